"""How a kind of result is given out: the files in its folder, its summary as JSON, and lines for the terminal."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import xarray as xr

from ..io import make_folder, write_bytes, write_dataset, write_text
from ..scene import Scene, to_toml
from . import style

# What commands call their files, by their endings; of several, the first.
ROLES = {".html": "report", ".nc": "result", ".toml": "scene", ".csv": "csv", ".png": "picture"}
# What a summary says of how its result was made, where that is known.
RUN = ("engine", "backend", "photons", "cpu_seconds", "wall_seconds", "digest", "accuracy_reached")


def _scene_of(result: Any) -> object:
    return result.attrs.get("scene") if isinstance(result, xr.Dataset) else getattr(result, "scene", None)


@dataclass(frozen=True)
class Report:
    """A kind of result.

    files : names of its files: the result itself (.nc), its page (.html), its first figure (.png), and others.
    page : of a result, as a whole page.
    summary : of a result, as plain numbers and texts.
    lines : of a result and its summary, for the terminal.
    figures : of a result, by their names, the most telling first.
    others : of a result, contents of its other files by their names, as `write_files` takes them.
    scene : of a result, its scene, or that as TOML; None where it has none.
    """

    files: tuple[str, ...]
    page: Callable[[Any], str]
    summary: Callable[[Any], dict[str, Any]]
    lines: Callable[[Any, dict[str, Any]], Iterable[object]]
    figures: Mapping[str, Callable[..., "style.Figure"]]
    others: Callable[..., Mapping[str, Any]] | None = None
    scene: Callable[[Any], object] = _scene_of

    def write(self, result: Any, folder: Path, *, stem: str | None = None, **options: Any) -> dict[str, Path]:
        """Write a result into a folder; returns the main paths by their role. Raises WriteError.

        stem : what all files are called but for their endings, where the user names one.
        """
        draw, others = next(iter(self.figures.values())), self.others(result, **options) if self.others else {}
        usual = {".nc": result, ".html": lambda _: self.page(result), ".png": lambda _: draw(result)}
        contents = {Path(name): others[name] if name in others else usual[Path(name).suffix] for name in self.files}
        return write_files(folder, {str(p.with_stem(stem or p.stem)): content for p, content in contents.items()})


def write_files(folder: Path, contents: Mapping[str, Any]) -> dict[str, Path]:
    """Write files, each whole; returns the main paths by their role.

    contents : by name: a text, bytes, a dataset or a figure, or a function that makes it or writes it at a path, so
        that the fault of a page does not cost the data before it; None is left out.
    """
    written: dict[str, Path] = {}
    make_folder(folder)
    for name, content in contents.items():
        path = folder / name
        made = content(path) if callable(content) else content
        if isinstance(made, xr.Dataset):
            write_dataset(made, path)
        elif isinstance(made, str):
            write_text(path, made)
        elif isinstance(made, bytes):
            write_bytes(path, made)
        elif hasattr(made, "savefig"):
            style.write_figure(made, path)
        if content is not None:
            written.setdefault(ROLES.get(path.suffix, ""), path)
    return {role: written[role] for role in ROLES.values() if role in written}


def run_summary(attributes: Mapping[Any, Any]) -> dict[str, Any]:
    """How a result was made, as its summary has it."""
    made = {name: attributes[name] for name in RUN if name in attributes}
    return made | {"cut_off": attributes.get("cut_off"), "reused": bool(attributes.get("reused", 0))}


def scene_text(scene: Scene, attributes: Mapping[Any, Any]) -> str:
    """A scene as TOML; one of a study that ended too early to be sure of it says so in its first line."""
    return (f"# Cut off: {attributes['cut_off']}\n" if attributes.get("cut_off") else "") + to_toml(scene)

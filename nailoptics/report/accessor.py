"""Results that show themselves: the figures, page and summary of each kind, as the command line writes them."""

import base64
import html
from collections.abc import Callable
from importlib import import_module
from inspect import signature
from io import BytesIO
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..scene import Scene, parse_scene
from . import style
from .files import Report, write_files
from .html import Html, preformatted, texts

# The report of each kind, by its class or, of Datasets, by their title.
KINDS = texts("kinds")


class Page(Html):
    """A page as text, which a notebook shows below the cell."""

    def __repr__(self) -> str:
        return f"<Page: {len(self)} characters>"

    def _repr_html_(self) -> str:
        return f'<iframe srcdoc="{html.escape(self)}" width="100%" height="700" style="border: 0"></iframe>'


class Nail:
    """Figures, page and summary of a result: `result.nail`."""

    def __init__(self, result: Any) -> None:
        self._result, attributes = result, getattr(result, "attrs", {})
        kind = str(attributes.get("title", type(result).__name__))
        known = max(filter(kind.startswith, KINDS), key=len, default=None)  # a sweep's title ends in its name
        if known is None:
            raise InputError(f'"{kind}" is not a result that nailoptics can show; keep the attributes of its Dataset.')
        self._kind, (module, _, name) = kind, KINDS[known].rpartition(".")
        self._report: Report = getattr(import_module(f".pages.{module}", __package__), name)

    def __repr__(self) -> str:
        return f"<{self._kind}: plot() of {', '.join(self.figures)}; report(), summary(), scene>"

    @property
    def figures(self) -> tuple[str, ...]:
        """Names of the figures of this kind of result, the most telling first; `plot` says what one of them lacks."""
        # Of sweeps those of colours alone have photographs.
        return tuple(f for f in self._report.figures if f != "photographs" or "photograph" in self._result)

    @property
    def scene(self) -> Scene:
        """The scene of a result: a placement's best, what an explanation requires; raises InputError if it has none."""
        scene = self._shown("the scene", self._report.scene)
        if not isinstance(scene, str | Scene):
            raise InputError(f'"{self._kind}" has no scene; use the scene that it was computed from.')
        return parse_scene(scene) if isinstance(scene, str) else scene

    def plot(self, figure: str | None = None, **which: Any) -> "style.Figure":
        """Draw a figure of the page as a matplotlib Figure.

        figure : one of `figures`; the first if not given.
        which : of several, such as led=1 where a page has one for each LED.

        Raises: InputError for an unknown name or option, or where a result lacks what is drawn, as parts of one do.
        """
        drawings = self._report.figures
        if figure is not None and figure not in drawings:
            raise InputError(f'figure = "{figure}" is unknown; choose from {", ".join(drawings)}.')
        name = figure or self.figures[0]
        what = ", ".join([f'figure = "{name}"', *(f"{option} = {value!r}" for option, value in which.items())])
        options = [*signature(drawings[name]).parameters][1:]
        if not which.keys() <= {*options}:
            raise InputError(f"{what} is unknown; options of this figure: {', '.join(options) or 'none'}.")
        drawn = self._shown(what, drawings[name], **which)
        vars(drawn)["_repr_png_"] = lambda: _png(drawn)  # a notebook shows figures of pyplot alone
        return drawn

    def report(self, path: str | Path | None = None, **options: Any) -> Page | dict[str, Path]:
        """The page, shown in a notebook; or written to a path that ends in .html, or with all files into a folder.

        options : of the files, such as scene_folder of a placement's.

        Returns: the page, or the paths of what was written by their role. Raises: WriteError, InputError.
        """
        if path is not None and Path(path).suffix != ".html":
            return self._shown("the report", self._report.write, folder=Path(path), **options)
        page = Page(self._shown("the report", self._report.page))
        return page if path is None else write_files(Path(path).parent, {Path(path).name: page})

    def summary(self) -> dict[str, Any]:
        """The result in plain numbers and texts, as the command prints them with --json."""
        return self._shown("the summary", self._report.summary)

    def _shown(self, what: str, show: Callable[..., Any], **options: Any) -> Any:
        """Call a function of the result; raises InputError for one that was cut or joined and lacks what is shown."""
        result = self._result.load() if hasattr(self._result, "attrs") else self._result  # a file at once
        try:
            return show(result, **options)
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
            raise InputError(f"{what} needs what this does not hold; show the whole result, as returned.") from error

    def _repr_html_(self) -> Html:
        """What a notebook shows: the lines of the terminal, and the first figure."""
        lines = preformatted("\n".join(map(str, self._report.lines(self._result, self.summary()))))
        try:
            picture = base64.b64encode(_png(self.plot())).decode()
        except InputError:
            return lines
        return Html(f'{lines}<img src="data:image/png;base64,{picture}">')


def _png(figure: "style.Figure") -> bytes:
    data = BytesIO()
    figure.savefig(data, format="png", dpi=110, facecolor="white")
    return data.getvalue()

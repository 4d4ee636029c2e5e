"""Results that show themselves: the figures, page and summary of each kind, as the command line writes them."""

import base64
import html
from importlib import import_module
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import xarray as xr

from ..errors import InputError
from ..io import make_folder, write_text
from ..scene import Scene, parse_scene
from .files import Report
from .html import Html, escaped

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# The report of each kind, by its class or, of Datasets, by their title.
KINDS = {
    "Exploration": "explore.page.EXPLORATION",
    "Explanation": "explain.EXPLANATION",
    "PaperFigures": "paper.PAPER",
    "Scene": "scene.SCENE",
    "SceneCheck": "scene.CHECK",
    "Subject": "force.SUBJECT",
    "Tradeoff": "tradeoff.TRADEOFF",
    "Transfer": "trace.TRANSFER",
    "Validation": "validate.VALIDATION",
    "nailoptics: a person's sensor, calibrated": "force.CALIBRATION",
    "nailoptics: batch": "sweep.SWEEP",
    "nailoptics: colour of the nail under force": "colour.COLOUR",
    "nailoptics: layouts ranked by force resolution": "placement.PLACEMENT",
    "nailoptics: oxygen from volts": "oximeter.OXIMETER",
    "nailoptics: readings of a trace": "trace.TRACE",
    "nailoptics: reduced optics against traced light": "compare.COMPARISON",
    "nailoptics: touch to volts": "simulate.SIMULATION",
    "force from volts": "force.PREDICTION",
    "oxygen from a recording": "oximeter.OXYGEN",
}


class Page(Html):
    """A page as text, which a notebook shows below the cell."""

    def __repr__(self) -> str:
        return f"<Page: {len(self)} characters>"

    def _repr_html_(self) -> str:
        return f'<iframe srcdoc="{html.escape(self)}" width="100%" height="700" style="border: 0"></iframe>'


@xr.register_dataset_accessor("nail")
class Nail:
    """Figures, page and summary of a result: `result.nail`."""

    def __init__(self, result: Any) -> None:
        self._result, attributes = result, getattr(result, "attrs", {})
        kind = str(attributes.get("title", type(result).__name__))
        known = max(filter(kind.startswith, KINDS), key=len, default=None)  # a sweep's title ends in its name
        if known is None:
            raise InputError(f'"{kind}" is no result that nailoptics can show; keep the attributes of its Dataset.')
        module, _, name = KINDS[known].rpartition(".")
        self._report: Report = getattr(import_module(f".pages.{module}", __package__), name)

    @property
    def figures(self) -> tuple[str, ...]:
        """Names of the figures that `plot` draws, the most telling first."""
        return tuple(self._report.figures)

    @property
    def scene(self) -> Scene:
        """The scene of a result; of a placement that of its best layout."""
        from ..studies.placement.result import chosen

        result = self._result
        return chosen(result) if "best_photodiode" in result.dims else parse_scene(str(result.attrs["scene"]))

    def plot(self, figure: str | None = None, **which: Any) -> "Figure":
        """Draw a figure of the page as a matplotlib Figure.

        figure : one of `figures`; the first if not given.
        which : of several, such as led=1 where a page has one for each LED.

        Raises: InputError for an unknown name, or where there is nothing to draw.
        """
        drawings = self._report.figures
        if figure is not None and figure not in drawings:
            raise InputError(f'figure = "{figure}" is unknown; choose from {", ".join(drawings)}.')
        name = figure or next(iter(drawings))
        try:
            drawn = drawings[name](self._result, **which)
        except (AttributeError, LookupError) as error:  # such as a section, which only simulate(picture=True) makes
            raise InputError(f'figure = "{name}" shows what this result does not hold: {error}.') from error
        vars(drawn)["_repr_png_"] = lambda: _png(drawn)  # a notebook shows figures of pyplot alone
        return drawn

    def report(self, path: str | Path | None = None, **options: Any) -> Page | dict[str, Path]:
        """The page, shown in a notebook; or written to a path that ends in .html, or with all files into a folder.

        options : of the files, such as negate_x_on_bottom of a placement's.

        Returns: the page, or the paths of what was written by their role. Raises: WriteError.
        """
        if path is not None and Path(path).suffix != ".html":
            return self._report.write(self._result, Path(path), **options)
        page = Page(self._report.page(self._result))
        if path is None:
            return page
        make_folder(Path(path).parent)
        write_text(Path(path), page)
        return {"report": Path(path)}

    def summary(self) -> dict[str, Any]:
        """The result in plain numbers and texts, as the command prints them with --json."""
        return self._report.summary(self._result)

    def html(self) -> Html:
        """What a notebook shows: the lines of the terminal, and the first figure."""
        lines = "\n".join(map(str, self._report.lines(self._result, self.summary())))
        try:
            picture = base64.b64encode(_png(self.plot())).decode()
        except InputError:
            return Html(f"<pre>{escaped(lines)}</pre>")
        return Html(f'<pre>{escaped(lines)}</pre><img src="data:image/png;base64,{picture}">')


def _png(figure: "Figure") -> bytes:
    data = BytesIO()
    figure.savefig(data, format="png", dpi=110, facecolor="white")
    return data.getvalue()

"""Objects that show themselves: the figures, page and summary of each kind, as the command line writes them."""

import base64
from importlib import import_module
from io import BytesIO
from typing import TYPE_CHECKING, Any

from ..errors import InputError
from .files import Report
from .html import Html, escaped

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# The kinds of what can be shown, by class or, of Datasets, by title: module and name of its report.
KINDS = {
    "Scene": "scene.SCENE",
}


class Nail:
    """Figures, page and summary of one object."""

    def __init__(self, shown: Any) -> None:
        self._shown = shown

    @property
    def figures(self) -> tuple[str, ...]:
        """Names of the figures that `plot` draws."""
        return tuple(self._report().figures)

    def plot(self, figure: str | None = None) -> "Figure":
        """Draw one of the figures of its page as a matplotlib Figure, the first if no name is given.

        Raises: InputError for an unknown name, or where there is nothing to draw.
        """
        drawings = self._report().figures
        if figure is not None and figure not in drawings:
            raise InputError(f'figure = "{figure}" is unknown; choose from {", ".join(drawings)}.')
        drawn = drawings[figure or next(iter(drawings))](self._shown)
        vars(drawn)["_repr_png_"] = lambda: png(drawn)  # a notebook shows figures of pyplot alone
        return drawn

    def html(self) -> Html:
        """What a notebook shows: a line, and the first figure."""
        try:
            picture = base64.b64encode(png(self.plot())).decode()
        except InputError:
            return escaped(repr(self._shown))
        return Html(f'{escaped(repr(self._shown))}<br><img src="data:image/png;base64,{picture}">')

    def _report(self) -> Report:
        kind = type(self._shown).__name__
        module, name = KINDS[kind].split(".")
        report: Report = getattr(import_module(f".pages.{module}", __package__), name)
        return report


def png(figure: "Figure") -> bytes:
    """A figure as a PNG file."""
    data = BytesIO()
    figure.savefig(data, format="png", dpi=110, facecolor="white")
    return data.getvalue()

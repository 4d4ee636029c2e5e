"""What objects show of themselves in a notebook. The report room makes it, which lies above all that it shows."""

from importlib import import_module
from typing import Any


class Displayed:
    """An object with figures, a page and a summary in its `nail`, the first figure of which a notebook shows."""

    @property
    def nail(self) -> Any:
        """Figures, page and summary: plot(), report() and summary(), as those of results that are Datasets."""
        # By its name, as rooms know those below them alone.
        return import_module("nailoptics.report.accessor").Nail(self)

    def _repr_html_(self) -> str:
        return str(self.nail.html())

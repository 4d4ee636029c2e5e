"""What objects show of themselves in a notebook, by the report room, which lies above all that it shows."""

from collections.abc import Callable
from typing import Any, ClassVar


class Displayed:
    """An object with figures, a page and a summary in its `nail`, the first figure of which a notebook shows."""

    accessor: ClassVar[Callable[[object], Any]]
    """Makes the `nail` of an object; the package sets it, which knows the report room and this one."""

    @property
    def nail(self) -> Any:
        """Figures, page and summary: plot(), report() and summary(), as those of results that are Datasets."""
        return Displayed.accessor(self)

    def _repr_html_(self) -> str:
        return str(self.nail.html())

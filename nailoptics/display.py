"""What objects show of themselves in a notebook, by `nailoptics.report`, which lies above all that it shows."""

import sys
from collections.abc import Callable
from importlib.abc import MetaPathFinder
from importlib.machinery import PathFinder
from typing import Any, ClassVar


class Displayed:
    """An object with figures, a page and a summary in its `nail`, the first figure of which a notebook shows."""

    accessor: ClassVar[Callable[[object], Any]]
    """Makes the `nail` of an object; the package sets it, which knows `nailoptics.report` and this module."""

    @property
    def nail(self) -> Any:
        """Figures, page and summary: plot(), report() and summary(), as those of results that are Datasets."""
        return Displayed.accessor(self)

    def __repr__(self) -> str:
        return repr(self.nail)

    def _repr_html_(self) -> str:
        return str(self.nail._repr_html_())


class _XarrayFinder(MetaPathFinder):
    """Registers `nail` once xarray has been imported, which `import nailoptics` does not wait for."""

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> Any:
        spec = PathFinder.find_spec(name, path) if name == "xarray" else None
        if spec and spec.loader:
            execute = spec.loader.exec_module

            def execute_and_register(module: Any) -> None:
                execute(module)
                sys.meta_path.remove(self)
                show_datasets()

            vars(spec.loader)["exec_module"] = execute_and_register
        return spec


def show_datasets() -> None:
    """Give Datasets their `nail`: now, or when somebody imports xarray."""
    if "xarray" in sys.modules:
        sys.modules["xarray"].register_dataset_accessor("nail")(Displayed.accessor)
    else:
        sys.meta_path.insert(0, _XarrayFinder())

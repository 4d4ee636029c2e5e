"""nailoptics: an optical sensor on a fingernail, simulated from touch force to photodiode volts."""

import importlib
from typing import TYPE_CHECKING, Any

from .errors import InputError, NailopticsError, NotReachedError

if TYPE_CHECKING:
    from . import hemodynamics, scene
    from .batch import open_results
    from .light import Transfer, trace
    from .scene import Scene, load_scene

__version__ = "0.1.0"

# Imported when first used, so that `import nailoptics` takes no time.
_ROOMS = ("hemodynamics", "scene")
_LATER = {
    "Scene": ".scene",
    "Transfer": ".light",
    "load_scene": ".scene",
    "open_results": ".batch",
    "trace": ".light",
}


def __getattr__(name: str) -> Any:
    if name in _ROOMS:
        return importlib.import_module(f".{name}", __name__)
    if name in _LATER:
        return getattr(importlib.import_module(_LATER[name], __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*__all__, "__version__"]


__all__ = [
    "InputError",
    "NailopticsError",
    "NotReachedError",
    "Scene",
    "Transfer",
    "hemodynamics",
    "load_scene",
    "open_results",
    "scene",
    "trace",
]

"""nailoptics: an optical sensor on a fingernail, simulated from touch force to photodiode volts."""

import importlib
from typing import TYPE_CHECKING, Any

from . import hemodynamics
from .errors import InputError, NailopticsError, NotReachedError
from .scene import Scene, load_scene

if TYPE_CHECKING:
    from .batch import open_results
    from .light import Transfer, trace

__version__ = "0.1.0"

# Names that would pull in slow packages are imported when first used.
_LATER = {"trace": ".light", "Transfer": ".light", "open_results": ".batch"}


def __getattr__(name: str) -> Any:
    if name in _LATER:
        return getattr(importlib.import_module(_LATER[name], __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


__all__ = [
    "InputError",
    "NailopticsError",
    "NotReachedError",
    "Scene",
    "Transfer",
    "hemodynamics",
    "load_scene",
    "open_results",
    "trace",
]

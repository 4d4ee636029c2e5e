"""nailoptics: an optical sensor on a fingernail, simulated from touch force to photodiode volts."""

import importlib
from typing import TYPE_CHECKING, Any

from .errors import InputError, NailopticsError, NotReachedError
from .version import __version__ as __version__

if TYPE_CHECKING:
    from . import hemodynamics as hemodynamics
    from . import scene as scene
    from . import tissue as tissue
    from .batch import open_results as open_results
    from .batch import sweep as sweep
    from .exports.formats import export as export
    from .exports.other_program import compare_with as compare_with
    from .light import Transfer as Transfer
    from .light import trace as trace
    from .scene import Scene as Scene
    from .scene import load_scene as load_scene
    from .scene import parse_scene as parse_scene
    from .scene import to_toml as to_toml
    from .studies.colour.nail_colour import colour as colour
    from .studies.comparison.compare import compare as compare
    from .studies.force.calibrate import calibrate as calibrate
    from .studies.force.predict import predict as predict
    from .studies.model_error.explain import explain as explain
    from .studies.model_error.tradeoff import tradeoff as tradeoff
    from .studies.oximetry.oxygen import oximeter as oximeter
    from .studies.placement.place import place as place
    from .studies.simulate import simulate as simulate

# Imported when first used, so that `import nailoptics` takes no time.
_ROOMS = ("hemodynamics", "scene", "tissue")
_NAMES = {
    ".batch": "open_results sweep",
    ".exports.formats": "export",
    ".exports.other_program": "compare_with",
    ".light": "Transfer trace",
    ".scene": "Scene load_scene parse_scene to_toml",
    ".studies.colour.nail_colour": "colour",
    ".studies.comparison.compare": "compare",
    ".studies.force.calibrate": "calibrate",
    ".studies.force.predict": "predict",
    ".studies.model_error.explain": "explain",
    ".studies.model_error.tradeoff": "tradeoff",
    ".studies.oximetry.oxygen": "oximeter",
    ".studies.placement.place": "place",
    ".studies.simulate": "simulate",
}
_HOMES = {name: home for home, names in _NAMES.items() for name in names.split()}
__all__ = ["InputError", "NailopticsError", "NotReachedError", *_ROOMS, *_HOMES]


def __getattr__(name: str) -> Any:
    if name in _ROOMS:
        return importlib.import_module(f".{name}", __name__)
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name], __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})

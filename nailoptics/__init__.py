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
_HOMES = {
    "Scene": ".scene",
    "Transfer": ".light",
    "calibrate": ".studies.force.calibrate",
    "colour": ".studies.colour.nail_colour",
    "compare": ".studies.comparison.compare",
    "compare_with": ".exports.other_program",
    "explain": ".studies.model_error.explain",
    "export": ".exports.formats",
    "load_scene": ".scene",
    "open_results": ".batch",
    "oximeter": ".studies.oximetry.oxygen",
    "parse_scene": ".scene",
    "predict": ".studies.force.predict",
    "place": ".studies.placement.place",
    "simulate": ".studies.simulate",
    "to_toml": ".scene",
    "trace": ".light",
    "tradeoff": ".studies.model_error.tradeoff",
}
__all__ = ["InputError", "NailopticsError", "NotReachedError", *_ROOMS, *_HOMES]


def __getattr__(name: str) -> Any:
    if name in _ROOMS:
        return importlib.import_module(f".{name}", __name__)
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name], __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})

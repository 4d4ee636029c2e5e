"""The public names and where they live: for type checkers, and for the package, which imports each when first used."""

from typing import Any

from . import hemodynamics as hemodynamics
from . import tissue as tissue
from .batch import open_results as open_results
from .batch import sweep as sweep
from .errors import InputError as InputError
from .errors import NailopticsError as NailopticsError
from .errors import NotReachedError as NotReachedError
from .exports.formats import export as export
from .exports.other_program import compare_with as compare_with
from .light import Transfer as Transfer
from .light import trace as trace
from .report.pages.paper import figures as figures
from .scene import Scene as Scene
from .scene import load_scene as load_scene
from .scene import parse_scene as parse_scene
from .scene import to_toml as to_toml
from .scene.protocol import protocol as protocol
from .studies.colour.nail_colour import colour as colour
from .studies.compare import compare as compare
from .studies.exploration.explore import explore as explore
from .studies.force.calibrate import calibrate as calibrate
from .studies.force.predict import predict as predict
from .studies.force.predict import predict_live as predict_live
from .studies.force.reading_table import record as record
from .studies.force.subject import Subject as Subject
from .studies.force.subject import load_subject as load_subject
from .studies.model_error.explain import explain as explain
from .studies.model_error.tradeoff import tradeoff as tradeoff
from .studies.oximetry.oxygen import oximeter as oximeter
from .studies.placement.place import place as place
from .studies.scene_check import check as check
from .studies.simulate import simulate as simulate
from .studies.validation.validate import validate as validate
from .terminal import show_progress as show_progress
from .version import __version__ as __version__

__all__: list[str]
scene = load_scene  # called; the module has more

def __getattr__(name: str) -> Any: ...

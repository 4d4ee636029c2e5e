"""WHAT THE USER WROTE: frozen models of a scene, from and to TOML; called, the package reads one (`load_scene`)."""

import sys
from pathlib import Path
from types import ModuleType

from .body import Body, Breathing, Drift, Heartbeat, Motion, Vasomotion
from .electronics import Ambient, Electronics, Oximeter, Slot
from .files import SceneIn, as_scene, digest, json_schema, load_scene, parse_scene, to_toml
from .finger import Finger, Layer, Phantom
from .layout import Element, Layout
from .parts import Board, Led, Photodiode
from .placement import Candidate, FingerCase, Placement
from .priors import Prior, Priors
from .rectangles import Rectangle
from .scene import Scene
from .touch import ForceStep, Touch
from .tracing import Accuracy, Light, Viewing
from .vessels import Blood, Tuning


class _CallableModule(ModuleType):
    def __call__(self, path: str | Path) -> Scene:
        """Read a scene file, or the shipped scene of that name, as `load_scene` does."""
        return load_scene(path)


sys.modules[__name__].__class__ = _CallableModule

"""WHAT THE USER WROTE: frozen models of a scene, read from and written to TOML."""

from .body import Body, Breathing, Drift, Heartbeat, Motion, Vasomotion
from .files import SceneIn, as_scene, digest, json_schema, load_scene, parse_scene, to_toml
from .finger import Finger
from .layout import Element, Layout
from .models import Accuracy, Ambient, Electronics, Layer, Light, Phantom, Scene, Viewing
from .oximeter import Oximeter, Slot
from .parts import Board, Led, Photodiode
from .placement import Candidate, FingerCase, Placement
from .priors import Prior, Priors
from .rectangles import Rectangle
from .touch import ForceStep, Touch
from .vessels import Blood, Tuning

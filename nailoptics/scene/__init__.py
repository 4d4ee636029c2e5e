"""WHAT THE USER WROTE: frozen models of a scene, read from and written to TOML."""

from .files import digest, json_schema, load_scene, parse_scene, to_toml
from .finger import Finger
from .layout import Element, Layout, Rectangle
from .models import Accuracy, Blood, Electronics, Layer, Light, Phantom, Scene
from .parts import Board, Led, Photodiode
from .placement import Candidate, FingerCase, Placement
from .touch import Touch

__all__ = [
    "Accuracy",
    "Blood",
    "Board",
    "Candidate",
    "Electronics",
    "Element",
    "Finger",
    "FingerCase",
    "Layer",
    "Layout",
    "Led",
    "Light",
    "Phantom",
    "Photodiode",
    "Placement",
    "Rectangle",
    "Scene",
    "Touch",
    "digest",
    "json_schema",
    "load_scene",
    "parse_scene",
    "to_toml",
]

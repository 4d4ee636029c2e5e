"""WHAT THE USER WROTE: frozen models of a scene, read from and written to TOML."""

from .files import digest, json_schema, load_scene, parse_scene, to_toml
from .finger import Finger
from .models import Accuracy, Blood, Board, Electronics, Layer, Led, Light, Phantom, Photodiode, Scene
from .placement import Candidate, FingerCase, Placement
from .touch import Touch

__all__ = [
    "Accuracy",
    "Blood",
    "Board",
    "Candidate",
    "Electronics",
    "Finger",
    "FingerCase",
    "Layer",
    "Led",
    "Light",
    "Phantom",
    "Photodiode",
    "Placement",
    "Scene",
    "Touch",
    "digest",
    "json_schema",
    "load_scene",
    "parse_scene",
    "to_toml",
]

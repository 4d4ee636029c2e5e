"""What decides where light goes: scenes that agree in it share a trace, whatever dims or reads the light."""

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any

from ..geometry.build import LED_LIGHT
from ..scene import Photodiode, Scene, digest
from ..scene.finger import ABSORBING
from ..scene.parts import ELECTRICAL, ROOM, BoardFile


def light_scene(scene: Scene) -> Scene:
    """The scene with the same light paths and everything else at its default; equal for all that can share a trace.

    Blood, saturation and what the finger's parts absorb only dim the light; touch, body, electronics, flux and line
    width come after it; and the fingers and boards of a search for a layout are not those of its scene.
    """
    blood = type(scene.blood)(zone_edges_mm=scene.zone_edges_mm, zone_width_mm=scene.zone_width_mm)
    packaged = dict.fromkeys((*ROOM, "reference", "part", "package_height_um", "price")) | {"lens": False}
    usual: dict[str, Any] = packaged | {"flux_mw": 1.0, "fwhm_nm": 0.0, "current_ma": None, "max_current_ma": None}
    leds = tuple(led.model_copy(update=usual | {"name": f"led{i}"}) for i, led in enumerate(scene.leds))
    usual = {name: Photodiode.model_fields[name].default for name in ELECTRICAL} | packaged
    photodiodes = tuple(
        p.model_copy(update=usual | {"name": f"photodiode{i}"}) for i, p in enumerate(scene.photodiodes)
    )
    plain = ("touch", "colour", "electronics", "accuracy", "priors")
    update: dict[str, Any] = {name: type(getattr(scene, name))() for name in plain}
    update |= dict.fromkeys(("body", "ambient", "oximeter", "placement"))
    update |= {"blood": blood, "leds": leds, "photodiodes": photodiodes}
    update["light"] = scene.light.model_copy(update={"engine": "auto"})
    of_file = {name: field.default for name, field in BoardFile.model_fields.items()}
    update["board"] = scene.board.model_copy(update=of_file)
    if scene.finger is not None:
        update["finger"] = scene.finger.with_usual(("digit", *ABSORBING))
    if scene.phantom is not None:
        named = enumerate(scene.phantom.layers)
        layers = tuple(layer.model_copy(update={"name": f"layer{i}"}) for i, layer in named)
        update["phantom"] = scene.phantom.model_copy(update={"layers": layers})
    return scene.model_copy(update=update)


def traced_absorption(scenes: Sequence[Scene]) -> list[Scene | None]:
    """For each scene, the one whose trace gives its readings, too; None where that is its own.

    A trace is read at more absorption with no more variance per photon, but its photons walk longer. So phantoms that
    differ in absorption alone are traced with that of each layer at the power of ten below, which many share.
    """
    clear = [light_digest(_absorbing_less(scene, nothing=True)) if scene.phantom else "" for scene in scenes]
    lights = {(light, light_digest(scene)) for light, scene in zip(clear, scenes, strict=True) if light}
    count = Counter(light for light, _ in lights)
    return [_absorbing_less(s) if count[light] > 1 else None for light, s in zip(clear, scenes, strict=True)]


def _absorbing_less(scene: Scene, *, nothing: bool = False) -> Scene:
    """A phantom whose layers absorb nothing, or as much as the power of ten below what they do."""
    assert scene.phantom is not None
    mu_a = [0.0 if nothing else layer.mu_a_per_mm for layer in scene.phantom.layers]
    less = [10.0 ** math.floor(math.log10(value) + 1e-9) if value else 0.0 for value in mu_a]
    pairs = zip(scene.phantom.layers, less, strict=True)
    layers = tuple(layer.model_copy(update={"mu_a_per_mm": value}) for layer, value in pairs)
    return scene.model_copy(update={"phantom": scene.phantom.model_copy(update={"layers": layers})})


def light_digest(scene: Scene) -> str:
    """Digest of what decides where light goes, (64) hexadecimal characters; scenes with the same one share a trace."""
    return digest(light_scene(scene))


def led_digest(scene: Scene, led: int) -> str:
    """Digest of what decides where the light of one LED goes: of the others only their dies, in a finger."""
    light = light_scene(scene)
    if scene.phantom is not None:
        return digest(light.model_copy(update={"leds": (light.leds[led],)}))
    dies = (die if i == led else die.model_copy(update=LED_LIGHT) for i, die in enumerate(light.leds))
    return digest(light.model_copy(update={"leds": tuple(dies)}))

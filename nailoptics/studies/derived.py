"""Effects that no retraced reading can show, derived from other traces: light from outside, from beyond, from blood."""

import math

import numpy as np

from .. import tissue
from ..scene import Scene
from ..scene.layout import lay_out
from . import variants
from .ambient import collecting_area_mm2
from .compare import BLOOD_REDUCED_SCATTERING_PER_MM
from .effects import Effect, effect_of
from .fits import Z95
from .variants import Look, revised

SCATTERING_FACTOR = 1.4
# Diffuse light in the band of the photodiodes, from all sides. [W m^-2] About a bright room; full sun is 100 times it.
AMBIENT_W_PER_M2 = 10.0
EPOXY_INDEX, BED_INDEX = 1.55, 1.38


def denser(scene: Scene) -> Scene:
    """The scene with a bed that scatters more."""
    return revised(scene, {"light": {"bed_scattering": SCATTERING_FACTOR * scene.light.bed_scattering}})


def blood_scattering(scene: Scene, base: Look, denser: Look, tolerance: float) -> Effect:
    """What the scattering of the blood that a touch moves would do to a reading; the model's stays as at rest."""
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = np.log(denser.level / base.level) / np.log(SCATTERING_FACTOR)
        error = np.hypot(base.relative_stderr, denser.relative_stderr) / np.log(SCATTERING_FACTOR)
    moved = np.abs(np.diff(variants.end_states(scene), axis=0)).max()
    bed = [tissue.optical_properties("bed", led.wavelength_nm) for led in scene.leds]
    reduced = np.array([float(b.mu_s_per_mm) * (1 - float(b.g)) for b in bed])[:, None]
    more = moved * BLOOD_REDUCED_SCATTERING_PER_MM / reduced
    text = f"bed's mu_s' follows the blood ({float(more.max()):.1%} of it)"
    return effect_of(
        "blood's own scattering", False, text, slope * more, error * more, None, "", tolerance, "derived", base
    )


def swapped_scene(scene: Scene) -> Scene:
    """The farthest photodiode as a Lambertian LED, and a photodiode where the first LED was."""
    layout, tables = lay_out(scene), scene.model_dump()
    first = layout.leds[0].center_mm
    far = max(layout.photodiodes, key=lambda e: math.dist(e.area.center_mm, first)).area
    # The board stays where it is, though its parts no longer span it evenly.
    center, (du, dv), (u, v) = layout.outline.center_mm, scene.board.center_mm, scene.leds[0].position_mm
    led = tables["leds"][0] | {
        "name": "swapped",
        "part": None,
        "pattern": "lambertian",
        "pattern_deg": None,
        "pattern_relative": None,
        "position_mm": (far.center_mm[0] - center[0], far.center_mm[1] - center[1]),
        "size_mm": (far.u_max - far.u_min, far.v_max - far.v_min),
    }
    place = (u + du - center[0], v + dv - center[1])
    photodiode = {"name": "swapped", "position_mm": place, "size_mm": scene.leds[0].size_mm}
    outline = layout.outline
    size = (outline.u_max - outline.u_min, outline.v_max - outline.v_min)
    board = tables["board"] | {"size_mm": size, "center_mm": center}
    return variants.validated(tables | {"board": board, "leds": (led,), "photodiodes": (photodiode,)})


def ambient(scene: Scene, base: Look, swapped: Look, tolerance: float) -> Effect:
    """Ambient light that reaches the farthest photodiode through the skin, beside the LED's light there."""
    escapes = swapped.transfer.energy()["reflected"]
    led = swapped.transfer.scene.leds[0]
    area_mm2 = led.size_mm[0] * led.size_mm[1]
    # A watt per square metre is a thousandth of a milliwatt per square millimetre.
    collected_mw = [
        1e-3 * AMBIENT_W_PER_M2 * collecting_area_mm2(escapes[k], area_mm2=area_mm2, n=EPOXY_INDEX)
        for k in ("value", "stderr")
    ]
    flux = np.array([one.flux_mw for one in scene.leds])[:, None]
    with np.errstate(divide="ignore"):
        ratio, error = (np.where(base.level > 0, x / (base.level * flux), np.inf) for x in collected_mw)
    text = f"{AMBIENT_W_PER_M2:g} W/m2 from all sides"
    moves = (ratio, np.hypot(error, ratio * base.relative_stderr))
    return effect_of("ambient light", False, text, *moves, None, "", tolerance, "derived", base)


def returning(
    name: str, modelled: bool, changed_to: str, lines: str, base: Look, cut: Look, back: Look, tolerance: float
) -> Effect:
    """Light that would come back from beyond a cut through the finger, at most.

    cut, back : looks whose light left through the cut: from the LED, and (by reciprocity, from a Lambertian source
        on the board) from the photodiode. Diffuse light from a cut of area A_cut reaches a photodiode of area A with
        the probability that the photodiode's would reach the cut, times n^2 A / (n_cut^2 A_cut).
    """
    finger = base.transfer.scene.finger
    assert finger is not None
    area_mm2 = np.pi / 4 * finger.width_mm * finger.thickness_mm
    diode = max((e.area for e in lay_out(base.transfer.scene).photodiodes), key=lambda r: r.area_mm2)
    passed = 1.0
    for one in (cut, back):
        left = one.transfer.energy()["transmitted"]
        # Of n photons none may have passed: with 95 % confidence the part is below 3 / n.
        passed *= left["value"] + Z95 * left["stderr"] + 3 / one.transfer.photons
    returned = passed * EPOXY_INDEX**2 * diode.area_mm2 / (BED_INDEX**2 * area_mm2)
    with np.errstate(divide="ignore"):
        ratio = np.where(base.level > 0, returned / base.level, np.inf)
    return effect_of(name, modelled, changed_to, ratio, 0 * base.level, None, lines, tolerance, "derived", base)


def nothing(name: str, why: str, tolerance: float) -> Effect:
    """An effect that is none by construction."""
    return Effect(name, False, why, "derived", 0.0, 0.0, 0.0, "", 0.0, 0.0, 0.0, "", tolerance)

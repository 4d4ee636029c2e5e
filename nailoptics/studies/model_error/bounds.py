"""Effects that no retraced reading can show, derived from other traces: light from outside, from beyond, from blood."""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from ... import tissue
from ...light import optics
from ...scene import Scene
from ...scene.files import scene_of
from ...scene.rectangles import Rectangle
from ...sensor import electronics
from ...sensor.ambient import SOURCES, collecting_area_mm2
from ...statistics import Z95
from .effect import Change, Effect, effect_of
from .paired import UNSEEN, Difference, PairedReadings, difference, end_states
from .variants import revised

SCATTERING_FACTOR = 1.4
# A part that less of a reading returns from is cut off.
RETURNING = 1e-4


def denser(scene: Scene) -> Scene:
    """The scene with a bed that scatters more."""
    assert scene.finger is not None
    return revised(scene, {"finger": {"bed_scattering": SCATTERING_FACTOR * scene.finger.bed_scattering}})


def blood_scattering(scene: Scene, base: PairedReadings, denser: PairedReadings, tolerance: float) -> Effect:
    """What the scattering of the blood that a touch moves would do to the signal; the model's stays as at rest.

    Blood takes the place of dermis. The slope of a reading by the scattering is known for the whole bed; each zone gets
    the part of it that the light's path has there.
    """
    assert scene.finger is not None
    both, factor = difference(base, denser), scene.finger.bed_scattering
    moved = np.diff(end_states(scene), axis=0)[0]
    contrast = [tissue.blood_scattering_contrast(led.wavelength_nm, bed_scattering=factor) for led in scene.leds]
    paths = np.stack(
        [
            [np.bincount(one.photodiode, part[:, 0] * path, minlength=base.level.shape[1]) for path in zones.T]
            for one, part in zip(base.transfer.traces, base.parts, strict=True)
            for zones in (one.path_mm[:, optics.bed_columns(scene)],)
        ]
    )
    largest = int(np.nanargmax(np.abs(base.modulation))) if np.isfinite(base.modulation).any() else 0
    unit, unit_stderr = np.abs(base.modulation.flat[largest]), base.modulation_stderr.flat[largest]
    with np.errstate(divide="ignore", invalid="ignore"):
        more = np.array(contrast)[:, None] * np.tensordot(paths, moved, (1, 0)) / paths.sum(1) / unit
        signal = more * np.log1p(both.ratio) / np.log(SCATTERING_FACTOR)
        each = more / (1 + both.ratio) / np.log(SCATTERING_FACTOR)
        error = np.hypot(each * both.ratio_stderr, signal * unit_stderr / unit)
    still = np.zeros_like(signal)
    found = Difference(still, still, signal, error, swing_skew=np.abs(each) * both.ratio_skew)
    text = f"replaces dermis, which scatters {1 / (1 + np.mean(contrast)):.2g} times as much"
    change = Change("blood's own scattering", False, text)
    return effect_of(change, found, base, tolerance=tolerance, of="signal")


def farthest(scene: Scene) -> Scene:
    """The photodiode farthest from the first LED, swapped with it."""
    led_mm = scene.layout.leds[0].center_mm
    return swapped(scene, max(scene.layout.photodiode_areas, key=lambda area: math.dist(area.center_mm, led_mm)))


def most_proximal(scene: Scene) -> Scene:
    """The photodiode nearest to the hand, swapped with the first LED."""
    return swapped(scene, min(scene.layout.photodiode_areas, key=lambda area: area.center_mm[1]))


def swapped(scene: Scene, far: Rectangle) -> Scene:
    """A photodiode as a Lambertian LED, and a photodiode where the first LED was."""
    outline, tables = scene.layout.outline, scene.model_dump()
    # The board stays where it is, though its parts no longer span it evenly.
    center, (du, dv), (u, v) = outline.center_mm, scene.board.center_mm, scene.leds[0].position_mm
    led = tables["leds"][0] | {
        "name": "swapped",
        "part": None,
        "pattern": "lambertian",
        "pattern_deg": None,
        "pattern_relative": None,
        "position_mm": (far.center_mm[0] - center[0], far.center_mm[1] - center[1]),
        "size_mm": far.size_mm,
    }
    place = (u + du - center[0], v + dv - center[1])
    photodiode = {"name": "swapped", "position_mm": place, "size_mm": scene.leds[0].size_mm}
    board = tables["board"] | {"size_mm": outline.size_mm, "center_mm": center}
    return scene_of(tables | {"board": board, "leds": (led,), "photodiodes": (photodiode,)})


def ambient(scene: Scene, base: PairedReadings, swapped: PairedReadings, tolerance: float) -> Effect:
    """A lamp's light from all sides on the farthest photodiode through the skin, beside the LED's light there.

    All of it is taken to be absorbed as the LED's light is, which is less than blood does to what is shorter.
    """
    lamp = SOURCES[-1]
    diode = scene.photodiodes[0]
    per_mm2 = float(lamp.photocurrent_a_per_mm2(diode)[1].sum())
    escapes, led = swapped.transfer.energy()["reflected"], swapped.transfer.scene.leds[0]
    area_mm2, index = led.size_mm[0] * led.size_mm[1], index_of("epoxy", led.wavelength_nm)
    # Of n photons one more may have left than were seen.
    parts = [escapes["value"], math.hypot(escapes["stderr"], UNSEEN / swapped.transfer.photons)]
    current = [per_mm2 * float(collecting_area_mm2(part, area_mm2=area_mm2, n=index)) for part in parts]
    wavelength_nm = np.array([one.wavelength_nm for one in scene.leds])
    response = electronics.photodiode_responsivity_a_per_w(diode, wavelength_nm)
    full = 1e-3 * np.array([one.flux_mw for one in scene.leds]) * response
    with np.errstate(divide="ignore"):
        ratio, error = (np.where(base.level > 0, x / (base.level * full[:, None]), np.inf) for x in current)
    found = Difference(ratio, np.hypot(error, ratio * base.relative_stderr))
    text = f"{lamp.name} of {lamp.lux:g} lux on all sides; a reading with the LED off takes it away"
    effect = effect_of(Change("ambient light", False, text), found, base, tolerance=tolerance)
    # The light that leaves is one number for all photodiodes, so that its error does not shrink in their mean.
    return replace(
        effect, typical_stderr=math.hypot(effect.typical_stderr, effect.typical * parts[1] / (parts[0] or 1.0))
    )


def index_of(region: str, wavelength_nm: float) -> float:
    """Refractive index of a region."""
    return float(tissue.scattering(region, wavelength_nm)[2])  # type: ignore[arg-type]


def without_deep(base: PairedReadings) -> Difference:
    """What readings would lose of themselves if the pulp swallowed all light that meets it."""
    pulp = base.transfer.absorbers.index("pulp")
    shallow = [trace.path_mm[:, [pulp]] <= 0 for trace in base.transfer.traces]
    left = tuple(part * kept for part, kept in zip(base.parts, shallow, strict=True))
    return difference(base, replace(base, parts=left))


def from_deep(base: PairedReadings) -> Effect:
    """What of a reading comes back from the pulp, which lies under the bed and around the bone."""
    found = without_deep(base)
    change = Change("light back from the pulp", True, "pulp swallows all")
    return effect_of(change, found, base, tolerance=RETURNING)


def returning(change: Change, base: PairedReadings, cut: PairedReadings, back: PairedReadings) -> Effect:
    """Light that would come back from beyond a cut through the finger, at most.

    cut, back : traces whose light left through the cut: from the LED, and (by reciprocity, from a Lambertian source
        on the board) from the photodiode. Diffuse light from a cut of area A_cut reaches a photodiode of area A with
        the probability that the photodiode's would reach the cut, times n^2 A / (n_cut^2 A_cut).
    """
    finger = base.transfer.scene.finger
    assert finger is not None
    area_mm2 = np.pi / 4 * finger.width_mm * finger.thickness_mm
    diode = max(base.transfer.scene.layout.photodiode_areas, key=lambda r: r.area_mm2)
    passed = 1.0
    for one in (cut, back):
        left = one.transfer.energy()["transmitted"]
        # Of n photons none may have passed: with 95 % confidence the part is below 3 / n.
        passed *= left["value"] + Z95 * left["stderr"] + 3 / one.transfer.photons
    wavelength = base.transfer.scene.leds[0].wavelength_nm
    ratio_of_indices = index_of("epoxy", wavelength) / index_of("bed", wavelength)
    returned = passed * ratio_of_indices**2 * diode.area_mm2 / area_mm2
    with np.errstate(divide="ignore"):
        most = np.where(base.level > 0, returned / base.level, np.inf)
    # All that is known is what it is at most.
    return effect_of(change, Difference(np.zeros_like(most), most / Z95), base, tolerance=RETURNING)


def nothing(name: str, why: str, tolerance: float) -> Effect:
    """An effect that is none by construction."""
    none: dict[str, Any] = dict.fromkeys(("change", "stderr", "bound", "typical", "typical_stderr"), 0.0)
    none |= {"how": "derived", "photodiode": "", "modulation_bound": 0.0, "tolerance": tolerance}
    return Effect(name=name, modelled=False, changed_to=why, **none)

"""What a change does to the readings, by its trace, by other weights, or derived, and whether that matters."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np

from ... import tissue
from ...light import optics
from ...scene import Scene
from ...sensor import electronics
from ...sensor.ambient import SOURCES, collecting_area_mm2
from ...statistics import Z95
from .changes import (
    SCATTERING_FACTOR,
    Change,
    changes_of,
    denser,
    farthest,
    lines_of,
    most_proximal,
    revised,
    shortened,
)
from .paired import (
    UNDETECTED,
    Difference,
    PairedReadings,
    difference,
    end_states,
    reweighted,
    shape_of,
    weighted_mean,
)

# An effect is sure to matter if its change exceeds the tolerance by so many standard errors: by chance alone that
# happens to one of 2000 changes, so that a study of a hundred is right about all of them in 19 of 20 cases.
SURE = 3.5
# A part that less of a reading returns from is cut off.
RETURNING = 1e-4


@dataclass(frozen=True, kw_only=True)
class Effect(Change):
    """A change that was measured: by how much readings move.

    of : "reading" where it moves the reading at rest, "signal" where it moves the change by touch alone.
    change, stderr : change of that, of the reading at rest relative and of the signal as a part of the largest, of the
        photodiode named, which it surely moves most; the error counts that it was picked: its 95 % interval holds with
        Bonferroni's correction for all photodiodes.
    bound : what no photodiode's change exceeds, with 95 % confidence each.
    typical, typical_stderr : change over all photodiodes, weighed by the errors of the scene's readings.
    modulation_bound : the same bound on the modulation by touch, as a part of the largest modulation.
    """

    how: Literal["reweighted", "retraced", "derived"]
    change: float
    stderr: float
    bound: float
    photodiode: str
    typical: float
    typical_stderr: float
    modulation_bound: float | None
    tolerance: float
    of: Literal["reading", "signal"] = "reading"

    @property
    def matters(self) -> Literal["yes", "no", "cannot tell"]:
        """Whether it moves a reading, or the signal, by more than the tolerance, as far as the traces resolve it."""
        if self.bound <= self.tolerance:
            return "no"
        return "yes" if abs(self.change) - SURE * self.stderr > self.tolerance else "cannot tell"

    @property
    def lines(self) -> list[str]:
        """The scene lines that change it."""
        return lines_of(self.changes)


def effect_of(
    change: Change,
    found: Difference,
    base: PairedReadings,
    *,
    tolerance: float,
    how: Literal["reweighted", "retraced", "derived"] = "derived",
    of: Literal["reading", "signal"] = "reading",
) -> Effect:
    """An effect from the difference that its change makes; without a modulation where the difference has none.

    of : what it is judged by.
    """
    from scipy.special import ndtri

    ratio, error, most = found.ratio, found.ratio_stderr, found.ratio_bound
    if of == "signal":
        ratio, error, most = np.asarray(found.swing), np.asarray(found.swing_stderr), found.swing_bound
    known = np.isfinite(ratio) & np.isfinite(error)
    # Where nothing was detected, anything may be.
    ratio, error = np.where(known, ratio, np.nan), np.where(known, error, np.nan)
    bounds = np.where(known, most, np.inf)
    # What is known best, not what is noisiest, says by how much readings move at least.
    sure = np.where(known, np.abs(ratio) - SURE * error, -np.inf)
    best = i, j = np.unravel_index(int(np.argmax(sure)), sure.shape)
    picked = float(ndtri(1 - 0.025 / max(int(known.sum()), 1))) / Z95
    mean, spread = weighted_mean(ratio, error, base)
    swing = found.swing_bound
    return Effect(
        **vars(change),
        how=how,
        change=float(ratio[best]),
        stderr=picked * float(error[best]),
        bound=float(bounds.max()),
        photodiode=f"{base.transfer.leds[i]} {base.transfer.photodiodes[j]}",
        typical=mean,
        typical_stderr=spread,
        modulation_bound=float(np.max(swing)) if np.isfinite(swing).all() else None,
        tolerance=tolerance,
        of=of,
    )


@dataclass(frozen=True)
class Measurement:
    """What is traced beside a scene for an effect, and what makes the effect of its readings and theirs."""

    scenes: tuple[Scene, ...]
    effect: Callable[..., Effect]


def measurements(scene: Scene, tolerance: float) -> list[Measurement]:
    """All effects of a scene; first those that need no trace, then those of its own geometry."""
    assert scene.finger is not None
    out = [Measurement((), from_deep)]
    if scene.board.cover_um:
        why = "it lies on the opaque cover, which no light leaves"
        out.append(Measurement((), lambda _: nothing("decorative nail", why, tolerance)))
    for change in changes_of(scene):
        changed = revised(scene, change.changes)
        if change.same_photons:
            out.append(Measurement((), partial(by_weights, change, tolerance, changed)))
        else:
            out.append(Measurement((changed,), partial(by_trace, change, tolerance)))
    out.append(Measurement((denser(scene),), partial(blood_scattering, tolerance)))
    out.append(Measurement((farthest(scene),), partial(ambient, tolerance)))
    past = Change(f"finger past {scene.finger.length_mm:g} mm", False, "finger without an end")
    out.append(Measurement((most_proximal(scene),), lambda base, back: returning(past, base, base, back)))
    if (cut := shortened(scene)) is not None:
        short = revised(scene, cut.changes)
        out.append(Measurement((short, most_proximal(short)), partial(returning, cut)))
    own = shape_of(scene)
    return sorted(out, key=lambda one: (len(one.scenes) > 0, any(shape_of(other) != own for other in one.scenes)))


def by_trace(change: Change, tolerance: float, base: PairedReadings, other: PairedReadings) -> Effect:
    """What a change does, by a trace with it."""
    return effect_of(change, difference(base, other), base, tolerance=tolerance, how="retraced")


def by_weights(change: Change, tolerance: float, changed: Scene, base: PairedReadings) -> Effect:
    """What a change that only dims light does, by the photons that are there with other weights."""
    found = difference(base, reweighted(base.transfer, changed))
    return effect_of(change, found, base, tolerance=tolerance, how="reweighted")


def blood_scattering(tolerance: float, base: PairedReadings, denser: PairedReadings) -> Effect:
    """What the scattering of the blood that a touch moves would do to the signal; the model's stays as at rest.

    Blood takes the place of dermis. The slope of a reading by the scattering is known for the whole bed; each zone gets
    the part of it that the light's path has there.
    """
    scene = base.transfer.scene
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
        skew = np.abs(each) * both.ratio_skew
    still = np.zeros_like(signal)
    found = Difference(still, still, signal, error, swing_skew=skew)
    text = f"replaces dermis, which scatters {1 / (1 + np.mean(contrast)):.2g} times as much"
    change = Change("blood's own scattering", False, text)
    return effect_of(change, found, base, tolerance=tolerance, of="signal")


def ambient(tolerance: float, base: PairedReadings, swapped: PairedReadings) -> Effect:
    """A lamp's light from all sides on the farthest photodiode through the skin, beside the LED's light there.

    All of it is taken to be absorbed as the LED's light is, which is less than blood does to what is shorter.
    """
    lamp, scene = SOURCES[-1], base.transfer.scene
    diode = scene.photodiodes[0]
    per_mm2 = float(lamp.photocurrent_a_per_mm2(diode)[1].sum())
    escapes, led = swapped.transfer.energy()["reflected"], swapped.transfer.scene.leds[0]
    area_mm2, index = led.size_mm[0] * led.size_mm[1], index_of("epoxy", led.wavelength_nm)
    # Of n photons one more may have left than were counted.
    parts = [escapes["value"], math.hypot(escapes["stderr"], UNDETECTED / swapped.transfer.photons)]
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
    left = tuple(part * one for part, one in zip(base.parts, shallow, strict=True))
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

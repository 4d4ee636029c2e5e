"""What a scene models, what it leaves out, how far each of these moves the readings, and what the scene requires."""

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal, TypeAlias, Unpack

import numpy as np

from ... import tissue
from ...display import Displayed
from ...errors import NotReachedError
from ...light import ProgressCallback, optics
from ...light.identity import light_digest
from ...options import Requested, TraceOptions
from ...scene import Scene, SceneIn, as_scene
from ...sensor import electronics
from ...sensor.ambient import LAMP, trace_ambient
from ...statistics import Z95
from .changes import Change, changes_of, merged, revised
from .paired import (
    Difference,
    Estimates,
    PairedReadings,
    PairedTracer,
    check_study,
    difference,
    end_states,
    reweighted,
    shape_of,
    weighted_mean,
)

# What makes an effect of a scene's readings and those of other scenes, and these, which are traced for it.
Measurement: TypeAlias = tuple[Callable[..., "Effect"], *tuple[Scene, ...]]

DEFAULT_TOLERANCE = 0.02
TOGETHER = "all that is not needed"
# An effect is sure to matter if its change exceeds the tolerance by so many standard errors: by chance alone that
# happens to one of 2000 changes, so that a study of a hundred is right about all of them in 19 of 20 cases.
SURE = 3.5
# The bed scatters so many times as much for the slope of a reading by its scattering.
SCATTERING_FACTOR = 1.4


@dataclass(frozen=True, kw_only=True)
class Effect(Change):
    """A change that was measured: by how much readings move.

    of : "reading" where it may move the reading at rest by more than the tolerance, else "signal", the change by touch.
    change, stderr : change of that, of the reading at rest relative and of the signal as a part of the largest, of the
        photodiode named, which it changes most; the error allows for its selection: its 95 % interval holds
        with Bonferroni's correction for all photodiodes.
    bound : what no photodiode's change exceeds, with 95 % confidence each.
    typical, typical_stderr : change over all photodiodes, weighted by the errors of the scene's readings.
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
    def matters(self) -> Literal["yes", "no", "undecided"]:
        """Whether it moves a reading, or the signal, by more than the tolerance, as far as the traces resolve it."""
        if self.bound <= self.tolerance:
            return "no"
        return "yes" if abs(self.change) - SURE * self.stderr > self.tolerance else "undecided"


@dataclass(frozen=True)
class Explanation(Displayed):
    """All effects and priors of a scene, those that change readings most first; what it requires; its cost.

    together : what leaving out all that is not needed does to the readings; None where all is needed.
    required : the scene with that left out, and with what it leaves out although it matters.
    photons : of each LED in each trace.
    attributes : what makes it again, and `cut_off`, why it ended before all was measured, if it did.
    """

    effects: tuple[Effect, ...]
    together: Effect | None
    required: Scene
    tolerance: float
    photons: int
    backend: str
    wall_seconds: float
    attributes: dict[str, Any] = field(default_factory=dict)

    @property
    def needless(self) -> list[Effect]:
        """Modelled effects that are significantly below the tolerance at every reading."""
        return needless(self.effects)

    @property
    def missing(self) -> list[Effect]:
        """Omitted effects that are significantly above the tolerance."""
        return [e for e in self.effects if not e.modelled and e.matters == "yes"]


def needless(effects: Iterable[Effect]) -> list[Effect]:
    """The modelled effects that are significantly below the tolerance; undecided ones stay."""
    return [e for e in effects if e.modelled and e.matters == "no" and e.changes and not e.unknown]


def explain(
    scene: SceneIn,
    *,
    tolerance: float | None = None,
    progress: ProgressCallback | None = None,
    **requested: Unpack[Requested],
) -> Explanation:
    """Measure what every part and effect of a finger scene, and all unknown of the finger, does to its readings.

    What only dims light, absorbers and line widths, is read from one trace with other weights. Everything else is
    traced with that one thing changed and the same random numbers, so that only photons that meet it make up the
    difference and its error.

    tolerance : relative change of a reading that matters; the scene's relative error if not given, else 2 %.
    photons : of each LED in each trace; or
    relative_error : of the scene's own trace, all others having as many photons; or
    max_seconds : for all traces together, from which the photons follow where they are not given; then it ends with
        what there is. If nothing is requested, about 90.

    Raises: InputError; NotReachedError, whose result is the Explanation as far as it was made, if interrupted or out
        of time.
    """
    scene = as_scene(scene)
    limit = tolerance or scene.accuracy.relative_error or DEFAULT_TOLERANCE
    check_study(scene, limit if tolerance is None else tolerance, "explain", "is modelled as it is written")
    options, start = TraceOptions(**requested), time.perf_counter()
    planned = measurements(scene, limit, options)
    # The scene itself, and what is not needed left out of it.
    tracer = PairedTracer(2 + sum(len(scenes) for _, *scenes in planned), options, progress)
    base = tracer.trace(scene)
    effects: list[Effect] = []
    together, unmet = None, tracer.unmet_reason
    try:
        for effect, *scenes in planned:
            effects.append(effect(base, *map(tracer.trace, scenes)))
        if left := merged(needless(effects)):
            change = Change(TOGETHER, True, "left out", left)
            together = by_change(change, limit, base, tracer.trace(revised(scene, left)))
    except NotReachedError as error:
        unmet = f"{str(error).rstrip('.')}; {len(effects)} effects were measured before."
    effects.sort(key=lambda e: -abs(e.change) if math.isfinite(e.change) else 0.0)
    result = Explanation(
        effects=tuple(effects),
        together=together,
        required=scene,
        tolerance=limit,
        photons=base.transfer.traces[0].photons,
        backend=base.transfer.backend,
        wall_seconds=time.perf_counter() - start,
        attributes=base.transfer.attributes() | ({"cut_off": unmet} if unmet else {}),
    )
    result = replace(result, required=revised(scene, merged([*result.needless, *result.missing])))
    if unmet:
        raise NotReachedError(unmet, result=result)
    return result


def measurements(scene: Scene, tolerance: float, options: TraceOptions) -> list[Measurement]:
    """All effects of a scene; first those that need no trace, then those of its own geometry."""
    out: list[Measurement] = []
    for change in changes_of(scene):
        changed = revised(scene, change.changes)
        same_light = light_digest(changed) == light_digest(scene)
        out.append((partial(by_change, change, tolerance), *([] if same_light else [changed])))
    denser = revised(scene, {"finger": {"bed_scattering": SCATTERING_FACTOR * scene.fingertip.bed_scattering}})
    out.append((partial(blood_scattering, tolerance), denser))
    shape = shape_of(scene)
    planned = sorted(out, key=lambda group: (len(group) > 1, any(shape_of(other) != shape for other in group[1:])))
    # Of light from outside the trace is its own, after all others.
    return [*planned, (partial(ambient, tolerance, options),)]


def effect_of(
    change: Change,
    paired: Difference,
    base: PairedReadings,
    *,
    tolerance: float,
    how: Literal["reweighted", "retraced", "derived"] = "derived",
) -> Effect:
    """An effect from the difference that its change makes; without a modulation where the difference has none.

    An effect significantly below the tolerance at every reading is evaluated by the signal, where that is known.
    """
    from scipy.special import ndtri

    of: Literal["reading", "signal"] = "reading"
    differences = paired.reading
    moves_blood = base.largest_modulation[0] > 0
    if moves_blood and paired.signal is not None and (paired.reading.bound <= tolerance).all():
        of, differences = "signal", paired.signal
    known = np.isfinite(differences.value) & np.isfinite(differences.stderr)
    # Where nothing was detected, anything may be.
    ratio, error = np.where(known, differences.value, np.nan), np.where(known, differences.stderr, np.nan)
    # What is known best, not what is noisiest, says by how much readings move at least.
    sure = np.where(known, np.abs(ratio) - SURE * error, -np.inf)
    best = i, j = np.unravel_index(int(np.argmax(sure)), sure.shape)
    picked = float(ndtri(1 - 0.025 / max(int(known.sum()), 1))) / Z95
    mean, mean_stderr = weighted_mean(differences._replace(value=ratio, stderr=error), base)
    of_signal = math.nan if paired.signal is None else float(paired.signal.bound.max())
    return Effect(
        **vars(change),
        how=how,
        change=float(ratio[best]),
        stderr=picked * float(error[best]),
        bound=float(np.where(known, differences.bound, np.inf).max()),
        photodiode=f"{base.transfer.leds[i]} {base.transfer.photodiodes[j]}",
        typical=mean,
        typical_stderr=mean_stderr,
        modulation_bound=of_signal if math.isfinite(of_signal) else None,
        tolerance=tolerance,
        of=of,
    )


def by_change(change: Change, tolerance: float, base: PairedReadings, *retraced: PairedReadings) -> Effect:
    """What a change does: by a trace with it, or, of what only dims light, by the same photons with other weights."""
    other = retraced[0] if retraced else reweighted(base, revised(base.transfer.scene, change.changes))
    how: Literal["reweighted", "retraced"] = "retraced" if retraced else "reweighted"
    return effect_of(change, difference(base, other), base, tolerance=tolerance, how=how)


def blood_scattering(tolerance: float, base: PairedReadings, denser: PairedReadings) -> Effect:
    """What the scattering of the blood that a touch moves would do to the signal; the model's stays as at rest.

    Blood takes the place of dermis. The slope of a reading by the scattering is known for the whole bed; each zone gets
    the part of it that the light's path has there.
    """
    scene = base.transfer.scene
    reading, factor = difference(base, denser).reading, scene.fingertip.bed_scattering
    moved = np.diff(end_states(scene), axis=0)[0]
    contrast = [tissue.blood_scattering_contrast(led.wavelength_nm, bed_scattering=factor) for led in scene.leds]
    paths = np.stack(
        [
            [np.bincount(trace.photodiode, part[:, 0] * path, minlength=base.level.shape[1]) for path in zones.T]
            for trace, part in zip(base.transfer.traces, base.parts, strict=True)
            for zones in (trace.path_mm[:, optics.bed_columns(scene)],)
        ]
    )
    unit, unit_stderr = base.largest_modulation
    with np.errstate(divide="ignore", invalid="ignore"):
        more = np.array(contrast)[:, None] * np.tensordot(paths, moved, (1, 0)) / paths.sum(1) / unit
        signal = more * np.log1p(reading.value) / np.log(SCATTERING_FACTOR)
        slope = more / (1 + reading.value) / np.log(SCATTERING_FACTOR)
        error = np.hypot(slope * reading.stderr, signal * unit_stderr / unit)
        skew = np.abs(slope) * reading.skew
        covariance = np.outer(slope, slope) * np.asarray(reading.covariance)
        covariance += np.outer(signal, signal) * (unit_stderr / unit) ** 2
    text = f"replaces dermis, which scatters {1 / (1 + np.mean(contrast)):.2g} times as much"
    change, none = (
        Change("blood's own scattering", False, text),
        Estimates(np.zeros_like(signal), np.zeros_like(signal)),
    )
    paired = Difference(none, Estimates(signal, error, skew, covariance))
    return effect_of(change, paired, base, tolerance=tolerance)


def ambient(tolerance: float, options: TraceOptions, base: PairedReadings) -> Effect:
    """The light from outside that the scene names, or else a lamp's, beside the LED's light on each photodiode."""
    scene = base.transfer.scene
    source, diodes = scene.ambient or LAMP, [element.photodiode for element in scene.layout.photodiodes]
    full_a = np.array([electronics.photocurrent_a(1.0, led, diodes) for led in scene.leds])
    outside_a = trace_ambient(scene, [source], options, seed=options.seed)[:2, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio, error = (np.where(base.level > 0, current / (base.level * full_a), np.inf) for current in outside_a)
        # All LEDs' readings of a photodiode have one photocurrent from outside.
        one_photodiode = np.tile(np.eye(len(diodes)), [len(scene.leds)] * 2)
        covariance = np.outer(error, error) * one_photodiode + np.outer(ratio, ratio) * base.relative_covariance
        paired = Difference(Estimates(ratio, np.hypot(error, ratio * base.relative_stderr), 0.0, covariance))
    text = f"{source.words} on all sides; a reading with the LED off takes it away"
    return effect_of(Change("ambient light", scene.ambient is not None, text), paired, base, tolerance=tolerance)

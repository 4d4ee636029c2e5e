"""Scenes traced with the same random numbers, what each reads, and how far one reads from another."""

import math
import time
from dataclasses import dataclass, field, replace

import numpy as np

from ...errors import InputError, NotReachedError, as_far_as_reached
from ...light import ProgressCallback, TraceProgress, Transfer, trace
from ...light.course import course
from ...light.records import LedTrace
from ...light.tracing import INTERRUPTED
from ...options import BackendName, TraceOptions
from ...scene import Scene
from ..blood_states import largest_force_n, steady_blood

PILOT_PHOTONS = 1 << 17
LEAST_PHOTONS = 1 << 14
# Variance of a count of photons that is 0, (3 / Z95)^2: of n photons none seen means, at 95 %, a part below 3 / n.
UNSEEN_VARIANCE = 2.34


@dataclass(frozen=True)
class PairedReadings:
    """What one scene reads, by photons that it may share with other scenes; (led, photodiode) float each.

    level : fraction of the emitted power at rest, weighed by the photodiode's response over the LED's line.
    change : of it at the touch's largest force.
    setup_seconds : before the first photon.
    """

    level: np.ndarray
    level_stderr: np.ndarray
    change: np.ndarray
    change_stderr: np.ndarray
    transfer: Transfer
    setup_seconds: float = 0.0

    @property
    def modulation(self) -> np.ndarray:
        """Change by touch, as a part of the reading at rest; NaN where nothing was seen."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return self.change / self.level

    @property
    def relative_stderr(self) -> np.ndarray:
        """Relative standard error of the level; inf where nothing was seen."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.level > 0, self.level_stderr / self.level, np.inf)


def paired_readings(transfer: Transfer, setup_seconds: float = 0.0) -> PairedReadings:
    """Readings of a trace at rest and at the scene's largest force."""
    found = course(transfer, end_states(transfer.scene), electrons=True)
    values = (found.fraction[..., 0], found.stderr[..., 0], found.change[..., 1], found.change_stderr[..., 1])
    return PairedReadings(*values, transfer, setup_seconds)


def reweighted(base: Transfer, scene: Scene) -> PairedReadings:
    """Readings of a scene that differs from a traced one only in absorption or LED lines: the same photons."""
    return paired_readings(replace(base, scene=scene))


def end_states(scene: Scene) -> np.ndarray:
    """Blood at rest and at the touch's largest force, (2, zones) float."""
    return steady_blood(scene, [0.0, largest_force_n(scene)])


@dataclass
class PairedTracer:
    """Traces several scenes with one seed and as many photons each, so that what they share cancels in a difference.

    scenes : how many traces there will be, for the time that each gets and for the progress.
    options : photons for each LED of every scene; or relative_error for the first scene and max_seconds for all scenes
        together, from which the number follows.
    """

    scenes: int
    options: TraceOptions
    progress: ProgressCallback | None
    _done: int = field(default=0, init=False)
    _start: float = field(default_factory=time.perf_counter, init=False)

    def trace(self, scene: Scene, *, backend: BackendName | None = None) -> PairedReadings:
        """Trace and read a scene; raises NotReachedError if interrupted."""
        # A tolerance in the scene would set each trace's own number of photons.
        scene = scene.model_copy(update={"accuracy": type(scene.accuracy)()})
        if self.options.photons is None:
            self.options = replace(self.options, photons=self._photons_for(scene))
        found = self._traced(scene, backend, self.options.photons)
        self._done += 1
        return found

    def _photons_for(self, scene: Scene) -> int:
        options = self.options
        if options.relative_error is not None:
            share = None if options.max_seconds is None else options.max_seconds / self.scenes
            fields = replace(options, max_seconds=share).fields
            pilot, unmet = as_far_as_reached(trace, scene, progress=self.progress, **fields)
            if unmet and str(unmet).startswith(INTERRUPTED):
                raise NotReachedError(str(unmet))
            return max(led.photons for led in pilot.traces)
        assert options.max_seconds is not None
        readings = self._traced(scene, None, PILOT_PHOTONS)
        left = options.max_seconds - (time.perf_counter() - self._start)
        seconds = left / self.scenes - readings.setup_seconds
        return max(LEAST_PHOTONS, int(PILOT_PHOTONS * seconds / readings.transfer.wall_seconds))

    def _traced(self, scene: Scene, backend: BackendName | None, photons: int | None) -> PairedReadings:
        begin, chosen, seed = time.perf_counter(), backend or self.options.backend, self.options.seed
        try:
            transfer = trace(scene, photons=photons, seed=seed, backend=chosen, progress=self._report_progress)
        except NotReachedError as error:
            # A part of one trace is of no use to those that are compared with it.
            raise NotReachedError(str(error)) from None
        return paired_readings(transfer, max(time.perf_counter() - begin - transfer.wall_seconds, 0.0))

    def _report_progress(self, p: TraceProgress) -> None:
        if self.progress:
            share = (self._done + p.fraction_done) / self.scenes
            name = f"{p.led}, trace {self._done + 1} of {self.scenes}"
            seconds = time.perf_counter() - self._start
            self.progress(replace(p, led=name, fraction_done=min(share, 1.0), seconds=seconds))


@dataclass(frozen=True)
class Difference:
    """How far one scene reads from another, (led, photodiode) float each; NaN and inf where nothing was seen.

    ratio, ratio_stderr : relative change of the reading at rest.
    swing, swing_stderr : change of the modulation, as a part of the largest modulation; NaN where only the readings at
        rest are known.
    """

    ratio: np.ndarray
    ratio_stderr: np.ndarray
    swing: np.ndarray | float = math.nan
    swing_stderr: np.ndarray | float = math.nan


def difference(base: PairedReadings, other: PairedReadings) -> Difference:
    """How far the other scene reads from the base; its noise is that of the photons that are not in both."""
    unit = np.nanmax(np.abs(base.modulation)) if np.isfinite(base.modulation).any() else np.nan
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio, swing = other.level / base.level - 1, (other.modulation - base.modulation) / unit
        if other.transfer.traces is base.transfer.traces:
            # Of the same photons a change is a mean of factors near 1, whose spread is at most about the change itself.
            same = base.relative_stderr
            return Difference(ratio, np.abs(ratio) * same, swing, np.abs(swing) * same)
        gone, come = (paired_readings(part) for part in unshared_photons(base.transfer, other.transfer))
        photons = [np.array([led.photons for led in one.transfer.traces], float)[:, None] for one in (base, other)]
        missed = base.level * base.relative_stderr**2 * photons[0] / photons[1]
        came = np.sqrt(come.level_stderr**2 + UNSEEN_VARIANCE * missed**2)
        kept = np.sqrt(np.maximum(base.level_stderr**2 - gone.level_stderr**2, 0))
        noise = np.sqrt(came**2 + ((1 + ratio) * gone.level_stderr) ** 2 + (ratio * kept) ** 2) / base.level
        # Of a change and the level that divides it the errors are such that most of them cancels: the upper side.
        kept_change = np.sqrt(np.maximum(base.change_stderr**2 - gone.change_stderr**2, 0))
        swing_noise = [
            np.hypot(come.change_stderr, other.modulation * came) / other.level,
            np.hypot(gone.change_stderr, base.modulation * gone.level_stderr) / base.level,
            (1 / other.level - 1 / base.level) * kept_change,
            (other.modulation / other.level - base.modulation / base.level) * kept,
        ]
        return Difference(ratio, noise, swing, np.linalg.norm(swing_noise, axis=0) / unit)


def unshared_photons(one: Transfer, other: Transfer) -> tuple[Transfer, Transfer]:
    """Both traces without the photons they share.

    In scenes that differ in one part, a photon that never meets that part goes the same way and counts the same, bit
    for bit, if both traces have one seed and as many photons. What is left of each makes up their difference, with
    only its own noise; without a common seed that is everything.
    """
    left, right = [], []
    for a, b in zip(one.traces, other.traces, strict=True):
        if (a.photons, a.seeds) == (b.photons, b.seeds):
            keys_a, keys_b = _keys(a), _keys(b)
            a, b = a.only(~np.isin(keys_a, keys_b)), b.only(~np.isin(keys_b, keys_a))
        left.append(a)
        right.append(b)
    return replace(one, traces=tuple(left)), replace(other, traces=tuple(right))


def _keys(trace: LedTrace) -> np.ndarray:
    """All that is known of each photon, as one item of bytes, (n,)."""
    columns = np.column_stack([trace.photodiode, trace.weight, trace.path_mm]).astype(np.float32)
    return np.ascontiguousarray(columns).view(np.dtype((np.void, columns.dtype.itemsize * columns.shape[1]))).ravel()


def error_of_ratio(ratio: np.ndarray, *relative_stderr: np.ndarray) -> np.ndarray:
    """Error of a relative change; few paths that happen to be dim must not pass for a sure small reading."""
    return np.asarray(np.maximum(1 + ratio, 1) * np.hypot(*relative_stderr))


def weighted_mean(values: np.ndarray, error: np.ndarray, base: PairedReadings) -> tuple[float, float]:
    """Mean over the readings and its error, weighed by the reference's errors; NaN and inf where one is unknown.

    The weights are the same for all that is compared with the reference, so that none is drawn to its own low values.
    """
    if not (np.isfinite(values).all() and np.isfinite(error).all()):
        return float("nan"), float("inf")
    weight = base.relative_stderr**-2.0
    weight = weight / weight.sum()
    return float((weight * values).sum()), float(np.linalg.norm(weight * error))


def check_study(scene: Scene, tolerance: float, study: str, why: str) -> None:
    """Raise InputError where a study of a scene's model has nothing to work on."""
    if scene.finger is None:
        raise InputError(f"{study} needs a [finger] scene; a [phantom] {why}.")
    if not 0 < tolerance < 1:
        raise InputError(f"tolerance = {tolerance:g} must lie between 0 and 1.")

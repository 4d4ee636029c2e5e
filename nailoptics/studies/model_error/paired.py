"""Scenes traced with common random numbers: what each reads, and their paired differences."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from ... import checks, geometry
from ...errors import InputError, NotReachedError, as_far_as_reached
from ...hemodynamics.for_scene import steady_blood
from ...hemodynamics.touch import largest_force_n
from ...light import ProgressCallback, TraceProgress, Transfer, optics, trace
from ...light.transfer.records import CHUNK, transmissions
from ...options import TraceOptions
from ...scene import Scene
from ...statistics import MIN_EFFECTIVE_TERMS, covariance_of_sums, jackknife, magnitude_bound_95, quotient

# All traces together take about so long where nothing is requested. [s]
USUAL_SECONDS = 90.0
# Photons of a pilot, which shows what one costs, and the fraction of the time for traces; the rest is a margin.
PILOT_PHOTONS, PLANNED_SHARE = 1 << 15, 0.8
# Standard error of a count of photons that is 0, 3 / Z95: of n photons none detected is, at 95 %, a part below 3 / n.
UNDETECTED = 1.53


@dataclass(frozen=True)
class PairedReadings:
    """What one scene reads, by photons that it may share with other scenes; (led, photodiode) float each.

    parts : per LED (n, 2) float. What each recorded photon adds to the reading at rest and at the largest force,
        fractions of the emitted power, weighted by the photodiode's response over the LED's line.
    setup_seconds : processor time before the first photon, as if nothing of the scene's shape were there before.
    """

    transfer: Transfer
    parts: tuple[np.ndarray, ...]
    setup_seconds: float = 0.0

    def sums(self, column: int, power: int = 1) -> np.ndarray:
        """Sums over the photons of each LED and photodiode, at rest (column 0) or at the largest force (1)."""
        count = len(self.transfer.photodiodes)
        pairs = zip(self.transfer.traces, self.parts, strict=True)
        return np.stack([np.bincount(trace.photodiode, p[:, column] ** power, minlength=count) for trace, p in pairs])

    @cached_property
    def level(self) -> np.ndarray:
        """The reading at rest."""
        return self.sums(0)

    @cached_property
    def modulation(self) -> np.ndarray:
        """Change by touch, as a fraction of the reading at rest; NaN where nothing was detected."""
        return quotient(self.sums(1), self.level) - 1

    @cached_property
    def relative_stderr(self) -> np.ndarray:
        """Relative standard error of the level; inf where fewer than 25 effective photons were detected."""
        photons, square = np.array([trace.photons for trace in self.transfer.traces])[:, None], self.sums(0, 2)
        relative = quotient(np.sqrt(np.maximum(square - self.level**2 / photons, 0)), self.level)
        return np.where(self.level**2 >= MIN_EFFECTIVE_TERMS * square, relative, np.inf)

    @cached_property
    def modulation_stderr(self) -> np.ndarray:
        """Standard error of the modulation; inf where fewer than 25 effective photons were detected."""
        count, spread = len(self.transfer.photodiodes), []
        of_leds = zip(self.transfer.traces, self.parts, self.level, self.modulation, strict=True)
        for recorded, part, level, modulation in of_leds:
            # The modulation is linear in what one photon more or less adds to it.
            added = part[:, 1] - (1 + modulation[recorded.photodiode]) * part[:, 0]
            root = np.sqrt(np.bincount(recorded.photodiode, added**2, minlength=count))
            spread.append(quotient(root, level))
        return np.where(np.isfinite(self.relative_stderr), np.stack(spread), np.inf)

    @cached_property
    def largest_modulation(self) -> tuple[float, float]:
        """Largest change by touch over the reading at rest, and its standard error; NaN if unknown or 0. [1]"""
        if not np.nan_to_num(self.modulation).any():
            return math.nan, math.nan
        largest = int(np.nanargmax(np.abs(self.modulation)))
        return abs(float(self.modulation.flat[largest])), float(self.modulation_stderr.flat[largest])


def paired_readings(transfer: Transfer, setup_seconds: float = 0.0) -> PairedReadings:
    """Readings of a trace at rest and at the scene's largest force."""
    scene, states = transfer.scene, end_states(transfer.scene)
    parts = []
    for recorded, led in zip(transfer.traces, scene.leds, strict=True):
        wavelength, share = optics.detected_spectrum(led, scene.elements)
        mu_a = optics.absorption(scene, wavelength, blood_fraction=states) - recorded.mu_a
        rows = (slice(k, k + CHUNK) for k in range(0, max(len(recorded.weight), 1), CHUNK))
        left = [transmissions(recorded.path_mm[part], mu_a, share[recorded.photodiode[part]]) for part in rows]
        parts.append(np.concatenate(left) * recorded.weight[:, None] / recorded.photons)
    return PairedReadings(transfer, tuple(parts), setup_seconds)


def reweighted(base: PairedReadings, scene: Scene) -> PairedReadings:
    """Readings of a scene that differs from a traced one only in absorption or LED lines: the same photons."""
    return paired_readings(replace(base.transfer, scene=scene), base.setup_seconds)


def end_states(scene: Scene) -> np.ndarray:
    """Blood at rest and at the touch's largest force, (2, zones) float."""
    return steady_blood(scene, [0.0, largest_force_n(scene)])


class PairedTracer:
    """Traces several scenes with one seed and as many photons each, so that what they share cancels in a difference.

    scenes : how many traces there will be, for the time that each gets and for the progress.
    options : photons for each LED of every scene; or relative_error for the first scene, whose photons all others get;
        or the photons follow from the time. After max_seconds no trace begins, and one that runs ends.
    """

    def __init__(self, scenes: int, options: TraceOptions, progress: ProgressCallback | None) -> None:
        self.scenes, self.options, self.progress = scenes, options, progress
        self.unmet_reason: str | None = None
        self._photons: int | None = None
        self._done, self._setup_s, self._start = 0, 0.0, time.perf_counter()

    @property
    def seconds_left(self) -> float:
        """Time until the traces are to end. [s]"""
        return (self.options.max_seconds or math.inf) - (time.perf_counter() - self._start)

    def trace(self, scene: Scene) -> PairedReadings:
        """Trace and read a scene; raises NotReachedError if interrupted or out of time."""
        # A tolerance in the scene would set each trace's own number of photons.
        scene = scene.without_accuracy()
        if self._photons is None:
            self._photons = self._photons_for(scene)
        else:
            self._check_time()
        difference = self._traced(scene, self._photons)
        self._done += 1
        return difference

    def _photons_for(self, scene: Scene) -> int:
        """Photons of each trace, from what is requested and what the first scene's traces take."""
        options = self.options
        if options.photons is not None and options.max_seconds is None:
            return options.photons
        if options.relative_error is not None or options.photons is not None:
            share = None if options.max_seconds is None else self.seconds_left / (self.scenes + 1)
            fields = replace(options, max_seconds=share).fields
            pilot, unmet = as_far_as_reached(trace, scene, with_faces=geometry.AROUND, progress=self.progress, **fields)
            self.unmet_reason = str(unmet) if unmet else None
            if unmet and unmet.interrupted:
                raise NotReachedError(str(unmet), interrupted=True)
            return max(led.photons for led in pilot.traces)
        # The first of two traces compiles; what a photon costs is what it costs from then on.
        each_s = min(self._traced(scene, PILOT_PHOTONS, store=False).transfer.wall_seconds for _ in range(2))
        left_s = (options.max_seconds or USUAL_SECONDS) - (time.perf_counter() - self._start)
        return max(PILOT_PHOTONS, int(PLANNED_SHARE * left_s / self.scenes / each_s * PILOT_PHOTONS))

    def _traced(self, scene: Scene, photons: int, *, store: bool = True) -> PairedReadings:
        cpu, store = time.process_time(), store and self.options.store
        how = replace(self.options, photons=photons, relative_error=None, max_seconds=None, store=store).fields
        try:
            transfer = trace(scene, with_faces=geometry.AROUND, progress=self._report_progress, **how)
        except NotReachedError as error:
            # A part of one trace is of no use to those that are compared with it.
            raise NotReachedError(str(error)) from None
        # What is there from earlier traces, the geometry and the engine, was paid for then.
        self._setup_s = max(self._setup_s, time.process_time() - cpu - transfer.cpu_seconds)
        return paired_readings(transfer, self._setup_s)

    def _check_time(self) -> None:
        if self.seconds_left < 0:
            raise NotReachedError(f"max_seconds ended the study after {self._done} of {self.scenes} traces")

    def _report_progress(self, p: TraceProgress) -> None:
        if self._done and p.fraction_done < 1:
            self._check_time()
        if self.progress:
            share = min((self._done + p.fraction_done) / self.scenes, 1.0)
            spent_s, limit_s = time.perf_counter() - self._start, self.options.max_seconds or math.inf
            name = f"LED {p.led}, trace {self._done + 1} of {self.scenes}"
            p = replace(p, led=name, fraction_done=share, seconds=spent_s, limit_s=limit_s, is_stage=True)
            self.progress(p)


class Estimates(NamedTuple):
    """Values, (led, photodiode) float each, and their standard errors; NaN and inf where too little was detected.

    skew : third moment over the variance: as much as a single photon may carry of a value.
    covariance : (r, r) float. Of all readings; None where their errors are independent.
    """

    value: np.ndarray
    stderr: np.ndarray
    skew: np.ndarray | float = 0.0
    covariance: np.ndarray | None = None

    @staticmethod
    def of_replicates(replicates: np.ndarray) -> "Estimates":
        """From all photons and without each group of them, (1 + groups, led, photodiode) float."""
        moved = (replicates[1:] - replicates[1:].mean(0)).reshape(len(replicates) - 1, -1)
        return Estimates(replicates[0], jackknife(replicates), 0.0, (1 - 1 / len(moved)) * moved.T @ moved)

    @property
    def bound(self) -> np.ndarray:
        """What no value exceeds, with 95 % confidence each."""
        return magnitude_bound_95(self.value, self.stderr, self.skew)


class Difference(NamedTuple):
    """How far one scene reads from another.

    reading : relative change of the reading at rest.
    signal : change of the modulation, as a fraction of the largest modulation; None where that is not known.
    """

    reading: Estimates
    signal: Estimates | None = None


def difference(base: PairedReadings, other: PairedReadings) -> Difference:
    """How far the other scene reads from the base; its noise is that of what each photon adds to the difference.

    To the sums over the photons comes a term for undetected photons: where few carry the difference, one more like
    them, and where none does, one that the difference takes away whole.
    """
    resolved = np.isfinite(base.relative_stderr) & np.isfinite(other.relative_stderr)

    def estimates(of_leds: Sequence[tuple[np.ndarray, ...]], unit: float, unit_stderr: float) -> Estimates:
        values, skews, covariances = zip(*of_leds, strict=True)
        value, skew = np.stack(values) / unit, np.stack(skews) / unit
        covariance = block_diag(*covariances) / unit**2 + np.outer(value, value) * (unit_stderr / unit) ** 2
        stderr = np.sqrt(np.diag(covariance)).reshape(value.shape)
        return Estimates(value, np.where(resolved, stderr, np.inf), skew, covariance)

    reading, swing = zip(*(_by_photodiode(base, other, led) for led in range(len(base.parts))), strict=True)
    with np.errstate(invalid="ignore"):
        return Difference(estimates(reading, 1.0, 0.0), estimates(swing, *base.largest_modulation))


def _by_photodiode(base: PairedReadings, other: PairedReadings, led: int) -> Sequence[tuple[np.ndarray, ...]]:
    """Relative change, and change of the modulation, (p,) float, each with its skew and its covariance (p, p)."""
    photon, photodiode, a, b = _side_by_side(base, other, led)
    count = len(base.transfer.photodiodes)

    def total(values: np.ndarray) -> np.ndarray:
        return np.bincount(photodiode, values, minlength=count)

    with np.errstate(divide="ignore", invalid="ignore"):
        level_a, level_b = total(a[:, 0]), total(b[:, 0])
        gain, swing_a, swing_b = level_b / level_a, total(a[:, 1]) / level_a, total(b[:, 1]) / level_b
        # Ratio and modulation are linear in what one photon more or less adds to them: that makes their errors.
        moved = (b[:, 0] - gain[photodiode] * a[:, 0]) / level_a[photodiode]
        base_change = (a[:, 1] - swing_a[photodiode] * a[:, 0]) / level_a[photodiode]
        swung = (b[:, 1] - swing_b[photodiode] * b[:, 0]) / level_b[photodiode] - base_change
        step, square_a, square_b = np.abs(b[:, 0] - a[:, 0]), total(a[:, 0] ** 2), total(b[:, 0] ** 2)
        carried, met = np.abs(swung) * (step > 0), np.maximum(a[:, 0], b[:, 0]) * (step > 0)
        carriers, taken = (np.nan_to_num(x) for x in (total(step) ** 2 / total(step**2), total(step) / total(met)))
        whole = np.maximum(square_a / level_a, square_b / level_b) * _expected_next_fraction(carriers, taken) / level_a
        # By as much do single photons differ in their modulation.
        scatter = np.sqrt(total(base_change**2)) * level_a / np.sqrt(square_a)
        undetected = np.fmax(whole, total(step**2) / total(step) / level_a)
        undetected_swing = np.fmax(whole * scatter, total(carried**2) / total(carried))
        out = []
        for value, change, one_more in ((gain - 1, moved, undetected), (swing_b - swing_a, swung, undetected_swing)):
            covariance = covariance_of_sums(photon, photodiode, change, count)
            skew = np.nan_to_num(total(change**3) / np.diag(covariance))
            out.append((value, skew, covariance + np.diag((UNDETECTED * one_more) ** 2)))
        return out


def _expected_next_fraction(carriers: np.ndarray, taken: np.ndarray) -> np.ndarray:
    """The fraction of one more photon that a difference is likely to take away.

    Optical depths of paths fall off exponentially. After so many of mean depth t, the next is deeper than T with the
    probability (1 + T / sum t)^-carriers; this is its mean, what is deeper than 1 taken for 1: 1 where no photon
    carried the difference, t where many did.

    carriers : effective number of the photons that carry the difference.
    taken : the fraction of them that it takes away.
    """
    total = np.maximum(carriers * taken, 1e-300)
    # At a power of one the integral is a logarithm, which is as near as rounding allows.
    power = np.where(np.abs(1 - carriers) < 1e-6, 1e-6, 1 - carriers)
    with np.errstate(over="ignore", invalid="ignore"):
        mean = total / power * np.expm1(power * np.log1p(1 / total))
    return np.asarray(np.where(carriers * taken > 0, np.minimum(mean, 1), 1.0))


def _side_by_side(base: PairedReadings, other: PairedReadings, led: int) -> tuple[np.ndarray, ...]:
    """Photons and photodiodes, (n,) int each, and what the one adds to the other in both scenes, (n, 2) float each. A
    photon of one seed has the same random numbers in both scenes, and goes the same way up to where they differ; those
    of two seeds are independent, whichever stand side by side."""
    first, second = base.transfer.traces[led], other.transfer.traces[led]
    a, b = base.parts[led], other.parts[led]
    if first is second:
        return first.photon, first.photodiode, a, b
    count = len(base.transfer.photodiodes)
    keys = [t.photon.astype(np.int64) * count + t.photodiode for t in (first, second)]
    every, at = np.unique(np.concatenate(keys), return_inverse=True)
    both = np.zeros((2, len(every), 2))
    both[0, at[: len(a)]], both[1, at[len(a) :]] = a, b
    return every // count, every % count, *both


def weighted_mean(estimates: Estimates, base: PairedReadings) -> tuple[float, float]:
    """Mean over the readings and its error, weighted by the reference's errors; NaN and inf where one is unknown. The
    weights are the same for all that is compared with the reference, so that none is drawn to its own low values."""
    weight = base.relative_stderr.ravel() ** -2.0
    if not (np.isfinite(estimates.value).all() and np.isfinite(estimates.stderr).all() and weight.any()):
        return float("nan"), float("inf")
    weight = weight / weight.sum()
    covariance = np.diag(estimates.stderr.ravel() ** 2) if estimates.covariance is None else estimates.covariance
    return float(weight @ estimates.value.ravel()), float(np.sqrt(weight @ covariance @ weight))


def check_study(scene: Scene, tolerance: float, study: str, why: str) -> None:
    """Raise InputError where a study of a scene's model has nothing to work on."""
    if scene.finger is None:
        raise InputError(f"{study} needs a [finger] scene; a [phantom] {why}.")
    checks.tolerance("tolerance", tolerance)

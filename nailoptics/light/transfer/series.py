"""One trace read in many states: over a course of the blood, by interpolation between a few of them, and with and
without each group of its photons."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.chebyshev import chebpts1, chebvander
from numpy.typing import ArrayLike

from ... import checks
from ...checks import Array
from ...errors import InputError
from ...scene import Scene
from ...statistics import leave_one_out, quotient, stderr_of_mean
from .. import optics
from .records import CHUNK, attenuation, transmissions
from .transfer import Transfer

# Interpolation may be off by this fraction of a reading; no trace has a standard error near it.
INTERPOLATION_ERROR = 1e-7
# States that need more nodes than this are halved, and each half is read by itself.
NODES_AT_ONCE = 64
# States interpolated at once: their weights on the nodes fill the cache, not the memory.
STATES_AT_ONCE = 1 << 13
# Groups of photons that are left out in turn.
GROUPS = 40


@dataclass(frozen=True)
class ReadingSeries:
    """Readings over many states, (led, photodiode, state) float each, fractions of the emitted power.

    fraction, stderr : detected fraction and its standard error.
    change, change_stderr : difference from the first state; both share their noise, so that its error is small.
    """

    fraction: np.ndarray
    stderr: np.ndarray
    change: np.ndarray
    change_stderr: np.ndarray


def readings_over_states(transfer: Transfer, blood_fraction: np.ndarray) -> ReadingSeries:
    """Readings over a course of blood states; a press of ten thousand steps takes about as long as one of a hundred.

    An LED's line is weighed by the photodiode's responsivity over its mean along the line. Readings are smooth in
    the blood: they are taken at Chebyshev nodes over the range of states, as many as keep the error of interpolation
    below 1e-7 of a reading for all but the longest paths, and interpolated.

    blood_fraction : (t, K) float in 0-1. Blood of each zone in each state; of single precision, readings are, too.

    Warns: ReweightWarning where fewer than 400 effective photons stand behind a reading of some state, or where, in one
    that is brighter than the traced state, a few long paths outweigh all others.
    """
    states = np.asarray(blood_fraction)
    states = states if states.dtype == np.float32 else states.astype(float, copy=False)
    count, blood = transfer.scene.zone_count, transfer.scene.blood
    if states.ndim != 2 or states.shape[1] != count or not len(states):
        raise InputError(f"blood_fraction has shape {states.shape}; give (states, {count}), one value for each zone.")
    course = _Course(transfer, states)
    # Absorption bends where venous blood begins to pool: between nodes on one side of that it is smooth.
    pooling = 1.0 if blood.venous_so2 is None else blood.rest_blood_fraction
    sides, side = np.unique(states > pooling, axis=0, return_inverse=True)
    for k in range(len(sides)):
        course.read(np.flatnonzero(side == k))
    fraction, stderr, _, _ = course.out
    # Of n equal photons the relative error is 1 / sqrt(n).
    effective = np.nan_to_num(np.square(quotient(fraction, stderr)), nan=np.inf).min(-1)
    # Where there is least blood, single long paths weigh most.
    transfer.warn_of_unreliable_weights(effective, transfer.moments_at(np.min(blood_fraction, 0)))
    return ReadingSeries(*course.out)


class _Course:
    """States to read, (t, K), and `out`, what was read in them: the four arrays of a `ReadingSeries`."""

    def __init__(self, transfer: Transfer, states: np.ndarray) -> None:
        self.transfer, self.states = transfer, states
        cure = f"choose from 0 to 1, or lower blood.rest_blood_fraction = {transfer.scene.blood.rest_blood_fraction:g}"
        self.first = checks.fraction("blood_fraction", states, cure)[0]
        self.out = np.empty((4, len(transfer.traces), len(transfer.photodiodes), len(states)), states.dtype)

    def sums(self, states: np.ndarray, line: tuple[np.ndarray, np.ndarray] | None = None) -> np.ndarray:
        """The four arrays in other states, from the photons; line : two states on the line through which absorption
        lies, for states beyond what blood can be."""
        count = len(self.transfer.photodiodes)
        out = np.zeros((4, len(self.transfer.traces), count, len(states)))
        for i, (trace, led) in enumerate(zip(self.transfer.traces, self.transfer.scene.leds, strict=True)):
            wavelength, share = optics.detected_spectrum(led, self.transfer.scene.elements)
            mu_a = _absorption(self.transfer.scene, wavelength, np.vstack([self.first, states]), line) - trace.mu_a
            sums = np.zeros((4, count, len(states)))
            order = np.argsort(trace.photodiode, kind="stable")
            edges = np.searchsorted(trace.photodiode[order], np.arange(count + 1))
            for j, start in [(p, at) for p in range(count) for at in range(edges[p], edges[p + 1], CHUNK)]:
                chunk = order[start : min(start + CHUNK, edges[j + 1])]
                weight = transmissions(trace.path_mm[chunk], mu_a, share[j]) * trace.weight[chunk, None]
                weight, change = weight[:, 1:], weight[:, 1:] - weight[:, :1]
                for total, values in zip(sums, (weight, weight**2, change, change**2), strict=True):
                    total[j] += values.sum(0)
            out[::2, i] = sums[::2] / trace.photons
            out[1::2, i] = stderr_of_mean(sums[::2], sums[1::2], trace.photons)
        return out

    def read(self, which: np.ndarray) -> None:
        """Read those states, by their numbers (n,), between which absorption is linear in the blood."""
        states = self.states[which].astype(float)
        low, high = states.min(0), states.max(0)
        if not (high - low > 1e-12).any():
            self.out[..., which] = self.sums(states[:1])
            return
        # Principal directions of the states, in columns, the widest first: a touch moves all zones along few of them.
        centre = states.sum(0) / len(which)
        directions = np.linalg.eigh((states - centre).T @ (states - centre))[1][:, ::-1]
        along = (states - centre) @ directions
        nearest, farthest = along.min(0), along.max(0)
        spans = farthest - nearest
        counts = [_nodes_needed(self.transfer, *direction) for direction in zip(directions.T, spans, strict=True)]
        if min(len(which), math.prod(counts)) > NODES_AT_ONCE:
            # Half of them lie in far fewer directions: a short piece of a course is nearly straight.
            upper = along[:, 0] > nearest[0] + spans[0] / 2
            self.read(which[~upper])
            self.read(which[upper])
        elif len(which) <= math.prod(counts):
            self.out[..., which] = self.sums(states)
        else:
            box = ChebyshevBox(nearest, farthest, counts)
            # What is interpolated of an error is its square.
            nodes = self.sums(centre + box.nodes @ directions.T, (low, high))
            nodes[1::2] **= 2
            for start in range(0, len(which), STATES_AT_ONCE):
                part = slice(start, start + STATES_AT_ONCE)
                values = nodes @ box.weights(along[part]).T
                values[1::2] = np.sqrt(np.maximum(values[1::2], 0))
                self.out[..., which[part]] = values


@dataclass(frozen=True)
class ChebyshevBox:
    """Chebyshev nodes over a box, so many in each direction, and the weights that interpolate between them.

    Reference: Trefethen 2013, Approximation Theory and Approximation Practice, ch. 3-4.

    low, high : (d,) float. Ends of the box.
    counts : (d,) int. Nodes in each direction; of one alone the value is the same all along it.
    """

    low: Sequence[float] | Array
    high: Sequence[float] | Array
    counts: Sequence[int]

    @property
    def axes(self) -> list[Array]:
        """The nodes along each direction, rising, (n,) float each."""
        middle, half = (np.add(self.high, self.low) / 2, np.subtract(self.high, self.low) / 2)
        return [m + h * chebpts1(n) for m, h, n in zip(middle, half, self.counts, strict=True)]

    @property
    def nodes(self) -> Array:
        """All nodes, (m, d) float; along the last direction they follow each other."""
        return np.stack([grid.ravel() for grid in np.meshgrid(*self.axes, indexing="ij")], -1).reshape(
            -1, len(self.counts)
        )

    def weights(self, places: ArrayLike) -> Array:
        """What each node's value counts for at places in the box, (t, d) or, of one direction, (t,): (t, m) float."""
        places = np.asarray(places, float).reshape(-1, len(self.counts))
        weights = np.ones((len(places), 1))
        for column, n, low, high in zip(places.T, self.counts, self.low, self.high, strict=True):
            # Of one node, which lies at 0, the place does not matter.
            x = (2 * column - low - high) / (high - low if n > 1 else np.inf)
            share = chebvander(x, n - 1) @ np.linalg.inv(chebvander(chebpts1(n), n - 1))
            weights = (weights[:, :, None] * share[:, None, :]).reshape(len(places), -1)
        return weights


def _nodes_needed(transfer: Transfer, direction: np.ndarray, span: float) -> int:
    """Chebyshev nodes that interpolate exp(-x) over the optical depths that a range of blood in a direction spans, (K,)
    float, the change of each zone's blood in one step; `span` is their number."""
    depth, columns = 0.0, list(optics.bed_columns(transfer.scene))
    no_and_all = np.repeat([[0.0], [1.0]], transfer.scene.zone_count, 1)
    for trace, led in zip(transfer.traces, transfer.scene.leds, strict=True):
        if len(trace.weight):
            mu_a = optics.absorption(transfer.scene, led.wavelength_nm, blood_fraction=no_and_all)
            slope = float(mu_a[1, 0, columns[0]] - mu_a[0, 0, columns[0]])
            path = np.abs(trace.path_mm[:: 1 + len(trace.weight) // CHUNK, columns] @ direction)
            depth = max(depth, slope * span * float(np.quantile(path, 0.999)))
    # The error of n nodes on exp over a range of depth d is (d / 4)^n 2 / n!; squares double the depth.
    count, error = 0, math.inf
    while error > INTERPOLATION_ERROR and count < 24:
        count += 1
        error = 2 * (depth / 2) ** count / math.factorial(count)
    return count


def _absorption(
    scene: Scene, wavelength: np.ndarray, states: np.ndarray, line: tuple[np.ndarray, np.ndarray] | None
) -> np.ndarray:
    """Absorption in a first state and in others, those on the line through two states if such are given."""
    if line is None:
        return optics.absorption(scene, wavelength, blood_fraction=states)
    mu_a = optics.absorption(scene, wavelength, blood_fraction=np.vstack([states[:1], *line]))
    (low, high), beds = line, list(optics.bed_columns(scene))
    part = (states[1:] - low) / np.where(high > low, high - low, 1.0)
    out = np.concatenate([mu_a[:1], np.repeat(mu_a[1:2], len(part), 0)])
    out[1:, :, beds] += part[:, None, :] * (mu_a[2] - mu_a[1])[:, beds]
    return out


def read_by_groups(transfer: Transfer, scene: Scene, states: np.ndarray, so2: np.ndarray | None = None) -> np.ndarray:
    """Readings of a scene in states (t, zones) by a trace that gives them, (1 + groups, led, photodiode, t) float.

    so2 : (t, zones) float, where the blood's oxygen is balanced.
    """
    by_led = []
    for i, led in enumerate(transfer.scene.leds):
        blood = states if so2 is None else optics.equivalent_blood(scene, led, states, so2)
        mu_a = optics.absorption(scene, optics.spectrum(led)[0], blood_fraction=blood)
        by_led.append(read_replicates(transfer, i, mu_a, paths=False)[0])
    return np.stack(by_led, 1)


def read_replicates(
    transfer: Transfer, led: int, mu_a: np.ndarray, blood_per_mm: np.ndarray | None = None, *, paths: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """Read one LED's trace in many states: in replicate 0 by all photons, in each other without one group of them.

    All records of a photon are in one group, so that what is made of several readings has its true error, too.

    mu_a : (states, q, absorbers) float. Absorption over the LED's line, `optics.spectrum`. [mm^-1]
    blood_per_mm : (q,) float. Absorption of the blood over the line, in the first state; even if not given. [mm^-1]
    paths : whether to have the mean paths, too, which are half of the work; else of no zone.

    Returns: (1 + groups, photodiodes, states) float, fractions of the emitted power, weighted by the photodiode's
    responsivity over its mean along the line; and (1 + groups, photodiodes, zones) float, the mean paths in the first
    state: minus the derivative of ln reading by the absorption of each zone's blood, averaged over the line. [mm]
    """
    trace, source = transfer.traces[led], transfer.scene.leds[led]
    wavelength, share = optics.detected_spectrum(source, transfer.scene.elements)
    blood_per_mm = np.ones(len(wavelength)) if blood_per_mm is None else blood_per_mm
    relative = blood_per_mm * (share.sum(1) / (share @ blood_per_mm))[:, None]
    zones, count = list(optics.bed_columns(transfer.scene)) if paths else [], len(transfer.photodiodes)
    sums = np.zeros((len(mu_a) + len(zones), count * GROUPS))
    # As many at once as there are sums, or more: adding these up takes no longer than the records.
    step = max(CHUNK, count * GROUPS)
    for start in range(0, len(trace.weight), step):
        chunk = slice(start, start + step)
        lengths = trace.path_mm[chunk].astype(float)
        weights, slope = np.zeros((len(mu_a), len(lengths))), np.zeros(len(lengths))
        at = trace.photodiode[chunk].astype(int)
        for q, part in enumerate(share.T):
            part_weight = part[at] * attenuation(mu_a[:, q] - trace.mu_a, lengths) * trace.weight[chunk]
            weights += part_weight
            slope += part_weight[0] * relative[at, q]
        group = at * GROUPS + trace.photon[chunk] % GROUPS
        for total, row in zip(sums, (*weights, *(slope * lengths[:, zones].T)), strict=True):
            total += np.bincount(group, row, minlength=count * GROUPS)
    read = leave_one_out(sums.reshape(len(sums), count, GROUPS).T * (GROUPS / trace.photons))
    total = read[..., : len(mu_a)]
    return total, quotient(read[..., len(mu_a) :], total[..., :1])

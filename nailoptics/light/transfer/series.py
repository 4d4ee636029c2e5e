"""One trace read in many states: over a course of the blood, and with and without each group of its photons."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ... import checks
from ...errors import InputError
from ...statistics import left_out, stderr_of_mean
from .. import optics
from .interpolation import ChebyshevBox
from .moments import slope_of
from .reweight import attenuation, transmissions
from .transfer import Transfer

# Interpolation may be off by this part of a reading; no trace has a standard error near it.
INTERPOLATION_ERROR = 1e-7
# States that need more nodes than this are halved, and each half is read by itself.
NODES_AT_ONCE = 64
# States interpolated at once: their weights on the nodes fill the cache, not the memory.
STATES_AT_ONCE = 1 << 13
# Photons read at once: their weights at all nodes fill the processor's cache, not the memory.
CHUNK = 4096
# Groups of photons that are left out in turn.
GROUPS = 40
# Photons read at once in groups; with a few hundred states their weights fill the processor's cache, not the memory.
GROUP_CHUNK = 8192


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


def readings_over_states(
    transfer: Transfer, blood_fraction: np.ndarray, *, so2: float | None = None, weight_by_responsivity: bool = False
) -> ReadingSeries:
    """Readings over a course of blood states; a press of ten thousand steps takes about as long as one of a hundred.

    Readings are smooth in the blood: they are taken at Chebyshev nodes over the range of states, as many as keep the
    error of interpolation below 1e-7 of a reading for all but the longest paths, and interpolated.

    blood_fraction : (t, K) float in 0-1. Blood of each zone in each state; of single precision, readings are, too.
    weight_by_responsivity : weigh the LED's line by the photodiode's response, relative to that at the peak wavelength.

    Warns: ReweightWarning where fewer than 400 effective photons stand behind a reading of some state, or fewer than 25
    behind the standard error of one that is brighter than the traced state.
    """
    found = _readings(transfer, blood_fraction, so2, weight_by_responsivity)
    effective = np.empty(found.fraction.shape[:2])
    with np.errstate(invalid="ignore", divide="ignore"):
        # Of n equal photons the relative error is 1 / sqrt(n).
        for pair in np.ndindex(*effective.shape):
            each = np.square(found.fraction[pair] / found.stderr[pair])
            effective[pair] = np.nan_to_num(each, nan=np.inf).min()
    # Where there is least blood, single long paths weigh most.
    least_absorbing = transfer.moments_at(np.min(blood_fraction, 0), so2)
    transfer.warn_if_thin(effective, least_absorbing)
    return found


def _readings(
    transfer: Transfer, blood_fraction: np.ndarray, so2: float | None, weight_by_responsivity: bool
) -> ReadingSeries:
    states = np.asarray(blood_fraction)
    states = states if states.dtype == np.float32 else states.astype(float, copy=False)
    count = optics.zones(transfer.scene).count
    if states.ndim != 2 or states.shape[1] != count or not len(states):
        raise InputError(f"blood_fraction has shape {states.shape}; give (states, {count}), one value for each zone.")
    blood, first = transfer.scene.blood, checks.fraction("blood_fraction", states)[0].copy()
    shape = (len(transfer.traces), len(transfer.photodiodes), len(states))
    reading = _Reading(
        transfer, states, first, so2, weight_by_responsivity, [np.empty(shape, states.dtype) for _ in range(4)]
    )
    if so2 is not None or blood.venous_so2 is None:
        _read(reading, np.arange(len(states)))
        return ReadingSeries(*reading.out)
    # Absorption bends where blood begins to pool: between nodes on one side of that it is smooth.
    sides, side = np.unique(states > blood.rest_blood_fraction, axis=0, return_inverse=True)
    for k in range(len(sides)):
        _read(reading, np.flatnonzero(side == k))
    return ReadingSeries(*reading.out)


@dataclass(frozen=True)
class _Reading:
    """States to read, (t, K), the first one, from which changes count, and the arrays of a `ReadingSeries`."""

    transfer: Transfer
    states: np.ndarray
    first: np.ndarray
    so2: float | None
    weight_by_responsivity: bool
    out: list[np.ndarray]

    def sums(self, states: np.ndarray, line: tuple[np.ndarray, np.ndarray] | None = None) -> tuple[np.ndarray, ...]:
        """The four arrays in other states, from the photons."""
        return _sums(self.transfer, states, self.first, self.so2, self.weight_by_responsivity, line=line)

    def blocks(self, which: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Some of the states, as many at once as leave the memory alone: their numbers and themselves."""
        for start in range(0, len(which), STATES_AT_ONCE):
            part = which[start : start + STATES_AT_ONCE]
            yield part, self.states[part].astype(float, copy=False)

    def put(self, part: np.ndarray, values: Sequence[np.ndarray]) -> None:
        """Keep what was read in some of the states."""
        for whole, value in zip(self.out, values, strict=True):
            whole[..., part] = value


def _read(reading: _Reading, which: np.ndarray) -> None:
    """Read those states, by their numbers (n,), between which absorption is linear in the blood."""
    ends = np.array([(block.min(0), block.max(0)) for _, block in reading.blocks(which)])
    low, high = ends[:, 0].min(0), ends[:, 1].max(0)
    if not (high - low > 1e-12).any():
        reading.put(which, reading.sums(reading.states[which[:1]].astype(float)))
        return
    centre, directions = _principal(reading, which)
    places = np.array([(at.min(0), at.max(0)) for at in _places(reading, which, centre, directions)])
    nearest, farthest = places[:, 0].min(0), places[:, 1].max(0)
    spans = farthest - nearest
    counts = [_nodes_needed(reading.transfer, *each, reading.so2) for each in zip(directions.T, spans, strict=True)]
    if min(len(which), math.prod(counts)) > NODES_AT_ONCE:
        # Half of them lie in far fewer directions: a short piece of a course is nearly straight.
        middle = nearest[0] + spans[0] / 2
        upper = np.concatenate([at[:, 0] > middle for at in _places(reading, which, centre, directions)])
        for half in (which[~upper], which[upper]):
            _read(reading, half)
        return
    if len(which) <= math.prod(counts):
        reading.put(which, reading.sums(reading.states[which].astype(float)))
        return
    box = ChebyshevBox(nearest, farthest, counts)
    fraction, stderr, change, change_stderr = reading.sums(centre + box.nodes @ directions.T, (low, high))
    of_nodes = fraction, stderr**2, change, change_stderr**2
    for part, block in reading.blocks(which):
        weights = box.weights((block - centre) @ directions).T
        values = [one @ weights for one in of_nodes]
        reading.put(part, [np.sqrt(np.maximum(one, 0)) if k % 2 else one for k, one in enumerate(values)])


def _places(reading: _Reading, which: np.ndarray, centre: np.ndarray, directions: np.ndarray) -> Iterator[np.ndarray]:
    """Where states lie along directions, block by block, (n, d) float each."""
    for _, block in reading.blocks(which):
        yield (block - centre) @ directions


def _principal(reading: _Reading, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The mean of states and orthonormal directions along which they spread, the widest first, in columns (K, K): a
    touch moves all zones along few of them."""
    centre = sum(block.sum(0) for _, block in reading.blocks(which)) / len(which)
    spread = sum((block - centre).T @ (block - centre) for _, block in reading.blocks(which))
    return centre, np.asarray(np.linalg.eigh(spread)[1][:, ::-1])


def _nodes_needed(transfer: Transfer, direction: np.ndarray, span: float, so2: float | None) -> int:
    """Chebyshev nodes that interpolate exp(-x) over the optical depths that a range of blood in a direction spans.

    direction : (K,) float. Change of each zone's blood in one step; `span` is their number.
    """
    depth, columns = 0.0, list(optics.bed_columns(transfer.scene))
    no_and_all = np.repeat([[0.0], [1.0]], optics.zones(transfer.scene).count, 1)
    for trace, led in zip(transfer.traces, transfer.scene.leds, strict=True):
        if len(trace.weight):
            mu_a = optics.absorption(transfer.scene, led.wavelength_nm, blood_fraction=no_and_all, so2=so2)
            slope = float(mu_a[1, 0, columns[0]] - mu_a[0, 0, columns[0]])
            path = np.abs(trace.path_mm[:: 1 + len(trace.weight) // CHUNK, columns] @ direction)
            depth = max(depth, slope * span * float(np.quantile(path, 0.999)))
    # The error of n nodes on exp over a range of depth d is (d / 4)^n 2 / n!; squares double the depth.
    count, error = 0, math.inf
    while error > INTERPOLATION_ERROR and count < 24:
        count += 1
        error = 2 * (depth / 2) ** count / math.factorial(count)
    return count


def _sums(
    transfer: Transfer,
    states: np.ndarray,
    first: np.ndarray,
    so2: float | None,
    weight_by_responsivity: bool,
    *,
    line: tuple[np.ndarray, np.ndarray] | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Fraction, its error, change from a first state and its error, (led, photodiode, states) each.

    line : two states on the line through which absorption lies, for states beyond what blood can be.
    """
    shape = (len(transfer.traces), len(transfer.photodiodes), len(states))
    out = tuple(np.zeros(shape) for _ in range(4))
    for i, (trace, led) in enumerate(zip(transfer.traces, transfer.scene.leds, strict=True)):
        wavelength, share = optics.spectrum(led)
        if weight_by_responsivity:
            share = share * wavelength / led.wavelength_nm
        mu_a = _absorption(transfer, wavelength, np.vstack([first, states]), so2, line) - trace.mu_a
        sums, full = np.zeros((4, *shape[1:])), trace.full
        # Of a sample of the photons: sums at rest and of their products with the values, to hold them against all.
        rest, rest_square, products = np.zeros(shape[1]), np.zeros(shape[1]), np.zeros((2, *shape[1:]))
        at_rest = trace.weight_at_rest if full is not None else None
        order = np.argsort(trace.photodiode, kind="stable")
        edges = np.searchsorted(trace.photodiode[order], np.arange(shape[1] + 1))
        pieces = [(p, at) for p in range(shape[1]) for at in range(edges[p], edges[p + 1], CHUNK)]
        for j, start in pieces:
            chunk = order[start : min(start + CHUNK, edges[j + 1])]
            weight = transmissions(trace.path_mm[chunk], mu_a, share) * trace.weight[chunk, None]
            change = weight[:, 1:] - weight[:, :1]
            weight = weight[:, 1:]
            for total, values in zip(sums, (weight, weight**2, change, change**2), strict=True):
                total[j] += values.sum(0)
            if at_rest is not None:
                own = at_rest[chunk]
                rest[j] += own.sum()
                rest_square[j] += own @ own
                products[0, j] += own @ weight
                products[1, j] += own @ change
        for k, unseen in ((0, 1.0), (2, 0.0)):
            total, square = sums[k], sums[k + 1]
            if full is not None:
                slope = slope_of(products[k // 2], rest_square[:, None], unseen)
                total = slope * full.weight[:, None] + (total - slope * rest[:, None])
                left = np.maximum(square - slope * products[k // 2], 0)
                square = slope**2 * full.square[:, None] + left
            out[k][i] = total / trace.photons
            out[k + 1][i] = stderr_of_mean(total, square, trace.photons)
    return out  # type: ignore[return-value]


def _absorption(
    transfer: Transfer,
    wavelength: np.ndarray,
    states: np.ndarray,
    so2: float | None,
    line: tuple[np.ndarray, np.ndarray] | None,
) -> np.ndarray:
    """Absorption in a first state and in others, those on the line through two states if such are given."""
    if line is None:
        return optics.absorption(transfer.scene, wavelength, blood_fraction=states, so2=so2)
    mu_a = optics.absorption(transfer.scene, wavelength, blood_fraction=np.vstack([states[:1], *line]), so2=so2)
    (low, high), beds = line, list(optics.bed_columns(transfer.scene))
    part = (states[1:] - low) / np.where(high > low, high - low, 1.0)
    out = np.concatenate([mu_a[:1], np.repeat(mu_a[1:2], len(part), 0)])
    out[1:, :, beds] += part[:, None, :] * (mu_a[2] - mu_a[1])[:, beds]
    return out


@dataclass(frozen=True)
class Replicates:
    """One LED's readings in many states; in replicate 0 by all photons, in each other without one group of them.

    reading : (1 + groups, photodiodes, states) float. Fraction of the emitted power, weighed by the photodiode's
        response relative to that at the LED's peak.
    mean_path_mm : (1 + groups, photodiodes, zones) float. In the first state, minus the derivative of ln reading by the
        absorption of the blood in each zone, averaged over the line: the mean path there. [mm]
    """

    reading: np.ndarray
    mean_path_mm: np.ndarray


def read_replicates(
    transfer: Transfer, led: int, mu_a: np.ndarray, blood_per_mm: np.ndarray, *, seed: int
) -> Replicates:
    """Read one LED's trace in many states, with and without each group of its photons.

    mu_a : (states, q, absorbers) float. Absorption over the LED's line, `optics.spectrum`. [mm^-1]
    blood_per_mm : (q,) float. Absorption of the blood over the line, in the first state. [mm^-1]
    seed : of the photons' groups.
    """
    trace, source = transfer.traces[led], transfer.scene.leds[led]
    wavelength, share = optics.spectrum(source)
    share = share * wavelength / source.wavelength_nm
    mean = float(share @ blood_per_mm / share.sum())
    zones = list(optics.bed_columns(transfer.scene))
    count = len(transfer.photodiodes)
    weight = np.zeros((count, GROUPS, len(mu_a)))
    path = np.zeros((count, GROUPS, len(zones)))
    groups = np.random.default_rng(seed).integers(GROUPS, size=len(trace.weight))
    for j in range(count):
        mine = np.flatnonzero(trace.photodiode == j)
        for start in range(0, len(mine), GROUP_CHUNK):
            chunk = mine[start : start + GROUP_CHUNK]
            lengths = trace.path_mm[chunk].astype(float)
            own, slope = np.zeros((len(chunk), len(mu_a))), np.zeros(len(chunk))
            for q, part in enumerate(share):
                seen = part * attenuation(lengths, mu_a[:, q] - trace.mu_a) * trace.weight[chunk, None]
                own += seen
                slope += seen[:, 0] * blood_per_mm[q] / mean
            weight[j] += _by_group(groups[chunk], own)
            path[j] += _by_group(groups[chunk], slope[:, None] * lengths[:, zones])
    total, by_path = (left_out(np.moveaxis(sums, 1, 0) * (GROUPS / trace.photons)) for sums in (weight, path))
    with np.errstate(invalid="ignore", divide="ignore"):
        return Replicates(reading=total, mean_path_mm=by_path / total[:, :, :1])


def _by_group(groups: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Sums of values (n, k) over each group, (GROUPS, k) float."""
    return np.stack([np.bincount(groups, column, minlength=GROUPS) for column in values.T], -1)

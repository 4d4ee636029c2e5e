"""What one LED's photons leave behind, batch by batch and as one, and sums over them by photodiode at one state."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ... import statistics
from ...io import CorruptError

# What is recorded of a photon for each photodiode that it, or a copy of it, reached.
COLUMNS = ("photon", "photodiode", "weight", "path_mm")
# Sums over all photons, of weights and of their squares, by name.
SUMS = ("energy", "absorbed")
# Where light may go.
ENERGY = ("reflected", "transmitted", "absorbed", "lost")
# Photons read at once: their weights in all states fill the processor's cache, not the memory.
CHUNK = 4096
# Photons of a full batch: enough to keep a processor's lanes busy; a graphics card's need a phantom's in a finger, too.
FINGER_BATCH_PHOTONS, PHANTOM_BATCH_PHOTONS = 1 << 17, 1 << 19


def check_arrays(arrays: Mapping[str, np.ndarray], shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Raise CorruptError unless each array is there, finite and of its shape."""
    for name, shape in shapes.items():
        if arrays[name].shape != shape or not np.isfinite(arrays[name]).all():
            raise CorruptError(f"{name} is not finite, or of shape {arrays[name].shape} in place of {shape}")


def attenuation(path_mm: np.ndarray, mu_a: np.ndarray) -> np.ndarray:
    """Beer-Lambert factor that reweights each photon to other states, (n,) or (n, m) float; of both swapped, (m, n).

    path_mm : (n, r) float. Path in each absorber. [mm]
    mu_a : (r,) or (m, r) float. Absorption, less that for which the weights hold. [mm^-1]
    """
    return np.asarray(np.exp(-(path_mm @ mu_a.T)))


def transmissions(path_mm: np.ndarray, mu_a: np.ndarray, share: np.ndarray) -> np.ndarray:
    """`attenuation` over an LED's line, in many states that differ in few absorbers, (n, states) float.

    mu_a : (states, q, r) float. Absorption over the line, less that for which the weights hold. [mm^-1]
    share : (q,) or, of each photon, (n, q) float. Weights of the line.
    """
    out = np.zeros((len(path_mm), len(mu_a)))
    fixed = np.ptp(mu_a, axis=0).max(0) == 0
    path = path_mm.astype(float)
    for q, part in enumerate(share.T):
        # What no state changes is worked out once; each zone's few values once each, not once per state.
        factor = (part * attenuation(path[:, fixed], mu_a[0, q, fixed]))[:, None]
        for k in np.flatnonzero(~fixed):
            values, which = np.unique(mu_a[:, q, k], return_inverse=True)
            factor = factor * attenuation(path[:, [k]], values[:, None])[:, which]
        out += factor
    return out


@dataclass(frozen=True)
class Moments:
    """Sums over the photons of each photodiode at one state: of weights, squares and weighted paths."""

    photons: int
    weight: np.ndarray  # (p,)
    square: np.ndarray  # (p,)
    path: np.ndarray  # (p, r)
    path_square: np.ndarray  # (p, r)
    path_cross: np.ndarray  # (p, r): sum of w^2 L
    tail_index: np.ndarray  # (p,): of w

    @property
    def fraction(self) -> np.ndarray:
        """Detected fraction, (p,)."""
        return self.weight / self.photons

    @property
    def stderr(self) -> np.ndarray:
        """Its standard error, (p,); NaN of fewer than 25 effective photons, as of mean paths and derivatives."""
        stderr = statistics.stderr_of_mean(self.weight, self.square, self.photons)
        return statistics.stderr_or_nan(stderr, self.weight, self.square)

    @property
    def effective_photons(self) -> np.ndarray:
        """Effective number of detected photons (sum w)^2 / sum w^2, (p,)."""
        return statistics.effective_count(self.weight, self.square)

    @property
    def mean_path(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean path of the detected light in each absorber and its standard error, (p, r) each. [mm]"""
        total = self.weight[:, None]
        mean = np.divide(self.path, total, out=np.full_like(self.path, np.nan), where=total > 0)
        spread = np.maximum(self.path_square - 2 * mean * self.path_cross + mean**2 * self.square[:, None], 0)
        stderr = np.divide(np.sqrt(spread), total, out=np.full_like(mean, np.nan), where=total > 0)
        return mean, statistics.stderr_or_nan(stderr, self.path, self.path_square)

    @property
    def derivative(self) -> tuple[np.ndarray, np.ndarray]:
        """Derivative of the fraction to each absorber's mu_a and its standard error, (p, r) each. [mm]"""
        stderr = statistics.stderr_of_mean(self.path, self.path_square, self.photons)
        return -self.path / self.photons, statistics.stderr_or_nan(stderr, self.path, self.path_square)


def moments_of(photons: int, photodiode: np.ndarray, weight: np.ndarray, path_mm: np.ndarray, count: int) -> Moments:
    """Moments of records; weights are those of the state that is read."""
    where = photodiode.astype(np.intp)

    def total(values: np.ndarray) -> np.ndarray:
        # Of no photons at all numpy makes integers.
        return np.bincount(where, values, minlength=count).astype(float)

    weighted = (weight * column for column in path_mm.T)
    paths = np.array([(total(one), total(one * one), total(weight * one)) for one in weighted])
    path, path_square, cross = paths.reshape(-1, 3, count).transpose(1, 2, 0)
    first = np.cumsum(np.bincount(where, minlength=count))[:-1]
    each = np.split(weight[np.argsort(photodiode, kind="stable")], first)
    tail_index = np.array([statistics.tail_index(one) for one in each])
    return Moments(photons, total(weight), total(weight * weight), path, path_square, cross, tail_index)


@dataclass(frozen=True)
class LedTrace:
    """All that one LED's photons left behind, of one batch or of many.

    photons : How many were emitted.
    mu_a : (r,) float. Absorption for which the weights hold. [mm^-1]
    photon : (n,) unsigned int. Which photon each record is of; one has no more than one for each photodiode.
    photodiode : (n,) unsigned int. Which photodiode it reached.
    weight : (n,) float. Its weight there, of 1 at emission.
    path_mm : (n, r) float32. Its path in each absorber. [mm]
    energy : for reflected, transmitted, absorbed, lost: sum of weights and sum of their squares.
    seeds : seeds of the batches.
    absorbed : as energy, of the light that was absorbed: how much where.
    events : scatterings.
    """

    photons: int
    mu_a: np.ndarray
    photon: np.ndarray
    photodiode: np.ndarray
    weight: np.ndarray
    path_mm: np.ndarray
    energy: Mapping[str, tuple[float, float]]
    seeds: tuple[int, ...]
    absorbed: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    events: int = 0

    @staticmethod
    def stored_sums(about: Mapping[str, Any]) -> dict[str, Any]:
        """Its sums from a header, which has lists for pairs."""
        return {name: {part: (a, b) for part, (a, b) in about[name].items()} for name in SUMS}

    def check(self, *, photodiodes: int, absorbers: int) -> None:
        """Raise CorruptError unless what a file held can be such a trace."""
        count = len(self.weight)
        columns: dict[str, tuple[int, ...]] = {"mu_a": (absorbers,), "path_mm": (count, absorbers)}
        columns |= dict.fromkeys(("photon", "photodiode", "weight"), (count,))
        check_arrays(vars(self), columns)
        for column, there in ((self.photon, self.photons), (self.photodiode, photodiodes)):
            if column.dtype.kind != "u" or (column >= there).any():
                raise CorruptError("it names a photon or photodiode that there is not")
        sums = np.array([pair for name in SUMS for pair in getattr(self, name).values()], float).reshape(-1, 2)
        # Paths in neighbouring zones of the bed are differences, so that one may round to below 0.
        negative = (self.weight < 0).any() or (self.path_mm < -1e-3).any() or (sums[:, 1] < 0).any()
        if negative or not np.isfinite(sums).all() or self.energy.keys() != {*ENERGY}:
            raise CorruptError("its weights, paths or sums cannot be of light")
        if not (isinstance(self.photons, int) and self.photons > 0 and all(isinstance(s, int) for s in self.seeds)):
            raise CorruptError("its counts or seeds are invalid")

    def select(self, chosen: np.ndarray) -> "LedTrace":
        """Some of the records, (n,) bool, as a trace of as many photons; sums over all photons do not hold for them."""
        return replace(self, **{name: getattr(self, name)[chosen] for name in COLUMNS})

    def weight_at(self, mu_a: np.ndarray, share: np.ndarray) -> np.ndarray:
        """The records' weights at a state, averaged over the LED's line, (n,) float.

        mu_a : (q, r) float. Absorption over the line. [mm^-1]
        share : (q,) float. Weights of the line.
        """
        # Of all at once, paths in double precision would take more memory than the records.
        rows = (slice(k, k + CHUNK) for k in range(0, max(len(self.weight), 1), CHUNK))
        factor = [attenuation(self.path_mm[part], mu_a - self.mu_a) @ share for part in rows]
        return self.weight * np.concatenate(factor)

    def moments(self, mu_a: np.ndarray, share: np.ndarray, *, count: int) -> Moments:
        """Sums over the photons of `count` photodiodes at a state, as `weight_at` takes it."""
        weight = self.weight_at(mu_a, share)
        return moments_of(self.photons, self.photodiode, weight, self.path_mm, count)

    def covariance(self, mu_a: np.ndarray, share: np.ndarray, *, count: int) -> np.ndarray:
        """Covariance of what `count` photodiodes detect at a state, as `moments` has it, (count, count) float."""
        weight = self.weight_at(mu_a, share)
        mean = np.bincount(self.photodiode, weight, minlength=count) / self.photons
        square = statistics.covariance_of_sums(self.photon, self.photodiode, weight, count) / self.photons
        return np.asarray((square - np.outer(mean, mean)) / (self.photons - 1))

    def fractions(self, sums: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
        """Fractions of the light that it emitted, each with its standard error, from such sums; of what rests on fewer
        than 25 effective photons at least that of the upper limit of what none showed."""
        fractions, least = {}, statistics.upper_limit_95(self.photons) / statistics.Z95
        for name, (total, square) in sums.items():
            stderr = float(statistics.stderr_of_mean(total, square, self.photons))
            few = statistics.effective_count(total, square) < statistics.MIN_EFFECTIVE_TERMS
            fractions[name] = (total / self.photons, max(stderr, least) if few and self.photons > 1 else stderr)
        return fractions


def joined(traces: Sequence[LedTrace]) -> LedTrace:
    """Traces of one LED, at one absorption and of different seeds, as one."""
    seeds = tuple(seed for trace in traces for seed in trace.seeds)
    together: dict[str, Any] = {name: np.concatenate([getattr(trace, name) for trace in traces]) for name in COLUMNS}
    *before, photons = np.cumsum([0, *(trace.photons for trace in traces)])
    first = np.array(before, np.promote_types(np.uint32, np.min_scalar_type(photons)))
    together["photon"] = together["photon"] + np.repeat(first, [len(trace.photon) for trace in traces])
    for column in SUMS:
        sums = [getattr(trace, column) for trace in traces]
        pairs = {name: [by_name.get(name, (0.0, 0.0)) for by_name in sums] for by_name in sums for name in by_name}
        together[column] = {name: tuple(map(sum, zip(*both, strict=True))) for name, both in pairs.items()}
    events = sum(trace.events for trace in traces)
    return replace(traces[0], photons=int(photons), seeds=seeds, events=events, **together)


def read_escaping(batch: LedTrace, photodiodes: int, mu_a: np.ndarray) -> LedTrace:
    """A batch of a phantom that also holds all light that left its top and bottom, as of two more photodiodes, without
    these, but with the energy at another absorption that they give; where light is absorbed is then not known.

    mu_a : (r,) float. Absorption, less that for which the weights hold. [mm^-1]
    """
    end = batch.photodiode.astype(int) - photodiodes
    weight = batch.weight * attenuation(batch.path_mm, mu_a)
    energy = {name: (weight[end == i].sum(), (weight[end == i] ** 2).sum()) for i, name in enumerate(ENERGY[:2])}
    total, square = (sum(sums) for sums in zip(*energy.values(), strict=True))
    lost = batch.energy["lost"]
    energy |= {"absorbed": (batch.photons - total - lost[0], batch.photons - 2 * total + square), "lost": lost}
    return replace(batch.select(end < 0), energy=energy, absorbed={})

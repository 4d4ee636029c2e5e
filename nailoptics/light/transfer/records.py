"""What one LED's photons leave behind: batches as they are walked, joined, and thinned where they are too many."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from operator import add
from typing import Any

import numpy as np

from ...errors import InputError
from ...io import CorruptError
from ...statistics import FEW_TERMS, Z95, effective_count, stderr_of_mean, upper_limit_95
from .moments import Moments, RestState, moments_of, moments_of_sample
from .reweight import attenuation, transmission

# What is recorded of each detected photon.
COLUMNS = ("photodiode", "weight", "path_mm", "draw")
# Sums over all photons, of weights and of their squares, by name.
SUMS = ("energy", "absorbed", "pairs")
# Where light may go.
ENERGY = ("reflected", "transmitted", "absorbed", "lost")
# Photons of a full batch: enough to keep a processor's lanes busy.
FINGER_BATCH_PHOTONS, PHANTOM_BATCH_PHOTONS = 1 << 18, 1 << 19
# Photons recorded per LED; of more, each is recorded with one probability, and sums over all of them at rest.
MAX_RECORDS = 8_000_000


def check_arrays(arrays: Mapping[str, np.ndarray], shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Raise CorruptError unless each array is there, finite and of its shape."""
    for name, shape in shapes.items():
        if arrays[name].shape != shape or not np.isfinite(arrays[name]).all():
            raise CorruptError(f"{name} is not finite, or of shape {arrays[name].shape} in place of {shape}")


@dataclass(frozen=True)
class LedTrace:
    """All that one LED's photons left behind, of one batch or of many.

    photons : How many were emitted.
    mu_a : (r,) float. Absorption for which the weights hold. [mm^-1]
    photodiode : (n,) unsigned int. Which photodiode each recorded photon reached.
    weight : (n,) float. Its weight there, of 1 at emission, divided by `keep`.
    path_mm : (n, r) float32. Its path in each absorber. [mm]
    energy : for reflected, transmitted, absorbed, lost: sum of weights and sum of their squares.
    seeds : seeds of the batches.
    draw : (n,) float32 in 0-1. A random number per photon, which decides when it is dropped; if not given, drawn.
    keep : Probability with which each detected photon was recorded; those whose draw is below it were.
    rest : The state in which sums over all photons are taken when records are dropped; without one none are.
    full : These sums, once a record was dropped.
    absorbed : as energy, of the light that was absorbed: how much where.
    pairs : by two photodiodes, "i j" with i < j: sum over photons of the product of their weights in both, and of its
        square, in the state for which the weights hold; those that no photon reaches both of are left out.
    events : scatterings.
    """

    photons: int
    mu_a: np.ndarray
    photodiode: np.ndarray
    weight: np.ndarray
    path_mm: np.ndarray
    energy: Mapping[str, tuple[float, float]]
    seeds: tuple[int, ...]
    draw: np.ndarray = None  # type: ignore[assignment]
    keep: float = 1.0
    rest: RestState | None = None
    full: Moments | None = None
    absorbed: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    pairs: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    events: int = 0

    def __post_init__(self) -> None:
        if self.draw is None:
            # A batch's own seed decides, so that it does not matter when and with what the batch is merged.
            draw = np.random.default_rng(self.seeds).random(len(self.weight), dtype=np.float32)
            object.__setattr__(self, "draw", draw)

    def check(self, *, photodiodes: int, absorbers: int) -> None:
        """Raise CorruptError unless what a file held can be such a trace."""
        count = len(self.weight)
        columns: dict[str, tuple[int, ...]] = {"mu_a": (absorbers,), "path_mm": (count, absorbers)}
        columns |= dict.fromkeys(("photodiode", "weight", "draw"), (count,))
        check_arrays(vars(self), columns)
        if self.full is not None:
            check_arrays({"full": self.full.as_array}, {"full": (photodiodes, 3 + 3 * absorbers)})
        if self.photodiode.dtype.kind != "u" or (self.photodiode >= photodiodes).any():
            raise CorruptError("it names a photodiode that there is not")
        # Paths in neighbouring zones of the bed are differences, so that one may round to below 0.
        if (self.weight < 0).any() or (self.path_mm < -1e-3).any():
            raise CorruptError("a weight or path is negative")
        sums = np.array([pair for name in SUMS for pair in getattr(self, name).values()], float).reshape(-1, 2)
        if not np.isfinite(sums).all() or (sums[:, 1] < 0).any() or self.energy.keys() != {*ENERGY}:
            raise CorruptError("its sums are none of light")
        known = {f"{i} {j}" for i in range(photodiodes) for j in range(i + 1, photodiodes)} if self.pairs else set()
        if not self.pairs.keys() <= known or not (isinstance(self.photons, int) and self.photons > 0):
            raise CorruptError("its counts are none of photons")
        if not 0 < self.keep <= 1 or (self.draw >= self.keep).any() or any(not isinstance(s, int) for s in self.seeds):
            raise CorruptError("its probabilities or seeds are none")

    def select(self, chosen: np.ndarray) -> "LedTrace":
        """Some of the records, (n,) bool, as a trace of as many photons; sums over all photons do not hold for them."""
        records = {name: getattr(self, name)[chosen] for name in COLUMNS}
        return replace(self, **records, rest=None, full=None)

    def thinned(self, keep: float) -> "LedTrace":
        """The records that a probability as low or lower keeps, and sums over all photons at rest."""
        if keep == self.keep:
            return self
        thin = self.select(self.draw < keep)
        # Probabilities are powers of two, so that weights lose no bits.
        weight = thin.weight * (self.keep / keep)
        return replace(thin, weight=weight, keep=keep, rest=self.rest, full=self._sums_at_rest())

    def moments(self, mu_a: np.ndarray, share: np.ndarray, *, count: int) -> Moments:
        """Sums over the photons of `count` photodiodes at a state.

        mu_a : (q, r) float. Absorption over the LED's line. [mm^-1]
        share : (q,) float. Weights of the line.
        """
        weight = self.weight * transmission(self.path_mm, mu_a - self.mu_a, share)
        if self.full is None:
            return moments_of(self.photons, self.photodiode, weight, self.path_mm, count)
        return moments_of_sample(self.full, self.keep, self.photodiode, weight, self.weight_at_rest, self.path_mm)

    def fractions(self, sums: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
        """Fractions of the light that it emitted, each with its standard error, from such sums.

        Of what rests on fewer than 25 effective photons it is at least that of the upper limit of what none showed.
        """
        fractions, least = {}, upper_limit_95(self.photons) / Z95
        for name, (total, square) in sums.items():
            stderr = float(stderr_of_mean(total, square, self.photons))
            few = effective_count(total, square) < FEW_TERMS
            fractions[name] = (total / self.photons, max(stderr, least) if few and self.photons > 1 else stderr)
        return fractions

    @property
    def weight_at_rest(self) -> np.ndarray:
        """Weight of each record at rest, divided by `keep`, (n,) float."""
        assert self.rest is not None
        return self.weight * transmission(self.path_mm, self.rest.mu_a - self.mu_a, self.rest.share)

    def _sums_at_rest(self) -> Moments | None:
        """Sums over all photons at rest; None without a state of rest or where they were not taken in time."""
        if self.rest is None or self.full is not None or self.keep < 1:
            return self.full
        return self.moments(self.rest.mu_a, self.rest.share, count=self.rest.photodiodes)


def joined(traces: Sequence[LedTrace]) -> LedTrace:
    """Traces of one LED as one; raises InputError if they share a seed or were made at different absorption."""
    seeds = [seed for trace in traces for seed in trace.seeds]
    shared = len(seeds) - len(set(seeds))
    if shared:
        raise InputError(f"these traces share {shared} seed(s), so they are not independent; use different seeds.")
    if any(not np.array_equal(trace.mu_a, traces[0].mu_a) for trace in traces):
        raise InputError("these traces were made at different absorption; trace both at the same blood state.")
    if len({trace.rest and (trace.rest.mu_a.tobytes(), trace.rest.share.tobytes()) for trace in traces}) > 1:
        raise InputError("these traces are of scenes that differ at rest; merge traces of one scene.")
    traces = bounded(traces)
    sums = [trace.full for trace in traces if trace.full is not None]
    together: dict[str, Any] = {name: np.concatenate([getattr(trace, name) for trace in traces]) for name in COLUMNS}
    together |= {name: _added([getattr(trace, name) for trace in traces]) for name in SUMS}
    return replace(
        traces[0],
        photons=sum(trace.photons for trace in traces),
        seeds=tuple(seeds),
        full=reduce(add, sums) if len(sums) == len(traces) else None,
        events=sum(trace.events for trace in traces),
        **together,
    )


def bounded(traces: Sequence[LedTrace]) -> list[LedTrace]:
    """The traces with a probability for the photons of all that is low enough that there are not too many records."""
    # One probability for all: had records of earlier batches another, few of them would carry most of a reading.
    keep = min(trace.keep for trace in traces)
    if sum(len(trace.weight) for trace in traces) > MAX_RECORDS:
        while sum(np.count_nonzero(trace.draw < keep) for trace in traces) > MAX_RECORDS:
            keep /= 2
    return [trace.thinned(keep) for trace in traces]


def _added(sums: Sequence[Mapping[str, tuple[float, float]]]) -> dict[str, tuple[float, float]]:
    names, none = dict.fromkeys(name for parts in sums for name in parts), (0.0, 0.0)
    return {name: (sum(s.get(name, none)[0] for s in sums), sum(s.get(name, none)[1] for s in sums)) for name in names}


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

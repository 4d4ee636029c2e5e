"""The uncertainty of an answer due to the unknown parameters of a finger: quadrature over one prior at a time."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, cast

import numpy as np
import xarray as xr

from ..errors import as_far_as_reached
from ..light import ProgressCallback, Transfer, optics, trace
from ..light.identity import light_digest
from ..light.transfer.series import read_replicates
from ..options import TraceOptions
from ..scene import Prior, Scene
from ..statistics import Z95, jackknife
from ..variables import Variables, variable

# Gauss-Hermite quadrature of three nodes: in standard deviations from the mean, and their weights.
NODES = np.array([-(3**0.5), 0.0, 3**0.5])
WEIGHTS = np.array([1, 4, 1]) / 6
# A field this near a node, relative, is at that node.
AT_NODE = 1e-3
# Photons of a trace of its own, as a part of the scene's: of an effect of a third a tenth is enough to know.
OWN_SHARE = 0.1
LEAST_OWN_PHOTONS = 1 << 14


def at_value(scene: Scene, field: str, value: float) -> Scene:
    """The scene with another value of one field, such as "finger.plate_absorption"."""

    def changed(table: Any, names: Sequence[str]) -> Any:
        new = changed(getattr(table, names[0]), names[1:]) if len(names) > 1 else value
        return table.model_copy(update={names[0]: new})

    return cast(Scene, changed(scene, field.split(".")))


def value_of(scene: Scene, field: str) -> float:
    """The scene's value of a field."""
    return float(attrgetter(field)(scene))


def only_absorbs(scene: Scene, prior: Prior) -> bool:
    """Whether a trace of the scene, reweighted, gives the readings at other values of the prior's field."""
    return light_digest(at_value(scene, prior.field, prior.low)) == light_digest(scene)


def prior_of(prior: Prior) -> tuple[float, float]:
    """Mean and standard deviation of a prior, of the field's logarithm where its scale is that."""
    low, high = np.log([prior.low, prior.high]) if prior.scale == "log" else (prior.low, prior.high)
    return float(low + high) / 2, float(high - low) / (2 * Z95)


def nodes_of(prior: Prior) -> tuple[float, ...]:
    """The field's values at the nodes of the quadrature."""
    mean, sd = prior_of(prior)
    at = mean + NODES * sd
    return tuple(float(x) for x in (np.exp(at) if prior.scale == "log" else at))


def over_priors(scene: Scene, priors: Sequence[Prior], answer: Callable[[Scene], np.ndarray]) -> "PriorSensitivity":
    """Carry an answer over priors, one at a time.

    answer : of a scene, by all photons and without each group of them, (1 + groups, ...) float.
    """
    own = answer(scene)
    nodes = []
    for prior in priors:
        mine = value_of(scene, prior.field)
        for value in nodes_of(prior):
            there = np.isclose(value, mine, rtol=AT_NODE, atol=0)
            nodes.append(own if there else answer(at_value(scene, prior.field, value)))
    return PriorSensitivity(tuple(priors), np.array(nodes).reshape(len(priors), len(NODES), *own.shape), own)


@dataclass(frozen=True)
class PriorSensitivity:
    """Answers at the nodes of every prior, by all photons and without each group of them.

    The variance of an answer over the priors is the sum of what each of them makes alone; what two of them together add
    to that is left out.

    nodes : (priors, 3, 1 + groups, ...) float. Answers, one prior at a time at each of its nodes.
    own : (1 + groups, ...) float. Answers of the scene as it is.
    """

    priors: tuple[Prior, ...]
    nodes: np.ndarray
    own: np.ndarray

    @property
    def by_prior(self) -> tuple[np.ndarray, np.ndarray]:
        """Standard deviation that each prior makes, and its standard error, (priors, ...) float each."""
        return _root(np.stack([self._variance(k) for k in range(len(self.priors))], 1))

    @property
    def total(self) -> tuple[np.ndarray, np.ndarray]:
        """Standard deviation over all of these priors, and its standard error, (...) float each."""
        return _root(np.sum([self._variance(k) for k in range(len(self.priors))], axis=0))

    @property
    def shift(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean over the priors less the scene's own answer, and its standard error, (...) float each.

        Not 0 where values of the scene are not the means of their priors, or the answer bends.
        """
        weights = WEIGHTS.reshape(-1, *([1] * self.own.ndim))
        shift = np.sum([(weights * self._moved(k)).sum(0) for k in range(len(self.priors))], axis=0)
        return shift[0], jackknife(shift)

    @property
    def keeps_sign(self) -> np.ndarray:
        """Whether an answer has one sign at every node and within its 95 % interval, (...) bool.

        That interval is about the mean over these priors, of them and of the photons' noise.
        """
        values = np.concatenate([self.own[None, 0], self.nodes[:, :, 0].reshape(-1, *self.own.shape[1:])])
        one_sign = (values > 0).all(0) | (values < 0).all(0)
        noise = np.nan_to_num(jackknife(self.own), nan=np.inf)
        mean = self.own[0] + self.shift[0]
        return np.asarray(one_sign & (np.abs(mean) > Z95 * np.hypot(self.total[0], noise)))

    def _moved(self, prior: int) -> np.ndarray:
        """By how much the answers at one prior's nodes differ from the scene's, (3, 1 + groups, ...) float."""
        # The logarithm of a reading that saw no light is not known, whatever the prior.
        own = np.where(np.isfinite(self.own), self.own, np.nan)
        return np.asarray(np.where(np.isfinite(self.nodes[prior]), self.nodes[prior], np.nan) - own)

    def _variance(self, prior: int) -> np.ndarray:
        """Variance that one prior makes, (1 + groups, ...) float."""
        each = self._moved(prior)
        weights = WEIGHTS.reshape(-1, *([1] * (each.ndim - 1)))
        return np.asarray((weights * each**2).sum(0) - (weights * each).sum(0) ** 2)

    def variables(self, name: str, dims: tuple[str, ...], text: str, untraced: int = 0) -> Variables:
        """Standard deviations, over all priors and by each, and the shift of an answer; NaN of the untraced priors."""
        (total, error), (shift, shift_error) = self.total, self.shift
        over = "over the priors of the finger's parameters"
        data = variable(f"{name}_spread", dims, total, f"standard deviation of {text} {over}", stderr=error)
        words = f"mean of {text} {over}, less that of the scene"
        data |= variable(f"{name}_shift", dims, shift, words, stderr=shift_error)
        gap = np.full((untraced, *total.shape), np.nan)
        each, errors = (np.concatenate([values, gap]) for values in self.by_prior)
        words = f"standard deviation of {text} over one prior alone"
        return data | variable(f"prior_{name}_spread", ("prior", *dims), each, words, stderr=errors)


def _root(variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviations and their standard errors from variances by all groups and without each, (1 + n, ...).

    Noise of the nodes adds to a variance; the jackknife takes that away.
    """
    groups = len(variance) - 1
    unbiased = groups * variance[0] - (groups - 1) * variance[1:].mean(0)
    value = np.sqrt(np.maximum(unbiased, 0.0))
    error = jackknife(variance)
    # Where the variance is not known from 0, neither is its root from what its error would make of it.
    with np.errstate(divide="ignore", invalid="ignore"):
        return value, np.where(unbiased > error, error / (2 * value), np.sqrt(error))


def prior_variables(evaluated: Sequence[Prior], untraced: Sequence[Prior], scene: Scene) -> xr.Dataset:
    """Priors as a Dataset: fields, ranges and sources, where the scene's values lie, and how each was evaluated."""
    priors = (*evaluated, *untraced)
    data: Variables = {}
    for field, text in (("field", "field of the scene"), ("source", "where its range comes from")):
        data |= variable(f"prior_{field}", "prior", [getattr(one, field) for one in priors], text)
    ends = [[one.low, one.high] for one in priors]
    data |= variable("prior_range", ("prior", "end"), ends, "ends of the range that holds with 95 %")
    offsets = []
    for one in priors:
        (mean, sd), value = prior_of(one), value_of(scene, one.field)
        with np.errstate(divide="ignore"):
            offsets.append(((np.log(value) if one.scale == "log" else value) - mean) / sd)
    text = "the scene's value less the mean of its prior, in standard deviations"
    data |= variable("prior_offset", "prior", offsets, text)
    how = ["reweighted" if only_absorbs(scene, one) else "retraced" for one in evaluated]
    data |= variable("prior_how", "prior", [*how, *["not traced"] * len(untraced)], "how it was evaluated")
    names = ("prior", [one.name for one in priors], {"long_name": "prior of a parameter of the finger"})
    return xr.Dataset(data, {"prior": names})


@dataclass(frozen=True)
class ReadingUncertainty:
    """Readings in a first state and their change to a second one over the priors, (led, photodiode) each.

    level : natural logarithm of the reading in the first state.
    change : the change, as a multiple of the scene's own.
    signal : the change as a part of the reading in the first state.
    untraced : priors that need traces of their own and had none.
    """

    level: PriorSensitivity
    change: PriorSensitivity
    signal: PriorSensitivity
    untraced: tuple[Prior, ...]

    def dataset(self, scene: Scene) -> xr.Dataset:
        """All of it over prior, led and photodiode; of priors that were not traced it is NaN."""
        pair, count = ("led", "photodiode"), len(self.untraced)
        data = self.level.variables("reading", pair, "the logarithm of the reading at the start", count)
        data |= self.change.variables("change", pair, "the change by touch, as a part of the scene's,", count)
        text = "change by touch as a part of the reading at the start"
        data |= self.signal.variables("signal", pair, f"the {text}", count)
        data |= variable("signal", pair, self.signal.own[0], text)
        text = "whether the change has one sign over the evaluated priors, to which vessels and touch do not belong"
        data |= variable("keeps_sign", pair, self.signal.keeps_sign, text)
        return xr.Dataset(data).merge(prior_variables(self.level.priors, self.untraced, scene))


def readings_over_priors(
    transfer: Transfer,
    states: Callable[[Scene], np.ndarray],
    *,
    options: TraceOptions,
    own_traces: bool,
    progress: ProgressCallback | None = None,
) -> ReadingUncertainty:
    """The uncertainty of a scene's readings in two blood states due to its priors.

    states : a scene's two states, (2, zones) float.
    options : seed and backend of the traces of their own, and the time for all of them.
    own_traces : whether to trace what scatters or is shaped otherwise; else only what the trace itself gives.
    """
    scene = transfer.scene
    priors = sorted(scene.priors.of_finger(), key=lambda prior: not only_absorbs(scene, prior))
    own = [prior for prior in priors if not only_absorbs(scene, prior)]
    evaluated = priors if own_traces else priors[: len(priors) - len(own)]
    limit = None if options.max_seconds is None else options.max_seconds / max(2 * len(own), 1)
    photons = max(LEAST_OWN_PHOTONS, round(OWN_SHARE * max(led.photons for led in transfer.traces)))
    fewer = TraceOptions(seed=options.seed, backend=options.backend, photons=photons, max_seconds=limit)

    def retraced(one: Scene) -> np.ndarray:
        return read_by_groups(_fresh(one, fewer, progress), one, states(one), options.seed)

    base = read_by_groups(transfer, scene, states(scene), options.seed)
    # Of as many photons with the same random numbers, so that what all have in common cancels.
    twin = retraced(scene) if own_traces and own else base

    def answer(one: Scene) -> np.ndarray:
        if light_digest(one) == light_digest(scene):
            return read_by_groups(transfer, one, states(one), options.seed)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(base * (retraced(one) / twin))

    result = over_priors(scene, evaluated, answer)
    # Each group's left-out change in its own unit, so that the noise that both share cancels.
    unit = np.abs(base[..., 1] - base[..., 0])
    level, change, signal = (
        PriorSensitivity(result.priors, *both)
        for both in zip(_answers(result.nodes, unit), _answers(result.own, unit), strict=True)
    )
    return ReadingUncertainty(level, change, signal, untraced=() if own_traces else tuple(own))


def _answers(read: np.ndarray, unit: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Logarithm of the first reading, the change to the second in its unit, and as a part of the first, (...) float.

    read : (..., 2) float.
    """
    first, change = read[..., 0], read[..., 1] - read[..., 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.log(first), change / unit, change / first


def _fresh(scene: Scene, options: TraceOptions, progress: ProgressCallback | None) -> Transfer:
    """A trace of its own, as far as its time went."""
    scene = scene.model_copy(update={"accuracy": type(scene.accuracy)()})
    result: Transfer = as_far_as_reached(trace, scene, progress=progress, **options.fields)[0]
    return result


def read_by_groups(transfer: Transfer, scene: Scene, states: np.ndarray, seed: int) -> np.ndarray:
    """Readings of a scene in states (t, zones) by a trace that gives them, (1 + groups, led, photodiode, t) float."""
    by_led = []
    for i, led in enumerate(transfer.scene.leds):
        wavelength, _ = optics.spectrum(led)
        mu_a = optics.absorption(scene, wavelength, blood_fraction=states)
        by_led.append(read_replicates(transfer, i, mu_a, np.ones(len(wavelength)), seed=seed).reading)
    return np.stack(by_led, 1)

"""The uncertainty of an answer due to the unknown parameters of a finger: draws from their joint prior."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from operator import attrgetter
from statistics import NormalDist
from typing import TypeVar

import numpy as np
import xarray as xr
from pydantic import BaseModel

from ..errors import NotReachedError, as_far_as_reached
from ..light import ProgressCallback, Transfer, trace
from ..light.identity import light_scene
from ..light.tracing import StageProgress
from ..light.transfer.series import read_by_groups
from ..options import TraceOptions
from ..scene import Prior, Scene
from ..scene.priors import size_priors
from ..statistics import Z95, covariance_root, jackknife, quotient
from ..variables import Variables, described, variable

Model = TypeVar("Model", bound=BaseModel)

# Gauss-Hermite quadrature of three nodes: in standard deviations from the mean, and their weights.
NODES = np.array([-(3**0.5), 0.0, 3**0.5])
WEIGHTS = np.array([1, 4, 1]) / 6
# A parabola through the nodes at the ends and the scene's value needs that to be no nearer to them.
MOST_OFFSET = 1.0
# Draws from the joint prior, and the fraction of them in which a sign that holds holds.
DRAWS, SURELY = 1024, 0.975
# Relative changes of readings as small as this are rounding.
ROUNDING = 1e-9
# Photons of a trace of its own, as a fraction of the scene's: of an effect of a third a tenth is enough to know.
OWN_SHARE = 0.1
LEAST_OWN_PHOTONS = 1 << 14


def at_value(scene: Model, field: str, value: float) -> Model:
    """The scene, or a table of one, with another value of one field, such as "finger.plate_absorption"."""
    name, _, within = field.partition(".")
    return scene.model_copy(update={name: at_value(getattr(scene, name), within, value) if within else value})


def value_of(scene: Scene, field: str) -> float:
    """The scene's value of a field."""
    return float(attrgetter(field)(scene))


def only_absorbs(scene: Scene, prior: Prior) -> bool:
    """Whether a trace of the scene, reweighted, gives the readings at other values of the prior's field."""
    return light_scene(at_value(scene, prior.field, prior.low)) == light_scene(scene)


def prior_of(prior: Prior) -> tuple[float, float]:
    """Mean and standard deviation of a prior, of the field's logarithm where its scale is that."""
    low, high = np.log([prior.low, prior.high]) if prior.scale == "log" else (prior.low, prior.high)
    return float(low + high) / 2, float(high - low) / (2 * Z95)


def nodes_of(prior: Prior, z: np.ndarray = NODES) -> list[float]:
    """The field's values so many standard deviations from the prior's mean: those of the quadrature if not given."""
    mean, sd = prior_of(prior)
    return np.asarray(np.exp(mean + z * sd) if prior.scale == "log" else mean + z * sd).tolist()


def over_priors(
    scene: Scene,
    priors: Sequence[Prior],
    answer: Callable[[Scene], np.ndarray],
    retraced: Callable[[Scene], np.ndarray] | None = None,
) -> "PriorSensitivity":
    """Carry an answer over priors, one at a time.

    answer : of a scene, by all photons and without each group of them, (1 + groups, ...) float. Where another value
        takes a trace, that of the middle node is on the parabola through the ends and the scene's own.
    retraced : the answer of fewer photons of their own, where a value takes a trace: the difference from that of the
        scene by as many with common random numbers is added to the scene's by all, which is the control variate.
        Where it raises NotReachedError, this prior and those after it are left out.
    """
    base, anew = answer(scene), retraced or answer
    nodes = np.empty((len(priors), len(NODES), *base.shape))
    twin = cache(lambda: anew(scene))
    try:
        for k, prior in enumerate(priors):
            as_traced = (absorbs := only_absorbs(scene, prior)) or retraced is None
            at = answer if as_traced else lambda varied: base + anew(varied) - twin()
            values = [at_value(scene, prior.field, value) for value in nodes_of(prior)]
            low, high, offset = at(values[0]), at(values[2]), offset_of(scene, prior)
            if abs(offset) < MOST_OFFSET and not absorbs:
                middle = base * NODES[2] ** 2 / (NODES[2] ** 2 - offset**2)
                middle = middle + offset / 2 * (low / (NODES[2] + offset) - high / (NODES[2] - offset))
            else:
                middle = base if values[1] == value_of(scene, prior.field) else at(values[1])
            nodes[k] = low, middle, high
    except NotReachedError:
        priors = priors[:k]
    return PriorSensitivity(tuple(priors), nodes[: len(priors)], base, scene.priors.correlation(priors))


def offset_of(scene: Scene, prior: Prior) -> float:
    """The scene's value less the mean of a prior, in its standard deviations."""
    (mean, sd), value = prior_of(prior), value_of(scene, prior.field)
    with np.errstate(divide="ignore"):
        return float(((np.log(value) if prior.scale == "log" else value) - mean) / sd)


def known_priors(scene: Scene) -> tuple[Prior, ...]:
    """The priors of a scene's finger and of its body."""
    return (*scene.finger_priors, *scene.priors.of_body(scene.body))


def draw_people(scene: Scene, count: int) -> list[dict[str, float]]:
    """Values of the fields of people drawn from the priors of a scene, its body and its finger's sizes. Always the same
    ones: a Latin hypercube, in which every field has one value in each of `count` equally probable parts of its prior,
    as far as correlations leave them there, and none beyond the prior's ends."""
    from scipy.stats import norm, qmc

    priors = (*known_priors(scene), *size_priors(scene.fingertip))
    parts = norm.ppf(qmc.LatinHypercube(len(priors), seed=1).random(count))
    z = np.clip(parts @ covariance_root(scene.priors.correlation(priors)).T, -Z95, Z95)
    fields, columns = [prior.field for prior in priors], map(nodes_of, priors, z.T)
    people = [dict(zip(fields, row, strict=True)) for row in zip(*columns, strict=True)]
    behind_mm = scene.fingertip.length_mm - scene.fingertip.nail_length_mm
    for person in people:
        person["finger.length_mm"] = person["finger.nail_length_mm"] + behind_mm
    return people


@dataclass(frozen=True)
class PriorSensitivity:
    """Quantities at the nodes of every prior, by all photons and without each group of them, and an answer by them.

    Between the nodes of one prior a quantity is quadratic in the standardised field, and what several priors change
    adds up; so a logarithm, whose changes multiply, is a better quantity than what it is of. Over all priors an answer
    has the mean and the standard deviation of its draws from their joint, correlated distribution.

    nodes : (priors, 3, 1 + groups, ...) float. Quantities, one prior at a time at each of its nodes.
    base : (1 + groups, ...) float. Quantities of the scene as it is.
    correlation : (priors, priors) float. Of the fields, each on the scale of its prior.
    answer : of quantities (n, ...) and the scene's own, (...), the answer; the quantities themselves if not given.
    """

    priors: tuple[Prior, ...]
    nodes: np.ndarray
    base: np.ndarray
    correlation: np.ndarray
    answer: Callable[[np.ndarray, np.ndarray], np.ndarray] = lambda values, base: values

    @cached_property
    def base_answer(self) -> np.ndarray:
        """The answer of the scene as it is, by all photons and without each group, (1 + groups, ...) float."""
        return np.stack([self.answer(base[None], base)[0] for base in self.base])

    @property
    def by_prior(self) -> tuple[np.ndarray, np.ndarray]:
        """Standard deviation that each prior makes alone, and its standard error, (priors, ...) float each."""
        variances, shape = [], (len(self.priors), len(NODES), *self.base_answer.shape[1:])
        for group, base in enumerate(self.base):
            answers = [self.answer(node, base) for node in self.nodes[:, :, group]]
            by_node = np.moveaxis(np.reshape(answers, shape), 1, 0)
            variances.append(np.tensordot(WEIGHTS, by_node**2, 1) - np.tensordot(WEIGHTS, by_node, 1) ** 2)
        return _root(np.stack(variances))

    @property
    def total(self) -> tuple[np.ndarray, np.ndarray]:
        """Standard deviation over all of these priors, and its standard error, (...) float each."""
        return _root(self._moments[1])

    @property
    def shift(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean over the priors less the scene's own answer, and its standard error, (...) float each. Not 0 where
        values of the scene are not the means of their priors, or the answer bends."""
        shift = self._moments[0] - self.base_answer
        return shift[0], jackknife(shift)

    @property
    def keeps_sign(self) -> np.ndarray:
        """Whether an answer has the scene's sign in 97.5 % of the draws, and beyond the photons' noise, (...) bool.
        Quadratic responses that are added up cross 0 in tails where the answer does not: what is False may hold."""
        draws, noise = self.draws(0), np.nan_to_num(jackknife(self.base_answer), nan=np.inf)
        same = (np.sign(draws) == np.sign(self.base_answer[0])).mean(0)
        return np.asarray((same >= SURELY) & (np.abs(self.base_answer[0]) > np.maximum(Z95 * noise, ROUNDING)))

    def draws(self, group: int) -> np.ndarray:
        """Answers at draws of the joint priors, without one group of photons (0: by all), (DRAWS, ...) float."""
        base = self.base[group]
        # The logarithm of a reading that saw no light is not known, whatever the prior.
        nodes = np.where(np.isfinite(self.nodes[:, :, group]), self.nodes[:, :, group], np.nan)
        low, middle, high = np.moveaxis(nodes, 1, 0)
        slope, bend = (high - low) / (NODES[2] - NODES[0]), (high + low - 2 * middle) / (2 * NODES[2] ** 2)
        values = np.tensordot(np.hstack([self._standard, self._standard**2]), np.concatenate([slope, bend]), 1)
        values += base + (middle - base).sum(0)
        return np.asarray(self.answer(values, base))

    @cached_property
    def _standard(self) -> np.ndarray:
        """Draws of normal numbers with exactly these correlations, means of 0 and variances of 1, (DRAWS, priors)
        float. Always the same ones: a Latin hypercube with antithetic draws, so that odd moments are exactly 0, too."""
        count, generator = len(self.correlation), np.random.default_rng(1)
        below = [NormalDist().inv_cdf((k + 0.5) / DRAWS) for k in range(DRAWS // 2)]
        sides = generator.choice([-1.0, 1.0], (DRAWS // 2, count))
        half = sides * generator.permuted(np.tile(below, (count, 1)), axis=1).T
        independent = half @ np.linalg.inv(np.linalg.cholesky(2 * half.T @ half / DRAWS)).T
        draws = independent @ covariance_root(self.correlation).T
        return np.concatenate([draws, -draws])

    @cached_property
    def _moments(self) -> tuple[np.ndarray, np.ndarray]:
        """Means and variances over the draws, by all photons and without each group, (1 + groups, ...) float each."""
        draws = (self.draws(group) for group in range(len(self.base)))
        mean, variance = zip(*((draw.mean(0), draw.var(0)) for draw in draws), strict=True)
        return np.stack(mean), np.stack(variance)

    def variables(self, name: str, dims: tuple[str, ...], text: str, untraced: int = 0) -> Variables:
        """Standard deviations, over all priors and by each, and the shift of an answer; NaN of the untraced priors."""
        (total, error), (shift, shift_error) = self.total, self.shift
        over, spread = "over the priors of the finger's parameters", f"standard deviation of {text}"
        data = variable(f"{name}_spread", dims, total, f"{spread} {over}", stderr=error)
        words = f"mean of {text} {over}, less that of the scene"
        data |= variable(f"{name}_shift", dims, shift, words, stderr=shift_error)
        gap = np.full((untraced, *total.shape), np.nan)
        stds, errors = (np.concatenate([values, gap]) for values in self.by_prior)
        words = f"{spread} over one prior alone"
        return data | variable(f"prior_{name}_spread", ("prior", *dims), stds, words, stderr=errors)


def _root(variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviations and their standard errors from variances by all groups and without each, (1 + n, ...). Noise
    of the nodes adds to a variance; the jackknife takes that away."""
    groups = len(variance) - 1
    unbiased = groups * variance[0] - (groups - 1) * variance[1:].mean(0)
    value = np.sqrt(np.maximum(unbiased, 0.0))
    error = jackknife(variance)
    # Where the variance is not known from 0, neither is its root from what its error would make of it.
    return value, np.where(unbiased > error, quotient(error, 2 * value), np.sqrt(error))


def prior_variables(evaluated: Sequence[Prior], untraced: Sequence[Prior], scene: Scene) -> xr.Dataset:
    """Priors as a Dataset: fields, ranges and sources, where the scene's values lie, and how each was evaluated."""
    priors = (*evaluated, *untraced)
    how = ["reweighted" if only_absorbs(scene, prior) else "retraced" for prior in evaluated]
    data = described(
        __package__,
        prior_field=[prior.field for prior in priors],
        prior_source=[prior.source for prior in priors],
        prior_range=np.reshape([(prior.low, prior.high) for prior in priors], (-1, 2)),
        prior_offset=[offset_of(scene, prior) for prior in priors],
        prior_how=[*how, *["not traced"] * len(untraced)],
    )
    names = ("prior", [prior.name for prior in priors], {"long_name": "prior of a parameter of the finger"})
    return xr.Dataset(data, {"prior": names})


@dataclass(frozen=True)
class ReadingUncertainty:
    """Readings in a first state and their change to a second one over the priors, (led, photodiode) each.

    level : natural logarithm of the reading in the first state. change : the change, over the scene's own.
    signal : the change as a fraction of the reading in the first state.
    untraced : priors that need traces of their own and had none, or too few.
    why : what ended the traces before them.
    """

    level: PriorSensitivity
    change: PriorSensitivity
    signal: PriorSensitivity
    untraced: tuple[Prior, ...]
    why: str

    def dataset(self, scene: Scene) -> xr.Dataset:
        """All of it over prior, led and photodiode; of priors that were not traced it is NaN."""
        pair, count = ("led", "photodiode"), len(self.untraced)
        data = self.level.variables("reading", pair, "the logarithm of the reading at the start", count)
        data |= self.change.variables("change", pair, "the change by touch, as a fraction of the scene's,", count)
        signal = "the change by touch as a fraction of the reading at the start"
        data |= self.signal.variables("signal", pair, signal, count)
        data |= described(__package__, signal=self.signal.base_answer[0], keeps_sign=self.signal.keeps_sign)
        return xr.Dataset(data).merge(prior_variables(self.level.priors, self.untraced, scene))


def readings_over_priors(
    transfer: Transfer,
    states: Callable[[Scene], tuple[np.ndarray, np.ndarray | None]],
    *,
    options: TraceOptions,
    own_traces: bool,
    progress: ProgressCallback | None = None,
) -> ReadingUncertainty:
    """The uncertainty of a scene's readings in two blood states due to its priors.

    states : a scene's two states, (2, zones) float, and their saturations where its oxygen is balanced.
    options : seed and backend of the traces of their own, none of which begins that would end after max_seconds.
    own_traces : whether to trace what scatters or is shaped otherwise; else only what the trace itself gives.
    progress : called with the stage "priors"; an interrupt, or the time, ends the traces; what is there is returned.
    """
    scene = transfer.scene
    needing_traces = [prior for prior in scene.finger_priors if not only_absorbs(scene, prior)]
    evaluated = [prior for prior in scene.finger_priors if prior not in needing_traces]
    count = 1 + sum(2 + (abs(offset_of(scene, prior)) >= MOST_OFFSET) for prior in needing_traces)
    stage, made_s = StageProgress(progress, options.max_seconds or math.inf), list[float]()
    photons = max(LEAST_OWN_PHOTONS, round(OWN_SHARE * max(led.photons for led in transfer.traces)))

    def reread(varied: Scene, light: Transfer = transfer) -> np.ndarray:
        """Logarithms of the first reading and of the second over it, (1 + groups, led, photodiode, 2) float."""
        with np.errstate(divide="ignore", invalid="ignore"):
            first, second = np.moveaxis(np.log(read_by_groups(light, varied, *states(varied))), -1, 0)
            return np.stack([first, second - first], -1)

    def report(_: object) -> None:
        stage("priors", len(made_s) / count)
        if stage.interrupted:
            raise NotReachedError(stage.why)

    def retraced(varied: Scene) -> np.ndarray:
        if (left_s := stage.seconds_left) <= (made_s or [0.0])[-1]:
            raise NotReachedError(stage.why)
        share_s, begin_s = left_s / (count - len(made_s)) if options.max_seconds else None, stage.seconds
        how = replace(options, relative_error=None, photons=photons, max_seconds=share_s).fields
        answer = reread(varied, as_far_as_reached(trace, varied.without_accuracy(), progress=report, **how)[0])
        made_s.append(stage.seconds - begin_s)
        stage("priors", len(made_s) / count)
        return answer

    result = over_priors(scene, evaluated + (needing_traces if own_traces else []), reread, retraced)
    return ReadingUncertainty(
        level=replace(result, answer=lambda values, _: values[..., 0]),
        change=replace(result, answer=_change),
        signal=replace(result, answer=lambda values, _: np.expm1(values[..., 1])),
        untraced=tuple(prior for prior in needing_traces if prior not in result.priors),
        why=stage.why,
    )


def _change(values: np.ndarray, base: np.ndarray) -> np.ndarray:
    """Change to the second reading over the scene's own: the noise that both share cancels. NaN where that is 0."""
    change = np.exp(values[..., 0] - base[..., 0]) * np.expm1(values[..., 1])
    scene_change = np.abs(np.expm1(base[..., 1]))
    return np.asarray(change / np.where(scene_change > 0, scene_change, np.nan))

"""How far readings and their change by touch spread over what is unknown of the finger, reread from one trace."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr

from ..errors import InputError, NotReachedError
from ..light import ProgressCallback, Transfer, optics, trace
from ..light.course import read_replicates
from ..light.identity import light_digest
from ..options import TraceOptions
from ..scene import Prior, Scene
from ..scene.priors import WEIGHTS
from ..statistics import Z95, jackknife
from ..variables import Variables, variable

# Photons of a trace of its own, as a part of the scene's: of an effect of a third a tenth is enough to know.
OWN_SHARE = 0.1
LEAST_OWN_PHOTONS = 1 << 14
# A field this near a node of its prior is at that node.
AT_NODE = 1e-3


def at_value(scene: Scene, field: str, value: float) -> Scene:
    """The scene with another value of one field, such as "finger.plate_absorption"."""
    table, name = field.split(".")
    return scene.model_copy(update={table: getattr(scene, table).model_copy(update={name: value})})


def value_of(scene: Scene, field: str) -> float:
    """The scene's value of a field."""
    table, name = field.split(".")
    return float(getattr(getattr(scene, table), name))


def only_absorbs(scene: Scene, prior: Prior) -> bool:
    """Whether a trace of the scene tells what another value of the prior's field would read."""
    return light_digest(at_value(scene, prior.field, prior.low)) == light_digest(scene)


@dataclass(frozen=True)
class Spread:
    """Answers at the nodes of every prior, by all photons and without each group of them.

    An answer's variance over the priors is the sum of what each of them makes alone, by Gauss-Hermite quadrature of
    three nodes; what two of them together add to that is left out.

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
        """Standard deviation over all priors, and its standard error, (...) float each."""
        return _root(np.sum([self._variance(k) for k in range(len(self.priors))], axis=0))

    @property
    def keeps_sign(self) -> np.ndarray:
        """Whether an answer has one sign at every node and within its 95 % interval, (...) bool.

        That interval is over all priors and over the photons' noise.
        """
        values = np.concatenate([self.own[None, 0], self.nodes[:, :, 0].reshape(-1, *self.own.shape[1:])])
        one_sign = (values > 0).all(0) | (values < 0).all(0)
        noise = np.nan_to_num(jackknife(self.own), nan=np.inf)
        return np.asarray(one_sign & (np.abs(self.own[0]) > Z95 * np.hypot(self.total[0], noise)))

    def _variance(self, prior: int) -> np.ndarray:
        """Variance that one prior makes, (1 + groups, ...) float."""
        # The logarithm of a reading that saw no light is not known, whatever the prior.
        own = np.where(np.isfinite(self.own), self.own, np.nan)
        each = np.where(np.isfinite(self.nodes[prior]), self.nodes[prior], np.nan) - own
        weights = WEIGHTS.reshape(-1, *([1] * (each.ndim - 1)))
        return np.asarray((weights * each**2).sum(0) - (weights * each).sum(0) ** 2)


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


@dataclass(frozen=True)
class ReadingSpread:
    """Spread of the readings in a first state and of their change to a second one, (led, photodiode) each.

    level : of the natural logarithm of the reading in the first state.
    change : of the change, as a multiple of the scene's own.
    signal : of the change as a part of the reading in the first state.
    untraced : priors that need traces of their own and had none.
    """

    level: Spread
    change: Spread
    signal: Spread
    untraced: tuple[Prior, ...]


def spread_of_readings(
    transfer: Transfer,
    states: Callable[[Scene], np.ndarray],
    *,
    options: TraceOptions,
    own_traces: bool,
    progress: ProgressCallback | None = None,
) -> ReadingSpread:
    """How far a scene's readings in two blood states spread over its priors.

    states : a scene's two states, (2, zones) float.
    options : seed and backend of the traces of their own, and the time for all of them.
    own_traces : whether to trace what scatters or is shaped otherwise; else only what the trace itself can tell.
    """
    scene = transfer.scene
    priors = scene.priors.of_finger()
    told = [prior for prior in priors if only_absorbs(scene, prior)]
    own = [prior for prior in priors if prior not in told]
    scenes = [at_value(scene, prior.field, value) for prior in told for value in prior.values]
    read = _read(transfer, [scene, *scenes], states, options.seed)
    base, nodes = read[0], list(read[1:].reshape(len(told), 3, *read.shape[1:]))
    if own_traces:
        limit = None if options.max_seconds is None else options.max_seconds / max(2 * len(own), 1)
        photons = max(LEAST_OWN_PHOTONS, round(OWN_SHARE * max(led.photons for led in transfer.traces)))
        one = TraceOptions(seed=options.seed, backend=options.backend, photons=photons, max_seconds=limit)
        # Of as many photons with the same random numbers, so that what all have in common cancels.
        twin = _read_fresh(scene, states, one, progress)
        for prior in own:
            fresh = [
                twin
                if np.isclose(value, value_of(scene, prior.field), rtol=AT_NODE, atol=0)
                else _read_fresh(at_value(scene, prior.field, value), states, one, progress)
                for value in prior.values
            ]
            # In terms of the scene's own trace, in which all others are.
            nodes.append(np.stack([_moved(base, twin, each) for each in fresh]))
    kept = (*told, *(own if own_traces else []))
    found = np.stack(nodes) if nodes else np.empty((0, 3, *base.shape))
    # Each group's left-out change in its own unit, so that the noise that both share cancels.
    unit = np.abs(base[..., 1] - base[..., 0])
    level, change, signal = (
        Spread(kept, *both) for both in zip(_answers(found, unit), _answers(base, unit), strict=True)
    )
    return ReadingSpread(level, change, signal, untraced=() if own_traces else tuple(own))


def _answers(read: np.ndarray, unit: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Logarithm of the first reading, the change to the second in its unit, and as a part of the first, (...) float.

    read : (..., 2) float.
    """
    first, change = read[..., 0], read[..., 1] - read[..., 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.log(first), change / unit, change / first


def _moved(base: np.ndarray, twin: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Readings of the base, moved as the other trace's are from its twin's."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return base * (other / twin)


def _read_fresh(
    scene: Scene, states: Callable[[Scene], np.ndarray], options: TraceOptions, progress: ProgressCallback | None
) -> np.ndarray:
    """Readings of a trace of its own, as far as its time went."""
    scene = scene.model_copy(update={"accuracy": type(scene.accuracy)()})
    try:
        transfer = trace(scene, progress=progress, **options.fields)
    except NotReachedError as error:
        if not isinstance(error.result, Transfer):
            raise
        transfer = error.result
    return _read(transfer, [scene], states, options.seed)[0]


def _read(transfer: Transfer, scenes: Sequence[Scene], states: Callable[[Scene], np.ndarray], seed: int) -> np.ndarray:
    """Readings of scenes that share a trace, (scenes, 1 + groups, led, photodiode, 2) float."""
    at = [states(scene) for scene in scenes]
    if any(state.shape[0] != 2 for state in at):
        raise InputError("a spread of readings is over two blood states; give two.")
    by_led = []
    for i, led in enumerate(transfer.scene.leds):
        wavelength, _ = optics.spectrum(led)
        mu_a = [
            optics.absorption(scene, wavelength, blood_fraction=state) for scene, state in zip(scenes, at, strict=True)
        ]
        found = read_replicates(transfer, i, np.concatenate(mu_a), np.ones(len(wavelength)), seed=seed).reading
        by_led.append(found.reshape(*found.shape[:2], len(scenes), 2))
    return np.moveaxis(np.stack(by_led, 1), 3, 0)


def spread_dataset(found: ReadingSpread, scene: Scene) -> xr.Dataset:
    """A spread of readings as a Dataset over prior, led and photodiode; of priors that were not traced it is NaN."""
    pair = ("led", "photodiode")
    data: Variables = {}
    words = "over what is unknown of the finger, one standard deviation"
    for name, one, text in (
        ("reading", found.level, "of the logarithm of the reading at the start"),
        ("change", found.change, "of the change by touch, as a part of the change,"),
        ("signal", found.signal, "of the change by touch as a part of the reading at the start"),
    ):
        total, error = one.total
        data |= variable(f"{name}_spread", pair, total, f"spread {text} {words}", stderr=error)
        gap = np.full((len(found.untraced), *total.shape), np.nan)
        each, errors = (np.concatenate([values, gap]) for values in one.by_prior)
        text = f"spread {text} by one prior alone"
        data |= variable(f"prior_{name}_spread", ("prior", *pair), each, text, stderr=errors)
    data |= variable("signal", pair, found.signal.own[0], "change by touch as a part of the reading at the start")
    data |= variable("keeps_sign", pair, found.signal.keeps_sign, "whether the change has one sign over all priors")
    return xr.Dataset(data).merge(prior_variables(found.level.priors, found.untraced, scene))


def prior_variables(evaluated: Sequence[Prior], untraced: Sequence[Prior], scene: Scene) -> xr.Dataset:
    """Priors as a Dataset: their fields, ranges and sources, and how each was evaluated."""
    priors = (*evaluated, *untraced)
    data: Variables = {}
    for field, text in (("field", "field of the scene"), ("source", "where its range comes from")):
        data |= variable(f"prior_{field}", "prior", [getattr(one, field) for one in priors], text)
    ends = [[one.low, one.high] for one in priors]
    data |= variable("prior_range", ("prior", "end"), ends, "ends of the range that holds with 95 %")
    how = ["reweighted" if only_absorbs(scene, one) else "retraced" for one in evaluated]
    data |= variable("prior_how", "prior", [*how, *["not traced"] * len(untraced)], "how it was evaluated")
    names = ("prior", [one.name for one in priors], {"long_name": "what is unknown of the finger"})
    return xr.Dataset(data, {"prior": names})

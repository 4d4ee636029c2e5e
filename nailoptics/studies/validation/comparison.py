"""One measured quantity beside the model's: when they agree, and what is stated of it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from ...assets import read_toml
from ...checks import Array
from ...statistics import Z95, jackknife
from ..prior_uncertainty import PriorSensitivity

# Between these the coverage of a 95 % interval agrees with it; of fewer people only the lower end counts, as all of
# them lie within such an interval by chance more often than once in twenty.
COVERAGE, COVERAGE_OF_FEW, FEW = (0.85, 0.99), (0.85, 1.0), 59


@dataclass(frozen=True)
class Comparison:
    """One measured quantity beside the model's.

    texts : of the quantity in assets/real/quantities.toml, and the source of its table.
    people, model : (3, n) float. Lower end, middle and upper end.
    statistic : z, the difference in its standard errors, or coverage, the part that agrees.
    accepted : between which the statistic agrees.
    x : (n,) float. What the quantity is measured over; None of one number.
    """

    texts: Mapping[str, Any]
    people: Array
    model: Array
    statistic: str
    value: float
    accepted: tuple[float, float]
    x: Array | None = None

    @classmethod
    def by_standard_errors(
        cls, texts: Mapping[str, Any], people: tuple[float, float], model: tuple[float, float], spread: float = 0.0
    ) -> Self:
        """Two numbers, each with its standard error; spread: standard deviation of the model over the priors, shown."""
        z = (model[0] - people[0]) / float(np.hypot(people[1], model[1]))
        return cls(texts, interval(*people), interval(model[0], float(np.hypot(model[1], spread))), "z", z, (-2.0, 2.0))

    @classmethod
    def by_coverage(cls, texts: Mapping[str, Any], values: ArrayLike, model: Array) -> Self:
        """People's values, (p,) float, beside the model's interval, (3, 1) float."""
        people = np.percentile(np.asarray(values, float), [[2.5], [50], [97.5]])
        accepted = COVERAGE_OF_FEW if np.size(values) < FEW else COVERAGE
        return cls(texts, people, model, "coverage", part_between(values, *model[::2]), accepted)

    @classmethod
    def of_curve(cls, texts: Mapping[str, Any], inside: float, people: Array, model: Array, x: Array) -> Self:
        """A quantity over x, (n,), of people and of the model, (3, n) float each, and the part of it that agrees."""
        return cls(texts, people, model, "coverage", inside, COVERAGE_OF_FEW, x)

    @property
    def agrees(self) -> bool:
        """Whether model and people agree."""
        return bool(self.accepted[0] <= self.value <= self.accepted[1])

    def as_dict(self) -> dict[str, Any]:
        """All of it as plain numbers and texts."""
        out = dict(self.texts)
        for name, rows in (("people", self.people), ("model", self.model)):
            values = rows[:, 0] if self.x is None else rows
            out[name] = dict(zip(("low", "middle", "high"), values.tolist(), strict=True))
        if self.x is not None:
            out["over"] = {out.pop("x_label"): self.x.tolist()}
        return out | {self.statistic: self.value, "accepted": [*self.accepted], "agrees": self.agrees}


def texts_of(name: str, table: pd.DataFrame, **words: Any) -> dict[str, Any]:
    """What is stated of a quantity of a table of people, with words filled in."""
    stated = read_toml("real/quantities.toml")[name]
    texts = {key: text.format(**words) if isinstance(text, str) else text for key, text in stated.items()}
    if not texts.pop("fitted_to_any", False) and not table.attrs["shipped"]:
        texts |= {"basis": "prediction", "fit": "nothing was fitted to this table"}
    return texts | {"source": table.attrs["source"]}


def interval(value: float, stderr: float) -> Array:
    return np.array([[value - Z95 * stderr], [value], [value + Z95 * stderr]])


def part_between(values: ArrayLike, low: ArrayLike, high: ArrayLike) -> float:
    """The fraction of values that lie between two ends."""
    return float(((np.asarray(values) >= low) & (np.asarray(values) <= high)).mean())


def moments(answers: PriorSensitivity) -> tuple[Array, Array, Array]:
    """Mean over the priors, which the scene's own answer need not be; standard deviation with the noise of the
    light, and that noise, (...) float each."""
    shift, error = answers.shift
    noise = np.hypot(error, jackknife(answers.base_answer))
    return answers.base_answer[0] + shift, np.hypot(answers.total[0], noise), noise

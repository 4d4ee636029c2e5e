"""Prior ranges of a scene's fields, shipped with their sources and correlations, and a scene's own [priors]."""

import math
from collections.abc import Collection, Sequence
from functools import cache
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import Field

from ..assets import read_toml
from .base import Table, check_unique
from .body import Body
from .finger import Finger


class PriorRange(Table):
    """The prior range of one field, which replaces the shipped one."""

    field: str
    """The field, such as finger.plate_absorption."""
    low: float
    """Lower end; 2.5 % of fingers lie below."""
    high: float
    """Upper end; 2.5 % of fingers lie above."""

    def _check(self) -> None:
        if self.low >= self.high:
            raise ValueError(f"low = {self.low:g} must be below high = {self.high:g}")


class Prior(PriorRange):
    """What is known beforehand of one field, and from where."""

    name: str
    """What it is, in words."""
    scale: Literal["log", "linear"]
    """On which scale it is normal."""
    source: str
    """Where the range comes from."""


class FactorPrior(NamedTuple):
    """What is known, before any recording, of a factor on constants of the scene's finger that `calibrate` fits.

    spread : standard deviation, as a factor: two of three people lie within 1 / spread and spread.
    fields : the constants of the network that it multiplies; none where it is not the network's.
    """

    name: str
    spread: float
    fields: Sequence[str]
    text: str


class Priors(Table):
    """Prior uncertainty of the results; the ranges are shipped, with their sources."""

    spread: bool = True
    """Report the prior uncertainty of every result beside its standard error; priors of [body] in place and explore."""
    own_traces: bool | None = None
    """Include scattering and thickness, each of which takes two short traces; else absorption and blood only. If not
    given they are included but in place, where every layout would take as many."""
    known: tuple[str, ...] = ()
    """Fields whose value in the scene is known exactly, such as "blood.so2"."""
    ranges: Annotated[tuple[PriorRange, ...], Field(max_length=100)] = ()
    """Ranges that replace the shipped ones; such a field is independent of all others."""

    def _check(self) -> None:
        named = [*self.known, *(one.field for one in self.ranges)]
        check_unique(named, "known and ranges")
        shipped = {prior.field: prior for prior in shipped_priors()}
        for field in named:
            if field not in shipped:
                raise ValueError(f'"{field}" has no prior; choose from {", ".join(shipped)}')
        for one in self.ranges:
            if one.low <= 0 < shipped[one.field].low:
                raise ValueError(f"ranges: low = {one.low:g} must be above 0 for {one.field}")

    def of_finger(self, stated: Collection[str] = ()) -> tuple[Prior, ...]:
        """The shipped priors without the known fields and those of [body], with the scene's own ranges.

        stated : fields that are no unknowns of the scene, too.
        """
        unknown = (prior for prior in self._unknown() if prior.field not in stated)
        return tuple(prior for prior in unknown if not prior.field.startswith("body."))

    def of_body(self, body: Body | None) -> tuple[Prior, ...]:
        """The priors of [body] without the known fields, for the tables that it has."""
        tables = body.waves if body is not None else {}
        return tuple(one for one in self._unknown() if one.field.split(".")[1] in tables)

    def _unknown(self) -> tuple[Prior, ...]:
        own = {one.field: {"low": one.low, "high": one.high} for one in self.ranges}
        unknown = (prior for prior in shipped_priors() if prior.field not in self.known)
        return tuple(prior.model_copy(update=own.get(prior.field, {})) for prior in unknown)

    def correlation(self, priors: Sequence[Prior]) -> np.ndarray:
        """Correlations of some priors, each on its scale, (priors, priors) float; 0 with the scene's own ranges."""
        of = {prior.field: i for i, prior in enumerate(priors)}
        own = {one.field for one in self.ranges}
        matrix, shipped = np.eye(len(priors)), read_toml("priors.toml")
        sizes = [of[one["field"]] for one in shipped["sizes"]["priors"] if one["field"] in of]
        matrix[np.ix_(sizes, sizes)] += shipped["sizes"]["correlation"] * (1 - np.eye(len(sizes)))
        for one in shipped["correlations"]:
            first, second = one["fields"]
            if first in of and second in of and not own & {first, second}:
                matrix[of[first], of[second]] = matrix[of[second], of[first]] = one["value"]
        return matrix


@cache
def shipped_priors() -> tuple[Prior, ...]:
    """The priors of assets/priors.toml."""
    return tuple(Prior(**one) for one in read_toml("priors.toml")["priors"])


def size_priors(finger: Finger) -> tuple[Prior, ...]:
    """Those of the sizes of people's fingers, of which this finger's are the median."""

    def around(one: Prior) -> Prior:
        scale = getattr(finger, one.field.removeprefix("finger.")) / math.sqrt(one.low * one.high)
        return one.model_copy(update={"low": scale * one.low, "high": scale * one.high})

    return tuple(around(Prior(**one)) for one in read_toml("priors.toml")["sizes"]["priors"])


@cache
def factor_priors() -> dict[str, FactorPrior]:
    """Those of assets/priors.toml that `calibrate` fits, by name."""
    return {one["name"]: FactorPrior(**one) for one in read_toml("priors.toml")["factors"]}

"""Prior ranges of a scene's fields, shipped with their sources, and a scene's own [priors]."""

import tomllib
from functools import cache
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from ..assets import asset_path
from .base import Positive, Table, check_unique
from .body import Body


class PriorRange(Table):
    """The prior range of one field, which replaces the shipped one."""

    field: str
    """The field, such as finger.plate_absorption."""
    low: Positive
    """Lower end; 2.5 % of fingers lie below."""
    high: Positive
    """Upper end; 2.5 % of fingers lie above."""

    @model_validator(mode="after")
    def _ends_rise(self) -> Self:
        if self.low >= self.high:
            raise ValueError(f"low = {self.low:g} must be below high = {self.high:g}")
        return self


class Prior(PriorRange):
    """What is known beforehand of one field, and from where."""

    name: str
    """What it is, in words."""
    scale: Literal["log", "linear"]
    """On which scale it is normal."""
    source: str
    """Where the range comes from."""


class Priors(Table):
    """Prior uncertainty of the results; the ranges are shipped, with their sources."""

    spread: bool = True
    """Report the prior uncertainty of every result in addition to its standard error."""
    own_traces: bool = False
    """Include scattering and thickness, each of which takes two more traces; else absorption only."""
    known: tuple[str, ...] = ()
    """Fields whose value in the scene is known exactly, such as "blood.so2"."""
    ranges: Annotated[tuple[PriorRange, ...], Field(max_length=100)] = ()
    """Ranges that replace the shipped ones."""

    @model_validator(mode="after")
    def _names_unknowns(self) -> Self:
        named = [*self.known, *(one.field for one in self.ranges)]
        check_unique(named, "known and ranges")
        fields = [one.field for one in shipped_priors()]
        for field in named:
            if field not in fields:
                raise ValueError(f'"{field}" has no prior; choose from {", ".join(fields)}')
        return self

    def of_finger(self) -> tuple[Prior, ...]:
        """The shipped priors without the known fields and those of [body], with the scene's own ranges."""
        return tuple(one for one in self._unknown() if not one.field.startswith("body."))

    def of_body(self, body: Body | None) -> tuple[Prior, ...]:
        """The same of [body], for the tables that it has."""
        tables = body.waves if body is not None else {}
        return tuple(one for one in self._unknown() if one.field.split(".")[1] in tables)

    def _unknown(self) -> tuple[Prior, ...]:
        own = {one.field: {"low": one.low, "high": one.high} for one in self.ranges}
        return tuple(
            one.model_copy(update=own.get(one.field, {})) for one in shipped_priors() if one.field not in self.known
        )


@cache
def shipped_priors() -> tuple[Prior, ...]:
    """The priors of assets/priors.toml."""
    with asset_path("priors.toml").open("rb") as file:
        return tuple(Prior(**one) for one in tomllib.load(file)["priors"])

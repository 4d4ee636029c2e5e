"""The model every table of a scene is made from: frozen, strict, no unknown fields, no NaN."""

import ast
import inspect
import itertools
import textwrap
from collections import Counter
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field, GetJsonSchemaHandler, ValidationInfo, model_validator

from ..checks import as_input_error
from .text_files import frozen

# What a scene has where its author says nothing, and what later packages take where nobody says more.
USUAL_BLOOD_FRACTION = 0.03  # of the nail bed at rest: measured values span 0.01 to 0.05
USUAL_PULP_BLOOD_FRACTION = 0.024  # fitted to the skin of ring fingers: assets/spectra/fit_fingertip_skin.py
USUAL_SO2 = 0.97  # arterial blood of a healthy adult at sea level, whose pulse oximeter shows 95 to 99 %
USUAL_MELANIN_FRACTION = 0.013  # the middle of the 0.9 to 1.7 % that the epidermis beside nails holds
# Over such a length the bone's end stops to shield the bed: with it the white band is as wide as in the paper's Fig. 2.
USUAL_BONE_EDGE_MM = 0.8
USUAL_CONTACT_AREA_MM2 = 100.0  # 1 cm^2, on which 1 N presses with the paper's 1 N/cm^2

MOST_FORCE_N = 30.0  # of a finger; what is more was meant in another unit
LEAST_AREA_MM2 = 0.1  # of a contact: a pin's head; what is smaller pricks

# Planck's constant times the speed of light over the elementary charge: a photon of 1240 nm carries 1 eV.
PHOTON_NM_PER_V = 1239.841984


class Table(BaseModel):
    """One table of a scene file."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False)

    def __init__(self, **fields: Any) -> None:
        """A table built in Python, from lists and arrays, too; parts and files are looked for in the current folder.

        Raises: InputError, a line for each fault, with the field, the rule and the value.
        """
        if "schema_version" in type(self).model_fields:
            fields = {"schema_version": 1} | fields
        try:
            self.__pydantic_validator__.validate_python(frozen(fields), self_instance=self, context={"folder": Path()})
        except ValueError as error:
            raise as_input_error(error, type(self)) from None

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(f"{name} cannot be assigned: scenes are frozen; scene.with_(...) returns a changed copy.")

    # Tables of files are validated without it, whose faults are those of the whole file.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    @model_validator(mode="before")
    @classmethod
    def _is_filled(cls, data: object, info: ValidationInfo) -> object:
        return cls._filled(data, (info.context or {}).get("folder")) if isinstance(data, dict) else data

    @classmethod
    def _filled(cls, data: dict[str, Any], folder: Path | None) -> dict[str, Any]:
        """The table, not validated yet, with what a digit, part or file gives; files are looked for in the folder."""
        return data

    @model_validator(mode="after")
    def _is_checked(self) -> Self:
        self._check()
        return self

    def _check(self) -> None:
        """Raise ValueError where fields do not go together."""

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: Any, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """The JSON Schema, each field described by the text below it.

        Pydantic reads these texts, too (use_attribute_docstrings), but from the sources of all tables in every process.
        """
        schema = handler(core_schema)
        fields = handler.resolve_ref_schema(schema)["properties"]
        tables = [base for base in reversed(cls.__mro__) if issubclass(base, Table)]
        for table in tables:
            for name, text in _texts_below(table).items():
                fields[name]["description"] = text
        return schema


@cache
def _texts_below(table: type) -> dict[str, str]:
    """Each field that a class itself names, and the text below it."""
    (body,) = ast.parse(textwrap.dedent(inspect.getsource(table))).body
    assert isinstance(body, ast.ClassDef)
    texts = {}
    for field, below in itertools.pairwise(body.body):
        match field, below:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                texts[name] = inspect.cleandoc(text)
    return texts


# Elements of all photodiodes of a scene, read or not.
MOST_PHOTODIODES = 1024


def check_unique(names: Sequence[str], what: str) -> None:
    """Raise ValueError where a name is used twice."""
    for name, count in Counter(names).items():
        if count > 1:
            raise ValueError(f'{what}: the name "{name}" is used twice; give each its own')


Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Fraction = Annotated[float, Field(ge=0, le=1)]
# Lowest and highest pressures of arteries, which hold less than 60 kPa, and of veins. [Pa]
ARTERIAL_PA, VENOUS_PA = (-1e4, 6e4), (-5e3, 1e4)
ArterialPressure = Annotated[float, Field(ge=ARTERIAL_PA[0], le=ARTERIAL_PA[1])]
VenousPressure = Annotated[float, Field(ge=VENOUS_PA[0], le=VENOUS_PA[1])]
WaveAmplitude = Annotated[float, Field(ge=0, le=ARTERIAL_PA[1])]
Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_.\-]*$", max_length=40)]
Point = tuple[float, float]
Polygon = Annotated[tuple[Point, ...], Field(min_length=3)]
Size = tuple[Positive, Positive]

# Two opposite corners of a rectangle.
Box = tuple[float, float, float, float]


class Packaged(Table):
    """The face and the package of a part, in a part as in a scene."""

    height_um: Annotated[float, Field(ge=0, le=3000)] = 0.0
    """Height by which its face protrudes from the board's underside. [um]"""
    package_height_um: Annotated[float, Field(gt=0, le=20_000)] | None = None
    """Height of its package above the board. [um]"""
    lens: bool = False
    """Whether its angular pattern or response is that of a lens in air, which epoxy of about its index undoes."""
    price: Annotated[float, Field(ge=0)] | None = None
    """Price of one, in any currency that is that of all parts; of a die of a module, its part."""


def shifted(lines: Iterable[Polygon], by: Point) -> tuple[Polygon, ...]:
    """Lines on a board elsewhere. [mm]"""
    return tuple(tuple((x + by[0], y + by[1]) for x, y in line) for line in lines)

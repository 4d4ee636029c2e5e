"""The model every table of a scene is made from: frozen, strict, no unknown fields, no NaN."""

from collections.abc import Sequence
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

# What a scene has where its author says nothing, and what later rooms take where nobody says more.
USUAL_BLOOD_FRACTION = 0.03  # of the nail bed at rest: measured values span 0.01 to 0.05
USUAL_SO2 = 0.97  # arterial blood of a healthy adult at sea level, whose pulse oximeter shows 95 to 99 %
USUAL_MELANIN_FRACTION = 0.013  # the middle of the 0.9 to 1.7 % that the epidermis beside nails holds
# Of the distal pressure, in lengths of the bed: the white band takes a half of it from 1 to 4 N, and the distal reading
# stays linear to 1 N as in the paper's Fig. 17, which a shorter one bends.
USUAL_DECAY_LENGTH = 0.4
USUAL_CONTACT_AREA_MM2 = 100.0  # 1 cm^2, on which 1 N presses with the paper's 1 N/cm^2

# Planck's constant times the speed of light over the elementary charge: a photon of 1240 nm carries 1 eV.
PHOTON_NM_PER_V = 1239.841984


class Table(BaseModel):
    """One table of a scene file."""

    model_config = ConfigDict(
        frozen=True, strict=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True
    )


# Elements of all photodiodes of a scene, read or not.
MOST_PHOTODIODES = 1024


def check_unique(names: Sequence[str], what: str) -> None:
    """Raise ValueError where a name is used twice."""
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise ValueError(f'{what}: the name "{name}" is used twice; give each its own')
        seen.add(name)


Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_.\-]*$", max_length=40)]
Point = tuple[float, float]
Polygon = tuple[Point, ...]
Size = tuple[Positive, Positive]

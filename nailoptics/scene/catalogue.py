"""Parts by name: LED dies, photodiodes and modules of both from files, the user's own before the shipped ones."""

import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError

from ..assets import WAVELENGTH_RANGE_NM, data_dir
from ..checks import as_input_error, nearest
from ..errors import InputError
from .base import MOST_PHOTODIODES, PHOTON_NM_PER_V, Name, NonNegative, Packaged, Point, Positive, Size, Table
from .text_files import is_there, parse_toml, read_text, short

Angle = Annotated[float, Field(ge=0, le=90)]
# Rows of an angle and what is relative there. [deg, 1]
Rows = tuple[tuple[Angle, NonNegative], ...]


def check_pattern(rows: Rows, name: str) -> None:
    """Raise ValueError unless angles rise from 0, and there is light at one of them."""
    if len(rows) < 2 or rows[0][0] != 0 or _falls(rows) or not any(relative for _, relative in rows):
        raise ValueError(f"{name} must have two angles or more, rising from 0 to at most 90, and light at one of them")


def _falls(rows: Sequence[tuple[float, float]]) -> bool:
    """Whether the first numbers of rows do not rise."""
    return any(b <= a for (a, _), (b, _) in pairwise(rows))


# What of a part, or of one in a module, a scene has under no name, or another.
NOT_IN_SCENE = {"kind", "name", "position_mm"}


class LedPart(Packaged):
    """An LED die: spectrum, power and angular pattern."""

    kind: Literal["led"]
    peak_nm: Annotated[
        float, Field(ge=WAVELENGTH_RANGE_NM[0], le=WAVELENGTH_RANGE_NM[1], serialization_alias="wavelength_nm")
    ]
    """Peak wavelength. [nm]"""
    fwhm_nm: Annotated[float, Field(ge=0, le=200)]
    """Full width at half maximum of the spectrum; 0 for monochromatic light. [nm]"""
    flux_mw: Positive
    """Radiant flux. [mW]"""
    current_ma: Positive | None = None
    """Current of that flux. [mA]"""
    max_current_ma: Positive | None = None
    """Largest current of the LED, or of the driver in its module. [mA]"""
    die_size_mm: Annotated[Size, Field(serialization_alias="size_mm")] = (0.25, 0.25)
    """Size of the die across the nail (u) and along it (v). [mm]"""
    pattern: Literal["lambertian"] | Rows = "lambertian"
    """lambertian, or rows [angle_deg, relative intensity per solid angle]."""

    def _check(self) -> None:
        if self.pattern != "lambertian":
            check_pattern(self.pattern, "pattern")

    def scene_fields(self) -> dict[str, Any]:
        """The part under the names that an LED has in a scene."""
        fields = self.model_dump(by_alias=True, exclude=NOT_IN_SCENE)
        if self.pattern == "lambertian":
            return fields
        angle_deg, relative = zip(*self.pattern, strict=True)
        return fields | {"pattern": "measured", "pattern_deg": angle_deg, "pattern_relative": relative}


class PhotodiodeElements(Packaged):
    """A row of equal elements along the nail (v), in a part as in a scene."""

    elements: Annotated[int, Field(ge=1, le=MOST_PHOTODIODES)] = 1
    """Number of elements in a row along v."""
    pitch_mm: Positive | None = None
    """Pitch of the elements, centre to centre; their size along v if not given. [mm]"""
    quantum_efficiency: Annotated[float, Field(gt=0, le=1)] = 0.85
    """Electrons per incident photon."""
    responsivity: tuple[tuple[Positive, NonNegative], ...] | None = None
    """Rows [wavelength_nm, A/W], instead of one quantum efficiency; linear interpolation, zero outside."""
    angular_response: Rows | None = None
    """Rows [angle_deg, relative], for a collimated beam of one irradiance; the cosine if not given."""
    dark_current_na: NonNegative = 0.1
    """Dark current of one element. [nA]"""
    dark_current_doubling_k: Positive | None = None
    """Temperature rise that doubles the dark current, given at 25 degrees Celsius; constant if not given. [K]"""
    capacitance_pf: NonNegative = 0.0
    """Capacitance of one element, in addition to that of the amplifier's input. [pF]"""

    def _check(self) -> None:
        rows, angular = self.responsivity, self.angular_response
        if rows is not None and (len(rows) < 2 or _falls(rows)):
            raise ValueError("responsivity needs two rows [wavelength_nm, A/W] or more, wavelengths rising")
        for nm, value in rows or ():
            if value > nm / PHOTON_NM_PER_V * (1 + 1e-9):
                why = f"at {nm:g} nm is more than one electron per photon, {nm / PHOTON_NM_PER_V:.3g} A/W; correct it"
                raise ValueError(f"responsivity = {value:g} A/W {why}")
        if angular is None:
            return
        if len(angular) < 2 or angular[0] != (0, 1) or _falls(angular):
            raise ValueError("angular_response needs two rows [angle_deg, relative] or more from [0, 1], angles rising")
        last_deg, last = angular[-1]
        if last_deg == 90 and last > 0:
            raise ValueError(f"angular_response = {last:g} at 90 degrees, where no light meets the face; give 0")


class PhotodiodePart(PhotodiodeElements):
    """A photodiode, or a row of equal elements along the nail (v)."""

    kind: Literal["photodiode", "photodiode_array"]
    element_size_mm: Annotated[Size, Field(serialization_alias="size_mm")]
    """Size of the sensitive area of an element across the nail (u) and along it (v). [mm]"""
    dark_current_na: NonNegative
    """Dark current of one element. [nA]"""
    shunt_ohm: Positive = 1e9
    """Shunt resistance of one element. [ohm]"""

    def scene_fields(self) -> dict[str, Any]:
        """The part under the names that a photodiode has in a scene."""
        fields = self.model_dump(by_alias=True, exclude={*NOT_IN_SCENE, "shunt_ohm"}, exclude_none=True)
        return fields | {"shunt_mohm": self.shunt_ohm / 1e6}


class InModule(Table):
    """Where an LED or a photodiode is in its module."""

    name: Name
    """Its name, after that of the module."""
    position_mm: Point
    """Position of its centre relative to that of the package, oriented as in the footprint. [mm]"""


class ModuleLed(LedPart, InModule):
    """An LED in a module, at its position in the package."""

    kind: Literal["led"] = "led"


class ModulePhotodiode(PhotodiodePart, InModule):
    """A photodiode in a module, at its position in the package."""

    kind: Literal["photodiode"] = "photodiode"


class ModulePart(Table):
    """LEDs and photodiodes in one package."""

    kind: Literal["module"]
    leds: Annotated[tuple[ModuleLed, ...], Field(max_length=8)] = ()
    """Its LEDs."""
    photodiodes: Annotated[tuple[ModulePhotodiode, ...], Field(max_length=16)] = ()
    """Its photodiodes."""


Part = LedPart | PhotodiodePart | ModulePart
KINDS: dict[str, type[Part]] = {
    "led": LedPart,
    "photodiode": PhotodiodePart,
    "photodiode_array": PhotodiodePart,  # as it was called before
    "module": ModulePart,
}


def load_part(name: str, beside: Path | str | None = None, *, expect: type[Part] | None = None) -> Part:
    """Load a part by its name, from the folder of the user's scene or parts/ in it, else the shipped one.

    expect : `LedPart`, `PhotodiodePart` or `ModulePart`, where only that kind will do.

    Raises: InputError when there is no such part, when it breaks a rule, or when it is of the other kind.
    """
    path = _find_part(name, None if beside is None else Path(beside))
    shown = f"part {path}"
    tables = parse_toml(read_text(path, "a part (TOML)", shown=shown), shown)
    if (model := KINDS.get(str(tables.get("kind")))) is None:
        raise InputError(f'{shown}: kind must be "led", "photodiode" or "module"; set it')
    try:
        part = model.model_validate(tables)
    except ValidationError as error:
        raise as_input_error(error, model, shown) from None
    if expect is not None and not isinstance(part, expect):
        needed = next(kind for kind, model in KINDS.items() if model is expect)
        raise InputError(f'part "{name}" has kind "{part.kind}", and "{needed}" is needed here; name another part')
    return part


def _find_part(name: str, beside: Path | None) -> Path:
    if not re.fullmatch(r"\w[\w.-]*|\?", name):  # "?" is what a proposed map has where a part is to be chosen
        why = 'is not a name of letters, digits, "_", "-" and "."; give no path and no .toml'
        raise InputError(f'part "{short(name)}" {why}')
    shipped = data_dir("assets") / "parts"
    folders = [] if beside is None else [beside, beside / "parts"]
    for folder in (*folders, shipped):
        if is_there(path := folder / f"{name}.toml"):
            return path
    known = sorted(path.stem for path in shipped.glob("*.toml"))
    own = [] if beside is None else sorted(path.stem for path in (beside / "parts").glob("*.toml"))
    meant = f'did you mean "{near}"? Else ' if (near := nearest(name, [*own, *known])) else ""
    hint = "" if beside is None else f", or put your own PART.toml into the folder {beside / 'parts'}/"
    hint += f" (there is {short(', '.join(own))})" if own else ""
    raise InputError(f'part "{short(name)}" is unknown; {meant}choose one of {", ".join(known)}{hint}')

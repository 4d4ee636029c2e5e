"""Where the shipped facts lie: spectra, parts and scenes, from a wheel as from a source checkout."""

import re
import tomllib
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, overload

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, TypeAdapter, ValidationError

from .errors import InputError

_PACKAGE = Path(__file__).resolve().parent


def data_dir(name: Literal["assets", "scenes"]) -> Path:
    """Return the folder of the shipped assets or scenes.

    A wheel carries them inside the package (`_assets`, `_scenes`); a source checkout or an editable install has
    them beside it.
    """
    for folder in (_PACKAGE / f"_{name}", _PACKAGE.parent / name):
        if folder.is_dir():
            return folder
    raise InputError(
        f"the folder of the shipped {name} is missing: neither {_PACKAGE / f'_{name}'} nor {_PACKAGE.parent / name} "
        "exists; install nailoptics again"
    )


def asset_path(relative: str) -> Path:
    """Return the path of one shipped asset, such as "spectra/water.csv"."""
    path = data_dir("assets") / relative
    if not path.is_file():
        raise InputError(f'asset "{relative}" does not exist in {data_dir("assets")}; check its name')
    return path


@cache
def read_table(relative: str) -> dict[str, NDArray[np.float64]]:
    """Read a shipped CSV table into one read-only float array per column.

    Lines that begin with # are its citation; the first other line names the columns, with their units.
    """
    lines = [line for line in asset_path(relative).read_text(encoding="utf-8").splitlines() if line[:1] != "#"]
    columns = np.loadtxt(lines[1:], delimiter=",", ndmin=2).T
    columns.setflags(write=False)
    return dict(zip(lines[0].split(","), columns, strict=True))


def _pattern(value: object) -> object:
    rule = 'must be "lambertian" or rows [angle_deg, relative] with angles rising from 0 to at most 90, relative >= 0'
    if value == "lambertian":
        return value
    try:
        rows = np.asarray(value, dtype=float)
    except (TypeError, ValueError) as error:
        raise ValueError(rule) from error
    if rows.ndim != 2 or rows.shape[1] != 2 or len(rows) < 2 or not np.isfinite(rows).all():
        raise ValueError(rule)
    angle, relative = rows.T
    if angle[0] != 0 or angle[-1] > 90 or (np.diff(angle) <= 0).any() or (relative < 0).any() or not relative.any():
        raise ValueError(rule)
    return tuple(map(tuple, rows.tolist()))


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


# TOML writes 1 for 1.0 and lists for pairs; strict keeps strings and booleans out all the same.
Positive = Annotated[float, Field(gt=0, strict=True)]
Pair = Annotated[tuple[Positive, Positive], Field(strict=False)]


class LedPart(_Part):
    """An LED die: its line, power and angular pattern."""

    kind: Literal["led"]
    peak_nm: Annotated[float, Field(ge=450, le=1000)]
    fwhm_nm: Annotated[float, Field(ge=0, le=200)] = Field(description="0 makes a single line")
    flux_mw: Positive
    die_size_mm: Pair = Field(default=(0.25, 0.25), description="across the nail (u), along it (v)")
    pattern: Annotated[Literal["lambertian"] | tuple[tuple[float, float], ...], BeforeValidator(_pattern)] = Field(
        default="lambertian", description="lambertian, or rows [angle_deg, relative intensity per solid angle]"
    )

    def scene_fields(self) -> dict[str, Any]:
        """Return the part under the names that an LED has in a scene."""
        fields: dict[str, Any] = {
            "wavelength_nm": self.peak_nm,
            "fwhm_nm": self.fwhm_nm,
            "flux_mw": self.flux_mw,
            "size_mm": self.die_size_mm,
        }
        if self.pattern == "lambertian":
            return fields | {"pattern": "lambertian"}
        angle_deg, relative = zip(*self.pattern, strict=True)
        return fields | {"pattern": "measured", "pattern_deg": angle_deg, "pattern_relative": relative}


class PhotodiodeArrayPart(_Part):
    """A row of equal photodiode elements along the nail (v)."""

    kind: Literal["photodiode_array"]
    elements: Annotated[int, Field(ge=1, le=1024)]
    element_size_mm: Pair = Field(description="across the nail (u), along it (v)")
    pitch_mm: Positive = Field(description="from centre to centre, along v")
    quantum_efficiency: Annotated[float, Field(gt=0, le=1)]
    dark_current_na: Annotated[float, Field(ge=0)] = Field(description="of one element")
    shunt_ohm: Positive = Field(description="of one element")

    def scene_fields(self) -> dict[str, Any]:
        """Return the part under the names that a photodiode has in a scene."""
        return {
            "elements": self.elements,
            "size_mm": self.element_size_mm,
            "pitch_mm": self.pitch_mm,
            "quantum_efficiency": self.quantum_efficiency,
            "dark_current_na": self.dark_current_na,
            "shunt_mohm": self.shunt_ohm / 1e6,
        }


Part = LedPart | PhotodiodeArrayPart
_P = TypeVar("_P", LedPart, PhotodiodeArrayPart)
_ADAPTER: TypeAdapter[Part] = TypeAdapter(Annotated[Part, Field(discriminator="kind")])


@overload
def load_part(name: str, beside: Path | str | None = None, *, expect: None = None) -> Part: ...
@overload
def load_part(name: str, beside: Path | str | None = None, *, expect: type[_P]) -> _P: ...
def load_part(name: str, beside: Path | str | None = None, *, expect: type | None = None) -> object:
    """Load a part by name: the user's own beside their scene if there is one, else the shipped one.

    Parameters
    ----------
    name : the file's name without .toml, such as "led_800".
    beside : the folder of the user's scene; `name`.toml and parts/`name`.toml in it come first.
    expect : `LedPart` or `PhotodiodeArrayPart`, where only that kind will do.

    Raises InputError when there is no such part, when it breaks a rule, or when it is of the other kind.
    """
    path = _find_part(name, None if beside is None else Path(beside))
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"part {path} cannot be read: {error}") from error
    try:
        part = _ADAPTER.validate_python(raw)
    except ValidationError as error:
        raise InputError(f"part {path}: {one_line(error)}") from error
    if expect is not None and not isinstance(part, expect):
        wanted = expect.model_fields["kind"].annotation.__args__[0]  # type: ignore[attr-defined]
        raise InputError(f'part "{name}" has kind "{part.kind}", and "{wanted}" is needed here; name another part')
    return part


def _find_part(name: str, beside: Path | None) -> Path:
    if not re.fullmatch(r"\w[\w.-]*", name):
        raise InputError(f'part "{name}" is not a name of letters, digits, "_", "-" and "."; give no path and no .toml')
    shipped = data_dir("assets") / "parts"
    folders = [] if beside is None else [beside, beside / "parts"]
    for folder in (*folders, shipped):
        if (path := folder / f"{name}.toml").is_file():
            return path
    known = ", ".join(sorted(path.stem for path in shipped.glob("*.toml")))
    own = "" if beside is None else f", or put your own {name}.toml into {beside}"
    raise InputError(f'part "{name}" is unknown; choose one of {known}{own}')


def one_line(error: ValidationError) -> str:
    """Say the first thing that pydantic found wrong in one line: field, rule, value."""
    first = error.errors(include_url=False)[0]
    # Tags of a union are pydantic's own words, not fields that the user wrote.
    tags = {"led", "photodiode_array"}
    field = ".".join(str(item) for item in first["loc"] if item not in tags and "[" not in str(item)) or "kind"
    if first["type"] == "extra_forbidden":
        return f"{field} is not a known field (value {first['input']!r}); remove it or correct its spelling"
    if first["type"] == "missing":
        return f"{field} is missing; add it"
    if first["type"].startswith("union_tag"):
        return 'kind must be "led" or "photodiode_array"; set it'
    rule = first["msg"].removeprefix("Value error, ").replace("Input should be", "must be")
    return f"{field} = {first['input']!r} {rule}; correct it"

"""What can be requested of every command and function that traces light, beside the scene: one object, passed whole."""

import inspect
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, Self, TypedDict, cast, get_args, get_type_hints

import numpy as np

from . import checks
from .errors import InputError

# More than any machine traces in a year; a slip of the keyboard should not start it.
MAX_PHOTONS = 10_000_000_000

BackendName = Literal["auto", "cuda", "llvm", "metal", "scalar"]
FormatName = Literal["glb", "ply", "kicad_pcb", "spice", "mmc", "mcx", "mitsuba"]
Illuminant = Literal["D65", "A", "LED-B3"]
LightFrom = Literal["sky", "lamp"]
Observer = Literal["2", "10"]
Over = Literal["force", "blood", "saturation"]


class Requested(TypedDict, total=False):
    """The fields of `TraceOptions` as keyword arguments."""

    seed: int
    backend: BackendName
    relative_error: float | None
    max_seconds: float | None
    photons: int | None
    store: bool


@dataclass(frozen=True, kw_only=True)
class TraceOptions:
    """How light is traced: which random numbers, on what, and how far.

    Whatever of relative_error, max_seconds and photons is not given is taken from the scene, if none of the three is.
    Raises InputError for values that none can have.
    """

    seed: int = 0
    """Same seed, same bits, on one backend."""
    backend: BackendName = "auto"
    """Backend of the light transport: auto selects the fastest that works here."""
    relative_error: float | None = None
    """Relative standard error that every reading must reach."""
    max_seconds: float | None = None
    """Wall time after which tracing ends with what there is; a command keeps a tenth of it for its files. [s]"""
    photons: int | None = None
    """Photons per LED (or wavelength, where none shines), in place of a tolerance."""
    store: bool = True
    """Keep what is traced on disk, and take what was traced before: same seed, same bits."""

    def __new__(cls, **fields: Any) -> Self:
        for name in fields.keys() - cls.__dataclass_fields__.keys():
            nearest = checks.nearest(name, cls.__dataclass_fields__, cutoff=0)
            raise InputError(f"{name} = {fields[name]!r} is not an option here; did you mean {nearest}?")
        return super().__new__(cls)

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if isinstance(value, np.generic):
                object.__setattr__(self, name, value.item())
        checks.seed(self.seed)
        if isinstance(self.photons, float) and self.photons.is_integer():  # 1e6
            object.__setattr__(self, "photons", int(self.photons))
        if self.backend not in get_args(BackendName):
            raise InputError(f'backend = "{self.backend}" is unknown; choose from {", ".join(get_args(BackendName))}.')
        for name, most in {"relative_error": 1.0, "max_seconds": math.inf, "photons": MAX_PHOTONS}.items():
            value, known = getattr(self, name), int if name == "photons" else int | float
            if value is None or isinstance(value, known) and not isinstance(value, bool) and 0 < value <= most:
                continue
            end = "" if math.isinf(most) else f" and at most {most:g}"
            raise InputError(f"{name} = {value!r}; must be a {'whole ' * (known is int)}number above 0{end}.")

    @property
    def fields(self) -> Requested:
        """The options as keyword arguments."""
        return cast(Requested, {name: getattr(self, name) for name in Requested.__annotations__})


def spell_out(study: Callable[..., Any]) -> None:
    """Show in a function's signature, for help and completion, the options that its `**requested` takes."""
    signature = inspect.signature(study)
    *own, last = signature.parameters.values()
    if last.name == "requested":
        (table,) = get_args(last.annotation)
        kind, taken = inspect.Parameter.KEYWORD_ONLY, get_type_hints(table).items()
        options = [inspect.Parameter(n, kind, default=getattr(TraceOptions, n, None), annotation=a) for n, a in taken]
        vars(study)["__signature__"] = signature.replace(parameters=[*own, *options])

"""What every package asks of its input, and the one translator of a validation's complaints into a user's lines."""

import difflib
import json
import re
from collections.abc import Callable, Iterable, Sequence
from itertools import takewhile
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import InputError
from .variables import unit_of

if TYPE_CHECKING:
    from pydantic import BaseModel

Array = NDArray[np.float64]


def _floats(name: str, value: ArrayLike) -> Array:
    try:
        return np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{name} must be numbers, got {value!r}; give a number or an array.") from None


def finite(name: str, value: ArrayLike) -> Array:
    """The value as an array of floats; InputError where one is not a finite number."""
    return _where(np.isfinite, name, value, "must be finite; replace NaN and inf")


def number(name: str, value: ArrayLike) -> float:
    """The value as one float; InputError if it is not a finite number."""
    array = finite(name, value)
    if array.shape:
        raise InputError(f"{name} must be one number, got {value!r}; give a single one.")
    return float(array)


def not_negative(name: str, value: ArrayLike) -> Array:
    """The value as an array of floats; InputError where one is negative or not finite."""
    return _where(lambda x: np.isfinite(x) & (x >= 0), name, value, "must be finite and not negative; correct it")


def positive(name: str, value: ArrayLike) -> Array:
    """The value as an array of floats; InputError where one is not positive or not finite."""
    return _where(lambda x: np.isfinite(x) & (x > 0), name, value, "must be finite and greater than 0; correct it")


def fraction(name: str, value: ArrayLike, cure: str = "choose from 0 to 1") -> Array:
    """The value as an array of floats; InputError, with its cure, where one lies outside 0 to 1."""
    return _where(lambda x: (x >= 0) & (x <= 1), name, value, f"is not a fraction; {cure}")


def tolerance(name: str, value: ArrayLike) -> float:
    """The value as one float; InputError unless it lies above 0 and below 1."""
    return float(_where(lambda x: (x > 0) & (x < 1), name, value, "must lie above 0 and below 1; give 0.05 for 5 %"))


def _where(is_valid: Callable[[Array], NDArray[np.bool_]], name: str, value: ArrayLike, rule: str) -> Array:
    array = _floats(name, value)
    if not (valid := is_valid(array)).all():
        where = np.argwhere(~valid)[0].tolist() or ""
        raise InputError(f"{name}{where} = {array[~valid].flat[0]:g} {rule}")
    return array


def nearest(name: str, known: Iterable[str], *, cutoff: float = 0.6) -> str:
    """The known name that a name was probably meant to be; empty where none is near."""
    return next(iter(difflib.get_close_matches(name, list(known), n=1, cutoff=cutoff)), "")


def seed(value: int) -> int:
    """The seed; InputError if it is not a whole number of at least 0 and below 2^63."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not 0 <= value < 2**63:
        raise InputError(f"seed = {value}; must be a whole number of at least 0 and below 2^63.")
    return int(value)


# Faults of one input that are named.
MOST_FAULTS = 10
# What pydantic puts below a field of several kinds: one of them, such as constrained-float or tuple[float, float].
KIND = re.compile(r"(constrained-)?(float|int|str|bool)|[\w-]*\[.*\]")


def as_input_error(error: Exception, model: "type[BaseModel]", name: str = "") -> InputError:
    """The faults of a validation, a line each: field, rule, value, what to do; of many the first `MOST_FAULTS`.

    name : what each line begins with, such as that of the file. Other errors keep their own lines.
    """
    from pydantic import ValidationError

    lines = list(error.args) if isinstance(error, InputError) else [str(error)]
    if isinstance(error, ValidationError):
        faults = error.errors(include_url=False)
        # An array with a faulty item is also called too short; once is enough.
        faults, lines = [f for f in faults if f["type"] != "too_short" or not f["input"]] or faults, []
        if any(f["loc"][:1] == ("board",) for f in faults):  # whose file may have the LEDs
            faults = [f for f in faults if f["loc"] != ("leds",)]
        while faults:
            location = faults[0]["loc"]
            field = tuple(takewhile(lambda part: not KIND.fullmatch(str(part)), location))
            kinds = [f for f in faults if f["loc"][: len(field)] == field] if field != location else faults[:1]
            lines.append(_line(kinds, model))
            faults = [f for f in faults if f not in kinds]
        if len(lines) > MOST_FAULTS:
            lines[MOST_FAULTS:] = [f"{len(lines) - MOST_FAULTS} more; correct these first."]
    return InputError(*(f"{name}: {line}" if name else line for line in lines))


def _line(kinds: Sequence[Any], model: "type[BaseModel]") -> str:
    """The line of one field's faults; of a field of several kinds with rules of those that the value is nearest to."""
    fault = max(kinds, key=lambda f: len(f["loc"]))
    where = _place(fault)
    rules = dict.fromkeys(_rule(f["msg"]) for f in kinds if _place(f) == where)
    value = fault.get("input")
    if fault["type"] == "extra_forbidden":
        known = _fields_at(model, fault["loc"][:-1])
        close = nearest(str(fault["loc"][-1]), known)
        cure = f'did you mean "{close}"?' if close else f"known here: {', '.join(known)}."
        return f"{where} is not a known field; {cure}"
    if fault["type"] == "missing":
        return f"{where} is missing; add {'schema_version = 1' if where == 'schema_version' else 'it'}."
    if fault["type"] == "value_error":
        return (f"{where}: " if where else "") + str(fault["ctx"]["error"]) + "."
    shown = json.dumps(value, default=str) if not isinstance(value, dict) else "a table"
    return f"{where} = {shown[:60]}: must {' or '.join(rules)}{_cure(fault, where)}."


def _cure(fault: Any, where: str) -> str:
    """What else to do about a value of the wrong size or kind, after a semicolon."""
    kind, value, unit = fault["type"], fault["input"], unit_of(where)
    if isinstance(value, dict) and kind == "tuple_type" and "[" not in where:
        return f"; write [[{where}]], in double brackets, for each"
    if isinstance(value, str) and kind in ("float_type", "int_type"):
        return f"; give {f'it in {unit}, ' if unit != '1' else ''}a number without unit and quotes"
    if kind == "less_than_equal" and unit == "1" and fault["ctx"]["le"] == 1 and 2 < value <= 100:
        return f"; it is a fraction, not percent: {value:g} % is {value / 100:g}"
    return f"; give it in {unit}" if kind.startswith(("greater_than", "less_than")) and unit != "1" else ""


def _place(fault: Any) -> str:
    """The field of a fault as a dotted path; an unknown one may be called as a kind is."""
    unknown = fault["type"] == "extra_forbidden"
    parts = (p for p in fault["loc"] if unknown or not KIND.fullmatch(str(p)))
    return "".join(f"[{p}]" if isinstance(p, int) else f".{p}" for p in parts).lstrip(".")


def _rule(message: str) -> str:
    """Pydantic's rule in TOML's words: "Tuple should have at least 1 item ..." is "have at least 1 item ..."."""
    rule = re.sub(r"^(Input|Value|Tuple|String) should ", "", message)
    name = "begin with a letter and hold only letters, digits, _, . and -"
    rule = re.sub(r"match pattern '\^\[A-Za-z\].*", name, rule)
    rule = re.sub(r"a valid dictionary( or instance of \w+)?", "a table", rule)
    return rule.replace("a valid tuple", "an array").replace(" after validation", "")


def _fields_at(model: "type[BaseModel]", location: tuple[int | str, ...]) -> list[str]:
    """Names of the fields of the table at a location in a model."""
    current: Any = model
    for part in location:
        if isinstance(part, int):
            continue
        annotation = current.model_fields[part].annotation if part in current.model_fields else None
        models = _models_in(annotation)
        if not models:
            return []
        current = models[0]
    return list(current.model_fields)


def _models_in(annotation: Any) -> "list[type[BaseModel]]":
    from pydantic import BaseModel

    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [m for argument in getattr(annotation, "__args__", ()) for m in _models_in(argument)]

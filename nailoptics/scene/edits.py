"""Values put at dotted paths of a scene's tables: by the axes of a sweep, and by edits in Python."""

import re
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from ..errors import InputError
from .base import Table
from .parts import FROM_PART, BoardFile
from .text_files import short


def steps_of(path: str) -> list[str | int]:
    """A dotted path as keys and indices: leds[0].flux_mw is leds, 0, flux_mw; raises ValueError."""
    steps: list[str | int] = []
    for part in path.split("."):
        match = re.fullmatch(r"([\w\-]+)((?:\[\d+\])*)", part)
        if not match:
            raise ValueError(f'"{path}": "{part}" is no field; write it as in leds[0].flux_mw')
        steps.append(match[1])
        steps += [int(n) for n in re.findall(r"\d+", match[2])]
    return steps


def with_value(item: Any, steps: Sequence[str | int], value: Any, path: str) -> Any:
    """A copy of tables and arrays with a value at a place, in arrays by number or name; raises InputError."""
    if not steps:
        return value
    step, *rest = steps
    if isinstance(item, Table):
        item = _defining_fields(item)
    if isinstance(item, dict) and isinstance(step, str):
        if not rest:
            item = _without_read(item, step, path)
        return item | {step: with_value(item.get(step) or {} if rest else None, rest, value, path)}
    if not isinstance(item, tuple):
        raise InputError(f'path "{path}" goes on at {step!r} where the scene has a value; correct the path.')
    names = [_name(row) for row in item]
    if step not in names and not (isinstance(step, int) and 0 <= step < len(item)):
        array = str(step).rpartition(".")[0]
        why = f"{step} is an element of the array {array}" if array in names else f"there is no item {step} here"
        known = ", ".join(["0" if len(item) == 1 else f"0 to {len(item) - 1}", *filter(None, names)])
        raise InputError(short(f'path "{path}": {why}; known: {known}', 300) + ".")
    i = step if isinstance(step, int) else names.index(step)
    return (*item[:i], with_value(item[i], rest, value, path), *item[i + 1 :])


def _name(row: Any) -> str | None:
    if isinstance(row, Table):
        return getattr(row, "name", None)
    name = row.get("name", row.get("part", row.get("array"))) if isinstance(row, dict) else None
    return name if isinstance(name, str) else None


def _defining_fields(table: Table) -> dict[str, Any]:
    """The fields that make a table, without those that a part, a digit, a profile or a default gives again."""
    fields = table.model_dump(exclude_unset=True, exclude_none=True)
    for name in [*fields]:
        fewer = {other: value for other, value in fields.items() if other != name}
        with suppress(InputError):
            if type(table)(**fewer) == table:
                fields = fewer
    return fields


def _without_read(table: dict[str, Any], field: str, path: str) -> dict[str, Any]:
    """A table without what was read from the file that a field names, which another one replaces.

    Raises: InputError where a change of the field would have no effect.
    """
    if table.get("unmapped") is not None and field in BoardFile.model_fields:
        raise InputError(f"{path}: the file of the board has been read; read it again, as with Scene.from_kicad.")
    if field in ("part", "array") and any(given <= table.keys() for given in FROM_PART.values()):
        raise InputError(
            f"{path}: all that a part gives is written out here, or its old part is not in this folder; give its "
            "values instead, or leave them out."
        )
    return {name: value for name, value in table.items() if field != "file" or not name.startswith("recorded_")}

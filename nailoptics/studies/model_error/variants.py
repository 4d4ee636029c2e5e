"""A scene with something else in it, and the lines of a scene file that make it so."""

from typing import Any

from ...errors import InputError
from ...scene import Led, Scene
from ...scene.catalogue import LedPart, load_part
from ...scene.files import scene_of

# Fields by table of the scene; those of "leds" and "photodiodes" are every one's, None stands for what its part says.
Changes = dict[str, dict[str, Any]]
EACH = ("leds", "photodiodes")
ONE_WAVELENGTH: Changes = {"leds": {"fwhm_nm": 0.0}}
PART_WIDTH: Changes = {"leds": {"fwhm_nm": None}}


def part_width_nm(led: Led) -> float:
    """Line width that an LED's part has; its own if it has no part that can be found."""
    try:
        part = load_part(led.part, expect=LedPart) if led.part else led
        return float(part.fwhm_nm) if isinstance(part, LedPart) else led.fwhm_nm
    except InputError:
        return led.fwhm_nm


def revised(scene: Scene, changes: Changes) -> Scene:
    """The scene with some fields of some of its tables changed; raises InputError where that makes no scene."""
    tables = scene.model_dump()
    for table, fields in changes.items():
        if table not in EACH:
            tables[table] |= {name: tuple(v) if isinstance(v, list) else v for name, v in fields.items()}
            continue
        changed = [{name: value for name, value in fields.items() if value is not None}] * len(tables[table])
        if PART_WIDTH["leds"].items() <= fields.items():
            changed = [one | {"fwhm_nm": part_width_nm(led)} for one, led in zip(changed, scene.leds, strict=True)]
        tables[table] = tuple(one | other for one, other in zip(tables[table], changed, strict=True))
    return scene_of(tables)


def changes_between(scene: Scene, other: Scene) -> Changes:
    """What of its light, and of its LEDs' line widths, makes one scene the other."""
    before, after = scene.light.model_dump(mode="json"), other.light.model_dump(mode="json")
    light = {name: value for name, value in after.items() if value != before[name]}
    changes: Changes = {"light": light} if light else {}
    if [led.fwhm_nm for led in scene.leds] != [led.fwhm_nm for led in other.leds]:
        changes |= PART_WIDTH if any(led.fwhm_nm for led in other.leds) else ONE_WAVELENGTH
    return changes


def lines_of(changes: Changes) -> list[str]:
    """The lines of a scene file that make these changes, each with the table that it belongs in before it."""
    import tomli_w

    lines = []
    for table, fields in changes.items():
        for name, value in fields.items():
            place = f"[[{table}]]" if table in EACH else f"[{table}]"
            text = f"without {name}" if value is None else " ".join(tomli_w.dumps({name: value}).split())
            lines.append(f"{place} {text}".replace("[ ", "[").replace(", ]", "]"))
    return lines

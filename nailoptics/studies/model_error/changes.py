"""What explain changes of a scene: every part and effect, all unknown parameters, and the scene lines that do so."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...errors import InputError
from ...scene import Led, Prior, Scene
from ...scene.catalogue import LedPart, load_part
from ...scene.files import scene_of
from ...scene.layout import LEAST_EPOXY_UM
from ..prior_uncertainty import value_of

AIR_UM = 25.0  # of a board that is lifted, or not bonded; what light meets there hardly depends on it
DIE_UM = 150.0  # dies of LEDs and photodiodes are 100 to 250 um thick
# Fields by table of the scene; those of "leds" and "photodiodes" are every one's, None stands for what its part says.
Changes = dict[str, dict[str, Any]]
EACH = ("leds", "photodiodes")
ONE_WAVELENGTH: Changes = {"leds": {"fwhm_nm": 0.0}}
PART_WIDTH: Changes = {"leds": {"fwhm_nm": None}}


@dataclass(frozen=True)
class Change:
    """One part or effect of a scene, whether the scene models it, and what the scene would have in its place.

    changes : what of the scene makes it so; nothing where no line can.
    unknown : whether it is no part but something unknown of the finger, at an end of its range, or of the sensor.
    """

    name: str
    modelled: bool
    changed_to: str
    changes: Changes = field(default_factory=dict)
    unknown: bool = False


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
            changed = [row | {"fwhm_nm": part_width_nm(led)} for row, led in zip(changed, scene.leds, strict=True)]
        tables[table] = tuple(row | new for row, new in zip(tables[table], changed, strict=True))
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


def merged(changed: Iterable[Change]) -> Changes:
    """All their changes at once; a part is left out, or put in, beside what others do to the same list."""
    out: Changes = {}
    for effect in changed:
        for table, fields in effect.changes.items():
            for name, value in fields.items():
                before = out.setdefault(table, {}).get(name)
                if name == "left_out" and before is not None:
                    value = sorted(set(value) | set(before)) if effect.modelled else sorted(set(value) & set(before))
                out[table][name] = value
    if "epidermis" in out.get("light", {}).get("left_out", ()):
        # Its melanin goes with it.
        out.get("finger", {}).pop("melanin_fraction", None)
    return {table: fields for table, fields in out.items() if fields}


def changes_of(scene: Scene) -> Iterator[Change]:
    """Every part and effect of a scene, then all priors, each with what leaves it out, or puts it in."""
    yield from _parts(scene)
    if scene.priors.spread:
        yield from (_unknown(scene, prior) for prior in scene.finger_priors)


def _unknown(scene: Scene, prior: Prior) -> Change:
    """A prior at that end of its range which is farther from the scene's value, on the prior's scale."""
    ends = (prior.low, value_of(scene, prior.field), prior.high)
    low, middle, high = np.log(ends) if prior.scale == "log" else ends
    # A nudge, so that rounding does not decide between ends that are as far.
    end = prior.low if middle - low > high - middle + 1e-3 else prior.high
    table, name = prior.field.split(".")
    text = f"{name} = {end:g}, of {prior.low:g} to {prior.high:g}"
    return Change(prior.name, True, text, {table: {name: end}}, unknown=True)


def _parts(scene: Scene) -> Iterator[Change]:
    """The scene's parts and effects, each with what leaves it out, or puts it in."""
    light, board, finger = scene.light, scene.board, scene.fingertip
    steps, similar, melanin = light.index_steps, light.similarity, finger.melanin_fraction
    text = "one index everywhere" if steps else "refraction where the index changes"
    yield Change("index steps", steps, text, {"light": {"index_steps": not steps}})
    text = "Henyey-Greenstein" if similar else "isotropic with the same mu_s'"
    yield Change("forward scattering", not similar, text, {"light": {"similarity": not similar}})
    for part in ("bone", "epidermis", "kapton"):
        gone = part in light.left_out
        left = [p for p in light.left_out if p != part] if gone else [*light.left_out, part]
        its_own = "optics of its own" + (", melanin" if part == "epidermis" else "")
        text = its_own if gone else "optics of what surrounds it"
        yield Change(part, not gone, text, {"light": {"left_out": left}})
    if any(led.fwhm_nm for led in scene.leds):
        yield Change("LED line width", True, "peak wavelength alone", ONE_WAVELENGTH)
    elif any(part_width_nm(led) for led in scene.leds):
        yield Change("LED line width", False, "as its part has", PART_WIDTH)
    if "epidermis" not in light.left_out:
        usual = type(finger).model_fields["melanin_fraction"].default
        text = "none" if melanin else f"{usual:.1%} of the epidermis"
        yield Change("melanin", melanin > 0, text, {"finger": {"melanin_fraction": 0.0 if melanin else usual}})
    if board.opaque_reflectance:
        yield Change("opaque epoxy's reflection", True, "black", {"board": {"opaque_reflectance": 0.0}})
    if board.barrier:
        yield Change("barrier", True, "clear epoxy in its place", {"board": {"barrier": False}})
    stand_out = any(led.height_um for led in scene.leds) or any(p.height_um for p in scene.photodiodes)
    height_um = 0.0 if stand_out else min(DIE_UM, board.clear_epoxy_um - LEAST_EPOXY_UM)
    text = "flush with the board's underside" if stand_out else f"standing {height_um:g} um out of the board"
    if stand_out or height_um:
        # A scene that says nothing of it leaves it unknown: what it requires is not to be guessed.
        heights: Changes = {table: {"height_um": height_um} for table in EACH}
        yield Change("height of dies", True, text, heights, unknown=not stand_out)
    bonded = board.air_gap_um is None
    text = f"{AIR_UM:g} um of air on the nail" if bonded else "adhesive on the nail"
    air: Changes = {"board": {"air_gap_um": AIR_UM if bonded else None}}
    yield Change("air under the board", True, text, air, unknown=bonded)
    if not board.cover_um:
        cover = type(board).model_fields["cover_um"].default
        yield Change("cover and decorative nail", False, "opaque cover", {"board": {"cover_um": cover}})

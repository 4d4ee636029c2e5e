"""A scene: a finger or a phantom, with the LEDs and photodiodes that look at it."""

import re
from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Field

from ..assets import WAVELENGTH_RANGE_NM
from ..display import Displayed
from ..errors import InputError
from .base import MOST_PHOTODIODES, Table, check_unique
from .body import Body
from .electronics import DARK, Ambient, Electronics, Oximeter, two_leds
from .finger import Finger, Phantom
from .layout import Layout, lay_out
from .parts import FROM_PART, Board, BoardFile, Led, Photodiode
from .placement import Placement
from .priors import Prior, Priors
from .text_files import short
from .touch import Touch
from .tracing import Accuracy, Light, Viewing
from .vessels import Blood

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Scene(Displayed, Table):
    """A scene: everything that determines the result."""

    schema_version: Literal[1]
    """Version of this format."""
    phantom: Phantom | None = None
    """A stack of layers instead of the finger."""
    finger: Finger | None = None
    """The finger."""
    blood: Blood = Blood()
    """Blood in the nail bed."""
    touch: Touch = Touch()
    """Force over time."""
    body: Body | None = None
    """Physiological noise, drift and motion; none if not given."""
    board: Board = Board()
    """The board on the nail."""
    leds: Annotated[tuple[Led, ...], Field(min_length=1, max_length=64)]
    """The LEDs, multiplexed in time."""
    photodiodes: Annotated[tuple[Photodiode, ...], Field(max_length=MOST_PHOTODIODES)] = ()
    """The photodiodes."""
    electronics: Electronics = Electronics()
    """Amplifier and converter."""
    ambient: Ambient | None = None
    """Light from outside; none if not given, for nailoptics oximeter a lamp of 1000 lux."""
    oximeter: Oximeter | None = None
    """LED timing of the pulse oximeter."""
    colour: Viewing = Viewing()
    """Viewing conditions for the colour of the bare nail."""
    light: Light = Light()
    """How the light is traced."""
    accuracy: Accuracy = Accuracy()
    """Required accuracy."""
    priors: Priors = Priors()
    """Prior uncertainty of the finger."""
    placement: Placement | None = None
    """Constraints and objective of the layout search."""

    @classmethod
    def _filled(cls, data: dict[str, Any], folder: Path | None) -> dict[str, Any]:
        data = cls._with_board_file(data, folder)
        # Old places of bed_scattering, once in [light], and of ambient_light and ambient_lux, once in [oximeter].
        light, oximeter, old = data.get("light"), data.get("oximeter"), {"ambient_light", "ambient_lux"}
        if isinstance(light, dict) and "bed_scattering" in light:
            data = data | {"light": {name: value for name, value in light.items() if name != "bed_scattering"}}
            if isinstance(data.get("finger"), dict):
                data["finger"] = {"bed_scattering": light["bed_scattering"]} | data["finger"]
        if isinstance(oximeter, dict) and "ambient" not in data and old & oximeter.keys():
            data = data | {"oximeter": {name: value for name, value in oximeter.items() if name not in old}}
            kind, lux = oximeter.get("ambient_light", "lamp"), oximeter.get("ambient_lux", 1000.0)
            data["ambient"] = {"kind": kind, "illuminance_lux": lux}
        return data

    @staticmethod
    def _with_board_file(data: dict[str, Any], folder: Path | None) -> dict[str, Any]:
        board = data.get("board")
        if not isinstance(board, dict) or not Board.is_to_be_read(board):
            return data
        if not all(isinstance(data.get(name, ()), tuple) for name in ("leds", "photodiodes")):
            return data
        from .importers.board_files import read_board_file

        try:
            leds, photodiodes, own = read_board_file(board, folder)
        except (InputError, ValueError) as error:
            raise ValueError(f"board: {str(error).rstrip('.')}") from None
        data = data | {"placement": _with_map(data.get("placement"), board.get("parts"))}
        parts = {"leds": (*data.get("leds", ()), *leds), "photodiodes": (*data.get("photodiodes", ()), *photodiodes)}
        return data | {"board": board | own} | parts

    def _check(self) -> None:
        if (self.phantom is None) == (self.finger is None):
            raise ValueError("a scene has either [finger] or [phantom]; give exactly one of them")
        auto = 'electronics.feedback_ohm = "auto"' if self.electronics.feedback_ohm == "auto" else None
        for needs in filter(None, (self.ambient and "ambient", self.oximeter and "oximeter", auto)):
            if self.phantom is not None:
                why = "a [phantom] is read as fractions, not in volts: leave it out"
                raise ValueError(f"{needs} needs a [finger]; {why}")
        check_unique([led.name for led in self.leds], "leds")
        elements = [name for p in self.photodiodes for name in p.element_names()]
        check_unique(elements, "photodiodes")
        if len(elements) > MOST_PHOTODIODES:
            raise ValueError(f"photodiodes: have {len(elements)} elements; at most {MOST_PHOTODIODES}, leave some out")
        for i, led in enumerate(self.leds):
            if self.finger is not None and led.pattern == "pencil":
                why = 'is for phantoms; a die on a board is "lambertian" or "measured"'
                raise ValueError(f'leds[{i}].pattern = "pencil" {why}')
            low, high = WAVELENGTH_RANGE_NM
            if self.finger is not None and not low <= led.wavelength_nm <= high:
                why = f"has no tissue data, which reach from {low:g} to {high:g} nm; choose a wavelength in there"
                raise ValueError(f"leds[{i}].wavelength_nm = {led.wavelength_nm:g} {why}")
        for i, photodiode in enumerate(self.photodiodes):
            if photodiode.aperture != (self.phantom is not None):
                why = (
                    "must be true in a phantom, which has no board" if self.phantom else "is for phantoms; leave it out"
                )
                raise ValueError(f"photodiodes[{i}].aperture {why}")
        if self.finger is not None and not self.photodiodes:
            raise ValueError("photodiodes: a finger scene needs at least one")
        # The board is laid out here so that every impossible layout is the scene's own error.
        if self.finger is not None:
            lay_out(self.finger, self.board, self.leds, self.photodiodes)
        self._body_suits_vessels_and_touch()
        self._slots_and_zones_fit()

    def _body_suits_vessels_and_touch(self) -> None:
        heartbeat, tuning = (self.body.heartbeat if self.body else None), self.blood.tuning
        if heartbeat is not None and heartbeat.mean_pressure_pa is not None and tuning is not None:
            if "arterial_pressure_pa" in {*tuning.values(), *(tuning.factors or {})}:
                both = "body.heartbeat.mean_pressure_pa and blood.tuning.arterial_pressure_pa"
                raise ValueError(f"{both} both set P_H; give one of them")
        touch, finger = self.touch, self.finger
        sides = [area for area in (touch.proximal_area_mm2, touch.distal_area_mm2) if area is not None]
        largest_mm2 = max([touch.contact_area_mm2, *sides, *(touch.recorded_contact_area_mm2 or ())])
        if touch.contact_force_n is not None:
            largest_mm2 *= max(1.0, touch.corners()[1].max() / touch.contact_force_n) ** (2 / 3)
        if finger is not None and largest_mm2 > (whole_mm2 := finger.width_mm * finger.length_mm):
            why = f"reaches off the finger, which has {whole_mm2:.0f} mm^2 (width_mm times length_mm); make it smaller"
            raise ValueError(f"touch: an area of contact of {largest_mm2:g} mm^2 {why}")
        recorded = self.body.recorded_time_s if self.body else None
        if recorded is not None:
            times = self.touch.times_s()
            if recorded[0] > times[0] or recorded[-1] < times[-1]:
                why = f"but the touch from {times[0]:g} to {times[-1]:g} s; record longer, or shorten the touch"
                raise ValueError(f"body.file reaches from {recorded[0]:g} to {recorded[-1]:g} s, {why}")

    def _slots_and_zones_fit(self) -> None:
        for i, slot in enumerate(self.oximeter.slots or () if self.oximeter else ()):
            known = [led.name for led in self.leds] + [DARK]
            if slot.light not in known:
                unknown = f'oximeter.slots[{i}].light = "{slot.light}" is unknown'
                raise ValueError(f"{unknown}; choose from {', '.join(known)}")
        if self.oximeter is not None:
            two_leds(self.leds, self.oximeter.slots)
        if self.finger is not None and (len(self.blood.zone_edges_mm) > 1 or self.blood.decay_length is not None):
            half = self.finger.nail_length_mm / 2
            for edge in self.blood.zone_edges_mm:
                if not -half < edge < half:
                    off = f"blood.zone_edges_mm {edge:g} lies off the nail"
                    raise ValueError(f"{off}, which reaches from {-half:g} to {half:g} mm; move it")

    @classmethod
    def from_kicad(cls, path: str | Path, parts: Mapping[str, Any] | None = None, **tables: Any) -> Self:
        """The scene of a KiCad board on a nail, its outline and the positions of its parts included.

        parts : what the board's references are, such as {"D1": {"led": "led_800"}, "U2": {"photodiode": "bpw34"}};
            without it the error proposes them.
        tables : further tables of the scene, such as touch={"force_n": 2.0}, and further fields of its board; an index
            finger if finger is not given.

        Raises: InputError.
        """
        board = {"kicad": str(path), "parts": parts} | tables.pop("board", {})
        return cls(**{"finger": {}, "board": board} | tables)

    def with_(self, values: Mapping[str, Any] | None = None, /, **changes: Any) -> Self:
        """The scene with other values at dotted paths, as of a sweep's axes: with_({"blood.so2": 0.9}).

        Another part, digit or recording brings its own values along, but for those that differ from the old one's; a
        whole table or list replaces the old one, with_(touch={"profile": "hold"}), and None removes what is optional.

        Raises: InputError, a line for each fault, with the field, the rule and the value.
        """
        try:
            return self._edited([(steps_of(path), value) for path, value in {**(values or {}), **changes}.items()])
        except ValueError as error:
            raise InputError(f"{error}.") from None

    def with_led(self, name: str | int, /, **changes: Any) -> Self:
        """The scene with other values of one LED, by its name or number: with_led("ir", position_mm=(-2, 0)).

        Raises: InputError, as `with_`.
        """
        return self._edited([(["leds", name, field], value) for field, value in changes.items()])

    def with_photodiode(self, name: str | int, /, **changes: Any) -> Self:
        """The scene with other values of one photodiode, or of one array, by its name or number; raises InputError."""
        return self._edited([(["photodiodes", name, field], value) for field, value in changes.items()])

    def _edited(self, edits: Iterable[tuple[list[str | int], Any]]) -> Self:
        tables: dict[str, Any] = dict(self)
        # An item is selected by its name until all else of it has changed.
        for steps, value in sorted(edits, key=lambda edit: edit[0][-1] == "name"):
            tables = with_value(tables, steps, value, ".".join(map(str, steps)))
        return type(self)(**tables)

    def draw(self) -> "Figure":
        """Its board on the nail from above, and the section below it, a matplotlib Figure; InputError for a phantom."""
        return self.nail.plot()

    def __repr__(self) -> str:
        """What it holds, in a line; `to_toml` writes all of it."""
        worn = "phantom" if self.finger is None else self.finger.digit
        leds = ", ".join(f"{led.name} {led.wavelength_nm:g} nm" for led in self.leds)
        elements = sum(len(p.wired_elements) for p in self.photodiodes)
        return f"<Scene: {worn}; LEDs: {short(leds, 60)}; photodiodes: {elements}; touch: {self.touch.profile}>"

    __str__ = __repr__

    def without_accuracy(self) -> Self:
        """The scene without a required accuracy, for traces of a stated number of photons."""
        return self.model_copy(update={"accuracy": Accuracy()})

    def require_blood(self, command: str) -> None:
        """Raise InputError where a bed without blood leaves a command nothing that changes."""
        if self.blood.rest_blood_fraction == 0.0:
            raise InputError(f"blood.rest_blood_fraction = 0: nothing changes that {command} reads; give some blood.")

    @property
    def fingertip(self) -> Finger:
        """The finger; raises InputError for a phantom, which has none."""
        if self.finger is None:
            raise InputError("a phantom has no finger; give a scene with [finger].")
        return self.finger

    @property
    def zone_edges_mm(self) -> tuple[float, ...]:
        """Boundaries of the blood zones along the nail, relative to its centre, the most proximal first. [mm]"""
        count = self.blood.zones
        if count is None or self.finger is None:
            return self.blood.zone_edges_mm
        return tuple(self.finger.nail_length_mm * (k / count - 0.5) for k in range(1, count))

    @property
    def zone_count(self) -> int:
        """Number of blood zones of the nail bed."""
        return len(self.zone_edges_mm) + 1

    @property
    def zones_of_photodiodes(self) -> tuple[int, ...]:
        """The blood zone above which each photodiode lies: 0 is the most proximal."""
        return tuple(bisect_right(self.zone_edges_mm, one.area.center_mm[1]) for one in self.layout.photodiodes)

    @property
    def zone_width_mm(self) -> float:
        """Width of the smooth passage from one blood zone to the next. [mm]"""
        if self.blood.zones is None or self.finger is None:
            return self.blood.zone_width_mm
        # A little less than a zone, whose edges are rounded.
        return min(self.blood.zone_width_mm, (1 - 1e-9) * self.finger.nail_length_mm / self.blood.zones)

    @property
    def finger_priors(self) -> tuple[Prior, ...]:
        """The priors of the finger, but for what the scene states, its contact, and what is without effect in it."""
        blood, without = self.blood, set(self.touch.stated_contact)
        if not blood.rest_blood_fraction:
            without.add("blood.rest_blood_fraction")
        if self.zone_count == 2 or blood.decay_length is not None:
            without.add("blood.bone_edge_mm")
        return self.priors.of_finger(without)

    @property
    def layout(self) -> Layout:
        """Where all lies on a finger's board; InputError where a copy's parts do not fit, or for a phantom."""
        if self.finger is None:
            raise InputError("a phantom has no board to lay out; give a scene with [finger].")
        try:
            return lay_out(self.finger, self.board, self.leds, self.photodiodes)
        except ValueError as error:
            raise InputError(f"{error}.") from None

    @property
    def elements(self) -> list[Photodiode]:
        """The photodiode of each reading, one for every element of an array; InputError as for `layout`."""
        return list(self.photodiodes) if self.finger is None else [e.photodiode for e in self.layout.photodiodes]


def _with_map(placement: object, parts: object) -> object:
    """The rules of a search in which candidates from files that say no other have the board's parts."""
    if not isinstance(placement, dict) or not isinstance(placement.get("candidates"), tuple):
        return placement
    candidates = (
        {"parts": parts} | item if isinstance(item, dict) and {"positions", "kicad"} & item.keys() else item
        for item in placement["candidates"]
    )
    return placement | {"candidates": tuple(candidates)}


def steps_of(path: str) -> list[str | int]:
    """A dotted path as keys and indices: leds[0].flux_mw or leds.0.flux_mw is leds, 0, flux_mw; raises ValueError."""
    steps: list[str | int] = []
    for part in path.split("."):
        match = re.fullmatch(r"([\w\-]+)((?:\[\d+\])*)", part)
        if not match:
            raise ValueError(f'"{path}": "{part}" is not a field; write it as in leds[0].flux_mw')
        steps.append(int(match[1]) if match[1].isdigit() else match[1])
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
    """A table without what was read from the file that a field names, which another one replaces; raises InputError."""
    if table.get("unmapped") is not None and field in BoardFile.model_fields:
        raise InputError(f"{path}: the file of the board has been read; read it again, as with Scene.from_kicad.")
    if field in ("part", "array") and any(given <= table.keys() for given in FROM_PART.values()):
        why = "or its old part is not in this folder; give its values instead, or leave them out."
        raise InputError(f"{path}: all that a part gives is written out here, {why}")
    return {name: value for name, value in table.items() if field != "file" or not name.startswith("recorded_")}

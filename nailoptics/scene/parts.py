"""What lies on the nail: the LEDs, the photodiodes, and the board that carries them."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError

from ..errors import InputError
from .base import Box, Fraction, Name, NonNegative, Packaged, Point, Polygon, Positive, Size, Table
from .catalogue import Angle, LedPart, ModulePart, PhotodiodeElements, PhotodiodePart, check_pattern, load_part

# Deeper than any part's face may protrude, and than packages with wires, such as the BPW34 of 3.2 mm. [um]
DEEPEST_EPOXY_UM = 5000
# Thickness of boards that bend onto a nail, as a scene's kapton_um, and that of other boards' film. [um]
FILM_UM, USUAL_FILM_UM = (5, 500), 25.0
Wavelength = Annotated[float, Field(ge=200, le=3000)]
Rotation = Annotated[float, Field(ge=-360, le=360)]
FileUnit = Literal["mm", "mil", "inch"]
BottomRotation = Literal["kicad", "assembler"]
# What a written scene gives of every LED and photodiode, so that it needs no part any more.
FROM_PART: dict[Any, set[str]] = {
    LedPart: {"wavelength_nm", "fwhm_nm", "flux_mw", "size_mm", "pattern"},
    PhotodiodePart: {"elements", "size_mm", "quantum_efficiency", "dark_current_na", "shunt_mohm"},
}
# What of a photodiode makes volts of the light that arrives, and changes nothing of where it goes.
ELECTRICAL = (
    "quantum_efficiency",
    "responsivity",
    "dark_current_na",
    "dark_current_doubling_k",
    "shunt_mohm",
    "capacitance_pf",
    "feedback_ohm",
)
# What a part takes of the board beside its die.
ROOM = ("body_mm", "courtyard_mm")
# Where a part's dark current is given. [K]
USUAL_TEMPERATURE_K = 298.15


def with_part(data: dict[str, Any], kind: Any, folder: Path | None) -> dict[str, Any]:
    """The table with the fields of its part filled in where it does not give them itself.

    A table that gives all that a part must, as a written scene does, needs no part any more.
    """
    if not isinstance(data.get("part"), str):
        return data
    try:
        part = load_part(data["part"], beside=folder, expect=kind)
    except InputError as error:
        if FROM_PART[kind] <= data.keys():
            return data
        # As a ValueError it comes with the place in the scene that names the part.
        raise ValueError(str(error).rstrip(".")) from None
    assert not isinstance(part, ModulePart)
    fields = part.scene_fields()
    if isinstance(flux_mw := data.get("flux_mw"), int | float) and fields["current_ma"] is not None:
        # The part's current is that of the part's flux.
        fields["current_ma"] *= flux_mw / fields["flux_mw"]
    if data.get("pattern", "measured") != "measured":
        # The part's measured table goes with the part's own pattern only.
        fields = {name: value for name, value in fields.items() if not name.startswith("pattern")}
    if any(value is not None and data.get(name, value) is None for name, value in fields.items()):
        # Without something that the part has it is another one.
        return fields | data | {"part": None}
    return fields | data


class Mounted(Packaged):
    """What an LED and a photodiode have on a board."""

    name: Name
    """Name, unique in the scene; the elements of an array are called name.0, name.1 and so on."""
    reference: str | None = None
    """Its reference in the board's file and in exported boards; filled from kicad or positions."""
    part: str | None = None
    """A part from assets/parts or the scene's folder; fills the fields that are not given."""
    position_mm: Point
    """Centre of the die, photodiode or array. [mm]"""
    rotation_deg: Rotation = 0.0
    """Rotation on the board around its centre, of an array as a whole, counterclockwise. [deg]"""
    body_mm: Box | None = None
    """Box around its body and pads, (u_min, v_min, u_max, v_max) about its position, unrotated; from kicad. [mm]"""
    courtyard_mm: Box | None = None
    """Box around its courtyard, on which no other part may lie, likewise; filled from kicad. [mm]"""

    @property
    def is_of_module(self) -> bool:
        """Whether it is one die of a footprint of several."""
        return "." in (self.reference or "")

    @property
    def footprint(self) -> str:
        """Reference of its footprint, the same for all dies of a module; its name without one."""
        return (self.reference or self.name).split(".")[0]


class Led(Mounted):
    """A light-emitting die, or a beam on a phantom."""

    position_mm: Point = (0.0, 0.0)
    """Centre of the die. [mm]"""
    wavelength_nm: Wavelength
    """Peak wavelength. [nm]"""
    fwhm_nm: NonNegative = 0.0
    """Full width at half maximum of the spectrum (Gaussian). [nm]"""
    flux_mw: Positive = 1.0
    """Radiant flux. [mW]"""
    current_ma: Positive | None = None
    """Drive current of that flux; of a part in proportion to its flux, if not given. [mA]"""
    max_current_ma: Positive | None = None
    """Largest current of the part. [mA]"""
    pattern: Literal["lambertian", "pencil", "measured"] = "lambertian"
    """Angular pattern: Lambertian, a measured table, or (phantom) a pencil beam at normal incidence."""
    pattern_deg: tuple[Angle, ...] | None = None
    """Angles from the normal of a measured pattern. [deg]"""
    pattern_relative: tuple[NonNegative, ...] | None = None
    """Relative radiant intensity at those angles."""
    size_mm: Size = (0.25, 0.25)
    """Size of the die (u, v); a pencil beam has none. [mm]"""

    @property
    def length_mm(self) -> float:
        """Length of the die along v. [mm]"""
        return self.size_mm[1]

    @classmethod
    def _filled(cls, data: dict[str, Any], folder: Path | None) -> dict[str, Any]:
        return with_part(data, LedPart, folder)

    def _check(self) -> None:
        if self.pattern == "measured":
            angles, values = self.pattern_deg or (), self.pattern_relative or ()
            if len(angles) != len(values):
                raise ValueError('pattern = "measured" needs pattern_deg and pattern_relative of equal length')
            check_pattern(tuple(zip(angles, values, strict=True)), "pattern_deg and pattern_relative")
        elif self.pattern_deg is not None or self.pattern_relative is not None:
            raise ValueError(f'pattern_deg and pattern_relative belong to pattern = "measured", not "{self.pattern}"')


class Photodiode(PhotodiodeElements, Mounted):
    """A photodiode, an array of them, or (phantom) an aperture that counts all light through it."""

    array: str | None = None
    """Old name of part."""
    wired: Annotated[tuple[Annotated[int, Field(ge=0)], ...], Field(min_length=1)] | None = None
    """Wired elements of the array, counted from 0 at the proximal end; all if not given."""
    aperture: bool = False
    """Counts all light that leaves the top face of a phantom through it, at every angle."""
    size_mm: Size = (1.0, 1.0)
    """Size of one element (u, v). [mm]"""
    shunt_mohm: Positive = 1000.0
    """Shunt resistance of one element. [Mohm]"""
    feedback_ohm: Positive | tuple[Positive, ...] | None = None
    """Feedback resistance of its stage, or of the stage of each wired element from the proximal end on; that of
    [electronics] if not given. [ohm]"""

    @property
    def length_mm(self) -> float:
        """Length of the row of elements along v. [mm]"""
        return self.size_mm[1] + (self.elements - 1) * (self.pitch_mm or self.size_mm[1])

    @property
    def wired_elements(self) -> Sequence[int]:
        """Which of its elements are read, counted from 0 at the proximal end."""
        return self.wired or range(self.elements)

    def dark_current_a(self, temperature_k: float) -> float:
        """Dark current of one element at a temperature. [A]"""
        warmer = 0.0 if self.dark_current_doubling_k is None else temperature_k - USUAL_TEMPERATURE_K
        return 1e-9 * self.dark_current_na * 2.0 ** (warmer / (self.dark_current_doubling_k or 1.0))

    def element_names(self) -> tuple[str, ...]:
        """Names of the elements: its own where it is one photodiode, name.0, name.1 and so on of an array."""
        return (self.name,) if self.elements == 1 else tuple(f"{self.name}.{i}" for i in range(self.elements))

    @classmethod
    def _filled(cls, data: dict[str, Any], folder: Path | None) -> dict[str, Any]:
        if isinstance(data.get("array"), str) and data.get("part") is None:
            data = {name: value for name, value in data.items() if name != "array"} | {"part": data["array"]}
        data = with_part(data, PhotodiodePart, folder)
        return {"name": data["part"]} | data if isinstance(data.get("part"), str) else data

    def _check(self) -> None:
        super()._check()
        if self.aperture and self.angular_response:
            raise ValueError("an aperture counts light at every angle; leave angular_response out")
        for index in self.wired or ():
            if index >= self.elements:
                raise ValueError(f"wired names element {index}, but the array has elements 0 to {self.elements - 1}")
        if self.wired is not None and len(set(self.wired)) < len(self.wired):
            raise ValueError(f"wired names an element twice: {list(self.wired)}")
        count = len(self.wired_elements)
        if isinstance(self.feedback_ohm, tuple) and len(self.feedback_ohm) != count:
            raise ValueError(f"feedback_ohm has {len(self.feedback_ohm)} values for {count} wired elements; give each")
        if self.elements > 1 and self.pitch_mm is not None and self.pitch_mm < self.size_mm[1]:
            raise ValueError(f"pitch_mm = {self.pitch_mm} is less than the element's size along v, {self.size_mm[1]}")


def check_one_response(photodiodes: Iterable[Photodiode]) -> None:
    """Raise InputError for photodiodes of several angular responses, where any place is read as by one of them."""
    first, *others = photodiodes
    for other in others:
        if other.angular_response != first.angular_response:
            why = "and maps of a board read any place as by one; give all the same, or use simulate or trace."
            raise InputError(f'photodiodes "{first.name}" and "{other.name}" differ in angular_response, {why}')


class BoardFile(Table):
    """A layout program's file that places the parts of a board, and how it is read."""

    kicad: str | None = None
    """A KiCad board in the scene's folder; its parts are mapped by parts, its outline is used."""
    positions: str | None = None
    """A position file of KiCad or an assembler in the scene's folder, instead of a KiCad board."""
    parts: dict[str, dict[str, Any]] | None = None
    """Map from the file's references to parts, such as D1 = { led = "led_660" } or U2 = { photodiode = "bpw34" };
    candidates without it have that of [board]. A scene that was read from a KiCad board keeps it."""
    origin: Literal["auxiliary", "grid", "outline"] | Point | None = None
    """Point of the file that is the board's origin: the auxiliary origin of drill and position files, the grid's, the
    outline's centre, or (x, y) as shown by the layout program; if not given the first of these that exists, except
    the grid's (of a position file (0, 0)), if a nail reaches all mapped parts from there, else their middle. [mm]"""
    faces_nail: Literal["top", "bottom"] | None = None
    """Side of the file's board that faces the nail; that of its parts if not given."""
    turn_deg: Rotation = 0.0
    """Rotation of the file's board on the nail, counterclockwise seen from above. [deg]"""
    negate_x_on_bottom: bool = False
    """The position file was written with "negate bottom side X"; undo that."""
    rotation_on_bottom: BottomRotation | None = None
    """Rotation of parts on the bottom in a position file: as KiCad writes it, or 180 degrees less it, as assemblers
    such as JLCPCB ask for; KiCad's if not given. [deg]"""
    positions_unit: FileUnit | None = None
    """Unit of a position file that does not state it, such as KiCad's CSV; mm if not given."""
    unmapped: tuple[str, ...] | None = None
    """References of the file that are no part of the scene; filled from it."""
    taken_mm: tuple[Polygon, ...] | None = None
    """Corners of the room that each of these takes on the nail's side of the board, from the board's origin, which
    place keeps free; filled from kicad. [mm]"""

    def __hash__(self) -> int:  # parts is a dict; layouts are looked up by their board
        return hash(tuple(value for name, value in self.__dict__.items() if name != "parts"))

    @staticmethod
    def is_to_be_read(table: dict[str, Any]) -> bool:
        """Whether a table names a file that has not been read, and its fields are valid; if not, these say so."""
        if "unmapped" in table or not isinstance(table.get("parts"), dict | None):
            return False
        given = {name: table[name] for name in BoardFile.model_fields.keys() & table.keys() - {"parts"}}
        try:
            file = BoardFile.model_validate(given)
        except ValidationError:
            return False
        return file.kicad is not None or file.positions is not None

    def _check(self) -> None:
        if self.parts is not None and self.unmapped is None:
            raise ValueError("parts says what a file's references are; give kicad or positions, the file that has them")


class Board(BoardFile):
    """The flexible board bent onto the nail, and the layers below it."""

    size_mm: Size | None = None
    """Size of the board (u, v) around its origin; if not given large enough for its parts. [mm]"""
    center_mm: Point = (0.0, 0.0)
    """Position of the board's origin relative to the nail's centre (u, v). [mm]"""
    outline_mm: Polygon | None = None
    """Corners of the outline, from the board's origin; filled from kicad. [mm]"""
    outline_holes_mm: tuple[Polygon, ...] = ()
    """Corners of each hole in it; filled from kicad. [mm]"""
    kapton_um: Annotated[float, Field(ge=FILM_UM[0], le=FILM_UM[1])] = USUAL_FILM_UM
    """Thickness of the Kapton film; of a flexible board from kicad that of its stackup. [um]"""
    clear_epoxy_um: Annotated[float, Field(ge=20, le=DEEPEST_EPOXY_UM)] = 400.0
    """Thickness of the clear epoxy under the board. [um]"""
    adhesive_um: Annotated[float, Field(ge=0, le=1000)] = 50.0
    """Thickness of the clear adhesive on the nail; it has the epoxy's index. [um]"""
    air_gap_um: Annotated[float, Field(ge=1, le=1000)] | None = None
    """Thickness of an air gap between nail and adhesive of a board that is not bonded; none if not given. [um]"""
    barrier: bool = True
    """A wall of opaque epoxy between LEDs and photodiodes, from the board to the nail."""
    barrier_um: Annotated[float, Field(ge=20, le=2000)] = 150.0
    """Thickness of that wall. [um]"""
    barrier_side: Literal["left", "right", "below", "above"] | None = None
    """Side of the photodiodes where the wall is, with every LED behind it; if not given, for each LED the side where
    it is farthest from them."""
    barrier_gap_mm: Annotated[float, Field(ge=0.02, le=5)] | None = None
    """Distance from the nearest LED to that wall; midway to the photodiodes if not given. [mm]"""
    cover_um: Annotated[float, Field(ge=0, le=5000)] = 500.0
    """Thickness of the opaque cover on top; with 0 there is none, and light passes through the film. [um]"""
    opaque_reflectance: Fraction = 0.04
    """Diffuse reflectance of the opaque epoxy: barrier, rim and cover."""

    @property
    def height_mm(self) -> float:
        """Height of the board's underside above the nail: clear epoxy, adhesive and air. [mm]"""
        return (self.clear_epoxy_um + self.adhesive_um + (self.air_gap_um or 0.0)) * 1e-3

    def on_nail(self, place_mm: Point) -> Point:
        """A place on the board from the nail's centre (u, v). [mm]"""
        return place_mm[0] + self.center_mm[0], place_mm[1] + self.center_mm[1]

    def _check(self) -> None:
        super()._check()
        if 0 < self.cover_um < 20:
            raise ValueError(f"cover_um = {self.cover_um:g} is too thin a cover; give 20 or more, or 0 for none")

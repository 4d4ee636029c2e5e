"""What a search for a layout may do: candidates, outline, clearances, and the fingers it must serve."""

from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import Field

from ..errors import InputError
from .base import Fraction, Name, NonNegative, Point, Polygon, Positive, Table, check_unique, shifted
from .finger import DermisAbsorption, Digit
from .parts import BoardFile, FileUnit, Led, Photodiode, Rotation
from .text_files import read_text

# What layouts can be ranked by, and most photodiodes of a searched one.
Aim = Literal["worst", "mean", "force", "share", "oxygen"]
MOST_SEARCHED = 32


class Candidate(BoardFile):
    """One layout: positions of the LEDs and photodiodes on the flat board, relative to the nail's centre.

    Of a position file without parts, references such as D1 or LED1 are LEDs, PD1 photodiodes, others are ignored.
    """

    name: Name
    """Name of the layout."""
    leds_mm: tuple[Point, ...] = ()
    """Positions of the LEDs (u, v), in the order of the scene; filled from positions. [mm]"""
    photodiodes_mm: tuple[Point, ...] = ()
    """Positions of the photodiodes (u, v); filled from positions. [mm]"""
    leds_deg: tuple[Rotation, ...] = ()
    """Rotation of each LED; filled from positions. [deg]"""
    photodiodes_deg: tuple[Rotation, ...] = ()
    """Rotation of each photodiode; filled from positions. [deg]"""
    led_refs: tuple[tuple[str, str], ...] = ()
    """Reference and value of each LED in the file, one of which is its name; filled from positions."""
    photodiode_refs: tuple[str, ...] = ()
    """References of the photodiodes; filled from positions."""
    leds: tuple[Led, ...] = ()
    """The LEDs according to parts, with their sizes; filled from the file."""
    photodiodes: tuple[Photodiode, ...] = ()
    """The photodiodes according to parts; filled from the file."""

    @classmethod
    def _filled(cls, data: dict[str, Any], folder: Path | None) -> dict[str, Any]:
        if "photodiodes_mm" in data or not cls.is_to_be_read(data):
            return data
        from .importers import board_files, positions

        if data.get("parts") or data.get("kicad") is not None:
            try:
                # The film is the scene's.
                leds, photodiodes, own = board_files.read_board_file(data | {"kapton_um": None}, folder)
            except InputError as error:
                raise ValueError(str(error).rstrip(".")) from None
            filled: dict[str, object] = {"leds": leds, "photodiodes": photodiodes, "parts": None}
            return data | filled | {"unmapped": own["unmapped"]}
        path = Path(folder or Path()) / str(data["positions"])
        parts = positions.read_positions(path, **{name: data[name] for name in positions.READING & data.keys()})
        groups = {f"{kind}s": [p for p in parts if p.kind == kind] for kind in ("led", "photodiode")}
        used = [*groups["leds"], *groups["photodiodes"]]
        # Fiducials and holes, which nobody asks for, may share one.
        check_unique([part.ref for part in used], f"{path}: Ref")
        text = read_text(path, "a position file", any_encoding=True)
        positions.warn_of_bottom(data, parts, used, [part for part in used if part.rotation_deg % 90], text)
        view = board_files.view_of(data, used, data.get("faces_nail")) if used else board_files.View()
        filled = {f"{name}_mm": tuple(view.place(p.position_mm) for p in group) for name, group in groups.items()}
        filled |= {f"{name}_deg": tuple(view.angle(p.rotation_deg) for p in group) for name, group in groups.items()}
        filled["led_refs"] = tuple((p.ref, p.value) for p in groups["leds"])
        filled["photodiode_refs"] = tuple(p.ref for p in groups["photodiodes"])
        return data | filled | {"unmapped": tuple(p.ref for p in parts if not p.kind)}

    def _check(self) -> None:
        super()._check()
        if not (self.leds_mm or self.leds) or not (self.photodiodes_mm or self.photodiodes):
            why = "or a file that has both: LEDs as D1 or LED1 and photodiodes as PD1, or any that parts names"
            raise ValueError(f"a candidate needs leds_mm and photodiodes_mm, {why}")
        for name in ("leds", "photodiodes"):
            places, given = getattr(self, f"{name}_mm"), getattr(self, f"{name}_deg")
            if given and len(given) != len(places):
                raise ValueError(f"{name}_deg has {len(given)} entries for {len(places)} places; give one for each")


class FingerCase(Table):
    """A finger on which layouts are evaluated; fields not given are those of the scene's finger."""

    name: Name
    """Name of the case."""
    digit: Digit | None = None
    """Which digit; its sizes from anatomy replace the scene's."""
    rest_blood_fraction: Fraction | None = None
    """Volume fraction of blood in the nail bed at rest."""
    so2: Fraction | None = None
    """Oxygen saturation of the blood."""
    melanin_fraction: Fraction | None = None
    """Volume fraction of melanosomes in the epidermis."""
    dermis: DermisAbsorption | None = None
    """Absorption of the bloodless bed."""


class Placement(Table):
    """Constraints and objective of the layout search."""

    candidates: Annotated[tuple[Candidate, ...], Field(max_length=200)] = ()
    """Layouts to rank."""
    search: bool = True
    """Also search for positions of the LED and the photodiodes."""
    outline: str | None = None
    """Board outline: a KiCad board, DXF or CSV (x_mm, y_mm) in the scene's folder; that of [board] if not given."""
    outline_origin: Literal["middle"] | Point | None = None
    """Point of that file on the nail's centre: the outline's centre, or (x, y); (0, 0), of a KiCad board its auxiliary
    origin, if not given. [mm]"""
    outline_unit: FileUnit | None = None
    """Unit of a DXF that does not state it, as KiCad's up to version 6; mm if not given."""
    outline_mm: Polygon | None = None
    """Corners of the outline (u, v); filled from outline. [mm]"""
    outline_holes_mm: tuple[Polygon, ...] = ()
    """Corners of each hole in the outline, which is kept free of parts; filled from outline. [mm]"""
    keep_out_mm: tuple[Polygon, ...] = ()
    """Corners (u, v) of each area that is kept free of parts. [mm]"""
    fixed: tuple[Name, ...] = ()
    """Names of the scene's LEDs and photodiodes that the search does not move."""
    wire: bool = False
    """Select which elements of the scene's photodiodes and arrays are wired, instead of searching positions."""
    photodiodes: Annotated[int, Field(ge=1, le=MOST_SEARCHED)] = 8
    """Number of photodiodes of a searched layout, including fixed ones; the others are like the scene's first. As many
    as the scene has where it has no [placement]."""
    force_n: Annotated[float, Field(gt=0, le=20)] = 0.5
    """Force at which the resolution is evaluated. [N]"""
    since_rest_s: Annotated[float, Field(gt=0, le=86400)] = 60.0
    """Time since the last rest reading, over which readings drift according to [body.drift]. [s]"""
    rank_by: Literal["worst", "mean", "force", "share", "oxygen", "oxygen_and_force"] | dict[Aim, Positive] = "worst"
    """Objective of search and ranking, to be minimized. worst, mean: the force resolution of one sample for the worst
    finger, or the mean over the fingers; force: error of the filter of predict over touches, worst finger, where the
    search is by one sample; share: standard error of the proximal share of the force, worst finger; oxygen: uncertainty
    of SpO2 of two LEDs for the worst finger, with a heartbeat; oxygen_and_force: oxygen and worst with equal weights.
    Or a table of weights, such as { worst = 2, oxygen = 1 }: the weighted mean of logarithms."""
    fingers: Annotated[tuple[FingerCase, ...], Field(max_length=16)] = ()
    """Fingers over which layouts are evaluated; the scene's finger if none is given."""
    people: Annotated[int, Field(ge=0, le=200)] = 0
    """Number of people, drawn from the priors and the sizes of fingers around the first finger, for whom layouts are
    ranked; the search itself is for the fingers. 0: layouts are ranked for the fingers."""
    quantile: Annotated[float, Field(gt=0, lt=1)] = 0.9
    """Fraction of people for whom a layout is at least as good as its rank says, in place of the worst or the mean."""
    edge_mm: NonNegative = 0.3
    """Minimum distance of any part from the board's edge. [mm]"""
    clearance_mm: NonNegative = 0.1
    """Minimum gap between two photodiodes or two LEDs, and between a photodiode and the barrier. [mm]"""
    bond_wire_mm: Annotated[float, Field(ge=0.02, le=3)] = 0.4
    """Space next to an LED for its bond wire: the gap to the barrier, or without one to photodiodes. [mm]"""
    led_step_mm: Annotated[float, Field(ge=0.25, le=5)] = 2.0
    """Initial spacing of LED positions; the search then halves it around the best, and tries LEDs side by side. [mm]"""
    photodiode_step_mm: Annotated[float, Field(ge=0.05, le=2)] = 0.25
    """Spacing of photodiode positions. [mm]"""

    @classmethod
    def _filled(cls, data: dict[str, Any], folder: Path | None) -> dict[str, Any]:
        if not isinstance(data.get("outline"), str) or "outline_mm" in data:
            return data
        from .importers import board_files, outlines, positions

        unit, origin = data.get("outline_unit") or "mm", data.get("outline_origin") or (0.0, 0.0)
        if unit not in get_args(FileUnit) or not (origin == "middle" or outlines.is_point(origin)):
            return data  # which its fields refuse
        outline = board_files.read_outline(Path(folder or Path()) / data["outline"], unit_mm=positions.UNITS_MM[unit])
        x, y = outlines.middle(outline.corners_mm) if origin == "middle" else origin
        corners, *holes = shifted((outline.corners_mm, *outline.holes_mm), (-x, -y))
        return data | {"outline_mm": corners, "outline_holes_mm": tuple(holes)}

    def _check(self) -> None:
        if not self.search and not self.candidates:
            raise ValueError("search = false leaves nothing to rank; give candidates")
        check_unique([candidate.name for candidate in self.candidates], "candidates")
        check_unique([case.name for case in self.fingers], "fingers")
        check_unique(self.fixed, "fixed")
        if not self.weights:
            raise ValueError('rank_by is empty; give a weight, such as { worst = 1.0 }, or a word, such as "worst"')
        if {"worst", "mean"} <= self.weights.keys():
            raise ValueError("rank_by has both worst and mean, which are of the same force; give one of them")

    @property
    def over_fingers(self) -> Literal["worst", "mean"]:
        """Whether the force over the fingers is that on the worst of them, or their mean."""
        return "mean" if "mean" in self.weights else "worst"

    @property
    def weights(self) -> dict[str, float]:
        """The part that each has in what layouts are ranked by; together 1."""
        both = {"oxygen": 1.0, "worst": 1.0} if self.rank_by == "oxygen_and_force" else {str(self.rank_by): 1.0}
        given = self.rank_by if isinstance(self.rank_by, dict) else both
        return {name: weight / sum(given.values()) for name, weight in given.items()}

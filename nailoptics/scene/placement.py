"""What a search for a layout may do: candidates, outline, clearances, and the fingers it must serve."""

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, ValidationInfo, model_validator

from .base import Fraction, Name, NonNegative, Point, Table, check_unique
from .finger import DermisAbsorption
from .outlines import read_outline
from .positions import read_positions


class Candidate(Table):
    """One layout: places of the LEDs and photodiodes on the flat board, from the nail's centre."""

    name: Name
    """Name of the layout."""
    positions: str | None = None
    """KiCad position file beside the scene; Refs D1, LED1 and the like are LEDs, the others photodiodes."""
    negate_x_on_bottom: bool = False
    """The position file was written with "negate bottom side X"; undo that."""
    leds_mm: tuple[Point, ...] = ()
    """Places of the LEDs (u, v), in the order of the scene; filled from positions. [mm]"""
    photodiodes_mm: tuple[Point, ...] = ()
    """Places of the photodiodes (u, v); filled from positions. [mm]"""
    leds_turned: tuple[bool, ...] = ()
    """Which LEDs lie turned by 90 degrees; none if not given; filled from positions."""
    photodiodes_turned: tuple[bool, ...] = ()
    """Which photodiodes lie turned by 90 degrees; none if not given; filled from positions."""

    @model_validator(mode="before")
    @classmethod
    def _read_the_positions(cls, data: object, info: ValidationInfo) -> object:
        if not isinstance(data, dict) or not isinstance(data.get("positions"), str) or "photodiodes_mm" in data:
            return data
        path = Path((info.context or {}).get("folder") or Path()) / data["positions"]
        parts = read_positions(path, negate_x_on_bottom=bool(data.get("negate_x_on_bottom", False)))
        groups = {"leds": [p for p in parts if p.is_led], "photodiodes": [p for p in parts if not p.is_led]}
        places = {f"{name}_mm": tuple(p.position_mm for p in group) for name, group in groups.items()}
        return data | places | {f"{name}_turned": tuple(p.is_turned for p in group) for name, group in groups.items()}

    @model_validator(mode="after")
    def _has_parts(self) -> Self:
        if not self.leds_mm or not self.photodiodes_mm:
            raise ValueError("a candidate needs leds_mm and photodiodes_mm, or a positions file that has both")
        for name in ("leds", "photodiodes"):
            places, turned = getattr(self, f"{name}_mm"), getattr(self, f"{name}_turned")
            if turned and len(turned) != len(places):
                raise ValueError(f"{name}_turned has {len(turned)} entries for {len(places)} places; give one for each")
        return self


class FingerCase(Table):
    """A finger that the layout must serve; what is not given is the scene's."""

    name: Name
    """Name of the case."""
    digit: Literal["thumb", "index", "middle", "ring", "little"] | None = None
    """Which digit; its sizes from anatomy replace the scene's."""
    rest_blood_fraction: Fraction | None = None
    """Volume fraction of blood in the nail bed at rest."""
    so2: Fraction | None = None
    """Oxygen saturation of the blood."""
    melanin_fraction: Fraction | None = None
    """Volume fraction of melanosomes in the epidermis."""
    dermis: DermisAbsorption | None = None
    """What the bed absorbs without blood."""


class Placement(Table):
    """The rules of a search for a layout."""

    candidates: Annotated[tuple[Candidate, ...], Field(max_length=200)] = ()
    """Layouts to rank."""
    search: bool = True
    """Search places of the LED and the photodiodes, too."""
    outline: str | None = None
    """Board outline beside the scene, a DXF or a CSV with columns x_mm, y_mm; [board] if not given."""
    outline_mm: tuple[Point, ...] | None = None
    """Corners of the outline (u, v); filled from outline. [mm]"""
    outline_holes_mm: tuple[tuple[Point, ...], ...] = ()
    """Corners of each hole in the outline, over which no part lies; filled from outline. [mm]"""
    photodiodes: Annotated[int, Field(ge=1, le=32)] = 8
    """How many photodiodes the search places, each like the scene's first."""
    force_n: Annotated[float, Field(gt=0, le=20)] = 0.5
    """Force at which the resolution is judged. [N]"""
    since_rest_s: Annotated[float, Field(gt=0, le=86400)] = 60.0
    """Time since the untouched finger was read, in which readings drift as [body.drift] says. [s]"""
    rank_by: Literal["worst", "mean"] = "worst"
    """Over the fingers: the worst resolution or the mean."""
    fingers: Annotated[tuple[FingerCase, ...], Field(max_length=16)] = ()
    """Fingers that the layout must serve; the scene's own if none is given."""
    edge_mm: NonNegative = 0.3
    """Least distance of any part from the board's edge. [mm]"""
    clearance_mm: NonNegative = 0.1
    """Least gap between two photodiodes, and between a photodiode and the barrier. [mm]"""
    bond_wire_mm: Annotated[float, Field(ge=0.02, le=3)] = 0.4
    """Room beside an LED for its bond wire: the gap to the barrier, and to photodiodes without one. [mm]"""
    led_step_mm: Annotated[float, Field(ge=0.25, le=5)] = 2.0
    """Spacing of the first LED places; the search then halves it around the best. [mm]"""
    photodiode_step_mm: Annotated[float, Field(ge=0.05, le=2)] = 0.25
    """Spacing of photodiode places. [mm]"""

    @model_validator(mode="before")
    @classmethod
    def _read_the_outline(cls, data: object, info: ValidationInfo) -> object:
        if not isinstance(data, dict) or not isinstance(data.get("outline"), str) or "outline_mm" in data:
            return data
        folder = (info.context or {}).get("folder") or Path()
        found = read_outline(Path(folder) / data["outline"])
        return data | {"outline_mm": found.corners_mm, "outline_holes_mm": found.holes_mm}

    @model_validator(mode="after")
    def _something_to_do(self) -> Self:
        if not self.search and not self.candidates:
            raise ValueError("search = false leaves nothing to rank; give candidates")
        check_unique([candidate.name for candidate in self.candidates], "candidates")
        check_unique([case.name for case in self.fingers], "fingers")
        if self.outline_mm is not None and len(self.outline_mm) < 3:
            raise ValueError("outline_mm needs three corners or more")
        return self

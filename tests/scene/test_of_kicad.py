"""Files that KiCad 6.0 and 9.0 wrote of one board: parts at odd angles on both sides, every shape of an outline."""

import math
from pathlib import Path

import pytest

from nailoptics.scene import parse_scene
from nailoptics.scene.importers.kicad import moved_board, read_board
from nailoptics.scene.importers.outlines import join
from nailoptics.scene.importers.positions import read_positions
from nailoptics.scene.rectangles import area_mm2

FILES = Path(__file__).parent / "of_kicad"
ORIGIN = (105.5, -104.25)
# What KiCad was given, with y up: reference, place, angle, side.
PARTS = {
    "D1": ((103.0, -102.0), 30.0, "bottom"),
    "PD1": ((106.0, -102.0), -17.3, "bottom"),
    "PD2": ((106.123457, -104.987651), 123.456, "bottom"),
    "R1": ((103.0, -104.0), 211.5, "top"),
    "H1": ((104.5, -101.5), 45.0, "top"),
    "J1": ((107.5, -103.0), 30.0, "bottom"),
    "J2": ((101.5, -103.0), 70.0, "top"),
    "J3": ((108.5, -104.3), -25.0, "bottom"),
    "J4": ((101.5, -104.8), 25.0, "bottom"),
}
# 10 x 8 mm with corners rounded by 1 mm; a circle, a square, a triangle, and those of J1 to J4.
BOARD_MM2 = 80 - (4 - math.pi)
HOLES_MM2 = sorted([math.pi / 4, 1.0, 0.5, math.pi * 0.3**2, 0.8 * 0.6, math.pi * 0.4**2 / 2, 0.2])
LINE_MM = 0.05


def away_deg(angle):
    return abs((angle + 180) % 360 - 180)


@pytest.mark.parametrize("version", [6, 9])
def test_a_board_is_read_as_kicad_made_it(version):
    result = read_board(FILES / f"version_{version}.kicad_pcb")
    assert {part.ref for part in result.footprints} == set(PARTS) and result.auxiliary_mm == ORIGIN
    for part in result.footprints:
        place, angle, side = PARTS[part.ref]
        assert part.position_mm == pytest.approx(place, abs=1e-9) and part.side == side
        assert away_deg(part.rotation_deg - angle) < 1e-6
    values = {part.ref: part.value for part in result.footprints}
    assert (values["R1"], values["PD1"]) == ("0.10", 'Q "x" (a) \\ µ')
    outline = join(result.edges, "x")
    assert abs(area_mm2(outline.corners_mm)) == pytest.approx(BOARD_MM2, abs=0.01)
    assert sorted(abs(area_mm2(hole)) for hole in outline.holes_mm) == pytest.approx(HOLES_MM2, abs=0.01)


def test_a_pad_of_a_turned_bottom_footprint_lies_where_kicad_puts_it():
    # Of the library's pad 0.4 mm to the right and 0.1 mm down, as KiCad's Python API gives its places on this board.
    pads = {"D1": (103.29641, -101.713397), "PD1": (106.411642, -102.023474)}
    one = '{ photodiode = "bpw34", offset_mm = [0.4, -0.1] }'
    text = f"""schema_version = 1
    [finger]
    digit = "thumb"
    [board]
    kicad = "version_9.kicad_pcb"
    parts.D1 = {{ led = "led_800", offset_mm = [0.4, -0.1] }}
    parts.PD1 = {one.replace("bpw34", "pd_array_4x1").replace("}", ", elements = 1, size_mm = [0.2, 0.2] }")}
    """
    scene = parse_scene(text, folder=FILES)
    for part, ref in ((scene.leds[0], "D1"), (scene.photodiodes[0], "PD1")):
        place = [a + b for a, b in zip(part.position_mm, ORIGIN, strict=True)]
        assert place == pytest.approx(pads[ref], abs=2e-6)
        assert away_deg(part.rotation_deg - PARTS[ref][1]) < 1e-6


def test_moved_footprints_are_to_the_byte_what_kicad_saves():
    """KiCad 6.0's python moved and turned the same four footprints of its own board, and saved it."""
    places = {"D1": ((101.25, -103.5), 75.0), "PD1": ((106.0, -102.0), -17.3), "PD2": ((104.0, -103.0), 33.456)}
    path = FILES / "version_6.kicad_pcb"
    text = moved_board(path, places | {"J1": ((106.5, -102.5), 30.0)}, [])
    assert text == (FILES / "version_6_moved.kicad_pcb").read_text()


@pytest.mark.parametrize("version", [6, 9])
def test_moved_there_and_back_a_board_is_the_same_to_the_byte(tmp_path, version):
    path, moved = FILES / f"version_{version}.kicad_pcb", tmp_path / "moved.kicad_pcb"
    placed = {part.ref: (part.position_mm, part.rotation_deg) for part in read_board(path).footprints}
    assert moved_board(path, placed, []) == path.read_text()
    away = {ref: ((x + 1.25, y - 0.5), angle + 73.25) for ref, ((x, y), angle) in placed.items() if ref[0] != "J"}
    moved.write_text(moved_board(path, away, []))
    result = {part.ref: part for part in read_board(moved).footprints}
    for ref, (place, angle) in (placed | away).items():
        assert result[ref].position_mm == pytest.approx(place, abs=1e-9)
        assert away_deg(result[ref].rotation_deg - angle) < 1e-6
    lines = [
        (a, b) for a, b in zip(path.read_text().splitlines(), moved.read_text().splitlines(), strict=True) if a != b
    ]
    assert lines and all("(at " in a for a, _ in lines)


@pytest.mark.parametrize(
    ("name", "how", "within_mm"),
    [
        ("negated.csv", {"negate_x_on_bottom": True}, 1e-6),
        ("inches.pos", {}, 2.6e-3),  # four digits of an inch
        ("inches.csv", {"positions_unit": "inch"}, 2.6e-5),
    ],
)
def test_position_files_agree_with_the_board(name, how, within_mm):
    result = read_positions(FILES / name, **how)
    assert {part.ref for part in result} == set(PARTS)
    for part in result:
        place, angle, side = PARTS[part.ref]
        expected = [a - b for a, b in zip(place, ORIGIN, strict=True)]
        assert part.position_mm == pytest.approx(expected, abs=within_mm) and part.side == side
        assert away_deg(part.rotation_deg - angle) < 1e-3

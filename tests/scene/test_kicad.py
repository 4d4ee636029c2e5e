"""KiCad position files and outlines: read, written back the same, and refused in one line where they are wrong."""

import math

import pytest

from nailoptics.errors import InputError
from nailoptics.scene import load_scene
from nailoptics.scene.kicad import PlacedPart, read_outline, read_positions, write_outline, write_positions

# As `kicad-cli pcb export pos --format csv --units mm --side both` writes it.
POSITIONS = """Ref,Val,Package,PosX,PosY,Rot,Side
"D1","IR800","LED_die",-2.500000,0.250000,0.000000,bottom
"LED2","IR940","LED_die",2.500000,0.250000,90.000000,top
"PD1","element","PD_1x0.25mm",0.500000,-1.500000,0.000000,bottom
"""
SQUARE = [(-4.0, -5.0), (4.0, -5.0), (4.0, 5.0), (-4.0, 5.0)]
ENTITIES = "0\nSECTION\n2\nENTITIES\n{}0\nENDSEC\n0\nEOF\n"


def line(a, b):
    return f"0\nLINE\n8\nEdge.Cuts\n10\n{a[0]}\n20\n{a[1]}\n11\n{b[0]}\n21\n{b[1]}\n"


def test_positions_of_both_sides_are_read_in_order(tmp_path):
    path = tmp_path / "pos.csv"
    path.write_text(POSITIONS)
    parts = read_positions(path)
    assert [(p.ref, p.position_mm, p.side) for p in parts] == [
        ("D1", (-2.5, 0.25), "bottom"),
        ("LED2", (2.5, 0.25), "top"),
        ("PD1", (0.5, -1.5), "bottom"),
    ]
    assert [p.is_led for p in parts] == [True, True, False] and parts[1].rotation_deg == 90


def test_negated_x_counts_on_the_bottom_alone(tmp_path):
    path = tmp_path / "pos.csv"
    path.write_text(POSITIONS)
    assert [p.position_mm[0] for p in read_positions(path, negate_x_on_bottom=True)] == [2.5, 2.5, -0.5]


@pytest.mark.parametrize("negated", [False, True])
def test_what_is_written_is_read_back(tmp_path, negated):
    parts = (
        PlacedPart("D1", "led_800", "LED_die", (-1.25, 0.5), 0.0, "bottom"),
        PlacedPart("PD1", "a, b", "PD", (0.3, -2.0), 90.0, "top"),
    )
    write_positions(tmp_path / "pos.csv", parts, negate_x_on_bottom=negated)
    assert read_positions(tmp_path / "pos.csv", negate_x_on_bottom=negated) == parts


@pytest.mark.parametrize("name", ["outline.csv", "outline.dxf"])
def test_an_outline_is_read_as_it_was_written(tmp_path, name):
    write_outline(tmp_path / name, SQUARE)
    assert list(read_outline(tmp_path / name)) == SQUARE


def test_lines_in_any_order_and_direction_are_one_outline(tmp_path):
    a, b, c, d = SQUARE
    path = tmp_path / "board.dxf"
    path.write_text(ENTITIES.format(line(a, b) + line(d, c) + line(c, b) + line(d, a)))
    assert set(read_outline(path)) == set(SQUARE)


def test_an_arc_becomes_a_polygon_of_nearly_its_area(tmp_path):
    path = tmp_path / "board.dxf"
    path.write_text(ENTITIES.format("0\nCIRCLE\n10\n0.0\n20\n0.0\n40\n4.0\n"))
    corners = read_outline(path)
    area = sum(a[0] * b[1] - b[0] * a[1] for a, b in zip(corners, corners[1:] + corners[:1], strict=True)) / 2
    # A polygon of 72 sides has sinc(2 pi / 72) of the circle's area.
    assert area == pytest.approx(16 * math.pi, rel=2e-3) and len(corners) == 72


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "missing"),
        ("Ref,Val\n", "missing"),
        (POSITIONS.replace("-2.500000", "left"), "line 2: PosX"),
        (POSITIONS.replace(",top", ",edge"), "Side"),
        (POSITIONS.replace('"LED2"', '"D1"'), "twice"),
        (POSITIONS.splitlines()[0], "no part"),
    ],
)
def test_a_wrong_position_file_is_refused_in_one_line(tmp_path, text, words):
    path = tmp_path / "pos.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=words) as caught:
        read_positions(path)
    assert len(str(caught.value).splitlines()) == 1 and "pos.csv" in str(caught.value)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("o.csv", "u,v\n1,2\n", "x_mm,y_mm"),
        ("o.csv", "x_mm,y_mm\n0,0\n1,1\n2,2\n", "no area"),
        ("o.dxf", ENTITIES.format(""), "has no LINE"),
        ("o.dxf", ENTITIES.format(line((0, 0), (1, 0)) + line((5, 5), (6, 5))), "not one closed line"),
        ("o.dxf", ENTITIES.format(line((0, 0), (1, 0)) + line((1, 0), (1, 1))), "open"),
    ],
)
def test_a_wrong_outline_is_refused_in_one_line(tmp_path, name, text, words):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=words) as caught:
        read_outline(tmp_path / name)
    assert len(str(caught.value).splitlines()) == 1


def test_a_scene_takes_candidates_and_outline_from_the_files_beside_it(tmp_path):
    (tmp_path / "pos.csv").write_text(POSITIONS.replace('"LED2"', '"PD2"'))
    write_outline(tmp_path / "board.dxf", SQUARE)
    (tmp_path / "scene.toml").write_text("""
schema_version = 1
[finger]
[[leds]]
name = "ir"
part = "led_800"
[[photodiodes]]
name = "pd"
position_mm = [2.0, 0.0]
[placement]
outline = "board.dxf"
[[placement.candidates]]
name = "mine"
positions = "pos.csv"
negate_x_on_bottom = true
""")
    placement = load_scene(tmp_path / "scene.toml").placement
    assert placement.candidates[0].leds_mm == ((2.5, 0.25),)
    assert placement.candidates[0].photodiodes_mm == ((2.5, 0.25), (-0.5, -1.5))
    assert list(placement.outline_mm) == SQUARE

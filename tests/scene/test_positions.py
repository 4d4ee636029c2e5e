"""Position files: read, written back the same, and refused in one line where they are wrong."""

import csv

import pytest
from pydantic import ValidationError

from nailoptics.errors import InputError
from nailoptics.scene.importers.positions import (
    PlacedPart,
    read_positions,
    warn_of_bottom,
    write_positions,
)
from nailoptics.scene.placement import Candidate
from nailoptics.scene.rectangles import turned

# As `kicad-cli pcb export pos --format csv --units mm --side both` writes it.
POSITIONS = """Ref,Val,Package,PosX,PosY,Rot,Side
"D1","IR800","LED_die",-2.500000,0.250000,0.000000,bottom
"LED2","IR940","LED_die",2.500000,0.250000,90.000000,top
"PD1","element","PD_1x0.25mm",0.500000,-1.500000,0.000000,bottom
"""


def test_positions_of_both_sides_are_read_in_order(tmp_path):
    path = tmp_path / "pos.csv"
    path.write_text(POSITIONS)
    parts = read_positions(path)
    assert [(p.ref, p.position_mm, p.side) for p in parts] == [
        ("D1", (-2.5, 0.25), "bottom"),
        ("LED2", (2.5, 0.25), "top"),
        ("PD1", (0.5, -1.5), "bottom"),
    ]
    assert [p.kind for p in parts] == ["led", "led", "photodiode"] and parts[1].rotation_deg == 90


def test_negated_x_counts_on_the_bottom_alone(tmp_path):
    path = tmp_path / "pos.csv"
    path.write_text(POSITIONS)
    assert [p.position_mm[0] for p in read_positions(path, negate_x_on_bottom=True)] == [2.5, 2.5, -0.5]


BOTH = [(10.0, "top"), (20.0, "top"), (-12.0, "bottom"), (-18.0, "bottom")]


@pytest.mark.parametrize(
    ("places", "board", "words"),
    [
        (BOTH, {}, "looks negated"),
        ([(-142.5, "bottom"), (-157.5, "bottom")], {}, "looks negated"),
        ([(-2.0, "bottom"), (1.0, "bottom")], {}, "may be negated"),
        ([(142.5, "bottom"), (157.5, "bottom")], {}, ""),
        ([(x if side == "top" else -x, side) for x, side in BOTH], {}, ""),
        ([(-2.0, "top"), (1.0, "top")], {}, ""),
        (BOTH, {"negate_x_on_bottom": False}, ""),
    ],
)
def test_x_that_may_be_negated_is_a_warning(caplog, places, board, words):
    result = [PlacedPart(f"PD{i}", "", "", (x, 0.0), 0.0, side) for i, (x, side) in enumerate(places)]
    warn_of_bottom({"positions": "pos.csv"} | board, result, result)
    assert words in caplog.text and bool(words) == ("negate_x_on_bottom = true" in caplog.text)


def test_what_is_written_is_read_back(tmp_path):
    parts = (
        PlacedPart("D1", "led_800", "LED_die", (-1.25, 0.5), 0.0, "bottom"),
        PlacedPart("PD1", "a, b", "PD", (0.3, -2.0), 90.0, "top"),
    )
    write_positions(tmp_path / "pos.csv", parts)
    assert read_positions(tmp_path / "pos.csv") == parts


@pytest.mark.parametrize("text", ['=1+1","0', "+D1", "-D1", "@SUM(A1)", '2 "inches"', "'plain", "<b>"])
def test_a_boards_own_texts_neither_break_the_file_nor_run_as_formulas(tmp_path, text):
    """References come from a designer's board, on which "-D1" is a name, too."""
    parts = (PlacedPart(text, text, text, (1.0, 2.0), 0.0, "top"), PlacedPart("D2", "", "", (0.0, 0.0), 90.0, "top"))
    write_positions(tmp_path / "pos.csv", parts)
    with (tmp_path / "pos.csv").open(newline="") as file:
        cells = [cell for row in csv.reader(file) for cell in row]
    assert len(cells) == 3 * 7 and not [cell for cell in cells if cell.startswith(("=", "+", "-", "@"))]
    assert read_positions(tmp_path / "pos.csv") == parts


def test_a_text_of_several_lines_is_written_as_one(tmp_path):
    write_positions(tmp_path / "pos.csv", [PlacedPart("D1\nD2", "a", "b", (1.0, 2.0), 0.0, "top")])
    assert [one.ref for one in read_positions(tmp_path / "pos.csv")] == ["D1 D2"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "missing"),
        ("PK\x03\x04 and so on", "is a spreadsheet"),
        ("Ref,Val\n", "missing"),
        (POSITIONS.replace("-2.500000", "left"), "line 2: PosX"),
        (POSITIONS.replace(",top", ",edge"), "Side"),
        (POSITIONS.replace("-2.500000", "1e9"), "too far away"),
        (POSITIONS.replace("-2.500000", "3 furlongs"), "not a number"),
        (POSITIONS + "D9\n", "line 5: has 1 columns"),
        (POSITIONS.replace("PosX", "PosX (furlong)"), "unit of its column"),
        (POSITIONS.splitlines()[0], "no part"),
    ],
)
def test_a_wrong_position_file_is_refused_in_one_line(tmp_path, text, words):
    path = tmp_path / "pos.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=words) as caught:
        read_positions(path)
    assert len(str(caught.value).splitlines()) == 1 and "pos.csv" in str(caught.value)


def test_a_reference_that_is_there_twice_is_refused_for_parts_alone(tmp_path):
    path = tmp_path / "pos.csv"
    holes = "REF**,,,1,1,0,top\nREF**,,,2,1,0,top\n"
    table = {"name": "a", "positions": "pos.csv", "negate_x_on_bottom": False}
    path.write_text(POSITIONS + holes)
    assert len(Candidate.model_validate(table, context={"folder": tmp_path}).leds_mm) == 2
    path.write_text(POSITIONS.replace('"LED2"', '"D1"') + holes)
    with pytest.raises(ValidationError, match='pos.csv: Ref: the name "D1" is used twice'):
        Candidate.model_validate(table, context={"folder": tmp_path})


def test_a_missing_side_column_is_warned_of(tmp_path, caplog):
    path = tmp_path / "pos.csv"
    path.write_text("Ref,PosX,PosY,Rot\nD1,1,2,0\n")
    assert read_positions(path)[0].side == "top" and "pos.csv: no column states the side" in caplog.text


def test_kicads_ascii_file_is_read_in_its_unit(tmp_path):
    path = tmp_path / "board.pos"
    path.write_text(
        "### Footprint positions - created on 2024-05-01 ###\n### Printed by KiCad version 8.0.1\n"
        "## Unit = inches, Angle = deg.\n## Side : All\n"
        "# Ref     Val     Package         PosX       PosY       Rot  Side\n"
        "D1        IR_800  LED_die       0.1000    -0.2000   33.5000  bottom\n## End\n"
    )
    (part,) = read_positions(path)
    assert part.position_mm == pytest.approx((2.54, -5.08)) and (part.rotation_deg, part.side) == (33.5, "bottom")


@pytest.mark.parametrize(
    ("text", "encoding"),
    [
        ("Designator,Mid X,Mid Y,Layer,Rotation\nD1,2.5mm,-1.25mm,Top,45\n", "utf-8"),
        ("Designator;Mid X;Mid Y;Layer;Rotation\nD1;2,5;-1,25;T;45\n", "utf-8-sig"),
        ("Designator\tCenter-X(mm)\tCenter-Y(mm)\tRotation\tLayer\nD1\t2.5\t-1.25\t45\tTopLayer\n", "utf-16"),
        (
            'Altium Designer Pick and Place Locations\n\nUnits used: mil\n\n"Designator","Comment","Layer","Footprint",'
            '"Center-X(mil)","Center-Y(mil)","Rotation"\n"D1","10µF","TopLayer","x","98.4252","-49.2126","45"\n',
            "cp1252",
        ),
        ("Part,X (in),Y (in),Angle,Side\nD1,0.0984252,-0.0492126,45,F.Cu\n", "utf-8"),
        ('RefDes;PosX;PosY;Rot;Side\n"D1";"98.4252 mil";"-1250um";45°;top\n', "utf-8"),
        (
            "Altium Designer Pick and Place Locations\nC:\\Work\\Pick Place for PCB1.txt\n\nUnits used: mm\n\n"
            "Designator Comment      Layer    Footprint Center-X(mm) Center-Y(mm) Rotation Description\n"
            'D1         "IR LED 800" TopLayer 0603      2.5000       -1.2500      45       "LED, ""IR"", 0.6 mm"\n',
            "utf-8",
        ),
        (
            "# PcbXY Version 1.0\n# RefDes, Description, Value, X, Y, rotation, top/bottom\n"
            '# X,Y in mil.  rotation in degrees.\n# ---\nD1,"0603","IR",98.4252,-49.2126,45,top\n',
            "utf-8",
        ),
        ("RefDes,Name,X (mm),Y (mm),Side,Rotate,Value\nD1,LED,2.5,-1.25,Top,45,IR\n", "utf-8"),
        ("Ref Des\tX-Loc (thou)\tY-Loc (thou)\tRotation (deg)\tFace\nD1\t98.4252\t-49.2126\t45 deg\tFront\n", "utf-8"),
        ("PARTNUM,REFDES,LAYER,ORIENT.,Body Center X,Body Center Y\n,D1,Top,45,2.5,-1.25\n", "utf-8"),
    ],
    ids=[
        *("JLCPCB", "semicolons, decimal commas", "tabs, UTF-16", "Altium", "inches", "units in the cells"),
        *("Altium's text", "pcb-rnd", "DipTrace", "thou", "OrCAD"),
    ],
)
def test_files_of_assemblers_are_read_as_they_come(tmp_path, text, encoding):
    path = tmp_path / "pos.csv"
    path.write_text(text, encoding=encoding)
    (part,) = read_positions(path)
    assert (part.ref, part.rotation_deg, part.side) == ("D1", 45, "top")
    assert part.position_mm == pytest.approx((2.5, -1.25), abs=1e-5)


def test_points_turn_against_the_clock_and_exactly_by_quarters():
    assert turned((2.0, 1.0), 90) == (-1.0, 2.0) and turned((2.0, 1.0), -90) == (1.0, -2.0)
    assert turned((2.0, 1.0), 540) == (-2.0, -1.0)
    assert turned((1.0, 0.0), 30) == pytest.approx((3**0.5 / 2, 0.5))

"""Drawings: arcs, bulges, splines, ellipses, blocks and units read; what is written opens without repair."""

import math

import ezdxf
import pytest
from ezdxf.enums import InsertUnits

from nailoptics.errors import InputError
from nailoptics.scene.importers.board_files import read_outline
from nailoptics.scene.importers.outlines import OUTLINE_LAYERS, Outline, write_outline
from nailoptics.scene.rectangles import area_mm2

SQUARE = ((-4.0, -5.0), (4.0, -5.0), (4.0, 5.0), (-4.0, 5.0))
ENTITIES = "0\nSECTION\n2\nENTITIES\n{}0\nENDSEC\n0\nEOF\n"


def line(a, b):
    return f"0\nLINE\n8\nEdge.Cuts\n10\n{a[0]}\n20\n{a[1]}\n11\n{b[0]}\n21\n{b[1]}\n"


def drawn(tmp_path, draw, *, units=4):
    """The outline of what a function draws."""
    drawing = ezdxf.new()
    drawing.header["$INSUNITS"] = units
    draw(drawing, drawing.modelspace())
    drawing.saveas(tmp_path / "board.dxf")
    return read_outline(tmp_path / "board.dxf")


def test_a_drawing_of_bare_entities_is_read(tmp_path):
    a, b, c, d = SQUARE
    path = tmp_path / "board.dxf"
    path.write_text(ENTITIES.format(line(a, b) + line(d, c) + line(c, b) + line(d, a)))
    assert read_outline(path).corners_mm == SQUARE


@pytest.mark.parametrize(
    ("draw", "area"),
    [
        (lambda _, space: space.add_circle((1, 2), 4), math.pi * 16),
        # A stadium: two sides of 10 and two half circles of radius 2.
        (
            lambda _, space: space.add_lwpolyline(
                [(0, 0, 0), (10, 0, 1), (10, 4, 0), (0, 4, 1)], format="xyb", close=True
            ),
            40 + math.pi * 4,
        ),
        (lambda _, space: space.add_polyline2d([(0, 0, 0), (4, 0, 1)], format="xyb", close=True), math.pi * 2),
        (lambda _, space: space.add_ellipse((0, 0), (5, 0), ratio=0.6), math.pi * 15),
        (lambda _, space: (space.add_arc((0, 0), 4, 0, 180), space.add_line((-4, 0), (4, 0))), math.pi * 8),
        # A cubic Bezier arch over a chord of 6, its handles 4 above its ends: 3/5 of 6 * 4.
        (
            lambda _, space: (
                space.add_open_spline([(0, 0), (0, 4), (6, 4), (6, 0)], degree=3),
                space.add_line((0, 0), (6, 0)),
            ),
            14.4,
        ),
    ],
    ids=["circle", "bulges", "old polyline", "ellipse", "arc", "spline"],
)
def test_curves_become_polygons_of_their_area(tmp_path, draw, area):
    # Lines within 2 um of a curve some 30 mm long have an error below 0.06 mm2.
    assert area_mm2(drawn(tmp_path, draw).corners_mm) == pytest.approx(area, abs=0.06)


def test_blocks_are_taken_apart_where_they_are_put(tmp_path):
    def draw(drawing, space):
        hole = drawing.blocks.new("HOLE")
        hole.add_circle((0, 0), 0.5)
        pair = drawing.blocks.new("PAIR")
        pair.add_blockref("HOLE", (-2, 0))
        pair.add_blockref("HOLE", (2, 0), dxfattribs={"xscale": 2, "yscale": 2})
        space.add_lwpolyline(SQUARE, close=True)
        space.add_blockref("PAIR", (0, 1))

    outline = drawn(tmp_path, draw)
    assert outline.corners_mm == SQUARE
    assert sorted(area_mm2(hole) for hole in outline.holes_mm) == pytest.approx([math.pi / 4, math.pi], abs=0.02)


@pytest.mark.parametrize(("unit", "unit_mm"), [("Inches", 25.4), ("Centimeters", 10.0), ("Millimeters", 1.0)])
def test_a_drawings_unit_is_read(tmp_path, unit, unit_mm):
    corners = [(x / unit_mm, y / unit_mm) for x, y in SQUARE]
    units = int(InsertUnits[unit])
    outline = drawn(tmp_path, lambda _, space: space.add_lwpolyline(corners, close=True), units=units)
    assert [c for p in outline.corners_mm for c in p] == pytest.approx([c for p in SQUARE for c in p], abs=2e-6)


def test_an_unknown_unit_is_refused(tmp_path):
    with pytest.raises(InputError, match="its unit .* is not known"):
        drawn(tmp_path, lambda _, space: space.add_lwpolyline(SQUARE, close=True), units=99)


def test_of_several_layers_that_of_the_outline_counts(tmp_path):
    assert "edge.cuts" in OUTLINE_LAYERS

    def draw(_, space):
        space.add_lwpolyline(SQUARE, close=True, dxfattribs={"layer": "Edge.Cuts"})
        space.add_circle((0, 0), 40, dxfattribs={"layer": "Drawing"})
        space.add_text("nail")

    assert drawn(tmp_path, draw) == Outline(SQUARE)


def test_a_written_drawing_is_read_back(tmp_path):
    hole = ((-1.0, -1.0), (1.0, -1.0), (0.0, 1.0))
    write_outline(tmp_path / "outline.dxf", Outline(SQUARE, (hole,)))
    assert read_outline(tmp_path / "outline.dxf") == Outline(SQUARE, (hole,))


def test_a_block_that_holds_itself_ends(tmp_path):
    def draw(drawing, space):
        drawing.blocks.new("A").add_blockref("A", (0, 0))
        space.add_blockref("A", (0, 0))

    with pytest.raises(InputError, match="board.dxf: "):
        drawn(tmp_path, draw)


@pytest.mark.parametrize(
    ("draw", "words"),
    [
        (lambda block: block.add_line((0, 0), (1, 1)), "more than 20000 things"),
        (lambda block: None, "more than 20000 things"),
        (lambda block: block.add_circle((0, 0), 1000), "more than 200000 points"),
    ],
    ids=["lines", "nothing", "curves"],
)
def test_a_drawing_of_countless_things_is_refused(tmp_path, draw, words):
    def blocks(drawing, space):
        draw(drawing.blocks.new("A"))
        grid = {"row_count": 30000, "column_count": 30000, "row_spacing": 1, "column_spacing": 1}
        drawing.blocks.new("B").add_blockref("A", (0, 0), dxfattribs=grid)
        space.add_blockref("B", (0, 0), dxfattribs=grid)

    with pytest.raises(InputError, match=words):
        drawn(tmp_path, blocks)


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("o.dxf", b"", "has no line"),
        ("o.dxf", b"\x89PNG\r\n\x1a\n" * 50, "no DXF drawing"),
        ("o.dxf", b"AutoCAD Binary DXF\r\n\x1a\x00abc", "no DXF drawing"),
        ("o.dxf", ENTITIES.format("").encode(), "has no line"),
        ("o.dxf", ENTITIES.format(line(SQUARE[0], SQUARE[1]).split("11\n")[0]).encode(), "LINE lacks one of start"),
        ("o.dxf", ENTITIES.format("0\nCIRCLE\n10\n0.0\n20\n0.0\n").encode(), "CIRCLE lacks"),
        ("o.dxf", ENTITIES.format(line(SQUARE[0], SQUARE[1])).encode(), "open at"),
        ("o.csv", b"u,v\n1,2\n", "x_mm,y_mm"),
        ("o.csv", b"x_mm,y_mm\n0,0\n1,1\n2,2\n", "no area"),
        ("o.csv", b"x_mm,y_mm\n0\n", "y_mm = '' is not a finite number"),
    ],
)
def test_a_wrong_drawing_or_list_of_corners_is_refused_in_one_line(tmp_path, name, data, words):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(InputError, match=words) as caught:
        read_outline(tmp_path / name)
    assert len(str(caught.value).splitlines()) == 1


def test_the_package_that_reads_drawings_is_named_where_it_is_missing(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "ezdxf", None)
    (tmp_path / "o.dxf").write_text(ENTITIES.format(""))
    with pytest.raises(InputError, match=r"pip install 'nailoptics\[cad\]'"):
        read_outline(tmp_path / "o.dxf")

"""Outlines: read, written back the same, and refused in one line where they are wrong."""

import math

import pytest

from nailoptics.errors import InputError
from nailoptics.scene.dxf import read_outline, write_outline

SQUARE = [(-4.0, -5.0), (4.0, -5.0), (4.0, 5.0), (-4.0, 5.0)]
ENTITIES = "0\nSECTION\n2\nENTITIES\n{}0\nENDSEC\n0\nEOF\n"


def line(a, b):
    return f"0\nLINE\n8\nEdge.Cuts\n10\n{a[0]}\n20\n{a[1]}\n11\n{b[0]}\n21\n{b[1]}\n"


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

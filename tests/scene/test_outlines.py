"""Outlines: lines joined in any order, holes detected, room computed exactly, and wrong ones refused in one line."""

import math
import random

import ezdxf
import pytest

from nailoptics.errors import InputError
from nailoptics.scene.importers.board_files import read_outline
from nailoptics.scene.importers.kicad import write_board
from nailoptics.scene.importers.outlines import Outline, join, write_outline
from nailoptics.scene.rectangles import area_mm2, has_room

SQUARE = ((-4.0, -5.0), (4.0, -5.0), (4.0, 5.0), (-4.0, 5.0))
HOLE = ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0))


def sides(corners):
    return list(zip(corners, (*corners[1:], corners[0]), strict=True))


def ring(count, radius=4.0):
    return tuple(
        (radius * math.cos(math.tau * i / count), radius * math.sin(math.tau * i / count)) for i in range(count)
    )


def test_an_outline_is_read_from_corners_and_from_a_board(tmp_path):
    (tmp_path / "o.csv").write_text("x_mm,y_mm\n" + "".join(f"{x},{y}\n" for x, y in SQUARE))
    assert read_outline(tmp_path / "o.csv") == Outline(SQUARE)
    write_board(tmp_path / "o.kicad_pcb", [], [], Outline(SQUARE, (HOLE,)), thickness_mm=0.025)
    result = read_outline(tmp_path / "o.kicad_pcb")
    for line, expected in zip((result.corners_mm, *result.holes_mm), (SQUARE, HOLE), strict=True):
        assert line == tuple(pytest.approx(corner) for corner in expected)


def test_a_written_drawing_opens_without_repair(tmp_path):
    write_outline(tmp_path / "outline.dxf", Outline(SQUARE, (HOLE,)))
    drawing = ezdxf.readfile(tmp_path / "outline.dxf")
    audit = drawing.audit()
    assert (audit.errors, audit.fixes, drawing.units) == ([], [], 4)
    lines = [[tuple(v.dxf.location.vec2) for v in one.vertices] for one in drawing.modelspace().query("POLYLINE")]
    assert lines == [list(SQUARE), list(HOLE)] and all(one.is_closed for one in drawing.modelspace())


def test_lines_in_any_order_and_direction_are_one_outline():
    lines = [line[::-1] if i % 2 else line for i, line in enumerate(sides(SQUARE) + sides(HOLE))]
    random.Random(1).shuffle(lines)
    result = join(lines, "x")
    assert result.corners_mm == SQUARE and result.holes_mm == (HOLE,)


def test_ends_that_nearly_meet_are_one_place_and_doubled_lines_count_once():
    lines = [((x + 0.003, y - 0.003), b) for (x, y), b in sides(SQUARE)] * 2
    assert area_mm2(join(lines, "x").corners_mm) == pytest.approx(80, rel=2e-3)


def test_an_end_is_found_however_many_others_lie_close():
    # Two ends of other lines lie farther than the tolerance from it, and nearer than the size of its neighbourhood.
    corner = (0.0001, 0.0001)
    lines = [(corner, (8.0, 0.0)), ((8.0, 0.0), (8.0, 8.0)), ((8.0, 8.0), (0.0095, 0.0095)), ((0.0095, 0.0095), corner)]
    lines += [((0.0095, 0.0095), (1.0, 3.0)), ((3.0, 1.0), corner)]
    assert area_mm2(join(lines, "x").corners_mm) == pytest.approx(32, rel=1e-2)


def test_where_lines_branch_the_border_goes_round_the_outside():
    # A square with a wedge of a fillet in its corner, drawn with all three sides: the wedge is board.
    wedge = [((4, 5), (4, 7)), ((4, 7), (2, 5))]
    lines = [line for line in sides(SQUARE) if line != (SQUARE[2], SQUARE[3])]
    lines += [((4.0, 5.0), (2.0, 5.0)), ((2.0, 5.0), (-4.0, 5.0)), *wedge]
    assert area_mm2(join(lines, "x").corners_mm) == pytest.approx(80 + 2)


def test_what_is_neither_border_nor_hole_is_left_out():
    in_hole = [(x / 4, y / 4) for x, y in HOLE]
    beside = [(x + 9, y) for x, y in HOLE]
    lines = [*sides(SQUARE), *sides(HOLE), *sides(in_hole), *sides(beside), ((2, 2), (3, 3)), ((2.5, 2), (3, 2.5))]
    assert join(lines, "x") == Outline(SQUARE, (HOLE,))


@pytest.mark.parametrize(
    ("around", "area"), [([], 130), ([(2, 2)], 100), ([(12, 5)], 30), ([(2, 2), (12, 5)], 130), ([(50, 50)], 130)]
)
def test_of_boards_that_share_an_edge_the_one_with_parts_is_taken(around, area):
    panel = [((0, 0), (10, 0), (10, 10), (0, 10)), ((10, 0), (15, 0), (15, 6), (10, 6))]
    result = join([line for board in panel for line in sides(board)], "x", around=around)
    assert area_mm2(result.corners_mm) == pytest.approx(area) and not result.holes_mm


def test_any_lines_make_an_outline_or_an_error():
    """Rectangles that overlap and share edges, with lines across them; the border holds every rectangle or is refused
    because a line outside is longer."""
    draw = random.Random(1)
    for _ in range(300):
        corners = [(*(draw.randint(0, 6) for _ in range(2)), *(draw.randint(1, 5) for _ in range(2))) for _ in "abc"]
        boxes = [((x, y), (x + w, y), (x + w, y + h), (x, y + h)) for x, y, w, h in corners[: draw.randint(1, 3)]]
        lines = [line for box in boxes for line in sides(box)]
        lines += [tuple((draw.randint(0, 8), draw.randint(0, 8)) for _ in "ab") for _ in range(draw.randint(0, 4))]
        try:
            result = join(lines, "x")
        except InputError as error:
            assert "open at" in str(error)
        else:
            assert area_mm2(result.corners_mm) >= max(map(area_mm2, boxes)) - 1e-9


def test_a_thousand_lines_that_cross_one_another_are_refused():
    lines = [line for k in range(500) for line in (((0, k), (500, k)), ((k, 0), (k, 500)))]
    with pytest.raises(InputError, match="1000 lines cross one another"):
        join(lines, "x")


@pytest.mark.long
def test_ten_thousand_holes_are_detected():
    holes = [[(x + 0.2 * a, y + 0.2 * b) for a, b in HOLE] for x in range(100) for y in range(100)]
    lines = [line for one in (((-1, -1), (100, -1), (100, 100), (-1, 100)), *holes) for line in sides(one)]
    result = join(lines, "x")
    assert len(result.holes_mm) == 10_000


@pytest.mark.parametrize(
    ("center", "half", "free"),
    [
        ((2.5, 0.0), (1.5, 5.0), True),  # touches the border on three sides, and the hole on the fourth
        ((2.5, 0.0), (1.51, 1.0), False),
        ((2.4, 0.0), (1.5, 1.0), False),  # 0.1 mm into the hole
        ((0.0, 0.0), (0.5, 0.5), False),  # within the hole
        ((0.0, 3.0), (4.0, 1.9), True),
        ((0.0, 0.0), (3.0, 3.0), False),  # around the hole
        ((6.0, 0.0), (1.0, 1.0), False),  # beside the board
    ],
)
def test_room_within_the_border_and_off_its_holes(center, half, free):
    assert has_room(center, half, SQUARE, [HOLE]) is free


def test_a_slot_without_a_corner_under_a_part_is_detected():
    slot = ((-3.0, -0.01), (3.0, -0.01), (3.0, 0.01), (-3.0, 0.01))
    assert not has_room((0.0, 0.5), (1.0, 0.5), SQUARE, [slot]) and has_room((0.0, 0.52), (1.0, 0.5), SQUARE, [slot])


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ([((0, 0), (1, 0)), ((5, 5), (6, 5))], "open at"),
        (sides(SQUARE)[:3], "open at .* 10 mm to the next end"),
        # A closed mounting hole does not make an open border closed.
        (sides(SQUARE)[:3] + sides(HOLE), "open at"),
        ([((0, 0), (1e9, 0))], "check its units"),
        ([((0, 0), (0, 0))], "no area"),
        ([], "no area"),
    ],
)
def test_lines_that_close_nothing_are_refused(lines, words):
    with pytest.raises(InputError, match=f"^x: .*({words})"):
        join(lines, "x")

"""A board whose outline is drawn: below it lies epoxy, beside it air; its light is that of the same board by size."""

import math

import numpy as np
import pytest
from small_scenes import PLAIN_FINGER
from watertight import check_watertight

from nailoptics.geometry import build, underside
from nailoptics.light import trace
from nailoptics.scene import parse_scene
from nailoptics.scene.rectangles import area_mm2
from nailoptics.studies.placement.robustness import _glued

BOX = [(-3.0, -3.5), (3.0, -3.5), (3.0, 3.5), (-3.0, 3.5)]
ELLIPSE = [(round(3.0 * math.cos(a), 4), round(3.5 * math.sin(a), 4)) for a in np.linspace(0, math.tau, 61)[:-1]]
NOTCH = [(-3.0, -3.5), (3.0, -3.5), (3.0, 3.5), (1.1, 3.5), (1.1, 0.9), (-0.63, 0.9), (-0.63, 3.5), (-3.0, 3.5)]
HOLE = [(1.3, -2.0), (2.3, -2.0), (2.3, -1.1), (1.3, -1.1)]
PARTS_MM2 = 0.25**2 + 1.0 * 0.25


def scene(border=None, *holes, **board):
    """The usual LED and photodiode on a board with a border."""
    board = {"barrier": "false"} | board
    if border is not None:
        lines = [[[float(x), float(y)] for x, y in line] for line in (border, *holes)]
        board |= {"outline_mm": lines[0], "outline_holes_mm": lines[1:]}
    text = "".join(f"{name} = {value}\n" for name, value in board.items())
    return parse_scene(f"{PLAIN_FINGER}[board]\n{text}")


def above_nail(geometry, u, v, height_mm):
    """The region at a place of the flat board, so far above the nail."""
    angle, radius = u / geometry.board_radius_mm, geometry.nail_radius_mm + height_mm
    at = [[radius * math.sin(angle), v, radius * math.cos(angle) - geometry.nail_radius_mm]]
    return geometry.regions[geometry.region_at(np.array(at))[0]]


@pytest.mark.parametrize("lines", [(ELLIPSE,), (NOTCH,), (BOX, HOLE), (ELLIPSE, HOLE)])
def test_the_underside_has_the_area_of_the_drawing_and_air_lies_beside_it(lines):
    """Expected: straight edges are met exactly, and of an oblique one the steps leave less than 1 %."""
    geometry = build(scene(*lines))
    area = abs(area_mm2(lines[0])) - sum(abs(area_mm2(hole)) for hole in lines[1:]) - PARTS_MM2
    tolerance = 0.01 if lines[0] is ELLIPSE else 1e-3
    assert underside(geometry).area_mm2 == pytest.approx(area, rel=tolerance)
    assert check_watertight(geometry, crossings=100_000).passed
    assert above_nail(geometry, 0.0, -2.0, 0.2) == "epoxy"
    beside = (1.8, -1.5) if len(lines) > 1 else (0.3, 2.5) if lines[0] is NOTCH else (2.7, 3.2)
    assert above_nail(geometry, *beside, 0.2) == "air"


def test_a_drawn_rectangle_is_the_board_of_that_size():
    drawn, sized = build(scene(BOX)), build(scene(size_mm=[6.0, 7.0]))
    assert np.array_equal(drawn.vertices, sized.vertices) and np.array_equal(drawn.triangles, sized.triangles)


def test_walls_end_with_the_board():
    """Expected: of a wall along the board what the notch takes is air, and what is left a barrier."""
    geometry = build(scene(NOTCH, barrier="true", barrier_gap_mm=0.2))
    wall_u = -1.2 + 0.125 + 0.2 + 0.075
    assert above_nail(geometry, wall_u, -2.0, 0.2) == "barrier"
    inside = build(scene([(a, b) if b < 3 else (a, 2.0) for a, b in NOTCH], barrier="true", barrier_gap_mm=0.2))
    assert above_nail(inside, wall_u, 3.0, 0.2) == "air"


def test_a_board_that_is_glued_at_an_angle_takes_its_border_along():
    """Expected: corners of border and hole lie as far from LED and photodiode as before, turned by the angle."""
    straight = scene(NOTCH, HOLE)
    glued = _glued(straight, du_mm=0.1, angle_deg=5.0)

    def lines_and_parts(layout):
        corners = np.array([corner for line in layout.border_mm for corner in line])
        return corners, np.array([r.center_mm for r in (*layout.leds, *layout.photodiode_areas)])

    (before, parts), (after, moved) = (lines_and_parts(one.layout) for one in (straight, glued))
    ways, turned = before[:, None] - parts, after[:, None] - moved
    assert np.linalg.norm(turned, axis=-1) == pytest.approx(np.linalg.norm(ways, axis=-1))
    angle = np.angle((turned @ [1, 1j]) / (ways @ [1, 1j]), deg=True)
    assert angle == pytest.approx(np.full(angle.shape, 5.0))


@pytest.mark.long
@pytest.mark.jit
def test_light_below_a_drawn_border_is_that_of_the_same_board_by_size(jit_backend):
    """Expected: a nick of 2 um turns a rectangle into a drawing, whose reading is the rectangle's; a notch that ends
    beside the photodiode changes it."""
    nicked = [*BOX[:2], (3.0, 0.0), (2.998, 0.001), (3.0, 0.002), *BOX[2:]]
    near = [(-3.0, -3.5), (3.0, -3.5), (3.0, 3.5), (0.8, 3.5), (0.8, 0.2), (-1.6, 0.2), (-1.6, 3.5), (-3.0, 3.5)]
    read = [
        trace(one, photons=1 << 17, backend=jit_backend.name, store=False)
        for one in (scene(size_mm=[6.0, 7.0]), scene(nicked), scene(near))
    ]
    value, error = np.array([[one.at()[f"detected_fraction{end}"].item() for end in ("", "_stderr")] for one in read]).T
    # Of one seed the two share most photons: over six seeds they differ by 0.4 of these errors at most.
    assert abs(value[1] - value[0]) < 2 * math.hypot(*error[:2])
    assert abs(value[2] - value[0]) > 8 * math.hypot(error[0], error[2])

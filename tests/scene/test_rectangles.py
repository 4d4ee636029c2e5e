"""Rectangles on the board: turned ones keep their area and moments as strips, overlap by their edges, hold points."""

import numpy as np
import pytest

from nailoptics.scene.rectangles import STRIP_MM, Rectangle


@pytest.mark.parametrize("angle", [0.0, 90.0, 180.0, 270.0, -90.0, 1e-9])
def test_quarter_turns_are_rectangles_along_the_axes(angle):
    result = Rectangle.around("a", (1.0, 2.0), (1.0, 0.25), angle)
    size = (0.25, 1.0) if round(angle / 90) % 2 else (1.0, 0.25)
    assert result.turned_size_mm is None and result.size_mm == pytest.approx(size)
    assert result.strips() == (result,) and result.center_mm == pytest.approx((1.0, 2.0))


@pytest.mark.parametrize("angle", [10.0, 30.0, 45.0, 100.0, 200.0, -20.0])
def test_strips_have_the_area_and_the_centre_of_a_turned_rectangle(angle):
    result = Rectangle.around("a", (0.3, -0.7), (1.0, 0.25), angle)
    strips = result.strips()
    areas = np.array([one.area_mm2 for one in strips])
    assert result.area_mm2 == 0.25 and areas.sum() == pytest.approx(0.25)
    center = areas @ np.array([one.center_mm for one in strips]) / areas.sum()
    # Along v a strip's light counts at its middle, which is inexact in the two at the ends alone.
    assert center == pytest.approx((0.3, -0.7), abs=STRIP_MM / 20)
    assert all(low.v_max == high.v_min for low, high in zip(strips, strips[1:], strict=False))
    assert (result.v_min, result.v_max) == (strips[0].v_min, strips[-1].v_max)


def test_touching_elements_share_the_steps_between_their_corners():
    one, other = (Rectangle.around("a", (0.0, v), (2.0, 0.5), 90 - 35) for v in (0.0, 0.5 / np.cos(np.radians(55))))
    rights = {round(s.v_min, 9): s for s in one.strips()}
    shared = [(rights[round(s.v_min, 9)], s) for s in other.strips() if round(s.v_min, 9) in rights]
    gaps = [min(abs(a.u_max - b.u_min), abs(b.u_max - a.u_min)) for a, b in shared]
    # Exactly where both fill a strip from side to side; at corners their steps differ by less than a strip.
    assert sum(gap < 1e-9 for gap in gaps) >= 5 and max(gaps) < STRIP_MM / 2


def test_a_turned_rectangle_holds_the_points_within_its_own_edges():
    result = Rectangle.around("a", (1.0, 1.0), (2.0, 0.5), 45)
    along = np.array([0.7, 0.72, 0.0, -0.2])
    # On its long axis its end lies 1 mm from the centre, that is 0.707 along u and v.
    assert result.holds(1 + along[:2], 1 + along[:2]).tolist() == [True, False]
    assert result.holds(1 + along[2:], 1 - along[2:]).tolist() == [True, False]  # across: 0.25 mm, 0.177 along each
    rng = np.random.default_rng(1)
    u, v = rng.uniform(-0.5, 2.5, (2, 100_000))
    # 9 mm2 of points: the share has a standard error of 1e-3.
    assert 9 * result.holds(u, v).mean() == pytest.approx(1.0, abs=0.04)


def test_overlaps_are_along_the_edges_of_either():
    one = Rectangle.around("a", (0.0, 0.0), (2.0, 0.5), 45)
    other = Rectangle.around("b", (0.4, -0.4), (2.0, 0.5), 45)
    assert one.overlap_mm(other) == pytest.approx(0.5 - 0.8 / 2**0.5)
    # Their bounds overlap, they do not.
    assert one.overlap_mm(Rectangle.around("c", (0.7, -0.7), (0.2, 0.2))) < 0 < one.u_max - 0.6
    assert one.overlap_mm(Rectangle.around("d", (0.6, 0.6), (0.2, 0.2))) > 0

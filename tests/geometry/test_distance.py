"""Safe distances: never too long, and not much too short."""

import numpy as np
import pytest

from nailoptics.geometry import build, distance_grid
from nailoptics.geometry.distance import CAP_MM, NORMAL_STEPS, PLANE_REACH_MM, PLANE_STEP_MM


def exact_distance(point, corners):
    """Distance from a point to the nearest of triangles (m, 3, 3), by cases."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    over = np.ones(len(a), bool)
    edges = np.full(len(a), np.inf)
    for u, v in ((a, b), (b, c), (c, a)):
        over &= np.einsum("ij,ij->i", np.cross(v - u, point - u), normal) >= 0
        t = np.clip(((point - u) * (v - u)).sum(axis=1) / ((v - u) ** 2).sum(axis=1), 0, 1)
        edges = np.minimum(edges, np.linalg.norm(u + t[:, None] * (v - u) - point, axis=1))
    return np.where(over, np.abs(((point - a) * normal).sum(axis=1)), edges).min()


@pytest.mark.parametrize("spacing", [0.1, 0.2])
def test_bounds_hold_and_are_tight(geometry, spacing):
    bounds = np.array([[-2.0, -0.5, -3.0], [0.0, 1.0, 0.6]])
    grid = distance_grid(geometry, spacing_mm=spacing, bounds_mm=bounds)
    assert (grid.distance_mm.shape == np.ceil((bounds[1] - bounds[0]) / spacing - 1e-9)).all()
    cells = np.random.default_rng(0).integers(0, grid.distance_mm.shape, (600, 3))
    cells = cells[geometry.region_at(grid.centers(cells)) != 0][:250]
    corners = geometry.vertices[geometry.triangles]
    # Farther triangles cannot be nearer than the cap.
    close = ((corners.min(axis=1) < bounds[1] + 1) & (corners.max(axis=1) > bounds[0] - 1)).all(axis=1)
    corners = corners[close]
    true = np.array([exact_distance(p, corners) for p in grid.centers(cells)])
    short = np.minimum(true, CAP_MM) - grid.distance_mm[tuple(cells.T)]
    assert short.min() >= 0
    assert (short[true < 0.5 * spacing] <= 0.4 * spacing).all()
    assert (short[true >= 0.5 * spacing] <= 0.3 * spacing + 0.02 * true[true >= 0.5 * spacing]).all()
    assert short.mean() < 0.15 * spacing


def test_the_air_has_no_distance_and_tissue_has(geometry):
    grid = distance_grid(geometry, spacing_mm=0.5)
    cells = np.argwhere(np.ones(grid.distance_mm.shape, bool))
    air = geometry.region_at(grid.centers(cells)) == 0
    assert (grid.distance_mm.ravel()[air] == 0).all()
    assert (grid.distance_mm.ravel()[~air] > 0).mean() > 0.5
    assert grid.distance_mm.max() == pytest.approx(CAP_MM, rel=1e-5)


def in_the_plate(geometry, bounds, count):
    """Random places (k, 3) in the nail plate, and their distances (k,) to the nearest interface. [mm]"""
    corners = geometry.vertices[geometry.triangles]
    close = (corners.max(axis=1) > bounds[0] - 0.5) & (corners.min(axis=1) < bounds[1] + 0.5)
    corners = corners[close.all(axis=1)]
    low, high = corners.min(axis=1) - 0.3, corners.max(axis=1) + 0.3
    points = np.random.default_rng(1).uniform(*bounds, (20 * count, 3))
    points = points[geometry.regions.index("plate") == geometry.region_at(points)][:count]
    # The plate is 0.5 mm thick: nothing farther away is nearest.
    near = [corners[((low < point) & (high > point)).all(axis=1)] for point in points]
    return points, np.array([exact_distance(*one) for one in zip(points, near, strict=True)])


@pytest.mark.parametrize("spacing, share", [(0.1, 0.7), (0.15, 0.7), (0.25, 0.3)])
def test_planes_hold_in_the_plate_and_tell_more_than_centres(geometry, spacing, share):
    bounds = np.array([[-2.0, -0.5, -1.0], [0.0, 1.0, 0.0]])
    grid = distance_grid(geometry, spacing_mm=spacing, bounds_mm=bounds)
    points, true = in_the_plate(geometry, bounds, 1000)
    assert (true < PLANE_REACH_MM).sum() > 200
    cells = np.floor((points - grid.origin_mm) / spacing).astype(int)
    at, off = tuple(cells.T), points - grid.centers(cells)
    slack, offset = grid.slack_steps[at] * PLANE_STEP_MM, grid.offset_steps[at] * PLANE_STEP_MM
    x, y = grid.normal_steps[at].T / NORMAL_STEPS
    height = x * off[:, 0] + y * off[:, 1] + np.sqrt(1 - x**2 - y**2) * off[:, 2] + offset
    plane = np.minimum(np.abs(height) - slack, PLANE_REACH_MM)
    has_plane = slack > 0
    assert (plane <= true + 1e-6)[has_plane].all()
    near = true < PLANE_REACH_MM
    assert has_plane[near].mean() > share
    # What a plane leaves out is a small part of a cell.
    assert np.median((true - plane)[near & has_plane]) < 0.012
    center = (grid.distance_mm[at] - np.linalg.norm(off, axis=1)).clip(0)
    assert (true - plane.clip(0))[near & has_plane].mean() < 0.5 * (true - center)[near & has_plane].mean()


@pytest.mark.parametrize("spacing, planes", [(0.25, True), (0.4, False)])
def test_coarse_cells_have_no_planes(geometry, spacing, planes):
    grid = distance_grid(geometry, spacing_mm=spacing, bounds_mm=np.array([[-2.0, -0.5, -1.0], [0.0, 1.0, 0.0]]))
    assert grid.slack_steps.any() == planes and (grid.distance_mm > 0).any()


@pytest.mark.jit
@pytest.mark.parametrize("barrier", [True, False])
def test_distances_are_never_too_long_and_seldom_too_short(jit_backend, sensor, barrier):
    from nailoptics.light.walk.interfaces import Interfaces, mi

    geometry = build(sensor(board=f"barrier = {str(barrier).lower()}"))
    bounds = np.array([[-2.0, -0.5, -1.0], [0.0, 1.0, 0.0]])
    interfaces = Interfaces(geometry, distance_grid(geometry, bounds_mm=bounds))
    points, true = in_the_plate(geometry, bounds, 1000)
    free = np.array(interfaces.free(mi.Point3f(points.T.astype(np.float32)), True))
    assert (free <= true + 2e-6).all()
    assert np.median((true - free)[true < PLANE_REACH_MM]) < 0.015
    beyond = interfaces.free(mi.Point3f([-9.0, 0.0, 1e9], [0.0, 0.0, 1e9], [0.0, 9.0, 1e9]), True)
    assert (np.array(beyond) == 0).all()

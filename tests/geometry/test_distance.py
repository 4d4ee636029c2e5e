"""Safe distances: never too long, and not much too short."""

import numpy as np
import pytest

from nailoptics.geometry import distance_grid


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
    short = np.minimum(true, grid.cap_mm) - grid.distance_mm[tuple(cells.T)]
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
    assert grid.distance_mm.max() == pytest.approx(grid.cap_mm, rel=1e-5)

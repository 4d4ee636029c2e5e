"""Safe distances: never too long, and not much too short."""

import numpy as np
import pytest

from nailoptics.geometry import build, distance_grid
from nailoptics.geometry.distance import CAP_MM, SHELL_MM


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


def heights(geometry, points):
    """Heights of points over the nail plate's outer face. [mm]"""
    return np.hypot(points[:, 0], points[:, 2] + geometry.nail_radius_mm) - geometry.nail_radius_mm


def test_shells_are_the_faces_of_plate_bed_and_board(geometry):
    grid = distance_grid(geometry, spacing_mm=0.5)
    assert np.all(np.diff(grid.shells_mm) < SHELL_MM + 3e-5) and np.all(np.diff(grid.shells_mm) > 0)
    for regions in (("plate", "epoxy"), ("bed", "plate"), ("bone", "bed")):
        below, above = map(geometry.regions.index, regions)
        face = geometry.triangles[(geometry.below == below) & (geometry.above == above)]
        assert len(face) > 100
        middles = heights(geometry, geometry.vertices[face].mean(1))
        between = (middles[:, None] > grid.shells_mm[:, 0]) & (middles[:, None] < grid.shells_mm[:, 1])
        assert between.all(0).sum() == 1


@pytest.mark.jit
@pytest.mark.parametrize("barrier", [True, False])
def test_distances_are_never_too_long_and_seldom_too_short(jit_backend, sensor, barrier):
    from nailoptics.light.walk.interfaces import Interfaces, mi

    geometry = build(sensor(board=f"barrier = {str(barrier).lower()}"))
    bounds = np.array([[-2.0, -0.5, -1.0], [0.0, 1.0, 0.0]])
    interfaces = Interfaces(geometry, distance_grid(geometry, bounds_mm=bounds, spacing_mm=0.2))
    points, true = in_the_plate(geometry, bounds, 1000)
    known = interfaces.clearance(mi.Point3f(points.T.astype(np.float32)), True)
    assert (np.array(known.distance) <= true + 2e-6).all() and np.array(known.distance).mean() > 0.2 * true.mean()
    assert (np.array(known.off_shell) >= np.array(known.distance)).all()
    assert np.allclose(np.array(known.height), heights(geometry, points), atol=1e-5)
    beyond = interfaces.clearance(mi.Point3f([-9.0, 0.0, 1e9], [0.0, 0.0, 1e9], [0.0, 9.0, 1e9]), True)
    assert (np.array(beyond.distance) == 0).all() and (np.array(beyond.off_shell) == 0).all()


@pytest.fixture(scope="module", params=[True, False], ids=["barrier", "no barrier"])
def steps_to_try(request, sensor):
    """A geometry, bounds (2, 3) around it, and starts (n, 3), directions (n, 3) and lengths (n,) of steps of light in
    the finger and on it: anywhere, from within a few micrometres of the plate's faces, and chords between two places
    right over a shell. [mm]"""
    geometry = build(sensor(board=f"barrier = {str(request.param).lower()}"))
    low, high = bounds = np.array([[-5.5, -6.5, -4.0], [5.5, 6.5, 0.5]])
    rng, nail_mm, count = np.random.default_rng(1), geometry.nail_radius_mm, 1 << 17
    axis = np.array([0.0, 0.0, nail_mm])
    anywhere, near = rng.uniform(low, high, (2, count, 3))
    face = rng.choice([0.0, -0.45], count) + rng.normal(0, 3e-3, count)
    scale = (nail_mm + face) / (nail_mm + heights(geometry, near))
    near = (near + axis) * np.stack([scale, scale**0, scale], 1) - axis
    angle, part = rng.uniform(-0.4, 0.4, count), rng.uniform(0.01, 0.08, count)
    over = nail_mm + rng.choice([-0.45, -2.15], count) + rng.uniform(2e-5, 4e-4, count)
    along = rng.uniform(-3, 1, count)
    ends = [np.stack([over * np.sin(one), along, over * np.cos(one)], 1) - axis for one in (angle, angle + part)]
    way = np.concatenate([rng.normal(size=(2 * count, 3)), ends[1] - ends[0]])
    length = np.concatenate([rng.exponential(0.09, 2 * count), np.linalg.norm(ends[1] - ends[0], axis=1)])
    starts = np.concatenate([anywhere, near, ends[0]])
    inside = geometry.region_at(starts) > 0
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    return geometry, bounds, starts[inside], way[inside], length[inside]


@pytest.mark.jit
@pytest.mark.parametrize("spacing", [0.2, 0.4])
def test_no_free_step_meets_an_interface_and_most_others_do(jit_backend, steps_to_try, spacing):
    from nailoptics.light.walk.interfaces import Interfaces, mi

    geometry, bounds, starts, ways, lengths = steps_to_try
    interfaces = Interfaces(geometry, distance_grid(geometry, bounds_mm=bounds, spacing_mm=spacing))
    start, w, step = mi.Point3f(starts.T), mi.Vector3f(ways.T), mi.Float(lengths)
    here, there = interfaces.clearance(start, True), interfaces.clearance(start + w * step, True)
    free = np.array(interfaces.is_free(step, here, there, interfaces.layer(here.height)))
    hit = interfaces.scene.ray_intersect_preliminary(mi.Ray3f(start, w, step, 0, []), coherent=False, active=True)
    hit = np.array(hit.is_valid())
    assert hit.sum() > 1000 and not (free & hit).any(), (free & hit).sum()
    assert (~free & ~hit).mean() < 0.35, (~free & ~hit).mean()

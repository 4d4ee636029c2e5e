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


def exact_distances(points, corners):
    """Distances (k,) from points (k, 3) to the nearest of triangles, at most CAP_MM. [mm]"""
    low, high = corners.min(axis=1) - CAP_MM, corners.max(axis=1) + CAP_MM
    near = [corners[((low < point) & (high > point)).all(axis=1)] for point in points]
    distances = [exact_distance(*one) if len(one[1]) else np.inf for one in zip(points, near, strict=True)]
    return np.minimum(distances, CAP_MM)


def beside_shells(geometry, grid):
    """The triangles (m, 3, 3) that are no parts of shells: those that reach below the plate's outer face, and those
    that reach above it."""
    corners = geometry.vertices[geometry.triangles][~grid.in_shell]
    at = heights(geometry, corners.reshape(-1, 3)).reshape(-1, 3)
    # No triangle dips farther between its corners.
    return corners[at.min(1) < grid.outer_mm + 1e-3], corners[at.max(1) > grid.outer_mm]


@pytest.mark.parametrize("spacing", [0.2, 0.3])
def test_bounds_hold_and_are_tight(geometry, spacing):
    grid = distance_grid(geometry, spacing_mm=spacing)
    low, high = geometry.bounds_mm
    assert (grid.distance_mm.shape[1:] == np.ceil((high - low) / spacing - 1e-9)).all()
    # Around the board's walls, and where plate and bed end beside the nail.
    boxes = ([-2.0, -1.5, -0.3], [0.5, 1.0, 0.6]), ([4.0, -2.0, -3.0], [6.0, 2.0, -0.5])
    points = np.concatenate([np.random.default_rng(0).uniform(*box, (400, 3)) for box in boxes])
    cells = np.floor((points - grid.origin_mm) / spacing).astype(int)
    cells = cells[geometry.region_at(grid.centers(cells)) != 0]
    for bound_mm, corners in zip(grid.distance_mm, beside_shells(geometry, grid), strict=True):
        true = exact_distances(grid.centers(cells), corners)
        short = true - bound_mm[tuple(cells.T)]
        assert short.min() >= 0 and (true < CAP_MM).sum() > 50
        assert (short[true < 0.5 * spacing] <= 0.4 * spacing).all()
        assert (short[true >= 0.5 * spacing] <= 0.3 * spacing + 0.02 * true[true >= 0.5 * spacing]).all()
        assert short.mean() < 0.15 * spacing


def test_the_air_has_no_distance_and_tissue_has(geometry):
    grid = distance_grid(geometry, spacing_mm=0.5)
    cells = np.argwhere(np.ones(grid.distance_mm.shape[1:], bool))
    air = geometry.region_at(grid.centers(cells)) == 0
    for bound_mm in grid.distance_mm:
        assert (bound_mm.ravel()[air] == 0).all()
        assert (bound_mm.ravel()[~air] > 0).mean() > 0.5
    assert grid.distance_mm.max() == pytest.approx(CAP_MM, rel=1e-5)


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
    grid = distance_grid(geometry, spacing_mm=0.2)
    interfaces = Interfaces(geometry, grid)
    points = np.random.default_rng(1).uniform([-2.0, -0.5, -0.3], [6.0, 1.0, 0.4], (1000, 3))
    points = points[geometry.region_at(points) != 0]
    known = interfaces.clearance(mi.Point3f(points.T.astype(np.float32)), True)
    for bound, corners in zip((known.below, known.above), beside_shells(geometry, grid), strict=True):
        true = exact_distances(points, corners)
        assert (np.array(bound) <= true + 2e-6).all() and np.array(bound).mean() > 0.2 * true.mean()
    assert np.allclose(np.array(known.height), heights(geometry, points), atol=1e-5)
    beyond = interfaces.clearance(mi.Point3f([-19.0, 0.0, 1e9], [0.0, 0.0, 1e9], [0.0, 9.0, 1e9]), True)
    assert (np.array(beyond.below) == 0).all() and (np.array(beyond.above) == 0).all()


@pytest.fixture(scope="module", params=[True, False], ids=["barrier", "no barrier"])
def steps_to_try(request, sensor):
    """A geometry, and starts (n, 3), directions (n, 3) and lengths (n,) of steps of light in the finger and on it:
    anywhere, from within a few micrometres of the plate's faces, and chords between two places right over a shell.
    [mm]"""
    geometry = build(sensor(board=f"barrier = {str(request.param).lower()}"))
    low, high = np.array([[-5.5, -6.5, -4.0], [5.5, 6.5, 0.5]])
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
    return geometry, starts[inside], way[inside], length[inside]


@pytest.mark.jit
@pytest.mark.parametrize("spacing", [pytest.param(0.2, marks=pytest.mark.long), 0.4])
def test_no_free_step_meets_an_interface_and_most_others_do(jit_backend, steps_to_try, spacing):
    from nailoptics.light.walk.interfaces import Interfaces, mi

    geometry, starts, ways, lengths = steps_to_try
    interfaces = Interfaces(geometry, distance_grid(geometry, spacing_mm=spacing))
    start, w, step = mi.Point3f(starts.T), mi.Vector3f(ways.T), mi.Float(lengths)
    here, there = interfaces.clearance(start, True), interfaces.clearance(start + w * step, True)
    free = np.array(interfaces.is_free(step, here, there, interfaces.layer(here.height, 0)))
    hit = interfaces.scene.ray_intersect_preliminary(mi.Ray3f(start, w, step, 0, []), coherent=False, active=True)
    hit = np.array(hit.is_valid())
    assert hit.sum() > 1000 and not (free & hit).any(), (free & hit).sum()
    assert (~free & ~hit).mean() < 0.35, (~free & ~hit).mean()


@pytest.mark.jit
def test_no_free_step_from_a_face_that_was_just_met_meets_an_interface(jit_backend, steps_to_try):
    from nailoptics.light.walk.interfaces import Interfaces, mi, off_surface

    geometry, *_ = steps_to_try
    grid = distance_grid(geometry)
    interfaces, rng, count = Interfaces(geometry, grid), np.random.default_rng(2), 1 << 18
    face = rng.choice(np.flatnonzero(grid.in_shell), count)
    corners, normal = geometry.vertices[geometry.triangles[face]], geometry.normals(geometry.triangles[face])
    start = np.einsum("ni,nij->nj", rng.dirichlet([1, 1, 1], count), corners)
    away = normal * rng.choice([-1, 1], count)[:, None]
    ways = rng.normal(size=(count, 3))
    ways *= (np.sign((ways * away).sum(1)) / np.linalg.norm(ways, axis=1))[:, None]
    outwards = (away * (start + [0, 0, geometry.nail_radius_mm]))[:, ::2].sum(1)
    # Some fly along the face, and some have steps so short that they end beside it.
    ways[::4] -= 0.999 * (ways * away).sum(1)[::4, None] * away[::4]
    step, side = mi.Float(rng.exponential(np.where(np.arange(count) % 3, 0.09, 0.003))), mi.Float(np.sign(outwards))
    p, w = off_surface(mi.Point3f(start.T.astype(np.float32)), mi.Vector3f(away.T)), mi.Vector3f(ways.T)
    here, there = interfaces.clearance(p, True), interfaces.clearance(p + w * step, True)
    layer = interfaces.layer(here.height, side)
    here.height = there.height
    free = np.array(interfaces.is_free(step, here, there, layer))
    hit = interfaces.scene.ray_intersect_preliminary(mi.Ray3f(p, w, step, 0, []), coherent=False, active=True)
    hit = np.array(hit.is_valid())
    assert hit.sum() > 1000 and not (free & hit).any(), (free & hit).sum()
    for way in (outwards > 0, outwards < 0):
        assert free[way].mean() > 0.3

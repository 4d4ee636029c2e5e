"""The checker: it passes what is watertight and detects what is not."""

import dataclasses

import numpy as np
import pytest
from watertight import check_watertight

from nailoptics.geometry import build
from nailoptics.geometry.cast import cast


def test_a_hundred_thousand_crossings_agree(geometry):
    report = check_watertight(geometry, crossings=100_000)
    assert report.passed and report.disagreements == 0 and report.crossings >= 100_000
    assert report.volume_error < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("digit", ["thumb", "index", "middle", "ring", "little"])
def test_a_million_crossings_agree_on_every_digit(sensor, digit):
    report = check_watertight(build(sensor(finger=f'digit = "{digit}"')), crossings=1_000_000)
    assert report.passed and report.crossings >= 1_000_000


def test_a_missing_patch_is_detected(geometry):
    # 20 of some 36 000 triangles.
    keep = np.ones(len(geometry.triangles), bool)
    keep[5000:5020] = False
    holed = dataclasses.replace(
        geometry, triangles=geometry.triangles[keep], below=geometry.below[keep], above=geometry.above[keep]
    )
    report = check_watertight(holed, crossings=100_000)
    assert not report.passed and report.disagreements > 5 and report.volume_error > 1e-6


def test_a_wrong_label_is_detected(geometry):
    below = geometry.below.copy()
    below[below == geometry.regions.index("bed")] = geometry.regions.index("pulp")
    report = check_watertight(dataclasses.replace(geometry, below=below), crossings=20_000)
    assert not report.passed and report.disagreements > 100


def test_a_bent_surface_is_detected(geometry):
    vertices = geometry.vertices.copy()
    bent = (np.abs(vertices[:, 1]) < 5) & (np.abs(vertices[:, 0]) < 3) & (np.abs(vertices[:, 2]) < 0.3)
    vertices[bent, 2] += 0.02
    assert not check_watertight(dataclasses.replace(geometry, vertices=vertices), crossings=100_000).passed


@pytest.mark.parametrize("moved_mm", [0.0, 0.5])
def test_the_least_volume_is_that_of_the_tetrahedra(geometry, moved_mm):
    """Of the grid as it is, which leaves no room, and of one that a node moved through its neighbours folds."""
    nodes = geometry.grid.nodes.copy()
    nodes[20, 20, 3] += moved_mm
    grid = dataclasses.replace(geometry.grid, nodes=nodes)
    corners = grid.nodes.reshape(-1, 3)[grid.tetrahedra()[0]]
    volumes = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
    assert grid.least_volume_mm3 == pytest.approx(volumes.min(), abs=1e-12)
    assert (volumes.min() < -1e-4) == (moved_mm > 0)


def test_rays_through_edges_and_corners_cross_once():
    # Two triangles that share the diagonal of a square: each ray on it, or on its ends, meets at most one of them.
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    triangles = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    place = np.linspace(0, 1, 33)[1:-1]
    ray, _, _, forward = cast(vertices, triangles, np.column_stack([place, place]))
    assert (ray == np.arange(31)).all() and forward.all()
    # A closed fan around a vertex, rays exactly on it: in and out come in pairs.
    corners = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, -1]])
    fan = np.array([[0, i, i % 4 + 1] for i in range(1, 5)] + [[5, i % 4 + 1, i] for i in range(1, 5)], np.int32)
    _, z, _, forward = cast(corners, fan, np.zeros((1, 2)))
    assert forward.tolist() == [False, True] and z.tolist() == [-1.0, 1.0]

"""Tetrahedra fill the geometry exactly once, and its interfaces are faces of theirs."""

import itertools

import numpy as np
import pytest
from watertight import volumes_mm3

from nailoptics.assets import data_dir
from nailoptics.exports.monte_carlo import FLAT_MM3, TetMesh, tetrahedra
from nailoptics.geometry import Geometry, build
from nailoptics.scene import load_scene


@pytest.fixture(scope="module")
def crowded() -> Geometry:
    """A thumb with every part that a scene may leave out, a turned die, and parts that stand out of the board."""
    scene = load_scene(data_dir("scenes") / "prototype.toml")
    assert scene.finger
    led = scene.leds[0].model_copy(update={"rotation_deg": 30.0, "height_um": 150.0})
    parts = {"finger": type(scene.finger)(digit="thumb"), "leds": (led,)}
    return build(scene.model_copy(update=parts | {"light": type(scene.light)(left_out=())}))


@pytest.fixture(scope="module", params=["geometry", "crowded"])
def filled(request) -> tuple[Geometry, TetMesh]:
    """A geometry, and its tetrahedra."""
    geometry = request.getfixturevalue(request.param)
    return geometry, tetrahedra(geometry)


def test_tetrahedra_fill_every_region_and_none_is_flat(filled):
    geometry, mesh = filled
    corners = mesh.nodes[mesh.tetrahedra]
    sizes_mm3 = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
    assert sizes_mm3.min() > FLAT_MM3 / 6
    filled = np.bincount(mesh.region, sizes_mm3, len(geometry.regions))
    volumes = volumes_mm3(geometry)
    assert filled[1:] == pytest.approx(list(volumes.values()), abs=1e-9 * sum(volumes.values()))
    assert filled[0] == 0
    # Each lies in the region that it is labelled with, by the triangles' arithmetic, too.
    some = slice(None, None, 97)
    assert (geometry.region_at(corners.mean(axis=1)[some]) == mesh.region[some]).all()


def test_neighbours_share_whole_faces_and_interfaces_are_among_them(filled):
    geometry, mesh = filled
    faces = np.concatenate([mesh.tetrahedra[:, list(three)] for three in itertools.combinations(range(4), 3)])
    region = np.tile(mesh.region, 4)
    # A face as one number, which is sorted in a fraction of the time of a row.
    number = np.ravel_multi_index(np.sort(faces, axis=1).T, (len(mesh.nodes),) * 3)
    number, which = np.unique(number, return_inverse=True)
    shared = np.column_stack(np.unravel_index(number, (len(mesh.nodes),) * 3))
    count = np.bincount(which)
    # A face of one alone borders on air.
    assert set(count) == {1, 2}
    low, high = np.full(len(shared), len(geometry.regions)), np.zeros(len(shared), int)
    np.minimum.at(low, which, region)
    np.maximum.at(high, which, region)
    low[count == 1] = 0

    def keys(corners: np.ndarray, one: np.ndarray, other: np.ndarray) -> set[tuple[float, ...]]:
        places = [sorted(map(tuple, three)) for three in corners.tolist()]
        pairs = zip(places, one.tolist(), other.tolist(), strict=True)
        return {(*itertools.chain(*three), *sorted((a, b))) for three, a, b in pairs}

    between = low != high
    result = keys(mesh.nodes[shared[between]], low[between], high[between])
    assert result == keys(geometry.vertices[geometry.triangles], geometry.below, geometry.above)

"""Files for other programs describe the geometry."""

import numpy as np
import pytest
import trimesh
from watertight import volumes_mm3

from nailoptics import export, load_scene
from nailoptics.errors import InputError
from nailoptics.exports.mesh_files import write_mesh


def test_glb_has_one_closed_named_part_per_region(geometry, tmp_path):
    scene = trimesh.load_scene(write_mesh(load_scene("prototype"), tmp_path / "finger.glb")["mesh"])
    volumes = {name: v for name, v in volumes_mm3(geometry).items() if v > 0}
    assert set(scene.geometry) == set(volumes)
    for name in ("plate", "bed", "bone", "epoxy", "cover", "led:ir"):
        part = scene.geometry[name]
        assert part.is_watertight and part.is_winding_consistent
        # The file holds single precision.
        assert part.volume == pytest.approx(volumes[name], rel=1e-3)
    # In metres, with the nail up.
    low, high = geometry.bounds_mm[:, [0, 2, 1]] * 1e-3
    assert scene.bounds[:, 1:] == pytest.approx(np.array([low, high])[:, 1:], abs=1e-6)


def test_ply_has_each_face_once_with_both_regions(geometry, tmp_path):
    path = write_mesh(load_scene("prototype"), tmp_path / "finger.ply")["mesh"]
    raw = trimesh.load(path, process=False).metadata["_ply_raw"]["face"]["data"]
    assert (raw["below"] == geometry.below).all() and (raw["above"] == geometry.above).all()
    assert b"comment region 2 bed\n" in path.read_bytes()[:4000]


def test_other_endings_and_impossible_folders_are_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"\.glb, \.ply, \.kicad_pcb"):
        export(load_scene("prototype"), tmp_path / "finger.stl")
    with pytest.raises(InputError, match="cannot be written"):
        write_mesh(load_scene("prototype"), tmp_path / "file" / "finger.glb")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]

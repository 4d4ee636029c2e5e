"""One line where something cannot be written."""

import pytest

import nailoptics
from nailoptics.assets import data_dir
from nailoptics.cli import run
from nailoptics.errors import InputError


@pytest.mark.parametrize(
    ("path", "format_", "why"),
    [
        ("finger.stl", None, "names no format"),
        ("finger", None, "names no format"),
        ("finger.ply", "glb", "ends in .glb"),
        ("there.txt", "mmc", "is a file where format mmc makes a folder"),
        ("there.txt/below", "mmc", "cannot be written"),
        ("there.txt/finger.glb", "glb", "cannot be written"),
        ("finger", "obj", "is unknown; choose from"),
    ],
)
def test_bad_places_and_formats_are_refused_before_anything_is_written(tmp_path, path, format_, why):
    scene = nailoptics.load_scene(data_dir("scenes") / "prototype.toml")
    (tmp_path / "there.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(InputError, match=why):
        nailoptics.export(scene, tmp_path / path, format=format_)
    assert [one.name for one in tmp_path.iterdir()] == ["there.txt"]


def test_voxels_belong_to_one_format(tmp_path):
    scene = nailoptics.load_scene(data_dir("scenes") / "prototype.toml")
    with pytest.raises(InputError, match="belongs to the format mcx"):
        nailoptics.export(scene, tmp_path / "out", format="mmc", voxel_mm=0.1)
    assert not list(tmp_path.iterdir())


def test_a_refusal_is_one_line_that_names_the_scene(tmp_path, capfd):
    assert run(["export", "phantom", "-o", str(tmp_path / "out"), "--format", "mmc"]) == 2
    out = capfd.readouterr()
    assert out.err.count("\n") == 1 and "phantom" in out.err and not out.out

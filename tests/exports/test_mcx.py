"""Voxels for MCX: labels, source and photodiodes are where the geometry has them, as near as a staircase can be."""

import json
import subprocess
import sys

import numpy as np
import pytest

import nailoptics
from nailoptics.assets import data_dir
from nailoptics.errors import InputError
from nailoptics.exports import run_pmcx
from nailoptics.exports.carried import as_seen
from nailoptics.exports.mcx import labels, staircase
from nailoptics.exports.voxels import voxels
from nailoptics.geometry import build
from nailoptics.light import optics
from nailoptics.scene import load_scene

SIDE_MM = 0.2


@pytest.fixture(scope="module")
def scene():
    """The prototype with a turned die, and Kapton as thin as it is."""
    scene = load_scene(data_dir("scenes") / "prototype.toml")
    die = scene.leds[0].model_copy(update={"rotation_deg": 30.0})
    return scene.model_copy(update={"leds": (die,), "light": type(scene.light)()})


@pytest.fixture(scope="module")
def folder(scene, tmp_path_factory):
    where = tmp_path_factory.mktemp("exports") / "voxels here"
    nailoptics.export(scene, where, format="mcx", voxel_mm=SIDE_MM)
    return where


@pytest.fixture(scope="module")
def session(folder):
    return json.loads((folder / "1_ir.json").read_text(encoding="utf-8"))


def test_voxels_have_the_region_at_their_middle(geometry):
    made = voxels(geometry, 0.3)
    middles = made.origin_mm + made.side_mm * (np.stack(np.indices(made.region.shape), -1) + 0.5)
    here = geometry.region_at(middles.reshape(-1, 3)).reshape(made.region.shape)
    # Only around the faces of dies and photodiodes something else is meant.
    around = np.zeros(here.shape, bool)
    for face in (*geometry.leds, *geometry.photodiodes):
        around |= (np.abs(middles - face.center_mm) < 2.0).all(axis=-1)
    assert (made.region == here)[~around].all() and (~around).mean() > 0.5
    # Air all round, but above, where the backs of the photodiodes reach.
    assert (
        (made.region[[0, -1]] == 0).all() and (made.region[:, [0, -1]] == 0).all() and (made.region[..., 0] == 0).all()
    )


def test_every_label_has_the_media_of_its_region(scene, folder, session):
    geometry = build(scene)
    volume = run_pmcx.volume(session, folder, "labels.bin", np.uint8)
    media = optics.finger_media(scene, geometry.regions, scene.leds[0].wavelength_nm)
    rows = [[m[key] for key in ("mua", "mus", "g", "n")] for m in session["Domain"]["Media"]]
    random = np.random.default_rng(1)
    places = geometry.bounds_mm[0] + random.random((20_000, 3)) * np.ptp(geometry.bounds_mm, axis=0)
    at = np.floor((places - session["nailoptics"]["origin_mm"]) / SIDE_MM).astype(int)
    middles = session["nailoptics"]["origin_mm"] + SIDE_MM * (at + 0.5)
    region, label = geometry.region_at(middles), volume[tuple(at.T)]
    sure = np.abs(middles[:, 2]) > 2  # below the board and its parts
    for r in np.unique(region[sure]):
        for one in np.unique(label[sure & (region == r)]):
            if r == 0 or media.opaque[r]:
                assert one == (len(rows) - 1 if r == 0 else 0)
            else:
                assert rows[one] == pytest.approx([media.mu_a[r], media.mu_s[r], media.g[r], media.n[r]])
    assert len(np.unique(region[sure])) > 3
    assert rows[-1] == [0, 0, 1, 1] and volume[0, 0, 0] == len(rows) - 1


def test_all_of_the_die_shines_from_the_epoxy_and_nothing_stands_before_it(scene, folder, session):
    made = run_pmcx.config(session, folder, photons=1, seed=1)
    source, sides = np.array(made["srcpos"]), np.array([made["srcparam1"][:3], made["srcparam2"][:3]])
    assert np.linalg.norm(sides, axis=1) * SIDE_MM == pytest.approx([0.25, 0.25])
    assert abs(sides[0] @ sides[1]) < 1e-9
    die = build(scene).leds[0]
    centre = (source + sides.sum(axis=0) / 2) * SIDE_MM + session["nailoptics"]["origin_mm"]
    assert centre == pytest.approx(die.center_mm, abs=2e-3)
    # Turned against the clock by 30 degrees from the board's axis along the nail.
    assert abs(sides[1][1]) / np.linalg.norm(sides[1]) == pytest.approx(np.cos(np.radians(30)), abs=1e-6)
    assert np.isneginf(made["srcdir"][3]) and made["srcdir"][2] < -0.9
    share = np.random.default_rng(0).random((5000, 2))
    places = source + share @ sides
    epoxy = 1 + session["nailoptics"]["absorbers"].index("epoxy")
    for way in (0.0, 0.5, 1.0):
        at = np.floor(places + way * np.array(made["srcdir"][:3])).astype(int)
        assert (made["vol"][tuple(at.T)] == epoxy).all()


def test_photodiodes_show_their_area_and_are_told_apart(scene, folder, session):
    geometry = build(scene)
    volume = run_pmcx.volume(session, folder, "labels.bin", np.uint8)
    number = run_pmcx.volume(session, folder, "photodiodes.bin", np.uint16)
    assert (volume[number > 0] == 0).all()
    places, expected = [], []
    for k, face in enumerate(geometry.photodiodes, start=1):
        seen = np.argwhere((number[:, :, 1:] == k) & (volume[:, :, :-1] > 0))
        # Each column of voxels whose middle is over the face shows one face of a voxel, give or take one row.
        assert len(seen) * SIDE_MM**2 == pytest.approx(face.area_mm2, abs=1.3 * SIDE_MM)
        places.append(seen + [0.5, 0.5, 1.0])
        expected += [k - 1] * len(seen)
        sphere = session["Optode"]["Detector"][k - 1]
        assert (np.linalg.norm(places[-1] - sphere["Pos"], axis=1) < sphere["R"]).all()
    where = np.concatenate(places).T
    media = len(session["Domain"]["Media"]) - 1
    ways, path = np.tile([[0.0], [0.0], [1.0]], where.shape[1]), np.full((media, where.shape[1]), 2.0)
    rows = np.concatenate([np.ones((1, where.shape[1])), path, where, ways])
    which, paths = run_pmcx.kept(session, folder, rows)
    assert which.tolist() == expected
    assert paths.shape == (len(expected), media - 1) and (paths == 2.0 * SIDE_MM).all()
    # Whoever goes down again has reached none.
    rows[-1] = -1.0
    assert len(run_pmcx.kept(session, folder, rows)[0]) == 0


def test_the_error_of_the_staircase_is_told_and_volumes_converge(geometry, folder):
    assert "| plate, epoxy |" in (folder / "README.md").read_text(encoding="utf-8")
    worst = []
    for side_mm in (0.4, 0.1):
        rows = [line.split(" | ") for line in staircase(geometry, voxels(geometry, side_mm))[2:]]
        errors = {row[0].strip("| "): abs(float(row[3].rstrip("% |"))) for row in rows}
        worst.append(max(errors[name] for name in ("plate", "bed", "bone", "pulp")))
    assert worst[1] < worst[0] / 2 and worst[1] < 2
    # The skin's area does not converge: a staircase around a round body shows up to 3/2 of it.
    assert 20 < errors["air, pulp"] < 50


def test_labels_fit_a_byte_for_every_number_of_zones(scene, geometry):
    many = as_seen(scene.model_copy(update={"blood": type(scene.blood)(zones=32)}), reflecting=False)
    found = labels(many, build(many), voxels(geometry, 0.3))
    assert found.dtype == np.uint8 and len(np.unique(found)) > 32


@pytest.mark.parametrize("side_mm", [0.0, -1.0, 0.001, 1.0, float("nan"), float("inf")])
def test_impossible_voxels_are_refused(scene, tmp_path, side_mm):
    with pytest.raises(InputError, match="voxel_mm"):
        nailoptics.export(scene, tmp_path / "out", format="mcx", voxel_mm=side_mm)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_pmcx_takes_every_keyword(folder):
    """Rationale: without a GPU pmcx checks its keywords and then ends for want of one. Expected: that, and no other."""
    pytest.importorskip("pmcx", reason="pmcx is missing: pip install pmcx")
    command = [sys.executable, str(folder / "run_pmcx.py"), str(folder / "1_ir.json"), "--photons", "1000"]
    done = subprocess.run([*command, "-o", str(folder / "x.npz")], capture_output=True, text=True, timeout=120)
    assert (folder / "x.npz").exists() or "CUDA" in done.stderr or "GPU" in done.stderr, done.stderr

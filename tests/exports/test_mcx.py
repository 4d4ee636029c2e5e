"""Voxels for MCX: labels, source and photodiodes are where the geometry has them, as near as a staircase can be."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
import run_session

import nailoptics
from nailoptics.assets import data_dir
from nailoptics.errors import InputError
from nailoptics.exports.compatibility import as_seen
from nailoptics.exports.monte_carlo import labels, voxels
from nailoptics.geometry import build
from nailoptics.light import optics
from nailoptics.scene import load_scene

SIDE_MM = 0.2
CLEAR = ("air", "plate", "bed", "bone", "pulp", "epidermis", "epoxy", "kapton")


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
    volume = run_session.volume(session, folder)
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


def test_all_of_the_die_emits_into_the_epoxy_unobstructed(scene, folder, session):
    made = run_session.mcx_config(session, folder, photons=1, seed=1)
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


def test_photodiodes_show_their_area_and_are_distinguished(scene, folder, session):
    """Rationale: photons that come straight to the board end where its opaque voxels begin, as they do in MCX.

    Expected: the photodiode in whose face that place lies, for as large an area as each has; no photodiode where the
    light goes away from it; no photodiode in the shadow of what is opaque beside it.
    """
    geometry = build(scene)
    volume = run_session.volume(session, folder)
    media, expected = len(session["Domain"]["Media"]) - 1, []
    spacing = 0.05  # voxels
    for k, face in enumerate(geometry.photodiodes):
        corners = (face.quads.reshape(-1, 3) - session["nailoptics"]["origin_mm"]) / SIDE_MM
        low, high = corners.min(axis=0) - 1.0, corners.max(axis=0) + 1.0
        x, y = (np.arange(low[axis], high[axis], spacing) for axis in (0, 1))
        plan = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
        column = volume[tuple(np.floor(plan).astype(int).T)]
        # From under the deepest corner upwards, so that what stands before a photodiode is met first.
        first = int(low[2])
        column = np.where(np.arange(column.shape[1]) < first, 1, column)
        place = np.column_stack([plan, (column == 0).argmax(axis=1)])
        ways = np.tile([[0.0], [0.0], [1.0]], len(place))
        rows = np.concatenate([np.ones((1, len(place))), np.full((media, len(place)), 2.0), place.T, ways])
        which, paths = run_session.detected(session, rows)
        flat = np.linalg.norm(face.normal[:, 2]) / np.sqrt(len(face.normal))
        assert (which == k).sum() * (spacing * SIDE_MM) ** 2 == pytest.approx(face.area_mm2 * flat, rel=0.02)
        assert paths.shape == (len(which), media - 1) and (paths == 2.0 * SIDE_MM).all()
        rows[-1] = -1.0
        assert len(run_session.detected(session, rows)[0]) == 0
        sphere = session["Optode"]["Detector"][k]
        assert (np.linalg.norm(corners - sphere["Pos"], axis=1) < sphere["R"]).all()
        expected.append(len(which))
    assert min(expected) > 1000


def test_photodiodes_lie_no_deeper_than_what_is_opaque_beside_them(geometry):
    """Rationale: in a recess of one voxel, 0.25 mm wide elements lost half of their light to the recess's walls."""
    for side_mm in (0.2, 0.1):
        made = voxels(geometry, side_mm)
        opaque = np.isin(made.region, [i for i, name in enumerate(geometry.regions) if name not in CLEAR])
        for face in geometry.photodiodes:
            own = np.argwhere((made.region[:, :, 1:] == face.region) & ~opaque[:, :, :-1])
            middle = made.origin_mm + made.side_mm * (own + [0.5, 0.5, 1.0])
            # The nail's side of its voxels is, but for half the diagonal of one, on its own plane.
            far = np.abs(((middle[:, None] - face.quads[:, 0]) * face.normal).sum(axis=-1)).min(axis=1)
            assert len(own) > 0 and far.max() < 0.87 * side_mm


def test_mcx_for_opencl_ends_photons_at_opaque_parts(session):
    """Rationale: label 0 with exactly the index before it is walked through by MCX for OpenCL, and crashes it."""
    rows = [m["n"] for m in session["Domain"]["Media"]]
    assert np.float32(rows[0]) not in np.float32(rows[1:])
    epoxy = rows[1 + session["nailoptics"]["absorbers"].index("epoxy")]
    assert ((rows[0] - epoxy) / (rows[0] + epoxy)) ** 2 < 1e-10 and rows[0] > epoxy


def test_labels_fit_a_byte_for_every_number_of_zones(scene, geometry):
    many = as_seen(scene.model_copy(update={"blood": type(scene.blood)(zones=32)}), reflecting=False)
    result = labels(many, build(many), voxels(geometry, 0.3))
    assert result.dtype == np.uint8 and len(np.unique(result)) > 32


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


@pytest.mark.slow
def test_pmcxcl_agrees_on_an_exported_finger_but_for_the_staircase(tmp_path, chosen_jit):
    """Rationale: MCX for OpenCL, on a processor, must detect light in the same photodiodes.

    Expected: readings within 6 % and 3 standard errors of ours (2 % measured in such cubes, 9 % in those of 0.1 mm)
    and what more blood changes of them; errors small enough to resolve either.
    """
    # In processes of its own, as its libraries end one that Mitsuba is in; and its own for C++ breaks PoCL's compiler.
    own = {**os.environ, "LD_PRELOAD": "libstdc++.so.6"}
    probe = [sys.executable, "-c", "import pmcxcl; assert pmcxcl.gpuinfo()"]
    if subprocess.run(probe, capture_output=True, timeout=120, env=own).returncode:
        pytest.skip("no pmcxcl with a device: pip install pmcxcl, apt install pocl-opencl-icd")
    scene = load_scene(data_dir("scenes") / "prototype.toml")
    paths = nailoptics.export(scene, tmp_path, format="mcx", voxel_mm=0.05)
    command = [sys.executable, str(paths["run"]), str(paths["led_1"]), "--opencl", "--photons", "400000", "--seed", "7"]
    command += ["-o", str(tmp_path / "found.npz")]
    subprocess.run(command, check=True, capture_output=True, timeout=1000, env=own)
    result = nailoptics.compare_with(tmp_path / "found.npz", photons=1_000_000, seed=3, backend=chosen_jit.name)
    assert len(result.readings) == 8 and result.program == "pmcxcl"
    for name, pair in result.readings.items():
        ratio, stderr = pair.ratio
        assert abs(ratio - 1) < 0.06 + 3 * stderr and stderr < 0.15, name
    assert abs(result.total.ratio[0] - 1) < 0.06 and result.total.ratio[1] < 0.02
    for pair in result.changes.values():
        assert abs(pair.deviations) < 3 and pair.ratio[1] < 0.05

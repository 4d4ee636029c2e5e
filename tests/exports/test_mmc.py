"""Sessions for MMC describe the scene, and what pmmc computes from one is what the walk of photons reads."""

import importlib.util
import json
import subprocess
import sys

import numpy as np
import pytest
import run_session

import nailoptics
from nailoptics import tissue
from nailoptics.assets import data_dir
from nailoptics.errors import InputError
from nailoptics.exports.monte_carlo import CONES, cones, tetrahedra, write_mmc
from nailoptics.geometry import build
from nailoptics.light import optics
from nailoptics.scene import Scene, load_scene


@pytest.fixture(scope="module")
def oximeter() -> Scene:
    """A scene with two LEDs of other wavelengths and lines, and one of a hostile name."""
    scene = load_scene(data_dir("scenes") / "pulse_oximeter.toml")
    hostile = scene.leds[0].model_copy(update={"name": "a..b-C.json"})
    return scene.model_copy(update={"leds": (hostile, *scene.leds[1:]), "oximeter": None})


@pytest.fixture(scope="module")
def folder(oximeter, tmp_path_factory):
    """The export of that scene, in a folder with a name that needs care."""
    where = tmp_path_factory.mktemp("exports") / "a finger, été $HOME"
    nailoptics.export(oximeter, where, format="mmc")
    return where


def read_session(folder, number: int):
    (path,) = folder.glob(f"{number}_*.json")
    return json.loads(path.read_text(encoding="utf-8"))


def test_every_led_has_a_session_with_the_media_of_its_wavelength(oximeter, folder):
    geometry = build(oximeter)
    assert len(list(folder.glob("*.json"))) == len(oximeter.leds) == 2
    meshes = []
    for number, led in enumerate(oximeter.leds, start=1):
        session = read_session(folder, number)
        media = optics.finger_media(oximeter, geometry.regions, led.wavelength_nm)
        names, regions = session["nailoptics"]["absorbers"], list(geometry.regions)
        labels = np.array(session["Mesh"]["MeshElem"])[:, 4]
        region = tetrahedra(geometry).region
        for medium, name in enumerate(names, start=1):
            at = regions.index("bed" if name.startswith("bed_") else name)
            expected = media.mu_a[at], media.mu_s[at], media.g[at], media.n[at]
            row = session["Domain"]["Media"][medium]
            assert [row[key] for key in ("mua", "mus", "g", "n")] == pytest.approx(expected, rel=1e-12)
            assert set(region[labels == medium]) <= {at}
        # What is opaque ends photons, and nothing else does.
        assert (labels == 0).tolist() == media.opaque[region].tolist()
        assert session["Domain"]["Media"][0]["n"] == media.n[regions.index("epoxy")]
        meshes.append(session["Mesh"]["MeshNode"])
    assert meshes[0] == meshes[1]


def test_the_source_lies_in_the_epoxy_and_shines_out_of_the_die(oximeter, folder):
    geometry = build(oximeter)
    for number, die in enumerate(geometry.leds, start=1):
        session = read_session(folder, number)
        places = np.array([one["position_mm"] for one in session["nailoptics"]["sources"]])
        below = (places - die.quads[0, 0]) @ die.normal[0]
        assert below == pytest.approx(np.full(CONES, 1e-4), abs=1e-6)
        assert {geometry.regions[i] for i in geometry.region_at(places)} == {"epoxy"}
        assert session["Optode"]["Source"]["Dir"] == pytest.approx(die.normal[0].tolist())


def test_cones_make_up_a_lambertian_die(geometry):
    """Mean powers of the cosine of a Lambertian emitter are 2/3, 1/2, 2/5; those of a cone follow from its angle."""
    die = geometry.leds[0]
    errors = []
    for count in (CONES, 4 * CONES):
        places, angle = cones(die, count)
        cos = np.cos(angle)
        powers = [np.mean(sum(cos**k for k in range(n + 1)) / (n + 1)) for n in (1, 2, 3)]
        errors.append(np.abs(np.array(powers) - [2 / 3, 1 / 2, 2 / 5]).max())
        corner = die.quads[0, 0]
        sides = np.array([die.quads[0, 1] - corner, die.quads[0, 3] - corner])
        u, v = ((places - corner) @ sides.T / (sides**2).sum(axis=1)).T
        for x in (u, v):
            assert x.mean() == pytest.approx(0.5, abs=1e-9) and 0 < x.min() < x.max() < 1
            assert x.var() == pytest.approx(1 / 12, rel=1e-3)
            # Wide cones start where narrow ones do.
            assert abs(np.corrcoef(x, cos)[0, 1]) < 0.1
        assert abs(np.corrcoef(u, v)[0, 1]) < 0.1
    assert errors[0] < 1e-3 and errors[1] < errors[0] / 3


def test_the_runner_finds_the_photodiode_of_each_place(oximeter, folder):
    geometry, session = build(oximeter), read_session(folder, 1)
    random = np.random.default_rng(0)
    faces = [quad for face in geometry.photodiodes for quad in face.quads]
    middle = np.mean([quad.mean(axis=0) for quad in faces], axis=0)
    places = np.concatenate([quad.mean(axis=0) + random.normal(0, 0.2, (200, 3)) for quad in faces] + [middle[None]])
    regions = geometry.region_at(places)
    expected = [next((i for i, f in enumerate(geometry.photodiodes) if f.region == r), -1) for r in regions]
    assert run_session.photodiode_at(session, places).tolist() == expected
    assert len(set(expected)) > 1


def test_keywords_are_those_of_pmmc(folder):
    session = read_session(folder, 2)
    result = run_session.mmc_config(session, source=3, photons=10, seed=5, threads=2)
    assert result["elem"].min() == 1 and result["elem"].max() == len(result["node"])
    assert result["elemprop"].max() == len(result["prop"]) - 1
    assert result["srcpos"] == session["nailoptics"]["sources"][3]["position_mm"]
    assert result["detpos"].shape == (len(session["nailoptics"]["photodiodes"]), 4)
    assert (result["nphoton"], result["seed"], result["nthread"]) == (10, 5, 2)


def test_the_page_lists_the_approximations_of_this_scene(oximeter, folder, geometry, tmp_path):
    text = (folder / "README.md").read_text(encoding="utf-8")
    assert "Lambertian, from the whole die | 64 cones" in text
    assert f"line width of LED {oximeter.leds[1].name} | {oximeter.leds[1].fwhm_nm:g} nm" in text
    assert "reflect 4% of the light" in text
    black = load_scene(data_dir("scenes") / "prototype.toml")
    black = black.model_copy(update={"board": black.board.model_copy(update={"opaque_reflectance": 0.0})})
    nailoptics.export(black, tmp_path, format="mmc")
    text = (tmp_path / "README.md").read_text(encoding="utf-8")
    assert "line width" not in text and "4%" not in text
    assert "at most 0.4 % of light that comes straight, 1.2 % on Kapton" in text
    nm = np.arange(400.0, 1001.0, 10.0)
    n = {region: tissue.scattering(region, nm)[2] for region in tissue.REGIONS}
    worst = {region: (((n[region] - n["epoxy"]) / (n[region] + n["epoxy"])) ** 2).max() for region in n}
    assert 0.011 < worst.pop("kapton") < 0.012 and 0.003 < max(worst.values()) < 0.004


def test_the_scene_beside_it_is_the_one_that_mmc_gets(oximeter, folder):
    exported = load_scene(folder / "scene.toml")
    assert exported.board.opaque_reflectance == 0 and {led.fwhm_nm for led in exported.leds} == {0.0}
    assert exported.finger == oximeter.finger and exported.photodiodes == oximeter.photodiodes


def test_a_phantom_is_refused(tmp_path):
    phantom = load_scene(data_dir("scenes") / "phantom.toml")
    with pytest.raises(InputError, match="phantom is laterally infinite"):
        nailoptics.export(phantom, tmp_path / "out", format="mmc")
    assert not list(tmp_path.iterdir())


@pytest.fixture
def pmmc() -> None:
    """pmmc with a device that it takes; without one the test is skipped, with the reason.

    It is tried in another process: once it is loaded, Dr.Jit's first kernel crashes.
    """
    if importlib.util.find_spec("pmmc") is None:
        pytest.skip("pmmc is missing: pip install pmmc")
    has_gpu = "import pmmc; assert pmmc.gpuinfo()"
    if subprocess.run([sys.executable, "-c", has_gpu], capture_output=True, timeout=120).returncode:
        pytest.skip("pmmc finds no OpenCL device, not even the processor: install PoCL (pocl-opencl-icd)")


@pytest.mark.slow
def test_pmmc_agrees_on_an_exported_finger(pmmc, chosen_jit, tmp_path):
    """Rationale: another program, with other arithmetic on other cells, must agree on the same finger.

    Expected: eight readings and what less and more blood changes of them within 3 standard errors, chi^2 plausible, and
    errors small enough to resolve a few percent.
    """
    scene = load_scene(data_dir("scenes") / "prototype.toml")
    paths = nailoptics.export(scene, tmp_path, format="mmc")
    command = [sys.executable, str(paths["run"]), str(paths["led_1"]), "--photons", "500000", "--seed", "7"]
    command += ["--threads", "1", "-o", str(tmp_path / "detected.npz")]
    subprocess.run(command, check=True, capture_output=True, timeout=1000)
    result = nailoptics.compare_with(tmp_path / "detected.npz", photons=2_000_000, seed=3, backend=chosen_jit.name)
    assert len(result.readings) == 8 and not result.unread
    assert max(abs(pair.deviations) for pair in result.readings.values()) < 3
    assert result.p_value > 0.003
    assert abs(result.total.deviations) < 3 and result.total.ratio[1] < 0.02
    for pair in result.changes.values():
        assert abs(pair.deviations) < 3
        assert pair.ratio[1] < 0.04
    for name, pair in result.paths_mm.items():
        assert abs(pair.deviations) < 3.5, name


def test_a_gap_of_air_that_no_mesh_can_hold_is_refused(tmp_path):
    scene = load_scene("prototype").with_({"board.air_gap_um": 50.0})
    with pytest.raises(InputError, match=r"board\.air_gap_um = 50: a mesh of tetrahedra has no air, .*; export mcx"):
        write_mmc(scene, tmp_path / "mmc")
    assert not (tmp_path / "mmc").exists()

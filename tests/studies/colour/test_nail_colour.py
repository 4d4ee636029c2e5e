"""The traced colour of a nail: calibrated errors, the order of the paper's Fig. 2, blood and melanin, the files."""

import json

import numpy as np
import pytest
import xarray as xr
from listed_variables import assert_listed
from small_scenes import SMALL_FINGER_BEST

import nailoptics as nail
from nailoptics.cli import run
from nailoptics.errors import InputError
from nailoptics.io import write_dataset
from nailoptics.light import optics
from nailoptics.light.photograph import photograph
from nailoptics.light.tracing.store import LightStore
from nailoptics.light.walk.nail_reflectance import NailReflectance, Patch
from nailoptics.report.pages.colour import COLOUR, summary as colour_summary
from nailoptics.scene import Viewing, load_scene, parse_scene
from nailoptics.studies.colour.nail_colour import SHARES, colour
from nailoptics.studies.colour.reflectance import GROUPS, WAVELENGTHS_NM, Viewer, delta_e_2000, walk_colour

PATCHES = (Patch((0.0, 0.0), (4.0, 8.0)), Patch((0.0, -7.5), (4.0, 1.5)))
# L*a*b* of skin: mean and standard deviation of 148 Asians (Yun 2010, doi 10.1111/j.1600-0846.2010.00434.x), and means
# of five groups of 120 people (IADR 2009, Miami, abstract 120461).
YUN_LAB = np.array([[64.15, 8.96, 18.34], [4.86, 2.65, 2.39]])
IADR_LAB = [[52.5, 17.0, 18.9], [37.7, 17.2, 14.7], [49.4, 22.0, 12.3], [41.5, 25.5, 13.3], [26.7, 14.6, 14.7]]
VIEWING = Viewing(lit_by="sky", gloss=False)
# A nail plate as moist as on a living finger: the bed is visible through it.
SCENE = parse_scene(SMALL_FINGER_BEST.replace("[finger]", "[finger]\nplate_scattering = 0.3"))


def without_priors(scene):
    """The scene without prior uncertainty, which would take rays of its own."""
    return scene.model_copy(update={"priors": scene.priors.model_copy(update={"spread": False})})


def walked(seed, photons=40_000, **how):
    return walk_colour(NailReflectance(SCENE), PATCHES, photons=photons, seed=seed, **how)


@pytest.fixture(scope="module")
def rays(chosen_jit):
    nail.light.backend.activate(chosen_jit)
    return walked(1, 240_000)


@pytest.mark.long
def test_reflectance_between_the_nodes_is_that_of_a_fresh_trace(rays, jit_backend):
    """Rays of four wavelengths, dimmed and interpolated, against rays of this one with its own scattering."""
    rest = np.full((1, 2), 0.03)
    read = rays.read(rest, VIEWING).reflectance
    for wavelength_nm in (450.0, 545.0, 680.0):
        bare = NailReflectance(SCENE)
        at_rest = optics.absorption(bare.scene, wavelength_nm)[0]
        own = bare.reflect(wavelength_nm, PATCHES, mu_a=at_rest, photons=60_000, seed=9, groups=GROUPS)
        cell = own.group.astype(int) * len(PATCHES) + own.patch
        sums = np.bincount(cell, own.weight * ~own.gloss, GROUPS * len(PATCHES)).reshape(GROUPS, -1)
        fresh = sums * GROUPS / own.rays
        at = int(np.flatnonzero(WAVELENGTHS_NM == wavelength_nm)[0])
        here = read[:, :, 0, at]
        error = np.hypot(fresh.std(0, ddof=1) / np.sqrt(GROUPS), nail.statistics.jackknife(here))
        assert np.all(np.abs(here[0] - fresh.mean(0)) < 3.5 * error), wavelength_nm
        assert np.all(error < 0.02 * here[0])


@pytest.mark.long
def test_blood_reddens_and_melanin_darkens_as_was_measured(rays):
    viewer = Viewer()
    lab = viewer.lab(rays.read([[0.02, 0.02], [0.04, 0.04]], VIEWING).reflectance[0])
    step = lab[0, 1] - lab[0, 0]
    # Takiwaki 1998: haemoglobin -0.74, melanin about -2.8.
    assert step[1] > 1 and -1.0 < step[0] / step[1] < -0.5
    # Pale skin, as melanin was measured on: where a finger's blood reddens it, pigment hides as much red as it adds.
    blood = rays.scene.blood.model_copy(update={"pulp_blood_fraction": 0.002})

    def skin(melanin):
        finger = rays.scene.finger.model_copy(update={"melanin_fraction": melanin})
        scene = rays.scene.model_copy(update={"finger": finger, "blood": blood})
        return viewer.lab(rays.read([[0.03, 0.03]], VIEWING, scene=scene).reflectance)[:, 1, 0]

    tanned = skin(0.03) - skin(0.005)
    slope = tanned[:, 0] / tanned[:, 1]
    # Darker and redder, steeper than what was measured: no published spectrum of melanin reaches -2.8 here.
    assert tanned[0, 0] < -5 and tanned[0, 1] > 1 and -7 < slope[0] < -3.5
    assert nail.statistics.jackknife(slope) < 0.3


def test_a_finger_that_absorbs_nothing_sends_back_almost_all_light(jit_backend):
    bare = NailReflectance(SCENE)
    none = np.full(len(optics.absorbers(SCENE)), 1e-7)
    result = bare.reflect(700.0, PATCHES[:1], mu_a=none, photons=4_000, seed=3, groups=GROUPS)
    # What does not come back has left by the cut end; nothing is gained or lost on the way.
    assert result.weight == pytest.approx(np.ones(len(result.weight)), abs=1e-3)
    assert 0.75 < len(result.weight) / result.rays.sum() <= 1
    # Gloss at normal incidence on n = 1.5, a little more where the nail curves away.
    assert result.gloss.sum() / result.rays.sum() == pytest.approx(0.041, abs=0.012)


@pytest.mark.long
def test_a_colours_standard_error_is_calibrated(jit_backend):
    """Twenty seeds with few rays: standard errors are those of the repeats, and 95 % intervals hold the mean."""
    result = [
        walked(seed, 8_000, shares=SHARES).read([[0.03, 0.03], [0.05, 0.02]], VIEWING).reflectance for seed in range(20)
    ]
    viewer = Viewer()
    lab = np.array([viewer.lab(one)[0] for one in result])
    error = np.array([nail.statistics.jackknife(viewer.lab(one)) for one in result])
    ratio = lab.std(0, ddof=1) / np.sqrt((error**2).mean(0))
    # Of 20 repeats a standard deviation is estimated to 16 %.
    assert np.all(np.abs(np.log(ratio)) < 0.55) and abs(np.log(ratio).mean()) < 0.25
    inside = np.abs(lab - lab.mean(0)) < 1.96 * error
    assert 0.88 < inside.mean() < 0.99
    change = np.array([viewer.lab(one)[:, :, 1] - viewer.lab(one)[:, :, 0] for one in result])
    errors = np.array([nail.statistics.jackknife(one) for one in change])
    assert abs(np.log(change[:, 0].std(0, ddof=1) / np.sqrt((errors**2).mean(0))).mean()) < 0.35
    moved = np.array([delta_e_2000(viewer.lab(one)[:, :, 1], viewer.lab(one)[:, :, 0]) for one in result])
    stderr = np.array([nail.statistics.jackknife(one) for one in moved])
    assert 0.8 < (np.abs(moved[:, 0] - moved[:, 0].mean(0)) < 1.96 * stderr).mean()


@pytest.mark.long
def test_each_place_gets_the_rays_that_its_colour_and_its_change_need(jit_backend):
    result = colour(without_priors(SCENE), forces_n=(0.0, 4.0), tolerance=1.2, change_tolerance=0.6, seed=3)
    # Two rounds foresee the errors to some per cent; only what is reached ends them.
    assert float(result.colour_stderr.max()) <= 1.2 and float(result.delta_e_2000_stderr.max()) <= 0.6
    assert "lab_spread" not in result


def test_a_stored_colour_is_the_same_and_walks_no_ray(jit_backend, tmp_path, monkeypatch):
    stores = [LightStore(tmp_path / "light")]
    quiet = without_priors(SCENE)
    first = colour(quiet, forces_n=(0.0, 4.0), photons=8_000, seed=4, stores=stores)
    monkeypatch.setattr(NailReflectance, "_batch", None)
    again = colour(quiet, forces_n=(0.0, 4.0), photons=8_000, seed=4, stores=stores)
    assert np.array_equal(first.lab.values, again.lab.values)
    # Another skin, other blood and another lamp use the same rays.
    other = quiet.model_copy(
        update={
            "finger": quiet.finger.model_copy(update={"melanin_fraction": 0.05}),
            "blood": quiet.blood.model_copy(update={"rest_blood_fraction": 0.05}),
        }
    )
    dark = colour(other, forces_n=(0.0, 4.0), illuminant="A", photons=8_000, seed=4, stores=stores)
    assert dark.lab[0, 0, 0] < first.lab[0, 0, 0] - 5


@pytest.mark.long
def test_priors_span_peoples_nails_and_skin(jit_backend, coarse_cells, tmp_path):
    """Rationale: nails of 160 people have L* 62.4 (5.9) and a* 10.8 (3.6), of which 5-95 % lie at 4.4-16.4."""
    result = colour(parse_scene(SMALL_FINGER_BEST), forces_n=(0.0,), photons=60_000, seed=6)
    spread = result.lab_spread.sel(site="nail").values
    assert (result.lab_spread_stderr.sel(site="nail").values < 0.5 * spread).all() and spread[1] > 1
    # Bounds within which 95 % of the interval hold 85 to 99 % of these people.
    usual = result.lab.values[len(result.place) // 2, 0]
    assert 50 < usual[0] < 75 and 4.4 < usual[1] < 16.4 and 1 < usual[2] < 17
    assert 4.2 < spread[0] < 7.8 and 2.6 < spread[1] < 4.8
    redness = result.prior_lab.sel(prior="plate scattering", site="nail").values[:, 1]
    assert str(result.prior_field.sel(prior="plate scattering").item()) == "finger.plate_scattering"
    assert (np.diff(redness) < 0).all()
    # L* and b* of skin within the widest that was published, less and more two standard deviations of both.
    skin = result.lab.values[0, 0]
    low = np.min([YUN_LAB[0] - 2 * YUN_LAB[1], *IADR_LAB], axis=0)
    high = np.max([YUN_LAB[0] + 2 * YUN_LAB[1], *IADR_LAB], axis=0)
    reach = 1.96 * result.lab_spread.sel(site="skin").values
    assert (skin + reach > low).all() and (skin - reach < high).all() and (low[:2] < skin[:2]).all()
    write_dataset(result, tmp_path / "colour.nc")
    assert_listed(tmp_path, "colour.nc")


@pytest.mark.long
def test_the_nail_reddens_and_then_whitens_from_the_tip_as_in_the_paper(jit_backend):
    scene = without_priors(load_scene("scenes/nail_colour.toml"))
    result = colour(scene, photons=60_000, seed=2)
    band = result.white_band_mm.values
    # A white band from 2 N on at the earliest, no longer than the nail beyond the bone and its edge.
    beyond_bone_mm = scene.finger.nail_length_mm / 2 - scene.finger.bone_end_mm + scene.blood.bone_edge_mm
    assert (band[:3] == 0).all() and (np.diff(band[2:]) >= 0).all() and 0.5 < band[-1] < beyond_bone_mm
    redness = result.lab.values[2:6, :, 1].mean(0)
    # Redder from 0.3 N on, no more beyond 1 N.
    assert redness[1] > redness[0] + 0.2 and redness[2] > redness[1] and abs(redness[3] - redness[2]) < 1.0
    errors = result.delta_e_2000_stderr.values
    # Changes come from the same rays, so they are far sharper than the colours themselves.
    assert errors[1:-1, 2].max() < 0.5 * result.colour_stderr.values.max()
    printed = json.loads(json.dumps(colour_summary(result)))
    assert printed["illuminant"] == "D65" and len(printed["states"]) == 5 and len(printed["lab_stderr"]) == 3
    place = printed["states"][0]["places"][5]
    assert {"v_mm", "lab", "srgb", "delta_e_2000"} <= set(place) and place["delta_e_2000"] == 0


@pytest.mark.long
def test_a_lamp_at_45_degrees_gives_nearly_the_same_colour(rays):
    viewer, rest = Viewer(), [[0.03, 0.03]]
    sky = viewer.lab(rays.read(rest, VIEWING).reflectance)
    lamp = viewer.lab(rays.read(rest, Viewing(lit_by="lamp", gloss=False)).reflectance)
    assert delta_e_2000(sky[0], lamp[0]).max() < 4
    # Gloss makes everything lighter and paler.
    glossy = viewer.lab(rays.read(rest, Viewing(lit_by="sky", gloss=True)).reflectance)
    assert (glossy[0, :, 0, 0] > sky[0, :, 0, 0] + 1).all()


def test_the_command_writes_its_files_and_json(jit_backend, tmp_path, capsys):
    path = tmp_path / "finger.toml"
    path.write_text(SMALL_FINGER_BEST + "[priors]\nspread = false\n")
    arguments = ["colour", str(path), "-o", str(tmp_path / "out"), "--photons", "8000", "--no-photograph", "--json"]
    assert run([*arguments, "--force", "0", "--force", "1"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert [state["force_n"] for state in printed["states"]] == [0, 1]
    written = {one.name for one in (tmp_path / "out").iterdir()}
    assert written == {"colour.nc", "colour.html", "strip.png"}
    result = xr.load_dataset(tmp_path / "out" / "colour.nc")
    assert result.attrs["illuminant"] == "D65"
    lines = COLOUR.lines(result, printed | {"lab_spread": {"nail": [5.0, 3.4, 3.2]}})
    assert any(line.startswith("Colours are those of the middle of the nail, +- one standard error") for line in lines)
    assert any(line.startswith("seen by daylight D65") for line in lines)
    assert lines[-1].endswith("L* 5.0, a* 3.4, b* 3.2")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"forces_n": (-1.0,)}, r"forces_n\[0\] = -1.0: must be greater than or equal to 0"),
        (
            {"forces_n": (101.0,)},
            r"forces_n\[0\]: 101 N must be at most 30 N; give it in newtons: divide millinewtons by",
        ),
        ({"forces_n": ()}, "forces_n = .*: must have at least 1 item"),
        ({"tolerance": 0.0}, "tolerance = 0.0: must be greater than 0"),
        ({"illuminant": "moon"}, "illuminant = \"moon\": must be 'D65', 'A' or 'LED-B3'"),
        ({"relative_error": 0.1}, "no relative_error; give tolerance"),
    ],
)
def test_impossible_requests_are_refused_in_one_line(change, words):
    with pytest.raises(InputError, match=words):
        colour(SCENE, **change)


def test_a_camera_inside_the_finger_is_refused_in_one_line():
    inside = SCENE.model_copy(update={"colour": SCENE.colour.model_copy(update={"camera_mm": (0.0, 0.0, -3.0)})})
    with pytest.raises(InputError, match=r"colour.camera_mm = \[0, 0, -3\]: lies inside the finger"):
        photograph(inside, np.zeros((1, 2)), np.ones(1, bool), np.zeros((1, 1, 3)))


def test_a_phantom_has_no_nail():
    with pytest.raises(InputError, match="has no nail"):
        colour(load_scene("scenes/phantom.toml"))

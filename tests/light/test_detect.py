"""Either engine behind one face: which one is taken, what is read between volpath's states, and what is reported."""

import time

import numpy as np
import pytest
from small_scenes import PLAIN_FINGER, phantom

from nailoptics.assets import data_dir
from nailoptics.errors import InputError
from nailoptics.light import backend, detect, open_light, optics, read_rest
from nailoptics.light.detect import engine_for
from nailoptics.light.reference.readings import StateReadings, between as read_between, corner_states
from nailoptics.light.transfer import Transfer
from nailoptics.light.transfer.records import LedTrace
from nailoptics.scene import Scene, parse_scene

SCALAR = backend.Backend("scalar", None, ("volpath",), "requested")
LLVM = backend.Backend("llvm", "libLLVM.so", backend.ENGINES, "requested")


def finger(engine: str = "auto") -> Scene:
    return parse_scene(PLAIN_FINGER + f'[light]\nengine = "{engine}"\n')


def test_photons_run_on_jit_backends_and_volpath_elsewhere():
    assert engine_for(finger(), LLVM) == engine_for(finger("photons"), LLVM) == "photons"
    assert engine_for(finger(), SCALAR) == engine_for(finger("volpath"), SCALAR) == "volpath"
    assert engine_for(finger("volpath"), LLVM) == "volpath"
    with pytest.raises(InputError, match="scalar compiles none.*doctor") as caught:
        engine_for(finger("photons"), SCALAR)
    assert "None" not in str(caught.value) and "\n" not in str(caught.value)


def test_every_zone_gets_a_state_in_which_it_alone_is_far_from_rest():
    blood = np.array([[0.03, 0.03], [0.02, 0.03], [0.025, 0.05], [0.03, 0.04]])
    corners = corner_states(blood)
    assert np.array_equal(corners, [[0.03, 0.03], [0.02, 0.03], [0.03, 0.05]])


@pytest.mark.parametrize("rest", [0.0, 1e-4, 0.03, 0.9, 1.0])
def test_blood_at_rest_still_gets_distinct_valid_states(rest):
    corners = corner_states(np.full((5, 2), rest))
    assert corners.shape == (3, 2) and np.all((corners >= 0) & (corners <= 1))
    away = np.diagonal(corners[1:]) - corners[0]
    assert np.all(abs(away) > 1e-5)
    assert corners[1, 1] == corners[2, 0] == rest


def between(blood: np.ndarray, corners: np.ndarray, ratio: np.ndarray, *, relative: float = 0.05):
    fraction, ratio = np.full((1, 3), 1e-3), ratio[0]
    traced = StateReadings(fraction, relative * fraction, ratio, np.where(ratio == 1, 0, 0.001), 1, None, False)
    return read_between([traced], corners, blood)


def test_between_the_states_light_dims_as_in_beer_lambert():
    """Two zones with paths of 2 and 1 mm at 0.4 per mm and unit of blood: exp of minus both, exactly."""
    corners = np.array([[0.03, 0.03], [0.05, 0.03], [0.03, 0.01]])
    slope = np.array([2 * 0.4, 1 * 0.4])
    ratio = np.exp(-(corners - corners[0]) @ slope)[None, None]
    blood = np.random.default_rng(1).uniform(0.01, 0.05, (20, 2))
    blood[0] = [0.03, 0.03]
    series = between(blood, corners, ratio)
    exact = 1e-3 * np.exp(-(blood - 0.03) @ slope)
    assert np.allclose(series.fraction[0, 0], exact, rtol=1e-12)
    assert np.allclose(series.change[0, 0], exact - 1e-3, atol=1e-15)
    assert series.change_stderr[0, 0, 0] == 0 and np.all(series.stderr >= 0.05 * series.fraction)
    assert np.all(series.change_stderr[..., 1:] < series.stderr[..., 1:])


def test_a_change_is_counted_from_the_first_state_wherever_that_lies():
    """The first state of a course need not be the corner; the error grows with the way from it, in each zone."""
    corners = np.array([[0.03, 0.03], [0.05, 0.03], [0.03, 0.01]])
    ratio = np.array([[[1.0, 0.98, 1.01]]])
    series = between(np.array([[0.05, 0.01], [0.03, 0.03], [0.05, 0.01]]), corners, ratio)
    assert series.change_stderr[0, 0, 0] == series.change_stderr[0, 0, 2] == 0 == series.change[0, 0, 2]
    assert series.change_stderr[0, 0, 1] > 1e-3 * 0.001


def test_an_unlit_photodiode_has_an_unknown_error():
    corners = np.array([[0.03, 0.03], [0.05, 0.03], [0.03, 0.01]])
    ones = np.ones((1, 3))
    series = read_between(
        [StateReadings(0 * ones, np.inf * ones, ones, np.inf * ones, 1, None, False)], corners, corners
    )
    assert np.all(series.fraction == 0) and not np.isfinite(series.stderr).any()
    assert detect._reached(np.array([0.01, np.nan])) == "some photodiode detected no light or too few photons"
    assert "0.02" in detect._reached(np.array([0.01, 0.02]))


@pytest.mark.parametrize(("photons", "known"), [(24, False), (26, True)])
def test_fewer_than_25_photons_have_no_standard_error(photons, known):
    scene = finger()
    path = np.ones((photons, len(optics.absorbers(scene))), np.float32)
    trace = LedTrace(
        photons=1000,
        mu_a=optics.absorption(scene, 800.0)[0],
        photon=np.arange(photons),
        photodiode=np.zeros(photons, np.uint16),
        weight=np.ones(photons),
        path_mm=path,
        energy={},
        seeds=(1,),
    )
    series = detect.light_of(Transfer(scene, (trace,), "llvm")).readings_at(np.full((2, 2), 0.03))
    assert np.all(series.fraction > 0) and np.all(np.isfinite(series.stderr) == known)


@pytest.mark.long
@pytest.mark.jit
def test_both_engines_agree_on_a_slab_with_many_parts(jit_backend):
    """Also what `trace` prints beside the readings: where all the light went."""
    upper = {"name": "upper", "thickness_mm": 0.5, "g": 0.8, "n": 1.5}
    lower = {"name": "lower", "thickness_mm": 2.0, "mu_a_per_mm": 0.1, "mu_s_per_mm": 8.0, "g": 0.8, "n": 1.4}
    leds = [{"wavelength_nm": 660.0}, {"name": "die", "wavelength_nm": 940.0, "pattern": "lambertian"}]
    apertures = [{"name": k, "position_mm": [u, 0.0], "size_mm": [1.0, 2.0]} for k, u in (("near", 1.5), ("far", 2.5))]
    text = phantom(upper, lower, leds=leds, photodiodes=apertures, n_below=1.33)
    # Stock Mitsuba's paths cost more, so that most of the error is left to them.
    ours, other = (
        read_rest(parse_scene(text + f'[light]\nengine = "{engine}"'), relative_error=error, seed=3)
        for engine, error in (("photons", 0.02), ("volpath", 0.065))
    )
    assert (ours.engine, other.engine) == ("photons", "volpath")
    assert [(r["led"], r["photodiode"]) for r in ours.readings] == [(r["led"], r["photodiode"]) for r in other.readings]
    for a, b in zip(ours.readings, other.readings, strict=True):
        stderr = np.hypot(a["stderr"], b["stderr"])
        assert abs(a["detected_fraction"] - b["detected_fraction"]) < 4 * stderr
        assert stderr < 0.07 * a["detected_fraction"]
    assert ours.energy is not None and other.energy is not None
    for part in ("reflected", "transmitted", "absorbed"):
        stderr = np.hypot(ours.energy[part]["stderr"], other.energy[part]["stderr"])
        assert abs(ours.energy[part]["value"] - other.energy[part]["value"]) < 4 * stderr < 0.05


@pytest.mark.jit
def test_seconds_count_from_the_scene_on(jit_backend):
    """Expected: processor time that the process spent, but for what its clock does not resolve."""
    before = time.process_time()
    result = read_rest(finger(), photons=1 << 14, seed=1)
    spent = time.process_time() - before
    assert result.transfer is not None
    whole, photons, setup = result.cpu_seconds, result.transfer.cpu_seconds, result.transfer.setup_seconds
    assert photons > 0 and setup > 0 and photons + setup <= whole <= spent and whole > 0.9 * spent


@pytest.mark.jit
def test_volpath_refuses_more_zones_than_it_can_distinguish_in_one_line(chosen_jit):
    text = (data_dir("scenes") / "white_band.toml").read_text(encoding="utf-8")
    scene = parse_scene(text.replace("[light]", '[light]\nengine = "volpath"'), folder=data_dir("scenes"))
    with pytest.raises(InputError, match='enough for two zones, and the scene has 8; take light.engine = "photons"'):
        open_light(scene, states=np.full((2, 8), 0.03), relative_error=0.5)

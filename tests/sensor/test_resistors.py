"""Feedback resistors: standard values that fit the brightest light, the same in every command, and their noise."""

import warnings

import numpy as np
import pytest

from nailoptics.assets import data_dir
from nailoptics.errors import InputError
from nailoptics.light import ReweightWarning, trace
from nailoptics.light.detect import rough_readings
from nailoptics.light.transfer.series import ReadingSeries
from nailoptics.options import TraceOptions
from nailoptics.scene import Ambient, Electronics, Led, Photodiode, Scene, load_scene, parse_scene, to_toml
from nailoptics.sensor import electronics
from nailoptics.sensor.ambient import LAMP, ambient_bound_a
from nailoptics.sensor.volts import with_fitted_resistors
from nailoptics.studies.prior_uncertainty import readings_over_priors
from nailoptics.studies.scene_check import check
from nailoptics.studies.simulate import simulate

AUTO = Electronics(feedback_ohm="auto")


def prototype(**electronics_fields: object) -> Scene:
    scene = load_scene(data_dir("scenes") / "prototype.toml")
    unfitted = tuple(p.model_copy(update={"feedback_ohm": None}) for p in scene.photodiodes)
    stage = scene.electronics.model_copy(update={"feedback_ohm": "auto"} | electronics_fields)
    return scene.model_copy(update={"electronics": stage, "photodiodes": unfitted})


def quiet(scene: Scene) -> Scene:
    """The scene without the uncertainty due to its priors, whose traces decide no resistor."""
    return scene.model_copy(update={"priors": scene.priors.model_copy(update={"spread": False})})


@pytest.mark.parametrize("headroom", [1.0, 2.0, 7.0])
def test_a_fitted_resistor_is_the_largest_of_e24_with_the_headroom(headroom):
    stage = Electronics(feedback_ohm="auto", headroom=headroom)
    current_a = np.geomspace(1e-6, 1e-3, 500)
    ohm = electronics.fitted_ohm(current_a, stage)
    assert (ohm * current_a * headroom <= electronics.limit_v(stage) * (1 + 1e-6)).all()
    series = (electronics.E24 * 10.0 ** np.arange(0, 7)[:, None]).ravel()
    place = np.searchsorted(series, ohm * (1 - 1e-9))
    assert series[place] == pytest.approx(ohm, rel=1e-12)
    assert (series[place + 1] * current_a * headroom > electronics.limit_v(stage) * (1 - 1e-6)).all()


def test_a_current_that_fits_hardly_less_than_a_power_of_ten_has_that() -> None:
    """Rationale: the logarithm rounds up to it. Expected: the power, and nowhere near it ten times as much."""
    stage = Electronics(feedback_ohm="auto", headroom=1.0)
    exact_a = electronics.limit_v(stage) / 1e4 * (1 + 1e-9)
    current_a = exact_a * (1 + 2.0**-52 * np.arange(-40, 41))
    assert {*np.round(electronics.fitted_ohm(current_a, stage), 6)} <= {9100.0, 10000.0}


def test_hardly_any_light_has_the_largest_resistor_that_is_sold():
    assert electronics.fitted_ohm([0.0, 1e-12, 1e-9], AUTO).tolist() == 3 * [electronics.MOST_OHM]


def test_photodiodes_keep_the_resistors_that_they_are_given():
    text = to_toml(prototype()).replace('name = "distal"', 'name = "distal"\nfeedback_ohm = [1e5, 2e5, 3e5, 4e5]')
    scene = electronics.with_resistors(parse_scene(text), np.full(8, 1e-6))
    fitted = float(electronics.fitted_ohm(1e-6 + 1e-10, AUTO))
    assert [p.feedback_ohm for p in scene.photodiodes] == [4 * (fitted,), (1e5, 2e5, 3e5, 4e5)]
    assert [e.photodiode.feedback_ohm for e in scene.layout.photodiodes] == [*4 * [fitted], 1e5, 2e5, 3e5, 4e5]
    assert parse_scene(to_toml(scene)) == scene


def test_as_many_resistors_as_wired_elements_are_required():
    with pytest.raises(InputError, match="feedback_ohm has 3 values for 4 wired elements"):
        parse_scene(to_toml(prototype()).replace('name = "distal"', 'name = "distal"\nfeedback_ohm = [1e5, 2e5, 3e5]'))


def test_a_phantom_has_no_finger_to_fit_to():
    text = (data_dir("scenes") / "phantom.toml").read_text(encoding="utf-8")
    with pytest.raises(InputError, match=r'feedback_ohm = "auto" needs a \[finger\]'):
        parse_scene(text + '\n[electronics]\nfeedback_ohm = "auto"\n')


def test_the_short_trace_that_fits_resistors_warns_of_no_photons(monkeypatch, recwarn):
    def rough(scene: Scene, states: np.ndarray) -> ReadingSeries:
        warnings.warn("few photons", ReweightWarning, stacklevel=2)
        return ReadingSeries(*4 * [np.full((1, 8, 1), 1e-4)])

    monkeypatch.setattr("nailoptics.sensor.volts.rough_readings", rough)
    monkeypatch.setattr("nailoptics.sensor.volts.ambient_bound_a", lambda scene, usual: np.zeros(8))
    with_fitted_resistors(prototype())
    assert not recwarn.list


def test_resistors_are_the_same_in_check_and_simulate_whatever_is_traced(jit_backend, shared_light):
    scene = quiet(prototype())
    checked = check(scene)
    ohm = [pair["feedback_ohm"] for pair in checked["pairs"]]
    for seed in (1, 2):
        touch = simulate(scene, photons=20_000, seed=seed)
        assert touch.feedback_ohm.values.tolist() == ohm and not touch.saturated.any()
    # Light and a lamp's fit to a step of E24, but for the error of the short trace.
    lamp_v = ohm * ambient_bound_a(scene, usual=LAMP)
    room = electronics.limit_v(scene.electronics) / (lamp_v + [pair["most_volts"] for pair in checked["pairs"]])
    assert (room > 2.0).all() and (room < 2.0 * 1.1 * 1.2).all()
    assert not any(line.startswith("may be saturated") for line in checked["warnings"])


def test_ambient_light_takes_its_room(jit_backend, shared_light):
    sun = prototype().model_copy(update={"ambient": Ambient(kind="sun", illuminance_lux=3e4)})
    dark, lit = (with_fitted_resistors(scene).photodiodes for scene in (prototype(), sun))
    for unlit, in_sun in zip(dark, lit, strict=True):
        assert np.less(in_sun.feedback_ohm, unlit.feedback_ohm).all()


@pytest.mark.parametrize("rejection", [None, "dark_slot"])
def test_repeated_samples_have_the_stated_noise(rejection):
    """Electrons of a sample are Poisson, Johnson's noise is normal, and the converter rounds, of levels in any step."""
    ohm, samples, rng = 5.1e6, 40_000, np.random.default_rng(3)
    stage = Electronics(feedback_ohm=ohm, adc_bits=20, ambient_rejection=rejection, noise_nv_per_rt_hz=0.0)
    led = Led(name="led", wavelength_nm=800.0, flux_mw=1.0)
    diode = Photodiode(name="diode", position_mm=(0, 0), dark_current_na=0.0, shunt_mohm=1e6)
    fraction, ambient_a = 4e-6 * rng.uniform(0.9, 1.1, samples), 4e-9 * rng.uniform(0.9, 1.1, samples)
    lit_a = electronics.photocurrent_a(fraction, led, diode)
    window_s, charge_c = 1 / (2 * stage.bandwidth_hz), electronics.ELEMENTARY_CHARGE_C
    johnson_v = np.sqrt(4 * electronics.BOLTZMANN_J_PER_K * stage.temperature_k * ohm * stage.bandwidth_hz)

    def sampled(current_a: np.ndarray) -> np.ndarray:
        volts = rng.poisson(current_a * window_s / charge_c) * charge_c / window_s * ohm
        volts = volts + johnson_v * rng.standard_normal(samples)
        return np.round(volts / electronics.lsb_v(stage)) * electronics.lsb_v(stage)

    stated = electronics.read(fraction, led, diode, stage, ambient_a=ambient_a)
    error_v = sampled(lit_a + ambient_a) - (sampled(ambient_a) if rejection else 0.0) - stated.volts
    assert abs(error_v.mean()) < 4 * error_v.std() / np.sqrt(samples)
    assert error_v.var() == pytest.approx(stated.noise_v2.mean(), rel=4 * np.sqrt(2 / samples))
    # So large that the sum would not hold without any of them.
    for cause in ("shot_v2", "feedback_v2", "adc_v2", "ambient_v2"):
        assert np.mean(getattr(stated.noise, cause)) > 5 * np.sqrt(2 / samples) * stated.noise_v2.mean()


@pytest.mark.long
def test_the_short_trace_is_that_of_a_long_one(jit_backend, shared_light):
    scene = quiet(prototype())
    states = np.array([[0.03, 0.03], [0.0, 0.0]])
    short, long = rough_readings(scene, states), simulate(scene, photons=500_000, seed=5)
    error = np.hypot(short.stderr[..., 0], long.detected_fraction_stderr.values[..., 0])
    assert (abs(short.fraction[..., 0] - long.detected_fraction.values[..., 0]) < 4 * error).all()
    assert (short.stderr < 0.1 * short.fraction).all() and (short.fraction[..., 1] > short.fraction[..., 0]).all()


@pytest.mark.slow
def test_fitted_resistors_hold_nearly_all_people_below_the_limit(jit_backend):
    """Over draws of all priors of the finger, traces of their own included; half of the headroom does not."""
    scene = with_fitted_resistors(prototype())
    transfer = trace(scene, photons=50_000, seed=1)
    whole = np.zeros((2, len(scene.zone_edges_mm) + 1))
    drawn = readings_over_priors(transfer, lambda varied: (whole, None), options=TraceOptions(seed=1), own_traces=True)
    photodiodes = [element.photodiode for element in scene.layout.photodiodes]
    fraction = np.exp(drawn.level.draws(0))[:, 0]
    lit_a, ambient_a = (
        electronics.photocurrent_a(fraction, scene.leds[0], photodiodes),
        ambient_bound_a(scene, usual=LAMP),
    )
    volts = (lit_a + ambient_a) * electronics.stage_ohm(photodiodes, scene.electronics)
    limit_v = electronics.limit_v(scene.electronics)
    assert (np.mean(volts >= limit_v, axis=0) < 0.025).all()
    assert np.mean(2 * volts >= limit_v) > 0.025

"""Slots: what the stage has not left of the slot before, and its noise by cause, against noise that is drawn."""

import numpy as np
import pytest

from nailoptics import load_scene
from nailoptics.assets import data_dir
from nailoptics.errors import InputError
from nailoptics.scene import Scene, parse_scene
from nailoptics.sensor import electronics
from nailoptics.sensor.front_end import SampledFrontEnd, front_end_of, oximeter_leds, ratio_stderr

TEXT = (data_dir("scenes") / "pulse_oximeter.toml").read_text(encoding="utf-8")
# Of both LEDs on three photodiodes.
LIGHT = np.array([[4e-3] * 3, [5e-3] * 3])


def shipped() -> Scene:
    return load_scene(data_dir("scenes") / "pulse_oximeter.toml")


def stage(scene: Scene, ambient_a: float = 0.0) -> SampledFrontEnd:
    return front_end_of(scene, (0, 1), np.full(3, ambient_a))


def test_settled_slots_read_their_own_light_less_the_dark_slot():
    bright = stage(shipped(), ambient_a=1e-6)
    weights, (volts, full) = bright.weights, bright.slot_volts(LIGHT)
    per_fraction = [
        electronics.volts_per_fraction(led, bright.photodiodes, shipped().electronics) for led in shipped().leds
    ]
    assert np.allclose(weights @ volts, LIGHT * per_fraction, rtol=1e-5) and not full.any()
    assert volts[2] == pytest.approx(1e-6 * 4e5 + 1e-10 * 4e5, rel=1e-4)


def test_a_slow_stage_carries_over_the_previous_slot_by_its_time_constant():
    """Expected: with one sample at a slot's end, exp(-slot / tau) of the light before is left, tau = 1 / (4 B)."""
    slow = TEXT.replace("bandwidth_hz = 4000.0", "bandwidth_hz = 250.0").replace("samples = 8", "samples = 1")
    one = stage(parse_scene(slow.replace("start_ms = 2.5", "start_ms = 2.0")))
    left = np.exp(-2e-3 * 4 * 250.0)
    assert one.mixing[1, 0] == pytest.approx(left * (one.mixing[0, 0]), rel=1e-9)
    assert np.allclose(one.mixing.sum(1), 1.0)


def test_noise_of_averaged_slots_is_that_of_samples_that_are_drawn():
    """Noise of a first-order stage, drawn sample by sample, averaged over a slot as the converter does."""
    one, rng = stage(shipped().with_({"oximeter.hold_pf": 5.0}), ambient_a=1e-6), np.random.default_rng(5)
    noise_v2 = {cause: float(slots_v2[0, 0]) for cause, slots_v2 in one.slot_noise_v2(LIGHT).items()}
    expected = noise_v2["electronics"]
    budget = electronics.noise_budget(one.photocurrent_a(LIGHT[0], 0), one.photodiodes, shipped().electronics)
    analog = float((sum(budget) - budget.adc_v2)[0])
    held = electronics.BOLTZMANN_J_PER_K * 305.0 / 5e-12
    step = np.exp(-np.diff(1e-3 * one.sample_times_ms(2.0))[0] / one.settling_s)
    values = np.sqrt(analog) * rng.standard_normal(200_000)
    total = values.copy()
    for _ in range(7):
        values = step * values + np.sqrt((1 - step**2) * analog) * rng.standard_normal(len(values))
        total += values
    drawn = np.var(total / 8) + held / 8
    assert drawn == pytest.approx(expected, rel=0.02)
    assert expected > analog / 8
    assert noise_v2["converter"] == pytest.approx(float(budget.adc_v2) / 8)
    # Shot noise 2qI of 1 uA, averaged as the stage's own.
    shot_v2 = 2 * electronics.ELEMENTARY_CHARGE_C * 1e-6 * 4e3 * 4e5**2
    assert noise_v2["ambient light"] == pytest.approx(shot_v2 * (expected - held / 8) / analog)


def test_the_error_of_a_ratio_is_that_of_slopes_of_noisy_pulses():
    rng, ratio, index = np.random.default_rng(2), 0.5, np.array([0.005, 0.01])
    shape = np.sin(2 * np.pi * np.arange(800) / 80.0) / 2
    level, noise = np.array([1.0, 2.0]), np.array([2e-4, 3e-4])
    slopes = []
    for _ in range(600):
        red = index[0] * shape + noise[0] / level[0] * rng.standard_normal(800)
        infrared = index[1] * shape + noise[1] / level[1] * rng.standard_normal(800)
        slopes.append(red @ shape / (infrared @ shape))
    stderr = ratio_stderr(np.array(ratio), index, level, noise**2, shape_rms=shape.std(), frames=800)
    assert np.std(slopes) == pytest.approx(float(stderr), rel=0.1)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("start_ms = 2.5", "start_ms = 1.5", "overlaps"),
        ('light = "dark", start_ms = 5.0', 'light = "dark", start_ms = 9.0', "after their frame"),
        ('light = "infrared"', 'light = "green"', "is unknown"),
        ('light = "infrared"', 'light = "red"', "is used twice"),
        ('    { light = "infrared", start_ms = 2.5, length_ms = 2.0 },\n', "", "two LEDs"),
        ('part = "led_940"', 'part = "led_660"', "see the same blood"),
    ],
)
def test_impossible_schedules_are_the_scenes_own_error(old, new, words):
    assert old in TEXT
    with pytest.raises(InputError, match=words) as error:
        parse_scene(TEXT.replace(old, new))
    assert "\n" not in str(error.value)


def test_one_led_or_no_pulse_is_refused():
    scene = shipped()
    with pytest.raises(InputError, match="two LEDs"):
        oximeter_leds(scene.model_copy(update={"oximeter": None, "leds": scene.leds[:1]}))
    with pytest.raises(InputError, match="heartbeat"):
        oximeter_leds(scene.model_copy(update={"body": None}))
    heart = scene.body.heartbeat.model_copy(update={"pulse_pressure_pa": 0.0})
    with pytest.raises(InputError, match="pulse"):
        oximeter_leds(scene.model_copy(update={"body": scene.body.model_copy(update={"heartbeat": heart})}))

"""Light on nail and eye against integrals over the die, and what a reading takes."""

import numpy as np
import pytest

from nailoptics.assets import data_dir
from nailoptics.scene import Scene, load_scene
from nailoptics.sensor.exposure import SKIN_M, SKIN_W_PER_M2, exposures
from nailoptics.studies.scene_check import check


def scene(name: str = "prototype", **led_fields: object) -> Scene:
    shipped = load_scene(data_dir("scenes") / f"{name}.toml")
    return shipped.model_copy(update={"leds": tuple(led.model_copy(update=led_fields) for led in shipped.leds)})


def test_the_limit_of_skin_is_that_of_the_standard():
    # 20 000 t^0.25 J/m^2 in 10 s.
    assert 10 * SKIN_W_PER_M2 == pytest.approx(20_000 * 10**0.25)


@pytest.mark.parametrize("size_mm", [0.05, 0.25, 1.0])
def test_irradiance_below_a_die_is_the_integral_over_it(size_mm):
    """A Lambertian place of the die gives cos^4 / (pi h^2) of its light to each place of the nail; both are summed."""
    lit = scene(size_mm=(size_mm, size_mm))
    (one,), height_mm, radius_mm = exposures(lit), lit.board.height_mm, 500 * SKIN_M
    middles = (np.arange(300) + 0.5) / 300 - 0.5
    u, v = np.meshgrid(2 * radius_mm * middles, 2 * radius_mm * middles)
    inside, die = np.hypot(u, v) < radius_mm, size_mm * (np.arange(5) - 2) / 5
    cos2 = [height_mm**2 / (height_mm**2 + (u[inside] - x) ** 2 + (v[inside] - y) ** 2) for x in die for y in die]
    expected = np.mean(np.square(cos2)) / height_mm**2 * lit.leds[0].flux_mw * 1e-3 / np.pi * 1e6
    # The formula's die is a point.
    assert one["nail_w_per_m2"] == pytest.approx(expected, rel=0.02)


def test_a_reading_takes_the_light_and_the_charge_of_its_time():
    (one,) = exposures(scene(current_ma=20.0))
    assert one["light_j"] == pytest.approx(2e-3 / 200) and one["charge_c"] == pytest.approx(20e-3 / 200)
    assert exposures(scene())[0]["charge_c"] is None


def test_leds_that_are_lit_in_turn_share_the_time():
    shipped, (alone,) = scene("pulse_oximeter"), exposures(scene())
    for led, slot in zip(exposures(shipped), shipped.oximeter.slots, strict=False):
        duty = 1e-3 * slot.length_ms * shipped.oximeter.frame_hz
        assert 0 < duty < 0.5 and led["eye_w_per_m2"] == pytest.approx(duty * alone["eye_w_per_m2"])


def test_check_warns_of_a_led_too_bright_for_skin(jit_backend, coarse_light, few_photons_beside):
    dim, bright = (check(scene(flux_mw=flux_mw))["warnings"] for flux_mw in (30.0, 50.0))
    assert not any("exposure" in line for line in dim) and any("exposure" in line for line in bright)

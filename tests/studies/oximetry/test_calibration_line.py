"""Lines between the ratio of ratios and saturation, and the warning where paths are too unequal for a textbook's."""

import numpy as np
import pytest

from nailoptics import load_scene
from nailoptics.assets import data_dir
from nailoptics.errors import InputError
from nailoptics.scene import Scene
from nailoptics.statistics import jackknife
from nailoptics.studies.oximetry.ratio import (
    MEASURED,
    calibrate_curve,
    literature_bias,
    path_warnings,
    saturation_of,
)

SO2 = np.linspace(0.7, 1.0, 31)


def test_a_line_is_fitted_with_the_standard_error_of_its_noise():
    """Expected: of 40 replicates without a group each, the slope's error is that of many repeats."""
    rng, slopes, errors = np.random.default_rng(4), [], []
    for _ in range(200):
        scale = 1 + 0.02 * np.sqrt(40) * rng.standard_normal(40)
        each = np.concatenate([[scale.mean()], (scale.sum() - scale) / 39])
        ratio = each[:, None, None] * ((110 - 100 * SO2) / 25)[None, None]
        fits, miss = calibrate_curve(SO2, ratio, 1)
        slopes.append(fits[0, 0, 1])
        errors.append(jackknife(fits)[0, 1])
    assert abs(np.mean(slopes) + 25) < 0.15
    assert abs(np.mean(errors) / np.std(slopes) - 1) < 0.15
    assert miss[0] < 1e-9 and calibrate_curve(SO2, ratio, 2)[1][0] < 1e-9


def test_a_curve_is_inverted_and_extrapolated_beyond_its_ends():
    curve = 1.1 - SO2 + 0.2 * (SO2 - 0.8) ** 2
    assert np.allclose(saturation_of(curve, SO2, curve), SO2)
    beyond = saturation_of([curve[0] + 0.1, curve[-1] - 0.1], SO2, curve)
    assert beyond[0] < SO2[0] and beyond[1] > SO2[-1]


def test_a_curve_that_rises_with_saturation_is_read_as_well():
    """Rationale: of 530 and 660 nm light the ratio of ratios rises. Expected: each saturation from its own ratio."""
    curve = SO2**2
    assert np.allclose(saturation_of(curve, SO2, curve), SO2)
    assert saturation_of(1.02, SO2, curve) == pytest.approx(1.01, abs=1e-3)


def test_the_bias_from_two_published_lines_is_that_from_the_nearer_one():
    assert abs(literature_bias(np.array([0.52]), 0.97)[0]) < 1e-9
    assert abs(literature_bias(np.array([(97.0 - MEASURED[0]) / MEASURED[1]]), 0.97)[0]) < 1e-9
    assert literature_bias(np.array([0.17]), 0.97)[0] > 7.0


def along_the_nail(scene: Scene) -> Scene:
    """The scene with its dies 1 mm apart along the nail, beside the photodiodes."""
    places = ((-1.2, -0.5), (-1.2, 0.5))
    leds = tuple(led.model_copy(update={"position_mm": p}) for led, p in zip(scene.leds, places, strict=True))
    diode = scene.photodiodes[0].model_copy(update={"position_mm": (0.0, -2.0), "wired": (6, 10)})
    return scene.model_copy(update={"leds": leds, "photodiodes": (diode,)})


def test_dies_along_the_nail_are_warned_of_with_advice():
    scene = along_the_nail(load_scene(data_dir("scenes") / "pulse_oximeter.toml"))
    lines = path_warnings(scene, np.array([0.30, 0.45]), np.array([0.9, 1.3]))
    assert len(lines) == 1 and "axis" in lines[0] and "photodiode" in lines[0] and "\n" not in lines[0]


def test_a_photodiode_as_far_from_both_leds_gets_its_own_advice():
    scene = load_scene(data_dir("scenes") / "pulse_oximeter.toml")
    lines = path_warnings(scene, np.array([0.30, 0.45, 0.50]), np.array([0.9, 1.3, 1.45]))
    assert len(lines) == 1 and '"axis.1"' in lines[0] and "fit of this scene" in lines[0]


def test_leds_that_were_changed_to_one_colour_are_refused_in_one_line():
    """Rationale: a scene that was changed after it was read is not checked again by its model."""
    scene = load_scene(data_dir("scenes") / "pulse_oximeter.toml")
    leds = tuple(led.model_copy(update={"wavelength_nm": 660.0}) for led in scene.leds)
    alike, ones = scene.model_copy(update={"leds": leds}), np.ones(len(scene.layout.photodiodes))
    with pytest.raises(InputError, match="see the same blood; take two") as error:
        path_warnings(alike, ones, ones)
    assert "\n" not in str(error.value)

"""Why predict estimates no shear: in the model it presses on the vessels as a distal force does."""

import numpy as np

from nailoptics import load_scene
from nailoptics.assets import data_dir
from nailoptics.hemodynamics.for_scene import blood_model


def test_shear_moves_the_blood_of_no_zone_as_a_distal_force_does_not() -> None:
    model = blood_model(load_scene(data_dir("scenes") / "shear.toml"))
    held_pa = model.touch.held_pa([1.5])
    by_distal, by_shear = (model.steady(held_pa + 200.0 * np.eye(3)[:, [side]]) for side in (1, 2))
    assert np.abs(by_distal - model.steady(held_pa)).max() > 1e-4
    assert np.abs(by_shear - by_distal).max() < 1e-9

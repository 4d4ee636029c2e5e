"""A sweep from Python: the scenes, results and folder of a batch over the same values."""

import subprocess
import sys

import numpy as np
import pytest

import nailoptics as nail
from nailoptics.batch import load_sweep, run_batch
from nailoptics.errors import InputError, NotReachedError
from nailoptics.scene import to_toml
from nailoptics.scene.sweep import sweep_over

from .conftest import FINGERS, bits, phantoms

OVER = {"blood.so2": [0.75, 0.97], "electronics.feedback_ohm": [2e5, 4e5]}


@pytest.mark.jit
def test_a_sweep_has_the_results_of_a_batch_and_a_dimension_for_each_field(jit_backend, here, fingers, tmp_path):
    swept = nail.sweep(nail.load_scene("prototype"), OVER, photons=8000, backend=jit_backend.name, workers=1)
    run_batch(fingers, tmp_path / "b", photons=8000, backend=jit_backend.name, workers=1)
    batch = nail.open_results(tmp_path / "b").squeeze("photons", drop=True)
    for name in ("volts_start", "volts_start_stderr", "volts_change_peak", "detected_fraction_rest_stderr"):
        assert swept[name].dims == ("so2", "feedback_ohm", "led", "photodiode") and (swept[name] > 0).any()
        assert np.array_equal(swept[name], batch[name])
    for name, path, unit in (("so2", "blood.so2", "1"), ("feedback_ohm", "electronics.feedback_ohm", "Ω")):
        assert swept[name].values.tolist() == OVER[path]
        assert swept[name].attrs == {"long_name": path, "units": unit}
    assert swept.nail.plot().axes[0].get_xlabel() == "blood.so2 [1]" and "4 scenes" in swept.nail.report()


@pytest.mark.jit
def test_scenes_of_other_zones_and_times_are_one_dataset(jit_backend, here):
    """Expected: what a scene lacks is NaN, and what it has is in its place."""
    over, more = {"blood.zones": [2, 4], "touch.duration_s": [2.0, 1.0]}, {"photons": 500, "workers": 1}
    swept = nail.sweep("prototype", over, course=True, backend=jit_backend.name, **more)
    assert np.isfinite(swept.volts_start).all() and swept.sizes["time"] == 201
    blood = np.isfinite(swept.blood_fraction.transpose("zones", "duration_s", "zone", "time"))
    assert blood.isel(time=0).sum("zone").values.tolist() == [[2, 2], [4, 4]]
    assert blood.any("zone").sum("time").values.tolist() == [[201, 101], [201, 101]]
    assert "touch.duration_s" in swept.nail.report()


@pytest.mark.jit
def test_in_a_folder_a_sweep_is_resumed(jit_backend, here, tmp_path):
    scene, folder = phantoms(tmp_path, 1).scenes[0], tmp_path / "b"
    field = "phantom.layers.slab.thickness_mm"
    more = {"folder": folder, "workers": 1, "backend": jit_backend.name}
    first = nail.sweep(scene, {field: [0.5, 1.0]}, **more)
    before = bits(folder)
    both = nail.sweep(scene, {field: np.array([0.5, 1.0, 2.0])}, **more)
    assert len(bits(folder)) == 3 and before.items() <= bits(folder).items()
    assert both.isel(thickness_mm=[0, 1]).equals(first)


@pytest.mark.long
@pytest.mark.jit
@pytest.mark.parametrize("is_file", [True, False])
def test_a_script_without_a_main_guard_is_run_once(jit_backend, tmp_path, is_file):
    """Expected: from a file or the standard input, its worker processes do not run it again."""
    (tmp_path / "slab.toml").write_text(to_toml(phantoms(tmp_path, 1).scenes[0]))
    field = "phantom.layers.slab.thickness_mm"
    text = f"""import nailoptics as nail
print("run", flush=True)
swept = nail.sweep("slab.toml", {{"{field}": [0.5, 1.0]}}, workers=1, backend="{jit_backend.name}")
print(*swept.state.values)
"""
    (tmp_path / "script.py").write_text(text)
    command, given = [sys.executable, "script.py" if is_file else "-"], None if is_file else text
    done = subprocess.run(command, input=given, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.stdout == "run\ndone done\n", done.stderr


@pytest.mark.jit
def test_where_scenes_fail_the_others_are_the_result(jit_backend, here, tmp_path):
    over = {"light.engine": ["photons", "volpath"], "phantom.layers.slab.thickness_mm": [1.0, 2.0]}
    (scene,) = phantoms(tmp_path, 1).scenes
    scene = scene.model_copy(
        update={
            "leds": (
                scene.leds[0].model_copy(
                    update={"pattern": "measured", "pattern_deg": (0.0, 90.0), "pattern_relative": (1.0, 0.0)}
                ),
            )
        }
    )
    with pytest.raises(NotReachedError, match="2 failed") as caught:
        nail.sweep(scene, over, workers=1, backend=jit_backend.name)
    result = caught.value.result
    assert "retry" not in str(caught.value)  # a sweep tries again by itself
    assert result.state.values.tolist() == [["done"] * 2, ["failed"] * 2] and "2 failed" in result.attrs["cut_off"]


def test_a_scene_and_its_file_make_the_same_scenes(tmp_path):
    """Whatever follows from a field: what its part has, sizes of its digit, a finger as long as its nail."""
    for path, values in (
        ("leds.ir.part", ["led_660", "led_940"]),
        ("finger.digit", ["ring", "thumb"]),
        ("finger.nail_length_mm", [11.0, 13.0]),
        ("leds.ir.flux_mw", [1.0, 2.0]),
    ):
        from_file = sweep_over("prototype", {path: values})
        from_scene = sweep_over(nail.load_scene("prototype"), {path: values})
        assert from_scene.scenes == from_file.scenes and len(set(from_file.scenes)) == 2
    (tmp_path / "fingers.toml").write_text(FINGERS)
    assert (
        sweep_over("prototype", OVER | {"accuracy.photons": [8000]}).scenes
        == load_sweep(tmp_path / "fingers.toml").scenes
    )


def test_fields_of_one_name_are_called_by_their_path():
    sweep = sweep_over("pulse_oximeter", {"leds.red.flux_mw": [1.0, 2.0], "leds[1].flux_mw": [3.0, 4.0]}, combine="zip")
    assert [axis.name for axis in sweep.axes] == ["leds_red_flux_mw", "leds_1_flux_mw"]
    assert [tuple(led.flux_mw for led in scene.leds) for scene in sweep.scenes] == [(1.0, 3.0), (2.0, 4.0)]


@pytest.mark.parametrize(
    ("over", "more", "words"),
    [
        ({}, {}, "over = {}: give fields"),
        ([0.9], {}, "over = [0.9]: give fields"),
        ({"blood.so2": [0.9, 0.9]}, {}, "blood.so2 has a value twice"),
        ({"touch.force_n": [1, 1.0]}, {}, "touch.force_n has a value twice"),
        ({"blood.so2": [0.9]}, {"workers": 1.5}, "workers = 1.5; must be a whole number"),
        ({"blood.so2": 0.9}, {}, '"blood.so2" = 0.9 is not a list'),
        ({"blood.so2": []}, {}, "is not a list"),
        ({"digit": "ring"}, {}, "is not a list"),
        ({"blood.so2": [0.9, 2.0]}, {}, "blood.so2 = 2.0: must be less than or equal to 1"),
        ({"blood.so3": [0.9]}, {}, 'blood.so3 is not a known field; did you mean "so2"'),
        ({"leds.uv.flux_mw": [1.0]}, {}, "there is no item uv here"),
        ({"blood..so2": [1.0]}, {}, "is not a field"),
        ({"blood.so2": [0.9]}, {"study": "smell"}, 'study = "smell"'),
        ({"blood.so2": [0.9], "touch.force_n": [1.0, 2.0]}, {"combine": "zip"}, "as many of each"),
        ({"blood.so2": [0.9]}, {"photons": -1}, "photons = -1"),
    ],
)
def test_mistakes_are_one_line_and_nothing_is_written(tmp_path, over, more, words):
    with pytest.raises(InputError) as caught:
        nail.sweep("prototype", over, folder=tmp_path / "b", **more)
    assert words in str(caught.value) and "\n" not in str(caught.value)
    assert not (tmp_path / "b").exists()


def test_a_field_without_effect_on_a_phantom_is_refused_and_zip_takes_a_value_twice():
    with pytest.raises(InputError, match="blood.so2.* changes nothing of a .phantom."):
        sweep_over(nail.load_scene("phantom"), {"blood.so2": [0.8, 0.9]})
    over = {"blood.so2": [0.9, 0.9], "touch.force_n": [1.0, 2.0]}
    assert len(sweep_over(nail.load_scene("prototype"), over, combine="zip").scenes) == 2

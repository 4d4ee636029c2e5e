"""The oximeter from light to SpO2: R against independent traces, its line, its error, and the answer as JSON."""

import itertools
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from listed_variables import assert_listed
from shown import all_shown

from nailoptics import load_scene, trace
from nailoptics.assets import data_dir
from nailoptics.cli import run
from nailoptics.errors import InputError
from nailoptics.hemodynamics.for_scene import BloodBeat, beat_at, rest_beat
from nailoptics.io import to_json, write_dataset
from nailoptics.light import Transfer
from nailoptics.options import TraceOptions
from nailoptics.report.pages.oximeter import OXIMETER, oximeter_summary as summary
from nailoptics.scene import Led, Scene
from nailoptics.sensor.electronics import photocurrent_a
from nailoptics.statistics import jackknife
from nailoptics.studies.oximetry import oxygen, ratio
from nailoptics.studies.oximetry.oxygen import oximeter, oximeter_from
from nailoptics.studies.oximetry.ratio import read_pulsations, read_states, saturation_curve, saturation_of
from nailoptics.studies.oximetry.recording import simulated, spo2_over_time
from nailoptics.variables import jackknifed

pytestmark = [pytest.mark.jit, pytest.mark.usefixtures("few_photons_beside")]
SEED = 11


def shipped() -> Scene:
    return load_scene(data_dir("scenes") / "pulse_oximeter.toml")


@pytest.fixture
def without_curves(monkeypatch: pytest.MonkeyPatch) -> None:
    """An oximeter's bias over what disturbs it is not computed: for tests that read nothing of it."""
    monkeypatch.setattr(oxygen, "sensitivity_curves", lambda *_: {})


def replace_leds(scene: Scene, *leds: Led) -> Scene:
    return scene.model_copy(update={"leds": leds})


@pytest.fixture(scope="module")
def light(chosen_jit) -> Transfer:
    """The shipped scene's light, 262144 photons for each LED."""
    return trace(shipped(), photons=1 << 18, seed=SEED)


@pytest.fixture(scope="module")
def computed(light):
    result = oximeter_from(light, options=TraceOptions(seed=SEED))
    result.attrs |= {"cpu_seconds": 0.0, "wall_seconds": 0.0}
    return result


@pytest.mark.long
def test_the_shipped_oximeter_is_one(computed, tmp_path):
    """Rationale: measured on fingers, a slope lies at -28 to -40, an intercept at 108 to 114 and R(0.97) at 0.36 to
    0.52. Expected: these on the best photodiode within three standard errors of so few photons, R that falls with
    saturation on all of them, and all that the JSON promises."""
    printed = summary(computed)
    best = printed["readings"][printed["best"]]
    fit, rest = best["fit"], best["ratio_at_rest"]
    assert -40 - 3 * fit["slope_stderr"] < fit["slope"] < -28 + 3 * fit["slope_stderr"]
    assert 108 < fit["intercept"] < 114
    assert 0.36 - 3 * rest["stderr"] < rest["value"] < 0.52 + 3 * rest["stderr"]
    assert rest["stderr"] < 0.08 * rest["value"]
    for one in printed["readings"].values():
        assert np.all(np.diff(one["ratio"]) < 0) and np.all(np.array(one["ratio_stderr"]) > 0)
        assert set(one["perfusion_index"]) == {"red", "infrared"} and one["so2"][0] == 0.5
        assert 0.9 < one["path_ratio"] < 1.8 and one["spo2_stderr_beat"] >= one["spo2_stderr"] > 0
        assert not one["saturated"]
        assert {"touch_force_n", "rest_blood_fraction", "sunlight_lux"} <= set(one["disturbances"])
    # By the sensor's noise, not by how many photons were traced.
    assert {*best["spo2_stderr_by_cause"]} == {"electronics", "converter", "ambient light"}
    assert best["spo2_stderr"] == min(one["spo2_stderr"] for one in printed["readings"].values())
    assert best["spo2_stderr"] == pytest.approx(np.linalg.norm([*best["spo2_stderr_by_cause"].values()]))
    assert best["spo2_simulation_stderr"] == pytest.approx(abs(fit["slope"]) * rest["stderr"])
    assert printed.pop("cut_off") is None and "null" not in to_json(printed)
    write_dataset(computed, tmp_path / "oximeter.nc")
    all_shown(computed, page=False)
    page = computed.nail.report()
    assert (
        page.startswith("<!doctype html>")
        and page.count("<figure") == 2
        and "textbook" in page
        and "Effect of a touch" in page
        and "red<br>[V]" in page
    )


@pytest.mark.long
def test_the_command_writes_and_prints_its_results(computed, undrawn, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(oxygen, "oximeter", lambda scene, **_: computed)
    worn, folder = tmp_path / "worn.csv", tmp_path / "out"
    assert run(["oximeter", "pulse_oximeter", "-o", str(folder), "--recording", str(worn), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["best"] == computed.attrs["best"]
    assert {path.name for path in folder.iterdir()} == set(OXIMETER.files) and len(worn.read_text().splitlines()) > 1000
    assert run(["oximeter", "pulse_oximeter", "-o", str(folder)]) == 0
    out = capsys.readouterr().out
    for name in computed.attrs["disturbances"]:
        bias = computed[f"off_by_{name}"]
        (line,) = (one for one in out.splitlines() if one.startswith(f"  {computed[name].attrs['long_name']}, "))
        off, photodiode = re.search(r"bias at most ([-+][\d.]+)(?: \+- [\d.]+)? % \((.+)\)", line).groups()
        there = bias.sel(photodiode=photodiode).values
        assert np.abs(there).max() == abs(bias).max() and np.abs(there - float(off)).min() <= 0.1 * np.abs(there).max()
    assert "sunlight with the dark slot left out, 0 to 100000 lx: bias at most" in out
    assert run(["oximeter", "pulse_oximeter", "-o", str(folder), "--readings", str(worn)]) == 0
    assert_listed(tmp_path, "oximeter.nc", "oxygen.nc")


@pytest.mark.long
def test_the_pulse_dims_infrared_more_than_red(computed):
    index = computed.perfusion_index
    assert np.all(index.sel(led="infrared") > index.sel(led="red"))
    # Far photodiodes sample deeper tissue, where the blood is.
    assert np.all(np.diff(index.values, axis=-1) > 0)
    least = computed.volts_pulse.argmin("beat_time")
    assert np.all(abs(least - least[0, 0]) <= 1)


@pytest.mark.long
def test_a_disturbance_biases_spo2_as_the_ratio_of_the_changed_scene(light, computed):
    """Expected: at the end of each curve the calibrated curve's SpO2 of R read again, and of R diluted by sunlight;
    nothing where the scene is as it was calibrated."""
    scene, so2 = light.scene, light.scene.blood.so2
    beat, (red, infrared) = rest_beat(scene), scene.leds
    warmer = replace_leds(
        scene, *(led.model_copy(update={"wavelength_nm": led.wavelength_nm + 5.0}) for led in scene.leds)
    )
    more_blood = scene.with_({"blood.rest_blood_fraction": 0.06})
    changed = {
        "touch_force_n": (scene, beat_at(scene, 2.0)),
        "rest_blood_fraction": (more_blood, rest_beat(more_blood)),
        "melanin_fraction": (scene.with_({"finger.melanin_fraction": 0.43}), beat),
        "line_width_nm": (replace_leds(scene, *(led.model_copy(update={"fwhm_nm": 40.0}) for led in scene.leds)), beat),
        "warmer_k_250_pm_per_k": (warmer, beat),
        "venous_below_arterial": (scene.with_({"blood.venous_so2": so2 - 0.30}), beat),
    }
    ratios = {
        name: read_pulsations(replace(light, scene=variant), (0, 1), [(so2, moved)]).ratio[0, :, 0]
        for name, (variant, moved) in changed.items()
    }
    nominal = read_pulsations(light, (0, 1), [(so2, beat)])
    level_a = [photocurrent_a(nominal.dc[0, k, :, 0], led, scene.elements) for k, led in enumerate((red, infrared))]
    diluted = [a / (a + computed.sun_a.values) for a in level_a]
    ratios["sunlight_lux"] = nominal.ratio[0, :, 0] * diluted[0] / diluted[1]
    for name, anew in ratios.items():
        for j, curve in enumerate(computed.ratio.values):
            bias = 100 * (saturation_of(anew[j], computed.so2.values, curve) - so2)
            assert computed[f"off_by_{name}"].values[j, -1] == pytest.approx(bias, abs=1e-3), name
    as_calibrated = {"touch_force_n": 0.0, "melanin_fraction": 0.013, "warmer_k_130_pm_per_k": 0.0, "sunlight_lux": 0.0}
    for name, value in as_calibrated.items():
        assert np.abs(computed[f"off_by_{name}"].sel({name: value})).max() < 2e-6, name
        assert computed[f"off_by_{name}_stderr"].sel({name: value}).max() < 1e-6, name


@pytest.mark.long
def test_interpolated_saturations_agree_with_those_read_directly(light):
    beat = beat_at(shipped(), 0.0)
    curve = saturation_curve(light, (0, 1), beat, low=0.5, high=1.0)
    many = curve(np.linspace(0.5, 1.0, 100)).ratio
    for k in (0, 37, 99):
        one = read_pulsations(light, (0, 1), [(np.linspace(0.5, 1.0, 100)[k], beat)]).ratio
        assert np.allclose(many[..., k], one[..., 0], rtol=1e-6)


@pytest.mark.long
def test_the_error_of_r_is_that_of_other_seeds(light):
    """Expected: R of eight traces, of three photodiodes each, scatters by its standard errors to a factor of 1.4."""
    beat, values, errors = beat_at(shipped(), 0.0), [], []
    for seed in range(8):
        other = trace(shipped(), photons=1 << 14, seed=100 + seed)
        value, error = jackknifed(read_pulsations(other, (0, 1), [(0.97, beat)]).ratio[..., 0])
        values.append(value)
        errors.append(error)
    assert 0.7 < np.sqrt(np.mean(np.var(values, axis=0, ddof=1) / np.mean(np.square(errors), axis=0))) < 1.4


@pytest.mark.slow
def test_r_is_that_of_fresh_traces_with_less_and_more_blood(chosen_jit):
    """Rationale: one trace gives R at any saturation by reweighting; a finite difference of fresh traces, each of its
    own blood, is independent of that. Both traces of a pair take the same random numbers, so that their difference is
    sharp, and pairs of other seeds give its error. Expected: agreement within three standard errors, which are below
    7 % of R (measured 2 to 4 % with twice as many photons)."""
    so2, low, high, pairs = 0.6, 0.02, 0.04, 8
    blood = shipped().blood.model_copy(update={"so2": so2, "venous_so2": None})
    middle = shipped().model_copy(update={"blood": blood})
    read = np.zeros((pairs, 2, 2, 3))
    for pair, (k, rest) in itertools.product(range(pairs), enumerate((low, high))):
        own = middle.model_copy(update={"blood": blood.model_copy(update={"rest_blood_fraction": rest})})
        read[pair, k] = trace(own, photons=1 << 18, seed=500 + pair).at().detected_fraction

    def ratio(pair: np.ndarray) -> np.ndarray:
        less, more = pair.mean(0)
        change = np.log(less / more)
        return np.asarray(change[0] / change[1])

    fresh = ratio(read)
    fresh_error = jackknife(np.stack([fresh, *(ratio(np.delete(read, k, 0)) for k in range(pairs))]))
    ours, beat = trace(middle, photons=1 << 20, seed=1), BloodBeat(np.arange(2.0), np.array([[low, high]] * 2))
    both = np.stack([read_states(ours, led, [(so2, beat.resting, beat.pulse)]) for led in (0, 1)], 1)
    logs = np.log(both[..., 0] / both[..., 1])
    estimated, estimated_error = jackknifed(logs[:, 0] / logs[:, 1])
    error = np.hypot(estimated_error, fresh_error)
    assert np.all(abs(estimated - fresh) < 3 * error) and np.all(error < 0.07 * fresh)


@pytest.mark.long
def test_the_saturation_is_recovered_from_a_recording_of_the_scene(light, computed, without_curves):
    """Expected: at held-out saturations, within the noise of the slots, as the light is one,
    until the touch after 20 s, which is marked."""
    for so2 in (0.80, 0.93):
        scene = shipped().model_copy(update={"blood": shipped().blood.with_so2(so2)})
        other = oximeter_from(replace(light, scene=scene), options=TraceOptions(seed=SEED))
        estimates = spo2_over_time(simulated(scene, other, seed=4), computed, shipped()).sel(
            photodiode=computed.attrs["best"]
        )
        still = estimates.sel(time=slice(0.0, 15.0))
        assert np.all(abs(still.spo2 - 100 * so2) < 0.15) and np.all(still.spo2_stderr < 1.0)
        assert np.all(abs(still.rate_per_min - 70.0) < 2.0)
        assert float(still.motion.max()) < 0.03 and float(estimates.sel(time=slice(18.0, 25.0)).motion.max()) > 0.05


@pytest.mark.long
def test_the_error_of_r_is_what_stops_the_trace(chosen_jit, without_curves, monkeypatch):
    """Expected: one more round than that of so few photons, and no more light than the best photodiode needs."""
    monkeypatch.setattr(ratio, "FIRST_PHOTONS", 1 << 12)
    largest = []
    for seed in (1, 2):
        loose = oximeter(shipped(), relative_error=0.1, seed=seed)
        error = loose.ratio_at_rest_stderr / loose.ratio_at_rest
        assert 0.07 < float(error.min()) <= 0.1 and 2 << 12 < loose.attrs["photons"] < 8 << 12
        largest.append(float(error.max()))
    # Of 16 seeds the others, too, have such a ratio at two.
    assert max(largest) > 0.1


@pytest.mark.long
def test_two_dies_along_the_nail_are_warned_of(light, without_curves):
    """Rationale: dies 2 mm apart along the nail sample other beds. Expected: a warning that names the photodiode and
    the advice."""
    scene = shipped()
    places = ((-1.2, -1.0), (-1.2, 1.0))
    leds = tuple(led.model_copy(update={"position_mm": p}) for led, p in zip(scene.leds, places, strict=True))
    diode = scene.photodiodes[0].model_copy(update={"position_mm": (0.0, -2.0), "wired": (6, 10)})
    along = scene.model_copy(update={"leds": leds, "photodiodes": (diode,)})
    result = oximeter_from(trace(along, photons=1 << 15, seed=3), options=TraceOptions(seed=1))
    message = " ".join(result.attrs["warnings"])
    assert '"axis.6"' in message and "on the axis between two dies side by side" in message
    assert float(result.path_ratio.min()) < 0.8


def test_slots_that_do_not_settle_are_refused(light):
    slow = light.scene.with_({"electronics.bandwidth_hz": 100.0})
    words = r'reads -\S+ V in slot "\w+" less the dark one; raise electronics.bandwidth_hz = 100 or lengthen'
    with pytest.raises(InputError, match=words):
        oximeter_from(replace(light, scene=slow), options=TraceOptions(seed=SEED))


def test_no_light_is_traced_for_what_is_no_oximeter(monkeypatch):
    monkeypatch.setattr("nailoptics.studies.oximetry.ratio.trace_for_ratio", None)
    with pytest.raises(InputError, match="heartbeat"):
        oximeter(shipped().model_copy(update={"body": None}))
    one = shipped().model_copy(update={"oximeter": None, "leds": shipped().leds[:1]})
    with pytest.raises(InputError, match="two LEDs"):
        oximeter(one)

"""Force under light from outside: what a calibration takes of it, and what an estimate does when it changes."""

from dataclasses import replace

import made_sensor
import numpy as np
import pytest
import xarray as xr
from untraced_light import MOST_BLOOD, untraced

from nailoptics.errors import InputError
from nailoptics.hemodynamics.for_scene import blood_over_touch
from nailoptics.options import TraceOptions
from nailoptics.report.pages.force import prediction_summary
from nailoptics.scene import Ambient, Scene, Touch, to_toml
from nailoptics.scene.importers.sensor_recordings import Recording
from nailoptics.sensor.ambient import scene_ambient_a
from nailoptics.sensor.volts import WornLight
from nailoptics.studies.force.calibrate import calibrate_with
from nailoptics.studies.force.predict import predict
from nailoptics.studies.force.reading_table import ReadingTable, reading_table, record
from nailoptics.studies.force.subject import Subject, parse_subject
from nailoptics.studies.simulate import simulate_from

# A lamp of 1000 lux on the prototype's photodiodes, as traced. [A]
LAMP_A = 1e-7 * np.array([4.6, 4.3, 4.3, 4.5, 4.7, 4.9, 5.1, 5.4])


@pytest.fixture(autouse=True)
def _untraced_lamp(monkeypatch: pytest.MonkeyPatch) -> None:
    """Photocurrents are proportional to the illuminance."""

    def trace_ambient(scene: Scene, sources: tuple[Ambient], *_: object, **__: object) -> np.ndarray:
        current_a = LAMP_A * (sources[0].illuminance_lux or 0.0) / 1e3
        return np.stack([current_a, 0.1 * current_a, 10.0 * current_a])[:, None]

    monkeypatch.setattr("nailoptics.sensor.ambient.trace_ambient", trace_ambient)


def lit(lux: float | None, rejection: str | None = None) -> Scene:
    scene = made_sensor.scene()
    stage = scene.electronics.model_copy(update={"ambient_rejection": rejection})
    ambient = None if lux is None else Ambient(illuminance_lux=lux)
    return scene.model_copy(update={"ambient": ambient, "electronics": stage})


def table_of(scene: Scene) -> ReadingTable:
    return reading_table(scene, untraced(scene), MOST_BLOOD, TraceOptions())


def simulated(scene: Scene, course: xr.Dataset, *, seed: int = 0) -> xr.Dataset:
    light = WornLight(scene, untraced(scene), scene_ambient_a(scene, TraceOptions()))
    return simulate_from(light, course=course, seed=seed)


def recorded(scene: Scene, *, site: str, peaks_n: tuple[float, ...], seed: int) -> Recording:
    time_s = np.append(0.0, 3.0 + np.arange(4 * len(peaks_n) + 1))
    force_n = np.append([0.0, 0.0], np.array([[0.5, 1.0, 0.5, 0.0]]) * np.array(peaks_n)[:, None])
    given = {"recorded_time_s": tuple(time_s), "recorded_force_n": tuple(force_n), "site": site}
    own = {"creep": 0.0, "distal_relaxation_s": 1e-3, "sample_rate_hz": 12.5, "profile": "recorded"}
    touched = scene.model_copy(update={"touch": Touch.model_validate(given | own)})
    result = simulated(touched, blood_over_touch(touched, rtol=1e-4), seed=seed)
    return record(result.assign_attrs(scene=to_toml(touched)), seed=seed)


def calibrated(scene: Scene) -> Subject:
    peaks_n = (0.4, 1.6, 0.8)
    sides = ("proximal", "distal")
    recordings = [recorded(scene, site=side, peaks_n=peaks_n, seed=k) for k, side in enumerate(sides)]
    return parse_subject(calibrate_with(scene, table_of(scene), recordings).attrs["subject"])


def estimated(subject: Subject, scene: Scene) -> dict[str, object]:
    return prediction_summary(predict(subject, recorded(scene, site="proximal", peaks_n=(0.6, 0.3), seed=9)))


def test_a_recording_needs_a_whole_result() -> None:
    scene = made_sensor.scene().with_(touch={"profile": "hold", "force_n": 0.2, "sample_rate_hz": 10.0})
    result = simulated(scene, blood_over_touch(scene)).assign_attrs(scene=to_toml(scene))
    recording = record(result, seed=1)
    assert (recording.volts != record(result).volts).any() and np.isnan(recording.site).all()
    assert recording.force_n.tolist() == result.force_n.values.tolist()
    for other in (result.isel(photodiode=[0]), result[["volts"]], result.drop_attrs(), None):
        with pytest.raises(InputError, match="record needs the whole result of simulate; give it as returned"):
            record(other)


def test_a_table_reads_at_rest_what_simulate_does() -> None:
    for rejection in (None, "dark_slot", "lock_in"):
        scene = lit(1000.0, rejection)
        table, rest = table_of(scene), np.full(2, scene.blood.rest_blood_fraction)
        result = simulated(scene, blood_over_touch(scene))
        assert table.volts(rest[:, None])[:, 0] == pytest.approx(result.volts.values[0, :, 0], rel=1e-6)
        assert table.noise_v == pytest.approx(result.volts_noise_rms.values[0, :, 0], rel=1e-9)
        # What is taken away still takes room below the converter's limit.
        assert table.range_v == pytest.approx(5.0 if rejection is None else 5.0 - LAMP_A.max() * 1e6, abs=1e-3)


def test_light_that_saturates_a_converter_at_rest_is_refused() -> None:
    with pytest.raises(InputError, match=r"at its limit \(5 V\) at rest; .* or the light of \[ambient\]\.$"):
        table_of(lit(20_000.0, "dark_slot"))


@pytest.mark.long
def test_a_calibration_under_a_lamp_estimates_under_it_and_reports_when_it_is_off() -> None:
    subject = calibrated(lit(1000.0))
    same, other = estimated(subject, lit(1000.0)), estimated(subject, lit(None))
    assert same["consistent"] and same["touch_rms_n"] < 0.1
    assert not other["consistent"] and other["misfit"] == "ambient light, or another person"
    assert other["touch_rms_n"] > 2 * same["touch_rms_n"]


@pytest.mark.long
def test_behind_a_dark_slot_the_lamp_does_not_matter() -> None:
    subject = calibrated(lit(1000.0, "dark_slot"))
    for lux in (1000.0, None):
        summary = estimated(subject, lit(lux, "dark_slot"))
        assert summary["consistent"] and summary["touch_rms_n"] < 0.1


def test_readings_that_saturate_beside_a_dark_slot_calibrate_nothing() -> None:
    """Expected: of 400 samples three at the limit that the dark slot leaves are gaps; five are refused."""
    table = replace(made_sensor.table(), range_v=3.5)
    recording = made_sensor.record(made_sensor.cycle(1.5), "proximal", seed=1)
    recording.volts[0, 200:203] = 3.5
    result = calibrate_with(made_sensor.scene(), table, [recording])
    assert np.flatnonzero(np.isnan(result.volts.values).any(0)).tolist() == [200, 201, 202]
    recording.volts[0, 200:205] = 3.5
    with pytest.raises(InputError, match=r"is saturated \(3.5 V\) in 5 samples"):
        calibrate_with(made_sensor.scene(), table, [recording])

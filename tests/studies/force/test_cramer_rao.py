"""What a placement promises, an estimator keeps: force from volts against the bound by which layouts are ranked."""

from dataclasses import replace

import made_sensor
import numpy as np
import pytest

from nailoptics.hemodynamics import parameters
from nailoptics.sensor import information
from nailoptics.studies.force.predict import predict
from nailoptics.studies.force.subject import Subject, parse_subject


@pytest.fixture(scope="module")
def calibrated() -> Subject:
    """A subject calibrated without error, whose body is still, and whose readings do not drift."""
    result, light = parse_subject(made_sensor.subject()), made_sensor.table()
    return replace(
        result,
        light=light,
        scene=replace(result.scene, distal_reach=0.0, vessels=parameters(made_sensor.scene().blood.parameters)),
        factors=np.ones_like(result.factors),
        readings=replace(
            result.readings,
            gain=np.ones_like(result.readings.gain),
            offset_v=np.zeros_like(result.readings.gain),
            noise_v=light.noise_v,
        ),
        covariance=1e-14 * np.eye(len(result.covariance)),
        ensemble=None,
        noise=replace(
            result.noise,
            drift_per_min=1e-9,
            led_drift_per_min=1e-9,
            beat=None,
            waves=(),
            dynamic_error=0.0,
            static_error=0.0,
        ),
    )


@pytest.mark.parametrize(("site", "share"), [("proximal", 1.0), ("distal", 0.0)])
def test_a_held_touch_is_estimated_as_finely_as_placement_predicts(
    calibrated: Subject, site: str, share: float
) -> None:
    """Rationale: matched model and electronic noise alone. Expected: rms within 1.3 times the Cramer-Rao bound of one
    sample, whatever the split; less than it only by what the filter remembers of the samples before.
    """
    force_n, light, scene = 0.5, made_sensor.table(), made_sensor.scene()
    touch = scene.touch.model_copy(update={"proximal_share": share, "contact_area_mm2": 100.0})
    point = information.operating_point(scene.model_copy(update={"touch": touch, "body": None}), force_n)
    volts, by_blood = light.slopes(point.blood_fraction)
    read = information.Response(volts, light.noise_v**2, by_blood @ point.blood_per_pa, by_blood, np.zeros(len(volts)))
    # Of a touch on one side, force is the pressure there on the whole contact.
    side = replace(point, force_per_pa=1e-4 * np.array([share, 1.0 - share]))
    bound_n = float(information.force_resolution_n(information.total_information([read]), side))
    time_s = made_sensor.STEP_S * np.arange(500)
    held = force_n * np.where(time_s < 1, 0.0, 1 - np.exp(-np.maximum(time_s - 1, 0) / 0.3))
    estimated = predict(calibrated, made_sensor.record(held, site, seed=5))
    # 250 samples determine an rms to 5 %.
    rms_n = float(np.sqrt(np.mean((estimated.force_n.values - held)[time_s >= 5] ** 2)))
    assert 0.7 * bound_n < rms_n < 1.3 * bound_n
    assert bound_n < 1e-3

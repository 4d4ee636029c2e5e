"""What a calibration leaves open of a force: as wide as readings of other persons of its covariance."""

from dataclasses import replace

import made_sensor
import numpy as np
import pytest
from scipy.optimize import least_squares

from nailoptics.statistics import Z95
from nailoptics.studies.force.interval import INTERVAL_SCALE, PARTS, PRESSURE_PRIOR_N_PER_CM2, ForceInterval
from nailoptics.studies.force.kalman import PressureEstimate, stacked
from nailoptics.studies.force.person import NAMES
from nailoptics.studies.force.subject import LINEAR, Subject, parse_subject

# So small a part of the covariance moves readings in proportion.
PART = 1e-4


@pytest.fixture(scope="module")
def subject() -> Subject:
    result = parse_subject(made_sensor.subject())
    return replace(result, covariance=PART * result.covariance)


def risen_v(one: Subject, pressure: np.ndarray) -> np.ndarray:
    """Volts of every reading over those at rest under held pressures (2,)."""
    diameters = one.person.steady_diameters(np.stack([np.zeros(2), pressure], axis=1))
    return np.asarray(one.readings.gain * np.diff(one.light.volts(one.person.blood(diameters)))[:, 0])


def other(one: Subject, off: np.ndarray) -> Subject:
    """The calibration with this error."""
    gain = one.readings.gain
    factors_ln, gain_error, offset_v, *slopes = np.split(off, len(NAMES) + len(gain) * np.arange(LINEAR))
    light = one.light.steeper(np.stack(slopes, axis=1) / gain[:, None], float(one.person.rest_blood))
    readings = replace(one.readings, gain=gain + gain_error)
    return replace(one, light=light, factors=one.factors * np.exp(factors_ln), readings=readings)


@pytest.mark.parametrize("side", [0, pytest.param(1, marks=pytest.mark.long)])
def test_an_interval_includes_the_uncertainty_of_the_calibration(subject: Subject, side: int) -> None:
    """Rationale: stiffness, area and how strongly readings fall with blood are hardly identified each by itself: one
    compensates for another; the force is resolved. Expected: readings of a held touch, estimated with calibrations in
    error along every direction of the covariance, scatter as the interval has it.
    """
    held = np.zeros(2)
    held[side] = PARTS[3] * subject.person.closure_n_per_cm2()[side]
    read, rest_v = risen_v(subject, held), subject.rest_v
    led = subject.light.same_led() * rest_v[:, None] * subject.noise.led_drift_per_min
    own = (subject.noise.drift_per_min * rest_v) ** 2 + subject.readings.noise_v**2
    white = np.linalg.inv(np.linalg.cholesky(np.diag(own) + led @ led.T))

    def force_n(calibration: Subject) -> float:
        def off(pressure: np.ndarray) -> np.ndarray:
            return np.concatenate(
                [white @ (risen_v(calibration, pressure) - read), (pressure - held) / PRESSURE_PRIOR_N_PER_CM2]
            )

        who = calibration.person
        result = least_squares(off, held, x_scale=0.1, diff_step=1e-3, xtol=1e-12, ftol=1e-12)
        return float(result.x[side] * who.area_cm2 * (who.proximal_area if side == 0 else 1.0))

    values, vectors = np.linalg.eigh(subject.covariance)
    each = (vectors * np.sqrt(np.maximum(values, 0.0))).T
    calibrated_n = force_n(subject)
    stderr_n = float(np.sqrt(sum((force_n(other(subject, off)) - calibrated_n) ** 2 for off in each)))
    estimate = PressureEstimate(held, 1e-14 * np.eye(2), 0.0, 0.0, len(read), False, True)
    estimated = ForceInterval(subject).estimate(stacked([estimate]))
    # The interval's slopes are of finite steps: where errors all but cancel, a hundredth of the area's is left.
    area = NAMES.index("contact_area")
    rounding_n = 0.02 * calibrated_n * float(np.sqrt(subject.covariance[area, area]))
    wide_n = float(estimated.force_high_n[0] - estimated.force_low_n[0]) / (2 * Z95)
    assert wide_n == pytest.approx(INTERVAL_SCALE * stderr_n, rel=0.1, abs=rounding_n)

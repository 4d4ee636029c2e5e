"""What a calibration leaves open of a force: as wide as readings told by other persons of its covariance come out."""

from dataclasses import replace

import made_sensor
import numpy as np
import pytest
from scipy.optimize import least_squares

from nailoptics.hemodynamics.steady import solve_walls
from nailoptics.statistics import Z95
from nailoptics.studies.force.kalman import PressureEstimate
from nailoptics.studies.force.person import NAMES, touch_on_walls, vessel_closure
from nailoptics.studies.force.state_space import LINEAR, CalibratedSensor
from nailoptics.studies.force.subject import Subject, parse_subject
from nailoptics.studies.force.uncertainty import INTERVAL_SCALE, PARTS, PRESSURE_PRIOR, no_correction

# So small a part of the covariance moves readings in proportion.
PART = 1e-4


@pytest.fixture(scope="module")
def subject() -> Subject:
    found = parse_subject(made_sensor.subject())
    return replace(found, covariance=PART * found.covariance, coverage_factor=1.0, correction=no_correction())


def risen_v(one: CalibratedSensor, pressure: np.ndarray) -> np.ndarray:
    """Volts of every reading over those at rest under held pressures (2,)."""
    who = one.make(one.factors_ln)
    ends = np.array(who.arterial_pa), np.array(who.venous_pa)
    held, _ = solve_walls(who.walls, touch_on_walls(pressure, who.distal_reach), *ends)
    at = np.stack([who.blood(held / who.rest_m), who.blood(np.ones(3))], axis=1)
    return np.asarray(one.gain * np.diff(one.table.volts(at)[:, ::-1])[:, 0])


def other(one: CalibratedSensor, off: np.ndarray) -> CalibratedSensor:
    """The calibration that is off by this much."""
    factors, gain, offset_v, *slopes = np.split(off, len(NAMES) + len(one.gain) * np.arange(LINEAR))
    steeper = np.stack(slopes, axis=1) / one.gain[:, None]
    table = one.table.steeper(steeper, float(one.make(one.factors_ln).rest_blood))
    return replace(one, table=table, factors_ln=one.factors_ln + factors, gain=one.gain + gain)


@pytest.mark.parametrize("side", [0, pytest.param(1, marks=pytest.mark.long)])
def test_an_interval_is_as_wide_as_what_the_calibration_leaves_open(subject: Subject, side: int) -> None:
    """Rationale: stiffness, area and how strongly readings fall with blood are hardly known each by itself: one makes
    up for another; the force is known. Expected: readings of a held touch, told by calibrations off along every
    direction of the covariance, spread as the interval says.
    """
    one, shut = subject.sensor, vessel_closure(subject.person())
    held = np.zeros(2)
    held[side] = PARTS[3] * (shut.proximal, shut.distal)[side]
    read = risen_v(one, held)
    rest_v = one.gain * one.table.volts(np.full((2, 1), float(subject.person().rest_blood)))[:, 0]
    led = one.table.same_led() * rest_v[:, None] * subject.noise.led_drift_per_min
    own = (subject.noise.drift_per_min * rest_v) ** 2 + subject.noise.reading_v**2
    white = np.linalg.inv(np.linalg.cholesky(np.diag(own) + led @ led.T))

    def force_n(told_by: CalibratedSensor) -> float:
        def off(pressure: np.ndarray) -> np.ndarray:
            return np.concatenate([white @ (risen_v(told_by, pressure) - read), (pressure - held) / PRESSURE_PRIOR])

        who = told_by.make(told_by.factors_ln)
        found = least_squares(off, held, x_scale=0.1, diff_step=1e-3, xtol=1e-12, ftol=1e-12)
        return float(found.x[side] * who.area_cm2 * (who.proximal_area if side == 0 else 1.0))

    values, vectors = np.linalg.eigh(one.covariance)
    each = (vectors * np.sqrt(np.maximum(values, 0.0))).T
    known_n = force_n(one)
    stderr_n = float(np.sqrt(sum((force_n(other(one, off)) - known_n) ** 2 for off in each)))
    estimate = PressureEstimate(held, 1e-14 * np.eye(2), 0.0, 0.0, len(read), False)
    told = subject.force_interval().of([estimate])
    # The interval's slopes are of finite steps: where errors all but cancel, a hundredth of the area's is left.
    area = NAMES.index("contact_area")
    rounding_n = 0.02 * known_n * float(np.sqrt(one.covariance[area, area]))
    wide_n = float(told.high_n[0] - told.low_n[0]) / (2 * Z95)
    assert wide_n == pytest.approx(INTERVAL_SCALE * stderr_n, rel=0.1, abs=rounding_n)

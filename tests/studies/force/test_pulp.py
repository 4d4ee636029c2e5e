"""The creep of a person's pulp: estimated by calibration where the scene does not state it."""

import re

import made_sensor
import numpy as np
import pytest

from nailoptics import load_scene
from nailoptics.assets import data_dir
from nailoptics.errors import InputError
from nailoptics.hemodynamics import relaxing_pressure, spreading_pressure
from nailoptics.studies.force import person
from nailoptics.studies.force.calibrate import calibrate_with
from nailoptics.studies.force.kalman import TOUCH, StateSpace
from nailoptics.studies.force.person import USUAL_PULP, Pulp
from nailoptics.studies.force.subject import parse_subject


@pytest.mark.long
@pytest.mark.parametrize(("creep", "recovery_s"), [(0.25, 0.3), (0.0, 0.05)])
def test_calibration_estimates_the_pulp_that_the_scene_does_not_state(creep: float, recovery_s: float) -> None:
    scene, pulp = load_scene(data_dir("scenes") / "prototype.toml"), Pulp(creep, USUAL_PULP.creep_s, recovery_s)
    assert scene.touch.creep is None and scene.touch.distal_relaxation_s is None
    # The distal pulp, which recovers slowly, is felt by a distal touch alone.
    recording = made_sensor.record(made_sensor.cycle(1.5), "distal", seed=1, pulp=pulp)
    subject = parse_subject(calibrate_with(scene, made_sensor.table(), [recording]).attrs["subject"])
    result, spread = subject.person, {name: one["stderr"] for name, one in subject.factor_table().items()}
    # A factor on what is usual reaches no further down than an eighth.
    least = 1 / 8
    reached, usual = max(creep, least * USUAL_PULP.creep), USUAL_PULP
    assert result.creep == pytest.approx(reached, abs=max(0.01, 3 * usual.creep * spread["creep"]))
    assert result.recovery_s == pytest.approx(
        recovery_s, abs=max(0.01, 3 * usual.recovery_s * spread["distal_recovery"])
    )
    assert spread["creep"] < 0.5 and spread["distal_recovery"] < 0.5


def test_what_the_scene_states_of_the_pulp_is_kept() -> None:
    scene, subject = made_sensor.scene(), parse_subject(made_sensor.subject())
    assert subject.person.creep == scene.touch.creep
    assert subject.person.recovery_s == scene.touch.distal_relaxation_s


@pytest.mark.parametrize("value", ["[]", "[1.0, 2.0]"])
@pytest.mark.parametrize("name", ["creep", "creep_s", "recovery_s"])
def test_a_subjects_pulp_that_is_no_number_is_refused(name: str, value: str) -> None:
    text = re.sub(rf"^{name} = .*$", f"{name} = {value}", made_sensor.subject(), flags=re.M)
    with pytest.raises(InputError, match="is not a valid subject file"):
        parse_subject(text)


def test_many_people_side_by_side_are_each_by_itself() -> None:
    time_s, touch = np.linspace(0.0, 4.0, 41), np.zeros((2, 3, 41))
    touch[:, :, 5:25] = 1.0
    parts, times = np.array([0.0, 0.1, 0.4]), np.array([0.0, 0.2, 0.5])
    spread = spreading_pressure(time_s, touch, part=parts, time_constant_s=2.0)
    left = relaxing_pressure(time_s, touch, relaxation_s=times)
    for k in range(3):
        alone = spreading_pressure(time_s, touch[:, k], part=parts[k], time_constant_s=2.0)
        np.testing.assert_array_equal(spread[:, k], alone)
        np.testing.assert_allclose(left[:, k], relaxing_pressure(time_s, touch[:, k], relaxation_s=times[k]), atol=1e-8)


@pytest.mark.parametrize("damping", [1.0, 8.0])
def test_pieces_of_time_walked_side_by_side_are_one_walk(monkeypatch: pytest.MonkeyPatch, damping: float) -> None:
    """The one walk is a single piece, stepped from sample to sample."""
    factors_ln = np.zeros((len(person.NAMES), 3))
    factors_ln[[person.NAMES.index(name) for name in ("vein_damping", "capillary_damping")]] = np.log(damping)
    who = person.nominal_finger(made_sensor.scene()).person(factors_ln)
    time_s = np.concatenate([np.arange(0.0, 30.0, 0.04), np.arange(30.0, 60.0, 0.5)])
    # Held, quick and hard touches, one of them through a cut.
    force_n = 0.6 * (np.sin(time_s) > 0.3) + 3.0 * (np.sin(0.31 * time_s) > 0.9)
    pressure = who.pressures_n_per_cm2(force_n, np.where(time_s % 20.0 < 10.0, 1.0, 0.0))
    pieces = who.diameters_over(time_s, pressure)
    monkeypatch.setattr(person, "PIECE_S", np.inf)
    whole = who.diameters_over(time_s, pressure)
    assert np.ptp(whole) > 0.3
    np.testing.assert_allclose(pieces, whole, rtol=3 * person.CONVERGED)


def test_the_filters_pulp_relaxes_to_the_pressure_within_its_time() -> None:
    """Expected: nothing in no time, all but 1 / e of the way in its time constant, and two steps are one."""
    model = StateSpace(parse_subject(made_sensor.subject()))
    state, before, touch = np.zeros(model.size), np.array([0.1, 0.5]), np.array([1.0, 2.0])
    state[TOUCH] = touch
    creep_s = float(np.ravel(model.person.creep_s)[0])
    assert model.relax(state, before, 0.0) == pytest.approx(before)
    assert model.relax(state, before, creep_s) == pytest.approx(touch + (before - touch) / np.e, abs=1e-4)
    half = model.relax(state, before, creep_s / 2)
    assert model.relax(state, half, creep_s / 2) == pytest.approx(model.relax(state, before, creep_s))

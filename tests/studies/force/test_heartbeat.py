"""The observer's heartbeat: a limit cycle of true slopes and of the calibration's height, and what it does to blood."""

import numpy as np
import pytest

from nailoptics.hemodynamics import parameters
from nailoptics.hemodynamics.steady import solve_walls
from nailoptics.studies.force.heartbeat import Beat, PulsedBlood
from nailoptics.studies.force.network import touch_on_walls
from nailoptics.studies.force.person import person

BEAT = Beat(1.1, (400.0, 200.0, 90.0), 0.1)


def test_the_slopes_are_those_of_the_step() -> None:
    state = np.array([0.05, 300.0, -500.0, 120.0, 210.0, -80.0, 60.0])
    after, slopes, _ = BEAT.go_on(state, 0.01)
    reach = 1e-4 * np.maximum(np.abs(state), 1.0)
    moved = [BEAT.go_on(state + one, 0.01)[0] - BEAT.go_on(state - one, 0.01)[0] for one in np.diag(reach)]
    assert np.array(moved).T / (2 * reach) == pytest.approx(slopes, rel=1e-5, abs=1e-6)
    assert after.shape == state.shape


def test_a_beat_turns_at_its_rate_and_comes_back_to_its_height() -> None:
    height = np.sqrt(2) * np.array(BEAT.rms_pa)
    state = np.concatenate([[0.0], (0.5 * height[:, None] * [1.0, 0.0]).ravel()])
    for _ in range(int(60 / 0.01)):
        state = BEAT.go_on(state, 0.01)[0]
    found = np.hypot(*state[1:].reshape(-1, 2).T)
    assert found == pytest.approx(height, rel=0.01)
    # 66 whole beats.
    assert state[1:].reshape(-1, 2)[:, 1] == pytest.approx(0.0, abs=0.01 * height[0])


def test_what_comes_in_between_delays_all_harmonics_together() -> None:
    state = np.array([0.0, 500.0, 0.0, 250.0, 0.0, 100.0, 0.0])
    after, _, noise = BEAT.go_on(state, 0.01)
    across = np.arange(2, 7, 2)
    deviation = np.sqrt(np.diag(noise)[across])
    alike = noise[np.ix_(across, across)] / np.outer(deviation, deviation)
    assert alike.min() > 0.8
    # Intervals of a second that scatter by 5 % move the phase of the first harmonic by 0.31 radians a beat.
    height = np.hypot(after[1], after[2])
    assert deviation[0] / height == pytest.approx(2 * np.pi * 0.05 * np.sqrt(1.1 * 0.01), rel=0.1)


def test_a_beat_that_is_far_too_high_comes_back_too() -> None:
    state = np.concatenate([[0.0], 1e4 * np.array(BEAT.rms_pa).repeat(2)])
    for _ in range(int(100 / 0.05)):
        before, state = state, BEAT.go_on(state, 0.05)[0]
        assert (np.hypot(*state[1:].reshape(-1, 2).T) < 1.01 * np.hypot(*before[1:].reshape(-1, 2).T)).all()
    assert np.hypot(*state[1:].reshape(-1, 2).T) == pytest.approx(np.sqrt(2) * np.array(BEAT.rms_pa), rel=0.01)


def test_harmonics_that_samples_do_not_show_are_not_followed() -> None:
    # Half of 10 Hz is 5 Hz, of which 3.75 Hz are used; a third harmonic of 1.1 Hz reaches up to 3.7 Hz.
    assert BEAT.seen(0.1).tolist() == [True, True, True]
    assert Beat(1.1, (1.0,) * 5, 0.1).seen(0.1).tolist() == [True, True, True, False, False]
    assert not BEAT.seen(1.0).any()


@pytest.mark.parametrize("touch", [(0.0, 0.0), (0.25, 0.0), (0.0, 0.4), (0.13, 0.31)])
def test_a_beat_moves_the_blood_as_a_slow_change_of_the_pressure_does(touch: tuple[float, float]) -> None:
    who = person(parameters("best"), {"distal_reach": 1.5}, rest_blood=0.03, area_cm2=1.0, share=0.5, distal_reach=0.2)
    highest = np.array([1.0, 2.0])
    pulsed, held = PulsedBlood(who, highest), np.array(touch)

    def blood(touch: np.ndarray, higher_pa: float) -> np.ndarray:
        outside = touch_on_walls(touch[:, None], who.distal_reach)
        width, _ = solve_walls(who.walls, outside, np.array([who.arterial_pa + higher_pa]), np.array([who.venous_pa]))
        return who.blood(width / who.rest_m[:, None])[:, 0]

    part, by_touch = pulsed.part(held)
    # Straight between pressures an eighth of the highest apart.
    assert part == pytest.approx((blood(held, 10.0) - blood(held, -10.0)) / 20.0 / blood(held, 0.0), rel=0.03)
    step = 1e-4
    moved = [(pulsed.part(held + one)[0] - pulsed.part(held)[0]) / step for one in step * np.eye(2)]
    assert np.array(moved).T == pytest.approx(by_touch, rel=1e-6)
    # Past the highest it stays.
    assert pulsed.part(2 * highest)[0] == pytest.approx(pulsed.part(highest)[0], rel=0.01)

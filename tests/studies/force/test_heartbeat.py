"""What a heartbeat does to blood under a touch."""

import numpy as np
import pytest
from made_sensor import nominal_finger

from nailoptics.hemodynamics import parameters
from nailoptics.studies.force.person import NAMES, PulsatileGain


@pytest.mark.parametrize("touch", [(0.0, 0.0), (0.25, 0.0), (0.0, 0.4), (0.13, 0.31)])
def test_a_beat_moves_the_blood_as_a_slow_change_of_the_pressure_does(touch: tuple[float, float]) -> None:
    factors_ln = np.where(np.array(NAMES) == "distal_reach", np.log(1.5), 0.0)
    who = nominal_finger(parameters("best"), distal_reach=0.2).person(factors_ln)
    highest = np.array([1.0, 2.0])
    pulsed, held = PulsatileGain(who, highest), np.array(touch)

    def blood(touch: np.ndarray, higher_pa: float) -> np.ndarray:
        return who.blood(who.steady_diameters(touch[:, None], higher_pa))[:, 0]

    part, by_touch = pulsed.at(held)
    # Straight between pressures an eighth of the highest apart.
    assert part == pytest.approx((blood(held, 10.0) - blood(held, -10.0)) / 20.0 / blood(held, 0.0), rel=0.03)
    step = 1e-4
    moved = [(pulsed.at(held + one)[0] - pulsed.at(held)[0]) / step for one in step * np.eye(2)]
    assert np.array(moved).T == pytest.approx(by_touch, rel=1e-6)
    # Past the highest it stays.
    assert pulsed.at(2 * highest)[0] == pytest.approx(pulsed.at(highest)[0], rel=0.01)

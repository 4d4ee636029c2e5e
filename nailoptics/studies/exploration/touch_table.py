"""What a held force does to the blood, and how the body moves it meanwhile, over a row of forces."""

from typing import Any

import numpy as np

from ...hemodynamics.for_scene import largest_force_n, touch_areas_mm2, touch_pressures_pa
from ...scene import Scene
from ...sensor.information import PRIOR_PA, operating_point
from ...sensor.physiological_noise import LIFT_PER_UM
from ..placement import boards

# Forces at which the blood is computed, denser where it changes more, up to this or a quarter beyond the scene's touch.
FORCES, LEAST_REACH_N = 33, 4.0


def touch_table(scene: Scene) -> dict[str, Any]:
    """Blood of both zones in parts of that at rest, its change with both pressures, and the body's noise, by force.

    All blood goes with that at rest, so that each is per unit of it.
    """
    reach_n = max(LEAST_REACH_N, 1.25 * largest_force_n(scene))
    force_n = reach_n * np.linspace(0.0, 1.0, FORCES) ** 1.5
    since_rest_s = boards.rules(scene).since_rest_s
    points = [operating_point(scene, float(force), since_rest_s=since_rest_s) for force in force_n]
    rest = scene.blood.rest_blood_fraction
    waves = [np.zeros((2, 2)) if p.body is None else p.body.blood @ p.body.blood.T for p in points]
    body, minutes = scene.body, since_rest_s / 60
    drift, motion = (body.drift, body.motion) if body else (None, None)
    return {
        "force_n": force_n,
        "blood": np.array([p.blood_fraction for p in points]) / rest,
        "blood_per_pa": np.array([p.blood_per_pa for p in points]) / rest,
        "waves": np.array(waves) / rest**2,
        "force_per_pa": np.array(touch_areas_mm2(scene)) * 1e-6,
        "pressure_per_n": np.array(touch_pressures_pa(scene, 1.0)),
        "prior_pa": PRIOR_PA,
        "has_body": points[0].body is not None,
        "led_drift": drift.led_per_rt_min * np.sqrt(minutes) if drift else 0.0,
        "reading_drift": drift.reading_per_rt_min * np.sqrt(minutes) if drift else 0.0,
        "lift": LIFT_PER_UM * motion.lift_um if motion else 0.0,
    }

"""What the body adds to readings while a touch is held: waves of both zones' blood, drift and motion of the sensor."""

from dataclasses import dataclass

import numpy as np

from ..checks import Array
from ..hemodynamics.for_scene import blood_by_arterial_pressure
from ..hemodynamics.waves import pressure_lines
from ..scene import Scene
from ..scene.body import Drift
from ..statistics import covariance_root

# By how much all readings of a board change with a micrometre more between it and the nail. On the prototype, traced,
# those 1.5 mm from the LED fall by 0.0014 (+- 0.0002), those beyond 2 mm by less than 0.0005; here all alike. [1/um]
LIFT_PER_UM = 0.001


@dataclass(frozen=True)
class PhysiologicalNoise:
    """What the body adds to one sample of all readings at a steady touch.

    blood : (2, 2) float. Excursions of the proximal and distal zone's blood, in columns: two independent ones, each
        as large as its standard deviation. Their outer products add up to the covariance of both zones' blood. [1]
    led_gain : (leds, leds) float. Relative changes of all readings of an LED, a row for each LED, in columns likewise.
    reading_gain : float. Relative change of each reading by itself, rms.
    """

    blood: Array
    led_gain: Array
    reading_gain: float

    def shapes_v(self, zone_v: Array, light_v: Array, led: int) -> Array:
        """What each of the body's shapes adds, rms, to readings of an LED, (..., k) float. [V]

        zone_v : (..., 2) float. Their change with the blood of either zone. light_v : (...) float. Their light. [V]
        """
        return np.concatenate([zone_v @ self.blood, light_v[..., None] * self.led_gain[led]], -1)


def physiological_noise(scene: Scene, force_n: float, *, since_rest_s: float) -> PhysiologicalNoise | None:
    """The body's noise while a force is held; None where the scene has no body, or one that is still.

    since_rest_s : for so long readings have drifted. [s]

    Drift and lift of the sensor move all readings of an LED alike, as parts of themselves. A slide along the nail is
    left out: on the prototype it moves no reading by more than 1e-4 in a micrometre.
    """
    body = scene.body
    if body is None or not (body.moves or body.drift or body.motion):
        return None
    drift, motion, minutes = (
        body.drift or Drift(led_per_rt_min=0.0, reading_per_rt_min=0.0),
        body.motion,
        since_rest_s / 60,
    )
    each, all_leds = drift.led_per_rt_min * np.sqrt(minutes), LIFT_PER_UM * (motion.lift_um if motion else 0.0)
    leds = len(scene.leds)
    return PhysiologicalNoise(
        blood=covariance_root(_blood_covariance(scene, force_n) if body.moves else np.zeros((2, 2))),
        led_gain=covariance_root(each**2 * np.eye(leds) + all_leds**2),
        reading_gain=float(drift.reading_per_rt_min * np.sqrt(minutes)),
    )


def _blood_covariance(scene: Scene, force_n: float) -> Array:
    """Covariance of both zones' blood by waves of the arterial pressure, (2, 2) float.

    They reach the blood through the network, each with the gain G of its frequency: the sum of G G^H times their
    variances. Waves faster than the stage's bandwidth are left out, as its noise is.
    """
    assert scene.body is not None
    frequency_hz, variance_pa2 = pressure_lines(scene.body)
    slow = frequency_hz <= scene.electronics.bandwidth_hz
    gain = blood_by_arterial_pressure(scene, frequency_hz[slow], force_n)
    return np.asarray(np.real(np.einsum("if,f,jf->ij", gain, variance_pa2[slow], gain.conj())))

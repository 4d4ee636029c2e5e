"""Pulsatile blood: one beat of the blood in the bed's zones while a force is held."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..hemodynamics.for_scene import blood_over_touch, force_course
from ..scene import Body, Scene, Touch
from ..scene.oximeter import two_leds

Array = NDArray[np.float64]

# Of one beat: its extremes are missed by less than 0.3 % of the pulse.
SAMPLES_PER_BEAT = 64
CONTACT = ("contact_area_mm2", "proximal_share", "proximal_area_mm2", "distal_area_mm2")


@dataclass(frozen=True)
class BloodBeat:
    """One beat of the blood in the bed.

    time_s : (t,) float. From the start of the beat. [s]
    blood_fraction : (zones, t) float. [1]
    """

    time_s: Array
    blood_fraction: Array

    @property
    def resting(self) -> Array:
        """Mean blood of each zone, (zones,) float."""
        return np.asarray(self.blood_fraction.mean(1))

    @property
    def pulse(self) -> Array:
        """Blood of each zone over its mean, (t, zones) float."""
        return np.asarray((self.blood_fraction - self.blood_fraction.mean(1, keepdims=True)).T)

    @property
    def extremes(self) -> Array:
        """The pulse when all zones together hold least blood and when they hold most, (2, zones) float."""
        total = self.blood_fraction.sum(0)
        return self.pulse[[int(total.argmin()), int(total.argmax())]]


def red_and_infrared(scene: Scene) -> tuple[int, int]:
    """The numbers of a scene's red and infrared LED; raises InputError without two of different wavelengths."""
    try:
        return two_leds(scene.leds, scene.oximeter.slots if scene.oximeter else None)
    except ValueError as error:
        raise InputError(f"leds: {error}.") from None


def oximeter_leds(scene: Scene) -> tuple[int, int]:
    """The numbers of a scene's red and infrared LED.

    Raises: InputError for a scene without a finger, a pulse, or two LEDs of different wavelengths.
    """
    if scene.finger is None:
        raise InputError("oximeter needs a [finger] scene, whose blood beats; a [phantom] has none.")
    leds = red_and_infrared(scene)
    heart_rate_per_min(scene)
    return leds


def heart_rate_per_min(scene: Scene) -> float:
    """Beats in a minute of a scene's heart.

    Raises: InputError where it does not beat.
    """
    heart = scene.body.heartbeat if scene.body else None
    if heart is None or heart.pulse_pressure_pa == 0:
        what = "a heart without a pulse" if heart else "no [body.heartbeat]"
        raise InputError(
            f"body: the scene has {what}, and without a pulse the arterial saturation cannot be measured; "
            "give [body.heartbeat] with pulse_pressure_pa above 0, such as 2000."
        )
    return heart.rate_per_min


def rest_force_n(scene: Scene) -> float:
    """The force with which a scene's touch begins, under which its oximeter is read. [N]"""
    return float(force_course(scene)[1][0])


def rest_beat(scene: Scene) -> BloodBeat:
    """A beat under the force with which the scene's touch begins."""
    return beat_at(scene, rest_force_n(scene))


def beat_at(scene: Scene, force_n: float) -> BloodBeat:
    """A beat of the scene's heart, always alike, while a force is held where its touch presses.

    Breathing and vasomotion are left out: what is slower than a beat is no part of a pulse.

    Raises: InputError where the heart does not beat.
    """
    rate = heart_rate_per_min(scene)
    assert scene.body is not None and scene.body.heartbeat is not None
    even = Body(heartbeat=scene.body.heartbeat.model_copy(update={"rate_variability": 0.0}))
    held = Touch(
        profile="hold",
        force_n=force_n,
        duration_s=60.0 / rate,
        sample_rate_hz=SAMPLES_PER_BEAT * rate / 60.0,
        **{name: getattr(scene.touch, name) for name in CONTACT},
    )
    return _beat(scene.model_copy(update={"touch": held, "body": even, "placement": None}))


@lru_cache(64)
def _beat(scene: Scene) -> BloodBeat:
    beat = blood_over_touch(scene).isel(time=slice(0, SAMPLES_PER_BEAT))
    return BloodBeat(beat.time.values, beat.blood_fraction.values)

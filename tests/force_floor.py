"""The least error of force by a calibration without error: people who are the fitted model, with their own bodies.

What is left is the body's own noise: heartbeat, breathing, vasomotion and drift move the readings as touches do.
"""

from dataclasses import replace

import numpy as np
from force_scores import VirtualPerson, required_samples
from record import TOUCHES, Site, touch_of

from nailoptics.hemodynamics import cardiac_pressure
from nailoptics.hemodynamics.for_scene import blood_model
from nailoptics.hemodynamics.waves import CardiacOscillator, DampedOscillator
from nailoptics.scene import Scene
from nailoptics.scene.body import Heartbeat
from nailoptics.scene.importers.sensor_recordings import SITES, Recording
from nailoptics.sensor.volts import drift_and_motion
from nailoptics.studies.force.body_noise import HARMONICS, HEIGHT_SPREAD, pressure_to_blood_gain
from nailoptics.studies.force.person import Person
from nailoptics.studies.force.predict import predict
from nailoptics.studies.force.subject import Subject

# Steps of derivatives by pressures [N/cm^2, N/cm^2, Pa], and the prior of the touch's.
STEPS, TOUCH_SPREAD = np.array([0.01, 0.01, 50.0]), 0.5
# The slow waves of a body fill the band about their middle: so long they keep their phase. [s]
SLOW_COHERENCE_S, BREATH_COHERENCE_S = 4.0, 30.0


def exactly_calibrated(subject: Subject, scene: Scene) -> Subject:
    """The subject as if calibration had left nothing open, with the noise of a scene's body."""
    body, noise = scene.body, subject.noise
    assert body is not None
    slow, breath, drift = body.vasomotion, body.breathing, body.drift
    waves = []
    if slow is not None:
        waves.append(DampedOscillator(sum(slow.band_hz) / 2, SLOW_COHERENCE_S, slow.amplitude_pa))
    if breath is not None:
        rms_pa = breath.amplitude_pa / np.sqrt(2)
        waves.append(DampedOscillator(breath.rate_per_min / 60.0, BREATH_COHERENCE_S, rms_pa))
    own = replace(
        noise,
        waves=tuple(waves),
        beat=None if body.heartbeat is None else _beat(body.heartbeat, subject.person),
        drift_per_min=drift.reading_per_rt_min if drift else 1e-6,
        led_drift_per_min=drift.led_per_rt_min if drift else 1e-6,
        dynamic_error=0.0,
        static_error=0.0,
    )
    nothing = np.zeros_like(subject.covariance)
    return replace(subject, noise=own, covariance=nothing, ensemble=None)


def _beat(heart: Heartbeat, who: Person) -> CardiacOscillator:
    """The filter's model of a heart that beats evenly: what the vessels at rest pass on of it."""
    rate_hz = heart.rate_per_min / 60.0
    course = cardiac_pressure(
        np.arange(256) / (256 * rate_hz), pulse_pressure_pa=heart.pulse_pressure_pa, rate_per_min=heart.rate_per_min
    )
    rms_pa = np.abs(np.fft.rfft(course))[1 : 1 + HARMONICS] / 256 * np.sqrt(2)
    reach = [pressure_to_blood_gain(who, k * rate_hz) for k in range(1, 1 + HARMONICS)]
    return CardiacOscillator(rate_hz, tuple((rms_pa * reach).tolist()), HEIGHT_SPREAD)


def modelled(subject: Subject, scene: Scene, touch: Recording, *, seed: int) -> Recording:
    """What the subject's sensor would read under a recording's touch, were the model the truth.

    scene : whose touch has the recording's times, and whose body moves the readings.
    """
    assert touch.force_n is not None and touch.site is not None and scene.body is not None
    body = scene.model_copy(update={"body": scene.body.model_copy(update={"seed": seed})})
    who, time_s = subject.person, touch.time_s
    high = blood_model(body).body_waveforms().get("arterial_pressure_pa")
    arterial_pa = who.arterial_pa + (0.0 if high is None else high.at(time_s) - high.at(time_s).mean())
    pressure = who.pressures_n_per_cm2(touch.force_n, touch.site)
    blood = who.blood(who.diameters_over(time_s, pressure, arterial_pa=np.broadcast_to(arterial_pa, time_s.shape)))
    volts = subject.readings.offset_v[:, None] + subject.readings.gain[:, None] * subject.light.volts(blood)
    worn = drift_and_motion(body, time_s)
    if "led_drift" in worn:
        volts = volts * (worn.led_drift.values[:, None] * worn.reading_drift.values).reshape(volts.shape)
    noise = np.random.default_rng(seed).normal(size=volts.shape)
    return replace(touch, volts=volts + subject.readings.noise_v[:, None] * noise)


def floor_n(subject: Subject, person: VirtualPerson, kind: str, site: Site, *, seed: int = 3) -> float:
    """Rms error of some touches by a calibration without error. [N]"""
    touch = person.recording(kind, site, seed=1)
    played = touch_of(person.scene, TOUCHES[kind], site, person.rate_hz)
    recording = modelled(subject, person.scene.model_copy(update={"touch": played}), touch, seed=seed)
    known, requested = exactly_calibrated(subject, person.scene), required_samples(kind, touch.time_s)
    result = predict(known, recording)
    return float(np.sqrt(np.mean((result.force_n - result.known_force_n).values[requested] ** 2)))


def one_sample_n(subject: Subject, site: Site, force_n: float) -> float:
    """Standard error of a held touch estimated from one sample (Cramer-Rao), the person calibrated without error. [N]

    Its noise is that of the readings, half a minute of drift, and the slow waves of the arterial pressure as
    calibrated: a heartbeat is averaged out. Only samples before and after can determine the touch better.
    """
    who, rest_v, gain = subject.person, subject.rest_v, subject.readings.gain
    held = np.append(who.pressures_n_per_cm2(np.array([force_n]), np.array([SITES[site]]))[:, 0], 0.0)
    places = np.repeat(held[:, None], 6, axis=1)
    places[range(3), range(3)] += STEPS
    places[range(3), range(3, 6)] -= STEPS
    places[:2] = np.maximum(places[:2], 0.0)
    volts = gain[:, None] * subject.light.volts(who.blood(who.steady_diameters(places[:2], places[2])))
    slopes = (volts[:, :3] - volts[:, 3:]) / (places[range(3), range(3)] - places[range(3), range(3, 6)])
    drift = np.outer(rest_v, rest_v) * subject.drift_covariance
    information = slopes.T @ np.linalg.solve(np.diag(subject.readings.noise_v**2) + 0.5 * drift, slopes)
    slow2_pa2 = sum(wave.rms_pa**2 for wave in subject.noise.waves)
    known = np.linalg.inv(information + np.diag([TOUCH_SPREAD**-2, TOUCH_SPREAD**-2, 1.0 / slow2_pa2]))
    area_cm2 = float(who.area_cm2 * (who.proximal_area if site == "proximal" else 1.0))
    return area_cm2 * float(np.sqrt(known[0, 0] if site == "proximal" else known[1, 1]))

"""The prototype's board on other fingers: worn, touched as for the error over touches, and calibrated without error."""

from typing import Any

import numpy as np

from nailoptics import load_scene
from nailoptics.assets import data_dir
from nailoptics.scene import Scene
from nailoptics.scene.importers.sensor_recordings import Recording
from nailoptics.studies.force.person import NAMES, USUAL_DISTAL_REACH, USUAL_PULP, nominal_finger
from nailoptics.studies.force.reading_table import ReadingTable
from nailoptics.studies.force.subject import LINEAR, Quality, Readings, Subject
from nailoptics.studies.force.touch_error import RATE_HZ, TouchError

Wired = tuple[tuple[int, ...], tuple[int, ...]]
# Distance of the paper's photodiodes from the LED, and which of their elements are wired. [mm]
PAPER_MM, PAPER_WIRED = 2.0, ((6, 8, 10, 12), (3, 5, 7, 9))


def worn(scene: Scene, v_mm: float = PAPER_MM, wired: Wired = PAPER_WIRED) -> Scene:
    """The prototype's board on the finger of a scene, its photodiodes so far from the LED, without arterioles and with
    the pulp that the filter takes as default, both stated."""
    prototype = load_scene(data_dir("scenes") / "prototype.toml")
    assert scene.body is not None and scene.body.heartbeat is not None
    heart = scene.body.heartbeat.model_copy(update={"arteriolar_blood_fraction": 0.0})
    pulp = {"creep": USUAL_PULP.creep, "distal_relaxation_s": USUAL_PULP.recovery_s}
    photodiodes = tuple(
        photodiode.model_copy(update={"position_mm": (0.0, at_mm), "wired": elements})
        for photodiode, at_mm, elements in zip(prototype.photodiodes, (-v_mm, v_mm), wired, strict=True)
    )
    return prototype.model_copy(
        update={
            "finger": scene.finger,
            "blood": scene.blood.model_copy(update={"distal_reach": USUAL_DISTAL_REACH}),
            "touch": scene.touch.model_copy(update=pulp),
            "body": scene.body.model_copy(update={"heartbeat": heart}),
            "electronics": scene.electronics,
            "photodiodes": photodiodes,
        }
    )


def played(touches: TouchError) -> dict[str, Any]:
    """The fields of a scene's [touch] that make these touches."""
    time_s = np.arange(len(touches._force_n)) / RATE_HZ
    return {
        "profile": "recorded",
        "recorded_time_s": tuple(time_s.tolist()),
        "recorded_force_n": tuple(touches._force_n.tolist()),
        "recorded_proximal_share": tuple(touches._proximal.astype(float).tolist()),
        "duration_s": float(time_s[-1]),
        "sample_rate_hz": RATE_HZ,
    }


def computed_n(touches: TouchError, table: ReadingTable) -> float:
    """The error over touches of a sensor with such readings. [N]"""
    volts, by_blood = table.slopes(touches.person.blood(np.ones(2)))
    return float(touches.rms_n(by_blood / volts[:, None], table.noise_v / volts, table.same_led()))


def exactly_calibrated(sensor: Scene, touches: TouchError, table: ReadingTable, recording: Recording) -> Subject:
    """The wearer of a sensor, as by a calibration without error; gains are those of the recording's rest."""
    zero, count = np.zeros(len(table.names)), len(table.names)
    gain = np.median(recording.volts[:, :100], axis=1) / table.volts(touches.person.blood(np.ones(2)))
    return Subject(
        scene_digest="",
        quality=Quality(1.0, rms_n=0.0),
        factors=np.ones(len(NAMES)),
        readings=Readings(gain, zero, zero, gain * table.noise_v),
        noise=touches.noise,
        scene=nominal_finger(sensor),
        light=table,
        covariance=1e-14 * np.eye(len(NAMES) + LINEAR * count),
    )

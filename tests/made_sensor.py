"""A worn sensor whose light is a formula: recordings of the prototype's readings in a second, without a trace."""

from functools import cache
from typing import Any

import numpy as np

from nailoptics import load_scene
from nailoptics.assets import data_dir
from nailoptics.hemodynamics.parameters import Parameters, parameters
from nailoptics.scene import Scene
from nailoptics.scene.importers.sensor_recordings import SITES, Recording
from nailoptics.studies.force.calibrate import calibrate_with
from nailoptics.studies.force.person import NominalFinger, Pulp
from nailoptics.studies.force.reading_table import POWERS, ReadingTable, reading_names

STEP_S = 0.02
MOST_BLOOD = 0.15
RIGID_PULP = Pulp(creep=0.0, creep_s=2.0, recovery_s=0.0)


def scene() -> Scene:
    """The prototype, whose readings these are, on a finger that does not yield."""
    return on_rigid_pulp(load_scene(data_dir("scenes") / "prototype.toml"))


def on_rigid_pulp(scene: Scene) -> Scene:
    """The scene with a pulp that neither spreads nor takes time to recover."""
    return scene.model_copy(
        update={"touch": scene.touch.model_copy(update={"creep": 0.0, "distal_relaxation_s": 1e-3})}
    )


def table() -> ReadingTable:
    """The logarithm of each reading falls in a line with the blood of both zones, most with that below it."""
    names = reading_names(scene())
    near = np.linspace(0.9, 0.1, len(names))
    slopes = -16.0 * np.stack([near, 1.0 - near], 1)
    coefficients = np.zeros((len(names), len(POWERS)))
    coefficients[:, POWERS.index((0, 0))] = np.log(0.5) - 0.03 * slopes.sum(1)
    coefficients[:, POWERS.index((1, 0))] = slopes[:, 0] * MOST_BLOOD
    coefficients[:, POWERS.index((0, 1))] = slopes[:, 1] * MOST_BLOOD
    return ReadingTable(
        ln_volts=dict(zip(names, coefficients, strict=True)),
        dark_v=np.full(len(names), 1e-4),
        most_blood_fraction=MOST_BLOOD,
        slope_stderr=0.01 * np.abs(slopes),
        noise_v=np.full(len(names), 5e-5),
        range_v=5.0,
    )


def nominal_finger(vessels: Parameters, **changes: Any) -> NominalFinger:
    """A finger whose pulp is rigid, and whose two zones share no pressure, but for some changes."""
    usual = {"rest_blood_fraction": 0.03, "contact_area_cm2": 1.0, "proximal_share": 0.5, "distal_reach": 0.0}
    return NominalFinger(**usual | {"pulp": RIGID_PULP, "vessels": vessels} | changes)


@cache
def subject() -> str:
    """A person whom one recording calibrated, as a subject file's text; tests of one worker share it."""
    # Slow enough that the fit averages its samples.
    recording = record(cycle(1.5), "proximal", seed=1)
    return str(calibrate_with(scene(), table(), [recording]).attrs["subject"])


def cycle(most_n: float, *, lasting_s: float = 8.0) -> np.ndarray:
    """Two seconds of rest, and a slow touch. [N]"""
    time_s = np.arange(0.0, lasting_s, STEP_S)
    return most_n * np.where(time_s < 2, 0.0, np.sin(np.pi * (time_s - 2) / (lasting_s - 2)) ** 2)


def touches() -> np.ndarray:
    """Two seconds of rest, and four touches of a second and different force that are let go at once. [N]"""
    time_s = np.arange(0.0, 8.0, STEP_S)
    number, into_s = np.divmod(time_s - 2, 1.5)
    height_n = np.array([0.5, 1.1, 0.3, 0.8])[np.clip(number, 0, 3).astype(int)]
    return height_n * np.where(time_s < 2, 0.0, np.clip(np.minimum(into_s, 1.0 - into_s) / 0.2, 0.0, 1.0))


def record_touches(*, seed: int) -> Recording:
    """What the sensor records of these touches twice, of the proximal side and then of the distal one."""
    force_n = np.tile(touches(), 4)
    return record(force_n, np.repeat([1.0, 0.0], force_n.size // 2), seed=seed)


def record(force_n: np.ndarray, site: str | np.ndarray, *, seed: int, pulp: Pulp = RIGID_PULP) -> Recording:
    """What the sensor records of a force that begins untouched, with noise, on a pulp."""
    own, light = scene(), table()
    time_s = STEP_S * np.arange(force_n.size)
    where = np.full(force_n.shape, SITES[site]) if isinstance(site, str) else site
    who = nominal_finger(parameters(own.blood.parameters), pulp=pulp).person()
    volts = light.volts(who.blood(who.diameters_over(time_s, who.pressures_n_per_cm2(force_n, where))))
    noise = np.random.default_rng(seed).normal(size=volts.shape)
    return Recording("made", light.names, time_s, volts + light.noise_v[:, None] * noise, force_n, where)

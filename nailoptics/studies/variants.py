"""A scene with something else in it, traced or reread, and how far that moves the readings."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pydantic import ValidationError

from .. import hemodynamics
from ..errors import InputError, NotReachedError
from ..light import Progress, Transfer, media, trace
from ..light.reread import course
from ..scene import Scene
from ..scene.files import explain


def revised(scene: Scene, changes: dict[str, dict[str, Any]]) -> Scene:
    """The scene with some fields of some of its tables changed; raises InputError where that makes no scene."""
    tables = scene.model_dump()
    for table, fields in changes.items():
        tables[table] |= fields
    return validated(tables)


def validated(tables: dict[str, Any]) -> Scene:
    """A scene from its tables; raises InputError where they make none."""
    try:
        return Scene.model_validate(tables)
    except ValidationError as error:
        raise InputError(explain(error, Scene)) from None


def without_lines(scene: Scene) -> Scene:
    """The scene with LEDs of one wavelength each."""
    return scene.model_copy(update={"leds": tuple(led.model_copy(update={"fwhm_nm": 0.0}) for led in scene.leds)})


@dataclass(frozen=True)
class Look:
    """Readings of one scene, (led, photodiode) float each.

    level : fraction of the emitted power at rest, weighed by the photodiode's response over the LED's line.
    modulation : change at the largest force, as a part of the reading at rest.
    """

    level: np.ndarray
    level_stderr: np.ndarray
    modulation: np.ndarray
    modulation_stderr: np.ndarray
    transfer: Transfer

    @property
    def relative_stderr(self) -> np.ndarray:
        """Relative standard error of the level; inf where nothing was seen."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.level > 0, self.level_stderr / self.level, np.inf)


def look(
    scene: Scene,
    *,
    seed: int,
    backend: str,
    photons: int | None,
    relative_error: float | None = None,
    max_seconds: float | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> tuple[Look, str | None]:
    """Trace a scene and read it at rest and at its largest force; and why it fell short of what was asked, if so."""
    unmet = None
    try:
        transfer = trace(
            scene,
            photons=photons,
            relative_error=relative_error,
            max_seconds=max_seconds,
            seed=seed,
            backend=backend,
            progress=progress,
        )
    except NotReachedError as error:
        if not isinstance(error.result, Transfer):
            raise
        transfer, unmet = error.result, str(error)
    return read(transfer), unmet


def read(transfer: Transfer) -> Look:
    """Readings of a trace at rest and at the scene's largest force."""
    found = course(transfer, end_states(transfer.scene), electrons=True)
    level = found.fraction[..., 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        modulation = found.change[..., 1] / level
        # The error of the level that divides is that of both states, so most of it cancels; this is the upper side.
        modulation_stderr = np.hypot(found.change_stderr[..., 1], modulation * found.stderr[..., 0]) / level
    return Look(level, found.stderr[..., 0], modulation, modulation_stderr, transfer)


def reread(base: Transfer, scene: Scene) -> Look:
    """Readings of a scene that differs from a traced one only in absorption or LED lines: the same photons."""
    return read(replace(base, scene=scene))


def end_states(scene: Scene) -> np.ndarray:
    """Blood at rest and at the touch's largest force, (2, zones) float."""
    touch, rest = scene.touch, scene.blood.rest_blood_fraction
    largest = max(touch.recorded_force_n) if touch.recorded_force_n else touch.force_n
    parameters = hemodynamics.parameters(scene.blood.parameters)
    proximal, distal = hemodynamics.pressures(np.array([0.0, largest]), touch.contact_area_mm2, touch.proximal_share)
    steady = hemodynamics.steady_state(parameters, proximal_pressure_pa=proximal, distal_pressure_pa=distal)
    blood = hemodynamics.blood_fraction(parameters, steady.capillary_diameter_m, rest_blood_fraction=rest)
    assert blood.shape[0] == media.zones(scene).count
    return np.asarray(blood.T)


def difference(base: Look, other: Look) -> tuple[np.ndarray, np.ndarray]:
    """Relative change of each reading at rest and its error, (led, photodiode) float each; NaN where nothing was seen.

    Of the same photons a change is a mean of factors near 1, whose spread is at most about the change itself.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = other.level / base.level - 1
        if other.transfer.traces is base.transfer.traces:
            return ratio, np.abs(ratio) * base.relative_stderr
        return ratio, error_of_ratio(ratio, base.relative_stderr, other.relative_stderr)


def error_of_ratio(ratio: np.ndarray, *relative_stderr: np.ndarray) -> np.ndarray:
    """Error of a relative change; few photons that happen to be dim must not pass for a sure small reading."""
    return np.asarray(np.maximum(1 + ratio, 1) * np.hypot(*relative_stderr))


def pooled(ratio: np.ndarray, error: np.ndarray, base: Look) -> tuple[float, float]:
    """Mean change over the readings and its error, weighed by the reference's errors; NaN and inf where one is unknown.

    The weights are the same for all that is compared with the reference, so that none is drawn to its own low values.
    """
    if not (np.isfinite(ratio).all() and np.isfinite(error).all()):
        return float("nan"), float("inf")
    weight = base.relative_stderr**-2.0
    weight = weight / weight.sum()
    return float((weight * ratio).sum()), float(np.linalg.norm(weight * error))

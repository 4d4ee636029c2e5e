"""Calibrate a person's sensor with recordings of a known force."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Unpack

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError

from ...checks import explain
from ...errors import InputError, NotReachedError, as_far_as_reached, unless_cut_off
from ...light import ProgressCallback, backend, open_light
from ...light.tracing import StageProgress
from ...options import Requested, TraceOptions
from ...scene import Scene, SceneIn, as_scene, digest, to_toml
from ...scene.importers.sensor_recordings import Recording, read_sensor_recording
from ...variables import variable
from .body_noise import REST_FORCE_N, estimate_noise
from .fit import Fit, Fitted
from .person import NAMES, nominal_finger
from .reading_table import ReadingTable, nodes_of, reading_table
from .recording_checks import checked, joined, lacking
from .scores import TOUCH_N, rms, touches_by_kind
from .subject import Quality, Readings, Subject, subject_toml
from .training import calibration_series, compared, train

# Largest blood of the table of light, over the scene's at rest: pooling doubles it, people differ by two more.
MOST_OVER_REST = 5.0
# Part of a calibration's time that its fit takes.
FITTED = 0.8
# Factors that say how fast vessels refill.
REFILL_FACTORS = ("vein_damping", "capillary_damping")
NO_SUBJECT = "interrupted; no subject was written."


def calibrate(
    scene: SceneIn,
    recordings: Recording | str | Path | Sequence[Recording | str | Path],
    *,
    progress: ProgressCallback | None = None,
    **requested: Unpack[Requested],
) -> xr.Dataset:
    """Fit a person's sensor to recordings of a known force.

    scene : the board and a guess of the finger.
    recordings : one or more, or the files that hold them, each with the force and its site.

    Returns: Dataset of the recordings beside what was fitted, over sample and reading; its attribute `subject` is the
    text of the subject's file, from which `predict` estimates force.

    Raises: InputError for recordings that cannot calibrate this board; NotReachedError, with the Dataset as result,
    where the trace falls short of what is required; KeyboardInterrupt if it was interrupted.
    """
    scene = as_scene(scene)
    given = [recordings] if isinstance(recordings, Recording | str | Path) else recordings
    read = [one if isinstance(one, Recording) else read_sensor_recording(one) for one in given]
    scene.require_blood("calibrate")
    read = checked(read, scene)
    (opened, table), unmet = as_far_as_reached(open_table, scene, progress=progress, **requested)
    if unmet and unmet.interrupted:
        raise KeyboardInterrupt(NO_SUBJECT)
    result = calibrate_with(opened, table, read, progress=progress)
    return unless_cut_off(result, unmet)


def open_table(
    scene: Scene, *, progress: ProgressCallback | None = None, **requested: Unpack[Requested]
) -> tuple[Scene, ReadingTable]:
    """The scene as it is fitted, and its readings over blood, traced: what calibrations of many people share.

    Raises: NotReachedError with both as result where the trace falls short of what is required.
    """
    if scene.ambient is not None:
        backend.choose_jit(requested.get("backend", "auto"), "[ambient]")
    # A person is the paper's network of two zones, whatever the scene has.
    two = {"zones": None, "zone_edges_mm": (0.0,), "decay_length": None}
    scene = scene.model_copy(update={"blood": scene.blood.model_copy(update=two), "body": None})
    most_blood = min(1.0, MOST_OVER_REST * scene.blood.rest_blood_fraction)
    how: dict[str, Any] = {"states": nodes_of(most_blood), "progress": progress, **requested}
    light, unmet = as_far_as_reached(open_light, scene, **how)
    table = reading_table(scene, light, most_blood, TraceOptions(**requested))
    if unmet:
        raise NotReachedError(str(unmet), result=(scene, table))
    return scene, table


def calibrate_with(
    scene: Scene,
    table: ReadingTable,
    recordings: Sequence[Recording],
    *,
    progress: ProgressCallback | None = None,
) -> xr.Dataset:
    """What `calibrate` returns, from a table of traced light and checked recordings."""
    stage = StageProgress(progress)

    def report(done: float) -> None:
        stage("fit", done)
        if stage.interrupted:
            raise KeyboardInterrupt(NO_SUBJECT)

    try:
        fit = Fit(recordings, table, nominal_finger(scene), free=_free(scene, recordings))
        fitted = fit.solve(lambda done: report(FITTED * done))
        subject = _subject(scene, fit, fitted)
    except (ValidationError, InputError) as error:
        why = explain(error, BaseModel).args[0]
        raise InputError(
            f"{recordings[0].name}: is no recording of this scene's board ({why}) Check units, columns and scene."
        ) from None
    subject = _judged(subject, recordings)
    report(1.0)
    return _dataset(recordings, fitted).assign_attrs(
        title="nailoptics: a person's sensor, calibrated",
        digest=subject.scene_digest,
        scene=to_toml(scene),
        subject=subject_toml(subject),
        recordings=[recording.name for recording in recordings],
        warnings=_warnings(subject, recordings),
    )


def _free(scene: Scene, recordings: Sequence[Recording]) -> NDArray[np.bool_]:
    """Which factors are searched, (P,) bool: what the scene states of the pulp is known."""
    fixed = set() if scene.touch.creep is None else {"creep"}
    fixed |= set() if scene.touch.distal_relaxation_s is None else {"distal_recovery"}
    fixed |= set() if np.isnan(np.asarray(joined(recordings).site)).any() else {"proximal_share"}
    return np.array([name not in fixed for name in NAMES])


def _subject(scene: Scene, fit: Fit, fitted: Fitted) -> Subject:
    """The subject as fitted, before its own force was estimated; raises ValidationError or InputError."""
    person, every = fit.finger.person(fitted.factors_ln), joined(fit.recordings)
    rest_v = np.nanmedian(every.volts[:, np.asarray(every.force_n) < REST_FORCE_N], axis=1)
    noise_v, noise = estimate_noise(person, fitted.table, fitted.gain, fit.recordings, fitted.residual_v, rest_v)
    residual_rms_v = np.sqrt(np.nanmean(np.concatenate(fitted.residual_v, axis=1) ** 2, axis=1))
    return Subject(
        scene_digest=digest(scene),
        quality=Quality(fitted.chi2_per_dof, rms_n=np.nan),
        factors=np.exp(fitted.factors_ln),
        readings=Readings(fitted.gain, fitted.offset_v, residual_rms_v, noise_v),
        noise=noise,
        scene=fit.finger,
        light=fitted.table,
        covariance=fitted.covariance,
    )


def _warnings(subject: Subject, recordings: Sequence[Recording]) -> list[str]:
    """Limits of a calibration, for its user."""
    warnings, quality = lacking(recordings), subject.quality
    factors = subject.factor_table()
    if not any(factors[name]["informed"] for name in REFILL_FACTORS):
        warnings.append(
            "the refill rate of the vessels is not identifiable, estimates of quick touches rely on priors."
        )
    if quality.is_wrong:
        held_out = "held-out touches" if quality.is_held_out else "own touches"
        warnings.insert(
            0,
            f"the force of the calibration's {held_out} is {1e3 * quality.rms_n:.0f} mN off (rms), "
            f"{quality.relative_error:.0%} of their size: do not rely on it; check scene, sites and units, and record "
            "the touches of `nailoptics protocol`.",
        )
    return warnings


def _judged(subject: Subject, recordings: Sequence[Recording]) -> Subject:
    """The subject with ensemble and baselines, and how well it estimates its own touches."""
    series = calibration_series(subject, recordings)
    off, at = series.by_filter.proximal_share - series.site, series.force_n >= TOUCH_N
    share_error = rms(off[at & (series.site == 1.0)]), rms(off[at & (series.site == 0.0)])
    quality = replace(subject.quality, share_error=share_error if np.isfinite(share_error).all() else None)
    subject = replace(subject, comparisons=compared(subject, series), quality=quality)
    trained = train(subject, series)
    if trained is not None:
        ensemble, touches = trained
        quality = replace(subject.quality, rms_n=touches["all"]["rms_n"], is_held_out=True, touches=touches)
        return replace(subject, ensemble=ensemble, quality=quality)
    # Without an ensemble errors are those of the touches that the filter was fitted to, as far as it tells them apart.
    below, force = np.isfinite(series.by_filter.force_high_n), series.by_filter
    touches = touches_by_kind(
        series.force_n[below],
        force.force_n[below],
        (force.force_low_n[below], force.force_high_n[below]),
        series.is_proximal[below],
        series.is_still[below],
    )
    return replace(subject, quality=replace(subject.quality, rms_n=touches["all"]["rms_n"], touches=touches))


def _dataset(recordings: Sequence[Recording], fitted: Fitted) -> xr.Dataset:
    """The recordings beside their fit, one after the other."""
    every, reading = joined(recordings), ("reading", "sample")
    which = np.repeat(np.arange(len(recordings)), [len(recording.time_s) for recording in recordings])
    columns: list[tuple[str, Any, Any, str, str]] = [
        ("recording", "sample", which, "number of the recording", "1"),
        ("time_s", "sample", every.time_s, "time", "s"),
        ("force_n", "sample", every.force_n, "known force", "N"),
        ("site", "sample", every.site, "1 proximal, 0 distal, NaN even", "1"),
        ("volts", reading, every.volts, "recorded voltage", "V"),
        ("volts_fitted", reading, np.concatenate(fitted.predicted_v, axis=1), "fitted voltage", "V"),
    ]
    data = {name: var for *column, units in columns for name, var in variable(*column, units=units).items()}
    return xr.Dataset(data, {"reading": list(every.names)})

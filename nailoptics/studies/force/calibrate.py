"""Calibrate a person's sensor with recordings of a known force, and what recordings must have."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Unpack

import numpy as np
import xarray as xr
from pydantic import BaseModel, ValidationError

from ...checks import as_input_error
from ...errors import InputError, NotReachedError, as_far_as_reached, unless_cut_off
from ...light import ProgressCallback, backend, open_light
from ...light.tracing import StageProgress
from ...options import Requested, TraceOptions
from ...scene import Scene, SceneIn, as_scene, digest, to_toml
from ...scene.importers.sensor_recordings import Recording, check_known, read_sensor_recording
from ...scene.protocol import CLOSING_N, FIRST_REST_S, LEAST_TOUCHES, LEVEL_N, SIDE_S
from ...sensor import electronics
from ...variables import variable
from .body_noise import REST_FORCE_N, estimate_noise
from .fit import FARTHEST_SPREADS, LEAST_TOUCHES_OF_ALL, Fit, Fitted, joined
from .person import LONGEST_GAP_S, NAMES, PRIORS, SIDES, SPREAD_LN, nominal_finger
from .reading_table import ReadingTable, nodes_of, reading_names, reading_table, site_of
from .scores import runs, touches_by_kind, train_baselines
from .subject import Quality, Readings, Subject, subject_toml
from .training import calibration_series, train

# Largest blood of the table of light, over the scene's at rest: pooling doubles it, people differ by two more.
MOST_OVER_REST = 5.0
# Fraction of a calibration's time that its fit takes.
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
    requested : photons, tolerance or time of the trace, seed and backend, as of `trace`.

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
    scene: Scene, table: ReadingTable, recordings: Sequence[Recording], *, progress: ProgressCallback | None = None
) -> xr.Dataset:
    """What `calibrate` returns, from a table of traced light and checked recordings."""
    stage = StageProgress(progress)

    def report(done: float) -> None:
        stage("fit", done)
        if stage.interrupted:
            raise KeyboardInterrupt(NO_SUBJECT)

    # A dark slot, which is taken off, saturates readings below the converter's range.
    recordings = [_without_saturated(recording, table.range_v) for recording in recordings]
    # What the scene states of the pulp is known.
    known = set() if scene.touch.creep is None else {"creep"}
    known |= set() if scene.touch.distal_relaxation_s is None else {"distal_recovery"}
    known |= set() if np.isnan(np.asarray(joined(recordings).site)).any() else {"proximal_share"}
    try:
        fit = Fit(recordings, table, nominal_finger(scene), free=np.array([name not in known for name in NAMES]))
        fitted = fit.solve(lambda done: report(FITTED * done))
        subject = _subject(scene, fit, fitted)
    except (ValidationError, InputError) as error:
        why = f"cannot be calibrated with this scene ({as_input_error(error, BaseModel).args[0]})"
        raise InputError(f"{recordings[0].name}: {why} Check units, columns and scene.") from None
    report(FITTED)
    subject = _judged(subject, recordings)
    stage("fit", 1.0)
    return _dataset(recordings, fitted).assign_attrs(
        title="nailoptics: a person's sensor, calibrated",
        digest=subject.scene_digest,
        scene=to_toml(scene),
        subject=subject_toml(subject),
        recordings=[recording.name for recording in recordings],
        warnings=_warnings(subject),
    )


def _subject(scene: Scene, fit: Fit, fitted: Fitted) -> Subject:
    """The subject as fitted, before its own force was estimated; raises ValidationError or InputError."""
    person, every = fit.finger.person(fitted.factors_ln), joined(fit.recordings)
    rest_v = np.nanmedian(every.volts[:, np.asarray(every.force_n) < REST_FORCE_N], axis=1)
    noise_v, noise = estimate_noise(person, fitted.table, fitted.gain, fit.recordings, fitted.residual_v, rest_v)
    residual_rms_v = np.sqrt(np.nanmean(np.concatenate(fitted.residual_v, axis=1) ** 2, axis=1))
    return Subject(
        scene_digest=digest(scene),
        quality=Quality(fitted.chi2_per_dof, rms_n=np.nan, lacking=tuple(lacking(fit.recordings))),
        factors=np.exp(fitted.factors_ln),
        readings=Readings(fitted.gain, fitted.offset_v, residual_rms_v, noise_v),
        noise=replace(noise, donning=fitted.donning),
        scene=fit.finger,
        light=fitted.table,
        covariance=fitted.covariance,
    )


def _warnings(subject: Subject) -> list[str]:
    """Limits of a calibration, for its user."""
    warnings, quality = [*subject.quality.lacking], subject.quality
    factors = subject.factor_table()
    # Of what is not a constant of the vessels, as the pulp's creep, there may be hardly any.
    of_vessels = [bool(prior.fields) for prior in PRIORS.values()]
    part = np.where(of_vessels, np.abs(subject.factors_ln), subject.factors_ln) / (FARTHEST_SPREADS * SPREAD_LN)
    at_bound = np.array(NAMES)[np.isclose(part, 1.0, atol=0.02)]
    if bounded := [f"{name} ({factors[name]['value']:.2g})" for name in at_bound]:
        warnings.append(f"the fit ends at a bound for {', '.join(bounded)}: its model is not quite this finger.")
    if not any(factors[name]["informed"] for name in REFILL_FACTORS):
        warnings.append("the refill rate of the vessels is unidentifiable: estimates of quick touches rely on priors.")
    if quality.fault:
        held_out = "held-out touches" if subject.ensemble else "own touches"
        off = f"{1e3 * quality.rms_n:.0f} mN off (rms), {quality.relative_error:.0%} of their size"
        cure = "check scene, sites and units, and record the touches of `nailoptics protocol`"
        warnings.insert(0, f"the force of the calibration's {held_out} is {off}: do not rely on it; {cure}.")
    return warnings


def _judged(subject: Subject, recordings: Sequence[Recording]) -> Subject:
    """The subject with ensemble and baselines, and how well it estimates its own touches."""
    series = calibration_series(subject, recordings)
    at, (_, by_zone) = series.is_varied, subject.light.slopes(subject.person.blood(np.ones(2)))
    is_proximal = np.abs(by_zone[:, 0]) >= np.abs(by_zone[:, 1])
    baselines = train_baselines(series.over_rest[:, at], series.force_n[at], is_proximal)
    ensemble, touches = train(subject, series) or (None, None)
    if touches is None:
        # Errors are of the touches that the filter was fitted to, as far as it distinguishes them.
        below = series.select(np.flatnonzero(np.isfinite(series.by_filter.force_high_n)))
        force_n, low_n, high_n = below.by_filter[:3]
        touches = touches_by_kind(below.force_n, force_n, (low_n, high_n), below.site, below.is_still)
    outliers = float(series.is_outlier[series.is_still].mean())
    quality = replace(subject.quality, rms_n=touches["all"]["rms_n"], outliers=outliers, touches=touches)
    return replace(subject, comparisons=baselines, ensemble=ensemble, quality=quality)


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


# Least rest before the first touch of a recording, its longest pause [s], and its largest force, at least and most [N].
REST_S, LONGEST_PAUSE_S, LEAST_TOUCH_N, MOST_TOUCH_N = 1.0, 60.0, 0.2, 20.0
# A touch reaches this force before the finger rests again [N]
TOUCHED_N = 0.1
# Rates of all recordings, of each in so many parts, differ by less than this part.
RATE_PARTS, SAME_RATE = 5, 0.2
# Least number of a reading's samples at rest, least valid fraction of all, and most that is saturated.
LEAST_AT_REST, LEAST_PART, MOST_SATURATED = 10, 0.1, 0.01
# A side lacks what it has less of than this fraction of the protocol's.
ENOUGH = 0.4
# Touches are quick whose force rises or falls by so much within a time; each side has so many of either. [N, s, 1]
QUICK_N, QUICK_S, QUICK_TOUCHES = 0.15, 0.3, 2


def checked(recordings: Sequence[Recording], scene: Scene) -> list[Recording]:
    """The recordings with the scene's readings and their sites; raises InputError unless they can calibrate."""
    names = reading_names(scene)
    for recording in recordings:
        check_known(recording.names, names, recording.name)
    # Force and length first: a reading that no touch moves says nothing of its wiring.
    for part in (part for recording in recordings for part in worn_at_once(recording)):
        with_site(replace(part, names=(), volts=part.volts[:0]), scene)
    in_order = [recording.with_readings(names) for recording in recordings]
    given = [with_site(part, scene) for recording in in_order for part in worn_at_once(recording)]
    if not given:
        raise InputError("calibrate needs at least one recording of a known force.")
    if fault := next(_faults_together(given), None):
        raise InputError(f"{', '.join(recording.name for recording in given)}: {fault}")
    return given


def worn_at_once(recording: Recording) -> list[Recording]:
    """The recording in parts, between pauses in which the sensor may have been taken off: the filter begins anew after
    these, the finger rests before and after them, and each part has touches."""
    if recording.force_n is None:
        return [recording]
    time_s, rests = recording.time_s, recording.force_n < REST_FORCE_N
    cuts = 1 + np.flatnonzero((np.diff(time_s) > LONGEST_GAP_S) & rests[:-1] & rests[1:])
    parts = np.split(np.arange(len(time_s)), cuts)
    if len(parts) == 1 or not all(recording.force_n[part].max() >= TOUCHED_N for part in parts):
        return [recording]
    label = f"{recording.name} from time_s ="
    return [replace(recording.select(part), name=f"{label} {time_s[part[0]]:g} on") for part in parts]


def with_site(recording: Recording, scene: Scene) -> Recording:
    """The recording with its site; raises InputError unless it can be one of a calibration."""
    if fault := next(_faults(recording), None):
        raise InputError(f"{recording.name}{fault}")
    recording = _without_saturated(recording, scene.electronics.adc_range_v)
    return recording if recording.site is not None else replace(recording, site=site_of(scene, recording.time_s))


def _without_saturated(recording: Recording, range_v: float) -> Recording:
    """The recording with gaps where readings are at their converter's limit; raises InputError where too many are."""
    saturated = electronics.recorded_at_limit(recording.volts, range_v)
    for title, count in zip(recording.names, saturated.sum(1), strict=True):
        if count > MOST_SATURATED * saturated.shape[1]:
            why = f"column {title!r} is saturated ({range_v:g} V) in {count} samples; lower the LED's power."
            raise InputError(f"{recording.name}: {why}")
    return replace(recording, volts=np.where(saturated, np.nan, recording.volts))


def _faults(recording: Recording) -> Iterator[str]:
    """Why a recording cannot calibrate: no force, no rest, times too far apart, readings missing."""
    force_n, time_s, steps_s = recording.force_n, recording.time_s, np.diff(recording.time_s)
    if force_n is None:
        yield ": has no column force_n; calibrating needs the force in newtons."
        return
    if (empty := np.isnan(force_n)).any():
        yield f" line {int(np.argmax(empty)) + 2}: force_n is empty; calibrating needs it in every row."
    rest, most_n = force_n < REST_FORCE_N, force_n.max()
    usual_s, longest = float(np.median(steps_s)), int(np.argmax(steps_s))
    first_rest_s = _first_rest_s(recording)
    faults = {
        f"force_n is constant at {force_n[0]:g} N; press the finger.": np.ptp(force_n) == 0,
        f"force_n reaches {most_n:.3g} N; press up to 1 N or more, {MOST_TOUCH_N:g} N at most, and give it in "
        "newtons.": not LEAST_TOUCH_N <= most_n <= MOST_TOUCH_N,
        f"the finger rests (force_n below {REST_FORCE_N:g} N) for {first_rest_s:.2g} s before the first touch; begin "
        f"with {FIRST_REST_S:g} s without a touch.": first_rest_s < REST_S,
        f"nothing was recorded for {steps_s[longest]:.3g} s after time_s = {time_s[longest]:g}; split the recording "
        "there.": steps_s[longest] > LONGEST_PAUSE_S,
        f"{len(time_s)} samples, mostly {usual_s:.2g} s apart, span {steps_s.sum():.3g} s; record at an even rate "
        "(empty cells are gaps).": usual_s * len(steps_s) < 0.5 * steps_s.sum(),
    }
    for title, volts in zip(recording.names, recording.volts, strict=True):
        valid = np.isfinite(volts)
        faults |= {
            f"column {title!r} has {valid.sum()} of {len(volts)} samples, {valid[rest].sum()} of them without a touch; "
            "record it throughout.": valid.mean() < LEAST_PART or valid[rest].sum() < LEAST_AT_REST,
        }
    yield from (f": {message}" for message, met in faults.items() if met)


def _touches(recording: Recording, side: float) -> list[slice]:
    """The samples of each touch of a side alone, by its number in `site`, from rest to rest."""
    force_n = np.asarray(recording.force_n)
    touched = (force_n >= REST_FORCE_N) & (recording.site == side)
    return [slice(start, stop) for start, stop in runs(touched) if force_n[start:stop].max() >= TOUCHED_N]


def _faults_together(recordings: Sequence[Recording]) -> Iterator[str]:
    """Why recordings that could calibrate cannot do so together."""
    parts = [part for one in recordings for part in np.array_split(np.diff(one.time_s), RATE_PARTS) if part.size]
    steps_s = [float(np.median(part)) for part in parts]
    if max(steps_s) > (1.0 + SAME_RATE) * min(steps_s):
        rates = f"{1.0 / max(steps_s):.3g} and {1.0 / min(steps_s):.3g} Hz"
        yield f"recorded at {rates}; record all of a calibration at one rate."
    counts = [sum(len(_touches(recording, number)) for recording in recordings) for number in (1.0, 0.0)]
    for side, count in zip(SIDES, counts, strict=True):
        if not count:
            where = "by the column site (without one, by the scene's touch)"
            yield f"no {side} touch was recorded {where}; record both sides, as `nailoptics protocol` has them."
    if sum(counts) < LEAST_TOUCHES_OF_ALL:
        more = f"{LEAST_TOUCHES_OF_ALL} or more, with rests between, as `nailoptics protocol` has them"
        yield f"{sum(counts)} touches were recorded; record {more}."


def lacking(recordings: Sequence[Recording]) -> Iterator[str]:
    """What recordings lack of the protocol, by what was measured: a sentence for each side, and for the rest."""
    for side, number in zip(SIDES, (1.0, 0.0), strict=True):
        if parts := _lacking(recordings, number):
            yield f"{side} touches lack {', '.join(parts)}: record those of `nailoptics protocol`, too."
    if (least_s := min(map(_first_rest_s, recordings))) < ENOUGH * FIRST_REST_S:
        yield f"a recording begins with {least_s:.2g} s of rest: begin with {FIRST_REST_S:g} s."


def _first_rest_s(recording: Recording) -> float:
    """Time before the first touch. [s]"""
    return float(recording.time_s[np.argmax(np.asarray(recording.force_n) >= REST_FORCE_N)] - recording.time_s[0])


def _lacking(recordings: Sequence[Recording], side: float) -> list[str]:
    """What one side lacks, each with what was recorded in brackets."""
    below_s, touches = 0.0, list[tuple[float, float, float]]()
    for recording in recordings:
        time_s, force_n = recording.time_s, np.asarray(recording.force_n)
        moved_n = force_n - np.interp(time_s - QUICK_S, time_s, force_n)
        after = round(QUICK_S / float(np.median(np.diff(time_s))))
        for touch in _touches(recording, side):
            below_s += float(np.diff(time_s[touch])[force_n[touch][1:] <= LEVEL_N[1]].sum())
            around = slice(touch.start, touch.stop + after)
            touches.append((float(force_n[touch].max()), moved_n[around].max(), -moved_n[around].min()))
    peak_n, risen_n, fallen_n = np.array(touches).reshape(-1, 3).T
    most_n = peak_n.max(initial=0.0)
    quick_rises, quick_ends = int(sum(risen_n >= QUICK_N)), int(sum(fallen_n >= QUICK_N))
    lacks = {
        f"touches ({len(touches)} of {LEAST_TOUCHES})": len(touches) < LEAST_TOUCHES,
        f"time below {LEVEL_N[1]:g} N ({below_s:.0f} of {SIDE_S:g} s)": below_s < ENOUGH * SIDE_S,
        f"quick rises ({quick_rises} within {QUICK_S:g} s)": quick_rises < QUICK_TOUCHES,
        f"quick releases ({quick_ends} within {QUICK_S:g} s)": quick_ends < QUICK_TOUCHES,
        f"a slow touch of {CLOSING_N[0]:g} to {CLOSING_N[1]:g} N (at most {most_n:.2g} N)": most_n < CLOSING_N[0],
    }
    return [text for text, is_lacking in lacks.items() if is_lacking]

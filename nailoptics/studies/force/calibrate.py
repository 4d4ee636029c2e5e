"""Calibrate a person's sensor with recordings of a known force."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Unpack

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError

from ...checks import explain
from ...errors import InputError, NotReachedError, as_far_as_reached, unless_cut_off
from ...hemodynamics import steady_state
from ...hemodynamics.for_scene import vessels
from ...hemodynamics.parameters import Parameters, each_bed
from ...light import ProgressCallback, open_light
from ...light.tracing import StageProgress
from ...options import Requested
from ...scene import Scene, digest, to_toml
from ...scene.importers.sensor_recordings import SATURATED, SITES, Recording, read_sensor_recording
from ...variables import variable
from .body_noise import REST_FORCE_N, estimate_noise
from .fit import Fit, Fitted
from .kalman import PressureEstimate, estimate_pressures
from .person import N_PER_CM2, NAMES, SIDES, USUAL_DISTAL_REACH, USUAL_PULP, Array, NominalFinger, Pulp
from .predict import TOUCH_N, rms
from .reading_table import ReadingTable, nodes_of, reading_names, reading_table, site_of
from .state_space import touch_pressure
from .subject import Correction, Quality, Readings, Regression, Subject, subject_toml
from .uncertainty import ForceInterval, fit_correction, no_correction

# Largest blood of the table of light, over the scene's at rest: pooling doubles it, people differ by two more.
MOST_OVER_REST = 5.0
# Least time at rest in a recording [s], and its largest force, at least and at most [N].
REST_S, LEAST_TOUCH_N, MOST_TOUCH_N = 1.0, 0.2, 20.0
# Longest usual step from sample to sample, and longest pause. [s]
LONGEST_STEP_S, LONGEST_PAUSE_S = 0.5, 60.0
# Least number of a reading's samples at rest, and least valid part of all.
LEAST_AT_REST, LEAST_PART = 10, 0.1
# Intervals are widened unless this part of the calibration's own errors lies within them, or, as touches are few and
# errors correlated, within so many times as much.
COVERED, BY_CHANCE = 0.95, 1.2
# Part of a calibration's time that its fit takes.
FITTED = 0.8
# A touch that ends within this time shows how fast the vessels refill. [s]
QUICKLY_S = 0.2
# Part of the readings' variance that the principal components of the regression hold; readings that hang together have
# components of rounding alone, so small a part of the largest.
COMPONENT_VARIANCE, ROUNDING = 0.999, 1e-13
# Factors that say how fast vessels refill.
REFILL_FACTORS = ("vein_damping", "capillary_damping")
NO_SUBJECT = "interrupted; no subject was written."


def calibrate(
    scene: Scene,
    recordings: Sequence[Recording | str | Path],
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
    names = reading_names(scene)
    read = [
        recording if isinstance(recording, Recording) else read_sensor_recording(recording) for recording in recordings
    ]
    given = [_checked(recording.of(names), scene) for recording in read]
    if not given:
        raise InputError("calibrate needs at least one recording of a known force.")
    (scene, table), unmet = as_far_as_reached(open_table, scene, progress=progress, **requested)
    if unmet and unmet.interrupted:
        raise KeyboardInterrupt(NO_SUBJECT)
    result = calibrate_with(scene, table, given, progress=progress)
    return unless_cut_off(result, unmet)


def open_table(
    scene: Scene, *, progress: ProgressCallback | None = None, **requested: Unpack[Requested]
) -> tuple[Scene, ReadingTable]:
    """The scene as it is fitted, and its readings over blood, traced: what calibrations of many people share.

    Raises: NotReachedError with both as result where the trace falls short of what is required.
    """
    # A person is the paper's network of two zones, whatever the scene has.
    two = {"zones": None, "zone_edges_mm": (0.0,), "decay_length": None}
    scene = scene.model_copy(update={"blood": scene.blood.model_copy(update=two), "body": None})
    most_blood = min(1.0, MOST_OVER_REST * scene.blood.rest_blood_fraction)
    how: dict[str, Any] = {"states": nodes_of(most_blood), "progress": progress, **requested}
    light, unmet = as_far_as_reached(open_light, scene, **how)
    table = reading_table(scene, light, most_blood)
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
        fit = Fit(recordings, table, _nominal_finger(scene), free=_free(scene, recordings))
        fitted = fit.solve(lambda done: report(FITTED * done))
        subject = _subject(scene, fit, fitted)
    except (ValidationError, InputError) as error:
        why = explain(error, BaseModel) if isinstance(error, ValidationError) else str(error)
        raise InputError(
            f"{recordings[0].name}: is no recording of this scene's board ({why}) Check units, columns and scene."
        ) from None
    subject, half_width_n = _judged(subject, recordings)
    report(1.0)
    return _dataset(recordings, fitted).assign_attrs(
        title="nailoptics: a person's sensor, calibrated",
        digest=subject.scene_digest,
        scene=to_toml(scene),
        subject=subject_toml(subject),
        half_width_n=half_width_n,
        recordings=[recording.name for recording in recordings],
        warnings=_warnings(subject, recordings),
    )


def joined(recordings: Sequence[Recording]) -> Recording:
    """All samples of recordings with force and site, one after the other; times begin anew with each."""
    force_n, site = ([np.asarray(getattr(recording, name)) for recording in recordings] for name in ("force_n", "site"))
    parts = [recording.time_s for recording in recordings], [recording.volts for recording in recordings], force_n, site
    return Recording("all", recordings[0].names, *(np.concatenate(part, axis=-1) for part in parts))


def _nominal_finger(scene: Scene) -> NominalFinger:
    """The scene's finger, with the usual pulp where the scene states none."""
    touch, pulp = scene.touch, USUAL_PULP
    creep = pulp.creep if touch.creep is None else touch.creep
    recovery_s = pulp.recovery_s if touch.distal_relaxation_s is None else touch.distal_relaxation_s
    return NominalFinger(
        rest_blood_fraction=scene.blood.rest_blood_fraction,
        contact_area_cm2=touch.contact_area_mm2 / 100.0,
        proximal_share=touch.proximal_share,
        distal_reach=scene.blood.distal_reach or USUAL_DISTAL_REACH,
        pulp=Pulp(creep=creep, creep_s=touch.creep_s, recovery_s=recovery_s),
        vessels=vessels(scene),
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
    force_n, site = np.asarray(every.force_n), np.asarray(every.site)
    rest_v = np.nanmedian(every.volts[:, force_n < REST_FORCE_N], axis=1)
    noise_v, noise = estimate_noise(person, fitted.table, fitted.gain, fit.recordings, fitted.residual_v, rest_v)
    residual_rms_v = np.sqrt(np.nanmean(np.concatenate(fitted.residual_v, axis=1) ** 2, axis=1))
    at_site = {"proximal": site == 1.0, "distal": site == 0.0, "even": np.isnan(site)}
    most_n = {name: float(force_n[at].max()) for name, at in at_site.items() if at.any()}
    bridged = np.concatenate([_bridged(recording.volts) for recording in fit.recordings], axis=1)
    complete = np.isfinite(bridged).all(0)
    return Subject(
        scene_digest=digest(scene),
        quality=Quality(fitted.chi2_per_dof, rms_n=np.nan, coverage_factor=1.0, most_force_n=most_n),
        factors=np.exp(fitted.factors_ln),
        readings=Readings(fitted.gain, fitted.offset_v, residual_rms_v, noise_v),
        noise=noise,
        correction=no_correction(),
        baselines=regressions(bridged[:, complete], force_n[complete]),
        scene=fit.finger,
        light=fitted.table,
        covariance=fitted.covariance,
    )


def _bridged(volts: Array) -> Array:
    """Volts (R, T) whose gaps are bridged where no sample is complete, as where LEDs are lit in turn."""
    valid = np.isfinite(volts)
    if valid.all(0).any():
        return volts
    samples = np.arange(volts.shape[1])
    return np.array([np.interp(samples, samples[at], series[at]) for series, at in zip(volts, valid, strict=True)])


def regressions(volts: Array, force_n: Array) -> dict[str, Regression]:
    """Regressions without a model: least squares on volts (R, T), and on their principal components.

    References: Grieve, Hollerbach, Mascaro 2015, which takes components for fingernail images.
    """
    mean_v = volts.mean(1)
    vectors, sizes, scores = np.linalg.svd(volts - mean_v[:, None], full_matrices=False)

    def on_components(count: int) -> Regression:
        weights = vectors[:, :count] @ (scores[:count] @ force_n / sizes[:count])
        return Regression(float(force_n.mean() - weights @ mean_v), weights)

    part = np.cumsum(sizes**2) / (sizes**2).sum()
    return {
        "linear": on_components(int(np.sum(sizes > ROUNDING * sizes[0]))),
        "components": on_components(int(np.searchsorted(part, COMPONENT_VARIANCE)) + 1),
    }


def _warnings(subject: Subject, recordings: Sequence[Recording]) -> list[str]:
    """Limits of a calibration, for its user."""
    warnings, who, quality, every = [], subject.person, subject.quality, joined(recordings)
    for side, closed_n in zip(SIDES, who.closure() * who.side_areas_cm2, strict=True):
        most_n = quality.most_force_n.get(side, quality.most_force_n.get("even", 0.0))
        if most_n == 0:
            warnings.append(f"no {side} touch was recorded: its estimates rely on priors.")
        elif most_n < 0.8 * closed_n:
            warnings.append(
                f"{side} touches reach {most_n:.2g} N, the vessels close at {closed_n:.2g} N: record harder ones."
            )
    for side, forces_n in _two_balances_n(subject).items():
        warnings.append(
            f"{side} touches of {forces_n.min():.2g} to {forces_n.max():.2g} N could hold the vessels in two states: "
            "the same force may read differently as it grows and as it falls."
        )
    factors = subject.factor_table()
    if not any(factors[name]["informed"] for name in REFILL_FACTORS):
        advice = f"record some that are released within {QUICKLY_S:g} s, too"
        if any(_released_quickly(recording) for recording in recordings):
            advice = "those that are released quickly do not identify it, either; record more of them"
        warnings.append(
            f"the refill rate of the vessels is not identifiable, estimates of quick touches rely on priors: {advice}."
        )
    if quality.is_wrong:
        linear_n = rms(subject.baselines["linear"].force_n(every.volts) - np.asarray(every.force_n))
        warnings.append(
            f"the force of the calibration's own touches is {1e3 * quality.rms_n:.0f} mN off (rms; linear regression "
            f"{1e3 * linear_n:.0f} mN): this subject does not fit them; check scene, sites and units."
        )
    if quality.coverage_factor > 2:
        warnings.append(
            f"intervals had to be made {quality.coverage_factor:.1f} times as wide to cover the calibration's own "
            "touches: the model misses something."
        )
    return warnings


def _released_quickly(recording: Recording) -> bool:
    """Whether a touch of the recording is released within `QUICKLY_S`."""
    time_s, force_n = recording.time_s, np.asarray(recording.force_n)
    before_n = np.interp(time_s - QUICKLY_S, time_s, force_n)
    return bool(((before_n >= LEAST_TOUCH_N) & (force_n < REST_FORCE_N)).any())


def _two_balances_n(subject: Subject) -> dict[str, Array]:
    """Calibrated forces at which the person's vessels have two stable states, by site."""
    constants = {name: each_bed(float, value) for name, value in subject.scene.vessels_of(subject.factors_ln).items()}
    forces = {}
    for side, most_n in subject.quality.most_force_n.items():
        forces_n = np.linspace(0.0, most_n, 101)
        proximal, distal = N_PER_CM2 * subject.person.pressures(forces_n, np.full(101, SITES[side]))
        state = steady_state(Parameters(**constants), proximal_pressure_pa=proximal, distal_pressure_pa=distal)
        if state.two_branches.any():
            forces[side] = forces_n[state.two_branches]
    return forces


def _judged(subject: Subject, recordings: Sequence[Recording]) -> tuple[Subject, float]:
    """The subject with its correction, its rms error of the force and its coverage factor, from its own recordings.

    And the median half width of the intervals over touches, infinite where most have no upper bound. [N]
    """
    every = joined(recordings)
    force_n, site = np.asarray(every.force_n), np.asarray(every.site)
    estimates_of = [estimate_pressures(subject, recording.time_s, recording.volts) for recording in recordings]
    estimates = PressureEstimate(*map(np.concatenate, zip(*estimates_of, strict=True)))
    estimated = touch_pressure(estimates.touch.T)
    applied, closure = subject.person.pressures(force_n, site), subject.person.closure()
    curves = [
        fit_correction(closure[side], every.time_s[at], estimated[side, at], applied[side, at])
        for side, at in enumerate((site == 1.0, site == 0.0))
    ]
    subject = replace(subject, correction=Correction(*curves))
    force = ForceInterval(subject).of(estimates)
    half_width_n = 0.5 * float(np.median((force.force_high_n - force.force_low_n)[force_n >= TOUCH_N]))
    # At rest an interval ends at 0, wherever the estimate lies: that says nothing of its width.
    judged = np.isfinite(force.force_high_n) & (force_n >= REST_FORCE_N)
    if not judged.any():
        return subject, half_width_n
    error = (force.force_n - force_n)[judged]
    half = np.where(
        error < 0, (force.force_high_n - force.force_n)[judged], (force.force_n - force.force_low_n)[judged]
    )
    ratio = np.abs(error)[half > 0] / half[half > 0]
    factor = max(1.0, float(np.quantile(ratio, COVERED)) / BY_CHANCE) if ratio.size else 1.0
    quality = replace(subject.quality, rms_n=rms(error), coverage_factor=factor)
    return replace(subject, quality=quality), half_width_n * factor


def _checked(recording: Recording, scene: Scene) -> Recording:
    """The recording with its site; raises InputError unless it can calibrate."""
    fault = next(_faults(recording, scene.electronics.adc_range_v), None)
    if fault:
        raise InputError(f"{recording.name}{fault}")
    if recording.site is not None:
        return recording
    return replace(recording, site=np.full(recording.time_s.shape, site_of(scene)))


def _faults(recording: Recording, limit_v: float) -> Iterator[str]:
    """Why a recording cannot calibrate: no force, no rest, times too far apart, readings saturated or missing."""
    force_n, time_s, steps_s = recording.force_n, recording.time_s, np.diff(recording.time_s)
    if force_n is None:
        yield ": has no column force_n; calibrating needs the force in newtons."
        return
    if (empty := np.isnan(force_n)).any():
        yield f" line {int(np.argmax(empty)) + 2}: force_n is empty; calibrating needs it in every row."
    rest, most_n = force_n < REST_FORCE_N, force_n.max()
    rest_s, usual_s, longest = float(steps_s[rest[1:]].sum()), float(np.median(steps_s)), int(np.argmax(steps_s))
    faults = {
        f"force_n is constant at {force_n[0]:g} N; press the finger.": np.ptp(force_n) == 0,
        f"force_n reaches {most_n:.3g} N; press up to 1 N or more, {MOST_TOUCH_N:g} N at most, and give it in "
        "newtons.": not LEAST_TOUCH_N <= most_n <= MOST_TOUCH_N,
        f"the finger rests (force_n below {REST_FORCE_N:g} N) for {rest_s:.2g} s; record at least {REST_S:g} s without "
        "a touch.": rest_s < REST_S,
        f"samples lie {usual_s:.2g} s apart; record at {1 / LONGEST_STEP_S:g} Hz or faster, with time_s in "
        "seconds.": usual_s > LONGEST_STEP_S,
        f"nothing was recorded for {steps_s[longest]:.3g} s after time_s = {time_s[longest]:g}; split the recording "
        "there.": steps_s[longest] > LONGEST_PAUSE_S,
        f"{len(time_s)} samples, mostly {usual_s:.2g} s apart, span {steps_s.sum():.3g} s; record at an even rate "
        "(empty cells are gaps).": usual_s * len(steps_s) < 0.5 * steps_s.sum(),
    }
    for title, volts in zip(recording.names, recording.volts, strict=True):
        at_limit, valid = int(np.sum(volts >= SATURATED * limit_v)), np.isfinite(volts)
        faults |= {
            f"column {title!r} is saturated ({limit_v:g} V) in {at_limit} samples; lower the LED's power.": (
                at_limit > 0.01 * len(volts)
            ),
            f"column {title!r} has {valid.sum()} of {len(volts)} samples, {valid[rest].sum()} of them without a touch; "
            "record it throughout.": valid.mean() < LEAST_PART or valid[rest].sum() < LEAST_AT_REST,
        }
    yield from (f": {message}" for message, met in faults.items() if met)


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

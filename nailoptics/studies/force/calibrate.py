"""Calibrate a person's sensor with recordings of a known force."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Unpack

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from ...errors import InputError, NotReachedError, as_far_as_reached
from ...hemodynamics import steady_state
from ...hemodynamics.for_scene import vessels
from ...light import ProgressCallback, open_light
from ...light.tracing import StageProgress
from ...options import Requested
from ...scene import Scene, Touch, digest, to_toml
from ...scene.importers.sensor_recordings import SATURATED, SITES, Recording, read_sensor_recording
from ...variables import variable
from .baselines import Regression, component_regression, linear_regression, whole_samples
from .body_noise import learn_noise
from .fit import Fit, Fitted, Profile, profile_of
from .kalman import KalmanFilter, PressureEstimate
from .person import NAMES, PRIORS, RIGID_PULP, USUAL_DISTAL_REACH, USUAL_PULP, Person, Pulp, vessel_closure
from .predict import TOUCH_N
from .reading_table import ReadingTable, nodes_of, paper_table, reading_names, reading_table
from .state_space import touch_pressure
from .subject import Model, Subject, subject_toml
from .uncertainty import Correction, fit_correction, no_correction

Array = NDArray[np.float64]

# The table of light reaches so far beyond the scene's blood at rest: pooling doubles it, people differ by two more.
MOST_OVER_REST = 5.0
# Recordings must begin or pause untouched, at less than this force, for so long in all. [N, s]
REST_FORCE_N, REST_S = 0.05, 1.0
# And they must press so hard at least and at most. [N]
LEAST_TOUCH_N, MOST_TOUCH_N = 0.2, 20.0
# Samples that lie further apart do not show how the vessels move; a longer pause is a recording's end. [s]
LONGEST_STEP_S, LONGEST_PAUSE_S = 0.5, 60.0
# A reading must be there in so many samples at rest, and in this part of all.
LEAST_AT_REST, LEAST_SEEN = 10, 0.1
# This part of the samples of the calibration's touches lies within intervals as they are, or, as such touches are few,
# within so many times as much by chance; where more is needed the model misses something, and they are made wider.
COVERED, BY_CHANCE = 0.95, 1.2
# Parts of a calibration's time that its fit and its profile likelihoods take, more or less.
FITTED, PROFILED = 0.4, 0.5
# A touch that ends within this time shows how fast the vessels refill. [s]
QUICKLY_S = 0.2
# What the paper tunes by hand beside offset and scale: time constants.
PAPER_FACTORS = ("vein_damping", "capillary_damping")
NO_SUBJECT = "interrupted; no subject was written."


def calibrate(
    scene: Scene,
    recordings: Sequence[Recording | str | Path],
    *,
    model: Model = "network",
    progress: ProgressCallback | None = None,
    **requested: Unpack[Requested],
) -> xr.Dataset:
    """Fit a person's sensor to recordings of a known force.

    scene : the board and a guess of the finger.
    recordings : one or more, or the files that hold them, each with the force and its site.
    model : "network" fits the vessels on the traced light; "paper" offset and scale of (9) and time constants alone.

    Returns: Dataset of the recordings beside what was fitted, over sample and reading; its attribute `subject` is the
    text of the subject's file, from which `predict` tells force.

    Raises: InputError for recordings that cannot calibrate this board; NotReachedError, with the Dataset as result,
    where the trace falls short of what is required; KeyboardInterrupt if it was interrupted.
    """
    names = reading_names(scene)
    read = [one if isinstance(one, Recording) else read_sensor_recording(one) for one in recordings]
    given = [_checked(one.of(names), scene) for one in read]
    if not given:
        raise InputError("calibrate needs at least one recording of a known force.")
    (scene, table), unmet = as_far_as_reached(open_table, scene, model=model, progress=progress, **requested)
    if unmet and unmet.interrupted:
        raise KeyboardInterrupt(NO_SUBJECT)
    result = calibrate_with(scene, table, given, model=model, progress=progress)
    if unmet:
        result.attrs["cut_off"] = str(unmet)
        raise NotReachedError(str(unmet), result=result)
    return result


def open_table(
    scene: Scene,
    *,
    model: Model = "network",
    progress: ProgressCallback | None = None,
    **requested: Unpack[Requested],
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
    table = paper_table(scene, table) if model == "paper" else table
    if unmet:
        raise NotReachedError(str(unmet), result=(scene, table))
    return scene, table


def calibrate_with(
    scene: Scene,
    table: ReadingTable,
    recordings: Sequence[Recording],
    *,
    model: Model = "network",
    progress: ProgressCallback | None = None,
) -> xr.Dataset:
    """What `calibrate` returns, from a table of light that is already there and recordings that were checked."""
    report = _reporter(progress)
    usual = {
        "rest_blood": scene.blood.rest_blood_fraction,
        "area_cm2": scene.touch.contact_area_mm2 / 100.0,
        "share": scene.touch.proximal_share,
        # The paper's two zones do not share the distal pressure.
        "distal_reach": USUAL_DISTAL_REACH if model == "network" else 0.0,
    }
    pulp = _pulp(scene.touch, model)
    fit = Fit(recordings, table, vessels(scene), free=_free(scene.touch, recordings, model), pulp=pulp, **usual)
    fitted = fit.solve(lambda done: report(FITTED * done))
    profile = profile_of(fit, fitted.factors_ln[fit.free], lambda done: report(FITTED + PROFILED * done))
    who, rest_v = fit.person(fitted.factors_ln), _rest_volts(recordings)
    noise = learn_noise(who, fitted.table, fitted.gain, recordings, fitted.residual_v, rest_v)
    subject = Subject(
        scene_digest=digest(scene),
        model=model,
        table=fitted.table,
        base=fit.base,
        factors_ln=fitted.factors_ln,
        gain=fitted.gain,
        offset_v=fitted.offset_v,
        covariance=fitted.covariance,
        residual_rms_v=np.sqrt(np.nanmean(np.concatenate(fitted.residual_v, axis=1) ** 2, axis=1)),
        noise=noise,
        correction=no_correction(),
        coverage_factor=1.0,
        most_force_n=_most_force(recordings),
        chi2_per_dof=fitted.chi2_per_dof,
        rms_n=float("nan"),
        baselines=_baselines(recordings),
        pulp=pulp,
        **usual,
    )
    try:
        subject.check()
    except ValueError as error:
        raise InputError(
            f"{recordings[0].name}: is no recording of this scene's board ({error}); check units, columns and scene."
        ) from None
    subject, half_width_n = _judged(subject, recordings)
    report(1.0)
    return _dataset(recordings, fitted, profile).assign_attrs(
        title="nailoptics: a person's sensor, calibrated",
        digest=subject.scene_digest,
        scene=to_toml(scene),
        subject=subject_toml(subject),
        half_width_n=half_width_n,
        bent_factors=list(profile.bent),
        recordings=[one.name for one in recordings],
        warnings=_warnings(subject, recordings),
    )


def _reporter(progress: ProgressCallback | None) -> Callable[[float], None]:
    """Reports the part of a calibration that is done, and ends it where the user interrupted."""
    stage = StageProgress(progress)

    def report(done: float) -> None:
        stage("fit", done)
        if stage.interrupted:
            raise KeyboardInterrupt(NO_SUBJECT)

    return report


def _free(touch: Touch, recordings: Sequence[Recording], model: Model) -> NDArray[np.bool_]:
    """Which factors are searched, (P,) bool: what the scene states of the pulp is known."""
    even = any(one.site is not None and np.isnan(one.site).any() for one in recordings)
    searched = PAPER_FACTORS if model == "paper" else NAMES
    stated = {"creep": touch.creep, "distal_recovery": touch.distal_relaxation_s}
    fixed = {name for name, value in stated.items() if value is not None} | (set() if even else {"proximal_share"})
    return np.array([name in searched and name not in fixed for name in NAMES])


def _pulp(touch: Touch, model: Model) -> Pulp:
    """What the scene states of the pulp, else what is usual; the paper's model has none."""
    if model == "paper":
        return RIGID_PULP
    creep, recovery_s = touch.creep, touch.distal_relaxation_s
    return Pulp(
        creep=USUAL_PULP.creep if creep is None else creep,
        creep_s=touch.creep_s,
        recovery_s=USUAL_PULP.recovery_s if recovery_s is None else recovery_s,
    )


def _warnings(subject: Subject, recordings: Sequence[Recording]) -> list[str]:
    """What a user should know of a calibration before trusting it."""
    warnings = []
    closure = vessel_closure(subject.person())
    who = subject.person()
    distal_cm2, proximal_cm2 = float(who.area_cm2), float(who.area_cm2 * who.proximal_area)
    for side, shut, area_cm2 in (("proximal", closure.proximal, proximal_cm2), ("distal", closure.distal, distal_cm2)):
        most = subject.most_force_n.get(side, subject.most_force_n.get("even", 0.0))
        reach = shut * area_cm2
        if most == 0:
            warnings.append(f"no {side} touch was recorded: its estimates rely on priors.")
        elif most < 0.8 * reach:
            warnings.append(
                f"{side} touches reach {most:.2g} N, the vessels close at {reach:.2g} N: record harder ones."
            )
    for side, forces_n in _two_balances_n(subject).items():
        warnings.append(
            f"{side} touches of {forces_n.min():.2g} to {forces_n.max():.2g} N could hold the vessels in two states: "
            "the same force may read differently as it grows and as it falls."
        )
    factors = subject.factors()
    if not any(factors[name]["informed"] for name in PAPER_FACTORS):
        advice = f"record some that are released within {QUICKLY_S:g} s, too"
        if any(_let_go_quickly(one) for one in recordings):
            advice = "those that are released quickly do not identify it, either; record more of them"
        warnings.append(
            f"the refill rate of the vessels is not identifiable, estimates of quick touches rely on priors: {advice}."
        )
    if subject.is_wrong:
        linear_n = _linear_rms_n(subject, recordings)
        warnings.append(
            f"the force of the calibration's own touches is {1e3 * subject.rms_n:.0f} mN off (rms; linear regression "
            f"{1e3 * linear_n:.0f} mN): this subject does not fit them; check scene, sites and units."
        )
    if subject.coverage_factor > 2:
        warnings.append(
            f"intervals had to be made {subject.coverage_factor:.1f} times as wide to cover the calibration's own "
            "touches: the model misses something."
        )
    return warnings


def _linear_rms_n(subject: Subject, recordings: Sequence[Recording]) -> float:
    """Rms error of linear regression on its own recordings. [N]"""
    linear = subject.baselines["linear"]
    off = np.concatenate([linear.force_n(one.volts) - np.asarray(one.force_n) for one in recordings])
    return float(np.sqrt(np.nanmean(off**2)))


def _let_go_quickly(recording: Recording) -> bool:
    """Whether a touch of the recording is let go within `QUICKLY_S`."""
    time_s, force_n = recording.time_s, np.asarray(recording.force_n)
    before_n = np.interp(time_s - QUICKLY_S, time_s, force_n)
    return bool(((before_n >= LEAST_TOUCH_N) & (force_n < REST_FORCE_N)).any())


def _two_balances_n(subject: Subject) -> dict[str, Array]:
    """Forces at which the person's vessels could rest in two states, by the sites of touches that reach them."""
    factors = dict(zip(NAMES, np.exp(subject.factors_ln), strict=True))
    own = {field: getattr(subject.base, field) * factors[name] for name in NAMES for field in PRIORS[name].fields}
    found = {}
    for side, most_n in subject.most_force_n.items():
        forces_n = np.linspace(0.0, most_n, 101)
        proximal, distal = 1e4 * subject.person().pressures(forces_n, np.full(101, SITES[side]))
        state = steady_state(subject.base.replace(**own), proximal_pressure_pa=proximal, distal_pressure_pa=distal)
        if state.two_branches.any():
            found[side] = forces_n[state.two_branches]
    return found


def _judged(subject: Subject, recordings: Sequence[Recording]) -> tuple[Subject, float]:
    """The subject with what its own recordings add: a correction, the force's error, intervals that cover it.

    And the median half width of these intervals over touches, infinite where most have no upper bound. [N]
    """
    estimates = []
    for one in recordings:
        kalman = KalmanFilter(subject.sensor, subject.noise)
        since = [None, *np.diff(one.time_s)]
        estimates.append([kalman.update_sample(volts, dt) for volts, dt in zip(one.volts.T, since, strict=True)])
    subject = replace(subject, correction=_correction(subject.person(), recordings, estimates))
    interval = subject.force_interval()
    errors, ratios, widths = [], [], []
    for one, of_one in zip(recordings, estimates, strict=True):
        estimate, force = interval.of(of_one), np.asarray(one.force_n)
        # At rest an interval ends at 0, wherever the estimate lies: that says nothing of its width.
        judged = np.isfinite(estimate.high_n) & (force >= REST_FORCE_N)
        widths.append((estimate.high_n - estimate.low_n)[force >= TOUCH_N])
        error = (estimate.force_n - force)[judged]
        above, below = estimate.high_n - estimate.force_n, estimate.force_n - estimate.low_n
        half = np.where(error < 0, above[judged], below[judged])
        errors.append(error)
        ratios.append(np.abs(error)[half > 0] / half[half > 0])
    half_width_n = 0.5 * float(np.median(np.concatenate(widths)))
    if not (error := np.concatenate(errors)).size:
        return subject, half_width_n
    ratio = np.concatenate(ratios)
    factor = max(1.0, float(np.quantile(ratio, COVERED)) / BY_CHANCE) if ratio.size else 1.0
    rms_n = float(np.sqrt(np.mean(error**2)))
    return replace(subject, rms_n=rms_n, coverage_factor=factor), half_width_n * factor


def _correction(
    who: Person, recordings: Sequence[Recording], estimates: Sequence[Sequence[PressureEstimate]]
) -> Correction:
    """The curve from the estimated pressures of one-sided touches to those applied."""
    sides = []
    for side, site in enumerate((1.0, 0.0)):
        time_s, estimated, applied = [np.empty(0)], [np.empty(0)], [np.empty(0)]
        for one, of_one in zip(recordings, estimates, strict=True):
            at = np.asarray(one.site) == site
            time_s.append(one.time_s[at])
            estimated.append(touch_pressure(np.array([estimate.touch[side] for estimate in of_one]))[at])
            applied.append(who.pressures(np.asarray(one.force_n), np.asarray(one.site))[side][at])
        sides.append((np.concatenate(time_s), np.concatenate(estimated), np.concatenate(applied)))
    return fit_correction(vessel_closure(who), sides)


def _checked(recording: Recording, scene: Scene) -> Recording:
    """The recording, if it can calibrate: force and site known, a time of rest, no reading at the converter's limit."""
    name = recording.name
    if recording.force_n is None:
        raise InputError(f"{name}: has no column force_n; calibrating needs the force in newtons.")
    if np.isnan(recording.force_n).any():
        line = int(np.flatnonzero(np.isnan(recording.force_n))[0]) + 2
        raise InputError(f"{name} line {line}: force_n is empty; calibrating needs it in every row.")
    if np.ptp(recording.force_n) == 0:
        raise InputError(f"{name}: force_n is constant at {recording.force_n[0]:g} N; press the finger.")
    most_n = float(recording.force_n.max())
    if not LEAST_TOUCH_N <= most_n <= MOST_TOUCH_N:
        raise InputError(
            f"{name}: force_n reaches {most_n:.3g} N; press up to 1 N or more, {MOST_TOUCH_N:g} N at most, "
            "and give it in newtons."
        )
    untouched = recording.force_n < REST_FORCE_N
    rest_s = float(np.diff(recording.time_s)[untouched[1:]].sum())
    if rest_s < REST_S:
        raise InputError(
            f"{name}: the finger rests (force_n below {REST_FORCE_N:g} N) for {rest_s:.2g} s; "
            f"record at least {REST_S:g} s without a touch."
        )
    _check_times(recording)
    _check_readings(recording, untouched, scene.electronics.adc_range_v)
    if recording.site is None:
        share = scene.touch.proximal_share
        site = {1.0: 1.0, 0.0: 0.0}.get(share, np.nan)
        return replace(recording, site=np.full(recording.time_s.shape, site))
    return recording


def _check_times(recording: Recording) -> None:
    """Raise InputError where samples lie too far apart, or are too few at an even rate."""
    name, steps_s = recording.name, np.diff(recording.time_s)
    usual_s, longest = float(np.median(steps_s)), int(np.argmax(steps_s))
    if usual_s > LONGEST_STEP_S:
        raise InputError(
            f"{name}: samples lie {usual_s:.2g} s apart; record at {1 / LONGEST_STEP_S:g} Hz or faster, "
            "with time_s in seconds."
        )
    if steps_s[longest] > LONGEST_PAUSE_S:
        raise InputError(
            f"{name}: nothing was recorded for {steps_s[longest]:.3g} s after time_s = {recording.time_s[longest]:g}; "
            "split the recording there."
        )
    if usual_s * len(steps_s) < 0.5 * steps_s.sum():
        raise InputError(
            f"{name}: {len(steps_s) + 1} samples, mostly {usual_s:.2g} s apart, span {steps_s.sum():.3g} s; "
            "record at an even rate (empty cells are gaps)."
        )


def _check_readings(recording: Recording, untouched: NDArray[np.bool_], limit_v: float) -> None:
    """Raise InputError for a reading that is at its converter's limit, or hardly there."""
    name = recording.name
    for title, volts in zip(recording.names, recording.volts, strict=True):
        at_limit, seen = int(np.sum(volts >= SATURATED * limit_v)), np.isfinite(volts)
        if at_limit > 0.01 * len(volts):
            raise InputError(
                f"{name}: column {title!r} is saturated ({limit_v:g} V) in {at_limit} samples; lower the LED's power."
            )
        if seen.mean() < LEAST_SEEN or seen[untouched].sum() < LEAST_AT_REST:
            raise InputError(
                f"{name}: column {title!r} has {int(seen.sum())} of {len(volts)} samples, "
                f"{int(seen[untouched].sum())} of them without a touch; record it throughout."
            )


def _rest_volts(recordings: Sequence[Recording]) -> Array:
    """Median of every reading while the finger rests. [V]"""
    still = [one.volts[:, np.asarray(one.force_n) < REST_FORCE_N] for one in recordings]
    return np.asarray(np.nanmedian(np.concatenate(still, axis=1), axis=1))


def _most_force(recordings: Sequence[Recording]) -> dict[str, float]:
    """The largest force by site."""
    most: dict[str, float] = {}
    for one in recordings:
        assert one.force_n is not None and one.site is not None
        for name, at in (("proximal", one.site == 1.0), ("distal", one.site == 0.0), ("even", np.isnan(one.site))):
            if at.any():
                most[name] = max(most.get(name, 0.0), float(one.force_n[at].max()))
    return most


def _baselines(recordings: Sequence[Recording]) -> dict[str, Regression]:
    volts = np.concatenate([whole_samples(one.volts) for one in recordings], axis=1)
    force = np.concatenate([np.asarray(one.force_n) for one in recordings])
    whole = np.isfinite(volts).all(0)
    found = {"linear": linear_regression, "components": component_regression}
    return {name: fit(volts[:, whole], force[whole]) for name, fit in found.items()}


def _dataset(recordings: Sequence[Recording], fitted: Fitted, profile: Profile) -> xr.Dataset:
    """The recordings beside what was fitted, one after the other, and the factors' profile likelihoods."""
    which = np.concatenate([np.full(len(one.time_s), k) for k, one in enumerate(recordings)])
    force = np.concatenate([np.asarray(one.force_n) for one in recordings])
    site = np.concatenate([np.asarray(one.site) for one in recordings])
    data = variable("recording", "sample", which, "number of the recording")
    data |= variable("time_s", "sample", np.concatenate([one.time_s for one in recordings]), "time", units="s")
    data |= variable("force_n", "sample", force, "known force", units="N")
    data |= variable("site", "sample", site, "1 proximal, 0 distal, NaN even")
    over = ("reading", "sample")
    volts = np.concatenate([one.volts for one in recordings], axis=1)
    data |= variable("volts", over, volts, "recorded voltage", units="V")
    data |= variable("volts_fitted", over, np.concatenate(fitted.predicted_v, axis=1), "fitted voltage", units="V")
    along = ("factor", "place")
    text = "factor held there, all others fitted"
    data |= variable("profile_factor", along, np.exp(profile.factors_ln), text)
    data |= variable("profile_deviance", along, profile.deviance, "squared residuals beyond those of the best fit")
    text = "the same were the fit quadratic"
    data |= variable("profile_quadratic", along, profile.offset**2, text)
    return xr.Dataset(data, {"reading": list(recordings[0].names), "factor": list(profile.names)})

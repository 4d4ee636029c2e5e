"""Recordings that calibrate: which are refused, and what the others lack of the protocol of touches."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ...errors import InputError
from ...scene import Scene
from ...scene.importers.sensor_recordings import Recording
from ...scene.protocol import CLOSING_N, FIRST_REST_S, LEAST_TOUCHES, LEVEL_N, SIDE_S
from ...sensor import electronics
from .body_noise import REST_FORCE_N
from .person import SIDES
from .reading_table import reading_names, site_of
from .scores import runs

# Least rest before the first touch of a recording [s], and its largest force, at least and at most [N].
REST_S, LEAST_TOUCH_N, MOST_TOUCH_N = 1.0, 0.2, 20.0
# A touch reaches this force before the finger rests again [N]; forces above the second are in grams.
TOUCHED_N, GRAMS = 0.1, 30.0
# All recordings together have so many touches at the least, and rates, of each in so many parts, that differ by less
# than this part.
LEAST_TOUCHES_OF_ALL, RATE_PARTS, SAME_RATE = 8, 5, 0.2
# Longest usual step from sample to sample, and longest pause. [s]
LONGEST_STEP_S, LONGEST_PAUSE_S = 0.5, 60.0
# Least number of a reading's samples at rest, and least valid part of all.
LEAST_AT_REST, LEAST_PART = 10, 0.1
# A side lacks what it has less of than this part of the protocol's.
ENOUGH = 0.4
# Touches are quick whose force rises or falls by so much within a time; each side has so many of either. [N, s, 1]
QUICK_N, QUICK_S, QUICK_TOUCHES = 0.15, 0.3, 2


def checked(recordings: Sequence[Recording], scene: Scene) -> list[Recording]:
    """The recordings with the scene's readings and their sites; raises InputError unless they can calibrate."""
    names = reading_names(scene)
    given = [with_site(recording.of(names), scene) for recording in recordings]
    if not given:
        raise InputError("calibrate needs at least one recording of a known force.")
    fault = next(_faults_together(given), None)
    if fault:
        raise InputError(f"{', '.join(recording.name for recording in given)}: {fault}")
    return given


def with_site(recording: Recording, scene: Scene) -> Recording:
    """The recording with its site; raises InputError unless it can be one of a calibration."""
    fault = next(_faults(recording, scene.electronics.adc_range_v), None)
    if fault:
        raise InputError(f"{recording.name}{fault}")
    if recording.site is not None:
        return recording
    return replace(recording, site=site_of(scene, recording.time_s))


def joined(recordings: Sequence[Recording]) -> Recording:
    """All samples of recordings with force and site, one after the other; times begin anew with each."""
    force_n, site = ([np.asarray(getattr(recording, name)) for recording in recordings] for name in ("force_n", "site"))
    parts = [recording.time_s for recording in recordings], [recording.volts for recording in recordings], force_n, site
    return Recording("all", recordings[0].names, *(np.concatenate(part, axis=-1) for part in parts))


def _faults(recording: Recording, limit_v: float) -> Iterator[str]:
    """Why a recording cannot calibrate: no force, no rest, times too far apart, readings saturated or missing."""
    force_n, time_s, steps_s = recording.force_n, recording.time_s, np.diff(recording.time_s)
    if force_n is None:
        yield ": has no column force_n; calibrating needs the force in newtons."
        return
    if (empty := np.isnan(force_n)).any():
        yield f" line {int(np.argmax(empty)) + 2}: force_n is empty; calibrating needs it in every row."
    rest, most_n = force_n < REST_FORCE_N, force_n.max()
    usual_s, longest = float(np.median(steps_s)), int(np.argmax(steps_s))
    first_rest_s = float(time_s[np.argmin(rest)] - time_s[0])
    faults = {
        f"force_n reaches {most_n:.3g}: that is in grams; divide it by 102.": most_n > GRAMS,
        f"force_n is constant at {force_n[0]:g} N; press the finger.": np.ptp(force_n) == 0,
        f"force_n reaches {most_n:.3g} N; press up to 1 N or more, {MOST_TOUCH_N:g} N at most, and give it in "
        "newtons.": not LEAST_TOUCH_N <= most_n <= MOST_TOUCH_N,
        f"the finger rests (force_n below {REST_FORCE_N:g} N) for {first_rest_s:.2g} s before the first touch; begin "
        f"with {FIRST_REST_S:g} s without a touch.": first_rest_s < REST_S,
        f"samples lie {usual_s:.2g} s apart; record at {1 / LONGEST_STEP_S:g} Hz or faster, with time_s in "
        "seconds.": usual_s > LONGEST_STEP_S,
        f"nothing was recorded for {steps_s[longest]:.3g} s after time_s = {time_s[longest]:g}; split the recording "
        "there.": steps_s[longest] > LONGEST_PAUSE_S,
        f"{len(time_s)} samples, mostly {usual_s:.2g} s apart, span {steps_s.sum():.3g} s; record at an even rate "
        "(empty cells are gaps).": usual_s * len(steps_s) < 0.5 * steps_s.sum(),
    }
    for title, volts in zip(recording.names, recording.volts, strict=True):
        at_limit, valid = int(electronics.recorded_at_limit(volts, limit_v).sum()), np.isfinite(volts)
        faults |= {
            f"column {title!r} is saturated ({limit_v:g} V) in {at_limit} samples; lower the LED's power.": (
                at_limit > 0.01 * len(volts)
            ),
            f"column {title!r} has {valid.sum()} of {len(volts)} samples, {valid[rest].sum()} of them without a touch; "
            "record it throughout.": valid.mean() < LEAST_PART or valid[rest].sum() < LEAST_AT_REST,
        }
    yield from (f": {message}" for message, met in faults.items() if met)


def _touches(recording: Recording, side: float) -> list[slice]:
    """The samples of each touch of a side, by its number in `site`, from rest to rest; even touches are of both."""
    force_n, site = np.asarray(recording.force_n), np.asarray(recording.site)
    touched = (force_n >= REST_FORCE_N) & (np.isnan(site) | (site == side))
    return [slice(start, stop) for start, stop in runs(touched) if force_n[start:stop].max() >= TOUCHED_N]


def _faults_together(recordings: Sequence[Recording]) -> Iterator[str]:
    """Why recordings that could calibrate cannot do so together."""
    parts = [part for one in recordings for part in np.array_split(np.diff(one.time_s), RATE_PARTS) if part.size]
    steps_s = [float(np.median(part)) for part in parts]
    if max(steps_s) > (1.0 + SAME_RATE) * min(steps_s):
        yield (
            f"recorded at {1.0 / max(steps_s):.3g} and {1.0 / min(steps_s):.3g} Hz; record all of a calibration at one "
            "rate."
        )
    counts = [sum(len(_touches(recording, number)) for recording in recordings) for number in (1.0, 0.0)]
    for side, count in zip(SIDES, counts, strict=True):
        if not count:
            yield f"no {side} touch was recorded; record touches of both sides, as `nailoptics protocol` has them."
    if sum(counts) < LEAST_TOUCHES_OF_ALL:
        yield (
            f"{sum(counts)} touches were recorded; record {LEAST_TOUCHES_OF_ALL} or more, with rests between, as "
            "`nailoptics protocol` has them."
        )


def lacking(recordings: Sequence[Recording]) -> list[str]:
    """What recordings lack of the protocol, by what was measured: a sentence for each side, and for the rest."""
    sentences = []
    for side, number in zip(SIDES, (1.0, 0.0), strict=True):
        if parts := _lacking(recordings, number):
            sentences.append(f"{side} touches lack {', '.join(parts)}: record those of `nailoptics protocol`, too.")
    rests_s = [
        float(recording.time_s[np.argmax(np.asarray(recording.force_n) >= REST_FORCE_N)] - recording.time_s[0])
        for recording in recordings
    ]
    if min(rests_s) < ENOUGH * FIRST_REST_S:
        sentences.append(f"a recording begins with {min(rests_s):.2g} s of rest: begin with {FIRST_REST_S:g} s.")
    return sentences


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

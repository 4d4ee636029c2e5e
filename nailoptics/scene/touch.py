"""The touch: force over time as a step, ramp, cycle, list of steps, held force, protocol of calibration or CSV."""

import math
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field

from ..errors import InputError
from .base import LEAST_AREA_MM2, MOST_FORCE_N, USUAL_CONTACT_AREA_MM2, Fraction, NonNegative, Positive, Table
from .importers.sensor_recordings import IN_NEWTONS, PRESSURES, check_columns, with_recording
from .protocol import MOST_DONNINGS, is_off, protocol

SHARES = {"proximal": 1.0, "distal": 0.0, "even": 0.5}
# The paper's subjects pressed slowly, at 0.05 Hz, and its readings are means of three cycles.
CYCLE: dict[str, Any] = {"period_s": 20.0, "cycles": 3, "waveform": "sine"}
# A sine goes through so many corners in a period: between them it is off by 4e-5 of its force.
CORNERS_PER_PERIOD = 256
# The last of a list of steps is held so long if no duration is given. [s]
LAST_STEP_S = 2.0


def _in_newtons(force_n: float) -> float:
    if force_n > MOST_FORCE_N:
        raise ValueError(f"{force_n:g} N must be at most {MOST_FORCE_N:g} N; {IN_NEWTONS}")
    return force_n


Force = Annotated[float, Field(ge=0, json_schema_extra={"maximum": MOST_FORCE_N}), AfterValidator(_in_newtons)]
Area = Annotated[float, Field(ge=LEAST_AREA_MM2)]
# Columns that may stand beside a recorded force.
BESIDE_FORCE = ("shear_n", "contact_area_mm2", "proximal_share")


class ForceStep(Table):
    """One of a list of steps."""

    start_s: NonNegative
    """Time at which the force steps to force_n. [s]"""
    force_n: Force
    """Force until the next step. [N]"""


class Touch(Table):
    """Force on the fingertip over time, and its distribution over the pulp."""

    profile: Literal["step", "ramp", "hold", "cycle", "steps", "protocol", "recorded"] = "step"
    """step: force_n from start_s to release_s; ramp: with linear edges; hold: constant; cycle: periodic between 0 and
    force_n; steps: a list of them; protocol: varied touches of both sides, to calibrate with; recorded: from a CSV."""
    force_n: Force = 1.0
    """Force of the step, ramp or hold, and the largest of a cycle. [N]"""
    start_s: NonNegative = 0.25
    """Start of the force. [s]"""
    ramp_s: Positive = 1.0
    """Duration of a ramp's rise, and of its fall. [s]"""
    release_s: NonNegative = 2.25
    """Release of the force (a ramp begins to fall). [s]"""
    period_s: Positive | None = None
    """Duration of one cycle; 20 if not given, the paper's. [s]"""
    cycles: Annotated[int, Field(ge=1, le=10_000)] | None = None
    """Number of cycles; 3 if not given, the paper's."""
    waveform: Literal["sine", "triangle"] | None = None
    """Shape of a cycle: (1 - cos)/2 or triangular; sine if not given."""
    steps: Annotated[tuple[ForceStep, ...], Field(min_length=1, max_length=10_000)] | None = None
    """The list of steps, in order of time; before the first the force is 0."""
    protocol_seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    """Seed of the protocol's touches, as of the command protocol --seed."""
    protocol_donnings: Annotated[int, Field(ge=1, le=MOST_DONNINGS)] = 1
    """How often the sensor is put on in it, by which readings change as body.drift.donning says."""
    duration_s: Annotated[float, Field(gt=0, le=86400)] = 4.0
    """Simulated time; if not given 4, the end of the last cycle, or 2 after the last step. [s]"""
    sample_rate_hz: Annotated[float, Field(gt=0, le=100_000)] = 100.0
    """Samples per second of the results; the touch itself does not depend on it. [Hz]"""
    file: str | None = None
    """Recorded touch in the scene's folder: a CSV with columns time_s and force_n, or time_s, proximal_pressure_pa and
    distal_pressure_pa, or all of them; optionally shear_n, contact_area_mm2 and proximal_share."""
    recorded_time_s: tuple[float, ...] | None = None
    """The recorded times; filled from file. [s]"""
    recorded_force_n: tuple[NonNegative, ...] | None = None
    """The recorded forces; filled from file. [N]"""
    recorded_proximal_pressure_pa: tuple[NonNegative, ...] | None = None
    """The recorded pressures on the proximal pulp (the veins); filled from file. [Pa]"""
    recorded_distal_pressure_pa: tuple[NonNegative, ...] | None = None
    """The recorded pressures on the distal pulp; filled from file. [Pa]"""
    recorded_shear_n: tuple[float, ...] | None = None
    """The recorded longitudinal forces; filled from file. [N]"""
    recorded_contact_area_mm2: tuple[Area, ...] | None = None
    """The recorded areas of the touch; filled from file. [mm^2]"""
    recorded_proximal_share: tuple[Fraction, ...] | None = None
    """The recorded proximal shares; filled from file."""
    contact_area_mm2: Area = USUAL_CONTACT_AREA_MM2
    """Area of the whole touch: a one-sided touch presses on all of it, an even one on half of it per side. [mm^2]"""
    contact_force_n: Annotated[float, Field(ge=0.01, le=100)] | None = None
    """Force at which all areas are as stated: they grow with force^(2/3), as in Hertz's contact of a sphere. If not
    given they do not grow. [N]"""
    distal_onset_n: Annotated[float, Field(ge=0, le=100)] | None = None
    """Force from which the contact reaches the distal pulp: only what exceeds it has the shares that are stated, the
    rest presses proximally. With 0.6 a white band begins past 1 N, as in the paper's Fig. 2; 0 if not given. [N]"""
    site: Literal["proximal", "distal", "even"] | None = None
    """Side of the touch: sets proximal_share to 1, 0 or 0.5."""
    proximal_share: Fraction = 0.5
    """Share of the force that presses on the proximal pulp (the veins); the rest presses distally."""
    proximal_area_mm2: Area | None = None
    """Area on which the proximal share presses; by default its share of contact_area_mm2, but at least half. [mm^2]"""
    distal_area_mm2: Area | None = None
    """Area on which the distal share presses; by default its share of contact_area_mm2, but at least half. [mm^2]"""
    distal_relaxation_s: Positive | None = None
    """Time constant of the distal pulp's recovery on release; it yields immediately on loading. 0.2 makes the distal
    reading as slow on release as in the paper. If not given it recovers immediately. [s]"""
    # A fingerpad that is held down pushes back less and less, within seconds (Pawluk and Howe 1999, J. Biomech. Eng.
    # 121:605): under a constant force it spreads. By how much the contact grows is an assumption; 0.1 in 2 s is usual.
    creep: Annotated[float, Field(ge=0, lt=1)] | None = None
    """Fraction of its pressure that a held touch loses by creep of the pulp; none if not given."""
    creep_s: Positive = 2.0
    """Time constant of the creep, and of its recovery. [s]"""
    shear_n: Annotated[float, Field(ge=-100, le=100)] | None = None
    """Longitudinal force at the largest normal force, positive towards the tip; proportional to the normal force. The
    paper says that it widens the white band, more than normal force does: here its magnitude over half of
    contact_area_mm2, or distal_area_mm2, is an additional pressure on the distal capillaries. [N]"""

    @property
    def stated_contact(self) -> set[str]:
        """Fields of the contact that this touch makes no unknown: measured, or of a touch on one side alone."""
        sides = self.recorded_proximal_pressure_pa is not None or self.proximal_area_mm2 or self.distal_area_mm2
        area = sides or self.recorded_contact_area_mm2 is not None
        share = sides or self.recorded_proximal_share is not None or self.proximal_share in (0.0, 1.0)
        stated = {"touch.contact_area_mm2": area, "touch.proximal_share": share}
        return {field for field, is_stated in stated.items() if is_stated}

    @classmethod
    def _filled(cls, data: dict[str, Any], folder: Path | None) -> dict[str, Any]:
        known = ("force_n", *PRESSURES, *BESIDE_FORCE)
        data = with_recording(data, folder, "touch", known, either=(("force_n",), PRESSURES))
        if data.get("profile") == "protocol" and "recorded_time_s" not in data:
            seed, donnings = data.get("protocol_seed", 0), data.get("protocol_donnings", 1)
            with suppress(InputError):  # the fields' rules say what is wrong
                drawn = protocol(seed, donnings=donnings)
                data = data | {f"recorded_{name}": tuple(column.tolist()) for name, column in drawn._asdict().items()}
        if data.get("profile") == "cycle":
            data = CYCLE | data
        if data.get("site") in tuple(SHARES):
            data = {"proximal_share": SHARES[data["site"]]} | data
        return _duration_of(data) | data

    def _check(self) -> None:
        if (self.profile in ("recorded", "protocol")) != (self.recorded_time_s is not None):
            raise ValueError('profile = "recorded" and file go together; give both or neither')
        if self.profile == "protocol" and (self.file is not None or self.site is not None):
            raise ValueError('profile = "protocol" touches both sides, as drawn; leave out site and file')
        if (self.profile == "steps") != (self.steps is not None):
            raise ValueError('profile = "steps" and the list steps go together; give both or neither')
        for name in CYCLE:
            if self.profile != "cycle" and getattr(self, name) is not None:
                raise ValueError(f'{name} = {getattr(self, name)} belongs to profile = "cycle"; leave it out')
        if self.recorded_time_s is not None:
            names = ("time_s", "force_n", *BESIDE_FORCE, *PRESSURES)
            columns = {name: getattr(self, f"recorded_{name}") for name in names}
            check_columns({name: column for name, column in columns.items() if column is not None}, "touch.file")
        if self.distal_onset_n and self.proximal_share == 0.0:
            why = "is for a touch that presses on the proximal pulp first, and proximal_share is 0; leave it out"
            raise ValueError(f"distal_onset_n = {self.distal_onset_n:g} {why}")
        if self.site is not None and self.proximal_share != SHARES[self.site]:
            set_to = f'site = "{self.site}" sets proximal_share to {SHARES[self.site]:g}'
            raise ValueError(f"{set_to}, but it is {self.proximal_share:g}; give one of them")
        if self.profile in ("step", "ramp") and self.release_s <= self.start_s:
            raise ValueError(f"release_s = {self.release_s} must come after start_s = {self.start_s}")
        end_s = self.start_s + self.ramp_s
        if self.profile == "ramp" and self.release_s < end_s:
            raise ValueError(f"release_s = {self.release_s} cuts the ramp, which ends at {end_s} s")
        steps = self.steps or ()
        for i, (before, after) in enumerate(pairwise(steps)):
            if after.start_s <= before.start_s:
                earlier = f"steps[{i}].start_s = {before.start_s}"
                raise ValueError(f"steps[{i + 1}].start_s = {after.start_s} must come after {earlier}")
        rate = f"sample_rate_hz = {self.sample_rate_hz:g}"
        if self.intervals > 1e7:
            raise ValueError(f"{rate} takes {self.intervals:g} samples of the touch; at most 1e7")
        if self.times_s().size < 2:
            raise ValueError(f"{rate} gives one sample of the touch; raise it, or touch longer")

    @property
    def intervals(self) -> float:
        """Intervals of sampling in the simulated time."""
        time_s = self.recorded_time_s
        return (self.duration_s if time_s is None else time_s[-1] - time_s[0]) * self.sample_rate_hz

    def times_s(self) -> np.ndarray:
        """Sample times, (t,) float, from the start of the touch. [s]"""
        first_s = self.recorded_time_s[0] if self.recorded_time_s else 0.0
        return first_s + np.arange(math.floor(self.intervals + 1e-9) + 1) / self.sample_rate_hz

    def is_off(self, at_s: np.ndarray) -> np.ndarray:
        """Whether the sensor is off the finger at some times (T,), bool."""
        return is_off(at_s, *self.corners()) if self.profile == "protocol" else np.zeros(at_s.shape, bool)

    def corners(self) -> tuple[np.ndarray, np.ndarray]:
        """Times [s] and forces [N] between which the force is linear, (k,) float each; a time twice where it jumps.

        A recording of pressures alone has no force: NaN.
        """
        if self.recorded_time_s is not None:
            time_s = np.array(self.recorded_time_s)
            return time_s, np.array(self.recorded_force_n or [math.nan] * len(time_s))
        if self.profile == "hold":
            points = [(0.0, self.force_n), (self.duration_s, self.force_n)]
        elif self.profile in ("step", "steps"):
            steps = [(step.start_s, step.force_n) for step in self.steps or ()]
            steps = steps or [(self.start_s, self.force_n), (self.release_s, 0.0)]
            before = [0.0, *(force for _, force in steps)]
            points = [(t, f) for (t, after), last in zip(steps, before, strict=False) for f in (last, after)]
        elif self.profile == "ramp":
            times = [self.start_s, self.start_s + self.ramp_s, self.release_s, self.release_s + self.ramp_s]
            points = list(zip(times, [0.0, self.force_n, self.force_n, 0.0], strict=True))
        else:
            period_s, cycles = self.period_s or CYCLE["period_s"], self.cycles or CYCLE["cycles"]
            per_period = 2 if self.waveform == "triangle" else CORNERS_PER_PERIOD
            turns = np.arange(cycles * per_period + 1) / per_period
            # Where it is 0 it is so exactly.
            shape = 1 - np.abs(2 * (turns % 1) - 1) if per_period == 2 else np.sin(np.pi * (turns % 1)) ** 2
            return self.start_s + period_s * turns, self.force_n * shape
        time_s, force_n = np.array(points).T
        return time_s, force_n


def _duration_of(data: dict[str, Any]) -> dict[str, float]:
    """The duration that a cycle or a list of steps has where none is given, if it can be computed."""
    with suppress(TypeError, KeyError, IndexError, ValueError, AttributeError):  # the fields' rules say what is wrong
        if data.get("profile") == "cycle":
            return {"duration_s": float(data.get("start_s", 0.25) + data["cycles"] * data["period_s"])}
        if data.get("profile") == "steps":
            last = data["steps"][-1]
            return {"duration_s": float(last["start_s"] if isinstance(last, dict) else last.start_s) + LAST_STEP_S}
    return {}

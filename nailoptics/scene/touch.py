"""The touch: force over time as a step, a ramp, a held force or a recorded CSV."""

import math
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, ValidationInfo, model_validator

from ..errors import InputError
from .base import USUAL_CONTACT_AREA_MM2, Fraction, NonNegative, Positive, Table
from .text_files import read_rows


class Touch(Table):
    """Force on the fingertip over time, and how it spreads over the pulp."""

    profile: Literal["step", "ramp", "hold", "recorded"] = "step"
    """step: force_n from start_s to release_s; ramp: with linear edges; hold: constant; recorded: from a CSV."""
    force_n: Annotated[float, Field(ge=0, le=100)] = 1.0
    """Force of the step, ramp or hold. [N]"""
    start_s: NonNegative = 0.25
    """When the force starts. [s]"""
    ramp_s: Positive = 1.0
    """Duration of a ramp's rise, and of its fall. [s]"""
    release_s: NonNegative = 2.25
    """When the force is released (a ramp begins to fall). [s]"""
    duration_s: Annotated[float, Field(gt=0, le=86400)] = 4.0
    """Length of the simulated time. [s]"""
    sample_rate_hz: Annotated[float, Field(gt=0, le=100_000)] = 100.0
    """Samples per second of the results. [Hz]"""
    file: str | None = None
    """Recorded touch: a CSV with columns time_s, force_n, beside the scene file."""
    recorded_time_s: tuple[float, ...] | None = None
    """The recorded times; filled from file. [s]"""
    recorded_force_n: tuple[NonNegative, ...] | None = None
    """The recorded forces; filled from file. [N]"""
    contact_area_mm2: Positive = USUAL_CONTACT_AREA_MM2
    """Area of the whole touch: on one side it presses there with all of it, evenly with half of it on each. [mm^2]"""
    proximal_share: Fraction = 0.5
    """Share of the force that presses on the proximal pulp (the veins); the rest presses distally."""
    proximal_area_mm2: Positive | None = None
    """Area on which the proximal share presses; by default its part of the contact, but at least half. [mm^2]"""
    distal_area_mm2: Positive | None = None
    """Area on which the distal share presses; by default its part of the contact, but at least half. [mm^2]"""

    @model_validator(mode="before")
    @classmethod
    def _read_the_recording(cls, data: object, info: ValidationInfo) -> object:
        if isinstance(data, dict) and isinstance(data.get("file"), str) and "recorded_time_s" not in data:
            folder = (info.context or {}).get("folder") or Path()
            time_s, force_n = read_recording(Path(folder) / data["file"])
            return data | {"recorded_time_s": time_s, "recorded_force_n": force_n}
        return data

    @model_validator(mode="after")
    def _profile_is_complete(self) -> Self:
        if (self.profile == "recorded") != (self.recorded_time_s is not None):
            raise ValueError('profile = "recorded" and file go together; give both or neither')
        if self.recorded_time_s is not None and self.recorded_force_n is not None:
            check_recording(self.recorded_time_s, self.recorded_force_n, "touch.file")
        if self.profile in ("step", "ramp") and self.release_s <= self.start_s:
            raise ValueError(f"release_s = {self.release_s} must come after start_s = {self.start_s}")
        if self.profile == "ramp" and self.release_s < self.start_s + self.ramp_s:
            raise ValueError(
                f"release_s = {self.release_s} cuts the ramp, which ends at {self.start_s + self.ramp_s} s"
            )
        if self.duration_s * self.sample_rate_hz > 10_000_000:
            raise ValueError(
                f"duration_s * sample_rate_hz = {self.duration_s * self.sample_rate_hz:g} samples; at most 1e7"
            )
        return self

    def times_s(self) -> np.ndarray:
        """Sample times, (t,) float, from the start of the touch. [s]"""
        if self.recorded_time_s is not None:
            first, last = self.recorded_time_s[0], self.recorded_time_s[-1]
            return first + np.arange(math.floor((last - first) * self.sample_rate_hz + 1e-9) + 1) / self.sample_rate_hz
        return np.arange(math.floor(self.duration_s * self.sample_rate_hz + 1e-9) + 1) / self.sample_rate_hz

    def force_at(self, time_s: np.ndarray) -> np.ndarray:
        """Force at the given times, (t,) float. [N]"""
        time_s = np.asarray(time_s, float)
        if self.recorded_time_s is not None and self.recorded_force_n is not None:
            return np.interp(time_s, self.recorded_time_s, self.recorded_force_n)
        if self.profile == "hold":
            return np.full(time_s.shape, self.force_n)
        if self.profile == "step":
            return np.where((time_s >= self.start_s) & (time_s < self.release_s), self.force_n, 0.0)
        knots = [self.start_s, self.start_s + self.ramp_s, self.release_s, self.release_s + self.ramp_s]
        return np.interp(time_s, knots, [0.0, self.force_n, self.force_n, 0.0])


def read_recording(path: Path) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Time [s] and force [N] of a recorded touch, from a CSV with the header time_s,force_n."""
    name = f"touch.file {str(path)!r}"
    lines = read_rows(path, "a CSV with columns time_s,force_n", shown=name)
    header = [cell.strip() for cell in lines[0][1]] if lines else []
    if "time_s" not in header or "force_n" not in header:
        raise InputError(f"{name} needs a header with time_s and force_n, has {','.join(header) or 'nothing'!r}.")
    columns = header.index("time_s"), header.index("force_n")
    time_s, force_n = [], []
    for number, row in lines[1:]:
        try:
            time_s.append(float(row[columns[0]]))
            force_n.append(float(row[columns[1]]))
        except (ValueError, IndexError):
            raise InputError(f"{name} line {number}: {','.join(row)!r} is not two numbers.") from None
    check_recording(time_s, force_n, name)
    return tuple(time_s), tuple(force_n)


def check_recording(
    time_s: "list[float] | tuple[float, ...]", force_n: "list[float] | tuple[float, ...]", name: str
) -> None:
    """Raise InputError unless the recording has rising finite times and forces of 0 to 100 N."""
    if len(time_s) < 2 or len(time_s) != len(force_n):
        raise InputError(f"{name} needs at least two samples of time and force, has {len(time_s)} and {len(force_n)}.")
    if not np.all(np.isfinite(time_s)) or not np.all(np.isfinite(force_n)):
        raise InputError(f"{name} holds a value that is not finite; remove the sample.")
    falling = np.flatnonzero(np.diff(time_s) <= 0)
    if falling.size:
        at = int(falling[0]) + 1
        raise InputError(
            f"{name}: time_s must rise, but sample {at + 1} ({time_s[at]:g}) follows {time_s[at - 1]:g}; "
            "sort or remove it."
        )
    if min(force_n) < 0 or max(force_n) > 100:
        wrong = min(force_n) if min(force_n) < 0 else max(force_n)
        raise InputError(f"{name}: force_n must lie in 0 to 100 N, found {wrong:g}; check sign and unit.")

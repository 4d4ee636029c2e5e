"""The protocol of touches that a sensor is calibrated with: varied touches below closure, drawn at random."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from .. import checks
from ..errors import InputError
from ..io import write_text

# Regressions of force on readings are worth the touches that they are trained on: varied ones below closure teach them
# more in a minute than slow cycles in three. All figures are judgement, within what fingers do in daily touches.
# The finger rests first, and so long after each touch. [s]
FIRST_REST_S, REST_S = 6.0, (1.0, 4.0)
# Each side is touched for so long, with so many touches, from rest to rest, and levels at the least. [s]
SIDE_S, LEAST_TOUCHES, LEAST_LEVELS = 90.0, 6, 20
# A touch has so many levels, reached in ramps and held. [1, N, s, s]
LEVELS, LEVEL_N, RAMP_S, HOLD_S = (1, 4), (0.1, 1.2), (0.16, 4.0), (0.3, 3.5)
# Of so many touches one begins as quickly as that, and one is let go at once, within a time. [1, s]
QUICK_OF, LET_GO_S = 3, 0.1
# A slow cycle ends each side: it shows where the vessels close. [N, s]
CLOSING_N, CLOSING_S, CLOSING_CORNERS = (1.5, 2.0), 20.0, 64
# The sensor may be taken off and put on again within a rest that is as long as no other, at most so often. [s, 1]
OFF_S, MOST_DONNINGS = 30.0, 4


class Protocol(NamedTuple):
    """Corners between which the force is linear: (k,) float each.

    time_s, force_n : when, and how hard the finger is to press. [s], [N]
    proximal_share : 1 where the proximal side is touched, 0 where the distal one is; it changes within a rest.
    """

    time_s: np.ndarray
    force_n: np.ndarray
    proximal_share: np.ndarray

    def save(self, path: str | Path, *, sample_rate_hz: float = 100.0) -> None:
        """Write the touches as a CSV with so many rows a second, which a scene takes as a recorded touch, too; none
        while the sensor is off."""
        rate_hz = float(checks.positive("sample_rate_hz", sample_rate_hz))
        time_s = np.arange(self.time_s[-1] * rate_hz) / rate_hz
        time_s = time_s[~is_off(time_s, self.time_s, self.force_n)]
        columns = [np.interp(time_s, self.time_s, values) for values in self[1:]]
        rows = (f"{t!r},{n:.4f},{p:.0f}" for t, n, p in zip(time_s.tolist(), *columns, strict=True))
        write_text(Path(path), "\n".join(["time_s,force_n,proximal_share", *rows]) + "\n")


def is_off(at_s: np.ndarray, time_s: np.ndarray, force_n: np.ndarray) -> np.ndarray:
    """Whether the sensor is off the finger at some times (T,), bool, by a protocol's corners (k,)."""
    off = (np.diff(time_s) > OFF_S - REST_S[0]) & (force_n[1:] == 0.0) & (force_n[:-1] == 0.0)
    return np.append(off, False)[np.searchsorted(time_s, at_s, side="right") - 1]


def protocol(seed: int = 0, *, donnings: int = 1) -> Protocol:
    """The touches to calibrate a sensor with, some four minutes, first of the proximal side, then of the distal one.

    seed : others for another person, or another day. A scene whose touch has `profile = "protocol"` makes them.
    donnings : how often the sensor is put on; both sides are touched each time, slowly and harder at the last.

    Returns: Protocol over its corners, whose `save` writes the file to follow. Raises: InputError.
    """
    checks.seed(seed)
    if donnings not in range(1, 1 + MOST_DONNINGS):
        raise InputError(f"donnings = {donnings} must be a whole number from 1 to {MOST_DONNINGS}.")
    rng, time_s, force_n, share = np.random.default_rng(seed), [0.0], [0.0], [1.0]

    def to(force: float, duration_s: float) -> None:
        time_s.append(time_s[-1] + duration_s)
        force_n.append(force)
        share.append(share[-1])

    for left in reversed(range(donnings)):
        if time_s[-1]:
            to(0.0, OFF_S)
        to(0.0, FIRST_REST_S)
        for side in (1.0, 0.0):
            share[-1], start_s, touches, levels = side, time_s[-1], 0, 0
            while touches < LEAST_TOUCHES or min((time_s[-1] - start_s) / SIDE_S, levels / LEAST_LEVELS) < 1 / donnings:
                heights_n = rng.uniform(*LEVEL_N, rng.integers(*LEVELS, endpoint=True))
                for number, level_n in enumerate(heights_n):
                    quick = touches % QUICK_OF == 1 and number == 0
                    to(level_n, RAMP_S[0] if quick else _log_uniform(rng, RAMP_S))
                    to(level_n, _log_uniform(rng, HOLD_S))
                to(0.0, LET_GO_S if touches % QUICK_OF == 0 else _log_uniform(rng, RAMP_S))
                to(0.0, rng.uniform(*REST_S))
                touches, levels = touches + 1, levels + len(heights_n)
            most_n, part = rng.uniform(*CLOSING_N), np.linspace(0.0, 1.0, CLOSING_CORNERS + 1)[1:]
            for height in () if left else np.sin(np.pi * part) ** 2:
                to(most_n * height, CLOSING_S / CLOSING_CORNERS)
            force_n[-1] = 0.0
            to(0.0, REST_S[1])
    return Protocol(np.array(time_s), np.array(force_n), np.array(share))


def _log_uniform(rng: np.random.Generator, ends: tuple[float, float]) -> float:
    return float(np.exp(rng.uniform(*np.log(ends))))

"""The time of a command: what it has taken, and what a limit of time leaves for its study."""

import os
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from .options import TraceOptions
from .terminal import say

if TYPE_CHECKING:
    from .scene import Scene

# Processor time of a command from the start of its process to its study, and from its last word to the end of the
# process, on the machine on which what its study and pages take was measured. [s]
STARTING_CPU_S, ENDING_CPU_S = 0.85, 0.25
# A study without time does the least that it can; it is given this, as a limit of 0 is none. [s]
NO_TIME_S = 1e-3
# Processor time before the first photon (imports of the engine, a finger's geometry, kernels), and of one batch. [s]
FINGER_OPENING_CPU_S, PHANTOM_OPENING_CPU_S = 1.4, 0.5
FINGER_BATCH_CPU_S, PHANTOM_BATCH_CPU_S = 1.2, 0.4
# The same of the least that each of the other studies does.
EXPLANATION_LEAST_CPU_S, TRADEOFF_LEAST_CPU_S, COMPARISON_LEAST_CPU_S, PLACEMENT_LEAST_CPU_S = 1.6, 1.8, 3.3, 4.5
COLOUR_LEAST_CPU_S, EXPLORATION_LEAST_CPU_S = 6.5, 14.0
# Of two photographs of the usual size, which follow a colour's rays. [s]
PHOTOGRAPHS_CPU_S, PHOTOGRAPHS_PX = 31.0, 800 * 600


class CommandTime:
    """What a command has taken since it began, so that its time limit holds for all of it, not for its study alone."""

    def __init__(self) -> None:
        self.begin()

    def begin(self, *, with_process: bool = False) -> None:
        """Begin anew.

        with_process : the process is the command's own, so that it began with the process.
        """
        self._begin = time.perf_counter() - (_age_of_process_s() if with_process else 0.0)

    def left(
        self,
        options: TraceOptions,
        *,
        limit_s: float | None = None,
        opening_cpu_s: float = 0.0,
        least_cpu_s: float,
        pages_cpu_s: float = 0.0,
    ) -> TraceOptions:
        """The options with what is left of max_seconds once the pages are written, which is done after the study.

        Says so where that is less than the least that the command does. All of it takes as much longer than its
        processor time did once as starting now has, on a busy machine or a slow one.

        limit_s : in place of the options' max_seconds, such as the scene's. [s]
        opening_cpu_s : processor time of what the study does not count as its own. [s]
        least_cpu_s : of the least that it does, that included. [s]
        pages_cpu_s : of what is written after it. [s]
        """
        limit_s = limit_s or options.max_seconds
        if limit_s is None:
            return options
        if (missing_s := self.missing_s(limit_s, cpu_s=least_cpu_s + pages_cpu_s)) > 0:
            least_s = f"{limit_s + missing_s:.0f}"
            say(f"max_seconds = {limit_s:g} is too short: the least of this command takes about {least_s} s here now.")
        left_s = -self.missing_s(limit_s, cpu_s=opening_cpu_s + pages_cpu_s)
        return replace(options, max_seconds=max(NO_TIME_S, left_s))

    def missing_s(self, limit_s: float, *, cpu_s: float) -> float:
        """By how much the command would go beyond a limit with so much processor time more; below 0 what is left. [s]

        cpu_s : on the machine on which it was measured; what ending takes is added. [s]
        """
        spent_s = time.perf_counter() - self._begin
        return spent_s + max(1.0, spent_s / STARTING_CPU_S) * (cpu_s + ENDING_CPU_S) - limit_s

    def left_for_light(self, options: TraceOptions, scene: "Scene", *, pages_cpu_s: float = 0.0) -> TraceOptions:
        """The options with what is left of max_seconds for tracing, which counts from the first photon on.

        pages_cpu_s : processor time of what is written after it. [s]
        """
        from .light.tracing import accuracy

        opening_cpu_s, batch_cpu_s = (
            (PHANTOM_OPENING_CPU_S, PHANTOM_BATCH_CPU_S)
            if scene.phantom
            else (FINGER_OPENING_CPU_S, FINGER_BATCH_CPU_S)
        )
        return self.left(
            options,
            limit_s=accuracy(scene, options).max_seconds,
            opening_cpu_s=opening_cpu_s,
            least_cpu_s=opening_cpu_s + len(scene.leds) * batch_cpu_s,
            pages_cpu_s=pages_cpu_s,
        )

    def left_for_colour(self, options: TraceOptions, scene: "Scene", *, photograph: bool) -> tuple[TraceOptions, bool]:
        """The options with what is left of max_seconds for rays, and whether photographs have time; says so if not."""
        from .report.result_files import COLOUR_CPU_S

        width, height = scene.colour.photograph_px
        pictures_cpu_s = PHOTOGRAPHS_CPU_S * max(1.0, width * height / PHOTOGRAPHS_PX) if photograph else 0.0
        pages_cpu_s = COLOUR_CPU_S + pictures_cpu_s
        if photograph and options.max_seconds is not None:
            missing_s = self.missing_s(options.max_seconds, cpu_s=COLOUR_LEAST_CPU_S + pages_cpu_s)
            if missing_s > 0:
                least_s = options.max_seconds + missing_s
                say(f"photographs are left out: with them this command takes about {least_s:.0f} s or more here now.")
                photograph, pages_cpu_s = False, COLOUR_CPU_S
        return self.left(options, least_cpu_s=COLOUR_LEAST_CPU_S, pages_cpu_s=pages_cpu_s), photograph


def _age_of_process_s() -> float:
    """How long this process has run; 0 where the system does not tell. [s]"""
    try:
        ticks = int(Path("/proc/self/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[19])
        return time.clock_gettime(time.CLOCK_BOOTTIME) - ticks / os.sysconf("SC_CLK_TCK")
    except (OSError, AttributeError, LookupError, ValueError):
        return 0.0

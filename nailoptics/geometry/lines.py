"""Grid lines along one axis: every required edge, and steps between them."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

MERGE_MM = 1e-3
"""Edges closer than this share a line, so that no cell is thinner. [mm]"""


def grid_lines(
    required: Iterable[float],
    *,
    wanted: Iterable[float] = (),
    step: Callable[[float], float],
    closed: Sequence[tuple[float, float]] = (),
) -> NDArray[np.float64]:
    """Lines through every required place, with gaps of at most a step between them.

    required : Places that get a line; the first of several within MERGE_MM stands for all. [mm]
    wanted : Places that get a line unless it would come closer than a quarter step to another. [mm]
    step : Largest gap as a function of place. [mm]
    closed : Spans (low, high) that get no line but a required one. [mm]

    Returns: (n,) float, rising. [mm]
    """
    lines: list[float] = []
    for place in sorted(required):
        if not lines or place - lines[-1] > MERGE_MM:
            lines.append(place)

    def is_closed(place: float) -> bool:
        return any(low < place < high for low, high in closed)

    for place in sorted(wanted):
        clear = min(abs(place - line) for line in lines) > 0.25 * step(place)
        if lines[0] < place < lines[-1] and clear and not is_closed(place):
            lines.append(place)
    lines.sort()
    result = lines[:1]
    for low, high in zip(lines, lines[1:], strict=False):
        middle = (low + high) / 2
        pieces = 1 if is_closed(middle) else int(np.ceil((high - low) / step(middle) - 1e-9))
        result += [low + (high - low) * i / pieces for i in range(1, pieces)] + [high]
    return np.array(result)

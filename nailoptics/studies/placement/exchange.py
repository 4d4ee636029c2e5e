"""The search for a layout: LED places on a grid, and for each the photodiodes that tell most, by exchange."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...scene import Placement, Scene
from ...scene.layout import Rectangle
from . import boards
from . import fisher as merit
from .photon_maps import Bank, View

# A wall that leaves less than this part of the board to the photodiodes is not tried.
LEAST_ROOM = 0.4
ROUNDS = 6


@dataclass(frozen=True)
class Spot:
    """A place of the LED and the side of the photodiodes on which it lies (None without a wall)."""

    place_mm: tuple[float, float]
    side: str | None

    @property
    def name(self) -> str:
        """The spot as a layout's name."""
        where = "_".join(f"{'m' if x < 0 else 'p'}{abs(x):.3g}" for x in (v + 0.0 for v in self.place_mm))
        return f"led_{where}" + (f"_{self.side}" if self.side else "")


def spots(base: Scene, placement: Placement) -> list[Spot]:
    """LED places on a grid over the outline, symmetric boards on one half, each with the walls that leave room."""
    outline, die = _outline(base), base.leds[0].size_mm
    low = [m + placement.edge_mm + d / 2 for m, d in zip((outline.u_min, outline.v_min), die, strict=True)]
    high = [m - placement.edge_mm - d / 2 for m, d in zip((outline.u_max, outline.v_max), die, strict=True)]
    axes = []
    for a, b in zip(low, high, strict=True):
        half = max(0, int((b - a) / 2 / placement.led_step_mm + 1e-9))
        axes.append((a + b) / 2 + placement.led_step_mm * np.arange(-half, half + 1))
    mirrored = placement.outline_mm is None and abs(outline.u_min + outline.u_max) < 1e-6
    found = []
    for u in axes[0]:
        # Fingers are symmetric here, so that a layout and its mirror image are one.
        if mirrored and u > 1e-6:
            continue
        for v in axes[1]:
            found += walls_for((float(u), float(v)), base, placement)
    found = [spot for spot in found if _inside(spot.place_mm, die, placement)]
    # The blood zones follow each other along the nail, so walls along it promise most and come first.
    return sorted(found, key=lambda spot: spot.side in ("below", "above"))


def around(spot: Spot, step_mm: float, base: Scene, placement: Placement) -> list[Spot]:
    """The places next to one, with the same wall."""
    outline, die = _outline(base), base.leds[0].size_mm
    found = []
    for du, dv in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        u, v = spot.place_mm[0] + du * step_mm, spot.place_mm[1] + dv * step_mm
        edge = min(
            u - die[0] / 2 - outline.u_min,
            outline.u_max - u - die[0] / 2,
            v - die[1] / 2 - outline.v_min,
            outline.v_max - v - die[1] / 2,
        )
        if edge >= placement.edge_mm - 1e-9 and _inside((u, v), die, placement):
            found.append(Spot((round(u, 4), round(v, 4)), spot.side))
    return found


def walls_for(place: tuple[float, float], base: Scene, placement: Placement) -> list[Spot]:
    """A place with each wall that leaves the photodiodes enough of the board."""
    if not base.board.barrier:
        return [Spot(place, None)]
    outline, (u, v) = _outline(base), place
    wide, long = outline.u_max - outline.u_min, outline.v_max - outline.v_min
    room = {
        "left": (outline.u_max - u) / wide,
        "right": (u - outline.u_min) / wide,
        "below": (outline.v_max - v) / long,
        "above": (v - outline.v_min) / long,
    }
    return [Spot(place, side) for side, part in room.items() if part > LEAST_ROOM]


def board_at(spot: Spot, base: Scene) -> Scene:
    """The bare board with its LED on a spot."""
    du, dv = base.board.center_mm
    led = base.leds[0].model_copy(update={"position_mm": (spot.place_mm[0] - du, spot.place_mm[1] - dv)})
    return boards.bare(base.model_copy(update={"leds": (led,)}), side=spot.side)


def free_places(board: Scene, size_mm: tuple[float, float], placement: Placement) -> np.ndarray:
    """Centres that a photodiode may take on a bare board, (m, 2) float. [mm]"""
    layout, step = board.layout, placement.photodiode_step_mm
    outline, half, apart = layout.outline, np.array(size_mm) / 2, placement.clearance_mm
    axes = []
    for i, (low, high) in enumerate(((outline.u_min, outline.u_max), (outline.v_min, outline.v_max))):
        first, last = low + placement.edge_mm + half[i], high - placement.edge_mm - half[i]
        axes.append(first + step * np.arange(int((last - first) / step + 1e-6) + 1))
    places = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 2)
    keep = np.ones(len(places), bool)
    for wall in layout.barriers:
        at, sign = {"left": (0, 1), "right": (0, -1), "below": (1, 1), "above": (1, -1)}[wall.name]
        edge = ((wall.u_max, wall.u_min), (wall.v_max, wall.v_min))[at][0 if sign > 0 else 1]
        # The layout asks for 0.02 mm between the wall and what lies behind it.
        keep &= sign * (places[:, at] - edge) >= half[at] + max(apart, 0.02) - 1e-9
    if not layout.barriers:
        for led in layout.leds:
            wide = np.array([led.u_max - led.u_min, led.v_max - led.v_min]) / 2 + half + placement.bond_wire_mm
            keep &= np.any(np.abs(places - led.center_mm) >= wide - 1e-9, axis=1)
    if placement.outline_mm is not None:
        keep &= np.array([_inside((u, v), size_mm, placement) for u, v in places])
    return places[keep]


def exchange(
    information: np.ndarray,
    places: np.ndarray,
    *,
    count: int,
    spacing_mm: tuple[float, float],
    score: Callable[[np.ndarray], np.ndarray],
) -> tuple[list[int], float]:
    """The places whose information together scores least, and the score: one after the other, then exchanged singly
    until nothing improves.

    information : (fingers, m, 3) float. What a photodiode at each place tells. [Pa^-2]
    spacing_mm : two photodiodes lie at least so far apart in u or in v.
    score : of sums of information (fingers, ..., 3) -> (...).
    """

    def best(total: np.ndarray, taken: list[int]) -> tuple[int, float]:
        scores = score(total[:, None] + information)
        for other in taken:
            away = np.abs(places - places[other])
            scores[np.all(away < np.array(spacing_mm) - 1e-9, axis=1)] = np.inf
        at = int(np.argmin(scores))
        return at, float(scores[at])

    chosen: list[int] = []
    total, reached = np.zeros((len(information), 3)), np.inf
    for _ in range(count):
        at, reached = best(total, chosen)
        if not np.isfinite(reached):
            return [], np.inf
        chosen.append(at)
        total = total + information[:, at]
    for _ in range(ROUNDS):
        before = reached
        for i in range(count):
            others = chosen[:i] + chosen[i + 1 :]
            at, found = best(information[:, others].sum(1), others)
            if found < reached * (1 - 1e-9):
                chosen[i], reached = at, found
        if reached >= before * (1 - 1e-6):
            break
    return chosen, reached


def combined(resolutions: np.ndarray, rank_by: str) -> np.ndarray:
    """Over the fingers, along the first axis: the worst or the mean."""
    return resolutions.max(0) if rank_by == "worst" else resolutions.mean(0)


def single(bank: Bank, board: Scene, places: np.ndarray, size_mm: tuple[float, float], pattern: Scene) -> np.ndarray:
    """What one photodiode at each place tells on each finger, (fingers, m, 3) float. [Pa^-2]"""
    half = np.array(size_mm) / 2
    areas = np.column_stack(
        [places[:, 0] - half[0], places[:, 0] + half[0], places[:, 1] - half[1], places[:, 1] + half[1]]
    )
    out = []
    for view, by_led in zip(bank.views, bank.maps(board), strict=True):
        total = np.zeros((len(places), 3))
        for led, one in zip(board.leds, by_led, strict=True):
            read = merit.volts(one.over(areas).mean(0), led, pattern.photodiodes[0], pattern.electronics, view.at)
            total += merit.information(read)
        out.append(total)
    return np.stack(out)


def scorer(views: tuple[View, ...], rank_by: str) -> Callable[[np.ndarray], np.ndarray]:
    """Force resolution over the fingers from sums of information (fingers, ..., 3)."""

    def score(total: np.ndarray) -> np.ndarray:
        each = [merit.resolution_n(one, view.at) for one, view in zip(total, views, strict=True)]
        return combined(np.stack(each), rank_by)

    return score


def _outline(base: Scene) -> Rectangle:
    size = base.board.size_mm
    assert size is not None
    return Rectangle.around("board", base.board.center_mm, size)


def _inside(place: tuple[float, float], size_mm: tuple[float, float], placement: Placement) -> bool:
    """Whether a part with its distance from the edge lies within an outline that is given as a polygon."""
    corners = placement.outline_mm
    if corners is None:
        return True
    half_u, half_v = (s / 2 + placement.edge_mm for s in size_mm)
    points = [
        (place[0] + a * half_u, place[1] + b * half_v) for a in (-1, 0, 1) for b in (-1, 0, 1) if (a, b) != (0, 0)
    ]
    return all(_within(point, corners) for point in points)


def _within(point: tuple[float, float], corners: tuple[tuple[float, float], ...]) -> bool:
    """Whether a point lies in a polygon or on its edge (crossings of a ray along u)."""
    (u, v), inside = point, False
    for (a, b), (c, d) in zip(corners, corners[1:] + corners[:1], strict=True):
        cross = (c - a) * (v - b) - (d - b) * (u - a)
        if abs(cross) < 1e-9 * max(1.0, abs(c - a) + abs(d - b)) and min(a, c) - 1e-9 <= u <= max(a, c) + 1e-9:
            if min(b, d) - 1e-9 <= v <= max(b, d) + 1e-9:
                return True
        if (b > v) != (d > v) and u < a + (v - b) * (c - a) / (d - b):
            inside = not inside
    return inside

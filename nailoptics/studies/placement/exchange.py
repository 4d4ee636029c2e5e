"""The search for a layout: LED sites on a grid, and for each the photodiodes that tell most, by exchange."""

import logging
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ...light.board_map import PhotonMap
from ...scene import Placement, Scene
from ...scene.outlines import has_room
from ...scene.rectangles import Rectangle
from . import boards
from .boards import CandidateLayout
from .fisher import OperatingPoint, fisher_information, force_resolution_n, over_fingers, response
from .photon_maps import PhotonMapCache
from .progress import StageProgress

log = logging.getLogger(__name__)

# Photons per LED and finger, to choose photodiodes for a site of the LED.
SEARCH_PHOTONS = 1 << 18
# Part of the time for the search.
SEARCH_SHARE = 0.55
# Searched layouts that are judged with photons of their own beside those that were given.
FINALISTS = 5
# A wall that leaves less than this part of the board to the photodiodes is not tried.
LEAST_ROOM = 0.4
# The layout asks for so much between the wall and what lies behind it.
WALL_ROOM_MM = 0.02
ROUNDS = 6


@dataclass(frozen=True)
class LedSite:
    """A place of the LED and the side of the photodiodes on which it lies (None without a wall)."""

    place_mm: tuple[float, float]
    side: str | None

    @property
    def name(self) -> str:
        """The site as a layout's name."""
        where = "_".join(f"{'m' if x < 0 else 'p'}{abs(x):.3g}" for x in (v + 0.0 for v in self.place_mm))
        return f"led_{where}" + (f"_{self.side}" if self.side else "")


@dataclass(frozen=True)
class SearchedSite:
    """The best photodiodes for a site of the LED: (n, 2) places, and the force that they resolve. [mm], [N]"""

    site: LedSite
    places_mm: np.ndarray
    resolution_n: float


def search(
    base: Scene, placement: Placement, cache: PhotonMapCache, report_progress: StageProgress
) -> list[SearchedSite]:
    """Every site of the LED that was tried with its best photodiodes, in the order tried: a grid, then around the best.

    Raises: InputError unless the scene has one LED.
    """
    boards.check_search(base, placement)

    def score(information: np.ndarray) -> np.ndarray:
        each = [force_resolution_n(*both) for both in zip(information, points, strict=True)]
        return over_fingers(np.stack(each), placement.rank_by)

    points = [condition.point for condition in cache.conditions]
    found: dict[LedSite, SearchedSite] = {}
    step, seen, waiting = placement.led_step_mm, set(), led_sites(base, placement)
    start = report_progress.seconds
    available = max(SEARCH_SHARE * report_progress.limit_s - start, 1e-9)
    while waiting and step >= placement.led_step_mm / 4:
        for i, site in enumerate(waiting):
            if report_progress.is_over(SEARCH_SHARE):
                why = "was interrupted" if report_progress.interrupted else "ran out of time"
                log.warning("the search for LED places %s after %d of them", why, len(found))
                return list(found.values())
            best = _best_at(site, base, placement, cache, score)
            if best:
                found[site] = best
            seen.add(site)
            part = (report_progress.seconds - start) / available
            report_progress("search", part if math.isfinite(available) else (i + 1) / len(waiting) / 2)
        step /= 2
        nearest = (n for one in ranked(found.values())[:2] for n in neighbours(one.site, step, base, placement))
        waiting = list(dict.fromkeys(n for n in nearest if n not in seen))
    return list(found.values())


def ranked(found: Iterable[SearchedSite]) -> list[SearchedSite]:
    """The finest first."""
    return sorted(found, key=lambda one: one.resolution_n)


def finalists(base: Scene, found: Sequence[SearchedSite]) -> list[CandidateLayout]:
    """The best layouts of a search, to be judged with photons of their own."""
    layouts = []
    for one in ranked(found)[:FINALISTS]:
        places = sorted(((float(u), float(v)) for u, v in one.places_mm), key=lambda p: (p[1], p[0]))
        scene = boards.with_parts(base, [one.site.place_mm], places, name=one.site.name)
        layouts.append(boards.candidate(one.site.name, scene, "searched"))
    return layouts


def _best_at(
    site: LedSite, base: Scene, placement: Placement, cache: PhotonMapCache, score: Callable[[np.ndarray], np.ndarray]
) -> SearchedSite | None:
    """Trace a site's board and choose its photodiodes; None where they find no room."""
    board, size, gap = board_at(site, base), base.photodiodes[0].size_mm, placement.clearance_mm
    cache.extend(board, SEARCH_PHOTONS)
    places = free_places(board, size, placement)
    chosen: list[int] = []
    if cache.is_traced(board) and len(places) >= placement.photodiodes:
        chosen, reached = exchange(
            information_at(cache, board, places, size, base),
            places,
            count=placement.photodiodes,
            spacing_mm=(size[0] + gap, size[1] + gap),
            score=score,
        )
    cache.forget(board)
    return SearchedSite(site, places[chosen], reached) if chosen else None


def led_sites(base: Scene, placement: Placement) -> list[LedSite]:
    """LED sites on a grid over the outline, symmetric boards on one half, each with the walls that leave room."""
    outline, die, step, axes = _outline(base), base.leds[0].size_mm, placement.led_step_mm, []
    for low, high in zip(*_led_range(base, placement), strict=True):
        half = max(0, int((high - low) / 2 / step + 1e-9))
        axes.append((low + high) / 2 + step * np.arange(-half, half + 1))
    if placement.outline_mm is None and abs(outline.u_min + outline.u_max) < 1e-6:
        # Fingers are symmetric here, so that a layout and its mirror image are one.
        axes[0] = axes[0][axes[0] <= 1e-6]
    places = [(float(u), float(v)) for u in axes[0] for v in axes[1]]
    found = [LedSite(p, side) for p in places if _inside(p, die, placement) for side in _walls_at(p, base)]
    # The blood zones follow each other along the nail, so walls along it promise most and come first.
    return sorted(found, key=lambda site: site.side in ("below", "above"))


def neighbours(site: LedSite, step_mm: float, base: Scene, placement: Placement) -> list[LedSite]:
    """The sites next to one, with the same wall."""
    low, high = _led_range(base, placement)
    found = []
    for du, dv in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        place = u, v = site.place_mm[0] + du * step_mm, site.place_mm[1] + dv * step_mm
        if np.all((low - 1e-9 <= place) & (place <= high + 1e-9)) and _inside((u, v), base.leds[0].size_mm, placement):
            found.append(LedSite((round(u, 4), round(v, 4)), site.side))
    return found


def _led_range(base: Scene, placement: Placement) -> tuple[np.ndarray, np.ndarray]:
    """The lowest and the highest (u, v) that the LED may take on the board. [mm]"""
    outline, margin = _outline(base), placement.edge_mm + np.array(base.leds[0].size_mm) / 2
    return np.array([outline.u_min, outline.v_min]) + margin, np.array([outline.u_max, outline.v_max]) - margin


def _walls_at(place: tuple[float, float], base: Scene) -> list[str | None]:
    """Each wall beside an LED that leaves the photodiodes enough of the board; None if the board has no wall."""
    if not base.board.barrier:
        return [None]
    outline, (u, v) = _outline(base), place
    wide, long = (LEAST_ROOM * size for size in outline.size_mm)
    room = {"left": outline.u_max - u > wide, "right": u - outline.u_min > wide}
    room |= {"below": outline.v_max - v > long, "above": v - outline.v_min > long}
    return [side for side, enough in room.items() if enough]


def board_at(site: LedSite, base: Scene) -> Scene:
    """The bare board with its LED on a site."""
    du, dv = base.board.center_mm
    led = base.leds[0].model_copy(update={"position_mm": (site.place_mm[0] - du, site.place_mm[1] - dv)})
    return boards.bare(base.model_copy(update={"leds": (led,)}), side=site.side)


def free_places(board: Scene, size_mm: tuple[float, float], placement: Placement) -> np.ndarray:
    """Centres that a photodiode may take on a bare board, (m, 2) float. [mm]"""
    layout, step = board.layout, placement.photodiode_step_mm
    outline, half = layout.outline, np.array(size_mm) / 2
    axes = []
    for i, (low, high) in enumerate(((outline.u_min, outline.u_max), (outline.v_min, outline.v_max))):
        first, last = low + placement.edge_mm + half[i], high - placement.edge_mm - half[i]
        axes.append(first + step * np.arange(int((last - first) / step + 1e-6) + 1))
    places = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 2)
    keep = np.ones(len(places), bool)
    for wall in layout.barriers:
        across, along = boards.FAR_SIDE[wall.name]
        edge = {"left": wall.u_max, "right": wall.u_min, "below": wall.v_max, "above": wall.v_min}[wall.name]
        axis, sign = (0, across) if across else (1, along)
        keep &= sign * (places[:, axis] - edge) >= half[axis] + max(placement.clearance_mm, WALL_ROOM_MM) - 1e-9
    if not layout.barriers:
        for led in layout.leds:
            wide = np.array(led.size_mm) / 2 + half + placement.bond_wire_mm
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

    information : (fingers, m, n) float. What a photodiode at each place tells, as `fisher_information`.
    spacing_mm : two photodiodes lie at least so far apart in u or in v.
    score : of sums of information (fingers, ..., n) -> (...).
    """

    def best(total: np.ndarray, taken: list[int]) -> tuple[int, float]:
        scores = score(total[:, None] + information)
        for other in taken:
            away = np.abs(places - places[other])
            scores[np.all(away < np.array(spacing_mm) - 1e-9, axis=1)] = np.inf
        at = int(np.argmin(scores))
        return at, float(scores[at])

    chosen: list[int] = []
    total, reached = np.zeros((len(information), information.shape[-1])), np.inf
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


def information_at(
    cache: PhotonMapCache, board: Scene, places: np.ndarray, size_mm: tuple[float, float], like: Scene
) -> np.ndarray:
    """What one photodiode at each place tells on each finger, (fingers, m, n) float, as `fisher_information`.

    like : the scene whose first photodiode and electronics these are.
    """
    half = np.array(size_mm) / 2
    areas = np.stack([places - half, places + half], -1).reshape(-1, 4)

    def told(number: int, one: PhotonMap, point: OperatingPoint) -> np.ndarray:
        led, values = board.leds[number], one.over(areas).mean(0)
        return fisher_information(response(values, led, like.photodiodes[0], like.electronics, point, number=number))

    by_finger = [
        sum(told(number, one, condition.point) for number, one in enumerate(by_led))
        for condition, by_led in zip(cache.conditions, cache.maps(board), strict=True)
    ]
    return np.stack(by_finger)


def _outline(base: Scene) -> Rectangle:
    size = base.board.size_mm
    assert size is not None
    return Rectangle.around("board", base.board.center_mm, size)


def _inside(place: tuple[float, float], size_mm: tuple[float, float], placement: Placement) -> bool:
    """Whether a part with its distance from the edge lies within an outline of corners and off its holes."""
    if placement.outline_mm is None:
        return True
    half_u, half_v = (s / 2 + placement.edge_mm for s in size_mm)
    return has_room(place, (half_u, half_v), placement.outline_mm, placement.outline_holes_mm)

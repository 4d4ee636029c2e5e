"""The search for a layout: places of the LEDs row by row on a grid, then finer around the best, from traced light; and
the best photodiodes for LEDs in one row, by coordinate exchange.

References: Meyer, Nachtsheim 1995, Technometrics 37, 60.
"""

import logging
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, islice, product
from typing import Any

import numpy as np

from ...light.tracing import StageProgress
from ...scene import Placement, Scene
from ...scene.base import Point
from ...scene.layout import SIDES
from ...scene.rectangles import Rectangle
from ...sensor.ambient import LAMP, ambient_bound_a
from ...sensor.electronics import stage_ohm
from ...sensor.information import brightest_current_a, response
from ...statistics import left_out
from . import boards
from .boards import CandidateLayout
from .objective import Objective
from .photon_maps import PhotonMapCache
from .sites import ROUNDING_MM, LedRow, PhotodiodePlaces, Sites

log = logging.getLogger(__name__)

# Photons per LED and finger for every place of the LED, in one batch, and for those of the best sites, whose
# photodiodes are chosen once more: the photons' noise adds to the information of positions, most where little light
# comes. With twice the latter the shipped scene's best came to 0.4(2) % above the bound of all layouts.
FIRST_PHOTONS, SEARCH_PHOTONS = 1 << 15, 1 << 17
# Cells of the distances that the walk asks for: few photons for each of many boards pay for no finer ones. Such cells
# take half the time of those of 0.2 mm to make, a place of the LED with its first photons four fifths. [mm]
DISTANCE_MM = 0.4
# First photodiodes from which those of the best sites are chosen once more.
LAST_STARTS = 8
# Part of the time for the search.
SEARCH_SHARE = 0.55
# Searched layouts that are evaluated with photons of their own beside given ones, and sites for regular ones.
SHORTLIST, REGULAR, FAR_WORSE = 2, 3, 4.0
# Sites around which LED places are searched more finely, and into how many parts a step is halved.
REFINED, FINEST = 2, 4

# Part of the score in which regular photodiodes are as good as the best, where waves count whole.
AS_GOOD = 0.01
# Rounds of exchange at most.
ROUNDS = 6
# So many combinations of LED places are evaluated each; of more, so many are starting points.
STARTS = 24
# Of more combinations than this a sample is drawn.
MOST_LISTED = 4096
# Relative improvement below which a search has converged.
CONVERGED = 1e-6

LedPlaces = tuple[Point, ...]


def coordinate_exchange(
    information: np.ndarray,
    free: PhotodiodePlaces,
    *,
    count: int,
    score: Callable[[np.ndarray], np.ndarray],
    given: np.ndarray | float = 0.0,
    allowed: np.ndarray | None = None,
    starts: int = 1,
) -> tuple[list[int], float]:
    """The free places whose information together scores least, and the score; inf where they have no room.

    They are taken one after the other, then exchanged singly until nothing improves.

    information : (fingers, m, n) float. Of a photodiode at each place, as `fisher_information`.
    score : of sums of information (fingers, ..., n) -> (...).
    given : (fingers, n) float. Information of others that stay.
    allowed : (m,) bool. Places that may be taken; all if not given.
    starts : number of first places, the best by themselves that leave room for each other, from which it begins.
    """
    places, spacing_mm = free.centers_mm, free.spacing_mm
    given = np.zeros((len(information), information.shape[-1])) + given
    excluded = np.zeros(len(places), bool) if allowed is None else ~allowed

    def scores(others: list[int]) -> np.ndarray:
        """Of each place beside others that are taken."""
        total = given + information[:, others].sum(1)
        values = np.where(excluded, np.inf, score(total[:, None] + information))
        for k in others:
            away = np.abs(places - places[k])
            values[np.all(away < np.array(spacing_mm) - 1e-9, axis=1)] = values[k] = np.inf
        return values

    if count == 0:
        return [], float(score(given))
    alone = scores([])
    ranked = _separate(np.argsort(alone), places, spacing_mm) if count > 1 else iter(())
    best: tuple[list[int], float] = ([], np.inf)
    for first in [None, *(k for k in islice(ranked, starts - 1) if not excluded[k])]:
        chosen, reached = ([], np.inf) if first is None else ([first], float(alone[first]))
        while len(chosen) < count:
            values = scores(chosen)
            chosen, reached = [*chosen, int(np.argmin(values))], float(values.min())
            if not np.isfinite(reached):
                break
        for _ in range(ROUNDS if np.isfinite(reached) else 0):
            before = reached
            for i in range(count):
                values = scores(chosen[:i] + chosen[i + 1 :])
                if float(values.min()) < reached * (1 - 1e-9):
                    chosen[i], reached = int(np.argmin(values)), float(values.min())
            if reached >= before * (1 - CONVERGED):
                break
        if reached < best[1]:
            best = chosen, reached
    return best


def _separate(ranked: np.ndarray, places: np.ndarray, spacing_mm: tuple[float, float]) -> Iterator[int]:
    """Numbers of places in their order, each of a place that leaves room for those before it."""
    while ranked.size:
        yield int(ranked[0])
        away = np.abs(places[ranked] - places[ranked[0]])
        ranked = ranked[np.any(away >= spacing_mm, axis=1)]


@dataclass(frozen=True)
class SearchedSite:
    """Places of all LEDs in a row, in the scene's order, with the best photodiodes for them. [mm]

    score : of what they are ranked by, less is better. resolution_n : the force that they resolve. [N]
    photons : of each LED behind it. form : "row" or "rows" of what is regular.
    """

    places_mm: LedPlaces
    row: LedRow
    photodiodes: tuple[Rectangle, ...]
    score: float
    resolution_n: float
    photons: int
    form: str = ""

    @property
    def name(self) -> str:
        """The site as a layout's name."""
        where = "_".join(
            f"{'m' if x < 0 else 'p'}{abs(x):.3g}" for place in self.places_mm for x in (v + 0.0 for v in place)
        )
        several = "s" if len(self.places_mm) > 1 else ""
        return "_".join(filter(None, [f"led{several}_{where}", self.row.side, self.form]))


@dataclass
class RowDesign:
    """LEDs at places of a row and photodiodes at theirs: what was traced, and the best of both by it.

    columns : of each LED at each of its places, (fingers, m + s, c) float: m places of photodiodes, then the s that
        stay.
    photons : of each LED at each place. starts : as of `coordinate_exchange`.
    """

    sites: Sites
    objective: Objective
    row: LedRow
    places: PhotodiodePlaces
    columns: Sequence[dict[Point, np.ndarray]]
    photons: int
    starts: int = 1

    @property
    def count(self) -> int:
        """Number of photodiodes to be placed."""
        return self.sites.rules.photodiodes - (len(self.places.areas) - self.places.free)

    def numbers(self, site: SearchedSite) -> list[int]:
        """Which of the places a site's photodiodes take, and those that stay."""
        return [*map(self.places.areas.index, site.photodiodes), *range(self.places.free, len(self.places.areas))]

    def information(self, leds: LedPlaces) -> np.ndarray:
        """Of photodiodes under LEDs at these places, (fingers, m + s, n) float."""
        return self.objective.together([by_place[at] for by_place, at in zip(self.columns, leds, strict=True)])

    def best(self, leds: LedPlaces) -> SearchedSite | None:
        """The best photodiodes for LEDs at given places; None where they have no room."""
        information, free = self.information(leds), self.places.free
        staying = information[:, free:].sum(1)
        chosen, score = coordinate_exchange(
            information[:, :free],
            self.places,
            count=self.count,
            score=self.objective.score,
            given=staying,
            allowed=self.allowed(leds),
            starts=self.starts,
        )
        return self._site(leds, chosen, information[:, chosen].sum(1) + staying) if np.isfinite(score) else None

    def regular(self, leds: LedPlaces) -> list[SearchedSite]:
        """Photodiodes in one straight row, and in equal rows, symmetric about the LEDs' middle: of those that are as
        good as the best of their kind the most spread."""
        if self.sites.rules.wire or not self.places.free or not self.count:
            return []
        axis = SIDES[self.row.side or "left"][0]
        middle_mm, step_mm = float(np.mean(leds, axis=0)[1 - axis]), self.sites.rules.photodiode_step_mm
        if not (every := self.places.in_rows(self.count, axis, middle_mm, step_mm, self.allowed(leds))):
            return []
        information = self.information(leds)
        totals = information[:, every].sum(2) + information[:, self.places.free :].sum(1)[:, None]
        scores, best, as_good = self.objective.score(totals), [], 1 + AS_GOOD / self.objective.waves_left
        for straight in (True, False):
            among = [k for k, chosen in enumerate(every) if self.places.is_straight(chosen) == straight]
            if among:
                least = min(scores[k] for k in among)
                k = next(k for k in among if scores[k] <= least * as_good)
                best.append(replace(self._site(leds, every[k], totals[:, k]), form="row" if straight else "rows"))
        return best

    def allowed(self, leds: LedPlaces) -> np.ndarray | None:
        """Which free places the LEDs leave, (free,) bool; all where they lie behind a wall."""
        return (
            None
            if self.row.side
            else self.sites.are_beside(self.places.areas[: self.places.free], dict(enumerate(leds)))
        )

    def _site(self, leds: LedPlaces, chosen: list[int], total: np.ndarray) -> SearchedSite:
        """LEDs with chosen photodiodes, which together have this information."""
        score, force_n = float(self.objective.score(total)), float(self.objective.force_n(total))
        return SearchedSite(leds, self.row, tuple(self.places.areas[k] for k in chosen), score, force_n, self.photons)

    def _best_leds(self, site: SearchedSite) -> LedPlaces:
        """The LEDs' places, one after the other moved to where it is best, for photodiodes that stay where they are."""
        leds, reached, areas, chosen = site.places_mm, site.score, site.photodiodes, self.numbers(site)
        for i, by_place in enumerate(self.columns):
            for place in by_place:
                tried = (*leds[:i], place, *leds[i + 1 :])
                if place == leds[i] or not self.sites.go_together(tried):
                    continue
                if self.row.side is None and not self.sites.are_beside(areas, dict(enumerate(tried))).all():
                    continue
                value = float(self.objective.score(self.information(tried)[:, chosen].sum(1)))
                if value < reached * (1 - 1e-9):
                    leds, reached = tried, value
        return leds

    def _improved(self, leds: LedPlaces) -> Iterator[SearchedSite]:
        """Arrangements from one start, photodiodes and LEDs exchanged in turns; the best last."""
        reached = math.inf
        while (better := self.best(leds)) and better.score < reached * (1 - CONVERGED):
            yield better
            leds, reached = self._best_leds(better), better.score
            if leds == better.places_mm:
                break

    def search(self, known: Sequence[LedPlaces] = ()) -> list[SearchedSite]:
        """Every arrangement of LEDs that was given its photodiodes: of few each; of many what some of them lead to, and
        from the best of it on every step of one LED, or of two that change places, as long as that is better.

        known : arrangements that were tried, best first; of few they are left out, of many the best is a start.
        """
        every = self._arrangements()
        if len(every) <= STARTS or sum(len(column) > 1 for column in self.columns) <= 1:
            return [a for leds in every if leds not in known and (a := self.best(leds))]
        picked = [every[i] for i in np.linspace(0, len(every) - 1, STARTS).astype(int)]
        results: dict[LedPlaces, SearchedSite] = {}
        for leds in dict.fromkeys((*known[:1], *picked)):
            results |= {a.places_mm: a for a in (self._improved(leds) if leds not in results else ())}
        tried, reached = set(results), math.inf
        while results and (best := min(results.values(), key=lambda a: a.score)).score < reached * (1 - CONVERGED):
            reached = best.score
            for leds in self._neighbours(best.places_mm):
                if leds not in tried and (better := self.best(leds)):
                    results[leds] = better
                tried.add(leds)
        return list(results.values())

    def _neighbours(self, leds: LedPlaces) -> list[LedPlaces]:
        """Arrangements in which one LED lies elsewhere, or two lie in each other's places."""
        moved = [(*leds[:i], place, *leds[i + 1 :]) for i, by_place in enumerate(self.columns) for place in by_place]
        for i, j in combinations(range(len(leds)), 2):
            if leds[j] in self.columns[i] and leds[i] in self.columns[j]:
                moved.append((*leds[:i], leds[j], *leds[i + 1 : j], leds[i], *leds[j + 1 :]))
        return [places for places in dict.fromkeys(moved) if places != leds and self.sites.go_together(places)]

    def _arrangements(self) -> list[LedPlaces]:
        """Places that LEDs may have together: all, or of very many a sample that is always the same."""
        pools = [list(column) for column in self.columns]
        if math.prod(map(len, pools)) <= MOST_LISTED:
            every = list(product(*pools))
        else:
            rng = np.random.default_rng(0)
            picks = np.stack([rng.integers(len(pool), size=MOST_LISTED) for pool in pools], -1)
            every = [tuple(pool[i] for pool, i in zip(pools, row, strict=True)) for row in picks]
        return [leds for leds in dict.fromkeys(every) if self.sites.go_together(leds)]


class Search:
    """A search as far as it is.

    results : every site of the LEDs that was given photodiodes, by row and places.
    designs : of each row, by the first photons.
    regular : sites in the middle of a row with the photodiodes that are best in regular places.
    """

    def __init__(self, base: Scene, objective: Objective, cache: PhotonMapCache) -> None:
        """base : a board whose parts lie straight, which `boards.check_search` has passed."""
        self.base, self.rules, self.objective, self.cache = base, objective.rules, objective, cache
        self.sites = Sites(base, self.rules)
        self.results: dict[tuple[LedRow, tuple[Point, ...]], SearchedSite] = {}
        self.designs: dict[LedRow, RowDesign] = {}
        self.regular: list[SearchedSite] = []

    @cached_property
    def ambient_a_per_mm2(self) -> float:
        """Photocurrent by light from outside to which "auto" fits, as on the photodiodes where they lie. [A/mm^2]"""
        if self.base.electronics.feedback_ohm != "auto":
            return 0.0
        areas_mm2 = [area.area_mm2 for area in self.base.layout.photodiode_areas]
        return float(np.max(ambient_bound_a(self.base, usual=LAMP) / areas_mm2))

    def run(self, report_progress: StageProgress) -> list[SearchedSite]:
        """Search on the grid, then around the best on finer ones, until time is over; the sites in that order."""
        step, start = self.rules.led_step_mm, report_progress.seconds
        available = max(SEARCH_SHARE * report_progress.limit_s - start, 1e-9)
        waiting, middle = self.sites.rows(step), list[SearchedSite]()
        while waiting and step >= self.rules.led_step_mm / FINEST:
            for i, (row, places) in enumerate(waiting.items()):
                design = self.designs.setdefault(row, self._design(row, places, FIRST_PHOTONS))
                for done in self._trace(design, places, report_progress):
                    part = (report_progress.seconds - start) / available
                    by_count = (i + done) / len(waiting) / 2
                    report_progress("search", part if math.isfinite(available) else by_count)
                if all(design.columns):
                    known = [a.places_mm for a in self.ranked if a.row == row]
                    self._store(design.search(known))
                if report_progress.is_over(SEARCH_SHARE):
                    why = "was interrupted" if report_progress.interrupted else "ran out of time"
                    log.warning("the search for LED places %s after %d of them", why, len(self.results))
                    return list(self.results.values())
            middle = self._in_the_middle() if step == self.rules.led_step_mm else middle
            step /= 2
            waiting = self._around_the_best(step)
        for site in (*self.ranked[:SHORTLIST], *middle):
            if report_progress.is_over(SEARCH_SHARE):
                break
            # The photodiodes once more, by more photons.
            once_more = self.traced(site, SEARCH_PHOTONS, report_progress)
            if once_more and site.form:
                self.regular += once_more.regular(site.places_mm)
            elif once_more and (again := once_more.best(site.places_mm)):
                self._store([again])
        return list(self.results.values())

    def _in_the_middle(self) -> list[SearchedSite]:
        """The sites in the middle of a row that are best with regular photodiodes."""
        best = []
        for row, leds in self.results:
            along = 1 - SIDES[row.side or "left"][0]
            if abs(np.mean(leds, axis=0)[along] - self.sites.outline.center_mm[along]) < ROUNDING_MM:
                best += sorted(self.designs[row].regular(leds), key=lambda a: a.score)[:1]
        return sorted(best, key=lambda a: a.score)[:REGULAR]

    def traced(self, site: SearchedSite, photons: int, report_progress: StageProgress) -> RowDesign | None:
        """A design of one site with its LEDs traced; None where time ends before."""
        places = [[place] for place in site.places_mm]
        design = self._design(site.row, places, photons, starts=LAST_STARTS)
        for _ in self._trace(design, places, report_progress):
            pass
        return design if all(design.columns) else None

    @property
    def ranked(self) -> list[SearchedSite]:
        """The best first."""
        return sorted(self.results.values(), key=lambda a: a.score)

    def _store(self, searched: Iterable[SearchedSite]) -> None:
        self.results |= {(a.row, a.places_mm): a for a in searched}

    def _design(self, row: LedRow, places: list[list[Point]], photons: int, *, starts: int = 1) -> RowDesign:
        """A row of which nothing is traced."""
        leds = range(len(self.base.leds))
        walls = self.sites.board_at(0, places[0][0], row).layout.barriers
        fixed = {i: self.sites.place_of(i) for i in leds if self.sites.is_fixed[i]}
        beside = self.sites.photodiode_places(walls, fixed)
        photons = min(photons, self.cache.most_photons or photons)
        return RowDesign(self.sites, self.objective, row, beside, [{} for _ in leds], photons, starts)

    def _trace(self, design: RowDesign, places: list[list[Point]], report_progress: StageProgress) -> Iterable[float]:
        """Trace every LED at its new places, place by place, as long as there is time; yields the part that is done."""
        if design.places.free < design.count:
            return
        waiting = [[p for p in spots if p not in had] for spots, had in zip(places, design.columns, strict=True)]
        longest, boards = max(map(len, waiting)), []
        for k in range(longest):
            if report_progress.is_over(SEARCH_SHARE):
                break
            for i, new_places in enumerate(waiting):
                if k < len(new_places):
                    boards.append(board := self.sites.board_at(i, new_places[k], design.row))
                    # LEDs that shine alike share their light.
                    traced = self.cache.of(board)
                    if traced.photons < design.photons:
                        self.cache.extend(board, design.photons - traced.photons)
                    if traced.photons >= design.photons:
                        design.columns[i][new_places[k]] = self.columns(i, board, design.places)
                    traced.tracers.clear()
            yield (k + 1) / longest
        for board in boards:
            self.cache.forget(board)

    def columns(self, led: int, board: Scene, places: PhotodiodePlaces, lit_led: int = 0) -> np.ndarray:
        """What an LED brings to photodiodes at all places and to those that stay, (fingers, m + s, c) float; by all
        photons and without each block of them, (fingers, 1 + blocks, m + s, c), where there are several.

        lit_led : which of the LEDs of the traced board it is.
        """
        columns, kinds, one = [], places.photodiodes, self.base.leds[led]
        conditions, replicates = self.cache.conditions, self.cache.blocks > 1
        lit = [of_leds[lit_led].over(places.areas)[self.cache.part] for of_leds in self.cache.of(board).maps]
        by_finger = [left_out(values) if replicates else values.mean(0) for values in lit]
        # A resistor is the same on all fingers; that other LEDs may be brighter is left to the evaluation.
        brightest_a = [
            brightest_current_a(values[0] if replicates else values, one, kinds, condition.point)
            for values, condition in zip(by_finger, conditions, strict=True)
        ]
        outside_a = self.ambient_a_per_mm2 * np.array([area.area_mm2 for area in places.areas])
        ohm = stage_ohm(kinds, self.base.electronics, largest_a=np.max(brightest_a, axis=0) + outside_a)
        for finger, (values, condition) in enumerate(zip(by_finger, conditions, strict=True)):
            how: dict[str, Any] = {"replicates": replicates, "feedback_ohm": ohm}
            read = response(values, self.base, led, kinds, condition.point, **how)
            columns.append(self.objective.columns(finger, led, read))
        return np.stack(columns)

    def _around_the_best(self, step_mm: float) -> dict[LedRow, list[list[Point]]]:
        """Places beside those of the best sites: along their rows, beside another LED, and rows beside theirs."""
        sites, requested = self.sites, dict[LedRow, list[dict[Point, None]]]()

        def request(row: LedRow, led: int, place: Point) -> None:
            if not sites.is_fixed[led]:
                place = (round(place[0], 4), round(place[1], 4))
            if sites.is_fixed[led] or sites.may_lie(led, place):
                requested.setdefault(row, [{} for _ in self.base.leds])[led][place] = None

        for best in self.ranked[:REFINED]:
            side, face_mm = best.row.side, best.row.face_mm
            ways = () if side is None or all(sites.is_fixed) else (-1, 1)
            rows = [LedRow(side, round(face_mm + way * step_mm, 4)) for way in ways]
            for i, place in enumerate(best.places_mm):
                for other in (place, *self._beside(best, i, step_mm)):
                    request(best.row, i, other)
                for row in rows:
                    along = place[1 if row.side in ("left", "right") else 0]
                    request(row, i, place if sites.is_fixed[i] else sites.in_row(i, row, along))
        complete = {row: [list(place) for place in per_led] for row, per_led in requested.items() if all(per_led)}
        return {row: per_led for row, per_led in complete.items() if sites.leaves_room(row)}

    def _beside(self, best: SearchedSite, led: int, step_mm: float) -> list[Point]:
        """Places of one LED a step along its row (on a board without walls: or across), or right beside another LED, at
        the clearance; in a row it stays in its own line."""
        if self.sites.is_fixed[led]:
            return []
        place, own, places = best.places_mm[led], self.sites.room(led, (0.0, 0.0)), []
        side = best.row.side
        for axis in (0, 1) if side is None else (1 - SIDES[side][0],):
            for sign, end in zip((-1, 1), ((own.u_max, own.v_max)[axis], (own.u_min, own.v_min)[axis]), strict=True):
                beside = [(place, place[axis] + sign * step_mm)]
                for k, other in enumerate(best.places_mm):
                    if k != led:
                        r = self.sites.room(k, other)
                        edge = ((r.u_min, r.u_max), (r.v_min, r.v_max))[axis][sign > 0]
                        beside.append((other if side is None else place, edge - end))
                places += [(line[0], along) if axis else (along, line[1]) for line, along in beside]
        return places


def shortlist(base: Scene, rules: Placement, results: Sequence[SearchedSite]) -> list[CandidateLayout]:
    """The best layouts of a search, to be evaluated with independent photons, those of few, whose resolution is biased
    low, last; and regular ones, but for those that more photons showed to be far worse than the best of them."""
    best = sorted((a for a in results if not a.form), key=lambda a: (-a.photons, a.score))[:SHORTLIST]
    regular, layouts = [a for a in results if a.form], []
    for result in (*best, *(a for a in regular if a.score < FAR_WORSE * min(b.score for b in regular))):
        side, sites = result.row.side, Sites(base, rules)
        wall = (side, sites.gap_mm(side)) if side else None
        scene = boards.searched(base, rules, result.places_mm, result.photodiodes, wall=wall, name=result.name)
        layouts.append(boards.candidate(result.name, scene, "searched"))
    return layouts

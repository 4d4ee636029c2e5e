"""The search for a layout: places of the LEDs row by row on a grid, then finer around the best, from traced light."""

import logging
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ...light.tracing import StageProgress
from ...scene import Placement, Scene
from ...scene.base import Point
from ...scene.layout import SIDES
from ...scene.rectangles import Rectangle
from ...sensor.information import responses
from . import boards, candidates
from .candidates import CandidateLayout
from .coordinate_exchange import Arrangement, DesignTables
from .objective import Objective
from .photon_maps import PhotonMapCache
from .sites import LedRow, LedSite, PhotodiodePlaces, Sites

log = logging.getLogger(__name__)

# Photons per LED and finger for every place of the LED, in one batch, and for those of the best sites, whose
# photodiodes are chosen once more: the photons' noise adds to what places tell, most where little light comes. Twice as
# many at first found no better best on the shipped scene: 29.20(15) and 29.00(7) mN by two seeds, 29.03(13) and
# 29.03(8) with these, in an eighth less time.
FIRST_PHOTONS, SEARCH_PHOTONS = 1 << 15, 1 << 18
# Cells of the distances that the walk asks for: few photons for each of many boards pay for no finer ones. Such cells
# take half the time of those of 0.2 mm to make, a place of the LED with its first photons four fifths. [mm]
DISTANCE_MM = 0.4
# First photodiodes from which those of the best sites are chosen once more.
LAST_STARTS = 8
# Part of the time for the search.
SEARCH_SHARE = 0.55
# Searched layouts that are judged with photons of their own beside those that were given.
SHORTLIST = 5
# Sites around which LED places are searched more finely, and into how many parts a step is halved.
REFINED, FINEST = 2, 4


@dataclass(frozen=True)
class SearchedSite:
    """The best photodiodes for a site of the LEDs: where they lie, their score, less being better, the force that they
    resolve, and the photons of each LED behind it. [mm], [N]"""

    site: LedSite
    photodiodes: tuple[Rectangle, ...]
    score: float
    resolution_n: float
    photons: int


@dataclass
class _Row:
    """A row of LEDs with what was traced of it: by LED and place (fingers, photodiodes and those that stay, c)."""

    row: LedRow
    places: PhotodiodePlaces
    columns: list[dict[Point, np.ndarray]]


class Search:
    """A search as far as it is.

    results : every site of the LEDs that was given photodiodes.
    """

    def __init__(self, base: Scene, rules: Placement, objective: Objective, cache: PhotonMapCache) -> None:
        """base : a board whose parts lie straight. Raises: InputError for what a search cannot place."""
        boards.check_search(base, rules)
        self.base, self.rules, self.objective, self.cache = base, rules, objective, cache
        self.sites = Sites(base, rules)
        self.results: dict[LedSite, SearchedSite] = {}
        self._rows: dict[LedRow, _Row] = {}
        # Boards whose maps are held.
        self._mapped: dict[tuple[LedRow, int, Point], Scene] = {}

    def run(self, report_progress: StageProgress) -> list[SearchedSite]:
        """Search on the grid, then around the best on finer ones, until time is over; the sites in that order."""
        step, start = self.rules.led_step_mm, report_progress.seconds
        available = max(SEARCH_SHARE * report_progress.limit_s - start, 1e-9)
        waiting = self.sites.rows(step)
        while waiting and step >= self.rules.led_step_mm / FINEST:
            for i, (row, places) in enumerate(waiting.items()):
                for done in self._trace(self._row(row, places), places, report_progress):
                    part = (report_progress.seconds - start) / available
                    by_count = (i + done) / len(waiting) / 2
                    report_progress("search", part if math.isfinite(available) else by_count)
                self._evaluate(self._rows[row])
                if report_progress.is_over(SEARCH_SHARE):
                    why = "was interrupted" if report_progress.interrupted else "ran out of time"
                    log.warning("the search for LED places %s after %d of them", why, len(self.results))
                    return list(self.results.values())
            step /= 2
            waiting = self._around_the_best(step)
        for best in ranked(self.results.values())[:SHORTLIST]:
            if report_progress.is_over(SEARCH_SHARE):
                break
            self._choose_again(best.site)
        return list(self.results.values())

    def _row(self, row: LedRow, places: list[list[Point]]) -> _Row:
        """A row, as far as it is traced."""
        if row not in self._rows:
            count = len(self.base.leds)
            walls = self.sites.board_at(0, places[0][0], row).layout.barriers
            fixed = [self.sites.die(i, self.sites.place_of(i)) for i in range(count) if self.sites.is_fixed[i]]
            self._rows[row] = _Row(row, self.sites.photodiode_places(walls, fixed), [{} for _ in range(count)])
        return self._rows[row]

    def _trace(self, row: _Row, places: list[list[Point]], report_progress: StageProgress) -> Iterable[float]:
        """Trace every LED at its new places, place by place, and yield the part that is done."""
        if len(row.places.areas) + len(row.places.stay) < self.rules.photodiodes:
            return
        waiting = [[p for p in each if p not in had] for each, had in zip(places, row.columns, strict=True)]
        longest = max(map(len, waiting))
        for k in range(longest):
            if report_progress.is_over(SEARCH_SHARE):
                return
            self._trace_at(row, [(i, each[k]) for i, each in enumerate(waiting) if k < len(each)], FIRST_PHOTONS)
            yield (k + 1) / longest

    def _trace_at(self, row: _Row, places: Sequence[tuple[int, Point]], photons: int) -> None:
        """Trace LEDs by number, each at a place of a row, unless there is no time."""
        for i, place, board in [(i, place, self.sites.board_at(i, place, row.row)) for i, place in places]:
            if (had := self.cache.photons_of(board)) < photons:
                self.cache.extend(board, photons - had)
            if self.cache.photons_of(board) > had or had >= photons:
                row.columns[i][place] = self._columns(i, board, row.places)
            self.cache.forget_tracer(board)
            self._mapped[row.row, i, place] = board

    def _choose_again(self, site: LedSite) -> None:
        """Choose a site's photodiodes once more, by more photons."""
        row = _Row(site.row, self._rows[site.row].places, [{} for _ in self.base.leds])
        self._trace_at(row, list(enumerate(site.places_mm)), SEARCH_PHOTONS)
        if all(row.columns):
            tables = self._tables(row, starts=LAST_STARTS)
            best = tables.best_photodiodes(site.places_mm, self.rules.photodiodes - len(row.places.stay))
            if best is not None:
                self._store(row, tables, best, SEARCH_PHOTONS)

    def _columns(self, led: int, board: Scene, places: PhotodiodePlaces) -> np.ndarray:
        """What an LED brings to photodiodes at all places and to those that stay, (fingers, m + s, c) float."""
        areas = [*places.areas, *places.stay]
        photodiodes, amplifier = self.sites.kinds(places), self.base.electronics
        columns = []
        for finger, ((light, *_), condition) in enumerate(
            zip(self.cache.maps(board), self.cache.conditions, strict=True)
        ):
            values = light.over(areas).mean(0)
            read = responses(values, self.base.leds[led], photodiodes, amplifier, condition.point, number=led)
            columns.append(self.objective.columns(finger, led, read))
        return np.stack(columns)

    def _evaluate(self, row: _Row) -> None:
        """Give every arrangement of a row's LEDs its photodiodes, as far as its light is traced, and free the maps that
        nothing will be added to."""
        if not all(row.columns):
            return
        tables = self._tables(row)
        known = [one.site.places_mm for one in ranked(self.results.values()) if one.site.row == row.row]
        for one in tables.search(self.rules.photodiodes - len(row.places.stay), known):
            self._store(row, tables, one, FIRST_PHOTONS)
        sites = [one.site for one in ranked(self.results.values())[:SHORTLIST]]
        held = {(site.row, i, place) for site in sites for i, place in enumerate(site.places_mm)}
        for key in self._mapped.keys() - held:
            self.cache.forget(self._mapped.pop(key))

    def _tables(self, row: _Row, *, starts: int = 1) -> DesignTables:
        places, sites = row.places, self.sites

        def allowed(leds: tuple[Point, ...]) -> np.ndarray:
            if row.row.side is not None:
                return np.ones(len(places.areas), bool)
            dies = [sites.die(i, place) for i, place in enumerate(leds)]
            return np.array([sites.is_beside(area, dies) for area in places.areas], bool)

        how = (self.objective.together, self.objective.score, places.centers_mm, places.spacing_mm)
        return DesignTables(row.columns, *how, sites.go_together, allowed, starts=starts)

    def _store(self, row: _Row, tables: DesignTables, one: Arrangement, photons: int) -> None:
        """Store the result of an arrangement of LEDs."""
        site = LedSite(one.leds, row.row)
        photodiodes = tuple(row.places.areas[k] for k in one.photodiodes)
        force_n = float(self.objective.force_of(tables.total(one.leds, one.photodiodes)))
        self.results[site] = SearchedSite(site, photodiodes, one.score, force_n, photons)

    def _around_the_best(self, step_mm: float) -> dict[LedRow, list[list[Point]]]:
        """Places beside those of the best sites: along their rows, beside another LED, and rows beside theirs."""
        requested: dict[LedRow, list[dict[Point, None]]] = {}

        def request(row: LedRow, led: int, place: Point) -> None:
            fixed, rounded = self.sites.is_fixed[led], (round(place[0], 4), round(place[1], 4))
            if fixed or self.sites.may_lie(led, rounded):
                by_led = requested.setdefault(row, [{} for _ in self.base.leds])
                by_led[led][place if fixed else rounded] = None

        for best in ranked(self.results.values())[:REFINED]:
            site = best.site
            for i, place in enumerate(site.places_mm):
                request(site.row, i, place)
                for other in self._beside(site, i, step_mm):
                    request(site.row, i, other)
            for row in self._rows_beside(site.row, step_mm):
                for i, place in enumerate(site.places_mm):
                    along = place[1 if row.side in ("left", "right") else 0]
                    request(row, i, place if self.sites.is_fixed[i] else self.sites.in_row(i, row, along))
        complete = {row: [list(one) for one in each] for row, each in requested.items() if all(each)}
        return {row: each for row, each in complete.items() if self._has_new(row, each) and self.sites.leaves_room(row)}

    def _has_new(self, row: LedRow, places: list[list[Point]]) -> bool:
        had = self._rows[row].columns if row in self._rows else [{} for _ in places]
        return any(place not in one for one, each in zip(had, places, strict=True) for place in each)

    def _beside(self, site: LedSite, led: int, step_mm: float) -> list[Point]:
        """Places of one LED a step along its row (on a board without walls: or across), or right beside another LED, at
        the clearance; in a row it stays in its own line."""
        if self.sites.is_fixed[led]:
            return []
        place, die, places = site.places_mm[led], self.sites.die(led, (0.0, 0.0)), []
        side = site.row.side
        for axis in (0, 1) if side is None else (1 - SIDES[side][0],):
            half = (die.u_max, die.v_max)[axis] + self.rules.clearance_mm
            for sign in (-1, 1):
                beside = [(place, place[axis] + sign * step_mm)]
                for k, other in enumerate(site.places_mm):
                    if k != led:
                        r = self.sites.die(k, other)
                        edge = ((r.u_min, r.u_max), (r.v_min, r.v_max))[axis][sign > 0]
                        beside.append((other if side is None else place, edge + sign * half))
                places += [(line[0], along) if axis else (along, line[1]) for line, along in beside]
        return places

    def _rows_beside(self, row: LedRow, step_mm: float) -> list[LedRow]:
        if row.side is None or row.face_mm is None or all(self.sites.is_fixed):
            return []
        rows = [LedRow(row.side, round(row.face_mm + sign * step_mm, 4)) for sign in (-1, 1)]
        return [one for one in rows if self.sites.is_before_fixed(one)]


def ranked(results: Iterable[SearchedSite]) -> list[SearchedSite]:
    """The best first."""
    return sorted(results, key=lambda one: one.score)


def shortlist(base: Scene, rules: Placement, results: Sequence[SearchedSite]) -> list[CandidateLayout]:
    """The best layouts of a search, to be judged with photons of their own: those of few photons look better than they
    are, and come after the others."""
    layouts = []
    for one in sorted(results, key=lambda one: (-one.photons, one.score))[:SHORTLIST]:
        name = one.site.name
        scene = candidates.searched(base, rules, one.site.places_mm, one.photodiodes, side=one.site.row.side, name=name)
        layouts.append(candidates.candidate(name, scene, "searched"))
    return layouts

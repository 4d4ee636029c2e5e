"""The search for a layout: places of the LEDs row by row on a grid, then finer around the best, from traced light."""

import logging
import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import zip_longest
from typing import Any

import numpy as np

from ...light.tracing import StageProgress
from ...scene import Placement, Scene
from ...scene.base import Point
from ...scene.layout import SIDES
from ...sensor.ambient import LAMP, ambient_bound_a
from ...sensor.electronics import stage_ohm
from ...sensor.information import brightest_current_a, response
from ...statistics import leave_one_out
from . import candidates
from .candidates import CandidateLayout
from .objective import Objective
from .photon_maps import PhotonMapCache
from .row_design import RowDesign, SearchedSite
from .sites import ROUNDING_MM, LedRow, PhotodiodePlaces, Sites

log = logging.getLogger(__name__)
# Photons per LED and finger for every place of the LED, in one batch, and for those of the best sites, whose
# photodiodes are chosen once more: the photons' noise adds to the information of positions, most where little light
# comes. With twice the latter the shipped scene's best came to 0.4(2) % above the bound of all layouts.
FIRST_PHOTONS, SEARCH_PHOTONS = 1 << 15, 1 << 17
# First photodiodes from which those of the best sites are chosen once more.
LAST_STARTS = 8
# Fraction of the time for the search.
SEARCH_SHARE = 0.55
# Searched layouts that are evaluated with photons of their own beside given ones, and sites for regular ones.
SHORTLIST, REGULAR, FAR_WORSE = 2, 3, 4.0
# Sites around which LED places are searched more finely, and into how many parts a step is halved.
REFINED, FINEST = 2, 4


class Search:
    """A search as far as it is.

    results : every site of the LEDs that was given photodiodes, by row and places.
    designs : of each row, by the first photons.
    regular : sites in the middle of a row with the photodiodes that are best in regular places.
    boards : on which the light of an LED at a place of a row is traced, and as which of its LEDs.
    """

    def __init__(self, base: Scene, objective: Objective, cache: PhotonMapCache) -> None:
        """base : a board whose parts lie straight, which `boards.check_search` has passed."""
        self.base, self.rules, self.objective, self.cache = base, objective.rules, objective, cache
        self.sites = Sites(base, self.rules)
        self.results: dict[tuple[LedRow, tuple[Point, ...]], SearchedSite] = {}
        self.designs: dict[LedRow, RowDesign] = {}
        self.regular: list[SearchedSite] = []
        self.boards: dict[tuple[LedRow, int, Point], tuple[Scene, int]] = {}

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
                design = self.designs[row] = self.designs.get(row) or self._design(row, places)
                for done in self._trace(design, places, report_progress):
                    part = (report_progress.seconds - start) / available
                    by_count = (i + done) / len(waiting) / 2
                    report_progress("search", part if math.isfinite(available) else by_count)
                if all(design.columns):
                    self._store(design.search([a.places_mm for a in self.ranked if a.row == row]))
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
        photons = min(photons, self.cache.most_photons or photons)
        how: dict[str, Any] = {"objective": self.objective, "photons": photons, "starts": LAST_STARTS}
        design = replace(self.designs[site.row], columns=[{} for _ in site.places_mm], **how)
        for _ in self._trace(design, [[place] for place in site.places_mm], report_progress):
            pass
        return design if all(design.columns) else None

    @property
    def ranked(self) -> list[SearchedSite]:
        """The best first."""
        return sorted(self.results.values(), key=lambda a: a.score)

    def _store(self, searched: Iterable[SearchedSite]) -> None:
        self.results |= {(a.row, a.places_mm): a for a in searched}

    def _design(self, row: LedRow, places: list[list[Point]]) -> RowDesign:
        """A row of which nothing is traced."""
        leds = range(len(self.base.leds))
        walls = self.sites.board_at(0, places[0][:1], row).layout.barriers
        fixed = {i: self.sites.place_of(i) for i in leds if self.sites.is_fixed[i]}
        beside = self.sites.photodiode_places(walls, fixed)
        photons = min(FIRST_PHOTONS, self.cache.most_photons or FIRST_PHOTONS)
        return RowDesign(self.sites, self.objective, row, beside, [{} for _ in leds], photons)

    def _trace(self, design: RowDesign, places: list[list[Point]], report_progress: StageProgress) -> Iterable[float]:
        """Trace every LED at its new places, place by place, as long as there is time; yields the part that is done."""
        if design.places.free < design.count:
            return
        each = ((i, p) for spots in zip_longest(*places) for i, p in enumerate(spots) if p)
        waiting = [(i, p) for i, p in each if p not in design.columns[i]]
        for led in range(len(places)):
            unknown = (p for i, p in waiting if i == led and (design.row, led, p) not in self.boards)
            for some in self.sites.apart(led, unknown):
                board = self.sites.board_at(led, some, design.row)
                self.boards |= {(design.row, led, place): (board, k) for k, place in enumerate(some)}
        for done, (led, place) in enumerate(waiting, 1):
            if report_progress.is_over(SEARCH_SHARE):
                break
            board, k = self.boards[design.row, led, place]
            maps = [by_led[k] for by_led in self.cache.traced_board(board).maps]
            # The first photons may be stored.
            for photons in (min(FIRST_PHOTONS, design.photons), design.photons):
                # LEDs that shine alike share their light.
                if (traced := min(light.photons for light in maps)) < photons:
                    self.cache.extend(board, photons - traced, k)
            if min(light.photons for light in maps) >= design.photons:
                design.columns[led][place] = self.columns(led, board, design.places, k)
            yield done / len(waiting)
        for led, place in waiting:
            self.cache.forget(self.boards[design.row, led, place][0])

    def columns(self, led: int, board: Scene, places: PhotodiodePlaces, lit_led: int = 0) -> np.ndarray:
        """What an LED brings to photodiodes at all places and to those that stay, (fingers, m + s, c) float; by all
        photons and without each block of them, (fingers, 1 + blocks, m + s, c), where there are several.

        lit_led : which of the LEDs of the traced board it is.
        """
        columns, kinds, one = [], places.photodiodes, self.base.leds[led]
        conditions, replicates = self.cache.conditions, self.cache.blocks > 1
        lit = [of_leds[lit_led].over(places.areas)[self.cache.part] for of_leds in self.cache.traced_board(board).maps]
        by_finger = [leave_one_out(values) if replicates else values.mean(0) for values in lit]
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
            columns.append(self.objective.information_columns(finger, led, read))
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
        scene = candidates.searched(base, rules, result.places_mm, result.photodiodes, wall=wall, name=result.name)
        layouts.append(candidates.candidate(result.name, scene, "searched"))
    return layouts

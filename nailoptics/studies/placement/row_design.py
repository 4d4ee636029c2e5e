"""The best photodiodes for LEDs in one row, by coordinate exchange, and the best places of the LEDs there.

References: Meyer, Nachtsheim 1995, Technometrics 37, 60.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, islice, product

import numpy as np

from ...scene.base import Point
from ...scene.layout import SIDES
from ...scene.rectangles import Rectangle
from .objective import Objective
from .sites import LedRow, PhotodiodePlaces, Sites

# Fraction of the score in which regular photodiodes are as good as the best, where waves count whole.
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
    allowed = np.ones(free.free, bool) if allowed is None else allowed

    def scores(others: list[int]) -> np.ndarray:
        """Of each place beside others that are taken."""
        values, left = np.full(free.free, np.inf), allowed & ~free.exclude[others].any(0)
        values[left] = score((given + information[:, others].sum(1))[:, None] + information[:, left])
        return values

    if count == 0:
        return [], float(score(given + information[:, :0].sum(1)))
    if count > free.free:
        return [], np.inf
    alone = scores([])
    ranked = _separate(np.argsort(alone), free.exclude) if count > 1 else iter(())
    best: tuple[list[int], float] = ([], np.inf)
    for first in [None, *(k for k in islice(ranked, starts - 1) if allowed[k])]:
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


def _separate(ranked: np.ndarray, exclude: np.ndarray) -> Iterator[int]:
    """Numbers of places in their order, each of a place that leaves room for those before it."""
    while ranked.size:
        yield int(ranked[0])
        ranked = ranked[~exclude[ranked[0], ranked]]


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
        where = " ".join(f"({u + 0.0:.3g} {v + 0.0:.3g})" for u, v in self.places_mm)
        several = "s" if len(self.places_mm) > 1 else ""
        return " ".join(filter(None, [f"LED{several} {where}", self.row.side, self.form]))


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
        return self.objective.sum_over_leds([by_place[at] for by_place, at in zip(self.columns, leds, strict=True)])

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
        if self.row.side:
            return None
        return self.sites.are_beside(self.places.areas[: self.places.free], dict(enumerate(leds)))

    def _site(self, leds: LedPlaces, chosen: list[int], total: np.ndarray) -> SearchedSite:
        """LEDs with chosen photodiodes, which together have this information."""
        values = self.objective.score(total), self.objective.value(self.objective.rules.over_fingers, total)
        score, force_n = map(float, values)
        areas = tuple(self.places.areas[k] for k in chosen)
        return SearchedSite(leds, self.row, areas, score, force_n, self.photons)

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

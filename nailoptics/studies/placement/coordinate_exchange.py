"""Coordinate exchange: photodiodes for given LEDs, LEDs for given photodiodes, in turns until nothing improves.

References: Meyer, Nachtsheim 1995, Technometrics 37, 60.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, islice, product
from typing import Any

import numpy as np

ROUNDS = 6
# So many combinations of LED places are evaluated each; of more, so many are starting points.
STARTS = 24
# Of more combinations than this a sample is drawn.
MOST_LISTED = 4096
# Relative improvement below which a search has converged.
CONVERGED = 1e-6

LedPlaces = tuple[Any, ...]


@dataclass(frozen=True)
class Arrangement:
    """LED places, in order, with the best photodiodes for them, by number, and their score; less is better."""

    leds: LedPlaces
    photodiodes: tuple[int, ...]
    score: float


def coordinate_exchange(
    information: np.ndarray,
    places: np.ndarray,
    *,
    count: int,
    spacing_mm: tuple[float, float],
    score: Callable[[np.ndarray], np.ndarray],
    given: np.ndarray | float = 0.0,
    allowed: np.ndarray | None = None,
    starts: int = 1,
) -> tuple[list[int], float]:
    """The places whose information together scores least, and the score: one after the other, then exchanged singly
    until nothing improves; inf where they have no room.

    information : (fingers, m, n) float. Of a photodiode at each place, as `fisher_information`.
    spacing_mm : two photodiodes lie at least so far from each other in u or in v.
    score : of sums of information (fingers, ..., n) -> (...).
    given : (fingers, n) float. Information of others that stay.
    allowed : (m,) bool. Places that may be taken; all if not given.
    starts : number of first places, the best by themselves that leave room for each other, from which it begins.
    """
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
class DesignTables:
    """What LEDs at their places bring to photodiodes at theirs.

    columns : of each LED at each of its places, (fingers, m + s, c) float: m places of photodiodes, then the s that
        stay.
    together : information of photodiodes by all LEDs' columns, (fingers, m + s, n) float.
    score : of sums of these (fingers, ..., n) -> (...).
    places_mm : (m, 2) float. Centres of photodiodes.
    fits : whether LEDs may have these places together.
    allowed : (m,) bool. Which photodiodes may lie beside LEDs at these places.
    starts : as of `coordinate_exchange`.
    """

    columns: Sequence[Mapping[Any, np.ndarray]]
    together: Callable[[Sequence[np.ndarray]], np.ndarray]
    score: Callable[[np.ndarray], np.ndarray]
    places_mm: np.ndarray
    spacing_mm: tuple[float, float]
    fits: Callable[[LedPlaces], bool]
    allowed: Callable[[LedPlaces], np.ndarray]
    starts: int = 1

    def information(self, leds: LedPlaces) -> np.ndarray:
        """Of photodiodes under LEDs at these places, (fingers, m + s, n) float."""
        return self.together([by_place[place] for by_place, place in zip(self.columns, leds, strict=True)])

    def total(self, leds: LedPlaces, chosen: Sequence[int]) -> np.ndarray:
        """Information of these photodiodes and those that stay, (fingers, n) float."""
        information = self.information(leds)
        return information[:, list(chosen)].sum(1) + information[:, len(self.places_mm) :].sum(1)

    def best_photodiodes(self, leds: LedPlaces, count: int) -> Arrangement | None:
        """The best photodiodes for LEDs at given places; None where they have no room."""
        information, free = self.information(leds), len(self.places_mm)
        chosen, score = coordinate_exchange(
            information[:, :free],
            self.places_mm,
            count=count,
            spacing_mm=self.spacing_mm,
            score=self.score,
            given=information[:, free:].sum(1),
            allowed=self.allowed(leds),
            starts=self.starts,
        )
        return Arrangement(leds, tuple(chosen), score) if np.isfinite(score) else None

    def _best_leds(self, arrangement: Arrangement) -> LedPlaces:
        """The LEDs' places, one after the other moved to where it is best, for photodiodes that stay where they are."""
        leds, chosen, reached = arrangement.leds, list(arrangement.photodiodes), arrangement.score
        for i, by_place in enumerate(self.columns):
            for place in by_place:
                tried = (*leds[:i], place, *leds[i + 1 :])
                if place == leds[i] or not self.fits(tried) or not self.allowed(tried)[chosen].all():
                    continue
                value = float(self.score(self.total(tried, chosen)))
                if value < reached * (1 - 1e-9):
                    leds, reached = tried, value
        return leds

    def _improved(self, leds: LedPlaces, count: int) -> Iterator[Arrangement]:
        """Arrangements from one start, photodiodes and LEDs exchanged in turns; the best last."""
        reached = math.inf
        while (one := self.best_photodiodes(leds, count)) and one.score < reached * (1 - CONVERGED):
            yield one
            leds, reached = self._best_leds(one), one.score
            if leds == one.leds:
                break

    def search(self, count: int, known: Sequence[LedPlaces] = ()) -> list[Arrangement]:
        """Every arrangement of LEDs that was given its photodiodes: of few each; of many what some of them lead to, and
        from the best of it on every step of one LED, or of two that change places, as long as that is better.

        known : arrangements that were tried, best first; of few they are left out, of many the best is a start.
        """
        every = self._arrangements()
        if len(every) <= STARTS or sum(len(one) > 1 for one in self.columns) <= 1:
            return [one for leds in every if leds not in known and (one := self.best_photodiodes(leds, count))]
        picked = [every[i] for i in np.linspace(0, len(every) - 1, STARTS).astype(int)]
        results: dict[LedPlaces, Arrangement] = {}
        for leds in dict.fromkeys((*known[:1], *picked)):
            results |= {one.leds: one for one in (self._improved(leds, count) if leds not in results else ())}
        tried, reached = set(results), math.inf
        while results and (best := min(results.values(), key=lambda one: one.score)).score < reached * (1 - CONVERGED):
            reached = best.score
            for leds in self._neighbours(best.leds):
                if leds not in tried and (better := self.best_photodiodes(leds, count)):
                    results[leds] = better
                tried.add(leds)
        return list(results.values())

    def _neighbours(self, leds: LedPlaces) -> list[LedPlaces]:
        """Arrangements in which one LED lies elsewhere, or two lie in each other's places."""
        moved = [(*leds[:i], place, *leds[i + 1 :]) for i, by_place in enumerate(self.columns) for place in by_place]
        for i, j in combinations(range(len(leds)), 2):
            if leds[j] in self.columns[i] and leds[i] in self.columns[j]:
                moved.append((*leds[:i], leds[j], *leds[i + 1 : j], leds[i], *leds[j + 1 :]))
        return [one for one in dict.fromkeys(moved) if one != leds and self.fits(one)]

    def _arrangements(self) -> list[LedPlaces]:
        """Places that LEDs may have together: all, or of very many a sample that is always the same."""
        pools = [list(one) for one in self.columns]
        if math.prod(map(len, pools)) <= MOST_LISTED:
            every = list(product(*pools))
        else:
            rng = np.random.default_rng(0)
            picks = np.stack([rng.integers(len(pool), size=MOST_LISTED) for pool in pools], -1)
            every = [tuple(pool[i] for pool, i in zip(pools, row, strict=True)) for row in picks]
        return [leds for leds in dict.fromkeys(every) if self.fits(leds)]

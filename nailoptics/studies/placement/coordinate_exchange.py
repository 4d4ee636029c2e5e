"""The places of LEDs and photodiodes that together tell most, by exchange: of photodiodes for given LEDs, of LEDs for
given photodiodes, in turns until nothing improves."""

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, islice, product
from typing import Generic, TypeVar

import numpy as np

ROUNDS = 6
# So many combinations of LED places are each given their own photodiodes; of more, so many are improved from.
STARTS = 24
# Of more combinations than this a sample is drawn.
MOST_LISTED = 4096

PlaceT = TypeVar("PlaceT", bound=Hashable)


@dataclass(frozen=True)
class Arrangement(Generic[PlaceT]):
    """LED places, in order, with the best photodiodes that were found for them, by number, and what is reached."""

    leds: tuple[PlaceT, ...]
    photodiodes: tuple[int, ...]
    reached: float


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
    until nothing improves.

    information : (fingers, m, n) float. What a photodiode at each place tells, as `fisher_information`.
    spacing_mm : two photodiodes lie at least so far apart in u or in v.
    score : of sums of information (fingers, ..., n) -> (...).
    given : (fingers, n) float. What others tell that stay.
    allowed : (m,) bool. Places that may be taken; all if not given.
    starts : from so many first places, the best by themselves that lie apart, it begins anew; the best of all is taken.
    """
    barred = np.zeros(len(places), bool) if allowed is None else ~allowed
    stays = np.zeros((len(information), information.shape[-1])) + given

    def scores(total: np.ndarray, taken: list[int]) -> np.ndarray:
        each = np.where(barred, np.inf, score(total[:, None] + information))
        each[taken] = np.inf
        for other in taken:
            away = np.abs(places - places[other])
            each[np.all(away < np.array(spacing_mm) - 1e-9, axis=1)] = np.inf
        return each

    def grown(chosen: list[int]) -> tuple[list[int], float]:
        reached = np.inf
        while len(chosen) < count:
            each = scores(stays + information[:, chosen].sum(1), chosen)
            chosen, reached = [*chosen, int(np.argmin(each))], float(each.min())
            if not np.isfinite(reached):
                return [], np.inf
        return exchanged(chosen, reached)

    def exchanged(chosen: list[int], reached: float) -> tuple[list[int], float]:
        for _ in range(ROUNDS):
            before = reached
            for i in range(count):
                others = chosen[:i] + chosen[i + 1 :]
                each = scores(stays + information[:, others].sum(1), others)
                if float(each.min()) < reached * (1 - 1e-9):
                    chosen[i], reached = int(np.argmin(each)), float(each.min())
            if reached >= before * (1 - 1e-6):
                break
        return chosen, reached

    if count == 0:
        return [], float(score(stays))
    found, ranked = grown([]), np.argsort(scores(stays, []))
    for first in islice(_apart(ranked, places, spacing_mm), starts - 1 if count > 1 else 0):
        if not barred[first]:
            found = min(found, grown([first]), key=lambda one: one[1])
    return found


def _apart(ranked: np.ndarray, places: np.ndarray, spacing_mm: tuple[float, float]) -> Iterator[int]:
    """Numbers of places in their order, each of a place that lies apart from those before it."""
    while ranked.size:
        yield int(ranked[0])
        away = np.abs(places[ranked] - places[ranked[0]])
        ranked = ranked[np.any(away >= spacing_mm, axis=1)]


@dataclass(frozen=True)
class DesignTables(Generic[PlaceT]):
    """What LEDs at their places bring to photodiodes at theirs.

    columns : of each LED at each of its places, (fingers, m, c) float, the first m photodiodes by number.
    stay : likewise of the photodiodes that stay, (fingers, s, c).
    together : what a photodiode tells of all LEDs' columns, (fingers, m, n) float.
    score : of sums of these (fingers, ..., n) -> (...).
    places_mm : (m, 2) float. Centres of photodiodes.
    go_together : whether LEDs may have these places together.
    beside : (m,) bool. Which photodiodes may lie beside LEDs at these places.
    starts : as of `coordinate_exchange`.
    """

    columns: Sequence[Mapping[PlaceT, np.ndarray]]
    stay: Sequence[Mapping[PlaceT, np.ndarray]]
    together: Callable[[Sequence[np.ndarray]], np.ndarray]
    score: Callable[[np.ndarray], np.ndarray]
    places_mm: np.ndarray
    spacing_mm: tuple[float, float]
    go_together: Callable[[tuple[PlaceT, ...]], bool]
    beside: Callable[[tuple[PlaceT, ...]], np.ndarray]
    starts: int = 1

    def best_photodiodes(self, leds: tuple[PlaceT, ...], count: int) -> Arrangement[PlaceT] | None:
        """The best photodiodes for LEDs at given places; None where they find no room."""
        new, stays = (
            self.together([one[place] for one, place in zip(each, leds, strict=True)])
            for each in (self.columns, self.stay)
        )
        chosen, reached = coordinate_exchange(
            new,
            self.places_mm,
            count=count,
            spacing_mm=self.spacing_mm,
            score=self.score,
            given=stays.sum(1),
            allowed=self.beside(leds),
            starts=self.starts,
        )
        return Arrangement(leds, tuple(chosen), reached) if np.isfinite(reached) else None

    def best_leds(self, found: Arrangement[PlaceT]) -> tuple[PlaceT, ...]:
        """The LEDs' places, one after the other moved to where it is best, for photodiodes that stay where they are."""
        leds, chosen, reached = found.leds, list(found.photodiodes), found.reached
        for i, own in enumerate(self.columns):
            for place in own:
                tried = (*leds[:i], place, *leds[i + 1 :])
                if place == leds[i] or not self.go_together(tried) or not self.beside(tried)[chosen].all():
                    continue
                value = self._read(tried, chosen)
                if value < reached * (1 - 1e-9):
                    leds, reached = tried, value
        return leds

    def _read(self, leds: tuple[PlaceT, ...], chosen: list[int]) -> float:
        return float(self.score(self.total(leds, chosen)))

    def total(self, leds: tuple[PlaceT, ...], chosen: list[int]) -> np.ndarray:
        """What these photodiodes and those that stay tell together, (fingers, n) float."""
        new = self.together([one[place][:, chosen] for one, place in zip(self.columns, leds, strict=True)])
        return new.sum(1) + self.together([one[p] for one, p in zip(self.stay, leds, strict=True)]).sum(1)

    def improved(self, leds: tuple[PlaceT, ...], count: int) -> list[Arrangement[PlaceT]]:
        """What is found from one start, photodiodes and LEDs exchanged in turns; the best last."""
        found: list[Arrangement[PlaceT]] = []
        while (one := self.best_photodiodes(leds, count)) is not None:
            if found and one.reached >= found[-1].reached * (1 - 1e-6):
                break
            found.append(one)
            leds = self.best_leds(one)
            if leds == one.leds:
                break
        return found

    def search(self, count: int, known: Sequence[tuple[PlaceT, ...]] = ()) -> list[Arrangement[PlaceT]]:
        """Every arrangement of LEDs that was given its photodiodes: of few each; of many what some of them lead to, and
        from the best of it on every step of one LED, or of two that change places, as long as that is better.

        known : arrangements that were tried, best first; of few they are left out, of many the best is a start.
        """
        every = self._arrangements()
        if len(every) <= STARTS or sum(len(one) > 1 for one in self.columns) <= 1:
            each = (self.best_photodiodes(leds, count) for leds in every if leds not in known)
            return [one for one in each if one is not None]
        picked = [every[i] for i in np.linspace(0, len(every) - 1, STARTS).astype(int)]
        found: dict[tuple[PlaceT, ...], Arrangement[PlaceT]] = {}
        for leds in dict.fromkeys((*known[:1], *picked)):
            for one in self.improved(leds, count) if leds not in found else ():
                found[one.leds] = one
        tried = set(found)
        while found:
            best = min(found.values(), key=lambda one: one.reached)
            for leds in self._beside(best.leds):
                better = None if leds in tried else self.best_photodiodes(leds, count)
                tried.add(leds)
                if better is not None:
                    found[leds] = better
            if min(one.reached for one in found.values()) >= best.reached * (1 - 1e-6):
                break
        return list(found.values())

    def _beside(self, leds: tuple[PlaceT, ...]) -> list[tuple[PlaceT, ...]]:
        """Arrangements in which one LED lies elsewhere, or two lie in each other's places."""
        moved = [(*leds[:i], place, *leds[i + 1 :]) for i, own in enumerate(self.columns) for place in own]
        for i, j in combinations(range(len(leds)), 2):
            swapped = list(leds)
            swapped[i], swapped[j] = leds[j], leds[i]
            if leds[j] in self.columns[i] and leds[i] in self.columns[j]:
                moved.append(tuple(swapped))
        return [one for one in dict.fromkeys(moved) if one != leds and self.go_together(one)]

    def _arrangements(self) -> list[tuple[PlaceT, ...]]:
        """Places that LEDs may have together: all, or of very many a sample that is always the same."""
        pools = [list(one) for one in self.columns]
        if np.prod([float(len(pool)) for pool in pools]) <= MOST_LISTED:
            every = list(product(*pools))
        else:
            rng = np.random.default_rng(0)
            picks = np.stack([rng.integers(len(pool), size=MOST_LISTED) for pool in pools], -1)
            every = [tuple(pool[i] for pool, i in zip(pools, row, strict=True)) for row in picks]
        return [leds for leds in dict.fromkeys(every) if self.go_together(leds)]

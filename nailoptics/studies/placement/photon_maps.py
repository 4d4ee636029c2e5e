"""Photon maps of boards on every finger: traced once, extended where more photons are needed, read as any layout."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...geometry import SPACING_MM
from ...light.board_map import Arrivals, BoardTracer, PhotonMap, blood_point
from ...light.identity import light_digest, light_scene
from ...light.tracing.store import LightStore
from ...scene import FingerCase, Scene, digest
from ...scene.rectangles import Rectangle
from ...sensor.information import OperatingPoint, Response, responses
from ...statistics import left_out, seed_of
from . import boards

# Cells of the distances that the walk asks for, of boards that are traced for a second or two each: made in 0.3 s of
# processor time less than the usual ones, a tenth slower to walk.
QUICK_DISTANCE_MM = 0.3


def batch_seed(seed: int, stream: int, traced: Scene, led: int, batch: int) -> int:
    """The seed of a batch of photons, from what decides the light: it depends neither on those before nor on blood."""
    return seed_of(seed, stream, int(light_digest(traced)[:8], 16), led, batch)


class Stopped(Exception):
    """There was no time to finish."""


@dataclass(frozen=True)
class FingerCondition:
    """A finger on which layouts are judged, and the touch there."""

    case: FingerCase
    point: OperatingPoint


@dataclass
class PhotonMapCache:
    """Photon maps by board; boards that differ only in their photodiodes share one.

    distance_mm : cells of the distances that the walk asks for.
    batch_photons : of one batch; as the tracer's if not given.
    store : the cache of traced light.
    stop : whether nothing more is to be traced, tested before every batch.
    """

    conditions: Sequence[FingerCondition]
    seed: int
    stream: int
    backend: str
    blocks: int
    distance_mm: float = SPACING_MM
    batch_photons: int | None = None
    store: LightStore | None = None
    stop: Callable[[], bool] = lambda: False
    photons: int = field(default=0, init=False)
    _maps: dict[str, list[list[PhotonMap]]] = field(default_factory=dict, init=False)
    _tracers: dict[tuple[str, str | None], BoardTracer] = field(default_factory=dict, init=False)
    _areas: dict[str, list[Rectangle]] = field(default_factory=dict, init=False)
    _recorded: dict[tuple[str, str | None, int], list[Arrivals]] = field(default_factory=dict, init=False)

    @property
    def cases(self) -> list[FingerCase]:
        """The fingers of the conditions."""
        return [one.case for one in self.conditions]

    def maps(self, board: Scene) -> list[list[PhotonMap]]:
        """Maps of a bare board by finger and LED."""
        return self._maps[digest(board)]

    def photons_of(self, board: Scene) -> int:
        """How many photons of every LED were traced on every finger."""
        return self._photons_of(digest(board))

    def _photons_of(self, key: str) -> int:
        return min((one.photons for by_led in self._maps.get(key, []) for one in by_led), default=0)

    def record(self, board: Scene, areas: Sequence[Rectangle]) -> None:
        """Record the light that arrives on these areas of a board from now on, for `recorded`."""
        self._areas.setdefault(digest(board), []).extend(areas)

    def recorded(self, board: Scene, digit: str | None, led: int) -> list[Arrivals]:
        """Light of an LED on a finger's digit that arrived on the areas to record, batch by batch."""
        return self._recorded.get((digest(board), digit, led), [])

    @property
    def has_traced(self) -> bool:
        """Whether there is light of every LED on every finger of some board."""
        return any(map(self._photons_of, self._maps))

    def extend(self, board: Scene, photons: int) -> None:
        """Trace so many photons more, per LED and finger, of a bare board; fewer where it has to stop."""
        key = digest(board)
        if key not in self._maps:
            outline = board.layout.outline
            self._maps[key] = [
                [PhotonMap(outline, values=4, blocks=self.blocks) for _ in board.leds] for _ in self.conditions
            ]
        # Conditions of one digit differ in what only dims the light: they share a trace.
        for digit in dict.fromkeys(condition.case.digit for condition in self.conditions):
            members = [i for i, condition in enumerate(self.conditions) if condition.case.digit == digit]
            if (key, digit) not in self._tracers:
                if self.stop():
                    return
                traced = boards.worn_on(board, self.conditions[members[0]].case, light_only=True)
                how: dict[str, Any] = {"backend": self.backend, "store": self.store, "seed": self.seed}
                self._tracers[key, digit] = BoardTracer(light_scene(traced), spacing_mm=self.distance_mm, **how)
            for led in range(len(board.leds)):
                self._extend_led(key, self._tracers[key, digit], board, led, members, photons)

    def _extend_led(
        self, key: str, tracer: BoardTracer, board: Scene, led: int, members: list[int], photons: int
    ) -> None:
        """Trace one LED on one digit and add its light to the maps of all conditions of that digit."""
        points, digit = {}, self.conditions[members[0]].case.digit
        for i in members:
            scene, blood = boards.worn_on(board, self.conditions[i].case), self.conditions[i].point.blood_fraction
            points[i] = blood_point(scene, led, traced=tracer.scene, blood_fraction=blood)
        each = self.batch_photons or tracer.batch_photons
        first = self._maps[key][members[0]][led].photons // each
        for batch in range(first, first + max(1, round(photons / each))):
            if self.stop():
                return
            seed = batch_seed(self.seed, self.stream, tracer.scene, led, batch)
            arrivals = tracer.arrivals(led, photons=each, seed=seed)
            self.photons += arrivals.photons
            if areas := self._areas.get(key):
                u, v = arrivals.place_mm.T
                inside = np.any([area.holds(u, v) for area in areas], axis=0)
                self._recorded.setdefault((key, digit, led), []).append(arrivals.select(inside))
            for i, point in points.items():
                self._maps[key][i][led].add(arrivals, point.values(arrivals))

    def forget(self, board: Scene) -> None:
        """Free what a board holds."""
        self.forget_tracer(board)
        self._maps.pop(digest(board), None)

    def forget_tracer(self, board: Scene) -> None:
        """Free what traces a board, and leave its maps."""
        key = digest(board)
        self._tracers = {name: tracer for name, tracer in self._tracers.items() if name[0] != key}

    def read(self, layout: Scene, board: Scene) -> list[list[Response]]:
        """Responses of a layout, by finger and LED, each (1 + blocks, photodiodes): by all photons, then without each
        block of them."""
        areas, photodiodes = layout.layout.photodiode_areas, [one.photodiode for one in layout.layout.photodiodes]
        return [
            [
                responses(
                    left_out(one.over(areas)),
                    led,
                    photodiodes,
                    layout.electronics,
                    condition.point,
                    number=k,
                    replicates=True,
                )
                for k, (led, one) in enumerate(zip(layout.leds, by_led, strict=True))
            ]
            for condition, by_led in zip(self.conditions, self.maps(board), strict=True)
        ]

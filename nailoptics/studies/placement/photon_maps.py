"""Photon maps of boards on every finger: traced once, extended where more photons are needed, read as any layout."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from ...light.board_map import Arrivals, BoardTracer, PhotonMap, blood_point, readings
from ...light.identity import light_digest
from ...light.tracing.store import LightStore
from ...options import BackendName
from ...scene import FingerCase, Scene, digest
from ...scene.rectangles import Rectangle
from ...sensor import electronics
from ...sensor.ambient import LAMP, ambient_bound_a
from ...sensor.information import OperatingPoint, Response, brightest_current_a, scene_responses
from ...statistics import leave_one_out, seed_of
from . import boards
from .boards import PersonCase

PERSON_SHARE = 0.5  # fraction of the photons of a finger that a person has
LEAST_PHOTONS = 4096  # fewer say too little of a layout


def batch_seed(seed: int, stream: int, traced: Scene, led: int, batch: int) -> int:
    """The seed of a batch of photons, from what decides the light: it depends neither on those before nor on blood."""
    return seed_of(seed, stream, int(light_digest(traced)[:8], 16), led, batch)


def recorded(
    batches: Sequence[Arrivals], scene: Scene, led: int, point: OperatingPoint, areas: Sequence[Rectangle], blocks: int
) -> np.ndarray:
    """Means per emitted photon of light of one LED that was recorded on areas, (blocks, areas, values) float."""
    blood, light = blood_point(scene, led, blood_fraction=point.blood_fraction), Arrivals.joined(batches)
    return readings(light, blood.values(light), areas, blocks=blocks)[0]


class Stopped(Exception):
    """There was no time to finish."""


@dataclass(frozen=True)
class FingerCondition:
    """A finger on which layouts are evaluated, and the touch there."""

    case: FingerCase | PersonCase
    point: OperatingPoint


@dataclass
class TracedBoard:
    """Light of a bare board.

    maps : by finger and LED. tracers : by digit.
    areas : where light that arrives is recorded, in `arrivals`, by digit or person and LED, batch by batch.
    batches : how many were traced, likewise.
    """

    maps: list[list[PhotonMap]]
    batches: dict[tuple[str | None, int], int] = field(default_factory=dict)
    tracers: dict[str | None, BoardTracer] = field(default_factory=dict)
    areas: list[Rectangle] = field(default_factory=list)
    arrivals: dict[tuple[str | None, int], list[Arrivals]] = field(default_factory=dict)

    @property
    def photons(self) -> int:
        """How many photons of every LED were traced on every finger."""
        return min(board_map.photons for by_led in self.maps for board_map in by_led)


@dataclass
class PhotonMapCache:
    """Photon maps by board; boards that differ only in their photodiodes share one.

    one_by_one : as of `BoardTracer`.
    most_photons : of an LED.
    stores : where traced light is stored.
    stop : whether nothing more is to be traced, tested before every batch.
    ambient_a : by digest of a layout, photocurrents by light from outside to which "auto" fits. [A]
    part : of the blocks of photons by which fingers are read.
    """

    conditions: Sequence[FingerCondition]
    seed: int
    stream: int
    backend: BackendName
    blocks: int
    one_by_one: bool = False
    most_photons: int | None = None
    stores: Sequence[LightStore] = ()
    stop: Callable[[], bool] = lambda: False
    part: slice = field(default_factory=lambda: slice(None))
    photons: int = field(default=0, init=False)
    _traced: dict[str, TracedBoard] = field(default_factory=dict, init=False)
    ambient_a: dict[str, np.ndarray] = field(default_factory=dict, init=False)

    @property
    def cases(self) -> list[FingerCase]:
        """The fingers of the conditions, without people."""
        return [condition.case for condition in self.conditions if not isinstance(condition.case, PersonCase)]

    @property
    def people(self) -> list[PersonCase]:
        """The people of the conditions, who come last; their light is recorded on areas alone."""
        return [condition.case for condition in self.conditions if isinstance(condition.case, PersonCase)]

    def on_fingers(self, part: slice) -> "PhotonMapCache":
        """The light on the fingers alone, read by part of its blocks."""
        same = replace(self, conditions=self.conditions[: len(self.cases)], part=part, blocks=1)
        same._traced = self._traced
        return same

    def tracer(self, scene: Scene) -> BoardTracer:
        """What traces a scene's light onto its board."""
        return BoardTracer(scene, backend=self.backend, stores=self.stores, seed=self.seed, one_by_one=self.one_by_one)

    def traced_board(self, board: Scene) -> TracedBoard:
        """What is traced of a board; of a new one nothing."""
        if (key := digest(board)) not in self._traced:
            new = partial(PhotonMap, board.layout.outline, values=4, blocks=self.blocks)
            self._traced[key] = TracedBoard([[new() for _ in board.leds] for _ in self.cases])
        return self._traced[key]

    @property
    def boards_traced(self) -> int:
        """Boards with a map of every LED on every finger."""
        return sum(board.photons > 0 for board in self._traced.values())

    def extend(self, board: Scene, photons: int, led: int | None = None) -> None:
        """Trace so many photons more, per LED, or of one LED, and finger, of a bare board; fewer where it has to stop.

        Conditions of one digit differ in what only dims the light: they share a trace. On a person's board no part lies
        off the nail; tracers of many people would fill the memory.
        """
        held = self.traced_board(board)
        cases: list[FingerCase | PersonCase] = [*self.people, *self.cases]
        for key, case in {case.digit: case for case in cases}.items():
            is_person, worn = isinstance(case, PersonCase), boards.worn_on(board, case, light_only=True)
            if (is_person and not boards.fits(worn)) or (key not in held.tracers and self.stop()):
                continue
            tracer = held.tracers.get(key) or self.tracer(worn)
            for i in range(len(board.leds)) if led is None else [led]:
                self._extend_led(board, tracer, key, i, PERSON_SHARE * photons if is_person else photons)
            if not is_person:
                held.tracers[key] = tracer

    def _extend_led(self, board: Scene, tracer: BoardTracer, key: str | None, led: int, photons: float) -> None:
        """Trace one LED on one digit or person, and add its light to the maps of all conditions of that digit."""
        held, members = self.traced_board(board), []
        for by_led, condition in zip(held.maps, self.conditions, strict=False):
            if condition.case.digit == key:
                worn, blood = boards.worn_on(board, condition.case), condition.point.blood_fraction
                members.append((by_led[led], blood_point(worn, led, blood_fraction=blood)))
        batches = math.ceil((photons := max(photons, LEAST_PHOTONS)) / tracer.batch_photons)
        for _ in range(batches):
            if self.stop():
                return
            batch = held.batches.get((key, led), 0)
            seed = batch_seed(self.seed, self.stream, tracer.scene, led, batch)
            arrivals = tracer.arrivals(led, photons=round(photons / batches), seed=seed)
            held.batches[key, led] = batch + 1
            self.photons += arrivals.photons
            if held.areas:
                on_areas = np.any([area.holds(*arrivals.place_mm.T) for area in held.areas], axis=0)
                held.arrivals.setdefault((key, led), []).append(arrivals.select(on_areas))
            for board_map, point in members:
                board_map.add(arrivals, point.values(arrivals))

    def check_time(self) -> None:
        """Raise `Stopped` where nothing more is to be traced."""
        if self.stop():
            raise Stopped

    def forget(self, board: Scene) -> None:
        """Free what is held of a board."""
        self._traced.pop(digest(board), None)

    def read(self, layout: Scene, board: Scene, count: int | None = None) -> list[list[Response]]:
        """Responses of a layout, by finger and LED, each (1 + blocks, photodiodes): by all photons, then without each
        block of them.

        count : on the first so many fingers; on all, and of all people, if not given.
        """
        fitted = self.with_resistors(layout, board)
        return [
            scene_responses(fitted, map(leave_one_out, self._light(layout, board, i)), condition.point, replicates=True)
            for i, condition in enumerate(self.conditions[:count])
        ]

    def _light(self, layout: Scene, board: Scene, i: int) -> list[np.ndarray]:
        """Means per emitted photon on one of the fingers by LED, each (blocks, photodiodes, values); dark where some
        part lies off a person's nail."""
        areas, condition, held = layout.layout.photodiode_areas, self.conditions[i], self.traced_board(board)
        if not isinstance(person := condition.case, PersonCase):
            return [light.over(areas)[self.part] for light in held.maps[i]]
        if not boards.fits(boards.worn_on(layout, person)):
            return [np.zeros((self.blocks, len(areas), 4)) for _ in board.leds]
        worn = boards.worn_on(board, person)
        by_led = (held.arrivals[person.name, led] for led in range(len(board.leds)))
        return [recorded(light, worn, k, condition.point, areas, self.blocks) for k, light in enumerate(by_led)]

    def with_resistors(self, layout: Scene, board: Scene) -> Scene:
        """The layout with its "auto" resistors for the brightest light on any finger, beside [ambient] or a lamp."""
        if electronics.has_resistors(layout):
            return layout
        lit_a = [
            brightest_current_a(light.mean(0), led, layout.elements, condition.point)
            for i, condition in enumerate(self.conditions)
            for led, light in zip(layout.leds, self._light(layout, board, i), strict=True)
        ]
        if (key := digest(layout)) not in self.ambient_a:
            self.ambient_a[key] = ambient_bound_a(layout, usual=LAMP)
        return electronics.with_resistors(layout, np.max(lit_a, axis=0) + self.ambient_a[key])

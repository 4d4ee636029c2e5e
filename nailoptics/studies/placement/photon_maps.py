"""Photon maps of boards on every finger: traced once, grown where more photons are needed, read as any layout."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...light.board_map import BloodPoint, BoardTracer, PhotonMap, blood_point
from ...scene import FingerCase, Scene, digest
from . import boards
from . import fisher as merit


@dataclass(frozen=True)
class View:
    """A finger on which layouts are judged, and the touch there."""

    case: FingerCase
    at: merit.Operating


class Bank:
    """Photon maps by board; boards that differ only in their photodiodes are one."""

    def __init__(
        self,
        views: Sequence[View],
        *,
        seed: int,
        stream: int,
        backend: str,
        spacing_mm: float,
        blocks: int,
        quick: bool = False,
    ) -> None:
        """quick : boards are traced for a second or two each, so that what is made for each must be made soon."""
        # Cells of the distances that the walk asks for: at 0.2 mm they take a quarter of the time, the walk a tenth
        # more.
        self.distance_mm = 0.2 if quick else 0.1
        self.views, self.seed, self.stream, self.backend = tuple(views), seed, stream, backend
        self.spacing_mm, self.blocks = spacing_mm, blocks
        self._maps: dict[str, list[list[PhotonMap]]] = {}
        self._tracers: dict[tuple[str, str], BoardTracer] = {}
        self.photons = 0

    def maps(self, board: Scene) -> list[list[PhotonMap]]:
        """Maps of a bare board by finger and LED."""
        return self._maps[digest(board)]

    def grow(self, board: Scene, photons: int) -> None:
        """Trace so many photons more, per LED and finger, of a bare board."""
        key = digest(board)
        if key not in self._maps:
            outline = board.layout.outline
            self._maps[key] = [
                [PhotonMap(outline, values=4, spacing_mm=self.spacing_mm, blocks=self.blocks) for _ in board.leds]
                for _ in self.views
            ]
        shapes: dict[str, list[int]] = {}
        for i, view in enumerate(self.views):
            shapes.setdefault(view.case.digit or "", []).append(i)
        for digit, members in shapes.items():
            traced = boards.on_finger(board, self.views[members[0]].case, light_only=True)
            if (key, digit) not in self._tracers:
                self._tracers[key, digit] = BoardTracer(traced, backend=self.backend, spacing_mm=self.distance_mm)
            tracer = self._tracers[key, digit]
            for led in range(len(board.leds)):
                points = [self._point(board, self.views[i], led, traced) for i in members]
                first = self._maps[key][members[0]][led].photons // tracer.batch_photons
                for batch in range(first, first + max(1, round(photons / tracer.batch_photons))):
                    # From the board's digest, so that a trace does not depend on which were made before it.
                    keys = (self.stream, int(key[:8], 16), members[0], led, batch)
                    state = np.random.SeedSequence(self.seed, spawn_key=keys).generate_state(1, np.uint64)
                    arrivals = tracer.arrivals(led, photons=tracer.batch_photons, seed=int(state[0]))
                    self.photons += arrivals.photons
                    for i, point in zip(members, points, strict=True):
                        self._maps[key][i][led].add(arrivals, point.values(arrivals))

    def forget(self, board: Scene) -> None:
        """Free what a board holds."""
        key = digest(board)
        self._maps.pop(key, None)
        for name in [name for name in self._tracers if name[0] == key]:
            del self._tracers[name]

    def read(self, layout: Scene, board: Scene) -> list[list[merit.Volts]]:
        """Readings of a layout, by finger and LED, each (1 + blocks, photodiodes): by all photons, then without each
        block of them."""
        areas, maps = boards.elements(layout), self.maps(board)
        entries = [e.photodiode for e in layout.layout.photodiodes]
        out: list[list[merit.Volts]] = []
        for view, by_led in zip(self.views, maps, strict=True):
            out.append([])
            for led, one in zip(layout.leds, by_led, strict=True):
                out[-1].append(merit.volts(left_out(one.over(areas)), led, entries[0], layout.electronics, view.at))
        return out

    def _point(self, board: Scene, view: View, led: int, traced: Scene) -> BloodPoint:
        scene = boards.on_finger(board, view.case)
        return blood_point(scene, led, traced=traced, blood_fraction=view.at.blood_fraction, dermis=view.case.dermis)


def left_out(blocks: np.ndarray) -> np.ndarray:
    """Means over all blocks, and over all but each, (1 + blocks, ...) float."""
    total = blocks.sum(0)
    return np.concatenate([total[None] / len(blocks), (total - blocks) / (len(blocks) - 1)])


def jackknife(replicates: np.ndarray) -> np.ndarray:
    """Standard error from values by all blocks and without each, along the first axis (Efron 1982)."""
    each = replicates[1:]
    return np.sqrt((len(each) - 1) / len(each) * ((each - each.mean(0)) ** 2).sum(0))

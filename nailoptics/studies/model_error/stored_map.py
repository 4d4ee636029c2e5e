"""A photon map of a bare board, stored once and read as any layout of photodiodes: first-order in the blood."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np

from ...light.board_map import BoardTracer, PhotonMap, blood_point
from ...options import BackendName
from ...scene import Scene
from ...statistics import left_out, seed_of
from ..placement.boards import candidate

# What a map of one scene's LED takes its random numbers from, besides the seed and the number of LED and batch.
STREAM = 7


@dataclass(frozen=True)
class StoredMap:
    """Maps of every LED of a scene on its board without photodiodes.

    cpu_seconds : that it took to make them, in all.
    """

    maps: tuple[PhotonMap, ...]
    cpu_seconds: float

    @classmethod
    def of(
        cls, scene: Scene, *, photons: int, seed: int, backend: BackendName, check: Callable[[], None] = lambda: None
    ) -> Self:
        """Trace the maps, so many photons for each LED; raises InputError for a board with walls on several sides.

        check : called before every batch, to raise where there is no time for it.
        """
        begin = time.process_time()
        board = candidate("the scene's board", scene, "given").board
        tracer, maps = BoardTracer(board, backend=backend), []
        for led in range(len(scene.leds)):
            point = blood_point(board, led)
            one = PhotonMap(board.layout.outline, values=2 + len(point.beds))
            for batch, start in enumerate(range(0, photons, tracer.batch_photons)):
                check()
                count = min(tracer.batch_photons, photons - start)
                arrivals = tracer.arrivals(led, photons=count, seed=seed_of(seed, STREAM, led, batch))
                one.add(arrivals, point.values(arrivals))
            maps.append(one)
        return cls(tuple(maps), time.process_time() - begin)

    def read(self, scene: Scene) -> np.ndarray:
        """Readings at rest and their derivatives to the blood of each zone, (led, 1 + blocks, photodiode, 1 + zones).

        By all photons, then without each block of them. Fractions of the emitted power, weighed as a trace's are.
        """
        areas = scene.layout.photodiode_areas
        return np.stack([left_out(one.over(areas))[..., [0, *range(2, one.sums.shape[0])]] for one in self.maps])

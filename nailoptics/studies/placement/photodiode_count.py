"""How many photodiodes, and where, with the body's noise and without: the best layout's board with fewer and more."""

from dataclasses import dataclass

import numpy as np
import xarray as xr

from ...light.board_map import PhotonMap
from ...scene import Scene
from ...sensor.information import Response, fisher_information, responses
from ...statistics import jackknife, left_out
from ...variables import variable
from . import boards
from .boards import CandidateLayout
from .exchange import exchange
from .objective import Objective
from .photon_maps import PhotonMapCache
from .sites import PhotodiodePlaces, Sites

COUNTS = (2, 3, 4, 6, 8, 12, 16)


@dataclass(frozen=True)
class _Read:
    """What a photodiode at each place, then those that stay, would read, by finger and LED: (..., m + s)."""

    places: PhotodiodePlaces
    chosen_by: list[list[Response]]
    judged_by: list[list[Response]]

    def chosen(self, count: int, objective: Objective, *, electronics_alone: bool) -> list[int] | None:
        """The photodiodes, by number, that with those that stay are best as so many; None where that is not possible.

        Half of the photons choose, the others judge: what is chosen and judged by the same photons looks finer than it
        is.
        """
        free = len(self.places.areas)
        more = count - len(self.places.stay)
        if not 0 <= more <= free:
            return None
        told = _information(self.chosen_by, electronics_alone=electronics_alone)
        found, reached = exchange(
            told[:, :free],
            self.places.centers_mm,
            count=more,
            spacing_mm=self.places.apart_mm,
            score=objective.force_n,
            given=told[:, free:].sum(1),
        )
        return [*found, *range(free, told.shape[1])] if np.isfinite(reached) else None


def resolution_by_count(
    layout: CandidateLayout, base: Scene, cache: PhotonMapCache, objective: Objective
) -> xr.Dataset:
    """The force that so many photodiodes resolve on a layout's board, where they are best for it.

    base : the scene that was searched, with what stays of it.

    Returns: Dataset over chosen_for, the body's noise (if there is a body) and the electronics alone, and over
    photodiode_count; counts that find no room are NaN.
    """
    read, has_body = _read(layout, base, cache, objective), any(point.body is not None for point in objective.points)
    noises = ("body", "electronics") if has_body else ("electronics",)
    counts = sorted({*COUNTS, len(layout.scene.layout.photodiodes)})
    centers = np.array([area.center_mm for area in (*read.places.areas, *read.places.stay)])
    shape = (len(noises), len(counts))
    found, errors = np.full((2, *shape), np.nan), np.full((2, *shape), np.nan)
    centers_mm = np.full((*shape, counts[-1], 2), np.nan)
    judging = [_information(read.judged_by, electronics_alone=alone) for alone in (False, True)]
    for i, purpose in enumerate(noises):
        for j, count in enumerate(counts):
            chosen = read.chosen(count, objective, electronics_alone=purpose == "electronics")
            if chosen is None:
                continue
            centers_mm[i, j, :count] = centers[chosen]
            for k, information in enumerate(judging):
                replicates = objective.force_n(information[..., chosen, :].sum(-2))
                found[k, i, j], errors[k, i, j] = replicates[0], replicates[0] * jackknife(np.log(replicates))
    over = ("chosen_for", "photodiode_count")
    text = "force resolution of so many photodiodes through the body's noise"
    data = variable("count_resolution_n", over, found[0], text, units="N", stderr=errors[0]) if has_body else {}
    text = "force resolution of so many photodiodes by the noise of the electronics alone"
    data |= variable("count_electronics_resolution_n", over, found[1], text, units="N", stderr=errors[1])
    data |= variable("count_place_mm", (*over, "count_place", "axis"), centers_mm, "their places", units="mm")
    return xr.Dataset(data, {"chosen_for": list(noises), "photodiode_count": counts})


def _read(layout: CandidateLayout, base: Scene, cache: PhotonMapCache, objective: Objective) -> _Read:
    """What one photodiode reads wherever it may lie, by one half of the photons and, block by block, by the other."""
    rules, board = objective.rules, layout.board.layout
    # A given layout may lie on a board of its own.
    own = base if layout.origin == "searched" else boards.searchable(boards.explicit(layout.scene, layout.name), rules)
    sites = Sites(own, rules)
    places = sites.photodiode_places(board.barriers, board.leds)
    areas, photodiodes = [*places.areas, *places.stay], sites.kinds(places)

    def read(finger: int, number: int, one: PhotonMap) -> tuple[Response, Response]:
        blocks, led, amplifier = one.over(areas), layout.board.leds[number], layout.scene.electronics
        how = (led, photodiodes, amplifier, objective.points[finger])
        chosen_by = responses(blocks[::2].mean(0), *how, number=number)
        return chosen_by, responses(left_out(blocks[1::2]), *how, number=number, replicates=True)

    both = [[read(k, i, one) for i, one in enumerate(each)] for k, each in enumerate(cache.maps(layout.board))]
    chosen_by, judged_by = ([[pair[k] for pair in by_led] for by_led in both] for k in range(2))
    return _Read(places, chosen_by, judged_by)


def _information(by_finger: list[list[Response]], *, electronics_alone: bool) -> np.ndarray:
    """What a photodiode at each place tells under all LEDs, (fingers, ..., m, n) float, as `fisher_information`."""
    return np.stack(
        [
            np.sum([fisher_information(read, electronics_alone=electronics_alone) for read in by_led], axis=0)
            for by_led in by_finger
        ]
    )

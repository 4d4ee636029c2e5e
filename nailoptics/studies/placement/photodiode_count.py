"""How many photodiodes, and where, with the body's noise and without: the best layout's board with fewer and more."""

from dataclasses import dataclass

import numpy as np
import xarray as xr

from ...scene import Placement
from ...statistics import jackknife, left_out
from ...variables import variable
from .boards import CandidateLayout
from .exchange import exchange, free_places
from .fisher import Response, fisher_information, force_resolution_n, over_fingers, response
from .photon_maps import PhotonMapCache

COUNTS = (2, 3, 4, 6, 8, 12, 16)
# What photodiodes are chosen against.
CHOSEN_FOR = ("body", "electronics")


@dataclass(frozen=True)
class _Places:
    """Places of one photodiode on a board, and what it would read there, by finger and LED: (..., m)."""

    centers_mm: np.ndarray
    size_mm: tuple[float, float]
    chosen_by: list[list[Response]]
    judged_by: list[list[Response]]


def resolution_by_count(layout: CandidateLayout, cache: PhotonMapCache, rules: Placement) -> xr.Dataset:
    """The force that so many photodiodes resolve on a layout's board, where they are best with the body and without.

    Half of the photons choose the photodiodes, the others judge them: what is chosen and judged by the same photons
    looks finer than it is.

    Returns: Dataset over chosen_for and photodiode_count; counts that find no room are NaN.
    """
    places, points = _read(layout, cache, rules), [condition.point for condition in cache.conditions]
    gap = rules.clearance_mm
    spacing_mm = (places.size_mm[0] + gap, places.size_mm[1] + gap)

    def resolution(information: np.ndarray) -> np.ndarray:
        each = [force_resolution_n(*both) for both in zip(information, points, strict=True)]
        return over_fingers(np.stack(each), rules.rank_by)

    shape = (len(CHOSEN_FOR), len(COUNTS))
    found, errors = np.full((2, *shape), np.nan), np.full((2, *shape), np.nan)
    centers_mm = np.full((len(CHOSEN_FOR), len(COUNTS), COUNTS[-1], 2), np.nan)
    judging = [_information(places.judged_by, electronics_alone=alone) for alone in (False, True)]
    for i, purpose in enumerate(CHOSEN_FOR):
        told = _information(places.chosen_by, electronics_alone=purpose == "electronics")
        for j, count in enumerate(COUNTS):
            chosen: list[int] = []
            if len(places.centers_mm) >= count:
                chosen, _ = exchange(told, places.centers_mm, count=count, spacing_mm=spacing_mm, score=resolution)
            if not chosen:
                break
            centers_mm[i, j, :count] = places.centers_mm[chosen]
            for k, information in enumerate(judging):
                replicates = resolution(information[..., chosen, :].sum(-2))
                found[k, i, j], errors[k, i, j] = replicates[0], replicates[0] * jackknife(np.log(replicates))
    over = ("chosen_for", "photodiode_count")
    text = "force resolution of so many photodiodes through the body's noise"
    data = variable("count_resolution_n", over, found[0], text, units="N", stderr=errors[0])
    text = "force resolution of so many photodiodes by the noise of the electronics alone"
    data |= variable("count_electronics_resolution_n", over, found[1], text, units="N", stderr=errors[1])
    data |= variable("count_place_mm", (*over, "count_place", "axis"), centers_mm, "their places", units="mm")
    return xr.Dataset(data, {"chosen_for": list(CHOSEN_FOR), "photodiode_count": list(COUNTS)})


def _read(layout: CandidateLayout, cache: PhotonMapCache, rules: Placement) -> _Places:
    """What one photodiode reads wherever it may lie, by one half of the photons and, block by block, by the other."""
    photodiode = layout.scene.layout.photodiodes[0].photodiode
    size_mm = photodiode.size_mm
    centers_mm, half = free_places(layout.board, size_mm, rules), np.array(size_mm) / 2
    areas = np.stack([centers_mm - half, centers_mm + half], -1).reshape(-1, 4)
    halves: tuple[list[list[Response]], list[list[Response]]] = ([], [])
    for condition, by_led in zip(cache.conditions, cache.maps(layout.board), strict=True):
        for each in halves:
            each.append([])
        for number, (led, one) in enumerate(zip(layout.board.leds, by_led, strict=True)):
            blocks = one.over(areas)
            for each, values in zip(halves, (blocks[::2].mean(0), left_out(blocks[1::2])), strict=True):
                amplifier, point = layout.scene.electronics, condition.point
                told = response(values, led, photodiode, amplifier, point, number=number, replicates=each is halves[1])
                each[-1].append(told)
    return _Places(centers_mm, size_mm, *halves)


def _information(by_finger: list[list[Response]], *, electronics_alone: bool) -> np.ndarray:
    """What a photodiode at each place tells under all LEDs, (fingers, ..., m, n) float, as `fisher_information`."""
    return np.stack(
        [
            np.sum([fisher_information(read, electronics_alone=electronics_alone) for read in by_led], axis=0)
            for by_led in by_finger
        ]
    )

"""How far the best layout stays the best: with fewer and more photodiodes, and over the priors of the finger."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from ...light.board_map import Arrivals, BoardTracer, PhotonMap, blood_point, readings
from ...light.identity import light_digest, light_scene
from ...scene import FingerCase, Placement, Prior, Scene
from ...sensor.information import (
    OperatingPoint,
    Response,
    fisher_information,
    force_resolution_n,
    operating_point,
    over_fingers,
    responses,
    total_information,
)
from ...statistics import Z95, jackknife, left_out
from ...variables import variable
from ..prior_uncertainty import PriorSensitivity, at_value, nodes_of, only_absorbs, prior_variables
from . import boards
from .candidates import CandidateLayout
from .coordinate_exchange import coordinate_exchange
from .objective import Objective
from .photon_maps import PhotonMapCache, batch_seed
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
        information = _information(self.chosen_by, electronics_alone=electronics_alone)
        found, reached = coordinate_exchange(
            information[:, :free],
            self.places.centers_mm,
            count=more,
            spacing_mm=self.places.spacing_mm,
            score=objective.force_n,
            given=information[:, free:].sum(1),
        )
        return [*found, *range(free, information.shape[1])] if np.isfinite(reached) else None


def resolution_vs_count(
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
    own = (
        base
        if layout.origin == "searched"
        else boards.searchable_board(boards.with_explicit_walls(layout.scene, layout.name), rules)
    )
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


# The best layouts that are read again at every node of every prior, from so many blocks of photons.
TOP_RANKED = 3
BLOCKS = 16
# Batches of photons for each change that makes light go otherwise.
OWN_BATCHES = 2


def resolution_over_priors(
    layouts: Sequence[CandidateLayout],
    rules: Placement,
    judged: PhotonMapCache,
    *,
    stop: Callable[[], bool],
) -> xr.Dataset:
    """Uncertainty of the force resolution of the top-ranked layouts over the priors, and which is the best where.

    layouts : best first, of one scene's priors; the paper's counts as one of them, too.
    judged : has kept the light of every layout, by which all changes are read that only absorb.
    stop : whether there is no time for one layout, or one batch, more.

    Returns: Dataset over layout, prior and node; NaN of layouts that were not read, and empty where none was.
    """
    scene = layouts[0].board
    priors = scene.priors.of_finger()
    reweighted = [one for one in priors if only_absorbs(scene, one)]
    own = [one for one in priors if one not in reweighted]
    kept = (*reweighted, *(own if scene.priors.own_traces else []))
    changes: list[tuple[str, float] | None] = [None, *((one.field, value) for one in kept for value in nodes_of(one))]
    # The touch is that of the finger, whatever lies on its nail.
    points = [
        [operating_point(one, rules.force_n, since_rest_s=rules.since_rest_s) for one in _changed(scene, case, changes)]
        for case in judged.cases
    ]
    read: list[np.ndarray] = []
    chosen = [i for i, one in enumerate(layouts) if i < TOP_RANKED or one.name == "paper"]
    for i in chosen:
        one = _log_resolutions(layouts[i], rules, changes, points, judged, stop=stop)
        if one is None:
            break
        read.append(one)
    if not read:
        return xr.Dataset()
    chosen = chosen[: len(read)]
    # By change, all blocks and without each, and layout.
    found = np.stack(read, -1)
    every = np.full((*found.shape[:-1], len(layouts)), np.nan)
    every[..., chosen] = found
    over = PriorSensitivity(kept, every[1:].reshape(len(kept), 3, *every.shape[1:]), every[0])
    return _dataset(over, chosen, () if scene.priors.own_traces else tuple(own), scene)


def _log_resolutions(
    layout: CandidateLayout,
    rules: Placement,
    changes: Sequence[tuple[str, float] | None],
    points: Sequence[Sequence[OperatingPoint]],
    judged: PhotonMapCache,
    *,
    stop: Callable[[], bool],
) -> np.ndarray | None:
    """Logarithm of a layout's score with each change of its fingers, (changes, 1 + blocks) float; None if stopped.

    points : by case and change.
    """
    score = np.zeros((len(judged.cases), len(changes), 1 + BLOCKS))
    # Scenes whose light goes the same way share a trace, whatever finger or change they are.
    sharing: dict[str, list[tuple[int, int, Scene]]] = {}
    for number, case in enumerate(judged.cases):
        for k, one in enumerate(_changed(layout.board, case, changes)):
            sharing.setdefault(light_digest(one), []).append((number, k, one))
    most = OWN_BATCHES if layout.board.priors.own_traces else None
    for members in sharing.values():
        number, _, scene = members[0]
        light = [_light(layout, scene, judged, judged.cases[number], i, most, stop) for i in range(len(scene.leds))]
        if stop() or any(one is None for one in light):
            return None
        shared = [(one, points[number][k]) for number, k, one in members]
        found = _resolutions(layout, [one for one in light if one is not None], shared, light_scene(scene))
        for (number, k, _), each in zip(members, found, strict=True):
            score[number, k] = each
    return np.log(over_fingers(score, rules.over_fingers))


def _light(
    layout: CandidateLayout,
    scene: Scene,
    judged: PhotonMapCache,
    case: FingerCase,
    led: int,
    most: int | None,
    stop: Callable[[], bool],
) -> Arrivals | None:
    """Light of an LED on a layout's photodiodes: what judged it, or where it goes otherwise, light of its own by the
    same random numbers; None if stopped.

    most : batches.
    """
    own, usual = light_scene(scene), light_scene(boards.worn_on(layout.board, case, light_only=True))
    batches = judged.kept(layout.board, case.digit, led)[:most]
    if own != usual:
        how: dict[str, Any] = {"backend": judged.backend, "store": judged.store, "seed": judged.seed}
        tracer = BoardTracer(own, spacing_mm=judged.distance_mm, **how)
        for i, batch in enumerate(batches):
            if stop():
                return None
            seed = batch_seed(judged.seed, judged.stream, usual, led, i)
            batches[i] = tracer.arrivals(led, photons=batch.photons, seed=seed)
    return Arrivals.joined(batches)


def _changed(board: Scene, case: FingerCase, changes: Sequence[tuple[str, float] | None]) -> list[Scene]:
    """A board on one of the fingers with each change."""
    base = boards.worn_on(board, case)
    return [base if change is None else at_value(base, *change) for change in changes]


def _resolutions(
    layout: CandidateLayout,
    light: Sequence[Arrivals],
    shared: Sequence[tuple[Scene, OperatingPoint]],
    traced: Scene,
) -> np.ndarray:
    """Force resolution on fingers that share their light, by all blocks and without each, (fingers, 1 + blocks). [N]

    light : of each LED.
    """
    areas = layout.scene.layout.photodiode_areas
    photodiodes = [one.photodiode for one in layout.scene.layout.photodiodes]
    # By LED: all photons and without each block, photodiode, finger, value.
    read: list[np.ndarray] = []
    for i, arrivals in enumerate(light):
        blood = [blood_point(one, i, traced=traced, blood_fraction=point.blood_fraction) for one, point in shared]
        blocks = []
        for block in range(BLOCKS):
            part = arrivals.thin(BLOCKS, block)
            each = readings(part, np.concatenate([one.values(part) for one in blood], axis=1), areas)[0]
            blocks.append(each.reshape(len(areas), len(shared), -1))
        read.append(left_out(np.stack(blocks)))
    out = []
    for k, (_, point) in enumerate(shared):
        by_led = [
            responses(values[:, :, k], led, photodiodes, layout.scene.electronics, point, number=i, replicates=True)
            for i, (values, led) in enumerate(zip(read, layout.scene.leds, strict=True))
        ]
        out.append(force_resolution_n(total_information(by_led), point))
    return np.stack(out)


def _dataset(over: PriorSensitivity, chosen: Sequence[int], untraced: Sequence[Prior], scene: Scene) -> xr.Dataset:
    """What was found of all layouts, NaN of those that were not read; `chosen` were."""
    text = "the logarithm of the force resolution"
    data = over.variables("resolution", ("layout",), text, len(untraced))
    nodes = np.exp(np.concatenate([over.nodes[:, :, 0], np.full((len(untraced), 3, over.own.shape[-1]), np.nan)]))
    text = "force resolution with one prior at one of its nodes"
    data |= variable("resolution_at_node_n", ("prior", "prior_node", "layout"), nodes, text, units="N")
    # How much coarser than the first each other layout is, at every node.
    read = over.nodes[..., chosen]
    apart = (read - read[..., :1]).reshape(-1, *read.shape[2:])
    behind, noise = apart[:, 0], jackknife(np.moveaxis(apart, 1, 0))
    ahead, surely = (behind >= 0).all(-1), (behind + Z95 * noise < 0).any(-1)
    data |= variable("best_stays_best_at", (), int(ahead.sum()), "nodes at which the best layout is the best")
    data |= variable("best_surely_beaten_at", (), int(surely.sum()), "nodes at which another one is surely better")
    data |= variable("nodes", (), len(apart), "nodes at which the top-ranked layouts were compared")
    return xr.Dataset(data).merge(prior_variables(over.priors, untraced, scene))

"""Whether the best layout is the best whatever the finger: force resolution of the foremost over what is unknown."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import xarray as xr

from ...light.board_map import Arrivals, BoardTracer, blood_point, readings
from ...light.identity import light_digest, light_scene
from ...scene import FingerCase, Placement, Prior, Scene
from ...sensor.information import (
    OperatingPoint,
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
from .boards import CandidateLayout
from .photon_maps import PhotonMapCache, batch_seed

# The best layouts that are read again at every node of every prior, from so many blocks of photons.
FOREMOST = 3
BLOCKS = 16
# Batches of photons for each change that makes light go otherwise.
OWN_BATCHES = 2


def resolution_over_unknowns(
    layouts: Sequence[CandidateLayout],
    rules: Placement,
    judged: PhotonMapCache,
    *,
    stop: Callable[[], bool],
) -> xr.Dataset:
    """Spread of the force resolution of the foremost layouts over the scene's priors, and which of them is best where.

    layouts : best first, of one scene's priors; the paper's counts as foremost, too.
    judged : has kept the light of every layout, by which all changes are read that only absorb.
    stop : whether there is no time for one layout, or one batch, more.

    Returns: Dataset over layout, prior and node; NaN of layouts that were not read, and empty where none was.
    """
    scene = layouts[0].board
    priors = scene.priors.of_finger()
    told = [one for one in priors if only_absorbs(scene, one)]
    own = [one for one in priors if one not in told]
    kept = (*told, *(own if scene.priors.own_traces else []))
    changes: list[tuple[str, float] | None] = [None, *((one.field, value) for one in kept for value in nodes_of(one))]
    # The touch is that of the finger, whatever lies on its nail.
    points = [
        [operating_point(one, rules.force_n, since_rest_s=rules.since_rest_s) for one in _changed(scene, case, changes)]
        for case in judged.cases
    ]
    read: list[np.ndarray] = []
    chosen = [i for i, one in enumerate(layouts) if i < FOREMOST or one.name == "paper"]
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
    own, usual = light_scene(scene), light_scene(boards.on_finger(layout.board, case, light_only=True))
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
    base = boards.on_finger(board, case)
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
    data |= variable("nodes", (), len(apart), "nodes at which the foremost layouts were compared")
    return xr.Dataset(data).merge(prior_variables(over.priors, untraced, scene))

"""How far the best layout stays the best over the priors of the finger."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import xarray as xr

from ...light.board_map import Arrivals, blood_point, readings
from ...light.identity import light_digest, light_scene
from ...scene import FingerCase, Placement, Prior, Scene
from ...sensor.information import (
    OperatingPoint,
    force_resolution_n,
    operating_point,
    over_fingers,
    scene_responses,
    total_information,
)
from ...statistics import Z95, jackknife, left_out
from ...variables import described
from ..prior_uncertainty import PriorSensitivity, only_absorbs, over_priors, prior_variables
from . import boards
from .candidates import CandidateLayout
from .photon_maps import PhotonMapCache, Stopped, batch_seed

# The best layouts that are read again at every node of every prior, from so many blocks of photons.
TOP_RANKED = 3
BLOCKS = 16
# Batches of photons for each change that makes light go otherwise.
OWN_BATCHES = 2


def resolution_over_priors(
    layouts: Sequence[CandidateLayout], rules: Placement, cache: PhotonMapCache, *, stop: Callable[[], bool]
) -> xr.Dataset:
    """Uncertainty of the force resolution of the top-ranked layouts over the priors, and which is the best where.

    layouts : best first, of one scene's priors; the paper's counts as one of them, too.
    cache : has recorded the light of every layout, by which all changes are read that only absorb.
    stop : whether there is no time for one layout, or one batch, more.

    Returns: Dataset over layout, prior and node; NaN of layouts that were not read, and empty where none was.
    """
    scene = layouts[0].board
    known = (*scene.finger_priors, *scene.priors.of_body(scene.body))
    priors = sorted(known, key=lambda prior: not only_absorbs(scene, prior))
    untraced = [prior for prior in priors if not (only_absorbs(scene, prior) or scene.priors.own_traces)]
    evaluated = priors[: len(priors) - len(untraced)]
    chosen = [i for i, layout in enumerate(layouts) if i < TOP_RANKED or layout.name == "paper"]
    results: list[tuple[np.ndarray, np.ndarray]] = []
    resolution = _Resolution(rules, cache, stop)
    try:
        for i in chosen:
            if stop():
                break
            results.append(resolution.over_priors(layouts[i], evaluated))
    except Stopped:
        pass
    if not results:
        return xr.Dataset()
    chosen = chosen[: len(results)]
    nodes, base = (np.full((*array.shape, len(layouts)), np.nan) for array in results[0])
    nodes[..., chosen], base[..., chosen] = (np.stack(arrays, -1) for arrays in zip(*results, strict=True))
    return _dataset(
        PriorSensitivity(tuple(evaluated), nodes, base, scene.priors.correlation(evaluated)), chosen, untraced, scene
    )


@dataclass
class _Resolution:
    """Force resolution of layouts on other fingers, by all blocks of photons and without each.

    points : the touch on each finger, which no layout changes.
    light : scenes whose light goes the same way share a trace, whatever finger or change they are.
    """

    rules: Placement
    cache: PhotonMapCache
    stop: Callable[[], bool]
    points: dict[Any, OperatingPoint] = field(default_factory=dict)
    light: dict[tuple[str, int], Arrivals] = field(default_factory=dict)

    def over_priors(self, layout: CandidateLayout, priors: Sequence[Prior]) -> tuple[np.ndarray, np.ndarray]:
        """Logarithm of the score at the nodes of every prior, (priors, 3, 1 + blocks) float, and of the scene's own,
        (1 + blocks,) float."""
        self.light.clear()
        by_case = [
            over_priors(boards.worn_on(layout.board, case), priors, partial(self._resolution_n, layout, case))
            for case in self.cache.cases
        ]
        over = self.rules.over_fingers
        nodes, base = (np.stack([getattr(case, name) for case in by_case]) for name in ("nodes", "base"))
        return np.log(over_fingers(nodes, over)), np.log(over_fingers(base, over))

    def _resolution_n(self, layout: CandidateLayout, case: FingerCase, scene: Scene) -> np.ndarray:
        """Force resolution on one finger, (1 + blocks,) float. [N]"""
        finger = scene.finger, scene.blood, scene.body, scene.touch
        if finger not in self.points:
            touch = operating_point(scene, self.rules.force_n, since_rest_s=self.rules.since_rest_s)
            self.points[finger] = touch
        point, areas, by_led = self.points[finger], layout.scene.layout.photodiode_areas, []
        for i in range(len(scene.leds)):
            blood = blood_point(scene, i, traced=light_scene(scene), blood_fraction=point.blood_fraction)
            blocks = [self._arrivals(layout, scene, case, i).thin(BLOCKS, k) for k in range(BLOCKS)]
            by_led.append(left_out(np.stack([readings(block, blood.values(block), areas)[0] for block in blocks])))
        read = scene_responses(layout.scene, by_led, point, replicates=True)
        return force_resolution_n(total_information(read), point)

    def _arrivals(self, layout: CandidateLayout, scene: Scene, case: FingerCase, led: int) -> Arrivals:
        """Light of an LED on the layout's photodiodes: that of the evaluation, or, where its paths differ, newly
        traced with the same random numbers."""
        key, cache = (light_digest(scene), led), self.cache
        if key not in self.light:
            most = OWN_BATCHES if layout.board.priors.own_traces else None
            batches = cache.of(layout.board).arrivals.get((case.digit, led), [])[:most]
            shaped, usual = light_scene(scene), light_scene(boards.worn_on(layout.board, case, light_only=True))
            if shaped != usual:
                tracer = cache.tracer(shaped)
                for i, batch in enumerate(batches):
                    if self.stop():
                        raise Stopped
                    seed = batch_seed(cache.seed, cache.stream, usual, led, i)
                    batches[i] = tracer.arrivals(led, photons=batch.photons, seed=seed)
            self.light[key] = Arrivals.joined(batches)
        return self.light[key]


def _dataset(over: PriorSensitivity, chosen: Sequence[int], untraced: Sequence[Prior], scene: Scene) -> xr.Dataset:
    """Of all layouts, NaN of those that were not read; `chosen` were."""
    text = "the logarithm of the force resolution"
    data = over.variables("resolution", ("layout",), text, len(untraced))
    nodes = np.exp(np.concatenate([over.nodes[:, :, 0], np.full((len(untraced), 3, over.base.shape[-1]), np.nan)]))
    # How much coarser than the first each other layout is, at every node.
    read = over.nodes[..., chosen]
    change = (read - read[..., :1]).reshape(-1, *read.shape[2:])
    behind, noise = change[:, 0], jackknife(np.moveaxis(change, 1, 0))
    ahead, surely = (behind >= 0).all(-1), (behind + Z95 * noise < 0).any(-1)
    data |= described(
        __package__,
        resolution_at_node_n=nodes,
        best_stays_best_at=int(ahead.sum()),
        best_surely_beaten_at=int(surely.sum()),
        nodes=len(change),
    )
    return xr.Dataset(data).merge(prior_variables(over.priors, untraced, scene))

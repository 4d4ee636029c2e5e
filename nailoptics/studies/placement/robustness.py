"""How far the best layout stays the best over the priors of the finger, and what people make of it."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import xarray as xr

from ...light.board_map import Arrivals
from ...light.identity import light_digest, light_scene
from ...scene import FingerCase, Placement, Prior, Scene
from ...scene.priors import size_priors
from ...sensor import information as sensor_information
from ...statistics import Z95, jackknife, left_out
from ...variables import described, jackknifed
from .. import prior_uncertainty
from ..prior_uncertainty import PriorSensitivity, at_value, known_priors, nodes_of, only_absorbs, over_priors, value_of
from . import boards
from .candidates import CandidateLayout
from .objective import LayoutScore
from .photon_maps import PERSON_DISTANCE_MM, PhotonMapCache, Stopped, batch_seed, recorded

# The best layouts that are read again at every node of every prior, from so many blocks of photons.
TOP_RANKED = 3
BLOCKS = 16
# Batches of photons for each change that makes light go otherwise.
OWN_BATCHES = 2


def resolution_over_priors(layouts: Sequence[CandidateLayout], rules: Placement, cache: PhotonMapCache) -> xr.Dataset:
    """Uncertainty of the force resolution of the top-ranked layouts over the priors, and which is the best where.

    layouts : best first, of one scene's priors; the paper's counts as one of them, too.
    cache : has recorded the light of every layout, by which all changes are read that only absorb.

    Returns: Dataset over layout, prior and node; NaN of layouts that were not read before the cache was to stop, and
        empty where none was.
    """
    scene = layouts[0].board
    priors = sorted(known_priors(scene), key=lambda prior: not only_absorbs(scene, prior))
    untraced = [prior for prior in priors if not (only_absorbs(scene, prior) or scene.priors.own_traces)]
    evaluated = priors[: len(priors) - len(untraced)]
    chosen = [i for i, layout in enumerate(layouts) if i < TOP_RANKED or layout.name == "paper"]
    results: list[tuple[np.ndarray, np.ndarray]] = []
    resolution = _Resolution(rules, cache)
    try:
        for i in chosen:
            cache.check_time()
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


def over_people(layouts: Sequence[CandidateLayout], scores: Sequence[LayoutScore], cache: PhotonMapCache) -> xr.Dataset:
    """What people make of evaluated layouts: the median, whom each does not fit, who is worst and by what of theirs.

    The reason is the property whose usual value, the prior's middle, would help that person most, one at a time; it is
    sought for the best layout and those that the search did not make, as long as there is time.
    """
    people = cache.people
    by_person = np.stack([score.force.fingers_n[:, -len(people) :].T for score in scores], -1)
    off = [[not boards.fits(boards.worn_on(one.scene, person)) for person in people] for one in layouts]
    worst = np.where(np.transpose(off), -np.inf, by_person[:, 0]).argmax(0)
    resolution = _Resolution(scores[0].force.objective.rules, cache)
    explained = [i for i, layout in enumerate(layouts) if i == 0 or layout.origin != "searched"]
    reasons = {i: _reason(resolution, layouts[i], people[worst[i]]) for i in explained}
    data = described(
        __package__,
        median_resolution_n=jackknifed(sensor_information.over_fingers(by_person, "", len(people), 0.5)),
        worst_resolution_n=by_person[worst, 0, np.arange(len(layouts))],
        worst_person=[people[k].name for k in worst],
        worst_reason=[reasons.get(i, "") for i in range(len(layouts))],
        people_off=np.sum(off, axis=1),
    )
    return xr.Dataset(data)


def _reason(resolution: "_Resolution", layout: CandidateLayout, person: boards.Person) -> str:
    """By which property of a person a layout's resolution is coarsest, in words; empty where there was no time."""
    worn, usual = boards.worn_on(layout.board, person), boards.worn_on(layout.board, person.first)
    middle = {prior: nodes_of(prior)[1] for prior in known_priors(usual)}
    changed = {prior.name: at_value(worn, prior.field, value) for prior, value in middle.items()}
    sizes = [prior.field.removeprefix("finger.") for prior in size_priors(usual.fingertip)]
    update = {name: getattr(usual.fingertip, name) for name in (*sizes, "length_mm")}
    changed["size of the finger"] = worn.model_copy(update={"finger": worn.fingertip.model_copy(update=update)})
    resolution.light.clear()
    try:
        own_mn, *others_mn = [1e3 * resolution.of(layout, person, one)[0] for one in (worn, *changed.values())]
    except Stopped:
        return ""
    least_mn, name = min(zip(others_mn, changed, strict=True))
    words = [f" of {value_of(worn, p.field):.2g} (usually {x:.2g})" for p, x in middle.items() if p.name == name]
    return f"{name}{''.join(words)}, without which {least_mn:.3g} instead of {own_mn:.3g} mN"


@dataclass
class _Resolution:
    """Force resolution of layouts on other fingers, by all blocks of photons and without each.

    points : the touch on each finger, which no layout changes.
    light : scenes whose light goes the same way share a trace, whatever finger or change they are.
    """

    rules: Placement
    cache: PhotonMapCache
    points: dict[Any, sensor_information.OperatingPoint] = field(default_factory=dict)
    light: dict[tuple[str, int], list[Arrivals]] = field(default_factory=dict)

    def over_priors(self, layout: CandidateLayout, priors: Sequence[Prior]) -> tuple[np.ndarray, np.ndarray]:
        """Logarithm of the score at the nodes of every prior, (priors, 3, 1 + blocks) float, and of the scene's own,
        (1 + blocks,) float."""
        self.light.clear()
        by_case = [
            over_priors(boards.worn_on(layout.board, case), priors, partial(self.of, layout, case))
            for case in self.cache.cases
        ]
        over = self.rules.over_fingers
        nodes, base = (np.stack([getattr(case, name) for case in by_case]) for name in ("nodes", "base"))
        return np.log(sensor_information.over_fingers(nodes, over)), np.log(sensor_information.over_fingers(base, over))

    def of(self, layout: CandidateLayout, case: FingerCase | boards.Person, scene: Scene) -> np.ndarray:
        """Force resolution on one finger changed to a scene, (1 + blocks,) float. [N]"""
        finger = scene.finger, scene.blood, scene.body, scene.touch
        if finger not in self.points:
            touch = sensor_information.operating_point(scene, self.rules.force_n, since_rest_s=self.rules.since_rest_s)
            self.points[finger] = touch
        point, areas, leds = self.points[finger], layout.scene.layout.photodiode_areas, range(len(scene.leds))
        batches = (self._arrivals(layout, scene, case, led) for led in leds)
        by_led = (recorded(light, scene, led, point, areas, BLOCKS) for led, light in enumerate(batches))
        read = sensor_information.scene_responses(layout.scene, map(left_out, by_led), point, replicates=True)
        return sensor_information.force_resolution_n(sensor_information.total_information(read), point)

    def _arrivals(
        self, layout: CandidateLayout, scene: Scene, case: FingerCase | boards.Person, led: int
    ) -> list[Arrivals]:
        """Light of an LED on the layout's photodiodes: that of the evaluation, or, where its paths differ, newly
        traced with the same random numbers."""
        key, cache = (light_digest(scene), led), self.cache
        if key not in self.light:
            most = OWN_BATCHES if layout.board.priors.own_traces else None
            batches = cache.of(layout.board).arrivals.get((case.digit, led), [])[:most]
            shaped, usual = light_scene(scene), light_scene(boards.worn_on(layout.board, case, light_only=True))
            if shaped != usual:
                tracer = cache.tracer(shaped, spacing_mm=PERSON_DISTANCE_MM if case in cache.people else None)
                for i, batch in enumerate(batches):
                    cache.check_time()
                    seed = batch_seed(cache.seed, cache.stream, usual, led, i)
                    batches[i] = tracer.arrivals(led, photons=batch.photons, seed=seed)
            self.light[key] = batches
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
    return xr.Dataset(data).merge(prior_uncertainty.prior_variables(over.priors, untraced, scene))

"""How far the best layout stays the best over the priors of the finger, what people make of it, and how much worse it
becomes by tolerances of gluing, of each part's place and of the LEDs' power."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np
import xarray as xr

from ...errors import InputError
from ...light.board_map import Arrivals
from ...light.identity import light_digest, light_scene
from ...scene import FingerCase, Placement, Prior, Scene
from ...scene.priors import size_priors
from ...scene.rectangles import turned
from ...sensor import information as sensor_information
from ...statistics import Z95, jackknife, leave_one_out
from ...variables import described, jackknifed
from .. import prior_uncertainty as uncertainty
from . import boards, candidates
from .boards import PartT
from .candidates import CandidateLayout
from .objective import LayoutScore, Objective, scores_of
from .photon_maps import PhotonMapCache, Stopped, batch_seed, recorded

# The best layouts that are read again at every node of every prior.
TOP_RANKED = 3
# Batches of photons for each change that makes light go otherwise.
OWN_BATCHES = 2
# Blocks of photons by which the best are read again.
BLOCKS = 16
STEP_MM, TURN_DEG = 0.5, 5.0
# A bin of an infrared LED's power is a factor of 1.6 wide, as data sheets sort them: this much about its middle.
POWER = 0.25
# Groups of photons for the error of a change, and photons of each LED where light goes otherwise.
GROUPS, MOST_PHOTONS = 4, 1 << 17
MOVED = {"left": (-STEP_MM, 0), "right": (STEP_MM, 0), "proximal": (0, -STEP_MM), "distal": (0, STEP_MM)}
TURNED = {"clockwise": -TURN_DEG, "counterclockwise": TURN_DEG}
POWERED = {"dimmer": 1 - POWER, "brighter": 1 + POWER}
KINDS = (*MOVED, *TURNED, *POWERED)


def resolution_over_priors(layouts: Sequence[CandidateLayout], rules: Placement, cache: PhotonMapCache) -> xr.Dataset:
    """Uncertainty of the force resolution of the top-ranked layouts over the priors, and which is the best where.

    layouts : best first, of one scene's priors; the paper's counts as one of them, too.
    cache : has recorded the light of every layout, by which all changes are read that only absorb.

    Returns: Dataset over layout, prior and node; NaN of layouts that were not read before the cache was to stop, and
        empty where none was.
    """
    scene = layouts[0].board
    priors = sorted(uncertainty.known_priors(scene), key=lambda prior: not uncertainty.only_absorbs(scene, prior))
    untraced = [prior for prior in priors if not (uncertainty.only_absorbs(scene, prior) or scene.priors.own_traces)]
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
    correlation = scene.priors.correlation(evaluated)
    over = uncertainty.PriorSensitivity(tuple(evaluated), nodes, base, correlation)
    return _dataset(over, chosen, untraced, scene)


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


def _reason(resolution: "_Resolution", layout: CandidateLayout, person: boards.PersonCase) -> str:
    """By which property of a person a layout's resolution is coarsest, in words; empty where there was no time."""
    worn, usual = boards.worn_on(layout.board, person), boards.worn_on(layout.board, person.first)
    middle = {prior: uncertainty.nodes_of(prior)[1] for prior in uncertainty.known_priors(usual)}
    changed = {prior.name: uncertainty.at_value(worn, prior.field, value) for prior, value in middle.items()}
    sizes = [prior.field.removeprefix("finger.") for prior in size_priors(usual.fingertip)]
    update = {name: getattr(usual.fingertip, name) for name in (*sizes, "length_mm")}
    changed["size of the finger"] = worn.model_copy(update={"finger": worn.fingertip.model_copy(update=update)})
    resolution.light.clear()
    try:
        own_mn, *others_mn = [1e3 * resolution.on_finger(layout, person, one)[0] for one in (worn, *changed.values())]
    except Stopped:
        return ""
    least_mn, name = min(zip(others_mn, changed, strict=True))
    words = [
        f" of {uncertainty.value_of(worn, p.field):.2g} (usually {x:.2g})" for p, x in middle.items() if p.name == name
    ]
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
            uncertainty.over_priors(boards.worn_on(layout.board, case), priors, partial(self.on_finger, layout, case))
            for case in self.cache.cases
        ]
        over = self.rules.over_fingers
        nodes, base = (np.stack([getattr(case, name) for case in by_case]) for name in ("nodes", "base"))
        return np.log(sensor_information.over_fingers(nodes, over)), np.log(sensor_information.over_fingers(base, over))

    def on_finger(self, layout: CandidateLayout, case: FingerCase | boards.PersonCase, scene: Scene) -> np.ndarray:
        """Force resolution on one finger changed to a scene, (1 + blocks,) float. [N]"""
        finger = scene.finger, scene.blood, scene.body, scene.touch
        if finger not in self.points:
            touch = sensor_information.operating_point(scene, self.rules.force_n, since_rest_s=self.rules.since_rest_s)
            self.points[finger] = touch
        point, areas, leds = self.points[finger], layout.scene.layout.photodiode_areas, range(len(scene.leds))
        batches = (self._arrivals(layout, scene, case, led) for led in leds)
        by_led = (recorded(light, scene, led, point, areas, BLOCKS) for led, light in enumerate(batches))
        read = sensor_information.scene_responses(layout.scene, map(leave_one_out, by_led), point, replicates=True)
        return sensor_information.force_resolution_n(sensor_information.total_information(read), point)

    def _arrivals(
        self, layout: CandidateLayout, scene: Scene, case: FingerCase | boards.PersonCase, led: int
    ) -> list[Arrivals]:
        """Light of an LED on the layout's photodiodes: that of the evaluation, or, where its paths differ, newly
        traced with the same random numbers."""
        key, cache = (light_digest(scene), led), self.cache
        if key not in self.light:
            most = OWN_BATCHES if layout.board.priors.own_traces else None
            batches = cache.traced_board(layout.board).arrivals.get((case.digit, led), [])[:most]
            shaped, usual = light_scene(scene), light_scene(boards.worn_on(layout.board, case, light_only=True))
            if shaped != usual:
                tracer = cache.tracer(shaped)
                for i, batch in enumerate(batches):
                    cache.check_time()
                    seed = batch_seed(cache.seed, cache.stream, usual, led, i)
                    batches[i] = tracer.arrivals(led, photons=batch.photons, seed=seed)
            self.light[key] = batches
        return self.light[key]


def _dataset(
    over: uncertainty.PriorSensitivity, chosen: Sequence[int], untraced: Sequence[Prior], scene: Scene
) -> xr.Dataset:
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
    return xr.Dataset(data).merge(uncertainty.prior_variables(over.priors, untraced, scene))


def tolerances(layout: CandidateLayout, cache: PhotonMapCache, objective: Objective) -> xr.Dataset:
    """How what layouts are ranked by changes on the fingers with each tolerance of a layout with resistors of its own.

    cache : has evaluated the layout. Another place of the board, its wall and edges straight where it is turned, or of
        an LED is traced; all else is read by the same light.

    Returns: Dataset over toleranced_part (board, photodiodes, LEDs) and deviation, NaN of what is not a tolerance of a
        part, has no room, or was not traced, and which of the two.
    """
    objective = replace(objective, filter_groups=GROUPS)
    scene, count = layout.scene, len(objective.points)
    fingers = cache.conditions[:count]
    photons = min(MOST_PHOTONS, cache.most_photons or MOST_PHOTONS)
    elsewhere = replace(cache, conditions=fingers)
    room = boards.room_mm(*(boards.worn_on(scene, condition.case) for condition in fingers))
    leds, photodiodes = ([part.name for part in parts] for parts in (scene.leds, scene.photodiodes))
    parts = ["board", *photodiodes, *leds]
    read = dict[tuple[int, int], Any]()
    missing = np.full((len(parts), len(KINDS)), "", "<U7")
    for part, kind, vary in _varied(scene):
        at = parts.index(part), KINDS.index(kind)
        try:
            if part == "board" or (kind in MOVED and part in leds):
                moved, light = candidates.candidate(layout.name, boards.cut_to(vary(), room), ""), elsewhere
                light.extend(moved.board, photons)
            else:
                moved, light = replace(layout, scene=vary()), cache
                candidates.check(moved.scene, layout.name)
            if light.traced_board(moved.board).photons:
                read[at] = light.read(moved.scene, moved.board, count)
            else:
                missing[at] = "no time"
        except InputError:
            missing[at] = "no room"
    cache.photons += elsewhere.photons
    best, *others = scores_of([cache.read(scene, layout.board, count), *read.values()], objective)
    table = np.full((len(best.ranked), *missing.shape), np.nan)
    for at, other in zip(read, others, strict=True):
        table[:, *at] = other.ranked / best.ranked - 1
    data = described(__package__, tolerance_ranking=jackknifed(table), tolerance_missing=missing)
    return xr.Dataset(data, coords={"toleranced_part": parts, "deviation": list(KINDS)})


def _varied(scene: Scene) -> Iterator[tuple[str, str, Callable[[], Scene]]]:
    """Each part, a deviation of it, and what makes the scene with that, which may be impossible."""
    for kind, (du, dv) in MOVED.items():
        yield "board", kind, partial(_glued, scene, du_mm=du, dv_mm=dv)
        for i, (u, v) in enumerate(photodiode.position_mm for photodiode in scene.photodiodes):
            moved: dict[str, Any] = {f"photodiodes[{i}].position_mm": (u + du, v + dv)}
            yield scene.photodiodes[i].name, kind, partial(scene.with_, **moved)
        for i, (led, die) in enumerate(zip(scene.leds, scene.layout.leds, strict=True)):
            moved = {f"leds[{i}].position_mm": tuple(np.add(led.position_mm, (du, dv)).tolist())}
            # The wall stays where it is.
            there = replace(die, u_min=die.u_min + du, u_max=die.u_max + du, v_min=die.v_min + dv, v_max=die.v_max + dv)
            dies = (*scene.layout.leds[:i], there, *scene.layout.leds[i + 1 :])
            if scene.layout.barriers:
                moved["board.barrier_gap_mm"] = replace(scene.layout, leds=dies).barrier_gap_mm
            yield led.name, kind, partial(scene.with_, **moved)
    for kind, angle_deg in TURNED.items():
        yield "board", kind, partial(_glued, scene, angle_deg=angle_deg)
    for led, (kind, factor) in product(scene.leds, POWERED.items()):
        yield led.name, kind, partial(scene.with_led, led.name, flux_mw=factor * led.flux_mw)


def _glued(scene: Scene, *, du_mm: float = 0.0, dv_mm: float = 0.0, angle_deg: float = 0.0) -> Scene:
    """The board glued aside, or turned about its middle."""
    turn, (u, v) = partial(turned, angle_deg=angle_deg), scene.board.center_mm
    # Edges lie straight: those of a turned board are its box; a drawn border turns with it.
    corners = product(*zip((0.0, 0.0), scene.layout.outline.size_mm, strict=True))
    size_mm = tuple(np.ptp([*map(turn, corners)], axis=0).tolist())
    border, *holes = (tuple(map(turn, line)) for line in (scene.board.outline_mm or (), *scene.board.outline_holes_mm))
    update: dict[str, Any] = {"center_mm": (u + du_mm, v + dv_mm), "size_mm": size_mm}
    update |= {"outline_mm": border or None, "outline_holes_mm": tuple(holes)}

    def glued(part: PartT) -> PartT:
        at_deg = (part.rotation_deg + angle_deg) % 360
        return part.model_copy(update={"position_mm": turn(part.position_mm), "rotation_deg": at_deg})

    parts = {kind: tuple(map(glued, getattr(scene, kind))) for kind in ("leds", "photodiodes")}
    return scene.model_copy(update={"board": scene.board.model_copy(update=update)} | parts)

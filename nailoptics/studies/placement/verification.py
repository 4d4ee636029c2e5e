"""The best layout at close range: a fresh trace of its own board, ambient light, how far it stays the best over the
priors of the finger, what people make of it, how much worse it becomes by tolerances of gluing, of each part's place
and of the LEDs' power, and what fewer or more photodiodes and another power cost.

A lower bound of what any layout on the search's grid reaches: the relaxed design, in which places have weights.

Information adds up over photodiodes, M(w) = M_0 + sum_k w_k M_k, where a layout has weights 0 and 1. Each figure that
layouts are ranked by is, on a finger, a standard error s = (c^T M^-1 c)^1/2 of one combination of the unknowns with the
body's as nuisance. s^-2 is concave in M (Pukelsheim), so that log s, the logarithm of the worst or the mean of several
and their weighted sum are convex in w: a tangent at any design lies below all of them. The least of a tangent over all
weights from 0 to 1 that sum to the number of photodiodes, of which places too near each other share 1, is a linear
programme, and its value bounds every layout. Designs are mixtures of what these programmes return (Frank-Wolfe); the
multiplicative algorithm (Yu) finds each mixture, and the gap between its figure and the best tangent ends the search.

It holds for the given fingers, the resistor that fits each place, and LEDs where they were tried; a quantile over
people is not convex and the error over touches is none of one sample.

References: Boyd, Vandenberghe 2004, Convex Optimization, sec. 7.5; Joshi, Boyd 2009, IEEE Trans. Signal Process. 57,
451 (sensor selection); Pukelsheim 2006, Optimal Design of Experiments, ch. 3; Yu 2010, Ann. Stat. 38, 1593.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np
import xarray as xr
from scipy.optimize import linprog
from scipy.sparse import csr_array, hstack, vstack

from ...errors import InputError
from ...light import ProgressCallback
from ...light import backend as backends
from ...light.board_map import Arrivals, blood_point
from ...light.identity import light_digest, light_scene
from ...light.reference.readings import check_readable, read_leds
from ...light.tracing import StageProgress
from ...options import TraceOptions
from ...scene import FingerCase, Placement, Prior, Scene, digest
from ...scene.priors import size_priors
from ...scene.rectangles import turned
from ...sensor import information as sensor_information
from ...sensor.ambient import PHOTONS, sources_of, trace_ambient
from ...sensor.information import OperatingPoint, force_resolution_n, scene_responses, total_information
from ...statistics import Z95, Array, jackknife, left_out, seed_of
from ...variables import Estimate, Variables, described, jackknifed, variable
from .. import prior_uncertainty as uncertainty
from . import boards
from .boards import CandidateLayout, PartT
from .objective import ALIKE, WAVES_LEFT, LayoutScore, Objective, resolution_stderr_n, score_layout
from .photon_maps import PERSON_DISTANCE_MM, FingerCondition, PhotonMapCache, Stopped, batch_seed, recorded
from .search import LAST_STARTS, SEARCH_PHOTONS, SEARCH_SHARE, RowDesign, Search, SearchedSite, coordinate_exchange
from .sites import PhotodiodePlaces

LEAST_BATCHES = 8
# The fresh trace has this part of a full batch's photons in each of its batches at least.
LEAST_PART = 1 / 8
# A batch takes up to so long on two cores. [s]
SHORT_S = 10.0
# So much light comes through a board without a cover that few photons suffice, with an error that goes with the others.
OPEN_PHOTONS = 1 << 13
# Paths of stock Mitsuba for the photodiodes that share them. Their number is fixed: its batches are skewed, and to stop
# where they look settled favours low readings.
MITSUBA_PATHS = 1 << 20
COVERS = ("covered", "uncovered")
# Stream of random numbers.
FORWARD = 2
# The best layouts that are read again at every node of every prior.
TOP_RANKED = 3
# Batches of photons for each change that makes light go otherwise.
OWN_BATCHES = 2
STEP_MM, TURN_DEG = 0.5, 5.0
# A bin of an infrared LED's power is a factor of 1.6 wide, as data sheets sort them: this much about its middle.
POWER = 0.25
# Groups of photons for the error of a change, and photons of each LED where light goes otherwise.
GROUPS, MOST_PHOTONS = 4, 1 << 17
MOVED = {"left": (-STEP_MM, 0), "right": (STEP_MM, 0), "proximal": (0, -STEP_MM), "distal": (0, STEP_MM)}
TURNED = {"clockwise": -TURN_DEG, "counterclockwise": TURN_DEG}
POWERED = {"dimmer": 1 - POWER, "brighter": 1 + POWER}
KINDS = (*MOVED, *TURNED, *POWERED)
# Numbers of photodiodes, up to twice those of the best layout, and powers of the LEDs over its own.
COUNTS, POWERS = (2, 4, 8, 12, 16, 24, 32), (1 / 64, 1 / 8, 1.0, 4.0)
# The bound is taken as found at this gap of the logarithm, or after so many programmes and steps for each mixture.
GAP, PROGRAMMES, STEPS = 5e-4, 30, 100
# Weight by which slopes are taken, and the power of the mean over fingers by which the worst of them is approached.
WEIGHT, POWER = 1e-3, 200.0
# Groups of photons for the error of the bound, and sites that are traced further while one of them bounds all others.
BLOCKS, TRACED = 16, 8
# A grid of more places than this has no bound, which would take minutes.
MOST_PLACES = 4000


def tolerances(layout: CandidateLayout, cache: PhotonMapCache, objective: Objective) -> xr.Dataset:
    """How what layouts are ranked by changes on the fingers with each tolerance of a layout with resistors of its own.

    cache : has evaluated the layout. Another place of the board, its wall and edges straight where it is turned, or of
        an LED is traced; all else is read by the same light.

    Returns: Dataset over toleranced_part (board, photodiodes, LEDs) and deviation, NaN of what is no tolerance of a
        part, has no room, or was not traced.
    """
    objective = replace(objective, filter_groups=GROUPS)
    scene, ranked = layout.scene, score_layout(layout, cache, objective).ranked
    fingers = cache.conditions[: len(objective.points)]
    photons = min(MOST_PHOTONS, cache.most_photons or MOST_PHOTONS)
    elsewhere = replace(cache, conditions=fingers, distance_mm=PERSON_DISTANCE_MM, batch_photons=photons)
    room = boards.room_mm(*(boards.worn_on(scene, condition.case) for condition in fingers))
    leds, changes = {led.name for led in scene.leds}, dict[tuple[str, str], Array]()
    for part, kind, vary in _varied(scene):
        try:
            if part == "board" or (kind in MOVED and part in leds):
                moved, light = boards.candidate(layout.name, boards.cut_to(vary(), room), ""), elsewhere
                light.extend(moved.board, photons)
            else:
                moved, light = replace(layout, scene=vary()), cache
                boards.check(moved.scene, layout.name)
            if light.of(moved.board).photons:
                changes[part, kind] = score_layout(moved, light, objective).ranked / ranked - 1
        except InputError:
            continue
    parts = ["board", *(part.name for part in (*scene.photodiodes, *scene.leds))]
    none = np.full_like(ranked, np.nan)
    table = np.array([[changes.get((part, kind), none) for kind in KINDS] for part in parts])
    data = described(__package__, tolerance_ranking=jackknifed(np.moveaxis(table, -1, 0)))
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
            dies = [*scene.layout.leds[:i], there, *scene.layout.leds[i + 1 :]]
            if walls := scene.layout.barriers:
                moved["board.barrier_gap_mm"] = min(-walls[0].overlap_mm(one) for one in dies)
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


def pareto_front(layout: CandidateLayout, cache: PhotonMapCache, objective: Objective) -> xr.Dataset:
    """What layouts are ranked by on the fingers for numbers of photodiodes and powers of all LEDs, up to their largest
    current, which stay where the best layout has them: Dataset over front_photodiodes and led_power_mw.

    Photodiodes are chosen by one half of the photons and judged by the other, so that the choice does not flatter. On
    the front is what no point with neither more photodiodes nor more power comes within 2 % of.

    cache : has evaluated the layout.
    """
    rules, half = objective.rules, cache.blocks // 2
    choosing, judging = (cache.on_fingers(part) for part in (slice(half), slice(half, None)))
    full = boards.with_explicit_walls(layout.scene, layout.name)
    base, laid_out = boards.searchable_board(full, rules), full.layout
    search = Search(base, replace(objective, waves_left=WAVES_LEFT), choosing)
    leds_mm, walls = [die.center_mm for die in laid_out.leds], laid_out.barriers
    places = search.sites.photodiode_places(walls, dict(enumerate(leds_mm)))
    information = search.objective.together([search.columns(i, layout.board, places, i) for i in range(len(leds_mm))])
    staying, count = information[:, places.free :].sum(1), len(laid_out.photodiodes)
    score = replace(objective, filter_groups=GROUPS)
    bears = [led.max_current_ma / led.current_ma for led in full.leds if led.max_current_ma and led.current_ma]
    powers = [power for power in POWERS if power <= max(1.0, min([POWERS[-1], *bears]))]
    counts, ranked = list[int](), list[Array]()
    wall = (walls[0].name, full.board.barrier_gap_mm or 0.0) if walls else None
    fixed = len(places.areas) - places.free
    for n in sorted({count, *(n for n in COUNTS if fixed <= n <= 2 * count)}):
        how: dict[str, Any] = {"count": n - fixed, "score": search.objective.score, "given": staying}
        chosen, reached = coordinate_exchange(information[:, : places.free], places, starts=LAST_STARTS, **how)
        if not np.isfinite(reached):
            continue
        areas = [places.areas[k] for k in chosen]
        scene = boards.searched(base, rules, leds_mm, areas, wall=wall, name=f"{n} photodiodes")
        ambient_a = search.ambient_a_per_mm2 * np.array([area.area_mm2 for area in scene.layout.photodiode_areas])
        counts.append(n)
        for power in powers:
            leds = tuple(led.model_copy(update={"flux_mw": power * led.flux_mw}) for led in scene.leds)
            lit = scene.model_copy(update={"leds": leds})
            judging.ambient_a[digest(lit)] = ambient_a
            ranked.append(score_layout(replace(layout, scene=lit), judging, score).ranked)
    if not counts:
        return xr.Dataset()
    table = np.array(ranked).T.reshape(-1, len(counts), len(powers))
    front = np.zeros(table.shape[1:], bool)
    for i, j in np.ndindex(front.shape):
        *others, here = table[0, : i + 1, : j + 1].ravel()
        front[i, j] = np.isfinite(here) and all(other > (1 + ALIKE) * here for other in others)
    power_mw = [power * sum(led.flux_mw for led in full.leds) for power in powers]
    axes = {"front_photodiodes": counts, "led_power_mw": power_mw}
    return xr.Dataset(described(__package__, front_error=jackknifed(table), on_front=front, **axes))


@dataclass(frozen=True)
class Bound:
    """The bound for LEDs at one site.

    log : logarithm of what no layout falls below. weights : (free places,) float, of the relaxed design.
    """

    log: float
    weights: Array


def _tangents(objective: Objective, total: Array, information: Array) -> list[tuple[float, Array, Array]]:
    """Of each figure that ranks, its weight, and values and slopes of convex functions of which the largest is its
    logarithm: (r,) and (r, m) float, by the weights of places; of the worst finger one of each finger.

    total : (fingers, n) float. information : (fingers, m, n) float. Of a photodiode at each place.
    """
    steps = np.array([0.0, 1.0, 2.0])[:, None, None] * WEIGHT
    moved, tangents = total[:, None, None] + steps * information[:, None], []
    by_finger = [replace(objective, points=[point]) for point in objective.points]
    for name, weight in objective.rules.weights.items():
        values = [one.value(name, at[None]) for one, at in zip(by_finger, moved, strict=True)]
        here, once, twice = np.log(np.stack(values, 1))
        slopes, here = (4 * once - 3 * here - twice) / (2 * WEIGHT), here[:, 0]
        if name == "mean":
            slopes, here = (_shares(here) @ slopes)[None], np.log(np.exp(here).mean(keepdims=True))
        tangents.append((weight, here, slopes))
    return tangents


def _shares(logs: Array, power: float = 1.0) -> Array:
    """The part of each in the slope of a mean of powers, from the logarithms of its terms."""
    terms = np.exp(power * (logs - logs.max()))
    return np.asarray(terms / terms.sum())


def lower_bound(
    information: Array,
    places: PhotodiodePlaces,
    chosen: Sequence[int],
    objective: Objective,
    *,
    given: Array,
    allowed: Array | None = None,
    enough: float = np.inf,
) -> Bound:
    """The bound of the score's logarithm over all as many photodiodes as are chosen on the free places.

    information : (fingers, m, n) float. Of a photodiode at each place. given : (fingers, n) float. Of those that stay.
    chosen : a layout, from which it begins. allowed : (m,) bool. Places that may be taken; all if not given.
    enough : a bound above this is returned as it is.
    """
    free = places.free
    most = np.ones(free) if allowed is None else allowed.astype(float)
    weights = np.bincount(chosen, minlength=free).astype(float)
    designs, mixture, best, windows = [weights], np.ones(1), Bound(-np.inf, weights), places.windows
    for _ in range(PROGRAMMES):
        total = given + np.einsum("m,fmn->fn", weights, information)
        log_bound, design = _least_tangent(_tangents(objective, total, information), weights, windows, most)
        if log_bound > best.log:
            best = Bound(log_bound, weights)
        if np.log(objective.score(total)) - best.log < GAP or best.log > enough:
            break
        designs, mixture = [*designs, design], np.append(0.7 * mixture, 0.3)
        of_designs = np.einsum("dm,fmn->fdn", np.array(designs), information)
        for _ in range(STEPS):
            tangents = _tangents(objective, given + np.einsum("d,fdn->fn", mixture, of_designs), of_designs)
            falls = -np.sum([weight * _shares(values, POWER) @ slopes for weight, values, slopes in tangents], axis=0)
            if falls.max() - mixture @ falls < GAP / 4:
                break
            mixture = mixture * np.sqrt(np.maximum(falls, 0.0))
            mixture /= mixture.sum()
        weights = mixture @ np.array(designs)
    return best


def _least_tangent(
    tangents: list[tuple[float, Array, Array]], weights: Array, windows: csr_array, most: Array
) -> tuple[float, Array]:
    """The least of the tangents at a design over all weights of as many photodiodes, none above `most`, and where."""
    free, figures, cuts, ends = len(weights), len(tangents), [], []
    for k, (_, values, slopes) in enumerate(tangents):
        cuts.append(np.hstack([slopes, np.tile(-np.eye(figures)[k], (len(values), 1))]))
        ends.append(slopes @ weights - values)
    solution = linprog(
        np.append(np.zeros(free), [weight for weight, *_ in tangents]),
        A_ub=vstack([hstack([windows, csr_array((windows.shape[0], figures))]), csr_array(np.vstack(cuts))]),
        b_ub=np.concatenate([np.ones(windows.shape[0]), *ends]),
        A_eq=np.append(np.ones(free), np.zeros(figures))[None],
        b_eq=[weights.sum()],
        bounds=[*((0.0, end) for end in most), *[(None, None)] * figures],
        method="highs",
    )
    return (float(solution.fun), solution.x[:free]) if solution.success else (-np.inf, weights)


def _site_bound(design: RowDesign, site: SearchedSite, information: Array, enough: float = np.inf) -> Bound:
    """The bound for LEDs at a site that has photodiodes, (fingers, m + s, n) float."""
    places, allowed = design.places, design.allowed(site.places_mm)
    free, staying = information[:, : places.free], information[:, places.free :].sum(1)
    chosen = design.numbers(site)[: design.count]
    return lower_bound(free, places, chosen, design.objective, given=staying, allowed=allowed, enough=enough)


def certify(search: Search, report_progress: StageProgress) -> tuple[float, float] | None:
    """What no layout on the search's grid falls below, and its standard error by the noise of the light; None where
    time ends before, or the grid is too fine. The search has found a site.

    It is the least bound of all sites. That of few photons comes out low, as their noise adds to the information: it
    is traced further until no other is lower, or `TRACED` were.
    """
    sites, objective = search.ranked, replace(search.objective, waves_left=1.0)
    bounds, enough = dict[SearchedSite, Bound](), np.inf
    for site in sites:
        design = replace(search.designs[site.row], objective=objective)
        if report_progress.is_over(SEARCH_SHARE) or design.places.free > MOST_PLACES:
            return None
        information = design.information(site.places_mm)
        enough = min(enough, float(np.log(objective.score(information[:, design.numbers(site)].sum(1)))))
        bounds[site] = _site_bound(design, site, information, enough)
    again, errors = Search(search.base, objective, replace(search.cache, blocks=BLOCKS)), dict[SearchedSite, float]()
    for k in range(TRACED + 1):
        site = min(bounds, key=lambda site: bounds[site].log)
        if site in errors:
            break
        photons = SEARCH_PHOTONS if k < TRACED else search.designs[site.row].photons
        further = again.traced(site, photons, report_progress)
        if further is None:
            return None
        replicates = further.information(site.places_mm)
        bounds[site] = bound = _site_bound(further, site, replicates[:, 0])
        weights = np.append(bound.weights, np.ones(replicates.shape[2] - len(bound.weights)))
        scores = objective.score(np.einsum("m,fbmn->fbn", weights, replicates))
        errors[site] = float(jackknife(np.log(scores)))
    search.cache.photons += again.cache.photons
    if not np.isfinite(bounds[site].log):
        return None
    least = np.exp(bounds[site].log)
    return float(least), float(least * errors[site])


def beside_the_bound(
    bound: tuple[float, float] | None,
    layouts: Sequence[CandidateLayout],
    scores: Sequence[LayoutScore],
    objective: Objective,
    *,
    sites: int,
) -> xr.Dataset:
    """The bound as variables, with the distance from it of the best searched layout, by other photons; none without it.

    layouts, scores : best first, by finger, then person. sites : of the LEDs that were tried.
    """
    searched = [score for layout, score in zip(layouts, scores, strict=True) if layout.origin == "searched"]
    if bound is None or not searched:
        return xr.Dataset()
    replicates = objective.score(objective.total(searched[0].responses[: len(objective.points)]))
    ratio, error = float(replicates[0]) / bound[0], float(jackknife(np.log(replicates)))
    above = Estimate(ratio - 1, ratio * np.hypot(error, bound[1] / bound[0]))
    return xr.Dataset(described(__package__, bound=Estimate(*bound), above_bound=above, bounded_sites=sites))


def _ambient(scene: Scene, values: np.ndarray, point: OperatingPoint, cache: PhotonMapCache) -> Variables:
    """What light from outside adds to each photodiode, with the cover and without, and what it leaves of the force
    resolution."""
    sources, traced = sources_of(scene), []
    options = TraceOptions(backend=cache.backend, store=cache.store is not None)
    for cover_um, photons in ((scene.board.cover_um, PHOTONS), (0.0, OPEN_PHOTONS)):
        on = scene.model_copy(update={"board": scene.board.model_copy(update={"cover_um": cover_um})})
        how: dict[str, Any] = {"photons": photons, "seed": cache.seed, "check_time": cache.check_time}
        traced.append(trace_ambient(on, sources, options, **how))
    current, error, _ = np.stack(traced, 1)
    dims, names = ("cover", "ambient", "best_photodiode"), [source.kind for source in sources]
    data: Variables = {"cover": (("cover",), np.array(COVERS), {}), "ambient": (("ambient",), np.array(names), {})}
    high = current + Z95 * error
    read = scene_responses(scene, values, point, ambient_a=high)
    most, limit_v = np.max([r.volts for r in read], axis=0), scene.electronics.adc_range_v
    text = f"largest output with light from outside at its bound; the converter ends at {limit_v:g} V"
    data |= variable("ambient_volts", dims, most, text, units="V")
    return data | described(
        __package__,
        ambient_a=Estimate(current, error),
        ambient_high_a=high,
        ambient_noise_v=np.max([r.noise_v for r in read], axis=0),
        ambient_resolution_n=force_resolution_n(total_information(read), point),
    )


def verify_layout(layout: CandidateLayout, cache: PhotonMapCache, *, max_seconds: float) -> xr.Dataset:
    """Everything about a layout on the first finger that the map of its bare board does not contain; empty where the
    cache is to stop before.

    cache : has evaluated the layout; the fresh trace has as many photons, unless time runs out, and some in any case.
    max_seconds : the fresh trace takes half of it at most, the rest is left to light from outside. [s]
    """
    begin, condition, photons = time.perf_counter(), cache.conditions[0], cache.of(layout.board).photons
    scene, point = boards.worn_on(layout.scene, condition.case), condition.point
    tracer = cache.tracer(scene)
    blood = tuple(blood_point(scene, led, blood_fraction=point.blood_fraction) for led in range(len(scene.leds)))
    means: list[np.ndarray] = []

    batches = max(LEAST_BATCHES, photons // tracer.batch_photons)
    # Where time is short, the batches that must be are small ones.
    least = round(LEAST_PART * min(photons, tracer.batch_photons))
    per_batch = least if max_seconds <= LEAST_BATCHES * SHORT_S else max(least, photons // batches)
    try:
        while len(means) < LEAST_BATCHES or (len(means) < batches and time.perf_counter() < begin + max_seconds / 2):
            detections = []
            for i, at in enumerate(blood):
                cache.check_time()
                seed = seed_of(cache.seed, FORWARD, i, len(means))
                detections.append(tracer.detected(i, at, photons=per_batch, seed=seed))
            means.append(np.stack(detections))
        values = left_out(np.stack(means))
        data = described(__package__, checked_fraction=jackknifed(values[..., 0]))
        data |= _ambient(scene, values[0], point, cache)
    except Stopped:
        return xr.Dataset()
    read = scene_responses(scene, np.moveaxis(values, 1, 0), point, replicates=True)
    resolution = force_resolution_n(total_information(read), point)
    error = resolution_stderr_n(resolution)
    attributes = {"checked_resolution_n": float(resolution[0]), "checked_resolution_n_stderr": float(error)}
    coordinates = {"led": [led.name for led in scene.leds], "best_photodiode": list(scene.layout.photodiode_names)}
    return xr.Dataset(data, coords=coordinates, attrs=attributes)


def check_mitsuba(scenes: Sequence[Scene], backend: str) -> None:
    """Raise InputError where stock Mitsuba cannot read boards, or not in reasonable time."""
    if not backends.choose(backend, volpath=True).jit:
        raise InputError("verify_with_mitsuba: no backend here compiles volpath (see nailoptics doctor); leave it out.")
    for scene in scenes:
        check_readable(scene)


def verify_by_mitsuba(
    best: Scene,
    condition: FingerCondition,
    verified: xr.Dataset,
    options: TraceOptions,
    progress: ProgressCallback | None,
) -> xr.Dataset:
    """The readings of a layout on one finger by stock Mitsuba, over those of the fresh trace; empty if interrupted.

    verified : what `verify_layout` says of the layout.
    options : seed, backend, and whether batches are stored and taken from the store.
    """
    options = replace(options, photons=MITSUBA_PATHS, relative_error=None, max_seconds=None)
    scene = boards.worn_on(best, condition.case)
    try:
        traced = read_leds(scene, options, progress, condition.point.blood_fraction[None])
    except KeyboardInterrupt:
        return xr.Dataset()
    if traced[-1].interrupted:
        return xr.Dataset()
    # Values and standard errors.
    stock = np.stack([[reading.fraction[:, 0], reading.fraction_stderr[:, 0]] for reading in traced], 1)
    fresh = np.stack([verified.checked_fraction, verified.checked_fraction_stderr])
    # A path ends on one photodiode, so that their errors are independent.
    stock_sum, fresh_sum = (np.stack([of[0].sum(-1), np.linalg.norm(of[1], axis=-1)]) for of in (stock, fresh))
    return xr.Dataset(_over_fresh("mitsuba", stock, fresh) | _over_fresh("mitsuba_led", stock_sum, fresh_sum))


def _over_fresh(name: str, stock: np.ndarray, fresh: np.ndarray) -> Variables:
    """Light by stock Mitsuba over that of the fresh trace; both have values, then standard errors."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = stock[0] / fresh[0]
        error = ratio * np.hypot(stock[1] / stock[0], fresh[1] / fresh[0])
        z = (ratio - 1) / error
    return described(__package__, **{f"{name}_ratio": Estimate(ratio, error), f"{name}_z": z})


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


def _reason(resolution: "_Resolution", layout: CandidateLayout, person: boards.Person) -> str:
    """By which property of a person a layout's resolution is coarsest, in words; empty where there was no time."""
    worn, usual = boards.worn_on(layout.board, person), boards.worn_on(layout.board, person.first)
    middle = {prior: uncertainty.nodes_of(prior)[1] for prior in uncertainty.known_priors(usual)}
    changed = {prior.name: uncertainty.at_value(worn, prior.field, value) for prior, value in middle.items()}
    sizes = [prior.field.removeprefix("finger.") for prior in size_priors(usual.fingertip)]
    update = {name: getattr(usual.fingertip, name) for name in (*sizes, "length_mm")}
    changed["size of the finger"] = worn.model_copy(update={"finger": worn.fingertip.model_copy(update=update)})
    resolution.light.clear()
    try:
        own_mn, *others_mn = [1e3 * resolution.of(layout, person, one)[0] for one in (worn, *changed.values())]
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
            uncertainty.over_priors(boards.worn_on(layout.board, case), priors, partial(self.of, layout, case))
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

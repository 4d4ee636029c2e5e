"""What other layouts on the search's grid reach: a lower bound of all, by the relaxed design, in which places have
weights; and the Pareto front of fewer or more photodiodes and another power of the LEDs.

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

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from scipy.optimize import linprog
from scipy.sparse import csr_array, hstack, vstack
from scipy.special import softmax

from ...light.tracing import StageProgress
from ...scene import digest
from ...statistics import Array, jackknife
from ...variables import Estimate, described, jackknifed
from . import boards, candidates
from .candidates import CandidateLayout
from .objective import ALIKE, WAVES_LEFT, LayoutScore, Objective, scores_of
from .photon_maps import PhotonMapCache
from .row_design import RowDesign, SearchedSite, coordinate_exchange
from .search import LAST_STARTS, SEARCH_PHOTONS, SEARCH_SHARE, Search
from .sites import PhotodiodePlaces

# Duality gap of the logarithm at which the bound ends, and most linear programmes and multiplicative steps for each.
GAP, PROGRAMMES, STEPS = 5e-4, 30, 100
# Step of weights in differences, and the power of the mean over fingers that stands for the worst of them (softmax).
DIFFERENCE_STEP, POWER = 1e-3, 200.0
# Groups of photons for the error of the bound, and sites that are traced further while one of them bounds all others.
BLOCKS, TRACED = 16, 8
# A grid of more places than this has no bound, which would take minutes.
MOST_PLACES = 4000
# Numbers of photodiodes, up to twice those of the best layout, and powers of the LEDs over its own.
COUNTS, POWERS = (2, 4, 8, 12, 16, 24, 32), (1 / 64, 1 / 8, 1.0, 4.0)
# Groups of photons for the error of the front.
GROUPS = 4


def _tangents(objective: Objective, total: Array, information: Array) -> list[tuple[float, Array, Array]]:
    """Of each figure that ranks, its weight, and values and slopes of convex functions of which the largest is its
    logarithm: (r,) and (r, m) float, by the weights of places; of the worst finger one of each finger.

    total : (fingers, n) float. information : (fingers, m, n) float. Of a photodiode at each place.
    """
    steps = np.array([0.0, 1.0, 2.0])[:, None, None] * DIFFERENCE_STEP
    moved, tangents = total[:, None, None] + steps * information[:, None], []
    by_finger = [replace(objective, points=[point]) for point in objective.points]
    for name, weight in objective.rules.weights.items():
        values = [one.value(name, at[None]) for one, at in zip(by_finger, moved, strict=True)]
        here, once, twice = np.log(np.stack(values, 1))
        slopes, here = (4 * once - 3 * here - twice) / (2 * DIFFERENCE_STEP), here[:, 0]
        if name == "mean":
            slopes, here = (softmax(here) @ slopes)[None], np.log(np.exp(here).mean(keepdims=True))
        tangents.append((weight, here, slopes))
    return tangents


def lower_bound(
    information: Array,
    places: PhotodiodePlaces,
    chosen: Sequence[int],
    objective: Objective,
    *,
    given: Array,
    allowed: Array | None = None,
    stop_above: float = np.inf,
) -> tuple[float, Array]:
    """The bound of the score's logarithm over all as many photodiodes as are chosen on the free places, and weights
    (m,) of the relaxed design.

    information : (fingers, m, n) float. Of a photodiode at each place. given : (fingers, n) float. Of those that stay.
    chosen : a layout, from which it begins. allowed : (m,) bool. Places that may be taken; all if not given.
    stop_above : a bound above this is returned as it is.
    """
    if not (free := places.free):
        return float(np.log(objective.score(given))), np.zeros(0)
    most = np.ones(free) if allowed is None else allowed.astype(float)
    weights = np.bincount(chosen, minlength=free).astype(float)
    designs, mixture, best, windows = [weights], np.ones(1), (-np.inf, weights), places.windows
    for _ in range(PROGRAMMES):
        total = given + np.einsum("m,fmn->fn", weights, information)
        log_bound, design = _least_in_programme(_tangents(objective, total, information), weights, windows, most)
        if log_bound > best[0]:
            best = log_bound, weights
        if np.log(objective.score(total)) - best[0] < GAP or best[0] > stop_above:
            break
        designs, mixture = [*designs, design], np.append(0.7 * mixture, 0.3)
        of_designs = np.einsum("dm,fmn->fdn", np.array(designs), information)
        for _ in range(STEPS):
            tangents = _tangents(objective, given + np.einsum("d,fdn->fn", mixture, of_designs), of_designs)
            falls = -np.sum([weight * softmax(POWER * values) @ slopes for weight, values, slopes in tangents], axis=0)
            if falls.max() - mixture @ falls < GAP / 4:
                break
            mixture = mixture * np.sqrt(np.maximum(falls, 0.0))
            mixture /= mixture.sum()
        weights = mixture @ np.array(designs)
    return best


def _least_in_programme(
    tangents: list[tuple[float, Array, Array]], weights: Array, windows: csr_array, most: Array
) -> tuple[float, Array]:
    """Linear programme: the least of tangents over all weights of as many photodiodes, none above `most`, and where."""
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


def _site_bound(
    design: RowDesign, site: SearchedSite, information: Array, stop_above: float = np.inf
) -> tuple[float, Array]:
    """The `lower_bound` for LEDs at a site that has photodiodes, (fingers, m + s, n) float."""
    places, allowed = design.places, design.allowed(site.places_mm)
    free, staying = information[:, : places.free], information[:, places.free :].sum(1)
    chosen = design.numbers(site)[: design.count]
    return lower_bound(free, places, chosen, design.objective, given=staying, allowed=allowed, stop_above=stop_above)


def certify(search: Search, report_progress: StageProgress) -> tuple[float, float] | None:
    """Lower bound on the score of any layout on the search's grid, and its standard error by the noise of the light;
    None where time ends before, or the grid is too fine. The search has found a site.

    It is the least bound of all sites. That of few photons comes out low, as their noise adds to the information: it
    is traced further until no other is lower, or `TRACED` were.
    """
    sites, objective = search.ranked, replace(search.objective, waves_left=1.0)
    logs, stop_above = dict[SearchedSite, float](), np.inf
    for site in sites:
        design = replace(search.designs[site.row], objective=objective)
        if report_progress.is_over(SEARCH_SHARE) or design.places.free > MOST_PLACES:
            return None
        information = design.information(site.places_mm)
        stop_above = min(stop_above, float(np.log(objective.score(information[:, design.numbers(site)].sum(1)))))
        logs[site], _ = _site_bound(design, site, information, stop_above)
    again, errors = copy(search), dict[SearchedSite, float]()
    again.objective, again.cache = objective, replace(search.cache, blocks=BLOCKS)
    for k in range(TRACED + 1):
        site = min(logs, key=lambda site: logs[site])
        if site in errors:
            break
        photons = SEARCH_PHOTONS if k < TRACED else search.designs[site.row].photons
        further = again.traced(site, photons, report_progress)
        search.cache.photons, again.cache.photons = search.cache.photons + again.cache.photons, 0
        if further is None:
            return None
        replicates = further.information(site.places_mm)
        logs[site], free = _site_bound(further, site, replicates[:, 0])
        weights = np.append(free, np.ones(replicates.shape[2] - len(free)))
        scores = objective.score(np.einsum("m,fbmn->fbn", weights, replicates))
        errors[site] = float(jackknife(np.log(scores)))
    if not np.isfinite(logs[site]):
        return None
    least = np.exp(logs[site])
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
    by_led = [search.columns(i, layout.board, places, i) for i in range(len(leds_mm))]
    information = search.objective.sum_over_leds(by_led)
    staying, count = information[:, places.free :].sum(1), len(laid_out.photodiodes)
    score = replace(objective, filter_groups=GROUPS)
    bears = [led.max_current_ma / led.current_ma for led in full.leds if led.max_current_ma and led.current_ma]
    powers = [power for power in POWERS if power <= max(1.0, min([POWERS[-1], *bears]))]
    counts, read, prices = list[int](), list[Any](), list[float]()
    wall = (walls[0].name, full.board.barrier_gap_mm or 0.0) if walls else None
    fixed = len(places.areas) - places.free
    for n in sorted({count, *(n for n in COUNTS if fixed <= n <= 2 * count)}):
        how: dict[str, Any] = {"count": n - fixed, "score": search.objective.score, "given": staying}
        chosen, reached = coordinate_exchange(information[:, : places.free], places, starts=LAST_STARTS, **how)
        if not np.isfinite(reached):
            continue
        areas = [places.areas[k] for k in chosen]
        scene = candidates.searched(base, rules, leds_mm, areas, wall=wall, name=f"{n} photodiodes")
        ambient_a = search.ambient_a_per_mm2 * np.array([area.area_mm2 for area in scene.layout.photodiode_areas])
        counts.append(n)
        parts = (*scene.leds, *(element.photodiode for element in scene.layout.photodiodes))
        prices.append(sum(np.nan if part.price is None else part.price for part in parts))
        for power in powers:
            leds = tuple(led.model_copy(update={"flux_mw": power * led.flux_mw}) for led in scene.leds)
            lit = scene.model_copy(update={"leds": leds})
            judging.ambient_a[digest(lit)] = ambient_a
            read.append(judging.read(lit, layout.board, len(score.points)))
    if not counts:
        return xr.Dataset()
    table = np.array([one.ranked for one in scores_of(read, score)]).T.reshape(-1, len(counts), len(powers))
    front = np.zeros(table.shape[1:], bool)
    for i, j in np.ndindex(front.shape):
        *others, here = table[0, : i + 1, : j + 1].ravel()
        front[i, j] = np.isfinite(here) and all(other > (1 + ALIKE) * here for other in others)
    power_mw = [power * sum(led.flux_mw for led in full.leds) for power in powers]
    costs = {"front_photodiodes": counts, "front_price": np.array(prices), "led_power_mw": power_mw}
    return xr.Dataset(described(__package__, front_error=jackknifed(table), on_front=front, **costs))

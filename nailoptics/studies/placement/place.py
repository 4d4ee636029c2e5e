"""Layout design: rank given layouts and searched ones by the force that they resolve, on every finger."""

import logging
import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Unpack

import xarray as xr

from ...errors import InputError, NotReachedError, unless_cut_off
from ...light import ProgressCallback, backend as backends
from ...light.tracing import StageProgress
from ...light.tracing.store import LightStore
from ...options import Requested, TraceOptions
from ...scene import FingerCase, Placement, Scene, SceneIn, as_scene, digest, load_scene
from ...sensor.information import operating_point
from ...variables import stopwatch
from ..force.touch_error import TouchError
from . import boards, candidates, certificate, robustness, search, verification
from .candidates import CandidateLayout
from .objective import JUDGE_SHARE, UNRESOLVED, WAVES_LEFT, LayoutScore, Objective, score_layouts, spo2_objective
from .photon_maps import FingerCondition, PhotonMapCache
from .result import as_dataset, kicad_parts
from .robustness import tolerances
from .row_design import SearchedSite
from .verification import verify_layout

log = logging.getLogger(__name__)

DEFAULT_SECONDS = 480.0
DEFAULT_RELATIVE_ERROR = 0.02
BLOCKS = 32
# The best layout is verified by its own trace if so much time is left. [s]
CHECK_S = 10.0
# Fraction of the time left that this takes at most; the rest is for what is unknown of the finger.
VERIFY_SHARE = 0.7


def place(
    scene: SceneIn,
    *,
    verify_with_mitsuba: bool = False,
    progress: ProgressCallback | None = None,
    **requested: Unpack[Requested],
) -> xr.Dataset:
    """Rank layouts of a finger scene by the force that they resolve; `result.nail.scene` is the best.

    verify_with_mitsuba : also read the best layout by stock Mitsuba, for minutes past max_seconds; what an interrupted
        run has traced of this is taken from the store.
    photons : per layout, LED and finger, 4096 at least, in place of a tolerance; search and tolerances take no more.
    relative_error : the evaluation ends when the best is distinguished from all others or every score is known so
        well; 0.02 if nothing is requested.
    max_seconds : wall time after which it ends in any case; 480 if nothing is requested. [s]

    Returns: Dataset over layout (best first), finger, photodiode and, for the best, the plane of the board.

    Raises: InputError; NotReachedError, with the Dataset as result, where time ran out or the user interrupted before
    the best was distinguished from the others or the tolerance was met; interrupted, the layouts so far are evaluated
    roughly.
    """
    scene = as_scene(scene)
    boards.check_two_zones(scene, "place")
    options, accuracy, run_time = TraceOptions(**requested), scene.accuracy, stopwatch()
    photons = options.photons or accuracy.photons
    limit_s = options.max_seconds or accuracy.max_seconds or (math.inf if photons else DEFAULT_SECONDS)
    report_progress = StageProgress(progress, limit_s)
    rules, base = boards.rules(scene), boards.base_board(scene)
    if verify_with_mitsuba:
        verification.check_mitsuba([base, *(layout.scene for layout in given(base, rules))], options.backend)
    people = boards.people(scene)
    on_fingers = [finger_condition(base, case, rules) for case in boards.fingers(scene)]
    conditions = [*on_fingers, *(finger_condition(base, person, rules) for person in people)]
    of_fingers = _objective(base, on_fingers, rules)
    objective = _objective(base, conditions, rules) if people else of_fingers
    made: dict[str, Any] = {"seed": options.seed, "backend": backends.choose(options.backend).name}
    stores = LightStore.of_command(options)
    ranking = PhotonMapCache(conditions, **made, stores=stores, stream=1, blocks=BLOCKS, most_photons=photons)
    searching = replace(ranking, conditions=on_fingers, stream=0, blocks=1, one_by_one=True)
    searching.stop = partial(report_progress.is_over, search.SEARCH_SHARE)
    layouts, searched, bound = _candidates(base, of_fingers, searching, people, report_progress)
    ranking.stop = partial(_evaluated_enough, ranking, layouts if searched else [], report_progress)
    target = options.relative_error or accuracy.relative_error or DEFAULT_RELATIVE_ERROR
    how: dict[str, Any] = {"objective": objective, "relative_error": target, "report_progress": report_progress}
    given_count = len(layouts)
    layouts, scores, unmet = score_layouts(layouts, ranking, photons=photons, **how)
    layouts = [replace(layout, scene=ranking.with_resistors(layout.scene, layout.board)) for layout in layouts]
    report_progress("check", 0.0, scores[0].relative_error)
    mitsuba = options if verify_with_mitsuba else None
    checked, unchecked = _checked(layouts, scores, ranking, of_fingers, report_progress, mitsuba)
    checked = checked.merge(certificate.beside_the_bound(bound, layouts, scores, of_fingers, sites=len(searched)))
    made |= {"layouts_given": given_count, "photons": ranking.photons + searching.photons} | run_time()
    result = as_dataset(scene, layouts, scores, ranking, searched, checked, made)
    return unless_cut_off(result, unmet or unchecked)


def _checked(
    layouts: Sequence[CandidateLayout],
    scores: Sequence[LayoutScore],
    cache: PhotonMapCache,
    of_fingers: Objective,
    report_progress: StageProgress,
    mitsuba: TraceOptions | None,
) -> tuple[xr.Dataset, str | None]:
    """The best layout by its own trace, on other fingers, within its tolerances and, with options for it, by stock
    Mitsuba; all for the people, if there are any; and what of the traces there was no time for, if any."""
    known, spread = xr.Dataset(), layouts[0].board.priors.spread
    cache.stop = partial(report_progress.is_over, 1.0)
    if (left_s := report_progress.seconds_left) > CHECK_S:
        known = verify_layout(layouts[0], cache, max_seconds=VERIFY_SHARE * left_s)
    if spread and report_progress.seconds_left > CHECK_S:
        known = known.merge(robustness.resolution_over_priors(layouts, of_fingers.rules, cache))
    if mitsuba and "checked_fraction" in known and not report_progress.interrupted:
        on = layouts[0].scene, cache.conditions[0]
        known = known.merge(verification.verify_by_mitsuba(*on, known, mitsuba, report_progress.callback))
        report_progress.interrupted = "mitsuba_ratio" not in known
    for study in (tolerances, certificate.pareto_front):
        known = known.merge(study(layouts[0], cache, of_fingers), combine_attrs="override")
    if cache.people:
        known = known.merge(robustness.over_people(layouts, scores, cache), combine_attrs="override")
    due = [("checked_fraction", True, "verified"), ("resolution_spread", spread, "evaluated on other fingers")]
    due += [("mitsuba_ratio", mitsuba is not None, "read by stock Mitsuba")]
    missing = [words for name, is_due, words in due if is_due and name not in known]
    return known, f"{report_progress.why} before the best layout was {missing[0]}." if missing else None


def _objective(base: Scene, conditions: Sequence[FingerCondition], rules: Placement) -> Objective:
    """The rule by which layouts are ranked on these fingers, and for the people among them if there are any."""
    cases = [condition.case for condition in conditions]
    rules = rules.model_copy(update={"people": sum(isinstance(case, boards.PersonCase) for case in cases)})
    oxygen = spo2_objective(base, cases, rules.force_n) if "oxygen" in rules.weights else None
    filters = [TouchError(boards.worn_on(base, case), rules.force_n) for case in cases if "force" in rules.weights]
    return Objective(rules, [condition.point for condition in conditions], oxygen, filters)


def _candidates(
    base: Scene,
    objective: Objective,
    cache: PhotonMapCache,
    people: Sequence[boards.PersonCase],
    report_progress: StageProgress,
) -> tuple[list[CandidateLayout], list[SearchedSite], tuple[float, float] | None]:
    """All layouts to evaluate, given, searched and the paper's, every site of the LEDs that the search tried, and what
    no layout on its grid falls below, as `certify`.

    people : whose nails the board of the search must fit, too.
    """
    rules = objective.rules
    for line in boards.misfits(base):
        log.warning("%s", line)
    for ref in dict.fromkeys(p.footprint for p in (*base.leds, *base.photodiodes) if p.is_of_module):
        log.warning("%s is one footprint, whose dies do not move by themselves: it stays where it is.", ref)
    boards.check_search(base, rules)
    # The paper's layout has one LED, which cannot measure oxygen, and is no layout for somebody's own board.
    of_paper = "oxygen" not in rules.weights and base.board.unmapped is None
    paper = _paper_layout(base, cache.conditions) if of_paper else None
    layouts = given(base, rules)
    if paper and all(of(base) == of(paper.scene) for of in (kicad_parts, lambda scene: scene.leds[0].flux_mw)):
        layouts = [one for one in layouts if one.name != "scene"]
    straight = boards.searchable_board(base, rules)
    for person in people:
        straight = boards.cut_to(straight, boards.room_mm(boards.worn_on(base, person)))
    layout_search = search.Search(straight, replace(objective, waves_left=WAVES_LEFT), cache)
    searched = layout_search.run(report_progress) if rules.search else []
    bound = certificate.certify(layout_search, report_progress) if searched else None
    parts = f"{len(base.leds)} LEDs and {rules.photodiodes} photodiodes"
    has_room = any(design.places.free >= design.count for design in layout_search.designs.values())
    if rules.search and not searched and not report_progress.is_over(search.SEARCH_SHARE):
        wall = ", set board.barrier = false" if base.board.barrier else ""
        room = f"no room for {parts}; make the board larger, placement.led_step_mm smaller{wall}, or ask for fewer"
        log.warning("placement.search: %s", UNRESOLVED if has_room else room)
    # The user's layouts and the search's best are evaluated even where time is over.
    layouts += search.shortlist(straight, rules, [*searched, *layout_search.regular])
    layouts += [paper] if paper else []
    if not layouts and report_progress.is_over(search.SEARCH_SHARE):
        raise NotReachedError(f"{report_progress.why} before one place of the LEDs was tried; allow more time.")
    if not layouts:
        room = f"{parts} of {base.photodiodes[0].size_mm} mm have no room beside each other; make the board larger, ask"
        raise InputError(f"placement: {UNRESOLVED if has_room else f'{room} for fewer, or fix and keep out less'}.")
    return layouts, searched, bound


def _evaluated_enough(cache: PhotonMapCache, layouts: Sequence[CandidateLayout], progress: StageProgress) -> bool:
    """Whether the evaluation ends: time is over, or the user has interrupted, and the boards of the user's layouts and
    of a search's best, which leaves little time, have been traced."""
    listed = sum(layout.origin == "given" for layout in layouts)
    least = 1 if progress.interrupted else len({digest(layout.board) for layout in layouts[: listed + 1]})
    return progress.is_over(JUDGE_SHARE) and cache.boards_traced >= least


def finger_condition(base: Scene, case: FingerCase | boards.PersonCase, rules: Placement) -> FingerCondition:
    """A finger of the placement with the touch at which layouts are evaluated."""
    scene = boards.worn_on(base, case)
    return FingerCondition(case, operating_point(scene, rules.force_n, since_rest_s=rules.since_rest_s))


def given(base: Scene, rules: Placement) -> list[CandidateLayout]:
    """The layouts that [placement] lists; if none, the scene's own, if it fits and could tell two pressures apart."""
    layouts = [(one.name, candidates.candidate_scene(base, one)) for one in rules.candidates]
    if not layouts and base.board.unmapped is not None:
        layouts = [("drawn", base)]
    elif not layouts and boards.fits(base) and len(base.leds) * len(base.layout.photodiodes) > 1:
        layouts = [("scene", base)] if len(base.layout.barriers) < 2 else []
    for name, scene in layouts:
        for line in boards.courtyard_overlaps(scene):
            log.warning('layout "%s": %s', name, line)
    return [candidates.candidate(name, scene, "given") for name, scene in layouts]


def _paper_layout(base: Scene, conditions: Sequence[FingerCondition]) -> CandidateLayout | None:
    """The paper's layout on the same finger with the same electronics; None where it does not fit every nail."""
    prototype = load_scene("prototype")
    shared = ("finger", "blood", "touch", "body", "electronics", "light", "priors")
    unfitted = tuple(p.model_copy(update=boards.UNFITTED) for p in prototype.photodiodes)
    scene = prototype.model_copy(update={name: getattr(base, name) for name in shared} | {"photodiodes": unfitted})
    try:
        for condition in conditions:
            candidates.check(boards.worn_on(scene, condition.case, light_only=True), "paper")
    except InputError as error:
        log.warning("the paper's layout is left out: %s", error)
        return None
    scene = boards.with_explicit_walls(scene, "paper")
    return CandidateLayout("paper", scene, boards.bare_board(scene), "paper")

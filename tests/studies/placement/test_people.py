"""Layouts for people drawn from the priors, and the tolerances of the best."""

from dataclasses import replace

import numpy as np
import pytest
from layout_scores import score_layout
from small_scenes import TWO_LAYOUTS as SCENE

from nailoptics.scene import FingerCase, parse_scene
from nailoptics.sensor.information import over_fingers
from nailoptics.statistics import jackknife
from nailoptics.studies.placement import boards, candidates, photon_maps, place, robustness
from nailoptics.studies.placement.objective import Objective
from nailoptics.studies.placement.robustness import over_people, tolerances
from nailoptics.studies.prior_uncertainty import draw_people, known_priors, value_of

PEOPLE = SCENE.replace("[placement]\n", "[placement]\npeople = 20\n", 1)


def cache_of(conditions, seed=0):
    return photon_maps.PhotonMapCache(conditions, seed, stream=1, backend="auto", blocks=16)


def objective_of(rules, conditions, people=0):
    points = [condition.point for condition in conditions]
    return Objective(rules.model_copy(update={"people": people}), points)


def test_people_are_drawn_from_the_priors_and_always_the_same():
    """Expected: medians within what ranks of 200 leave, no value beyond a prior's ends, sizes that go together."""
    scene = parse_scene(PEOPLE)
    drawn = draw_people(scene, 200)
    assert drawn == draw_people(scene, 200)
    for prior in known_priors(scene):
        values = np.array([one[prior.field] for one in drawn])
        middle = np.sqrt(prior.low * prior.high) if prior.scale == "log" else (prior.low + prior.high) / 2
        assert prior.low - 1e-9 <= values.min() and values.max() <= prior.high + 1e-9, prior.field
        assert np.quantile(values, 0.4) < middle < np.quantile(values, 0.6), prior.field
    widths, lengths = (np.log([one[f"finger.nail_{name}_mm"] for one in drawn]) for name in ("width", "length"))
    assert np.median(widths) == pytest.approx(np.log(value_of(scene, "finger.nail_width_mm")), abs=0.01)
    assert 0.6 < np.corrcoef(widths, lengths)[0, 1] < 0.8
    # 95 % of index fingers have nails of 10 to 14 mm.
    assert widths.std() == pytest.approx(np.log(14 / 10) / 3.92, rel=0.1)


def test_a_quantile_is_what_no_less_than_that_part_of_the_people_reach():
    rng = np.random.default_rng(0)
    resolution = rng.permutation(np.arange(1.0, 21.0))[:, None] * [1.0, 2.0]
    fingers = np.full((2, 2), 99.0)
    assert over_fingers(np.concatenate([fingers, resolution]), "worst", 20, 0.9).tolist() == [18.0, 36.0]
    assert over_fingers(resolution, "worst", 20, 0.85).tolist() == [17.0, 34.0]
    assert over_fingers(fingers, "worst").tolist() == [99.0, 99.0]


def test_a_scene_without_people_has_none_and_their_number_is_its_own():
    assert boards.people(parse_scene(SCENE)) == []
    people = boards.people(parse_scene(PEOPLE))
    assert len({person.name for person in people}) == len({person.digit for person in people}) == 20


def test_what_of_a_board_reaches_over_a_narrow_nail_is_cut_and_parts_there_do_not_fit():
    scene = parse_scene(PEOPLE)
    layouts = place.given(boards.base_board(scene), boards.rules(scene))
    person = boards.people(scene)[0]
    narrow, sharp = (replace(person, values=person.values | {"finger.nail_width_mm": mm}) for mm in (8.0, 6.5))
    worn = boards.worn_on(layouts[0].scene, narrow)
    assert worn.layout.outline.size_mm == pytest.approx((7.8, 9.0))
    assert worn.layout.photodiode_areas == layouts[0].scene.layout.photodiode_areas
    bare = boards.worn_on(layouts[0].board, narrow).layout
    assert bare.outline == worn.layout.outline and boards.fits(worn)
    assert not boards.fits(boards.worn_on(layouts[1].scene, sharp))


@pytest.fixture(scope="module")
def evaluated(chosen_jit):
    """Two layouts on the usual finger, on two people, and on a third with a nail too narrow for the far one."""
    scene = parse_scene(PEOPLE)
    base, rules = boards.base_board(scene), boards.rules(scene)
    first, second, third, *_ = boards.people(scene)
    people = [first, second, replace(third, values=third.values | {"finger.nail_width_mm": 7.0})]
    conditions = [place.finger_condition(base, case, rules) for case in (FingerCase(name="one"), *people)]
    cache = cache_of(conditions)
    layouts = place.given(base, rules)
    for layout in layouts:
        cache.traced_board(layout.board).areas.extend(layout.scene.layout.photodiode_areas)
    # Both have one board.
    cache.extend(layouts[0].board, 1 << 18)
    objective = objective_of(rules, conditions, people=3)
    return base, rules, layouts, cache, objective, [score_layout(layout, cache, objective) for layout in layouts]


@pytest.mark.long
def test_a_person_is_read_as_a_finger_with_the_same_values(evaluated):
    """Rationale: a person's light is recorded on the photodiodes alone, on a coarser grid of distances. Expected: the
    resolution on a placement's only finger that has the person's values, by photons of another seed."""
    base, rules, layouts, cache, _, scores = evaluated
    person = cache.people[0]
    own = boards.worn_on(base, person)
    condition = place.finger_condition(own, FingerCase(name="one"), rules)
    other = cache_of([condition], seed=5)
    layout = replace(layouts[0], board=boards.worn_on(layouts[0].board, person))
    other.extend(layout.board, 1 << 18)
    fresh = score_layout(layout, other, objective_of(rules, [condition]))
    mine = scores[0].electronics.fingers_n[:, 1]
    errors = [float(jackknife(np.log(each))) for each in (mine, fresh.electronics.fingers_n[:, 0])]
    assert abs(np.log(mine[0] / fresh.electronics.fingers_n[0, 0])) < 4 * np.hypot(*errors) and max(errors) < 0.15


@pytest.mark.long
def test_people_who_cannot_wear_a_layout_resolve_nothing_with_it(evaluated, monkeypatch):
    base, rules, layouts, cache, objective, scores = evaluated
    near, far = (score.force.fingers_n[0] for score in scores)
    assert near[3] < 0.2 and far[3] > 5 and (far[:3] < 0.5).all()
    assert scores[1].force.all_n[0] == far[3] and scores[0].force.all_n[0] == near[1:].max()
    # Any few priors may be a reason; each takes a trace.
    monkeypatch.setattr(robustness.uncertainty, "known_priors", lambda scene: known_priors(scene)[::5])
    made = over_people(layouts, scores, cache)
    assert made.people_off.values.tolist() == [0, 1]
    worst = np.array([near[1:].max(), far[1:3].max()])
    assert made.worst_resolution_n.values == pytest.approx(worst)
    assert made.worst_person.values[0] == cache.people[int(near[1:].argmax())].name
    assert made.worst_person.values[1] == cache.people[int(far[1:3].argmax())].name
    assert made.median_resolution_n.values[0] == np.sort(near[1:])[1]
    assert "instead of" in str(made.worst_reason.values[0])


@pytest.mark.long
def test_fingers_are_read_the_same_whether_or_not_there_are_people(evaluated):
    base, rules, layouts, cache, _, scores = evaluated
    alone = cache_of(cache.conditions[:1])
    alone.extend(layouts[0].board, 1 << 18)
    score = score_layout(layouts[0], alone, objective_of(rules, alone.conditions))
    assert np.array_equal(score.force.fingers_n[:, 0], scores[0].force.fingers_n[:, 0])


@pytest.mark.long
def test_tolerances_of_gluing_and_power_are_those_of_layouts_with_them(evaluated, monkeypatch):
    """Expected: a board glued 0.5 mm to the left as a layout whose places all lie there, by light of another seed; an
    LED of a quarter more power, as a scene with such an LED on the same light."""
    base, rules, layouts, cache, _, _ = evaluated
    on_finger = cache.conditions[:1]
    objective = objective_of(rules, on_finger)
    layout = replace(layouts[0], scene=cache.with_resistors(layouts[0].scene, layouts[0].board))
    # To one side alone.
    monkeypatch.setattr(robustness, "MOVED", {"left": robustness.MOVED["left"]})
    result = tolerances(layout, cache, objective)
    ranked = score_layout(layout, cache, objective).ranked
    brighter = [led.model_copy(update={"flux_mw": 1.25 * led.flux_mw}) for led in layout.scene.leds]
    with_power = replace(layout, scene=layout.scene.model_copy(update={"leds": tuple(brighter)}))
    change = float(score_layout(with_power, cache, objective).ranked[0] / ranked[0]) - 1
    led = result.sel(toleranced_part=layout.scene.leds[0].name)
    assert float(led.tolerance_ranking.sel(deviation="brighter")) == pytest.approx(change, rel=1e-9) and change < 0
    moved = {
        kind: tuple(
            part.model_copy(update={"position_mm": (part.position_mm[0] - 0.5, part.position_mm[1])})
            for part in getattr(layout.scene, kind)
        )
        for kind in ("leds", "photodiodes")
    }
    there = candidates.candidate("there", layout.scene.model_copy(update=moved), "given")
    other = cache_of(on_finger, seed=7)
    other.extend(there.board, 1 << 18)
    fresh = score_layout(there, other, objective).ranked / ranked
    board = result.sel(toleranced_part="board", deviation="left")
    error = np.hypot(float(board.tolerance_ranking_stderr), float(jackknife(fresh)))
    assert abs(float(board.tolerance_ranking) - (fresh[0] - 1)) < 4 * error and error < 0.3
    turned = result.tolerance_ranking.sel(toleranced_part="board", deviation=["clockwise", "counterclockwise"])
    assert np.isfinite(turned).all() and np.isfinite(led.tolerance_ranking.sel(deviation="left"))
    assert np.isnan(led.tolerance_ranking.sel(deviation="clockwise"))


@pytest.mark.slow
def test_a_board_for_several_fingers_is_glued_with_what_of_it_every_nail_bears(chosen_jit):
    """Expected: a board as large as the nail of the little finger has room beside its place, without its edge there."""
    fingers = '[placement]\nfingers = [{ name = "index" }, { name = "little", digit = "little" }]\n'
    scene = parse_scene(SCENE.replace("size_mm = [9.0, 9.0]\n", "").replace("[placement]\n", fingers, 1))
    base, rules = boards.base_board(scene), boards.rules(scene)
    conditions = [place.finger_condition(base, case, rules) for case in boards.fingers(scene)]
    layout, cache = place.given(base, rules)[0], cache_of(conditions)
    cache.extend(layout.board, 1 << 15)
    layout = replace(layout, scene=cache.with_resistors(layout.scene, layout.board))
    result = tolerances(layout, cache, objective_of(rules, conditions))
    glued = result.tolerance_ranking.sel(toleranced_part="board", deviation=["left", "right", "proximal", "distal"])
    assert np.isfinite(glued).all()

"""The paper's claims: what each named set meets; the search measures what the table shows, and improves sets."""

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest
from benchmarks.parameter_search import (
    OF_SUBJECT,
    SEARCHED,
    largest_loop_gain,
    logarithms_of,
    loss_of_pairs,
    misses,
    pair_of,
    search,
    simulate_responses_of_many,
)

from nailoptics.errors import InputError
from nailoptics.hemodynamics import NAMES, bounds, parameters, respond, steady_state
from nailoptics.hemodynamics.parameters import beds, each_bed
from nailoptics.paper.claims import RULES, as_rows, evaluate
from nailoptics.paper.responses import (
    CURVE_PA,
    ON_S,
    PA_PER_N_PER_CM2,
    RELAXATION_S,
    Responses,
    cycle,
    one_sided,
    press,
    simulate_responses,
    steps,
    subject_force,
)
from nailoptics.report.pages import paper as page

V_P2_LEVEL = "pressure at which 95 % of V_P2's change has come"


@pytest.fixture(scope="module")
def responses():
    return {name: simulate_responses(parameters(name)) for name in NAMES}


@pytest.fixture(scope="module")
def evaluated(responses):
    return {name: evaluate(one, name) for name, one in responses.items()}


@pytest.fixture(scope="module")
def coarse():
    """All sets at once, as the search simulates them."""
    sets = [parameters(name).as_dict() for name in NAMES]
    return simulate_responses_of_many(together(sets))


def together(sets):
    """Constants of several sets side by side: arrays, or pairs of them where the beds differ in one."""
    pairs = {field: np.array([beds(one[field]) for one in sets]).T for field in sets[0]}
    return {field: one if np.array_equal(one, two) else (one, two) for field, (one, two) in pairs.items()}


def missed(evaluated, name):
    return {(claim.rule.figure, claim.rule.text.split(",")[0]) for claim in evaluated[name] if not claim.met}


def test_simulation_and_subject_meet_all_rules_together(evaluated):
    """Stiffness and damping alone differ, and no bed of either can have two balances."""
    first, second = (parameters(name).as_dict() for name in ("simulation", "subject"))
    assert {name for name in first if first[name] != second[name]} == set(OF_SUBJECT)
    assert missed(evaluated, "simulation") == missed(evaluated, "subject") == set()
    assert max(largest_loop_gain(one).max() for one in (first, second)) < 1.0


def test_where_the_band_of_the_subject_ends_depends_on_the_contact(evaluated, monkeypatch):
    """Expected: on the contact of a touch on one side, 50 mm^2, it grows past 4 N by more than the rule allows."""
    rule = next(claim.rule for claim in evaluated["subject"] if claim.rule.text.startswith("growth of the band from 4"))
    monkeypatch.setattr("nailoptics.paper.responses.DISTAL_AREA_MM2", 50.0)
    set_alone = {name: each_bed(np.atleast_1d, value) for name, value in parameters("subject").as_dict().items()}
    assert rule.high < rule.measure(simulate_responses_of_many(set_alone, [rule]))[0] < 0.06


def test_sets_of_one_bed_miss_what_both_beds_together_cannot_give(evaluated):
    """Fig. 10 releases slowly, Fig. 16 quickly: no set has both; "sluggish" has one, "best" all but the other."""
    v_p2 = {("12", "slope of V_P2 to 0.1 over that from 0.1 to 1 N/cm^2"), ("12", V_P2_LEVEL)}
    unloading = ("16", "proximal time constant on unloading (likewise)")
    assert missed(evaluated, "best") > v_p2 | {("10", "time constants"), unloading}
    assert missed(evaluated, "sluggish") > v_p2 | {unloading, ("11", "overshoot of the distal reading")}
    value = {
        name: next(c.value for c in evaluated[name] if c.rule.text == unloading[1]) for name in ("best", "sluggish")
    }
    assert value["best"] < 0.155 < 0.25 < value["sluggish"]


def test_linear_walls_without_feedback_cannot_begin_as_steeply_as_v_p2():
    """Rationale: under P_F2 alone a wall that follows the pressure linearly empties as (1 - a P)^2. Expected: where
    that stays within 0.1 of its chord to 1 N/cm^2, its first slope is at most 1.444 times the later one; 1.5 needs
    more, which venules are."""
    slope = next(rule for rule in RULES if rule.text.startswith("slope of V_P2"))
    chord = next(rule for rule in RULES if rule.text.startswith("V_P2 off its chord"))
    closing = np.linspace(0.2, 3.0, 2801)[:, None]
    blood = np.maximum(1.0 - CURVE_PA / PA_PER_N_PER_CM2 / closing, 0.0) ** 2
    names = [field.name for field in dataclasses.fields(Responses)]
    made = Responses(**dict.fromkeys(names, np.empty(0)) | {"alone": np.stack([blood, blood])})
    straight = chord.measure(made) <= chord.high
    assert straight.any() and 1.40 < slope.measure(made)[straight].max() < 1.45 < slope.low


def test_the_guide_states_how_many_rules_best_meets(evaluated):
    text = (Path(__file__).parents[2] / "docs" / "model.md").read_text(encoding="utf-8")
    section = text[text.index("| figure, touch | rules `best` meets |") :]
    rows = [line.split("|")[1:3] for line in section.splitlines()[2:9]]
    for figures, met in rows:
        names = set(re.findall(r"\d+|II", figures))
        claims = [claim for claim in evaluated["best"] if claim.rule.figure in names]
        assert met.strip() == f"{sum(claim.met for claim in claims)} of {len(claims)}", figures
    assert f"{len(RULES)} rules derived from" in text


def test_a_touch_of_2_n_on_either_side_leaves_best_where_it_was(responses):
    for name in ("best", "sluggish"):
        assert np.abs(responses[name].cycle[:, 1, 0]).max() < 0.05
        assert np.abs(responses[name].press_off[..., -1]).max() < 0.01


@pytest.mark.parametrize(("name", "over"), [("listed", 0.057), ("subject", 0.046), ("best", 0.002)])
def test_a_vein_that_is_squeezed_shut_overfills_the_bed_as_long_as_force_rises(name, over):
    """Slight rises of proximal readings past 1 N: what the vein pushed back into the bed drains through R_A."""
    p, time_s = parameters(name), np.linspace(0.0, 20.0, 2001)
    touch_pa = 1.5e4 * np.sin(np.pi * time_s / 20.0) ** 2
    run = respond(p, time_s, proximal_pressure_pa=touch_pa, distal_pressure_pa=0.0)
    blood, pressure_pa = run.capillary_diameter_m.values[0] ** 2, run.capillary_pressure_pa.values[0]
    assert (blood.max() - blood[0]) / (blood[1000] - blood[0]) - 1 == pytest.approx(over, abs=0.002)
    assert pressure_pa.max() > p.arterial_pressure_pa
    # Held, no touch past closure leaves a bed with more or less blood than another.
    held = steady_state(p, proximal_pressure_pa=[2e4, 3e4], distal_pressure_pa=[0.0, 0.0])
    assert held.capillary_pressure_pa == pytest.approx(p.arterial_pressure_pa, rel=1e-9)


def test_figures_set_loses_the_linearity_of_fig_11(evaluated):
    assert not next(c for c in evaluated["figures"] if c.rule.text.startswith("distal reading off its chord")).met


def test_listed_set_is_not_sluggish_at_low_force(evaluated):
    # It comes from the feedback of R_A on D_C, which is weak at the listed R_A0/R_V1 of 1.2.
    assert not next(c for c in evaluated["listed"] if c.rule.sentence.startswith("Capillaries are slower")).met


def test_every_rule_stands_for_a_sentence_and_has_a_bound():
    assert all(rule.sentence.endswith(".") and np.isfinite([rule.low, rule.high]).any() for rule in RULES)
    assert len({(rule.figure, rule.sentence, rule.text) for rule in RULES}) == len(RULES)


def test_each_touch_presses_on_the_side_of_its_figure():
    assert not steps(distal_part=0.0).touch_pa[1].any() and np.array_equal(*vars_of(steps(distal_part=1.0)))
    for touch in (cycle(), press()):
        assert not touch.touch_pa[1][0].any() and not touch.touch_pa[0][1].any()
        assert touch.touch_pa[0][0].max() == pytest.approx(touch.touch_pa[1][1].max())
    assert cycle().touch_pa[0].max() == 2 * PA_PER_N_PER_CM2
    # Three cycles of 20 s, each a sine.
    wave = 1e4 * (1.0 - np.cos(2 * np.pi * 0.05 * cycle().time_s))
    assert cycle().time_s[-1] == pytest.approx(60.0) and np.allclose(cycle().touch_pa[0][0], wave, atol=1e-6)
    # 1 N on one side is 1 N/cm^2 there.
    assert press().touch_pa[0].max() == pytest.approx(1e4, rel=1e-5)


def vars_of(touch):
    return touch.touch_pa[0], touch.touch_pa[1]


def test_distal_pulp_recovers_with_its_relaxation_time():
    time = np.linspace(0.0, 3.0, 301)
    touch = one_sided(time, np.where(time < 1.0, time, 0.0))
    after = time >= 1.0
    assert np.array_equal(touch.touch_pa[1][1][~after], touch.touch_pa[0][0][~after])
    left = touch.touch_pa[1][1][after]
    assert np.allclose(left / left[0], np.exp(-(time[after] - 1.0) / RELAXATION_S), rtol=1e-12)


def test_overshoots_and_late_changes_are_exact_on_synthetic_curves(responses):
    path = np.zeros((10, 81))
    path[:, 1:] = np.linspace(0.1, 1.0, 10)[:, None]
    back = path.max() - path
    back[-1, 3] = -0.2
    made = dataclasses.replace(responses["best"], proximal_on=np.stack([path] * 3), proximal_off=np.stack([back] * 3))
    rule = next(rule for rule in RULES if rule.text.startswith("overshoot of the vein"))
    assert rule.measure(made) == pytest.approx(0.2)
    force = CURVE_PA / PA_PER_N_PER_CM2
    bent = np.where(force <= 1.0, force, 1.0 + 0.1 * (force - 1.0))
    made = dataclasses.replace(responses["best"], cycle=np.stack([[-bent, -bent], [bent, bent]]))
    rule = next(rule for rule in RULES if rule.figure == "17" and rule.text.startswith("slope"))
    assert rule.measure(made) == pytest.approx(0.1)
    rule = next(rule for rule in RULES if rule.figure == "15" and rule.text.startswith("change"))
    assert rule.measure(made) == pytest.approx(-0.08 / 1.02)


@pytest.mark.parametrize("name", NAMES)
def test_search_measures_what_the_table_shows(name, evaluated, coarse):
    for claim in evaluated[name]:
        value = float(claim.rule.measure(coarse)[NAMES.index(name)])
        assert value == pytest.approx(claim.value, rel=0.02, abs=3e-3), claim.rule.text
    rules = [claim.rule for claim in evaluated[name]]
    coarsely = misses(coarse, rules=rules)[:, NAMES.index(name)] > 0
    assert np.array_equal(coarsely, [not claim.met for claim in evaluated[name]])


def test_simulating_many_sets_at_once_is_simulating_each():
    low, high = np.log10([bounds(factor=2.0)[name] for name in SEARCHED]).T
    points = np.random.default_rng(0).uniform(low, high, (5, len(SEARCHED))).T
    alone = [loss_of_pairs(points[:, i : i + 1])[0] for i in range(5)]
    assert np.allclose(loss_of_pairs(points), alone, rtol=1e-6)


def test_pairs_of_sets_go_through_the_coordinates_of_the_search():
    point = np.log10([np.sqrt(low * high) for low, high in (bounds()[name] for name in SEARCHED)])
    point += np.random.default_rng(1).uniform(-0.5, 0.5, point.size)
    pair = pair_of(point)
    assert logarithms_of(*pair) == pytest.approx(point)
    assert pair[0].capillary_area_m2 == pair[1].capillary_area_m2


@pytest.mark.long
def test_search_continues_from_a_given_set():
    # One generation around a good set reaches what random sets do not.
    near = search(seed=0, max_seconds=1e-3, population=6, start=(parameters("best"), parameters("best")))
    assert near.pairs == 6 and near.loss < search(seed=0, max_seconds=1e-3, population=6).loss


def test_search_refuses_no_time_and_no_population():
    with pytest.raises(InputError, match="max_seconds"):
        search(seed=0, max_seconds=0.0)
    with pytest.raises(InputError, match="population"):
        search(seed=0, population=2)


def test_table_is_plain_rows_and_readable_text(evaluated):
    rows = as_rows(evaluated)
    assert json.loads(json.dumps(rows)) == rows
    for row in rows:
        assert row["sentence"] and row["rule"] and row["number"]
        # Each of the two sets is evaluated by its own figures, all others by all.
        assert set(NAMES) - set(row["sets"]) == set(NAMES) & {"simulation", "subject"} - {row["applies_to"]}
    lines = page.lines(evaluated)
    assert all(name in lines[0] for name in NAMES)
    assert lines[-2].strip().startswith("rules met") and lines[-1].startswith("* the bound is our choice")
    ours = sum("given" not in row["number"] and "gives" not in row["number"] for row in rows)
    assert sum(" * " in line for line in lines) == ours


def time_constant_s(time_s, values, *, start_s, end_s):
    """Time from the start until 63 % of the change between start and end has come about."""
    inside = (time_s >= start_s) & (time_s <= end_s)
    done = (values[inside] - values[inside][0]) / (values[inside][-1] - values[inside][0])
    return np.interp(1.0 - np.exp(-1.0), done, time_s[inside]) - start_s


def test_subjects_force_has_their_time_constants():
    time = np.arange(0.0, 2 * ON_S, 1e-3)
    force = subject_force(time)
    assert time_constant_s(time, force, start_s=0.0, end_s=ON_S - 0.01) == pytest.approx(0.16, abs=2e-3)
    assert time_constant_s(time, force, start_s=ON_S, end_s=2 * ON_S - 0.01) == pytest.approx(0.12, abs=2e-3)


@pytest.mark.long
def test_figures_are_drawn_for_any_set(tmp_path, responses):
    for name, shown in (
        ("mine", ("10", "11", "12", "15_to_18")),
        ("simulation", ("10", "11", "12")),
        ("subject", ("15_to_18",)),
    ):
        paths = page.draw(tmp_path / "new", responses["listed"], name=name)
        assert [path.name for path in paths] == [f"hemodynamics_{name}_fig{n}.png" for n in shown]
        assert all(path.stat().st_size > 20_000 for path in paths)

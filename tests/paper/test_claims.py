"""The paper's claims: what each named set meets, that the search measures what the table shows, and that it finds."""

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest
from benchmarks.parameter_search import SEARCHED, loss, misses, search, simulate_responses_of_many

from nailoptics.errors import InputError
from nailoptics.hemodynamics import NAMES, bounds, parameters
from nailoptics.paper.claims import RULES, as_rows, as_text, judge
from nailoptics.paper.protocols import CURVE_PA, N_PER_CM2, RELAXATION_S, cycle, one_sided, press, steps, subject_force
from nailoptics.paper.responses import pressed, simulate_responses

V_P2_LEVEL = "pressure at which 95 % of V_P2's change has come"


@pytest.fixture(scope="module")
def responses():
    return {name: simulate_responses(parameters(name)) for name in NAMES}


@pytest.fixture(scope="module")
def judged(responses):
    return {name: judge(one) for name, one in responses.items()}


@pytest.fixture(scope="module")
def coarse():
    """All sets at once, as the search simulates them."""
    sets = [parameters(name).as_dict() for name in NAMES]
    return simulate_responses_of_many({field: np.array([one[field] for one in sets]) for field in sets[0]})


def missed(judged, name):
    return {(claim.rule.figure, claim.rule.text.split(",")[0]) for claim in judged[name] if not claim.met}


def test_best_set_misses_a_slow_release_and_two_features_of_v_p2(judged):
    """Fig. 10 releases slowly, Fig. 16 quickly: no set has both; "sluggish" has one, "best" all but the other."""
    v_p2 = {("12", "slope of V_P2 to 0.1 over that from 0.1 to 1 N/cm^2"), ("12", V_P2_LEVEL)}
    unloading = ("16", "proximal time constant on unloading (likewise)")
    assert missed(judged, "best") == v_p2 | {("10", "time constants"), unloading}
    assert missed(judged, "sluggish") == v_p2 | {unloading, ("11", "overshoot of the distal reading")}
    value = {name: next(c.value for c in judged[name] if c.rule.text == unloading[1]) for name in NAMES}
    assert value["best"] < 0.155 < 0.25 < value["sluggish"]


def test_best_set_meets_more_claims_than_all_others(judged):
    counts = {name: sum(claim.met for claim in claims) for name, claims in judged.items()}
    assert all(counts["best"] > counts[name] + 2 for name in ("listed", "figures", "compromise"))


def test_the_guide_tells_how_many_rules_best_meets(judged):
    text = (Path(__file__).parents[2] / "docs" / "model.md").read_text(encoding="utf-8")
    section = text[text.index("| figure, touch | rules met |") :]
    rows = [line.split("|")[1:3] for line in section.splitlines()[2:8]]
    for figures, met in rows:
        names = {"II"} if "II" in figures else set(re.findall(r"\d+", figures))
        claims = [claim for claim in judged["best"] if claim.rule.figure in names]
        assert met.strip() == f"{sum(claim.met for claim in claims)} of {len(claims)}", figures
    assert f"Of the {len(RULES)} rules `best` meets {len(RULES) - len(missed(judged, 'best'))}:" in text


def test_a_touch_of_2_n_on_either_side_leaves_best_where_it_was(responses):
    for name in ("best", "sluggish"):
        assert np.abs(responses[name].cycle[:, 1, 0]).max() < 0.05
        assert np.abs(responses[name].press_off[..., -1]).max() < 0.01


def test_figures_set_loses_the_linearity_of_fig_11(judged):
    assert not next(c for c in judged["figures"] if c.rule.text.startswith("distal reading off its chord")).met


def test_listed_set_is_not_sluggish_at_low_force(judged):
    # It comes from the feedback of R_A on D_C, which is weak at the listed R_A0/R_V1 of 1.2.
    assert not next(c for c in judged["listed"] if c.rule.sentence.startswith("Capillaries are slower")).met


def test_every_rule_stands_for_a_sentence_and_has_a_bound():
    assert all(rule.sentence.endswith(".") and np.isfinite([rule.low, rule.high]).any() for rule in RULES)
    assert len({(rule.figure, rule.sentence, rule.text) for rule in RULES}) == len(RULES)


def test_each_touch_presses_where_its_figure_says():
    assert not steps(distal_part=0.0).distal_pa.any() and np.array_equal(*vars_of(steps(distal_part=1.0)))
    for touch in (cycle(), press()):
        assert not touch.distal_pa[0].any() and not touch.proximal_pa[1].any()
        assert touch.proximal_pa[0].max() == pytest.approx(touch.distal_pa[1].max())
    assert cycle().proximal_pa.max() == 2 * N_PER_CM2
    # Three cycles of 20 s, each a sine.
    wave = 1e4 * (1.0 - np.cos(2 * np.pi * 0.05 * cycle().time_s))
    assert cycle().time_s[-1] == pytest.approx(60.0) and np.allclose(cycle().proximal_pa[0], wave, atol=1e-6)
    # 1 N on one side is 1 N/cm^2 there.
    assert press().proximal_pa.max() == pytest.approx(1e4, rel=1e-5)


def vars_of(touch):
    return touch.proximal_pa, touch.distal_pa


def test_distal_pulp_recovers_with_its_relaxation_time():
    time = np.linspace(0.0, 3.0, 301)
    touch = one_sided(time, np.where(time < 1.0, time, 0.0))
    after = time >= 1.0
    assert np.array_equal(touch.distal_pa[1][~after], touch.proximal_pa[0][~after])
    left = touch.distal_pa[1][after]
    assert np.allclose(left / left[0], np.exp(-(time[after] - 1.0) / RELAXATION_S), rtol=1e-12)


def test_overshoots_and_late_changes_are_what_they_are_on_made_up_curves(responses):
    path = np.zeros((10, 81))
    path[:, 1:] = np.linspace(0.1, 1.0, 10)[:, None]
    back = path.max() - path
    back[-1, 3] = -0.2
    made = dataclasses.replace(responses["best"], proximal_on=np.stack([path] * 3), proximal_off=np.stack([back] * 3))
    rule = next(rule for rule in RULES if rule.text.startswith("overshoot of the vein"))
    assert rule.measure(made) == pytest.approx(0.2)
    force = CURVE_PA / N_PER_CM2
    bent = np.where(force <= 1.0, force, 1.0 + 0.1 * (force - 1.0))
    made = dataclasses.replace(responses["best"], cycle=np.stack([[-bent, -bent], [bent, bent]]))
    rule = next(rule for rule in RULES if rule.figure == "17" and rule.text.startswith("slope"))
    assert rule.measure(made) == pytest.approx(0.1)
    rule = next(rule for rule in RULES if rule.figure == "15" and rule.text.startswith("change"))
    assert rule.measure(made) == pytest.approx(-0.08 / 1.02)


@pytest.mark.parametrize("name", NAMES)
def test_search_measures_what_the_table_shows(name, judged, coarse):
    for claim in judged[name]:
        value = float(claim.rule.measure(coarse)[NAMES.index(name)])
        assert value == pytest.approx(claim.value, rel=0.02, abs=3e-3), claim.rule.text
    assert np.array_equal(misses(coarse)[:, NAMES.index(name)] > 0, [not claim.met for claim in judged[name]])


def test_simulating_many_sets_at_once_is_simulating_each():
    rng = np.random.default_rng(0)
    limits = bounds(factor=2.0)
    values = {field: np.full(5, value) for field, value in parameters("listed").as_dict().items()}
    for name in SEARCHED:
        low, high = limits[name]
        values[name] = np.exp(rng.uniform(np.log(low), np.log(high), 5))
    together = loss(simulate_responses_of_many(values))
    alone = [loss(simulate_responses_of_many({k: v[i : i + 1] for k, v in values.items()}))[0] for i in range(5)]
    assert np.allclose(together, alone, rtol=1e-6)


@pytest.mark.slow
def test_a_short_search_already_beats_the_listed_set(judged):
    found = search(seed=3, max_seconds=15.0, population=40)
    assert found.met > sum(claim.met for claim in judged["listed"])
    low_high = bounds()
    assert all(low_high[name][0] <= found.parameters.as_dict()[name] <= low_high[name][1] for name in SEARCHED)


def test_search_goes_on_from_a_given_set():
    # One generation around a good set finds what random sets do not.
    near = search(seed=0, max_seconds=1e-3, population=6, start=parameters("best"))
    assert near.sets == 6 and near.loss < search(seed=0, max_seconds=1e-3, population=6).loss


def test_search_refuses_no_time_and_no_population():
    with pytest.raises(InputError, match="max_seconds"):
        search(seed=0, max_seconds=0.0)
    with pytest.raises(InputError, match="population"):
        search(seed=0, population=2)


def test_table_is_plain_rows_and_readable_text(judged):
    rows = as_rows(judged)
    assert json.loads(json.dumps(rows)) == rows
    assert set(rows[0]["sets"]) == set(NAMES)
    assert all(row["sentence"] and row["rule"] for row in rows)
    lines = as_text(judged).splitlines()
    assert all(name in lines[0] for name in NAMES)
    assert sum(line.rstrip().endswith("met") for line in lines[:-1]) == len(rows)
    assert lines[-1].strip().startswith(f"rules met of {len(rows)}")


def time_constant_s(time_s, values, *, start_s, end_s):
    """Time from the start until 63 % of the change between start and end has come about."""
    inside = (time_s >= start_s) & (time_s <= end_s)
    done = (values[inside] - values[inside][0]) / (values[inside][-1] - values[inside][0])
    return np.interp(1.0 - np.exp(-1.0), done, time_s[inside]) - start_s


def test_subjects_force_has_their_time_constants():
    time = np.arange(0.0, 6.0, 1e-3)
    force = subject_force(time, on_s=0.5, off_s=3.0)
    assert time_constant_s(time, force, start_s=0.5, end_s=2.99) == pytest.approx(0.16, abs=2e-3)
    assert time_constant_s(time, force, start_s=3.0, end_s=5.99) == pytest.approx(0.12, abs=2e-3)
    proximal, distal = pressed(parameters("best"), time, force)
    assert proximal.min() < -0.3 < 0.3 < distal.max()
    # Before the touch nothing moves.
    assert np.abs([proximal[time < 0.5], distal[time < 0.5]]).max() < 1e-3


def test_figures_are_drawn_for_any_set(tmp_path, responses):
    from nailoptics.report.pages.paper import draw

    time = np.linspace(0.0, 2.0, 201)
    force = 0.5 * (time > 1.0)
    recorded = time, force, pressed(parameters("listed"), time, force)
    paths = draw(tmp_path / "new", responses["listed"], name="mine", recorded=recorded)
    assert [path.name for path in paths] == [f"hemodynamics_mine_fig{n}.png" for n in (10, 11, 12, 15, 16, 17, 18)]
    assert all(path.stat().st_size > 20_000 for path in paths)

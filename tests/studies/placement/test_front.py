"""The Pareto front of a placement: the best photodiodes of each number by half of the light, evaluated by the other."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from layout_scores import score_layout
from small_scenes import PLACEMENT

from nailoptics.scene import FingerCase, parse_scene
from nailoptics.studies.placement import boards, candidates, certificate, place, search
from nailoptics.studies.placement.objective import Objective

from .test_place import photon_map_cache

RULES = "photodiodes = 3\nphotodiode_step_mm = 2.0\nclearance_mm = 0.5\n"


@pytest.mark.jit
def test_the_best_of_each_number_is_chosen_by_one_half_and_evaluated_by_the_other(jit_backend, monkeypatch):
    """Expected: of all pairs on the grid that is taken which is best by the first half of the photons, and what is
    returned is its error by the second half; no photon is traced. Without waves more power lowers it, by no more than
    in proportion; a power beyond the LED's largest current is left out."""
    text = PLACEMENT[: PLACEMENT.index("[placement]")] + f"[placement]\n{RULES}"
    requested = parse_scene(text.replace("[blood]", "[electronics]\nfeedback_ohm = 1e6\n[blood]"))
    rules, base = boards.rules(requested), boards.base_board(requested)
    condition = place.finger_condition(base, FingerCase(name="one"), rules)
    cache, objective = photon_map_cache([condition], seed=4, stream=1, blocks=16), Objective(rules, [condition.point])
    pd = requested.photodiodes[0]
    driven = base.leds[0].model_copy(update={"current_ma": 20.0, "max_current_ma": 50.0, "price": 1.5})
    drawn = base.model_copy(
        update={
            "leds": (driven,),
            "photodiodes": tuple(
                pd.model_copy(update={"name": f"p{v}", "position_mm": (1.0, v), "price": 0.25}) for v in (-2.0, 2.0)
            ),
        }
    )
    layout = candidates.candidate("mine", drawn, "given")
    cache.extend(layout.board, 1 << 17)
    before, chosen = cache.photons, []
    original = candidates.searched

    def spied(*given, **how):
        chosen.append([area.center_mm for area in given[3]])
        return original(*given, **how)

    monkeypatch.setattr(candidates, "searched", spied)
    data = certificate.pareto_front(layout, cache, objective)
    assert cache.photons == before and data.front_photodiodes.values.tolist() == [2, 4]
    assert data.front_price.values == pytest.approx([2.0, 2.5])
    assert data.led_power_mw.values == pytest.approx(np.array([1 / 64, 1 / 8, 1]) * driven.flux_mw)
    areas = search.Search(base, objective, cache).sites.photodiode_places(layout.scene.layout.barriers, {}).areas
    first, second = (cache.on_fingers(part) for part in (slice(None, 8), slice(8, None)))

    def score(pair, light):
        scene = original(base, rules, [drawn.layout.leds[0].center_mm], pair, wall=("left", 0.4), name="pair")
        return float(score_layout(replace(layout, scene=scene), light, objective).ranked[0])

    def far_apart(a, b):
        return any(abs(p - q) >= s + 0.5 - 1e-9 for p, q, s in zip(a.center_mm, b.center_mm, pd.size_mm, strict=True))

    best = min((pair for pair in combinations(areas, 2) if far_apart(*pair)), key=lambda pair: score(pair, first))
    assert {area.center_mm for area in best} == {*chosen[0]}
    assert float(data.front_error[0, 2]) == pytest.approx(score(best, second), rel=1e-9)
    assert score(best, second) != pytest.approx(score(best, first), rel=1e-3)
    steps = data.led_power_mw.values[1:] / data.led_power_mw.values[:-1]
    gains = data.front_error.values[:, :-1] / data.front_error.values[:, 1:]
    assert (gains > 1).all() and (gains < steps).all() and (data.front_error_stderr > 0).all()
    # The cheapest is on the front, and what is better than every cheaper point by more than 2 %.
    error, on_front = data.front_error.values, data.on_front.values
    for i, j in np.ndindex(error.shape):
        cheaper = [error[k, m] for k in range(i + 1) for m in range(j + 1) if (k, m) != (i, j)]
        assert on_front[i, j] == all(one > 1.02 * error[i, j] for one in cheaper)
    assert on_front[0].all() and on_front[1].any()
    # Whose current may be four times as large shines four times as bright.
    stronger = layout.scene.model_copy(update={"leds": (driven.model_copy(update={"max_current_ma": 80.0}),)})
    monkeypatch.setattr(certificate, "COUNTS", (2,))
    front = certificate.pareto_front(replace(layout, scene=stronger), cache, objective)
    assert front.led_power_mw.values == pytest.approx(np.append(data.led_power_mw, 4.0 * driven.flux_mw))
    brighter, *as_before = front.front_error.values[0, ::-1]
    assert as_before == pytest.approx(error[0, ::-1]) and 1 < as_before[0] / brighter < 4

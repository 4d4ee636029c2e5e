"""Of layouts that tie, the simplest is proposed: in rows, symmetric, on a grid; and seeds agree on it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from small_scenes import PLACEMENT, TWO_LAYOUTS

from nailoptics import place
from nailoptics.assets import data_dir
from nailoptics.errors import InputError, as_far_as_reached
from nailoptics.light.tracing import StageProgress
from nailoptics.report.pages.placement import _tied, _warnings
from nailoptics.scene import Candidate, FingerCase, load_scene, parse_scene
from nailoptics.scene.rectangles import Rectangle
from nailoptics.sensor import information
from nailoptics.sensor.information import PhysiologicalNoise
from nailoptics.statistics import jackknife, leave_one_out
from nailoptics.studies.placement import boards, candidates, objective, result, search
from nailoptics.studies.placement.photon_maps import FingerCondition
from nailoptics.studies.placement.sites import PhotodiodePlaces

from .test_place import AT
from .test_search import MadeLight

SEARCHED = PLACEMENT.replace("search = false\nphotodiodes = 4", "photodiodes = 4\nled_step_mm = 3.0")


class NoisyLight(MadeLight):
    """The same with the noise of few photons."""

    def __init__(self, conditions, seed, noise):
        super().__init__(conditions)
        self.rng, self.noise = np.random.default_rng(seed), noise

    def extend(self, board, photons, led=0):
        super().extend(board, photons, led)
        sums = self.traced_board(board).maps[0][led].sums
        sums *= 1 + self.noise * self.rng.standard_normal(sums.shape)


def layouts_of(scene, seed, noise=0.0):
    """What a search by noisy light proposes to evaluate."""
    rules = boards.rules(scene)
    cache = NoisyLight([FingerCondition(FingerCase(name="one"), AT)], seed, noise)
    base = boards.searchable_board(boards.base_board(scene), rules)
    one = search.Search(base, objective.Objective(rules, [AT]), cache)
    computed = one.run(StageProgress(None))
    return search.shortlist(base, rules, [*computed, *one.regular])


def places_of(layout):
    return sorted(area.center_mm for area in (*layout.layout.leds, *layout.layout.photodiode_areas))


@pytest.mark.parametrize("middle_mm", [0.0, 0.125])
@pytest.mark.parametrize("axis", [0, 1])
def test_places_in_rows_are_symmetric_and_evenly_spaced(axis, middle_mm):
    """Expected: of a grid every choice has the middle for its own and even rows; without a place beside it none takes
    that."""
    centers = [(0.25 * i, 0.25 * j) for i in range(9) for j in range(-8, 9)]
    areas = tuple(Rectangle.around("", center[:: -1 if axis else 1], (0.2, 0.2)) for center in centers)
    places, allowed = PhotodiodePlaces(areas, (), len(areas), (0.3, 0.3)), np.ones(len(areas), bool)
    allowed[7] = False
    every = places.in_rows(4, axis, middle_mm, 0.25, allowed)
    assert any(places.is_straight(chosen) for chosen in every) and not all(places.is_straight(c) for c in every)
    for chosen in every:
        assert len(set(chosen)) == 4 and 7 not in chosen
        at = places.centers_mm[chosen][:, [axis, 1 - axis]]
        image = {tuple(x) for x in np.round(at * [1, -1] + [0, 2 * middle_mm], 6)}
        assert image == {tuple(x) for x in np.round(at, 6)}
        for line in at.T:
            assert np.ptp(np.diff(np.unique(np.round(line, 6)))) < 1e-6 if len(np.unique(line)) > 1 else True
        apart = np.abs(at[:, None] - at).max(2)[~np.eye(4, dtype=bool)]
        assert apart.min() >= 0.3 - 1e-9


def test_an_led_beside_the_grid_has_no_regular_photodiodes():
    text = SEARCHED.replace("position_mm = [-3.0, 0.0]", "position_mm = [-3.0, 0.07]")
    layouts = layouts_of(parse_scene(text.replace("led_step_mm = 3.0", 'fixed = ["ir"]')), 0)
    assert layouts and not any(layout.name.endswith(("row", "rows")) for layout in layouts)


def test_the_simplest_has_fewest_parts_then_rows_then_a_mirror_image_then_a_grid():
    base = boards.base_board(parse_scene(TWO_LAYOUTS))

    def complexity(*photodiodes):
        plan = Candidate(name="one", leds_mm=[[-3.0, 0.0]], photodiodes_mm=photodiodes)
        return candidates.candidate("one", candidates.candidate_scene(base, plan), "given").complexity

    row = complexity((1.0, -1.0), (1.0, 0.0), (1.0, 1.0))
    off_grid, askew = complexity((1.1, -1.0), (1.1, 0.0), (1.1, 1.0)), complexity((1.0, -1.0), (1.0, 0.0), (1.0, 2.0))
    rows, fewer = complexity((1.0, -1.0), (1.0, 1.0), (2.5, 0.0)), complexity((1.1, -1.0), (2.2, 1.3))
    assert fewer < row < off_grid < askew < rows


@pytest.mark.parametrize("floor_n", [0.0, 0.03])
def test_the_error_of_a_resolution_is_that_of_what_lies_above_the_bodys_own(floor_n):
    """Expected: of blocks that scatter by a percent about 0.04 N the jackknife of the whole, to first order."""
    blocks = 0.04 * np.exp(0.01 * np.random.default_rng(2).standard_normal((20, 3)))
    whole_n = np.hypot(leave_one_out(blocks), floor_n)
    assert objective.resolution_stderr_n(whole_n, floor_n) == pytest.approx(jackknife(whole_n), rel=0.01)


def score(value, blocks):
    """Of a layout, from the blocks' departures from its value."""
    replicates = value * (1 + np.append(0.0, blocks / (len(blocks) - 1)))
    return objective.LayoutScore(*[None] * 6, None, replicates)


def test_ties_are_by_the_difference_in_which_shared_noise_cancels():
    """Layouts 5 % apart with errors of 10 % that they share are distinguished; with errors of their own they tie, and
    so do layouts 1 % apart without error, and 3 % apart with an error of 1 %; 3 % apart, and exact, do not."""
    shared, own = 0.4 * np.random.default_rng(0).standard_normal((2, 16))
    assert objective.ties([score(1.05, shared), score(1.0, shared)]).tolist() == [False, True]
    assert objective.ties([score(1.05, own), score(1.0, shared)]).tolist() == [True, True]
    assert objective.ties([score(1.0, 0 * own), score(1.01, 0 * own)]).tolist() == [True, True]
    assert objective.ties([score(1.0, 0 * own), score(1.03, 0.1 * own)]).tolist() == [True, True]
    assert objective.ties([score(1.0, 0 * own), score(1.03, 0 * own)]).tolist() == [True, False]


def test_the_simplest_of_those_that_tie_within_four_percent_comes_first(monkeypatch):
    """Expected: of four layouts that their noise lets tie not the best nor the simplest, which is 4.1 % worse."""
    layouts = [
        SimpleNamespace(
            scene=SimpleNamespace(layout=SimpleNamespace(photodiode_areas=[])), board=k, complexity=(parts,)
        )
        for k, parts in enumerate((9, 2, 3, 4))
    ]
    noise = np.random.default_rng(0).normal(size=(4, 16))
    scores = [score(value, noise[k]) for k, value in enumerate((1.0, 1.041, 1.039, 1.01))]
    cache = SimpleNamespace(
        traced_board=lambda board: SimpleNamespace(areas=[], photons=1), read=lambda scene, board, points: scores[board]
    )
    monkeypatch.setattr(objective, "_extend", lambda *_: True)
    monkeypatch.setattr(objective, "scores_of", lambda read, _: read)
    how = {"objective": SimpleNamespace(points=[None]), "relative_error": 0.01, "report_progress": StageProgress(None)}
    ranked, of_ranked, unmet = objective.score_layouts(layouts, cache, photons=1, **how)
    assert [layout.board for layout in ranked] == [2, 0, 3, 1] and of_ranked[0] is scores[2]
    assert unmet is None


def test_layouts_of_which_none_resolves_anything_are_refused_in_a_line():
    """Expected: a layout that resolves nothing never ties with one that does; if all resolve nothing, advice."""

    def score(value):
        return objective.LayoutScore(*[None] * 6, None, np.full(9, value))

    assert objective.ties([score(np.inf), score(1.0), score(np.inf)]).tolist() == [False, True, False]
    with pytest.raises(InputError, match=r"placement: no layout resolves .*; trace more photons, or set") as error:
        objective.ties([score(np.inf), score(np.inf)])
    assert len(str(error.value).splitlines()) == 1


def test_a_search_by_the_filters_error_counts_a_part_of_the_waves():
    """Expected: one sample in which waves count by a part is one at a touch whose body has so much less of them; other
    aims have them whole."""
    blood, left = np.array([[2e-3, 1e-3], [1e-3, 3e-3]]), 0.05
    body = PhysiologicalNoise(blood, led_gain=np.array([[3e-3]]), reading_gain=1e-3)
    whole, less = (replace(AT, body=replace(body, blood=part * blood)) for part in (1.0, left))
    scene, rng = parse_scene(TWO_LAYOUTS), np.random.default_rng(0)
    values = np.abs(rng.normal([1e-4, 0.0, -2e-4, -1e-4], [3e-5, 1e-9, 5e-5, 5e-5], (6, 4))) * [1, 0, -1, -1]
    totals = [information.fisher_information(response(scene, values, at)).sum(0)[None] for at in (whole, less)]
    rules = boards.rules(scene).model_copy(update={"rank_by": "force"})
    search_by = objective.Objective(rules, [whole], waves_left=left)
    assert search_by.value("force", totals[0]) == pytest.approx(search_by.value("worst", totals[1]), rel=1e-9)
    assert search_by.value("worst", totals[0]) > 1.1 * search_by.value("force", totals[0])


def response(scene, values, at):
    return information.response(values, scene, 0, scene.photodiodes[0], at)


def test_the_page_states_how_many_tie():
    rows = [{"layout": name, "rank": rank} for name, rank in (("a", 1), ("b", 1), ("c", 1), ("d", 4))]
    assert _tied(rows).startswith("Proposed: a, the simplest of those worse than the best by less than twice 2 %.")
    assert "3 layouts tie (rank 1)" in _tied(rows) and "Another seed" in _tied(rows)
    assert _tied([rows[0], rows[3]]) == "No other ties with the first."


def test_a_layout_of_which_a_reading_may_be_saturated_is_named():
    """Expected: by the least probability of all readings to be below the limit, on page and terminal; else nothing."""

    def score(*unsaturated):
        one, none = np.ones((9, 2)), np.zeros((9, 2))
        read = information.Response(one, one, none, none, none, unsaturated=np.array(unsaturated), light_v=one)
        return objective.LayoutScore(*[None] * 4, [[read]], None, None, None)

    layouts = [SimpleNamespace(scene=parse_scene(TWO_LAYOUTS))] * 3
    known = result._extremes(layouts, [score(1.0, 1.0), score(1.0, 0.9), score(0.0, 1.0)])
    assert known["may_saturate"][1].tolist() == [False, True, True]
    data = xr.Dataset(known | {"predicted_volts": ("x", [1.0]), "predicted_volts_stderr": ("x", [0.1])})
    (line,) = _warnings(data.assign_coords(layout=["a", "b", "c"]))
    assert line.startswith("A reading may lie at the converter's limit") and ": b, c. The stated errors" in line
    assert not _warnings(data.assign_coords(layout=["a", "b", "c"]).isel(layout=[0]))


def test_the_signal_to_noise_is_that_of_the_leds_light():
    """Expected: dark current and light from outside are in the amplifier's output, and in no signal."""
    one, none = np.ones((9, 2)), np.zeros((9, 2))
    read = information.Response(5 * one, 0.01 * one, none, none, none, light_v=2 * one)
    score = objective.LayoutScore(*[None] * 4, [[read]], None, None, None)
    known = result._extremes([SimpleNamespace(scene=parse_scene(TWO_LAYOUTS))], [score])
    assert known["least_volts"][1] == known["most_volts"][1] == [5.0] and known["least_snr"][1] == pytest.approx([20.0])


@pytest.mark.long
def test_seeds_agree_on_the_simplest_of_what_ties():
    """Expected: with noise by which freely searched layouts differ, the same row beside the same LED is proposed."""
    scene, simplest, best = parse_scene(SEARCHED), [], []
    for seed in range(4):
        layouts = layouts_of(scene, seed, noise=0.02)
        best.append(places_of(layouts[0].scene))
        rows = [layout for layout in layouts if layout.name.endswith(" row")]
        simplest.append(places_of(min(rows, key=lambda layout: layout.complexity).scene))
    assert all(np.allclose(simplest[0], other, atol=0.25) for other in simplest[1:])
    assert not all(np.allclose(best[0], other, atol=0.25) for other in best[1:])


@pytest.mark.slow
def test_seeds_propose_one_layout_of_the_shipped_scene_or_report_a_tie(chosen_jit, store):
    """Expected: the proposals of three seeds are the same, every part within 0.25 mm, or each reports a tie."""
    scene, computed = load_scene(data_dir("scenes") / "placement.toml"), []
    for seed in (1, 2, 3):
        computed.append(as_far_as_reached(place, scene, seed=seed, max_seconds=3000.0)[0])
    proposed = [places_of(result.chosen(one)) for one in computed]
    same = all(np.allclose(proposed[0], other, atol=0.25) for other in proposed[1:])
    assert same or all(one.tied.values.sum() > 1 for one in computed)

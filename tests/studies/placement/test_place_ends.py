"""A placement that is interrupted or out of time: it ends within a batch, and what it has by then is reported."""

import itertools

import pytest
from small_scenes import TWO_LAYOUTS as SCENE

from nailoptics.errors import NotReachedError
from nailoptics.light.board_map import BoardTracer
from nailoptics.light.tracing import StageProgress
from nailoptics.report.pages.placement import PLACEMENT
from nailoptics.scene import FingerCase, Scene, parse_scene
from nailoptics.studies.placement import boards, place, search, verification
from nailoptics.studies.placement.objective import JUDGE_PHOTONS
from nailoptics.studies.placement.photon_maps import PhotonMapCache, TracedBoard


@pytest.fixture(scope="module")
def scene() -> Scene:
    return parse_scene(SCENE)


@pytest.mark.slow
def test_an_interrupt_leaves_the_ranking_as_far_as_it_is(chosen_jit, scene):
    """Ctrl-C comes out of the progress callback; what is traced by then is evaluated, verified and reported."""

    def interrupting(progress):
        if progress.led == "evaluate":
            raise KeyboardInterrupt

    with pytest.raises(NotReachedError, match="^interrupted: 3 of 3 layouts traced") as caught:
        place.place(scene, relative_error=1e-4, progress=interrupting)
    assert caught.value.result.sizes["layout"] == 3 and "checked_fraction" not in caught.value.result


@pytest.mark.slow
def test_an_interrupt_of_the_search_leaves_its_best_after_one_batch_more(chosen_jit, tmp_path):
    """Expected: no site of the LED is begun after Ctrl-C, and the best so far is evaluated by one batch of its own."""
    requested = parse_scene(SCENE[: SCENE.index("[placement]")] + "[placement]\nphotodiodes = 2\n")
    reports = []

    def interrupting(progress):
        reports.append(progress)
        raise KeyboardInterrupt

    with pytest.raises(NotReachedError, match="^interrupted: 1 of .* layouts traced") as caught:
        place.place(requested, progress=interrupting)
    computed = caught.value.result
    assert len(reports) == 1 and computed.sizes["led_site"] == 1 and computed.sizes["layout"] == 1
    assert str(computed.origin.values[0]) == "searched"
    assert computed.attrs["photons"] == search.FIRST_PHOTONS + JUDGE_PHOTONS
    PLACEMENT.write(computed, tmp_path)
    head = (tmp_path / "place.html").read_text(encoding="utf-8").split("</header>")[0]
    assert "The layout with ir at (" in head and str(computed.layout.values[0]) not in head


@pytest.mark.slow
@pytest.mark.parametrize("last", [3, verification.LEAST_BATCHES + 1])
def test_verification_of_the_best_layout_ends_within_a_batch(chosen_jit, scene, monkeypatch, last):
    """Expected: no batch begins once there is no time, nor light from outside through another cover, and what was
    traced of the check is not reported."""
    layout = place.given(boards.base_board(scene), boards.rules(scene))[0]
    conditions = [place.finger_condition(layout.scene, FingerCase(name="one"), boards.rules(scene))]
    cache = PhotonMapCache(conditions, seed=0, stream=1, backend="auto", blocks=1)
    monkeypatch.setattr(TracedBoard, "photons", JUDGE_PHOTONS)
    calls, batches, traced = itertools.count(), [], BoardTracer.detected
    monkeypatch.setattr(BoardTracer, "detected", lambda *at, **how: batches.append(1) or traced(*at, **how))
    cache.stop = lambda: next(calls) >= last
    assert not verification.verify_layout(layout, cache, max_seconds=1.0)
    assert len(batches) <= last


@pytest.mark.slow
def test_a_time_limit_returns_the_layouts_traced_and_is_reported(chosen_jit, scene, tmp_path, monkeypatch):
    """Every reading of the clock takes a second: the given layouts' board has light by then, the paper's has not."""
    clock = itertools.count()
    monkeypatch.setattr(StageProgress, "seconds", property(lambda _: next(clock)))
    with pytest.raises(NotReachedError, match="^max_seconds ended with 2 of 3 layouts traced") as caught:
        place.place(scene, max_seconds=5)
    computed = caught.value.result
    assert set(computed.layout.values) == {"near", "far"} and computed.attrs["cut_off"] == str(caught.value)
    assert "checked_fraction" not in computed and computed.attrs["photons"] == JUDGE_PHOTONS
    PLACEMENT.write(computed, tmp_path)
    head = (tmp_path / "place.html").read_text(encoding="utf-8").split("</header>")[0]
    assert "max_seconds ended with 2 of 3 layouts traced" in head
    best = (tmp_path / "best.toml").read_text()
    assert best.startswith("# Cut off: max_seconds ended") and "max_seconds =" not in best


@pytest.mark.slow
def test_listed_layouts_and_the_best_are_evaluated_after_a_long_search(chosen_jit, monkeypatch):
    clock = itertools.count()
    monkeypatch.setattr(StageProgress, "seconds", property(lambda _: next(clock)))
    searched = parse_scene(SCENE.replace("search = false", "search = true"))
    with pytest.raises(NotReachedError, match="^max_seconds ended") as caught:
        place.place(searched, max_seconds=60)
    result = caught.value.result
    assert {"near", "far"} < set(result.layout.values) and "searched" in result.origin.values


def test_no_time_at_all_is_one_line(chosen_jit, scene):
    with pytest.raises(NotReachedError, match="before one layout was traced") as caught:
        place.place(scene, max_seconds=1e-9)
    assert caught.value.result is None

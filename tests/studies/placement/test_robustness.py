"""The ranking of layouts over the priors of the finger."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from layout_scores import score_layout

from nailoptics import load_scene
from nailoptics.assets import data_dir
from nailoptics.report.uncertainty_section import spread_section, spread_summary
from nailoptics.scene import Body, Breathing, Candidate, Placement, Priors
from nailoptics.scene.priors import PriorRange
from nailoptics.studies.placement import boards, candidates
from nailoptics.studies.placement.objective import Objective
from nailoptics.studies.placement.photon_maps import PhotonMapCache
from nailoptics.studies.placement.place import finger_condition
from nailoptics.studies.placement.robustness import resolution_over_priors
from nailoptics.studies.prior_uncertainty import at_value, nodes_of

pytestmark = pytest.mark.slow
FIELDS = ("finger.plate_absorption", "finger.bed_absorption", "finger.bed_scattering")


@pytest.fixture(scope="module")
def ranked(chosen_jit):
    """Two layouts, photodiodes near the LED and far from it, and their resolution over three priors.

    Of a body that is still: the false force by waves of its pressure is the same on every finger and hides the rest.
    """
    scene = load_scene(data_dir("scenes") / "placement.toml")
    known = tuple(one.field for one in scene.priors.of_finger() if one.field not in FIELDS)
    rules = Placement(photodiodes=2, search=True)
    scene = scene.model_copy(update={"placement": rules, "priors": Priors(known=known), "body": None})
    base = boards.base_board(scene)
    places = {"near": ((0.5, -1.5), (0.5, 1.5)), "far": ((2.5, -3.5), (2.5, 3.5))}
    layouts = [
        candidates.candidate(one.name, candidates.candidate_scene(base, one), "given")
        for one in (
            Candidate(name=name, leds_mm=((-2.0, 0.0),), photodiodes_mm=where) for name, where in places.items()
        )
    ]
    conditions = [finger_condition(base, case, rules) for case in boards.fingers(scene)]
    photon_maps = PhotonMapCache(conditions, seed=1, stream=1, backend="auto", blocks=16)
    for layout in layouts:
        photon_maps.traced_board(layout.board).areas.extend(layout.scene.layout.photodiode_areas)
    # One board, whose light is traced once for both.
    photon_maps.extend(layouts[0].board, 1 << 19)
    result = resolution_over_priors(layouts, rules, photon_maps)
    return base, rules, layouts, photon_maps, result.assign_coords(layout=list(places))


def test_the_ranking_covers_every_prior_that_only_absorbs(ranked):
    base, *_, result = ranked
    how = dict(zip(result.prior_field.values.tolist(), result.prior_how.values.tolist(), strict=True))
    assert how == {FIELDS[0]: "reweighted", FIELDS[1]: "reweighted", FIELDS[2]: "not traced"}
    assert (result.resolution_spread > 3 * result.resolution_spread_stderr).all()
    # More absorption makes resolution coarser, at every layout, and most where light comes from far.
    nodes = result.resolution_at_node_n.values[:2]
    assert (np.diff(nodes, axis=1) > 0).all() and (np.diff(nodes[..., 1] / nodes[..., 0], axis=1) > 0).all()
    # So both act alike, and their correlation adds to, or subtracts from, their squares.
    priors = [next(one for one in base.priors.of_finger() if one.field == field) for field in FIELDS[:2]]
    alone = result.prior_resolution_spread.values[:2]
    total = np.sqrt(np.einsum("il,ij,jl->l", alone, base.priors.correlation(priors), alone))
    assert total == pytest.approx(result.resolution_spread.values, rel=0.05)
    ahead = int((nodes[..., 0] <= nodes[..., 1]).sum())
    assert int(result.nodes) == 6 and int(result.best_stays_best_at) == ahead and int(result.best_surely_beaten_at) == 0


def test_a_node_has_the_resolution_of_a_placement_on_that_finger(ranked):
    """Rationale: the same layout evaluated on a finger that has the node's value, by photons of its own."""
    base, rules, layouts, photon_maps, result = ranked
    prior = next(one for one in base.priors.of_finger() if one.field == FIELDS[0])
    clear = at_value(base, prior.field, nodes_of(prior)[0])
    layout = candidates.candidate("near", at_value(layouts[0].scene, prior.field, nodes_of(prior)[0]), "given")
    cache = PhotonMapCache(
        [finger_condition(clear, photon_maps.cases[0], rules)], seed=9, stream=1, backend="auto", blocks=16
    )
    cache.extend(layout.board, 1 << 19)
    score = score_layout(layout, cache, Objective(rules, [one.point for one in cache.conditions]))
    resolution_n = float(result.resolution_at_node_n[0, 0, 0])
    # Of half a million photons behind a node its score is about as precise as this one's.
    assert abs(np.log(resolution_n / score.force.all_n[0])) < 4 * np.sqrt(2) * score.relative_error
    assert score.relative_error < 0.1


def test_robust_conclusions_are_reported_in_words_and_on_the_page(ranked):
    *_, result = ranked
    lines = spread_summary(result)["conclusions"]
    times = int(result.best_stays_best_at)
    assert f"near has the finest resolution of one sample at {times} of 6 values" in lines[0]
    assert "none of them" in lines[0]
    assert "most with bloodless bed absorption" in lines[1]
    assert "bed scattering" in lines[-1] and "own_traces" in lines[-1]
    assert "Uncertainty over the priors" in spread_section(result)


def test_out_of_time_only_complete_readings_are_reported(ranked, monkeypatch):
    """Expected: all fingers of one digit share their light; the second layout is not begun."""
    _, rules, layouts, photon_maps, _ = ranked
    checks = itertools.count()
    monkeypatch.setattr(photon_maps, "stop", lambda: next(checks) >= 1)
    result = resolution_over_priors(layouts, rules, photon_maps)
    assert np.isfinite(result.resolution_spread.values).tolist() == [True, False]
    calls = next(checks)
    assert calls == 2
    monkeypatch.setattr(photon_maps, "stop", lambda: True)
    assert not resolution_over_priors(layouts, rules, photon_maps)


def test_a_prior_of_scattering_is_traced_by_itself(ranked):
    """Expected: a bed of almost the same scattering is estimated by photons of its own, and as the usual one."""
    _, rules, layouts, photon_maps, _ = ranked
    scatters = next(one for one in layouts[0].board.priors.of_finger() if one.field == FIELDS[2])
    middle = float(np.sqrt(scatters.low * scatters.high))
    own = PriorRange(field=scatters.field, low=0.98 * middle, high=1.02 * middle)
    priors = layouts[0].board.priors.model_copy(update={"own_traces": True, "ranges": (own,)})
    layout = replace(layouts[0], board=layouts[0].board.model_copy(update={"priors": priors}))
    photon_maps.traced_board(layout.board).areas.extend(layout.scene.layout.photodiode_areas)
    photon_maps.extend(layout.board, 1 << 19)
    result = resolution_over_priors([layout], rules, photon_maps)
    retraced = result.isel(prior=result.prior_field.values.tolist().index(FIELDS[2]), layout=0)
    score = score_layout(layout, photon_maps, Objective(rules, [one.point for one in photon_maps.conditions]))
    assert str(retraced.prior_how.values) == "retraced"
    nodes = retraced.resolution_at_node_n.values
    assert len(set(nodes)) > 1 and score.relative_error < 0.1
    assert np.abs(np.log(nodes / score.force.all_n[0])).max() < 4 * np.sqrt(2) * score.relative_error


def test_priors_of_the_bodys_waves_spread_the_resolution(ranked):
    """Expected: with breathing between the ends of its prior the false force by it is proportional to its amplitude."""
    _, rules, layouts, photon_maps, _ = ranked
    board = layouts[0].board.model_copy(update={"body": Body(breathing=Breathing())})
    waves = board.priors.of_body(board.body)
    known = tuple(one.field for one in Priors().of_finger())
    layout = replace(layouts[0], board=board.model_copy(update={"priors": Priors(known=known)}))
    photon_maps.traced_board(layout.board).areas.extend(layout.scene.layout.photodiode_areas)
    photon_maps.extend(layout.board, 1 << 18)
    result = resolution_over_priors([layout], rules, photon_maps)
    assert result.prior_field.values.tolist() == [one.field for one in waves] == ["body.breathing.amplitude_pa"]
    nodes = result.resolution_at_node_n.values[0, :, 0]
    assert np.all(np.diff(nodes) > 0) and nodes[2] > 1.5 * nodes[0]

"""What a scene models and leaves out: which effects are found to matter, and how sure that is."""

import json

import numpy as np
import pytest

from nailoptics import cli, load_scene
from nailoptics.assets import data_dir
from nailoptics.errors import InputError
from nailoptics.scene import Scene, parse_scene
from nailoptics.studies import derived
from nailoptics.studies.effects import Effect
from nailoptics.studies.explain import explain
from nailoptics.studies.variants import look, reread, without_lines


def prototype() -> Scene:
    return load_scene(data_dir("scenes") / "prototype.toml")


@pytest.fixture(scope="module")
def found(chosen_jit):
    return explain(prototype(), photons=200_000, seed=3)


@pytest.mark.slow
@pytest.mark.jit
def test_the_barrier_matters_and_the_lines_width_does_not(found):
    by_name = {e.name: e for e in found.effects}
    barrier, width = by_name["barrier"], by_name["LED line width"]
    assert barrier.matters == "yes" and barrier.change > 1 and barrier.modelled
    assert width.matters == "no" and width.how == "reread" and 0 < width.bound < 0.01
    assert by_name["melanin"].matters == "no"
    assert by_name["ambient light"].modelled is False and by_name["ambient light"].bound > 0


@pytest.mark.slow
@pytest.mark.jit
def test_the_far_finger_returns_less_than_1e_4_of_a_reading(found):
    ends = [e for e in found.effects if e.name.startswith(("finger past", "beyond the cut"))]
    assert len(ends) == 2 and all(0 < e.bound < 1e-4 for e in ends)


@pytest.mark.slow
@pytest.mark.jit
def test_what_is_not_needed_is_told_as_scene_lines_that_make_a_scene(found):
    line = next(line for line in str(found).splitlines() if line.startswith("Not needed"))
    assert "finger.melanin_fraction = 0.0" in line and "barrier" not in line
    text = (data_dir("scenes") / "prototype.toml").read_text(encoding="utf-8")
    assert parse_scene(text.replace('digit = "index"', 'digit = "index"\nmelanin_fraction = 0.0')).finger


@pytest.mark.jit
def test_rereading_is_what_tracing_with_the_same_photons_would_give(jit_backend):
    """Rationale: what only dims light needs no new trace. Expected: the two agree within the error of the second."""
    scene = prototype()
    base, _ = look(scene, seed=1, backend="auto", photons=200_000)
    again = reread(base.transfer, without_lines(scene))
    other, _ = look(without_lines(scene), seed=1, backend="auto", photons=200_000)
    # The same walks: only the line's width, which the trace does not know, differs.
    assert np.allclose(again.level, other.level, rtol=1e-6)
    assert np.abs(again.level / base.level - 1).max() < 0.01


def test_swapping_source_and_photodiode_keeps_the_board():
    scene = prototype()
    swapped = derived.swapped_scene(scene)
    from nailoptics.scene.layout import lay_out

    one, two = lay_out(scene), lay_out(swapped)
    assert two.outline.center_mm == pytest.approx(one.outline.center_mm)
    assert two.photodiodes[0].area.center_mm == pytest.approx(one.leds[0].center_mm)
    assert min(abs(two.leds[0].center_mm[1] - e.area.center_mm[1]) for e in one.photodiodes) < 1e-9


@pytest.mark.parametrize(
    ("change", "stderr", "bound", "matters"),
    [(0.10, 0.01, 0.12, "yes"), (0.01, 0.003, 0.016, "no"), (0.04, 0.01, 0.06, "cannot tell"), (0.0, 0.0, 0.0, "no")],
)
def test_an_effect_matters_only_if_that_is_sure(change, stderr, bound, matters):
    values = {"change": change, "stderr": stderr, "bound": bound, "typical": change, "typical_stderr": stderr}
    effect = Effect(
        "x", True, "y", "retraced", photodiode="p", modulation_bound=None, lines="", tolerance=0.02, **values
    )
    assert effect.matters == matters


def test_what_cannot_be_explained_is_one_line():
    phantom = load_scene(data_dir("scenes") / "phantom.toml")
    with pytest.raises(InputError, match="finger"):
        explain(phantom)
    with pytest.raises(InputError, match="tolerance"):
        explain(prototype(), tolerance=2.0)


@pytest.mark.slow
@pytest.mark.jit
def test_the_command_prints_one_json_object(jit_backend, capsys):
    assert cli.run(["explain", "prototype", "--json", "--photons", "20000"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert {"effects", "tolerance", "photons"} <= printed.keys() and len(printed["effects"]) >= 10
    assert all(row["matters"] in ("yes", "no", "cannot tell") for row in printed["effects"])

"""Error against cost of every level of model: what is measured, what counts as proven, what is chosen."""

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from nailoptics import cli, load_scene
from nailoptics.assets import data_dir
from nailoptics.errors import InputError, NotReachedError
from nailoptics.report import tradeoff_page
from nailoptics.scene import Scene, parse_scene
from nailoptics.studies.model_error import levels, paired
from nailoptics.studies.model_error import tradeoff as study
from nailoptics.studies.model_error.levels import OWN, REFERENCE, Bias, Level
from nailoptics.studies.model_error.tradeoff import Tradeoff, tradeoff
from nailoptics.studies.model_error.variants import changes_between, lines_of


def prototype() -> Scene:
    return load_scene(data_dir("scenes") / "prototype.toml")


def level(name: str, **changes: Any) -> Level:
    values: dict[str, Any] = {
        "backend": "llvm",
        "changes": {},
        "reading": Bias(0.0, 0.0, 0.0),
        "signal": None,
        "cpu_seconds": (10.0, 111.0, 1000.0),
    }
    values |= {"reweight_seconds": None, "memory_mb": 1.0, "setup_seconds": 1.0}
    return Level(name=name, **(values | {"proven": True} | changes))


def test_costs_grow_with_the_square_of_the_accuracy():
    assert levels._cost(2.0, 0.05) == pytest.approx((50.0, 50.0 / 0.09, 5000.0))


def test_few_dim_photons_do_not_pass_for_a_sure_small_reading():
    """Rationale: a level seen by few photons reads low more often than high, with an error that looks small.
    Expected: its error is at least the relative one of both, whatever it reads."""
    error = paired.error_of_ratio(np.array([-0.99, 0.0, 1.0]), np.full(3, 0.01), np.full(3, 0.5))
    assert np.allclose(error, np.hypot(0.01, 0.5) * np.array([1, 1, 2]))


def test_the_picture_and_the_front_know_what_is_cheap_and_near():
    every = (
        level("far", reading=Bias(0.2, 0.01, 0.0), cpu_seconds=(1.0, 11.0, 100.0), proven=False),
        level("worse", reading=Bias(0.3, 0.0, 0.0), cpu_seconds=(2.0, 22.0, 200.0), proven=False),
        level("near", reading=Bias(0.01, 0.0, 0.0), cpu_seconds=(3.0, 33.0, 300.0), signal=Bias(0.03, 0.01, 0.1)),
        level("unseen", reading=Bias(math.nan, math.inf, 0.0), cpu_seconds=(math.inf,) * 3, proven=False),
        level(REFERENCE, cpu_seconds=(9.0, 100.0, 900.0)),
    )
    made = {"scene": "", "digest": "", "photons": 1}
    found = Tradeoff(every, 0.02, "near", prototype(), None, {1000: 1.0}, 1.0, made)
    assert [one.name for one in found.front] == ["far", "near", REFERENCE]
    left, right = tradeoff_page.draw(found).axes
    # Four names at the left; at the right the one level whose signal is known, and the tolerance.
    assert len(left.texts) == 4 and [text.get_text() for text in right.texts] == ["near", "tolerance 2 %"]
    assert found.choice.name == "near" and "near" in str(found) and found.as_dict()["chosen"] == "near"


def test_the_full_model_is_chosen_unless_another_is_cheaper_beyond_the_noise_of_cost():
    full = level(REFERENCE, cpu_seconds=(10.0, 100.0, 1000.0))
    near, cheap, wrong = (
        level(n, cpu_seconds=(c, 0.0, 0.0)) for n, c in (("near", 9.5), ("cheap", 5.0), ("wrong", 1.0))
    )
    wrong = replace(wrong, proven=False)
    assert study._cheapest([wrong, near, full]) is full
    assert study._cheapest([wrong, cheap, near, full]) is cheap
    # What the scene is already, if that is proven, comes before a change that saves nothing.
    own = level(OWN, cpu_seconds=(10.5, 0.0, 0.0))
    assert study._cheapest([wrong, full, own]) is own
    assert study._cheapest([wrong, full, replace(own, proven=False)]) is full


@pytest.fixture(scope="module")
def found(chosen_jit):
    patch = pytest.MonkeyPatch()
    stock = level("stock Mitsuba, llvm", cpu_seconds=(1e5, 1e6, 1e7), proven=False)
    patch.setattr(levels, "_stock", lambda *_: stock)
    patch.setattr(levels.Bench, "batches", lambda *_: {})
    try:
        return tradeoff(prototype(), photons=40_000, tolerance=0.02)
    finally:
        patch.undo()


@pytest.mark.jit
def test_a_proven_level_is_within_the_tolerance_and_the_full_one_always_is(found):
    by_name = {one.name: one for one in found.levels}
    assert {REFERENCE, "one wavelength", "similarity", "matched indices", "Taylor (9)"} <= by_name.keys()
    full = by_name[REFERENCE]
    assert (
        full.proven and by_name["one wavelength"].proven and by_name["one wavelength"].cpu_seconds == full.cpu_seconds
    )
    formulas = ("Taylor (9)", "Beer-Lambert (8)")
    assert all(one.reading.bound <= 0.02 for one in found.levels if one.proven and one.name not in formulas)
    # A formula takes its reading at rest from the trace; it has to prove its signal.
    for name in formulas:
        one = by_name[name]
        assert one.signal.bound > 0 and one.proven == (one.signal.bound <= 0.02)
        assert one.reweight_seconds < by_name[REFERENCE].reweight_seconds
    # Without forward scattering there is a tenth of the scatterings: the walk is cheaper, and wrong.
    similar = by_name["similarity"]
    assert not similar.proven and similar.cpu_seconds[0] < full.cpu_seconds[0]
    # Photons that never meet epidermis or Kapton are the same: the error is a part of what two traces apart would have.
    assert by_name["no epidermis, no Kapton"].reading.stderr < 0.7 * by_name["matched indices"].reading.stderr
    assert found.choice.cpu_seconds[0] <= full.cpu_seconds[0]


@pytest.mark.jit
def test_the_lines_of_every_level_make_its_scene(found):
    """Expected: pasted under their tables in the scene file, they select the level."""
    text = (data_dir("scenes") / "prototype.toml").read_text(encoding="utf-8")
    places = {"[light]": "[light]", "[[leds]]": "[[leds]]"}
    for one in found.levels:
        pasted = text
        for line in lines_of(one.changes):
            table, field = line.split(" ", 1)
            name = field.split()[-1] if field.startswith("without") else field.split(" = ")[0]
            kept = [t for t in pasted.splitlines() if not t.startswith(f"{name} =")]
            pasted = "\n".join(kept) + "\n"
            if not field.startswith("without"):
                start = next(t for t in kept if t.startswith(places[table]))
                pasted = pasted.replace(start, f"{start}\n{field}", 1)
        scene = parse_scene(pasted)
        assert changes_between(prototype(), scene) == one.changes, one.name
        if one.name == found.chosen:
            assert scene.light == found.scene.light and scene.leds == found.scene.leds


def test_what_has_no_levels_is_one_line():
    with pytest.raises(InputError, match="finger"):
        tradeoff(load_scene(data_dir("scenes") / "phantom.toml"))
    with pytest.raises(InputError, match="tolerance"):
        tradeoff(prototype(), tolerance=0.0)


@pytest.mark.jit
def test_an_interrupt_keeps_the_levels_that_were_measured(jit_backend):
    def stop(p):
        if "trace 2 " in p.led:
            raise KeyboardInterrupt

    with pytest.raises(NotReachedError, match="interrupted") as caught:
        tradeoff(prototype(), photons=8192, progress=stop)
    result = caught.value.result
    assert isinstance(result, Tradeoff)
    assert {REFERENCE, "Taylor (9)"} <= {one.name for one in result.levels} and result.choice.proven
    assert "similarity" not in {one.name for one in result.levels}


@pytest.mark.jit
def test_a_photodiode_that_saw_nothing_is_one_line(jit_backend):
    with pytest.raises(NotReachedError, match="none reached photodiode") as caught:
        tradeoff(prototype(), photons=100)
    assert caught.value.result is None and len(str(caught.value).splitlines()) == 1


@pytest.mark.slow
@pytest.mark.jit
def test_the_command_writes_table_page_and_picture(jit_backend, tmp_path, capsys):
    assert cli.run(["tradeoff", "prototype", "-o", str(tmp_path), "--json", "--max-seconds", "40"]) == 0
    printed = json.loads(capsys.readouterr().out)
    names = {row["name"] for row in printed["levels"]}
    assert {REFERENCE, "stock Mitsuba, scalar"} <= names and printed["chosen"] in names
    assert sum(row["front"] for row in printed["levels"]) >= 1 and len(printed["batches"]) == 3
    assert load_scene(tmp_path / "scene.toml").finger is not None
    assert json.loads((tmp_path / "tradeoff.json").read_text())["chosen"] == printed["chosen"]
    assert (tmp_path / "tradeoff.png").stat().st_size > 10_000
    assert "<svg" in (tmp_path / "tradeoff.html").read_text(encoding="utf-8")

"""Error against cost of every level of model: what is measured, what counts as proven, what is chosen."""

import json
import math

import numpy as np
import pytest

from nailoptics import cli, load_scene
from nailoptics.assets import data_dir
from nailoptics.errors import InputError
from nailoptics.report import tradeoff_page
from nailoptics.scene import Scene
from nailoptics.studies import tradeoff as study
from nailoptics.studies import variants
from nailoptics.studies.tradeoff import Level, Tradeoff, tradeoff


def prototype() -> Scene:
    return load_scene(data_dir("scenes") / "prototype.toml")


def level(name: str, **changes) -> Level:
    values = {"backend": "llvm", "lines": "", "bias": 0.0, "bias_stderr": 0.0, "bias_bound": 0.0, "signal_bias": None}
    values |= {"signal_bias_stderr": None, "cpu_seconds": (10.0, 111.0, 1000.0), "memory_mb": 1.0, "setup_seconds": 1.0}
    return Level(name=name, **(values | {"proven": True} | changes))


def test_costs_grow_with_the_square_of_the_accuracy():
    assert study._cost(2.0, 0.05) == pytest.approx((50.0, 50.0 / 0.09, 5000.0))


def test_few_dim_photons_do_not_pass_for_a_sure_small_reading():
    """Rationale: a level seen by few photons reads low more often than high, with an error that looks small.
    Expected: its error is at least the relative one of both, whatever it reads."""
    error = variants.error_of_ratio(np.array([-0.99, 0.0, 1.0]), np.full(3, 0.01), np.full(3, 0.5))
    assert np.allclose(error, np.hypot(0.01, 0.5) * np.array([1, 1, 2]))


def test_the_picture_and_the_front_know_what_is_cheap_and_near():
    levels = (
        level("far", bias=0.2, bias_stderr=0.01, cpu_seconds=(1.0, 11.0, 100.0), proven=False),
        level("worse", bias=0.3, cpu_seconds=(2.0, 22.0, 200.0), proven=False),
        level("near", bias=0.01, cpu_seconds=(3.0, 33.0, 300.0)),
        level("unseen", bias=math.nan, bias_stderr=math.inf, cpu_seconds=(math.inf,) * 3, proven=False),
        level("reference", cpu_seconds=(9.0, 100.0, 900.0)),
    )
    found = Tradeoff(levels, 0.02, "near", math.nan, {1000: 1.0}, 1.0, {"scene": "", "digest": "", "photons": 1})
    assert [one.name for one in tradeoff_page._front(levels)] == ["far", "near", "reference"]
    assert len(tradeoff_page.draw(found).axes[0].texts) == 5
    assert found.choice.name == "near" and "near" in str(found) and found.as_dict()["chosen"] == "near"


@pytest.mark.jit
def test_a_proven_level_is_within_the_tolerance_and_the_reference_always_is(jit_backend, monkeypatch):
    monkeypatch.setattr(
        study, "_stock", lambda *_: level("stock Mitsuba, llvm", cpu_seconds=(1e5, 1e6, 1e7), proven=False)
    )
    monkeypatch.setattr(study, "_batches", lambda *_: {})
    found = tradeoff(prototype(), photons=60_000, tolerance=0.02)
    by_name = {one.name: one for one in found.levels}
    assert {"reference", "one wavelength", "similarity", "matched indices", "Taylor (9)"} <= by_name.keys()
    assert by_name["reference"].proven and by_name["one wavelength"].proven
    assert all(one.bias_bound <= 0.02 for one in found.levels if one.proven)
    # Without forward scattering there is a tenth of the scatterings; the walk is cheaper, and wrong by some 10 %.
    similar = by_name["similarity"]
    assert not similar.proven and similar.cpu_seconds[0] < by_name["reference"].cpu_seconds[0]
    assert abs(similar.bias + 0.1) < 4 * similar.bias_stderr
    assert found.choice.cpu_seconds[0] <= by_name["reference"].cpu_seconds[0]


def test_what_has_no_levels_is_one_line():
    with pytest.raises(InputError, match="finger"):
        tradeoff(load_scene(data_dir("scenes") / "phantom.toml"))
    with pytest.raises(InputError, match="tolerance"):
        tradeoff(prototype(), tolerance=0.0)


@pytest.mark.slow
@pytest.mark.jit
def test_the_command_writes_table_page_and_picture(jit_backend, tmp_path, capsys):
    assert cli.run(["tradeoff", "prototype", "-o", str(tmp_path), "--json", "--max-seconds", "40"]) == 0
    printed = json.loads(capsys.readouterr().out)
    names = {row["name"] for row in printed["levels"]}
    assert {"reference", "stock Mitsuba, scalar"} <= names and printed["chosen"] in names
    assert json.loads((tmp_path / "tradeoff.json").read_text())["chosen"] == printed["chosen"]
    assert (tmp_path / "tradeoff.png").stat().st_size > 10_000
    assert "<svg" in (tmp_path / "tradeoff.html").read_text(encoding="utf-8")

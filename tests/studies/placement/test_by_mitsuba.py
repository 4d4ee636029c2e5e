"""The best layout read by stock Mitsuba: it agrees with the photons engine, and detects what is wrong."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from small_scenes import TWO_LAYOUTS

import nailoptics as nail
from nailoptics.cli import run
from nailoptics.errors import InputError, NotReachedError
from nailoptics.light.reference import readings as stock
from nailoptics.light.reference.readings import StateReadings
from nailoptics.options import TraceOptions
from nailoptics.report.pages.placement import PLACEMENT
from nailoptics.scene import FingerCase, parse_scene
from nailoptics.studies.placement import boards, place, verification

SCENE = parse_scene(TWO_LAYOUTS)


def fresh(scene, blood_fraction, *, photons=1 << 19):
    """Light on each photodiode by the photons engine, as a fresh trace has it."""
    at = nail.trace(scene, photons=photons, seed=1).at(blood_fraction=blood_fraction)
    names = {"detected_fraction": "checked_fraction", "detected_fraction_stderr": "checked_fraction_stderr"}
    return at[list(names)].rename(names | {"photodiode": "best_photodiode"})


@pytest.mark.jit
@pytest.mark.parametrize(
    "paths", [pytest.param(1 << 12, marks=pytest.mark.long), pytest.param(1 << 17, marks=pytest.mark.slow)]
)
def test_stock_mitsuba_agrees_and_detects_a_wrong_layout_and_medium(jit_backend, store, monkeypatch, paths):
    """Expected: all within 4 standard errors; with the LED 0.5 mm further away, or ten times the blood, beyond 4.

    Batches that are traced once serve all three. A tenth of the light on these photodiodes comes through their sides.
    Few paths resolve neither, but a reading by another geometry, unit or photodiode.
    """
    monkeypatch.setattr(verification, "MITSUBA_PATHS", paths)
    few = paths < 1 << 17
    layout = place.given(boards.base_board(SCENE), boards.rules(SCENE))[0].scene
    condition = place.finger_condition(layout, FingerCase(name="one"), boards.rules(SCENE))
    scene, blood = boards.worn_on(layout, condition.case), condition.point.blood_fraction
    led = scene.leds[0].model_copy(update={"position_mm": (-3.5, 0.0)})
    options, traced = TraceOptions(seed=2), []
    batch = stock.Paths.batch
    monkeypatch.setattr(stock.Paths, "batch", lambda *at, **how: traced.append(1) or batch(*at, **how))

    def compared(verified):
        return verification.verify_by_mitsuba(layout, condition, verified, options, None)

    agreeing = compared(fresh(scene, blood, photons=1 << 17 if few else 1 << 19))
    assert agreeing.mitsuba_ratio.shape == (1, 4)
    assert bool((abs(agreeing.mitsuba_z) < 4).all()) and abs(float(agreeing.mitsuba_led_z[0])) < 4
    assert len(traced) == 32 and float(agreeing.mitsuba_led_ratio_stderr[0]) < 0.2
    if few:
        return
    assert bool((agreeing.mitsuba_ratio_stderr < 0.15).all())
    moved = compared(fresh(scene.model_copy(update={"leds": (led,)}), blood))
    redder = compared(fresh(scene, 10 * blood))
    assert float(moved.mitsuba_led_z[0]) > 4 and float(redder.mitsuba_led_z[0]) > 4
    assert len(traced) == 32


def readings(scene, factor, *, interrupted=False):
    """What stock Mitsuba may report of light of 1e-3 on each photodiode."""
    count = len(scene.layout.photodiode_names)
    fraction, one = np.full((count, 1), factor * 1e-3), np.ones((count, 1))
    return [StateReadings(fraction, 0.02 * fraction, one, 0 * one, 1 << 20, None, interrupted)]


@pytest.mark.parametrize(("factor", "z"), [(1.0, 0.0), (1.1, 0.1 / 1.1 / np.hypot(0.02, 0.01))])
def test_ratios_and_their_z_are_those_of_the_readings(monkeypatch, factor, z):
    """Values by hand; the error of the sum of four alike is half of theirs."""
    monkeypatch.setattr(verification, "read_leds", lambda scene, *_: readings(scene, factor))
    layout = place.given(boards.base_board(SCENE), boards.rules(SCENE))[0].scene
    condition = place.finger_condition(layout, FingerCase(name="one"), boards.rules(SCENE))
    pair = ("led", "best_photodiode")
    verified = xr.Dataset({"checked_fraction": (pair, np.full((1, 4), 1e-3))})
    verified["checked_fraction_stderr"] = 0.01 * verified.checked_fraction
    computed = verification.verify_by_mitsuba(layout, condition, verified, TraceOptions(), None)
    assert np.allclose(computed.mitsuba_ratio, factor) and np.allclose(computed.mitsuba_z, z)
    assert np.allclose(computed.mitsuba_ratio_stderr, factor * np.hypot(0.02, 0.01))
    assert np.allclose(computed.mitsuba_led_ratio, factor) and np.allclose(computed.mitsuba_led_z, 2 * z)


@pytest.mark.long
def test_page_and_terminal_state_the_ratio_and_an_interrupt(
    chosen_jit, fewer_photons, untraced_tolerances, undrawn, monkeypatch, tmp_path
):
    quiet = SCENE.with_(**{"priors.spread": False})

    def placed(**how):
        monkeypatch.setattr(verification, "read_leds", lambda scene, *_: readings(scene, 2.0, **how))
        with fewer_photons():
            return place.place(quiet, photons=1 << 15, seed=1, verify_with_mitsuba=True)

    computed = placed()
    PLACEMENT.write(computed, tmp_path)
    page, lines = (tmp_path / "place.html").read_text(), PLACEMENT.lines(computed, PLACEMENT.summary(computed))
    words = f"({float(computed.mitsuba_led_z[0]):+.1f}) for LED ir"
    assert words in page and any(words in line for line in lines) and "Mitsuba / trace (z)" in page
    with pytest.raises(NotReachedError, match="interrupted before the best layout was read by stock Mitsuba") as caught:
        placed(interrupted=True)
    assert "mitsuba_ratio" not in caught.value.result and "checked_fraction" in caught.value.result


def test_what_stock_mitsuba_cannot_read_is_refused_before_the_search(chosen_jit, tmp_path, capsys):
    measured = 'pattern = "measured"\npattern_deg = [0, 90]\npattern_relative = [1, 0]\n'
    path = tmp_path / "scene.toml"
    path.write_text(TWO_LAYOUTS.replace('part = "led_800"\n', f'part = "led_800"\n{measured}'))
    assert run(["place", str(path), "--verify-with-mitsuba", "-o", str(tmp_path / "out")]) == 2
    assert "needs the photons engine" in capsys.readouterr().err and not (tmp_path / "out" / "place.nc").exists()


def test_a_backend_that_does_not_compile_volpath_is_refused(chosen_jit, monkeypatch):
    scalar = replace(chosen_jit, name="scalar", library=None)
    monkeypatch.setattr(verification.backends, "choose", lambda *_, **__: scalar)
    with pytest.raises(InputError, match="compiles volpath"):
        verification.check_mitsuba([SCENE], "auto")

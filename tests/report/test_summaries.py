"""What commands print: the numbers of the page, and saturated readings by their name."""

import numpy as np
import pytest
from hostile_names import HOSTILE, assert_text_alone

from nailoptics.report.pages.force import CALIBRATION
from nailoptics.report.readings import hold_end, photodiode_readings, simulation_lines, simulation_summary
from nailoptics.report.scene_description import body_words, check_lines
from nailoptics.report.uncertainty_section import spread_section, spread_summary
from nailoptics.scene import load_scene


def test_the_terminal_and_the_page_have_one_definition_of_a_change(make):
    result = make(leds=2, section=False)
    # A peak after the touch, which the end of the hold does not include.
    result.volts_change[..., -1] = 1.0
    rows = simulation_summary(result)["readings"]
    assert [row["volts_change"] for row in rows] == [*photodiode_readings(result).volts_change]
    assert {row["volts_change_peak"] for row in rows} == {1.0}
    assert {row["time_of_peak_s"] for row in rows} == {float(result.time[-1])}
    hold = hold_end(result)
    assert {row["time_of_change_s"] for row in rows} == {float(result.time[hold])}
    assert result.force_n[hold] == 1 and result.force_n[hold + 1] == 0
    lines = simulation_lines(result, simulation_summary(result))
    at_s = f"{float(result.time[hold]):.3g} s"
    assert f"to the last under the largest force, at {at_s}" in lines[-1] and "+1.00" in lines[1]
    assert lines[-1].endswith("NEF: noise-equivalent force, noise over slope") and lines[0].endswith("NEF [mN]")


def test_saturated_readings_are_marked(make):
    result = make(section=False)
    result.saturated[0, 2, 5] = True
    summary = simulation_summary(result)
    assert [row["saturated"] for row in summary["readings"]] == list(np.arange(8) == 2)
    lines = simulation_lines(result, summary)
    assert "proximal.12 saturated" in lines[3] and lines[-1].startswith("saturated: the converter")
    assert sum("saturated" in line for line in lines) == 2


def with_priors(result, offset):
    """The result with the spread of one prior: the eighth photodiode varies most."""
    pair, spread = ("led", "photodiode"), 0.1 * np.arange(1, 9)[None]
    data = {f"{kind}_{end}": (pair, spread) for kind in ("reading", "change", "signal") for end in ("spread", "shift")}
    data |= {f"{kind}_spread_stderr": (pair, 0.1 * spread) for kind in ("reading", "change")}
    data |= {
        f"prior_{kind}_spread{end}": (("prior", *pair), spread[None])
        for kind in ("reading", "change")
        for end in ("", "_stderr")
    }
    data |= {
        "keeps_sign": (pair, np.arange(8)[None] < 3),
        "prior_offset": ("prior", [offset]),
        "prior_range": (("prior", "end"), [[0.5, 2.0]]),
    }
    data |= {f"prior_{name}": ("prior", [name]) for name in ("field", "how", "source")}
    return result.assign(data).assign_coords(prior=["plate absorption"])


def test_the_prior_uncertainty_states_the_signs_that_hold_and_what_it_omits(make):
    """Expected: of eight readings, of which the first is saturated, the signs that hold are counted; the shift of a
    scene that is not at its priors' mean is reported."""
    result = make(section=False)
    result.saturated[0, 0, 5] = True
    lines = spread_summary(with_priors(result, 0.0))["conclusions"]
    assert any(
        "sign of the change holds" in line and "at 2 of 7 readings; at the others it may" in line for line in lines
    )
    assert lines[-1].startswith("Not among these priors: how contact") and not any("shifted" in line for line in lines)
    (line,) = [one for one in spread_summary(with_priors(make(section=False), -1.3))["conclusions"] if "shifted" in one]
    assert "(plate absorption)" in line and "+10 % to +80 %" in line


def test_the_priors_with_most_effect_on_readings_and_on_changes_are_named(make):
    line = spread_summary(with_priors(make(section=False), 0.0))["conclusions"][0]
    assert "(one standard deviation), most by plate absorption, and changes by" in line
    assert line.endswith("most by plate absorption.")


def test_an_effect_that_is_not_resolved_is_named_and_none_is_a_zero(make):
    """Expected: a standard deviation below its error has no row but is named; one of rounding is 0."""
    result = with_priors(make(section=False), 0.0)
    given = {"reading_spread": 6e-7, "reading_spread_stderr": 4e-8, "change_spread": 0.0, "change_spread_stderr": 0.0}
    result = result.assign({f"prior_{name}": 0 * result[f"prior_{name}"] + value for name, value in given.items()})
    assert "(6." not in spread_section(result) and "is not known" not in spread_section(result)
    result["prior_change_spread"] += 0.01
    result["prior_change_spread_stderr"] += 0.02
    assert "so that it is not known: plate absorption;" in spread_section(result)


@pytest.mark.parametrize("name", HOSTILE)
@pytest.mark.parametrize("field", ["prior", "prior_source"])
def test_a_prior_with_a_hostile_name_is_text(make, name, field):
    result = with_priors(make(section=False), 0.0)
    result[field] = result[field].dims, np.array([name])
    assert_text_alone(spread_section(result), name)


def test_a_saturated_reading_has_no_prior_uncertainty(make):
    result = with_priors(make(section=False), 0.0)
    assert "10-80 %" in spread_summary(result)["conclusions"][0]
    result.saturated[0, 7, 5] = True
    assert "10-70 %" in spread_summary(result)["conclusions"][0]
    result.saturated[:] = True
    assert spread_summary(result)["conclusions"] == []


def test_slow_waves_are_called_mayer_waves():
    assert body_words(load_scene("heartbeat")).endswith("breathing, 15 a minute, Mayer waves")


def test_the_error_of_a_calibration_and_its_interval_are_of_the_same_touches():
    scores = {"rms_n": 0.059, "coverage_95": 0.96, "half_width_n": 0.11}
    (line,) = CALIBRATION.lines(None, {"is_held_out": True, "quality": {"all": scores}})
    which, how = line.split(": ")
    assert which == "held-out touches of 0.15 N or more"
    assert how == "rms error 59 mN, 96% inside their 95 % interval, half width 110 mN (median)"


def test_a_check_is_reported_in_sentences():
    led = {
        "name": "ir",
        "part": "led_800",
        "wavelength_nm": 800.0,
        "fwhm_nm": 33.0,
        "flux_mw": 2.0,
        "position_mm": [1, 2],
    }
    lines = check_lines({"scene": "phantom", "valid": True, "leds": [led]})
    assert lines == [
        "phantom: the scene is valid",
        "LED ir (led_800): 800 nm, 33 nm wide, 2 mW, at (1, 2) mm",
    ]
    pair = {"led": "ir", "photodiode": "a", "distance_mm": 1.5, "volts": 0.25}
    pair |= {"volts_stderr": 0.01, "feedback_ohm": 1e6, "noise_v": {"shot": 2e-6}}
    diode = {"name": "a", "position_mm": [0.5, -2.0], "size_mm": [1.0, 0.25], "rotation_deg": 90.0}
    computed = {"photodiodes": [diode], "not_wired": 2, "board_mm": [2.825, 9.0]}
    lit = {"led": "ir", "nail_w_per_m2": 400.0, "eye_w_per_m2": 0.01, "light_j": 1e-6, "charge_c": None}
    computed |= {"pairs": [pair], "warnings": ["hot"], "noise": "shot noise limits", "exposure": [lit]}
    computed |= {"ignored": {"x.kicad_pcb": [f"R{i}" for i in range(9)]}}
    computed |= {"candidates": [{"name": "mine", "leds": 1, "photodiodes": 4}]}
    lines = check_lines({"scene": "mine", "valid": True, "leds": [led]} | computed)
    assert "photodiodes: 1, and 2 that are not wired, on a board of 2.83 x 9 mm" in lines
    assert [line.split() for line in lines if "(0.5, -2)" in line] == [
        ["ir", "a", "(0.5,", "-2)", "1", "x", "0.25", "90", "1.50", "1", "0.250", "+-", "0.010"]
    ]
    computed["pairs"] = [pair | {"volts_stderr": float("nan")}]
    assert "0.250 +- ?" in "\n".join(check_lines({"scene": "mine", "valid": True, "leds": [led]} | computed))
    assert "noise: shot noise limits" in lines and any("400 W/m^2 below ir" in line for line in lines)
    assert lines[-1] == "warning: hot"
    assert "layout mine: 1 LEDs, 4 photodiodes" in lines
    assert "ignored: 9 parts of x.kicad_pcb (R0, R1, R2, R3, R4, R5, R6, R7, ...)" in lines
    shape = {"regions": ["air", "plate"], "triangles": 12}
    assert "12 triangles between the air and plate" in check_lines({"scene": "mine", "valid": True} | shape)[-1]

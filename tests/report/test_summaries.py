"""What commands print: the numbers of the page, and saturated readings by their name."""

import numpy as np

from nailoptics.report.readings import hold_end, photodiode_readings
from nailoptics.report.summaries import check_lines, simulation_lines, simulation_summary


def test_the_terminal_and_the_page_have_one_definition_of_a_change(make):
    result = make(leds=2, section=False)
    # A peak after the touch, which the end of the hold does not see.
    result.volts_change[..., -1] = 1.0
    rows = simulation_summary(result)["readings"]
    assert [row["volts_change"] for row in rows] == [r.change_v for r in photodiode_readings(result, None)]
    assert {row["volts_change_peak"] for row in rows} == {1.0}
    assert {row["time_of_peak_s"] for row in rows} == {float(result.time[-1])}
    hold = hold_end(result)
    assert {row["time_of_change_s"] for row in rows} == {float(result.time[hold])}
    assert result.force_n[hold] == 1 and result.force_n[hold + 1] == 0
    assert f"to the end of the hold, at {float(result.time[hold]):.3g} s" in simulation_lines({"readings": rows})[-1]
    assert "1000.000" in simulation_lines({"readings": rows})[1]


def test_saturated_readings_are_marked(make):
    result = make(section=False)
    result.saturated[0, 2, 5] = True
    summary = simulation_summary(result)
    assert [row["saturated"] for row in summary["readings"]] == list(np.arange(8) == 2)
    lines = simulation_lines(summary)
    assert "saturated" in lines[3] and "proximal.12" in lines[3]
    assert sum("saturated" in line for line in lines) == 1


def test_a_check_is_reported_in_sentences():
    assert check_lines({"scene": "phantom", "valid": True}) == ["phantom: fields, parts and layout are valid"]
    found = {"regions": ["air", "plate"], "triangles": 12, "crossings": 70, "disagreements": 0, "volume_error": 1e-15}
    first, second, third = check_lines({"scene": "mine", "valid": True, "vessels": "listed"} | found)
    assert "listed" in first and "12 triangles between the air and plate" in second
    assert third.startswith("closed: yes; of 70 times")

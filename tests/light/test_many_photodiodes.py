"""A thousand photodiodes on one nail: each photon is counted where it ends, whatever the number of its region."""

import numpy as np
import pytest

import nailoptics as nail
from nailoptics.scene import parse_scene

BOARD = """schema_version = 1
[finger]
[board]
barrier = false
[[leds]]
name = "ir"
part = "led_800"
position_mm = [-4.0, 0.0]
"""


def rows_of(elements: int, pitch_mm: float) -> str:
    each = (
        f'[[photodiodes]]\nname = "p{i}"\nposition_mm = [{-3.4 + 0.2 * i:.2f}, 0.0]\nelements = {elements}\n'
        f"size_mm = [0.15, {pitch_mm}]\npitch_mm = {pitch_mm}\n"
        for i in range(32)
    )
    return BOARD + "".join(each)


@pytest.mark.slow
@pytest.mark.jit
def test_a_thousand_elements_read_what_the_few_read_that_they_make_up(jit_backend):
    """32 columns of 32 elements without gaps, and the same columns as one photodiode each."""
    fine, coarse = (
        nail.trace(parse_scene(rows_of(n, mm)), photons=100_000, seed=seed).at().squeeze("led")
        for n, mm, seed in ((32, 0.25, 1), (1, 8.0, 2))
    )
    assert fine.sizes["photodiode"] == 1024 and coarse.sizes["photodiode"] == 32
    columns = fine.detected_fraction.values.reshape(32, 32).sum(1)
    error = np.sqrt(
        (fine.detected_fraction_stderr.values.reshape(32, 32) ** 2).sum(1) + coarse.detected_fraction_stderr**2
    )
    z = (columns - coarse.detected_fraction) / error
    assert float((z**2).sum()) < 32 + 4 * np.sqrt(64) and float(coarse.detected_fraction.min()) > 0

"""A thousand photodiodes on one nail: each photon is counted where it ends, whatever the number of its region."""

import numpy as np
import pytest
from small_scenes import columns_of_photodiodes

import nailoptics as nail
from nailoptics.scene import parse_scene


@pytest.mark.slow
@pytest.mark.jit
def test_a_thousand_elements_read_what_the_few_read_that_they_make_up(jit_backend):
    """32 columns of 32 elements without gaps, and the same columns as one photodiode each."""
    fine, coarse = (
        nail.trace(parse_scene(columns_of_photodiodes(n, mm, mm)), photons=100_000, seed=seed).at().squeeze("led")
        for n, mm, seed in ((32, 0.25, 1), (1, 8.0, 2))
    )
    assert fine.sizes["photodiode"] == 1024 and coarse.sizes["photodiode"] == 32
    columns = fine.detected_fraction.values.reshape(32, 32).sum(1)
    error = np.sqrt(
        (fine.detected_fraction_stderr.values.reshape(32, 32) ** 2).sum(1) + coarse.detected_fraction_stderr**2
    )
    z = (columns - coarse.detected_fraction) / error
    assert float((z**2).sum()) < 32 + 4 * np.sqrt(64) and float(coarse.detected_fraction.min()) > 0

"""Photons split near a photodiode: the same readings, paths and energy as plain walks, with less noise."""

import numpy as np
import pytest

from nailoptics import geometry
from nailoptics.assets import data_dir
from nailoptics.light.splitting import CELL_MM, REACH_MM, near_photodiodes
from nailoptics.scene import load_scene
from nailoptics.statistics import stderr_of_mean


@pytest.fixture(scope="module")
def prototype():
    return load_scene(data_dir("scenes") / "prototype.toml")


def test_cells_within_reach_are_those_and_no_others(prototype):
    finger = geometry.build(prototype)
    near, low = near_photodiodes(finger)
    plans = [np.asarray(face.quads).reshape(-1, 3)[:, :2] for face in finger.photodiodes]
    middle = np.mean(plans[0], axis=0)
    across, along = np.floor((middle - low) / CELL_MM).astype(int)
    assert near[across, along]
    width = plans[0][:, 0].max() - plans[0][:, 0].min()
    assert near[:, along].sum() * CELL_MM == pytest.approx(width + 2 * REACH_MM, abs=2 * CELL_MM)
    assert not near[0, 0], "the corner of the box is farther from any photodiode than its sides"


@pytest.mark.jit
def test_split_photons_read_what_plain_ones_read(jit_backend, prototype):
    """Light, and light times its path in plate and bed, on all photodiodes; and a split photon must tell more.

    chi^2 of 24 dependent values: 60 is one in more than 1e4 even of 24 independent ones.
    """
    from nailoptics.light.finger_walk import FingerTracer
    from nailoptics.light.surroundings import DETECTED

    tracer = FingerTracer(prototype)
    photons, count = 1 << 19, len(tracer.photodiodes)
    split = tracer.batch(0, photons=photons, seed=2026_11_21)
    walked = tracer.walk(0, photons=photons, seed=1911_05_03)
    ended = np.flatnonzero(walked.outcome >= DETECTED)
    plain = walked.outcome[ended] - DETECTED, walked.weight[ended], tracer.by_zone(walked.path_mm[:, ended])
    found = []
    for photodiode, light, path in ((split.photodiode, split.weight, split.path_mm), plain):
        scores = np.stack([light, light * path[:, 0], light * path[:, 1:3].sum(1)])
        sums, squares = (np.stack([np.bincount(photodiode, s**k, minlength=count) for s in scores]) for k in (1, 2))
        found.append((sums / photons, stderr_of_mean(sums, squares, photons)))
    (ours, error), (other, more) = found
    assert np.sum((ours - other) ** 2 / (error**2 + more**2)) < 60
    assert np.all(error[0] / ours[0] < 0.8 * more[0] / other[0])
    energy = {part: total / photons for part, (total, _) in split.energy.items()}
    assert sum(energy.values()) == pytest.approx(1, abs=1e-9) and abs(energy["lost"]) < 1e-5

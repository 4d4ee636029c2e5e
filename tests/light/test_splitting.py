"""Photons split near a photodiode: the same readings, paths and energy as plain walks, with less noise."""

from types import SimpleNamespace

import numpy as np
import pytest

from nailoptics import geometry
from nailoptics.assets import data_dir
from nailoptics.light.walk.splitting import (
    CELL_MM,
    LEAST_DISTANCE_MM,
    MOST_STRIDES,
    REACH_MM,
    STRIDE_CELL_MM,
    STRIDE_MM,
    Splitting,
    near_photodiodes,
    strides_made,
)
from nailoptics.scene import load_scene
from nailoptics.statistics import stderr_of_mean


@pytest.fixture(scope="module")
def prototype():
    return load_scene(data_dir("scenes") / "prototype.toml")


def test_cells_hold_the_distance_and_height_of_the_nearest_photodiode(prototype):
    finger = geometry.build(prototype)
    away, height, low = near_photodiodes(finger)
    corners = [np.asarray(face.quads).reshape(-1, 3) for face in finger.photodiodes]
    middle = corners[0].mean(axis=0)
    across, along = np.floor((middle[:2] - low) / CELL_MM).astype(int)
    assert away[across, along] == 0 and height[across, along] == pytest.approx(middle[2])
    width = corners[0][:, 0].max() - corners[0][:, 0].min()
    assert (away[:, along] <= REACH_MM).sum() * CELL_MM == pytest.approx(width + 2 * REACH_MM, abs=2 * CELL_MM)
    assert away[0, 0] == pytest.approx(REACH_MM * 2**0.5, abs=CELL_MM), "the corner of the box is farthest"


def with_led_at(scene, across_mm, **board):
    """The scene with its LED elsewhere, and another board."""
    led = scene.leds[0].model_copy(update={"position_mm": (across_mm, 0.0)})
    return scene.model_copy(update={"leds": (led,), "board": scene.board.model_copy(update=board)})


@pytest.mark.parametrize("across_mm, most", [(-1.2, 5), (-3.2, MOST_STRIDES)])
def test_strides_count_towards_a_photodiode(prototype, across_mm, most):
    finger = geometry.build(with_led_at(prototype, across_mm))
    strides, low = strides_made(finger, finger.leds[0])
    led = np.asarray(finger.leds[0].quads).reshape(-1, 3).mean(0)
    centres = np.array([np.asarray(face.quads).reshape(-1, 3).mean(0) for face in finger.photodiodes])
    away = np.linalg.norm(centres - led, axis=1)
    limit = np.minimum(np.floor((away - LEAST_DISTANCE_MM) / STRIDE_MM), MOST_STRIDES)
    # A place is no farther from the middle of its cell than half of the cell's diagonal.
    half = 3**0.5 / 2 * STRIDE_CELL_MM
    for centre in centres:
        for part in (0.2, 0.35, 0.5, 0.65, 0.9, 1.0):
            place = led + part * (centre - led)
            cell = tuple(np.floor((place - low) / STRIDE_CELL_MM).astype(int))
            counted = strides[cell] if min(cell) >= 0 else 0
            made = away - np.linalg.norm(centres - place, axis=1)
            least, largest = (np.minimum(np.floor((made + by) / STRIDE_MM), limit).max() for by in (-half, half))
            assert max(least, 0) <= counted <= largest
    assert strides.max() == most


def test_no_strides_where_all_photodiodes_are_near(prototype, monkeypatch):
    monkeypatch.setattr("nailoptics.light.walk.splitting.LEAST_DISTANCE_MM", 3.0)
    finger = geometry.build(prototype)
    assert not strides_made(finger, finger.leds[0])[0].any()


@pytest.mark.jit
def test_a_batch_without_room_for_all_arrivals_is_walked_again_with_more(jit_backend, coarse_cells, prototype):
    from nailoptics.light.walk.finger import FingerTracer

    tracer = FingerTracer(prototype)
    enough = tracer.batch(0, photons=1 << 12, seed=3)
    tracer.reach[0].arrivals = little = 0.01
    again = tracer.batch(0, photons=1 << 12, seed=3)
    assert tracer.reach[0].arrivals > len(enough.photon) / (1 << 12) > little
    for name in ("photon", "photodiode", "weight", "path_mm"):
        assert np.array_equal(getattr(again, name), getattr(enough, name))


@pytest.mark.jit
def test_a_photon_has_the_weight_of_its_copies_and_the_path_of_one_drawn_by_weight(jit_backend):
    """Three copies of each photon reach one photodiode, and one another photodiode."""
    import mitsuba as mi

    photons, weights = 1 << 12, np.array([1.0, 2.0, 5.0, 0.5])
    splitting = Splitting(SimpleNamespace(arrivals=4.0), photons, paths=1)
    splitting.count, splitting.photon = mi.UInt32(4 * photons), mi.UInt32(np.repeat(np.arange(photons), 4))
    splitting.photodiode = mi.UInt32(np.tile([3, 3, 3, 1], photons))
    splitting.weight, splitting.path = mi.Float(np.tile(weights, photons)), [mi.Float(np.tile(np.arange(4), photons))]
    photon, photodiode, weight, (path,) = splitting.records(seed=1)
    assert np.array_equal(photon, np.repeat(np.arange(photons), 2))
    assert np.array_equal(photodiode, np.tile([1, 3], photons)) and np.array_equal(weight, np.tile([0.5, 8.0], photons))
    drawn, part = np.bincount(path[1::2].astype(int), minlength=3) / photons, weights[:3] / 8.0
    assert np.all(np.abs(drawn - part) < 4 * np.sqrt(part * (1 - part) / photons)) and np.all(path[::2] == 3)


@pytest.mark.long
@pytest.mark.jit
def test_split_photons_read_as_plain_ones_with_calibrated_errors(jit_backend, prototype):
    """Seven levels on the way and one at the photodiodes. Light, and light times its path in the bed, in 16 values of
    which 45 is one in 1e4; errors beside the spread of 32 batches, in 8 values that share photons."""
    from nailoptics.light.walk.finger import FingerTracer
    from nailoptics.light.walk.interfaces import DETECTED

    tracer = FingerTracer(with_led_at(prototype, -3.2))
    count, photons, batches = len(tracer.photodiodes), 1 << 12, 32

    def scored(photodiode, light, path):
        scores = light, light * path[:, 1:3].sum(1)
        return np.array([[np.bincount(photodiode, s**k, minlength=count) for s in scores] for k in (1, 2)])

    split = [tracer.batch(0, photons=photons, seed=seed) for seed in range(batches)]
    ours = np.array([scored(one.photodiode, one.weight, one.path_mm) for one in split])
    assert np.array(tracer.reach[0].strides).max() == MOST_STRIDES
    many = 1 << 20  # far from the LED they estimate readings to a tenth
    walked = tracer.walk(0, photons=many, seed=1911_05_03)
    ended = np.flatnonzero(walked.outcome >= DETECTED)
    path = tracer.by_zone(walked.path_mm[:, ended])
    plain = scored(walked.outcome[ended] - DETECTED, walked.weight[ended], path)
    (sums, squares), total = ours.sum(0), photons * batches
    error, more = stderr_of_mean(sums, squares, total), stderr_of_mean(*plain, many)
    assert np.sum((sums / total - plain[0] / many) ** 2 / (error**2 + more**2)) < 45
    # Of eight times the photons.
    assert np.all(error[0] / (sums[0] / total) < 0.7 * more[0] / (plain[0][0] / many))
    # Splitting on the way compensates for the distance: all readings have similar relative errors.
    assert (error[0] / sums[0]).max() < 1.3 * (error[0] / sums[0]).min()
    spread = ours[:, 0].std(axis=0, ddof=1) / photons / np.sqrt(batches)
    assert np.all((spread / error > 0.6) & (spread / error < 1.5))
    energy = [{part: total / photons for part, (total, _) in one.energy.items()} for one in split]
    assert np.abs([sum(one.values()) - 1 for one in energy]).max() < 1e-9
    assert abs(np.mean([one["lost"] for one in energy])) < 1e-4


@pytest.mark.long
@pytest.mark.jit
def test_split_photons_read_what_plain_ones_read(jit_backend, prototype):
    """Light, and light times its path in plate and bed, on all photodiodes; and a lower variance per photon.

    chi^2 of 24 dependent values: 60 is one in more than 1e4 even of 24 independent ones.
    """
    from nailoptics.light.walk.finger import FingerTracer
    from nailoptics.light.walk.interfaces import DETECTED

    tracer = FingerTracer(prototype)
    photons, count = 1 << 18, len(tracer.photodiodes)
    split = tracer.batch(0, photons=photons, seed=2026_11_21)
    walked = tracer.walk(0, photons=photons, seed=1911_05_03)
    ended = np.flatnonzero(walked.outcome >= DETECTED)
    plain = walked.outcome[ended] - DETECTED, walked.weight[ended], tracer.by_zone(walked.path_mm[:, ended])
    result = []
    for photodiode, light, path in ((split.photodiode, split.weight, split.path_mm), plain):
        scores = np.stack([light, light * path[:, 0], light * path[:, 1:3].sum(1)])
        sums, squares = (np.stack([np.bincount(photodiode, s**k, minlength=count) for s in scores]) for k in (1, 2))
        result.append((sums / photons, stderr_of_mean(sums, squares, photons)))
    (ours, error), (other, more) = result
    assert np.sum((ours - other) ** 2 / (error**2 + more**2)) < 60
    assert np.all(error[0] / ours[0] < 0.8 * more[0] / other[0])
    energy = {part: total / photons for part, (total, _) in split.energy.items()}
    # 2e-6 in the mean of ten seeds: the weight of one photon or two.
    lost_error = stderr_of_mean(*split.energy["lost"], photons)
    assert sum(energy.values()) == pytest.approx(1, abs=1e-9) and abs(energy["lost"]) < 5e-6 + 3 * lost_error < 5e-5
    # Of the photons here alone.
    assert abs(energy["lost"]) < 1e-5

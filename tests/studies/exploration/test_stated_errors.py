"""The errors that explore states of its readings are those that it makes, over places and seeds."""

from typing import Any

import numpy as np
import pytest

from nailoptics.assets import data_dir
from nailoptics.light.board_map import BoardTracer, blood_point
from nailoptics.options import TraceOptions
from nailoptics.scene import Scene, load_scene
from nailoptics.sensor.ambient import SOURCES, trace_ambient
from nailoptics.studies.exploration import explore as study
from nailoptics.studies.exploration.explore import KERNEL_ERROR, Exploration
from nailoptics.studies.placement import boards

PHOTONS, LED_PHOTONS = 400_000, 400_000
# Edge of square photodiodes, and how far they lie from the LED. [mm]
EDGE_MM, NEAR_MM, FAR_MM = 1.0, 1.2, 3.6


def read(explored: Exploration, die_mm: Any, size_mm: Any, places_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What square photodiodes read of a die by the table, and its stated standard error, (n,) float each."""
    t, weight = np.polynomial.legendre.leggauss(4)
    table, weight = explored.wavelengths[0], np.outer(weight, weight).ravel() / 4
    square = np.stack(np.meshgrid(t / 2, t / 2), -1).reshape(-1, 2)
    die, values = square * size_mm + die_mm, []
    blood = explored.scene.blood
    rest = explored.polynomial.monomials(np.array([[blood.rest_blood_fraction] * 2 + [blood.so2]]))[0]
    known = np.column_stack([table.coefficients @ rest, table.blocks[:, :, 0].T])
    for place in places_mm:
        area = square * EDGE_MM + place
        pair = np.repeat(die, len(area), 0), np.tile(area, (len(die), 1))
        each = EDGE_MM**2 * np.outer(weight, weight).ravel() * explored.radial(*pair)
        values.append(each @ (explored.basis.matrix(*pair) @ known))
    first, groups = np.split(np.array(values), [1], axis=1)
    counted = groups.std(1, ddof=1) / np.sqrt(groups.shape[1])
    return first[:, 0], np.hypot(counted, KERNEL_ERROR * first[:, 0])


def traced(scene: Scene, die_mm: Any, places_mm: np.ndarray, *, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """The same by light of the die alone on the bare board, and its standard error."""
    led = scene.leds[0].model_copy(update={"position_mm": tuple(die_mm), "rotation_deg": 0.0})
    lit = boards.bare_board(scene).model_copy(update={"leds": (led,)})
    tracer = BoardTracer(lit)
    arrived = tracer.arrivals(0, photons=LED_PHOTONS, seed=seed)
    value, result = blood_point(lit, 0).values(arrived)[:, 0], []
    for place in places_mm:
        on = np.all(abs(arrived.place_mm - place) < EDGE_MM / 2, axis=1)
        each = np.bincount(arrived.photon[on], value[on])
        result.append((each.sum(), np.sqrt((each**2).sum())))
    return tuple(np.array(result).T / LED_PHOTONS)  # type: ignore[return-value]


def pulls(seed: int, *, photons: int = PHOTONS, response: Any = None) -> np.ndarray:
    """Errors of readings of three places of an LED, in their standard errors.

    photons : of the table. response : angular response of the photodiodes.
    """
    scene, rng = load_scene(data_dir("scenes") / "placement.toml"), np.random.default_rng(seed)
    diode = scene.photodiodes[0].model_copy(update={"angular_response": response})
    board = scene.board.model_copy(update={"barrier": False})
    scene = scene.model_copy(update={"board": board, "photodiodes": (diode,)})
    explored = study.explore(scene, photons=photons, seed=seed)
    reach, result = np.array(explored.scene.layout.outline.size_mm) / 2 - EDGE_MM, []
    for k in range(3):
        die = rng.uniform(-reach, reach)
        places = die + rng.uniform(-FAR_MM, FAR_MM, (60, 2))
        apart = np.hypot(*(places - die).T)
        places = places[(apart > NEAR_MM) & (apart < FAR_MM) & np.all(abs(places) < reach, axis=1)][:20]
        estimate, error = read(explored, die, explored.scene.leds[0].size_mm, places)
        truth, spread = traced(explored.scene, die, places, seed=100 * seed + k)
        result.append((estimate - truth) / np.hypot(error, spread))
    return np.concatenate(result)


@pytest.mark.slow
@pytest.mark.jit
def test_the_stated_errors_on_an_open_board_are_those_that_are_made(jit_backend: Any, monkeypatch: pytest.MonkeyPatch):
    """Readings of one LED share the errors of its neighbourhood, so that these 170 count as some 60: their rms pull
    spreads by 0.09 and their mean by 0.13, and 12 groups of photons alone make the former 1.1."""
    monkeypatch.setattr(study, "FURTHER_LEDS", ())
    pull = np.concatenate([pulls(seed) for seed in (1, 2, 3)])
    assert len(pull) > 120
    assert 0.75 < np.sqrt(np.mean(pull**2)) < 1.3
    assert abs(pull.mean()) < 0.4


@pytest.mark.slow
@pytest.mark.jit
def test_the_kernel_of_photodiodes_of_narrow_acceptance_matches_their_light(
    jit_backend: Any, monkeypatch: pytest.MonkeyPatch
):
    """Half at 35 degrees: the table counts each photon at either end, a trace where it arrives alone."""
    monkeypatch.setattr(study, "FURTHER_LEDS", ())
    narrow = ((0.0, 1.0), (20.0, 0.85), (35.0, 0.5), (60.0, 0.1), (90.0, 0.0))
    pull = pulls(4, photons=150_000, response=narrow)
    assert len(pull) > 40
    assert 0.6 < np.sqrt(np.mean(pull**2)) < 1.5
    assert abs(pull.mean()) < 0.7


@pytest.mark.slow
@pytest.mark.jit
def test_light_from_outside_on_the_prototypes_photodiodes_is_that_of_their_own_traces(
    jit_backend: Any, monkeypatch: pytest.MonkeyPatch
):
    """It falls from the rim by a factor of five over these eight, and the table's errors are of 4 to 20 %: their rms
    pull spreads by 0.25 where neighbours share photons. Averages over cells of 2 mm read 45 % too much."""
    monkeypatch.setattr(study, "FURTHER_LEDS", ())
    explored = study.explore(load_scene(data_dir("scenes") / "prototype.toml"), photons=1_000_000, seed=2)
    (u, v), areas = explored.ambient_nodes, explored.scene.layout.photodiode_areas
    t, weight = np.polynomial.legendre.leggauss(4)
    read_a = []
    for area in areas:
        across, along = (
            np.array([np.interp(middle + t * size / 2, axis, node) @ weight / 2 for node in np.eye(len(axis))])
            for axis, middle, size in zip((u, v), area.center_mm, area.size_mm, strict=True)
        )
        read_a.append(area.area_mm2 * (across @ explored.ambient_a_per_mm2[0] @ along))
    estimate, error = np.mean(read_a, 1), np.std(read_a, axis=1, ddof=1) / np.sqrt(study.BLOCKS)
    truth, spread, _ = trace_ambient(explored.scene, SOURCES[:1], TraceOptions(), seed=5, photons=1 << 17)[:, 0]
    pull = (estimate - truth) / np.hypot(error, spread)
    assert 0.4 < np.sqrt(np.mean(pull**2)) < 1.6
    assert abs(pull.mean()) < 1.1
    assert np.sum(estimate) == pytest.approx(np.sum(truth), rel=0.15)

"""Where detected light was: cells hold what the paths hold, and a fresh trace knows nothing else."""

import numpy as np
import pytest
from small_scenes import finger

import nailoptics as nail
from nailoptics.light import optics
from nailoptics.light.board_map import BoardTracer, blood_point
from nailoptics.scene import parse_scene

SCENE = finger(
    {"name": "near", "position_mm": [0.3, -0.5], "size_mm": [1.5, 1.5]},
    {"name": "far", "position_mm": [1.4, 2.5], "size_mm": [2.0, 2.0]},
    leds=({"wavelength_nm": 800.0, "position_mm": [-2.0, 0.5]},),
    blood={"zone_edges_mm": [0.5], "zone_width_mm": 1.0},
    board={"size_mm": [8.0, 9.0]},
)
BATCHES = 3


@pytest.fixture(scope="module")
def scene():
    return parse_scene(SCENE)


@pytest.fixture(scope="module")
def seen(chosen_jit, scene):
    """Readings and depth maps of several batches, and the cells."""
    tracer = BoardTracer(scene)
    point, cells = blood_point(scene, 0), tracer.cells()
    each = [tracer.detected(0, point, photons=tracer.batch_photons, seed=i, cells=cells) for i in range(BATCHES)]
    return np.stack([means for means, _ in each]), np.stack([depth for _, depth in each]), cells


def in_bed(depth, cells, scene):
    """Sums over the bed, in each blood zone, (..., photodiodes, zones)."""
    plate, bed = scene.finger.nail_thickness_mm, scene.finger.bed_thickness_mm
    middle = (cells.depth_mm[1:] + cells.depth_mm[:-1]) / 2
    zone = optics.zones(scene).weights((cells.v_mm[1:] + cells.v_mm[:-1]) / 2)
    inside = (depth * cells.volume_mm3)[..., (middle > plate) & (middle < plate + bed)]
    return np.einsum("...uvd,vk->...k", inside, zone)


@pytest.mark.long
def test_cells_of_a_zone_hold_the_sensitivity_to_its_absorption(scene, seen):
    """The same photons by their cells and by their partial paths, from which the slope by blood comes.

    Steps count whole in the cell of their middle and by the zone's weight there: 1 % at cells of 0.2 mm.
    """
    means, depth, cells = seen
    slope = blood_point(scene, 0).slope[0]
    assert np.allclose(in_bed(depth, cells, scene).mean(0), -means.mean(0)[:, 2:] / slope, rtol=0.01)
    assert np.all(depth >= 0)


@pytest.mark.parametrize(
    ("photons", "most"),
    [pytest.param(1 << 18, 0.09, marks=pytest.mark.long), pytest.param(BATCHES << 18, 0.05, marks=pytest.mark.slow)],
)
def test_more_absorption_in_a_zone_acts_as_the_depth_map_predicts(scene, seen, chosen_jit, photons, most):
    """No photon is shared: derivatives to mu_a of either zone of the bed, within 4 standard errors of 9 or 5 %."""
    _, depth, cells = seen
    each = in_bed(depth, cells, scene)
    found, error = each.mean(0), each.std(0, ddof=1) / np.sqrt(BATCHES)
    other = nail.trace(scene, photons=photons, seed=99).at()
    for k in range(2):
        fresh = -other.derivative_mm.sel(absorber=f"bed_{k + 1}").values[0]
        spread = other.derivative_mm_stderr.sel(absorber=f"bed_{k + 1}").values[0]
        # Three batches know their own spread badly; that of the fresh trace, of no more photons, is theirs, too.
        assert np.all(np.abs(found[:, k] - fresh) < 4 * np.hypot(spread, np.maximum(error, spread)))
        assert np.all(spread[k] < most * fresh[k])


@pytest.mark.long
def test_a_pair_looks_between_its_die_and_its_photodiode(seen):
    """The banana: along the nail most of it lies between the LED at 0.5 and the far photodiode at 2.5 mm."""
    _, depth, cells = seen
    middle = (cells.v_mm[1:] + cells.v_mm[:-1]) / 2
    profile = (depth.mean(0) * cells.volume_mm3)[1].sum((0, 2))
    center = (profile @ middle) / profile.sum()
    assert 0.8 < center < 2.2
    assert profile[(middle > -0.5) & (middle < 3.5)].sum() > 0.8 * profile.sum()


@pytest.mark.long
def test_sensitivity_goes_as_the_fluence_of_both_ends(chosen_jit):
    """Were the light diffuse, it would be A / 4 of the product of their fluence rates for a photodiode of area A.

    Expected on a board without a wall: in every layer of the bed 0.6 to 1 of that, within 20 % of one factor.
    """
    scene = parse_scene(SCENE.replace("[board]", "[board]\nbarrier = false").replace("-2.0", "-1.0"))
    tracer, finger, diode = BoardTracer(scene), scene.finger, scene.photodiodes[1]
    cells = tracer.cells()
    _, sensitivity = tracer.detected(0, blood_point(scene, 0), photons=1 << 18, seed=1, cells=cells)
    fluence = tracer.fluence(0, 0.3, photons=1 << 17, seed=5)
    u, v = ((edge[1:] + edge[:-1]) / 2 for edge in (cells.u_mm, cells.v_mm))

    def around(place_mm):
        distance = np.hypot(u[:, None] - place_mm[0], v - place_mm[1])
        return np.stack([np.interp(distance, fluence.radius_mm, layer) for layer in fluence.values.T], -1)

    product = around(scene.leds[0].position_mm) * around(diode.position_mm)
    part = np.prod(diode.size_mm) / 4 * product.sum((0, 1)) / sensitivity[1].sum((0, 1))
    top = finger.nail_thickness_mm
    part = part[(fluence.depth_mm > top) & (fluence.depth_mm < top + finger.bed_thickness_mm)]
    assert np.all((part > 0.6) & (part < 1))
    assert np.allclose(part, part.mean(), rtol=0.2)

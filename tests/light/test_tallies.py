"""The fluence under the nail: cells hold what the paths hold."""

from types import SimpleNamespace

import numpy as np
import pytest
from small_scenes import finger

from nailoptics.light import optics
from nailoptics.light.board_map import BoardTracer
from nailoptics.light.walk.tallies import FluenceTally
from nailoptics.scene import parse_scene

SCENE = finger(
    {"name": "near", "position_mm": [0.3, -0.5], "size_mm": [1.5, 1.5]},
    leds=({"wavelength_nm": 800.0, "position_mm": [-1.0, 0.5]},),
    board={"size_mm": [8.0, 9.0], "barrier": False},
)
PHOTONS = 1 << 17


@pytest.mark.long
def test_fluence_in_the_bed_is_what_its_absorption_takes(chosen_jit):
    """Rationale: light that a volume absorbs is mu_a times its fluence, whatever its paths.

    Expected: of the bed under the nail, beside which hardly any light comes to it, what photons of another seed lose
    there by their weights, which is estimated to 1 %.
    """
    scene = parse_scene(SCENE)
    tracer = BoardTracer(scene).tracer
    tally = FluenceTally(scene, tracer.geometry)
    tracer.walk(0, photons=PHOTONS, seed=1, section=tally)
    depth_mm = tally.edges_mm[2]
    middle = (depth_mm[1:] + depth_mm[:-1]) / 2
    top = scene.finger.nail_thickness_mm
    in_bed = (middle > top) & (middle < top + scene.finger.bed_thickness_mm)
    bed_per_mm = optics.absorption(scene, 800.0)[0][optics.bed_columns(scene)[0]]
    by_fluence = bed_per_mm * tally.sums()[..., in_bed].sum() / PHOTONS
    total, square = tracer.batch(0, photons=PHOTONS, seed=2).absorbed["bed"]
    by_weights, error = total / PHOTONS, np.sqrt(square) / PHOTONS
    assert abs(by_fluence - by_weights) < 4 * np.sqrt(2) * error and error < 0.01 * by_weights


@pytest.mark.jit
def test_cells_of_the_fluence_fill_a_shell_around_the_nails_axis(jit_backend):
    """Expected: as many as there are across and along take the volume between two cylinders, over the nail's angle."""
    scene = parse_scene(SCENE)
    finger = scene.fingertip
    shape = SimpleNamespace(nail_radius_mm=finger.nail_radius_mm, board_radius_mm=finger.nail_radius_mm + 0.5)
    tally = FluenceTally(scene, shape)
    outer, inner = finger.nail_radius_mm - tally.edges_mm[2][[0, -1]]
    shell_mm3 = finger.nail_width_mm / finger.nail_radius_mm * (outer**2 - inner**2) / 2 * finger.nail_length_mm
    assert np.prod(tally.shape[:2]) * tally.volume_mm3.sum() == pytest.approx(shell_mm3, rel=1e-9)

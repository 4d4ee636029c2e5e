"""Skin of the pulp through the port of a spectrophotometer."""

import numpy as np
import pytest

from nailoptics import load_scene
from nailoptics.assets import data_dir
from nailoptics.light.walk.nail_reflectance import NailReflectance, Patch
from nailoptics.statistics import jackknife
from nailoptics.studies.colour.reflectance import WAVELENGTHS_NM, walk_colour


@pytest.mark.long
@pytest.mark.jit
def test_a_port_loses_red_light_and_no_blue(jit_backend):
    """Expected: a port wider than the finger loses nothing; 5 and 11 mm differ by little at 400 nm, and in the red by
    some 10 % (Takiwaki 2002, Skin Res. Technol. 8, 94), at 700 nm on this finger by 28(2) %."""
    scene = load_scene(data_dir("scenes") / "prototype.toml")
    nail = NailReflectance(scene, backend=jit_backend.name)
    patches = [Patch((0.0, 0.0), (3.0, 3.0), port_mm=port) for port in (5.0, 11.0, 60.0)]
    rays = walk_colour(nail, patches, photons=72_000, seed=1)
    blood = np.full((1, nail.scene.zone_count), scene.blood.rest_blood_fraction)
    read = rays.read(blood, scene.colour, scene=nail.scene).reflectance[:, :, 0]
    blue, red = (int(np.abs(WAVELENGTHS_NM - nm).argmin()) for nm in (400.0, 700.0))
    ratio = read / read[:, 2:]
    value, stderr = ratio[0], jackknife(ratio)
    assert value[0, red] < value[1, red] - 2 * stderr[1, red] < 1
    assert 1 - value[0, red] / value[1, red] == pytest.approx(0.28, abs=0.06)
    assert (abs(value[:2, blue] - 1) < 3.5 * stderr[:2, blue]).all() and (stderr[:2, blue] < 0.05).all()

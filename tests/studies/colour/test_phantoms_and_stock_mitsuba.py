"""The traced reflectance of known things: layered, white and black phantoms, and the finger by stock Mitsuba."""

import iadpython
import numpy as np
import pytest
from nail_camera import NailCamera
from small_scenes import SMALL_FINGER_BEST

from nailoptics import tissue
from nailoptics.errors import InputError
from nailoptics.geometry import DistanceGrid, Geometry
from nailoptics.geometry.regions import BARRIER, BED, CUT, PLATE, REGIONS
from nailoptics.light import backend, optics
from nailoptics.light.walk.interfaces import Interfaces
from nailoptics.light.walk.nail_reflectance import NailReflectance, Patch
from nailoptics.scene import Viewing, parse_scene
from nailoptics.statistics import jackknife, seed_of
from nailoptics.studies.colour.nail_colour import colour
from nailoptics.studies.colour.reflectance import GROUPS, NODES, WAVELENGTHS_NM, ColourRays, Viewer, walk_colour

SCENE = parse_scene(
    SMALL_FINGER_BEST.replace("[finger]", "[finger]\nplate_scattering = 0.3") + "[board]\nopaque_reflectance = 1.0\n"
)
MIDDLE = (Patch((0.0, 0.0), (4.0, 8.0)),)
THICKNESS_MM = {"plate": 0.45, "bed": 1.7}
REST = np.full((1, 2), 0.03)


class FlatStack(NailReflectance):
    """Nail plate and bed as layers 200 mm wide over something opaque, walked as a finger is."""

    def __init__(self, floor: int) -> None:
        super().__init__(SCENE)
        depth_mm = np.cumsum([0.0, *THICKNESS_MM.values()])
        corners = np.array([[-100, -100], [100, -100], [100, 100], [-100, 100]], float)
        planes = [np.column_stack([corners, np.full(4, -z)]) for z in depth_mm]
        faces = np.array([[0, 1, 2], [0, 2, 3]])
        stack = [0, PLATE, BED, floor]
        shape = Geometry(
            vertices=np.concatenate(planes),
            triangles=np.concatenate([faces + 4 * i for i in range(3)]),
            below=np.repeat(stack[1:], 2),
            above=np.repeat(stack[:-1], 2),
            regions=REGIONS,
            leds=(),
            photodiodes=(),
            nail_radius_mm=8.8,
            board_radius_mm=8.8,
            grid=None,
        )
        # No distance is precomputed anywhere: every step casts a ray.
        unknown, flat = np.zeros((2, 1, 1, 1), np.float32), np.zeros(len(shape.triangles), bool)
        self.flat = shape, DistanceGrid(unknown, flat, np.zeros((0, 2)), np.inf, np.zeros(3), 1.0)

    @property
    def finger(self):
        return self.flat[0], Interfaces(*self.flat)


def by_adding_doubling(wavelength_nm: float, n: float) -> float:
    """Reflectance of both layers of one index over black, of light that falls in at a right angle."""
    layers = []
    mu_a = optics.absorption(SCENE, wavelength_nm, blood_fraction=REST)[0, 0]
    for name, column in (("plate", 0), ("bed", 1)):
        mu_s, g, _ = tissue.scattering(name, wavelength_nm)
        mu_s *= 0.3 if name == "plate" else 1.0
        thick = (mu_a[column] + mu_s) * THICKNESS_MM[name]
        layers.append(iadpython.Sample(a=mu_s / (mu_a[column] + mu_s), b=thick, g=g, n=n, quad_pts=24))
    return stacked(layers, over_air=False)


def stacked(layers: list[iadpython.Sample], *, over_air: bool) -> float:
    """Reflectance of two layers of one index, over air or over black that has their index."""
    first, _ = layers
    above, below = (iadpython.simple_layer_matrices(one) for one in layers)
    both = iadpython.add_layers(first, above[0], above[0], above[1], above[1], below[0], below[0], below[1], below[1])
    top, bottom = (iadpython.start.boundary_layer(first, top=upper) for upper in (True, False))
    result = iadpython.add_slide_above(first, *top, *both)
    if over_air:
        result = iadpython.add_slide_below(first, *result, *bottom)
    return float(first.UX1_and_UXU(result[0], result[2])[0])


def test_two_halves_of_a_slab_make_the_slab():
    """What the layered phantom is held against is itself right where one layer can be computed whole."""
    made = {"a": 0.95, "g": 0.6, "n": 1.5, "quad_pts": 16}
    half, whole = iadpython.Sample(b=1.5, **made), iadpython.Sample(b=3.0, **made)
    assert stacked([half, half], over_air=True) == pytest.approx(whole.rt()[0], rel=1e-9)
    # So thick that nothing comes back from below, the floor does not matter.
    thick = iadpython.Sample(b=400.0, **made)
    assert stacked([half, thick], over_air=False) == pytest.approx(stacked([half, thick], over_air=True), rel=1e-6)


@pytest.mark.jit
@pytest.mark.parametrize(
    ("photons", "within"), [(160_000, 0.02), pytest.param(3_200_000, 0.005, marks=pytest.mark.slow)]
)
def test_a_layered_phantom_meets_adding_doubling_at_eight_wavelengths(jit_backend, monkeypatch, photons, within):
    """Plate and bed of one index over black, from four walked wavelengths, dimmed and interpolated."""
    monkeypatch.setitem(tissue._INDEX, "bed", tissue._INDEX["plate"])
    rays = walk_colour(FlatStack(CUT), MIDDLE, photons=photons, seed=3)
    read = rays.read(REST, Viewing(lit_by="sky", gloss=True)).reflectance[:, 0, 0]
    value, error = read[0], jackknife(read)
    for wavelength_nm in (420.0, 450.0, 500.0, 545.0, 575.0, 620.0, 680.0, 740.0):
        at = int(np.flatnonzero(WAVELENGTHS_NM == wavelength_nm)[0])
        exact = by_adding_doubling(wavelength_nm, 1.5)
        assert abs(value[at] - exact) < 3 * error[at], (wavelength_nm, value[at], exact, error[at])
        assert abs(value[at] - exact) < within * exact, (wavelength_nm, value[at], exact)


@pytest.mark.jit
def test_white_and_black_phantoms_have_their_exact_colours(jit_backend, monkeypatch):
    viewer, absorbers = Viewer(), len(optics.absorbers(SCENE))
    stack = FlatStack(BARRIER)
    result = stack.reflect(550.0, MIDDLE, mu_a=np.full(absorbers, 1e-7), photons=8_000, seed=5, groups=GROUPS)
    rays = ColourRays(stack.scene, MIDDLE, (result,) * NODES)
    monkeypatch.setattr(optics, "absorption", lambda *a, **k: np.zeros((1, len(WAVELENGTHS_NM), absorbers)))
    # Every ray comes back, but for those that chance ended for others that count twice.
    lab = viewer.lab(rays.read(REST, Viewing(lit_by="sky", gloss=True)).reflectance)
    error = jackknife(lab)[0, 0]
    assert np.all(np.abs(lab[0, 0, 0] - [100, 0, 0]) < np.maximum(3 * error, 1e-3)) and error.max() < 0.1
    monkeypatch.setattr(optics, "absorption", lambda *a, **k: np.full((1, len(WAVELENGTHS_NM), absorbers), 1e5))
    assert viewer.lab(rays.read(REST, Viewing()).reflectance)[0, 0, 0] == pytest.approx([0, 0, 0], abs=1e-3)


@pytest.mark.slow
@pytest.mark.jit
def test_a_camera_of_stock_mitsuba_renders_the_same_colour_of_the_nail(chosen_jit):
    """volpath through real media under an even sky, gloss included, against the traced rays, at three wavelengths."""
    backend.activate(chosen_jit)
    bare = NailReflectance(SCENE)
    rays = walk_colour(bare, MIDDLE, photons=320_000, seed=7)
    read = rays.read(REST, Viewing(lit_by="sky", gloss=True)).reflectance[:, 0, 0]
    value, error = read[0], jackknife(read)
    camera = NailCamera(bare.scene, MIDDLE, groups=GROUPS, backend=backend.choose("auto", volpath=True))
    for wavelength_nm in (450.0, 545.0, 680.0):
        at = int(np.flatnonzero(WAVELENGTHS_NM == wavelength_nm)[0])
        groups = camera.see(wavelength_nm, REST, spp=240, seed=seed_of(9, at))[:, 0, 0]
        rendered, rendered_error = groups.mean(), groups.std(ddof=1) / np.sqrt(len(groups))
        both = np.hypot(error[at], rendered_error)
        assert abs(value[at] - rendered) < 3 * both and both < 0.02 * rendered, (
            wavelength_nm,
            value[at],
            rendered,
            both,
        )


def test_without_a_backend_that_compiles_kernels_colour_is_refused():
    with pytest.raises(InputError, match="colour needs a JIT backend"):
        colour(SCENE, backend="scalar")

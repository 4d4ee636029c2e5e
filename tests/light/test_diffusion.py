"""Layered diffusion: closed formulas, the photon walk through a phantom, and what a finger's photodiodes read."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import j0
from small_scenes import phantom

from nailoptics import load_scene, trace
from nailoptics.assets import data_dir
from nailoptics.errors import InputError
from nailoptics.light import diffusion
from nailoptics.light.diffusion import DiffusionModel, DiffusiveStack, fresnel_moments
from nailoptics.scene import Scene, parse_scene


def homogeneous(n: float = 1.4, layers: int = 1) -> DiffusiveStack:
    return DiffusiveStack(
        thickness_mm=np.full(layers - 1, 0.7),
        mu_a_per_mm=np.full(layers, 0.03),
        mu_s_reduced_per_mm=np.full(layers, 1.2),
        n=np.full(layers, n),
        n_above=1.0,
    )


def reflectance(stack: DiffusiveStack, distance_mm: np.ndarray, depth_mm: float) -> np.ndarray:
    """Light that leaves per area at a distance from an isotropic source, by a Hankel transform. [mm^-2]"""
    node, weight = np.polynomial.legendre.leggauss(20)
    edges = np.linspace(0, 40 / depth_mm, 201)
    half = edges[1] / 2
    frequency = (edges[:-1, None] + half * (node + 1)).ravel()
    escape = stack.escape(frequency, depth_mm)[0] * np.tile(half * weight, 200) * frequency / (2 * np.pi)
    return np.array([escape @ j0(frequency * r) for r in distance_mm])


def farrell(stack: DiffusiveStack, distance_mm: np.ndarray, depth_mm: float) -> np.ndarray:
    """The closed formula of a half space with an image source above the extrapolated boundary.

    References: Farrell, Patterson, Wilson 1992, Med. Phys. 19, 879, eq. (14).
    """
    effective = np.sqrt(stack.mu_a_per_mm[0] / stack.diffusion_mm[0])
    image = depth_mm + 2 * stack.extrapolated_mm

    def source(z: float) -> np.ndarray:
        r = np.hypot(distance_mm, z)
        return z * (effective + 1 / r) * np.exp(-effective * r) / r**2

    return (source(depth_mm) + source(image)) / (4 * np.pi)


DISTANCE_MM = np.array([0.3, 1.0, 2.0, 4.0, 8.0])


@pytest.mark.parametrize("layers", [1, 3])
def test_equal_layers_are_a_half_space(layers):
    """Expected: the closed formula, to the digits of the transform, however the half space is cut into layers."""
    stack = homogeneous(layers=layers)
    depth = stack.mean_path_mm
    found = reflectance(stack, DISTANCE_MM, depth)
    assert np.allclose(found, farrell(stack, DISTANCE_MM, depth), rtol=1e-5)


def test_light_is_kept_where_nothing_absorbs():
    """Expected: all light of a source in layers without absorption leaves, across steps of the index."""
    stack = replace(homogeneous(layers=3), mu_a_per_mm=np.full(3, 1e-12), n=np.array([1.5, 1.38, 1.55]), n_above=1.3)
    assert np.allclose(stack.escape(np.array([0.0]), [0.1, 0.7, 1.0, 3.0]), 1, atol=1e-4)


def test_layers_meet():
    """Expected: continuous in depth where only mu_a and mu_s' change; a fall of the fluence where the index does."""
    stack = replace(homogeneous(layers=2), mu_a_per_mm=np.array([0.5, 0.05]))
    above, below = stack.escape(np.array([0.0, 1.0]), [0.7 - 1e-9, 0.7])
    assert np.allclose(above, below, rtol=1e-7)
    above, below = replace(stack, n=np.array([1.5, 1.38])).escape(np.array([0.0, 1.0]), [0.7 - 1e-9, 0.7])
    assert (below < above).all()


@pytest.mark.parametrize(("n_in", "n_out"), [(1.4, 1.0), (1.5, 1.55), (1.0, 1.4)])
def test_moments_of_fresnel_reflection(n_in, n_out):
    """Expected: by reciprocity n_in^2 (1 - R_in) = n_out^2 (1 - R_out)."""
    into, back = fresnel_moments(n_in, n_out), fresnel_moments(n_out, n_in)
    assert n_in**2 * (1 - into[0]) == pytest.approx(n_out**2 * (1 - back[0]), rel=1e-4)


def test_diffuse_reflection_from_outside():
    """References: Walsh 1926, as in Duntley 1942, J. Opt. Soc. Am. 32, 61, eq. (26)."""
    n = 1.5
    first = 0.5 + (n - 1) * (3 * n + 1) / (6 * (n + 1) ** 2)
    second = n**2 * (n**2 - 1) ** 2 / (n**2 + 1) ** 3 * np.log((n - 1) / (n + 1))
    third = 2 * n**3 * (n**2 + 2 * n - 1) / ((n**2 + 1) * (n**4 - 1))
    fourth = 8 * n**4 * (n**4 + 1) / ((n**2 + 1) * (n**4 - 1) ** 2) * np.log(n)
    assert fresnel_moments(1.0, n)[0] == pytest.approx(first + second - third + fourth, abs=1e-5)


@pytest.mark.long
@pytest.mark.jit
def test_a_layered_phantom_against_the_photon_walk(jit_backend):
    """Rationale: a plate of two mean paths on a slab, a beam that becomes diffuse within the plate.
    Expected: near the beam the layers err, by tens of percent; from ten mean paths on, by few."""
    distances = np.array([0.5, 1.0, 2.0, 4.0])
    upper = {"name": "plate", "thickness_mm": 0.5, "mu_s_per_mm": 40.0, "g": 0.9, "n": 1.5}
    lower = {"name": "bed", "thickness_mm": np.inf, "mu_a_per_mm": 0.03, "mu_s_per_mm": 20.0, "g": 0.9, "n": 1.38}
    apertures = [{"name": f"at_{x}", "position_mm": [x, 0.0], "size_mm": [0.2, 0.2]} for x in distances]
    scene = parse_scene(phantom(upper, lower, photodiodes=apertures))
    layers = scene.phantom.layers
    stack = DiffusiveStack(
        thickness_mm=np.array([layers[0].thickness_mm]),
        mu_a_per_mm=np.array([one.mu_a_per_mm for one in layers]),
        mu_s_reduced_per_mm=np.array([one.mu_s_per_mm * (1 - one.g) for one in layers]),
        n=np.array([one.n for one in layers]),
        n_above=scene.phantom.n_above,
    )
    walked = trace(scene, photons=400_000, seed=1).at()
    scattered = stack.mu_s_reduced_per_mm[0] * stack.mean_path_mm
    found = 0.04 * 0.96 * scattered * reflectance(stack, distances, stack.mean_path_mm)
    ratio = found / walked.detected_fraction.values[0]
    error = walked.detected_fraction_stderr.values[0] / walked.detected_fraction.values[0]
    assert (error < 0.03).all()
    # Measured with 6 million photons, to 0.1-0.6 %.
    assert (np.abs(ratio - [0.945, 0.744, 0.914, 0.981]) < 4 * error + 0.01).all()


def prototype() -> Scene:
    return load_scene(data_dir("scenes") / "prototype.toml")


BLOOD = np.array([[0.03, 0.03], [0.05, 0.002], [0.05, 0.03], [0.03, 0.002]])


def test_readings_are_sums_over_the_nail():
    """Expected: summed place by place, with the Hankel transform between, as they are by spatial frequency."""
    model = DiffusionModel(prototype())
    layout, stack, cells = model.scene.layout, model._stacks[0], model._cells
    die, area = layout.leds[0], layout.photodiode_areas[2]
    depth, height = diffusion.MEAN_COSINE * stack.mean_path_mm, 0.45
    place = np.stack(np.meshgrid(cells.u_mm, cells.v_mm, indexing="ij"), -1)
    emitted, seen = cells.view_factor(die, height) / die.area_mm2, cells.view_factor(area, height)
    assert emitted.sum() * diffusion.CELL_MM**2 == pytest.approx(0.75, abs=0.25)
    distance = np.linspace(0, 25, 2000)
    spread = reflectance(stack, distance, depth)
    lit, looked = emitted > 1e-3 * emitted.max(), seen > 1e-3 * seen.max()
    apart = np.linalg.norm(place[lit][:, None] - place[looked][None], axis=-1)
    total = emitted[lit] @ np.interp(apart, distance, spread) @ seen[looked] * diffusion.CELL_MM**4
    scattered = stack.mu_s_reduced_per_mm[0] * stack.mean_path_mm
    assert model.readings(BLOOD[:1])[0, 2, 0] == pytest.approx(scattered * total, rel=0.02)


def test_finer_cells_frequencies_and_nodes_change_little(monkeypatch):
    """Expected: readings and their changes within 2 %."""
    coarse = DiffusionModel(prototype()).readings(BLOOD)
    for name, value in (("CELL_MM", 0.05), ("FREQUENCIES", 1500), ("DEPTHS", 6), ("NODES", 9)):
        monkeypatch.setattr(diffusion, name, value)
    fine = DiffusionModel(prototype()).readings(BLOOD)
    assert np.allclose(coarse, fine, rtol=0.02, atol=0)
    changes = [found / found[..., :1] - 1 for found in (coarse, fine)]
    assert np.allclose(*changes, rtol=0.02, atol=1e-9)


def test_blood_dims_the_photodiodes_above_it():
    """Expected: each zone weighs more on its own side, all in all 1; more blood in a zone dims every photodiode."""
    model = DiffusionModel(prototype())
    assert np.allclose(model.zone_share.sum(-1), 1)
    assert (model.zone_share[0, :4, 0] > 0.5).all() and (model.zone_share[0, 4:, 1] > 0.5).all()
    rest, both, proximal, distal = np.moveaxis(model.readings(BLOOD), -1, 0)
    assert (proximal < rest).all() and (distal > rest).all() and (both > proximal).all()
    assert np.allclose(model.readings(BLOOD[[0, 0]]), rest[..., None], rtol=1e-6)


def test_a_phantom_has_no_nail():
    with pytest.raises(InputError, match="finger"):
        DiffusionModel(load_scene(data_dir("scenes") / "phantom.toml"))

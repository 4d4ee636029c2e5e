"""Reflectance to colour, against the CIE's values of white, grey and black."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from nailoptics.hemodynamics import white_band_mm
from nailoptics.light import optics
from nailoptics.light.tracing import StageProgress
from nailoptics.light.transfer.series import ChebyshevBox
from nailoptics.light.walk.nail_reflectance import Patch, ReflectedLight
from nailoptics.options import TraceOptions
from nailoptics.scene import Viewing, load_scene
from nailoptics.studies.colour import nail_colour as adaptive_sampling
from nailoptics.studies.colour.nail_colour import _redness_left, stderr_of_colour
from nailoptics.studies.colour.reflectance import (
    GROUPS,
    NODES,
    NODES_NM,
    WAVELENGTHS_NM,
    WEIGHTS,
    ColourRays,
    Viewer,
    _weighted,
    delta_e_2000,
)


@pytest.mark.parametrize("illuminant", ["D65", "A", "LED-B3"])
@pytest.mark.parametrize("observer", ["2", "10"])
def test_white_grey_and_black_have_their_exact_colours(illuminant, observer):
    viewer = Viewer(illuminant, observer)
    flat = np.ones(len(WAVELENGTHS_NM))
    assert viewer.lab(flat) == pytest.approx([100, 0, 0], abs=1e-9)
    assert viewer.lab(0 * flat) == pytest.approx([0, 0, 0], abs=1e-9)
    # L* = 116 Y^(1/3) - 16.
    assert viewer.lab(0.2 * flat) == pytest.approx([116 * 0.2 ** (1 / 3) - 16, 0, 0], abs=1e-9)
    assert viewer.srgb(flat) == pytest.approx([1, 1, 1], abs=2e-3)


def test_daylights_white_is_the_tabulated_one():
    # CIE 015:2018, 2 degrees: X 95.04, Z 108.88 for Y = 100; cut at 400 nm, blue loses 0.2.
    assert 100 * Viewer("D65").white == pytest.approx([95.04, 100, 108.88], abs=0.25)


def test_red_and_green_lie_on_opposite_sides_of_the_a_axis():
    red = np.where(WAVELENGTHS_NM > 600, 0.8, 0.1)
    green = np.where((WAVELENGTHS_NM > 500) & (WAVELENGTHS_NM < 580), 0.8, 0.1)
    lab = Viewer().lab(np.stack([red, green]))
    assert lab[0, 1] > 40 and lab[1, 1] < -40
    assert delta_e_2000(lab[0], lab[0]) == pytest.approx(0) and delta_e_2000(lab[0], lab[1]) > 50


def test_between_the_nodes_a_parabola_in_the_logarithm_is_exact():
    x = np.log(WAVELENGTHS_NM / 550)
    assert WEIGHTS.sum(0) == pytest.approx(np.ones(len(x)), abs=1e-9)
    parabola = np.polynomial.Polynomial([0.3, -0.2, 0.5])
    assert parabola(np.log(NODES_NM / 550)) @ WEIGHTS == pytest.approx(parabola(x), abs=1e-9)


def test_the_number_of_nodes_is_what_the_colours_error_needs():
    """Skin with blood by diffusion: its colour with the nodes' scattering, interpolated, against that with its own."""
    viewer, absorbed = Viewer(), 0.05 + 0.3 * np.exp(-((WAVELENGTHS_NM - 560) ** 2) / 800)
    fine = 4.6 * (WAVELENGTHS_NM / 500) ** -1.421

    def reflected(reduced_per_mm):
        # Semi-infinite and index-matched: T. J. Farrell, M. S. Patterson, B. Wilson, Med. Phys. 19, 879 (1992), A = 1.
        albedo = reduced_per_mm / (reduced_per_mm + absorbed)
        root = np.sqrt(3 * (1 - albedo))
        return albedo / 2 * (1 + np.exp(-4 / 3 * root)) * np.exp(-root)

    exact = viewer.lab(reflected(fine))
    result = []
    for count in (NODES - 1, NODES):
        box = ChebyshevBox(*np.log(WAVELENGTHS_NM[[[0], [-1]]]), [count])
        each = np.array([reflected(4.6 * (node / 500) ** -1.421) for node in np.exp(box.nodes[:, 0])])
        result.append(float(delta_e_2000(viewer.lab((box.weights(np.log(WAVELENGTHS_NM)) @ each).diagonal()), exact)))
    # A hundredth of the standard error that colours are traced to.
    assert result[1] < 0.003 < result[0], result


def test_the_error_of_a_colour_is_that_of_its_replicates():
    """Of Gaussian scatter in L* at 50, where CIEDE2000 counts a step of L* as about 1."""
    scatter = np.random.default_rng(1).normal(0, 0.3, (32, 400))
    groups = 50 + scatter * np.sqrt(32)
    every = np.concatenate([groups.mean(0)[None], (groups.sum(0) - groups) / 31])
    lab = np.stack([every, np.full_like(every, 10.0), np.full_like(every, 5.0)], -1)
    assert np.sqrt((stderr_of_colour(lab) ** 2).mean()) == pytest.approx(0.3, rel=0.05)


def test_a_white_band_ends_where_half_of_the_redness_is_gone():
    v_mm, ends_mm = np.arange(-5.5, 6), (-6.0, 6.0)
    rest, pale = np.full(12, 8.0), np.full(12, -2.0)
    # Pale from 2.5 mm on, as red as ever before 1.5 mm: half-way at 2.
    pressed = np.where(v_mm > 2, -2.0, 8.0)
    redness = np.stack([rest, pressed, pale], -1)
    part = _redness_left(redness, pale)
    assert white_band_mm(v_mm, part, ends_mm=ends_mm) == pytest.approx([0.0, 4.0, 12.0])


@pytest.mark.parametrize("pace_s", [2e-6, 2e-5])
def test_parts_of_rays_fit_into_what_is_left_of_the_time(monkeypatch, pace_s):
    """Expected: rays end within the time, which the first, of unknown pace, leave a tenth of at least."""
    clock = SimpleNamespace(now=0.0)
    monkeypatch.setattr("nailoptics.light.tracing.stopping.time", SimpleNamespace(perf_counter=lambda: clock.now))

    parts = []

    def walk_colour(*_, photons, **__):
        clock.now += photons * pace_s
        parts.append(photons)
        return walked(photons)

    def walked(photons):
        rays = SimpleNamespace(photons=photons, with_more=lambda more: walked(photons + more.photons))
        rays.read = lambda *_: rays
        return rays

    def sampled(photons, **limit):
        stage = StageProgress(None, **limit)
        options, nail = TraceOptions(photons=photons), SimpleNamespace(scene=None)
        return adaptive_sampling.sample_until_tolerance(nail, None, None, Viewing(), options, stage)

    monkeypatch.setattr(adaptive_sampling, "walk_colour", walk_colour)
    monkeypatch.setattr(adaptive_sampling, "patches_of", lambda _: ())
    monkeypatch.setattr(adaptive_sampling, "errors_of", lambda *_: (np.ones(1), np.ones(1)))
    limit_s = 10 * adaptive_sampling.PILOT * pace_s
    _, why = sampled(10**8, limit_s=limit_s)
    assert 0.9 * limit_s < clock.now < 1.2 * limit_s and why.startswith(
        "max_seconds ended the rays at a standard error"
    )
    # Without a limit all are walked.
    parts.clear()
    rays, why = sampled(3 * adaptive_sampling.MOST_AT_ONCE)
    assert rays.photons == 3 * adaptive_sampling.MOST_AT_ONCE and len(parts) == 3 and why == ""


@pytest.mark.parametrize("lit_by", ["sky", "lamp"])
def test_a_white_surface_that_scatters_evenly_has_a_reflectance_of_1(lit_by):
    """Of a Lambertian surface's rays the squared cosines are spread evenly, and gloss is none of them."""
    count = 40_000
    cosine = np.sqrt((np.arange(count) + 0.5) / count).astype(np.float32)
    none, ones = np.zeros(count, int), np.ones(count, np.float32)
    rays = ReflectedLight(np.array([count]), none, none, ones, np.zeros((count, 1)), np.zeros(1), cosine, none > 0)
    assert _weighted(rays, Viewing(lit_by=lit_by)).weight.sum() / count == pytest.approx(1.0, abs=1e-3)
    assert _weighted(replace(rays, gloss=none == 0), Viewing(lit_by=lit_by)).weight.sum() == 0


def test_rays_are_read_part_by_part_and_patch_by_patch_as_all_at_once():
    """Three patches' rays in two parts; expected: each ray's weight and Beer-Lambert's law of its path, ray by ray."""
    scene, generator = load_scene("prototype"), np.random.default_rng(4)
    states, absorbers = np.array([[0.02, 0.03], [0.05, 0.01]]), len(optics.absorbers(scene))
    mu_a = optics.absorption(scene, WAVELENGTHS_NM, blood_fraction=states)
    patches = tuple(Patch((0.0, float(v)), (1.0, 1.0)) for v in range(3))

    def walked(count):
        def light():
            return ReflectedLight(
                rays=GROUPS * np.array([count, 2 * count, count]),
                patch=generator.integers(0, 3, count).astype(np.uint16),
                group=generator.integers(0, GROUPS, count).astype(np.uint8),
                weight=generator.choice([0.0, 0.5, 1.0], count).astype(np.float32),
                path_mm=generator.exponential(1.0, (count, absorbers)).astype(np.float16),
                mu_a=np.full(absorbers, 0.01),
                cosine=np.ones(count, np.float32),
                gloss=np.zeros(count, bool),
            )

        return ColourRays(scene, patches, tuple(light() for _ in range(NODES)))

    parts = [walked(count) for count in (3_000, 500)]
    together = parts[0].with_more(parts[1])
    expected = np.zeros((3, *mu_a.shape[:2]))
    for cell, weight in zip(together.light, WEIGHTS, strict=True):
        left = np.exp(-np.einsum("nr,sqr->nsq", cell.path_mm.astype(float), mu_a - cell.mu_a))
        sums = np.zeros_like(expected)
        np.add.at(sums, cell.patch, cell.weight[:, None, None] * left)
        expected += weight * sums / cell.rays[:, None, None]
    viewing = Viewing(gloss=False)
    at_once = together.read(states, viewing).reflectance
    assert at_once.shape == (1 + GROUPS, 3, 2, len(WAVELENGTHS_NM))
    assert at_once[0] == pytest.approx(expected, rel=1e-5, abs=1e-9)
    by_part = parts[0].read(states, viewing).with_more(parts[1].read(states, viewing)).reflectance
    assert by_part == pytest.approx(at_once, rel=1e-5, abs=1e-9)
    two = replace(together, patches=(patches[2], patches[0]), light=tuple(c.select([2, 0]) for c in together.light))
    assert two.read(states, viewing).reflectance == pytest.approx(at_once[:, [2, 0]], rel=1e-5, abs=1e-9)

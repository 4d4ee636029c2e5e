"""Light from outside: spectra with the luminous efficacy they must have, and a sky that the other engine shines."""

import tempfile
from importlib import import_module
from pathlib import Path

import colour
import numpy as np
import pytest
from small_scenes import finger
from watertight import check_watertight

from nailoptics import trace
from nailoptics.assets import read_table
from nailoptics.light import backend, optics
from nailoptics.light.board_map import Arrivals, BoardTracer
from nailoptics.light.reference import mitsuba_scene, readings
from nailoptics.options import TraceOptions
from nailoptics.scene import Ambient, Photodiode, parse_scene
from nailoptics.sensor.ambient import (
    ALL_NM,
    INSIDE_NM,
    KELVIN,
    SILICON_NM,
    SOURCES,
    photocurrent_a_per_mm2,
    spectral_irradiance,
    trace_ambient,
)


def covered(cover_um: int) -> str:
    """A finger whose board has a cover of some thickness."""
    return finger(
        {"name": "pd", "position_mm": [1.0, -0.5], "size_mm": [1.5, 1.5]},
        leds=({"wavelength_nm": 800.0, "position_mm": [-2.5, 0.5]},),
        board={"size_mm": [7.0, 7.0], "barrier": False, "cover_um": cover_um},
    )


def test_light_from_outside_takes_the_distances_that_the_leds_light_has(jit_backend):
    """Expected: a command that traces both makes the grid of distances once."""
    scene = parse_scene(covered(0))
    built = import_module("nailoptics.light.walk.finger").built
    built.cache_clear()
    trace(scene, photons=2000, store=False)
    trace_ambient(scene, SOURCES, TraceOptions(store=False), seed=0, photons=1000)
    assert built.cache_info().misses == 1


@pytest.mark.parametrize(("kelvin", "lumens_per_watt"), [(5800.0, 93.0), (2800.0, 15.0), (7000.0, 95.0)])
def test_black_bodies_shine_with_their_luminous_efficacy(kelvin, lumens_per_watt, monkeypatch):
    """Efficacies of ideal black bodies as tables of photometry list them, rounded to whole lm/W."""
    monkeypatch.setitem(KELVIN, "sun", kelvin)
    total = np.trapezoid(spectral_irradiance(SOURCES[0], ALL_NM), ALL_NM)
    assert 1e5 / total == pytest.approx(lumens_per_watt, abs=1.0)


@pytest.mark.parametrize("kind", ["sun", "lamp", "led"])
def test_spectra_are_those_of_colour_science(kind):
    if kind in KELVIN:
        there = colour.colorimetry.planck_law(SILICON_NM * 1e-9, KELVIN[kind])
    else:
        lamp = colour.SDS_ILLUMINANTS["LED-B3"]
        there = np.interp(SILICON_NM, lamp.wavelengths, lamp.values, left=0.0, right=0.0)
    ours = spectral_irradiance(Ambient(kind=kind, illuminance_lux=500.0), SILICON_NM)
    assert np.allclose(ours / ours.max(), there / there.max(), rtol=1e-13)


def test_the_photopic_observer_is_that_of_colour_science():
    there = colour.SDS_LEFS["CIE 1924 Photopic Standard Observer"]
    wavelength_nm, efficiency = read_table("photometry/photopic.csv").values()
    assert (wavelength_nm == there.wavelengths).all() and (efficiency == there.values).all()


@pytest.mark.parametrize("kind", ["sun", "lamp", "led"])
def test_an_irradiance_and_its_illuminance_are_the_same_light(kind):
    lit = spectral_irradiance(Ambient(kind=kind, illuminance_lux=500.0), ALL_NM)
    total = float(np.trapezoid(lit, ALL_NM))
    assert np.allclose(spectral_irradiance(Ambient(kind=kind, irradiance_w_per_m2=total), ALL_NM), lit, rtol=1e-9)
    # Only an LED lamp has no infrared.
    assert (np.trapezoid(lit[ALL_NM > 800], ALL_NM[ALL_NM > 800]) < 1e-6 * total) == (kind == "led")


@pytest.mark.parametrize("rows", [None, ((940.0, 0.0), (943.0, 0.6), (947.0, 0.6), (950.0, 0.0))])
def test_a_photocurrent_is_the_whole_spectrums_whatever_lies_between_the_wavelengths_of_absorption(rows):
    photodiode = Photodiode(name="p", position_mm=(0.0, 0.0), responsivity=rows)
    nm = np.arange(380.0, 1100.01, 0.05)
    current = spectral_irradiance(SOURCES[0], nm) * optics.responsivity_a_per_w(photodiode, nm)
    total = photocurrent_a_per_mm2(SOURCES[0], photodiode).sum()
    assert total == pytest.approx(1e-6 * np.trapezoid(current, nm), rel=1e-3) and total > 1e-7


def test_scatter_of_traced_ambient_light_matches_its_standard_error(jit_backend, monkeypatch):
    """Four seeds: chi squared of 3 degrees of freedom below its 99.9 % quantile, at an error of less than 3 %."""
    monkeypatch.setattr("nailoptics.sensor.ambient.PHOTONS", 1 << 14)
    scene = parse_scene(covered(0))
    result = [trace_ambient(scene, SOURCES, TraceOptions(store=False), seed=seed) for seed in range(4)]
    current, error, bare = np.moveaxis(np.array(result)[..., 0], 1, 0)
    chi2 = (((current - current.mean(0)) / error) ** 2).sum(0)
    assert (chi2 < 16.3).all() and (error < 0.03 * current).all(), (chi2, error / current)
    assert (current < bare).all()


def test_a_face_in_a_denser_medium_collects_what_falls_on_its_area():
    """Of a Lambertian face's light in a medium of index 2 a quarter leaves, through the cone that no face reflects, and
    by the same cone all that falls on its area comes to it."""
    left = Arrivals(1000, np.arange(250), np.zeros((250, 2)), np.ones(250), np.zeros((250, 1), np.float32), np.zeros(1))
    each = left.from_outside(np.array([[0.3, 0.1]]), np.zeros((2, 1)), area_mm2=1.5, n=2.0)
    assert each.shape == (1, 250) and each.sum() == pytest.approx(1.5 * 0.4)


@pytest.mark.parametrize("count", [0, 1, 50])
def test_light_of_few_traced_photons_has_the_error_of_one_at_least(jit_backend, monkeypatch, count):
    scene = parse_scene(covered(0))
    no_path = np.zeros((count, len(optics.absorbers(scene))), np.float32)
    left = Arrivals(1000, np.arange(count), np.zeros((count, 2)), np.ones(count), no_path, np.zeros(no_path.shape[1]))
    monkeypatch.setattr(BoardTracer, "leaving", lambda *_, **__: left)
    traced = trace_ambient(scene, SOURCES, TraceOptions(store=False), seed=0, photons=1000)
    current, error, bare = traced[..., 0]
    if count == 0:
        assert (current == 0).all() and error == pytest.approx(bare / 1000)
    else:
        expected = current / count * max(np.sqrt(count * (1 - count / 1000)), 1.0)
        assert error == pytest.approx(expected, rel=1e-6)


def test_silicon_in_the_open_gives_the_short_circuit_current_of_full_sun():
    """A photodiode of 1 mm^2 in air whose light all leaves collects 1 mm^2 of sky.

    A silicon cell of perfect efficiency gives 44 mA/cm^2 in the standard sun of 1000 W/m^2, 110 klux, and air takes
    parts out of the sun's infrared that a black body has: 0.40 mA/mm^2 at 100 klux, within 15 %.
    """
    scene = parse_scene(covered(500)).model_copy()
    scene = scene.model_copy(update={"light": scene.light.model_copy(update={"index_steps": False})})
    no_path = np.zeros((10, len(optics.absorbers(scene))), np.float32)
    all_left = Arrivals(10, np.arange(10), np.zeros((10, 2)), np.ones(10), no_path, no_path[0])
    perfect = scene.photodiodes[0].model_copy(update={"quantum_efficiency": 1.0})
    bare, mu_a = photocurrent_a_per_mm2(SOURCES[0], perfect)[None], optics.absorption(scene, INSIDE_NM)
    each = all_left.from_outside(bare, mu_a, area_mm2=1.0, n=optics.index_around(scene, 800.0))
    assert each.sum() == pytest.approx(0.40e-3, rel=0.15)


@pytest.mark.slow
@pytest.mark.parametrize("cover", [500, 0])
def test_a_sky_of_the_other_engine_agrees_with_reciprocity(jit_backend, cover):
    """Rationale: what leaves the finger from the photodiode, times n^2 A E, must be what volpath collects of a sky.

    volpath's sky has radiance 1 from all sides, irradiance pi; its irradiance meter in the epoxy counts the n^2.
    Expected: agreement within 4 combined standard errors, of at most 5 %, with and without the cover.
    """
    scene = parse_scene(covered(cover))
    tracer = BoardTracer(scene)
    shape = tracer.tracer.geometry
    result = optics.finger_media(scene, shape.regions, 800.0)
    n = result.n[shape.regions.index("epoxy")]
    area, mu_a = shape.photodiodes[0].area_mm2, optics.absorption(scene, 800.0)
    each = []
    for seed in range(4):
        left = tracer.leaving(0, 0, photons=1 << 18, seed=seed)
        each.append(left.from_outside(np.ones((1, 1)), mu_a, area_mm2=area, n=n).sum())
    ours, error = np.mean(each), np.std(each, ddof=1) / 2
    low, high = np.asarray(shape.bounds_mm)[:, 1]
    v = np.linspace(low - 0.2, high + 0.2, 101)
    bed = mitsuba_scene.BedAbsorption(v, np.full((1, len(v)), result.mu_a[shape.regions.index("bed")]))
    with (
        readings.stock_mitsuba(backend.choose("auto", volpath=True)) as mi,
        tempfile.TemporaryDirectory() as folder,
    ):
        sensor = shape.photodiodes[0].region
        made = mitsuba_scene.finger_scene(mi, shape, result, bed, sensor=sensor, emitters={}, folder=Path(folder))
        made["sky"] = {"type": "constant", "radiance": {"type": "rgb", "value": [1.0, 1.0, 1.0]}}
        loaded = mi.load_dict(made, optimize=False)
        theirs = np.array([readings._render(mi, loaded, paths=1 << 14, seed=s)[0] for s in range(30)]) * area / np.pi
    spread = theirs.std(ddof=1) / np.sqrt(len(theirs))
    assert abs(theirs.mean() - ours) < 4 * np.hypot(error, spread), (theirs.mean(), spread, ours, error)
    assert error < 0.05 * ours and spread < 0.05 * ours
    assert check_watertight(shape, crossings=10_000).passed

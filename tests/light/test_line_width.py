"""The width of an LED's line, read from one trace, against traces at single wavelengths."""

import numpy as np
import pytest

import nailoptics as nail
from nailoptics import tissue
from nailoptics.assets import data_dir
from nailoptics.errors import InputError
from nailoptics.light import optics
from nailoptics.light.transfer.series import read_by_groups, read_replicates, readings_over_states
from nailoptics.light.transfer.transfer import rest_state
from nailoptics.scene import load_scene

PHOTONS = 150_000
# The outermost wavelengths of a line carry a hundredth of its light: a fifth of the photons is enough.
FEW_PHOTONS, LITTLE = 30_000, 0.05


@pytest.mark.jit
@pytest.mark.parametrize(
    "part", [pytest.param("led_660", marks=pytest.mark.long), pytest.param("led_940", marks=pytest.mark.slow)]
)
def test_a_line_read_from_one_trace_is_the_sum_of_narrow_band_traces(chosen_jit, part):
    """Expected: within 3.5 combined standard errors on each of four photodiodes, and within 1.5 % on their sum.

    Rationale: one trace scatters as at the peak and only absorbs as along the line; 42 nm at 940 nm and the steep
    edge of blood at 660 nm are the hardest of the shipped parts.
    """
    scene = nail.load_scene(data_dir("scenes") / "prototype.toml")
    led = nail.scene.Led(name="line", part=part, position_mm=(-1.2, 0.0))
    near = tuple(
        p.model_copy(update={"wired": (10, 12) if p.name == "proximal" else (3, 5)}) for p in scene.photodiodes
    )
    scene = scene.model_copy(update={"leds": (led,), "photodiodes": near})
    line = nail.trace(scene, photons=2 * PHOTONS, seed=2).at()
    total, variance = np.zeros(4), np.zeros(4)
    for k, (nm, share) in enumerate(zip(*optics.spectrum(led), strict=True)):
        narrow = led.model_copy(update={"wavelength_nm": float(nm), "fwhm_nm": 0.0})
        photons = FEW_PHOTONS if share < LITTLE else PHOTONS
        one = nail.trace(scene.model_copy(update={"leds": (narrow,)}), photons=photons, seed=2000 + k).at()
        total += share * one.detected_fraction.values[0]
        variance += (share * one.detected_fraction_stderr.values[0]) ** 2
    values, errors = (
        line.detected_fraction.values[0],
        np.hypot(line.detected_fraction_stderr.values[0], np.sqrt(variance)),
    )
    assert np.all(np.abs(values - total) < 3.5 * errors) and np.all(errors < 0.06 * total)
    assert abs(values.sum() / total.sum() - 1) < 0.015 + 3 * np.linalg.norm(errors) / total.sum()


@pytest.mark.long
@pytest.mark.jit
def test_a_line_is_weighed_by_each_photodiodes_own_responsivity(chosen_jit):
    """Rationale: a daylight filter's edge lies within the line, or a narrow band that leaves its peak out.
    Expected: photocurrents are sums of light times responsivity over 201 wavelengths of the line, of the same photons;
    light is read at five of them, which leaves half a percent."""
    scene = nail.load_scene(data_dir("scenes") / "prototype.toml")
    led = scene.leds[0].model_copy(update={"wavelength_nm": 800.0, "fwhm_nm": 40.0})
    rows = {0: ((780.0, 0.0), (800.0, 0.5), (1100.0, 0.6)), 1: ((806.0, 0.0), (810.0, 0.5), (822.0, 0.5), (826.0, 0.0))}
    changed = [one.model_copy(update={"responsivity": rows.get(i)}) for i, one in enumerate(scene.photodiodes)]
    scene = scene.model_copy(update={"leds": (led,), "photodiodes": tuple(changed)})
    transfer = nail.trace(scene, photons=PHOTONS, seed=3)
    rest = np.full((1, 2), scene.blood.rest_blood_fraction)
    fraction = readings_over_states(transfer, rest).fraction[0, :, 0]
    by_groups = read_by_groups(transfer, scene, rest)[0, 0, :, 0]
    nm = 800.0 + np.linspace(-100.0, 100.0, 201)
    line = np.exp(-4 * np.log(2) * ((nm - 800.0) / 40.0) ** 2)
    alone = [transfer.traces[0].moments(mu[None], np.ones(1), count=8).fraction for mu in optics.absorption(scene, nm)]
    at_nodes = optics.absorption(scene, optics.spectrum(led)[0])
    nodes = [transfer.traces[0].moments(mu[None], np.ones(1), count=8).fraction for mu in at_nodes]
    for j, photodiode in enumerate(scene.elements):
        of_nodes = optics.line_response(led, photodiode)
        expected = of_nodes @ np.array(nodes)[:, j]
        assert of_nodes.sum() * np.array([fraction[j], by_groups[j]]) == pytest.approx(expected, rel=1e-5)
        weight = line / line.sum() * optics.responsivity_a_per_w(photodiode, nm)
        response = optics.line_response(led, photodiode).sum()
        assert response == pytest.approx(weight.sum(), rel=2e-3) and response > 0
        assert response * np.array([fraction[j], by_groups[j]]) == pytest.approx(
            weight @ np.array(alone)[:, j], rel=5e-3
        )


@pytest.mark.jit
def test_mean_paths_are_weighted_by_the_bloods_absorption_over_the_line(chosen_jit):
    """Expected: minus the derivative of ln reading by a zone's blood, by central differences, over the blood's
    absorption averaged over the line. At 660 nm that falls to a third along a line of 40 nm."""
    scene = nail.load_scene(data_dir("scenes") / "prototype.toml")
    led = scene.leds[0].model_copy(update={"wavelength_nm": 660.0, "fwhm_nm": 40.0})
    scene = scene.model_copy(update={"leds": (led,)})
    transfer = nail.trace(scene, photons=FEW_PHOTONS, seed=3)
    wavelength, share = optics.detected_spectrum(led, scene.elements)
    blood = tissue.blood_mu_a_per_mm(wavelength, scene.blood.so2)
    rest = optics.absorption(scene, wavelength, so2=scene.blood.so2)
    step, states = 1e-4, [rest]
    for zone in optics.bed_columns(scene):
        for sign in (1, -1):
            changed = rest.copy()
            changed[:, zone] += sign * step * blood
            states.append(changed)
    reading, path_mm = (one[0] for one in read_replicates(transfer, 0, np.array(states), blood))
    derivative = np.log(reading[:, 2::2] / reading[:, 1::2]) / (2 * step)
    assert path_mm == pytest.approx(derivative / (share @ blood)[:, None], rel=1e-4)


@pytest.mark.parametrize(("wavelength_nm", "most"), [(410.0, 8), (980.0, 16)])
def test_a_line_wider_than_the_tables_is_refused(wavelength_nm, most):
    """Five nodes reach 2.0202 / (2 sqrt(ln 2)) = 1.2132 widths to each side: 8 of 10 nm, 16 of 20 nm."""
    scene = load_scene(data_dir("scenes") / "prototype.toml")
    led = scene.leds[0].model_copy(update={"wavelength_nm": wavelength_nm, "fwhm_nm": 5000.0})
    wide = scene.model_copy(update={"leds": (led,)})
    with pytest.raises(
        InputError, match=rf"leds\[0\]\.fwhm_nm = 5000: .*400 to 1000 nm; give at most {most}"
    ) as caught:
        rest_state(wide, 0)
    assert "\n" not in str(caught.value)
    for width in (float(most), 0.0):
        narrow = wide.model_copy(update={"leds": (led.model_copy(update={"fwhm_nm": width}),)})
        assert np.isfinite(rest_state(narrow, 0)[0]).all()
    with pytest.raises(InputError, match="fwhm_nm"):
        rest_state(wide.model_copy(update={"leds": (led.model_copy(update={"fwhm_nm": most + 1.0}),)}), 0)

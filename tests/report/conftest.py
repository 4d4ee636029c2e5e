"""Synthetic results in the form of a real one, for any LEDs, times and force."""

import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from nailoptics.scene import digest, parse_scene, to_toml

SCENES = Path(__file__).parents[2] / "scenes"
REGIONS = ("air", "plate", "bed", "bone", "pulp", "epoxy", "cover")


def synthetic(*, leds=1, times=41, swing=1.0, section=True):
    """A result of the prototype's board: proximal readings fall and distal ones rise with force, by `swing`."""
    text = (SCENES / "prototype.toml").read_text(encoding="utf-8")
    for i in range(1, leds):
        text += f'\n[[leds]]\nname = "led{i}"\nwavelength_nm = {600 + 100 * i}.0\nposition_mm = [-1.2, {i - 3.0}]\n'
    scene = parse_scene(text)
    rng = np.random.default_rng(5)
    time = np.linspace(0.0, 4.0, times) if times > 1 else np.array([0.5])
    force = np.where((time > 0.3) & (time < 2.3), 1.0, 0.0)
    zone_of = np.repeat([0, 1], 4)
    sign = np.where(zone_of == 0, -1.0, 1.0)
    rest = rng.uniform(0.05, 2.0, (leds, 8))
    volts = rest[..., None] + swing * (4e-3 * sign * rng.uniform(0.5, 1.5, (leds, 8)))[..., None] * force
    over, pair = ("led", "photodiode", "time"), ("led", "photodiode")
    data = {
        "force_n": ("time", force),
        "proximal_pressure_pa": ("time", 1e4 * force),
        "distal_pressure_pa": ("time", 1e4 * force),
        "capillary_diameter_m": (("zone", "time"), 8e-6 + 2e-6 * swing * np.outer([1, -1], force)),
        "vein_diameter_m": ("time", 1e-4 - 5e-5 * swing * force),
        "blood_fraction": (("zone", "time"), 0.03 + 0.02 * swing * np.outer([1, -1], force)),
        "detected_fraction": (over, volts * 1e-3),
        "detected_fraction_stderr": (over, volts * 1e-5),
        "volts": (over, volts),
        "volts_stderr": (over, 0.01 * volts),
        "volts_change": (over, volts - volts[..., :1]),
        "volts_change_stderr": (over, np.abs(volts - volts[..., :1]) * 0.02),
        "volts_noise_rms": (over, np.full(volts.shape, 2.2e-5)),
        "saturated": (over, np.zeros(volts.shape, bool)),
        "volts_beer_lambert": (over, volts + 1e-5 * swing),
        "volts_taylor": (over, volts - 3e-5 * swing),
        "mean_path_mm": ((*pair, "absorber"), rng.uniform(0.1, 4, (leds, 8, 3))),
        "mean_path_mm_stderr": ((*pair, "absorber"), np.full((leds, 8, 3), 0.01)),
        "zone_of_photodiode": ("photodiode", zone_of),
        "responsivity_a_per_w": (pair, np.full((leds, 8), 0.55)),
        "wavelength_nm": ("led", [led.wavelength_nm for led in scene.leds]),
        "fit_note": (pair, np.full((leds, 8), "", dtype="U40")),
    }
    for name in ("beer_lambert_v0_v", "beer_lambert_v1_v", "taylor_v0_v"):
        data[name], data[f"{name}_stderr"] = (pair, rest), (pair, 0.01 * rest)
    for name, size in (("beer_lambert_alpha_per_m2", 1e9), ("taylor_v1_v_per_m2", 1e8)):
        data[name], data[f"{name}_stderr"] = (pair, size * rest), (pair, np.full((leds, 8), np.inf))
    for name, size in (("beer_lambert", 1e-5), ("taylor", 3e-5)):
        data[f"{name}_residual_rms_v"] = (pair, np.full((leds, 8), size * swing))
    coords = {
        "led": [led.name for led in scene.leds],
        "photodiode": [f"proximal.{i}" for i in (6, 9, 12, 15)] + [f"distal.{i}" for i in (0, 3, 6, 9)],
        "zone": ["proximal", "distal"],
        "time": time,
        "absorber": ["plate", "bed_1", "bed_2"],
    }
    if section:
        y, z = np.linspace(-7, 7, 71), np.linspace(-5, 1.2, 32)
        region = np.digitize(z, [-2.15, -0.45, 0.0, 0.45, 0.97])
        region = np.array([3, 2, 1, 5, 6, 0])[region] * np.ones((len(y), 1), int)
        data["section_region"] = (("section_y", "section_z"), region, {"regions": json.dumps(REGIONS)})
        density = np.exp(-np.hypot(*np.meshgrid(y, z, indexing="ij")) * 2)
        data["path_density"] = (("led", "section_y", "section_z"), np.repeat(density[None], leds, 0))
        coords |= {"section_y": y, "section_z": z}
    attrs = {
        "scene": to_toml(scene),
        "digest": digest(scene),
        "engine": "photons",
        "backend": "llvm",
        "photons": 1_000_000,
        "seeds": "17",
        "versions": "nailoptics=0.1.0",
        "cpu_seconds": 3.0,
        "wall_seconds": 2.0,
        "accuracy_reached": "1 %",
    }
    return xr.Dataset(data, coords, attrs)


@pytest.fixture(scope="session")
def make():
    """The maker of results."""
    return synthetic

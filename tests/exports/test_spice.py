"""The circuit of a scene: ngspice has the volts over the touch and the noise that `simulate` has."""

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from small_scenes import finger

import nailoptics as nail
from nailoptics.cli import run
from nailoptics.scene import Scene, parse_scene
from nailoptics.sensor import electronics

TWO_LEDS = [{"name": "red", "part": "led_660"}, {"name": "ir", "position_mm": [1.2, 0.0]}]
PHOTODIODES = [{"name": "near", "position_mm": [0.0, -2.0]}, {"name": "far", "position_mm": [0.0, 3.0]}]
BEST, TOUCH = {"parameters": "best"}, {"profile": "ramp", "force_n": 1.5, "contact_area_mm2": 100.0}
SENSORS = {
    "resistors of 1 Mohm": {},
    "shot noise, ambient light and drift": {
        "electronics": {"feedback_ohm": 1e5, "adc_bits": 24},
        "ambient": {"illuminance_lux": 2000.0},
        "body.drift": {"led_per_rt_min": 0.003, "reading_per_rt_min": 0.002},
    },
    "resistors of each photodiode, warm": {"electronics": {"feedback_ohm": "auto", "temperature_k": 330.0}},
    "a fast amplifier with much capacitance": {
        "electronics": {"feedback_ohm": 2e5, "bandwidth_hz": 2e4, "capacitance_pf": 300.0, "adc_bits": 24}
    },
    "a noisy amplifier": {"electronics": {"feedback_ohm": 1e4, "noise_nv_per_rt_hz": 30.0, "adc_bits": 24}},
}


def sensor(tables: dict) -> Scene:
    """Two LEDs and two photodiodes, dim enough for every resistor."""
    leds = [led | {"flux_mw": 0.3} for led in TWO_LEDS]
    return parse_scene(finger(*PHOTODIODES, leds=leds, blood=BEST, touch=TOUCH, accuracy={"photons": 20_000}, **tables))


@pytest.fixture
def ngspice() -> str:
    """The simulator; without it the test is skipped, with the reason."""
    path = shutil.which("ngspice")
    if path is None:
        pytest.skip("ngspice is missing: apt install ngspice")
    return path


def measured(
    ngspice: str, circuit: Path, scene: Scene, result: xr.Dataset
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Volts (led, photodiode, time) of a circuit, its noise and that with the converter, (led, photodiode). [V]"""
    done = subprocess.run(
        [ngspice, "-b", circuit.name], cwd=circuit.parent, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    volts = np.empty(result.volts.shape)
    for i in range(len(scene.leds)):
        time_s, *columns = np.loadtxt(circuit.with_name(f"volts_led{i + 1}.txt"), skiprows=1).T
        volts[i] = [np.interp(result.time, time_s, column) for column in columns]
    noise = np.array(re.findall(r"noise (\S+) V, with the converter (\S+) V", done.stdout), float)
    return volts, *np.moveaxis(noise.reshape(*volts.shape[:2], 2), -1, 0)


@pytest.mark.jit
@pytest.mark.parametrize("tables", SENSORS.values(), ids=SENSORS)
def test_ngspice_reproduces_volts_and_noise(jit_backend, coarse_light, ngspice, tmp_path, tables):
    scene = sensor(tables)
    circuit = nail.export(scene, tmp_path / "board.cir")["circuit"]
    result = nail.simulate(scene.model_copy(update={"priors": scene.priors.model_copy(update={"spread": False})}))
    assert not result.saturated.any()
    volts, noise, with_converter = measured(ngspice, circuit, scene, result)
    # While the force changes, the circuit's filter is late.
    settled = np.abs(result.force_n - result.force_n.shift(time=20)).fillna(0).values == 0
    assert settled.sum() > 50 and result.force_n.values[settled].max() == 1.5
    assert volts[..., settled] == pytest.approx(result.volts.values[..., settled], rel=0.002)
    # The touch changes them by little.
    change, own_change = ((v - v[..., :1])[..., settled] for v in (volts, result.volts.values))
    assert np.abs(change - own_change).max(-1) == pytest.approx(0.0, abs=0.02 * np.ptp(own_change, axis=-1).min())
    own_v = result.volts_noise_rms.values[..., 0]
    adc_v = electronics.lsb_v(scene.electronics) / np.sqrt(12)
    assert noise == pytest.approx(np.sqrt(own_v**2 - adc_v**2), rel=0.02)
    assert with_converter == pytest.approx(own_v, rel=0.02)


@pytest.mark.parametrize(
    ("scene", "file", "how", "why"),
    [
        ("phantom", "board.cir", [], "has no mesh, board or touch; export a scene with [finger]"),
        ("prototype", "board.net", ["--format", "spice"], "ends in .cir or .sp; rename it"),
        ("prototype", "there.txt/board.sp", [], "cannot be written"),
    ],
)
def test_what_cannot_be_written_is_one_line_before_light_is_traced(tmp_path, capfd, scene, file, how, why):
    (tmp_path / "there.txt").write_text("mine", encoding="utf-8")
    assert run(["export", scene, "-o", str(tmp_path / file), *how]) == 2
    out = capfd.readouterr()
    assert out.err.count("\n") == 1 and why in out.err and not out.out
    assert [one.name for one in tmp_path.iterdir()] == ["there.txt"]

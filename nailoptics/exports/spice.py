"""The circuit of a scene for ngspice: LED currents, photodiodes as current sources over its touch, and amplifiers."""

import logging
from pathlib import Path
from string import Template
from typing import Unpack

import numpy as np
import xarray as xr

from ..errors import as_far_as_reached
from ..io import write_text
from ..options import Requested
from ..scene import Led, Scene
from ..sensor import electronics
from ..sensor.volts import reading_gain
from ..studies.simulate import simulate
from ..version import __version__

log = logging.getLogger(__name__)

# An LED whose current the scene does not have emits its flux at this one. [mA]
STAND_IN_MA = 1.0
# Gain-bandwidth product of an amplifier, more where its stage would limit the bandwidth. [Hz]
USUAL_GBW_HZ = 1e6
# The stage's own bandwidth is at least so many times the noise bandwidth, which it then changes by 1e-3.
STAGE_BANDWIDTHS = 30.0
# Noise is integrated from and to so many times the bandwidth, beyond which the filter leaves less than 1e-6 of it.
NOISE_FROM, NOISE_TO = 1e-6, 1e2


def write_spice(scene: Scene, path: Path, **requested: Unpack[Requested]) -> dict[str, Path]:
    """Simulate a scene's touch and write its circuit for ngspice, traced as requested; returns the path by what it is.

    Raises: WriteError; InputError as `simulate`.
    """
    certain = scene.model_copy(update={"priors": scene.priors.model_copy(update={"spread": False})})
    result, unmet = as_far_as_reached(simulate, certain, **requested)
    if unmet:
        log.warning("%s", unmet)
    stage = scene.electronics
    values = {
        "boltzmann": electronics.BOLTZMANN_J_PER_K,
        "charge": electronics.ELEMENTARY_CHARGE_C,
        "kelvin": stage.temperature_k,
        "celsius": stage.temperature_k - 273.15,
        "bandwidth": stage.bandwidth_hz,
        "en": 1e-9 * stage.noise_nv_per_rt_hz,
        "duration": float(result.time[-1] - result.time[0]),
    }
    leds = range(len(scene.leds))
    parts = [line for i in leds for line in _led(scene, result, i)]
    parts += [line for j in range(result.sizes["photodiode"]) for line in _photodiode(scene, result, j)]
    runs = [line for i in leds for line in _run(scene, result, i)]
    page = Template(Path(__file__).with_name("spice.cir").read_text(encoding="utf-8"))
    rows = {name: f"{value:.10g}" for name, value in values.items()}
    write_text(path, page.substitute(rows, version=__version__, circuit="\n".join(parts), runs="\n".join(runs)))
    return {"circuit": path}


def _drive_a(led: Led) -> float:
    """The LED's current. [A]"""
    return 1e-3 * (led.current_ma or STAND_IN_MA)


def _led(scene: Scene, result: xr.Dataset, i: int) -> list[str]:
    """An LED's drive, and its current transfer ratio to every photodiode over the touch."""
    led, time_s = scene.leds[i], result.time.values - result.time.values[0]
    note = "" if led.current_ma else f", for which {STAND_IN_MA:g} mA stands: the scene has no current_ma"
    lines = [f"* LED {led.name}: {led.flux_mw:g} mW{note}. Replace by its driver; Vled measures its current."]
    lines += [f"Iled{i + 1} 0 led{i + 1} DC {_drive_a(led) if i == 0 else 0:g}", f"Vled{i + 1} led{i + 1} 0 0"]
    per_fraction_a = electronics.photocurrent_a(1.0, led, scene.elements)
    fraction = (result.detected_fraction.values * reading_gain(result))[i]
    for j, ratio in enumerate(fraction * per_fraction_a[:, None] / _drive_a(led), start=1):
        lines += [f"Vratio{i + 1}_{j} ratio{i + 1}_{j} 0 PWL("]
        lines += [f"+ {t:.9g} {value:.7g}" for t, value in zip(time_s, ratio, strict=True)] + ["+ )"]
    return lines


def _photodiode(scene: Scene, result: xr.Dataset, j: int) -> list[str]:
    """A photodiode with its photocurrent, amplifier and filter."""
    stage, diode, k = scene.electronics, scene.layout.photodiodes[j].photodiode, j + 1
    steady_a = diode.dark_current_a(stage.temperature_k) + float(result.ambient_a[j] if "ambient_a" in result else 0)
    light = [f"1e6*v(ratio{i}_{k})*i(Vled{i})" for i in range(1, len(scene.leds) + 1)]
    farad, ohm = 1e-12 * (stage.capacitance_pf + diode.capacitance_pf), float(result.feedback_ohm[j])
    least_hz = 2 * np.pi * ohm * farad * (STAGE_BANDWIDTHS * stage.bandwidth_hz) ** 2
    return [
        f"* Photodiode {result.photodiode.values[j]}",
        f"Blight{k} light{k} 0 V={1e6 * steady_a:.9g}",
        *(f"+ +{one}" for one in light),
        f"Itest{k} 0 in{k} DC 0 AC 1",
        f"Xstage{k} light{k} in{k} amplified{k} stage rf={ohm:g} cin={farad:g} rsh={1e6 * diode.shunt_mohm:g} "
        f"gbw={max(USUAL_GBW_HZ, least_hz):g}",
        f"Xfilter{k} amplified{k} out{k} filter",
    ]


def _run(scene: Scene, result: xr.Dataset, i: int) -> list[str]:
    """Commands that light one LED, and write volts over the touch and print the noise at its start."""
    time_s, stage = result.time.values - result.time.values[0], scene.electronics
    names = [f"out{j + 1}" for j in range(result.sizes["photodiode"])]
    sweep = f"dec 50 {NOISE_FROM * stage.bandwidth_hz:g} {NOISE_TO * stage.bandwidth_hz:g}"
    lines = [f"alter Iled{i} DC = 0"] if i else []
    lines += [f"alter Iled{i + 1} DC = {_drive_a(scene.leds[i]):g}", f"tran {time_s[1]:.9g} {time_s[-1]:.9g}"]
    lines += [f"wrdata volts_led{i + 1}.txt " + " ".join(f"v({name})" for name in names)]
    for j, name in enumerate(names, start=1):
        lines += [f"noise v({name}) Itest{j} {sweep}"]
        lines += [f"let total = sqrt(onoise_total^2 + {electronics.lsb_v(stage) ** 2 / 12:g})"]
        lines += [
            f'echo "LED {scene.leds[i].name}, photodiode {result.photodiode.values[j - 1]}: noise $&onoise_total V, '
            'with the converter $&total V"'
        ]
    return lines

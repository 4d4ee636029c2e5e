"""The main job: touch, blood, traced light, volts, beside the paper's reduced optics (8) and (9)."""

from collections.abc import Callable
from typing import Any, Unpack

import numpy as np
import xarray as xr

from .. import electronics
from ..errors import InputError, NotReachedError
from ..light import Light, Progress, open_light
from ..options import Requested, TraceOptions
from ..paper import reduced_optics
from ..scene import Scene
from ..scene.layout import lay_out
from .blood_states import blood_over_touch, zones_of_photodiodes

COORDINATES = {
    "time": "time from the start of the simulation",
    "led": "LED",
    "photodiode": "photodiode",
    "absorber": "absorbing region or blood zone",
}


def simulate(
    scene: Scene,
    *,
    progress: Callable[[Progress], None] | None = None,
    **requested: Unpack[Requested],
) -> xr.Dataset:
    """Simulate a touch on a finger scene, from force to the volts of every photodiode.

    Returns: Dataset over led, photodiode, zone and time with the force, pressures, vessel diameters, blood, detected
    fraction and volts, each estimate with its standard error, the fits of (8) and (9), and the traced section.

    Raises: InputError; NotReachedError, whose result is the Dataset as far as the accuracy went.
    """
    options = TraceOptions(**requested)
    if scene.finger is None:
        raise InputError("simulate needs a [finger] scene; a [phantom] has no blood, use trace for its light.")
    course = blood_over_touch(scene)
    blood = course.blood_fraction.values.T
    unmet = None
    try:
        light = open_light(scene, states=blood, progress=progress, **requested)
    except NotReachedError as error:
        if not isinstance(error.result, Light):
            raise
        light, unmet = error.result, error
    result = simulate_from(scene, light, course=course, seed=options.seed)
    if unmet:
        raise NotReachedError(str(unmet), result=result) from None
    return result


def simulate_from(scene: Scene, light: Light, *, course: xr.Dataset, seed: int) -> xr.Dataset:
    """What `simulate` returns, from light that is already traced and the scene's `blood_over_touch`."""
    result = course.merge(_volts(scene, light, course.blood_fraction.values.T))
    result = result.merge(_reduced(scene, result))
    result = result.merge(light.section)
    for name, text in COORDINATES.items():
        result[name].attrs = {"long_name": text} | result[name].attrs
    result.attrs = light.attributes | {
        "seed": seed,
        "title": "nailoptics: touch to volts",
        "references": "S. A. Mascaro, H. H. Asada, IEEE Trans. Robotics and Automation 17(5), 2001",
    }
    return result


def _volts(scene: Scene, light: Light, blood: np.ndarray) -> xr.Dataset:
    """Detected fractions and volts over the course, with standard errors and noise."""
    layout = lay_out(scene)
    readings = light.over(blood)
    shape = readings.fraction.shape
    volts, change, noise, saturated = (np.zeros(shape) for _ in range(4))
    volts_stderr, change_stderr = np.zeros(shape), np.zeros(shape)
    responsivity = np.zeros(shape[:2])
    for i, led in enumerate(scene.leds):
        for j, element in enumerate(layout.photodiodes):
            diode = scene.photodiodes[element.entry]
            responsivity[i, j] = electronics.responsivity_a_per_w(led.wavelength_nm, diode.quantum_efficiency)
            read = electronics.read(
                readings.fraction[i, j] * led.flux_mw * 1e-3,
                responsivity=responsivity[i, j],
                amplifier=scene.electronics,
                dark_current_na=diode.dark_current_na,
                shunt_ohm=diode.shunt_mohm * 1e6,
            )
            per_fraction = led.flux_mw * 1e-3 * responsivity[i, j] * scene.electronics.feedback_ohm
            volts[i, j], noise[i, j], saturated[i, j] = read.volts, read.volts_noise_rms, read.saturated
            volts_stderr[i, j] = readings.stderr[i, j] * per_fraction
            change[i, j] = read.volts - read.volts[0]
            change_stderr[i, j] = readings.change_stderr[i, j] * per_fraction
    over, pair = ("led", "photodiode", "time"), ("led", "photodiode")
    return xr.Dataset(
        {
            "detected_fraction": (
                over,
                readings.fraction,
                _of("1", "detected fraction of the emitted power", True, "detected_fraction"),
            ),
            "detected_fraction_stderr": (over, readings.stderr, _of("1", "standard error of the detected fraction")),
            "volts": (over, volts, _of("V", "photodiode voltage", True, "volts")),
            "volts_stderr": (over, volts_stderr, _of("V", "standard error of the voltage (light tracing)")),
            "volts_change": (over, change, _of("V", "change of the voltage from the start", True, "volts_change")),
            "volts_change_stderr": (over, change_stderr, _of("V", "standard error of the change (light tracing)")),
            "volts_noise_rms": (over, noise, _of("V", "electronic noise of one reading, rms")),
            "saturated": (over, saturated.astype(bool), _of("1", "converter at its limit")),
            "responsivity_a_per_w": (pair, responsivity, _of("A W-1", "responsivity at the LED's peak")),
            "mean_path_mm": (
                (*pair, "absorber"),
                light.mean_path,
                _of("mm", "mean path of the light detected at rest", True, "mean_path_mm"),
            ),
            "mean_path_mm_stderr": (
                (*pair, "absorber"),
                light.mean_path_stderr,
                _of("mm", "standard error of the mean path"),
            ),
            "zone_of_photodiode": (
                "photodiode",
                zones_of_photodiodes(scene),
                _of("1", "blood zone above which it lies, 0 proximal"),
            ),
            "wavelength_nm": ("led", [led.wavelength_nm for led in scene.leds], _of("nm", "peak wavelength")),
        },
        coords={
            "led": [led.name for led in scene.leds],
            "photodiode": [element.area.name for element in layout.photodiodes],
            "absorber": list(light.absorbers),
        },
    )


def _reduced(scene: Scene, result: xr.Dataset) -> xr.Dataset:
    """Beer-Lambert (8) and Taylor (9), each fitted to the volts of every photodiode over its own zone's diameter."""
    leds, photodiodes, times = result.volts.shape
    curves = {name: np.zeros((leds, photodiodes, times)) for name in ("beer_lambert", "taylor")}
    names = {"beer_lambert": ("v0_v", "v1_v", "alpha_per_m2"), "taylor": ("v0_v", "v1_v_per_m2")}
    table: dict[str, np.ndarray] = {}
    for model, fields in names.items():
        for field in (*fields, *(f"{f}_stderr" for f in fields), "residual_rms_v", "residual_max_v"):
            table[f"{model}_{field}"] = np.zeros((leds, photodiodes))
    notes = np.full((leds, photodiodes), "", dtype=object)
    for i in range(leds):
        for j in range(photodiodes):
            diameter = result.capillary_diameter_m.values[int(result.zone_of_photodiode[j])]
            volts = result.volts.values[i, j]
            for model, fit in (
                ("beer_lambert", reduced_optics.fit_beer_lambert),
                ("taylor", reduced_optics.fit_taylor),
            ):
                found: Any = fit(diameter, volts)
                curves[model][i, j] = found.predict(diameter)
                for field, error in zip(names[model], found.stderr, strict=True):
                    table[f"{model}_{field}"][i, j] = getattr(found, field)
                    table[f"{model}_{field}_stderr"][i, j] = error
                table[f"{model}_residual_rms_v"][i, j] = found.residual_rms_v
                table[f"{model}_residual_max_v"][i, j] = found.residual_max_v
                if found.note:
                    notes[i, j] = found.note
    units = {
        "v0_v": "V",
        "v1_v": "V",
        "alpha_per_m2": "m-2",
        "v1_v_per_m2": "V m-2",
        "residual_rms_v": "V",
        "residual_max_v": "V",
    }
    data: dict[str, Any] = {
        "volts_beer_lambert": (
            ("led", "photodiode", "time"),
            curves["beer_lambert"],
            _of("V", "Beer-Lambert (8), fitted"),
        ),
        "volts_taylor": (("led", "photodiode", "time"), curves["taylor"], _of("V", "Taylor (9), fitted")),
        "fit_note": (("led", "photodiode"), notes.astype(str), {"long_name": "what the fit could not determine"}),
    }
    for name, values in table.items():
        field = name.removeprefix("beer_lambert_").removeprefix("taylor_").removesuffix("_stderr")
        data[name] = (("led", "photodiode"), values, _of(units[field], name.replace("_", " ")))
    return xr.Dataset(data)


def _of(units: str, long_name: str, has_error: bool = False, name: str = "") -> dict[str, str]:
    attributes = {"units": units, "long_name": long_name}
    return attributes | {"ancillary_variables": f"{name}_stderr"} if has_error else attributes

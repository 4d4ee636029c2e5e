"""What a batch keeps of a scene: its readings as a dataset, and that dataset as a record."""

import math

import numpy as np
import xarray as xr

from ..errors import as_far_as_reached
from ..light import Transfer
from ..light.detect import light_of
from ..light.transfer import photodiode_names
from ..options import TraceOptions
from ..scene import Scene
from ..scene.sweep import StudyName
from ..variables import Variable, variable

PAIR = ("led", "photodiode")


def of_transfer(transfer: Transfer, study: StudyName, *, seed: int) -> xr.Dataset:
    """The simulated touch of a finger; of a phantom, or where light alone is asked for, the readings at rest."""
    if study == "trace" or transfer.scene.phantom is not None:
        return _at_rest(transfer)
    return _simulate(transfer, seed)


def relative_error(dataset: xr.Dataset) -> float:
    """Largest relative standard error at rest; inf where a photodiode has seen nothing, or too little for one."""
    fraction, stderr = dataset["detected_fraction_rest"].values, dataset["detected_fraction_rest_stderr"].values
    if np.any(fraction <= 0) or np.any(np.isnan(stderr)):
        return math.inf
    return float(np.max(stderr / fraction, initial=0.0))


def _at_rest(transfer: Transfer) -> xr.Dataset:
    rest, energy = transfer.at(), transfer.energy()
    kept = {name: rest.variables[name] for name in ("effective_photons", "mean_path_mm", "mean_path_mm_stderr")}
    fraction, pair = rest.variables["detected_fraction"], {"ancillary_variables": "detected_fraction_rest_stderr"}
    value, stderr = ([part[name] for part in energy.values()] for name in ("value", "stderr"))
    # One constructor: every further step of xarray costs as much as a small trace.
    return xr.Dataset(
        {
            "detected_fraction_rest": (fraction.dims, fraction.values, fraction.attrs | pair),
            "detected_fraction_rest_stderr": rest.variables["detected_fraction_stderr"],
            **kept,
            "wavelength_nm": rest.variables["wavelength_nm"],
            **variable("energy", "part", value, "share of the emitted power", stderr=stderr),
        },
        coords={"part": list(energy)} | {name: rest.variables[name] for name in ("led", "photodiode", "absorber")},
        attrs=rest.attrs,
    )


def _simulate(transfer: Transfer, seed: int) -> xr.Dataset:
    from ..hemodynamics.for_scene import blood_over_touch
    from ..studies.simulate import simulate_from

    course = blood_over_touch(transfer.scene)
    return _summarised(simulate_from(transfer.scene, light_of(transfer), course=course, seed=seed))


def _summarised(result: xr.Dataset) -> xr.Dataset:
    """A simulated touch with the numbers that a sweep is about: at the start, and where it changes most."""
    start, peak = result.isel(time=0), result.isel(time=abs(result.volts_change).argmax("time"))

    def of(moment: xr.Dataset, source: str, name: str, text: str) -> dict[str, Variable]:
        values, stderr = moment[source].transpose(*PAIR), None
        if f"{source}_stderr" in moment:
            stderr = moment[f"{source}_stderr"].transpose(*PAIR).values
        return variable(name, PAIR, values.values, text, units=values.attrs["units"], stderr=stderr)

    saturated = result.saturated.any("time").values
    return result.assign(
        of(start, "detected_fraction", "detected_fraction_rest", "detected fraction at the start")
        | of(start, "volts", "volts_start", "voltage at the start")
        | of(peak, "volts_change", "volts_change_peak", "largest change of the voltage")
        | of(peak, "volts_noise_rms", "volts_noise_peak", "electronic noise at the largest change, rms")
        | variable("saturated_ever", PAIR, saturated, "converter at its limit at any time")
    )


def by_volpath(scene: Scene, options: TraceOptions, study: StudyName) -> tuple[xr.Dataset, int, bool]:
    """The same from volpath, which traces every scene anew: the dataset, its photons, and whether it is accurate."""
    if study == "simulate" and scene.finger is not None:
        from ..studies.simulate import simulate

        result, unmet = as_far_as_reached(simulate, scene, **options.fields)
        kept = [name for name in result.variables if not str(name).startswith(("section_", "path_density"))]
        return _summarised(result[kept]), int(result.attrs["photons"]), not unmet
    from ..light import read_rest

    rest, unmet = as_far_as_reached(read_rest, scene, **options.fields)
    names = photodiode_names(scene)
    fraction, stderr = (
        np.reshape([row[column] for row in rest.readings], (len(scene.leds), len(names)))
        for column in ("detected_fraction", "stderr")
    )
    text = "detected fraction of the emitted power"
    dataset = xr.Dataset(
        variable("detected_fraction_rest", PAIR, fraction, text, stderr=stderr),
        coords={"led": [led.name for led in scene.leds], "photodiode": list(names)},
        attrs={"engine": "volpath", "backend": rest.backend},
    )
    return dataset, rest.photons, not unmet

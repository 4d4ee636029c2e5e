"""The readings of each photodiode during a touch: rest, change at the end of the hold, noise, resolution."""

import math
from dataclasses import dataclass
from itertools import product

import numpy as np
import xarray as xr

from ..scene import Scene
from ..studies.simulate import hold_end
from . import style


@dataclass(frozen=True)
class Reading:
    """One photodiode under one LED."""

    led: str
    photodiode: str
    led_index: int
    photodiode_index: int
    zone: str
    distance_mm: float
    rest_v: float
    rest_stderr_v: float
    noise_rms_v: float
    change_v: float
    change_stderr_v: float
    peak_v: float
    peak_stderr_v: float
    peak_s: float
    force_change_n: float
    saturated: bool
    rest_spread: float = math.nan
    change_spread: float = math.nan

    @property
    def spreads_v(self) -> dict[str, float]:
        """Standard deviations of reading and change over the priors of the finger; empty where not requested. [V]"""
        spreads = {"start_spread": abs(self.rest_v) * self.rest_spread}
        spreads["change_spread"] = abs(self.change_v) * self.change_spread
        return {} if math.isnan(self.rest_spread) else spreads

    @property
    def change_percent(self) -> float:
        """Change at the end of the hold, in percent of the reading at rest."""
        return 100 * self.change_v / self.rest_v if self.rest_v else float("nan")

    @property
    def sigmas(self) -> float:
        """Change in standard errors of the trace: the z score of its sign."""
        return _ratio(abs(self.change_v), self.change_stderr_v)

    @property
    def signal_to_noise(self) -> float:
        """Change over the electronics' noise of one sample."""
        return _ratio(abs(self.change_v), self.noise_rms_v)

    @property
    def resolution_n(self) -> float:
        """Force that one sample resolves: noise over the mean slope from rest to hold; NaN without a touch. [N]"""
        if not self.force_change_n:
            return float("nan")
        return _ratio(self.noise_rms_v * abs(self.force_change_n), abs(self.change_v))


def _ratio(value: float, by: float) -> float:
    if by > 0:
        return value / by
    return float("inf") if value > 0 else float("nan")


def photodiode_readings(result: xr.Dataset, scene: Scene | None) -> list[Reading]:
    """Every LED and photodiode, LED by LED, photodiodes from proximal to distal."""
    rest, held = result.isel(time=0), result.isel(time=hold_end(result))
    # Pair by pair, as of a million samples each copy of all readings is large.
    swings = [[int(np.nanargmax(np.abs(one))) for one in of_led] for of_led in result.volts_change]
    largest = xr.DataArray(swings, dims=("led", "photodiode"))
    peak = result[["volts_change", "volts_change_stderr"]].isel(time=largest)
    names = {"rest_spread": "reading_spread", "change_spread": "change_spread"}
    spreads = {field: result[name].values for field, name in names.items() if name in result}
    found = []
    for i, j in product(range(result.sizes["led"]), order_along_nail(scene, result.sizes["photodiode"])):
        distance_mm = math.nan
        if scene is not None:
            distance_mm = math.dist(scene.layout.leds[i].center_mm, scene.layout.photodiode_areas[j].center_mm)
        found.append(
            Reading(
                led=str(result.led.values[i]),
                photodiode=str(result.photodiode.values[j]),
                led_index=i,
                photodiode_index=j,
                zone=str(result.zone.values[int(result.zone_of_photodiode[j])]),
                distance_mm=distance_mm,
                rest_v=float(rest.volts[i, j]),
                rest_stderr_v=float(rest.volts_stderr[i, j]),
                noise_rms_v=float(held.volts_noise_rms[i, j]),
                change_v=float(held.volts_change[i, j]),
                change_stderr_v=float(held.volts_change_stderr[i, j]),
                peak_v=float(peak.volts_change[i, j]),
                peak_stderr_v=float(peak.volts_change_stderr[i, j]),
                peak_s=float(result.time[largest[i, j]]),
                force_change_n=float(held.force_n - rest.force_n),
                saturated=bool(result.saturated[i, j].any()),
                **{name: float(values[i, j]) for name, values in spreads.items()},
            )
        )
    return found


def led_name(result: xr.Dataset, led: int) -> str:
    """An LED with its wavelength."""
    return f"LED {result.led.values[led]}, {float(result.wavelength_nm[led]):g} nm"


def order_along_nail(scene: Scene | None, count: int) -> list[int]:
    """Indices of so many photodiodes from the most proximal to the most distal; as they come where no scene says."""
    if scene is None:
        return list(range(count))
    areas = scene.layout.photodiode_areas
    return sorted(range(count), key=lambda j: areas[j].center_mm[1])


def coloured_along_nail(scene: Scene | None, count: int) -> list[tuple[str, int]]:
    """Colour and index of each of so many photodiodes, from the most proximal to the most distal."""
    return list(zip(style.place_colours(count), order_along_nail(scene, count), strict=True))

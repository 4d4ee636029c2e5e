"""What each photodiode tells about the touch: rest, change at the end of the hold, noise, resolution."""

import math
from dataclasses import dataclass

import numpy as np
import xarray as xr

from ..scene import Scene


def hold_end(result: xr.Dataset) -> int:
    """Index of the end of the hold: the last sample whose force is (nearly) as far from the first as any."""
    departure = np.abs(result.force_n.to_numpy() - float(result.force_n[0]))
    return int(np.flatnonzero(departure >= 0.995 * departure.max())[-1])


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
    force_change_n: float
    saturated: bool

    @property
    def change_percent(self) -> float:
        """Change at the end of the hold, in percent of the reading at rest."""
        return 100 * self.change_v / self.rest_v if self.rest_v else float("nan")

    @property
    def sigmas(self) -> float:
        """Change in standard errors of the trace: how sure its sign is."""
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


def change_v(result: xr.Dataset) -> tuple[np.ndarray, np.ndarray, bool]:
    """Change of every reading from rest and its standard error, (led, photodiode, time) each; whether that is a bound.

    All times are read from one trace and share its noise, so the error of a change is far less than that of a reading;
    `volts_change_stderr` holds it. Without that variable the two errors are added as if independent: an upper bound.
    """
    bounded = "volts_change_stderr" not in result
    names = ("volts", "volts_stderr" if bounded else "volts_change_stderr")
    volts, stderr = (result[name].transpose("led", "photodiode", "time").to_numpy() for name in names)
    change = volts - volts[..., :1]
    if not bounded:
        return change, stderr, False
    bound = np.sqrt(stderr**2 + stderr[..., :1] ** 2)
    bound[..., 0] = 0.0
    return change, bound, True


def photodiode_readings(result: xr.Dataset, scene: Scene | None) -> list[Reading]:
    """Every LED and photodiode, LED by LED, photodiodes from proximal to distal."""
    hold = hold_end(result)
    change, change_stderr, _ = change_v(result)
    at_rest, at_hold = result.isel(time=0), result.isel(time=hold)
    moved_n = float(at_hold.force_n - at_rest.force_n)
    centres = centres_mm(result, scene)
    saturated = result.saturated.any("time")
    found = []
    for i, led in enumerate(result.led.values):
        for j in order_along_nail(result, scene):
            found.append(
                Reading(
                    led=str(led),
                    photodiode=str(result.photodiode.values[j]),
                    led_index=i,
                    photodiode_index=j,
                    zone=str(result.zone.values[int(result.zone_of_photodiode[j])]),
                    distance_mm=float(np.linalg.norm(centres[0][i] - centres[1][j])) if centres else math.nan,
                    rest_v=float(at_rest.volts[i, j]),
                    rest_stderr_v=float(at_rest.volts_stderr[i, j]),
                    noise_rms_v=float(at_hold.volts_noise_rms[i, j]),
                    change_v=float(change[i, j, hold]),
                    change_stderr_v=float(change_stderr[i, j, hold]),
                    force_change_n=moved_n,
                    saturated=bool(saturated[i, j]),
                )
            )
    return found


def led_name(result: xr.Dataset, led: int) -> str:
    """An LED with its wavelength."""
    return f"LED {result.led.values[led]}, {float(result.wavelength_nm[led]):g} nm"


def centres_mm(result: xr.Dataset, scene: Scene | None) -> tuple[np.ndarray, np.ndarray] | None:
    """Centres of LEDs and of photodiodes on the board, (n, 2) each; None where the scene is not the result's. [mm]"""
    if scene is None or scene.finger is None:
        return None
    leds = np.array([r.center_mm for r in scene.layout.leds])
    photodiodes = np.array([e.area.center_mm for e in scene.layout.photodiodes])
    fits = len(leds) == result.sizes["led"] and len(photodiodes) == result.sizes["photodiode"]
    return (leds, photodiodes) if fits else None


def order_along_nail(result: xr.Dataset, scene: Scene | None) -> list[int]:
    """Indices of the photodiodes from the most proximal to the most distal."""
    centres = centres_mm(result, scene)
    if centres is None:
        return list(range(result.sizes["photodiode"]))
    return [int(i) for i in np.argsort(centres[1][:, 1], kind="stable")]

"""One trace read in many states, with and without each group of its photons: errors of whatever is made from them."""

from dataclasses import dataclass

import numpy as np

from ..light import Transfer, optics

GROUPS = 40
# Photons read at once; with a few hundred states their weights fill the processor's cache, not the memory.
CHUNK = 8192


@dataclass(frozen=True)
class LedReadings:
    """One LED's readings in many states; in replicate 0 by all photons, in each other without one group of them.

    reading : (1 + groups, photodiodes, states) float. Fraction of the emitted power, weighed by the photodiode's
        response relative to that at the LED's peak.
    mean_path_mm : (1 + groups, photodiodes, zones) float. In the first state, minus the derivative of ln reading by the
        absorption of the blood in each zone, averaged over the line: the mean path there. [mm]
    """

    reading: np.ndarray
    mean_path_mm: np.ndarray


def read_led(transfer: Transfer, led: int, mu_a: np.ndarray, blood_per_mm: np.ndarray, *, seed: int) -> LedReadings:
    """Read one LED's trace in many states.

    mu_a : (states, q, absorbers) float. Absorption over the LED's line, `optics.spectrum`. [mm^-1]
    blood_per_mm : (q,) float. Absorption of the blood over the line, in the first state. [mm^-1]
    seed : of the photons' groups.
    """
    trace, source = transfer.traces[led], transfer.scene.leds[led]
    wavelength, share = optics.spectrum(source)
    share = share * wavelength / source.wavelength_nm
    mean = float(share @ blood_per_mm / share.sum())
    zones = list(optics.bed_columns(transfer.scene))
    count = len(transfer.photodiodes)
    weight = np.zeros((count, GROUPS, len(mu_a)))
    path = np.zeros((count, GROUPS, len(zones)))
    groups = np.random.default_rng(seed).integers(GROUPS, size=len(trace.weight))
    numbers = np.arange(GROUPS)[:, None]
    for j in range(count):
        mine = np.flatnonzero(trace.photodiode == j)
        for start in range(0, len(mine), CHUNK):
            chunk = mine[start : start + CHUNK]
            lengths = trace.path_mm[chunk].astype(float)
            own, slope = np.zeros((len(chunk), len(mu_a))), np.zeros(len(chunk))
            for q, part in enumerate(share):
                seen = part * np.exp(-(lengths @ (mu_a[:, q] - trace.mu_a).T)) * trace.weight[chunk, None]
                own += seen
                slope += seen[:, 0] * blood_per_mm[q] / mean
            picks = (groups[chunk] == numbers).astype(float)
            weight[j] += picks @ own
            path[j] += picks @ (slope[:, None] * lengths[:, zones])
    total, path_sum = (_left_out(sums) / trace.photons for sums in (weight, path))
    with np.errstate(invalid="ignore", divide="ignore"):
        return LedReadings(reading=total, mean_path_mm=path_sum / total[:, :, :1])


def _left_out(sums: np.ndarray) -> np.ndarray:
    """Sums over all groups, then over all but one of them, scaled up to as many photons: (1 + groups, ...)."""
    sums = np.moveaxis(sums, 1, 0)
    total = sums.sum(0)
    return np.concatenate([total[None], (total - sums) * (GROUPS / (GROUPS - 1))])

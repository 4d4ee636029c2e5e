"""What the pulse makes of traced light at any saturation: ac and dc, and the ratio of ratios, from one trace."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ... import tissue
from ...errors import InputError
from ...light import Transfer, optics
from ...light.course import read_replicates
from ...scene import Scene
from ...statistics import jackknife
from .beating_blood import BloodBeat

Array = NDArray[np.float64]

# Readings are smooth in the saturation: over half of its range polynomials of this many nodes miss them by 1e-6.
NODES = 6


@dataclass(frozen=True)
class Pulsation:
    """Pulsating and steady light of the red and the infrared LED, by all photons and without each group of them.

    ac, dc : (1 + groups, 2, photodiodes, states) float. Parts of the LED's power, weighed by the photodiode's response;
        ac is from the most blood in a beat to the least, dc at its mean.
    """

    ac: Array
    dc: Array

    @property
    def perfusion_index(self) -> Array:
        """ac over dc, (1 + groups, 2, photodiodes, states) float."""
        return _over(self.ac, self.dc)

    @property
    def ratio(self) -> Array:
        """The ratio of ratios, R = (ac/dc of red) / (ac/dc of infrared), (1 + groups, photodiodes, states) float."""
        index = self.perfusion_index
        return _over(index[:, 0], index[:, 1])


def _over(a: Array, b: Array) -> Array:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(a / b)


def estimate(replicates: Array) -> tuple[Array, Array]:
    """A value by all photons and its standard error."""
    return replicates[0], jackknife(replicates)


def with_saturation(scene: Scene, so2: float) -> Scene:
    """The scene with another arterial saturation; that of its veins stays as far below."""
    blood = scene.blood
    venous = None if blood.venous_so2 is None else max(so2 - (blood.so2 - blood.venous_so2), 0.0)
    return scene.model_copy(update={"blood": blood.model_copy(update={"so2": so2, "venous_so2": venous})})


def absorption(scene: Scene, wavelength_nm: Array, so2: float, resting: Array, pulse: Array) -> Array:
    """Absorption where resting blood, arterial and venous, and a pulse of arterial blood fill the bed. [mm^-1]

    so2 : of the arteries.
    resting : (zones,) float. Mean blood of each zone.
    pulse : (m, zones) float. Blood over that.

    Returns: (m, q, absorbers) float.
    """
    rest = optics.absorption(with_saturation(scene, so2), wavelength_nm, blood_fraction=resting)
    arterial = tissue.blood_mu_a_per_mm(wavelength_nm, so2)
    out = np.repeat(rest[None], len(pulse), 0)
    out[:, :, list(optics.bed_columns(scene))] += arterial[None, :, None] * pulse[:, None, :]
    return out


def read_states(transfer: Transfer, led: int, states: list[tuple[float, Array, Array]], *, seed: int) -> Array:
    """One LED's readings in states of the blood, (1 + groups, photodiodes, all rows of all pulses) float.

    states : saturation, resting blood and pulse of each, as in `absorption`.
    """
    wavelength, _ = optics.spectrum(transfer.scene.leds[led])
    mu_a = np.concatenate([absorption(transfer.scene, wavelength, *state) for state in states])
    return read_replicates(transfer, led, mu_a, np.ones(len(wavelength)), seed=seed).reading


def read_pulsations(
    transfer: Transfer, leds: tuple[int, int], states: list[tuple[float, BloodBeat]], *, seed: int
) -> Pulsation:
    """Pulsation in some states, each a saturation and a beat.

    leds : numbers of the red and the infrared LED.
    seed : of the groups of photons.
    """
    rows = []
    for so2, beat in states:
        rows.append((so2, beat.resting, np.vstack([np.zeros_like(beat.resting), beat.extremes])))
    read = np.stack([read_states(transfer, led, rows, seed=seed) for led in leds], 1)
    read = read.reshape(*read.shape[:3], len(states), 3)
    return Pulsation(ac=read[..., 1] - read[..., 2], dc=read[..., 0])


class SaturationCurve:
    """Pulsation at every saturation in a range, from the light at a few.

    Whatever is requested of it afterwards costs no more photons.
    """

    def __init__(
        self,
        transfer: Transfer,
        leds: tuple[int, int],
        beat: BloodBeat,
        *,
        low: float = 0.5,
        high: float = 1.0,
        seed: int,
    ) -> None:
        self.low, self.high = low, high
        places = np.cos((np.arange(NODES) + 0.5) * np.pi / NODES)
        self._nodes = places
        so2 = low + (high - low) * (1 + places) / 2
        self._at_nodes = read_pulsations(transfer, leds, [(float(s), beat) for s in so2], seed=seed)

    def at(self, so2: ArrayLike) -> Pulsation:
        """Pulsation at saturations, (n,) float, in parts of 1.

        Raises: InputError for one outside the curve's range.
        """
        asked = np.atleast_1d(np.asarray(so2, float))
        if not np.all((asked >= self.low - 1e-12) & (asked <= self.high + 1e-12)):
            raise InputError(f"so2 must lie in {self.low:g} to {self.high:g}, where the curve is known.")
        places = 2 * (asked - self.low) / (self.high - self.low) - 1
        weights = np.polynomial.chebyshev.chebvander(places, NODES - 1) @ np.linalg.inv(
            np.polynomial.chebyshev.chebvander(self._nodes, NODES - 1)
        )
        return Pulsation(ac=self._at_nodes.ac @ weights.T, dc=self._at_nodes.dc @ weights.T)


def path_ratios(transfer: Transfer, leds: tuple[int, int], beat: BloodBeat, *, seed: int) -> tuple[Array, Array]:
    """Mean paths of red and infrared light in the blood that beats, (1 + groups, 2, photodiodes) [mm], and their
    ratios, (1 + groups, photodiodes) float."""
    scene, paths = transfer.scene, []
    swing = np.ptp(beat.extremes, axis=0)
    for led in leds:
        wavelength, _ = optics.spectrum(scene.leds[led])
        mu_a = absorption(scene, wavelength, scene.blood.so2, beat.resting, np.zeros((1, len(swing))))
        found = read_replicates(transfer, led, mu_a, np.ones(len(wavelength)), seed=seed).mean_path_mm
        paths.append(found @ swing / swing.sum())
    both = np.stack(paths, 1)
    return both, _over(both[:, 0], both[:, 1])


def changed(transfer: Transfer, scene: Scene) -> Transfer:
    """The same light in a scene that differs in what only dims it."""
    return replace(transfer, scene=scene)

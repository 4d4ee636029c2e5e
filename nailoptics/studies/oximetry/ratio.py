"""The ratio of ratios: the pulse in traced light at any saturation, and the lines from R to SpO2."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ... import tissue
from ...errors import InputError
from ...light import Transfer, optics
from ...light.transfer.interpolation import ChebyshevBox
from ...light.transfer.series import read_replicates
from ...scene import Scene
from ...statistics import jackknife
from ..pulsatile_blood import BloodBeat

Array = NDArray[np.float64]

# Readings are smooth in the saturation: over half of its range polynomials of this many nodes miss them by 1e-6.
NODES = 6
# SpO2 = intercept + slope R, in percent. The first is that of textbooks, the second was measured on fingers against a
# reference, 70 to 98 %, with residuals of 3.2 % rms.
TEXTBOOK = (110.0, -25.0)
MEASURED = (110.9, -33.2)
# Saturations over which lines are fitted, those at which oximeters are tested.
FIT_SO2 = np.linspace(0.70, 1.00, 31)


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
        return _quotient(self.ac, self.dc)

    @property
    def ratio(self) -> Array:
        """The ratio of ratios, R = (ac/dc of red) / (ac/dc of infrared), (1 + groups, photodiodes, states) float."""
        index = self.perfusion_index
        return _quotient(index[:, 0], index[:, 1])


def _quotient(a: Array, b: Array) -> Array:
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
    """Pulsation at every saturation in a range, interpolated between Chebyshev nodes; it costs no more photons."""

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
        self._range = ChebyshevBox([low], [high], [NODES])
        so2 = self._range.nodes[:, 0]
        self._at_nodes = read_pulsations(transfer, leds, [(float(s), beat) for s in so2], seed=seed)

    def at(self, so2: ArrayLike) -> Pulsation:
        """Pulsation at saturations, (n,) float, in parts of 1.

        Raises: InputError for one outside the curve's range.
        """
        saturation = np.atleast_1d(np.asarray(so2, float))
        if not np.all((saturation >= self.low - 1e-12) & (saturation <= self.high + 1e-12)):
            raise InputError(f"so2 must lie in {self.low:g} to {self.high:g}, where the curve is known.")
        weights = self._range.weights(saturation)
        return Pulsation(ac=self._at_nodes.ac @ weights.T, dc=self._at_nodes.dc @ weights.T)


def path_length_ratios(transfer: Transfer, leds: tuple[int, int], beat: BloodBeat, *, seed: int) -> tuple[Array, Array]:
    """Mean paths of red and infrared light in the pulsatile blood, (1 + groups, 2, photodiodes) [mm], and their
    ratios, (1 + groups, photodiodes) float."""
    scene, paths = transfer.scene, []
    swing = np.ptp(beat.extremes, axis=0)
    for led in leds:
        wavelength, _ = optics.spectrum(scene.leds[led])
        mu_a = absorption(scene, wavelength, scene.blood.so2, beat.resting, np.zeros((1, len(swing))))
        read = read_replicates(transfer, led, mu_a, np.ones(len(wavelength)), seed=seed)
        paths.append(read.mean_path_mm @ swing / swing.sum())
    both = np.stack(paths, 1)
    return both, _quotient(both[:, 0], both[:, 1])


def in_scene(transfer: Transfer, scene: Scene) -> Transfer:
    """The same light in a scene that differs only in absorption and spectra."""
    return replace(transfer, scene=scene)


@dataclass(frozen=True)
class Calibration:
    """SpO2 = intercept + slope R and SpO2 = a + b R + c R^2, in percent, of each photodiode.

    linear, linear_stderr : (photodiodes, 2) float. Intercept and slope.
    quadratic, quadratic_stderr : (photodiodes, 3) float. a, b and c.
    linear_miss, quadratic_miss : (photodiodes,) float. The largest residual over the curve. [percent]
    """

    linear: Array
    linear_stderr: Array
    quadratic: Array
    quadratic_stderr: Array
    linear_miss: Array
    quadratic_miss: Array


def calibrate_curve(so2: Array, ratio: Array) -> Calibration:
    """Both fits to ratios of ratios, (1 + groups, photodiodes, n) float, at saturations, (n,) float in parts of 1."""
    fields: dict[str, Array] = {}
    for name, degree in (("linear", 1), ("quadratic", 2)):
        fits = np.array([[_fit(one, so2, degree) for one in replicate] for replicate in ratio])
        residual = [evaluate(fit, one) - 100 * so2 for fit, one in zip(fits[0], ratio[0], strict=True)]
        fields |= {name: fits[0], f"{name}_stderr": jackknife(fits), f"{name}_miss": np.abs(residual).max(1)}
    return Calibration(**fields)


def _fit(ratio: Array, so2: Array, degree: int) -> Array:
    if not np.isfinite(ratio).all():
        return np.full(degree + 1, np.nan)
    return np.asarray(np.polynomial.polynomial.polyfit(ratio, 100 * so2, degree), dtype=np.float64)


def evaluate(coefficients: ArrayLike, ratio: ArrayLike) -> Array:
    """SpO2 of a ratio of ratios by a line or a parabola. [percent]"""
    return np.asarray(np.polynomial.polynomial.polyval(np.asarray(ratio, float), np.asarray(coefficients, float)))


def saturation_of(ratio: ArrayLike, so2: Array, curve: Array) -> Array:
    """The saturation at which a curve has a ratio of ratios, extrapolated beyond its ends. [parts of 1]

    so2, curve : (n,) float. Saturations that rise, and ratios there that fall.
    """
    ratios = np.asarray(ratio, float)
    inside = np.interp(ratios, curve[::-1], so2[::-1])
    first, last = (so2[1] - so2[0]) / (curve[1] - curve[0]), (so2[-1] - so2[-2]) / (curve[-1] - curve[-2])
    inside = np.where(ratios > curve[0], so2[0] + first * (ratios - curve[0]), inside)
    return np.asarray(np.where(ratios < curve[-1], so2[-1] + last * (ratios - curve[-1]), inside))

"""The ratio of ratios R of two LEDs' pulsating light against saturation, and lines from R to SpO2."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.polynomial.polynomial import polyfit, polyval
from numpy.typing import ArrayLike

from ... import tissue
from ...errors import NotReachedError, as_far_as_reached
from ...hemodynamics.for_scene import BloodBeat
from ...light import Transfer, optics, trace
from ...light.tracing import StoppingCriterion, accuracy
from ...light.transfer.series import ChebyshevBox, read_replicates
from ...options import TraceOptions
from ...scene import Scene
from ...sensor.front_end import oximeter_leds
from ...statistics import Array, quotient, seed_of

# Readings are smooth in the saturation: over half of its range polynomials of this many nodes miss them by 1e-6.
NODES = 7
# SpO2 = intercept + slope R, in percent. The first is that of textbooks; the second is from 56 public recordings of one
# finger, 70 to 98 % by another oximeter, with residuals of 3.2 % rms (tests/benchmarks/real_oximeter.py).
TEXTBOOK = (110.0, -25.0)
MEASURED = (109.5, -31.2)
# By a larger bias of SpO2 a published line misleads. [percent]
MOST_BIAS = 2.0
# Saturations over which lines are fitted, those at which oximeters are tested.
FIT_SO2 = np.linspace(0.70, 1.00, 31)
# Photons of the first round, whose error decides how many more are needed; rounds have seeds of their own.
FIRST_PHOTONS = 1 << 19
_ROUND = 41


def trace_for_ratio(
    scene: Scene, error_of: Callable[[Transfer], float], options: TraceOptions, **given: Any
) -> Transfer:
    """Light of every LED until an answer's relative error is that of the scene, or of the options.

    error_of : relative standard error of the answer from what was traced; inf where it is not known.
    given : progress and stores of `trace`.

    Raises: NotReachedError with the Transfer so far.
    """
    required, begin = accuracy(scene, options), time.perf_counter()
    plain, target = scene.without_accuracy(), required.relative_error
    left_s = limit_s = required.max_seconds
    if target is None:
        how = replace(options, relative_error=None, max_seconds=left_s, photons=required.photons)
        return replace(trace(plain, **given, **how.fields), scene=scene)
    criterion = StoppingCriterion(target=target, first=FIRST_PHOTONS, least=FIRST_PHOTONS // 4, margin=1.15, growth=16)
    light: Transfer | None = None
    photons, rounds = criterion.first, 0
    while True:
        seed = seed_of(options.seed, _ROUND, rounds) >> 1 if rounds else options.seed
        how = replace(options, seed=seed, relative_error=None, max_seconds=left_s, photons=photons)
        more, unmet = as_far_as_reached(trace, plain, **given, **how.fields)
        more = replace(more, scene=scene)
        light, rounds = light.merge(more) if light else more, rounds + 1
        per_led, error = light.photons // len(scene.leds), error_of(light)
        if not (photons := criterion.needed(per_led, error)):
            return light
        left_s = None if limit_s is None else limit_s - (time.perf_counter() - begin)
        if unmet or (left_s is not None and left_s <= 0):
            reached = f"{per_led} photons for each LED with a relative error of {error:.3g}"
            why = f"the trace ended at {reached} of the ratio of ratios where it is least, {target:g} requested"
            interrupted = bool(unmet and unmet.interrupted)
            raise NotReachedError(f"{why}; allow more time or require less.", result=light, interrupted=interrupted)


@dataclass(frozen=True)
class Pulsation:
    """Pulsating and steady light of the red and the infrared LED, by all photons and without each group of them.

    ac, dc : (1 + groups, 2, photodiodes, states) float. Fractions of the LED's power, weighted by the photodiode's
        response; ac is from the most blood in a beat to the least, dc at its mean.
    """

    ac: Array
    dc: Array

    @property
    def perfusion_index(self) -> Array:
        """ac over dc, (1 + groups, 2, photodiodes, states) float."""
        return quotient(self.ac, self.dc)

    @property
    def ratio(self) -> Array:
        """The ratio of ratios, R = (ac/dc of red) / (ac/dc of infrared), (1 + groups, photodiodes, states) float."""
        index = self.perfusion_index
        return quotient(index[:, 0], index[:, 1])


def absorption(scene: Scene, wavelength_nm: Array, so2: float, resting: Array, pulse: Array) -> Array:
    """Absorption where resting blood, arterial and venous, and a pulse of arterial blood fill the bed. [mm^-1]

    so2 : of the arteries.
    resting : (zones,) float. Mean blood of each zone.
    pulse : (m, zones) float. Blood over that.

    Returns: (m, q, absorbers) float.
    """
    saturated = scene.model_copy(update={"blood": scene.blood.with_so2(so2)})
    rest = optics.absorption(saturated, wavelength_nm, blood_fraction=resting)
    arterial = tissue.blood_mu_a_per_mm(wavelength_nm, so2)
    out = np.repeat(rest[None], len(pulse), 0)
    out[:, :, list(optics.bed_columns(scene))] += arterial[None, :, None] * pulse[:, None, :]
    return out


def read_states(transfer: Transfer, led: int, states: list[tuple[float, Array, Array]]) -> Array:
    """One LED's readings in states of the blood, (1 + groups, photodiodes, all rows of all pulses) float.

    states : saturation, resting blood and pulse of each, as in `absorption`.
    """
    wavelength, _ = optics.spectrum(transfer.scene.leds[led])
    mu_a = np.concatenate([absorption(transfer.scene, wavelength, *state) for state in states])
    return read_replicates(transfer, led, mu_a, paths=False)[0]


def read_pulsations(transfer: Transfer, leds: tuple[int, int], states: list[tuple[float, BloodBeat]]) -> Pulsation:
    """Pulsation in some states, each a saturation and a beat. leds : numbers of the red and the infrared LED."""
    rows = [(so2, beat.resting, np.vstack([np.zeros_like(beat.resting), beat.extremes])) for so2, beat in states]
    read = np.stack([read_states(transfer, led, rows) for led in leds], 1)
    read = read.reshape(*read.shape[:3], len(states), 3)
    return Pulsation(ac=read[..., 1] - read[..., 2], dc=read[..., 0])


def saturation_curve(
    transfer: Transfer, leds: tuple[int, int], beat: BloodBeat, *, low: float, high: float
) -> Callable[[ArrayLike], Pulsation]:
    """Pulsation at every saturation in a range, (n,) float as a fraction, for no more photons.

    It is interpolated between Chebyshev nodes.
    """
    box = ChebyshevBox([low], [high], [NODES])
    at_nodes = read_pulsations(transfer, leds, [(float(so2), beat) for (so2,) in box.nodes])

    def at(so2: ArrayLike) -> Pulsation:
        weights = box.weights(so2).T
        return Pulsation(ac=at_nodes.ac @ weights, dc=at_nodes.dc @ weights)

    return at


def path_length_ratios(transfer: Transfer, leds: tuple[int, int], beat: BloodBeat) -> Array:
    """Mean path of red light in the pulsatile blood over that of infrared, (1 + groups, photodiodes) float."""
    scene, paths = transfer.scene, []
    swing = np.ptp(beat.extremes, axis=0)
    for led in leds:
        wavelength, _ = optics.spectrum(scene.leds[led])
        mu_a = absorption(scene, wavelength, scene.blood.so2, beat.resting, np.zeros((1, len(swing))))
        paths.append(read_replicates(transfer, led, mu_a)[1] @ swing / swing.sum())
    return quotient(*paths)


def calibrate_curve(so2: Array, ratio: Array, degree: int) -> tuple[Array, Array]:
    """Polynomials, from the constant up, that make SpO2 in percent of R; what they miss at most. [percent]

    so2 : (n,) float. In parts of 1.
    ratio : (1 + groups, photodiodes, n) float. Ratios of ratios there.

    Returns: (1 + groups, photodiodes, degree + 1) and (photodiodes,) float; NaN where a ratio is not known.
    """
    percent, fits = 100 * so2, np.full((*ratio.shape[:2], degree + 1), np.nan)
    for at in np.argwhere(np.isfinite(ratio).all(-1)):
        fits[tuple(at)] = polyfit(ratio[tuple(at)], percent, degree)
    residual = [polyval(ratios, fit) - percent for fit, ratios in zip(fits[0], ratio[0], strict=True)]
    return fits, np.abs(residual).max(1)


def saturation_of(ratio: ArrayLike, so2: Array, curve: Array) -> Array:
    """The saturation at which a curve has a ratio of ratios, extrapolated beyond its ends. [parts of 1]

    so2, curve : (n,) float. Saturations, and ratios there that rise or fall with them throughout.
    """
    from scipy.interpolate import interp1d

    return np.asarray(interp1d(curve, so2, fill_value="extrapolate")(ratio))


def literature_bias(ratio: Array, so2: float) -> Array:
    """Bias of SpO2 by the nearer of both published lines, the textbook's and that of fingers. [percent]

    ratio : (photodiodes,) float. Ratio of ratios at a saturation as a fraction.
    """
    bias = np.stack([polyval(ratio, line) - 100 * so2 for line in (TEXTBOOK, MEASURED)])
    return np.asarray(np.take_along_axis(bias, np.abs(bias).argmin(0)[None], 0)[0])


def path_warnings(scene: Scene, ratio: Array, path_length_ratio: Array) -> list[str]:
    """One line for each photodiode on which published lines have a larger bias, and what mends it.

    ratio, path_length_ratio : (photodiodes,) float. At the scene's saturation.
    """
    red, infrared = oximeter_leds(scene)
    dies, names, lines = scene.layout.leds, [scene.leds[i].name for i in (red, infrared)], []
    bias = literature_bias(ratio, scene.blood.so2)
    for element, r, paths, percent in zip(scene.layout.photodiodes, ratio, path_length_ratio, bias, strict=True):
        if not abs(percent) > MOST_BIAS:
            continue
        near = [math.dist(element.area.center_mm, dies[i].center_mm) for i in (red, infrared)]
        cure = "it is as far from both LEDs: move it to 2.5 to 3.5 mm from them, or use the fit of this scene"
        if abs(near[0] - near[1]) > 0.1:
            from_both = [f'{mm:.2f} mm from "{name}"' for mm, name in zip(near, names, strict=True)]
            place = "put it as far from both, on the axis between two dies side by side"
            cure = f"it lies {' and '.join(from_both)}: {place}"
        longer = f"the path of red light in the pulsatile blood is {paths:.2f} times that of infrared"
        bias_of_line = f"R({scene.blood.so2:g}) = {r:.2f}, and a textbook's line has a bias of {percent:+.1f} % or more"
        lines.append(f'photodiode "{element.name}": {longer}, {bias_of_line}; {cure}')
    return lines

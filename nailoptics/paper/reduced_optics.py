"""The paper's reduced optics, Beer-Lambert (8) and Taylor (9), and the least-squares fit of their constants."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from ..checks import Array, finite, not_negative
from ..errors import InputError
from ..statistics import jackknife
from ..variables import Estimate, Variables, described

# alpha D^2 at the largest D, between which it is searched: below, Beer-Lambert (8) is a straight line in D^2 to 1e-5 of
# its slope; above, light is all gone.
CURVATURES = np.geomspace(1e-4, 50.0, 21)
# More readings than this are fitted as their means in so many narrow ranges of D^2: within one the curve is straight.
MOST_READINGS, RANGES = 20_000, 4096
# The errors of the fits' constants are taken at so many samples of a touch, evenly apart.
FIT_SAMPLES = 64


@dataclass(frozen=True)
class FittedCurve:
    """y = value - slope (1 - exp(-curvature (x - centre))) / curvature; the straight line where curvature is 0.

    Nearly straight readings determine V0, V1 and alpha of Beer-Lambert (8) only together, but value, slope and
    curvature at their centre one by one.

    curved : whether the curvature was fitted, too.
    """

    centre: float
    value: float
    slope: float
    curvature: float
    curved: bool

    def at(self, x: Array) -> Array:
        """Its values at x."""
        return np.asarray(self.value - self.slope * _bend(self.curvature, x - self.centre))

    def design(self, x: Array) -> Array:
        """Its derivatives by value, slope and, where fitted, curvature, (n, 2 or 3) float."""
        shift = x - self.centre
        columns = [np.ones_like(shift), -_bend(self.curvature, shift)]
        if self.curved:
            columns.append(-self.slope * _bend_slope(self.curvature, shift))
        return np.stack(columns, 1)

    def gradient(self, x: Array) -> Array:
        """Derivatives of value, slope and curvature by readings at x, (2 or 3, n) float; 0 of what they do not move."""
        design = self.design(x)
        # Columns differ by orders of magnitude.
        length = np.linalg.norm(design, axis=0)
        length = np.where(length > 0, length, 1.0)
        return np.asarray(np.linalg.pinv(design / length, rcond=1e-14) / length[:, None])

    def replicates(self, x: Array, y: Array) -> Array:
        """Values at x of the curves through replicates y (r, n), of which it fits the first, to first order in how far
        they differ, which is their noise: (r, n) float."""
        moved = (y - y[0]) @ self.gradient(x).T
        return np.asarray(self.at(x) + moved @ self.design(x).T)

    def curvature_of_replicates(self, x: Array, y: Array) -> Array:
        """Their curvatures, (r,) float."""
        return np.asarray(self.curvature + ((y - y[0]) @ self.gradient(x)[2] if self.curved else np.zeros(len(y))))


def fit_curve(
    x: Array, y: Array, weight: Array | None = None, *, curved: bool, scale: float | None = None
) -> FittedCurve:
    """The curve with the least squared residual, or the straight line; two different x get a straight line, too.

    x, y, weight : (n,) float.
    scale : the curvature times this is held in 1e-4 to 50; the largest x if not given.
    """
    share = np.full_like(x, 1 / x.size) if weight is None else weight / weight.sum()
    centre, level = float(share @ x), float(share @ y)
    shift, moved = x - centre, y - level

    def linear(curvature: Array) -> tuple[Array, Array, Array]:
        """Value and slope at given curvatures (k,), and the squares that they leave, (k,) float each."""
        bend = _bend(curvature[:, None], shift)
        middle = bend @ share
        away = bend - middle[:, None]
        square = away**2 @ share
        slope = -(away @ (share * moved)) / np.where(square > 0, square, np.inf)
        return level + slope * middle, slope, (moved + slope[:, None] * away) ** 2 @ share

    def at(curvature: float, curved: bool) -> FittedCurve:
        value, slope, _ = (float(column[0]) for column in linear(np.array([curvature])))
        return FittedCurve(centre, value, slope, curvature, curved)

    scale = scale or float(x.max()) or 1.0
    distinct = _distinct(x / (float(x.max()) or 1.0))
    if not curved or distinct < 3:
        return at(CURVATURES[0] / scale if curved and distinct == 2 else 0.0, False)
    # The residual may be flat at first and has one valley, searched on ever finer grids to where it no longer changes.
    grid = np.log(CURVATURES / scale)
    while np.ptp(grid) > 1e-8:
        best = int(np.argmin(linear(np.exp(grid))[2]))
        grid = np.linspace(grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)], 9)
    alpha = float(np.exp(grid.mean()))
    return at(alpha, bool(1.01 * CURVATURES[0] < alpha * scale < 0.99 * CURVATURES[-1]))


@dataclass(frozen=True)
class OpticsFit:
    """Beer-Lambert (8) or Taylor (9), fitted to readings over D^2.

    constants : V0, V1 and alpha of Beer-Lambert (8), as v0_v, v1_v and alpha_per_m2; V0' and V1' of Taylor (9), as v0_v
        and v1_v_per_m2.
    residual_rms_v : what the curve misses of the readings. [V]
    note : empty, or one line on what the readings do not determine.
    jacobian : (constants, 2 or 3) float. Derivatives of the constants by value, slope and curvature of the curve.
    """

    constants: dict[str, float]
    residual_rms_v: float
    note: str
    curve: FittedCurve
    scale_m2: float
    jacobian: Array

    def predict(self, diameter_m: ArrayLike) -> Array:
        """The reading at a capillary diameter [m]. [V]"""
        return self.curve.at(np.square(np.asarray(diameter_m, float)) / self.scale_m2)

    def stderr(self, diameter_m: ArrayLike, replicates_v: Array) -> Array:
        """Standard errors of the constants by the jackknife, (constants,) float; inf where nothing determines them.

        diameter_m : (n,) float. Diameters that are distributed as those of the fit. [m]
        replicates_v : (1 + groups, n) float. The readings there by all photons, and without each group of them. [V]
        """
        if self.note:
            return np.full(len(self.constants), np.inf)
        gradient = self.curve.gradient(np.square(np.asarray(diameter_m, float)) / self.scale_m2)
        return jackknife((replicates_v - replicates_v[0]) @ (self.jacobian @ gradient).T)

    def remark(self, stderr: Array) -> str:
        """What the readings do not determine, given the standard errors of the constants; empty if nothing."""
        if self.note or not stderr[-1] > self.constants.get("alpha_per_m2", np.inf):
            return self.note
        return "alpha differs from 0 by less than its standard error: V0, V1 and alpha are left out"


def fit_taylor(diameter_m: ArrayLike, volts: ArrayLike) -> OpticsFit:
    """Fit the constants of Taylor (9), V = V0' - V1' D^2, by least squares.

    diameter_m : (n,) float. Capillary diameter D_C + x_C, 0 or more. [m]
    volts : (n,) float. Readings. [V]

    Where the diameters do not vary the slope is 0, and `note` says so.

    Raises: InputError for arrays of different length, none at all, or values that are not finite.

    References: Mascaro and Asada 2001, IEEE Trans. Robotics and Automation 17(5), eq. (9).
    """
    x, y, scale_m2 = _checked(diameter_m, volts)
    curve = fit_curve(*_in_ranges(x, y), curved=False)
    constants = {"v0_v": curve.value + curve.slope * curve.centre, "v1_v_per_m2": curve.slope / scale_m2}
    jacobian = np.array([[1.0, curve.centre], [0.0, 1.0 / scale_m2]])
    note = "the diameters do not vary: the slope is not known" if _distinct(x) == 1 else ""
    return OpticsFit(constants, _residual_rms(curve, x, y), note, curve, scale_m2, jacobian)


def fit_beer_lambert(diameter_m: ArrayLike, volts: ArrayLike) -> OpticsFit:
    """Fit the constants of Beer-Lambert (8), V = V0 + V1 exp(-alpha D^2), by least squares.

    At alpha D^2 of 1e-2 the curve is nearly a straight line in D^2, which fixes only the product alpha V1. Where the
    readings do not determine alpha, the constants are those of the best curve in range, and `note` says so.
    Parameters and errors: as in `fit_taylor`.

    References: Mascaro and Asada 2001, IEEE Trans. Robotics and Automation 17(5), eq. (8).
    """
    x, y, scale_m2 = _checked(diameter_m, volts)
    distinct, still = _distinct(x), np.ptp(y) <= 1e-12 * np.abs(y).max()
    curve = fit_curve(*_in_ranges(x, y), curved=not still)
    if distinct == 1 or still:
        what = "diameters do not vary" if distinct == 1 else "readings do not change with the diameter"
        constants, jacobian = {"v0_v": float(y.mean()), "v1_v": 0.0, "alpha_per_m2": 0.0}, np.eye(3, 2)
        note = f"the {what}: neither V1 nor alpha is known"
    else:
        centre, slope, curvature = curve.centre, curve.slope, curve.curvature
        growth = float(np.exp(curvature * centre))
        constants = {"v0_v": curve.value - slope / curvature, "v1_v": slope / curvature * growth}
        constants["alpha_per_m2"] = curvature / scale_m2
        by_v0 = [1.0, -1.0 / curvature, slope / curvature**2]
        by_v1 = [0.0, growth / curvature, slope * growth * (centre * curvature - 1) / curvature**2]
        jacobian, note = np.array([by_v0, by_v1, [0.0, 0.0, 1.0 / scale_m2]]), ""
        if distinct == 2:
            note = "only two different diameters: any alpha fits, and the straight line in D^2 is taken"
        elif not curve.curved:
            note = "the readings are a step in D^2: alpha is at the high end of its range"
            if curvature < 1:
                note = "the readings are straight in D^2, or bent the other way: alpha is at the low end of its range"
    return OpticsFit(constants, _residual_rms(curve, x, y), note, curve, scale_m2, jacobian)


# By the prefix of their variables.
REDUCED_OPTICS: dict[str, Callable[..., OpticsFit]] = {"beer_lambert": fit_beer_lambert, "taylor": fit_taylor}


def fit_reduced_optics(result: xr.Dataset, few: Array, replicates_v: Array | None) -> Variables:
    """Beer-Lambert (8) and Taylor (9), each fitted to the volts of every photodiode over its own zone's diameter.

    result : volts over led, photodiode and time, capillary_diameter_m over zone and time, and zone_of_photodiode.
    few : (n,) int. The samples of the replicates.
    replicates_v : (led, photodiode, 1 + groups, n) float. Volts by all photons and without each group of them, whose
        noise, shared by all samples, makes the constants' standard errors; NaN without it. [V]
    """
    shape = result.volts.shape[:2]
    # One row for each zone, not for each photodiode.
    diameter_m = [result.capillary_diameter_m.values[zone] for zone in result.zone_of_photodiode.values]
    notes = np.full(shape, "", dtype=object)
    data: Variables = {}
    for model, fit in REDUCED_OPTICS.items():
        fits = [[fit(*pair) for pair in zip(diameter_m, volts, strict=True)] for volts in result.volts]
        rows = [[fit.predict(width_m) for fit, width_m in zip(of_led, diameter_m, strict=True)] for of_led in fits]
        columns: dict[str, Any] = {f"volts_{model}": np.array(rows, result.volts.dtype)}
        constants = list(fits[0][0].constants)
        errors = np.full((*shape, len(constants)), np.nan)
        for i, j in np.ndindex(shape):
            if replicates_v is not None:
                errors[i, j] = fits[i][j].stderr(diameter_m[j][few], replicates_v[i, j])
            notes[i, j] = notes[i, j] or fits[i][j].remark(errors[i, j])
        # Constants of a curve whose bend is not known may be any, of millions of volts.
        unknown = (notes != "") & (model == "beer_lambert")
        for k, name in enumerate(constants):
            values = [[fit.constants[name] for fit in of_led] for of_led in fits]
            columns[f"{model}_{name}"] = Estimate(*(np.where(unknown, np.nan, x) for x in (values, errors[..., k])))
        columns[f"{model}_residual_rms_v"] = [[fit.residual_rms_v for fit in of_led] for of_led in fits]
        data |= described(__package__, **columns)
    return data | described(__package__, fit_note=notes.astype(str))


def _residual_rms(curve: FittedCurve, x: Array, y: Array) -> float:
    """Root mean square distance of readings from a curve."""
    return float(np.sqrt(np.mean((y - curve.at(x)) ** 2)))


def _checked(diameter_m: ArrayLike, volts: ArrayLike) -> tuple[Array, Array, float]:
    """D^2 in terms of the largest, (n,), the readings, (n,), and the largest D^2. [m^2]"""
    diameter, reading = not_negative("diameter_m", diameter_m), finite("volts", volts)
    if diameter.ndim != 1 or diameter.shape != reading.shape or diameter.size == 0:
        why = "must be rows of one length, and not empty"
        raise InputError(f"diameter_m {diameter.shape} and volts {reading.shape} {why}")
    scale_m2 = float(np.square(diameter.max())) or 1.0
    return np.square(diameter) / scale_m2, reading, scale_m2


def _in_ranges(x: Array, y: Array) -> tuple[Array, Array, Array]:
    """Readings with their weights; of very many the means in narrow ranges of x, each weighing as all of them do."""
    if x.size <= MOST_READINGS or not np.ptp(x):
        return x, y, np.ones_like(x)
    count, edges = np.histogram(x, RANGES)
    there = count > 0
    x, y = (np.histogram(x, edges, weights=values)[0][there] / count[there] for values in (x, y))
    return x, y, count[there].astype(float)


def _distinct(x: Array) -> int:
    """How many values differ by more than rounding: 1, 2, or 3 for more."""
    low, high = x.min() + 1e-12, x.max() - 1e-12
    if low >= high:
        return 1
    return 3 if ((x > low) & (x < high)).any() else 2


def _bend(curvature: float | Array, shift: Array) -> Array:
    """(1 - exp(-a s)) / a, which goes to s as a goes to 0."""
    if not np.all(curvature):
        return shift + np.zeros_like(curvature)
    return np.asarray(-np.expm1(-curvature * shift) / curvature)


def _bend_slope(curvature: float, shift: Array) -> Array:
    """The derivative of `_bend` by the curvature, without the loss of digits that its closed form has."""
    t = curvature * shift
    small = np.abs(t) < 1e-3
    safe = np.where(small, 1.0, t)
    closed = (safe * np.exp(-safe) + np.expm1(-safe)) / safe**2
    return np.asarray(np.where(small, -0.5 + t / 3 - t**2 / 8, closed) * shift**2)

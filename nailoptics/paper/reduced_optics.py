"""The paper's reduced optics, Beer-Lambert (8) and Taylor (9), and the fit of their constants to readings."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..checks import Array, finite, not_negative
from ..errors import InputError

# alpha D_ref^2 between these: below, (8) is a straight line in D^2 to 1e-5 of its slope; above, light is all gone.
_CURVATURE_RANGE = (1e-4, 50.0)
_CURVATURE_STEP = 1e-9  # of its logarithm, to which it is searched; rounding of the residual hides less
# More readings than this are fitted as their means in so many narrow ranges of D^2: within one the curve is straight.
_MOST_READINGS, _RANGES = 20_000, 4096


@dataclass(frozen=True, kw_only=True)
class _Fit:
    """What both fits say beside their constants.

    covariance : Of the constants, in the order of the fields; inf where the readings do not determine one.
    residual_rms_v, residual_max_v : What the curve misses of the readings. [V]
    note : Empty, or one line on what the readings could not determine.
    """

    covariance: Array
    residual_rms_v: float
    residual_max_v: float
    note: str

    @property
    def stderr(self) -> Array:
        """Standard errors of the constants, in the order of the fields."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


@dataclass(frozen=True, kw_only=True)
class BeerLambertFit(_Fit):
    """Equation (8), V = v0_v + v1_v exp(-alpha_per_m2 D^2), fitted."""

    v0_v: float
    v1_v: float
    alpha_per_m2: float

    def predict(self, diameter_m: ArrayLike) -> Array:
        """The reading at a capillary diameter [m]. [V]"""
        return beer_lambert(diameter_m, v0_v=self.v0_v, v1_v=self.v1_v, alpha_per_m2=self.alpha_per_m2)


@dataclass(frozen=True, kw_only=True)
class TaylorFit(_Fit):
    """Equation (9), V = v0_v - v1_v_per_m2 D^2, fitted."""

    v0_v: float
    v1_v_per_m2: float

    def predict(self, diameter_m: ArrayLike) -> Array:
        """The reading at a capillary diameter [m]. [V]"""
        return taylor(diameter_m, v0_v=self.v0_v, v1_v_per_m2=self.v1_v_per_m2)


def beer_lambert(diameter_m: ArrayLike, *, v0_v: float, v1_v: float, alpha_per_m2: float) -> Array:
    """The reading by equation (8): v0 + v1 exp(-alpha D^2). [V]"""
    return np.asarray(v0_v + v1_v * np.exp(-alpha_per_m2 * np.square(np.asarray(diameter_m, dtype=float))))


def taylor(diameter_m: ArrayLike, *, v0_v: float, v1_v_per_m2: float) -> Array:
    """The reading by equation (9): v0' - v1' D^2. [V]"""
    return np.asarray(v0_v - v1_v_per_m2 * np.square(np.asarray(diameter_m, dtype=float)))


def fit_taylor(diameter_m: ArrayLike, volts: ArrayLike, stderr_v: ArrayLike | None = None) -> TaylorFit:
    """Fit the two constants of equation (9), V = V0' - V1' D^2, by (weighted) least squares.

    diameter_m : (t,) float. Capillary diameter D_C + x_C, 0 or more. [m]
    volts : (t,) float. Readings. [V]
    stderr_v : (t,) float or one for all. Standard errors of the readings; they weigh them and set the errors of the
        constants. Without them (or all 0) the scatter about the fit does. Taken as independent: readings of one trace
        share their noise, and the errors of the slope are then upper bounds. [V]

    Where the diameters do not vary the slope is 0 with an infinite error, and `note` says so.

    Raises: InputError for arrays of different length, none at all, or values that are not finite.

    References: Mascaro and Asada 2001, IEEE Trans. Robotics and Automation 17(5), eq. (9).
    """
    data = _Data.checked(diameter_m, volts, stderr_v)
    if data.distinct() == 1:
        note = "the diameters do not vary: the slope is not known"
        return TaylorFit(**data.constant(2), note=note, v1_v_per_m2=0.0)
    centre = data.centre()
    design = np.stack([np.ones_like(data.x), -(data.x - centre)], axis=1)
    value, slope = data.solve(design)
    # From value and slope at the centre of the data to value and slope at D = 0.
    jacobian = np.array([[1.0, centre], [0.0, 1.0 / data.scale_m2]])

    def line(x: Array) -> Array:
        return np.asarray(value - slope * (x - centre))

    covariance = _carried(data.covariance(design, line), jacobian)
    return TaylorFit(
        **data.residuals(line),
        covariance=covariance,
        note="" if np.isfinite(covariance).all() else "as many constants as readings: their errors are not known",
        v0_v=value + slope * centre,
        v1_v_per_m2=slope / data.scale_m2,
    )


def fit_beer_lambert(diameter_m: ArrayLike, volts: ArrayLike, stderr_v: ArrayLike | None = None) -> BeerLambertFit:
    """Fit the three constants of equation (8), V = V0 + V1 exp(-alpha D^2), by (weighted) least squares.

    At alpha D^2 of 1e-2 the curve is nearly a straight line in D^2, which fixes only the product alpha V1. So the fit
    works with value, slope and relative curvature at the centre of the readings, which the readings determine one
    by one, and turns them into V0, V1 and alpha at the end; their standard errors then say how far the three are
    known, and the prediction is good even where they are not. alpha D^2 is held in 1e-4 to 50.

    Parameters, errors and what happens where the diameters do not vary: as in `fit_taylor`. Where the readings do not
    determine the curvature, the constants are those of the best curve in range, their errors are large (or infinite,
    at the ends of the range), and `note` says so.

    References: Mascaro and Asada 2001, IEEE Trans. Robotics and Automation 17(5), eq. (8).
    """
    data = _Data.checked(diameter_m, volts, stderr_v)
    still = data.distinct() == 1
    if still or np.ptp(data.volts) <= 1e-12 * np.abs(data.volts).max():
        what = "diameters do not vary" if still else "readings do not change with the diameter"
        note = f"the {what}: neither V1 nor alpha is known"
        return BeerLambertFit(**data.constant(3), note=note, v1_v=0.0, alpha_per_m2=0.0)
    curve = _fitted_curve(data)
    covariance, note = _curve_covariance(data, curve), _out_of_range(data, curve)
    if note:
        covariance = np.full((3, 3), np.inf)
    elif not covariance[2, 2] < (curve.curvature / data.scale_m2) ** 2:
        note = "alpha differs from 0 by less than its standard error: V1 and alpha are known by their product only"
    return BeerLambertFit(
        **data.residuals(curve.at),
        covariance=covariance,
        note=note,
        v0_v=curve.value - curve.slope / curve.curvature,
        v1_v=curve.slope / curve.curvature * curve.growth,
        alpha_per_m2=curve.curvature / data.scale_m2,
    )


@dataclass(frozen=True)
class _Curve:
    """Equation (8) by its value, slope and relative curvature at the centre of the readings, over x = D^2 / scale."""

    centre: float
    value: float
    slope: float
    curvature: float

    @property
    def growth(self) -> float:
        """The exponential at D = 0 over that at the centre."""
        return float(np.exp(self.curvature * self.centre))

    def at(self, x: Array) -> Array:
        return np.asarray(self.value - self.slope * _bend(self.curvature, x - self.centre))


def _line_design(curvature: float, shift: Array) -> Array:
    """What value and slope multiply at a given curvature, (t, 2) float."""
    return np.stack([np.ones_like(shift), -_bend(curvature, shift)], axis=1)


def _fitted_curve(data: "_Data") -> _Curve:
    """The curve with the least squared residual; two different diameters get the straightest one."""
    centre = data.centre()
    shift = data.x - centre
    curvature = _best_curvature(data, shift) if data.distinct() > 2 else _CURVATURE_RANGE[0]
    value, slope = data.solve(_line_design(curvature, shift))
    return _Curve(centre, value, slope, curvature)


def _curve_covariance(data: "_Data", curve: _Curve) -> Array:
    """Covariance of V0, V1 and alpha, (3, 3) float, from that of value, slope and curvature at the centre."""
    centre, slope, curvature, growth = curve.centre, curve.slope, curve.curvature, curve.growth
    v0 = [1.0, -1.0 / curvature, slope / curvature**2]
    v1 = [0.0, growth / curvature, slope * growth * (centre * curvature - 1) / curvature**2]
    alpha = [0.0, 0.0, 1.0 / data.scale_m2]
    shift = data.x - centre
    full = np.column_stack([_line_design(curvature, shift), -slope * _bend_slope(curvature, shift)])
    return _carried(data.covariance(full, curve.at), np.array([v0, v1, alpha]))


def _out_of_range(data: "_Data", curve: _Curve) -> str:
    """Why the readings do not determine alpha; empty where they may."""
    low, high = _CURVATURE_RANGE
    if data.distinct() == 2:
        return "only two different diameters: any alpha fits, and the straight line in D^2 is taken"
    if curve.curvature <= 1.01 * low:
        return "the readings are straight in D^2, or bent the other way: alpha is at the low end of its range"
    if curve.curvature >= 0.99 * high:
        return "the readings are a step in D^2: alpha is at the high end of its range"
    return ""


def _carried(covariance: Array, jacobian: Array) -> Array:
    """The covariance in other constants; where it is not known it stays infinite, not nan."""
    if not np.isfinite(covariance).all():
        return np.full_like(covariance, np.inf)
    return np.asarray(jacobian @ covariance @ jacobian.T)


def _bend(curvature: float, shift: Array) -> Array:
    """(1 - exp(-a s)) / a, which goes to s as a goes to 0."""
    return np.asarray(-np.expm1(-curvature * shift) / curvature)


def _bend_slope(curvature: float, shift: Array) -> Array:
    """The derivative of `_bend` by the curvature, without the loss of digits that its closed form has."""
    t = curvature * shift
    small = np.abs(t) < 1e-3
    safe = np.where(small, 1.0, t)
    closed = (safe * np.exp(-safe) + np.expm1(-safe)) / safe**2
    series = -0.5 + t / 3 - t**2 / 8
    return np.asarray(np.where(small, series, closed) * shift**2)


def _best_curvature(data: "_Data", shift: Array) -> float:
    """The relative curvature with the least squared residual; value and slope follow from it linearly."""

    def cost(log_curvature: float) -> float:
        design = _line_design(float(np.exp(log_curvature)), shift)
        return float(np.sum(np.square((data.volts - design @ data.solve(design)) * data.root_weight)))

    # The cost can have a flat start and one valley; a coarse scan finds the valley, halved steps its bottom.
    grid = np.log(np.geomspace(*_CURVATURE_RANGE, 41))
    step, (least, best) = grid[1] - grid[0], min((cost(x), float(x)) for x in grid)
    while step > _CURVATURE_STEP:
        step /= 2
        nearer = [float(np.clip(x, grid[0], grid[-1])) for x in (best - step, best + step)]
        least, best = min((least, best), *((cost(x), x) for x in nearer))
    return float(np.exp(best))


@dataclass(frozen=True)
class _Data:
    """Readings in the scaled variable x = D^2 / largest D^2, with their weights; means of many, if there are very many.

    every : x and volts of each single reading.
    """

    x: Array
    volts: Array
    root_weight: Array
    scale_m2: float
    absolute: bool
    every: tuple[Array, Array]

    @classmethod
    def checked(cls, diameter_m: ArrayLike, volts: ArrayLike, stderr_v: ArrayLike | None) -> "_Data":
        diameter, reading = not_negative("diameter_m", diameter_m), finite("volts", volts)
        if diameter.ndim != 1 or diameter.shape != reading.shape or diameter.size == 0:
            raise InputError(
                f"diameter_m {diameter.shape} and volts {reading.shape} must be rows of one length, and not empty"
            )
        error = np.zeros_like(reading) + not_negative("stderr_v", 0.0 if stderr_v is None else stderr_v)
        absolute = bool((error > 0).any())
        if absolute and not (error > 0).all():
            raise InputError("stderr_v must be above 0 (or 0 for all readings, which then weigh alike)")
        scale_m2 = float(np.square(diameter.max())) or 1.0
        root_weight = 1.0 / error if absolute else np.ones_like(reading)
        x = np.square(diameter) / scale_m2
        single = cls(x, reading, root_weight, scale_m2, absolute, (x, reading))
        return single.in_ranges() if x.size > _MOST_READINGS else single

    def in_ranges(self) -> "_Data":
        """The means of these readings in narrow ranges of x, each of which weighs as all of them do."""
        low, span = self.x.min(), np.ptp(self.x)
        where = np.minimum((self.x - low) * (_RANGES / (span or 1.0)), _RANGES - 1).astype(np.intp)
        weight = self.root_weight**2
        total = np.bincount(where, weight, _RANGES)
        sums = np.stack([np.bincount(where, weight * values, _RANGES) for values in (self.x, self.volts)])
        there = total > 0
        x, volts = sums[:, there] / total[there]
        return replace(self, x=x, volts=volts, root_weight=np.sqrt(total[there]))

    def distinct(self) -> int:
        """The number of diameters that differ by more than rounding."""
        return 1 + int(np.count_nonzero(np.diff(np.sort(self.x)) > 1e-12))

    def centre(self) -> float:
        return float(np.average(self.x, weights=self.root_weight**2))

    def constant(self, constants: int) -> dict[str, Any]:
        """What a fit of so many constants says where only the mean of the readings is known."""
        mean = float(np.average(self.volts, weights=self.root_weight**2))

        def level(x: Array) -> Array:
            return np.full_like(x, mean)

        covariance = np.diag(np.full(constants, np.inf))
        covariance[0, 0] = self.covariance(np.ones((self.x.size, 1)), level)[0, 0]
        return self.residuals(level) | {"covariance": covariance, "v0_v": mean}

    def solve(self, design: Array) -> list[float]:
        weighted = design * self.root_weight[:, None]
        solution, *_ = np.linalg.lstsq(weighted, self.volts * self.root_weight, rcond=None)
        return [float(constant) for constant in solution]

    def covariance(self, design: Array, model: Callable[[Array], Array]) -> Array:
        """The covariance of linear constants: from the stated errors, else from the scatter about the fit."""
        count = design.shape[1]
        free, unknown = self.every[0].size - count, np.full((count, count), np.inf)
        # Columns differ by orders of magnitude; at equal length their cross product keeps its digits.
        weighted = design * self.root_weight[:, None]
        length = np.linalg.norm(weighted, axis=0)
        if not (length > 0).all() or (free == 0 and not self.absolute):
            return unknown
        _, singular, axes = np.linalg.svd(weighted / length, full_matrices=False)
        if singular.size < count or singular[-1] < 1e-14 * singular[0]:
            return unknown
        covariance = (axes.T / singular**2) @ axes / np.outer(length, length)
        return np.asarray(covariance if self.absolute else covariance * np.sum(self.missed_by(model) ** 2) / free)

    def missed_by(self, model: Callable[[Array], Array]) -> Array:
        """What a curve misses of every single reading. [V]"""
        x, volts = self.every
        return np.asarray(volts - model(x))

    def residuals(self, model: Callable[[Array], Array]) -> dict[str, Any]:
        residual = self.missed_by(model)
        rms_v = float(np.sqrt(np.mean(residual**2)))
        return {"residual_rms_v": rms_v, "residual_max_v": float(np.abs(residual).max())}

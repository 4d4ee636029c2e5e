"""The paper's reduced optics, Beer-Lambert (8) and Taylor (9), and the fit of their constants to readings."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError

Array = NDArray[np.float64]

# alpha D_ref^2 between these: below, (8) is a straight line in D^2 to 1e-5 of its slope; above, light is all gone.
_CURVATURE_RANGE = (1e-4, 50.0)


@dataclass(frozen=True, kw_only=True)
class _Fit:
    """What both fits tell beside their constants."""

    covariance: Array
    """Covariance of the constants, in the order of the fields; inf where the readings do not determine one."""
    residual_rms_v: float
    residual_max_v: float
    note: str
    """Empty, or one line on what the readings could not determine."""

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
        """Return the reading at a capillary diameter [m]. [V]"""
        return beer_lambert(diameter_m, v0_v=self.v0_v, v1_v=self.v1_v, alpha_per_m2=self.alpha_per_m2)


@dataclass(frozen=True, kw_only=True)
class TaylorFit(_Fit):
    """Equation (9), V = v0_v - v1_v_per_m2 D^2, fitted."""

    v0_v: float
    v1_v_per_m2: float

    def predict(self, diameter_m: ArrayLike) -> Array:
        """Return the reading at a capillary diameter [m]. [V]"""
        return taylor(diameter_m, v0_v=self.v0_v, v1_v_per_m2=self.v1_v_per_m2)


def beer_lambert(diameter_m: ArrayLike, *, v0_v: float, v1_v: float, alpha_per_m2: float) -> Array:
    """Return the reading by equation (8): v0 + v1 exp(-alpha D^2). [V]"""
    return np.asarray(v0_v + v1_v * np.exp(-alpha_per_m2 * np.square(np.asarray(diameter_m, dtype=float))))


def taylor(diameter_m: ArrayLike, *, v0_v: float, v1_v_per_m2: float) -> Array:
    """Return the reading by equation (9): v0' - v1' D^2. [V]"""
    return np.asarray(v0_v - v1_v_per_m2 * np.square(np.asarray(diameter_m, dtype=float)))


def fit_taylor(diameter_m: ArrayLike, volts: ArrayLike, stderr_v: ArrayLike | None = None) -> TaylorFit:
    """Fit the two constants of equation (9), V = V0' - V1' D^2, by (weighted) least squares.

    Parameters
    ----------
    diameter_m : (t,) float. Capillary diameter D_C + x_C, 0 or more. [m]
    volts : (t,) float. Readings. [V]
    stderr_v : (t,) float or one for all. Standard errors of the readings; they weigh them and set the errors of the
        constants. Without them (or all 0) the scatter about the fit does. Taken as independent: readings reread from
        one trace share their noise, and the errors of the slope are then upper bounds. [V]

    Where the diameters do not vary the slope is 0 with an infinite error, and `note` says so.

    Raises InputError for arrays of different length, none at all, or values that are not finite.

    References: Mascaro and Asada 2001, IEEE Trans. Robotics and Automation 17(5), eq. (9).
    """
    data = _Data.checked(diameter_m, volts, stderr_v)
    if data.distinct() == 1:
        return TaylorFit(
            **data.residuals(data.constant),
            covariance=np.diag([data.mean_variance(), np.inf]),
            note="the diameters do not vary: no slope can be told",
            v0_v=data.mean(),
            v1_v_per_m2=0.0,
        )
    centre = data.centre()
    design = np.stack([np.ones_like(data.x), -(data.x - centre)], axis=1)
    value, slope = data.solve(design)
    # From value and slope at the centre of the data to value and slope at D = 0.
    jacobian = np.array([[1.0, centre], [0.0, 1.0 / data.scale_m2]])
    covariance = _carried(data.covariance(design, data.volts - design @ [value, slope]), jacobian)
    return TaylorFit(
        **data.residuals(lambda x: value - slope * (x - centre)),
        covariance=covariance,
        note="" if np.isfinite(covariance).all() else "as many constants as readings: their errors cannot be told",
        v0_v=value + slope * centre,
        v1_v_per_m2=slope / data.scale_m2,
    )


def fit_beer_lambert(diameter_m: ArrayLike, volts: ArrayLike, stderr_v: ArrayLike | None = None) -> BeerLambertFit:
    """Fit the three constants of equation (8), V = V0 + V1 exp(-alpha D^2), by (weighted) least squares.

    At alpha D^2 of 1e-2 the curve is nearly a straight line in D^2, which fixes only the product alpha V1. So the fit
    works with value, slope and relative curvature at the centre of the readings, which the readings determine one
    by one, and turns them into V0, V1 and alpha at the end; their standard errors then say how far the three are
    known, and the prediction is good even where they are not. alpha D^2 is held in 1e-4 to 50.

    Parameters, errors and what happens where the diameters do not vary: as in `fit_taylor`. Where the curvature
    cannot be told from the readings, the constants are those of the best curve in range, their errors are large (or
    infinite, at the ends of the range), and `note` says so.

    References: Mascaro and Asada 2001, IEEE Trans. Robotics and Automation 17(5), eq. (8).
    """
    data = _Data.checked(diameter_m, volts, stderr_v)
    still = data.distinct() == 1
    if still or np.ptp(data.volts) <= 1e-12 * np.abs(data.volts).max():
        what = "diameters do not vary" if still else "readings do not change with the diameter"
        return BeerLambertFit(
            **data.residuals(data.constant),
            covariance=np.diag([data.mean_variance(), np.inf, np.inf]),
            note=f"the {what}: neither V1 nor alpha can be told",
            v0_v=data.mean(),
            v1_v=0.0,
            alpha_per_m2=0.0,
        )
    centre = data.centre()
    shift = data.x - centre
    low, high = _CURVATURE_RANGE
    curvature = _best_curvature(data, shift) if data.distinct() > 2 else low
    design = np.stack([np.ones_like(shift), -_bend(curvature, shift)], axis=1)
    value, slope = data.solve(design)

    def model(x: Array) -> Array:
        return np.asarray(value - slope * _bend(curvature, x - centre))

    # From value, slope and curvature at the centre of the data to V0, V1 and alpha.
    grown = float(np.exp(curvature * centre))
    jacobian = np.array(
        [
            [1.0, -1.0 / curvature, slope / curvature**2],
            [0.0, grown / curvature, slope * grown * (centre * curvature - 1) / curvature**2],
            [0.0, 0.0, 1.0 / data.scale_m2],
        ]
    )
    full = np.column_stack([design, -slope * _bend_slope(curvature, shift)])
    covariance = _carried(data.covariance(full, data.volts - model(data.x)), jacobian)
    note = ""
    if data.distinct() == 2:
        note = "only two different diameters: any alpha fits, and the straight line in D^2 is taken"
    elif curvature <= 1.01 * low:
        note = "the readings are straight in D^2, or bent the other way: alpha is at the low end of its range"
    elif curvature >= 0.99 * high:
        note = "the readings are a step in D^2: alpha is at the high end of its range"
    if note:
        covariance = np.full((3, 3), np.inf)
    elif not covariance[2, 2] < (curvature / data.scale_m2) ** 2:
        note = "alpha is not told from 0 within its standard error: V1 and alpha are known by their product only"
    return BeerLambertFit(
        **data.residuals(model),
        covariance=covariance,
        note=note,
        v0_v=value - slope / curvature,
        v1_v=slope / curvature * grown,
        alpha_per_m2=curvature / data.scale_m2,
    )


def _carried(covariance: Array, jacobian: Array) -> Array:
    """Return the covariance in other constants; where it is not known it stays infinite, not nan."""
    if not np.isfinite(covariance).all():
        return np.full_like(covariance, np.inf)
    return np.asarray(jacobian @ covariance @ jacobian.T)


def _bend(curvature: float, shift: Array) -> Array:
    """Return (1 - exp(-a s)) / a, which goes to s as a goes to 0."""
    return np.asarray(-np.expm1(-curvature * shift) / curvature)


def _bend_slope(curvature: float, shift: Array) -> Array:
    """Return the derivative of `_bend` by the curvature, without the loss of digits that its closed form has."""
    t = curvature * shift
    small = np.abs(t) < 1e-3
    safe = np.where(small, 1.0, t)
    closed = (safe * np.exp(-safe) + np.expm1(-safe)) / safe**2
    series = -0.5 + t / 3 - t**2 / 8
    return np.asarray(np.where(small, series, closed) * shift**2)


def _best_curvature(data: "_Data", shift: Array) -> float:
    """Return the relative curvature with the least squared residual; value and slope follow from it linearly."""
    from scipy.optimize import minimize_scalar

    def cost(log_curvature: float) -> float:
        design = np.stack([np.ones_like(shift), -_bend(float(np.exp(log_curvature)), shift)], axis=1)
        return float(np.sum(np.square((data.volts - design @ data.solve(design)) * data.root_weight)))

    # The cost can have a flat start and one valley; a coarse scan finds the valley, a bounded search its bottom.
    first, last = _CURVATURE_RANGE
    grid = np.log(np.geomspace(first, last, 41))
    costs = [cost(x) for x in grid]
    best = int(np.argmin(costs))
    low, high = grid[max(best - 1, 0)], grid[min(best + 1, grid.size - 1)]
    found = minimize_scalar(cost, bounds=(low, high), method="bounded", options={"xatol": 1e-10})
    return float(np.exp(found.x if found.fun <= costs[best] else grid[best]))


@dataclass(frozen=True)
class _Data:
    """Readings in the scaled variable x = D^2 / largest D^2, with their weights."""

    x: Array
    volts: Array
    root_weight: Array
    scale_m2: float
    absolute: bool

    @classmethod
    def checked(cls, diameter_m: ArrayLike, volts: ArrayLike, stderr_v: ArrayLike | None) -> "_Data":
        diameter, reading = (np.asarray(value, dtype=float) for value in (diameter_m, volts))
        if diameter.ndim != 1 or diameter.shape != reading.shape or diameter.size == 0:
            raise InputError(
                f"diameter_m {diameter.shape} and volts {reading.shape} must be rows of one length, and not empty"
            )
        if not (np.isfinite(diameter).all() and (diameter >= 0).all()):
            raise InputError("diameter_m must be finite and not negative; a vessel wall cannot pass through itself")
        if not np.isfinite(reading).all():
            raise InputError("volts must be finite; leave out readings that are not")
        error = np.zeros_like(reading)
        if stderr_v is not None:
            error = error + np.asarray(stderr_v, dtype=float)
        absolute = bool((error > 0).any())
        if not np.isfinite(error).all() or (error < 0).any() or (absolute and not (error > 0).all()):
            raise InputError("stderr_v must be finite and above 0 (or 0 for all readings, which then weigh alike)")
        scale_m2 = float(np.square(diameter.max())) or 1.0
        root_weight = 1.0 / error if absolute else np.ones_like(reading)
        return cls(np.square(diameter) / scale_m2, reading, root_weight, scale_m2, absolute)

    def distinct(self) -> int:
        """Return the number of diameters that are more than rounding apart."""
        return 1 + int(np.count_nonzero(np.diff(np.sort(self.x)) > 1e-12))

    def constant(self, x: Array) -> Array:
        return np.full_like(x, self.mean())

    def centre(self) -> float:
        return float(np.average(self.x, weights=self.root_weight**2))

    def mean(self) -> float:
        return float(np.average(self.volts, weights=self.root_weight**2))

    def mean_variance(self) -> float:
        design = np.ones((self.x.size, 1))
        return float(self.covariance(design, self.volts - self.mean())[0, 0])

    def solve(self, design: Array) -> list[float]:
        weighted = design * self.root_weight[:, None]
        solution, *_ = np.linalg.lstsq(weighted, self.volts * self.root_weight, rcond=None)
        return [float(constant) for constant in solution]

    def covariance(self, design: Array, residual: Array) -> Array:
        """Return the covariance of linear constants: from the stated errors, else from the scatter about the fit."""
        count = design.shape[1]
        # Columns differ by orders of magnitude; at equal length their cross product keeps its digits.
        weighted = design * self.root_weight[:, None]
        length = np.linalg.norm(weighted, axis=0)
        if not (length > 0).all():
            return np.full((count, count), np.inf)
        _, singular, axes = np.linalg.svd(weighted / length, full_matrices=False)
        if singular.size < count or singular[-1] < 1e-14 * singular[0]:
            return np.full((count, count), np.inf)
        covariance = (axes.T / singular**2) @ axes / np.outer(length, length)
        if not self.absolute:
            free = self.x.size - count
            if free == 0:
                return np.full((count, count), np.inf)
            covariance = covariance * np.sum(residual**2) / free
        return np.asarray(covariance)

    def residuals(self, model: Callable[[Array], Array]) -> dict[str, float]:
        residual = self.volts - model(self.x)
        return {
            "residual_rms_v": float(np.sqrt(np.mean(residual**2))),
            "residual_max_v": float(np.abs(residual).max()),
        }

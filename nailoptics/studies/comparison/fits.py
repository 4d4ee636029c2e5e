"""Fits of (8) and (9) to readings over growing ranges, many replicates at once, and where they stop being good."""

import numpy as np

from ...statistics import Z95

# Curvatures alpha (x_max - x_min) that a fit of (8) tries: below, it is a straight line; above, a step.
CURVATURES = np.geomspace(1e-3, 30, 161)
GAUSS_NEWTON_STEPS = 3


def line(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Least-squares line through replicates y (r, t) over x (t,), at x: (r, t) float."""
    shift = x - x.mean()
    spread = float(shift @ shift)
    slope = y @ shift / spread if spread > 0 else np.zeros(len(y))
    return y.mean(1, keepdims=True) + np.outer(slope, shift)


def exponential(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least-squares V0 + V1 exp(-a x) through replicates.

    Returns: its values at x, (r, t) float, and a, (r,) float in CURVATURES / range of x.
    """
    span = float(np.ptp(x))
    if span <= 0:
        return line(x, y), np.zeros(len(y))
    s = (x - x.min()) / span
    level = y.mean(1, keepdims=True)
    shapes = _centred(np.exp(-np.outer(CURVATURES, s)))
    gain = (shapes @ (y - level).T) ** 2 / np.sum(shapes**2, 1)[:, None]
    best = np.clip(gain.argmax(0), 1, len(CURVATURES) - 2)
    rows = np.arange(len(y))
    low, mid, high = (gain[best + k, rows] for k in (-1, 0, 1))
    bend = low - 2 * mid + high
    with np.errstate(invalid="ignore", divide="ignore"):
        off = np.where(bend < 0, 0.5 * (low - high) / bend, 0.0)
    a = CURVATURES[best] * (CURVATURES[1] / CURVATURES[0]) ** np.clip(off, -1, 1)
    for _ in range(GAUSS_NEWTON_STEPS):
        a = np.clip(a * (1 + np.clip(_step(a, s, y - level), -0.2, 0.2)), CURVATURES[0], CURVATURES[-1])
    shape = _centred(np.exp(-np.outer(a, s)))
    scale = np.sum(shape * (y - level), 1) / np.sum(shape**2, 1)
    return level + scale[:, None] * shape, a / span


def _step(a: np.ndarray, s: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Relative change of the curvatures a (r,) that a fit of level, scale and curvature asks for at once."""
    shape = np.exp(-np.outer(a, s))
    bend = _centred(-s * shape)
    shape = _centred(shape)
    # What the change of curvature adds to the shape itself is the scale's affair.
    bend -= shape * (np.sum(bend * shape, 1) / np.sum(shape**2, 1))[:, None]
    scale = np.sum(shape * y, 1) / np.sum(shape**2, 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        step = np.sum(bend * y, 1) / np.sum(bend**2, 1) / scale / a
    return np.where(np.isfinite(step), step, 0.0)


def _centred(rows: np.ndarray) -> np.ndarray:
    return np.asarray(rows - rows.mean(1, keepdims=True))


def range_errors(model: np.ndarray, traced: np.ndarray) -> np.ndarray:
    """Largest distance of a model from the trace over each range that starts at the first point, (r, t) float.

    In parts of the trace's swing over the same range; at the first point it is that at the second.
    """
    worst = np.maximum.accumulate(np.abs(model - traced), 1)
    swing = np.maximum.accumulate(traced, 1) - np.minimum.accumulate(traced, 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        error = np.where(swing > 0, worst / swing, 0.0)
    error[:, 0] = error[:, min(1, error.shape[1] - 1)]
    return error


def fitted_range_errors(x: np.ndarray, traced: np.ndarray, model: str) -> np.ndarray:
    """The same for a model that is fitted anew to each range, (r, t) float; 0 while it has as many constants."""
    free = 2 if model == "taylor" else 3
    error = np.zeros_like(traced)
    for end in range(free + 1, len(x) + 1):
        some, y = x[:end], traced[:, :end]
        fit = line(some, y) if model == "taylor" else exponential(some, y)[0]
        swing = np.ptp(y, axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            error[:, end - 1] = np.where(swing > 0, np.abs(fit - y).max(1) / swing, 0.0)
    return error


def crossing(setting: np.ndarray, error: np.ndarray, tolerance: float) -> tuple[float, bool]:
    """Setting at which an error first exceeds a tolerance, and True; the last setting and False if it never does."""
    over = np.flatnonzero(~(error <= tolerance))
    if not len(over):
        return float(setting[-1]), False
    i = int(over[0])
    if i == 0 or not np.isfinite(error[i]):
        return float(setting[max(i - 1, 0)]), True
    part = (tolerance - error[i - 1]) / (error[i] - error[i - 1])
    return float(setting[i - 1] + part * (setting[i] - setting[i - 1])), True


def limit(
    setting: np.ndarray, error: np.ndarray, stderr: np.ndarray, tolerance: float
) -> tuple[float, float, float, bool]:
    """Setting up to which an error stays within a tolerance.

    Returns: value, lower and upper end of its 95 % interval, and whether the error exceeds the tolerance at all.
    """
    value, ends = crossing(setting, error, tolerance)
    first, _ = crossing(setting, error + Z95 * stderr, tolerance)
    last, _ = crossing(setting, error - Z95 * stderr, tolerance)
    return value, first, last, ends

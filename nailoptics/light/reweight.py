"""One trace read at thousands of blood states: exactly at a few, smoothly between them."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError
from ..statistics import stderr_of_mean
from . import optics
from .moments import slope_of

if TYPE_CHECKING:
    from .transfer import Transfer

# Readings over more zones than this are taken state by state: nodes grow with the power of the zones.
MAX_ZONES_BETWEEN_NODES = 2
# Interpolation may be off by this part of a reading; no trace has a standard error near it.
INTERPOLATION_ERROR = 1e-8
# Photons read at once: their weights at all nodes fill the processor's cache, not the memory.
CHUNK = 4096


@dataclass(frozen=True)
class Course:
    """Readings over many states, (led, photodiode, state) float each, fractions of the emitted power.

    fraction, stderr : detected fraction and its standard error.
    change, change_stderr : difference from the first state; both share their noise, so that its error is small.
    """

    fraction: np.ndarray
    stderr: np.ndarray
    change: np.ndarray
    change_stderr: np.ndarray


def course(
    transfer: "Transfer", blood_fraction: np.ndarray, *, so2: float | None = None, electrons: bool = False
) -> Course:
    """Readings over a course of blood states; a press of ten thousand steps takes about as long as one of a hundred.

    Readings are smooth in the blood: they are taken at Chebyshev nodes over the range of states, as many as keep the
    error of interpolation below 1e-8 of a reading for all but the longest paths, and interpolated.

    Parameters
    ----------
    blood_fraction : (t, K) float in 0-1. Blood of each zone in each state.
    electrons : weigh the LED's line by the photodiode's response, relative to that at the peak wavelength.

    Warns: RereadWarning where fewer than 100 effective photons stand behind a reading of some state, or fewer than 25
    behind the standard error of one that is brighter than the traced state.
    """
    found = _course(transfer, blood_fraction, so2, electrons)
    with np.errstate(invalid="ignore", divide="ignore"):
        # Of n equal photons the relative error is 1 / sqrt(n).
        effective = np.square(found.fraction / found.stderr)
    # Where there is least blood, single long paths weigh most.
    palest = transfer.moments_at(np.min(blood_fraction, 0), so2)
    transfer.warn_if_thin(np.nan_to_num(effective, nan=np.inf).min(-1), palest)
    return found


def _course(transfer: "Transfer", blood_fraction: np.ndarray, so2: float | None, electrons: bool) -> Course:
    states = np.asarray(blood_fraction, float)
    count = optics.zones(transfer.scene).count
    if states.ndim != 2 or states.shape[1] != count or not len(states):
        raise InputError(f"blood_fraction has shape {states.shape}; give (states, {count}), one value for each zone.")
    low, high = states.min(0), states.max(0)
    varies = np.flatnonzero(high - low > 1e-12)
    if not len(varies):
        one = _sums(transfer, states[:1], states[0], so2, electrons)
        return Course(*(np.repeat(values, len(states), -1) for values in one))
    counts = [_nodes_needed(transfer, int(k), high[k] - low[k], so2) for k in varies]
    if len(states) <= np.prod(counts) or len(varies) > MAX_ZONES_BETWEEN_NODES:
        return Course(*_sums(transfer, states, states[0], so2, electrons))
    nodes, weights = _barycentric(states[:, varies], low[varies], high[varies], counts)
    at_nodes = np.repeat(states[:1], len(nodes), 0)
    at_nodes[:, varies] = nodes
    fraction, stderr, change, change_stderr = _sums(transfer, at_nodes, states[0], so2, electrons)
    return Course(
        fraction=fraction @ weights.T,
        stderr=np.sqrt(np.maximum(stderr**2 @ weights.T, 0)),
        change=change @ weights.T,
        change_stderr=np.sqrt(np.maximum(change_stderr**2 @ weights.T, 0)),
    )


def _nodes_needed(transfer: "Transfer", zone: int, span: float, so2: float | None) -> int:
    """Chebyshev nodes that interpolate exp(-x) over the optical depths that a zone's range of blood spans."""
    depth = 0.0
    for trace, led in zip(transfer.traces, transfer.scene.leds, strict=True):
        column = optics.bed_columns(transfer.scene)[zone]
        if len(trace.weight):
            more = optics.absorption(
                transfer.scene, led.wavelength_nm, blood_fraction=np.ones(optics.zones(transfer.scene).count), so2=so2
            )
            less = optics.absorption(
                transfer.scene, led.wavelength_nm, blood_fraction=np.zeros(optics.zones(transfer.scene).count), so2=so2
            )
            slope = float((more - less)[0, column])
            depth = max(depth, slope * span * float(np.quantile(trace.path_mm[:, column], 0.999)))
    # The error of n nodes on exp over a range of depth d is (d / 4)^n 2 / n!; squares double the depth.
    count, error = 2, math.inf
    while error > INTERPOLATION_ERROR and count < 24:
        count += 1
        error = 2 * (depth / 2) ** count / math.factorial(count)
    return count


def _barycentric(
    states: np.ndarray, low: np.ndarray, high: np.ndarray, counts: list[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Chebyshev nodes (m, d) over a box, and each state's weights on them (t, m) (Berrut, Trefethen 2004)."""
    axes, weights = [], np.ones((len(states), 1))
    for column, a, b, n in zip(states.T, low, high, counts, strict=True):
        angle = (2 * np.arange(n) + 1) * np.pi / (2 * n)
        sign = np.sin(angle) * (-1.0) ** np.arange(n)
        axis = (a + b) / 2 + (b - a) / 2 * np.cos(angle)
        away = column[:, None] - axis
        on_node = np.abs(away) < 1e-14 * (b - a)
        share = sign / np.where(on_node, 1, away)
        share = np.where(on_node.any(1, keepdims=True), on_node, share / share.sum(1, keepdims=True))
        weights = (weights[:, :, None] * share[:, None, :]).reshape(len(states), -1)
        axes.append(axis)
    grids = np.meshgrid(*axes, indexing="ij")
    return np.stack([grid.ravel() for grid in grids], -1).reshape(-1, len(low)), weights


def _sums(
    transfer: "Transfer", states: np.ndarray, first: np.ndarray, so2: float | None, electrons: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Fraction, its error, change from a first state and its error, (led, photodiode, states) each."""
    shape = (len(transfer.traces), len(transfer.photodiodes), len(states))
    out = tuple(np.zeros(shape) for _ in range(4))
    for i, (trace, led) in enumerate(zip(transfer.traces, transfer.scene.leds, strict=True)):
        wavelength, share = optics.spectrum(led)
        if electrons:
            share = share * wavelength / led.wavelength_nm
        mu_a = (
            optics.absorption(transfer.scene, wavelength, blood_fraction=np.vstack([first, states]), so2=so2)
            - trace.mu_a
        )
        sums, full = np.zeros((4, *shape[1:])), trace.full
        # Of a sample of the photons: sums at rest and of their products with the values, to hold them against all.
        rest, rest_square, products = np.zeros(shape[1]), np.zeros(shape[1]), np.zeros((2, *shape[1:]))
        at_rest = trace.weight_at_rest if full is not None else None
        order = np.argsort(trace.photodiode, kind="stable")
        edges = np.searchsorted(trace.photodiode[order], np.arange(shape[1] + 1))
        pieces = [(p, at) for p in range(shape[1]) for at in range(edges[p], edges[p + 1], CHUNK)]
        for j, start in pieces:
            chunk = order[start : min(start + CHUNK, edges[j + 1])]
            weight = _weights(trace.path_mm[chunk], mu_a, share) * trace.weight[chunk, None]
            change = weight[:, 1:] - weight[:, :1]
            weight = weight[:, 1:]
            for total, values in zip(sums, (weight, weight**2, change, change**2), strict=True):
                total[j] += values.sum(0)
            if at_rest is not None:
                own = at_rest[chunk]
                rest[j] += own.sum()
                rest_square[j] += own @ own
                products[0, j] += own @ weight
                products[1, j] += own @ change
        for k, unseen in ((0, 1.0), (2, 0.0)):
            total, square = sums[k], sums[k + 1]
            if full is not None:
                slope = slope_of(products[k // 2], rest_square[:, None], unseen)
                total = slope * full.weight[:, None] + (total - slope * rest[:, None])
                left = np.maximum(square - slope * products[k // 2], 0)
                square = slope**2 * full.square[:, None] + left
            out[k][i] = total / trace.photons
            out[k + 1][i] = stderr_of_mean(total, square, trace.photons)
    return out  # type: ignore[return-value]


def _weights(path_mm: np.ndarray, mu_a: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Transmission of each path in each state, averaged over the line, (n, states) float.

    mu_a : (states, q, r) float, less that of the trace. [mm^-1]
    """
    out = np.zeros((len(path_mm), len(mu_a)))
    fixed = np.ptp(mu_a, axis=0).max(0) == 0
    path = path_mm.astype(float)
    for q, part in enumerate(share):
        # What no state changes is worked out once; each zone's few values once each, not once per state.
        factor = part * np.exp(-(path[:, fixed] @ mu_a[0, q, fixed]))[:, None]
        for k in np.flatnonzero(~fixed):
            values, which = np.unique(mu_a[:, q, k], return_inverse=True)
            factor = factor * np.exp(-np.outer(path[:, k], values))[:, which]
        out += factor
    return out

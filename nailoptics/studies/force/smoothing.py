"""Estimates that use the future, too: the filter run forward, then corrected backward (Rauch, Tung, Striebel 1965)."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .observer import LOWEST, Estimate, Observer

Array = NDArray[np.float64]

# So many samples are corrected at a time, and so many more are read ahead of them: later ones tell nothing about them.
BLOCK, AHEAD = 4000, 1000
# Directions of less than this part of the largest spread are known; nothing is corrected along them.
LEAST_SPREAD = 1e-9


def smooth(observer: Observer, samples: Iterable[tuple[Array, float | None]]) -> list[Estimate]:
    """Estimates of all samples (volts, time since the one before)."""
    out: list[Estimate] = []
    kept: list[tuple[Estimate, Array, Array, Array, Array, Array]] = []
    for volts, since_s in samples:
        estimate = observer.see(volts, since_s)
        predicted = observer.predicted_state, observer.predicted_covariance, observer.transition
        kept.append((estimate, observer.state.copy(), observer.covariance.copy(), *predicted))
        if len(kept) == BLOCK + AHEAD:
            out += _backward(observer, kept)[:BLOCK]
            kept = kept[BLOCK:]
    return out + _backward(observer, kept)


def _backward(observer: Observer, kept: list[tuple[Estimate, Array, Array, Array, Array, Array]]) -> list[Estimate]:
    own = slice(0, observer.estimated)
    estimate, state, covariance, *_ = kept[-1]
    out = [estimate]
    for (here, filtered, spread, *_), (_, _, _, ahead, ahead_spread, transition) in zip(
        reversed(kept[:-1]), reversed(kept[1:]), strict=True
    ):
        # What is carried along is not corrected; each unknown is measured in its own spread, which differ by decades.
        scale = np.sqrt(np.diag(ahead_spread)[own])
        inverse = np.linalg.pinv(ahead_spread[own, own] / np.outer(scale, scale), rcond=LEAST_SPREAD, hermitian=True)
        weight = np.zeros_like(spread)
        weight[own, own] = (spread @ transition.T)[own, own] / scale @ inverse / scale
        state = filtered + weight @ (state - ahead)
        state[observer.touch] = np.maximum(state[observer.touch], LOWEST)
        covariance = spread + weight @ (covariance - ahead_spread) @ weight.T
        out.append(
            replace(
                here,
                touch=state[observer.touch],
                covariance=covariance[np.ix_(observer.shown, observer.shown)],
                arterial_pa=float(observer.arterial @ state),
            )
        )
    return out[::-1]

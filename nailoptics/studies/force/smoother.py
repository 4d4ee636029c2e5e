"""What an observer would have told of every sample, had it known those after it as well."""

from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from .observer import TOUCH, Observer, PressureEstimate, going_on, within

Array = NDArray[np.float64]

# What rounding adds to a foretold variance.
ROUNDING = 1e-12


class Passage(NamedTuple):
    """A sample and how it came about from the one before it.

    estimate : what it told by itself and those before it. state, covariance, ways : the observer's after it.
    slopes : of its state by that before; None where the observer began anew. since_s : time from it. [s]
    foretold, each, expected : state, covariances by ways of moving, and these ways' probabilities, before its readings.
    """

    estimate: PressureEstimate
    state: Array
    covariance: Array
    ways: Array
    slopes: Array | None
    since_s: float
    foretold: Array
    each: Array
    expected: Array


def smoothed_estimates(observer: Observer, samples: Iterable[tuple[Array, float | None]]) -> list[PressureEstimate]:
    """Estimates of samples (volts and time from the sample before), each from all of them.

    A backward pass over the linearised steps. The state after a step was foretold with no less than the step made of
    the state before it, so that a difference shrinks on its way back: the pass is stable.

    References: Rauch, Tung, Striebel 1965, AIAA J. 3:1445; the ways of moving as in Kim 1994, J. Econometrics 60:1.
    """
    passages = [_passage(observer, volts, since_s) for volts, since_s in samples]
    out: list[PressureEstimate] = []
    later, known = None, (np.empty(0),) * 3
    for one in reversed(passages):
        if later is None or later.slopes is None:
            known = one.state, one.covariance, one.ways
        else:
            state, covariance, ways = _back(one, later, known)
            known = within(state, covariance, observer.touches, observer.drift), covariance, ways
        later = one
        out.append(
            replace(
                one.estimate,
                touch=one.estimate.touch + known[0][TOUCH] - one.state[TOUCH],
                covariance=known[1][TOUCH, TOUCH].copy(),
                arterial_pa=float((observer.beating + observer.slow) @ known[0]),
            )
        )
    return out[::-1]


def _passage(observer: Observer, volts: Array, since_s: float | None) -> Passage:
    slopes = None if since_s is None else observer.foresee(since_s)
    foretold, each, expected = observer.state, observer.each, observer.ways
    estimate = observer.take_in(volts, since_s)
    return Passage(
        estimate, observer.state, observer.covariance, observer.ways, slopes, since_s or 0.0, foretold, each, expected
    )


def _back(one: Passage, after: Passage, known: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
    """State, covariance and ways of moving of a sample from those known of the sample after it."""
    later_state, later_covariance, later_ways = known
    assert after.slopes is not None
    foretold = np.einsum("m,mij->ij", later_ways, after.each)
    # In standard deviations: pascals and widths lie far apart.
    scale = np.sqrt(np.diag(foretold))
    alike = foretold / np.outer(scale, scale) + ROUNDING * np.eye(len(scale))
    gain = cho_solve(cho_factor(alike), (after.slopes @ one.covariance) / scale[:, None]).T / scale
    state = one.state + gain @ (later_state - after.foretold)
    covariance = one.covariance + gain @ (later_covariance - foretold) @ gain.T
    ways = one.ways * (going_on(after.since_s) @ (later_ways / np.maximum(after.expected, 1e-300)))
    return state, covariance, ways / ways.sum()

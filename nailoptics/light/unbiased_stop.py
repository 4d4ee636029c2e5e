"""Takes out again what luck put into a trace that ended as soon as its error looked small enough."""

from collections.abc import Callable, Sequence

import numpy as np

# Random orders of the batches that are tried, as long as all their sums hold no more numbers than this.
MOST_ORDERS, MOST_SUMS = 1000, 2_000_000


def batch_factors(
    sums: np.ndarray, meets: Callable[[np.ndarray, int], np.ndarray], checks: Sequence[int]
) -> np.ndarray:
    """What each batch of a trace that stopped by itself must count for, so that its mean is unbiased, (n,) float.

    The first batches, up to where no rule could stop yet, are chosen by nobody: their mean is unbiased, but of few
    photons. In which order the batches came says nothing about the light, so that mean may be averaged over all
    orders in which the same rule would have stopped after the same n batches, and not before (Rao-Blackwell). Nearly
    all photons then count nearly alike; the mean is exact whatever the weights are distributed like, of which a bound
    on the number of photons cannot be sure.

    sums : (n, ...) float. Sums over the photons of each batch, from which the rule decides.
    meets : whether the rule is met by totals, (m, ...) float, over a number of batches; (m,) bool.
    checks : numbers of batches after which it was asked in vain.

    References: Blackwell 1947, Ann. Math. Statist. 18, 105; Girshick, Mosteller, Savage 1946, ibid. 17, 13.
    """
    count = len(sums)
    tried = int(np.clip(MOST_SUMS // sums.size, 1, MOST_ORDERS))
    orders = np.random.default_rng(0).permuted(np.tile(np.arange(count), (tried, 1)), axis=1)
    stops = np.full(tried, count)
    for check in reversed(checks):
        stops[meets(sums[orders[:, :check]].sum(1), check)] = check
    fewest = int(stops.min())
    # One order in which the rule stops there is known: that in which they came.
    orders[0], stops[0] = np.arange(count), count
    first = orders[stops == count, :fewest]
    return np.bincount(first.ravel(), minlength=count) * (count / first.size)

"""Standard errors, intervals and streams of seeds, each defined once."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

# A value known with a Gaussian error lies within so many standard errors of the truth in 95 of 100 cases.
Z95 = 1.96


def stderr_of_mean(total: ArrayLike, square: ArrayLike, count: int) -> Array:
    """Standard error of total / count, from the sum of squares over independent samples; NaN of one sample."""
    mean = np.asarray(total) / count
    if count < 2:
        return np.full_like(mean, np.nan)
    return np.asarray(np.sqrt(np.maximum(np.asarray(square) / count - mean**2, 0) / (count - 1)))


def left_out(groups: Array) -> Array:
    """Means over all groups, and over all but each: (1 + n, ...) float of (n, ...) sums scaled as means."""
    total = groups.sum(0)
    return np.concatenate([total[None] / len(groups), (total - groups) / (len(groups) - 1)])


def jackknife(replicates: Array) -> Array:
    """Standard error of what was made from all groups and without each, (1 + n, ...) float (Efron, Stein 1981)."""
    each = replicates[1:]
    return np.asarray(np.sqrt((len(each) - 1) / len(each) * ((each - each.mean(0)) ** 2).sum(0)))


def seed_of(seed: int, *key: int) -> int:
    """The seed of one stream of random numbers; other keys and other seeds give streams that share nothing."""
    return int(np.random.SeedSequence(seed, spawn_key=key).generate_state(1, np.uint64)[0])

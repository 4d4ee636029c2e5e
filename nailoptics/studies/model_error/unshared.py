"""What two traces of one seed do not share: the photons that alone make up their difference."""

from dataclasses import replace

import numpy as np

from ...light.records import LedTrace
from ...light.transfer import Transfer


def unshared_photons(one: Transfer, other: Transfer) -> tuple[Transfer, Transfer]:
    """Both traces without the photons they share.

    In scenes that differ in one part, a photon that never meets that part goes the same way and counts the same, bit
    for bit, if both traces have one seed and as many photons. What is left of each makes up their difference, with
    only its own noise; without a common seed that is everything.
    """
    pairs = [_unshared(a, b) for a, b in zip(one.traces, other.traces, strict=True)]
    left, right = zip(*pairs, strict=True)
    return replace(one, traces=left), replace(other, traces=right)


def _unshared(a: LedTrace, b: LedTrace) -> tuple[LedTrace, LedTrace]:
    if a.photons != b.photons or a.seeds != b.seeds:
        return a, b
    keys_a, keys_b = _keys(a), _keys(b)
    return a.only(~np.isin(keys_a, keys_b)), b.only(~np.isin(keys_b, keys_a))


def _keys(trace: LedTrace) -> np.ndarray:
    """All that is known of each photon, as one item of bytes, (n,)."""
    columns = np.column_stack([trace.photodiode, trace.weight, trace.path_mm]).astype(np.float32)
    return np.ascontiguousarray(columns).view(np.dtype((np.void, columns.dtype.itemsize * columns.shape[1]))).ravel()

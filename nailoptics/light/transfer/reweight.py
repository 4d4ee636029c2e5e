"""What absorption leaves of traced photons, exp(-sum_k L_k d mu_a,k): the one place that computes it."""

import numpy as np


def attenuation(path_mm: np.ndarray, mu_a: np.ndarray) -> np.ndarray:
    """What each photon's weight is multiplied by in other states, (n,) or (n, m) float.

    path_mm : (n, r) float. Path in each absorber. [mm]
    mu_a : (r,) or (m, r) float. Absorption, less that for which the weights hold. [mm^-1]
    """
    return np.asarray(np.exp(-(path_mm @ mu_a.T)))


def transmission(path_mm: np.ndarray, mu_a: np.ndarray, share: np.ndarray) -> np.ndarray:
    """What each photon's weight is multiplied by in another state, averaged over the LED's line, (n,) float.

    mu_a : (q, r) float. Absorption over the line, less that for which the weights hold. [mm^-1]
    share : (q,) float. Weights of the line.
    """
    factor = np.zeros(len(path_mm))
    for mu, part in zip(mu_a, share, strict=True):
        factor += part * attenuation(path_mm, mu)
    return factor


def transmissions(path_mm: np.ndarray, mu_a: np.ndarray, share: np.ndarray) -> np.ndarray:
    """The same in many states that differ in few absorbers, (n, states) float.

    mu_a : (states, q, r) float. [mm^-1]
    """
    out = np.zeros((len(path_mm), len(mu_a)))
    fixed = np.ptp(mu_a, axis=0).max(0) == 0
    path = path_mm.astype(float)
    for q, part in enumerate(share):
        # What no state changes is worked out once; each zone's few values once each, not once per state.
        factor = part * attenuation(path[:, fixed], mu_a[0, q, fixed])[:, None]
        for k in np.flatnonzero(~fixed):
            values, which = np.unique(mu_a[:, q, k], return_inverse=True)
            factor = factor * attenuation(path[:, [k]], values[:, None])[:, which]
        out += factor
    return out

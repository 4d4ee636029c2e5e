"""Light that layers of tissue reflect and transmit, by adding-doubling: S. A. Prahl et al., Appl. Opt. 32, 559 (1993).

Directions are those of the layer of the largest refractive index; in every other layer the same light goes as Snell's
law says, so that refraction maps direction onto direction. Henyey-Greenstein scattering, its forward peak removed by
delta-M (W. J. Wiscombe, J. Atmos. Sci. 34, 1408 (1977)). Light falls in at right angles, which by reciprocity is light
from all sides seen from above. Within 0.5 % of iadpython for a plate and of the walk through flat layers for three.
"""

from collections.abc import Sequence

import numpy as np

Array = np.ndarray
ANISOTROPY = 0.9
# Gauss-Legendre points between two critical angles, and Legendre orders of the phase function.
POINTS, ORDER = 3, 4
# Optical depth, along the flattest direction, of the thin layer that is doubled.
THIN = 0.3
# n, mu_a, mu_s' (q,) [mm^-1] and thickness [mm].
Layer = tuple[float, Array, Array, float]


class Stack:
    """Layers of some refractive indices, with air above."""

    def __init__(self, *indices: float) -> None:
        self.index = max(indices)
        cuts = sorted({0.0, 1.0, *(float(np.sqrt(1 - (n / self.index) ** 2)) for n in (1.0, *indices))})
        x, w = np.polynomial.legendre.leggauss(POINTS)
        pairs = list(zip(cuts, cuts[1:], strict=False))
        # The last direction is vertical, of no weight: that of the light that falls in.
        self.cosine = np.concatenate([*((a + b + (b - a) * x) / 2 for a, b in pairs), [1.0]])
        self.weight = np.concatenate([*((b - a) * w / 2 for a, b in pairs), [0.0]])
        self.one = np.eye(len(self.cosine))

    def reflects(self, layers: Sequence[Layer]) -> Array:
        """Reflectance of layers, the top one first, without what their surface mirrors, (q,) float."""
        below, under = np.zeros_like(self.one), layers[-1][0]
        for n, mu_a, reduced, thickness_mm in reversed(layers):
            below = self._under_interface(below, self._mirrors(n, under))
            reflected, passed = self._slab(n, mu_a, reduced, thickness_mm)
            below = reflected + passed @ below @ np.linalg.solve(self.one - reflected @ below, passed)
            under = n
        mirrored = self._mirrors(1.0, under)
        return np.asarray(self._under_interface(below, mirrored)[..., -1].sum(-1) - mirrored[-1])

    def passes(self, layer: Layer) -> Array:
        """Transmittance of one layer in air, in all directions, (q,) float."""
        reflected, passed = self._slab(*layer)
        mirrored = self._mirrors(1.0, layer[0])
        entered = (self.one[-1] * (1 - mirrored))[:, None]
        # Light downward at the top and upward at the bottom, as their sum and their difference.
        both = (np.linalg.solve(self.one - mirrored[:, None] * (reflected + s * passed), entered) for s in (1, -1))
        even, odd = both
        out = passed @ (even + odd) / 2 + reflected @ (even - odd) / 2
        return np.asarray(((1 - mirrored)[:, None] * out)[..., 0].sum(-1))

    def _directions(self, n: float) -> tuple[Array, Array, Array]:
        """Cosines and weights in a layer, and which of the directions exist there."""
        square = 1 - (self.index / n) ** 2 * (1 - self.cosine**2)
        exists = square > 1e-12
        cosine = np.sqrt(np.where(exists, square, 1.0))
        weight = np.where(exists, self.weight * self.cosine / cosine, 0.0)
        return cosine, weight / weight.sum(), exists

    def _mirrors(self, above: float, below: float) -> Array:
        """Fresnel reflectance of the interface of two indices; 1 where light is totally reflected."""
        (a, _, over), (b, _, under) = self._directions(above), self._directions(below)
        s, p = (above * a - below * b) / (above * a + below * b), (below * a - above * b) / (below * a + above * b)
        return np.where(over & under, (s**2 + p**2) / 2, 1.0)

    def _under_interface(self, below: Array, mirrored: Array) -> Array:
        """Reflection of what lies below an interface, and of the interface."""
        passed = 1 - mirrored
        again = below @ np.linalg.inv(self.one - mirrored[:, None] * below)
        return np.diag(mirrored) + passed[:, None] * again * passed

    def _slab(self, n: float, mu_a: Array, reduced: Array, thickness_mm: float) -> tuple[Array, Array]:
        """Reflection and transmission of a layer without its interfaces, (q, d, d) float each."""
        cosine, weight, exists = self._directions(n)
        order = np.arange(ORDER)
        peak = ANISOTROPY**ORDER
        terms = (2 * order + 1) * (ANISOTROPY**order - peak) / (1 - peak) / 2
        of = np.polynomial.legendre.legvander(cosine, ORDER - 1)
        ahead, back = (
            (weight * exists)[:, None] * exists * np.einsum("k,ik,jk", terms * sign**order, of, of)
            for sign in (1.0, -1.0)
        )
        # What the quadrature loses or gains of the light is given back.
        whole = np.where(exists, (ahead + back).sum(0), 1.0)
        scatters = reduced / (1 - ANISOTROPY) * (1 - peak)
        depth = float(np.max((mu_a + scatters) * thickness_mm)) / (THIN * cosine[exists].min())
        doublings = max(0, int(np.ceil(np.log2(max(depth, 1e-6)))))
        half = thickness_mm / 2**doublings / 2 / cosine
        lost = self.one * half * (mu_a + scatters)[:, None, None]
        lost, back = (
            lost - half * scatters[:, None, None] * ahead / whole,
            half * scatters[:, None, None] * back / whole,
        )
        within = np.linalg.inv(self.one + lost)
        turned, kept = within @ back, within @ (self.one - lost)
        reflected = np.linalg.solve(self.one - turned @ turned, turned @ (self.one + kept))
        passed = kept + turned @ reflected
        for _ in range(doublings):
            again = passed @ np.linalg.inv(self.one - reflected @ reflected)
            reflected, passed = reflected + again @ reflected @ passed, again @ passed
        both = exists[:, None] & exists
        return reflected * both, passed * both

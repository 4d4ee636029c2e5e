"""What `explore` returns, made by formulas in place of light, for tests of its page."""

import numpy as np

from nailoptics.light.pair_kernel import RadialFunction, pair_basis
from nailoptics.scene import Scene
from nailoptics.sensor.ambient import SOURCES
from nailoptics.studies.exploration.blood_ratio import BloodPolynomial, ratio_basis
from nailoptics.studies.exploration.colour_table import BLOCKS, ColourTable
from nailoptics.studies.exploration.explore import (
    Exploration,
    colours,
    explored_board,
    fluence_edges,
    touch_table,
)


def made_exploration(scene: Scene, *, seed: int = 0) -> Exploration:
    """Kernels that fall with the distance, uneven by a fifth, whose readings fall as blood comes."""
    rng, base = np.random.default_rng(seed), explored_board(scene)
    layout = base.layout
    basis = pair_basis(layout.outline, layout.barriers[0] if layout.barriers else None)
    ratio = ratio_basis(basis)
    distance_mm = np.geomspace(0.2, 20, 30)
    radial = RadialFunction(np.log(distance_mm), -distance_mm - 1.0)
    polynomial, touch = BloodPolynomial((0.0, 0.1), (0.7, 1.0)), touch_table(base)
    rings, depths = fluence_edges(base)
    fluence = np.exp(-(rings[:-1, None] + depths[None, :-1]))
    tables = []
    for led in colours(base):
        at_rest = 0.01 * rng.uniform(0.8, 1.2, basis.size)
        blocks = at_rest * rng.normal(1.0, 0.05, (BLOCKS, basis.size))
        zones = rng.uniform(2.0, 4.0, (ratio.size, 2))
        blood, so2 = polynomial.states[:, :2] - base.blood.rest_blood_fraction, polynomial.states[:, 2]
        parts = np.exp(-zones @ blood.T) * (1 + so2) / (1 + base.blood.so2)
        ratios = parts @ polynomial.coefficients.T
        ratio_blocks = -zones * rng.normal(1.0, 0.05, (BLOCKS, ratio.size, 1))
        light = at_rest, 0.2 * at_rest, blocks, ratios, ratio_blocks, fluence
        tables.append(ColourTable(led, *light, photons=1000))
    nodes = (np.linspace(layout.outline.u_min, layout.outline.u_max, 4), basis.coarse_along_mm)
    ambient = 1e-9 * rng.uniform(1, 2, (len(SOURCES), *(len(axis) for axis in nodes)))
    return Exploration(
        base, basis, ratio, radial, polynomial, tables, touch, nodes, ambient, {"photons": 1000, "seed": seed}
    )

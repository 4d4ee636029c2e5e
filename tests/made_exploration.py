"""What `explore` returns, made by formulas in place of light, for tests of its page."""

import numpy as np

from nailoptics.light.pair_kernel import RadialFunction, pair_basis
from nailoptics.scene import Scene
from nailoptics.studies.ambient import SOURCES
from nailoptics.studies.exploration.blood_polynomial import BloodPolynomial
from nailoptics.studies.exploration.explore import (
    BLOCKS,
    ColourTable,
    Exploration,
    colours,
    explored_board,
    fluence_edges,
)
from nailoptics.studies.exploration.touch_table import touch_table


def made_exploration(scene: Scene, *, seed: int = 0) -> Exploration:
    """Kernels that fall with the distance, uneven by a fifth, whose readings fall as blood comes."""
    rng, base = np.random.default_rng(seed), explored_board(scene)
    layout = base.layout
    basis = pair_basis(layout.outline, layout.barriers[0] if layout.barriers else None)
    distance_mm = np.geomspace(0.2, 20, 30)
    radial = RadialFunction(np.log(distance_mm), -distance_mm - 1.0)
    polynomial, touch = BloodPolynomial((0.0, 0.1), (0.7, 1.0)), touch_table(base)
    rings, depths = fluence_edges(base)
    fluence = np.exp(-(rings[:-1, None] + depths[None, :-1]))
    tables = []
    for led in colours(base):
        mean = 0.01 * rng.uniform(0.8, 1.2, basis.size)
        zones = rng.uniform(2.0, 4.0, (basis.size, 2))
        states = polynomial.states
        reading = mean[:, None] * np.exp(-zones @ states[:, :2].T) * (0.5 + 0.5 * states[:, 2])
        rest = base.blood.rest_blood_fraction
        at_rest = mean * np.exp(-zones.sum(1) * rest) * (0.5 + 0.5 * base.blood.so2)
        columns = np.column_stack([at_rest, *(-zones.T * at_rest)])
        blocks = columns * rng.normal(1.0, 0.05, (BLOCKS, basis.size, 1))
        coefficients = reading @ polynomial.coefficients.T
        tables.append(ColourTable(led, coefficients, 0.2 * at_rest, blocks, fluence, photons=1000))
    nodes = (np.linspace(layout.outline.u_min, layout.outline.u_max, 4), basis.coarse_along_mm)
    ambient = 1e-9 * rng.uniform(1, 2, (len(SOURCES), *(len(axis) for axis in nodes)))
    return Exploration(base, basis, radial, polynomial, tables, touch, nodes, ambient, {"photons": 1000, "seed": seed})

"""What `explore` returns, made by formulas in place of light, for tests of its page."""

from dataclasses import replace

import numpy as np
import xarray as xr

from nailoptics.scene import Scene
from nailoptics.sensor.ambient import SOURCES
from nailoptics.studies.exploration.drawn_people import QUANTILES, DrawnPerson
from nailoptics.studies.exploration.explore import (
    BLOCKS,
    Exploration,
    WavelengthTable,
    blood_polynomial,
    explored_board,
    led_per_wavelength,
    touch_table,
)
from nailoptics.studies.exploration.pair_table import BloodPolynomial, RadialFunction, pair_basis
from nailoptics.studies.prior_uncertainty import at_value, draw_people, known_priors, only_absorbs


def made_exploration(scene: Scene, *, seed: int = 0, every: int = 2) -> Exploration:
    """Kernels that fall with the distance, uneven by a fifth, whose readings fall as blood comes.

    every : of the nodes of the table in each direction, and the last; 1 for all that `explore` has, of which a page is
        large, and takes long to be read.
    """
    rng, base = np.random.default_rng(seed), explored_board(scene)
    layout = base.layout
    basis = pair_basis(layout.outline, layout.barriers[0] if layout.barriers else None)
    basis = replace(basis, axes=tuple(np.union1d(axis[::every], axis[-1:]) for axis in basis.axes))
    radial = RadialFunction(np.array([-0.3, -2.0, -5.5]))
    polynomial, touch = BloodPolynomial((0.0, 0.1), (0.7, 1.0)), touch_table(base)
    radius_mm, depth_mm = np.arange(0.15, 10.0, 0.3), np.arange(0.05, 3.0, 0.1)
    fluence = np.exp(-(radius_mm[:, None] + depth_mm))
    fluence = xr.DataArray(fluence, {"radius_mm": radius_mm, "depth_mm": depth_mm})
    drawn, tables = draw_people(base, len(QUANTILES)), []
    people = []
    for i, values in enumerate(drawn):
        worn = base
        for prior in (prior for prior in known_priors(base) if only_absorbs(base, prior)):
            worn = at_value(worn, prior.field, values[prior.field])
        people.append(DrawnPerson(worn, 0.01 * (i + 1)))
    for led in led_per_wavelength(base):
        at_rest = rng.uniform(0.8, 1.2, (basis.size, 1))
        zones = rng.uniform(2.0, 4.0, (basis.size, 2))
        blood, so2 = polynomial.states[:, :2] - base.blood.rest_blood_fraction, polynomial.states[:, 2]
        readings = at_rest * np.exp(-zones @ blood.T) * (1 + so2) / (1 + base.blood.so2)
        blocks = at_rest * np.column_stack([np.ones(basis.size), -zones])
        blocks = blocks * rng.normal(1.0, 0.05, (BLOCKS, basis.size, 1))
        coefficients = readings @ polynomial.coefficients.T
        of_people = []
        for one in people:
            over = blood_polynomial(one.scene, chosen=False)
            blood = over.states[:, :2] - base.blood.rest_blood_fraction
            readings = rng.uniform(0.5, 1.5) * at_rest * np.exp(-zones @ blood.T)
            of_people.append(readings @ over.coefficients.T)
        table = WavelengthTable(led, coefficients, 0.2 * at_rest[:, 0], blocks, fluence, 1000, np.array(of_people))
        tables.append(table)
    r = layout.outline
    nodes = tuple(np.linspace(*ends, 6) for ends in ((r.u_min, r.u_max), (r.v_min, r.v_max)))
    ambient = 1e-9 * rng.uniform(1, 2, (len(SOURCES), BLOCKS, 6, 6))
    made = {"photons": 1000, "seed": seed}
    return Exploration(base, basis, radial, polynomial, tables, touch, (nodes[0], nodes[1]), ambient, people, made)

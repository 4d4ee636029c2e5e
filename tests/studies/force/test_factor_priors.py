"""Priors of fitted factors beside those of a scene's fields: neither narrower, nor of another network."""

import numpy as np
import pytest

from nailoptics.hemodynamics.parameters import parameters
from nailoptics.scene.priors import factor_priors, shipped_priors
from nailoptics.statistics import Z95


def _odds(share: float) -> float:
    return share / (1.0 - share)


@pytest.mark.parametrize(
    ("factor", "field"),
    [
        ("vein_stiffness", "blood.wall_stiffness"),
        ("capillary_stiffness", "blood.wall_stiffness"),
        ("contact_area", "touch.contact_area_mm2"),
        ("rest_blood", "blood.rest_blood_fraction"),
        ("proximal_share", "touch.proximal_share"),
    ],
)
def test_a_fitted_factor_may_lie_as_far_off_as_fingers_differ(factor, field):
    [prior] = [prior for prior in shipped_priors() if prior.field == field]
    low, high = (_odds(prior.low), _odds(prior.high)) if factor == "proximal_share" else (prior.low, prior.high)
    spread_ln = np.log(high / low) / (2.0 * Z95)
    assert 0.9 * spread_ln < np.log(factor_priors()[factor].spread) < 2.0 * spread_ln


def test_factors_multiply_constants_of_the_network():
    fields = [field for prior in factor_priors().values() for field in prior.fields]
    assert len(set(fields)) == len(fields) and set(fields) <= set(parameters("listed").as_dict())

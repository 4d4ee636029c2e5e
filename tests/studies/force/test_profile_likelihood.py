"""Profile likelihoods of a person's factors: what others leave when they follow, and where no parabola describes it."""

from collections.abc import Callable

import made_sensor
import numpy as np
import pytest
import xarray as xr
from scipy.optimize import least_squares

from nailoptics.hemodynamics.for_scene import vessels
from nailoptics.report.pages.force import profiles_figure
from nailoptics.studies.force.fit import OFFSETS, Fit, bent_factors, profile_likelihoods
from nailoptics.studies.force.person import NAMES

# Of finite differences, which all are worked out together.
STEP = 1e-7
FREE = ("vein_stiffness", "capillary_stiffness", "contact_area", "rest_blood")


@pytest.fixture(scope="module")
def fit() -> Fit:
    scene = made_sensor.scene()
    recordings = [made_sensor.record(made_sensor.cycle(1.5), site, seed=k) for k, site in enumerate(("distal",))]
    free = np.array([name in FREE for name in NAMES])
    return Fit(recordings, made_sensor.table(), made_sensor.nominal_finger(vessels(scene)), free=free)


@pytest.mark.long
def test_all_other_factors_follow_the_one_that_is_held(fit: Fit) -> None:
    best = fit.solve().factors_ln[fit.free]
    profiles = profile_likelihoods(fit, best)
    factors_ln, deviance = np.log(profiles.profile_factor.values), profiles.profile_deviance.values
    assert tuple(profiles.factor.values) == FREE and deviance.shape == (len(FREE), OFFSETS.size)
    # Nothing fits better than the best fit, but for what its search leaves undone.
    assert np.nanmin(deviance) > -0.05
    assert (np.diff(factors_ln, axis=1) >= 0).all()
    # The same, searched by another program from the best fit itself.
    least = float((fit.residuals(best[:, None])[0] ** 2).sum())
    for held, place in ((1, 2), (2, 6)):
        others = np.delete(np.arange(len(FREE)), held)

        def whole(some: np.ndarray, held: int = held, place: int = place, others: np.ndarray = others) -> np.ndarray:
            some = some.reshape(len(others), -1)
            moved = np.empty((len(FREE), some.shape[1]))
            moved[held], moved[others] = factors_ln[held, place], some
            return np.squeeze(fit.residuals(moved)[0])

        def slopes(some: np.ndarray, whole: Callable[[np.ndarray], np.ndarray] = whole) -> np.ndarray:
            here, *there = whole(some[:, None] + STEP * np.eye(len(some), 1 + len(some), 1)).T
            return (np.stack(there, axis=1) - here[:, None]) / STEP

        found = 2.0 * least_squares(whole, best[others], slopes).cost - least
        assert deviance[held, place] == pytest.approx(found, rel=0.05, abs=0.02)
    drawn = profiles.assign_attrs(bent_factors=[FREE[0], FREE[2]])
    assert len([axes for axes in profiles_figure(drawn).axes if axes.get_title(loc="left")]) == 2


@pytest.mark.parametrize(
    ("deviance", "bent"),
    [(OFFSETS**2, ()), ((1 + 0.2 * OFFSETS / 3) * OFFSETS**2, ()), (np.exp(0.4 * OFFSETS) * OFFSETS**2, ("one",))],
    ids=["parabola", "hardly bent", "steeper one way"],
)
def test_a_profile_is_bent_where_its_error_is_not_a_parabolas(deviance: np.ndarray, bent: tuple[str, ...]) -> None:
    data = {"profile_deviance": deviance[None], "profile_quadratic": OFFSETS[None] ** 2}
    profiles = xr.Dataset({name: (("factor", "place"), one) for name, one in data.items()}, {"factor": ["one"]})
    assert tuple(bent_factors(profiles)) == bent

"""Reported standard errors of a placement against the scatter of other seeds."""

from functools import lru_cache

import numpy as np
import pytest
import xarray as xr
from scipy.special import ndtri, stdtr
from small_scenes import PLACEMENT

from nailoptics.light.board_map import BoardTracer
from nailoptics.light.walk import finger as finger_walk
from nailoptics.scene import Priors, Scene, parse_scene
from nailoptics.studies.placement import verification
from nailoptics.studies.placement.place import place
from nailoptics.studies.placement.result import gains

pytestmark = [pytest.mark.slow, pytest.mark.jit]
SCENE = PLACEMENT.replace("size_mm = [1.0, 0.25]", "size_mm = [1.0, 0.5]").replace("photodiodes = 4", "photodiodes = 6")
# No reading lies so near to the converter's limit that the light's noise decides whether it counts.
SCENE = SCENE.replace("[placement]", "[electronics]\nfeedback_ohm = 4e5\n[placement]")
SCENE += """
[[placement.candidates]]
name = "near"
leds_mm = [[-2.5, 0.0]]
photodiodes_mm = [[-0.8, -2.5], [-0.8, -1.5], [-0.8, -0.5], [-0.8, 0.5], [-0.8, 1.5], [-0.8, 2.5]]
"""
FIELDS = ("finger.plate_absorption", "finger.bed_absorption")
PHOTONS, SEEDS = 1 << 18, range(20)
# Where so much of a number is noise, its error is too imprecise to be tested by twenty seeds.
MOST_RELATIVE_ERROR = 0.25


def scene() -> Scene:
    """A layout near its LED, two priors."""
    scene = parse_scene(SCENE)
    known = tuple(one.field for one in scene.priors.of_finger() if one.field not in FIELDS)
    return scene.model_copy(update={"priors": Priors(known=known)})


@pytest.fixture(scope="module")
def computed(chosen_jit) -> list[xr.Dataset]:
    """The same placement with twenty seeds, in small batches; its four geometries are made once."""
    patch = pytest.MonkeyPatch()
    patch.setattr(BoardTracer, "batch_photons", PHOTONS // verification.LEAST_BATCHES)
    patch.setattr(finger_walk, "built", lru_cache(maxsize=8)(finger_walk.built.__wrapped__))
    patch.setattr(verification, "PHOTONS", 1 << 15)
    try:
        return [place(scene(), photons=PHOTONS, seed=seed) for seed in SEEDS]
    finally:
        patch.undo()


def assert_calibrated(values: np.ndarray, errors: np.ndarray, name: str, *, batches: int | None = None) -> None:
    """Distances from the mean over the seeds, in standard errors, of what is resolved well enough.

    batches : of which the errors are, if they are few: a distance follows Student's t, and counts as the Gaussian one
        that is as rare.

    Expected: a root mean square of 1 within the 50 % that three times the chance of twenty seeds is.
    """
    estimated = (np.isfinite(values) & np.isfinite(errors) & (errors > 0)).all(0)
    values, errors = values[:, estimated], errors[:, estimated]
    resolved = errors.mean(0) < MOST_RELATIVE_ERROR * np.abs(values.mean(0))
    assert resolved.any(), (name, estimated.sum())
    away = ((values - values.mean(0)) / errors)[:, resolved] * np.sqrt(len(values) / (len(values) - 1))
    away = away if batches is None else ndtri(stdtr(batches - 1, away))
    assert 0.5 < np.sqrt(np.mean(away**2)) < 1.5, (name, np.sqrt(np.mean(away**2)))


@pytest.mark.parametrize(
    "name",
    [
        "force_resolution_n",
        "finger_resolution_n",
        "resolution_spread",
        "prior_resolution_spread",
        "predicted_volts",
        "predicted_shunted_fraction",
        "predicted_zone_v",
        "checked_fraction",
        "ambient_a",
        "place_resolution_n",
        "irradiance",
        "direct",
    ],
)
def test_stated_errors_of_layouts(computed, name):
    """Expected: what other seeds scatter by."""
    assert_calibrated(*(np.array([one[f"{name}{end}"].values for one in computed]) for end in ("", "_stderr")), name)


def test_errors_of_the_sensitivity_over_the_board(computed):
    """Rationale: few photons reach a cell of the map with blood in their way. Expected: over all cells together, the
    sum of squares by which seeds scatter is that of the errors."""
    value, error = (np.array([one[f"sensitivity{end}"].values for one in computed]) for end in ("", "_stderr"))
    known = (np.isfinite(value) & np.isfinite(error)).all(0)
    scatter = ((value - value.mean(0)) ** 2 * len(value) / (len(value) - 1))[:, known].sum()
    assert 0.7 < np.sqrt(scatter / (error[:, known] ** 2).sum()) < 1.4


@pytest.mark.parametrize("name", ["checked_resolution_n"])
def test_errors_of_the_verification_of_the_best_layout(computed, name):
    """Expected: what other seeds scatter by."""
    values, errors = (np.array([[one.attrs[f"{name}{end}"]] for one in computed]) for end in ("", "_stderr"))
    assert_calibrated(values, errors, name, batches=verification.LEAST_BATCHES)


def test_the_error_of_the_gain_over_the_papers_layout(computed):
    """Expected: what other seeds scatter by; the better of the two is the same for every seed."""
    assert all(one.layout.values.tolist() == ["near", "paper"] for one in computed)
    better = np.array([gains(one)["paper"] for one in computed])
    assert_calibrated(better[:, [0]], better[:, [1]], "gain")


def test_ends_of_intervals(computed):
    """Expected: the ends of 95 % intervals hold the mean over the seeds; light from outside lies below its bound."""
    score = np.array([one.force_resolution_n.values for one in computed])
    low, high = (np.array([one[f"force_resolution_{end}_n"].values for one in computed]) for end in ("low", "high"))
    held = (low <= np.exp(np.log(score).mean(0))) & (np.exp(np.log(score).mean(0)) <= high)
    assert (held.sum(0) >= 16).all(), held.sum(0)
    most, mean = (np.array([one[name].values for one in computed]) for name in ("ambient_high_a", "ambient_a"))
    assert ((most >= mean.mean(0)).sum(0) >= 16).all()

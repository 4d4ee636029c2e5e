"""Layouts ranked by their information on oxygen: against an oximeter's own error, and in a placement."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from nailoptics import load_scene, place
from nailoptics.assets import data_dir
from nailoptics.errors import as_far_as_reached
from nailoptics.scene import Candidate, FingerCase, Placement, Priors, Scene
from nailoptics.sensor.front_end import ratio_stderr
from nailoptics.sensor.information import Response, operating_point
from nailoptics.studies.placement.objective import Objective, spo2_objective


def shipped() -> Scene:
    return load_scene(data_dir("scenes") / "pulse_oximeter.toml")


def response(volts, noise_v2, zone_v) -> Response:
    volts = np.asarray(volts, float)
    return Response(
        amplified_v=volts,
        noise_v2=np.full(volts.shape, noise_v2),
        slope_v_per_pa=np.ones((*volts.shape, 2)),
        zone_v=np.asarray(zone_v, float),
        shunted_fraction=np.zeros(volts.shape),
    )


def test_the_error_is_that_of_the_ratio_of_ratios_in_saturation():
    """Expected: the error of R by `ratio_stderr`, through the slope of ln R, as made by hand for one photodiode; two
    alike are better by the root of 2, and one without light has no information."""
    scene = shipped()
    rule = spo2_objective(scene, [FingerCase(name="one")], 0.3)
    objective = Objective(Placement(rank_by="oxygen"), [operating_point(scene, 0.3)], rule)

    def error_percent(by_led: list[Response]) -> np.ndarray:
        return objective.score(objective.total([by_led]))

    volts, noise, zone = (1.0, 2.0), 1e-8, np.array([[[-0.5, 0.0]], [[-3.0, 0.0]]])
    by_led = [response([v], noise, z) for v, z in zip(volts, zone, strict=True)]
    stderr_percent = error_percent(by_led)
    index = np.array([abs(zone[k, 0] @ rule.pulse[0, k]) / volts[k] for k in (0, 1)])
    ratio = index[0] / index[1]
    error = ratio_stderr(
        np.array(ratio), index, np.array(volts), np.full(2, noise), shape_rms=rule.shape_rms[0], frames=rule.frames
    )
    assert stderr_percent == pytest.approx(float(error) / ratio / rule.log_ratio_per_percent, rel=1e-9)
    twice = [response([v, v], noise, np.vstack([z, z])) for v, z in zip(volts, zone, strict=True)]
    assert error_percent(twice) == pytest.approx(stderr_percent / np.sqrt(2))
    blind = [response([v, 0.0], noise, np.vstack([z, 0 * z])) for v, z in zip(volts, zone, strict=True)]
    assert error_percent(blind) == pytest.approx(stderr_percent)
    full = [replace(read, unsaturated=np.zeros(1)) for read in by_led]
    assert np.isinf(error_percent(full)).all()
    # By hand from 0.171 and 1.728, 0.650 and 0.371 per mm of blood with and without oxygen, at 97 %.
    assert rule.log_ratio_per_percent == pytest.approx(0.01557 / 0.2177 + 0.0028 / 0.6416, rel=0.05)


@pytest.mark.long
@pytest.mark.jit
def test_a_placement_ranks_given_layouts_by_oxygen(chosen_jit, monkeypatch):
    """Rationale: near photodiodes get much light, far ones a larger pulse. Expected: the order of both layouts is that
    of their own errors, which the ranking carries with standard errors."""
    scene = shipped()
    near, far = (
        Candidate(name=name, leds_mm=((-0.2, -1.5), (0.2, -1.5)), photodiodes_mm=((0.0, v),))
        for name, v in (("near", -0.2), ("far", 2.5))
    )
    rules = Placement(photodiodes=1, force_n=0.3, rank_by="oxygen", search=False, candidates=(near, far))
    diode = scene.photodiodes[0].model_copy(
        update={"part": None, "elements": 1, "wired": None, "pitch_mm": None, "position_mm": (0.0, 0.0)}
    )
    requested = scene.model_copy(update={"placement": rules, "photodiodes": (diode,), "priors": Priors(spread=False)})
    # The verification of the best and its tolerances, which are of force, take minutes.
    for name in ("verify_layout", "tolerances"):
        monkeypatch.setattr(f"nailoptics.studies.placement.place.{name}", lambda *_, **__: xr.Dataset())
    result, _ = as_far_as_reached(place, requested, photons=1 << 18, seed=3)
    error, stderr = result.spo2_error_percent.values, result.spo2_error_percent_stderr.values
    assert list(result.layout.values) == ["near", "far"] and error[0] < error[1]
    assert np.all(stderr > 0) and np.all(stderr < 0.5 * error)

"""Standard errors of a person's factors against scatter over people and seeds, with heartbeat, breath and drift."""

import numpy as np
import pytest
from made_sensor import nominal_finger
from record import SIDES, TOUCHES, load_person, record_touch, touch_of
from untraced_light import untraced, untraced_table

from nailoptics import load_scene
from nailoptics.assets import data_dir
from nailoptics.hemodynamics.parameters import vessels
from nailoptics.scene import Scene
from nailoptics.statistics import Z95
from nailoptics.studies.force.fit import Fit
from nailoptics.studies.force.person import NAMES, PRIORS, SPREAD_LN

PEOPLE = 24
# No person's share or reach is searched: the touches are one-sided, and the scene's two zones share no pressure. These
# people's pulp is rigid.
FIXED = ("proximal_share", "distal_reach", "creep", "distal_recovery")
FREE = np.array([name not in FIXED for name in NAMES])
SEARCHED = tuple(name for name, free in zip(NAMES, FREE, strict=True) if free)
# People differ by this from the scene, in logarithms.
DIFFER_LN = 0.25


def scene_of(true: dict[str, float], usual: Scene) -> Scene:
    """The scene of a person who has the fitted model's zones and walls, but other constants and a body; no arterioles,
    which that model does not have: their blood would count as the capillaries'."""
    like = load_person("person_1")
    assert like.body is not None and like.body.heartbeat is not None
    heart = like.body.heartbeat.model_copy(update={"arteriolar_blood_fraction": 0.0})
    body = like.body.model_copy(update={"heartbeat": heart})
    factors = {field: true[name] for name in SEARCHED for field in PRIORS[name].fields}
    blood = usual.blood.model_copy(
        update={
            "tuning": like.blood.tuning.model_copy(update={"factors": factors}),
            "rest_blood_fraction": usual.blood.rest_blood_fraction * true["rest_blood"],
        }
    )
    touch = usual.touch.model_copy(
        update={"contact_area_mm2": usual.touch.contact_area_mm2 * true["contact_area"], "creep": None}
    )
    return usual.model_copy(update={"blood": blood, "touch": touch, "body": body})


@pytest.mark.slow
def test_factors_lie_within_their_stated_errors() -> None:
    usual = load_scene(data_dir("scenes") / "prototype.toml")
    off, informed = [], []
    for seed in range(PEOPLE):
        ln = dict.fromkeys(NAMES, 0.0)
        # A touch presses on one area on both sides.
        varied = [name for name in SEARCHED if name != "proximal_area"]
        ln |= dict(zip(varied, DIFFER_LN * np.random.default_rng(seed).normal(size=len(varied)), strict=True))
        scene = scene_of({name: float(np.exp(one)) for name, one in ln.items()}, usual)
        recordings = [
            record_touch(
                scene, untraced(scene), touch_of(scene, TOUCHES["calibration"], side, 20.0), seed=10 * seed + k
            )
            for k, side in enumerate(SIDES)
        ]
        fit = Fit(
            recordings,
            untraced_table(usual),
            nominal_finger(
                vessels(usual),
                rest_blood_fraction=usual.blood.rest_blood_fraction,
                contact_area_cm2=usual.touch.contact_area_mm2 / 100.0,
                proximal_share=usual.touch.proximal_share,
            ),
            free=FREE,
        )
        fitted = fit.solve()
        stderr = np.sqrt(np.diag(fitted.covariance))[: len(NAMES)]
        off.append(((fitted.factors_ln - [ln[name] for name in NAMES]) / stderr)[FREE])
        informed.append((stderr < 0.7 * SPREAD_LN)[FREE])
    z, known = np.array(off), np.array(informed)
    covered = float((np.abs(z[known]) < Z95).mean())
    estimated = [SEARCHED.index(name) for name in ("vein_stiffness", "capillary_stiffness", "contact_area")]
    rms = np.sqrt((z[:, estimated] ** 2).mean(0))
    assert known.mean() > 0.4
    assert 0.88 < covered < 1.0
    # With waves that move readings alike all along a touch that of the vein is 1.5: they move them most near closure.
    assert (rms > 0.6).all() and (rms < 1.3).all()

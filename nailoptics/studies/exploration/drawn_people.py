"""Three of the people drawn from a scene's priors, on whose fingers the page reads every layout beside the scene's own.

They differ in what only reweights the traced light: what absorbs, the blood, its vessels, the touch and the body's
waves. Scattering, thicknesses and sizes stay those of the scene: of the prototype's readings these add 1 % to the
variance of the change under a touch over all priors, and a third to that of the light at rest.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from ...light.board_map import BoardTracer
from ...scene import Electronics, Scene
from ...sensor.information import force_resolution_n, operating_point, scene_responses, total_information
from ..placement.photon_maps import recorded
from ..prior_uncertainty import at_value, draw_people, known_priors, only_absorbs

# People who are drawn, and which of them the page has: by this fraction of them a force is resolved no coarser.
DRAWN, QUANTILES = 20, (0.1, 0.5, 0.9)
# They are ranked at this force [N], by so many photons of each LED, by which other seeds exchange neighbours at most.
RANKED_N, RANK_PHOTONS = 1.0, 1 << 16


class DrawnPerson(NamedTuple):
    """A person drawn from the priors: the scene on this finger, and how its own layout resolves the force there [N],
    with resistors that fit each reading, so that people are the same whatever the scene's electronics are."""

    scene: Scene
    resolution_n: float


def ranked_people(scene: Scene, tracers: Sequence[BoardTracer], seed: int) -> list[DrawnPerson]:
    """Those of the people drawn at the quantiles; tracers : of each LED, on the bare board with its wavelength."""
    fields = [prior.field for prior in known_priors(scene) if only_absorbs(scene, prior)]
    light = [tracer.arrivals(led, photons=RANK_PHOTONS, seed=seed + led) for led, tracer in enumerate(tracers)]
    people = []
    for drawn in draw_people(scene, DRAWN):
        worn = scene
        for field in fields:
            worn = at_value(worn, field, drawn[field])
        point, areas = operating_point(worn, RANKED_N), worn.layout.photodiode_areas
        by_led = [recorded([one], worn, led, point, areas, 1)[0] for led, one in enumerate(light)]
        fitted = worn.model_copy(update={"electronics": Electronics(feedback_ohm="auto")})
        information = total_information(scene_responses(fitted, by_led, point))
        people.append(DrawnPerson(worn, float(force_resolution_n(information, point))))
    people.sort(key=lambda person: person.resolution_n)
    return [people[math.ceil(quantile * DRAWN) - 1] for quantile in QUANTILES]

"""The people of the page are those at the quantiles of the ones drawn, by how they resolve the force."""

import numpy as np
import pytest

from nailoptics import load_scene
from nailoptics.studies.exploration import drawn_people


def test_by_a_quantile_of_the_people_a_force_is_resolved_no_coarser(monkeypatch):
    """Expected: of twenty who resolve a force by as much as they have blood, the second, tenth and eighteenth."""
    field, parts = "blood.rest_blood_fraction", 1e-3 * np.random.default_rng(0).permutation(np.arange(1, 21))
    made = {
        "known_priors": lambda scene: [p for p in scene.priors.of_finger() if p.field == field],
        "draw_people": lambda scene, count: [{field: float(part)} for part in parts[:count]],
        "scene_responses": lambda scene, by_led, point: scene.blood.rest_blood_fraction,
        "total_information": lambda part: part,
        "force_resolution_n": lambda part, point: part,
    }
    for name, replacement in made.items():
        monkeypatch.setattr(drawn_people, name, replacement)
    people = drawn_people.ranked_people(load_scene("prototype"), [], seed=0)
    for person, part in zip(people, (2e-3, 1e-2, 1.8e-2), strict=True):
        assert person.resolution_n == person.scene.blood.rest_blood_fraction == pytest.approx(part)

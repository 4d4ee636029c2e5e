"""What is unknown of the finger in explain's table: which end of a range, how it is read, and what it leaves alone."""

import pytest

from nailoptics import explain, load_scene
from nailoptics.assets import data_dir
from nailoptics.scene import Priors
from nailoptics.studies.model_error.unknown_changes import unknown_changes
from nailoptics.studies.prior_uncertainty import at_value


@pytest.fixture
def scene():
    return load_scene(data_dir("scenes") / "prototype.toml")


def test_every_prior_is_a_change_to_the_end_that_is_farther(scene):
    found = {change.name: change for change in unknown_changes(scene)}
    assert len(found) == len(scene.priors.of_finger()) and all(change.unknown for change in found.values())
    assert found["plate absorption"].changes == {"finger": {"plate_absorption": 0.1}}
    # From 3 % of blood 1 % is farther than 5 %.
    assert found["blood at rest"].changes == {"blood": {"rest_blood_fraction": 0.01}}
    # A plate that scatters a fifth as much is farther than one that scatters 1.667 times as much.
    assert found["plate scattering"].changes == {"finger": {"plate_scattering": 0.2}}
    assert found["plate absorption"].same_photons and not found["plate scattering"].same_photons
    clear = at_value(scene, "finger.plate_absorption", 1.9)
    assert next(unknown_changes(clear)).changes == {"finger": {"plate_absorption": 0.1}}
    assert list(unknown_changes(scene.model_copy(update={"priors": Priors(spread=False)}))) == []


@pytest.mark.slow
def test_unknowns_are_ranked_beside_parts_and_are_never_left_out(chosen_jit, scene):
    fields = ("finger.plate_absorption", "finger.plate_scattering", "finger.bed_absorption")
    known = tuple(one.field for one in scene.priors.of_finger() if one.field not in fields)
    found = explain(scene.model_copy(update={"priors": Priors(known=known)}), photons=30_000, seed=1)
    by_name = {effect.name: effect for effect in found.effects}
    plate, scatters = by_name["plate absorption"], by_name["plate scattering"]
    assert plate.unknown and plate.how == "reweighted" and plate.matters == "yes" and plate.change < -0.3
    # The farther end of its range is the clear plate.
    assert scatters.how == "retraced" and scatters.change > 0.2
    assert not {effect.name for effect in found.needless + found.missing} & {plate.name, scatters.name}
    assert found.required.finger == scene.finger and found.required.blood == scene.blood
    shown = str(found).splitlines()
    assert sum("unknown" in line.split("  ")[-1] or " unknown " in line for line in shown) == len(fields) + 1
    assert by_name["height of dies"].unknown and by_name["height of dies"].how == "retraced"
    rows = {row["name"]: row for row in found.as_dict()["effects"]}
    assert rows[plate.name]["unknown"] is True and rows["bone"]["unknown"] is False
    order = [effect.name for effect in found.effects]
    assert all(order.index(plate.name) < order.index(e.name) for e in found.effects if e.matters == "no")

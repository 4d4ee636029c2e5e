"""Priors of the finger in explain's table: which end of a range, how it is read, and what it leaves alone."""

import pytest

from nailoptics import explain, load_scene
from nailoptics.assets import data_dir
from nailoptics.options import TraceOptions
from nailoptics.report.pages import explain as explain_page
from nailoptics.scene import Priors
from nailoptics.studies.model_error.explain import changes_of, lines_of, revised
from nailoptics.studies.model_error.paired import PairedTracer, difference
from nailoptics.studies.prior_uncertainty import at_value


@pytest.fixture
def scene():
    return load_scene(data_dir("scenes") / "prototype.toml")


def test_every_prior_is_a_change_to_the_end_that_is_farther(scene):
    result = {change.name: change for change in changes_of(scene) if change.unknown}
    of_sensor = {"height of dies", "air under the board"}
    assert result.keys() == {prior.name for prior in scene.finger_priors} | of_sensor
    assert result["plate absorption"].changes == {"finger": {"plate_absorption": 2.68}}
    # From 3 % of blood 7.86 % is farther than 1.61 %.
    assert result["blood at rest"].changes == {"blood": {"rest_blood_fraction": 0.0786}}
    # A plate that scatters 0.56 times as much is farther than one that scatters 1.65 times as much.
    assert result["plate scattering"].changes == {"finger": {"plate_scattering": 0.56}}
    clear = at_value(scene, "finger.plate_absorption", 1.9)
    assert {"finger": {"plate_absorption": 0.439}} in [change.changes for change in changes_of(clear)]
    known = changes_of(scene.model_copy(update={"priors": Priors(spread=False)}))
    assert [change.name for change in known if change.unknown] == ["height of dies", "air under the board"]


@pytest.mark.slow
def test_priors_are_ranked_beside_parts_and_are_never_left_out(chosen_jit, scene):
    fields = ("finger.plate_absorption", "finger.plate_scattering", "finger.bed_absorption")
    known = tuple(one.field for one in scene.priors.of_finger() if one.field not in fields)
    result = explain(scene.model_copy(update={"priors": Priors(known=known)}), photons=600_000, seed=1)
    by_name = {effect.name: effect for effect in result.effects}
    plate, scatters = by_name["plate absorption"], by_name["plate scattering"]
    assert plate.unknown and plate.how == "reweighted" and plate.matters == "yes" and plate.change < -0.1
    # The farther end of its range is the clear plate.
    assert scatters.how == "retraced" and scatters.change > 0.2
    assert not {effect.name for effect in result.needless + result.missing} & {plate.name, scatters.name}
    assert result.required.finger == scene.finger and result.required.blood == scene.blood
    shown = explain_page.lines(result)
    assert sum("unknown" in line.split("  ")[-1] or " unknown " in line for line in shown) == len(fields) + 2
    assert by_name["height of dies"].unknown and by_name["height of dies"].how == "retraced"
    rows = {row["name"]: row for row in explain_page.summary(result)["effects"]}
    assert rows[plate.name]["unknown"] is True and rows["bone"]["unknown"] is False
    order = [effect.name for effect in result.effects]
    assert all(order.index(plate.name) < order.index(e.name) for e in result.effects if e.matters == "no")


@pytest.mark.jit
def test_air_under_the_board_is_an_effect_that_dims_readings(chosen_jit, coarse_cells, scene):
    """Rationale: a board that is lifted, or not bonded, lies on air: light leaves the nail at a steep angle alone, and
    what is reflected back goes farther. Expected: an effect whose scene line makes it, by a trace with common photons
    readings next to the LED fall by a tenth or more; a scene with air has the adhesive as its alternative."""
    (air,) = [change for change in changes_of(scene) if change.name == "air under the board"]
    assert air.unknown and lines_of(air.changes) == ["[board] air_gap_um = 25.0"]
    lifted = revised(scene, air.changes)
    tracer = PairedTracer(2, TraceOptions(photons=60_000, seed=1), None)
    result = difference(tracer.trace(scene), tracer.trace(lifted))
    near = [3, 4]
    assert (result.reading.value[0, near] + 3 * result.reading.stderr[0, near] < -0.1).all()
    (back,) = [change for change in changes_of(lifted) if change.name == "air under the board"]
    assert not back.unknown and revised(lifted, back.changes) == scene

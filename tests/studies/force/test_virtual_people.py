"""Virtual people: recorded as specified, the same for one seed, and estimated by a model that is not theirs."""

import numpy as np
import pytest
from record import (
    CALIBRATION_N,
    EDGE_S,
    SIDES,
    STEPS_N,
    TOUCHES,
    load_person,
    people,
    record_person,
    touch_of,
)
from untraced_light import untraced

from nailoptics import load_scene
from nailoptics.assets import data_dir
from nailoptics.errors import InputError
from nailoptics.studies.prior_uncertainty import value_of


def test_eight_people_differ_in_all_that_the_papers_did():
    scenes = [load_person(name) for name in people()]
    assert len(scenes) == 8
    usual = load_scene(data_dir("scenes") / "prototype.toml")
    for pick in (
        lambda s: s.blood.rest_blood_fraction,
        lambda s: s.finger.nail_thickness_mm,
        lambda s: s.finger.plate_absorption,
        lambda s: s.finger.bed_scattering,
        lambda s: s.blood.tuning.factors["vein_stiffness_n_per_m"],
        lambda s: s.touch.contact_area_mm2,
        lambda s: s.leds[0].flux_mw,
        lambda s: s.body.heartbeat.pulse_pressure_pa,
        lambda s: s.blood.decay_length,
        lambda s: s.finger.nail_width_mm,
        lambda s: s.finger.melanin_fraction,
    ):
        assert len({pick(scene) for scene in scenes}) >= 6
    assert len({scene.finger.digit for scene in scenes}) == 5
    # From the lightest group of people to the darkest, as the tables of their skin are fitted.
    assert [f([s.finger.melanin_fraction for s in scenes]) for f in (min, max)] == [0.006, 0.189]
    # The board is that of the scene that is fitted; zones, and so the model, are not.
    for scene in scenes:
        assert scene.layout.photodiode_names == usual.layout.photodiode_names
        assert len(scene.zone_edges_mm) == 7 and len(usual.zone_edges_mm) == 1
        assert scene.body.drift is not None and scene.touch.creep and scene.touch.distal_relaxation_s


def test_all_of_people_but_their_skin_lies_within_the_shipped_priors():
    for name in people():
        scene = load_person(name)
        for prior in scene.finger_priors:
            # That of melanin is of the epidermis beside nails alone.
            assert (
                prior.field == "finger.melanin_fraction" or prior.low <= value_of(scene, prior.field) <= prior.high
            ), (name, prior.field)


def test_touches_are_those_of_the_paper():
    person = load_person("person_1")
    slow, steps = (touch_of(person, TOUCHES[kind], "distal") for kind in ("calibration", "steps"))
    time_s = slow.times_s()
    force_n = np.interp(time_s, *slow.corners())
    assert force_n.max() == pytest.approx(CALIBRATION_N[0], abs=1e-4) and force_n[-1] == 0 == force_n[:200].max()
    # Three cycles at 0.05 Hz: three maxima 20 s apart.
    peaks = time_s[1:-1][(np.diff(force_n)[:-1] > 0) & (np.diff(force_n)[1:] <= 0)]
    assert np.diff(peaks) == pytest.approx([20.0, 20.0], abs=0.02)
    force_n = np.interp(steps.times_s(), *steps.corners())
    assert set(STEPS_N) <= set(force_n.round(9)) and slow.proximal_share == 0.0
    time_s = steps.times_s()
    rise = time_s[(force_n > 0) & (force_n < STEPS_N[0]) & (time_s < 3.0)]
    assert 0.8 * EDGE_S < np.ptp(rise) < EDGE_S


def test_a_recording_is_that_of_its_seed_and_of_both_kinds_of_walls():
    person = load_person("person_4")
    made = {
        seed: record_person(person, untraced(person), "steps", "proximal", seed=seed, model="massless")
        for seed in (0, 1)
    }
    again = record_person(person, untraced(person), "steps", "proximal", seed=0, model="massless")
    assert np.array_equal(again.volts, made[0].volts) and not np.array_equal(made[1].volts, made[0].volts)
    assert made[0].names == tuple(person.layout.photodiode_names) and (made[0].site == 1.0).all()
    # A proximal touch dams up blood: every reading near the proximal end is darker under the longest step of 1 N.
    held = (made[0].time_s > 11) & (made[0].time_s < 12)
    assert (made[0].volts[:3, held].mean(1) < 0.97 * made[0].volts[:3, :150].mean(1)).all()


@pytest.mark.parametrize("kind", ["cycle", "Steps"])
def test_a_touch_that_is_none_is_refused(kind):
    person = load_person("person_1")
    with pytest.raises(InputError, match="choose from calibration, slow, steps, quick"):
        record_person(person, untraced(person), kind, SIDES[0])

"""How a scene's touch, vessels and body change the blood under the nail."""

import numpy as np
import pytest
import xarray as xr
from equal_zones import equal_zones
from small_scenes import SMALL_FINGER_BEST

from nailoptics.errors import InputError
from nailoptics.hemodynamics import PAPER_ZONES
from nailoptics.hemodynamics.for_scene import (
    beat_at,
    blood_model,
    blood_over_touch,
    hold_end,
    rest_beat,
    steady_blood,
)
from nailoptics.hemodynamics.parameters import vessels
from nailoptics.hemodynamics.touch import largest_force_n, touch_course
from nailoptics.hemodynamics.waves import pressure_lines
from nailoptics.hemodynamics.zones import capillary_zones
from nailoptics.light.identity import light_digest
from nailoptics.scene import parse_scene


def scene_with(text, folder=None):
    return parse_scene(SMALL_FINGER_BEST + text, folder=folder)


def test_recorded_pressures_drive_the_blood_and_give_the_force(tmp_path):
    (tmp_path / "touch.csv").write_text(
        "time_s,proximal_pressure_pa,distal_pressure_pa\n0,0,0\n0.5,8000,2000\n2,8000,2000\n"
    )
    scene = scene_with('[touch]\nprofile = "recorded"\nfile = "touch.csv"\n', tmp_path)
    run = blood_over_touch(scene)
    assert run.proximal_pressure_pa[-1] == 8000.0 and run.distal_pressure_pa[25] == 1000.0
    # Half of 100 mm^2 on either side.
    assert run.force_n[-1] == pytest.approx(0.5) and largest_force_n(scene) == pytest.approx(0.5)
    assert np.array(touch_course(scene.touch).sides_pa(0.25)) == pytest.approx([4000.0, 1000.0])
    assert steady_blood(scene, [0.0])[0] == pytest.approx([0.03, 0.03], rel=1e-9)


def test_recorded_pressures_go_before_the_force_beside_them(tmp_path):
    (tmp_path / "touch.csv").write_text(
        "time_s,force_n,proximal_pressure_pa,distal_pressure_pa\n0,0,0,0\n1,2,0,5000\n2,2,0,5000\n"
    )
    run = blood_over_touch(scene_with('[touch]\nprofile = "recorded"\nfile = "touch.csv"\n', tmp_path))
    assert run.force_n[-1] == 2.0 and run.proximal_pressure_pa.max() == 0 and run.distal_pressure_pa[-1] == 5000.0


def test_a_distal_cycle_spares_the_vein_and_shows_hysteresis():
    text = '[touch]\nprofile = "cycle"\nforce_n = 0.8\nsite = "distal"\nstart_s = 0.0\nperiod_s = 2.0\ncycles = 3\n'
    run = blood_over_touch(scene_with(text + "sample_rate_hz = 50.0"))
    assert run.proximal_pressure_pa.max() == 0 and run.distal_pressure_pa.max() == pytest.approx(8e3)
    distal = run.blood_fraction.isel(zone=1)
    up, down = (float(distal.sel(time=t, method="nearest")) for t in (4.5, 5.5))  # the same force
    assert down < 0.97 * up


def test_the_distal_pulp_recovers_with_its_time_constant_after_a_step():
    text = '[touch]\nforce_n = 1.0\nsite = "distal"\ndistal_relaxation_s = 0.2\n'
    run = blood_over_touch(scene_with(text))
    left = run.distal_pressure_pa.sel(time=[0.3, 2.24, 2.25, 2.45, 2.65, 3.25], method="nearest").values
    assert left == pytest.approx(1e4 * np.exp([0.0, 0.0, 0.0, -1.0, -2.0, -5.0]), rel=2e-3)
    assert run.proximal_pressure_pa.max() == 0.0
    # It is off unless requested, and on the proximal side there is none.
    assert not blood_over_touch(scene_with('[touch]\nsite = "distal"\n')).distal_pressure_pa.values[-150:].any()
    proximal = scene_with('[touch]\nsite = "proximal"\ndistal_relaxation_s = 0.2\n')
    assert not blood_over_touch(proximal).proximal_pressure_pa.values[-150:].any()


def test_a_heartbeat_beats_in_the_blood_and_is_off_by_default():
    still, beating = (
        scene_with('[touch]\nprofile = "hold"\nforce_n = 0.0\n'),
        "[body.heartbeat]\nrate_variability = 0.0",
    )
    beating = scene_with('[touch]\nprofile = "hold"\nforce_n = 0.0\nduration_s = 6.0\n' + beating)
    run = blood_over_touch(still)
    assert np.ptp(run.blood_fraction.values) < 1e-9 and "arterial_pressure_pa" not in run
    run = blood_over_touch(beating)
    beat = run.blood_fraction.isel(zone=0).sel(time=slice(2.0, None)).values
    # Capillaries that a distal touch shuts at more than 1 N/cm^2 are stiff, and pulse by 5 %.
    assert 0.03 < np.ptp(beat) / beat.mean() < 0.25
    assert np.ptp(beat) == pytest.approx(np.ptp(rest_beat(beating).blood_fraction[0]), rel=0.01)
    assert np.fft.rfftfreq(beat.size, 0.01)[np.argmax(np.abs(np.fft.rfft(beat - beat.mean())))] == pytest.approx(
        70 / 60, abs=0.15
    )
    assert np.ptp(run.arterial_pressure_pa.values) == pytest.approx(2e3, rel=0.01)


def blood_at(time_s, text, rate_hz):
    run = blood_over_touch(scene_with(f"{text}\nsample_rate_hz = {rate_hz}\n"))
    return run.blood_fraction.sel(time=time_s).values


@pytest.mark.parametrize(
    "touch",
    [
        "force_n = 1.0",
        'profile = "steps"\nduration_s = 4.0\n'
        "steps = [{ start_s = 0.1, force_n = 0.7 }, { start_s = 0.3, force_n = 0.2 }]",
        'profile = "cycle"\nperiod_s = 0.7\ncycles = 2\nduration_s = 4.0\nwaveform = "triangle"',
    ],
)
def test_blood_does_not_depend_on_how_often_results_are_sampled(touch):
    """Expected: a quarter of a second after the onset both the same, to the stepper's tolerance."""
    coarse, fine = (blood_at(0.5, "[touch]\n" + touch, rate) for rate in (4.0, 1000.0))
    assert coarse == pytest.approx(fine, rel=1e-9)


def test_a_heartbeat_does_not_depend_on_the_rate_of_results():
    beating = "[body.heartbeat]\n[touch]\n" + 'profile = "hold"\nforce_n = 0.0'
    coarse, fine = (blood_at(2.0, beating, rate) for rate in (2.0, 500.0))
    assert coarse == pytest.approx(fine, rel=1e-9)
    run = blood_over_touch(scene_with(beating.replace("[body.heartbeat]", "[body.heartbeat]\nrate_variability = 0.0")))
    beat = run.blood_fraction.isel(zone=0)
    assert float(beat.interp(time=0.5)) == pytest.approx(float(beat.interp(time=0.5 + 3 * 60 / 70)), rel=1e-3)


def test_breath_and_slow_waves_add_to_the_beat_and_the_seed_decides():
    parts = "[body.heartbeat]\n[body.breathing]\n[body.vasomotion]\n"
    runs = [blood_over_touch(scene_with(f"[body]\nseed = {seed}\n{parts}")) for seed in (1, 1, 2)]
    assert np.array_equal(runs[0].blood_fraction, runs[1].blood_fraction)
    assert not np.allclose(runs[0].blood_fraction, runs[2].blood_fraction)


def test_a_recorded_pulse_is_the_arterial_pressure_with_its_mean_at_rest(tmp_path):
    (tmp_path / "pulse.csv").write_text("time_s,arterial_pressure_pa\n0,9000\n2,11000\n4,9000\n")
    scene = scene_with('[body]\nfile = "pulse.csv"\n', tmp_path)
    run = blood_over_touch(scene)
    assert run.arterial_pressure_pa.sel(time=1.0, method="nearest") == pytest.approx(10_000.0)
    assert vessels(scene).arterial_pressure_pa == pytest.approx(10_000.0)
    assert steady_blood(scene, [0.0])[0] == pytest.approx([0.03, 0.03], rel=1e-9)


def zoned(text="", zone_text="zones = 8"):
    return scene_with(zone_text + "\n" + text)


def test_two_zones_are_the_papers_and_eight_are_equal_parts_of_the_nail():
    assert capillary_zones(scene_with("")) is PAPER_ZONES
    eight, equal = capillary_zones(zoned(zone_text="zones = 8\ndecay_length = 0.4")), equal_zones(8, decay_length=0.4)
    assert np.allclose(eight.share, equal.share, rtol=1e-12) and np.allclose(eight.reach, equal.reach, rtol=1e-12)
    assert zoned().zone_edges_mm == pytest.approx([-4.5, -3.0, -1.5, 0.0, 1.5, 3.0, 4.5])
    assert scene_with("zones = 2").zone_edges_mm == (0.0,)


def test_edges_cut_the_bed_and_equal_ones_share_light_with_a_count():
    cut = capillary_zones(zoned(zone_text="zone_edges_mm = [-3.0, 3.0]\ndecay_length = 0.4"))
    assert cut.share == pytest.approx((0.5, 1.0, 0.5)) and cut.names == ["zone_1", "zone_2", "zone_3"]
    # P_F2 is the mean over the distal half, which holds half of the middle zone.
    reach = np.array(cut.reach)[:, 1]
    assert (reach[1] + reach[2]) / 2 == pytest.approx(1.0)
    edges = zoned(zone_text=f"zone_edges_mm = {list(zoned().zone_edges_mm)}\nzone_width_mm = {zoned().zone_width_mm!r}")
    assert light_digest(edges) == light_digest(zoned()) != light_digest(scene_with(""))


def test_the_bone_shields_the_bed_behind_its_end():
    """The bone ends 3.8 mm short of the tip, which lies 2 mm beyond the nail: at 4.2 mm of 6."""
    scene = zoned(zone_text="zones = 24\nzone_width_mm = 0.4")
    middle_mm = 12.0 * (capillary_zones(scene).position - 0.5)
    reach = np.array(capillary_zones(scene).reach)[:, 1]
    assert reach == pytest.approx(0.5 + 0.5 * np.tanh((middle_mm - 4.2) / 0.8), abs=0.01)
    assert reach[middle_mm < 2.0].max() < 0.01 and reach[-1] > 0.95
    # Of few zones each feels the mean over it, and a digit has its own bone.
    coarse = np.array(capillary_zones(zoned()).reach)[:, 1]
    assert coarse == pytest.approx(reach.reshape(8, 3).mean(axis=1), rel=1e-9)
    scene = zoned()
    thumb = scene.model_copy(update={"finger": scene.finger.model_copy(update={"bone_to_tip_mm": 5.7})})
    assert np.array(capillary_zones(thumb).reach)[-2, 1] > coarse[-2] + 0.2
    sharp = np.array(capillary_zones(zoned(zone_text="zones = 8\nbone_edge_mm = 0.01")).reach)[:, 1]
    assert sharp == pytest.approx([0.0] * 6 + [0.2, 1.0], abs=1e-2)


def steady_reading(text, force_n):
    return touch_course(scene_with("[touch]\n" + text).touch).sides_pa(force_n)


def test_contact_grows_with_force_and_reaches_the_tip_late():
    force_n = np.array([0.0, 0.4, 0.8, 1.0, 4.0])
    proximal, distal = steady_reading("distal_onset_n = 0.8", force_n)
    # On half of 100 mm^2 the tip carries half of what exceeds the onset; both sides carry all of the force.
    assert distal == pytest.approx(1e4 * np.array([0.0, 0.0, 0.0, 0.2, 3.2]))
    assert proximal == pytest.approx(1e4 * force_n)
    growing = np.array(steady_reading("contact_force_n = 1.0", force_n))
    assert growing == pytest.approx(1e4 * np.cbrt([force_n, force_n])) and growing[0, 3] == pytest.approx(1e4)


@pytest.mark.parametrize(
    "law", ["contact_force_n = 1.0", "distal_onset_n = 0.8", "contact_force_n = 2.0\ndistal_onset_n = 0.3"]
)
def test_a_growing_contact_is_followed_between_corners(law):
    text = f'{law}\nprofile = "ramp"\nforce_n = 3.0\nsample_rate_hz = 997.0\n'
    scene = scene_with("[touch]\n" + text)
    run = blood_over_touch(scene)
    exact = touch_course(scene.touch).sides_pa(run.force_n.values)
    for row, expected in zip((run.proximal_pressure_pa, run.distal_pressure_pa), exact, strict=True):
        assert np.abs(row.values - expected).max() < 0.01 * expected.max()
    cycle = scene_with(f'[touch]\n{law}\nprofile = "cycle"\nforce_n = 0.0\nperiod_s = 1.0\ncycles = 1')
    assert not blood_over_touch(cycle).proximal_pressure_pa.any()


def test_recorded_contact_sets_where_the_force_presses(tmp_path):
    rows = "0,0,50,0.5\n1,1,50,1.0\n2,1,100,0.0\n3,1,100,0.0\n"
    (tmp_path / "touch.csv").write_text("time_s,force_n,contact_area_mm2,proximal_share\n" + rows)
    run = blood_over_touch(scene_with('[touch]\nprofile = "recorded"\nfile = "touch.csv"\n', tmp_path))
    at = run.sel(time=[1.0, 3.0], method="nearest")
    assert at.proximal_pressure_pa.values == pytest.approx([2e4, 0.0])
    assert at.distal_pressure_pa.values == pytest.approx([0.0, 1e4])
    (tmp_path / "touch.csv").write_text("time_s,force_n,contact_area_mm2\n0,0,50\n1,1,1e-9\n")
    with pytest.raises(InputError, match="contact_area_mm2 = 1e-09 must lie in 0.1 to 1000 mm"):
        scene_with('[touch]\nprofile = "recorded"\nfile = "touch.csv"\n', tmp_path)


def test_the_local_contact_is_the_slope_of_the_pressures():
    scene = scene_with("[touch]\ncontact_force_n = 1.0\n")
    held, per_n, force_per_pa = blood_model(scene).touch.contact_at(2.0)
    assert held == pytest.approx(1e4 * np.cbrt([2.0, 2.0])) and per_n == pytest.approx(held / 6.0, rel=1e-3)
    assert force_per_pa == pytest.approx(3.0 * 0.5e-4 * np.cbrt(4.0), rel=1e-3)
    plain = blood_model(scene_with("")).touch.contact_at(2.0)
    assert plain[0] == pytest.approx([2e4, 2e4]) and plain[2] @ plain[1] == pytest.approx(1.0)


@pytest.mark.parametrize("force_n", [0.0, 0.3, 1.0, 2.0])
@pytest.mark.parametrize("grows", ["", "contact_force_n = 1.0\n"])
def test_pressures_of_one_newton_more_make_it(force_n, grows):
    """Where the distal side is reached at 0.6 N, below it by the proximal one alone, and whether areas grow or not."""
    touch = blood_model(scene_with("[touch]\ndistal_onset_n = 0.6\n" + grows)).touch
    _, per_n, force_per_pa = touch.contact_at(force_n)
    assert force_per_pa @ per_n == pytest.approx(1.0)


def test_a_touch_without_force_has_no_shear():
    held_pa = blood_model(scene_with("[touch]\nforce_n = 0.0\nshear_n = 0.5\n")).touch.held_pa([0.0, 1.0])
    assert held_pa == pytest.approx(np.array([[0.0, 1e4], [0.0, 1e4], [0.0, 0.0]]))


def test_photodiodes_lie_above_their_own_zones():
    board = """
[[photodiodes]]
name = "{name}"
position_mm = [2.0, {v}]
"""
    text = (
        SMALL_FINGER_BEST
        + "{}"
        + "".join(board.format(name=f"p{k}", v=v) for k, v in enumerate((-4.0, -2.0, 2.0, 4.0)))
    )
    assert parse_scene(text.format("zones = 8")).zones_of_photodiodes == (4, 1, 2, 5, 6)
    assert parse_scene(text.format("")).zones_of_photodiodes == (1, 0, 0, 1, 1)


@pytest.mark.parametrize("name", ["best", "compromise"])
def test_the_white_band_widens_from_1_to_4_n_and_shear_widens_it_further(name):
    def band(force_n, extra=""):
        text = f'zones = 16\n[touch]\nprofile = "hold"\nforce_n = {force_n}\nduration_s = 0.1\n{extra}'
        return float(blood_over_touch(parse_scene(SMALL_FINGER_BEST.replace("best", name) + text)).white_band_mm[-1])

    assert band(0.0) == 0.0 and band(1.0) < band(2.0) < band(4.0) < 12.0
    assert band(1.0) < band(1.0, "shear_n = 0.5") == band(1.0, "shear_n = -0.5") < band(1.0, "shear_n = 2.0")


def test_the_white_band_ends_where_half_of_the_blood_is_left():
    scene = zoned(zone_text="zones = 4")
    part = np.array([[1.0, 1.0, 0.4, 0.9], [1.0, 0.8, 0.4, 0.4], [1.0, 0.4, 0.4, 0.3], [1.0, 0.0, 0.4, 0.6]])
    # Middles lie at -4.5, -1.5, 1.5 and 4.5 mm; from 0.8 to 0.4 half is passed at three quarters of the way.
    expected = [0.0, 6.0 - (-1.5 + 0.75 * 3.0), 12.0, 0.0]
    assert blood_model(scene).white_band_mm(0.03 * part) == pytest.approx(expected)


def test_shear_is_a_third_pressure_left_out_of_two_pressure_states():
    sheared = zoned("[touch]\nforce_n = 2.0\nshear_n = -1.0\n")
    run = blood_over_touch(sheared)
    assert run.shear_n.min() == -1.0 and run.shear_n[0] == 0.0
    assert run.distal_pressure_pa.max() == pytest.approx(2e4)
    still = steady_blood(zoned(), [2.0])[0]
    assert steady_blood(sheared, [2.0])[0, -2] < still[-2]
    assert blood_model(sheared).without_shear().steady(np.full((2, 1), 2e4))[0] == pytest.approx(still)
    assert steady_blood(sheared, [0.0])[0] == pytest.approx(np.full(8, 0.03), rel=1e-9)


def test_pooled_blood_is_arterial_and_squeezing_changes_no_saturation():
    run = blood_over_touch(scene_with("so2 = 0.95\nvenous_so2 = 0.85\n"))
    fraction, so2 = run.blood_fraction.values, run.so2.values
    assert so2[:, 0] == pytest.approx([0.9, 0.9])
    pooled = fraction > 0.03
    assert so2[~pooled] == pytest.approx(0.9)
    # Oxygen is what was there, and what came with the arteries.
    assert (so2 * fraction)[pooled] == pytest.approx((0.9 * 0.03 + 0.95 * (fraction - 0.03))[pooled])
    assert so2[0].max() > 0.91 and "so2" not in blood_over_touch(scene_with(""))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("zones = 8\nzone_edges_mm = [1.0]", "both cut the bed; give one"),
        ("zone_edges_mm = [0.0, 1.0]", "lie closer than zone_width_mm = 2; move them apart"),
        ("zone_edges_mm = [0.0, 7.0]", "blood.zone_edges_mm 7 lies off the nail, which reaches from -6 to 6 mm"),
        ("zones = 1", "blood.zones = 1: must be greater than or equal to 2"),
        ("venous_so2 = 0.99", "venous_so2 = 0.99 must not be above so2 = 0.97"),
        ("decay_length = 0.0", "blood.decay_length = 0.0: must be greater than or equal to 0.01"),
    ],
)
def test_blood_that_cannot_be_is_refused_in_one_line(text, words):
    with pytest.raises(InputError, match=words) as caught:
        scene_with(text)
    assert len(str(caught.value).splitlines()) == 1


def test_a_creeping_touch_ends_as_a_lighter_one():
    text = '[touch]\nprofile = "hold"\nforce_n = 0.5\nsite = "proximal"\n'
    creeping, lighter = scene_with(text + "creep = 0.2\ncreep_s = 0.5\n"), scene_with(text.replace("0.5", "0.4"))
    assert float(blood_over_touch(creeping).proximal_pressure_pa[-1]) == pytest.approx(4e3, rel=1e-3)
    assert float(blood_over_touch(creeping).force_n[-1]) == 0.5
    assert steady_blood(creeping, [0.5]) == pytest.approx(steady_blood(lighter, [0.4]))


def test_waves_move_the_blood_by_the_squares_of_their_gains():
    """Expected: of the covariance the diagonal is the sum of lines, and no combination of zones has less than none."""
    scene = scene_with("[body.heartbeat]\n[body.vasomotion]\namplitude_pa = 300.0\n")
    model, (frequency_hz, variance_pa2) = blood_model(scene), pressure_lines(scene.body)
    gain = model.by_arterial_pressure(frequency_hz, 0.5)
    assert np.abs(np.angle(gain[0, frequency_hz > 1])).max() > 0.2
    covariance = model.covariance(scene.body, 0.5, bandwidth_hz=1e3)
    assert np.diagonal(covariance) == pytest.approx(np.abs(gain) ** 2 @ variance_pa2)
    assert np.linalg.eigvalsh(covariance).min() > -1e-12 * covariance.max()


def test_a_beat_is_from_the_least_blood_to_the_most():
    beat = rest_beat(scene_with("[body.heartbeat]\n"))
    least, most = beat.extremes.sum(1) + beat.resting.sum()
    assert (least, most) == pytest.approx((beat.blood_fraction.sum(0).min(), beat.blood_fraction.sum(0).max()))


@pytest.mark.parametrize(
    "text",
    [
        "[body]\nhand_height_m = 0.3\n",
        "[body]\nvenous_pressure_pa = 3000.0\n",
        "[touch]\ncreep = 0.3\ncreep_s = 0.5\n",
        "[touch]\nforce_n = 0.8\nshear_n = 0.4\n",
    ],
)
def test_a_beat_under_a_force_is_that_of_a_touch_that_is_held(text):
    """Posture, creep and shear move the blood about which it beats, and its pulse. Expected: both zones' mean and pulse
    once the touch has been held for long, and without these others."""
    beats = SMALL_FINGER_BEST + "{}" + "[body.heartbeat]\nrate_variability = 0.0\n"
    scene, plain = parse_scene(beats.format(text)), parse_scene(beats.format(""))
    held = {"profile": "hold", "force_n": 0.8, "duration_s": 20.0, "sample_rate_hz": 64 * 70 / 60}
    run = blood_over_touch(scene.with_({f"touch.{name}": value for name, value in held.items()}))
    last = run.blood_fraction.values[:, -64:]
    beat = beat_at(scene, 0.8)
    assert beat.resting == pytest.approx(last.mean(1), rel=1e-3)
    assert np.ptp(beat.pulse, axis=0) == pytest.approx(np.ptp(last, axis=1), rel=0.01)
    assert np.abs(beat.resting - beat_at(plain, 0.8).resting).max() > 5e-4


def test_a_beat_in_a_recorded_posture_is_that_of_its_mean():
    heart = {"heartbeat": {}, "recorded_time_s": (0.0, 2.0, 4.0), "recorded_hand_height_m": (0.0, 0.2, 0.4)}
    recorded, still = (
        scene_with("").with_({"body": body}) for body in (heart, {"heartbeat": {}, "hand_height_m": 0.2})
    )
    assert beat_at(recorded, 0.5).blood_fraction == pytest.approx(beat_at(still, 0.5).blood_fraction)


@pytest.mark.parametrize(
    ("force_n", "end"), [([0.0, 0.5, 1.0, 0.999, 1.0, 0.4, 0.0], 4), ([1.0, 0.2, 0.2, 1.0], 2), ([0.0, 0.0, 0.0], 2)]
)
def test_the_hold_ends_with_the_last_sample_that_is_farthest_from_the_first(force_n, end):
    assert hold_end(xr.Dataset({"force_n": ("time", force_n)})) == end

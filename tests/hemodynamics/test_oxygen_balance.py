"""Oxygen of the bed by inflow and consumption: limits with closed forms, an independent integrator, and touches."""

import numpy as np
import pytest
import xarray as xr
from scipy.integrate import solve_ivp
from small_scenes import SMALL_FINGER_BEST

from nailoptics import tissue
from nailoptics.errors import InputError
from nailoptics.hemodynamics import saturation_over_time, steady_state
from nailoptics.hemodynamics.for_scene import blood_model, blood_over_touch
from nailoptics.light import DetectedLight, optics
from nailoptics.light.transfer.series import ReadingSeries
from nailoptics.scene import Blood, parse_scene

BLOOD = Blood(so2=0.97, venous_so2=0.89, oxygen_balance=True, exchange_s=40.0)
BALANCE = "rest_blood_fraction = 0.03\nso2 = 0.97\nvenous_so2 = 0.89\noxygen_balance = {}\n"
HELD = "[touch]\nforce_n = 1.0\nproximal_share = 1.0\nstart_s = 5.0\nrelease_s = 65.0\nduration_s = 100.0\n"


def scene_with(text: str, balance: str = "true", folder=None):
    return parse_scene(SMALL_FINGER_BEST + BALANCE.format(balance) + text, folder=folder)


def test_rest_keeps_the_mean_of_arterial_and_venous_saturation() -> None:
    time_s = np.linspace(0.0, 200.0, 11)
    so2 = saturation_over_time(BLOOD, time_s, np.full((2, 11), 0.03), np.ones((2, 11)))
    assert so2 == pytest.approx(np.full((2, 11), BLOOD.rest_so2), rel=1e-12)


def test_stagnant_blood_desaturates_at_the_rate_of_consumption() -> None:
    time_s, flow = np.linspace(0.0, 60.0, 601), np.ones((1, 601))
    flow[:, 1:] = 0.0
    for pooled in (0.03, 0.06):
        so2 = saturation_over_time(BLOOD, time_s, np.full((1, 601), pooled), flow)[0]
        expected = (BLOOD.so2 - BLOOD.venous_so2) / BLOOD.exchange_s * BLOOD.rest_blood_fraction / pooled
        assert np.diff(so2)[1:] / np.diff(time_s)[1:] == pytest.approx(-expected, rel=1e-9)
    # 12 % in a minute, as in the hand under a cuff, and never below none.
    assert so2[0] - so2[-1] == pytest.approx(0.06, rel=0.02)
    assert saturation_over_time(BLOOD, 100 * time_s, np.full((1, 601), 0.03), flow).min() == 0.0


def test_twice_the_flow_halves_the_extraction() -> None:
    time_s = np.linspace(0.0, 400.0, 4001)
    flow = np.where(time_s < 1.0, 1.0, 2.0)[None]
    below = BLOOD.so2 - saturation_over_time(BLOOD, time_s, np.full(flow.shape, 0.03), flow)[0]
    assert below[-1] == pytest.approx(0.5 * below[0], rel=1e-6)
    # Relaxation in exchange_s / 4.
    assert np.interp(11.0, time_s, below) / below[0] == pytest.approx(0.5 + 0.5 / np.e, rel=0.01)


def test_an_independent_integrator_gives_the_same_saturation() -> None:
    time_s = np.linspace(0.0, 60.0, 60_001)
    fraction = 0.03 + 0.015 * np.sin(0.3 * time_s) ** 2
    flow = 1.0 + 0.9 * np.cos(0.21 * time_s)
    rest_flow = 0.03 / 40.0

    def slope(t, so2):
        f, change = 0.03 + 0.015 * np.sin(0.3 * t) ** 2, 0.015 * 0.3 * np.sin(0.6 * t)
        inflow = 2.0 * rest_flow * (1.0 + 0.9 * np.cos(0.21 * t)) + max(change, 0.0)
        return (inflow * (0.97 - so2) - rest_flow * 0.08) / f

    so2 = saturation_over_time(BLOOD, time_s, fraction[None], flow[None])[0]
    exact = solve_ivp(slope, (0.0, 60.0), [so2[0]], t_eval=time_s[::1000], rtol=1e-9, max_step=0.1).y[0]
    assert so2[::1000] == pytest.approx(exact, abs=2e-6)


def test_what_pools_under_a_held_touch_gives_off_its_oxygen() -> None:
    balanced, kept = (blood_over_touch(scene_with(HELD, text)) for text in ("true", "false"))
    assert np.array_equal(balanced.blood_fraction, kept.blood_fraction)
    times_s = [4.0, 6.0, 64.0, 99.0]
    before, pooled, late, after = balanced.so2.sel(time=times_s, method="nearest").values[0]
    assert before == pytest.approx(0.93, abs=1e-6) and pooled > 0.94 and late < before - 0.02
    # Once the touch is over fresh blood flows through again.
    assert late < after < before
    assert kept.so2.sel(time=64.0, method="nearest").values[0] == pytest.approx(pooled, abs=0.003)


def test_a_heartbeat_does_not_move_the_mean_saturation() -> None:
    text = '[touch]\nprofile = "hold"\nforce_n = 0.0\nduration_s = 60.0\n'
    text += "[body.heartbeat]\narteriolar_blood_fraction = {}\n"
    capillaries, both = (blood_over_touch(scene_with(text.format(part))) for part in (0.0, 0.02))
    assert float(capillaries.so2.mean()) == pytest.approx(0.93, abs=2e-3)
    # Arterioles hold arterial blood.
    assert float(both.so2.mean()) == pytest.approx((0.03 * 0.93 + 0.02 * 0.97) / 0.05, abs=2e-3)


def test_equivalent_blood_absorbs_as_blood_of_another_saturation() -> None:
    scene = scene_with("")
    led, fraction = scene.leds[0], np.array([[0.01, 0.03], [0.05, 0.06]])
    so2 = np.array([[0.5, 0.93], [0.97, 0.6]])
    equal = optics.equivalent_blood(scene, led, fraction, so2)
    columns = list(optics.bed_columns(scene))
    empty, mu_a = (
        optics.absorption(scene, led.wavelength_nm, blood_fraction=one)[..., 0, columns] for one in (0 * equal, equal)
    )
    assert mu_a - empty == pytest.approx(fraction * tissue.blood_mu_a_per_mm(led.wavelength_nm, so2), rel=1e-9)
    assert equal[0, 1] == pytest.approx(0.03)


def test_every_led_is_read_with_the_blood_that_absorbs_as_much_to_it() -> None:
    scene = scene_with('[[leds]]\nname = "red"\npart = "led_660"\nposition_mm = [-3.2, 0.0]\n')
    fraction, so2 = np.array([[0.01, 0.03], [0.05, 0.06]]), np.array([[0.5, 0.93], [0.97, 0.6]])
    course = xr.Dataset({"blood_fraction": (("zone", "time"), fraction), "so2": (("zone", "time"), so2)})

    def states_as_readings(states: np.ndarray) -> ReadingSeries:
        return ReadingSeries(*np.broadcast_to(states.T, (4, len(scene.leds), *states.T.shape)))

    read = DetectedLight(states_as_readings, np.zeros(0), np.zeros(0), (), {}).over(scene, course)
    for led, blood in zip(scene.leds, read.fraction, strict=True):
        assert np.array_equal(blood, optics.equivalent_blood(scene, led, fraction, so2))
    assert np.abs(read.fraction[0] - read.fraction[1]).max() > 0.005


def test_a_second_wavelength_distinguishes_a_held_touch_from_an_arterial_rise(tmp_path) -> None:
    """Change of the absorption at 660 nm over that at 940 nm, both of more blood in the proximal half of the bed."""
    rows = "".join(f"{t},{1e4 + 40.0 * min(max(t - 5, 0), 60)}\n" for t in range(0, 101, 5))
    (tmp_path / "rise.csv").write_text("time_s,arterial_pressure_pa\n" + rows)
    hold = '[touch]\nprofile = "hold"\nforce_n = 0.0\nduration_s = 100.0\n[body]\nfile = "rise.csv"\n'
    held = HELD.replace("force_n = 1.0", "force_n = 0.5")
    ratio = []
    for scene in (scene_with(held), scene_with(hold, folder=tmp_path)):
        run = blood_over_touch(scene)
        fraction, so2 = run.blood_fraction.values[0], run.so2.values[0]
        k = int(np.searchsorted(run.time.values, 64.0))
        assert fraction[k] > 1.05 * fraction[0]
        red, infrared = (fraction * tissue.blood_mu_a_per_mm(nm, so2) for nm in (660.0, 940.0))
        ratio.append((red[k] - red[0]) / (infrared[k] - infrared[0]))
    touch, arterial = ratio
    # Fresh arterial blood has 0.26.
    assert touch > 0.45 and arterial < 0.1


def test_a_balance_without_venous_saturation_is_refused_in_one_line() -> None:
    text = SMALL_FINGER_BEST.replace('parameters = "best"\n', 'parameters = "best"\noxygen_balance = true\n')
    with pytest.raises(InputError, match=r"oxygen_balance needs venous_so2; 0.89 is usual"):
        parse_scene(text)


def test_a_touch_from_the_first_sample_begins_with_the_saturation_at_rest() -> None:
    touch = "[touch]\nforce_n = 1.0\nproximal_share = 1.0\nstart_s = {}\nduration_s = 10.0\nprofile = 'step'\n"
    first, later = (blood_over_touch(scene_with(touch.format(start_s))) for start_s in (0.0, 1.0))
    assert first.so2.values[:, 0] == pytest.approx(BLOOD.rest_so2, abs=1e-9)
    after = later.so2.sel(time=first.time[:-150].values + 1.0, method="nearest").values
    assert first.so2.values[:, :-150] == pytest.approx(after, abs=1e-3)


def test_a_steady_flow_has_the_saturation_of_its_extraction() -> None:
    """Under a higher arterial pressure vessels are wider, and what flows in, by the fourth power of their diameter, is
    what flows out through the venules: the same oxygen is taken from more blood."""
    model = blood_model(scene_with(""))
    high = model.parameters.replace(arterial_pressure_pa=1.3 * model.parameters.arterial_pressure_pa)
    rest, now = (steady_state(one, zones=model.zones) for one in (model.rest, high))
    time_s = np.linspace(0.0, 10.0, 11)
    ends = {name: ("time", np.full(11, getattr(high, name))) for name in ("arterial_pressure_pa", "venous_pressure_pa")}
    within = {name: np.asarray(getattr(now, name))[..., None] + 0 * time_s for name in vars(now)}
    units = {name: (("zone", "time"), within[name]) for name in ("capillary_diameter_m", "capillary_pressure_pa")}
    run = xr.Dataset({"vein_pressure_pa": ("time", within["vein_pressure_pa"])} | ends | units, {"time": time_s})
    flow = (now.capillary_pressure_pa - now.vein_pressure_pa) / (rest.capillary_pressure_pa - rest.vein_pressure_pa)
    so2 = model.capillary_saturation(run, np.full((2, 11), 0.03))
    assert (flow > 1.1).all() and (now.capillary_diameter_m > 1.02 * rest.capillary_diameter_m).all()
    assert so2 == pytest.approx(np.repeat(0.97 - 0.08 / (2 * flow[:, None]), 11, axis=1), abs=1e-6)


def test_a_touch_that_shears_has_a_balance_of_oxygen():
    """Expected: the saturation of blood on which no shear acts, the proximal one's, is that without it; a touch of a
    third pressure was refused."""
    with_it, without = (blood_over_touch(scene_with(HELD + shear)).so2.values for shear in ("shear_n = 0.5\n", ""))
    assert with_it[:, 0] == pytest.approx(without[:, 0]) and np.isfinite(with_it).all()

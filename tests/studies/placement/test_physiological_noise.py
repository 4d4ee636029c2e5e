"""Placement with physiological noise: exact cases and limits of the arithmetic, and a placement that has a body."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from layout_scores import score_layout
from small_scenes import TWO_LAYOUTS

from nailoptics import hemodynamics
from nailoptics.hemodynamics.for_scene import blood_model
from nailoptics.hemodynamics.touch import touch_course
from nailoptics.hemodynamics.waves import pressure_lines
from nailoptics.report.pages import placement
from nailoptics.report.pages.placement import page
from nailoptics.scene import Placement, parse_scene
from nailoptics.sensor import electronics, information
from nailoptics.sensor.information import PhysiologicalNoise, operating_point
from nailoptics.statistics import covariance_root, leave_one_out
from nailoptics.studies.force.touch_error import TouchError
from nailoptics.studies.placement import place, result
from nailoptics.studies.placement.objective import LayoutScore, Objective

SCENE = TWO_LAYOUTS.replace("[board]", "[body.heartbeat]\n[body.breathing]\n[body.vasomotion]\n[board]")
BLOOD_PER_PA = np.array([[1.5e-6, -2e-7], [1.8e-6, -3e-6]])
FORCE_PER_PA = np.full(2, 5e-5)


def _point(blood: np.ndarray | None, *, gain: float = 0.0, reading_gain: float = 0.0) -> information.OperatingPoint:
    gains = np.array([[gain]])
    body = None if blood is None else PhysiologicalNoise(blood=blood, led_gain=gains, reading_gain=reading_gain)
    return information.OperatingPoint(
        blood_fraction=np.array([0.035, 0.025]),
        blood_per_pa=BLOOD_PER_PA,
        force_n=0.5,
        force_per_pa=FORCE_PER_PA,
        pressure_per_n=np.full(2, 1e4),
        body=body,
    )


def _read(point: information.OperatingPoint, *, count: int = 6, noise_v: float = 4e-5) -> information.Response:
    """Photodiodes along the nail, each of which reads both zones in its own proportion."""
    zone_v = -np.column_stack([np.linspace(1.5, 0.3, count), np.linspace(0.2, 1.4, count)])
    light_v = 0.1 + 0.2 * np.linspace(-1.0, 1.0, count) ** 2
    return information.Response(
        amplified_v=light_v,
        noise_v2=np.full(count, noise_v**2),
        slope_v_per_pa=zone_v @ point.blood_per_pa,
        zone_v=zone_v,
        shunted_fraction=np.zeros(count),
        body_v=None if point.body is None else point.body.shapes_v(zone_v, light_v, 0),
        independent_v2=0.0 if point.body is None else (point.body.reading_gain * light_v) ** 2,
        light_v=light_v,
    )


def test_marginalising_the_waves_equals_a_covariance_of_the_readings():
    """Rationale: J = S^T (N + W W^T)^-1 S for slopes S, the electronics' N and the body's shapes W, photodiode by
    photodiode or inverted at once; and the spread of a least squares fit to readings with both noises.
    """
    point = _point(1e-4 * np.array([[7.0, 1.0], [6.0, -2.0]]), gain=2e-3, reading_gain=5e-4)
    read = _read(point)
    independent_v2 = read.noise_v2 + read.independent_v2
    covariance = np.diag(independent_v2) + read.body_v @ read.body_v.T
    assert covariance[0, 0] > 1.5 * read.noise_v2[0]
    exact = read.slope_v_per_pa.T @ np.linalg.solve(covariance, read.slope_v_per_pa)
    total = information.fisher_information(read).sum(0)
    assert np.allclose(information.pressure_information(total), exact[[0, 0, 1], [0, 1, 1]], rtol=1e-6)
    rng = np.random.default_rng(0)
    samples = rng.normal(size=(20_000, 6)) * np.sqrt(independent_v2) + rng.normal(size=(20_000, 3)) @ read.body_v.T
    fitted = np.linalg.solve(exact, read.slope_v_per_pa.T @ np.linalg.solve(covariance, samples.T))
    # 20 000 samples determine a standard deviation to 0.5 %; the pressures' prior is 1e5 Pa.
    assert information.force_resolution_n(total, point) == pytest.approx((FORCE_PER_PA @ fitted).std(), rel=0.02)


def test_the_budget_of_the_force_is_its_error_cause_by_cause():
    """Rationale: a cause's effect on readings goes through the same estimate. Expected: squares add up to the force
    resolution, and each is the spread of forces fitted to readings with that cause alone."""
    body = PhysiologicalNoise(
        blood=3e-4 * np.array([[7.0, 1.0], [6.0, -2.0]]),
        led_gain=covariance_root(4e-4**2 * np.eye(2) + 3e-4**2),
        reading_gain=5e-4,
        led_drift=4e-4,
        lift=3e-4,
    )
    point, blocks = replace(_point(None), body=body), np.ones((3, 1))
    stage = electronics.NoiseBudget(*(part * 4e-5**2 for part in (0.5, 0.2, 0.1, 0.05, 0.15)))
    by_led, rng = [], np.random.default_rng(0)
    for led, read in enumerate((_read(point), _read(point))):
        zone_v, light_v = blocks[..., None] * read.zone_v * (1 - 0.3 * led), blocks * read.light_v
        shared = {"body_v": body.shapes_v(zone_v, light_v, led), "independent_v2": (body.reading_gain * light_v) ** 2}
        slope, noise_v2 = zone_v @ point.blood_per_pa, blocks * read.noise_v2
        one = information.Response(
            light_v, noise_v2, slope, zone_v, 0 * light_v, light_v=light_v, noise=stage, **shared
        )
        by_led.append(one)
    budget = information.force_budget_n(by_led, point)
    total = information.force_resolution_n(information.total_information(by_led), point)
    shared_v = np.concatenate([read.body_v[0] for read in by_led])
    light_v, slope = (
        np.concatenate([getattr(read, name)[0] for read in by_led]) for name in ("light_v", "slope_v_per_pa")
    )
    of_led = np.repeat(np.eye(2), 6, axis=0)
    own = np.concatenate([read.noise_v2[0] + read.independent_v2[0] for read in by_led])
    inverse = np.linalg.inv(np.diag(own) + shared_v @ shared_v.T)
    weights = point.force_per_pa @ np.linalg.solve(slope.T @ inverse @ slope, slope.T @ inverse)
    assert np.hypot.reduce([*budget.values()]) == pytest.approx(total[0], rel=1e-9)
    samples, normal = 20_000, rng.normal
    alone = {
        "shot": normal(size=(samples, 12)) * np.sqrt(0.5) * 4e-5,
        "waves": normal(size=(samples, 2)) @ shared_v[:, :2].T,
        "lift": normal(size=(samples, 1)) * 3e-4 * light_v,
        "drift": (4e-4 * normal(size=(samples, 2)) @ of_led.T + 5e-4 * normal(size=(samples, 12))) * light_v,
    }
    for cause, volts in alone.items():
        # 20 000 samples determine a standard deviation to 0.5 %.
        assert (volts @ weights).std() == pytest.approx(budget[cause], rel=0.02), cause
    assert {*information.force_budget_n(by_led, _point(None))} == {*budget} - {"waves", "lift", "drift"}


@pytest.mark.parametrize("count", [1, 6])
def test_the_noise_budget_of_one_photodiode_includes_what_it_cannot_distinguish(count):
    """Expected: floor and causes add up to the figure that ranks, also where one photodiode reads both zones at once
    and follows less of the waves than the floor; what it cannot measure is the most."""
    point = _point(1e-4 * np.array([[7.0, 1.0], [6.0, -2.0]]), gain=2e-3)
    point = replace(point, body=replace(point.body, led_drift=2e-3))
    read, stage = _read(point, count=count), electronics.NoiseBudget(*(part * 4e-5**2 for part in (1, 0, 0, 0, 0)))
    replicates = {name: np.stack(3 * [v]) for name, v in vars(read).items() if np.ndim(v)}
    parts = information.force_budget_n([replace(read, noise=stage, **replicates)], point)
    total_n = float(information.force_resolution_n(information.total_information([read]), point))
    floor_n = information.physiological_noise_force_n(point)
    assert (parts["waves"] < 0.5 * floor_n) == (count == 1)
    one = {"finger_resolution_n": [[total_n]], "physiological_noise_force_n": [floor_n]}
    (row,) = result.budgets(
        xr.Dataset(
            {name: (("layout", "finger")[-np.ndim(value) :], value) for name, value in one.items()}
            | {"force_budget_n": (("layout", "finger", "cause"), [[[*parts.values()]]])}
            | {"force_resolution_n": ("layout", [total_n]), "origin": ("layout", ["given"])},
            coords={"layout": ["drawn"], "cause": [*parts]},
        )
    )
    layout, total, *rest = row.values()
    # The prior of six photodiodes' waves is 2e-5 of them, less than the floor has.
    assert total == pytest.approx(total_n, rel=1e-4) and np.hypot.reduce(rest) == pytest.approx(total_n, rel=1e-4)
    assert (row["split"] > 0.99 * total_n) == (count == 1) and row["floor"] == floor_n


def test_a_body_that_becomes_still_leaves_the_noise_of_the_electronics():
    still = _point(None)
    alone = information.total_information([_read(still)])
    assert alone.shape == (3,)
    for strength in (1e-3, 1e-7):
        point = _point(strength * np.array([[1.0, 0.0], [0.8, 0.1]]))
        moving = [_read(point)]
        assert np.array_equal(information.total_information(moving, electronics_alone=True), alone)
        ratio = information.force_resolution_n(
            information.total_information(moving), point
        ) / information.force_resolution_n(alone, still)
        assert ratio > 5 if strength == 1e-3 else ratio == pytest.approx(1.0, abs=1e-4)


def test_unlimited_light_resolves_to_the_noise_floor_of_the_waves():
    """The body's part is the same for all layouts that read both zones, and adds to the electronics' in squares."""
    point = _point(1e-4 * np.array([[7.0, 0.5], [6.0, 0.7]]))
    floor_n = information.physiological_noise_force_n(point)
    assert floor_n > 1e-3
    for count, noise_v in ((2, 1e-7), (6, 4e-5), (12, 4e-5)):
        read = _read(point, count=count, noise_v=noise_v)
        through, alone = (
            information.force_resolution_n(information.total_information([read], electronics_alone=still), point)
            for still in (False, True)
        )
        assert through == pytest.approx(np.hypot(alone, floor_n), rel=1e-3)
    assert information.physiological_noise_force_n(_point(None)) == 0.0


def test_a_touch_of_given_split_is_distinguished_from_waves_of_one_shape():
    """One shape and one force: two unknowns, which two zones determine; its resolution is that of the part of the touch
    that is not along the wave, whatever the wave's height.
    """
    wave = np.array([[7e-2], [6e-2]])
    point = _point(wave)
    read = _read(point)
    noise_v = np.sqrt(read.noise_v2[0])
    touch, pulse = (read.zone_v @ BLOOD_PER_PA) @ point.pressure_per_n / noise_v, read.body_v[:, 0] / noise_v
    apart = touch - pulse * (touch @ pulse) / (pulse @ pulse)
    resolution_n = information.fixed_ratio_resolution_n(information.total_information([read]), point)
    assert resolution_n == pytest.approx(1 / np.linalg.norm(apart), rel=1e-3)


def test_a_gain_that_all_readings_share_leaves_their_ratios():
    """However much an LED drifts, three readings resolve two pressures by two ratios; two readings resolve none."""
    point = _point(np.zeros((2, 2)), gain=1e3)
    read = _read(point)
    noise_v = np.sqrt(read.noise_v2[0])
    light, slopes = read.amplified_v / noise_v, read.slope_v_per_pa / noise_v
    ratios = slopes - np.outer(light, light @ slopes) / (light @ light)
    spread_pa = np.linalg.inv(ratios.T @ ratios)
    resolution_n = information.force_resolution_n(information.total_information([read]), point)
    assert resolution_n == pytest.approx(np.sqrt(FORCE_PER_PA @ spread_pa @ FORCE_PER_PA), rel=1e-3)
    two = information.total_information([_read(point, count=2)])
    assert information.force_resolution_n(two, point) > 0.5 * 1e5 * FORCE_PER_PA[0]


def test_readings_of_two_leds_drift_apart_and_lift_together():
    text = SCENE.replace("[placement]", '[[leds]]\nname = "second"\npart = "led_940"\n[placement]')
    text = text.replace(
        "[body.heartbeat]", "[body.drift]\nled_per_rt_min = 0.004\n[body.motion]\nlift_um = 1.5\n[body.heartbeat]"
    )
    body = operating_point(parse_scene(text), 0.5, since_rest_s=15.0).body
    gain = body.led_gain @ body.led_gain.T
    # A quarter of a minute, of which a random walk makes half.
    assert gain[0, 0] == pytest.approx(gain[1, 1]) == pytest.approx(0.002**2 + 0.0015**2)
    assert gain[0, 1] == pytest.approx(0.0015**2)
    assert body.reading_gain == pytest.approx(0.0005 / 2)
    light_v, zone_v = np.array([0.2, 0.3]), np.ones((2, 2))
    shapes = [body.shapes_v(zone_v, light_v, led)[:, 2:] for led in range(2)]
    assert np.allclose(shapes[0] @ shapes[1].T, 0.0015**2 * np.outer(light_v, light_v))


def test_the_bodys_lines_hold_the_variance_of_its_pressure():
    """Each rhythm alone against the course that the scene would be simulated with."""
    time_s = np.arange(0.0, 6000.0, 0.02)
    for table, course in (
        ("[body.heartbeat]\nrate_variability = 0.0", hemodynamics.cardiac_pressure(time_s)),
        ("[body.breathing]", hemodynamics.breathing_pressure(time_s, amplitude_pa=600.0)),
        ("[body.vasomotion]", hemodynamics.vasomotion_pressure(time_s, amplitude_pa=600.0)),
    ):
        body = parse_scene(_with_body(table)).body
        frequency_hz, variance = pressure_lines(body)
        # It holds whole beats and breaths, and of the slow waves 600 that beat against each other: by other random
        # numbers their deviation scatters by 0.6 %.
        assert np.sqrt(variance.sum()) == pytest.approx(course.std(), rel=0.025)
        assert (frequency_hz > 0.04).all()


def _with_body(tables: str) -> str:
    return SCENE.replace("[body.heartbeat]\n[body.breathing]\n[body.vasomotion]\n", tables + "\n")


def test_a_wave_moves_the_blood_as_in_a_simulation():
    """Rationale: 20 Pa of a sine through the full equations over its last period, amplitude and phase in both zones."""
    scene = parse_scene(_with_body("").replace('"best"', '"listed"'))
    frequency_hz, force_n = 1.2, 0.3
    proximal, distal = touch_course(scene.touch).sides_pa(force_n)
    parameters = hemodynamics.parameters("listed")
    time_s = np.linspace(0.0, 6.0 / frequency_hz, 6 * 64 + 1)
    wave = parameters.arterial_pressure_pa + 20.0 * np.sin(2 * np.pi * frequency_hz * time_s)
    run = hemodynamics.respond(
        parameters,
        time_s,
        proximal_pressure_pa=float(proximal),
        distal_pressure_pa=float(distal),
        arterial_pressure_pa=wave,
        start="steady",
        rtol=1e-8,
    )
    blood = hemodynamics.blood_fraction(parameters, run.capillary_diameter_m.values, rest_blood_fraction=0.03)[:, -64:]
    turning = np.exp(-2j * np.pi * frequency_hz * time_s[-64:])
    computed = 2j * (blood * turning).mean(1) / 20.0
    assert np.allclose(blood_model(scene).by_arterial_pressure([frequency_hz], force_n)[:, 0], computed, rtol=5e-3)


def test_the_slowest_waves_move_the_blood_as_steady_states_do():
    scene = parse_scene(_with_body(""))
    proximal, distal = touch_course(scene.touch).sides_pa(0.5)
    blood = []
    for change_pa in (-10.0, 10.0):
        heartbeat = f"[body.heartbeat]\nmean_pressure_pa = {1e4 + change_pa}\npulse_pressure_pa = 0.0"
        moved = parse_scene(_with_body(heartbeat))
        parameters = hemodynamics.parameters("best").replace(arterial_pressure_pa=1e4 + change_pa)
        state = hemodynamics.steady_state(parameters, proximal_pressure_pa=proximal, distal_pressure_pa=distal)
        blood.append(state.capillary_diameter_m)
        assert np.isfinite(blood_model(moved).steady(np.array([[proximal], [distal]]))).all()
    rest = hemodynamics.steady_state(hemodynamics.parameters("best")).capillary_diameter_m
    steady = 0.03 * (blood[1] ** 2 - blood[0] ** 2) / rest**2 / 20.0
    computed = blood_model(scene).by_arterial_pressure([1e-5], 0.5)[:, 0]
    assert np.allclose(computed, steady, rtol=1e-4)


def test_waves_faster_than_the_stage_are_left_out():
    # Arterioles are there where a heart beats alone.
    heart = "[body.heartbeat]\narteriolar_blood_fraction = 0.0\n"
    usual = parse_scene(_with_body(heart + "[body.breathing]\n[body.vasomotion]"))
    slow = usual.model_copy(update={"electronics": usual.electronics.model_copy(update={"bandwidth_hz": 0.2})})
    without_beat = parse_scene(_with_body("[body.vasomotion]"))
    computed, expected = (operating_point(one, 0.5).body for one in (slow, without_beat))
    assert np.allclose(computed.blood @ computed.blood.T, expected.blood @ expected.blood.T)
    assert operating_point(parse_scene(_with_body("[body]")), 0.5).body is None


def test_intervals_with_physiological_noise_have_their_nominal_coverage():
    """Rationale: photon maps of given mean in 32 noisy blocks, 600 times. Expected: 95 % intervals cover the resolution
    of the means in 90 to 98 % of them, and standard errors are the scatter, though most of the score is the body's.
    """
    scene = parse_scene(SCENE.replace("[body.heartbeat]", "[body.drift]\n[body.motion]\n[body.heartbeat]"))
    point = information.operating_point(scene, 0.5)
    blood = np.column_stack([np.linspace(16.0, 4.0, 4), np.linspace(3.0, 12.0, 4)])
    light = np.array([2e-5, 6e-5, 5e-5, 2e-5])
    mean = np.column_stack([light, 0.3 * light, -light[:, None] * blood])
    layout = SimpleNamespace(scene=scene, board=scene)

    def scored(blocks: np.ndarray) -> LayoutScore:
        read = information.response(leave_one_out(blocks), scene, 0, scene.photodiodes[0], point)
        cache = SimpleNamespace(read=lambda *_: [[read]], conditions=[SimpleNamespace(point=point)])
        return score_layout(layout, cache, Objective(Placement(), [point]))

    true_n = float(scored(np.repeat(mean[None], 2, axis=0)).force.all_n[0])
    assert true_n < 1.1 * information.physiological_noise_force_n(point)
    rng = np.random.default_rng(4)
    # Blocks of one photon map that scatter by 30 %, so that their mean has an error of 5 %.
    every = [scored(mean * (1 + 0.3 * rng.normal(size=(32, *mean.shape)))) for _ in range(600)]
    held = np.mean([one.force.interval_n[0] <= true_n <= one.force.interval_n[1] for one in every])
    assert 0.90 <= held <= 0.98, held
    scatter = np.std([float(one.force.all_n[0]) for one in every])
    error = np.mean([one.relative_error * float(one.force.all_n[0]) for one in every])
    assert error == pytest.approx(scatter, rel=0.12)


@pytest.mark.long
def test_errors_over_touches_scatter_by_their_standard_errors():
    """Rationale: 16 noisy photon maps, each in 32 blocks, of which the filter's error is taken without one eighth at a
    time. Expected: standard errors are the scatter, within the 50 % of so few maps; a dark layout has no information.
    """
    scene = parse_scene(SCENE.replace("[body.heartbeat]", "[body.drift]\n[body.motion]\n[body.heartbeat]"))
    point, rules = information.operating_point(scene, 0.5), Placement(rank_by="force")
    objective = Objective(rules, [point], None, [TouchError(scene, 0.5)])
    light, blood = np.array([2e-5, 6e-5, 5e-5, 2e-5]), np.array([[16, 3], [12, 6], [8, 9], [4, 12]])
    mean = np.column_stack([light, 0.3 * light, -light[:, None] * blood])

    def scored(blocks: np.ndarray) -> LayoutScore:
        read = information.response(leave_one_out(blocks), scene, 0, scene.photodiodes[0], point, replicates=True)
        cache = SimpleNamespace(read=lambda *_: [[read]], conditions=[SimpleNamespace(point=point)])
        return score_layout(SimpleNamespace(scene=scene, board=scene), cache, objective)

    rng = np.random.default_rng(4)
    every = [scored(mean * (1 + 0.3 * rng.normal(size=(32, *mean.shape)))) for _ in range(16)]
    values_n = [float(one.ranked[0]) for one in every]
    error_n = np.mean([one.relative_error * value_n for one, value_n in zip(every, values_n, strict=True)])
    assert error_n == pytest.approx(np.std(values_n, ddof=1), rel=0.5)
    assert 0.4 < float(scored(np.zeros((32, *mean.shape))).ranked[0]) < 0.5


def quiet(text):
    """The scene without the uncertainty due to its priors."""
    return parse_scene(text + "[priors]\nspread = false\n")


@pytest.fixture(scope="module")
def computed(chosen_jit, fewer_photons):
    with fewer_photons():
        return place.place(quiet(SCENE), photons=1 << 17, seed=2)


@pytest.mark.long
def test_a_placement_with_a_body_is_ranked_by_its_noise(computed):
    rows = result.rows(computed)
    assert [row["layout"] for row in rows if row["layout"] != "paper"] == ["near", "far"]
    floor_n = float(computed.physiological_noise_force_n[0])
    for row in rows:
        both = np.hypot(row["electronics_resolution_n"], floor_n)
        assert row["force_resolution_n"] == pytest.approx(both, rel=0.01)
        low, high = float(row["force_resolution_low_n"]), float(row["force_resolution_high_n"])
        # Through a healthy nail the electronics add less than the prior of the pressures.
        assert 0.9995 * floor_n < row["force_resolution_n"] < 1.0005 * high and floor_n <= low <= high
        # The body's own part has no error: what is left is the electronics', as much less as it adds.
        share = row["electronics_resolution_n"] / row["force_resolution_n"]
        error = share * row["electronics_resolution_n_stderr"]
        assert row["force_resolution_n_stderr"] == pytest.approx(error, rel=0.1, abs=1e-4 * floor_n)
    assert sorted(row["electronics_rank"] for row in rows) == list(range(1, len(rows) + 1))
    fresh, predicted = computed.attrs["checked_resolution_n"], float(computed.finger_resolution_n[0, 0])
    assert fresh == pytest.approx(predicted, rel=0.05)
    assert "Electronics alone [mN]" in placement.lines(placement.summary(computed))[0]
    assert [row["layout"] for row in rows if row["roughly_known"]] == ["far"]
    lines = placement.lines(placement.summary(computed))
    assert any("too optimistic" in line for line in lines) and f"{len(rows)} of {len(rows)} layouts traced" in lines
    total_n = (computed.force_budget_n**2).sum("cause") ** 0.5
    assert np.allclose(total_n, computed.finger_resolution_n, rtol=1e-3)
    assert any("waves of the body that no layout changes" in line for line in lines)


@pytest.mark.long
def test_readings_with_too_few_photons_for_an_error_are_warned_of_and_have_no_numbers(computed):
    few = computed.assign(predicted_volts_stderr=computed.predicted_volts_stderr.copy(deep=True))
    few.predicted_volts_stderr[0, 0] = np.nan
    (warning,) = placement.summary(few)["warnings"]
    known = int(computed.predicted_volts_stderr.isnull().sum())
    assert warning.startswith(f"{known + 1} of {few.predicted_volts.size} readings of the best layout")
    text = page(few)
    assert "too few photons</td><td>–</td>" in text and warning in text and "its intervals too narrow" in warning
    # Beside the interval in the lead and, with the layouts of which that is so, below the figure of all intervals.
    assert re.search(r"95 % interval [^)]*, too narrow: too few photons\)", text)
    assert re.search(r"<figcaption>Force resolution of each layout[^<]* intervals are too narrow", text)


@pytest.mark.long
def test_the_page_states_the_part_of_physiological_noise(computed, tmp_path):
    (tmp_path / "place.html").write_text(page(computed), encoding="utf-8")
    text = (tmp_path / "place.html").read_text(encoding="utf-8")
    assert "Physiological noise" in text and "Electronics alone<br>[mN]" in text and "heartbeat" in text
    assert text.count("<svg") == 5


@pytest.mark.long
def test_layouts_are_ranked_by_the_filters_error_over_touches(computed, fewer_photons):
    """Expected: with the same light, the filter's error is what ranks, with its interval, above what no layout changes;
    the one-sample figure stays, and page and terminal state how much of the error depends on the layout."""
    with fewer_photons():
        by_touches = place.place(
            quiet(SCENE.replace("[placement]", '[placement]\nrank_by = "force"')), photons=1 << 17, seed=2
        )
    rows = {row["layout"]: row for row in result.rows(by_touches)}
    before = {row["layout"]: row for row in result.rows(computed)}
    floor_n = float(by_touches.force_error_floor_n[0])
    by_error = sorted(rows, key=lambda name: rows[name]["force_error_n"])
    proposed, *others = rows
    assert others == [name for name in by_error if name != proposed]
    assert proposed == by_error[0] or rows[proposed]["force_error_n"] < 1.04 * rows[by_error[0]]["force_error_n"]
    for name, row in rows.items():
        assert row["force_resolution_n"] == pytest.approx(before[name]["force_resolution_n"])
        assert floor_n < row["force_error_low_n"] < row["force_error_n"] < row["force_error_high_n"]
    assert rows["near"]["force_error_n"] < rows["far"]["force_error_n"]
    text, lines = page(by_touches), placement.lines(placement.summary(by_touches))
    assert "Error over touches<br>[mN]" in text and "error of the force over touches [mN]" in text
    assert "Error over touches [mN]" in lines[0]
    sentence = next(line for line in lines if "depend on the layout" in line)
    assert "of a finger that is known exactly" in sentence and "depend on the layout" in text
    assert np.isfinite(by_touches.tolerance_ranking_stderr).any()

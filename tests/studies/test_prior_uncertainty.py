"""Uncertainty over the priors of the finger: against closed forms, fresh traces, joint draws and other photons."""

import warnings
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr

from nailoptics import load_scene, parse_scene, simulate, to_toml
from nailoptics.assets import data_dir
from nailoptics.errors import InputError
from nailoptics.hemodynamics.for_scene import steady_blood
from nailoptics.light import ReweightWarning, Transfer, optics, trace
from nailoptics.light.tracing import stopping
from nailoptics.light.transfer.records import LedTrace
from nailoptics.light.transfer.series import readings_over_states
from nailoptics.options import TraceOptions
from nailoptics.report.uncertainty_section import _range, spread_section, spread_summary
from nailoptics.scene import Priors, Scene, Touch
from nailoptics.scene.priors import Prior, PriorRange, shipped_priors
from nailoptics.scene.vessels import Tuning
from nailoptics.sensor.information import operating_point
from nailoptics.statistics import Z95, jackknife, leave_one_out
from nailoptics.studies import prior_uncertainty
from nailoptics.studies.prior_uncertainty import (
    NODES,
    WEIGHTS,
    PriorSensitivity,
    at_value,
    nodes_of,
    only_absorbs,
    over_priors,
    prior_of,
    readings_over_priors,
    value_of,
)

OPTIONS = TraceOptions(seed=1)


def prototype(*known: str, **fields) -> Scene:
    scene = load_scene(data_dir("scenes") / "prototype.toml")
    return scene.model_copy(update={"priors": Priors(known=known, **fields)})


def ends(scene: Scene) -> np.ndarray:
    return steady_blood(scene, [0.0, 1.0])


def held_ends(scene: Scene) -> tuple[np.ndarray, None]:
    """The same as `readings_over_priors` takes them, of blood as saturated as the scene states."""
    return ends(scene), None


def all_but(*fields: str) -> tuple[str, ...]:
    return tuple(one.field for one in shipped_priors() if one.field not in fields)


@pytest.fixture(scope="module")
def traced(chosen_jit) -> Transfer:
    return trace(prototype(), photons=400_000, seed=1)


@pytest.fixture(scope="module")
def reread(chosen_jit) -> Transfer:
    """Light for tests that compare what is read of it with nothing but other readings of the same photons."""
    return trace(prototype(), photons=80_000, seed=1)


def relative(transfer: Transfer, scene: Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Reading at rest, its error, its change by 1 N as a fraction of it and the error of that, (photodiode,) each."""
    result = readings_over_states(replace(transfer, scene=scene), ends(scene))
    level, change = result.fraction[0, :, 0], result.change[0, :, 1]
    return level, result.stderr[0, :, 0], change / level, result.change_stderr[0, :, 1] / level


@pytest.mark.parametrize("scale", ["log", "linear"])
def test_the_nodes_of_a_prior_have_its_mean_and_standard_deviation(scale):
    prior = Prior(field="finger.plate_absorption", low=0.5, high=2.0, name="x", scale=scale, source="none")
    of = np.log if scale == "log" else np.asarray
    at, (low, high) = of(nodes_of(prior)), of([0.5, 2.0])
    assert WEIGHTS.sum() == pytest.approx(1) and WEIGHTS @ at == pytest.approx((low + high) / 2, abs=1e-12)
    assert WEIGHTS @ (at - at[1]) ** 2 == pytest.approx(((high - low) / (2 * Z95)) ** 2)
    assert low < at[0] < at[2] < high


def test_light_of_one_path_varies_as_the_absorption_does():
    """Rationale: of one path L in the plate ln reading = -mu_a L f + const; f is lognormal with a given variance."""
    halved_to_doubled = PriorRange(field="finger.plate_absorption", low=0.5, high=2.0)
    scene, length_mm = prototype(*all_but("finger.plate_absorption"), ranges=(halved_to_doubled,)), 2.0
    names = optics.absorbers(scene)
    path = np.zeros((8 * 400, len(names)), np.float32)
    path[:, names.index("plate")] = length_mm
    light = LedTrace(
        photons=4000,
        mu_a=optics.absorption(scene, 800.0)[0],
        photon=np.arange(len(path)) % 4000,
        photodiode=np.repeat(np.arange(8), 400),
        weight=np.ones(len(path)),
        path_mm=path,
        energy={},
        seeds=(0,),
    )
    transfer = Transfer(scene, (light,), "none", engine="made up", versions={"numpy": "0"})
    result = readings_over_priors(transfer, held_ends, options=OPTIONS, own_traces=False)
    value, error = result.level.total
    sd, depth = np.log(4) / (2 * Z95), float(light.mu_a[names.index("plate")]) * length_mm
    exact = depth * np.sqrt((np.exp(sd**2) - 1) * np.exp(sd**2))
    assert value == pytest.approx(np.full((1, 8), exact), rel=0.01) and (error < 1e-6).all()
    # No light went through the bed, so touch changes nothing.
    assert (result.signal.base_answer == 0).all() and not result.signal.keeps_sign.any()


@pytest.mark.slow
@pytest.mark.parametrize("field, value", [("finger.plate_absorption", 0.5), ("finger.bed_absorption", 4.0)])
def test_a_reweighted_prior_agrees_with_a_fresh_trace_of_it(jit_backend, traced, field, value):
    changed = at_value(traced.scene, field, value)
    assert only_absorbs(traced.scene, next(one for one in shipped_priors() if one.field == field))
    reread, fresh = relative(traced, changed), relative(trace(changed, photons=400_000, seed=2), changed)
    for k in (0, 2):
        apart, error = np.abs(reread[k] - fresh[k]), np.hypot(reread[k + 1], fresh[k + 1])
        assert (apart < 3 * error).all() and (apart**2 / error**2).mean() < 2
    # Precise enough to test: the change is many times its error.
    moved = np.abs(reread[0] / relative(traced, traced.scene)[0] - 1)
    assert (moved > 5 * reread[1] / reread[0]).any()


def drawn(scene: Scene, result: PriorSensitivity, count: int, seed: int) -> Iterator[Scene]:
    """The scene at so many draws from the joint prior, not beyond three standard deviations."""
    random = np.random.default_rng(seed)
    for row in random.multivariate_normal(np.zeros(len(result.priors)), result.correlation, count):
        one = scene
        for at, prior in zip(np.clip(row, -3, 3), result.priors, strict=True):
            mean, sd = prior_of(prior)
            value = float(np.exp(mean + sd * at) if prior.scale == "log" else mean + sd * at)
            one = at_value(one, prior.field, min(value, 1.0) if prior.field == "blood.so2" else value)
        yield one


@pytest.mark.long
def test_one_prior_at_a_time_adds_up_to_all_at_once(reread):
    """Expected: what one prior each changes adds up to joint draws; what two of them add together is small."""
    result, draws = readings_over_priors(reread, held_ends, options=OPTIONS, own_traces=False), []
    for one in drawn(reread.scene, result.level, 160, seed=7):
        with warnings.catch_warnings():
            # Some draws lie far from the trace; they count with all others.
            warnings.simplefilter("ignore", ReweightWarning)
            draws.append(relative(reread, one))
    level = np.log([one[0] for one in draws]).std(0, ddof=1)
    signal = np.array([one[2] for one in draws]).std(0, ddof=1)
    # Of 160 draws a standard deviation is estimated to 6 %, all photodiodes alike; lognormal tails make it some more.
    assert result.level.total[0][0] == pytest.approx(level, rel=0.3)
    assert result.signal.total[0][0] == pytest.approx(signal, rel=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [11, 12])
def test_the_95_percent_interval_over_priors_covers_fresh_traces(traced, seed):
    """Expected: of 40 draws, all priors at once, 88 to 99 % of readings and signals lie within the stated interval."""
    transfer = trace(traced.scene, photons=1_000_000, seed=1)
    result = readings_over_priors(transfer, held_ends, options=OPTIONS, own_traces=True)
    fresh = []
    for k, one in enumerate(drawn(traced.scene, result.level, 40, seed=seed)):
        with warnings.catch_warnings():
            # A touch that presses nearly all blood out is read with few of its photons; it counts with all others.
            warnings.simplefilter("ignore", ReweightWarning)
            fresh.append(relative(trace(one, photons=100_000, seed=100 + k), one))
    for stated, read in ((result.level, np.log([one[0] for one in fresh])), (result.signal, [one[2] for one in fresh])):
        low, high = np.percentile(stated.draws(0)[:, 0], [2.5, 97.5], axis=0)
        covered = ((read > low) & (read < high)).mean(axis=0)
        what = "readings" if stated is result.level else "signals"
        print(f"covered, seed {seed}: {covered.mean():.3f} of {what}, at each photodiode {np.round(covered, 3)}")
        assert 0.88 <= covered.mean() <= 0.99


@pytest.mark.parametrize(
    ("fresh", "draws", "seed"),
    [
        pytest.param(False, 100, 7, marks=pytest.mark.long),
        pytest.param(True, 40, 11, marks=pytest.mark.slow),
        pytest.param(True, 40, 12, marks=pytest.mark.slow),
    ],
)
def test_signs_that_hold_do_so_in_joint_draws(request, fresh, draws, seed):
    """Expected: at least 97.5 % of joint draws, with the blood of each and the scene's light or a fresh trace, have the
    sign that is stated to hold: of a distal touch at all photodiodes, of an even one not at each."""
    transfer, sites = request.getfixturevalue("traced" if fresh else "reread"), ("even", "proximal", "distal")

    def at(site: str, scene: Scene) -> Scene:
        return scene if site == "even" else at_value(scene, "touch.proximal_share", float(site == "proximal"))

    def signal_over_priors(site: str) -> PriorSensitivity:
        pressed = replace(transfer, scene=at(site, transfer.scene))
        return readings_over_priors(pressed, held_ends, options=OPTIONS, own_traces=fresh).signal

    stated = {site: signal_over_priors(site) for site in sites}
    same: dict[str, list[np.ndarray]] = {site: [] for site in sites}
    for k, one in enumerate(drawn(transfer.scene, stated["even"], draws, seed=seed)):
        light = trace(one, photons=20_000, seed=100 + k) if fresh else transfer
        for site in sites:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ReweightWarning)
                same[site].append(np.sign(relative(light, at(site, one))[2]) == np.sign(stated[site].base_answer[0, 0]))
    held = {site: stated[site].keeps_sign[0] for site in sites}
    for site in sites:
        print(f"{site}: stated to hold at {held[site].sum()} of 8; same sign in {np.mean(same[site], axis=0)} of draws")
    assert held["distal"].all() and not held["even"].all() and np.mean(same["even"], axis=0).min() < 0.9
    assert np.mean(np.concatenate([np.mean(same[site], axis=0)[held[site]] for site in sites])) >= 0.975


@pytest.mark.slow
def test_the_standard_error_of_a_prior_uncertainty_is_calibrated(traced):
    """Twenty parts of the photons, each by itself, against all of them: 95 % intervals hold their estimates."""
    light, parts = traced.traces[0], 20
    whole = readings_over_priors(traced, held_ends, options=OPTIONS, own_traces=False)
    of = np.random.default_rng(3).integers(parts, size=light.photons)[light.photon]
    each = []
    for k in range(parts):
        part = replace(light.select(of == k), photons=light.photons // parts)
        result = readings_over_priors(replace(traced, traces=(part,)), held_ends, options=OPTIONS, own_traces=False)
        each.append([(*one.total, one.base_answer[0]) for one in (result.level, result.change, result.signal)])
    value, error = (np.array([[kind[j][0] for kind in one] for one in each]) for j in (0, 1))
    for kind, one in ((0, whole.level), (1, whole.change), (2, whole.signal)):
        truth = one.total[0][0]
        off = (value[:, kind] - truth) / error[:, kind]
        assert 0.85 < (np.abs(off) < Z95).mean()
        assert 0.4 < (off**2).mean() < 2.0, kind


def test_photon_noise_adds_nothing_to_the_prior_uncertainty():
    """Responses proportional to the standardised field, by slopes of 20 groups of photons that scatter by 1 about 1.
    Expected: their mean's square is 1.05 in the mean of repeats, and 1 once its noise is taken away, to 0.003."""
    slopes = leave_one_out(1 + np.random.default_rng(5).standard_normal((20, 20_000)))
    nodes = NODES[None, :, None, None] * slopes
    value, _ = PriorSensitivity((shipped_priors()[0],), nodes, 0 * slopes, np.eye(1)).by_prior
    assert np.mean(value**2) == pytest.approx(1.0, abs=0.015) and np.mean(slopes[0] ** 2) > 1.04


@pytest.mark.long
def test_a_scattering_prior_has_traces_of_its_own(chosen_jit):
    own = PriorRange(field="finger.plate_scattering", low=0.25, high=2.5)
    scene = prototype(*all_but("finger.plate_scattering", "finger.plate_absorption"), ranges=(own,))
    transfer = trace(scene, photons=200_000, seed=1)
    without = readings_over_priors(transfer, held_ends, options=OPTIONS, own_traces=False)
    assert [one.field for one in without.untraced] == ["finger.plate_scattering"] and len(without.level.priors) == 1
    result = readings_over_priors(transfer, held_ends, options=OPTIONS, own_traces=True)
    assert result.untraced == () and [one.field for one in result.level.priors][1] == "finger.plate_scattering"
    value, error = (each[1] for each in result.level.by_prior)
    assert (value > 3 * error).sum() > 4
    # A plate that scatters the most passes the least, where the photodiodes get enough light; those next to the LED
    # lose so little that 200 000 photons, with errors of 2 %, do not resolve it.
    nodes = result.level.nodes[1, :, 0, 0, :, 0]
    less = nodes[1, 2:6] - nodes[2, 2:6]
    assert less.min() > -0.1 and less.mean() > 0.1 and (np.delete(less, 1) > 0).all()
    value, error = result.level.total
    assert (value + 2 * error >= without.level.total[0]).all() and (value - 2 * error > without.level.total[0]).any()


def test_the_traces_of_all_priors_share_one_time(reread, monkeypatch):
    """Traces of 4 s each, five of two priors; expected: each may take its share of what is left, and none begins that
    would end too late, so that a prior whose traces are not complete is left out."""
    scene, now_s, limits = prototype(*all_but("finger.plate_scattering", "finger.bed_scattering")), [0.0], []

    def traced_for_4_s(varied, *, max_seconds, **how):
        limits.append(max_seconds)
        now_s[0] += 4.0
        return replace(reread, scene=varied)

    monkeypatch.setattr(stopping, "time", SimpleNamespace(perf_counter=lambda: now_s[0]))
    monkeypatch.setattr(prior_uncertainty, "trace", traced_for_4_s)
    for max_seconds, expected, names in (
        (30.0, [6.0, 6.5, 22 / 3, 9.0, 14.0], []),
        (19.0, [3.8, 3.75, 11 / 3, 3.5], ["finger.bed_scattering"]),
        (None, [None] * 5, []),
    ):
        now_s[0], options = 0.0, replace(OPTIONS, max_seconds=max_seconds)
        limits.clear()
        result = readings_over_priors(replace(reread, scene=scene), held_ends, options=options, own_traces=True)
        assert limits == pytest.approx(expected) if max_seconds else limits == expected
        assert [prior.field for prior in result.untraced] == names and result.why == "max_seconds ended"


@pytest.mark.long
def test_a_finger_without_priors_has_no_prior_uncertainty(reread):
    scene = prototype(*all_but())
    result = readings_over_priors(replace(reread, scene=scene), held_ends, options=OPTIONS, own_traces=True).dataset(
        scene
    )
    assert result.sizes["prior"] == 0 and (result.reading_spread < 1e-9).all() and (result.signal_spread < 1e-9).all()
    assert spread_summary(result) == {} and spread_section(result) == ""


def test_a_sign_holds_where_nearly_all_draws_have_it_beyond_noise():
    """Rationale: a normal answer of mean 1 is above 0 in 97.5 % where its standard deviation is 1 / 1.96."""
    prior, root3 = shipped_priors()[0], 3**0.5
    sd = np.array([0.9 / Z95, 1.1 / Z95])
    nodes = 1 + np.array([-root3, 0.0, root3])[None, :, None, None, None] * np.broadcast_to(sd, (1, 3, 5, 1, 2))
    own = np.ones((5, 1, 2))
    one = np.eye(1)
    assert PriorSensitivity((prior,), nodes, own, one).keeps_sign.tolist() == [[True, False]]
    # Nor does it where photons alone could have made it: with four groups their error here is 0.8 of the answer.
    noisy = own * np.array([1.0, 1.4, 0.6, 1.4, 0.6])[:, None, None]
    assert jackknife(noisy)[0, 0] > own[0, 0, 0] / Z95
    assert not PriorSensitivity((prior,), nodes, noisy, one).keeps_sign.any()


def test_signs_by_few_draws_are_those_of_very_many():
    """Expected: of answers that bend with six correlated priors, those whose sign holds in 98.5 % of 200 000 random
    draws hold, and those with 96.5 % do not; both are many."""
    random, priors, root3 = np.random.default_rng(5), shipped_priors()[:6], 3**0.5
    slope, bend = random.normal(0.0, 0.16, (6, 400)), random.normal(0.0, 0.04, (6, 400))
    nodes = np.stack([slope * u + bend * u**2 for u in (-root3, 0.0, root3)], 1)
    half = 0.5 * np.eye(6) + 0.5
    result = PriorSensitivity(tuple(priors), 1 + nodes[:, :, None] * np.ones((1, 1, 5, 1)), np.ones((5, 400)), half)
    normal = np.split(random.multivariate_normal(np.zeros(6), half, 200_000), 200)
    part = np.mean([(1 + some @ slope + some**2 @ bend > 0).mean(0) for some in normal], 0)
    assert (part > 0.985).sum() > 30 and (part < 0.965).sum() > 30
    assert result.keeps_sign[part > 0.985].all() and not result.keeps_sign[part < 0.965].any()


def test_correlated_priors_add_up_by_their_correlation():
    """Expected: var(a u + b v) = a^2 + b^2 + 2 r a b, and of squares 2 (a^2 + b^2 + 2 r^2 a b), in the mean of ten
    pairs of priors, of which each misses the latter by 6 % at most."""
    priors, pairs, root3 = 10 * shipped_priors()[:2], 10, 3**0.5
    linear, bent = np.array([-root3, 0.0, root3]), np.array([3.0, 0.0, 3.0])
    a, b = 1.0, -0.5
    of_pair = np.moveaxis(np.stack([[a * linear, a * bent], [b * linear, b * bent]]), 2, 1)
    # Of each pair's two answers, linear and bent, no other prior changes any.
    nodes = np.einsum("pq,injk->pinqk", np.eye(pairs), of_pair[:, :, None]).reshape(2 * pairs, 3, 1, pairs, 2)
    nodes = nodes * np.ones((5, 1, 1))
    for r in (0.0, 0.6, -0.8):
        correlation = np.kron(np.eye(pairs), [[1, r], [r, 1]])
        result = PriorSensitivity(tuple(priors), nodes, np.zeros((5, pairs, 2)), correlation)
        alone = np.einsum("pipk->pik", result.by_prior[0].reshape(pairs, 2, pairs, 2))
        assert alone == pytest.approx(np.tile(np.outer(np.abs([a, b]), [1, 2**0.5]), (pairs, 1, 1)))
        assert result.by_prior[0].sum() == pytest.approx(alone.sum())
        # The draws have these correlations exactly, and those of their squares nearly.
        linearly, squares = np.sqrt([a**2 + b**2 + 2 * r * a * b, 2 * (a**2 + b**2 + 2 * r**2 * a * b)])
        assert result.total[0][:, 0] == pytest.approx(linearly)
        off = result.total[0][:, 1] / squares - 1
        error = off.std(ddof=1) / np.sqrt(pairs)
        assert abs(off.mean()) < 4 * error < 0.1, (r, off)
        assert result.shift[0] == pytest.approx(np.tile([0, a + b], (pairs, 1)), abs=1e-9)


def test_shipped_correlations_are_possible_and_left_out_for_own_ranges():
    own = PriorRange(field="finger.plate_scattering", low=0.9, high=1.1)
    for priors in (Priors(), Priors(ranges=(own,)), Priors(known=("blood.so2",))):
        matrix = priors.correlation(priors.of_finger())
        assert (matrix == matrix.T).all() and (np.diag(matrix) == 1).all()
        assert np.linalg.eigvalsh(matrix).min() > 0
        fields = [one.field for one in priors.of_finger()]
        row = matrix[fields.index("finger.plate_scattering")]
        assert (np.count_nonzero(row) > 1) == (not priors.ranges)


def test_the_shift_is_that_of_the_mean_over_the_priors_from_the_scene():
    """Rationale: a scene need not lie at the mean of its priors; the spread is then about another finger's answer.
    Expected: for an answer linear in the field, mean and standard deviation are those of the prior; a scene at 1 of a
    prior around 2 is reported with the shift of 1, and a sign that holds at the scene alone does not hold."""
    prior = Prior(field="finger.plate_scattering", low=1.0, high=3.0, name="x", scale="linear", source="none")
    scene = prototype()

    def answer(one: Scene) -> np.ndarray:
        return np.full((5, 1), one.finger.plate_scattering)

    result = over_priors(scene, [prior], answer)
    assert scene.finger.plate_scattering == 1
    assert result.shift[0] == pytest.approx([1.0]) and result.total[0] == pytest.approx([1 / Z95])
    assert result.keeps_sign.all()
    # Far from 0 at the scene, but not over the prior.
    nodes = np.array([0.02, 0.3, 0.6])[None, :, None, None] + 0 * result.nodes
    assert not PriorSensitivity((prior,), nodes, 0.6 * result.base, np.eye(1)).keeps_sign.any()


@pytest.mark.slow
def test_a_simulated_touch_reports_its_prior_uncertainty_if_enabled(chosen_jit):
    result = simulate(
        prototype("blood.so2", ranges=(PriorRange(field="finger.plate_absorption", low=0.9, high=1.1),)),
        photons=60_000,
        seed=1,
    )
    fields = [str(field) for field in result.prior_field.values]
    # Of what acts in this scene: it has no waves of the body, and two zones, whatever the edge of the bone.
    absent = {one for one in all_but() if one.startswith("body.")} | {"blood.bone_edge_mm"}
    assert len(absent) == 5 and set(fields) == set(all_but("blood.so2")) - absent
    how = dict(zip(fields, result.prior_how.values.tolist(), strict=True))
    assert how["finger.plate_absorption"] == "reweighted" and how["finger.bed_scattering"] == "retraced"
    narrow = result.prior_reading_spread.values[fields.index("finger.plate_absorption")]
    assert 0 < narrow.max() < 0.05 and result.prior_range.values[0].tolist() == [0.9, 1.1]
    for name in ("reading_spread", "change_spread", "signal_spread"):
        assert (result[name] > 0).all() and (result[f"{name}_stderr"] > 0).all()
    silent = simulate(prototype(spread=False), photons=60_000, seed=1)
    assert "prior" not in silent.dims and "reading_spread" not in silent


@pytest.mark.parametrize(
    "lines, words",
    [
        (
            'known = ["finger.plate"]',
            '"finger.plate" has no prior; choose from finger.plate_absorption',
        ),
        ('known = ["blood.so2", "blood.so2"]', "used twice"),
        ('[[priors.ranges]]\nfield = "blood.so2"\nlow = 0.9\nhigh = 0.8', "low = 0.9 must be below high = 0.8"),
        ('[[priors.ranges]]\nfield = "blood.so2"\nlow = -0.9\nhigh = 0.8', "priors: ranges.* = -0.9"),
    ],
)
def test_impossible_priors_are_refused_in_one_line(lines, words):
    text = to_toml(prototype()).split("[priors]")[0] + "[priors]\n" + lines + "\n"
    with pytest.raises(InputError, match=words) as caught:
        parse_scene(text)
    assert "\n" not in str(caught.value)


def test_every_prior_has_a_source_and_a_field_in_its_range():
    scene = load_scene(data_dir("scenes") / "placement.toml")
    assert len({one.field for one in shipped_priors()}) == len(shipped_priors()) >= 16
    for prior in shipped_priors():
        assert prior.source and prior.low <= value_of(scene, prior.field) <= prior.high
    assert {*scene.priors.of_finger(), *scene.priors.of_body(scene.body)} == {*shipped_priors()}
    assert scene.priors.of_body(None) == ()


def test_a_range_of_prior_uncertainties_has_no_end_below_the_photon_noise():
    spread = xr.DataArray([0.002, 0.05, 0.21])
    assert _range(spread, xr.DataArray([0.001, 0.01, 0.01])) == "0-21 %"
    assert _range(spread, xr.DataArray([0.08, 0.01, 0.01])) == "up to 21 %"


def test_the_bones_edge_is_a_prior_where_it_moves_blood():
    scene, force_n = prototype(), np.array([0.0, 2.0])
    for zones, is_prior in ((2, False), (8, True)):
        cut = at_value(scene, "blood.zones", zones)
        low, high = (steady_blood(at_value(cut, "blood.bone_edge_mm", mm), force_n) for mm in (0.25, 2.5))
        assert any(prior.field == "blood.bone_edge_mm" for prior in cut.finger_priors) == is_prior
        assert (np.abs(low - high).max() > 1e-3) == is_prior


def test_priors_of_vessels_cover_diameters_and_arterial_pressure():
    """Rationale: steady, the network depends on its walls' stiffness over P_H, on resistances and on touch over P_H.
    Expected: to rounding, a diameter of capillaries acts as their stiffness and the fourth power of resistances, P_H as
    the stiffness of all walls and the contact area."""
    scene, c = prototype(), 1.3

    def tuned(**factors: float) -> np.ndarray:
        return ends(at_value(scene, "blood.tuning", Tuning(factors=factors)))

    stiffer = {"capillary_stiffness_n_per_m": c, "venule_resistance_pa_s_per_m3": c**4}
    thicker = at_value(scene, "blood.tuning", Tuning(factors=stiffer))
    assert tuned(capillary_diameter_m=c) == pytest.approx(ends(at_value(thicker, "blood.vein_resistance", c**4)))
    softer = at_value(scene, "blood.wall_stiffness", 1 / c)
    assert tuned(arterial_pressure_pa=c) == pytest.approx(ends(at_value(softer, "touch.contact_area_mm2", 100 * c)))
    assert np.abs(tuned(capillary_diameter_m=c) / ends(scene) - 1).max() > 0.1


def test_contact_has_no_prior_where_the_touch_states_it():
    def unknown(**fields) -> set[str]:
        touch = Touch(profile="step", force_n=1.0, **fields)
        return {prior.field for prior in Priors().of_finger(touch.stated_contact) if prior.field.startswith("touch.")}

    assert unknown() == {"touch.contact_area_mm2", "touch.proximal_share"}
    assert unknown(site="distal") == {"touch.contact_area_mm2"}
    assert unknown(proximal_area_mm2=50.0, distal_area_mm2=60.0) == set()


@pytest.mark.parametrize("zones", [None, 8])
def test_contact_reach_and_vessels_move_the_signal_alone(zones):
    """Expected: that of a simulated touch, and the force's operating point in a placement."""
    scene = at_value(prototype(), "blood.zones", zones)
    usual, held = ends(scene), operating_point(scene, 1.0).blood_fraction
    light = {"rest_blood_fraction", "pulp_blood_fraction", "so2"}
    of_blood = [one for one in scene.finger_priors if one.field.split(".")[0] in ("blood", "touch")]
    priors = [one for one in of_blood if one.field.split(".")[1] not in light]
    assert len(priors) == (7 if zones is None else 8)
    for prior in priors:
        moved = ends(other := at_value(scene, prior.field, prior.high))
        assert np.abs(operating_point(other, 1.0).blood_fraction / held - 1).max() > 0.05
        assert moved[0] == pytest.approx(usual[0], rel=1e-9) and np.abs(moved[1] / usual[1] - 1).max() > 0.05

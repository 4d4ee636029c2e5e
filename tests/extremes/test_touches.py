"""Random touches, however they are given: as few steps as an established solver needs, and none that is not reached."""

import logging

import numpy as np
import pytest
import scipy.integrate
from benchmarks.parameter_search import SEARCHED
from scipy.integrate._ivp import ivp

from nailoptics.hemodynamics import NAMES, Waveform, bounds, parameters, respond


class Enough(Exception):
    """The other solver has taken as many steps as the comparison needs."""


class Steps(logging.Handler):
    """Steps of the massless model, from its log."""

    def emit(self, record):
        self.taken = record.args[0]


@pytest.fixture
def steps():
    log, handler = logging.getLogger("nailoptics.hemodynamics.massless"), Steps()
    level = log.level
    log.setLevel(logging.DEBUG)
    log.addHandler(handler)
    yield handler
    log.removeHandler(handler)
    log.setLevel(level)


def radau_takes(monkeypatch, most, *arguments, **given):
    """Steps that scipy's Radau takes for a response of the six states, as far as `most`."""
    taken = 0

    class Counted(scipy.integrate.Radau):
        def _step_impl(self):
            nonlocal taken
            result = super()._step_impl()
            taken += 1
            if taken >= most:
                raise Enough
            return result

    with monkeypatch.context() as patch:
        patch.setitem(ivp.METHODS, "Radau", Counted)
        try:
            respond(*arguments, model="inertial", **given)
        except Enough:
            pass
    return taken


def random_set(rng):
    if rng.random() < 0.5:
        return parameters(str(rng.choice(NAMES)))
    limits = bounds()
    return parameters("listed").replace(
        **{name: float(np.exp(rng.uniform(*np.log(limits[name])))) for name in SEARCHED}
    )


def random_touch(rng):
    """Times, and both pressures: few knots over ten decades of time, jumps, noise of any size, or smooth curves."""
    kind = rng.choice(["knots", "jumps", "noise", "smooth"], p=[0.4, 0.2, 0.2, 0.2])
    top = 10 ** rng.uniform(2, 5)
    if kind in ("noise", "smooth"):
        time = np.arange(rng.integers(20, 200)) * 10 ** rng.uniform(-4, -1)
        curve = top * np.sin(np.pi * time / time[-1] * rng.integers(1, 4, (2, 1))) ** 2
        size = top * 10 ** rng.uniform(-6, -0.5) if kind == "noise" else 0.0
        return time, list(curve + size * rng.normal(size=curve.shape))
    count = int(rng.integers(3, 9))
    time = np.concatenate([[0.0], np.cumsum(10 ** rng.uniform(-5, 2.2, count - 1))])
    shape = (2, 2 * count - 2 if kind == "jumps" else count)
    values = top * rng.uniform(-0.2, 1.0, shape) * 10 ** rng.uniform(-3, 0, shape) * (rng.random(shape) > 0.3)
    if kind == "knots":
        return time, list(values)
    return time, [Waveform(time_s=np.repeat(time, 2)[1:-1], pressure_pa=row) for row in values]


@pytest.mark.parametrize(
    "seeds", [range(40), pytest.param(range(40, 1040), marks=pytest.mark.slow)], ids=["some", "a thousand"]
)
def test_no_touch_needs_more_than_twenty_times_the_steps_of_radau(seeds, steps, monkeypatch):
    for seed in seeds:
        rng = np.random.default_rng(seed)
        p, (time, touch) = random_set(rng), random_touch(rng)
        given = {
            "proximal_pressure_pa": touch[0],
            "distal_pressure_pa": touch[1],
            "rtol": 10 ** rng.uniform(-7, -4),
            "start": str(rng.choice(["untouched", "steady"])),
        }
        run = respond(p, time, **given)
        assert np.all(np.isfinite(run["capillary_diameter_m"])) and np.all(run["capillary_diameter_m"] > 0.0)
        ours = steps.taken
        # The six states, restarted at each corner, are what the massless model is to replace.
        least = -(-ours // 20)
        assert radau_takes(monkeypatch, least, p, time, **given) >= least, seed


def test_a_bend_of_less_than_a_hundredth_is_no_smooth_curve(steps):
    # Both pieces are straight; to take the slope between for that of a curve takes 115116 steps.
    time, touch = np.array([0.0, 0.0189, 105.0159]), np.array([0.0, 289.0, 40842.0])
    few = respond(parameters("best"), time, proximal_pressure_pa=touch)
    assert steps.taken < 200
    grid = np.linspace(0.0, time[-1], 5558)
    many = respond(parameters("best"), grid, proximal_pressure_pa=np.interp(grid, time, touch))
    assert steps.taken < 200
    assert np.allclose(many["capillary_diameter_m"][:, -1], few["capillary_diameter_m"][:, -1], rtol=1e-6)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("field", ["capillary_damping_n_s_per_m", "vein_damping_n_s_per_m"])
def test_walls_with_hardly_any_damper_take_no_more_steps(name, field, steps):
    time = np.arange(0.0, 4.0, 1e-3)
    touch = np.where((time >= 0.5) & (time < 2.5), 9e3, 0.0)
    for damping in (1e-3, 1e-9):
        p = parameters(name).replace(**{field: damping})
        run = respond(p, time, proximal_pressure_pa=touch, distal_pressure_pa=touch)
        assert steps.taken < 600
    assert np.all(np.isfinite(run["capillary_diameter_m"]))


def test_a_step_on_a_pole_of_the_method_is_taken_shorter(monkeypatch):
    from nailoptics.hemodynamics import massless

    time = np.linspace(0.0, 4.0, 9)
    expected = respond(parameters("best"), time, proximal_pressure_pa=5e3)["capillary_diameter_m"]
    unrolled, calls = massless._unrolled(2), 0

    def often_on_a_pole(*arguments):
        nonlocal calls
        calls += 1
        # What 1 / (1/(gamma h) - d) is where h meets the rate d of a growing mode.
        return unrolled[0](*arguments) if calls % 3 else 1.0 / 0.0

    monkeypatch.setattr(massless, "_unrolled", lambda units: (often_on_a_pole, unrolled[1]))
    computed = respond(parameters("best"), time, proximal_pressure_pa=5e3)["capillary_diameter_m"]
    assert calls > 30 and np.allclose(computed, expected, rtol=2e-6)

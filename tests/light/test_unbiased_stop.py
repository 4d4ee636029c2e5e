"""A trace that stops by its own error is unbiased: exactly where all ways it can go are known, and over seeds."""

import itertools

import numpy as np
import pytest

from nailoptics.light.records import Batch, LedRecords
from nailoptics.light.tracing import StoppingRule
from nailoptics.light.unbiased_stop import batch_factors
from nailoptics.scene import Accuracy, parse_scene
from nailoptics.statistics import stderr_of_mean

PHOTONS = 1024
SCENE = parse_scene("""
schema_version = 1
[phantom]
[[phantom.layers]]
name = "slab"
thickness_mm = 2.0
mu_a_per_mm = 0.0
mu_s_per_mm = 5.0
g = 0.5
[[leds]]
name = "beam"
wavelength_nm = 800.0
pattern = "pencil"
[[photodiodes]]
name = "square"
aperture = true
position_mm = [2.0, 0.0]
""")


@pytest.mark.parametrize("needed", [2, 4])
def test_of_all_ways_that_a_coin_may_fall_the_weighed_mean_is_the_truth(needed):
    """Rationale: tossed until heads came so often, at most nine times, a coin looks better than it is.
    Expected: the mean of the tosses, weighed, over all 512 ways, each by its probability, is the coin's."""
    heads, most = 0.35, 9
    checks = [1, 2, 3, 5, 7]
    plain = weighed = 0.0
    ends = {}
    for tosses in itertools.product((0.0, 1.0), repeat=most):
        stop = next((n for n in checks if sum(tosses[:n]) >= needed), most)
        ends[tosses[:stop]] = stop
    for tosses, stop in ends.items():
        sums, before = np.array(tosses), [n for n in checks if n < stop]
        factors = batch_factors(sums, lambda total, _: total >= needed, before)
        assert factors.sum() == pytest.approx(stop)
        chance = np.prod(np.where(sums > 0, heads, 1 - heads))
        plain += chance * sums.mean()
        weighed += chance * (factors @ sums) / stop
    # Of the orders of the tosses only so many are tried.
    assert abs(weighed / heads - 1) < 0.01
    assert plain / heads - 1 > 0.05


def stopped(seed: int, *, spread: float, target: float) -> tuple[float, float, float]:
    """Departure from the truth of a run that stops at a tolerance, its error, and its plain mean's departure.

    spread : standard deviation of the logarithm of the photons' weights.
    """
    rng, probability = np.random.default_rng(seed), 0.02
    rule = StoppingRule(SCENE, 0, Accuracy(relative_error=target), np.zeros(1), full=PHOTONS)
    records, sums = LedRecords(np.zeros(1), rule.rest, seed=seed, led=0), []
    while rule.sizes() is None:
        seen = int(rng.binomial(PHOTONS, probability))
        weight = np.exp(spread * rng.normal(size=seen) - spread**2 / 2)
        batch = Batch(PHOTONS, np.zeros(seen, np.uint16), weight, np.zeros((seen, 1), np.float32), {}, 0)
        rule.add(batch)
        records.add(len(sums), batch)
        sums.append(weight.sum())
    trace = records.trace(rule.factors)
    total = trace.weight.sum()
    error = float(stderr_of_mean(total, (trace.weight**2).sum(), trace.photons)) * trace.photons / total
    assert error == pytest.approx(rule.error) and rule.shortfall() is None
    truth = probability * PHOTONS
    return total / len(sums) / truth - 1, error, float(np.mean(sums)) / truth - 1


@pytest.mark.slow
@pytest.mark.parametrize(("spread", "runs", "plain_bias"), [(0.0, 4000, 0.004), (1.5, 2400, -0.01)])
def test_a_loose_tolerance_with_few_photons_does_not_bias_a_reading(spread, runs, plain_bias):
    """Rationale: a run that stops at a tenth prefers luck: many photons of one weight, or none of the rare heavy ones.
    Expected: over seeds the reading is off by less than half a percent, its intervals cover; the plain mean is not."""
    off, error, plain = np.array([stopped(seed, spread=spread, target=0.1) for seed in range(runs)]).T
    chance = off.std() / np.sqrt(len(off))
    assert chance < 0.0025
    assert abs(off.mean()) < 0.005 and abs(off.mean()) < 3.5 * chance
    # Paired: both means see the same photons, so that their difference is known far better than either.
    assert (plain - off).mean() / plain_bias > 1
    assert abs(np.mean(np.abs(off) < 1.96 * error) - 0.95) < 0.02


def test_a_stop_at_a_small_error_counts_all_batches_alike():
    rule = StoppingRule(SCENE, 0, Accuracy(relative_error=0.015), np.zeros(1), full=PHOTONS)
    while rule.sizes() is None:
        rule.add(Batch(PHOTONS, np.zeros(900, np.uint16), np.ones(900), np.zeros((900, 1), np.float32), {}, 0))
    assert rule.factors is not None and (rule.factors == 1).all()

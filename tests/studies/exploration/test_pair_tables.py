"""The kernel between places of a board is that of the light, and what the page cannot show is refused."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from nailoptics.assets import data_dir
from nailoptics.cli import run
from nailoptics.errors import InputError
from nailoptics.light.board_map import BoardTracer
from nailoptics.light.tracing import StageProgress
from nailoptics.scene import Scene, load_scene
from nailoptics.scene.rectangles import Rectangle
from nailoptics.studies.exploration import explore as study
from nailoptics.studies.exploration.explore import BLOCKS, explore, explored_board
from nailoptics.studies.exploration.pair_table import BloodPolynomial, PairProjection, RadialFunction, pair_basis
from nailoptics.studies.placement import boards
from nailoptics.studies.prior_uncertainty import at_value

BOARD = Rectangle("board", -4.0, 4.0, -5.0, 5.0)
WALL = Rectangle("left", -0.9, -0.7, -5.0, 5.0)
RADIAL = RadialFunction(np.array([-1.0, -0.5]))


def scene() -> Scene:
    return load_scene(data_dir("scenes") / "prototype.toml")


def places(basis, rng, count):
    """Pairs of places at random, the second beyond the wall if there is one, and the area squared in which they lie."""
    low, high = np.array([BOARD.u_min, BOARD.v_min]), np.array([BOARD.u_max, BOARD.v_max])
    lows, highs = np.array([low, low]), np.array([high, high])
    if basis.wall_mm is not None:
        for k, axis in enumerate(basis.axes[:2]):
            lows[k, basis.across], highs[k, basis.across] = axis[0], axis[-1]
    x, y = (rng.uniform(one, other, (count, 2)) for one, other in zip(lows, highs, strict=True))
    return x, y, np.prod(highs - lows)


@pytest.mark.parametrize(
    "wall",
    [
        pytest.param(None, id="open", marks=pytest.mark.long),
        pytest.param(WALL, id="left"),
        pytest.param(Rectangle("above", -4.0, 4.0, 1.0, 1.2), id="above", marks=pytest.mark.slow),
    ],
)
def test_a_kernel_of_its_form_is_recovered_from_photons_drawn_from_it(wall):
    """Photons at pairs of places at random, each with the kernel's weight there."""
    basis, rng = pair_basis(BOARD, wall), np.random.default_rng(0)

    def truth(x, y):
        return RADIAL(x, y) * (1.5 + 0.1 * (x + y).sum(1) + 0.05 * np.abs(x[:, 1] - y[:, 1]))

    x, y, area2 = places(basis, rng, 200_000)
    weight = area2 / len(x) * truth(x, y)
    kernel = PairProjection(basis, RADIAL).solve(basis.matrix(x, y).T @ weight[:, None], weight=weight.mean())[:, 0]
    x, y, _ = places(basis, rng, 2000)
    result = RADIAL(x, y) * (basis.matrix(x, y) @ kernel)
    # The photons' places are random, so that their number at each pair of nodes is; their weights are exact.
    assert np.sqrt(np.mean((result / truth(x, y) - 1) ** 2)) < 0.1
    assert np.mean(result / truth(x, y)) == pytest.approx(1.0, abs=0.01)


def test_stored_tables_are_those_of_the_blood_and_photodiodes():
    """What changes the tables is traced again; what only names parts or lights them more is not."""
    plain = scene()

    def digest_of(changed, seed=0, plate=1.5):
        polynomial = BloodPolynomial((0.0, 0.1), (0.7, 1.0))
        bare = study.lit_by(boards.bare_board(explored_board(changed)), changed.leds[0])
        drawn = [(changed, polynomial), (at_value(changed, "finger.plate_absorption", plate), polynomial)]
        sums = study.WavelengthSums(bare, BoardTracer(bare, seed=seed), 0, pair_basis(BOARD, None), drawn)
        return json.dumps(study._tables_key([sums], seed), sort_keys=True)

    led, blood = plain.leds[0], plain.blood
    brighter = plain.model_copy(update={"leds": (led.model_copy(update={"flux_mw": 2 * led.flux_mw}),)})
    assert digest_of(brighter) == digest_of(plain)
    wider = led.model_copy(update={"fwhm_nm": led.fwhm_nm + 10})
    others = [plain.model_copy(update={"leds": (wider,)})]
    others += [plain.model_copy(update={"blood": blood.model_copy(update={"so2": blood.so2 - 0.1})})]
    slow = [p.model_copy(update={"quantum_efficiency": 0.5}) for p in plain.photodiodes]
    others += [plain.model_copy(update={"photodiodes": tuple(slow)})]
    assert len({digest_of(plain), digest_of(plain, 1), digest_of(plain, plate=2.0), *map(digest_of, others)}) == 6


@pytest.mark.parametrize("name", ["left", "right", "below", "above"])
def test_photons_through_a_wall_are_turned_to_go_from_leds_to_photodiodes(name):
    along = name in ("below", "above")
    wall = Rectangle(name, *((-4.0, 4.0, 1.0, 1.2) if along else (-0.9, -0.7, -5.0, 5.0)))
    basis, rng = pair_basis(BOARD, wall), np.random.default_rng(0)
    starts, arrivals = rng.uniform([-4, -5], [4, 5], (2, 1000, 2))
    axis, middle = (1, 1.1) if along else (0, -0.8)
    low = name in ("left", "below")
    passed, forth = basis.passed(starts, arrivals)
    assert (passed == ((starts[:, axis] < middle) != (arrivals[:, axis] < middle))).all()
    assert (forth == ((starts[:, axis] < middle) == low)).all()


def test_a_polynomial_in_blood_and_saturation_follows_attenuation():
    polynomial, rng = BloodPolynomial((0.0, 0.09), (0.7, 1.0)), np.random.default_rng(0)

    def reading(states):
        # At 660 nm, where oxygen matters most: 6 mm of path in the bed.
        per_blood = 0.16 + 1.4 * (1 - states[:, 2])
        return np.exp(-per_blood * (4.0 * states[:, 0] + 2.0 * states[:, 1])) * (1 - 0.2 * (1 - states[:, 2]))

    coefficients = polynomial.coefficients @ reading(polynomial.states)
    states = rng.uniform([0, 0, 0.7], [0.09, 0.09, 1.0], (1000, 3))
    assert polynomial.monomials(states) @ coefficients == pytest.approx(reading(states), rel=5e-4)


def test_the_board_that_is_explored_keeps_the_parts_and_the_wall():
    given, explored = scene(), explored_board(scene())
    assert explored.layout.leds[0].center_mm == pytest.approx(given.layout.leds[0].center_mm)
    assert explored.layout.photodiode_names == given.layout.photodiode_names
    assert explored.layout.barriers[0].u_min == pytest.approx(given.layout.barriers[0].u_min)
    assert explored.layout.outline.area_mm2 > given.layout.outline.area_mm2


def test_every_wavelength_has_the_wall_of_the_board():
    """The wall keeps its gap to the nearest of two LEDs, whichever comes first."""
    one = scene()
    u, v = one.leds[0].position_mm
    near, far = (
        one.leds[0].model_copy(update={"name": n, "position_mm": (u - d, v)}) for n, d in (("n", 0), ("f", 1.5))
    )
    for leds in ((near, far), (far, near)):
        base = explored_board(one.model_copy(update={"leds": leds}))
        for source in study.led_per_wavelength(base):
            lit = study.lit_by(boards.bare_board(base), source)
            assert lit.layout.barriers[0] == base.layout.barriers[0]
            assert {led.wavelength_nm for led in lit.leds} == {source.wavelength_nm}


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"blood": scene().blood.model_copy(update={"zones": 4})}, "two blood zones"),
        (
            {
                "leds": (
                    scene()
                    .leds[0]
                    .model_copy(
                        update={"pattern": "measured", "pattern_deg": (0.0, 90.0), "pattern_relative": (1.0, 0.0)}
                    ),
                )
            },
            "Lambertian",
        ),
    ],
    ids=["zones", "pattern"],
)
def test_what_it_cannot_show_is_refused_in_a_line(change, what):
    with pytest.raises(InputError, match=what):
        explore(scene().model_copy(update=change))
    with pytest.raises(InputError, match="photons or max_seconds"):
        explore(scene(), relative_error=0.01)


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        (["phantom", "-o", "page.html"], "needs a [finger] scene"),
        (["prototype", "-o", "page.htm"], "a page ends in .html"),
        (["prototype", "-o", "page.html", "--relative-error", "0.01"], "photons or max_seconds"),
    ],
)
def test_the_command_refuses_in_one_line(arguments, what, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run(["explore", *arguments]) == 2
    message = capsys.readouterr().err
    assert what in message
    assert message.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_the_time_left_is_estimated_from_the_first_batch_on(monkeypatch):
    """Batches of a fixed and a growing cost after 10 s of preparation, then tables; all by a clock that they turn."""
    clock, pace_s, shown = SimpleNamespace(now=0.0), 5e-6, []
    monkeypatch.setattr("nailoptics.light.tracing.stopping.time", SimpleNamespace(perf_counter=lambda: clock.now))

    def colour():
        photons = np.zeros(BLOCKS)

        def add(block, size):
            photons[block] += size
            clock.now += (size + study.PER_BATCH) * pace_s

        return SimpleNamespace(add=add, photons=photons, lit=scene(), tracer=SimpleNamespace(batch_photons=1 << 17))

    report = StageProgress(lambda p: shown.append((clock.now, p.seconds_left)))
    clock.now += 10.0
    assert study._trace([colour(), colour()], [3_000_000, 2_000_000], report, None) == ""
    end_s = clock.now + 2 * study.PER_TABLE * pace_s
    now_s, left_s = np.array(shown, float).T
    assert len(now_s) > 2 * BLOCKS and (np.abs(np.log(left_s / (end_s - now_s))) < np.log(1.5)).all()


@pytest.mark.parametrize(("pace_s", "limit_s"), [(5e-6, 60.0), (5e-5, 60.0), (5e-6, 6.0), (5e-5, 0.001)])
@pytest.mark.parametrize("table_s", [0.0, 0.1])
def test_rounds_end_with_the_time_or_with_the_first(monkeypatch, pace_s, limit_s, table_s):
    """Expected: the time is kept, tables included, and a third of it used; in no time one least batch of each group."""
    clock, sent = SimpleNamespace(now=0.0), np.zeros((2, BLOCKS))
    monkeypatch.setattr("nailoptics.light.tracing.stopping.time", SimpleNamespace(perf_counter=lambda: clock.now))

    def colour(k):
        def add(block, photons):
            sent[k, block] += photons
            clock.now += photons * pace_s

        lit = scene()
        tracer = SimpleNamespace(batch_photons=1 << 17)
        return SimpleNamespace(add=add, table=tabulate, photons=sent[k], lit=lit, tracer=tracer)

    def tabulate(projection):
        clock.now += table_s

    why = study._trace([colour(0), colour(1)], [10**8, 10**8], StageProgress(None, limit_s), None)
    assert why == f"max_seconds ended with {sent.sum():.0f} of 200000000 photons."
    clock.now += 2 * table_s
    least_s = sent.size * study.LEAST_BATCH * pace_s
    assert (sent == sent[0, 0]).all() and sent[0, 0] >= study.LEAST_BATCH
    assert min(0.3 * limit_s, least_s) <= clock.now <= max(limit_s, least_s + 3 * table_s) * 1.001

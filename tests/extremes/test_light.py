"""Light at every extreme: each case meets its analytic limit within its error, or is refused in one clear line.

Where float32 stops being enough, and what is done there:

- Depth. A walk counts depths from the top of its layer, so that 1 um under 1 m keeps its digits.
- Accumulation. Weights are summed in float64; in float32 1e9 photons would stop counting at 2^24.
- g near 0. The sampling formula loses its digits below 1e-3; there a first-order one takes its place.
- Far from the origin. Lateral places are displacements from the start, added in float64.
- A finger's mesh. Its origin is the nail's centre, so that all places lie within 30 mm, where float32 resolves 2 nm;
  a photon leaves a face by 2e-6 (1 + its largest coordinate) mm, and one that slips through an edge counts as lost.
  With ten triangles there is no finger: the grid of its regions makes a thousand at the least.
- Paths. A sum of up to 65536 steps in float32 keeps four to five digits; sums over photons are float64.
- Free paths. A uniform number has 23 bits, so none is longer than 15.9 mean ones: of light that would go farther, 1e-7
  of all, nothing is detected. A photodiode that nothing reaches reads 0 below -ln(0.05) / photons.
- Long lives. After 65536 scatterings roulette halves the photons, so that total reflection without loss ends.
"""

import json
import math
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from small_scenes import phantom
from watertight import check_watertight

import nailoptics as nail
from nailoptics import geometry
from nailoptics.errors import InputError
from nailoptics.io import to_json
from nailoptics.scene import Scene, load_scene, parse_scene
from nailoptics.statistics import stderr_of_mean

jit = pytest.mark.jit
PROTOTYPE = Path(__file__).parents[2] / "scenes" / "prototype.toml"


def stack(*layers: dict, **more) -> Scene:
    """A phantom lit by a pencil beam at the origin, with a square aperture beside it."""
    clear = {"thickness_mm": 1.0, "mu_a_per_mm": 0.0, "mu_s_per_mm": 0.0, "g": 0.0, "n": 1.0}
    named = [clear | {"name": f"layer{i}"} | layer for i, layer in enumerate(layers)]
    return parse_scene(phantom(*named, **{"photodiodes": [{"size_mm": [1.0, 1.0]}]} | more))


def energy(scene: Scene, photons: int = 200_000, seed: int = 1) -> dict[str, tuple[float, float]]:
    parts = nail.trace(scene, photons=photons, seed=seed).energy()
    assert sum(part["value"] for part in parts.values()) == pytest.approx(1, abs=1e-9)
    return {name: (part["value"], part["stderr"]) for name, part in parts.items()}


def meets(result: tuple[float, float], exact: float, floor: float = 1e-6) -> bool:
    return abs(result[0] - exact) < 4.5 * result[1] + floor


@jit
@pytest.mark.parametrize("mu_a", [0.0, 1e-6, 1e-3, 1.0, 30.0, 1000.0])
def test_absorption_alone_is_exponential(jit_backend, mu_a):
    result = energy(stack({"mu_a_per_mm": mu_a}))
    assert meets(result["transmitted"], math.exp(-mu_a)) and result["reflected"][0] == 0 and result["lost"][0] == 0


def adding_doubling(mu_a: float, mu_s: float, g: float, n: float) -> tuple[float, float]:
    iad = pytest.importorskip("iadpython")
    r, t, _, _ = iad.Sample(a=mu_s / (mu_a + mu_s), b=mu_a + mu_s, g=g, n=n, n_above=1, n_below=1, quad_pts=16).rt()
    return float(r), float(t)


@jit
@pytest.mark.parametrize(
    ("mu_a", "mu_s", "g", "n"),
    [
        (1.0, 1e-3, 0.0, 1.4),
        (0.01, 100.0, 0.0, 1.0),
        (1.0, 1000.0, 0.0, 1.4),
        (1000.0, 1000.0, 0.5, 1.4),
        (1e-3, 20.0, 0.9, 1.4),
        (0.1, 10.0, -0.9, 1.0),
        (0.1, 10.0, 1e-4, 1.0),
        (0.1, 10.0, 0.5, 2.5),
        (1e-4, 9.9999, 0.5, 1.4),  # albedo 0.99999
    ],
)
def test_slabs_from_thin_to_thick_meet_adding_doubling(jit_backend, mu_a, mu_s, g, n):
    result = energy(stack({"mu_a_per_mm": mu_a, "mu_s_per_mm": mu_s, "g": g, "n": n}), photons=60_000)
    reflected, transmitted = adding_doubling(mu_a, mu_s, g, n)
    # Sixteen quadrature angles are good to a few 1e-4.
    assert meets(result["reflected"], reflected, floor=6e-4) and meets(result["transmitted"], transmitted, floor=6e-4)


@jit
@pytest.mark.parametrize("g", [-0.99, -0.5, -1e-3, 0.0, 9.99e-4, 1.001e-3, 0.5, 0.99, 0.999])
def test_one_scattering_turns_light_by_henyey_and_greenstein(jit_backend, g):
    """Thin matched layer: of what is scattered the part (1 - g^2)/(2g) ((1+g^2)^-1/2 - (1+g)^-1) + ... goes back."""
    depth = 0.01
    result = energy(stack({"thickness_mm": 1.0, "mu_s_per_mm": depth, "g": g}), photons=1_000_000)
    cosine = np.linspace(-1, 1, 400_001)
    density = 0.5 * (1 - g * g) / (1 + g * g - 2 * g * cosine) ** 1.5
    back = float(np.trapezoid(density[cosine < 0], cosine[cosine < 0]))
    # Twice scattered light is of second order in the depth, with logarithms from light along the layer.
    assert meets(result["reflected"], back * depth, floor=4 * depth * back * depth)


@jit
@pytest.mark.parametrize("n", [1.0, 1.0001, 1.4, 2.5])
def test_a_clear_plate_reflects_by_fresnels_equations(jit_backend, n):
    single = ((n - 1) / (n + 1)) ** 2
    assert meets(energy(stack({"n": n}))["reflected"], 2 * single / (1 + single))


@jit
def test_total_reflection_keeps_light_in_and_all_of_it_leaves_in_the_end(jit_backend):
    """Nothing absorbs, n 2.5: what is trapped can only leave by scattering, as much on either side as by
    adding-doubling."""
    result = energy(stack({"mu_s_per_mm": 5.0, "n": 2.5}), photons=20_000)
    assert meets(result["reflected"], adding_doubling(1e-9, 5.0, 0.0, 2.5)[0], floor=6e-4)
    assert meets((result["reflected"][0] + result["transmitted"][0], result["lost"][1]), 1.0)
    assert max(result[end][0] for end in ("absorbed", "lost")) < 1e-9 and result["reflected"][1] < 4e-3


@jit
@pytest.mark.parametrize("thickness_mm", [1e-3, 1.0, 1000.0])
def test_layers_of_a_micrometre_and_of_a_metre(jit_backend, thickness_mm):
    result = energy(
        stack({"thickness_mm": thickness_mm, "mu_a_per_mm": 0.7 / thickness_mm, "n": 1.4}, n_above=1.4, n_below=1.4)
    )
    assert meets(result["transmitted"], math.exp(-0.7))


@jit
def test_a_micrometre_under_a_metre_keeps_its_digits(jit_backend):
    result = energy(
        stack({"thickness_mm": 1000.0}, {"thickness_mm": 1e-3, "mu_a_per_mm": 500.0}, {"thickness_mm": 1000.0})
    )
    assert meets(result["transmitted"], math.exp(-0.5)) and result["transmitted"][1] < 2e-3


@jit
def test_an_unlit_photodiode_reads_zero_below_a_limit(jit_backend):
    from nailoptics.light import read_rest

    blind = {"name": "far", "position_mm": [1e6, 0.0], "size_mm": [1.0, 1.0]}
    rest = read_rest(stack({"mu_a_per_mm": 1.0, "mu_s_per_mm": 1.0}, photodiodes=[blind]), photons=10_000)
    row = rest.readings[0]
    assert row["detected_fraction"] == 0 and (1 - row["upper_limit_95"]) ** 10_000 == pytest.approx(0.05)
    # The path of undetected light is unknown, in JSON null.
    assert all(value is None for value in json.loads(to_json(row))["mean_path_mm"].values())


@jit
def test_one_photon_is_traced_and_accounted_for(jit_backend):
    transfer = nail.trace(stack({"mu_a_per_mm": 0.1, "mu_s_per_mm": 5.0, "n": 1.4}), photons=1)
    assert transfer.photons == 1 and sum(p["value"] for p in transfer.energy().values()) == pytest.approx(1)
    with np.errstate(all="raise"):
        assert float(transfer.at().detected_fraction.sum()) >= 0


@pytest.mark.long
def test_a_billion_photons_lose_nothing_in_the_sum():
    """1e9 weights, as batches sum them: float64 loses under 1e-12; float32 alone has an error above half."""
    batch, count = 1 << 18, 1_000_000_000
    weight = np.random.default_rng(1).random(batch).astype(np.float32).astype(float)
    once, of_batch, total = math.fsum(weight), float(np.bincount(np.zeros(batch, np.uint16), weight)[0]), 0.0
    for _ in range(count // batch):
        total += of_batch
    assert total == pytest.approx(once * (count // batch), rel=1e-6)
    assert float(stderr_of_mean(total, total, count)) == pytest.approx(math.sqrt(0.25 / count), rel=0.01)


@jit
@pytest.mark.parametrize("away_mm", [1000.0, -1000.0])
def test_a_phantom_moved_a_metre_reads_the_same(jit_backend, away_mm):
    def reading(x: float) -> tuple[float, float]:
        beam, square = {"position_mm": [x, x]}, {"position_mm": [x + 2.0, x], "size_mm": [1.0, 1.0]}
        layer = {"thickness_mm": 10.0, "mu_a_per_mm": 0.05, "mu_s_per_mm": 10.0, "g": 0.9}
        rest = nail.trace(stack(layer, leds=[beam], photodiodes=[square]), photons=50_000, seed=3).at().squeeze()
        return float(rest.detected_fraction), float(rest.detected_fraction_stderr)

    # The same seed walks the same displacements, so that the two agree to rounding.
    assert reading(away_mm)[0] == pytest.approx(reading(0.0)[0], rel=1e-6)


@jit
def test_a_beam_inside_its_photodiode_and_dies_that_touch_it(jit_backend):
    """A photodiode that covers everything reads all that is reflected; one that ends at the beam, half of the rest."""
    layer = {"thickness_mm": 10.0, "mu_a_per_mm": 0.05, "mu_s_per_mm": 10.0, "g": 0.5}
    both = [
        {"name": "all", "position_mm": [0.0, 0.0], "size_mm": [1e5, 1e5]},
        {"name": "half", "position_mm": [5e4, 0.0], "size_mm": [1e5, 1e5]},
    ]
    transfer = nail.trace(stack(layer, photodiodes=both), photons=100_000)
    everything, half = transfer.at().detected_fraction.values[0]
    assert everything == pytest.approx(transfer.energy()["reflected"]["value"], rel=1e-9)
    assert half == pytest.approx(everything / 2, rel=1e-6)


def prototype_with(**tables: dict) -> Scene:
    from nailoptics.studies.model_error.explain import revised

    return revised(load_scene(PROTOTYPE), tables)


@pytest.fixture(scope="module")
def finger(chosen_jit):
    """A trace of the prototype, to be read at extreme states."""
    return nail.trace(prototype_with(), photons=400_000, seed=2)


@jit
def test_no_blood_and_much_of_it_at_both_ends_of_saturation(finger):
    """Expected: a bed without blood is brighter, where only other tissue has a saturation; much dims, and just
    beyond 797 nm, where both absorb alike, oxygenated blood a little more."""
    (none, same), (blue, red) = (
        [finger.at(blood_fraction=[blood, blood], so2=so2).detected_fraction.values for so2 in (0.0, 1.0)]
        for blood in (0.0, 0.1)
    )
    assert (finger.at(blood_fraction=[0.1, 0.1], so2=0.0).detected_fraction_stderr > 0).all()
    rest = finger.at().detected_fraction.values
    assert same == pytest.approx(none, rel=1e-3) and (none > rest).all()
    assert (rest > blue).all() and (blue > red).all() and (red > 0.8 * none).all()


@pytest.mark.long
@jit
def test_pure_blood_read_from_a_trace_at_rest_is_that_of_a_new_one(finger):
    read = finger.at(blood_fraction=[1.0, 1.0])
    fresh = nail.trace(prototype_with(blood={"rest_blood_fraction": 1.0}), photons=400_000, seed=3).at()
    error = np.hypot(read.detected_fraction_stderr, fresh.detected_fraction_stderr)
    assert (abs(read.detected_fraction - fresh.detected_fraction) < 4 * error).all()
    assert (error < 0.25 * fresh.detected_fraction).all()
    assert (read.detected_fraction < finger.at().detected_fraction).all() and (read.detected_fraction > 0).all()


@jit
def test_the_ends_of_the_spectrum_are_traced(jit_backend):
    """Expected: at 400 nm blood and melanin take what comes back at 1000 nm, to the last tenth."""
    scene, results = prototype_with(), []
    for wavelength_nm in (400.0, 1000.0):
        leds = tuple(led.model_copy(update={"wavelength_nm": wavelength_nm}) for led in scene.leds)
        transfer = nail.trace(scene.model_copy(update={"leds": leds}), photons=30_000)
        parts = transfer.energy()
        assert sum(p["value"] for p in parts.values()) == pytest.approx(1) and abs(parts["lost"]["value"]) < 1e-3
        results.append((parts["reflected"]["value"], transfer.at().detected_fraction.values))
    (blue, blue_detected), (infrared, infrared_detected) = results
    assert 0 < blue < 0.1 * infrared and (blue_detected < 0.5 * infrared_detected).all() and (blue_detected > 0).all()


@pytest.mark.long
@jit
def test_an_led_that_touches_a_photodiode_is_traced_and_bright(jit_backend):
    """Without a barrier, edge to edge: light crosses 0.45 mm of clear epoxy and back by nail and bed."""
    scene = prototype_with(board={"barrier": False})
    near = nail.trace(_led_at(scene, -0.625), photons=60_000).at().detected_fraction.max()
    far = nail.trace(scene, photons=60_000).at().detected_fraction.max()
    assert 0 < far < near < 1


def _led_at(scene: Scene, u: float) -> Scene:
    tables = scene.model_dump()
    return Scene.model_validate(tables | {"leds": tuple(led | {"position_mm": (u, 0.0)} for led in tables["leds"])})


def test_overlapping_and_empty_parts_are_refused_in_one_line():
    scene = prototype_with(board={"barrier": False})
    with pytest.raises(ValueError, match="inside"):
        _led_at(scene, -0.5)
    with pytest.raises(InputError, match=r"size_mm.*\n?") as caught:
        text = PROTOTYPE.read_text(encoding="utf-8").replace(
            'part = "led_800"', 'part = "led_800"\nsize_mm = [0.0, 0.25]'
        )
        parse_scene(text)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("layer", "field"),
    [
        ({"thickness_mm": 0.0}, "thickness_mm"),
        ({"mu_a_per_mm": -1e-9}, "mu_a_per_mm"),
        ({"mu_s_per_mm": math.nan}, "mu_s_per_mm"),
        ({"g": 1.0}, "g"),
        ({"n": 0.99}, "n"),
    ],
)
def test_layers_beyond_physics_are_refused_in_one_line(layer, field):
    with pytest.raises(InputError, match=rf"layers\[0\]\.{field}") as caught:
        stack(layer)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.slow
@pytest.mark.parametrize(("resolution", "least"), [(0.1, 1000), (9.2, 1_000_000)])
def test_meshes_from_coarse_to_a_million_triangles_are_closed(resolution, least):
    shape = geometry.build(prototype_with(), resolution=resolution)
    assert len(shape.triangles) >= least
    assert check_watertight(shape, crossings=20_000).disagreements <= 20


@jit
@pytest.mark.slow
def test_readings_do_not_depend_on_the_resolution_of_the_mesh(jit_backend, monkeypatch):
    """A million triangles in place of ten thousand: the same readings within the error, and nothing more lost."""
    from nailoptics.light.walk import finger as finger_walk

    scene, build = prototype_with(), geometry.build
    result = []
    for resolution, seed in ((1.0, 1), (9.0, 2)):
        monkeypatch.setattr(geometry, "build", partial(build, resolution=resolution))
        finger_walk.built.cache_clear()
        tracer = finger_walk.FingerTracer(scene)
        batch = tracer.batch(0, photons=250_000, seed=seed)
        assert batch.energy["lost"][0] < 1e-4 * batch.photons
        total, square = batch.weight.sum(), (batch.weight**2).sum()
        result.append((total / batch.photons, float(stderr_of_mean(total, square, batch.photons))))
    finger_walk.built.cache_clear()
    (one, error), (other, more) = result
    assert abs(one - other) < 4 * math.hypot(error, more) and error < 0.05 * one

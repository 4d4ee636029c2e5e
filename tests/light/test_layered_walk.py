"""The walk through phantoms against adding-doubling, published tables, closed forms, and itself."""

import iadpython
import numpy as np
import pytest
from scipy import special, stats
from small_scenes import phantom

import nailoptics as nail
from nailoptics.light.walk import sampling
from nailoptics.light.walk.layered import LayeredTracer, arc_share, walk_layers
from nailoptics.light.walk.sampling import TOP
from nailoptics.scene import Led, Scene, parse_scene
from nailoptics.statistics import seed_of

pytestmark = pytest.mark.jit
SQUARE = {"size_mm": [1.0, 1.0]}
INF = float("inf")


def layer(*, thickness: float, mu_a: float, mu_s: float, g: float = 0.0, n: float = 1.0) -> dict[str, float]:
    return {"thickness_mm": thickness, "mu_a_per_mm": mu_a, "mu_s_per_mm": mu_s, "g": g, "n": n}


def die(u: float, v: float, size: float) -> dict:
    return {"pattern": "lambertian", "position_mm": [u, v], "size_mm": [size, size]}


def stack(*layers: dict[str, float], led: dict | None = None, **more) -> Scene:
    """A phantom of layers named l0, l1 and so on from the top down."""
    named = [{"name": f"l{i}"} | values for i, values in enumerate(layers)]
    return parse_scene(phantom(*named, leds=[{"name": "led"} | (led or {})], **more))


def slab(*, a: float, b: float, g: float, n: float, **more) -> Scene:
    """A slab of albedo a and optical thickness b, 1 mm^-1 of extinction."""
    return stack(layer(thickness=b, mu_a=round(1 - a, 12), mu_s=a, g=g, n=n), **more)


def reflected_transmitted(scene: Scene, *, photons: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Fractions reflected and transmitted, (2,) float, and their standard errors."""
    energy = nail.trace(scene, photons=photons, seed=seed).energy()
    parts = [energy["reflected"], energy["transmitted"]]
    return np.array([p["value"] for p in parts]), np.array([p["stderr"] for p in parts])


def reading(scene: Scene, *, photons: int, seed: int = 1):
    return nail.trace(scene, photons=photons, seed=seed).at().squeeze()


def agree(a, b, *, within: float = 3.5) -> bool:
    """Whether two (value, standard error) pairs agree."""
    return bool(np.all(abs(np.subtract(a[0], b[0])) < within * np.hypot(a[1], b[1])))


# a, b, g, n, R, T of slabs in air. Rows 1 and 2: van de Hulst 1980 and Giovanelli 1955 as quoted by Wang, Jacques,
# Zheng 1995 (MCML); the others by adding-doubling. The last digit's half is what they are uncertain by.
PUBLISHED = [
    (0.9, 2.0, 0.75, 1.0, 0.09739, 0.66096),
    (0.9, INF, 0.0, 1.5, 0.2600, 0.0),
    (0.9, 2.0, 0.0, 1.0, 0.361649, 0.356501),
    (0.99, 10.0, 0.9, 1.0, 0.247628, 0.589082),
    (0.9, 2.0, 0.75, 1.4, 0.116213, 0.527025),
    (0.99, 10.0, 0.0, 1.4, 0.621879, 0.102603),
]


@pytest.mark.parametrize(("a", "b", "g", "n", "reflected", "transmitted"), PUBLISHED)
def test_slabs_meet_published_tables(jit_backend, a, b, g, n, reflected, transmitted):
    """Expected: within 3 standard errors, which are below 0.3 % of the value, plus what rounding took."""
    value, stderr = reflected_transmitted(slab(a=a, b=b, g=g, n=n), photons=1 << 21)
    exact = np.array([reflected, transmitted])
    assert np.all(abs(value - exact) < 3 * stderr + 2e-5)
    # Of light that none of two million photons showed, the error is that of its upper limit.
    assert np.all(stderr < 0.003 * exact + 1e-6)


@pytest.mark.long
def test_slabs_meet_adding_doubling_over_a_grid(jit_backend):
    """Rationale: the corners of the table, thin and thick, forward and backward, dim and bright, each tested at once.
    Expected: z-scores over all of them like a normal's: none beyond 4.2 (1 in 300 for 120), mean square near 1."""
    scores, errors = [], []
    for a in (0.3, 0.9, 0.99, 0.9999):
        for g in (-0.5, 0.0, 0.8):
            for n in (1.0, 1.5):
                for b in (0.2, 1.0, 8.0):
                    exact = np.array(iadpython.Sample(a=a, b=b, g=g, n=n, quad_pts=20).rt()[:2])
                    value, stderr = reflected_transmitted(slab(a=a, b=b, g=g, n=n), photons=1 << 17)
                    scores.append((value - exact) / stderr)
                    errors.append(stderr)
    z = np.concatenate(scores)
    assert np.max(errors) < 0.0015
    assert np.abs(z).max() < 4.2
    # R and T of a bright slab are one number, so that fewer are independent; 5 sigma of 72.
    assert 1 - 5 * np.sqrt(2 / 72) < np.mean(z**2) < 1 + 5 * np.sqrt(2 / 72)


def test_a_photodiode_sized_reading_meets_mesh_and_plain_monte_carlo(jit_backend):
    """Reference: 8.977(9)e-3 through the square and mean path 6.098(3) mm, R .521588, T .015927, by two codes each."""
    scene = stack(layer(thickness=10.0, mu_a=0.05, mu_s=10.0, g=0.9), photodiodes=[SQUARE])
    transfer = nail.trace(scene, photons=1 << 20, seed=3)
    read, energy = transfer.at().squeeze(), transfer.energy()
    assert read.detected_fraction_stderr < 0.003 * read.detected_fraction
    assert agree((read.detected_fraction, read.detected_fraction_stderr), (8.977e-3, 0.009e-3), within=3)
    assert agree((read.mean_path_mm, read.mean_path_mm_stderr), (6.098, 0.003), within=3)
    for part, exact in (("reflected", 0.521588), ("transmitted", 0.015927)):
        assert abs(energy[part]["value"] - exact) < 3 * energy[part]["stderr"] < 0.03 * exact


@pytest.mark.parametrize(
    "scene",
    [
        slab(a=0.9, b=2.0, g=0.75, n=1.4),
        slab(a=0.9999, b=50.0, g=0.0, n=1.5),
        stack(
            layer(thickness=0.5, mu_a=3.0, mu_s=1.0, n=1.5), layer(thickness=INF, mu_a=0.001, mu_s=8.0, g=0.9, n=1.37)
        ),
    ],
    ids=["dim", "bright", "layers"],
)
def test_energy_is_accounted_for(jit_backend, scene):
    energy = nail.trace(scene, photons=1 << 16, seed=1).energy()
    assert sum(part["value"] for part in energy.values()) == pytest.approx(1, abs=1e-9)
    assert abs(energy["lost"]["value"]) <= 4 * energy["lost"]["stderr"] + 1e-12
    assert abs(energy["lost"]["value"]) < 1e-5


@pytest.mark.parametrize("n", [1.0, 1.5])
def test_what_does_not_absorb_gives_all_light_back(jit_backend, n):
    energy = nail.trace(stack(layer(thickness=5.0, mu_a=0.0, mu_s=4.0, g=0.5, n=n)), photons=1 << 17, seed=1).energy()
    assert energy["reflected"]["value"] + energy["transmitted"]["value"] == pytest.approx(1, abs=1e-12)
    assert energy["absorbed"]["value"] == pytest.approx(0, abs=1e-12) and energy["lost"]["value"] == 0


def test_very_long_lives_end_without_bias(jit_backend):
    """Rationale: between total reflection and no absorption some photons scatter hundreds of thousands of times, and
    roulette ends those. Expected: all the light comes back on average, though single photons are worth 0 or 2."""
    scene = stack(layer(thickness=INF, mu_a=0.0, mu_s=10.0, g=0.0, n=1.5))
    energy = nail.trace(scene, photons=1 << 12, seed=1).energy()
    assert energy["lost"]["stderr"] > 0
    assert abs(energy["lost"]["value"]) < 4 * energy["lost"]["stderr"]
    assert abs(energy["reflected"]["value"] - 1) < 4 * energy["reflected"]["stderr"]


def test_a_layer_cut_in_three_is_the_same_layer(jit_backend):
    optics = {"mu_a": 0.1, "mu_s": 10.0, "g": 0.8, "n": 1.4}
    whole = nail.trace(stack(layer(thickness=3.0, **optics), photodiodes=[SQUARE]), photons=1 << 19, seed=1)
    parts = [layer(thickness=t, **optics) for t in (0.4, 0.001, 2.599)]
    cut = nail.trace(stack(*parts, photodiodes=[SQUARE]), photons=1 << 19, seed=2)
    for part in ("reflected", "transmitted", "absorbed"):
        a, b = whole.energy()[part], cut.energy()[part]
        assert agree((a["value"], a["stderr"]), (b["value"], b["stderr"]))
    one, three = whole.at().squeeze(), cut.at().squeeze()
    assert agree(
        (one.detected_fraction, one.detected_fraction_stderr), (three.detected_fraction, three.detected_fraction_stderr)
    )
    path = three.mean_path_mm.sum()
    assert agree((one.mean_path_mm, one.mean_path_mm_stderr), (path, np.linalg.norm(three.mean_path_mm_stderr)))
    assert one.mean_path_mm_stderr < 0.01 * one.mean_path_mm


@pytest.mark.parametrize("depth", [0.0, 10.0, 1000.0])
def test_a_thin_layer_far_down_absorbs_exactly(jit_backend, depth):
    """Ten micrometres of 100 mm^-1 pass exp(-1) of a beam, however deep; ray epsilons of a mesh take 15 % off there."""
    above = [layer(thickness=depth, mu_a=0.0, mu_s=0.0)] if depth else []
    value, stderr = reflected_transmitted(stack(*above, layer(thickness=0.01, mu_a=100.0, mu_s=0.0)), photons=1 << 18)
    assert abs(value[1] - np.exp(-1)) < 3.5 * stderr[1] and stderr[1] < 0.002
    assert value[0] == 0


def test_fresnel_alone_gives_a_clear_plates_reflectance(jit_backend):
    """A clear plate of n 1.5 in air reflects 2 r / (1 + r) with r = 0.04, all orders of its ghosts together."""
    value, stderr = reflected_transmitted(stack(layer(thickness=1.0, mu_a=0.0, mu_s=0.0, n=1.5)), photons=1 << 18)
    assert abs(value[0] - 0.08 / 1.04) < 3.5 * stderr[0] and stderr[0] < 0.01 * value[0]
    assert value.sum() == pytest.approx(1, abs=1e-12)


@pytest.mark.long
def test_an_infinite_layer_is_a_very_thick_one(jit_backend):
    optics = {"mu_a": 0.05, "mu_s": 10.0, "g": 0.9, "n": 1.4}
    endless = reading(stack(layer(thickness=INF, **optics), photodiodes=[SQUARE]), photons=1 << 19, seed=1)
    thick = reading(stack(layer(thickness=100.0, **optics), photodiodes=[SQUARE]), photons=1 << 19, seed=2)
    for name in ("detected_fraction", "mean_path_mm"):
        assert agree((endless[name], endless[f"{name}_stderr"]), (thick[name], thick[f"{name}_stderr"]))
    assert endless.detected_fraction_stderr < 0.006 * endless.detected_fraction


@pytest.mark.parametrize("n_above", [1.0, 1.5])
def test_a_lambertian_die_through_an_absorbing_layer_meets_its_integral(jit_backend, n_above):
    """Without scattering a layer passes 2 E3(b) of diffuse light (matched), or the integral with Fresnel's law."""
    b, n = 0.7, 1.5
    value, stderr = reflected_transmitted(
        stack(layer(thickness=b, mu_a=1.0, mu_s=0.0, n=n), led=die(0.0, 0.0, 0.25), n_above=n_above, n_below=n),
        photons=1 << 19,
    )
    if n_above == n:
        exact = 2 * special.expn(3, b)
    else:
        cos = (np.arange(200_000) + 0.5) / 200_000
        inside = np.sqrt(1 - (1 - cos**2) * (n_above / n) ** 2)
        s = (n_above * cos - n * inside) / (n_above * cos + n * inside)
        p = (n_above * inside - n * cos) / (n_above * inside + n * cos)
        exact = np.mean(2 * cos * (1 - (s**2 + p**2) / 2) * np.exp(-b / inside))
    assert abs(value[1] - exact) < 3.5 * stderr[1] and stderr[1] < 0.003 * exact


@pytest.mark.jit
@pytest.mark.parametrize("power", [1, 10, 60])
def test_a_narrow_pattern_has_no_wide_tail(jit_backend, power):
    """Expected: the mean cosine of cos^n is (n + 1) / (n + 2), and beyond 45 degrees there is 2^-(n + 1)/2 of it."""
    degrees = np.linspace(0.0, 90.0, 181)
    relative = np.cos(np.radians(degrees)) ** power
    led = Led(
        name="a",
        position_mm=(0, 0),
        wavelength_nm=800.0,
        pattern="measured",
        pattern_deg=degrees,
        pattern_relative=relative,
    )
    table = sampling.mi.Float(sampling.emission_table(led))
    u = (np.arange(1_000_000) + 0.5) / 1e6
    cos = np.array(sampling.emission_cosine(table, sampling.mi.Float(u))).astype(float)
    assert cos.mean() == pytest.approx((power + 1) / (power + 2), abs=1e-4)
    assert (cos < np.sqrt(0.5)).mean() == pytest.approx(0.5 ** ((power + 1) / 2), abs=1e-4)


def test_a_measured_pattern_meets_its_integral(jit_backend):
    """Intensity as cos^2 without scattering: a layer of optical thickness b passes 3 E4(b)."""
    degrees = np.arange(0, 91)
    relative = (np.cos(np.radians(degrees)) ** 2).tolist()
    pattern = {"pattern": "measured", "pattern_deg": degrees.tolist(), "pattern_relative": relative}
    value, stderr = reflected_transmitted(stack(layer(thickness=0.7, mu_a=1.0, mu_s=0.0), led=pattern), photons=1 << 19)
    exact = 3 * special.expn(4, 0.7)
    assert abs(value[1] - exact) < 3.5 * stderr[1] + 1e-4 and stderr[1] < 0.003 * exact


@pytest.mark.parametrize("n", [1.0, 1.4])
def test_a_lambertian_die_on_a_scattering_slab_meets_adding_doubling(jit_backend, n):
    exact = np.array(iadpython.Sample(a=0.95, b=3.0, g=0.6, n=n, quad_pts=20).rt()[2:])
    value, stderr = reflected_transmitted(slab(a=0.95, b=3.0, g=0.6, n=n, led=die(1.0, -2.0, 0.5)), photons=1 << 19)
    assert np.all(abs(value - exact) < 3.5 * stderr) and np.all(stderr < 0.005 * exact)


def test_arc_share_is_what_counting_azimuths_gives():
    rng = np.random.default_rng(5)
    azimuth = 2 * np.pi * (np.arange(20_000) + 0.5) / 20_000
    ring = np.stack([np.cos(azimuth), np.sin(azimuth)], -1)
    partial = 0
    for _ in range(200):
        low, size = rng.uniform(-2, 2, 2), rng.uniform(0.05, 2, 2)
        x0, y0, x1, y1 = *low, *(low + size)
        start, radius = rng.uniform(-2, 2, (1, 2)), rng.uniform(0, 2.5)
        at = start + radius * ring
        inside = (at[:, 0] > x0) & (at[:, 0] < x1) & (at[:, 1] > y0) & (at[:, 1] < y1)
        share = arc_share(np.array([[0.0, radius]]), start, (x0, x1, y0, y1))
        # Each of up to eight crossings of the rectangle's edge is counted to one azimuth of 20 000.
        assert share[0] == pytest.approx(inside.mean(), abs=8 / 20_000)
        partial += 0 < share[0] < 1
    assert partial > 40


def test_arc_share_of_corner_cases_is_exact():
    origin, square = np.zeros((1, 2)), (-1.0, 1.0, -1.0, 1.0)
    for radius, share in ((0.0, 1.0), (0.5, 1.0), (1.0, 1.0), (np.sqrt(2) + 1e-9, 0.0), (5.0, 0.0)):
        assert arc_share(np.array([[radius, 0.0]]), origin, square)[0] == pytest.approx(share, abs=1e-7)
    # A quarter plane, and a start on the edge of a half plane.
    assert arc_share(np.array([[1.0, 0.0]]), origin, (0.0, 9.0, 0.0, 9.0))[0] == pytest.approx(0.25, abs=1e-12)
    assert arc_share(np.array([[1.0, 0.0]]), origin, (0.0, 9.0, -9.0, 9.0))[0] == pytest.approx(0.5, abs=1e-12)


@pytest.mark.parametrize(
    ("led", "center"),
    [
        ({}, (0.0, 0.0)),
        (die(0.3, -0.2, 0.8), (0.3, -0.1)),
        (die(-1.0, 0.5, 0.25), (0.5, 0.2)),
    ],
    ids=["square around the beam", "square over the die", "square beside the die"],
)
def test_a_square_detects_what_counting_exits_in_it_gives(jit_backend, led, center):
    """Rationale: readings average over azimuth, which takes a symmetry for granted; counting takes nothing.
    Expected: equal within errors, of the same photons."""
    square = SQUARE | {"position_mm": list(center)}
    scene = stack(layer(thickness=2.0, mu_a=0.1, mu_s=5.0, g=0.7, n=1.4), led=led, photodiodes=[square])
    photons = 1 << 19
    walked, start, shift = walk_layers(scene.phantom, scene.leds[0], photons=photons, seed=11)
    at = start + shift - center
    inside = (walked.outcome == TOP) & (abs(at) < 0.5).all(axis=1)
    counted = np.where(inside, walked.weight, 0.0)
    batch = LayeredTracer(scene).batch(0, photons=photons, seed=11)
    stderr = counted.std() / np.sqrt(photons)
    assert abs(batch.weight.sum() / photons - counted.mean()) < 3.5 * stderr < 0.05 * counted.mean()


def test_each_layer_absorbs_by_lamberts_law(jit_backend):
    """Light that nothing scatters loses 1 - exp(-mu_a d) of itself in each layer; the parts make up all of it."""
    first, second = layer(thickness=2.0, mu_a=0.4, mu_s=0.0), layer(thickness=3.0, mu_a=0.2, mu_s=0.0)
    result = nail.trace(stack(first, second, photodiodes=[SQUARE]), photons=1 << 18, seed=3)
    absorbed = result.absorbed()["led"]
    for name, exact in (("l0", 1 - np.exp(-0.8)), ("l1", np.exp(-0.8) - np.exp(-1.4))):
        assert abs(absorbed[name]["value"] - exact) < 4 * absorbed[name]["stderr"] < 0.01 * exact
    assert sum(one["value"] for one in absorbed.values()) == pytest.approx(
        result.energy()["absorbed"]["value"], abs=1e-12
    )
    assert abs(result.energy()["lost"]["value"]) < 1e-12


def test_photodiodes_at_one_distance_report_that_they_share_their_error(jit_backend):
    beside = SQUARE | {"name": "beside", "position_mm": [0.0, 2.0]}
    slab = layer(thickness=10.0, mu_a=0.05, mu_s=10.0, g=0.9)
    read = reading(stack(slab, photodiodes=[SQUARE, beside]), photons=1 << 16)
    assert read.detected_fraction[0] == pytest.approx(float(read.detected_fraction[1]), rel=1e-6)
    assert "Transfer.covariance" in read.detected_fraction_stderr.attrs["comment"]
    alone = reading(stack(slab, photodiodes=[SQUARE]), photons=1 << 12)
    assert "comment" not in alone.detected_fraction_stderr.attrs


def test_averaging_over_azimuth_sharpens_a_distant_reading(jit_backend):
    scene = stack(layer(thickness=10.0, mu_a=0.05, mu_s=10.0, g=0.9), photodiodes=[SQUARE])
    read = reading(scene, photons=1 << 17)
    analog = np.sqrt(read.detected_fraction / (1 << 17))
    assert read.detected_fraction_stderr < 0.5 * analog


def test_the_same_seed_gives_the_same_bits_and_another_one_others(jit_backend):
    scene = stack(layer(thickness=1.0, mu_a=0.1, mu_s=10.0, g=0.9, n=1.4), photodiodes=[SQUARE])
    first, again, other = (nail.trace(scene, photons=30_001, seed=seed).traces[0] for seed in (1, 1, 2))
    for name in ("photodiode", "weight", "path_mm"):
        assert getattr(first, name).tobytes() == getattr(again, name).tobytes()
    assert first.energy == again.energy and first.seeds == again.seeds
    assert first.weight.tobytes() != other.weight.tobytes()
    assert first.seeds != other.seeds


def test_photons_of_a_batch_and_batches_of_a_seed_are_independent(jit_backend):
    """Expected: no correlation between what photons i and i + k became, nor between photons i of two batches, whichever
    bits of their seeds differ."""
    scene = slab(a=0.9, b=2.0, g=0.0, n=1.0)
    seeds = seed_of(7, 0, 0), seed_of(7, 0, 1), 1, 2, 1 + (1 << 32), 1 + (1 << 63)
    batches = [
        (walk_layers(scene.phantom, scene.leds[0], photons=1 << 18, seed=seed)[0].outcome == TOP) - 0.36
        for seed in seeds
    ]
    one, count = batches[0], len(batches[0])
    for k in (1, 2, 1023, 1024, 1025, 4096, 8191, 8192, 8193, 16384):
        assert abs(np.corrcoef(one[:-k], one[k:])[0, 1]) < 4 / np.sqrt(count)
    assert np.all(np.abs(np.corrcoef(batches) - np.eye(len(seeds))) < 4 / np.sqrt(count))


@pytest.mark.slow
def test_standard_errors_are_calibrated(jit_backend):
    """Rationale: a tolerance is worth what the standard error is worth; a heavy tail would make it lie.
    Expected: z-scores of 200 small runs against the reading of many photons are standard normal."""
    scene = stack(layer(thickness=10.0, mu_a=0.05, mu_s=10.0, g=0.9), photodiodes=[SQUARE])
    truth = reading(scene, photons=1 << 21, seed=1000)
    scores = {"detected_fraction": [], "mean_path_mm": [], "derivative_mm": []}
    for seed in range(200):
        small = reading(scene, photons=1 << 14, seed=seed)
        for name, z in scores.items():
            spread = np.hypot(small[f"{name}_stderr"], truth[f"{name}_stderr"])
            z.append(float((small[name] - truth[name]) / spread))
    for name, z in scores.items():
        assert stats.kstest(z, "norm").pvalue > 1e-3, name
        assert 1e-3 < stats.chi2(len(z)).cdf(np.sum(np.square(z))) < 1 - 1e-3, name

"""The stock volpath engine against adding-doubling, published readings, and itself."""

from dataclasses import replace

import numpy as np
import pytest
from colour.colorimetry import SpectralShape, sd_gaussian_fwhm
from small_scenes import PLAIN_FINGER, phantom

from nailoptics import geometry
from nailoptics.errors import InputError
from nailoptics.light import backend
from nailoptics.light.optics import finger_media
from nailoptics.light.reference import mitsuba_scene, readings
from nailoptics.light.reference.mitsuba_scene import EVERYTHING, LEAVING, BedAbsorption, Window
from nailoptics.options import TraceOptions
from nailoptics.scene import Led, parse_scene
from nailoptics.statistics import seed_of

# Dermis, measured by Shimojo (mu_a), and reduced scattering 4.6 (lambda / 500)^-1.421 (Jacques 2013). [mm^-1]
DERMIS = {660.0: (0.065, 3.10), 800.0: (0.050, 2.36), 940.0: (0.066, 1.88)}
SQUARE = {"position_mm": [2.0, 0.0], "size_mm": [1.0, 1.0]}
THROUGH_SQUARE = [Window((2.0, 0.0), (1.0, 1.0))]


@pytest.fixture(scope="module")
def jit_backend():
    """A backend that compiles this engine's kernels; without one the test is skipped, with the reason."""
    chosen = backend.choose("auto", volpath=True)
    if not chosen.jit:
        pytest.skip(f"no JIT backend works here: {chosen.why}")
    return chosen


@pytest.fixture(params=[pytest.param("jit", marks=pytest.mark.jit), "scalar"])
def engine(request):
    """Each kind of backend in turn."""
    return backend.choose("scalar") if request.param == "scalar" else request.getfixturevalue("jit_backend")


def slab(*, mu_a, mu_s, g, n, thickness=1.0, n_below=1.0, led=None, photodiodes=()):
    layer = {"thickness_mm": thickness, "mu_a_per_mm": mu_a, "mu_s_per_mm": mu_s, "g": g, "n": n}
    return parse_scene(phantom(layer, leds=[led or {}], photodiodes=photodiodes, n_below=n_below))


def fractions(scene, windows, *, batches, paths, seed, backend):
    """The fraction of the LED's power through each window, (batches, windows) float."""
    with readings.stock_mitsuba(backend, readings.SPECTRAL):
        traced = readings.phantom_paths(scene, windows, backend=backend)
        return np.stack([traced.batch(paths=paths, seed=seed_of(seed, k)) for k in range(batches)])


def statistics(batches):
    return batches.mean(axis=0), batches.std(axis=0, ddof=1) / np.sqrt(len(batches))


@pytest.mark.parametrize("n", [1.0, 1.4])
@pytest.mark.parametrize("wavelength", [660.0, *(pytest.param(nm, marks=pytest.mark.slow) for nm in (800.0, 940.0))])
def test_a_slab_at_each_wavelength_meets_adding_doubling(wavelength, n, engine):
    """R and T of 1 mm of dermis under a beam, index-matched and not."""
    iadpython = pytest.importorskip("iadpython")
    mu_a, reduced = DERMIS[wavelength]
    g = 0.8
    mu_s = reduced / (1 - g)
    exact = iadpython.Sample(a=mu_s / (mu_a + mu_s), b=mu_a + mu_s, g=g, n=n, quad_pts=20).rt()[:2]
    scene = slab(mu_a=mu_a, mu_s=mu_s, g=g, n=n, led={"wavelength_nm": wavelength})
    batches = fractions(scene, LEAVING, batches=16, paths=4096, seed=1, backend=engine)
    mean, stderr = statistics(batches)
    assert np.all(abs(mean - exact) < 4 * stderr)
    assert np.all(stderr < 0.01 * mean)


def test_a_lambertian_die_meets_adding_doubling(engine):
    """R and T of diffuse light from a die that lies on the slab, which proves the die's factor of pi."""
    iadpython = pytest.importorskip("iadpython")
    exact = iadpython.Sample(a=0.99, b=10, g=0.8, n=1.4, quad_pts=20).rt()[2:]
    scene = slab(mu_a=0.1, mu_s=9.9, g=0.8, n=1.4, led={"pattern": "lambertian", "size_mm": [0.25, 0.25]})
    batches = fractions(scene, LEAVING, batches=16, paths=4096, seed=2, backend=engine)
    mean, stderr = statistics(batches)
    assert np.all(abs(mean - exact) < 4 * stderr)
    assert np.all(stderr < 0.01 * mean)


@pytest.mark.parametrize("led", [{}, {"pattern": "lambertian", "size_mm": [0.5, 0.5]}])
def test_without_absorption_all_light_comes_out(led, engine):
    """R + T = 1 path by path, also where the index below differs: radiance over n squared is what is reciprocal."""
    scene = slab(mu_a=0.0, mu_s=8.0, g=0.5, n=1.5, n_below=1.33, led=led)
    batches = fractions(scene, LEAVING, batches=2, paths=4096, seed=3, backend=engine)
    assert np.allclose(batches.sum(axis=1), 1, atol=1e-3)
    assert np.all(batches > 0.1)


def test_three_blood_states_of_one_medium_meet_adding_doubling(engine):
    """The colours of one path are three absorptions: R of each state on its own, from the grid that carries the bed."""
    iadpython = pytest.importorskip("iadpython")
    states, mu_s, g = np.array([0.05, 0.1, 0.2]), 12.0, 0.8
    exact = [iadpython.Sample(a=mu_s / (m + mu_s), b=m + mu_s, g=g, n=1.4, quad_pts=20).rt()[0] for m in states]
    with readings.stock_mitsuba(engine) as mi:
        scene = slab(mu_a=0.05, mu_s=mu_s, g=g, n=1.4)
        made = mitsuba_scene.phantom_scene(mi, scene.phantom, scene.leds[0], [Window((0.0, 0.0), EVERYTHING)])
        bed = BedAbsorption(np.array([-80.0, 0.0, 80.0]), np.repeat(states[:, None], 3, axis=1))
        box = np.array([[-80.0, -80, -1.2], [80, 80, 0.2]])
        made["medium_0"] = mitsuba_scene.bed_medium(mi, bed, mu_s=mu_s, g=g, bounds_mm=box)
        made["window_0"]["emitter"] = mitsuba_scene.emitter([1.0, 1.0, 1.0])
        loaded = mi.load_dict(made, optimize=False)
        batches = np.stack([readings._render(mi, loaded, paths=4096, seed=seed) for seed in range(12)])
    mean, stderr = statistics(batches)
    assert np.all(abs(mean - exact) < 4 * stderr)
    assert np.all(stderr < 0.01 * mean)


@pytest.mark.long
@pytest.mark.jit
@pytest.mark.parametrize("along_y", [False, True])
def test_a_line_is_read_wavelength_by_wavelength(along_y, jit_backend):
    """Expected: a slab whose absorption grows and whose scattering falls along a line reflects the mean of
    adding-doubling over the line, by colour-science; not what it has at the peak, nor with a tenth more absorption."""
    iadpython = pytest.importorskip("iadpython")
    led = Led(name="line", wavelength_nm=800.0, fwhm_nm=40.0, position_mm=(0.0, 0.0), pattern="pencil")
    nm, g = mitsuba_scene.line_wavelengths_nm(led), 0.8
    mu_a, mu_s = 0.1 * np.exp((nm - 800) / 20), 12.0 * (800 / nm) ** 2

    def exact(mu_a):
        albedo, depth = mu_s / (mu_a + mu_s), mu_a + mu_s
        each = [iadpython.Sample(a=a, b=b, g=g, n=1.4, quad_pts=20).rt()[0] for a, b in np.stack([albedo, depth], -1)]
        return np.average(each, weights=sd_gaussian_fwhm(800, 40, SpectralShape(740, 860, 3)).values)

    assert np.allclose(nm, np.arange(740, 861, 3))
    scene = slab(mu_a=0.1, mu_s=12.0, g=g, n=1.4)
    with readings.stock_mitsuba(jit_backend, readings.SPECTRAL) as mi:
        made = mitsuba_scene.phantom_scene(mi, scene.phantom, led, [Window((0.0, 0.0), EVERYTHING)])
        bed = BedAbsorption(np.array([-80.0, 0.0, 80.0]), np.tile(mu_a, (1, 3, 1)))
        box = np.array([[-80.0, -80, -1.2], [80, 80, 0.2]])
        made["medium_0"] = mitsuba_scene.medium(mu_a=mu_a, mu_s=mu_s, g=g)
        if along_y:
            made["medium_0"] = mitsuba_scene.bed_medium(mi, bed, mu_s=mu_s, g=g, bounds_mm=box)
        made["window_0"]["emitter"] = mitsuba_scene.emitter([1.0, 1.0, 1.0, 0.5])
        loaded = mi.load_dict(mitsuba_scene.spectral(made), optimize=False)
        batches = np.stack([readings._render(mi, loaded, paths=8192, seed=seed) for seed in range(12)])
    mean, stderr = statistics(batches)
    assert np.all(abs(mean * [1, 1, 1, 2] - exact(mu_a)) < 4 * stderr * [1, 1, 1, 2])
    pooled, spread = statistics((batches * [1, 1, 1, 2]).mean(1))
    for wrong in (np.full_like(mu_a, 0.1), 1.1 * mu_a):
        assert abs(pooled - exact(wrong)) > 4 * spread
    # The four wavelengths of a path are the same place of the line, so that channels hardly differ.
    assert np.ptp(batches[:, :3], axis=1).max() < 1e-3 * pooled


@pytest.mark.jit
def test_absorption_by_place_and_channel_is_that_of_the_table(jit_backend):
    """Read back from the medium's volume, between the nodes in place and at those in wavelength."""
    rng, v = np.random.default_rng(1), np.linspace(-6.0, 6.0, 25)
    states = rng.uniform(0.1, 0.3, (3, 25, mitsuba_scene.LINE_POINTS))
    with readings.stock_mitsuba(jit_backend, readings.SPECTRAL) as mi:
        box = np.array([[-5.0, -5, -9], [5, 5, 0]])
        made = mitsuba_scene.bed_medium(mi, BedAbsorption(v, states), mu_s=20.0, g=0.9, bounds_mm=box)
        for y, node in ((3.33, 7), (-4.87, 40)):
            point = mi.Interaction3f()
            point.p = mi.Point3f(0, y, -1)
            point.wavelengths = mitsuba_scene.AXIS_START + node + mitsuba_scene.LINE_POINTS * np.arange(4.0)
            expected = [np.interp(y, v, state[:, node]) for state in (*states, states[-1])]
            total, share = (np.ravel(made[name].eval(point)) for name in ("sigma_t", "albedo"))
            assert np.allclose(total, np.add(expected, 20), rtol=1e-5)
            assert np.allclose(total * (1 - share), expected, rtol=1e-3)
        assert made["sigma_t"].max() >= 1.05 * (states.max() + 20)


@pytest.mark.long
def test_a_photodiode_sized_reading(engine):
    """8.977(9)e-3 through a 1 x 1 mm square 2 mm from a beam on 10 mm of matched medium: pmmc, MCX and plain C."""
    scene = slab(mu_a=0.05, mu_s=10, g=0.9, n=1, thickness=10, photodiodes=[SQUARE])
    batches = fractions(scene, THROUGH_SQUARE, batches=20, paths=5120, seed=4, backend=engine)
    mean, stderr = statistics(batches)
    assert abs(mean - 8.977e-3) < 4 * stderr and stderr < 0.04 * mean


def test_same_seed_same_bits_and_the_variant_is_given_back(engine):
    mi = backend.activate(backend.choose("scalar"))
    scene = slab(mu_a=0.1, mu_s=1, g=0, n=1.3, photodiodes=[SQUARE])
    first, second, other = (
        fractions(scene, THROUGH_SQUARE, batches=2, paths=512, seed=seed, backend=engine) for seed in (5, 5, 6)
    )
    assert np.array_equal(first, second) and not np.array_equal(first, other)
    assert mi.variant() == "scalar_rgb"


def test_what_stock_mitsuba_cannot_do_is_refused():
    scene = slab(
        mu_a=0.1,
        mu_s=1,
        g=0,
        n=1,
        led={"pattern": "measured", "pattern_deg": [0.0, 90.0], "pattern_relative": [1.0, 0.5]},
        photodiodes=[SQUARE],
    )
    with pytest.raises(InputError, match="measured"):
        fractions(scene, THROUGH_SQUARE, batches=1, paths=256, seed=1, backend=backend.choose("scalar"))


def test_the_bed_varies_along_the_nail_as_requested():
    """sigma_t and albedo read back from Mitsuba's grids at places between the nodes."""
    mi = backend.activate(backend.choose("scalar"))
    v = np.linspace(-6, 6, 121)
    states = np.stack([0.1 + 0.05 * np.tanh(v), 0.2 - 0.01 * v, np.full_like(v, 0.3)])
    made = mitsuba_scene.bed_medium(
        mi, BedAbsorption(v, states), mu_s=20.0, g=0.9, bounds_mm=np.array([[-5.0, -5, -9], [5, 5, 0]])
    )
    sigma_t, albedo = mi.load_dict(made["sigma_t"]), mi.load_dict(made["albedo"])
    assert sigma_t.max() >= 1.05 * (states.max() + 20)
    for x, y, z in ((0, 0.0, -1), (4.9, 3.33, -8.9), (-4.9, -4.87, -0.1)):
        point = mi.Interaction3f()
        point.p = mi.Point3f(x, y, z)
        expected = np.array([np.interp(y, v, state) for state in states])
        total, share = (np.array(volume.eval(point)) for volume in (sigma_t, albedo))
        assert np.allclose(total, expected + 20, rtol=1e-5)
        assert np.allclose(total * (1 - share), expected, rtol=1e-3)


@pytest.fixture(scope="module")
def finger():
    """A finger with one LED and one photodiode beside it, and its media in three blood states."""
    return prepare(PLAIN_FINGER)


@pytest.fixture(scope="module")
def by_scalar(finger):
    """Eight batches of that finger's reading in three states by the scalar backend, (8, 3) float."""
    return read(finger, backend.choose("scalar"), seed=2, batches=8)


def prepare(text):
    scene = parse_scene(text)
    shape = geometry.build(scene)
    optics = finger_media(scene, shape.regions, 800.0)
    v = np.linspace(-14, 9, 231)
    bloodless = optics.mu_a[shape.regions.index("bed")]
    # 1, 3 and 6 % of blood of 0.437 per mm, smoothly less towards the tip.
    states = bloodless + 0.437 * np.outer([0.01, 0.03, 0.06], 1 - 0.3 / (1 + np.exp(-v)))
    return scene, shape, optics, BedAbsorption(v, states)


def read(finger, engine, *, seed, batches, keep=slice(None), optics=None):
    scene, shape, media, bed = finger
    traced = readings.finger_paths(
        shape,
        optics or media,
        bed=BedAbsorption(bed.v_mm, bed.mu_a_per_mm[keep]),
        led=0,
        photodiodes=(0,),
        backend=engine,
    )
    with readings.stock_mitsuba(engine, readings.SPECTRAL):
        return np.stack([traced.batch(paths=2048, seed=seed_of(seed, k)) for k in range(batches)])


@pytest.mark.long
@pytest.mark.jit
def test_a_finger_reads_the_same_with_either_backend(finger, by_scalar, jit_backend):
    one, one_error = statistics(read(finger, jit_backend, seed=1, batches=8))
    two, two_error = statistics(by_scalar)
    assert np.all(abs(one - two) < 4 * np.hypot(one_error, two_error))
    assert np.all(np.hypot(one_error, two_error) < 0.2 * one)


@pytest.mark.long
def test_more_blood_dims_the_reading_and_states_share_their_noise(by_scalar):
    assert by_scalar.shape == (8, 3)
    mean, stderr = statistics(by_scalar)
    for a, b in ((0, 1), (1, 2)):
        change, error = statistics(by_scalar[:, b] - by_scalar[:, a])
        assert change < -4 * error
        assert error < 0.3 * stderr[a]


def test_without_index_steps_the_finger_is_traced_through_null_boundaries(finger):
    scene, shape, media, bed = finger
    matched = replace(media, n=np.ones_like(media.n))
    (mean,), (stderr,) = statistics(
        read(finger, backend.choose("scalar"), seed=6, batches=4, keep=slice(1), optics=matched)
    )
    # The photon walk reads 0.00398(4) of 2^20 photons.
    assert abs(mean - 0.00398) < 4 * stderr < 0.0025


@pytest.mark.long
def test_photodiodes_distinguished_by_colour_read_what_each_reads_alone():
    """Three photodiodes in one trace against one each, in the scalar variant."""
    two = """
[[photodiodes]]
name = "far"
position_mm = [0.0, 1.0]
size_mm = [1.0, 1.0]
"""
    scene, shape, media, bed = prepare(PLAIN_FINGER.replace("[1.0, 0.25]", "[1.0, 0.8]") + two)
    rest = BedAbsorption(bed.v_mm, bed.mu_a_per_mm[:1])
    scalar = backend.choose("scalar")

    def trace(photodiodes, seed):
        traced = readings.finger_paths(shape, media, bed=rest, led=0, photodiodes=photodiodes, backend=scalar)
        with readings.stock_mitsuba(scalar, readings.SPECTRAL):
            return statistics(np.stack([traced.batch(paths=1024, seed=100 * seed + k) for k in range(6)]))

    together, error = trace((0, 1), 1)
    for i in (0, 1):
        alone, alone_error = trace((i,), 2 + i)
        assert abs(alone[0] - together[i]) < 4 * np.hypot(alone_error[0], error[i])
        assert alone_error[0] < 0.3 * alone[0]


@pytest.mark.long
def test_states_of_every_photodiode_within_a_time_or_a_tolerance(finger, by_scalar):
    scene, shape, media, bed = finger
    heard = []
    options = TraceOptions(relative_error=0.25, max_seconds=60.0, seed=1, backend="scalar")
    result = readings.finger_states(scene, shape, media, bed, led=0, options=options, progress=heard.append)
    assert result.unmet_reason is None and result.fraction.shape == result.ratio_stderr.shape == (1, 3)
    assert np.all(result.fraction_stderr < 0.3 * result.fraction)
    assert np.all(result.ratio[:, 0] == 1) and np.all(result.ratio_stderr[:, 0] < 1e-12)
    other, other_error = readings.ratio_to_first([2048] * 8, by_scalar)
    assert np.all(abs(result.ratio[0] - other)[1:] < 4 * np.hypot(result.ratio_stderr[0], other_error)[1:])
    assert np.all(result.ratio_stderr < 0.03)
    assert heard[-1].relative_error <= 0.25 and len(heard) >= readings.ROUND_BATCHES
    options = replace(options, relative_error=1e-4, max_seconds=0.1)
    hurried = readings.finger_states(scene, shape, media, bed, led=0, options=options)
    assert "max_seconds" in hurried.unmet_reason and hurried.paths >= readings.LEAST_BATCHES


def test_an_interrupt_keeps_the_batches_that_are_there(finger):
    scene, shape, media, bed = finger
    heard = []

    def interrupt(progress):
        heard.append(progress)
        if len(heard) > 4:
            raise KeyboardInterrupt

    options = TraceOptions(relative_error=1e-4, max_seconds=600.0, seed=1, backend="scalar")
    kept = readings.finger_states(scene, shape, media, bed, led=0, options=options, progress=interrupt)
    assert kept.unmet_reason.startswith("interrupted") and kept.paths == heard[-1].photons
    assert np.all(np.isfinite(kept.fraction_stderr))


@pytest.mark.long
def test_batches_of_an_interrupted_run_come_from_the_store(finger, store, monkeypatch):
    """Expected: the run after it traces only what is missing and has the bits of one that was never interrupted; its
    pace counts the stored batches' time, and other absorption has batches of its own."""
    scene, shape, media, bed = finger
    options, traced, heard = TraceOptions(photons=64, seed=1, backend="scalar"), [], []
    batch = readings.Paths.batch
    monkeypatch.setattr(readings.Paths, "batch", lambda *at, **how: traced.append(1) or batch(*at, **how))

    def run(bed=bed, options=options, progress=heard.append):
        return readings.finger_states(scene, shape, media, bed, led=0, options=options, progress=progress)

    def interrupt(progress):
        heard.append(progress)
        if len(heard) == 20:
            raise KeyboardInterrupt

    assert run(progress=interrupt).interrupted and len(traced) == 20
    first_s = heard[-1].seconds
    resumed = run()
    assert not resumed.interrupted and len(traced) == 32
    # Of the batches, not of what is between them.
    assert heard[39].fraction_done == heard[19].fraction_done and heard[39].seconds > 0.8 * first_s
    unbroken = run(options=replace(options, store=False))
    assert len(traced) == 64 and np.array_equal(unbroken.fraction, resumed.fraction)

    def interrupt_at_once(progress):
        if len(traced) == 66:
            raise KeyboardInterrupt

    # No batch of these two comes from the store.
    assert run(bed=replace(bed, mu_a_per_mm=1.01 * bed.mu_a_per_mm), progress=interrupt_at_once).interrupted
    assert len(traced) == 66

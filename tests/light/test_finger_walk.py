"""The photon walk through a finger against stock volpath, which shares nothing with it but the scene."""

import numpy as np
import pytest

import nailoptics as nail
from nailoptics import geometry
from nailoptics.assets import data_dir
from nailoptics.light import backend, optics
from nailoptics.light.reference import mitsuba_scene, readings
from nailoptics.light.walk import sampling
from nailoptics.light.walk.finger import FingerTracer
from nailoptics.light.walk.interfaces import ZoneEdges, table_of_rows
from nailoptics.light.walk.tallies import Section
from nailoptics.options import TraceOptions
from nailoptics.scene import Led, Scene, load_scene
from nailoptics.statistics import seed_of
from nailoptics.tissue import BloodZones


def prototype(*, index_steps: bool = True, elements: tuple[tuple[int, ...], tuple[int, ...]] | None = None) -> Scene:
    """The shipped prototype, with as many of its photodiodes as are requested."""
    scene = load_scene(data_dir("scenes") / "prototype.toml")
    update: dict = {"light": scene.light.model_copy(update={"index_steps": index_steps})}
    if elements is not None:
        kept = zip(scene.photodiodes, elements, strict=True)
        update["photodiodes"] = tuple(p.model_copy(update={"wired": w}) for p, w in kept if w)
    return scene.model_copy(update=update)


# The element of the proximal array that lies nearest to the LED: the brightest, so the quickest to settle.
NEAREST = ((15,), ())
# Of stock Mitsuba's paths, by whose spread its standard errors are estimated.
BATCHES = 32


@pytest.mark.jit
@pytest.mark.parametrize(
    ("index_steps", "air_gap_um"),
    [
        pytest.param(True, None, marks=pytest.mark.slow),
        pytest.param(True, 50.0, marks=pytest.mark.long),
        pytest.param(False, None, marks=pytest.mark.slow),
    ],
)
def test_photons_and_volpath_read_the_same_on_a_photodiode_of_the_finger(jit_backend, index_steps, air_gap_um):
    """Within 3 combined standard errors at 3 % each.

    The array has one element as long as sixteen of its own beside the LED: more light settles in fewer paths. Their
    number is fixed: volpath's batches are skewed, and stopping where they first appear settled favours low ones.
    """
    scene = prototype(index_steps=index_steps)
    large = {"elements": 1, "size_mm": (1.0, 4.0), "wired": (0,), "position_mm": (0.0, 0.0)}
    board = scene.board.model_copy(update={"air_gap_um": air_gap_um})
    scene = scene.model_copy(update={"board": board, "photodiodes": (scene.photodiodes[0].model_copy(update=large),)})
    reading = nail.trace(scene, relative_error=0.015, seed=1).at().isel(led=0, photodiode=0)
    shape = geometry.build(scene)
    result = optics.finger_media(scene, shape.regions, 800.0)
    v = np.linspace(*(np.asarray(shape.bounds_mm)[:, 1] + [-0.2, 0.2]), 101)
    traced = readings.finger_paths(
        shape,
        result,
        bed=mitsuba_scene.BedAbsorption(v, np.full((1, len(v)), result.mu_a[shape.regions.index("bed")])),
        led=0,
        photodiodes=(0,),
        backend=backend.choose("auto", volpath=True),
    )
    with readings.stock_mitsuba(backend.choose("auto", volpath=True), readings.SPECTRAL):
        batches = np.array([traced.batch(paths=2304, seed=seed_of(2, k))[0] for k in range(22)])
    other, error = batches.mean(), batches.std(ddof=1) / np.sqrt(len(batches))
    assert error < 0.03 * other and reading.detected_fraction_stderr < 0.03 * reading.detected_fraction
    assert abs(reading.detected_fraction - other) < 3 * np.hypot(error, reading.detected_fraction_stderr)


@pytest.mark.slow
@pytest.mark.jit
def test_stock_mitsuba_detects_a_tenth_more_absorption_on_the_prototype(jit_backend):
    """Expected: all eight readings of the LED's whole line within 3.5 combined standard errors, of which one beyond is
    a chance of 1 in 270, and their mean ratio within 3; with a tenth more absorption that is beyond 3.

    Rationale: a tenth dims the readings by 2.4 %, which needs their mean ratio to 0.5 %. The number of paths is fixed:
    volpath's batches are skewed, and stopping where they first appear settled favours low ones. Stock Mitsuba scatters
    at each wavelength of the line as there, the walk as at the peak.
    """
    scene = prototype()
    led = Led(name="ir", part=scene.leds[0].part, position_mm=scene.leds[0].position_mm)
    scene = scene.model_copy(update={"leds": (led,)})
    ours = nail.trace(scene, photons=1 << 22, seed=1).at().isel(led=0)
    walk, walk_error = (
        ours.detected_fraction.values,
        ours.detected_fraction_stderr.values / ours.detected_fraction.values,
    )
    tenth_more = np.exp(-0.1 * ours.mean_path_mm.values @ optics.absorption(scene, led.wavelength_nm)[0]).mean()
    shape, rest = geometry.build(scene), np.full((1, 2), scene.blood.rest_blood_fraction)
    media, bed = readings.line_optics(scene, shape, rest, 0, along_line=True)
    assert led.fwhm_nm > 30 and np.all(np.ptp(media.mu_s[media.mu_s[:, 0] > 0], axis=1) > 0)
    ratios = []
    for part in ((0, 1, 2, 3), (4, 5, 6, 7)):
        how = {"bed": bed, "photodiodes": part, "backend": backend.choose("auto", volpath=True)}
        traced = readings.finger_paths(shape, media, led=0, **how)
        seeds = (seed_of(2, part[0], k) for k in range(BATCHES))
        with readings.stock_mitsuba(how["backend"], readings.SPECTRAL):
            ratios.append(np.array([traced.batch(paths=1 << 15, seed=seed) for seed in seeds]) / walk[list(part)])
    of_batches = np.concatenate(ratios, axis=1)
    ratio, error = of_batches.mean(0), of_batches.std(0, ddof=1) / BATCHES**0.5
    away = abs(ratio - 1) / np.hypot(error, walk_error)
    assert np.all(away < 3.5) and np.all(error < 0.03), (ratio, error)
    # Photodiodes of one trace share its paths; those of the walk share hardly any photons.
    of_group = [ratio_of_batch.mean(1).std(ddof=1) / BATCHES**0.5 for ratio_of_batch in ratios]
    sigma = np.hypot(np.linalg.norm(of_group) / 2, np.linalg.norm(walk_error) / 8)
    assert abs(ratio.mean() - 1) < 3 * sigma, (ratio.mean(), sigma)
    assert abs(ratio.mean() - tenth_more) > 3 * sigma, (ratio.mean(), tenth_more, sigma)


@pytest.fixture(scope="module")
def traced(chosen_jit):
    """Half a million photons through the prototype."""
    return nail.trace(prototype(), photons=1 << 19, seed=8)


@pytest.mark.long
@pytest.mark.jit
@pytest.mark.parametrize("index_steps", [True, False])
def test_every_photon_is_accounted_for(jit_backend, traced, index_steps):
    """Parts of the energy are fractions that sum to 1 within their noise, and fewer than 1 in 1e5 is lost."""
    energy = (traced if index_steps else nail.trace(prototype(index_steps=False), photons=1 << 19, seed=5)).energy()
    stderr = np.linalg.norm([part["stderr"] for part in energy.values()])
    assert abs(sum(part["value"] for part in energy.values()) - 1) < 4 * stderr < 0.01
    assert energy["lost"]["value"] < 1e-5
    assert energy["absorbed"]["value"] > 0.2 and all(part["value"] >= 0 for part in energy.values())


@pytest.mark.long
@pytest.mark.jit
def test_parts_left_out_read_the_same_with_and_without_faces(jit_backend):
    """Rationale: only `explain` keeps the faces of what is left out, so that two scenes share photons.
    Expected: independent traces of both agree at every photodiode, and estimate their sum to 2 %."""
    scene, photons = prototype(), 1 << 17
    scene = scene.model_copy(update={"light": scene.light.model_copy(update={"left_out": tuple(geometry.AROUND)})})
    result = []
    for seed, kept in enumerate((tuple(geometry.AROUND), ())):
        tracer = FingerTracer(scene, with_faces=kept)
        batch = tracer.batch(0, photons=photons, seed=seed)
        met = {*tracer.geometry.below.tolist(), *tracer.geometry.above.tolist()}
        assert all((tracer.geometry.regions.index(part) in met) == bool(kept) for part in geometry.AROUND)
        assert batch.path_mm[:, optics.absorbers(scene).index("bone")].any() == bool(kept)
        sums = [np.bincount(batch.photodiode, batch.weight**k, minlength=8) / photons for k in (1, 2)]
        result.append((sums[0], (sums[1] - sums[0] ** 2) / photons))
    (with_faces, variance), (without, other) = result
    assert ((with_faces - without) ** 2 / (variance + other)).sum() < 26.1  # 8 readings: one time in a thousand
    assert np.sqrt((variance + other).sum()) < 0.02 * without.sum()


@pytest.mark.jit
def test_absorbed_light_is_tallied_by_region(jit_backend, monkeypatch):
    """Rationale: what is absorbed is not what is left, so that the balance can fail.
    Expected: each photon's parts make up all of it, and without the tally of the plate its share is lost."""
    scene = prototype()
    tracer, photons = FingerTracer(scene), 1 << 15
    batch = tracer.batch(0, photons=photons, seed=5)
    lost = batch.energy["lost"][0] / photons
    assert abs(lost) < 1e-4  # one photon in 1e5 slips through an edge
    places = {name: total / photons for name, (total, _) in batch.absorbed.items()}
    assert sum(places.values()) == pytest.approx(batch.energy["absorbed"][0] / photons, abs=1e-12)
    assert places.keys() >= {"plate", "bed", "bone", "pulp", "barrier", "cover", "leds", "photodiodes"}
    assert min(places[name] for name in ("plate", "bed", "bone", "barrier", "cover")) > 0.02
    plate = tracer.geometry.regions.index("plate")
    regions = tracer.regions[0]
    rows = np.array(regions.ends).reshape(-1, 4)
    rows[plate, -1] = -1
    monkeypatch.setattr(regions, "ends", table_of_rows(rows))
    missed = tracer.batch(0, photons=photons, seed=5)
    assert missed.energy["lost"][0] / photons - lost == pytest.approx(places["plate"], rel=1e-6)


@pytest.mark.slow
@pytest.mark.jit
def test_a_bed_that_absorbs_more_dims_both_engines_alike(jit_backend):
    """Rationale: volpath absorbs along the way, photons only afterwards, from the paths that they kept.
    Expected: the ratio of two states, in which most noise cancels, agrees to a small part of what the bed takes."""
    scene, more = prototype(elements=NEAREST), 0.1
    shape = geometry.build(scene)
    result = optics.finger_media(scene, shape.regions, 800.0)
    bed = float(result.mu_a[shape.regions.index("bed")])
    result = readings.finger_states(
        scene,
        shape,
        result,
        mitsuba_scene.BedAbsorption(np.array([-20.0, 20.0]), np.array([[bed] * 2, [bed + more] * 2])),
        led=0,
        # The ratio is settled before the level.
        options=TraceOptions(relative_error=0.5, max_seconds=300.0, seed=3),
    )
    traced = nail.trace(scene, photons=1 << 20, seed=4)
    trace = traced.traces[0]
    path = trace.path_mm[:, [traced.absorbers.index(name) for name in ("bed_1", "bed_2")]].sum(1)
    left = np.exp(-more * path.astype(float))
    ratio = (trace.weight @ left) / trace.weight.sum()
    own = np.linalg.norm(np.bincount(trace.photon, trace.weight * (left - ratio))) / trace.weight.sum()
    assert abs(ratio - result.ratio[0, 1]) < 3 * np.hypot(own, result.ratio_stderr[0, 1]) < 0.5 * (1 - ratio)


@pytest.mark.jit
def test_paths_are_divided_among_zones_by_the_weights_at_their_middle(jit_backend):
    """Expected: what lies beyond each edge, less what lies beyond the next one, is the zone's weight of the path."""
    import mitsuba as mi

    zones, v_mm = BloodZones((-2.0, 1.5), 2.5), np.linspace(-5.0, 5.0, 101)
    beyond = ZoneEdges(zones).beyond(mi.Float(v_mm), mi.Float(3.0))
    by_zone = -np.diff([np.full_like(v_mm, 3.0), *map(np.array, beyond), np.zeros_like(v_mm)], axis=0).T
    assert by_zone == pytest.approx(3.0 * zones.weights(v_mm), abs=1e-5)


@pytest.mark.jit
def test_the_same_seed_gives_the_same_bits_and_another_one_others(jit_backend, monkeypatch):
    """Expected: also in other lanes, so that no photon is walked twice, or by none, whichever lane takes it."""
    tracer, photons = FingerTracer(prototype()), 1 << 15
    first, other = (tracer.batch(0, photons=photons, seed=seed) for seed in (5, 6))
    assert not np.array_equal(first.weight, other.weight)
    for lanes in (sampling.CPU_LANES, 77, 20_000):
        monkeypatch.setattr(sampling, "CPU_LANES", lanes)
        monkeypatch.setattr(sampling, "GPU_LANES", lanes)
        again = tracer.batch(0, photons=photons, seed=5)
        assert all(np.array_equal(getattr(first, name), getattr(again, name)) for name in ("weight", "path_mm"))
        assert (again.energy, again.events) == (first.energy, first.events)


@pytest.mark.long
@pytest.mark.jit
def test_the_board_bends_no_light_to_one_side(traced):
    """Elements that mirror each other in the LED's place read alike: the finger's taper matters less than the noise."""
    scene = prototype()
    read = traced.at().isel(led=0)
    value, stderr = read.detected_fraction.values, read.detected_fraction_stderr.values
    mirrored = [p.wired for p in scene.photodiodes]
    if mirrored[0] != tuple(15 - k for k in reversed(mirrored[1])):
        pytest.fail("the prototype's wiring is no longer symmetrical; choose mirrored elements here")
    assert np.all(abs(value - value[::-1]) < 4 * np.hypot(stderr, stderr[::-1]) + 0.05 * value)
    assert abs(value[:4].sum() - value[4:].sum()) < 4 * np.linalg.norm(stderr) + 0.02 * value[:4].sum()
    assert np.all(np.diff(value[:4]) > 0)  # nearer to the LED is brighter


@pytest.mark.jit
def test_the_sections_path_density_adds_up_to_the_paths_of_all_light(jit_backend, monkeypatch):
    """Expected: where nothing absorbs, summed over the section, the density times the area is the mean path per photon
    in all media, beside which it goes 0.1 % in air; most lies at the LED. A cell's middle is its place."""
    import mitsuba as mi

    tracer, photons = FingerTracer(prototype()), 1 << 12
    rows = np.array(tracer.regions[0].optics).reshape(-1, 4) * [1, 1, 0, 1]
    monkeypatch.setattr(tracer.regions[0], "optics", table_of_rows(rows))
    low, high = np.asarray(tracer.geometry.bounds_mm)
    y, z = np.arange(low[1] - 0.5, high[1] + 0.5, 0.1), np.arange(low[2] - 0.5, high[2] + 0.5, 0.1)
    section, marked = Section(y, z), Section(y, z)
    walked = tracer.walk(0, photons=photons, seed=9, section=section)
    density, path_mm = section.density(photons), walked.path_mm[: len(optics.TISSUES)].sum(0).mean()
    assert density.sum() * 0.1**2 == pytest.approx(path_mm, rel=3e-3)
    at = np.unravel_index(density.argmax(), density.shape)
    led = np.asarray(tracer.geometry.leds[0].quads).reshape(-1, 3)
    assert abs(y[at[0]] - led[:, 1].mean()) < 0.5 and abs(z[at[1]] - led[:, 2].mean()) < 0.5
    place = mi.Point3f(0.0, float(y[3] + 0.04), float(z[5] - 0.04))
    marked.add(None, place, mi.Float(0.5), mi.Float(0.2), mi.Bool(True))
    (row,), (column,) = np.nonzero(marked.density(10))
    assert (row, column) == (3, 5) and marked.density(10).sum() == pytest.approx(0.5 * 0.2 / (10 * 0.1**2))


def test_scenes_that_differ_in_optics_have_their_geometry_in_common():
    """Expected: what the cache of geometries leaves aside changes no triangle; what a finger is built from stays."""
    scene = prototype()
    light = scene.light.model_copy(update={"index_steps": False})
    finger = scene.finger.model_copy(update={"bed_scattering": 2.0, "plate_absorption": 0.5, "dermis": "shimojo"})
    blood = scene.blood.model_copy(update={"zone_edges_mm": (1.0,), "rest_blood_fraction": 0.1})
    leds = [led.model_copy(update={"part": None, "wavelength_nm": 660.0, "fwhm_nm": 20.0}) for led in scene.leds]
    photodiodes = [one.model_copy(update={"quantum_efficiency": 0.5}) for one in scene.photodiodes]
    parts = {"leds": tuple(leds), "photodiodes": tuple(photodiodes)}
    parts["board"] = scene.board.model_copy(update={"opaque_reflectance": 0.5})
    other = scene.model_copy(update={"light": light, "blood": blood, "finger": finger} | parts)
    one, two = (geometry.build(s) for s in (scene, other))
    assert np.array_equal(one.vertices, two.vertices) and np.array_equal(one.triangles, two.triangles)
    assert one.regions == two.regions
    kept = geometry.shaping(other)
    assert (
        kept == geometry.shaping(scene)
        and kept.blood == type(blood)()
        and kept.light == type(light)(left_out=scene.light.left_out)
    )
    assert kept.finger == scene.finger
    for change in ({"name": "x"}, {"position_mm": (-1.3, 0.0)}, {"size_mm": (0.2, 0.2)}):
        moved = scene.model_copy(update={"leds": (scene.leds[0].model_copy(update=change),)})
        assert geometry.shaping(moved) != kept
    assert geometry.shaping(scene.model_copy(update={"photodiodes": scene.photodiodes[:1]})) != kept
    bare = scene.board.model_copy(update={"cover_um": 0.0})
    assert geometry.shaping(scene.model_copy(update={"board": bare})) != kept

"""Photodiodes that weigh light by its angle: flat ones are as before, narrow ones collect the theoretical flux."""

from functools import partial

import numpy as np
import pytest

import nailoptics as nail
from nailoptics.assets import data_dir
from nailoptics.errors import InputError
from nailoptics.light.board_map import BoardTracer, blood_point, readings
from nailoptics.light.reference.readings import finger_states
from nailoptics.options import TraceOptions
from nailoptics.scene import Scene, load_scene
from nailoptics.statistics import stderr_of_mean
from nailoptics.studies.placement import boards, candidates

FLAT = ((0.0, 1.0), (60.0, 0.5), (90.0, 0.0))


def with_response(*rows: tuple[tuple[float, float], ...] | None) -> Scene:
    """The prototype, each of its two arrays with an angular response."""
    scene = load_scene(data_dir("scenes") / "prototype.toml")
    pairs = zip(scene.photodiodes, rows, strict=True)
    return scene.model_copy(
        update={"photodiodes": tuple(p.model_copy(update={"angular_response": r}) for p, r in pairs)}
    )


def power_of_cosine(power: float) -> tuple[tuple[float, float], ...]:
    rows = tuple((float(a), float(np.cos(np.radians(a)) ** power)) for a in range(90))
    return (*rows, (90.0, 0.0))


@pytest.mark.jit
def test_a_response_that_follows_the_cosine_reads_the_bits_of_none(jit_backend):
    bare, flat = (nail.trace(with_response(r, r), photons=1 << 14, seed=3).traces[0] for r in (None, FLAT))
    assert len(bare.weight) > 100
    assert np.array_equal(bare.weight, flat.weight) and np.array_equal(bare.photodiode, flat.photodiode)
    assert np.array_equal(bare.path_mm, flat.path_mm)


@pytest.mark.jit
@pytest.mark.parametrize(
    "power", [pytest.param(1.0, marks=pytest.mark.slow), 3.5, pytest.param(20.0, marks=pytest.mark.long)]
)
def test_a_face_under_even_radiance_collects_the_theoretical_flux(jit_backend, power):
    """Of even radiance a response cos^m takes int cos^m dw / int cos dw = 2 / (m + 1) of what a flat face does."""
    import mitsuba as mi

    from nailoptics.light.walk.finger import FingerTracer, FingerWalk
    from nailoptics.light.walk.interfaces import Emitter, ZoneEdges
    from nailoptics.light.walk.sampling import LAMBERTIAN, PhotonEnds, PhotonQueue, acceptance_of
    from nailoptics.light.walk.splitting import COPIES, Reach, Splitting

    scene = with_response(None, power_of_cosine(power))
    tracer, photons = FingerTracer(scene), 1 << 17
    chosen = len(tracer.photodiodes) - 1

    class Inwards(Emitter):
        """Even radiance on a face, from a little below it."""

        def emit(self, rng, index):
            p, w, cos = super().emit(rng, index)
            return mi.Point3f(p + 0.01 * w), mi.Vector3f(-w), cos

    emitter = Inwards(tracer.geometry.photodiodes[chosen], LAMBERTIAN, tracer.regions[0].epoxy)
    ends = PhotonEnds(photons, paths=tracer.paths, media=len(tracer.regions[0].absorbing))
    reach = Reach(tracer.geometry, tracer.geometry.leds[0])
    reach.arrivals = 1 + COPIES
    splitting, acceptance = Splitting(reach, photons, paths=tracer.paths), acceptance_of(scene.photodiodes)
    made = (tracer.interfaces, tracer.regions[0], ZoneEdges(tracer.zones), emitter, ends)
    walk = FingerWalk(*made, splitting=splitting, acceptance=acceptance)
    ends.evaluated(walk.run(PhotonQueue(photons, 5)))
    detected, photodiode, weight, _ = splitting.records(5)
    assert splitting.fits() and np.all(photodiode == chosen)
    score = np.zeros(photons)
    score[detected] = weight
    stderr = stderr_of_mean(score.sum(), (score**2).sum(), photons)
    assert abs(score.mean() - 2 / (power + 1)) < 4 * stderr + 1e-4
    assert stderr < 0.01 * score.mean()


@pytest.mark.long
@pytest.mark.jit
def test_only_the_photodiodes_with_a_narrow_response_read_less(jit_backend):
    bare, lens = (
        nail.trace(with_response(None, r), photons=1 << 17, seed=3).at().isel(led=0)
        for r in (None, power_of_cosine(3.5))
    )
    ratio = lens.detected_fraction.values / bare.detected_fraction.values
    first = len(ratio) // 2
    error = (bare.detected_fraction_stderr / bare.detected_fraction).values
    assert np.all(error < 0.025)
    # Of even radiance 2 / 4.5; near the LED more of the light comes straight.
    assert np.all(abs(ratio[:first] - 1) < 1e-6) and np.all(abs(ratio[first:] - 0.5) < 0.1)


def on_board(*rows: tuple[tuple[float, float], ...] | None) -> Scene:
    """An open board whose photodiodes, of one size, have angular responses."""
    one = load_scene(data_dir("scenes") / "placement.toml")
    board = one.board.model_copy(update={"barrier": False, "size_mm": (8.0, 9.0)})
    places = zip(((1.0, -0.6), (0.2, 1.6)), rows, strict=True)
    photodiodes = tuple(
        one.photodiodes[0].model_copy(
            update={"name": f"p{i}", "position_mm": place, "size_mm": (1.2, 1.2), "angular_response": response}
        )
        for i, (place, response) in enumerate(places)
    )
    led = one.leds[0].model_copy(update={"position_mm": (-1.0, 0.0), "fwhm_nm": 0.0})
    update = {"board": board, "photodiodes": photodiodes, "leds": (led,), "placement": None}
    return one.model_copy(update=update)


@pytest.mark.jit
def test_maps_of_a_response_that_follows_the_cosine_are_those_of_none(jit_backend):
    result = []
    for response in (None, FLAT):
        tracer = BoardTracer(on_board(response, response))
        starts, *everywhere = tracer.everywhere(photons=1 << 13, seed=1)
        own = [arrivals(0, photons=1 << 13, seed=1) for arrivals in (tracer.arrivals, partial(tracer.leaving, 1))]
        result.append([starts, *(column for one in (*everywhere, *own) for column in vars(one).values())])
    assert all(np.array_equal(one, other, equal_nan=True) for one, other in zip(*result, strict=True))


@pytest.mark.long
@pytest.mark.jit
def test_maps_read_a_narrow_response_as_a_trace_does(jit_backend):
    """Both photodiodes half at 36 degrees: the bare board's map, and a walk of their own."""
    narrow = power_of_cosine(3.3)
    scene = on_board(narrow, narrow)
    traced = nail.trace(scene, photons=1 << 17, seed=3).at().isel(led=0)
    expected, error = (traced[name].values for name in ("detected_fraction", "detected_fraction_stderr"))
    areas = scene.layout.photodiode_areas
    board = boards.bare_board(boards.with_explicit_walls(scene, ""))
    bare, own = (BoardTracer(one) for one in (board, scene))
    point, photons = blood_point(scene, 0), 1 << 17
    arrived = bare.arrivals(0, photons=photons, seed=1)
    (mean,), error_of_mean = readings(arrived, point.values(arrived), areas)
    by_map = [mean[:, 0], error_of_mean[:, 0]]
    each = [own.detected(0, point, photons=photons // 8, seed=seed)[:, 0] for seed in range(4)]
    fresh = [np.mean(each, 0), np.std(each, 0, ddof=1) / 2]
    # Four batches estimate their own spread badly: it is no less than that of as many photons of the map.
    fresh[1] = np.maximum(fresh[1], by_map[1] * 2**0.5)
    for (value, spread), most in ((by_map, 0.05), (fresh, 0.1)):
        assert np.all(np.abs(value - expected) < 4 * np.hypot(spread, error)), (value, spread, expected, error)
        assert np.all(spread < most * expected)


@pytest.mark.long
@pytest.mark.jit
def test_light_is_weighed_by_the_photodiode_at_its_end(jit_backend):
    """Photons from everywhere, over pairs of places 1 to 3 mm apart: the light that comes with a narrow response, by
    where it arrives and by where it starts, which by reciprocity is the same."""
    tracer = BoardTracer(on_board(power_of_cosine(3.3), power_of_cosine(3.3)))
    starts, arrived, back, left = tracer.everywhere(photons=1 << 16, seed=2)
    flat = BoardTracer(on_board(None, None)).everywhere(photons=1 << 16, seed=2)
    apart = np.hypot(*(starts[arrived.photon] - arrived.place_mm).T)
    near = (apart > 1) & (apart < 3)
    sums, ways = [], (arrived, back, flat[1])
    for one in ways:
        by_photon = np.bincount(one.photon[near], one.weight[near], minlength=one.photons)
        sums.append((by_photon.sum(), by_photon))
    spread = np.sqrt(((sums[0][1] - sums[1][1]) ** 2).sum())
    assert abs(sums[0][0] - sums[1][0]) < 4 * spread and spread < 0.01 * sums[0][0]
    assert sums[0][0] < 0.7 * sums[2][0]
    assert left.weight.sum() != flat[3].weight.sum()


def test_what_cannot_weigh_angles_is_refused():
    scene = with_response(None, FLAT)
    with pytest.raises(InputError, match='"proximal" and "distal" differ in angular_response'):
        BoardTracer(scene).arrivals(0, photons=1, seed=0)
    with pytest.raises(InputError, match="differ in angular_response"):
        candidates.check(scene, "mixed")
    with pytest.raises(InputError, match="angular_response is not known to volpath"):
        finger_states(scene, None, None, None, led=0, options=TraceOptions())  # type: ignore[arg-type]

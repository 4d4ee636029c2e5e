"""Photodiodes that weigh light by its angle: flat ones are as before, and narrow ones collect what theory says."""

import numpy as np
import pytest

import nailoptics as nail
from nailoptics.assets import data_dir
from nailoptics.errors import InputError
from nailoptics.light.board_map import BoardTracer
from nailoptics.light.volpath.states import finger_states
from nailoptics.options import TraceOptions
from nailoptics.scene import Scene, load_scene
from nailoptics.statistics import stderr_of_mean

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
    bare, flat = (nail.trace(with_response(r, r), photons=1 << 17, seed=3).traces[0] for r in (None, FLAT))
    assert len(bare.weight) > 100
    assert np.array_equal(bare.weight, flat.weight) and np.array_equal(bare.photodiode, flat.photodiode)
    assert np.array_equal(bare.path_mm, flat.path_mm)


@pytest.mark.jit
@pytest.mark.parametrize("power", [1.0, 3.5, 20.0])
def test_a_face_under_even_radiance_collects_two_over_one_more_than_the_power(jit_backend, power):
    """Of even radiance a response cos^m takes int cos^m dw / int cos dw = 2 / (m + 1) of what a flat face does."""
    import drjit as dr
    import mitsuba as mi

    from nailoptics.light.acceptance import acceptance_of
    from nailoptics.light.finger_walk import FingerTracer, FingerWalk
    from nailoptics.light.sampling import LAMBERTIAN, PhotonEnds, lanes
    from nailoptics.light.splitting import Splitting
    from nailoptics.light.surroundings import Emitter, ZoneEdges

    scene = with_response(None, power_of_cosine(power))
    tracer, photons = FingerTracer(scene), 1 << 17
    chosen = len(tracer.photodiodes) - 1

    class Inwards(Emitter):
        """Even radiance on a face, from a little below it."""

        def emit(self, rng, index):
            p, w = super().emit(rng, index)
            return mi.Point3f(p + 0.01 * w), mi.Vector3f(-w)

    emitter = Inwards(tracer.geometry.photodiodes[chosen], LAMBERTIAN, tracer.regions[0].epoxy)
    ends = PhotonEnds(photons, paths=tracer.paths, media=len(tracer.regions[0].absorbing))
    splitting = Splitting(tracer.geometry, photons, acceptance_of(scene.photodiodes))
    walk = FingerWalk(tracer.interfaces, tracer.regions[0], ZoneEdges(tracer.zones), emitter, ends, splitting=splitting)
    rng, count = lanes(photons, 5)
    ends.evaluated(walk.run(rng, count, dr.arange(mi.UInt32, dr.width(count))))
    score = np.array(splitting.score).astype(float)
    assert np.all(np.array(splitting.photodiode)[score > 0] == chosen)
    stderr = stderr_of_mean(score.sum(), (score**2).sum(), photons)
    assert abs(score.mean() - 2 / (power + 1)) < 4 * stderr + 1e-4
    assert stderr < 0.01 * score.mean()


@pytest.mark.jit
def test_only_the_photodiodes_with_a_narrow_response_read_less(jit_backend):
    bare, lens = (
        nail.trace(with_response(None, r), photons=1 << 19, seed=3).at().isel(led=0)
        for r in (None, power_of_cosine(3.5))
    )
    ratio = lens.detected_fraction.values / bare.detected_fraction.values
    first = len(ratio) // 2
    error = (bare.detected_fraction_stderr / bare.detected_fraction).values
    # Copies of a photon that reach both arrays count for one of them, by lot.
    assert np.all(abs(ratio[:first] - 1) < 3 * error[:first]) and np.all(ratio[first:] < 0.8)


def test_what_cannot_weigh_angles_says_so():
    scene = with_response(None, FLAT)
    with pytest.raises(InputError, match="angular_response is not known to a photon map"):
        BoardTracer(scene)
    with pytest.raises(InputError, match="angular_response is not known to volpath"):
        finger_states(scene, None, None, None, led=0, options=TraceOptions())  # type: ignore[arg-type]

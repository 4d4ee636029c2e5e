"""One trace for many scenes: what shares it, and that what is read from it is what a trace of the scene gives."""

import numpy as np
import pytest

import nailoptics as nail
from nailoptics.batch import run_batch
from nailoptics.light.identity import light_digest, light_scene, traced_absorption
from nailoptics.light.tracing import LedTrigger, batch_photons, extend, photons_engine, trigger
from nailoptics.light.tracing.store import LedSource, LightStore, made_of
from nailoptics.light.tracing.trigger import check_schedule
from nailoptics.light.transfer import Transfer, rest_state
from nailoptics.scene import Accuracy, load_scene, parse_scene
from nailoptics.scene.placement import Placement

from .conftest import bits, phantoms


def prototype():
    from nailoptics.assets import data_dir

    return load_scene(data_dir("scenes") / "prototype.toml")


def changed(scene, table, **update):
    return scene.model_copy(update={table: getattr(scene, table).model_copy(update=update)})


def test_what_does_not_change_the_light_leaves_its_digest():
    scene = prototype()
    key = light_digest(scene)
    led = scene.leds[0].model_copy(update={"name": "x", "flux_mw": 9.0, "fwhm_nm": 3.0, "part": None})
    diode = scene.photodiodes[0].model_copy(update={"dark_current_na": 5.0, "quantum_efficiency": 0.5})
    same = [
        changed(scene, "blood", so2=0.6, rest_blood_fraction=0.1, parameters="listed"),
        changed(scene, "finger", melanin_fraction=0.3),
        changed(scene, "touch", force_n=7.0),
        changed(scene, "electronics", adc_bits=8),
        changed(scene, "accuracy", relative_error=0.5),
        scene.model_copy(update={"placement": Placement()}),
        scene.model_copy(update={"leds": (led,)}),
        scene.model_copy(update={"photodiodes": (diode, *scene.photodiodes[1:])}),
    ]
    assert [light_digest(s) for s in same] == [key] * len(same)


def test_what_changes_the_light_changes_its_digest():
    scene = prototype()
    other = [
        changed(scene, "blood", zone_width_mm=1.0),
        changed(scene, "blood", zone_edges_mm=(0.5,)),
        changed(scene, "finger", nail_thickness_mm=0.5),
        changed(scene, "board", clear_epoxy_um=300.0),
        changed(scene, "light", index_steps=False),
        scene.model_copy(update={"leds": (scene.leds[0].model_copy(update={"wavelength_nm": 660.0}),)}),
        scene.model_copy(update={"leds": (scene.leds[0].model_copy(update={"position_mm": (-1.2, 1.0)}),)}),
    ]
    assert len({light_digest(s) for s in [scene, *other]}) == 1 + len(other)


def grown(scene, *, asked, stored=(), seed=0):
    kind = photons_engine(scene, "auto")
    traced: list[int] = []

    class Counting(kind):
        def batch(self, led, *, photons, seed):
            traced.append(photons)
            return super().batch(led, photons=photons, seed=seed)

    engine = Counting(light_scene(scene))
    rule = LedTrigger(scene, 0, asked, engine.mu_a(0), full=batch_photons(scene))
    source = LedSource(lambda: engine, 0, engine.mu_a(0), photodiodes=1, seed=seed, stored=stored)
    batches = extend(source, [rule], stop=lambda: False)
    sizes, met = rule.accepted_batches(batches.pieces)
    assert met
    return batches, sizes, traced


def rest_of(scene):
    return rest_state(scene, 0)


@pytest.mark.jit
@pytest.mark.parametrize("which", ["phantom", "finger"])
def test_a_trace_for_many_is_the_trace_of_one_bit_for_bit(jit_backend, tmp_path, which):
    """A scene whose blood is the reference's: nail.trace walks the same photons with the same seeds."""
    if which == "phantom":
        scene, photons = phantoms(tmp_path, 2).scenes[0], 700_000
    else:
        scene, photons = prototype(), 8_000
    batches, sizes, _ = grown(scene, asked=Accuracy(photons=photons), seed=5)
    trace = batches.trace(sizes, seed=5, led=0, rest=rest_of(scene))
    mine = Transfer(scene, (trace,), jit_backend.name)
    theirs = nail.trace(scene, photons=photons, seed=5)
    assert mine.photodiodes == theirs.photodiodes and mine.absorbers == theirs.absorbers
    for name in ("photodiode", "weight", "path_mm"):
        assert np.array_equal(getattr(mine.traces[0], name), getattr(theirs.traces[0], name))
    assert mine.traces[0].energy == theirs.traces[0].energy and mine.traces[0].seeds == theirs.traces[0].seeds


@pytest.mark.slow
@pytest.mark.jit
def test_another_state_read_from_the_shared_trace_meets_its_own_trace(jit_backend):
    scene = changed(changed(prototype(), "blood", so2=0.75, rest_blood_fraction=0.05), "finger", melanin_fraction=0.1)
    batches, sizes, _ = grown(scene, asked=Accuracy(photons=1 << 19))
    trace = batches.trace(sizes, seed=0, led=0, rest=rest_of(scene))
    shared = Transfer(scene, (trace,), jit_backend.name).at()
    own = nail.trace(scene, photons=1 << 19, seed=99).at()
    off = (shared.detected_fraction - own.detected_fraction) / np.hypot(
        shared.detected_fraction_stderr, own.detected_fraction_stderr
    )
    assert float(abs(off).max()) < 4
    total, error = float(own.detected_fraction.sum()), np.linalg.norm(own.detected_fraction_stderr.values)
    assert error < 0.04 * total


@pytest.mark.long
@pytest.mark.jit
def test_a_tighter_error_continues_from_stored_light(jit_backend, tmp_path):
    scene = phantoms(tmp_path, 2).scenes[0]
    stored = [LightStore(tmp_path / "store").light(made_of(scene, 0, seed=0, backend=jit_backend.name))]
    coarse, coarse_sizes, _ = grown(scene, asked=Accuracy(relative_error=0.004), stored=stored)
    fine, fine_sizes, more = grown(scene, asked=Accuracy(relative_error=0.0015), stored=stored)
    fresh, fresh_sizes, every = grown(scene, asked=Accuracy(relative_error=0.0015))
    assert len(coarse_sizes) < len(fine_sizes) == len(fresh_sizes)
    assert len(more) == len(fine_sizes) - len(coarse.pieces) and len(every) == len(fresh_sizes)
    one, two = (b.trace(fine_sizes, seed=0, led=0, rest=rest_of(scene)) for b in (fine, fresh))
    assert np.array_equal(one.weight, two.weight) and one.energy == two.energy and one.seeds == two.seeds


def test_errors_are_checked_seldom_and_at_fixed_numbers():
    checks = [n for n in range(1, 400) if check_schedule(n)]
    assert checks[:6] == [1, 2, 3, 4, 5, 6] and len(checks) < 30
    assert all(b <= max(a + 1, 1.25 * a) for a, b in zip(checks, checks[1:], strict=False))


def test_the_light_of_a_scene_is_its_own_light():
    for scene in (prototype(), parse_scene(nail.scene.to_toml(prototype()))):
        once = light_scene(scene)
        assert light_scene(once) == once


@pytest.mark.long
@pytest.mark.jit
def test_a_photodiode_that_no_light_reaches_ends_the_trace_with_a_word(jit_backend, tmp_path, monkeypatch):
    """However many other scenes go on tracing, and seen or not by their photons later."""
    monkeypatch.setattr(trigger, "UNLIT_PHOTONS", 1_000_000)
    scene = phantoms(tmp_path, 2, path="photodiodes.p.position_mm[0]", high=500.0).scenes[1]
    kind = photons_engine(scene, "auto")
    mu_a = kind(light_scene(scene)).mu_a(0)
    far, more = (
        LedTrigger(scene, 0, asked, mu_a, full=batch_photons(scene))
        for asked in (Accuracy(relative_error=0.01), Accuracy(photons=1 << 22))
    )
    engine = kind(light_scene(scene))
    stored = [LightStore(tmp_path / "store").light(made_of(scene, 0, seed=0, backend=jit_backend.name))]
    source = LedSource(lambda: engine, 0, mu_a, photodiodes=1, seed=0, stored=stored)
    batches = extend(source, [far], stop=lambda: False)
    assert sum(size for _, size in batches.pieces) < 2_000_000 and 'none reached photodiode "p"' in far.unlit
    again = LedTrigger(scene, 0, Accuracy(relative_error=0.01), mu_a, full=batch_photons(scene))
    assert len(extend(source, [again, more], stop=lambda: False).pieces) == 8
    assert again.unlit == far.unlit and not more.unlit


@pytest.mark.jit
def test_a_sweep_over_the_absorption_of_a_phantom_reads_one_trace(jit_backend, here, tmp_path):
    """Readings and energy are those of a trace of each scene's own within their errors; resumed, they have the same
    bits."""
    more = {"path": "phantom.layers.slab.mu_a_per_mm", "low": 0.02, "high": 0.2, "accuracy": "photons = 200000"}
    sweep, folder = phantoms(tmp_path, 4, **more), tmp_path / "b"
    assert len(run_batch(sweep, folder, workers=1, backend=jit_backend.name).done) == 4
    assert len([path for path in (folder / "light").iterdir() if path.is_dir()]) == 1
    results = nail.open_results(folder)
    for i, scene in enumerate(sweep.scenes):
        alone, one = nail.trace(scene, photons=200_000, seed=99, backend=jit_backend.name), results.isel(mu_a_per_mm=i)
        rest, energy = alone.at(), alone.energy()
        pairs = [(one.detected_fraction_rest.item(), one.detected_fraction_rest_stderr.item())]
        expected = [(rest.detected_fraction.item(), rest.detected_fraction_stderr.item())]
        pairs += zip(one.energy.values, one.energy_stderr.values, strict=True)
        expected += [(energy[part]["value"], energy[part]["stderr"]) for part in one.part.values]
        pairs += zip(one.mean_path_mm.values.ravel(), one.mean_path_mm_stderr.values.ravel(), strict=True)
        expected += zip(rest.mean_path_mm.values.ravel(), rest.mean_path_mm_stderr.values.ravel(), strict=True)
        for (value, stderr), (own, own_stderr) in zip(pairs, expected, strict=True):
            assert abs(value - own) < 4 * np.hypot(stderr, own_stderr) and stderr < 1.5 * own_stderr
        assert one.energy.sum().item() == pytest.approx(1, abs=1e-6)
    before = bits(folder)
    (folder / "results" / sorted(before)[1]).unlink()
    run_batch(sweep, folder, workers=1, backend=jit_backend.name)
    assert bits(folder) == before


def test_phantoms_share_a_trace_where_one_absorbs_least_and_none_far_more(tmp_path):
    def traced(values):
        scenes = [phantoms(tmp_path, 1, path="phantom.layers.slab.mu_a_per_mm", low=v).scenes[0] for v in values]
        return [None if one is None else one.phantom.layers[0].mu_a_per_mm for one in traced_absorption(scenes)]

    assert traced([0.1, 0.01, 0.05]) == [0.01] * 3
    assert traced([0.0, 0.01, 0.05, 0.11, 0.2]) == [None, 0.01, 0.01, 0.11, 0.11]
    assert traced([0.1, 0.1]) == [None] * 2

"""One trace for many scenes: what shares it, and that what is read from it is what a trace of the scene gives."""

from dataclasses import replace

import numpy as np
import pytest

import nailoptics as nail
from nailoptics.batch import run_batch
from nailoptics.light.identity import light_digest, light_scene, traced_absorption
from nailoptics.light.tracing.stopping import check_schedule
from nailoptics.light.tracing.store import LightStore
from nailoptics.scene import load_scene, parse_scene
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


@pytest.mark.slow
@pytest.mark.jit
def test_another_state_read_from_the_shared_trace_meets_its_own_trace(jit_backend):
    scene = changed(changed(prototype(), "blood", so2=0.75, rest_blood_fraction=0.05), "finger", melanin_fraction=0.1)
    shared = replace(nail.trace(prototype(), photons=1 << 19), scene=scene).at()
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
    scene, store = phantoms(tmp_path, 2).scenes[0], LightStore(tmp_path / "store")
    coarse = nail.trace(scene, relative_error=0.02, stores=[store])
    fine = nail.trace(scene, relative_error=0.002, stores=[LightStore(tmp_path / "store")])
    fresh = nail.trace(scene, relative_error=0.002, store=False)
    assert fine.reused_photons == coarse.traces[0].photons < fine.traces[0].photons
    assert np.array_equal(fine.traces[0].weight, fresh.traces[0].weight)


def test_errors_are_checked_seldom_and_at_fixed_numbers():
    checks = [n for n in range(1, 400) if check_schedule(n)]
    assert checks[:6] == [1, 2, 3, 4, 5, 6] and len(checks) < 30
    assert all(b <= max(a + 1, 1.25 * a) for a, b in zip(checks, checks[1:], strict=False))


def test_the_light_of_a_scene_is_its_own_light():
    for scene in (prototype(), parse_scene(nail.scene.to_toml(prototype()))):
        once = light_scene(scene)
        assert light_scene(once) == once


@pytest.mark.jit
def test_a_sweep_over_the_absorption_of_a_phantom_reads_one_trace(jit_backend, here, tmp_path):
    """Readings and energy are those of a trace of each scene's own within their errors; resumed, they have the same
    bits."""
    more = {"path": "phantom.layers.slab.mu_a_per_mm", "low": 0.02, "high": 0.09, "accuracy": "photons = 200000"}
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


def test_phantoms_share_the_trace_of_the_power_of_ten_below_whatever_else_is_swept(tmp_path):
    def traced(values):
        scenes = [phantoms(tmp_path, 1, path="phantom.layers.slab.mu_a_per_mm", low=v).scenes[0] for v in values]
        return [None if one is None else one.phantom.layers[0].mu_a_per_mm for one in traced_absorption(scenes)]

    assert traced([0.1, 0.01, 0.05]) == [0.1, 0.01, 0.01]
    assert traced([0.0, 0.01, 0.05, 0.11, 1e-3]) == [0.0, 0.01, 0.01, 0.1, 1e-3]
    assert traced([0.1, 0.1]) == [None] * 2

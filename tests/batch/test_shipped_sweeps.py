"""Every shipped scene and sweep runs to its end: with few photons, and of long sweeps a few scenes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import nailoptics as nail
from nailoptics.assets import data_dir
from nailoptics.batch import load_sweep
from nailoptics.batch.jobs import Settings
from nailoptics.options import TraceOptions
from nailoptics.scene import load_scene, parse_scene

from .test_run import done_here

SCENES, SWEEPS = data_dir("scenes"), data_dir("scenes") / "sweeps"
# What a scene is for, where that is not a simulated touch, and what that gives.
COMMANDS = {"phantom": nail.trace, "nail_colour": nail.colour, "pulse_oximeter": nail.oximeter}
GIVES = {"phantom": "detected_fraction", "nail_colour": "reflectance", "pulse_oximeter": "ratio_at_rest"}
# Traced by their studies' own tests, too, and of photographs a sweep by test_studies.
SLOW, SLOW_SWEEPS = {"nail_colour", "pulse_oximeter"}, {"photographs"}
LONG = {"calibration", "heartbeat", "prototype"}
# Placed by test_outputs_run.
ELSEWHERE = {"placement"}
# Scenes of a sweep that are run, spread over it: few where each is traced separately.
MOST_SCENES = {"photographs": 2, "fingers": 3, "led_place_and_nail": 4}
QUICK = {"vein_stiffness"}
# Scenes of two zones, of eight, and of a heart, whose readings over their priors are read as well.
SPREAD = {"prototype", "white_band", "heartbeat"}


def names(folder: Path) -> list[str]:
    return sorted(path.stem for path in folder.glob("*.toml"))


@pytest.mark.jit
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(n, marks=pytest.mark.slow if n in SLOW else pytest.mark.long if n in LONG else ())
        for n in names(SCENES)
        if n not in ELSEWHERE
    ],
)
def test_a_shipped_scene_runs_to_its_end(chosen_jit, shared_light, name):
    scene = load_scene(SCENES / f"{name}.toml")
    if name != "prototype":
        # Priors that need traces of their own take these of one scene as of another.
        priors = scene.priors.model_copy(update={"own_traces": False, "spread": name in SPREAD})
        scene = scene.model_copy(update={"priors": priors})
    result = COMMANDS.get(name, nail.simulate)(scene, photons=20_000, seed=1)
    given = (result.at() if name == "phantom" else result)[GIVES.get(name, "volts")]
    assert given.size and (given > 0).all()


@pytest.mark.jit
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(n, marks=() if n in QUICK else pytest.mark.slow if n in SLOW_SWEEPS else pytest.mark.long)
        for n in names(SWEEPS)
    ],
)
def test_a_shipped_sweep_runs_to_its_end(jit_backend, coarse_cells, tmp_path, name):
    sweep = load_sweep(SWEEPS / f"{name}.toml")
    count = min(MOST_SCENES.get(name, 24), len(sweep.scenes))
    few = np.linspace(0, len(sweep.scenes) - 1, count).astype(int)
    scenes = tuple(sweep.scenes[i] for i in few)
    sweep = replace(sweep, scenes=scenes, axes=(), dims={"scene": len(scenes)})
    options = TraceOptions(photons=2000, backend=jit_backend.name)
    reports = done_here(sweep, Settings.of(tmp_path / "b", options, sweep.study))
    assert reports == [("done", "")] * len(few)


def test_scenes_with_factors_on_vessels_are_hashable():
    """Scenes that share their light are grouped by what is read of it: equal ones must have one hash."""
    text = (SCENES / "prototype.toml").read_text()
    factors = "[blood.tuning.factors]\nvein_stiffness_n_per_m = 2.0\nvein_count = 3.0\n"
    swapped = "[blood.tuning.factors]\nvein_count = 3.0\nvein_stiffness_n_per_m = 2.0\n"
    first, second = (parse_scene(f"{text}\n{one}") for one in (factors, swapped))
    assert first == second and hash(first) == hash(second)
    assert hash(first) != hash(parse_scene(f"{text}\n{factors.replace('3.0', '4.0')}"))

"""Ctrl-C, a real one: whatever a command does, it ends soon, and reports correctly what is kept."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import xarray as xr
from fewer_photons import FEW_NODES
from interrupted import ENVIRONMENT, Interrupting, interrupted_at
from small_scenes import SMALL_FINGER_BEST

from nailoptics.report.pages.simulate import SIMULATION
from nailoptics.scene.priors import shipped_priors
from nailoptics.studies.colour import nail_colour
from nailoptics.studies.colour.reflectance import NODES
from nailoptics.studies.exploration import explore, pair_table

BATCH = "nailoptics.studies.exploration.explore:WavelengthSums.add"
EXPLORE = ("explore", "prototype", "--photons", "12288", "-o", "page.html")
# A page of two wavelengths, with small batches, little light around its sources and a small table.
SMALL_PAGE = {
    "LEAST_BATCH": 1 << 10,
    "FURTHER_LEDS": ("led_660",),
    "FLUENCE_PHOTONS": 1 << 12,
}
# Rays of a colour's first round and of its parts, as one to ten, as they are in the package.
PILOT = 30_000
SMALL_ROUNDS = {"PILOT": PILOT, "MOST_AT_ONCE": 10 * PILOT}
FINGER = SMALL_FINGER_BEST + "[priors]\nspread = false\n"
SIMULATE = ("simulate", "finger.toml", "--photons", "8000", "-o", "out")
COMPLETE = "nailoptics: interrupted; every file that was written is complete."


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working directory that holds a small finger alone."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "finger.toml").write_text(FINGER)
    return tmp_path


@pytest.fixture
def interrupting(
    jit_backend: object, undrawn: None, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> Interrupting:
    """Interrupts commands of this process."""
    return Interrupting(monkeypatch, capfd)


@pytest.fixture
def small_page(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in SMALL_PAGE.items():
        monkeypatch.setattr(explore, name, value)
    for name, value in FEW_NODES.items():
        monkeypatch.setattr(pair_table, name, value)


def written(folder: Path) -> set[str]:
    """Files below a folder, but for the scene."""
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()} - {"finger.toml"}


@pytest.mark.long
@pytest.mark.jit
def test_explore_ends_within_a_batch_and_writes_no_page_without_all_groups(folder, interrupting, small_page):
    """A batch of every group of each wavelength gives its errors: at the third of the first nothing can be shown."""
    ended = interrupting.at(BATCH, *EXPLORE, call=3)
    assert (ended.code, ended.later) == (130, 0) and not written(folder)
    assert ended.stderr_lines[-1].startswith("nailoptics: interrupted with 3072 of 24576 photons. ")
    assert "No page was written." in ended.stderr_lines[-1]


@pytest.mark.long
@pytest.mark.jit
def test_explore_keeps_what_it_has_of_every_wavelength(folder, interrupting, small_page):
    """Expected: in the second round of batches a page of both, which reports it."""
    ended = interrupting.at(BATCH, *EXPLORE[:3], "24576", *EXPLORE[4:], call=26)
    assert (ended.code, ended.later) == (3, 0) and written(folder) == {"page.html"}
    why = "interrupted with 26624 of 36864 photons."
    assert ended.stderr_lines[-1] == f"nailoptics: {why} What was reached is in page.html."
    page = Path("page.html").read_text(encoding="utf-8")
    assert why in page.split("</header>")[0]
    assert "2 wavelengths, at least 12288 at each" in ended.out and ended.out.startswith(f"Cut off: {why}")


@pytest.mark.jit
def test_an_interrupt_between_two_results_leaves_the_first_whole(folder, interrupting, coarse_cells, store):
    ended = interrupting.at("nailoptics.report.pages.simulate:document", *SIMULATE)
    assert ended.code == 130 and written(folder / "out") == {SIMULATION.files[0]} and ended.stderr_lines[-1] == COMPLETE
    assert xr.load_dataset(folder / "out" / SIMULATION.files[0]).sizes["time"] > 0


@pytest.mark.jit
def test_the_priors_of_a_simulation_end_within_a_batch(folder, interrupting, coarse_cells, store):
    """The first trace is the scene's, the second its twin of few photons; expected: of two priors that need traces of
    their own the first is kept, the second is left out, and the page does not blame the scene for that."""
    unknown = ("finger.plate_scattering", "finger.bed_scattering", "blood.so2")
    known = [prior.field for prior in shipped_priors() if prior.field not in unknown]
    Path("finger.toml").write_text(SMALL_FINGER_BEST + f"[priors]\nknown = {json.dumps(known)}\n")
    traced = "nailoptics.light.tracing.trace_scene:LedSource.batch"
    ended = interrupting.at(traced, *SIMULATE, call=5)
    assert (ended.code, ended.later) == (3, 0) and written(folder / "out") == set(SIMULATION.files)
    assert (
        ended.stderr_lines[-1]
        == "nailoptics: interrupted; priors not traced: bed scattering. What was reached is in out."
    )
    assert ended.stderr_lines[-2] == "nailoptics: no more light is traced; writing what was reached."
    result = xr.load_dataset(folder / "out" / SIMULATION.files[0])
    how = dict(zip(result.prior_field.values.tolist(), result.prior_how.values.tolist(), strict=True))
    assert how == dict(zip(unknown, ("retraced", "not traced", "reweighted"), strict=True))
    assert "which this run has not made: bed scattering." in ended.out and "own_traces" not in ended.out
    assert interrupting.at(traced, *SIMULATE, call=2).code == 3


@pytest.mark.jit
def test_a_second_interrupt_ends_the_command_at_once(folder, chosen_jit, store):
    """It comes before the first batch is traced, or when one is to take its place in the store."""
    for place in ("nailoptics.light.tracing.trace_scene:take_batches", "nailoptics.io:os.replace"):
        ended = interrupted_at(place, *SIMULATE, twice=True)
        assert ended.code == 130 and ended.stderr_lines[-1] == COMPLETE
        assert not list(folder.rglob("*.part")) and not list(store.rglob("*.dat")) and not written(folder / "out")


@pytest.mark.long
@pytest.mark.jit
def test_the_colour_of_a_nail_is_kept_without_its_photographs(folder, interrupting):
    """While rays are walked, and while the first photograph is made; expected: no photograph is begun after it."""
    Path("finger.toml").write_text(FINGER + "[colour]\nphotograph_px = [40, 30]\n")
    command = ("colour", "finger.toml", "--photons", "8000", "--force", "0", "--force", "1", "-o", "out")
    for place in (
        "nailoptics.studies.colour.nail_colour:walk_colour",
        "nailoptics.studies.colour.nail_colour:photograph",
    ):
        ended = interrupting.at(place, *command)
        assert (ended.code, ended.later) == (3, 0), ended.stderr_lines
        assert (
            ended.stderr_lines[-1].endswith("What was reached is in out.") and "interrupted" in ended.stderr_lines[-1]
        )
        assert written(folder / "out") == {"colour.nc", "colour.html", "strip.png"}


@pytest.mark.long
@pytest.mark.jit
def test_the_rays_that_a_colour_waits_for_are_abandoned(folder, interrupting, monkeypatch):
    """Expected: at the second wavelength of the second round, of ten times as many rays, the first's are kept."""
    command = ("colour", "finger.toml", "--no-photograph", "--tolerance", "0.01", "-o", "out")
    place = "nailoptics.light.walk.nail_reflectance:NailReflectance.reflect"
    for name, value in SMALL_ROUNDS.items():
        monkeypatch.setattr(nail_colour, name, value)
    ended = interrupting.at(place, *command, call=NODES + 2)
    assert (ended.code, ended.later) == (3, 0) and "interrupted at a standard error of" in ended.stderr_lines[-1]
    assert xr.load_dataset("out/colour.nc").attrs["photons"] < 2 * PILOT


@pytest.mark.long
@pytest.mark.jit
def test_a_calibration_is_not_made_of_a_part_of_its_light(folder, interrupting, store):
    """An interrupt while light is traced, and a second one; expected: neither a fault of ours nor a subject."""
    recording = Path("recording.csv")
    names = "time_s,force_n,site,proximal.6,proximal.8,proximal.10,proximal.12,distal.3,distal.5,distal.7,distal.9"
    forces = [0.0] * 300 + ([1.0] * 50 + [0.0] * 50) * 8
    volts = [",".join([f"{0.3 + 0.01 * force + 1e-5 * (k % 7):g}"] * 8) for k, force in enumerate(forces)]
    sites = ["proximal"] * 700 + ["distal"] * 400
    rows = zip(forces, sites, volts, strict=True)
    lines = [f"{k / 100},{force},{site},{read}" for k, (force, site, read) in enumerate(rows)]
    recording.write_text("\n".join([names, *lines]) + "\n")
    command = ("calibrate", "prototype", str(recording), "-o", "me.toml", "--photons", "20000")
    for twice in (True, False):
        ended = interrupting.at("nailoptics.light.tracing.trace_scene:LedSource.batch", *command, twice=twice)
        assert (ended.code, ended.later) == (130, 0)
        assert ended.stderr_lines[-1] in (COMPLETE, "nailoptics: interrupted; no subject was written.")
        assert written(folder) - {"recording.csv"} == {str(path.relative_to(folder)) for path in store.rglob("*.dat")}


@pytest.mark.long
@pytest.mark.jit
def test_a_command_in_the_background_of_a_script_ignores_interrupts(folder, chosen_jit, store):
    """A shell lets it ignore SIGINT, which is for the script; expected: it goes on to its end."""
    ended = interrupted_at("nailoptics.light.tracing.trace_scene:take_batches", *SIMULATE, ignored=True)
    assert ended.code == 0 and written(folder / "out") == set(SIMULATION.files)
    assert not [line for line in ended.stderr_lines if "interrupt" in line or "stopping" in line]


def alone(code: str) -> tuple[int, str]:
    """Exit code and stderr of Python that runs some code, in which SIGINT reaches it."""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, env=os.environ | ENVIRONMENT
    )
    return done.returncode, done.stderr


NOTHING = (130, f"{COMPLETE}\n")


def test_an_interrupt_within_compiled_code_is_no_internal_error():
    code = """
import os, signal, sys, nailoptics.scene
from nailoptics.__main__ import main
def turning():
    try:
        os.kill(os.getpid(), signal.SIGINT)
    except BaseException:
        raise NameError("name '_drjit_ext' is not defined") from None
nailoptics.scene.json_schema = turning
sys.argv[1:] = ["schema"]
main()
"""
    assert alone(code) == NOTHING


def test_an_interrupt_while_the_command_line_is_loaded_makes_no_traceback():
    code = """
import os, signal, sys
from nailoptics.__main__ import main
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == "nailoptics.cli":
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Finder())
main()
"""
    assert alone(code) == (-signal.SIGINT, "")


def test_interrupts_reach_commands_of_background_tests():
    """Tests that a script starts in its background begin with SIGINT ignored."""
    one = f"{__file__}::{test_an_interrupt_while_the_command_line_is_loaded_makes_no_traceback.__name__}"
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-n", "0", one],
        capture_output=True,
        text=True,
        timeout=120,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_IGN),
    )
    assert done.returncode == 0, done.stdout

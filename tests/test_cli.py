"""The command line: what it prints and writes, its exit codes, and one plain line for every mistake."""

import json
import math
import os
import pty
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from listed_variables import assert_listed
from small_scenes import SMALL_FINGER, phantom

import nailoptics
from nailoptics import terminal
from nailoptics.batch.run import BatchProgress
from nailoptics.cli import run
from nailoptics.errors import InputError, NotReachedError
from nailoptics.hemodynamics import parameters
from nailoptics.io import to_json
from nailoptics.light import TraceProgress, Transfer, backend
from nailoptics.paper.claims import as_rows, evaluate
from nailoptics.paper.responses import simulate_responses
from nailoptics.studies.colour import nail_colour
from nailoptics.studies.exploration.explore import FURTHER_LEDS
from nailoptics.terminal import show_progress
from nailoptics.version import commit

ROOT = Path(nailoptics.__file__).parents[1]
PROTOTYPE = (ROOT / "scenes/prototype.toml").read_text(encoding="utf-8")
# Without scattering and thickness of the finger varied, each of which takes traces of its own.
QUICK = PROTOTYPE + "\n[priors]\nown_traces = false\n"
PHANTOM = phantom(
    {"thickness_mm": 2.0, "mu_a_per_mm": 0.1, "g": 0.5, "n": 1.4},
    photodiodes=[{"position_mm": [1.0, 0.0], "size_mm": [1.0, 1.0]}],
)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """An empty working directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def contents(folder: Path) -> dict[str, bytes | None]:
    return {str(p.relative_to(folder)): p.read_bytes() if p.is_file() else None for p in folder.rglob("*")}


def spawn(*arguments, **options) -> subprocess.CompletedProcess:
    """The command in a process of its own."""
    environment = os.environ | {"PYTHONPATH": str(ROOT)} | options.pop("env", {})
    return subprocess.run(
        [sys.executable, "-m", "nailoptics", *arguments],
        capture_output=True,
        text=True,
        timeout=120,
        env=environment,
        **options,
    )


def changed(old: str, new: str) -> str:
    """The prototype with one thing wrong."""
    assert PROTOTYPE.count(old) == 1, old
    return PROTOTYPE.replace(old, new)


RECORDED = changed('profile = "step"', 'profile = "recorded"\nfile = "touch.csv"')
BAD_SCENES = {
    "an unknown field": (changed("digit =", "digitt ="), "digitt"),
    "a part that is not there": (changed("led_800", "led_801"), "led_801"),
    "a recording that is not there": (RECORDED, "touch.csv"),
    "a recording whose time stands still": (RECORDED, "touch.csv", "time_s,force_n\n0,0\n1,1\n1,2\n"),
    "an unknown hemodynamic set": (changed('parameters = "best"', 'parameters = "bset"'), "bset"),
    "no TOML": ("this is no scene", "TOML"),
    "more blood than the bed can hold": (
        changed("rest_blood_fraction = 0.03", "rest_blood_fraction = 1.0"),
        "lower blood.rest_blood_fraction = 1 or",
    ),
    "an engine that the backend cannot run": (changed("[light]", '[light]\nengine = "photons"'), "scalar"),
}


@pytest.mark.parametrize("mistake", BAD_SCENES)
def test_a_bad_scene_is_one_line_and_exit_code_2_and_nothing_is_written(mistake, folder, capfd):
    text, word, *recording = BAD_SCENES[mistake]
    (folder / "scene.toml").write_text(text, encoding="utf-8")
    if recording:
        (folder / "touch.csv").write_text(recording[0], encoding="utf-8")
    before = contents(folder)
    assert run(["simulate", "scene.toml", "-o", "deep/results", "--backend", "scalar"]) == 2
    out, err = capfd.readouterr()
    assert out == "" and len(err.splitlines()) == 1 and err.startswith("nailoptics: ")
    assert word in err and "Traceback" not in err
    assert contents(folder) == before


BAD_COMMANDS = {
    "an unknown command": (["simulte", "prototype"], "simulte"),
    "an unknown option": (["simulate", "prototype", "--fast"], "--fast"),
    "an option without its value": (["simulate", "prototype", "-o"], "-o"),
    "no scene": (["simulate"], 'Command "simulate" needs SCENE.'),
    "no scene, and an option": (["protocol", "-o", "deep/protocol"], 'Command "protocol" needs SCENE.'),
    "no file for a mesh": (["export", "prototype"], "parameter --output requires an argument"),
    "time below 0": (
        ["simulate", "prototype", "--max-seconds", "-5"],
        ": --max-seconds = -5.0; must be a number above 0",
    ),
    "a force below 0": (["colour", "nail_colour", "--force", "-1"], ": --force[0] = -1.0: must be greater"),
    "no donning": (["protocol", "prototype", "--donnings", "0"], ": --donnings = 0 must be a whole number from 1"),
    "one scene too many": (["check", "prototype", "prototype"], "prototype"),
    "a scene that is not there": (["simulate", "missing.toml"], "missing.toml"),
    "a name that is no shipped scene": (["simulate", "protoype"], "shipped: "),
    "a folder for a scene": (["simulate", "."], "."),
    "a scene's name too long to be one": (["check", "x" * 300], "xxx"),
    "a binary file for a scene": (["check", sys.executable], "not a text file"),
    "a backend that does not exist": (["simulate", "prototype", "--backend", "gpu"], "scalar"),
    "a tolerance that is no number": (["simulate", "prototype", "--relative-error", "nan"], ": --relative-error = nan"),
    "a tolerance in words": (["simulate", "prototype", "--relative-error", "1%"], "1%"),
    "half a photon": (["simulate", "prototype", "--photons", "2.5"], "2.5 is not a whole number"),
    "a folder below a file": (["simulate", "prototype", "-o", "existing/sub"], "existing/sub"),
    "a file below a file": (["trace", "prototype", "-o", "existing/sub/transfer.nc"], "existing/sub"),
    "a folder in the place of a file": (["trace", "prototype", "-o", "full"], "full"),
    "a folder where result.nc will be": (["simulate", "prototype", "-o", "full"], "result.nc"),
    "pictures below a file": (["figures", "-o", "existing/sub"], "existing/sub"),
    "a mesh below a file": (["export", "prototype", "-o", "existing/sub/finger.glb"], "existing/sub"),
    "a mesh of no known kind": (["export", "prototype", "-o", "finger.stl"], ".ply"),
    "a mesh of a phantom": (["export", "phantom.toml", "-o", "deep/phantom.glb"], "phantom"),
    "a touch on a phantom": (["simulate", "phantom.toml", "-o", "deep/results"], "phantom"),
    "a transfer of volpath": (["trace", "prototype", "--backend", "scalar", "-o", "deep/transfer.nc"], "volpath"),
    "a requirement in percent": (
        ["compare", "prototype", "--require", "5"],
        "--require = 5 must lie above 0 and",
    ),
    "a requirement of all": (["compare", "prototype", "--require", "1"], "give 0.05 for 5 %"),
    "a tolerance of 0": (
        ["tradeoff", "prototype", "--tolerance", "0"],
        ": --tolerance = 0 must lie above 0 and below 1",
    ),
    "a tolerance in percent": (["explain", "prototype", "--tolerance", "2"], "must lie above 0 and below 1; give 0.05"),
    "an unknown set": (["figures", "-o", "deep/pictures", "--set", "nonsense"], "nonsense"),
}


@pytest.mark.parametrize("mistake", BAD_COMMANDS)
def test_an_invalid_command_is_one_line_and_exit_code_2(mistake, folder, capfd):
    arguments, word = BAD_COMMANDS[mistake]
    (folder / "existing").write_text("a file")
    (folder / "full/result.nc").mkdir(parents=True)
    (folder / "phantom.toml").write_text(PHANTOM)
    before = contents(folder)
    assert run(arguments) == 2
    out, err = capfd.readouterr()
    assert out == "" and len(err.splitlines()) == 1 and err.startswith("nailoptics: ")
    assert word in err and "Traceback" not in err and "internal error" not in err
    assert contents(folder) == before


def test_a_read_only_folder_is_refused_before_light_is_traced(folder, capfd, monkeypatch):
    """Rationale: the tests may run as root, whom no permission stops; so touching a file fails by order."""

    def refuse(self, *_, **__):
        raise PermissionError(13, "Permission denied", str(self))

    monkeypatch.setattr(Path, "touch", refuse)
    monkeypatch.setattr("nailoptics.studies.simulate.simulate", lambda *_, **__: pytest.fail("light was traced"))
    assert run(["simulate", "prototype", "-o", "locked/below"]) == 2
    assert "locked/below: cannot be written: Permission denied" in capfd.readouterr().err
    assert contents(folder) == {}


def test_mistakes_in_a_process_of_their_own_leave_one_line_too(folder):
    for arguments in (["simulate", "missing.toml"], ["check", "prototype", "--wat"], ["wat"]):
        done = spawn(*arguments)
        assert (done.returncode, done.stdout, len(done.stderr.splitlines())) == (2, "", 1), done


def test_an_internal_error_is_one_line_and_exit_code_1(capfd, monkeypatch):
    monkeypatch.setattr("nailoptics.scene.json_schema", lambda: 1 / 0)
    assert run(["schema"]) == 1
    err = capfd.readouterr().err
    assert len(err.splitlines()) == 1 and "ZeroDivisionError" in err and "NAILOPTICS_DEBUG=1" in err
    monkeypatch.setenv("NAILOPTICS_DEBUG", "1")
    with pytest.raises(ZeroDivisionError):
        run(["schema"])


def test_names_with_terminal_control_characters_are_escaped(folder, capfd, coarse_light):
    """A name that clears the screen, renames the window or turns the writing round, in a file's name and in a scene."""
    name = "a\x1b[2J\x1b]0;b\x07\u202ec\nd"
    part = 'part = "led_800"'
    assert part in SMALL_FINGER
    (folder / f"{name}.toml").write_text(SMALL_FINGER)
    (folder / "part.toml").write_text(SMALL_FINGER.replace(part, 'part = "a\\u001b[2J\\u001b]0;b\\u0007\\u202ec\\nd"'))
    shown = "a\\x1b[2J\\x1b]0;b\\x07\\u202ec"
    codes = [run(["check", f"{name}.toml"]), run(["check", f"no{name}.toml"]), run(["check", "part.toml"])]
    out, err = capfd.readouterr()
    assert codes == [0, 2, 2] and out.startswith(f"{shown}\\nd.toml: ") and err.count(shown) == 2
    assert len(err.splitlines()) == 2
    assert (out + err).replace("\n", "").isprintable()


def test_names_that_the_terminals_encoding_lacks_are_escaped(folder, coarse_light):
    (folder / "\u6307\u7532.toml").write_text(SMALL_FINGER)
    done = spawn("check", "\u6307\u7532.toml", env={"PYTHONIOENCODING": "ascii"})
    assert done.returncode == 0 and done.stdout.startswith(r"\u6307\u7532.toml: "), done.stderr


def test_an_early_interrupt_is_one_line_and_exit_code_130(capfd, monkeypatch):
    def interrupt():
        raise KeyboardInterrupt

    monkeypatch.setattr("nailoptics.scene.json_schema", interrupt)
    assert run(["schema"]) == 130
    assert len(capfd.readouterr().err.splitlines()) == 1


def test_help_and_version_are_quick_and_on_stdout(folder):
    for arguments in ([], ["--help"], ["simulate", "--help"], ["--version"]):
        done = spawn(*arguments)
        assert done.returncode == 0 and done.stdout and not done.stderr
    shown = spawn("--version").stdout.strip()
    known = commit()
    assert shown == (f"{nailoptics.__version__} (commit {known[:12]})" if known else nailoptics.__version__)


def test_a_command_loads_nothing_that_it_has_no_use_for(folder):
    """Rationale: imports were a third of what a short command costs. Expected: no Dask where no cluster is requested,
    no Mitsuba and no scipy.spatial where no light is traced; and a cluster, where requested, still gets Dask."""
    code = """if True:
        import sys
        from nailoptics.cli import main
        from nailoptics.io import unblock_dask_import
        sys.argv[1:] = ["protocol", "prototype", "-o", "protocol.csv"]
        try:
            main()
        except SystemExit as ended:
            assert ended.code == 0
        print("loaded", *({"dask.array", "distributed", "mitsuba", "scipy.spatial"} & set(sys.modules)))
        unblock_dask_import()
        import distributed
    """
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0 and done.stdout.splitlines()[-1] == "loaded", done.stdout + done.stderr


def test_a_reader_that_closes_the_pipe_is_no_error(folder):
    """`nailoptics schema | head -c 1`: no traceback, no complaint when Python ends."""
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(
        [sys.executable, "-m", "nailoptics", "schema"],
        stdout=writing,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    os.close(writing)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
def test_a_full_disk_behind_stdout_is_one_line(folder):
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "nailoptics", "schema"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | {"PYTHONPATH": str(ROOT)},
        )
    assert done.returncode == 1 and len(done.stderr.splitlines()) == 1 and "No space left" in done.stderr


def only_json(capfd) -> dict:
    """What was printed, which must be one JSON object without NaN, and nothing else."""

    def refuse(constant):
        raise AssertionError(f"{constant} is not JSON")

    out = capfd.readouterr().out
    result = json.loads(out, parse_constant=refuse)
    assert isinstance(result, dict) and out.startswith("{") and out.endswith("}\n")
    return result


def assert_traced(result: dict, *, engine: str, name: str) -> None:
    known = {"readings", "energy", "photons", "engine", "backend", "cpu_seconds", "wall_seconds", "reused"}
    assert set(result) - known == ({"absorbed", "note"} if engine == "photons" else set()) and known <= set(result)
    assert (result["engine"], result["backend"]) == (engine, name)
    assert result["photons"] > 0 and result["cpu_seconds"] > 0 and result["wall_seconds"] > 0
    for row in result["readings"]:
        assert {
            "led",
            "photodiode",
            "wavelength_nm",
            "detected_fraction",
            "stderr",
            "mean_path_mm",
            "mean_path_stderr_mm",
        } <= set(row)
        assert 0 < row["detected_fraction"] < 1 and 0 < row["stderr"] < row["detected_fraction"]
        assert set(row["mean_path_mm"]) == set(row["mean_path_stderr_mm"])
    for part in result["energy"].values() if result["energy"] else ():
        assert set(part) == {"value", "stderr"}


@pytest.mark.parametrize("backend_name", [pytest.param("auto", marks=pytest.mark.jit), "scalar"])
def test_trace_of_a_phantom_prints_the_agreed_json(backend_name, folder, capfd, request):
    chosen = request.getfixturevalue("chosen_jit") if backend_name == "auto" else backend.choose("scalar")
    (folder / "phantom.toml").write_text(PHANTOM)
    assert run(["trace", "phantom.toml", "--json", "--photons", "2e4", "--backend", backend_name]) == 0
    result = only_json(capfd)
    assert_traced(result, engine="photons" if chosen.jit else "volpath", name=chosen.name)
    assert set(result["energy"]) == {"reflected", "transmitted", "absorbed", "lost"}
    assert sum(part["value"] for part in result["energy"].values()) == pytest.approx(1, abs=1e-3)
    assert result["photons"] == 20000 and contents(folder).keys() == {"phantom.toml"}


@pytest.mark.long
def test_both_backends_print_the_same_light_of_a_phantom(folder, capfd, chosen_jit):
    (folder / "phantom.toml").write_text(PHANTOM)
    result = []
    for name in (chosen_jit.name, "scalar"):
        assert run(["trace", "phantom.toml", "--json", "--relative-error", "0.02", "--backend", name]) == 0
        result.append(only_json(capfd))
    one, two = (f["readings"][0] for f in result)
    stderr = (one["stderr"] ** 2 + two["stderr"] ** 2) ** 0.5
    assert abs(one["detected_fraction"] - two["detected_fraction"]) < 4 * stderr < 0.1 * one["detected_fraction"]
    for part in ("reflected", "transmitted", "absorbed"):
        a, b = (f["energy"][part] for f in result)
        assert abs(a["value"] - b["value"]) < 4 * (a["stderr"] ** 2 + b["stderr"] ** 2) ** 0.5 < 0.1 * a["value"]


@pytest.mark.jit
def test_trace_of_a_finger_prints_the_agreed_json_and_keeps_the_transfer(folder, capfd, chosen_jit):
    options = ["--photons", "20000", "--seed", "3", "--json"]
    assert run(["trace", "prototype", *options, "-o", "deep/transfer.nc"]) == 0
    result = only_json(capfd)
    assert result.pop("transfer") == "deep/transfer.nc"
    assert_traced(result, engine="photons", name=chosen_jit.name)
    assert len(result["readings"]) == 8 and result["photons"] == 20_000
    assert {"plate", "bed_1", "bed_2", "epoxy"} <= set(result["readings"][0]["mean_path_mm"])
    assert contents(folder).keys() == {"deep", "deep/transfer.nc"}
    again = Transfer.load(Path("deep/transfer.nc")).at()
    first = result["readings"][0]
    assert float(again.detected_fraction[0, 0]) == first["detected_fraction"]


@pytest.mark.long
@pytest.mark.jit
def test_what_was_reached_in_max_seconds_is_saved_and_the_exit_code_is_3(folder, capfd, chosen_jit):
    options = ["--relative-error", "0.001", "--max-seconds", "0.5"]
    assert run(["trace", "prototype", *options, "-o", "transfer.nc", "--json"]) == 3
    out, err = capfd.readouterr()
    assert json.loads(out)["photons"] > 0
    last = err.splitlines()[-1]
    assert "max_seconds" in last and "0.001 requested" in last and "transfer.nc" in last and "Traceback" not in err
    assert json.loads(out)["cut_off"] in last
    assert Transfer.load(Path("transfer.nc")).photons == json.loads(out)["photons"]


def test_scalar_phantoms_stop_at_max_seconds_with_exit_code_3(folder, capfd):
    (folder / "phantom.toml").write_text(PHANTOM)
    options = ["--backend", "scalar", "--relative-error", "1e-6", "--max-seconds", "0.1", "--json"]
    assert run(["trace", "phantom.toml", *options]) == 3
    out, err = capfd.readouterr()
    assert json.loads(out)["readings"][0]["detected_fraction"] > 0 and "max_seconds" in err.splitlines()[-1]


@pytest.mark.long
@pytest.mark.jit
def test_a_photodiode_without_light_is_reported(folder, capfd, chosen_jit):
    """Without detected photons there is no standard error; it must not be reported as 0, nor break the JSON."""
    (folder / "quick.toml").write_text(QUICK)
    assert run(["simulate", "quick.toml", "--photons", "1000", "-o", "few", "--json"]) == 0
    out, err = capfd.readouterr()
    rows = json.loads(out)["readings"]
    assert any(row["volts_start_stderr"] is None for row in rows) and "detected no light" in err
    # No reading is above 1, and of one photon it is not even significantly below 0.94.
    for photons, limit in (("5", -math.expm1(math.log(0.05) / 5)), ("1", 0.95)):
        assert run(["trace", "quick.toml", "--photons", photons, "--json"]) == 0
        limits = {row["upper_limit_95"] for row in only_json(capfd)["readings"] if "upper_limit_95" in row}
        assert limits and all(one == pytest.approx(limit) for one in limits)


def test_the_help_of_explore_names_all_wavelengths_that_it_traces(capsys):
    assert run(["explore", "--help"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "--photons is for each of the scene's wavelengths, half of it for 660 and 940 nm." in shown
    assert {f"led_{nm}" for nm in (660, 940)} == {*FURTHER_LEDS}


@pytest.mark.jit
def test_few_photons_have_no_standard_error(folder, capfd, chosen_jit):
    """One photon has no spread, and that of a few is no estimate; neither must pass for exact, nor break the JSON."""
    (folder / "phantom.toml").write_text(PHANTOM)
    for photons in ("1", "4"):
        assert run(["trace", "phantom.toml", "--photons", photons, "--json"]) == 0
        out, err = capfd.readouterr()
        printed = json.loads(out)
        assert printed["readings"][0]["stderr"] is None and "too few photons to estimate a standard error" in err
        assert all((part["stderr"] is None) == (photons == "1") for part in printed["energy"].values())
        assert run(["trace", "phantom.toml", "--photons", photons]) == 0
        head, reading = capfd.readouterr().out.splitlines()[:2]
        assert head == "LED, photodiode, detected fraction of the emitted power [1]"
        assert reading.endswith(("+- unknown", "(95 %)")) and "+- 0.0" not in reading
    assert run(["trace", "phantom.toml", "--photons", "100000", "--json"]) == 0
    out, err = capfd.readouterr()
    assert json.loads(out)["readings"][0]["stderr"] > 0 and "too few" not in err


@pytest.mark.jit
def test_simulate_writes_its_two_files_and_prints_where(folder, capfd, chosen_jit):
    (folder / "quick.toml").write_text(QUICK)
    assert run(["simulate", "quick.toml", "--photons", "30000"]) == 0
    out, err = capfd.readouterr()
    files = ["results/quick/report.html", "results/quick/result.nc"]
    assert contents(folder).keys() == {"quick.toml", "results", "results/quick", *files}
    assert out.splitlines()[-2:] == files
    rows = [line for line in out.splitlines() if line.split()[:1] == ["ir"]]
    assert len(rows) == 9 and "absorbed in " in rows[8]  # eight photodiodes, and where the light ended
    page = Path(files[0]).read_text(encoding="utf-8")
    assert "<svg" in page or "data:image" in page
    assert not re.search(r"<(script|link|img)[^>]+(src|href)=.http", page)
    assert_listed(folder, "result.nc")
    assert all(line.startswith("nailoptics: LED ir, error ") for line in err.splitlines()), err


def test_a_shipped_scene_is_found_by_name_from_anywhere(folder, capfd, coarse_light):
    for name in ("prototype", "prototype.toml", "scenes/prototype.toml"):
        assert run(["check", name, "--json"]) == 0
        result = only_json(capfd)
        assert result["valid"] and result["triangles"] > 1000
        assert result["two_balances_n"] is None
    (folder / "prototype.toml").write_text(PHANTOM)
    assert run(["check", "prototype.toml", "--json"]) == 0
    assert "regions" not in only_json(capfd)  # the user's own file comes first
    assert contents(folder).keys() == {"prototype.toml"}


def test_export_writes_meshes_that_trimesh_reads(folder, capfd):
    import trimesh

    assert run(["export", "prototype", "-o", "deep/finger.glb"]) == 0
    assert run(["export", "prototype", "-o", "finger.PLY"]) == 0
    assert capfd.readouterr().out.split() == ["deep/finger.glb", "finger.PLY"]
    loaded = trimesh.load("deep/finger.glb")
    assert {"plate", "bed", "bone", "led:ir"} <= set(loaded.geometry)
    assert (folder / "finger.PLY").read_bytes().startswith(b"ply")
    assert contents(folder).keys() == {"deep", "deep/finger.glb", "finger.PLY"}


def test_schema_and_doctor_print_json(folder, capfd):
    assert run(["schema"]) == 0
    assert only_json(capfd)["$schema"].startswith("https://json-schema.org/")
    assert run(["doctor", "--json"]) == 0
    result = only_json(capfd)
    assert {row["backend"] for row in result["findings"]} == {"cuda", "llvm", "metal", "scalar"}
    assert all(set(row["engines"]) <= {"photons", "volpath"} for row in result["findings"])
    assert all(row["usable"] == bool(row["engines"]) for row in result["findings"])
    for engine, name in result["engines"].items():
        serving = {row["backend"] for row in result["findings"] if engine in row["engines"]}
        assert name in serving or (name is None and not serving)
    assert run(["doctor"]) == 0
    text = capfd.readouterr().out
    assert "selected" in text and "scalar" in text


@pytest.mark.long
def test_figures_draws_and_evaluates_a_set(folder, capfd):
    assert run(["figures", "-o", "pictures", "--set", "best", "--no-colour", "--json"]) == 0
    result = only_json(capfd)
    assert all((folder / picture).stat().st_size > 10_000 for picture in result["pictures"])
    expected = as_rows({"best": evaluate(simulate_responses(parameters("best")), "best")})
    assert (
        result["claims"] == json.loads(to_json(expected)) and len({row["sets"]["best"]["met"] for row in expected}) == 2
    )


@pytest.mark.slow
def test_figures_of_people_are_drawn_and_evaluated_beside_a_set(folder, capfd, monkeypatch):
    from nailoptics.studies import people

    scenes = people.people()[:3]
    monkeypatch.setattr(people, "people", lambda: scenes)
    monkeypatch.setattr(people, "PHOTONS", 1 << 14)
    assert run(["figures", "-o", "pictures", "--set", "best", "--no-colour", "--people"]) == 0
    printed = capfd.readouterr().out
    assert "people" in printed.splitlines()[0] and "+-" in printed and "skin does not matter" in printed
    assert (folder / "pictures/people_fig15_to_18.png").stat().st_size > 100_000


@pytest.mark.long
def test_an_invalid_library_costs_the_main_job_nothing_but_speed(folder):
    """Rationale: DRJIT_LIBLLVM_PATH may point to a text file, or to a library that aborts the process.
    Expected: one line of advice, then the scalar backend's answer."""
    (folder / "phantom.toml").write_text(PHANTOM)
    broken = folder / "libLLVM-99.so"
    broken.write_text("not a library")
    environment = {
        "DRJIT_LIBLLVM_PATH": str(broken),
        "XDG_CACHE_HOME": str(folder / "cache"),
        "CUDA_VISIBLE_DEVICES": "",
    }
    done = spawn("trace", "phantom.toml", "--json", "--photons", "2000", env=environment)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["backend"] == "scalar"
    advice, *progress = done.stderr.splitlines()
    assert "libllvm19" in advice and all("LED beam" in line for line in progress)
    done = spawn("trace", "phantom.toml", "--backend", "llvm", env=environment)
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1 and broken.name in done.stderr


@pytest.mark.long
def test_an_aborting_library_does_not_crash_the_main_job(folder):
    """Rationale: a broken libLLVM aborts the process that runs a kernel. Expected: whatever process tries one dies,
    really, and the command still answers, with its line of advice."""
    (folder / "phantom.toml").write_text(PHANTOM)
    (folder / "libLLVM-15.so").write_text("stands for one that aborts")
    (folder / "path").mkdir()
    (folder / "path/sitecustomize.py").write_text("import os, sys\nif '-c' in sys.orig_argv:\n    os.abort()\n")
    environment = {
        "DRJIT_LIBLLVM_PATH": str(folder / "libLLVM-15.so"),
        "XDG_CACHE_HOME": str(folder / "cache"),
        "CUDA_VISIBLE_DEVICES": "",
        "PYTHONPATH": os.pathsep.join([str(folder / "path"), str(ROOT)]),
    }
    done = spawn("trace", "phantom.toml", "--json", "--photons", "2000", env=environment)
    assert done.returncode == 0 and json.loads(done.stdout)["backend"] == "scalar", done.stderr
    assert "libllvm19" in done.stderr.splitlines()[0]
    assert "SIGABRT" in spawn("doctor", env=environment).stdout


@pytest.mark.long
def test_volpath_falls_back_to_scalar_where_its_library_aborts(folder):
    """Rationale: libLLVM 15 and 16 compile the photons engine, and abort at volpath. Expected: volpath's answer comes
    from the scalar backend, after one line that reports it, and doctor distinguishes the two engines."""
    (folder / "stock.toml").write_text(PHANTOM + '\n[light]\nengine = "volpath"\n')
    (folder / "libLLVM-15.so").write_text("stands for one that aborts")
    (folder / "path").mkdir()
    dies = "import os, sys\nif '-c' in sys.orig_argv:\n    print('photons', flush=True)\n    os.abort()\n"
    (folder / "path/sitecustomize.py").write_text(dies)
    environment = {
        "DRJIT_LIBLLVM_PATH": str(folder / "libLLVM-15.so"),
        "XDG_CACHE_HOME": str(folder / "cache"),
        "CUDA_VISIBLE_DEVICES": "",
        "PYTHONPATH": os.pathsep.join([str(folder / "path"), str(ROOT)]),
    }
    result = json.loads(spawn("doctor", "--json", env=environment).stdout)
    assert result["backend"] == "llvm" and result["engines"] == {"photons": "llvm", "volpath": "scalar"}
    lines = spawn("doctor", env=environment).stdout
    assert "selected for volpath" in lines and "libllvm19" in lines.splitlines()[-1]
    for name in ("auto", "llvm"):
        done = spawn("trace", "stock.toml", "--json", "--photons", "2000", "--backend", name, env=environment)
        assert done.returncode == 0, done.stderr
        assert [json.loads(done.stdout)[key] for key in ("engine", "backend")] == ["volpath", "scalar"]
        assert done.stderr.splitlines()[0].startswith("nailoptics: volpath traces with the slow scalar backend")
        assert done.stderr.count("scalar") == 1


@pytest.mark.long
def test_progress_is_plain_lines_in_a_log_and_a_bar_on_a_terminal(folder):
    (folder / "phantom.toml").write_text(PHANTOM)
    arguments = ["trace", "phantom.toml", "--backend", "scalar", "--photons", "20000"]
    logged = spawn(*arguments).stderr
    assert logged.startswith("nailoptics: LED beam, error ") and "\x1b" not in logged and "\r" not in logged
    assert len(logged.splitlines()) == 1
    shown = on_terminal(arguments)
    assert "LED beam" in shown and "\x1b[" in shown and "━" in shown and "Traceback" not in shown


def test_python_shows_progress_in_one_line_that_is_overwritten(capsys):
    of_led = TraceProgress("ir", 1000, 0.031, 0.02, 0.4, 2.0)
    for p in (of_led, replace(of_led, fraction_done=1.0, relative_error=0.02)):
        show_progress(p)
    show_progress(BatchProgress(3, 4, 1, 9.0, 0.0))
    shown, lines = capsys.readouterr(), []
    lines = [line.strip() for line in shown.err.split("\r")[1:]]
    assert not shown.out and lines[:1] == ["LED ir, error 3.10% (2.00% requested), 3 s left"]
    assert lines[1] == "LED ir, error 2.00% (2.00% requested)" and shown.err.count("\n") == 2
    assert lines[2] == "batch, 3 of 4 scenes, 1 failed"


def on_terminal(arguments: list[str]) -> str:
    """What the command shows on a terminal."""
    main, side = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-m", "nailoptics", *arguments],
        stdout=subprocess.PIPE,
        stderr=side,
        env=os.environ | {"PYTHONPATH": str(ROOT), "TERM": "xterm", "COLUMNS": "100"},
    )
    os.close(side)
    shown = b""
    while True:
        try:
            piece = os.read(main, 4096)
        except OSError:  # the terminal is gone with the process
            break
        if not piece:
            break
        shown += piece
    os.close(main)
    assert process.stdout is not None
    process.stdout.close()
    assert process.wait(60) == 0
    return shown.decode(errors="replace")


@pytest.mark.long
@pytest.mark.jit
def test_ctrl_c_keeps_what_was_traced(folder, chosen_jit, store):
    """A real interrupt of a real process as soon as its first photons are stored."""
    process = subprocess.Popen(
        [sys.executable, "-m", "nailoptics", "trace", "prototype", "--relative-error", "0.0005", "-o", "transfer.nc"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    assert process.stderr is not None
    try:
        while not list(store.rglob("*.dat")) and process.poll() is None:
            time.sleep(0.02)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 3, err
    assert "interrupted" in err.splitlines()[-1] and "Traceback" not in err
    assert Transfer.load(Path("transfer.nc")).photons > 0 and len(out.splitlines()) == 17
    assert out.startswith("Cut off: interrupted")


@pytest.mark.parametrize(
    "arguments",
    [
        ["simulate", "prototype"],
        ["trace", "prototype"],
        ["compare", "prototype"],
        ["explain", "prototype"],
        ["tradeoff", "prototype"],
        ["place", "placement"],
        ["oximeter", "pulse_oximeter"],
        ["colour", "nail_colour"],
        ["explore", "prototype"],
        ["calibrate", "prototype", "recording.csv"],
        ["batch", str(ROOT / "scenes/sweeps/vein_stiffness.toml"), "-o", "sweep"],
    ],
    ids=lambda arguments: arguments[0],
)
def test_max_seconds_bounds_the_tracing_with_a_reserve_for_the_rest(arguments, monkeypatch, folder):
    given: list[float] = []

    def ended(*_, **options):
        given.append(options["max_seconds"])
        raise InputError("enough")

    monkeypatch.setattr(terminal, "as_far_as_reached", ended)
    assert run([*arguments, "--max-seconds", "600", "--backend", "scalar"]) == 2
    assert given == [600 * (1 - terminal.RESERVE)]


@pytest.mark.parametrize(
    ("options", "unmet", "made"),
    [
        ([], "", 1),
        (["--max-seconds", "60"], "", 0),
        (["--max-seconds", "60", "--photograph"], "", 1),
        (["--max-seconds", "60", "--photograph"], "max_seconds ended the rays", 1),
        (["--photograph"], "interrupted", 0),
        (["--no-photograph"], "", 0),
    ],
    ids=str,
)
def test_photographs_are_made_unless_there_is_a_time_limit(options, unmet, made, monkeypatch, folder):
    """Expected: where requested, they are made of the rays that the time allowed, but not after Ctrl-C."""
    calls: list[int] = []

    def ended(*_, **__):
        raise InputError("enough")

    of_one_state = SimpleNamespace(sizes={"state": 1, "tile": 1})
    monkeypatch.setattr(
        terminal, "as_far_as_reached", lambda *_, **__: (of_one_state, NotReachedError(unmet) if unmet else None)
    )
    monkeypatch.setattr(nail_colour, "photographs", lambda *_, **__: [calls.append(1)])
    monkeypatch.setattr("nailoptics.report.files.Report.write", ended)
    assert run(["colour", "nail_colour", "--backend", "scalar", *options]) == 2
    assert len(calls) == made


@pytest.mark.skipif(sys.platform == "win32", reason="bash completes")
def test_the_tab_key_completes_commands_and_formats(folder):
    environment = {"HOME": str(folder)}
    done = spawn("--install-completion", "--shell", "bash", env=environment)
    assert done.returncode == 0, done.stderr
    script = next(path for path in folder.rglob("nailoptics") if "completion" in str(path))
    complete = """. "$0"; COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); _nailoptics; echo "${COMPREPLY[*]}" """
    for words, result in ((["ex"], {"explain", "explore", "export"}), (["export", "s", "--format", "sp"], {"spice"})):
        done = subprocess.run(["bash", "-c", complete, script, "nailoptics", *words], capture_output=True, text=True)
        assert set(done.stdout.split()) == result, done.stderr

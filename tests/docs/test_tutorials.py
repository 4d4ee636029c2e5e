"""What commands write has the variables that the page of output files lists, and pages type commands that exist.

The slow tests take shipped scenes as they are, and more photons, the others scenes that were made small. Notebooks run
when the pages are built, in test_pages.py.
"""

import json
import re
import runpy
import shlex
import shutil
from pathlib import Path

import pytest

import nailoptics
from nailoptics.assets import data_dir
from nailoptics.cli import app, run
from nailoptics.report import style
from nailoptics.scene import files

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
# These have photons of their own that --photons does not decide.
FEW = {
    "colour.nail_colour.OWN_PHOTONS": 2000,
    # So many, on any machine, in place of as many as there is time for.
    "model_error.paired.PILOT_PHOTONS": 1 << 16,
    "model_error.paired.PLANNED_SHARE": 0,
}
# What makes a shipped scene small: one element of each array.
SMALLER = {r"wired = \[(\d+), [^\]]*\]": r"wired = [\1]"}
# Beside `simulate` and `compare`, what writes results of the shipped scenes, with few photons.
COMMANDS = (
    "oximeter pulse_oximeter -o oximeter --recording worn.csv --photons 20000",
    "oximeter pulse_oximeter -o oximeter --readings worn.csv --photons 20000",
    "colour nail_colour -o colour --no-photograph --photons 5000",
    "tradeoff prototype -o tradeoff --tolerance 0.05 --max-seconds 60",
)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shared_light: None) -> Path:
    """An empty folder to work in, with the shipped scenes."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(ROOT / "scenes", tmp_path / "scenes")
    return tmp_path


@pytest.fixture
def small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Shipped scenes made small: what is typed stays the same."""
    shipped = shutil.copytree(data_dir("scenes"), tmp_path / "shipped")
    for one in shipped.glob("*.toml"):
        text = one.read_text(encoding="utf-8")
        for pattern, by in SMALLER.items():
            text = re.sub(pattern, by, text, flags=re.M)
        # Priors of scattering and thickness would each take traces of their own.
        one.write_text(text + "\n[priors]\nown_traces = false\n", encoding="utf-8")
    monkeypatch.setattr(files, "data_dir", lambda name: shipped if name == "scenes" else data_dir(name))


def with_few_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few photons where --photons decides none, and pages whose figures are made but not written as pictures."""
    for name, photons in FEW.items():
        monkeypatch.setattr(f"nailoptics.studies.{name}", photons)
    monkeypatch.setattr(style, "to_svg", lambda figure, **_: "<svg></svg>")
    monkeypatch.setattr(style, "write_figure", lambda figure, path, **_: path.write_bytes(b""))


def listed_as_written(folder: Path) -> None:
    """What commands wrote has the variables that the page of output files lists, under their words."""
    found = runpy.run_path(str(DOCS / "collect_variables.py"))["collect"](folder)
    listed = json.loads((DOCS / "output_variables.json").read_text(encoding="utf-8"))
    for name, made in found.items():
        for variable, words in made["variables"].items():
            known = listed[name]["variables"].get(variable)
            # A unit is not listed where it is that of what was swept.
            assert known is not None and known == words | {"units": known["units"] and words["units"]}, (name, variable)


@pytest.mark.long
@pytest.mark.jit
@pytest.mark.parametrize("small_scenes", [True, pytest.param(False, marks=pytest.mark.slow)])
@pytest.mark.filterwarnings("ignore::nailoptics.light.ReweightWarning")
def test_what_studies_write_has_the_variables_that_the_page_lists(
    small_scenes, folder, jit_backend, monkeypatch, request
):
    if small_scenes:
        request.getfixturevalue("small")
        with_few_of_its_own(monkeypatch)
    for command in COMMANDS:
        assert run(command.split()) in ({0, 3} if command.startswith("tradeoff") else {0}), command
    listed_as_written(folder)


@pytest.mark.jit
def test_what_simulate_and_compare_write_has_the_variables_that_the_page_lists(folder, small, jit_backend):
    for command in ("simulate", "compare"):
        assert run([command, "prototype", "-o", command, "--photons", "20000"]) == 0
    listed_as_written(folder)


@pytest.mark.slow
@pytest.mark.jit
def test_what_place_and_predict_write_has_the_variables_that_the_page_lists(folder, jit_backend):
    few = ["--photons", "100000"]
    assert run(["place", "placement", "-o", "placed", *few]) in {0, 3}
    assert run(["simulate", "calibration", "--recording", "known.csv", "-o", "known", *few]) == 0
    assert run(["calibrate", "calibration", "known.csv", "-o", "me.toml", *few]) == 0
    assert run(["predict", "me.toml", "known.csv", "-o", "predicted"]) == 0
    listed_as_written(folder)


def test_every_command_that_a_page_types_exists():
    """Of all pages and the README: the command and its options are known; users' files need not be there."""
    known = {name for name in app if not name.startswith("-")}
    typed = 0
    for page in [ROOT / "README.md", *DOCS.rglob("*.md")]:
        fenced = "".join(re.findall(r"^```.*?\n(.*?)^```$", page.read_text(encoding="utf-8"), re.M | re.S))
        for line in re.findall(r"^(?:\.venv/bin/)?nailoptics (.*)$", fenced, re.M):
            command, *words = shlex.split(line, comments=True)
            if command in known:
                options = {name for one in app[command].assemble_argument_collection() for name in one.names}
                given = {word for word in words if re.match(r"--?[a-z]", word)}
                assert given <= options | {"-o"}, (page.name, line)
                typed += 1
            else:
                assert command in ("--version", "--install-completion"), (page.name, line)
    assert typed > 25 and nailoptics.__version__

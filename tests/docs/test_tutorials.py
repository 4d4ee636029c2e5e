"""What commands write has the variables that the page of output files lists, and pages type commands that exist.

Here of shipped scenes as they are; each study's tests hold what it writes to the same list. Notebooks run when the
pages are built, in test_pages.py.
"""

import re
import shlex
import shutil
from pathlib import Path

import pytest
from listed_variables import assert_listed

import nailoptics
from nailoptics.cli import app, run

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
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


@pytest.mark.slow
@pytest.mark.jit
@pytest.mark.filterwarnings("ignore::nailoptics.light.ReweightWarning")
def test_what_studies_write_has_the_variables_that_the_page_lists(folder, jit_backend):
    for command in COMMANDS:
        assert run(command.split()) in ({0, 3} if command.startswith("tradeoff") else {0}), command
    for command in ("simulate", "compare"):
        assert run([command, "prototype", "-o", command, "--photons", "20000"]) == 0
    assert_listed(folder, "result.nc", "compare.nc", "oximeter.nc", "oxygen.nc", "colour.nc", "tradeoff.nc")


@pytest.mark.slow
@pytest.mark.jit
def test_what_place_and_predict_write_has_the_variables_that_the_page_lists(folder, jit_backend):
    few = ["--photons", "100000"]
    assert run(["place", "placement", "-o", "placed", *few]) in {0, 3}
    assert run(["simulate", "calibration", "--recording", "known.csv", "-o", "known", *few]) == 0
    assert run(["calibrate", "calibration", "known.csv", "-o", "me.toml", *few]) == 0
    assert run(["predict", "me.toml", "known.csv", "-o", "predicted"]) == 0
    assert_listed(folder, "result.nc", "place.nc", "predict.nc")


def test_every_command_that_a_page_types_exists():
    """Of all pages and the README: the command and its options exist; users' files need not be there."""
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

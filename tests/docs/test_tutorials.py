"""Every tutorial that is no notebook does what it says: its files are written, its commands and its Python run.

With few photons; the slow tests take shipped scenes as they are, and more photons, the others scenes that were made
small. Notebooks run when the pages are built, in test_pages.py.
"""

import json
import re
import runpy
import shlex
import shutil
from collections.abc import Iterator
from inspect import signature
from pathlib import Path

import pytest

import nailoptics
from nailoptics.assets import data_dir
from nailoptics.cli import app, run
from nailoptics.report import style
from nailoptics.scene import files

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
NOTEBOOK = "---\nfile_format: mystnb\n"
PAGES = sorted(
    page
    for page in (DOCS / "tutorials").glob("*.md")
    if page.stem != "index" and not page.read_text(encoding="utf-8").startswith(NOTEBOOK)
)
FENCE = re.compile(r"^```(?:\{code-block\} )?(\w+)\n(?::caption: (\S+)\n)?(.*?)^```$", re.M | re.S)
# Which have photons of their own that --photons does not decide, and many pictures: the slow tests take and draw them.
MANY = {"colour", "oximetry", "tradeoff"}
FEW = {
    "colour.nail_colour.OWN_PHOTONS": 2000,
    # So many, on any machine, in place of as many as there is time for.
    "model_error.paired.PILOT_PHOTONS": 1 << 16,
    "model_error.paired.PLANNED_SHARE": 0,
}
# Photons where 20 000 say too little, and where a tutorial's own limit is kept (0).
PHOTONS = {"tradeoff": 0, "oximetry": 30_000}
# Where few photons decide less than many do.
CODES = {"tradeoff": {0, 3}}
# What makes a shipped scene small: one element of each array.
SMALLER = {r"wired = \[(\d+), [^\]]*\]": r"wired = [\1]"}
OWN_LIMITS = {"--relative-error", "--photons", "--max-seconds"}


def blocks(page: Path) -> Iterator[tuple[str, str, str]]:
    """Each fenced block of a page: its language, the file that it shows if any, and its text."""
    yield from FENCE.findall(page.read_text(encoding="utf-8"))


def with_few_photons(command: list[str], photons: int) -> list[str]:
    """A command that traces light, with so many photons in place of its own limits."""
    if "options" not in signature(app[command[0]].default_command).parameters or "--dry-run" in command or not photons:
        return command
    kept = [
        word
        for i, word in enumerate(command)
        if word not in OWN_LIMITS and (i == 0 or command[i - 1] not in OWN_LIMITS)
    ]
    return [*kept, "--photons", str(photons)]


def lasting(output: str) -> set[str]:
    """What a command prints with any photons: its files and the heads of its tables, or else its first two words."""
    lines = [line.rstrip() for line in output.strip().splitlines() if not line.startswith("Cut off:")]
    files = {line for line in lines if re.fullmatch(r"\S+\.[a-z_]+", line)}
    heads = {" ".join(line.split()) for line in lines if re.search(r"\[[^\]\d]+\]  ", line)}
    return files | heads or set(re.findall("[A-Za-z]{2,}", lines[0])[:2])


def follow(page: Path, photons: int, capsys: pytest.CaptureFixture[str]) -> None:
    """Do in the current folder what a tutorial says; raises AssertionError where it does not work."""
    codes = CODES.get(page.stem, {0})
    names: dict[str, object] = {}
    printed = ""
    for language, file, text in blocks(page):
        if language == "output":
            assert lasting(text) <= lasting(printed), (page.name, printed)
            continue
        capsys.readouterr()
        if file:
            Path(file).write_text(text, encoding="utf-8")
        elif language == "sh":
            for line in text.splitlines():
                program, *command = shlex.split(line, comments=True)
                assert program == "nailoptics", line
                assert run(with_few_photons(command, photons)) in codes, (line, capsys.readouterr().err)
        elif language == "python":
            exec(compile(text, str(page), "exec"), names)
        printed = capsys.readouterr().out


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
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
@pytest.mark.filterwarnings("ignore::nailoptics.light.ReweightWarning")
def test_a_tutorial_does_what_it_says(page, folder, small, jit_backend, capsys, monkeypatch):
    if page.stem in MANY:
        with_few_of_its_own(monkeypatch)
    follow(page, {"tradeoff": 0, "colour": 5_000}.get(page.stem, 20_000), capsys)
    listed_as_written(folder)


@pytest.mark.slow
@pytest.mark.jit
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
@pytest.mark.filterwarnings("ignore::nailoptics.light.ReweightWarning")
def test_a_tutorial_does_what_it_says_with_the_shipped_scenes(page, folder, jit_backend, capsys):
    follow(page, PHOTONS.get(page.stem, 20_000), capsys)
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

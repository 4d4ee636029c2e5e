"""How the package is laid out: its rooms in order, no circles, one home for every idea, slow imports where needed."""

import ast
import os
import re
import subprocess
import sys
import tokenize
from collections import Counter
from collections.abc import Iterator
from functools import cache
from io import StringIO
from pathlib import Path

import pytest

import nailoptics
from nailoptics.report.pages.colour import COLOUR
from nailoptics.report.pages.compare import COMPARISON
from nailoptics.report.pages.force import PREDICTION
from nailoptics.report.pages.oximeter import OXIMETER, OXYGEN
from nailoptics.report.pages.placement import PLACEMENT
from nailoptics.report.pages.simulate import SIMULATION
from nailoptics.report.pages.tradeoff import TRADEOFF

PACKAGE = Path(__file__).parents[1] / "nailoptics"
# Rooms in one entry do not import each other.
ORDER = [
    {"display", "errors", "version"},
    {"assets"},
    {"statistics", "io"},
    {"variables"},
    {"checks"},
    {"options"},
    {"scene"},
    {"hemodynamics"},
    {"paper"},
    {"tissue"},
    {"geometry"},
    {"light"},
    {"sensor"},
    {"studies"},
    {"local_worker"},
    {"batch"},
    {"exports"},
    {"report"},
    {"terminal"},
    {"cli"},
    {"__main__"},
]
RANK = {room: rank for rank, rooms in enumerate(ORDER) for room in rooms}
SLOW = {"mitsuba", "drjit", "xarray", "scipy", "matplotlib", "trimesh", "colour", "netCDF4"}
FILES = sorted(PACKAGE.rglob("*.py"))


def module_name(path: Path) -> list[str]:
    parts = ["nailoptics", *path.relative_to(PACKAGE).with_suffix("").parts]
    return parts[:-1] if parts[-1] == "__init__" else parts


MODULES = {".".join(module_name(path)): path for path in FILES}


@cache
def statements(source: str) -> list[ast.AST]:
    """All statements of a source, and itself, without the expressions in them; parsed once for all tests."""
    result: list[ast.AST] = [ast.parse(source)]
    for node in result:  # grows meanwhile
        for body in ("body", "orelse", "finalbody", "handlers", "cases"):
            result += getattr(node, body, [])
    return result


def imported(source: str, module: list[str], *, package: bool) -> Iterator[str]:
    """Absolute dotted names that a module imports anywhere: functions, type checking and imports by name included."""
    yield from re.findall(r"""import_module\(["'](nailoptics[\w.]*)["']""", source)
    for node in statements(source):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = node.level - package
            base = module[: len(module) - above] if node.level else []
            stem = ".".join([*base, *([node.module] if node.module else [])])
            yield from (f"{stem}.{alias.name}" for alias in node.names)


def rooms(names: Iterator[str]) -> set[str]:
    """The rooms among dotted names; the package itself, imported by name, counts as its last room."""
    inside = [name.split(".") for name in names if name.split(".")[0] == "nailoptics"]
    return {
        parts[1] if len(parts) > 1 and parts[1] in RANK else "__main__"
        for parts in inside
        if parts[1:] != ["__version__"]
    }


def broken(source: str, module: list[str], *, package: bool) -> list[str]:
    own = module[1]
    return sorted(
        room for room in rooms(imported(source, module, package=package)) if room != own and RANK[room] >= RANK[own]
    )


def test_every_package_has_its_place_in_the_order():
    result = {path.relative_to(PACKAGE).parts[0].removesuffix(".py") for path in FILES} - {"__init__"}
    assert result <= RANK.keys()


def test_a_module_imports_only_from_packages_before_its_own():
    wrong = {}
    for name, path in MODULES.items():
        if name != "nailoptics":
            source = path.read_text(encoding="utf-8")
            wrong[name] = broken(source, name.split("."), package=path.name == "__init__.py")
    assert not {name: others for name, others in wrong.items() if others}


@pytest.mark.parametrize(
    ("source", "module", "package", "result"),
    [
        ("from .. import light", "nailoptics.tissue.properties", False, ["light"]),
        ("from ..light.transfer import Transfer", "nailoptics.scene.files", False, ["light"]),
        (
            "def f():\n    import nailoptics.report.pages.simulate",
            "nailoptics.light.finger_walk",
            False,
            ["report"],
        ),
        ("from nailoptics import trace", "nailoptics.scene.files", False, ["__main__"]),
        ("from ..light import trace", "nailoptics.studies.simulate", False, []),
        ("from ..sensor import electronics", "nailoptics.light.tracing", False, ["sensor"]),
        ("from ..scene import Scene\nfrom .mesh import walk\nimport numpy", "nailoptics.light.tracing", False, []),
        ("from .files import digest", "nailoptics.scene", True, []),
        ("from ..cli import main", "nailoptics.scene", True, ["cli"]),
        ('import_module("nailoptics.report.accessor").Nail', "nailoptics.display", False, ["report"]),
    ],
)
def test_the_order_is_checked_for_every_kind_of_import(source, module, package, result):
    assert broken(source, module.split("."), package=package) == result


def names_imported(path: Path) -> set[str]:
    """Absolute dotted names that a module of the package imports anywhere."""
    return set(imported(path.read_text(encoding="utf-8"), module_name(path), package=path.name == "__init__.py"))


def test_only_the_light_room_imports_mitsuba_and_drjit():
    importing = {
        name
        for name, path in MODULES.items()
        if {one.split(".")[0] for one in names_imported(path)} & {"mitsuba", "drjit"}
    }
    assert importing and all(name.startswith("nailoptics.light.") for name in importing), importing


def modules_imported(path: Path) -> set[str]:
    """Modules of the package that a module imports by name, functions and type checking included."""
    names = names_imported(path)
    return {name if name in MODULES else name.rpartition(".")[0] for name in names} & MODULES.keys()


def test_every_module_that_is_imported_exists():
    """Also those that only functions import: mypy takes a missing module for one without types."""
    missing = {}
    for name, path in MODULES.items():
        homes = {one.rpartition(".")[0] for one in names_imported(path) if one.startswith("nailoptics.")}
        missing[name] = homes - MODULES.keys()
    assert not {name: homes for name, homes in missing.items() if homes}


def circle(imports: dict[str, set[str]]) -> list[str]:
    """Modules that import each other in a ring, or nothing."""
    finished: set[str] = set()

    def search(module: str, way: list[str]) -> list[str]:
        if module in way:
            return way[way.index(module) :]
        if module not in finished:
            for other in sorted(imports[module]):
                if result := search(other, [*way, module]):
                    return result
            finished.add(module)
        return []

    return next((result for module in imports if (result := search(module, []))), [])


def test_no_modules_import_each_other_circularly():
    """Not in one room, not inside functions, not for the type checker."""
    assert circle({name: modules_imported(path) for name, path in MODULES.items()}) == []


def test_a_circular_import_is_detected():
    assert circle({"a": {"b"}, "b": {"c", "d"}, "c": set(), "d": {"b"}}) == ["b", "d"]


def test_exported_names_are_unique():
    bodies = [statements(path.read_text(encoding="utf-8"))[0].body for path in FILES]
    classes = Counter(node.name for body in bodies for node in body if isinstance(node, ast.ClassDef))
    assert len(set(nailoptics.__all__)) == len(nailoptics.__all__)
    assert [name for name in nailoptics.__all__ if classes[name] > 1] == []


@pytest.mark.parametrize(
    ("what", "home"),
    [
        ("default-src 'none'", "report/html.py"),
        (r"SeedSequence\(", "statistics.py"),
        (r"os\.replace", "io.py"),
    ],
    ids=["the security policy of pages", "random seeds", "atomic writing of files"],
)
def test_an_idea_has_one_home(what, home):
    result = {str(path.relative_to(PACKAGE)) for path in FILES if re.search(what, path.read_text(encoding="utf-8"))}
    assert result == {home}


ROOT = PACKAGE.parent
FILE = re.compile(
    r"(?<![\w/.*-])(?:[\w.-]+/)*[\w-]+\.(?:py|toml|csv|md|nc|npz|html|css|png|json|glb|ply|dxf|dat|yml)(?![\w.(/])"
)
KINDS = (COLOUR, SIMULATION, COMPARISON, PLACEMENT, TRADEOFF, PREDICTION, OXIMETER, OXYGEN)
# What users have or make.
THEIRS = {
    "a.toml",
    "b.toml",
    "sweep.toml",
    "board.kicad_pcb",
    "board-bottom.csv",
    "FINGER.glb",
    "SUBJECT.toml",
    "READINGS.csv",
    "FILE.csv",
    "me.toml",
    "results/out/predict.png",
    "results/known.csv",
    "results/steps.csv",
    "results/me.toml",
    "known.csv",
    "protocol.csv",
    "steps.csv",
    "worn.csv",
    "results/prototype/report.html",
    "explore.html",
    "1_NAME.json",
    "FILE.npz",
    "detected.npz",
    "finger/1_ir.json",
    "finger/run_pmmc.py",
    "cubes/run_pmcx.py",
    "run_pmmc.py",
    "run_pmcx.py",
    "scene.toml",
}
THEIRS |= {
    *(name for kind in KINDS for name in kind.files),
    "table.csv",
    "contact_sheet.png",
    "_fig10.png",
    "hemodynamics_NAME_fig2.png",
    "hemodynamics_NAME_fig15_to_18.png",
}


def prose(path: Path) -> Iterator[str]:
    """A file's text for its readers: comments and docstrings of a module, all of a page, the comments of data."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        # To find comments takes long: only where there may be one that names a file.
        if any(FILE.search(line) for line in text.splitlines() if "#" in line):
            tokens = tokenize.generate_tokens(StringIO(text).readline)
            yield from (token.string for token in tokens if token.type == tokenize.COMMENT)
        documented = ast.Module, ast.ClassDef, ast.FunctionDef
        for node in statements(text):
            if isinstance(node, documented):
                yield ast.get_docstring(node) or ""
    elif path.suffix == ".md":
        yield text
    else:
        yield from (line for line in text.splitlines() if line.startswith("#"))


def test_every_file_that_a_text_names_exists():
    shipped = {
        str(path.relative_to(ROOT))
        for folder in ("nailoptics", "tests", "assets", "scenes", "docs", ".github")
        for path in (ROOT / folder).rglob("*.*")
    } | {path.name for path in ROOT.glob("*.*")}
    # Pages of the documentation name what their readers make: they are built, and their tutorials run, instead.
    pages = {name for name in shipped if name.startswith("docs/") and name.endswith(".md")}
    readable = [ROOT / name for name in shipped - pages if name.endswith((".py", ".md", ".toml", ".csv"))]
    named = {name: path for path in readable for text in prose(path) for name in FILE.findall(text)}
    assert len(named) > 20
    missing = [name for name in named.keys() - THEIRS if not any(f"/{one}".endswith(f"/{name}") for one in shipped)]
    assert {name: str(named[name].relative_to(ROOT)) for name in missing} == {}


def run(code: str) -> str:
    """What a fresh interpreter prints."""
    environment = os.environ | {"PYTHONPATH": str(PACKAGE.parent)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return done.stdout


LOADED = "import sys; print(*sorted({name.split('.')[0] for name in sys.modules}))"


@pytest.mark.parametrize("statement", ["import nailoptics", "import nailoptics.scene", "from nailoptics import cli"])
def test_importing_the_package_or_its_command_line_loads_nothing_slow(statement):
    assert not set(run(f"{statement}; {LOADED}").split()) & SLOW


def test_help_loads_nothing_slow():
    code = f"""if True:
        import runpy, sys
        sys.argv = ["nailoptics", "--help"]
        sys.stdout, out = sys.stderr, sys.stdout
        try:
            runpy.run_module("nailoptics", run_name="__main__")
        except SystemExit as end:
            assert not end.code, end.code
        sys.stdout = out
        {LOADED}
    """
    assert not set(run(code).split()) & SLOW


def costs(commands: list[list[str]], attempts: int = 5) -> list[float]:
    """The least CPU time of each command, which take turns, as a machine may be slow for a while. [s]"""
    result = []
    for _ in range(attempts):
        for command in commands:
            before = os.times()
            environment = os.environ | {"PYTHONPATH": str(PACKAGE.parent)}
            subprocess.run([sys.executable, *command], env=environment, check=True, capture_output=True)
            after = os.times()
            result.append(after.children_user - before.children_user + after.children_system - before.children_system)
    return [min(result[k :: len(commands)]) for k in range(len(commands))]


@pytest.mark.long
def test_import_and_help_take_less_than_loading_what_every_study_needs():
    """Expected: 0.04 and 0.6 of it; on a usual machine help takes less than half a second."""
    package, usage, study = costs(
        [["-c", "import nailoptics"], ["-m", "nailoptics", "--help"], ["-c", "import xarray"]]
    )
    assert package < 0.25 * study and usage < 0.9 * study

"""The order of the rooms: each imports only from those before it, and slow packages only where they are needed."""

import ast
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "nailoptics"
# Rooms in one entry do not import each other.
ORDER = [
    {"errors"},
    {"checks", "statistics", "variables", "io"},
    {"options"},
    {"assets"},
    {"scene"},
    {"hemodynamics"},
    {"paper"},
    {"tissue"},
    {"geometry"},
    {"light"},
    {"electronics"},
    {"studies"},
    {"batch"},
    {"exports"},
    {"report"},
    {"terminal"},
    {"cli"},
    {"__main__"},
]
RANK = {room: rank for rank, rooms in enumerate(ORDER) for room in rooms}
SLOW = {"mitsuba", "drjit", "xarray", "scipy", "matplotlib", "trimesh", "colour", "h5netcdf"}
FILES = sorted(PACKAGE.rglob("*.py"))


def module_name(path: Path) -> list[str]:
    parts = ["nailoptics", *path.relative_to(PACKAGE).with_suffix("").parts]
    return parts[:-1] if parts[-1] == "__init__" else parts


def imported(source: str, module: list[str], *, package: bool) -> Iterator[str]:
    """Absolute dotted names that a module imports anywhere, functions and type checking included."""
    for node in ast.walk(ast.parse(source)):
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


def test_every_room_has_its_place_in_the_order():
    found = {path.relative_to(PACKAGE).parts[0].removesuffix(".py") for path in FILES} - {"__init__"}
    assert found <= RANK.keys()


@pytest.mark.parametrize("path", FILES, ids=lambda path: ".".join(module_name(path)))
def test_a_module_imports_only_from_rooms_before_its_own(path):
    module = module_name(path)
    if len(module) > 1:
        assert broken(path.read_text(encoding="utf-8"), module, package=path.name == "__init__.py") == []


@pytest.mark.parametrize(
    ("source", "module", "package", "found"),
    [
        ("from .. import light", "nailoptics.tissue.blood_zones", False, ["light"]),
        ("from ..light.transfer import Transfer", "nailoptics.scene.files", False, ["light"]),
        ("def f():\n    import nailoptics.report.simulate_page", "nailoptics.light.finger_walk", False, ["report"]),
        ("from nailoptics import trace", "nailoptics.scene.files", False, ["__main__"]),
        ("from ..light import trace", "nailoptics.studies.simulate", False, []),
        ("from ..electronics import volts", "nailoptics.light.tracing", False, ["electronics"]),
        ("from ..scene import Scene\nfrom .mesh import walk\nimport numpy", "nailoptics.light.tracing", False, []),
        ("from .files import digest", "nailoptics.scene", True, []),
        ("from ..cli import main", "nailoptics.scene", True, ["cli"]),
    ],
)
def test_the_order_is_seen_through_every_kind_of_import(source, module, package, found):
    assert broken(source, module.split("."), package=package) == found


@pytest.mark.parametrize("path", FILES, ids=lambda path: ".".join(module_name(path)))
def test_only_the_light_room_imports_mitsuba_and_drjit(path):
    if path.relative_to(PACKAGE).parts[0] != "light":
        names = imported(path.read_text(encoding="utf-8"), module_name(path), package=path.name == "__init__.py")
        assert not {name.split(".")[0] for name in names} & {"mitsuba", "drjit"}


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


def cost(command: list[str], attempts: int = 5) -> float:
    """The least CPU time of a command, which is its time on the clock where nothing else has the machine. [s]"""
    costs = []
    for _ in range(attempts):
        before = os.times()
        environment = os.environ | {"PYTHONPATH": str(PACKAGE.parent)}
        subprocess.run([sys.executable, *command], env=environment, check=True, capture_output=True)
        after = os.times()
        costs.append(after.children_user - before.children_user + after.children_system - before.children_system)
        if costs[-1] < 0.4:
            break
    return min(costs)


@pytest.mark.parametrize(
    "command", [["-c", "import nailoptics"], ["-m", "nailoptics", "--help"]], ids=["import", "help"]
)
def test_import_and_help_take_less_than_half_a_second(command):
    assert cost(command) < 0.5

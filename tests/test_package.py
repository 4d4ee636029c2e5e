"""The package as it is installed: its data, its licence, its extras and its public names."""

import ast
import importlib
import inspect
import os
import re
import shutil
import subprocess
import sys
import tomllib
from functools import cache
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import nailoptics
from nailoptics import assets, version

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
# What only some users need, each an extra of its own.
EXTRAS = PROJECT["project"]["optional-dependencies"]
OPTIONAL = [one for name in ("cluster", "cad", "validation") for one in EXTRAS[name]]
# Packages whose distribution has another name.
DISTRIBUTION = {"PIL": "pillow", "colour": "colour-science", "dask": "distributed"}


def distributions(requirements: list[str]) -> set[str]:
    return {re.split(r"[\[<>=!~; ]", requirement)[0].lower() for requirement in requirements}


def test_every_requirement_has_a_version_that_passed_in_its_range():
    lines = (ROOT / ".ci" / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pairs = (line.split("==") for line in lines if not line.startswith("#"))
    passed = {canonicalize_name(name): version for name, version in pairs}
    direct = [*PROJECT["project"]["dependencies"]]
    direct += [one for name in ("cluster", "cad", "test", "docs", "dev") for one in EXTRAS[name]]
    needed = [one for one in map(Requirement, direct) if one.name != "nailoptics"]
    assert not [str(one) for one in needed if passed.get(canonicalize_name(one.name), "0") not in one.specifier]


@cache
def stated(path: Path) -> tuple[set[str], str | None]:
    """Top-level packages that a file imports, anywhere in it, and its description of itself."""
    module, names = ast.parse(path.read_text(encoding="utf-8")), set()
    for node in ast.walk(module):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level and node.module:
            names.add(node.module.split(".")[0])
    return names, ast.get_docstring(module)


def third_party(paths) -> set[str]:
    """Top-level packages imported by files, that are neither Python's own nor this one."""
    return {name for path in paths for name in stated(path)[0]} - sys.stdlib_module_names - {"nailoptics"}


def test_a_plain_install_finds_its_assets_and_scenes(tmp_path):
    """Rationale: a wheel carries the data inside the package, a checkout beside it.
    Expected: a copy laid out by the wheel's rules reads its prototype from itself, parts and all."""
    shutil.copytree(
        ROOT / "nailoptics", tmp_path / "nailoptics", ignore=shutil.ignore_patterns("__pycache__", "_assets", "_scenes")
    )
    for source, target in PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"].items():
        shutil.copytree(ROOT / source, tmp_path / target)
    code = """if True:
        import nailoptics
        from nailoptics.assets import data_dir, read_table
        from nailoptics.scene.catalogue import load_part
        scene = nailoptics.load_scene(data_dir("scenes") / "prototype.toml")
        print(data_dir("assets"), data_dir("scenes"), len(read_table("spectra/water.csv")), sep="\\n")
    """
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assets_dir, scenes_dir, columns = done.stdout.split("\n")[:3]
    assert Path(assets_dir) == tmp_path / "nailoptics/_assets" and Path(scenes_dir) == tmp_path / "nailoptics/_scenes"
    assert int(columns) >= 2


def test_a_checkout_finds_its_assets_and_scenes():
    assert assets.data_dir("assets").resolve() == ROOT / "assets"
    assert assets.data_dir("scenes").resolve() == ROOT / "scenes"


def test_a_package_without_its_data_reports_it(monkeypatch, tmp_path):
    monkeypatch.setattr(assets, "_PACKAGE", tmp_path / "nailoptics")
    with pytest.raises(nailoptics.InputError, match="install nailoptics again"):
        assets.data_dir("assets")


def test_every_public_name_exists_and_is_documented():
    for name in nailoptics.__all__:
        assert getattr(nailoptics, name).__doc__, name
    with pytest.raises(AttributeError, match="no_such_name"):
        nailoptics.no_such_name  # noqa: B018


def test_dir_and_the_type_checker_know_every_public_name():
    assert dir(nailoptics) == sorted({*nailoptics.__all__, "__version__"})
    assert (ROOT / "nailoptics/py.typed").is_file()
    source = ast.parse((ROOT / "nailoptics/__init__.pyi").read_text(encoding="utf-8"))
    typed = {alias.name for node in ast.walk(source) if isinstance(node, ast.ImportFrom) for alias in node.names}
    typed |= {target.id for node in ast.walk(source) if isinstance(node, ast.Assign) for target in node.targets}
    assert set(nailoptics.__all__) <= typed


@pytest.mark.parametrize("first", ["nailoptics", "xarray"])
def test_datasets_show_themselves_whichever_is_imported_first(first):
    """Rationale: a file of yesterday is opened before any function of nailoptics has been used.
    Expected: `nail` is there without an import of xarray by nailoptics, of which no finder is left."""
    code = """if True:
        import importlib, sys
        finders = [*sys.meta_path]
        importlib.import_module(sys.argv[1])
        import nailoptics
        assert sys.argv[1] == "xarray" or "xarray" not in sys.modules
        import xarray
        assert sys.meta_path == finders
        print(nailoptics.scene("prototype") == nailoptics.load_scene("prototype"))
        xarray.Dataset(attrs={"title": "mine"}).nail
    """
    command = [sys.executable, "-W", "error", "-c", code, first]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.stdout == "True\n" and 'mine" is not a result that nailoptics can show' in done.stderr


def test_help_has_every_option_of_a_study():
    """Expected: no public function hides its options behind **; each takes a seed and photons, with their defaults."""
    for name in nailoptics.__all__:
        one = getattr(nailoptics, name)
        if inspect.isfunction(one):
            parameters = inspect.signature(one).parameters
            assert not [p for p in parameters.values() if p.kind is p.VAR_KEYWORD], name
    options = inspect.signature(nailoptics.simulate).parameters
    assert options["seed"].default == 0 and options["photons"].default is None and options["picture"].default is False
    assert "workers" in inspect.signature(nailoptics.sweep).parameters


@pytest.mark.long
def test_a_script_reaches_every_study_by_its_public_name(chosen_jit, tmp_path):
    """Rationale: what `import nailoptics` offers is imported only when it is used, in a process that has nothing else.
    Expected: studies answer with a Dataset, and each refuses what cannot be computed with an InputError."""
    code = """if True:
        import sys
        import warnings
        import nailoptics as nail
        warnings.simplefilter("ignore")
        assert "xarray" not in sys.modules and "mitsuba" not in sys.modules
        text = nail.to_toml(nail.load_scene(sys.argv[1]))
        scene = nail.parse_scene(text)
        assert nail.to_toml(scene) == text
        mistakes = {"seed": -1, "photons": 0, "relative_error": 5, "max_seconds": "1", "backend": "gpu", "photon": 3}
        for study in (nail.trace, nail.simulate, nail.compare, nail.explain, nail.tradeoff, nail.place):
            for name, value in mistakes.items():
                try:
                    study(scene, **{name: value})
                except nail.InputError as error:
                    assert str(error).startswith(name), error
                else:
                    raise AssertionError((study, name))
        quiet = scene.model_copy(update={"priors": scene.priors.model_copy(update={"spread": False})})
        volts = nail.simulate(quiet, photons=3000).volts
        errors = nail.compare(scene, over=["blood"], photons=3000)
        print(*volts.dims, *errors.sweep.values, nail.tissue.blood_mu_a_per_mm(800.0, so2=0.97) > 0)
    """
    done = subprocess.run(
        [sys.executable, "-c", code, str(ROOT / "scenes/prototype.toml")],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["led", "photodiode", "time", "blood", "True"]


def test_every_module_states_its_purpose_in_its_first_line():
    for path in sorted((ROOT / "nailoptics").rglob("*.py")):
        _, doc = stated(path)
        assert doc and doc.splitlines()[0].strip(), path


def test_the_version_is_in_the_change_log():
    assert re.fullmatch(r"\d+\.\d+\.\d+(\.dev\d+)?", nailoptics.__version__)
    release, _, development = nailoptics.__version__.partition(".dev")
    newest = re.search(r"^## .*$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert newest and newest[0] == f"## {release}{' (unreleased)' if development else ''}"


def test_the_citation_is_of_the_newest_release():
    text = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    released = re.findall(r"^## ([\d.]+)$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert f"\nversion: {released[0]}\n" in text and "\ncff-version: 1.2.0\n" in f"\n{text}"


def test_the_commit_is_that_of_the_clone_or_of_its_work_tree(tmp_path, monkeypatch):
    """Whatever repository a hook of git names, within which the command may run."""
    clone, tree = tmp_path / "clone", tmp_path / "tree"

    def git(*words):
        person = ("-c", "user.name=a", "-c", "user.email=a@b")
        return subprocess.run(["git", "-C", clone, *person, *words], check=True, capture_output=True, text=True).stdout

    clone.mkdir()
    git("init", "-q")
    for message in "ab":
        git("commit", "-q", "--allow-empty", "-m", message)
    git("worktree", "add", "-q", "--detach", tree, "HEAD~1")
    last, before = git("rev-parse", "HEAD", "HEAD~1").split()
    monkeypatch.setenv("GIT_DIR", str(tmp_path))
    for root, expected in ((clone, last), (tree, before)):
        monkeypatch.setattr(version, "_ROOT", root)
        assert version.commit.__wrapped__() == expected


def test_the_licence_is_the_one_that_the_package_names():
    text = (ROOT / "LICENSE").read_text(encoding="utf-8")
    assert PROJECT["project"]["license"] == "BSD-3-Clause" and text.startswith("BSD 3-Clause License")
    assert "nailoptics developers" in text


def test_the_readme_of_the_package_is_there():
    assert (ROOT / PROJECT["project"]["readme"]).read_text(encoding="utf-8").startswith("# nailoptics")


# The package, and the runner that it copies into exports.
SHIPPED = [*(ROOT / "nailoptics").rglob("*.py"), ROOT / "assets/run_session.py"]


def test_every_package_that_the_code_imports_is_required():
    needed = {DISTRIBUTION.get(name, name) for name in third_party(SHIPPED)}
    declared = distributions(PROJECT["project"]["dependencies"])
    optional = distributions(OPTIONAL)
    assert {name.replace("_", "-") for name in needed} <= declared | optional


def test_every_package_that_is_required_is_imported():
    used = {DISTRIBUTION.get(name, name) for name in third_party(SHIPPED)}
    # xarray imports netCDF4 by its engine's name.
    assert 'engine="netcdf4"' in (ROOT / "nailoptics/io.py").read_text(encoding="utf-8")
    # The runner of exports imports the program that its options name.
    assert 'else "pmcx"' in (ROOT / "assets/run_session.py").read_text(encoding="utf-8")
    used |= {"netcdf4", "pmcx"}
    declared = distributions(PROJECT["project"]["dependencies"] + OPTIONAL)
    assert declared - {name.replace("_", "-") for name in used} == set()


def test_every_package_that_the_tests_import_is_in_the_test_extra():
    needed = {DISTRIBUTION.get(name, name) for name in third_party((ROOT / "tests").rglob("*.py"))}
    extras = PROJECT["project"]["optional-dependencies"]
    known = distributions(PROJECT["project"]["dependencies"] + OPTIONAL + extras["test"])
    files = [path for folder in ("tests", "scenes", "assets") for path in (ROOT / folder).rglob("*.py")]
    local = {name for path in files for name in (path.stem, path.parent.name)}
    assert {name.replace("_", "-") for name in needed - local} <= known


def test_the_command_exists():
    module, function = PROJECT["project"]["scripts"]["nailoptics"].split(":")
    assert callable(getattr(importlib.import_module(module), function))


def test_an_installed_package_names_the_commit_of_its_build(tmp_path, monkeypatch):
    """Expected: an installed package states the commit that its wheel was built from, a clone its own."""
    built = tmp_path / "_commit.txt"
    monkeypatch.setattr(version, "_BUILT_FROM", built)
    before = version.commit.__wrapped__()
    built.write_text("0123abc\n", encoding="utf-8")
    assert version.commit.__wrapped__() == "0123abc" != before


def test_results_name_versions_and_the_commit_where_it_is_available(monkeypatch):
    monkeypatch.setattr(version, "commit", lambda: "0123abc")
    result = version.code_attributes({"nailoptics": "1", "numpy": "2"})
    assert result == {"versions": "nailoptics=1 numpy=2", "commit": "0123abc"}
    monkeypatch.setattr(version, "commit", lambda: None)
    assert list(version.code_attributes()) == ["versions"]


WITHOUT_POSIX = """
import os, signal, sys, warnings

for name in ("fcntl", "grp", "pwd", "resource", "termios"):
    sys.modules[name] = None
for name in ("O_DIRECTORY", "O_NOFOLLOW", "fork", "getuid", "geteuid", "killpg", "setsid", "sched_getaffinity"):
    if hasattr(os, name):
        delattr(os, name)
if hasattr(os, "process_cpu_count"):  # which asks sched_getaffinity where there is one
    os.process_cpu_count = os.cpu_count
for name in ("SIGALRM", "SIGHUP", "SIGKILL", "SIGUSR1"):
    delattr(signal, name)
# What a file is read or written with must not depend on the system.
warnings.filterwarnings("error", category=EncodingWarning, module="nailoptics")
from nailoptics.cli import run

sys.exit(max(run(command.split()) for command in sys.argv[1:]))
"""


@pytest.mark.long
def test_nothing_is_needed_that_only_posix_has(chosen_jit, coarse_cells, tmp_path):
    """Rationale: Windows was not available. Expected: without the modules, functions and signals that Python
    has not got there, and with no text in the system's own encoding, a scene is checked, its light traced and kept."""
    trace = f"trace prototype --photons 2000 --backend {chosen_jit.name} -o light.npz"
    commands = ["check prototype", trace, "export prototype -o finger --format mitsuba", "store"]
    done = subprocess.run(
        [sys.executable, "-X", "warn_default_encoding", "-c", WITHOUT_POSIX, *commands],
        cwd=tmp_path,
        env={**os.environ, "NAILOPTICS_STORE": str(tmp_path / "store")},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "light.npz").exists() and (tmp_path / "finger" / "1_ir.xml").exists()
    assert "2 cached traces" in done.stdout  # the short trace of check, too

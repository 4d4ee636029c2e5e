"""What all tests share: the backends that trace light, and no skips in CI."""

import gc
import os
import shutil
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import lru_cache, partial
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from fewer_photons import COARSE_MM, PHOTONS_FROM_OUTSIDE, ROUGH_PHOTONS

# Before NumPy is loaded, here or in a worker: threads of BLAS that wait for small matrices take a fifth of the time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Package and tests are compiled once, not again in each of the processes of a run.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

from nailoptics.errors import InputError  # noqa: E402
from nailoptics.light import backend  # noqa: E402

# What a script starts in its background ignores Ctrl-C, and so would the commands that tests start and interrupt.
signal.signal(signal.SIGINT, signal.default_int_handler)
# As on the command line: there is much that stays, which the collector would scan again and again.
gc.set_threshold(100_000)
# No test reads or writes the user's store; those that test one have their own.
os.environ["NAILOPTICS_STORE"] = "off"
# Names of browsers that can show pages; NAILOPTICS_BROWSER may give the path of another.
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge")
# Folders whose files take less than a few seconds each.
QUICK = tuple(f"{Path(__file__).parent / one}{os.sep}" for one in ("hemodynamics", "scene", "tissue"))
# Of 10 MB or so each.
SHAPES_KEPT = 24
# First on the path of processes that trace few photons in coarse cells.
FEWER = Path(__file__).parent / "fewer"
IN_CI = os.environ.get("CI", "").lower() in ("true", "1")


@pytest.fixture
def store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A store of traced light for this test alone, and for the processes that it starts."""
    monkeypatch.setenv("NAILOPTICS_STORE", str(tmp_path / "store"))
    return tmp_path / "store"


@pytest.fixture(scope="session")
def shared_store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store of traced light that tests of this run share, whatever worker they are in."""
    base = tmp_path_factory.getbasetemp()
    return (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "light"


@pytest.fixture
def shared_light(shared_store: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Light comes from the shared store: for tests of what is made of it, not of how it is traced."""
    monkeypatch.setenv("NAILOPTICS_STORE", str(shared_store))


@pytest.fixture(scope="session")
def fewer_photons(shared_store: Path) -> Callable[[], AbstractContextManager[None]]:
    """Lets a placement verify its best layout, and vary the priors of the finger, with a quarter of the photons,
    and so at the board glued elsewhere.

    Each number's error grows with that, and tests that compare two of them bound those errors, too.
    """

    @contextmanager
    def fewer() -> Iterator[None]:
        tracer = import_module("nailoptics.light.board_map").BoardTracer
        verification, robustness = (
            import_module(f"nailoptics.studies.placement.{name}") for name in ("verification", "robustness")
        )
        with pytest.MonkeyPatch.context() as patch:
            # Apart, as a test may trace in coarse cells.
            patch.setenv("NAILOPTICS_STORE", str(shared_store.with_name("fewer")))
            patch.setattr(tracer, "batch_photons", tracer.batch_photons // 4)
            patch.setattr(verification, "PHOTONS", verification.PHOTONS // 8)
            patch.setattr(robustness, "MOST_PHOTONS", robustness.MOST_PHOTONS // 4)
            yield

    return fewer


@pytest.fixture(scope="module")
def few_photons_beside() -> Iterator[None]:
    """Few photons where no option sets fewer, of light from outside and of rough readings before a trace: for tests
    that do not compare these."""
    ambient, detect = (import_module(f"nailoptics.{name}") for name in ("sensor.ambient", "light.detect"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(ambient.trace_ambient.__kwdefaults__, "photons", PHOTONS_FROM_OUTSIDE)
        patch.setattr(ambient, "BOUND_PHOTONS", ambient.BOUND_PHOTONS // 8)
        patch.setattr(detect, "ROUGH_PHOTONS", ROUGH_PHOTONS)
        yield


@pytest.fixture
def untraced_tolerances(monkeypatch: pytest.MonkeyPatch) -> None:
    """A placement has those of its tolerances alone that take no light of their own."""
    of_layout = import_module("nailoptics.studies.placement.robustness").tolerances

    def untraced(layout: Any, cache: Any, objective: Any) -> Any:
        cache.stop = lambda: True
        return of_layout(layout, cache, objective)

    monkeypatch.setattr(import_module("nailoptics.studies.placement.place"), "tolerances", untraced)


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are made, but not drawn: for pages that other tests draw, and of which no more than words are read."""
    monkeypatch.setattr(import_module("nailoptics.report.style"), "to_svg", lambda figure, **_: "<svg></svg>")


@pytest.fixture(scope="session")
def chosen_llvm() -> backend.Backend:
    try:
        return backend.choose("llvm")
    except InputError as error:
        pytest.skip(f"no LLVM works here: {error}")


@pytest.fixture(scope="session")
def chosen_jit() -> backend.Backend:
    chosen = backend.choose("auto")
    if not chosen.jit:
        pytest.skip(f"no JIT backend works here: {chosen.why}")
    return chosen


def activated(chosen: backend.Backend) -> backend.Backend:
    """A backend, active again, because another test may have set another variant."""
    backend.activate(chosen)
    # Of tests that run side by side, each has its own core: threads of all on all cores wait for one another.
    if "PYTEST_XDIST_WORKER" in os.environ:
        backend.set_threads(1)
    keep_shapes()
    return chosen


def keep_shapes() -> None:
    """Let this process keep the shapes that it builds: many tests trace the same few fingers."""
    from nailoptics.light.walk import finger

    if finger.built.cache_parameters()["maxsize"] < SHAPES_KEPT:
        finger.built = lru_cache(SHAPES_KEPT)(finger.built.__wrapped__)


@lru_cache
def _coarsely_built() -> Callable[..., Any]:
    """What builds shapes with coarse cells; it keeps them for all tests of this process."""
    built = import_module("nailoptics.light.walk.finger").built.__wrapped__
    geometry = import_module("nailoptics.geometry")
    coarse_grid = partial(geometry.distance_grid, spacing_mm=COARSE_MM)

    def coarsely_built(*shape: Any) -> Any:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(geometry, "distance_grid", coarse_grid)
            return built(*shape)

    return lru_cache(SHAPES_KEPT)(coarsely_built)


@pytest.fixture
def coarse_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cells of the distances to interfaces that are soon made, here and in processes that are started: for few photons
    in many shapes. Light does not depend on them but by chance."""
    monkeypatch.setattr("nailoptics.light.walk.finger.built", _coarsely_built())
    monkeypatch.setenv("PYTHONPATH", str(FEWER), prepend=os.pathsep)


@pytest.fixture
def coarse_light(coarse_cells: None, shared_store: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As `shared_light`, in coarse cells, and in a store of its own, so that no other test has its bits."""
    monkeypatch.setenv("NAILOPTICS_STORE", str(shared_store.with_name("coarse")))


@pytest.fixture
def llvm(chosen_llvm: backend.Backend) -> backend.Backend:
    """The LLVM backend, active; without one the test is skipped, with the reason."""
    return activated(chosen_llvm)


@pytest.fixture
def jit_backend(chosen_jit: backend.Backend) -> backend.Backend:
    """The fastest backend that compiles kernels, active; without one the test is skipped, with the reason."""
    return activated(chosen_jit)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """A browser for tests of pages; without one the test is skipped, with the reason."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is missing: pip install playwright")
    with playwright.sync_playwright() as driver:
        own = driver.chromium.executable_path
        known = [os.environ.get("NAILOPTICS_BROWSER"), *map(shutil.which, BROWSERS), own]
        path = next((one for one in known if one and Path(one).exists()), None)
        if path is None:
            pytest.skip("no Chromium was found; install one, or name it in NAILOPTICS_BROWSER")
        started = driver.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield started
        started.close()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    # Workers take file after file; quick ones at the end leave none of them waiting for another.
    items.sort(key=lambda item: str(item.path).startswith(QUICK))


def pytest_collection_finish() -> None:
    # What is loaded by now stays to the end: the collector need not scan it again, nor when pytest ends.
    gc.freeze()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Iterator[None]:
    """Turn a skip into a failure in CI: what is not run there is run nowhere."""
    report = yield
    if IN_CI and report.skipped and not hasattr(report, "wasxfail"):
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
        report.outcome = "failed"
        report.longrepr = f"{report.nodeid}: in CI a skip is a failure. {reason}"
    return report


pytest_make_collect_report = pytest_runtest_makereport

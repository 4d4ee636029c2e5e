"""Backends are detected without ever risking this process, and the result is cached."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from nailoptics.errors import InputError
from nailoptics.light import backend
from nailoptics.light.reference import readings


@pytest.fixture
def fresh(monkeypatch, tmp_path):
    """An empty cache, no remembered answers, no library of the user's choice."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    monkeypatch.setattr(backend, "_answers", {})
    return tmp_path / "cache" / "nailoptics" / "backends.json"


@pytest.fixture
def library(fresh, monkeypatch, tmp_path):
    """A file that passes for a libLLVM; what loading it does is up to the probe."""
    file = tmp_path / "libLLVM-99.so"
    file.write_bytes(b"not a library")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(file))
    monkeypatch.setattr(backend, "_cuda_libraries", lambda: [])
    return file


def test_a_library_that_aborts_leaves_this_process_alive(library, fresh, monkeypatch):
    monkeypatch.setattr(backend, "PROBE", "import os; os.abort()")
    chosen = backend.choose()
    assert (chosen.name, chosen.jit, chosen.library) == ("scalar", False, None)
    assert "SIGABRT" in chosen.why and library.name in chosen.why
    assert chosen.advice is not None and "libllvm19" in chosen.advice and "\n" not in chosen.advice
    with pytest.raises(InputError, match="SIGABRT") as caught:
        backend.choose("llvm")
    assert "\n" not in str(caught.value)
    assert "SIGABRT" in fresh.read_text()


def test_a_file_that_is_no_library_is_refused_by_the_real_probe(library):
    [finding] = [f for f in backend.findings() if f.name == "llvm"]
    assert not finding.usable and finding.why.startswith("refused")
    assert backend.choose().name == "scalar"


def test_libraries_on_this_machine_that_abort_are_survived(fresh, monkeypatch):
    """Whatever libLLVM is installed, requesting it leaves this process alive, also where it aborts at volpath (15, 16).

    Expected: every one from 15 on runs the photons engine; volpath runs on it or on the scalar backend."""
    monkeypatch.setattr(backend, "_cuda_libraries", lambda: [])
    for path in backend._llvm_libraries():
        monkeypatch.setenv("DRJIT_LIBLLVM_PATH", path)
        [finding] = [f for f in backend.findings() if f.name == "llvm"]
        assert finding.why and ("photons" in finding.engines) == (backend._major_version(path) >= 15)
        assert backend.choose().name == ("llvm" if finding.usable else "scalar")
        assert backend.choose(volpath=True).name == ("llvm" if "volpath" in finding.engines else "scalar")


def test_volpath_takes_the_scalar_backend_where_only_photons_compile(library, fresh, monkeypatch):
    """Rationale: libLLVM 15 and 16 abort at Mitsuba's own kernels. Expected: volpath runs on the scalar
    backend with one line of advice, whichever backend was requested; if forced, one line of error."""
    monkeypatch.setattr(backend, "PROBE", "import os; print('photons', flush=True); os.abort()")
    chosen = backend.choose()
    assert (chosen.name, chosen.jit, chosen.engines, chosen.advice) == ("llvm", True, ("photons",), None)
    for requested in ("auto", "llvm"):
        stock = backend.choose(requested, volpath=True)
        assert (stock.name, stock.jit, stock.engines) == ("scalar", False, ("volpath",))
        assert "SIGABRT" in stock.why and stock.advice == backend.ADVICE["volpath"]
    assert "libllvm19" in backend.ADVICE["volpath"] and "\n" not in backend.ADVICE["volpath"]
    assert {f.name: f.why.rpartition("; ")[2] for f in backend.findings() if f.usable} == {
        "llvm": "selected",
        "scalar": "selected for volpath",
    }
    assert json.loads(fresh.read_text()).popitem()[1]["engines"] == ["photons"]
    with pytest.raises(InputError, match=f"{library.name}.*scalar") as caught, readings.stock_mitsuba(chosen):
        pass
    assert "\n" not in str(caught.value)


def test_the_answer_is_remembered_until_the_library_changes(library, fresh, monkeypatch):
    probed = []

    def probe(name, path):
        probed.append(path)
        return backend.ENGINES, "works", True

    monkeypatch.setattr(backend, "_probe", probe)
    assert backend.choose("llvm").library == str(library)
    backend._answers.clear()  # as in the next process
    with monkeypatch.context() as patched:
        patched.setattr(subprocess, "Popen", lambda *_, **__: pytest.fail("a process was started"))
        assert backend.choose("auto").name == "llvm"
    assert len(probed) == 1
    library.write_bytes(b"another library, longer")
    backend._answers.clear()
    backend.choose()
    assert len(probed) == 2
    fresh.write_text("damaged {")
    backend._answers.clear()
    backend.choose()
    assert len(probed) == 3


def test_a_probe_that_hangs_is_given_up_and_not_remembered(library, fresh, monkeypatch):
    monkeypatch.setattr(backend, "PROBE", "import time; time.sleep(60)")
    monkeypatch.setattr(backend, "PROBE_TIMEOUT_S", 0.5)
    assert "no answer" in backend.choose().why
    assert not fresh.exists()


def test_a_missing_package_is_not_remembered(library, fresh, monkeypatch, tmp_path):
    """Power: a library that is refused is remembered."""
    assert backend._probe("llvm", str(library))[2]
    (tmp_path / "mitsuba.py").write_text("raise ImportError('no mitsuba here')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    assert backend._probe("llvm", str(library)) == ((), "refused: no mitsuba here", False)


def test_an_unwritable_cache_costs_a_probe_and_nothing_else(library, monkeypatch, tmp_path):
    blocker = tmp_path / "file"
    blocker.write_text("in the way")
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocker))
    monkeypatch.setattr(backend, "_probe", lambda name, path: (backend.ENGINES, "works", True))
    assert backend.choose().name == "llvm"


def test_newest_library_first_and_each_file_once(fresh, tmp_path):
    folder = tmp_path / "lib"
    folder.mkdir()
    others = ("libLLVM.dylib", "libLLVMCore.so", "libLLVM.a")
    for name in ("libLLVM-15.so.1", "libLLVM.so.19.1", "libLLVM-17.so.1", *others):
        (folder / name).touch()
    (folder / "libLLVM-19.so").symlink_to("libLLVM.so.19.1")
    (tmp_path / "other").symlink_to("lib")
    result = backend._llvm_in(folder, tmp_path / "other", tmp_path / "missing")
    newest = ["libLLVM.so.19.1", "libLLVM-17.so.1", "libLLVM-15.so.1"]
    assert [Path(path).name for path in result] == [*newest, "libLLVM.dylib"]


def test_findings_name_one_backend_as_selected(fresh, monkeypatch):
    monkeypatch.setattr(backend, "_llvm_libraries", lambda: ["a", "b", "c"])
    monkeypatch.setattr(backend, "_cuda_libraries", lambda: [])
    answers = {"a": ((), "broken", True)}
    monkeypatch.setattr(backend, "_probe", lambda name, path: answers.get(path, (backend.ENGINES, "works", True)))
    findings = backend.findings()
    assert [(f.name, f.library, f.usable) for f in findings] == [
        ("cuda", None, False),
        ("llvm", "a", False),
        ("llvm", "b", True),
        ("llvm", "c", True),
        ("metal", None, False),
        ("scalar", None, True),
    ]
    assert [f.why.endswith("selected") for f in findings] == [False, False, True, False, False, False]
    assert backend.choose().library == "b"


@pytest.mark.parametrize("libraries", [["b"], []])
def test_an_apple_gpu_is_chosen_where_there_is_no_libllvm_and_reported_as_untested(fresh, monkeypatch, libraries):
    """Rationale: no Apple GPU was available; whether one computes is for the probe, whose answer is replaced here."""
    monkeypatch.setattr(backend, "_llvm_libraries", lambda: libraries)
    monkeypatch.setattr(backend, "_cuda_libraries", lambda: [])
    with monkeypatch.context() as apple:
        apple.setattr(sys, "platform", "darwin")
        apple.setattr(backend.platform, "machine", lambda: "arm64")
        on_apple = backend._metal_libraries()
    monkeypatch.setattr(backend, "_metal_libraries", lambda: on_apple)
    probed = {}

    def probe(name, path):
        probed[name] = path
        return backend.ENGINES, "works", True

    monkeypatch.setattr(backend, "_probe", probe)
    chosen = backend.choose()
    assert (chosen.name, chosen.jit) == (("llvm", True) if libraries else ("metal", True))
    assert (chosen.advice is None) == bool(libraries)
    if not libraries:
        assert "untried" in chosen.advice and "\n" not in chosen.advice and set(probed) == {"metal"}
    assert backend.choose("metal").name == "metal"
    assert backend.VARIANTS["metal"] == "metal_ad_mono"


def test_scalar_needs_no_library_and_an_unknown_backend_is_one_line():
    assert backend.choose("scalar").library is None
    with pytest.raises(InputError, match="auto, cuda, llvm, metal, scalar"):
        backend.choose("opencl")


def test_choosing_imports_no_mitsuba():
    code = """if True:
        import sys
        from nailoptics.light import backend
        backend.choose("scalar")
        assert "mitsuba" not in sys.modules
    """
    root = str(Path(backend.__file__).parents[2])
    subprocess.run([sys.executable, "-c", code], check=True, env={**os.environ, "PYTHONPATH": root})


def test_activation_sets_the_variant():
    mi = backend.activate(backend.choose("scalar"))
    assert mi.variant() == "scalar_rgb"

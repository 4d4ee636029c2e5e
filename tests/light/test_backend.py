"""Backends are found without ever risking this process, and the answer is remembered."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from nailoptics.errors import InputError
from nailoptics.light import backend


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
    assert "SIGABRT" in chosen.reason and library.name in chosen.reason
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
    """Whatever libLLVM lies here, 15 and 16 (which abort) included, asking for it leaves this process alive."""
    for path in backend._llvm_libraries():
        monkeypatch.setenv("DRJIT_LIBLLVM_PATH", path)
        findings = [f for f in backend.findings() if f.name == "llvm"]
        assert len(findings) == 1 and findings[0].why
        assert backend.choose().name in ("cuda", "scalar") or findings[0].usable


def test_the_answer_is_remembered_until_the_library_changes(library, fresh, monkeypatch):
    asked = []

    def probe(name, path):
        asked.append(path)
        return True, "works", True

    monkeypatch.setattr(backend, "_probe", probe)
    assert backend.choose("llvm").library == str(library)
    backend._answers.clear()  # as in the next process
    start = time.perf_counter()
    assert backend.choose("auto").name == "llvm"
    assert time.perf_counter() - start < 0.1 and len(asked) == 1
    library.write_bytes(b"another library, longer")
    backend._answers.clear()
    backend.choose()
    assert len(asked) == 2
    fresh.write_text("damaged {")
    backend._answers.clear()
    backend.choose()
    assert len(asked) == 3


def test_a_probe_that_hangs_is_given_up_and_not_remembered(library, fresh, monkeypatch):
    monkeypatch.setattr(backend, "PROBE", "import time; time.sleep(60)")
    monkeypatch.setattr(backend, "PROBE_TIMEOUT_S", 0.5)
    assert "no answer" in backend.choose().reason
    assert not fresh.exists()


def test_an_unwritable_cache_costs_a_probe_and_nothing_else(library, monkeypatch, tmp_path):
    blocker = tmp_path / "file"
    blocker.write_text("in the way")
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocker))
    monkeypatch.setattr(backend, "_probe", lambda name, path: (True, "works", True))
    assert backend.choose().name == "llvm"


def test_newest_library_first_and_each_file_once(fresh, tmp_path):
    folder = tmp_path / "lib"
    folder.mkdir()
    for name in ("libLLVM-15.so.1", "libLLVM.so.19.1", "libLLVM-17.so.1", "libLLVMSupport.a"):
        (folder / name).touch()
    (folder / "libLLVM-19.so").symlink_to("libLLVM.so.19.1")
    found = backend._llvm_libraries([folder, tmp_path / "missing"])
    assert [Path(path).name for path in found] == ["libLLVM.so.19.1", "libLLVM-17.so.1", "libLLVM-15.so.1"]


def test_findings_name_one_backend_as_taken(fresh, monkeypatch):
    monkeypatch.setattr(backend, "_llvm_libraries", lambda: ["a", "b", "c"])
    monkeypatch.setattr(backend, "_cuda_libraries", lambda: [])
    monkeypatch.setattr(backend, "_probe", lambda name, path: (path != "a", "works" if path != "a" else "broken", True))
    findings = backend.findings()
    assert [(f.name, f.library, f.usable) for f in findings] == [
        ("cuda", None, False),
        ("llvm", "a", False),
        ("llvm", "b", True),
        ("llvm", "c", True),
        ("scalar", None, True),
    ]
    assert [f.why.endswith("taken") for f in findings] == [False, False, True, False, False]
    assert backend.choose().library == "b"


def test_scalar_needs_no_library_and_an_unknown_backend_is_one_line():
    assert backend.choose("scalar").variant == "scalar_rgb"
    with pytest.raises(InputError, match="auto, cuda, llvm, scalar"):
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

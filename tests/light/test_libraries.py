"""Whichever libLLVM compiles the walks, their bits are the same."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from nailoptics.light import backend

VERSIONS = range(15, 21)
# Everything whose kernels are ours: both walks, light onto the board and back, and fluence.
JOB = """
import hashlib, json
import numpy as np
from nailoptics import load_scene
from nailoptics.assets import data_dir
from nailoptics.light import backend, trace
from nailoptics.light.board_map import BoardTracer, blood_point
from nailoptics.light.backend import set_threads

backend.activate(backend.choose("llvm"))
set_threads(1)  # sums on cells add up in the order of their photons
found = {}

def note(name, *columns):
    digest = hashlib.sha256(b"".join(np.ascontiguousarray(column).tobytes() for column in columns)).hexdigest()
    found[name] = [digest, *(float(np.sum(column)) for column in columns)]

phantom, finger = (load_scene(data_dir("scenes") / f"{name}.toml") for name in ("phantom", "prototype"))
light = trace(phantom, photons=20_000, seed=1, backend="llvm").traces[0]
note("phantom", light.photodiode, light.weight, light.path_mm)
board = BoardTracer(finger, backend="llvm")
light = board.tracer.batch(0, photons=20_000, seed=1)
note("finger", light.photodiode, light.weight, light.path_mm)
note("detected", board.detected(0, blood_point(finger, 0), photons=5_000, seed=2))
note("fluence", board.fluence(photons=5_000, seed=4).values)
onto = board.arrivals(0, photons=5_000, seed=3)
note("board", onto.photon, onto.place_mm, onto.weight, onto.path_mm)
left = board.leaving(0, 0, photons=5_000, seed=3)
note("leaving", left.photon, left.weight, left.path_mm)
print(json.dumps({"library": backend.choose("llvm").library, "found": found}))
"""


def installed() -> dict[int, str]:
    """One libLLVM of each major version here that the walks support."""
    return {v: path for path in backend._llvm_libraries() if (v := backend._major_version(path)) in VERSIONS}


@pytest.mark.long
def test_every_library_gives_the_same_bits(monkeypatch, tmp_path):
    """Rationale: libLLVM 15 and 16 have no machine code for some of Dr.Jit's functions, and each library makes its own.
    Expected: the same light from all, bit for bit."""
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    libraries = installed()
    if len(libraries) < 2:
        pytest.skip(f"needs two libLLVM of 15 to 20 to compare; here: {', '.join(libraries.values()) or 'none'}")
    answers = {}
    for version, path in libraries.items():
        environment = {
            "PYTHONPATH": str(Path(backend.__file__).parents[2]),
            "DRJIT_LIBLLVM_PATH": path,
            # Kernels that another library has compiled must not answer for this one.
            "DRJIT_CACHE_DIR": str(tmp_path / str(version)),
        }
        done = subprocess.run(
            [sys.executable, "-c", JOB], env=os.environ | environment, capture_output=True, text=True, timeout=300
        )
        assert done.returncode == 0, f"{path}: {done.stderr[-2000:]}"
        answer = json.loads(done.stdout)
        assert answer["library"] == path
        answers[version] = answer["found"]
    first, *others = answers.values()
    assert all(sums[-1] > 0 for _, *sums in first.values())  # there was light to compare
    for version, other in zip([*answers][1:], others, strict=True):
        assert other == first, f"libLLVM {version} and {[*answers][0]} differ"

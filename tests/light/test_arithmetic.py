"""The walks' kernels: their functions of floats agree with NumPy's, none that libLLVM 15 and 16 abort at is called, and
one kernel walks any number of photons."""

import ast
from pathlib import Path

import numpy as np
import pytest

import nailoptics as nail
from nailoptics import light
from nailoptics.assets import data_dir

ABORT = {"maximum", "minimum", "clip", "max", "min", "atan", "atan2", "hypot", "safe_sqrt", "safe_asin", "safe_acos"}


def called(source: str) -> set[str]:
    """Names that a source takes from Dr.Jit."""
    return {
        node.attr
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "dr"
    }


def test_no_kernel_calls_what_aborts():
    used = {path.name: called(path.read_text()) for path in Path(light.__file__).parent.rglob("*.py")}
    assert "select" in used["sampling.py"] and called("dr.sqrt(dr.maximum(a, 0))") & ABORT == {"maximum"}
    assert {name: names & ABORT for name, names in used.items() if names & ABORT} == {}


@pytest.mark.jit
def test_functions_of_floats_are_numpys(jit_backend):
    import mitsuba as mi

    from nailoptics.light.walk.sampling import atan2, clip, maximum, minimum, safe_sqrt

    special = np.array([0, -0.0, 1, -1, 1e-30, -1e-30, 1e30, -1e30, np.inf, -np.inf], np.float32)
    a, b = (grid.ravel() for grid in np.meshgrid(special, special))
    x, y = mi.Float(a), mi.Float(b)
    assert np.array_equal(maximum(x, y), np.maximum(a, b))
    assert np.array_equal(minimum(x, y), np.minimum(a, b))
    assert np.array_equal(clip(x, -1, 0.5), np.clip(a, -1, 0.5))
    assert np.array_equal(safe_sqrt(x), np.sqrt(np.maximum(a, 0)))
    nan = mi.Float(np.nan)
    assert all(np.isnan(np.array(f)).all() for f in (maximum(nan, 0), minimum(nan, 0), clip(nan, 0, 1), safe_sqrt(nan)))

    angle = np.concatenate([np.linspace(-np.pi, np.pi, 20_001), np.geomspace(1e-6, 1, 100), [np.pi / 2]])
    away = np.geomspace(1e-3, 1e3, len(angle))
    across, along = ((away * f(angle)).astype(np.float32) for f in (np.sin, np.cos))
    result, exact = np.array(atan2(mi.Float(across), mi.Float(along))), np.arctan2(across.astype(float), along)
    # Four roundings of float32, of a relative 6e-8 each, and those of Dr.Jit's arc sine, 4e-7 at most.
    assert np.all(np.abs(result - exact) <= 6.4e-7 * np.abs(exact))
    assert np.array_equal(atan2(mi.Float(0, -2, 2), mi.Float(0, 0, 0)), np.float32([0, -np.pi / 2, np.pi / 2]))


@pytest.mark.jit
@pytest.mark.parametrize("name", ["phantom", "prototype"])
def test_one_kernel_walks_any_number_of_photons(jit_backend, name):
    """Rationale: a kernel of its own for each number of photons took up to a second to compile, in nearly every run; on
    a GPU also that of a phantom for each number of lanes, which are fewer for fewer photons than fill them."""
    import drjit as dr

    scene, kernels = nail.load_scene(data_dir("scenes") / f"{name}.toml"), []
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        for photons in (3000, 5001, 2048, 601):
            nail.trace(scene, photons=photons, seed=1)
            kernels.append({one["hash"] for one in dr.kernel_history() if one["type"] == dr.KernelType.JIT})
    # The first may make tables, too.
    assert kernels[1] and kernels[1] == kernels[2] == kernels[3] <= kernels[0]


@pytest.mark.jit
def test_one_kernel_reads_a_table_wherever_it_lies(jit_backend):
    """Rationale: of NumPy's memory, aligned by chance, Dr.Jit makes one of two kernels; a run had either."""
    import drjit as dr
    import mitsuba as mi

    from nailoptics.light.walk.interfaces import table_of_rows

    def kernels(table_of):
        result, index = set(), dr.opaque(mi.UInt32, 0, 8) + dr.arange(mi.UInt32, 8)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            for start in range(0, 64, 4):
                rows = memory[start : start + 4000].reshape(-1, 4)
                dr.eval(index, read := table_of(rows))
                dr.kernel_history_clear()
                read = dr.gather(mi.Vector4f, read, index)
                dr.eval(read)
                result |= {one["hash"] for one in dr.kernel_history() if one["type"] == dr.KernelType.JIT}
                assert np.array_equal(read, rows[:8].T)
        return result

    memory = np.arange(4064, dtype=np.float32)
    assert len(kernels(table_of_rows)) == 1
    if jit_backend.name == "llvm":  # NumPy's own memory is what a processor reads
        assert len(kernels(lambda rows: mi.Float(rows.ravel()))) == 2

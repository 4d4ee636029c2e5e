"""What another program detected is read and compared with ours by calibrated standard errors."""

import json
import math
import runpy
import sys
from types import SimpleNamespace

import numpy as np
import pytest

import nailoptics
from nailoptics.assets import data_dir
from nailoptics.cli import run
from nailoptics.errors import InputError
from nailoptics.exports.other_program import OtherDetection, compared, read_detected
from nailoptics.light.transfer.records import LedTrace
from nailoptics.scene import load_scene, to_toml

PHOTONS = 20_000


@pytest.fixture(scope="module")
def scene():
    return load_scene(data_dir("scenes") / "prototype.toml")


def synthetic(seed: int, *, brighter: float = 1.0, shared: float = 0.0) -> LedTrace:
    """Photons of a synthetic finger: each photodiode detects its own share, with paths that vary, and a part of its
    neighbour's."""
    random = np.random.default_rng(seed)
    shares = brighter * np.array([0.01, 0.02, 0.03, 0.04, 0.04, 0.03, 0.02, 0.01])
    count = random.multinomial(PHOTONS, [*shares, 1 - shares.sum()])[:-1]
    which = np.repeat(np.arange(8), count)
    paths = random.exponential([2.0, 1.0, 1.0, 0.1, 0.1, 0.0, 1.3, 0.0], (len(which), 8)).astype(np.float32)
    photon = np.arange(len(which))
    again = np.concatenate([photon, photon[random.random(len(photon)) < shared]])
    which = np.concatenate([which, which[again[len(which) :]] ^ 1])
    return LedTrace(PHOTONS, np.zeros(8), again, which, np.ones(len(which)), paths[again], {}, (seed,))


@pytest.mark.parametrize("shared", [0.0, 0.6])
def test_standard_errors_and_p_values_are_calibrated(scene, shared):
    """Of many pairs of runs of one truth, differences scatter by their standard errors, and p-values evenly, also
    where neighbouring photodiodes share photons."""
    made = [synthetic(seed, shared=shared) for seed in range(300)]
    result = [compared(a, OtherDetection("other", scene, 0, b)) for a, b in zip(made[::2], made[1::2], strict=True)]
    pairs = [list(f.readings.values()) + [f.total] for f in result]
    pairs = [row + list(f.changes.values()) + list(f.paths_mm.values()) for row, f in zip(pairs, result, strict=True)]
    apart = np.array([[pair.deviations for pair in row] for row in pairs])
    # A standard deviation of n values has the relative error 1 / sqrt(2 n): at most five of these of 1000 values.
    assert np.std(apart) == pytest.approx(1, abs=0.06)
    assert np.abs(apart.mean(axis=0)).max() < 4 / math.sqrt(len(result))
    ratio, stderr = np.array([pair.ratio for row in pairs for pair in row[:9]]).T
    assert np.std((ratio - 1) / stderr) == pytest.approx(1, abs=0.08)
    assert np.mean([f.chi2 for f in result]) == pytest.approx(8, abs=4 * math.sqrt(16 / len(result)))
    p = np.sort([f.p_value for f in result])
    assert np.abs(p - (np.arange(len(p)) + 0.5) / len(p)).max() < 1.63 / math.sqrt(len(p))


def test_a_brighter_scene_is_detected(scene):
    result = compared(synthetic(1), OtherDetection("other", scene, 0, synthetic(2, brighter=1.2)))
    ratio, stderr = result.total.ratio
    assert result.p_value < 1e-3 and ratio == pytest.approx(1 / 1.2, abs=4 * stderr)
    assert f"chi^2 {result.chi2:.1f} of 8 readings" in "\n".join(result.lines())
    assert json.dumps(result.as_dict())


def test_a_change_that_few_photons_carry_has_no_error(scene):
    """Rationale: records of one photon at several photodiodes are one term of a sum. Expected: of a change that 20
    photons carry, each at all eight photodiodes, the standard error is NaN; of one that 100 carry, it is a number."""

    def detected_by_all(carriers: int) -> LedTrace:
        photon = np.append(np.repeat(np.arange(1000), 8), np.arange(1000, 2000))
        which = np.arange(len(photon)) % 8
        paths = np.zeros((len(photon), 8), np.float32)
        paths[photon < carriers, 1:4] = 1.0
        return LedTrace(PHOTONS, np.zeros(8), photon, which, np.ones(len(photon)), paths, {}, (1,))

    result = compared(detected_by_all(100), OtherDetection("other", scene, 0, detected_by_all(20)))
    assert all(np.isfinite(pair.ours_stderr) and np.isnan(pair.theirs_stderr) for pair in result.changes.values())


def test_paths_in_the_bed_are_compared_as_one(scene):
    """Rationale: zones of blood pass into each other here and have edges in an export, so that on boards that are not
    symmetric their paths differ by several standard errors. Expected: light whose path in the bed is split differently
    between the zones compares as equal, by the standard error of their sum."""
    ours, theirs = synthetic(1), synthetic(2)
    bed, step = theirs.path_mm[:, 1:3].sum(1), np.float32(0.8)
    theirs.path_mm[:, 1], theirs.path_mm[:, 2] = step * bed, (1 - step) * bed
    result = compared(ours, OtherDetection("other", scene, 0, theirs))
    assert {"plate", "bed", "bone"} <= result.paths_mm.keys() and not any("bed_" in name for name in result.paths_mm)
    pair = result.paths_mm["bed"]
    assert abs(pair.deviations) < 4 and pair.ours == pytest.approx(2.0, abs=5 * pair.ours_stderr)
    assert pair.ours_stderr == pytest.approx(np.sqrt(2 / len(ours.weight)), rel=0.1)


def write(path, known, **other) -> None:
    trace = synthetic(5)
    fields = {"photodiode": trace.photodiode, "path_mm": trace.path_mm, "photons": PHOTONS, "led": 0, "seed": 1}
    np.savez(path, **(fields | {"program": "other", "scene": to_toml(known)} | other))


def test_a_file_is_read_as_it_was_written(scene, tmp_path):
    write(tmp_path / "detected.npz", scene)
    result = read_detected(tmp_path / "detected.npz")
    assert (result.program, result.led, result.trace.photons) == ("other", 0, PHOTONS)
    assert (result.trace.path_mm == synthetic(5).path_mm).all()


@pytest.mark.parametrize(
    ("other", "why"),
    [
        ({"path_mm": np.zeros((3, 8))}, "path_mm has shape"),
        ({"photodiode": np.full(len(synthetic(5).weight), 8)}, "but the scene has 8"),
        ({"path_mm": np.full((len(synthetic(5).weight), 8), np.nan)}, "finite and not negative"),
        ({"photons": 3}, "fewer than the"),
        ({"led": 4}, "no LED 5"),
        ({"scene": "[finger"}, "its scene"),
        ({"photons": "many"}, "is not what an export's runner writes"),
        ({"program": np.array([{}], dtype=object)}, "is not what an export's runner writes"),
    ],
)
def test_what_does_not_belong_to_a_scene_is_refused_in_one_line(scene, tmp_path, other, why, capfd):
    write(tmp_path / "detected.npz", scene, **other)
    with pytest.raises(InputError, match=why):
        read_detected(tmp_path / "detected.npz")
    assert run(["compare-with", str(tmp_path / "detected.npz")]) == 2
    assert capfd.readouterr().err.count("\n") == 1


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 no archive", b"a,b\n1,2\n"])
def test_another_file_is_refused_in_one_line(tmp_path, content, capfd):
    (tmp_path / "x.npz").write_bytes(content)
    assert run(["compare-with", str(tmp_path / "x.npz")]) == 2
    assert run(["compare-with", str(tmp_path / "missing.npz")]) == 2
    assert run(["compare-with", str(tmp_path)]) == 2
    assert capfd.readouterr().err.count("\n") == 3


@pytest.mark.parametrize(("format", "program"), [("mmc", "pmmc"), ("mcx", "pmcxcl")])
def test_what_a_runner_saves_is_read(scene, tmp_path, monkeypatch, format, program):
    """A program of the test's own detects one photon in the middle of the second photodiode, and one elsewhere."""
    paths = nailoptics.export(scene, tmp_path / "out", format=format, **({"voxel_mm": 0.5} if format == "mcx" else {}))
    session = json.loads(paths["led_1"].read_text(encoding="utf-8"))
    # The middle of facets lies off them, by micrometres.
    place = np.array(session["Optode"]["Detector"][1]["Pos"]) + [0.0, 0.0, 0.01 if format == "mmc" else 0.0]
    media = len(session["Domain"]["Media"]) - 1

    def run(**how):
        paths_mm = np.tile(np.arange(1.0, 1 + media), (2, 1)).T
        scatterings = np.zeros((media if format == "mmc" else 0, 2))
        where, way = np.column_stack([place, place - 1e3]), np.tile([[0.0], [0.0], [1.0]], 2)
        return {"detp": np.vstack([np.ones((1, 2)), scatterings, paths_mm, where, way, np.ones((1, 2))])}

    monkeypatch.setitem(sys.modules, program, SimpleNamespace(run=run))
    options = ["--photons", "64", "--opencl", "-o", str(tmp_path / "detected.npz")]
    monkeypatch.setattr(sys, "argv", ["run", str(paths["led_1"]), *options])
    runpy.run_path(str(paths["run"]), run_name="__main__")
    detection = read_detected(tmp_path / "detected.npz")
    assert detection.program == program and detection.trace.photons == 64
    assert (detection.trace.photodiode == 1).all() and len(detection.trace.photodiode) == (64 if format == "mmc" else 1)
    path_mm = session["Domain"].get("LengthUnit", 1.0) * np.arange(1.0, 1 + len(session["nailoptics"]["absorbers"]))
    assert detection.trace.path_mm == pytest.approx(np.tile(path_mm, (len(detection.trace.photodiode), 1)))

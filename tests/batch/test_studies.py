"""Sweeps that name their study: colours with photographs, oximeters and light alone are jobs like any other."""

import os
import signal

import numpy as np
import pytest
from shown import all_shown
from small_scenes import SMALL_FINGER_BEST

import nailoptics as nail
from nailoptics.batch import load_sweep, run_batch
from nailoptics.batch.jobs import Settings, jobs_of
from nailoptics.errors import InputError, NotReachedError
from nailoptics.options import TraceOptions
from nailoptics.report.pages.sweep import write_sweep
from nailoptics.studies.colour.reflectance import NODES

from .conftest import Here, bits
from .test_run import children, done_here

pytestmark = pytest.mark.jit

COLOURS = """
schema_version = 1
study = "colour"
base = "finger.toml"
[[axes]]
path = "colour.illuminant"
values = ["D65", "A"]
[[axes]]
path = "finger.melanin_fraction"
name = "melanin"
values = [0.01, 0.05]
"""
SMALL = "[accuracy]\nphotons = 8000\n[priors]\nspread = false\n"
SMALL += "[colour]\nforces_n = [0.0, 4.0]\nphotograph_px = [40, 30]\n"


def colours(folder):
    (folder / "finger.toml").write_text(SMALL_FINGER_BEST + SMALL)
    (folder / "colours.toml").write_text(COLOURS)
    return load_sweep(folder / "colours.toml")


@pytest.mark.long
def test_a_killed_sweep_of_photographs_is_resumed(jit_backend, coarse_cells, tmp_path, monkeypatch):
    """The worker is killed (SIGKILL) once two of four results are there; the next run does the others alone."""
    sweep = colours(tmp_path)
    killed = []

    def kill(p):
        if len(bits(tmp_path / "b")) >= 2 and not killed and children():
            killed.append(children()[0])
            os.kill(killed[0], signal.SIGKILL)
            raise KeyboardInterrupt

    with pytest.raises(NotReachedError):
        run_batch(sweep, tmp_path / "b", workers=1, progress=kill)
    before = bits(tmp_path / "b")
    assert killed and 2 <= len(before) < 4
    monkeypatch.setattr("nailoptics.batch.run.LocalSlots", Here)
    outcome = run_batch(sweep, tmp_path / "b", workers=1)
    assert len(outcome.kept) == len(before) and len(outcome.done) == 4 - len(before)
    after = bits(tmp_path / "b")
    assert len(after) == 4 and before.items() <= after.items()
    # People of one finger share their rays: one light for each wavelength that is walked.
    assert outcome.traces == 1 and len(list((tmp_path / "b" / "light").iterdir())) == NODES
    results = nail.open_results(tmp_path / "b")
    assert results.photograph.dims == ("illuminant", "melanin", "force", "row", "column", "channel")
    assert results.photograph.shape == (2, 2, 2, 30, 40, 3) and results.photograph.dtype == np.uint8
    # More melanin darkens skin, and an incandescent lamp changes every colour.
    skin = results.lab.isel(place=0, force=0, band=0)
    assert (skin.sel(melanin=0.05) < skin.sel(melanin=0.01) - 2).all()
    assert abs(results.lab.sel(illuminant="A") - results.lab.sel(illuminant="D65")).max() > 1
    alone = nail.colour(sweep.scenes[3])
    assert results.lab.values[1, 1] == pytest.approx(alone.lab.values, abs=1e-6)
    all_shown(alone)
    paths = write_sweep(results, tmp_path / "b", failures={})
    assert paths["contact_sheet"].stat().st_size > 10_000
    table = paths["table"].read_text().splitlines()
    assert len(table) == 1 + 4 * 2 * results.sizes["place"] and "lab_L*" in table[0]


def test_an_oximeter_and_light_alone_are_swept_too(jit_backend, tmp_path):
    (tmp_path / "light.toml").write_text(
        'schema_version = 1\nstudy = "trace"\nbase = "prototype"\n'
        '[[axes]]\npath = "blood.so2"\nvalues = [0.8, 0.97]\n[[axes]]\npath = "accuracy.photons"\nvalues = [8000]\n'
    )
    sweep = load_sweep(tmp_path / "light.toml")
    reports = done_here(sweep, Settings.of(tmp_path / "l", TraceOptions(backend=jit_backend.name), sweep.study))
    assert reports == [("done", "")] * 2
    results = nail.open_results(tmp_path / "l")
    direct = nail.trace(sweep.scenes[0], seed=0).at()
    assert results.detected_fraction_rest.values[0, 0] == pytest.approx(direct.detected_fraction.values)
    assert "energy" in results and "volts_start" not in results


@pytest.mark.long
def test_an_oximeter_is_swept_over_its_pulse(jit_backend, coarse_cells, few_photons_beside, monkeypatch, tmp_path):
    # Its bias over what disturbs it is nothing that a sweep reads.
    monkeypatch.setattr("nailoptics.studies.oximetry.oxygen.sensitivity_curves", lambda *_: {})
    (tmp_path / "o.toml").write_text(
        'schema_version = 1\nstudy = "oximeter"\nbase = "pulse_oximeter"\n'
        '[[axes]]\npath = "blood.so2"\nvalues = [0.9, 0.97]\n'
    )
    # Of the command, as the scene's own tolerance would hold beside photons of a sweep.
    sweep, options = load_sweep(tmp_path / "o.toml"), TraceOptions(backend=jit_backend.name, photons=20_000)
    reports = done_here(sweep, Settings.of(tmp_path / "o", options, sweep.study))
    assert reports == [("done", "")] * 2
    # One light for each LED.
    assert len([path for path in (tmp_path / "o" / "light").iterdir() if path.is_dir()]) == 2
    results = nail.open_results(tmp_path / "o")
    assert results.ratio_at_rest.dims == ("so2", "photodiode") and np.isfinite(results.ratio_at_rest).any()
    assert len(write_sweep(results, tmp_path / "o", failures={})["table"].read_text().splitlines()) > 1


def test_two_studies_of_one_scene_are_two_results(tmp_path):
    sweep = colours(tmp_path)
    settings = Settings(tmp_path / "b", TraceOptions(backend="llvm"), None)
    studied = Settings(tmp_path / "b", TraceOptions(backend="llvm"), None, "colour")
    digests = [{one.digest for one in jobs_of(sweep, each)} for each in (settings, studied)]
    assert not digests[0] & digests[1]
    assert len({one.key for one in jobs_of(sweep, studied)}) == 1


def test_an_unknown_study_is_refused_in_one_line(tmp_path):
    sweep = colours(tmp_path)
    with pytest.raises(InputError, match="relative_error: a sweep of colours has none; give colour.tolerance"):
        run_batch(sweep, tmp_path / "b", relative_error=0.1)
    (tmp_path / "colours.toml").write_text(COLOURS.replace('"colour"', '"smell"', 1))
    with pytest.raises(InputError, match="study = \"smell\": must be 'simulate', 'trace', 'oximeter' or 'colour'"):
        load_sweep(tmp_path / "colours.toml")

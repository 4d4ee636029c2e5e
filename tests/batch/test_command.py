"""The batch command: what it prints, writes and ends with."""

import json

import pytest

from nailoptics import cli

from .conftest import FAILING, phantoms

pytestmark = pytest.mark.jit


def test_a_batch_from_the_command_line(jit_backend, tmp_path, capsys):
    phantoms(tmp_path, 3)
    sweep, folder = str(tmp_path / "slabs3.toml"), str(tmp_path / "b")
    assert cli.run(["batch", sweep, "-o", folder, "--workers", "1", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert (printed["total"], len(printed["done"]), printed["failed"]) == (3, 3, {})
    lines = (tmp_path / "b" / "table.csv").read_text().splitlines()
    assert len(lines) == 4 and lines[0].startswith("thickness_mm,led,photodiode,")
    page = (tmp_path / "b" / "report.html").read_text()
    assert "3 scenes: 3 done" in page and "<svg" in page and "://" not in page.replace("http://www.w3.org", "")
    for form in (["--status", folder], [sweep, "-o", folder, "--status"]):
        assert cli.run(["batch", *form, "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["done"] == 3
    assert cli.run(["batch", "--status", folder]) == 0
    assert "3 of 3 scenes done" in capsys.readouterr().out
    assert cli.run(["batch", sweep, "--dry-run", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["traces"] == 3


def test_a_sweep_names_once_the_vessels_that_are_far_off_the_list(tmp_path, capsys):
    axis = '[[axes]]\npath = "blood.tuning.capillary_stiffness_n_per_m"\nvalues = [1e-6, 1e5, 1e-5]\n'
    (tmp_path / "far.toml").write_text(f'schema_version = 1\nbase = "prototype"\n{axis}')
    assert cli.run(["batch", str(tmp_path / "far.toml"), "--dry-run"]) == 0
    err = capsys.readouterr().err
    assert err.count("more than 100 times off the paper's list") == 1
    assert "= 1e-06 (listed 100000)" in err and "= 1e-05 (listed 100000)" in err


def test_failures_end_with_3_and_stand_on_the_page(jit_backend, here, tmp_path, capsys):
    (tmp_path / "s.toml").write_text(FAILING)
    assert cli.run(["batch", str(tmp_path / "s.toml"), "-o", str(tmp_path / "b"), "--workers", "1"]) == 3
    assert "2 failed" in capsys.readouterr().err
    page = (tmp_path / "b" / "report.html").read_text()
    assert "needs the photons engine" in page and "Over light.engine." in page


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere.toml", "-o", "b"], "cannot be read"),
        (["--status", "nowhere"], "not a batch folder"),
        (["SWEEP"], "needs -o"),
        (["SWEEP", "-o", "b", "--workers", "0"], "workers = 0"),
        (["SWEEP", "-o", "b", "--shard", "9/3"], "shard 9/3"),
        (["SWEEP", "-o", "slabs2.toml"], "slabs2.toml"),
    ],
)
def test_mistakes_end_with_2(jit_backend, tmp_path, monkeypatch, capsys, arguments, words):
    phantoms(tmp_path, 2)
    monkeypatch.chdir(tmp_path)
    assert cli.run(["batch", *("slabs2.toml" if a == "SWEEP" else a for a in arguments)]) == 2
    message = capsys.readouterr().err
    assert words in message and message.count("\n") == 1

"""Force from volts from the command line alone: two recordings, a calibration, and a held-out touch."""

import csv
import json
from pathlib import Path

import pytest
from small_scenes import SMALL_FINGER_BEST

from nailoptics.cli import run
from nailoptics.studies.force.predict import CSV_COLUMNS
from nailoptics.studies.force.subject import load_subject

pytestmark = pytest.mark.slow

# The photodiode beside the LED would saturate the usual stage.
SECOND = '[[photodiodes]]\nname = "distal"\nposition_mm = [0.5, 2.0]\n[electronics]\nfeedback_ohm = 1e5\n'
TOUCH = """
[touch]
profile = "cycle"
site = "{site}"
contact_area_mm2 = 100.0
force_n = {force_n}
period_s = 3.0
cycles = 4
waveform = "triangle"
start_s = 2.0
sample_rate_hz = 20.0
"""
PHOTONS = ["--photons", str(1 << 18), "--seed", "1"]


def _json(capsys: pytest.CaptureFixture[str], arguments: list[str]) -> dict[str, object]:
    capsys.readouterr()
    assert run([*arguments, "--json"]) == 0
    return dict(json.loads(capsys.readouterr().out))


def test_a_person_is_recorded_calibrated_and_predicted(
    chosen_jit: object, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Rationale: three scenes of one small board, few photons. Expected: every command ends with 0 and writes what it
    reports, and the force is estimated far better than not at all, with an interval that covers it.
    """
    for name, site, force_n in (("one", "proximal", 1.2), ("two", "distal", 1.2), ("touch", "proximal", 0.6)):
        scene = tmp_path / f"{name}.toml"
        scene.write_text(SMALL_FINGER_BEST + SECOND + TOUCH.format(site=site, force_n=force_n))
        recording, out = str(tmp_path / f"{name}.csv"), str(tmp_path / name)
        assert run(["simulate", str(scene), "-o", out, "--recording", recording, *PHOTONS]) == 0
    subject = tmp_path / "me.toml"
    recordings = [str(tmp_path / f"{name}.csv") for name in ("one", "two")]
    result = _json(capsys, ["calibrate", str(tmp_path / "one.toml"), *recordings, "-o", str(subject), *PHOTONS])
    assert result["subject"] == str(subject) and set(result["readings"]) == {"pd", "distal"}
    assert subject.exists() and subject.with_suffix(".html").exists()
    # A trace that falls short of what is required is followed by its fit all the same.
    late, short = tmp_path / "late.toml", ["--relative-error", "1e-4", "--max-seconds", "1", "--seed", "1"]
    assert run(["calibrate", str(tmp_path / "one.toml"), *recordings, "-o", str(late), *short]) == 3
    assert f"What was reached is in {late}." in capsys.readouterr().err and load_subject(late).quality.rms_n < 1.0
    estimated = _json(capsys, ["predict", str(subject), str(tmp_path / "touch.csv"), "-o", str(tmp_path / "predicted")])
    assert estimated["rms_n"] < 0.1 and estimated["coverage_95"] > 0.8 and estimated["consistent"]
    # Four cycles; each event stands beside the measured one of its own cycle, which it may precede.
    assert [event["kind"] for event in estimated["events"]] == ["press", "release"] * 4
    assert all(abs(event["latency_s"]) < 0.3 for event in estimated["events"])
    made = {path.name for path in (tmp_path / "predicted").iterdir()}
    assert made == {"predict.nc", "predict.csv", "predict.html", "predict.png"}
    with (tmp_path / "predicted" / "predict.csv").open() as file:
        head, *rows = csv.reader(file)
    assert head == list(CSV_COLUMNS)
    assert len(rows) == len((tmp_path / "touch.csv").read_text().splitlines()) - 1

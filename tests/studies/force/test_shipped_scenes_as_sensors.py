"""What simulate records of every shipped finger under the protocol calibrates a sensor, and that sensor reads it: files
of one command run in the next."""

from pathlib import Path

import pytest
from fewer_photons import SHORT_PROTOCOL

from nailoptics import load_scene
from nailoptics.assets import data_dir
from nailoptics.cli import run
from nailoptics.scene import Body, Touch, protocol, to_toml
from nailoptics.studies.force import fit
from nailoptics.studies.force.predict import CSV_COLUMNS

# Two LEDs, and eight zones of blood; the others differ in touch and board.
UNLIKE_OTHERS = {"pulse_oximeter", "white_band"}
FINGERS = [
    pytest.param(path, id=path.stem, marks=pytest.mark.long if path.stem in UNLIKE_OTHERS else pytest.mark.slow)
    for path in sorted(data_dir("scenes").glob("*.toml"))
    if load_scene(path).finger is not None
]
PHOTONS = ["--photons", "30000", "--seed", "1"]


@pytest.mark.parametrize("scene", FINGERS)
def test_a_shipped_finger_is_recorded_calibrated_and_predicted(
    chosen_jit: object,
    shared_light: None,
    scene: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    request: pytest.FixtureRequest,
) -> None:
    # Any touches are recorded alike, and any fit of them is written and read.
    for name, value in SHORT_PROTOCOL.items():
        monkeypatch.setattr(protocol, name, value)
    monkeypatch.setattr(fit, "STARTS", ({},))
    monkeypatch.setattr(fit, "ROUNDS", 1)
    recording, subject, out = (str(tmp_path / name) for name in ("recording.csv", "me.toml", "out"))
    loaded, own = load_scene(scene), ("contact_area_mm2", "distal_relaxation_s", "creep", "creep_s")
    touch = {"profile": "protocol", "sample_rate_hz": 12.5} | {name: getattr(loaded.touch, name) for name in own}
    # A recorded body is as long as the touch that it was recorded with.
    body = Body() if loaded.body is not None and loaded.body.file is not None else loaded.body
    scene = tmp_path / "scene.toml"
    # What priors add to the errors of the recording, by traces of their own, is in no file that the next command reads.
    update = {"touch": Touch.model_validate(touch), "body": body}
    update["priors"] = loaded.priors.model_copy(update={"spread": False})
    scene.write_text(to_toml(loaded.model_copy(update=update)))
    assert run(["simulate", str(scene), "-o", str(tmp_path / "run"), "--recording", recording, *PHOTONS]) == 0
    # Pages of the next commands have the same figures for all boards.
    request.getfixturevalue("undrawn")
    assert run(["calibrate", str(scene), recording, "-o", subject, *PHOTONS]) == 0
    # Its first minute and a half, with touches of both sides.
    lines = Path(recording).read_text().splitlines()[:1125]
    Path(recording).write_text("\n".join(lines) + "\n")
    assert run(["predict", subject, recording, "-o", out]) == 0
    rows = (Path(out) / "predict.csv").read_text().splitlines()
    assert rows[0] == ",".join(CSV_COLUMNS)
    assert len(rows) == len(lines)

"""What simulate records of every shipped finger under the protocol calibrates a sensor, and that sensor reads it: files
of one command run in the next."""

from pathlib import Path

import pytest

from nailoptics import load_scene
from nailoptics.assets import data_dir
from nailoptics.cli import run
from nailoptics.scene import Body, Touch, to_toml
from nailoptics.studies.force.predict import CSV_COLUMNS

# Differ from the two that stay in the side of the touch alone.
LIKE_OTHERS = {"static_distal", "dynamic_proximal"}
FINGERS = [
    pytest.param(path, id=path.stem, marks=pytest.mark.slow if path.stem in LIKE_OTHERS else pytest.mark.long)
    for path in sorted(data_dir("scenes").glob("*.toml"))
    if load_scene(path).finger is not None
]
PHOTONS = ["--photons", "100000", "--seed", "1"]


@pytest.mark.parametrize("scene", FINGERS)
def test_a_shipped_finger_is_recorded_calibrated_and_predicted(
    chosen_jit: object, shared_light: None, scene: Path, tmp_path: Path
) -> None:
    recording, subject, out = (str(tmp_path / name) for name in ("recording.csv", "me.toml", "out"))
    loaded, own = load_scene(scene), ("contact_area_mm2", "distal_relaxation_s", "creep", "creep_s")
    touch = {"profile": "protocol", "sample_rate_hz": 10.0} | {name: getattr(loaded.touch, name) for name in own}
    # A recorded body is as long as the touch that it was recorded with.
    body = Body() if loaded.body is not None and loaded.body.file is not None else loaded.body
    scene = tmp_path / "scene.toml"
    scene.write_text(to_toml(loaded.model_copy(update={"touch": Touch.model_validate(touch), "body": body})))
    assert run(["simulate", str(scene), "-o", str(tmp_path / "run"), "--recording", recording, *PHOTONS]) == 0
    assert run(["calibrate", str(scene), recording, "-o", subject, *PHOTONS]) == 0
    assert run(["predict", subject, recording, "-o", out]) == 0
    rows = (Path(out) / "predict.csv").read_text().splitlines()
    assert rows[0] == ",".join(CSV_COLUMNS)
    assert len(rows) == len(Path(recording).read_text().splitlines())

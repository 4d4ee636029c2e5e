"""What `nailoptics oximeter` refuses, before any light is traced: one line, exit code 2, nothing written."""

import pytest

from nailoptics.assets import data_dir
from nailoptics.cli import run

SHIPPED = (data_dir("scenes") / "pulse_oximeter.toml").read_text(encoding="utf-8")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("nailoptics.studies.oximetry.ratio.trace_for_ratio", None)
    return tmp_path


@pytest.mark.parametrize(
    ("change", "arguments", "words"),
    [
        (("rate_per_min = 70.0", "rate_per_min = 5.0"), [], "rate_per_min"),
        (("pulse_pressure_pa = 2000.0", "pulse_pressure_pa = 0.0"), [], "without a pulse"),
        (("start_ms = 2.5", "start_ms = 1.0"), [], "overlaps"),
        (('part = "led_940"', 'part = "led_660"'), [], "same blood"),
        (("", ""), ["--readings", "missing.csv"], "missing.csv"),
        (("", ""), ["--readings", "empty.csv"], "is empty"),
        (("", ""), ["--readings", "short.csv"], "three beats"),
    ],
)
def test_what_is_refused_is_one_line(folder, capfd, change, arguments, words):
    (folder / "scene.toml").write_text(SHIPPED.replace(*change) if change[0] else SHIPPED)
    (folder / "empty.csv").write_text("")
    rows = [f"{0.01 * k:.2f},{1 + 1e-3 * (k % 50):.4f},{1 + 2e-3 * (k % 50):.4f}" for k in range(60)]
    (folder / "short.csv").write_text("\n".join(["time_s,red:axis.1,infrared:axis.1", *rows]))
    assert run(["oximeter", "scene.toml", *arguments]) == 2
    out, err = capfd.readouterr()
    assert out == "" and len(err.splitlines()) == 1 and words in err
    assert {path.name for path in folder.iterdir()} == {"scene.toml", "empty.csv", "short.csv"}


def test_a_scene_of_one_led_is_refused(folder, capfd):
    assert run(["oximeter", "prototype"]) == 2
    assert "two LEDs" in capfd.readouterr().err

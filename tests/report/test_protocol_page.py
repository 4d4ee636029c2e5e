"""The page of a protocol: the line moves by its clock, or by the force that is piped in, which it shows."""

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import pytest

from nailoptics.cli import run
from nailoptics.report.pages.protocol import page, serve
from nailoptics.scene.protocol import protocol

DRAWN = protocol(3)
LEFT = re.compile(r"(\d+) s are left")


@pytest.fixture
def tab(browser: Any) -> Iterator[Any]:
    """A tab that fails the test on any error of its scripts or its policy."""
    tab, faults = browser.new_page(), list[str]()
    tab.on("pageerror", lambda error: faults.append(str(error)))
    tab.on("console", lambda message: faults.append(message.text) if message.type == "error" else None)
    yield tab
    tab.close()
    assert faults == []


def _left_s(tab: Any) -> int:
    result = LEFT.search(tab.inner_text("#now"))
    assert result
    return int(result.group(1))


def _wait_until(tab: Any, expression: str) -> None:
    """Wait until something holds on a page whose policy lets no text run as code."""
    for _ in range(100):
        if tab.evaluate(expression):
            return
        tab.wait_for_timeout(50)
    raise AssertionError(expression)


def _pass_s(tab: Any, seconds: int) -> None:
    """Let time pass by the clock of a page: most of it between two of its frames, the last second frame by frame."""
    tab.clock.fast_forward(1000 * (seconds - 1))
    tab.clock.run_for(1000)


def test_the_whole_protocol_has_axes_with_units(tab: Any, tmp_path: Path) -> None:
    (tmp_path / "protocol.html").write_text(page(DRAWN), encoding="utf-8")
    tab.goto((tmp_path / "protocol.html").as_uri())
    written = """() => {
      const shown = [], write = CanvasRenderingContext2D.prototype.fillText;
      CanvasRenderingContext2D.prototype.fillText = (text) => shown.push(text);
      draw_whole(0);
      CanvasRenderingContext2D.prototype.fillText = write;
      return shown;
    }"""
    assert {"force [N]", "time [min]", "0", "1", "2", "3"} <= set(tab.evaluate(written))


def test_a_click_starts_the_line_and_another_holds_it(tab: Any, tmp_path: Path) -> None:
    (tmp_path / "protocol.html").write_text(page(DRAWN), encoding="utf-8")
    tab.clock.install()
    tab.goto((tmp_path / "protocol.html").as_uri())
    whole_s = _left_s(tab)
    assert whole_s == pytest.approx(DRAWN.time_s[-1], abs=1) and "Rest. Next is the proximal" in tab.inner_text("#now")
    tab.click("#start")
    _pass_s(tab, 20)
    assert _left_s(tab) == pytest.approx(whole_s - 20, abs=1)
    tab.click("#start")
    _pass_s(tab, 20)
    assert _left_s(tab) == pytest.approx(whole_s - 20, abs=1)
    tab.click("#start")
    _pass_s(tab, 150)
    assert "distal side" in tab.inner_text("#now")
    _pass_s(tab, 150)
    assert "complete" in tab.inner_text("#now")


def test_the_measured_force_moves_a_served_page(tab: Any) -> None:
    """Expected: the line's time is that since the first sample, the bar grows evenly with the last one's force."""
    bar_px, lines = list[int](), list[str]()

    def samples() -> Iterator[dict[str, float]]:
        yield {"time_s": 100.0, "force_n": 0.0}
        address = lines[0].split()[-1]
        tab.goto(address)
        for force_n in (0.5, 1.0, 1.5):
            yield {"time_s": 140.0, "force_n": force_n}
            with urlopen(f"{address}force") as answer:
                assert json.load(answer) == {"time_s": 40.0, "force_n": force_n}
            _wait_until(tab, f"measured && measured.force_n === {force_n}")
            # Pixels of the bar near its left edge, beside its number.
            bar_px.append(tab.evaluate(_BAR))
            assert _left_s(tab) == pytest.approx(DRAWN.time_s[-1] - 40, abs=1)
        yield {"time_s": 141.0, "force_n": float("nan")}
        assert tab.evaluate("measured.force_n") == 1.5
        tab.evaluate("listen = () => {}")
        tab.wait_for_timeout(100)

    serve(DRAWN, samples(), lines.append)
    assert bar_px[1] - bar_px[0] > 50 and bar_px[2] - bar_px[1] == pytest.approx(bar_px[1] - bar_px[0], abs=2)


_BAR = """() => {
  draw();
  const x = canvas.width - (BARS - 16 - 68 - 2) * devicePixelRatio;
  const pixels = canvas.getContext("2d").getImageData(x, 0, 1, canvas.height).data;
  return pixels.filter((value, k) => k % 4 === 0 && value < 40 && pixels[k + 3] === 255).length;
}"""


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ("time_s,grams\n0,1\n", "stdin: has no column force_n"),
        ("", "stdin: has no column time_s"),
        ("time_s,force_n\n0,x\n", "stdin line 2: force_n = 'x' is not a finite number"),
    ],
)
def test_lines_that_are_no_force_end_it_with_one_line(tmp_path: Path, lines: str, message: str) -> None:
    command = [sys.executable, "-m", "nailoptics", "protocol", "prototype", "-", "-o", str(tmp_path / "p.csv")]
    done = subprocess.run(command, input=lines, capture_output=True, text=True, check=False)
    assert done.returncode == 2 and message in done.stderr.splitlines()[-1]


def test_the_command_writes_a_page_beside_the_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["protocol", "prototype", "-o", str(tmp_path / "p.csv"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["report"] == str(tmp_path / "p.html")
    text = (tmp_path / "p.html").read_text()
    assert "connect-src" not in text and "Digest of the scene" in text and "nailoptics=" in text and "<dt>Seed" in text
    assert "The sensor stays on throughout" in text and "take the sensor off and put it on" not in text
    assert "take the sensor off and put it on" in page(protocol(3, donnings=2))
    assert run(["protocol", "prototype", "-o", str(tmp_path / "p.txt")]) == 2
    assert "ends in .csv" in capsys.readouterr().err and not (tmp_path / "p.txt").exists()

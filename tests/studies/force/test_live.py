"""Force line by line, as a sensor that is piped in: however its lines come, and however it ends."""

import signal
import subprocess
import sys
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any

import made_sensor
import numpy as np
import pytest

from nailoptics.cli import run
from nailoptics.errors import InputError
from nailoptics.scene.importers.sensor_recordings import recording_csv
from nailoptics.studies.force.predict import csv_rows, live, predict, predict_live
from nailoptics.studies.force.subject import Subject, parse_subject, subject_toml

NAMES = made_sensor.table().names


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("live")
    (folder / "me.toml").write_text(made_sensor.subject())
    touch = made_sensor.record(made_sensor.cycle(0.6, lasting_s=4.0), "proximal", seed=3)
    (folder / "touch.csv").write_text(recording_csv(touch))
    return folder


@pytest.fixture(scope="module")
def subject(folder: Path) -> Subject:
    return parse_subject((folder / "me.toml").read_text())


@pytest.fixture(scope="module")
def lines(folder: Path) -> list[str]:
    return (folder / "touch.csv").read_text().splitlines(keepends=True)[:12]


def test_estimates_of_lines_are_those_of_a_file_and_come_one_by_one(
    subject: Subject, folder: Path, lines: list[str]
) -> None:
    (folder / "part.csv").write_text("".join(lines))
    given = iter(lines)
    answers = live(subject, given)
    estimated = [next(answers), next(answers)]
    # The first sample is answered before the second is read.
    assert len(list(given)) == len(lines) - 2
    assert [*estimated, *list(live(subject, lines))[2:]] == list(csv_rows(predict(subject, folder / "part.csv")))


def test_samples_too_slow_for_the_filter_are_refused_whichever_way_they_come(subject: Subject, folder: Path) -> None:
    """Rationale: at 10 Hz it restarts in each touch, and reads a held one as rest. Expected: refused as a recording,
    and line by line at the tenth sample; at 12.5 Hz, and with pauses, they are read."""
    touch = made_sensor.record(made_sensor.cycle(0.6, lasting_s=4.0), "proximal", seed=3).select(np.arange(0, 200, 4))
    slow, paused_s = replace(touch, time_s=1.25 * touch.time_s), touch.time_s + 0.3 * (np.arange(50) // 5)
    with pytest.raises(InputError, match=r"in steps of 0.1 \(10 Hz\); record at 12.5 to 100000 Hz"):
        predict(subject, slow)
    answers = live(subject, recording_csv(slow).splitlines(keepends=True))
    assert len([next(answers) for _ in range(10)]) == 10
    with pytest.raises(InputError, match=r"sample at time_s = 0.9: time_s rises in steps of 0.1 \(10 Hz\)"):
        next(answers)
    for read in (touch, replace(touch, time_s=paused_s)):
        assert len(list(live(subject, recording_csv(read).splitlines(keepends=True)))) == 51
        assert predict(subject, read).sizes["time"] == 50


def test_samples_that_become_too_slow_are_refused(subject: Subject) -> None:
    """Expected: when most of those that the rate is of lie too far apart, and not for one pause."""
    volts = dict.fromkeys(NAMES, 0.5)
    times_s = np.cumsum([*np.full(60, 0.02), 0.5, *np.full(60, 0.02), *np.full(60, 0.1)])
    answers = predict_live(subject, ((time_s, volts) for time_s in times_s.tolist()))
    read_s = [next(answers).time_s for _ in range(121)]
    with pytest.raises(InputError, match=r"time_s rises in steps of 0.1 \(10 Hz\)"):
        read_s.extend(one.time_s for one in answers)
    assert 121 < len(read_s) < 121 + 30


def test_estimates_of_samples_in_python_are_those_of_a_recording_and_come_one_by_one(subject: Subject) -> None:
    """Expected: with gaps, too, the forces of `predict`; no sample is taken before the one before it is answered."""
    recording = made_sensor.record(made_sensor.cycle(0.6, lasting_s=4.0), "proximal", seed=3)
    recording.volts[3, 5] = np.nan
    volts = [dict(zip(NAMES, row, strict=True)) for row in recording.volts.T[:12].tolist()]
    given = iter(zip(recording.time_s.tolist(), volts, strict=False))
    forces = predict_live(subject, given)
    first = next(forces)
    assert first.time_s == recording.time_s[0] and next(given)[0] == recording.time_s[1]
    computed = [*predict_live(subject, zip(recording.time_s.tolist(), volts, strict=False))]
    known = predict(subject, recording).isel(time=slice(12))
    for name in ("force_n", "force_low_n", "force_high_n", "proximal_share"):
        assert [getattr(one, name) for one in computed] == pytest.approx(known[name].values)


RIGHT = dict.fromkeys(NAMES, 0.5)


@pytest.mark.parametrize(
    ("samples", "message"),
    [
        ([(0.0, {"other": 0.5})], "sample at time_s = 0: has no column 'proximal.6'"),
        ([(0.0, RIGHT | {"other": 0.5})], "column 'other' is not a reading of this board"),
        ([5], "sample 5: give a time in s and numbers in V"),
        ([("a", RIGHT)], "give a time in s"),
        ([(0.0, dict.fromkeys(NAMES, "0.5"))], "numbers in V"),
        ([(0.0, RIGHT), (float("nan"), RIGHT)], "time_s = nan does not come after 0"),
        ([(0.0, RIGHT), (0.0, RIGHT)], "time_s = 0 does not come after 0"),
        ([(0.0, dict.fromkeys(NAMES, 3e4))], "looks like millivolts or a converter's counts"),
    ],
)
def test_samples_that_are_none_are_an_input_error(subject: Subject, samples: list[Any], message: str) -> None:
    with pytest.raises(InputError) as caught:
        list(predict_live(subject, samples))
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("gap_s", "empty", "unknown"), [(0.0, [0, 1, 2, 6], slice(3)), (6.0, [6, 7, 8], slice(6, 9))], ids=["first", "gap"]
)
def test_before_the_first_reading_force_is_nan(
    subject: Subject, gap_s: float, empty: list[int], unknown: slice
) -> None:
    """Expected: NaN in both at the beginning and after a gap of more than 5 s, and from the next reading on the same
    finite forces; scores leave out what is before."""
    recording = made_sensor.record(made_sensor.cycle(0.6, lasting_s=4.0), "proximal", seed=3)
    recording.time_s[6:] += gap_s
    recording.volts[:, empty] = np.nan
    volts = [dict(zip(NAMES, row, strict=True)) for row in recording.volts.T[:12].tolist()]
    live_n = [one[1:4] for one in predict_live(subject, zip(recording.time_s.tolist(), volts, strict=False))]
    result = predict(subject, recording)
    force_n = np.transpose([result[name][:12] for name in ("force_n", "force_low_n", "force_high_n")])
    assert np.isnan(force_n[unknown]).all() and np.isfinite(np.delete(force_n, unknown, axis=0)).all()
    assert np.array(live_n) == pytest.approx(force_n, nan_ok=True)
    assert np.isnan(result.known_force_n[unknown]).all() and np.isfinite(result.attrs["rms_n"])


def test_rows_without_a_reading_are_a_gap_as_rows_left_out_are(subject: Subject) -> None:
    """Rationale: a logger goes on while the sensor sends nothing. Expected: within 5 s the touch that was held before,
    in an interval that widens; NaN from then on, and rest with the first reading, live as in a file."""
    force_n = np.interp(
        np.arange(0.0, 9.0, made_sensor.STEP_S), [0.0, 0.5, 1.0, 2.0, 7.0, 7.1], [0, 0, 0.5, 0.5, 0.5, 0]
    )
    recording = made_sensor.record(force_n, "distal", seed=3)
    recording.volts[:, (recording.time_s > 2.0) & (recording.time_s < 7.5)] = np.nan
    result = predict(subject, recording)
    lost, long, later = (
        slice(*np.searchsorted(recording.time_s, span)) for span in ((2.0, 6.9), (7.1, 7.4), (7.6, 9.0))
    )
    assert (result.force_low_n[lost] <= 0.5).all() and (result.force_high_n[lost] >= 0.5).all()
    assert np.abs(result.force_n[lost] - result.force_n[lost.start]).max() < 0.05
    assert result.force_low_n[lost][-1] < 0.5 * result.force_low_n[lost.start]
    assert np.isnan(result.force_n[long]).all() and (result.force_n[later] < 0.1).all()
    volts = [dict(zip(NAMES, row, strict=True)) for row in recording.volts.T.tolist()]
    live_n = [one.force_n for one in predict_live(subject, zip(recording.time_s.tolist(), volts, strict=True))]
    assert np.array(live_n) == pytest.approx(result.force_n.values, nan_ok=True)


def test_what_senders_add_is_accepted(subject: Subject, lines: list[str]) -> None:
    plain = list(live(subject, lines))
    windows = [
        "\ufeff" + lines[0].replace("\n", "\r\n"),
        "# hello\r\n",
        "\r\n",
        *(x.replace("\n", "\r\n") for x in lines[1:]),
    ]
    assert list(live(subject, windows)) == plain
    assert list(live(subject, [lines[0].replace("time_s", '"time_s"'), *lines[1:]])) == plain
    # A last line without its end is a sample where it is whole, and none where it is not.
    assert list(live(subject, [*lines[:-1], lines[-1].rstrip("\n")])) == plain
    assert list(live(subject, [*lines[:-1], lines[-1][:20]])) == plain[:-1]


def test_what_a_converter_at_its_limit_reads_is_a_gap(subject: Subject, lines: list[str]) -> None:
    def with_first(cell: str) -> list[str]:
        rows = [line.split(",") for line in lines]
        at = rows[0].index(NAMES[0])
        return [",".join([*row[:at], cell, *row[at + 1 :]]) if k > 3 else ",".join(row) for k, row in enumerate(rows)]

    assert list(live(subject, with_first("5"))) == list(live(subject, with_first("")))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda lines: [], "stdin: is empty"),
        (lambda lines: ["\ufffd\ufffd\x01"], "stdin: is not text"),
        (lambda lines: [lines[0].replace(NAMES[0], "other"), *lines[1:]], f"has no column '{NAMES[0]}'"),
        (lambda lines: [lines[0].replace("\n", ",room\n"), *lines[1:]], "column 'room' is not a reading of this board"),
        (lambda lines: [lines[0].replace("time_s", "t"), *lines[1:]], "no column time_s"),
        (lambda lines: [*lines[:4], _cells(lines[4], "x")], "'x' is not a finite number; an empty cell is a gap"),
        (lambda lines: [*lines[:4], lines[4].replace("0.", "nan", 1)], "stdin line 5"),
        (lambda lines: [*lines[:4], lines[2]], "time_s = 0.02 does not come after 0.04; times must rise"),
        (lambda lines: [*lines[:4], _cells(lines[4], "inf")], "'inf' is not a finite number"),
        (lambda lines: [*lines[:4], _cells(lines[4], "nan")], "an empty cell is a gap"),
        (lambda lines: [*lines[:4], _cells(lines[4], "31000")], "looks like millivolts or a converter's counts"),
    ],
)
def test_a_line_that_is_none_ends_it_with_one_line(subject: Subject, lines: list[str], change, message: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(InputError) as caught:
        list(live(subject, change(lines)))
    assert message in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def _cells(line: str, last: str) -> str:
    return ",".join([*line.rstrip("\n").split(",")[:-1], last]) + "\n"


def test_times_of_a_clock_keep_all_their_digits(subject: Subject, folder: Path, lines: list[str]) -> None:
    times = [str(1763900000 + k / 1000) for k in range(len(lines) - 1)]
    by_clock = [lines[0], *(",".join([t, *line.split(",")[1:]]) for t, line in zip(times, lines[1:], strict=True))]
    (folder / "clock.csv").write_text("".join(by_clock))
    for answers in (live(subject, by_clock), csv_rows(predict(subject, folder / "clock.csv"))):
        assert [line.split(",")[0] for line in answers][1:] == times


def _started(folder: Path) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "nailoptics", "predict", str(folder / "me.toml"), "-"]
    pipe = subprocess.PIPE
    return subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe)


def test_ctrl_c_ends_a_running_command_cleanly(folder: Path, lines: list[str]) -> None:
    with _started(folder) as running:
        assert running.stdin is not None and running.stdout is not None and running.stderr is not None
        running.stdin.write("".join(lines[:3]).encode())
        running.stdin.flush()
        assert [running.stdout.readline().split(b",")[0] for _ in range(3)] == [b"time_s", b"0.0", b"0.02"]
        running.send_signal(signal.SIGINT)
        assert running.wait(60) == 0
        assert running.stdout.read() == running.stderr.read() == b""


def test_a_wrong_calibration_is_reported_at_once(
    subject: Subject, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = replace(subject, quality=replace(subject.quality, rms_n=0.3, touches={}))
    (tmp_path / "me.toml").write_text(subject_toml(wrong))
    monkeypatch.setattr("sys.stdin", StringIO("time_s," + ",".join(NAMES) + "\n"))
    assert run(["predict", str(tmp_path / "me.toml"), "-"]) == 0
    printed = capsys.readouterr()
    off = "the calibration itself was 300 mN off on its own touches (rms): calibrate again."
    assert printed.err == f"nailoptics: {off}\n" and printed.out.startswith("time_s,force_n")


@pytest.mark.long
def test_a_closed_pipe_and_bytes_that_are_no_text_end_it_cleanly(folder: Path, lines: list[str]) -> None:
    with _started(folder) as running:
        assert running.stdin is not None and running.stdout is not None and running.stderr is not None
        running.stdin.write(lines[0].encode())
        running.stdin.flush()
        assert running.stdout.readline().startswith(b"time_s")
        # As `| head -1` does; what comes then cannot be answered any more.
        running.stdout.close()
        running.stdin.write("".join(lines[1:]).encode())
        running.stdin.close()
        assert running.wait(60) == 0
        assert running.stderr.read() == b""
    done = subprocess.run(
        [sys.executable, "-m", "nailoptics", "predict", str(folder / "me.toml"), "-"],
        input=b"\xff\xfe\x00\n",
        capture_output=True,
        check=False,
    )
    assert done.returncode == 2 and done.stdout == b""
    assert done.stderr.decode().splitlines() == [
        "nailoptics: stdin: is not text; give a CSV with time_s and the readings in volts."
    ]

"""Recordings of a worn sensor: what is read, and one line for everything that is none."""

import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from nailoptics.errors import InputError
from nailoptics.scene.importers.sensor_recordings import read_sensor_recording, recording_csv

GOOD = "time_s,force_n,site,a,b\n0,0,proximal,1.0,2.0\n0.01,0.1,proximal,,2.1\n0.03,0.2,even,1.2,2.2\n"


def _read(tmp_path: Path, text: str) -> object:
    file = tmp_path / "recording.csv"
    file.write_text(text)
    result = read_sensor_recording(file)
    return result.with_readings(result.names)


def test_a_recording_is_read_with_its_gaps_and_sites_and_written_again(tmp_path: Path) -> None:
    file = tmp_path / "recording.csv"
    file.write_text(GOOD)
    result = read_sensor_recording(file)
    assert result.names == ("a", "b")
    np.testing.assert_array_equal(result.volts, [[1.0, np.nan, 1.2], [2.0, 2.1, 2.2]])
    np.testing.assert_array_equal(result.site, [1.0, 1.0, np.nan])
    result.save(tmp_path / "out" / file.name)
    again = read_sensor_recording(tmp_path / "out" / file.name)
    for name in ("time_s", "volts", "force_n", "site"):
        np.testing.assert_array_equal(getattr(again, name), getattr(result, name))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("force_n,a\n1,2\n", "no column time_s"),
        ("time_s,force_n\n0,1\n1,2\n", "has no reading"),
        ("time_s,a,a\n0,1,2\n1,2,3\n", "is there twice"),
        ("time_s,a\n0,1\n", "two or more are needed"),
        ("time_s,a\n0,1\n0,2\n", "does not come after"),
        ("time_s,a\n1,1\n0,2\n", "line 3: time_s = 0 does not come after 1"),
        ("time_s,a\n0,x\n1,2\n", "line 2: a = 'x' is not a finite number"),
        ("time_s,a\n0,inf\n1,2\n", "line 2: a = 'inf' is not a finite number"),
        ("time_s,a\n,1\n1,2\n", "line 2: time_s = '' is not a finite number"),
        ("time_s,a\n0,\n1,\n", "column 'a' is empty"),
        ("time_s,a\n0,1\n1,1\n2,1\n", "constant at 1 V; check its wiring"),
        ("time_s,a\n0,31000\n1,32000\n", "looks like millivolts or a converter's counts"),
        ("time_s,force_n,a\n0,-1,1\n1,0,2\n", "line 2: force_n = -1 must lie in 0 to 30 N"),
        ("time_s,force_n,a\n0,-0.06,1\n1,0,2\n", "line 2: force_n = -0.06 must lie in 0 to 30 N"),
        ("time_s,force_n,a\n0,1000,1\n1,0,2\n", "force_n = 1000 must lie in 0 to 30 N"),
        ("time_s;a\n0;1\n1;2\n", "has semicolons between columns"),
        ("time_s,a\n0,0,1\n1,0,2\n", "line 2: has 3 cells for 2 columns; write numbers with a decimal point"),
        ("time_s,,a\n0,1,2\n1,2,3\n", "column 2 has no title"),
        ("time_s,a\n0,1\n20,2\n40,1\n", "in steps of 20 (0.05 Hz); record at 12.5 to 100000 Hz, with times in seconds"),
        ("time_s,a\n0,1\n0.1,2\n0.2,1\n", "in steps of 0.1 (10 Hz); record at 12.5"),
        ("time_s,a\n0,1\n1e-9,2\n", "in steps of 1e-09 (1e+09 Hz); record at 12.5 to 100000 Hz, with times in"),
        ("time_s,a\n1e12,1\n1.000000000001e12,2\n", "line 2: time_s = 1e+12 must lie in -1e+10 to 1e+10 s"),
        ("time_s,site,a\n0,left,1\n1,even,2\n", "line 2: site = 'left' is unknown; choose from proximal, distal, even"),
    ],
)
def test_an_invalid_recording_is_refused_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        _read(tmp_path, text)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_recording_prints_itself_in_a_line(tmp_path: Path) -> None:
    read = _read(tmp_path, "time_s,force_n,a\n0,0,1\n0.08,1.5,2\n")
    assert repr(read).endswith("recording.csv: 1 readings, 2 samples in 0.08 s>")


def test_times_of_a_clock_keep_all_their_digits(tmp_path: Path) -> None:
    file = tmp_path / "recording.csv"
    time_s = 1763900000.0 + np.arange(3) / 1000
    file.write_text("time_s,a\n" + "".join(f"{t!r},{k}\n" for k, t in enumerate(time_s.tolist())))
    result = read_sensor_recording(file)
    file.write_text(recording_csv(result))
    np.testing.assert_array_equal(read_sensor_recording(file).time_s, time_s)
    file.write_text("time_s,a\n1763900000.002,1\n1763900000.001,2\n")
    with pytest.raises(InputError, match=r"1763900000\.001 does not come after 1763900000\.002"):
        read_sensor_recording(file)


def test_reading_takes_memory_for_numbers_not_for_text(tmp_path: Path) -> None:
    file, samples = tmp_path / "recording.csv", 20_000
    file.write_text("time_s,a,b,c\n" + "".join(f"{k / 100},0.5,1.25,{k}e-4\n" for k in range(samples)))
    tracemalloc.start()
    read_sensor_recording(file)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    # Four numbers of 8 bytes and the line's, some of them twice; as lists of strings they took 1.2 kB a sample.
    assert peak < 150 * samples


def test_readings_of_another_board_are_named(tmp_path: Path) -> None:
    file = tmp_path / "recording.csv"
    file.write_text(GOOD)
    result = read_sensor_recording(file)
    assert result.with_readings(("b", "a")).names == ("b", "a")
    with pytest.raises(InputError, match="has no column 'c'"):
        result.with_readings(("a", "b", "c"))
    with pytest.raises(InputError, match="column 'b' is not a reading of this board"):
        result.with_readings(("a",))


def test_what_spreadsheets_add_is_accepted(tmp_path: Path) -> None:
    """A byte order mark, commas at the end of each line, quotes, Windows' line ends and comments."""
    plain = read_sensor_recording(_written(tmp_path, GOOD))
    adorned = "# made today\n" + GOOD.replace("\n", ",,\n").replace("time_s", '"time_s"').replace("\n", "\r\n")
    result = read_sensor_recording(_written(tmp_path, "\ufeff" + adorned))
    assert result.names == plain.names
    np.testing.assert_array_equal(result.volts, plain.volts)


def test_a_load_cell_that_reads_just_below_zero_is_not_pressed(tmp_path: Path) -> None:
    result = read_sensor_recording(_written(tmp_path, "time_s,force_n,a\n0,-0.002,1\n1,0.5,2\n2,,1\n3,-0.05,2\n"))
    assert result.force_n is not None
    np.testing.assert_array_equal(result.force_n, [0.0, 0.5, np.nan, 0.0])


def _written(tmp_path: Path, text: str) -> Path:
    file = tmp_path / "recording.csv"
    file.write_text(text, encoding="utf-8", newline="")
    return file


def test_an_unknown_column_is_named_before_what_it_holds(tmp_path: Path) -> None:
    text = "time_s,a,room\n0,1.0,21\n0.1,1.1,21\n0.2,1.0,21\n"
    with pytest.raises(InputError, match="column 'room' is not a reading of this board"):
        read_sensor_recording(_written(tmp_path, text)).with_readings(("a",))

"""calibrate and predict with recordings and subjects that are none: one line, exit code 2, nothing written."""

import copy
import tomllib
from collections.abc import Callable
from functools import cache
from pathlib import Path

import made_sensor
import numpy as np
import pytest
import tomli_w
from hypothesis import HealthCheck, given, settings, strategies as st
from pydantic import TypeAdapter

from nailoptics.cli import run
from nailoptics.errors import InputError
from nailoptics.report import style
from nailoptics.scene import to_toml
from nailoptics.scene.importers.sensor_recordings import recording_csv
from nailoptics.studies.force import calibrate as calibrating
from nailoptics.studies.force.predict import predict
from nailoptics.studies.force.scores import Baseline
from nailoptics.studies.force.subject import parse_subject

FIRST = made_sensor.table().names[0]
Change = Callable[[str, int], str]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recordings of both sites, one of another touch, and a subject that the command calibrated from eight touches."""
    folder = tmp_path_factory.mktemp("sensor")
    for seed, site in enumerate(("proximal", "distal")):
        (folder / f"{site}.csv").write_text(recording_csv(made_sensor.record(made_sensor.cycle(1.5), site, seed=seed)))
    touch = made_sensor.record(made_sensor.cycle(0.6, lasting_s=4.0), "proximal", seed=3)
    (folder / "touch.csv").write_text(recording_csv(touch))
    (folder / "least.csv").write_text(recording_csv(made_sensor.record_touches(seed=4)))
    _calibrated(folder / "least.csv", folder / "me.toml")
    return folder


def _calibrated(recording: Path, subject: Path) -> None:
    """A subject from one recording, by the command; the scene states the creep of the pulp."""
    scene = subject.with_name("prototype.toml")
    scene.write_text(to_toml(made_sensor.scene()))
    with pytest.MonkeyPatch.context() as patch:
        _without_a_trace(patch)
        assert run(["calibrate", str(scene), str(recording), "-o", str(subject)]) == 0


def _without_a_trace(patch: pytest.MonkeyPatch) -> None:
    """Nothing is traced, nor drawn on a page that is not read."""
    patch.setattr(style, "to_svg", lambda *_, **__: "<svg></svg>")
    patch.setattr(calibrating, "open_light", lambda *_, **__: None)
    patch.setattr(calibrating, "reading_table", lambda *_: made_sensor.table())


def _changed(text: str, column: str, change: Change) -> str:
    """A recording whose cells of one column are changed by their text and number."""
    head, *rows = text.splitlines()
    at, out = head.split(",").index(column), [head]
    for number, row in enumerate(rows):
        cells = row.split(",")
        cells[at] = change(cells[at], number)
        out.append(",".join(cells))
    return "\n".join(out) + "\n"


def _column(name: str, change: Change) -> Callable[[str], str]:
    return lambda text: _changed(text, name, change)


def _refused(capsys: pytest.CaptureFixture[str], arguments: list[str], *, written: Path) -> str:
    """The one line in which a command refuses its input; it must write nothing."""
    capsys.readouterr()
    assert run(arguments) == 2
    out, err = capsys.readouterr()
    assert out == "" and not written.exists()
    assert len(err.splitlines()) == 1
    return err


EITHER = [
    (lambda text: "", "is empty"),
    (lambda text: text.splitlines()[0] + "\n", "has 0 samples; two or more are needed"),
    (lambda text: text.replace(",", ";"), "has semicolons between columns"),
    (lambda text: text.replace("time_s", "seconds"), "no column time_s"),
    (lambda text: text.replace(FIRST, "other"), f"has no column '{FIRST}'; this board's readings are"),
    (lambda text: text.replace(FIRST, "site", 1), "column 'site' is there twice"),
    (
        lambda text: text.replace("\n", ",21\n").replace(",21\n", ",room\n", 1),
        "column 'room' is not a reading of this board",
    ),
    (lambda text: text.replace("\n0.02,", "\n0,02,"), "write numbers with a decimal point"),
    (_column(FIRST, lambda cell, k: "0.5"), "is constant at 0.5 V; check its wiring"),
    (_column(FIRST, lambda cell, k: ""), "is empty; record it"),
    (_column(FIRST, lambda cell, k: f"-{cell}"), "is mostly below 0 V; change its sign"),
    (_column(FIRST, lambda cell, k: "4.9999" if k % 2 else "5"), "is saturated"),
    (_column(FIRST, lambda cell, k: "nan" if k == 7 else cell), f"line 9: {FIRST} = 'nan' is not a finite number"),
    (_column(FIRST, lambda cell, k: "-inf" if k == 7 else cell), f"line 9: {FIRST} = '-inf' is not a finite number"),
    (_column(FIRST, lambda cell, k: str(int(13107 * float(cell)))), "looks like millivolts or a converter's counts"),
    (_column(FIRST, lambda cell, k: str(1e3 * float(cell))), "looks like millivolts or a converter's counts"),
    (_column("time_s", lambda cell, k: "0.1" if k == 9 else cell), "line 11: time_s = 0.1 does not come after"),
    (
        _column("time_s", lambda cell, k: str(20 * k)),
        "in steps of 20 (0.05 Hz); record at 12.5 to 100000 Hz, with times in seconds",
    ),
    (_column("force_n", lambda cell, k: "-0.1" if k == 9 else cell), "line 11: force_n = -0.1 must lie in 0 to 30 N"),
    (
        _column("force_n", lambda cell, k: "250" if k == 9 else cell),
        "force_n = 250 must lie in 0 to 30 N; give it in newtons",
    ),
    # A load cell in grams, whose noise lies below 0, too.
    (_column("force_n", lambda cell, k: str(102 * float(cell) - 0.3)), "must lie in 0 to 30 N; give it in newtons"),
    (_column("site", lambda cell, k: "thumb" if k == 9 else cell), "line 11: site = 'thumb' is unknown; choose from"),
]


@pytest.mark.parametrize(("change", "message"), EITHER, ids=[message[:30] for _, message in EITHER])
def test_what_is_no_recording_is_refused_by_both(
    folder: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path, change: Callable[[str], str], message: str
) -> None:
    (tmp_path / "bad.csv").write_text(change((folder / "proximal.csv").read_text()))
    bad, made = str(tmp_path / "bad.csv"), tmp_path / "made"
    assert message in _refused(capsys, ["predict", str(folder / "me.toml"), bad, "-o", str(made)], written=made)
    subject = tmp_path / "new.toml"
    requested = ["calibrate", "prototype", bad, "-o", str(subject)]
    with pytest.MonkeyPatch.context() as patch:
        _without_a_trace(patch)
        assert message in _refused(capsys, requested, written=subject)


CALIBRATING = [
    (lambda text: text.replace("force_n", "proximal_pressure_pa"), "has no column force_n"),
    (_column("force_n", lambda cell, k: "" if k == 7 else cell), "line 9: force_n is empty"),
    # What predict wrote: it has no volts, and its force no rest.
    (
        lambda text: "time_s,force_n,force_low_n\n" + "".join(f"{0.02 * k},0.5,0.4\n" for k in range(400)),
        f"has no column '{FIRST}'; this board's readings are",
    ),
    (_column("force_n", lambda cell, k: "0"), "constant at 0 N; press the finger"),
    # A rest alone, in which a quiet reading does not change.
    (
        lambda text: _column(FIRST, lambda cell, k: "2.00333")(_column("force_n", lambda cell, k: "0.01")(text)),
        "force_n is constant at 0.01 N; press the finger",
    ),
    (_column("force_n", lambda cell, k: str(1e-3 * float(cell))), "force_n reaches 0.0015 N; press up to 1 N"),
    (_column("force_n", lambda cell, k: str(15 * float(cell))), "reaches 22.5 N; press up to 1 N or more, 20 N"),
    (
        _column("force_n", lambda cell, k: str(60 * float(cell))),
        "must lie in 0 to 30 N; give it in newtons: divide millinewtons by 1000, grams-force by 102.",
    ),
    (_column("force_n", lambda cell, k: str(0.2 + float(cell))), "rests (force_n below 0.05 N) for 0 s before the"),
    (
        _column("force_n", lambda cell, k: "0.3" if k == 20 else cell),
        "for 0.4 s before the first touch; begin with 6 s",
    ),
    (_column("time_s", lambda cell, k: str(2.0 * float(cell))), "recorded at 25 and 50 Hz; record all"),
    (
        _column("time_s", lambda cell, k: str(float(cell) + 0.02 * max(0, k - 300))),
        "recorded at 25 and 50 Hz; record all",
    ),
    (_column("site", lambda cell, k: "distal"), "record both sides, as `nailoptics protocol` has them"),
    # Both sides at once do not identify either, nor does the default scene where the column is missing.
    (_column("site", lambda cell, k: "even"), "record both sides, as `nailoptics protocol` has them"),
    (
        lambda text: text.replace(",site,", ",", 1).replace(",proximal,", ","),
        "no proximal touch was recorded by the column site (without one, by the scene's touch)",
    ),
    (lambda text: text, "2 touches were recorded; record 8 or more"),
    (_column("time_s", lambda cell, k: str(2.0 * k)), "time_s rises in steps of 2 (0.5 Hz); record at 12.5"),
    (_column("time_s", lambda cell, k: str(float(cell) + 3600.0 * (k > 200))), "nothing was recorded for 3.6e+03 s"),
    (_column("time_s", lambda cell, k: str(float(cell) + 50.0 * (k > 200))), "record at an even rate"),
    (_column(FIRST, lambda cell, k: cell if k % 100 == 0 else ""), "has 4 of 400 samples, 2 of them without a touch"),
]


@pytest.mark.parametrize(("change", "message"), CALIBRATING, ids=[message[:30] for _, message in CALIBRATING])
def test_what_cannot_calibrate_is_refused(
    folder: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path, change: Callable[[str], str], message: str
) -> None:
    (tmp_path / "bad.csv").write_text(change((folder / "proximal.csv").read_text()))
    subject = tmp_path / "new.toml"
    with pytest.MonkeyPatch.context() as patch:
        _without_a_trace(patch)
        requested = [
            "calibrate",
            "prototype",
            str(folder / "distal.csv"),
            str(tmp_path / "bad.csv"),
            "-o",
            str(subject),
        ]
        assert message in _refused(capsys, requested, written=subject)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["predict", "touch.csv", "touch.csv"], "is a recording, which calibrate and predict take last"),
        (["predict", "none.toml", "touch.csv"], "cannot be read"),
        (["predict", "me.toml", "none.csv"], "cannot be read"),
        (["predict", "me.toml", "touch.csv", "--press", "0.2"], "--release = 0.3 N must lie above 0 and below --press"),
        (["predict", "me.toml", "touch.csv", "--press", "inf"], "below --press = inf N"),
        (["predict", "me.toml", "touch.csv", "--release", "nan"], "--release = nan N"),
        (["predict", "me.toml", "--jsn"], "Unknown option: --jsn"),
        (["predict", "me.toml", "-", "--json"], "leave out --json and -o"),
        (["calibrate", "phantom", "proximal.csv"], "a phantom has no board"),
        (["calibrate", "pulse_oximeter", "proximal.csv"], "has no column 'red:"),
        (["calibrate", "prototype"], "needs RECORDINGS"),
    ],
)
def test_wrong_requests_are_refused(
    folder: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path, arguments: list[str], message: str
) -> None:
    files = ("touch.csv", "proximal.csv", "me.toml", "none.csv", "none.toml")
    named = [str(folder / one) if one in files else one for one in arguments]
    made = tmp_path / "made.toml"
    if "--json" not in named:
        named += ["-o", str(made)]
    assert message in _refused(capsys, named, written=made)


def test_a_saturated_part_counts_as_a_gap_and_is_reported(
    folder: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    text = (folder / "touch.csv").read_text()
    (tmp_path / "part.csv").write_text(_changed(text, FIRST, lambda cell, k: "5" if 100 <= k < 150 else cell))
    assert run(["predict", str(folder / "me.toml"), str(tmp_path / "part.csv"), "-o", str(tmp_path / "out")]) == 0
    err = capsys.readouterr().err
    assert f"{FIRST} is saturated in 50 of 200 samples, which count as gaps." in err
    assert "do not fit" not in err
    assert f"{FIRST} is saturated" in (tmp_path / "out" / "predict.html").read_text()


@pytest.mark.long
def test_readings_that_are_there_every_other_sample_calibrate(folder: Path, tmp_path: Path) -> None:
    """LEDs that are lit in turn leave every other cell empty, and no sample whole."""
    text = (folder / "least.csv").read_text()
    for number, name in enumerate(made_sensor.table().names):
        text = _changed(text, name, lambda cell, k, number=number: cell if (k + number) % 2 else "")  # type: ignore[misc]
    (tmp_path / "turns.csv").write_text(text)
    _calibrated(tmp_path / "turns.csv", tmp_path / "me.toml")
    whole, turns = (parse_subject((at / "me.toml").read_text()) for at in (folder, tmp_path))
    assert np.allclose(turns.readings.noise_v, whole.readings.noise_v, rtol=0.5)


QUICK = settings(
    max_examples=60,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
CELLS = st.sampled_from(
    [
        "",
        "nan",
        "inf",
        "-1",
        "0",
        "1e300",
        "-1e300",
        "1e-300",
        "x",
        '"',
        "#",
        "5",
        "even",
        "0,5",
        "\ufeff",
        "\x00",
        "１",
    ]
)


@pytest.mark.long
@QUICK
@given(changes=st.lists(st.tuples(st.integers(0, 12), st.integers(0, 12), CELLS), min_size=1, max_size=4))
def test_any_recording_is_read_or_refused(folder: Path, changes: list[tuple[int, int, str]]) -> None:
    rows = [line.split(",") for line in (folder / "touch.csv").read_text().splitlines()[90:102]]
    rows.insert(0, (folder / "touch.csv").read_text().splitlines()[0].split(","))
    for row, column, cell in changes:
        rows[row % len(rows)][column % len(rows[0])] = cell
    file = folder / "fuzz.csv"
    file.write_text("\n".join(map(",".join, rows)) + "\n", encoding="utf-8")
    try:
        estimated = predict(folder / "me.toml", file)
    except InputError as error:
        assert len(str(error).splitlines()) == 1
    else:
        assert np.isfinite(estimated.force_n).all()


VALUES = st.sampled_from([None, 0, -1, 1e300, 1e-300, float("nan"), float("inf"), "x", [], {}, True, [1.0, 2.0], -0.5])


@pytest.mark.long
@QUICK
@given(choice=st.integers(0, 10**6), value=VALUES)
def test_any_subject_is_read_or_refused(folder: Path, choice: int, value: object) -> None:
    result = copy.deepcopy(_read(folder / "me.toml"))
    places = list(_places(result))
    tables, key = places[choice % len(places)]
    if value is None:
        del tables[key]
    else:
        tables[key] = value
    try:
        subject = parse_subject(tomli_w.dumps(result))
        estimated = predict(subject, folder / "short.csv")
    except InputError as error:
        assert len(str(error).splitlines()) == 1
    else:
        assert np.isfinite(estimated.force_n).all()


@pytest.mark.parametrize("projection", [0.0, [1.0, 2.0], [[1e300, 0.0], [0.0, 1.0]]])
def test_a_comparison_of_another_shape_or_beyond_numbers_is_refused(projection: object) -> None:
    terms = {"shift": [0.0, 0.0], "coefficients_n": [0.0] * 9}
    with pytest.raises(ValueError, match="has shape|must lie within"):
        TypeAdapter(Baseline).validate_python({"shape": "cubic", "projection": projection} | terms)


@pytest.mark.parametrize("value", [1e300, -1e300])
def test_numbers_beyond_what_their_cubes_can_hold_are_refused(folder: Path, value: float) -> None:
    for change in ("intercept_n", "polynomial_n", "components", "centres"):
        tables = copy.deepcopy(_read(folder / "me.toml"))
        tables["ensemble"][change] = np.full_like(tables["ensemble"][change], value).tolist()  # type: ignore[index]
        with pytest.raises(InputError, match="must lie within"):
            parse_subject(tomli_w.dumps(tables))
    tables = copy.deepcopy(_read(folder / "me.toml"))
    tables["comparisons"]["cubic"]["intercept_n"] = value  # type: ignore[index]
    with pytest.raises(InputError, match="intercept_n"):
        parse_subject(tomli_w.dumps(tables))


@cache
def _read(file: Path) -> dict[str, object]:
    tables = tomllib.loads(file.read_text())
    # Of a file with it any change is refused.
    del tables["digest"]
    return tables


def _places(tables):  # type: ignore[no-untyped-def]
    """Every table and list with each of its keys, of long lists the first three."""
    keys = list(tables) if isinstance(tables, dict) else range(min(3, len(tables)))
    for key in keys:
        yield tables, key
        if isinstance(tables[key], dict | list):
            yield from _places(tables[key])


@pytest.fixture(autouse=True, scope="module")
def _short(folder: Path) -> None:
    text = (folder / "touch.csv").read_text().splitlines()
    (folder / "short.csv").write_text("\n".join([text[0], *text[95:101]]) + "\n")

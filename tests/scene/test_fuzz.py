"""Whatever a file holds, reading it ends with what was read or with one line that states what is wrong."""

import os
import tomllib
from datetime import date
from pathlib import Path

import pytest
import tomli_w
from hypothesis import HealthCheck, given, settings, strategies as st

from nailoptics.assets import data_dir
from nailoptics.errors import InputError
from nailoptics.scene import load_scene
from nailoptics.scene.catalogue import load_part
from nailoptics.scene.importers.board_files import read_outline
from nailoptics.scene.importers.kicad import read_board
from nailoptics.scene.importers.positions import COLUMNS, read_positions
from nailoptics.scene.importers.sensor_recordings import with_recording
from nailoptics.scene.sweep import load_sweep

fuzz = settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
PROTOTYPE = tomllib.loads((data_dir("scenes") / "prototype.toml").read_text())


def read_touch(path):
    return with_recording({"file": str(path)}, None, "touch", ("force_n",), either=(("force_n",),))


def few_lines_or_nothing(read, *arguments) -> str:
    """What the user reads, having checked that it is nothing but a few lines of bounded length, each of its own."""
    try:
        read(*arguments)
    except InputError as error:
        lines = str(error).splitlines()
        assert error.exit_code == 2 and 1 <= len(lines) <= 11 and len(set(lines)) == len(lines), lines
        assert lines == list(error.args) and max(map(len, lines)) < 2000, lines
        return "\n".join(lines)
    return ""


numbers = st.one_of(
    st.floats(), st.integers(-(2**63), 2**63 - 1), st.sampled_from([0, -1, 1e308, 5e-324, 10**300, 1e9])
)
texts = st.one_of(
    st.text(st.characters(exclude_categories=["Cs"]), max_size=12),
    st.sampled_from(["", "x" * 5000, "../../etc/passwd", "a\0b", "led_800", "prototype", "=1+1", "inf", "nan"]),
)
leaves = st.one_of(numbers, texts, st.booleans(), st.dates(date(1, 1, 1)))
values = st.recursive(
    leaves, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(texts, inner, max_size=3), max_leaves=8
)


def places(tables, path=()):
    """Where a table or array holds something."""
    items = tables.items() if isinstance(tables, dict) else enumerate(tables)
    for key, item in items:
        yield (*path, key)
        if isinstance(item, dict | list):
            yield from places(item, (*path, key))


def changed(tables, path, value):
    """A copy with a value at a place."""
    copy = dict(tables) if isinstance(tables, dict) else list(tables)
    key, *rest = path
    copy[key] = changed(copy[key], rest, value) if rest else value
    return copy


def toml(tables) -> bytes:
    try:
        return tomli_w.dumps(tables).encode()
    except (TypeError, ValueError):  # what TOML cannot express
        return b"schema_version = 1"


@fuzz
@given(st.data())
def test_a_scene_with_anything_anywhere(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("fuzz") / "scene.toml"
    tables = PROTOTYPE
    for _ in range(data.draw(st.integers(1, 3))):
        tables = changed(tables, data.draw(st.sampled_from(sorted(places(tables), key=str))), data.draw(values))
    extra = data.draw(
        st.dictionaries(st.sampled_from(["placement", "touch", "body", "priors", "phantom", "blood"]), values)
    )
    path.write_bytes(toml(tables | extra))
    few_lines_or_nothing(load_scene, path)


AXIS = st.dictionaries(
    st.sampled_from(["path", "name", "values", "linspace", "logspace", "range"]),
    st.one_of(
        values,
        st.sampled_from(["blood.so2", "leds[0].flux_mw", "leds[7]", "leds.ir.part", "finger", "a..b", "touch.file"]),
        st.lists(numbers, min_size=2, max_size=3),
        st.tuples(numbers, numbers, st.integers(1, 4)).map(list),
    ),
)


@fuzz
@given(
    st.dictionaries(st.sampled_from(["base", "scenes", "combine", "samples", "seed", "schema_version"]), values),
    st.lists(AXIS, max_size=3),
    st.booleans(),
)
def test_a_sweep_of_anything(tmp_path_factory, tables, axes, usual):
    path = tmp_path_factory.mktemp("fuzz") / "sweep.toml"
    samples = tables.get("samples")
    if isinstance(samples, int) and samples > 4:  # a million scenes take minutes, rightly
        tables["samples"] = 4
    path.write_bytes(toml(({"schema_version": 1, "base": "prototype"} if usual else {}) | tables | {"axes": axes}))
    few_lines_or_nothing(load_sweep, path)


@fuzz
@given(st.dictionaries(texts | st.sampled_from(["kind", "peak_nm", "elements", "pattern", "pitch_mm"]), values))
def test_a_part_of_anything(tmp_path_factory, tables):
    folder = tmp_path_factory.mktemp("fuzz")
    (folder / "mine.toml").write_bytes(toml(tables))
    few_lines_or_nothing(load_part, "mine", folder)


@fuzz
@given(texts)
def test_a_part_of_any_name(tmp_path_factory, name):
    few_lines_or_nothing(load_part, name, tmp_path_factory.mktemp("fuzz"))


cells = st.one_of(st.floats().map(str), texts, st.sampled_from(["0", "1", "90", "top", "bottom", "PD1", "D1"]))
rows = st.lists(st.lists(cells, max_size=8).map(",".join), max_size=6).map("\n".join)


@fuzz
@given(st.sampled_from(["", ",".join(COLUMNS) + "\n"]), rows)
def test_positions_of_anything(tmp_path_factory, head, body):
    path = tmp_path_factory.mktemp("fuzz") / "positions.csv"
    path.write_text(head + body, encoding="utf-8")
    few_lines_or_nothing(read_positions, path)


@fuzz
@given(st.sampled_from(["", "x_mm,y_mm\n"]), rows)
def test_an_outline_of_anything(tmp_path_factory, head, body):
    path = tmp_path_factory.mktemp("fuzz") / "outline.csv"
    path.write_text(head + body, encoding="utf-8")
    few_lines_or_nothing(read_outline, path)


@fuzz
@given(st.sampled_from(["", "time_s,force_n\n", "time_s,proximal_pressure_pa,distal_pressure_pa\n"]), rows)
def test_a_recorded_touch_of_anything(tmp_path_factory, head, body):
    path = tmp_path_factory.mktemp("fuzz") / "touch.csv"
    path.write_text(head + body, encoding="utf-8")
    few_lines_or_nothing(read_touch, path)


groups = st.tuples(
    st.sampled_from(["0", "10", "20", "11", "21", "40", "42", "50", "51", "70", "8"]) | texts,
    st.sampled_from(["LINE", "ARC", "CIRCLE", "LWPOLYLINE", "0", "1", "-1", "1e300", "nan"]) | texts,
)


@fuzz
@given(st.lists(groups, max_size=30), st.booleans())
def test_a_dxf_of_anything(tmp_path_factory, drawn, inside):
    path = tmp_path_factory.mktemp("fuzz") / "outline.dxf"
    body = [("0", "SECTION"), ("2", "ENTITIES")] * inside + drawn
    path.write_text("".join(f"{code}\n{value}\n" for code, value in body), encoding="utf-8")
    few_lines_or_nothing(read_outline, path)


@fuzz
@given(st.binary(max_size=200))
def test_bytes_of_no_supported_format(tmp_path_factory, data):
    folder = tmp_path_factory.mktemp("fuzz")
    for name, read in (
        ("a.toml", load_scene),
        ("b.toml", load_sweep),
        ("c.kicad_pcb", read_outline),
        ("c.dxf", read_outline),
        ("d.csv", read_touch),
    ):
        (folder / name).write_bytes(data)
        few_lines_or_nothing(read, folder / name)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a = " + "9" * 5000, "not valid TOML: a number has thousands of digits"),
        ("a = 0x" + "f" * 9000, "thousands of digits"),
        ("a = " + "[" * 9000 + "]" * 9000, "nested too deep"),
        ('schema_version = 1\n[finger]\n[[leds]]\nname = "ir"\npart = "' + "x" * 5000 + '"', "is unknown"),
    ],
    ids=["digits", "hexadecimal", "deep", "name"],
)
def test_toml_beyond_all_bounds_is_refused(tmp_path, text, words):
    (tmp_path / "s.toml").write_text(text)
    assert words in few_lines_or_nothing(load_scene, tmp_path / "s.toml")


def test_invalid_names_are_refused(tmp_path):
    sweep = 'schema_version = 1\nbase = "prototype"\n[[axes]]\npath = "leds.x.flux_mw"\nvalues = [1.0]\n'
    base = tomllib.loads(sweep) | {"base": PROTOTYPE | {"leds": [{"name": ["a", "list"]}, {"name": "ir"}]}}
    (tmp_path / "s.toml").write_bytes(toml(base))
    assert "there is no item x here; known: 0 to 1, ir" in few_lines_or_nothing(load_sweep, tmp_path / "s.toml")
    (tmp_path / "t.toml").write_text(sweep.replace("prototype", "x" * 5000))
    assert "cannot be read" in few_lines_or_nothing(load_sweep, tmp_path / "t.toml")


def test_a_cell_over_128_kb_is_refused(tmp_path):
    (tmp_path / "t.csv").write_text("time_s,force_n\n0," + "1" * 140_000 + "\n")
    for read in (read_touch, read_outline, read_positions):
        assert few_lines_or_nothing(read, tmp_path / "t.csv")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names here")
@pytest.mark.parametrize("name", ["outline.kicad_pcb", "outline.dxf", "outline.csv"])
def test_a_pipe_is_refused_without_waiting(tmp_path, name):
    os.mkfifo(tmp_path / name)
    assert "not an ordinary file" in few_lines_or_nothing(read_outline, tmp_path / name)
    assert "not an ordinary file" in few_lines_or_nothing(load_scene, tmp_path / name)


def test_a_file_beyond_all_bounds_is_not_read(tmp_path):
    with open(tmp_path / "s.toml", "wb") as file:
        file.truncate(600_000_000)
    assert "600 MB" in few_lines_or_nothing(load_scene, tmp_path / "s.toml")


def test_no_message_quotes_a_file_of_another_kind(tmp_path):
    (tmp_path / "secret").write_text("root:x:0:0:hidden\n")
    scene = 'schema_version = 1\n[finger]\n[touch]\nprofile = "recorded"\nfile = "secret"\n'
    (tmp_path / "s.toml").write_text(scene)
    assert "hidden" not in few_lines_or_nothing(load_scene, Path(tmp_path / "s.toml"))


atoms = st.one_of(
    st.sampled_from(
        ["0", "1", "1e300", "-1", "nan", '"D1"', '"Edge.Cuts"', "at", "layer", "start", "end", "mid", "pts"]
    ),
    texts.map(lambda text: '"' + text.replace('"', "") + '"'),
)
trees = st.recursive(
    atoms, lambda inner: st.lists(inner, max_size=4).map(lambda parts: f"({' '.join(parts)})"), max_leaves=15
)
heads = st.sampled_from(
    ["footprint", "gr_line", "gr_arc", "gr_circle", "gr_rect", "gr_poly", "gr_curve", "property", "at"]
)


@fuzz
@given(st.lists(st.tuples(heads, st.lists(trees, max_size=5)), max_size=5), st.sampled_from(["", ")", "(", '"']))
def test_a_board_of_anything(tmp_path_factory, items, more):
    path = tmp_path_factory.mktemp("fuzz") / "board.kicad_pcb"
    body = "\n".join(f"({head} {' '.join(parts)})" for head, parts in items)
    path.write_text(f"(kicad_pcb (version 20240108)\n{body}){more}", encoding="utf-8")
    few_lines_or_nothing(read_board, path)


@pytest.mark.parametrize("text", ["", "(", "(" * 5000 + ")" * 5000, "(kicad_pcb " + "(a " * 900 + ")" * 901, "\0"])
def test_a_board_beyond_all_bounds_is_refused(tmp_path, text):
    (tmp_path / "b.kicad_pcb").write_text(text)
    few_lines_or_nothing(read_board, tmp_path / "b.kicad_pcb")

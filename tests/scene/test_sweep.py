"""Sweep files become scenes in order, every mistake in one is reported in one line, and editors have their schema."""

import itertools
import tomllib

import jsonschema
import numpy as np
import pytest
from small_scenes import ON_KICAD_BOARD

from nailoptics.assets import data_dir
from nailoptics.errors import InputError
from nailoptics.scene.sweep import load_sweep, sweep_json_schema

BASE = 'schema_version = 1\nbase = "prototype"\n'


def sweep(tmp_path, text):
    (tmp_path / "s.toml").write_text(text)
    return load_sweep(tmp_path / "s.toml")


def test_a_product_has_every_pair_and_its_last_axis_varies_fastest(tmp_path):
    result = sweep(
        tmp_path,
        BASE
        + '[[axes]]\npath = "blood.so2"\nlinspace = [0.8, 0.9, 3]\n'
        + '[[axes]]\npath = "leds.ir.position_mm"\nvalues = [[-1.2, -1.0], [-1.2, 1.0]]\n',
    )
    assert result.dims == {"so2": 3, "position_mm": 2}
    expected = list(itertools.product([0.8, 0.85, 0.9], [(-1.2, -1.0), (-1.2, 1.0)]))
    assert [(s.blood.so2, s.leds[0].position_mm) for s in result.scenes] == [
        (pytest.approx(so2), place) for so2, place in expected
    ]


def test_parts_of_a_boards_file_are_varied_as_those_of_a_scene(tmp_path):
    (tmp_path / "x.kicad_pcb").write_text("""(kicad_pcb (version 20240108) (setup (aux_axis_origin 100 100))
      (footprint "LED" (layer "B.Cu") (at 97 99) (property "Reference" "D1"))
      (footprint "PD" (layer "B.Cu") (at 101 101) (property "Reference" "PD1"))
      (gr_rect (start 95.5 95.5) (end 104.5 104.5) (layer "Edge.Cuts")))""")
    (tmp_path / "mine.toml").write_text(ON_KICAD_BOARD.format(board="", diode="", parts=""))
    places = [(-3.0, 1.0), (-3.0, -1.0)]
    axes = '[[axes]]\npath = "leds.D1.position_mm"\nvalues = [[-3.0, 1.0], [-3.0, -1.0]]\n'
    axes += '[[axes]]\npath = "finger.digit"\nvalues = ["thumb", "index"]\n'
    result = sweep(tmp_path, f'schema_version = 1\nbase = "mine.toml"\n{axes}')
    assert [scene.leds[0].position_mm for scene in result.scenes] == [place for place in places for _ in range(2)]
    assert result.scenes[0].finger.nail_width_mm > result.scenes[1].finger.nail_width_mm
    turned = axes.replace('"finger.digit"\nvalues = ["thumb", "index"]', '"board.turn_deg"\nvalues = [0.0, 5.0]')
    with pytest.raises(InputError, match="the file of the board has been read"):
        sweep(tmp_path, f'schema_version = 1\nbase = "mine.toml"\n{turned}')


def test_a_zip_walks_all_axes_together(tmp_path):
    result = sweep(
        tmp_path,
        BASE
        + 'combine = "zip"\n[[axes]]\npath = "touch.force_n"\nvalues = [0.5, 1.0]\n'
        + '[[axes]]\npath = "leds[0].flux_mw"\nlogspace = [0.1, 10.0, 2]\n',
    )
    assert result.dims == {"sample": 2}
    assert [(s.touch.force_n, s.leds[0].flux_mw) for s in result.scenes] == [(0.5, 0.1), (1.0, pytest.approx(10.0))]


def test_a_latin_hypercube_has_one_sample_in_every_stratum(tmp_path):
    text = (
        'combine = "latin_hypercube"\nsamples = 20\nseed = {}\n'
        '[[axes]]\npath = "blood.so2"\nrange = [0.5, 1.0]\n'
        '[[axes]]\npath = "finger.digit"\nvalues = ["index", "little"]\n'
    )
    one, two, other = (sweep(tmp_path, BASE + text.format(seed)) for seed in (3, 3, 4))
    so2 = np.array([s.blood.so2 for s in one.scenes])
    assert sorted(np.floor((so2 - 0.5) / 0.5 * 20)) == list(range(20))
    assert [s.finger.digit for s in one.scenes].count("index") == 10
    assert one.scenes == two.scenes != other.scenes


def test_what_is_not_given_follows_what_is_swept(tmp_path):
    """A digit sets the sizes of the finger, a part those of the LED: the axis counts as if it were in the file."""
    result = sweep(tmp_path, BASE + '[[axes]]\npath = "finger.digit"\nvalues = ["index", "little"]\n')
    assert [s.finger.width_mm for s in result.scenes] == [17.5, 14.5]


def test_scenes_can_be_listed_and_swept_together(tmp_path):
    text = (data_dir("scenes") / "prototype.toml").read_text()
    for name in ("a", "b"):
        (tmp_path / f"{name}.toml").write_text(text.replace("so2 = 0.97", f"so2 = 0.{9 if name == 'a' else 8}"))
    listed = sweep(tmp_path, 'schema_version = 1\nscenes = ["a.toml", "b.toml"]\n')
    assert listed.dims == {"scene": 2} and [s.blood.so2 for s in listed.scenes] == [0.9, 0.8]
    both = sweep(
        tmp_path,
        'schema_version = 1\nscenes = ["a.toml", "b.toml"]\n[[axes]]\npath = "touch.force_n"\nvalues = [1.0, 2.0]\n',
    )
    assert both.dims == {"scene": 2, "force_n": 2} and len(both.scenes) == 4


SWEEPS = sorted((data_dir("scenes") / "sweeps").glob("*.toml"))


@pytest.mark.parametrize("path", SWEEPS, ids=lambda p: p.stem)
def test_the_shipped_sweeps_load(path):
    assert len(load_sweep(path).scenes) >= 20


@pytest.mark.parametrize("path", SWEEPS, ids=lambda p: p.stem)
def test_shipped_sweeps_name_and_meet_the_schema(path):
    text = path.read_text(encoding="utf-8")
    assert text.splitlines()[0] == "#:schema ../sweep.schema.json"
    validator = jsonschema.Draft202012Validator(sweep_json_schema())
    validator.check_schema(sweep_json_schema())
    data = tomllib.loads(text)
    assert [error.message for error in validator.iter_errors(data)] == []
    data["combine"] = "both"
    data["axes"][0]["colour"] = "red"
    del data["axes"][0]["path"]
    assert len(list(validator.iter_errors(data))) == 3


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "schema_version"),
        ("schema_version = 1", "either base"),
        ('schema_version = 1\nbase = 3\n[[axes]]\npath = "blood.so2"\nvalues = [0.5]', "base = 3"),
        (BASE, "at least one [[axes]]"),
        (BASE + "axis = 3", "axis is not a known field"),
        (BASE + "[[axes]]\nvalues = [1]", "axes[0].path is missing"),
        (BASE + '[[axes]]\npath = "blood..so2"\nvalues = [1]', "is not a field"),
        (BASE + '[[axes]]\npath = "blood.so2"', "exactly one of"),
        (BASE + '[[axes]]\npath = "blood.so2"\nvalues = []', "axes[0].values = []: must have at least 1 item"),
        (BASE + '[[axes]]\npath = "blood.so2"\nvalues = [1.5]', "blood.so2 = 1.5"),
        (BASE + '[[axes]]\npath = "blod.so2"\nvalues = [0.5]', 'did you mean "blood"'),
        (BASE + '[[axes]]\npath = "leds.red.flux_mw"\nvalues = [0.5]', "no item red"),
        (BASE + '[[axes]]\npath = "leds[4].flux_mw"\nvalues = [0.5]', "no item 4"),
        (BASE + '[[axes]]\npath = "blood.so2.deep"\nvalues = [0.5]', "goes on at"),
        (BASE + '[[axes]]\npath = "blood.so2"\nlinspace = [0.5, 1]', "axes[0].linspace[2] is missing"),
        (BASE + '[[axes]]\npath = "blood.so2"\nlogspace = [0, 1, 3]', "above 0"),
        (BASE + '[[axes]]\npath = "blood.so2"\nrange = [0, 1]', "Latin hypercube"),
        (BASE + 'combine = "latin_hypercube"\n[[axes]]\npath = "blood.so2"\nrange = [0, 1]', "samples"),
        (BASE + 'combine = "both"\n[[axes]]\npath = "blood.so2"\nvalues = [1.0]', "combine"),
        (BASE + "samples = 3\n" + '[[axes]]\npath = "blood.so2"\nvalues = [1.0]', "latin_hypercube"),
        (BASE + '[[axes]]\npath = "touch.force_n"\nname = "led"\nvalues = [1.0]', "taken"),
        (BASE + '[[axes]]\npath = "blood.so2"\nlinspace = [0, 1, 2000000]', "axes[0].linspace[2] = 2000000"),
        (
            BASE
            + 'combine = "zip"\n[[axes]]\npath = "blood.so2"\nvalues = [1.0]\n'
            + '[[axes]]\npath = "touch.force_n"\nvalues = [1.0, 2.0]',
            "as many of each",
        ),
        ('schema_version = 1\nscenes = ["none.toml"]', "cannot be read"),
        ("schema_version = 1\nscenes = []", "scenes = []: must have at least 1 item"),
        ("no toml", "not valid TOML"),
    ],
)
def test_a_mistake_is_one_line_that_names_file_and_field(tmp_path, text, words):
    with pytest.raises(InputError) as caught:
        sweep(tmp_path, text)
    message = str(caught.value)
    assert words in message and "\n" not in message and ".toml" in message

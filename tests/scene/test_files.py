"""Scenes to TOML and back, their digest, their parts, and the schema that editors use."""

import math
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import jsonschema
import pytest
from small_scenes import finger

import nailoptics
from nailoptics.assets import data_dir
from nailoptics.cli import run
from nailoptics.errors import InputError
from nailoptics.scene import Scene, digest, json_schema, load_scene, parse_scene, to_toml

SHIPPED = sorted(data_dir("scenes").rglob("*.toml"))
# A sweep holds scenes in place of being one.
SCENES = [path for path in SHIPPED if "sweeps" not in path.parts]
ROW = {"array": "row", "position_mm": [0.0, 0.0], "wired": [0, 2]}
FINGER = finger(ROW, leds=({"part": "mine"},), touch={"profile": "recorded", "file": "touch.csv"})
PHANTOM = """
schema_version = 1
[phantom]
n_above = 1.4
[[phantom.layers]]
name = "upper"
thickness_mm = 0.5
mu_a_per_mm = 0.02
mu_s_per_mm = 5
g = 0.9
[[phantom.layers]]
name = "lower"
thickness_mm = inf
mu_a_per_mm = 0.1
mu_s_per_mm = 1e1
[[leds]]
name = "beam"
wavelength_nm = 800
pattern = "pencil"
"""


@pytest.fixture
def folder(tmp_path):
    """A user's own parts and recording."""
    (tmp_path / "mine.toml").write_text(
        'kind = "led"\npeak_nm = 850.0\nfwhm_nm = 30\nflux_mw = 3\npattern = [[0, 1.0], [60, 0.5], [90, 0]]\n'
    )
    (tmp_path / "row.toml").write_text(
        'kind = "photodiode_array"\nelements = 3\nelement_size_mm = [1.0, 0.5]\npitch_mm = 0.6\n'
        "quantum_efficiency = 0.8\ndark_current_na = 0.2\nshunt_ohm = 1e8\n"
    )
    (tmp_path / "touch.csv").write_text("time_s,force_n\n0,0\n0.5,1\n1,0\n")
    return tmp_path


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.name)
def test_shipped_scenes_survive_a_round_trip_through_toml(path):
    scene = load_scene(path)
    again = parse_scene(to_toml(scene))
    assert again == scene and digest(again) == digest(scene)


def test_a_written_scene_needs_neither_its_parts_nor_its_recording(folder):
    """Rationale: results carry their scene, and are read on machines that lack the user's files.
    Expected: equality without the folder, though a part and a recording came from there."""
    scene = parse_scene(FINGER, folder=folder)
    assert scene.leds[0].wavelength_nm == 850.0 and scene.leds[0].pattern_relative == (1.0, 0.5, 0.0)
    assert scene.photodiodes[0].shunt_mohm == 100.0 and scene.touch.recorded_force_n == (0.0, 1.0, 0.0)
    assert parse_scene(to_toml(scene)) == scene
    with pytest.raises(InputError):
        parse_scene(FINGER)


def test_infinite_thickness_survives_a_round_trip():
    scene = parse_scene(PHANTOM)
    again = parse_scene(to_toml(scene))
    assert again == scene and math.isinf(again.phantom.layers[1].thickness_mm)


def test_fields_of_the_scene_come_before_those_of_its_part(folder):
    text = FINGER.replace('part = "mine"', 'part = "mine"\nflux_mw = 7.0')
    led = parse_scene(text, folder=folder).leds[0]
    assert led.flux_mw == 7.0 and led.fwhm_nm == 30.0


def test_a_pattern_in_the_scene_sets_the_parts_measured_pattern_aside(folder):
    text = FINGER.replace('part = "mine"', 'part = "mine"\npattern = "lambertian"')
    scene = parse_scene(text, folder=folder)
    led = scene.leds[0]
    assert led.pattern == "lambertian" and led.pattern_deg is None and led.pattern_relative is None
    assert led.wavelength_nm == 850.0
    assert parse_scene(to_toml(scene)) == scene


def test_a_users_part_comes_before_a_shipped_one_of_that_name(folder):
    (folder / "mine.toml").rename(folder / "led_800.toml")
    assert parse_scene(FINGER.replace('"mine"', '"led_800"'), folder=folder).leds[0].wavelength_nm == 850.0


def test_the_digest_is_that_of_the_content_not_of_its_writing():
    scene = parse_scene(PHANTOM)
    written_otherwise = PHANTOM.replace("= 5\n", "= 5.0 # a comment\n").replace("1e1", "10.0").replace("800", "800.00")
    assert digest(parse_scene(written_otherwise)) == digest(scene)
    assert len(digest(scene)) == 64


@pytest.mark.parametrize("hash_seed", ["1", "2"])
def test_the_digest_is_the_same_in_every_process(hash_seed):
    code = f"from nailoptics.scene import digest, parse_scene; print(digest(parse_scene({PHANTOM!r})))"
    run = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"PYTHONHASHSEED": hash_seed, "PYTHONPATH": str(Path(nailoptics.__file__).parents[1])},
        capture_output=True,
        text=True,
        check=True,
    )
    assert run.stdout.strip() == digest(parse_scene(PHANTOM))


def test_every_number_of_a_scene_changes_its_digest():
    scene = parse_scene(PHANTOM)
    digests = {digest(scene)}
    layer = scene.phantom.layers[0]
    for name, value in layer.model_dump().items():
        other = layer.model_copy(update={name: value + 1e-9 if isinstance(value, float) else value + "x"})
        phantom = scene.phantom.model_copy(update={"layers": (other, scene.phantom.layers[1])})
        digests.add(digest(scene.model_copy(update={"phantom": phantom})))
    finite = scene.phantom.layers[1].model_copy(update={"thickness_mm": 1e9})
    phantom = scene.phantom.model_copy(update={"layers": (layer, finite)})
    digests.add(digest(scene.model_copy(update={"phantom": phantom})))
    assert len(digests) == 1 + len(layer.model_dump()) + 1


def test_a_byte_order_mark_is_no_obstacle(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(PHANTOM, encoding="utf-8-sig")
    assert load_scene(path) == parse_scene(PHANTOM)


@pytest.mark.parametrize("kind", ["scene", "sweep"])
def test_the_schema_that_is_printed_is_the_shipped_file_to_the_byte(capsys, kind):
    """After adding a field, regenerate the file by the command, and read the difference."""
    assert run(["schema", "--of", kind]) == 0
    assert capsys.readouterr().out == (data_dir("scenes") / f"{kind}.schema.json").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def validator():
    """What scene files are held against; the schema itself is one."""
    schema = json_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.name)
def test_shipped_scenes_name_and_meet_the_schema(path, validator):
    text = path.read_text(encoding="utf-8")
    up = "../" if path.parent.name == "subjects" else "./"
    assert text.splitlines()[0] == f"#:schema {up}scene.schema.json"
    data = tomllib.loads(text)
    assert [error.message for error in validator.iter_errors(data)] == []
    data["hue"] = "red"
    data["leds"][0]["flux_mw"] = -1.0
    data["leds"][0].pop("name")
    assert len(list(validator.iter_errors(data))) == 3


def test_every_dimension_carries_its_unit():
    """Fields that hold a float and are no pure number end in their unit, in name and in description."""
    units = {"mm", "um", "nm", "mm2", "s", "n", "pf", "k", "v", "ohm", "mohm", "hz", "na", "mw", "deg"}
    pure = {"g", "n", "n_above", "n_below"}
    for name, table in json_schema()["$defs"].items():
        for field, rule in table["properties"].items():
            ends = field.split("_")[-1]
            if field not in pure and ends in units:
                assert rule["description"].rstrip().endswith("]"), f"{name}.{field}"


def test_a_scene_that_is_no_scene_cannot_be_built_in_python_either():
    with pytest.raises(InputError, match="leds = ..: must have at least 1 item"):
        Scene(leds=())


@pytest.mark.parametrize("digit", ["thumb", "index", "middle", "ring", "little"])
def test_any_digit_may_take_the_prototypes_board(digit):
    """A finger's length follows its nail, that of the digit or the one that is given."""
    text = (
        (data_dir("scenes") / "prototype.toml")
        .read_text(encoding="utf-8")
        .replace('digit = "index"', f'digit = "{digit}"')
    )
    finger = parse_scene(text).finger
    assert finger.digit == digit and finger.length_mm == finger.nail_length_mm + 4
    longer = parse_scene(text.replace(f'digit = "{digit}"', f'digit = "{digit}"\nnail_length_mm = 14.0'))
    assert longer.finger.length_mm == 18.0

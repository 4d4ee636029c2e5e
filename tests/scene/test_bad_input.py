"""Every bad scene ends in one clear line: which field, which rule, which value, what to do."""

import math
import re
import traceback
from pathlib import Path

import pytest
from small_scenes import finger, phantom

from nailoptics.assets import WAVELENGTH_RANGE_NM
from nailoptics.cli import run
from nailoptics.errors import InputError
from nailoptics.scene import load_scene, parse_scene
from nailoptics.scene.catalogue import LedPart
from nailoptics.tissue import WAVELENGTH_RANGE_NM as TISSUE_RANGE_NM

FINGER = finger({"array": "pd_array_4x1", "position_mm": [0.0, 0.0]})
PHANTOM = phantom({"thickness_mm": math.inf, "mu_a_per_mm": 0.1, "mu_s_per_mm": 1.0})
FINGERLESS = FINGER.replace("[finger]", "")
LAYERS = PHANTOM.split("[phantom]")[1].split("[[leds]]")[0]


def complaint(text: str, folder: Path | None = None, *, faults: int = 1) -> str:
    """What the user reads about a bad scene, having checked that it is nothing but that."""
    with pytest.raises(InputError) as caught:
        parse_scene(text, folder=folder, name="bad.toml")
    error = caught.value
    line = str(error)
    assert error.exit_code == 2
    assert len(line.splitlines()) == faults and line.endswith((".", "?"))
    assert all(one.startswith("bad.toml: ") for one in line.splitlines())
    assert ".. " not in line and not line.endswith("..")
    # No chain: the user's traceback, if any, holds this error alone.
    assert "During handling" not in "".join(traceback.format_exception(error))
    assert "direct cause" not in "".join(traceback.format_exception(error))
    return line


def test_every_mistake_has_its_line(tmp_path, capsys):
    tables = {"finger": 'digit = "toe"\nnail_width_mm = -3', "blood": "so2 = 1.7\nrestblood = 3"}
    path = tmp_path / "bad.toml"
    path.write_text("schema_version = 1\n" + "".join(f"[{name}]\n{text}\n" for name, text in tables.items()))
    assert run(["check", str(path)]) == 2
    lines = capsys.readouterr().err.splitlines()
    fields = (
        "finger.digit = ",
        "finger.nail_width_mm = -3",
        "blood.so2 = 1.7",
        "blood.restblood is not",
        "leds is missing",
    )
    assert [line.startswith(f"nailoptics: {path}: {field}") for line, field in zip(lines, fields, strict=True)] == [
        True
    ] * 5
    path.write_text("schema_version = 1\n" + "".join(f"[a{k}]\n" for k in range(30)))
    assert run(["check", str(path)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 11 and lines[-1].endswith(" more; correct these first.")


def in_finger(line: str) -> str:
    return FINGER.replace("[finger]", f"[finger]\n{line}")


def in_led(line: str) -> str:
    return FINGER.replace('part = "led_800"', line)


def in_photodiode(line: str) -> str:
    return FINGER + line + "\n"


def test_the_scenes_that_the_bad_ones_are_made_from_are_good():
    assert parse_scene(FINGER).finger and parse_scene(PHANTOM).phantom


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (in_finger("nail_thicknes_mm = 0.4"), ["finger.nail_thicknes_mm", "not a known field", '"nail_thickness_mm"?']),
        (in_led('part = "led_800"\nwavelenght_nm = 800.0'), ["leds[0].wavelenght_nm", '"wavelength_nm"?']),
        ("leds_ = 1\n" + FINGER, ["leds_", '"leds"?']),
        (in_finger("colour = 1"), ["finger.colour", "known here: digit, width_mm"]),
        (in_finger('"a\\nb" = 1'), ["finger.a b"]),
    ],
    ids=["finger", "led", "scene", "nothing alike", "line break"],
)
def test_an_unknown_field_is_named_with_a_suggestion(text, words):
    line = complaint(text)
    assert all(word in line for word in words), line


@pytest.mark.parametrize(
    ("text", "field", "value"),
    [
        (in_finger("nail_thickness_mm = 450.0"), "finger.nail_thickness_mm", "450.0"),
        (in_finger("melanin_fraction = 1.3"), "finger.melanin_fraction", "1.3"),
        (FINGER + "[blood]\nso2 = 97", "blood.so2", "97"),
        (FINGER + "[blood]\nrest_blood_fraction = -0.01", "blood.rest_blood_fraction", "-0.01"),
        (FINGER + "[board]\nkapton_um = 0.025", "board.kapton_um", "0.025"),
        (FINGER + "[board]\nopaque_reflectance = 4.0", "board.opaque_reflectance", "4.0"),
        (FINGER + "[touch]\nproximal_share = 50", "touch.proximal_share", "50"),
        (FINGER + "[touch]\ncontact_area_mm2 = 0", "touch.contact_area_mm2", "0"),
        (FINGER + "[touch]\ncontact_area_mm2 = 1e-296", "touch.contact_area_mm2", "1e-296"),
        (FINGER.replace("[finger]", "[finger]\nlength_mm = 1e4"), "finger.length_mm", "10000.0"),
        (FINGER + "[electronics]\nadc_bits = 64", "electronics.adc_bits", "64"),
        (FINGER + "[accuracy]\nrelative_error = 0.0", "accuracy.relative_error", "0.0"),
        (FINGER + "[accuracy]\nphotons = 1.5", "accuracy.photons", "1.5"),
        (FINGER + "[accuracy]\nmax_seconds = -1", "accuracy.max_seconds", "-1"),
        (FINGER + '[light]\nengine = "photon"', "light.engine", '"photon"'),
        (PHANTOM.replace("= inf", "= 0.0"), "phantom.layers[0].thickness_mm", "0.0"),
        (PHANTOM.replace("mu_a_per_mm = 0.1", "mu_a_per_mm = 1e39"), "phantom.layers[0].mu_a_per_mm", "1e+39"),
        (PHANTOM.replace("mu_s_per_mm = 1.0", "mu_s_per_mm = -1.0"), "phantom.layers[0].mu_s_per_mm", "-1.0"),
        (PHANTOM.replace("mu_s_per_mm", "g = 1.0\nmu_s_per_mm"), "phantom.layers[0].g", "1.0"),
        (PHANTOM.replace("mu_s_per_mm", "n = 0.9\nmu_s_per_mm"), "phantom.layers[0].n", "0.9"),
        (FINGER.replace("schema_version = 1", "schema_version = 2"), "schema_version", "2"),
    ],
    ids=lambda value: value if isinstance(value, str) and len(value) < 40 else "",
)
def test_a_value_out_of_range_names_its_field_and_rule(text, field, value):
    line = complaint(text)
    assert f"bad.toml: {field} = {value}: must " in line, line


@pytest.mark.parametrize(
    ("text", "field"),
    [
        (in_finger('nail_thickness_mm = "0.4"'), "finger.nail_thickness_mm"),
        (in_finger("nail_thickness_mm = true"), "finger.nail_thickness_mm"),
        (in_finger("digit = {}"), "finger.digit"),
        (in_finger("digit = [1]"), "finger.digit"),
        (FINGERLESS.replace("schema_version = 1", "schema_version = 1\nfinger = 3"), "finger"),
        ("schema_version = 1\nleds = []\n[finger]", "leds"),
        ("schema_version = 1\nleds = {}\n[finger]", "leds"),
        (FINGER.replace("[-1.2, 0.0]", "[-1.2, 0.0, 1.0]"), "leds[0].position_mm"),
        (FINGER.replace("[-1.2, 0.0]", "-1.2"), "leds[0].position_mm"),
        (FINGER.replace('"ir"', '"1 r"'), "leds[0].name"),
        (FINGER + "[touch]\nforce_n = 1" + 400 * "0", "touch.force_n"),
    ],
)
def test_a_value_of_the_wrong_kind_names_its_field(text, field):
    assert f": {field} = " in complaint(text)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (FINGER + "[blood]\nso2 = 97", "; it is a fraction, not percent: 97 % is 0.97."),
        (FINGER + '[touch]\nforce_n = "2 N"', "; give it in N, a number without unit and quotes."),
        (FINGER + '[blood]\nso2 = "97 %"', "; give a number without unit and quotes."),
        (FINGER.replace("schema_version = 1", ""), "schema_version is missing; add schema_version = 1."),
        (FINGER.replace("[[leds]]", "[leds]"), "; write [[leds]], in double brackets, for each."),
    ],
    ids=["percent", "a unit", "a text", "no version", "single brackets"],
)
def test_a_common_mistake_is_named_with_its_correction(text, words):
    assert complaint(text).endswith(words)


@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
@pytest.mark.parametrize("field", ["finger.nail_thickness_mm", "blood.so2", "touch.force_n", "leds[0].position_mm[0]"])
def test_nan_and_infinity_are_refused(field, value):
    table, name = field.rsplit(".", 1)
    text = {
        "finger": in_finger(f"{name} = {value}"),
        "leds[0]": FINGER.replace("-1.2", value),
    }.get(table, f"{FINGER}[{table}]\n{name} = {value}")
    assert field in complaint(text)


def test_only_the_last_layers_thickness_may_be_infinite_and_none_nan():
    assert math.isinf(parse_scene(PHANTOM).phantom.layers[-1].thickness_mm)
    assert "thickness_mm = NaN" in complaint(PHANTOM.replace("= inf", "= nan"))
    assert '"slab" has thickness_mm = inf but is not the last' in complaint(
        PHANTOM.replace("[[leds]]", LAYERS.replace('"slab"', '"below"') + "[[leds]]")
    )


def test_an_led_inside_a_photodiode_names_the_depth():
    # Element 7 of 16 spans v from -0.25 to 0 mm, the die at 0.1 spans v from -0.125 to 0.125.
    line = complaint(FINGER.replace("-1.2", "0.1"))
    assert 'leds "ir": position_mm lies 0.125 mm inside photodiode "pd_array_4x1.7"' in line


def test_a_board_wider_or_longer_than_the_nail_is_refused():
    assert "-7.00 to 7.00 mm does not fit on the nail, which is 11.5 mm wide" in complaint(
        FINGER + "[board]\nsize_mm = [14.0, 8.0]"
    )
    assert "mm long" in complaint(FINGER + "[board]\nsize_mm = [6.0, 13.0]")
    assert "does not fit on the nail" in complaint(FINGER + "[board]\ncenter_mm = [5.0, 0.0]")
    # Of a board whose size follows from its parts, what lies outermost is named.
    for place, size in (("[-24.0, 0.0]", "11.5 mm wide"), ("[-1.2, 26.0]", "12 mm long")):
        where = place.strip("[]").replace(".0", "")
        line = complaint(FINGER.replace("[-1.2, 0.0]", place))
        assert (
            f'leds "ir" at ({where}) mm, with board beside it, does not fit on the nail, which is {size}; move' in line
        )
    assert "reaches over the edge of the board" in complaint(FINGER + "[board]\nsize_mm = [2.0, 6.0]")


def test_a_barrier_without_room_is_refused_with_advice():
    line = complaint(FINGER.replace("-1.2", "-0.7"))
    assert line.startswith("bad.toml: board.barrier: LED ") and "barrier = false" in line


@pytest.mark.parametrize("wavelength", ["399.9", "1000.1", "300.5"])
def test_a_wavelength_without_tissue_data_is_refused(wavelength):
    line = complaint(in_led(f"wavelength_nm = {wavelength}"))
    assert f"leds[0].wavelength_nm = {wavelength}" in line and "400 to 1000 nm" in line


def test_a_wavelength_in_micrometres_is_refused_with_the_unit():
    line = complaint(in_led("wavelength_nm = 0.94"))
    assert "leds[0].wavelength_nm = 0.94: must be greater than or equal to 200; give it in nm." in line


@pytest.mark.parametrize("wavelength", [400.0, 1000.0])
def test_wavelengths_at_the_ends_of_the_data_are_good(wavelength):
    assert parse_scene(in_led(f"wavelength_nm = {wavelength}")).leds[0].wavelength_nm == wavelength


def test_scene_parts_and_tissue_agree_on_the_wavelengths_that_have_data():
    limits = {type(rule).__name__: rule for rule in LedPart.model_fields["peak_nm"].metadata}
    assert WAVELENGTH_RANGE_NM == TISSUE_RANGE_NM == (limits["Ge"].ge, limits["Le"].le)


def test_names_given_twice_are_refused():
    led = FINGER.split("[[photodiodes]]")[0].split("[[leds]]")[1]
    photodiode = FINGER.split("[[photodiodes]]")[1]
    assert 'leds: the name "ir" is used twice' in complaint(FINGER + "[[leds]]" + led.replace("-1.2", "1.2"))
    assert "photodiodes: the name" in complaint(
        FINGER + "[[photodiodes]]" + photodiode.replace("[0.0, 0.0]", "[2.0, 0.0]")
    )
    single = '[[photodiodes]]\nname = "pd_array_4x1.3"\nposition_mm = [2.0, 0.0]\n'
    assert 'the name "pd_array_4x1.3" is used twice' in complaint(FINGER + single)
    assert 'phantom.layers: the name "slab"' in complaint(
        PHANTOM.replace("[[leds]]", LAYERS + "[[leds]]").replace("inf", "1.0")
    ).replace("phantom: layers", "phantom.layers")


def test_a_scene_has_either_a_finger_or_a_phantom():
    assert "either [finger] or [phantom]" in complaint(FINGERLESS)
    assert "either [finger] or [phantom]" in complaint(FINGER + "[phantom]" + LAYERS)


def test_phantoms_and_fingers_refuse_each_others_fields():
    assert 'leds[0].pattern = "pencil" is for phantoms' in complaint(
        in_led('wavelength_nm = 800.0\npattern = "pencil"')
    )
    assert "photodiodes[0].aperture is for phantoms" in complaint(in_photodiode("aperture = true"))
    assert "photodiodes[0].aperture must be true in a phantom" in complaint(
        PHANTOM + '[[photodiodes]]\nname = "square"\nposition_mm = [2.0, 0.0]'
    )


@pytest.mark.parametrize(
    ("touch", "words"),
    [
        ("contact_area_mm2 = 400.0", "an area of contact of 400 mm^2 reaches off the finger, which has 280 mm^2"),
        (
            "force_n = 8.0\ncontact_force_n = 1.0",
            "an area of contact of 400 mm^2 reaches off the finger, which has 280",
        ),
        (
            'site = "distal"\ndistal_onset_n = 0.8',
            "touch: distal_onset_n = 0.8 is for a touch that presses on the proximal",
        ),
        ("duration_s = 1e-3", "touch: sample_rate_hz = 100 gives one sample of the touch"),
    ],
)
def test_a_contact_that_cannot_be_is_refused(touch, words):
    assert words in complaint(FINGER + "[touch]\n" + touch)


def test_what_is_missing_is_named():
    assert "schema_version is missing" in complaint("", faults=2)
    assert "leds is missing" in complaint("schema_version = 1\n[finger]")
    assert "phantom.layers is missing" in complaint(PHANTOM.replace(LAYERS, "\n"))
    assert "photodiodes: a finger scene needs at least one" in complaint(FINGER.split("[[photodiodes]]")[0])


def test_a_missing_or_wrong_part_is_named_with_those_there_are(tmp_path):
    line = complaint(in_led('part = "led_801"'), tmp_path)
    assert "leds[0]" in line and '"led_801" is unknown' in line and "led_660, led_800" in line and str(tmp_path) in line
    assert 'has kind "photodiode"' in complaint(in_led('part = "pd_array_4x1"'))
    assert "no path" in complaint(in_led('part = "../led_800"'))
    (tmp_path / "mine.toml").write_text('kind = "led"\npeak_nm = 8000.0\nfwhm_nm = 30\nflux_mw = 2')
    line = complaint(in_led('part = "mine"'), tmp_path)
    assert "peak_nm = 8000.0" in line and "mine.toml" in line


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ("wired = [16]", "wired names element 16, but the array has elements 0 to 15"),
        ("wired = [1, 1]", "wired names an element twice"),
        ("wired = []", "wired = []: must have at least 1 item"),
        ("wired = [-1]", "wired[0] = -1"),
        ("pitch_mm = 0.1", "pitch_mm = 0.1 is less than the element's size"),
    ],
)
def test_impossible_wiring_is_refused(fields, words):
    line = complaint(in_photodiode(fields))
    assert "photodiodes[0]" in line and words in line


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ('pattern = "measured"', "pattern_deg and pattern_relative must have two angles or more"),
        ('pattern = "measured"\npattern_deg = [0, 90]\npattern_relative = [0, 0]', "light at one of them"),
        ('pattern = "measured"\npattern_deg = [0, 90]\npattern_relative = [1]', "of equal length"),
        (
            'pattern = "measured"\npattern_deg = [0, 90.001]\npattern_relative = [1, 0]',
            "leds[0].pattern_deg[1] = 90.001: must be less than or equal to 90",
        ),
        ('pattern = "measured"\npattern_deg = [0, 50, 40]\npattern_relative = [1, 1, 0]', "rising from 0"),
        ("pattern_deg = [0, 90]\npattern_relative = [1, 0]", 'belong to pattern = "measured"'),
    ],
)
def test_an_impossible_pattern_is_refused(fields, words):
    assert words in complaint(in_led("wavelength_nm = 800.0\n" + fields))


@pytest.mark.parametrize("text", ["x = ", "= 1", "[finger", "a = " + 5000 * "[", '"\x00" = 1'])
def test_what_is_not_toml_is_refused_as_such(text):
    assert "is not " in complaint(text)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["check", "part.toml"], 'part.toml: is a part, which a scene names as part = "NAME"; give a scene here.'),
        (["batch", "scene.toml", "-o", "x"], "scene.toml: is a scene, .*; give a sweep here."),
        (["predict", "scene.toml", "rec.csv"], "scene.toml: is a scene, .*; give a subject file here."),
        (["calibrate", "rec.csv", "scene.toml"], "rec.csv: is a recording, .*; give a scene here."),
        (
            ["calibrate", "scene.toml", "sweep.toml"],
            "sweep.toml: is a sweep, which batch takes; give a recording here.",
        ),
        (["calibrate", "me.toml", "rec.csv"], "me.toml: is a subject file, which predict takes; give a scene here."),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_a_file_of_another_kind_is_named_as_what_it_is(tmp_path, monkeypatch, capsys, arguments, words):
    monkeypatch.chdir(tmp_path)
    Path("scene.toml").write_text(FINGER)
    Path("part.toml").write_text('kind = "led"\npeak_nm = 805\nfwhm_nm = 30\nflux_mw = 2\n')
    Path("sweep.toml").write_text(
        'schema_version = 1\nbase = "prototype"\n[[axes]]\npath = "blood.so2"\nvalues = [0.9]\n'
    )
    Path("me.toml").write_text('schema_version = 3\nscene_digest = "0"\n[scene]\n[light]\n')
    Path("rec.csv").write_text("# of today\n\ntime_s,force_n,pd\n0,0,1\n1,1,2\n")
    assert run(arguments) == 2
    assert re.fullmatch(f"nailoptics: {words}\n", capsys.readouterr().err)


@pytest.mark.parametrize(("given", "meant"), [("prototyp", "prototype"), ("ring", "ring.toml")])
def test_a_misspelt_scene_is_named_with_the_nearest(tmp_path, monkeypatch, given, meant):
    monkeypatch.chdir(tmp_path)
    Path("ring.toml").write_text(FINGER)
    with pytest.raises(InputError, match=f'did you mean "{meant}"\\? shipped: calibration, '):
        load_scene(given)


def test_a_scene_file_that_cannot_be_read_is_named(tmp_path):
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    for path, words in ((tmp_path / "none.toml", "No such file"), (tmp_path, "directory"), (binary, "not a text file")):
        with pytest.raises(InputError, match=words) as caught:
            load_scene(path)
        assert str(caught.value).startswith(f"{path}: ") and len(str(caught.value).splitlines()) == 1

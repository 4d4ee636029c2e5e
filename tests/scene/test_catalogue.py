"""Parts by name: shipped ones cited, the user's own first, and every rule that they break reported in one line."""

import numpy as np
import pytest

from nailoptics import scene
from nailoptics.assets import asset_path, data_dir
from nailoptics.errors import InputError
from nailoptics.light.optics import responsivity_a_per_w
from nailoptics.scene.catalogue import LedPart, ModulePart, PhotodiodePart, load_part
from nailoptics.scene.importers.board_files import proposal
from nailoptics.scene.importers.positions import PlacedPart

PARTS = sorted(path.name for path in (data_dir("assets") / "parts").glob("*.toml"))
LED = 'kind = "led"\npeak_nm = 805\nfwhm_nm = 30\nflux_mw = 2\n'


@pytest.mark.parametrize("name", PARTS)
def test_a_shipped_part_loads_and_cites_its_source(name):
    assert asset_path(f"parts/{name}").read_text().startswith("# ")
    load_part(name.removesuffix(".toml"))


def test_the_papers_parts():
    array = load_part("pd_array_4x1", expect=PhotodiodePart)
    assert array.elements * array.pitch_mm == 4.0 and array.element_size_mm == (1.0, 0.25)
    leds = [load_part(f"led_{peak}", expect=LedPart) for peak in (660, 800, 940)]
    assert [(led.peak_nm, led.fwhm_nm) for led in leds] == [(660, 17), (800, 33), (940, 42)]


def test_a_users_own_part_beside_the_scene_wins(tmp_path):
    (tmp_path / "led_800.toml").write_text(LED)
    assert load_part("led_800", tmp_path).peak_nm == 805
    assert load_part("led_800").peak_nm == 800
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "mine.toml").write_text(LED + "pattern = [[0, 1], [45.0, 0.6], [90, 0]]")
    assert load_part("mine", tmp_path).pattern == ((0, 1), (45, 0.6), (90, 0))


def test_a_scene_gets_a_parts_numbers_under_its_own_names(tmp_path):
    (tmp_path / "mine.toml").write_text(LED + "pattern = [[0, 1], [45.0, 0.6], [90, 0]]")
    led = scene.Led.model_validate({"name": "ir", "part": "mine"}, context={"folder": tmp_path})
    assert (led.wavelength_nm, led.fwhm_nm, led.flux_mw, led.size_mm) == (805, 30, 2, (0.25, 0.25))
    assert (led.pattern, led.pattern_deg, led.pattern_relative) == ("measured", (0, 45, 90), (1, 0.6, 0))
    assert scene.Led.model_validate({"name": "red", "part": "led_660"}).pattern == "lambertian"
    array = scene.Photodiode.model_validate({"array": "pd_array_4x1", "position_mm": (0.0, 0.0)})
    assert (array.elements, array.pitch_mm, array.size_mm) == (16, 0.25, (1.0, 0.25))
    assert (array.quantum_efficiency, array.dark_current_na, array.shunt_mohm) == (0.85, 0.1, pytest.approx(1000))


@pytest.mark.parametrize(
    "text, words",
    [
        (LED + "colour = 3", "colour is not a known field"),
        (LED.replace("805", "1200"), "peak_nm = 1200: must be less than or equal to 1000"),
        (LED.replace("805", '"x"'), 'peak_nm = "x": must be a valid number'),
        (LED.replace("805", "nan"), "peak_nm = NaN: must be a finite number"),
        (LED.replace("flux_mw = 2", ""), "flux_mw is missing"),
        (LED + "die_size_mm = [0.2, -1]", r"die_size_mm\[1\] = -1: must be greater than 0"),
        (LED + 'pattern = "cosine"', "pattern = .cosine.: must be 'lambertian' or be an array"),
        (LED + "pattern = [[5, 1], [90, 0]]", "pattern must have two angles or more, rising from 0"),
        (LED + "pattern = [[0, 1], [90, -1]]", r"pattern\[1\]\[1\] = -1: must be greater than or equal to 0"),
        (LED + "pattern = [[0, 1], [90.001, 0]]", r"pattern\[1\]\[0\] = 90.001: must be less than or equal to 90"),
        (LED.replace('"led"', '"lamp"'), "kind must be"),
        ("peak_nm = 3", "kind must be"),
        ("x =", "is not valid TOML"),
    ],
)
def test_a_part_that_breaks_a_rule_is_refused_in_one_line(tmp_path, text, words):
    (tmp_path / "mine.toml").write_text(text)
    with pytest.raises(InputError, match=words) as caught:
        load_part("mine", tmp_path)
    assert "mine.toml" in str(caught.value) and "\n" not in str(caught.value)


def test_an_unknown_part_is_refused_with_the_available_ones():
    with pytest.raises(InputError, match="choose one of .*bpw34, .*led_660, led_800, led_940, .*pd_array_4x1"):
        load_part("led_850")
    with pytest.raises(InputError, match='"led_80" is unknown; did you mean "led_800"\\? Else choose one of'):
        load_part("led_80")
    with pytest.raises(InputError, match="give no path"):
        load_part("../led_800")
    with pytest.raises(InputError, match='kind "led", and "photodiode" is needed'):
        load_part("led_800", expect=PhotodiodePart)


def test_a_users_own_parts_are_among_the_available_ones(tmp_path):
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "my_green.toml").write_text(LED)
    (tmp_path / "ring.toml").write_text('[ambient]\nkind = "lamp"\n')
    words = f'did you mean "my_green"\\? .* PART.toml into the folder {tmp_path / "parts"}/ \\(there is my_green\\)'
    with pytest.raises(InputError, match=words):
        load_part("my_gren", tmp_path)


def test_parts_of_the_old_kind_and_scenes_with_the_old_key_are_read(tmp_path):
    rows = (
        "elements = 4\nelement_size_mm = [1.0, 0.25]\npitch_mm = 0.3\nquantum_efficiency = 0.8\ndark_current_na = 0.2\n"
    )
    (tmp_path / "row.toml").write_text('kind = "photodiode_array"\nshunt_ohm = 1e8\n' + rows)
    old, new = (
        scene.Photodiode.model_validate({key: "row", "position_mm": (0.0, 0.0)}, context={"folder": tmp_path})
        for key in ("array", "part")
    )
    assert old == new and (new.name, new.part, new.array, new.pitch_mm, new.shunt_mohm) == (
        "row",
        "row",
        None,
        0.3,
        100,
    )


def test_real_parts_match_their_data_sheets():
    bpw34, bp104 = (
        scene.Photodiode.model_validate({"part": n, "position_mm": (0.0, 0.0)}) for n in ("bpw34", "bp104fs")
    )
    # 50 uA at 1 mW/cm2 of 950 nm on 7.5 mm2.
    area = bpw34.size_mm[0] * bpw34.size_mm[1]
    current_ua = 10 * area * responsivity_a_per_w(bpw34, 950.0)
    assert area == pytest.approx(7.5, abs=0.02) and current_ua == pytest.approx(50, rel=0.01)
    # 34 uA on 4.84 mm2, and nothing of red light through its filter.
    assert 48.4 * responsivity_a_per_w(bp104, 950.0) == pytest.approx(34, rel=0.01)
    assert responsivity_a_per_w(bp104, [660.0, 865.0, 1200.0]).tolist() == pytest.approx([0, 0.385, 0])
    # Its Fig. 1 has 40 nA at 60 degrees.
    assert bpw34.dark_current_a(298.15) == 2e-9 and bpw34.dark_current_a(333.15) == pytest.approx(40e-9, rel=0.05)
    assert scene.Photodiode(name="a", position_mm=(0.0, 0.0)).dark_current_a(400.0) == pytest.approx(1e-10)


def test_a_module_is_a_package_of_leds_and_photodiodes():
    module = load_part("max30101", expect=ModulePart)
    assert [led.name for led in module.leds] == ["red", "ir", "green"]
    assert all(
        abs(one.position_mm[0]) < 1.65 and abs(one.position_mm[1]) < 2.8 for one in (*module.leds, *module.photodiodes)
    )
    assert module.leds[0].scene_fields()["wavelength_nm"] == 660
    # The maker's table: quantum efficiency above 30 % from 640 to 980 nm.
    diode = scene.Photodiode.model_validate(module.photodiodes[0].scene_fields() | {"name": "a", "position_mm": (0, 0)})
    efficiency = responsivity_a_per_w(diode, [640.0, 980.0]) * 1239.84 / [640.0, 980.0]
    assert np.all(efficiency > 0.3) and efficiency[1] == pytest.approx(0.31, abs=0.015)


@pytest.mark.parametrize(
    ("field", "rows", "words"),
    [
        ("angular_response", "[[0.0, 1.0]]", "two rows"),
        ("angular_response", "[[0.0, 0.9], [60.0, 0.5]]", r"from \[0, 1\],"),
        ("angular_response", "[[0.0, 1.0], [60.0, 0.5], [50.0, 0.2]]", "angles rising"),
        ("angular_response", "[[0.0, 1.0], [90.0, 0.1]]", "0.1 at 90 degrees"),
        ("angular_response", "[[0.0, 1.0], [91.0, 0.0]]", "less than or equal to 90"),
        ("responsivity", "[[600.0, 0.4]]", "two rows"),
        ("responsivity", "[[600.0, 0.4], [500.0, 0.3]]", "wavelengths rising"),
        ("responsivity", "[[600.0, 0.4], [800.0, 0.7]]", "0.7 A/W at 800 nm is more than one electron per photon"),
    ],
)
def test_an_impossible_table_of_a_photodiode_is_refused(tmp_path, field, rows, words):
    text = f'kind = "photodiode"\nelement_size_mm = [1.0, 1.0]\ndark_current_na = 1\n{field} = {rows}\n'
    (tmp_path / "mine.toml").write_text(text)
    with pytest.raises(InputError, match=words):
        load_part("mine", tmp_path)


@pytest.mark.parametrize(
    ("name", "nm", "ua_at_1_mw_per_cm2"), [("sfh2400fa", 870.0, 6.2), ("bp104s", 850.0, 30.0), ("g1738", 940.0, 0.0)]
)
def test_photocurrents_of_more_photodiodes_match_their_data_sheets(name, nm, ua_at_1_mw_per_cm2):
    """Expected: within a tenth the sheet's photocurrent, or its area times its responsivity; GaAsP has no infrared."""
    part = scene.Photodiode.model_validate({"part": name, "position_mm": (0.0, 0.0)})
    current_ua = 10 * part.size_mm[0] * part.size_mm[1] * float(responsivity_a_per_w(part, nm))
    assert current_ua == pytest.approx(ua_at_1_mw_per_cm2, rel=0.1)


@pytest.mark.parametrize(
    ("name", "half_deg", "mw_per_sr"), [("sfh4543", 10.0, 230.0), ("sfh4545", 5.0, 550.0), ("sfh4550", 3.0, 1100.0)]
)
def test_emitters_with_a_lens_have_their_intensity_on_the_axis_and_half_of_it_aside(name, half_deg, mw_per_sr):
    led = scene.Led.model_validate({"name": name, "part": name})
    angle = np.radians(np.linspace(0.0, 90.0, 50_001))
    relative = np.interp(np.degrees(angle), led.pattern_deg, led.pattern_relative)
    on_axis = led.flux_mw / (2 * np.pi * np.trapezoid(relative * np.sin(angle), angle))
    assert on_axis == pytest.approx(mw_per_sr, rel=0.03)
    assert np.interp(half_deg, led.pattern_deg, led.pattern_relative) == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize(("value", "use"), [("660nm", "led_660"), ("LED red", "?"), ("1N4148", None)])
def test_a_diode_is_proposed_as_an_led_by_its_value(value, use):
    """Expected: D1 of a wavelength, or called an LED, is one; any other diode is not."""
    line = proposal(
        [PlacedPart("D1", value, "", (0.0, 0.0), 0.0, "top"), PlacedPart("PD1", "", "", (0, 0), 0.0, "top")]
    )
    assert ("D1 = { led" in line) == (use is not None) and (use is None or f'D1 = {{ led = "{use}" }}' in line)


@pytest.mark.parametrize(
    ("ref", "value", "package", "line"),
    [
        ("R", "~", "LEDs:LED_0805", 'parts = { R = { led = "?" } }'),
        ("D1", "SFH_2430-Z", "SFH_2430-Z:DIO_SFH_2430-Z", 'parts = { D1 = { photodiode = "?" } }'),
        ("J", "~", "Pin_Headers:1x03", 'parts = { REF = { led = "PART" } }, with REF one of J'),
    ],
)
def test_a_part_is_proposed_by_its_footprint(ref, value, package, line):
    assert proposal([PlacedPart(ref, value, package, (0.0, 0.0), 0.0, "top")]) == line


def test_of_parts_whose_names_begin_alike_the_longer_is_proposed():
    values = enumerate(("SFH 2400 FA", "SFH2400"))
    placed = [PlacedPart(f"PD{i}", value, "", (0.0, 0.0), 0.0, "top") for i, value in values]
    assert proposal(placed) == 'parts = { PD0 = { photodiode = "sfh2400fa" }, PD1 = { photodiode = "sfh2400" } }'

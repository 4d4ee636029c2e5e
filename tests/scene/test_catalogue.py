"""Parts by name: shipped ones cited, the user's own first, and every rule that they break told in one line."""

import pytest

from nailoptics import scene
from nailoptics.assets import asset_path, data_dir
from nailoptics.errors import InputError
from nailoptics.scene.catalogue import LedPart, PhotodiodePart, load_part

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
        (LED + 'pattern = "cosine"', 'pattern: must be "lambertian" or rows .* not .cosine.'),
        (LED + "pattern = [[5, 1], [90, 0]]", "angles rising from 0"),
        (LED + "pattern = [[0, 1], [90, -1]]", "relative >= 0"),
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


def test_an_unknown_part_names_the_known_ones():
    with pytest.raises(InputError, match="choose one of led_660, led_800, led_940, pd_array_4x1"):
        load_part("led_850")
    with pytest.raises(InputError, match="give no path"):
        load_part("../led_800")
    with pytest.raises(InputError, match='kind "led", and "photodiode" is needed'):
        load_part("led_800", expect=PhotodiodePart)

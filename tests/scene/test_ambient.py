"""[ambient] and the rejection of its light: what is read, what is refused in one line, and the fields before it."""

import pytest
from small_scenes import SMALL_FINGER, phantom

from nailoptics.errors import InputError
from nailoptics.light.identity import light_digest
from nailoptics.scene import Ambient, parse_scene, to_toml

TWO_LEDS = SMALL_FINGER + '[[leds]]\nname = "red"\npart = "led_660"\nposition_mm = [-1.2, 1.0]\n'


def test_old_ambient_fields_of_an_oximeter_are_read_as_ambient():
    scene = parse_scene(TWO_LEDS + '[oximeter]\nambient_light = "sun"\nsettle = 0.4\n')
    assert scene.ambient == Ambient(kind="sun", illuminance_lux=1000.0)
    assert scene.oximeter is not None and scene.oximeter.settle == 0.4
    assert parse_scene(TWO_LEDS + "[oximeter]\nambient_lux = 0.0\n").ambient == Ambient(illuminance_lux=0.0)
    assert parse_scene(to_toml(scene)) == scene
    assert parse_scene(TWO_LEDS + "[oximeter]\n").ambient is None


def test_ambient_light_leaves_the_leds_light_as_it_is():
    lit = SMALL_FINGER + '[ambient]\nilluminance_lux = 1.0\n[electronics]\nambient_rejection = "lock_in"\n'
    assert light_digest(parse_scene(lit)) == light_digest(parse_scene(SMALL_FINGER))
    assert parse_scene(lit).electronics.rejection_hz == 1000.0


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("[ambient]", "either illuminance_lux or irradiance_w_per_m2; give exactly one"),
        ("[ambient]\nilluminance_lux = 1.0\nirradiance_w_per_m2 = 1.0", "give exactly one"),
        ('[ambient]\nkind = "moon"\nilluminance_lux = 1.0', "ambient.kind"),
        ("[ambient]\nilluminance_lux = -1.0", "ambient.illuminance_lux = -1"),
        ("[ambient]\nirradiance_w_per_m2 = 1e9", "ambient.irradiance_w_per_m2"),
        ("[ambient]\nilluminance_lux = 1.0\nflicker = 1.5", "ambient.flicker = 1.5"),
        ("[electronics]\nswitching_hz = 10.0", "switching_hz is for ambient_rejection"),
        (
            '[electronics]\nambient_rejection = "dark_slot"\nswitching_hz = 50.0',
            "switching_hz = 50: must be at most a third",
        ),
        ('[electronics]\nambient_rejection = "lock_in"\nswitching_hz = 150.0', "switching_hz = 150: must be"),
        ("[touch]\ncontact_area_mm2 = 1e4", "reaches off the finger"),
        ("[touch]\ncontact_area_mm2 = 1e-9", "touch.contact_area_mm2"),
        ("[touch]\ndistal_area_mm2 = 1e-9", "touch.distal_area_mm2"),
        ("[blood]\nrest_blood_fraction = -0.1", "blood.rest_blood_fraction"),
        ("[body]\nhand_height_m = -1.1", "body.hand_height_m"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(table, words):
    with pytest.raises(InputError, match=words.replace(".", r"\.")) as error:
        parse_scene(SMALL_FINGER + table + "\n")
    assert "\n" not in str(error.value)


def test_a_phantom_has_no_ambient_light():
    with pytest.raises(InputError, match=r"ambient needs a \[finger\]"):
        parse_scene(phantom({}) + "[ambient]\nilluminance_lux = 1.0\n")

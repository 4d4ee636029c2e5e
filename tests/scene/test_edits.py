"""Scenes built and edited in Python: what another part or digit brings along, and errors in the user's words."""

import numpy as np
import pytest
from small_scenes import finger

import nailoptics as nail
from nailoptics.assets import data_dir
from nailoptics.scene import Finger, Led

BOARD = "tests/scene/of_kicad/version_9.kicad_pcb"


@pytest.fixture
def scene():
    return nail.load_scene("prototype")


def test_a_field_an_led_and_a_photodiode_are_edited_by_a_call_each(scene):
    assert scene.with_(**{"blood.so2": 0.9, "touch.force_n": 2}).touch.force_n == 2.0
    moved = scene.with_led("ir", position_mm=[-1.5, 1.0])
    assert moved.leds[0].position_mm == (-1.5, 1.0) and moved.photodiodes == scene.photodiodes
    louder = scene.with_photodiode("distal", feedback_ohm=2e6)
    assert [one.feedback_ohm for one in louder.photodiodes] == [None, 2e6]
    assert louder.with_photodiode(1, feedback_ohm=None) == scene
    two = scene.with_(leds=[*scene.leds, {"name": "red", "part": "led_660", "position_mm": np.array([-1.2, 1.0])}])
    assert [led.wavelength_nm for led in two.leds] == [800.0, 660.0] and two.with_(leds=two.leds[:1]) == scene
    assert scene.leds[0].position_mm == (-1.2, 0.0)


def test_what_a_scene_is_edited_to_is_what_a_file_with_these_lines_is(scene):
    """Rationale: a scene holds all that parts, digits and profiles fill in; edits must not freeze it.
    Expected: the same scene as a file with the edited line."""
    assert scene.with_(**{"finger.digit": "thumb"}).finger == Finger(digit="thumb")
    for same in (scene, nail.parse_scene(nail.to_toml(scene))):
        red = same.with_led("ir", part="led_660", position_mm=(-2.0, 0.0)).leds[0]
        assert red == Led(name="ir", part="led_660", position_mm=(-2.0, 0.0), fwhm_nm=0.0)
    cycle = scene.with_(**{"touch.profile": "cycle", "touch.cycles": 2}).touch
    assert (cycle.period_s, cycle.duration_s) == (20.0, 40.25)
    assert scene.with_(**{"touch.site": "distal"}).touch.proximal_share == 0.0
    driven = scene.with_led("ir", flux_mw=3.0, current_ma=10.0)
    assert driven.with_led("ir", flux_mw=4.0).leds[0].current_ma == 10.0  # was given, and belongs to no part


@pytest.mark.parametrize("name", sorted(path.stem for path in data_dir("scenes").glob("*.toml")))
def test_a_value_that_a_scene_has_already_changes_nothing(name):
    """Though the tables around it are made again from what defines them."""
    scene = nail.load_scene(name)
    same = {"leds[0].name": scene.leds[0].name, "blood.so2": scene.blood.so2, "touch.force_n": scene.touch.force_n}
    if scene.photodiodes:
        same["photodiodes[0].position_mm"] = list(scene.photodiodes[0].position_mm)
    if scene.finger is not None:
        same["finger.nail_length_mm"] = scene.finger.nail_length_mm
    assert scene.with_(**same) == scene


TALL = """kind = "led"
peak_nm = 850.0
fwhm_nm = 30.0
flux_mw = 5.0
die_size_mm = [0.3, 0.3]
height_um = 200.0
package_height_um = 900.0
lens = true
"""


def test_another_part_leaves_nothing_of_the_one_before(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tall.toml").write_text(TALL)
    place = {"name": "a", "position_mm": (-2.0, 0.0)}
    photodiode, board = {"name": "p", "position_mm": (1.0, 0.0)}, {"barrier": False}
    tall, red = (
        nail.Scene(finger={}, leds=[place | {"part": part}], photodiodes=[photodiode], board=board)
        for part in ("tall", "led_660")
    )
    assert tall.leds[0].height_um == 200.0 and tall.with_led("a", part="led_660") == red


def test_a_table_that_gives_what_a_written_scene_does_keeps_the_rest_of_its_part():
    given = {"elements": 1, "size_mm": (1.0, 1.0), "quantum_efficiency": 0.9, "dark_current_na": 1.0, "shunt_mohm": 9.0}
    one = nail.scene.Photodiode(name="p", position_mm=(1.0, 0.0), part="sfh2400fa", **given)
    assert one.responsivity is not None and one.capacitance_pf == 11.0 and one.dark_current_na == 1.0
    # Without its table it is no longer that part, which would bring it back.
    scene = nail.load_scene("prototype").with_photodiode(
        "distal", part="sfh2400fa", wired=None, elements=1, pitch_mm=None
    )
    bare = scene.with_photodiode("distal", responsivity=None)
    assert bare.photodiodes[1].responsivity is None and nail.parse_scene(nail.to_toml(bare)) == bare


def test_another_flux_takes_another_current_of_its_part():
    part = nail.parse_scene(finger({"part": "bpw34", "position_mm": [2.0, 0.0]}, leds=({"part": "sfh7051_green"},)))
    before, after = part.leds[0], part.with_led("ir", flux_mw=2 * part.leds[0].flux_mw).leds[0]
    assert after.current_ma == pytest.approx(2 * before.current_ma)


def test_another_recording_is_read(tmp_path, monkeypatch, scene):
    monkeypatch.chdir(tmp_path)
    for name, force_n in (("a.csv", 1), ("b.csv", 2)):
        (tmp_path / name).write_text(f"time_s,force_n\n0,0\n1,{force_n}\n")
    first = scene.with_(touch={"profile": "recorded", "file": "a.csv"})
    assert first.with_(**{"touch.file": "b.csv"}).touch.recorded_force_n == (0.0, 2.0)
    assert first.with_(**{"touch.profile": "hold", "touch.file": None}).touch.recorded_force_n is None


def test_names_are_changed_last_and_paths_come_in_a_mapping(scene):
    led = scene.with_led("ir", name="near", flux_mw=3.0).leds[0]
    assert (led.name, led.flux_mw) == ("near", 3.0)
    assert scene.with_photodiode(0, name="first").photodiodes[0].name == "first"
    assert scene.with_({"blood.so2": 0.9}) == scene.with_(**{"blood.so2": 0.9}) != scene


UNPLACED = ({"name": "a", "part": "led_660"}, {"name": "b", "part": "led_660"})


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda s: s.with_led("red", flux_mw=1), "leds.red.flux_mw.*no item red here; known: 0, ir"),
        (lambda s: s.with_led(-1, flux_mw=1), "no item -1 here; known: 0, ir"),
        (lambda s: s.with_photodiode("distal.3", feedback_ohm=1e5), "distal.3 is an element of the array distal"),
        (lambda s: nail.Scene(**dict(s) | {"leds": UNPLACED}), "position_mm lies .*; it was not given and is "),
        (lambda s: s.with_led("ir", flux=1), r'leds\[0\].flux is not a known field; did you mean "flux_mw"'),
        (lambda s: s.with_led("ir", flux_mw=-1), r"leds\[0\].flux_mw = -1: must be greater than 0"),
        (lambda s: s.with_led("ir", position_mm=(0, -2)), "position_mm lies .* mm inside photodiode"),
        (lambda s: s.with_(**{"blood so2": 0.9}), "is not a field"),
        (lambda s: s.with_(**{"blood.so2": 97}), "blood.so2 = 97: must be less than or equal to 1"),
        (lambda s: s.with_(**{"blood.so2.x": 1}), "blood.so2"),
        (lambda s: s.with_(leds=[]), "leds = .*at least 1 item"),
        (
            lambda s: s.with_({"touch.force_n": 50}),
            "touch.force_n: 50 N must be at most 30 N; give it in newtons: divide millinewtons by",
        ),
        (lambda s: nail.Scene(finger={}, leds=s.leds), "photodiodes: a finger scene needs at least one"),
        (lambda s: nail.Scene(schema_version=2, finger={}, leds=s.leds), "schema_version = 2"),
        (lambda s: Led(name="ir", wavelength_nm="red"), 'wavelength_nm = "red": must be a valid number'),
        (lambda s: Led(name="ir", part="none"), 'part "none" is unknown'),
        (lambda s: nail.Scene.from_kicad("no.kicad_pcb"), "no.kicad_pcb: cannot be read"),
        (lambda s: nail.Scene.from_kicad(BOARD), "nothing says what its parts are; choose from this"),
    ],
)
def test_an_edit_to_an_invalid_scene_names_the_field_and_rule(scene, edit, message):
    with pytest.raises(nail.InputError, match=message):
        edit(scene)


def test_assigning_a_field_is_refused_with_the_way_to_change_it(scene):
    for table, field in ((scene, "leds"), (scene.touch, "force_n")):
        with pytest.raises(AttributeError, match=rf"^{field} cannot be assigned: .* scene.with_\(\.\.\.\) returns"):
            setattr(table, field, 1.0)


def test_an_edit_without_effect_is_refused(tmp_path, scene):
    """Where the part is no longer available, or the board's file has been read."""
    (tmp_path / "mine.toml").write_text('kind = "led"\npeak_nm = 850.0\nfwhm_nm = 30.0\nflux_mw = 3.0\n')
    text = finger({"name": "p", "position_mm": [2.0, 0.0]}, leds=({"part": "mine"},))
    mine = nail.parse_scene(text, folder=tmp_path)
    with pytest.raises(nail.InputError, match=r"leds.ir.part: .* its old part is not in this folder"):
        mine.with_led("ir", part="led_660")
    worn = of_kicad()
    with pytest.raises(nail.InputError, match="board.turn_deg: the file of the board has been read"):
        worn.with_(**{"board.turn_deg": 90.0})


def of_kicad():
    parts = {"D1": {"led": "led_660"}, "PD1": {"photodiode": "bpw34"}}
    return nail.Scene.from_kicad(BOARD, parts, board={"barrier": False}, finger={"digit": "thumb"})


def test_a_scene_is_built_from_a_board_of_kicad(monkeypatch):
    worn = of_kicad()
    assert [led.name for led in worn.leds] == ["D1"] and worn.board.outline_mm and "R1" in worn.board.unmapped
    assert nail.parse_scene(nail.to_toml(worn)) == worn
    moved = worn.with_led("D1", position_mm=(-4.0, 0.0))
    assert moved.leds[0].reference == "D1" and moved.board == worn.board
    # The film is the file's, or assumed, as check reports; an edit must not make it stated.
    assert moved.board.model_fields_set == worn.board.model_fields_set


def test_a_scene_summarises_itself_in_a_line_and_draws_itself(scene):
    assert repr(scene) == str(scene) == "<Scene: index; LEDs: ir 800 nm; photodiodes: 8; touch: step>"
    top, cut = scene.draw().axes
    assert {"LED ir, 800 nm", "distal.9"} <= {text.get_text() for text in top.texts} and len(cut.images) == 1
    html = scene._repr_html_()
    assert html.startswith("<pre>&lt;Scene: index;") and 'src="data:image/png;base64,' in html


def test_a_phantom_has_no_board_to_draw():
    phantom = nail.load_scene("phantom")
    with pytest.raises(nail.InputError, match="phantom has no board to draw"):
        phantom.draw()
    assert phantom._repr_html_().startswith("<pre>&lt;Scene: phantom;") and "img" not in phantom._repr_html_()

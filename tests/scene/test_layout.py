"""The layout of a scene's board: of each copy its own, with names, areas and photodiodes together."""

import pickle

import pytest
from small_scenes import PLAIN_FINGER, columns_of_photodiodes

from nailoptics.assets import data_dir
from nailoptics.errors import InputError
from nailoptics.scene import load_scene, parse_scene


@pytest.fixture
def scene():
    return load_scene(data_dir("scenes") / "prototype.toml")


def test_a_copy_has_its_own_layout(scene):
    before = scene.layout
    moved = scene.model_copy(update={"board": scene.board.model_copy(update={"center_mm": (0.1, 0.2)})})
    (u, v), (moved_u, moved_v) = before.leds[0].center_mm, moved.layout.leds[0].center_mm
    assert (moved_u - u, moved_v - v) == (pytest.approx(0.1), pytest.approx(0.2))
    assert scene.layout == before != moved.layout


def test_a_pickled_scene_has_the_same_layout(scene):
    before = scene.layout
    again = pickle.loads(pickle.dumps(scene))
    assert again == scene and again.layout == before


def test_elements_carry_their_names_and_photodiodes(scene):
    layout = scene.layout
    assert layout.photodiode_names == tuple(area.name for area in layout.photodiode_areas)
    for element in layout.photodiodes:
        assert element.photodiode in scene.photodiodes and element.name in element.photodiode.element_names()
        width, length = element.photodiode.size_mm
        assert element.area.area_mm2 == pytest.approx(width * length)


def test_impossible_copies_and_phantoms_have_none(scene):
    wide = scene.board.model_copy(update={"size_mm": (100.0, 11.0)})
    with pytest.raises(InputError, match="does not fit on the nail"):
        _ = scene.model_copy(update={"board": wide}).layout
    with pytest.raises(InputError, match="phantom has no board"):
        _ = load_scene(data_dir("scenes") / "phantom.toml").layout


def test_the_wall_stands_on_the_side_that_is_stated_or_where_the_led_is_farthest():
    """Expected: midway to the photodiode, which begins 1.2 mm right of the LED and 0.775 mm above it."""
    scene = parse_scene(PLAIN_FINGER).with_led("ir", position_mm=(-1.8, -1.0), size_mm=(0.2, 0.2))
    for side, axis, middle_mm in ((None, 0, -1.1), ("left", 0, -1.1), ("below", 1, -0.5125)):
        (wall,) = scene.with_({"board.barrier_side": side}).layout.barriers
        assert wall.name == (side or "left") and wall.center_mm[axis] == pytest.approx(middle_mm)
    with pytest.raises(InputError, match='board.barrier: LED "ir" lies 0 mm beside the photodiodes'):
        scene.with_({"board.barrier_side": "right"})


def test_a_die_as_high_as_the_epoxy_is_refused(scene):
    high = tuple(led.model_copy(update={"height_um": 390.0}) for led in scene.leds)
    with pytest.raises(InputError, match='leds "ir": height_um = 390 leaves less than 20 um of the clear epoxy'):
        _ = scene.model_copy(update={"leds": high}).layout


MANY = columns_of_photodiodes(32, 0.2, 0.25)


def test_a_thousand_photodiodes_and_no_more():
    scene = parse_scene(MANY)
    assert len(scene.layout.photodiodes) == 1024
    one_more = MANY + '[[photodiodes]]\nname = "last"\nposition_mm = [4.2, 0.0]\nsize_mm = [0.15, 0.2]\n'
    with pytest.raises(InputError, match="have 1025 elements; at most 1024"):
        parse_scene(one_more)
    # Of so many, the first two that overlap are named.
    moved = MANY.replace("position_mm = [2.6, 0.0]", "position_mm = [2.50, 0.1]")
    with pytest.raises(InputError, match=r'photodiode "p29\.0": position_mm lies .* mm inside photodiode "p30\.0"'):
        parse_scene(moved)

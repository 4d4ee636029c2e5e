"""Packages of a KiCad board: read with their dies, kept apart by a search, on the board and off its other parts."""

import re
from itertools import combinations

import numpy as np
import pytest
import shapely
from shapely import affinity

from nailoptics.errors import InputError
from nailoptics.exports import kicad_board
from nailoptics.light.identity import light_digest
from nailoptics.scene import Led, Photodiode, load_scene, parse_scene, to_toml
from nailoptics.scene.importers.kicad import read_board
from nailoptics.scene.layout import room_of
from nailoptics.studies import scene_check
from nailoptics.studies.placement import boards, place, search

from .test_search import searched

# Two LEDs whose dies lie aside of their packages' middle, photodiodes of which one is turned by 90 degrees, a resistor
# beside them and a connector on the other side, with pins.
BOARD = """(kicad_pcb (version 20240108)
  (setup (aux_axis_origin 100 100))
  (footprint "LED" (layer "B.Cu") (at 96.6 97) (property "Reference" "D1")
    (fp_rect (start -0.9 -0.5) (end 0.7 0.5) (layer "B.Fab"))
    (fp_rect (start -1.1 -0.7) (end 0.9 0.7) (layer "B.CrtYd"))
    (pad "1" smd rect (at -0.8 0) (size 0.4 0.8)) (pad "2" smd rect (at 0.6 0) (size 0.4 0.8)))
  (footprint "LED" (layer "B.Cu") (at 96.6 103) (property "Reference" "D2")
    (fp_rect (start -0.9 -0.5) (end 0.7 0.5) (layer "B.Fab"))
    (fp_rect (start -1.1 -0.7) (end 0.9 0.7) (layer "B.CrtYd"))
    (pad "1" smd rect (at -0.8 0) (size 0.4 0.8)) (pad "2" smd rect (at 0.6 0) (size 0.4 0.8)))
  (footprint "PD" (layer "B.Cu") (at 102 97 90) (property "Reference" "PD1")
    (fp_line (start -1 -0.6) (end 1.2 -0.6) (layer "B.Fab")) (fp_line (start 1.2 -0.6) (end 1.2 0.6) (layer "B.Fab"))
    (fp_circle (center 0 0) (end 0.8 0) (layer "B.CrtYd")) (fp_rect (start -1.2 -0.8) (end 1.4 0.8) (layer "B.CrtYd")))
  (footprint "PD" (layer "B.Cu") (at 102 103) (property "Reference" "PD2")
    (fp_line (start -1 -0.6) (end 1.2 -0.6) (layer "B.Fab")) (fp_line (start 1.2 -0.6) (end 1.2 0.6) (layer "B.Fab"))
    (fp_circle (center 0 0) (end 0.8 0) (layer "B.CrtYd")) (fp_rect (start -1.2 -0.8) (end 1.4 0.8) (layer "B.CrtYd")))
  (footprint "R" (layer "B.Cu") (at 99.5 97 45) (property "Reference" "R1")
    (fp_rect (start -0.5 -0.25) (end 0.5 0.25) (layer "B.CrtYd")))
  (footprint "J" (layer "F.Cu") (at 99.5 102) (property "Reference" "J1")
    (fp_rect (start -3 -1) (end 3 1) (layer "F.CrtYd")) (pad "1" thru_hole circle (at 0 0) (size 0.8 0.8) (drill 0.4)))
  (gr_rect (start 95 95) (end 104.5 105) (layer "Edge.Cuts"))
)
"""
SCENE = """
schema_version = 1
[finger]
digit = "thumb"
[blood]
parameters = "best"
[board]
kicad = "x.kicad_pcb"
barrier = {barrier}
{more}
[board.parts]
D1 = {{ led = "led_660", name = "red", offset_mm = [-0.3, 0.1] }}
D2 = {{ led = "led_800", name = "ir", offset_mm = [-0.3, 0.1] }}
PD1 = {{ photodiode = "pd_array_4x1", elements = 1, size_mm = [1.2, 0.6], offset_mm = [0.2, 0.0] }}
PD2 = {{ photodiode = "pd_array_4x1", elements = 1, size_mm = [1.2, 0.6], offset_mm = [0.2, 0.0] }}
[placement]
photodiodes = 3
clearance_mm = 0.2
edge_mm = 0.4
led_step_mm = 2.0
photodiode_step_mm = 0.5
"""


def written(tmp_path, *, barrier="true", more="", board=BOARD):
    (tmp_path / "x.kicad_pcb").write_text(board)
    (tmp_path / "mine.toml").write_text(SCENE.format(barrier=barrier, more=more))
    return load_scene(tmp_path / "mine.toml")


def drawn(part, box):
    """A footprint's box on its board, in the file's coordinates with y up."""
    turned = affinity.rotate(shapely.box(*box), part.rotation_deg, origin=(0, 0))
    return affinity.translate(turned, *part.position_mm)


def shape(area):
    return shapely.Polygon(area.corners_mm)


@pytest.mark.parametrize(
    ("side", "turn"), [("B", 0.0), ("B", 30.0), ("F", 0.0), ("F", -90.0)], ids=["bottom", "turned", "top", "top turned"]
)
def test_a_package_lies_around_its_die_as_drawn(tmp_path, side, turn):
    """Expected: where the file has body, pads and courtyard, seen from above as the file's parts go onto the nail; the
    LED's body from the pads' outer edges, the courtyard of a circle and a box around both."""
    swapped = BOARD.replace("B.", "#.").replace("F.", "B.").replace("#.", "F.") if side == "F" else BOARD
    scene = written(tmp_path, more=f"turn_deg = {turn}", board=swapped)
    parts = {part.ref: part for part in read_board(tmp_path / "x.kicad_pcb").footprints}
    assert parts["D1"].body_mm == (-1.0, -0.5, 0.8, 0.5) and parts["PD1"].courtyard_mm == (-1.2, -0.8, 1.4, 0.8)
    assert parts["J1"].beyond_mm == (-0.4, -0.4, 0.4, 0.4) and parts["R1"].beyond_mm is None

    def on_nail(polygon):
        x, y = np.array(polygon.exterior.coords).T
        points = shapely.Polygon(np.column_stack([(x - 100) * (-1 if side == "F" else 1), y + 100]))
        return affinity.rotate(points, turn, origin=(0, 0))

    for part in (*scene.leds, *scene.photodiodes):
        there = parts[part.reference]
        for name in ("body_mm", "courtyard_mm"):
            one = part.model_copy(update={"body_mm": None, "courtyard_mm": None} | {name: getattr(part, name)})
            hull = shape(room_of(one, part.position_mm))
            assert hull.symmetric_difference(on_nail(drawn(there, getattr(there, name)))).area < 1e-6
        # Without any, the die.
        bare = part.model_copy(update={"body_mm": None, "courtyard_mm": None})
        assert room_of(bare, (0.0, 0.0), 0.1).area_mm2 == pytest.approx(
            (part.size_mm[0] + 0.2) * (part.size_mm[1] + 0.2)
        )
    taken = shapely.MultiPolygon([shapely.Polygon(line) for line in scene.board.taken_mm])
    expected = [
        on_nail(drawn(parts["R1"], parts["R1"].courtyard_mm)),
        on_nail(drawn(parts["J1"], (-0.4, -0.4, 0.4, 0.4))),
    ]
    assert taken.symmetric_difference(shapely.unary_union(expected)).area < 1e-6
    # Light and its cache do not depend on packages, which a written scene keeps.
    assert parse_scene(to_toml(scene)).photodiodes == scene.photodiodes


@pytest.mark.long
@pytest.mark.parametrize("barrier", ["true", "false"])
def test_searched_layouts_keep_their_clearances_on_the_written_board(tmp_path, barrier):
    """Expected of each layout, read again from its board: no courtyard on another, on the resistor or the connector's
    pins; bodies the clearance apart, and the distance to the edge within it; dies where the layout has them."""
    scene = written(tmp_path, barrier=barrier)
    one, result = searched(scene)
    layouts = search.shortlist(one.base, one.rules, [*result, *one.regular])
    assert len(layouts) >= 2
    for layout in layouts:
        assert not boards.courtyard_overlaps(layout.scene)
        named, text = kicad_board.own_board(layout.scene, tmp_path)
        (tmp_path / "best.kicad_pcb").write_text(text)
        parts = read_board(tmp_path / "best.kicad_pcb").footprints
        mine = [part for part in parts if part.ref[0] in "DP"]
        assert len(mine) == 5
        courtyards, bodies = (
            [drawn(part, getattr(part, name)) for part in mine] for name in ("courtyard_mm", "body_mm")
        )
        others = {part.ref: part for part in parts}
        courtyards += [drawn(others["R1"], others["R1"].courtyard_mm), drawn(others["J1"], others["J1"].beyond_mm)]
        assert max(a.intersection(b).area for a, b in combinations(courtyards, 2)) < 1e-6
        assert min(a.distance(b) for a, b in combinations(bodies, 2)) > 0.2 - 1e-5
        edge = shapely.box(95, -105, 104.5, -95)
        assert all(edge.buffer(-0.4 + 1e-5, join_style="mitre").covers(body) for body in bodies)
        assert all(edge.buffer(1e-5).covers(courtyard) for courtyard in courtyards)
        update = {"board": named.board.model_copy(update={"kicad": "best.kicad_pcb"})}
        uses = SCENE.format(barrier=barrier, more="").replace("x.kicad_pcb", "best.kicad_pcb")
        again = load_scene_of(tmp_path, uses, [p.reference for p in named.photodiodes])
        areas = {area.name: area for area in (*again.layout.leds, *again.layout.photodiode_areas)}
        for area in (*layout.scene.layout.leds, *layout.scene.layout.photodiode_areas):
            if area.name in areas:
                assert shape(area).symmetric_difference(shape(areas[area.name])).area < 1e-4
        assert parse_scene(to_toml(named.model_copy(update=update))).layout.leds == named.layout.leds


def load_scene_of(tmp_path, text, refs):
    """The scene on a written board, with the photodiodes that lie there of its own."""
    lines = [line for line in text.splitlines() if not line.startswith("PD") or line.split()[0] in refs]
    (tmp_path / "best.toml").write_text("\n".join(lines))
    return load_scene(tmp_path / "best.toml")


@pytest.mark.long
def test_without_packages_dies_come_nearer(tmp_path):
    """Expected: of the same board without body and courtyard places that packages do not have."""
    scene = written(tmp_path)
    none = {"body_mm": None, "courtyard_mm": None}
    bare = {kind: tuple(p.model_copy(update=none) for p in getattr(scene, kind)) for kind in ("leds", "photodiodes")}
    (one, _), (other, _) = searched(scene), searched(scene.model_copy(update=bare))
    assert one.sites.room(0, (0.0, 0.0)).area_mm2 > 2 * other.sites.room(0, (0.0, 0.0)).area_mm2
    row = next(iter(one.designs))
    places, more = one.designs[row].places, next(iter(other.designs.values())).places
    assert 0 < places.free < more.free and places.spacing_mm[0] > more.spacing_mm[0]
    # From the die's edge, 0.3 - 0.125 mm left of the anchor, to the pads' 0.8 mm right of it, and the clearance.
    assert one.sites.gap_mm("left") == pytest.approx(0.3 - 0.125 + 0.8 + 0.2)


def test_overlapping_packages_of_a_drawn_board_are_warned_of(coarse_light, few_photons_beside, tmp_path, caplog):
    near = BOARD.replace("(at 102 103)", "(at 102.2 98.6)").replace("(at 96.6 103)", "(at 95.8 103)")
    scene = written(tmp_path, barrier="false", board=near.replace("(at 99.5 97 45)", "(at 101 96.3 45)"))
    lines = boards.courtyard_overlaps(scene)
    assert [line.split(";")[0] for line in lines if "overlap by" in line] == [
        "body or courtyard of PD1 and PD2 overlap by 0.4 mm"
    ]
    assert [line.split()[4] for line in lines if "reaches over" in line] == ["ir", "PD1"]
    assert {*lines} <= {*scene_check.check(scene)["warnings"]}
    place.given(boards.base_board(scene), boards.rules(scene))
    assert 'layout "drawn": body or courtyard of PD1 and PD2 overlap' in caplog.text
    assert not boards.courtyard_overlaps(written(tmp_path, barrier="false"))


def test_a_box_may_be_given_from_any_corner(tmp_path):
    led = written(tmp_path).leds[0]
    left, low, right, high = led.body_mm
    turned = led.model_copy(update={"body_mm": (right, low, left, high)})
    assert room_of(turned, (1.0, 2.0), 0.1) == room_of(led, (1.0, 2.0), 0.1)
    with pytest.raises(InputError, match=r"leds\[0\].body_mm.*must have at (least|most) 4 items") as caught:
        parse_scene(re.sub(r"body_mm = \[", "body_mm = [9.0, ", to_toml(written(tmp_path)), count=1))
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.long
def test_a_package_higher_than_the_epoxy_and_a_lens_within_it_are_warned_of(coarse_light, few_photons_beside, tmp_path):
    """Expected: of shipped parts with their own figures; none once epoxy is deep enough and the pattern the die's."""
    scene = written(tmp_path, barrier="false")
    lens, high = ({"part": name} for name in ("sfh4550", "bpw34"))
    table = scene.leds[0].model_dump(include={"name", "position_mm"})
    leds = (Led.model_validate(table | lens), scene.leds[1])
    photodiodes = (
        Photodiode.model_validate({"name": "high", "position_mm": (0.0, 0.0)} | high),
        *scene.photodiodes[1:],
    )
    both = scene.model_copy(update={"leds": leds, "photodiodes": photodiodes})
    lines = boards.misfits(both)
    assert [line.split(":")[0] for line in lines] == [
        f"lens of {leds[0].name} lies in epoxy of about its index",
        "package of high is 3200 um high, and 450 um are between board and nail",
    ]
    assert {*lines} <= {*scene_check.check(both)["warnings"]} and not boards.misfits(scene)
    # The advice is followed literally, and helps.
    bare = Led.model_validate(table | lens | {"pattern": "lambertian"})
    field, value = re.search(r"give board\.(\w+) = ([0-9.]+)$", lines[1]).groups()
    followed = both.with_(board={field: float(value)}).model_copy(update={"leds": (bare, leds[1])})
    assert not boards.misfits(followed) and not {*lines} & {*scene_check.check(followed)["warnings"]}
    highest = photodiodes[0].model_copy(update={"package_height_um": 2e4})
    assert boards.misfits(followed.model_copy(update={"photodiodes": (highest,)}))[0].endswith("; take a lower part")
    assert light_digest(both.model_copy(update={"leds": (bare, leds[1])})) == light_digest(
        both.model_copy(update={"leds": (bare.model_copy(update={"lens": False}), leds[1])})
    )


def test_a_module_stays_where_its_footprint_is(tmp_path, caplog):
    """Expected: in every searched layout the module's dies where the board has them, and photodiodes beside it."""
    file = BOARD.replace('(at 102 97 90) (property "Reference" "PD1")', '(at 100 101 90) (property "Reference" "U1")')
    (tmp_path / "x.kicad_pcb").write_text(file)
    text = "\n".join(
        line for line in SCENE.format(barrier="false", more="").splitlines() if line[:2] not in ("D1", "D2")
    )
    text = text.replace("PD1 = {", 'U1 = { module = "max30102" }\n#').replace("\n[placement]", "#\n[placement]")
    (tmp_path / "mine.toml").write_text(text)
    scene = load_scene(tmp_path / "mine.toml")
    one, result = searched(scene)
    layouts = search.shortlist(one.base, one.rules, [*result, *one.regular])
    assert layouts
    for layout in layouts:
        named, board = kicad_board.own_board(layout.scene, tmp_path)
        assert [led.center_mm for led in layout.scene.layout.leds] == [led.center_mm for led in scene.layout.leds]
        assert "U1.pd" in layout.scene.layout.photodiode_names
        (tmp_path / "best.kicad_pcb").write_text(board)
        before, after = (
            next(part for part in read_board(tmp_path / f"{name}.kicad_pcb").footprints if part.ref == "U1")
            for name in ("x", "best")
        )
        assert before == after

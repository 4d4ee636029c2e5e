"""A designer's own board in a scene: mapped parts at their places, nothing guessed, and one line where it is wrong."""

import json

import pytest
from small_scenes import ON_KICAD_BOARD

from nailoptics.cli import run
from nailoptics.errors import InputError
from nailoptics.light.identity import light_digest
from nailoptics.scene import Candidate, Placement, digest, load_scene, parse_scene, to_toml
from nailoptics.scene.importers.kicad import read_board, write_board
from nailoptics.scene.importers.outlines import Outline
from nailoptics.scene.rectangles import Rectangle, turned
from nailoptics.studies.placement import boards, candidates, result
from nailoptics.studies.placement.sites import Sites

BOARD = """(kicad_pcb (version 20171130)
  (setup (aux_axis_origin 100 100))
  (module LED_SMD:LED_0603 (layer {side}) (at 97 99 {turn}) (fp_text reference D1) (fp_text value 660nm))
  (module Osram:SFH2430 (layer {side}) (at 101 101 30) (fp_text reference PD1) (fp_text value x))
  (module R_0402 (layer F.Cu) (at 101 104) (fp_text reference R1) (fp_text value 1k))
  (gr_rect (start 96 96) (end 104 105) (layer Edge.Cuts))
)
"""


def write(tmp_path, *, more="", side="B.Cu", turn=90, scene=ON_KICAD_BOARD):
    (tmp_path / "x.kicad_pcb").write_text(BOARD.format(side=side, turn=turn))
    (tmp_path / "mine.toml").write_text(scene.format(board=more, diode="", parts=""))
    return tmp_path / "mine.toml"


def write_positions(tmp_path, positions, **how):
    """The same scene with a position file in place of the board."""
    path = write(tmp_path, **how)
    (tmp_path / "pos.csv").write_text(positions)
    path.write_text(path.read_text().replace('kicad = "x.kicad_pcb"', 'positions = "pos.csv"'))
    return path


def test_mapped_parts_lie_where_the_file_has_them_and_others_are_named(tmp_path):
    scene = load_scene(write(tmp_path))
    (led,), (diode,) = scene.leds, scene.photodiodes
    assert (led.name, led.wavelength_nm, led.position_mm, led.rotation_deg) == ("D1", 660, (-3.0, 1.0), 90)
    assert (diode.name, diode.size_mm, diode.position_mm, diode.rotation_deg) == ("PD1", (1.0, 0.5), (1.0, -1.0), 30)
    assert scene.board.unmapped == ("R1",) and {*scene.board.parts} == {"D1", "PD1"}
    # y points down in KiCad and to the tip on the nail.
    assert set(scene.board.outline_mm) == {(-4, -5), (4, -5), (4, 4), (-4, 4)}
    outline = scene.layout.outline
    assert (outline.u_min, outline.u_max, outline.v_min, outline.v_max) == (-4, 4, -5, 4)


def test_a_scene_from_a_board_is_complete_without_it(tmp_path):
    scene = load_scene(write(tmp_path))
    assert parse_scene(to_toml(scene)) == scene and digest(parse_scene(to_toml(scene))) == digest(scene)


@pytest.mark.parametrize(
    ("more", "side", "places"),
    [
        ("origin = [97.0, 99.0]", "B.Cu", [(0, 0, 90), (4, -2, 30)]),
        ('origin = "outline"', "B.Cu", [(-3, 1.5, 90), (1, -0.5, 30)]),
        ("turn_deg = 90", "B.Cu", [(-1, -3, 180), (1, 1, 120)]),
        # The top faces the nail: seen from above, the board is mirrored.
        ("", "F.Cu", [(3, 1, 270), (-1, -1, 330)]),
        ('faces_nail = "bottom"', "B.Cu", [(-3, 1, 90), (1, -1, 30)]),
    ],
)
def test_origin_side_and_turn_place_the_board_on_the_nail(tmp_path, more, side, places):
    scene = load_scene(write(tmp_path, more=more, side=side))
    computed = [(*part.position_mm, part.rotation_deg) for part in (*scene.leds, *scene.photodiodes)]
    assert computed == [pytest.approx(one) for one in places]


@pytest.mark.parametrize(("side", "up"), [("F.Cu", 1), ("B.Cu", -1)])
def test_a_row_of_elements_and_a_turn_of_its_die_are_turned_over_with_the_footprint(tmp_path, side, up):
    """Rationale: KiCad flips a footprint by negating y. Pad 1 of this one, of element 0, lies at its lower end."""
    scene = ON_KICAD_BOARD.format(board="", diode="", parts="").replace("elements = 1", "elements = 2, pitch_mm = 1.0")
    path = write(tmp_path, side=side, turn=0, scene=scene.replace("{", "{{").replace("}", "}}"))
    board = tmp_path / "x.kicad_pcb"
    board.write_text(board.read_text().replace("(at 101 101 30)", "(at 101 101)"))
    first, second = (element.area.center_mm[1] for element in load_scene(path).layout.photodiodes)
    assert up * (second - first) == pytest.approx(1.0)
    # On the top, seen from above, the nail's side is mirrored; on the bottom the footprint is.
    path.write_text(path.read_text().replace("size_mm", "rotation_deg = 20.0, size_mm"))
    assert load_scene(path).photodiodes[0].rotation_deg == {1: 340.0, -1: 160.0}[up]


def test_parts_on_the_scene_and_those_of_the_file_go_together(tmp_path):
    more = '[[leds]]\nname = "ir"\npart = "led_940"\nposition_mm = [-3.0, -2.0]\n[board.nothing]\n'
    path = write(tmp_path)
    path.write_text(path.read_text() + more.replace("[board.nothing]\n", ""))
    assert [led.name for led in load_scene(path).leds] == ["ir", "D1"]


def test_a_part_may_sit_beside_the_middle_of_its_footprint(tmp_path):
    path = write(tmp_path)
    path.write_text(path.read_text().replace('"led_660"', '"led_660", offset_mm = [0.5, 0.2]'))
    # Turned by 90 degrees, on the bottom: x of the footprint points to the tip, its y, turned over, to the right.
    assert load_scene(path).leds[0].position_mm == pytest.approx((-3.0 + 0.2, 1.0 + 0.5))


PINS = "(pad 1 thru_hole rect (at 0 0 {0}) (size 1.6 1.6)) (pad 2 thru_hole circle (at 5.08 0 {0}) (size 1.6 1.6))"


@pytest.mark.parametrize("angle", [0, 30, 90])
def test_a_part_with_wires_lies_in_the_middle_of_its_pads(tmp_path, caplog, angle):
    path = write(tmp_path, turn=angle)
    board = tmp_path / "x.kicad_pcb"
    board.write_text(
        board.read_text().replace("(fp_text reference D1)", f"(fp_text reference D1) {PINS.format(angle)}")
    )
    dx, dy = turned((2.54, 0.0), angle)
    assert load_scene(path).leds[0].position_mm == pytest.approx((-3 + dx, 1 + dy))
    assert "D1: the middle of its pads lies 2.54 mm from" in caplog.text
    path.write_text(path.read_text().replace('"led_660"', '"led_660", offset_mm = [0.0, 0.0]'))
    assert load_scene(path).leds[0].position_mm == pytest.approx((-3, 1))


def test_parts_that_are_not_fitted_are_left_out(tmp_path, caplog):
    path, board = write(tmp_path), tmp_path / "x.kicad_pcb"
    second = "(module LED_0603 (layer B.Cu) (at 98 103) (attr smd dnp) (fp_text reference D2) (fp_text value 660nm))"
    board.write_text(board.read_text().replace("(gr_rect", f"{second}\n(gr_rect"))
    path.write_text(path.read_text() + 'D2 = { led = "led_660" }\n')
    assert [led.name for led in load_scene(path).leds] == ["D1"] and "D2 is marked DNP" in caplog.text


def test_coordinates_of_a_page_are_taken_from_the_middle_of_the_parts(tmp_path, caplog):
    text = "Ref,PosX,PosY,Rot,Side\nD1,97,-99,90,bottom\nPD1,101,-101,30,bottom\n"
    path = write_positions(tmp_path, text)
    scene = load_scene(path)
    assert scene.leds[0].position_mm == (-2, 1) and scene.photodiodes[0].position_mm == (2, -1)
    assert "pos.csv: has no origin near its mapped parts, whose middle lies on the nail's centre" in caplog.text


@pytest.mark.parametrize("origin", ["(setup (aux_axis_origin 10 20))", ""])
def test_parts_far_from_the_origin_of_a_large_board_lie_around_the_nails_centre(tmp_path, caplog, origin):
    """A board of 80 x 60 mm whose corner is the origin of its drill files, or that has none."""
    path, file = write(tmp_path), tmp_path / "x.kicad_pcb"
    setup, edges = "(setup (aux_axis_origin 100 100))", "(gr_rect (start 96 96) (end 104 105)"
    assert (board := file.read_text()).count(setup) == board.count(edges) == 1
    file.write_text(board.replace(setup, origin).replace(edges, "(gr_rect (start 93 60) (end 190 130)"))
    scene = load_scene(path)
    assert (scene.leds[0].position_mm, scene.photodiodes[0].position_mm) == ((-2, 1), (2, -1))
    assert "x.kicad_pcb: has no origin near its mapped parts" in caplog.text


def test_an_assembler_writes_the_bottom_seen_from_below(tmp_path, caplog):
    text = "Designator,Mid X,Mid Y,Layer,Rotation\nD1,-3mm,1mm,Bottom,90\nPD1,1mm,-1mm,Bottom,150\n"
    board, path = load_scene(write(tmp_path)), write_positions(tmp_path, text)
    assert load_scene(path).photodiodes[0].rotation_deg == 150
    warning = "the rotation of PD1 on the bottom is read as KiCad writes it, but its header is"
    assert caplog.text.count(warning) == 1
    path.write_text(path.read_text().replace("barrier", 'rotation_on_bottom = "assembler"\nbarrier'))
    scene = load_scene(path)
    assert (scene.leds, scene.photodiodes) == (board.leds, board.photodiodes)
    assert caplog.text.count(warning) == 1


def test_the_rotation_of_a_part_beside_its_footprint_is_warned_of(tmp_path, caplog):
    path = write_positions(tmp_path, "Ref,PosX,PosY,Rot,Side\nD1,-3,1,0,bottom\nPD1,1,-1,90,bottom\n")
    load_scene(path)
    assert "the rotation of" not in caplog.text
    path.write_text(path.read_text().replace('"led_660"', '"led_660", offset_mm = [0.5, 0.2]'))
    load_scene(path)
    assert "the rotation of D1 on the bottom" in caplog.text


def test_the_rotation_of_an_array_is_warned_of(tmp_path, caplog):
    path = write_positions(tmp_path, "Ref,PosX,PosY,Rot,Side\nD1,-3,1,0,bottom\nPD1,1,-1,90,bottom\n")
    path.write_text(path.read_text().replace(", elements = 1, size_mm = [1.0, 0.5]", ""))
    load_scene(path)
    assert "the rotation of PD1 on the bottom" in caplog.text


def test_a_candidate_of_a_position_file_lies_by_its_origin_and_turn(tmp_path, caplog):
    text = "Ref,PosX,PosY,Rot,Side\nD1,97,-99,0,bottom\nPD1,101,-101,0,bottom\n"
    (tmp_path / "pos.csv").write_text(text)
    given = {"name": "mine", "positions": "pos.csv"}

    def places(**how):
        read = Candidate.model_validate(given | how, context={"folder": tmp_path})
        return *read.leds_mm, *read.photodiodes_mm, *read.photodiodes_deg

    assert places() == ((-2, 1), (2, -1), 0)
    assert "pos.csv: has no origin near its mapped parts" in caplog.text
    assert places(origin=(100.0, -100.0)) == ((-3, 1), (1, -1), 0)
    assert places(origin=(100.0, -100.0), turn_deg=90.0) == ((-1, -3), (1, 1), 90)
    assert places(origin=(100.0, -100.0), faces_nail="top") == ((3, 1), (-1, -1), 0)
    (tmp_path / "pos.csv").write_text(text.replace("-101,0", "-101,30"))
    places(negate_x_on_bottom=False)
    assert "the rotation of PD1 on the bottom" in caplog.text


STACK = '(layer "F.Cu" (type "copper") (thickness 0.018)) (layer "dielectric 1" (type "core") (thickness 0.05))'


@pytest.mark.parametrize(
    ("general", "setup", "more", "film_um"),
    [
        ("", "", "", 25),
        ("(general (thickness 0.11))", "", "", 110),
        ("(general (thickness 0.11))", f"(stackup {STACK})", "", 50),
        ("(general (thickness 0.11))", "", "kapton_um = 75.0", 75),
        ("(general (thickness 1.6))", "", "", 25),
        ("(general (thickness 1.6))", "", "kapton_um = 75.0", 75),
    ],
)
def test_the_film_is_as_thick_as_the_board_of_the_file(tmp_path, caplog, general, setup, more, film_um):
    path, board = write(tmp_path, more=more), tmp_path / "x.kicad_pcb"
    board.write_text(board.read_text().replace("(setup", f"{general}\n(setup {setup}"))
    scene = load_scene(path)
    assert scene.board.kapton_um == film_um
    # What the file does not state is assumed; what it states and no nail fits is warned of once.
    assert ("kapton_um" in scene.board.model_fields_set) == bool(general)
    text = "x.kicad_pcb: the board is 1600 um thick, one that bends onto a nail 5 to 500: a film of 25 um is taken"
    assert caplog.text.count(text) == caplog.text.count("thick") == ("1.6" in general and not more)
    assert parse_scene(to_toml(scene)).board == scene.board
    candidate = '[placement]\nsearch = false\n[[placement.candidates]]\nname = "drawn"\nkicad = "x.kicad_pcb"\n'
    path.write_text(path.read_text() + candidate)
    count = caplog.text.count("thick")
    assert load_scene(path).placement.candidates[0].leds and caplog.text.count("thick") == 2 * count


@pytest.mark.parametrize(("corner", "lies_on"), [("97 96", True), ("99 96", False)])
def test_a_part_off_an_outline_that_is_no_rectangle_is_refused(tmp_path, corner, lies_on):
    path, board = write(tmp_path), tmp_path / "x.kicad_pcb"
    corners = ("96 105", "104 105", "104 96", corner, "96 105")
    lines = (f"(gr_line (start {a}) (end {b}) (layer Edge.Cuts))" for a, b in zip(corners, corners[1:], strict=False))
    text = board.read_text().replace("(gr_rect (start 96 96) (end 104 105) (layer Edge.Cuts))", "\n".join(lines))
    board.write_text(text)
    if lies_on:
        assert len(load_scene(path).board.outline_mm) == 4
        return
    with pytest.raises(InputError, match=r'"D1" at \(-3, 1\) mm reaches over the edge of .* give board.origin'):
        load_scene(path)


@pytest.mark.parametrize(
    ("hole", "lies_on"),
    [
        ("96.5 98.5) (end 97.5 99.5", False),  # D1 lies in it
        ("97.1 98.95) (end 97.3 99.05", False),  # its edge alone does
        ("97.13 98.5) (end 98 99.5", True),  # beside its die of 0.25 mm
        ("101.4 100.6) (end 101.5 100.7", False),  # below a corner of PD1, which is turned by 30 degrees
        ("101.4 101.3) (end 101.5 101.4", True),  # below its box, but not below itself
    ],
)
def test_a_part_over_a_hole_in_the_board_is_refused(tmp_path, hole, lies_on):
    path, board = write(tmp_path), tmp_path / "x.kicad_pcb"
    board.write_text(board.read_text().replace("(gr_rect", f"(gr_rect (start {hole}) (layer Edge.Cuts))\n(gr_rect", 1))
    if lies_on:
        assert len(load_scene(path).board.outline_holes_mm) == 1
        return
    with pytest.raises(InputError, match="reaches over the edge of the board, of a hole in it"):
        load_scene(path)


def test_position_files_are_accepted_as_boards(tmp_path, caplog):
    text = "Designator,Mid X,Mid Y,Layer,Rotation\nD1,-3mm,1mm,Bottom,90\nPD1,1mm,-1mm,Bottom,30\nC1,9,9,Top,0\n"
    board, path = load_scene(write(tmp_path)), write_positions(tmp_path, text)
    scene = load_scene(path)
    assert (scene.leds, scene.photodiodes) == (board.leds, board.photodiodes) and scene.board.unmapped == ("C1",)
    assert caplog.text.count("add negate_x_on_bottom") == 1


@pytest.mark.long
def test_check_warns_once_of_a_file_shared_by_board_and_candidate(tmp_path, capsys, shared_light):
    path = write_positions(tmp_path, "Ref,PosX,PosY,Rot,Side\nD1,-3,1,90,bottom\nPD1,-1,-1,30,bottom\n")
    more = '[placement]\nphotodiodes = 1\n[[placement.candidates]]\nname = "drawn"\npositions = "pos.csv"\n'
    path.write_text(path.read_text() + more)
    assert run(["check", str(path), "--json"]) == 0
    captured = capsys.readouterr()
    (line,) = [one for one in json.loads(captured.out)["warnings"] if "add negate_x_on_bottom" in one]
    assert line.startswith("pos.csv: X on the bottom looks negated") and not captured.err
    # Where an error follows, it may be what was warned of.
    path.write_text(path.read_text().replace("barrier = false", "barrier = false\ncenter_mm = [90.0, 0.0]"))
    assert run(["check", str(path), "--json"]) == 2
    assert capsys.readouterr().err.count("X on the bottom looks negated") == 1


def test_check_names_what_of_the_board_is_assumed(tmp_path, capsys, coarse_light):
    path, board = write(tmp_path), tmp_path / "x.kicad_pcb"
    board.write_text(board.read_text().replace("(setup", "(general (thickness 1.6))\n(setup"))
    assert run(["check", str(path), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    # The thickness is stated, and is none of a film.
    assert "kapton_um" not in report["assumed"]
    assert [line for line in report["warnings"] if "1600 um thick" in line and "film of 25 um" in line]
    assert report["assumed"]["clear_epoxy_um"] == 400.0 and "barrier" not in report["assumed"]
    assert [diode["rotation_deg"] for diode in report["photodiodes"]] == [30.0]


def test_a_position_file_without_a_unit_is_read_in_that_of_the_scene(tmp_path, capsys):
    text = "Ref,PosX,PosY,Rot,Side\nD1,-0.1,0,90,top\nPD1,0.1,0.05,30,top\n"
    path = write_positions(tmp_path, text, more='positions_unit = "inch"')
    assert load_scene(path).leds[0].position_mm == pytest.approx((2.54, 0.0))  # the top faces the nail: mirrored
    path.write_text(path.read_text().replace('"inch"', '"cubit"'))
    assert (
        run(["check", str(path)]) == 2
        and "positions_unit = \"cubit\": must be 'mm', 'mil' or 'inch'" in capsys.readouterr().err
    )


def test_candidates_are_files_with_their_own_parts_matched_by_name(tmp_path):
    path = write(tmp_path)
    (tmp_path / "pos.csv").write_text(
        "Ref,Val,Package,PosX,PosY,Rot,Side\nC7,,,0,0,0,bottom\nPD1,,,2,0,0,bottom\nD1,,,-2,0,0,bottom\n"
    )
    more = '[placement]\nsearch = false\n[[placement.candidates]]\nname = "mine"\npositions = "pos.csv"\n'
    path.write_text(path.read_text() + more)
    (one,) = load_scene(path).placement.candidates
    assert (one.leds[0].name, one.photodiodes[0].size_mm, one.unmapped) == ("D1", (1.0, 0.5), ("C7",))
    assert parse_scene(to_toml(load_scene(path))).placement.candidates[0] == one


def test_where_nothing_is_mapped_a_map_is_proposed(tmp_path):
    with pytest.raises(InputError) as caught:
        load_scene(write(tmp_path, scene=ON_KICAD_BOARD[: ON_KICAD_BOARD.index("[board.parts]")]))
    line = str(caught.value)
    assert 'parts = { D1 = { led = "led_660" }, PD1 = { photodiode = "?" } }' in line and "\n" not in line


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("D1 =", "D7 =", "parts.D7 names a part that x.kicad_pcb has not; it has D1, PD1, R1"),
        ('led = "led_660"', "colour = 3", "parts.D1 must say what it is: one of led, photodiode, module"),
        ('led = "led_660"', 'led = "led_661"', 'part "led_661" is unknown'),
        ('led = "led_660"', 'led = "?"', r'part "\?" is unknown; choose one of bp104fs, .*led_660'),
        ('led = "led_660"', 'led = "led_660", position_mm = [1.0, 2.0]', "parts.D1.position_mm is the file's"),
        ("elements = 1", "elements = -1", r"photodiodes\[0\].elements = -1"),
        ("barrier = false", 'barrier = false\norigin = "grid"', "x.kicad_pcb has no such origin"),
        ("barrier = false", 'barrier = false\nfaces_nail = "top"', "parts.D1 lies on the bottom, but the top"),
        ("barrier = false", "barrier = false\norigin = [0.0, 0.0]", "reaches over the edge of the board, of a hole"),
        ("barrier = false", "barrier = false\norigin = [0.0]", r"board.origin\[1\] is missing; add it"),
        ("barrier = false", 'barrier = false\norigin = "top"', "board.origin = .*: must be 'auxiliary', 'grid' or"),
        ("barrier = false", "barrier = false\nturn_deg = []", "board.turn_deg = .*: must be a valid number"),
        ("[board.parts]", "parts = 3\n[electronics]", "board.parts = 3: must be a"),
        ('led = "led_660"', 'led = "led_660", offset_mm = 3', "parts.D1.offset_mm must be"),
        ('led = "led_660"', "led = 3", "parts.D1.led must be the name of a part"),
        ("x.kicad_pcb", "y.kicad_pcb", "y.kicad_pcb: cannot be read"),
        ("x.kicad_pcb", "mine.toml", "mine.toml: is no KiCad board"),
        ('kicad = "x.kicad_pcb"', "", "parts says what a file's references are"),
        ('kicad = "x.kicad_pcb"', 'kicad = "x.kicad_pcb"\npositions = "x.csv"', "give one of them"),
        ("barrier = false", "barrier = false\nclear_epoxy_mu = 3", "board.clear_epoxy_mu is not a known field"),
    ],
)
def test_a_wrong_board_is_refused_in_one_line(tmp_path, old, new, words):
    path = write(tmp_path)
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(InputError, match=words) as caught:
        load_scene(path)
    lines = str(caught.value).splitlines()
    # The parts in another table are two faults of their own.
    assert len(lines) == (3 if "[electronics]" in new else 1) and all("mine.toml: " in line for line in lines)


def test_a_search_keeps_to_the_boards_own_outline_and_off_its_holes(tmp_path):
    path = write(tmp_path, more="center_mm = [0.5, 0.0]")
    hole = "(gr_rect (start 102 99) (end 103 100.5) (layer Edge.Cuts))\n"
    board = tmp_path / "x.kicad_pcb"
    board.write_text(board.read_text().replace("(gr_rect", hole + "  (gr_rect", 1))
    scene = load_scene(path)
    rules, base = boards.rules(scene), boards.base_board(scene)
    assert base.board.size_mm == (8.0, 9.0) and base.board.center_mm == (0.5, -0.5)
    assert boards.rules(base).outline_mm == rules.outline_mm and min(y for _, y in rules.outline_mm) == -5
    # The hole lies 2 to 3 mm right of the origin and up to 1 mm above it, all moved by 0.5 mm; parts keep 0.3 mm off.
    free = Sites(base, rules).photodiode_places([], {0: Sites(base, rules).place_of(0)}).centers_mm
    near = free[(abs(free[:, 0] - 3.0) < 0.5 + 0.5 + 0.3 - 1e-6) & (abs(free[:, 1] - 0.25) < 0.75 + 0.25 + 0.3 - 1e-6)]
    assert len(free) > 100 and len(near) == 0 and free[:, 0].max() == pytest.approx(4.5 - 0.3 - 0.5, abs=0.25)


def test_fixed_parts_stay_where_they_are_where_the_outline_lies_aside(tmp_path):
    """The middle of the file's outline lies half a millimetre behind its origin."""
    scene = load_scene(write(tmp_path))
    base = boards.base_board(scene)
    assert base.board.center_mm == (0.0, -0.5)
    assert base.layout.leds[0].center_mm == pytest.approx(scene.layout.leds[0].center_mm)
    assert base.layout.photodiode_areas[0].center_mm == pytest.approx((1.0, -1.0))
    assert Sites(base, Placement(fixed=("D1",))).place_of(0) == pytest.approx((-3.0, 1.0))


def test_a_written_board_keeps_the_references_of_its_file(tmp_path):
    path = write(tmp_path)
    path.write_text(
        path.read_text()
        .replace('"led_660"', '"led_660", name = "red"')
        .replace("elements = 1", 'name = "left", elements = 1')
    )
    scene = load_scene(path)
    assert [(p.ref, p.value) for p in result.kicad_parts(scene)] == [("D1", "led_660"), ("PD1", "left")]
    base, computed = boards.base_board(scene), [Rectangle("", u - 0.25, u + 0.25, 1.0, 2.0) for u in (0.0, 1.0, 2.0)]
    best = candidates.searched(base, boards.rules(scene), [(-2.0, 1.0)], computed, wall=None, name="search")
    # The file's one photodiode, at u = 1 mm, goes to the nearest place; names and references of the others are new.
    assert [(one.name, one.reference) for one in best.photodiodes] == [("PD2", None), ("left", "PD1"), ("PD3", None)]
    parts = result.kicad_parts(best)
    sizes = [*(led.size_mm for led in best.leds), *(one.size_mm for one in best.photodiodes)]
    write_board(
        tmp_path / "best.kicad_pcb", parts, sizes, Outline(((-4, -5), (4, -5), (4, 4), (-4, 4)), ()), thickness_mm=0.025
    )
    assert [one.ref for one in read_board(tmp_path / "best.kicad_pcb").footprints] == ["D1", "PD2", "PD1", "PD3"]
    assert light_digest(best) == light_digest(parse_scene(to_toml(best).replace('reference = "D1"\n', "")))

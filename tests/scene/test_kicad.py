"""KiCad boards of versions 5 to 9: parts, outline and origins read; what is written is read back."""

import math
from dataclasses import replace

import pytest

from nailoptics.errors import InputError
from nailoptics.scene.importers.kicad import read_board, write_board
from nailoptics.scene.importers.outlines import Outline, join
from nailoptics.scene.importers.positions import PlacedPart
from nailoptics.scene.rectangles import area_mm2

# An outline of 10 x 8 mm with its corners rounded by 1 mm as KiCad 5 writes it, parts on both sides.
KICAD_5 = """(kicad_pcb (version 20171130) (host pcbnew 5.1.6)
  (layers (0 F.Cu signal) (31 B.Cu signal) (44 Edge.Cuts user))
  (setup (aux_axis_origin 105 104) (visible_elements FFFFFF7F))
  (net 1 "Net-(D1-Pad1)")
  (module LED_SMD:LED_0603 (layer B.Cu) (tedit 5B) (tstamp 5E)
    (at 103 102 30) (descr "an LED; 5' of it") (attr smd)
    (fp_text reference D1 (at 0 -3.5 30) (layer B.SilkS) (effects (font (size 1 1))))
    (fp_text value 660nm (at 0 3 30) (layer B.Fab))
    (pad 1 smd rect (at -0.7 0 30) (size 0.8 0.9) (layers B.Cu B.Paste)))
  (module MountingHole:M2 (layer F.Cu) (at 107 106 90)
    (fp_text reference REF** (at 0 0) (layer F.SilkS))
    (fp_text value 2.2mm (at 0 0) (layer F.Fab))
    (fp_circle (center 1 0) (end 1.5 0) (layer Edge.Cuts) (width 0.05)))
  (gr_line (start 101 100) (end 109 100) (layer Edge.Cuts) (width 0.05))
  (gr_line (start 110 101) (end 110 107) (layer Edge.Cuts) (width 0.05))
  (gr_line (start 109 108) (end 101 108) (layer Edge.Cuts) (width 0.05))
  (gr_line (start 100 107) (end 100 101) (layer Edge.Cuts) (width 0.05))
  (gr_arc (start 101 101) (end 101 100) (angle -90) (layer Edge.Cuts) (width 0.05))
  (gr_arc (start 109 101) (end 110 101) (angle -90) (layer Edge.Cuts) (width 0.05))
  (gr_arc (start 109 107) (end 109 108) (angle -90) (layer Edge.Cuts) (width 0.05))
  (gr_arc (start 101 107) (end 100 107) (angle -90) (layer Edge.Cuts) (width 0.05))
  (gr_line (start 0 0) (end 300 300) (layer Dwgs.User) (width 0.05))
)
"""
H = 1 - math.sqrt(0.5)  # how far the middle of a rounded corner lies inside it
# The same as newer versions write it: footprints with properties, arcs through three points.
KICAD_8 = f"""(kicad_pcb (version 20240108) (generator "pcbnew") (generator_version "8.0")
  (setup (aux_axis_origin 105 104) (grid_origin 100 100))
  (footprint "LED_SMD:LED_0603" (layer "B.Cu") (uuid "a") (at 103 102 30)
    (property "Reference" "D1" (at 0 -3.5 30) (layer "B.SilkS")) (property "Value" "660nm" (at 0 3 30))
    (attr smd))
  (footprint "MountingHole:M2" (layer "F.Cu") (at 107 106 90)
    (property "Reference" "REF**" (at 0 0)) (property "Value" "2.2mm")
    (fp_circle (center 1 0) (end 1.5 0) (stroke (width 0.05) (type solid)) (fill none) (layer "Edge.Cuts")))
  (gr_poly (pts (xy 101 100) (xy 109 100) (arc (start 109 100) (mid {110 - H} {100 + H}) (end 110 101))
    (xy 110 107)) (stroke (width 0.05)) (fill none) (layer "Dwgs.User"))
  (gr_line (start 101 100) (end 109 100) (stroke (width 0.05) (type default)) (layer "Edge.Cuts") (uuid "b"))
  (gr_line (start 110 101) (end 110 107) (layer "Edge.Cuts"))
  (gr_line (start 109 108) (end 101 108) (layer "Edge.Cuts"))
  (gr_line (start 100 107) (end 100 101) (layer "Edge.Cuts"))
  (gr_arc (start 100 101) (mid {100 + H} {100 + H}) (end 101 100) (layer "Edge.Cuts"))
  (gr_arc (start 109 100) (mid {110 - H} {100 + H}) (end 110 101) (layer "Edge.Cuts"))
  (gr_arc (start 110 107) (mid {110 - H} {108 - H}) (end 109 108) (layer "Edge.Cuts"))
  (gr_arc (start 101 108) (mid {100 + H} {108 - H}) (end 100 107) (layer "Edge.Cuts"))
)
"""
# Version 9 has what no older one has: files within the file, and fonts that are or are not.
KICAD_9 = (
    KICAD_8.replace("20240108", "20241229").replace('"8.0"', '"9.0"').rstrip().removesuffix(")")
    + """(embedded_fonts no)
  (embedded_files (file (name "logo.png") (type other) (data |KLUv/WBQAZ0LAFYUQSBQqQFVYgDC/XEkP8WQkE
    aGVsbG8gd29ybGQ+/=|) (checksum "AB12")))
)
"""
)


def board(tmp_path, text):
    (tmp_path / "x.kicad_pcb").write_text(text)
    return read_board(tmp_path / "x.kicad_pcb")


@pytest.mark.parametrize("text", [KICAD_5, KICAD_8, KICAD_9], ids=["5", "8", "9"])
def test_parts_and_outline_are_read_alike_of_every_version(tmp_path, text):
    result = board(tmp_path, text)
    led, hole = result.footprints
    assert replace(led, pads_middle_mm=(0.0, 0.0), body_mm=None) == PlacedPart(
        "D1", "660nm", "LED_SMD:LED_0603", (103.0, -102.0), 30.0, "bottom"
    )
    assert (hole.ref, hole.side) == ("REF**", "top") and result.auxiliary_mm == (105.0, -104.0)
    outline = join(result.edges, "x")
    assert area_mm2(outline.corners_mm) == pytest.approx(80 - (4 - math.pi), abs=0.02)
    (drilled,) = outline.holes_mm
    xs, ys = zip(*drilled, strict=True)
    # The hole lies 1 mm along x of a part turned by 90 degrees against the clock: above it.
    assert ((min(xs) + max(xs)) / 2, (min(ys) + max(ys)) / 2) == pytest.approx((107, -105), abs=1e-3)
    assert area_mm2(drilled) == pytest.approx(math.pi / 4, abs=0.01)


@pytest.mark.parametrize("angle", [0, 30, 90])
def test_pads_keep_their_place_in_a_footprint_that_is_turned(tmp_path, angle):
    """Their angles in the file are those on the board: the second lies across the first."""
    pads = "".join(f"(pad 1 smd rect (at {x} 0 {angle + a}) (size 0.8 0.6))" for x, a in ((-0.7, 0), (0.7, 90)))
    result = board(tmp_path, f'(kicad_pcb (footprint "x" (layer "F.Cu") (at 3 2 {angle}) {pads}))')
    assert result.footprints[0].body_mm == pytest.approx((-1.1, -0.4, 1.0, 0.4))
    assert result.footprints[0].pads_middle_mm == pytest.approx((-0.05, 0.0))


@pytest.mark.parametrize(
    ("shape", "area"),
    [
        ("(gr_rect (start 1 1) (end 4 3) (layer Edge.Cuts))", 6),
        ("(gr_rect (start 0 0) (end 6 4) (radius 1) (layer Edge.Cuts))", 24 - (4 - math.pi)),
        ("(gr_circle (center 1 1) (end 4 5) (layer Edge.Cuts))", math.pi * 25),
        ("(gr_poly (pts (xy 0 0) (xy 4 0) (xy 4 3)) (layer Edge.Cuts))", 6),
        ("(gr_poly (pts (xy 0 0) (arc (start 4 0) (mid 6 2) (end 4 4)) (xy 0 4)) (layer Edge.Cuts))", 16 + math.pi * 2),
        # A cubic arch over a chord of 6, its handles 4 above its ends: 3/5 of 6 * 4.
        (
            "(gr_curve (pts (xy 0 0) (xy 0 4) (xy 6 4) (xy 6 0)) (layer Edge.Cuts))"
            "(gr_line (start 0 0) (end 6 0) (layer Edge.Cuts))",
            14.4,
        ),
    ],
)
def test_every_shape_of_an_outline_is_read(tmp_path, shape, area):
    result = board(tmp_path, f"(kicad_pcb (version 20171130) {shape})")
    assert area_mm2(join(result.edges, "x").corners_mm) == pytest.approx(area, abs=0.06)


def test_a_part_lies_on_the_bottom_whatever_its_copper_is_called(tmp_path):
    # Up to version 5 a user's name of a layer stands at every part.
    named = "(0 Top signal) (1 Inner power) (31 Back mixed) (32 B.Adhes user) (44 Edge.Cuts user)"
    text = KICAD_5.replace("(0 F.Cu signal) (31 B.Cu signal) (44 Edge.Cuts user)", named)
    text = text.replace("(layer B.Cu)", "(layer Back)").replace("(layer F.Cu)", "(layer Top)")
    assert [part.side for part in board(tmp_path, text).footprints] == ["bottom", "top"]
    layers = '(0 "F.Cu" signal) (4 "In1.Cu" signal "Inner") (2 "B.Cu" signal "Back") (31 "F.CrtYd" user "F.Courtyard")'
    text = KICAD_9.replace("(setup", f"(layers {layers}) (setup", 1)
    assert [part.side for part in board(tmp_path, text).footprints] == ["bottom", "top"]


def test_words_stay_as_they_stand(tmp_path):
    text = KICAD_5.replace("value 660nm", "value 1.50").replace("LED_SMD:LED_0603", "0603")
    assert board(tmp_path, text).footprints[0].value == "1.50" and board(tmp_path, text).footprints[0].package == "0603"
    other = '(property "VALUE" "of the user" (at 0 0)) (attr smd)'
    assert board(tmp_path, KICAD_8.replace("(attr smd)", other)).footprints[0].value == "660nm"


def test_of_several_boards_in_a_file_the_one_with_the_parts_is_taken():
    large, small = (((x, 0), (x + w, 0), (x + w, w), (x, w), (x, 0)) for x, w in ((0, 9), (20, 5)))
    assert area_mm2(join([large, small], "x", around=[(22, 2)]).corners_mm) == 25


def test_an_unset_origin_is_none(tmp_path):
    result = board(tmp_path, "(kicad_pcb (version 20171130) (setup (aux_axis_origin 0 0)))")
    assert result.auxiliary_mm is None and result.grid_mm is None


def test_a_written_layout_is_read_back(tmp_path):
    parts = (
        PlacedPart("D1", 'IR "800"\nof 2', "LED_die", (-1.25, 0.5), 123.456789, "bottom"),
        PlacedPart("PD1", "a", "PD", (0.3, -2.0), 0.0, "bottom"),
    )
    outline = Outline(((-4.0, -5.0), (4.0, -5.0), (4.0, 5.0)), (((2.0, -3.0), (3.0, -3.0), (3.0, -2.0)),))
    write_board(tmp_path / "best.kicad_pcb", parts, [(0.25, 0.25), (1.0, 0.25)], outline, thickness_mm=0.025)
    result = read_board(tmp_path / "best.kicad_pcb")
    ox, oy = result.auxiliary_mm
    moved = [(p.ref, p.value, p.rotation_deg, p.side) for p in result.footprints]
    assert moved == [(p.ref, p.value, p.rotation_deg, p.side) for p in parts]
    places = [(p.position_mm[0] - ox, p.position_mm[1] - oy) for p in result.footprints]
    assert places == [pytest.approx(p.position_mm) for p in parts]
    again = join(result.edges, "x")
    lines = [[(round(x - ox, 6), round(y - oy, 6)) for x, y in one] for one in (again.corners_mm, *again.holes_mm)]
    assert sorted(map(sorted, lines)) == sorted(map(sorted, (outline.corners_mm, *outline.holes_mm)))
    first = (tmp_path / "best.kicad_pcb").read_text()
    write_board(tmp_path / "best.kicad_pcb", parts, [(0.25, 0.25), (1.0, 0.25)], outline, thickness_mm=0.025)
    assert (tmp_path / "best.kicad_pcb").read_text() == first


@pytest.mark.parametrize(
    "text",
    [
        "",
        "(kicad_pcb",
        "(kicad_sch (version 1))",
        "PCBNEW-BOARD Version 1",
        KICAD_5[:700],
        "(" * 5000,
        "(kicad_pcb (module a (layer F.Cu)))",
        "(kicad_pcb (gr_line (start 1) (end 2 3) (layer Edge.Cuts)))",
    ],
)
def test_what_is_no_board_is_refused_in_one_line(tmp_path, text):
    with pytest.raises(InputError, match="x.kicad_pcb: is no KiCad board") as caught:
        board(tmp_path, text)
    assert len(str(caught.value).splitlines()) == 1

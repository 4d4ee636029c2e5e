"""A layout in its designer's board: its parts moved, all else byte for byte; without one, a new board with pads."""

import re
from dataclasses import replace

import pytest
from small_scenes import ON_KICAD_BOARD

import nailoptics as nail
from nailoptics.errors import InputError
from nailoptics.exports import kicad_board
from nailoptics.scene import load_scene, parse_scene, to_toml
from nailoptics.scene.importers.kicad import _parsed, read_board
from nailoptics.studies.placement import boards

BOARD = """(kicad_pcb (version 20240108)
  (setup (aux_axis_origin 100 100))
  (footprint "LED_0603" (layer "{side}") (at 97 99 90)
    (property "Reference" "D1" (at 0 0 180)) (property "Value" "x")
    (pad "1" smd rect (at -0.5 0 90) (size 0.2 0.2)) (pad "2" smd rect (at 2.5 0 90) (size 0.2 0.2)){held})
  (footprint "SFH" (layer "{side}") (at 101 101 30) (property "Reference" "PD1"))
  (footprint "M" (layer "{side}") (at 101 97 10) (property "Reference" "U1"))
  (segment (start 97 99) (end 101 101) (width 0.2) (layer "B.Cu") (net 1))
  (gr_rect (start 96 95) (end 104 105) (layer "Edge.Cuts"))
)
"""


def written(tmp_path, *, side="B.Cu", turn=0.0, held="", more=""):
    (tmp_path / "x.kicad_pcb").write_text(BOARD.format(side=side, held=held))
    (tmp_path / "mine.toml").write_text(
        ON_KICAD_BOARD.format(
            board=f"center_mm = [0.25, 0.5]\nturn_deg = {turn}", diode=", offset_mm = [0.3, 0.1]", parts=more
        )
    )
    return load_scene(tmp_path / "mine.toml")


def moved(scene, *, by=(0.6, -0.35), turned=20.0):
    """The scene with each part elsewhere."""

    def one(part):
        place = tuple(a + b for a, b in zip(part.position_mm, by, strict=True))
        return part.model_copy(update={"position_mm": place, "rotation_deg": part.rotation_deg + turned})

    parts = {kind: tuple(map(one, getattr(scene, kind))) for kind in ("leds", "photodiodes")}
    return scene.model_copy(update=parts)


@pytest.mark.parametrize(("side", "turn"), [("B.Cu", 0.0), ("B.Cu", 90.0), ("F.Cu", 0.0), ("F.Cu", -15.0)])
def test_a_layout_on_its_own_board_is_read_again_where_it_was(tmp_path, side, turn):
    """Pads aside of the anchor, a die aside of its footprint, either side, any turn, another middle of the board."""
    scene = written(tmp_path, side=side, turn=turn)
    before = (tmp_path / "x.kicad_pcb").read_text()
    nail.export(scene, tmp_path / "same.kicad_pcb", folder=tmp_path)
    assert (tmp_path / "same.kicad_pcb").read_text() == before
    layout = moved(boards.base_board(scene))
    (tmp_path / "layout.toml").write_text(to_toml(layout))
    nail.export(load_scene(tmp_path / "layout.toml"), tmp_path / "x.kicad_pcb", folder=tmp_path)
    after = (tmp_path / "x.kicad_pcb").read_text()
    assert [a for a, b in zip(before.splitlines(), after.splitlines(), strict=True) if a != b] == [
        line
        for line in before.splitlines()
        if "LED_0603" in line or "(at 0 0" in line or "SFH" in line or "pad" in line
    ]
    again = load_scene(tmp_path / "mine.toml")
    for was, now in zip((*layout.leds, *layout.photodiodes), (*again.leds, *again.photodiodes), strict=True):
        shift = zip(now.position_mm, again.board.center_mm, was.position_mm, layout.board.center_mm, strict=True)
        assert [a + b - c - d for a, b, c, d in shift] == pytest.approx([0, 0], abs=2e-6)
        assert (now.rotation_deg - was.rotation_deg + 180) % 360 - 180 == pytest.approx(0, abs=1e-6)


def test_a_further_part_is_added_and_a_missing_one_stays_and_is_reported(tmp_path, caplog):
    scene = written(tmp_path)
    old, (u, v) = scene.photodiodes[0], scene.photodiodes[0].position_mm
    new = tuple(
        old.model_copy(update={"name": name, "reference": None, "position_mm": (u, v + k)})
        for k, name in enumerate(("PD1", "other"))
    )
    named, text = kicad_board.own_board(scene.model_copy(update={"photodiodes": new}), tmp_path)
    (tmp_path / "y.kicad_pcb").write_text(text)
    assert [pd.reference for pd in named.photodiodes] == ["PD2", "other"] and len(named.layout.photodiodes) == 2
    # The new board with the new references is itself a board to move parts on.
    again = named.model_copy(update={"board": named.board.model_copy(update={"kicad": "y.kicad_pcb"})})
    assert kicad_board.own_board(parse_scene(to_toml(again)), tmp_path)[1] == text
    assert "PD1 has no place in this layout, and stays where it is" in caplog.text
    before, after = ({p.ref: p for p in read_board(tmp_path / f"{n}.kicad_pcb").footprints} for n in "xy")
    assert {*after} == {*before, "PD2", "other"} and {ref: after[ref] for ref in before} == before
    assert after["PD2"].side == "bottom" and after["PD2"].pads_middle_mm == (0.0, 0.0)


# What KiCad 5.1 reads within a part and what is in it (parseMODULE and what it calls); at anything else it stops.
IN_KICAD_5 = {
    "module": "locked placed layer tedit tstamp at descr tags path attr fp_text fp_line fp_circle fp_arc pad model",
    "fp_text": "at layer hide effects",
    "fp_line": "start end layer width tstamp status",
    "pad": "at size drill layers net",
    "effects": "font justify hide",
    "font": "size thickness bold italic",
}


def of_no_old_kicad(item):
    """What of a part KiCad 5 does not read, and of its identifiers those that are no 8 hexadecimal digits."""
    for inner in (one for one in item if isinstance(one, list)):
        if inner[0] not in IN_KICAD_5.get(item[0], inner[0]).split():
            yield f"{item[0]} {inner[0]}"
        elif inner[0] == "tstamp" and not re.fullmatch("[0-9a-fA-F]{8}", inner[1]):
            yield f"tstamp {inner[1]}"
        yield from of_no_old_kicad(inner)


@pytest.mark.parametrize(
    ("version", "kind"), [(4, "module"), (20171130, "module"), (20211014, "footprint"), (20240108, "footprint")]
)
def test_a_further_part_is_written_as_the_boards_own_kicad_has_parts(tmp_path, version, kind):
    """Expected: of KiCad 4 and 5 modules without anything unsupported there, elsewhere footprints; all read alike."""
    scene, old = written(tmp_path), version < 20201115
    text = BOARD.format(side="B.Cu", held="").replace("20240108", str(version))
    if old:
        text = text.replace("(footprint ", "(module ")
        text = re.sub(r'\(property "(Reference|Value)"', lambda word: f"(fp_text {word[1].lower()}", text)
    (tmp_path / "x.kicad_pcb").write_text(text)
    one, (u, v) = scene.photodiodes[0], scene.photodiodes[0].position_mm
    boxes = {"body_mm": (-0.7, -0.4, 0.7, 0.4), "courtyard_mm": (-0.9, -0.6, 0.9, 0.6)}
    new = one.model_copy(update={"name": "new", "reference": None, "position_mm": (u, v + 2)} | boxes)
    (tmp_path / "y.toml").write_text(to_toml(scene.model_copy(update={"photodiodes": (one, new)})))
    nail.export(load_scene(tmp_path / "y.toml"), tmp_path / "y.kicad_pcb", folder=tmp_path)
    *kept, added = [
        item for item in _parsed((tmp_path / "y.kicad_pcb").read_text()) if item[0] in ("module", "footprint")
    ]
    assert [item[0] for item in (*kept, added)] == [kind] * 4 and added[1].startswith("nailoptics:PD_")
    assert not old or [*of_no_old_kicad(added)] == []
    part = next(part for part in read_board(tmp_path / "y.kicad_pcb").footprints if part.ref == "new")
    assert (part.side, part.body_mm, part.courtyard_mm) == ("bottom", *(pytest.approx(box) for box in boxes.values()))
    x, y = next(part.position_mm for part in read_board(tmp_path / "x.kicad_pcb").footprints if part.ref == "PD1")
    assert part.position_mm[1] - y == pytest.approx(2.0, abs=0.5) and abs(part.position_mm[0] - x) < 0.5


@pytest.mark.parametrize(("pitch_mm", "length_mm"), [(None, 4.0), (1.5, 5.5)])
def test_a_new_array_is_drawn_as_long_as_its_row_of_elements(tmp_path, pitch_mm, length_mm):
    """Expected: four elements of 1 mm, side by side without a pitch."""
    scene = written(tmp_path)
    own = {"name": "row", "reference": None, "elements": 4, "size_mm": (0.5, 1.0), "pitch_mm": pitch_mm}
    row = scene.photodiodes[0].model_copy(update=own | {"body_mm": None, "courtyard_mm": None})
    text = kicad_board.own_board(scene.model_copy(update={"photodiodes": (row,)}), tmp_path)[1]
    assert f"PD_0.5x{length_mm:g}mm" in text
    (tmp_path / "y.kicad_pcb").write_text(text)
    low_u, low_v, high_u, high_v = next(
        p.body_mm for p in read_board(tmp_path / "y.kicad_pcb").footprints if p.ref == "row"
    )
    assert sorted((high_u - low_u, high_v - low_v)) == pytest.approx([0.5, length_mm])


def test_what_cannot_move_is_refused_in_one_line(tmp_path):
    scene = moved(written(tmp_path, held=' (zone (net 0) (layer "B.Cu"))'))
    with pytest.raises(InputError, match="D1 has a zone in its footprint, which does not move with it") as caught:
        nail.export(scene, tmp_path / "y.kicad_pcb", folder=tmp_path)
    assert len(str(caught.value).splitlines()) == 1
    scene = written(tmp_path, more='U1 = { module = "max30101" }')
    nail.export(moved(scene, turned=0.0), tmp_path / "y.kicad_pcb", folder=tmp_path)
    die = scene.leds[-1]
    assert die.reference.startswith("U1.")
    leds = (*scene.leds[:-1], die.model_copy(update={"position_mm": (die.position_mm[0] + 0.1, die.position_mm[1])}))
    with pytest.raises(InputError, match="U1 is one footprint, whose dies cannot move by themselves"):
        nail.export(scene.model_copy(update={"leds": leds}), tmp_path / "y.kicad_pcb", folder=tmp_path)
    with pytest.raises(InputError, match=r"x\.kicad_pcb: cannot be read"):
        nail.export(scene, tmp_path / "y.kicad_pcb", folder=tmp_path / "elsewhere")


def test_without_a_board_of_its_own_each_die_has_two_pads(tmp_path):
    scene = written(tmp_path)
    plain = scene.model_copy(update={"board": scene.board.model_copy(update={"kicad": None})})
    nail.export(plain, tmp_path / "new.kicad_pcb")
    text = (tmp_path / "new.kicad_pcb").read_text()
    result = read_board(tmp_path / "new.kicad_pcb")
    assert text.count('(pad "1" smd rect') == text.count('(pad "2" smd rect') == 2 == len(result.footprints)
    assert {replace(part, package="").pads_middle_mm for part in result.footprints} == {(0.0, 0.0)}
    assert '(pad "1" smd rect (at -0.3 0 30) (size 0.4 0.5)' in text

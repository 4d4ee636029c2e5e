"""The rules of a search: candidates and outline come from the files beside the scene."""

import json

import pytest
from small_scenes import finger

from nailoptics.cli import run
from nailoptics.errors import InputError
from nailoptics.scene import load_scene
from nailoptics.scene.importers.kicad import write_board
from nailoptics.scene.importers.outlines import Outline, write_outline

# As `kicad-cli pcb export pos --format csv --units mm --side both` writes it.
POSITIONS = """Ref,Val,Package,PosX,PosY,Rot,Side
"D1","IR800","LED_die",-2.500000,0.250000,0.000000,bottom
"LED2","IR940","LED_die",2.500000,0.250000,90.000000,top
"PD1","element","PD_1x0.25mm",0.500000,-1.500000,0.000000,bottom
"""
SQUARE = [(-4.0, -5.0), (4.0, -5.0), (4.0, 5.0), (-4.0, 5.0)]


def test_a_scene_takes_candidates_and_outline_from_the_files_beside_it(tmp_path):
    (tmp_path / "pos.csv").write_text(POSITIONS.replace('"LED2"', '"PD2"'))
    write_board(tmp_path / "board.kicad_pcb", [], [], Outline(tuple(SQUARE)), thickness_mm=0.025)
    (tmp_path / "scene.toml").write_text(f"""{THUMB}
[placement]
outline = "board.kicad_pcb"
[[placement.candidates]]
name = "mine"
positions = "pos.csv"
negate_x_on_bottom = true
""")
    placement = load_scene(tmp_path / "scene.toml").placement
    assert placement.candidates[0].leds_mm == ((2.5, 0.25),)
    assert placement.candidates[0].photodiodes_mm == ((2.5, 0.25), (-0.5, -1.5))
    assert [x for corner in placement.outline_mm for x in corner] == pytest.approx([x for c in SQUARE for x in c])


# A board of 8 x 10 mm on the page of a layout program, with a hole of 1 mm.
PAGE = Outline(tuple((x + 100, y - 90) for x, y in SQUARE), (((100, -90), (101, -90), (101, -89), (100, -89)),))
THUMB = finger(
    {"name": "pd", "position_mm": [2.0, 0.0]}, leds=({"position_mm": [-2.0, 0.0]},), finger={"digit": "thumb"}
)
ON_PAGE = THUMB + '[placement]\noutline = "board.kicad_pcb"\n'


@pytest.mark.parametrize("origin", ['"middle"', "[100.0, -90.0]"])
def test_the_scene_sets_an_outlines_origin(tmp_path, origin):
    write_board(tmp_path / "board.kicad_pcb", [], [], PAGE, thickness_mm=0.025)
    (tmp_path / "scene.toml").write_text(f"{ON_PAGE}outline_origin = {origin}")
    placement = load_scene(tmp_path / "scene.toml").placement
    flat = [x for corner in placement.outline_mm for x in corner]
    assert flat == pytest.approx([x for corner in SQUARE for x in corner], abs=1e-6)
    assert placement.outline_holes_mm[0][0] == pytest.approx((0, 0), abs=1e-6)


def test_the_scene_sets_the_unit_of_a_drawing_without_one(tmp_path):
    write_outline(tmp_path / "board.dxf", PAGE)
    drawing = (tmp_path / "board.dxf").read_text()
    assert "$INSUNITS\n 70\n4" in drawing
    (tmp_path / "board.dxf").write_text(drawing.replace("$INSUNITS\n 70\n4", "$INSUNITS\n 70\n0"))
    text = ON_PAGE.replace("board.kicad_pcb", "board.dxf") + 'outline_origin = "middle"\noutline_unit = "inch"'
    (tmp_path / "scene.toml").write_text(text)
    flat = [x for corner in load_scene(tmp_path / "scene.toml").placement.outline_mm for x in corner]
    assert flat == pytest.approx([25.4 * x for corner in SQUARE for x in corner], abs=1e-6)


@pytest.mark.long
def test_check_refuses_an_outline_beside_the_nail_as_place_does(tmp_path, capsys, shared_light):
    write_board(tmp_path / "board.kicad_pcb", [], [], PAGE, thickness_mm=0.025)
    (tmp_path / "scene.toml").write_text(ON_PAGE)
    assert run(["check", str(tmp_path / "scene.toml")]) == 2
    message = capsys.readouterr().err
    assert "placement.outline: it is 8 x 10 mm around (100, -90)" in message and len(message.splitlines()) == 1
    # One that reaches beyond the nail ends there.
    write_board(
        tmp_path / "board.kicad_pcb", [], [], Outline(tuple((3 * x, 3 * y) for x, y in SQUARE)), thickness_mm=0.025
    )
    assert run(["check", str(tmp_path / "scene.toml"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["valid"]
    (tmp_path / "scene.toml").write_text(ON_PAGE + 'outline_origin = "corner"')
    with pytest.raises(InputError, match="outline_origin"):
        load_scene(tmp_path / "scene.toml")

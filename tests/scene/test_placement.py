"""The rules of a search: candidates and outline come from the files beside the scene."""

from nailoptics.scene import load_scene
from nailoptics.scene.outlines import Outline, write_outline

# As `kicad-cli pcb export pos --format csv --units mm --side both` writes it.
POSITIONS = """Ref,Val,Package,PosX,PosY,Rot,Side
"D1","IR800","LED_die",-2.500000,0.250000,0.000000,bottom
"LED2","IR940","LED_die",2.500000,0.250000,90.000000,top
"PD1","element","PD_1x0.25mm",0.500000,-1.500000,0.000000,bottom
"""
SQUARE = [(-4.0, -5.0), (4.0, -5.0), (4.0, 5.0), (-4.0, 5.0)]


def test_a_scene_takes_candidates_and_outline_from_the_files_beside_it(tmp_path):
    (tmp_path / "pos.csv").write_text(POSITIONS.replace('"LED2"', '"PD2"'))
    write_outline(tmp_path / "board.dxf", Outline(tuple(SQUARE)))
    (tmp_path / "scene.toml").write_text("""
schema_version = 1
[finger]
[[leds]]
name = "ir"
part = "led_800"
[[photodiodes]]
name = "pd"
position_mm = [2.0, 0.0]
[placement]
outline = "board.dxf"
[[placement.candidates]]
name = "mine"
positions = "pos.csv"
negate_x_on_bottom = true
""")
    placement = load_scene(tmp_path / "scene.toml").placement
    assert placement.candidates[0].leds_mm == ((2.5, 0.25),)
    assert placement.candidates[0].photodiodes_mm == ((2.5, 0.25), (-0.5, -1.5))
    assert list(placement.outline_mm) == SQUARE

"""Position files: read, written back the same, and refused in one line where they are wrong."""

import pytest

from nailoptics.errors import InputError
from nailoptics.scene.positions import PlacedPart, read_positions, write_positions

# As `kicad-cli pcb export pos --format csv --units mm --side both` writes it.
POSITIONS = """Ref,Val,Package,PosX,PosY,Rot,Side
"D1","IR800","LED_die",-2.500000,0.250000,0.000000,bottom
"LED2","IR940","LED_die",2.500000,0.250000,90.000000,top
"PD1","element","PD_1x0.25mm",0.500000,-1.500000,0.000000,bottom
"""


def test_positions_of_both_sides_are_read_in_order(tmp_path):
    path = tmp_path / "pos.csv"
    path.write_text(POSITIONS)
    parts = read_positions(path)
    assert [(p.ref, p.position_mm, p.side) for p in parts] == [
        ("D1", (-2.5, 0.25), "bottom"),
        ("LED2", (2.5, 0.25), "top"),
        ("PD1", (0.5, -1.5), "bottom"),
    ]
    assert [p.is_led for p in parts] == [True, True, False] and parts[1].rotation_deg == 90


def test_negated_x_counts_on_the_bottom_alone(tmp_path):
    path = tmp_path / "pos.csv"
    path.write_text(POSITIONS)
    assert [p.position_mm[0] for p in read_positions(path, negate_x_on_bottom=True)] == [2.5, 2.5, -0.5]


@pytest.mark.parametrize("negated", [False, True])
def test_what_is_written_is_read_back(tmp_path, negated):
    parts = (
        PlacedPart("D1", "led_800", "LED_die", (-1.25, 0.5), 0.0, "bottom"),
        PlacedPart("PD1", "a, b", "PD", (0.3, -2.0), 90.0, "top"),
    )
    write_positions(tmp_path / "pos.csv", parts, negate_x_on_bottom=negated)
    assert read_positions(tmp_path / "pos.csv", negate_x_on_bottom=negated) == parts


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "missing"),
        ("Ref,Val\n", "missing"),
        (POSITIONS.replace("-2.500000", "left"), "line 2: PosX"),
        (POSITIONS.replace(",top", ",edge"), "Side"),
        (POSITIONS.replace('"LED2"', '"D1"'), "twice"),
        (POSITIONS.splitlines()[0], "no part"),
    ],
)
def test_a_wrong_position_file_is_refused_in_one_line(tmp_path, text, words):
    path = tmp_path / "pos.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=words) as caught:
        read_positions(path)
    assert len(str(caught.value).splitlines()) == 1 and "pos.csv" in str(caught.value)

"""The designer's notebook and the edits of the library's page, as they stand there."""

import re
from pathlib import Path

import pytest

import nailoptics as nail
from nailoptics.studies.placement import place

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "library.md").read_text(encoding="utf-8")
# A layout in place of a search for one, and no traces of other fingers.
GIVEN = (
    'placement={"search": False, "candidates": [{"name": "near", "leds_mm": [(-2, 1)], "photodiodes_mm": '
    '[(0.5, -1), (0.5, 1)]}]}, priors={"own_traces": False}'
)
EDITS = re.findall(r"^\| [^|]+ \| `(scene\.with.*)` \|$", PAGE, re.M)


def block(text: str, begins: str) -> str:
    """The code block whose first line after its language is this one."""
    result = re.search(rf"^```\{{code-(?:block|cell)\}} \w+\n{begins}\n(.*?)^```$", text, re.M | re.S)
    assert result
    return result[1]


@pytest.mark.parametrize("edit", EDITS)
def test_each_edit_is_one_call(edit):
    scene = nail.load_scene("prototype")
    assert eval(edit, {"scene": scene}) != scene


def test_the_ten_most_common_edits_are_there():
    assert len(EDITS) >= 10


@pytest.mark.long
@pytest.mark.jit
@pytest.mark.filterwarnings("ignore")
def test_the_designers_notebook_runs(jit_backend, fewer_photons, untraced_tolerances, tmp_path, monkeypatch):
    """Rationale: what a newcomer copies first. Expected: it runs as it stands, here with a few photons in place of a
    minute of them and, in place of a search, which the page on KiCad makes, the board as moved; and leaves the board of
    the best layout, which is read again."""
    code = block(PAGE, ":name: designer")
    assert len([line for line in code.splitlines() if line]) <= 15
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(place, "BLOCKS", 8)
    board = block((DOCS / "tutorials/kicad.md").read_text(encoding="utf-8"), "%%writefile sensor.kicad_pcb")
    Path("sensor.kicad_pcb").write_text(board, encoding="utf-8")
    made: dict = {}
    quick = re.sub(r"(?:relative_error|photons)=[\d._]+", f'photons=3000, backend="{jit_backend.name}"', code)
    with fewer_photons():
        exec(quick.replace('placement={"photodiodes": 2}', GIVEN), made)
    assert made["touch"].volts.sizes["photodiode"] == 2 and made["moved"].leds[0].position_mm == (-2.0, 0.5)
    again = nail.Scene.from_kicad("best.kicad_pcb", made["parts"])
    for one, other in zip(again.layout.leds, made["best"].layout.leds, strict=True):
        assert one.center_mm == pytest.approx(other.center_mm, abs=1e-3)

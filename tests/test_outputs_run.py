"""What one command writes runs in every command that reads its kind: layouts of place, boards and drawings of them."""

from pathlib import Path

import pytest

import nailoptics as nail
from nailoptics.assets import data_dir
from nailoptics.cli import run
from nailoptics.errors import as_far_as_reached
from nailoptics.exports.formats import WRITERS
from nailoptics.report.pages.placement import PLACEMENT
from nailoptics.scene import Candidate, Scene, Touch, load_scene, parse_scene, to_toml
from nailoptics.scene.importers.board_files import read_outline
from nailoptics.scene.importers.kicad import read_board
from nailoptics.scene.importers.positions import read_positions
from nailoptics.studies.placement import place
from nailoptics.studies.scene_check import check
from nailoptics.studies.simulate import simulate

SCENES = {path.stem: load_scene(path) for path in sorted(data_dir("scenes").glob("*.toml"))}
FINGERS = [name for name, scene in SCENES.items() if scene.finger is not None and len(scene.zone_edges_mm) == 1]
ZONED = [name for name, scene in SCENES.items() if len(scene.zone_edges_mm) > 1]

# A layout for the shipped placement on one finger, which saves the search and most tolerances.
IN_A_ROW = Candidate(name="row", leds_mm=((-2.0, 0.0),), photodiodes_mm=((1.0, -3.5), (1.0, -2.0), (1.0, 3.0)))


def is_read(scene: Scene) -> None:
    check(scene)
    scene = scene.model_copy(update={"priors": scene.priors.model_copy(update={"spread": False})})
    assert simulate(scene, photons=2000, seed=1).detected_fraction.notnull().all()


@pytest.mark.jit
@pytest.mark.filterwarnings("ignore:LED .* effective photons")  # of a scene whose light is as rough as it may be
@pytest.mark.parametrize(
    ("name", "search"),
    [
        pytest.param("placement", False, marks=pytest.mark.long),
        *[pytest.param(one, True, marks=pytest.mark.slow) for one in FINGERS],
    ],
)
def test_every_file_of_place_is_read(
    jit_backend,
    coarse_cells,
    store,
    fewer_photons,
    few_photons_beside,
    untraced_tolerances,
    undrawn,
    monkeypatch,
    tmp_path: Path,
    name: str,
    search: bool,
):
    """Few photons rank layouts badly, and are enough to write them."""
    monkeypatch.setattr(place, "BLOCKS", 8)
    scene = SCENES[name].with_(**{"priors.own_traces": False})
    if not search:
        given = {"search": False, "candidates": (IN_A_ROW,), "fingers": ()}
        scene = scene.model_copy(update={"placement": scene.placement.model_copy(update=given)})
    with fewer_photons():
        result, _ = as_far_as_reached(nail.place, scene, photons=2000, seed=1)
    PLACEMENT.write(result, tmp_path)
    best = load_scene(tmp_path / "best.toml")
    is_read(best)
    assert parse_scene(to_toml(best)) == best
    for name in ("glb", "kicad_pcb", "mitsuba", "mmc"):
        path = tmp_path / (f"export.{name}" if WRITERS[name][2] else name)
        assert all(file.exists() for file in nail.export(best, path, format=name).values())
    outline = read_outline(tmp_path / "best.kicad_pcb")
    assert len(outline.corners_mm) >= 4
    one = best.layout.photodiodes[0].photodiode
    size = f"size_mm = [{one.size_mm[0]}, {one.size_mm[1]}]"
    for key, file in (("kicad", "best.kicad_pcb"), ("positions", "best.csv")):
        placed = read_positions(tmp_path / file) if key == "positions" else read_board(tmp_path / file).footprints
        uses = [f"parts.{p.ref} = {{ photodiode = true, {size} }}" for p in placed[len(best.leds) :]]
        uses += [f"parts.{p.ref} = {{ led = true, wavelength_nm = 800.0 }}" for p in placed[: len(best.leds)]]
        digit = f'digit = "{best.finger.digit}"'
        text = "\n".join(
            ["schema_version = 1", "[finger]", digit, "[board]", f'{key} = "{file}"', "barrier = false", *uses]
        )
        again = parse_scene(text, folder=tmp_path)
        check(again)
        assert len(again.layout.photodiodes) == len(best.layout.photodiodes)


@pytest.mark.jit
@pytest.mark.slow
def test_the_best_layout_is_recorded_calibrated_predicted_and_explored(jit_backend, tmp_path: Path, capfd):
    """On a board as large as the nail, whose body moves it, with resistors that place fitted."""
    scene = SCENES["placement"]
    rules = scene.placement.model_copy(update={"led_step_mm": 5.0, "photodiodes": 3, "fingers": ()})
    update = {"placement": rules, "priors": scene.priors.model_copy(update={"spread": False})}
    try:
        result = nail.place(scene.model_copy(update=update), photons=2000, seed=1)
    except nail.NotReachedError as short:
        result = short.result
    PLACEMENT.write(result, tmp_path)
    best, few = str(tmp_path / "best.toml"), ["--photons", "20000", "--seed", "1"]
    assert all(photodiode.feedback_ohm for photodiode in load_scene(best).photodiodes)
    recorded, recording, subject, page = (
        str(tmp_path / name) for name in ("recorded.toml", "recording.csv", "me.toml", "explore.html")
    )
    assert run(["check", best]) == 0
    # A calibration takes touches of both sides, with rests between.
    touch = Touch.model_validate({"profile": "protocol", "sample_rate_hz": 12.5})
    Path(recorded).write_text(to_toml(load_scene(best).model_copy(update={"touch": touch})))
    assert run(["simulate", recorded, "-o", str(tmp_path / "run"), "--recording", recording, *few]) == 0
    # So few photons do not resolve the dimmest photodiode, in words.
    assert run(["calibrate", recorded, recording, "-o", subject, "--photons", "3000", "--seed", "1"]) == 2
    assert "trace more photons" in capfd.readouterr().err
    few[1] = "400000"
    assert run(["calibrate", recorded, recording, "-o", subject, *few]) == 0
    assert run(["predict", subject, recording, "-o", str(tmp_path / "force")]) == 0
    assert run(["explore", best, "-o", page, "--photons", "50000"]) == 0


@pytest.mark.parametrize("name", ZONED)
def test_place_refuses_more_than_two_blood_zones(name: str):
    with pytest.raises(nail.InputError, match="two blood zones"):
        nail.place(SCENES[name], photons=2000, seed=1)

"""What functions take as a scene, and as files: anything else is one line in the user's words, before any trace."""

import inspect

import pytest

import nailoptics as nail
from nailoptics.options import TraceOptions

PUBLIC = {name: getattr(nail, name) for name in nail.__all__ if inspect.isfunction(getattr(nail, name))}
OF_SCENE = [name for name, call in PUBLIC.items() if "scene" in inspect.signature(call).parameters]
MORE = {"sweep": [{"blood.so2": [0.9]}], "export": ["finger.glb"], "calibrate": [[]]}


@pytest.mark.parametrize("name", OF_SCENE)
@pytest.mark.parametrize("given", [None, "prototyp", 5])
def test_what_is_no_scene_is_an_input_error(name, given):
    with pytest.raises(nail.InputError, match="give a Scene, or the path or name of one|there is no such file"):
        PUBLIC[name](given, *MORE.get(name, []))


def test_a_name_stands_for_its_scene(tmp_path):
    scene = nail.load_scene("prototype")
    assert nail.to_toml("prototype") == nail.to_toml(scene) and len(OF_SCENE) > 10
    nail.export("prototype", tmp_path / "a.kicad_pcb")
    nail.export(scene, tmp_path / "b.kicad_pcb")
    assert (tmp_path / "a.kicad_pcb").read_bytes() == (tmp_path / "b.kicad_pcb").read_bytes()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda s: nail.load_scene(5), "^scene = 5: give a Scene"),
        (lambda s: nail.parse_scene({"leds": []}), "is not text; give TOML"),
        (lambda s: nail.load_subject(None), "None.*: is not a path; give a subject file"),
        (lambda s: nail.export(s, 5), "path = 5: is not a path"),
        (lambda s: nail.export(s, "finger.glb", photons=10), "photons belongs to the format spice, not to glb"),
        (lambda s: nail.export(s, "board.cir", photons=-1), "photons = -1"),
        (lambda s: nail.calibrate(s, "known.csv"), "^known.csv: cannot be read"),
        (lambda s: nail.calibrate(s, [5]), "5.*: is not a path; give a recording"),
        (lambda s: nail.open_results("nothing.nc"), "nothing.nc: is not a batch folder .no such file or folder"),
    ],
)
def test_files_that_are_none_are_an_input_error(call, message):
    with pytest.raises(nail.InputError, match=message):
        call(nail.load_scene("prototype"))


def test_photons_may_be_a_whole_float():
    options = TraceOptions(photons=1e6)
    assert options.photons == 1_000_000 and isinstance(options.photons, int)
    with pytest.raises(nail.InputError, match=r"photons = 2\.5; must be a whole number"):
        TraceOptions(photons=2.5)

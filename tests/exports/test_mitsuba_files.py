"""Plain Mitsuba renders an exported finger without this package, and reads what our engines read."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

import nailoptics
from nailoptics.assets import data_dir
from nailoptics.exports.compatibility import as_seen
from nailoptics.geometry import build
from nailoptics.light import backend, optics
from nailoptics.light.reference.mitsuba_scene import finger_scene
from nailoptics.light.reference.readings import stock_mitsuba
from nailoptics.scene import load_scene

# What the README of an export states, and where the pixels go.
PLAIN = """
import json, sys
import mitsuba as mi, numpy as np
mi.set_variant("scalar_rgb")
scene = mi.load_file(sys.argv[1], optimize=False, **json.loads(sys.argv[3]))
image = np.array(mi.render(scene, spp=int(sys.argv[2]), seed=1), float)
assert not any(name.split(".")[0] == "nailoptics" for name in sys.modules)
np.save(sys.argv[4], image)
"""


@pytest.fixture(scope="module")
def scene():
    return load_scene(data_dir("scenes") / "prototype.toml")


@pytest.fixture(scope="module")
def folder(scene, tmp_path_factory):
    where = tmp_path_factory.mktemp("exports") / "a finger & <été>"
    nailoptics.export(scene, where, format="mitsuba")
    return where


def render(folder, tmp_path, *, spp: int, **photodiodes: str) -> np.ndarray:
    """The picture that plain Mitsuba renders of the first LED's scene, in another process and folder."""
    (path,) = folder.glob("1_*.xml")
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    command = [sys.executable, "-c", PLAIN, str(path), str(spp), json.dumps(photodiodes), str(tmp_path / "image.npy")]
    subprocess.run(command, env=environment, cwd=tmp_path, check=True, timeout=500)
    return np.load(tmp_path / "image.npy")


def test_plain_mitsuba_renders_the_very_scene_of_our_engine(scene, folder, tmp_path):
    """Pixel by pixel the same bits, so that nothing is lost on the way through files."""
    exported = as_seen(scene, reflecting=True)
    geometry = build(exported)
    colours = {face.region: [float(k % 3 == c) for c in range(3)] for k, face in enumerate(geometry.photodiodes)}
    media = optics.finger_media(exported, geometry.regions, exported.leds[0].wavelength_nm)
    with stock_mitsuba(backend.choose("scalar", volpath=True)) as mi:
        led = geometry.leds[0].region
        made = finger_scene(None, geometry, media, None, sensor=led, emitters=colours, folder=tmp_path)
        ours = np.array(mi.render(mi.load_dict(made, optimize=False), spp=8, seed=1), float)
    each = {f"photodiode_{k + 1}": ",".join(map(str, c)) for k, c in enumerate(colours.values())}
    theirs = render(folder, tmp_path, spp=8, **each)
    assert (theirs == ours).all()
    assert np.count_nonzero(theirs) > 3


def test_a_scene_stands_on_its_own(scene, folder):
    text = "".join(path.read_text(encoding="utf-8") for path in folder.glob("*.xml"))
    assert str(folder) not in text and str(folder.parent) not in text
    assert text.count("<default") == len(scene.layout.photodiode_names) == 8
    page = (folder / "README.md").read_text(encoding="utf-8")
    assert "8 distal.9" in page and "| zones of blood |" in page and "1_ir.xml" in page


@pytest.mark.slow
def test_plain_mitsuba_reads_what_the_walk_of_photons_reads(scene, folder, chosen_jit, tmp_path):
    """Rationale: the page beside the scene describes how to get readings. Expected: the sum of all eight agrees."""
    every = {f"photodiode_{k + 1}": "1,1,1" for k in range(8)}
    pixels = render(folder, tmp_path, spp=512, **every)[..., 0].ravel() / np.pi
    value, stderr = pixels.mean(), pixels.std(ddof=1) / len(pixels) ** 0.5
    ours = nailoptics.trace(as_seen(scene, reflecting=True), photons=1_000_000, seed=5, backend=chosen_jit.name).at()
    expected = float(ours.detected_fraction.sum())
    error = np.hypot(stderr, float((ours.detected_fraction_stderr**2).sum()) ** 0.5)
    assert abs(value - expected) < 3 * error and error < 0.06 * expected

"""What of a scene another program can take and what it cannot, and the folder that says so beside every export."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from ..assets import data_dir
from ..geometry import Geometry
from ..geometry.build import LAMBERTIAN
from ..io import write_bytes, write_text
from ..light import optics
from ..scene import Scene, to_toml


def as_seen(scene: Scene, *, reflecting: bool) -> Scene:
    """The scene as another program gets it, at rest, without what it lacks; reflecting: opaque parts do."""
    plain = LAMBERTIAN | {"fwhm_nm": 0.0}
    update: dict[str, object] = {"leds": tuple(led.model_copy(update=plain) for led in scene.leds)}
    if not reflecting:
        update["board"] = scene.board.model_copy(update={"opaque_reflectance": 0.0})
    return scene.model_copy(update=update)


def _lacking(scene: Scene, *, reflecting: bool) -> list[tuple[str, str, str]]:
    """What no other program takes of a scene: in the scene's words, what it is here, and what the program gets in its
    place, or what that does to a reading; arguments as of `as_seen`."""
    lacking = []
    for led in scene.leds:
        if led.fwhm_nm:
            there = f"one wavelength, {led.wavelength_nm:g} nm"
            lacking.append((f"line width of LED {led.name}", f"{led.fwhm_nm:g} nm", there))
        if led.pattern == "measured":
            lacking.append((f"pattern of LED {led.name}", "a measured table", "Lambertian"))
    for photodiode in scene.photodiodes:
        if photodiode.angular_response:
            there = "a flat face, which takes all alike"
            lacking.append((f"angular response of photodiode {photodiode.name}", "rows over the angle", there))
    edges = ", ".join(f"{edge:g}" for edge in scene.zone_edges_mm)
    zones = f"{scene.zone_count} zones that pass into each other over {scene.zone_width_mm:g} mm"
    electronics = "flux, line and responsivity, amplifier, converter, noise"
    touch = "touch and what it does to the blood", f'"{scene.touch.profile}", over time'
    lacking += [
        ("zones of blood", f"{zones} at {edges} mm", "blood at rest, alike in all zones"),
        (*touch, "rest; read paths at other absorption instead"),
        ("electronics", electronics, "nothing: readings are fractions of the light that the LED emits"),
    ]
    if scene.light.left_out:
        there = "the same: `light.left_out = []` brings them back"
        lacking.append((", ".join(scene.light.left_out), "take the optics of what they lie in", there))
    if not reflecting and (share := scene.board.opaque_reflectance):
        lacking.append(("barrier, rim and cover", f"reflect {share:.0%} of the light diffusely", "swallow it"))
    if not reflecting:
        there = "reflect as if they had the epoxy's index: at most 0.4 % of light that comes straight, 1.2 % on Kapton"
        lacking.append(("faces of opaque parts", "swallow all light that is not reflected back", there))
    return lacking


def absorber_of(scene: Scene, geometry: Geometry, middles_mm: np.ndarray, region: np.ndarray) -> np.ndarray:
    """Which of the scene's absorbers a place in a region belongs to, from 1 on, (n,) int; 0 in what is opaque, or air.

    A place at middles_mm, (n, 3) float, between two zones of blood counts as in the one that it is more in.
    """
    number = np.zeros(len(geometry.regions), int)
    for i, absorber in enumerate(optics.absorbing(scene), start=1):
        if not absorber.zone:
            number[geometry.regions.index(absorber.region)] = i
    labels = number[region]
    bed = region == geometry.regions.index("bed")
    labels[bed] += optics.zones(scene).weights(middles_mm[bed, 1]).argmax(-1)
    return labels


def media_table(scene: Scene, geometry: Geometry, led: int, *, index_step: float = 0.0) -> list[list[float]]:
    """mu_a, mu_s [mm^-1], g and n of what is opaque and of every absorber at an LED's wavelength, with blood at rest.

    index_step : by what part the index of what is opaque lies above that of the epoxy around LEDs and photodiodes.
    """
    media = optics.finger_media(scene, geometry.regions, scene.leds[led].wavelength_nm)
    rows = [geometry.regions.index(absorber.region) for absorber in optics.absorbing(scene)]
    opaque = [0.0, 0.0, 1.0, (1 + index_step) * float(media.n[geometry.regions.index("epoxy")])]
    return [opaque, *np.column_stack([getattr(media, name)[rows] for name in ("mu_a", "mu_s", "g", "n")]).tolist()]


def led_file(scene: Scene, led: int, ending: str) -> str:
    """Name of the file of one LED in an export's folder."""
    return f"{led + 1}_{scene.leds[led].name}{ending}"


def session_of(
    scene: Scene, led: int, *, photons: int, longest_s: float, media: Iterable[Iterable[float]], **own: Any
) -> dict[str, Any]:
    """What sessions of MCX and MMC for an LED share, as JSON, in which light is followed for so long.

    media : mu_a, mu_s [mm^-1], g and n of each, from medium 0 on. own : what else stands under "nailoptics".
    """
    names = {"absorbers": list(optics.absorbers(scene)), "photodiodes": list(scene.layout.photodiode_names)}
    about = {"led": led, "wavelength_nm": scene.leds[led].wavelength_nm, **own, **names, "scene": to_toml(scene)}
    flags = {"DoMismatch": 1, "DoPartialPath": 1, "DoSaveVolume": 0}
    return {
        "Session": {"ID": led_file(scene, led, ""), "Photons": photons, "RNGSeed": 1} | flags,
        "Forward": {"T0": 0.0, "T1": longest_s, "Dt": longest_s},
        "Domain": {"Media": [dict(zip(("mua", "mus", "g", "n"), map(float, row), strict=True)) for row in media]},
        "nailoptics": about,
    }


def write_folder(
    program: str,
    folder: Path,
    scene: Scene,
    of_leds: Sequence[Any],
    *,
    about: str,
    reflecting: bool = False,
    **values: object,
) -> dict[str, Path]:
    """Write an export: a file of each LED, the runner of sessions, the scene and a README; returns their paths.

    program : names the README's template, which has what this program alone lacks; values are what else that holds.
    scene : the user's; reflecting as of `as_seen`.
    of_leds : bytes of XML, or sessions, which become JSON; about : what one of these files is.
    """
    paths = {"readme": folder / "README.md", "scene": folder / "scene.toml"}
    names = [led_file(scene, i, ".xml" if isinstance(one, bytes) else ".json") for i, one in enumerate(of_leds)]
    for k, (name, content) in enumerate(zip(names, of_leds, strict=True), start=1):
        paths[f"led_{k}"] = folder / name
        data = content if isinstance(content, bytes) else json.dumps(content, separators=(",", ":")).encode()
        write_bytes(paths[f"led_{k}"], data)
    if program != "mitsuba":
        paths["run"] = folder / f"run_p{program}.py"
        write_text(paths["run"], (data_dir("assets") / "run_session.py").read_text(encoding="utf-8"))
    write_text(paths["scene"], to_toml(as_seen(scene, reflecting=reflecting)))
    page = Template(Path(__file__).with_name(f"{program}.md").read_text(encoding="utf-8"))
    table = "\n".join(f"| {' | '.join(row)} |" for row in _lacking(scene, reflecting=reflecting))
    files = "\n".join(f"- `{name}`: {about}" for name in names)
    write_text(paths["readme"], page.substitute(values, rows=table, about=files, first=names[0]))
    return paths

"""What of a scene another program can take, what it cannot, and the page that says so beside every export."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..geometry import Geometry
from ..light import optics
from ..scene import Scene

# How many photons a run sends where nobody says more.
USUAL_PHOTONS = 1_000_000


@dataclass(frozen=True)
class Lost:
    """Something of a scene that an export leaves out or changes.

    what : in the scene's words.
    here : what it is in nailoptics.
    there : what the other program gets in its place, or what that does to a reading.
    """

    what: str
    here: str
    there: str


def checked_finger(scene: Scene) -> Scene:
    """The scene itself; raises InputError for a phantom, which has neither ends nor a mesh."""
    if scene.finger is None:
        raise InputError(
            "export: a phantom is laterally infinite and has no mesh; export a scene with [finger], or give its layers "
            "to the other program by hand."
        )
    return scene


def as_seen(scene: Scene, *, reflecting: bool) -> Scene:
    """The scene as another program gets it, at rest: what it lacks is taken out, so that readings can be compared.

    reflecting : whether its opaque parts reflect light.
    """
    plain = {"fwhm_nm": 0.0, "pattern": "lambertian", "pattern_deg": None, "pattern_relative": None}
    update: dict[str, object] = {"leds": tuple(led.model_copy(update=plain) for led in scene.leds)}
    if not reflecting:
        update["board"] = scene.board.model_copy(update={"opaque_reflectance": 0.0})
    return scene.model_copy(update=update)


def lost_everywhere(scene: Scene) -> list[Lost]:
    """What no other program takes of a scene."""
    rows = [
        Lost(f"line width of LED {led.name}", f"{led.fwhm_nm:g} nm", f"one wavelength, {led.wavelength_nm:g} nm")
        for led in scene.leds
        if led.fwhm_nm
    ]
    rows += [
        Lost(f"pattern of LED {led.name}", "a measured table", "Lambertian")
        for led in scene.leds
        if led.pattern == "measured"
    ]
    rows += [
        Lost(f"angular response of photodiode {one.name}", "rows over the angle", "a flat face, which takes all alike")
        for one in scene.photodiodes
        if one.angular_response
    ]
    edges = ", ".join(f"{edge:g}" for edge in scene.zone_edges_mm)
    smooth = f"{len(scene.zone_edges_mm) + 1} zones that pass into each other over {scene.zone_width_mm:g} mm"
    rows.append(Lost("zones of blood", f"{smooth} at {edges} mm", "blood at rest, alike in all zones"))
    touch = f'"{scene.touch.profile}", over time'
    rows.append(Lost("touch and what it does to the blood", touch, "rest; read paths at other absorption instead"))
    text = "flux, line and responsivity, amplifier, converter, noise"
    rows.append(Lost("electronics", text, "nothing: readings are fractions of the light that the LED emits"))
    if scene.light.left_out:
        text = "take the optics of what they lie in"
        rows.append(Lost(", ".join(scene.light.left_out), text, "the same: `light.left_out = []` brings them back"))
    return rows


def lost_reflection(scene: Scene) -> list[Lost]:
    """What is lost where opaque parts swallow all light."""
    share = scene.board.opaque_reflectance
    if not share:
        return []
    return [Lost("barrier, rim and cover", f"reflect {share:.0%} of the light diffusely", "swallow it")]


def lost_refraction(scene: Scene, geometry: Geometry) -> list[Lost]:
    """What is lost where opaque parts have the index of the epoxy, whatever they touch."""
    found: dict[str, float] = {}
    for led in scene.leds:
        media = optics.finger_media(scene, geometry.regions, led.wavelength_nm)
        epoxy = epoxy_index(scene, geometry, led.wavelength_nm)
        for one, other in geometry.interfaces():
            for clear, opaque in ((one, other), (other, one)):
                if media.opaque[opaque] and not media.opaque[clear] and geometry.regions[clear] != "air":
                    n = float(media.n[clear])
                    share = ((n - epoxy) / (n + epoxy)) ** 2
                    name = geometry.regions[clear]
                    found[name] = max(found.get(name, 0.0), share)
    names = [name for name, share in found.items() if share > 0]
    if not names:
        return []
    text = f"reflect as if they had the epoxy's index: at most {max(found.values()):.1e} of light that comes straight"
    return [Lost(f"faces of opaque parts on {', '.join(names)}", "swallow all light that is not reflected back", text)]


def epoxy_index(scene: Scene, geometry: Geometry, wavelength_nm: float) -> float:
    """Refractive index of the clear epoxy, in which LEDs and photodiodes lie."""
    media = optics.finger_media(scene, geometry.regions, wavelength_nm)
    return float(media.n[geometry.regions.index("epoxy")])


def absorber_of(scene: Scene, geometry: Geometry, middles_mm: np.ndarray, region: np.ndarray) -> np.ndarray:
    """Which of the scene's absorbers a place in a region belongs to, from 1 on, (n,) int; 0 in what is opaque, or air.

    A place between two zones of blood counts as in the one that it is more in.

    middles_mm : (n, 3) float. [mm]
    region : (n,) int.
    """
    number = np.zeros(len(geometry.regions), int)
    for i, absorber in enumerate(optics.absorbing(scene), start=1):
        if not absorber.zone:
            number[geometry.regions.index(absorber.region)] = i
    labels = number[region]
    bed = region == geometry.regions.index("bed")
    labels[bed] += optics.zones(scene).weights(middles_mm[bed, 1]).argmax(-1)
    return labels


def media_table(scene: Scene, geometry: Geometry, led: int) -> np.ndarray:
    """mu_a, mu_s [mm^-1], g and n of every absorber at an LED's wavelength, with blood at rest, (r, 4) float."""
    wavelength = scene.leds[led].wavelength_nm
    media = optics.finger_media(scene, geometry.regions, wavelength)
    rows = [geometry.regions.index(absorber.region) for absorber in optics.absorbing(scene)]
    return np.column_stack([getattr(media, name)[rows] for name in ("mu_a", "mu_s", "g", "n")])


def page(title: str, text: Iterable[str], lost: Iterable[Lost]) -> str:
    """The README.md of an export: what it is, how to use it, and what does not carry over."""
    rows = [f"| {row.what} | {row.here} | {row.there} |" for row in lost]
    table = ["| of the scene | here | there |", "|---|---|---|", *rows]
    return "\n".join([f"# {title}", "", *text, "", "## What does not carry over", "", *table, ""])

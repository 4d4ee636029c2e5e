"""Whether red and infrared light go equally far through the beating blood, so that a textbook's line holds."""

import numpy as np
from numpy.typing import NDArray

from ... import tissue
from ...light.diffusion import DiffusionModel
from ...scene import Scene
from ...scene.oximeter import two_leds
from .calibration_line import MEASURED, TEXTBOOK, evaluate

Array = NDArray[np.float64]

# By more than this a line from the literature misleads. [percent]
MOST_OFF = 2.0
# By so much less blood layered diffusion finds its path, and from so far on its readings hold.
LESS_BLOOD = 0.01


def misread(ratio: Array, so2: float) -> Array:
    """By how much the nearer of both lines, the textbook's and that of fingers, misses the saturation. [percent]

    ratio : (photodiodes,) float. Ratio of ratios at a saturation in parts of 1.
    """
    off = np.stack([evaluate(line, ratio) - 100 * so2 for line in (TEXTBOOK, MEASURED)])
    return np.asarray(np.take_along_axis(off, np.abs(off).argmin(0)[None], 0)[0])


def path_warnings(scene: Scene, ratio: Array, path_ratio: Array, *, how: str = "") -> list[str]:
    """One line for each photodiode on which lines from the literature are off by more than 2 %, and what mends it.

    ratio, path_ratio : (photodiodes,) float. At the scene's saturation.
    how : a remark on how the paths were found.
    """
    red, infrared = two_leds(scene.leds, scene.oximeter.slots if scene.oximeter else None)
    dies, lines = scene.layout.leds, []
    off = misread(ratio, scene.blood.so2)
    for element, r, paths, percent in zip(scene.layout.photodiodes, ratio, path_ratio, off, strict=True):
        if not abs(percent) > MOST_OFF:
            continue
        (u, v), name = element.area.center_mm, element.name
        near = [float(np.hypot(u - dies[i].center_mm[0], v - dies[i].center_mm[1])) for i in (red, infrared)]
        line = (
            f'photodiode "{name}": red light goes {paths:.2f} times as far through the beating blood as '
            f"infrared{how}, R({scene.blood.so2:g}) = {r:.2f}, a textbook's line is off by {percent:+.1f} % or more; "
        )
        if abs(near[0] - near[1]) > 0.1:
            line += (
                f'it lies {near[0]:.2f} mm from "{scene.leds[red].name}" and {near[1]:.2f} mm from '
                f'"{scene.leds[infrared].name}": put it as far from both, on the axis between two dies side by side'
            )
        else:
            line += "it is as far from both LEDs: move it to 1.2 to 2 mm from them, or use the fit of this scene"
        lines.append(line)
    return lines


def warnings_without_light(scene: Scene) -> list[str]:
    """The same warnings from layered diffusion, in a fraction of a second; nothing where a scene is no oximeter.

    A scene is one if it says so with [oximeter].
    """
    if scene.oximeter is None or scene.finger is None:
        return []
    red, infrared = two_leds(scene.leds, scene.oximeter.slots)
    paths = diffusion_paths_mm(scene)
    path_ratio = paths[red] / paths[infrared]
    mu = [float(tissue.blood_mu_a_per_mm(scene.leds[i].wavelength_nm, scene.blood.so2)) for i in (red, infrared)]
    return path_warnings(scene, path_ratio * mu[0] / mu[1], path_ratio, how=" (by layered diffusion, about 15 %)")


def diffusion_paths_mm(scene: Scene) -> Array:
    """Mean path of each LED's light in the bed by layered diffusion, (led, photodiode) float. [mm]"""
    rest, zones = scene.blood.rest_blood_fraction, len(scene.zone_edges_mm) + 1
    states = np.full((2, zones), rest)
    states[1] *= 1 - LESS_BLOOD
    readings = DiffusionModel(scene).readings(states)
    mu = np.array([float(tissue.blood_mu_a_per_mm(led.wavelength_nm, scene.blood.rest_so2)) for led in scene.leds])
    return np.asarray(np.log(readings[..., 1] / readings[..., 0]) / (mu[:, None] * rest * LESS_BLOOD))

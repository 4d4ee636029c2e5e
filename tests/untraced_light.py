"""Light of a finger in a formula, in place of a trace: for tests of what is made of volts."""

import numpy as np

from nailoptics.light import DetectedLight, optics
from nailoptics.light.transfer.series import ReadingSeries
from nailoptics.scene import Scene
from nailoptics.sensor import electronics
from nailoptics.studies.force.reading_table import POWERS, ReadingTable

# How strongly the logarithm of a reading falls with the blood of the two halves of the bed, as traced light has it for
# readings along the nail, and what part of the LED's light each of them gets.
SLOPES = np.array([[-16, -2.5], [-9, -2], [-5, -2], [-3, -3], [-3, -3], [-2, -5], [-2, -9], [-2.5, -16.0]])
LEVEL = np.array([0.2, 0.5, 1.0, 1.5, 1.5, 1.0, 0.5, 0.2]) * 1e-3
MOST_BLOOD = 0.15


def untraced(scene: Scene) -> DetectedLight:
    """Light that dims as Beer and Lambert have it, in place of a trace."""
    zones = len(scene.zone_edges_mm) + 1
    slopes = np.repeat(SLOPES / (zones / 2), zones // 2, axis=1)

    def readings_at(blood: np.ndarray) -> ReadingSeries:
        fraction = (LEVEL[:, None] * np.exp(slopes @ (blood - scene.blood.rest_blood_fraction).T))[None]
        zero = np.zeros_like(fraction)
        return ReadingSeries(fraction, zero, fraction - fraction[..., :1], zero)

    paths = np.zeros((1, len(SLOPES), len(optics.absorbers(scene))))
    return DetectedLight(readings_at, paths, paths, tuple(optics.absorbers(scene)), attributes={})


def untraced_table(scene: Scene) -> ReadingTable:
    """The same light as a fit takes it, on the scene's board."""
    led, diodes = scene.leds[0], [element.photodiode for element in scene.layout.photodiodes]
    level_v = LEVEL * electronics.volts_per_fraction(led, diodes, scene.electronics)
    coefficients = np.zeros((len(LEVEL), len(POWERS)))
    coefficients[:, POWERS.index((0, 0))] = np.log(level_v) - scene.blood.rest_blood_fraction * SLOPES.sum(1)
    coefficients[:, POWERS.index((1, 0))] = SLOPES[:, 0] * MOST_BLOOD
    coefficients[:, POWERS.index((0, 1))] = SLOPES[:, 1] * MOST_BLOOD
    return ReadingTable(
        ln_volts=dict(zip(scene.layout.photodiode_names, coefficients, strict=True)),
        dark_v=np.full(len(LEVEL), 1e-4),
        most_blood_fraction=MOST_BLOOD,
        slope_stderr=0.01 * np.abs(SLOPES),
        noise_v=np.full(len(LEVEL), 1e-4),
        range_v=scene.electronics.adc_range_v,
    )

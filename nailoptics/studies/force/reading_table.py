"""Volts of every reading over the blood in both zones: polynomials fitted to one trace, read in microseconds."""

import itertools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...hemodynamics.for_scene import zones_of_photodiodes
from ...light import DetectedLight
from ...scene import Scene
from ...sensor import electronics

Array = NDArray[np.float64]

# The logarithm of a reading is nearly linear in blood: polynomials of this degree in both zones' blood together.
DEGREE = 3
POWERS = tuple(p for p in itertools.product(range(DEGREE + 1), repeat=2) if sum(p) <= DEGREE)
# Blood that the table reaches to, over the largest that is expected; and points along each zone's blood.
NODES = 12


@dataclass(frozen=True)
class ReadingTable:
    """The volts of R readings where two zones hold some blood, as the electronics of a scene show them.

    names : (R,) str. Photodiode, or LED:photodiode where there are several LEDs.
    coefficients : (R, P) float. Of ln volts without dark current, over POWERS of blood / most_blood.
    dark_v : (R,) float. Volts by the photodiode's dark current.
    most_blood : float. Blood fraction up to which the table holds. [1]
    slope_stderr : (R, 2) float. Standard error of d ln volts / d blood of each zone at rest, of the trace.
    noise_v : (R,) float. Noise of the electronics at rest, rms. [V]
    range_v : float. The converter's full scale. [V]
    """

    names: tuple[str, ...]
    coefficients: Array
    dark_v: Array
    most_blood: float
    slope_stderr: Array
    noise_v: Array
    range_v: float

    def volts(self, blood: Array) -> Array:
        """Volts, (R, *S) float, for (2, *S) blood fractions; blood beyond the table counts as its end."""
        return self.dark_v.reshape((-1,) + (1,) * (blood.ndim - 1)) + self._light_v(self._powers(blood))

    def slopes(self, blood: Array) -> tuple[Array, Array]:
        """Volts (R,) and their derivatives by the blood of each zone (R, 2), for blood (2,)."""
        x = np.clip(blood / self.most_blood, 0.0, 1.0)
        rows = [
            [x[0] ** i * x[1] ** j, i * x[0] ** max(i - 1, 0) * x[1] ** j, j * x[0] ** i * x[1] ** max(j - 1, 0)]
            for i, j in POWERS
        ]
        value, by_first, by_second = (self.coefficients @ np.array(rows)).T
        light = np.exp(value)
        return self.dark_v + light, light[:, None] * np.stack([by_first, by_second], 1) / self.most_blood

    def steeper(self, by_blood: Array, rest_blood: float) -> "ReadingTable":
        """The table whose ln volts have an additional slope (R, 2) by each zone's blood, the same at rest."""
        changed = self.coefficients.copy()
        changed[:, POWERS.index((1, 0))] += by_blood[:, 0] * self.most_blood
        changed[:, POWERS.index((0, 1))] += by_blood[:, 1] * self.most_blood
        changed[:, POWERS.index((0, 0))] -= rest_blood * by_blood.sum(1)
        return replace(self, coefficients=changed)

    def same_led(self) -> Array:
        """Which LED each reading is of, (R, L) float: 1 or 0."""
        leds = [name.rpartition(":")[0] for name in self.names]
        return np.array([[float(led == one) for one in dict.fromkeys(leds)] for led in leds])

    def _powers(self, blood: Array) -> Array:
        x = np.clip(blood / self.most_blood, 0.0, 1.0)
        ladder = x[:, None] ** np.arange(DEGREE + 1).reshape((-1,) + (1,) * (blood.ndim - 1))
        return np.stack([ladder[0, i] * ladder[1, j] for i, j in POWERS])

    def _light_v(self, powers: Array) -> Array:
        return np.exp(np.tensordot(self.coefficients, powers, axes=1))


def reading_names(scene: Scene) -> tuple[str, ...]:
    """Names of a scene's readings: the photodiode, with the LED before it where there are several."""
    photodiodes = scene.layout.photodiode_names
    if len(scene.leds) == 1:
        return tuple(photodiodes)
    return tuple(f"{led.name}:{photodiode}" for led in scene.leds for photodiode in photodiodes)


def nodes_of(most_blood: float) -> Array:
    """The (n, 2) blood fractions at which light is read for a table."""
    # Denser where there is little blood, from which single long paths reach the photodiode.
    along = most_blood * (0.5 - 0.5 * np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES))
    return np.array(list(itertools.product(along, along)))


def reading_table(scene: Scene, light: DetectedLight, most_blood: float) -> ReadingTable:
    """Fit the table to a scene's traced light.

    Raises: InputError where a photodiode sees no light, or a converter is at its limit at rest.
    """
    nodes, rest = nodes_of(most_blood), scene.blood.rest_blood_fraction
    step = 0.5 * rest
    around = np.array([[rest, rest], [rest + step, rest], [rest, rest + step]])
    found, near = light.readings_at(nodes), light.readings_at(around)
    diodes = [element.photodiode for element in scene.layout.photodiodes]
    pairs = [(led, diode) for led in scene.leds for diode in diodes]
    per_fraction = np.array([electronics.volts_per_fraction(led, diode, scene.electronics) for led, diode in pairs])
    read = [
        electronics.read(part, led, diode, scene.electronics)
        for part, (led, diode) in zip(near.fraction[..., 0].ravel(), pairs, strict=True)
    ]
    names = reading_names(scene)
    for name, one, part in zip(names, read, near.fraction[..., 0].ravel(), strict=True):
        if not part > 0:
            raise InputError(f"{name}: sees no light in this scene; trace more photons or leave it out.")
        if one.saturated:
            raise InputError(
                f"{name}: its converter is at its limit ({scene.electronics.adc_range_v:g} V) at rest; "
                "lower flux_mw or feedback_ohm."
            )
    fraction = found.fraction.reshape(len(names), -1)
    x = nodes.T / most_blood
    design = np.stack([x[0] ** i * x[1] ** j for i, j in POWERS], 1)
    coefficients = np.linalg.lstsq(design, np.log(fraction * per_fraction[:, None]).T, rcond=None)[0].T
    rest_fraction = near.fraction.reshape(len(names), -1)[:, :1]
    return ReadingTable(
        names=names,
        coefficients=coefficients,
        dark_v=np.array(
            [
                diode.dark_current_a(scene.electronics.temperature_k) * scene.electronics.feedback_ohm
                for _, diode in pairs
            ]
        ),
        most_blood=most_blood,
        slope_stderr=near.change_stderr.reshape(len(names), -1)[:, 1:] / rest_fraction / step,
        noise_v=np.array([float(one.volts_noise_rms) for one in read]),
        range_v=scene.electronics.adc_range_v,
    )


def paper_table(scene: Scene, table: ReadingTable) -> ReadingTable:
    """The paper's optics (9) in place of traced light: each reading falls in a line with the blood of its own zone.

    Offset and scale of every reading are left to the calibration, so that any line does; this one loses a tenth of the
    reading from no blood to twice that at rest.
    """
    zones = np.tile(zones_of_photodiodes(scene), len(scene.leds))
    own = np.zeros_like(table.coefficients)
    blood = table.most_blood * (np.arange(NODES) + 0.5) / NODES
    line = np.log(1.0 - 0.05 * blood / scene.blood.rest_blood_fraction)
    by_power = np.polynomial.polynomial.polyfit(blood / table.most_blood, line, DEGREE)
    for reading, zone in enumerate(zones):
        for k, power in enumerate(POWERS):
            if power[1 - zone] == 0:
                own[reading, k] = by_power[power[zone]]
    level = table.volts(np.full((2, 1), scene.blood.rest_blood_fraction))[:, 0]
    own[:, POWERS.index((0, 0))] += np.log(level)
    return replace(table, coefficients=own, slope_stderr=np.zeros_like(table.slope_stderr))

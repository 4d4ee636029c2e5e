"""Volts of every reading over the blood in both zones: polynomials fitted to one trace, read in microseconds."""

import itertools
from dataclasses import replace
from functools import cached_property, partial
from typing import Annotated

import numpy as np
import xarray as xr
from pydantic import Field
from pydantic.dataclasses import dataclass

from ... import checks
from ...errors import InputError
from ...light import DetectedLight
from ...options import TraceOptions
from ...scene import Scene, parse_scene
from ...scene.importers.sensor_recordings import MOST_VOLTS, SITES, Recording
from ...sensor import electronics
from ...sensor.ambient import scene_ambient_a
from ...sensor.volts import with_fitted_resistors
from ...statistics import seed_of
from .person import MOST_GAIN, TABLE, Array, Numbers, require_shapes, within

# The logarithm of a reading is nearly linear in blood: polynomials of this degree in both zones' blood together.
DEGREE = 3
POWERS = tuple(p for p in itertools.product(range(DEGREE + 1), repeat=2) if sum(p) <= DEGREE)
# Which of them are linear in the blood of the proximal and of the distal zone.
LINEAR_POWERS = [POWERS.index((1, 0)), POWERS.index((0, 1))]
# Points along each zone's blood at which light is read for the table.
NODES = 12
# Which stream of random numbers the noise of a recording takes, beside those of the light and the body.
_NOISE = 11


def monomials(x: Array, y: Array) -> Array:
    """x^i y^j for all `POWERS`, (P, ...) float."""
    return np.stack([x**i * y**j for i, j in POWERS])


@dataclass(frozen=True, config=TABLE)
class ReadingTable:
    """The volts of R readings where two zones hold some blood, as the electronics of a scene show them.

    ln_volts : (P,) float by reading, named by photodiode, or LED:photodiode where there are several LEDs. Coefficients
        of ln volts by the LED's light, over POWERS of blood / most_blood_fraction.
    dark_v : (R,) float. What a reading has of dark current and light from outside. [V]
    most_blood_fraction : blood up to which the table holds. [1]
    slope_stderr : (R, 2) float. Standard error of d ln volts / d blood of each zone at rest, of the trace.
    noise_v : (R,) float. Noise of the electronics at rest, rms. [V]
    range_v : reading from which a converter may be at its full scale. [V]
    """

    ln_volts: Annotated[dict[str, Annotated[Numbers, within(0, MOST_GAIN)]], Field(min_length=1)]
    dark_v: Annotated[Numbers, within(0, MOST_VOLTS, np.positive)]
    most_blood_fraction: Annotated[float, Field(ge=1e-6, le=1)]
    slope_stderr: Annotated[Numbers, within(0, MOST_GAIN, np.positive)]
    noise_v: Annotated[Numbers, within(1e-12, MOST_VOLTS, np.positive)]
    range_v: Annotated[float, Field(ge=1e-3, le=MOST_VOLTS)]

    def __post_init__(self) -> None:
        count = len(self.ln_volts)
        require_shapes(self, dark_v=(count,), noise_v=(count,), slope_stderr=(count, 2))
        require_shapes(self, coefficients=(count, len(POWERS)))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the readings."""
        return tuple(self.ln_volts)

    @cached_property
    def coefficients(self) -> Array:
        """Those of ln volts, (R, P) float."""
        return np.stack(list(self.ln_volts.values()))

    def volts(self, blood: Array) -> Array:
        """Volts, (R, *S) float, for (2, *S) blood fractions; blood beyond the table counts as its end."""
        x = np.clip(blood / self.most_blood_fraction, 0.0, 1.0)
        light_v = np.exp(np.tensordot(self.coefficients, monomials(*x), axes=1))
        return self.dark_v.reshape((-1,) + (1,) * (blood.ndim - 1)) + light_v

    def slopes(self, blood: Array) -> tuple[Array, Array]:
        """Volts (R,) and their derivatives by the blood of each zone (R, 2), for blood (2,)."""
        inside = np.minimum(np.maximum(blood / self.most_blood_fraction, 0.0), 1.0)
        x, y = ([part**i for i in range(DEGREE + 1)] for part in inside.tolist())
        rows = [[x[i] * y[j], i * x[i - 1] * y[j], j * x[i] * y[j - 1]] for i, j in POWERS]
        value, by_first, by_second = (self.coefficients @ np.array(rows)).T
        light = np.exp(value)
        return self.dark_v + light, light[:, None] * np.stack([by_first, by_second], 1) / self.most_blood_fraction

    def steeper(self, by_blood: Array, rest_blood: float) -> "ReadingTable":
        """The table whose ln volts have an additional slope (R, 2) by each zone's blood, the same at rest."""
        changed = self.coefficients.copy()
        changed[:, LINEAR_POWERS] += by_blood * self.most_blood_fraction
        changed[:, POWERS.index((0, 0))] -= rest_blood * by_blood.sum(1)
        return replace(self, ln_volts=dict(zip(self.names, changed, strict=True)))

    def same_led(self) -> Array:
        """Which LED each reading is of, (R, L) float: 1 or 0."""
        leds = [name.rpartition(":")[0] for name in self.names]
        return np.array([[float(led == each) for each in dict.fromkeys(leds)] for led in leds])


def reading_names(scene: Scene) -> tuple[str, ...]:
    """Names of a scene's readings: the photodiode, with the LED before it where there are several."""
    photodiodes = scene.layout.photodiode_names
    if len(scene.leds) == 1:
        return tuple(photodiodes)
    return tuple(f"{led.name}:{photodiode}" for led in scene.leds for photodiode in photodiodes)


def record(result: xr.Dataset, *, seed: int = 0) -> Recording:
    """What a worn sensor would record of a simulated touch: volts with noise, the flicker of [ambient], and the
    converter's steps.

    result : what `simulate` returned.

    Returns: Recording, which `calibrate` and `predict` take, and whose `save` writes it. Raises: InputError.
    """
    checks.seed(seed)
    try:
        scene, time_s, force_n = parse_scene(result.attrs["scene"]), result.time.values, result.force_n.values
        shape = len(names := reading_names(scene)), len(time_s)
        volts, noise = (result[name].values.reshape(shape) for name in ("volts", "volts_noise_rms"))
    except (AttributeError, LookupError, ValueError):
        raise InputError("record needs the whole result of simulate; give it as returned.") from None
    # The converter's own steps are applied below, not drawn.
    lsb = electronics.lsb_v(scene.electronics)
    analog = np.sqrt(np.maximum(noise**2 - lsb**2 / 12, 0.0))
    rng = np.random.default_rng(seed_of(seed, _NOISE))
    volts = volts + analog * rng.normal(size=volts.shape)
    if scene.ambient is not None:
        flicker = np.sqrt(2) * np.sin(2 * np.pi * (scene.ambient.flicker_hz * time_s + rng.random()))
        volts += np.tile(result.ambient_flicker_v.values, len(scene.leds))[:, None] * flicker
    volts, _ = electronics.converted(np.round(volts / lsb) * lsb, scene.electronics)
    # Nothing is recorded while the sensor is off the finger.
    worn = ~scene.touch.is_off(time_s)
    return Recording("simulated", names, time_s[worn], volts[:, worn], force_n[worn], site_of(scene, time_s[worn]))


def site_of(scene: Scene, time_s: Array) -> Array:
    """Where the scene's touch presses at some times [s]: 1 proximal, 0 distal, NaN even."""
    touch = scene.touch
    if touch.recorded_proximal_share and {0.0, 1.0}.issuperset(touch.recorded_proximal_share):
        return np.round(np.interp(time_s, touch.recorded_time_s or (), touch.recorded_proximal_share))
    site = SITES[touch.site] if touch.site else {1.0: 1.0, 0.0: 0.0}.get(touch.proximal_share, np.nan)
    return np.full(time_s.shape, site)


def nodes_of(most_blood: float) -> Array:
    """The (n, 2) blood fractions at which light is read for a table."""
    # Denser where there is little blood, from which single long paths reach the photodiode.
    along = most_blood * (0.5 - 0.5 * np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES))
    return np.array(list(itertools.product(along, along)))


def reading_table(scene: Scene, light: DetectedLight, most_blood: float, options: TraceOptions) -> ReadingTable:
    """Fit the table to a scene's traced light, in its light from outside, which is traced with the options.

    Raises: InputError where a photodiode sees no light, or a converter is at its limit at rest.
    """
    scene, rest = with_fitted_resistors(scene), scene.blood.rest_blood_fraction
    step, stage = 0.5 * rest, scene.electronics
    near = light.readings_at(np.array([[rest, rest], [rest + step, rest], [rest, rest + step]]))
    diodes = scene.elements
    traced_a = scene_ambient_a(scene, options)
    read = partial(electronics.read, ambient_a=np.zeros(len(diodes)) if traced_a is None else traced_a[0])
    unlit = read(0.0, scene.leds[0], diodes, stage)
    names, at_rest = reading_names(scene), near.fraction[..., 0]
    reads = [read(part, led, diodes, stage) for part, led in zip(at_rest, scene.leds, strict=True)]
    is_known = (at_rest > 0) & np.isfinite(near.change_stderr).all(-1)
    faults = {
        "sees too little light for a standard error; trace more photons or leave it out": ~is_known.ravel(),
        f"its converter is at its limit ({stage.adc_range_v:g} V) at rest; lower flux_mw, feedback_ohm or the light of "
        "[ambient]": np.concatenate([read.saturated for read in reads]),
    }
    for fault, where in faults.items():
        if where.any():
            raise InputError(f"{names[int(np.argmax(where))]}: {fault}.")
    nodes = nodes_of(most_blood)
    fraction = light.readings_at(nodes).fraction.reshape(len(names), -1)
    per_fraction_v = np.concatenate([electronics.volts_per_fraction(led, diodes, stage) for led in scene.leds])
    volts = fraction * per_fraction_v[:, None]
    x, y = nodes.T / most_blood
    coefficients = np.linalg.lstsq(monomials(x, y).T, np.log(volts).T, rcond=None)[0].T
    removed_v = unlit.amplified_v.max() if stage.ambient_rejection else 0.0
    return ReadingTable(
        ln_volts=dict(zip(names, coefficients, strict=True)),
        dark_v=np.tile(unlit.volts, len(scene.leds)),
        most_blood_fraction=most_blood,
        slope_stderr=near.change_stderr.reshape(len(names), -1)[:, 1:] / at_rest.reshape(-1, 1) / step,
        noise_v=np.concatenate([read.volts_noise_rms for read in reads]),
        range_v=stage.adc_range_v - removed_v,
    )

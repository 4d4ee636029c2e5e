"""What light LEDs put on the nail and into an eye, beside the limits of exposure, and what a reading takes of both.

Limits: IEC 62471:2006, 4.3.7 and 4.3.8, as in Directive 2006/25/EC, Annex I, table 1.1, rows n and o. Skin, 380 to
3000 nm, thermal: 20 000 t^0.25 J/m^2 for t up to 10 s, that is an irradiance of 20 000 t^-0.75 W/m^2. Eye, 780 to 3000
nm: 100 W/m^2 beyond 1000 s, which is also the limit of the exempt group. The limits of blue and ultraviolet light are
left out: they are for LEDs below 500 nm.
"""

import math
from dataclasses import dataclass

from ..scene import Scene
from ..scene.oximeter import Oximeter

# The longest time for which the limit of the skin is given; beyond it pain ends an exposure. [s]
SKIN_S = 10.0
SKIN_W_PER_M2 = 20_000.0 * SKIN_S**-0.75
# Limit of infrared light on an eye, and the distance at which a source is classified. [m]
EYE_W_PER_M2, EYE_M = 100.0, 0.2


@dataclass(frozen=True)
class Exposure:
    """What one LED emits.

    duty : part of the time in which it is lit. reading_s : for so long it is lit in one reading. [s]
    nail_w_per_m2 : mean irradiance right below it. eye_w_per_m2 : if the lit board lies open before an eye.
    light_j, charge_c : of one reading; the charge None where no current is known. [J], [C]
    """

    led: str
    duty: float
    reading_s: float
    nail_w_per_m2: float
    eye_w_per_m2: float
    light_j: float
    charge_c: float | None


def exposures(scene: Scene) -> list[Exposure]:
    """The exposure by each LED of a finger scene.

    A Lambertian disc of the die's area A emits the flux P at the height h of the board over the nail: right below it
    the irradiance is P / (A + pi h^2), not averaged over any aperture, and P / (pi r^2) at a distance r on its axis.
    Without an [oximeter] LEDs are lit in turn, and a reading takes 1 / (2 bandwidth), of which ambient rejection lights
    a half.
    """
    stage, rows = scene.electronics, []
    slots = {slot.light: slot.length_ms for slot in (scene.oximeter or Oximeter()).schedule(scene.leds)}
    for led in scene.leds:
        if scene.oximeter is not None:
            lit_s = 1e-3 * slots.get(led.name, 0.0)
            duty = lit_s * scene.oximeter.frame_hz
        else:
            lit_part = 1.0 if stage.ambient_rejection is None else 0.5
            lit_s, duty = lit_part / (2 * stage.bandwidth_hz), lit_part / len(scene.leds)
        power_w, area_mm2 = 1e-3 * led.flux_mw, math.prod(led.size_mm)
        height_mm = scene.board.height_mm - 1e-3 * led.height_um
        nail_w_per_m2 = duty * power_w / (1e-6 * (area_mm2 + math.pi * height_mm**2))
        eye_w_per_m2 = duty * power_w / (math.pi * EYE_M**2)
        charge_c = None if led.current_ma is None else 1e-3 * led.current_ma * lit_s
        rows.append(Exposure(led.name, duty, lit_s, nail_w_per_m2, eye_w_per_m2, power_w * lit_s, charge_c))
    return rows

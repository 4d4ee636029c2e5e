"""What light LEDs put on the nail and into an eye, beside the limits of exposure, and what a reading takes of both.

Limits: IEC 62471:2006, 4.3.7 and 4.3.8, as in Directive 2006/25/EC, Annex I, table 1.1, rows n and o. Skin, 380 to
3000 nm, thermal: 20 000 t^0.25 J/m^2 for t up to 10 s, that is an irradiance of 20 000 t^-0.75 W/m^2; none for longer.
Eye, 780 to 3000 nm: 100 W/m^2 beyond 1000 s, which is also the limit of the exempt group; LEDs of all wavelengths are
counted here. The limits of blue and ultraviolet light are left out: they are for LEDs below 500 nm. That skin is
averaged over the circle of Annex II, table 2.4, for lasers is a judgement: Annex I names none for lamps. A die's waste
heat, which is left out, warms skin more than its light does (Bozkurt and Onaral 2004, BioMed. Eng. OnLine 3:9).
"""

import math
from typing import Any

from ..scene import Scene

# Limit of the irradiance of skin over 10 s, and the diameter of the circle over which it is averaged. [m]
SKIN_W_PER_M2, SKIN_M = 20_000.0 * 10.0**-0.75, 3.5e-3
# Limit of infrared light on an eye, and the distance at which a source is classified. [m]
EYE_W_PER_M2, EYE_M = 100.0, 0.2


def exposures(scene: Scene) -> list[dict[str, Any]]:
    """Of each LED its mean irradiance of the circle right below it and, were the lit board open, of an eye, and the
    light [J] and, by its current, the charge [C] of one reading.

    A small Lambertian die that emits P at the height h of the board over the nail gives P / (pi (a^2 + h^2)) on a
    circle of radius a right below it, and P / (pi r^2) at a distance r. Without an [oximeter] LEDs are lit in turn, and
    a reading takes 1 / (2 bandwidth), of which ambient rejection lights a half.
    """
    stage, oximeter, rows = scene.electronics, scene.oximeter, []
    frame_hz = 2 * stage.bandwidth_hz / len(scene.leds) if oximeter is None else oximeter.frame_hz
    length_s = {slot.light: 1e-3 * slot.length_ms for slot in oximeter.schedule(scene.leds)} if oximeter else {}
    usual_s = (0.5 if stage.ambient_rejection else 1.0) / (2 * stage.bandwidth_hz)
    for led in scene.leds:
        lit_s = usual_s if oximeter is None else length_s.get(led.name, 0.0)
        light_j, height_m = 1e-3 * led.flux_mw * lit_s, 1e-3 * scene.board.height_mm - 1e-6 * led.height_um
        row = {"led": led.name, "nail_w_per_m2": light_j * frame_hz / (math.pi * (SKIN_M**2 / 4 + height_m**2))}
        row |= {"eye_w_per_m2": light_j * frame_hz / (math.pi * EYE_M**2), "light_j": light_j}
        rows.append(row | {"charge_c": None if led.current_ma is None else 1e-3 * led.current_ma * lit_s})
    return rows

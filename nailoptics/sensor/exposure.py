"""What light LEDs put on the nail and into an eye, beside the limits of exposure, and what a reading takes of both.

Limits: IEC 62471:2006, 4.3.7 and 4.3.8, as in Directive 2006/25/EC, Annex I, table 1.1, rows n and o. Skin, 380 to
3000 nm, thermal: 20 000 t^0.25 J/m^2 for t up to 10 s, that is an irradiance of 20 000 t^-0.75 W/m^2. Eye, 780 to 3000
nm: 100 W/m^2 beyond 1000 s, which is also the limit of the exempt group. The limits of blue and ultraviolet light are
left out: they are for LEDs below 500 nm.
"""

import math
from typing import Any

from ..scene import Scene

SKIN_W_PER_M2 = 20_000.0 * 10.0**-0.75
# Limit of infrared light on an eye, and the distance at which a source is classified. [m]
EYE_W_PER_M2, EYE_M = 100.0, 0.2


def exposures(scene: Scene) -> list[dict[str, Any]]:
    """Of each LED its mean irradiance right below it and, were the lit board open, on an eye, and the light [J] and, by
    its current, the charge [C] of one reading.

    A Lambertian disc of the die's area A that emits P at the height h of the board over the nail gives P / (A + pi h^2)
    right below it, not averaged over any aperture, and P / (pi r^2) at a distance r. Without an [oximeter] LEDs are lit
    in turn, and a reading takes 1 / (2 bandwidth), of which ambient rejection lights a half.
    """
    stage, rows = scene.electronics, []
    lit_part = 1.0 if stage.ambient_rejection is None else 0.5
    lit_s = dict.fromkeys((led.name for led in scene.leds), lit_part / (2 * stage.bandwidth_hz))
    duty = dict.fromkeys(lit_s, lit_part / len(scene.leds))
    if scene.oximeter is not None:
        lit_s = dict.fromkeys(lit_s, 0.0) | {
            slot.light: 1e-3 * slot.length_ms for slot in scene.oximeter.schedule(scene.leds)
        }
        duty = {name: lit_s[name] * scene.oximeter.frame_hz for name in duty}
    for led in scene.leds:
        mean_w, height_m = 1e-3 * led.flux_mw * duty[led.name], 1e-3 * scene.board.height_mm - 1e-6 * led.height_um
        rows.append(
            {
                "led": led.name,
                "nail_w_per_m2": mean_w / (1e-6 * math.prod(led.size_mm) + math.pi * height_m**2),
                "eye_w_per_m2": mean_w / (math.pi * EYE_M**2),
                "light_j": 1e-3 * led.flux_mw * lit_s[led.name],
                "charge_c": None if led.current_ma is None else 1e-3 * led.current_ma * lit_s[led.name],
            }
        )
    return rows

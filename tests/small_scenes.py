"""Fingers, boards and phantoms as small as a scene can be, for tests to add tables to."""

import json
from collections.abc import Sequence
from typing import Any

SMALL_FINGER = """
schema_version = 1
[finger]
[[leds]]
name = "ir"
part = "led_800"
position_mm = [-1.2, 0.0]
[[photodiodes]]
name = "pd"
position_mm = [0.5, 0.0]
"""
# The same without parts: an LED of one wavelength.
PLAIN_FINGER = """
schema_version = 1
[finger]
[[leds]]
name = "ir"
wavelength_nm = 800.0
position_mm = [-1.2, 0.0]
[[photodiodes]]
name = "near"
position_mm = [0.0, 0.0]
size_mm = [1.0, 0.25]
"""
SMALL_FINGER_BEST = SMALL_FINGER + '[blood]\nparameters = "best"\n'

# A board of its own size, whose LED lies behind the barrier, without a search.
PLACEMENT = """
schema_version = 1
[finger]
[blood]
parameters = "best"
[board]
size_mm = [9.0, 9.0]
[[leds]]
name = "ir"
part = "led_800"
position_mm = [-3.0, 0.0]
[[photodiodes]]
name = "pd"
position_mm = [1.0, 0.0]
size_mm = [1.0, 0.25]
[placement]
search = false
photodiodes = 4
"""
# Two given layouts on one board: photodiodes near the LED, and far from it.
TWO_LAYOUTS = (
    PLACEMENT
    + """
[[placement.candidates]]
name = "near"
leds_mm = [[-3.0, 0.0]]
photodiodes_mm = [[-1.0, -2.0], [-1.0, -1.0], [-1.0, 1.0], [-1.0, 2.0]]
[[placement.candidates]]
name = "far"
leds_mm = [[-3.0, 0.0]]
photodiodes_mm = [[3.0, -2.0], [3.0, -1.0], [3.0, 1.0], [3.0, 2.0]]
"""
)


def finger(*photodiodes: dict[str, Any], leds: Sequence[dict[str, Any]] = ({},), **tables: dict[str, Any]) -> str:
    """TOML of a finger with its photodiodes, and LEDs that are the usual one but for the values given.

    tables : such as finger, board and blood. The usual LED is of part led_800, or none where its wavelength is given.
    """
    led = {"name": "ir", "position_mm": [-1.2, 0.0]}
    lines = [("[finger]", tables.pop("finger", {})), *((f"[{name}]", values) for name, values in tables.items())]
    lines += [
        ("[[leds]]", led | ({} if "wavelength_nm" in values else {"part": "led_800"}) | values) for values in leds
    ]
    return _toml([*lines, *(("[[photodiodes]]", values) for values in photodiodes)])


def columns_of_photodiodes(elements: int, size_mm: float, pitch_mm: float) -> str:
    """TOML of a finger with 32 photodiodes, each a column of so many elements along the nail."""
    column = {"elements": elements, "size_mm": [0.15, size_mm], "pitch_mm": pitch_mm}
    places = [{"name": f"p{i}", "position_mm": [round(-3.4 + 0.2 * i, 2), 0.0]} for i in range(32)]
    far = {"position_mm": [-4.0, 0.0]}
    return finger(*(place | column for place in places), leds=(far,), board={"barrier": False})


def phantom(
    *layers: dict[str, Any], leds: Sequence[dict[str, Any]] = ({},), photodiodes: Sequence[dict[str, Any]] = (), **faces
) -> str:
    """TOML of a phantom: each layer, LED and photodiode is one of usual values, but for those given.

    layers : from the top down. faces : n_above and n_below. The usual LED is a pencil beam at the origin, the usual
    photodiode a square aperture beside it.
    """
    layer = {"name": "slab", "thickness_mm": 10.0, "mu_a_per_mm": 0.05, "mu_s_per_mm": 5.0}
    led = {"name": "beam", "wavelength_nm": 800.0, "pattern": "pencil"}
    photodiode = {"name": "square", "aperture": True, "position_mm": [2.0, 0.0]}
    tables = [("[phantom]", faces), *(("[[phantom.layers]]", layer | values) for values in layers)]
    tables += [("[[leds]]", led | values) for values in leds]
    tables += [("[[photodiodes]]", photodiode | values) for values in photodiodes]
    return _toml(tables)


def _toml(tables: Sequence[tuple[str, dict[str, Any]]]) -> str:
    lines = ["schema_version = 1"]
    for header, values in tables:
        # JSON writes numbers, texts and lists as TOML does, but for those that are not finite.
        lines += [header, *(f"{k} = {v if isinstance(v, float) else json.dumps(v)}" for k, v in values.items())]
    return "\n".join(lines) + "\n"


# A scene on a board of KiCad beside it, with an LED and a photodiode; more of [board], the photodiode and parts.
ON_KICAD_BOARD = """
schema_version = 1
[finger]
[board]
kicad = "x.kicad_pcb"
barrier = false
{board}
[board.parts]
D1 = {{ led = "led_660" }}
PD1 = {{ photodiode = "pd_array_4x1", elements = 1, size_mm = [1.0, 0.5]{diode} }}
{parts}
"""

"""A sensor on a finger, and one that varies, for the geometry's tests."""

import pytest

from nailoptics.geometry import Geometry, build
from nailoptics.scene import Scene, parse_scene


def sensor(
    *,
    finger: str = "",
    board: str = "",
    leds: tuple[tuple[float, float], ...] = ((-1.2, 0.0), (-1.2, 0.6)),
    **photodiode: object,
) -> Scene:
    """LEDs of 0.25 mm at the given places beside an array of 1 x 0.25 mm elements."""
    table = {"position_mm": [0.0, 0.0], "elements": 32, "wired": [2, 6, 10, 14, 18, 22, 26, 30]} | photodiode
    text = f"schema_version = 1\n[finger]\n{finger}\n[board]\n{board}\n"
    for i, (u, v) in enumerate(leds):
        text += f'[[leds]]\nname = "led{i}"\nwavelength_nm = 800.0\nposition_mm = [{float(u)}, {float(v)}]\n'
    text += '[[photodiodes]]\nname = "pd"\nsize_mm = [1.0, 0.25]\n'
    return parse_scene(text + "\n".join(f"{key} = {value}" for key, value in table.items()))


@pytest.fixture(scope="session")
def geometry() -> Geometry:
    """The prototype's kind of sensor on an index finger."""
    return build(sensor())


@pytest.fixture(name="sensor", scope="session")
def sensor_fixture() -> object:
    """The function that makes sensors."""
    return sensor

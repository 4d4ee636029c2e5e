"""The prototype's geometry, for files that other programs read."""

import pytest

from nailoptics.assets import data_dir
from nailoptics.geometry import Geometry, build
from nailoptics.scene import load_scene


@pytest.fixture(scope="session")
def geometry() -> Geometry:
    """The shipped prototype on its index finger."""
    return build(load_scene(data_dir("scenes") / "prototype.toml"))

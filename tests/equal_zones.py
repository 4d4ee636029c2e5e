"""A nail bed that is cut into equal units."""

import numpy as np

from nailoptics.hemodynamics import Zones, zones_between


def equal_zones(count: int, *, decay_length: float | None = None) -> Zones:
    """Equal units along the nail; without decay the distal half of an even number feels all of the distal pressure."""
    if decay_length is not None:
        return zones_between(np.arange(1, count) / count, decay_length=decay_length)
    reach = ((0.0, 0.0),) * (count // 2) + ((0.0, 1.0),) * (count // 2)
    return Zones(share=(2.0 / count,) * count, reach=reach, vein_reach=(1.0, 0.0))

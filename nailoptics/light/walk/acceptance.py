"""How photodiodes weigh light by its angle, where they do otherwise than a flat face, which weighs all alike."""

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...scene import Photodiode
from .arithmetic import clip, minimum

# Steps of a table over the squared cosine, in which a Lambertian photodiode's light is spread evenly.
STEPS = 1024


def acceptance_table(photodiode: Photodiode) -> np.ndarray:
    """What a photodiode makes of a photon at equal steps of the squared cosine, 0 to 1, (STEPS + 1,) float.

    A beam of one irradiance across itself sends its cosine's part through a flat face, so that a photon counts as the
    angular response over the cosine, linear in the angle between the rows, nothing beyond the last one.
    """
    assert photodiode.angular_response is not None
    angle, relative = np.array([row for row in photodiode.angular_response if row[0] < 90]).T
    counts = relative / np.cos(np.radians(angle))
    # Rows down to 90 degrees keep the last ratio: there both the response and the cosine are none.
    beyond = counts[-1] if photodiode.angular_response[-1][0] == 90 else 0.0
    at = np.degrees(np.arccos(np.sqrt(np.linspace(0, 1, STEPS + 1))))
    return np.interp(at, angle, counts, right=beyond)


def accepted(photodiode: Photodiode, cos: np.ndarray) -> np.ndarray:
    """What a photodiode makes of photons that meet it, or leave it as they would meet it, at angles, (n,) float."""
    if photodiode.angular_response is None:
        return np.ones(len(cos))
    table = acceptance_table(photodiode).astype(np.float32)
    return np.interp(cos**2, np.linspace(0, 1, STEPS + 1), table)


class Acceptance:
    """Tables of several photodiodes, one after the other, as a walk reads them; (photodiodes, STEPS + 1) float."""

    def __init__(self, tables: np.ndarray) -> None:
        self.tables = mi.Float(tables.ravel().astype(np.float32))
        dr.make_opaque(self.tables)

    def of(self, photodiode: Any, cos: Any, active: Any) -> Any:
        """What a photodiode makes of light at an angle."""
        place = clip(cos * cos, 0, 1) * STEPS
        cell = minimum(mi.UInt32(place), STEPS - 1)
        at = photodiode * (STEPS + 1) + cell
        low, high = dr.gather(mi.Float, self.tables, at, active), dr.gather(mi.Float, self.tables, at + 1, active)
        return dr.lerp(low, high, place - mi.Float(cell))


def acceptance_of(photodiodes: Sequence[Photodiode]) -> Acceptance | None:
    """The acceptance of every element of a scene's photodiodes, as its geometry orders them; None if all are flat."""
    if all(one.angular_response is None for one in photodiodes):
        return None
    flat = np.ones(STEPS + 1)
    tables = [flat if one.angular_response is None else acceptance_table(one) for one in photodiodes]
    read = [len(one.wired or range(one.elements)) for one in photodiodes]
    return Acceptance(np.repeat(tables, read, axis=0))

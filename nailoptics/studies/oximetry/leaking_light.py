"""How much of the light from outside reaches each photodiode of a scene, through finger and board."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...light.board_map import BoardTracer
from ...light.identity import light_scene
from ...light.store import LightStore
from ...scene import Oximeter, Scene
from ...statistics import seed_of
from ..ambient import SOURCES, Ambient, photocurrents_a

Array = NDArray[np.float64]

# Photons that each photodiode sends back out: a leak of 1e-4 is then known within a few parts in ten.
PHOTONS = 1 << 16
DISTANCE_MM = 0.2
_BACK = 31


@dataclass(frozen=True)
class Leak:
    """Photocurrent by light from outside and its standard error, (photodiodes,) float each. [A]"""

    current_a: Array
    stderr_a: Array

    def at_lux(self, lux: float, of_lux: float) -> "Leak":
        """The same at another illuminance."""
        return Leak(self.current_a * lux / of_lux, self.stderr_a * lux / of_lux)


def source_of(oximeter: Oximeter) -> Ambient:
    """The light from outside that an oximeter's table names."""
    named = next(source for source in SOURCES if source.name == oximeter.ambient_light)
    return replace(named, lux=oximeter.ambient_lux)


def leaks(
    scene: Scene,
    sources: list[Ambient],
    *,
    backend: str,
    seed: int,
    photons: int = PHOTONS,
    store: LightStore | None = None,
) -> list[Leak]:
    """What each light from outside makes of every photodiode, by reciprocity: from one trace of each photodiode's own.

    Where none of n photons left, the error is that of the one photon that may have.

    store : where light is looked for, and kept.
    """
    how: dict[str, Any] = {"backend": backend, "store": store, "seed": seed}
    tracer, rows = BoardTracer(light_scene(scene), spacing_mm=DISTANCE_MM, **how), []
    traced_nm = max(led.wavelength_nm for led in scene.leds)
    led = next(i for i, one in enumerate(scene.leds) if one.wavelength_nm == traced_nm)
    for j, element in enumerate(scene.layout.photodiodes):
        _, left = tracer.back(j, led, photons=photons, seed=seed_of(seed, _BACK, j))
        diode, area = element.photodiode, element.area.area_mm2
        for source in sources:
            light: dict[str, Any] = {"traced": tracer.scene, "traced_nm": traced_nm}
            each = photocurrents_a(left, scene, source, photodiode=diode, area_mm2=area, **light)
            whole = area * float(source.photocurrent_a_per_mm2(diode)[1].sum())
            one = float(each.max(initial=0.0)) or whole / photons
            total, square = float(each.sum()), float((each**2).sum())
            rows.append((total, np.sqrt(max(square - total**2 / photons, one**2))))
    found = np.array(rows).reshape(len(scene.layout.photodiodes), len(sources), 2)
    return [Leak(found[:, k, 0], found[:, k, 1]) for k in range(len(sources))]

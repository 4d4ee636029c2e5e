"""Stock Mitsuba on a finger scene from one small pass: what it reads, how noisy it is, and what its paths cost."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ... import geometry
from ...light import backend as backends
from ...light import optics
from ...light.reference.integrate import FingerPaths
from ...light.reference.led_readings import bed_absorption
from ...light.reference.mitsuba_scene import check_pattern
from ...options import BackendName
from ...scene import Scene
from ...scene.parts import check_flat
from ...statistics import FEW_TERMS, seed_of

# Photodiodes that share a pass, told apart by its colours.
TOGETHER = 3


@dataclass(frozen=True)
class StockPass:
    """One pass over every LED and photodiode at rest, at each LED's peak wavelength.

    level, stderr : (led, photodiode) float. Fractions of the emitted power, and their spread over the pass.
    setup_seconds : processor time before the pass: geometry, media, kernels, finding how many paths fit.
    path_seconds : processor time of the pass itself, all of it warm.
    """

    level: np.ndarray
    stderr: np.ndarray
    setup_seconds: float
    path_seconds: float

    @classmethod
    def of(
        cls, scene: Scene, *, backend: BackendName, seconds: float, seed: int, check: Callable[[], None] = lambda: None
    ) -> "StockPass":
        """Trace for about so many seconds; check is called before every part, to raise where there is no time for it.

        Raises: InputError for an LED with a measured pattern, or a photodiode with an angular response.
        """
        begin, warm = time.process_time(), 0.0
        chosen, finger = backends.choose(backend, volpath=True), geometry.build(scene)
        rest = np.full((1, optics.zones(scene).count), scene.blood.rest_blood_fraction)
        count = len(finger.photodiodes)
        groups = [tuple(range(start, min(start + TOGETHER, count))) for start in range(0, count, TOGETHER)]
        found = np.zeros((2, len(scene.leds), count))
        for led, source in enumerate(scene.leds):
            check_pattern(source)
            check_flat(scene.photodiodes, "volpath")
            media = optics.finger_media(scene, finger.regions, source.wavelength_nm)
            bed = bed_absorption(scene, finger, rest, led)
            for number, group in enumerate(groups):
                check()
                paths = FingerPaths(finger, media, bed=bed, led=led, photodiodes=group, backend=chosen)
                wanted = paths.paths_for(seconds / len(groups) / len(scene.leds))
                cpu = time.process_time()
                found[:, led, list(group)] = paths.spread(paths=wanted, seed=seed_of(seed, led, number))
                warm += time.process_time() - cpu
        return cls(found[0], found[1], time.process_time() - begin - warm, warm)

    @property
    def effective_paths(self) -> float:
        """Paths of equal weight that would spread as those of all photodiodes do."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return float(np.nan_to_num((self.level / self.stderr) ** 2).sum())

    def relative_stderr(self, expected: np.ndarray) -> np.ndarray:
        """Relative standard error of each reading, (led, photodiode) float.

        Where a photodiode saw too few paths to tell its own, it is that of all: a variance in proportion to the
        reading, as where paths weigh alike.

        expected : what the photodiodes read by a trace that knows it better.
        """
        shared = np.sqrt((self.stderr**2).sum() / expected.sum() / expected)
        with np.errstate(divide="ignore", invalid="ignore"):
            own = self.stderr / self.level
            return np.where(own**2 * FEW_TERMS <= 1, own, shared)

"""The colour of a nail where no backend compiles kernels: stock Mitsuba looks at every place, state and wavelength."""

import logging
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...light.backend import Backend
from ...light.reference.mitsuba_scene import FILM
from ...light.reference.nail_camera import NailCamera
from ...light.tracing import StageProgress
from ...light.walk.nail_reflectance import as_seen
from ...options import TraceOptions
from ...scene import Scene, Viewing
from ...scene.viewing import LightFrom
from ...statistics import left_out, seed_of
from .colorimetry import WAVELENGTHS_NM
from .enough_rays import Places
from .reflectance import GROUPS

log = logging.getLogger(__name__)

Array = NDArray[np.float64]

# Where haemoglobin's bands turn, and few beyond them: between these reflectance is taken for linear. [nm]
SEEN_NM = np.array([400, 415, 430, 450, 475, 500, 515, 530, 542, 550, 560, 570, 577, 588, 600, 620, 660, 720, 780.0])
# Blood states that travel as the colours of one path.
AT_ONCE = 3
# A relative error of every wavelength's reflectance makes so many times as large an error of colour. [CIEDE2000]
COLOUR_PER_ERROR = 30.0
# Samples of a pixel with which time and error are foreseen.
PILOT_SPP = 2


class StockSight:
    """Reflectance of places as `ColourRays` tells it, seen anew by volpath for whatever states are asked for."""

    def __init__(
        self, scene: Scene, places: Places, viewing: Viewing, options: TraceOptions, stage: StageProgress, by: Backend
    ) -> None:
        if viewing.lit_by != "sky":
            raise InputError('colour.lit_by = "lamp" needs a backend that compiles kernels; take "sky".')
        self.patches, self.stage, self.seed = places.patches, stage, options.seed
        self.camera = NailCamera(as_seen(scene), places.patches, groups=GROUPS, backend=by)
        self.renders = len(SEEN_NM) * math.ceil((len(viewing.forces_n) + 1) / AT_ONCE)
        paths = self.renders * len(places.patches) * FILM**2
        pilot = self.camera.see(545.0, np.full((1, _zones(scene)), 0.03), spp=PILOT_SPP, seed=options.seed)
        error = float((pilot.std(0, ddof=1) / pilot.mean(0)).max() / math.sqrt(GROUPS))
        needed = PILOT_SPP * (COLOUR_PER_ERROR * error / viewing.tolerance) ** 2
        if options.photons is not None:
            needed = options.photons / paths
        each = self.camera.seconds_per_path * paths
        within = needed if options.max_seconds is None else min(needed, options.max_seconds / each)
        self.spp = max(round(within), 1)
        self.photons = self.spp * paths
        log.warning(
            "no backend here compiles kernels, so stock Mitsuba looks at %d places: about %.2g minutes; a looser "
            "--tolerance or --max-seconds ends it sooner",
            len(places.patches),
            self.spp * each / 60,
        )

    def reflectance(
        self, states: Array, *, lit_by: LightFrom, gloss: bool, patches: Sequence[int] | None = None, **_: Any
    ) -> Array:
        """As `ColourRays.reflectance`."""
        seen = np.empty((GROUPS, len(self.patches), len(states), len(SEEN_NM)))
        done = 0
        for q, wavelength_nm in enumerate(SEEN_NM):
            for first in range(0, len(states), AT_ONCE):
                some, seed = states[first : first + AT_ONCE], seed_of(self.seed, q, first)
                seen[:, :, first : first + AT_ONCE, q] = self.camera.see(
                    float(wavelength_nm), some, spp=self.spp, seed=seed
                )
                done += 1
                self.stage("colour", done / self.renders)
        if not gloss:
            seen -= self.camera.mirror(spp=4 * self.spp, seed=seed_of(self.seed, len(SEEN_NM)))[:, :, None, None]
        wanted = slice(None) if patches is None else list(patches)
        at = np.array([np.interp(WAVELENGTHS_NM, SEEN_NM, row) for row in np.eye(len(SEEN_NM))])
        return left_out(seen[:, wanted] @ at)


def _zones(scene: Scene) -> int:
    return len(scene.zone_edges_mm) + 1

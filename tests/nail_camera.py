"""Stock Mitsuba's view of a bare nail from above, under an even sky: the reference for the traced colours."""

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nailoptics import geometry as finger_geometry
from nailoptics.light import optics
from nailoptics.light.backend import Backend
from nailoptics.light.reference.mitsuba_scene import FILM, RGB_FILM, BedAbsorption, finger_scene
from nailoptics.light.reference.readings import SEEDS, stock_mitsuba
from nailoptics.light.walk.nail_reflectance import Patch
from nailoptics.scene import Scene
from nailoptics.statistics import seed_of

# Cameras look from so far above the nail, and the bed's absorption is given on so many places. [mm, 1]
ABOVE_MM, BED_PLACES = 2.0, 201


class NailCamera:
    """Reflectance factors of patches of a bare nail by volpath, in up to three blood states at once.

    scene : with what an eye sees (`nail_reflectance.as_seen`).
    groups : of independent paths, by whose spread errors are estimated; FILM^2 is a multiple of it.
    """

    def __init__(self, scene: Scene, patches: Sequence[Patch], *, groups: int, backend: Backend) -> None:
        self.scene, self.patches, self.groups, self.backend = scene, tuple(patches), groups, backend
        self.mesh = finger_geometry.build(scene, board=False)

    def see(self, wavelength_nm: float, states: NDArray[np.float64], *, spp: int, seed: int) -> NDArray[np.float64]:
        """What each patch sends back, gloss included, (groups, patches, states) float.

        states : (s, zones) float, up to three. Blood in each zone of the bed. [1]
        """
        media = optics.finger_media(self.scene, self.mesh.regions, wavelength_nm)
        mu_a = optics.absorption(self.scene, wavelength_nm, blood_fraction=states)[:, 0]
        zones = optics.zones(self.scene)
        low, high = np.asarray(self.mesh.bounds_mm)[:, 1]
        v_mm = np.linspace(low - 0.2, high + 0.2, BED_PLACES)
        bed = BedAbsorption(v_mm, mu_a[:, list(optics.bed_columns(self.scene))] @ zones.weights(v_mm).T)
        return self._render(media, bed, spp=spp, seed=seed)[..., : len(states)]

    def _render(self, media: optics.Media, bed: BedAbsorption, *, spp: int, seed: int) -> NDArray[np.float64]:
        """Radiance of each patch over that of the sky, in three colours, (groups, patches, 3) float."""
        result = []
        with stock_mitsuba(self.backend) as mi, tempfile.TemporaryDirectory(prefix="nailoptics-") as folder:
            made = finger_scene(mi, self.mesh, media, bed, sensor=-1, emitters={}, folder=Path(folder))
            made["sky"] = {"type": "constant", "radiance": {"type": "rgb", "value": 1.0}}
            made |= {f"camera_{i}": _camera(mi, patch) for i, patch in enumerate(self.patches)}
            loaded = mi.load_dict(made, optimize=False)
            for i in range(len(self.patches)):
                image = mi.render(loaded, sensor=i, spp=spp, seed=seed_of(seed, i) % SEEDS)
                result.append(np.array(image, dtype=float).reshape(-1, 3))
        # Pixels of a group lie all over the patch, so that groups differ by chance alone.
        pixels = np.random.default_rng(0).permutation(FILM**2).reshape(self.groups, -1)
        return np.stack(result)[:, pixels].mean(2).swapaxes(0, 1)


def _camera(mi: Any, patch: Patch) -> dict[str, Any]:
    """A camera that sees a patch from above."""
    (u, v), (wide, tall) = patch.center_mm, patch.size_mm
    look = mi.ScalarTransform4f().look_at(origin=[u, v, ABOVE_MM], target=[u, v, 0.0], up=[0, 1, 0])
    return {
        "type": "orthographic",
        "near_clip": 1e-3,
        "to_world": look @ mi.ScalarTransform4f().scale([wide / 2, tall / 2, 1]),
        "film": RGB_FILM,
    }

"""The uncertainty of a finger's colour at rest due to the unknown parameters of its nail, its bed and its skin."""

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from ...hemodynamics.for_scene import steady_blood
from ...light.identity import light_digest
from ...light.walk.nail_reflectance import NailReflectance
from ...scene import Scene, Viewing
from ...statistics import seed_of
from ...variables import variable
from ..prior_uncertainty import only_absorbs, over_priors
from .adaptive_sampling import Places, view
from .colorimetry import Viewer
from .reflectance import ColourRays, walk_colour

Array = NDArray[np.float64]

# Rays of all nodes for each value of what needs rays of its own, such as scattering.
OWN_PHOTONS = 24_000
_SPREAD = 61


def spread_of_colours(
    nail: NailReflectance, rays: ColourRays, places: Places, viewer: Viewer, viewing: Viewing, *, seed: int
) -> xr.Dataset:
    """Standard deviation of L*, a* and b* over each prior of the scene, and over all together.

    On the middle of the nail and on the skin behind it, at the first of the forces. What only absorbs is reread from
    the rays; what scatters is walked anew, with the same random numbers at each of its values. The thickness of the bed
    is left out.
    """
    scene, sites = nail.scene, (places.along // 2, 0)
    priors = [prior for prior in scene.priors.of_finger() if prior.field != "finger.bed_thickness_mm"]
    priors.sort(key=lambda prior: not only_absorbs(scene, prior))
    own = light_digest(scene)

    def lab(light: ColourRays, one: Scene, chosen: tuple[int, ...]) -> Array:
        states = steady_blood(one, viewing.forces_n[:1])
        read = light.reflectance(states, **view(viewing), scene=one, patches=chosen)
        return np.asarray(viewer.lab(read)[:, :, 0])

    def walked(one: Scene) -> Array:
        other = NailReflectance(one, backend=nail.backend, stores=nail.stores)
        patches = [places.patches[site] for site in sites]
        light = walk_colour(other, patches, photons=OWN_PHOTONS, seed=seed_of(seed, _SPREAD))
        return lab(light, one, (0, 1))

    base = lab(rays, scene, sites)
    twin = walked(scene)

    def answer(one: Scene) -> Array:
        return lab(rays, one, sites) if light_digest(one) == own else base + walked(one) - twin

    found = over_priors(scene, priors, answer)
    over = ("site", "band")
    data = found.variables("lab", over, "L*a*b* at the first force")
    text = "L*a*b* at the low, middle and high node of a prior"
    data |= variable("prior_lab", ("prior", "node", *over), found.nodes[:, :, 0], text)
    ends = [[p.low, p.high] for p in priors]
    data |= variable("prior_range", ("prior", "end"), ends, "ends of the range that holds with 95 %")
    names = {"prior": [p.name for p in priors], "site": ["nail", "skin"], "node": ["low", "middle", "high"]}
    return xr.Dataset(data, names)

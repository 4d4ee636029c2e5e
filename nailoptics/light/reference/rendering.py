"""The independent engine: paths by Mitsuba's stock volpath.

It shares nothing with the photon walk but the scene: absorption acts along the way through real participating media.
"""

import math
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...geometry import Geometry
from ...scene import Scene
from ..backend import NAMES, Backend, Name, activate
from ..optics import Media
from .mitsuba_scene import FILM, BedAbsorption, Window, channel_count, finger_scene, phantom_scene, spectral

# The rgb variants carry three plain floats, at the cost of one; the spectral ones four.
RGB: dict[Name, str] = {name: f"{name}_ad_rgb" for name in NAMES} | {"scalar": "scalar_rgb"}
SPECTRAL: dict[Name, str] = {name: f"{name}_ad_spectral" for name in NAMES} | {"scalar": "scalar_rgb"}
MAX_SPP, PIXELS = 10_000, FILM * FILM
# Mitsuba's seeds have 32 bits.
SEEDS = 1 << 32


@contextmanager
def stock_mitsuba(backend: Backend, variants: Mapping[Name, str] = RGB) -> Iterator[Any]:
    """Mitsuba in one of the variants that this engine needs; the one that was set before returns afterwards."""
    if "volpath" not in backend.engines:
        raise InputError(f"volpath cannot run on {backend.library}: its kernels abort there; take the scalar backend.")
    # Dr.Jit loads its library at import, so only `activate`, which knows the right one, may import it.
    loaded = sys.modules.get("mitsuba")
    before = loaded.variant() if loaded else None
    mi = activate(backend, variants)
    try:
        yield mi
    finally:
        if before and mi.variant() != before:
            mi.set_variant(before)


def _render(mi: Any, scene: Any, *, paths: int, seed: int) -> NDArray[np.float64]:
    """Mean of each channel over some paths, (channels,) float."""
    spp = max(1, math.ceil(paths / PIXELS))
    if spp > MAX_SPP:
        raise ValueError(f"{paths} paths in one batch lose counts in float32; at most {MAX_SPP * PIXELS}")
    image = np.array(mi.render(scene, spp=spp, seed=seed % SEEDS), dtype=np.float64)
    mean = image.reshape(-1, image.shape[-1]).mean(axis=0)
    if not np.isfinite(mean).all():
        raise FloatingPointError(f"volpath gave {mean}")
    return np.asarray(mean)


class Paths:
    """Traces one LED's light to up to four readings at once, three by the scalar backend.

    made : the scene of a Mitsuba, which may write meshes to a folder; channel k of its film is reading k.
    scale : (channels,) float. Fraction of the LED's power per channel.
    """

    def __init__(self, made: Callable[[Any, Path], dict[str, Any]], scale: Sequence[float], backend: Backend) -> None:
        self._backend, self._scale = backend, np.array(scale)
        folder = tempfile.TemporaryDirectory(prefix="nailoptics-")
        with stock_mitsuba(self._backend, SPECTRAL) as mi, folder as meshes:
            scene = made(mi, Path(meshes))
            self._scene = mi.load_dict(spectral(scene) if self._backend.jit else scene, optimize=False)

    def batch(self, *, paths: int, seed: int) -> NDArray[np.float64]:
        """Fractions of the LED's power from one batch, (channels,) float; kernels cannot be interrupted."""
        with stock_mitsuba(self._backend, SPECTRAL) as mi:
            return np.asarray(_render(mi, self._scene, paths=paths, seed=seed)[: len(self._scale)] * self._scale)


def phantom_paths(scene: Scene, windows: Sequence[Window], *, led: int = 0, backend: Backend) -> Paths:
    """An LED's light that leaves a phantom through as many windows as there are channels.

    Raises: InputError for an LED with a measured pattern.
    """
    assert scene.phantom is not None
    phantom, source = scene.phantom, scene.leds[led]
    # What is reciprocal is radiance over n squared. A beam reads the radiance that leaves along it; a die reads
    # irradiance, pi times as much.
    below = (phantom.n_below / phantom.n_above) ** 2
    read = 1.0 if source.pattern == "pencil" else math.pi
    scale = [(1.0 if window.top else below) / read for window in windows]
    return Paths(lambda mi, _: phantom_scene(mi, phantom, source, windows), scale, backend)


def finger_paths(
    geometry: Geometry, media: Media, *, bed: BedAbsorption, led: int, photodiodes: tuple[int, ...], backend: Backend
) -> Paths:
    """An LED's light on one photodiode of a finger in up to three blood states, or on as many as there are channels.

    media : optics of its regions, mu_a and mu_s (r,) float, or (r, LINE_POINTS) along the LED's line where the backend
        is not scalar; the bed's own mu_a is not used.
    bed : absorption of the bed along the nail in each state.
    led, photodiodes : indices into geometry.leds, whose light is taken to be Lambertian, and geometry.photodiodes;
        several only with one state.
    """
    channels, die = max(len(bed.mu_a_per_mm), len(photodiodes)), geometry.leds[led]
    colour = np.eye(channel_count(SPECTRAL[backend.name]))
    colours = {geometry.photodiodes[p].region: colour[i].tolist() for i, p in enumerate(photodiodes)}
    if len(photodiodes) == 1:
        colours = dict.fromkeys(colours, [1.0] * len(colour))

    def made(mi: Any, folder: Path) -> dict[str, Any]:
        return finger_scene(mi, geometry, media, bed, sensor=die.region, emitters=colours, folder=folder)

    # Irradiance E under radiance 1 gives a throughput E A; a Lambertian die of radiance 1 emits pi A.
    return Paths(made, [1 / math.pi] * channels, backend)

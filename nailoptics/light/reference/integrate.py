"""The independent engine: Mitsuba's stock volpath, traced from the LED back to the photodiode.

It shares nothing with the photon walk but the scene: absorption acts along the way through real participating media,
and up to three blood states travel as the three colours of one path, so that their difference carries little noise.
Where no JIT backend works it does the main job in the scalar variant.
"""

import math
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...geometry import Geometry
from ...scene import Scene
from ...statistics import seed_of
from ..backend import Backend, Name, activate, choose
from ..optics import Media
from .mitsuba_scene import FILM, BedAbsorption, Window, finger_scene, phantom_scene

# The rgb variants carry three plain floats, at the cost of one.
VARIANTS: dict[Name, str] = {"cuda": "cuda_ad_rgb", "llvm": "llvm_ad_rgb", "scalar": "scalar_rgb"}
PIXELS = FILM * FILM
MAX_SPP = 10_000
# Mitsuba's seeds have 32 bits.
SEEDS = 1 << 32


@contextmanager
def stock_mitsuba(backend: Backend | None) -> Iterator[Any]:
    """Mitsuba in the variant that this engine needs; the one that was set before returns afterwards."""
    backend = backend or choose(volpath=True)
    if "volpath" not in backend.engines:
        raise InputError(f"volpath cannot run on {backend.library}: its kernels abort there; take the scalar backend.")
    # Dr.Jit loads its library at import, so only `activate`, which knows the right one, may import it.
    loaded = sys.modules.get("mitsuba")
    before = loaded.variant() if loaded else None
    mi = activate(backend, VARIANTS)
    try:
        yield mi
    finally:
        if before:
            mi.set_variant(before)


def _render(mi: Any, scene: Any, *, paths: int, seed: int) -> NDArray[np.float64]:
    """Mean of each colour over some paths, (3,) float."""
    spp = max(1, math.ceil(paths / PIXELS))
    if spp > MAX_SPP:
        raise ValueError(f"{paths} paths in one batch lose counts in float32; at most {MAX_SPP * PIXELS}")
    image = np.array(mi.render(scene, spp=spp, seed=seed % SEEDS), dtype=np.float64)
    mean = image.reshape(-1, image.shape[-1]).mean(axis=0)
    if not np.isfinite(mean).all():
        raise FloatingPointError(f"volpath gave {mean}")
    return np.asarray(mean)


def phantom_fractions(
    scene: Scene,
    windows: Sequence[Window],
    *,
    led: int = 0,
    batches: int,
    paths_per_batch: int,
    seed: int,
    backend: Backend | None = None,
) -> NDArray[np.float64]:
    """The fraction of an LED's power that leaves a phantom through up to three windows, (batches, windows) float.

    Raises: InputError for an LED with a measured pattern.
    """
    assert scene.phantom is not None
    phantom, source = scene.phantom, scene.leds[led]
    # What is reciprocal is radiance over n squared.
    scale = np.array([1.0 if window.top else (phantom.n_below / phantom.n_above) ** 2 for window in windows])
    # A beam reads the radiance that leaves along it; a die reads irradiance, pi times as much.
    scale /= 1.0 if source.pattern == "pencil" else math.pi
    with stock_mitsuba(backend) as mi:
        loaded = mi.load_dict(phantom_scene(mi, phantom, source, windows), optimize=False)
        colours = np.stack([_render(mi, loaded, paths=paths_per_batch, seed=seed_of(seed, k)) for k in range(batches)])
    return np.asarray(colours[:, : len(windows)] * scale)


class FingerPaths:
    """Traces one LED of a finger to one photodiode in up to three blood states, or to up to three in one state.

    geometry : the finger.
    media : optics of its regions; the bed's own mu_a is not used.
    bed : absorption of the bed along the nail in each state.
    led, photodiodes : indices into geometry.leds, whose light is taken to be Lambertian, and geometry.photodiodes;
        several only with one state.
    """

    def __init__(
        self,
        geometry: Geometry,
        media: Media,
        *,
        bed: BedAbsorption,
        led: int,
        photodiodes: tuple[int, ...],
        backend: Backend | None = None,
    ) -> None:
        states = len(bed.mu_a_per_mm)
        if not 1 <= len(photodiodes) <= 3 or (len(photodiodes) > 1 and states > 1):
            raise ValueError("three colour channels can separate states or photodiodes, not both")
        self.channels, die = max(states, len(photodiodes)), geometry.leds[led]
        colours = {geometry.photodiodes[p].region: [float(i == k) for k in range(3)] for i, p in enumerate(photodiodes)}
        if len(photodiodes) == 1:
            colours = dict.fromkeys(colours, [1.0, 1.0, 1.0])
        self._backend = backend or choose(volpath=True)
        with stock_mitsuba(self._backend) as mi, tempfile.TemporaryDirectory(prefix="nailoptics-") as folder:
            made = finger_scene(mi, geometry, media, bed, sensor=die.region, emitters=colours, folder=Path(folder))
            self._scene = mi.load_dict(made, optimize=False)

    def batch(self, *, paths: int, seed: int) -> NDArray[np.float64]:
        """Detected fraction of the LED's power in each state or photodiode from one batch, (channels,) float.

        Cannot be interrupted where kernels are compiled: ask `paths_for` how many paths a second or two can hold.
        """
        with stock_mitsuba(self._backend) as mi:
            # Irradiance E under radiance 1 gives a throughput E A; a Lambertian die of radiance 1 emits pi A.
            return _render(mi, self._scene, paths=paths, seed=seed)[: self.channels] / math.pi

    def paths_for(self, seconds: float) -> int:
        """How many paths take about this long; measured, and rounded to whole samples per pixel."""
        paths = 4 * PIXELS
        self.batch(paths=paths, seed=0)  # compiles kernels
        while True:
            start = time.perf_counter()
            self.batch(paths=paths, seed=1)
            spent = time.perf_counter() - start
            if spent > 0.1 * seconds or paths >= MAX_SPP * PIXELS:
                batch_paths = int(paths * seconds / max(spent, 1e-6)) // PIXELS * PIXELS
                return min(max(batch_paths, PIXELS), MAX_SPP * PIXELS)
            paths *= 4

"""A map of the light on the whole board plane, for whoever looks for a photodiode's place."""

import numpy as np
import xarray as xr

from ..errors import InputError
from ..scene import Scene
from ..scene.layout import lay_out
from . import backend as backends
from .transfer import provenance, stderr_of_mean


def map_board(
    scene: Scene, *, photons: int = 1_000_000, seed: int = 0, backend: str = "auto", spacing_mm: float = 0.1
) -> xr.Dataset:
    """Trace where each LED's light arrives on the underside of the board, at rest.

    Where a photodiode would lie, the map's integral is what it would read, but for the few percent of light that the
    bare board sends back and that then arrives again.

    Parameters
    ----------
    spacing_mm : size of the map's cells. [mm]

    Returns: Dataset over led, u (across) and v (along the nail, towards the tip): irradiance and its standard error, as
    fractions of the emitted power per area. [mm^-2]

    Raises: InputError for a phantom, a bad spacing, or without a JIT backend.
    """
    if scene.finger is None:
        raise InputError("map_board needs a [finger] scene; a phantom has no board, give it apertures.")
    if not 0.01 <= spacing_mm <= 2:
        raise InputError(f"spacing_mm = {spacing_mm:g} must lie in 0.01 to 2.")
    chosen = backends.choose(backend)
    if not chosen.jit:
        raise InputError(f"map_board needs a JIT backend, and {chosen.name} is none: {chosen.advice}")
    backends.activate(chosen)
    from .mesh import BoardMap, MeshTracer

    outline = lay_out(scene).outline
    u = np.arange(outline.u_min + spacing_mm / 2, outline.u_max, spacing_mm)
    v = np.arange(outline.v_min + spacing_mm / 2, outline.v_max, spacing_mm)
    tracer = MeshTracer(scene)
    values, errors = [], []
    for led in range(len(scene.leds)):
        board = BoardMap(tracer.shape, u, v)
        seeds = np.random.SeedSequence(seed, spawn_key=(led,)).generate_state(
            -(-photons // tracer.batch_photons), np.uint64
        )
        for i, one in enumerate(seeds):
            size = min(tracer.batch_photons, photons - i * tracer.batch_photons)
            tracer.walk(led, photons=size, seed=int(one), board=board)
        weight, square = board.sums()
        values.append(weight / photons / spacing_mm**2)
        errors.append(stderr_of_mean(weight, square, photons) / spacing_mm**2)
    text = "irradiance of the board's underside per emitted power"
    return xr.Dataset(
        {
            "irradiance": (
                ("led", "u", "v"),
                values,
                {"units": "mm-2", "long_name": text, "ancillary_variables": "irradiance_stderr"},
            ),
            "irradiance_stderr": (
                ("led", "u", "v"),
                errors,
                {"units": "mm-2", "long_name": f"standard error of the {text}"},
            ),
        },
        coords={
            "led": [led.name for led in scene.leds],
            "u": ("u", u, {"units": "mm", "long_name": "across the nail, on the flat board"}),
            "v": ("v", v, {"units": "mm", "long_name": "along the nail, towards the tip"}),
        },
        attrs=provenance(
            scene, engine="photons", backend=chosen.name, photons=photons * len(scene.leds), seeds=str(seed)
        ),
    )

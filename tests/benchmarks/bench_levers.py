"""Ways to read more with as many photons: which of them pay. Run: python bench_levers.py

On the photodiode-sized reading of a slab (10 mm, mu_a 0.05, mu_s 10 per mm, g 0.9, matched; 1 x 1 mm, 2 mm from a
pencil beam), with a small walk of its own: analog; next-event estimation; that with multiple importance sampling of
direction; quasi-random numbers for the first step and direction. On the prototype: splitting near the photodiodes.
Printed: figures of merit 1 / (relative error^2 CPU
seconds), as ratios to the plain way in the same run; errors are those of independent batches, which assume nothing.
"""

import math
import time
from collections.abc import Callable

import drjit as dr
import numpy as np

import nailoptics as nail
from nailoptics.assets import data_dir
from nailoptics.light import backend

backend.activate(backend.choose("auto"))
import mitsuba as mi  # noqa: E402

from nailoptics.light.walk.finger import FingerTracer  # noqa: E402
from nailoptics.light.walk.interfaces import DETECTED  # noqa: E402
from nailoptics.light.walk.sampling import henyey_greenstein, rotate_direction  # noqa: E402

THICKNESS_MM, MU_A, MU_S, G = 10.0, 0.05, 10.0, 0.9
LOW, HIGH = (1.5, -0.5), (2.5, 0.5)
BATCHES, PHOTONS = 64, 1 << 17
# Shares of the golden ratio's sequence in three dimensions (M. Roberts, 2018): the root of x^4 = x + 1, to its powers.
GOLDEN = 1 / 1.2207440846057596 ** np.arange(1, 4)


@dr.syntax
def slab(seed: int, next_event: bool, importance: bool, quasi: bool) -> mi.Float:
    """Score of each photon, (PHOTONS,) float; the mean is the detected fraction."""
    rng = mi.PCG32(size=PHOTONS, initstate=dr.opaque(mi.UInt64, seed))
    F = mi.Float
    p, w = mi.Point3f(dr.zeros(F, PHOTONS), 0, 0), mi.Vector3f(dr.zeros(F, PHOTONS), 0, 1)
    absorption_path = -dr.log(1 - rng.next_float32()) / MU_A
    first = [rng.next_float32(), rng.next_float32(), rng.next_float32()]
    if dr.hint(quasi, mode="scalar"):
        shift = np.random.default_rng(seed).random(3)
        places = (shift + np.arange(PHOTONS)[:, None] * GOLDEN) % 1
        first = [F(column.astype(np.float32)) for column in places.T]
    score, scattered, density = dr.zeros(F, PHOTONS), dr.zeros(mi.UInt32, PHOTONS), dr.zeros(F, PHOTONS)
    active = dr.full(mi.Bool, True, PHOTONS)
    while active:
        start = scattered == 0
        step = -dr.log(1 - dr.select(start, first[0], rng.next_float32())) / MU_S
        at = mi.Point3f(p + w * step)
        surface = dr.select(w.z < 0, -p.z / w.z, dr.select(w.z > 0, (THICKNESS_MM - p.z) / w.z, 1e9))
        leaves = step > surface
        absorption_path -= dr.minimum(step, surface)
        x, y = p.x + w.x * surface, p.y + w.y * surface
        detected = (
            leaves & (w.z < 0) & (absorption_path > 0) & (x > LOW[0]) & (x < HIGH[0]) & (y > LOW[1]) & (y < HIGH[1])
        )
        if dr.hint(not next_event, mode="scalar"):
            score += dr.select(detected, F(1), 0)
        elif dr.hint(importance, mode="scalar"):
            # Chosen with the same probability by a point on the aperture: distance^2 / cosine, of 1 mm^2.
            by_area = surface * surface / -w.z
            score += dr.select(detected, density / (density + by_area), 0)
        p = at
        active &= ~leaves & (absorption_path > 0)
        if dr.hint(next_event, mode="scalar"):
            to = mi.Vector3f(LOW[0] + rng.next_float32() - p.x, LOW[1] + rng.next_float32() - p.y, -p.z)
            r = dr.norm(to)
            cos = dr.dot(w, to) / r
            phase = (1 - G * G) / (4 * dr.pi * (1 + G * G - 2 * G * cos) ** 1.5)
            by_area = r * r * r / p.z
            odds = phase / by_area
            if dr.hint(importance, mode="scalar"):
                odds = phase / (by_area + phase)
            score += dr.select(active, odds * dr.exp(-(MU_A + MU_S) * r), 0)
        u = dr.select(start, first[1], rng.next_float32())
        phi = 2 * dr.pi * dr.select(start, first[2], rng.next_float32())
        cos = henyey_greenstein(F(G), u)
        density = (1 - G * G) / (4 * dr.pi * (1 + G * G - 2 * G * cos) ** 1.5)
        w = mi.Vector3f(rotate_direction(w, cos, phi))
        scattered += 1
    return score


def merit(batch: Callable[[int], float]) -> tuple[float, float, float]:
    """Mean of batches by seed, its standard error, and figure of merit per CPU second."""
    batch(0)  # compiles
    start = time.process_time()
    values = np.array([batch(seed) for seed in np.random.default_rng(1).integers(1 << 60, size=BATCHES)])
    spent = time.process_time() - start
    mean, error = values.mean(), values.std(ddof=1) / math.sqrt(BATCHES)
    return mean, error, (mean / error) ** 2 / spent


def main() -> None:
    """Print a row per lever; ratios of figures of merit from 64 batches have a standard error of 25 %."""
    plain = None
    for name, how in (
        ("analog", (False, False, False)),
        ("next-event estimation", (True, False, False)),
        ("  with importance sampling", (True, True, False)),
        ("quasi-random first direction", (False, False, True)),
    ):
        mean, error, figure = merit(lambda seed, how=how: float(dr.mean(slab(int(seed), *how))[0]))
        plain = plain or figure
        row(f"slab      {name}", mean, error, figure / plain)
    finger()


def finger() -> None:
    """The same for the prototype's photodiodes, one by one."""
    scene = nail.load_scene(data_dir("scenes") / "prototype.toml")
    tracer = FingerTracer(scene)
    names, count = tracer.photodiodes, len(tracer.photodiodes)

    def split(seed: int) -> np.ndarray:
        batch = tracer.batch(0, photons=PHOTONS, seed=int(seed))
        return np.bincount(batch.photodiode, batch.weight, minlength=count) / PHOTONS

    def unsplit(seed: int) -> np.ndarray:
        walked = tracer.walk(0, photons=PHOTONS, seed=int(seed))
        ended = walked.outcome >= DETECTED
        return np.bincount(walked.outcome[ended] - DETECTED, walked.weight[ended], minlength=count) / PHOTONS

    figures = {}
    for name, batch in (("plain", unsplit), ("split", split)):
        batch(0)
        start = time.process_time()
        values = np.array([batch(seed) for seed in np.random.default_rng(1).integers(1 << 60, size=BATCHES)])
        spent = time.process_time() - start
        figures[name] = BATCHES * values.mean(0) ** 2 / values.var(0, ddof=1) / spent
    for i in range(count):
        ratio = figures["split"][i] / figures["plain"][i]
        mean, error = values.mean(0)[i], values.std(0, ddof=1)[i] / math.sqrt(BATCHES)
        row(f"{names[i]}, split near photodiodes", mean, error, ratio)


def row(name: str, mean: float, error: float, ratio: float) -> None:
    """Print one lever's reading and its figure of merit over the plain way's."""
    print(f"{name:<46} {mean:.3e} +- {error:.1e}   {ratio:5.2f} times plain")


if __name__ == "__main__":
    main()

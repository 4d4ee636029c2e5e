"""The photon walk through a phantom: exact planes, laterally infinite, no mesh."""

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..scene import Led, Phantom, Scene
from .arithmetic import maximum, minimum, safe_sqrt
from .records import Batch
from .sampling import (
    ABSORBED,
    BOTTOM,
    FAR,
    KILLED_SHARE,
    LONG_LIFE,
    LOST,
    TOP,
    emission_cosine,
    emission_table,
    energy_sums,
    fresnel,
    henyey_greenstein,
    lanes,
    lifetime,
    turn,
)


class StackTracer:
    """Traces the LEDs of a phantom scene."""

    batch_photons = 1 << 19

    def __init__(self, scene: Scene) -> None:
        assert scene.phantom is not None
        self.scene, self.phantom = scene, scene.phantom
        self.photodiodes = tuple(photodiode.name for photodiode in scene.photodiodes)
        self.apertures = [
            (x - dx / 2, x + dx / 2, y - dy / 2, y + dy / 2)
            for (x, y), (dx, dy) in ((p.position_mm, p.size_mm) for p in scene.photodiodes)
        ]

    def mu_a(self, led: int) -> np.ndarray:
        """Absorption for which the weights hold, (layers,) float. [mm^-1]"""
        return np.array([layer.mu_a_per_mm for layer in self.phantom.layers])

    def batch(self, led: int, *, photons: int, seed: int) -> Batch:
        """Trace some photons of one LED."""
        walked = walk_stack(self.phantom, self.scene.leds[led], photons=photons, seed=seed)
        top = np.flatnonzero(walked.outcome == TOP)
        photodiode, weight, path = [], [], []
        for i, aperture in enumerate(self.apertures):
            share = arc_share(walked.shift_mm[top], walked.start_mm[top], aperture)
            seen = np.flatnonzero(share)
            photodiode.append(np.full(len(seen), i, np.uint16))
            weight.append(share[seen] * walked.weight[top[seen]])
            path.append(walked.path_mm[top[seen]])
        return Batch(
            photons=photons,
            photodiode=np.concatenate([np.zeros(0, np.uint16), *photodiode]),
            weight=np.concatenate([np.zeros(0), *weight]),
            path_mm=np.concatenate([np.zeros((0, len(self.phantom.layers)), np.float32), *path]),
            energy=energy_sums(walked.outcome, walked.weight, walked.roulette),
            events=walked.events,
        )


@dataclass(frozen=True)
class StackBatch:
    """What became of each photon of a batch.

    outcome : (n,) int. TOP, BOTTOM, ABSORBED or LOST.
    weight : (n,) float. Weight at the end, at the phantom's own absorption; what is missing of 1 was absorbed.
    roulette : (n,) float. What roulette took from it less what it gave.
    start_mm, shift_mm : (n, 2) float. Where it entered, and its lateral displacement from there. [mm]
    path_mm : (n, layers) float32. Path in each layer. [mm]
    events : Scatterings in all.
    """

    outcome: np.ndarray
    weight: np.ndarray
    roulette: np.ndarray
    start_mm: np.ndarray
    shift_mm: np.ndarray
    path_mm: np.ndarray
    events: int


def walk_stack(phantom: Phantom, led: Led, *, photons: int, seed: int) -> StackBatch:
    """Trace a batch of photons from a beam or a die on the phantom's top face, each to its end.

    Absorption dims a photon and at last ends it, each at half its rate; very long walks end by roulette: nothing is
    cut off. Depths are counted from the top of the photon's layer, so that thin layers keep their digits.
    """
    layers = phantom.layers
    tables = {
        "n": [phantom.n_above, *(layer.n for layer in layers), phantom.n_below],
        "mu_a": [layer.mu_a_per_mm for layer in layers],
        "mu_s": [layer.mu_s_per_mm for layer in layers],
        "g": [layer.g for layer in layers],
        "thickness": [min(layer.thickness_mm, FAR) for layer in layers],
        "emission": emission_table(led),
    }
    rng, count = lanes(photons, seed)
    results = [dr.zeros(mi.UInt32, photons)] + [dr.zeros(mi.Float, photons) for _ in range(6 + len(layers))]
    events = _walk(
        rng,
        count,
        {name: _opaque(values) for name, values in tables.items()},
        results,
    )
    dr.eval(events, results)
    outcome, weight, roulette, u, v, x, y, *paths = (np.array(a) for a in results)
    size = (0.0, 0.0) if led.pattern == "pencil" else led.size_mm
    start = np.stack([led.position_mm[0] + (u - 0.5) * size[0], led.position_mm[1] + (v - 0.5) * size[1]], -1)
    return StackBatch(
        outcome=outcome.astype(np.int8),
        weight=weight.astype(float),
        roulette=roulette.astype(float),
        start_mm=start.astype(float),
        shift_mm=np.stack([x, y], -1).astype(float),
        path_mm=np.stack(paths, -1),
        events=int(np.array(events).sum(dtype=np.int64)),
    )


def _opaque(values: Any) -> Any:
    """A table whose values do not become part of the kernel: a table of one would, and be compiled for every scene."""
    table = mi.Float(values)
    dr.make_opaque(table)
    return table


def arc_share(shift_mm: np.ndarray, start_mm: np.ndarray, aperture: tuple[float, float, float, float]) -> np.ndarray:
    """Share of all azimuths at which a displacement from its start ends inside a rectangle, (n,) float.

    Source and layers look alike from every side, so a photon's azimuth is free: averaged over it exactly, a photon
    counts a little in every aperture at its distance, in place of fully in one or in none.

    Parameters
    ----------
    shift_mm, start_mm : (n, 2) float. [mm]
    aperture : x_min, x_max, y_min, y_max. [mm]
    """
    x_min, x_max, y_min, y_max = aperture
    radius = np.maximum(np.hypot(*shift_mm.T), 1e-12)
    share = np.zeros(len(radius))
    near = np.hypot(
        np.maximum(np.maximum(x_min - start_mm[:, 0], start_mm[:, 0] - x_max), 0),
        np.maximum(np.maximum(y_min - start_mm[:, 1], start_mm[:, 1] - y_max), 0),
    )
    far = np.hypot(
        np.maximum(x_max - start_mm[:, 0], start_mm[:, 0] - x_min),
        np.maximum(y_max - start_mm[:, 1], start_mm[:, 1] - y_min),
    )
    hit = np.flatnonzero((radius >= near) & (radius <= far))
    r, (sx, sy) = radius[hit], start_mm[hit].T
    # Azimuths with x inside: [a, b] and its mirror image; with y inside: [c, d] and its mirror image.
    a, b = np.arccos(np.clip((x_max - sx) / r, -1, 1)), np.arccos(np.clip((x_min - sx) / r, -1, 1))
    c, d = np.arcsin(np.clip((y_min - sy) / r, -1, 1)), np.arcsin(np.clip((y_max - sy) / r, -1, 1))
    pi = np.pi
    overlaps = [
        (a, b, c, d),
        (a, b, pi - d, pi - c),
        (2 * pi - b, 2 * pi - a, pi - d, pi - c),
        (2 * pi - b, 2 * pi - a, 2 * pi + c, 2 * pi + d),
    ]
    share[hit] = sum(np.maximum(np.minimum(q, t) - np.maximum(p, s), 0) for p, q, s, t in overlaps) / (2 * pi)
    return share


def _launch(rng: Any, n: Any, squares: Any) -> tuple[Any, ...]:
    """A new photon: place on the die (u, v), mirrored at the top face or not, direction in, depth at which it ends."""
    u, v = rng.next_float32(), rng.next_float32()
    cos = emission_cosine(squares, rng.next_float32())
    mirrored, cos_in, eta = fresnel(cos, n_in=dr.gather(mi.Float, n, 0), n_out=dr.gather(mi.Float, n, 1))
    sin_phi, cos_phi = dr.sincos(2 * dr.pi * rng.next_float32())
    sin = eta * safe_sqrt(1 - cos * cos)
    bounced = rng.next_float32() < mirrored
    return u, v, bounced, mi.Vector3f(sin * cos_phi, sin * sin_phi, -cos_in), lifetime(rng.next_float32())


@dr.syntax
def _walk(rng: Any, count: Any, tables: dict[str, Any], results: list[Any]) -> Any:
    """Scatterings per lane; a lane walks one photon after the other, so that none waits for one long life."""
    F, U, B = mi.Float, mi.UInt32, mi.Bool
    n, mu_a, mu_s, g, thickness = (tables[name] for name in ("n", "mu_a", "mu_s", "g", "thickness"))
    emission = tables["emission"]
    outcome_of, weight_of, roulette_of, u_of, v_of, x_of, y_of, *path_of = results
    width, last_layer = dr.width(count), len(path_of) - 1
    photon = dr.arange(U, width)
    u, v, bounced, w, life = _launch(rng, n, emission)
    x, y, depth, tau = dr.zeros(F, width), dr.zeros(F, width), dr.zeros(F, width), dr.zeros(F, width)
    layer, age, events = dr.zeros(U, width), dr.zeros(U, width), dr.zeros(U, width)
    boost, given = dr.full(F, 1, width), dr.zeros(F, width)
    path = [dr.zeros(F, width) for _ in range(last_layer + 1)]
    active = count > 0
    while dr.hint(active, label="stack walk"):
        mus = dr.gather(F, mu_s, layer, active)
        free = dr.select(mus > 0, -dr.log(1 - rng.next_float32()) * dr.rcp(mus), FAR)
        up = (w.z > 0) | bounced
        room = dr.select(up, depth, dr.gather(F, thickness, layer, active) - depth)
        meets = free * dr.abs(w.z) >= room
        step = dr.select(meets, minimum(room * dr.rcp(maximum(dr.abs(w.z), 1e-12)), FAR), free)
        step = dr.select(bounced, 0, step)
        x = dr.fma(step, w.x, x)
        y = dr.fma(step, w.y, y)
        depth = dr.select(meets, dr.select(up, 0, depth + room), dr.fma(-step, w.z, depth))
        tau = dr.fma(step, dr.gather(F, mu_a, layer, active), tau)
        for k in range(last_layer + 1):
            path[k] = path[k] + dr.select(layer == k, step, 0)

        spin = rng.next_float32()
        turned = turn(w, henyey_greenstein(dr.gather(F, g, layer, active), spin), 2 * dr.pi * rng.next_float32())
        leaves = B(bounced)
        if meets & ~bounced:
            here, there = dr.gather(F, n, layer + 1), dr.gather(F, n, dr.select(up, layer, layer + 2))
            mirrored, cos_out, eta = fresnel(dr.abs(w.z), n_in=here, n_out=there)
            reflected = spin < mirrored
            turned = dr.select(
                reflected,
                mi.Vector3f(w.x, w.y, -w.z),
                mi.Vector3f(eta * w.x, eta * w.y, dr.copysign(cos_out, w.z)),
            )
            leaves = ~reflected & dr.select(up, layer == 0, layer == last_layer)
            moves = ~reflected & ~leaves
            layer = dr.select(moves, dr.select(up, layer - 1, layer + 1), layer)
            depth = dr.select(moves, dr.select(up, dr.gather(F, thickness, layer), 0), depth)
        w = mi.Vector3f(turned)
        events += dr.select(meets, U(0), U(1))
        age += 1
        absorbed = tau > life
        lost = B(False)
        if (age >= LONG_LIFE) & ((age & (age - 1)) == 0):
            lost = rng.next_float32() < 0.5
            given = dr.select(lost, given, given + boost * dr.exp(-(1 - KILLED_SHARE) * tau))
            boost = dr.select(lost, boost, 2 * boost)
        if absorbed | leaves | lost:
            outcome = dr.select(absorbed, U(ABSORBED), dr.select(lost, U(LOST), dr.select(up, U(TOP), U(BOTTOM))))
            dr.scatter(outcome_of, outcome, photon)
            dr.scatter(weight_of, dr.select(absorbed, 0, boost * dr.exp(-(1 - KILLED_SHARE) * tau)), photon)
            dr.scatter(roulette_of, -given, photon)
            for target, value in ((u_of, u), (v_of, v), (x_of, x), (y_of, y)):
                dr.scatter(target, value, photon)
            for k in range(last_layer + 1):
                dr.scatter(path_of[k], path[k], photon)
                path[k] = F(0)
            photon += width
            count -= 1
            u, v, bounced, w, life = _launch(rng, n, emission)
            x, y, depth, tau, boost, given = F(0), F(0), F(0), F(0), F(1), F(0)
            layer, age = U(0), U(0)
        active &= count > 0
    return events

"""The photon walk through a phantom: exact planes, laterally infinite, no mesh."""

from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...scene import Led, Phantom, Scene
from .. import optics
from ..transfer.records import LedTrace
from . import sampling
from .sampling import Photon, PhotonEnds, PhotonQueue, WalkedPhotons, maximum, minimum, safe_sqrt, starts, survival

# Of a cosine, or in mm: keeps a division by what may be 0 finite, and is lost in any number that is not.
TINY = 1e-12


class LayeredTracer:
    """The photons engine for a phantom scene: walks the photons of its LEDs until each has ended."""

    def __init__(self, scene: Scene, *, escaping: bool = False) -> None:
        """escaping : whether all light that leaves is recorded, as that of two more photodiodes, top and bottom."""
        assert scene.phantom is not None
        self.escaping = escaping
        self.scene, self.phantom = scene, scene.phantom
        self.apertures = [
            (x - dx / 2, x + dx / 2, y - dy / 2, y + dy / 2)
            for (x, y), (dx, dy) in ((p.position_mm, p.size_mm) for p in scene.photodiodes)
        ]

    def batch(self, led: int, *, photons: int, seed: int) -> LedTrace:
        """Trace some photons of one LED."""
        walked, start, shift = walk_layers(self.phantom, self.scene.leds[led], photons=photons, seed=seed)
        energy, absorbed = walked.energy([layer.name for layer in self.phantom.layers])
        top, detected = np.flatnonzero(walked.outcome == sampling.TOP), []
        for aperture in self.apertures:
            share = arc_share(shift[top], start[top], aperture)
            photon = top[share > 0]
            detected.append((photon, share[share > 0] * walked.weight[photon]))
        for end in (sampling.TOP, sampling.BOTTOM) if self.escaping else ():
            left = np.flatnonzero(walked.outcome == end)
            detected.append((left, walked.weight[left]))
        photon, weight = (np.concatenate(part) for part in zip((top[:0], walked.weight[:0]), *detected, strict=True))
        return LedTrace(
            photons=photons,
            mu_a=optics.absorption(self.scene, self.scene.leds[led].wavelength_nm)[0],
            seeds=(seed,),
            photon=photon.astype(np.uint32),
            photodiode=np.repeat(np.arange(len(detected), dtype=np.uint16), [len(reached) for reached, _ in detected]),
            weight=weight,
            path_mm=np.ascontiguousarray(walked.path_mm[:, photon].T),
            energy=energy,
            absorbed=absorbed,
            events=walked.events,
        )


def walk_layers(phantom: Phantom, led: Led, *, photons: int, seed: int) -> tuple[WalkedPhotons, np.ndarray, np.ndarray]:
    """Trace a batch of photons from a beam or a die on the phantom's top face, each to its end.

    Absorption dims a photon and at last ends it, each at half its rate; very long walks end by roulette: nothing is
    cut off. Depths are counted from the top of the photon's layer, so that thin layers keep their digits.

    Returns: the photons; where each entered, and its lateral displacement from there, (n, 2) float. [mm]
    """
    ends = PhotonEnds(photons, paths=len(phantom.layers) + 4, media=len(phantom.layers))
    walked = ends.evaluated(_walk(_Layers(phantom, led), PhotonQueue(photons, seed), ends))
    *path, u, v, x, y = walked.path_mm
    size = (0.0, 0.0) if led.pattern == "pencil" else led.size_mm
    start = np.stack([led.position_mm[0] + (u - 0.5) * size[0], led.position_mm[1] + (v - 0.5) * size[1]], -1)
    return replace(walked, path_mm=np.stack(path)), start.astype(float), np.stack([x, y], -1).astype(float)


class _Layers:
    """What the walk reads of a phantom and its LED; n counts what lies above and below, too. The tables' values are no
    part of the kernel, which would be compiled for every scene."""

    def __init__(self, phantom: Phantom, led: Led) -> None:
        layers = phantom.layers
        self.count = len(layers)
        self.n = mi.Float([phantom.n_above, *(layer.n for layer in layers), phantom.n_below])
        self.mu_a = mi.Float([layer.mu_a_per_mm for layer in layers])
        self.mu_s = mi.Float([layer.mu_s_per_mm for layer in layers])
        self.g = mi.Float([layer.g for layer in layers])
        self.thickness = mi.Float([min(layer.thickness_mm, sampling.FAR) for layer in layers])
        self.emission = mi.Float(sampling.emission_table(led))
        dr.make_opaque(self.n, self.mu_a, self.mu_s, self.g, self.thickness, self.emission)


@dataclass(kw_only=True)
class _LayeredPhoton(Photon):
    """A photon in a phantom.

    u, v : Where on the die it set out, in 0-1.
    x, y : Its lateral displacement from there. [mm]
    layer : Index of the layer it is in.
    depth : Below the top of that layer. [mm]
    bounced : It is mirrored at the top face before it enters.
    """

    u: Any
    v: Any
    x: Any = starts(0.0)
    y: Any = starts(0.0)
    layer: Any = starts(0)
    depth: Any = starts(0.0)
    bounced: Any


def arc_share(shift_mm: np.ndarray, start_mm: np.ndarray, aperture: tuple[float, float, float, float]) -> np.ndarray:
    """The share of all azimuths at which a displacement from its start ends inside a rectangle, (n,) float.

    Source and layers look alike from every side, so a photon's azimuth is free: averaged over it exactly, a photon
    counts a little in every aperture at its distance, in place of fully in one or in none.

    shift_mm, start_mm : (n, 2) float. [mm]
    aperture : x_min, x_max, y_min, y_max. [mm]
    """
    x_min, x_max, y_min, y_max = aperture
    radius = np.maximum(np.hypot(*shift_mm.T), TINY)
    share = np.zeros(len(radius))
    low, high = np.array([x_min, y_min]), np.array([x_max, y_max])
    near = np.hypot(*np.maximum(np.maximum(low - start_mm, start_mm - high), 0).T)
    far = np.hypot(*np.maximum(high - start_mm, start_mm - low).T)
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


def _launch(layers: _Layers, queue: PhotonQueue, index: Any) -> _LayeredPhoton:
    """A new photon on the die, mirrored at the top face or on its way in."""
    rng = queue.random_numbers(index)
    u, v = rng.next_float32(), rng.next_float32()
    cos = sampling.emission_cosine(layers.emission, rng.next_float32())
    reflectance, cos_in, eta = sampling.fresnel(
        cos, n_in=dr.gather(mi.Float, layers.n, 0), n_out=dr.gather(mi.Float, layers.n, 1)
    )
    sin_phi, cos_phi = dr.sincos(2 * dr.pi * rng.next_float32())
    sin = eta * safe_sqrt(1 - cos * cos)
    bounced = rng.next_float32() < reflectance
    return _LayeredPhoton(
        index=index,
        rng=rng,
        w=mi.Vector3f(sin * cos_phi, sin * sin_phi, -cos_in),
        absorption_optical_depth=sampling.absorption_depth(rng.next_float32()),
        path=[mi.Float(0) for _ in range(layers.count)],
        u=u,
        v=v,
        bounced=bounced,
    )


@dr.syntax
def _walk(layers: _Layers, queue: PhotonQueue, ends: PhotonEnds) -> Any:
    """Walk all photons of a batch to their ends; returns scatterings per lane."""
    photon = _launch(layers, queue, queue.first)
    events = dr.zeros(mi.UInt32, dr.width(queue.first))
    active = photon.index < queue.photons
    while dr.hint(active, label="layered walk"):
        up, meets = _step(photon, layers, active)
        u = photon.rng.next_float32()
        cos = sampling.henyey_greenstein(dr.gather(mi.Float, layers.g, photon.layer, active), u)
        w, layer = mi.Vector3f(photon.w), mi.UInt32(photon.layer)
        photon.w = mi.Vector3f(sampling.rotate_direction(w, cos, 2 * dr.pi * photon.rng.next_float32()))
        leaves = _meet_face(photon, w, layers, up, meets & ~photon.bounced, u, ends)
        events += dr.select(meets, mi.UInt32(0), mi.UInt32(1))
        left = dr.select(up, mi.UInt32(sampling.TOP), mi.UInt32(sampling.BOTTOM))
        absorbed = photon.tau > photon.absorption_optical_depth
        photon.outcome = dr.select(absorbed, mi.UInt32(sampling.ABSORBED), dr.select(leaves, left, 0))
        sampling.roulette(photon, 1, 1)
        if photon.outcome > 0:
            ends.record(photon, layer, True)
            ends.record_path(photon, photon.u, photon.v, photon.x, photon.y)
            photon = _launch(layers, queue, queue.next())
        # A photon that ended has begun anew; so no loop carries this along.
        photon.outcome = mi.UInt32(0)
        active &= photon.index < queue.photons
    return events


def _step(photon: _LayeredPhoton, layers: _Layers, active: Any) -> tuple[Any, Any]:
    """Move photons to their next scattering or to the face of their layer; returns which go up, and which meet it."""
    mu_s = dr.gather(mi.Float, layers.mu_s, photon.layer, active)
    free = dr.select(mu_s > 0, -dr.log(1 - photon.rng.next_float32()) * dr.rcp(mu_s), sampling.FAR)
    up = (photon.w.z > 0) | photon.bounced
    thickness = dr.gather(mi.Float, layers.thickness, photon.layer, active)
    room, cos = dr.select(up, photon.depth, thickness - photon.depth), dr.abs(photon.w.z)
    meets = free * cos >= room
    step = dr.select(meets, minimum(room * dr.rcp(maximum(cos, TINY)), sampling.FAR), free)
    step = dr.select(photon.bounced, 0, step)
    photon.x = dr.fma(step, photon.w.x, photon.x)
    photon.y = dr.fma(step, photon.w.y, photon.y)
    at_face = dr.select(up, 0, photon.depth + room)
    photon.depth = dr.select(meets, at_face, dr.fma(-step, photon.w.z, photon.depth))
    photon.tau = dr.fma(step, dr.gather(mi.Float, layers.mu_a, photon.layer, active), photon.tau)
    photon.path = [path + dr.select(photon.layer == k, step, 0) for k, path in enumerate(photon.path)]
    return up, meets


@dr.syntax
def _meet_face(photon: _LayeredPhoton, w: Any, layers: _Layers, up: Any, meets: Any, u: Any, ends: PhotonEnds) -> Any:
    """Reflect or refract photons that meet a face along w, u a uniform number; returns which leave the phantom."""
    leaves = mi.Bool(photon.bounced)
    if meets:
        here = dr.gather(mi.Float, layers.n, photon.layer + 1)
        there = dr.gather(mi.Float, layers.n, dr.select(up, photon.layer, photon.layer + 2))
        reflectance, cos_out, eta = sampling.fresnel(dr.abs(w.z), n_in=here, n_out=there)
        reflected = u < reflectance
        leaves = ~reflected & dr.select(up, photon.layer == 0, photon.layer == layers.count - 1)
        moves = ~reflected & ~leaves
        ends.absorb(photon, photon.layer, photon.weight * survival(photon.tau), moves)
        photon.w = dr.select(
            reflected, mi.Vector3f(w.x, w.y, -w.z), mi.Vector3f(eta * w.x, eta * w.y, dr.copysign(cos_out, w.z))
        )
        photon.layer = dr.select(moves, dr.select(up, photon.layer - 1, photon.layer + 1), photon.layer)
        thickness = dr.gather(mi.Float, layers.thickness, photon.layer)
        photon.depth = dr.select(moves, dr.select(up, thickness, 0), photon.depth)
    return leaves

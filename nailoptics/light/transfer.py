"""Transfer, what a trace returns: each detected photon's weight and paths, readable at any blood state."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from ..errors import InputError, NailopticsError
from ..scene import Scene, digest, parse_scene, to_toml
from . import optics

# Photons kept per LED; of more, a random half is dropped and the others count twice.
MAX_RECORDS = 8_000_000
# A reading that rests on fewer effective photons than this has no trustworthy standard error.
MIN_EFFECTIVE_PHOTONS = 100.0


class RereadWarning(UserWarning):
    """A reading was asked for at a state for which the trace holds too few effective photons."""


@dataclass(frozen=True)
class LedTrace:
    """All that one LED's photons left behind.

    photons : How many were emitted.
    mu_a : (r,) float. Absorption for which the weights hold. [mm^-1]
    photodiode : (n,) int. Which photodiode each kept photon reached.
    weight : (n,) float. Its weight there, of 1 at emission.
    path_mm : (n, r) float32. Its path in each absorber. [mm]
    energy : for reflected, transmitted, absorbed, lost: sum of weights and sum of their squares.
    seeds : seeds of the batches.
    """

    photons: int
    mu_a: np.ndarray
    photodiode: np.ndarray
    weight: np.ndarray
    path_mm: np.ndarray
    energy: Mapping[str, tuple[float, float]]
    seeds: tuple[int, ...]

    def thinned(self) -> "LedTrace":
        """At most MAX_RECORDS photons: a random half dropped, the others doubled, as often as it takes."""
        # One generator for all rounds: the same numbers twice would drop the same photons twice.
        rng, thin = np.random.default_rng(self.seeds), self
        while len(thin.weight) > MAX_RECORDS:
            keep = rng.random(len(thin.weight)) < 0.5
            thin = replace(
                thin, photodiode=thin.photodiode[keep], weight=2 * thin.weight[keep], path_mm=thin.path_mm[keep]
            )
        return thin


def joined(traces: Sequence[LedTrace]) -> LedTrace:
    """Traces of one LED as one; raises InputError if they share a seed or were made at different absorption."""
    seeds = [seed for trace in traces for seed in trace.seeds]
    shared = len(seeds) - len(set(seeds))
    if shared:
        raise InputError(f"these traces share {shared} seed(s), so they are not independent; use different seeds.")
    if any(not np.array_equal(trace.mu_a, traces[0].mu_a) for trace in traces):
        raise InputError("these traces were made at different absorption; trace both at the same blood state.")
    return LedTrace(
        photons=sum(trace.photons for trace in traces),
        mu_a=traces[0].mu_a,
        photodiode=np.concatenate([trace.photodiode for trace in traces]),
        weight=np.concatenate([trace.weight for trace in traces]),
        path_mm=np.concatenate([trace.path_mm for trace in traces]),
        energy={
            part: (sum(t.energy[part][0] for t in traces), sum(t.energy[part][1] for t in traces))
            for part in traces[0].energy
        },
        seeds=tuple(seeds),
    ).thinned()


@dataclass(frozen=True)
class Moments:
    """Sums over the photons of each photodiode at one state: of weights, squares and weighted paths."""

    photons: int
    weight: np.ndarray  # (p,)
    square: np.ndarray  # (p,)
    path: np.ndarray  # (p, r)
    path_square: np.ndarray  # (p, r)
    path_cross: np.ndarray  # (p, r): sum of w^2 L

    @property
    def fraction(self) -> np.ndarray:
        """Detected fraction, (p,)."""
        return self.weight / self.photons

    @property
    def stderr(self) -> np.ndarray:
        """Its standard error, (p,); photons are independent and each reaches a photodiode once."""
        return stderr_of_mean(self.weight, self.square, self.photons)

    @property
    def effective_photons(self) -> np.ndarray:
        """Effective number of detected photons (sum w)^2 / sum w^2, (p,)."""
        return np.divide(self.weight**2, self.square, out=np.zeros_like(self.weight), where=self.square > 0)

    @property
    def mean_path(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean path of the detected light in each absorber and its standard error, (p, r) each. [mm]"""
        total = self.weight[:, None]
        mean = np.divide(self.path, total, out=np.full_like(self.path, np.nan), where=total > 0)
        spread = np.maximum(self.path_square - 2 * mean * self.path_cross + mean**2 * self.square[:, None], 0)
        return mean, np.divide(np.sqrt(spread), total, out=np.full_like(mean, np.nan), where=total > 0)

    @property
    def derivative(self) -> tuple[np.ndarray, np.ndarray]:
        """Derivative of the fraction to each absorber's mu_a and its standard error, (p, r) each. [mm]"""
        return -self.path / self.photons, stderr_of_mean(self.path, self.path_square, self.photons)


def stderr_of_mean(total: ArrayLike, square: ArrayLike, photons: int) -> np.ndarray:
    """Standard error of total / photons from the sum of squares over independent photons."""
    mean = np.asarray(total) / photons
    return np.sqrt(np.maximum(np.asarray(square) / photons - mean**2, 0) / max(photons - 1, 1))


@dataclass(frozen=True)
class Transfer:
    """Light from every LED to every photodiode, traced once, readable at any absorption.

    Scattering decides where light goes and blood only dims it, so a photon of weight w and paths L_k counts
    w exp(-sum_k (mu_a,k - mu_a,k at the trace) L_k) in any other state.
    """

    scene: Scene
    photodiodes: tuple[str, ...]
    absorbers: tuple[str, ...]
    traces: tuple[LedTrace, ...]
    engine: str
    backend: str
    versions: Mapping[str, str]
    cpu_seconds: float
    wall_seconds: float
    events: int

    @property
    def leds(self) -> tuple[str, ...]:
        """Names of the LEDs."""
        return tuple(led.name for led in self.scene.leds)

    @property
    def photons(self) -> int:
        """Photons emitted, all LEDs together."""
        return sum(trace.photons for trace in self.traces)

    def at(
        self,
        blood_fraction: ArrayLike | None = None,
        so2: float | None = None,
        *,
        mu_a_per_mm: Mapping[str, float] | None = None,
    ) -> xr.Dataset:
        """Readings at one state.

        Parameters
        ----------
        blood_fraction : (K,) float in 0-1. Blood in each zone of the bed; at rest if not given.
        so2 : oxygen saturation in 0-1; the scene's if not given.
        mu_a_per_mm : absorption by absorber's name, in place of what the scene says. [mm^-1]

        Returns
        -------
        Dataset over led, photodiode (and absorber): detected_fraction, mean_path_mm, effective_photons, each with
        its standard error, or its derivative to mu_a. Fractions are of the power that the LED emits.

        Warns: RereadWarning where fewer than 100 effective photons stand behind a reading of this state.
        """
        moments = [self._moments(i, self._mu_a(i, blood_fraction, so2, mu_a_per_mm)) for i in range(len(self.traces))]
        self.warn_if_thin(np.array([m.effective_photons for m in moments]))
        pairs = ("led", "photodiode")
        paths = [m.mean_path for m in moments]
        slopes = [m.derivative for m in moments]
        data = {
            "detected_fraction": (pairs, [m.fraction for m in moments]),
            "detected_fraction_stderr": (pairs, [m.stderr for m in moments]),
            "effective_photons": (pairs, [m.effective_photons for m in moments]),
            "mean_path_mm": ((*pairs, "absorber"), [p[0] for p in paths]),
            "mean_path_mm_stderr": ((*pairs, "absorber"), [p[1] for p in paths]),
            "derivative_mm": ((*pairs, "absorber"), [s[0] for s in slopes]),
            "derivative_mm_stderr": ((*pairs, "absorber"), [s[1] for s in slopes]),
        }
        return self._dataset({name: (dims, np.array(values)) for name, (dims, values) in data.items()})

    def derivative(self, blood_fraction: ArrayLike | None = None, so2: float | None = None) -> xr.DataArray:
        """Derivative of each reading to the mu_a of each absorber, -<w L>, (led, photodiode, absorber). [mm]"""
        return self.at(blood_fraction, so2).derivative_mm

    def mean_path_mm(self, blood_fraction: ArrayLike | None = None, so2: float | None = None) -> xr.DataArray:
        """Mean path of the detected light in each absorber, (led, photodiode, absorber). [mm]"""
        return self.at(blood_fraction, so2).mean_path_mm

    def energy(self) -> dict[str, dict[str, float]]:
        """Where the light of all LEDs went, in equal parts, with standard errors; fractions of the power emitted."""
        parts = {}
        for name in ("reflected", "transmitted", "absorbed", "lost"):
            values = [t.energy[name][0] / t.photons for t in self.traces]
            errors = [float(stderr_of_mean(*t.energy[name], t.photons)) for t in self.traces]
            parts[name] = {"value": float(np.mean(values)), "stderr": float(np.linalg.norm(errors) / len(errors))}
        return parts

    def merge(self, other: "Transfer") -> "Transfer":
        """This trace and another of the same light as one; raises InputError if they differ or share a seed."""
        if optical_key(self.scene) != optical_key(other.scene) or self.engine != other.engine:
            raise InputError("these traces are of different scenes or engines; merge traces of one scene.")
        return replace(
            self,
            traces=tuple(joined(pair) for pair in zip(self.traces, other.traces, strict=True)),
            cpu_seconds=self.cpu_seconds + other.cpu_seconds,
            wall_seconds=self.wall_seconds + other.wall_seconds,
            events=self.events + other.events,
        )

    def save(self, path: str | Path) -> None:
        """Write the transfer to a NumPy archive (.npz), whole or not at all."""
        from .store import save

        save(self, Path(path))

    @staticmethod
    def load(path: str | Path) -> "Transfer":
        """Read a transfer that `save` wrote."""
        from .store import load

        return load(Path(path))

    def _mu_a(
        self, led: int, blood: ArrayLike | None, so2: ArrayLike | None, override: Mapping[str, float] | None
    ) -> Any:
        """Absorption (q, r) over the LED's line, and the line's weights (q,)."""
        wavelengths, weights = optics.spectrum(self.scene.leds[led])
        mu_a = optics.absorption(self.scene, wavelengths, blood_fraction=blood, so2=so2)
        for name, value in (override or {}).items():
            if name not in self.absorbers:
                raise InputError(
                    f'mu_a_per_mm names "{name}", which is no absorber here; known: {", ".join(self.absorbers)}.'
                )
            if not (np.isfinite(value) and value >= 0):
                raise InputError(f"mu_a_per_mm of {name} = {value}; must be a number of at least 0.")
            mu_a[..., self.absorbers.index(name)] = value
        return mu_a, weights

    def _moments(self, led: int, line: tuple[np.ndarray, np.ndarray]) -> Moments:
        trace, (mu_a, line_weights) = self.traces[led], line
        path = trace.path_mm
        factor = np.zeros(len(trace.weight))
        for mu, share in zip(mu_a, line_weights, strict=True):
            factor += share * np.exp(-(path @ (mu - trace.mu_a)))
        weight = trace.weight * factor
        count = len(self.photodiodes)

        def total(values: np.ndarray) -> np.ndarray:
            # Of no photons at all numpy makes integers.
            return np.bincount(trace.photodiode, values, minlength=count).astype(float)

        def by_absorber(values: np.ndarray, power: int) -> np.ndarray:
            return np.stack([total(values * column**power) for column in path.T], -1)

        return Moments(
            photons=trace.photons,
            weight=total(weight),
            square=total(weight**2),
            path=by_absorber(weight, 1),
            path_square=by_absorber(weight**2, 2),
            path_cross=by_absorber(weight**2, 1),
        )

    @cached_property
    def _effective_at_trace(self) -> list[np.ndarray]:
        """Effective photons of each pair in the state that was traced."""
        out = []
        for trace in self.traces:
            counts = len(self.photodiodes)
            one, two = (np.bincount(trace.photodiode, trace.weight**p, minlength=counts).astype(float) for p in (1, 2))
            out.append(np.divide(one**2, two, out=np.zeros_like(one), where=two > 0))
        return out

    def warn_if_thin(self, effective: np.ndarray) -> None:
        """Warn where few of the effective photons that were traced are left, (led, photodiode) float."""
        for led, left, traced in zip(self.leds, effective, self._effective_at_trace, strict=True):
            thin = (left < MIN_EFFECTIVE_PHOTONS) & (left < 0.5 * traced)
            if thin.any():
                i = int(np.argmin(np.where(thin, left, np.inf)))
                warnings.warn(
                    f'LED "{led}", photodiode "{self.photodiodes[i]}": this state is so far from the traced one that '
                    f"only {left[i]:.1f} effective photons of {traced[i]:.0f} remain; trace nearer or more photons",
                    RereadWarning,
                    stacklevel=3,
                )

    def _dataset(self, data: Mapping[str, tuple[tuple[str, ...], np.ndarray]]) -> xr.Dataset:
        coords = {"led": list(self.leds), "photodiode": list(self.photodiodes), "absorber": list(self.absorbers)}
        names = {
            "detected_fraction": ("detected fraction of the emitted power", "1"),
            "effective_photons": ("effective number of detected photons", "1"),
            "mean_path_mm": ("mean path of the detected light in the absorber", "mm"),
            "derivative_mm": ("derivative of the detected fraction to the absorber's mu_a", "mm"),
        }
        out = xr.Dataset({name: (dims, values) for name, (dims, values) in data.items()}, coords=coords)
        for name, (long_name, unit) in names.items():
            out[name].attrs = {"long_name": long_name, "units": unit}
            if f"{name}_stderr" in out:
                out[name].attrs["ancillary_variables"] = f"{name}_stderr"
                out[f"{name}_stderr"].attrs = {"long_name": f"standard error of the {long_name}", "units": unit}
        out["wavelength_nm"] = (
            "led",
            [led.wavelength_nm for led in self.scene.leds],
            {"units": "nm", "long_name": "peak wavelength"},
        )
        return out.assign_attrs(self.attributes())

    def attributes(self) -> dict[str, Any]:
        """What a result carries about its making: scene, digest, engine, backend, versions, photons."""
        seeds = " ".join(str(t.seeds[0]) for t in self.traces if t.seeds)
        return provenance(self.scene, engine=self.engine, backend=self.backend, photons=self.photons, seeds=seeds) | {
            "versions": " ".join(f"{name}={number}" for name, number in self.versions.items())
        }


@cache
def versions() -> dict[str, str]:
    """Versions of what decides a result's bits."""
    return {name: version(name) for name in ("nailoptics", "mitsuba", "drjit", "numpy")}


def provenance(scene: Scene, *, engine: str, backend: str, photons: int, seeds: str) -> dict[str, Any]:
    """Attributes of a result that tell how it was made and let it be made again."""
    return {
        "Conventions": "CF-1.11",
        "scene": to_toml(scene),
        "digest": digest(scene),
        "engine": engine,
        "backend": backend,
        "photons": photons,
        "seeds": seeds,
        "versions": " ".join(f"{name}={number}" for name, number in versions().items()),
    }


def optical_key(scene: Scene) -> str:
    """Digest of what decides where light goes and how it is traced; blood, touch and electronics do not."""
    light_only = scene.model_copy(
        update={
            "touch": type(scene.touch)(),
            "electronics": type(scene.electronics)(),
            "accuracy": type(scene.accuracy)(),
        }
    )
    return digest(light_only)


def scene_from_attributes(attributes: Mapping[str, Any]) -> Scene:
    """The scene that a result carries."""
    if "scene" not in attributes:
        raise NailopticsError("this file carries no scene; it was not written by nailoptics.")
    return parse_scene(str(attributes["scene"]), name="the stored scene")

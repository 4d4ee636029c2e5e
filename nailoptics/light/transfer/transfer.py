"""Transfer, what a trace returns: each detected photon's weight and paths, readable at any blood state."""

import warnings
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from ... import checks, io
from ...display import Displayed
from ...errors import InputError
from ...scene import Scene, digest, parse_scene, to_toml
from ...statistics import upper_limit_95
from ...variables import Estimate, Variables, described
from ...version import code_attributes, code_versions
from .. import optics
from .records import COLUMNS, SUMS, LedTrace, Moments, check_arrays, joined, moments_of

# Below so many effective photons, or above such a tail index of its weights, a reading has a `ReweightWarning`.
MIN_EFFECTIVE_PHOTONS, MAX_TAIL_INDEX = 400.0, 0.45
# What the photodiodes' standard errors alone do not say.
SHARED_ERROR = (
    "photodiodes share photons, and so their errors, wholly where a phantom's lie at one distance from the LED; the "
    "error of a difference, ratio or mean of readings follows from Transfer.covariance"
)
# What a trace took, which adds up where traces are merged.
EFFORT = ("cpu_seconds", "wall_seconds", "events", "setup_seconds")


class ReweightWarning(UserWarning):
    """A reading was requested at a state for which the trace holds too few effective photons."""


@cache
def current_versions() -> dict[str, str]:
    """Versions of what decides a result's bits."""
    return code_versions("mitsuba", "drjit", "numpy")


def rest_state(scene: Scene, led: int) -> tuple[np.ndarray, np.ndarray]:
    """The state in which a scene's light is read first, blood at rest: absorption over the LED's line, (q, r) float
    [mm^-1], and the line's weights, (q,) float.
    """
    optics.check_line(scene, led)
    wavelengths, share = optics.spectrum(scene.leds[led])
    return optics.absorption(scene, wavelengths), share


@dataclass(frozen=True)
class Transfer(Displayed):
    """Light from every LED to every photodiode, traced once, readable at any absorption.

    Scattering decides where light goes and blood only dims it, so a photon of weight w and paths L_k counts
    w exp(-sum_k (mu_a,k - mu_a,k at the trace) L_k) in any other state.
    """

    scene: Scene
    traces: tuple[LedTrace, ...]
    backend: str
    engine: str = "photons"
    versions: Mapping[str, str] = field(default_factory=current_versions)
    # Of light that was traced for many scenes the time is nobody's share.
    cpu_seconds: float = 0.0
    wall_seconds: float = 0.0
    events: int = 0
    # Processor time before the first photon, which is no part of cpu_seconds.
    setup_seconds: float = 0.0
    # Photons that were taken from the store, of all.
    reused_photons: int = 0

    def __repr__(self) -> str:
        """What was traced, in a line."""
        return f"<Transfer: {self.photons} photons by {self.engine} on {self.backend}; {self.scene!r}>"

    @cached_property
    def photodiodes(self) -> tuple[str, ...]:
        """Names of the photodiodes, in the order of the traces' numbers."""
        return photodiode_names(self.scene)

    @cached_property
    def absorbers(self) -> tuple[str, ...]:
        """Names of the absorbers, in the order of the traces' paths."""
        return optics.absorbers(self.scene)

    @property
    def shared_error(self) -> str:
        """What the photodiodes' standard errors alone do not say; nothing of a single one's."""
        return SHARED_ERROR if len(self.photodiodes) > 1 else ""

    @property
    def leds(self) -> tuple[str, ...]:
        """Names of the LEDs."""
        return tuple(led.name for led in self.scene.leds)

    @property
    def photons(self) -> int:
        """Photons emitted, all LEDs together."""
        return sum(trace.photons for trace in self.traces)

    @property
    def reused(self) -> bool:
        """Whether all photons came from the store."""
        return self.reused_photons == self.photons

    def at(
        self,
        blood_fraction: ArrayLike | None = None,
        so2: ArrayLike | None = None,
        *,
        mu_a_per_mm: Mapping[str, float] | None = None,
    ) -> xr.Dataset:
        """Readings at one state, or at several.

        blood_fraction : (K,) or (states, K) float in 0-1. Blood in each zone of the bed; at rest if not given.
        so2 : float or (states,) float in 0-1. Oxygen saturation of all blood, whatever part is venous in the scene; the
            scene's saturations if not given.
        mu_a_per_mm : absorption by absorber's name, in place of what the scene says. [mm^-1]

        Returns: Dataset over led, photodiode and absorber, and over state where several are given: detected_fraction,
        mean_path_mm and derivative_mm, each with its standard error, and effective_photons. Fractions are of the power
        that the LED emits. A standard error is NaN, not known, where it rests on fewer than 25 effective photons; of a
        reading of 0, upper_limit_95 is what the fraction does not exceed.

        Warns: ReweightWarning where fewer than 400 effective photons stand behind a reading of this state, or where, in
        a brighter state than the traced one, a few long paths outweigh all others.
        """
        states = _states(blood_fraction, so2)
        if states is not None:
            readings = [self.at(*state, mu_a_per_mm=mu_a_per_mm) for state in states]
            change = [name for name in readings[0] if name != "wavelength_nm"]
            return xr.concat(readings, "state", data_vars=change, coords="minimal", compat="override", join="override")
        moments = self.moments_at(blood_fraction, so2, mu_a_per_mm)
        effective, fraction, stderr, path, slope = (
            np.array([getattr(m, name) for m in moments])
            for name in ("effective_photons", "fraction", "stderr", "mean_path", "derivative")
        )
        self.warn_of_unreliable_weights(effective, moments)
        limits = np.array([[upper_limit_95(trace.photons)] for trace in self.traces])
        data = described(
            optics.__package__,
            detected_fraction=Estimate(fraction, stderr),
            effective_photons=effective,
            upper_limit_95=np.where(fraction == 0, limits, np.nan),
            mean_path_mm=Estimate(path[:, 0], path[:, 1]),
            derivative_mm=Estimate(slope[:, 0], slope[:, 1]),
            wavelength_nm=[led.wavelength_nm for led in self.scene.leds],
        )
        if self.shared_error:
            data["detected_fraction_stderr"][2]["comment"] = self.shared_error
        names = {"led": list(self.leds), "photodiode": list(self.photodiodes), "absorber": list(self.absorbers)}
        return xr.Dataset(data, names, self.attributes() | {"title": "nailoptics: readings of a trace"})

    def moments_at(
        self,
        blood_fraction: ArrayLike | None,
        so2: ArrayLike | None = None,
        mu_a_per_mm: Mapping[str, float] | None = None,
    ) -> list[Moments]:
        """What `at` reads, as sums over the photons of each LED."""
        return [
            trace.moments(*self._mu_a(i, blood_fraction, so2, mu_a_per_mm), count=len(self.photodiodes))
            for i, trace in enumerate(self.traces)
        ]

    def covariance(self, blood_fraction: ArrayLike | None = None, so2: ArrayLike | None = None) -> np.ndarray:
        """Covariance of the readings of each LED at one state, as in `at`, (led, photodiode, photodiode) float; copies
        of one photon may reach several photodiodes. Readings of different LEDs are independent."""
        state, count = (blood_fraction, so2, None), len(self.photodiodes)
        return np.stack([t.covariance(*self._mu_a(i, *state), count=count) for i, t in enumerate(self.traces)])

    def energy(self) -> dict[str, dict[str, float]]:
        """Where the light of all LEDs went, in equal parts, with standard errors; fractions of the power emitted."""
        return mean_of_leds([t.fractions(t.energy) for t in self.traces])

    def absorbed(self) -> dict[str, dict[str, dict[str, float]]]:
        """Where the light of each LED that was absorbed ended, with standard errors; fractions of the LED's power."""
        return {
            led: {name: {"value": a, "stderr": b} for name, (a, b) in t.fractions(t.absorbed).items()}
            for led, t in zip(self.leds, self.traces, strict=True)
        }

    def energy_by_led(self) -> xr.Dataset:
        """Where each LED's light went, in all and, of what was absorbed, by region, as fractions of its power."""
        data: Variables = {}
        for name, axis in (("energy", "part"), ("absorbed", "region")):
            by_led = [t.fractions(getattr(t, name)) for t in self.traces]
            places = list(dict.fromkeys(place for ends in by_led for place in ends))
            # A region that absorbs nothing at an LED's wavelength has no tally there.
            rows = [[ends.get(place, (0.0, 0.0)) for place in places] for ends in by_led]
            fraction = Estimate(*np.transpose(rows, (2, 0, 1)))
            data |= described(optics.__package__, **{f"{name}_fraction": fraction, axis: places})
        return xr.Dataset(data, {"led": list(self.leds)})

    def merge(self, other: "Transfer") -> "Transfer":
        """This trace and another of the same scene and engine as one; InputError if they differ or share a seed, or the
        light was traced at different absorption."""
        ours, theirs = ({seed for trace in light.traces for seed in trace.seeds} for light in (self, other))
        alike = all(np.array_equal(a.mu_a, b.mu_a) for a, b in zip(self.traces, other.traces, strict=False))
        if (self.scene, self.engine) != (other.scene, other.engine) or ours & theirs or not alike:
            raise InputError("traces are of different scenes, engines or absorption, or share seeds; merge other ones.")
        traces = tuple(joined(pair) for pair in zip(self.traces, other.traces, strict=True))
        effort = {name: getattr(self, name) + getattr(other, name) for name in (*EFFORT, "reused_photons")}
        return replace(self, traces=traces, **effort)

    def save(self, path: str | Path) -> None:
        """Write the transfer to a NumPy archive (.npz), whole or not at all."""
        of_led = ("photons", *SUMS, "seeds")
        leds = [{"records": len(t.weight)} | {name: getattr(t, name) for name in of_led} for t in self.traces]
        header = self.attributes() | {name: getattr(self, name) for name in EFFORT}
        header |= {"leds": leds, "version_table": dict(self.versions)}
        # Photons of all LEDs lie one after the other.
        arrays = {name: np.concatenate([getattr(t, name) for t in self.traces]) for name in COLUMNS}
        arrays["mu_a_per_mm"] = np.array([t.mu_a for t in self.traces])
        io.write_bytes(Path(path), io.pack(header, arrays))

    @staticmethod
    def load(path: str | Path) -> "Transfer":
        """Read a transfer that `save` wrote; raises InputError for a file that is none."""
        path = Path(path)
        try:
            header, arrays = io.unpack(path.read_bytes())
            scene = parse_scene(header["scene"], name="the stored scene")
            count = {"photodiodes": len(photodiode_names(scene)), "absorbers": len(optics.absorbers(scene))}
            leds = header["leds"]
            if len(leds) != len(scene.leds):
                raise io.CorruptError("it is of other LEDs than its scene")
            check_arrays({"mu_a": arrays["mu_a_per_mm"]}, {"mu_a": (len(leds), count["absorbers"])})
            traces, first = [], np.cumsum([0, *(led["records"] for led in leds)])
            for i, led in enumerate(leds):
                content = {name: arrays[name][first[i] : first[i + 1]] for name in COLUMNS} | LedTrace.stored_sums(led)
                content |= {"photons": led["photons"], "seeds": tuple(led["seeds"])}
                traces.append(LedTrace(mu_a=arrays["mu_a_per_mm"][i], **content))
                traces[-1].check(**count)
            made = {name: header[name] for name in ("engine", "backend", *EFFORT)}
            return Transfer(scene, tuple(traces), versions=dict(header["version_table"]), **made)
        except (OSError, io.CorruptError, LookupError, AttributeError, TypeError, ValueError) as error:
            why = f"is not a transfer that this version can read ({error}); trace the scene again."
            raise InputError(f"{path}: {why}") from None

    def _mu_a(
        self, led: int, blood: ArrayLike | None, so2: ArrayLike | None, override: Mapping[str, float] | None
    ) -> Any:
        """Absorption (q, r) over the LED's line, and the line's weights (q,)."""
        wavelengths, weights = optics.spectrum(self.scene.leds[led])
        mu_a = optics.absorption(self.scene, wavelengths, blood_fraction=blood, so2=so2)
        for name, value in (override or {}).items():
            if name not in self.absorbers:
                why = f"known: {', '.join(self.absorbers)}."
                raise InputError(f'mu_a_per_mm names "{name}", which is not an absorber here; {why}')
            if not (np.isfinite(value) and value >= 0):
                raise InputError(f"mu_a_per_mm of {name} = {value}; must be a number of at least 0.")
            mu_a[..., self.absorbers.index(name)] = value
        return mu_a, weights

    @cached_property
    def _traced(self) -> list[Moments]:
        """Sums in the state that was traced, without paths."""
        count = len(self.photodiodes)
        return [moments_of(t.photons, t.photodiode, t.weight, t.path_mm[:, :0], count) for t in self.traces]

    def warn_of_unreliable_weights(self, effective: np.ndarray, least_absorbing: Sequence[Moments]) -> None:
        """Warn where the effective sample size of reweighted readings, (led, photodiode) float, is small, or the tail
        of the weights is heavy: longer paths, not seen, would outweigh all others, and reading and error come out too
        small. Deep tissue at an eighth of its absorption or less has intervals of 95 % that hold 13 to 88 %.

        least_absorbing : sums of each LED in the state of least absorption, where long paths weigh most.
        """
        for led, left, bright, traced in zip(self.leds, effective, least_absorbing, self._traced, strict=True):
            thin = (left < MIN_EFFECTIVE_PHOTONS) & (left < 0.5 * traced.effective_photons)
            heavy = bright.tail_index > np.maximum(MAX_TAIL_INDEX, traced.tail_index + 0.05)
            if (thin | heavy).any():
                i = int(np.argmin(np.where(heavy, 0, np.where(thin, left, np.inf))))
                warnings.warn(
                    f'LED "{led}", photodiode "{self.photodiodes[i]}": so far from the traced state reading and error '
                    f"may be too small ({left[i]:.1f} effective photons of {traced.effective_photons[i]:.0f}, "
                    f"tail index {bright.tail_index[i]:.2f}); trace nearer or more photons, of which a check has few",
                    ReweightWarning,
                    stacklevel=3,
                )

    def attributes(self) -> dict[str, Any]:
        """What a result carries about its making: scene, digest, engine, backend, versions, photons."""
        seeds = " ".join(str(t.seeds[0]) for t in self.traces if t.seeds)
        made: dict[str, Any] = {name: getattr(self, name) for name in ("engine", "backend", "photons", "versions")}
        return provenance(self.scene, seeds=seeds, **made)


def _states(blood_fraction: ArrayLike | None, so2: ArrayLike | None) -> list[tuple[Any, Any]] | None:
    """Blood and saturation of each of several states; None where they are of a single one."""
    blood = None if blood_fraction is None else checks.finite("blood_fraction", blood_fraction)
    saturation = None if so2 is None else checks.fraction("so2", checks.finite("so2", so2))
    shapes = () if blood is None else blood.shape[:-1], () if saturation is None else saturation.shape
    with suppress(ValueError):
        shape = np.broadcast_shapes(*shapes)
        if shape == ():
            return None
        if len(shape) == 1 and shape[0]:
            bloods = shape[0] * [None] if blood is None else np.broadcast_to(blood, (*shape, blood.shape[-1]))
            so2s = shape[0] * [None] if saturation is None else np.broadcast_to(saturation, shape)
            return list(zip(bloods, so2s, strict=True))
    why = "or (states, zones) of blood_fraction, and one number or (states,) of so2, for at least one state."
    raise InputError(f"blood_fraction and so2 are of {' and '.join(map(str, shapes))} states; give (zones,) {why}")


def provenance(
    scene: Scene, *, engine: str, backend: str, photons: int, seeds: str, versions: Mapping[str, str] | None = None
) -> dict[str, Any]:
    """Attributes of a result that say how it was made and let it be made again."""
    return {
        "Conventions": io.CONVENTIONS,
        "scene": to_toml(scene),
        "digest": digest(scene),
        "engine": engine,
        "backend": backend,
        "photons": photons,
        "seeds": seeds,
    } | code_attributes(versions or current_versions())


def mean_of_leds(energy: Sequence[Mapping[str, tuple[float, float]]]) -> dict[str, dict[str, float]]:
    """Where the light of all LEDs went, in equal parts, from the parts of each and their standard errors."""
    out = {}
    for name in energy[0]:
        values, errors = zip(*(parts[name] for parts in energy), strict=True)
        out[name] = {"value": float(np.mean(values)), "stderr": float(np.linalg.norm(errors) / len(errors))}
    return out


def photodiode_names(scene: Scene) -> tuple[str, ...]:
    """Names of the photodiodes in the order in which a trace counts them."""
    return scene.layout.photodiode_names if scene.phantom is None else tuple(p.name for p in scene.photodiodes)

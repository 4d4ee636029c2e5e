"""What another program detected of an exported scene, beside what the walk of photons reads of it."""

from collections.abc import Iterable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple, Unpack

import numpy as np

from .. import light
from ..errors import InputError, as_far_as_reached, unless_cut_off
from ..light import ProgressCallback, optics
from ..light.transfer.records import LedTrace, moments_of
from ..options import Requested
from ..scene import Scene, parse_scene
from ..statistics import stderr_or_nan

# What an export's runner writes.
FIELDS = ("photodiode", "path_mm", "photons", "led", "seed", "program", "scene")
# Blood in all zones, of that at rest, to which readings are read over: from 3 % to 2 and 5 %.
BLOOD_FACTORS = (2 / 3, 5 / 3)
# Readings of fewer photons by either program have no error that could be held against anything.
LEAST_PHOTONS = 10


@dataclass(frozen=True)
class Pair:
    """One quantity by both programs, each with its standard error."""

    ours: float
    ours_stderr: float
    theirs: float
    theirs_stderr: float

    @property
    def deviations(self) -> float:
        """Difference in its standard errors, theirs less ours."""
        return (self.theirs - self.ours) / float(np.hypot(self.ours_stderr, self.theirs_stderr))

    @property
    def ratio(self) -> tuple[float, float]:
        """Ours over theirs, and its standard error."""
        ratio = self.ours / self.theirs
        return ratio, abs(ratio) * float(np.hypot(self.ours_stderr / self.ours, self.theirs_stderr / self.theirs))

    def as_dict(self) -> dict[str, float]:
        """All four numbers and the difference, by name."""
        return {**vars(self), "deviations": self.deviations}


@dataclass(frozen=True)
class ProgramComparison:
    """Readings of two programs of one LED's light.

    program : The other one.
    readings : Detected fraction by photodiode.
    chi2 : Of the differences of the readings by their covariance, one degree of freedom each.
    unread : Photodiodes that too few photons of either program reached.
    total : Sum of the readings.
    changes : Relative change of that sum, by the blood fraction of all zones that it is read over to.
    paths_mm : Mean path of all detected light in each region that it met; the bed's as one, as its zones of blood are
        smooth here and have edges there. [mm]
    """

    program: str
    led: str
    photons: int
    their_photons: int
    readings: dict[str, Pair]
    chi2: float
    unread: tuple[str, ...]
    total: Pair
    changes: dict[float, Pair]
    paths_mm: dict[str, Pair]

    @property
    def p_value(self) -> float:
        """Probability of such a chi^2 or a larger one where both programs are right."""
        from scipy.special import gammaincc

        return float(gammaincc(len(self.readings) / 2, self.chi2 / 2))

    def as_dict(self) -> dict[str, Any]:
        """All of it for JSON."""
        ratio, stderr = self.total.ratio
        return {
            **vars(self),
            "degrees_of_freedom": len(self.readings),
            "p_value": self.p_value,
            "ratio_of_sums": ratio,
            "ratio_of_sums_stderr": stderr,
            "readings": {name: pair.as_dict() for name, pair in self.readings.items()},
            "total": self.total.as_dict(),
            "paths_mm": {name: pair.as_dict() for name, pair in self.paths_mm.items()},
            "changes": [{"blood_fraction": fraction, **pair.as_dict()} for fraction, pair in self.changes.items()],
        }

    def lines(self) -> list[str]:
        """All of it as a table for the terminal."""
        rows = [f"{'':<24}{'nailoptics':>22}{self.program:>22}  z score"]
        named = [*self.readings.items(), ("sum", self.total)]
        named += [(f"change to {f:.2g} blood", pair) for f, pair in self.changes.items()]
        named += [(f"path in {name} [mm]", pair) for name, pair in self.paths_mm.items()]
        for name, p in named:
            ours, theirs = f"{p.ours:.4g} +- {p.ours_stderr:.1g}", f"{p.theirs:.4g} +- {p.theirs_stderr:.1g}"
            rows.append(f"{name:<24}{ours:>22}{theirs:>22}  {p.deviations:+.1f}")
        ratio, stderr = self.total.ratio
        rows.append(f"ratio of sums {ratio:.4f} +- {stderr:.4f}")
        rows.append(f"chi^2 {self.chi2:.1f} of {len(self.readings)} readings, p = {self.p_value:.2g}")
        if self.unread:
            rows.append(f"too few photons for a comparison: {', '.join(self.unread)}")
        return rows


class OtherDetection(NamedTuple):
    """What another program detected of an LED of a scene: photons, paths, and weights that hold without absorption."""

    program: str
    scene: Scene
    led: int
    trace: LedTrace


def compare_with(
    path: str | Path, *, progress: ProgressCallback | None = None, **requested: Unpack[Requested]
) -> ProgramComparison:
    """Compare what another program detected of an exported scene with our trace of that scene.

    path : the file that an export's runner wrote.
    requested : how our light is traced, fields of `TraceOptions`.

    Raises: InputError for another file; NotReachedError, with the comparison so far as result, where ours falls short.
    """
    theirs = read_detected(Path(path))
    transfer, unmet = as_far_as_reached(light.trace, theirs.scene, progress=progress, **requested)
    return unless_cut_off(compared(transfer.traces[theirs.led], theirs), unmet)


def read_detected(path: Path) -> OtherDetection:
    """Read the file that an export's runner wrote; raises InputError for another one."""
    try:
        with np.load(BytesIO(path.read_bytes()), allow_pickle=False) as file:
            fields = {name: file[name] for name in FIELDS}
        which, paths = fields["photodiode"].astype(np.int64), fields["path_mm"].astype(np.float32)
        photons, led, seed = (int(fields[name]) for name in ("photons", "led", "seed"))
    except OSError as error:
        why = f"cannot be read: {error.strerror or error}; give the detected.npz of an export's runner."
        raise InputError(f"{path}: {why}") from None
    except Exception as error:  # what is not an archive of arrays fails in many ways
        raise InputError(f"{path}: is not what an export's runner writes ({error}); give its detected.npz.") from None
    scene = parse_scene(str(fields["scene"]), name=f"{path}: its scene")
    if scene.finger is None or not 0 <= led < len(scene.leds):
        raise InputError(f"{path}: its scene has no finger, or no LED {led + 1}; export the scene again.")
    photodiodes, absorbers = len(scene.layout.photodiode_names), len(optics.absorbers(scene))
    shape = (len(which), absorbers) if which.ndim == 1 else None
    beyond = ((which < 0) | (which >= photodiodes)).any()
    for wrong, why in (
        (paths.shape != shape, f"path_mm has shape {paths.shape} for {which.size} photons and {absorbers} absorbers"),
        (beyond, f"photodiode reaches {which.max(initial=0)}, but the scene has {photodiodes}"),
        (not (np.isfinite(paths) & (paths >= 0)).all(), "path_mm must be finite and not negative"),
        (photons < max(2, len(which)), f"photons = {photons}, fewer than the {len(which)} that were detected"),
    ):
        if wrong:
            raise InputError(f"{path}: {why}; run the export again.")
    photon, weight = np.arange(len(which)), np.ones(len(which))
    trace = LedTrace(photons, np.zeros(absorbers), photon, which, weight, paths, {}, (seed,))
    return OtherDetection(str(fields["program"]), scene, led, trace)


def compared(ours: LedTrace, theirs: OtherDetection) -> ProgramComparison:
    """Readings, their sum, its change with the blood and mean paths of one LED's light by two programs."""
    scene, both = theirs.scene, (ours, theirs.trace)
    wavelength, names = scene.leds[theirs.led].wavelength_nm, scene.layout.photodiode_names
    at_rest = optics.absorption(scene, wavelength)
    regions = [*dict.fromkeys(absorber.region for absorber in optics.absorbing(scene))]
    columns = np.array([[a.region == region for region in regions] for a in optics.absorbing(scene)], np.float32)
    made = [(trace, trace.weight_at(at_rest, np.ones(1)), trace.path_mm @ columns) for trace in both]
    each = [moments_of(t.photons, t.photodiode, weight, path_mm, len(names)) for t, weight, path_mm in made]
    covariances = np.stack([trace.covariance(at_rest, np.ones(1), count=len(names)) for trace in both])
    read = [i for i in range(len(names)) if all(m.effective_photons[i] >= LEAST_PHOTONS for m in each)]
    if not read:
        raise InputError(f"too few photons reached any photodiode in nailoptics or {theirs.program}; send more.")
    off = (each[1].fraction - each[0].fraction)[read]
    changes = {}
    for factor in BLOOD_FACTORS:
        fraction = min(factor * scene.blood.rest_blood_fraction, 1.0)
        mu_a = optics.absorption(scene, wavelength, blood_fraction=np.full(scene.zone_count, fraction))
        changes[fraction] = _pair(_ratio(t, t.weight_at(mu_a, np.ones(1)) - w, w) for t, w, _ in made)
    by_region = {name: [_ratio(t, w * path[:, r], w) for t, w, path in made] for r, name in enumerate(regions)}
    return ProgramComparison(
        program=theirs.program,
        led=scene.leds[theirs.led].name,
        photons=ours.photons,
        their_photons=theirs.trace.photons,
        readings={names[i]: _pair((m.fraction[i], m.stderr[i]) for m in each) for i in read},
        chi2=float(off @ np.linalg.solve(covariances.sum(0)[np.ix_(read, read)], off)),
        unread=tuple(name for i, name in enumerate(names) if i not in read),
        total=_pair((m.fraction.sum(), np.sqrt(c.sum())) for m, c in zip(each, covariances, strict=True)),
        changes=changes,
        paths_mm={name: _pair(both) for name, both in by_region.items() if all(error > 0 for _, error in both)},
    )


def _pair(both: Iterable[tuple[Any, Any]]) -> Pair:
    return Pair(*(float(number) for estimate in both for number in estimate))


def _ratio(trace: LedTrace, above: np.ndarray, below: np.ndarray) -> tuple[float, float]:
    """Ratio of two sums over the records, (n,) float each, and its standard error: both share their photons."""
    photon = np.unique(trace.photon, return_inverse=True)[1]
    above, below = (np.bincount(photon, values) for values in (above, below))
    ratio = above.sum() / below.sum()
    stderr = np.linalg.norm(above - ratio * below) / below.sum()
    return float(ratio), float(stderr_or_nan(stderr, above.sum(), (above**2).sum()))

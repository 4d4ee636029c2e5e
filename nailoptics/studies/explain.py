"""What a scene models, what it leaves out, and how far each of these moves the readings, measured."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from ..errors import InputError
from ..light import Progress
from ..scene import Scene
from . import derived, variants
from .effects import Effect, effect_of
from .variants import Look, revised

DEFAULT_SECONDS = 90.0
DEFAULT_TOLERANCE = 0.02
# Geometry and kernels come first; a trace gets this long at least. [s]
LEAST_SECONDS = 1.0
# A finger cannot be cut nearer to the nail than this much more than the nail's length.
SHORTEST_BEYOND_NAIL_MM = 4.0


@dataclass(frozen=True)
class Explanation:
    """All effects of a scene, the most moving first, and what it took."""

    effects: tuple[Effect, ...]
    tolerance: float
    photons: int
    backend: str
    wall_seconds: float

    def as_dict(self) -> dict[str, Any]:
        """Everything, ready for JSON."""
        rows = [vars(effect) | {"matters": effect.matters} for effect in self.effects]
        return {name: value for name, value in vars(self).items() if name != "effects"} | {"effects": rows}

    def __str__(self) -> str:
        head = f"{'effect':<26} {'in scene':<8} {'reading moves':>17} {'at most':>8} {'modulation':>10}  matters"
        lines = [f"Changes of a reading by more than {self.tolerance:.2%} matter.", head]
        for e in self.effects:
            swing = f"{e.modulation_bound:9.1%}" if e.modulation_bound is not None else "-"
            told = f"{100 * e.typical:+8.2f} +- {100 * e.typical_stderr:4.2f}%"
            shown = "yes" if e.modelled else "no"
            lines.append(
                f"{e.name:<26} {shown:<8} {told:>17} {e.bound:>8.1%} {swing:>10}  {e.matters:<11} {e.changed_to}"
            )
        needless = [e.lines for e in self.effects if e.modelled and e.matters == "no" and e.lines]
        missing = [e.name for e in self.effects if not e.modelled and e.matters == "yes"]
        if needless:
            lines.append("Not needed; these scene lines leave it out: " + "; ".join(needless))
        if missing:
            lines.append("Left out, though it matters: " + ", ".join(missing))
        return "\n".join(lines)


@dataclass(frozen=True)
class _Change:
    name: str
    modelled: bool
    changed_to: str
    scene: Scene
    lines: str = ""
    same_photons: bool = False


def explain(
    scene: Scene,
    *,
    tolerance: float | None = None,
    seed: int = 0,
    backend: str = "auto",
    photons: int | None = None,
    relative_error: float | None = None,
    max_seconds: float | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Explanation:
    """Measure what every part and effect of a finger scene does to its readings.

    Absorbers and line widths are reread from one trace, with the same photons; everything else is traced with that one
    thing changed, in equal shares of the time.

    Parameters
    ----------
    tolerance : relative change of a reading that matters; the scene's relative error if not given, else 2 %.
    max_seconds : for all traces together; 90 if neither photons nor an error is asked for.

    Raises: InputError.
    """
    if scene.finger is None:
        raise InputError("explain needs a [finger] scene; a [phantom] is modelled as it is written.")
    limit = DEFAULT_TOLERANCE if tolerance is None else tolerance
    if tolerance is None and scene.accuracy.relative_error is not None:
        limit = scene.accuracy.relative_error
    if not 0 < limit < 1:
        raise InputError(f"tolerance = {limit:g} must lie between 0 and 1.")
    if photons is None and relative_error is None and max_seconds is None:
        max_seconds = DEFAULT_SECONDS
    start = time.perf_counter()
    changes = list(_changes(scene))
    traced = [c for c in changes if not c.same_photons]
    # The scene itself stands in every difference: it gets two shares; three more go to what is derived below.
    shares = len(traced) + 5
    counted = 0

    def seen(one: Scene, number: int, parts: int = 1) -> Look:
        nonlocal counted, shares
        left = None if max_seconds is None else max_seconds - (time.perf_counter() - start)
        limit_s = None if left is None else max(left * parts / shares, LEAST_SECONDS)
        shares -= parts
        found, _ = variants.look(
            # A tolerance in the scene would set the time of each trace; here the shares do.
            one.model_copy(update={"accuracy": type(scene.accuracy)()}),
            seed=seed + number,
            backend=backend,
            photons=photons,
            relative_error=relative_error,
            max_seconds=limit_s,
            progress=progress,
        )
        counted += found.transfer.photons
        return found

    base = seen(scene, 0, 2)
    effects = []
    for number, change in enumerate(changes, start=1):
        if change.same_photons:
            effects.append(_effect(change, base, variants.reread(base.transfer, change.scene), limit))
        else:
            effects.append(_effect(change, base, seen(change.scene, number), limit))
    effects.append(derived.blood_scattering(scene, base, seen(derived.denser(scene), len(changes) + 1), limit))
    swapped = seen(derived.swapped_scene(scene), len(changes) + 2)
    effects.append(derived.ambient(scene, base, swapped, limit))
    length, shortest = scene.finger.length_mm, scene.finger.nail_length_mm + SHORTEST_BEYOND_NAIL_MM
    beyond = (f"beyond the cut at {length:g} mm", False, "finger without an end", "")
    effects.append(derived.returning(*beyond, base, base, swapped, limit))
    if length > shortest:
        cut = seen(revised(scene, {"finger": {"length_mm": shortest}}), len(changes) + 3)
        text = (f"finger past {shortest:g} mm", True, "cut there", f"finger.length_mm = {shortest:g}")
        effects.append(derived.returning(*text, base, cut, cut, limit))
    effects.append(derived.nothing("light through the cover", "the cover passes none: opaque by construction", limit))
    effects.sort(key=lambda e: -abs(e.typical))
    return Explanation(tuple(effects), limit, counted, base.transfer.backend, wall_seconds=time.perf_counter() - start)


def _changes(scene: Scene) -> Iterator[_Change]:
    """The scene with one thing changed at a time."""
    assert scene.finger is not None
    light, board, finger = scene.light, scene.board, scene.finger
    steps = light.index_steps
    yield _Change(
        "index steps",
        steps,
        "one index everywhere" if steps else "refraction where the index changes",
        revised(scene, {"light": {"index_steps": not steps}}),
        f"light.index_steps = {str(not steps).lower()}",
    )
    yield _Change(
        "forward scattering",
        not light.similarity,
        "isotropic with the same mu_s'" if not light.similarity else "Henyey-Greenstein",
        revised(scene, {"light": {"similarity": not light.similarity}}),
        f"light.similarity = {str(not light.similarity).lower()}",
    )
    for part in ("bone", "epidermis", "kapton"):
        gone = part in light.left_out
        others = tuple(p for p in light.left_out if p != part)
        left = others if gone else (*others, part)
        yield _Change(
            part,
            not gone,
            "optics of its own" if gone else "optics of what surrounds it",
            revised(scene, {"light": {"left_out": left}}),
            f"light.left_out = {list(left)}",
        )
    if any(led.fwhm_nm for led in scene.leds):
        one_line = variants.without_lines(scene)
        yield _Change("LED line width", True, "peak wavelength alone", one_line, "leds.fwhm_nm = 0", same_photons=True)
    melanin = finger.melanin_fraction
    yield _Change(
        "melanin",
        melanin > 0,
        "none" if melanin else "1.3 % of the epidermis",
        revised(scene, {"finger": {"melanin_fraction": 0.0 if melanin else 0.013}}),
        f"finger.melanin_fraction = {0.0 if melanin else 0.013}",
        same_photons=True,
    )
    if board.opaque_reflectance:
        black = revised(scene, {"board": {"opaque_reflectance": 0.0}})
        yield _Change("opaque epoxy's reflection", True, "black", black, "board.opaque_reflectance = 0.0")
    if board.barrier:
        open_board = revised(scene, {"board": {"barrier": False}})
        yield _Change("barrier", True, "clear epoxy in its place", open_board, "board.barrier = false")


def _effect(change: _Change, base: Look, other: Look, tolerance: float) -> Effect:
    """The difference between two looks; of the same photons, its error is that of their few lost or gained weights."""
    ratio, error = variants.difference(base, other)
    with np.errstate(divide="ignore", invalid="ignore"):
        unit = np.nanmax(np.abs(base.modulation)) if np.isfinite(base.modulation).any() else np.nan
        swing = (other.modulation - base.modulation) / unit
        noise = np.hypot(base.modulation_stderr, other.modulation_stderr) / unit
        noise = np.abs(swing) * base.relative_stderr if change.same_photons else noise
    words = (change.name, change.modelled, change.changed_to)
    how: Literal["reread", "retraced"] = "reread" if change.same_photons else "retraced"
    return effect_of(*words, ratio, error, (swing, noise), change.lines, tolerance, how, base)

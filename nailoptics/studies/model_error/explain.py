"""What a scene models, what it leaves out, how far each of these moves the readings, and what the scene requires."""

import math
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal, TypeAlias, Unpack

import numpy as np

from ... import geometry, tissue
from ...display import Displayed
from ...errors import InputError, NotReachedError, unless_cut_off
from ...light import ProgressCallback, optics
from ...light.identity import light_digest
from ...options import Requested, TraceOptions
from ...scene import Led, Prior, Scene, SceneIn, as_scene
from ...scene.catalogue import LedPart, load_part
from ...scene.files import scene_of
from ...scene.layout import LEAST_EPOXY_UM
from ...sensor import electronics
from ...sensor.ambient import LAMP, trace_ambient
from ...statistics import Z95
from ..prior_uncertainty import value_of
from . import paired
from .paired import Difference, Estimates, PairedReadings, PairedTracer

AIR_UM = 25.0  # of a board that is lifted, or not bonded; what light meets there hardly depends on it
DIE_UM = 150.0  # dies of LEDs and photodiodes are 100 to 250 um thick
# Fields by table of the scene; those of "leds" and "photodiodes" are every one's, None stands for what its part says.
Changes = dict[str, dict[str, Any]]
EACH = ("leds", "photodiodes")
ONE_WAVELENGTH: Changes = {"leds": {"fwhm_nm": 0.0}}
PART_WIDTH: Changes = {"leds": {"fwhm_nm": None}}
How = Literal["reweighted", "retraced", "derived"]


@dataclass(frozen=True)
class Change:
    """One part or effect of a scene, whether the scene models it, and what the scene would have in its place.

    changes : what of the scene makes it so; nothing where no line can.
    unknown : whether it is no part but something unknown of the finger, at an end of its range, or of the sensor.
    """

    name: str
    modelled: bool
    changed_to: str
    changes: Changes = field(default_factory=dict)
    unknown: bool = False


def part_width_nm(led: Led) -> float:
    """Line width that an LED's part has; its own if it has no part that can be found."""
    try:
        part = load_part(led.part, expect=LedPart) if led.part else led
        return float(part.fwhm_nm) if isinstance(part, LedPart) else led.fwhm_nm
    except InputError:
        return led.fwhm_nm


def revised(scene: Scene, changes: Changes) -> Scene:
    """The scene with some fields of some of its tables changed; raises InputError where that makes no scene."""
    tables = scene.model_dump()
    for table, fields in changes.items():
        if table not in EACH:
            tables[table] |= {name: tuple(v) if isinstance(v, list) else v for name, v in fields.items()}
            continue
        new = {name: value for name, value in fields.items() if value is not None}
        tables[table] = tuple(row | new for row in tables[table])
        if PART_WIDTH["leds"].items() <= fields.items():
            for row, led in zip(tables[table], scene.leds, strict=True):
                row["fwhm_nm"] = part_width_nm(led)
    return scene_of(tables)


def changes_between(scene: Scene, other: Scene) -> Changes:
    """What of its light, and of its LEDs' line widths, makes one scene the other."""
    before, after = scene.light.model_dump(mode="json"), other.light.model_dump(mode="json")
    light = {name: value for name, value in after.items() if value != before[name]}
    changes: Changes = {"light": light} if light else {}
    if [led.fwhm_nm for led in scene.leds] != [led.fwhm_nm for led in other.leds]:
        changes |= PART_WIDTH if any(led.fwhm_nm for led in other.leds) else ONE_WAVELENGTH
    return changes


def lines_of(changes: Changes) -> list[str]:
    """The lines of a scene file that make these changes, each with the table that it belongs in before it."""
    import tomli_w

    lines = []
    for table, fields in changes.items():
        for name, value in fields.items():
            place = f"[[{table}]]" if table in EACH else f"[{table}]"
            text = f"without {name}" if value is None else " ".join(tomli_w.dumps({name: value}).split())
            lines.append(f"{place} {text}".replace("[ ", "[").replace(", ]", "]"))
    return lines


def merged(changed: Iterable[Change]) -> Changes:
    """All their changes at once; a part is left out, or put in, beside what others do to the same list."""
    out: Changes = {}
    for effect in changed:
        for table, fields in effect.changes.items():
            for name, value in fields.items():
                before = out.setdefault(table, {}).get(name)
                if name == "left_out" and before is not None:
                    value = sorted(set(value) | set(before)) if effect.modelled else sorted(set(value) & set(before))
                out[table][name] = value
    if "epidermis" in out.get("light", {}).get("left_out", ()):
        # Its melanin goes with it.
        out.get("finger", {}).pop("melanin_fraction", None)
    return {table: fields for table, fields in out.items() if fields}


def _unknown(scene: Scene, prior: Prior) -> Change:
    """A prior at that end of its range which is farther from the scene's value, on the prior's scale."""
    ends = (prior.low, value_of(scene, prior.field), prior.high)
    low, middle, high = np.log(ends) if prior.scale == "log" else ends
    # A nudge, so that rounding does not decide between ends that are as far.
    end = prior.low if middle - low > high - middle + 1e-3 else prior.high
    table, name = prior.field.split(".")
    text = f"{name} = {end:g}, of {prior.low:g} to {prior.high:g}"
    return Change(prior.name, True, text, {table: {name: end}}, unknown=True)


def changes_of(scene: Scene) -> Iterator[Change]:
    """Every part and effect of a scene, then all priors, each with what leaves it out, or puts it in."""
    light, board, finger = scene.light, scene.board, scene.fingertip
    steps, similar, melanin = light.index_steps, light.similarity, finger.melanin_fraction
    text = "one index everywhere" if steps else "refraction where the index changes"
    yield Change("index steps", steps, text, {"light": {"index_steps": not steps}})
    text = "Henyey-Greenstein" if similar else "isotropic with the same mu_s'"
    yield Change("forward scattering", not similar, text, {"light": {"similarity": not similar}})
    for part in ("bone", "epidermis", "kapton"):
        gone = part in light.left_out
        left = [p for p in light.left_out if p != part] if gone else [*light.left_out, part]
        its_own = "optics of its own" + (", melanin" if part == "epidermis" else "")
        text = its_own if gone else "optics of what surrounds it"
        yield Change(part, not gone, text, {"light": {"left_out": left}})
    if any(led.fwhm_nm for led in scene.leds):
        yield Change("LED line width", True, "peak wavelength alone", ONE_WAVELENGTH)
    elif any(part_width_nm(led) for led in scene.leds):
        yield Change("LED line width", False, "as its part has", PART_WIDTH)
    if "epidermis" not in light.left_out:
        usual = type(finger).model_fields["melanin_fraction"].default
        text = "none" if melanin else f"{usual:.1%} of the epidermis"
        yield Change("melanin", melanin > 0, text, {"finger": {"melanin_fraction": 0.0 if melanin else usual}})
    if board.opaque_reflectance:
        yield Change("opaque epoxy's reflection", True, "black", {"board": {"opaque_reflectance": 0.0}})
    if board.barrier:
        yield Change("barrier", True, "clear epoxy in its place", {"board": {"barrier": False}})
    stand_out = any(led.height_um for led in scene.leds) or any(p.height_um for p in scene.photodiodes)
    height_um = 0.0 if stand_out else min(DIE_UM, board.clear_epoxy_um - LEAST_EPOXY_UM)
    text = "flush with the board's underside" if stand_out else f"standing {height_um:g} um out of the board"
    if stand_out or height_um:
        # A scene that says nothing of it leaves it unknown: what it requires is not to be guessed.
        heights: Changes = {table: {"height_um": height_um} for table in EACH}
        yield Change("height of dies", True, text, heights, unknown=not stand_out)
    bonded = board.air_gap_um is None
    text = f"{AIR_UM:g} um of air on the nail" if bonded else "adhesive on the nail"
    air: Changes = {"board": {"air_gap_um": AIR_UM if bonded else None}}
    yield Change("air under the board", True, text, air, unknown=bonded)
    if not board.cover_um:
        cover = type(board).model_fields["cover_um"].default
        yield Change("cover and decorative nail", False, "opaque cover", {"board": {"cover_um": cover}})
    if scene.priors.spread:
        yield from (_unknown(scene, prior) for prior in scene.finger_priors)


# What makes an effect of a scene's readings and those of other scenes, and these, which are traced for it.
Measurement: TypeAlias = tuple[Callable[..., "Effect"], *tuple[Scene, ...]]

DEFAULT_TOLERANCE = 0.02
TOGETHER = "all that is not needed"
# An effect is sure to matter if its change exceeds the tolerance by so many standard errors: by chance alone that
# happens to one of 2000 changes, so that a study of a hundred is right about all of them in 19 of 20 cases.
SURE = 3.5
# The bed scatters so many times as much for the slope of a reading by its scattering.
SCATTERING_FACTOR = 1.4


@dataclass(frozen=True, kw_only=True)
class Effect(Change):
    """A change that was measured: by how much readings move.

    of : "reading" where it may move the reading at rest by more than the tolerance, else "signal", the change by touch.
    change, stderr : change of that, of the reading at rest relative and of the signal as a fraction of the largest, of
        the photodiode named, which it changes most; the error allows for its selection: its 95 % interval holds
        with Bonferroni's correction for all photodiodes.
    bound : what no photodiode's change exceeds, with 95 % confidence each.
    modulation_bound : the same bound on the modulation by touch, as a fraction of the largest modulation.
    """

    how: How
    change: float
    stderr: float
    bound: float
    photodiode: str
    modulation_bound: float | None
    tolerance: float
    of: Literal["reading", "signal"] = "reading"

    @property
    def matters(self) -> Literal["yes", "no", "undecided"]:
        """Whether it moves a reading, or the signal, by more than the tolerance, as far as the traces resolve it."""
        if self.bound <= self.tolerance:
            return "no"
        return "yes" if abs(self.change) - SURE * self.stderr > self.tolerance else "undecided"


@dataclass(frozen=True, repr=False)
class Explanation(Displayed):
    """All effects and priors of a scene, those that change readings most first; what it requires; its cost.

    together : what leaving out all that is not needed does to the readings; None where all is needed.
    required : the scene with that left out, and with what it leaves out although it matters.
    photons : of each LED in each trace.
    attributes : what makes it again, and `cut_off`, why it ended before all was measured, if it did.
    """

    effects: tuple[Effect, ...]
    together: Effect | None
    required: Scene
    tolerance: float
    photons: int
    backend: str
    wall_seconds: float
    attributes: dict[str, Any] = field(default_factory=dict)

    @property
    def needless(self) -> list[Effect]:
        """Modelled effects that are significantly below the tolerance at every reading."""
        return needless(self.effects)

    @property
    def missing(self) -> list[Effect]:
        """Omitted effects that are significantly above the tolerance."""
        return [e for e in self.effects if not e.modelled and e.matters == "yes"]


def needless(effects: Iterable[Effect]) -> list[Effect]:
    """The modelled effects that are significantly below the tolerance; undecided ones stay."""
    return [e for e in effects if e.modelled and e.matters == "no" and e.changes and not e.unknown]


def explain(
    scene: SceneIn,
    *,
    tolerance: float | None = None,
    progress: ProgressCallback | None = None,
    **requested: Unpack[Requested],
) -> Explanation:
    """Measure what every part and effect of a finger scene, and all unknown of the finger, does to its readings.

    What only dims light, absorbers and line widths, is read from one trace with other weights. Everything else is
    traced with that one thing changed and the same random numbers, so that only photons that meet it make up the
    difference and its error.

    tolerance : relative change of a reading that matters; the scene's relative error if not given, else 2 %.
    photons : of each LED in each trace; or
    relative_error : of the scene's own trace, all others having as many photons; or
    max_seconds : for all traces together, from which the photons follow where they are not given; then it ends with
        what there is. If nothing is requested, about 90.

    Raises: InputError; NotReachedError, whose result is the Explanation as far as it was made, if interrupted or out
        of time.
    """
    scene = as_scene(scene)
    limit = tolerance or scene.accuracy.relative_error or DEFAULT_TOLERANCE
    paired.check_study(scene, limit if tolerance is None else tolerance, "explain", "is modelled as it is written")
    options, start = TraceOptions(**requested), time.perf_counter()
    planned = measurements(scene, limit, options)
    # The scene itself, and what is not needed left out of it.
    tracer = PairedTracer(2 + sum(len(scenes) for _, *scenes in planned), options, progress)
    base = tracer.trace(scene)
    effects: list[Effect] = []
    together, unmet = None, tracer.unmet_reason
    try:
        for effect, *scenes in planned:
            effects.append(effect(base, *map(tracer.trace, scenes)))
        if left := merged(needless(effects)):
            change = Change(TOGETHER, True, "left out", left)
            together = by_change(change, limit, base, tracer.trace(revised(scene, left)))
    except NotReachedError as error:
        unmet = f"{str(error).rstrip('.')}; {len(effects)} effects were measured before."
    effects.sort(key=lambda e: -abs(e.change) if math.isfinite(e.change) else 0.0)
    result = Explanation(
        effects=tuple(effects),
        together=together,
        required=scene,
        tolerance=limit,
        photons=base.transfer.traces[0].photons,
        backend=base.transfer.backend,
        wall_seconds=time.perf_counter() - start,
        attributes=base.transfer.attributes() | ({"cut_off": unmet} if unmet else {}),
    )
    required = revised(scene, merged([*result.needless, *result.missing]))
    return unless_cut_off(replace(result, required=required), unmet)


def measurements(scene: Scene, tolerance: float, options: TraceOptions) -> list[Measurement]:
    """All effects of a scene; first those that need no trace, then those of its own geometry."""
    out: list[Measurement] = []
    for change in changes_of(scene):
        changed = revised(scene, change.changes)
        retraced = [changed] if light_digest(changed) != light_digest(scene) else []
        out.append((partial(by_change, change, tolerance), *retraced))
    denser = revised(scene, {"finger": {"bed_scattering": SCATTERING_FACTOR * scene.fingertip.bed_scattering}})
    out.append((partial(blood_scattering, tolerance), denser))
    # What the geometry is built from, with all parts, so that paths are shared.
    shape_of = partial(geometry.shaping, with_faces=geometry.AROUND)
    shape = shape_of(scene)
    planned = sorted(out, key=lambda group: (len(group) > 1, any(shape_of(other) != shape for other in group[1:])))
    # Of light from outside the trace is its own, after all others.
    return [*planned, (partial(ambient, tolerance, options),)]


def effect_of(
    change: Change, measured: Difference, base: PairedReadings, *, tolerance: float, how: How = "derived"
) -> Effect:
    """An effect from the difference that its change makes; without a modulation where the difference has none.

    An effect significantly below the tolerance at every reading is evaluated by the signal, where that is known.
    """
    from scipy.special import ndtri

    of: Literal["reading", "signal"] = "reading"
    differences = measured.reading
    if base.largest_modulation[0] > 0 and measured.signal is not None and (measured.reading.bound <= tolerance).all():
        of, differences = "signal", measured.signal
    known = np.isfinite(differences.value) & np.isfinite(differences.stderr)
    # Where nothing was detected, anything may be.
    ratio, error = np.where(known, differences.value, np.nan), np.where(known, differences.stderr, np.nan)
    # What is known best, not what is noisiest, says by how much readings move at least.
    sure = np.where(known, np.abs(ratio) - SURE * error, -np.inf)
    best = i, j = np.unravel_index(int(np.argmax(sure)), sure.shape)
    picked = float(ndtri(1 - 0.025 / max(int(known.sum()), 1))) / Z95
    of_signal = math.nan if measured.signal is None else float(measured.signal.bound.max())
    return Effect(
        **vars(change),
        how=how,
        change=float(ratio[best]),
        stderr=picked * float(error[best]),
        bound=float(np.where(known, differences.bound, np.inf).max()),
        photodiode=f"{base.transfer.leds[i]} on {base.transfer.photodiodes[j]}",
        modulation_bound=of_signal if math.isfinite(of_signal) else None,
        tolerance=tolerance,
        of=of,
    )


def by_change(change: Change, tolerance: float, base: PairedReadings, *retraced: PairedReadings) -> Effect:
    """What a change does: by a trace with it, or, of what only dims light, by the same photons with other weights."""
    other = retraced[0] if retraced else paired.reweighted(base, revised(base.transfer.scene, change.changes))
    how: How = "retraced" if retraced else "reweighted"
    return effect_of(change, paired.difference(base, other), base, tolerance=tolerance, how=how)


def blood_scattering(tolerance: float, base: PairedReadings, denser: PairedReadings) -> Effect:
    """What the scattering of the blood that a touch moves would do to the signal; the model's stays as at rest.

    Blood takes the place of dermis. The slope of a reading by the scattering is known for the whole bed; each zone gets
    the part of it that the light's path has there.
    """
    scene = base.transfer.scene
    reading, factor = paired.difference(base, denser).reading, scene.fingertip.bed_scattering
    moved = np.diff(paired.end_states(scene), axis=0)[0]
    contrast = [tissue.blood_scattering_contrast(led.wavelength_nm, bed_scattering=factor) for led in scene.leds]
    paths = np.zeros((len(scene.leds), len(moved), base.level.shape[1]))
    for of_led, trace, part in zip(paths, base.transfer.traces, base.parts, strict=True):
        for of_zone, column in zip(of_led, optics.bed_columns(scene), strict=True):
            of_zone += np.bincount(trace.photodiode, part[:, 0] * trace.path_mm[:, column], minlength=len(of_zone))
    unit, unit_stderr = base.largest_modulation
    with np.errstate(divide="ignore", invalid="ignore"):
        more = np.array(contrast)[:, None] * np.tensordot(paths, moved, (1, 0)) / paths.sum(1) / unit
        signal = more * np.log1p(reading.value) / np.log(SCATTERING_FACTOR)
        slope = more / (1 + reading.value) / np.log(SCATTERING_FACTOR)
        error = np.hypot(slope * reading.stderr, signal * unit_stderr / unit)
        skew = np.abs(slope) * reading.skew
    text = f"replaces dermis, which scatters {1 / (1 + np.mean(contrast)):.2g} times as much"
    none = Estimates(np.zeros_like(signal), np.zeros_like(signal))
    measured = Difference(none, Estimates(signal, error, skew))
    return effect_of(Change("blood's own scattering", False, text), measured, base, tolerance=tolerance)


def ambient(tolerance: float, options: TraceOptions, base: PairedReadings) -> Effect:
    """The light from outside that the scene names, or else a lamp's, beside the LED's light on each photodiode."""
    scene = base.transfer.scene
    source, diodes = scene.ambient or LAMP, scene.elements
    full_a = np.array([electronics.photocurrent_a(1.0, led, diodes) for led in scene.leds])
    outside_a = trace_ambient(scene, [source], options, seed=options.seed)[:2, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio, error = (np.where(base.level > 0, current / (base.level * full_a), np.inf) for current in outside_a)
        measured = Difference(Estimates(ratio, np.hypot(error, ratio * base.relative_stderr)))
    text = f"{source.words} on all sides; a reading with the LED off takes it away"
    return effect_of(Change("ambient light", scene.ambient is not None, text), measured, base, tolerance=tolerance)

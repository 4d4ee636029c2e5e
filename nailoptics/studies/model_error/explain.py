"""What a scene models, what it leaves out, how far each of these moves the readings, and what the scene requires."""

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Unpack

from ...errors import NotReachedError
from ...light import ProgressCallback
from ...options import Requested, TraceOptions
from ...scene import Scene
from ...scene.finger import BEYOND_NAIL_MM
from ...scene.layout import LEAST_EPOXY_UM
from . import bounds
from .answers import percent
from .effect import Change, Effect, effect_of
from .paired import PairedReadings, PairedTracer, check_study, difference, reweighted, shape_of
from .unknown_changes import unknown_changes
from .variants import EACH, ONE_WAVELENGTH, PART_WIDTH, Changes, lines_of, part_width_nm, revised

DEFAULT_TOLERANCE = 0.02
DIE_UM = 150.0  # dies of LEDs and photodiodes are 100 to 250 um thick
TOGETHER = "all that is not needed"


@dataclass(frozen=True)
class Explanation:
    """All effects of a scene and all that is unknown of its finger, the most moving first; what it requires; its cost.

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
    def cut_off(self) -> str | None:
        """Why it ended before all was measured, if it did."""
        return self.attributes.get("cut_off")

    @property
    def needless(self) -> list[Effect]:
        """What is modelled and surely moves no reading by more than the tolerance."""
        return [e for e in self.effects if e.modelled and e.matters == "no" and e.changes and not e.unknown]

    @property
    def without_needless(self) -> Changes:
        """What leaves all of that out at once."""
        return _merged(self.needless)

    @property
    def missing(self) -> list[Effect]:
        """What is left out and surely matters."""
        return [e for e in self.effects if not e.modelled and e.matters == "yes"]

    def as_dict(self) -> dict[str, Any]:
        """Everything, ready for JSON."""

        def row(effect: Effect) -> dict[str, Any]:
            measured = {name: value for name, value in vars(effect).items() if name != "same_photons"}
            return measured | {"matters": effect.matters, "lines": effect.lines}

        return {
            "effects": [row(e) for e in self.effects],
            "not_needed": [e.name for e in self.needless],
            "missing": [e.name for e in self.missing],
            "together": self.together and row(self.together),
        } | {name: getattr(self, name) for name in ("tolerance", "photons", "backend", "wall_seconds", "cut_off")}

    def __str__(self) -> str:
        head = f"{'effect':<26} {'in scene':<8} {'reading moves':>18} {'of':<16} "
        head += f"{'all at most':>11} {'signal':>8}  matters"
        lines = [f"Cut off: {self.cut_off}"] if self.cut_off else []
        lines += [f"Changes of a reading by more than {100 * self.tolerance:g} % matter.", head]
        for e in (*self.effects, *([self.together] if self.together else [])):
            swing = "-" if e.modulation_bound is None else _percent(e.modulation_bound)
            known, modelled = math.isfinite(e.change), "unknown" if e.unknown else "yes" if e.modelled else "no"
            moved = percent(e.change, e.stderr) if known else "not known"
            of = e.photodiode + (" (signal)" if e.of == "signal" else "") if known else ""
            text = f"{e.name:<26} {modelled:<8} {moved:>18} {of:<16} "
            lines.append(f"{text}{_percent(e.bound):>11} {swing:>8}  {e.matters:<11} {e.changed_to}")
        if self.needless:
            lines.append("Not needed each by itself; these scene lines leave all of it out:")
            lines += [*(f"  {line}" for line in lines_of(self.without_needless))]
            if self.together:
                moved = f"moves a reading by at most {_percent(self.together.bound)}"
                lines.append(f"Leaving all of these out at once {moved}, all photodiodes, 95 % sure.")
        if self.missing:
            lines.append("Left out, though it matters: " + ", ".join(map(name_of, self.missing)))
        if any(e.matters == "cannot tell" for e in self.effects):
            lines.append("What cannot be told needs more photons: --max-seconds, --photons or --relative-error.")
        return "\n".join(lines)


def name_of(effect: Effect) -> str:
    """Its name, and what it moves where that is not the reading."""
    return effect.name + (" (to the signal)" if effect.of == "signal" else "")


def _percent(part: float) -> str:
    return f"{100 * part:.2g}%" if part < 1 else f"{100 * part:.0f}%"


def explain(
    scene: Scene,
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
    limit = tolerance or scene.accuracy.relative_error or DEFAULT_TOLERANCE
    check_study(scene, limit if tolerance is None else tolerance, "explain", "is modelled as it is written")
    options, start = TraceOptions(**requested), time.perf_counter()
    changes = [*_changes(scene), *unknown_changes(scene)]
    # One more with what is not needed left out, for which the scene's own geometry is made again.
    planned = list(_to_trace(scene, changes))
    shapes = len({shape_of(one) for one in planned})
    tracer = PairedTracer(len(planned) + 1, options, progress, shapes=shapes)
    base = tracer.trace(scene)
    effects: list[Effect] = []
    together, unmet = None, tracer.shortfall
    try:
        for effect in _effects(scene, base, changes, tracer, limit):
            effects.append(effect)
        together = _left_out_together(scene, base, effects, tracer, limit)
    except NotReachedError as error:
        unmet = f"{str(error).rstrip('.')}; {len(effects)} effects were measured before."
    effects.sort(key=lambda e: -abs(e.change) if math.isfinite(e.change) else 0.0)
    # What is not known stays as it is.
    known = [e for e in effects if e.matters == ("no" if e.modelled else "yes") and not e.unknown]
    result = Explanation(
        effects=tuple(effects),
        together=together,
        required=revised(scene, _merged(known)),
        tolerance=limit,
        photons=base.transfer.traces[0].photons,
        backend=base.transfer.backend,
        wall_seconds=time.perf_counter() - start,
        attributes=base.transfer.attributes() | ({"cut_off": unmet} if unmet else {}),
    )
    if unmet:
        raise NotReachedError(unmet, result=result)
    return result


def _left_out_together(
    scene: Scene, base: PairedReadings, effects: list[Effect], tracer: PairedTracer, limit: float
) -> Effect | None:
    """What leaving out all that surely does not matter does to the readings; None where there is nothing such."""
    left = _merged([e for e in effects if e.modelled and e.matters == "no" and not e.unknown])
    if not left:
        return None
    found = difference(base, tracer.trace(revised(scene, left)))
    return effect_of(Change(TOGETHER, True, "left out", left), found, base, tolerance=limit, how="retraced")


def _merged(effects: list[Effect]) -> Changes:
    """All their changes at once; a part is left out, or put in, beside what others do to the same list."""
    out: Changes = {}
    for effect in effects:
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


def _to_trace(scene: Scene, changes: list[Change]) -> Iterator[Scene]:
    """Every scene that the effects of these changes are measured with."""
    yield scene
    yield from (revised(scene, change.changes) for change in changes if not change.same_photons)
    yield from (make(scene) for make in (bounds.denser, bounds.farthest, bounds.most_proximal))
    if (shortened := _shortened(scene)) is not None:
        short = revised(scene, shortened.changes)
        yield from (short, bounds.most_proximal(short))


def _shortened(scene: Scene) -> Change | None:
    """The finger cut as near to the nail as it may be; None where it is that short."""
    finger = scene.finger
    assert finger is not None
    shortest = finger.nail_length_mm + BEYOND_NAIL_MM
    if finger.length_mm <= shortest:
        return None
    return Change(f"finger past {shortest:g} mm", True, "cut there", {"finger": {"length_mm": shortest}})


def _effects(
    scene: Scene, base: PairedReadings, changes: list[Change], tracer: PairedTracer, limit: float
) -> Iterator[Effect]:
    """Every effect as soon as it is measured; those that cost nothing first, then those of the scene's geometry."""
    own = shape_of(scene)
    others = [c for c in changes if shape_of(revised(scene, c.changes)) != own]
    yield bounds.from_deep(base)
    if scene.board.cover_um:
        yield bounds.nothing("decorative nail", "it lies on the opaque cover, which no light leaves", limit)
    for change in changes:
        if change.same_photons:
            found = difference(base, reweighted(base.transfer, revised(scene, change.changes)))
            yield effect_of(change, found, base, tolerance=limit, how="reweighted")
    for change in changes:
        if not change.same_photons and change not in others:
            yield _retraced(change, scene, base, tracer, limit)
    yield bounds.blood_scattering(scene, base, tracer.trace(bounds.denser(scene)), limit)
    for change in others:
        yield _retraced(change, scene, base, tracer, limit)
    yield bounds.ambient(scene, base, tracer.trace(bounds.farthest(scene)), limit)
    back = tracer.trace(bounds.most_proximal(scene))
    assert scene.finger is not None
    change = Change(f"finger past {scene.finger.length_mm:g} mm", False, "finger without an end")
    yield bounds.returning(change, base, base, back)
    if (shortened := _shortened(scene)) is not None:
        short = revised(scene, shortened.changes)
        cut, back = (tracer.trace(one) for one in (short, bounds.most_proximal(short)))
        yield bounds.returning(shortened, base, cut, back)


def _retraced(change: Change, scene: Scene, base: PairedReadings, tracer: PairedTracer, limit: float) -> Effect:
    """What a change does, by a trace with it."""
    found = difference(base, tracer.trace(revised(scene, change.changes)))
    return effect_of(change, found, base, tolerance=limit, how="retraced")


def _changes(scene: Scene) -> Iterator[Change]:
    """The scene's parts and effects, each with what leaves it out, or puts it in."""
    assert scene.finger is not None
    light, board, finger = scene.light, scene.board, scene.finger
    steps, similar = light.index_steps, light.similarity
    text = "one index everywhere" if steps else "refraction where the index changes"
    yield Change("index steps", steps, text, {"light": {"index_steps": not steps}})
    text = "Henyey-Greenstein" if similar else "isotropic with the same mu_s'"
    yield Change("forward scattering", not similar, text, {"light": {"similarity": not similar}})
    for part in ("bone", "epidermis", "kapton"):
        gone = part in light.left_out
        left = [p for p in light.left_out if p != part] if gone else [*light.left_out, part]
        own = "optics of its own" + (", melanin" if part == "epidermis" else "")
        text = own if gone else "optics of what surrounds it"
        yield Change(part, not gone, text, {"light": {"left_out": left}})
    if any(led.fwhm_nm for led in scene.leds):
        yield Change("LED line width", True, "peak wavelength alone", ONE_WAVELENGTH, same_photons=True)
    elif any(part_width_nm(led) for led in scene.leds):
        yield Change("LED line width", False, "as its part has", PART_WIDTH, same_photons=True)
    if "epidermis" not in light.left_out:
        melanin = finger.melanin_fraction
        usual = type(finger).model_fields["melanin_fraction"].default
        text = "none" if melanin else f"{usual:.1%} of the epidermis"
        other = {"finger": {"melanin_fraction": 0.0 if melanin else usual}}
        yield Change("melanin", melanin > 0, text, other, same_photons=True)
    if board.opaque_reflectance:
        yield Change("opaque epoxy's reflection", True, "black", {"board": {"opaque_reflectance": 0.0}})
    if board.barrier:
        yield Change("barrier", True, "clear epoxy in its place", {"board": {"barrier": False}})
    stand_out = any(led.height_um for led in scene.leds) or any(p.height_um for p in scene.photodiodes)
    height_um = 0.0 if stand_out else min(DIE_UM, board.clear_epoxy_um - LEAST_EPOXY_UM)
    text = "flush with the board's underside" if stand_out else f"standing {height_um:g} um out of the board"
    if stand_out or height_um:
        # A scene that says nothing of it leaves it unknown: what it requires is not to be guessed.
        changes: Changes = {table: {"height_um": height_um} for table in EACH}
        yield Change("height of dies", True, text, changes, unknown=not stand_out)
    if not board.cover_um:
        cover = type(board).model_fields["cover_um"].default
        yield Change("cover and decorative nail", False, "opaque cover", {"board": {"cover_um": cover}})

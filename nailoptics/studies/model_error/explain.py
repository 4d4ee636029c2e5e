"""What a scene models, what it leaves out, how far each of these moves the readings, and what the scene requires."""

import math
import time
from dataclasses import dataclass, field
from typing import Any, Unpack

from ...errors import NotReachedError
from ...light import ProgressCallback
from ...options import Requested, TraceOptions
from ...scene import Scene
from .changes import Change, Changes, merged, revised
from .effects import Effect, by_trace, measurements
from .paired import PairedTracer, check_study, shape_of

DEFAULT_TOLERANCE = 0.02
TOGETHER = "all that is not needed"


@dataclass(frozen=True)
class Explanation:
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
        return merged(self.needless)

    @property
    def missing(self) -> list[Effect]:
        """What is left out and surely matters."""
        return [e for e in self.effects if not e.modelled and e.matters == "yes"]


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
    planned = measurements(scene, limit)
    traced = [one for each in planned for one in each.scenes]
    # One more with what is not needed left out, for which the scene's own geometry is made again.
    tracer = PairedTracer(2 + len(traced), options, progress, shapes=len({shape_of(one) for one in (scene, *traced)}))
    base = tracer.trace(scene)
    effects: list[Effect] = []
    together, unmet = None, tracer.shortfall
    try:
        for one in planned:
            effects.append(one.effect(base, *(tracer.trace(other) for other in one.scenes)))
        if left := merged(_known(effects, modelled=True)):
            other = tracer.trace(revised(scene, left))
            together = by_trace(Change(TOGETHER, True, "left out", left), limit, base, other)
    except NotReachedError as error:
        unmet = f"{str(error).rstrip('.')}; {len(effects)} effects were measured before."
    effects.sort(key=lambda e: -abs(e.change) if math.isfinite(e.change) else 0.0)
    result = Explanation(
        effects=tuple(effects),
        together=together,
        required=revised(scene, merged([*_known(effects, modelled=True), *_known(effects, modelled=False)])),
        tolerance=limit,
        photons=base.transfer.traces[0].photons,
        backend=base.transfer.backend,
        wall_seconds=time.perf_counter() - start,
        attributes=base.transfer.attributes() | ({"cut_off": unmet} if unmet else {}),
    )
    if unmet:
        raise NotReachedError(unmet, result=result)
    return result


def _known(effects: list[Effect], *, modelled: bool) -> list[Effect]:
    """What is modelled and surely does not matter, or left out and does; what is unknown stays as it is."""
    sure = "no" if modelled else "yes"
    return [e for e in effects if e.modelled == modelled and e.matters == sure and not e.unknown]

"""Layout design: rank given layouts and searched ones by the force that they resolve, on every finger."""

import logging
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Unpack

import numpy as np
import xarray as xr

from ...assets import data_dir
from ...errors import InputError, NotReachedError
from ...light import Progress
from ...light import backend as backends
from ...options import Requested, TraceOptions
from ...scene import FingerCase, Placement, Scene, digest, load_scene
from ..comparison.fits import Z95
from . import boards
from . import exchange as search
from . import fisher as merit
from .inspection import look
from .photon_maps import Bank, View, jackknife
from .result import as_dataset

log = logging.getLogger(__name__)

DEFAULT_SECONDS = 480.0
DEFAULT_RELATIVE_ERROR = 0.02
# Photons per LED and finger: to choose photodiodes for a place of the LED, and of a round of judging.
SEARCH_PHOTONS = 1 << 18
JUDGE_PHOTONS = 1 << 20
SPACING_MM = 0.1
BLOCKS = 32
# Searched layouts that are judged with photons of their own beside those that were given.
FINALISTS = 5
# Parts of the time for the search; the rest is for judging, but for what the last check needs.
SEARCH_SHARE = 0.55
CHECK_SHARE = 0.15


@dataclass(frozen=True)
class Layout:
    """A layout to judge: the whole scene, the bare board whose light it reads, and where it came from."""

    name: str
    scene: Scene
    board: Scene
    origin: str


@dataclass(frozen=True)
class Judged:
    """A layout's merit: by all photons and without each block of them.

    resolution_n : (1 + blocks, fingers) float. [N]
    score_n : (1 + blocks,) float. Over the fingers. [N]
    volts : by finger and LED, (1 + blocks, photodiodes).
    """

    resolution_n: np.ndarray
    known_split_n: np.ndarray
    pressures_pa: np.ndarray
    score_n: np.ndarray
    volts: list[list[merit.Volts]]

    @property
    def interval_n(self) -> tuple[float, float]:
        """95 % interval of the score, symmetric in its logarithm. [N]"""
        spread = Z95 * float(jackknife(np.log(self.score_n)))
        return float(self.score_n[0] * math.exp(-spread)), float(self.score_n[0] * math.exp(spread))

    @property
    def relative_error(self) -> float:
        """Relative standard error of the score."""
        return float(jackknife(np.log(self.score_n)))


def place(
    scene: Scene,
    *,
    progress: Callable[[Progress], None] | None = None,
    **requested: Unpack[Requested],
) -> xr.Dataset:
    """Rank layouts of a finger scene by the force that they resolve; `place_result.chosen` is the best as a scene.

    Parameters
    ----------
    photons : per layout, LED and finger, in place of a tolerance.
    relative_error : judging ends when the best is apart from all others or every force resolution is known so well.
    max_seconds : wall time after which it ends in any case; 480 if nothing is asked.

    Returns: Dataset over layout (best first), finger, photodiode and, for the best, the plane of the board.

    Raises: InputError; NotReachedError, with the Dataset as result, where time ran out or the user interrupted before
    the best was told apart or the tolerance was met; interrupted, what is found so far is finished roughly.
    """
    if scene.finger is None:
        raise InputError("place needs a [finger] scene; a phantom has no board and no force.")
    options = TraceOptions(**requested)
    seed, backend = options.seed, backends.choose(options.backend).name
    begin, cpu = time.perf_counter(), time.process_time()
    rules, base = boards.rules(scene), boards.base_board(scene)
    views = tuple(View(case, _operating(base, case, rules)) for case in boards.fingers(scene))
    asked = options.photons or scene.accuracy.photons
    wanted = options.relative_error or scene.accuracy.relative_error or DEFAULT_RELATIVE_ERROR
    limit = options.max_seconds or scene.accuracy.max_seconds or (math.inf if asked else DEFAULT_SECONDS)
    told = _Told(progress, begin, limit)

    layouts = _given(base, rules)
    paper = _papers(base, views)
    tried: list[tuple[search.Spot, float]] = []
    if rules.search:
        bank = Bank(views, seed=seed, stream=0, backend=backend, spacing_mm=SPACING_MM, blocks=1, quick=True)
        found, tried = _searched(base, rules, bank, begin + SEARCH_SHARE * limit, told)
        layouts += found
        spent = bank.photons
    else:
        spent = 0
    layouts += [paper] if paper else []
    if not layouts:
        raise InputError(
            f"placement: {rules.photodiodes} photodiodes of {base.photodiodes[0].size_mm} mm find no room; "
            "make the board larger, or ask for fewer."
        )
    bank = Bank(views, seed=seed, stream=1, backend=backend, spacing_mm=SPACING_MM, blocks=BLOCKS)
    judged, unmet = _judge(layouts, bank, rules, asked, wanted, begin + (1 - CHECK_SHARE) * limit, told)
    order = sorted(range(len(layouts)), key=lambda i: float(judged[i].score_n[0]))
    layouts, judged = [layouts[i] for i in order], [judged[i] for i in order]
    maps = bank.maps(layouts[0].board)[0]
    end = time.perf_counter() if told.interrupted else begin + limit
    closer = look(layouts[0].scene, views[0], photons=maps[0].photons, seed=seed, backend=backend, deadline=end)
    told("check", 1.0, judged[0].relative_error, None)
    result = as_dataset(
        scene,
        layouts,
        judged,
        views=views,
        maps=maps,
        tried=tried,
        closer=closer,
        attributes={
            "seed": seed,
            "photons": bank.photons + spent,
            "backend": backend,
            "wall_seconds": time.perf_counter() - begin,
            "cpu_seconds": time.process_time() - cpu,
            "rank_by": rules.rank_by,
        },
    )
    if unmet:
        raise NotReachedError(unmet, result=result)
    return result


class _Told:
    """Progress of the stages as one callback hears it, and whether the user asked to end."""

    def __init__(self, progress: Callable[[Progress], None] | None, begin: float, limit: float) -> None:
        self.progress, self.begin, self.limit, self.interrupted = progress, begin, limit, False
        self.last: tuple[str, float, float, float | None] | None = None

    def __call__(self, stage: str, done: float, error: float, target: float | None) -> None:
        self.last = (stage, done, error, target)
        if self.progress and not self.interrupted:
            seconds = time.perf_counter() - self.begin
            try:
                self.progress(Progress(stage, 0, error, target, min(1.0, done), seconds))
            except KeyboardInterrupt:
                self.interrupted = True

    def again(self) -> None:
        """The same once more, because time has passed and the user may have asked to end."""
        if self.last:
            self(*self.last)


def _operating(base: Scene, case: FingerCase, rules: Placement) -> merit.Operating:
    return merit.operating(boards.on_finger(base, case), rules.force_n)


def _given(base: Scene, rules: Placement) -> list[Layout]:
    out = []
    for one in rules.candidates:
        scene = boards.with_parts(
            base,
            one.leds_mm,
            one.photodiodes_mm,
            name=one.name,
            leds_turned=one.leds_turned,
            photodiodes_turned=one.photodiodes_turned,
        )
        out.append(Layout(one.name, scene, boards.bare(boards.explicit(scene, one.name)), "given"))
    return out


def _papers(base: Scene, views: tuple[View, ...]) -> Layout | None:
    """The paper's layout on the same finger with the same electronics; None where it does not fit every nail."""
    prototype = load_scene(data_dir("scenes") / "prototype.toml")
    kept = ("finger", "blood", "touch", "electronics", "light")
    scene = prototype.model_copy(update={name: getattr(base, name) for name in kept})
    try:
        for view in views:
            boards.check(boards.on_finger(scene, view.case, light_only=True), "paper")
    except InputError as error:
        log.warning("the paper's layout is left out: %s", error)
        return None
    scene = boards.explicit(scene, "paper")
    return Layout("paper", scene, boards.bare(scene), "paper")


def _searched(
    base: Scene, rules: Placement, bank: Bank, deadline: float, told: _Told
) -> tuple[list[Layout], list[tuple[search.Spot, float]]]:
    """The best layouts for the best places of the LED, and every place that was tried with what it resolves."""
    if len(base.leds) != 1:
        raise InputError(
            f"placement.search places one LED, the scene has {len(base.leds)}; set search = false and give candidates."
        )
    size = base.photodiodes[0].size_mm
    apart = (size[0] + rules.clearance_mm, size[1] + rules.clearance_mm)
    score = search.scorer(bank.views, rules.rank_by)
    results: dict[search.Spot, tuple[float, np.ndarray]] = {}

    def attempt(spot: search.Spot, photons: int) -> None:
        board = search.board_at(spot, base)
        bank.grow(board, photons)
        places = search.free_places(board, size, rules)
        if len(places) >= rules.photodiodes:
            information = search.single(bank, board, places, size, base)
            chosen, reached = search.exchange(
                information, places, count=rules.photodiodes, spacing_mm=apart, score=score
            )
            if chosen:
                results[spot] = (reached, places[chosen])
        bank.forget(board)

    step, start = rules.led_step_mm, time.perf_counter()
    waiting, seen = search.spots(base, rules), set()
    while waiting:
        for i, spot in enumerate(waiting):
            if results and (told.interrupted or time.perf_counter() > deadline):
                why = "was interrupted" if told.interrupted else "ran out of time"
                log.warning("the search for LED places %s after %d of them", why, len(results))
                return _layouts(base, results), [(s, r[0]) for s, r in results.items()]
            attempt(spot, SEARCH_PHOTONS)
            seen.add(spot)
            part = (time.perf_counter() - start) / max(deadline - start, 1e-9)
            told("search", part if math.isfinite(deadline) else (i + 1) / len(waiting) / 2, math.inf, None)
        step /= 2
        best = sorted(results, key=lambda s: results[s][0])[:2]
        waiting = list(dict.fromkeys(n for s in best for n in search.around(s, step, base, rules) if n not in seen))
        if step < rules.led_step_mm / 4:
            break
    return _layouts(base, results), [(s, r[0]) for s, r in results.items()]


def _layouts(base: Scene, results: dict[search.Spot, tuple[float, np.ndarray]]) -> list[Layout]:
    out = []
    for spot in sorted(results, key=lambda s: results[s][0])[:FINALISTS]:
        places = sorted(((float(u), float(v)) for u, v in results[spot][1]), key=lambda p: (p[1], p[0]))
        scene = boards.with_parts(base, [spot.place_mm], places, name=spot.name)
        out.append(Layout(spot.name, scene, boards.bare(boards.explicit(scene, spot.name)), "searched"))
    return out


def judge(layout: Layout, bank: Bank, rank_by: str) -> Judged:
    """A layout's merit from light that is traced; a further layout on a traced board costs milliseconds."""
    volts = bank.read(layout.scene, layout.board)
    resolution, known, pressures = [], [], []
    for view, by_led in zip(bank.views, volts, strict=True):
        total = np.sum([merit.information(read).sum(1) for read in by_led], axis=0)
        resolution.append(merit.resolution_n(total, view.at))
        known.append(merit.known_split_n(total, view.at))
        pressures.append(merit.pressures_pa(total))
    each = np.stack(resolution)
    return Judged(each.T, np.stack(known).T, np.stack(pressures, 1), search.combined(each, rank_by), volts)


def _judge(
    layouts: list[Layout],
    bank: Bank,
    rules: Placement,
    asked: int | None,
    wanted: float,
    deadline: float,
    told: _Told,
) -> tuple[list[Judged], str | None]:
    """Trace until the best is told apart, more photons where that is undecided; and why not, if it was not."""
    photons = {layout.name: 0 for layout in layouts}
    share: dict[str, list[str]] = {}
    for layout in layouts:
        share.setdefault(digest(layout.board), []).append(layout.name)

    def grow(names: set[str], amount: int) -> bool:
        for layout in layouts:
            members = share[digest(layout.board)]
            if layout.name == members[0] and names & set(members):
                if all(photons.values()) and (told.interrupted or time.perf_counter() > deadline):
                    return False
                bank.grow(layout.board, amount)
                for name in members:
                    photons[name] += amount
                told.again()
        return True

    grow(set(photons), SEARCH_PHOTONS if told.interrupted else asked or JUDGE_PHOTONS)
    while True:
        judged = [judge(layout, bank, rules.rank_by) for layout in layouts]
        best = min(range(len(layouts)), key=lambda i: float(judged[i].score_n[0]))
        tied = {layouts[i].name for i, one in enumerate(judged) if one.interval_n[0] <= judged[best].interval_n[1]}
        worst = max(one.relative_error for layout, one in zip(layouts, judged, strict=True) if layout.name in tied)
        told("judge", min(1.0, (wanted / worst) ** 2) if len(tied) > 1 else 1.0, worst, wanted)
        if (asked or len(tied) == 1 or worst <= wanted) and not told.interrupted:
            return judged, None
        undecided = {
            layout.name
            for layout, one in zip(layouts, judged, strict=True)
            if layout.name in tied and one.relative_error > wanted
        }
        most = max(photons[name] for name in undecided)
        left = f"{len(tied)} layouts tied at relative error {worst:.3g}, {wanted:g} asked"
        if told.interrupted:
            return judged, f"interrupted: {left}."
        if not grow(undecided, most // 2) and not told.interrupted:
            return judged, f"max_seconds ended with {left}; allow more time or ask for less."

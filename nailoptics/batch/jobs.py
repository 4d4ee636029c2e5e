"""Which scenes of a batch belong together, and what all jobs share."""

import hashlib
import re
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Unpack, cast

from ..errors import InputError
from ..light import backend as backends
from ..light.identity import light_digest, traced_absorption
from ..light.tracing import accuracy
from ..light.tracing.store import LightStore
from ..light.transfer import current_versions
from ..options import BackendName, Requested, TraceOptions
from ..scene import Accuracy, Scene, digest
from ..scene.sweep import StudyName, Sweep
from .folder import FORMAT, Folder, Made, Plan, PlanError
from .studies import STUDIES

# Scenes of one light that one job studies.
CHUNK = 16


@dataclass(frozen=True)
class Settings:
    """What all jobs of a batch share.

    options : of every scene; the time that a run may take is in deadline, in seconds since the epoch.
    study : what is done with every scene.
    """

    folder: Path
    options: TraceOptions
    deadline: float | None = None
    study: StudyName = "simulate"

    @classmethod
    def of(cls, folder: Path, options: TraceOptions, study: StudyName = "simulate") -> "Settings":
        """The settings of a run that begins now, with the backend that this machine offers."""
        deadline = None if options.max_seconds is None else time.time() + options.max_seconds
        chosen = cast(BackendName, backends.choose_jit(options.backend, "batch").name)
        if study == "colour" and options.relative_error is not None:
            raise InputError("relative_error: a sweep of colours has none; give colour.tolerance in its base scene.")
        return cls(folder.resolve(), replace(options, backend=chosen, max_seconds=None), deadline, study)

    def required(self, scene: Scene) -> Accuracy:
        """What a scene's light must reach."""
        return accuracy(scene, self.options)

    def options_of(self, scene: Scene) -> TraceOptions:
        """The options of a scene's study, which takes no longer than the run has left."""
        requested = self.options.photons or self.options.relative_error
        own_light = STUDIES[self.study].own_light
        required = scene.accuracy if own_light and not requested else self.required(scene)
        if self.deadline is not None:
            left = max(self.deadline - time.time(), 1e-3)
            required = required.model_copy(update={"max_seconds": min(left, required.max_seconds or left)})
        return replace(self.options, **required.model_dump())

    def made(self) -> Made:
        """What decides a scene's result beside the scene and how accurate it is to be."""
        return Made(seed=self.options.seed, backend=self.options.backend, versions=dict(current_versions()))

    def stores(self, on_damage: Callable[[Path, Exception], None] | None = None) -> list[LightStore]:
        """Where light is stored, first that of the batch; what single commands traced is read, too."""
        return [LightStore(Folder(self.folder).light, on_damage=on_damage), *LightStore.of_command(self.options)]

    def is_late(self) -> bool:
        """Whether the run's time is over."""
        return self.deadline is not None and time.time() >= self.deadline


@dataclass(frozen=True)
class Planned:
    """One scene of a batch: its digest, the key of its light, and what is traced in its place."""

    digest: str
    key: str
    scene: Scene
    traced: Scene | None = None


# Scenes of the same light.
Job = tuple[Planned, ...]


def plan(sweep: Sweep, settings: Settings) -> list[Planned]:
    """Digest and light of every scene, in the sweep's order."""
    planned, study = [], settings.study
    for scene, traced in zip(sweep.scenes, traced_absorption(sweep.scenes), strict=True):
        # Another study of the same scene is another result.
        scene_id = digest(scene)
        scene_id = scene_id if study == "simulate" else hashlib.sha256(f"{study} {scene_id}".encode()).hexdigest()
        key = f"{light_digest(traced or scene)}{study if STUDIES[study].own_light else ''}"
        planned.append(Planned(scene_id, key, scene, traced))
    return planned


def parse_shard(text: str | None) -> tuple[int, int]:
    """A shard I/N as numbers: I of 1 to N."""
    if text is None:
        return 1, 1
    match = re.fullmatch(r"(\d+)/(\d+)", text)
    if not match or not 1 <= int(match[1]) <= int(match[2]):
        raise InputError(f"shard {text}: must be I/N with I of 1 to N, such as 1/8 (job arrays that count from 1).")
    return int(match[1]), int(match[2])


def of_shard(planned: list[Planned], shard: tuple[int, int]) -> list[Planned]:
    """The scenes of one shard: whole groups, so that no light is traced by two shards."""
    keys = {key: i for i, key in enumerate(dict.fromkeys(p.key for p in planned))}
    return [p for p in planned if keys[p.key] % shard[1] == shard[0] - 1]


def jobs_of(planned: Iterable[Planned]) -> list[Job]:
    """Jobs of at most 16 scenes of the same light; the first of every light come before any second."""
    groups: dict[str, list[Planned]] = {}
    for p in planned:
        groups.setdefault(p.key, []).append(p)
    parts = [(i, tuple(group[i : i + CHUNK])) for group in groups.values() for i in range(0, len(group), CHUNK)]
    return [job for _, job in sorted(parts, key=lambda part: part[0])]


def plan_of(sweep: Sweep, planned: list[Planned], settings: Settings) -> Plan:
    """The plan for the folder."""
    return Plan(
        format=FORMAT,
        sweep=sweep.name,
        study=settings.study,
        dims=dict(sweep.dims),
        axes=sweep.axes,
        made=settings.made(),
        photons=settings.options.photons,
        relative_error=settings.options.relative_error,
        scenes=tuple(p.digest for p in planned),
        required=tuple(settings.required(p.scene) for p in planned),
        lights=len({p.key for p in planned}),
    )


def check_same(folder: Folder, planned: list[Planned], settings: Settings) -> str:
    """Raise InputError where the folder was begun with another sweep, seed, backend or version.

    A sweep may grow: one that holds all scenes that were planned before resumes in their folder.

    Returns: what is wrong with the plan that lies there, and so will be written anew; empty if nothing is.
    """
    try:
        old = folder.read_plan()
    except PlanError as error:
        return str(error) if (folder.root / "plan.json").exists() else ""
    made = settings.made()
    for name in ("seed", "backend"):
        if (then := getattr(old.made, name)) != (now := getattr(made, name)):
            raise InputError(
                f"{folder.root}: was begun with {name} {then}, and {now} is requested; "
                f"give {name} {then}, or another folder."
            )
    if old.made != made:
        raise InputError(
            f"{folder.root}: was begun with {old.made.other_versions}; use that version, or another folder."
        )
    others = len(set(old.scenes) - {p.digest for p in planned})
    if others:
        raise InputError(
            f'{folder.root}: holds the sweep "{old.sweep}", and {others} of its {len(old.scenes)} scenes are not '
            "in this one; use another folder."
        )
    return ""


def count(sweep: Sweep, **requested: Unpack[Requested]) -> dict[str, int]:
    """How many scenes a sweep has, and how many traces: scenes that differ only in absorption share one."""
    planned = plan(sweep, Settings.of(Path(), TraceOptions(**requested), sweep.study))
    return {"scenes": len({p.digest for p in planned}), "lights": len({p.key for p in planned})}

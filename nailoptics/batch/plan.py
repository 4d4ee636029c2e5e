"""Which scenes of a sweep are still to do, grouped so that scenes with the same light are traced once."""

import hashlib
from dataclasses import dataclass
from typing import Any

from ..errors import InputError
from ..light.identity import light_digest
from ..scene import Scene, digest
from ..scene.sweep import Sweep
from .folder import Folder, HiddenError
from .study_runs import STUDIES
from .work import Job, Settings, other_versions, reads_transfer, standing

# Scenes read from one light by one worker before others may help.
CHUNK = 16


@dataclass(frozen=True)
class Planned:
    """One scene of a batch: its digest, and the key of its light."""

    digest: str
    key: str
    scene: Scene


def plan(sweep: Sweep, settings: Settings) -> list[Planned]:
    """Digest and light of every scene, in the sweep's order."""
    return [_planned(scene, settings) for scene in sweep.scenes]


def _planned(scene: Scene, settings: Settings) -> Planned:
    own, study = digest(scene), settings.study
    if study != "simulate":
        # Another study of the same scene is another result.
        own = hashlib.sha256(f"{study} {own}".encode()).hexdigest()
    by_volpath = study not in STUDIES and not reads_transfer(scene, settings)
    return Planned(own, own if by_volpath else f"{light_digest(scene)}{study if study in STUDIES else ''}", scene)


def parse_shard(text: str | None) -> tuple[int, int]:
    """A shard I/N as numbers: I of 1 to N."""
    if text is None:
        return 1, 1
    part, slash, count = text.partition("/")
    if not (slash and part.isdigit() and count.isdigit() and 1 <= int(part) <= int(count)):
        raise InputError(f"--shard {text}: must be I/N with I of 1 to N, such as 1/8 (job arrays that count from 1).")
    return int(part), int(count)


def of_shard(planned: list[Planned], shard: tuple[int, int]) -> list[Planned]:
    """The scenes of one shard: whole groups, so that no light is traced by two shards."""
    keys = {key: i for i, key in enumerate(dict.fromkeys(p.key for p in planned))}
    return [p for p in planned if keys[p.key] % shard[1] == shard[0] - 1]


@dataclass(frozen=True)
class Todo:
    """What is left of a plan.

    jobs : one per light, each with all its scenes.
    kept : digests that are done as required. failed : those that failed before, which stay so.
    corrupt, foreign : results that are not what was written, or that another seed, backend or version made; both will
        be made again.
    """

    jobs: list[Job]
    kept: list[str]
    failed: list[str]
    corrupt: list[str]
    foreign: list[str]


def left(planned: list[Planned], folder: Folder, settings: Settings, *, retry_failed: bool) -> Todo:
    """What is left to do, checking every result that is there."""
    groups: dict[str, dict[str, Scene]] = {}
    kept: list[str] = []
    failed: list[str] = []
    again: dict[str, list[str]] = {"corrupt": [], "foreign": []}
    for p in {p.digest: p for p in planned}.values():
        stands = standing(folder, p.digest, settings.required(p.scene), settings.made())
        if stands == "done":
            kept.append(p.digest)
        elif stands == "failed" and not retry_failed:
            failed.append(p.digest)
        else:
            groups.setdefault(p.key, {})[p.digest] = p.scene
            if stands in again:
                again[stands].append(p.digest)
    return Todo([Job(key, tuple(scenes.items())) for key, scenes in groups.items()], kept, failed, **again)


def first_of(job: Job) -> Job:
    """The part of a job that is done first: the light of all its scenes, and the readings of some."""
    return Job(job.key, job.scenes[:CHUNK], tuple(scene for _, scene in job.scenes[CHUNK:]))


def rest_of(job: Job) -> list[Job]:
    """The other parts, which only read that light."""
    return [Job(job.key, job.scenes[i : i + CHUNK]) for i in range(CHUNK, len(job.scenes), CHUNK)]


def as_json(sweep: Sweep, planned: list[Planned], settings: Settings) -> dict[str, Any]:
    """The plan for the folder: enough to open the results and to tell how far they are."""
    return {
        "sweep": sweep.name,
        "dims": sweep.dims,
        "axes": [{"name": a.name, "path": a.path, "values": a.values} for a in sweep.axes],
        "study": settings.study,
        "made": settings.made(),
        **{name: getattr(settings.options, name) for name in ("photons", "relative_error")},
        "scenes": [p.digest for p in planned],
        "asked": [settings.required(p.scene).model_dump(exclude_none=True) for p in planned],
        "lights": len({p.key for p in planned}),
    }


def check_same(folder: Folder, planned: list[Planned], settings: Settings) -> str:
    """Raise InputError where the folder was begun with another sweep, seed, backend or version.

    A sweep may grow: one that holds all scenes that were planned before goes on in their folder.

    Returns: what is wrong with the plan that lies there, and so will be written anew; empty if nothing is.
    """
    try:
        old = folder.read_plan()
    except HiddenError:
        raise
    except InputError as error:
        return str(error) if not folder.gone() else ""
    wanted = settings.made()
    for name in ("seed", "backend"):
        if old["made"][name] != (mine := wanted[name]):
            raise InputError(
                f"{folder.root}: was begun with {name} {old['made'][name]}, and {mine} is requested; "
                f"use --{name} {old['made'][name]} or another folder."
            )
    if old["made"] != wanted:
        moved = other_versions(old["made"])
        raise InputError(f"{folder.root}: was begun with {moved}; use that version, or another folder.")
    others = len(set(old["scenes"]) - {p.digest for p in planned})
    if others:
        raise InputError(
            f'{folder.root}: holds the sweep "{old["sweep"]}", and {others} of its {len(old["scenes"])} scenes are not '
            "in this one; use another folder."
        )
    return ""

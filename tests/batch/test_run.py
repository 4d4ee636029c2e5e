"""A batch loses nothing: kills, failures, damage, full disks and rivals, and always the same bits."""

import contextlib
import json
import multiprocessing.spawn
import os
import random
import signal
import subprocess
import sys
import time
from multiprocessing import resource_tracker
from pathlib import Path

import numpy as np
import pytest

import nailoptics as nail
from nailoptics.batch import (
    BatchProgress,
    Outcome,
    Sweep,
    load_sweep,
    run_batch,
    status,
    studies,
    write_table,
)
from nailoptics.batch.folder import Folder, meets
from nailoptics.batch.jobs import Settings, in_order, jobs_of, of_shard, plan_of, work
from nailoptics.errors import InputError, NailopticsError, NotReachedError
from nailoptics.light import backend
from nailoptics.options import TraceOptions
from nailoptics.scene import Accuracy

from .conftest import FAILING, bits, command_of, kill_one, offspring, phantoms

pytestmark = pytest.mark.jit


def children() -> list[int]:
    return [child.pid for child in multiprocessing.active_children() if child.pid]


def test_a_run_gives_each_scene_its_reading_and_a_second_run_does_nothing(jit_backend, tmp_path):
    sweep = phantoms(tmp_path, 6)
    outcome = run_batch(sweep, tmp_path / "b", workers=1)
    assert (len(outcome.done), outcome.traces, outcome.failed) == (6, 6, {})
    results = nail.open_results(tmp_path / "b")
    assert results.detected_fraction_rest.dims == ("thickness_mm", "led", "photodiode")
    assert results.thickness_mm.values == pytest.approx(np.linspace(0.5, 3.0, 6))
    direct = nail.trace(sweep.scenes[4], seed=0).at()
    assert results.detected_fraction_rest[4].item() == direct.detected_fraction.item()
    before = bits(tmp_path / "b")
    again = run_batch(sweep, tmp_path / "b", workers=1)
    assert (len(again.done), len(again.kept)) == (0, 6)
    assert bits(tmp_path / "b") == before


@pytest.mark.long
def test_random_kills_and_the_number_of_workers_and_their_threads_change_no_bit(calm, tmp_path):
    """A worker is killed (SIGKILL) after every seventh scene; what is left is the work of an undisturbed run."""
    rng, killed = random.Random(1), [0]

    def kill(p: BatchProgress) -> None:
        if p.done + p.failed >= 7 * (killed[0] + 1) and children():
            killed[0] += 1
            os.kill(rng.choice(children()), signal.SIGKILL)

    outcome = finish(calm.sweep, tmp_path / "killed", workers=2, progress=kill)
    assert killed[0] >= 3 and outcome.total == 30
    assert bits(tmp_path / "killed") == calm.bits
    assert not list((tmp_path / "killed").glob("failed/*.json"))


@pytest.mark.slow
def test_two_thousand_scenes_survive_kills_at_any_moment(jit_backend, tmp_path):
    """Workers and whole runs are killed at random times until all is done; no bit differs from a calm run's."""
    sweep = phantoms(tmp_path, 2000)
    run_batch(sweep, tmp_path / "calm", workers=2)
    rng, runs, killed = random.Random(2), 0, 0
    while True:
        process = driver(tmp_path / "slabs2000.toml", tmp_path / "b", "--workers", "2", "--retry-failed")
        runs, ends = runs + 1, time.time() + rng.uniform(4, 10)
        while process.poll() is None and time.time() < ends:
            time.sleep(rng.uniform(0.5, 3.0))
            workers = [w for w in offspring(process.pid) if b"spawn_main" in command_of(w)]
            if workers:
                kill_one(rng.choice(workers))
                killed += 1
        if process.poll() is None:
            process.kill()
        process.communicate()
        if process.returncode == 0:
            break
        assert runs < 100
    print(f"{runs} runs, {killed} workers killed")
    assert runs > 2 and killed > 10
    assert bits(tmp_path / "b") == bits(tmp_path / "calm")


def finish(sweep, folder: Path, **options) -> Outcome:
    """Runs until everything is done."""
    for _ in range(20):
        try:
            return run_batch(sweep, folder, retry_failed=True, **options)
        except NotReachedError:
            continue
    raise AssertionError("twenty runs were not enough")


def done_here(sweep: Sweep, settings: Settings) -> list[tuple[str, str]]:
    """What workers do, without them: all that is left of a sweep."""
    folder, jobs = Folder(settings.folder), jobs_of(sweep, settings)
    folder.make()
    folder.write_plan(plan_of(sweep, jobs, settings))
    return [work(job, settings) for job in in_order(jobs)]


def test_workers_that_cannot_start_are_refused_in_a_line(jit_backend, tmp_path, monkeypatch):
    resource_tracker.ensure_running()  # which is a process of Python, too
    monkeypatch.setattr(multiprocessing.spawn, "_python_exe", b"/bin/false")
    with pytest.raises(NailopticsError, match="die as they start"):
        run_batch(phantoms(tmp_path, 2), tmp_path / "b", workers=2)
    # A busy machine takes a moment to end them, and may start one more until then.
    end_s = time.monotonic() + 10.0
    while children() and time.monotonic() < end_s:
        time.sleep(0.05)
    assert not children()


@pytest.mark.long
def test_a_scene_that_kills_its_worker_again_and_again_fails_alone(jit_backend, tmp_path):
    """Of three scenes one is endless; its worker is killed twice, as for lack of memory, and the others are done."""
    sweep = phantoms(tmp_path, 3)
    endless = sweep.scenes[2].model_copy(update={"accuracy": Accuracy(photons=10_000_000_000)})
    sweep = Sweep(sweep.name, sweep.axes, sweep.dims, (*sweep.scenes[:2], endless))
    last, news = [time.time()], []

    def kill(p: BatchProgress) -> None:
        if p.news:
            news.append(p.news)
            last[0] = time.time()
        if p.done == 2 and time.time() - last[0] > 1.5 and children():
            last[0] = time.time()
            os.kill(children()[0], signal.SIGKILL)

    with pytest.raises(NotReachedError, match="killed 2 times") as caught:
        run_batch(sweep, tmp_path / "b", workers=1, progress=kill)
    assert len(caught.value.result.done) == 2 and len(caught.value.result.failed) == 1
    assert any("tried again" in line for line in news)
    assert len(status(tmp_path / "b").failed) == 1


def driver(sweep_file: Path, folder: Path, *options: str, **kwargs) -> subprocess.Popen:
    command = [sys.executable, "-m", "nailoptics", "batch", str(sweep_file), "-o", str(folder), *options]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **kwargs)


def test_a_killed_driver_ends_its_workers_and_the_next_run_resumes(calm, here, tmp_path):
    process = driver(calm.file, tmp_path / "b", "--workers", "2")
    deadline = time.time() + 60
    while len(bits(tmp_path / "b")) < 4 and time.time() < deadline:
        time.sleep(0.01)
    workers = offspring(process.pid)
    process.kill()
    process.communicate()
    there = bits(tmp_path / "b")
    assert 4 <= len(there) < 30
    while any(Path(f"/proc/{w}").exists() for w in workers) and time.time() < deadline:
        time.sleep(0.05)
    assert not [w for w in workers if Path(f"/proc/{w}").exists()]
    outcome = run_batch(calm.sweep, tmp_path / "b", workers=1)
    assert len(outcome.kept) >= len(there) and len(outcome.kept) + len(outcome.done) == 30
    assert bits(tmp_path / "b") == calm.bits


def test_an_interrupted_run_ends_at_once_and_keeps_what_is_done(calm, tmp_path):
    # Ten times: where other work takes the processor away, the run may end before it is interrupted.
    for attempt in range(10):
        folder = tmp_path / f"b{attempt}"
        process = driver(calm.file, folder, "--workers", "1", start_new_session=True)
        # Its workers inherit its low priority, so that this test reads the fourth result long before the last.
        os.setpriority(os.PRIO_PGRP, process.pid, 19)
        deadline = time.time() + 60
        while len(bits(folder)) < 4 and time.time() < deadline:
            time.sleep(0.001)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGINT)  # as Ctrl-C does, to the workers too
        _, printed = process.communicate(timeout=20)
        if process.returncode:  # on a busy machine the run may have ended before it was interrupted
            break
    assert process.returncode == 3 and "interrupted; what is done is kept" in printed
    there = bits(folder)
    assert 4 <= len(there) < 30 and there.items() <= calm.bits.items()


@pytest.mark.long
def test_two_runs_in_one_folder_share_the_work(calm, tmp_path):
    rival = driver(calm.file, tmp_path / "b", "--workers", "1", "--json")
    deadline = time.time() + 60
    while not bits(tmp_path / "b") and time.time() < deadline:
        time.sleep(0.01)
    mine = run_batch(calm.sweep, tmp_path / "b", workers=1)
    printed, error = rival.communicate(timeout=120)
    assert rival.returncode == 0 and json.loads(printed)["total"] == 30, error
    assert len(mine.kept) + len(mine.done) == 30 and bits(tmp_path / "b") == calm.bits


@pytest.mark.slow
def test_the_number_of_threads_changes_no_bit_of_a_finger(jit_backend, here, fingers, tmp_path):
    for threads in (1, 2):
        backend.set_threads(threads)
        run_batch(fingers, tmp_path / str(threads), workers=1, photons=100_000)
    assert bits(tmp_path / "1") == bits(tmp_path / "2")


def test_scenes_of_one_light_trace_it_once(jit_backend, here, fingers, tmp_path):
    outcome = run_batch(fingers, tmp_path / "b", workers=1)
    assert (outcome.traces, outcome.total) == (1, 4)
    assert len(list((tmp_path / "b" / "light").iterdir())) == 1
    results = nail.open_results(tmp_path / "b", course=True)
    table = write_table(results, tmp_path / "table.csv").read_text().splitlines()
    assert table[0].startswith("so2,feedback_ohm,photons,led,photodiode,") and table[1].split(",")[3:5] == [
        "ir",
        "proximal.6",
    ]
    assert {"so2", "feedback_ohm"} <= set(results.volts.dims) and results.so2.values.tolist() == [0.75, 0.97]
    volts = results.volts.sel(so2=0.97).squeeze("photons", drop=True)
    assert volts.dims == ("feedback_ohm", "led", "photodiode", "time")
    ratio = volts.isel(feedback_ohm=1) / volts.isel(feedback_ohm=0)
    assert not bool(results.saturated_ever.any()) and float(abs(ratio - 2).max()) < 0.05


def test_a_damaged_result_and_damaged_light_are_detected_reported_and_computed_again(
    jit_backend, here, tmp_path, caplog
):
    sweep = phantoms(tmp_path, 4)
    run_batch(sweep, tmp_path / "b", workers=1)
    before = bits(tmp_path / "b")
    results, lights = (sorted((tmp_path / "b").glob(f"{n}/*.dat")) for n in ("results", "light/*"))
    results[0].write_bytes(results[0].read_bytes()[:200] + b"?" + results[0].read_bytes()[201:])
    results[1].write_bytes(b"")
    for light in lights:
        light.write_bytes(light.read_bytes()[:200])
    assert status(tmp_path / "b").corrupt == 2
    news = []
    outcome = run_batch(sweep, tmp_path / "b", workers=1, progress=lambda p: p.news and news.append(p.news))
    assert bits(tmp_path / "b") == before
    assert len(outcome.done) == len(outcome.kept) == len(outcome.corrupt) == 2
    assert sum("damaged" in line for line in news) == 2 and caplog.text.count("traced again") == 2


def test_a_failed_scene_is_recorded_and_retried_on_request(jit_backend, here, tmp_path):
    (tmp_path / "s.toml").write_text(FAILING)
    sweep = load_sweep(tmp_path / "s.toml")
    with pytest.raises(NotReachedError, match="2 failed") as caught:
        run_batch(sweep, tmp_path / "b", workers=1)
    assert len(caught.value.result.done) == 2 and all(
        "needs the photons engine" in why for why in caught.value.result.failed.values()
    )
    records = sorted((tmp_path / "b" / "failed").iterdir())
    first = [path.read_bytes() for path in records]
    with pytest.raises(NotReachedError, match="; --retry-failed tries them again") as caught:
        run_batch(sweep, tmp_path / "b", workers=1)
    assert len(caught.value.result.kept) == 2 and [path.read_bytes() for path in records] == first
    with pytest.raises(NotReachedError):
        run_batch(sweep, tmp_path / "b", workers=1, retry_failed=True)
    assert all(path.read_bytes() != old for path, old in zip(records, first, strict=True))
    results = nail.open_results(tmp_path / "b")
    assert sorted(results.state.values.ravel()) == ["done", "done", "failed", "failed"]
    assert np.isnan(results.detected_fraction_rest.sel(engine="volpath")).all()


@pytest.mark.slow
def test_a_scene_that_needs_too_much_memory_fails_alone(jit_backend, tmp_path):
    """Ten million samples of a touch need 3 GB and more; a limit on memory stands in for a smaller machine."""
    import resource

    axis = '[[axes]]\npath = "touch.{}"\nvalues = [{}]\n'
    text = 'schema_version = 1\nbase = "prototype"\n[[axes]]\npath = "accuracy.photons"\nvalues = [5000]\n'
    text += axis.format("sample_rate_hz", "10.0, 100000.0") + axis.format("duration_s", "90.0")
    (tmp_path / "s.toml").write_text(text)
    limit = 4_000_000_000
    process = driver(
        tmp_path / "s.toml",
        tmp_path / "b",
        *("--workers", "1", "--backend", "llvm"),
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (limit, limit)),
    )
    _, printed = process.communicate(timeout=300)
    assert process.returncode == 3 and "1 of 2 scenes are done; 1 failed" in printed
    assert all("memory" in why for why in status(tmp_path / "b").failed.values())


def test_of_scenes_that_share_their_light_one_without_memory_fails_alone(jit_backend, tmp_path, monkeypatch):
    sweep = phantoms(tmp_path, 4, path="leds.beam.flux_mw")
    trace = studies.trace

    def limited(scene, **options):
        if scene == sweep.scenes[0]:
            raise MemoryError("Unable to allocate 99 TiB")
        return trace(scene, **options)

    monkeypatch.setattr(studies, "trace", limited)
    (state, why), *others = done_here(sweep, Settings(tmp_path / "b", TraceOptions(backend=jit_backend.name)))
    assert (
        state == "failed"
        and others == [("done", "")] * 3
        and "not enough memory for it (Unable to allocate 99 TiB)" in why
    )


@pytest.mark.parametrize("key", ["required", "asked"])  # the second by 0.2.0
def test_what_reached_its_own_accuracy_is_not_run_again(key):
    """Colours have another tolerance than readings, and no relative error."""
    header = {"reached": True, "relative_error": None, "photons_per_led": 700, key: {"relative_error": 0.01}}
    assert meets(header, Accuracy(relative_error=0.01)) and not meets(header, Accuracy(relative_error=0.02))
    assert not meets(header | {"reached": False}, Accuracy(relative_error=0.01))


def test_a_result_as_accurate_as_required_is_not_run_again():
    header = {"reached": True, "relative_error": 0.015, "photons_per_led": 700, "required": {"photons": 700}}
    for accuracy, met in (
        (Accuracy(relative_error=0.015), True),
        (Accuracy(relative_error=0.0149), False),
        (Accuracy(photons=700, max_seconds=60.0), True),
        (Accuracy(photons=701), False),
        (Accuracy(max_seconds=60.0), True),
    ):
        assert meets(header, accuracy) == met
    assert not meets(header | {"relative_error": None}, Accuracy(relative_error=1.0))


def test_a_full_disk_ends_the_run_and_the_next_one_resumes(jit_backend, here, tmp_path):
    """A limit on the size of files stands in for a full disk."""
    import resource

    sweep = phantoms(tmp_path, 3, accuracy="photons = 60000")
    process = driver(
        tmp_path / "slabs3.toml",
        tmp_path / "b",
        "--workers",
        "1",
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000)),
    )
    _, printed = process.communicate(timeout=60)
    assert process.returncode == 1 and "make room and run again" in printed
    assert not list((tmp_path / "b").glob("*/.*.part"))
    assert len(run_batch(sweep, tmp_path / "b", workers=1).done) == 3


@pytest.mark.long
def test_a_time_limit_keeps_the_light_and_the_next_run_continues_it(jit_backend, here, tmp_path):
    sweep = phantoms(tmp_path, 1, accuracy="photons = 4_000_000_000")
    with pytest.raises(NotReachedError, match="max_seconds") as caught:
        run_batch(sweep, tmp_path / "b", workers=1, max_seconds=2)
    assert caught.value.result.unfinished == 1 and not bits(tmp_path / "b")
    [first] = (tmp_path / "b" / "light").iterdir()
    traced = {path: path.read_bytes() for path in first.iterdir()}
    with pytest.raises(NotReachedError, match="max_seconds"):
        run_batch(sweep, tmp_path / "b", workers=1, max_seconds=2)
    again = {path: path.read_bytes() for path in first.iterdir()}
    assert traced.items() < again.items() and not bits(tmp_path / "b")


@pytest.mark.long
def test_more_accuracy_later_continues_and_gives_the_bits_of_a_fresh_run(jit_backend, here, tmp_path):
    sweep = phantoms(tmp_path, 1, accuracy="relative_error = 0.004")
    assert done_here(sweep, Settings(tmp_path / "b", TraceOptions(backend=jit_backend.name))) == [("done", "")]
    first = sorted((tmp_path / "b" / "light").glob("*/*.dat"))
    assert len(run_batch(sweep, tmp_path / "b", workers=1, relative_error=0.002).done) == 1
    assert nail.open_results(tmp_path / "b").relative_error.item() < 0.002
    assert {*first} < {*(tmp_path / "b" / "light").glob("*/*.dat")}
    done_here(sweep, Settings(tmp_path / "fresh", TraceOptions(backend=jit_backend.name, relative_error=0.002)))
    assert bits(tmp_path / "b") == bits(tmp_path / "fresh")
    assert len(run_batch(sweep, tmp_path / "b", workers=1).kept) == 1


def test_a_scene_that_failed_for_a_rival_alone_counts_as_failed_no_more(jit_backend, tmp_path):
    """Expected: even once its result is damaged, it is left to do, not given up."""
    sweep, settings = phantoms(tmp_path, 1), Settings(tmp_path / "b", TraceOptions(backend=jit_backend.name))
    folder, [job] = Folder(settings.folder), jobs_of(sweep, settings)
    folder.write_failure(job.digest, "its worker was killed")
    assert done_here(sweep, settings) == [("done", "")] and status(settings.folder).done == 1
    folder.result(job.digest).write_bytes(b"")
    assert status(settings.folder).corrupt == status(settings.folder).left == 1


def test_shards_are_all_scenes_once_and_never_split_a_light(fingers, tmp_path):
    settings = Settings(tmp_path, TraceOptions(backend="llvm"))
    jobs = jobs_of(phantoms(tmp_path, 11), settings)
    parts = [of_shard(jobs, f"{i}/3") for i in (1, 2, 3)]
    assert sorted(job.digest for part in parts for job in part) == sorted(job.digest for job in jobs)
    assert [len(part) for part in parts] == [4, 4, 3]
    assert [len(of_shard(jobs_of(fingers, settings), f"{i}/2")) for i in (1, 2)] == [4, 0]


@pytest.mark.parametrize("shard", ["0/3", "4/3", "1", "a/b", "1/0"])
def test_a_wrong_shard_is_refused(shard):
    with pytest.raises(InputError, match="shard"):
        of_shard([], shard)


def test_a_folder_of_another_seed_is_refused_and_a_backend_without_kernels(jit_backend, here, tmp_path):
    sweep = phantoms(tmp_path, 2)
    run_batch(sweep, tmp_path / "b", workers=1)
    with pytest.raises(InputError, match="another folder"):
        run_batch(sweep, tmp_path / "b", seed=1)
    with pytest.raises(InputError, match="needs a JIT backend"):
        run_batch(sweep, tmp_path / "b", backend="scalar")
    with pytest.raises(InputError, match="exclude"):
        run_batch(sweep, tmp_path / "b", workers=1, scheduler="tcp://127.0.0.1:1")

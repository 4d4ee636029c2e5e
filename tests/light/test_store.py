"""What was traced is kept: the bits of a fresh trace, bounded, safe among rivals, and no other light served for it."""

import json
import multiprocessing
import os
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from small_scenes import SMALL_FINGER, phantom

import nailoptics as nail
from nailoptics import io
from nailoptics.io import pack
from nailoptics.light.tracing import stopping, store as store_module, trace_scene
from nailoptics.light.tracing.store import LightStore, led_cache_key, user_folder
from nailoptics.light.tracing.trace_scene import LedSource, LightEngine
from nailoptics.light.walk.layered import LayeredTracer
from nailoptics.scene import Scene, parse_scene

PHOTONS = 1 << 14


def slab_text(*, layer: str = "slab", flux: float = 1.0, x: float = 0.5) -> str:
    leds = [{"name": "one", "flux_mw": flux}, {"name": "two", "position_mm": [x, 0.0]}]
    return phantom({"name": layer, "g": 0.8}, leds=leds, photodiodes=[{}])


def slab(*, layer: str = "slab", flux: float = 1.0, x: float = 0.5) -> Scene:
    return parse_scene(slab_text(layer=layer, flux=flux, x=x))


def same_bits(one, other) -> bool:
    columns = ("photodiode", "weight", "path_mm")
    pairs = zip(one.traces, other.traces, strict=True)
    return all(
        a.seeds == b.seeds
        and a.energy == b.energy
        and a.absorbed == b.absorbed
        and all(np.array_equal(getattr(a, name), getattr(b, name)) for name in columns)
        for a, b in pairs
    )


@pytest.fixture
def small_batches(jit_backend, monkeypatch):
    monkeypatch.setattr(trace_scene, "PHANTOM_BATCH_PHOTONS", 1 << 12)


@pytest.mark.jit
def test_a_second_trace_walks_nothing_and_has_the_bits_of_a_fresh_one(small_batches, store, monkeypatch):
    first = nail.trace(slab(), photons=PHOTONS, seed=3)
    fresh = nail.trace(slab(layer="other", flux=9.0), photons=PHOTONS, seed=3, store=False)
    assert first.reused_photons == fresh.reused_photons == 0
    monkeypatch.setattr(LayeredTracer, "batch", None)
    again = nail.trace(slab(layer="other", flux=9.0), photons=PHOTONS, seed=3)
    assert again.reused_photons == again.photons == 2 * PHOTONS
    assert same_bits(again, fresh) and {*again.absorbed()["one"]} >= {"other"}
    assert np.array_equal(again.at().detected_fraction, fresh.at().detected_fraction)


@pytest.mark.jit
def test_a_tighter_error_continues_the_trace_and_another_seed_or_place_starts_one(small_batches, store):
    coarse = nail.trace(slab(), relative_error=0.02, seed=1)
    fine = nail.trace(slab(), relative_error=0.008, seed=1)
    assert fine.reused_photons == coarse.photons < fine.photons
    assert same_bits(fine, nail.trace(slab(), relative_error=0.008, seed=1, store=False))
    assert nail.trace(slab(), photons=PHOTONS, seed=2).reused_photons == 0
    # Of two LEDs only the one that moved.
    moved = nail.trace(slab(x=-1.0), photons=PHOTONS, seed=1)
    assert moved.reused_photons == PHOTONS
    assert same_bits(moved, nail.trace(slab(x=-1.0), photons=PHOTONS, seed=1, store=False))


@pytest.mark.jit
def test_opening_the_engine_is_no_part_of_the_time_for_tracing(small_batches, monkeypatch):
    """The clock goes on by a minute while the engine opens, and by a second with every batch."""
    now = [0.0]
    opened, batch = LayeredTracer.__init__, LayeredTracer.batch

    def slowly(self, scene):
        now[0] += 60.0
        opened(self, scene)

    def second(self, led, **more):
        now[0] += 1.0
        return batch(self, led, **more)

    monkeypatch.setattr(LayeredTracer, "__init__", slowly)
    monkeypatch.setattr(LayeredTracer, "batch", second)
    clock = SimpleNamespace(perf_counter=lambda: now[0], process_time=lambda: now[0])
    monkeypatch.setattr(trace_scene, "time", clock)
    monkeypatch.setattr(stopping, "time", clock)
    transfer = nail.trace(slab(), max_seconds=10.0, store=False)
    assert [trace.photons for trace in transfer.traces] == [5 << 12, 5 << 12]
    assert (transfer.setup_seconds, transfer.cpu_seconds, transfer.wall_seconds) == (60.0, 10.0, 10.0)


@pytest.mark.jit
def test_without_a_store_nothing_is_written(jit_backend, store):
    nail.trace(slab(), photons=100, store=False)
    assert not store.exists()


@pytest.mark.jit
def test_damaged_and_misplaced_files_are_named_and_traced_again(small_batches, store, caplog):
    fresh = nail.trace(slab(), photons=PHOTONS, seed=3)
    other = nail.trace(slab(), photons=PHOTONS, seed=4)
    kept = {path.parent for path in store.glob("*/*.dat")}
    seed = {json.loads(one)["seed"]: folder for folder in kept for one in [_made(folder)]}
    files = sorted(seed[3].glob("*.dat"))
    files[0].write_bytes(files[0].read_bytes()[:-9] + b"123456789")
    files[1].write_bytes(b"")
    shutil.copy(sorted(seed[4].glob("*.dat"))[2], files[2])
    files[3].unlink()
    files[3].mkdir()
    assert not same_bits(fresh, other)
    again = nail.trace(slab(), photons=PHOTONS, seed=3)
    assert same_bits(again, fresh) and again.reused_photons == PHOTONS
    messages = [record.getMessage() for record in caplog.records]
    assert all(any(str(file) in line for line in messages) for file in files), messages
    assert any("another light's" in line for line in messages) and any("not an archive" in line for line in messages)
    # The file that is a folder stays one; the others are whole again.
    caplog.clear()
    nail.trace(slab(), photons=PHOTONS, seed=3)
    assert [str(files[3]) in record.getMessage() for record in caplog.records] == [True]


def _set(array: np.ndarray, value: float) -> np.ndarray:
    return np.concatenate([array[:-1], np.full_like(array[-1:], value)])


WRONG_CONTENT = {
    "a weight is NaN": lambda about, arrays: arrays.update(weight=_set(arrays["weight"], np.nan)),
    "a weight is negative": lambda about, arrays: arrays.update(weight=-arrays["weight"]),
    "a path is infinite": lambda about, arrays: arrays.update(path_mm=_set(arrays["path_mm"], np.inf)),
    "no such photodiode": lambda about, arrays: arrays.update(photodiode=_set(arrays["photodiode"], 7)),
    "columns differ in length": lambda about, arrays: arrays.update(weight=arrays["weight"][1:]),
    "paths of another finger": lambda about, arrays: arrays.update(path_mm=np.repeat(arrays["path_mm"], 2, 1)),
    "a column is missing": lambda about, arrays: arrays.pop("path_mm"),
    "a sum is NaN": lambda about, arrays: about["energy"].update(lost=[float("nan"), 0.0]),
    "a sum is no pair": lambda about, arrays: about["energy"].update(lost=3),
    "sums are missing": lambda about, arrays: about.pop("absorbed"),
    "no count of events": lambda about, arrays: about.update(events="many"),
}


def rewritten(path: Path, change) -> None:
    """A file whose content was changed, its checksums right."""
    header, arrays = io.unpack(path.read_bytes())
    change(header["about"], arrays)
    path.write_bytes(pack(header, arrays))


@pytest.mark.jit
def test_wrong_content_with_valid_checksums_is_traced_again(small_batches, store, caplog):
    fresh = nail.trace(slab(), photons=PHOTONS, seed=3)
    files = sorted(store.glob("*/*.dat"))
    for k, (what, change) in enumerate(WRONG_CONTENT.items()):
        caplog.clear()
        path = files[k % len(files)]
        rewritten(path, change)
        again = nail.trace(slab(), photons=PHOTONS, seed=3)
        assert same_bits(again, fresh) and again.reused_photons == 2 * PHOTONS - (1 << 12), what
        assert [str(path) in record.getMessage() for record in caplog.records] == [True], what
    assert nail.trace(slab(), photons=PHOTONS, seed=3).reused


def test_nothing_outside_the_store_is_removed_through_a_link(tmp_path, store, capsys):
    from nailoptics.cli import run

    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "mine.dat").write_bytes(b"x" * 5000)
    store.mkdir()
    (store / ("0" * 32)).symlink_to(outside)
    kept = LightStore(store).entry({"light": 1})
    kept.write("0-1", {}, {"x": np.zeros(500)})
    (kept.folder / "1-1.dat").symlink_to(outside / "mine.dat")
    LightStore(store, most_bytes=100, optional=True).trim()
    assert not kept.folder.exists()
    assert run(["store", "--clear"]) == 0
    assert (outside / "mine.dat").read_bytes() == b"x" * 5000


def _made(folder) -> str:
    from nailoptics.io import unpack

    header, _ = unpack(next(folder.glob("*.dat")).read_bytes())
    return json.dumps(header["key"])


def test_every_option_that_changes_bits_has_its_own_entry_in_the_store(tmp_path, monkeypatch):
    store, scene = LightStore(tmp_path), slab()
    made = led_cache_key(scene, 0, seed=1, backend="llvm")
    others = [
        led_cache_key(scene, 0, seed=2, backend="llvm"),
        led_cache_key(scene, 0, seed=1, backend="cuda"),
        led_cache_key(scene, 1, seed=1, backend="llvm"),
        led_cache_key(slab(x=0.7), 1, seed=1, backend="llvm"),
        made | {"versions": made["versions"] | {"nailoptics": "0.0"}},
        made | {"program": "another"},
    ]
    assert len({store.entry(one).folder for one in (made, *others)}) == 7
    for same in (slab(layer="x"), slab(flux=4.0), slab(x=0.7)):
        assert store.entry(led_cache_key(same, 0, seed=1, backend="llvm")).folder == store.entry(made).folder


def test_walks_of_other_settings_have_their_own_entries_in_the_store(tmp_path):
    """Those on other faces, or that record more; a part that is there has its faces anyway."""
    finger = parse_scene(SMALL_FINGER + '[light]\nleft_out = ["bone"]\n')
    ways = [(finger, how) for how in ({}, {"with_faces": ("bone",)}, {"with_faces": ("kapton",)})]
    ways += [(slab(), {}), (slab(), {"escaping": True})]
    sources = [
        LedSource(scene, 0, LightEngine(scene, SimpleNamespace(name="llvm"), **how), [LightStore(tmp_path)], seed=1)
        for scene, how in ways
    ]
    folders = [source.stored[0].folder for source in sources]
    assert folders[2] == folders[0] and len({*folders}) == 4


def test_the_least_recently_used_light_is_removed_first_and_other_files_stay(tmp_path):
    store = LightStore(tmp_path)
    (tmp_path / "notes.txt").write_text("mine")
    entries = [store.entry({"light": i}) for i in range(5)]
    for i, entry in enumerate(entries):
        entry.write("0-1", {"a": 1}, {"x": np.zeros(50)})
        os.utime(entry.folder, (1000 + i, 1000 + i))
    assert entries[0].read("0-1", lambda about, arrays: about) == {"a": 1}
    LightStore(tmp_path, most_bytes=2500, optional=True).trim()
    left = [entry.folder.exists() for entry in entries]
    assert left[0] and left[4] and not left[1] and sum(left) < 5
    assert sum(path.stat().st_size for path in tmp_path.glob("*/*.dat")) <= 2500
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_no_command_evicts_its_own_light(tmp_path):
    light = LightStore(tmp_path, most_bytes=20_000, optional=True).entry({"light": 1})
    for number in range(100):
        light.write(f"{number}-1", {}, {"x": np.zeros(100)})
    assert light.path("0-1").exists() and light.path("5-1").exists() and not light.path("99-1").exists()


def test_a_store_that_cannot_be_written_stops_no_trace_and_is_warned_of_once(tmp_path, caplog):
    (tmp_path / "store").write_text("a file")
    light = LightStore(tmp_path / "store", optional=True).entry({"light": 1})
    for _ in range(3):
        light.write("0-1", {}, {"x": np.zeros(3)})
    assert len(caplog.records) == 1 and "not stored" in caplog.records[0].getMessage()


def _trace(results, most_bytes: float, times: int) -> None:
    """Trace into a store that hardly has room, as others do at the same time."""
    store_module.MOST_BYTES = most_bytes
    for _ in range(times):
        transfer = nail.trace(slab(), photons=1 << 14, seed=5)
        results.put((transfer.traces[0].weight.tobytes(), transfer.photons))


@pytest.mark.long
@pytest.mark.jit
def test_four_processes_at_once_share_a_store_and_all_have_the_same_bits(jit_backend, store):
    """Half of them make room in it all the time."""
    context = multiprocessing.get_context("spawn")
    results = context.Queue()
    rivals = [context.Process(target=_trace, args=(results, most, 8)) for most in (1e4, 2e9) * 2]
    for rival in rivals:
        rival.start()
    bits = {results.get(timeout=240)[0] for _ in range(8 * len(rivals))}
    for rival in rivals:
        rival.join()
    assert [rival.exitcode for rival in rivals] == [0] * 4
    assert bits == {nail.trace(slab(), photons=1 << 14, seed=5).traces[0].weight.tobytes()}
    assert not list(store.rglob("*.part"))


@pytest.mark.parametrize(("free", "most"), [(1e9, 2.5e8), (1e12, 2e9)])
def test_the_store_takes_a_part_of_what_is_free_and_no_more_than_its_bound(monkeypatch, store, free, most):
    monkeypatch.setattr("nailoptics.light.tracing.store.shutil.disk_usage", lambda path: SimpleNamespace(free=free))
    assert LightStore.of_user().most_bytes == most


def test_where_the_store_lies(monkeypatch, tmp_path):
    monkeypatch.setenv("NAILOPTICS_STORE", "off")
    assert user_folder() is None and LightStore.of_user() is None
    monkeypatch.delenv("NAILOPTICS_STORE")
    for platform, variable, below in (
        ("linux", "XDG_CACHE_HOME", "nailoptics/light"),
        ("win32", "LOCALAPPDATA", "nailoptics/light"),
        ("darwin", "HOME", "Library/Caches/nailoptics/light"),
    ):
        monkeypatch.setattr(io.sys, "platform", platform)
        monkeypatch.setenv(variable, str(tmp_path / platform))
        assert user_folder() == tmp_path / platform / below

    def nobodys() -> Path:
        raise RuntimeError("no home")

    monkeypatch.setattr(io.Path, "home", nobodys)
    assert user_folder() is None


@pytest.mark.jit
def test_the_store_from_the_command_line(jit_backend, store, tmp_path, capsys):
    from nailoptics.cli import run

    scene = tmp_path / "slab.toml"
    scene.write_text(slab_text())
    reused = []
    for more in (["--photons", "500"], ["--photons", "500"], ["--photons", "500", "--no-store"]):
        assert run(["trace", str(scene), "--json", *more]) == 0
        reused.append(json.loads(capsys.readouterr().out)["reused"])
    assert reused == [False, True, False]
    assert run(["store", "--json"]) == 0
    stored = json.loads(capsys.readouterr().out)
    assert stored["traces"] == 2 and stored["bytes"] == sum(path.stat().st_size for path in store.rglob("*.dat"))
    assert run(["store"]) == 0 and "2 cached traces" in capsys.readouterr().out
    assert run(["store", "--clear"]) == 0 and not list(store.iterdir())


def test_a_store_that_is_off_is_reported(capsys):
    from nailoptics.cli import run

    assert run(["store"]) == 2 and "NAILOPTICS_STORE" in capsys.readouterr().err


def test_a_store_that_is_a_file_is_refused_in_one_line(tmp_path, monkeypatch, capsys):
    from nailoptics.cli import run

    (tmp_path / "file").write_text("mine")
    monkeypatch.setenv("NAILOPTICS_STORE", str(tmp_path / "file"))
    for command in (["store"], ["store", "--clear", "--json"]):
        assert run(command) == 2
        shown = capsys.readouterr()
        assert shown.out == "" and len(shown.err.splitlines()) == 1 and "set NAILOPTICS_STORE to another" in shown.err
    assert LightStore.of_user().entry({"light": 1}).read("0-1", dict) is None
    assert (tmp_path / "file").read_text() == "mine"


def test_stored_light_is_identified_by_the_programs_optics(monkeypatch):
    """Rationale: light of other optics must not be taken for today's. Expected: what the walks import is in the
    program's digest but for what checks, reads, writes, and vessels beside the blood; so are tissue's constants."""
    read, read_bytes = set(), Path.read_bytes
    monkeypatch.setattr(Path, "read_bytes", lambda path: read.add(path.resolve()) or read_bytes(path))
    store_module.program_digest.__wrapped__()
    package = Path(nail.__file__).resolve().parent
    others = {"__init__", "assets", "checks", "display", "errors", "io", "options", "variables", "version"}
    code = """
        import sys, nailoptics.light.walk.finger, nailoptics.light.walk.layered
        print(*(m.__file__ for name, m in sys.modules.items() if name.split(".")[0] == "nailoptics"), sep="\\n")
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(code)], capture_output=True, text=True, check=True)
    walked = {Path(path).resolve() for path in done.stdout.split()}
    missing = {path.relative_to(package) for path in walked - read} - {Path(f"{name}.py") for name in others}
    assert {path.parent for path in missing} <= {Path("hemodynamics")} and Path("hemodynamics/blood.py") not in missing
    assert {"tissue.py", "tissue.toml"} <= {path.name for path in read} and len(walked) > 30

"""Every file of a batch records its origin: what does not fit is refused or reported, and never used for another."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import nailoptics as nail
from nailoptics.assets import data_dir
from nailoptics.batch import Sweep, folder as folders, run_batch, status
from nailoptics.batch.folder import Folder
from nailoptics.batch.jobs import Settings, jobs_of, work
from nailoptics.cli import run
from nailoptics.errors import InputError, NotReachedError
from nailoptics.io import pack, unpack
from nailoptics.light.tracing import store
from nailoptics.options import TraceOptions

from .conftest import Calm, Here, bits, phantoms

pytestmark = pytest.mark.jit


@pytest.fixture
def used(calm: Calm, here: None, tmp_path: Path) -> Path:
    """A folder of thirty scenes that are done; more are done without workers."""
    return Path(shutil.copytree(calm.folder, tmp_path / "used"))


@pytest.fixture(scope="module")
def other_seed(calm: Calm, tmp_path_factory) -> dict[str, bytes]:
    """The same scenes, traced with seed 1."""
    folder = tmp_path_factory.mktemp("other")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("nailoptics.batch.run.LocalSlots", Here)
        run_batch(calm.sweep, folder, workers=1, seed=1)
    return bits(folder)


def results_of(folder: Path) -> list[Path]:
    return sorted((folder / "results").iterdir())


def rewritten(path: Path, **header) -> None:
    """A result of which some of the header is another's, its checksum right."""
    old, arrays = unpack(path.read_bytes())
    path.write_bytes(pack(old | header, arrays))


def again(calm: Calm, folder: Path, **options):
    news: list[str] = []
    outcome = run_batch(calm.sweep, folder, workers=1, progress=lambda p: p.news and news.append(p.news), **options)
    return outcome, news


def test_results_of_another_seed_or_version_are_computed_again(calm, used, caplog):
    made = unpack(results_of(used)[0].read_bytes())[0]["made"]
    for path, other in zip(
        results_of(used),
        ({"seed": 7}, {"backend": "cuda"}, {"versions": made["versions"] | {"nailoptics": "0.0.1"}}),
        strict=False,
    ):
        rewritten(path, made=made | other)
    assert (status(used).foreign, status(used).done) == (3, 27) and "another seed's" in str(status(used))
    opened = nail.open_results(used)
    assert sorted(opened.state.values)[-3:] == ["foreign"] * 3 and "3 results" in caplog.text
    assert np.isnan(opened.detected_fraction_rest[opened.state == "foreign"]).all()
    outcome, news = again(calm, used)
    assert (len(outcome.done), len(outcome.kept)) == (3, 27) and sum("another seed's" in line for line in news) == 3
    assert bits(used) == calm.bits


@pytest.mark.parametrize("damage", ["lost", "cut", "incomplete", "folder"])
def test_without_its_plan_a_folder_gives_no_other_seeds_results(calm, used, damage, other_seed, caplog):
    plan = used / "plan.json"
    whole = json.loads(plan.read_text())
    plan.unlink()
    if damage == "cut":
        plan.write_text('{"format": 2, "swe')
    elif damage == "incomplete":
        plan.write_text(json.dumps({name: value for name, value in whole.items() if name != "dims"}))
    elif damage == "folder":
        plan.mkdir()
    for question in (status, nail.open_results):
        with pytest.raises(InputError, match=r"plan\.json") as caught:
            question(used)
        assert len(str(caught.value).splitlines()) == 1
    if damage == "folder":
        with pytest.raises(InputError, match="folder"):
            again(calm, used)
        return
    outcome, _ = again(calm, used, seed=1)
    assert (len(outcome.done), len(outcome.kept), len(outcome.corrupt)) == (30, 0, 30)
    assert ("written anew" in caplog.text) == (damage != "lost")
    assert bits(used) == other_seed


@pytest.mark.parametrize(
    "change",
    [
        {"dims": {"x": "many"}},
        {"dims": {"x": 7}},
        {"required": []},
        {"axes": [{"name": "x", "values": [1.0, 2.0]}]},
        {"scenes": "abc"},
        {"made": {}},
        {"axes": [{"name": "x"}]},
        {"required": [{"photons": "many"}] * 30},
        {"made": {"seed": 0, "backend": "llvm", "versions": "all"}},
    ],
    ids=str,
)
def test_a_plan_with_wrong_fields_is_refused(used, change):
    plan = used / "plan.json"
    plan.write_text(json.dumps(json.loads(plan.read_text()) | change))
    with pytest.raises(InputError, match=r"plan\.json"):
        status(used)


@pytest.mark.parametrize("text", ["[]", "5", "null", '"plan"'])
def test_a_plan_that_is_no_table_is_refused(used, text):
    (used / "plan.json").write_text(text)
    for question in (status, nail.open_results):
        with pytest.raises(InputError, match="it holds no table"):
            question(used)


def test_light_under_another_name_is_not_used(calm, used, caplog):
    folders = sorted((used / "light").iterdir())
    for folder in folders[1:4]:
        [mine], [other] = folder.iterdir(), folders[0].iterdir()
        shutil.copy(other, mine)
    for path in results_of(used):
        path.unlink()
    outcome, _ = again(calm, used)
    assert len(outcome.done) == 30 and bits(used) == calm.bits and caplog.text.count("it is another light's") == 3


def test_a_damaged_results_folder_is_reported_and_the_rest_continues(calm, used):
    paths = results_of(used)
    shutil.copy(paths[0], paths[1])
    for path in paths[2:4]:
        path.unlink()
    paths[2].mkdir()
    paths[3].symlink_to(paths[3])
    paths[4].write_bytes(pack({}, {}))
    assert (status(used).corrupt, status(used).done) == (4, 26)
    states = nail.open_results(used).state.values
    assert sorted(states) == ["corrupt"] * 4 + ["done"] * 26
    with pytest.raises(NotReachedError, match="29 of 30 scenes are done; 1 failed") as caught:
        again(calm, used)
    [why] = caught.value.result.failed.values()
    assert paths[2].name in why and "is a folder" in why
    assert {name: one for name, one in bits_of_files(used).items()} == {
        name: one for name, one in calm.bits.items() if name != paths[2].name
    }
    assert list(status(used).failed) == [paths[2].stem]


def bits_of_files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in results_of(folder) if path.is_file()}


def test_another_sweep_is_refused_and_one_that_grew_continues(calm, used, tmp_path):
    other = phantoms(tmp_path, 4, low=5.0, high=6.0)
    with pytest.raises(InputError, match="30 of its 30 scenes are not"):
        run_batch(other, used, workers=1)
    [axis] = calm.sweep.axes
    values = (*axis.values, 9.0)
    grown = phantoms(tmp_path, 2, low=values[0], high=9.0)
    longer = Sweep(
        calm.sweep.name,
        (type(axis)(axis.name, axis.path, values),),
        {"thickness_mm": 31},
        (*calm.sweep.scenes, grown.scenes[1]),
    )
    outcome = run_batch(longer, used, workers=1)
    assert (len(outcome.done), len(outcome.kept)) == (1, 30)
    with pytest.raises(InputError, match="1 of its 31 scenes are not"):
        again(calm, used)


def test_a_batch_of_another_version_opens_but_does_not_resume(calm, used, caplog):
    """Its results are whole, so that they are opened; a run would mix them with others."""
    assert status(used).other_versions == "" and nail.open_results(used) is not None and not caplog.text
    plan = json.loads((used / "plan.json").read_text())
    plan["made"]["versions"]["nailoptics"] = "0.0.1"
    (used / "plan.json").write_text(json.dumps(plan))
    for path in results_of(used):
        rewritten(path, made=plan["made"])
    after = status(used)
    assert (after.done, after.foreign) == (30, 0) and "begun with nailoptics 0.0.1" in str(after)
    assert (nail.open_results(used).state == "done").all() and "made with nailoptics 0.0.1" in caplog.text
    with pytest.raises(InputError, match=r"nailoptics 0\.0\.1 and is .* here"):
        again(calm, used)


def test_results_of_another_program_are_computed_again(calm, used, monkeypatch, caplog):
    """Of the same version, as between releases. Expected: opened with a warning, never mixed with new results."""
    monkeypatch.setattr(folders, "program_digest", lambda code, assets: "another program")
    assert (status(used).foreign, status(used).left, status(used).other_versions) == (30, 30, "")
    assert (nail.open_results(used).state == "done").all() and "and is another prog here" in caplog.text
    outcome, news = again(calm, used)
    assert (len(outcome.done), len(outcome.kept)) == (30, 0) and "or program's; made again" in news[0]
    assert status(used).done == 30 and not set(bits(used).values()) & set(calm.bits.values())


def test_a_program_is_all_its_code_and_assets_from_a_wheel_as_from_a_clone(monkeypatch, tmp_path):
    read, read_bytes, package = set(), Path.read_bytes, Path(nail.__file__).resolve().parent
    monkeypatch.setattr(Path, "read_bytes", lambda path: read.add(path) or read_bytes(path))
    monkeypatch.setattr(folders, "program_digest", store.program_digest.__wrapped__)
    clone = folders.Provenance.here(0, "llvm")
    assert {path.resolve() for path in read} >= {*package.glob("**/*.py"), *data_dir("assets").glob("**/*.toml")}
    wheel = tmp_path / "nailoptics"
    shutil.copytree(package, wheel, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(data_dir("assets"), wheel / "_assets")
    monkeypatch.setattr(store, "__file__", str(wheel / "light" / "tracing" / "store.py"))
    monkeypatch.setattr(store, "data_dir", lambda name: wheel / f"_{name}")
    assert folders.Provenance.here(0, "llvm") == clone
    (wheel / "_assets" / "vessels.toml").write_text("")
    assert "program" in clone.unlike(folders.Provenance.here(0, "llvm"))


def test_a_worker_of_another_version_fails_its_scenes_with_the_reason(calm, tmp_path, monkeypatch):
    """Its results would be another's, and be made again by every run."""
    settings = Settings(tmp_path, TraceOptions(backend="llvm"))
    (job, *_) = jobs_of(calm.sweep, settings)
    monkeypatch.setattr(folders, "current_versions", lambda: dict(settings.made.versions) | {"nailoptics": "0.0.1"})
    state, why = work(job, settings)
    assert state == "failed" and "and is 0.0.1 here, in the worker" in why and "\n" not in why
    assert Folder(tmp_path).why_failed(job.digest) == why and not bits(tmp_path)


def test_a_plan_with_the_key_of_0_2_0_is_read(used):
    plan = json.loads((used / "plan.json").read_text())
    plan["asked"] = plan.pop("required")
    (used / "plan.json").write_text(json.dumps(plan))
    assert (status(used).done, status(used).left) == (30, 0)


def test_a_folder_that_is_removed_ends_the_run(calm, tmp_path):
    folder = tmp_path / "b"

    def remove(p) -> None:
        if p.done >= 5 and folder.exists():
            shutil.rmtree(folder, ignore_errors=True)

    with pytest.raises(NotReachedError, match="the folder takes no more"):
        run_batch(calm.sweep, folder, workers=1, progress=remove)


def test_a_second_interrupt_reports_where_finished_results_lie(calm, used, monkeypatch, capsys):
    """The second one comes while the page is written."""

    def interrupted(*arguments, **more):
        raise KeyboardInterrupt

    monkeypatch.setattr("nailoptics.report.pages.sweep.write_sweep", interrupted)
    assert run(["batch", str(calm.file), "-o", str(used), "--workers", "1"]) == 130
    assert f"finished scenes are in {used}" in capsys.readouterr().err

"""Results that show themselves: the figures, pages, summaries and files of the command line, from Python.

Here those that take next to no light; each study's tests show a traced one.
"""

import ast
import html
import json
from pathlib import Path

import made_sensor
import numpy as np
import pytest
import xarray as xr
from made_exploration import made_exploration
from shown import all_shown

import nailoptics as nail
from nailoptics.cli import run
from nailoptics.report.accessor import KINDS, Nail
from nailoptics.report.pages.simulate import SIMULATION, page
from nailoptics.studies.force.subject import parse_subject

PACKAGE = Path(nail.__file__).parent
TITLE = {"title": "nailoptics: touch to volts"}


@pytest.mark.long
def test_a_simulation_shows_itself_as_its_page_does(make, undrawn, tmp_path):
    result = make(leds=2).assign_attrs(TITLE)
    figures = all_shown(result, page=False)
    assert list(figures) == list(result.nail.figures) == ["readings", "touch", "volts", "section"]
    shown, report = page(result), result.nail.report()
    assert result.nail.summary() == SIMULATION.summary(result) and report == shown
    assert shown.startswith("<!doctype html>")
    titles = [[axes.get_title("left") for axes in result.nail.plot("volts", led=k).axes] for k in (0, 1)]
    assert titles[0] and titles == [titles[0]] * 2
    assert result.nail.scene == nail.parse_scene(result.attrs["scene"])
    assert "plot() of readings, touch" in repr(result.nail) and result.nail._repr_html_().startswith("<pre>")
    inline = report._repr_html_()
    assert inline.startswith("<iframe srcdoc=") and html.escape(shown[:500]) in inline
    assert figures["readings"]._repr_png_().startswith(b"\x89PNG")
    written = result.nail.report(tmp_path / "here" / "page.html")
    assert written == {"report": tmp_path / "here/page.html"} and written["report"].read_text("utf-8") == shown


def test_a_folder_gets_the_files_of_the_command_which_show_themselves_again(make, undrawn, tmp_path):
    made = make(leds=1).assign_attrs(TITLE)
    written = made.nail.report(tmp_path / "results")
    assert {path.name for path in (tmp_path / "results").iterdir()} == {"result.nc", "report.html"}
    with xr.open_dataset(written["result"]) as result:
        assert result.nail.report() == written["report"].read_text("utf-8")


def test_a_file_is_read_once(make, undrawn, tmp_path):
    """Expected: what is shown later needs it no more; each access to a lazy value costs milliseconds."""
    path = make(leds=1).assign_attrs(TITLE).nail.report(tmp_path)["result"]
    with xr.open_dataset(path) as result:
        summary = result.nail.summary()
    path.unlink()
    assert result.nail.summary() == summary and result.nail.report() and result.nail.plot()


def test_what_a_result_lacks_is_reported(make):
    result = make(section=False).assign_attrs(TITLE)
    with pytest.raises(nail.InputError, match='figure = "spectrum" is unknown; choose from readings, touch'):
        result.nail.plot("spectrum")
    with pytest.raises(nail.InputError, match=r'"section" needs .* simulate\(scene, picture=True\)'):
        result.nail.plot("section")
    for other in (xr.Dataset(), xr.Dataset(attrs={"title": "mine"})):
        with pytest.raises(nail.InputError, match="not a result that nailoptics can show"):
            _ = Nail(other)


def test_a_photodiode_without_light_has_no_line(make):
    """Expected: what detected no light is stated in the legend, not drawn as a reading that stays the same."""
    result = make(leds=1).assign_attrs(TITLE)
    name = str(result.photodiode.values[0])
    result = result.assign(detected_fraction=result.detected_fraction.where(result.photodiode != name, 0.0))
    lines = {line.get_label(): line.get_ydata() for line in result.nail.plot().axes[0].lines}
    (dark,) = (label for label in lines if label.startswith(name))
    assert dark == f"{name}  no light" and not np.isfinite(lines.pop(dark)).any()
    assert all(np.isfinite(values).all() for values in lines.values())
    panel = next(axes for axes in result.nail.plot("volts").axes if axes.get_title("left") == name)
    assert not any(np.isfinite(line.get_ydata()).any() for line in panel.lines)


CUTS = {
    "two of the photodiodes": lambda r: r.isel(photodiode=[0, 1]),
    "one photodiode": lambda r: r.isel(photodiode=0),
    "no time": lambda r: r.isel(time=[]),
    "one time": lambda r: r.isel(time=0),
    "no LED": lambda r: r.isel(led=[]),
    "two runs": lambda r: xr.concat([r, r], "run"),
    "one variable": lambda r: r[["volts"]],
}


@pytest.mark.parametrize("cut", CUTS.values(), ids=CUTS)
def test_of_a_part_of_a_result_the_whole_is_named_as_what_is_needed(make, tmp_path, cut):
    part = cut(make(leds=1).assign_attrs(TITLE)).nail
    for show in (lambda: part.plot("volts"), part.report, lambda: part.report(tmp_path / "a.html")):
        with pytest.raises(nail.InputError, match="show the whole result, as returned") as refused:
            show()
        assert refused.value.__cause__ and len(str(refused.value)) < 150
    assert not [*tmp_path.iterdir()]


def test_options_are_those_of_the_figure(make):
    shown = make(leds=1).assign_attrs(TITLE).nail
    for options, line in (({"name": "touch"}, "is unknown; .*: none"), ({"led": 7}, "led = 7 is unknown")):
        with pytest.raises(nail.InputError, match=line):
            shown.plot("touch", **options)
    with pytest.raises(nail.InputError, match='figure = "volts", led = 7 needs what this does not hold'):
        shown.plot("volts", led=7)


def sweep(**axes):
    """Readings over axes in newtons, without light."""
    shape = [*(len(values) for values in axes.values()), 1, 1]
    of, volts = {"units": "V", "long_name": "voltage at rest"}, ((*axes, "led", "photodiode"), np.ones(shape))
    data = {
        "volts_start": (*volts, of),
        "volts_start_stderr": (*volts, of),
        "state": (tuple(axes), np.full(shape[:-2], "done")),
    }
    coords = {name: (name, values, {"units": "N", "long_name": name}) for name, values in axes.items()}
    return xr.Dataset(data, coords | {"led": ["ir"], "photodiode": ["a"]}, {"title": "nailoptics: batch x"}).nail


def test_a_sweep_of_one_value_is_a_point_and_another_axis_is_named():
    (axes,) = sweep(force_n=[1.0]).plot().axes
    assert axes.get_xlabel() == "force_n [N]" and [*axes.lines[0].get_xdata()] == [1.0]
    (axes,) = sweep(rest_n=[0.1, 0.2], force_n=[1.0, 2.0]).plot().axes
    assert axes.get_title("left") == "force_n = 2 N"
    assert sweep(force_n=[1.0]).figures == ("along",) and "photographs" not in repr(sweep(force_n=[1.0]))
    with pytest.raises(nail.InputError, match='"photographs" needs a sweep of study = "colour"'):
        sweep(force_n=[1.0]).plot("photographs")
    with pytest.raises(nail.InputError, match='"nailoptics: batch x" has no scene'):
        _ = sweep(force_n=[1.0]).scene
    # As where all scenes failed.
    failed = sweep(force_n=[1.0])._result[["state"]].nail
    with pytest.raises(nail.InputError, match="needs readings: no scene is done"):
        failed.plot()
    assert "1 scenes: 1 done" in failed.report()


@pytest.mark.long
def test_a_persons_sensor_and_its_force_show_themselves(tmp_path):
    subject = parse_subject(made_sensor.subject())
    assert list(all_shown(subject)) == ["factors"] and len(repr(subject)) < 120
    assert "&lt;Subject: 8 readings" in subject._repr_html_()
    recording = made_sensor.record(made_sensor.cycle(0.6), "proximal", seed=3)
    predicted = nail.predict(subject, recording)
    assert list(all_shown(predicted)) == ["force", "share"]
    with pytest.raises(nail.InputError, match='"force from volts" has no scene'):
        _ = predicted.nail.scene
    assert nail.predict(nail.load_subject(subject.nail.report(tmp_path)["scene"]), recording).attrs["rms_n"] > 0


def test_an_exploration_shows_itself():
    explored = made_exploration(nail.load_scene("prototype"))
    assert explored.nail.scene == explored.scene
    explored.attributes.update(photons=1000, cpu_seconds=1.0, wall_seconds=1.0)
    assert list(all_shown(explored)) == ["board"]
    assert repr(explored) == "<Exploration: plot() of board; report(), summary(), scene>"


def test_the_papers_figures_show_themselves(tmp_path):
    shown = nail.figures(tmp_path, ["subject"], colour=False)
    assert list(all_shown(shown, page=False)) == ["picture"] and len(shown.nail.plot(name="fig15").axes[0].images) == 1
    with pytest.raises(nail.InputError, match="does not hold"):
        shown.nail.plot(name="fig99")
    assert {row["figure"] for row in shown.nail.summary()["claims"]} and shown.nail.report().count("<img") > 1


def test_every_title_of_a_study_has_its_report():
    """Expected: a Dataset of a public study is shown, and KINDS names no report that does not exist."""
    computed = set()
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                computed |= {node.value} & KINDS.keys()
    assert computed >= {kind for kind in KINDS if kind.startswith("nailoptics") and "batch" not in kind}
    for kind in KINDS:
        assert Nail(xr.Dataset(attrs={"title": kind})).figures


@pytest.mark.jit
def test_a_trace_and_its_readings_show_themselves(jit_backend, tmp_path):
    transfer = nail.trace(nail.load_scene("prototype"), photons=20_000, backend=jit_backend.name)
    assert list(all_shown(transfer)) == list(all_shown(transfer.at(so2=[0.9, 0.95]))) == ["readings"]
    assert transfer.nail.scene == transfer.scene == transfer.at().nail.scene
    assert transfer.at(so2=[0.9, 0.95]).sizes["state"] == 2 and len(repr(transfer)) < 150
    detected = transfer.at().detected_fraction
    (row,) = [row for row in transfer.nail.summary()["readings"] if row["photodiode"] == "distal.3"]
    assert row["detected_fraction"] == float(detected.sel(led="ir", photodiode="distal.3"))
    assert transfer.nail.report(tmp_path)["result"].name == "trace.nc"


@pytest.mark.long
@pytest.mark.jit
def test_a_check_is_that_of_the_command(jit_backend, shared_light, few_photons_beside, capsys):
    check = nail.check(nail.load_scene("prototype"))
    assert list(all_shown(check)) == ["board"]
    assert run(["check", "prototype", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert json.loads(json.dumps(check["leds"])) == printed["leds"] and len(check["pairs"]) == len(printed["pairs"])
    assert {"scene", *check.nail.summary()} == printed.keys()

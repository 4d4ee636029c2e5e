"""Names that attack a browser are text in every part that pages are made of, in drawings, too."""

from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from hostile_names import HOSTILE, Tags, assert_text_alone
from matplotlib.figure import Figure

from nailoptics.assets import data_dir
from nailoptics.report import html
from nailoptics.report.pages import force, oximeter, placement, sweep, tradeoff
from nailoptics.report.pages.simulate import page as touch_page
from nailoptics.scene import load_scene, to_toml


@pytest.mark.parametrize("name", HOSTILE)
def test_every_slot_of_a_page_shows_a_name_as_text(name):
    for slot in ("kicker", "title", "lead"):
        given = {"kicker": "k", "title": "t", "lead": "l"} | {slot: name}
        assert_text_alone(html.document(**given, cards=[], body=[], attributes={}), name)
    plain = {"kicker": "k", "title": "t", "lead": "l", "body": []}
    assert_text_alone(html.document(**plain, cards=[(name, name)], attributes={}), name)
    assert_text_alone(html.document(**plain, cards=[], attributes={}, warnings=[name]), name)
    for attribute in ("scene", "cut_off", *html.PROVENANCE):
        assert_text_alone(html.document(**plain, cards=[], attributes={"scene": "", attribute: name}), name)
    assert_text_alone(html.table([{name: name}, {name: "other"}], groups=[name, "another"]), name)
    assert_text_alone(html.section(name, name, html.small(name), html.subheading(name)), name)


def test_invisible_characters_are_escaped_on_a_page():
    """A name that clears a terminal, one that turns the writing round, and the byte of a file's name that is not text;
    an unbreakable space and a line break stay."""
    name = "a\x1b[2J\u202eb\udcffc\u00a0d\ne"
    shown = "a\\x1b[2J\\u202eb\\udcffc\u00a0d\ne"
    text = html.document(kicker="k", title=name, lead="l", cards=[(name, name)], body=[], attributes={"scene": name})
    assert shown in Tags(text).visible_text and text.encode()
    assert not any(c in text for c in "\x1b\u202e\udcff")


@pytest.mark.long
def test_a_browser_runs_and_loads_nothing_of_a_name(browser, make, monkeypatch, tmp_path):
    """In every slot, table and figure, and on pages of a touch, a prediction and a sweep: no dialog, no request."""
    name, drawing = "".join(HOSTILE), Figure()
    drawing.subplots().set_title(name.replace("$", r"\$"))
    body = [html.table([{name: name}], groups=[name]), html.figure(drawing, name)]
    given = {"kicker": name, "title": name, "lead": name, "warnings": name, "cards": [(name, name)], "body": body}
    about = dict.fromkeys(("scene", "cut_off", *html.PROVENANCE), name)
    result = make(section=False).assign_coords(led=[name], photodiode=[f"{name}{i}" for i in range(8)])
    result = result.assign_attrs(versions=name, seeds=name, backend=name)
    pages = {"touch.html": touch_page(result), "predict.html": hostile_prediction(name, monkeypatch)}
    pages |= {
        "sweep.html": hostile_sweep(HOSTILE[0].partition("$")[0]),
        "parts.html": html.document(**given, attributes=about),
    }
    for page, text in pages.items():
        (tmp_path / page).write_text(text, encoding="utf-8")
    view, heard = browser.new_page(), []
    for event in ("console", "pageerror", "dialog", "request"):
        view.on(event, lambda what, event=event: heard.append((event, getattr(what, "url", what))))
    for page in pages:
        view.goto((tmp_path / page).as_uri())
        assert "alert(1)" in view.inner_text("main")
        assert view.evaluate("document.querySelectorAll('script, img, [onerror], [onload]').length") == 0
    assert heard == [("request", (tmp_path / page).as_uri()) for page in pages]
    view.close()


@pytest.mark.parametrize("name", HOSTILE)
def test_a_drawing_and_its_caption_show_a_name_as_text(name):
    """Labels, legend and title of a figure, as SVG inside a page."""
    drawing = Figure()
    axes = drawing.subplots()
    # A pair of dollars would be set as a formula; names of a result are drawn with theirs escaped.
    shown = name.replace("$", r"\$")
    axes.plot([0, 1], label=shown)
    axes.set(title=shown, xlabel=shown)
    axes.legend()
    text = html.figure(drawing, name)
    assert_text_alone(text, name)
    assert Tags(text).found.count("svg") == 1


@pytest.mark.parametrize("name", HOSTILE)
def test_tables_of_layouts_persons_and_readings_show_a_name_as_text(name):
    numbers = ["force_resolution_n", "force_resolution_n_stderr", "fixed_ratio_resolution_n", "shunted_fraction"]
    numbers += [
        "proximal_pressure_pa",
        "distal_pressure_pa",
        "condition_number",
        "least_snr",
        "adc_headroom",
        "led_power_mw",
    ]
    numbers += ["share_resolution", "share_resolution_stderr"]
    row = dict.fromkeys(numbers, 1.0) | {"layout": name, "rank": 1, "tied": False, "photodiodes": 8}
    assert_text_alone(html.table(placement._ranking_rows([row])), name)
    person = {"value": 1.0, "stderr": 0.1, "prior": name, "informed": True, "what": name}
    assert_text_alone(html.table(force._factors({"parameters": {name: person}})), name)
    result = xr.Dataset(
        {"spo2_stderr_by_cause": (("photodiode", "cause"), np.ones((1, 1)))}
        | {"volts": (("led", "photodiode", "beat_time"), np.ones((1, 1, 2)))}
        | {key: ("photodiode", np.ones(1)) for key in ("spo2_stderr", "spo2_stderr_beat", "spo2_simulation_stderr")},
        coords={"led": [name], "photodiode": [name], "cause": [name]},
    )
    assert_text_alone(html.table(oximeter._errors(result)), name)
    bias = SimpleNamespace(value=1.0, stderr=0.1, bound=1.0)
    level = SimpleNamespace(name=name, reading=bias, signal=bias, seconds=lambda tolerance: 1.0)
    computed = SimpleNamespace(levels=[level], chosen=level, tolerance=0.02)
    assert_text_alone(html.table(tradeoff._rows(computed)), name)


@pytest.mark.parametrize("name", ["".join(HOSTILE)], ids=["all"])
def test_hostile_names_are_text_on_the_page_of_a_calibration(name, monkeypatch):
    over = ("reading", "sample")
    volts = 1.0 + np.linspace(0.0, 1e-3, 8)[None]
    data = {"volts": (over, volts), "volts_fitted": (over, volts), "time_s": ("sample", np.arange(8.0))}
    data["recording"] = ("sample", np.array([name] * 8))
    # A scene takes no such names.
    scene = to_toml(load_scene(data_dir("scenes") / "prototype.toml"))
    about = {"recordings": [name], "scene": scene}
    result = xr.Dataset(data, {"reading": [name]}, about)
    numbers = ("gain", "gain_stderr", "offset_v", "offset_stderr_v", "residual_rms_v", "noise_v")
    factor = {"value": 1.0, "stderr": 0.1, "prior": name, "informed": True, "what": name}
    scores = dict.fromkeys(("rms_n", "relative_error", "coverage_95", "half_width_n"), 0.1)
    summary = {"rms_n": 0.1, "chi2_per_dof": 1.0, "half_width_n": 0.2, "is_held_out": True, "warnings": [name]}
    summary["coverage_95"] = 0.9
    summary |= {"quality": {name: scores}}
    summary |= {"parameters": {name: factor}, "readings": {name: dict.fromkeys(numbers, 1.0)}}
    monkeypatch.setattr(force, "calibration_summary", lambda _: summary)
    assert_text_alone(force.calibration_page(result), name)


def hostile_prediction(name, monkeypatch) -> str:
    """The page of a prediction in which everything is called so."""
    numbers = ["force_n", "force_low_n", "force_high_n", "known_force_n", "normalized_innovation_squared"]
    numbers += ["proximal_share", "proximal_share_low", "proximal_share_high", "arterial_change_pa"]
    numbers += ["probability_proximal", "probability_distal", "probability_both"]
    data = {one: ("time", np.linspace(0.1, 1.0, 8)) for one in numbers} | {"outlier": ("time", np.zeros(8, bool))}
    for method in ("filter", "cubic"):
        data[f"force_{method}_n"] = "time", np.linspace(0.1, 1.0, 8), {"long_name": name}
    result = xr.Dataset(data, {"time": np.arange(8.0)}, {"scene": name, "scene_digest": name})
    summary = {"warnings": [name], "consistent": False, "misfit": name, "open_above_n": 1.0, "rms_n": 0.1}
    scores = dict.fromkeys(("rms_n", "relative_error", "coverage_95", "half_width_n"), 0.1)
    summary |= {"coverage_95": 0.9, "touch_rms_n": 0.1, "touches": {name: scores}}
    summary |= {"baseline_rms_n": {"filter": 0.1, "cubic": 0.1}}
    summary |= {"events": [{"kind": name, "time_s": 1.0, "latency_s": 0.1}]}
    monkeypatch.setattr(force, "prediction_summary", lambda _: summary)
    return force.prediction_page(result)


def hostile_sweep(name) -> str:
    """The page of a sweep in which everything is called so."""
    shape, dims, about = (2, 1, 1), ("base", "led", "photodiode"), {"long_name": name, "units": "V"}
    data = {f"volts_start{end}": (dims, np.ones(shape), about) for end in ("", "_stderr")}
    coords = {"base": ("base", [name, f"{name}1"], {"long_name": name}), "led": [name], "photodiode": [name]}
    attrs = {"title": f"nailoptics: {name}", "versions": name, "seed": name, "backend": name}
    return sweep.page(
        xr.Dataset(data | {"state": ("base", [name, "done"])}, coords, attrs), failures={name: "".join(HOSTILE)}
    )


@pytest.mark.parametrize("name", ["".join(HOSTILE)], ids=["all"])
def test_hostile_names_are_text_on_the_page_of_a_prediction(name, monkeypatch):
    assert_text_alone(hostile_prediction(name, monkeypatch), name)

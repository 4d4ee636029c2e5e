"""The page and the table of a sweep: names that attack a browser or a spreadsheet are text."""

import csv
from html.parser import HTMLParser
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from nailoptics.batch import write_table
from nailoptics.report import style
from nailoptics.report.pages.sweep import page

HOSTILE = ['"><script>alert(1)</script>$a_b^{c$ & <b>', '"><img src=x onerror=y>', '"></title><svg onload=z>']
FORMULAS = ["=cmd|' /C calc'!A0", "+1+1", "-2+3", "@SUM(A1)", "\t=1", "plain"]


class Tags(HTMLParser):
    """Every tag of a page, and every attribute that runs something."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found |= {tag, *(name for name, _ in attrs if name.startswith("on"))}


def results(names: list[str], *, axis: str = "base") -> xr.Dataset:
    """What `open_results` returns of a sweep over texts."""
    shape, dims = (len(names), 1, 1), (axis, "led", "photodiode")
    about = {"long_name": f"voltage {names[0]}", "units": "V"}
    return xr.Dataset(
        {
            "volts_start": (dims, np.arange(1.0, len(names) + 1).reshape(shape), about),
            "volts_start_stderr": (dims, np.full(shape, 0.1), about),
            "state": ((axis,), np.array([names[0]] + ["done"] * (len(names) - 1))),
        },
        coords={axis: (axis, names, {"long_name": names[0]}), "led": [names[0]], "photodiode": [names[-1]]},
        attrs={"title": f"nailoptics: batch {names[0]}", "seed": 1, "versions": names[0], "backend": names[1]},
    )


def test_names_failures_and_titles_are_text_on_the_page():
    text = page(results(HOSTILE), failures=dict(zip(HOSTILE, HOSTILE, strict=True)))
    assert not Tags(text).found & {"script", "img", "onerror", "onload"}
    assert "&lt;script&gt;alert(1)" in text and "&quot;&gt;&lt;img" in text


@pytest.mark.parametrize(
    ("axis", "place", "values", "label"),
    [
        ("clear_epoxy_um", "board.clear_epoxy_um", [200.0, 400.0], "board.clear_epoxy_um [µm]"),
        ("led_position", "leds.ir.position_mm", ["[-1, 0]", "[-2, 1]"], "leds.ir.position_mm [mm]"),
        ("parameters", "blood.parameters", ["best", "listed"], "blood.parameters"),
    ],
)
def test_an_axis_is_named_once_with_its_unit(monkeypatch, axis, place, values, label):
    units = {"units": "µm"} if axis == "clear_epoxy_um" else {}
    sweep = results(["a", "b"], axis=axis).assign_coords({axis: (axis, values, {"long_name": place} | units)})
    drawn: list[Any] = []
    monkeypatch.setattr(style, "to_svg", lambda figure, **_: drawn.append(figure) or "<svg></svg>")
    page(sweep, failures={})
    assert drawn[0].axes[0].get_xlabel() == label


def test_the_axes_of_a_figure_have_names_and_units(monkeypatch):
    names = ["a", "b", "c"]
    sweep = results(names).assign_coords(base=("base", [0.0, 0.5, 1.0], {"long_name": "touch.force_n", "units": "N"}))
    sweep.volts_start.attrs["long_name"] = "voltage at rest"
    drawn: list[Any] = []
    monkeypatch.setattr(style, "to_svg", lambda figure, **_: drawn.append(figure) or "<svg></svg>")
    text = page(sweep, failures={})
    for head in ("Axis", "Place in the scene", "Values", "From, to"):
        assert f"<th>{head}</th>" in text
    (axes,) = drawn[0].axes
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("touch.force_n [N]", "voltage at rest [V]")


def test_an_oximeters_quantity_is_drawn_by_photodiode(monkeypatch):
    """Its R is of both LEDs; a photodiode of other scenes alone has no line."""
    of = {"units": "1", "long_name": "R at the scene's saturation"}
    value = (("so2", "flux_mw", "photodiode"), np.linspace(0.4, 0.9, 12).reshape(2, 3, 2), of)
    coords = {"so2": [0.8, 0.9], "flux_mw": [1.0, 2.0, 3.0], "photodiode": ["a", "b"]}
    data = {"ratio_at_rest": value, "ratio_at_rest_stderr": value, "state": (("so2", "flux_mw"), [["done"] * 3] * 2)}
    drawn: list[Any] = []
    monkeypatch.setattr(style, "to_svg", lambda figure, **_: drawn.append(figure) or "<svg></svg>")
    page(xr.Dataset(data, coords, {"title": "nailoptics: batch x"}).reindex(photodiode=["a", "other", "b"]))
    first, second = (one.axes[0] for one in drawn)
    assert [text.get_text() for text in first.get_legend().get_texts()] == ["a", "b"]
    assert [*first.containers[1][0].get_ydata()] == pytest.approx(value[1][:, 1, 1])
    assert [*second.containers[0][0].get_ydata()] == pytest.approx(value[1][1, :, 0])
    assert second.get_ylabel() == "R at the scene's saturation [1]"


def test_resistors_that_were_fitted_scene_by_scene_are_named():
    """Expected: where they differ, unless the sweep itself sets them."""
    words = "each fitted to the light of its own"
    for place, ohm, shown in (
        ("leds.ir.flux_mw", [1e3, 2e3], True),
        ("leds.ir.flux_mw", [1e3, 1e3], False),
        ("electronics.feedback_ohm", [1e3, 2e3], False),
    ):
        sweep = results(["a", "b"], axis="scene").assign_coords(scene=("scene", [1.0, 2.0], {"long_name": place}))
        sweep["feedback_ohm"] = ("scene", "photodiode"), np.reshape(ohm, (2, 1))
        assert (words in page(sweep)) is shown


@pytest.mark.parametrize("axis", ["base", "=1+1"])
def test_no_cell_of_the_table_is_a_formula(tmp_path: Path, axis):
    write_table(results(FORMULAS, axis=axis), tmp_path / "t.csv")
    head, *rows = csv.reader(StringIO((tmp_path / "t.csv").read_text(), newline=""))
    cells = [cell for row in rows for cell in row]
    assert len(rows) == len(FORMULAS) and not any(cell[:1] in ("=", "+", "@", "\t") for cell in [*head, *cells])
    assert [row[0].removeprefix("'") for row in rows] == FORMULAS
    # Numbers stay numbers.
    column = head.index("volts_start")
    assert [float(row[column]) for row in rows] == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]

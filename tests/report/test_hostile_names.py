"""Names that attack a browser are text in every part that pages are made of, in drawings, too."""

from html.parser import HTMLParser
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure

from nailoptics.report import force_pages, html, oximeter_page, place_page, tradeoff_page

HOSTILE = [
    "<script>alert(1)</script>$a_b^{c$ & <b>",
    '"><img src=x onerror=y>',
    "</title></svg><svg onload=z>",
    "'><i>",
]


class Tags(HTMLParser):
    """Every tag of a page, and every attribute that runs something."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[str] = []
        self.said = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found += [tag, *(name for name, _ in attrs if name.startswith("on"))]

    def handle_data(self, data: str) -> None:
        self.said += data


def assert_text_alone(text: str, name: str) -> None:
    """The name is read on the page, and made nothing of it a tag."""
    page = Tags(text)
    assert not set(page.found) & {"script", "img", "i", "onerror", "onload"}, page.found
    assert name in page.said


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
    assert_text_alone(html.table(["head"], [["cell"], ["other"]], groups=[name, "another"]), name)


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
    text = html.figure(drawing, "drawing", name)
    assert_text_alone(text, name)
    assert Tags(text).found.count("svg") == 1


@pytest.mark.parametrize("name", HOSTILE)
def test_tables_of_layouts_persons_and_readings_show_a_name_as_text(name):
    numbers = ["force_resolution_n", "force_resolution_n_stderr", "fixed_ratio_resolution_n", "shunted_fraction"]
    numbers += ["proximal_pressure_pa", "distal_pressure_pa", "condition_number", "least_snr", "adc_headroom"]
    row = dict.fromkeys(numbers, 1.0) | {"layout": name, "rank": 1, "tied": False}
    # An underscore in a layout's name is a space on the page.
    assert_text_alone(place_page._table([row]), name.replace("_", " "))
    person = {"value": 1.0, "stderr": 0.1, "prior": name, "informed": True, "what": name}
    assert_text_alone(force_pages._factors_table({"parameters": {name: person}}), name)
    result = xr.Dataset(
        {"spo2_stderr_by_cause": (("photodiode", "cause"), np.ones((1, 1)))}
        | {key: ("photodiode", np.ones(1)) for key in ("spo2_stderr", "spo2_stderr_beat")},
        coords={"photodiode": [name], "cause": [name]},
    )
    assert_text_alone(oximeter_page._errors(result), name)
    level = SimpleNamespace(name=name, beforehand=name, lines=(name,), call=name)
    found = SimpleNamespace(levels=[level])
    assert_text_alone(tradeoff_page._needs(found), name)

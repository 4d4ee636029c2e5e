"""The page: it shows what the result holds, needs nothing else, and handles any names and gaps of a result."""

import os
import re
from functools import partial
from html.parser import HTMLParser
from importlib import import_module
from itertools import combinations

import numpy as np
import pytest
import xarray as xr
from matplotlib.backends.backend_agg import FigureCanvasAgg
from small_scenes import finger

from nailoptics.assets import data_dir
from nailoptics.errors import InputError
from nailoptics.report import maps, style
from nailoptics.report.pages.simulate import SIMULATION, courses, overview, page
from nailoptics.scene import parse_scene, to_toml

VOID = {"meta", "br"}


class Page(HTMLParser):
    """Tables by the first class as rows of texts, all tags with their attributes, and whether tags nest."""

    def __init__(self, text):
        super().__init__()
        self.tables, self.tags, self.open, self.rows, self.in_svg, self.visible_text = {}, [], [], None, 0, ""
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attrs):
        attrs = dict(attrs)
        self.tags.append((tag, attrs))
        if tag not in VOID:
            self.open.append(tag)
        if tag == "table":
            self.rows = self.tables[attrs["class"].split()[0]] = []
        elif tag == "tr" and self.rows is not None:
            self.rows.append([])

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag
        if tag == "table":
            self.rows = None

    def handle_data(self, data):
        self.visible_text += data
        if self.rows and data.strip():
            self.rows[-1].append(data.strip())


def body_rows(table):
    """Rows without the head and without headings of groups."""
    return [row for row in table[1:] if len(row) > 1]


def number(text):
    """The number of a cell, without its standard error."""
    return float(text.split(" ± ")[0].replace("−", "-"))


@pytest.mark.parametrize("leds", [1, 2])
def test_the_page_holds_every_reading_with_the_numbers_of_the_result(undrawn, make, leds):
    result = make(leds=leds)
    rows = body_rows(Page(page(result)).tables["readings"])
    assert len(rows) == 8 * leds
    hold = int(np.flatnonzero(result.force_n.values > 0)[-1])
    change = result.volts.values[..., hold] - result.volts.values[..., 0]
    for (name, zone, *cells), (i, j) in zip(rows, np.ndindex(leds, 8), strict=True):
        assert name == result.photodiode.values[j] and zone == result.zone.values[j // 4]
        distance, rest, moved, percent, z_score, largest, noise, ratio, nef = map(number, cells)
        swings = result.volts_change.values[i, j]
        near = partial(pytest.approx, rel=0.02)
        assert largest == near(1e3 * swings[abs(swings).argmax()])
        assert rest == near(result.volts.values[i, j, 0]) and moved == near(1e3 * change[i, j])
        assert percent == near(100 * change[i, j] / result.volts.values[i, j, 0])
        assert z_score == near(50) and noise == near(22)  # the error is made 2 % of the change
        assert ratio == near(abs(change[i, j]) / 2.2e-5)
        assert nef == near(1e3 * 2.2e-5 / abs(change[i, j]))  # noise over the slope, after 1 N
        if i == 0 and j == 0:
            assert distance == near(np.hypot(1.2, 2.375))  # the LED at (-1.2, 0), element 6 of 16 at -2
    shown = [text for text in rows[0] if "±" in text]
    assert len(shown) == 2 and re.fullmatch(r"−?[\d.]+ ± [\d.]+", shown[0])


def test_the_fits_and_paths_are_those_of_the_result(undrawn, make):
    result = make(leds=2, section=False)
    tables = Page(page(result)).tables
    for (_, *cells), (i, j) in zip(body_rows(tables["paths"]), np.ndindex(2, 8), strict=True):
        assert [number(cell) for cell in cells] == pytest.approx(result.mean_path_mm.values[i, j].tolist(), abs=0.006)
    for (_, *cells), (i, j) in zip(body_rows(tables["fits"]), np.ndindex(2, 8), strict=True):
        assert number(cells[0]) == pytest.approx(1e3 * float(result.beer_lambert_v0_v[i, j]), rel=0.02)
        assert number(cells[5]) == pytest.approx(1e-6 * float(result.taylor_v1_v_per_m2[i, j]), rel=0.02)


def test_the_page_needs_nothing_from_outside(make):
    text = page(make(leds=2))
    assert "http:" not in text and "https:" not in text and "@import" not in text and "<script" not in text
    assert "Content-Security-Policy\" content=\"default-src 'none'; script-src 'none';" in text
    ids = set()
    for tag, attrs in Page(text).tags:
        assert tag not in ("link", "script", "iframe", "object")
        if "id" in attrs:
            ids.add(attrs["id"])
        for name in ("src", "href"):
            assert attrs.get(name, "#").startswith(("#", "data:image/"))
    for target in re.findall(r'(?:href="#|url\(#)([^")]+)', text):
        assert target in ids


def test_names_and_notes_are_text_wherever_they_are_shown(make):
    hostile = '<script>alert(1)</script>$a_b^{c$ & <b>"><img src=x onerror=y>'
    result = make(leds=2, section=False)
    result = result.assign_coords(photodiode=[f"{hostile}{i}" for i in range(8)], led=[hostile, f"{hostile}1"])
    result["fit_note"] = (("led", "photodiode"), np.full((2, 8), hostile))
    result.attrs.update(accuracy_reached=hostile, versions=hostile, seeds=hostile)
    result.attrs["scene"] += f"# {hostile}\n"
    shown = Page(page(result))
    assert not {tag for tag, _ in shown.tags} & {"script", "img"}
    assert not any(name.startswith("on") for _, attributes in shown.tags for name in attributes)
    assert [row[0] for row in shown.tables["readings"][1:3]] == [f"LED {hostile}", f"{hostile}0"]


@pytest.mark.parametrize(
    "left_out",
    [["path_density"], ["path_density", "section_region"]],
)
def test_what_was_not_computed_is_left_out(undrawn, make, left_out):
    text = page(make().drop_vars(left_out))
    assert len(body_rows(Page(text).tables["readings"])) == 8
    assert ("was not computed" in text) == ("section_region" in left_out)


def test_equations_have_their_names(make):
    text = Page(page(make(section=False)))
    named = re.findall(r"(.{14})\((?:8|9)\)", text.visible_text)
    assert len(named) > 4 and all(one.endswith(("Beer–Lambert ", "Taylor ")) for one in named), named
    assert "docs/glossary.md" in text.visible_text


def test_a_touch_that_changes_nothing_has_no_constants_of_rounding(undrawn, make):
    result = make(swing=0.0, section=False)
    for name in ("taylor_v1_v_per_m2", "taylor_residual_rms_v"):
        result[name] = result[name] * 0 + 5.09e-14 * (1e11 if name.endswith("m2") else 1)
    result["taylor_v1_v_per_m2_stderr"] = result.taylor_v1_v_per_m2 * np.inf
    result["taylor_v0_v_stderr"] = result.taylor_v0_v * 1e-15
    for texts in body_rows(Page(page(result)).tables["fits"]):
        assert texts[-2:] == ["0", "0"] and "±" not in texts[-3]


@pytest.mark.long
def test_one_moment_and_readings_that_do_not_change(make):
    for result in (make(times=1), make(swing=0.0, section=False)):
        text = page(result)
        assert "No reading changes" in text and "nan" not in Page(text).tables["readings"][1]
        assert len(body_rows(Page(text).tables["readings"])) == 8


def test_readings_that_are_nothing_at_all(make):
    result = make()
    for name in ("volts", "volts_stderr", "volts_change", "volts_change_stderr", "volts_noise_rms", "volts_taylor"):
        result[name] = result[name] * 0
    result["mean_path_mm"] = result.mean_path_mm * np.nan  # as from an engine that keeps no paths
    parsed = Page(page(result))
    assert "paths" not in parsed.tables and len(parsed.tables["readings"]) == 9


def test_saturation_is_reported_at_the_top(undrawn, make):
    result = make(section=False)
    result.saturated[0, 2, 5] = True
    text = page(result)
    assert text.index("at its limit: proximal.12 under ir") < text.index("<h2>")


def test_a_saturated_reading_is_no_key_figure_and_shows_only_its_limit(undrawn, make):
    result = make(section=False)
    largest = int(abs(result.volts_change.values[0]).max(axis=-1).argmax())
    name = str(result.photodiode.values[largest])
    before = page(result)
    result.saturated[0, largest, 5] = True
    result.fit_note[0, largest] = "a note"
    text = page(result)
    assert "a note" not in text
    assert f"largest fall: {name}," in before or f"largest rise: {name}," in before
    assert f"largest fall: {name}," not in text and f"largest rise: {name}," not in text
    tables = Page(text).tables
    (row,) = [row for row in tables["readings"] if row[0] == f"{name} saturated"]
    assert row.count("–") == 7 and len(row) == 11
    (row,) = [row for row in tables["fits"] if row[0] == f"{name} saturated"]
    assert row[1:] == ["–"] * 7


def test_a_fit_that_is_straight_is_shown_as_straight(undrawn, make):
    result = make(section=False)
    largest_m2 = float(result.capillary_diameter_m.max()) ** 2
    result["beer_lambert_alpha_per_m2"][0, 3] = 1e-4 / largest_m2
    result["beer_lambert_v0_v"][0, 3] = -79000.0
    for constant in ("v0_v", "v1_v", "alpha_per_m2"):
        result[f"beer_lambert_{constant}_stderr"][0, 3] = np.inf
    texts = body_rows(Page(page(result)).tables["fits"])[3]
    assert texts.count("straight") == 3
    assert not any("79000" in text or "?" in text for text in texts[1:4])


def test_a_fit_of_unresolved_curvature_is_left_blank_and_its_note_names_the_led(undrawn, make):
    result = make(leds=2, section=False)
    result["fit_note"] = result.fit_note.astype("U80")
    name = str(result.photodiode.values[3])
    for constant in ("v0_v", "v1_v", "alpha_per_m2"):
        result[f"beer_lambert_{constant}"][1, 3] = np.nan
    result.fit_note[1, 3] = "alpha differs from 0 by less than its standard error"
    shown = page(result)
    assert [row for table in Page(shown).tables.values() for row in table if row.count("not known") == 3]
    assert f"{name} under led1: alpha differs from 0" in shown


def test_signs_that_differ_are_named_with_their_led(undrawn, make):
    result = make(leds=2, section=False)
    result["volts_change"][1, 0] *= -1
    assert f"; not {result.photodiode.values[0]} under led1" in page(result)


def test_photodiodes_have_the_colour_of_their_place_whatever_their_order():
    scene = parse_scene((data_dir("scenes") / "prototype.toml").read_text(encoding="utf-8"))
    turned = scene.with_(photodiodes=scene.photodiodes[::-1])
    colours, others = (maps.colours_of(xr.Dataset(attrs={"scene": to_toml(one)})) for one in (scene, turned))
    assert colours == style.place_colours(8) and others == colours[4:] + colours[:4]


def test_a_truncated_result_reports_it_in_its_first_lines(undrawn, make):
    assert "Cut off" not in page(make(section=False))
    text = page(make(section=False).assign_attrs(cut_off="7 % instead of 1 % after 3 s."))
    assert text.index("Cut off: 7 % instead of 1 % after 3 s.") < text.index("<h2>")


def test_signs_are_evaluated_by_the_place_of_a_zone_whatever_its_name(undrawn, make):
    result = make(section=False).assign_coords(zone=["zone_1", "zone_2"])
    result["white_band_mm"] = ("time", np.where(result.force_n > 0, 2.34, 0.0))
    text = page(result)
    assert "<b>8 of 8</b>" in text and "<b>2.3\u00a0mm</b>" in text
    result.volts_change[0, 0] *= -1
    assert "<b>7 of 8</b>" in page(result)


def test_signs_are_no_key_figure_of_a_board_over_one_half_or_that_follows_none(undrawn, make):
    result, words = make(section=False), "readings of this finger change as in the paper"
    assert words in page(result)
    of_one_half = result.copy()
    of_one_half["zone_of_photodiode"] = 0 * result.zone_of_photodiode
    result.volts_change.values *= -1
    assert words not in page(of_one_half) and words not in page(result)


def test_colours_of_distal_photodiodes_are_cool_however_few_they_are():
    of_eight = style.place_colours(8)
    assert style.place_colours(8, 4) == of_eight
    assert style.place_colours(1, 1) == of_eight[-1:] and style.place_colours(1, 0) == of_eight[:1]
    assert style.place_colours(3, 3)[-1] == of_eight[-1] and style.place_colours(3, 0)[0] == of_eight[0]
    assert style.place_colours(5, 4) == [of_eight[0], *of_eight[4:]]


@pytest.mark.parametrize("name", ["a", "photodiode_number_12"])
@pytest.mark.parametrize("width_mm", [4.0, 11.3])
def test_names_of_parts_stand_within_the_drawing_of_the_board(name, width_mm):
    scene = parse_scene(
        f"schema_version = 1\n[finger]\n[board]\nbarrier = false\nsize_mm = [{width_mm}, 8.0]\n"
        f'[[leds]]\nname = "{name}"\npart = "led_800"\nposition_mm = [1.2, 0.0]\n'
        f'[[photodiodes]]\nname = "{name}"\nposition_mm = [-1.0, 0.1]\n'
    )
    figure = maps.top_view.__wrapped__(scene)
    FigureCanvasAgg(figure).draw()
    (axes,) = figure.axes
    frame = axes.get_window_extent()
    boxes = {text.get_text(): text.get_window_extent() for text in axes.texts}
    assert len(boxes) == 4
    assert all(frame.x0 < box.x0 and box.x1 < frame.x1 for box in boxes.values())
    # The line to either name runs off to the side where no other part lies.
    middle = (frame.x0 + frame.x1) / 2
    assert boxes[name].x1 < middle < boxes[f"LED {name}, 800 nm"].x0


def test_a_board_that_is_no_rectangle_is_drawn_as_it_is():
    corners = [[-4.0, -4.5], [1.8, -4.5], [1.8, -0.2], [4.0, 1.0], [4.0, 4.5], [-4.0, 4.5]]
    hole = [[-3.2, 2.4], [-2.2, 2.4], [-2.2, 3.4], [-3.2, 3.4]]
    scene = parse_scene(
        f"schema_version = 1\n[finger]\n[board]\nbarrier = false\noutline_mm = {corners}\noutline_holes_mm = [{hole}]\n"
        '[[leds]]\nname = "ir"\npart = "led_800"\nposition_mm = [1.0, 2.0]\n'
        '[[photodiodes]]\nname = "pd"\nposition_mm = [-1.0, 0.0]\n'
    )
    drawn = [patch.get_xy()[:-1].tolist() for patch in maps.top_view.__wrapped__(scene).axes[0].patches]
    assert corners in drawn and hole in drawn


def test_the_board_fits_a_telephone_and_its_names_do_not_touch():
    """Expected: 0.79 of its natural width within the 350 pixels of a telephone's page, as the style sheet scales it;
    one name above another, however near two parts lie, and no line of one drawn over a part."""
    leds = [("U1.ir", -3.8, 4.0), ("U1.red", -3.8, 3.6), ("U1.green", -3.8, 3.2)]
    text = "schema_version = 1\n[finger]\n[board]\nbarrier = false\n"
    text += "".join(f'[[leds]]\nname = "{n}"\npart = "led_660"\nposition_mm = [{u}, {v}]\n' for n, u, v in leds)
    for i, (u, v) in enumerate([(1.0, 4.0), (2.5, 3.9), (4.0, 4.1), (1.0, 1.4)]):
        text += f'[[photodiodes]]\nname = "pd{i}"\nposition_mm = [{u}, {v}]\n'
    figure = maps.top_view.__wrapped__(parse_scene(text))
    FigureCanvasAgg(figure).draw()
    assert 0.79 * 96 * figure.get_figwidth() <= 350
    (axes,) = figure.axes
    boxes = [one.get_window_extent() for one in axes.texts if "blood" not in one.get_text()]
    assert len(boxes) == 7 and not any(a.overlaps(b) for a, b in combinations(boxes, 2))
    names = [line for line in axes.lines if len(line.get_xdata()) == 3]
    assert len(names) == 7 and max(line.zorder for line in names) < min(p.zorder for p in axes.patches[-7:])


@pytest.mark.parametrize(("elements", "named"), [(32, 64), (33, 0)])
def test_names_of_more_photodiodes_than_could_be_read_are_left_out(elements, named):
    columns = [
        {"name": n, "elements": elements, "size_mm": [0.2, 0.2], "position_mm": [u, 0.0]}
        for n, u in (("a", 0.0), ("b", 1.0))
    ]
    (axes,) = maps.top_view.__wrapped__(parse_scene(finger(*columns, leds=({"position_mm": [-2.0, 0.0]},)))).axes
    names = [text.get_text() for text in axes.texts]
    assert sum(name[:2] in ("a.", "b.") for name in names) == named and "LED ir, 800 nm" in names


def test_the_energy_budget_is_shown_where_it_is_available(undrawn, make):
    result = make(leds=2, section=False)
    assert "Where the light of each LED ends" not in page(result)
    energy, absorbed = {"reflected": 0.1, "transmitted": 0.02, "absorbed": 0.88, "lost": 0.0}, [0.5, 0.3799, 0.00009]
    for name, axis, values in (("energy", "part", [*energy.values()]), ("absorbed", "region", absorbed)):
        result[f"{name}_fraction"] = (("led", axis), np.array([values, values]))
        result[f"{name}_fraction_stderr"] = (("led", axis), np.full((2, len(values)), 1e-3))
    result = result.assign_coords(part=list(energy), region=["bed", "barrier", "bone"])
    ends = page(result)
    _, *rows = Page(ends).tables["ends"]
    assert "Where the light of each LED ends" in ends
    assert rows[:3] == [
        ["bed", "50.00 ± 0.10", "50.00 ± 0.10"],
        ["barrier, opaque epoxy", "37.99 ± 0.10", "37.99 ± 0.10"],
        ["leaves to the air", "10.00 ± 0.10", "10.00 ± 0.10"],
    ]
    assert len(rows) == 4


def test_a_result_whose_scene_cannot_be_read_reports_it(undrawn, make):
    with pytest.raises(InputError, match="the result's scene"):
        page(make(section=False).assign_attrs(scene="not [a scene"))


def test_a_page_that_cannot_be_written_leaves_the_old_one(undrawn, make, tmp_path, monkeypatch):
    result, path = make(section=False), tmp_path / "report.html"
    path.write_text("old", encoding="utf-8")
    replace = os.replace

    def refuse(source, target):
        if target == path:
            raise OSError(28, "No space left on device")
        replace(source, target)

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(InputError, match="No space left"):
        SIMULATION.write(result, tmp_path)
    assert path.read_text(encoding="utf-8") == "old" and sorted(os.listdir(tmp_path)) == ["report.html", "result.nc"]


def test_names_of_courses_lie_on_no_curve(make):
    """Touches that fill every panel from its left to its right, where no place among the curves is free."""
    result = make(section=False)
    swing = np.abs((np.arange(result.sizes["time"]) / 7) % 2 - 1)
    full = {n: (result[n].dims, result[n].values * 0 + swing) for n in ("blood_fraction", "capillary_diameter_m")}
    drawn = courses(result.assign(full))
    FigureCanvasAgg(drawn).draw()
    boxes = [(axes, axes.get_legend().get_window_extent()) for axes in drawn.axes if axes.get_legend()]
    assert len(boxes) >= 2
    for axes, box in boxes:
        for line in axes.get_lines():
            assert not line.get_path().transformed(axes.transData).intersects_bbox(box, filled=False)


def test_names_of_many_photodiodes_leave_room_for_their_curves(make, monkeypatch):
    result = make(section=False)
    scene = parse_scene(result.attrs["scene"])
    assert overview(result, scene).axes[0].get_legend()
    monkeypatch.setattr(import_module("nailoptics.report.pages.simulate"), "PANELS", 1)
    assert not overview(result, scene).axes[0].get_legend()


def test_on_a_telephone_what_is_wider_scrolls_within_its_box_and_shows_that(browser, make):
    """Expected: the page is as wide as the screen; what is wider lies in a box of its own, with a shade at its edge."""
    view = browser.new_context(viewport={"width": 390, "height": 800}, is_mobile=True).new_page()
    view.set_content(page(make()))
    assert view.evaluate("document.documentElement.scrollWidth") == 390
    boxes = view.evaluate("""[...document.querySelectorAll('.scroll')].map(box => [
        box.scrollWidth > box.clientWidth, getComputedStyle(box).backgroundAttachment,
        box.getBoundingClientRect().right])""")
    assert any(wider for wider, *_ in boxes) and all(right <= 390 for *_, right in boxes)
    assert all("local" in shades and "scroll" in shades for wider, shades, _ in boxes if wider)
    outside = "[...document.querySelectorAll('main *')].filter(one => one.getBoundingClientRect().right > 390.5"
    assert view.evaluate(f"{outside} && !one.closest('.scroll, pre')).length") == 0
    view.context.close()

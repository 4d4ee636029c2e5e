"""The page of `explore` in a real browser: its numbers are Python's, and a hand can use it."""

import math
import re
from base64 import b64decode
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_exploration import made_exploration
from PIL import Image
from scipy.interpolate import RegularGridInterpolator
from small_scenes import finger

from nailoptics import export, load_scene
from nailoptics.assets import data_dir
from nailoptics.errors import InputError
from nailoptics.hemodynamics.for_scene import steady_blood
from nailoptics.io import FORMULA
from nailoptics.report.pages.explore import MOST_POINTS, _readout, page
from nailoptics.scene import Scene, to_toml
from nailoptics.scene.files import parse_scene
from nailoptics.scene.importers.kicad import read_board
from nailoptics.scene.importers.positions import read_positions
from nailoptics.sensor import electronics
from nailoptics.sensor.information import Response, force_resolution_n, operating_point, total_information
from nailoptics.statistics import jackknife
from nailoptics.studies.exploration.explore import KERNEL_ERROR, Exploration, blood_polynomial
from nailoptics.studies.exploration.pair_table import BloodPolynomial
from nailoptics.studies.placement.result import kicad_parts

KICAD = Path(__file__).parents[1] / "scene" / "of_kicad"


def explored_scene(name: str) -> Scene:
    """With a wall, without a body; and with a body and a contact that grows, whose board has no wall here."""
    scene = load_scene(data_dir("scenes") / f"{name}.toml")
    if name == "placement":
        # As from a board's file, with its references.
        parts = {
            kind: tuple(p.model_copy(update={"reference": f"{ref}{i}"}) for i, p in enumerate(getattr(scene, kind), 7))
            for kind, ref in (("leds", "D"), ("photodiodes", "U"))
        }
        board = scene.board.model_copy(update={"barrier": False})
        touch = scene.touch.model_copy(update={"contact_force_n": 2.0})
        scene = scene.model_copy(update={"board": board, "touch": touch} | parts)
    return scene


@pytest.fixture(scope="module", params=["prototype", "placement"])
def explored(request: pytest.FixtureRequest) -> Exploration:
    return made_exploration(explored_scene(request.param))


# For what does not depend on the scene that the page opens with.
on_one_page = pytest.mark.parametrize("explored", ["prototype"], indirect=True)


@pytest.fixture(scope="module")
def file(explored: Exploration, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("explore") / "explore.html"
    path.write_text(page(explored), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def tab(browser: Any) -> Iterator[Any]:
    """One tab for all tests that reload the page: a tab of its own would cost each as much as the page itself."""
    context = browser.new_context(viewport={"width": 1200, "height": 900})
    yield context.new_page()
    context.close()


@contextmanager
def heard(tab: Any, file: Path) -> Iterator[None]:
    """The page must log no error meanwhile, and must load no other file and call no server."""
    complaints, requested = [], []
    hear = {
        "pageerror": lambda error: complaints.append(str(error)),
        "console": lambda message: complaints.append(message.text) if message.type == "error" else None,
        "request": lambda request: requested.append(request.url),
    }
    for event, note in hear.items():
        tab.on(event, note)
    yield
    assert complaints == []
    assert {url for url in requested if not url.startswith("blob:")} <= {file.as_uri()}
    for event, note in hear.items():
        tab.remove_listener(event, note)


def open_page(tab: Any, file: Path) -> None:
    """The page as it opens; it is reloaded unless it was left so."""
    if tab.url.split("#")[0] != file.as_uri() or not tab.evaluate("window.isUnchanged"):
        tab.goto(file.as_uri())
    tab.evaluate("say(''); window.isUnchanged = false")


@pytest.fixture
def shown(tab: Any, file: Path) -> Iterator[Any]:
    """The page as it opens."""
    with heard(tab, file):
        open_page(tab, file)
        yield tab


@pytest.fixture
def unchanged(tab: Any, file: Path) -> Iterator[Any]:
    """The page as it opens, for tests that leave its layout as it is, of which the next need not reload it."""
    with heard(tab, file):
        open_page(tab, file)
        opened = tab.evaluate("workbench.layout")
        yield tab
        assert tab.evaluate("workbench.layout") == opened
        tab.evaluate("window.isUnchanged = true")


@pytest.mark.parametrize("name", ["prototype", "placement"])
def test_the_page_is_one_file_of_at_most_five_megabytes(name: str):
    """With all nodes of its table. That it loads no other file is checked whenever it is shown."""
    assert len(page(made_exploration(explored_scene(name), every=1)).encode()) < 5e6


def rows(shown: Any) -> list[dict[str, Any]]:
    return shown.evaluate("JSON.parse(JSON.stringify(workbench.result.rows))")


def half(values: np.ndarray) -> np.ndarray:
    """Numbers as they are in half precision."""
    return values.astype(np.float16).astype(float)


def reading(
    explored: Exploration,
    kernel: np.ndarray,
    polynomial: BloodPolynomial,
    die: Any,
    area: Any,
    state: list[float],
    points: int = 0,
) -> float:
    """What a photodiode reads, from a table at the precision in which the page has it.

    kernel : (size, monomials) float. Of a wavelength, of the scene's finger or a person's.
    points : Of Gauss quadrature along each side; as many as the page takes if 0.
    """
    nodes: list[Any] = []
    for one in (die, area):
        turn = np.radians(one["turn"])
        rules = [
            np.polynomial.legendre.leggauss(points or min(MOST_POINTS, max(1, math.ceil(side / 0.25))))
            for side in one["size"]
        ]
        (tx, weight_x), (ty, weight_y) = rules
        x, y = (a.ravel() for a in np.meshgrid(tx * one["size"][0] / 2, ty * one["size"][1] / 2, indexing="ij"))
        turned = np.stack([np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y], -1)
        nodes.append((turned + one["at"], np.outer(weight_x, weight_y).ravel() / 4))
    (x, wx), (y, wy) = nodes
    pairs = np.repeat(x, len(y), 0), np.tile(y, (len(x), 1))
    weights = np.outer(wx, wy).ravel() * area["size"][0] * area["size"][1] * explored.radial(*pairs)
    coefficients = half(kernel) @ polynomial.monomials(np.array([state]))[0]
    return float(weights @ (explored.basis.matrix(*pairs) @ coefficients))


def test_readings_are_pythons_at_random_places_sizes_turns_and_states(unchanged: Any, explored: Exploration):
    rng, board = np.random.default_rng(1), explored.scene.layout.outline
    sides = [(board.u_min, board.u_max)] * 2
    if explored.basis.wall_mm is not None:
        sides = [(axis[0], axis[-1]) for axis in explored.basis.axes[:2]]
    for _ in range(20):
        x, y = ([rng.uniform(low + 1, high - 1), rng.uniform(board.v_min + 1, board.v_max - 1)] for low, high in sides)
        if np.hypot(x[0] - y[0], x[1] - y[1]) < 1.0:
            continue
        size, turn = rng.uniform(0.2, 1.2, 2).round(3).tolist(), float(rng.uniform(0, 180))
        state, colour = [*rng.uniform(0.0, 0.1, 2).tolist(), float(rng.uniform(0.7, 1.0))], int(rng.integers(3))
        die = {"at": x, "size": (0.25, 0.25), "turn": 0.0}
        area = {"at": y, "size": size, "turn": turn}
        shown_fraction, *of_people = unchanged.evaluate(
            """([colour, x, y, size, turn, state]) => {
                const pair = readPair({u: x[0], v: x[1], width: 0.25, length: 0.25, turn: 0},
                    {u: y[0], v: y[1], width: size[0], length: size[1], turn: turn * Math.PI / 180}, colours[colour]);
                return [dot(monomials(state), pair.coefficients),
                    ...people.map((person, i) => dot(monomials(state, null, person.polynomial), pair.people[i]))];
            }""",
            [colour, x, y, size, turn, state],
        )
        table, own = explored.wavelengths[colour], explored.polynomial
        assert shown_fraction == pytest.approx(reading(explored, table.coefficients, own, die, area, state), rel=1e-6)
        # Beside kinks of the table a few points miss some.
        expected = reading(explored, table.coefficients, own, die, area, state, 12)
        assert shown_fraction == pytest.approx(expected, rel=0.02)
        assert len(of_people) == len(explored.people) == 3
        for fraction, kernel, one in zip(of_people, table.people, explored.people, strict=True):
            expected = reading(explored, kernel, blood_polynomial(one.scene, chosen=False), die, area, state)
            assert fraction == pytest.approx(expected, rel=1e-6)


def test_volts_noise_and_the_converters_limit_are_pythons(unchanged: Any, explored: Exploration):
    scene, ohm = explored.scene, 1e6
    led, photodiode = scene.leds[0], scene.photodiodes[0].model_copy(update={"feedback_ohm": ohm})
    # The last of them lies in the converter's last step.
    limit_v = electronics.limit_v(scene.electronics) + 0.5 * electronics.lsb_v(scene.electronics)
    dark_v = float(electronics.read(0.0, led, photodiode, scene.electronics).amplified_v)
    last = (limit_v - dark_v) / electronics.volts_per_fraction(led, photodiode, scene.electronics)
    for fraction in (0.0, 1e-5, 1e-3, 0.5, last):
        expected = electronics.read(fraction, led, photodiode, scene.electronics)
        current = fraction * led.flux_mw * 1e-3
        displayed = unchanged.evaluate(
            "([x, ohm]) => stage(tables.photodiodeKinds[0], x * tables.photodiodeKinds[0].responsivity[0], 0, ohm)",
            [current, ohm],
        )
        assert displayed["volts"] == pytest.approx(float(expected.volts), rel=1e-9)
        assert displayed["noiseV2"] == pytest.approx(float(expected.noise_v2), rel=1e-6)
        budget = displayed["noise"]
        of_causes = [
            budget[c] for c in ("shot noise", "feedback resistor", "shunt resistance", "amplifier", "converter")
        ]
        assert of_causes == pytest.approx([float(v2) for v2 in expected.noise[:5]], rel=1e-6, abs=1e-20)
        assert displayed["saturated"] == bool(expected.saturated)


@pytest.mark.parametrize("rejection", [None, "dark_slot", "lock_in"])
def test_ambient_light_and_its_rejection_are_pythons(unchanged: Any, explored: Exploration, rejection: str | None):
    led, ambient_a, ohm = explored.scene.leds[0], 3e-7, 1e6
    photodiode = explored.scene.photodiodes[0].model_copy(update={"feedback_ohm": ohm})
    stage = explored.scene.electronics.model_copy(update={"ambient_rejection": rejection})
    expected = electronics.read(1e-4, led, photodiode, stage, ambient_a=ambient_a)
    scene = explored.scene.model_copy(update={"electronics": stage})
    kind = _readout(photodiode, [{"fields": {"wavelength_nm": led.wavelength_nm}}], scene)
    lit_a = 1e-7 * led.flux_mw * float(kind.pop("responsivity")[0])
    displayed = unchanged.evaluate(
        """([kind, lit, ambient, ohm, rejects]) => {
            const before = tables.stage.rejects;
            try { tables.stage.rejects = rejects; return stage(kind, lit, ambient, ohm); }
            finally { tables.stage.rejects = before; }
        }""",
        [kind, lit_a, ambient_a, ohm, rejection is not None],
    )
    assert displayed["volts"] == pytest.approx(float(expected.volts), rel=1e-9)
    assert displayed["noiseV2"] == pytest.approx(float(expected.noise_v2), rel=1e-6)


def test_resistors_that_fit_a_layout_are_pythons(unchanged: Any, explored: Exploration):
    stage, current_a = explored.scene.electronics, [1e-12, *np.geomspace(1e-8, 1e-3, 40).tolist()]
    displayed = unchanged.evaluate("currents => currents.map(fittedOhm)", current_a)
    assert displayed == pytest.approx(electronics.fitted_ohm(current_a, stage), rel=1e-12)
    # On the page every element has the one for its brightest light, and none is saturated, or that of the scene.
    rows = unchanged.evaluate(
        "evaluate(workbench.layout).rows.map(row => [row.element.ohm, row.amplified, row.saturated])"
    )
    if stage.feedback_ohm != "auto":
        assert {ohm for ohm, _, _ in rows} == {stage.feedback_ohm}
        return
    assert len({ohm for ohm, _, _ in rows}) >= min(2, len(explored.scene.layout.photodiodes))
    assert all(volts < electronics.limit_v(stage) / stage.headroom and not full for _, volts, full in rows)


def test_the_force_that_readings_resolve_is_that_of_place(unchanged: Any, explored: Exploration):
    rng, scene, force_n = np.random.default_rng(2), explored.scene, float(explored.touch["force_n"][12])
    point = operating_point(scene, force_n, since_rest_s=60.0)
    for _ in range(10):
        light, zone = rng.uniform(0.1, 2.0, 6), -rng.uniform(0.5, 3.0, (6, 2))
        noise_v2, limit = rng.uniform(1e-10, 1e-8, 6), rng.random(6) < 0.2
        carries_information = ~limit[:, None]
        read = Response(
            amplified_v=light,
            noise_v2=noise_v2,
            slope_v_per_pa=(zone @ point.blood_per_pa) * carries_information,
            zone_v=zone,
            shunted_fraction=0 * light,
            body_v=None if point.body is None else point.body.shapes_v(zone, light, 0) * carries_information,
            independent_v2=0.0 if point.body is None else (point.body.reading_gain * light) ** 2,
        )
        expected = float(force_resolution_n(total_information([read]), point))
        given = [
            {"led": 0, "light": a, "zone": b, "noiseV2": c, "saturated": d}
            for a, b, c, d in zip(light.tolist(), zone.tolist(), noise_v2.tolist(), limit.tolist(), strict=True)
        ]
        displayed = unchanged.evaluate(
            """([rows, force, rest]) => forceResolution(rows, {body: tables.touch.has_body, force,
                bloodPerPa: atForce(tables.touch.blood_per_pa, force).map((row) => row.map((x) => x * rest)),
                waves: atForce(tables.touch.waves, force).map((row) => row.map((x) => x * rest * rest))}, 1)""",
            [given, force_n, scene.blood.rest_blood_fraction],
        )
        assert displayed == pytest.approx(expected, rel=1e-6)


def test_people_read_the_shown_layout_with_blood_touch_and_waves_of_their_own(shown: Any, explored: Exploration):
    """Expected: Cramer-Rao bounds of each person's readings, with steady vessels; the table follows as parts move."""
    force_n = float(explored.touch["force_n"][12])
    before = shown.inner_text("#people")
    people = shown.evaluate(
        """force => { change((layout) => { layout.force = force; layout.photodiodes[0].v += 0.4; });
            return JSON.parse(JSON.stringify(workbench.result.people)); }""",
        force_n,
    )
    assert shown.inner_text("#people") != before
    assert shown.locator("#people thead th").all_text_contents()[1:] == [
        "This finger",
        *(f"{percent} % quantile" for percent in (10, 50, 90)),
    ]
    texts = shown.locator("#people tbody tr").first.locator("td").all_text_contents()
    for k, (displayed, one, text) in enumerate(zip(people, explored.people, texts[1:], strict=True)):
        worn = one.scene
        blood = shown.evaluate("([k, f]) => stateAt(f, people[k].rest, 0.9, people[k])", [k, force_n])
        rest = worn.blood.rest_blood_fraction
        assert blood[:2] == pytest.approx(steady_blood(worn, [force_n])[0], abs=0.01 * rest)
        point, rows_ = operating_point(worn, force_n, since_rest_s=60.0), displayed["rows"]
        light, zone = np.array([row["light"] for row in rows_]), np.array([row["zone"] for row in rows_])
        read = Response(
            amplified_v=light,
            noise_v2=np.array([row["noiseV2"] for row in rows_]),
            slope_v_per_pa=zone @ point.blood_per_pa,
            zone_v=zone,
            shunted_fraction=0 * light,
            body_v=None if point.body is None else point.body.shapes_v(zone, light, 0),
            independent_v2=0.0 if point.body is None else (point.body.reading_gain * light) ** 2,
        )
        assert not any(row["saturated"] or row["few"] for row in rows_)
        expected = float(force_resolution_n(total_information([read]), point))
        value = displayed["throughBody" if point.body else "electronics"]["value"]
        assert value == pytest.approx(expected, rel=1e-3)
        assert ("None" in text) == (not shown.evaluate("([k, x]) => isKnown(x, people[k])", [k, value]))
    assert len({row["rows"][0]["volts"] for row in people}) == 3


def test_saturated_readings_are_counted_for_each_person(shown: Any):
    """The second person's light is made so bright that no reading is below the limit."""
    shown.evaluate(
        """() => { for (const pair of caches.values()) pair.people[1] = pair.people[1].map((x) => 1e6 * x); draw(); }"""
    )
    cells = shown.locator("#people tr", has_text="Saturated readings").locator("td").all_text_contents()
    count = shown.evaluate("workbench.result.rows.length")
    assert cells[2] == f"{count} of {count}" and cells[0] != cells[2]


def test_the_noise_budget_of_a_pair_has_all_causes_of_its_variance(unchanged: Any, explored: Exploration):
    """Expected: electronics add up to the reading's noise; waves, drift and lift are place's."""
    force_n = float(explored.touch["force_n"][12])
    row, budget = unchanged.evaluate(
        "force => (row => [row, noiseBudget(row, { ...workbench.layout, force })])(workbench.result.rows[0])", force_n
    )
    assert sum(row["noise"].values()) == pytest.approx(row["noiseV2"], rel=1e-12)
    body = operating_point(explored.scene, force_n, since_rest_s=60.0).body
    if body is None:
        assert budget == row["noise"]
        return
    zone, light = np.array(row["zone"]), row["light"]
    assert budget["waves of the body"] == pytest.approx(float(np.sum((zone @ body.blood) ** 2)), rel=1e-6)
    assert budget["drift"] == pytest.approx(light**2 * (body.led_drift**2 + body.reading_gain**2), rel=1e-6)
    assert budget["lift"] == pytest.approx(light**2 * body.lift**2, rel=1e-6)
    assert len(unchanged.locator("#noise li").all()) >= 2


def test_the_blood_under_a_force_is_that_of_the_vessels(unchanged: Any, explored: Exploration):
    force_n = np.linspace(0.0, 3.5, 15)
    expected = steady_blood(explored.scene, force_n)
    rest = explored.scene.blood.rest_blood_fraction
    displayed = unchanged.evaluate("([fs, rest]) => fs.map((f) => stateAt(f, rest, 0.97))", [force_n.tolist(), rest])
    assert np.array(displayed)[:, :2] == pytest.approx(expected, abs=0.01 * rest)


def test_jackknife_polynomial_and_ambient_light_are_pythons(unchanged: Any, explored: Exploration):
    rng, polynomial = np.random.default_rng(3), explored.polynomial
    for _ in range(10):
        values = rng.normal(size=explored.wavelengths[0].blocks.shape[0])
        replicates = np.concatenate([[values.mean()], values])
        assert unchanged.evaluate("jackknife", values.tolist()) == pytest.approx(float(jackknife(replicates)), rel=1e-9)
        state = np.array([*rng.uniform(0, 0.1, 2), rng.uniform(0.7, 1.0)])
        expected = polynomial.monomials(state[None])[0]
        assert unchanged.evaluate("(s) => monomials(s)", state.tolist()) == pytest.approx(expected.tolist(), abs=1e-9)
        for zone in (0, 1):
            step = 1e-6 * np.eye(3)[zone]
            low, high = (polynomial.monomials((state + k * step)[None])[0] for k in (-1, 1))
            slope = unchanged.evaluate("([s, zone]) => monomials(s, zone)", [state.tolist(), zone])
            assert slope == pytest.approx(((high - low) / 2e-6).tolist(), rel=1e-5, abs=1e-5)
        u, v = (float(rng.uniform(nodes[0], nodes[-1])) for nodes in explored.ambient_nodes)
        # So small that it reads the place in its middle.
        current = unchanged.evaluate(
            "([u, v]) => ambientCurrent({u, v, width: 1e-6, length: 1e-6, turn: 0}, 1)", [u, v]
        )
        by_group = [
            1e-12 * float(RegularGridInterpolator(explored.ambient_nodes, table)([u, v])[0])
            for table in explored.ambient_a_per_mm2[1]
        ]
        assert current["ambientA"] == pytest.approx(np.mean(by_group), rel=1e-4)
        assert current["ambientErrorA"] == pytest.approx(np.std(by_group, ddof=1) / len(by_group) ** 0.5, rel=1e-3)


def test_the_section_shows_the_fluence_of_both_parts_of_the_selected_pair(shown: Any, explored: Exploration):
    """The made fluence is exp(-r - z): its product is highest between both parts, right below the plate."""
    rng, table = np.random.default_rng(4), explored.wavelengths[1].fluence
    log = RegularGridInterpolator([table.radius_mm.values, table.depth_mm.values], half(np.log(table.values)))
    for place in rng.uniform([0.2, 0.1], [9.0, 2.9], (20, 2)).tolist():
        computed = shown.evaluate("([r, z]) => logFluence(colours[1], r, z)", place)
        assert computed == pytest.approx(log(place)[0], rel=1e-6)
    pictures = []
    for along in (0.0, 0.5):
        shown.evaluate("(along) => change((layout) => { layout.photodiodes[0].v += along; })", along)
        row = shown.evaluate("JSON.parse(JSON.stringify(workbench.result.rows[0]))")
        led, place = shown.evaluate("workbench.layout.leds")[row["led"]], row["element"]
        apart = math.hypot(led["u"] - place["u"], led["v"] - place["v"])
        words = f"Section through {led['name']} and {place['name']}, {apart:.2f} mm apart: "
        assert shown.inner_text("#section-words").startswith(words)
        png = b64decode(shown.evaluate("$('section').toDataURL()").partition(",")[2])
        rgb = np.array(Image.open(BytesIO(png)).convert("RGB"))
        _, across = np.nonzero((rgb == [253, 231, 37]).all(-1))
        assert len(across) and np.mean(across) == pytest.approx(rgb.shape[1] / 2, abs=6)
        assert (rgb == [68, 1, 84]).all(-1).any()
        pictures.append(png)
    assert pictures[0] != pictures[1]
    assert shown.inner_text(".ticks").split() == ["1/1000", "1/100", "1/10", "1"]


def test_what_the_page_calls_buildable_is_a_scene(unchanged: Any):
    """Random moves of every part: what has no problem on the page is read by Python, and what has one is refused, but
    where the scene's wall would stand elsewhere."""
    rng, buildable = np.random.default_rng(4), 0
    for _ in range(60):
        moves = rng.normal(scale=10 ** rng.uniform(-2, 0.5), size=(40, 3)).tolist()
        computed, text = unchanged.evaluate(
            """(moves) => { const layout = copy(tables.layout);
            [...layout.leds, ...layout.photodiodes].forEach((part, k) => {
                part.u += moves[k][0]; part.v += moves[k][1]; part.turn += 30 * moves[k][2]; });
            return [problems(layout), smolToml.stringify(toScene(layout))]; }""",
            moves,
        )
        if not computed:
            parse_scene(text, name="moved")
            buildable += 1
        elif not any("where a scene would put its wall" in problem for problem in computed):
            with pytest.raises(InputError):
                parse_scene(text, name="moved")
    assert 2 < buildable < 60


def test_errors_are_those_of_the_groups_of_photons(unchanged: Any, explored: Exploration):
    """All coefficients of a group are uneven by 5 % each by itself, so that a reading's error is a part of that."""
    first = rows(unchanged)[0]
    counted = np.sqrt((first["restError"] / first["fractionRest"]) ** 2 - KERNEL_ERROR**2)
    assert 0.05 / np.sqrt(12) / 10 < counted < 0.05 / np.sqrt(12)


def drag(shown: Any, name: str, by: tuple[float, float]) -> None:
    box = shown.locator(f'#board .part[data-name="{name}"] .die').first.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    shown.mouse.move(x, y)
    shown.mouse.down()
    for k in range(1, 6):
        shown.mouse.move(x + by[0] * k / 5, y + by[1] * k / 5)
    shown.mouse.up()


def saved(shown: Any, button: str, folder: Path) -> Path:
    with shown.expect_download() as waiting:
        shown.click(button)
    path = folder / waiting.value.suggested_filename
    waiting.value.save_as(path)
    return path


def test_a_dragged_led_and_a_typed_force_are_saved_as_scene_and_positions(
    shown: Any, explored: Exploration, tmp_path: Path
):
    before, start = rows(shown), explored.scene.layout.leds[0].center_mm
    drag(shown, explored.scene.leds[0].name, (-40.0, -60.0))
    shown.fill("#force-number", "0.5")
    shown.press("#force-number", "Enter")
    after, layout = rows(shown), shown.evaluate("workbench.layout")
    led = layout["leds"][0]
    assert led["u"] < start[0] - 0.2
    assert led["v"] > start[1] + 0.3
    assert layout["force"] == 0.5
    assert after[0]["fraction"] != before[0]["fraction"]
    path = saved(shown, "#save-scene", tmp_path)
    scene = parse_scene(path.read_text(encoding="utf-8"), name="explored")
    assert scene.layout.leds[0].center_mm == pytest.approx((led["u"], led["v"]), abs=1e-5)
    assert scene.layout.photodiode_names == explored.scene.layout.photodiode_names
    if explored.scene.board.barrier:
        wall, kept = scene.layout.barriers[0], explored.scene.layout.barriers[0]
        assert (wall.name, wall.u_min) == (kept.name, pytest.approx(kept.u_min, abs=1e-5))
    assert scene.layout.outline == explored.scene.layout.outline
    assert scene.touch.force_n == 0.5
    positions = read_positions(saved(shown, "#save-positions", tmp_path))
    expected = kicad_parts(scene)
    assert expected[0].ref == (explored.scene.leds[0].reference or "D1")
    assert [part.ref for part in positions] == [part.ref for part in expected]
    assert np.array([p.position_mm for p in positions]) == pytest.approx(
        np.array([p.position_mm for p in expected]), abs=1e-5
    )


def test_a_layout_of_a_kicad_board_moves_its_footprints_and_nothing_else(tab: Any, tmp_path: Path):
    """Expected: the parts where they were dragged, by KiCad's coordinates; every other line of the file as it was."""
    (tmp_path / "board.kicad_pcb").write_bytes((KICAD / "version_9.kicad_pcb").read_bytes())
    text = """schema_version = 1
    [finger]
    digit = "thumb"
    [board]
    kicad = "board.kicad_pcb"
    parts.D1 = { led = "led_800" }
    parts.PD1 = { photodiode = "pd_array_4x1", elements = 1, size_mm = [1.0, 0.5] }
    parts.PD2 = { photodiode = "pd_array_4x1", elements = 1, size_mm = [1.0, 0.5] }
    """
    (tmp_path / "explore.html").write_text(page(made_exploration(parse_scene(text, folder=tmp_path))), encoding="utf-8")
    tab.goto((tmp_path / "explore.html").as_uri())
    tab.evaluate("""change(({ leds: [led], photodiodes: [pd] }) => { led.v -= 0.5; pd.u += 0.25; pd.turn += 15; })""")
    scene = load_scene(saved(tab, "#save-scene", tmp_path))
    export(scene, tmp_path / "moved.kicad_pcb", folder=tmp_path)
    before, after = (read_board(tmp_path / name).footprints for name in ("board.kicad_pcb", "moved.kicad_pcb"))
    steps = {a.ref: np.subtract(b.position_mm, a.position_mm) for a, b in zip(before, after, strict=True)}
    turned = {a.ref: (b.rotation_deg - a.rotation_deg) % 360 for a, b in zip(before, after, strict=True)}
    first = scene.photodiodes[0].reference
    assert steps.pop("D1") == pytest.approx([0.0, -0.5], abs=1e-6) and steps.pop(first) == pytest.approx(
        [0.25, 0.0], abs=1e-6
    )
    assert turned.pop(first) == pytest.approx(15.0, abs=1e-6)
    assert not np.any(list(steps.values())) and not any(turned.values())
    lines = ((tmp_path / name).read_text().splitlines() for name in ("board.kicad_pcb", "moved.kicad_pcb"))
    changed = [old for old, new in zip(*lines, strict=True) if old != new]
    assert len(changed) == 7 and all(line.strip().startswith("(at ") for line in changed)


def test_a_board_that_is_no_rectangle_is_shown_and_kept_to(tab: Any, tmp_path: Path):
    """Expected: of random places on an L with a hole the page takes those that Python takes, and no others."""
    corners = "[-4, -4.5], [1.8, -4.5], [1.8, -0.2], [4, 1], [4, 4.5], [-4, 4.5]"
    text = f"""schema_version = 1
    [finger]
    digit = "thumb"
    [board]
    barrier = false
    outline_mm = [{corners}]
    outline_holes_mm = [[[-3.2, 2.4], [-2.2, 2.4], [-2.2, 3.4], [-3.2, 3.4]]]
    [[leds]]
    name = "ir"
    part = "led_800"
    position_mm = [3.0, 3.0]
    [[photodiodes]]
    name = "pd"
    position_mm = [-1.0, 0.0]
    size_mm = [1.6, 0.8]
    """
    (tmp_path / "explore.html").write_text(page(made_exploration(parse_scene(text))), encoding="utf-8")
    tab.goto((tmp_path / "explore.html").as_uri())
    assert tab.evaluate("document.querySelectorAll('#board .outline')[0].getAttribute('d').match(/[ML]/g).length") == 10
    rng, taken = np.random.default_rng(0), []
    for u, v, turn in zip(*rng.uniform([[-5], [-5.5], [0]], [[5], [5.5], [90]], (3, 150)), strict=True):
        computed, moved = tab.evaluate(
            """([u, v, turn]) => {
            const layout = copy(tables.layout); Object.assign(layout.photodiodes[0], { u, v, turn });
            return [problems(layout), smolToml.stringify(toScene(layout))]; }""",
            [u, v, turn],
        )
        try:
            parse_scene(moved)
        except InputError as error:
            assert computed, error
        else:
            assert not computed
            taken.append((u, v))
    assert 30 < len(taken) < 120


def test_dies_of_a_module_move_together(tab: Any, tmp_path: Path):
    """Expected: by a key, an angle and a mirror of one die the whole footprint, which the exported board has there, and
    no other; a photodiode that is added beside it is none of its dies."""
    (tmp_path / "x.kicad_pcb").write_text("""(kicad_pcb (version 20240108) (setup (aux_axis_origin 100 100))
      (footprint "OLGA" (layer "B.Cu") (at 100.5 101 30) (property "Reference" "U1"))
      (footprint "LED" (layer "B.Cu") (at 96 103) (property "Reference" "D1"))
      (gr_rect (start 94.5 94.5) (end 105.5 105.5) (layer "Edge.Cuts")))""")
    text = """schema_version = 1
    [finger]
    digit = "thumb"
    [board]
    kicad = "x.kicad_pcb"
    barrier = false
    parts.U1 = { module = "max30102" }
    parts.D1 = { led = "led_660" }
    """
    (tmp_path / "explore.html").write_text(page(made_exploration(parse_scene(text, folder=tmp_path))), encoding="utf-8")
    tab.goto((tmp_path / "explore.html").as_uri())

    def dies() -> np.ndarray:
        return np.array(tab.evaluate("allParts().filter(([, part]) => moduleOf(part)).map(([, { u, v }]) => [u, v])"))

    before = dies()
    tab.locator('#board .part[data-name="U1.ir"]').focus()
    tab.keyboard.press("Shift+ArrowRight")
    assert dies() - before == pytest.approx(np.tile([0.5, 0.0], (3, 1)), abs=1e-4)
    tab.fill('#properties input[data-key="turn"]', str(tab.evaluate("chosenPart()[1].turn") + 45))
    tab.press('#properties input[data-key="turn"]', "Enter")
    tab.click("#mirror-v")
    scene = load_scene(saved(tab, "#save-scene", tmp_path))
    export(scene, tmp_path / "moved.kicad_pcb", folder=tmp_path)
    was, now = ({part.ref: part for part in read_board(tmp_path / f"{n}.kicad_pcb").footprints} for n in ("x", "moved"))
    assert now["D1"] == was["D1"] and now["U1"].position_mm != was["U1"].position_mm
    assert scene.leds[0].position_mm != scene.leds[1].position_mm
    tab.click("#add-photodiode")
    assert tab.evaluate("workbench.layout.photodiodes.at(-1).reference") == "PD1"
    tab.locator('#board .part[data-name="U1.pd"]').focus()
    tab.keyboard.press("Delete")
    assert not len(dies()) and tab.evaluate("allParts().length") == 2


@on_one_page
def test_numbers_fit_a_telephone(browser: Any, file: Path):
    """Expected: cards and table of the three people within 390 pixels; volts without powers of ten."""
    context = browser.new_context(viewport={"width": 390, "height": 700})
    view = context.new_page()
    view.goto(file.as_uri())
    for layout in ("", "change(({ leds }) => leds.splice(1)); workbench.layout.ambient = 0; draw();"):
        view.evaluate(layout)
        table = view.evaluate(
            "(({ scrollWidth, clientWidth }) => scrollWidth - clientWidth)($('people').parentElement)"
        )
        assert table <= 0
        assert view.evaluate("$('cards').querySelector('.narrow').getBoundingClientRect().right") <= 390
    assert view.evaluate("whySaturated({ amplified: 112, ambientA: 1.1e-4, element: { ohm: 1e6 } })").startswith(
        ": 110 V"
    )
    context.close()


def test_parts_that_are_added_have_references_of_their_own(shown: Any, explored: Exploration, tmp_path: Path):
    for button in ("#add-led", "#add-photodiode", "#add-photodiode"):
        shown.click(button)
    # Wherever they came to lie, which a small board may not allow.
    shown.evaluate("document.getElementById('save-positions').disabled = false")
    before = [part.ref for part in kicad_parts(explored.scene)]
    refs = [part.ref for part in read_positions(saved(shown, "#save-positions", tmp_path))]
    assert len(refs) == len(before) + 3 and len(set(refs)) == len(refs) and set(before) < set(refs)
    if explored.scene.leds[0].reference:
        assert set(refs) - set(before) == {"D1", "U1", "U2"}


@on_one_page
def test_a_finger_drags_a_part_and_does_not_scroll_the_page(browser: Any, file: Path, explored: Exploration):
    context = browser.new_context(viewport={"width": 390, "height": 700}, has_touch=True, is_mobile=True)
    view = context.new_page()
    view.goto(file.as_uri())
    assert view.evaluate("document.documentElement.scrollWidth") == 390, "nothing is wider than a telephone"
    die = view.locator(f'#board .part[data-name="{explored.scene.leds[0].name}"] .die').first
    die.scroll_into_view_if_needed()
    box, touch = die.bounding_box(), context.new_cdp_session(view)
    start = view.evaluate("[workbench.layout.leds[0].v, scrollY]")
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    touch.send("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": [{"x": x, "y": y}]})
    for k in range(1, 9):
        touch.send("Input.dispatchTouchEvent", {"type": "touchMove", "touchPoints": [{"x": x - 2 * k, "y": y - 5 * k}]})
    touch.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    end = view.evaluate("[workbench.layout.leds[0].v, scrollY]")
    # 40 pixels up, as far as they go on the nail.
    assert end[0] - start[0] == pytest.approx(
        40 / view.evaluate("document.querySelector('#board').getScreenCTM().a"), abs=0.1
    )
    assert end[1] == start[1]
    context.close()


def test_keys_move_turn_remove_and_undo(shown: Any, explored: Exploration):
    led = explored.scene.leds[0].name
    where = "workbench.layout.leds.map((led) => [led.u, led.v, led.turn])"
    start = shown.evaluate(where)
    shown.locator(f'#board .part[data-name="{led}"]').focus()
    for key in ("ArrowUp", "Shift+ArrowLeft", "r"):
        shown.keyboard.press(key)
    (u, v, turn), (u0, v0, _) = shown.evaluate(where)[0], start[0]
    assert (u - u0, v - v0, turn) == (pytest.approx(-0.5), pytest.approx(0.05), 15)
    shown.keyboard.press("Delete")
    assert shown.evaluate(where) == []
    assert shown.is_visible("#problem")
    for _ in range(4):
        shown.keyboard.press("Control+z")
    assert shown.evaluate(where) == start
    shown.keyboard.press("Control+Shift+z")
    assert shown.evaluate(where)[0][1] == pytest.approx(v0 + 0.05)


@on_one_page
def test_parts_snap_align_and_mirror_beside_their_distances(shown: Any, explored: Exploration):
    led = explored.scene.leds[0].name
    grip = shown.locator(f'#board .part[data-name="{led}"] .grip').bounding_box()
    shown.select_option("#snap", "0.25")
    shown.mouse.move(grip["x"] + grip["width"] / 2, grip["y"] + grip["height"] / 2)
    shown.mouse.down()
    shown.mouse.move(grip["x"] - 20, grip["y"] - 30, steps=4)
    shown.wait_for_selector("#board text.separation")
    u, v = shown.evaluate("[workbench.layout.leds[0].u, workbench.layout.leds[0].v]")
    assert (4 * u, 4 * v) == (round(4 * u), round(4 * v)) and v > 0.25
    # The nearest element of each photodiode.
    away_mm: dict[str, list[float]] = {}
    for name, area in ((e.name, e.area) for e in explored.scene.layout.photodiodes):
        away_mm.setdefault(name.split(".")[0], []).append(math.dist(area.center_mm, (u, v)))
    nearest = sorted(min(each) for each in away_mm.values())
    assert shown.locator("#board text.separation").all_text_contents() == [f"{d:.2f} mm" for d in nearest]
    shown.mouse.up()
    assert shown.locator("#board text.separation").count() == 0
    shown.click("#mirror-v")
    assert shown.evaluate("workbench.layout.leds[0].v") == -v
    read = "workbench.result.rows.map((row) => [row.element.u, row.element.v])"
    shown.evaluate("choosePart(workbench.layout.photodiodes[0].name)")
    before = np.array(shown.evaluate(read))
    shown.click("#mirror-v")
    of_part = shown.evaluate("workbench.result.rows.map((row) => row.element.of === workbench.layout.photodiodes[0])")
    mirrored = np.where(np.array(of_part)[:, None], before * (1, -1), before)
    assert sorted(shown.evaluate(read)) == pytest.approx(np.array(sorted(mirrored.tolist())), abs=1e-9)
    shown.evaluate(f"choosePart('{led}')")
    shown.click("#align-v")
    others = shown.evaluate("workbench.layout.photodiodes.map((part) => part.v)")
    assert shown.evaluate("workbench.layout.leds[0].v") == min(others, key=lambda other: abs(other + v))


@on_one_page
def test_a_layout_and_the_scenes_own_change_places(shown: Any, explored: Exploration):
    """Expected: while a layout differs its figure stands beside the scene's own; A/B shows either."""
    where = "workbench.layout.leds[0].v"
    own_v, own = shown.evaluate(where), shown.locator("#cards li").first.inner_text().split()[0]
    assert shown.is_disabled("#other")
    shown.evaluate("change((layout) => { layout.leds[0].v += 0.5; })")
    mine, beside = (shown.locator("#cards li").nth(k).inner_text().split()[0] for k in (0, 1))
    assert beside == own != mine
    shown.click("#other")
    assert shown.evaluate(where) == own_v and shown.locator("#cards li").first.inner_text().split()[0] == own
    shown.click("#other")
    assert shown.evaluate(where) == own_v + 0.5 and shown.locator("#cards li").first.inner_text().split()[0] == mine


@on_one_page
def test_the_link_holds_the_layout(shown: Any, browser: Any):
    shown.select_option("#ambient", "1")
    shown.fill("#so2-number", "80")
    shown.press("#so2-number", "Enter")
    again = browser.new_page()
    again.goto(shown.url)
    assert again.evaluate("workbench.layout") == shown.evaluate("workbench.layout")
    assert again.evaluate("workbench.layout.so2") == pytest.approx(0.8)
    again.close()


def test_an_exported_scene_opens_again_and_an_unsupported_one_is_refused_with_the_reason(shown: Any, tmp_path: Path):
    path = saved(shown, "#save-scene", tmp_path)
    layout = shown.evaluate("workbench.layout")
    shown.click("#add-led")
    assert len(shown.evaluate("workbench.layout.leds")) == 2
    shown.set_input_files("#open", path)
    shown.locator("#message", has_text="its parts lie").wait_for()
    assert shown.evaluate("workbench.layout") == layout
    unsupported = tmp_path / "strange.toml"
    unsupported.write_text(
        '[[leds]]\nname = "uv"\nwavelength_nm = 365.0\n[[photodiodes]]\nname = "p"\nposition_mm = [0, 0]\n'
    )
    shown.set_input_files("#open", unsupported)
    shown.locator("#message", has_text="not a wavelength of this page").wait_for()
    assert shown.evaluate("workbench.layout") == layout


def test_the_noise_in_the_dark_is_a_number(unchanged: Any):
    """With fitted resistors it depends on the light, and is not given."""
    text, fixed = unchanged.inner_text("body"), unchanged.evaluate("tables.stage.feedbackOhm !== null")
    dark = r", 0\.0\d+ mV in the dark" if fixed else ""
    assert re.search(f"amplifier and converter{dark}, and the shot noise", text) and "NaN" not in text


def test_every_gain_is_shown_and_whether_it_follows_the_ambient_light(shown: Any):
    """Expected: of the readings' photodiodes, and that resistors are fitted where the scene gives none."""
    ohm = shown.evaluate("workbench.result.rows.map((row) => row.element.ohm)")
    units = {"kΩ": 1e3, "MΩ": 1e6}
    cells = [cell.split() for cell in shown.locator("#readings tbody td:nth-child(3)").all_text_contents()]
    assert [float(number) * units[unit] for number, unit in cells] == pytest.approx(ohm, rel=5e-3)
    fixed = shown.evaluate("tables.stage.feedbackOhm !== null")
    assert ("fitted to the LEDs and to the ambient light" in shown.inner_text("#gain-words")) != fixed


def test_the_reason_why_no_force_is_resolved_is_reported(shown: Any):
    """Expected: saturation, or vessels that no more force closes; nothing where force is resolved."""
    card = shown.locator("#cards li").first
    shown.evaluate("change((layout) => { layout.force = 0.5; })")
    assert card.inner_text().startswith("None") == (": " in card.inner_text())
    shown.evaluate(
        "tables.touch.blood_per_pa = tables.touch.blood_per_pa.map((at, k) => k ? [[0, 0], [0, 0]] : at); draw()"
    )
    assert "None" in card.inner_text()
    assert "at 0.5 N the vessels of the proximal and distal bed are closed" in card.inner_text()
    saturated = "workbench.result.rows.map((row) => ({ ...row, saturated: true }))"
    assert shown.evaluate(f"whyNone({{ ...workbench.result, rows: {saturated} }})") == ": every reading is saturated"


def test_a_change_whose_error_is_mostly_interpolation_is_marked(shown: Any):
    shown.evaluate("tables.kernelChangeError = 9; draw()")
    assert all("†" in text for text in shown.locator("#readings tbody td:nth-child(6)").all_text_contents())
    shown.evaluate("tables.kernelChangeError = 0; draw()")
    assert not any("†" in text for text in shown.locator("#readings tbody td:nth-child(6)").all_text_contents())
    assert "† where interpolation has the larger part" in shown.inner_text("#error-words")


def test_names_of_leds_side_by_side_do_not_overlap(shown: Any):
    shown.evaluate(
        """change((layout) => { const [first] = layout.leds;
            layout.leds.push({ ...first, name: "beside", reference: null, v: first.v + 0.5 }); })"""
    )
    boxes = """[...document.querySelectorAll("#board .led text")].map((one) => {
        const { x, y, width, height } = one.getBBox(); return [x, y, x + width, y + height]; })"""
    a, b = shown.evaluate(boxes)[:2]
    assert a[2] <= b[0] or b[2] <= a[0] or a[3] <= b[1] or b[3] <= a[1]


def test_what_cannot_be_built_is_reported_and_not_saved(shown: Any):
    shown.evaluate("change((layout) => { layout.leds[0].u = 50; })")
    assert "edge" in shown.inner_text("#problem")
    assert shown.is_disabled("#save-scene")


def test_the_page_warns_where_hardly_any_photons_arrived(shown: Any):
    shown.evaluate("colours[0].blocks = colours[0].blocks.map((x, i) => x * (i % tables.blocks ? 0 : 9))")
    shown.evaluate("caches.clear(); draw()")
    assert "too few photons" in shown.inner_text("#readings").lower()


def link(shown: Any, edit: str) -> str:
    """The link of the layout as it is, changed by some JavaScript before anything can check it."""
    return shown.evaluate(
        f"""(() => {{ const l = copy(workbench.layout); {edit}; const p = packed(l);
        l.leds.forEach((led, k) => {{ p[1][k][2] = led.u; }}); return btoa(JSON.stringify(p)); }})()"""
    )


@on_one_page
@pytest.mark.parametrize(
    ("edit", "rule"),
    [
        ("l.leds[0].u = null", "leds[0] lies at null"),
        ("l.leds[0].kind = 'length'", "leds[0].kind = length is no part of this page"),
        ("l.leds[0].name = '=cmd()'", "leds[0].name = =cmd() breaks the rule pattern"),
        ("l.leds[0].reference = 7", "leds[0].reference = 7 is no string"),
        ("l.so2 = 9", "so2 = 9 is not in"),
        ("l.rest = -1", "rest = -1 is not in"),
        ("l.force = '1'", "force = 1 is not in"),
        ("l.ambient = 99", "ambient = 99 is no light of this page"),
        ("l.leds = Array(2000).fill(l.leds[0])", "leds breaks the rule maxItems 64"),
        ("l.photodiodes[0].elements = 1e9", "photodiodes[0].elements = 1000000000 breaks the rule maximum 1024"),
        ("l.leds = Array(64).fill(l.leds[0]); l.photodiodes[0].elements = 1000", "more than this page shows"),
        ("l.photodiodes[0].width = 0", "photodiodes[0].size_mm[0] = 0 breaks the rule exclusiveMinimum 0"),
        ("l.photodiodes[0].wired = [0, 0]", "wired must name elements"),
    ],
)
def test_a_link_that_breaks_a_rule_is_refused(unchanged: Any, file: Path, edit: str, rule: str):
    layout, hostile = unchanged.evaluate("workbench.layout"), link(unchanged, edit)
    unchanged.evaluate("(hash) => { location.hash = hash; }", hostile)
    unchanged.locator("#message", has_text=rule).wait_for()
    assert unchanged.evaluate("workbench.layout") == layout
    # So is one that the page is opened with.
    unchanged.goto("about:blank")
    unchanged.goto(f"{file.as_uri()}#{hostile}")
    assert rule in unchanged.inner_text("#message") and unchanged.evaluate("workbench.layout") == layout


SCENE = finger(
    {"name": "pd", "position_mm": [1.5, 0.0]},
    leds=({"part": "led_660"},),
    finger={"digit": "index"},
    blood={"so2": 0.97},
)


@on_one_page
@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("so2 = 0.97", "so2 = 9.0"),
        ("so2 = 0.97", 'so2 = "high"'),
        ("so2 = 0.97", "so3 = 0.97"),
        ("[-1.2, 0.0]", "[-1.2]"),
        ("[-1.2, 0.0]", "[nan, 0.0]"),
        ('"ir"', '"=1+1"'),
        ('"pd"', '"a\\nb"'),
        ("[1.5, 0.0]", "[1.5, 0.0]\nsize_mm = [-1.0, 1.0]"),
        ("[1.5, 0.0]", "[1.5, 0.0]\nelements = 2000"),
        ("[1.5, 0.0]", "[1.5, 0.0]\nelements = 2\nwired = [2]"),
        ("[1.5, 0.0]", "[1.5, 0.0]\nelements = 2\npitch_mm = 0.5"),
        ('digit = "index"', 'digit = "nose"'),
        ("schema_version = 1", "schema_version = 2"),
        ("schema_version = 1", "schema_version = 1\nleds = 5"),
    ],
)
def test_a_dropped_scene_is_refused_as_python_refuses_it(unchanged: Any, tmp_path: Path, old: str, new: str):
    layout, text = unchanged.evaluate("workbench.layout"), SCENE.replace(old, new)
    assert text != SCENE
    with pytest.raises(InputError):
        parse_scene(text)
    (tmp_path / "dropped.toml").write_text(text, encoding="utf-8")
    unchanged.set_input_files("#open", tmp_path / "dropped.toml")
    unchanged.locator("#message", has_text="dropped.toml:").wait_for()
    assert "lie on this page" not in unchanged.inner_text("#message")
    assert unchanged.evaluate("workbench.layout") == layout


@on_one_page
def test_the_scene_that_those_refused_differ_from_is_taken(shown: Any, tmp_path: Path):
    layout = shown.evaluate("workbench.layout")
    parse_scene(SCENE)
    (tmp_path / "whole.toml").write_text(SCENE, encoding="utf-8")
    shown.set_input_files("#open", tmp_path / "whole.toml")
    shown.locator("#message", has_text="whole.toml: its parts lie").wait_for()
    assert shown.evaluate("workbench.layout") != layout


@on_one_page
def test_every_shipped_finger_keeps_the_rules_of_the_page(unchanged: Any):
    """The page uses the models' own JSON Schema: what Python accepts it does not refuse."""
    for path in sorted(data_dir("scenes").glob("*.toml")):
        scene = load_scene(path)
        for text in (path.read_text(encoding="utf-8"), to_toml(scene)) if scene.finger else ():
            assert unchanged.evaluate("(text) => broken(smolToml.parse(text), tables.rules.scene, '')", text) == "", (
                path
            )


@on_one_page
def test_positions_hold_no_formula_and_no_line_of_their_own(shown: Any, tmp_path: Path):
    refs = ["=HYPERLINK(1)", "@SUM", 'D"1', "a\nb,c", "+1"]
    shown.evaluate(
        """(refs) => { const [like] = workbench.layout.leds;
        workbench.layout.leds = refs.map((reference, k) => ({ ...like, name: `l${k}`, reference }));
        document.getElementById('save-positions').disabled = false; }""",
        refs,
    )
    path = saved(shown, "#save-positions", tmp_path)
    assert [part.ref for part in read_positions(path)][:5] == [ref.replace("\n", " ") for ref in refs]
    cells = [line.split(",")[0].strip('"') for line in path.read_text(encoding="utf-8").splitlines()]
    assert not any(cell[:1] in FORMULA for cell in cells)


@on_one_page
def test_no_script_but_its_own_runs_on_the_page(shown: Any, explored: Exploration):
    """What came into it as markup would neither run nor load anything."""
    text = page(explored)
    injected = text.replace("</main>", "<script>window.hostile = 1</script><img src='http://x.invalid/' ></main>")
    refused: list[str] = []
    view = shown.context.new_page()
    view.on("console", lambda message: refused.append(message.text))
    view.set_content(injected)
    assert view.evaluate("[window.hostile, typeof workbench.result]") == [None, "object"]
    assert sum("Content Security Policy" in line for line in refused) == 2
    view.close()


def test_another_board_than_the_scenes_and_too_few_photons_are_warned_of(shown: Any):
    """Expected: too few photons of a made exploration's 1000; another board only where the sizes differ."""
    warning = shown.inner_text("#board-words")
    assert "1000 photons" in warning and "simulate" not in warning
    shown.evaluate("tables.board.ownMm = [2.83, 9]; tables.colours[0].photons = 2e6; drawFixed();")
    warning = shown.inner_text("#board-words")
    assert "as simulate takes it, is 2.83 by 9.00 mm" in warning and "photons" not in warning
    assert "not of the scene's (2.83 by 9.00 mm)" in shown.inner_text("#gain-words")

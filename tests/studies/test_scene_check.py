"""What check reports: it predicts readings, names what is ignored, and refuses what later commands refuse."""

import pytest
from small_scenes import PLACEMENT

from nailoptics.assets import data_dir
from nailoptics.cli import run
from nailoptics.errors import InputError
from nailoptics.light import backend
from nailoptics.report.pages.scene import CHECK
from nailoptics.report.scene_description import check_lines
from nailoptics.scene import Ambient, Electronics, load_scene, parse_scene, to_toml
from nailoptics.scene.catalogue import load_part
from nailoptics.sensor.volts import with_fitted_resistors
from nailoptics.studies.scene_check import SceneCheck, check

# Of the light of a scene, which is traced once.
pytestmark = pytest.mark.usefixtures("coarse_light")
# Two LEDs on a board as large as the nail, without a barrier, and a layout in a file.
SCENE = (
    PLACEMENT.replace("size_mm = [9.0, 9.0]", "barrier = false")
    .replace("[[photodiodes]]", '[[leds]]\nname = "red"\npart = "led_660"\nposition_mm = [-3.0, 1.0]\n[[photodiodes]]')
    .replace("photodiodes = 4\n", '[[placement.candidates]]\nname = "mine"\npositions = "pos.csv"\n')
)
MORE_LEDS = "".join(
    f'[[leds]]\nname = "more{v:.0f}"\npart = "led_660"\nposition_mm = [3.0, {v}]\n' for v in (-2.0, 0.0, 2.0)
)
POSITIONS = (
    "Ref,Val,Package,PosX,PosY,Rot,Side\nD1,red,,-3,0,0,top\nD2,led_800,,3,0,45,top\nPD1,,,0,2,0,top\nC1,,,0,0,0,top\n"
)


def scene(tmp_path, *, positions=POSITIONS, text=SCENE):
    (tmp_path / "pos.csv").write_text(positions)
    (tmp_path / "mine.toml").write_text(text)
    return tmp_path / "mine.toml"


def test_it_reports_distances_candidates_and_what_is_ignored(tmp_path):
    result = check(load_scene(scene(tmp_path)))
    assert [(p["led"], p["distance_mm"]) for p in result["pairs"]] == [("ir", 4.0), ("red", pytest.approx(17**0.5))]
    assert result["candidates"] == [{"name": "mine", "leds": 2, "photodiodes": 1}]
    assert result["ignored"] == {"pos.csv": ["C1"]} and result["warnings"] == []
    assert [led["name"] for led in result["leds"]] == ["ir", "red"]


@pytest.mark.long
def test_it_warns_of_readings_that_may_be_saturated():
    prototype = load_scene(data_dir("scenes") / "prototype.toml")

    def lit(factor: float) -> dict:
        leds = tuple(led.model_copy(update={"flux_mw": factor * led.flux_mw}) for led in prototype.leds)
        return check(prototype.model_copy(update={"leds": leds}))

    assert lit(0.5)["warnings"] == []
    line, exposure = lit(20)["warnings"]
    assert exposure.startswith("exposure: ")
    assert line.startswith(
        "may be saturated, above 60% of the converter's range of 5 V, the margin for other fingers: "
    )
    assert "proximal.12 under ir (" in line and "leds.flux_mw" in line


def test_it_warns_of_an_led_that_its_part_does_not_bear(tmp_path):
    """The current of a part is in proportion to its flux, unless the scene gives both; one without a limit has none."""
    own = 'kind = "led"\npeak_nm = 850.0\nfwhm_nm = 20.0\nflux_mw = 5.0\ncurrent_ma = 20.0\n'

    def warned(limit, led):
        (tmp_path / "own.toml").write_text(own + limit)
        scene = parse_scene(
            f'schema_version = 1\n[phantom]\n[[phantom.layers]]\nname = "slab"\nthickness_mm = 10.0\n'
            f'mu_a_per_mm = 0.05\nmu_s_per_mm = 5.0\n[[leds]]\nname = "ir"\npart = "own"\n{led}\n',
            folder=tmp_path,
        )
        assert parse_scene(to_toml(scene)) == scene
        return check(scene)["warnings"]

    limit = "max_current_ma = 50.0\n"
    assert warned(limit, "") == warned(limit, "flux_mw = 12.5") == warned("", "flux_mw = 50.0") == []
    words = "leds: ir needs 51.2 mA for 12.8 mW, beyond the 50 mA of its part; set flux_mw to 12.5"
    assert warned(limit, "flux_mw = 12.8") == [words]
    assert warned(limit, "flux_mw = 12.8\ncurrent_ma = 49.0") == []
    assert load_part("max30101").leds[0].max_current_ma == 51.0


BLIND = SCENE.replace("size_mm = [1.0, 0.25]", "size_mm = [1.0, 0.25]\nresponsivity = [[400.0, 0.1], [700.0, 0.4]]")


def test_it_and_simulate_warn_of_a_table_that_does_not_reach_an_led(undrawn, tmp_path, capfd):
    line = 'photodiode "pd" does not see LED "ir" of 800 nm: its responsivity reaches from 400 to 700 nm; add rows'
    (warning,) = check(load_scene(scene(tmp_path, text=BLIND)))["warnings"]
    assert warning.startswith(line)
    blind = scene(tmp_path, text=BLIND + "[priors]\nspread = false\n")
    assert run(["simulate", str(blind), "--photons", "2000", "-o", str(tmp_path / "out")]) == 0
    assert capfd.readouterr().err.count(line) == 1


def test_it_warns_of_photodiodes_that_the_sun_may_saturate(jit_backend):
    prototype = load_scene(data_dir("scenes") / "prototype.toml")
    leds = tuple(led.model_copy(update={"flux_mw": 0.5 * led.flux_mw}) for led in prototype.leds)

    def lit(lux: float) -> dict:
        return check(prototype.model_copy(update={"leds": leds, "ambient": Ambient(kind="sun", illuminance_lux=lux)}))

    (line,) = lit(1e5)["warnings"]
    assert line.startswith("may be saturated") and line.endswith("or the light of [ambient]") and " and 4 more" in line
    dim, dark = (lit(lux)["pairs"][0]["volts"] for lux in (1000.0, 0.0))
    assert lit(1000.0)["warnings"] == [] and 0.05 < dim - dark < 0.5


def test_a_scene_in_ambient_light_is_checked_without_a_compiling_backend(monkeypatch):
    scalar = backend.choose("scalar")
    monkeypatch.setattr(backend, "choose", lambda *_, **__: scalar)
    usual = load_scene(data_dir("scenes") / "prototype.toml")
    report = check(usual.model_copy(update={"ambient": Ambient(illuminance_lux=1e5)}))
    assert report["pairs"] == [] and report["noise"] == "" and len(report["photodiodes"]) == 8
    assert any("readings need a backend that compiles kernels" in line for line in report["warnings"])
    assert "  distal.9" in "\n".join(check_lines(report | {"scene": "prototype"}))
    with pytest.raises(InputError, match="needs a JIT backend"):
        with_fitted_resistors(usual.model_copy(update={"electronics": Electronics(feedback_ohm="auto")}))


def test_an_area_of_contact_in_square_centimetres_is_warned_of(tmp_path, capfd):
    text = (data_dir("scenes") / "prototype.toml").read_text(encoding="utf-8")
    assert not any("contact_area" in w for w in check(parse_scene(text))["warnings"])
    small = text.replace("contact_area_mm2 = 100.0", "contact_area_mm2 = 1.0")
    (line,) = (w for w in check(parse_scene(small))["warnings"] if "contact_area" in w)
    assert line == "touch.contact_area_mm2 = 1: fingertips touch with 50 to 200 mm^2 (1 cm^2 is 100 mm^2)"
    (tmp_path / "small.toml").write_text(small.replace("[light]", '[light]\nengine = "photons"'), encoding="utf-8")
    assert run(["simulate", str(tmp_path / "small.toml"), "-o", str(tmp_path), "--backend", "scalar"]) == 2
    assert line in capfd.readouterr().err


def test_vessels_far_off_the_list_are_named_by_check_and_simulate(tmp_path, capfd):
    text = (data_dir("scenes") / "prototype.toml").read_text(encoding="utf-8")
    tuned = text.replace("so2 = 0.97", "so2 = 0.97\ntuning = { capillary_stiffness_n_per_m = 1e-9 }")
    (tmp_path / "far.toml").write_text(tuned.replace("[light]", '[light]\nengine = "photons"'), encoding="utf-8")
    (line,) = (w for w in check(parse_scene(tuned))["warnings"] if w.startswith("blood.tuning"))
    assert "capillary_stiffness_n_per_m = 1e-09 (listed" in line
    # Ends before it traces: an engine that the backend cannot run.
    assert run(["simulate", str(tmp_path / "far.toml"), "-o", str(tmp_path), "--backend", "scalar"]) == 2
    assert line in capfd.readouterr().err


@pytest.mark.parametrize(("name", "is_remarked"), [("listed", True), ("best", False)])
def test_the_set_of_vessels_is_named_and_the_papers_table_remarked(tmp_path, capfd, name, is_remarked):
    assert run(["check", str(scene(tmp_path, text=SCENE.replace('"best"', f'"{name}"')))]) == 0
    (line,) = [line for line in capfd.readouterr().out.splitlines() if line.startswith("blood: ")]
    assert line.startswith(f'blood: vessels "{name}", ') and ("does not reproduce its figures" in line) == is_remarked


def test_regions_are_those_that_are_there(tmp_path):
    with_barrier = SCENE.replace("barrier = false", "barrier = true")
    for text, is_there in ((SCENE, False), (with_barrier, True)):
        loaded = load_scene(scene(tmp_path, text=text))
        assert ("barrier" in CHECK.summary(SceneCheck(loaded, {}))["regions"]) == is_there


def test_a_phantom_is_checked_without_a_finger():
    result = check(load_scene(data_dir("scenes") / "phantom.toml"))
    assert result["leds"] and "pairs" not in result


@pytest.mark.parametrize(
    ("positions", "text", "words"),
    [
        (POSITIONS.replace("red", "green"), SCENE, r'candidates\[0\]: layout "mine": which of its LEDs .* is "red"'),
        (POSITIONS.replace("PD1,,,0,2", "PD1,,,-3,0"), SCENE, r'candidates\[0\]: layout "mine".*photodiode "PD1"'),
        (
            POSITIONS,
            SCENE.replace("search = false", "search = true").replace("[[photodiodes]]", MORE_LEDS + "[[photodiodes]]"),
            "placement.search places up to 4 LEDs, the scene has 5",
        ),
        (POSITIONS, SCENE.replace('part = "led_800"', 'part = "led_800"\nfwhm_nm = 300.0'), r"leds\[0\].fwhm_nm = 300"),
    ],
)
def test_it_refuses_what_a_later_command_would(tmp_path, capfd, positions, text, words):
    path = scene(tmp_path, positions=positions, text=text)
    with pytest.raises(InputError, match=words):
        check(load_scene(path))
    assert run(["check", str(path)]) == 2
    out, err = capfd.readouterr()
    assert out == "" and len(err.splitlines()) == 1 and str(path) in err


@pytest.mark.long
@pytest.mark.parametrize(
    ("outline", "words"),
    [
        ("[-4.0, -5.0], [4.0, -5.0], [4.0, 30.0], [-4.0, 30.0]", ["its outline reaches"]),
        ("[-4.0, -5.0], [4.0, -5.0], [4.0, 1.0], [0.0, 5.0], [-4.0, 5.0]", []),
        ("[-4.0, -5.0], [4.0, -5.0], [4.0, 5.0], [-4.0, 5.0]", []),
    ],
)
def test_it_reports_where_the_models_board_is_not_that_of_the_file(outline, words):
    text = SCENE.split("[placement]")[0].replace("barrier = false", f"barrier = false\noutline_mm = [{outline}]")
    warnings = [line for line in check(parse_scene(text))["warnings"] if line.startswith("board: ")]
    assert len(warnings) == len(words) and all(word in line for word, line in zip(words, warnings, strict=True))

"""The model beside measurements on people: tables, statistics, and the shipped model with little light."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from nailoptics.assets import asset_path
from nailoptics.cli import run
from nailoptics.errors import InputError
from nailoptics.report.pages import validate as page
from nailoptics.studies.validation import appearance, validate
from nailoptics.studies.validation.comparison import Comparison
from nailoptics.studies.validation.people_tables import COLUMNS, percentile, pooled, read_people, slope_within_days

DOCUMENTS = "README.md", "docs/trust.md", "docs/validation.md"
PHOTOS, PULSE, SKIN, WAVES = "nail_photos", "red_infrared_pulse", "skin_spectra", "fingertip_waves"


def test_shipped_tables_hold_their_columns_and_sources():
    for name, columns in COLUMNS.items():
        table = read_people(name)
        assert {*columns} <= {*table.columns} and len(table) >= 6
        assert table.attrs["shipped"] and table.attrs["source"] in asset_path(f"real/{name}.csv").read_text()[
            :2000
        ].replace("\n# ", " ")


def own(folder: Path, name: str, change: Callable[[pd.DataFrame], pd.DataFrame]) -> Path:
    """A folder with a changed copy of a shipped table, all of whose columns hold anything."""
    change(pd.read_csv(asset_path(f"real/{name}.csv"), comment="#").astype(object)).to_csv(folder / f"{name}.csv")
    return folder


def cell(column: str, value: object) -> Callable[[pd.DataFrame], pd.DataFrame]:
    return lambda table: table.assign(**{column: [value, *table[column][1:]]})


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        (PHOTOS, lambda t: t.rename(columns={"hb_g_per_l": "hb"}), "lacks the column hb_g_per_l"),
        (PHOTOS, cell("nail_r", -0.6918), "nail_r must be a finite number above 0 and at most 1, got -0.6918 in row 1"),
        (PHOTOS, cell("nail_r", "light"), "nail_r must be .* got light in row 1"),
        (PHOTOS, cell("skin_g", 176), "skin_g must be a finite number above 0 and at most 1, got 176"),
        (PHOTOS, cell("hb_g_per_l", 13.5), "hb_g_per_l must be a finite number above 20 and at most 300, got 13.5"),
        (PHOTOS, cell("day", None), "day must be a name, got nan in row 1"),
        (PHOTOS, lambda t: t[:0], "two people more than days"),
        (PHOTOS, lambda t: t[:2], "two people more than days"),
        (PHOTOS, lambda t: t.assign(hb_g_per_l=120), "of different haemoglobin within a day"),
        (PULSE, cell("correlation", "good"), "correlation must be a finite number above -1 and at most 1, got good"),
        (PULSE, cell("ratio_of_ratios", np.inf), "ratio_of_ratios must be a finite number above 0"),
        (PULSE, lambda t: t[:2], "three recordings of different ratio"),
        (PULSE, lambda t: t.assign(ratio_of_ratios=0.5), "three recordings of different ratio"),
        (PULSE, lambda t: t.assign(correlation=0.5), "three recordings .* a correlation above 0.9"),
        (PULSE, lambda t: t[t.spo2_percent < 90], "one of these recordings at a saturation of 94 % or more"),
        (PULSE, lambda t: t.assign(spo2_percent=t.spo2_percent / 100), "spo2_percent must be"),
        (SKIN, cell("600_nm", 1314), "600_nm must be a finite number above 1 and at most 100, got 1314"),
        (SKIN, cell("600_nm", 0.31), "600_nm must be a finite number above 1 and at most 100, got 0.31"),
        (SKIN, cell("600_nm", None), "600_nm must be .* got nan in row 1"),
        (SKIN, lambda t: t.assign(**{"380_nm": 10.0}), "has an unknown column 380_nm"),
        (SKIN, lambda t: t[:0], "rows of place ring finger or back of hand"),
        (SKIN, cell("place", "forehead"), "none of forehead"),
        (SKIN, lambda t: t[t.percentile != 50], "one row of percentile 50 for back of hand, group AB"),
        (WAVES, lambda t: t[:1], "needs two rows"),
        (WAVES, lambda t: t[:0], "needs two rows"),
    ],
)
def test_a_wrong_table_is_refused_in_one_line(tmp_path, name, change, words):
    folder = own(tmp_path, name, change)
    with pytest.raises(InputError, match=words) as caught:
        read_people(name, folder)
    assert "\n" not in str(caught.value) and f"{name}.csv" in str(caught.value)


def test_a_file_that_is_no_table_is_refused_in_one_line(tmp_path):
    (tmp_path / f"{WAVES}.csv").write_text("a,b\n1,2\n1,2,3\n", encoding="utf-8")
    with pytest.raises(InputError, match="cannot be read as a table") as caught:
        read_people(WAVES, tmp_path)
    assert "\n" not in str(caught.value)


def test_wrong_tables_are_refused_before_light_and_with_code_2(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(validate, "trace", lambda *a, **k: pytest.fail("traced"))
    assert run(["validate", "--data", str(own(tmp_path, WAVES, lambda t: t[:1])), "-o", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_help_offers_no_option_that_validate_refuses(capsys):
    run(["validate", "--help"])
    text = capsys.readouterr().out
    assert "--photons" in text and "--relative-error" not in text and "--max-seconds" not in text


@pytest.mark.parametrize("place", ["ring finger", "back of hand"])
def test_a_table_of_one_place_is_read_with_its_path_as_source(tmp_path, place):
    table = read_people(SKIN, own(tmp_path, SKIN, lambda t: t[t.place == place]))
    assert set(table.place) == {place} and table.attrs == {"source": str(tmp_path / f"{SKIN}.csv"), "shipped": False}
    assert read_people(PHOTOS, tmp_path).attrs["shipped"]


def test_one_ring_finger_is_compared_with_its_own_quartiles(tmp_path):
    """Expected: of one person the quartiles that the table states, not the one median between which nothing lies."""

    def alone(table: pd.DataFrame) -> pd.DataFrame:
        return table[(table.place == "ring finger") & (table.group == "JP")].assign(people=1)

    table = read_people(SKIN, own(tmp_path, SKIN, alone))
    low, high = pooled(table, (25, 75))
    assert (high > low).all() and np.array_equal(low, percentile(table, 25))
    everyone = read_people(SKIN)[lambda t: t.place == "ring finger"]
    assert not np.array_equal(pooled(everyone, (25,))[0], low)


def test_only_the_third_left_out_of_the_fit_is_compared_with_nails(tmp_path):
    about = np.ones(6), np.ones(6)
    shipped = appearance._colours(read_people(PHOTOS), *about)["nail_L"]
    assert shipped.texts["basis"] == "held out" and "53 people" in shipped.texts["quantity"]
    theirs = appearance._colours(read_people(PHOTOS, own(tmp_path, PHOTOS, lambda t: t)), *about)["nail_L"]
    assert (
        theirs.texts["basis"] == "prediction"
        and "160 people" in theirs.texts["quantity"]
        and theirs.texts["source"] == str(tmp_path / f"{PHOTOS}.csv")
    )


def test_a_folder_without_any_table_is_refused(tmp_path):
    with pytest.raises(InputError, match="holds none of nail_photos.csv"):
        validate.validate(data=tmp_path)


def test_slopes_within_days_ignore_exposure_between_days():
    """Expected: a slope of 0.3 per 10 g/l is estimated whatever each day adds, within its standard error."""
    rng = np.random.default_rng(1)
    photos = read_people("nail_photos")
    values = 0.03 * photos["hb_g_per_l"].to_numpy() + 50 * photos["day"].to_numpy() + rng.normal(0, 1, len(photos))
    slope, stderr = slope_within_days(photos, values)
    assert abs(slope - 0.3) < 4 * stderr and 0 < stderr < 0.15


def test_nails_carried_over_to_measured_skin_are_pink():
    """Expected: medians of the 160 people as published with the table, by another computation: 62.4, 10.8, 8.8."""
    lab = appearance.nails_lab(read_people("nail_photos"))
    assert np.median(lab, 0) == pytest.approx([62.4, 10.8, 8.8], abs=1.1)
    assert (lab[:, 1] < 3).mean() < 0.05


def test_statistics_agree_and_disagree_where_they_should():
    assert Comparison.by_standard_errors({}, (1.0, 0.1), (1.1, 0.1), 0.0).agrees
    # A spread over the priors is shown, and excuses nothing.
    wide = Comparison.by_standard_errors({}, (1.0, 0.1), (1.5, 0.1), 3.0)
    assert not wide.agrees and wide.model[0, 0] < -4
    people, model = np.random.default_rng(2).normal(0, 1, 400), np.array([[-1.96], [0.0], [1.96]])
    covered = Comparison.by_coverage({}, people, model)
    assert covered.agrees and covered.value == pytest.approx(0.95, abs=0.03)
    assert not Comparison.by_coverage({}, people + 2, model).agrees
    # An interval that holds everybody states too much.
    assert not Comparison.by_coverage({}, people, 10 * model).agrees
    # That it holds all of a few people is no sign of that.
    assert not Comparison.by_coverage({}, people[:59] / 10, model).agrees
    assert Comparison.by_coverage({}, people[:58] / 10, model).agrees


def test_a_w_that_is_too_deep_disagrees():
    """Expected: from medians of two groups, 1.041 and 1.029, a model of 1.14 is many standard errors off."""
    fingers = read_people(SKIN)[lambda t: t.place == "ring finger"]
    (deep,) = appearance._w_depth("w_of_ring_finger", fingers, [np.array([1.0, 1.14, 1.3])] * 2).values()
    assert deep.people[1, 0] == pytest.approx(1.035, abs=1e-3)
    assert deep.value > 10 and not deep.agrees and deep.model[0, 0] < 1.01
    (flat,) = appearance._w_depth("w_of_ring_finger", fingers, [np.array([1.0, 1.036, 1.1])] * 2).values()
    assert flat.agrees
    assert not appearance._w_depth("w_of_ring_finger", fingers[fingers.group == "JP"], [np.ones(3)])


def test_waves_and_pulse_without_light_agree_with_people():
    waves = validate._waves(read_people("fingertip_waves"))
    shape = validate._contact_pressure(read_people("pulse_against_contact_pressure"))
    assert all(comparison.agrees for comparison in waves.values()) and shape.agrees
    assert shape.x[shape.model[1].argmax()] == 50
    fall = 1 - shape.model[1, -1] / shape.model[1].max()
    assert 0.15 < fall < 0.4


def test_skin_is_measured_with_the_bandwidth_of_a_spectrophotometer(monkeypatch):
    """Expected: a line of one of the wavelengths, 5 nm apart, counts for a third there, and none 10 nm off."""
    spectrum = np.zeros((1, 77))
    spectrum[0, appearance.WAVELENGTHS_NM == 560] = 1.0
    monkeypatch.setattr(appearance.Skin, "__init__", lambda self: None)
    monkeypatch.setattr(appearance.Skin, "read", lambda self, scene, rays, gloss: spectrum)
    (measured,) = appearance.Skin().spectrum(None)
    assert measured[appearance.SPECTRUM_NM == 560] == pytest.approx(100 / 3) and measured.sum() == pytest.approx(
        100 / 3
    )
    # A level part of a spectrum, and its ends, are what they are.
    spectrum[:] = 0.5
    assert appearance.Skin().spectrum(None) == pytest.approx(50.0)


@pytest.mark.long
@pytest.mark.jit
def test_validation_shows_disagreement_first(jit_backend, coarse_cells, tmp_path):
    result = validate.validate(photons=15_000, seed=1, store=False)
    assert {"nail_L", "nail_a", "nail_b", "ring_finger", "spo2_slope", "pulse_red"} <= {*result.tables}
    # Of the darkest and the palest group's skin, by the melanin that is fitted to each.
    dark, pale = (result.tables[f"back_of_hand_{group}"].model[1] for group in ("AF", "CA"))
    assert (dark < 0.6 * pale).all()
    # The model has an interval over the priors at every point.
    for name, one in result.tables.items():
        assert (one.model[2] - one.model[0] > 0.003 * np.abs(one.model[1])).all(), name
    # Of so few rays only what is plain: the nail is no longer grey.
    assert result.tables["nail_a"].agrees and 4.4 < result.tables["nail_a"].model[1, 0] < 16.4
    text = page.page(result)
    rows = [comparison.agrees for comparison in sorted(result.tables.values(), key=lambda one: one.agrees)]
    curves = [one for one in result.tables.values() if one.as_dict().get("over")]
    assert rows == sorted(rows) and text.count("<svg") == len(curves) > 5
    summary = page.summary(result)
    assert {"quantity", "people", "model", "agrees"} <= {*summary["tables"]["nail_L"]}
    assert len(page.lines(summary)) == len(result.tables) + 2 and "Accepted" in page.lines(summary)[0]
    not_fitted = [one.agrees for one in result.tables.values() if one.texts["basis"] != "fitted"]
    assert f"of {len(not_fitted)} unfitted quantities {sum(not_fitted)} agree" in page.lines(summary)[-1]


def test_the_documents_state_the_results_of_the_documentation():
    """Expected: counts of the README, and of trust.md and validation.md how much of skin and nails agrees."""
    root = Path(__file__).parents[3]
    words = {name: " ".join((root / name).read_text(encoding="utf-8").split()) for name in DOCUMENTS}
    made = json.loads((root / "docs/validation.json").read_text(encoding="utf-8"))
    (n, count), (fitted, of_fitted) = made["counts"]["unfitted"], made["counts"]["fitted"]
    assert f"{n} of {count} quantities that were not fitted agree" in words["README.md"]
    assert f"and {fitted} of {of_fitted} fitted ones" in words["README.md"]
    skin = made["tables"]["ring_finger"]
    inside = f"{round(skin['coverage'] * len(skin['people']['low']))} of {len(skin['people']['low'])} wavelengths"
    assert inside in words["docs/trust.md"] and inside in words["docs/validation.md"]
    lightness, redness, yellowness = (round(100 * made["tables"][f"nail_{k}"]["coverage"]) for k in "Lab")
    assert f"{lightness} % have an L*, {redness} % an a* and {yellowness} % a b*" in words["docs/trust.md"]
    rises = [
        100 * made["tables"][f"w_of_{place}"]["model"]["middle"] - 100 for place in ("ring_finger", "back_of_hand")
    ]
    assert "it rises, by {:.0f} and {:.0f} %".format(*rises) in words["docs/validation.md"]

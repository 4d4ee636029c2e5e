"""The model beside measurements on people: tables, statistics, and the shipped model with little light."""

import numpy as np
import pytest

from nailoptics.assets import asset_path
from nailoptics.errors import InputError
from nailoptics.report.pages import validate as page
from nailoptics.studies import validate
from nailoptics.studies.validate import COLUMNS, read_people


def test_shipped_tables_hold_their_columns_and_sources():
    for name, (others, positive) in COLUMNS.items():
        table = read_people(name)
        assert {*others, *positive} <= {*table.columns} and len(table) >= 6
        assert (table[positive] > 0).all(axis=None) and validate._source(name)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda text: text.replace("hb_g_per_l", "hb"), "lacks the column hb_g_per_l"),
        (lambda text: text.replace("0.6918", "-0.6918"), "nail_r must be a number above 0, got -0.6918 in row 1"),
        (lambda text: text.replace("0.6918", "light"), "nail_r must be a number above 0, got light in row 1"),
    ],
)
def test_a_wrong_table_is_refused_in_one_line(tmp_path, change, words):
    text = asset_path("real/nail_photos.csv").read_text(encoding="utf-8")
    (tmp_path / "nail_photos.csv").write_text(change(text), encoding="utf-8")
    with pytest.raises(InputError, match=words) as caught:
        read_people("nail_photos", tmp_path)
    assert "\n" not in str(caught.value)


def test_a_folder_without_any_table_is_refused(tmp_path):
    with pytest.raises(InputError, match="holds none of nail_photos.csv"):
        validate.validate(data=tmp_path)


def test_slopes_within_days_ignore_exposure_between_days():
    """Expected: a slope of 0.3 per 10 g/l is estimated whatever each day adds, within its standard error."""
    rng = np.random.default_rng(1)
    photos = read_people("nail_photos")
    values = 0.03 * photos["hb_g_per_l"].to_numpy() + 50 * photos["day"].to_numpy() + rng.normal(0, 1, len(photos))
    slope, stderr = validate.slope_within_days(photos, values)
    assert abs(slope - 0.3) < 4 * stderr and 0 < stderr < 0.15


def test_nails_carried_over_to_measured_skin_are_pink():
    """Expected: medians of the 160 people as published with the table, by another computation: 62.4, 10.8, 8.8."""
    lab = validate.nails_lab(read_people("nail_photos"), read_people("skin_spectra"))
    assert np.median(lab, 0) == pytest.approx([62.4, 10.8, 8.8], abs=1.1)
    assert (lab[:, 1] < 3).mean() < 0.05


def test_statistics_agree_and_disagree_where_they_should():
    about = {"quantity": "length", "units": "mm", "source": "a table"}
    assert validate._z((1.0, 0.1), (1.1, 0.1), **about).agrees
    assert not validate._z((1.0, 0.1), (1.5, 0.1), **about).agrees
    people, model = np.random.default_rng(2).normal(0, 1, 400), np.array([[-1.96], [0.0], [1.96]])
    covered = validate._coverage(people, model, **about)
    assert covered.agrees and covered.value == pytest.approx(0.95, abs=0.03)
    assert not validate._coverage(people + 2, model, **about).agrees
    # An interval that holds everybody states too much.
    assert not validate._coverage(people, 10 * model, **about).agrees


def test_waves_and_pulse_without_light_agree_with_people():
    waves = validate._waves(read_people("fingertip_waves"))
    shape = validate._contact_pressure(read_people("pulse_against_contact_pressure"))
    assert all(comparison.agrees for comparison in waves.values()) and shape.agrees
    assert shape.x[shape.model[1].argmax()] == 50
    fall = 1 - shape.model[1, -1] / shape.model[1].max()
    assert 0.15 < fall < 0.4


@pytest.mark.long
@pytest.mark.jit
def test_validation_shows_disagreement_first(chosen_jit, tmp_path):
    result = validate.validate(photons=60_000, seed=1, store=False)
    assert {"nail_L", "nail_a", "nail_b", "ring_finger", "spo2_slope", "pulse_red"} <= {*result.tables}
    # Of so few rays only what is plain: the nail is no longer grey.
    assert result.tables["nail_a"].agrees and 4.4 < result.tables["nail_a"].model[1, 0] < 16.4
    text = page.page(result)
    rows = [comparison.agrees for comparison in sorted(result.tables.values(), key=lambda one: one.agrees)]
    assert rows == sorted(rows) and text.count("<svg") == len(result.tables)
    summary = page.summary(result)
    assert {"quantity", "people", "model", "agrees"} <= {*summary["tables"]["nail_L"]}
    assert len(page.lines(summary)) == len(result.tables) + 1

"""What the page shows of traced light is what `simulate` computes from the scene that it exports."""

from typing import Any

import numpy as np
import pytest
from shown import all_shown

import nailoptics as nail
from nailoptics.assets import data_dir
from nailoptics.report.pages.explore import page
from nailoptics.scene.files import parse_scene
from nailoptics.statistics import MIN_EFFECTIVE_TERMS
from nailoptics.studies.exploration import drawn_people, explore as study

EXPLORED, SIMULATED = 400_000, 200_000


@pytest.mark.long
def test_readings_and_their_change_are_those_of_the_exported_scene(
    jit_backend: Any,
    browser: Any,
    coarse_cells: None,
    tmp_path: Any,
    monkeypatch: pytest.MonkeyPatch,
):
    """An LED moved by 0.6 mm: each reading within 2 standard errors of both, but for one in twenty or so."""
    monkeypatch.setattr(study, "FURTHER_LEDS", ())
    # Neither light around the sources nor the rank of people is compared with anything but itself.
    monkeypatch.setattr(study, "FLUENCE_PHOTONS", 1 << 13)
    monkeypatch.setattr(drawn_people, "RANK_PHOTONS", 1 << 13)
    scene = nail.load_scene(data_dir("scenes") / "prototype.toml")
    # Dimmer, as readings that saturate change by nothing.
    dim = tuple(led.model_copy(update={"flux_mw": 0.25 * led.flux_mw}) for led in scene.leds)
    scene = scene.model_copy(update={"leds": dim})
    path = tmp_path / "explore.html"
    monkeypatch.setenv("NAILOPTICS_STORE", str(tmp_path / "light"))
    explored = study.explore(scene, photons=EXPLORED, seed=4)
    path.write_text(page(explored), encoding="utf-8")
    with monkeypatch.context() as patch:
        # What is stored is not traced again, also for other electronics.
        patch.delattr(study.WavelengthSums, "traced")
        again = study.explore(
            scene.model_copy(update={"electronics": type(scene.electronics)()}), photons=EXPLORED, seed=4
        )
    np.testing.assert_equal(again.wavelengths[0].blocks, explored.wavelengths[0].blocks)
    np.testing.assert_equal(again.wavelengths[0].fluence.values, explored.wavelengths[0].fluence.values)
    np.testing.assert_equal(again.ambient_a_per_mm2, explored.ambient_a_per_mm2)
    shown = browser.new_page()
    shown.goto(path.as_uri())
    shown.evaluate("change((layout) => { layout.leds[0].u -= 0.2; layout.leds[0].v += 0.6; layout.force = 0.8; })")
    rows = shown.evaluate("JSON.parse(JSON.stringify(workbench.result.rows))")
    exported = parse_scene(shown.evaluate("smolToml.stringify(toScene(workbench.layout))"), name="exported")
    quiet = exported.model_copy(update={"priors": exported.priors.model_copy(update={"spread": False})})
    result = nail.simulate(quiet, photons=SIMULATED, seed=7)
    held = int(np.flatnonzero(result.force_n.values >= 0.8 - 1e-9)[-1])
    rest, rest_error = (result[name].values[0, :, 0] for name in ("detected_fraction", "detected_fraction_stderr"))
    change, change_error = (1e3 * result[name].values[0, :, held] for name in ("volts_change", "volts_change_stderr"))
    assert [row["element"]["name"] for row in rows] == list(result.photodiode.values)
    pulls = []
    for i, row in enumerate(rows):
        assert not row["few"]
        assert row["restError"] < MIN_EFFECTIVE_TERMS**-0.5 * row["fractionRest"]
        pulls.append((row["fractionRest"] - rest[i]) / np.hypot(row["restError"], rest_error[i]))
        pulls.append((1e3 * row["change"] - change[i]) / np.hypot(1e3 * row["changeError"], change_error[i]))
    assert np.mean(np.abs(pulls) < 2) > 0.85
    assert np.sqrt(np.mean(np.square(pulls))) < 1.5
    shown.close()
    all_shown(explored, page=False)

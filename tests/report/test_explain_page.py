"""The page of an explanation: the worst photodiode with its error first, and what to leave out."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from nailoptics import load_scene
from nailoptics.assets import data_dir
from nailoptics.report.pages import explain
from nailoptics.report.pages.explain import EXPLANATION
from nailoptics.studies.model_error.explain import TOGETHER, Effect, Explanation


def effect(name: str, change: float, stderr: float, **fields: Any) -> Effect:
    values: dict[str, Any] = {"change": change, "stderr": stderr, "bound": abs(change) + 3 * stderr}
    values |= {"modelled": True, "photodiode": "ir on proximal.6", "modulation_bound": 0.1, "tolerance": 0.02}
    values |= {"changed_to": "other", "how": "derived"}
    return Effect(name=name, **(values | fields))


@pytest.fixture
def result() -> Explanation:
    bone = effect("bone", 0.004, 0.001, changes={"light": {"left_out": ["bone"]}})
    effects = (
        effect("plate <absorption>", -0.62, 0.01, unknown=True),
        effect("barrier", 0.5, 0.02),
        effect("cover", -0.2, 0.01, modelled=False),
        effect("index steps", 0.03, 0.02),
        bone,
        effect("ambient light", np.nan, np.inf, bound=np.inf, modelled=False),
    )
    together, scene = replace(bone, name=TOGETHER, bound=0.007), load_scene(data_dir("scenes") / "prototype.toml")
    return Explanation(effects, together, scene, 0.02, 1000, "llvm", 1.0)


def test_the_page_begins_with_the_largest_effect_and_its_error(result, tmp_path):
    paths = EXPLANATION.write(result, tmp_path)
    page = paths["report"].read_text(encoding="utf-8")
    head, body = page.split("</header>")
    assert "<h1>Plate &lt;absorption&gt; (other): the reading of LED ir" in head
    assert "on photodiode proximal.6 changes by −62.0" in head
    assert all(f"<td>{change}</td>" in body for change in ("−62.0 ± 1.0", "+50.0 ± 2.0", "−20.0 ± 1.0"))
    assert "[light] left_out = [&quot;bone&quot;]" in body and "changes no reading by more than 0.70 %" in body
    assert "though it matters: cover." in body and "more photons are needed: index steps, ambient light" in body
    assert "not known" in body and "pooled" not in page
    assert load_scene(paths["scene"]) == result.required


def test_an_undecided_effect_is_no_headline_beside_a_significant_one(result, tmp_path):
    noisy = effect("forward scattering", -0.9, 0.4)
    assert noisy.matters == "undecided"
    for shown, name in (((noisy, *result.effects), "Plate &lt;absorption&gt;"), ((noisy,), "Forward scattering")):
        page = EXPLANATION.write(replace(result, effects=shown), tmp_path)["report"]
        assert f"<h1>{name} (other): the reading" in page.read_text(encoding="utf-8")


def test_the_picture_names_every_estimated_effect(result):
    axes = explain.draw(result).axes[0]
    names = [text.get_text() for text in axes.get_yticklabels()]
    assert names == [one.name for one in result.effects if np.isfinite(one.change)]
    dots = np.concatenate([line.get_xdata() for line in axes.lines if line.get_marker() == "o"])
    assert np.allclose(sorted(dots), [0.4, 3, 20, 50, 62])


def test_an_incomplete_result_reports_it_first(result, tmp_path):
    cut = replace(result, attributes={"cut_off": "max_seconds ended the study"}, effects=(), together=None)
    paths = EXPLANATION.write(cut, tmp_path)
    assert paths["scene"].read_text(encoding="utf-8").startswith("# Cut off: max_seconds ended the study\n")
    page = paths["report"].read_text(encoding="utf-8")
    assert "Cut off: max_seconds ended the study" in page.split("</header>")[0] and "Too few photons" in page

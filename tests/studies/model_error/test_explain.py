"""What a scene models and leaves out: which effects matter, and with what significance."""

import json
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from shown import all_shown

from nailoptics import cli, load_scene, tissue
from nailoptics.assets import data_dir
from nailoptics.errors import InputError, NotReachedError
from nailoptics.light import Transfer, optics
from nailoptics.light.transfer.records import LedTrace
from nailoptics.options import TraceOptions
from nailoptics.report.pages.explain import lines as explanation_lines
from nailoptics.scene import Scene, parse_scene
from nailoptics.statistics import Z95, magnitude_bound_95
from nailoptics.studies.model_error import explain as effects, paired
from nailoptics.studies.model_error.explain import (
    ONE_WAVELENGTH,
    PART_WIDTH,
    SCATTERING_FACTOR,
    Change,
    Changes,
    Effect,
    Explanation,
    changes_between,
    effect_of,
    explain,
    lines_of,
    merged,
    revised,
)
from nailoptics.studies.model_error.paired import (
    UNDETECTED,
    Difference,
    Estimates,
    PairedReadings,
    PairedTracer,
    difference,
    paired_readings,
    reweighted,
    weighted_mean,
)

TEXT = (data_dir("scenes") / "prototype.toml").read_text(encoding="utf-8")
WHOLE: Changes = {"light": {"left_out": []}, "finger": {"length_mm": 20.0}, **PART_WIDTH}


def prototype() -> Scene:
    return load_scene(data_dir("scenes") / "prototype.toml")


def whole() -> Scene:
    """The prototype with all that it leaves out put back."""
    return revised(prototype(), WHOLE)


@pytest.fixture(scope="module")
def computed(chosen_jit):
    return explain(whole(), photons=1_000_000, seed=3)


def traced(scene: Scene, *, photons: int, seed: int) -> PairedReadings:
    return PairedTracer(1, TraceOptions(photons=photons, seed=seed), None).trace(scene)


@pytest.mark.slow
@pytest.mark.jit
def test_the_barrier_matters_and_the_lines_width_does_not(computed):
    by_name = {e.name: e for e in computed.effects}
    barrier, width = by_name["barrier"], by_name["LED line width"]
    assert barrier.matters == "yes" and barrier.change > 1 and barrier.modelled
    assert width.matters == "no" and width.how == "reweighted" and 0 < width.bound < 0.01
    assert by_name["melanin"].matters == "no"
    assert by_name["ambient light"].modelled is False and by_name["ambient light"].bound > 0
    # Bone is met by few photons: what these alone make up is estimated far better than by two separate traces.
    assert by_name["bone"].stderr < 0.5 * by_name["index steps"].stderr


@pytest.mark.slow
@pytest.mark.jit
def test_the_lines_that_leave_out_the_needless_make_the_required_scene(computed):
    """Expected: the lines, pasted under their tables, make the required scene, which reads as the whole one does."""
    lines = lines_of(merged(computed.needless))
    assert all(f"  {line}" in explanation_lines(computed) for line in lines)
    assert "[[leds]] fwhm_nm = 0.0" in lines
    text = TEXT.split("[light]")[0].replace("fwhm_nm = 0.0\n", "")
    text += "[light]\n[accuracy]\nrelative_error = 0.02\n"
    length = WHOLE["finger"]["length_mm"]
    for line in [f"[finger] length_mm = {length}", *lines]:
        table, pasted = line.split(" ", 1)
        text = re.sub(rf"^{re.escape(table)}.*", rf"\g<0>\n{pasted}", text, flags=re.MULTILINE)
    assert parse_scene(text).model_dump() == computed.required.model_dump()
    assert computed.together.matters == "no" and computed.together.bound <= computed.tolerance


@pytest.mark.slow
@pytest.mark.jit
def test_the_shipped_prototype_models_what_matters_and_nothing_else(chosen_jit):
    """Rationale: the default scene is derived from what explain measures. Expected: nothing in it is needless, and
    nothing that a line could put in is missing, at its own tolerance."""
    computed = explain(prototype(), photons=1_000_000, seed=11)
    assert [e.name for e in computed.needless] == []
    assert [e.name for e in computed.missing if e.changes] == []
    assert {"LED line width", "epidermis"} <= {e.name for e in computed.effects if not e.modelled and e.matters == "no"}


@pytest.mark.long
@pytest.mark.jit
def test_rereading_is_what_tracing_with_the_same_photons_would_give(jit_backend):
    """Rationale: what only dims light needs no new trace. Expected: the two agree to rounding."""
    narrow, wide = (revised(prototype(), width) for width in (ONE_WAVELENGTH, PART_WIDTH))
    base, other = (traced(scene, photons=60_000, seed=1) for scene in (wide, narrow))
    again = reweighted(base, narrow)
    assert np.allclose(again.level, other.level, rtol=1e-6)
    assert 0 < np.abs(again.level / base.level - 1).max() < 0.01


@pytest.mark.long
@pytest.mark.jit
def test_a_difference_has_the_noise_of_the_photons_that_differ(jit_backend):
    """Rationale: photons that never meet the bone are the same with and without it.
    Expected: the difference's error is far below that of two traces apart, and never zero where no photon differs."""
    base = traced(whole(), photons=60_000, seed=5)
    bone, skin = (
        traced(revised(whole(), {"light": {"left_out": [part]}}), photons=60_000, seed=5)
        for part in ("bone", "epidermis")
    )
    independent = traced(whole(), photons=60_000, seed=6)
    away = difference(base, independent)
    assert (difference(base, bone).reading.stderr < 0.7 * away.reading.stderr).all()
    assert (difference(base, skin).reading.stderr > 0.1 * UNDETECTED * base.relative_stderr**2).all()
    # No photon met the epidermis: melanin changes no detected light, which is not a change of zero.
    pale = difference(base, reweighted(base, revised(whole(), {"finger": {"melanin_fraction": 0.0}})))
    assert (pale.reading.stderr >= 0.99 * UNDETECTED * base.relative_stderr**2)[pale.reading.value == 0].all()
    # The same scene twice: nothing but noise, as large as reported.
    z = away.reading.value / away.reading.stderr
    assert np.abs(z).max() < 4 and 0.6 < np.sqrt(np.mean(z**2)) < 1.8
    same = difference(base, paired_readings(replace(base.transfer, traces=tuple(base.transfer.traces))))
    assert np.all(same.reading.value == 0)


@pytest.mark.slow
@pytest.mark.jit
def test_effects_that_are_read_from_one_trace_have_calibrated_errors(chosen_jit):
    """Rationale: on a narrow nail a few photons cross the skin and carry all that melanin does; line width changes
    every photon a little. Expected: over 20 seeds, 95 % intervals cover the value of sixty times the photons at
    the nominal rate, as far as errors from a handful of photons can."""
    changes = {"finger": {"nail_width_mm": 4.0, "melanin_fraction": 0.4}}
    scene = revised(whole(), WHOLE | {"finger": WHOLE["finger"] | changes["finger"]})
    others = [revised(scene, {"finger": {"melanin_fraction": 0.0}}), revised(scene, ONE_WAVELENGTH)]

    def computed(photons: int, seed: int) -> tuple[PairedReadings, list[Difference]]:
        base = traced(scene, photons=photons, seed=seed)
        every = [difference(base, reweighted(base, other)) for other in others]
        return base, every

    def numbers(every: list[Difference]) -> np.ndarray:
        return np.array([list(zip(*(one[:3] for one in d), strict=True)) for d in every])

    exact, seeds = computed(2_400_000, 99), [computed(40_000, seed) for seed in range(20)]
    truth, each = numbers(exact[1]), np.array([numbers(every) for _, every in seeds])
    z = (each[:, :, 0] - truth[:, 0]) / np.hypot(each[:, :, 1], truth[:, 1])
    assert np.isfinite(z).all() and (each[:, :, 1] > 0).all()
    covered = (np.abs(z) < Z95).mean(axis=(0, 3, 4))
    assert (covered > 0.87).all(), covered
    # The value of sixty times the photons is an estimate, too, with an error of its own.
    most = magnitude_bound_95(each[:, :, 0], np.hypot(each[:, :, 1], truth[:, 1]), each[:, :, 2])
    held = (most >= np.abs(truth[:, 0])).mean(axis=(0, 3, 4))
    assert (held > 0.9).all(), held
    # Far too large errors would pass unnoticed: these are what the values scatter by.
    assert (np.sqrt((z**2).mean(axis=(0, 3, 4))) > 0.7).all()
    for k, one in enumerate(exact[1]):
        assert_printed([(base, every[k]) for base, every in seeds], one)


@pytest.mark.slow
@pytest.mark.jit
def test_effects_that_are_retraced_have_calibrated_errors(chosen_jit, monkeypatch):
    """Rationale: scenes traced with the same photons differ by those that do not share their way: a few percent where a
    part goes, all where the optics change. Expected: over 20 seeds, 95 % intervals of every photodiode, and of their
    weighted mean, cover the value of twenty times the photons at that rate; so do those of what is derived from
    such traces, blood's scattering and light from outside."""
    others = [revised(whole(), {"light": {"left_out": ["bone"]}}), revised(whole(), {"light": {"index_steps": False}})]
    others.append(revised(whole(), {"finger": {"bed_scattering": SCATTERING_FACTOR}}))
    assert whole().finger.bed_scattering == 1.0

    derived, printed = [], []
    differences: list[Difference] = []

    def kept(change: Change, computed: Difference, *more: Any, **named: Any) -> Effect:
        differences.append(computed)
        return effect_of(change, computed, *more, **named)

    monkeypatch.setattr(effects, "effect_of", kept)

    def computed(photons: int, seed: int) -> np.ndarray:
        base, out = traced(whole(), photons=photons, seed=seed), []
        *_, denser = others_traced = [traced(other, photons=photons, seed=seed) for other in others]
        effects.blood_scattering(0.02, base, denser)
        effects.ambient(0.02, TraceOptions(seed=seed, store=False), base)
        scattered, outside = differences[-2:]
        derived.append([(of.value[0], of.stderr[0]) for of in (scattered.signal, outside.reading)])
        retraced = [(base, one) for one in differences[-2:]]
        every = [difference(base, other) for other in others_traced]
        printed.append([*((base, d) for d in every), *retraced])
        for d in every:
            means = [weighted_mean(one, base) for one in d]
            each = [[d.reading.value[0], d.signal.value[0]], [d.reading.stderr[0], d.signal.stderr[0]]]
            out.append(np.concatenate([each, np.transpose(means)[..., None]], axis=-1))
        return np.array(out)

    truth, each = computed(800_000, 99), np.array([computed(40_000, seed) for seed in range(20)])
    z = (each[:, :, 0] - truth[:, 0]) / np.hypot(each[:, :, 1], truth[:, 1])
    assert np.isfinite(z).all()
    photodiodes, means = np.abs(z[..., :-1]) < Z95, np.abs(z[..., -1]) < Z95
    assert (photodiodes.mean(axis=(0, 3)) > 0.87).all(), photodiodes.mean(axis=(0, 3))
    assert (means.sum(0) >= 16).all(), means.sum(0)
    (exact, *values), (error, *errors) = np.moveaxis(derived, 2, 0)
    held = np.abs(np.subtract(values, exact)) < Z95 * np.hypot(errors, error)
    assert (held.mean(axis=(0, 2)) > 0.87).all(), held.mean(axis=(0, 2))
    for of_exact, *of_seeds in zip(*printed, strict=True):
        assert_printed(of_seeds, of_exact[1])
    # Errors far too large would pass unnoticed.
    assert (np.sqrt((z[..., :-1] ** 2).mean(axis=(0, 3))) > 0.5).all()


def assert_printed(seeds: list[tuple[PairedReadings, Difference]], exact: Difference) -> None:
    """The line that is printed of an effect: the photodiode that is named, and what none exceeds, of 20 seeds."""
    held = []
    for base, computed in seeds:
        one = effect_of(Change("any", True, ""), computed, base, tolerance=0.02)
        j = [f"{base.transfer.leds[0]} on {name}" for name in base.transfer.photodiodes].index(one.photodiode)
        reference = exact.signal if one.of == "signal" else exact.reading
        away = abs(one.change - reference.value[0, j]) / np.hypot(one.stderr, reference.stderr[0, j])
        # The values of many photons have errors of their own.
        least, least_swing = (np.max(np.abs(of.value) - Z95 * of.stderr) if of else 0.0 for of in exact)
        bounded = one.bound >= (least_swing if one.of == "signal" else least)
        held.append((away < Z95, bounded, one.modulation_bound is None or one.modulation_bound >= least_swing))
    # Of 20 at 95 % fewer than 16 would come once in four hundred times.
    assert (np.sum(held, axis=0) >= 16).all(), np.sum(held, axis=0)


def synthetic(scene: Scene, paths_mm: tuple[float, float], weight: float, photons: int = 40_000) -> PairedReadings:
    """Every photodiode's light with these paths in both zones of the bed, so much of it."""
    names, count = optics.absorbers(scene), len(scene.layout.photodiode_names)
    path = np.zeros((count * 1000, len(names)), np.float32)
    path[:, [names.index("bed_1"), names.index("bed_2")]] = paths_mm
    light = LedTrace(
        photons=photons,
        mu_a=optics.absorption(scene, 800.0)[0],
        photon=np.arange(len(path)),
        photodiode=np.repeat(np.arange(count), 1000),
        weight=np.full(len(path), weight),
        path_mm=path,
        energy={},
        seeds=(0,),
    )
    return paired_readings(Transfer(scene, (light,), "none", engine="made up", versions={"numpy": "0"}))


@pytest.mark.parametrize("paths_mm", [(4.0, 0.0), (1.0, 3.0)])
def test_scattering_of_blood_is_evaluated_by_the_signal(paths_mm):
    """Rationale: at rest it is part of the bed's measured scattering, so that it moves the touch's change alone; blood
    scatters less than the dermis whose place it takes. Expected: the slope of ln reading by ln mu_s', here 2, times the
    relative change of mu_s' along the path, as a fraction of the signal; beyond a tolerance of 2 % it matters."""
    scene = revised(prototype(), ONE_WAVELENGTH)
    base, denser = synthetic(scene, paths_mm, 1.0), synthetic(scene, paths_mm, SCATTERING_FACTOR**2)
    computed = effects.blood_scattering(0.02, base, denser)
    share, blood = np.array(paths_mm) / 4, np.diff(paired.end_states(scene), axis=0)[0]
    mu_a = float(tissue.blood_mu_a_per_mm(800.0, scene.blood.rest_so2))
    # Of skin at 800 nm mu_s' is 4.60 (800 / 500)^-1.421 per mm, of blood 1.34.
    more = 2 * (1.34 / (4.60 * 1.6**-1.421) - 1) * (share @ blood)
    signal = np.expm1(-mu_a * blood @ paths_mm)
    assert computed.of == "signal" and computed.change == pytest.approx(more / abs(signal), rel=1e-3)
    assert computed.bound > abs(computed.change) > 0.1 and "replaces" in computed.changed_to
    assert computed.modulation_bound == pytest.approx(computed.bound)


def test_what_moves_no_reading_by_the_tolerance_is_evaluated_by_the_signal():
    """Expected: 0.1 % of a reading but 30 % of the signal matters; beyond the tolerance the reading decides, and where
    a touch moves no blood."""
    usual = revised(prototype(), ONE_WAVELENGTH)
    base, still = (synthetic(one, (4.0, 0.0), 1.0) for one in (usual, revised(usual, {"touch": {"force_n": 0.0}})))
    some = np.full(base.level.shape, 1e-3)
    signal = Estimates(300 * some, 10 * some)
    change = effects.Change("bone", True, "none")
    for reading, of, expected in ((some, "signal", 0.3), (100 * some, "reading", 0.1)):
        one = effect_of(change, Difference(Estimates(reading, 0.1 * some), signal), base, tolerance=0.02)
        assert one.of == of and one.change == pytest.approx(expected) and one.matters == "yes"
    one = effect_of(change, Difference(Estimates(some, 0.1 * some), signal), still, tolerance=0.02)
    assert one.of == "reading" and one.matters == "no"


def test_changes_are_reported_as_lines_that_make_them():
    scene = whole()
    changes = {"light": {"left_out": ["epidermis", "kapton"], "index_steps": False}} | ONE_WAVELENGTH
    other = revised(scene, changes)
    assert other.light.left_out == ("epidermis", "kapton") and all(led.fwhm_nm == 0 for led in other.leds)
    assert changes_between(scene, other) == changes and changes_between(other, other) == {}
    assert revised(other, changes_between(other, scene)).model_dump() == scene.model_dump()
    expected = ['[light] left_out = ["epidermis", "kapton"]', "[light] index_steps = false", "[[leds]] fwhm_nm = 0.0"]
    assert sorted(lines_of(changes)) == sorted(expected)


def needless_effect(name: str) -> Effect:
    """An effect that changes nothing."""
    none = dict.fromkeys(("change", "stderr", "bound"), 0.0)
    return Effect(name, True, "", how="derived", photodiode="", modulation_bound=0.0, tolerance=0.02, **none)


def effect(name: str, changes: dict, *, modelled: bool = True) -> Effect:
    return replace(needless_effect(name), modelled=modelled, changes=changes)


def test_parts_that_are_not_needed_are_left_out_together():
    bone, skin = (effect(p, {"light": {"left_out": [p]}}) for p in ("bone", "epidermis"))
    melanin = effect("melanin", {"finger": {"melanin_fraction": 0.0}})
    assert merged([bone, melanin]) == {"light": {"left_out": ["bone"]}, "finger": {"melanin_fraction": 0.0}}
    # Melanin goes with the epidermis.
    assert merged([bone, skin, melanin]) == {"light": {"left_out": ["bone", "epidermis"]}}
    back = effect("bone", {"light": {"left_out": ["kapton"]}}, modelled=False)
    assert merged([effect("x", {"light": {"left_out": ["bone", "kapton"]}}), back])["light"]["left_out"] == ["kapton"]


@pytest.mark.parametrize(
    ("change", "stderr", "bound", "matters"),
    [(0.10, 0.01, 0.12, "yes"), (0.01, 0.003, 0.016, "no"), (0.04, 0.01, 0.06, "undecided"), (0.0, 0.0, 0.0, "no")],
)
def test_an_effect_matters_only_if_it_is_significant(change, stderr, bound, matters):
    values = {"change": change, "stderr": stderr, "bound": bound}
    assert replace(needless_effect("x"), **values).matters == matters


def test_what_cannot_be_explained_is_one_line():
    phantom = load_scene(data_dir("scenes") / "phantom.toml")
    with pytest.raises(InputError, match="finger"):
        explain(phantom)
    with pytest.raises(InputError, match="tolerance"):
        explain(prototype(), tolerance=2.0)


@pytest.mark.slow
@pytest.mark.jit
def test_the_command_prints_one_json_object_and_writes_the_required_scene(jit_backend, capsys, tmp_path):
    written = tmp_path / "required.toml"
    assert cli.run(["explain", "prototype", "--json", "--photons", "20000", "-o", str(written)]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert {"effects", "tolerance", "photons", "together"} <= printed.keys() and len(printed["effects"]) >= 10
    assert all(row["matters"] in ("yes", "no", "undecided") for row in printed["effects"])
    assert printed["scene"] == str(written) and load_scene(written).finger is not None


@pytest.mark.jit
def test_an_interrupt_keeps_the_effects_that_were_measured(jit_backend, coarse_cells):
    def stop(p):
        if "trace 3 " in p.led:
            raise KeyboardInterrupt

    with pytest.raises(NotReachedError, match="interrupted") as caught:
        explain(prototype(), photons=8192, progress=stop)
    result = caught.value.result
    assert isinstance(result, Explanation)
    names = [e.name for e in result.effects]
    assert "index steps" in names and "barrier" not in names
    all_shown(result)


@pytest.mark.long
@pytest.mark.jit
def test_a_time_limit_keeps_what_was_measured_and_is_reported(jit_backend, coarse_cells, monkeypatch, tmp_path, capsys):
    """Whatever the clock: after three traces no time is left."""
    monkeypatch.setattr(PairedTracer, "seconds_left", property(lambda tracer: 1.0 if tracer._done < 3 else -1.0))
    written = tmp_path / "required.toml"
    arguments = ["explain", "prototype", "--photons", "8192", "--max-seconds", "500", "-o", str(written)]
    assert cli.run([*arguments, "--json"]) == 3
    printed = json.loads(capsys.readouterr().out)
    assert printed["cut_off"].startswith("max_seconds ended the study after 3 of")
    names = {row["name"] for row in printed["effects"]}
    assert {"index steps", "forward scattering"} <= names and not {"bone", "barrier", "ambient light"} & names
    assert written.read_text().startswith("# Cut off: max_seconds ended ") and load_scene(written).finger is not None
    assert cli.run(arguments) == 3
    assert capsys.readouterr().out.startswith("Cut off: max_seconds ended ")


@pytest.mark.jit
def test_an_interrupt_of_the_scenes_own_trace_leaves_nothing(jit_backend):
    def stop(p):
        raise KeyboardInterrupt

    with pytest.raises(NotReachedError, match="interrupted") as caught:
        explain(prototype(), photons=8192, progress=stop)
    assert caught.value.result is None


@pytest.mark.jit
@pytest.mark.parametrize("still", [{"blood": {"rest_blood_fraction": 0.0}}, {"touch": {"force_n": 0.0}}])
def test_readings_that_no_touch_changes_have_effects_but_no_signal(jit_backend, still):
    base = traced(revised(prototype(), still), photons=20_000, seed=1)
    change = Change("absorption", True, "twice", {"finger": {"bed_absorption": 2.0}})
    effect = effects.by_change(change, 0.02, base)
    assert effect.of == "reading" and effect.change < -0.02 and effect.modulation_bound is None
    scattering = effects.blood_scattering(0.02, base, traced(base.transfer.scene, photons=20_000, seed=1))
    assert scattering.change == 0 and scattering.matters == "no"


@pytest.mark.long
@pytest.mark.jit
def test_undetected_light_has_no_estimate(jit_backend, coarse_cells, few_photons_beside):
    """A handful of photons: no number, no verdict, no warning, and nothing taken for needless."""
    computed = explain(prototype(), photons=100)
    retraced = [e for e in computed.effects if e.how == "retraced"]
    assert retraced and all(e.matters == "undecided" for e in retraced)
    assert (
        "not known" in "\n".join(explanation_lines(computed))
        and computed.needless == []
        and computed.required.light == prototype().light
    )

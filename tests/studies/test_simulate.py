"""The main job, from touch to volts: its signs, its dataset, its seeds, and what is kept when it is cut short."""

import os
import subprocess
import sys
import tracemalloc
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from shown import all_shown
from small_scenes import phantom

from nailoptics import variables
from nailoptics.assets import data_dir
from nailoptics.errors import InputError, NotReachedError
from nailoptics.hemodynamics.for_scene import blood_model, blood_over_touch, hold_end
from nailoptics.io import write_dataset
from nailoptics.light import detect, open_light
from nailoptics.options import TraceOptions
from nailoptics.scene import Ambient, Body, Electronics, Heartbeat, Scene, digest, load_scene, parse_scene, to_toml
from nailoptics.sensor.volts import WornLight
from nailoptics.studies.exploration.explore import explore
from nailoptics.studies.force.calibrate import calibrate
from nailoptics.studies.force.reading_table import record
from nailoptics.studies.model_error.tradeoff import tradeoff
from nailoptics.studies.oximetry.oxygen import oximeter
from nailoptics.studies.placement.place import place
from nailoptics.studies.simulate import simulate, simulate_from

# Priors that need traces of their own, but for one: each takes as long as the scene's own light of few photons.
KNOWN_PRIORS = (
    "finger.plate_scattering",
    "finger.bone_scattering",
    "finger.pulp_scattering",
    "finger.nail_thickness_mm",
    "finger.bed_thickness_mm",
)
PHOTONS = 1 << 18


def prototype(**touch) -> Scene:
    """The prototype, whose only prior of scattering is that of the bed, touched differently."""
    scene = load_scene(data_dir("scenes") / "prototype.toml")
    priors = scene.priors.model_copy(update={"known": KNOWN_PRIORS})
    return scene.model_copy(update={"touch": scene.touch.model_copy(update=touch), "priors": priors})


def quiet(scene: Scene) -> Scene:
    """The scene without the uncertainty due to its priors."""
    return scene.model_copy(update={"priors": scene.priors.model_copy(update={"spread": False})})


@pytest.fixture(scope="module")
def own_store(tmp_path_factory) -> Path:
    """The store of all light in this file."""
    return tmp_path_factory.mktemp("store")


@pytest.fixture(scope="module")
def pressed(chosen_jit, own_store) -> dict[str, xr.Dataset]:
    """The prototype touched as shipped, and with the force on one side only; the same photons for all three."""
    scenes = {"as shipped": prototype()}
    scenes |= {name: quiet(prototype(proximal_share=share)) for name, share in (("proximal", 1.0), ("distal", 0.0))}
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NAILOPTICS_STORE", str(own_store))
        return {
            name: simulate(scene, photons=PHOTONS, seed=1, picture=name == "as shipped")
            for name, scene in scenes.items()
        }


def largest_change(result: xr.Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Each photodiode's largest change under the first LED and its standard error. [V]"""
    change, stderr = (result[name].values[0] for name in ("volts_change", "volts_change_stderr"))
    at = np.abs(change).argmax(-1)[:, None]
    return np.take_along_axis(change, at, -1)[:, 0], np.take_along_axis(stderr, at, -1)[:, 0]


@pytest.mark.long
@pytest.mark.jit
def test_a_traced_touch_shows_itself(pressed):
    assert "section" in all_shown(pressed["as shipped"], page=False)


@pytest.mark.jit
def test_every_proximal_reading_falls_with_proximal_force(pressed):
    change, stderr = largest_change(pressed["proximal"])
    proximal = pressed["proximal"].zone_of_photodiode.values == 0
    assert proximal.sum() == 4 and np.all(change[proximal] < -5 * stderr[proximal])


@pytest.mark.jit
def test_every_distal_reading_rises_with_distal_force(pressed):
    change, stderr = largest_change(pressed["distal"])
    distal = pressed["distal"].zone_of_photodiode.values == 1
    assert distal.sum() == 4 and np.all(change[distal] > 5 * stderr[distal])


@pytest.mark.jit
def test_as_shipped_the_outermost_readings_change_in_opposite_directions(pressed):
    """One force on both sides: the proximal end darkens while the distal end brightens."""
    change, stderr = largest_change(pressed["as shipped"])
    assert change[0] < -5 * stderr[0] and change[-1] > 5 * stderr[-1]


@pytest.mark.jit
def test_readings_are_back_when_the_touch_is_over(pressed):
    """The press ends at 2.25 s of 4 s; by then nearly all of the change is gone."""
    result = pressed["as shipped"]
    change, stderr = largest_change(result)
    assert np.all(abs(result.volts_change.values[0, :, -1]) < 0.1 * abs(change))
    assert np.all(abs(result.volts_change.values[..., 0]) < 1e-6 * abs(change))
    assert np.all(result.volts_change_stderr.values[..., 0] < 1e-3 * stderr)


@pytest.mark.jit
def test_changes_are_sharper_than_readings(pressed):
    for result in pressed.values():
        _, stderr = largest_change(result)
        assert np.all(stderr < 0.3 * result.volts_stderr.values[0, :, 0])


def assert_well_described(result: xr.Dataset) -> None:
    """CF's demands: units and a long name on every variable, errors named, and the provenance stated."""
    for name, variable in result.variables.items():
        assert variable.attrs.get("long_name"), name
        if variable.dtype.kind in "fiu" and name != "section_region":
            assert "units" in variable.attrs, name
        for other in variable.attrs.get("ancillary_variables", "").split():
            assert other in result.variables and result[other].dims == variable.dims, (name, other)
    for name in ("detected_fraction", "volts", "volts_change", "mean_path_mm"):
        assert result[name].attrs["ancillary_variables"] == f"{name}_stderr"
    attrs = result.attrs
    assert attrs["Conventions"].startswith("CF-") and attrs["title"] and "2001" in attrs["references"]
    assert {"seed", "engine", "backend", "photons", "cpu_seconds", "wall_seconds", "accuracy_reached"} <= attrs.keys()
    for package in ("nailoptics=", "mitsuba=", "drjit=", "numpy="):
        assert package in attrs["versions"]
    scene = parse_scene(attrs["scene"])
    assert digest(scene) == attrs["digest"]


@pytest.mark.long
@pytest.mark.jit
def test_stored_light_needs_no_mitsuba_until_a_part_of_it_is_gone(pressed, own_store, tmp_path):
    """Rationale: loading Mitsuba and its kernels is most of what a second run would cost. Expected: with other blood
    and touch, photons and picture both come from the store; where the picture is gone, it alone is traced."""
    code = """if True:
        import sys
        from pathlib import Path
        from nailoptics import load_scene, simulate
        scene = load_scene(sys.argv[1])
        priors = scene.priors.model_copy(update={"known": tuple(sys.argv[5:])})
        scene = scene.model_copy(update={"priors": priors})
        def changed(part, **values):
            return scene.model_copy(update={part: getattr(scene, part).model_copy(update=values)})
        for other in (changed("blood", rest_blood_fraction=0.035), changed("touch", force_n=2.0)):
            simulate(other, photons=int(sys.argv[4]), seed=1, picture=True)
        assert not {"mitsuba", "drjit"} & set(sys.modules)
        for file in Path(sys.argv[2]).glob("*/section.dat"):
            file.unlink()
        result = simulate(scene, photons=int(sys.argv[4]), seed=1, picture=True)
        assert "mitsuba" in sys.modules and result.attrs["reused"]
        result.path_density.to_netcdf(sys.argv[3])
    """
    section = tmp_path / "section.nc"
    given = [str(one) for one in (data_dir("scenes") / "prototype.toml", own_store, section, PHOTONS, *KNOWN_PRIORS)]
    environment = os.environ | {"NAILOPTICS_STORE": str(own_store), "PYTHONPATH": str(Path(__file__).parents[2])}
    done = subprocess.run([sys.executable, "-c", code, *given], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    with xr.open_dataarray(section) as again:
        assert np.array_equal(again, pressed["as shipped"].path_density)


@pytest.mark.jit
def test_the_result_describes_its_variables_and_origin(pressed):
    result = pressed["as shipped"]
    assert_well_described(result)
    assert result.attrs["seed"] == 1 and result.attrs["engine"] == "photons"
    assert parse_scene(result.attrs["scene"]) == prototype()
    assert {"led": 1, "photodiode": 8, "zone": 2, "time": 401}.items() <= dict(result.sizes).items()
    for name in ("volts_beer_lambert", "volts_taylor", "path_density", "force_n", "capillary_diameter_m"):
        assert np.isfinite(result[name].values).all()


@pytest.mark.jit
def test_the_light_tallied_by_region_is_all_that_was_emitted(pressed):
    """Expected: parts that add up, and on photodiodes what all of them detect, within the errors of both, which exceed
    what the LED's line makes."""
    result = pressed["as shipped"].isel(led=0)
    ends, absorbed = (result[name].to_series() for name in ("energy_fraction", "absorbed_fraction"))
    assert ends.sum() == pytest.approx(1, abs=1e-9) and absorbed.sum() == pytest.approx(ends["absorbed"], abs=1e-9)
    error = float(result.absorbed_fraction_stderr.sel(region="photodiodes"))
    error = np.hypot(error, float(np.sqrt(np.sum(result.detected_fraction_stderr[:, 0] ** 2))))
    assert absorbed["photodiodes"] == pytest.approx(float(result.detected_fraction[:, 0].sum()), abs=4 * error)
    assert error < 0.016 * absorbed["photodiodes"]
    assert min(absorbed[["cover", "bed", "bone", "plate"]]) > 0.02 and (result.energy_fraction_stderr < 2e-3).all()


@pytest.mark.jit
def test_the_reduced_optics_follow_the_traced_volts(pressed):
    """(8) and (9), fitted to small changes, leave less than a third of the change of the outermost photodiodes."""
    result = pressed["as shipped"]
    change, _ = largest_change(result)
    for name in ("beer_lambert", "taylor"):
        residual = result[f"{name}_residual_rms_v"].values[0]
        assert np.all(residual[[0, -1]] < 0.3 * abs(change[[0, -1]]))
        off = result.volts.values[0] - result[f"volts_{name}"].values[0]
        assert np.allclose(np.sqrt(np.mean(off**2, -1)), residual, rtol=0.05, atol=1e-9)


@pytest.mark.long
@pytest.mark.jit
def test_fitted_constants_scatter_over_seeds_by_their_standard_errors(chosen_jit):
    """Rationale: all samples of a reading share the photons' noise, so what they miss of a curve is not its error.
    Expected: of ten traces of few photons, 95 % intervals of the constants of Taylor (9) and Beer-Lambert (8) hold
    their mean at their nominal rate, and the spread over the traces is the stated one."""
    scene = quiet(load_scene(data_dir("scenes") / "static_proximal.toml"))
    results = [simulate(scene, photons=30_000, seed=seed) for seed in range(10)]
    for name in ("taylor_v0_v", "taylor_v1_v_per_m2", "beer_lambert_v1_v", "beer_lambert_alpha_per_m2"):
        value, error = (np.array([r[name + end].values[0] for r in results]) for end in ("", "_stderr"))
        known = np.isfinite(error).all(0)
        z = ((value - value.mean(0)) / np.sqrt(0.9) / error)[:, known]
        assert known.sum() >= 4 and (np.abs(z) < 1.96).mean() > 0.85 and 0.6 < np.sqrt(np.mean(z**2)) < 1.5, name


@pytest.mark.jit
def test_a_result_survives_its_file(pressed, tmp_path):
    path = tmp_path / "result.nc"
    write_dataset(pressed["as shipped"], path)
    with xr.open_dataset(path) as stored:
        again = stored.load()
    xr.testing.assert_identical(again.drop_attrs(), pressed["as shipped"].drop_attrs())
    for name in ("scene", "digest", "seed", "versions", "photons"):
        assert again.attrs[name] == pressed["as shipped"].attrs[name]
    assert [p.name for p in tmp_path.iterdir()] == ["result.nc"]


@pytest.mark.long
@pytest.mark.jit
def test_the_same_seed_gives_the_same_bits_and_another_one_others(chosen_jit):
    first, second, other = (simulate(prototype(), photons=1 << 14, seed=seed) for seed in (5, 5, 6))
    xr.testing.assert_identical(first.drop_attrs(), second.drop_attrs())
    assert not np.array_equal(first.volts, other.volts)


@pytest.mark.long
@pytest.mark.jit
def test_of_very_many_samples_what_there_is_of_each_is_single(chosen_jit, monkeypatch, own_store, tmp_path):
    """Rationale: a million samples of eight readings, each with its errors, noise and fits, are 0.7 GB in double
    precision. Expected: all that is stored of few samples, to the 6e-8 of single precision, times in double, and the
    same from the file."""
    monkeypatch.setenv("NAILOPTICS_STORE", str(own_store))
    scene, options = prototype(), {"photons": 1 << 14, "seed": 5}
    few = simulate(scene, **options)
    monkeypatch.setattr(variables, "MANY_SAMPLES", 400)
    many = simulate(scene, **options)
    assert many.time.dtype == few.volts.dtype == float and many.volts.dtype == many.blood_fraction.dtype == np.float32
    write_dataset(many, tmp_path / "result.nc")
    # A change has the precision of the reading that it is a change of; zones' ends are means of many samples.
    least = {"volts_change": 2e-7 * few.volts.max(), "volts_change_stderr": 1e-7 * few.volts_stderr.max()}
    with xr.open_dataset(tmp_path / "result.nc") as stored:
        assert set(stored.variables) == set(many.variables) == set(few.variables)
        for name, one in few.data_vars.items():
            if "time" in one.dims:
                assert np.allclose(many[name], one, rtol=3e-7, atol=float(least.get(name, 0.0))), name
                assert np.array_equal(many[name], stored[name], equal_nan=True), name


AMBIENT_NAMES = {f"ambient_{name}" for name in ("a", "fraction", "volts", "left_v", "flicker_v", "noise_v")}


@pytest.fixture(scope="module")
def in_ambient_light(chosen_jit, own_store) -> dict[str, xr.Dataset]:
    """The prototype without light from outside, in a lamp's that flickers, in the sun, and with a dark slot."""
    lamp = Ambient(kind="lamp", illuminance_lux=1000.0, flicker=0.1)
    sun = Ambient(kind="sun", irradiance_w_per_m2=1000.0)
    slot = Electronics(ambient_rejection="dark_slot")
    lights = {"none": {}, "lamp": {"ambient": lamp}, "sun": {"ambient": sun}, "slot": {"ambient": lamp}}
    lights["dark"] = {"ambient": Ambient(illuminance_lux=0.0)}
    lights["slot"]["electronics"] = slot
    scene = quiet(prototype(duration_s=1.0))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NAILOPTICS_STORE", str(own_store))
        patch.setattr("nailoptics.sensor.ambient.PHOTONS", 1 << 14)
        return {
            name: simulate(scene.model_copy(update=update), photons=1 << 15, seed=1) for name, update in lights.items()
        }


@pytest.mark.jit
def test_ambient_light_adds_its_volts_noise_and_error(in_ambient_light):
    alone, lit = in_ambient_light["none"], in_ambient_light["lamp"]
    assert not any("ambient" in str(name) for name in alone.variables) and set(lit.data_vars) >= AMBIENT_NAMES
    assert np.array_equal(alone.detected_fraction, lit.detected_fraction)
    # A constant offset takes nothing from the constants of the fits, nor from their errors.
    fits = (one.beer_lambert_alpha_per_m2_stderr for one in (alone, lit))
    assert np.allclose(*fits, rtol=1e-5, equal_nan=True)
    assert np.allclose(lit.volts, alone.volts + lit.ambient_volts, rtol=1e-12) and (lit.ambient_volts > 0.1).all()
    assert np.allclose(lit.volts_noise_rms**2, alone.volts_noise_rms**2 + lit.ambient_noise_v**2, rtol=1e-9)
    assert np.allclose(lit.volts_stderr**2, alone.volts_stderr**2 + lit.ambient_left_v_stderr**2, rtol=1e-9)
    assert np.array_equal(alone.volts_change_stderr, lit.volts_change_stderr)
    assert (lit.ambient_volts_stderr < 0.05 * lit.ambient_volts).all() and (lit.ambient_fraction < 1).all()


def test_ambient_light_without_a_compiling_backend_is_refused_at_once(monkeypatch):
    """Expected: not after the minutes that the light takes."""
    monkeypatch.setattr("nailoptics.studies.simulate.worn_light", lambda *_, **__: pytest.fail("light was traced"))
    scene = prototype(duration_s=1.0).model_copy(update={"ambient": Ambient(illuminance_lux=1e5)})
    with pytest.raises(InputError, match=r"\[ambient\] needs a JIT backend"):
        simulate(scene, backend="scalar")


@pytest.mark.jit
def test_ambient_light_of_0_lux_leaves_the_readings_as_they_are(in_ambient_light):
    alone, dark = in_ambient_light["none"], in_ambient_light["dark"]
    assert np.array_equal(alone.volts, dark.volts) and (dark.ambient_noise_v == 0).all()
    assert dark.ambient_fraction.isnull().all()


@pytest.mark.jit
def test_a_dark_slot_leaves_noise_flicker_and_saturation(in_ambient_light):
    alone, lit, slot, sun = (in_ambient_light[name] for name in ("none", "lamp", "slot", "sun"))
    dark_v = (alone.volts - slot.volts).values
    assert dark_v.max() < 1e-3 and np.ptp(dark_v) < 1e-9 and (slot.ambient_left_v == 0).all()
    assert np.array_equal(slot.volts_stderr, alone.volts_stderr)
    assert np.allclose(slot.ambient_noise_v, np.sqrt(2) * lit.ambient_noise_v, rtol=1e-9)
    assert (slot.ambient_flicker_v > 0.01 * slot.ambient_volts).all()
    assert bool(sun.saturated.all()) and not bool(lit.saturated.any())


@pytest.mark.jit
def test_a_balance_of_oxygen_is_in_the_signal_as_in_the_volts(chosen_jit):
    """Rationale: at 660 nm blood that loses oxygen absorbs more, which turns or doubles the change by a touch."""
    held = {"touch.site": "proximal", "touch.release_s": 25.0, "touch.duration_s": 30.0}
    scene = prototype().with_(
        {"blood.venous_so2": 0.88, "blood.oxygen_balance": True, "priors.own_traces": False} | held
    )
    result = simulate(scene.with_led(0, wavelength_nm=660.0), photons=1 << 14, seed=1)
    read = result.detected_fraction.values
    assert result.signal.values == pytest.approx(read[..., hold_end(result)] / read[..., 0] - 1, rel=1e-3)
    assert result.so2.values.min() < 0.92


@pytest.mark.long
@pytest.mark.jit
def test_flicker_is_recorded_and_its_crest_reaches_the_converters_limit(in_ambient_light):
    lit = in_ambient_light["lamp"]
    scene = parse_scene(lit.attrs["scene"])
    # At 100 Hz it would come out as a constant of these samples, a hundred in a second.
    other = lit.assign_attrs(scene=to_toml(scene.with_({"ambient.flicker_hz": 97.0})))
    recorded, alone = record(other, seed=1), record(in_ambient_light["none"], seed=1)
    flicker = (recorded.volts - alone.volts)[:, 1:] - lit.ambient_volts.values[:, None]
    assert np.sqrt((flicker**2).mean(1)) == pytest.approx(lit.ambient_flicker_v.values, rel=0.3)
    crest = scene.with_({"ambient.flicker": 1.0, "ambient.illuminance_lux": 1.2e4, "electronics.feedback_ohm": 4e5})
    result = simulate(crest, photons=1 << 14, seed=1)
    above = (result.volts + result.ambient_volts).max("time") > 5.0
    assert (result.volts < 5.0).all() and above.any() and (result.saturated.any("time") == above).all()


@pytest.mark.jit
def test_a_bloodless_finger_is_a_control_whose_readings_stay(chosen_jit):
    scene = prototype(duration_s=1.0)
    bare = scene.model_copy(update={"blood": scene.blood.model_copy(update={"rest_blood_fraction": 0.0})})
    quick = {"priors": bare.priors.model_copy(update={"own_traces": False})}
    result = simulate(bare.model_copy(update=quick), photons=1 << 14, seed=1)
    assert (result.volts > 0.1).all() and (result.volts_change == 0).all() and (result.volts_change_stderr == 0).all()
    assert "blood at rest" not in result.prior.values and "plate absorption" in result.prior.values


@pytest.mark.parametrize("command", [calibrate, place, explore, tradeoff, oximeter], ids=lambda one: one.__name__)
def test_commands_that_read_changes_of_blood_refuse_a_bloodless_bed(command):
    scene = prototype()
    bare = scene.model_copy(update={"blood": scene.blood.model_copy(update={"rest_blood_fraction": 0.0})})
    with pytest.raises(InputError, match=f"^blood.rest_blood_fraction = 0: .* {command.__name__} reads; give some"):
        command(bare, []) if command is calibrate else command(bare)


@pytest.mark.jit
def test_simulate_states_the_false_force_of_physiological_noise(chosen_jit):
    body = Body(heartbeat=Heartbeat(), hand_height_m=-0.1)
    worn = quiet(prototype(duration_s=1.0, force_n=0.5, release_s=0.8)).model_copy(update={"body": body})
    result = simulate(worn, photons=1 << 13, seed=1)
    at_hold_n, bandwidth_hz = float(result.force_n[hold_end(result)]), worn.electronics.bandwidth_hz
    expected_n = blood_model(worn).false_forces_n(at_hold_n, bandwidth_hz=bandwidth_hz)
    assert result.false_force_n.to_series().to_dict() == pytest.approx(expected_n)
    assert list(result.disturbance.values) == ["heartbeat", "hand_height_m"] and 0 < float(result.false_force_n[0]) < 1
    assert float(result.false_force_n[1]) == pytest.approx(blood_model(worn).posture_force_n(at_hold_n), rel=0.02)


@pytest.mark.long
@pytest.mark.jit
def test_very_many_samples_take_little_memory(chosen_jit):
    """Expected: 64 bytes at most for each sample of a reading; ten variables of single precision are 40."""
    scene = prototype(duration_s=3.0, sample_rate_hz=1e5)
    light = open_light(scene, states=np.full((1, 2), 0.03), photons=1 << 13)
    tracemalloc.start()
    result = simulate_from(WornLight(scene, light, None), course=blood_over_touch(scene), seed=1)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert result.volts.shape == (1, 8, 300_001) and peak < 64 * result.volts.size


@pytest.mark.long
@pytest.mark.jit
def test_very_many_samples_of_many_zones_keep_no_copy_of_their_blood(chosen_jit):
    """Rationale: its first state once kept a copy of it, double in precision, alive. Expected: its readings take no
    more memory beside it than those of two zones do."""
    scene = prototype(duration_s=2.0, sample_rate_hz=2e5)
    scene = scene.model_copy(update={"blood": scene.blood.model_copy(update={"zones": 8})})
    light, blood = open_light(scene, states=np.full((1, 8), 0.03), photons=1 << 13), blood_over_touch(scene)
    tracemalloc.start()
    simulate_from(WornLight(scene, light, None), course=blood, seed=1)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert blood.blood_fraction.dtype == np.float32 and peak < 80 * 8 * blood.sizes["time"]


@pytest.mark.long
@pytest.mark.jit
def test_too_little_time_gives_what_was_reached(chosen_jit):
    with pytest.raises(NotReachedError, match="max_seconds") as caught:
        simulate(prototype(), relative_error=0.002, max_seconds=0.3, seed=2)
    result = caught.value.result
    assert isinstance(result, xr.Dataset) and "\n" not in str(caught.value)
    assert_well_described(result)
    assert result.attrs["photons"] > 0 and result.volts.notnull().all()


def test_half_of_the_time_is_left_to_the_priors(monkeypatch):
    """Where time alone ends the trace, which would take all of it; not where it is a limit beside another aim."""
    required = []

    def light(scene, **requested):
        required.append(requested["max_seconds"])
        raise InputError("enough")

    monkeypatch.setattr(import_module("nailoptics.studies.simulate"), "worn_light", light)
    for options in ({}, {"photons": 1000}, {"relative_error": 0.1}):
        with pytest.raises(InputError, match="enough"):
            simulate(prototype(), max_seconds=8, **options)
    with pytest.raises(InputError, match="enough"):
        simulate(prototype().with_({"priors.spread": False}), max_seconds=8)
    assert required == [4, 8, 8, 8]


@pytest.mark.jit
def test_an_interrupt_after_a_batch_keeps_the_batch(chosen_jit):
    heard = []

    def stop(progress):
        heard.append(progress)
        raise KeyboardInterrupt

    with pytest.raises(NotReachedError, match="interrupted") as caught:
        simulate(prototype(), relative_error=0.002, seed=2, progress=stop)
    assert caught.value.result.attrs["photons"] == heard[-1].photons > 0
    assert np.isfinite(caught.value.result.volts.values).all()


@pytest.mark.jit
def test_the_traces_of_priors_report_their_progress(chosen_jit):
    """Expected: the share that is done rises from 0 to 1, and a callback that interrupts leaves the rest untraced."""
    reports = []
    result = simulate(prototype(), photons=1 << 14, seed=1, progress=reports.append)
    done = [p.fraction_done for p in reports if p.led == "priors" and p.is_stage]
    assert done == sorted(done) and done[0] == 0 and done[-1] == 1 and len(done) > 3
    assert "not traced" not in result.prior_how

    def stop(progress):
        if progress.led == "priors":
            raise KeyboardInterrupt

    with pytest.raises(NotReachedError, match=r"^interrupted; priors not traced: bed scattering\.$") as caught:
        simulate(prototype(), photons=1 << 14, seed=1, progress=stop)
    assert caught.value.interrupted and "bed scattering" in caught.value.result.prior


@pytest.mark.jit
def test_without_a_touch_nothing_changes(chosen_jit):
    result = simulate(quiet(prototype(force_n=0.0)), photons=1 << 15, seed=1)
    assert "path_density" not in result and "section_region" not in result
    assert abs(result.volts_change.values).max() < 1e-9
    assert_well_described(result)


@pytest.mark.long
def test_the_main_job_runs_without_a_jit_backend(monkeypatch, caplog):
    """Rationale: where no LLVM is usable, volpath in the scalar variant answers. Expected: the same dataset, errors no
    larger than requested, and the signs of the largest changes, of which the states share their noise."""
    monkeypatch.setattr(detect, "VOLPATH_RELATIVE_ERROR", 0.3)
    scene = prototype()
    scene = scene.model_copy(
        update={
            "photodiodes": (
                scene.photodiodes[0].model_copy(update={"wired": (12,)}),
                scene.photodiodes[1].model_copy(update={"wired": (3,)}),
            )
        }
    )
    reports = []
    result = simulate(scene, backend="scalar", relative_error=0.3, seed=1, progress=reports.append)
    assert_well_described(result)
    assert (result.attrs["engine"], result.attrs["backend"]) == ("volpath", "scalar")
    assert "three blood states" in result.attrs["accuracy_reached"] and "relative error of 0.3" in caplog.text
    assert "path_density" not in result and reports and reports[-1].fraction_done > 0
    start = result.isel(time=0)
    assert np.all(start.detected_fraction_stderr <= 0.3 * start.detected_fraction) and np.all(start.volts > 0)
    change, stderr = largest_change(result)
    assert np.all(np.isfinite(change)) and np.all(stderr > 0)
    assert change[0] < 0 < change[1]


@pytest.mark.slow
@pytest.mark.jit
def test_both_engines_give_the_same_volts_over_time(chosen_jit):
    """Within 4 combined standard errors at 3 %, and the changes within theirs, plus 3 % for (8) between the states."""
    scene = prototype()
    ours = simulate(scene, relative_error=0.02, seed=1)
    other = simulate(
        scene.model_copy(update={"light": scene.light.model_copy(update={"engine": "volpath"})}),
        relative_error=0.05,
        seed=2,
    )
    assert (ours.attrs["engine"], other.attrs["engine"]) == ("photons", "volpath")
    stderr = np.hypot(ours.volts_stderr, other.volts_stderr)
    assert np.all(abs(ours.volts - other.volts) < 4 * stderr)
    stderr = np.hypot(ours.volts_change_stderr, other.volts_change_stderr)
    assert np.all(abs(ours.volts_change - other.volts_change) < 4 * stderr + 0.03 * abs(ours.volts_change) + 1e-6)


def test_what_cannot_be_simulated_is_refused_before_any_light_is_traced(monkeypatch):
    monkeypatch.setattr("nailoptics.sensor.volts.open_light", None)
    with pytest.raises(InputError, match="finger"):
        simulate(parse_scene(phantom({})))
    for seed in (-1, 2**63):
        with pytest.raises(InputError, match="seed"):
            simulate(prototype(), seed=seed)
    full = prototype()
    full = full.model_copy(update={"blood": full.blood.model_copy(update={"rest_blood_fraction": 1.0})})
    with pytest.raises(InputError, match="blood"):
        simulate(full)


def test_blood_over_time_starts_at_rest_and_diverges_under_force():
    course = blood_over_touch(prototype())
    blood = course.blood_fraction
    assert np.allclose(blood.isel(time=0), 0.03, rtol=1e-3)
    assert blood.sel(zone="distal").min() < 0.027
    assert set(course.data_vars) >= {"force_n", "capillary_diameter_m", "vein_diameter_m", "proximal_pressure_pa"}
    assert float(course.force_n.max()) == 1.0


@pytest.mark.parametrize("body", [None, {"heartbeat": {}}])
def test_over_priors_of_the_blood_at_rest_blood_over_time_is_that_of_its_own_touch(monkeypatch, body):
    """Eq. (7): blood is proportional to the blood at rest, another one needs no other run; that of arterioles, which
    are there where a heart beats, does not."""
    scene, requested = prototype(duration_s=1.0, release_s=0.9).with_({"body": body}), []
    course = blood_over_touch(scene)

    def record_states(transfer, states, **how):
        for rest in (0.01, 0.03, 0.05):
            varied = scene.with_({"blood.rest_blood_fraction": rest})
            # As precisely as the states are, the scene's own more so, and as can be.
            rtol = 1e-6 if varied == scene else 1e-4
            own = (blood_over_touch(varied, rtol=one).blood_fraction.values for one in (rtol, 1e-6))
            requested.append((states(varied)[0], *(blood[:, [0, hold_end(course)]].T for blood in own)))
        return SimpleNamespace(dataset=lambda scene: xr.Dataset())

    module = import_module("nailoptics.studies.simulate")
    monkeypatch.setattr(module, "readings_over_priors", record_states)
    module._spread(course, SimpleNamespace(scene=scene), TraceOptions(), None, False)
    for states, own, exact in requested:
        assert states == pytest.approx(own, rel=1e-6)
        assert states == pytest.approx(exact, rel=2e-5 if body else 1e-6)
    assert body or requested[0][0][0] == pytest.approx(0.01)
    assert np.ptp(requested[2][0][:, 0]) > 1e-3

"""What a finger's fields do to the optics of its parts, and which of them leave a trace as it is."""

import numpy as np
import pytest

from nailoptics import parse_scene, to_toml
from nailoptics.errors import InputError
from nailoptics.light import optics
from nailoptics.light.identity import light_digest
from nailoptics.scene import FingerCase, load_scene
from nailoptics.scene.finger import ABSORBING, SCATTERING
from nailoptics.studies.placement.boards import worn_on

REGIONS = ("plate", "bed", "bone", "pulp", "epidermis", "epoxy", "kapton", "cover", "air")


@pytest.fixture(scope="module")
def scene():
    return load_scene("scenes/prototype.toml")


def with_finger(scene, **fields):
    return scene.model_copy(update={"finger": scene.finger.model_copy(update=fields)})


@pytest.mark.parametrize("part", ["plate", "bed", "bone", "pulp"])
def test_a_factor_multiplies_the_bloodless_absorption(scene, part):
    bloodless = scene.model_copy(update={"blood": scene.blood.model_copy(update={"rest_blood_fraction": 0.0})})
    changed = with_finger(bloodless, **{f"{part}_absorption": 3.0})
    before, after = (optics.absorption(s, 800.0)[0] for s in (bloodless, changed))
    regions = [absorber.region for absorber in optics.absorbing(scene)]
    for region, one, other in zip(regions, before, after, strict=True):
        # The epidermis is left out in this scene, so that it has the pulp's optics, as its factor.
        mine = region == part or (part == "pulp" and region == "epidermis")
        if mine and part == "pulp":
            blood = scene.blood.pulp_blood_fraction * 0.436  # per mm; 0.97 of it oxygenated
            assert other - blood == pytest.approx(3 * (one - blood), rel=0.01)
        else:
            assert other == pytest.approx(3 * one if mine else one, rel=1e-12)


@pytest.mark.parametrize("part", ["plate", "bed", "bone", "pulp"])
def test_a_scattering_factor_scales_mu_s_of_one_part_alone(scene, part):
    before, after = (
        optics.finger_media(s, REGIONS, 800.0) for s in (scene, with_finger(scene, **{f"{part}_scattering": 0.5}))
    )
    ratio = np.divide(after.mu_s, before.mu_s, out=np.ones_like(after.mu_s), where=before.mu_s > 0)
    mine = [r == part or (part == "pulp" and r == "epidermis") for r in REGIONS]
    assert ratio == pytest.approx(np.where(mine, 0.5, 1.0))
    assert np.array_equal(before.mu_a, after.mu_a) and np.array_equal(before.g, after.g)


def test_the_dermis_is_chosen_by_finger_or_case(scene):
    bed = optics.bed_columns(scene)[0]
    usual, dark = (optics.absorption(with_finger(scene, dermis=d), 800.0)[0, bed] for d in DERMIS)
    # Salomatina's bloodless dermis less the baseline at 800 nm. [mm^-1]
    assert dark - usual == pytest.approx(0.122 - 0.0262, abs=5e-4)
    case = FingerCase(name="dark", dermis="salomatina")
    assert worn_on(scene, case).finger.dermis == "salomatina"
    assert worn_on(with_finger(scene, dermis="shimojo"), FingerCase(name="own")).finger.dermis == "shimojo"
    thumb = worn_on(with_finger(scene, plate_absorption=0.7), FingerCase(name="thumb", digit="thumb"))
    assert thumb.finger.plate_absorption == 0.7 and thumb.finger.nail_radius_mm == 11.4


DERMIS = ("jacques_baseline", "salomatina")


def test_the_plates_absorption_goes_with_a_power_of_the_wavelength(scene):
    column, wavelength = optics.absorbers(scene).index("plate"), np.array([500.0, 1000.0])
    usual, sloped = (
        optics.absorption(with_finger(scene, plate_absorption_slope=slope), wavelength)[:, column]
        for slope in (0.0, 1.5)
    )
    assert sloped / usual == pytest.approx([1.0, 2.0**1.5])


def test_a_line_has_its_width_at_half_of_its_height(scene):
    """Of a Gaussian the standard deviation is the full width over 2.3548, the fourth moment three of its squares."""
    led = scene.leds[0].model_copy(update={"wavelength_nm": 800.0, "fwhm_nm": 40.0})
    wavelength, weight = optics.spectrum(led)
    variance, fourth = (weight @ (wavelength - 800.0) ** power for power in (2, 4))
    assert weight.sum() == pytest.approx(1.0) and weight @ wavelength == pytest.approx(800.0)
    assert variance == pytest.approx((40.0 / 2.3548) ** 2, rel=1e-4) and fourth == pytest.approx(3 * variance**2)


@pytest.mark.parametrize("field", ABSORBING)
def test_absorption_leaves_a_trace_as_it_is(scene, field):
    value = "shimojo" if field == "dermis" else 0.5
    assert light_digest(with_finger(scene, **{field: value})) == light_digest(scene)


@pytest.mark.parametrize("field", SCATTERING)
def test_scattering_makes_another_trace(scene, field):
    assert light_digest(with_finger(scene, **{field: 0.5})) != light_digest(scene)


def test_bed_scattering_is_read_from_its_old_place_and_written_in_its_new(scene):
    old = (
        to_toml(scene).replace("[light]\n", "[light]\nbed_scattering = 1.4\n").replace("bed_scattering = 1.0\n", "", 1)
    )
    read = parse_scene(old)
    assert read.finger.bed_scattering == 1.4
    assert parse_scene(to_toml(read)) == read and "bed_scattering = 1.4" in to_toml(read)
    phantom = to_toml(load_scene("scenes/phantom.toml")).replace("[light]\n", "[light]\nbed_scattering = 1.0\n")
    assert parse_scene(phantom).light == scene.light.model_copy(update={"left_out": ()})


@pytest.mark.parametrize("line", ["plate_absorption = 0.0", "bone_scattering = -1.0", "bed_absorption = 1e9"])
def test_impossible_factors_are_refused_in_one_line(scene, line):
    text = "schema_version = 1\n[finger]\n" + line + '\n[[leds]]\nname = "ir"\npart = "led_800"\n'
    with pytest.raises(InputError, match=f"finger.{line.split()[0]} = .* must be") as caught:
        parse_scene(text)
    assert "\n" not in str(caught.value)

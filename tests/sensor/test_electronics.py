"""Electronics: volts and noise against closed forms and the sensor's published figures."""

import numpy as np
import pytest

from nailoptics.errors import InputError
from nailoptics.light.optics import responsivity_a_per_w
from nailoptics.scene import Electronics, Led, Photodiode
from nailoptics.scene.base import PHOTON_NM_PER_V
from nailoptics.sensor.electronics import flicker_gain, lsb_v, noise_budget, read

# Of one watt, so that a detected fraction is a power in watts.
LED = Led(name="watt", wavelength_nm=800, flux_mw=1000)
# 0.55 A/W at the LED's wavelength.
DIODE = Photodiode(name="diode", position_mm=(0, 0), quantum_efficiency=0.55 * PHOTON_NM_PER_V / 800)

NO_DARK_CURRENT = DIODE.model_copy(update={"dark_current_na": 0.0})


def efficient(quantum_efficiency: float) -> Photodiode:
    return Photodiode(name="diode", position_mm=(0, 0), quantum_efficiency=quantum_efficiency)


def test_light_that_is_no_number_is_refused_in_one_line():
    with pytest.raises(InputError, match=r"ambient_a must be numbers, got 'lamp'; give a number or an array\."):
        read(1e-3, LED, DIODE, Electronics(), ambient_a="lamp")


def test_responsivity_is_that_of_silicon():
    # eta 0.85: 0.45 / 0.55 / 0.64 A/W at 660 / 800 / 940 nm, rounded as data sheets give them.
    assert responsivity_a_per_w(efficient(0.85), [660, 800, 940]) == pytest.approx([0.45, 0.55, 0.64], abs=0.005)


def test_a_perfect_photodiode_gives_one_electron_per_photon():
    photon_j = 6.62607015e-34 * 299792458 / 800e-9
    assert responsivity_a_per_w(efficient(1.0), 800) == pytest.approx(1.602176634e-19 / photon_j, rel=1e-9)


def test_shot_noise_exceeds_thermal_noise_from_52_mv_at_any_resistor():
    # 2 q V / R = 4 k T / R at V = 2 k T / q = 51.7 mV at 300 K.
    for ohm in (1e5, 1e6, 1e7):
        amplifier = Electronics(feedback_ohm=ohm, temperature_k=300)
        below, above = (noise_budget(volts / ohm, NO_DARK_CURRENT, amplifier) for volts in (0.0510, 0.0524))
        assert below.shot_v2 < below.feedback_v2
        assert above.shot_v2 > above.feedback_v2


def test_the_amplifiers_noise_is_the_integral_of_its_density():
    amplifier = Electronics(bandwidth_hz=5e4, capacitance_pf=80, noise_nv_per_rt_hz=12)
    f = np.linspace(0, 5e4, 200_001)
    expected = np.trapezoid((1 + (2 * np.pi * f * 80e-12 * 1e6) ** 2) * 12e-9**2, f)
    assert noise_budget(0.0, DIODE, amplifier).amplifier_v2 == pytest.approx(expected, rel=1e-8)


def test_each_noise_grows_with_bandwidth_as_it_should():
    narrow, wide, fast, faster = (noise_budget(1e-7, DIODE, Electronics(bandwidth_hz=hz)) for hz in (1, 2, 1e6, 2e6))
    assert [b / a for a, b in zip(narrow[:-1], wide[:-1], strict=True)] == pytest.approx([2, 2, 2, 2, 1])
    # From where the capacitance lets more of the amplifier's noise through than the resistor.
    assert faster.amplifier_v2 / fast.amplifier_v2 == pytest.approx(8, rel=1e-3)


def test_simulated_electrons_show_the_same_shot_noise():
    # 1 nA for half a millisecond (bandwidth 1 kHz) is 3.1e6 electrons, Poisson.
    amplifier = Electronics(bandwidth_hz=1e3)
    electrons = np.random.default_rng(1).poisson(1e-9 * 0.5e-3 / 1.602176634e-19, size=20_000)
    volts = electrons * 1.602176634e-19 / 0.5e-3 * 1e6
    expected = noise_budget(1e-9, NO_DARK_CURRENT, amplifier).shot_v2
    relative_error = np.sqrt(2 / electrons.size)
    assert volts.var() == pytest.approx(expected, rel=4 * relative_error)
    assert relative_error < 0.011


def test_the_prototype_reads_tenths_of_a_volt_with_small_noise():
    diode = Photodiode(name="diode", array="pd_array_4x1", position_mm=(0, 0))
    output = read(np.array([1e-7, 1e-6]), LED, diode, Electronics())
    # P * 0.5485 A/W * 1 Mohm + 0.1 mV of dark current.
    assert output.volts == pytest.approx([0.0549, 0.5486], rel=0.005)
    assert (output.volts_noise_rms < 1e-3 * output.volts).all() and (output.volts_noise_rms > 0).all()
    assert not output.saturated.any()


def test_darkness_reads_the_dark_current():
    output = read(0.0, LED, DIODE, Electronics())
    assert output.volts == pytest.approx(1e-4)
    assert output.volts_noise_rms >= lsb_v(Electronics()) / np.sqrt(12)
    assert not output.saturated


def test_dark_current_adds_its_shot_noise():
    amplifier, dark_a = Electronics(), 50e-9
    dim, dark = (DIODE.model_copy(update={"dark_current_na": 1e9 * a}) for a in (0.0, dark_a))
    # 2 q I B R^2 of the dark current alone, whatever the light.
    expected = 2 * 1.602176634e-19 * dark_a * amplifier.bandwidth_hz * amplifier.feedback_ohm**2
    for power_w in (0.0, 1e-7):
        more = read(power_w, LED, dark, amplifier).noise_v2 - read(power_w, LED, dim, amplifier).noise_v2
        assert more == pytest.approx(expected, rel=1e-6)


def test_a_converter_saturates_in_its_last_step():
    coarse = Electronics(adc_bits=4)
    steps = np.array([-1.01, -0.99, -0.5, 0.5])
    volts = coarse.adc_range_v + steps * lsb_v(coarse)
    output = read((volts - 1e-4) / 0.55e6, LED, DIODE, coarse)
    assert output.saturated.tolist() == [False, True, True, True]
    assert output.volts == pytest.approx(np.minimum(volts, coarse.adc_range_v))


def test_a_coarse_converter_dominates():
    coarse = Electronics(adc_bits=4)
    assert read(0.0, LED, DIODE, coarse).volts_noise_rms == pytest.approx(lsb_v(coarse) / np.sqrt(12), rel=1e-4)


def test_too_much_light_saturates_at_the_range_and_is_marked():
    power_w = np.geomspace(1e-9, 1e-3, 61)
    output = read(power_w, LED, DIODE, Electronics())
    saturated = output.saturated
    assert (np.diff(output.volts) >= 0).all() and output.volts.max() == Electronics().adc_range_v
    assert (np.diff(output.amplified_v) > 0).all()
    assert (saturated == (power_w * 0.55e6 + 1e-4 >= Electronics().adc_range_v - lsb_v(Electronics()))).all()
    assert saturated.any() and not saturated.all()
    # What the converter cuts off adds no noise.
    assert (np.diff(output.noise_v2[~saturated]) > 0).all()
    assert output.noise_v2[saturated] == pytest.approx(output.noise_v2[-1], rel=1e-9)


def test_light_and_light_from_outside_broadcast():
    output = read(np.full((3, 1), 1e-7), LED, DIODE, Electronics(), ambient_a=[0.0, 1e-8])
    assert output.volts.shape == output.volts_noise_rms.shape == output.saturated.shape == (3, 2)


def test_light_from_outside_adds_its_current_and_its_noise():
    amplifier = Electronics()
    alone, lit = (read(1e-7, LED, DIODE, amplifier, ambient_a=a) for a in (0.0, 2e-7))
    assert lit.volts - alone.volts == pytest.approx(2e-7 * amplifier.feedback_ohm, rel=1e-12)
    dark, bright = (noise_budget(a, DIODE, amplifier).shot_v2 for a in (0.55e-7, 0.55e-7 + 2e-7))
    more = bright - dark
    assert lit.noise_v2 - alone.noise_v2 == pytest.approx(more, rel=1e-6)


def test_a_dark_slot_subtracts_the_mean_and_adds_its_own_noise():
    bare, slotted = Electronics(), Electronics(ambient_rejection="dark_slot")
    plain, result = (read(1e-7, LED, DIODE, one, ambient_a=2e-7) for one in (bare, slotted))
    dark = read(0.0, LED, DIODE, bare, ambient_a=2e-7)
    assert result.volts == pytest.approx(0.55e-7 * bare.feedback_ohm, rel=1e-9)
    assert result.noise_v2 == pytest.approx(plain.noise_v2 + dark.noise_v2, rel=1e-12)
    assert result.amplified_v == plain.amplified_v and not result.saturated
    # The stage is full all the same.
    assert read(1e-7, LED, DIODE, slotted, ambient_a=1e-5).saturated


def test_a_lock_in_has_the_noise_of_a_demodulated_square_wave():
    """White noise of both states, sampled at 2 B over half a period each, as the sum of many such demodulations."""
    lock_in = Electronics(ambient_rejection="lock_in")
    lit, dark = (read(power, LED, DIODE, Electronics(), ambient_a=2e-7).noise_v2 for power in (1e-7, 0.0))
    rng, halves = np.random.default_rng(1), 64
    noise = rng.normal(size=(20_000, 2, halves)) * np.sqrt(2 * halves * np.array([lit, dark]))[:, None]
    demodulated = 2 * (noise[:, 0].sum(1) - noise[:, 1].sum(1)) / (2 * halves)
    assert read(1e-7, LED, DIODE, lock_in, ambient_a=2e-7).noise_v2 == pytest.approx(demodulated.var(), rel=0.04)


@pytest.mark.parametrize("flicker_hz", [20.0, 100.0, 120.0, 950.0])
@pytest.mark.parametrize(
    "how",
    [{}, {"ambient_rejection": "dark_slot", "switching_hz": 30.0}, {"ambient_rejection": "lock_in"}],
    ids=["none", "dark slot", "lock-in"],
)
def test_flicker_is_left_as_in_a_stage_stepped_through_time(how, flicker_hz):
    """A first-order stage of noise bandwidth B has the time constant 1 / (4 B); the lock-in's is behind its mixer."""
    amplifier = Electronics(**how)
    tau_s, step_s = 1 / (4 * amplifier.bandwidth_hz), 2e-5
    time_s = np.arange(0.0, 2.0, step_s)
    light = np.cos(2 * np.pi * flicker_hz * time_s)
    if amplifier.ambient_rejection == "lock_in":
        # Its switching a little off a multiple of the step.
        light = 2 * light * np.sign(np.sin(2 * np.pi * amplifier.rejection_hz * time_s + 0.1))
    out, level = np.empty_like(light), 0.0
    kept = np.exp(-step_s / tau_s)
    for i, value in enumerate(light):
        level = value + (level - value) * kept
        out[i] = level
    if amplifier.ambient_rejection == "dark_slot":
        later = round(0.5 / amplifier.rejection_hz / step_s)
        out = out[later:] - out[:-later]
    rms = out[len(out) // 4 :].std()
    assert flicker_gain(flicker_hz, amplifier) / np.sqrt(2) == pytest.approx(rms, rel=0.03, abs=0.002)


@pytest.mark.parametrize("power_w", [-1e-9, np.nan, np.inf])
def test_impossible_power_is_refused(power_w):
    with pytest.raises(InputError, match="detected_fraction"):
        read([1e-7, power_w], LED, DIODE, Electronics())


def test_impossible_quantum_efficiency_is_refused():
    with pytest.raises(InputError, match=r"quantum_efficiency = 1\.2: must be less than or equal to 1"):
        efficient(1.2)

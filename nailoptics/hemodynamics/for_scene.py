"""Touch to blood: what a scene's touch makes of the blood under the nail, over time or held until nothing moves."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from .. import hemodynamics
from ..errors import InputError
from ..scene import Blood, Body, Scene, Touch
from ..statistics import covariance_root
from ..variables import described, precision
from .blood import Arterioles
from .parameters import posture_pa, time_mean, vessels, with_posture
from .respond import Model
from .steady import linear_response, two_branches
from .touch import TouchCourse, touch_course
from .walls import build_walls
from .waves import fastest_hz, pressure_lines, waves_pressure
from .zones import capillary_zones

# A body begins to beat so long before the touch. [s]
WARM_UP_S = 5.0
# Its pressure goes through so many knots in the shortest of its periods: a pulse is off by 0.4 % of its height at most.
KNOTS_PER_PERIOD = 128
# Of one beat: its extremes are missed by less than 0.3 % of the pulse.
SAMPLES_PER_BEAT = 64
# Step of a touch pressure over which blood's change with it is taken. [Pa]
STEP_PA = 100.0
# Highest pressures to which blood's change is extrapolated, about the mean arterial one, where vessels close. [Pa]
FAR_PA = 1e4
# Fields of the body that move the blood once and for all, as they are where nothing does.
POSTURE: dict[str, Any] = {"hand_height_m": 0.0, "venous_pressure_pa": None}


@dataclass(frozen=True)
class SteadyTouch:
    """A touch that is held.

    blood_fraction : (2,) float. Blood of the proximal and distal zone there.
    blood_per_pa : (zone, pressure) float. How it changes with the proximal and distal pressure. [Pa^-1]
    force_n : the force. [N]
    force_per_pa : (2,) float. Change of the force with each pressure: the area of either side, unless it grows. [N/Pa]
    pressure_per_n : (2,) float. Change of the pressures with the force of the scene's touch. [Pa/N]
    """

    blood_fraction: np.ndarray
    blood_per_pa: np.ndarray
    force_n: float
    force_per_pa: np.ndarray
    pressure_per_n: np.ndarray

    def as_force_n(self, blood: np.ndarray) -> np.ndarray:
        """The force of touch pressures that change the blood of both zones as given, (zones, ...) float, to first
        order, (...) float; NaN where pressures move too little blood for that. [N]
        """
        if np.linalg.cond(self.blood_per_pa) > 1 / np.finfo(float).eps:
            return np.full(blood.shape[1:], np.nan)
        pressure_pa = np.linalg.lstsq(self.blood_per_pa, blood)[0]
        far = np.linalg.norm(pressure_pa.reshape(len(pressure_pa), -1), axis=1).max() > FAR_PA
        return np.full(blood.shape[1:], np.nan) if far else np.asarray(self.force_per_pa @ pressure_pa)


@dataclass(frozen=True)
class BloodModel:
    """What a scene says of the blood under its nail, for the network of vessels.

    rest : the vessels as the blood at rest holds for them; parameters : under the hand's height, too.
    zone_ends_mm : (zones + 1,) float. Where zones meet along the nail, from the cuticle to the tip. [mm]
    """

    rest: hemodynamics.Parameters
    parameters: hemodynamics.Parameters
    zones: hemodynamics.Zones
    touch: TouchCourse
    body: Body | None
    blood: Blood
    zone_ends_mm: np.ndarray

    @property
    def arterioles(self) -> Arterioles | None:
        """Small arteries and arterioles; None where no heart beats, as in the paper, or the bed has no blood."""
        heart, rest_blood = self.body.heartbeat if self.body else None, self.blood.rest_blood_fraction
        if heart is None or 0.0 in (heart.pulse_pressure_pa, heart.arteriolar_blood_fraction, rest_blood):
            return None
        ratio, mean_pa = heart.arterial_pulse_pressure_pa / heart.pulse_pressure_pa, self.rest.arterial_pressure_pa
        return Arterioles(heart.arteriolar_blood_fraction, heart.arteriolar_peak_pa, mean_pa, ratio)

    @property
    def rest_fraction(self) -> float:
        """Blood fraction at rest, that of arterioles included. [1]"""
        small = self.arterioles
        return self.blood.rest_blood_fraction + (small.blood_fraction if small else 0.0)

    def fraction(self, diameter_m: np.ndarray, touch_pa: ArrayLike, *, unit: int | None = None) -> np.ndarray:
        """Blood fraction of each zone, or of one, by the diameter of its capillaries and the touch on them. [1]"""
        how: dict[str, Any] = {"rest_blood_fraction": self.blood.rest_blood_fraction, "zones": self.zones, "unit": unit}
        return hemodynamics.blood_fraction(self.rest, diameter_m, touch_pa=touch_pa, **how)

    def steady(self, pressure_pa: np.ndarray) -> np.ndarray:
        """Blood fractions once pressures (M, n) have been held for long, (n, zones) float. [1]"""
        state = hemodynamics.steady_state(self.parameters, pressure_pa=pressure_pa, zones=self.zones)
        touch_pa, small = self.zones.on_walls(pressure_pa)[:-1], self.arterioles
        fraction = self.fraction(state.capillary_diameter_m, touch_pa)
        if small is not None:
            fraction = fraction + small.fraction(self.parameters.arterial_pressure_pa - touch_pa)
        return fraction.T

    def in_posture(self, posture: Mapping[str, Any]) -> "BloodModel":
        """The model with another height of the hand or pressure of the veins, by their names in [body]."""
        assert self.body is not None
        body = self.body.model_copy(update=posture)
        return replace(self, body=body, parameters=with_posture(self.rest, body))

    def bistable_forces_n(self) -> np.ndarray:
        """The forces, of 101 from 0 to the touch's largest, under which the vessels are bistable: they could rest in
        two states, and the blood depends on whether the force has grown or fallen to what it is. [N]"""
        force_n = np.linspace(0.0, float(self.touch.force_n.max()), 101)
        return force_n[two_branches(self.parameters, pressure_pa=self.touch.held_pa(force_n), zones=self.zones)]

    def by_arterial_pressure(self, frequency_hz: ArrayLike, force_n: float) -> np.ndarray:
        """Change of the blood fraction of each zone with a small wave of P_H while a force is held, (zones, F) complex.

        frequency_hz : (F,) float. [Hz]

        Returns: amplitude and phase against the wave's. A touch that shears is taken without its shear. [Pa^-1]
        """
        model, p = self.without_shear(), self.parameters
        pressure_pa = np.array(model.touch.sides_pa(force_n))
        outside_pa = model.zones.on_walls(pressure_pa[:, None])
        ends_pa = np.array([p.arterial_pressure_pa]), np.array([p.venous_pressure_pa])
        gain = linear_response(build_walls(p, model.zones), np.asarray(frequency_hz), outside_pa, *ends_pa)[:-1]
        state = hemodynamics.steady_state(p, pressure_pa=pressure_pa[:, None], zones=model.zones)
        # Blood of capillaries goes with the square of the diameter; venules, shut here, stay as they are.
        capillary = model.fraction(state.capillary_diameter_m, np.inf)
        change = np.asarray(2.0 * capillary / state.capillary_diameter_m * gain)
        if (small := model.arterioles) is not None:
            # All that is slower than a beat has the height in arterioles that it has in P_H.
            beats = np.asarray(frequency_hz) > 0.99 * heart_rate_per_min(self.body) / 60.0
            transmural_pa = p.arterial_pressure_pa - outside_pa[:-1]
            change = change + small.compliance_per_pa(transmural_pa) * np.where(beats, small.pulse_ratio, 1.0)
        return change

    def covariance(self, waves: Body, force_n: float, *, bandwidth_hz: float) -> np.ndarray:
        """Covariance of both zones' blood by a body's waves of the arterial pressure while a force is held, (2, 2)
        float: the sum over waves, up to a stage's bandwidth, of G G^H times their variances, with the gain G of each.
        """
        frequency_hz, variance_pa2 = pressure_lines(waves)
        slow = frequency_hz <= bandwidth_hz
        gain = self.by_arterial_pressure(frequency_hz[slow], force_n)
        return np.asarray(np.real(np.einsum("if,f,jf->ij", gain, variance_pa2[slow], gain.conj())))

    def at_force(self, force_n: float) -> SteadyTouch:
        """The blood at a steady force, and its change with either pressure; a touch that shears is taken without it."""
        held_pa, per_n, force_per_pa = self.touch.contact_at(force_n)
        # In columns: there, and half a step up and down in either pressure.
        step = 0.5 * STEP_PA * np.array([[0, 1, -1, 0, 0], [0, 0, 0, 1, -1]])
        pressure = np.maximum(held_pa[:, None] + step, 0.0)
        blood = self.without_shear().steady(pressure)
        width = np.array([pressure[0, 1] - pressure[0, 2], pressure[1, 3] - pressure[1, 4]])
        per_pa = np.stack([blood[1] - blood[2], blood[3] - blood[4]], -1) / width
        return SteadyTouch(blood[0], per_pa, force_n, force_per_pa=force_per_pa, pressure_per_n=per_n)

    def posture_force_n(self, force_n: float, at_rest: Mapping[str, Any] = POSTURE) -> float:
        """The false force, as of `SteadyTouch.as_force_n`, by the hand's height and venous pressure of the body while a
        force is held. [N] at_rest : the posture in which rest was read, as for `in_posture`.
        """
        usual = self.in_posture({**POSTURE, **at_rest}).at_force(force_n)
        return float(usual.as_force_n(self.at_force(force_n).blood_fraction - usual.blood_fraction))

    def false_forces_n(self, force_n: float, *, bandwidth_hz: float) -> dict[str, float]:
        """The false force by each thing that moves blood beside the touch while a force is held, by its name in [body]:
        of waves of the arterial pressure, as far as a stage of some bandwidth follows them, the rms, of the hand's
        height and venous pressure the shift, of recorded ones the largest from their first value. [N]
        """
        if (body := self.body) is None:
            return {}
        point, out = self.at_force(force_n), {}
        waves = {name: Body().model_copy(update={name: wave}) for name, wave in body.waves.items()}
        for name, alone in (waves if body.recorded_arterial_pressure_pa is None else {"file": body}).items():
            blood = covariance_root(self.covariance(alone, force_n, bandwidth_hz=bandwidth_hz))
            out[name] = float(np.linalg.norm(point.as_force_n(blood)))
        still = POSTURE | {f"recorded_{name}": None for name in POSTURE}
        for name, usual in POSTURE.items():
            first, *later = body.recorded.get(name, (usual, getattr(body, name)))
            ends = [still | {name: end} for end in {min(later), max(later)} - {first}]
            if ends:
                shifts_n = [self.in_posture(end).posture_force_n(force_n, {name: first}) for end in ends]
                out[name] = max(shifts_n, key=abs)
        return out

    def without_shear(self) -> "BloodModel":
        """The model for the proximal and the distal pressure alone."""
        cut = self.zones
        reach = tuple((proximal, distal) for proximal, distal, *_ in cut.reach)
        return replace(self, zones=replace(cut, reach=reach, vein_reach=cut.vein_reach[:2]))

    def white_band_mm(self, blood_fraction: np.ndarray) -> np.ndarray:
        """Width of the white band at the tip, where less than half of the blood at rest is left, (t,) float. [mm]

        blood_fraction : (zones, t) float. Taken for that at the middle of each zone, and for linear between.
        """
        ends, part = self.zone_ends_mm, blood_fraction / self.rest_fraction
        return hemodynamics.white_band_mm(0.5 * (ends[1:] + ends[:-1]), part, ends_mm=(ends[0], ends[-1]))

    def body_waveforms(self) -> dict[str, hemodynamics.Waveform]:
        """P_H and P_L, where they move, over the touch and a while before, as inputs of `respond`."""
        body, times_s = self.body, self.touch.samples_s
        if body is None:
            return {}
        recorded_s, (fall_pa, low_pa) = body.recorded_time_s, posture_pa(self.rest, body)
        high_pa = np.asarray(body.recorded_arterial_pressure_pa or self.rest.arterial_pressure_pa) - fall_pa
        moved = {"arterial_pressure_pa": (recorded_s, high_pa), "venous_pressure_pa": (recorded_s, low_pa)}
        if body.waves:
            spacing_s = 1.0 / (KNOTS_PER_PERIOD * fastest_hz(body))
            since_s = np.arange(-WARM_UP_S, times_s[-1] - times_s[0] + spacing_s, spacing_s)
            moved["arterial_pressure_pa"] = (tuple(times_s[0] + since_s), self._waves_pa(since_s))
        return {
            name: hemodynamics.Waveform(time_s=time_s, pressure_pa=pressure_pa)
            for name, (time_s, pressure_pa) in moved.items()
            if pressure_pa.ndim and time_s is not None
        }

    def _waves_pa(self, since_s: np.ndarray, **how: float) -> np.ndarray:
        """The waves of P_H about its mean at some times from the start of the touch, under the hand's height. [Pa]"""
        assert self.body is not None
        mean_pa, (fall_pa, _) = self.parameters.arterial_pressure_pa, posture_pa(self.rest, self.body)
        pressure_pa = waves_pressure(self.body, since_s, mean_pressure_pa=mean_pa, **how)
        if fall_pa.ndim == 0 or self.body.recorded_time_s is None:
            return pressure_pa
        at_s = self.touch.samples_s[0] + since_s
        above_mean_pa = self.rest.arterial_pressure_pa - mean_pa
        return pressure_pa + above_mean_pa - np.interp(at_s, self.body.recorded_time_s, fall_pa)

    def arteriolar_pressure_pa(self) -> np.ndarray:
        """The pressure in arterioles at the samples of the touch, (t,) float, or that of arterioles at rest. [Pa]"""
        small, since_s = self.arterioles, self.touch.samples_s - self.touch.samples_s[0]
        if self.body is None or small is None:
            return np.full(since_s.shape, self.parameters.arterial_pressure_pa)
        return self._waves_pa(since_s, pulse_ratio=small.pulse_ratio)

    def capillary_saturation(self, run: xr.Dataset, fraction: np.ndarray) -> np.ndarray:
        """Saturation of the capillaries' blood by the balance of oxygen, whose pulse is arterial, (zones, t) float. [1]

        run : of `respond`, with pressures. fraction : (zones, t) float. Blood of the capillaries. [1]
        """
        from scipy.ndimage import uniform_filter1d

        time_s, beat = run.time.values, 1
        if self.body is not None and self.body.heartbeat is not None:
            beat = max(round(60.0 / self.body.heartbeat.rate_per_min / float(np.median(np.diff(time_s)))), 1)

        def without_pulse(values: np.ndarray) -> np.ndarray:
            return np.asarray(uniform_filter1d(values, beat, axis=-1, mode="nearest"))

        def flows(state: Any, parameters: hemodynamics.Parameters | xr.Dataset) -> np.ndarray:
            """Inflow, which goes with the fourth power of the diameter, and outflow, (2, zones, ...) float."""
            diameter_m, within_pa = np.asarray(state.capillary_diameter_m), np.asarray(state.capillary_pressure_pa)
            inflow = (np.asarray(parameters.arterial_pressure_pa) - within_pa) * diameter_m**4
            return np.stack([inflow, within_pa - np.asarray(state.vein_pressure_pa)])

        def untouched(parameters: hemodynamics.Parameters) -> np.ndarray:
            zones = self.without_shear().zones
            return flows(hemodynamics.steady_state(parameters, zones=zones), parameters)[..., None]

        # What a wall that moves takes up or gives off does not flow through.
        ends = ("arterial_pressure_pa", "venous_pressure_pa")
        first = {name: float(without_pulse(run[name].values)[0]) for name in ends}
        # A touch that is there from the first sample finds the finger as it was without it.
        courses = untouched(self.parameters.replace(**first)), flows(run, run)
        before, flow = (np.maximum(one / untouched(self.rest), 0.0).min(0) for one in courses)
        steady, flow = without_pulse(fraction.astype(float)), without_pulse(flow)
        so2 = hemodynamics.saturation_over_time(self.blood, time_s, steady, flow, flow_before=before[:, 0])
        oxygen, all_arterial = steady * so2 + (fraction - steady) * self.blood.so2, np.full(so2.shape, self.blood.so2)
        return np.clip(np.divide(oxygen, fraction, out=all_arterial, where=fraction > 0), 0.0, 1.0)

    def over_touch(
        self, *, model: Model = "massless", rtol: float = 1e-6, bandwidth_hz: float | None = None
    ) -> xr.Dataset:
        """The touch over time and what it does: force, pressures, vessel diameters, and the blood fraction by zone.

        model, rtol : as for `hemodynamics.respond`.
        bandwidth_hz : of a stage, to have the `false_forces_n` at the end of the hold, too. [Hz]
        """
        course, moving = self.touch, self.body_waveforms()
        time_s, pressures = course.samples_s, course.waveforms()
        # Vessels that beat forget within seconds that they began at rest.
        before_s = time_s[:1] - WARM_UP_S if "arterial_pressure_pa" in moving else time_s[:0]
        run = hemodynamics.respond(
            self.parameters,
            np.concatenate([before_s, time_s]),
            pressure_pa=pressures,
            **moving,
            zones=self.zones,
            start="steady",
            model=model,
            rtol=rtol,
            only_diameters=not self.blood.oxygen_balance,
        ).isel(time=slice(len(before_s), None))
        # Zone by zone: of very many samples the arrays between are large.
        diameter_m, kind, small = run.capillary_diameter_m, precision(len(time_s)), self.arterioles
        fraction, over_time_pa = np.empty(diameter_m.shape, kind), [row.at(time_s) for row in pressures]
        arteriolar, arterial_pa = np.zeros_like(fraction), self.arteriolar_pressure_pa()
        for i, row_m in enumerate(diameter_m.values):
            touch_pa = sum(part * row for part, row in zip(self.zones.reach[i], over_time_pa, strict=True))
            fraction[i] = self.fraction(row_m, touch_pa, unit=i)
            if small is not None:
                arteriolar[i] = small.fraction(arterial_pa - touch_pa)
        so2 = self.capillary_saturation(run, fraction) if self.blood.oxygen_balance else None
        if small is not None:
            so2 = None if so2 is None else (fraction * so2 + arteriolar * self.blood.so2) / (fraction + arteriolar)
            fraction += arteriolar
        # One by one, as they come as parts of one array.
        walls = {"capillary_diameter_m": diameter_m.astype(kind), "vein_diameter_m": run.vein_diameter_m.astype(float)}
        data = {"force_n": np.interp(time_s, course.time_s, course.force_n)}
        data |= {"proximal_pressure_pa": over_time_pa[0], "distal_pressure_pa": over_time_pa[1]}
        if course.shear_n is not None:
            data["shear_n"] = np.interp(time_s, course.time_s, course.shear_n)
        data |= {name: waveform.at(time_s) for name, waveform in moving.items()} | {"blood_fraction": fraction}
        if self.blood.venous_so2 is not None:
            data["so2"] = hemodynamics.saturation(self.blood, fraction) if so2 is None else so2
        if len(fraction) > 2:
            data["white_band_mm"] = self.white_band_mm(fraction)
        run = run[[*walls]].assign(walls | described(__package__, **data)).drop_vars("zone_position")
        hold_n = float(run.force_n[hold_end(run)])
        if bandwidth_hz and (false_n := self.false_forces_n(hold_n, bandwidth_hz=bandwidth_hz)):
            run = run.assign(described(__package__, false_force_n=list(false_n.values())))
            run = run.assign_coords(described(__package__, disturbance=list(false_n)))
        return run


def blood_model(scene: Scene) -> BloodModel:
    """What a scene says of the blood under its nail."""
    half_mm = scene.fingertip.nail_length_mm / 2
    return BloodModel(
        rest=(rest := vessels(scene)),
        parameters=with_posture(rest, scene.body),
        zones=capillary_zones(scene),
        touch=touch_course(scene.touch),
        body=scene.body,
        blood=scene.blood,
        zone_ends_mm=np.array([-half_mm, *scene.zone_edges_mm, half_mm]),
    )


def blood_over_touch(scene: Scene, **how: Any) -> xr.Dataset:
    """What a scene's touch makes of its blood; how : of `BloodModel.over_touch`."""
    return blood_model(scene).over_touch(**how)


def hold_end(result: xr.Dataset) -> int:
    """Index of the end of the hold: the last sample whose force is (nearly) as far from the first as any."""
    departure = np.abs(result.force_n.to_numpy() - float(result.force_n[0]))
    return int(np.flatnonzero(departure >= 0.995 * departure.max())[-1])


def steady_blood(scene: Scene, force_n: ArrayLike) -> np.ndarray:
    """Blood fractions once each of the forces has been held for long, (n, zones) float for (n,) forces. [1]"""
    model = blood_model(scene)
    return model.steady(model.touch.held_pa(force_n))


@dataclass(frozen=True)
class BloodBeat:
    """One beat of the blood in the bed while a force is held.

    time_s : (t,) float. From the start of the beat. [s]
    blood_fraction : (zones, t) float. [1]
    """

    time_s: np.ndarray
    blood_fraction: np.ndarray

    @property
    def resting(self) -> np.ndarray:
        """Mean blood of each zone, (zones,) float."""
        return np.asarray(self.blood_fraction.mean(1))

    @property
    def pulse(self) -> np.ndarray:
        """Blood of each zone over its mean, (t, zones) float."""
        return np.asarray((self.blood_fraction - self.blood_fraction.mean(1, keepdims=True)).T)

    @property
    def extremes(self) -> np.ndarray:
        """The pulse when all zones together hold least blood and when they hold most, (2, zones) float."""
        total = self.blood_fraction.sum(0)
        return self.pulse[[int(total.argmin()), int(total.argmax())]]

    @property
    def rms_per_swing(self) -> float:
        """Root mean square of the pulse of all zones together over its swing."""
        together = self.blood_fraction.sum(0)
        return float(together.std() / np.ptp(together))


def heart_rate_per_min(body: Body | None) -> float:
    """Beats in a minute of a body's heart; raises InputError where it does not beat."""
    if body is None or body.heartbeat is None or body.heartbeat.pulse_pressure_pa == 0:
        why = "give [body.heartbeat] with pulse_pressure_pa above 0, such as 2000."
        raise InputError(f"body: no heart beats, and without a pulse the arterial saturation cannot be measured; {why}")
    return body.heartbeat.rate_per_min


def rest_beat(scene: Scene) -> BloodBeat:
    """A beat under the force with which the scene's touch begins."""
    return beat_at(scene, float(touch_course(scene.touch).force_n[0]))


@lru_cache(64)
def beat_at(scene: Scene, force_n: float) -> BloodBeat:
    """A beat of the scene's heart alone, always alike, in its posture (of a recorded one, the mean), once a force has
    been held for long as its touch presses.

    Raises: InputError where the heart does not beat.
    """
    rate, body = heart_rate_per_min(scene.body), scene.body
    assert body is not None and body.heartbeat is not None
    means = {name: time_mean(np.array(values), body) for name, values in body.recorded.items()}
    posture = {name: getattr(body, name) for name in POSTURE} | means
    even = Body(heartbeat=body.heartbeat.model_copy(update={"rate_variability": 0.0}), **posture)
    model = blood_model(scene.model_copy(update={"body": even}))
    time_s = np.arange(SAMPLES_PER_BEAT + 1) * 60.0 / (rate * SAMPLES_PER_BEAT)
    pressure_pa = np.repeat(model.touch.held_pa([force_n]), 2, axis=1)
    ends: dict[str, Any] = {"time_s": time_s[[0, -1]], "force_n": np.full(2, force_n), "pressure_pa": pressure_pa}
    held = replace(model.touch, touch=Touch(), shear_n=None, samples_s=time_s[:-1], **ends)
    beat = replace(model, touch=held).over_touch()
    return BloodBeat(beat.time.values, beat.blood_fraction.values)

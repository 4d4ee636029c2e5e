"""Estimated force of people of an independent simulator, which shares no model of body and light with the package.

    python tests/benchmarks/other_people.py FOLDER [--people ann ...] [--rate 50] [--donnings 2]

Writes recordings of eight people who wear the sensor of scenes/prototype.toml, runs `nailoptics calibrate` and
`nailoptics predict` on them as commands, and prints a table. FOLDER keeps what is done: the same command goes on.
From the package come the columns' names, and the size and sign of what the prototype reads. The rest is this:

Touch. The contact's area grows with force [1]; the load spreads with depth and, filtered by the pulp's relaxation [2],
raises the tissue's pressure about the place of the touch, which is a little different each time.
Blood. Five zones along the nail have arterioles, capillaries and venules, the last two with a tube law [3]. The venules
drain from zone to zone to the root, and by the sides into the pulp; a pressure outside a drain that is above the vein's
holds the blood back [4], and valves let none return. So a proximal touch, which shuts the drains, reddens the nail, and
a distal one, which presses on the bed under the nail's distal half, whitens it [5]. Ischaemia opens the arterioles for
some seconds. Pressures at rest are as measured in nailfolds [6, 7]; the heart, breath and vasomotion move them.
Light. Attenuation by the effective attenuation coefficient of each zone [8, 9], weighted by its place between LED and
photodiode; gain, offset, drift, noise of electronics, 16 bits; a load cell with noise, a tare and an error of its gain.

With --donnings the sensor is donned again for every recording, and so often within the protocol: its gains and its
place along the nail differ each time.

Each person is drawn from `RANGES`. Where there is no measured range (compliance of the bed's venules, what reaches the
bed of a pressure on the pulp) it is wide and chosen so that the nail reddens or refills in one to three seconds and
saturates about 1 to 2 N. In half of the people (ann, eve, gus, hal) a light proximal touch whitens the nail a little
before it reddens it, which no source reports: read their proximal rows as a hard case, the others' as the usual one.
So this measures the commands on a body other than theirs, not on a real one.

1 Dzidek et al. 2017, J. R. Soc. Interface 14, 20160935. 2 Pawluk, Howe 1999, J. Biomech. Eng. 121, 178: 70 ms, 1.4 s.
3 Shapiro 1977, J. Biomech. Eng. 99, 126. 4 Permutt, Riley 1963, J. Appl. Physiol. 18, 924. 5 Mascaro, Asada 2001, IEEE
Trans. Robot. Autom. 17(5). 6 Mahy, Tooke, Shore 1995, J. Physiol. 485, 213. 7 Mahler et al. 1979, Am. J. Physiol.
236, 888. 8 Bosschaart et al. 2014, Lasers Med. Sci. 29, 453. 9 Jacques 2013, Phys. Med. Biol. 58, R37.
"""

import argparse
import csv
import itertools
import json
import statistics
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp
from scipy.ndimage import gaussian_filter1d
from scipy.signal import lfilter

sys.path.append(str(Path(__file__).parents[1]))

import force_page  # noqa: E402

SCENE = Path(__file__).parents[2] / "scenes" / "prototype.toml"
PEOPLE = ("ann", "bob", "cyd", "dan", "eve", "fay", "gus", "hal")
COLUMNS = [f"proximal.{i}" for i in (6, 8, 10, 12)] + [f"distal.{i}" for i in (3, 5, 7, 9)]
ALONG = np.array([-2.375, -1.875, -1.375, -0.875, 0.875, 1.375, 1.875, 2.375])  # photodiodes from the LED [mm]
DISTANCE = np.hypot(1.2, ALONG)  # [mm]
ZONES = np.array([-5.0, -2.5, 0.0, 2.5, 5.0])  # middles along the nail, distal is positive [mm]
STEP = 0.005  # of the inputs [s]
WARM_UP = 40.0  # before each recording [s]
REST = 6.0  # at the beginning of each [s]
MMHG_PER_KPA = 7.5
BLOOD_PER_MM = 0.45  # absorption of whole blood at 800 nm [8]
SCATTERING_PER_MM = 1.7  # reduced, of skin at 800 nm [9]
DONNED = (0.05, 0.2)  # sd of gains and of the place along the nail [mm] between donnings: assumed

RANGES = {  # least and most of each person's
    "area_mm2": (90.0, 170.0),  # of contact at 1 N [1]
    "area_power": (0.35, 0.6),  # [1]
    "depth_mm": (2.0, 5.0),  # over which the load spreads
    "distal_share": (0.5, 1.1),  # of that pressure that acts on the bed right over a distal touch
    "proximal_share": (0.15, 0.45),  # the same of a proximal one, whose pressure the bone takes
    "drain_share": (0.7, 1.5),  # that acts on the nail's drains of a proximal touch
    "lateral_share": (0.2, 0.7),  # that acts on the drains into the pulp of any
    "reach_mm": (3.0, 5.0),  # of a touch along the bed
    "suction": (0.0, 0.25),  # by which a distal touch lowers the root's pressure, and a proximal one the tip's
    "creep_fast": (0.1, 0.25),  # part that follows with 70 ms [2]
    "creep_slow": (0.08, 0.25),  # part that follows slowly
    "creep_s": (1.0, 3.5),  # 1.4 s [2] when pressed at a held depth
    "wander_mm": (0.1, 0.35),  # sd of a touch's place
    "arterial_mmhg": (55.0, 85.0),  # mean, of the arterioles' inflow
    "capillary_mmhg": (15.0, 30.0),  # [6, 7]
    "venule_mmhg": (9.0, 14.0),
    "vein_mmhg": (4.0, 8.0),
    "transit_s": (0.5, 1.6),  # blood of capillaries and venules over flow
    "capillary_fraction": (0.008, 0.016),
    "venule_fraction": (0.012, 0.026),
    "capillary_k_mmhg": (6.0, 12.0),  # of its tube law
    "venule_k_mmhg": (4.0, 10.0),
    "lateral_flow": (0.15, 0.5),  # part of the flow that leaves by the sides
    "hyperaemia": (0.1, 0.4),  # largest gain of the arterioles' conductance
    "hyperaemia_s": (4.0, 10.0),
    "heart_hz": (0.9, 1.5),
    "pulse_mmhg": (8.0, 20.0),  # arterioles', peak to peak; capillaries' 4.2 +- 2.0 [6]
    "arteriole_fraction": (0.001, 0.003),
    "breath_hz": (0.18, 0.3),
    "breath_mmhg": (0.5, 2.0),
    "vasomotion": (0.02, 0.12),  # sd of the arterioles' logarithm of resistance
    "tissue_per_mm": (0.015, 0.04),  # absorption without blood
    "bed_part": (0.35, 0.7),  # of the light's path that lies in the bed
    "depth_of_light": (0.9, 1.6),  # half width along the nail of where a photodiode's light comes from [mm]
    "decay_per_mm": (1.5, 2.1),  # of the volts with distance
    "bright_v": (1.4, 3.0),  # of the photodiode next to the LED
    "noise_v": (4e-5, 1.5e-4),
    "drift_per_s": (1e-6, 2e-5),  # sd over recordings of the light's relative change
}


class Person:
    """One who wears the sensor: a name's draw from RANGES, as attributes, and what differs among zones and elements."""

    def __init__(self, name: str) -> None:
        rng = np.random.default_rng([2001, PEOPLE.index(name)])
        for key, (low, high) in RANGES.items():
            setattr(self, key, float(rng.uniform(low, high)))
        self.name = name
        self.vascularity = np.exp(rng.normal(0, 0.2, len(ZONES)))  # relative amount of vessels of each zone
        self.resistance = np.exp(rng.normal(0, 0.2, len(ZONES)))
        self.sites = {"proximal": rng.normal(-5.5, 0.7), "distal": rng.normal(5.0, 0.7)}  # [mm]
        self.gains = np.exp(rng.normal(0, 0.08, len(COLUMNS)))
        self.offsets_v = rng.uniform(0.0, 0.03, len(COLUMNS))
        self.cell = (rng.normal(0, 0.004), rng.normal(1, 0.005))  # tare [N], gain

    def __getattr__(self, key: str) -> float:
        raise AttributeError(key)  # declares RANGES' attributes to the type checker


@dataclass(frozen=True)
class Recording:
    """Touches of one recording: peaks [N], slow cycles at 0.05 Hz or steps, on one side; or a protocol's on both."""

    name: str
    site: str
    slow: bool
    peaks: tuple[float, ...]


PROTOCOL = Recording("protocol", "both", False, ())
CALIBRATIONS = {
    "protocol": (PROTOCOL,),
    "cycles": (
        Recording("slow_proximal", "proximal", True, (2.0, 2.0, 2.0)),
        Recording("slow_distal", "distal", True, (2.0, 2.0, 2.0)),
        Recording("quick_distal", "distal", False, (0.5, 0.15, 1.0, 0.3, 0.75)),
    ),
}
HELD_OUT = tuple(
    Recording(f"{kind}_{site}_{top}", site, kind == "slow", peaks)
    for site in ("proximal", "distal")
    for kind, top, peaks in (
        ("slow", "held", (0.9, 0.45, 0.7)),
        ("steps", "held", (0.4, 0.9, 0.2, 0.65, 1.0, 0.3)),
        ("steps", "hard", (1.2, 1.6, 2.0)),
    )
)
# Both sides at once, each pressed as by a touch of it alone; no calibration has such touches.
BOTH_SIDES = tuple(Recording(f"{r.name.split('_')[0]}_even_held", "even", r.slow, r.peaks) for r in HELD_OUT[:2])


def followed(person: Person, rng: np.random.Generator, path: Path, donnings: int) -> tuple[np.ndarray, ...]:
    """What `touches` returns of the command's protocol, written to path; whether the touch is proximal; and how often
    the sensor was donned before, NaN while it is off."""
    own = ["--seed", str(PEOPLE.index(person.name)), "--donnings", str(donnings)]
    run(["protocol", str(SCENE), *own, "-o", str(path)], path.with_suffix(".json"))
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    time = np.arange(-WARM_UP, table[-1, 0], STEP)
    force = np.interp(time, table[:, 0], table[:, 1])
    tremor = gaussian_filter1d(rng.normal(size=len(time)), 0.06 / STEP)
    begins = np.cumsum(np.diff(force > 0, prepend=False) & (force > 0))
    wander = rng.normal(size=begins[-1] + 1)[begins]
    proximal = np.interp(time, table[:, 0], table[:, 2]) >= 0.5
    before = np.cumsum(np.diff(table[:, 0], prepend=0.0) > 5.0)
    donning = np.interp(time, table[:, 0], before)
    donning = np.where(donning % 1.0, np.nan, donning)
    return time, np.maximum(force * (1 + 0.015 * tremor / tremor.std()), 0.0), wander, proximal, donning


def touches(recording: Recording, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times [s] from -WARM_UP on, force [N] and the place's scatter (a draw for each touch, in standard deviations)."""
    starts, length = [], REST
    holds = [20.0 if recording.slow else rng.uniform(1.5, 3.0) for _ in recording.peaks]
    for hold in holds:
        starts.append(length)
        length += hold + (0.0 if recording.slow else 0.32 + rng.uniform(1.8, 3.2))
    time = np.arange(-WARM_UP, length + 4.0, STEP)
    force, wander = np.zeros_like(time), np.zeros_like(time)
    tremor = gaussian_filter1d(rng.normal(size=len(time)), 0.06 / STEP)
    for start, hold, peak in zip(starts, holds, recording.peaks, strict=True):
        into = time - start
        if recording.slow:
            shape = np.where((into > 0) & (into < hold), 0.5 - 0.5 * np.cos(2 * np.pi * into / hold), 0.0)
        else:
            shape = np.clip(np.minimum(into, hold + 0.32 - into) / 0.16, 0.0, 1.0)
        force += peak * shape
        wander[into > -0.5] = rng.normal()
    return time, np.maximum(force * (1 + 0.015 * tremor / tremor.std()), 0.0), wander


def lagged(values: np.ndarray, time_s: float) -> np.ndarray:
    """Values after a first-order lag."""
    kept = np.exp(-STEP / time_s)
    return lfilter([1 - kept], [1, -kept], values)


def pressures(person: Person, site: str, force: np.ndarray, wander: np.ndarray) -> tuple[np.ndarray, ...]:
    """Pressure [mmHg] on the bed (time, zone), the drain at the root (time,) and those at the sides (time, zone)."""
    area = person.area_mm2 * np.maximum(force, 1e-9) ** person.area_power
    spread = force / (np.sqrt(area) + person.depth_mm) ** 2 * 1000 * MMHG_PER_KPA
    fast, slow = person.creep_fast, person.creep_slow
    load = (1 - fast - slow) * spread + fast * lagged(spread, 0.07) + slow * lagged(spread, person.creep_s)
    place = person.sites[site] + person.wander_mm * wander

    def near(where: np.ndarray | float, reach: float) -> np.ndarray:
        return np.exp(-((where - place[:, None]) ** 2) / (2 * reach**2))

    over = person.distal_share if site == "distal" else person.proximal_share
    away = 1 - near(ZONES, 2 * person.reach_mm)
    bed = load[:, None] * over * (near(ZONES, person.reach_mm) - person.suction * away)
    drain = load * person.drain_share * near(-7.0, person.reach_mm)[:, 0]
    sides = load[:, None] * person.lateral_share * near(ZONES, 1.5 * person.reach_mm)
    return bed, drain, sides


def rhythms(person: Person, time: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Arterioles' inflow pressure [mmHg], pulse (0 to 1), and the factor on their conductance, over time."""
    rate = person.heart_hz * (1 + 0.04 * np.sin(2 * np.pi * person.breath_hz * time) + 0.02 * rng.normal())
    phase = (np.cumsum(rate) * STEP + rng.uniform()) % 1.0
    pulse = np.exp(-(((phase - 0.18) / 0.09) ** 2)) + 0.35 * np.exp(-(((phase - 0.48) / 0.14) ** 2))
    breath = person.breath_mmhg * np.sin(2 * np.pi * person.breath_hz * time + rng.uniform(0, 6))
    # Below some 0.1 Hz and below some 0.02 Hz.
    slow = sum(gaussian_filter1d(rng.normal(size=len(time)), s / STEP) * np.sqrt(s) for s in (1.6, 8.0))
    tone = np.exp(person.vasomotion * slow / np.std(slow))
    return person.arterial_mmhg + person.pulse_mmhg * (pulse - pulse.mean()) + breath, pulse, tone


def blood(person: Person, time: np.ndarray, outside: tuple, inflow: tuple) -> np.ndarray:
    """Part of the bed's volume (time, zone) that blood fills: in capillaries, venules and arterioles."""
    (bed, drain, sides), (arterial, pulse, tone), zones = outside, inflow, len(ZONES)
    rest_c = person.capillary_fraction * person.vascularity
    rest_v = person.venule_fraction * person.vascularity
    flow = (rest_c + rest_v) / person.transit_s / person.resistance  # [1/s]
    into = flow / (person.arterial_mmhg - person.capillary_mmhg)
    across = flow / (person.capillary_mmhg - person.venule_mmhg)
    lateral = person.lateral_flow * flow / (person.venule_mmhg - person.vein_mmhg)
    # What does not leave by the sides gathers towards the root, where pressure falls zone by zone.
    gathered = np.cumsum(((1 - person.lateral_flow) * flow)[::-1])[::-1]
    fall = (person.venule_mmhg - person.vein_mmhg) / 8
    along = gathered / np.r_[person.venule_mmhg - person.vein_mmhg - 4 * fall, np.full(len(ZONES) - 1, fall)]
    venule_rest = person.venule_mmhg + fall * (np.arange(zones) - 4.0)

    def tube(relative: np.ndarray, k_mmhg: float, power: float) -> np.ndarray:
        relative = np.maximum(relative, 0.02)
        return k_mmhg * (relative**power - relative**-1.5)

    def change(at: float, state: np.ndarray) -> np.ndarray:
        i = min(int((at + WARM_UP) / STEP), len(time) - 1)
        capillary = bed[i] + person.capillary_mmhg + tube(state[:zones] / rest_c, person.capillary_k_mmhg, 6.0)
        venule = bed[i] + venule_rest + tube(state[zones:-1] / rest_v, person.venule_k_mmhg, 3.0)
        opened = 1 + person.hyperaemia * np.clip(state[-1], 0.0, 1.0)
        q_in = into * tone[i] * opened * np.maximum(arterial[i] - np.maximum(capillary, bed[i]), 0.0)
        q_across = across * (capillary - np.maximum(venule, 0.0))
        q_side = lateral * np.maximum(venule - np.maximum(person.vein_mmhg, sides[i]), 0.0)
        q_along = along * np.maximum(venule - np.r_[max(person.vein_mmhg, drain[i]), venule[:-1]], 0.0)
        debt = (1 - q_in.sum() / flow.sum() - state[-1]) / person.hyperaemia_s
        return np.r_[q_in - q_across, q_across - q_side - q_along + np.r_[q_along[1:], 0.0], debt]

    shown = np.arange(int(WARM_UP / STEP), len(time))
    start = np.r_[rest_c, rest_v, 0.0]
    answer = solve_ivp(change, (time[0], time[-1]), start, "LSODA", time[shown], max_step=0.02, rtol=1e-4, atol=1e-7)
    squeezed = 1 / (1 + np.exp((bed[shown] - 0.6 * person.arterial_mmhg) / 10))
    arterioles = person.arteriole_fraction * squeezed * (1 + 0.3 * pulse[shown, None])
    return answer.y[:zones].T + answer.y[zones:-1].T + arterioles * person.vascularity


def volts(person: Person, bed_blood: np.ndarray, rng: np.random.Generator, shift_mm: float = 0.0) -> np.ndarray:
    """Readings (time, column) [V] of blood (time, zone) before the converter."""
    middle, half = (ALONG[:, None] + shift_mm) / 2, person.depth_of_light + 0.2 * DISTANCE[:, None]
    weight = np.exp(-((ZONES - middle) ** 2) / (2 * half**2))
    weight /= weight.sum(1, keepdims=True)
    absorption = person.tissue_per_mm + BLOOD_PER_MM * bed_blood
    effective = np.sqrt(3 * absorption * (absorption + SCATTERING_PER_MM))
    usual = np.sqrt(3 * SCATTERING_PER_MM * (person.tissue_per_mm + 0.03 * BLOOD_PER_MM))
    light = np.exp(-person.bed_part * DISTANCE * (effective @ weight.T - usual))
    bright = person.bright_v * person.gains * np.exp(-person.decay_per_mm * (DISTANCE - DISTANCE.min()))
    span = np.arange(len(bed_blood)) * STEP
    drift = 1 + person.drift_per_s * rng.normal() * span + rng.normal(0, 2e-3)  # since the sensor's warm-up
    return person.offsets_v + bright * light * drift[:, None]


def donned(person: Person, bed_blood: np.ndarray, rng: np.random.Generator, donning: np.ndarray) -> np.ndarray:
    """Readings as of `volts`, of a sensor that was donned again for the recording, and within it."""
    worn, out = np.random.default_rng(rng.integers(2**32)), np.full((len(bed_blood), len(COLUMNS)), np.nan)
    state = rng.bit_generator.state
    for number in np.unique(donning[np.isfinite(donning)]):
        rng.bit_generator.state = state  # the same drift
        gains, shift_mm = np.exp(worn.normal(0, DONNED[0], len(COLUMNS))), worn.normal(0, DONNED[1])
        now = donning == number
        out[now] = (volts(person, bed_blood, rng, shift_mm) * gains)[now]
    return out


def record(person: Person, recording: Recording, rate_hz: float, path: Path, donnings: int | None) -> None:
    """Write one recording as a CSV."""
    number = [r.name for r in (*CALIBRATIONS["cycles"], *HELD_OUT, PROTOCOL, *BOTH_SIDES)].index(recording.name)
    rng = np.random.default_rng([17, PEOPLE.index(person.name), number])
    if recording is PROTOCOL:
        own = path.with_name(f"{person.name}_touches.csv")
        time, force, wander, proximal, donning = followed(person, rng, own, donnings or 1)
    else:
        time, force, wander = touches(recording, rng)
        proximal, donning = np.full(len(time), recording.site != "distal"), np.zeros(len(time))
    inflow, even = rhythms(person, time, rng), recording.site == "even"
    sides = [
        pressures(person, site, force * at, wander)
        for site, at in (("proximal", proximal), ("distal", ~proximal | even))
    ]
    bed_blood = blood(person, time, tuple(map(sum, zip(*sides, strict=True))), inflow)
    force, proximal = force[-len(bed_blood) :], proximal[-len(bed_blood) :]
    shown = donning[-len(bed_blood) :]
    readings = donned(person, bed_blood, rng, shown) if donnings else volts(person, bed_blood, rng)
    every = round(1 / rate_hz / STEP)
    readings, force, proximal = readings[::every], force[::every], proximal[::every]
    hum = gaussian_filter1d(rng.normal(size=readings.shape), 2.0 * rate_hz, axis=0) * np.sqrt(2.0 * rate_hz)
    readings = readings + person.noise_v * (rng.normal(size=readings.shape) + 0.5 * hum)
    readings = np.round(readings * 2**16 / 5) * 5 / 2**16
    cell = person.cell[0] + person.cell[1] * force + rng.normal(0, 0.003, len(force))
    part = path.with_suffix(".part")
    with part.open("w", newline="") as file:
        out = csv.writer(file)
        out.writerow(["time_s", "force_n", "site", *COLUMNS])
        for i in np.flatnonzero(np.isfinite(readings[:, 0])):
            site = "even" if even else "proximal" if proximal[i] else "distal"
            out.writerow([f"{i / rate_hz:.3f}", f"{cell[i]:.4f}", site, *(f"{v:.7f}" for v in readings[i])])
    part.rename(path)


def run(arguments: list[str], path: Path) -> dict:
    """What a command of nailoptics answers with --json, kept at path."""
    if not path.exists():
        command = [sys.executable, "-m", "nailoptics", *arguments, "--json"]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            raise SystemExit(f"{' '.join(command)}\n{done.stderr}")
        path.write_text(done.stdout)
    return json.loads(path.read_text())


def columns(path: Path, names: list[str]) -> np.ndarray:
    """Columns of a CSV as (row, name); an empty cell is infinite."""
    with path.open(newline="") as file:
        return np.array([[float(row[name] or "inf") for name in names] for row in csv.DictReader(file)])


def score(folder: Path, recording: Recording) -> dict[str, float]:
    """One row of the table, over touches."""
    path = folder / f"{recording.name}.csv"
    out = folder / recording.name
    estimated = run(["predict", str(folder / "subject.toml"), str(path), "-o", str(out)], out.with_suffix(".json"))
    force = columns(path, ["force_n"])[:, 0]
    estimate, low, high = columns(out / "predict.csv", ["force_n", "force_low_n", "force_high_n"]).T
    touch = (force >= 0.15) & (force <= 1.0)
    inside = (low <= force) & (force <= high)

    def over(values: np.ndarray, average: Callable[[np.ndarray], float]) -> float:
        return float(average(values[touch])) if touch.any() else float("nan")

    return {
        "rms_n": over((estimate - force) ** 2, np.mean) ** 0.5,
        **{f"{name}_n": estimated["baseline_rms_n"][name] for name in ("filter", "cubic", "components", "sigmoid")},
        "covered": over(inside, np.mean),
        "half_width_n": over(0.5 * (high - low), np.median),
        "open": over(np.isinf(high), np.mean),
        "consistent": float(estimated["consistent"]),
    }


def measure(
    name: str, folder: Path, rate_hz: float, calibration: str, donnings: int | None
) -> dict[str, dict[str, float]]:
    """All rows of one person, by recording."""
    folder.mkdir(parents=True, exist_ok=True)
    person, teaching = Person(name), CALIBRATIONS[calibration]
    for recording in (*teaching, *HELD_OUT, *BOTH_SIDES):
        path = folder / f"{recording.name}.csv"
        if not path.exists():
            record(person, recording, rate_hz, path, donnings)
    known = [folder / f"{recording.name}.csv" for recording in teaching]
    subject = folder / "subject.toml"
    fit = run(["calibrate", str(SCENE), *map(str, known), "-o", str(subject)], folder / "calibrate.json")
    print(f"{name}: calibration {1000 * fit['rms_n']:.0f} mN", *fit["warnings"], sep="\n  ")
    return {recording.name: score(folder, recording) for recording in (*HELD_OUT, *BOTH_SIDES)}


def folder_of(name: str, options: argparse.Namespace) -> Path:
    """Where one person's recordings and results lie."""
    worn = f"_{options.donnings}_donnings" if options.donnings else ""
    return Path(options.folder / f"{name}_{options.rate:.0f}hz_{options.calibration}{worn}")


def print_row(heads: tuple[str, str], row: dict[str, float]) -> None:
    cells = (f"{value:13.0f}" if key == "consistent" else f"{value:13.3f}" for key, value in row.items())
    print(f"{heads[0]:7}{heads[1]:21}" + "".join(cells), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--people", nargs="+", choices=PEOPLE, default=PEOPLE)
    parser.add_argument("--rate", type=float, choices=(25, 50, 100), default=50, help="samples a second")
    parser.add_argument(
        "--calibration", choices=tuple(CALIBRATIONS), default="protocol", help="touches to calibrate on"
    )
    parser.add_argument("--donnings", type=int, help="the sensor is put on anew, so often within the protocol")
    parser.add_argument("--json", type=Path, help="file that keeps the rows, for the documentation")
    options = parser.parse_args()
    print(
        "rms in N over touches of 0.15 to 1 N, and of the filter alone and of baselines over those of 0.15 N and more;"
    )
    print("the part of the samples of touches within the 95 % interval, and the median of half of it in N")
    rows: dict[str, list[dict[str, float]]] = {recording.name: [] for recording in (*HELD_OUT, *BOTH_SIDES)}
    for name in options.people:
        answers = measure(name, folder_of(name, options), options.rate, options.calibration, options.donnings)
        print(f"{'':28}" + "".join(f"{key:>13}" for key in next(iter(answers.values()))))
        for recording, row in answers.items():
            print_row((name, recording), row)
            rows[recording].append(row)
    if options.json:
        held = [
            {"touches": f"{kind} {site}", "person": name} | row
            for kind, site in itertools.product(("slow", "steps"), ("proximal", "distal", "even"))
            for name, row in zip(options.people, rows[f"{kind}_{site}_held"], strict=True)
        ]

        def series(name: str, touches: str) -> tuple[np.ndarray, ...]:
            folder = folder_of(name, options)
            recording = f"{touches.replace(' ', '_')}_held"
            known = columns(folder / f"{recording}.csv", ["time_s", "force_n"]).T
            return *known, *columns(folder / recording / "predict.csv", ["force_n", "force_low_n", "force_high_n"]).T

        force_page.keep(options.json, "other_people.py", held, series)
    for recording, result in rows.items():
        print_row(("median", recording), {key: statistics.median(row[key] for row in result) for key in result[0]})


if __name__ == "__main__":
    main()

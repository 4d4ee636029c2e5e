"""The people of scenes/subjects under the touches of the paper's Figs. 15 to 18, and what another skin would change."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..assets import data_dir, read_toml
from ..checks import Array
from ..hemodynamics.for_scene import blood_over_touch
from ..hemodynamics.parameters import PA_PER_N_PER_CM2
from ..light import Transfer, trace
from ..light.detect import light_of
from ..light.transfer.series import read_by_groups
from ..paper.reduced_optics import fit_taylor
from ..paper.responses import CYCLE_HZ, PHASE_S, PeopleReadings, TouchProtocol, branches, cycle, press
from ..scene import Scene, load_scene
from ..variables import stacked_rows
from .prior_uncertainty import at_value, value_of

PHOTONS, SEED = 1 << 17, 0
MELANIN = "finger.melanin_fraction"
# Samples per second of slow cycles and of steps, between which readings are linear. [Hz]
SLOW_HZ, QUICK_HZ = 20.0, 200.0


def people() -> list[Scene]:
    """The bodies of scenes/subjects with the paper's two beds, set "subject", and each its own walls and contact."""
    paths, own = sorted((data_dir("scenes") / "subjects").glob("*.toml")), read_toml("paper_claims.toml")["people"]
    paper: dict[str, Any] = dict.fromkeys(("body", "blood.tuning", "blood.zones", "blood.decay_length"))
    paper["blood.parameters"] = "subject"
    return [load_scene(path).with_(paper | fields) for path, fields in zip(paths, own, strict=True)]


def read_people(scenes: Sequence[Scene]) -> PeopleReadings:
    """Trace people's sensors and read them under the touches of Figs. 15 to 18."""
    melanin = [value_of(scene, MELANIN) for scene in scenes]
    lights = [trace(scene, photons=PHOTONS, seed=SEED) for scene in scenes]
    sides = [[_read_side(light, side, (min(melanin), max(melanin))) for light in lights] for side in (0, 1)]
    return PeopleReadings(**stacked_rows([stacked_rows(side) for side in sides]))


def _read_side(transfer: Transfer, side: int, skins: tuple[float, float]) -> dict[str, Array]:
    """Fields of `PeopleReadings` of one person's proximal (0) or distal (1) side; skins : least and most melanin."""
    scene, light = transfer.scene, light_of(transfer)
    here = [j for j, element in enumerate(scene.layout.photodiodes) if (element.area.center_mm[1] > 0) == side]

    def course(protocol: TouchProtocol, rate_hz: float) -> tuple[Array, Array, Array]:
        """Change of the reading, that of its fit by Taylor (9), (T,) each, and the blood at the samples, (t, zones)."""
        force_n = tuple(protocol.touch_pa[0][0] / PA_PER_N_PER_CM2)
        given: dict[str, Any] = {"recorded_time_s": tuple(protocol.time_s), "recorded_force_n": force_n}
        given |= {"profile": "recorded", "site": None, "proximal_share": 1.0 - side, "sample_rate_hz": rate_hz}
        blood = blood_over_touch(scene.model_copy(update={"touch": scene.touch.model_copy(update=given)}))
        states, diameter_m = blood.blood_fraction.values.T, blood.capillary_diameter_m.values
        reading, zone = light.readings_at(states).fraction[0], scene.zones_of_photodiodes
        fit = sum(fit_taylor(diameter_m[zone[j]], reading[j]).predict(diameter_m[zone[j]]) for j in here)
        both = np.stack([reading[here].sum(0), fit]) / reading[here, 0].sum() - 1.0
        return *(np.interp(protocol.time_s, blood.time.values, values) for values in both), states

    slow, slow_fit, states = course(cycle(), SLOW_HZ)
    quick, quick_fit, _ = course(press(), QUICK_HZ)
    ends = states[[0, round(SLOW_HZ / CYCLE_HZ / 2)]]
    scenes = [at_value(scene, MELANIN, melanin) for melanin in skins]
    read = [read_by_groups(transfer, skin, ends)[0, 0, here].sum(0) for skin in scenes]
    (rest, held), (dark_rest, dark_held) = read
    effect = np.array([dark_rest / rest, (dark_held / dark_rest - 1.0) / (held / rest - 1.0)]) - 1.0
    on, off = quick[: PHASE_S.size], quick[PHASE_S.size - 1 :]
    fields = {"cycle": branches(slow), "press_on": on, "press_off": off, "skin_effect": effect}
    return fields | {"cycle_fit": branches(slow_fit), "press_fit": quick_fit}

"""Which constants of vessels and touch move the prototype's signals, and whether the paper's rules tie any of them.

Run: python bench_vessel_priors.py. Printed: for each constant the standard deviation over its range (95 %) of the
change of each reading by 1 N, in percent of the reading at rest; then, of sets around "best" drawn from the priors of
vessels that meet as many of the paper's rules, the standard deviations and correlations.
"""

import numpy as np
from parameter_search import misses, simulate_responses_of_many

from nailoptics import Scene, load_scene, trace
from nailoptics.assets import data_dir
from nailoptics.hemodynamics import parameters
from nailoptics.hemodynamics.for_scene import steady_blood
from nailoptics.light.transfer.series import readings_over_states
from nailoptics.scene.priors import Prior, shipped_priors
from nailoptics.scene.vessels import FACTORS as FACTORS_OF_SCENE, Tuning
from nailoptics.studies.prior_uncertainty import WEIGHTS, at_value, nodes_of, prior_of

SETS = 4000
# Factors on constants of the set, and fields.
FACTORS = {
    "capillary_stiffness_n_per_m": (0.5, 2.0),
    "vein_stiffness_n_per_m": (0.5, 2.0),
    "capillary_diameter_m": (0.5, 2.0),
    "vein_diameter_m": (0.5, 2.0),
    "vein_length_m": (0.5, 2.0),
    "venule_resistance_pa_s_per_m3": (0.1, 10.0),
    "viscosity_pa_s": (0.5, 2.0),
    "arterial_pressure_pa": (0.8, 1.25),
}
FIELDS = {"venular_share": (1e-6, 0.1), "venous_pressure_pa": (1e-6, 1e3)}


def of_tuning(scene: Scene, name: str, value: float) -> Scene:
    """The scene with a factor on one constant of its vessels, or with its value."""
    tuning = Tuning(factors={name: value}) if name in FACTORS else Tuning(**{name: value})
    return at_value(scene, "blood.tuning", tuning)


def rank() -> None:
    """Print the standard deviations."""
    scene = load_scene(data_dir("scenes") / "prototype.toml")
    light = trace(scene, photons=400_000, seed=1)

    def signal(one: Scene) -> np.ndarray:
        read = readings_over_states(light, steady_blood(one, [0.0, 1.0]))
        return 100 * read.change[0, :, 1] / read.fraction[0, :, 0]

    rows = {}
    for name, (low, high) in (FACTORS | FIELDS).items():
        scale = "log" if name in FACTORS else "linear"
        prior = Prior(field="blood.tuning", low=low, high=high, name=name, scale=scale, source="")
        rows[name] = np.array([signal(of_tuning(scene, name, max(value, 1e-6))) for value in nodes_of(prior)])
    for prior in scene.finger_priors:
        if prior.field.split(".")[0] in ("blood", "touch"):
            rows[prior.field] = np.array([signal(at_value(scene, prior.field, v)) for v in nodes_of(prior)])
    print("signal", np.round(signal(scene), 2))
    for name, values in rows.items():
        print(f"{name:30s}", np.round(np.sqrt(WEIGHTS @ (values - WEIGHTS @ values) ** 2), 2))


def tie() -> None:
    """Print how many sets meet as many rules as "best", and what remains of the priors of vessels in those."""
    priors = [one for one in shipped_priors() if one.field.removeprefix("blood.") in FACTORS_OF_SCENE]
    mean_sd = np.array([prior_of(one) for one in priors])[..., None]
    random = np.random.default_rng(0).normal(size=(len(priors), SETS))
    random[:, 0] = -mean_sd[:, 0, 0] / mean_sd[:, 1, 0]
    factor = dict(zip([one.field for one in priors], np.exp(mean_sd[:, 0] + mean_sd[:, 1] * random), strict=True))
    values = {name: np.full(SETS, one) for name, one in parameters("best").as_dict().items()}
    wall = factor["blood.wall_stiffness"]
    stiffness = values["capillary_stiffness_n_per_m"] * wall
    values["capillary_stiffness_n_per_m"] = stiffness, stiffness * factor["blood.distal_stiffness"]
    values["vein_stiffness_n_per_m"] *= wall * factor["blood.vein_stiffness"]
    values["vein_length_m"] *= factor["blood.vein_resistance"]
    met = (misses(simulate_responses_of_many(values)) == 0.0).sum(0)
    as_good = met >= met[0] - 1
    print(f"{as_good.sum()} of {SETS} sets meet at most one rule less than the {met[0]} of best; there", *factor)
    print("have of their priors the standard deviations", np.round(random[:, as_good].std(1), 2), "and correlate by")
    print(np.round(np.corrcoef(random[:, as_good]), 2))


if __name__ == "__main__":
    rank()
    tie()

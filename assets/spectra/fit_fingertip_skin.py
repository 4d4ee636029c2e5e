"""Fit the skin of the fingertip to people's ring fingers: scattering, bloodless absorption and blood of the pulp.

    python assets/spectra/fit_fingertip_skin.py

One fit: the median spectrum of 234 ring fingers (assets/real/skin_spectra.csv) by epidermis with the usual melanin over
a deep pulp: a power of wavelength and a factor on the pulp's scattering, a factor on its bloodless absorption, and its
blood. By adding-doubling, times what the walk through a ring finger gives over it, seen on the pad through the port of
a spectrophotometer, which light leaves aside of; the ratio is walked anew at each result. Then melanin alone by group
of people; for backs of hands, whose skin holds less blood, that blood once for all groups, too.
"""

from pathlib import Path

import numpy as np
from adding_doubling import ANISOTROPY, Stack
from scipy.optimize import least_squares
from scipy.stats import norm

from nailoptics import tissue
from nailoptics.assets import data_dir
from nailoptics.light import backend
from nailoptics.light.walk.nail_reflectance import NailReflectance
from nailoptics.scene import Finger, load_scene
from nailoptics.scene.base import USUAL_MELANIN_FRACTION, USUAL_SO2
from nailoptics.studies.colour.reflectance import WAVELENGTHS_NM, walk_colour
from nailoptics.studies.validation.appearance import PAD
from nailoptics.tissue import PULP_ABSORPTION, PULP_SCATTERING, PULP_SCATTERING_POWER

NM = np.arange(400.0, 701.0, 10)
EPIDERMIS_MM, PULP_MM = 0.1, 9.0
# Rays through the finger of each fit in turn. Those of the last leave the factors known to 0.0015, as seeds scatter; of
# 300 000 it would be 0.004.
RAYS = 300_000, 300_000, 5_000_000
PERCENTILES = (5, 25, 50, 75, 95)
# Standard deviations of the priors of: logarithm of the scattering, its power, logarithm of the absorption.
PRIOR_SD = np.array([0.5, 0.3, 0.8])
Spectra = dict[int, np.ndarray]


def measured(place: str) -> dict[str, tuple[int, Spectra]]:
    """Number of people and percentiles of their reflectance, by group."""
    lines = (Path(__file__).parents[1] / "real/skin_spectra.csv").read_text().splitlines()
    groups: dict[str, tuple[int, Spectra]] = {}
    for _, group, people, percentile, *values in (line.split(",") for line in lines if line.startswith(place)):
        groups.setdefault(group, (int(people), {}))[1][int(percentile)] = np.array(values, float) / 100
    return groups


def pooled(groups: dict[str, tuple[int, Spectra]]) -> Spectra:
    """Percentiles of all groups' people together, normal between the percentiles of each."""
    score, total = norm.ppf(np.array(PERCENTILES) / 100), sum(count for count, _ in groups.values())
    reflectance = np.linspace(0.0, 1.0, 4001)
    below = np.zeros((len(NM), len(reflectance)))
    for count, spectra in groups.values():
        for k, knots in enumerate(np.stack([spectra[p] for p in PERCENTILES], -1)):
            rate = (score[1] - score[0]) / (knots[1] - knots[0]), (score[-1] - score[-2]) / (knots[-1] - knots[-2])
            at = np.interp(reflectance, knots, score)
            at += rate[0] * np.minimum(reflectance - knots[0], 0) + rate[1] * np.maximum(reflectance - knots[-1], 0)
            below[k] += count / total * norm.cdf(at)
    return {p: np.array([np.interp(p / 100, one, reflectance) for one in below]) for p in PERCENTILES}


class Skin:
    """Epidermis over pulp, with its gloss: those tables include it."""

    def __init__(self) -> None:
        self.stack = Stack(1.43, 1.40)
        self.pulp = tissue.absorption("pulp", NM, so2=USUAL_SO2)
        self.scattering = {
            name: (1 - ANISOTROPY) * np.asarray(tissue.scattering(name, NM)[0]) for name in ("epidermis", "pulp")
        }
        self.gloss = ((1.43 - 1) / (1.43 + 1)) ** 2
        self.shape = np.ones(len(NM))
        self.backend = backend.choose_jit("auto", "fit").name
        backend.activate(backend.choose_jit("auto", "fit"))

    def reflects(self, scatters: float, power: float, absorbs: float, blood: float, melanin: float) -> np.ndarray:
        """Reflectance at `NM`, by factors on the pulp of the literature."""
        absorbs, scatters, power = absorbs / PULP_ABSORPTION, scatters / PULP_SCATTERING, power - PULP_SCATTERING_POWER
        above = tissue.absorption("epidermis", NM, melanin_fraction=min(melanin, 0.9))
        below = absorbs * np.asarray(self.pulp.base_per_mm) + blood * np.asarray(self.pulp.per_blood_fraction_per_mm)
        layers = (
            (1.43, np.asarray(above.base_per_mm), self.scattering["epidermis"], EPIDERMIS_MM),
            (1.40, below, scatters * (NM / 500) ** power * self.scattering["pulp"], PULP_MM),
        )
        return self.shape * self.stack.reflects(layers) + self.gloss

    def walk(self, scatters: float, power: float, absorbs: float, blood: float, *, photons: int) -> None:
        """Take for `shape` what a finger of such a pulp reflects over what flat layers do."""
        usual = PULP_SCATTERING, PULP_SCATTERING_POWER, PULP_ABSORPTION
        names = "PULP_SCATTERING", "PULP_SCATTERING_POWER", "PULP_ABSORPTION"
        for name, value in zip(names, (scatters, power, absorbs), strict=True):
            setattr(tissue, name, value)
        scene = load_scene(data_dir("scenes") / "prototype.toml")
        more = {"finger": Finger(digit="ring"), "blood": scene.blood.model_copy(update={"pulp_blood_fraction": blood})}
        scene = scene.model_copy(update=more)
        nail = NailReflectance(scene, backend=self.backend)
        rays = walk_colour(nail, [PAD], photons=photons, seed=1)
        rest = np.full((1, nail.scene.zone_count), 0.03)
        walked = rays.read(rest, scene.colour, scene=nail.scene).reflectance[0, 0, 0]
        for name, value in zip(names, usual, strict=True):
            setattr(tissue, name, value)
        self.shape = np.ones(len(NM))
        flat = self.reflects(scatters, power, absorbs, blood, USUAL_MELANIN_FRACTION) - self.gloss
        self.shape = np.interp(NM, WAVELENGTHS_NM, walked) / flat


def residual(reflectance: np.ndarray, people: Spectra) -> np.ndarray:
    """Of the logarithm from the median, in standard deviations of people."""
    return np.asarray(np.log(reflectance / people[50]) / (np.log(people[75] / people[25]) / 1.349))


def inside(reflectance: np.ndarray, people: Spectra, low: int, high: int) -> int:
    """At how many of the wavelengths a spectrum lies between two percentiles of people."""
    return int(((reflectance >= people[low]) & (reflectance <= people[high])).sum())


def values_of(x: np.ndarray) -> tuple[float, float, float, float]:
    """Scattering, its power, absorption and blood of the unknowns, which are logarithms but for the power."""
    return float(np.exp(x[0])), float(x[1]), float(np.exp(x[2])), float(np.exp(x[3]))


def misfit(x: np.ndarray, skin: Skin, people: Spectra) -> np.ndarray:
    """What the fit makes least: residuals from people's median, and from the priors."""
    reflectance = skin.reflects(*values_of(x), USUAL_MELANIN_FRACTION)
    return np.concatenate([residual(reflectance, people), x[:3] / PRIOR_SD])


def main() -> None:
    """Print the fit, and where it lies among people."""
    skin, fingers, hands = Skin(), measured("ring finger"), measured("back of hand")
    everyone = pooled(fingers)
    at = np.array([0.2, 0.1, -0.5, np.log(0.02)])
    for photons in RAYS:
        skin.walk(*values_of(at), photons=photons)
        found = least_squares(misfit, at, diff_step=1e-3, args=(skin, everyone))
        at = found.x
    scatters, power, absorbs, blood = values_of(at)
    covariance = np.linalg.inv(found.jac.T @ found.jac)
    errors = np.sqrt(np.diag(covariance))
    print(f"scattering x{scatters:.3f} (wavelength/500)^{power:+.3f}, absorption x{absorbs:.3f}, blood {blood:.4f}")
    print(f"standard errors, of logarithms but for the power: {errors.round(2).tolist()}; correlations:")
    print((covariance / errors / errors[:, None]).round(2))
    fitted = skin.reflects(scatters, power, absorbs, blood, USUAL_MELANIN_FRACTION)
    print(f"all ring fingers: within their quartiles at {inside(fitted, everyone, 25, 75)} of {len(NM)} wavelengths")

    def melanin_of(people: Spectra, blood: float) -> float:
        how = scatters, power, absorbs, blood
        x = least_squares(lambda x: residual(skin.reflects(*how, np.exp(x[0])), people), [-3.5], diff_step=1e-2).x
        return float(np.exp(x[0]))

    def hand_misfit(x: np.ndarray) -> np.ndarray:
        each = zip(x[1:], hands.values(), strict=True)
        how = scatters, power, absorbs, float(np.exp(x[0]))
        return np.concatenate([residual(skin.reflects(*how, float(np.exp(m))), one[1]) for m, one in each])

    of_hands = float(np.exp(least_squares(hand_misfit, [-5.0, *[-3.5] * len(hands)], diff_step=1e-2).x[0]))
    print(f"blood in backs of hands {of_hands:.4f}")
    for place, groups, there in (("ring finger", fingers, blood), ("back of hand", hands, of_hands)):
        for group, (_, people) in groups.items():
            melanin = melanin_of(people, there)
            shown = skin.reflects(scatters, power, absorbs, there, melanin)
            quartiles, most = inside(shown, people, 25, 75), inside(shown, people, 5, 95)
            print(f"{place} {group}: melanin {melanin:.3f}, within quartiles at {quartiles}, within 5-95 % at {most}")


if __name__ == "__main__":
    main()

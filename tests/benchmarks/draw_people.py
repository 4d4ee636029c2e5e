"""Draw the bodies of the eight people in scenes/subjects, and their vessels for the paper's figures, from stated seeds.

    python draw_people.py            # writes the bodies
    python draw_people.py vessels    # prints the people of assets/paper_claims.toml

Bodies are written into the scenes, in place: the whole [finger] table, blood at rest, of bed and pulp, with its
saturation, and the LED's flux. Vessels, contact, pulse and board stay as they are.
- Digits are given. A size is that of the digit (`nailoptics.scene.finger.ANATOMY`) times a factor with the spread of
  index fingers; the factors of one person are correlated (assets/priors.toml).
- Melanin is that of eight groups of people, from the lightest ring finger to the darkest back of a hand, as
  assets/spectra/fit_fingertip_skin.py fits it to the medians in assets/real/skin_spectra.csv.
- Tissue and blood are drawn from the joint prior (assets/priors.toml), each within the range of its own prior:
  as that was when the scenes were drawn, since another prior draws other people.
- The flux keeps every reading below the range of the converter.

Vessels of the figures: factors on the walls of the set "subject" are drawn from their joint prior, each within its own
range, until the distal bed is no softer than the set's, which would have two balances. The contact is that on which a
held proximal touch of some 1.15 N, less what the pulp's creep takes of it, shuts the vein: the readings of all subjects
level past 1 N.
"""

import re
import sys

import numpy as np

from nailoptics.assets import data_dir, read_toml
from nailoptics.hemodynamics.parameters import parameters
from nailoptics.scene import Finger, Prior, Priors
from nailoptics.scene.finger import ANATOMY
from nailoptics.scene.priors import size_priors
from nailoptics.scene.vessels import FACTORS
from nailoptics.statistics import Z95
from nailoptics.studies.people import people
from nailoptics.studies.prior_uncertainty import prior_of

SEED = 36
# Digit, group and its melanin. The first is a median of ring fingers, all others of backs of hands.
PEOPLE = (
    ("index", "CA", 0.029),
    ("middle", "AF", 0.189),
    ("ring", "JP, ring finger", 0.006),
    ("index", "TH", 0.051),
    ("thumb", "CN", 0.035),
    ("middle", "SA", 0.078),
    ("little", "IQ", 0.041),
    ("index", "AB", 0.032),
)
# Standard deviations of logarithms.
SIZE_SD = {prior.field.removeprefix("finger."): prior_of(prior)[1] for prior in size_priors(Finger())}
SIZE_CORRELATION = read_toml("priors.toml")["sizes"]["correlation"]
FLUX_MW = (0.9, 1.5)
VESSELS_SEED = 0
WALLS = ("blood.wall_stiffness", "blood.vein_stiffness", "blood.distal_stiffness")
# Force of a proximal touch that shuts the vein, and the standard deviation of its logarithm. [N]
CLOSING_N, CLOSING_SD = 1.15, 0.07
# Drawn differently, or not at all: the scenes have vessels and contact of their own.
NOT_DRAWN = (
    "finger.melanin_fraction",
    *(f"blood.{name}" for name in FACTORS),
    "blood.distal_reach",
    "blood.bone_edge_mm",
    "touch.",
)


def sizes(digit: str, rng: np.random.Generator) -> dict[str, float]:
    """Sizes of one finger. [mm]"""
    common = rng.normal()
    own = rng.normal(size=len(SIZE_SD))
    z = np.sqrt(SIZE_CORRELATION) * common + np.sqrt(1 - SIZE_CORRELATION) * own
    return {name: ANATOMY[digit][name] * np.exp(sd * one) for (name, sd), one in zip(SIZE_SD.items(), z, strict=True)}


def tissue(priors: tuple[Prior, ...], rng: np.random.Generator) -> dict[str, float]:
    """Fields of one person's tissue and blood; all within their priors."""
    mean, sd = np.array([prior_of(prior) for prior in priors]).T
    covariance = Priors().correlation(priors)
    while (np.abs(z := rng.multivariate_normal(np.zeros(len(mean)), covariance)) > 0.99 * Z95).any():
        pass
    drawn = zip(priors, mean + sd * z, strict=True)
    return {prior.field: float(np.exp(x) if prior.scale == "log" else x) for prior, x in drawn}


def vessels() -> list[dict[str, float]]:
    """Factors on the walls of the set "subject" and contact area [mm^2] of each of the people."""
    rng, p, rows = np.random.default_rng(VESSELS_SEED), parameters("subject"), []
    priors = tuple(prior for prior in Priors().of_finger() if prior.field in WALLS)
    wall_pa = p.vein_stiffness_n_per_m * p.vein_diameter_m / p.vein_area_m2
    for scene in people():
        factor = dict.fromkeys(WALLS, 0.0)
        while factor[WALLS[0]] * factor[WALLS[2]] < 1.0:
            factor = tissue(priors, rng)
        closing_pa = p.arterial_pressure_pa + factor[WALLS[0]] * factor[WALLS[1]] * wall_pa
        force_n = CLOSING_N * np.exp(CLOSING_SD * rng.normal()) * (1.0 - (scene.touch.creep or 0.0))
        row = {name: factor[name] for name in WALLS} | {"touch.contact_area_mm2": 1e6 * force_n / closing_pa}
        rows.append({name: float(f"{value:.3g}") for name, value in row.items()})
    return rows


def bodies() -> None:
    rng = np.random.default_rng(SEED)
    priors = tuple(prior for prior in Priors().of_finger() if not prior.field.startswith(NOT_DRAWN))
    for i, (digit, group, melanin) in enumerate(PEOPLE, 1):
        body = tissue(priors, rng)
        finger = sizes(digit, rng) | {k[7:]: v for k, v in body.items() if k.startswith("finger.")}
        lines = [f'digit = "{digit}"', *(f"{name} = {value:.3g}" for name, value in finger.items())]
        lines.append(f"melanin_fraction = {melanin:g} # group {group}")
        path = data_dir("scenes") / "subjects" / f"person_{i}.toml"
        text = path.read_text(encoding="utf-8")
        text = re.sub(r"(?<=\[finger\]\n).*?(?=\n\n)", "\n".join(lines), text, flags=re.DOTALL)
        own = {field[6:]: value for field, value in body.items() if field.startswith("blood.")}
        text = re.sub(r"^pulp_blood_fraction.*\n", "", text, flags=re.MULTILINE)
        text = re.sub(
            r"^rest_blood_fraction.*\n", "rest_blood_fraction = 0\npulp_blood_fraction = 0\n", text, flags=re.MULTILINE
        )
        flux_mw = np.exp(rng.uniform(*np.log(FLUX_MW)))
        for name, value in (own | {"flux_mw": flux_mw}).items():
            text = re.sub(rf"^{name} = .*$", f"{name} = {value:.3g}", text, flags=re.MULTILINE)
        path.write_text(text, encoding="utf-8")
        print(path)


if __name__ == "__main__":
    if sys.argv[1:] == ["vessels"]:
        for row in vessels():
            print("    { " + ", ".join(f'"{name}" = {value}' for name, value in row.items()) + " },")
    else:
        bodies()

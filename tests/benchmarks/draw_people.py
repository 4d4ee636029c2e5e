"""Draw the bodies of the eight people in scenes/subjects, from a stated seed. Run: python draw_people.py

Writes into the scenes, in place: the whole [finger] table, blood at rest, of bed and pulp, with its saturation, and the
LED's flux. Vessels, contact, pulse and board stay as they are.
- Digits are given. A size is that of the digit (`nailoptics.scene.finger.ANATOMY`) times a factor with the spread of
  index fingers; the factors of one person are correlated (assets/priors.toml).
- Melanin is that of eight groups of people, from the lightest ring finger to the darkest back of a hand, as
  assets/spectra/fit_fingertip_skin.py fits it to the medians in assets/real/skin_spectra.csv.
- Tissue and blood are drawn from the joint prior (assets/priors.toml), each within the range of its own prior:
  as that was when the scenes were drawn, since another prior draws other people.
- The flux keeps every reading below the range of the converter.
"""

import re

import numpy as np

from nailoptics.assets import data_dir, read_toml
from nailoptics.scene import Finger, Prior, Priors
from nailoptics.scene.finger import ANATOMY
from nailoptics.scene.priors import size_priors
from nailoptics.scene.vessels import FACTORS
from nailoptics.statistics import Z95
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
# Drawn otherwise, or not at all: the scenes have vessels and contact of their own.
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


def main() -> None:
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
    main()

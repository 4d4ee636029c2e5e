"""Fit the nail plate and its bed to people's nails: assets/spectra/nail_plate.csv, and priors with their correlation.

    python assets/spectra/fit_nail_plate.py > assets/spectra/nail_plate.csv
    python assets/spectra/fit_nail_plate.py priors         # ranges and correlations of assets/priors.toml
    python assets/spectra/fit_nail_plate.py comparison     # colours, slopes, transmittance, held-out people

Unknown: the plate's reduced scattering a (wavelength / 500 nm)^-b, its absorption

    mu_a = plateau + edge exp(-(wavelength - 450 nm) / width) + water,

its thickness, and the bed's thickness, scattering, bloodless absorption and blood, each normal on its scale with the
mean and standard deviation of `UNKNOWNS`. Reflectance of plate on bed on bone is by adding-doubling, corrected for the
finger's shape. Two steps, linearised at the result (Gauss-Newton, then corrected for the mean of draws):

1. what is known of transmittance and of the slopes with haemoglobin conditions the priors (Bayes);
2. mean and covariance then change as little as makes L*, a* and b* those of people, mean and covariance
   (consistent inversion: T. Butler et al., SIAM J. Sci. Comput. 40, A984 (2018), for normal distributions).

The result is a distribution over people, not the uncertainty of one nail. Photographs: the level of a nail is that of
the skin beside it, times what a spectrophotometer measured on backs of hands; the spread is that within a day. A
change of all three colours alike with haemoglobin, which skin in the same pictures has, too, is not fitted: red is
absorbed ten times less than green, so it is exposure, tone curve, or what goes with haemoglobin among people.
"""

import sys
import textwrap
from functools import cached_property
from pathlib import Path

import numpy as np
from adding_doubling import ANISOTROPY, Stack

from nailoptics import tissue
from nailoptics.assets import read_table
from nailoptics.studies.colour.reflectance import WAVELENGTHS_NM, Viewer

# Name, mean, standard deviation between people, and whether of the logarithm.
UNKNOWNS = (
    ("scattering at 500 nm, per mm", 2.5, 0.7, True),
    ("power of scattering", 1.2, 0.4, False),
    ("plateau of absorption, per mm", 0.06, 1.0, True),
    ("edge of absorption at 450 nm, per mm", 0.2, 0.7, True),
    ("width of the edge, nm", 35.0, 0.25, True),
    ("bed scattering", 1.0, 0.296, True),
    ("bed absorption", 0.97, 0.806, True),
    ("blood at rest", 0.0224, 0.41, True),
    ("bed thickness, mm", 1.7, 0.18, False),
    ("plate thickness, mm", 0.45, 0.04, False),
    ("scattering of a dry plate over a living one", 2.5, 0.35, True),
)
MEAN = np.array([np.log(mean) if log else mean for _, mean, _, log in UNKNOWNS])
SD = np.array([sd for _, _, sd, _ in UNKNOWNS])
LOG = np.array([log for *_, log in UNKNOWNS])
PLATE, BED = slice(0, 5), slice(5, 10)
# What a scene has where it says nothing, of the unknowns of `BED`.
USUAL_BED = np.array([1.0, 1.0, 0.03, 1.7, 0.45])
WATER = 0.20  # volume fraction; 7-35 % were measured
# Above 750 nm nothing was measured: standard deviation of the logarithm of the plateau at 800 nm from that of red.
EXTRAPOLATED = 0.4
SLOPE_NM = (500.0, 800.0)
SCATTERING_NM = 600.0

# Transmittance of nails, dry and in air: mean, and standard deviation of its logarithm with that between people.
TRANSMITTANCE_NM, TRANSMITTANCE, TRANSMITTANCE_SD = np.array([365.0, 450.0]), np.array([0.0165, 0.20]), 0.35
DRY_THICKNESS_MM = 0.44
# Measured on skin with its gloss, which a photograph shows in part: half of a plate's 4 % is in the colours.
GLOSS = 0.02
HANDS = ("CA", "CN")
# Red, green and blue of sRGB to X, Y, Z.
XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
# Reflectance of flat layers over that of a finger's nail (60 000 rays of `colour`), at these wavelengths.
SHAPE_NM, SHAPE = np.array([400.0, 500, 600, 700]), np.array([0.955, 0.963, 0.958, 0.940])
DRAWS = 128
WAVELENGTH_NM = np.arange(400.0, 701.0, 10)

HEADER = (
    "FITTED to people, not measured: absorption and reduced scattering of a healthy living nail plate. No published "
    "table was found. Written by assets/spectra/fit_nail_plate.py, which describes the fit.",
    "Measured: colours of nails of 160 people against the skin beside them and their haemoglobin (Yakimov et al., Sci. "
    "Data 11, 1070 (2024), assets/real/nail_photos.csv), carried over to skin under a spectrophotometer (Lu et "
    "al., Sci. Data (2025), assets/real/skin_spectra.csv). Transmittance: about 20 % of blue light, gradually more at "
    "longer wavelengths (400-750 nm; Photochem. Photobiol. 96, 1267-1272 (2020), doi 10.1111/php.13296), and 1.65 % "
    "(0.56 to 2.43) of UV-A through ten cadaver nails (Arch. Dermatol. 147, 439 (2011), doi "
    "10.1001/archdermatol.2010.375). n 1.5; thickness 0.40-0.48 mm; water 7-35 %. g 0.9 is assumed.",
    "Fit: mu_a = {plateau:.4f} + {edge:.4f} exp(-(wavelength - 450)/{width:.1f}) + {water:.2f} mu_a,water /mm, "
    "mu_s' = {scattering:.3f} (wavelength/500)^-{power:.3f} /mm. On the usual bed with 3 % of blood the nail has "
    "{colour}; dry, where it scatters {dry:.1f} times as much, 0.44 mm pass {blue:.0%} at 450 nm and {uv:.1%} at 365 "
    "nm. Above 750 nm nothing was measured: the plateau is extrapolated.",
    "Both are uncertain, and not independent of each other: see assets/priors.toml.",
)
COLUMNS = "wavelength_nm,mu_a_per_mm,mu_s_reduced_per_mm"


def colours(reflectance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """L*, a*, b* by daylight and linear red, green and blue of reflectances (..., q), (..., 3) float each."""
    onto = np.array([np.interp(WAVELENGTHS_NM, WAVELENGTH_NM, one) for one in np.eye(len(WAVELENGTH_NM))])
    xyz = reflectance @ (onto @ Viewer().weights)
    return lab_of(xyz), xyz @ np.linalg.inv(XYZ).T


def lab_of(xyz: np.ndarray) -> np.ndarray:
    """CIE 1976 L*, a*, b* of X, Y, Z, brighter than black, (..., 3) float."""
    x, y, z = np.moveaxis(np.cbrt(xyz / XYZ.sum(1)), -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], -1)


class People:
    """Nails of some of the people of assets/real/nail_photos.csv.

    lab : (p, 3) float. Colours carried over to skin that a spectrophotometer measured.
    """

    def __init__(self, *, held_out: bool) -> None:
        table = read_table("real/nail_photos.csv")
        chosen = (np.arange(len(table["day"])) % 3 == 2) == held_out
        self.day, self.haemoglobin = table["day"][chosen], table["hb_g_per_l"][chosen]
        self.nail, skin = (np.stack([table[f"{part}_{c}"] for c in "rgb"], -1)[chosen] for part in ("nail", "skin"))
        self.lab = lab_of(self.nail / skin * _hands_rgb() @ XYZ.T)

    def slope(self, values: np.ndarray) -> np.ndarray:
        """Of (p, k) values per 10 g/L of haemoglobin within a day, and their standard errors, (2, k) float."""
        x, y = self._within(self.haemoglobin[:, None])[:, 0], self._within(values)
        slope = x @ y / (x @ x)
        left = y - x[:, None] * slope
        freedom = len(x) - len(set(self.day)) - 1
        return 10 * np.stack([slope, np.sqrt((left**2).sum(0) / freedom / (x @ x))])

    @cached_property
    def slopes(self) -> np.ndarray:
        """Of a* and of ln G/R and ln B/R in percent, with standard errors, (2, 3) float."""
        red, green, blue = np.log(self.nail).T
        return self.slope(np.stack([lab_of(self.nail @ XYZ.T)[:, 1], 100 * (green - red), 100 * (blue - red)], -1))

    @property
    def covariance(self) -> np.ndarray:
        """Of L*, a*, b* between people within a day, (3, 3) float: exposures and the skin's own spread are left out."""
        within = self._within(lab_of(self.nail @ XYZ.T))
        return np.asarray(within.T @ within / (len(within) - len(set(self.day))))

    def _within(self, values: np.ndarray) -> np.ndarray:
        return values - np.stack([values[self.day == day].mean(0) for day in self.day])


def _hands_rgb() -> np.ndarray:
    """Linear red, green and blue of the median backs of hands of `HANDS`."""
    lines = (Path(__file__).parents[1] / "real/skin_spectra.csv").read_text().splitlines()
    rows = [line.split(",") for line in lines if line.startswith("back of hand")]
    medians = [np.array(row[4:], float) / 100 for row in rows if row[1] in HANDS and row[3] == "50"]
    return np.asarray(colours(np.mean(medians, 0))[1])


class Nail:
    """What nails of some optics have of all that was measured."""

    def __init__(self) -> None:
        bed = tissue.absorption("bed", WAVELENGTH_NM)
        self.bloodless, self.blood = np.asarray(bed.base_per_mm), np.asarray(bed.per_blood_fraction_per_mm)
        self.bed_scattering, self.bone_scattering = (
            (1 - ANISOTROPY) * np.asarray(tissue.scattering(name, WAVELENGTH_NM)[0]) for name in ("bed", "bone")
        )
        self.bone = np.asarray(tissue.absorption("bone", WAVELENGTH_NM).base_per_mm)
        self.stack, self.plate = Stack(1.5, 1.38, 1.55), Stack(1.5)

    def observed(self, u: np.ndarray) -> np.ndarray:
        """L*, a*, b*, slopes of a*, ln G/R, ln B/R and ln G, ln R per 10 g/L, and ln T, at unknowns in standard
        deviations from their means, (10,) float."""
        value = values_of(u)
        (lab, more), (rgb, more_rgb) = colours(np.stack([self._reflects(value, 0.0), self._reflects(value, 10.0)]))
        red, green, blue = 100 * np.log(more_rgb / rgb)
        dry = value[10] * scattering(value, TRANSMITTANCE_NM)
        passes = self.plate.passes((1.5, absorption(value, TRANSMITTANCE_NM), dry, DRY_THICKNESS_MM))
        slopes = [more[1] - lab[1], green - red, blue - red, green, red]
        return np.concatenate([lab, slopes, np.log(passes)])

    def _reflects(self, value: np.ndarray, more_g_per_l: float) -> np.ndarray:
        """Reflectance of people's mean haemoglobin and so much more, with its part of the gloss."""
        scatters, absorbs, blood, deep_mm, thick_mm = value[BED]
        mean_g_per_l = float(read_table("real/nail_photos.csv")["hb_g_per_l"].mean())
        bed = absorbs * self.bloodless + (1 + more_g_per_l / mean_g_per_l) * blood * self.blood
        layers = (
            (1.5, absorption(value, WAVELENGTH_NM), scattering(value, WAVELENGTH_NM), thick_mm),
            (1.38, bed, scatters * self.bed_scattering, deep_mm),
            (1.55, self.bone, self.bone_scattering, 8.0),
        )
        return self.stack.reflects(layers) / np.interp(WAVELENGTH_NM, SHAPE_NM, SHAPE) + GLOSS


def values_of(u: np.ndarray) -> np.ndarray:
    """Unknowns from their distances to the means, in standard deviations, (..., k) float."""
    at = MEAN + SD * u
    return np.where(LOG, np.exp(np.where(LOG, at, 0)), at)


def absorption(value: np.ndarray, wavelength_nm: np.ndarray) -> np.ndarray:
    """Of the plate. [mm^-1]"""
    water = read_table("spectra/water.csv")
    wet = WATER * np.interp(wavelength_nm, water["wavelength_nm"], water["mu_a_per_mm"])
    return np.asarray(value[2] + value[3] * np.exp(-(wavelength_nm - 450) / value[4]) + wet)


def scattering(value: np.ndarray, wavelength_nm: np.ndarray) -> np.ndarray:
    """Reduced scattering of the living plate. [mm^-1]"""
    return np.asarray(value[0] * (wavelength_nm / 500) ** -value[1])


class Posterior:
    """Normal distribution of the unknowns over people; mean and covariance in standard deviations of the prior."""

    def __init__(self) -> None:
        self.nail, self.people = Nail(), People(held_out=False)
        self.mean, self.covariance = np.zeros(len(UNKNOWNS)), np.eye(len(UNKNOWNS))
        wanted = np.median(self.people.lab, 0)
        target = wanted.copy()
        for _ in range(3):
            self._solve(target)
            target += wanted - self.draws[:, :3].mean(0)

    @property
    def draws(self) -> np.ndarray:
        """What is observed at draws of the posterior, always the same ones, (DRAWS, 10) float."""
        half = np.random.default_rng(1).standard_normal((DRAWS // 2, len(UNKNOWNS)))
        each = np.concatenate([half, -half]) @ np.linalg.cholesky(self.covariance).T
        return np.array([self.nail.observed(self.mean + one) for one in each])

    def _solve(self, colour: np.ndarray) -> None:
        """Gauss-Newton to the mean whose linearised colour is this one, and its covariance."""
        known, over = np.r_[3:6, 8:10], np.eye(len(UNKNOWNS))
        slopes, errors = self.people.slopes
        fact = np.concatenate([slopes, np.log(TRANSMITTANCE)])
        noise = np.concatenate([errors, np.full(2, TRANSMITTANCE_SD)])
        for _ in range(10):
            at = self.nail.observed(self.mean)
            slope = np.stack([(self.nail.observed(self.mean + 0.05 * one) - at) / 0.05 for one in over], -1)
            one, two = slope[:3], slope[known] / noise[:, None]
            given = np.linalg.inv(over + two.T @ two)
            mean = given @ two.T @ ((fact - at[known]) / noise + two @ self.mean)
            spread = one @ given @ one.T
            gain = given @ one.T @ np.linalg.inv(spread)
            step = mean + gain @ (colour - at[:3] - one @ (mean - self.mean)) - self.mean
            self.mean = self.mean + step * min(1.0, 0.7 / np.abs(step).max())
            self.covariance = given - gain @ (spread - self.people.covariance) @ gain.T
            if np.abs(step).max() < 1e-3:
                return

    def usual(self) -> np.ndarray:
        """The plate of the posterior's mean where the bed is as a scene has it, and that bed, (k,) float."""
        bed = (np.where(LOG[BED], np.log(USUAL_BED), USUAL_BED) - MEAN[BED]) / SD[BED]
        gain = self.covariance[:, BED] @ np.linalg.inv(self.covariance[BED, BED])
        return values_of(self.mean + gain @ (bed - self.mean[BED]))

    def fields(self) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
        """Fields of a scene that have a prior, their means and covariance on the scales of their priors."""
        usual = self.usual()

        def of(u: np.ndarray) -> np.ndarray:
            value, nm = values_of(u), np.array(SLOPE_NM)
            absorbs = np.log(absorption(value, nm) / absorption(usual, nm))
            scatters = np.log(scattering(value, np.array(SCATTERING_NM)) / scattering(usual, np.array(SCATTERING_NM)))
            slope = (absorbs[1] - absorbs[0]) / np.log(nm[1] / nm[0])
            bed = np.where(LOG[BED], np.log(value[BED]), value[BED])
            return np.concatenate([[absorbs[0], slope, scatters], bed])

        at = of(self.mean)
        slope = np.stack([(of(self.mean + 0.05 * one) - at) / 0.05 for one in np.eye(len(UNKNOWNS))], -1)
        covariance = slope @ self.covariance @ slope.T
        covariance[1, 1] += (EXTRAPOLATED / np.log(SLOPE_NM[1] / SLOPE_NM[0])) ** 2
        return FIELDS, at, covariance


FIELDS = (
    "finger.plate_absorption",
    "finger.plate_absorption_slope",
    "finger.plate_scattering",
    "finger.bed_scattering",
    "finger.bed_absorption",
    "blood.rest_blood_fraction",
    "finger.bed_thickness_mm",
    "finger.nail_thickness_mm",
)
LINEAR = ("finger.plate_absorption_slope", "finger.bed_thickness_mm", "finger.nail_thickness_mm")
# A correlation smaller than this is none.
LEAST_CORRELATION = 0.05


def table(posterior: Posterior) -> str:
    """The shipped table, with the fit in its header."""
    usual = posterior.usual()
    at = posterior.nail.observed(np.where(SD > 0, (np.where(LOG, np.log(usual), usual) - MEAN) / SD, 0))
    said = dict(zip(("scattering", "power", "plateau", "edge", "width"), usual[PLATE], strict=True))
    said |= {"water": WATER, "dry": usual[10], "uv": np.exp(at[8]), "blue": np.exp(at[9])}
    said["colour"] = "L* {:.0f}, a* {:.1f}, b* {:.1f}".format(*at[:3])
    header = [
        line
        for paragraph in HEADER
        for line in textwrap.wrap(
            paragraph.format(**said), 118, initial_indent="# ", subsequent_indent="# ", break_on_hyphens=False
        )
    ]
    nm = np.arange(400.0, 1001.0, 10.0)
    rows = zip(nm, absorption(usual, nm), scattering(usual, nm), strict=True)
    return "\n".join([*header, COLUMNS, *(f"{a:.0f},{b:.4f},{c:.4f}" for a, b, c in rows)]) + "\n"


def priors(posterior: Posterior) -> str:
    """Ranges that hold 95 % and correlations, as assets/priors.toml has them."""
    names, mean, covariance = posterior.fields()
    sd = np.sqrt(np.diag(covariance))
    lines = []
    for name, middle, each in zip(names, mean, sd, strict=True):
        ends = np.array([middle - 1.96 * each, middle + 1.96 * each])
        low, high = ends if name in LINEAR else np.exp(ends)
        lines.append(f"{name}: low = {low:.3g}, high = {high:.3g}")
    both = covariance / sd / sd[:, None]
    for i, j in zip(*np.triu_indices(len(names), 1), strict=True):
        if abs(both[i, j]) >= LEAST_CORRELATION:
            lines.append(f'[[correlations]]\nfields = ["{names[i]}", "{names[j]}"]\nvalue = {both[i, j]:.2f}')
    return "\n".join(lines) + "\n"


def comparison(posterior: Posterior) -> str:
    """People beside draws of the posterior: colours, slopes with haemoglobin, transmittance, held-out people."""
    draws, usual, lines = posterior.draws, posterior.usual(), []
    lines.append(
        f"unknowns: {dict(zip([one[0] for one in UNKNOWNS], values_of(posterior.mean).round(4), strict=True))}"
    )
    lines.append(f"usual: {usual.round(4).tolist()}")
    names = [
        "L*",
        "a*",
        "b*",
        "slope of a*",
        "of ln G/R [%]",
        "of ln B/R [%]",
        "of ln G [%]",
        "of ln R [%]",
        "T365",
        "T450",
    ]
    lines += [f"{name}: {x:.3f} ({y:.3f})" for name, x, y in zip(names, draws.mean(0), draws.std(0), strict=True)]
    for held_out in (False, True):
        people = People(held_out=held_out)
        lines.append(f"people, held out {held_out}: {np.median(people.lab, 0).round(1)} ({people.lab.std(0).round(1)})")
        lines.append(f"  within a day {np.sqrt(np.diag(people.covariance)).round(2)}; slopes {people.slopes.round(2)}")
        red_green = people.slope(100 * np.log(people.nail[:, :2])).round(2).tolist()
        lines.append(f"  slopes of ln R and ln G [%], with errors: {red_green}")
        low, high = np.percentile(draws[:, :3], [2.5, 97.5], axis=0)
        inside = ((people.lab > low) & (people.lab < high)).mean(0)
        lines.append(f"  within the 95 % interval of draws: L* {inside[0]:.0%}, a* {inside[1]:.0%}, b* {inside[2]:.0%}")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.stdout.write({"priors": priors, "comparison": comparison}.get("".join(sys.argv[1:]), table)(Posterior()))

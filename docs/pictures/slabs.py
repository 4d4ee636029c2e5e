"""Draw slabs.png: traced reflectance and transmittance of slabs against published tables and adding-doubling.

    python docs/pictures/slabs.py docs/pictures/slabs.png

Needs iadpython, of the test extra.
"""

import sys
from pathlib import Path

import iadpython
import numpy as np
from matplotlib.figure import Figure

import nailoptics as nail
from nailoptics.report import style

# Single scattering albedo, optical thickness, g, n, source, and R and T if published.
SLABS = [
    (0.9, 2.0, 0.75, 1.0, "van de Hulst 1980", (0.09739, 0.66096)),
    (0.9, np.inf, 0.0, 1.5, "Giovanelli 1955", (0.2600, 0.0)),
    *((a, b, g, n, "adding-doubling", None) for a, b, g, n in ((0.9, 2, 0, 1.0), (0.99, 10, 0.9, 1.0))),
    *((a, b, g, n, "adding-doubling", None) for a, b, g, n in ((0.9, 2, 0.75, 1.4), (0.99, 10, 0.0, 1.4))),
]
SCENE = """
schema_version = 1
[phantom]
[[phantom.layers]]
name = "slab"
thickness_mm = {thickness}
mu_a_per_mm = {mu_a}
mu_s_per_mm = {mu_s}
g = {g}
n = {n}
[[leds]]
name = "beam"
wavelength_nm = 800.0
pattern = "pencil"
[[photodiodes]]
name = "any"
aperture = true
position_mm = [1.0, 0.0]
"""


def traced(a: float, b: float, g: float, n: float) -> list[tuple[float, float]]:
    """Reflectance and transmittance with their standard errors, by a trace of a million photons."""
    thickness = "inf" if np.isinf(b) else 1.0
    extinction = 1.0 if np.isinf(b) else b
    text = SCENE.format(thickness=thickness, mu_a=(1 - a) * extinction, mu_s=a * extinction, g=g, n=n)
    energy = nail.trace(nail.parse_scene(text), photons=1_000_000, seed=1).energy()
    return [(energy[name]["value"], energy[name]["stderr"]) for name in ("reflected", "transmitted")]


def draw(path: Path) -> None:
    """Write the figure and print its numbers."""
    rows = []
    for a, b, g, n, source, known in SLABS:
        r, t = known or iadpython.Sample(a=a, b=b, g=g, n=n, quad_pts=16).rt()[:2]
        for name, reference, (value, error) in zip("RT", (r, t), traced(a, b, g, n), strict=True):
            if reference > 0:
                rows.append((f"{name}, a {a:g}, b {b:g}, g {g:g}, n {n:g} ({source})", reference, value, error))
                print(f"{rows[-1][0]:<55} {reference:.5f} {value:.5f} +- {error:.5f}")
    with style.drawing():
        figure = Figure(figsize=(9.0, 4.2), layout="constrained", facecolor="white")
        axes = figure.subplots()
        difference = [100 * (value / reference - 1) for _, reference, value, _ in rows]
        error = [100 * 1.96 * one / reference for _, reference, _, one in rows]
        axes.errorbar(difference, range(len(rows)), xerr=error, fmt="o", ms=4, capsize=3)
        axes.axvline(0, color=style.DARK_INK, lw=0.8)
        axes.set_yticks(range(len(rows)), [name for name, *_ in rows])
        axes.set(
            xlabel="traced minus reference [% of reference], 95 % interval", title="Slabs: validation of traced light"
        )
        axes.invert_yaxis()
        style.write_figure(figure, path, dpi=110)


if __name__ == "__main__":
    draw(Path(sys.argv[1]))

"""The paper's Fig. 4 from the shipped tables: what blood absorbs with and without oxygen, and the LEDs' lines on it."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .. import tissue
from ..io import make_folder
from ..scene.catalogue import LedPart, load_part
from . import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

OXYGENATED, DEOXYGENATED = "#c0303b", "#3a55b0"
LEDS = ("led_660", "led_800", "led_940")
# Where both curves cross, by source: 796.8 nm in the shipped table; 820 to 825 nm in that of N. Bosschaart et al.,
# Lasers Med. Sci. 29, 453 (2014).
CROSSES_BETWEEN_NM = (797.0, 825.0)


def crossing_nm() -> float:
    """Where blood absorbs alike with and without oxygen, near 800 nm, in the shipped table. [nm]"""
    wavelength = np.arange(700.0, 900.0, 0.1)
    apart = tissue.blood_mu_a_per_mm(wavelength, 1.0) - tissue.blood_mu_a_per_mm(wavelength, 0.0)
    after = int(np.flatnonzero(np.diff(np.sign(apart)))[0])
    share = apart[after] / (apart[after] - apart[after + 1])
    return float(wavelength[after] + 0.1 * share)


def draw_haemoglobins(directory: Path) -> Path:
    """Draw the figure into a folder, which is made if it is not there, and return its path: haemoglobin_fig4.png."""
    make_folder(directory)
    path = directory / "haemoglobin_fig4.png"
    style.write_figure(haemoglobins(), path, dpi=140, facecolor=style.PAPER)
    return path


@style.drawing()
def haemoglobins() -> "Figure":
    """Absorption of whole blood with and without oxygen, the shipped LEDs' lines, and the crossing near 800 nm."""
    figure, axes = style.panels(9.5, 4.4)
    wavelength = np.linspace(600.0, tissue.WAVELENGTH_RANGE_NM[1], 401)
    for so2, colour, label in ((1.0, OXYGENATED, "oxygenated"), (0.0, DEOXYGENATED, "deoxygenated")):
        axes.semilogy(wavelength, tissue.blood_mu_a_per_mm(wavelength, so2), color=colour, label=label)
    low, high = axes.get_ylim()
    for name in LEDS:
        part = load_part(name, expect=LedPart)
        assert isinstance(part, LedPart)
        # On a logarithmic axis the line stands on its lower edge.
        line = np.exp(-4 * np.log(2) * ((wavelength - part.peak_nm) / part.fwhm_nm) ** 2)
        axes.fill_between(wavelength, low, low * (high / low) ** (0.2 * line), color=style.MUTED, alpha=0.25, lw=0)
        foot = low * (high / low) ** 0.02
        axes.text(part.peak_nm, foot, f"{part.peak_nm:g} nm", ha="center", va="bottom", color=style.INK)
    axes.axvspan(*CROSSES_BETWEEN_NM, color=style.VEIN, alpha=0.12, lw=0)
    at = crossing_nm()
    axes.plot(at, tissue.blood_mu_a_per_mm(at, 1.0), "o", color=style.INK, ms=4)
    first, last = CROSSES_BETWEEN_NM
    text = f"cross at {at:.1f} nm here;\nby source at {first:g} to {last:g} nm"
    axes.text(last + 4.0, low * (high / low) ** 0.62, text, fontsize=8.5)
    axes.set(xlabel="wavelength [nm]", ylabel="absorption of whole blood [1/mm]", xlim=(600.0, wavelength[-1]))
    axes.set_ylim(low, high)
    axes.legend(loc="upper right")
    title = "Fig. 4: absorption of both haemoglobins, 150 g/L, and the LEDs' lines"
    figure.suptitle(title, x=0.02, ha="left", fontsize=11, fontweight="bold")
    return figure

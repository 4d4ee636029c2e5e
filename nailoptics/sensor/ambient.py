"""Light from outside on a photodiode: by reciprocity, from the part of its own light that would leave the finger."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .. import tissue
from ..checks import Array
from ..light import optics
from ..light.board_map import Arrivals
from ..light.transfer.reweight import attenuation
from ..scene import Photodiode, Scene
from . import electronics

LUMENS_PER_WATT = 683.0
PHOTOPIC_OBSERVER = "CIE 1924 Photopic Standard Observer"
STEP_NM = 10.0
# Silicon sees from here to there; where tissue has no data, that of the nearest wavelength stands for it.
SILICON_NM = (380.0, 1100.0)


@dataclass(frozen=True)
class Ambient:
    """Light from all sides with the spectrum of a black body; every part of the skin gets so much of it."""

    name: str
    kelvin: float
    lux: float

    def irradiance(self, wavelength_nm: ArrayLike) -> Array:
        """Spectral irradiance. [W m^-2 nm^-1]"""
        # Half a second, paid only where light from outside is requested.
        import colour

        def planck(nm: ArrayLike) -> Array:
            return np.asarray(colour.colorimetry.planck_law(np.asarray(nm, float) * 1e-9, self.kelvin))

        observer = colour.SDS_LEFS[PHOTOPIC_OBSERVER]
        lumens = LUMENS_PER_WATT * np.trapezoid(observer.values * planck(observer.wavelengths), observer.wavelengths)
        return planck(wavelength_nm) * self.lux / lumens

    def photocurrent_a_per_mm2(self, photodiode: Photodiode) -> tuple[Array, Array]:
        """Wavelengths that silicon sees [nm], and the photocurrent of each for a square millimetre in the open.
        [A/mm^2]

        Steps are equal, so that the sum is the integral.
        """
        wavelength_nm = np.arange(SILICON_NM[0], SILICON_NM[1] + STEP_NM / 2, STEP_NM)
        responsivity = electronics.photodiode_responsivity_a_per_w(photodiode, wavelength_nm)
        return wavelength_nm, 1e-6 * STEP_NM * self.irradiance(wavelength_nm) * responsivity


# Full sun, and a bright place in the light of incandescent lamps, the kind with the most infrared for its lux.
SOURCES = (Ambient("sun", 5778.0, 1e5), Ambient("lamp", 2856.0, 1e3))


def collecting_area_mm2(escaping: ArrayLike, *, area_mm2: float, n: float) -> Array:
    """Area that would collect in the open what a photodiode gets of diffuse light from all sides.

    By reciprocity: of diffuse irradiance E on the finger, a photodiode of area A in a medium of index n collects
    n^2 A E times the part of the light that would leave the finger if the photodiode were a Lambertian LED. A sun in
    one place gives no part of the skin more than its irradiance, so that the same from all sides is no less, but for
    the few percent by which steep light enters more easily.

    escaping : Part of that light, 0-1.
    """
    return n**2 * area_mm2 * np.asarray(escaping, float)


def photocurrents_a(
    escaped: Arrivals,
    scene: Scene,
    ambient: Ambient,
    *,
    traced: Scene | None = None,
    traced_nm: float,
    photodiode: Photodiode,
    area_mm2: float,
) -> Array:
    """What each photon that left adds to the photocurrent by light from outside, (n,) float; its sum over the photons
    that were emitted is the photocurrent. [A]

    Absorption is that of every wavelength, scattering that of the one traced: at shorter ones light scatters more and
    leaks less.

    traced : the scene whose light was traced, if another of the same shape and scattering.
    """
    wavelength, per_mm2 = ambient.photocurrent_a_per_mm2(photodiode)
    inside = np.clip(wavelength, *tissue.WAVELENGTH_RANGE_NM)
    change = optics.absorption(scene, inside) - optics.absorption(traced or scene, traced_nm)[0]
    part = attenuation(escaped.path_mm.astype(float), change) @ per_mm2
    n = float(tissue.scattering("epoxy", traced_nm)[2]) if scene.light.index_steps else 1.0
    return collecting_area_mm2(escaped.weight * part / escaped.photons, area_mm2=area_mm2, n=n)

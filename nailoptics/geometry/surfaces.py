"""The finger's surfaces: skin, nail, layers and bone as functions of the angle around it and the place along it."""

import numpy as np

from ..checks import Array
from ..errors import InputError
from ..scene import Finger
from ..tissue import smoothstep

PHALANX_MM = 15.8  # mean distal phalanx of adult index fingers (Buryanov, Kotiuk 2010, Int. J. Morphol. 28:755)
# Set by eye, as anatomy gives no number.
PULP_EXPONENT = 2.3  # of the superellipse that the section is on the pulp's side; on the nail's it is an ellipse
BONE_ROUNDING_MM = 3.0  # of the bone's end
FOLD_MM = 0.4  # how high the fold of skin at the nail's root rises above the nail
FOLD_LENGTH_MM = 1.5  # over which it rises


def taper(x: Array, *, exponent: float) -> Array:
    """1 at x <= 0, falling as a superellipse to 0 at x >= 1."""
    return (1 - np.clip(x, 0.0, 1.0) ** exponent) ** (1 / exponent)


def signed_angle(phi: Array) -> Array:
    """The same angle between -pi and pi. [rad]"""
    return np.remainder(phi + np.pi, 2 * np.pi) - np.pi


class FingerSurfaces:
    """A fingertip around a nail that is a piece of a cylinder; lengths in mm.

    The origin is the centre of the nail plate's outer face, x across, y to the tip, z out of the nail. The nail's
    cylinder has its axis at x = 0, z = -nail_radius. Sections are described around the line x = 0, z = center_z,
    which runs inside the bone: phi is the angle around it from z towards x.

    Sizes are anatomy's (see the finger's fields); what is between them is set by eye in proportion to these.

    fold_rad : Angle over which the skin beside the nail leaves the nail's cylinder, at least. [rad]
    nail_half_angle : Half of the angle that the nail spans around its axis. [rad]
    deep, bed_radius : Depth and radius of the bed's lower face.
    nail_end : Place of the nail's free edge; its other end lies at -nail_end.
    tip, cut, bone_end : Places of the tip, of the proximal end of what is modelled, of the end of the distal phalanx.
    """

    def __init__(self, finger: Finger, fold_rad: float) -> None:
        radius, thickness = finger.nail_radius_mm, finger.thickness_mm
        self.finger, self.fold_rad = finger, fold_rad
        self.nail_half_angle = finger.nail_width_mm / 2 / radius
        self.deep = finger.nail_thickness_mm + finger.bed_thickness_mm
        self.bed_radius = radius - self.deep
        half_span = radius * np.sin(self.nail_half_angle)
        if half_span > 0.95 * finger.width_mm / 2:
            raise InputError(
                f"finger.nail_width_mm = {finger.nail_width_mm:g} spans {2 * half_span:.2f} mm across a finger "
                f"{finger.width_mm:g} mm wide; at most {0.95 * finger.width_mm:.2f}: make the nail narrower."
            )
        drop = radius * (1 - np.cos(self.nail_half_angle))
        if drop > 0.5 * thickness:
            why = f"its sides, more than half of thickness_mm = {thickness:g}; make the nail narrower or flatter."
            raise InputError(f"finger.nail_radius_mm = {radius:g} bends the nail down by {drop:.2f} mm at {why}")
        if self.bed_radius < 0.15 * radius:
            why = f"reaches the axis of a nail of radius {radius:g} mm; make them thinner."
            raise InputError(f"finger: nail_thickness_mm + bed_thickness_mm = {self.deep:g} {why}")
        self.bone_half_height = min(0.17 * thickness, 0.3 * (thickness - self.deep), 0.8 * self.bed_radius)
        self.center_z = -(self.deep + self.bone_half_height)
        self.nail_end = finger.nail_length_mm / 2
        self.beyond_nail = finger.beyond_nail_mm
        self.tip = self.nail_end + self.beyond_nail
        self.cut = self.tip - finger.length_mm
        self.bone_end = finger.bone_end_mm

    def skin(self, phi: Array, y: Array) -> Array:
        """Distance from the central line to the skin (or nail), for angles and places that broadcast."""
        finger, half_width = self.finger, self.finger.width_mm / 2
        # The tip narrows over this length; it is blunter where a wide nail needs the width to its end.
        needed = min(1.08 * (finger.nail_radius_mm * np.sin(self.nail_half_angle)) / half_width, 0.97)
        rounding = float(min(half_width, self.beyond_nail / (1 - (1 - needed**2.5) ** 0.4)))
        width = half_width * taper((y - self.tip) / rounding + 1, exponent=2.5)
        down_length = 0.6 * finger.thickness_mm
        down = (finger.thickness_mm + self.center_z) * taper((y - self.tip) / down_length + 1, exponent=2.0)
        top = taper((y - self.nail_end) / self.beyond_nail, exponent=2.0)
        sin, cos = np.abs(np.sin(phi)), np.cos(phi)
        tiny = 1e-12  # keeps the section of zero size at the tip finite
        height = np.where(cos > 0, -self.center_z * top, down)
        power = np.where(cos > 0, 2.0, PULP_EXPONENT)
        section = ((sin / (width + tiny)) ** power + (np.abs(cos) / (height + tiny)) ** power) ** (-1 / power)
        nail = self._nail_circle(phi) * top
        edge = self.nail_angle_to_phi(np.array(self.nail_half_angle))
        across = ((np.sin(edge) / half_width) ** 2 + (np.cos(edge) / -self.center_z) ** 2) ** -0.5
        # Where the skin lies much higher than the nail's edge it takes a longer way up.
        rise = max(0.0, float(across / self._nail_circle(edge)) - 1)
        weight = smoothstep((np.abs(signed_angle(phi)) - edge) / (self.fold_rad + 0.5 * rise))
        # The mean of inverse squares follows the nearer of the two, so that a flat nail raises no fold.
        mixed = ((1 - weight) / (nail + tiny) ** 2 + weight / section**2) ** -0.5
        return mixed + (1 - weight) * self.fold(y)

    def fold(self, y: Array) -> Array:
        """Height of the skin above the nail's cylinder, same shape as y: the fold of skin over the nail's root."""
        return FOLD_MM * smoothstep((-self.nail_end - y) / FOLD_LENGTH_MM)

    def bone(self, phi: Array, y: Array) -> Array:
        """Distance from the central line to the bone at phi, y (n, m), same shape; 0 beyond its end."""
        finger = self.finger
        base = smoothstep((self.bone_end - y - 0.55 * PHALANX_MM) / (0.4 * PHALANX_MM))
        rounded = taper((y - self.bone_end) / BONE_ROUNDING_MM + 1, exponent=2.0)
        wide = finger.width_mm * (0.23 + 0.08 * base) * rounded + 1e-12
        high = self.bone_half_height * (1 + 0.25 * base) * rounded + 1e-12
        return ((np.sin(phi) / wide) ** 2 + (np.cos(phi) / high) ** 2) ** -0.5

    def nail_angle_to_phi(self, theta: Array) -> Array:
        """Angle around the central line of points of the nail's outer face at angle theta around the nail's axis."""
        radius = self.finger.nail_radius_mm
        return np.arctan2(radius * np.sin(theta), radius * np.cos(theta) - radius - self.center_z)

    def _nail_circle(self, phi: Array) -> Array:
        """Distance from the central line to the nail's cylinder."""
        radius = self.finger.nail_radius_mm
        offset = -radius - self.center_z
        along = offset * np.cos(phi)
        return along + np.sqrt(along**2 - offset**2 + radius**2)

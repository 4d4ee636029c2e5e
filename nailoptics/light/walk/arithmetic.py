"""Dr.Jit's functions of the same names, made of comparisons so that libLLVM 15 and 16 compile them, too.

For floats, Dr.Jit's own become the instructions fmaximum and fminimum, for which those two know no machine code: they
abort the process. Kernels call these here instead; the walks take the same ways, bit for bit, in the same time.
"""

from typing import Any

import drjit as dr


def maximum(a: Any, b: Any) -> Any:
    """The larger of two numbers; a NaN in the first stays."""
    return dr.select(a < b, b, a)


def minimum(a: Any, b: Any) -> Any:
    """The smaller of two numbers; a NaN in the first stays."""
    return dr.select(a > b, b, a)


def clip(x: Any, low: Any, high: Any) -> Any:
    """A number, or the end of the range beyond which it lies."""
    return minimum(maximum(x, low), high)


def safe_sqrt(x: Any) -> Any:
    """The square root of a number, and 0 for one that rounding left below 0."""
    return dr.sqrt(maximum(x, 0))


def atan2(y: Any, x: Any) -> Any:
    """The angle of a point (x, y) from the x axis, in -pi to pi, to a few parts in ten million; 0 at the origin."""
    across, along = dr.abs(y), dr.abs(x)
    radius = dr.sqrt(x * x + y * y)
    # The arc sine of the smaller side, because that of the larger one loses digits near 1.
    angle = dr.asin(dr.select(radius > 0, minimum(across, along) / radius, 0))
    angle = dr.select(across > along, dr.pi / 2 - angle, angle)
    return dr.copysign(dr.select(x < 0, dr.pi - angle, angle), y)

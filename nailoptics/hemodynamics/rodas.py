"""One step of RODAS, a stiffly accurate, L-stable Rosenbrock method of order 4 with an error estimate of order 3.

The Jacobian is a diagonal and a product of two vectors, so that a stage costs a sum and no matrix is solved.

References: Hairer and Wanner 1996, Solving Ordinary Differential Equations II, section IV.7.
"""

from collections.abc import Callable, Sequence
from typing import Any

from .unroll import larger

# The method's coefficients as its authors' code has them, where a stage needs no product with the Jacobian: gamma,
# gamma of each stage, weights of the stages in states (A) and in slopes (C), and of the curve between (H).
GAMMA = 0.25
_D = (0.25, -0.1043, 0.1035, -0.0362, 0.0, 0.0)
_A = (
    (),
    (1.544,),
    (0.9466785280815826, 0.2557011698983284),
    (3.314825187068521, 2.896124015972201, 0.9986419139977817),
    (1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950),
    (1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950, 1.0),
)
_C = (
    (),
    (-5.6688,),
    (-2.430093356833875, -0.2063599157091915),
    (-0.1073529058151375, -9.594562251023355, -20.47028614809616),
    (7.496443313967647, -10.24680431464352, -33.99990352819905, 11.70890893206160),
    (8.083246795921522, -7.981132988064893, -31.52159432874371, 16.31930543123136, -6.058818238834054),
)
_H1 = (10.12623508344586, -7.487995877610167, -34.80091861555747, -7.992771707568823, 1.025137723295662)
_H2 = (-0.6762803392801253, 6.087714651680015, 16.43084320892478, 24.76722511418386, -6.594389125716872)

# Parts of a step at which the slope is needed, and which of them each stage takes; the middle is the last.
INSTANTS = (0.0, 0.386, 0.21, 0.63, 1.0, 0.5)
_INSTANT_OF_STAGE = (0, 1, 2, 3, 4, 4)

# Weight of the defect within a step beside the error at its end: of ordinary steps the end decides.
_DEFECT_WEIGHT = 0.3

Vector = list[float]


def step(
    slope: Callable[[int, Vector], Vector],
    state: Vector,
    *,
    slope_in_time: Vector,
    jacobian: tuple[Vector, Vector, Vector],
    step_s: float,
) -> tuple[Vector, ...]:
    """One step: the state in its middle and after it, its estimated error, and the two vectors of `interpolate`.

    slope : d state/d time as a function of the position in INSTANTS and the state.
    slope_in_time : Its partial derivative by time at the start.
    jacobian : (d, p, q), its derivative by the state at the start as diag(d) + outer(p, q).
    """
    diagonal, left, right = jacobian
    inverse_step = 1.0 / step_s
    inverse = [1.0 / (inverse_step / GAMMA - d) for d in diagonal]
    spread = [p * e for p, e in zip(left, inverse, strict=True)]
    pull = [q * e for q, e in zip(right, inverse, strict=True)]
    weight = 1.0 / (1.0 - sum(q * s for q, s in zip(right, spread, strict=True)))

    def solve(residual: Vector) -> Vector:
        reach = weight * sum(q * r for q, r in zip(pull, residual, strict=True))
        return [r * e + reach * s for r, e, s in zip(residual, inverse, spread, strict=True)]

    stages: list[Vector] = []
    here = state
    for instant, a, c, d in zip(_INSTANT_OF_STAGE, _A, _C, _D, strict=True):
        here = _add(state, a, stages)
        residual = _add(slope(instant, here), [inverse_step * factor for factor in c], stages)
        stages.append(solve(_add(residual, [d * step_s] if d else [], [slope_in_time])))
    after = [a + b for a, b in zip(here, stages[5], strict=True)]
    zero = [0.0] * len(state)
    first, second = _add(zero, _H1, stages), _add(zero, _H2, stages)
    # In a long stiff step the ends can be right and the curve between them wrong: its defect in the middle, brought
    # back to an error of the state, counts too.
    middle = [interpolate(*curve, 0.5) for curve in zip(state, after, first, second, strict=True)]
    curve_slope = [(b - a + 0.25 * k2) * inverse_step for a, b, k2 in zip(state, after, second, strict=True)]
    between = solve([c - f for c, f in zip(curve_slope, slope(5, middle), strict=True)])
    error = [larger(abs(a), _DEFECT_WEIGHT * abs(b)) for a, b in zip(stages[5], between, strict=True)]
    return middle, after, error, first, second


def _add(base: Vector, factors: Sequence[float], stages: list[Vector]) -> Vector:
    """The base and the first stages times their factors."""
    total = base
    for factor, stage in zip(factors, stages, strict=False):
        total = [y + factor * k for y, k in zip(total, stage, strict=True)]
    return total


def interpolate(start: Any, end: Any, first: Any, second: Any, part: Any) -> Any:
    """One component of the state at a part 0..1 of a step, to order 3."""
    rest = 1.0 - part
    return rest * start + part * (end + rest * (first + part * second))

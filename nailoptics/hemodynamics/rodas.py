"""One step of RODAS, a stiffly accurate, L-stable Rosenbrock method of order 4 with an error estimate of order 3.

The Jacobian is a diagonal and a product of two vectors, so that a stage costs a sum and no matrix is solved.

References: Hairer and Wanner 1996, Solving Ordinary Differential Equations II, section IV.7.
"""

from collections.abc import Callable

# The method's coefficients as its authors' code has them, where a stage needs no product with the Jacobian: gamma,
# instants, gamma of each stage, weights of the stages in states (A) and in slopes (C), and of the curve between (H).
GAMMA = 0.25
_TIMES = (0.0, 0.386, 0.21, 0.63, 1.0, 1.0)
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

# Weight of the defect within a step beside the error at its end: of ordinary steps the end decides.
_DEFECT_WEIGHT = 0.3

Vector = list[float]


def step(
    slope: Callable[[float, Vector], Vector],
    time: float,
    state: Vector,
    *,
    slope_now: Vector,
    slope_in_time: Vector,
    jacobian: tuple[Vector, Vector, Vector],
    step_s: float,
) -> tuple[Vector, Vector, Vector, Vector]:
    """One step: the state after it, its estimated error (0 or more), and the two vectors that `interpolate` needs.

    slope : d state/d time as a function of time and state; slope_now is its value at the start.
    slope_in_time : Its partial derivative by time at the start.
    jacobian : (d, p, q), its derivative by the state as diag(d) + outer(p, q).
    """
    diagonal, left, right = jacobian
    inverse_step = 1.0 / step_s
    shift = inverse_step / GAMMA
    inverse = [1.0 / (shift - d) for d in diagonal]
    spread = [p * e for p, e in zip(left, inverse, strict=True)]
    pull = [q * e for q, e in zip(right, inverse, strict=True)]
    weight = 1.0 / (1.0 - sum([q * s for q, s in zip(right, spread, strict=True)]))
    stages: list[Vector] = []
    here = state
    for index in range(6):
        if index == 0:
            residual = slope_now
        else:
            if index < 5:
                here = _add(state, _A[index], stages)
            else:
                here = [a + b for a, b in zip(here, stages[4], strict=True)]
            residual = slope(time + _TIMES[index] * step_s, here)
            residual = _add(residual, [c * inverse_step for c in _C[index]], stages)
        d = _D[index] * step_s
        if d:
            residual = [r + d * t for r, t in zip(residual, slope_in_time, strict=True)]
        reach = weight * sum([q * r for q, r in zip(pull, residual, strict=True)])
        stages.append([r * e + reach * s for r, e, s in zip(residual, inverse, spread, strict=True)])
    error = stages[5]
    after = [a + b for a, b in zip(here, error, strict=True)]
    zero = [0.0] * len(state)
    first, second = _add(zero, _H1, stages), _add(zero, _H2, stages)
    # In a long stiff step the ends can be right and the curve between them wrong: its defect in the middle, brought
    # back to an error of the state, counts too.
    middle = [0.5 * (a + b) + 0.25 * k1 + 0.125 * k2 for a, b, k1, k2 in zip(state, after, first, second, strict=True)]
    defect = [
        (b - a + 0.25 * k2) * inverse_step - f
        for a, b, k2, f in zip(state, after, second, slope(time + 0.5 * step_s, middle), strict=True)
    ]
    reach = weight * sum([q * r for q, r in zip(pull, defect, strict=True)])
    between = [r * e + reach * s for r, e, s in zip(defect, inverse, spread, strict=True)]
    error = [max(abs(a), _DEFECT_WEIGHT * abs(b)) for a, b in zip(error, between, strict=True)]
    return after, error, first, second


def _add(base: Vector, factors: tuple[float, ...] | list[float], stages: list[Vector]) -> Vector:
    """The base and the first stages times their factors; spelled out, since this is the innermost loop."""
    columns = zip(base, *stages[: len(factors)], strict=True)
    if len(factors) == 1:
        (a,) = factors
        return [y + a * k1 for y, k1 in columns]
    if len(factors) == 2:
        a, b = factors
        return [y + a * k1 + b * k2 for y, k1, k2 in columns]
    if len(factors) == 3:
        a, b, c = factors
        return [y + a * k1 + b * k2 + c * k3 for y, k1, k2, k3 in columns]
    if len(factors) == 4:
        a, b, c, d = factors
        return [y + a * k1 + b * k2 + c * k3 + d * k4 for y, k1, k2, k3, k4 in columns]
    a, b, c, d, e = factors
    return [y + a * k1 + b * k2 + c * k3 + d * k4 + e * k5 for y, k1, k2, k3, k4, k5 in columns]


def interpolate(start: float, end: float, first: float, second: float, part: float) -> float:
    """One component of the state at a part 0..1 of a step, to order 3."""
    rest = 1.0 - part
    return rest * start + part * (end + rest * (first + part * second))

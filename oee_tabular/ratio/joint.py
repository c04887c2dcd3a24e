"""Both density ratios in one program, under marginal consistency.

The quotient of beta_sas' and beta_sa then has rows that sum to 1:

    minimise    [sum q B - sum p log B + ridge/2 I(B)^2]
                + [sum r b - sum s log b + ridge/2 I(b)^2]
    subject to  lower <= B, b <= upper,
                sum_s' d(s, a, s') B(s, a, s') = d(s, a) b(s, a)  for each (s, a),
                ratio_lower b <= B <= ratio_upper b,  if the ratio has its own box,

p, s the target's frequencies of (s, a, s') and (s, a); q = d(s, a) P(s' | s, a), r =
d(s, a) the simulator's, whose data enter through d(s, a) alone. The constraint says
sum_s' P B / b = 1.

Each (s, a) is solved by itself, B_x = B(s, a, x) and b together, r = sum_x q_x. With
the multiplier theta of the equality and a given b, each B_x has the coordinate's closed
form (``dual``) in its bounds, and the Lagrangian's least value is convex in b with the
derivative (envelope theorem)

    (1 - theta) r - s / b + lam b + ratio_lower sum eta - ratio_upper sum xi,

eta and xi the slopes of B at the bounds that move with b: b is a bracketed root, or of
closed form without a box. Then phi(theta) = sum q B(theta) - r b(theta) is
nonincreasing: a bracketed root again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import copysign, inf, nan
from typing import ClassVar

import numpy as np

from oee_tabular import _checks
from oee_tabular._compiling import njit
from oee_tabular._keywords import suggest_keywords
from oee_tabular.exceptions import ArgumentError
from oee_tabular.ratio import _certificate, statements
from oee_tabular.ratio.dual import ROUNDING, Box, check_box, check_ridge, coordinate
from oee_tabular.ratio.method import Method, RatioInput, SimulatorData
from oee_tabular.ratio.quotient import check_simulator_data, simulator_weights
from oee_tabular.ratio.result import TransitionRatio
from oee_tabular.ratio.statements import JointPoint, JointProgram
from oee_tabular.typing import PolicyLike


@suggest_keywords
@dataclass(frozen=True, eq=False)
class Joint(Method):
    """Both density ratios in one program, which makes rows of zeta * P sum to 1.

    The program minimises the KL risks of beta(s, a, s') and beta(s, a), with a ridge,
    in a box, under marginal consistency: sum_s' d(s, a, s') beta(s, a, s') = d(s, a)
    beta(s, a). d(s, a) alone is taken from the simulator's data: P is known.

    Parameters
    ----------
    lower : float, default 0.01
        The paper's nu, on each beta. None means 0.
    upper : float, default 10.0
        The paper's mu, on each beta. None or ``numpy.inf`` means no bound.
    ratio_lower : float, optional
        Lower bound on beta(s, a, s') / beta(s, a). None means 0.
    ratio_upper : float, optional
        Upper bound on beta(s, a, s') / beta(s, a). None means no bound.
    ridge : float or callable, default 0.0
        The ridge lambda_n of both, a number or a function of n.
    solver : str, default 'dual'
        'dual' (exact), or the name of a cvxpy solver.
    data : Transitions or 'exact', optional
        Data of the simulator, as in ``Quotient``.
    behavior_policy : (S, A) policy, optional
        Behaviour policy of these data, as in ``Quotient``.

    See Also
    --------
    Quotient : The two ratios fitted separately.

    Notes
    -----
    Limit: the program's with the simulator's exact occupancy. zeta is 1 for pairs
    outside the simulator's data.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator, target = (
    ...     oee.FiniteMDP([[[1 - p, p]]] * 2, [0, 1], [0.5, 0.5], 0.5)
    ...     for p in (0.5, 0.6)
    ... )
    >>> log = oee.sample_transitions(target, [[0.5], [0.5]], 10_000, seed=0)
    >>> Joint(data="exact").fit(log, simulator).values.data.round(1).tolist()
    [0.8, 1.2, 0.8, 1.2]
    """

    lower: float | None = 0.01
    upper: float | None = 10.0
    ratio_lower: float | None = None
    ratio_upper: float | None = None
    ridge: float | Callable[[float], float] = 0.0
    solver: str = "dual"
    data: SimulatorData = field(default=None, repr=False)
    behavior_policy: PolicyLike | None = field(default=None, repr=False)

    USES: ClassVar = frozenset({"simulator_data", "behavior_policy"})

    def __post_init__(self) -> None:
        """Check the method's options."""
        _checks.instance(self.solver, str, "solver")
        self._refuse_words(self.ridge)
        check_box(self.lower, self.upper, normalized=True)
        self._ratio_box()
        check_simulator_data(self.data)

    def _ratio_box(self) -> Box:
        """Return the checked bounds on the quotient."""
        return check_box(
            self.ratio_lower,
            self.ratio_upper,
            normalized=True,
            names=("ratio_lower", "ratio_upper"),
        )

    def _exact(self) -> Joint:
        """Return this method with the simulator's exact data."""
        return replace(self, data=None)

    def _fit(self, given: RatioInput) -> TransitionRatio:
        """Solve the joint program and take the quotient."""
        counts = given.observed
        rows = given.rows
        box = check_box(self.lower, self.upper, normalized=True)
        ratio_box = self._ratio_box()
        share = rows.sums(simulator_weights(given, self.data, self.behavior_policy))
        lam = check_ridge(self.ridge, float(counts.sum()))
        p = counts / counts.sum()
        q = rows.spread(share / share.sum()) * rows.weights
        # r is d(s, a) to the last bit as the constraint has it, so that neither ratio
        # can diverge alone.
        program = JointProgram(
            p, q, rows.sums(p), rows.sums(q), rows.indptr, *box, *ratio_box, lam
        )
        lost = (program.s > 0) & (share == 0)
        if lost.any() and not np.isfinite(box.upper) and lam == 0:
            raise ArgumentError(
                "simulator_data",
                "must cover the log's (s, a), or upper be finite: the program is"
                f" unbounded at {int(lost.sum())} of them",
            )
        if self.solver == "dual":
            point = solve_program(program)
            gap = float(_certificate.joint_gaps(program, point).sum())
        else:
            point = statements.solve_joint(program, solver=self.solver)
            # cvxpy's sign of an equality's multiplier is not the same for all programs;
            # either sign gives a bound, and the better one is kept.
            signs = (point, point._replace(theta=-point.theta))
            gaps = [_certificate.joint_gaps(program, each).sum() for each in signs]
            gap = min(float(each) for each in gaps)
        known = rows.spread((share > 0) & (point.pairs > 0))
        below = np.where(known, rows.spread(point.pairs), 1.0)
        zeta = np.where(known, point.moves / below, 1.0)
        details = {
            "lower": box.lower,
            "upper": box.upper,
            "ratio_lower": ratio_box.lower,
            "ratio_upper": ratio_box.upper,
            "moves": point.moves,
            "pairs": point.pairs,
            "pairs_without_simulator_data": int(lost.sum()),
        }
        return given.ratio(zeta, self._name, gap, details)


# The relative distance at which a bound that moves with b and a fixed one coincide.
NEAR = 1e-12


@njit(cache=True, error_model="numpy")
def slope_at(x, theta, f, g):
    """Compute dL/dB_x = (1 + theta) q_x + lam g - p_x / g at B_x = g."""
    return (1.0 + theta) * f.q[x] + f.lam * g - (f.p[x] / g if f.p[x] > 0.0 else 0.0)


@njit(cache=True, error_model="numpy")
def fill_moves(b, theta, f, k, moves):
    """Fill ``moves`` with B_x(theta, b) of row k; return the slope of min L in b.

    B_x minimises (1 + theta) q_x B - p_x log B + lam/2 B^2 within [max(nu, ratio_lower
    b), min(mu, ratio_upper b)]. The slope is (1 - theta) r - s / b + lam b plus, for
    each B_x at a bound that moves with b, that bound's factor times dL/dB_x.
    """
    lower = f.ratio_lower * b
    if not lower > f.nu:
        lower = f.nu
    upper = f.ratio_upper * b
    if not upper < f.mu:
        upper = f.mu
    slope = f.r[k] - theta * f.r[k] + f.lam * b - (f.s[k] / b if f.s[k] > 0.0 else 0.0)
    for x in range(f.indptr[k], f.indptr[k + 1]):
        g = coordinate((1.0 + theta) * f.q[x], f.lam, f.p[x], lower, upper)
        moves[x] = g
        at_lower = g <= lower and lower > f.nu
        if at_lower or (g >= upper and upper < f.mu):
            own = slope_at(x, theta, f, g)
            if at_lower and own > 0.0:
                slope += f.ratio_lower * own
            elif not at_lower and own < 0.0:
                slope += f.ratio_upper * own
    return slope


@njit(cache=True, error_model="numpy")
def minimise(theta, f, k, moves):
    """Fill ``moves`` with B(theta) of row k; return b(theta) and phi(theta).

    phi(theta) = sum_x q_x B_x(theta) - r b(theta). b is the root of the slope of
    ``fill_moves``, or has a closed form where no bound moves with it.
    """
    b = coordinate(f.r[k] - theta * f.r[k], f.lam, f.s[k], f.nu, f.mu)
    if f.ratio_lower > 0.0 or f.ratio_upper < inf:
        # The root of an increasing slope: secant steps within a bracket, halved at
        # every third step, doubled where the bracket has no end yet.
        left = f.nu
        right = f.mu
        at_left = nan
        at_right = nan
        step = 0
        b = 1.0
        if b < f.nu:
            b = f.nu
        if b > f.mu:
            b = f.mu
        while 1e-300 < b < 1e300:
            slope = fill_moves(b, theta, f, k, moves)
            if slope > 0.0:
                right = b
                at_right = slope
            else:
                left = b
                at_left = slope
            b = (left * at_right - right * at_left) / (at_right - at_left)
            step += 1
            if left == 0.0 or right == inf:
                b = 0.5 * right if left == 0.0 else 2.0 * left
            elif not left < b < right or step % 3 == 0:
                b = left + 0.5 * (right - left)
            if not left < b < right:
                break
    fill_moves(b, theta, f, k, moves)
    phi = -f.r[k] * b
    for x in range(f.indptr[k], f.indptr[k + 1]):
        phi += f.q[x] * moves[x]
    return b, phi


@njit(cache=True, error_model="numpy")
def solve(f, k, moves, at_left, at_right):
    """Solve one (s, a): fill ``moves`` with B; return b and theta.

    theta is the root of the nonincreasing phi. At a jump the point is the convex
    combination of the two ends that has phi = 0.
    """
    b, phi = minimise(0.0, f, k, moves)
    n = f.indptr[k + 1] - f.indptr[k]
    # The two sums are equal up to their own rounding.
    if b < inf and abs(phi) <= ROUNDING * (n + 2) * f.r[k] * b:
        return b, 0.0
    side = copysign(1.0, phi)
    left = 0.0
    right = 0.0
    width = 0.5
    while phi * side > 0.0 and width < 1e300:  # phi(left) >= 0 >= phi(right)
        left, right = (right, right + width) if side > 0.0 else (left - width, left)
        width *= 2.0
        b, phi = minimise(right if side > 0.0 else left, f, k, moves)
    theta = 0.5 * (left + right)
    while left < theta < right:
        b, phi = minimise(theta, f, k, moves)
        if phi >= 0.0:
            left = theta
        if phi <= 0.0:
            right = theta
        theta = 0.5 * (left + right)
    b_left, phi_left = minimise(left, f, k, at_left)
    b_right, phi_right = minimise(right, f, k, at_right)
    # The weight of the right end.
    share = phi_left / (phi_left - phi_right) if phi_left > phi_right else 0.0
    if not 0.0 <= share <= 1.0:
        share = 0.0 if phi_left < inf else 1.0
    b = (
        b_left
        if b_left == b_right or share == 0.0
        else b_left + share * (b_right - b_left)
    )
    for x in range(f.indptr[k], f.indptr[k + 1]):
        same = at_left[x] == at_right[x] or share == 0.0
        moves[x] = (
            at_left[x] if same else at_left[x] + share * (at_right[x] - at_left[x])
        )
    return b, right if share > 0.5 else left


@njit(cache=True, error_model="numpy")
def fill_multipliers(b, theta, f, k, moves, eta, xi):
    """Fill eta and xi, the multipliers of the ratio's bounds, for B, b and theta.

    eta_x = dL/dB_x where B_x is at ratio_lower b, xi_x = -dL/dB_x where it is at
    ratio_upper b, else 0. Where a moving bound coincides with a fixed one its share of
    the multiplier is what b's own condition asks for.
    """
    rest = f.r[k] - theta * f.r[k] + f.lam * b - (f.s[k] / b if f.s[k] > 0.0 else 0.0)
    loose = 0.0
    moving_lower = f.ratio_lower * b > f.nu * (1.0 + NEAR)
    moving_upper = f.ratio_upper * b < f.mu * (1.0 - NEAR)
    # The multipliers of all entries, their sum with moving bounds in ``rest``, and with
    # bounds that coincide with a fixed one in ``loose``.
    for x in range(f.indptr[k], f.indptr[k + 1]):
        eta[x] = 0.0
        xi[x] = 0.0
        slope = slope_at(x, theta, f, moves[x])
        if (
            slope > 0.0
            and f.ratio_lower > 0.0
            and moves[x] <= f.ratio_lower * b * (1.0 + NEAR)
        ):
            eta[x] = slope
            pull = f.ratio_lower * slope
            moving = moving_lower
        elif slope < 0.0 and moves[x] >= f.ratio_upper * b * (1.0 - NEAR):
            xi[x] = -slope
            pull = f.ratio_upper * slope
            moving = moving_upper
        else:
            continue
        if moving:
            rest += pull
        else:
            loose += pull
    share = 0.0
    if loose != 0.0:
        share = -rest / loose
        if share < 0.0:
            share = 0.0
        if share > 1.0:
            share = 1.0
    for x in range(f.indptr[k], f.indptr[k + 1]):
        if not moving_lower:
            eta[x] *= share
        if not moving_upper:
            xi[x] *= share


def solve_program(program: JointProgram) -> JointPoint:
    """Solve each (s, a) of the program."""
    moves, at_left, at_right = np.empty((3, len(program.p)))
    eta, xi = np.zeros((2, len(program.p)))
    b, theta = np.empty((2, len(program.s)))
    solve_all(program, moves, b, theta, eta, xi, at_left, at_right)
    return JointPoint(moves, b, theta, eta, xi)


@njit(cache=True, error_model="numpy")
def solve_all(f, moves, b, theta, eta, xi, at_left, at_right):
    """Fill B, b, theta, eta and xi of each (s, a); the last two are room for B."""
    for k in range(len(b)):
        b[k], theta[k] = solve(f, k, moves, at_left, at_right)
        fill_multipliers(b[k], theta[k], f, k, moves, eta, xi)

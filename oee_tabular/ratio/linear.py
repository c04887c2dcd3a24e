"""Ratios in linear and kernel classes: g = Phi w, and zeta = 1 + Phi w for transitions.

    minimise  sum_x q g - p log g  +  ridge/2 |w|^2
    over w,  g = offset + Phi w,  lower <= g <= upper,

and sum q g = 1 where the program is normalised: eq. 3.7 over a class. For zeta, offset
= 1 and the features are centred in each row, sum_s' P(s' | s, a) phi(s, a, s') = 0, so
that rows of zeta * P sum to 1 for every w; p = n_sas' / n and q = n_sa P / n. With
ridge = 1/n (the default) the penalty is worth one transition: a unit Gaussian prior on
w, for a kernel a Gaussian process of unit amplitude around the simulator.

*Solution*: Clarabel, by the statement of ``ratio.statements``. *Certificate*: with g
and w apart, tied by g = offset + Phi w with multiplier v, and eta that of sum q g = 1,
the dual function at any v and eta is

    D(v, eta) = sum_x min {(q + v + eta q) g - p log g}
                - v . offset - |Phi^T v|^2 / (2 ridge) - eta,

the minima over [lower, upper] in closed form: a lower bound on the optimum whatever
solver v and eta are from (v is first moved so that Phi^T v = ridge w). ``gap`` is the
value at the w that is handed over less D, a sum of terms that are none of them
negative.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular.exceptions import ArgumentError, SolverStatusError
from oee_tabular.ratio import _certificate, statements
from oee_tabular.ratio.dual import Box, check_box, check_ridge
from oee_tabular.ratio.features import (
    FeaturesLike,
    KernelFunction,
    KernelLike,
    check_kernel,
    count_rank,
    feature_array,
    kernel_features,
    move_points,
    standard_gaussian,
)
from oee_tabular.ratio.functions import N_CENTERS
from oee_tabular.ratio.method import Method, RatioInput
from oee_tabular.ratio.result import Influence, TransitionRatio
from oee_tabular.ratio.statements import LinearProgram
from oee_tabular.typing import Array, RealArrayLike

# Shares of the way to the boundary at which Clarabel's steps end. Short steps stall
# less: one of 270 random programs stalls at each, none at all three.
STEP_FRACTIONS = (0.8, 0.7, 0.5)
# The gap, in nats, above which the next of these shares is tried.
GAP_TOLERANCE_NATS = 1e-11
# The largest violation of the constraints, in units of g, of a certified fit.
VIOLATION_TOLERANCE = 1e-7
# The least slope of a term of the dual function that only a slope of at least 0 keeps
# bounded.
LEAST_SLOPE = 1e-15
# The largest ratio that the certificate considers where p = 0 and no bound is given.
LARGEST_RATIO = 1e6
# A fit with a larger gap, in nats, counts as none.
LARGEST_USEFUL_GAP_NATS = 1.0


class ClassFit(NamedTuple):
    """A fit in a class: w, g = offset + Phi w clipped to the box, eta, and the gap.

    The gap includes what the constraints are missed by.
    """

    weights: Array
    ratio: Array
    eta: float
    gap: float


def solve_class(program: LinearProgram, solver: str) -> ClassFit:
    """Solve the program by Clarabel ("dual") or another cvxpy solver, with its gap.

    Without a ridge the features are first reduced to an orthonormal basis of their
    span, and the smallest w is returned. Raises ValueError where no function of the
    class meets the constraints, RuntimeError where the solver reaches none that does.
    """
    solver = "CLARABEL" if solver == "dual" else solver
    back = np.eye(program.features.shape[1])
    best = None
    # Phi = Q S R: w = R^T S^-1 c is the smallest with Phi w = Q c.
    if program.penalty == 0.0:
        basis, values, right = np.linalg.svd(program.features, full_matrices=False)
        kept = values > 1e-10 * values.max(initial=0.0)
        program = program._replace(features=basis[:, kept])
        back = right[kept].T / values[kept]
    for fraction in STEP_FRACTIONS if solver == "CLARABEL" else (1.0,):
        solution = statements.solve_linear(
            program, solver=solver, step_fraction=fraction
        )
        fit = None if solution is None else certify(program, *solution)
        gap_to_beat = LARGEST_USEFUL_GAP_NATS if best is None else best.gap
        if fit is not None and fit.gap < gap_to_beat:
            best = fit
        if best is not None and best.gap <= GAP_TOLERANCE_NATS:
            break
    if best is None:
        _refuse_class_without_room(program)
        if program.penalty > 1e100:
            raise ArgumentError(
                "ridge",
                "must leave a program that double precision holds; it is"
                f" {program.penalty:g}",
            )
        raise SolverStatusError(
            f"{solver} found no minimum; the program may be unbounded, where q = 0 < p;"
            " give a ridge or a finite upper bound"
        )
    return best._replace(weights=back @ best.weights)


def certify(program: LinearProgram, weights: Array, tie: Array, eta: float) -> ClassFit:
    """Return the fit that w and the constraints' multipliers make, with its gap.

    The gap is infinite where w misses the constraints by more than a tolerance:

    gap = sum_x [l(g) - min l] + ridge/2 |w - Phi^T v / ridge|^2 + |eta (sum q g - 1)|,
    l(g) = (q + v + eta q) g - p log g.

    Any v gives a bound. The one that is used is near ``tie``, but has Phi^T v = ridge
    w, and q + v + eta q >= 0 where nothing else bounds an entry, so that it is not
    spoilt by the rounding of a solver. Entries with p > 0 take the change: there it
    costs its square.
    """
    p = program.p
    q = program.q
    phi = program.features
    ridge = program.penalty
    g = program.offset + phi @ weights
    # Where p > 0 the ratio must have a logarithm.
    lowest = np.maximum(program.lower, np.where(p > 0, np.finfo(float).tiny, 0.0))
    ratio = np.clip(g, lowest, program.upper)
    off = float(q @ ratio) - 1.0 if program.normalized else 0.0
    violation = max(abs(off), float(np.abs(g - ratio).max()))
    free = (p == 0) & (program.upper == np.inf)
    lacking = np.maximum(LEAST_SLOPE - (1.0 + eta) * q - tie, 0.0)
    tie = tie + np.where(free, lacking, 0.0)
    weight = np.where(p > 0, p / np.maximum(ratio, 1e-100) ** 2, 1e-6)
    curvature = phi.T @ (weight[:, None] * phi)
    # The second pass removes the rounding that the first leaves.
    for _ in range(2):
        tie = tie + weight * (
            phi @ np.linalg.lstsq(curvature, ridge * weights - phi.T @ tie)[0]
        )
    rest = ridge * weights - phi.T @ tie
    top = np.maximum(np.where(free, LARGEST_RATIO, program.upper), ratio)
    gap = (
        _certificate.excesses((1.0 + eta) * q + tie, p, ratio, program.lower, top)
        + abs(eta * off)
        + violation
    )
    if ridge > 0.0:
        gap += 0.5 / ridge * float(rest @ rest)
    else:
        # Without a ridge Phi^T v must be 0; what it is missed by counts as it is.
        largest = max(1.0, float(np.abs(weights).max(initial=0.0)))
        gap += float(np.abs(rest).sum()) * largest
    if violation > VIOLATION_TOLERANCE or np.isnan(violation):
        gap = np.inf
    return ClassFit(weights, ratio, eta, gap)


def _refuse_class_without_room(program: LinearProgram) -> None:
    """Raise an error where the class has no function strictly within the bounds.

    Where it is asked for, the function must also meet sum q g = 1.
    """
    miss = statements.nearest_miss(program)
    if miss <= -1e-9:
        return
    if miss > 1e-9:
        above = "at least"
        below = "at most"
        nearest = f"the nearest misses by {miss:g}"
    else:
        above = "above"
        below = "below"
        nearest = "none is at all points"
    upper = f" and {below} {program.upper:g}" if np.isfinite(program.upper) else ""
    one = ", with sum q g = 1" if program.normalized else ""
    raise ArgumentError(
        "features",
        f"must span a function that is {above} {program.lower:g}{upper}{one}; {nearest}"
        " (a constant feature makes one)",
    )


def fit_cells(
    p: Array,
    q: Array,
    features: Array,
    box: Box,
    ridge: float,
    normalized: bool,
    solver: str,
) -> ClassFit:
    """Fit g = Phi w to distributions p and q on the same cells."""
    _refuse_thin_box(box, normalized)
    return solve_class(
        LinearProgram(p, q, features, 0.0, ridge, *box, normalized), solver
    )


def _refuse_thin_box(box: Box, normalized: bool) -> None:
    """Raise an error for a box without an inside, which a conic solver needs."""
    if not box.lower < box.upper or (normalized and not box.lower < 1.0 < box.upper):
        rule = "lower < 1 < upper" if normalized else "lower < upper"
        raise ValueError(
            f"the box of a linear class must have {rule}; it is [{box.lower:g},"
            f" {box.upper:g}]"
        )


@suggest_keywords
@dataclass(frozen=True, eq=False)
class InClass(Method):
    """Ratio in a linear or kernel class: zeta = 1 + Phi w, all rows sharing w.

    w minimises  sum q zeta - p log zeta + ridge/2 times its squared length, p = n_sas'
    / n and q = n_sa P / n, over the box. The features are centred in each row, so that
    rows of zeta * P sum to 1.

    Parameters
    ----------
    features : array-like, data frame or callable, optional
        Features of transitions: an array aligned with ``simulator.transitions.data``,
        one of shape (S, A, S) or (S, A, S, d), a function of (s, a, s'), or a data
        frame (columns state, action, next_state, by number or name, and one a feature).
        Either these or a kernel must be given.
    kernel : 'gaussian' or callable, optional
        'gaussian' is of the coordinates of s and the displacement to s', for each
        action; a function takes (m, 1 + 2c) and (k, 1 + 2c) points (action, coordinates
        of s, displacement) and returns an (m, k) array.
    coordinates : array-like of shape (S,) or (S, c), optional
        Coordinates of each state, with a kernel.
    bandwidth : float, default 1.0
        Bandwidth of the Gaussian, in standard deviations.
    n_centers : int, default 200
        Number of transitions above which the kernel is replaced by its pivoted Cholesky
        approximation, whose error is in ``details``.
    lower : float, optional
        Lower bound on zeta. None means 0.
    upper : float, optional
        Upper bound on zeta. None means no bound.
    ridge : float or callable, optional
        The factor of the penalty in the risk per transition, or a function of n. None
        means 1 / n, worth one transition.
    solver : str, default 'dual'
        'dual' (Clarabel, with the certificate of ``ratio.linear``), or the name of
        another cvxpy solver.

    Notes
    -----
    Limit: the member of the class nearest to the target in KL risk. Cost: about forty
    steps of O(nnz d^2).

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator, target = (
    ...     oee.FiniteMDP([[[1 - p, p]]] * 2, [0, 1], [0.5, 0.5], 0.5)
    ...     for p in (0.5, 0.6)
    ... )
    >>> log = oee.sample_transitions(target, [[0.5], [0.5]], 10_000, seed=0)
    >>> InClass(features=lambda s, a, following: following).fit(
    ...     log, simulator
    ... ).values.data.round(2).tolist()
    [0.81, 1.19, 0.81, 1.19]
    """

    features: FeaturesLike | None = field(default=None, repr=False)
    kernel: KernelLike | None = None
    coordinates: RealArrayLike | None = field(default=None, repr=False)
    bandwidth: float = 1.0
    n_centers: int = N_CENTERS
    lower: float | None = None
    upper: float | None = None
    ridge: float | Callable[[float], float] | None = None
    solver: str = "dual"

    def __post_init__(self) -> None:
        """Check the method's options."""
        _checks.instance(self.solver, str, "solver")
        self._refuse_words(self.ridge)
        if self.kernel is None:
            if self.features is None:
                raise ArgumentError("features", 'must be given with method "linear"')
            if self.coordinates is not None:
                raise ArgumentError(
                    "coordinates", "must be given with a kernel; none is given"
                )
        else:
            if self.features is not None:
                raise ArgumentError(
                    "features",
                    "must be left out with a kernel: the two are different classes",
                )
            check_kernel(self.kernel)
            if self.coordinates is None:
                raise ArgumentError(
                    "coordinates",
                    'must be given with method "kernel": (S,) or (S, c), where each'
                    " state is",
                )
        _checks.positive_integer(self.n_centers, "n_centers")
        _refuse_thin_box(check_box(self.lower, self.upper, normalized=True), True)

    @property
    def _name(self) -> str:
        """Return the method's name in errors and results."""
        return "linear" if self.kernel is None else "kernel"

    def _kernel_of_moves(self, points: Array) -> KernelFunction:
        """Return the user's kernel, or the Gaussian within each action.

        The Gaussian is in standardised coordinates and displacements.
        """
        if callable(self.kernel):
            return self.kernel
        smooth = standard_gaussian(points[:, 1:], self.bandwidth)

        def kernel(x: Array, c: Array) -> Array:
            """Return the kernel of two arrays of points, 0 between actions."""
            is_same_action = x[:, :1] == c[:, 0]
            return np.asarray(is_same_action * smooth(x[:, 1:], c[:, 1:]))

        return kernel

    def _fit(self, given: RatioInput) -> TransitionRatio:
        """Solve the class's program and differentiate its solution."""
        observed = given.observed
        simulator = given.simulator
        rows = given.rows
        box = check_box(self.lower, self.upper, normalized=True)
        q = rows.weights
        details: dict[str, object] = {}
        if self.features is not None:
            phi = rows.center(feature_array(self.features, simulator))
            details["feature_rank"] = count_rank(phi, where=" within rows")
        else:
            points = move_points(simulator, self.coordinates)
            space = kernel_features(
                points, self._kernel_of_moves(points), self.n_centers
            )
            phi = rows.center(space.matrix)
            details |= {
                "kernel_residual": space.residual,
                "centers": points[space.pivots],
            }
        n = float(observed.sum())
        lam = 1.0 / n if self.ridge is None else check_ridge(self.ridge, n)
        mass = rows.spread(rows.sums(observed) / n) * q
        program = LinearProgram(observed / n, mass, phi, 1.0, lam, *box, False)
        solution = solve_class(program, self.solver)
        zeta = solution.ratio
        safe = np.maximum(zeta, 1e-12)
        details |= {
            "weights": solution.weights,
            "ridge": lam,
            "lower": box.lower,
            "upper": box.upper,
        }
        information = (phi * (observed / safe**2)[:, None]).T @ phi
        information = information + n * lam * np.eye(phi.shape[1])
        scores = phi / safe[:, None]
        share = np.zeros(len(rows))
        influence = Influence(
            rows,
            observed,
            zeta,
            q / safe,
            share,
            scores=scores,
            information=information,
        )
        return given.ratio(zeta, self._name, solution.gap, details, influence)

"""Every program as data, and as cvxpy states it for a conic solver: the reference that the structured solvers are held to.

Squares stand in epigraph form (s >= (g - c)^2 as second-order cones): a quadratic objective beside exponential cones stalls.
Only the status "optimal" is accepted.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse

from oee_tabular._checks import Array, IntArray, show
from oee_tabular.ratio.dual import Coordinates

# Clarabel is asked for the tightest of these that it can call "optimal"; 1e-8, its default, leaves ratios off by 1e-4
TOLERANCES = (1e-12, 1e-10, 1e-8)


def clarabel_options(tolerance: float) -> dict[str, Any]:
    """Clarabel's settings for a tolerance on gap and feasibility."""
    names = ("tol_gap_abs", "tol_gap_rel", "tol_feas")
    return {**dict.fromkeys(names, tolerance), "tol_ktratio": 1e-6, "max_iter": 500}


class SolverStatusError(RuntimeError):
    """The solver did not report an optimal point; its numbers are not handed on."""


class JointProgram(NamedTuple):
    """The joint program of ``ratio.joint``: p, q are (entries,), s, r (rows,); nu, mu the box, lam the ridge.

    ``ratio_lower`` and ``ratio_upper`` bound the ratio beta_sas' / beta_sa (0 and inf: free).
    """

    p: Array
    q: Array
    s: Array
    r: Array
    indptr: IntArray
    nu: float
    mu: float
    ratio_lower: float
    ratio_upper: float
    lam: float


class JointPoint(NamedTuple):
    """beta_sas', beta_sa, the multipliers of each (s, a)'s consistency and of the lower and upper bounds on their ratio."""

    moves: Array
    pairs: Array
    theta: Array
    eta: Array
    xi: Array


@dataclass(frozen=True, eq=False)
class LinearProgram:
    """The program of ``ratio.linear`` over g = offset + features w.

    p, q are (n,), features (n, d); ``penalty`` is that of |w|^2 / 2; ``normalized`` says whether sum q g = 1 is imposed.
    ``ceiling`` (n,) is an upper bound on every feasible g that the constraints imply, for the certificate's sake.
    """

    p: Array
    q: Array
    features: Array
    offset: float
    penalty: float
    lower: float
    upper: float
    normalized: bool
    ceiling: Array


@dataclass(frozen=True, eq=False)
class TiltProgram:
    """The tilt's program: counts (entries,), log of the simulator's rows, features (entries, d), rows by ``indptr``.

    ``penalty``: the positive definite matrix M of the term theta' M theta / 2 (None: the identity).
    """

    counts: Array
    log_weights: Array
    features: Array | sparse.csr_array
    indptr: IntArray
    penalty: sparse.csc_array | None = None


def check_solver(solver: str) -> None:
    """``solver`` is "dual" or a solver that cvxpy finds here."""
    import cvxpy as cp

    installed = cp.installed_solvers()
    if solver not in installed:
        raise ValueError(f"solver must be 'dual' or one of {', '.join(sorted(installed))}; got {show(solver)}")


@dataclass(frozen=True)
class Statement:
    """A cvxpy problem, its variable, and its equality constraint with the rows that it stands for (None: free)."""

    problem: Any
    variable: Any
    equality: Any
    rows: IntArray


def state_rows(program: Coordinates, lower: float, upper: float, indptr: IntArray | None) -> Statement:
    """minimise sum q g - p log g + A/2 (g - c)^2 over the box, with sum q g = sum q in each row (indptr None: free).

    Least squares: q g^2 / 2 - p g in place of the first two terms.
    """
    import cvxpy as cp

    p, q, curvature = program.p, program.q, program.curvature
    g = cp.Variable(len(p))
    seen = np.flatnonzero((p > 0) & (not program.squares))
    constraints = []
    if lower > 0 or len(seen) < len(p):
        constraints.append(g >= lower)
    if upper < np.inf:
        constraints.append(g <= upper)
    cost = -p @ g if program.squares else q @ g
    if seen.size:
        cost = cost - p[seen] @ cp.log(g[seen])
    squares = [(curvature, program.center)] + ([(q, np.zeros(len(q)))] if program.squares else [])
    for weight, center in squares:
        curved = np.flatnonzero(weight > 0)
        if curved.size:
            height = cp.Variable(curved.size)
            constraints.append(cp.square(g[curved] - center[curved]) <= height)
            cost = cost + 0.5 * (weight[curved] @ height)
    equality = None
    filled = np.zeros(0, dtype=np.int64)
    if indptr is not None:
        filled = np.flatnonzero(np.diff(indptr) > 0)
        rows = sparse.csr_array((q, np.arange(len(q)), indptr), shape=(len(indptr) - 1, len(q)))[filled]
        equality = rows @ g == np.asarray(rows.sum(axis=1)).reshape(-1)
        constraints.append(equality)
    return Statement(cp.Problem(cp.Minimize(cost), constraints), g, equality, filled)


def solve_rows(
    program: Coordinates, lower: float, upper: float, indptr: IntArray | None, *, solver: str = "CLARABEL"
) -> tuple[Array, Array]:
    """The statement above, solved by ``solver``: g inside the box, and the multipliers of the equalities (one a row).

    Raises SolverStatusError (a RuntimeError) for any status but "optimal", ValueError for a solver that is not
    installed. Cost: a conic program with an exponential cone an entry.
    """
    check_solver(solver)
    statement = state_rows(program, lower, upper, indptr)
    _solve(statement.problem, solver)
    multiplier = np.zeros(0 if indptr is None else len(indptr) - 1)
    if statement.equality is not None:
        multiplier[statement.rows] = np.ravel(statement.equality.dual_value)
    return np.clip(statement.variable.value, max(lower, np.finfo(float).tiny), upper), multiplier


def solve_joint(program: JointProgram, *, solver: str = "CLARABEL") -> JointPoint:
    """The statement of ``ratio.joint``, solved by ``solver``."""
    import cvxpy as cp

    check_solver(solver)
    moves, pairs = cp.Variable(len(program.p)), cp.Variable(len(program.s))
    cost = program.q @ moves + program.r @ pairs
    constraints = [moves >= program.nu, pairs >= program.nu]
    if program.mu < np.inf:
        constraints += [moves <= program.mu, pairs <= program.mu]
    for weights, variable in ((program.p, moves), (program.s, pairs)):
        seen = np.flatnonzero(weights > 0)
        cost = cost - weights[seen] @ cp.log(variable[seen])
        if program.lam > 0:
            height = cp.Variable(len(weights))
            constraints.append(cp.square(variable) <= height)
            cost = cost + 0.5 * program.lam * cp.sum(height)
    shape = len(program.s), len(program.q)
    rows = sparse.csr_array((program.q, np.arange(len(program.q)), program.indptr), shape=shape)
    consistency = rows @ moves == cp.multiply(np.asarray(rows.sum(axis=1)).reshape(-1), pairs)
    constraints.append(consistency)
    at_entry = pairs[np.repeat(np.arange(len(program.s)), np.diff(program.indptr))]
    below = moves >= program.ratio_lower * at_entry if program.ratio_lower > 0 else None
    above = moves <= program.ratio_upper * at_entry if program.ratio_upper < np.inf else None
    constraints += [bound for bound in (below, above) if bound is not None]
    _solve(cp.Problem(cp.Minimize(cost), constraints), solver)
    smallest = max(program.nu, np.finfo(float).tiny)
    found = [np.clip(variable.value, smallest, program.mu) for variable in (moves, pairs)]
    eta, xi = (
        np.zeros(len(program.q)) if bound is None else np.maximum(np.ravel(bound.dual_value), 0.0)
        for bound in (below, above)
    )
    return JointPoint(found[0], found[1], np.ravel(consistency.dual_value), eta, xi)


def state_linear(program: LinearProgram) -> tuple[Any, Any, Any, Any]:
    """The linear class: (problem, w, the constraint g = offset + Phi w, the constraint sum q g = 1 or None).

    Here alone the square stands in the objective: without a scaling of the rows Clarabel then gets further.
    """
    import cvxpy as cp

    g, weights = cp.Variable(len(program.p)), cp.Variable(program.features.shape[1])
    tie = g == program.offset + program.features @ weights
    constraints = [tie, g >= program.lower]
    if program.upper < np.inf:
        constraints.append(g <= program.upper)
    seen = np.flatnonzero(program.p > 0)
    cost = program.q @ g - program.p[seen] @ cp.log(g[seen])
    if program.penalty > 0:
        cost = cost + 0.5 * program.penalty * cp.sum_squares(weights)
    one = program.q @ g == 1 if program.normalized else None
    return cp.Problem(cp.Minimize(cost), constraints + ([] if one is None else [one])), weights, tie, one


def solve_linear(
    program: LinearProgram, *, solver: str = "CLARABEL", step_fraction: float = 0.99
) -> tuple[Array, Array, float] | None:
    """w, the multiplier v of g = offset + Phi w, and eta of sum q g = 1; None where no w meets the constraints.

    Clarabel's steps end at ``step_fraction`` of the way to the boundary, and what it reaches is handed over whatever its
    status: the caller has a certificate. Any other solver must report "optimal".
    """
    check_solver(solver)
    problem, weights, tie, one = state_linear(program)
    if solver == "CLARABEL":
        settings = clarabel_options(TOLERANCES[0]) | {"equilibrate_enable": False, "max_step_fraction": step_fraction}
        status = attempt(problem, solver, settings)
    else:
        status = attempt(problem, solver, {})
        if status not in ("optimal", "infeasible"):
            raise SolverStatusError(_refusal(solver, status))
    if weights.value is None or tie.dual_value is None or "infeasible" in status:
        return None
    eta = 0.0 if one is None else float(np.ravel(one.dual_value)[0])
    return np.asarray(weights.value, dtype=np.float64), np.ravel(tie.dual_value), eta


def state_tilt(program: TiltProgram) -> tuple[Any, Any]:
    """The tilt: minimise sum_k n_k log sum_x exp(log P_x + phi_x theta) - n_x phi_x theta + theta' M theta / 2.

    M is the identity, or what ``TiltRisk`` penalises by. Rows of one length share one log-sum-exp atom.
    """
    import cvxpy as cp

    theta = cp.Variable(program.features.shape[1])
    lengths = np.diff(program.indptr)
    totals = np.add.reduceat(program.counts, program.indptr[:-1])
    height = cp.Variable()
    cost = 0.5 * height - (program.counts @ program.features) @ theta
    for length in np.unique(lengths):
        rows = np.flatnonzero((lengths == length) & (totals > 0))
        if rows.size == 0:
            continue
        entries = (program.indptr[rows][:, None] + np.arange(length)).reshape(-1)
        exponents = program.features[entries] @ theta + program.log_weights[entries]
        table = cp.reshape(exponents, (rows.size, int(length)), order="C")
        cost = cost + totals[rows] @ cp.log_sum_exp(table, axis=1)
    size = cp.sum_squares(theta) if program.penalty is None else cp.quad_form(theta, cp.psd_wrap(program.penalty))
    return cp.Problem(cp.Minimize(cost), [size <= height]), theta


def solve_tilt(program: TiltProgram, *, solver: str = "CLARABEL") -> Array:
    """theta of the statement above."""
    check_solver(solver)
    problem, theta = state_tilt(program)
    _solve(problem, solver)
    return np.asarray(theta.value, dtype=np.float64)


def _solve(problem: object, solver: str) -> None:
    """Solve to the status "optimal", or SolverStatusError."""
    status = run(problem, solver)
    if status != "optimal":
        raise SolverStatusError(_refusal(solver, status))


def _refusal(solver: str, status: str) -> str:
    return f"{solver} ended with status {status!r}, not 'optimal'; its numbers are not used (use solver='dual')"


def run(problem: Any, solver: str, tolerances: tuple[float, ...] = TOLERANCES) -> str:
    """Solve, Clarabel at falling demands; the status that was reached (a failure is one)."""
    settings = [clarabel_options(t) for t in tolerances] if solver == "CLARABEL" else [{}]
    status = "failed"
    for options in settings:
        status = attempt(problem, solver, options)
        if status == "optimal":
            break
    return status


def attempt(problem: Any, solver: str, options: dict[str, Any]) -> str:
    """Solve once; the status that was reached (a failure is one)."""
    import cvxpy as cp

    try:
        with warnings.catch_warnings(), np.errstate(invalid="ignore", divide="ignore"):
            warnings.filterwarnings("ignore", message="Solution may be inaccurate")
            problem.solve(solver=solver, warm_start=False, **options)
    except cp.error.SolverError as error:
        return f"failed: {error}"
    return str(problem.status)

"""The programs of all methods as data, and as cvxpy states them for a conic solver.

They are the reference that the structured solvers are compared with. Squares stand in
epigraph form (s >= (g - c)^2 as second-order cones): a quadratic objective beside
exponential cones stalls. Only the status "optimal" is accepted.
"""

from __future__ import annotations

import warnings
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse

from oee_tabular._checks import show
from oee_tabular.exceptions import ArgumentError, SolverStatusError
from oee_tabular.ratio.dual import Coordinates
from oee_tabular.typing import Array, Csr, IntArray

# Clarabel is asked for the tightest of these tolerances on gap and feasibility that it
# can call "optimal"; 1e-8, its default, leaves ratios off by 1e-4.
TOLERANCES = (1e-12, 1e-10, 1e-8)
# The least ratio that has a logarithm.
SMALLEST_RATIO = np.finfo(float).tiny


def clarabel_options(tolerance: float) -> dict[str, Any]:
    """Return Clarabel's settings for a tolerance on gap and feasibility."""
    names = ("tol_gap_abs", "tol_gap_rel", "tol_feas")
    return {**dict.fromkeys(names, tolerance), "tol_ktratio": 1e-6, "max_iter": 500}


class JointProgram(NamedTuple):
    """The joint program of ``ratio.joint``.

    p, q are (entries,), s, r (rows,); nu and mu are the box, lam is the ridge.
    ``ratio_lower`` and ``ratio_upper`` bound the ratio beta_sas' / beta_sa (0 and inf:
    free).
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
    """A point of the joint program: beta_sas', beta_sa, and the multipliers.

    theta is the multiplier of each (s, a)'s consistency; eta and xi are those of the
    lower and upper bounds on the ratio of the two.
    """

    moves: Array
    pairs: Array
    theta: Array
    eta: Array
    xi: Array


class LinearProgram(NamedTuple):
    """The program of ``ratio.linear`` over g = offset + features w.

    p, q are (n,), features (n, d); ``penalty`` is that of |w|^2 / 2; ``normalized``
    says whether sum q g = 1 is imposed.
    """

    p: Array
    q: Array
    features: Array
    offset: float
    penalty: float
    lower: float
    upper: float
    normalized: bool


class TiltProgram(NamedTuple):
    """The program of a tilt, with rows by ``indptr``.

    Counts are (entries,), as is the logarithm of the simulator's rows; features are
    (entries, d).
    """

    counts: Array
    log_weights: Array
    features: Array
    indptr: IntArray


def solve_rows(
    program: Coordinates,
    lower: float,
    upper: float,
    indptr: IntArray | None,
    *,
    solver: str = "CLARABEL",
) -> tuple[Array, Array]:
    """Solve the separable program of ``ratio.dual`` by a cvxpy solver.

    It minimises sum q g - p log g + A/2 (g - c)^2 over the box, with sum q g = sum q in
    each row (no equality where indptr is None). Least squares have q g^2 / 2 - p g in
    place of the first two terms. Returns g inside the box, and the multipliers of the
    equalities (one a row). Raises SolverStatusError (a
    RuntimeError) for any status but "optimal", ValueError for a solver that is not
    installed. Cost: a conic program with an exponential cone an entry.
    """
    import cvxpy as cp

    p = program.p
    q = program.q
    curvature = program.curvature
    g = cp.Variable(len(p))
    has_log = np.flatnonzero((p > 0) & (not program.squares))
    constraints = []
    if lower > 0 or len(has_log) < len(p):
        constraints.append(g >= lower)
    if upper < np.inf:
        constraints.append(g <= upper)
    cost = (-p if program.squares else q) @ g
    if has_log.size:
        cost = cost - p[has_log] @ cp.log(g[has_log])
    squares = [(curvature, program.center)]
    if program.squares:
        squares.append((q, np.zeros(len(q))))
    for weight, center in squares:
        curved = np.flatnonzero(weight > 0)
        if curved.size:
            height = cp.Variable(curved.size)
            constraints.append(cp.square(g[curved] - center[curved]) <= height)
            cost = cost + 0.5 * (weight[curved] @ height)
    filled = np.flatnonzero(np.diff([0, 0] if indptr is None else indptr) > 0)
    if filled.size and indptr is not None:
        rows = _sums_over_rows(q, indptr)[filled]
        constraints.append(rows @ g == rows.sum(axis=1))
    _require_optimal(run(cp.Problem(cp.Minimize(cost), constraints), solver), solver)
    multiplier = np.zeros(0 if indptr is None else len(indptr) - 1)
    if filled.size:
        multiplier[filled] = np.ravel(constraints[-1].dual_value)
    return np.clip(g.value, max(lower, SMALLEST_RATIO), upper), multiplier


def _sums_over_rows(weights: Array, indptr: IntArray) -> Csr:
    """Return the matrix that maps (entries,) values to weighted sums over the rows."""
    return sparse.csr_array(
        (weights, np.arange(len(weights)), indptr),
        shape=(len(indptr) - 1, len(weights)),
    )


def solve_joint(program: JointProgram, *, solver: str = "CLARABEL") -> JointPoint:
    """Solve the program of ``ratio.joint`` by a cvxpy solver."""
    import cvxpy as cp

    moves = cp.Variable(len(program.p))
    pairs = cp.Variable(len(program.s))
    cost = program.q @ moves + program.r @ pairs
    rows = _sums_over_rows(program.q, program.indptr)
    consistency = rows @ moves == cp.multiply(rows.sum(axis=1), pairs)
    constraints = [consistency]
    for weights, variable in ((program.p, moves), (program.s, pairs)):
        has_log = np.flatnonzero(weights > 0)
        cost = cost - weights[has_log] @ cp.log(variable[has_log])
        constraints.append(variable >= program.nu)
        if program.mu < np.inf:
            constraints.append(variable <= program.mu)
        if program.lam > 0:
            height = cp.Variable(len(weights))
            constraints.append(cp.square(variable) <= height)
            cost = cost + 0.5 * program.lam * cp.sum(height)
    at_entry = pairs[np.repeat(np.arange(len(program.s)), np.diff(program.indptr))]
    below = None
    if program.ratio_lower > 0:
        below = moves >= program.ratio_lower * at_entry
        constraints.append(below)
    above = None
    if program.ratio_upper < np.inf:
        above = moves <= program.ratio_upper * at_entry
        constraints.append(above)
    problem = cp.Problem(cp.Minimize(cost), constraints)
    _require_optimal(run(problem, solver), solver)
    lowest = max(program.nu, SMALLEST_RATIO)
    return JointPoint(
        moves=np.clip(moves.value, lowest, program.mu),
        pairs=np.clip(pairs.value, lowest, program.mu),
        theta=np.ravel(consistency.dual_value),
        eta=_multipliers(below, len(program.q)),
        xi=_multipliers(above, len(program.q)),
    )


def _multipliers(bound: Any, n: int) -> Array:
    """Return the (n,) multipliers of a solved bound; 0 where there is no bound."""
    if bound is None:
        return np.zeros(n)
    return np.maximum(np.ravel(bound.dual_value), 0.0)


def solve_linear(
    program: LinearProgram, *, solver: str = "CLARABEL", step_fraction: float = 0.99
) -> tuple[Array, Array, float] | None:
    """Solve the program of ``ratio.linear`` by a cvxpy solver.

    Returns w, the multiplier v of g = offset + Phi w, and eta of sum q g = 1; None
    where no w meets the constraints. Clarabel's steps end at ``step_fraction`` of the
    way to the boundary, and what it reaches is returned whatever its status, since the
    caller has a certificate. Any other solver must report "optimal". Here alone the
    square stands in the objective, because without a scaling of the rows Clarabel then
    gets further.
    """
    import cvxpy as cp

    p = program.p
    q = program.q
    g = cp.Variable(len(p))
    weights = cp.Variable(program.features.shape[1])
    tie = g == program.offset + program.features @ weights
    one = q @ g == 1
    bounds = [g >= program.lower]
    if program.upper < np.inf:
        bounds.append(g <= program.upper)
    if program.normalized:
        bounds.append(one)
    has_log = np.flatnonzero(p > 0)
    risk = q @ g - p[has_log] @ cp.log(g[has_log])
    cost = risk + 0.5 * program.penalty * cp.sum_squares(weights)
    problem = cp.Problem(cp.Minimize(cost), [tie, *bounds])
    if solver == "CLARABEL":
        settings = clarabel_options(TOLERANCES[0]) | {
            "equilibrate_enable": False,
            "max_step_fraction": step_fraction,
        }
        status = _attempt(problem, solver, settings)
    else:
        status = _attempt(problem, solver, {})
        if status != "infeasible":
            _require_optimal(status, solver)
    if weights.value is None or tie.dual_value is None or "infeasible" in status:
        return None
    eta = float(np.ravel(one.dual_value)[0]) if program.normalized else 0.0
    return np.asarray(weights.value, dtype=np.float64), np.ravel(tie.dual_value), eta


def nearest_miss(program: LinearProgram) -> float:
    """Return the least violation of the bounds in the class, with sum q g = 1.

    It is negative where a function is strictly within the bounds, and inf where none
    meets the equality. It solves a linear program: minimise t >= -1 over lower - t <=
    offset + Phi w <= upper + t.
    """
    import cvxpy as cp

    weights = cp.Variable(program.features.shape[1])
    miss = cp.Variable()
    g = program.offset + program.features @ weights
    bounds = [miss >= -1, g >= program.lower - miss]
    if program.normalized:
        bounds.append(program.q @ g == 1)
    if program.upper < np.inf:
        bounds.append(g <= program.upper + miss)
    problem = cp.Problem(cp.Minimize(miss), bounds)
    return float(miss.value) if run(problem, "CLARABEL") == "optimal" else np.inf


def solve_tilt(program: TiltProgram, *, solver: str = "CLARABEL") -> Array:
    """Solve a tilt's program by a cvxpy solver; return theta.

    theta minimises sum_k n_k log sum_x exp(log P_x + phi_x theta) - n_x phi_x theta +
    |theta|^2 / 2. Rows of one length share one log-sum-exp atom.
    """
    import cvxpy as cp

    theta = cp.Variable(program.features.shape[1])
    height = cp.Variable()
    lengths = np.diff(program.indptr)
    totals = np.add.reduceat(program.counts, program.indptr[:-1])
    cost = 0.5 * height - (program.counts @ program.features) @ theta
    for length in np.unique(lengths[totals > 0]):
        rows = np.flatnonzero((lengths == length) & (totals > 0))
        entries = (program.indptr[rows][:, None] + np.arange(length)).reshape(-1)
        exponents = program.features[entries] @ theta + program.log_weights[entries]
        table = cp.reshape(exponents, (rows.size, int(length)), order="C")
        cost = cost + totals[rows] @ cp.log_sum_exp(table, axis=1)
    problem = cp.Problem(cp.Minimize(cost), [cp.sum_squares(theta) <= height])
    _require_optimal(run(problem, solver), solver)
    return np.asarray(theta.value, dtype=np.float64)


def run(problem: Any, solver: str, tolerances: tuple[float, ...] = TOLERANCES) -> str:
    """Solve a problem and return the status that was reached (a failure is one).

    Clarabel is tried at each tolerance until it reports "optimal".
    """
    status = "failed"
    settings: list[dict[str, Any]] = [{}]
    if solver == "CLARABEL":
        settings = [clarabel_options(tolerance) for tolerance in tolerances]
    for options in settings:
        status = _attempt(problem, solver, options)
        if status == "optimal":
            break
    return status


def _attempt(problem: Any, solver: str, options: dict[str, Any]) -> str:
    """Solve a problem once and return the status that was reached.

    Raises ValueError for a solver that is not installed.
    """
    import cvxpy as cp

    if solver not in cp.installed_solvers():
        raise ArgumentError(
            "solver",
            f"must be 'dual' or one of {', '.join(sorted(cp.installed_solvers()))}; got"
            f" {show(solver)}",
        )
    try:
        with warnings.catch_warnings(), np.errstate(invalid="ignore", divide="ignore"):
            warnings.filterwarnings("ignore", message="Solution may be inaccurate")
            problem.solve(solver=solver, warm_start=False, **options)
    except cp.error.SolverError as error:
        return f"failed: {error}"
    return str(problem.status)


def _require_optimal(status: str, solver: str) -> None:
    """Raise a SolverStatusError unless the status is "optimal"."""
    if status != "optimal":
        raise SolverStatusError(
            f"{solver} ended with status {status!r}, not 'optimal'; its numbers are not"
            " used (use solver='dual')"
        )

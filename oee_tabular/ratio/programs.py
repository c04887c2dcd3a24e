"""The same programs as cvxpy statements, solved by a conic solver: the reference that the structured solver is held to.

Squares stand in epigraph form (s >= (g - c)^2 as second-order cones): a quadratic objective beside exponential cones stalls.
Only the status "optimal" is accepted.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from oee_tabular._checks import Array, IntArray
from oee_tabular.ratio.dual import Coordinates
from oee_tabular.ratio.program_types import JointProgram

# Clarabel is asked for the tightest of these that it can call "optimal"; 1e-8, its default, leaves ratios off by 1e-4
TOLERANCES = (1e-12, 1e-10, 1e-8)


def clarabel_options(tolerance: float) -> dict[str, Any]:
    """Clarabel's settings for a tolerance on gap and feasibility."""
    names = ("tol_gap_abs", "tol_gap_rel", "tol_feas")
    return {**dict.fromkeys(names, tolerance), "tol_ktratio": 1e-6, "max_iter": 500}


class SolverStatusError(RuntimeError):
    """The solver did not report an optimal point; its numbers are not handed on."""


@dataclass(frozen=True)
class ProgramSolution:
    """Ratios, multipliers of the equalities (one a row), status."""

    ratio: Array
    multiplier: Array
    status: str


def check_solver(solver: str) -> None:
    """``solver`` is "dual" or a solver that cvxpy finds here."""
    import cvxpy as cp

    installed = cp.installed_solvers()
    if solver not in installed:
        raise ValueError(f"solver must be 'dual' or one of {', '.join(sorted(installed))}; got {solver!r}")


@dataclass(frozen=True)
class Statement:
    """A cvxpy problem, its variable, and its equality constraint with the rows that it stands for (None: free)."""

    problem: Any
    variable: Any
    equality: Any
    rows: IntArray


def state_rows(program: Coordinates, lower: float, upper: float, indptr: IntArray | None) -> Statement:
    """minimise sum q g - p log g + A/2 (g - c)^2 over the box, with sum q g = sum q in each row (indptr None: free)."""
    import cvxpy as cp

    p, q, curvature = program.p, program.q, program.curvature
    g = cp.Variable(len(p))
    seen, bent = np.flatnonzero(p > 0), np.flatnonzero(curvature > 0)
    constraints = []
    if lower > 0 or len(seen) < len(p):
        constraints.append(g >= lower)
    if upper < np.inf:
        constraints.append(g <= upper)
    cost = q @ g
    if seen.size:
        cost = cost - p[seen] @ cp.log(g[seen])
    if bent.size:
        height = cp.Variable(bent.size)
        constraints.append(cp.square(g[bent] - program.center[bent]) <= height)
        cost = cost + 0.5 * (curvature[bent] @ height)
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
) -> ProgramSolution:
    """The statement above, solved by ``solver``.

    Raises SolverStatusError (a RuntimeError) for any status but "optimal", ValueError for a solver that is not
    installed. Cost: a conic program with an exponential cone an entry.
    """
    check_solver(solver)
    statement = state_rows(program, lower, upper, indptr)
    status = _run(statement.problem, solver)
    if status != "optimal":
        raise SolverStatusError(
            f"{solver} ended with status {status!r}, not 'optimal'; its numbers are not used (use solver='dual')"
        )
    multiplier = np.zeros(0 if indptr is None else len(indptr) - 1)
    if statement.equality is not None:
        multiplier[statement.rows] = np.ravel(statement.equality.dual_value)
    return ProgramSolution(np.asarray(statement.variable.value, dtype=np.float64), multiplier, status)


def solve_joint(program: JointProgram, *, solver: str = "CLARABEL") -> tuple[Array, Array, Array]:
    """beta_sas', beta_sa and the multiplier of each (s, a)'s consistency; the statement of ``ratio.joint``."""
    import cvxpy as cp

    check_solver(solver)
    moves, pairs = cp.Variable(len(program.p)), cp.Variable(len(program.s))
    cost = program.q @ moves + program.r @ pairs
    constraints = [moves >= program.lower, pairs >= program.lower]
    if program.upper < np.inf:
        constraints += [moves <= program.upper, pairs <= program.upper]
    for weights, variable in ((program.p, moves), (program.s, pairs)):
        seen = np.flatnonzero(weights > 0)
        cost = cost - weights[seen] @ cp.log(variable[seen])
    for bend, variable in ((program.bend, moves), (program.stiffness, pairs)):
        if bend.any():
            height = cp.Variable(len(bend))
            constraints.append(cp.square(variable) <= height)
            cost = cost + 0.5 * (bend @ height)
    rows = sparse.csr_array(
        (program.q, np.arange(len(program.q)), program.indptr), shape=(len(program.s), len(program.q))
    )
    consistency = rows @ moves == cp.multiply(np.asarray(rows.sum(axis=1)).reshape(-1), pairs)
    constraints.append(consistency)
    problem = cp.Problem(cp.Minimize(cost), constraints)
    status = _run(problem, solver)
    if status != "optimal":
        raise SolverStatusError(
            f"{solver} ended with status {status!r}, not 'optimal'; its numbers are not used (use solver='dual')"
        )
    smallest = max(program.lower, np.finfo(float).tiny)
    found = [np.clip(variable.value, smallest, program.upper) for variable in (moves, pairs)]
    return found[0], found[1], np.ravel(consistency.dual_value)


def _run(problem: Any, solver: str) -> str:
    """Solve, Clarabel at falling demands; the status that was reached (a failure is one)."""
    import cvxpy as cp

    settings = [clarabel_options(t) for t in TOLERANCES] if solver == "CLARABEL" else [{}]
    status = "failed"
    for options in settings:
        try:
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", message="Solution may be inaccurate")
                problem.solve(solver=solver, warm_start=False, **options)
            status = str(problem.status)
        except cp.error.SolverError as error:
            status = f"failed: {error}"
        if status == "optimal":
            break
    return status

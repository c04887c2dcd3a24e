"""The programs of intervals and plans as cvxpy states them: the references for ``robust`` and for ``design``.

The robust interval's extreme over occupancies, an exponential cone an entry:

    maximise  sum x(s, a, s') r / (1 - gamma)
    subject to  d(s') = (1 - gamma) mu_0(s') + gamma sum_{s, a} x(s, a, s'),   sum_s' x(s, a, s') = pi(a | s) d(s) = X,
                sum_i phat_i X log(phat_i X / x_i) <= epsilon X,   low X <= x <= high X   in each row,

x the discounted occupancy of moves; jointly convex, since X log(X / x) is. The best plan, a second-order cone a row:

    minimise t   subject to   sum_x C_kx s_x <= t for every policy k,   s_x (b_x + q_x) >= 1,   q >= 0,
                              sum q = 1  ("free"), or the flow of the collection MDP

with b + q in units of the allocation that would be best if rows could be chosen freely.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from scipy import sparse

from oee_tabular._checks import Array
from oee_tabular.inference.ambiguity import Evidence
from oee_tabular.mdp import FiniteMDP
from oee_tabular.ratio.statements import SolverStatusError, check_solver, clarabel_options


def rectangular_program(evidence: Evidence, radius: Array, sign: float, *, solver: str = "CLARABEL") -> float:
    """The extreme of J over the rectangular KL set (largest for sign 1), infinite horizon, by ``solver``.

    Raises SolverStatusError (a RuntimeError) for any status but "optimal". Cost: a conic program with a cone an entry.
    """
    import cvxpy as cp

    if evidence.horizon is not None:
        raise ValueError(f"horizon must be None for the program over occupancies; it is {evidence.horizon}")
    check_solver(solver)
    model, gamma = evidence.model, evidence.model.discount
    rows, columns = evidence.rows, model.transitions.indices
    n_states, n_rows, entries = model.n_states, len(evidence.n), len(rows)
    d, x = cp.Variable(n_states), cp.Variable(entries)
    start = np.arange(n_rows) // model.n_actions
    share = sparse.csr_array((evidence.policy.reshape(-1), (np.arange(n_rows), start)), shape=(n_rows, n_states))
    taken = share @ d  # X of each row
    spread = sparse.csr_array((np.ones(entries), (np.arange(entries), rows)), shape=(entries, n_rows))
    into = sparse.csr_array((np.ones(entries), (columns, np.arange(entries))), shape=(n_states, entries))
    constraints: list[Any] = [
        d == (1.0 - gamma) * model.initial + gamma * (into @ x),
        spread.T @ x == taken,
        x >= sparse.diags_array(evidence.low) @ spread @ taken,
        x <= sparse.diags_array(evidence.high) @ spread @ taken,
    ]
    counted = np.isfinite(radius)
    seen = np.flatnonzero((evidence.phat > 0) & counted[rows])
    if seen.size:
        mass = sparse.diags_array(evidence.phat[seen]) @ spread[seen] @ taken
        owner = sparse.csr_array((np.ones(seen.size), (rows[seen], np.arange(seen.size))), shape=(n_rows, seen.size))
        used = np.flatnonzero(counted)
        constraints.append(
            owner[used] @ cp.rel_entr(mass, x[seen]) <= sparse.diags_array(radius[used]) @ share[used] @ d
        )
    pay = model.reward_data if model.reward_data is not None else model.rewards.reshape(-1)[rows]
    problem = cp.Problem(cp.Maximize(sign * (pay @ x)), constraints)
    status = _solve(problem, solver)
    if status != "optimal":
        raise SolverStatusError(f"{solver} ended with status {status!r}, not 'optimal'; its numbers are not used")
    return sign * float(problem.value) / (1.0 - gamma)


def conic_design(costs: Array, base: Array, mdp: FiniteMDP | None) -> tuple[Array, Array]:
    """(q, w): the program above, solved by Clarabel, and the multipliers of its policies; ``mdp`` None: free sampling.

    Raises SolverStatusError (a RuntimeError) for any status but "optimal". q is what the solver
    hands over: feasible to its tolerance. Cost: a conic program with a cone a row.
    """
    import cvxpy as cp

    n_rows = len(base)
    used = np.flatnonzero(costs.max(axis=0) > 0.0)
    rest = np.setdiff1d(np.arange(n_rows), used)
    unit = np.sqrt(costs.mean(axis=0)[used])
    unit = np.maximum(unit / unit.sum(), 1e-9)
    z, u, top = cp.Variable(used.size), cp.Variable(max(rest.size, 1), nonneg=True), cp.Variable()
    into_used, into_rest = (
        sparse.csr_array((np.ones(rows.size), (rows, np.arange(rows.size))), shape=(n_rows, max(rows.size, 1)))
        for rows in (used, rest)
    )
    q = into_used @ (cp.multiply(unit, z) - base[used]) + into_rest @ u
    inefficiency = (costs[:, used] / unit) @ cp.inv_pos(z) <= top
    constraints: list[Any] = [inefficiency, z >= base[used] / unit]
    if mdp is None:
        constraints.append(cp.sum(q) == 1.0)
    else:
        owner = sparse.csr_array(
            (np.ones(n_rows), (np.arange(n_rows) // mdp.n_actions, np.arange(n_rows))), shape=(mdp.n_states, n_rows)
        )
        flow = owner - mdp.discount * mdp.transitions.T
        constraints.append(sparse.csr_array(flow) @ q == (1.0 - mdp.discount) * mdp.initial)
    problem = cp.Problem(cp.Minimize(top), constraints)
    status = _solve(problem, "CLARABEL")
    if status != "optimal":
        raise SolverStatusError(
            f"CLARABEL ended with status {status!r}, not 'optimal'; its numbers are not used (use solver='frank_wolfe')"
        )
    weights = np.maximum(np.ravel(inefficiency.dual_value), 0.0)
    return np.asarray(q.value, dtype=np.float64), weights / weights.sum()


def _solve(problem: Any, solver: str) -> str:
    """Its status: "optimal" at 1e-10, or else what it is at 1e-8."""
    import cvxpy as cp

    status = "failed"
    for tolerance in (1e-10, 1e-8):
        try:
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", message="Solution may be inaccurate")
                problem.solve(solver=solver, **(clarabel_options(tolerance) if solver == "CLARABEL" else {}))
            status = str(problem.status)
        except cp.error.SolverError as error:
            status = f"failed: {error}"
        if status == "optimal":
            break
    return status

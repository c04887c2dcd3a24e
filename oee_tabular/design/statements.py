"""The best plan as cvxpy states it, the reference for ``design``'s own solvers: a second-order cone a row.

    minimise t   subject to   sum_x C_kx s_x <= t for every policy k,   s_x (b_x + q_x) >= 1,   q >= 0,
                              sum q = 1  ("free"), or the flow of the collection MDP

with b + q in units of the allocation that would be best if rows could be chosen freely.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from oee_tabular._checks import Array
from oee_tabular.mdp import FiniteMDP
from oee_tabular.ratio.statements import SolverStatusError, run


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
    constraints: list[object] = [inefficiency, z >= base[used] / unit]
    if mdp is None:
        constraints.append(cp.sum(q) == 1.0)
    else:
        owner = sparse.csr_array(
            (np.ones(n_rows), (np.arange(n_rows) // mdp.n_actions, np.arange(n_rows))), shape=(mdp.n_states, n_rows)
        )
        flow = owner - mdp.discount * mdp.transitions.T
        constraints.append(sparse.csr_array(flow) @ q == (1.0 - mdp.discount) * mdp.initial)
    problem = cp.Problem(cp.Minimize(top), constraints)
    status = run(problem, "CLARABEL", (1e-10, 1e-8))
    if status != "optimal":
        raise SolverStatusError(
            f"CLARABEL ended with status {status!r}, not 'optimal'; its numbers are not used (use solver='frank_wolfe')"
        )
    weights = np.maximum(np.ravel(inefficiency.dual_value), 0.0)
    return np.asarray(q.value, dtype=np.float64), weights / weights.sum()

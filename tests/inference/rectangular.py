"""The robust interval's program as cvxpy states it: the reference for ``inference.robust``."""

import cvxpy as cp
import numpy as np
from scipy import sparse

from oee_tabular.ratio.statements import run


def rectangular_program(evidence, radius, sign):
    """The extreme of J over the rectangular KL set (largest for sign 1), infinite horizon; x the occupancy of moves:

    maximise  sum x(s, a, s') r / (1 - gamma)
    subject to  d(s') = (1 - gamma) mu_0(s') + gamma sum_{s, a} x(s, a, s'),   sum_s' x(s, a, s') = pi(a | s) d(s) = X,
                sum_i phat_i X log(phat_i X / x_i) <= epsilon X,   low X <= x <= high X   in each row,

    jointly convex, since X log(X / x) is; an exponential cone an entry.
    """
    model, gamma = evidence.model, evidence.model.discount
    rows, columns = evidence.rows.spread(np.arange(len(evidence.n))), evidence.rows.arrival
    n_states, n_rows, entries = model.n_states, len(evidence.n), len(rows)
    d, x = cp.Variable(n_states), cp.Variable(entries)
    start = np.arange(n_rows) // model.n_actions
    share = sparse.csr_array((evidence.policy.reshape(-1), (np.arange(n_rows), start)), shape=(n_rows, n_states))
    taken = share @ d  # X of each row
    spread = sparse.csr_array((np.ones(entries), (np.arange(entries), rows)), shape=(entries, n_rows))
    into = sparse.csr_array((np.ones(entries), (columns, np.arange(entries))), shape=(n_states, entries))
    constraints = [
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
    problem = cp.Problem(cp.Maximize(sign * (evidence.pay @ x)), constraints)
    assert run(problem, "CLARABEL", (1e-10, 1e-8)) == "optimal"
    return sign * float(problem.value) / (1.0 - gamma)

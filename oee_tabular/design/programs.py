"""The convex programs of experimental design:  minimise over q  max_k F_k(q),  F_k(q) = sum_x C_kx / (b_x + q_x).

q is the distribution over rows x = (s, a) of the next m observations, b_x = n_x / m what the log has of each, C_k the costs of
policy k divided by m and by the best that a plan for that policy alone can reach, so that F_k is its relative inefficiency.
q is any distribution ("free"), or one that a behaviour policy can have (``design.flow``).

Both are solved by a fully corrective Frank-Wolfe method [1]: q is the best mixture of a few columns, found by a
primal-dual interior-point method in the mixture's weights; the multipliers w of the policies then define the single
objective sum_k w_k F_k, whose own solution (free) or steps (behaviour) are new columns and whose dual value bounds max_k F_k
from below for every q. The gap between the two is the certificate (for one policy the equivalence theorem [2] is its case
gap = 0); it does not depend on how the columns were found.

References: [1] B. von Hohenbalken, Simplicial decomposition in nonlinear programming, Mathematical Programming 13, 1977.
[2] F. Pukelsheim, Optimal Design of Experiments, 1993, chapter 7 (the equivalence theorem of Kiefer and Wolfowitz).

``conic_design`` is the reference: the same as cvxpy states it, with a second-order cone a row,

    minimise t   subject to   sum_x C_kx s_x <= t for every policy k,   s_x (b_x + q_x) >= 1,   q >= 0,
                              sum q = 1  ("free"), or the flow of the collection MDP

with b + q in units of the allocation that would be best if rows could be chosen freely.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from oee_tabular._checks import Array
from oee_tabular.mdp import FiniteMDP
from oee_tabular.ratio.statements import SolverStatusError, run

TOLERANCE = 1e-3  # of the relative gap
_ROUNDS, _MEMORY, _NEWTON = 200, 48, 60  # rounds, columns kept, steps of the interior-point method


@dataclass(frozen=True, eq=False)
class Design:
    """``q`` (rows,), its largest F_k ``value``, a lower ``bound`` of every q's, the policies' multipliers ``weights`` (K,)."""

    q: Array
    value: float
    bound: float
    weights: Array
    solver: str

    @property
    def gap(self) -> float:
        """(value - bound) / value: by how much, relatively, another q could be better at most."""
        return max(0.0, 1.0 - self.bound / self.value)


# (weights, q) -> a lower bound of min_q sum_k weights_k F_k, and new columns
Propose = Callable[[Array, Array], tuple[float, list[Array]]]


def evaluate(costs: Array, base: Array, q: Array) -> Array:
    """(K,) F_k(q) = sum_x C_kx / (b_x + q_x), 0 / 0 being 0; inf where a row that costs has nothing."""
    total = base + q
    empty = total <= 0.0
    finite: Array = np.sum(np.divide(costs, total, out=np.zeros_like(costs), where=~empty), axis=1)
    return np.where(np.any(costs[:, empty] > 0.0, axis=1), np.inf, finite)


def fill(cost: Array, base: Array) -> Array:
    """The q >= 0, sum q = 1, that minimises sum_x c_x / (b_x + q_x): b + q = max(b, t sqrt(c)), exactly.

    With b = 0 Neyman's allocation q ~ sqrt(c), value (sum sqrt c)^2. Cost: O(rows log rows).

    >>> fill(np.array([1.0, 4.0]), np.zeros(2)), fill(np.array([1.0, 4.0]), np.array([1.0, 0.0]))
    (array([0.33333333, 0.66666667]), array([0., 1.]))
    """
    root = np.sqrt(cost)
    rows = np.flatnonzero(root > 0.0)
    order = rows[np.argsort(base[rows] / root[rows], kind="stable")]
    level = (1.0 + np.cumsum(base[order])) / np.cumsum(root[order])  # t, if the first so many rows get a share
    number = int(np.flatnonzero(level > base[order] / root[order])[-1])
    q = np.zeros_like(cost)
    q[order[: number + 1]] = level[number] * root[order[: number + 1]] - base[order[: number + 1]]
    q = np.maximum(q, 0.0)
    return np.asarray(q / q.sum())


def free_design(costs: Array, base: Array, *, tolerance: float = TOLERANCE) -> Design:
    """The best distribution over rows; for one policy ``fill`` itself."""

    def propose(weights: Array, q: Array) -> tuple[float, list[Array]]:
        column = fill(weights @ costs, base)
        return float(weights @ evaluate(costs, base, column)), [column]

    columns = [fill(cost, base) for cost in costs]
    if len(costs) > 1:
        columns.append(fill(costs.mean(axis=0), base))
    return minimise(costs, base, columns, propose, solver="closed form" if len(costs) == 1 else "frank_wolfe",
                    tolerance=tolerance)  # fmt: skip


def minimise(
    costs: Array, base: Array, columns: list[Array], propose: Propose, *, solver: str, tolerance: float = TOLERANCE
) -> Design:
    """Mix the columns, ask ``propose`` for a bound and new ones, until the relative gap is at most ``tolerance``.

    The result is no worse than any of the first columns. Ends after 200 rounds with the gap that it then has. Cost of a
    round: O(rows * 48^2) at most for a Newton step of the mixture (48 columns are kept), and what ``propose`` costs.
    """
    table = np.array(columns)
    values = [float(evaluate(costs, base, q).max()) for q in table]
    q, best = table[int(np.argmin(values))], min(values)
    bound, weights = -np.inf, np.full(len(costs), 1.0 / len(costs))
    share = np.full(len(table), 1.0 / len(table))
    for _ in range(_ROUNDS):
        share, w = mixture(costs, base, table, share)
        point = share @ table
        value = float(evaluate(costs, base, point).max())
        if value < best:
            q, best = point, value
        lower, new = propose(w, point)
        if lower > bound:
            bound, weights = lower, w
        if best - bound <= tolerance * best:
            break
        kept = np.argsort(-share, kind="stable")[: _MEMORY - 1 - len(new)]
        kept = kept[share[kept] > 1e-9]
        table = np.concatenate([[point], table[kept], np.array(new)])
        share = np.concatenate([[0.5], 0.4 * share[kept] / share[kept].sum(), np.full(len(new), 0.1 / len(new))])
    return Design(q, best, bound, weights, solver)


def mixture(costs: Array, base: Array, table: Array, start: Array) -> tuple[Array, Array]:
    """(shares, w): the mixture of the rows of ``table`` (J, rows) that minimises max_k F_k, and the multipliers of the F_k.

    minimise t  subject to  F_k(share @ table) + slack_k = t,  share >= 0,  sum share = 1: a primal-dual interior-point method
    from the positive ``start``. Its accuracy bears on the speed of ``minimise``, not on its certificate.
    """
    n_columns, n_costs = len(table), len(costs)
    if n_columns == 1 and n_costs == 1:
        return np.ones(1), np.ones(1)
    used = np.flatnonzero(costs.max(axis=0) > 0.0)
    c, b, v = costs[:, used], base[used], table[:, used]
    share = 0.9 * start / start.sum() + 0.1 / n_columns
    values = np.sum(c / (b + share @ v), axis=1)
    top = 1.1 * float(values.max())
    slack, w = top - values, np.full(n_costs, 1.0 / n_costs)
    reduced, level = np.full(n_columns, float(w @ slack) / n_costs) / share, 0.0
    for _ in range(_NEWTON):
        total = b + share @ v
        values = np.sum(c / total, axis=1)
        slope = -(c / total**2) @ v.T  # (K, J)
        bend = (v * (2.0 * (w @ c) / total**3)) @ v.T
        dual = w @ slope - reduced + level
        primal = values + slack - top
        gap = float(w @ slack + reduced @ share)
        if gap <= 1e-10 * top and max(np.abs(dual).max(), np.abs(primal).max(), abs(1.0 - w.sum())) <= 1e-9 * top:
            break
        mu = 0.15 * gap / (n_costs + n_columns)
        ratio = w / slack
        pull = mu / slack - w + ratio * primal
        system = np.zeros((n_columns + 2, n_columns + 2))
        system[:-2, :-2] = bend + slope.T @ (ratio[:, None] * slope) + np.diag(reduced / share)
        system[:-2, -2] = system[-2, :-2] = -(ratio @ slope)
        system[-2, -2] = ratio.sum()
        system[:-2, -1] = system[-1, :-2] = 1.0
        right = np.concatenate(
            [-dual - pull @ slope + mu / share - reduced, [pull.sum() - (1.0 - w.sum())], [1.0 - share.sum()]]
        )
        try:
            step = np.linalg.solve(system, right)
        except np.linalg.LinAlgError:
            break
        d_share, d_top = step[:-2], float(step[-2])
        d_slack = d_top - primal - slope @ d_share
        d_w, d_reduced = (mu - w * slack - w * d_slack) / slack, (mu - reduced * share - reduced * d_share) / share
        if not np.all(np.isfinite(np.concatenate([step, d_w, d_reduced]))):
            break
        length = min(_longest(*pair) for pair in ((share, d_share), (slack, d_slack), (w, d_w), (reduced, d_reduced)))
        share, slack, top = share + length * d_share, slack + length * d_slack, top + length * d_top
        w, reduced, level = w + length * d_w, reduced + length * d_reduced, level + length * float(step[-1])
    return share / share.sum(), w / w.sum()


def _longest(x: Array, step: Array) -> float:
    """The largest step in (0, 1] that keeps x positive, with a margin."""
    falls = step < 0.0
    return float(min(1.0, 0.99 * np.min(-x[falls] / step[falls], initial=2.0)))


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

"""The programs of experimental design: minimise over q  max_k F_k(q),  F_k(q) = sum_x
C_kx / (b_x + q_x).

Two ways to solve them, stated at the door of the room (``oee_tabular.design``): an
interior point method (``solve_by_interior_point``), and the statement in cvxpy
(``solve_by_clarabel``). Both end with a value and a lower bound that do not depend on
how q was found.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import aslinearoperator, cg

from oee_tabular._sparse import canonical
from oee_tabular.exact import occupancy
from oee_tabular.exceptions import ArgumentError, SolverStatusError
from oee_tabular.mdp import FiniteMDP, uniform_policy
from oee_tabular.ratio.statements import run
from oee_tabular.typing import Array, BoolArray

Solver = Literal["auto", "frank_wolfe", "CLARABEL"]
# q (S*A,), its largest F_k, and a lower bound of that of every q
Solution = tuple[Array, float, float]
TOLERANCE = 1e-4  # the relative gap at which the interior point method ends
LARGEST_GAP = 0.01  # a plan that is certified no closer than this says so
# the residual that CG leaves is removed by the next step
N_NEWTON_STEPS = 200
N_CG_STEPS = 2000
CG_TOLERANCE = 1e-3
# a Newton step aims at this much of the mean of q z: with 0.1 a log's rows take twice
# as long
BARRIER_FALL = 0.3
# times the variance of free sampling: episodes do not get where it matters
UNREACHED = 1e12
# a row that the start reaches more seldom costs nothing, and is left out
NEGLIGIBLE = 1e-60


def sum_variances(costs: Array, base: Array, q: Array) -> Array:
    """(K,) F_k(q) = sum_x C_kx / (b_x + q_x), 0 / 0 being 0; inf where a row that costs
    has nothing.
    """
    total = base + q
    empty = total <= 0.0
    finite: Array = np.sum(
        np.divide(costs, total, out=np.zeros_like(costs), where=~empty), axis=1
    )
    return np.where(np.any(costs[:, empty] > 0.0, axis=1), np.inf, finite)


def fill(cost: Array, base: Array) -> Array:
    """The q >= 0, sum q = 1, that minimises sum_x c_x / (b_x + q_x): b + q = max(b, t
    sqrt(c)), exactly.

    With b = 0 Neyman's allocation q ~ sqrt(c), value (sum sqrt c)^2. Cost: O(rows log
    rows).

    >>> fill(np.array([1.0, 4.0]), np.zeros(2)), fill(np.array([1.0, 4.0]), np.array([1.0, 0.0]))
    (array([0.33333333, 0.66666667]), array([0., 1.]))
    """
    root = np.sqrt(cost)
    rows = np.flatnonzero(root > 0.0)
    order = rows[np.argsort(base[rows] / root[rows], kind="stable")]
    # t, if the first so many rows get a share
    level = (1.0 + np.cumsum(base[order])) / np.cumsum(root[order])
    last = np.flatnonzero(level > base[order] / root[order])[-1]
    q = np.zeros_like(cost)
    q[order[: last + 1]] = np.maximum(level[last] * root[order] - base[order], 0.0)[
        : last + 1
    ]
    return np.asarray(q / q.sum())


def collection_mdp(
    model: FiniteMDP,
    restart: float,
    *,
    ends: BoolArray | None = None,
    restart_costs_a_move: bool = False,
) -> FiniteMDP:
    """Make the MDP in which data are collected: ``model``, started again after each
    transition with probability ``restart``.

    Its discount is 1 - restart, its occupancy the long-run share of recorded
    transitions, its rewards 0. An episode ends in the states ``ends`` (S,), by default
    those that no action leaves: entering one leads to a start (as ``sample_episodes``
    records), or, with ``restart_costs_a_move``, one more recorded transition does.
    """
    matrix: Any = model.transitions
    is_end = model.closed() if ends is None else ends
    start = sparse.csr_array(model.initial[None, :])
    if restart_costs_a_move:
        to_start = np.repeat(is_end, model.n_actions).astype(np.float64)
        matrix = sparse.diags_array(1.0 - to_start) @ matrix
    else:
        to_start = np.asarray(matrix @ is_end.astype(np.float64))
        matrix = matrix @ sparse.diags_array(1.0 - is_end)
    transitions = canonical(
        matrix + sparse.csr_array(to_start[:, None]) @ start, drop_zeros=True
    )
    return FiniteMDP(
        transitions, np.zeros(model.n_states), model.initial, 1.0 - restart
    )


def behavior_of(q: Array, shape: tuple[int, int]) -> Array:
    """(S, A): q / sum_a q, uniform in states that q never visits."""
    table = q.reshape(shape)
    total = table.sum(axis=1, keepdims=True)
    return np.where(
        total > 0.0, table / np.where(total > 0.0, total, 1.0), 1.0 / shape[1]
    )


@dataclass(frozen=True, eq=False)
class Program:
    """minimise max_k F_k(q), with ``costs`` C (K, S*A) and ``base`` b (S*A,), over the
    feasible q.

    ``collection`` None: all distributions over the rows; a collection MDP: the
    occupancies of its policies.
    """

    costs: Array
    base: Array
    collection: FiniteMDP | None

    def start(self, policies: list[Array]) -> Array:
        """A feasible q, positive where another can usefully be: best for all costs at
        once, or what the policies record.

        Raises ValueError where that is not what matters to a policy.
        """
        if self.collection is None:
            mean = self.costs.mean(axis=0)
            return np.asarray(
                0.9 * fill(mean, self.base) + 0.1 * (mean > 0.0) / np.sum(mean > 0.0)
            )
        visits = [
            occupancy(self.collection, policy)
            for policy in (uniform_policy(self.collection), *policies)
        ]
        q = np.mean(visits, axis=0).reshape(-1)
        worst = float(sum_variances(self.costs, self.base, q).max())
        if not worst < UNREACHED:
            raise ArgumentError(
                "restart",
                "must let episodes reach the (s, a) that matter; at"
                f" {1.0 - self.collection.discount:g} what their own policies and the"
                f" uniform one record leaves {worst:.2g} times the variance of free"
                " sampling",
            )
        return np.asarray(q)

    def equations(self) -> tuple[sparse.csr_array, Array]:
        """(M, m): q >= 0 is feasible where M q = m: sum q = 1, or the flow of the
        collection MDP.
        """
        if self.collection is None:
            return sparse.csr_array(np.ones((1, self.base.size))), np.ones(1)
        mdp = self.collection
        in_state = sparse.kron(
            sparse.eye_array(mdp.n_states), np.ones((1, mdp.n_actions))
        )
        flow = in_state - mdp.discount * mdp.transitions.T
        return sparse.csr_array(flow), (1.0 - mdp.discount) * mdp.initial

    def project(self, q: Array) -> Array:
        """The feasible point that a solver's q stands for: its shares, or the occupancy
        of its policy.
        """
        kept = np.maximum(q, 0.0)
        if self.collection is not None:
            shape = (self.collection.n_states, self.collection.n_actions)
            return np.asarray(
                occupancy(self.collection, behavior_of(kept, shape)).reshape(-1)
            )
        kept = np.where(self.costs.max(axis=0) > 0.0, kept, 0.0)
        return np.asarray(kept / kept.sum())

    def lower_bound(self, weights: Array, prices: Array, level: float) -> float:
        """Bound min_q max_k F_k by Lagrange: sum_x min_q [w . C_x / (b_x + q) + kappa_x
        q] - level, ``prices`` kappa = M' v.

        ``level`` is m . v. A constant is added to all prices, and to the level, that
        makes every price nonnegative.
        """
        shift = max(0.0, -float(prices.min()))
        cost = weights @ self.costs
        kappa = prices + shift
        # where nothing is gained q is 0, the price inf or not
        with np.errstate(divide="ignore", invalid="ignore"):
            q = np.where(
                cost > kappa * self.base**2, np.sqrt(cost / kappa) - self.base, 0.0
            )
            terms = np.where(cost > 0.0, cost / (self.base + q), 0.0) + np.where(
                kappa * q > 0.0, kappa * q, 0.0
            )
        return float(terms.sum()) - level - shift


def solve_for_all(
    costs: Array,
    base: Array,
    collection: FiniteMDP | None,
    policies: list[Array],
    solver: Solver,
) -> tuple[Solution, Array, Array]:
    """The solution, and of each policy the least variance of a plan for it alone:
    sampling as here, and at will.
    """
    free = np.array(
        [float(sum_variances(c[None], base, fill(c, base))[0]) for c in costs]
    )
    scaled = costs / free[:, None]
    if collection is None:
        return solve(Program(scaled, base, None), policies, solver), free, free
    alone = [
        solve(Program(scaled[[k]], base, collection), [pi], solver)
        for k, pi in enumerate(policies)
    ]
    least = free * np.array([value for _, value, _ in alone])
    if len(policies) == 1:
        return alone[0], least, free
    return (
        solve(Program(costs / least[:, None], base, collection), policies, solver),
        least,
        free,
    )


def solve(program: Program, policies: list[Array], solver: Solver) -> Solution:
    """Solve by cvxpy where it is asked for, else in closed form, or by the interior
    point method.
    """
    start = program.start(policies)
    if solver == "CLARABEL":
        return solve_by_clarabel(program)
    if program.collection is None and len(program.costs) == 1:
        q = fill(program.costs[0], program.base)
        value = float(sum_variances(program.costs, program.base, q)[0])
        return q, value, value
    return solve_by_interior_point(program, start)


def solve_by_interior_point(program: Program, start: Array) -> Solution:
    """Take primal-dual Newton steps until the relative gap is at most 0.01%; after 200
    steps end with the gap there is.

    For weights w of the policies and c = w . C the conditions of the least sum_x c_x /
    (b_x + q_x) are, with z the multipliers of q >= 0 and mu falling to 0,

        M' v - c / (b + q)^2 - z = 0,   M q = m,   q z = mu.

    Elimination leaves M diag(1 / theta) M' dv = ..., theta = 2 c / (b + q)^3 + z / q,
    which is solved by conjugate gradients; each step begins with one for the weights.
    Cost: 10 to 40 steps of 20 to 300 products with M, and an occupancy each.
    """
    used = start > NEGLIGIBLE
    costs = program.costs[:, used]
    base = program.base[used]
    q = start[used]
    matrix, right = program.equations()
    matrix = matrix[:, np.flatnonzero(used)]
    transposed = sparse.csr_array(matrix.T)
    squared = matrix.power(2)
    best = program.project(start)
    value = float(sum_variances(program.costs, program.base, best).max())
    bound = -np.inf
    weights = np.full(len(costs), 1.0 / len(costs))
    v = np.zeros(len(right))
    z = value * BARRIER_FALL / (len(q) * q)
    smallest_barrier = 0.1 * TOLERANCE * value / len(q)
    point = np.zeros(len(start))
    prices = np.full(len(start), np.inf)
    theta = 2.0 * costs.mean(axis=0) / (base + q) ** 3 + z / q
    step = 1.0
    for _ in range(N_NEWTON_STEPS):
        weights += step * (update_weights(weights, costs, base + q, theta) - weights)
        prices[used] = transposed @ v
        point[used] = q
        bound = max(bound, program.lower_bound(weights, prices, float(right @ v)))
        candidate = program.project(point)
        at_candidate = float(
            sum_variances(program.costs, program.base, candidate).max()
        )
        if at_candidate < value:
            best = candidate
            value = at_candidate
        if value - bound <= TOLERANCE * value:
            break
        cost = weights @ costs
        total = base + q
        barrier = max(BARRIER_FALL * float(np.mean(q * z)), smallest_barrier)
        theta = 2.0 * cost / total**3 + z / q
        residual = prices[used] - cost / total**2 - barrier / q
        # 1 on the diagonal of the system
        scale = 1.0 / np.sqrt(np.maximum(squared @ (1.0 / theta), 1e-300))
        half = aslinearoperator(
            sparse.diags_array(scale)
            @ matrix
            @ sparse.diags_array(1.0 / np.sqrt(theta))
        )
        change = scale * (matrix @ (q - residual / theta) - right)
        dv = scale * cg(half @ half.T, change, rtol=CG_TOLERANCE, maxiter=N_CG_STEPS)[0]
        dq = -(residual + transposed @ dv) / theta
        dz = (barrier - z * dq) / q - z
        step = min(
            1.0, 0.95 / max(1e-300, float(np.max(-dq / q)), float(np.max(-dz / z)))
        )
        q = q + step * dq
        z = z + step * dz
        v = v + step * dv
    return best, value, bound


def update_weights(weights: Array, costs: Array, total: Array, theta: Array) -> Array:
    """Take a Newton step for the conditions of the worst policies: F_k = t, or w_k = 0
    and F_k < t.

    With dF = -S dw, S = G diag(1 / theta) G', G_kx = C_kx / (b_x + q_x)^2: what a
    change of the weights moves where q needs no flow, so never too far. A policy below
    t has slack, which takes its weight to 0.
    """
    values = np.sum(costs / total, axis=1)
    slopes = costs / total**2
    slack = values.max() - values
    curvature = (slopes / theta) @ slopes.T
    curvature += np.diag(1e-9 * np.trace(curvature) + slack / weights)
    ahead, level = np.linalg.solve(
        curvature, np.stack([values, np.ones(len(values))], axis=1)
    ).T
    new_weights = weights + ahead - ahead.sum() / level.sum() * level
    new_weights = np.clip(new_weights, weights / 3.0, 3.0 * weights)
    return np.asarray(new_weights / new_weights.sum())


def solve_by_clarabel(program: Program) -> Solution:
    """Solve the statement in cvxpy by Clarabel; its point is made feasible, and gets a
    bound by its multipliers.

    Raises SolverStatusError (a RuntimeError) for any status but "optimal". Cost: a
    conic program with a cone a row.
    """
    import cvxpy as cp

    costs = program.costs
    base = program.base
    used = np.flatnonzero(costs.max(axis=0) > 0.0)
    free_best = np.sqrt(costs.mean(axis=0))
    unit = np.where(
        costs.max(axis=0) > 0.0, np.maximum(free_best / free_best.sum(), 1e-9), 1.0
    )
    y = cp.Variable(base.size, nonneg=True)
    top = cp.Variable()
    # b + q in units of the free allocation
    q = cp.multiply(unit, y)
    total = base[used] / unit[used] + y[used]
    inefficiency = (costs[:, used] / unit[used]) @ cp.inv_pos(total) <= top
    matrix, right = program.equations()
    feasible = matrix @ q == right
    problem = cp.Problem(cp.Minimize(top), [inefficiency, feasible])
    status = run(problem, "CLARABEL", (1e-10, 1e-8, 1e-6))  # the gap is ours to certify
    if status != "optimal":
        raise SolverStatusError(
            f"CLARABEL ended with status {status!r}, not 'optimal'; its numbers are not"
            " used (use solver='auto')"
        )
    weights = np.maximum(np.ravel(inefficiency.dual_value), 0.0)
    v = np.ravel(feasible.dual_value)
    point = program.project(unit * y.value)
    bound = program.lower_bound(weights / weights.sum(), matrix.T @ v, float(right @ v))
    return point, float(sum_variances(costs, base, point).max()), bound

"""The programs of experimental design, and their solvers.

minimise over q  max_k F_k(q),   F_k(q) = sum_x C_kx / (b_x + q_x).

Two ways to solve them, stated at the door of the room (``oee_tabular.design``): an
interior point method (``solve_by_interior_point``), and the statement in cvxpy
(``solve_by_clarabel``). Both end with a value and a lower bound that do not depend on
how q was found.
"""

from __future__ import annotations

from collections.abc import Sequence
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
from oee_tabular.typing import Array, BoolArray, Csr

Solver = Literal["auto", "CLARABEL"]
# q (S*A,), its largest F_k, and a lower bound of that of every q
Solution = tuple[Array, float, float]
GAP_TOLERANCE = 1e-4  # the relative gap at which the interior point method ends
MAX_GAP = 0.01  # the relative gap from which on a plan says that it is not finished
MAX_NEWTON_STEPS = 200
MAX_CG_STEPS = 2000
# of the right-hand side: what conjugate gradients leave, the next Newton step removes
CG_TOLERANCE = 1e-3
# the share of the mean of q z at which a Newton step aims; with 0.1 a log's rows take
# twice as long
BARRIER_SHARE = 0.3
STEP_SHARE = 0.95  # of the way to the boundary of q >= 0 or z >= 0
# times the variance of free sampling, from which on episodes do not reach the pairs
# that matter
MAX_RELATIVE_VARIANCE = 1e12
# of all transitions: a row that the start reaches more seldom costs nothing, and is
# left out
MIN_START_SHARE = 1e-60


def sum_variances(costs: Array, base: Array, q: Array) -> Array:
    """Compute F_k(q) = sum_x C_kx / (b_x + q_x) of each policy, (K,).

    0 / 0 counts as 0; a row that costs and has nothing makes inf.
    """
    total = base + q
    empty = total <= 0.0
    terms = np.divide(costs, total, out=np.zeros_like(costs), where=~empty)
    finite: Array = np.sum(terms, axis=1)
    return np.where(np.any(costs[:, empty] > 0.0, axis=1), np.inf, finite)


def fill(cost: Array, base: Array) -> Array:
    """Find the distribution q that minimises sum_x c_x / (b_x + q_x), exactly.

    b + q = max(b, t sqrt(c)); with b = 0 it is Neyman's allocation q ~ sqrt(c), value
    (sum sqrt c)^2. Cost: O(rows log rows).

    >>> (
    ...     fill(np.array([1.0, 4.0]), np.zeros(2)),
    ...     fill(np.array([1.0, 4.0]), np.array([1.0, 0.0])),
    ... )
    (array([0.33333333, 0.66666667]), array([0., 1.]))
    """
    root = np.sqrt(cost)
    rows = np.flatnonzero(root > 0.0)
    order = rows[np.argsort(base[rows] / root[rows], kind="stable")]
    # t, if the first so many rows get a share
    level = (1.0 + np.cumsum(base[order])) / np.cumsum(root[order])
    last = np.flatnonzero(level > base[order] / root[order])[-1]
    q = np.zeros_like(cost)
    filled = order[: last + 1]
    q[filled] = np.maximum(level[last] * root[filled] - base[filled], 0.0)
    return np.asarray(q / q.sum())


def collection_mdp(
    model: FiniteMDP,
    restart: float,
    *,
    ends: BoolArray | None = None,
    restart_costs_a_move: bool = False,
) -> FiniteMDP:
    """Make the MDP in which data are collected: ``model`` with restarts.

    It starts again after each transition with probability ``restart``. Its discount is
    1 - restart, its occupancy the long-run share of recorded transitions, its rewards
    0. An episode ends in the states ``ends`` (S,), by default those that no action
    leaves: entering one leads to a start (as ``sample_episodes`` records), or, with
    ``restart_costs_a_move``, one more recorded transition does.
    """
    matrix: Any = model.transitions
    is_end = model.closed() if ends is None else ends
    start = sparse.csr_array(model.initial[None, :])
    if restart_costs_a_move:
        to_start = (is_end[:, None] & model.available).reshape(-1).astype(np.float64)
        matrix = sparse.diags_array(1.0 - to_start) @ matrix
    else:
        to_start = np.asarray(matrix @ is_end.astype(np.float64))
        matrix = matrix @ sparse.diags_array(1.0 - is_end)
    transitions = canonical(
        matrix + sparse.csr_array(to_start[:, None]) @ start, drop_zeros=True
    )
    return FiniteMDP(
        transitions,
        np.zeros(model.n_states),
        model.initial,
        1.0 - restart,
        available=None if model.has_all_actions else model.available,
    )


def behavior_of(q: Array, mdp: FiniteMDP) -> Array:
    """Return q as a policy (S, A), uniform in states that q never visits."""
    table = q.reshape(mdp.rewards.shape)
    total = table.sum(axis=1, keepdims=True)
    shares = table / np.where(total > 0.0, total, 1.0)
    return np.where(total > 0.0, shares, uniform_policy(mdp))


@dataclass(frozen=True, eq=False)
class Program:
    """The program: minimise max_k F_k(q) over the feasible q.

    ``costs`` C have shape (K, S*A), ``base`` b (S*A,). Without a ``collection`` all
    distributions over the rows are feasible; with a collection MDP, the occupancies of
    its policies.
    """

    costs: Array
    base: Array
    collection: FiniteMDP | None

    def start(self, policies: Sequence[Array]) -> Array:
        """Return a feasible q that is positive where another can usefully be.

        It is the best for all costs at once, or what the policies record. Raises
        ValueError where that is not what matters to a policy.
        """
        if self.collection is None:
            mean = self.costs.mean(axis=0)
            # a tenth is spread, so that every row that costs begins inside
            uniform = 0.1 * (mean > 0.0) / np.sum(mean > 0.0)
            return np.asarray(0.9 * fill(mean, self.base) + uniform)
        visits = [
            occupancy(self.collection, policy)
            for policy in (uniform_policy(self.collection), *policies)
        ]
        q = np.mean(visits, axis=0).reshape(-1)
        worst = float(sum_variances(self.costs, self.base, q).max())
        if not worst < MAX_RELATIVE_VARIANCE:
            raise ArgumentError(
                "restart",
                "must let episodes reach the (s, a) that matter; at"
                f" {1.0 - self.collection.discount:g} what their own policies and the"
                f" uniform one record leaves {worst:.2g} times the variance of free"
                " sampling",
            )
        return np.asarray(q)

    def equations(self) -> tuple[Csr, Array]:
        """Return (M, m) such that q >= 0 is feasible where M q = m.

        They say that q sums to 1, or that it is a flow of the collection MDP.
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
        """Return the feasible point that a solver's q stands for.

        It has the same shares, or is the occupancy of the same policy.
        """
        kept = np.maximum(q, 0.0)
        if self.collection is not None:
            behavior = behavior_of(kept, self.collection)
            return np.asarray(occupancy(self.collection, behavior).reshape(-1))
        kept = np.where(self.costs.max(axis=0) > 0.0, kept, 0.0)
        return np.asarray(kept / kept.sum())

    def lower_bound(self, weights: Array, prices: Array, level: float) -> float:
        """Bound min_q max_k F_k from below by Lagrange.

        The bound is sum_x min_q [w . C_x / (b_x + q) + kappa_x q] - level, ``prices``
        kappa = M' v and ``level`` m . v. A constant is added to all prices, and to the
        level, that makes every price nonnegative.
        """
        shift = max(0.0, -float(prices.min()))
        cost = weights @ self.costs
        kappa = prices + shift
        # where nothing is gained q is 0, the price inf or not
        with np.errstate(divide="ignore", invalid="ignore"):
            is_gain = cost > kappa * self.base**2
            q = np.where(is_gain, np.sqrt(cost / kappa) - self.base, 0.0)
            variances = np.where(cost > 0.0, cost / (self.base + q), 0.0)
            terms = variances + np.where(kappa * q > 0.0, kappa * q, 0.0)
        return float(terms.sum()) - level - shift


def solve_for_all(
    costs: Array,
    base: Array,
    collection: FiniteMDP | None,
    policies: list[Array],
    solver: Solver,
    also: Sequence[Array] = (),
) -> tuple[Solution, Array, Array]:
    """Solve the program of all policies, and that of each policy alone.

    Rows that only the policies ``also`` visit may have costs as well. Returns the
    solution, and of each policy the least variance of a plan for it alone: with the
    sampling of the program, and with free sampling.
    """
    best = [sum_variances(c[None], base, fill(c, base))[0] for c in costs]
    free = np.array([float(value) for value in best])
    scaled = costs / free[:, None]
    if collection is None:
        program = Program(scaled, base, None)
        return solve(program, [*policies, *also], solver), free, free
    alone = [
        solve(Program(scaled[[k]], base, collection), [pi, *also], solver)
        for k, pi in enumerate(policies)
    ]
    least = free * np.array([value for _, value, _ in alone])
    if len(policies) == 1:
        return alone[0], least, free
    together = Program(costs / least[:, None], base, collection)
    return solve(together, [*policies, *also], solver), least, free


def solve(program: Program, policies: list[Array], solver: Solver) -> Solution:
    """Solve a program in closed form, by the interior point method, or by cvxpy.

    cvxpy is used where it is asked for.
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
    """Take primal-dual Newton steps until the relative gap is at most 0.01%.

    After 200 steps it ends with the gap there is.

    For weights w of the policies and c = w . C the conditions of the least sum_x c_x /
    (b_x + q_x) are, with z the multipliers of q >= 0 and mu falling to 0,

        M' v - c / (b + q)^2 - z = 0,   M q = m,   q z = mu.

    Elimination leaves M diag(1 / theta) M' dv = ..., theta = 2 c / (b + q)^3 + z / q,
    which is solved by conjugate gradients; each step begins with one for the weights.
    Cost: 10 to 40 steps of 20 to 300 products with M, and an occupancy each.
    """
    used = start > MIN_START_SHARE
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
    z = value * BARRIER_SHARE / (len(q) * q)
    smallest_barrier = 0.1 * GAP_TOLERANCE * value / len(q)
    point = np.zeros(len(start))
    prices = np.full(len(start), np.inf)
    theta = 2.0 * costs.mean(axis=0) / (base + q) ** 3 + z / q
    step = 1.0
    for _ in range(MAX_NEWTON_STEPS):
        weights += step * (update_weights(weights, costs, base + q, theta) - weights)
        prices[used] = transposed @ v
        point[used] = q
        bound = max(bound, program.lower_bound(weights, prices, float(right @ v)))
        candidate = program.project(point)
        variances = sum_variances(program.costs, program.base, candidate)
        at_candidate = float(variances.max())
        if at_candidate < value:
            best = candidate
            value = at_candidate
        if value - bound <= GAP_TOLERANCE * value:
            break
        cost = weights @ costs
        total = base + q
        barrier = max(BARRIER_SHARE * float(np.mean(q * z)), smallest_barrier)
        theta = 2.0 * cost / total**3 + z / q
        residual = prices[used] - cost / total**2 - barrier / q
        # 1 on the diagonal of the system
        diagonal = np.asarray(squared @ (1.0 / theta))
        scale = 1.0 / np.sqrt(np.maximum(diagonal, 1e-300))
        half = aslinearoperator(
            sparse.diags_array(scale)
            @ matrix
            @ sparse.diags_array(1.0 / np.sqrt(theta))
        )
        change = scale * (matrix @ (q - residual / theta) - right)
        solution, _ = cg(half @ half.T, change, rtol=CG_TOLERANCE, maxiter=MAX_CG_STEPS)
        dv = scale * solution
        dq = -(residual + transposed @ dv) / theta
        dz = (barrier - z * dq) / q - z
        nearest = max(1e-300, float(np.max(-dq / q)), float(np.max(-dz / z)))
        step = min(1.0, STEP_SHARE / nearest)
        q = q + step * dq
        z = z + step * dz
        v = v + step * dv
    return best, value, bound


def update_weights(weights: Array, costs: Array, total: Array, theta: Array) -> Array:
    """Take a Newton step for the weights of the policies.

    The conditions are F_k = t for the worst policies, and w_k = 0 and F_k < t for
    others.

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
    # a weight changes by a factor of three at most, and stays positive
    new_weights = weights + ahead - ahead.sum() / level.sum() * level
    new_weights = np.clip(new_weights, weights / 3.0, 3.0 * weights)
    return np.asarray(new_weights / new_weights.sum())


def solve_by_clarabel(program: Program) -> Solution:
    """Solve the statement in cvxpy by Clarabel, and certify its point.

    The point is made feasible, and gets a bound by its multipliers. Raises
    SolverStatusError (a RuntimeError) for any status but "optimal". Cost: a conic
    program with a cone for each row.
    """
    import cvxpy as cp

    costs = program.costs
    base = program.base
    used = np.flatnonzero(costs.max(axis=0) > 0.0)
    free_best = np.sqrt(costs.mean(axis=0))
    shares = np.maximum(free_best / free_best.sum(), 1e-9)
    unit = np.where(costs.max(axis=0) > 0.0, shares, 1.0)
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

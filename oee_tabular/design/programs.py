"""The programs of experimental design: minimise over q  max_k F_k(q),  F_k(q) = sum_x C_kx / (b_x + q_x).

Two ways to solve them, stated at the door of the room (``oee_tabular.design``): columns proposed by planning and mixed by a
multiplicative algorithm (``solve_by_columns``), and the statement in cvxpy (``solve_by_clarabel``). Both end with a value and
a lower bound that do not depend on how q was found.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy import sparse

from oee_tabular._checks import Array, BoolArray
from oee_tabular._sparse import canonical, row_sums
from oee_tabular.exact import occupancy, optimal_policy, state_values
from oee_tabular.mdp import FiniteMDP, uniform_policy
from oee_tabular.ratio.statements import SolverStatusError, run

Solver = Literal["auto", "frank_wolfe", "CLARABEL"]
TOLERANCE = 1e-3  # of the relative gap at which columns are enough
LARGEST_GAP = 0.01  # a plan that is certified no closer than this says so
N_CONIC_ROWS = 4000  # of a grid 1 s, of 1000 states with random successors 2 to 6 s, and soon minutes above
N_ROUNDS, N_COLUMNS, N_MIXING_STEPS = 200, 48, 300  # 48 columns are kept
UNREACHED = 1e12  # times the variance of free sampling: episodes do not get where it matters


@dataclass(frozen=True, eq=False)
class Design:
    """``q`` (S*A,), its largest F_k ``value``, and a lower ``bound`` of every q's."""

    q: Array
    value: float
    bound: float
    solver: str

    @property
    def gap(self) -> float:
        """(value - bound) / value: by how much, relatively, another q could be better at most."""
        return max(0.0, 1.0 - self.bound / self.value)


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
    last = np.flatnonzero(level > base[order] / root[order])[-1]
    q = np.zeros_like(cost)
    q[order[: last + 1]] = np.maximum(level[last] * root[order] - base[order], 0.0)[: last + 1]
    return np.asarray(q / q.sum())


def collection_mdp(
    model: FiniteMDP, restart: float, *, ends: BoolArray | None = None, restart_costs_a_move: bool = False
) -> FiniteMDP:
    """Make the MDP in which data are collected: ``model``, started again after each move with probability ``restart``.

    Its discount is 1 - restart, its occupancy the long-run share of recorded moves, its rewards 0. An episode ends in the
    states ``ends`` (S,), by default those that no action leaves: entering one leads to a start (as ``sample_episodes``
    records), or, with ``restart_costs_a_move``, one more recorded move does.
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
    transitions = canonical(matrix + sparse.csr_array(to_start[:, None]) @ start, drop_zeros=True)
    transitions = sparse.diags_array(1.0 / row_sums(transitions)) @ transitions
    return FiniteMDP(transitions, np.zeros(model.n_states), model.initial, 1.0 - restart)


def behavior_of(q: Array, shape: tuple[int, int]) -> Array:
    """(S, A): q / sum_a q, uniform in states that q never visits."""
    table = q.reshape(shape)
    total = table.sum(axis=1, keepdims=True)
    return np.where(total > 0.0, table / np.where(total > 0.0, total, 1.0), 1.0 / shape[1])


@dataclass(frozen=True, eq=False)
class FreeProgram:
    """minimise over all distributions q  max_k F_k(q), with ``costs`` C (K, S*A) and ``base`` b (S*A,)."""

    costs: Array
    base: Array

    @property
    def is_closed_form(self) -> bool:
        """Whether ``fill`` is the solution."""
        return len(self.costs) == 1

    def start(self, policies: list[Array]) -> list[Array]:
        """The best q of each policy alone, and of their mean."""
        return [fill(cost, self.base) for cost in (*self.costs, self.costs.mean(axis=0))]

    def propose(self, weights: Array, q: Array) -> tuple[float, list[Array]]:
        """Bound min_q sum_k w_k F_k from below (here exactly), and propose a column."""
        column = fill(weights @ self.costs, self.base)
        return float(weights @ evaluate(self.costs, self.base, column)), [column]

    def project(self, q: Array) -> Array:
        """The point of the feasible set that a solver's q stands for."""
        kept = np.where(self.costs.max(axis=0) > 0.0, np.maximum(q, 0.0), 0.0)
        return np.asarray(kept / kept.sum())

    def equations(self) -> tuple[Any, Any]:
        """(M, m): q >= 0 is feasible where M q = m."""
        return np.ones((1, self.base.size)), np.ones(1)


@dataclass(frozen=True, eq=False)
class FlowProgram:
    """The same over the occupancies q of the behaviour policies of a collection MDP."""

    costs: Array
    base: Array
    mdp: FiniteMDP
    is_closed_form = False

    @property
    def shape(self) -> tuple[int, int]:
        """(S, A)."""
        return self.mdp.n_states, self.mdp.n_actions

    def visits(self, policy: Array) -> Array:
        """(S*A,) the occupancy of a behaviour policy."""
        return occupancy(self.mdp, policy).reshape(-1)

    def start(self, policies: list[Array]) -> list[Array]:
        """The uniform policy, the policies, and what one would record at will, made a policy.

        Raises ValueError where episodes are too short to reach what matters to a policy.
        """
        uniform = uniform_policy(self.mdp)
        ideal = behavior_of(fill(self.costs.mean(axis=0), self.base), self.shape)
        columns = [self.visits(policy) for policy in (uniform, *policies, 0.9 * ideal + 0.1 * uniform)]
        worst = float(evaluate(self.costs, self.base, np.mean(columns, axis=0)).max())
        if not worst < UNREACHED:
            raise ValueError(
                f"restart must let episodes reach the (s, a) that matter; at {1.0 - self.mdp.discount:g} what their own "
                f"policies and the uniform one record leaves {worst:.2g} times the variance of free sampling"
            )
        return columns

    def propose(self, weights: Array, q: Array) -> tuple[float, list[Array]]:
        """Bound min_q sum_k w_k F_k from below, and propose columns: the best policy, and what prices ask for.

        Cost: a policy iteration and three policy evaluations.
        """
        cost, total = weights @ self.costs, self.base + q
        slope = np.divide(cost, total**2, out=np.zeros_like(cost), where=cost > 0.0)
        rewarded, behavior = self.mdp.with_rewards(slope.reshape(self.shape)), behavior_of(q, self.shape)
        best = optimal_policy(rewarded)
        values, best_values = (state_values(rewarded, policy) for policy in (behavior, best))
        demand = self._demand(cost, np.maximum(self._prices(values), slope / 16.0))
        table = np.where(cost > 0.0, demand, q).reshape(self.shape)
        table = np.where(table.sum(axis=1, keepdims=True) > 0.0, table, behavior)
        bound = max(self._dual_value(cost, v) for v in (values, best_values))
        return bound, [self.visits(best), self.visits(behavior_of(table, self.shape))]

    def _prices(self, v: Array) -> Array:
        """kappa_x = v(s) - (1 - rho) sum_s' P(s' | x) v(s')."""
        ahead = self.mdp.discount * (self.mdp.transitions @ v)
        return np.asarray(np.repeat(v, self.mdp.n_actions) - ahead)

    def _demand(self, cost: Array, prices: Array) -> Array:
        """argmin_{q >= 0} C / (b + q) + kappa q."""
        return np.maximum(np.sqrt(cost / np.maximum(prices, 1e-300)) - self.base, 0.0)

    def _dual_value(self, cost: Array, v: Array) -> float:
        """Lagrange's bound at the multipliers v, with a constant added to v that makes every price nonnegative."""
        prices = self._prices(v)
        shift = max(0.0, -float(prices.min()))
        used = cost > 0.0
        c, kappa, b = cost[used], prices[used] + shift, self.base[used]
        q = self._demand(cost, prices + shift)[used]
        level = (1.0 - self.mdp.discount) * float(self.mdp.initial @ v) + shift
        return float(np.sum(c / (b + q) + kappa * q)) - level

    def project(self, q: Array) -> Array:
        """The occupancy of the policy that a solver's q stands for."""
        return self.visits(behavior_of(np.maximum(q, 0.0), self.shape))

    def equations(self) -> tuple[Any, Any]:
        """(M, m): sum_a q(s', a) - (1 - rho) sum_x P(s' | x) q(x) = rho mu_0(s')."""
        in_state = sparse.kron(sparse.eye_array(self.mdp.n_states), np.ones((1, self.mdp.n_actions)))
        flow = in_state - self.mdp.discount * self.mdp.transitions.T
        return sparse.csr_array(flow), (1.0 - self.mdp.discount) * self.mdp.initial


Program = FreeProgram | FlowProgram


def solve_for_all(
    costs: Array, base: Array, collection: FiniteMDP | None, policies: list[Array], solver: Solver
) -> tuple[Design, Array, Array]:
    """The design, and of each policy the least variance of a plan for it alone: sampling as here, and at will."""
    free = np.array([float(evaluate(c[None], base, fill(c, base))[0]) for c in costs])
    scaled = costs / free[:, None]
    if collection is None:
        return solve(FreeProgram(scaled, base), policies, solver), free, free
    alone = [solve(FlowProgram(scaled[[k]], base, collection), [pi], solver) for k, pi in enumerate(policies)]
    least = free * np.array([design.value for design in alone])
    if len(policies) == 1:
        return alone[0], least, free
    starts = [*policies, *(behavior_of(design.q, policies[0].shape) for design in alone)]
    return solve(FlowProgram(costs / least[:, None], base, collection), starts, solver), least, free


def solve(program: Program, policies: list[Array], solver: Solver) -> Design:
    """Solve by the solver asked for; "auto": by Clarabel up to 4000 rows, by columns above, and where it was not close."""
    columns, designs = program.start(policies), []
    if solver == "CLARABEL":
        return solve_by_clarabel(program)
    if solver == "auto" and len(program.base) <= N_CONIC_ROWS and not program.is_closed_form:
        with contextlib.suppress(SolverStatusError):
            designs.append(solve_by_clarabel(program))
    if not designs or designs[0].gap > 2.0 * TOLERANCE:
        designs.append(solve_by_columns(program, columns))
    return min(designs, key=lambda design: design.gap)


def solve_by_columns(program: Program, columns: list[Array]) -> Design:
    """Mix columns, ask the program for a bound and new ones, until the relative gap is at most 0.1%.

    The result is no worse than any of the first columns. Ends after 200 rounds with the gap that it then has. Cost of a
    round: 300 passes over at most 48 columns, and what ``propose`` costs.
    """
    costs, base = program.costs, program.base
    q = min(columns, key=lambda column: evaluate(costs, base, column).max())
    value, bound = float(evaluate(costs, base, q).max()), -np.inf
    table, share = np.array(columns), np.ones(len(columns))
    weights = np.full(len(costs), 1.0 / len(costs))
    for _ in range(N_ROUNDS):
        share, weights = mix_columns(costs, base, table, share, weights)
        point = share @ table
        at_point = float(evaluate(costs, base, point).max())
        if at_point < value:
            q, value = point, at_point
        lower, new = program.propose(weights, point)
        bound = max(bound, lower)
        if value - bound <= TOLERANCE * value:
            break
        kept = np.argsort(-share, kind="stable")[: N_COLUMNS - 1 - len(new)]
        kept = kept[share[kept] > 1e-9]
        table = np.concatenate([[point, *new], table[kept]])
        share = np.concatenate([[0.5], np.full(len(new), 0.1 / len(new)), 0.4 * share[kept] / share[kept].sum()])
    return Design(q, value, bound, "closed form" if program.is_closed_form else "frank_wolfe")


def mix_columns(costs: Array, base: Array, table: Array, share: Array, weights: Array) -> tuple[Array, Array]:
    """Improve shares y of the columns (rows of ``table``) and weights w of the policies, from positive ones.

    y_j <- y_j sqrt(d_j) / sum,  d_j = -dF_w / dy_j;    w_k <- w_k F_k / sum.

    Ends where max_k F_k is within 0.025% of its bound on the columns' hull, w . F - (max_j d_j - y . d), or after
    300 steps: its accuracy bears on the speed of ``solve_by_columns``, not on its certificate.
    """
    used = np.flatnonzero(costs.max(axis=0) > 0.0)
    shared = table[:, used].min(axis=0)  # what every mixture has: as part of b it leaves d_j that differ more
    c, b, v = costs[:, used], base[used] + shared, table[:, used] - shared
    share = 0.9 * share / share.sum() + 0.1 / len(table)
    for _ in range(N_MIXING_STEPS):
        total = b + share @ v
        values = np.sum(c / total, axis=1)
        weights = weights * values / (weights @ values)
        slope = v @ ((weights @ c) / total**2)
        bound = weights @ values - (slope.max() - share @ slope)
        if values.max() - bound <= 0.25 * TOLERANCE * values.max():
            break
        share = share * np.sqrt(slope + 1e-300)  # also where all columns are one
        share /= share.sum()
    return share, weights


def solve_by_clarabel(program: Program) -> Design:
    """Solve the statement in cvxpy by Clarabel; its point is made feasible, and gets a bound by its multipliers.

    Raises SolverStatusError (a RuntimeError) for any status but "optimal". Cost: a conic program with a cone a row.
    """
    import cvxpy as cp

    costs, base = program.costs, program.base
    used = np.flatnonzero(costs.max(axis=0) > 0.0)
    free_best = np.sqrt(costs.mean(axis=0))
    unit = np.where(costs.max(axis=0) > 0.0, np.maximum(free_best / free_best.sum(), 1e-9), 1.0)
    y, top = cp.Variable(base.size, nonneg=True), cp.Variable()
    q, total = cp.multiply(unit, y), base[used] / unit[used] + y[used]  # b + q in units of the free allocation
    inefficiency = (costs[:, used] / unit[used]) @ cp.inv_pos(total) <= top
    matrix, right = program.equations()
    problem = cp.Problem(cp.Minimize(top), [inefficiency, matrix @ q == right])
    status = run(problem, "CLARABEL", (1e-10, 1e-8, 1e-6))  # the gap is ours to certify
    if status != "optimal":
        raise SolverStatusError(
            f"CLARABEL ended with status {status!r}, not 'optimal'; its numbers are not used (use solver='frank_wolfe')"
        )
    weights = np.maximum(np.ravel(inefficiency.dual_value), 0.0)
    point = program.project(unit * y.value)
    bound, _ = program.propose(weights / weights.sum(), point)
    return Design(point, float(evaluate(costs, base, point).max()), bound, "CLARABEL")

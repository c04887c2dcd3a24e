"""Designs that a behaviour policy can carry out: q in the occupancy polytope of the collection MDP.

    q >= 0,   sum_a q(s', a) = (1 - b) mu_0(s') + b sum_x q(x) P(s' | x)   for every s'

b the probability of going on after a move. On it sum_x C_x / (b_x + q_x) is convex. At a point q with the gradient's size
g_x = C_x / (b_x + q_x)^2 and the behaviour policy beta = q / sum_a q, ``flow_design`` evaluates two policies of the
collection MDP that pays g: the best one (the linear oracle of Frank and Wolfe [1, 2], policy iteration; its occupancy is a
column) and beta itself. For any v, with kappa = v(s) - b E_P v(s') made nonnegative by a constant added to v,

    sum_x min_{q >= 0} [C_x / (b_x + q) + kappa_x q]  -  (1 - b) mu_0 . v   <=   min over the polytope

(Lagrange). With v the best policy's value this is at least the Frank-Wolfe bound F(q) - max_{q'} <q' - q, g>; with beta's,
where kappa is g less the advantage, its error is of second order. The minimising q of each row, made a policy, is a second
column, which does what vertices cannot: at the optimum every row that costs is used, and it takes up to S (A - 1) vertices
to mix such a point.

References: [1] M. Frank and P. Wolfe, An algorithm for quadratic programming, Naval Research Logistics Quarterly 3, 1956.
[2] T. Zahavy et al., Reward is enough for convex MDPs, NeurIPS 2021 (the linear oracle is planning).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from oee_tabular._checks import Array, BoolArray
from oee_tabular._sparse import canonical, row_sums
from oee_tabular.design.programs import TOLERANCE, Design, evaluate, fill, minimise
from oee_tabular.exact import occupancy, optimal_policy, state_values
from oee_tabular.mdp import FiniteMDP, uniform_policy

_BLENDS = (0.0, 0.03, 0.3, 1.0)  # of the best policy's value into beta's, in the bound
_HOPELESS = 1e12


def collection_mdp(
    model: FiniteMDP, restart: float, *, ends: BoolArray | None = None, restart_costs_a_move: bool = False
) -> FiniteMDP:
    """The MDP in which data are collected: ``model``, started again after each move with probability ``restart``.

    Its discount is b = 1 - restart, its occupancy the long-run share of recorded moves, its rewards 0. An episode ends in the
    states ``ends`` (S,), by default those that no action leaves: entering one leads to a start (as ``sample_episodes``
    records), or, with ``restart_costs_a_move``, one more recorded move does.
    """
    matrix: Any = model.transitions
    over = model.closed() if ends is None else ends
    start = sparse.csr_array(model.initial[None, :])
    if restart_costs_a_move:
        again = np.repeat(over, model.n_actions).astype(np.float64)
        matrix = sparse.diags_array(1.0 - again) @ matrix
    else:
        again = np.asarray(matrix @ over.astype(np.float64))
        matrix = matrix @ sparse.diags_array(1.0 - over)
    led = canonical(matrix + sparse.csr_array(again[:, None]) @ start, drop_zeros=True)
    scaled = sparse.diags_array(1.0 / row_sums(led)) @ led
    return FiniteMDP(scaled, np.zeros(model.n_states), model.initial, 1.0 - restart)


def policy_of(q: Array, shape: tuple[int, int]) -> Array:
    """(S, A): q / sum_a q, uniform in states that q never visits."""
    table = q.reshape(shape)
    total = table.sum(axis=1, keepdims=True)
    return np.where(total > 0.0, table / np.where(total > 0.0, total, 1.0), 1.0 / shape[1])


class Flow:
    """The polytope of a collection MDP: bounds and columns for ``minimise``."""

    def __init__(self, mdp: FiniteMDP, costs: Array, base: Array) -> None:
        self.mdp, self.costs, self.base = mdp, costs, base
        self.shape = (mdp.n_states, mdp.n_actions)

    def visits(self, policy: Array) -> Array:
        """(S*A,) the occupancy of a behaviour policy."""
        return occupancy(self.mdp, policy).reshape(-1)

    def propose(self, weights: Array, q: Array) -> tuple[float, list[Array]]:
        """See the module's docstring. Cost: a policy iteration and three policy evaluations."""
        cost, total = weights @ self.costs, self.base + q
        paid = np.divide(cost, total**2, out=np.zeros_like(cost), where=cost > 0.0)
        rewarded = self.mdp.with_rewards(paid.reshape(self.shape))
        best, now = optimal_policy(rewarded), policy_of(q, self.shape)
        values = [state_values(rewarded, policy) for policy in (now, best)]
        found = [self._dual(cost, (1.0 - blend) * values[0] + blend * values[1]) for blend in _BLENDS]
        steep = np.maximum(self._price(values[0]), paid / 16.0)
        wanted = np.where(cost > 0.0, self._demand(cost, steep), q)
        table = np.where(wanted.reshape(self.shape).sum(axis=1, keepdims=True) > 0, wanted.reshape(self.shape), now)
        return max(found), [self.visits(best), self.visits(policy_of(table, self.shape))]

    def _price(self, v: Array) -> Array:
        """kappa_x = v(s) - b sum_s' P(s' | x) v(s')."""
        ahead = self.mdp.discount * (self.mdp.transitions @ v)
        return np.asarray(np.repeat(v, self.shape[1]) - ahead)

    def _demand(self, cost: Array, price: Array) -> Array:
        """argmin_{q >= 0} C / (b + q) + kappa q."""
        return np.maximum(np.sqrt(cost / np.maximum(price, 1e-300)) - self.base, 0.0)

    def _dual(self, cost: Array, v: Array) -> float:
        price = self._price(v)
        shift = max(0.0, -float(price.min()))
        price = price + shift
        q = np.where(cost > 0.0, self._demand(cost, price), 0.0)
        total = np.where(cost > 0.0, self.base + q, 1.0)
        level = (1.0 - self.mdp.discount) * float(self.mdp.initial @ v) + shift
        return float(np.sum(cost / total + np.where(cost > 0.0, price * q, 0.0))) - level


def flow_design(
    mdp: FiniteMDP, costs: Array, base: Array, policies: list[Array], *, tolerance: float = TOLERANCE
) -> Design:
    """The best behaviour in ``mdp``; no worse than the uniform policy, than any of ``policies``, than their mixtures.

    Raises ValueError where episodes are too short to reach what matters to a policy.
    """
    flow = Flow(mdp, costs, base)
    columns = [flow.visits(policy) for policy in (uniform_policy(mdp), *policies)]
    ideal = policy_of(fill(costs.mean(axis=0), base), flow.shape)  # what one would record if one could, as a policy
    columns.append(flow.visits(0.9 * ideal + 0.1 * uniform_policy(mdp)))
    worst = float(evaluate(costs, base, np.mean(columns, axis=0)).max())
    if not worst < _HOPELESS:
        raise ValueError(
            f"restart must let episodes reach the (s, a) that matter; at {1.0 - mdp.discount:g} what their own policies and "
            f"the uniform one record leaves {worst:.2g} times the variance of free sampling"
        )
    return minimise(costs, base, columns, flow.propose, solver="frank_wolfe", tolerance=tolerance)


def certify(mdp: FiniteMDP, costs: Array, base: Array, q: Array, weights: Array, solver: str) -> Design:
    """The design of the policy that q stands for, with its own value and bound, however q was found."""
    flow = Flow(mdp, costs, base)
    point = flow.visits(policy_of(np.maximum(q, 0.0), flow.shape))
    bound, _ = flow.propose(weights, point)
    return Design(point, float(evaluate(costs, base, point).max()), bound, weights, solver)

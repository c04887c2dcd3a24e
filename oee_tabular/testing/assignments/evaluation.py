"""Assignment 3: values with and without a horizon, and the occupancy."""

from __future__ import annotations

from typing import Any

import numpy as np

from oee_tabular.exact import occupancy, state_values
from oee_tabular.testing.assignments.drawing import Parts, draw_parts, draw_policy
from oee_tabular.testing.assignments.judging import Arguments, Mistake, Task
from oee_tabular.typing import Array


def _uniform_start(P: Array) -> Array:
    return np.full(P.shape[0], 1 / P.shape[0])


def _draw_values(rng: np.random.Generator, is_hard: bool) -> Arguments:
    parts = draw_parts(rng, is_hard)
    policy = draw_policy(rng, parts.r.shape, is_hard=is_hard)
    return {"P": parts.P, "r": parts.r, "policy": policy, "discount": parts.discount}


def _draw_finite(rng: np.random.Generator, is_hard: bool) -> Arguments:
    arguments = _draw_values(rng, is_hard)
    if is_hard and rng.random() < 0.3:
        arguments["discount"] = 1.0
    return arguments | {"horizon": int(rng.integers(1 if is_hard else 2, 8))}


def _draw_occupancy(rng: np.random.Generator, is_hard: bool) -> Arguments:
    arguments = _draw_values(rng, is_hard)
    n = arguments["P"].shape[0]
    mu = np.eye(n)[0] if is_hard else rng.dirichlet(np.ones(n))
    return {
        "P": arguments["P"],
        "mu": mu,
        "policy": arguments["policy"],
        "discount": arguments["discount"],
    }


def _values(P: Array, r: Array, policy: Array, discount: float) -> Array:
    return state_values(Parts(P, r, _uniform_start(P), discount).mdp, policy)


def _finite(P: Array, r: Array, policy: Array, discount: float, horizon: int) -> Array:
    mdp = Parts(P, r, _uniform_start(P), discount).mdp
    return np.asarray(state_values(mdp, policy, horizon=horizon))


def _occupancy(P: Array, mu: Array, policy: Array, discount: float) -> Any:
    return occupancy(Parts(P, np.zeros(policy.shape), mu, discount).mdp, policy)


def _chain(P: Array, policy: Array) -> Array:
    return np.asarray(np.einsum("sa,sat->st", policy, P))


def _solve(M: Array, right: Array) -> Array:
    return np.asarray(np.linalg.solve(np.eye(len(M)) - M, right))


def _best_values(P: Array, r: Array, policy: Array, discount: float) -> Array:
    V = np.zeros(len(P))
    for _ in range(2000):
        V = (r + discount * P @ V).max(axis=1)
    return V


def _backward(
    P: Array, r: Array, policy: Array, discount: float, horizon: int
) -> Array:
    V = np.zeros(len(P))
    for _ in range(horizon):
        V = (policy * (r + discount * P @ V)).sum(axis=1)
    return V


VALUES = Task(
    name="3_values",
    call="state_values(P, r, policy, discount)",
    draw=_draw_values,
    solve=_values,
    hint="solve (I - discount P_pi) V = r_pi, where P_pi and r_pi are averages over the"
    " policy's actions; or iterate V = r_pi + discount P_pi V to the end.",
    mistakes=(
        Mistake(
            lambda P, r, policy, discount: _solve(
                discount * _chain(P, policy).T, (policy * r).sum(1)
            ),
            "the matrix is transposed: entry [s, t] leads from s to t.",
        ),
        Mistake(
            lambda P, r, policy, discount: _solve(
                discount * P.mean(axis=1), r.mean(axis=1)
            ),
            "all actions count the same here; average with the policy's probabilities.",
        ),
        Mistake(
            lambda P, r, policy, discount: _solve(
                discount * _chain(P, policy), r.mean(axis=1)
            ),
            "the rewards are averaged with the policy's probabilities as well.",
        ),
        Mistake(
            lambda P, r, policy, discount: _solve(
                discount * P.mean(axis=1), (policy * r).sum(1)
            ),
            "the transitions are averaged with the policy's probabilities as well.",
        ),
        Mistake(
            lambda P, r, policy, discount: _solve(
                discount * _chain(P, policy), r.sum(axis=1)
            ),
            "the rewards are summed over actions; weight them by the policy.",
        ),
        Mistake(
            _best_values,
            "these are the values of the best policy, by a maximum over actions; take"
            " the average over the policy that is given.",
        ),
        Mistake(
            lambda P, r, policy, discount: (
                (1 - discount)
                * _solve(discount * _chain(P, policy), (policy * r).sum(1))
            ),
            "the values are multiplied by (1 - discount); the sum itself is asked for.",
        ),
        Mistake(
            lambda P, r, policy, discount: (
                discount * _solve(discount * _chain(P, policy), (policy * r).sum(1))
            ),
            "the first reward is not discounted: t begins at 0.",
        ),
        Mistake(
            lambda P, r, policy, discount: (policy * r).sum(1),
            "this is the first reward alone; what follows is missing.",
        ),
        Mistake(
            lambda P, r, policy, discount: (
                (policy * r).sum(1) + discount * _chain(P, policy) @ (policy * r).sum(1)
            ),
            "these are the first two rewards; the sum goes on for ever.",
        ),
        Mistake(
            lambda P, r, policy, discount: _solve(
                discount
                * _chain(P, policy.argmax(1)[:, None] == np.arange(r.shape[1])),
                r[np.arange(len(r)), policy.argmax(axis=1)],
            ),
            "the policy takes its other actions too; average over all of them.",
        ),
    ),
)

FINITE = Task(
    name="3_horizon",
    call="finite_values(P, r, policy, discount, horizon)",
    draw=_draw_finite,
    solve=_finite,
    hint="begin with V = 0 and repeat V = r_pi + discount P_pi V, horizon times.",
    mistakes=(
        Mistake(
            lambda P, r, policy, discount, horizon: _backward(
                P, r, policy, discount, horizon + 1
            ),
            "this has one reward too many: horizon T means t = 0, ..., T - 1.",
        ),
        Mistake(
            lambda P, r, policy, discount, horizon: _backward(
                P, r, policy, discount, horizon - 1
            ),
            "this has one reward too few: horizon T means t = 0, ..., T - 1.",
        ),
        Mistake(
            lambda P, r, policy, discount, horizon: _solve(
                discount * _chain(P, policy), (policy * r).sum(1)
            ),
            "these are the values without a horizon.",
        ),
        Mistake(
            lambda P, r, policy, discount, horizon: _backward(
                P, r, policy, 1.0, horizon
            ),
            "the discount is missing.",
        ),
        Mistake(
            lambda P, r, policy, discount, horizon: (
                discount**horizon * _backward(P, r, policy, 1.0, horizon)
            ),
            "the discount counts once in each step, and not at the end alone.",
        ),
        Mistake(
            lambda P, r, policy, discount, horizon: sum(
                np.linalg.matrix_power(_chain(P, policy), t) @ (policy * r).sum(1)
                for t in range(horizon)
            ),
            "the discount is missing.",
        ),
    ),
)

OCCUPANCY = Task(
    name="3_occupancy",
    call="occupancy(P, mu, policy, discount)",
    draw=_draw_occupancy,
    solve=_occupancy,
    hint="d(s) = (1 - discount) mu(s) + discount times what flows into s; then d(s, a) ="
    " d(s) policy(a | s). It sums to 1.",
    mistakes=(
        Mistake(
            lambda P, mu, policy, discount: (
                _solve(discount * _chain(P, policy).T, mu)[:, None] * policy
            ),
            "the factor (1 - discount) is missing: the occupancy sums to 1.",
        ),
        Mistake(
            lambda P, mu, policy, discount: (
                (1 - discount)
                * _solve(discount * _chain(P, policy), mu)[:, None]
                * policy
            ),
            "the flow goes forward: multiply mu from the left, or transpose the matrix.",
        ),
        Mistake(
            lambda P, mu, policy, discount: (
                (1 - discount)
                * _solve(discount * _chain(P, policy).T, _uniform_start(P))[:, None]
                * policy
            ),
            "the first state is drawn from mu, and not uniformly.",
        ),
        Mistake(
            lambda P, mu, policy, discount: (
                (np.linalg.matrix_power(_chain(P, policy).T, 4096) @ mu)[:, None]
                * policy
            ),
            "this is where the policy is in the end; the occupancy counts early steps"
            " more.",
        ),
        Mistake(
            lambda P, mu, policy, discount: mu[:, None] * policy,
            "this is the first step alone; what follows is missing.",
        ),
        Mistake(
            lambda P, mu, policy, discount: np.repeat(
                (1 - discount) * _solve(discount * _chain(P, policy).T, mu)[:, None],
                policy.shape[1],
                axis=1,
            ),
            "multiply the time in a state by the policy's probability of the action.",
        ),
    ),
)

TASKS = (VALUES, FINITE, OCCUPANCY)

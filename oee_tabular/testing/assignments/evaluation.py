"""Assignment 3: values with and without a horizon, and the occupancy."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from oee_tabular.exact import occupancy, state_values
from oee_tabular.testing.assignments.drawing import (
    Parts,
    Situation,
    draw_situation,
    situation_kinds,
)
from oee_tabular.testing.assignments.judging import Arguments, Kind, Mistake, Task
from oee_tabular.typing import Array


def _uniform_start(P: Array) -> Array:
    return np.full(P.shape[0], 1 / P.shape[0])


def _for_values(drawn: Situation) -> Arguments:
    P, r, _, discount = drawn.parts
    return {"P": P, "r": r, "policy": drawn.policy, "discount": discount}


def _for_occupancy(drawn: Situation) -> Arguments:
    P, _, mu, discount = drawn.parts
    return {"P": P, "mu": mu, "policy": drawn.policy, "discount": discount}


def _draw_finite(
    rng: np.random.Generator,
    *,
    horizon: int | None = None,
    discount: float | None = None,
    n_states: int | None = None,
    n_actions: int | None = None,
    has_zeros: bool = False,
    is_certain: bool = False,
) -> Arguments:
    drawn = draw_situation(
        rng,
        discount=discount,
        n_states=n_states,
        n_actions=n_actions,
        has_zeros=has_zeros,
        is_certain=is_certain,
    )
    horizon = int(rng.integers(3, 9)) if horizon is None else horizon
    return _for_values(drawn) | {"horizon": horizon}


FINITE_KINDS = (
    Kind("", _draw_finite),
    Kind(
        "the discount is 1",
        partial(_draw_finite, discount=1.0),
        "with a discount of 1 the sum of T rewards exists, and no matrix I - discount P"
        " can be inverted: repeat the step T times.",
    ),
    Kind(
        "the horizon is 1",
        partial(_draw_finite, horizon=1),
        "with a horizon of 1 the value is the first reward alone.",
    ),
    Kind(
        "the horizon is 2",
        partial(_draw_finite, horizon=2),
        "with a horizon of 2 there are the rewards of t = 0 and t = 1.",
    ),
    Kind(
        "the horizon is 150 and the discount 0.99",
        partial(_draw_finite, horizon=150, discount=0.99),
        "the horizon may be long: repeat the step as often as it says.",
    ),
    Kind(
        "the policy takes one action in each state, and transitions have zeros",
        partial(_draw_finite, is_certain=True, has_zeros=True),
        "probabilities may be 0 and 1; the formula holds as it is.",
    ),
    Kind(
        "there are more actions than states",
        partial(_draw_finite, n_states=2, n_actions=4),
        "the first axis counts states and the second one actions; take no number of the"
        " one for the other.",
    ),
    Kind(
        "there is one state",
        partial(_draw_finite, n_states=1, n_actions=3),
        "with one state every action leads back to it; the formula holds as it is.",
    ),
    Kind(
        "the discount is 0",
        partial(_draw_finite, discount=0.0),
        "with a discount of 0 the first reward alone counts: 0**0 is 1.",
    ),
)


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


def _best_values(
    P: Array, r: Array, policy: Array, discount: float, horizon: int = 2000
) -> Array:
    V = np.zeros(len(P))
    for _ in range(horizon):
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
    kinds=situation_kinds(_for_values),
    axes=("state",),
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
        Mistake(
            lambda P, r, policy, discount: (
                discount
                * _chain(P, policy)
                @ _solve(discount * _chain(P, policy), (policy * r).sum(1))
            ),
            "the reward of t = 0 is missing: the sum begins with r(s, a) itself.",
        ),
        Mistake(
            lambda P, r, policy, discount: _solve(
                -discount * _chain(P, policy), (policy * r).sum(1)
            ),
            "the matrix is I - discount P_pi, with a minus.",
        ),
        Mistake(
            lambda P, r, policy, discount: (
                (np.eye(len(r)) - discount * _chain(P, policy)) @ (policy * r).sum(1)
            ),
            "this multiplies by the matrix I - discount P_pi; solve with it.",
        ),
        Mistake(
            lambda P, r, policy, discount: _solve(
                discount * P.sum(axis=1), (policy * r).sum(1)
            ),
            "the transitions are summed over actions; weight them by the policy.",
        ),
        Mistake(
            lambda P, r, policy, discount: _solve(
                discount * _chain(P, policy), r.max(axis=1)
            ),
            "this takes the best reward; average with the policy's probabilities.",
        ),
        Mistake(
            lambda P, r, policy, discount: _solve(
                0.9 * _chain(P, policy), (policy * r).sum(1)
            ),
            "the discount is an argument, and not always 0.9.",
        ),
        Mistake(
            lambda P, r, policy, discount: np.full(
                len(r),
                _solve(discount * _chain(P, policy), (policy * r).sum(1)).mean(),
            ),
            "each state has a value of its own; take no mean over states.",
        ),
    ),
)

FINITE = Task(
    name="3_horizon",
    call="finite_values(P, r, policy, discount, horizon)",
    kinds=FINITE_KINDS,
    axes=("state",),
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
        Mistake(
            lambda P, r, policy, discount, horizon: (
                discount * _backward(P, r, policy, discount, horizon)
            ),
            "the first reward is not discounted: t begins at 0.",
        ),
        Mistake(
            lambda P, r, policy, discount, horizon: (policy * r).sum(1) * horizon,
            "the state changes: multiply by P_pi in each step.",
        ),
        Mistake(
            lambda P, r, policy, discount, horizon: _backward(
                P, r, np.full(policy.shape, 1 / policy.shape[1]), discount, horizon
            ),
            "all actions count the same here; average with the policy's probabilities.",
        ),
        Mistake(
            lambda P, r, policy, discount, horizon: _best_values(
                P, r, policy, discount, horizon
            ),
            "these are the values of the best policy, by a maximum over actions; take"
            " the average over the policy that is given.",
        ),
        Mistake(
            lambda P, r, policy, discount, horizon: sum(
                discount**t
                * np.linalg.matrix_power(_chain(P, policy).T, t)
                @ (policy * r).sum(1)
                for t in range(horizon)
            ),
            "the matrix is transposed: entry [s, t] leads from s to t.",
        ),
    ),
)

OCCUPANCY = Task(
    name="3_occupancy",
    call="occupancy(P, mu, policy, discount)",
    kinds=situation_kinds(_for_occupancy),
    axes=("state", "action"),
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
        Mistake(
            lambda P, mu, policy, discount: (
                (1 - discount)
                * _solve(discount * P.mean(axis=1).T, mu)[:, None]
                * policy
            ),
            "the way through the states follows the policy's probabilities, and not equal"
            " ones.",
        ),
        Mistake(
            lambda P, mu, policy, discount: (
                (1 - discount)
                * _solve(discount * _chain(P, policy).T, mu)[:, None]
                / policy.shape[1]
                * np.ones(policy.shape)
            ),
            "multiply the time in a state by the policy's probability of the action, and"
            " not by an equal share.",
        ),
        Mistake(
            lambda P, mu, policy, discount: (
                (1 - discount)
                * discount
                * (_chain(P, policy).T @ _solve(discount * _chain(P, policy).T, mu))[
                    :, None
                ]
                * policy
            ),
            "the first step is missing: t begins at 0.",
        ),
        Mistake(
            lambda P, mu, policy, discount: (
                (1 - discount)
                * (_chain(P, policy).T @ _solve(discount * _chain(P, policy).T, mu))[
                    :, None
                ]
                * policy
            ),
            "the first step is missing: t begins at 0.",
        ),
        Mistake(
            lambda P, mu, policy, discount: policy.copy(),
            "each state's entries sum to 1 here; all entries together do, by the time"
            " that is spent in each state.",
        ),
        Mistake(
            lambda P, mu, policy, discount: np.full(policy.shape, 1.0 / policy.size),
            "the pairs are not equally frequent; follow the policy from mu.",
        ),
    ),
)

TASKS = (VALUES, FINITE, OCCUPANCY)

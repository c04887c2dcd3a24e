"""Assignment 6: what a state-action pair adds to the variance, and where to record next."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from oee_tabular.exact import occupancy, state_values
from oee_tabular.testing.assignments.drawing import Parts, draw_parts, draw_policy
from oee_tabular.testing.assignments.judging import Arguments, Mistake, Task
from oee_tabular.typing import Array


def _draw_costs(rng: np.random.Generator, is_hard: bool) -> Arguments:
    parts = draw_parts(rng, is_hard)
    policy = draw_policy(rng, parts.r.shape, is_hard=is_hard)
    return {
        "P": parts.P,
        "r": parts.r,
        "mu": parts.mu,
        "policy": policy,
        "discount": parts.discount,
    }


class _Terms(NamedTuple):
    """What costs are made of, for right and wrong ones."""

    P: Array
    policy: Array
    discount: float
    factor: float
    d: Array
    V: Array
    variance: Array


def _terms(P: Array, r: Array, mu: Array, policy: Array, discount: float) -> _Terms:
    mdp = Parts(P, r, mu, discount).mdp
    V = state_values(mdp, policy)
    variance = np.maximum(P @ V**2 - (P @ V) ** 2, 0.0)
    d = np.asarray(occupancy(mdp, policy))
    return _Terms(P, policy, discount, discount / (1.0 - discount), d, V, variance)


def _costs(P: Array, r: Array, mu: Array, policy: Array, discount: float) -> Array:
    x = _terms(P, r, mu, policy, discount)
    return np.asarray((x.factor * x.d) ** 2 * x.variance)


def _mistake(rule: Callable[[_Terms], Array], hint: str) -> Mistake:
    return Mistake(lambda *arguments: rule(_terms(*arguments)), hint)


def _draw_design(rng: np.random.Generator, is_hard: bool) -> Arguments:
    costs = np.round(rng.gamma(0.7, size=(int(rng.integers(2, 5)), 2)), 3) + 0.01
    if is_hard:
        costs[rng.random(costs.shape) < 0.3] = 0.0
        costs[0, 0] = 1.0
    return {"costs": costs, "n": int(rng.integers(50, 500))}


def _design(costs: Array, n: int) -> Array:
    roots = np.sqrt(costs)
    return np.asarray(n * roots / roots.sum())


def _draw_variance(rng: np.random.Generator, is_hard: bool) -> Arguments:
    costs = _draw_design(rng, is_hard)["costs"]
    counts = rng.integers(1, 60, size=costs.shape)
    if is_hard:
        counts[costs == 0] = 0  # 0 / 0 costs nothing
        if rng.random() < 0.5:
            counts[0, 0] = 0  # what matters was never recorded
    return {"costs": costs, "counts": counts}


def _variance(costs: Array, counts: Array) -> float:
    matters = costs > 0
    with np.errstate(divide="ignore"):
        return float((costs[matters] / counts[matters]).sum())


COSTS = Task(
    name="6_costs",
    call="costs(P, r, mu, policy, discount)",
    draw=_draw_costs,
    solve=_costs,
    hint="c(s, a) = (discount / (1 - discount))^2 d(s, a)^2 Var V(s'), where d is the"
    " occupancy and the variance is over s' drawn from P(. | s, a).",
    mistakes=(
        _mistake(
            lambda x: x.factor**2 * x.d * x.variance,
            "the occupancy enters squared: an error in a row counts d times, and its"
            " variance d^2 times.",
        ),
        _mistake(
            lambda x: x.d**2 * x.variance,
            "the factor (discount / (1 - discount))^2 is missing.",
        ),
        _mistake(
            lambda x: x.factor * x.d**2 * x.variance,
            "the factor discount / (1 - discount) enters squared.",
        ),
        _mistake(
            lambda x: (x.d / (1.0 - x.discount)) ** 2 * x.variance,
            "the next state's value is discounted once: the factor is discount /"
            " (1 - discount), and not 1 / (1 - discount).",
        ),
        _mistake(
            lambda x: (x.factor * x.d) ** 2 * np.sqrt(x.variance),
            "the variance of V is needed, and not its standard deviation.",
        ),
        _mistake(
            lambda x: (x.factor * x.d) ** 2 * (x.P @ x.V**2),
            "this is the mean of V^2; subtract the square of the mean.",
        ),
        _mistake(
            lambda x: (x.factor * x.d) ** 2 * np.var(x.V),
            "the variance is over the next state of each pair, by P(. | s, a), and not"
            " over all states.",
        ),
        _mistake(
            lambda x: (x.factor * x.d.sum(axis=1, keepdims=True)) ** 2 * x.variance,
            "d(s, a) is the time in the pair, and not in the state.",
        ),
        _mistake(
            lambda x: x.factor * x.d * np.sqrt(x.variance),
            "this is the root of the cost.",
        ),
        _mistake(
            lambda x: (x.factor * x.policy) ** 2 * x.variance,
            "the policy's probability is not the time spent in the pair; multiply by"
            " the occupancy of the state.",
        ),
    ),
)

DESIGN = Task(
    name="6_design",
    call="neyman_design(costs, n)",
    draw=_draw_design,
    solve=_design,
    hint="the sum of costs / n(s, a) is least where n(s, a) is proportional to the root"
    " of the cost. The shares add up to n.",
    mistakes=(
        Mistake(
            lambda costs, n: n * costs / costs.sum(),
            "proportional to the root of the cost, and not to the cost: the second"
            " transition in a pair helps less than the first.",
        ),
        Mistake(
            lambda costs, n: np.full(costs.shape, n / costs.size),
            "equal shares are best only for equal costs.",
        ),
        Mistake(
            lambda costs, n: np.sqrt(costs) / np.sqrt(costs).sum(),
            "these are shares of 1; multiply by n.",
        ),
        Mistake(
            lambda costs, n: n * np.sqrt(costs / costs.sum()),
            "divide by the sum of the roots, and not by the root of the sum: the"
            " numbers must add up to n.",
        ),
        Mistake(
            lambda costs, n: (
                n * np.sqrt(costs) / np.sqrt(costs).sum(axis=1, keepdims=True)
            ),
            "n is for all pairs together, and not for each state.",
        ),
        Mistake(
            lambda costs, n: n * costs**2 / (costs**2).sum(),
            "proportional to the root of the cost, and not to its square.",
        ),
        Mistake(
            lambda costs, n: np.round(n * np.sqrt(costs) / np.sqrt(costs).sum()),
            "do not round: rounded numbers need not add up to n.",
        ),
        Mistake(
            lambda costs, n: n * (costs == costs.max()) / (costs == costs.max()).sum(),
            "all in the most expensive pair leaves the variance of the others infinite.",
        ),
        Mistake(
            lambda costs, n: n * (1 / np.sqrt(costs)) / (1 / np.sqrt(costs)).sum(),
            "the more expensive pair gets more transitions, and not fewer.",
        ),
    ),
)

VARIANCE = Task(
    name="6_variance",
    call="variance(costs, counts)",
    draw=_draw_variance,
    solve=_variance,
    hint="the variance is the sum of costs / counts. A pair of cost 0 adds 0, also"
    " without counts; one of positive cost without counts makes it inf.",
    mistakes=(
        Mistake(
            lambda costs, counts: costs.sum() / counts.sum(),
            "divide pair by pair, and sum then.",
        ),
        Mistake(
            lambda costs, counts: np.mean(costs / counts),
            "take the sum over pairs, and not the mean.",
        ),
        Mistake(
            lambda costs, counts: np.sqrt(_variance(costs, counts)),
            "this is the standard error, the root of the variance.",
        ),
        Mistake(
            lambda costs, counts: (costs / counts).sum(),
            "0 / 0 is nan: a pair of cost 0 adds 0, also without counts.",
        ),
        Mistake(
            lambda costs, counts: (costs[counts > 0] / counts[counts > 0]).sum(),
            "a pair that matters and was never recorded makes the variance inf; leaving"
            " it out takes silence for certainty.",
        ),
        Mistake(
            lambda costs, counts: (costs / np.maximum(counts, 1)).sum(),
            "no transition is not one transition: the variance is inf.",
        ),
        Mistake(
            lambda costs, counts: (costs / (counts / counts.sum())).sum(),
            "divide by the counts; by shares this is n times the variance.",
        ),
    ),
)

TASKS = (COSTS, DESIGN, VARIANCE)

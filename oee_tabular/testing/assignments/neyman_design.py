"""Assignment 6: what a state-action pair adds to the variance, and where to record next."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from oee_tabular.exact import occupancy, state_values
from oee_tabular.testing.assignments.drawing import (
    Parts,
    Situation,
    situation_kinds,
)
from oee_tabular.testing.assignments.judging import Arguments, Kind, Mistake, Task
from oee_tabular.typing import Array


def _for_costs(drawn: Situation) -> Arguments:
    P, r, mu, discount = drawn.parts
    return {"P": P, "r": r, "mu": mu, "policy": drawn.policy, "discount": discount}


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


def _draw_design(
    rng: np.random.Generator,
    *,
    shape: tuple[int, int] | None = None,
    n: int | None = None,
    n_zeros: int = 0,
    least: float = 0.01,
) -> Arguments:
    shape = (int(rng.integers(3, 6)), 2) if shape is None else shape
    costs = np.round(rng.gamma(0.7, size=shape), 3) + 0.01
    costs.ravel()[rng.permutation(costs.size)[:n_zeros]] = 0.0
    if least < 0.01:
        costs[0, 0], costs[-1, -1] = least, 1.0 / least
    return {"costs": costs, "n": int(rng.integers(50, 500)) if n is None else n}


def _draw_equal(rng: np.random.Generator) -> Arguments:
    drawn = _draw_design(rng)
    return drawn | {"costs": np.full(drawn["costs"].shape, drawn["costs"][0, 0])}


DESIGN_KINDS = (
    Kind("", _draw_design),
    Kind(
        "two costs are 0",
        partial(_draw_design, n_zeros=2),
        "a pair of cost 0 gets nothing, and the others share all of n.",
    ),
    Kind(
        "costs are from 1e-6 to 1e6",
        partial(_draw_design, least=1e-6),
        "a small cost is a cost: no floor, no number that is added, no rounding.",
    ),
    Kind("all costs are equal", _draw_equal, "equal costs get equal shares of n."),
    Kind(
        "one pair alone has a cost",
        partial(_draw_design, shape=(2, 3), n_zeros=5),
        "what has no cost gets nothing, and one pair gets all of n.",
    ),
    Kind(
        "there are more actions than states",
        partial(_draw_design, shape=(2, 5)),
        "n is for all pairs together, of every state and every action.",
    ),
    Kind(
        "n is 1",
        partial(_draw_design, n=1),
        "the numbers are real, and add up to n; do not round.",
    ),
)


def _design(costs: Array, n: int) -> Array:
    roots = np.sqrt(costs)
    return np.asarray(n * roots / roots.sum())


def _draw_variance(
    rng: np.random.Generator,
    *,
    n_zeros: int = 0,
    n_unrecorded: int = 0,
    least: float = 0.01,
    most: int = 60,
) -> Arguments:
    """Draw costs and counts; pairs of cost 0 and ``n_unrecorded`` others have none."""
    costs = _draw_design(rng, n_zeros=n_zeros, least=least)["costs"]
    counts = rng.integers(1, most, size=costs.shape)
    counts[costs == 0] = 0  # 0 / 0 costs nothing
    matters = np.flatnonzero(costs > 0)
    counts.ravel()[matters[:n_unrecorded]] = 0
    return {"costs": costs, "counts": counts}


def _draw_idle(rng: np.random.Generator) -> Arguments:
    """Draw a log with transitions in pairs of cost 0."""
    drawn = _draw_variance(rng, n_zeros=2)
    return drawn | {"counts": drawn["counts"] + 5}


def _draw_unequal(rng: np.random.Generator) -> Arguments:
    drawn = _draw_variance(rng)
    drawn["counts"][0] *= 100_000
    drawn["counts"][-1] = 1
    return drawn


_SILENCE = (
    "a pair of positive cost, however small, that was never recorded makes the variance"
    " inf."
)

VARIANCE_KINDS = (
    Kind("", _draw_variance),
    Kind(
        "pairs of cost 0 were never recorded",
        partial(_draw_variance, n_zeros=2),
        "0 / 0 is nan: a pair of cost 0 adds 0, also without counts.",
    ),
    Kind(
        "a pair of positive cost was never recorded",
        partial(_draw_variance, n_unrecorded=1),
        _SILENCE,
    ),
    Kind(
        "a pair of cost 1e-6 was never recorded",
        partial(_draw_variance, n_unrecorded=1, least=1e-6),
        _SILENCE,
    ),
    Kind(
        "pairs of cost 0 and of positive cost were never recorded",
        partial(_draw_variance, n_zeros=2, n_unrecorded=1),
        "inf and nan are told apart pair by pair: cost 0 adds 0, any other inf.",
    ),
    Kind(
        "pairs of cost 0 were recorded",
        _draw_idle,
        "a pair of cost 0 adds 0 with any count.",
    ),
    Kind(
        "pairs have one transition, and others millions",
        _draw_unequal,
        "each cost is divided by the count of its own pair.",
    ),
)


def _variance(costs: Array, counts: Array) -> float:
    matters = costs > 0
    with np.errstate(divide="ignore"):
        return float((costs[matters] / counts[matters]).sum())


COSTS = Task(
    name="6_costs",
    call="costs(P, r, mu, policy, discount)",
    kinds=situation_kinds(_for_costs, long=0.99),
    axes=("state", "action"),
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
        _mistake(
            lambda x: x.factor**2 * x.variance,
            "the occupancy is missing: a pair matters by the time spent in it.",
        ),
        _mistake(
            lambda x: (x.factor * x.d) ** 2 * (x.P @ x.V) ** 2,
            "this is the square of the mean of V; its variance is asked for.",
        ),
        _mistake(
            lambda x: (x.factor * x.d / (1.0 - x.discount)) ** 2 * x.variance,
            "the occupancy sums to 1: its factor (1 - discount) belongs to it.",
        ),
        _mistake(
            lambda x: (x.factor * x.d) ** 2 * x.P.var(axis=2),
            "the variance is of V(s'), weighted by P(s' | s, a), and not of the"
            " probabilities.",
        ),
    ),
)

DESIGN = Task(
    name="6_design",
    call="neyman_design(costs, n)",
    kinds=DESIGN_KINDS,
    is_entrywise=True,
    axes=("state", "action"),
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
        Mistake(
            lambda costs, n: n * (1 / costs) / (1 / costs).sum(),
            "the more expensive pair gets more transitions, and not fewer.",
        ),
        Mistake(
            lambda costs, n: np.sqrt(n * costs / costs.sum()),
            "the root is of the cost alone, and not of n.",
        ),
        Mistake(
            lambda costs, n: (
                n * np.sqrt(costs) / np.sqrt(costs).sum(axis=0, keepdims=True)
            ),
            "n is for all pairs together, and not for each action.",
        ),
        Mistake(
            lambda costs, n: np.floor(n * np.sqrt(costs) / np.sqrt(costs).sum()),
            "do not round: rounded numbers need not add up to n.",
        ),
        Mistake(
            lambda costs, n: np.ceil(n * np.sqrt(costs) / np.sqrt(costs).sum()),
            "do not round: rounded numbers need not add up to n.",
        ),
    ),
)

VARIANCE = Task(
    name="6_variance",
    call="variance(costs, counts)",
    kinds=VARIANCE_KINDS,
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
        Mistake(
            lambda costs, counts: (costs / np.sqrt(counts)).sum(),
            "divide by the counts, and not by their roots.",
        ),
        Mistake(
            lambda costs, counts: (costs / (counts + 1)).sum(),
            "divide by the counts as they are; nothing is added to them.",
        ),
        Mistake(
            lambda costs, counts: (costs * counts).sum(),
            "the variance falls with the counts: divide by them.",
        ),
        Mistake(
            lambda costs, counts: (costs**2 / counts).sum(),
            "the costs enter as they are, and not squared.",
        ),
        Mistake(
            lambda costs, counts: np.nan_to_num(costs / counts, posinf=0.0).sum(),
            "a pair that matters and was never recorded makes the variance inf; leaving"
            " it out takes silence for certainty.",
        ),
    ),
)

TASKS = (COSTS, DESIGN, VARIANCE)

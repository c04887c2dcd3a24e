"""Assignment 7: laws for estimators, judged by the estimators that they let pass.

An estimator here is a function (P, r, mu, discount, counts, policy) of the simulator's
arrays and of the counts of a log; it returns a number. A law returns True or False.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse

from oee_tabular.exact import policy_value
from oee_tabular.ratio import transition_ratio
from oee_tabular.testing.assignments.drawing import (
    Parts,
    draw_counts,
    draw_rows,
    draw_situation,
)
from oee_tabular.testing.assignments.judging import Arguments, Kind, Task, ask
from oee_tabular.typing import Array

Estimator = Callable[[Array, Array, Array, float, Array, Array], float]


class Suspect(NamedTuple):
    """An estimator, whether it obeys the law, and what is said where the law is wrong."""

    estimator: Estimator
    is_right: bool
    about: str


def value_of_simulator(
    P: Array, r: Array, mu: Array, discount: float, counts: Array, policy: Array
) -> float:
    """Compute the simulator's value, whatever the log says."""
    return float(policy_value(Parts(P, r, mu, discount).mdp, policy))


def value_of_frequencies(
    P: Array, r: Array, mu: Array, discount: float, counts: Array, policy: Array
) -> float:
    """Compute the value under the log's frequencies, the simulator's where none are."""
    mdp = Parts(P, r, mu, discount).mdp
    log = sparse.csr_array(counts.reshape(-1, counts.shape[-1]))
    model = transition_ratio(log, mdp, prior="none").target_model(mdp)
    return float(policy_value(model, policy))


def value_with_one_more(
    P: Array, r: Array, mu: Array, discount: float, counts: Array, policy: Array
) -> float:
    """Compute the value with one transition of the simulator's more in each pair."""
    more = counts + P
    more = more / more.sum(axis=-1, keepdims=True)
    return float(policy_value(Parts(more, r, mu, discount).mdp, policy))


class Drawn(NamedTuple):
    """A simulator with its rewards, a policy, and the target's transitions."""

    parts: Parts
    policy: Array
    target: Array


def _draw(
    rng: np.random.Generator,
    *,
    discount: float | None = None,
    n_states: int | None = None,
    n_actions: int | None = None,
    is_certain: bool = False,
    target_has_zeros: bool = False,
    sign: float | None = None,
    scale: float = 1.0,
) -> Drawn:
    """Draw a problem; with a sign, all rewards have it."""
    parts, policy = draw_situation(
        rng,
        discount=discount,
        n_states=n_states,
        n_actions=n_actions,
        is_certain=is_certain,
    )
    target = draw_rows(rng, parts.P.shape, has_zeros=target_has_zeros)
    if sign is not None:
        r = sign * np.round(rng.uniform(0.2, 1.5, size=parts.r.shape), 2)
        parts = parts._replace(r=r)
    return Drawn(parts._replace(r=scale * parts.r), policy, target)


def _for_shift(
    rng: np.random.Generator,
    draw: Callable[[np.random.Generator], Drawn],
    *,
    least: int = 1,
) -> Arguments:
    parts, policy, target = draw(rng)
    n = rng.integers(least, 20, size=parts.r.shape)
    if least == 0:
        n[0] = 0
    return {
        "estimate": None,
        "P": parts.P,
        "r": parts.r,
        "mu": parts.mu,
        "discount": parts.discount,
        "counts": draw_counts(rng, n, target),
        "policy": policy,
    }


def _for_limit(
    rng: np.random.Generator, draw: Callable[[np.random.Generator], Drawn]
) -> Arguments:
    """Draw a target whose value is not nearly 0, where a relative error says little."""
    truth = 0.0
    while abs(truth) < 0.3:
        parts, policy, target = draw(rng)
        at_target = parts._replace(P=target).mdp
        truth = policy_value(at_target, policy)
    return {
        "estimate": None,
        "simulator": parts.P,
        "target": target,
        "r": parts.r,
        "mu": parts.mu,
        "discount": parts.discount,
        "policy": policy,
    }


_DRAWS = (
    ("", _draw),
    ("the discount is 0.99", partial(_draw, discount=0.99)),
    ("the discount is 0.5", partial(_draw, discount=0.5)),
    ("all rewards are positive", partial(_draw, sign=1.0)),
    ("all rewards are negative", partial(_draw, sign=-1.0)),
    ("the policy takes one action in each state", partial(_draw, is_certain=True)),
    (
        "there are more actions than states",
        partial(_draw, n_states=2, n_actions=4),
    ),
    ("the target has zeros", partial(_draw, target_has_zeros=True)),
    ("rewards are in ten thousands", partial(_draw, scale=1e4)),
)

SHIFT_KINDS = (
    *(Kind(about, partial(_for_shift, draw=draw)) for about, draw in _DRAWS),
    Kind(
        "pairs were never recorded",
        partial(_for_shift, draw=_draw, least=0),
    ),
)

LIMIT_KINDS = tuple(
    Kind(about, partial(_for_limit, draw=draw)) for about, draw in _DRAWS
)


def _with_rewards(change: Callable[[Array], Array]) -> Estimator:
    """Return the value of frequencies under changed rewards."""

    def estimate(
        P: Array, r: Array, mu: Array, discount: float, counts: Array, policy: Array
    ) -> float:
        return value_of_frequencies(P, change(r), mu, discount, counts, policy)

    return estimate


def _scaled(factor: float) -> Estimator:
    """Return the value of frequencies times a number."""

    def estimate(
        P: Array, r: Array, mu: Array, discount: float, counts: Array, policy: Array
    ) -> float:
        return factor * value_of_frequencies(P, r, mu, discount, counts, policy)

    return estimate


def _normalised(
    P: Array, r: Array, mu: Array, discount: float, counts: Array, policy: Array
) -> float:
    value = value_of_frequencies(P, r, mu, discount, counts, policy)
    return (1.0 - discount) * value


def _first_reward_late(
    P: Array, r: Array, mu: Array, discount: float, counts: Array, policy: Array
) -> float:
    return discount * value_of_frequencies(P, r, mu, discount, counts, policy)


def _blend(
    P: Array, r: Array, mu: Array, discount: float, counts: Array, policy: Array
) -> float:
    arguments = (P, r, mu, discount, counts, policy)
    return 0.97 * value_of_frequencies(*arguments) + 0.03 * value_of_simulator(
        *arguments
    )


def _uniform(
    P: Array, r: Array, mu: Array, discount: float, counts: Array, policy: Array
) -> float:
    policy = np.full(policy.shape, 1.0 / policy.shape[1])
    return value_of_frequencies(P, r, mu, discount, counts, policy)


def _uniform_start(
    P: Array, r: Array, mu: Array, discount: float, counts: Array, policy: Array
) -> float:
    mu = np.full(len(mu), 1.0 / len(mu))
    return value_of_frequencies(P, r, mu, discount, counts, policy)


def _stops_early(
    P: Array, r: Array, mu: Array, discount: float, counts: Array, policy: Array
) -> float:
    """Compute the value of the frequencies for the first 20 rewards alone."""
    mdp = Parts(P, r, mu, discount).mdp
    log = sparse.csr_array(counts.reshape(-1, counts.shape[-1]))
    model = transition_ratio(log, mdp, prior="none").target_model(mdp)
    return float(policy_value(model, policy, horizon=20))


SHIFT_SUSPECTS = (
    Suspect(value_of_frequencies, True, "takes the log's frequencies for the target"),
    Suspect(
        value_of_simulator,
        True,
        "answers with the simulator's value (it is wrong, but it obeys this law)",
    ),
    Suspect(value_with_one_more, True, "adds the simulator's row to the counts"),
    Suspect(
        _uniform,
        True,
        "evaluates the uniform policy (it is wrong, but it obeys this law)",
    ),
    Suspect(
        _uniform_start,
        True,
        "begins in each state with equal probability (it is wrong, but it obeys this"
        " law)",
    ),
    Suspect(_normalised, False, "multiplies its value by (1 - discount)"),
    Suspect(_first_reward_late, False, "discounts the first reward"),
    Suspect(_stops_early, False, "sums the first 20 rewards alone"),
    Suspect(_scaled(1.01), False, "is too large by 1%"),
    Suspect(
        _with_rewards(lambda r: np.maximum(r, 0.0)),
        False,
        "takes negative rewards for 0",
    ),
    Suspect(
        _with_rewards(lambda r: np.asarray(r - r.mean())),
        False,
        "subtracts the mean reward",
    ),
    Suspect(
        _with_rewards(lambda r: np.clip(r, -3.0, 3.0)),
        False,
        "cuts rewards to between -3 and 3",
    ),
    Suspect(
        _with_rewards(lambda r: np.minimum(r, 3.0)),
        False,
        "cuts rewards above 3",
    ),
    Suspect(
        _with_rewards(lambda r: np.maximum(r, -3.0)),
        False,
        "cuts rewards below -3",
    ),
    Suspect(
        _with_rewards(lambda r: np.asarray(r / np.abs(r).max())),
        False,
        "divides the rewards by the largest",
    ),
)

LIMIT_SUSPECTS = (
    Suspect(value_of_frequencies, True, "takes the log's frequencies for the target"),
    Suspect(
        value_with_one_more,
        True,
        "adds the simulator's row to the counts, which a long log outweighs",
    ),
    Suspect(value_of_simulator, False, "answers with the simulator's value"),
    Suspect(_scaled(1.01), False, "is too large by 1%"),
    Suspect(_scaled(0.99), False, "is too small by 1%"),
    Suspect(_scaled(1.0001), False, "is too large by a ten thousandth"),
    Suspect(_scaled(0.9999), False, "is too small by a ten thousandth"),
    Suspect(_scaled(-1.0), False, "has the wrong sign"),
    Suspect(_stops_early, False, "sums the first 20 rewards alone"),
    Suspect(_blend, False, "mixes 3% of the simulator's value in"),
    Suspect(_normalised, False, "multiplies its value by (1 - discount)"),
    Suspect(_uniform, False, "evaluates the uniform policy"),
    Suspect(_uniform_start, False, "begins in each state with equal probability"),
    Suspect(
        _with_rewards(lambda r: np.maximum(r, 0.0)),
        False,
        "takes negative rewards for 0",
    ),
)


def _find_fault(
    task: Task, answer: Any, arguments: Arguments, suspects: Iterable[Suspect]
) -> str:
    """Run a law on estimators that obey it and on others; say where it is wrong."""
    for estimator, is_right, about in suspects:
        given = {**arguments, "estimate": estimator}
        verdict = task.read(ask(task, answer, given), True)
        if verdict != is_right:
            does = "accepts" if verdict else "refuses"
            obeys = "breaks" if verdict else "obeys"
            return (
                f"your law {does} an estimator that {about}, which {obeys} the law."
                f" Hint: {task.hint}"
            )
    return ""


def _judge_shift(task: Task, answer: Any, arguments: Arguments) -> str:
    return _find_fault(task, answer, arguments, SHIFT_SUSPECTS)


def _judge_limit(task: Task, answer: Any, arguments: Arguments) -> str:
    """Leave out a wrong estimator that happens to be right on this problem."""
    _, simulator, target, r, mu, discount, policy = arguments.values()
    truth = value_of_simulator(target, r, mu, discount, target, policy)
    suspects = [
        suspect
        for suspect in LIMIT_SUSPECTS
        if suspect.is_right
        or abs(
            suspect.estimator(simulator, r, mu, discount, 1e9 * target, policy) - truth
        )
        > 1e-5 * abs(truth)
    ]
    return _find_fault(task, answer, arguments, suspects)


SHIFT = Task(
    name="7_shift",
    call="shift_law(estimate, P, r, mu, discount, counts, policy)",
    kinds=SHIFT_KINDS,
    solve=lambda *_: True,
    judge=_judge_shift,
    hint="estimate with the rewards r and with r + c, for a c such as 5 and one such as"
    " -5; the second value is the first plus c / (1 - discount), to 1e-8 of the values.",
)

LIMIT = Task(
    name="7_limit",
    call="limit_law(estimate, simulator, target, r, mu, discount, policy)",
    kinds=LIMIT_KINDS,
    solve=lambda *_: True,
    judge=_judge_limit,
    hint="give it the counts 1e9 * target, which are a log without chance, and compare"
    " with the target's value to a relative error of 1e-6.",
)

TASKS = (SHIFT, LIMIT)

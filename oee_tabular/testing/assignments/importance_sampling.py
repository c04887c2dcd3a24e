"""Assignment 4: importance sampling over the episodes of a log, one weight a step."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from oee_tabular.data import Transitions
from oee_tabular.estimators import ImportanceSampling, Problem
from oee_tabular.mdp import FiniteMDP
from oee_tabular.simulate import sample_episodes
from oee_tabular.testing.assignments.drawing import draw_parts, draw_policy
from oee_tabular.testing.assignments.judging import Arguments, Mistake, Task
from oee_tabular.typing import Array, IntArray

STEPS = 5


def _draw_positive(rng: np.random.Generator, is_hard: bool) -> Arguments:
    """Draw a log and a policy that takes every action, so that no weight is 0."""
    arguments = _draw(rng, is_hard)
    policy = draw_policy(rng, arguments["policy"].shape, is_hard=False)
    return arguments | {"policy": policy}


def _draw(rng: np.random.Generator, is_hard: bool) -> Arguments:
    parts = draw_parts(rng, is_hard)
    behavior = draw_policy(rng, parts.r.shape, is_hard=False)
    log = sample_episodes(
        parts.mdp, behavior, int(rng.integers(4, 10)), STEPS, seed=rng
    )
    assert log.episode is not None
    assert log.timestep is not None
    assert log.reward is not None
    return {
        "state": np.array(log.state),
        "action": np.array(log.action),
        "reward": np.array(log.reward),
        "episode": np.array(log.episode),
        "timestep": np.array(log.timestep),
        "behavior": behavior,
        "policy": draw_policy(rng, parts.r.shape, is_hard=is_hard),
        "discount": parts.discount,
    }


def _solver(*, is_weighted: bool) -> Callable[..., float]:
    """Return the package's estimate from the columns of a log."""

    def solve(
        state: IntArray,
        action: IntArray,
        reward: Array,
        episode: IntArray,
        timestep: IntArray,
        behavior: Array,
        policy: Array,
        discount: float,
    ) -> float:
        # the model leads anywhere: the estimate reads of it only where an episode ends
        n, k = policy.shape
        P = np.full((n + 1, k, n + 1), 1.0 / (n + 1))
        P[n] = np.eye(n + 1)[n]
        model = FiniteMDP(
            P, np.zeros((n + 1, k)), np.full(n + 1, 1 / (n + 1)), discount
        )
        is_last = np.append(timestep[1:], 0) == 0
        log = Transitions(
            state,
            action,
            np.where(is_last, n, np.roll(state, -1)),
            reward,
            episode=episode,
            timestep=timestep,
            behavior_probability=behavior[state, action],
        )
        policy = np.vstack([policy, np.full(k, 1.0 / k)])
        problem = Problem(model, log, horizon=STEPS)
        estimator = ImportanceSampling(
            kind="per_decision", self_normalized=is_weighted, ragged="pad"
        )
        return float(estimator(problem, policy).value)

    return solve


def _by_steps(
    columns: tuple[Any, ...],
    *,
    power: int = 1,
    lag: int = 0,
    is_product: bool = True,
    is_whole: bool = False,
    is_discounted: bool = True,
    is_weighted: bool = False,
    is_padded: bool = True,
    is_sum: bool = False,
) -> float:
    """Estimate as a student may: with the whole product, without a discount, ..."""
    state, action, reward, episode, _, behavior, policy, discount = columns
    names = np.unique(episode)
    W, R = np.zeros((len(names), STEPS)), np.zeros((len(names), STEPS))
    for i, name in enumerate(names):
        mine = episode == name
        ratio = (policy / behavior)[state[mine], action[mine]] ** power
        w = np.cumprod(ratio) if is_product else ratio
        if lag:
            w = np.concatenate([[1.0], w[:-1]])
        if is_whole:
            w = np.full(len(w), w[-1])
        W[i, : len(w)] = w
        W[i, len(w) :] = w[-1] if is_padded else 0.0
        R[i, : len(w)] = reward[mine]
    factor = discount ** np.arange(STEPS) if is_discounted else np.ones(STEPS)
    if is_weighted:
        total = W.sum(axis=0)
        share = np.divide(W, total, out=np.zeros_like(W), where=total > 0)
        return float(factor @ (share * R).sum(axis=0))
    return float(factor @ (W * R).sum(axis=0)) / (1 if is_sum else len(names))


def _mistake(hint: str, **options: Any) -> Mistake:
    return Mistake(lambda *columns: _by_steps(columns, **options), hint)


def _over_the_log(*columns: Any) -> float:
    state, action, reward, episode, timestep, behavior, policy, discount = columns
    weight = np.cumprod((policy / behavior)[state, action])
    return float(discount**timestep @ (weight * reward)) / len(np.unique(episode))


def _by_rows(*columns: Any) -> float:
    return _by_steps(columns, is_sum=True) / len(columns[0])


def _over_all_weights(*columns: Any) -> float:
    """Divide by the sum of all weights and not step by step."""
    state, action, reward, episode, timestep, behavior, policy, discount = columns
    weight = np.empty(len(state))
    for name in np.unique(episode):
        mine = episode == name
        weight[mine] = np.cumprod((policy / behavior)[state[mine], action[mine]])
    return float(discount**timestep @ (weight * reward) / weight.sum())


CALL = "(state, action, reward, episode, timestep, behavior, policy, discount)"

PER_DECISION = Task(
    name="4_per_decision",
    call=f"per_decision{CALL}",
    draw=_draw,
    solve=_solver(is_weighted=False),
    hint="in each episode the reward of step t has the weight rho_0 rho_1 ... rho_t and"
    " the factor discount**t, where rho is policy / behavior of the action taken; the"
    " estimate is the mean over episodes.",
    mistakes=(
        _mistake(
            "each reward has the whole episode's product; the ratios after step t have"
            " mean 1 and add nothing but variance. Stop at t.",
            is_whole=True,
        ),
        _mistake(
            "the reward of step t depends on the action of step t: its ratio belongs"
            " into the weight.",
            lag=1,
        ),
        _mistake(
            "the ratio is policy / behavior, the evaluated over the recording one.",
            power=-1,
        ),
        _mistake(
            "one step's ratio is not enough: the state was reached by the behaviour"
            " policy. Multiply the ratios up to t.",
            is_product=False,
        ),
        _mistake("without weights this is the behaviour policy's value.", power=0),
        _mistake("the discount is missing: discount**t.", is_discounted=False),
        Mistake(
            _over_the_log,
            "the product runs on from one episode to the next; begin each with 1.",
        ),
        Mistake(_by_rows, "divide by the number of episodes, and not of rows."),
        _mistake("this is the sum over episodes; take the mean.", is_sum=True),
        _mistake(
            "this divides each step by the sum of its weights, which is the next"
            " exercise. Here divide by the number of episodes.",
            is_weighted=True,
        ),
    ),
)

WEIGHTED = Task(
    name="4_weighted",
    call=f"weighted_per_decision{CALL}",
    draw=_draw_positive,
    solve=_solver(is_weighted=True),
    hint="in step t divide the sum of weight * reward by the sum of weights over all"
    " episodes; an episode that has ended keeps its last weight, with reward 0.",
    mistakes=(
        _mistake(
            "this divides by the number of episodes; divide each step by the sum of"
            " its weights.",
        ),
        _mistake(
            "an episode that has ended keeps its last weight in the sum: it earns"
            " nothing more, and that is part of the average.",
            is_weighted=True,
            is_padded=False,
        ),
        Mistake(
            _over_all_weights,
            "this divides by the sum of the weights of all steps; each step has a sum"
            " of its own.",
        ),
        _mistake(
            "each reward has the whole episode's product; stop at t.",
            is_weighted=True,
            is_whole=True,
        ),
        _mistake(
            "the ratio of the action of step t belongs into the weight of its reward.",
            is_weighted=True,
            lag=1,
        ),
        _mistake(
            "the discount is missing: discount**t.",
            is_weighted=True,
            is_discounted=False,
        ),
        _mistake(
            "the ratio is policy / behavior, the evaluated over the recording one.",
            is_weighted=True,
            power=-1,
        ),
    ),
)

TASKS = (PER_DECISION, WEIGHTED)

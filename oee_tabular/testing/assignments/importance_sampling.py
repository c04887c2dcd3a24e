"""Assignment 4: importance sampling over the episodes of a log, one weight a step."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from oee_tabular.data import Transitions
from oee_tabular.estimators import ImportanceSampling, Problem
from oee_tabular.mdp import FiniteMDP
from oee_tabular.testing.assignments.drawing import draw_parts, draw_policy
from oee_tabular.testing.assignments.judging import Arguments, Kind, Mistake, Task
from oee_tabular.typing import Array, IntArray

LONG_EPISODE = 40  # steps
SMALL = 1e-6  # a small probability of the evaluated policy
RARE = 0.02  # the probability of an action that the behaviour policy takes rarely


def _draw_log(
    rng: np.random.Generator,
    *,
    n_episodes: int | None = None,
    lengths: tuple[int, int] = (1, 6),
    discount: float | None = None,
    n_states: int | None = None,
    n_actions: int | None = None,
) -> Arguments:
    """Draw the columns of a log; the rewards of one pair differ from step to step."""
    parts = draw_parts(rng, discount=discount, n_states=n_states, n_actions=n_actions)
    behavior = draw_policy(rng, parts.r.shape)
    n = int(rng.integers(4, 10)) if n_episodes is None else n_episodes
    rows = []
    for episode in range(n):
        state = int(rng.choice(len(parts.mu), p=parts.mu))
        for timestep in range(int(rng.integers(*lengths))):
            action = int(rng.choice(behavior.shape[1], p=behavior[state]))
            reward = round(float(parts.r[state, action] + rng.normal()), 2)
            rows.append((state, action, reward, episode, timestep))
            state = int(rng.choice(len(parts.mu), p=parts.P[state, action]))
    states, actions, rewards, episodes, timesteps = zip(*rows, strict=True)
    return {
        "state": np.array(states),
        "action": np.array(actions),
        "reward": np.array(rewards),
        "episode": np.array(episodes),
        "timestep": np.array(timesteps),
        "behavior": behavior,
        "policy": draw_policy(rng, parts.r.shape),
        "discount": parts.discount,
    }


def _draw_zeros(rng: np.random.Generator) -> Arguments:
    """Draw a policy that never takes some of the recorded actions."""
    drawn = _draw_log(rng)
    return drawn | {"policy": draw_policy(rng, drawn["policy"].shape, is_certain=True)}


def _draw_small(rng: np.random.Generator) -> Arguments:
    """Draw a policy that takes some of the recorded actions with probability 1e-6."""
    drawn = _draw_log(rng)
    policy = draw_policy(rng, drawn["policy"].shape, is_certain=True) + SMALL
    return drawn | {"policy": policy / policy.sum(axis=1, keepdims=True)}


def _draw_same(rng: np.random.Generator) -> Arguments:
    drawn = _draw_log(rng)
    return drawn | {"policy": drawn["behavior"].copy()}


def _draw_rare(rng: np.random.Generator) -> Arguments:
    """Draw a behaviour policy that takes one action rarely, and a log that has it."""
    drawn = _draw_log(rng)
    behavior = np.full(drawn["behavior"].shape, RARE)
    behavior[:, 0] += 1.0 - behavior.sum(axis=1)
    return drawn | {"behavior": behavior}


def _draw_named(rng: np.random.Generator) -> Arguments:
    """Draw episodes whose names are any whole numbers, in any order."""
    drawn = _draw_log(rng)
    names = rng.permutation(1000)[: drawn["episode"].max() + 1] + 7
    return drawn | {"episode": names[drawn["episode"]]}


def _kinds(special: Kind) -> tuple[Kind, ...]:
    """Return the kinds of logs, with one of small weights."""
    return (
        Kind("", _draw_log),
        special,
        Kind(
            "the policy is the one that recorded",
            _draw_same,
            "all weights are 1 here, and the estimate is the mean discounted return.",
        ),
        Kind(
            "there is one episode",
            partial(_draw_log, n_episodes=1, lengths=(4, 6)),
            "a log may have one episode. Divide by the number of episodes, or by the sum of"
            " their weights, as it is: nothing is added to it.",
        ),
        Kind(
            "every episode has one step",
            partial(_draw_log, lengths=(1, 2)),
            "an episode may end after its first step; each begins with a weight of its"
            " own.",
        ),
        Kind(
            "no episode ends early",
            partial(_draw_log, lengths=(5, 6)),
        ),
        Kind(
            "the discount is 1",
            partial(_draw_log, discount=1.0),
            "the discount may be 1.",
        ),
        Kind(
            "episodes are named by any numbers",
            _draw_named,
            "an episode's name is any whole number: it is no position, and the largest"
            " one says nothing of how many there are.",
        ),
        Kind(
            "the behaviour policy takes one action rarely",
            _draw_rare,
            "weights may be large; they are not cut.",
        ),
        Kind(
            "episodes have up to 40 steps",
            partial(_draw_log, lengths=(1, LONG_EPISODE + 1)),
            "an episode may be long; a step has no largest number.",
        ),
    )


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
            episode=np.cumsum(timestep == 0),
            timestep=timestep,
            behavior_probability=behavior[state, action],
        )
        policy = np.vstack([policy, np.full(k, 1.0 / k)])
        problem = Problem(model, log, horizon=int(timestep.max()) + 1)
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
    state, action, reward, episode, timestep, behavior, policy, discount = columns
    names = np.unique(episode)
    n_steps = int(timestep.max()) + 1
    W, R = np.zeros((len(names), n_steps)), np.zeros((len(names), n_steps))
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
    factor = (discount if is_discounted else 1.0) ** np.arange(n_steps)
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
    _, _, reward, _, timestep, _, _, discount = columns
    weight = _running_weights(*columns)
    return float(discount**timestep @ (weight * reward) / weight.sum())


def _by_first_ratio(*columns: Any) -> float:
    """Weight each reward with the ratio of the episode's first step."""
    state, action, reward, _, timestep, behavior, policy, discount = columns
    ratio = (policy / behavior)[state, action]
    first = ratio[timestep == 0][np.cumsum(timestep == 0) - 1]
    n = np.count_nonzero(timestep == 0)
    return float(discount**timestep @ (first * reward)) / n


def _by_numbered_rows(*columns: Any) -> float:
    """Discount by the row's number in the log, in place of the step."""
    _, _, reward, episode, _, _, _, discount = columns
    factor = discount ** np.arange(len(reward))
    return float(factor @ (_running_weights(*columns) * reward)) / len(
        np.unique(episode)
    )


def _running_weights(*columns: Any) -> Array:
    """Return the product of the ratios up to each row, in its own episode."""
    state, action, _, episode, _, behavior, policy, _ = columns
    weight = np.empty(len(state))
    for name in np.unique(episode):
        mine = episode == name
        weight[mine] = np.cumprod((policy / behavior)[state[mine], action[mine]])
    return weight


def _weighted_by(
    denominator: Callable[[Array, Array], Array],
) -> Callable[..., float]:
    """Return an estimate with another denominator of the padded weights."""

    def estimate(*columns: Any) -> float:
        _, _, reward, _, timestep, _, _, discount = columns
        n_steps = int(timestep.max()) + 1
        i = np.cumsum(timestep == 0) - 1
        W = np.full((int(i[-1]) + 1, n_steps), np.nan)
        R = np.zeros(W.shape)
        W[i, timestep], R[i, timestep] = _running_weights(*columns), reward
        is_recorded = ~np.isnan(W)
        for t in range(1, n_steps):
            W[:, t] = np.where(is_recorded[:, t], W[:, t], W[:, t - 1])
        step = (W * R / denominator(W, is_recorded)).sum(axis=0)
        return float(discount ** np.arange(n_steps) @ step)

    return estimate


def _with_cut_weights(*columns: Any) -> float:
    """Cut weights to at most 1."""
    _, _, reward, episode, timestep, _, _, discount = columns
    weight = np.minimum(_running_weights(*columns), 1.0)
    return float(discount**timestep @ (weight * reward)) / len(np.unique(episode))


CALL = "(state, action, reward, episode, timestep, behavior, policy, discount)"

PER_DECISION = Task(
    name="4_per_decision",
    call=f"per_decision{CALL}",
    kinds=_kinds(
        Kind(
            "the policy never takes some of the recorded actions",
            _draw_zeros,
            "a weight may be 0; the episode still counts in n, and its rewards before"
            " that step do as well.",
        )
    ),
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
        Mistake(
            lambda *columns: _by_steps(
                (*columns[:5], np.ones_like(columns[5]), *columns[6:])
            ),
            "the ratio is policy / behavior; the behaviour policy is missing.",
        ),
        Mistake(_by_rows, "divide by the number of episodes, and not of rows."),
        Mistake(
            lambda *columns: (
                _by_steps(columns, is_sum=True) / (int(columns[4].max()) + 1)
            ),
            "divide by the number of episodes, and not of steps.",
        ),
        Mistake(
            lambda *columns: (
                _by_steps(columns, is_sum=True) / (int(columns[3].max()) + 1)
            ),
            "divide by the number of episodes; their names are any numbers.",
        ),
        Mistake(
            _by_first_ratio,
            "the ratio of the first step is not enough; multiply the ratios up to t.",
        ),
        Mistake(
            _by_numbered_rows,
            "discount by the step in the episode, discount**timestep, and not by the row"
            " of the log.",
        ),
        Mistake(
            _with_cut_weights,
            "a weight may be above 1; it is not cut.",
        ),
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
    kinds=_kinds(
        Kind(
            "the policy takes some of the recorded actions with probability 1e-6",
            _draw_small,
            "a weight may be very small; it is no 0, and nothing is added to it.",
        )
    ),
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
        Mistake(
            _weighted_by(lambda W, _: W.sum(axis=1, keepdims=True)),
            "the sum is over episodes in each step, and not over an episode's steps.",
        ),
        Mistake(
            _weighted_by(lambda W, _: W[:, :1].sum(axis=0)),
            "each step has a sum of weights of its own, and not that of the first step.",
        ),
        Mistake(
            _weighted_by(lambda W, _: W[:, -1:].sum(axis=0)),
            "each step has a sum of weights of its own, and not that of the last step.",
        ),
        Mistake(
            _weighted_by(lambda _, is_recorded: is_recorded.sum(axis=0)),
            "divide by the sum of the weights, and not by the number of episodes that"
            " are in the step.",
        ),
        _mistake(
            "one step's ratio is not enough: multiply the ratios up to t.",
            is_weighted=True,
            is_product=False,
        ),
        _mistake(
            "without weights this is the behaviour policy's value.",
            is_weighted=True,
            power=0,
        ),
    ),
)

TASKS = (PER_DECISION, WEIGHTED)

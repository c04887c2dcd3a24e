"""Episodes of a continuous task: Monte Carlo values, recorded logs and resimulation."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular._results import checked
from oee_tabular.continuous.log.transitions import RECORDED, ContinuousTransitions
from oee_tabular.continuous.task.base import (
    ContinuousTask,
    Moves,
    StatePolicy,
    check_probabilities,
    check_states,
)
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import limit_horizon
from oee_tabular.typing import Array, IntArray, Seed

CHUNK = 4096  # episodes of one random stream


def _choose(probabilities: Array, uniform: Array) -> IntArray:
    """Choose an action (n,) for each row of probabilities by a uniform number."""
    # columns: sums along short rows take thrice the time
    running = list(itertools.accumulate(probabilities.T))
    chosen = np.zeros(len(uniform), dtype=np.int64)
    level = uniform * running[-1]
    for bound in running[:-1]:
        chosen += bound <= level
    return chosen


@checked(counts=("n_episodes",))
@dataclass(frozen=True)
class MonteCarlo:
    """The mean of sampled returns and its standard error.

    Attributes
    ----------
    value : float
        The mean of the returns.
    standard_error : float
        The standard error of the mean.
    deviation : float
        The standard deviation of one return.
    n_episodes : int
        The number of returns.

    Examples
    --------
    >>> from oee_tabular.tasks import CartPole, cartpole_policy
    >>> found = monte_carlo_value(CartPole(), cartpole_policy(1.0), 400, 100, seed=0)
    >>> (
    ...     round(found.deviation / 20, 6) == round(found.standard_error, 6),
    ...     found.n_episodes,
    ... )
    (True, 400)
    """

    value: float
    standard_error: float
    deviation: float
    n_episodes: int


@suggest_keywords
def monte_carlo_value(
    task: ContinuousTask,
    policy: StatePolicy,
    n_episodes: int,
    horizon: int,
    *,
    discount: float = 0.99,
    seed: Seed = None,
    normalized: bool = False,
) -> MonteCarlo:
    """Estimate J = E[sum_{t<T} gamma^t r_t] of a continuous task by Monte Carlo.

    Parameters
    ----------
    task : ContinuousTask
        The task.
    policy : function
        The policy: of states (n, d) it gives probabilities (n, A).
    n_episodes : int
        The number of returns that are averaged.
    horizon : int
        T, the number of rewards.
    discount : float, default 0.99
        Gamma, in [0, 1].
    seed : int, Generator or SeedSequence, optional
        The source of random numbers. The same seed gives the same bits.
    normalized : bool, default False
        Whether values are multiplied by (1 - discount).

    Returns
    -------
    MonteCarlo
        The mean, its standard error and the deviation of one return.

    Raises
    ------
    ValueError
        If a number is out of its range, or ``normalized`` is asked for at discount 1.

    See Also
    --------
    corrected_value : The value in a simulator that a log corrects.
    policy_value : The exact value in a finite MDP.

    Notes
    -----
    It is the truth that discretised values are held to. Costs O(n_episodes * horizon)
    vectorised steps, from which terminal episodes are left out.

    Examples
    --------
    The paper's figure has .63 here, and 1 - .99^100 = .634 is the most there is:

    >>> from oee_tabular.tasks import CartPole, cartpole_policy
    >>> expert = monte_carlo_value(
    ...     CartPole(), cartpole_policy(0.0), 2000, 100, seed=0, normalized=True
    ... )
    >>> 0.62 < expert.value < 0.635
    True
    """
    _checks.instance(task, ContinuousTask, "task")
    n = _checks.positive_integer(n_episodes, "n_episodes")
    gamma = _checks.number_in(discount, "discount", 0.0, 1.0)
    _checks.boolean(normalized, "normalized")
    steps = limit_horizon(
        _checks.positive_integer(horizon, "horizon"), gamma, work=1000.0 * n
    )
    if normalized and gamma == 1.0:
        raise ArgumentError(
            "normalized",
            "must be False at discount 1: the factor (1 - discount) would be 0",
        )
    returns = []
    for rng, size in _streams(seed, n):
        total = np.zeros(size)
        walk = _walk(task, policy, size, steps, rng)
        for t, (alive, _, _, _, moved) in enumerate(walk):
            total[alive] += gamma**t * moved.reward
        returns.append(total)
    every = np.concatenate(returns) * ((1.0 - gamma) if normalized else 1.0)
    deviation = float(every.std(ddof=1)) if n > 1 else float("nan")
    return MonteCarlo(float(every.mean()), float(deviation / np.sqrt(n)), deviation, n)


def compare_returns(
    tasks: Sequence[ContinuousTask],
    policy: StatePolicy | Sequence[StatePolicy],
    n: int,
    horizon: int,
    *,
    discount: float,
    seed: np.random.SeedSequence,
) -> Array:
    """Sample returns (len(tasks), n) of several tasks with common random numbers.

    All have the ``policy``, or each its own of a sequence.

    The random numbers belong to the episode and the step, so that tasks that are alike
    go alike. By the difference of two tasks' returns their values are compared with a
    small part of Monte Carlo's own error. All begin where the first does.
    """
    start, steps = _common_streams(seed)
    n_disturbances = max(task.n_disturbances for task in tasks)
    states = np.tile(tasks[0].initial_states(n, start), (len(tasks), 1))
    total = np.zeros(len(states))
    alive = np.arange(len(states))
    for t, stream in enumerate(steps.spawn(horizon)):
        uniform = stream.random(n)
        disturbance = stream.standard_normal((n_disturbances, n)).T
        parts = _parts_of_tasks(alive, n, len(tasks))
        probabilities = _ask_each(policy, states, parts, tasks[0].n_actions)
        actions = _choose(probabilities, uniform[alive % n])
        following = np.empty_like(states)
        ended = np.zeros(len(states), dtype=np.bool_)
        for task, here in zip(tasks, parts, strict=True):
            if here.start < here.stop:
                chance = disturbance[alive[here] % n, : task.n_disturbances]
                moved = task.moves(states[here], actions[here], chance)
                following[here] = moved.next_state
                ended[here] = moved.terminated
                total[alive[here]] += discount**t * moved.reward
        alive = alive[~ended]
        states = following[~ended]
        if alive.size == 0:
            break
    return total.reshape(len(tasks), n)


def _common_streams(
    seed: np.random.SeedSequence,
) -> tuple[np.random.Generator, np.random.Generator]:
    """Return the generators of first states and of steps, the same for each call."""
    # the seed may have spawned streams before: its copy begins with the first
    fresh = np.random.SeedSequence(seed.entropy, spawn_key=seed.spawn_key)
    start, steps = map(np.random.default_rng, fresh.spawn(2))
    return start, steps


def _parts_of_tasks(alive: IntArray, n: int, n_tasks: int) -> list[slice]:
    """Return where the rows of each task stand among those of episodes that go on.

    Episodes k n to (k + 1) n - 1 are those of task k.
    """
    ends = np.searchsorted(alive, n * np.arange(n_tasks + 1))
    return [slice(*each) for each in itertools.pairwise(ends.tolist())]


def _ask_each(
    policy: StatePolicy | Sequence[StatePolicy],
    states: Array,
    parts: Sequence[slice],
    n_actions: int,
) -> Array:
    """Return probabilities (n, A) of one policy, or of one for each part of rows."""
    if callable(policy):
        return check_probabilities(policy, states, n_actions)
    asked = [
        check_probabilities(each, states[here], n_actions)
        for each, here in zip(policy, parts, strict=True)
        if here.start < here.stop
    ]
    return np.concatenate(asked)


@suggest_keywords
def record(
    task: ContinuousTask,
    policy: StatePolicy,
    *,
    n_transitions: int | None = None,
    n_episodes: int | None = None,
    max_steps: int,
    seed: Seed = None,
) -> ContinuousTransitions:
    """Record episodes of the task under a policy, with the transitions that end them.

    Parameters
    ----------
    task : ContinuousTask
        The task.
    policy : function
        The policy: of states (n, d) it gives probabilities (n, A).
    n_transitions : int, optional
        The number of transitions; the last episode is truncated where the log ends.
        Exactly one of ``n_transitions`` and ``n_episodes`` is given.
    n_episodes : int, optional
        The number of episodes.
    max_steps : int
        Episodes that still go on after so many steps are truncated, not terminated.
    seed : int, Generator or SeedSequence, optional
        The source of random numbers. The same seed gives the same bits.

    Returns
    -------
    ContinuousTransitions
        The log, with rewards, termination, truncation, episodes and the probabilities
        of the actions taken.

    Raises
    ------
    ValueError
        If both or neither of ``n_transitions`` and ``n_episodes`` are given, or a
        number is not a positive integer.

    See Also
    --------
    resimulate : Step a log's own states and actions in a simulator.

    Examples
    --------
    >>> from oee_tabular.tasks import CartPole, cartpole_policy
    >>> log = record(
    ...     CartPole(15.0),
    ...     cartpole_policy(0.3),
    ...     n_transitions=500,
    ...     max_steps=100,
    ...     seed=0,
    ... )
    >>> len(log), log.n_state, bool(log.truncated[-1] or log.terminated[-1])
    (500, 4, True)
    """
    if (n_transitions is None) == (n_episodes is None):
        raise ValueError("one of n_transitions and n_episodes must be given")
    _checks.instance(task, ContinuousTask, "task")
    steps = _checks.positive_integer(max_steps, "max_steps")
    if n_transitions is None:
        streams = _streams(seed, _checks.positive_integer(n_episodes, "n_episodes"))
        return ContinuousTransitions.concatenate(
            [_episodes(task, policy, size, steps, rng) for rng, size in streams]
        )
    rows = _checks.positive_integer(n_transitions, "n_transitions")
    _checks.require_memory(8.0 * rows, "n_transitions", rows)
    steps = min(steps, rows)  # where a longer episode goes on, the log has ended
    parts: list[ContinuousTransitions] = []
    generator = _checks.generator(seed)
    while sum(map(len, parts)) < rows:
        parts.append(_episodes(task, policy, 256, steps, generator.spawn(1)[0]))
    return ContinuousTransitions.concatenate(parts).first(rows)


def _streams(seed: Seed, n: int) -> list[tuple[np.random.Generator, int]]:
    """Return generators for CHUNK episodes each, spawned from ``seed``."""
    _checks.require_memory(9.0 * n, "n_episodes", n)
    sizes = [min(CHUNK, n - low) for low in range(0, n, CHUNK)]
    return list(zip(_checks.generator(seed).spawn(len(sizes)), sizes, strict=True))


def _walk(
    task: ContinuousTask,
    policy: StatePolicy,
    n: int,
    steps: int,
    rng: np.random.Generator,
) -> Iterator[tuple[IntArray, Array, IntArray, Array, Moves]]:
    """Yield n episodes step by step.

    Each step has the numbers of the episodes that go on, their states, actions, the
    actions' probabilities (n, A), and the transitions.
    """
    alive = np.arange(n)
    states = task.initial_states(n, rng)
    for _ in range(steps):
        probabilities = check_probabilities(policy, states, task.n_actions)
        actions = _choose(probabilities, rng.random(len(states)))
        moved = task.step(states, actions, rng)
        yield alive, states, actions, probabilities, moved
        alive = alive[~moved.terminated]
        states = moved.next_state[~moved.terminated]
        if alive.size == 0:
            return


def _episodes(
    task: ContinuousTask,
    policy: StatePolicy,
    n: int,
    steps: int,
    rng: np.random.Generator,
) -> ContinuousTransitions:
    """Record n episodes, sorted by episode and then by time."""
    rows: list[tuple[object, ...]] = []
    walk = _walk(task, policy, n, steps, rng)
    for t, (alive, states, actions, probabilities, moved) in enumerate(walk):
        cut = (t == steps - 1) & ~moved.terminated
        taken = probabilities[np.arange(len(alive)), actions]
        rows.append(
            (
                states,
                actions,
                moved.next_state,
                moved.reward,
                moved.terminated,
                cut,
                alive,
                taken,
            )
        )
    columns = {
        name: np.concatenate(part)
        for name, part in zip(RECORDED, zip(*rows, strict=True), strict=True)
    }
    order = np.argsort(columns["episode"], kind="stable")
    return ContinuousTransitions(
        **{name: column[order] for name, column in columns.items()}
    )


@suggest_keywords
def resimulate(
    task: ContinuousTask, log: ContinuousTransitions, *, seed: Seed = None
) -> ContinuousTransitions:
    """Step the states and actions of a log once in a simulator.

    Parameters
    ----------
    task : ContinuousTask
        The simulator.
    log : ContinuousTransitions
        The log, whose next states are not used.
    seed : int, Generator or SeedSequence, optional
        The source of the simulator's noise. The same seed gives the same bits.

    Returns
    -------
    ContinuousTransitions
        Independent transitions, in the order of the rows of ``log``.

    Raises
    ------
    ValueError
        If the log does not have the task's states and actions.

    Examples
    --------
    >>> from oee_tabular.tasks import CartPole, cartpole_policy
    >>> log = record(
    ...     CartPole(15.0), cartpole_policy(0.3), n_episodes=2, max_steps=50, seed=0
    ... )
    >>> pair = resimulate(CartPole(10.0), log, seed=0)
    >>> (
    ...     bool((pair.state == log.state).all()),
    ...     bool((pair.next_state == log.next_state).all()),
    ... )
    (True, False)
    """
    _checks.instance(task, ContinuousTask, "task")
    _checks.instance(log, ContinuousTransitions, "log", "ContinuousTransitions")
    states = check_states(task, log.state, "log.state")
    moved = task.step(states, log.action_numbers(task.actions), _checks.generator(seed))
    return ContinuousTransitions(
        states,
        log.action,
        moved.next_state,
        moved.reward,
        terminated=moved.terminated,
        timestep=log.timestep,
    )

"""Empirical MDPs: P(s' | s, a) = n(s, a, s') / n(s, a) of a log or of an environment.

The samples of an environment are drawn by ``tasks.exploring``, which steps it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from oee_tabular import _checks
from oee_tabular._sparse import (
    check_values,
    csr_on_pattern,
    is_matrix_list,
    repeat_rows,
    row_sums,
    stack_actions,
)
from oee_tabular.exceptions import ArgumentError, DataWarning, SimulatorWarning
from oee_tabular.mdp.arrays import check_available, check_layout, csr_from_entries
from oee_tabular.mdp.gymnasium_table import Outcomes, build_arguments
from oee_tabular.mdp.logs import LogLike, require_log, source_of_row
from oee_tabular.mdp.naming import (
    Name,
    Names,
    check_names,
    find_misspelt_ends,
    initial_distribution,
    renumber,
)
from oee_tabular.typing import Array, BoolArray, Csr, IntArray

# of 8 bytes each, that a model has for a pair without data
NUMBERS_PER_PAIR = 6.0


class Sampling(NamedTuple):
    """Hold the numbers of samples that an MDP of frequencies rests on.

    Attributes
    ----------
    pairs : ndarray of shape (S*A,)
        The samples of each (s, a): inf of terminal states, 0 where none was taken and
        the row was filled in.
    starts : float
        The number of first states that were sampled, inf if the initial distribution
        was given.
    reward_error : csr_array of shape (S*A, S), or None
        The variance of the mean reward of each transition; None where rewards were
        given.
    """

    pairs: Array
    starts: float
    reward_error: Csr | None


class Samples(NamedTuple):
    """Hold transitions that were met, and what their numbers stand for.

    Attributes
    ----------
    outcomes : Outcomes
        The transitions, each of weight 1.
    starts : ndarray of int
        The first state of each episode.
    names : Names
        The names of states and actions, where there are some.
    shape : tuple of int
        The numbers of states and of actions.
    available : ndarray of bool of shape (S, A), or None
        Which actions can be taken in each state; None means all of them.
    """

    outcomes: Outcomes
    starts: IntArray
    names: Names
    shape: tuple[int, int]
    available: BoolArray | None = None


def log_arguments(
    log: LogLike,
    rewards: Any,
    initial: object,
    sizes: tuple[Any, Any],
    names: tuple[Any, Any],
    layout: object,
    available: object = None,
) -> dict[str, Any]:
    """Return the arguments of ``FiniteMDP``, without the discount, from a log.

    ``FiniteMDP.from_log`` explains these. ``sizes`` and ``names`` are of states and of
    actions.
    """
    require_log(log)
    n_states, states, (state, following) = _resolve(
        log, "state", ("state", "next_state"), sizes[0], names[0]
    )
    n_actions, actions, (action,) = _resolve(
        log, "action", ("action",), sizes[1], names[1]
    )
    if names[0] is None and states is not None:
        _warn_of_misspelt(log, states, state, following)
    given = ("n_actions", n_actions) if n_actions > n_states else ("n_states", n_states)
    _checks.require_memory(NUMBERS_PER_PAIR * n_states * n_actions, *given)
    reward = _log_rewards(log, rewards)
    outcomes = Outcomes(
        state,
        action,
        following,
        np.ones(len(state)),
        np.nan_to_num(reward),
        log.terminated,
    )
    starts = state if log.episode_starts is None else state[log.episode_starts[:-1]]
    law: Array | None = None
    if initial is None and log.episode_starts is None and np.any(state != state[0]):
        _checks.warn(
            f"the log has no episodes: the simulator starts in each of its {len(state)}"
            " states alike (say where episodes start: initial=, --initial)",
            DataWarning,
        )
    if initial is not None:
        law = _checks.distribution(
            initial_distribution(initial, states, n_states), "initial", (n_states,)
        )
    called = Names(states, actions)
    can = None
    if available is not None:
        shape = (n_states, n_actions)
        source_of = partial(source_of_row, log)
        can = _check_available(available, called, shape, (state, action), source_of)
    samples = Samples(outcomes, starts, called, (n_states, n_actions), can)
    return frequency_arguments(samples, initial=law, rewards=rewards, layout=layout)


def _warn_of_misspelt(
    log: LogLike, names: tuple[Name, ...], state: IntArray, following: IntArray
) -> None:
    """Warn of states that no row leaves whose names may be misspellings of others'.

    A state that rows enter by termination alone is one in which the task ends.
    """
    is_end = np.ones(len(names), dtype=np.bool_)
    is_end[state] = False
    is_entered = np.zeros(len(names), dtype=np.bool_)
    is_entered[following[~log.terminated]] = True
    n_rows = np.bincount(np.concatenate([state, following]), minlength=len(names))
    pairs = [
        (name, other)
        for name, other in find_misspelt_ends(names, is_end, n_rows)
        if is_entered[names.index(name)]
    ]
    if not pairs:
        return
    name, other = pairs[0]
    row = int(np.flatnonzero(following == names.index(name))[0])
    more = _checks.in_all(len(pairs), "such states")
    _checks.warn(
        f"log.next_state[{row}]{source_of_row(log, row)} {_checks.show(name)} resembles the state"
        f" {_checks.show(other)}, and no row begins in it: it is read as another state,"
        f" in which episodes stay{more}. If it is misspelt, write {_checks.show(other)};"
        " if it is meant, write terminated in the rows that lead to it, or give it a"
        " row of its own",
        DataWarning,
    )


def _check_available(
    value: object,
    names: Names,
    shape: tuple[int, int],
    pairs: tuple[IntArray, IntArray],
    source_of: Callable[[int], str],
) -> BoolArray:
    """Check which actions can be taken, and that a log's transitions are of these.

    ``source_of`` returns the file that a row is of, in words.
    """
    state, action = pairs
    checked = check_available(value, names.states, names.actions)
    if checked.mask.shape != shape:
        raise ArgumentError(
            "available",
            f"must have shape {shape}, of the log's states and actions; it has shape"
            f" {checked.mask.shape}",
        )
    bad = np.flatnonzero(~checked.mask[state, action])
    if bad.size:
        pair = state[bad[0]], action[bad[0]]
        more = _checks.in_all(bad.size, "such transitions")
        raise ArgumentError(
            f"log[{bad[0]}]{source_of(int(bad[0]))}",
            "must have an action that can be taken in its state; in state"
            f" {names.state(pair[0])} action {names.action(pair[1])} cannot be taken,"
            f" and is{more}: {_checks.place('available', pair)} is False",
        )
    return checked.mask


def _log_rewards(log: LogLike, rewards: Any) -> Array:
    """Return the rewards of a log's rows, 0 or nan where one is missing.

    Raises an ArgumentError where one is missing and no ``rewards`` are given.
    """
    lacking = ""
    reward: Array = np.zeros(len(log.state)) if log.reward is None else log.reward
    if log.reward is None:
        lacking = "the log has none"
    elif np.isnan(reward).any():
        lacking = "some rows of the log have none"
    if lacking and rewards is None:
        raise ArgumentError("rewards", f"must be given where {lacking}; they are None")
    return reward


def _resolve(
    log: LogLike, label: str, columns: tuple[str, ...], size: object, names: object
) -> tuple[int, tuple[Name, ...] | None, list[IntArray]]:
    """Return the number of states or actions, their names, and their columns."""
    own = getattr(log, f"{label}_names")
    codes = [getattr(log, column) for column in columns]
    called = own
    if names is not None:
        rule = "a sequence of texts or tuples"
        called = _checks.collection(names, f"{label}_names", rule)
    largest = max(int(each.max()) for each in codes)
    if size is None:
        size = largest + 1 if called is None else len(called)
    number = _checks.positive_integer(size, f"n_{label}s")
    if own is None and number <= largest:
        raise ArgumentError(
            f"n_{label}s",
            f"must be at least {largest + 1}, for the log has {label} {largest}; it is"
            f" {number}",
        )
    if called is not None:
        called = check_names(called, f"{label}_names", number)
    if own is not None:
        source_of = partial(source_of_row, log)
        codes = [
            renumber(each, own, called, number, f"log.{name}", source_of)
            for each, name in zip(codes, columns, strict=True)
        ]
    return number, called, codes


def frequency_arguments(
    samples: Samples,
    *,
    initial: Array | None = None,
    rewards: Any = None,
    layout: object = None,
) -> dict[str, Any]:
    """Return the arguments of ``FiniteMDP``, without the discount, from samples.

    Without ``initial`` the distribution of the first state is how often episodes began
    in each; without ``rewards`` they are the mean reward of each transition.
    """
    met, starts, names, (n_states, n_actions), available = samples
    law = initial
    if law is None:
        law = np.bincount(starts, minlength=n_states) / len(starts)
    can = np.ones((n_states, n_actions), np.bool_) if available is None else available
    outcomes = _fill_pairs(met, law, can, names)
    by_pair = None
    if rewards is not None:
        table = _check_rewards(rewards, n_states, n_actions)
        if table.ndim < 3:
            by_pair = table.reshape(n_states, -1)
        else:
            reward = table[outcomes.state, outcomes.action, outcomes.next_state]
            outcomes = outcomes._replace(reward=reward)
    arguments = build_arguments(
        outcomes,
        law,
        n_actions,
        available=available,
        rewards=by_pair,
        layout=None if layout is None else check_layout(layout, n_states),
        state_names=names.states,
        action_names=names.actions,
    )
    counts = arguments["transitions"]
    terminal = arguments["terminal_state"]
    shares = counts.data / repeat_rows(counts, row_sums(counts))
    frequencies = csr_on_pattern(counts, shares, own=True)
    n_starts = float(len(starts)) if initial is None else np.inf
    sampling = _count_samples(
        met, terminal, counts.shape, n_starts, has_rewards=rewards is None
    )
    mask = arguments["available"]
    if mask is not None:  # nothing about them is unknown
        sampling.pairs[~mask.reshape(-1)] = np.inf
    return arguments | {"transitions": frequencies, "sampling": sampling}


def _check_rewards(rewards: Any, n_states: int, n_actions: int) -> Array:
    """Check rewards (S,), (S, A) or (S, A, S) and return them dense."""
    shape = n_states, n_actions, n_states
    if is_matrix_list(rewards):
        rewards = stack_actions(rewards, "rewards")
    is_sparse = _checks.is_sparse(rewards)
    given = check_values(rewards, "rewards").toarray() if is_sparse else rewards
    table = _checks.float_array(given, "rewards", ndim=(1, 2, 3))
    if is_sparse and table.shape == (n_states * n_actions, n_states):
        table = table.reshape(shape)
    if table.shape != shape[: table.ndim]:
        raise ArgumentError(
            "rewards",
            f"must have shape {shape[: table.ndim]}; it has shape {table.shape}",
        )
    return table


def _fill_pairs(
    samples: Outcomes, initial: Array, available: BoolArray, names: Names
) -> Outcomes:
    """Return the samples, with others for the ``available`` pairs that have none.

    An action never taken in a state does what the other actions did there; a state
    never left is absorbing with reward 0, but for those that are entered by termination
    alone. A warning names such pairs.
    """
    state, action, following, _, _, terminated = samples
    n_states, n_actions = available.shape
    row = state * n_actions + action
    counts = np.bincount(row, minlength=n_states * n_actions).reshape(-1, n_actions)
    is_left = counts.any(axis=1)
    is_entered = np.bincount(following[~terminated], minlength=n_states) > 0
    is_alive = is_left | (initial > 0) | is_entered
    is_ended = np.bincount(following[terminated], minlength=n_states) > 0
    is_lacking = (counts == 0) & available
    filled = np.argwhere(is_lacking & is_alive[:, None])
    if len(filled):
        _checks.warn(
            f"{len(filled)} state-action pairs were never recorded and are filled in"
            " (by the state's other actions; without any the state is absorbing,"
            f" reward 0): {names.first_pairs(filled)}",
            SimulatorWarning,
        )
    is_kept = ~is_left & (is_alive | ~is_ended)
    parts = [samples]
    for a in range(n_actions):
        stays = np.flatnonzero(is_kept & available[:, a])
        one = np.ones(len(stays))
        others = np.flatnonzero((is_left & is_lacking[:, a])[state])
        copies = Outcomes._make(part[others] for part in samples)
        parts.append(copies._replace(action=np.full(len(others), a)))
        parts.append(
            Outcomes(stays, np.full(len(stays), a), stays, one, 0.0 * one, one < 0)
        )
    return Outcomes._make(np.concatenate(part) for part in zip(*parts, strict=True))


def _count_samples(
    samples: Outcomes,
    terminal: IntArray,
    shape: tuple[int, int],
    starts: float,
    *,
    has_rewards: bool,
) -> Sampling:
    """Count the samples of each pair, and estimate the variance of each mean reward.

    The variance of a mean of k rewards is s^2 / k, s^2 the transition's own, or the
    pooled one where k = 1. There is none without ``has_rewards``.
    """
    n_rows, n_states = shape
    row = samples.state * (n_rows // n_states) + samples.action
    to = np.where(samples.terminated, terminal[samples.next_state], samples.next_state)
    pairs = np.bincount(row, minlength=n_rows).astype(np.float64)
    is_terminal = np.bincount(to[samples.terminated], minlength=n_states) > 0
    pairs[np.repeat(is_terminal, n_rows // n_states)] = np.inf
    if not has_rewards:
        return Sampling(pairs, starts, None)
    number, total, squares = (
        csr_from_entries(row, to, samples.reward**k, shape) for k in range(3)
    )
    deviation = np.maximum(squares.data - total.data**2 / number.data, 0.0)
    freedom = float((number.data - 1.0).sum())
    pooled = float(deviation.sum()) / freedom if freedom else 0.0
    own = deviation / np.maximum(number.data - 1.0, 1.0)
    variance = np.where(number.data > 1, own, pooled) / number.data
    return Sampling(pairs, starts, csr_on_pattern(number, variance, own=True))

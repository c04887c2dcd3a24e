"""MDPs from samples: the frequencies of a log, or of an environment that is stepped."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array, BoolArray, IntArray, Seed
from oee_tabular._sparse import check_csr
from oee_tabular.mdp.arrays import Sampling, check_layout, sampling_of
from oee_tabular.mdp.gymnasium_table import Outcomes, build
from oee_tabular.mdp.naming import Name, Names, check_names, initial_distribution, renumber, to_plain
from oee_tabular.mdp.support import require_log


def arguments_of_log(
    log: Any, rewards: Any, initial: object, sizes: tuple[Any, Any], names: tuple[Any, Any], layout: object
) -> dict[str, Any]:
    """The arguments of ``FiniteMDP`` but for the discount; ``FiniteMDP.from_log`` explains these."""
    require_log(log)
    own = (log.state_names, log.action_names)
    sized = [
        _sized(size, called, mine, columns, label)
        for size, called, mine, columns, label in zip(
            sizes, names, own, ((log.state, log.next_state), (log.action,)), ("state", "action"), strict=True
        )
    ]
    (n_states, state_names), (n_actions, action_names) = sized
    columns = []
    for column, called, mine in (
        ("state", state_names, own[0]), ("action", action_names, own[1]), ("next_state", state_names, own[0])
    ):  # fmt: skip
        codes = getattr(log, column)
        columns.append(codes if mine is None else renumber(codes, mine, called, len(called or ()), f"log.{column}"))
    state, action, following = columns
    if initial is None:
        starts = log.episode_starts
        first = state if starts is None else state[starts[:-1]]
        law = np.bincount(first, minlength=n_states) / len(first)
    else:
        law = _checks.distribution(initial_distribution(initial, state_names, n_states), "initial", (n_states,))
    if rewards is None and log.reward is None:
        raise ValueError("rewards must be given where the log has none; they are None")
    reward = np.zeros(len(state)) if log.reward is None else log.reward
    moves = frequencies(
        state, action, following, reward, log.terminated, n_actions, law, Names(state_names, action_names)
    )
    found = _arguments(moves, rewards, law, n_actions, (state_names, action_names), layout)
    firsts = len(state) if log.episode_starts is None else len(log.episode_starts) - 1
    columns_of = (state, action, following, log.terminated)
    return found | {
        "sampling": _sampling(found, columns_of, reward if rewards is None else None, firsts, initial is None)
    }


def arguments_of_env(env: object, samples_per_pair: object, seed: Seed, max_steps: object) -> dict[str, Any]:
    """The arguments of ``FiniteMDP`` but for the discount; ``FiniteMDP.from_env`` explains these."""
    wanted = _checks.positive_integer(samples_per_pair, "samples_per_pair")
    limit = _checks.positive_integer(max_steps, "max_steps")
    if not hasattr(env, "step") or not hasattr(env, "reset"):
        made = f" (gymnasium.make({env!r}))" if isinstance(env, str) else ""
        raise ValueError(f"env must be a Gymnasium environment; got {type(env).__name__}{made}")
    space, actions = getattr(env, "observation_space", None), getattr(env, "action_space", None)
    if not hasattr(actions, "n") or int(getattr(actions, "start", 0)) != 0:
        raise ValueError(f"env.action_space must be Discrete, from 0; it is {actions}")
    if getattr(getattr(space, "dtype", None), "kind", "i") == "f":
        raise ValueError(
            f"env.observation_space must be discrete (cut a continuous one into cells first); it is {space}"
        )
    n_actions = int(getattr(actions, "n", 0))
    seen, starts = _walked(env, n_actions, wanted, limit, _checks.generator(seed))
    known = dict.fromkeys(state for move in seen for state in (move[0], move[2]))
    numbers = all(isinstance(state, int) and state >= 0 for state in known)
    names = None if numbers else check_names(_ordered(list(known)), "the environment's observations", len(known))
    code = {state: state for state in known} if names is None else {name: k for k, name in enumerate(names)}
    n_states = max(int(getattr(space, "n", 0)), 1 + max(code.values())) if names is None else len(names)
    state, action, following, reward, terminated = (list(column) for column in zip(*seen, strict=True))
    law = np.bincount([code[s] for s in starts], minlength=n_states) / len(starts)
    columns = (
        np.array([code[s] for s in state]), np.array(action), np.array([code[s] for s in following]),
        np.array(terminated, dtype=np.bool_),
    )  # fmt: skip
    paid = np.array(reward, dtype=np.float64)
    moves = frequencies(*columns[:3], paid, columns[3], n_actions, law, Names(names))
    found = _arguments(moves, None, law, n_actions, (names, None), None)
    return found | {"sampling": _sampling(found, columns, paid, len(starts), True)}


def _sampling(found: dict[str, Any], columns: Any, reward: Array | None, starts: int, sampled: bool) -> Sampling:
    return sampling_of(
        columns, reward, float(starts) if sampled else np.inf, found["terminal_state"], found["transitions"].shape
    )


def _walked(
    env: Any, n_actions: int, wanted: int, limit: int, generator: np.random.Generator
) -> tuple[list[tuple[Any, ...]], list[Any]]:
    """Moves and first states of episodes, until each action of each state met has been taken ``wanted`` times."""
    tried: dict[Any, list[int]] = {}
    moves: list[tuple[object, ...]] = []
    starts: list[object] = []
    lacking, over, state = 0, True, None
    first_seed: int | None = int(generator.integers(2**31))
    while len(moves) < limit:
        if over:
            state = to_plain(env.reset(seed=first_seed)[0])
            first_seed = None
            starts.append(state)
        if state not in tried:
            tried[state] = [0] * n_actions
            lacking += n_actions
        counts = tried[state]
        least = [a for a in range(n_actions) if counts[a] == min(counts)]
        choices = least if min(counts) < wanted else range(n_actions)
        action = int(choices[int(generator.integers(len(choices)))])
        observation, reward, terminated, truncated, _ = env.step(action)
        following = to_plain(observation)
        moves.append((state, action, following, float(reward), bool(terminated)))
        counts[action] += 1
        lacking -= counts[action] == wanted
        state, over = following, bool(terminated or truncated)
        if lacking == 0 and (over or state in tried):
            return moves, starts
    _checks.warn(
        f"samples_per_pair, {wanted}, was not reached within max_steps, {limit}, in {lacking} of the {len(tried) * n_actions} "
        "pairs of a state and an action that were met"
    )
    return moves, starts


def _ordered(states: list[Any]) -> list[Any]:
    """In an order of their own, whatever was met first."""
    try:
        return sorted(states)
    except TypeError:
        return sorted(states, key=str)


def frequencies(
    state: IntArray, action: IntArray, following: IntArray, reward: Array, terminated: BoolArray, n_actions: int,
    initial: Array, names: Names,
) -> Outcomes:  # fmt: skip
    """The outcomes of each (s, a), with their shares and mean rewards; what is not there filled in, with a warning.

    An action never taken in a state: the shares of the moves that others made there; a state never left: it stays and pays 0,
    but for those that are entered by termination alone, which ``build`` makes so.
    Eight columns and facts of one log: none is apart from the others.
    """
    n_states = len(initial)
    keys, back = np.unique(
        np.stack([state, action, following, terminated.astype(np.int64)]), axis=1, return_inverse=True
    )
    back = back.reshape(-1)
    number = np.bincount(back).astype(np.float64)
    paid = np.bincount(back, weights=reward) / number
    met = Outcomes(keys[0], keys[1], keys[2], number, paid, keys[3] > 0)
    often = np.bincount(state * n_actions + action, minlength=n_states * n_actions).reshape(n_states, n_actions)
    left = often.sum(axis=1) > 0
    entered = np.zeros(n_states, dtype=np.bool_)
    entered[following[~terminated]] = True
    ended = np.zeros(n_states, dtype=np.bool_)
    ended[following[terminated]] = True
    alive = left | entered | (initial > 0)
    _say_filled((often == 0) & alive[:, None], names)
    parts = [met]
    for a in range(n_actions):
        parts.append(_borrowed(met, a, np.flatnonzero(left & (often[:, a] == 0)), n_states))
        stays = np.flatnonzero(~left & (alive | ~ended))
        one = np.ones(len(stays))
        parts.append(Outcomes(stays, np.full(len(stays), a), stays, one, 0.0 * one, one < 0))
    joined = Outcomes._make(np.concatenate(columns) for columns in zip(*parts, strict=True))
    totals = np.bincount(joined.state * n_actions + joined.action, weights=joined.probability)
    share = joined.probability / totals[joined.state * n_actions + joined.action]
    return joined._replace(probability=share)


def _borrowed(met: Outcomes, action: int, states: IntArray, n_states: int) -> Outcomes:
    """The moves of other actions in ``states``, as those of ``action``."""
    asked = np.zeros(n_states, dtype=np.bool_)
    asked[states] = True
    rows = np.flatnonzero(asked[met.state])
    taken = Outcomes._make(column[rows] for column in met)
    return taken._replace(action=np.full(len(rows), action))


def _say_filled(missing: BoolArray, names: Names) -> None:
    pairs = np.argwhere(missing)
    if len(pairs):
        named = "; ".join(names.pair(s, a) for s, a in pairs[:3])
        _checks.warn(
            f"{len(pairs)} pairs of a state and an action were never recorded and are filled in (as the state's other "
            f"actions do; without any it stays and pays 0): {named}{'; ...' * (len(pairs) > 3)}"
        )


def _arguments(
    moves: Outcomes, rewards: Any, initial: Array, n_actions: int, names: tuple[Any, Any], layout: object
) -> dict[str, Any]:
    n_own = len(initial)
    array = None
    if rewards is not None:
        array = check_csr(rewards, "rewards").toarray() if sparse.issparse(rewards) else rewards
        array = _checks.float_array(array, "rewards", ndim=(1, 2, 3))
        if sparse.issparse(rewards) and array.shape == (n_own * n_actions, n_own):
            array = array.reshape(n_own, n_actions, n_own)
        shapes = {1: (n_own,), 2: (n_own, n_actions), 3: (n_own, n_actions, n_own)}
        if array.shape != shapes[array.ndim]:
            raise ValueError(f"rewards must have shape {shapes[array.ndim]}; it has shape {array.shape}")
        if array.ndim == 3:
            moves = moves._replace(reward=array[moves.state, moves.action, moves.next_state])
    places = None
    if layout is not None:
        places = np.array(check_layout(layout, n_own))
    table = replace(build(moves, n_actions, initial, places, names[0]), action_names=names[1])
    found = dict(vars(table))
    if array is not None and array.ndim < 3:
        found["rewards"] = _paid_alive(array.reshape(n_own, -1), moves, initial, len(table.initial), n_actions)
    return found


def _paid_alive(rewards: Array, moves: Outcomes, initial: Array, n_states: int, n_actions: int) -> Array:
    """(S, A): r(s, a) of the own states, 0 where the task is over."""
    going_on = initial > 0
    going_on[moves.next_state[~moves.terminated]] = True
    over = np.zeros(len(initial), dtype=np.bool_)
    over[moves.next_state[moves.terminated]] = True
    paid = np.zeros((n_states, n_actions))
    paid[: len(rewards)] = np.where((over & ~going_on)[:, None], 0.0, rewards)
    return paid


def _sized(
    size: object, names: object, own: tuple[Name, ...] | None, columns: tuple[IntArray, ...], label: str
) -> tuple[int, tuple[Name, ...] | None]:
    """How many states or actions there are, and their names."""
    largest = max(int(column.max()) for column in columns)
    called = own if names is None else _checks.collection(names, f"{label}_names", "a sequence of texts or tuples")
    least = largest + 1 if own is None else 1
    count = size if size is not None else len(called) if called is not None else largest + 1
    number = _checks.positive_integer(count, f"n_{label}s")
    if number < least:
        raise ValueError(f"n_{label}s must be at least {least}, for the log has {label} {largest}; it is {number}")
    return number, None if called is None else check_names(called, f"{label}_names", number)

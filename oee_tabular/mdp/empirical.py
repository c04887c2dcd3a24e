"""Empirical MDPs: P(s' | s, a) = n(s, a, s') / n(s, a) of a log, or of an environment that is stepped."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array, BoolArray, IntArray, Seed
from oee_tabular._sparse import check_csr
from oee_tabular.mdp.arrays import check_layout
from oee_tabular.mdp.explorer import Explorer
from oee_tabular.mdp.gymnasium_table import Outcomes, build_arguments
from oee_tabular.mdp.naming import Name, Names, check_names, initial_distribution, renumber
from oee_tabular.mdp.samples import compute_sampling
from oee_tabular.mdp.support import require_log


def log_arguments(
    log: Any, rewards: Any, initial: object, sizes: tuple[Any, Any], names: tuple[Any, Any], layout: object
) -> dict[str, Any]:
    """Return the arguments of ``FiniteMDP`` but for the discount; ``FiniteMDP.from_log`` explains these."""
    require_log(log)
    n_states, state_names = _count(sizes[0], names[0], log.state_names, (log.state, log.next_state), "state")
    n_actions, action_names = _count(sizes[1], names[1], log.action_names, (log.action,), "action")
    columns = []
    for name in ("state", "action", "next_state"):
        own, called = (log.action_names, action_names) if name == "action" else (log.state_names, state_names)
        codes = getattr(log, name)
        columns.append(codes if own is None else renumber(codes, own, called, len(called or ()), f"log.{name}"))
    if rewards is None and log.reward is None:
        raise ValueError("rewards must be given where the log has none; they are None")
    paid = np.zeros(len(columns[0])) if log.reward is None else log.reward
    if rewards is None and np.isnan(paid).any():
        raise ValueError("rewards must be given where some rows of the log have none; they are None")
    paid = np.nan_to_num(paid)
    first = columns[0] if log.episode_starts is None else columns[0][log.episode_starts[:-1]]
    law = None
    if initial is not None:
        law = _checks.distribution(initial_distribution(initial, state_names, n_states), "initial", (n_states,))
    return _empirical_arguments(
        (*columns, log.terminated), paid, first, law, Names(state_names, action_names), (n_states, n_actions), rewards, layout
    )  # fmt: skip


def env_arguments(env: Any, samples_per_pair: object, seed: Seed, max_steps: object) -> dict[str, Any]:
    """Return the arguments of ``FiniteMDP`` but for the discount; ``FiniteMDP.from_env`` explains these."""
    n_wanted = _checks.positive_integer(samples_per_pair, "samples_per_pair")
    limit = _checks.positive_integer(max_steps, "max_steps")
    if not hasattr(env, "step") or not hasattr(env, "reset"):
        hint = f" (gymnasium.make({_checks.show(env)}))" if isinstance(env, str) else ""
        raise ValueError(f"env must be a Gymnasium environment; got {type(env).__name__}{hint}")
    space, actions = getattr(env, "observation_space", None), getattr(env, "action_space", None)
    if not hasattr(actions, "n") or int(getattr(actions, "start", 0)) != 0:
        raise ValueError(f"env.action_space must be Discrete, from 0; it is {actions}")
    if getattr(getattr(space, "dtype", None), "kind", "i") == "f":
        raise ValueError(
            f"env.observation_space must be discrete (cut a continuous one into cells first); it is {space}"
        )
    explorer = Explorer(env, int(getattr(actions, "n", 0)), n_wanted, _checks.generator(seed))
    is_short = explorer.explore(limit)
    known, state_names = list(explorer.states), None
    if all(isinstance(state, int) and state >= 0 for state in known):
        number = np.array(known)
        n_states = max(int(getattr(space, "n", 0)), 1 + max(known))
    else:
        state_names = check_names(_sort_states(known), "the environment's observations", len(known))
        places = {name: k for k, name in enumerate(state_names)}
        number, n_states = np.array([places[state] for state in known]), len(known)
    names = Names(state_names)
    if is_short.any():
        short = np.argwhere(is_short)
        named = "; ".join(names.pair(number[s], a) for s, a in short[:3])
        _checks.warn(
            f"samples_per_pair, {n_wanted}, was not reached within max_steps, {limit}, in {len(short)} of the "
            f"{explorer.n_pairs} state-action pairs that were met: {named}{'; ...' * (len(short) > 3)}"
        )
    state, action, following, reward, terminated = (np.array(c) for c in zip(*explorer.transitions, strict=True))
    columns = (number[state], action, number[following], terminated)
    return _empirical_arguments(
        columns, reward, number[explorer.starts], None, names, (n_states, explorer.n_actions), None, None
    )


def _empirical_arguments(
    columns: tuple[IntArray, IntArray, IntArray, BoolArray], reward: Array, starts: IntArray, initial: Array | None,
    names: Names, shape: tuple[int, int], rewards: Any, layout: object,
) -> dict[str, Any]:  # fmt: skip
    """Return the arguments of the MDP of samples (state, action, next state, terminated), and what they are known by.

    ``initial`` None: the frequencies of ``starts``. ``rewards`` None: the mean ``reward`` of each transition.
    """
    n_states, n_actions = shape
    law = np.bincount(starts, minlength=n_states) / len(starts) if initial is None else initial
    outcomes, table = outcome_frequencies(columns, reward, law, n_actions, names), None
    if rewards is not None:
        table = check_csr(rewards, "rewards").toarray() if sparse.issparse(rewards) else rewards
        table = _checks.float_array(table, "rewards", ndim=(1, 2, 3))
        if sparse.issparse(rewards) and table.shape == (n_states * n_actions, n_states):
            table = table.reshape(n_states, n_actions, n_states)
        expected = (n_states, n_actions, n_states)[: table.ndim]
        if table.shape != expected:
            raise ValueError(f"rewards must have shape {expected}; it has shape {table.shape}")
        if table.ndim == 3:
            outcomes = outcomes._replace(reward=table[outcomes.state, outcomes.action, outcomes.next_state])
    arguments = build_arguments(
        outcomes,
        law,
        n_actions,
        rewards=None if table is None or table.ndim == 3 else table.reshape(n_states, -1),
        layout=None if layout is None else np.array(check_layout(layout, n_states)),
        state_names=names.states,
        action_names=names.actions,
    )
    number = float(len(starts)) if initial is None else np.inf
    own = reward if rewards is None else None
    sampling = compute_sampling(columns, own, number, arguments["terminal_state"], arguments["transitions"].shape)
    return arguments | {"sampling": sampling}


def outcome_frequencies(
    columns: tuple[IntArray, IntArray, IntArray, BoolArray], reward: Array, initial: Array, n_actions: int, names: Names
) -> Outcomes:
    """Return the outcomes of each (s, a) with their shares and mean rewards; pairs without samples are filled in.

    An action never taken in a state does what the other actions did there; a state never left stays and pays 0, but for
    those that are entered by termination alone. A warning names such pairs.
    """
    state, action, following, terminated = columns
    n_states = len(initial)
    keys, back = np.unique(np.stack([part.astype(np.int64) for part in columns]), axis=1, return_inverse=True)
    number = np.bincount(back.reshape(-1)).astype(np.float64)
    mean = np.bincount(back.reshape(-1), weights=reward) / number
    met = Outcomes(keys[0], keys[1], keys[2], number, mean, keys[3] > 0)
    counts = np.bincount(state * n_actions + action, minlength=n_states * n_actions).reshape(n_states, n_actions)
    is_left = counts.any(axis=1)
    is_alive, is_ended = is_left | (initial > 0), np.zeros(n_states, dtype=np.bool_)
    is_alive[following[~terminated]] = True
    is_ended[following[terminated]] = True
    _warn_of_filled(np.argwhere((counts == 0) & is_alive[:, None]), names)
    parts, stays = [met], np.flatnonzero(~is_left & (is_alive | ~is_ended))
    one = np.ones(len(stays))
    for a in range(n_actions):
        others = np.flatnonzero((is_left & (counts[:, a] == 0))[met.state])
        parts.append(Outcomes._make(part[others] for part in met)._replace(action=np.full(len(others), a)))
        parts.append(Outcomes(stays, np.full(len(stays), a), stays, one, 0.0 * one, one < 0))
    filled = Outcomes._make(np.concatenate(part) for part in zip(*parts, strict=True))
    row = filled.state * n_actions + filled.action
    return filled._replace(probability=filled.probability / np.bincount(row, weights=filled.probability)[row])


def _warn_of_filled(pairs: IntArray, names: Names) -> None:
    if len(pairs):
        named = "; ".join(names.pair(s, a) for s, a in pairs[:3])
        _checks.warn(
            f"{len(pairs)} state-action pairs were never recorded and are filled in (as the state's other "
            f"actions do; without any it stays and pays 0): {named}{'; ...' * (len(pairs) > 3)}"
        )


def _sort_states(states: list[Any]) -> list[Any]:
    """Return the states in an order that does not depend on which was met first."""
    try:
        return sorted(states)
    except TypeError:
        return sorted(states, key=str)


def _count(
    size: object, names: object, own: tuple[Name, ...] | None, columns: tuple[IntArray, ...], label: str
) -> tuple[int, tuple[Name, ...] | None]:
    """Return the number of states or actions, and their names."""
    largest = max(int(column.max()) for column in columns)
    called = own if names is None else _checks.collection(names, f"{label}_names", "a sequence of texts or tuples")
    least = largest + 1 if own is None else 1
    count = size if size is not None else len(called) if called is not None else largest + 1
    number = _checks.positive_integer(count, f"n_{label}s")
    if number < least:
        raise ValueError(f"n_{label}s must be at least {least}, for the log has {label} {largest}; it is {number}")
    return number, None if called is None else check_names(called, f"{label}_names", number)

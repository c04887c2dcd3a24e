"""Outcomes of actions as the arrays of an MDP, and the tables of Gymnasium's toy texts.

``P[s][a]`` is a list of (probability, s', reward, terminated). Gymnasium itself is not
imported: the environment that is handed over brings what is needed.
"""

from __future__ import annotations

import contextlib
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from oee_tabular import _checks
from oee_tabular._sparse import csr_on_pattern
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp.arrays import csr_from_entries, grid_coordinates
from oee_tabular.mdp.environments import (
    is_discrete,
    read_flag,
    read_integer,
    read_mask,
    read_number,
    require_environment,
)
from oee_tabular.mdp.naming import Name, coordinates, valid_names
from oee_tabular.typing import Array, BoolArray, Csr, IntArray

# Wrappers of Gymnasium that change neither actions nor observations nor rewards. A time
# limit is no part of the model: it is the horizon of an evaluation.
_HARMLESS = frozenset(
    (
        "HumanRendering",
        "OrderEnforcing",
        "PassiveEnvChecker",
        "RecordEpisodeStatistics",
        "RecordVideo",
        "RenderCollection",
        "TimeLimit",
    )
)


class Outcomes(NamedTuple):
    """Hold what may follow an action, or did: six columns, (n,) each.

    The weight is a probability, or a number of samples.
    """

    state: IntArray
    action: IntArray
    next_state: IntArray
    weight: Array
    reward: Array
    terminated: BoolArray


def read_table(env: Any, *, masked: bool = False) -> dict[str, Any]:
    """Return the arguments of ``FiniteMDP``, but the discount, from a toy-text table.

    ``FiniteMDP.from_gymnasium`` explains them, and ``masked``.
    """
    if isinstance(env, str | type) or hasattr(env, "num_envs"):
        require_environment(env)
    _refuse_changing_wrappers(env)
    base = getattr(env, "unwrapped", env)
    table = getattr(base, "P", None)
    # old Gym calls the distribution of the first state isd
    first = getattr(base, "initial_state_distrib", getattr(base, "isd", None))
    if table is None or first is None:
        raise ArgumentError(
            "env",
            "must have a toy-text table env.unwrapped.P and an initial_state_distrib;"
            f" {type(base).__name__} has none (build the FiniteMDP from its arrays, or"
            " sample it: FiniteMDP.from_env(env, samples_per_pair=...); of an"
            " environment with continuous states make a tasks.GymnasiumTask)",
        )
    if getattr(base, "fickle_passenger", False):
        raise ArgumentError(
            "env",
            "must have all its dynamics in the table P; a fickle Taxi passenger"
            " changes its destination outside it"
            f" (fickle_probability={base.fickle_probability:g}): use"
            " fickle_passenger=False",
        )
    n_states, n_actions = _check_sizes(base, table)
    available = np.ones((n_states, n_actions), dtype=np.bool_)
    if masked:
        available &= _read_masks(base, n_states, n_actions)
    rows = list(_list_outcomes(table, available))
    columns = np.array(rows, dtype=np.float64).T
    outcomes = Outcomes._make(
        [*columns[:3].astype(np.int64), *columns[3:5], columns[5] > 0]
    )
    return build_arguments(
        outcomes,
        _checks.distribution(first, "env.initial_state_distrib", (n_states,)),
        n_actions,
        available=available,
        layout=_map_layout(base, n_states),
        state_names=valid_names(getattr(base, "state_names", None), n_states),
        action_names=_action_names(base, n_actions),
    )


def build_arguments(
    outcomes: Outcomes,
    initial: Array,
    n_actions: int,
    *,
    available: BoolArray | None = None,
    rewards: Array | None = None,
    layout: Array | None = None,
    state_names: tuple[Name, ...] | None = None,
    action_names: tuple[Name, ...] | None = None,
) -> dict[str, Any]:
    """Return the arguments of the MDP in which these outcomes follow.

    Outcomes that terminate lead to terminal states, and P has the sums of weights. A
    state that is only entered by termination is terminal itself; any other has a twin
    for it. Outcomes of one (s, a) that enter the same s' are merged: r(s, a, s') is
    their mean. ``rewards``: (S, A) of the own states, in place of theirs;
    ``available``: which actions can be taken in them, None for all.
    """
    terminal_state, terminal, twins = _terminal_states(outcomes, initial)
    n_own = len(initial)
    n_states = n_own + len(twins)
    shape = n_states * n_actions, n_states
    mask: BoolArray | None = None
    if available is not None and not available.all():
        mask = np.ones((n_states, n_actions), dtype=np.bool_)
        mask[:n_own] = available
        mask[terminal] = True
    # outcomes of what became terminal are replaced by staying there
    is_kept = ~np.isin(outcomes.state, terminal)
    weight = outcomes.weight
    rows, columns = _places(outcomes, is_kept, terminal_state, terminal, n_actions)
    stay = np.zeros(len(terminal) * n_actions)
    weights = np.concatenate([weight[is_kept], stay + 1.0])
    transitions = csr_from_entries(rows, columns, weights, shape)
    table: Csr | Array
    if rewards is None:
        own = np.concatenate([outcomes.reward[is_kept], stay])
        table = csr_from_entries(rows, columns, own, shape)
        if table.nnz < len(own):  # some are merged
            flow = csr_from_entries(rows, columns, weights * own, shape)
            mean = table.data.copy()
            np.divide(flow.data, transitions.data, mean, where=transitions.data > 0.0)
            table = csr_on_pattern(transitions, mean, own=True)
    else:
        table = np.zeros((n_states, n_actions))
        table[:n_own] = rewards
        table[terminal] = 0.0
    layout = coordinates(state_names) if layout is None else layout
    return {
        "transitions": transitions,
        "rewards": table,
        "initial": np.concatenate([initial, np.zeros(len(twins))]),
        "terminal_state": terminal_state,
        "layout": None if layout is None else np.concatenate([layout, layout[twins]]),
        "state_names": _add_twin_names(state_names, twins),
        "action_names": action_names,
        "available": mask,
    }


def _terminal_states(
    outcomes: Outcomes, initial: Array
) -> tuple[IntArray, IntArray, IntArray]:
    """Return ``terminal_state``, the terminal states, and the states that have a twin.

    A state has a twin where it is entered both by termination and alive.
    """
    n_own = len(initial)
    is_possible = outcomes.weight > 0.0
    to = outcomes.next_state[is_possible]
    terminated = outcomes.terminated[is_possible]
    is_ended = np.bincount(to[terminated], minlength=n_own) > 0
    is_entered = (initial > 0) | (np.bincount(to[~terminated], minlength=n_own) > 0)
    twins = np.flatnonzero(is_ended & is_entered)
    terminal_state = np.arange(n_own, dtype=np.int64)
    terminal_state[twins] = n_own + np.arange(len(twins))
    return terminal_state, terminal_state[is_ended], twins


def _places(
    outcomes: Outcomes,
    is_kept: BoolArray,
    terminal_state: IntArray,
    terminal: IntArray,
    n_actions: int,
) -> tuple[IntArray, IntArray]:
    """Return the rows s*A + a and columns s' of the kept outcomes, then of staying.

    Each action of a terminal state stays there.
    """
    to = outcomes.next_state
    entered = np.where(outcomes.terminated, terminal_state[to], to)
    own_rows = (outcomes.state * n_actions + outcomes.action)[is_kept]
    stay_rows = (terminal[:, None] * n_actions + np.arange(n_actions)).reshape(-1)
    stay_columns = np.repeat(terminal, n_actions)
    rows = np.concatenate([own_rows, stay_rows])
    columns = np.concatenate([entered[is_kept], stay_columns])
    return rows, columns


def _add_twin_names(
    names: tuple[Name, ...] | None, twins: IntArray
) -> tuple[Name, ...] | None:
    """Return the names of states, then those of their twins, "hall (over)"."""
    if names is None:
        return None
    added: list[Name] = []
    for state in twins:
        name = names[state]
        is_tuple = isinstance(name, tuple)
        added.append((*name, "over") if is_tuple else f"{name} (over)")
    return (*names, *added)


def _check_sizes(base: Any, table: Any) -> tuple[int, int]:
    """Return the numbers of states and actions of a table P.

    The spaces give them where they are Discrete, so that a table which lacks some is
    not taken for a whole one.
    """
    n_states = len(_entries(table, "env.P", "state"))
    space = getattr(base, "observation_space", None)
    if is_discrete(space) and int(space.n) != n_states:  # type: ignore[union-attr]
        raise ArgumentError(
            "env.P",
            f"must have the {space.n} states of env.observation_space; it has"  # type: ignore[union-attr]
            f" {n_states}",
        )
    own = _entry(table, "env.P", 0, n_states, "state")
    n_actions = len(_entries(own, "env.P[0]", "action"))
    if isinstance(own, Mapping):
        # a state may lack some of the actions
        rows = table.values() if isinstance(table, Mapping) else table
        numbers = [
            key
            for row in rows
            if isinstance(row, Mapping)
            for key in row
            if _checks.is_integer(key)
        ]
        n_actions = max(n_actions, 1 + max(numbers, default=0))
    space = getattr(base, "action_space", None)
    if is_discrete(space):
        n_actions = int(space.n)  # type: ignore[union-attr]
    return n_states, n_actions


def _entries(value: Any, name: str, noun: str) -> Any:
    """Require a mapping or a list that is not empty."""
    is_list = isinstance(value, Mapping | Sequence) and not isinstance(
        value, str | bytes
    )
    if isinstance(value, np.ndarray):
        is_list = value.ndim > 0
    if not is_list or not len(value):
        raise ArgumentError(
            name,
            f"must be a dict or list with an entry for each {noun}; it is"
            f" {_checks.show(value)}",
        )
    return value


def _entry(value: Any, name: str, number: int, size: int, noun: str) -> Any:
    """Return the entry of a state or an action; what is missing is an ArgumentError."""
    try:
        return value[number]
    except LookupError:
        keys = f"; its keys are {_checks.show(list(value)[:5])}"
        hint = ""
        if noun == "action":
            hint = (
                f" (of an action that cannot be taken: {name}[{number}] = [], a list"
                " without outcomes)"
            )
        raise ArgumentError(
            name,
            f"must have the {noun}s 0..{size - 1}; it lacks {number}"
            f"{keys if isinstance(value, Mapping) else ''}{hint}",
        ) from None


def _read_masks(base: Any, n_states: int, n_actions: int) -> BoolArray:
    """Return the masks of an environment's actions in each state, (S, A)."""
    if not callable(getattr(base, "action_mask", None)):
        raise ArgumentError(
            "masked",
            f"must be False where the environment has no action_mask(state);"
            f" {type(base).__name__} has none (masks in info are read by"
            " FiniteMDP.from_env)",
        )
    return np.array(
        [
            read_mask(base.action_mask(s), n_actions, f"env.action_mask({s})")
            for s in range(n_states)
        ]
    )


def _list_outcomes(
    table: Any, available: BoolArray
) -> Iterator[tuple[int, int, int, float, float, bool]]:
    """Yield the outcomes of positive probability, in the order of ``Outcomes``.

    What is no outcome is an ArgumentError that names its place in the table. In
    ``available`` (S, A), an action whose outcomes the table lacks, or lists none of,
    becomes False; the outcomes of one that is False are left out.
    """
    n_states, n_actions = available.shape
    for s in range(n_states):
        actions = _entry(table, "env.P", s, n_states, "state")
        name = f"env.P[{s}]"
        n_own = len(_entries(actions, name, "action"))
        is_mapping = isinstance(actions, Mapping)
        n_found = n_empty = 0
        for a in range(n_actions):
            if is_mapping and a not in actions:
                available[s, a] = False
                continue
            listed = _entry(actions, name, a, n_actions, "action")
            n_found += 1
            if isinstance(listed, Mapping | list | tuple) and len(listed) == 0:
                available[s, a] = False
                n_empty += 1
                continue
            found = _check_outcomes(listed, s, a, n_states)
            if available[s, a]:
                yield from found
        if n_own != n_found:
            keys = f": {_checks.show(list(actions)[:5])}" if is_mapping else ""
            raise ArgumentError(
                name,
                f"must have actions in 0..{n_actions - 1}; it has {n_own}{keys}",
            )
        if n_empty == n_found:
            raise ArgumentError(
                name,
                f"must have an action that can be taken; state {s} has none (a terminal"
                f" state: {name}[0] = [(1.0, {s}, 0.0, True)])",
            )
    never = np.flatnonzero(~available.any(axis=0))
    if never.size:
        raise ArgumentError(
            "env.P",
            f"must have each action 0..{n_actions - 1} in some state; no state has"
            f" action {never[0]}",
        )


def _check_outcomes(
    listed: Any, s: int, a: int, n_states: int
) -> list[tuple[int, int, int, float, float, bool]]:
    """Return the outcomes of a state-action pair; their probabilities sum to 1."""
    name = f"env.P[{s}][{a}]"
    found = []
    weights = []
    is_single = True
    for k, outcome in enumerate(_entries(listed, name, "outcome")):
        place = f"{name}[{k}]"
        if not isinstance(outcome, Sequence | np.ndarray) or len(outcome) != 4:
            raise ArgumentError(
                place,
                "must be (probability, next state, reward, terminated); it is"
                f" {_checks.show(outcome)} (of arrays of probabilities and rewards:"
                " FiniteMDP(transitions, rewards, initial, discount))",
            )
        probability, to, reward, terminated = outcome
        weight = read_number(probability)
        if weight is None or not 0.0 <= weight <= 1.0 + _checks.SUM_TOLERANCE:
            raise ArgumentError(
                place,
                f"must have a probability in [0, 1]; it has {_checks.show(probability)}",
            )
        weights.append(weight)
        is_single = is_single and isinstance(probability, np.float32)
        if weight > 0.0:
            state, number, flag = _check_outcome(
                to, reward, terminated, place, n_states
            )
            found.append((s, a, state, weight, number, flag))
    total = math.fsum(weights)
    if abs(total - 1.0) <= _checks.SUM_TOLERANCE:
        return found
    if is_single and abs(total - 1.0) <= _checks.SCALED_TOLERANCES[np.float32]:
        return [(*row[:3], row[3] / total, *row[4:]) for row in found]
    raise ArgumentError(
        name,
        "must have probabilities that"
        f" {_checks.SUM_RULE.format(total).replace('it sums', 'they sum')}",
    )


def _check_outcome(
    to: Any, reward: Any, terminated: Any, place: str, n_states: int
) -> tuple[int, float, bool]:
    """Return the next state, the reward and the flag of an outcome."""
    state = read_integer(to)
    if state is None or not 0 <= state < n_states:
        raise ArgumentError(
            place,
            f"must lead to a state in 0..{n_states - 1}; it leads to"
            f" {_checks.show(to)}",
        )
    number = read_number(reward)
    if number is None or not math.isfinite(number):
        raise ArgumentError(
            place, f"must have a finite reward; it has {_checks.show(reward)}"
        )
    flag = read_flag(terminated)
    if flag is None:
        raise ArgumentError(
            place,
            f"must have True or False as terminated; it has {_checks.show(terminated)}",
        )
    return state, number, flag


def _refuse_changing_wrappers(env: object) -> None:
    """Raise an ArgumentError for a wrapper that may change what the table P says."""
    layer = env
    while hasattr(layer, "env") and layer is not getattr(layer, "unwrapped", layer):
        if type(layer).__name__ not in _HARMLESS:
            raise ArgumentError(
                "env",
                "must not change actions, observations or rewards outside its table P;"
                f" the wrapper {type(layer).__name__} may (pass env.unwrapped to leave"
                " it out)",
            )
        layer = layer.env


def _map_layout(base: object, n_states: int) -> Array | None:
    """Return the (S, 2) row and column of the states of an environment on a map.

    None where it has no map with a cell for each state.
    """
    shapes: tuple[Any, ...] = (
        getattr(getattr(base, "desc", None), "shape", None),
        getattr(base, "shape", None),
    )
    for shape in shapes:
        is_map = (
            isinstance(shape, tuple)
            and len(shape) == 2
            and all(isinstance(n, int) for n in shape)
        )
        if is_map and shape[0] * shape[1] == n_states:
            return grid_coordinates(n_states, shape[1])
    return None


def _action_names(base: object, n_actions: int) -> tuple[Name, ...] | None:
    """Return an environment's names of its actions, or its module's (LEFT = 0).

    None where neither numbers them all.
    """
    given = getattr(base, "action_names", None)
    if given is None and hasattr(base, "get_action_meanings"):
        with contextlib.suppress(Exception):  # an environment's own code: no names then
            given = base.get_action_meanings()
    if given is not None:
        return valid_names(given, n_actions)
    constants = getattr(sys.modules.get(type(base).__module__), "__dict__", {}).items()
    numbered = sorted(
        (v, k.lower())
        for k, v in constants
        if k.isupper() and isinstance(v, int) and 0 <= v < n_actions
    )
    if [number for number, _ in numbered] != list(range(n_actions)):
        return None
    return tuple(name for _, name in numbered)

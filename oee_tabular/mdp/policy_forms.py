"""The forms in which people have a policy, made (S, A): an action a state, a mapping by names, a table, a function."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, Protocol

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray, PolicyLike
from oee_tabular.mdp.naming import Name, Names, is_name, names_of, number_of, numbers_of, plain

COLUMNS = "the columns state and action, with probability or without, or state and one for each action"


class Sized(Protocol):
    """Anything with numbers of states and actions, and the states that the environment itself knows."""

    @property
    def n_states(self) -> int:
        """S."""

    @property
    def n_actions(self) -> int:
        """A."""

    @property
    def terminal_state(self) -> IntArray:
        """(S0,): its length is the number of the environment's own states."""


def is_labelled(policy: object) -> bool:
    """Whether ``policy`` is a table or a series whose labels mean something: its order then does not."""
    if not hasattr(policy, "index") or not hasattr(policy, "to_dict"):
        return False
    own_index = type(policy.index).__name__ != "RangeIndex"
    return own_index or "state" in getattr(policy, "columns", ())


def labelled_policy(policy: Any, mdp: Sized, name: str) -> dict[Any, Any]:
    """A series state -> action, a table with a row a state and a column an action, or one as ``by_state`` reads it."""
    if not hasattr(policy, "columns"):
        return _unique(list(policy.items()), name)
    if "state" in policy.columns:
        return by_state(policy, mdp, name)
    return by_state(policy.rename_axis("state").reset_index(), mdp, name)


def by_state(frame: Any, mdp: Sized, name: str) -> dict[Any, Any]:
    """A mapping of a pandas table: state and action, a row a state; these and probability; or state and a column an action."""
    labels = list(frame.columns)
    known = numbers_of(names_of(mdp).actions or ())
    numbers = range(mdp.n_actions)
    actions = {  # a number or a name
        label: int(label) if isinstance(label, str) and label.isdigit() else label
        for label in labels
        if label != "state"
    }
    wide = "action" not in labels and all(a in known or (isinstance(a, int) and a in numbers) for a in actions.values())
    if "state" not in labels or len(labels) < 2 or not ("action" in labels or wide) or len(frame) == 0:
        found = ", ".join(map(str, labels))
        raise ValueError(f"{name} must have {COLUMNS}, and at least one row; it has {found} and {len(frame)} rows")
    if wide:
        rows = frame.to_dict("records")
        pairs = [(row["state"], {a: _number(row[label], name) for label, a in actions.items()}) for row in rows]
        return _unique(pairs, name)
    if "probability" not in labels:
        return _unique(list(zip(frame["state"].tolist(), frame["action"].tolist(), strict=True)), name)
    table: dict[Any, Any] = {}
    for state, action, probability in frame[["state", "action", "probability"]].itertuples(index=False, name=None):
        chosen = table.setdefault(state, {})
        if action in chosen:
            raise ValueError(
                f"{name} must have each state's action once; state {state}, action {action} is there twice"
            )
        chosen[action] = _number(probability, name)
    return table


def _unique(pairs: list[tuple[Any, Any]], name: str) -> dict[Any, Any]:
    table: dict[Any, object] = {}
    for state, choice in pairs:
        if state in table:
            raise ValueError(f"{name} must have a row for each state; state {state} has two")
        table[state] = choice
    return table


def _number(value: Any, name: str) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        raise ValueError(f"{name} must have numbers as probabilities; it has {value!r}") from None


def policy_table(policy: PolicyLike, mdp: Sized, name: str) -> Any:
    """A policy in one of these forms as (S0, A) or (S, A); any other, an array among them, as it is.

    Raises
    ------
    ValueError
        A state or an action that the MDP has not (with the nearest), a state without an action that is not over, what is
        neither an action nor a distribution.
    """
    if isinstance(policy, str | bytes | int | np.integer) or policy is None:
        hint = f"the same in every state: lambda state: {policy!r:.40}; a file: numpy.load"
        if policy in ("uniform", "optimal"):
            hint = f"oee.{policy}_policy(simulator)"
        raise ValueError(
            f"{name} must be an action, or a distribution, for each of the {mdp.n_states} states; it is {policy!r:.80} ({hint})"
        )
    if is_labelled(policy):
        policy = labelled_policy(policy, mdp, name)
    if isinstance(policy, Mapping):
        return _of_mapping(policy, mdp, name)
    if callable(policy) and not hasattr(policy, "__array__"):
        return _of_function(policy, mdp, name)
    return _of_actions(policy, mdp, name)


def is_policy_by_state(policies: Mapping[Any, object], mdp: Sized) -> bool:
    """Whether a mapping is one policy, state -> action or distribution, and not name -> policy."""
    known = numbers_of(names_of(mdp).states or ())
    return bool(policies) and all(
        (plain(key) in known or _checks.is_integer(key)) and not (callable(value) or _depth(value) >= 2)
        for key, value in policies.items()
    )


def are_several(policies: object, mdp: Sized) -> bool:
    """Whether a list holds policies, and is not one: an action, or a row, a state."""
    if not isinstance(policies, list | tuple) or not policies:
        return isinstance(policies, list | tuple)
    first, sizes = policies[0], (mdp.n_states, len(mdp.terminal_state))
    if callable(first) or isinstance(first, Mapping) or _depth(first) >= 2:
        return True
    one = (len(policies) in sizes) and _depth(first) == 1 and len(first) == mdp.n_actions
    return _depth(first) == 1 and len(first) in sizes and not one


def changes_with_time(policy: PolicyLike | None) -> bool:
    """Whether a policy is (T, S, A)."""
    return _depth(policy) == 3


def _depth(value: Any) -> int:
    """The dimensions of what is an array; 0 of anything else."""
    try:
        return 0 if isinstance(value, Mapping) else int(np.ndim(value))
    except (TypeError, ValueError):
        return 0


def _of_actions(policy: PolicyLike, mdp: Sized, name: str) -> Any:
    """One action a state, by number or name."""
    called, sizes = names_of(mdp).actions, (mdp.n_states, len(mdp.terminal_state))
    items: Any = _tuples(policy, called, mdp.n_actions)
    if items is None:
        try:
            items = np.asarray(policy)
        except (TypeError, ValueError):
            return policy
        if items.ndim != 1 or len(items) not in sizes or items.dtype.kind not in "iuUO":
            return policy
        if items.dtype.kind in "UO" and not all(isinstance(item, str) for item in items):
            return policy
    if len(items) not in sizes:
        return policy
    if isinstance(items, np.ndarray) and items.dtype.kind in "iu":
        bad = np.flatnonzero((items < 0) | (items >= mdp.n_actions))
        if bad.size:
            raise ValueError(f"{name}[{bad[0]}] must be in 0..{mdp.n_actions - 1}; it is {items[bad[0]]}")
        chosen = items.astype(np.int64)
    else:
        chosen = np.array(
            [number_of(a, called, mdp.n_actions, f"{name}[{s}]", "the MDP's") for s, a in enumerate(items)]
        )
    return deterministic_policy(chosen, mdp.n_actions)


def deterministic_policy(actions: IntArray, n_actions: int) -> Array:
    """The (S, A) policy that takes ``actions[s]`` in state s."""
    policy = np.zeros((len(actions), n_actions))
    policy[np.arange(len(actions)), actions] = 1.0
    return policy


def _tuples(policy: PolicyLike, names: tuple[Name, ...] | None, n_actions: int) -> list[Any] | None:
    """A list of the tuples that actions are called; None for anything else, rows of probabilities among it."""
    if not isinstance(policy, list | tuple) or names is None:
        return None
    known = numbers_of(names)
    if not all(isinstance(item, tuple) and is_name(item) and item in known for item in policy):
        return None
    return (
        None
        if all(len(item) == n_actions and _depth(item) == 1 and not _texts(item) for item in policy)
        else list(policy)
    )


def _texts(item: tuple[object, ...]) -> bool:
    return any(isinstance(part, str) for part in item)


def _of_mapping(policy: Mapping[Any, object], mdp: Sized, name: str) -> Array:
    called = names_of(mdp)
    rows: dict[int, Array] = {}
    for state, choice in policy.items():
        s = number_of(state, called.states, mdp.n_states, f"{name}'s state", "the MDP's")
        if s in rows:
            raise ValueError(f"{name}'s states must differ; state {called.state(s)} is given twice")
        rows[s] = _row(choice, mdp, called, f"{name}[{state!r}]")
    own = len(mdp.terminal_state)
    table = np.full((mdp.n_states, mdp.n_actions), 1.0 / mdp.n_actions)
    missing = [s for s in range(own) if s not in rows and not _over(mdp)[s]]
    if missing:
        more = f" ({len(missing)} such states in all)" if len(missing) > 1 else ""
        raise ValueError(
            f"{name} must have every state in which a task is not over; state {called.state(missing[0])} is not there{more}"
        )
    for s, row in rows.items():
        table[s] = row
    return table


def _of_function(policy: Callable[[Any], Any], mdp: Sized, name: str) -> Array:
    called, over = names_of(mdp), _over(mdp)
    states: Iterable[object] = range(mdp.n_states) if called.states is None else called.states
    table = np.full((len(mdp.terminal_state), mdp.n_actions), 1.0 / mdp.n_actions)
    for s, state in zip(range(len(table)), states, strict=False):
        try:
            choice = policy(state)
        except Exception as error:
            raise ValueError(
                f"{name}({state!r}) must be an action or a distribution; it raises {type(error).__name__}: {error}"
            ) from error
        if choice is not None or not over[s]:
            table[s] = _row(choice, mdp, called, f"{name}({state!r})")
    return table


def _over(mdp: Sized) -> _checks.BoolArray:
    """The states in which any action does."""
    absorbing = getattr(mdp, "absorbing", None)
    return np.zeros(mdp.n_states, dtype=np.bool_) if absorbing is None else np.asarray(absorbing())


def _row(choice: Any, mdp: Sized, names: Names, name: str) -> Array:
    """An action, a mapping action -> probability, or A probabilities, as (A,)."""
    row = np.zeros(mdp.n_actions)
    if isinstance(choice, Mapping):
        for action, probability in choice.items():
            a = number_of(action, names.actions, mdp.n_actions, f"{name}'s action", "the MDP's")
            row[a] += _checks.number_in(probability, f"{name}[{action!r}]", 0.0, 1.0)
    elif _checks.is_integer(given := plain(choice)) or (isinstance(choice, str | tuple) and _is_action(given, names)):
        row[number_of(given, names.actions, mdp.n_actions, name, "the MDP's")] = 1.0
    else:
        shape = np.shape(choice) if _depth(choice) else ()
        if shape != (mdp.n_actions,):
            raise ValueError(
                f"{name} must be an action, or a distribution over the {mdp.n_actions} actions; it is {choice!r:.80}"
            )
        row = _checks.float_array(choice, name, ndim=1)
        _checks.require_nonnegative(row, name)
        row = _checks.scaled_if_single(row, choice)
    _checks.require_sums_to_one(np.asarray(row.sum()), name)
    return row


def _is_action(given: object, names: Names) -> bool:
    """A text is to be an action; a tuple where it is one's name, else it is probabilities."""
    return isinstance(given, str) or (is_name(given) and given in numbers_of(names.actions or ()))

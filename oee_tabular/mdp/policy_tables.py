"""Policies as tables of pandas, or of a file: state -> action -> probability, states and actions by name or number."""

from __future__ import annotations

from typing import Any, Protocol

from oee_tabular._checks import IntArray
from oee_tabular.mdp.naming import names_of, numbers_of

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
    actions = {label: _item(label) for label in labels if label != "state"}
    wide = "action" not in labels and all(item in known or _in_range(item, mdp.n_actions) for item in actions.values())
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


def _item(label: object) -> Any:
    """A column's action: a number, or a name."""
    return int(label) if isinstance(label, str) and label.isdigit() else label


def _in_range(item: object, n_actions: int) -> bool:
    return isinstance(item, int) and 0 <= item < n_actions


def _number(value: Any, name: str) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        raise ValueError(f"{name} must have numbers as probabilities; it has {value!r}") from None

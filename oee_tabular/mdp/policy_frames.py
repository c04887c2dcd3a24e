"""Calls of pandas that make a mapping or an array of a policy in a DataFrame."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from oee_tabular import _checks
from oee_tabular.mdp.naming import Name, Names, numbers_of, to_plain

BY_LABELS = "of a row for each state, an action a column: "
IN_ORDER = "in the order of the states: "


def number_actions(labels: Sequence[Any]) -> dict[Any, int]:
    """Return the numbers of actions that labels such as action_0 mean, or nothing.

    The labels are one word with the numbers 0, 1, ... or 1, 2, ... at its end. Labels
    without a number may stand among them.

    >>> number_actions(["a1", "a2", "note"]), number_actions(["a1", "b2"])
    ({'a1': 0, 'a2': 1}, {})
    """
    ends: dict[str, dict[Any, int]] = {}
    for label in labels:
        match = re.fullmatch(r"(.*\D)(\d{1,6})\]?", str(label))
        if match:
            ends.setdefault(match[1], {})[label] = int(match[2])
    if len(ends) != 1:
        return {}
    found = next(iter(ends.values()))
    first = min(found.values())
    expected = range(first, first + len(found))
    if first > 1 or sorted(found.values()) != list(expected) or len(found) < 2:
        return {}
    return {label: number - first for label, number in found.items()}


def suggest_conversions(
    policy: Any, names: Names, n_states: int, n_actions: int
) -> str:
    """Return the calls that make a policy of a frame of pandas, in words.

    Each of them gives what is accepted, as far as the frame's labels tell.
    """
    if getattr(policy, "ndim", 2) == 1:
        return _convert_series(policy, names, n_states)
    columns = list(policy.columns)
    if "state" in columns and "action" in columns:
        return _convert_long(policy)
    call = "policy"
    states = list(policy.index)
    if "state" in columns:
        columns.remove("state")
        states = list(policy["state"])
        call += '.set_index("state")'
    renamed = []
    if _are_number_texts(states, names.states, n_states):
        renamed.append("index=int")
    if _are_number_texts(columns, names.actions, n_actions):
        renamed.append("columns=int")
    numbers = _find_numbers(columns, names.actions, n_actions)
    numbered = number_actions(columns)
    if numbers is None and len(numbered) == len(columns) == n_actions:
        numbers = list(numbered.values())
        renamed.append(f"columns={numbered}")
    if renamed:
        call += f".rename({', '.join(renamed)})"
    call += _as_floats(policy[columns])
    ways = []
    # labels that are unknown have a refusal of their own, where there are names
    if numbers is not None or names.actions:
        ways.append(f'{BY_LABELS}{call}.to_dict("index")')
    is_ordered = numbers is None or numbers == sorted(numbers)
    is_ordered &= _are_in_order(states, names.states, n_states)
    if is_ordered and len(columns) == len(policy.columns):
        ways.append(f"{IN_ORDER}policy{_as_floats(policy)}.to_numpy()")
    return "; ".join(ways) or f'{BY_LABELS}{call}.to_dict("index")'


def _convert_long(policy: Any) -> str:
    """Return the call for a frame with a row for each state, or for each pair."""
    call = "policy"
    texts = [label for label in ("state", "action") if _are_digits(list(policy[label]))]
    if texts:
        kinds = ", ".join(f'"{label}": int' for label in texts)
        call += f".astype({{{kinds}}})"
    if "probability" not in policy.columns:
        return f'by its columns: {call}.set_index("state")["action"].to_dict()'
    call += '.pivot(index="state", columns="action", values="probability").fillna(0)'
    call += _as_floats(policy[["probability"]])
    return f'by its columns: {call}.to_dict("index")'


def _convert_series(policy: Any, names: Names, n_states: int) -> str:
    """Return the calls for a series of actions, or of probabilities by pair."""
    labels = list(policy.index)
    are_pairs = getattr(policy.index, "nlevels", 1) == 2
    if are_pairs and _find_numbers(labels, names.states, n_states) is None:
        return 'by its labels: policy.unstack(fill_value=0).to_dict("index")'
    actions = policy.tolist()
    call = "policy"
    are_floats = all(isinstance(action, float) for action in actions)
    if _are_digits(actions) or (are_floats and all(a % 1 == 0 for a in actions)):
        call = "policy.astype(int)"
    by_labels = call
    if _are_number_texts(labels, names.states, n_states):
        by_labels += ".rename(index=int)"
    ways = f"by its labels: {by_labels}.to_dict()"
    if _are_in_order(labels, names.states, n_states):
        ways += f"; {IN_ORDER}{call}.to_numpy()"
    return ways


def _find_numbers(
    labels: Sequence[Any], names: tuple[Name, ...] | None, size: int
) -> list[int] | None:
    """Return the numbers of labels that are all names, numbers or texts of these."""
    known = numbers_of(names or ())
    numbers = []
    for label in map(to_plain, labels):
        number = known.get(label)
        if number is None and (_checks.is_integer(label) or _are_digits([label])):
            number = int(label)
        if number is None or not 0 <= number < size:
            return None
        numbers.append(number)
    return numbers


def _are_in_order(
    labels: Sequence[Any], names: tuple[Name, ...] | None, size: int
) -> bool:
    """Say whether labels are in the order of their numbers, or have none."""
    numbers = _find_numbers(labels, names, size)
    return numbers is None or numbers == sorted(numbers)


def _are_number_texts(
    labels: Sequence[Any], names: tuple[Name, ...] | None, size: int
) -> bool:
    """Say whether all labels are texts of numbers that are known."""
    return _are_digits(labels) and _find_numbers(labels, names, size) is not None


def _are_digits(labels: Sequence[Any]) -> bool:
    """Say whether all labels are texts of digits."""
    return all(isinstance(label, str) and label.isdecimal() for label in labels)


def _as_floats(frame: Any) -> str:
    """Return the call that makes numbers of truth values and texts, or nothing."""
    kinds = [getattr(kind, "kind", "") for kind in frame.dtypes]
    return "" if all(kind in ("i", "u", "f") for kind in kinds) else ".astype(float)"

"""Policies in CSV tables: a row for each state and action, or for each state.

Labels are those of a log's tables (``data.aliases``); others are found by the names of
the simulator's states and actions that their columns hold.
"""

from __future__ import annotations

import difflib
import io
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from oee_tabular import _checks, _files
from oee_tabular.data.aliases import (
    POLICY_PROBABILITY,
    find_field,
    plain,
    resembles_probability,
)
from oee_tabular.data.labels import (
    show_labels,
    suggest_columns,
    suggest_label,
    warn_left_out,
    warn_read_as,
)
from oee_tabular.data.rules import (
    DECIMAL_POINT,
    Fault,
    as_objects,
    is_absent,
    is_missing,
    parse_flag,
    to_numbers,
)
from oee_tabular.data.tables import csv_frame, describe_row, read_labels
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import (
    FiniteMDP,
    Name,
    is_number_text,
    number_actions,
    numbers_of,
    suggest_name,
    to_plain,
)
from oee_tabular.typing import Array, BoolArray

RULE = (
    "must have the columns state and action, with probability or without, or state and"
    " one for each action, and at least one row"
)
PROBABILITY_RULE = (
    "must be a number from 0 to 1 (or true or false, where its whole column is)"
)
LABEL_OF_STATES = " (write the states in a column whose label is state)"
INDEX = re.compile(r"Unnamed: \d+|index|level_0|")  # as pandas calls its index

MAX_SHOWN = 3  # names and labels in an error
# of names that are compared letter by letter, which takes .1 s
MAX_COMPARED_TEXTS = 20
MAX_COMPARED_NAMES = 1000
NEAR_NAME = 0.7  # how like a name a misspelt one is, by difflib
ENDINGS = (".npy", ".csv")  # of the files that are written


class Columns(NamedTuple):
    """Hold the labels of a policy's table: state, action and probability.

    ``action`` is None where each action has a column; ``actions`` are then these.
    """

    state: Any
    action: Any
    probability: Any
    actions: tuple[Any, ...] = ()


def read_policy_table(path: str, mdp: FiniteMDP) -> dict[Any, Any]:
    """Read a policy by state from a CSV file, as ``check_policy`` takes it."""
    name = repr(path)
    require_commas(path)
    _require_label_of_states(path)
    frame = drop_index(csv_frame(path, has_flags=False))
    columns = _find_columns(frame, mdp, name)
    if columns is None or frame.empty:
        _refuse_misspelt_column(frame, mdp, path)
        raise ArgumentError(
            name,
            f"{RULE}; it has {show_labels(list(frame.columns))} and {len(frame)}"
            f" rows{_suggest(frame, mdp)}",
        )
    names = {columns.state: mdp.state_names, columns.action: mdp.action_names}
    for label in (columns.state, columns.action):
        if label is not None:
            frame[label] = _to_names(frame[label], name)
            _require_known(frame[label], names[label], path)
    if columns.action is None:
        return _read_wide(frame, columns, path)
    keys = ["state", "action"]
    table = frame[[columns.state, columns.action]].set_axis(keys, axis=1)
    if columns.probability is None:
        _require_once(table, keys[:1], name)
        return dict(zip(table["state"], table["action"], strict=True))
    _require_once(table, keys, name)
    numbers = read_probabilities(frame[columns.probability], path)
    policy: dict[Any, Any] = {}
    for state, action, number in zip(
        table["state"], table["action"], numbers, strict=True
    ):
        policy.setdefault(state, {})[action] = number
    return policy


def _read_wide(frame: Any, columns: Columns, path: str) -> dict[Any, Any]:
    """Read the policy of a table that has a column for each action."""
    name = repr(path)
    actions = [_to_action(label) for label in columns.actions]
    for label, action in zip(columns.actions, actions, strict=True):
        first = columns.actions[actions.index(action)]
        if first != label:
            raise ArgumentError(
                name,
                f"must have one column for each action; {_checks.show(first)} and"
                f" {_checks.show(label)} are both action {action}",
            )
    states = frame[[columns.state]].set_axis(["state"], axis=1)
    _require_once(states, ["state"], name)
    # an empty field of such a table is no probability
    numbers = [
        read_probabilities(frame[label], path, is_empty_zero=True)
        for label in columns.actions
    ]
    return {
        state: dict(zip(actions, row, strict=True))
        for state, row in zip(states["state"], np.transpose(numbers), strict=True)
    }


def write_pairs(
    path: Path, values: Array, mdp: FiniteMDP, label: str = "probability"
) -> None:
    """Write numbers of the state-action pairs, by default a policy's probabilities.

    A .npy file has the array of shape (S, A). A .csv file has the columns state, action
    and ``label``, and the simulator's names. The file appears complete or not at all.
    """
    if not _files.has_ending(path, (".csv",)):
        write_array(path, values)
        return
    import pandas as pd

    states = mdp.state_names or range(mdp.n_states)
    actions = mdp.action_names or range(mdp.n_actions)
    rows = [(str(state), str(action)) for state in states for action in actions]
    frame = pd.DataFrame(rows, columns=["state", "action"])
    frame[label] = np.asarray(values, dtype=np.float64).ravel()
    with _files.whole_file(path, (".csv",)) as handle:
        frame.to_csv(handle, index=False)


def write_array(path: Path, array: Array) -> None:
    """Write a .npy file, which appears complete or not at all."""
    # np.save to a file would lose the system's message about a full disk
    content = io.BytesIO()
    np.save(content, array, allow_pickle=False)
    with _files.whole_file(path, (".npy",)) as handle:
        handle.write(content.getbuffer())


def require_commas(path: str, own: Iterable[str] = ()) -> None:
    """Raise an ArgumentError where another sign than a comma parts the fields.

    ``own``: labels of columns, beside those that every table may have.
    """
    labels = read_labels(path)
    if len(labels) > 1:
        return
    known = ["state", "action", "probability", "next_state", "reward"]
    hint = suggest_columns([*known, *map(plain, own)], labels)
    if hint:
        raise ArgumentError(
            repr(path), f"must be a table of comma-separated values{hint}"
        )


def drop_index(frame: Any) -> Any:
    """Return a table without the index of pandas, a nameless column 0, 1, 2, ..."""
    for label in list(frame.columns)[:2]:
        values = frame[label].to_numpy()
        is_index = INDEX.fullmatch(str(label)) is not None
        is_index &= values.dtype.kind in "iu" and len(frame.columns) > 1
        if is_index and np.array_equal(values, np.arange(len(values))):
            frame = frame.drop(columns=label)
    return frame


def _find_columns(frame: Any, mdp: FiniteMDP, name: str) -> Columns | None:
    """Return which labels hold the state, the action and the probability."""
    labels = list(frame.columns)
    as_actions = [label for label in labels if _is_action(label, mdp)]
    others = [label for label in labels if label not in as_actions]
    state = _find_label(frame, others, "state", mdp)
    action = _find_label(
        frame, [each for each in others if each != state], "action", mdp
    )
    if state is None:
        return None
    if action is None:
        if not as_actions:
            return None
        left = [each for each in others if each != state]
        _settle(frame, mdp, left, name, renamed=[(state, "state")], has_all=False)
        return Columns(state, None, None, tuple(as_actions))
    left = [label for label in labels if label not in (state, action)]
    probability = _find_probability(left, name)
    left = [label for label in left if label != probability]
    if probability is None:
        _refuse_both_forms(frame, action, as_actions, name)
    renamed = [(state, "state"), (action, "action")]
    if probability is not None:
        renamed.append((probability, "probability"))
    _settle(frame, mdp, left, name, renamed=renamed, has_all=probability is not None)
    return Columns(state, action, probability)


def _find_probability(labels: list[Any], name: str) -> Any:
    """Return the label of the probabilities among these, or None.

    Raises an ArgumentError where several labels, or one that is misspelt, may be it.
    """
    found = [label for label in labels if plain(label) in POLICY_PROBABILITY]
    exact = [label for label in found if label == "probability"]
    if len(found) > 1 and not exact:
        raise ArgumentError(
            name,
            "must have one column of probabilities; it has"
            f" {' and '.join(map(_checks.show, found))} (call the one that is meant"
            " probability, and leave the other one out)",
        )
    if found:
        return (exact or found)[0]
    for label in labels:
        if resembles_probability(label):
            raise ArgumentError(
                name,
                "must have columns whose meaning is clear;"
                f" {_checks.show(label)} resembles probability (rename it so, or"
                " leave it out, where the policy always takes the actions)",
            )
    return None


def _refuse_both_forms(
    frame: Any, action: Any, as_actions: list[Any], name: str
) -> None:
    """Raise an ArgumentError for a column of actions beside a column for each action.

    ``as_actions``: labels that are actions. Their columns may hold something else, such
    as values of the actions, where not all of these are from 0 to 1.
    """
    both = [label for label in as_actions if _may_be_probabilities(frame[label])]
    if both:
        raise ArgumentError(
            name,
            "must have either a column action, or a column for each action; it has"
            f" {_checks.show(action)} and {show_labels(both)} (leave"
            f" {_checks.show(action)} out where the others hold the policy's"
            " probabilities, else leave the others out)",
        )


def _may_be_probabilities(column: Any) -> bool:
    """Say whether a column holds numbers from 0 to 1, or flags, and no more."""
    return not column.isna().all() and not _find_others(column)


def _find_others(column: Any) -> list[Any]:
    """Return the values of a column that are no probabilities and not empty."""
    bad = _parse_probabilities(column)[1] & ~column.isna().to_numpy()
    return list(column[bad])


def _find_label(frame: Any, labels: list[Any], field: str, mdp: FiniteMDP) -> Any:
    """Return the label of a column of states or actions, or None.

    It is its own, one of other projects, or that of a column of the simulator's names:
    of these alone, or else of these in most rows, where the others may be misspelt.
    """
    if field in labels:
        return field
    found = [label for label in labels if find_field(label, has_vectors=False) == field]
    names = mdp.state_names if field == "state" else mdp.action_names
    if not found and names:
        known = numbers_of(names)
        shares = {
            label: sum(value in known for value in frame[label]) / len(frame)
            for label in labels
            if len(frame) and frame[label].dtype.kind not in "biuf"
        }
        found = [label for label, share in shares.items() if share == 1.0]
        found = found or [label for label, share in shares.items() if share > 0.5]
    return found[0] if len(found) == 1 else None


def _settle(
    frame: Any,
    mdp: FiniteMDP,
    left: list[Any],
    name: str,
    *,
    renamed: list[tuple[Any, str]],
    has_all: bool,
) -> None:
    """Warn of labels that are read as others and of columns that are left out.

    Raises an ArgumentError where a column may hold the policy's probabilities, which it
    may not where the table ``has_all``.
    """
    if not has_all:
        _refuse_unclear(frame, left, list(mdp.action_names or ()), name)
    others = [pair for pair in renamed if pair[0] != pair[1]]
    warn_read_as(name, others, option="", of="policy")
    warn_left_out(repr(name.strip("'")), left, of="policy")


def _refuse_unclear(frame: Any, left: list[Any], actions: list[Any], name: str) -> None:
    """Raise an ArgumentError for a column that may hold the policy's probabilities.

    ``left``: the labels that have no meaning yet. ``actions``: names of actions, of
    which the nearest is suggested.
    """
    for label in left:
        if _may_be_probabilities(frame[label]):
            raise ArgumentError(
                name,
                "must have columns whose meaning is clear;"
                f" {_checks.show(label)} holds numbers from 0 to 1 (call it"
                " probability, or by the action's name, if these are the policy's, else"
                f" leave it out of the file){suggest_label(label, actions)}",
            )


def _to_action(label: Any) -> Any:
    """Return a label as an action's number where it writes one."""
    return int(label) if isinstance(label, str) and label.isdecimal() else label


def _suggest(frame: Any, mdp: FiniteMDP) -> str:
    """Return what is to be changed in a table that is no policy, in words."""
    labels = list(frame.columns)
    actions = list(mdp.action_names or ())
    others = [label for label in labels if not _is_action(label, mdp)]
    if labels and not others:
        return f"; the column of the states is missing{LABEL_OF_STATES}"
    state = _find_label(frame, others, "state", mdp)
    if state is None or "action" in labels:
        return (
            " (write state, action and probability as the labels of the columns that"
            " hold them)"
        )
    numbered = number_actions([label for label in others if label != state])
    if len(numbered) == mdp.n_actions:
        return f"; {_describe_numbers(numbered)}"
    for label in others:
        near = suggest_label(label, actions)
        if near and label != state:
            return f"; {_checks.show(label)} is no action{near}"
    return (
        " (write state, action and probability as the labels of the columns that hold"
        " them)"
    )


def _is_action(label: Any, mdp: FiniteMDP) -> bool:
    """Say whether a label is the name or the number of one of the simulator's actions."""
    action = _to_action(label)
    if isinstance(action, int):
        return action < mdp.n_actions
    return action in numbers_of(mdp.action_names or ())


def _describe_numbers(numbered: dict[Any, int]) -> str:
    """Say by which numbers to call the columns of actions, in words."""
    words = [f"{_checks.show(label)} {number}" for label, number in numbered.items()]
    if len(words) > MAX_SHOWN:
        words[MAX_SHOWN:] = ["..."]
    return f"call the columns by the actions' numbers: {', '.join(words)}"


def _require_label_of_states(path: str) -> None:
    """Raise an ArgumentError where all labels of a table are numbers.

    Its columns may be those of the actions, but nothing says which the states are.
    """
    labels = read_labels(path)
    if labels and all(map(is_number_text, labels)):
        raise ArgumentError(
            repr(path),
            f"{RULE}; the labels in its first line are {show_labels(labels)}, and the"
            f" column of the states is missing{LABEL_OF_STATES}",
        )


def _refuse_misspelt_column(frame: Any, mdp: FiniteMDP, path: str) -> None:
    """Raise an ArgumentError for a column that is found only by names like its own.

    Most of its names are nearly those of the simulator, but not these.
    """
    labels = [label for label in frame.columns if not _is_action(label, mdp)]
    for field, names in (("state", mdp.state_names), ("action", mdp.action_names)):
        if names is None or _find_label(frame, labels, field, mdp) is not None:
            continue
        known = [str(name) for name in names[:MAX_COMPARED_NAMES]]
        for label in labels:
            if find_field(label, has_vectors=False) is None and _resembles_names(
                frame[label], known
            ):
                _require_known(frame[label], names, path)


def _resembles_names(column: Any, names: list[str]) -> bool:
    """Say whether most of the first texts of a column are nearly some of the names."""
    texts = [value for value in column.unique() if isinstance(value, str)]
    texts = texts[:MAX_COMPARED_TEXTS]
    near = [
        bool(difflib.get_close_matches(text[:80], names, n=1, cutoff=NEAR_NAME))
        for text in texts
    ]
    return 2 * sum(near) > len(near)


def _require_known(column: Any, names: tuple[Name, ...] | None, path: str) -> None:
    """Raise an ArgumentError for texts that are none of the simulator's names.

    It has the first of them, each with the nearest name.
    """
    if names is None:
        return
    known = numbers_of(names)
    values = column.tolist()
    rows = [
        row
        for row, value in enumerate(values)
        if isinstance(value, str) and value not in known
    ]
    if not rows:
        return
    first, *others = dict.fromkeys(values[row] for row in rows)
    words = [
        f"{_checks.show(name)}{suggest_name(name, names)}"
        for name in others[: MAX_SHOWN - 1]
    ]
    more = f"; others that are not are {', '.join(words)}" if words else ""
    raise ArgumentError(
        _place(path, rows[0], column.name),
        f"must be one of the simulator's names; it is {_checks.show(first)}"
        f"{suggest_name(first, names)}{more}{_checks.in_all(len(rows), 'such rows')}",
    )


def _place(path: str, row: int, label: Any) -> str:
    """Return the place of a value, by its row, its line in the file and its column."""
    return f"{path!r}: {describe_row(path, row)}: column {_checks.show(label)}"


def _require_once(table: Any, keys: list[str], name: str) -> None:
    """Raise an ArgumentError where two rows have the same keys."""
    twice = table[table.duplicated(keys)]
    if len(twice):
        place = ", ".join(f"{key} {twice.iloc[0][key]}" for key in keys)
        raise ArgumentError(
            name, f"must have one row for each {' and '.join(keys)}; {place} has two"
        )


def _to_names(column: Any, name: str) -> Any:
    """Return states or actions, as a log's table has them: 1.0 is the integer 1."""
    lacking = np.flatnonzero(column.isna())
    if lacking.size:
        raise ArgumentError(
            name,
            f"must have a value in each row; {column.name}[{lacking[0]}] has none"
            f" ({lacking.size} such rows in all)",
        )
    if column.dtype.kind == "f" and (column % 1 == 0).all():
        return column.astype("int64")
    return column


def read_probabilities(column: Any, path: str, *, is_empty_zero: bool = False) -> Array:
    """Return a column of numbers, or one of truth values as 1 and 0.

    Raises an ArgumentError with the place of the first value that is neither.
    ``is_empty_zero``: whether an empty field is 0.
    """
    numbers, bad = _parse_probabilities(column)
    lacking = column.isna().to_numpy()
    if is_empty_zero:
        numbers = np.where(lacking, 0.0, numbers)
        bad &= ~lacking
    rows = np.flatnonzero(bad)
    if rows.size:
        value = to_plain(column.iloc[rows[0]])
        if is_absent(value):
            value = None
        fault = Fault(
            column.name, rows, PROBABILITY_RULE, value, _suggest_probability(value)
        )
        raise ArgumentError(
            _place(path, int(rows[0]), column.name),
            f"{fault.problem()}{_checks.in_all(len(rows), 'such rows')}",
        )
    return numbers


def _parse_probabilities(column: Any) -> tuple[Array, BoolArray]:
    """Return a column as numbers, and which of its values are no probabilities.

    All its values are numbers, or all are truth values; empty fields are nan.
    """
    raw = column.to_numpy()
    if raw.dtype.kind in "iuf":
        numbers = raw.astype(np.float64)
    else:
        numbers = _parse_texts(raw.tolist())
    return numbers, ~((numbers >= 0.0) & (numbers <= 1.0))


def _parse_texts(items: list[Any]) -> Array:
    """Return flags as 1 and 0 if all items are such, or else numbers; nan for others."""
    flags = [None if is_missing(item) else parse_flag(item) for item in items]
    are_flags = all(
        flag is not None or is_missing(item)
        for flag, item in zip(flags, items, strict=True)
    )
    if are_flags:
        return np.array([np.nan if flag is None else float(flag) for flag in flags])
    return np.asarray(to_numbers(as_objects(items)), dtype=np.float64)


def _suggest_probability(value: Any) -> str:
    """Return how to write the probability that a text means, in words."""
    text = value.strip() if isinstance(value, str) else ""
    percent = re.fullmatch(r"(\d+(?:\.\d*)?|\.\d+)\s*%", text)
    if percent:
        return f" (write {float(percent[1]) / 100:.12g} for {text:.20})"
    fraction = re.fullmatch(r"(\d{1,9})\s*/\s*(\d{1,9})", text)
    if fraction and int(fraction[2]):
        share = int(fraction[1]) / int(fraction[2])
        return f" (write {share!r} for {text:.20})"
    if re.fullmatch(r"\d+,\d+", text):
        return DECIMAL_POINT
    return ""


def describe_policy(path: str) -> str | None:
    """Return in words what policy a CSV file holds; None where it is none."""
    labels = [label for label in read_labels(path) if not INDEX.fullmatch(label)]
    fields = {label: find_field(label, has_vectors=False) for label in labels}
    of_log = set(fields.values()) - {None, "state", "action", "behavior_probability"}
    if of_log or len(labels) < 2:
        return None
    own = {field: label for label, field in fields.items() if field is not None}
    found = [label for label in labels if plain(label) in POLICY_PROBABILITY]
    others = [label for label in labels if label not in found]
    if found and len(others) == 2:
        own = {"state": others[0], "action": others[1]} | own
    if "action" in own and "state" in own:
        frame = drop_index(csv_frame(path, has_flags=False))
        return _describe_long(frame, own["state"], own["action"], path)
    if "state" not in own or own["state"] != labels[0]:
        return None
    return _describe_wide(drop_index(csv_frame(path, has_flags=False)), labels[0], path)


def _describe_long(frame: Any, state: Any, action: Any, path: str) -> str | None:
    """Describe a policy that has a column of actions; None where it is none.

    Raises an ArgumentError for what no simulator makes a policy.
    """
    left = [label for label in frame.columns if label not in (state, action)]
    has_label = any(plain(label) in POLICY_PROBABILITY for label in left)
    if not has_label and frame[state].duplicated().any():
        return None
    probability = _find_probability(left, repr(path))
    kind = "one action for each state"
    if probability is None:
        actions = {str(value) for value in frame[action]}
        as_actions = [label for label in left if label in actions or label.isdecimal()]
        _refuse_both_forms(frame, action, as_actions, repr(path))
        _refuse_unclear(frame, left, sorted(actions), repr(path))
    else:
        read_probabilities(frame[probability], path)
        kind = f"probabilities {probability!r}"
    return (
        f"policy: {len(frame)} rows of {frame[state].nunique()} states and"
        f" {frame[action].nunique()} actions, {kind}"
    )


def _describe_wide(frame: Any, state: Any, path: str) -> str | None:
    """Describe a policy that has a column for each action; None where it is none.

    Raises an ArgumentError for a value that is no probability, where the labels are
    the numbers of actions, or where the value is a percent or a fraction.
    """
    table = frame.drop(columns=state)
    labels = list(table.columns)
    if frame.empty or not labels:
        return None
    others = [value for label in labels for value in _find_others(table[label])]
    are_numbered = all(label.isdecimal() for label in labels)
    # percents and fractions are probabilities that are written in another way
    if others and not (are_numbered or all(map(_suggest_probability, others))):
        return None
    numbers = [
        read_probabilities(table[label], path, is_empty_zero=True) for label in labels
    ]
    if not bool((abs(np.sum(numbers, axis=0) - 1.0) < 1e-8).all()):
        return None
    text = (
        f"policy: {len(frame)} states, and a column for each of {len(labels)} actions,"
        f" {show_labels(labels)}"
    )
    numbered = number_actions(labels)
    if len(numbered) == len(labels):
        text += (
            "\nwhere the simulator's actions have no such names,"
            f" {_describe_numbers(numbered)}"
        )
    return text

"""Policies in CSV tables: a row for each state and action, or for each state.

Labels are those of a log's tables (``data.aliases``); others are found by the names of
the simulator's states and actions that their columns hold.
"""

from __future__ import annotations

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
from oee_tabular.data.tables import csv_frame, read_labels
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import FiniteMDP, numbers_of
from oee_tabular.typing import Array

RULE = (
    "must have the columns state and action, with probability or without, or state and"
    " one for each action, and at least one row"
)
INDEX = re.compile(r"Unnamed: \d+|index|level_0|")  # as pandas calls its index


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
    frame = drop_index(csv_frame(path, has_flags=False))
    columns = _find_columns(frame, mdp, name)
    if columns is None or frame.empty:
        raise ArgumentError(
            name,
            f"{RULE}; it has {show_labels(list(frame.columns))} and {len(frame)}"
            f" rows{_suggest(frame, mdp)}",
        )
    for label in (columns.state, columns.action):
        if label is not None:
            frame[label] = _to_names(frame[label], name)
    keys = ["state"]
    if columns.action is None:
        actions = [_to_action(label) for label in columns.actions]
        for label, action in zip(columns.actions, actions, strict=True):
            first = columns.actions[actions.index(action)]
            if first != label:
                raise ArgumentError(
                    name,
                    f"must have one column for each action; {_checks.show(first)} and"
                    f" {_checks.show(label)} are both action {action}",
                )
        wide = frame[[columns.state, *columns.actions]]
        wide = wide.set_axis(["state", *actions], axis=1)
        _require_once(wide, keys, name)
        table = wide.melt("state", var_name="action", value_name="probability")
        # an empty field of a table with a column for each action is no probability
        given = table["probability"].astype(object)
        table["probability"] = given.where(given.notna(), 0.0)
    else:
        own = [columns.state, columns.action]
        if columns.probability is not None:
            own.append(columns.probability)
            keys.append("action")
        table = frame[own].set_axis(
            ["state", "action", "probability"][: len(own)], axis=1
        )
        _require_once(table, keys, name)
        if columns.probability is None:
            return dict(zip(table["state"], table["action"], strict=True))
    numbers = _to_numbers(table["probability"], name)
    policy: dict[Any, Any] = {}
    rows = zip(table["state"], table["action"], numbers, strict=True)
    for state, action, number in rows:
        policy.setdefault(state, {})[action] = number
    return policy


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
    own_actions = {*numbers_of(mdp.action_names or ()), *range(mdp.n_actions)}
    as_actions = [label for label in labels if _to_action(label) in own_actions]
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
    found = [label for label in left if plain(label) in POLICY_PROBABILITY]
    exact = [label for label in found if label == "probability"]
    probability = (exact or found or [None])[0]
    if len(found) > 1 and not exact:
        raise ArgumentError(
            name,
            "must have one column of probabilities; it has"
            f" {' and '.join(map(_checks.show, found))} (call the one that is meant"
            " probability, and leave the other one out)",
        )
    left = [label for label in left if label != probability]
    if probability is None:
        for label in left:
            if resembles_probability(label):
                raise ArgumentError(
                    name,
                    "must have columns whose meaning is clear;"
                    f" {_checks.show(label)} resembles probability (rename it so, or"
                    " leave it out, where the policy always takes the actions)",
                )
    renamed = [(state, "state"), (action, "action")]
    if probability is not None:
        renamed.append((probability, "probability"))
    _settle(frame, mdp, left, name, renamed=renamed, has_all=probability is not None)
    return Columns(state, action, probability)


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
    for label in left:
        values = frame[label]
        is_number = values.dtype.kind in "iuf" and len(values) > 0
        if is_number and not has_all and values.between(0.0, 1.0).all():
            raise ArgumentError(
                name,
                "must have columns whose meaning is clear;"
                f" {_checks.show(label)} holds numbers from 0 to 1 (call it"
                " probability, or by the action's name, if these are the policy's, else"
                f" leave it out of the file){suggest_label(label, list(mdp.action_names or ()))}",
            )
    others = [pair for pair in renamed if pair[0] != pair[1]]
    warn_read_as(name, others, option="", of="policy")
    warn_left_out(repr(name.strip("'")), left, of="policy")


def _to_action(label: Any) -> Any:
    """Return a label as an action's number where it writes one."""
    return int(label) if isinstance(label, str) and label.isdecimal() else label


def _suggest(frame: Any, mdp: FiniteMDP) -> str:
    """Return what is to be changed in a table that is no policy, in words."""
    labels = list(frame.columns)
    actions = list(mdp.action_names or ())
    if "state" in labels and "action" not in labels:
        for label in labels:
            near = suggest_label(label, actions)
            if near and label not in actions and label != "state":
                return f"; {_checks.show(label)} is no action{near}"
    return (
        " (write state, action and probability as the labels of the columns that hold"
        " them)"
    )


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


def _to_numbers(column: Any, name: str) -> Any:
    """Return probabilities as floats."""
    try:
        return column.astype(float)
    except (TypeError, ValueError) as error:
        texts = [value for value in column if isinstance(value, str)]
        hint = ""
        if any(text.strip().endswith("%") for text in texts):
            hint = " (write 0.1 for 10%)"
        elif any(re.fullmatch(r"\s*\d+,\d+\s*", text) for text in texts):
            hint = " (write a decimal point, not a comma)"
        raise ArgumentError(
            name, f"must have numbers as probabilities; {error}{hint}"
        ) from None


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
        frame = csv_frame(path)
        state, action = own["state"], own["action"]
        if not found and frame[state].duplicated().any():
            return None
        kind = f"probabilities {found[0]!r}" if found else "one action for each state"
        return (
            f"policy: {len(frame)} rows of {frame[state].nunique()} states and"
            f" {frame[action].nunique()} actions, {kind}"
        )
    if "state" not in own or own["state"] != labels[0]:
        return None
    frame = drop_index(csv_frame(path))
    table = frame.drop(columns=labels[0])
    is_numbers = all(table[label].dtype.kind in "biuf" for label in table)
    is_policy = is_numbers and bool((abs(table.sum(axis=1) - 1.0) < 1e-8).all())
    if is_policy and not frame.empty:
        return (
            f"policy: {len(frame)} states, and a column for each of"
            f" {table.shape[1]} actions, {show_labels(list(table.columns))}"
        )
    return None

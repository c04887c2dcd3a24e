"""Simulators from CSV tables of samples, or of transitions with probabilities."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

import oee_tabular as oee  # whose rooms are imported on use
from oee_tabular import _checks
from oee_tabular._arguments import is_whole_number, whole_number
from oee_tabular.cli.transition_tables import (
    COLUMNS,
    ENDS,
    FIELDS,
    PROBABILITY,
    describe_missing,
    find_label,
    find_missing,
    read_transition_table,
)
from oee_tabular.exceptions import ArgumentError

SUM_TOLERANCE = 1e-6  # of the probabilities of a state and action
FEW_STATES = 5  # that are named of those where episodes start or are over
TABLES = (".csv", ".csv.gz", ".parquet", ".tsv", ".txt", ".xlsx")


def is_table(spec: str) -> bool:
    """Say whether a simulator's name is that of a table's file."""
    return spec.lower().endswith(TABLES)


def refuse_table(spec: str) -> None:
    """Raise an ArgumentError where a simulator is named by the file of a table."""
    if is_table(spec):
        file = f"./{spec}" if spec.startswith("-") else spec
        columns = _write_column_options(spec)
        raise ArgumentError(
            "--simulator",
            f"must be a task, an environment or a saved FiniteMDP (.npz); {spec!r} is a"
            f" table (of samples, or with a column probability: oee export"
            f" {shlex.quote(file)}{columns}"
            " --initial STATE --discount G --output simulator.npz; in Python, of"
            " samples: log = Transitions.load(path); FiniteMDP.from_log(log,"
            " initial=STATE, discount=G).save('simulator.npz'))",
        )


def _write_column_options(spec: str) -> str:
    """Return the options that say which columns of a table are which.

    Empty where there are none to say, and where a table needs more than other names.
    """
    from oee_tabular.data.labels import suggest_columns
    from oee_tabular.data.tables import read_labels

    if not spec.lower().endswith((".csv", ".csv.gz")):
        return ""
    try:
        labels = read_labels(spec)
    except (ArgumentError, OSError):
        return ""
    known = {find_label(field, labels, {}) for field in COLUMNS}
    free = [label for label in labels if label and label not in known]
    missing = find_missing(labels, {}, (*FIELDS[:3], "reward"))
    if missing and missing[-1] == "reward" and len(free) < len(missing):
        missing.pop()  # it may be in no column
    has_vectors = any(re.fullmatch(r"(next_)?state_\d+", label) for label in labels)
    if has_vectors or len(free) < len(missing) or suggest_columns(FIELDS[:3], labels):
        return ""
    options = "".join(f" --column {field}=LABEL" for field in missing)
    if options and PROBABILITY not in labels and len(free) > len(missing):
        options += f" [--column {PROBABILITY}=LABEL]"
    return options


def read_simulator(
    path: str, columns: Mapping[str, Any], initial: str | None, discount: float | None
) -> oee.FiniteMDP:
    """Make a simulator of a table: of samples, or of transitions with probabilities.

    Parameters
    ----------
    path : str
        The file.
    columns : mapping
        What it calls the columns of a log, and probability. None for probability says
        that each row is a sample.
    initial : str, optional
        The first state, by name or number. Samples with episodes say it themselves.
    discount : float, optional
        The discount, 0.99 by default.

    Returns
    -------
    FiniteMDP
        The frequencies of the samples, or the probabilities of the table.
    """
    from oee_tabular.data.tables import read_labels

    start: Any = initial
    if initial is not None and is_whole_number(initial):
        start = whole_number(initial, "--initial")
    gamma = 0.99 if discount is None else discount
    is_read = path.lower().endswith((".csv", ".csv.gz", ".parquet"))
    labels = read_labels(path) if is_read and Path(path).is_file() else []
    if not _has_probabilities(path, labels, columns):
        own = dict(columns)
        if own.pop(PROBABILITY, "") is None:
            # frequencies have no use for the probabilities of a log's actions either
            own.setdefault("behavior_probability", None)
        log = load_samples(path, own)
        if log.reward is None:
            has = describe_missing(labels, ["reward"], own) if labels else "none"
            raise ArgumentError(
                repr(path), f"must have rewards, to be a simulator; it has {has}"
            )
        _require_every_reward(path, log.reward)
        if start is None and log.episode is None:
            _require_initial(path)
        return oee.FiniteMDP.from_log(log, discount=gamma, initial=start)
    if start is None:
        _require_initial(path)
    arguments = read_transition_table(path, columns).to_arguments(start)
    return oee.FiniteMDP(discount=gamma, **arguments)


def _require_every_reward(path: str, reward: Any) -> None:
    """Raise an ArgumentError for the first row of samples that has no reward."""
    from oee_tabular.data.tables import describe_row

    lacking = np.flatnonzero(np.isnan(reward))
    if not lacking.size:
        return
    k = int(lacking[0])
    is_csv = path.lower().endswith((".csv", ".csv.gz"))
    row = describe_row(path, k) if is_csv else f"row {k}"
    raise ArgumentError(
        f"{path!r}: {row}: reward",
        "must have a value in each row, to be a simulator; it has none"
        f"{_checks.in_all(lacking.size, 'such rows')} (write the reward that the"
        " simulator gave, 0 where it gave none)",
    )


def _has_probabilities(
    path: str, labels: list[str], columns: Mapping[str, Any]
) -> bool:
    """Return whether a table has a column of probabilities, or else holds samples.

    Raises an ArgumentError for a label that may be another spelling of probability, and
    for a column that sums to 1 as probabilities do, as the rows of a table without it
    would be samples.
    """
    from oee_tabular.data.aliases import (
        DOUBTS,
        POLICY_PROBABILITY,
        find_field,
        plain,
        resembles_probability,
    )

    if PROBABILITY in columns:
        return columns[PROBABILITY] is not None
    if any(plain(label) in POLICY_PROBABILITY for label in labels):
        return True
    used: set[Any] = set()
    for given in columns.values():
        used.update(given if isinstance(given, tuple) else (given,))
    unknown = []
    for label in labels:
        is_known = label in used or plain(label) in DOUBTS
        is_known |= find_field(label, has_vectors=False) is not None
        if not is_known and resembles_probability(label):
            _ask_after(path, label, f"resembles {PROBABILITY}")
        if not is_known and label:
            unknown.append(label)
    pair: list[Any] = []
    for field in FIELDS[:2]:
        found = find_label(field, labels, columns)
        pair += found if isinstance(found, tuple) else (found,)
    for label in _find_sums_of_one(path, pair, unknown):
        _ask_after(path, label, "sums to 1 for each state and action, as probabilities")
    return False


def _ask_after(path: str, label: str, why: str) -> NoReturn:
    """Raise an ArgumentError for a column that may be the probability."""
    word = _checks.escape_controls(shlex.quote(f"{PROBABILITY}={label:.80}"))
    raise ArgumentError(
        repr(path),
        f"must have columns whose meaning is clear; {_checks.show(label)} {why} (to read"
        f" it: --column {word}; to leave it out, where each row is a sample: --column"
        f" {PROBABILITY}=)",
    )


def _find_sums_of_one(path: str, pair: list[Any], labels: list[str]) -> Iterator[str]:
    """Yield the labels of columns that sum to 1 over the rows of each pair.

    ``pair`` are the labels of states and actions. A column of ones and zeros is none:
    flags of single rows would be. Nothing is found in a table that has other faults, of
    which the reader of samples tells.
    """
    from oee_tabular.data.tables import csv_frame

    is_csv = path.lower().endswith((".csv", ".csv.gz"))
    if None in pair or not labels or not is_csv:
        return
    try:
        frame = csv_frame(path)
    except ArgumentError:
        return
    if not {*pair, *labels} <= set(frame.columns) or frame[pair].isna().any(axis=None):
        return
    keys = [frame[column] for column in pair]
    for label in labels:
        values = frame[label]
        if values.dtype.kind != "f" or not values.between(0.0, 1.0).all():
            continue
        sums = values.groupby(keys).sum()
        if values.isin((0.0, 1.0)).all() or (abs(sums - 1.0) > SUM_TOLERANCE).any():
            continue
        yield label


def load_samples(files: Any, columns: Mapping[str, Any]) -> Any:
    """Load a log; an error says of a single file which columns a simulator's has."""
    try:
        return oee.Transitions.load(files, columns=columns)
    except ArgumentError as error:
        paths = [files] if isinstance(files, str) else files
        # errors of other kinds know better what is wrong
        is_of_names = "(say which column holds " in error.rule
        if len(paths) > 1 or not is_of_names or " looks like the header" in error.rule:
            raise
        _name_missing(paths[0], columns, error)
        raise


def _name_missing(path: str, columns: Mapping[str, Any], error: ArgumentError) -> None:
    """Raise an ArgumentError that names each missing column of a .csv file.

    Where a change of the file is what helps (other separators, other spellings), the
    reader's ``error`` says so already.
    """
    from oee_tabular.data.labels import suggest_columns
    from oee_tabular.data.tables import read_labels

    if not path.lower().endswith((".csv", ".csv.gz")) or not Path(path).is_file():
        return
    labels = read_labels(path)
    if any(label not in labels for label in columns.values()):
        return  # several columns to a state, or none
    missing = find_missing(labels, columns, FIELDS[:3])
    if not missing or suggest_columns(FIELDS[:3], labels):
        return
    lacks = find_missing(labels, columns, FIELDS[3:])
    more = "has probability and reward as well"
    if lacks:
        words = " ".join(f"--column {field}=LABEL" for field in lacks)
        more += f" ({words})"
    of_policy = {2: "state and action", 3: "state, action and probability"}
    n_labels = len([label for label in labels if label])
    if n_labels in of_policy:
        more += f", a policy's has {of_policy[n_labels]}"
    raise ArgumentError(
        repr(path),
        f"must have the columns {', '.join(FIELDS[:3])}; it has"
        f" {describe_missing(labels, missing, columns)}; a simulator's table,"
        f" for oee export, {more}",
    ) from error


def _require_initial(path: str) -> None:
    """Raise an ArgumentError where nothing says where episodes start."""
    raise ArgumentError(
        "--initial",
        f"must be given: {path!r} does not say where episodes start (--initial STATE)",
    )


def describe_table(path: str, columns: Mapping[str, Any]) -> str | None:
    """Return in words what a simulator's table holds; None where a file is none.

    It has state, action, next_state and a column of probabilities, and none that a log
    alone has. Raises an ArgumentError where it breaks a rule of such tables, unless its
    label says that the probabilities are those of a log's actions.
    """
    label = _find_probabilities(path, columns)
    if label is None:
        return None
    from oee_tabular.data.aliases import find_field
    from oee_tabular.data.tables import read_labels

    is_named = PROBABILITY in columns
    is_of_actions = find_field(label, has_vectors=False) == "behavior_probability"
    labels = read_labels(path)
    has_rewards = find_label("reward", labels, columns) in labels
    try:
        table = read_transition_table(path, columns, has_rewards=has_rewards)
    except ArgumentError as error:
        if is_named:
            raise
        if is_of_actions:
            return None
        word = _checks.escape_controls(shlex.quote(f"behavior_probability={label:.80}"))
        raise ArgumentError(
            error.argument,
            f"{error.rule}; if the file is a log, and {_checks.show(label)} the"
            f" probability of the action that was taken: --column {word}",
        ) from None
    rows = table.outcomes
    n_states = len(np.union1d(rows.state, rows.next_state))
    lacking = "" if has_rewards else ", once it has a column reward"
    return (
        f"table of a simulator: {len(rows.state)} transitions of {n_states} states and"
        f" {len(np.unique(rows.action))} actions with probabilities"
        f" ({_checks.show(label)}), which sum to 1 for each state and action; no"
        f" log\nto evaluate with it{lacking}: oee export {shlex.quote(path)} --initial"
        f" STATE --discount G --output simulator.npz{_repeat_columns(columns)}"
    )


def _find_probabilities(path: str, columns: Mapping[str, Any]) -> str | None:
    """Return the label of the probabilities of a simulator's table, by labels alone.

    None where the labels are not those of such a table.
    """
    from oee_tabular.data.aliases import find_field
    from oee_tabular.data.tables import read_labels

    is_read = path.lower().endswith((".csv", ".csv.gz", ".parquet"))
    if not is_read or columns.keys() - set(COLUMNS):
        return None
    if columns.get(PROBABILITY, "") is None:  # left out, so that rows are samples
        return None
    labels = read_labels(path)
    own = [find_label(field, labels, columns) for field in FIELDS[:4]]
    if not set(own) <= set(labels) or len(set(own)) < len(own):
        return None
    others = {find_field(each, has_vectors=False) for each in labels if each not in own}
    of_table = {None, "reward"}
    if PROBABILITY in columns or find_field(own[3], has_vectors=False) is None:
        of_table.update(ENDS)
    # beside probabilities of a log's actions, ends of tasks are those of a log too
    if others - of_table:
        return None
    return str(own[3])


def _repeat_columns(columns: Mapping[str, Any]) -> str:
    """Return the options that name columns as they were given."""
    words = [
        shlex.quote(f"{field}={'' if label is None else label}")
        for field, label in columns.items()
    ]
    return "".join(f" --column {_checks.escape_controls(word)}" for word in words)


def describe_ends(mdp: oee.FiniteMDP) -> str:
    """Return in words where episodes of a table's simulator start and are over."""
    starts = _list_states(mdp, np.flatnonzero(mdp.initial > 0))
    ends = np.flatnonzero(mdp.absorbing())
    text = f"episodes start in {starts}; "
    if not ends.size:
        return f"{text}no state is terminal"
    are, back = ("is", "it") if ends.size == 1 else ("are", "the same state")
    text += (
        f"{_list_states(mdp, ends)} {are} terminal: every action leads back to {back}"
        " with reward 0"
    )
    twins = mdp.terminal_state != np.arange(len(mdp.terminal_state))
    twin = np.flatnonzero(twins)
    if twin.size:
        entered = _list_states(mdp, twin)
        after = _list_states(mdp, mdp.terminal_state[twin])
        text += f"; a transition that ends the task in {entered} leads to {after}"
    return text


def _list_states(mdp: oee.FiniteMDP, states: Any) -> str:
    """Return the names or numbers of states in words, of many only the first ones."""
    names = [
        str(k) if mdp.state_names is None else str(mdp.state_names[k])
        for k in states[:FEW_STATES].tolist()
    ]
    more = len(states) - len(names)
    return ", ".join(names) + (f" and {more} other states" if more else "")

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
from oee_tabular.exceptions import ArgumentError, DataWarning

SUM_TOLERANCE = 1e-6  # of the probabilities of a state and action
ROUNDING = 0.01  # by which a sum of probabilities that were rounded may be off
PROBABILITY = "probability"
FIELDS = ("state", "action", "next_state", PROBABILITY, "reward")
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
    known = {_find_label(field, labels, {}) for field in FIELDS}
    free = [label for label in labels if label and label not in known]
    missing = _find_missing(labels, {}, (*FIELDS[:3], "reward"))
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
            has = _describe_missing(labels, ["reward"], own) if labels else "none"
            raise ArgumentError(
                repr(path), f"must have rewards, to be a simulator; it has {has}"
            )
        _require_every_reward(path, log.reward)
        if start is None and log.episode is None:
            _require_initial(path)
        return oee.FiniteMDP.from_log(log, discount=gamma, initial=start)
    if start is None:
        _require_initial(path)
    arguments = _read_probabilities(path, columns)
    return oee.FiniteMDP(initial=start, discount=gamma, **arguments)


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
        found = _find_label(field, labels, columns)
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
    missing = _find_missing(labels, columns, FIELDS[:3])
    if not missing or suggest_columns(FIELDS[:3], labels):
        return
    lacks = _find_missing(labels, columns, FIELDS[3:])
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
        f" {_describe_missing(labels, missing, columns)}; a simulator's table,"
        f" for oee export, {more}",
    ) from error


def _find_missing(
    labels: list[Any], columns: Mapping[str, Any], fields: tuple[str, ...]
) -> list[str]:
    """Return which of the fields no column of a table holds."""
    return [
        field for field in fields if _find_label(field, labels, columns) not in labels
    ]


def _describe_missing(
    labels: list[Any], missing: list[str], columns: Mapping[str, Any]
) -> str:
    """Return in words what a table has, what it lacks, and the options that help."""
    from oee_tabular.data.labels import show_labels, suggest_label

    known = {_find_label(field, labels, columns) for field in FIELDS}
    free = [label for label in labels if label not in known]
    names = []
    for field in missing:
        name = columns.get(field) or field
        names.append(f"{name}{suggest_label(name, free)}")
    words = " ".join(f"--column {field}=LABEL" for field in missing)
    lacking = " or ".join([", ".join(names[:-1]), names[-1]] if names[1:] else names)
    return f"{show_labels(labels)}, and none is {lacking} ({words})"


def _require_initial(path: str) -> None:
    """Raise an ArgumentError where nothing says where episodes start."""
    raise ArgumentError(
        "--initial",
        f"must be given: {path!r} does not say where episodes start (--initial STATE)",
    )


def _read_probabilities(path: str, columns: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of a FiniteMDP from a table of its transitions.

    A state that no row leaves is terminal.
    """
    from oee_tabular.data.tables import describe_row
    from oee_tabular.mdp import csr_from_entries

    state, action, following, probability, reward = _read_columns(path, columns)
    number, states = _number(np.concatenate([state, following]))
    codes, actions = _number(action)
    n = len(state)
    n_states = int(number.max()) + 1
    n_actions = int(codes.max()) + 1
    rows = number[:n] * n_actions + codes
    to = number[n:]
    twice = np.flatnonzero(_is_repeated(rows * n_states + to))
    if twice.size:
        k = int(twice[0])
        raise ArgumentError(
            f"{path!r}: {describe_row(path, k)}",
            "must be the only one of its state, action and next_state;"
            f" {state[k]}, {action[k]}, {following[k]} has another",
        )
    ends = np.setdiff1d(np.arange(n_states), number[:n])
    if states is not None:
        _warn_of_misspelt(path, number, ends, states)
    loops = (ends[:, None] * n_actions + np.arange(n_actions)).ravel()
    shape = (n_states * n_actions, n_states)
    rows = np.concatenate([rows, loops])
    to = np.concatenate([to, np.repeat(ends, n_actions)])
    zeros = np.zeros(len(loops))
    _require_every_action(path, rows, n, states, actions, (n_states, n_actions))
    sums = np.bincount(rows[:n], probability)[rows[:n]]
    wrong = np.flatnonzero(~(abs(sums - 1.0) <= _checks.SUM_TOLERANCE))
    if wrong.size:
        k = int(wrong[0])
        way = "a row may be missing, or be there twice under two names"
        if abs(sums[k] - 1.0) < ROUNDING:
            way = "of rounded ones, divide each by the sum of its pair"
        raise ArgumentError(
            f"{path!r}: state {state[k]}, action {action[k]} (first in"
            f" {describe_row(path, k)}): probability",
            f"must {_checks.SUM_RULE.format(sums[k])} ({way})",
        )
    return {
        "transitions": csr_from_entries(
            rows, to, np.concatenate([probability, zeros + 1]), shape
        ),
        "rewards": csr_from_entries(rows, to, np.concatenate([reward, zeros]), shape),
        "state_names": states,
        "action_names": actions,
    }


def _warn_of_misspelt(path: str, number: Any, ends: Any, states: list[Any]) -> None:
    """Warn of terminal states whose names may be misspellings of other states'.

    ``number``: the states of the rows, and then their next states.
    """
    from oee_tabular.data.tables import describe_row
    from oee_tabular.mdp import find_misspelt_ends

    is_end = np.zeros(len(states), dtype=np.bool_)
    is_end[ends] = True
    n_rows = np.bincount(number, minlength=len(states))
    notes = []
    for name, other in find_misspelt_ends(states, is_end, n_rows):
        row = np.flatnonzero(number == states.index(name))[0] - len(number) // 2
        notes.append((int(row), name, other))
    if not notes:
        return
    row, name, other = notes[0]
    more = _checks.in_all(len(notes), "such states")
    _checks.warn(
        f"{path!r}: {describe_row(path, row)}: next_state {_checks.show(name)} resembles"
        f" the state {_checks.show(other)}, and no row begins in it: it is read as"
        f" another state, which is terminal{more}. If it is misspelt, write"
        f" {_checks.show(other)}; if it is meant, give it a row for each action that"
        " leads back to it with probability 1 and reward 0",
        DataWarning,
    )


def _require_every_action(
    path: str,
    rows: Any,
    n: int,
    states: list[Any] | None,
    actions: list[Any] | None,
    shape: tuple[int, int],
) -> None:
    """Raise an ArgumentError where a state has one action in the table but not all.

    ``rows`` are the numbers s * A + a of the pairs that are there, ``shape`` is (S, A);
    the first ``n`` of them are those of the table's rows.
    """
    lacking = np.setdiff1d(np.arange(shape[0] * shape[1]), rows)
    if not lacking.size:
        return
    s, a = divmod(int(lacking[0]), shape[1])
    state = s if states is None else states[s]
    action = a if actions is None else actions[a]
    raise ArgumentError(
        repr(path),
        f"must have every action of a state that has one; state {state}, action"
        f" {action} is not there ({lacking.size} such pairs"
        f"{_find_cause(path, rows[:n], states, actions, shape[1])}; of actions that"
        " cannot be taken, save one made by FiniteMDP(..., available=))",
    )


def _find_cause(
    path: str,
    rows: Any,
    states: list[Any] | None,
    actions: list[Any] | None,
    n_actions: int,
) -> str:
    """Say of a name of few rows that it may be another that is misspelt; "" for none."""
    from oee_tabular.data.tables import describe_row
    from oee_tabular.mdp import find_misspelt

    for names, codes in ((actions, rows % n_actions), (states, rows // n_actions)):
        known = names or []
        for name, others in find_misspelt(known, known).items():
            places = [
                np.flatnonzero(codes == known.index(each)) for each in (name, others[0])
            ]
            if not all(map(len, places)):
                continue  # a state that no row leaves
            # the misspelt one stands in fewer rows, or came later
            rare = min(places, key=lambda found: (len(found), -found[0]))
            misspelt, meant = (name, others[0])[:: 1 if rare is places[0] else -1]
            return (
                f"; {describe_row(path, int(rare[0]))} has {_checks.show(misspelt)}: is"
                f" {_checks.show(meant)} meant?"
            )
    return ""


def _read_columns(path: str, columns: Mapping[str, Any]) -> list[Any]:
    """Return state, action, next_state, probability and reward of a table."""
    from oee_tabular.cli.policies import drop_index, require_commas
    from oee_tabular.data.labels import warn_left_out
    from oee_tabular.data.tables import csv_frame, describe_row

    name = repr(path)
    if not path.lower().endswith((".csv", ".csv.gz")):
        raise ArgumentError(name, "must be a .csv file, to have probabilities")
    for field in columns:
        if field not in FIELDS:
            raise ArgumentError(
                "--column",
                f"must name columns of {', '.join(FIELDS)} for a table with"
                f" probabilities; it names {_checks.show(field)}",
            )
    require_commas(path, [str(label) for label in columns.values()])
    frame = drop_index(csv_frame(path))
    labels = list(frame.columns)
    missing = _find_missing(labels, columns, FIELDS)
    if missing:
        raise ArgumentError(
            name,
            "must have the columns state, action, next_state, probability and reward;"
            f" it has {_describe_missing(labels, missing, columns)}",
        )
    found = []
    used = []
    for field in FIELDS:
        label = _find_label(field, labels, columns)
        used.append(label)
        values = frame[label].to_numpy()
        if frame[label].isna().any():
            k = int(np.flatnonzero(frame[label].isna())[0])
            raise ArgumentError(
                f"{name}: {describe_row(path, k)}: {field}",
                "must have a value; it has none",
            )
        if field in (PROBABILITY, "reward"):
            values = _read_numbers(path, field, values)
        elif values.dtype.kind == "O":
            _refuse_blanks(path, field, values)
        found.append(values)
    warn_left_out(repr(path), [label for label in frame.columns if label not in used])
    return found


def _refuse_blanks(path: str, field: str, values: Any) -> None:
    """Raise an ArgumentError for a name that begins or ends with a blank."""
    from oee_tabular.data.tables import describe_row

    for k, name in enumerate(values):
        if isinstance(name, str) and name != name.strip():
            raise ArgumentError(
                f"{path!r}: {describe_row(path, k)}: {field}",
                f"must not begin or end with a blank; it is {_checks.show(name)}",
            )


def _read_numbers(path: str, field: str, values: Any) -> Any:
    """Return a column of probabilities, from 0 to 1, or of finite rewards."""
    import pandas as pd

    from oee_tabular.data.tables import describe_row

    numbers = pd.to_numeric(pd.Series(values), errors="coerce").to_numpy(np.float64)
    is_wrong = ~np.isfinite(numbers)
    rule = "must be a finite number"
    if not is_wrong.any() and field == PROBABILITY:
        is_wrong = (numbers < 0.0) | (numbers > 1.0)
        rule = "must be in [0, 1]"
    if is_wrong.any():
        k = int(np.flatnonzero(is_wrong)[0])
        raise ArgumentError(
            f"{path!r}: {describe_row(path, k)}: {field}",
            f"{rule}; it is {_checks.show(values[k : k + 1].tolist()[0])}",
        )
    return numbers


def _find_label(field: str, labels: list[Any], columns: Mapping[str, Any]) -> Any:
    """Return what a table calls a column; None where no label is likely."""
    from oee_tabular.data.aliases import POLICY_PROBABILITY, find_field, plain

    if columns.get(field) is not None:
        return columns[field]
    likely = [
        each
        for each in labels
        if each == field
        or (field == "probability" and plain(each) in POLICY_PROBABILITY)
        or find_field(each, has_vectors=False) == field
    ]
    return field if field in likely else (likely or [None])[0]


def describe_table(path: str, columns: Mapping[str, Any]) -> str | None:
    """Return in words what a simulator's table holds; None where a file is none.

    It has state, action, next_state and a column of probabilities, which sum to 1 over
    the rows of a state and action. Those of the actions of a log do not.
    """
    from oee_tabular.cli.policies import drop_index
    from oee_tabular.data.aliases import find_field
    from oee_tabular.data.tables import csv_frame, read_labels

    if not path.lower().endswith((".csv", ".csv.gz")) or columns.keys() - set(FIELDS):
        return None
    if columns.get(PROBABILITY, "") is None:  # left out, so that rows are samples
        return None
    labels = read_labels(path)
    found = {field: _find_label(field, labels, columns) for field in FIELDS}
    own = [found[field] for field in FIELDS[:4]]
    if not set(own) <= set(labels) or len(set(own)) < len(own):
        return None
    others = {find_field(each, has_vectors=False) for each in labels if each not in own}
    if others - {None, "reward"}:  # columns that a log alone has
        return None
    frame = drop_index(csv_frame(path))
    if not set(own) <= set(frame.columns):
        return None
    state, action, following, probability = own
    values = frame[probability]
    if (
        values.dtype.kind not in "iuf"
        or not len(frame)
        or frame[own].isna().to_numpy().any()
    ):
        return None
    sums = frame.groupby([state, action])[probability].sum()
    is_repeated = frame.duplicated([state, action, following]).any()
    if is_repeated or not bool((abs(sums - 1.0) <= SUM_TOLERANCE).all()):
        return None
    states = set(frame[state]) | set(frame[following])
    reward = found["reward"]
    lacking = ""
    if reward not in labels:
        lacking = ", once it has a column reward"
    return (
        f"table of a simulator: {len(frame)} transitions of {len(states)} states and"
        f" {frame[action].nunique()} actions with probabilities"
        f" ({_checks.show(probability)}), which sum to 1 for each state and action; no"
        f" log\nto evaluate with it{lacking}: oee export {shlex.quote(path)} --initial"
        f" STATE --discount G --output simulator.npz{_repeat_columns(columns)}"
    )


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
    return (
        f"{text}{_list_states(mdp, ends)} {are} terminal: every action leads back to"
        f" {back} with reward 0"
    )


def _list_states(mdp: oee.FiniteMDP, states: Any) -> str:
    """Return the names or numbers of states in words, of many only the first ones."""
    names = [
        str(k) if mdp.state_names is None else str(mdp.state_names[k])
        for k in states[:FEW_STATES].tolist()
    ]
    more = len(states) - len(names)
    return ", ".join(names) + (f" and {more} other states" if more else "")


def _number(column: Any) -> tuple[Any, list[Any] | None]:
    """Return a column of names as numbers in the order of first rows, with the names.

    A column of numbers has no names.
    """
    if column.dtype.kind in "iu":
        return column.astype(np.int64), None
    names = list(dict.fromkeys(column.tolist()))
    place = {name: k for k, name in enumerate(names)}
    return np.array([place[name] for name in column.tolist()]), names


def _is_repeated(values: Any) -> Any:
    """Say of each value whether it stands there more than once."""
    _, code, number = np.unique(values, return_inverse=True, return_counts=True)
    return number[code] > 1

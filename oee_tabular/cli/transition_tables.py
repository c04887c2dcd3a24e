"""Tables of a simulator's transitions with their probabilities, as a FiniteMDP.

States, actions and flags follow the rules that the tables of logs have.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from oee_tabular import _checks
from oee_tabular.exceptions import ArgumentError, DataWarning

if TYPE_CHECKING:  # modules that take long to import
    from oee_tabular.mdp import Name, Outcomes

ROUNDING = 0.01  # by which a sum of probabilities that were rounded may be off
PROBABILITY = "probability"
FIELDS = ("state", "action", "next_state", PROBABILITY, "reward")
ENDS = ("terminated", "truncated")
COLUMNS = (*FIELDS, *ENDS)
KIND = "table of probabilities"


class TransitionTable(NamedTuple):
    """Hold a table of transitions, whose states and actions have become numbers.

    Attributes
    ----------
    outcomes : Outcomes
        The rows. One is terminated where the table says that the task ends with it.
    states, actions : tuple, or None
        The names by number; None where the table has numbers itself.
    shape : tuple of int
        The numbers of states and of actions.
    """

    outcomes: Outcomes
    states: tuple[Name, ...] | None
    actions: tuple[Name, ...] | None
    shape: tuple[int, int]

    def to_arguments(self, initial: Any) -> dict[str, Any]:
        """Return the arguments of ``FiniteMDP``, but the discount.

        A state that no row leaves is terminal. Transitions that end the task are those
        of ``FiniteMDP.from_gymnasium``.
        """
        from oee_tabular.mdp import Outcomes, build_arguments, initial_distribution

        n_states, n_actions = self.shape
        rows = self.outcomes
        ends = np.setdiff1d(np.arange(n_states), rows.state)
        state = np.repeat(ends, n_actions)
        stay = Outcomes(
            state,
            np.tile(np.arange(n_actions), len(ends)),
            state,
            np.ones(len(state)),
            np.zeros(len(state)),
            np.zeros(len(state), dtype=np.bool_),
        )
        both = zip(rows, stay, strict=True)
        law = initial_distribution(initial, self.states, n_states)
        return build_arguments(
            Outcomes._make(map(np.concatenate, both)),
            _checks.distribution(law, "initial", (n_states,)),
            n_actions,
            state_names=self.states,
            action_names=self.actions,
        )


def read_transition_table(
    path: str, columns: Mapping[str, Any], *, has_rewards: bool = True
) -> TransitionTable:
    """Read a simulator's table and check it by itself.

    Raises an ArgumentError with the file, the row and the rule that it breaks.

    Parameters
    ----------
    path : str
        The file.
    columns : mapping
        What it calls its columns; None for terminated or truncated leaves one out.
    has_rewards : bool, default True
        Whether it must have rewards; without them they are 0.

    Returns
    -------
    TransitionTable
        The rows, by number.
    """
    from oee_tabular.mdp import Outcomes

    frame, labels = _read_frame(path, columns, has_rewards=has_rewards)
    values = {field: frame[label].to_numpy() for field, label in labels.items()}
    states, actions, pairs = _number_columns(path, values)
    probability = _read_numbers(path, PROBABILITY, values[PROBABILITY])
    reward = np.zeros(len(frame))
    if "reward" in values:
        reward = _read_numbers(path, "reward", values["reward"])
    state, action, following = pairs
    shape = _count(path, pairs)
    is_left = np.bincount(state, minlength=shape[0]) > 0
    ends = _read_ends(path, values, len(frame))
    # nothing follows a state that no row leaves, and an impossible transition ends none
    terminated = ends & is_left[following] & (probability > 0.0)
    outcomes = Outcomes(state, action, following, probability, reward, terminated)
    table = TransitionTable(outcomes, states, actions, shape)
    # a misspelt action leaves a sum that is wrong as well
    _require_every_action(path, table)
    _require_sums(path, table)
    _warn_of_repeats(path, table)
    if states is not None:
        is_end = ~is_left
        is_end &= np.bincount(following[~ends], minlength=shape[0]) > 0
        _warn_of_misspelt(path, np.concatenate([state, following]), is_end, states)
    _warn_of_labels(path, columns, list(frame.columns), labels)
    return table


def _read_frame(
    path: str, columns: Mapping[str, Any], *, has_rewards: bool
) -> tuple[Any, dict[str, Any]]:
    """Return a table and, by the column, the labels that it has for them."""
    from oee_tabular.cli.policies import drop_index, require_commas
    from oee_tabular.data.tables import csv_frame

    name = repr(path)
    if not path.lower().endswith((".csv", ".csv.gz")):
        raise ArgumentError(name, "must be a .csv file, to have probabilities")
    for field in columns:
        if field not in COLUMNS:
            raise ArgumentError(
                "--column",
                f"must name columns of {', '.join(COLUMNS)} for a table with"
                f" probabilities; it names {_checks.show(field)}",
            )
    require_commas(path, [str(label) for label in columns.values()])
    frame = drop_index(csv_frame(path, has_flags=False))
    labels = list(frame.columns)
    needed = FIELDS if has_rewards else FIELDS[:4]
    asked = [field for field in ENDS if columns.get(field) is not None]
    missing = find_missing(labels, columns, (*needed, *asked))
    if missing:
        raise ArgumentError(
            name,
            "must have the columns state, action, next_state, probability and reward;"
            f" it has {describe_missing(labels, missing, columns)}",
        )
    if frame.empty:
        raise ArgumentError(name, "must have at least one row; it has none")
    found = _choose_labels(path, labels, columns)
    _refuse_doubtful_ends(name, labels, columns, found)
    return frame, found


def _choose_labels(
    path: str, labels: list[Any], columns: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the label of each column that a table has.

    Raises an ArgumentError where several labels may be that of one column.
    """
    from oee_tabular.data.labels import choose_label

    found = {}
    for field in COLUMNS:
        if field in ENDS and columns.get(field, "") is None:
            continue
        likely = _list_likely(field, labels)
        if columns.get(field) is not None:
            found[field] = columns[field]
        elif field in likely:
            found[field] = field
        elif likely:
            found[field] = choose_label(field, likely, repr(path))
    return found


def _refuse_doubtful_ends(
    name: str, labels: list[Any], columns: Mapping[str, Any], found: dict[str, Any]
) -> None:
    """Raise an ArgumentError for a column that may say that the task ends."""
    from oee_tabular.data.aliases import DOUBTS, plain
    from oee_tabular.data.labels import refuse_doubt
    from oee_tabular.data.rules import COLUMNS as COLUMNS_OF_LOG

    known = set(COLUMNS_OF_LOG)
    if "terminated" not in found and "terminated" not in columns:
        known.discard("terminated")
    used = list(found.values())
    for label in labels:
        doubt = DOUBTS.get(plain(label))
        is_of_end = doubt is None or any(
            "terminated" in way for way in doubt.settled_by
        )
        if label not in used and is_of_end:
            refuse_doubt(label, known, name)


def _read_ends(path: str, values: Mapping[str, Any], n_rows: int) -> Any:
    """Return which transitions end the task, (n,) booleans.

    Raises an ArgumentError for one that is truncated.
    """
    flags = {field: np.zeros(n_rows, dtype=np.bool_) for field in ENDS}
    for field in ENDS:
        if field in values:
            flags[field] = _check_values(path, field, values[field])
    cut = np.flatnonzero(flags["truncated"])
    if cut.size:
        k = int(cut[0])
        raise ArgumentError(
            _place(path, k, "truncated"),
            "must be false in a table of probabilities, as a model has no limit of"
            f" time; it is {values['truncated'][k]}{_checks.in_all(cut.size, 'such rows')}"
            " (leave the column out: --column truncated=)",
        )
    return flags["terminated"]


def _number_columns(
    path: str, values: Mapping[str, Any]
) -> tuple[Any, Any, tuple[Any, Any, Any]]:
    """Return the names of states and of actions, and the numbers of each row's.

    These are its state, its action and its next state. A column of numbers has no
    names.
    """
    state, action, following = (
        _check_values(path, field, values[field]) for field in FIELDS[:3]
    )
    if state.dtype.hasobject != following.dtype.hasobject:
        named = "state" if state.dtype.hasobject else "next_state"
        other = "next_state" if named == "state" else "state"
        raise ArgumentError(
            _place(path, 0, named),
            f"must be a number, as those of {other} are; it is"
            f" {_checks.show(values[named][0])} (write the states of both columns as"
            " names, or those of both as numbers)",
        )
    n = len(state)
    states, number = _number(path, [("state", state), ("next_state", following)])
    actions, codes = _number(path, [("action", action)])
    return states, actions, (number[:n], codes, number[n:])


def _number(
    path: str, columns: list[tuple[str, Any]]
) -> tuple[tuple[Name, ...] | None, Any]:
    """Return the names in columns, in the order of their first rows, and their numbers.

    Columns of numbers have no names.
    """
    from oee_tabular.mdp import check_names

    values = np.concatenate([column for _, column in columns])
    if not values.dtype.hasobject:
        return None, values
    first: dict[Any, int] = {}
    for k, name in enumerate(values.tolist()):
        first.setdefault(name, k)
    rows = list(first.values())

    def place_of(k: int) -> str:
        """Return the place of the first row that has a name."""
        which, row = divmod(rows[k], len(columns[0][1]))
        return _place(path, row, columns[which][0])

    names = check_names(list(first), f"{path!r}: {columns[0][0]}", len(first), place_of)
    number = {name: k for k, name in enumerate(first)}
    return names, np.array([number[name] for name in values.tolist()], dtype=np.int64)


def _count(path: str, pairs: tuple[Any, Any, Any]) -> tuple[int, int]:
    """Return the numbers of states and actions of a table.

    Raises an ArgumentError where memory does not suffice for so many.
    """
    from oee_tabular.mdp import NUMBERS_PER_PAIR

    state, action, following = pairs
    n_states = 1 + int(max(state.max(), following.max()))
    n_actions = 1 + int(action.max())
    field, column = "action", action
    if n_states >= n_actions:
        is_first = state.max() >= following.max()
        field, column = ("state", state) if is_first else ("next_state", following)
    row = int(np.argmax(column))
    needed = NUMBERS_PER_PAIR * n_states * n_actions
    try:
        _checks.require_memory(needed, field, column[row])
    except ArgumentError as error:
        hint = "numbers begin at 0 and have no gaps: write names in place of others"
        raise ArgumentError(
            _place(path, row, field), f"{error.rule} ({hint})"
        ) from None
    return n_states, n_actions


def _check_values(path: str, field: str, values: Any) -> Any:
    """Return a column of names, of numbers from 0, or of flags.

    The rules are those of a log, but that a word for a missing value may be a name.
    """
    from oee_tabular.data.rules import check_column, is_missing

    is_flag = field in ENDS
    own = {item for item in values.tolist() if isinstance(item, str)}
    checked, fault = check_column(
        values, field, names=None if is_flag else (), own=set() if is_flag else own
    )
    if fault is not None:
        if not (is_flag or is_missing(fault.value) or isinstance(fault.value, str)):
            things = "actions" if field == "action" else "states"
            hint = f" (number the {things} from 0, or write names)"
            fault = fault._replace(hint=hint)
        more = _checks.in_all(len(fault.rows), "such rows")
        raise ArgumentError(
            _place(path, int(fault.rows[0]), field), f"{fault.problem()}{more}"
        )
    return checked


def _place(path: str, row: int, field: str) -> str:
    """Return the file, the row and the column of a value in words."""
    from oee_tabular.data.tables import describe_row

    return f"{path!r}: {describe_row(path, row)}: {field}"


def _find_repeats(table: TransitionTable) -> Any:
    """Say of each row whether another one is of the same transition.

    One that ends the task is another than one that does not.
    """
    rows = table.outcomes
    n_states, n_actions = table.shape
    entry = (rows.state * n_actions + rows.action) * n_states + rows.next_state
    return _is_repeated(2 * entry + rows.terminated)


def _warn_of_repeats(path: str, table: TransitionTable) -> None:
    """Warn of rows of the same transition, which are added up."""
    from oee_tabular.data.tables import describe_row

    twice = np.flatnonzero(_find_repeats(table))
    if twice.size:
        more = _checks.in_all(twice.size, "such rows")
        _checks.warn(
            f"{path!r}: {describe_row(path, int(twice[0]))} has the state, action and"
            f" next_state of another row{more}: their probabilities are added, and"
            " their rewards are averaged by them",
            DataWarning,
        )


def _words(table: TransitionTable, row: int) -> list[str]:
    """Return the state, the action and the next state of a row as the table has them."""
    numbers = [column[row] for column in table.outcomes[:3]]
    names = (table.states, table.actions, table.states)
    return [
        str(number if called is None else called[number])
        for number, called in zip(numbers, names, strict=True)
    ]


def _require_sums(path: str, table: TransitionTable) -> None:
    """Raise an ArgumentError where the probabilities of a pair do not sum to 1.

    Where a row is there twice, that is why.
    """
    from oee_tabular.data.tables import describe_row

    rows = table.outcomes
    pair = rows.state * table.shape[1] + rows.action
    sums = np.bincount(pair, rows.weight)[pair]
    is_wrong = ~(abs(sums - 1.0) <= _checks.SUM_TOLERANCE)
    # of impossible ones nothing says which reward is right
    twice = np.flatnonzero(_find_repeats(table) & (is_wrong | (rows.weight == 0.0)))
    if twice.size:
        k = int(twice[0])
        raise ArgumentError(
            f"{path!r}: {describe_row(path, k)}",
            "must be the only one of its state, action and next_state;"
            f" {', '.join(_words(table, k))} has another",
        )
    wrong = np.flatnonzero(is_wrong)
    if wrong.size:
        k = int(wrong[0])
        way = "a row may be missing, or be there twice under two names"
        if abs(sums[k] - 1.0) < ROUNDING:
            way = "of rounded ones, divide each by the sum of its pair"
        state, action, _ = _words(table, k)
        raise ArgumentError(
            f"{path!r}: state {state}, action {action} (first in"
            f" {describe_row(path, k)}): probability",
            f"must {_checks.SUM_RULE.format(sums[k])} ({way})",
        )


def _warn_of_labels(
    path: str, columns: Mapping[str, Any], labels: list[Any], found: dict[str, Any]
) -> None:
    """Warn of columns that are read by other labels, and of those that are left out."""
    from oee_tabular.data.labels import warn_left_out, warn_read_as

    renamed = [
        (label, field)
        for field, label in found.items()
        if label != field and field not in columns
    ]
    used = list(found.values())
    left = [label for label in labels if label not in used]
    warn_read_as(repr(path), renamed, " (--column names other columns)", of=KIND)
    warn_left_out(repr(path), left, of=KIND)


def _warn_of_misspelt(
    path: str, number: Any, is_end: Any, states: tuple[Name, ...]
) -> None:
    """Warn of terminal states whose names may be misspellings of other states'.

    ``number``: the states of the rows, and then their next states.
    """
    from oee_tabular.data.tables import describe_row
    from oee_tabular.mdp import find_misspelt_ends

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


def _require_every_action(path: str, table: TransitionTable) -> None:
    """Raise an ArgumentError where a state has one action in the table but not all."""
    rows = table.outcomes
    n_actions = table.shape[1]
    pairs = rows.state * n_actions + rows.action
    left = np.unique(rows.state)
    needed = left[:, None] * n_actions + np.arange(n_actions)
    lacking = np.setdiff1d(needed, pairs)
    if not lacking.size:
        return
    s, a = divmod(int(lacking[0]), n_actions)
    state = s if table.states is None else table.states[s]
    action = a if table.actions is None else table.actions[a]
    raise ArgumentError(
        repr(path),
        f"must have every action of a state that has one; state {state}, action"
        f" {action} is not there ({lacking.size} such pairs"
        f"{_find_cause(path, table)}; of actions that"
        " cannot be taken, save one made by FiniteMDP(..., available=))",
    )


def _find_cause(path: str, table: TransitionTable) -> str:
    """Say of a name of few rows that it may be another that is misspelt; "" for none."""
    from oee_tabular.data.tables import describe_row
    from oee_tabular.mdp import find_misspelt

    rows = table.outcomes
    for names, codes in ((table.actions, rows.action), (table.states, rows.state)):
        known = names or ()
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


def _read_numbers(path: str, field: str, values: Any) -> Any:
    """Return a column of probabilities, from 0 to 1, or of finite rewards."""
    import pandas as pd

    lacking = np.flatnonzero(pd.isna(values))
    if lacking.size:
        more = _checks.in_all(lacking.size, "such rows")
        raise ArgumentError(
            _place(path, int(lacking[0]), field),
            f"must have a value; it has none{more}",
        )
    numbers = pd.to_numeric(pd.Series(values), errors="coerce").to_numpy(np.float64)
    is_wrong = ~np.isfinite(numbers)
    rule = "must be a finite number"
    if not is_wrong.any() and field == PROBABILITY:
        is_wrong = (numbers < 0.0) | (numbers > 1.0)
        rule = "must be in [0, 1]"
    if is_wrong.any():
        k = int(np.flatnonzero(is_wrong)[0])
        raise ArgumentError(
            _place(path, k, field),
            f"{rule}; it is {_checks.show(values[k : k + 1].tolist()[0])}",
        )
    return numbers


def find_label(field: str, labels: list[Any], columns: Mapping[str, Any]) -> Any:
    """Return what a table calls a column; None where no label is likely."""
    if columns.get(field) is not None:
        return columns[field]
    likely = _list_likely(field, labels)
    return field if field in likely else (likely or [None])[0]


def _list_likely(field: str, labels: list[Any]) -> list[Any]:
    """Return the labels of a table that are clear ones of a column."""
    from oee_tabular.data.aliases import POLICY_PROBABILITY, find_field, plain

    return [
        each
        for each in labels
        if each == field
        or (field == PROBABILITY and plain(each) in POLICY_PROBABILITY)
        or find_field(each, has_vectors=False) == field
    ]


def find_missing(
    labels: list[Any], columns: Mapping[str, Any], fields: tuple[str, ...]
) -> list[str]:
    """Return which of the fields no column of a table holds."""
    return [
        field for field in fields if find_label(field, labels, columns) not in labels
    ]


def describe_missing(
    labels: list[Any], missing: list[str], columns: Mapping[str, Any]
) -> str:
    """Return in words what a table has, what it lacks, and the options that help."""
    from oee_tabular.data.labels import show_labels, suggest_label

    known = {find_label(field, labels, columns) for field in COLUMNS}
    free = [label for label in labels if label not in known]
    names = []
    for field in missing:
        name = columns.get(field) or field
        names.append(f"{name}{suggest_label(name, free)}")
    words = " ".join(f"--column {field}=LABEL" for field in missing)
    lacking = " or ".join([", ".join(names[:-1]), names[-1]] if names[1:] else names)
    return f"{show_labels(labels)}, and none is {lacking} ({words})"


def _is_repeated(values: Any) -> Any:
    """Say of each value whether it stands there more than once."""
    _, code, number = np.unique(values, return_inverse=True, return_counts=True)
    return number[code] > 1

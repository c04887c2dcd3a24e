"""Columns of a log: their labels, and what each must hold in arrays, tables and counts.

A check returns the values and, where some break the rule, a ``Fault``: all such rows,
and the words for the first. Whoever asks raises it, or leaves the rows out. A value is
missing where it is nan or None. In tables, a text is the number that it writes.
"""

from __future__ import annotations

import difflib
import math
import operator
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from oee_tabular import _checks
from oee_tabular.exceptions import ArgumentError, DataWarning
from oee_tabular.mdp.naming import Name, is_number_text, numbers_of, suggest_name
from oee_tabular.typing import Array, BoolArray, Column, IntArray, SupportsArray

# a column of a log as it is given: numbers, flags or names; a text is no column
ColumnLike: TypeAlias = SupportsArray | list[Any] | tuple[Any, ...] | range

MOVE = ("state", "action", "next_state")
KEY = (*MOVE, "terminated")  # of sums
KINDS = {
    "state": "integers",
    "action": "integers",
    "next_state": "integers",
    "reward": "numbers",
    "terminated": "booleans",
    "truncated": "booleans",
    "episode": "integers",
    "timestep": "integers",
    "behavior_probability": "numbers",
}
COLUMNS = tuple(KINDS)
MAX_SHOWN_COLUMNS = 10  # of those that are left out
SEPARATORS = {";": "semicolons", "\t": "tabs", "|": "bars", " ": "spaces"}
FLAG_TEXTS = {
    "true": True,
    "1": True,
    "1.0": True,
    "false": False,
    "0": False,
    "0.0": False,
}


class Fault(NamedTuple):
    """Hold the rows of a column that break its rule, with the value in the first.

    The rows are in their order. ``shift``: -1 where the value is that of the row
    before.
    """

    label: str
    rows: IntArray
    rule: str
    value: Any
    hint: str = ""
    shift: int = 0

    def place(self, row: int | None = None) -> str:
        """Return the label and the number of the first row, ``state[3]``.

        ``row``: the number of the first row, where it has another in its file.
        """
        first = self.rows[0] if row is None else row
        return f"{self.label}[{first + self.shift}]"

    def problem(self) -> str:
        """Return the rule and the value in words, the sentence after the place."""
        if is_missing(self.value):
            return "must have a value; it has none"
        text = self.value.strip() if isinstance(self.value, str) else ""
        # a number is shown without quotes
        is_number = bool(text) and len(text) < 80 and is_number_text(text)
        shown = text if is_number else _checks.show(self.value)
        return f"{self.rule}; it is {shown}{self.hint}"

    def to_error(self, source: str = "", *, has_count: bool = True) -> ArgumentError:
        """Return the error of the first row, of a table where ``source`` names one.

        ``has_count``: whether it says how many rows break the rule.
        """
        place = f"{source}: {self.place()}" if source else self.place()
        others = ""
        if has_count and len(self.rows) > 1:
            others = f" ({len(self.rows)} such rows in all)"
        return ArgumentError(place, f"{self.problem()}{others}")


def as_objects(items: Sequence[Any]) -> Column:
    """Return names as an array of objects, tuples whole."""
    array = np.empty(len(items), dtype=object)
    array[:] = items
    return array


def is_missing(value: Any) -> bool:
    """Say whether a value is None or nan."""
    return value is None or (isinstance(value, float) and math.isnan(value))


def find_fault(
    label: str, raw: Column, rules: Mapping[str, BoolArray], *, has_names: bool = False
) -> Fault | None:
    """Return the fault of the rows that break one of the rules, or None.

    ``rules``: by the words of each rule, the rows that break it.
    """
    rows = np.flatnonzero(np.any(list(rules.values()), axis=0))
    if not rows.size:
        return None
    first = rows[0]
    rule = next(rule for rule, is_broken in rules.items() if is_broken[first])
    value = raw[first].item() if isinstance(raw[first], np.generic) else raw[first]
    return Fault(label, rows, rule, value, _suggest_value(value, label, has_names))


def _suggest_value(value: Any, label: str, has_names: bool) -> str:
    """Return a hint for the value that breaks a rule, in words; empty without one."""
    if isinstance(value, str) and re.fullmatch(r"\s*-?\d+,\d+\s*", value):
        return " (write a decimal point, not a comma)"
    # nan, which is not above 0, where it is no number
    if label.endswith("action") and _parse_number(value) % 1 > 0:
        return " (call the column of a continuous task's commands action_0)"
    is_word = isinstance(value, str) and value.strip()[:1].isalpha()
    if label in MOVE and is_word and not has_names:
        return " (names take a simulator that has them: simulator=, --simulator)"
    return ""


def to_numbers(raw: Column) -> Column:
    """Return numbers; a text becomes the number that it writes, or nan."""
    if raw.dtype.kind in "iuf":
        return raw
    numbers = np.array([_parse_number(item) for item in raw.tolist()])
    # integers beyond 64 bits are objects
    if numbers.dtype.hasobject or not numbers.size:
        return numbers.astype(np.float64)
    return numbers


def _parse_number(item: Any) -> int | float:
    """Return the number that an item is or writes, or nan.

    An int stays one, since a float does not hold all from 2**53 on.
    """
    item = item.item() if isinstance(item, np.generic) else item
    if isinstance(item, str):
        return _parse_text(item)
    is_number = isinstance(item, int | float) and not isinstance(item, bool)
    return item if is_number else math.nan


def _parse_text(text: str) -> int | float:
    """Return the number that a text writes, or nan."""
    if "_" in text:  # which Python's own literals may have
        return math.nan
    try:
        return int(text) if text.isdecimal() else float(text)
    except ValueError:
        return math.nan


def check_array(value: object, label: str) -> Column:
    """Check a column that is given as an array or a list.

    Raises an ArgumentError with the row, the rule and the value.
    """
    kind = KINDS[label]
    if kind == "numbers":
        array: Column = _checks.float_array(
            value, label, ndim=1, allow_missing=label == "reward"
        )
    else:
        array = _checks.as_array(value, label, f"a column of {kind}")
    if array.ndim != 1:
        raise ArgumentError(label, f"must have 1 dimension; it has shape {array.shape}")
    if kind == "integers" and array.size and array.dtype.kind not in "iuf":
        texts = ""
        if array.dtype.kind in "UO":
            texts = " (numbers written as text? .astype(int))"
        raise ArgumentError(label, f"must hold integers; it holds {array.dtype}{texts}")
    values, fault = check_column(array, label)
    if fault is not None:
        raise fault.to_error(has_count=False)
    return values


def check_table(columns: Mapping[str, Column], source: str) -> dict[str, Column]:
    """Return the values of a table's columns; names and episodes may be texts.

    Raises an ArgumentError for the first fault.
    """
    values = {}
    for label, raw in columns.items():
        names = () if label in MOVE else None
        values[label], fault = check_column(raw, label, names=names)
        if fault is not None:
            raise fault.to_error(source)
    return values


def check_column(
    raw: Column, label: str, *, high: int = 2**63, names: tuple[Name, ...] | None = None
) -> tuple[Column, Fault | None]:
    """Return the values of a column by its label, and its fault or None.

    Labels that a log does not know are numbers. ``high``: integers are below it.
    ``names``: those that may stand in place of numbers, which they become; empty: any,
    which stay, as the texts of episodes do; None: none.
    """
    kind = KINDS.get(label, "numbers")
    if raw.dtype.kind in "Mm":  # dates are no numbers
        raw = raw.astype(str)
    # truth values are texts, as in CSV
    if kind != "booleans" and raw.dtype.kind in "bO":
        raw = as_objects([_flag_as_text(item) for item in raw.tolist()])
    names = () if label == "episode" else names
    if names is not None and _holds_names(raw):
        return _match_names(raw, label, names)
    if kind == "integers":
        return _check_integers(raw, label, high)
    if kind == "booleans":
        return _check_flags(raw, label)
    return _check_numbers(raw, label)


def _flag_as_text(item: Any) -> Any:
    """Return a truth value as a text, anything else as it is."""
    return str(item) if isinstance(item, bool | np.bool_) else item


def _holds_names(raw: Column) -> bool:
    """Say whether the first value of a column that is not missing is a name."""
    if not raw.dtype.hasobject:
        return False
    first = next((item for item in raw.tolist() if not is_missing(item)), None)
    is_text_name = isinstance(first, str) and not is_number_text(first)
    return isinstance(first, tuple) or is_text_name


def _check_integers(
    raw: Column, label: str, high: int
) -> tuple[IntArray, Fault | None]:
    """Check integers from 0 (of episodes any) and below ``high``; others become 0."""
    low = -(2**63) if label == "episode" else 0
    if raw.dtype == np.int64 and raw.size and raw.min() >= low and raw.max() < high:
        return raw, None
    numbers = to_numbers(raw)
    odd = np.zeros(len(numbers), dtype=np.bool_)
    if numbers.dtype.kind == "f":
        odd = ~((np.abs(numbers) <= 2.0**53) & (numbers == np.floor(numbers)))
    is_low = numbers < low
    is_high = numbers >= high
    limit = f"must be in {low}..{high - 1}"
    if high >= 2**53:
        limit = f"must be below 2**{high.bit_length() - 1}"
    rules = {
        "must be an integer": odd,
        f"must be at least {low}": is_low,
        limit: is_high,
    }
    values = np.where(odd | is_low | is_high, 0, numbers).astype(np.int64)
    return values, find_fault(label, raw, rules)


def _check_numbers(raw: Column, label: str) -> tuple[Array, Fault | None]:
    """Check finite numbers, probabilities from 0 to 1; a reward may be missing."""
    low, high = (0.0, 1.0) if label == "behavior_probability" else (-np.inf, np.inf)
    numbers = to_numbers(raw).astype(np.float64, copy=False)
    is_good = np.isfinite(numbers) & (numbers >= low) & (numbers <= high)
    if is_good.all():
        return numbers, None
    if label == "reward":
        is_absent = [is_missing(value) or value == "nan" for value in raw.tolist()]
        is_good |= np.array(is_absent)
    rule = "must be finite" if low == -np.inf else f"must be in [{low:g}, {high:g}]"
    return numbers, find_fault(label, raw, {rule: ~is_good})


def _check_flags(raw: Column, label: str) -> tuple[BoolArray, Fault | None]:
    """Check booleans, 0 and 1, or texts of these."""
    if raw.dtype.kind == "b":
        return raw, None
    if raw.dtype.kind in "iuf":
        flags = raw == 1
        bad = (raw != 0) & (raw != 1)
    else:
        known = [FLAG_TEXTS.get(str(item).strip().lower()) for item in raw.tolist()]
        flags = np.array([flag is True for flag in known])
        bad = np.array([flag is None for flag in known])
    return flags, find_fault(label, raw, {"must be a boolean (or 0 or 1)": bad})


def _match_names(
    raw: Column, label: str, names: tuple[Name, ...]
) -> tuple[Column, Fault | None]:
    """Return names as their numbers; numbers as texts are none of them."""
    missing = np.array([is_missing(item) for item in raw.tolist()], dtype=np.bool_)
    if not names:
        return raw, find_fault(label, raw, {"must have a value": missing})
    known = numbers_of(names)
    found = [known.get(str(item), -1) for item in raw.tolist()]
    numbers = np.array(found, dtype=np.int64)
    rules = {
        "must have a value": missing,
        "must be one of the simulator's names": numbers < 0,
    }
    fault = find_fault(label, raw, rules, has_names=True)
    if fault is not None and not is_missing(fault.value):
        fault = fault._replace(hint=suggest_name(fault.value, names))
    return np.maximum(numbers, 0), fault


def find_repeat(names: Column, rows: IntArray) -> tuple[int, str] | None:
    """Return the first row in which an episode begins again, and the broken rule.

    ``rows``: where episodes of these ``names`` begin.
    """
    unique, index = np.unique(names, return_index=True)
    if len(unique) == len(names):
        return None
    k = int(np.setdiff1d(np.arange(len(names)), index)[0])
    name = names[k].item() if isinstance(names[k], np.generic) else names[k]
    return int(rows[k]), (
        f"must keep the rows of an episode together; {_checks.show(name)} begins again"
        f" in row {rows[k]}"
    )


def find_order_faults(
    columns: Mapping[str, Any],
    before: Mapping[str, Any],
    is_first: BoolArray,
    follows: BoolArray,
    differs: Callable[[Any, Any], Any] = np.not_equal,
    show: Callable[[Any], Any] = operator.methodcaller("tolist"),
) -> list[Fault]:
    """Return the faults of the rows that do not continue the episode of the row before.

    Parameters
    ----------
    columns : mapping of str to ndarray
        State and episode, and of timestep, terminated and truncated those that there
        are.
    before : mapping of str to ndarray
        The same and next_state, of the row before each.
    is_first, follows : ndarray of bool of shape (n,)
        Whether a row begins an episode, and whether it goes on with the one of the row
        before; neither where nothing is known of that row.
    differs : callable
        Says whether a next_state and the state after it differ.
    show : callable
        Returns a state as errors print it.
    """
    faults = [
        _find_timestep_fault(columns, before, is_first, follows),
        _find_chain_fault(columns, before, follows, differs, show),
    ]
    rule = "must be False: its episode continues in the next row"
    for label in ("terminated", "truncated"):
        if label in columns:
            rows = np.flatnonzero(follows & before[label])
            faults.append(Fault(label, rows, rule, True, shift=-1))
    return [fault for fault in faults if fault is not None and fault.rows.size]


def _find_timestep_fault(
    columns: Mapping[str, Any],
    before: Mapping[str, Any],
    is_first: BoolArray,
    follows: BoolArray,
) -> Fault | None:
    """Return the fault of timesteps that do not count 0, 1, 2, ... in their episode."""
    if "timestep" not in columns:
        return None
    expected = np.where(is_first, 0, before["timestep"] + 1)
    jumps = (is_first | follows) & (columns["timestep"] != expected)
    rule = f"must be {expected[jumps.argmax()]} (steps of an episode in order from 0)"
    return find_fault("timestep", columns["timestep"], {rule: jumps})


def _find_chain_fault(
    columns: Mapping[str, Any],
    before: Mapping[str, Any],
    follows: BoolArray,
    differs: Callable[[Any, Any], Any],
    show: Callable[[Any], Any],
) -> Fault | None:
    """Return the fault of next states that are not the state of the next row."""
    rows = np.flatnonzero(follows & differs(before["next_state"], columns["state"]))
    if not rows.size:
        return None
    state = show(columns["state"][rows[0]])
    next_state = show(before["next_state"][rows[0]])
    rule = f"must be the state of the next row of its episode, which is {state}"
    if isinstance(state, str):
        rule += " (or one of the two names is misspelt)"
    return Fault("next_state", rows, rule, next_state, shift=-1)


# ---- labels of tables


def require_columns(
    name: str, required: Sequence[str], labels: Iterable[str], *, way: str = ""
) -> None:
    """Raise an ArgumentError where a required column is missing.

    It has the separator or the spelling that was probably meant. ``way``: what else
    helps, where that cannot be said.
    """
    given = list(labels)
    if set(required) <= set(given):
        return
    shown = _checks.escape_controls(", ".join(given[:1000])[:300]) or "none"
    hint = suggest_columns(required, given)
    if not hint and len(given) >= len(required):
        hint = f" (rename the columns that hold them{way})"
    raise ArgumentError(
        name, f"must have the columns {', '.join(required)}; it has {shown}{hint}"
    )


def suggest_columns(required: Sequence[str], labels: Sequence[str]) -> str:
    """Return what is to be changed: the separator, or how a label is written.

    Empty where that cannot be said.
    """
    first = labels[0] if labels else ""
    for mark, word in SEPARATORS.items():
        if mark in first and set(_plain(first.split(mark))) & set(required):
            return f": its fields must be separated by commas; they are by {word}"
    written = {
        label: column
        for label, column in zip(labels, _plain(labels), strict=True)
        if column in required and column not in labels
    }
    return "".join(
        f"; write {column} for {_checks.show(label)}"
        for label, column in written.items()
    )


def _plain(labels: Iterable[str]) -> list[str]:
    """Return labels in lower case, with one underscore for what parts their words."""
    return [
        "_".join(label.strip(" \t\"'\ufeff").lower().replace("-", " ").split())
        for label in labels
    ]


def warn_left_out(name: str, unknown: Sequence[str], known: Sequence[str]) -> None:
    """Warn of columns that are not read, each with the known one that it resembles."""
    if not unknown:
        return
    named = [
        _checks.escape_controls(label[:80]) + suggest(label, known, likeness=0.8)
        for label in unknown[:MAX_SHOWN_COLUMNS]
    ]
    if len(unknown) > MAX_SHOWN_COLUMNS:
        named.append(f"and {len(unknown) - MAX_SHOWN_COLUMNS} more")
    _checks.warn(
        f"columns of {name!r} that a log does not use are left out: {', '.join(named)}",
        DataWarning,
    )


def suggest(
    label: object, known: Sequence[str], *, quotes: bool = False, likeness: float = 0.6
) -> str:
    """Return what was probably meant, in words; empty where nothing is near."""
    text = label if isinstance(label, str) else _checks.show(label)
    near = difflib.get_close_matches(text[:80], known, n=1, cutoff=likeness)
    if not near:
        return ""
    return f" (did you mean {near[0]!r}?)" if quotes else f" (did you mean {near[0]}?)"

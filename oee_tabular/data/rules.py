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
from typing import Any, NamedTuple

import numpy as np

from oee_tabular import _checks
from oee_tabular.exceptions import ArgumentError, DataWarning
from oee_tabular.mdp.naming import Name, is_number_text, numbers_of, suggest_name
from oee_tabular.typing import Array, BoolArray, Column, IntArray

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
N_SHOWN = 10  # of the columns that are left out
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

    def describe(self, row: int | None = None) -> str:
        """Return the place, the rule and the value in words.

        ``row``: the number of the first row, where it has another in its file.
        """
        place = f"{self.label}[{(self.rows[0] if row is None else row) + self.shift}]"
        if is_missing(self.value):
            return f"{place} must have a value; it has none"
        text = self.value.strip() if isinstance(self.value, str) else ""
        # shown without quotes
        is_number = bool(text) and len(text) < 80 and is_number_text(text)
        return (
            f"{place} {self.rule}; it is"
            f" {text if is_number else _checks.show(self.value)}{self.hint}"
        )


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
    rule = next(rule for rule, is_broken in rules.items() if is_broken[rows[0]])
    value = (
        raw[rows[0]].item() if isinstance(raw[rows[0]], np.generic) else raw[rows[0]]
    )
    hint = ""
    if isinstance(value, str) and re.fullmatch(r"\s*-?\d+,\d+\s*", value):
        hint = " (write a decimal point, not a comma)"
    elif label.endswith("action") and _parse_number(value) % 1 > 0:
        # nan where it is no number
        hint = " (call the column of a continuous task's commands action_0)"
    elif (
        label in MOVE
        and isinstance(value, str)
        and value.strip()[:1].isalpha()
        and not has_names
    ):
        hint = " (names take a simulator that has them: simulator=, --simulator)"
    return Fault(label, rows, rule, value, hint)


def to_numbers(raw: Column) -> Column:
    """Return numbers; a text becomes the number that it writes, or nan."""
    if raw.dtype.kind in "iuf":
        return raw
    numbers = np.array([_parse_number(item) for item in raw.tolist()])
    return (
        numbers.astype(np.float64)
        if numbers.dtype.hasobject or not numbers.size
        else numbers
    )


def _parse_number(item: Any) -> int | float:
    """Return the number that an item is or writes, or nan.

    An int stays one, since a float does not hold all from 2**53 on.
    """
    item = item.item() if isinstance(item, np.generic) else item
    if not isinstance(item, str):
        return (
            item
            if isinstance(item, int | float) and not isinstance(item, bool)
            else math.nan
        )
    try:
        return (
            math.nan if "_" in item else int(item) if item.isdecimal() else float(item)
        )
    except ValueError:
        return math.nan


def check_array(value: object, label: str) -> Column:
    """Check a column that is given as an array or a list.

    Raises an ArgumentError with the row, the rule and the value.
    """
    kind = KINDS[label]
    if kind == "numbers":
        array: Column = _checks.float_array(value, label, ndim=1)
    else:
        array = _checks.as_array(value, label, f"a column of {kind}")
    if array.ndim != 1:
        raise ArgumentError(label, f"must have 1 dimension; it has shape {array.shape}")
    if kind == "integers" and array.size and array.dtype.kind not in "iuf":
        texts = (
            " (numbers written as text? .astype(int))"
            if array.dtype.kind in "UO"
            else ""
        )
        raise ArgumentError(label, f"must hold integers; it holds {array.dtype}{texts}")
    values, fault = check_column(array, label)
    if fault is not None:
        raise ValueError(fault.describe())
    return values


def check_table(columns: Mapping[str, Column], source: str) -> dict[str, Column]:
    """Return the values of a table's columns; names and episodes may be texts.

    Raises a ValueError for the first fault.
    """
    values = {}
    for label, raw in columns.items():
        values[label], fault = check_column(
            raw, label, names=() if label in MOVE else None
        )
        if fault is not None:
            raise ValueError(f"{source}: {fault.describe()}{count_others(fault)}")
    return values


def count_others(fault: Fault) -> str:
    """Return how many rows break the rule, in words, where more than one does."""
    return f" ({len(fault.rows)} such rows in all)" if len(fault.rows) > 1 else ""


def check_column(
    raw: Column, label: str, *, high: int = 2**63, names: tuple[Name, ...] | None = None
) -> tuple[Column, Fault | None]:
    """Return the values of a column by its label, and its fault or None.

    Labels that a log does not know are numbers. ``high``: integers are below it.
    ``names``: those that may stand in place of numbers, which they become; empty: any,
    which stay, as the texts of episodes do; None: none.
    """
    kind = KINDS.get(label, "numbers")
    raw = raw.astype(str) if raw.dtype.kind in "Mm" else raw  # dates are no numbers
    # truth values are texts, as in CSV
    if kind != "booleans" and raw.dtype.kind in "bO":
        raw = as_objects(
            [
                str(item) if isinstance(item, bool | np.bool_) else item
                for item in raw.tolist()
            ]
        )
    names = () if label == "episode" else names
    if names is not None and raw.dtype.hasobject:
        first = next((item for item in raw.tolist() if not is_missing(item)), None)
        if isinstance(first, tuple) or (
            isinstance(first, str) and not is_number_text(first)
        ):
            return _match_names(raw, label, names)
    if kind == "integers":
        return _check_integers(raw, label, high)
    return (
        _check_flags(raw, label) if kind == "booleans" else _check_numbers(raw, label)
    )


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
    limit = (
        f"must be below 2**{high.bit_length() - 1}"
        if high >= 2**53
        else f"must be in {low}..{high - 1}"
    )
    rules = {
        "must be an integer": odd,
        f"must be at least {low}": is_low,
        limit: is_high,
    }
    return np.where(odd | is_low | is_high, 0, numbers).astype(np.int64), find_fault(
        label, raw, rules
    )


def _check_numbers(raw: Column, label: str) -> tuple[Array, Fault | None]:
    """Check finite numbers, probabilities from 0 to 1; a reward may be missing."""
    low, high = (0.0, 1.0) if label == "behavior_probability" else (-np.inf, np.inf)
    numbers = to_numbers(raw).astype(np.float64, copy=False)
    is_good = np.isfinite(numbers) & (numbers >= low) & (numbers <= high)
    if is_good.all():
        return numbers, None
    if label == "reward":
        is_good |= np.array(
            [is_missing(value) or value == "nan" for value in raw.tolist()]
        )
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
    numbers = np.array(
        [known.get(str(item), -1) for item in raw.tolist()], dtype=np.int64
    )
    rules = {
        "must have a value": missing,
        "must be one of the simulator's names": numbers < 0,
    }
    fault = find_fault(label, raw, rules, has_names=True)
    if fault is not None and not is_missing(fault.value):
        fault = fault._replace(hint=suggest_name(fault.value, names))
    return np.maximum(numbers, 0), fault


def find_repeat(names: Column, rows: IntArray) -> tuple[int, str] | None:
    """Return the first row in which an episode begins again, and the words for it.

    ``rows``: where episodes of these ``names`` begin.
    """
    unique, index = np.unique(names, return_index=True)
    if len(unique) == len(names):
        return None
    k = int(np.setdiff1d(np.arange(len(names)), index)[0])
    name = names[k].item() if isinstance(names[k], np.generic) else names[k]
    rule = "episode must keep the rows of an episode together"
    return int(rows[k]), f"{rule}; {_checks.show(name)} begins again in row {rows[k]}"


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
    faults = []
    if "timestep" in columns:
        expected = np.where(is_first, 0, before["timestep"] + 1)
        jumps = (is_first | follows) & (columns["timestep"] != expected)
        rule = (
            f"must be {expected[jumps.argmax()]} (steps of an episode in order from 0)"
        )
        faults.append(find_fault("timestep", columns["timestep"], {rule: jumps}))
    rows = np.flatnonzero(follows & differs(before["next_state"], columns["state"]))
    if rows.size:
        state, next_state = (
            show(column[rows[0]]) for column in (columns["state"], before["next_state"])
        )
        rule = f"must be the state of the next row of its episode, which is {state}"
        rule += " (or one of the two names is misspelt)" * isinstance(state, str)
        faults.append(Fault("next_state", rows, rule, next_state, shift=-1))
    for label in ("terminated", "truncated"):
        rows = np.flatnonzero(follows & before[label]) if label in columns else rows[:0]
        if rows.size:
            faults.append(
                Fault(
                    label,
                    rows,
                    "must be False: its episode continues in the next row",
                    True,
                    shift=-1,
                )
            )
    return [fault for fault in faults if fault is not None]


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
    hint = suggest_columns(
        required, given
    ) or f" (rename the columns that hold them{way})" * (len(given) >= len(required))
    raise ArgumentError(
        name, f"must have the columns {', '.join(required)}; it has {shown}{hint}"
    )


def suggest_columns(required: Sequence[str], labels: Sequence[str]) -> str:
    """Return what is to be changed: the separator, or how a label is written.

    Empty where that cannot be said.
    """
    for mark, word in SEPARATORS.items():
        if any(
            mark in label and set(_plain(label.split(mark))) & set(required)
            for label in labels[:1]
        ):
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
        for label in unknown[:N_SHOWN]
    ]
    if len(unknown) > N_SHOWN:
        named.append(f"and {len(unknown) - N_SHOWN} more")
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
    return (
        f" (did you mean {near[0]!r}?)"
        if near and quotes
        else f" (did you mean {near[0]}?)"
        if near
        else ""
    )

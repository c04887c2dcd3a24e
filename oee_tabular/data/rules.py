"""What each column of a log must hold: one check of its values for arrays, files and counts.

A check returns the values and, where some break the rule, a ``Fault``: all such rows, and the words for the first. Whoever
asks raises it, or leaves the rows out. A value is missing where it is nan or None.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array, BoolArray, Column, IntArray
from oee_tabular.mdp.naming import Name, is_number_text, numbers_of, suggest_name

KINDS = {
    "state": "integer", "action": "integer", "next_state": "integer", "reward": "number", "terminated": "flag",
    "truncated": "flag", "episode": "integer", "timestep": "integer", "behavior_probability": "number",
}  # fmt: skip
HELD = {"integer": "integers", "number": "numbers", "flag": "booleans"}
FLAG_TEXTS = {"true": True, "1": True, "1.0": True, "false": False, "0": False, "0.0": False}
NAMES_HINT = " (names take a simulator that has them: simulator=, --simulator)"
COMMA_HINT = " (write a decimal point, not a comma)"
COMMAND_HINT = " (call the column of a continuous task's commands action_0)"


class Fault(NamedTuple):
    """The rows of a column that break its rule, in their order, with the value in the first.

    ``shift``: -1 where the value is that of the row before.
    """

    label: str
    rows: IntArray
    rule: str
    value: Any
    hint: str = ""
    shift: int = 0

    def describe(self, row: int | None = None) -> str:
        """The place, the rule and the value; ``row``: the number of the first row, where it has another in its file."""
        place = f"{self.label}[{(self.rows[0] if row is None else row) + self.shift}]"
        if is_missing(self.value):
            return f"{place} must have a value; it has none"
        return f"{place} {self.rule}; it is {show_value(self.value)}{self.hint}"


def count_others(fault: Fault) -> str:
    """How many rows break the rule, in words, where more than one does."""
    return f" ({len(fault.rows)} such rows in all)" if len(fault.rows) > 1 else ""


def is_missing(value: Any) -> bool:
    """Whether a value is none."""
    return value is None or (isinstance(value, float) and math.isnan(value))


def show_value(value: Any) -> str:
    """A value as errors print it: texts that are no numbers in quotes."""
    return (
        value.strip() if isinstance(value, str) and is_number_text(value) and len(value) < 80 else _checks.show(value)
    )


def find_fault(label: str, raw: Column, bad: BoolArray, rule: Callable[[int], str]) -> Fault | None:
    """The fault of the rows that are ``bad``, if any; ``rule(row)``: what the value of the first breaks."""
    rows = np.flatnonzero(bad)
    if not rows.size:
        return None
    value = raw[rows[0]]
    value = value.item() if isinstance(value, np.generic) else value
    is_comma = isinstance(value, str) and re.fullmatch(r"\s*-?\d+,\d+\s*", value)
    is_command = label.endswith("action") and _parse_number(value) % 1 > 0  # nan where it is no number
    hint = COMMA_HINT if is_comma else COMMAND_HINT if is_command else ""
    return Fault(label, rows, rule(int(rows[0])), value, hint)


def to_numbers(raw: Column) -> Column:
    """Numbers; of texts those that they write, and nan for a text that writes none."""
    if raw.dtype.kind in "iuf":
        return raw
    numbers = np.array([_parse_number(item) for item in raw.tolist()])
    return numbers.astype(np.float64) if numbers.dtype.hasobject or not numbers.size else numbers


def _parse_number(item: Any) -> int | float:
    """An int where it is written as one, for a float does not hold it from 2**53 on."""
    if not isinstance(item, str):
        return item if isinstance(item, int | float) and not isinstance(item, bool) else math.nan
    try:
        return math.nan if "_" in item else int(item) if item.isdecimal() else float(item)
    except ValueError:
        return math.nan


def check_array(value: object, label: str) -> Column:
    """A column that is given as an array or a list; ValueError with the row, the rule and the value found."""
    kind = KINDS[label]
    if kind == "number":
        array: Column = _checks.float_array(value, label, ndim=1)
    else:
        array = _checks.as_array(value, label, f"a column of {HELD[kind]}")
    if array.ndim != 1:
        raise ValueError(f"{label} must have 1 dimension; it has shape {array.shape}")
    if kind == "integer" and array.size and array.dtype.kind not in "iuf":
        texts = " (numbers written as text? .astype(int))" if array.dtype.kind in "UO" else ""
        raise ValueError(f"{label} must hold integers; it holds {array.dtype}{texts}")
    values, fault = check_column(array, label)
    if fault is not None:
        raise ValueError(fault.describe())
    return values


def check_column(
    raw: Column, label: str, *, high: int = 2**63, names: tuple[Name, ...] | None = None
) -> tuple[Column, Fault | None]:
    """The values of a column by its label, and what is wrong with them; labels that a log does not know are numbers.

    ``high``: integers are below it. ``names``: those that may stand in place of numbers, which they become; empty: any, which
    stay; None: none.
    """
    kind = KINDS.get(label, "number")
    if names is not None and raw.dtype.hasobject and _holds_names(raw):
        return _match_names(raw, label, names)
    if kind == "integer":
        return _check_integers(raw, label, None if label == "episode" else 0, high)
    if kind == "flag":
        return _check_flags(raw, label)
    return _check_numbers(raw, label)


def _check_integers(raw: Column, label: str, low: int | None, high: int) -> tuple[IntArray, Fault | None]:
    """Integers in low..high - 1, and 0 in place of what is none."""
    if raw.dtype == np.int64 and raw.size and (low is None or raw.min() >= low) and raw.max() < high:
        return raw, None
    numbers = to_numbers(raw)
    odd = np.zeros(len(numbers), dtype=np.bool_)
    if numbers.dtype.kind == "f":
        odd = ~((np.abs(numbers) <= 2.0**53) & (numbers == np.floor(numbers)))
    outside = (numbers >= high) | (numbers < low) if low is not None else numbers >= high
    bad = odd | outside

    def rule(row: int) -> str:
        if odd[row]:
            return "must be an integer"
        if low is not None and numbers[row] < low:
            return f"must be at least {low}"
        return "must be below " + f"2**{high.bit_length() - 1}" if high >= 2**53 else f"must be in {low}..{high - 1}"

    return np.where(bad, 0, numbers).astype(np.int64), find_fault(label, raw, bad, rule)


def _check_numbers(raw: Column, label: str) -> tuple[Array, Fault | None]:
    """Finite numbers, probabilities from 0 to 1; a reward may be missing."""
    low, high = (0.0, 1.0) if label == "behavior_probability" else (-np.inf, np.inf)
    numbers = to_numbers(raw).astype(np.float64, copy=False)
    is_good = np.isfinite(numbers) & (numbers >= low) & (numbers <= high)
    if is_good.all():
        return numbers, None
    if label == "reward":
        is_good |= np.array([is_missing(value) or value == "nan" for value in raw.tolist()])
    rule = "must be finite" if low == -np.inf else f"must be in [{low:g}, {high:g}]"
    return numbers, find_fault(label, raw, ~is_good, lambda row: rule)


def _check_flags(raw: Column, label: str) -> tuple[BoolArray, Fault | None]:
    """Booleans, 0 and 1, or texts of these."""
    if raw.dtype.kind == "b":
        return raw, None
    if raw.dtype.kind in "iuf":
        flags, bad = raw == 1, (raw != 0) & (raw != 1)
    else:
        known = [FLAG_TEXTS.get(str(item).strip().lower()) for item in raw.tolist()]
        flags, bad = np.array([flag is True for flag in known]), np.array([flag is None for flag in known])
    return flags, find_fault(label, raw, bad, lambda row: "must be a boolean (or 0 or 1)")


def _holds_names(raw: Column) -> bool:
    """Whether the first value of a column of objects is a text that is no number."""
    first = next((item for item in raw.tolist() if not is_missing(item)), None)
    return isinstance(first, str) and not is_number_text(first)


def _match_names(raw: Column, label: str, names: tuple[Name, ...]) -> tuple[Column, Fault | None]:
    """Names as their numbers; numbers as texts are none of them."""
    missing = np.array([is_missing(item) for item in raw.tolist()], dtype=np.bool_)
    if not names:
        return raw, find_fault(label, raw, missing, lambda row: "must have a value")
    known = numbers_of(names)
    numbers = np.array([known.get(str(item), -1) for item in raw.tolist()], dtype=np.int64)
    numbers[missing] = -1
    fault = find_fault(label, raw, numbers < 0, lambda row: "must be one of the simulator's names")
    if fault is not None and not is_missing(fault.value):
        fault = fault._replace(hint=suggest_name(fault.value, names))
    return np.maximum(numbers, 0), fault


def find_repeat(names: Column, rows: IntArray) -> tuple[int, str] | None:
    """The first row, of ``rows`` where episodes of these names begin, whose episode began before, and the words for it."""
    unique, index = np.unique(names, return_index=True)
    if len(unique) == len(names):
        return None
    k = int(np.setdiff1d(np.arange(len(names)), index)[0])
    name = names[k].item() if isinstance(names[k], np.generic) else names[k]
    rule = "episode must keep the rows of an episode together"
    return int(rows[k]), f"{rule}; {_checks.show(name)} begins again in row {rows[k]}"


def find_order_faults(
    columns: dict[str, Any],
    before: dict[str, Any],
    is_first: BoolArray,
    follows: BoolArray,
    is_apart: Callable[[Any, Any], Any] = np.not_equal,
    show: Callable[[Any], Any] = operator.methodcaller("tolist"),
) -> list[Fault]:
    """The rows that do not continue the episode of the row before them.

    Parameters
    ----------
    columns : state and episode, and of timestep, terminated and truncated those that there are
    before : the same and next_state, of the row before each
    is_first, follows : (n,) whether a row begins an episode, and whether it goes on with the one of the row before; neither
        where nothing is known of that row
    is_apart : whether a next_state and the state after it differ; ``show``: a state as errors print it
    """
    faults = []
    if "timestep" in columns:
        expected = np.where(is_first, 0, before["timestep"] + 1)
        jumps = (is_first | follows) & (columns["timestep"] != expected)
        rule = "must be {} (steps of an episode in order from 0)"
        faults.append(find_fault("timestep", columns["timestep"], jumps, lambda row: rule.format(expected[row])))
    apart = follows & is_apart(before["next_state"], columns["state"])
    rows = np.flatnonzero(apart)
    if rows.size:
        state, next_state = (show(column[rows[0]]) for column in (columns["state"], before["next_state"]))
        rule = f"must be the state of the next row of its episode, which is {state}"
        rule += " (or one of the two names is misspelt)" * isinstance(state, str)
        faults.append(Fault("next_state", rows, rule, next_state, shift=-1))
    for label in ("terminated", "truncated"):
        rows = np.flatnonzero(follows & before[label]) if label in columns else rows[:0]
        if rows.size:
            faults.append(Fault(label, rows, "must be False: its episode continues in the next row", True, shift=-1))
    return [fault for fault in faults if fault is not None]

"""Columns of a log: their labels, and what each must hold in arrays, tables and counts.

A check returns the values and, where some break the rule, a ``Fault``: all such rows,
and the words for the first. Whoever asks raises it, or leaves the rows out. A value is
missing where it is nan or None, and in tables where it is one of ``MISSING_WORDS``, as
R, SQL, Julia and pandas write it. In tables, a text is the number that it writes, or
the name that it is; episodes are texts unless they are integers as Python writes them,
so that "7" and "007" differ.
"""

from __future__ import annotations

import decimal
import difflib
import fractions
import math
import operator
import re
from collections.abc import Callable, Container, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from oee_tabular import _checks
from oee_tabular.data.aliases import FIELDS, plain
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import Name, is_number_text, numbers_of, suggest_name, to_plain
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
# what a whole reading says to bad rows of a file of transitions
WAY = (
    " (to leave such rows out and let them lead anywhere: Transitions.open(...,"
    " bad_rows='drop'), oee counts --bad-rows drop)"
)
# the same of a word for a missing value that may be the name of a state or action
NAME_WAY = (
    " (where it is a name, give the simulator that has it: Problem(simulator, path),"
    " Transitions.open(..., simulator=), --simulator)"
)
# the same of rows that do not follow each other, where a column may be the wrong one
ORDER_WAY = (
    " (make sure first that episode, timestep, state and next_state are the right"
    " columns; Transitions.open(..., bad_rows='drop') and oee counts --bad-rows drop"
    " count such rows as they are, in episodes that are not whole)"
)
# in small letters, without blanks around; numbers that are 0 or 1 are flags as well
FLAG_WORDS = {
    "true": True,
    "t": True,
    "yes": True,
    "y": True,
    "false": False,
    "f": False,
    "no": False,
    "n": False,
}
# what programs write for no value, in small letters, without blanks around
MISSING_WORDS = frozenset(
    {
        "",
        "nan",
        "-nan",
        "+nan",
        "na",
        "n/a",
        "#n/a",
        "#na",
        "#n/a n/a",
        "<na>",
        "nat",
        "null",
        "none",
        "nil",
        "missing",
        "undefined",
        "\\n",
        ".",
        "1.#ind",
        "-1.#ind",
        "1.#qnan",
        "-1.#qnan",
    }
)


MAX_INTEGER_TEXT = 300  # characters, below those of the largest float
MUST_HAVE = "must have a value"
DECIMAL_POINT = " (write a decimal point, not a comma)"
NO_NAMES: Mapping[str, tuple[Name, ...] | None] = {}


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
            return f"must have a value; it has none{self.hint}"
        text = self.value.strip() if isinstance(self.value, str) else ""
        # a number is shown without quotes
        is_number = bool(text) and len(text) < 80 and is_number_text(text)
        shown = text if is_number else _checks.show(self.value)
        return f"{self.rule}; it is {shown}{self.hint}"

    def with_text(self, text: object) -> Fault:
        """Return the fault with its value as the file writes it, where it is known."""
        if not isinstance(text, str) or not text or isinstance(self.value, str):
            return self
        rule = MUST_HAVE if is_absent(text) else self.rule
        return self._replace(value=text, rule=rule)

    def to_error(self, source: str = "", *, has_count: bool = True) -> ArgumentError:
        """Return the error of the first row, of a table where ``source`` names one.

        ``has_count``: whether it says how many rows break the rule.
        """
        place = f"{source}: {self.place()}" if source else self.place()
        others = _checks.in_all(len(self.rows), "such rows") if has_count else ""
        return ArgumentError(place, f"{self.problem()}{others}")


def as_objects(items: Sequence[Any]) -> Column:
    """Return names as an array of objects, tuples whole."""
    array = np.empty(len(items), dtype=object)
    array[:] = items
    return array


def is_missing(value: Any) -> bool:
    """Return whether a value is None or nan."""
    if isinstance(value, float | np.floating):
        return bool(value != value)
    return value is None or (isinstance(value, decimal.Decimal) and value.is_nan())


def is_absent(value: Any, own: Container[Any] = ()) -> bool:
    """Return whether a table's value is missing, or one of the words for that.

    ``own``: names of the simulator, which are no such words.
    """
    if not isinstance(value, str):
        return is_missing(value)
    return value.strip().lower() in MISSING_WORDS and value not in own


def find_fault(
    label: str,
    raw: Column,
    rules: Mapping[str, BoolArray],
    *,
    has_names: bool = False,
    own: Container[Any] = (),
) -> Fault | None:
    """Return the fault of the rows that break one of the rules, or None.

    ``rules``: by the words of each rule, the rows that break it. ``own``: names that
    no word for a missing value is.
    """
    rows = np.flatnonzero(np.any(list(rules.values()), axis=0))
    if not rows.size:
        return None
    first = rows[0]
    rule = next(rule for rule, is_broken in rules.items() if is_broken[first])
    value = raw[first].item() if isinstance(raw[first], np.generic) else raw[first]
    if is_absent(value, own):
        if isinstance(value, str) and not value.strip():
            value = None
        return Fault(label, rows, MUST_HAVE, value)
    hint = _suggest_value(value, label, has_names)
    is_word = isinstance(value, str) and not is_number_text(value)
    is_first = first == 0 and rows.size == 1 and len(raw) > 1
    if is_first and is_word and not hint and label not in MOVE:
        hint = " (a row of units below the header? Leave it out)"
    return Fault(label, rows, rule, value, hint)


def _suggest_value(value: Any, label: str, has_names: bool) -> str:
    """Return a hint for the value that breaks a rule, in words; empty without one."""
    kind = KINDS.get(label, "numbers")
    if isinstance(value, str) and not is_number_text(value):
        if kind == "numbers":
            return _suggest_number(value.strip())
        if kind == "booleans":
            return " (write true and false, yes and no, or 1 and 0)"
    if isinstance(value, str) and re.fullmatch(r"\s*-?\d+,\d+\s*", value):
        return DECIMAL_POINT
    # nan, which is not above 0, where it is no number
    if label.endswith("action") and _parse_number(value) % 1 > 0:
        return " (call the column of a continuous task's commands action_0)"
    is_word = isinstance(value, str) and value.strip()[:1].isalpha()
    is_word = is_word and not is_number_text(value)
    if label in MOVE and is_word and not has_names:
        return " (names take a simulator that has them: simulator=, --simulator)"
    return ""


def _suggest_number(text: str) -> str:
    """Return how to write the number that a text means, in words."""
    if re.fullmatch(r"[-+]?\d+,\d+", text):
        return DECIMAL_POINT
    if re.fullmatch(r"[-+]?\d{1,3}(,\d{3})+(\.\d*)?", text):
        return " (write it without commas: pandas.read_csv(path, thousands=','))"
    if re.fullmatch(r"[\u2212\u2013\u2012]\s*[\d.]+", text):
        return " (write the minus as a hyphen: -1)"
    if re.fullmatch(r"\([\d.]+\)", text):
        return " (write a minus, -1, in place of parentheses)"
    unit = r"[^\d\s.,+()-]+"
    if re.fullmatch(rf"[-+]?[\d.,]+\s*{unit}|{unit}\s*[-+]?[\d.,]+", text):
        return " (write the number alone, without its unit)"
    return ""


def to_numbers(raw: Column) -> Column:
    """Return numbers; a text becomes the number that it writes, or nan."""
    if raw.dtype.kind in "iuf":
        return raw
    numbers = np.array(for_each(_parse_number, raw.tolist()))
    # integers beyond 64 bits are objects
    if numbers.dtype.hasobject or not numbers.size:
        return numbers.astype(np.float64)
    return numbers


def for_each(function: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
    """Apply a function to each item, once for equal texts.

    A column of a million texts has few distinct ones, and a table of these is read by
    ``map`` without a step of Python for each item.
    """
    if set(map(type, items)) == {str}:
        results = {text: function(text) for text in dict.fromkeys(items)}
        return list(map(results.__getitem__, items))
    known: dict[str, Any] = {}
    found = []
    for item in items:
        if type(item) is not str:
            found.append(function(item))
            continue
        if item not in known:
            known[item] = function(item)
        found.append(known[item])
    return found


def _parse_number(item: Any) -> int | float:
    """Return the number that an item is or writes, or nan.

    An int stays one, since a float does not hold all from 2**53 on; one beyond all
    floats is infinite.
    """
    if isinstance(item, np.generic | np.ndarray) and not item.ndim:
        item = item.item()
    if isinstance(item, str):
        return _parse_text(item)
    if isinstance(item, decimal.Decimal | fractions.Fraction):
        is_integer = _is_finite(item) and item == int(item)
        return _within_floats(int(item)) if is_integer else _to_float(item)
    if isinstance(item, bool):
        return math.nan
    if isinstance(item, int):
        return _within_floats(item)
    return item if isinstance(item, float) else math.nan


def _within_floats(number: int) -> int | float:
    """Return an integer, or an infinity where it is beyond all floats."""
    try:
        float(number)
    except OverflowError:
        return math.inf if number > 0 else -math.inf
    return number


def _is_finite(item: decimal.Decimal | fractions.Fraction) -> bool:
    """Return whether a number is finite, and small enough to be looked at as an int."""
    if isinstance(item, decimal.Decimal):
        return item.is_finite() and item.adjusted() < 25
    return True


def _to_float(item: decimal.Decimal | fractions.Fraction) -> float:
    """Return a number as a float; nan where none stands for it."""
    try:
        return float(item)
    except (ValueError, OverflowError):  # a signaling nan; a large fraction
        return math.nan


def _parse_text(text: str) -> int | float:
    """Return the number that a text writes, or nan."""
    if "_" in text:  # which Python's own literals may have
        return math.nan
    try:
        is_integer = text.strip().lstrip("+-").isdecimal()
        # Python reads no int of more than some thousand digits, but any float
        if is_integer and len(text) < MAX_INTEGER_TEXT:
            return int(text)
        return float(text)
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
        if label == "behavior_probability":
            array = _checks.clip_if_single(array, value)
    else:
        array = _checks.as_array(value, label, f"a column of {kind}")
    if array.ndim != 1:
        raise ArgumentError(label, f"must have 1 dimension; it has shape {array.shape}")
    if kind == "integers" and array.size and array.dtype.kind not in "iuf":
        names = ""
        if label in ("state", "next_state"):
            names = " (names? state and next_state must both hold names, or numbers)"
        _checks.refuse_text(value, label, "hold integers", "int", names)
        if not array.dtype.hasobject:
            raise ArgumentError(label, f"must hold integers; it holds {array.dtype}")
        for k, item in enumerate(array.tolist()):
            if isinstance(item, str) or math.isnan(_parse_number(item)):
                raise ArgumentError(
                    f"{label}[{k}]", f"must be an integer; it is {_checks.show(item)}"
                )
    values, fault = check_column(array, label)
    if fault is not None:
        raise fault.to_error(has_count=False)
    return values


def check_table(
    columns: Mapping[str, Column],
    source: str,
    *,
    names: Mapping[str, tuple[Name, ...] | None] = NO_NAMES,
    find_text: Callable[[str, int], Any] | None = None,
    way: str = "",
) -> dict[str, Column]:
    """Return the values of a table's columns; names and episodes may be texts.

    Episodes are to be settled (``settle_episodes``). Raises an ArgumentError for the
    first fault.

    Parameters
    ----------
    columns : mapping of str to ndarray
        The raw columns.
    source : str
        What errors call the table.
    names : mapping of str to tuple, optional
        By the label of a column, the names that the simulator has, which are no words
        for a missing value. They stay in their columns.
    find_text : callable, optional
        Returns the text of a field by its label and row, as the file writes it.
    way : str, default ''
        What errors of missing values add: how to leave them out.
    """
    headers = find_headers(columns, list(columns))
    if headers.size:
        row = int(headers[0])
        raise ArgumentError(f"{source}: row {row}", HEADER_RULE)
    values = {}
    for label, raw in columns.items():
        own = numbers_of(names.get(label) or ())
        called = () if label in MOVE else None
        values[label], fault = check_column(raw, label, names=called, own=own)
        if fault is not None:
            if find_text is not None:
                fault = fault.with_text(find_text(label, int(fault.rows[0])))
            if is_absent(fault.value, own):
                is_name = label in MOVE and isinstance(fault.value, str) and not own
                fault = fault._replace(hint=way + NAME_WAY if is_name else way)
            raise fault.to_error(source)
    _require_one_kind(values, source)
    return values


# how like a label a misspelt one is, by difflib: next_stat is, as 0.95
NEAR = 0.85
# of logs, policies, trials and simulators' tables alike
HEADER_RULE = (
    "must hold the values of its columns; it holds the labels of the columns again"
    " (leave that line out; to read several files of a log, which need not be joined by"
    " hand, give the files as a list)"
)


def find_headers(columns: Mapping[str, Column], labels: Sequence[str]) -> IntArray:
    """Return the rows that hold labels of the columns, own ones or other projects'."""
    return np.union1d(_find_own_labels(columns, labels), _find_other_labels(columns))


def _find_other_labels(columns: Mapping[str, Column]) -> IntArray:
    """Return the rows whose state, action and next state each are a label of these.

    One of them may be misspelt. A row is no header where another row holds one of its
    labels of states as well: states may be called s and s1.
    """
    none = np.zeros(0, dtype=np.int64)
    if not all(label in columns and columns[label].dtype.hasobject for label in MOVE):
        return none

    def likeness(item: Any, label: str) -> float:
        """Return how much a value is like a label of a column, 1 where it is one."""
        text = plain(item[:100]) if isinstance(item, str) else ""
        if FIELDS.get(text) == label:
            return 1
        if abs(len(text) - len(label)) > 2:  # which is known at once
            return 0
        ratio = difflib.SequenceMatcher(None, text, label).ratio()
        return ratio if ratio > NEAR else 0

    # nearly all logs have no action of such a name, which takes one look at each name
    actions = columns["action"].tolist()
    names_of_actions = {item for item in actions if isinstance(item, str)}
    if not any(likeness(name, "action") for name in names_of_actions):
        return none
    rows = np.arange(len(columns["state"]))
    total = np.zeros(len(rows))
    for label in sorted(MOVE):
        values = columns[label][rows].tolist()
        found = np.array(for_each(partial(likeness, label=label), values), dtype=float)
        is_kept = found > 0
        rows = rows[is_kept]
        total = total[is_kept] + found[is_kept]
    rows = rows[total > len(MOVE) - 1 + NEAR]
    if not rows.size:
        return none
    is_other = np.ones(len(columns["state"]), dtype=np.bool_)
    is_other[rows] = False
    names: set[Any] = set()
    for label in MOVE[::2]:
        names.update(columns[label][is_other].tolist())
    pairs = zip(columns["state"][rows], columns["next_state"][rows], strict=True)
    return rows[[names.isdisjoint(pair) for pair in pairs]]


def _find_own_labels(columns: Mapping[str, Column], labels: Sequence[str]) -> IntArray:
    """Return the rows of raw columns that hold labels of the columns.

    A label that is a number is left aside: the same number below it is a value.
    """
    none = np.zeros(0, dtype=np.int64)
    if not columns or not all(column.dtype.hasobject for column in columns.values()):
        return none
    words = {plain(label) for label in labels}
    words = {word for word in words if not is_number_text(word)}

    def is_label(item: Any) -> bool:
        """Return whether a value is a label."""
        return isinstance(item, str) and plain(item[:100]) in words

    first, *others = columns.values()
    rows = np.flatnonzero(np.array(for_each(is_label, first.tolist()), dtype=np.bool_))
    for column in others:
        rows = np.array([row for row in rows if is_label(column[row])], dtype=np.int64)
    return rows


def _require_one_kind(values: Mapping[str, Column], source: str) -> None:
    """Raise an ArgumentError where one of state and next_state alone holds names."""
    if not {"state", "next_state"} <= set(values):
        return
    named = [
        label
        for label in ("state", "next_state")
        if values[label].dtype.hasobject and len(values[label])
    ]
    if len(named) != 1:
        return
    other = "next_state" if named == ["state"] else "state"
    raise ArgumentError(
        f"{source}: {named[0]}[0]",
        f"must be a number, as those of {other} are; it is"
        f" {_checks.show(values[named[0]][0])} (write the states of both columns as"
        " names, or those of both as numbers)",
    )


def check_column(
    raw: Column,
    label: str,
    *,
    high: int = 2**63,
    names: tuple[Name, ...] | None = None,
    own: Container[Any] = (),
) -> tuple[Column, Fault | None]:
    """Return the values of a column by its label, and its fault or None.

    Labels that a log does not know are numbers. ``high``: integers are below it.
    ``names``: those that may stand in place of numbers, which they become; empty: any,
    which stay; None: none. ``own``: names that no word for a missing value is.
    """
    kind = KINDS.get(label, "numbers")
    if raw.dtype.kind in "MmUST":  # dates are no numbers and no names
        names = None if raw.dtype.kind in "Mm" else names
        raw = raw.astype(str).astype(object)
    if label == "episode":
        return _check_episodes(raw)
    # truth values are texts, as in CSV
    if kind != "booleans" and raw.dtype.kind in "bO":
        items = raw.tolist()
        if not {bool, np.bool_}.isdisjoint(map(type, items)):
            raw = as_objects([_flag_as_text(item) for item in items])
    if names is not None and raw.dtype.hasobject:
        return _check_names(raw, label, high, names, own)
    if kind == "integers":
        return _check_integers(raw, label, high)
    if kind == "booleans":
        return _check_flags(raw, label)
    return _check_numbers(raw, label)


def _flag_as_text(item: Any) -> Any:
    """Return a truth value as a text, and any other value unchanged."""
    return str(item) if isinstance(item, bool | np.bool_) else item


def _check_episodes(raw: Column) -> tuple[Column, Fault | None]:
    """Check the ids of episodes: integers, or texts as they are written.

    A text is a number only where that is how Python writes it: "7", not "007" or "7.0".
    The same texts are the same episode, and others are others. A number with a point
    that is no integer is refused, as it is where columns are mistaken.
    """
    if not raw.dtype.hasobject:
        return _check_integers(
            raw.astype(np.int64) if raw.dtype.kind == "b" else raw, "episode", 2**63
        )
    items = raw.tolist()
    found = for_each(parse_episode, items)
    bad = np.array([item is None for item in found], dtype=np.bool_)
    is_large = bad.copy()
    is_large[bad] = [abs(_parse_number(items[k])) >= 2**63 for k in np.flatnonzero(bad)]
    rules = {"must be in -2**63..2**63 - 1": is_large, "must be an integer": bad}
    fault = find_fault("episode", raw, rules)
    if all(type(item) is int for item in found):
        return np.array(found, dtype=np.int64), fault
    return as_objects([0 if item is None else item for item in found]), fault


def parse_episode(item: Any) -> int | str | None:
    """Return the id of an episode, an integer or a text; None for what is none."""
    # most ids, in a fifth of the time
    if type(item) is str and len(item) < 19 and item.isascii() and item.isdecimal():
        return int(item) if item[0] != "0" or item == "0" else item
    if is_absent(item):
        return None
    number = _parse_number(item)
    if not isinstance(item, str):
        # infinities and nan lie outside
        is_id = -(2**63) <= number < 2**63 and number == math.floor(number)
        return int(number) if is_id else None
    text = item.strip()
    if isinstance(number, int) and -(2**63) <= number < 2**63 and str(number) == text:
        return number
    if "." in text and number % 1 > 0:
        return None
    return text


def settle_episodes(episodes: Column) -> Column:
    """Return a whole log's ids of episodes, all integers or all texts.

    Texts become the integers that they write where these differ as the texts do.
    """
    if not episodes.dtype.hasobject:
        return episodes
    texts = [str(item) for item in episodes.tolist()]
    number: dict[str, int | float] = {text: _parse_text(text) for text in set(texts)}
    numbers = set(number.values())
    is_integers = all(
        n == n and abs(n) < 2.0**53 and n == math.floor(n) for n in numbers
    )
    if is_integers and len(numbers) == len(number):
        return np.array([int(number[text]) for text in texts], dtype=np.int64)
    return as_objects(texts)


def _check_integers(
    raw: Column, label: str, high: int
) -> tuple[IntArray, Fault | None]:
    """Check integers from 0 (of episodes any) and below ``high``; others become 0."""
    low = -(2**63) if label == "episode" else 0
    if raw.dtype == np.int64 and raw.size and raw.min() >= low and raw.max() < high:
        return raw, None
    numbers = to_numbers(raw)
    odd = np.zeros(len(numbers), dtype=np.bool_)
    is_rounded = odd
    digits = _binary_digits(raw)
    if numbers.dtype.kind == "f":
        numbers = numbers.astype(np.float64, copy=False)  # half precision ends at 65504
        odd = ~(np.isfinite(numbers) & (numbers == np.floor(numbers)))
        if raw.dtype.hasobject:  # an integer beyond all floats is too large
            for k in np.flatnonzero(np.isinf(numbers)):
                odd[k] = isinstance(raw[k], str | float)
        is_rounded = ~odd & (np.abs(numbers) >= 2.0**digits)
    is_low = numbers < low
    is_high = numbers >= high
    limit = f"must be in {low}..{high - 1}"
    if high >= 2**53:
        limit = f"must be below 2**{high.bit_length() - 1}"
    rules = {
        "must be an integer": odd,
        f"must be at least {low}": is_low,
        limit: is_high,
        f"must be an integer of 64 bits, or below 2**{digits}, from where a float does"
        " not hold each": is_rounded,
    }
    values = np.where(odd | is_low | is_high | is_rounded, 0, numbers).astype(np.int64)
    return values, find_fault(label, raw, rules)


def _binary_digits(raw: Column) -> int:
    """Return how many binary digits the numbers of a column hold, at most 53."""
    if raw.dtype.kind != "f":
        return 53
    return int(min(np.finfo(raw.dtype).nmant + 1, 53))


def _check_numbers(raw: Column, label: str) -> tuple[Array, Fault | None]:
    """Check finite numbers, probabilities from 0 to 1; a reward may be missing."""
    low, high = (0.0, 1.0) if label == "behavior_probability" else (-np.inf, np.inf)
    numbers = to_numbers(raw).astype(np.float64, copy=False)
    if high == 1.0:
        numbers = _checks.clip_if_single(numbers, raw)
    is_good = np.isfinite(numbers) & (numbers >= low) & (numbers <= high)
    if is_good.all():
        return numbers, None
    if label == "reward":
        is_good |= _find_absent(raw)
    rule = "must be finite" if low == -np.inf else f"must be in [{low:g}, {high:g}]"
    is_word = np.full(len(raw), raw.dtype.kind == "c")
    if raw.dtype.hasobject:
        odd = np.flatnonzero(~is_good)
        is_word[odd] = [_is_other(item) for item in raw[odd].tolist()]
    rules = {"must be a number": ~is_good & is_word, rule: ~is_good & ~is_word}
    return numbers, find_fault(label, raw, rules)


def _find_absent(raw: Column) -> BoolArray:
    """Return for each value whether it is missing."""
    if raw.dtype.kind == "f":
        return np.isnan(raw)
    return np.array(for_each(is_absent, raw.tolist()), dtype=np.bool_)


def _check_flags(raw: Column, label: str) -> tuple[BoolArray, Fault | None]:
    """Check booleans, 0 and 1, or texts of these."""
    if raw.dtype.kind == "b":
        return raw, None
    if raw.dtype.kind in "iuf":
        flags = raw == 1
        bad = (raw != 0) & (raw != 1)
    else:
        known = for_each(parse_flag, raw.tolist())
        flags = np.array([flag is True for flag in known], dtype=np.bool_)
        bad = np.array([flag is None for flag in known], dtype=np.bool_)
    return flags, find_fault(label, raw, {"must be a boolean (or 0 or 1)": bad})


def parse_flag(item: Any) -> bool | None:
    """Return the truth value that an item is or writes, or None."""
    if isinstance(item, bool | np.bool_):
        return bool(item)
    if isinstance(item, str) and item.strip().lower() in FLAG_WORDS:
        return FLAG_WORDS[item.strip().lower()]
    number = _parse_number(item)
    return bool(number) if number in (0, 1) else None


def _check_names(
    raw: Column,
    label: str,
    high: int,
    names: tuple[Name, ...],
    own: Container[Any],
) -> tuple[Column, Fault | None]:
    """Check a column of objects, which are names or numbers, but not both.

    All values tell which they are. ``names`` and ``own`` are those of
    ``check_column``.
    """
    known = numbers_of(names) if names else own
    raw = as_objects(for_each(_plain_name, raw.tolist()))
    is_none = np.array(
        for_each(lambda item: is_absent(item, known), raw.tolist()), dtype=np.bool_
    )
    is_named = np.array(for_each(_is_no_number, raw.tolist()), dtype=np.bool_)
    is_named &= ~is_none
    n_named = int(is_named.sum())
    if n_named == 0:
        return _check_integers(raw, label, high)
    if names:
        return _match_names(raw, label, names, is_none)
    n = len(raw) - int(is_none.sum())
    if 2 * n_named > n:
        rules = {
            MUST_HAVE: is_none,
            "must be a name, as most of its column are": ~(is_named | is_none),
        }
        return raw, find_fault(label, raw, rules, has_names=True, own=own)
    values, fault = _check_integers(raw, label, high)
    if fault is not None and n > n_named and _is_no_number(fault.value):
        hint = f" ({n - n_named} of the column's {n} values are numbers, not names)"
        fault = fault._replace(hint=hint)
    return values, fault


def _plain_name(item: Any) -> Any:
    """Return a text or a tuple as names have it, and any other value unchanged."""
    return to_plain(item) if isinstance(item, str | tuple) else item


def _is_other(item: Any) -> bool:
    """Return whether an item is not a number, nor a text that writes one plainly."""
    if isinstance(item, str):
        return _is_no_number(item) or "_" in item
    if isinstance(item, bool):
        return True
    kinds = float, int, np.floating, np.integer, decimal.Decimal, fractions.Fraction
    return item is not None and not isinstance(item, kinds)


def _is_no_number(item: Any) -> bool:
    """Return whether an item is a name: a tuple, or a text that writes no number."""
    if isinstance(item, tuple):
        return True
    return isinstance(item, str) and not is_number_text(item)


def _match_names(
    raw: Column, label: str, names: tuple[Name, ...], missing: BoolArray
) -> tuple[Column, Fault | None]:
    """Return names as their numbers; numbers as texts are none of them."""
    known = numbers_of(names)
    found = for_each(lambda item: known.get(str(item), -1), raw.tolist())
    numbers = np.array(found, dtype=np.int64)
    rules = {
        MUST_HAVE: missing,
        "must be one of the simulator's names": numbers < 0,
    }
    fault = find_fault(label, raw, rules, has_names=True, own=known)
    if fault is not None and not is_absent(fault.value, known):
        fault = fault._replace(hint=suggest_name(fault.value, names))
    return np.maximum(numbers, 0), fault


MAX_PARTS = 10  # of an episode, on average; above it rows are shuffled
SORT = (
    " (its rows stand apart nearly everywhere: sort the table by episode and time, as"
    " pandas' sort_values does)"
)
# how ids that restart in each file become unique
UNIQUE = (
    " (where ids restart in each of the files that were joined, write the file's name"
    " before them: 'run1-0', 'run2-0'; files that are given as a list need nothing)"
)


def find_repeat(names: Column, rows: IntArray) -> tuple[int, str] | None:
    """Return the first row in which an episode begins again, and the broken rule.

    ``rows``: where episodes of these ``names`` begin.
    """
    unique, index = np.unique(names, return_index=True)
    if len(unique) == len(names):
        return None
    k = int(np.setdiff1d(np.arange(len(names)), index)[0])
    name = names[k].item() if isinstance(names[k], np.generic) else names[k]
    # ids that restart in each of many files begin again as often
    is_shuffled = len(names) > MAX_PARTS * len(unique)
    return int(rows[k]), (
        f"must keep the rows of an episode together; {_checks.show(name)} begins again"
        f" in row {rows[k]}{SORT if is_shuffled else UNIQUE}"
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
        Of the row before each: next_state, and those of the last three that there are.
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
    row = int(jumps.argmax())
    rule = f"must be {expected[row]} (steps of an episode in order from 0)"
    if row == 0 and jumps[0] and expected[0] == 0:
        rule = (
            "must be 0 (steps of an episode in order from 0; where another file begins"
            " this episode, give the files in the order in which they were written)"
        )
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

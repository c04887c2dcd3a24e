"""A user's table of numbers for the simulator's transitions, one a row, with states and actions by number or name.

Columns state, action, next_state, and beside them one for each feature, or one of keys.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oee_tabular._checks import Array, BoolArray, IntArray
from oee_tabular._sparse import find
from oee_tabular.data.frames import eager
from oee_tabular.data.rules import MOVE, require_columns
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.arrays import name_transition
from oee_tabular.mdp.naming import Name, number_of

NAMELESS = "Unnamed: "  # what pandas calls a column without a name
WHOLE = 2.0**53  # up to which a float is the integer that was written


def features_in(frame: Any, simulator: FiniteMDP, source: str) -> tuple[Array, list[str]]:
    """(entries, d) finite numbers on ``simulator.transitions.data``, their names; 0 for transitions not in the frame.

    ``source`` is what errors call the frame.
    """
    columns, entry = _moves_of(frame, simulator, source)
    values = np.zeros((simulator.transitions.nnz, len(columns)))
    for k, column in enumerate(columns):
        values[entry, k] = column.finite()
    return values, [column.label for column in columns]


def keys_in(frame: Any, simulator: FiniteMDP, source: str) -> NDArray[Any]:
    """(entries,) integer keys; no transition of the simulator may be left out."""
    columns, entry = _moves_of(frame, simulator, source)
    if len(columns) > 1:
        labels = words(column.label for column in columns)
        raise ValueError(f"{source} must have one column of keys beside {words(MOVE)}; it has {labels}")
    written = columns[0].integers()
    matrix = simulator.transitions
    absent = np.setdiff1d(np.arange(matrix.nnz), entry)
    if absent.size:
        first = name_transition(matrix, int(absent[0]), simulator.n_actions, simulator.names)
        raise ValueError(
            f"{source} must have a key for every transition of the simulator; {absent.size} of {matrix.nnz} have none, "
            f"the first: {first}"
        )
    keys = np.empty(matrix.nnz, dtype=written.dtype)
    keys[entry] = written
    return keys


def _moves_of(frame: Any, simulator: FiniteMDP, source: str) -> tuple[list[_Column], IntArray]:
    """The columns beside the transitions, and the entry of the simulator's transitions that each row is about."""
    table = eager(frame)
    labels = [str(label) for label in table.columns]
    require_columns(source, MOVE, labels)
    own = [label for label in labels if label not in MOVE]
    if any(label.startswith(NAMELESS) for label in own):
        raise ValueError(f"{source} must have a name for every column; it has {words(labels)} (a written index?)")
    if not own or len(table) == 0:
        rule = "a column of numbers beside its transitions" if len(table) else "at least one row"
        raise ValueError(f"{source} must have {rule}; it has none")
    columns = {label: _Column(label, source, table[label]) for label in labels}
    states = (simulator.state_names, simulator.n_states)
    sizes = (states, (simulator.action_names, simulator.n_actions), states)
    s, a, following = (columns[label].numbered(*size) for label, size in zip(MOVE, sizes, strict=True))
    entry, stored = find(simulator.transitions, s * simulator.n_actions + a, following)

    def move(row: int) -> str:
        return simulator.names.transition(s[row], a[row], following[row])

    outside = np.flatnonzero(~stored)
    if outside.size:
        more = f" ({outside.size} such rows in all)" if outside.size > 1 else ""
        raise ValueError(
            f"row {outside[0]} of {source} must be a transition of the simulator, which gives probability 0 to "
            f"{move(int(outside[0]))}{more}"
        )
    again = np.setdiff1d(np.arange(len(entry)), np.unique(entry, return_index=True)[1])
    if again.size:
        row = int(again[0])
        before = int(np.argmax(entry == entry[row]))
        raise ValueError(f"row {row} of {source} must be another transition; {move(row)} is row {before} already")
    return [columns[label] for label in own], entry


class _Column(NamedTuple):
    """A column of a data frame; its errors name it, its table and the first bad row."""

    label: str
    source: str
    series: Any

    def refuse(self, bad: BoolArray, rule: str, values: Any) -> None:
        """A ValueError where a row is ``bad``."""
        if bad.any():
            row = int(np.argmax(bad))
            shown = "none or nan" if values is None else values[row]
            raise ValueError(f"column {self.label!r} of {self.source} must {rule}; row {row} has {shown}")

    def finite(self) -> Array:
        """Finite numbers."""
        rule, values = "have a finite number in every row", np.asarray(self.series.to_numpy())
        self.refuse(self.series.is_null().to_numpy(), rule, None)
        numbers: Any = values
        if values.dtype.kind not in "biuf":
            import pandas as pd

            numbers = pd.to_numeric(pd.Series(values, dtype=object), errors="coerce").to_numpy()
        numbers = np.asarray(numbers, dtype=np.float64)
        self.refuse(~np.isfinite(numbers), rule, values)
        return np.asarray(numbers)

    def integers(self) -> NDArray[Any]:
        """Whole numbers, as integers."""
        values = np.asarray(self.series.to_numpy())
        if values.dtype.kind in "iu":
            return values
        numbers = self.finite()
        self.refuse((numbers != np.rint(numbers)) | (np.abs(numbers) >= WHOLE), "have an integer in every row", numbers)
        return numbers.astype(np.int64)

    def numbered(self, names: tuple[Name, ...] | None, size: int) -> IntArray:
        """States or actions: integers in 0..size-1, or the simulator's names where it has some."""
        values = np.asarray(self.series.to_numpy())
        if names is None or values.dtype.kind in "biuf":
            numbers = self.integers()
            self.refuse((numbers < 0) | (numbers >= size), f"be in 0..{size - 1}", numbers)
            return numbers.astype(np.int64)
        self.refuse(self.series.is_null().to_numpy(), "have a name in every row", None)
        source, code = f"column {self.label!r} of {self.source}", {}
        items = [tuple(item) if isinstance(item, list | np.ndarray) else item for item in values]
        for k, item in enumerate(items):
            if item not in code:
                code[item] = number_of(item, names, size, f"{source}, row {k},", "the simulator's")
        return np.array([code[item] for item in items], dtype=np.int64)


def words(names: Iterable[object]) -> str:
    """Names in a sentence."""
    return ", ".join(str(name) for name in names) or "none"

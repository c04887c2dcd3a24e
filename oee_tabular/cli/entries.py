"""A user's own numbers for the simulator's transitions: the files of ``--features`` and ``--tie``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oee_tabular import _files
from oee_tabular._checks import Array, BoolArray, IntArray
from oee_tabular._sparse import find, row_of_entry
from oee_tabular.data.tables import csv_frame, require_columns
from oee_tabular.estimators import Estimator, OffEnvironment
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.finite_mdp import name_move
from oee_tabular.ratio import transition_ratio

MOVE = ("state", "action", "next_state")
NAMELESS = "Unnamed: "  # what pandas calls a column without a name
WHOLE = 2.0**53  # up to which a float is the integer that was written


def own_rows(files: Mapping[str, Path | None], simulator: FiniteMDP) -> tuple[dict[str, Estimator], dict[str, str]]:
    """Rows for the report, by name, and its facts, of the files given for "features" and "tie"."""
    rows: dict[str, Estimator] = {}
    facts = {}
    if (path := files["features"]) is not None:
        features, names = features_of(path, simulator)
        rows["oee-features"] = OffEnvironment(ratio=partial(transition_ratio, features=features))
        facts["features"] = f"{path} ({', '.join(names)})"
    if (path := files["tie"]) is not None:
        keys = tie_of(path, simulator)
        rows["oee-tied"] = OffEnvironment(ratio=partial(transition_ratio, method="tied", tie=keys))
        facts["tie"] = f"{path} ({len(np.unique(keys))} keys)"
    return rows, facts


def features_of(path: Path, simulator: FiniteMDP) -> tuple[Array, list[str]]:
    """(entries, d) finite numbers on ``simulator.transitions.data``, and their names.

    A .npy holds (entries,), (entries, d), (S, A, S) or (S, A, S, d), numbered as the simulator's transitions are; what a dense
    one has where P is 0 is not looked at. A .csv has a move a row: columns state, action, next_state, and one for each
    feature, which is 0 in moves that are not in the file.
    """
    if _is_table(path, "--features"):
        columns, entry = _table(path, simulator)
        values = np.zeros((simulator.transitions.nnz, len(columns)))
        for k, column in enumerate(columns):
            values[entry, k] = column.finite()
        return values, [column.label for column in columns]
    found = np.asarray(_entries(path, simulator, columns=True), dtype=np.float64).reshape(simulator.transitions.nnz, -1)
    bad = np.argwhere(~np.isfinite(found))
    if bad.size:
        j, k = (int(i) for i in bad[0])
        where = name_move(simulator.transitions, j, simulator.n_actions, simulator.names)
        raise ValueError(f"{str(path)!r} must be finite; feature {k} at {where} is {found[j, k]}")
    return found, [f"feature {k}" for k in range(found.shape[1])]


def tie_of(path: Path, simulator: FiniteMDP) -> NDArray[Any]:
    """(entries,) integer keys: files as in ``features_of``, but with one number a move, and none may be left out."""
    if not _is_table(path, "--tie"):
        keys = _entries(path, simulator, columns=False)
        if keys.dtype.kind not in "iu":
            raise ValueError(f"{str(path)!r} must hold integer keys; it holds {keys.dtype}")
        return keys
    columns, entry = _table(path, simulator)
    if len(columns) > 1:
        found = _words(column.label for column in columns)
        raise ValueError(f"{str(path)!r} must have one column of keys beside {_words(MOVE)}; it has {found}")
    written = columns[0].integers()
    matrix = simulator.transitions
    absent = np.setdiff1d(np.arange(matrix.nnz), entry)
    if absent.size:
        first = name_move(matrix, int(absent[0]), simulator.n_actions, simulator.names)
        raise ValueError(
            f"{str(path)!r} must have a key for every transition of the simulator; {absent.size} of {matrix.nnz} have none, "
            f"the first: {first}"
        )
    keys = np.empty(matrix.nnz, dtype=written.dtype)
    keys[entry] = written
    return keys


def _is_table(path: Path, option: str) -> bool:
    suffix = path.suffix.lower()
    if suffix not in (".npy", ".csv"):
        raise ValueError(f"{option} must be a .npy or .csv file; got {str(path)!r}")
    return suffix == ".csv"


def _entries(path: Path, simulator: FiniteMDP, *, columns: bool) -> NDArray[Any]:
    """The array of a .npy on the entries: (entries,), or (entries, d) where there may be ``columns``."""
    arrays = _files.read_npz(path)
    if "array" not in arrays:
        raise ValueError(f"{str(path)!r} must hold one array, as numpy.save writes it; it holds {_words(arrays)}")
    array = arrays["array"]
    if array.dtype.kind not in "biuf":
        raise ValueError(f"{str(path)!r} must hold real numbers; it holds {array.dtype}")
    matrix, shape = simulator.transitions, (simulator.n_states, simulator.n_actions, simulator.n_states)
    given = array.shape
    if given[:3] == shape:
        array = array.reshape(matrix.shape[0], *given[2:])[row_of_entry(matrix), matrix.indices]
    if array.shape[:1] != (matrix.nnz,) or array.ndim > 1 + columns or array.size == 0:
        rule = f"({matrix.nnz},), in the order of the simulator's transitions, or {shape}"
        more = ", or either with a last axis of features" if columns else ""
        raise ValueError(f"{str(path)!r} must have shape {rule}{more}; it has shape {given}")
    return array


def _table(path: Path, simulator: FiniteMDP) -> tuple[list[_Column], IntArray]:
    """The columns of a .csv beside its moves, and the entry of the simulator's transitions that each row is about."""
    frame = csv_frame(str(path))
    require_columns(str(path), MOVE, frame.columns)
    names = [str(label) for label in frame.columns if label not in MOVE]
    if any(name.startswith(NAMELESS) for name in names):
        raise ValueError(
            f"{str(path)!r} must have a name for every column; it has {_words(frame.columns)} (a written index?)"
        )
    if not names or len(frame) == 0:
        rule = "a column of numbers beside its moves" if len(frame) else "at least one row"
        raise ValueError(f"{str(path)!r} must have {rule}; it has none")
    sizes = (simulator.n_states, simulator.n_actions, simulator.n_states)
    s, a, following = (_Column(label, path, frame[label]).below(size) for label, size in zip(MOVE, sizes, strict=True))
    entry, stored = find(simulator.transitions, s * simulator.n_actions + a, following)

    def move(row: int) -> str:
        return simulator.names.move(s[row], a[row], following[row])

    outside = np.flatnonzero(~stored)
    if outside.size:
        more = f" ({outside.size} such rows in all)" if outside.size > 1 else ""
        raise ValueError(
            f"row {outside[0]} of {str(path)!r} must be a move of the simulator, which gives probability 0 to "
            f"{move(int(outside[0]))}{more}"
        )
    again = np.setdiff1d(np.arange(len(entry)), np.unique(entry, return_index=True)[1])
    if again.size:
        row = int(again[0])
        before = int(np.argmax(entry == entry[row]))
        raise ValueError(f"row {row} of {str(path)!r} must be a move of its own; {move(row)} is row {before} already")
    return [_Column(label, path, frame[label]) for label in names], entry


@dataclass(frozen=True, eq=False)
class _Column:
    """A column of a .csv; its errors name it, its file and the first bad row."""

    label: str
    path: Path
    values: Any

    def refuse(self, bad: BoolArray, rule: str, found: Any) -> None:
        """A ValueError where a row is ``bad``."""
        if bad.any():
            row = int(np.argmax(bad))
            told = "none or nan" if found is None else found[row]
            raise ValueError(f"column {self.label!r} of {str(self.path)!r} must {rule}; row {row} has {told}")

    def finite(self) -> Array:
        """Finite numbers."""
        import pandas as pd

        rule = "have a finite number in every row"
        self.refuse(self.values.isna().to_numpy(), rule, None)
        numbers = pd.to_numeric(self.values, errors="coerce").to_numpy(dtype=np.float64)
        self.refuse(~np.isfinite(numbers), rule, self.values.to_numpy())
        return np.asarray(numbers)

    def integers(self) -> NDArray[Any]:
        """Whole numbers, as integers."""
        if self.values.dtype.kind in "iu":
            return np.asarray(self.values.to_numpy())
        numbers = self.finite()
        self.refuse((numbers != np.rint(numbers)) | (np.abs(numbers) >= WHOLE), "have an integer in every row", numbers)
        return numbers.astype(np.int64)

    def below(self, size: int) -> IntArray:
        """Integers in 0..size-1."""
        numbers = self.integers()
        self.refuse((numbers < 0) | (numbers >= size), f"be in 0..{size - 1}", numbers)
        return numbers.astype(np.int64)


def _words(names: Any) -> str:
    return ", ".join(str(name) for name in names) or "none"

"""Logs of continuous states as files: npz, CSV and parquet, whole or not at all; Minari data sets are read.

In a table a vector is spread over numbered columns: state_0, state_1, ..., next_state_0, ..., action_0, ...
"""

from __future__ import annotations

import os
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oee_tabular import _files
from oee_tabular.data.files import _require, is_minari, minari_columns, minari_episodes
from oee_tabular.data.transitions import COLUMNS

KIND = "continuous_transitions"
VECTORS = ("state", "action", "next_state")
SUFFIXES = (".npz", ".csv", ".parquet")
Columns = dict[str, NDArray[Any]]


def write(columns: Columns, path: str | os.PathLike[str]) -> None:
    """Columns (n,) or (n, d) in the format that the path's ending names."""
    suffix = _suffix(path)
    if suffix == ".npz":
        _files.save_npz(path, KIND, columns)
        return
    import pandas as pd

    frame = pd.DataFrame(_spread(columns))
    if suffix == ".parquet":
        _require("pyarrow", "parquet")
    with _files.whole_file(path) as handle:
        if suffix == ".csv":
            frame.to_csv(handle, index=False)
        else:
            frame.to_parquet(handle, index=False)


def read(path: str | os.PathLike[str]) -> Columns:
    """The columns that ``write`` wrote, or a table of the same names; unknown ones are left out with a warning."""
    name = os.fspath(path)
    if Path(name).suffix.lower() not in SUFFIXES and is_minari(name):
        columns = minari_columns(name, _vectors_only)
    elif _suffix(name) == ".npz":
        columns = _files.load_npz(name, KIND)
        columns.pop(_files.KIND)
    else:
        columns = _gathered(_table(name), name)
    unknown = [column for column in columns if column not in COLUMNS]
    if unknown:
        warnings.warn(f"columns of {name!r} that a log does not know are left out: {', '.join(unknown)}", stacklevel=4)
    absent = [column for column in VECTORS if column not in columns]
    if absent:
        raise ValueError(
            f"{name!r} must have the columns state_0, ..., next_state_0, ... and action (or action_0, ...); it has no "
            f"{', no '.join(absent)}, only {', '.join(columns) or 'nothing'}"
        )
    if columns["state"].ndim == 1 and columns["next_state"].ndim == 1:
        raise ValueError(
            f"{name!r} must have the columns state_0, ..., next_state_0, ...; it has one column state: a log of numbered states"
        )
    return {column: columns[column] for column in COLUMNS if column in columns}


def holds_states(path: str | os.PathLike[str]) -> bool:
    """Whether a file or Minari data set is a log of continuous states; of tables only the header is read."""
    name = os.fspath(path)
    suffix = Path(name).suffix.lower()
    if suffix == ".npz":
        return _files.npz_kind(_files.read_npz(name)) == KIND
    if suffix == ".csv":
        with open(name, encoding="utf-8", errors="replace") as handle:
            return "state_0" in [label.strip().strip('"') for label in handle.readline().split(",")]
    if suffix == ".parquet":
        _require("pyarrow", "parquet")
        from pyarrow import ArrowInvalid, parquet

        try:
            return "state_0" in parquet.read_schema(name).names
        except ArrowInvalid:
            return False  # whoever reads it says what is wrong
    if not is_minari(name):
        return False
    first = next(iter(minari_episodes(name)), None)
    return first is not None and np.asarray(first.observations).ndim == 2


def _vectors_only(observations: NDArray[Any], actions: NDArray[Any], name: str) -> None:
    if observations.ndim != 2 or observations.dtype.kind not in "fiu" or actions.ndim not in (1, 2):
        raise ValueError(
            f"{name!r} must have observations that are vectors, and actions that are numbers or vectors; they have shapes "
            f"{observations.shape} of {observations.dtype} and {actions.shape} of {actions.dtype}"
        )


def _suffix(path: str | os.PathLike[str]) -> str:
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        raise ValueError(f"path must end in {', '.join(SUFFIXES)}; it is {os.fspath(path)!r}")
    return suffix


def _table(name: str) -> Columns:
    import pandas as pd

    try:
        if _suffix(name) == ".csv":
            with warnings.catch_warnings():
                warnings.simplefilter("error", pd.errors.ParserWarning)  # more fields than the header names
                frame = pd.read_csv(name, index_col=False, **_exact_floats(pd.__version__))
        else:
            _require("pyarrow", "parquet")
            frame = pd.read_parquet(name)
    except FileNotFoundError:
        raise
    except (pd.errors.ParserWarning, pd.errors.ParserError, pd.errors.EmptyDataError, ValueError, OSError) as error:
        raise ValueError(f"{name!r} must be a table with a header; {error}") from None
    return {str(label): frame[label].to_numpy() for label in frame.columns}


def _exact_floats(version: str) -> dict[str, Any]:
    """The option with which pandas reads back every bit; it is deprecated from 3.1 on, where that is the default."""
    major, minor = (int(part) for part in version.split(".")[:2])
    return {} if (major, minor) >= (3, 1) else {"float_precision": "round_trip"}


def _spread(columns: Columns) -> Columns:
    flat: Columns = {}
    for name, column in columns.items():
        if column.ndim == 1:
            flat[name] = column
        else:
            flat |= {f"{name}_{k}": column[:, k] for k in range(column.shape[1])}
    return flat


def _gathered(flat: Columns, name: str) -> Columns:
    """state_0, state_1, ... as one (n, d) column, whatever their order in the file."""
    columns: Columns = {}
    parts: dict[str, dict[int, NDArray[Any]]] = {}
    for label, column in flat.items():
        match = re.fullmatch(rf"({'|'.join(VECTORS)})_(\d+)", label)
        if match:
            parts.setdefault(match[1], {})[int(match[2])] = column
        else:
            columns[label] = column
    for vector, found in parts.items():
        if vector in columns:
            raise ValueError(f"{name!r} must have either {vector} or {vector}_0, ...; it has both")
        missing = [k for k in range(max(found) + 1) if k not in found]
        if missing:
            last = f"{vector}_{max(found)}"
            raise ValueError(
                f"{name!r} must have every column from {vector}_0 to {last}; {vector}_{missing[0]} is missing"
            )
        columns[vector] = np.stack([found[k] for k in range(len(found))], axis=1)
    return columns

"""Logs of continuous states as files: npz, CSV and parquet, whole or not at all; Minari data sets are read.

In a table a vector is spread over numbered columns: state_0, state_1, ..., next_state_0, ..., action_0, ...
"""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oee_tabular import _files
from oee_tabular.data.files import is_minari, minari_columns, minari_episodes
from oee_tabular.data.tables import (
    csv_frame,
    csv_header,
    meant,
    parquet_frame,
    parquet_header,
    require_module,
    warn_left_out,
)
from oee_tabular.data.transitions import COLUMNS

KIND = "continuous_transitions"
VECTORS = ("state", "action", "next_state")
SUFFIXES = (".npz", ".csv", ".parquet")
NUMBERED = re.compile(rf"({'|'.join(VECTORS)})_(0|[1-9][0-9]{{0,8}})")
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
        require_module("pyarrow", "parquet")
    with _files.whole_file(path) as handle:
        if suffix == ".csv":
            frame.to_csv(handle, index=False)
        else:
            frame.to_parquet(handle, index=False)


def read(path: str | os.PathLike[str]) -> Columns:
    """The columns that ``write`` wrote, or a table of the same names; unknown ones are left out with a warning."""
    name = _files.local(path)
    suffix = Path(name).suffix.lower()
    if suffix not in SUFFIXES and is_minari(name):
        columns = minari_columns(name, _vectors_only)
    elif _suffix(name) == ".npz":
        columns = _files.load_npz(name, KIND)
        columns.pop(_files.KIND)
    else:
        frame = (csv_frame if suffix == ".csv" else parquet_frame)(name, _known)
        columns = _gathered({str(label): frame[label].to_numpy() for label in frame.columns}, name)
        columns |= {label: np.empty(0) for label in frame.attrs["labels"] if not _known(label)}
    absent = [column for column in VECTORS if column not in columns]
    if absent:
        raise ValueError(
            f"{name!r} must have the columns state_0, ..., next_state_0, ... and action (or action_0, ...); it has no "
            f"{', no '.join(absent)}, only {', '.join(columns) or 'nothing':.300}"
            + meant(("state_0", "next_state_0", *VECTORS), list(columns))
        )
    warn_left_out(name, [column for column in columns if column not in COLUMNS], COLUMNS, level=4)
    if columns["state"].ndim == 1 and columns["next_state"].ndim == 1:
        raise ValueError(
            f"{name!r} must have the columns state_0, ..., next_state_0, ...; it has one column state: a log of numbered states"
        )
    return {column: columns[column] for column in COLUMNS if column in columns}


def holds_states(path: str | os.PathLike[str]) -> bool:
    """Whether a file or Minari data set is a log of continuous states; of tables only the header is read."""
    name = _files.local(path)
    suffix = Path(name).suffix.lower()
    if suffix == ".npz":
        return _files.npz_kind(_files.read_npz(name)) == KIND
    if suffix == ".csv":
        return "state_0" in _header(csv_header, name)
    if suffix == ".parquet":
        return "state_0" in _header(parquet_header, name)
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


def _known(label: str) -> bool:
    return label in COLUMNS or NUMBERED.fullmatch(label) is not None


def _header(labels: Callable[[str], list[str]], name: str) -> list[str]:
    try:
        return labels(name)
    except (ValueError, csv.Error):
        return []  # whoever reads it says what is wrong


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
        match = NUMBERED.fullmatch(label)
        if match:
            parts.setdefault(match[1], {})[int(match[2])] = column
        else:
            columns[label] = column
    for vector, found in parts.items():
        if vector in columns:
            raise ValueError(f"{name!r} must have either {vector} or {vector}_0, ...; it has both")
        if max(found) >= len(found):
            missing = next(k for k in range(len(found)) if k not in found)
            last = f"{vector}_{max(found)}"
            raise ValueError(
                f"{name!r} must have every column from {vector}_0 to {last}; {vector}_{missing} is missing"
            )
        with _files.parts_of(name, f"{vector}_0, ..."):  # columns of kinds that have nothing in common
            columns[vector] = np.stack([found[k] for k in range(len(found))], axis=1)
    return columns

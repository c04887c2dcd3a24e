"""Logs of continuous states as files.

In a table a vector is spread over numbered columns: state_0, state_1, ..., next_state_0, ..., action_0, ...
"""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oee_tabular import _files
from oee_tabular.data.files import COLUMNS, Columns, Format, is_minari, minari_episodes
from oee_tabular.data.tables import csv_header, meant, parquet_header

NUMBERED = re.compile(rf"({'|'.join(Format.required)})_(0|[1-9][0-9]{{0,8}})")


class VectorFormat(Format):
    """Columns of vectors, (n, d) in an npz, numbered in a table; Minari data sets are read, not written."""

    kind = "continuous_transitions"
    endings = ".npz, .csv, .parquet"

    def known(self, label: str) -> bool:
        """A log's column, or one coordinate of a vector."""
        return label in COLUMNS or NUMBERED.fullmatch(label) is not None

    def flat(self, columns: Columns) -> Columns:
        """One column for each coordinate."""
        flat: Columns = {}
        for name, column in columns.items():
            if column.ndim == 1:
                flat[name] = column
            else:
                flat |= {f"{name}_{k}": column[:, k] for k in range(column.shape[1])}
        return flat

    def gathered(self, flat: Columns, name: str) -> Columns:
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

    def require(self, columns: Columns, labels: Sequence[str], name: str) -> None:
        """The three of a move, and not of a move between numbered states."""
        absent = [column for column in self.required if column not in columns]
        if absent:
            found = [*columns, *(label for label in labels if not self.known(label))]
            raise ValueError(
                f"{name!r} must have the columns state_0, ..., next_state_0, ... and action (or action_0, ...); it has no "
                f"{', no '.join(absent)}, only {', '.join(found) or 'nothing':.300}"
                + meant(("state_0", "next_state_0", *self.required), found)
            )
        if columns["state"].ndim == 1 and columns["next_state"].ndim == 1:
            raise ValueError(
                f"{name!r} must have the columns state_0, ..., next_state_0, ...; it has one column state: a log of numbered "
                "states"
            )

    def check_episode(self, observations: NDArray[Any], actions: NDArray[Any], name: str) -> None:
        """Observations are vectors, actions numbers or vectors."""
        if observations.ndim != 2 or observations.dtype.kind not in "fiu" or actions.ndim not in (1, 2):
            raise ValueError(
                f"{name!r} must have observations that are vectors, and actions that are numbers or vectors; they have shapes "
                f"{observations.shape} of {observations.dtype} and {actions.shape} of {actions.dtype}"
            )

    def save_data_set(self, log: object, name: str) -> None:
        """Refused."""
        raise self.refuse(name)


VECTORS = VectorFormat()


def holds_states(path: str | os.PathLike[str]) -> bool:
    """Whether a file or Minari data set is a log of continuous states; of tables only the header is read."""
    name = _files.local(path)
    suffix = Path(name).suffix.lower()
    if suffix == ".npz":
        return _files.npz_kind(_files.read_npz(name)) == VECTORS.kind
    if suffix == ".csv":
        return "state_0" in _header(csv_header, name)
    if suffix == ".parquet":
        return "state_0" in _header(parquet_header, name)
    if not is_minari(name):
        return False
    first = next(iter(minari_episodes(name)), None)
    return first is not None and np.asarray(first.observations).ndim == 2


def _header(labels: Callable[[str], list[str]], name: str) -> list[str]:
    try:
        return labels(name)
    except (ValueError, csv.Error):
        return []  # whoever reads it says what is wrong

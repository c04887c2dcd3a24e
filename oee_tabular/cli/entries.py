"""A user's own numbers for the simulator's transitions: the files of ``--features`` and ``--tie``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oee_tabular import _files
from oee_tabular._checks import Array
from oee_tabular._sparse import row_of_entry
from oee_tabular.data.reader import csv_frame
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.arrays import name_transition
from oee_tabular.ratio.tabled import features_in, keys_in, words


def known_entries(files: Mapping[str, Path | None], simulator: FiniteMDP) -> tuple[dict[str, Any], dict[str, str]]:
    """``features`` and ``tie`` for ``evaluate``, and the report's facts, of the files given for them."""
    known: dict[str, Any] = {}
    facts = {}
    if (path := files["features"]) is not None:
        known["features"], names = features_of(path, simulator)
        facts["features"] = f"{path} ({', '.join(names)})"
    if (path := files["tie"]) is not None:
        known["tie"] = tie_of(path, simulator)
        facts["tie"] = f"{path} ({len(np.unique(known['tie']))} keys)"
    return known, facts


def features_of(path: Path, simulator: FiniteMDP) -> tuple[Array, list[str]]:
    """(entries, d) finite numbers on ``simulator.transitions.data``, and their names.

    A .npy holds (entries,), (entries, d), (S, A, S) or (S, A, S, d), numbered as the simulator's transitions are; what a dense
    one has where P is 0 is not looked at. A .csv has a move a row: columns state, action, next_state (numbers, or the
    simulator's names), and one for each feature, which is 0 in moves that are not in the file.
    """
    if _is_table(path, "--features"):
        return features_in(csv_frame(str(path)), simulator, repr(str(path)))
    found = np.asarray(_entries(path, simulator, columns=True), dtype=np.float64).reshape(simulator.transitions.nnz, -1)
    bad = np.argwhere(~np.isfinite(found))
    if bad.size:
        j, k = (int(i) for i in bad[0])
        where = name_transition(simulator.transitions, j, simulator.n_actions, simulator.names)
        raise ValueError(f"{str(path)!r} must be finite; feature {k} at {where} is {found[j, k]}")
    return found, [f"feature {k}" for k in range(found.shape[1])]


def tie_of(path: Path, simulator: FiniteMDP) -> NDArray[Any]:
    """(entries,) integer keys: files as in ``features_of``, but with one number a move, and none may be left out."""
    if not _is_table(path, "--tie"):
        keys = _entries(path, simulator, columns=False)
        if keys.dtype.kind not in "iu":
            raise ValueError(f"{str(path)!r} must hold integer keys; it holds {keys.dtype}")
        return keys
    return keys_in(csv_frame(str(path)), simulator, repr(str(path)))


def _is_table(path: Path, option: str) -> bool:
    suffix = path.suffix.lower()
    if suffix not in (".npy", ".csv"):
        raise ValueError(f"{option} must be a .npy or .csv file; got {str(path)!r}")
    return suffix == ".csv"


def _entries(path: Path, simulator: FiniteMDP, *, columns: bool) -> NDArray[Any]:
    """The array of a .npy on the entries: (entries,), or (entries, d) where there may be ``columns``."""
    arrays = _files.read_npz(path)
    if "array" not in arrays:
        raise ValueError(f"{str(path)!r} must hold one array, as numpy.save writes it; it holds {words(arrays)}")
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

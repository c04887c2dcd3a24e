"""Logs in parquet whose vectors are lists, as LeRobot's data sets (v3) have them.

A row of such a data set is a frame: what was observed, what was done, and what came of
it (``next.reward``). The state that follows stands in the next frame of the episode;
the last frame has no successor, and is no transition.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from oee_tabular import _checks, _files
from oee_tabular.data.aliases import stem
from oee_tabular.data.files import Columns, Format
from oee_tabular.data.labels import (
    Matching,
    match_labels,
    show_labels,
    warn_left_out,
    warn_read_as,
)
from oee_tabular.data.rules import MOVE, check_table
from oee_tabular.data.tables import (
    MAX_COLUMNS,
    PARQUET,
    TAIL_BYTES,
    fill_missing,
    open_duckdb,
    quote_label,
)
from oee_tabular.exceptions import ArgumentError, DataWarning

# the labels of a frame of LeRobot, by a log's columns
FRAME = {
    "state": "observation.state",
    "action": "action",
    "reward": "next.reward",
    "terminated": "next.done",
    "episode": "episode_index",
    "timestep": "frame_index",
}
# of each frame, and no part of a log
BOOKKEEPING = ("timestamp", "index", "task_index")
_NUMBERS = (
    "FLOAT",
    "DOUBLE",
    "TINYINT",
    "SMALLINT",
    "INTEGER",
    "BIGINT",
    "UTINYINT",
    "USMALLINT",
    "UINTEGER",
)


def find_lists(
    path: str, columns: Mapping[str, Any]
) -> tuple[Matching, dict[str, str]] | None:
    """Return a file's columns of a log, and the types of all; None without lists.

    ``columns``: what the file calls a log's columns.
    """
    if not _may_have_lists(path):
        return None
    with open_duckdb(path) as run:
        described = run(f"DESCRIBE SELECT * FROM {PARQUET}").fetchall()
    types = {row[0]: str(row[1]) for row in described}
    if not any(map(_is_list, types.values())):
        return None
    said = dict(columns)
    is_frames = FRAME["episode"] in types and FRAME["timestep"] in types
    if is_frames:
        own = {field: label for field, label in FRAME.items() if label in types}
        given = {stem(field) for field in said}
        said |= {field: label for field, label in own.items() if field not in given}

    def require(labels: list[Any], taken: Mapping[str, Any]) -> None:
        """Require a state and an action; the next state may be the next row's."""
        whole = set(map(stem, taken))
        absent = [field for field in ("state", "action") if field not in whole]
        if absent:
            raise ArgumentError(
                f"{path!r}",
                f"must have columns for state and action; it has no {absent[0]}, only"
                f" {show_labels(labels)} (say which hold them: columns={{'state': 'its"
                " label'})",
            )

    known = set(types) - (set(BOOKKEEPING) if is_frames else set())
    labels = [label for label in types if label in known]
    matching = match_labels(labels, repr(path), said, require, has_vectors=True)
    labels = _group(matching).get("state", [])
    return (matching, types) if any(_is_list(types[x]) for x in labels) else None


def read_lists(form: Format, path: str, reported: set[Any]) -> Columns | None:
    """Return the columns of a log whose states are lists; None of another file.

    Warns of labels that are not ``reported``, and of rewards that are left out.
    """
    found = find_lists(path, form.columns)
    if found is None:
        return None
    matching, types = found
    flat = _read_flat(path, matching, types)
    values = check_table(flat, repr(path))
    if "next_state" not in _group(matching):
        values = _shift(values, path)
    renamed = [pair for pair in matching.renamed if pair not in reported]
    unknown = [label for label in matching.left_out if label not in reported]
    reported.update(renamed, unknown)
    warn_read_as(repr(path), renamed)
    warn_left_out(repr(path), unknown)
    return form.from_table(values, path)


def _may_have_lists(path: str) -> bool:
    """Say whether a file's end names what parquet calls lists.

    DuckDB's look at the columns takes as long as reading a small log.
    """
    with _files.open_regular(path) as handle:
        n_bytes = handle.seek(0, os.SEEK_END)
        handle.seek(max(0, n_bytes - TAIL_BYTES))
        tail = handle.read()
    return any(mark in tail for mark in (b"list", b"array", b"bag"))


def _group(matching: Matching) -> dict[str, list[Any]]:
    """Return the labels of each column of a log, those of state_0, ... as of one."""
    groups: dict[str, list[Any]] = {}
    for field in sorted(matching.taken, key=lambda x: (stem(x), len(x), x)):
        groups.setdefault(stem(field), []).extend(matching.taken[field])
    return groups


def _is_list(kind: str) -> bool:
    """Say whether a column of a DuckDB type has lists, or arrays of one length."""
    return kind.endswith("]")


def _read_flat(path: str, matching: Matching, types: Mapping[str, str]) -> Columns:
    """Return the columns of a log, vectors as state_0, state_1, ..., raw."""
    with open_duckdb(path) as run:
        n_rows = int(run(f"SELECT count(*) FROM {PARQUET}").fetchone()[0])
        parts: dict[str, str] = {}
        for field, group in _group(matching).items():
            items: list[str] = []
            for label in group:
                items += _list_items(run, path, label, types[label])
            is_vector = field in MOVE and any(_is_list(types[x]) for x in group)
            if is_vector or len(items) > 1:
                parts |= {f"{field}_{k}": item for k, item in enumerate(items)}
            else:
                parts[field] = items[0]
        if len(parts) > MAX_COLUMNS:
            raise ArgumentError(
                f"{path!r}",
                f"must have at most {MAX_COLUMNS} numbers in a row; it has"
                f" {len(parts)} (say which hold the state: columns={{'state': ...}})",
            )
        _checks.require_memory(2 * n_rows * len(parts), repr(path))
        chosen = ", ".join(f"{sql} AS {name}" for name, sql in parts.items())
        table = run(f"SELECT {chosen} FROM {PARQUET}").fetchnumpy()
    return {name: fill_missing(table[name]) for name in parts}


def _list_items(run: Any, path: str, label: str, kind: str) -> Sequence[str]:
    """Return the SQL of each number of a column, of which lists have several."""
    name = quote_label(label)
    if not _is_list(kind):
        return [name]
    if kind.split("[")[0] not in _NUMBERS or kind.count("[") > 1:
        raise ArgumentError(
            f"{path!r}: {label!r}",
            f"must hold lists of numbers; it has {kind:.60} (say which column holds"
            " the vectors: columns={'state': 'LABEL'})",
        )
    least, most, n_absent = run(
        f"SELECT min(len({name})), max(len({name})), count(*) - count({name})"
        f" FROM {PARQUET}"
    ).fetchone()
    if n_absent or least != most or not least:
        what = f"of {least} to {most} numbers"
        if n_absent:
            what = f"and {n_absent} rows without one"
        raise ArgumentError(
            f"{path!r}: {label!r}",
            f"must hold lists of one length, at least 1; it has lists {what}",
        )
    return [f"{name}[{k + 1}]" for k in range(min(least, MAX_COLUMNS + 1))]


def _shift(values: Columns, path: str) -> Columns:
    """Return transitions from frames: the next state is that of the next frame."""
    episode = values.get("episode")
    if episode is None:
        raise ArgumentError(
            f"{path!r}",
            "must have a column episode where it has no next_state, which is then the"
            " next row's state (columns={'episode': 'LABEL'})",
        )
    is_same = episode[1:] == episode[:-1]
    steps = values.get("timestep")
    if steps is not None:
        gaps = np.flatnonzero(is_same & (steps[1:] != steps[:-1] + 1))
        if gaps.size:
            row = int(gaps[0])
            raise ArgumentError(
                f"{path!r}: row {row + 1}",
                "must be the frame after the row before it, whose next state it has;"
                f" its time is {steps[row + 1]} after {steps[row]} in episode"
                f" {episode[row]}",
            )
    kept = np.flatnonzero(is_same)
    if kept.size == 0:
        raise ArgumentError(
            f"{path!r}", "must have an episode of two frames; each has one alone"
        )
    moved = {label: column[kept] for label, column in values.items()}
    for label, column in values.items():
        if stem(label) == "state":
            moved["next_" + label] = column[kept + 1]
    reward = values.get("reward")
    if reward is not None:
        last = np.delete(reward, kept)
        n_paid = np.count_nonzero(last)
        if n_paid:
            _checks.warn(
                f"{path!r}: the last frame of an episode has no next state, and is left"
                f" out; in {n_paid} of {len(last)} episodes it has a reward, in all"
                f" {last.sum():g} of {reward.sum():g}",
                DataWarning,
            )
    return moved

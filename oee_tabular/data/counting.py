"""One file of a log as counts, in one pass and in the memory of the counts.

Of each piece of the file the values are checked (``rules.py``), rows that break a rule
are noted, and the others are added to the sums of their (s, a, s', terminated). Of
whole episodes a sample is kept, for importance sampling: those first in the order of a
hash of the file's name and the episode's number. It is uniform over the whole episodes,
and the same wherever it is drawn.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oee_tabular.data.counts import N_REASONS, Recording
from oee_tabular.data.rules import (
    COLUMNS,
    KEY,
    MOVE,
    Fault,
    check_column,
    find_order_faults,
    find_repeat,
)
from oee_tabular.data.sums import add_sums, join_sums
from oee_tabular.data.tables import LogFile, Piece, Table, open_table, sum_groups
from oee_tabular.data.transitions import Transitions
from oee_tabular.mdp.naming import Name
from oee_tabular.typing import BoolArray, Column, IntArray

LARGEST = 2**53  # from which on a float does not tell n from n + 1
N_SPARE = 2  # times the sample is kept before it is cut
LAST_PLACE = 2**64 - 1
WAY = " (bad_rows='drop', --bad-rows drop, leaves such rows out and counts them)"


class Limits(NamedTuple):
    """Hold what rows must keep to: numbers below ``sizes`` (states, actions), or names.

    ``drop``: whether other rows are left out. ``kept``: the transitions of the sample.
    """

    sizes: tuple[int, int] = (LARGEST, LARGEST)
    names: tuple[tuple[Name, ...] | None, tuple[Name, ...] | None] = (None, None)
    drop: bool = False
    kept: int = 200_000


class Sample(NamedTuple):
    """Hold rows of whole episodes with each episode's place in the draw.

    All places are below ``limit``.
    """

    rows: dict[str, Column] = {}  # noqa: RUF012
    limit: int = LAST_PLACE

    def join(self, other: Sample, kept: int) -> Sample:
        """Return the episodes first in the draw of both samples.

        A reward that only one has is nan in the other.
        """
        limit = min(self.limit, other.limit)
        parts = [sample.rows for sample in (self, other) if sample.rows]
        if not parts:
            return Sample(limit=limit)
        labels = dict.fromkeys(label for part in parts for label in part)
        columns = {
            label: [
                part.get(label, np.full(len(part["place"]), np.nan)) for part in parts
            ]
            for label in labels
        }
        return cut_sample(
            {label: np.concatenate(column) for label, column in columns.items()},
            kept,
            limit,
        )


def cut_sample(rows: dict[str, Column], kept: int, limit: int) -> Sample:
    """Return the episodes below ``limit`` first in the draw, of at most ``kept`` rows.

    The first episode that is left out is the new limit.
    """
    rows = choose(rows, rows["place"] < np.uint64(limit))
    # an episode's rows stand together
    starts = np.flatnonzero(np.diff(rows["place"], prepend=rows["place"][:1] + 1))
    order = np.argsort(rows["place"][starts])
    length = np.diff(starts, append=len(rows["place"]))
    n = int(np.searchsorted(np.cumsum(length[order]), kept, side="right"))
    if n < len(order):
        limit = int(rows["place"][starts[order[n]]])
        rows = choose(rows, rows["place"] < np.uint64(limit))
    return Sample(rows, limit)


class FileCounts(NamedTuple):
    """Hold the sums of a file, how it was recorded, and the labels of its columns."""

    sums: dict[str, Column] | None
    recording: Recording
    sample: Sample
    known: frozenset[str]
    unknown: tuple[str, ...]


def count_file(file: LogFile, name: str, limits: Limits) -> FileCounts:
    """Count one file; its ``name`` is hashed for the sample."""
    form = Transitions.FILES
    if file.suffix in (".csv", ".parquet"):
        table = open_table(file, form)
    else:
        columns = form.to_table(Transitions.load(file.path).columns())
        table = Table(
            list(columns),
            list(columns),
            [Piece(columns, np.arange(len(columns["state"])), {})],
        )
    count = _FileCount(file.path, limits, name)
    if not (
        file.suffix == ".parquet"
        and {"episode", "timestep"}.isdisjoint(table.known)
        and count.add_groups(table)
    ):
        for piece in table.pieces:
            count.add(piece)
    sample = count.draw_episodes() if count.n_rows else Sample()
    sums = join_sums(count.sums) if count.sums else None
    recording = count.recording(sums, table)
    unknown = tuple(label for label in table.labels if label not in COLUMNS)
    return FileCounts(sums, recording, sample, frozenset(table.known), unknown)


class _FileCount:
    """Hold the sums of the pieces so far, their faults, and their episodes."""

    def __init__(self, path: str, limits: Limits, name: str) -> None:
        self.path = path
        self.limits = limits
        self.name = name
        self.sums: list[dict[str, Column]] = []
        # by kind: the first row, the words for it, how many rows
        self.faults: dict[str, tuple[int, str, int]] = {}
        self.n_dropped = self.n_truncated = 0
        # that have an episode; runs of such rows with the same one
        self.n_rows = self.n_runs = 0
        self.last: dict[str, Column] = {}  # the last row of the piece before
        self.last_row = self.last_lost = -1
        # of the runs, among these rows and among those of the file
        self.starts: list[IntArray] = []
        self.names: list[Column] = []  # of their episodes
        self.broken: list[IntArray] = []
        # the rows that may be in the sample, with their run
        self.kept: list[dict[str, Column]] = []
        self.limit = LAST_PLACE

    def add_groups(self, table: Table) -> bool:
        """Add the whole of a parquet file without episodes, summed by DuckDB.

        Returns False, and adds nothing, where a value is odd.
        """
        groups = (
            sum_groups(self.path, table.known)
            if set(table.known) <= set(table.labels)
            else None
        )
        if groups is None:
            return False
        for label in table.known:
            if label in (*KEY, "truncated"):
                groups[label], fault = self._check(groups[label], label)
                has_all = True
            else:
                # texts have another order
                ends = np.concatenate([groups[f"{label}_min"], groups[f"{label}_max"]])
                fault = self._check(ends, label)[1]
                has_all = (
                    label == "reward"
                    or (groups[f"{label}_count"] == groups["count"]).all()
                )
                has_all &= not ends.dtype.hasobject
            if fault is not None or not has_all:
                return False
        if (
            "reward" in table.known
            and (np.isnan(groups["reward_max"]) & (groups["reward_count"] > 0)).any()
        ):
            return False  # a reward that is nan is missing, and DuckDB adds it
        self.n_truncated = (
            int(groups["count"][groups["truncated"]].sum())
            if "truncated" in groups
            else 0
        )
        add_sums(self.sums, groups)
        return True

    def add(self, piece: Piece) -> None:
        """Check one more piece and add its sums and episodes."""
        for row, words in piece.lost.items():
            self._note("fields", row, words)
        columns = {}
        is_bad = np.zeros(len(piece.rows), dtype=np.bool_)
        has_episode = ~is_bad
        for label, raw in piece.columns.items():
            columns[label], fault = self._check(raw, label)
            if fault is not None:
                self._note_fault(label, fault, piece.rows)
                is_bad[fault.rows] = True
                has_episode[fault.rows] &= label != "episode"
        if "episode" in columns and has_episode.any():
            self._follow(
                choose(columns | {"is_bad": is_bad, "row": piece.rows}, has_episode)
            )
        self.last_lost = max([self.last_lost, *piece.lost, *piece.rows[~has_episode]])
        good = choose(columns, ~is_bad)
        self.n_dropped += len(piece.lost) + int(is_bad.sum())
        self.n_truncated += int(good["truncated"].sum()) if "truncated" in good else 0
        add_sums(self.sums, good)

    def _check(self, raw: Column, label: str) -> tuple[Column, Fault | None]:
        """Return a column's values, names as the simulator's numbers, and its fault."""
        if label not in MOVE:
            return check_column(raw, label)
        is_action = label == "action"
        return check_column(
            raw,
            label,
            high=self.limits.sizes[is_action],
            names=self.limits.names[is_action],
        )

    def _note_fault(self, kind: str, fault: Fault, rows: IntArray) -> None:
        """Note a fault of rows of a piece, whose numbers in the file are ``rows``."""
        row = int(rows[fault.rows[0]])
        self._note(kind, row, fault.describe(row), len(fault.rows))

    def _note(self, kind: str, row: int, words: str, n: int = 1) -> None:
        """Keep the words for the first row of each kind of fault, and count rows."""
        first_row, first_words, before = self.faults.get(kind, (row, words, 0))
        self.faults[kind] = first_row, first_words, before + n

    def _follow(self, columns: dict[str, Column]) -> None:
        """Note where episodes begin, which are broken, and rows for the sample."""
        last = self.last or {label: column[:1] for label, column in columns.items()}
        before = {
            label: np.concatenate([last[label], column[:-1]])
            for label, column in columns.items()
        }
        rows = columns["row"]
        is_bad = columns["is_bad"]
        is_first = np.asarray(columns["episode"] != before["episode"], dtype=np.bool_)
        is_first[0] |= not self.last
        run = self.n_runs - 1 + np.cumsum(is_first)
        # rows were lost before this one
        is_gap = np.diff(rows, prepend=self.last_row) > 1
        is_broken = is_bad | is_gap
        self.broken.append(run[is_broken] - is_first[is_broken])
        follows = ~(is_first | is_broken | before["is_bad"])
        for fault in find_order_faults(columns, before, is_first & ~is_broken, follows):
            self._note_fault(f"order of {fault.label}", fault, rows)
            is_broken[fault.rows] = True
        self.broken.append(run[is_broken])
        starts = np.flatnonzero(is_first)
        self.starts.append(np.stack([self.n_rows + starts, rows[starts]]))
        self.names.append(columns["episode"][starts])
        self.last = {label: column[-1:] for label, column in columns.items()}
        self.last_row = int(rows[-1])
        self.n_rows += len(rows)
        self.n_runs = int(run[-1]) + 1
        place = hash_places(np.arange(run[0], self.n_runs), self.name)[run - run[0]]
        own = {
            label: columns[label]
            for label in COLUMNS
            if label in columns and label != "episode"
        }
        self.kept.append(
            choose(own | {"run": run, "place": place}, place < np.uint64(self.limit))
        )
        if sum(len(kept["run"]) for kept in self.kept) > N_SPARE * self.limits.kept:
            self._cut()

    def _cut(self) -> Sample:
        """Cut the sample to the unbroken episodes that are first in the draw."""
        rows = {
            label: np.concatenate([kept[label] for kept in self.kept])
            for label in self.kept[0]
        }
        rows = choose(rows, ~np.isin(rows["run"], np.concatenate(self.broken)))
        sample = cut_sample(rows, self.limits.kept, self.limit)
        self.kept = [sample.rows]
        self.limit = sample.limit
        return sample

    def draw_episodes(self) -> Sample:
        """Return a sample of the whole episodes whose rows are consecutive.

        A run of rows is not whole where another run has the same episode.
        """
        names = np.concatenate(self.names)
        names = names.astype(str) if names.dtype.hasobject else names
        repeat = find_repeat(names, np.concatenate(self.starts, axis=1)[1])
        if repeat is not None:
            self._note("together", *repeat)
            _, code, number = np.unique(names, return_inverse=True, return_counts=True)
            self.broken.append(np.flatnonzero(number[code] > 1))
        if self.last_lost > self.last_row:
            self.broken.append(np.array([self.n_runs - 1]))
        sample = self._cut()
        return sample._replace(
            rows={
                label: column for label, column in sample.rows.items() if label != "run"
            }
        )

    def recording(self, sums: Mapping[str, Column] | None, table: Table) -> Recording:
        """Return how the file was recorded, with the first row of each fault.

        Raises a ValueError where such rows are refused.
        """
        words = []
        for _, text, n in sorted(self.faults.values())[:N_REASONS]:
            more = f"; {n - 1} other rows break the same rule" * (n > 1)
            words.append(f"{self.path!r}: {text}{more}")
            if not self.limits.drop:
                raise ValueError(words[0] + WAY)
        recording = Recording(
            "episode" in table.known,
            files=1,
            dropped=self.n_dropped,
            reasons=tuple(words),
        )
        if not self.n_rows:
            return recording._replace(truncated=self.n_truncated)
        length = np.diff(np.concatenate(self.starts, axis=1)[0], append=self.n_rows)
        broken = np.unique(np.concatenate(self.broken))
        if "truncated" not in table.known:
            n_terminated = (
                0 if sums is None else int(sums["count"][sums["terminated"] == 1].sum())
            )
            self.n_truncated = max(len(length) - n_terminated, 0)
        return recording._replace(
            episodes=len(length),
            shortest=int(length.min()),
            longest=int(length.max()),
            truncated=self.n_truncated,
            broken=int((broken >= 0).sum()),
        )


def choose(columns: dict[str, Column], chosen: BoolArray) -> dict[str, Column]:
    """Return the chosen rows of columns; the columns themselves where all are."""
    return (
        columns
        if chosen.all()
        else {label: column[chosen] for label, column in columns.items()}
    )


def hash_places(number: IntArray, name: str) -> NDArray[np.uint64]:
    """Return splitmix64 of number + a hash of the name as a place in the draw."""
    salt = np.uint64(
        int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "little")
    )
    with np.errstate(over="ignore"):
        x = (number.astype(np.uint64) + np.uint64(1)) * np.uint64(
            0x9E3779B97F4A7C15
        ) + salt
        x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        return np.asarray(x ^ (x >> np.uint64(31)))

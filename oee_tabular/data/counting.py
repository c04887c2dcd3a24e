"""One file of a log as counts, in one pass and in the memory of the counts.

Of each piece of the file the values are checked (``rules.py``), rows that break a rule are noted, and the others are added to
the sums of their (s, a, s', ended). Of whole episodes a sample is kept, for importance sampling: those first in the order of
a hash of the file's name and the episode's number. It is uniform over the whole episodes, and the same wherever it is drawn.
"""

from __future__ import annotations

import hashlib
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oee_tabular._checks import BoolArray, Column, IntArray
from oee_tabular.data.counts import N_REASONS, Recording
from oee_tabular.data.labels import COLUMNS, MOVE, require_columns
from oee_tabular.data.reader import LogFile, Piece, Table, open_table, sum_groups
from oee_tabular.data.rules import NAMES_HINT, Fault, find_order_faults, find_repeat
from oee_tabular.data.sums import KEY, Sums
from oee_tabular.data.transitions import Transitions
from oee_tabular.mdp.naming import Name

LARGEST = 2**53  # from which on a float does not tell n from n + 1
N_SPARE = 2  # times the sample is kept before it is cut
WAY = " (bad_rows='drop', --bad-rows drop, leaves such rows out and counts them)"


class Limits(NamedTuple):
    """What rows must keep to: numbers below ``sizes`` (states, actions), or names; ``drop``: others are left out."""

    sizes: tuple[int, int] = (LARGEST, LARGEST)
    names: tuple[tuple[Name, ...] | None, tuple[Name, ...] | None] = (None, None)
    drop: bool = False
    kept: int = 200_000


class Sample(NamedTuple):
    """Whole episodes, in their order: their place in the draw and length, (n,) each, and their rows; all below ``limit``."""

    place: NDArray[np.uint64]
    length: IntArray
    rows: dict[str, Column]
    limit: int = 2**64 - 1

    def cut(self, kept: int, is_whole: BoolArray | None = None) -> Sample:
        """Those first in the draw that have ``kept`` rows at most; ``limit``: the place of the first that is left out."""
        may = self.place < np.uint64(self.limit)
        order = np.flatnonzero(may if is_whole is None else may & is_whole)
        order = order[np.argsort(self.place[order])]
        n = int(np.searchsorted(np.cumsum(self.length[order]), kept, side="right"))
        limit = int(self.place[order[n]]) if n < len(order) else self.limit
        is_kept = np.zeros(len(self.place), dtype=np.bool_)
        is_kept[order[:n]] = True
        rows = _choose(self.rows, np.repeat(is_kept, self.length))
        return Sample(self.place[is_kept], self.length[is_kept], rows, limit)

    def join(self, other: Sample, kept: int) -> Sample:
        """The episodes first in the draw of both; a reward that only one has is nan in the other."""
        parts = [sample for sample in (self, other) if len(sample.place)]
        rows = {}
        for label in dict.fromkeys(label for part in parts for label in part.rows):
            rows[label] = np.concatenate([part.rows.get(label, np.full(part.length.sum(), np.nan)) for part in parts])
        place, length = (np.concatenate([one, two]) for one, two in zip(self[:2], other[:2], strict=True))
        return Sample(place, length, rows, min(self.limit, other.limit)).cut(kept)


NO_SAMPLE = Sample(np.zeros(0, dtype=np.uint64), np.zeros(0, dtype=np.int64), {})


class FileCounts(NamedTuple):
    """What a file came to: the columns of its counts, how it was recorded, and the labels of its columns."""

    entries: dict[str, Column]
    recording: Recording
    sample: Sample
    known: frozenset[str]
    unknown: tuple[str, ...]


def count_file(file: LogFile, name: str, limits: Limits) -> FileCounts:
    """Count one file; ``name`` is hashed for the sample."""
    if file.suffix in (".csv", ".parquet"):
        table = open_table(file, COLUMNS.__contains__)
    else:
        columns = Transitions.FILES.to_table(Transitions.load(file.path).columns())
        whole = Piece(columns, np.arange(len(columns["state"])), {})
        table = Table(file, list(columns), COLUMNS.__contains__, lambda *_: iter([whole]))
    require_columns(repr(file.path), MOVE, [*table.labels, *table.known])
    count = _FileCount(table, limits, name)
    if not (file.suffix == ".parquet" and "episode" not in table.known and count.add_groups()):
        for piece in table.pieces():
            count.add(piece)
    return count.result()


class _FileCount:
    """The sums of the pieces so far, what is wrong with them, and their episodes."""

    def __init__(self, table: Table, limits: Limits, name: str) -> None:
        self.table, self.limits, self.name = table, limits, name
        self.sums = Sums()
        self.faults: dict[str, tuple[int, str, int]] = {}  # by kind: the first row, the words for it, how many rows
        self.n_dropped = self.n_truncated = 0
        self.n_rows = self.n_runs = 0  # that have an episode; runs of such rows with the same one
        self.last: dict[str, Column] = {}  # the last row of the piece before
        self.last_row = self.last_lost = -1
        self.starts: list[IntArray] = []  # of the runs, among these rows and among those of the file
        self.names: list[Column] = []  # of their episodes
        self.broken: list[IntArray] = []
        self.kept: list[dict[str, Column]] = []  # the rows that may be in the sample, with their run
        self.limit = 2**64 - 1

    def add_groups(self) -> bool:
        """Sum a parquet file by DuckDB, in half of the time of the pieces; False, and nothing added, where a value is odd."""
        labels = [label for label in COLUMNS if label in self.table.known]
        groups = sum_groups(self.table, labels)
        if groups is None:
            return False
        for label in labels:
            parts = [label] if label in KEY else [f"{label}_min", f"{label}_max"]
            values, fault = self._check(np.concatenate([groups[part] for part in parts]), label)
            has_all = label in (*KEY, "reward") or (groups[f"{label}_count"] == groups["count"]).all()
            if fault is not None or not has_all:
                return False
            if label in KEY:
                groups[label] = values
        if "reward" in labels:
            if (np.isnan(groups["reward_max"]) & (groups["reward_count"] > 0)).any():
                return False  # a reward that is nan is missing, and DuckDB adds it
            groups["reward_sum"] = np.nan_to_num(groups["reward_sum"])
        self.sums.add(groups)
        self.n_truncated = int(groups["truncated_sum"].sum()) if "truncated" in labels else 0
        return True

    def add(self, piece: Piece) -> None:
        """One more piece."""
        for row, words in piece.lost.items():
            self._note("fields", row, words)
        columns, is_bad = {}, np.zeros(len(piece.rows), dtype=np.bool_)
        has_episode = ~is_bad
        for label, raw in piece.columns.items():
            columns[label], fault = self._check(raw, label)
            if fault is not None:
                self._note_fault(fault.label, fault, piece.rows)
                is_bad[fault.rows] = True
                has_episode[fault.rows] &= label != "episode"
        if "episode" in columns and has_episode.any():
            self._follow(_choose(columns | {"is_bad": is_bad, "row": piece.rows}, has_episode))
        self.last_lost = max([self.last_lost, *piece.lost, *piece.rows[~has_episode]])
        good = _choose(columns, ~is_bad)
        self.n_dropped += len(piece.lost) + int(is_bad.sum())
        self.n_truncated += int(good["truncated"].sum()) if "truncated" in good else 0
        self.sums.add(good)

    def _check(self, raw: Column, label: str) -> tuple[Column, Fault | None]:
        """The values of a column, names as the simulator's numbers, and what is wrong with it."""
        if label not in MOVE:
            return self.table.check(raw, label)
        is_action = label == "action"
        names = self.limits.names[is_action]
        values, fault = self.table.check(raw, label, high=self.limits.sizes[is_action], names=names)
        if fault is not None and names is None and isinstance(fault.value, str) and fault.value.strip()[:1].isalpha():
            fault = fault._replace(hint=NAMES_HINT)
        return values, fault

    def _note_fault(self, kind: str, fault: Fault, rows: IntArray) -> None:
        row = int(rows[fault.rows[0]])
        self._note(kind, row, fault.describe(row), len(fault.rows))

    def _note(self, kind: str, row: int, words: str, n: int = 1) -> None:
        """Keep the words for the first row of each kind of fault, and how many there are."""
        first_row, first_words, before = self.faults.get(kind, (row, words, 0))
        self.faults[kind] = first_row, first_words, before + n

    def _follow(self, columns: dict[str, Column]) -> None:
        """Where episodes begin, which are broken, and which rows may be in the sample."""
        last = self.last or {label: column[:1] for label, column in columns.items()}
        before = {label: np.concatenate([last[label], column[:-1]]) for label, column in columns.items()}
        rows, is_bad = columns["row"], columns["is_bad"]
        is_first = np.asarray(columns["episode"] != before["episode"], dtype=np.bool_)
        is_first[0] |= not self.last
        run = self.n_runs - 1 + np.cumsum(is_first)
        is_gap = np.diff(rows, prepend=self.last_row) > 1  # rows were lost before this one
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
        may_be_kept = hash_places(run, self.name) < np.uint64(self.limit)
        own = {label: columns[label] for label in COLUMNS if label in columns and label != "episode"}
        self.kept.append(_choose({"run": run} | own, may_be_kept))
        if sum(len(kept["run"]) for kept in self.kept) > N_SPARE * self.limits.kept:
            self._cut_sample()

    def _cut_sample(self) -> Sample:
        """The episodes first in the draw, of those that are not broken so far."""
        rows = {label: np.concatenate([kept[label] for kept in self.kept]) for label in self.kept[0]}
        runs, length = np.unique(rows["run"], return_counts=True)
        sample = Sample(hash_places(runs, self.name), length, rows, self.limit)
        sample = sample.cut(self.limits.kept, ~np.isin(runs, np.concatenate(self.broken)))
        self.kept = [sample.rows]
        self.limit = sample.limit
        return sample._replace(rows={label: column for label, column in sample.rows.items() if label != "run"})

    def result(self) -> FileCounts:
        """What was counted."""
        sample = NO_SAMPLE
        entries = self.sums.entries()
        recording = Recording(by_episodes="episode" in self.table.known, files=1, dropped=self.n_dropped)
        if self.n_rows:
            starts, first_rows = np.concatenate(self.starts, axis=1)
            self._find_repeated(first_rows)
            sample = self._cut_sample()
            length = np.diff(starts, append=self.n_rows)
            broken = np.unique(np.concatenate(self.broken))
            recording = recording._replace(
                episodes=len(length),
                shortest=int(length.min()),
                longest=int(length.max()),
                broken=int((broken >= 0).sum()),
            )
            if "truncated" not in self.table.known:
                n_terminated = int(entries["count"][entries["terminated"] == 1].sum())
                self.n_truncated = max(len(length) - n_terminated, 0)
        known = frozenset(self.table.known)
        unknown = tuple(label for label in self.table.labels if label not in COLUMNS)
        recording = recording._replace(truncated=self.n_truncated, reasons=self._reasons())
        return FileCounts(entries, recording, sample, known, unknown)

    def _find_repeated(self, first_rows: IntArray) -> None:
        """An episode's rows stand together: no run has the episode of another."""
        names = np.concatenate(self.names)
        names = names.astype(str) if names.dtype.hasobject else names
        repeat = find_repeat(names, first_rows)
        if repeat is not None:
            self._note("together", *repeat)
            _, code, number = np.unique(names, return_inverse=True, return_counts=True)
            self.broken.append(np.flatnonzero(number[code] > 1))
        if self.last_lost > self.last_row:
            self.broken.append(np.array([self.n_runs - 1]))

    def _reasons(self) -> tuple[str, ...]:
        """What is wrong with the file, the first of each kind; ValueError where that is refused."""
        words = []
        for _, text, n in sorted(self.faults.values())[:N_REASONS]:
            more = f"; {n - 1} other rows break the same rule" * (n > 1)
            words.append(f"{self.table.file.path!r}: {text}{more}")
            if not self.limits.drop:
                raise ValueError(words[0] + WAY)
        return tuple(words)


def _choose(columns: dict[str, Column], chosen: BoolArray) -> dict[str, Column]:
    """The chosen rows of columns; the columns themselves where all are."""
    return columns if chosen.all() else {label: column[chosen] for label, column in columns.items()}


def hash_places(number: IntArray, name: str) -> NDArray[np.uint64]:
    """splitmix64 of number + a hash of the name: a place in the draw for each."""
    salt = np.uint64(int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "little"))
    with np.errstate(over="ignore"):
        x = (number.astype(np.uint64) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15) + salt
        x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        return np.asarray(x ^ (x >> np.uint64(31)))

"""One file of a log, counted: its moves, and what is wrong with its rows."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from oee_tabular._checks import Array, BoolArray, Column, IntArray
from oee_tabular.data import _counting
from oee_tabular.data.batches import Batch, batches
from oee_tabular.data.files import MOVE
from oee_tabular.data.parts import NAMES, Part
from oee_tabular.data.readers import READERS, Limits
from oee_tabular.data.sampling import Episodes

REASONS = 5  # kinds of bad rows that are told with an example


class Counted(NamedTuple):
    """What a file, or several, came to: ``key`` (K, 4) s, a, s', ended; ``sums`` (K, 4) number, total, least, most.

    ``facts``: rows, episodes, shortest, longest, truncated, broken, dropped, files. ``sample``: columns of whole episodes by
    their ``key`` and number, of all whose key is at most ``most``.
    """

    key: IntArray
    sums: Array
    facts: IntArray
    reasons: tuple[str, ...]
    rewarded: bool
    by_episodes: bool
    sample: dict[str, Column]
    most: int


ROWS, EPISODES, SHORTEST, LONGEST, TRUNCATED, BROKEN, DROPPED, FILES = range(8)


def count_part(part: Part, label: str, limits: Limits, most: int = 2**64 - 1, expected: int = 0) -> Counted:
    """Count one file. ``label`` names it in the draw of the sample, of which keys above ``most`` are no longer asked for;
    ``expected``: about how many different moves it has, which saves time alone.

    Cost: O(rows).
    """
    tally = Tally(part, label, limits, Growing(expected))
    if tally.episodes is not None:
        tally.episodes.sample.most = np.uint64(most)
    for batch in batches(part):
        tally.add(batch)
    return tally.done()


class Growing:
    """A table of moves that grows with what it holds; ``expected`` are how many different ones there may be."""

    def __init__(self, expected: int = 0) -> None:
        self.table = _empty(2 ** max(10, math.ceil(math.log2((expected + 1) / _counting.FULL))))

    def __len__(self) -> int:
        return int(self.table.used[0])

    def add(self, rows: Any) -> None:
        """Add rows in their order."""
        begin = _counting.add(self.table, rows, 0)
        while begin < len(rows.state):
            old = self.contents()
            self.table = _empty(2 * len(self.table.cell))
            _counting.add(self.table, rows_of(*old), 0)
            begin = _counting.add(self.table, rows, begin)

    def contents(self) -> tuple[IntArray, Array]:
        """Keys and sums, as they stand in the table."""
        taken = np.flatnonzero(self.table.real[:, 4] > 0)
        return self.table.cell[taken, :4], self.table.real[taken, 4:]


def _empty(slots: int) -> Any:
    """A table without rows; ``slots`` is a power of 2."""
    memory = np.zeros(8 * (slots + 1), dtype=np.int64)
    first = -memory.ctypes.data % 64 // 8  # cells begin where cache lines do
    cell = memory[first : first + 8 * slots].reshape(slots, 8)
    return _counting.Table(cell, cell.view(np.float64), np.zeros(1, dtype=np.int64))


def rows_of(key: IntArray, sums: Array) -> Any:
    """Keys and sums as rows to be added."""
    state, action, next_state, ended = (np.ascontiguousarray(column) for column in key.T)
    return _counting.Rows(state, action, next_state, ended, np.zeros(0), np.ascontiguousarray(sums))


def in_order(key: IntArray, sums: Array) -> tuple[IntArray, Array]:
    """Sorted by s, a, s', ended."""
    order = np.lexsort(key.T[::-1])
    return np.ascontiguousarray(key[order]), np.ascontiguousarray(sums[order])


@dataclass
class Tally:
    """The rows of a file, batch by batch."""

    part: Part
    label: str
    limits: Limits
    moves: Growing = field(default_factory=Growing)
    reasons: dict[str, str] = field(default_factory=dict)
    dropped: int = 0
    rows: int = 0
    truncated: int = 0

    def __post_init__(self) -> None:
        self.by_episodes = "episode" in self.part.known
        self.episodes = Episodes(self.label, self.limits.kept, self.bad) if self.by_episodes else None

    def add(self, batch: Batch) -> None:
        """Count the rows of a batch; ValueError for the first bad one, unless they are dropped."""
        for row, words in batch.lost:
            self.bad("fields", f"row {row} {words}", 1)
        columns, wrong = self._read(batch)
        bad = np.zeros(len(batch.row), dtype=np.bool_)
        for mask in wrong.values():
            bad |= mask
        self.dropped += int(bad.sum())
        good = ~bad
        self.rows += int(good.sum())
        self.moves.add(_rows(columns, good if bad.any() else slice(None)))
        if "truncated" in columns:
            self.truncated += int((columns["truncated"] & good).sum())
        if self.episodes is not None:
            lost = wrong.get("episode", np.zeros(len(bad), dtype=np.bool_))
            self.episodes.add(columns, bad, lost, batch.row, [row for row, _ in batch.lost])

    def _read(self, batch: Batch) -> tuple[dict[str, Column], dict[str, BoolArray]]:
        """The columns as a log has them, and of each the rows with a bad value."""
        columns: dict[str, Column] = {}
        wrong: dict[str, BoolArray] = {}
        first: list[tuple[int, str, str]] = []
        for name, column in batch.columns.items():
            values, faults = READERS[name](column, self.limits)
            if name in batch.missing:
                faults = [(batch.missing[name], "must have a value", "it has none"), *faults]
            mask = np.zeros(len(values), dtype=np.bool_)
            for at, rule, found in faults:
                fresh = at & ~mask
                mask |= at
                if fresh.any():
                    k = int(np.argmax(fresh))
                    named = name in MOVE and at.all() and isinstance(column[k], str)
                    said = found(k) if callable(found) else found or f"it is {column[k]}{NAMES * bool(named)}"
                    first.append((k, f"{name} {rule}", f"{name}[{batch.row[k]}] {rule}; {said}"))
            columns[name] = values
            if mask.any():
                wrong[name] = mask
        for _, kind, words in sorted(first):
            self.bad(kind, words, 0)
        return columns, wrong

    def bad(self, kind: str, words: str, rows: int) -> None:
        """Refuse, or note, what is wrong; the first of each kind is told."""
        text = f"{self.part.name!r}: {words}"
        if not self.limits.drop:
            raise ValueError(f"{text} (bad_rows='drop', --bad-rows drop, leaves such rows out and counts them)")
        self.dropped += rows
        if len(self.reasons) < REASONS:
            self.reasons.setdefault(kind, text)

    def done(self) -> Counted:
        """What was counted."""
        sample: dict[str, Column] = {}
        most = np.uint64(2**64 - 1)
        facts = np.zeros(8, dtype=np.int64)
        if self.episodes is not None:
            episodes, self.episodes = self.episodes, None  # which know this: memory is given back at once
            sample, more = episodes.done()
            most = episodes.sample.most
            facts[[EPISODES, SHORTEST, LONGEST, TRUNCATED, BROKEN]] = more
        if "truncated" in self.part.known:
            facts[TRUNCATED] = self.truncated
        facts[[ROWS, DROPPED, FILES]] = self.rows, self.dropped, 1
        key, sums = self.moves.contents()
        rewarded = "reward" in self.part.known
        return Counted(key, sums, facts, tuple(self.reasons.values()), rewarded, self.by_episodes, sample,
                       int(most))  # fmt: skip


def _rows(columns: dict[str, Column], keep: Any) -> Any:
    """The moves of some rows, each one of it."""
    ended = columns["terminated"].astype(np.int64) if "terminated" in columns else np.zeros_like(columns["state"])
    pay = columns["reward"][keep] if "reward" in columns else np.zeros(0)
    state, action, next_state = (columns[name][keep] for name in ("state", "action", "next_state"))
    return _counting.Rows(state, action, next_state, ended[keep], pay, np.zeros((0, 4)))

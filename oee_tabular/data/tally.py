"""One file of a log, counted: its moves, what is wrong with its rows, and a sample of its whole episodes."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oee_tabular._checks import Array, BoolArray, IntArray
from oee_tabular.data import _counting
from oee_tabular.data.parts import Batch, Part, batches

LARGEST = 2**53  # from which on a float does not tell n from n + 1
REASONS = 5  # kinds of bad rows that are told with an example
_TRUE, _FALSE = ("true", "1", "1.0"), ("false", "0", "0.0")
_SAMPLED = ("state", "action", "next_state", "reward", "terminated", "truncated", "timestep", "behavior_probability")


class Limits(NamedTuple):
    """What rows must keep to: numbers below ``states`` and ``actions``; ``drop``: others are left out, not refused."""

    states: int = LARGEST
    actions: int = LARGEST
    drop: bool = False
    kept: int = 200_000


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
    sample: dict[str, NDArray[Any]]
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
    pending: list[int] = field(default_factory=list)  # numbers of lost rows whose place is in a later batch

    def __post_init__(self) -> None:
        self.by_episodes = "episode" in self.part.known
        self.episodes = Episodes(self) if self.by_episodes else None

    def add(self, batch: Batch) -> None:
        """Count the rows of a batch; ValueError for the first bad one, unless they are dropped."""
        for row, words in batch.lost:
            self.bad("fields", f"row {row} {words}", 1)
        self.pending += [row for row, _ in batch.lost]
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
            self.episodes.add(columns, bad, lost, batch.row)

    def _read(self, batch: Batch) -> tuple[dict[str, NDArray[Any]], dict[str, BoolArray]]:
        """The columns as a log has them, and of each the rows with a bad value."""
        columns: dict[str, NDArray[Any]] = {}
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
                    said = found or f"it is {column[k]}"
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
        sample: dict[str, NDArray[Any]] = {}
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


def _rows(columns: dict[str, NDArray[Any]], keep: Any) -> Any:
    """The moves of some rows, each one of it."""
    ended = columns["terminated"].astype(np.int64) if "terminated" in columns else np.zeros_like(columns["state"])
    pay = columns["reward"][keep] if "reward" in columns else np.zeros(0)
    state, action, next_state = (columns[name][keep] for name in ("state", "action", "next_state"))
    return _counting.Rows(state, action, next_state, ended[keep], pay, np.zeros((0, 4)))


@dataclass
class Episodes:
    """Where the episodes of a file begin and break, and a sample of the whole ones.

    An episode's place in the draw is a hash of the file's label and the episode's number: whatever the batches and the order of
    the files, those first in it are kept, as many as together have at most ``kept`` moves.
    """

    tally: Tally

    def __post_init__(self) -> None:
        self.carried = np.zeros(_counting.CARRIED, dtype=np.int64)
        self.carried[_counting.ORDINAL] = -1
        self.broken: set[int] = set()
        self.runs: list[IntArray] = []  # (first, last, row) of names in a row that grow by 1
        self.sample = Sample(self.tally.limits.kept)
        self.salt = int.from_bytes(hashlib.sha256(self.tally.label.encode()).digest()[:8], "little")

    def add(self, columns: dict[str, NDArray[Any]], bad: BoolArray, nameless: BoolArray, row: IntArray) -> None:
        """The next rows; those without a name are lost."""
        gap = self._gaps(nameless, row)
        if nameless.any():
            columns = {name: column[~nameless] for name, column in columns.items()}
            bad, row, gap = bad[~nameless], row[~nameless], gap[~nameless]
        n, last = len(row), int(self.carried[_counting.ORDINAL])
        none, false = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.bool_)
        steps = _counting.Steps(
            columns["episode"], columns["state"], columns["next_state"],
            columns.get("terminated", np.zeros(n, dtype=np.bool_)), columns.get("truncated", false),
            columns.get("timestep", none), bad, gap,
        )  # fmt: skip
        ordinal, fault = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
        _counting.walk(steps, self.carried, ordinal, fault)
        begins = np.flatnonzero(np.diff(ordinal, prepend=last))
        self._name(columns["episode"][begins], row[begins])
        at = np.flatnonzero(gap)
        self.broken |= {*ordinal[at].tolist(), *(ordinal[np.intersect1d(at, begins)] - 1).tolist()}
        at = np.flatnonzero(fault)
        if at.size:
            self.broken |= set(np.unique(ordinal[at]).tolist())
            self._tell(columns, fault, at, row)
        keys = _mixed(ordinal, self.salt)
        keep = keys <= self.sample.most
        if keep.any():
            chosen = {name: columns[name][keep] for name in _SAMPLED if name in columns}
            self.sample.add(chosen | {"key": keys[keep], "ordinal": ordinal[keep]})

    def _gaps(self, nameless: BoolArray, row: IntArray) -> BoolArray:
        """Before which rows some were lost."""
        lost = np.concatenate([np.array(self.tally.pending, dtype=np.int64), row[nameless]])
        named = row[~nameless]
        gap = np.zeros(len(row), dtype=np.bool_)
        at = np.searchsorted(named, lost)
        self.tally.pending = lost[at == len(named)].tolist()
        gap[np.flatnonzero(~nameless)[at[at < len(named)]]] = True
        return gap

    def _name(self, names: IntArray, row: IntArray) -> None:
        """Note which names episodes have, as runs that grow by 1."""
        if not len(names):
            return
        cut = np.flatnonzero(np.diff(names) != 1) + 1
        first, last = np.concatenate([[0], cut]), np.concatenate([cut, [len(names)]]) - 1
        runs = np.stack([names[first], names[last], row[first]], axis=1)
        if self.runs and self.runs[-1][-1, 1] + 1 == runs[0, 0]:
            self.runs[-1][-1, 1] = runs[0, 1]
            runs = runs[1:]
        if len(runs):
            self.runs.append(runs)

    def _tell(self, columns: dict[str, NDArray[Any]], fault: IntArray, at: IntArray, row: IntArray) -> None:
        """Refuse, or note, rows that do not go on with their episode."""
        for kind, rule in (
            (
                _counting.TIMESTEP,
                "timestep[{}] must be the number of the step in episode {}, in order from 0; it is {}",
            ),
            (_counting.APART, "state[{}] must be the next_state of the row before, in episode {}; it is {}"),
            (
                _counting.EARLY,
                "episode[{}] must be another than that of the row before, which ended episode {}; it is {}",
            ),
        ):
            some = at[fault[at] == kind]
            if some.size:
                k = int(some[0])
                column = {_counting.TIMESTEP: "timestep", _counting.APART: "state", _counting.EARLY: "episode"}[kind]
                self.tally.bad(column + " in order", rule.format(row[k], columns["episode"][k], columns[column][k]), 0)

    def done(self) -> tuple[dict[str, NDArray[Any]], list[int]]:
        """The sample; how many episodes, the shortest, the longest, how many without an end, how many broken."""
        number = int(self.carried[_counting.ORDINAL]) + 1
        _counting.close(self.carried)
        if self.tally.pending:
            self.broken.add(number - 1)
        again = self._again()
        if again is not None:
            name, row = again
            words = f"episode must keep the rows of an episode together; {name} begins again from row {row} on"
            self.tally.bad("episode together", words, 0)
            self.broken |= set(range(number))
        self.broken -= {-1}
        self.sample.leave_out(np.array(sorted(self.broken), dtype=np.int64))
        carried = self.carried[[_counting.SHORTEST, _counting.LONGEST, _counting.UNFINISHED]].tolist()
        return self.sample.columns(), [number, *carried, len(self.broken)]

    def _again(self) -> tuple[int, int] | None:
        """The first name that two episodes have, and the row where the later begins its run."""
        if not self.runs:
            return None
        runs = np.concatenate(self.runs)
        runs = runs[np.lexsort([runs[:, 2], runs[:, 0]])]
        reach = np.maximum.accumulate(runs[:, 1])
        twice = np.flatnonzero(runs[1:, 0] <= reach[:-1])
        if not twice.size:
            return None
        k = int(twice[0]) + 1
        return int(runs[k, 0]), int(max(runs[k, 2], runs[k - 1, 2]))


@dataclass
class Sample:
    """Whole episodes in the order of their keys, as many of the first as together have at most ``size`` moves."""

    size: int

    def __post_init__(self) -> None:
        self.most = np.uint64(2**64 - 1)
        self.held: list[dict[str, NDArray[Any]]] = []
        self.moves = 0

    def add(self, rows: dict[str, NDArray[Any]]) -> None:
        """More rows, with their ``key``; those of an episode stand together."""
        keep = rows["key"] <= self.most
        self.held.append(rows if keep.all() else {name: column[keep] for name, column in rows.items()})
        self.moves += int(keep.sum())
        if self.moves > 2 * self.size:
            self.cut()

    def columns(self) -> dict[str, NDArray[Any]]:
        """What is kept."""
        self.cut()
        return self.held[0] if self.held else {}

    def cut(self) -> None:
        """Keep the first episodes; of the last to come the rest may follow, which can only push others out."""
        if not self.held:
            return
        self._gather()
        key = self.held[0]["key"]
        begins = np.flatnonzero(np.concatenate([[True], key[1:] != key[:-1]])[: len(key)])
        lengths = np.diff(begins, append=len(key))
        order = np.argsort(key[begins])
        fits = np.cumsum(lengths[order]) <= self.size
        if not fits.all():
            first_out = int(key[begins][order[np.argmin(fits)]])
            self.most = min(self.most, np.uint64(max(first_out - 1, 0)))
        if (key > self.most).any():
            self._keep(key <= self.most)

    def leave_out(self, ordinals: IntArray) -> None:
        """Without the episodes of these numbers."""
        if len(ordinals) and self.held:
            self._gather()
            self._keep(~np.isin(self.held[0]["ordinal"], ordinals))

    def _gather(self) -> None:
        self.held = [{name: np.concatenate([part[name] for part in self.held]) for name in self.held[0]}]

    def _keep(self, mask: BoolArray) -> None:
        self.held = [{name: column[mask] for name, column in self.held[0].items()}]
        self.moves = int(mask.sum())


def _mixed(number: IntArray, salt: int) -> NDArray[np.uint64]:
    """splitmix64 of salt + number: a place in the draw for each."""
    with np.errstate(over="ignore"):
        x = (number.astype(np.uint64) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(salt)
        x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        mixed: NDArray[np.uint64] = x ^ (x >> np.uint64(31))
        return mixed


# ---- columns: their values, and (mask, rule, what is found) of those that are none


Fault = tuple[BoolArray, str, str]


def _numbers(column: NDArray[Any]) -> NDArray[Any]:
    """Text as numbers, nan where it is none."""
    if column.dtype.kind not in "OUT":
        return column
    import pandas as pd

    return np.asarray(pd.to_numeric(pd.Series(column).astype(object), errors="coerce"))


def _whole(column: NDArray[Any], low: int | None, high: int, above: str) -> tuple[IntArray, list[Fault]]:
    values, faults = _numbers(column), []
    if values.dtype.kind == "f":
        odd = ~((np.abs(values) <= 2.0**53) & (values == np.floor(values)))
        if odd.any():
            faults.append((odd, "must be an integer", ""))
            values = np.where(odd, 0.0, values)
    if values.dtype.kind == "u" and values.dtype.itemsize == 8 and len(values) and values.max() >= 2**63:
        beyond = values >= 2**63
        faults.append((beyond, above, ""))
        values = np.where(beyond, 0, values)
    whole: IntArray = values.astype(np.int64, copy=False)
    if len(whole) and low is not None and whole.min() < low:
        faults.append((whole < low, f"must be at least {low}", ""))
    if len(whole) and whole.max() >= high:
        faults.append((whole >= high, above, ""))
    return whole, faults


def _range(size: int) -> str:
    return "must be below 2**53" if size == LARGEST else f"must be in 0..{size - 1}"


def _states(column: NDArray[Any], limits: Limits) -> tuple[NDArray[Any], list[Fault]]:
    return _whole(column, 0, limits.states, _range(limits.states))


def _actions(column: NDArray[Any], limits: Limits) -> tuple[NDArray[Any], list[Fault]]:
    return _whole(column, 0, limits.actions, _range(limits.actions))


def _steps(column: NDArray[Any], limits: Limits) -> tuple[NDArray[Any], list[Fault]]:
    return _whole(column, 0, LARGEST, _range(LARGEST))


def _names(column: NDArray[Any], limits: Limits) -> tuple[NDArray[Any], list[Fault]]:
    return _whole(column, None, 2**63, "must be below 2**63")


def _rewards(column: NDArray[Any], limits: Limits) -> tuple[NDArray[Any], list[Fault]]:
    values = _numbers(column).astype(np.float64, copy=False)
    fine = np.isfinite(values)
    return values, [] if fine.all() else [(~fine, "must be finite", "")]


def _probabilities(column: NDArray[Any], limits: Limits) -> tuple[NDArray[Any], list[Fault]]:
    values = _numbers(column).astype(np.float64, copy=False)
    fine = (values >= 0) & (values <= 1)
    return values, [] if fine.all() else [(~fine, "must be in [0, 1]", "")]


def _flags(column: NDArray[Any], limits: Limits) -> tuple[NDArray[Any], list[Fault]]:
    if column.dtype.kind == "b":
        return column, []
    if column.dtype.kind in "iuf":
        ones = column == 1
        fine = ones | (column == 0)
        return ones, [] if fine.all() else [(~fine, "must be a boolean (or 0 or 1)", "")]
    words = np.char.lower(column.astype(str))
    true = np.isin(words, _TRUE)
    fine = true | np.isin(words, _FALSE)
    return true, [] if fine.all() else [(~fine, "must be a boolean (or 0 or 1)", "")]


READERS = {
    "state": _states,
    "action": _actions,
    "next_state": _states,
    "reward": _rewards,
    "terminated": _flags,
    "truncated": _flags,
    "episode": _names,
    "timestep": _steps,
    "behavior_probability": _probabilities,
}

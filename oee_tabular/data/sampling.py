"""The episodes of a file: where they begin and break, and a sample of the whole ones."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oee_tabular._checks import BoolArray, Column, IntArray
from oee_tabular.data import _counting

_SAMPLED = ("state", "action", "next_state", "reward", "terminated", "truncated", "timestep", "behavior_probability")


@dataclass
class Episodes:
    """Where the episodes of a file begin and break, and a sample of the whole ones.

    An episode's place in the draw is a hash of the file's ``label`` and the episode's number: whatever the batches and order
    of the files, those first in it are kept, as many as together have at most ``kept`` moves.
    """

    label: str
    kept: int
    bad: Callable[[str, str, int], None]  # notes what is wrong, or refuses: its kind, in words, rows left out

    def __post_init__(self) -> None:
        self.pending: list[int] = []  # numbers of lost rows whose place is in a later batch
        self.carried = np.zeros(_counting.CARRIED, dtype=np.int64)
        self.carried[_counting.ORDINAL] = -1
        self.broken: set[int] = set()
        self.runs: list[IntArray] = []  # (first, last, row) of names in a row that grow by 1
        self.sample = Sample(self.kept)
        self.salt = int.from_bytes(hashlib.sha256(self.label.encode()).digest()[:8], "little")

    def add(
        self, columns: dict[str, Column], bad: BoolArray, nameless: BoolArray, row: IntArray, lost: list[int]
    ) -> None:
        """The next rows, without the numbers that are ``lost``; those without a name are lost as well."""
        self.pending += lost
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
        lost = np.concatenate([np.array(self.pending, dtype=np.int64), row[nameless]])
        named = row[~nameless]
        gap = np.zeros(len(row), dtype=np.bool_)
        at = np.searchsorted(named, lost)
        self.pending = lost[at == len(named)].tolist()
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

    def _tell(self, columns: dict[str, Column], fault: IntArray, at: IntArray, row: IntArray) -> None:
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
                self.bad(column + " in order", rule.format(row[k], columns["episode"][k], columns[column][k]), 0)

    def done(self) -> tuple[dict[str, Column], list[int]]:
        """The sample; how many episodes, the shortest, the longest, how many without an end, how many broken."""
        number = int(self.carried[_counting.ORDINAL]) + 1
        _counting.close(self.carried)
        if self.pending:
            self.broken.add(number - 1)
        again = self._again()
        if again is not None:
            name, row = again
            words = f"episode must keep the rows of an episode together; {name} begins again from row {row} on"
            self.bad("episode together", words, 0)
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
        self.held: list[dict[str, Column]] = []
        self.moves = 0

    def add(self, rows: dict[str, Column]) -> None:
        """More rows, with their ``key``; those of an episode stand together."""
        keep = rows["key"] <= self.most
        self.held.append(rows if keep.all() else {name: column[keep] for name, column in rows.items()})
        self.moves += int(keep.sum())
        if self.moves > 2 * self.size:
            self.cut()

    def columns(self) -> dict[str, Column]:
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

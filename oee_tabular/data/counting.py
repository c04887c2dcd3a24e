"""One file of a log as counts, in one pass and in the memory of the counts.

Of each piece of the file the values are checked (``rules.py``), rows that break a rule
are noted, and the others are added to the sums of their (s, a, s', terminated). Of
whole episodes a sample is kept, for importance sampling: those first in the order of a
hash of the file's name and the episode's number. It is uniform over the whole episodes,
and the same wherever it is drawn.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from oee_tabular import _checks
from oee_tabular._memory import free_memory
from oee_tabular.data.copies import N_GROUPED_ROWS, EndRows, Print
from oee_tabular.data.counts import N_REASONS, Recording
from oee_tabular.data.joining import Row, order_hint
from oee_tabular.data.labels import Matching
from oee_tabular.data.rules import (
    COLUMNS,
    KEY,
    MOVE,
    Fault,
    check_column,
    find_headers,
    find_order_faults,
    find_repeat,
    is_absent,
)
from oee_tabular.data.sums import add_sums, join_sums
from oee_tabular.data.tables import (
    LogFile,
    Piece,
    Table,
    add_folders,
    match_own,
    open_table,
    sum_groups,
)
from oee_tabular.data.transitions import Transitions
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import Name, numbers_of
from oee_tabular.typing import BoolArray, Column, IntArray

LARGEST = 2**53  # from which on a float does not tell n from n + 1
MAX_SAMPLE_FACTOR = 2  # rows that are kept before the sample is cut, of those wanted
LAST_PLACE = 2**64 - 1
# of 8 bytes each, that a different transition has while sums are joined: nine columns
# twice, its key, and the places of its sums
NUMBERS_PER_ENTRY = 26.0

# the first row of a fault, its place, the broken rule, and the number of rows
FirstFault: TypeAlias = tuple[int, str, str, int]
WAY = " (bad_rows='drop', --bad-rows drop, leaves such rows out and counts them)"


# kinds of faults of rows that are counted, in episodes that are broken
ORDER_KINDS = {"together"} | {f"order of {label}" for label in COLUMNS}
COUNTED = " (such rows are counted; their episodes are not whole)"


class Limits(NamedTuple):
    """Hold the limits of rows: numbers below ``sizes`` (states, actions), or names.

    ``drop``: whether other rows are left out. ``kept``: the transitions of the sample.
    ``has_others``: whether an episode may go on in another file. ``columns``: what the
    files call a log's columns. ``end``: the only state in which an episode can be over.
    """

    sizes: tuple[int, int] = (LARGEST, LARGEST)
    names: tuple[tuple[Name, ...] | None, tuple[Name, ...] | None] = (None, None)
    drop: bool = False
    kept: int = 200_000
    has_others: bool = False
    columns: Mapping[str, Any] = {}
    end: int | None = None


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
        rows = {}
        for label in dict.fromkeys(label for part in parts for label in part):
            columns = [
                part.get(label, np.full(len(part["place"]), np.nan)) for part in parts
            ]
            rows[label] = np.concatenate(columns)
        return cut_sample(rows, kept, limit)


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


class Run(NamedTuple):
    """Hold the rows of an episode that may go on in another file.

    ``rows`` are its columns, or None where they are more than a sample has; ``place``
    is that of the episode in the draw.
    """

    rows: dict[str, Column] | None
    n: int
    place: int
    is_broken: bool

    def join(self, other: Run, kept: int) -> Run:
        """Return the episode that goes on in the ``other``, with its own place."""
        n = self.n + other.n
        rows = None
        if self.rows is not None and other.rows is not None and n <= kept:
            rows = {
                label: np.concatenate([self.rows[label], other.rows[label]])
                for label in self.rows
                if label in other.rows
            }
        return Run(rows, n, self.place, self.is_broken or other.is_broken)

    def sample(self, kept: int) -> Sample:
        """Return the sample that the episode is by itself."""
        if self.is_broken:
            return Sample()
        if self.rows is None or self.n > kept:
            return Sample(limit=self.place)
        place = np.full(self.n, self.place, dtype=np.uint64)
        return Sample(self.rows | {"place": place})


class Ends(NamedTuple):
    """Hold the episodes of a file that may go on in another file.

    Attributes
    ----------
    first, last : Row
        The first and the last row that have an episode.
    head : Run
        The first episode.
    tail : Run or None
        The last episode; None where it is over, or is the head.
    is_single : bool
        Whether all rows are of one episode.
    others : tuple of int
        The lengths of the shortest and the longest of the other episodes; none for
        none.
    """

    first: Row
    last: Row
    head: Run
    tail: Run | None
    is_single: bool
    others: tuple[int, ...]


class FileCounts(NamedTuple):
    """Hold the sums of a file, how it was recorded, and the labels of its columns.

    ``ends`` is None where no episode goes on in another file, ``ends_print`` where
    there is no other file, and ``episodes`` are those that stand in folders
    ``column=value``. ``dropped``: the numbers of the rows that were left out, by their
    state and action. ``n_ended``: those that terminated and have no next state, which
    is the only one in which an episode can be over.
    """

    sums: dict[str, Column] | None
    recording: Recording
    sample: Sample
    known: frozenset[str]
    matching: Matching
    ends: Ends | None = None
    episodes: tuple[str, ...] = ()
    dropped: Mapping[tuple[int, int], int] = {}
    n_ended: int = 0
    ends_print: Print | None = None


def count_file(file: LogFile, name: str, limits: Limits) -> FileCounts:
    """Count one file; its ``name`` is hashed for the sample."""
    counts: list[_FileCount] = []
    with name_missing_memory(
        file.path, lambda: sum(count.n_different() for count in counts)
    ):
        table = _open_any(file, limits)
        counts.append(_FileCount(file, limits, name, table))
        return _count_table(counts[0], table)


def _open_any(file: LogFile, limits: Limits) -> Table:
    """Return the table in a file; an npz or a Minari data set is read whole."""
    form = Transitions.FILES.with_columns(limits.columns)
    if file.suffix in (".csv", ".parquet"):
        table = open_table(file, form)
    else:
        columns = form.to_table(
            Transitions.load(file.path, columns=limits.columns).columns()
        )
        labels = list(columns)
        whole = Piece(columns, np.arange(len(columns["state"])), {})
        own = match_own(file, labels)
        whole = add_folders(file, own, whole)
        table = Table(labels, list(whole.columns), [whole], own)
    return table


@contextmanager
def name_missing_memory(path: str, n_different: Callable[[], int]) -> Iterator[None]:
    """Let a MemoryError say what is needed, what is free, and what helps.

    ``n_different`` returns the number of different transitions so far.
    """
    try:
        yield
    except MemoryError:
        # its own words, if any, say neither what is free nor what helps
        n = n_different()
    else:
        return
    free = free_memory() / 2**30
    raise MemoryError(
        f"{path!r} needs more memory than there is: it was over after {n} different"
        f" transitions, which take about {8 * NUMBERS_PER_ENTRY:.0f} bytes each while"
        f" more are added; {free:.3g} GiB are free (count in fewer processes, jobs=1;"
        " leave out columns, columns={'episode': None}; or merge states that need not"
        " be told apart)"
    )


def _count_table(count: _FileCount, table: Table) -> FileCounts:
    """Count all rows of a table, whose file is that of the empty ``count``."""
    file = count.file
    has_episodes = not {"episode", "timestep"}.isdisjoint(table.known)
    can_group = file.suffix == ".parquet" and not has_episodes
    if not (can_group and count.add_groups(table)):
        for piece in table.pieces:
            count.add(piece)
    sample = count.draw_episodes() if count.n_rows else Sample()
    sums = join_sums(count.sums) if count.sums else None
    recording = count.recording(sums, table)
    episodes: tuple[str, ...] = ()
    if file.fixed and count.names:
        episodes = tuple(map(str, np.unique(np.concatenate(count.names).astype(str))))
    return FileCounts(
        sums,
        recording,
        sample,
        frozenset(table.known),
        table.matching,
        count.ends,
        episodes,
        count.dropped,
        count.n_ended,
        count.ends_rows.print(),
    )


class _FileCount:
    """Hold the sums of the pieces so far, their faults, and their episodes."""

    def __init__(self, file: LogFile, limits: Limits, name: str, table: Table) -> None:
        self.file = file
        self.path = file.path
        self.table = table
        self.limits = limits
        self.ends: Ends | None = None
        self.first: Row | None = None
        # the rows of the first episode, where another file may begin it
        self.head: list[dict[str, Column]] = []
        self.n_head = 0
        self.name = name
        self.sums: list[dict[str, Column]] = []
        self.faults: dict[str, FirstFault] = {}  # by kind
        self.n_dropped = 0
        # rows that were left out, by their state and action
        self.dropped: Counter[tuple[int, int]] = Counter()
        self.n_ended = 0
        self.ends_rows = EndRows()
        self.n_truncated = 0
        # rows that have an episode, and runs of such rows with the same one
        self.n_rows = 0
        self.n_runs = 0
        self.last: dict[str, Column] = {}  # the last row of the piece before
        self.last_row = -1
        self.last_lost = -1
        # the first row of each run, among these rows and among those of the file
        self.starts: list[IntArray] = []
        self.names: list[Column] = []  # the episode of each run
        self.broken: list[IntArray] = []  # the runs with a bad row
        # the rows that may be in the sample, with their run
        self.kept: list[dict[str, Column]] = []
        self.limit = LAST_PLACE

    def n_different(self) -> int:
        """Return the number of sums so far, of which some may be of one transition."""
        return sum(len(part["count"]) for part in self.sums)

    def add_groups(self, table: Table) -> bool:
        """Add the whole of a parquet file without episodes, summed by DuckDB.

        Returns False, and adds nothing, where a value is odd.
        """
        taken = table.matching.taken
        names = {field: group[0] for field, group in taken.items() if len(group) == 1}
        # several columns make a name, or a folder names a column
        folders = {label for label, _ in self.file.fixed}
        if len(names) < len(taken) or not folders.isdisjoint(names.values()):
            return False
        n_ends = N_GROUPED_ROWS if self.limits.has_others else 0
        found = sum_groups(self.path, names, EndRows.LABELS, n_ends)
        if found is None or self._has_odd_values(found[0], table):
            return False
        groups, ends = found
        if "truncated" in groups:
            self.n_truncated = int(groups["count"][groups["truncated"]].sum())
        add_sums(self.sums, groups)
        for end in ends:
            self.ends_rows.add(
                {label: self._check(raw, label)[0] for label, raw in end.items()}
            )
        return True

    def _has_odd_values(self, groups: dict[str, Column], table: Table) -> bool:
        """Return whether DuckDB's sums need a look at the values themselves.

        States, actions and flags are replaced by their checked values.
        """
        if find_headers({label: groups[label] for label in MOVE}, table.labels).size:
            return True
        labels = table.known
        for label in labels:
            if label in (*KEY, "truncated"):
                groups[label], fault = self._check(groups[label], label)
                if fault is not None:
                    return True
                continue
            # texts have another order
            ends = np.concatenate([groups[f"{label}_min"], groups[f"{label}_max"]])
            fault = self._check(ends, label)[1]
            if fault is not None or ends.dtype.hasobject:
                return True
            is_complete = (groups[f"{label}_count"] == groups["count"]).all()
            if label != "reward" and not is_complete:
                return True
        if "reward" not in labels:
            return False
        # a reward that is nan is missing, and DuckDB adds it
        is_nan = np.isnan(groups["reward_max"]) & (groups["reward_count"] > 0)
        return bool(is_nan.any())

    def add(self, piece: Piece) -> None:
        """Check one more piece and add its sums and episodes."""
        for row, (place, rule) in piece.lost.items():
            self._note("fields", row, place, rule)
        columns = {}
        is_bad = np.zeros(len(piece.rows), dtype=np.bool_)
        has_episode = ~is_bad
        has_pair = ~is_bad
        faults = {}
        for label, raw in piece.columns.items():
            columns[label], faults[label] = self._check(raw, label)
        if self.limits.end is not None and faults["next_state"] is not None:
            self._end_in_only_state(piece, columns, faults)
        for label, fault in faults.items():
            if fault is not None:
                self._note_fault(label, fault, piece.rows)
                is_bad[fault.rows] = True
                has_episode[fault.rows] &= label != "episode"
                has_pair[fault.rows] &= label not in ("state", "action")
        if is_bad.any():
            lost = choose(
                {label: columns[label] for label in MOVE[:2]}, is_bad & has_pair
            )
            pairs = zip(*(column.tolist() for column in lost.values()), strict=True)
            self.dropped.update(pairs)
        if "episode" in columns and has_episode.any():
            marked = columns | {"is_bad": is_bad, "row": piece.rows}
            self._follow(choose(marked, has_episode))
        self.last_lost = max([self.last_lost, *piece.lost, *piece.rows[~has_episode]])
        good = choose(columns, ~is_bad)
        self.n_dropped += len(piece.lost) + int(is_bad.sum())
        if "truncated" in good:
            self.n_truncated += int(good["truncated"].sum())
        n_entries = self.n_different() + len(good["state"])
        _checks.require_memory(NUMBERS_PER_ENTRY * n_entries, repr(self.path))
        add_sums(self.sums, good)
        if self.limits.has_others:
            self.ends_rows.add(good)

    def _end_in_only_state(
        self,
        piece: Piece,
        columns: dict[str, Column],
        faults: dict[str, Fault | None],
    ) -> None:
        """Let terminated rows without a next state lead to the only terminal state.

        A row that terminated leads to a state in which an episode is over.
        """
        fault = faults["next_state"]
        terminated = columns.get("terminated")
        if fault is None or terminated is None:
            return
        is_over = terminated[fault.rows].astype(np.bool_)
        odd = faults["terminated"]
        if odd is not None:
            is_over &= ~np.isin(fault.rows, odd.rows)
        own = numbers_of(self.limits.names[0] or ())
        raw = piece.columns["next_state"]
        is_over &= np.array([is_absent(raw[row], own) for row in fault.rows], np.bool_)
        if not is_over.any():
            return
        following = columns["next_state"].copy()
        following[fault.rows[is_over]] = self.limits.end
        columns["next_state"] = following
        self.n_ended += int(is_over.sum())
        left = fault.rows[~is_over]
        faults["next_state"] = None
        if left.size:
            values = np.delete(raw, fault.rows[is_over])
            again = self._check(values, "next_state")[1]
            assert again is not None
            faults["next_state"] = again._replace(rows=left)

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
        if kind not in self.faults and not fault.shift:  # of values by themselves
            fault = fault.with_text(self.table.find_text(fault.label, row))
        self._note(kind, row, fault.place(row), fault.problem(), len(fault.rows))

    def _note(self, kind: str, row: int, place: str, rule: str, n: int = 1) -> None:
        """Keep the first row of each kind of fault with its rule, and count rows."""
        first = self.faults.get(kind, (row, place, rule, 0))
        self.faults[kind] = (*first[:3], first[3] + n)

    def _follow(self, columns: dict[str, Column]) -> None:
        """Record the starts of episodes, broken ones, and rows for the sample."""
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
        begins = is_first & ~is_broken
        if self.first is None:
            self.first = self._row(columns, 0, is_sound=not is_broken[0])
            begins[0] &= not self.limits.has_others  # it may go on from another file
        hint = order_hint(self.file, self.table.known, self.table.matching.fields())
        for fault in find_order_faults(columns, before, begins, follows):
            fault = fault._replace(hint=fault.hint + hint)
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
        self._keep_rows(columns, run)

    def _row(self, columns: dict[str, Column], k: int, *, is_sound: bool) -> Row:
        """Return one row of columns as an end of the file."""
        labels = [label for label in COLUMNS if label in columns]
        return Row(
            self.path, {label: _item(columns[label][k]) for label in labels}, is_sound
        )

    def _keep_rows(self, columns: dict[str, Column], run: IntArray) -> None:
        """Keep the rows whose episodes may be in the sample."""
        place = hash_places(np.arange(run[0], self.n_runs), self.name)[run - run[0]]
        labels = [label for label in COLUMNS if label in columns and label != "episode"]
        own = {label: columns[label] for label in labels}
        marked = own | {"run": run, "place": place}
        is_wanted = place < np.uint64(self.limit)
        if self.limits.has_others and run[0] == 0:
            is_head = run == 0
            if self.n_head <= self.limits.kept:
                self.head.append(choose(own, is_head))
            self.n_head += int(is_head.sum())
            is_wanted &= ~is_head
        self.kept.append(choose(marked, is_wanted))
        if (
            sum(len(kept["run"]) for kept in self.kept)
            > MAX_SAMPLE_FACTOR * self.limits.kept
        ):
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
            row, rule = repeat
            self._note("together", row, "episode", rule)
            _, code, number = np.unique(names, return_inverse=True, return_counts=True)
            self.broken.append(np.flatnonzero(number[code] > 1))
        if self.last_lost > self.last_row:
            self.broken.append(np.array([self.n_runs - 1]))
        sample = self._cut()
        rows = dict(sample.rows)
        if self.limits.has_others:
            rows = self._part_ends(rows)
        rows.pop("run", None)
        return sample._replace(rows=rows)

    def _part_ends(self, rows: dict[str, Column]) -> dict[str, Column]:
        """Note the episodes that may go on in another file; return the rows of others.

        The rows are those of the sample, in which the first episode is not.
        """
        broken = set(np.concatenate(self.broken).tolist())
        last_run = self.n_runs - 1
        is_sound = self.last_lost < self.last_row and not self.last["is_bad"][0]
        last = self._row(self.last, 0, is_sound=bool(is_sound))
        place = hash_places(np.array([0, last_run]), self.name).tolist()
        head = None
        if self.n_head <= self.limits.kept:
            labels = self.head[0]
            head = {
                label: np.concatenate([part[label] for part in self.head])
                for label in labels
            }
        first_run = Run(head, self.n_head, place[0], 0 in broken)
        length = np.diff(np.concatenate(self.starts, axis=1)[0], append=self.n_rows)
        between = length[1:]
        tail = None
        is_over = last.values.get("terminated") or last.values.get("truncated")
        if last_run and not is_over:
            is_tail = rows["run"] == last_run
            own = {
                label: column[is_tail]
                for label, column in rows.items()
                if label not in ("run", "place")
            }
            has_tail = bool(is_tail.any())
            n_tail = int(between[-1])
            tail = Run(own if has_tail else None, n_tail, place[1], last_run in broken)
            rows = choose(rows, ~is_tail)
            between = between[:-1]
        others = (int(between.min()), int(between.max())) if between.size else ()
        assert self.first is not None
        self.ends = Ends(self.first, last, first_run, tail, last_run == 0, others)
        return rows

    def recording(self, sums: Mapping[str, Column] | None, table: Table) -> Recording:
        """Return how the file was recorded, with the first row of each fault.

        Raises a ValueError where such rows are refused.
        """
        words = []
        first = sorted(self.faults, key=self.faults.__getitem__)[:N_REASONS]
        for kind in first:
            _, place, rule, n = self.faults[kind]
            others = f"; {n - 1} other rows break the same rule" if n > 1 else ""
            error = ArgumentError(f"{self.path!r}: {place}", rule + others)
            words.append(f"{error}{COUNTED if kind in ORDER_KINDS else ''}")
            if not self.limits.drop:
                raise ArgumentError(error.argument, error.rule + WAY)
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
            n_terminated = 0
            if sums is not None:
                n_terminated = int(sums["count"][sums["terminated"] == 1].sum())
            self.n_truncated = max(len(length) - n_terminated, 0)
        return recording._replace(
            episodes=len(length),
            shortest=int(length.min()),
            longest=int(length.max()),
            truncated=self.n_truncated,
            broken=int((broken >= 0).sum()),
        )


def _item(value: Any) -> Any:
    """Return a value of an array as Python's own."""
    return value.item() if isinstance(value, np.generic) else value


def choose(columns: dict[str, Column], chosen: BoolArray) -> dict[str, Column]:
    """Return the chosen rows of columns, or the columns if all are chosen."""
    if chosen.all():
        return columns
    return {label: column[chosen] for label, column in columns.items()}


def hash_places(number: IntArray, name: str) -> NDArray[np.uint64]:
    """Return splitmix64 of number + a hash of the name as a place in the draw."""
    digest = hashlib.sha256(name.encode("utf-8", "surrogatepass")).digest()
    salt = np.uint64(int.from_bytes(digest[:8], "little"))
    step = np.uint64(0x9E3779B97F4A7C15)
    with np.errstate(over="ignore"):
        x = (number.astype(np.uint64) + np.uint64(1)) * step + salt
        x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        return np.asarray(x ^ (x >> np.uint64(31)))

"""Files of one log that hold the same transitions, which would count twice.

Two files of the same bytes, or of one name in two formats with the same rows, are an
error. Of two files, the same run of rows is warned of: exports that overlap, or copies
in another form. The rows are compared by windows of ``N_WINDOW`` rows that stand once in
each of the two files. Runs may be the same by chance, as where little is random: p(row)
being the share of a row among those of its state in both files, the warning takes ::

    - sum_rows log2 p(row) >= MIN_BITS .

Files that hold the same rows in another order are warned of by a digest that is a sum
over rows. It takes the same bits of the numbers of rows of each kind, where n_k of the
n_s rows of a state s are of kind k::

    - log2 prod_s n_s! / prod_k n_k! prod_k (n_k / n_s)^n_k >= MIN_BITS .
"""

from __future__ import annotations

import hashlib
import os
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oee_tabular import _checks, _files
from oee_tabular.data.rules import KEY, MOVE
from oee_tabular.data.tables import LogFile, open_csv, read_parquet_header
from oee_tabular.exceptions import ArgumentError, DataWarning
from oee_tabular.typing import Column

N_WINDOW = 20  # rows that are compared at once; fewer may well be the same
N_TOLD = 4  # rows of equal files from which on there is a warning
MIN_BITS = 40.0  # a chance of 1e-12
N_ROWS = 2**14  # at each end of a file, which are compared
N_KEPT_ROWS = 2**22  # of the files before one, in 64 MB
N_SAMPLED = 256  # windows of a file, all of which are looked for in the files before it
SAMPLED_ONE_OF = 64  # of more windows
N_COMPARED = 3  # files that share most of the windows looked for, and the one before
N_GROUPED_ROWS = 2**12  # of a file whose other rows are not read one by one
BLOCK_BYTES = 2**20
ENDINGS = (".csv.gz", ".csv", ".parquet", ".npz")
REMEDY = (
    " (leave one of the two out; if they are two recordings that happen to be the same,"
    " join them in Python: Transitions.concatenate([Transitions.load(path), ...])"
    ".save('log.npz'))"
)
Hashes = NDArray[np.uint64]


def refuse_same_bytes(files: Sequence[LogFile]) -> None:
    """Raise an ArgumentError where two of the files hold the same bytes.

    Of files of a few rows, which may be the same by chance, there is a warning.
    """
    short = []
    for one, other in _find_same_bytes(files):
        n_rows = _count_rows(one)
        words = f"{one!r} and {other!r} hold the same {n_rows} rows"
        if n_rows >= N_WINDOW:
            raise ArgumentError(
                "path", f"must name each recording once; {words}{REMEDY}"
            )
        if n_rows >= N_TOLD:
            short.append(words)
    if short:
        more = _checks.in_all(len(short), "such files")
        _checks.warn(
            f"{short[0]}{more}: they are counted twice, as two recordings; if they are"
            " copies, leave one of them out",
            DataWarning,
        )


def _find_same_bytes(files: Sequence[LogFile]) -> list[tuple[str, str]]:
    """Return the pairs of files that hold the same bytes."""
    if len(files) < 2:
        return []
    by_size = defaultdict[int, list[str]](list)
    for file in files:
        path = _files.local(file.path)
        if os.path.isfile(path):  # anything else is an error where it is read
            by_size[os.path.getsize(path)].append(path)
    pairs = []
    for size, paths in by_size.items():
        # most files differ in their first block
        if size == 0 or len(paths) < 2:
            continue
        for alike in _group(paths, 1):
            for same in _group(alike, -1) if size > BLOCK_BYTES else [alike]:
                pairs += [(same[0], other) for other in same[1:]]
    return pairs


def _group(paths: Iterable[str], n_blocks: int) -> list[list[str]]:
    """Group files by their first blocks (-1: all of them); a group has two or more."""
    groups = defaultdict[bytes, list[str]](list)
    for path in paths:
        digest = hashlib.sha256()
        with _files.open_regular(path) as handle:
            n_read = 0
            while n_read != n_blocks and (block := handle.read(BLOCK_BYTES)):
                digest.update(block)
                n_read += 1
        groups[digest.digest()].append(path)
    return [group for group in groups.values() if len(group) > 1]


def _count_rows(path: str) -> int:
    """Return about how many rows a file has."""
    if path.lower().endswith(".parquet"):
        return read_parquet_header(path).n_rows
    if path.lower().endswith(".npz"):
        arrays = _files.read_npz(path)
        return max((len(array) for array in arrays.values() if array.ndim), default=0)
    with open_csv(path) as handle:
        blocks = iter(lambda: handle.read(BLOCK_BYTES), b"")
        n_lines: int = sum(block.count(b"\n") for block in blocks)
    return max(n_lines - 1, 0)


def find_namesakes(files: Sequence[LogFile]) -> dict[str, str]:
    """Return, by its path, the name that a file shares with one of another format."""
    names = defaultdict[str, list[str]](list)
    for file in files:
        ending = next((e for e in ENDINGS if file.path.lower().endswith(e)), "")
        if ending:
            names[file.path[: -len(ending)]].append(file.path)
    return {
        path: name for name, paths in names.items() if len(paths) > 1 for path in paths
    }


class Namesakes:
    """Refuse files of one name in several formats that hold the same transitions."""

    def __init__(self, files: Sequence[LogFile]) -> None:
        self.names = find_namesakes(files)
        self.found = defaultdict[str, list[tuple[str, Sequence[Column]]]](list)

    def add(self, path: str, columns: Mapping[str, Column]) -> None:
        """Raise an ArgumentError where a namesake has the same columns."""
        name = self.names.get(path)
        if name is None:
            return
        own = [columns[label] for label in (*MOVE, "count") if label in columns]
        for other, theirs in self.found[name]:
            is_same = len(own) == len(theirs) and all(
                np.array_equal(*pair) for pair in zip(own, theirs, strict=True)
            )
            if is_same:
                raise ArgumentError(
                    "path",
                    f"must name each recording once; {other!r} and {path!r} hold the"
                    f" same transitions{REMEDY}",
                )
        self.found[name].append((path, own))

    def add_sums(self, path: str, sums: Mapping[str, Column]) -> None:
        """Raise an ArgumentError where a namesake has the same sums, in any order."""
        if path in self.names:
            order = np.lexsort([sums[label] for label in reversed(KEY)])
            self.add(path, {label: sums[label][order] for label in (*KEY, "count")})


class Print(NamedTuple):
    """Hold hashes of rows at both ends of a file, and those of their states.

    The rows of each end stand together.
    """

    rows: tuple[Hashes, ...]
    states: tuple[Hashes, ...]

    @property
    def n_rows(self) -> int:
        """Return how many rows are held."""
        return sum(map(len, self.rows))


class EndRows:
    """Keep the first and the last ``N_ROWS`` rows of a file that is read in pieces."""

    LABELS = (*KEY, "reward")

    def __init__(self) -> None:
        self.head: list[dict[str, Column]] = []
        self.tail: list[dict[str, Column]] = []
        self.n_head = 0

    def add(self, columns: Mapping[str, Column]) -> None:
        """Add the next rows."""
        own = {label: columns[label] for label in self.LABELS if label in columns}
        n = len(own["state"])
        cut = min(N_ROWS - self.n_head, n)
        if cut:
            self.head.append({label: column[:cut] for label, column in own.items()})
            self.n_head += cut
        if cut == n:
            return
        start = max(cut, n - N_ROWS)
        last = {label: column[start:].copy() for label, column in own.items()}
        if n - start < N_ROWS:
            # as many of the rows before as are wanted
            wanted = N_ROWS - (n - start)
            last = {
                label: np.concatenate(
                    [*(part[label][-wanted:] for part in self.tail), column]
                )
                for label, column in last.items()
            }
        self.tail = [last]

    def print(self) -> Print | None:
        """Return the hashes; None without rows."""
        parts = []
        for end in (self.head, self.tail):
            if end:
                parts.append(
                    {
                        label: np.concatenate([part[label] for part in end])
                        for label in end[0]
                    }
                )
        if not parts:
            return None
        states = tuple(_hash(part["state"]) for part in parts)
        rows = tuple(
            _mix([_hash(column) for column in part.values()]) for part in parts
        )
        return Print(rows, states)


def print_of(columns: Mapping[str, Column]) -> Print | None:
    """Return the hashes of the rows at both ends of a table."""
    ends = EndRows()
    ends.add(columns)
    return ends.print()


_ODD = np.uint64(0x9E3779B97F4A7C15)


def _hash(column: Column) -> Hashes:
    """Return 64 bits for each value of a column, the same for the same values."""
    if column.ndim > 1:
        return _mix([_hash(part) for part in column.T])
    if column.dtype.kind == "f":
        bits: Hashes = (column.astype(np.float64) + 0.0).view(np.uint64)
        return _scramble(bits)
    if column.dtype.kind in "biu":
        return _scramble(column.astype(np.int64).view(np.uint64))
    import pandas as pd

    texts = np.array([str(item) for item in column.tolist()], dtype=object)
    return np.asarray(pd.util.hash_array(texts))


def _scramble(bits: Hashes) -> Hashes:
    """Mix the bits of integers as splitmix64 does."""
    with np.errstate(over="ignore"):
        x = bits + _ODD
        x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        return np.asarray(x ^ (x >> np.uint64(31)))


def _mix(parts: Sequence[Hashes]) -> Hashes:
    """Combine several hashes into one that depends on their order."""
    total = np.zeros(len(parts[0]), dtype=np.uint64)
    for part in parts:
        with np.errstate(over="ignore"):
            total = _scramble(total * _ODD + part)
    return total


def _hash_windows(rows: Hashes) -> Hashes:
    """Return a hash of each ``N_WINDOW`` rows that follow each other."""
    n = len(rows) - N_WINDOW + 1
    total = np.zeros(max(n, 0), dtype=np.uint64)
    with np.errstate(over="ignore"):
        for k in range(N_WINDOW if n > 0 else 0):
            total = total * _ODD + rows[k : k + n]
    return total


def _sample_windows(rows: Print) -> list[int]:
    """Return some of a file's windows, chosen by their hash, as in any other file."""
    windows = np.concatenate([_hash_windows(end) for end in rows.rows])
    if len(windows) > N_SAMPLED:
        windows = windows[windows % np.uint64(SAMPLED_ONE_OF) == 0]
    found: list[int] = windows.tolist()
    return found


def find_shared_rows(one: Print, other: Print) -> int:
    """Count the rows of both that are copies; 0 where they may agree by chance."""
    windows = [
        np.concatenate([_hash_windows(end) for end in each.rows])
        for each in (one, other)
    ]
    single = []
    for each in windows:
        values, number = np.unique(each, return_counts=True)
        single.append(values[number == 1])
    shared = np.intersect1d(single[0], single[1], assume_unique=True)
    if not shared.size:
        return 0
    is_shared = []
    for end in one.rows:
        starts = np.isin(_hash_windows(end), shared)
        covered = np.zeros(len(end) + 1, dtype=np.int64)
        np.add.at(covered, np.flatnonzero(starts), 1)
        np.add.at(covered, np.flatnonzero(starts) + N_WINDOW, -1)
        is_shared.append(np.cumsum(covered)[:-1] > 0)
    chosen = np.concatenate(is_shared)
    rows = np.concatenate([*one.rows, *other.rows])
    states = np.concatenate([*one.states, *other.states])
    numbers: list[Any] = []
    for each in (rows, states):
        _, code, number = np.unique(each, return_inverse=True, return_counts=True)
        numbers.append(number[code][: len(chosen)][chosen])
    bits = float(np.log2(numbers[1] / numbers[0]).sum())
    return int(chosen.sum()) if bits >= MIN_BITS else 0


class Overlaps:
    """Find files that repeat rows of files before them, and warn of them.

    A file is compared with the one before it, and with those of the files before that
    share some of its windows, of which each file has a sample. Of many large files only
    the last ones are kept.
    """

    def __init__(self) -> None:
        self.kept: dict[str, Print] = {}
        self.n_kept_rows = 0
        # the last file of each sampled window, which is the last to be forgotten
        self.owner: dict[int, str] = {}
        self.found: list[tuple[str, str, int]] = []

    def add(self, path: str, rows: Print | None) -> None:
        """Compare a file with those before it that may share rows with it."""
        if rows is None:
            return
        sample = _sample_windows(rows)
        owners = Counter(self.owner[w] for w in sample if w in self.owner)
        likely = [other for other, _ in owners.most_common(N_COMPARED)]
        before = next(reversed(self.kept), None)
        if before is not None and before not in likely:
            likely.append(before)
        for other in likely:
            n_shared = find_shared_rows(self.kept[other], rows)
            if n_shared:
                self.found.append((other, path, n_shared))
                break
        self._keep(path, rows, sample)

    def _keep(self, path: str, rows: Print, sample: list[int]) -> None:
        """Keep a file for those to come, and forget the first ones of too many."""
        self.kept[path] = rows
        self.n_kept_rows += rows.n_rows
        self.owner.update(dict.fromkeys(sample, path))
        is_full = False
        while self.n_kept_rows > N_KEPT_ROWS and len(self.kept) > 1:
            first = next(iter(self.kept))
            self.n_kept_rows -= self.kept.pop(first).n_rows
            is_full = True
        if is_full:
            self.owner = {w: one for w, one in self.owner.items() if one in self.kept}

    def warn(self) -> None:
        """Warn of the files that share rows, with the first of them."""
        if not self.found:
            return
        one, other, n_rows = self.found[0]
        more = _checks.in_all(len(self.found), "such pairs of files")
        _checks.warn(
            f"{n_rows} rows stand in {one!r} and in {other!r}, in the same order, and"
            f" count twice{more}: if the files overlap, leave these rows out of one of"
            " them",
            DataWarning,
        )


class Reordered:
    """Find files that hold the same rows in another order, and warn of them."""

    def __init__(self) -> None:
        self.first: dict[tuple[int, ...], str] = {}
        self.found: list[tuple[str, str, int]] = []

    def add_logs(self, paths: Sequence[str], logs: Sequence[Any]) -> None:
        """Compare logs, of which those of one number of rows are looked at closely.

        Sums of columns tell most of them apart in a hundredth of the time of hashes.
        """
        groups = defaultdict[tuple[int, ...], list[int]](list)
        for k, log in enumerate(logs):
            groups[(len(log),)].append(k)
        for of_size in [group for group in groups.values() if len(group) > 1]:
            alike = defaultdict[tuple[int, ...], list[int]](list)
            for k in of_size:
                alike[_sum_columns(logs[k])].append(k)
            for k in (k for group in alike.values() if len(group) > 1 for k in group):
                columns = {
                    label: _values_of(logs[k], label)
                    for label in EndRows.LABELS
                    if getattr(logs[k], label) is not None
                }
                rows = _mix([_hash(column) for column in columns.values()])
                states = _hash(columns["state"])
                _, first, number = np.unique(
                    rows, return_index=True, return_counts=True
                )
                self._add(paths[k], rows, states[first], number)

    def add_sums(self, path: str, sums: Mapping[str, Column]) -> None:
        """Compare the sums of a file with those of the files before it.

        Sums of rewards depend on the order of rows, by their last digits.
        """
        labels = (*KEY, "count", "reward_count", "reward_min", "reward_max")
        # a nan, which is the least of no reward, has many bits
        rows = _mix([_hash(np.nan_to_num(sums[label])) for label in labels])
        self._add(path, rows, _hash(sums["state"]), sums["count"])

    def _add(
        self, path: str, rows: Hashes, states: Hashes, number: NDArray[Any]
    ) -> None:
        """Compare a file: its rows, and the number of each kind with its state."""
        n = int(number.sum())
        digest = (n, len(rows), int(rows.sum()))
        other = self.first.setdefault(digest, path)
        if other != path and _bits_of_numbers(states, number) >= MIN_BITS:
            self.found.append((other, path, n))

    def warn(self, known: Iterable[tuple[str, str, int]]) -> None:
        """Warn of the files that are not ``known`` to share rows in the same order."""
        told = {pair[:2] for pair in known}
        found = [pair for pair in self.found if pair[:2] not in told]
        if not found:
            return
        one, other, n_rows = found[0]
        more = _checks.in_all(len(found), "such pairs of files")
        _checks.warn(
            f"{one!r} and {other!r} hold the same {n_rows} rows, in another order, and"
            f" count twice{more}: if one is a copy, leave it out",
            DataWarning,
        )


def _values_of(log: Any, label: str) -> Column:
    """Return a column of a log, names as the hashes of their texts."""
    column: Column = getattr(log, label)
    names = getattr(log, f"{label.removeprefix('next_')}_names", None)
    if names is None:
        return column
    texts = np.empty(len(names), dtype=object)
    texts[:] = names
    return _hash(texts)[column].view(np.int64)


def _sum_columns(log: Any) -> tuple[int, ...]:
    """Return the sums of a log's columns, of rewards the sum of their bits."""
    sums = []
    for label in EndRows.LABELS:
        if getattr(log, label) is not None:
            values = _values_of(log, label)
            if values.dtype.kind == "f":
                values = (values.astype(np.float64) + 0.0).view(np.int64)
            sums.append(int(values.sum(dtype=np.int64)))
    return tuple(sums)


def _bits_of_numbers(states: Hashes, number: NDArray[Any]) -> float:
    """Return the bits of the numbers of rows of each kind, in each state."""
    from scipy.special import gammaln  # only of files that look the same

    n_k = number.astype(np.float64)
    _, code = np.unique(states, return_inverse=True)
    n_s = np.bincount(code, weights=n_k)
    logs = gammaln(n_s + 1.0).sum() - gammaln(n_k + 1.0).sum()
    logs += (n_k * np.log(n_k / n_s[code])).sum()
    return float(-logs / np.log(2.0))

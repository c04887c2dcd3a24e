"""One file of a log as counts, in the memory of the counts: n(s, a, s', ended) and sums of the rewards, by DuckDB.

Of whole episodes a sample is kept, for importance sampling: those first in the order of a hash of the file's name and the
episode's number.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oee_tabular import _checks
from oee_tabular._checks import Array, BoolArray, Column, IntArray
from oee_tabular.data.counts import Recording
from oee_tabular.data.labels import COLUMNS, MOVE, require_columns
from oee_tabular.data.reader import LogFile, Table, use_table
from oee_tabular.data.transitions import Transitions
from oee_tabular.data.values import NAMES_HINT, show_value
from oee_tabular.mdp.naming import Name, numbers_of, suggest_name

LARGEST = 2**53  # from which on a float does not tell n from n + 1
N_REASONS = 5  # kinds of bad rows that are told with an example
SAMPLED = tuple(label for label in COLUMNS if label != "episode")
WAY = " (bad_rows='drop', --bad-rows drop, leaves such rows out and counts them)"
ORDER_RULES = {
    "timestep": "must be the number of the step in its episode, in order from 0",
    "state": "must be the next_state of the row before, in the same episode",
    "episode": "must be another than that of the row before, which ended it",
}


class Limits(NamedTuple):
    """What rows must keep to: numbers below ``sizes`` (states, actions), or names; ``drop``: others are left out."""

    sizes: tuple[int, int] = (LARGEST, LARGEST)
    names: tuple[tuple[Name, ...] | None, tuple[Name, ...] | None] = (None, None)
    drop: bool = False
    kept: int = 200_000

    def of(self, label: str) -> tuple[int, tuple[Name, ...] | None]:
        """The size and the names for a column of a move."""
        k = int(label == "action")
        return self.sizes[k], self.names[k]


class Sample(NamedTuple):
    """Whole episodes: their place in the draw and length, (n,) each, and their rows; all places below ``limit`` are here."""

    place: NDArray[np.uint64]
    length: IntArray
    rows: dict[str, Column]
    limit: int = 2**64 - 1


class FileCounts(NamedTuple):
    """What a file came to: ``key`` (K, 4) s, a, s', ended; ``sums`` (K, 5) count, rewards, their sum, least and largest."""

    key: IntArray
    sums: Array
    recording: Recording
    sample: Sample | None
    known: frozenset[str]
    unknown: tuple[str, ...]


def count_file(file: LogFile, name: str, limits: Limits, limit: int = 2**64 - 1) -> FileCounts:
    """Count one file. ``name`` is hashed for the sample, of which places from ``limit`` on are no longer asked for.

    n(s, a, s', e) is one GROUP BY; what is wrong with a move is looked for in the groups, not in the rows.
    """
    columns = _log_in_memory(file) if file.suffix == ".npz" else None
    named = [label for label in MOVE if limits.of(label)[1] is not None]

    def count(table: Table) -> FileCounts:
        require_columns(repr(file.path), MOVE, [*table.labels, *(label for label, _ in file.fixed)])
        steps = _FileCount(table, limits)
        steps.group()
        sample = None
        if "episode" in table.columns and steps.n_rows:
            sample = steps.follow_episodes(name, limit)
        return steps.result(sample)

    return use_table(count, file, COLUMNS.__contains__, named=named, drop=limits.drop, columns=columns)


def _log_in_memory(file: LogFile) -> dict[str, Column]:
    columns = Transitions.load(file.path).columns()
    return {
        label: np.array([str(item) for item in column], dtype=object) if column.dtype.hasobject else column
        for label, column in columns.items()
    }


@dataclass
class _FileCount:
    """The steps in which a file is counted."""

    table: Table
    limits: Limits

    def __post_init__(self) -> None:
        self.groups: dict[str, Any] = {}
        self.key = np.zeros((0, 4), dtype=np.int64)
        self.reasons: dict[str, str] = {}
        self.dropped = len(self.table.lost)
        self.bad_values: dict[str, Any] = {}
        self.broken: set[int] = set()
        self.facts = {"episodes": 0, "shortest": 0, "longest": 0}
        for row, words in self.table.lost[:1]:
            self.note("fields", f"row {row} {words}")

    def has(self, label: str) -> bool:
        """Whether the file has a column."""
        return label in self.table.columns

    def note(self, kind: str, words: str, others: int = 0) -> None:
        """Refuse, or note, what is wrong with a row."""
        more = f"; {others} other rows break the same rule" * (others > 0)
        text = f"{self.table.file.path!r}: {words}"
        if not self.limits.drop:
            raise ValueError(f"{text}{more}{WAY}")
        if len(self.reasons) < N_REASONS:
            self.reasons.setdefault(kind, text + more)

    def group(self) -> None:
        """The sums of each different (s, a, s', ended); a group with a bad value is left out.

        Most files have none. A quick query says so, in two thirds of the time of the one that says which row is bad.
        """
        faults = self._sum(is_quick=True)
        if faults:
            faults = self._sum(is_quick=False)
        groups, bad = self.groups, np.zeros(len(self.groups["number"]), dtype=np.bool_)
        for _, wrong in faults:
            bad |= wrong
        first = [(int(groups["row"][wrong].min()), label, wrong) for label, wrong in faults]
        for row, label, wrong in sorted(first, key=lambda fault: fault[0]):
            self.note(label, self._describe(label, row), int(groups["number"][wrong].sum()) - 1)
        self.n_rows = int(groups["number"].sum())
        self.dropped += int(groups["number"][bad].sum())
        self.truncated = int(groups["truncated"][~bad].sum())
        self.key = self.key[~bad]
        names = ("number", "n_rewards", "total", "least", "most")
        sums = [np.ma.filled(groups[name].astype(np.float64), np.nan) for name in names]
        self.sums = np.column_stack(sums)[~bad]

    def _sum(self, *, is_quick: bool) -> list[tuple[str, BoolArray]]:
        """The groups, and which of them have a bad value, by column; without the first row of each where ``is_quick``."""
        ended = "terminated" if self.has("terminated") else "false"
        reward = "reward" if self.has("reward") else "NULL::DOUBLE"
        if not is_quick:
            reward = f"nullif({reward}, 'nan'::DOUBLE)"
        fault = self._fault(is_quick=is_quick)
        first = "" if is_quick else ", min(row) AS row"
        cut = "count_if(truncated)" if self.has("truncated") else "0"
        groups = self.table.fetch(
            f"SELECT state, action, next_state, {ended} AS terminated, {fault} AS fault, count(*) AS number, "
            f"count({reward}) AS n_rewards, coalesce(sum({reward}), 0.0) AS total, min({reward}) AS least, "
            f"max({reward}) AS most, {cut} AS truncated{first} FROM {self.table.rows} GROUP BY ALL"
        )
        self.groups, self.key = groups, np.zeros((len(groups["number"]), 4), dtype=np.int64)
        faults = []
        for k, label in enumerate((*MOVE, "terminated")):
            self.key[:, k], wrong = self._numbers(label, groups[label])
            faults.append((label, wrong))
            if wrong.any():
                self.bad_values[label] = np.unique(np.ma.getdata(groups[label])[wrong & ~_absent(groups[label])])
        other = np.ma.filled(groups["fault"], "")
        faults += [(label, np.asarray(other == label)) for label in COLUMNS if not (is_quick and label == "reward")]
        if is_quick and self.has("reward"):
            extremes = [np.ma.filled(groups[name].astype(np.float64), 0.0) for name in ("least", "most")]
            faults.append(("reward", np.asarray(~np.isfinite(extremes).all(axis=0))))
        return [(label, wrong) for label, wrong in faults if wrong.any()]

    def _fault(self, *, is_quick: bool = False) -> str:
        """The SQL of the first column, of those that no group has as its key, whose value is none of a log."""
        rules = {
            "reward": "isinf(reward)",
            "behavior_probability": "behavior_probability IS NULL OR behavior_probability < 0 OR behavior_probability > 1",
            "timestep": "timestep IS NULL OR timestep < 0",
            "truncated": "truncated IS NULL",
            "episode": "episode IS NULL",
        }
        if is_quick:
            del rules["reward"]  # a group's extremes tell
        cases = "".join(f" WHEN {rule} THEN '{label}'" for label, rule in rules.items() if self.has(label))
        return f"CASE{cases} END" if cases else "NULL::VARCHAR"

    def _numbers(self, label: str, values: Any) -> tuple[IntArray, BoolArray]:
        """Values of a key as numbers, and which are none."""
        absent, held = _absent(values), np.ma.getdata(values)
        if label == "terminated":
            return np.where(absent, 0, held).astype(np.int64), absent
        size, names = self.limits.of(label)
        if held.dtype.hasobject:
            assert names is not None
            lookup = numbers_of(names)
            held = np.array([-1 if none else lookup.get(text, -1) for text, none in zip(held, absent, strict=True)])
        wrong = absent | (held < 0) | (held >= size)
        return np.where(wrong, 0, held).astype(np.int64), wrong

    def _describe(self, label: str, row: int) -> str:
        rule, hint = {"behavior_probability": "must be in [0, 1]", "timestep": "must be at least 0"}.get(label, ""), ""
        if label in MOVE:
            size, names = self.limits.of(label)
            raw = self.table.value(label, row)
            rule = f"must be in 0..{size - 1}" if size < LARGEST else "must be below 2**53"
            if str(raw).strip().startswith("-"):
                rule = "must be at least 0"
            if self.table.columns[label][2] == "text" and names is not None:
                rule, hint = "must be one of the simulator's names", "" if raw is None else suggest_name(raw, names)
            elif isinstance(raw, str) and raw.strip()[:1].isalpha():
                hint = NAMES_HINT
        return self.table.describe(label, row, rule, hint)

    def follow_episodes(self, name: str, limit: int) -> Sample | None:
        """Where episodes begin and which are broken; the sample of the others."""
        found = self.table.fetch(
            f"SELECT row, episode, is_first, fault FROM ({self._episode_rows()}) WHERE is_first OR fault IS NOT NULL"
        , **self._episode_parameters())  # fmt: skip
        first = found["is_first"]
        ordinal = np.cumsum(first) - 1
        starts, lengths = found["row"][first], np.diff(found["row"][first], append=self.n_rows)
        nameless = np.flatnonzero(_absent(found["episode"])[first])  # may be the episode's before or after
        own = np.setdiff1d(np.arange(len(starts)), nameless)
        lengths_own = lengths[own] if len(own) else np.zeros(1, dtype=np.int64)
        self.facts = {"episodes": len(own), "shortest": int(lengths_own.min()), "longest": int(lengths_own.max())}
        fault = np.ma.filled(found["fault"], "")
        for kind, rule in ORDER_RULES.items():
            rows = found["row"][fault == kind]
            if len(rows):
                row = int(rows[0])
                words = f"{kind}[{self.table.file_row(row)}] {rule}; it is {show_value(self.table.value(kind, row))}"
                self.note(f"order of {kind}", words, len(rows) - 1)
        before = ordinal[first & (fault == "lost")] - 1
        broken = np.concatenate([ordinal[fault != ""], before, nameless - 1, nameless, nameless + 1])
        if any(gap >= self.n_rows for gap in self._episode_parameters()["gaps"]):
            broken = np.append(broken, len(starts) - 1)
        names = np.ma.getdata(found["episode"])[first]
        broken = np.concatenate([broken, own[self._begin_again(names[own], starts[own])]])
        self.broken = set(broken.tolist()) & set(own.tolist())
        if not self.has("truncated"):
            self.truncated = max(len(own) - int(self.sums[self.key[:, 3] == 1, 0].sum()), 0)
        place = hash_places(np.arange(len(starts)), name)
        whole = np.isin(np.arange(len(starts)), own)
        whole[list(self.broken)] = False
        return self._sample(place, starts, lengths, whole, limit)

    def _episode_rows(self) -> str:
        """The SQL of each row beside the one before it, with what is wrong with it as one of its episode."""
        bad = " OR ".join([f"({self._fault()}) IS NOT NULL", *self._bad_keys()])
        ends = " OR ".join([label for label in ("terminated", "truncated") if self.has(label)] or ["false"])
        step = ", timestep, lag(timestep) OVER () AS step_before" if self.has("timestep") else ""
        timestep = (
            "WHEN timestep <> CASE WHEN is_first THEN 0 ELSE step_before + 1 END THEN 'timestep' " if step else ""
        )
        gap = "OR list_contains($gaps, row) " if self.table.lost else ""
        rows = f"(SELECT *, ({bad}) AS is_bad, coalesce({ends}, false) AND NOT ({bad}) AS ends FROM {self.table.rows})"
        return (
            f"SELECT row, episode, is_first, CASE WHEN is_bad {gap}THEN 'lost' "
            "WHEN NOT is_first AND ended_before THEN 'episode' "
            "WHEN NOT is_first AND NOT bad_before AND state IS DISTINCT FROM led_before THEN 'state' "
            f"{timestep}END AS fault FROM (SELECT row, episode, state, is_bad{step}, "
            "lag(episode) OVER () IS DISTINCT FROM episode OR row = 0 AS is_first, lag(next_state) OVER () AS led_before, "
            f"lag(ends) OVER () AS ended_before, lag(is_bad) OVER () AS bad_before FROM {rows})"
        )

    def _bad_keys(self) -> list[str]:
        """The SQL of a row whose move has a bad value, where some have."""
        rules = [f"{label} IS NULL" for label in self.bad_values]
        return rules + [f"list_contains($bad_{label}, {label})" for label in self.bad_values if label != "terminated"]

    def _episode_parameters(self) -> dict[str, Any]:
        lost = np.array([row for row, _ in self.table.lost], dtype=np.int64)
        bad = {f"bad_{label}": values.tolist() for label, values in self.bad_values.items()}
        return bad | {"gaps": (lost - np.arange(len(lost))).tolist()}

    def _begin_again(self, names: Column, starts: IntArray) -> IntArray:
        """The runs of rows whose episode has another run: an episode's rows stand together."""
        _, code, number = np.unique(names, return_inverse=True, return_counts=True)
        again = np.flatnonzero(number[code] > 1)
        if again.size:
            _, firsts = np.unique(code, return_index=True)
            k = int(np.setdiff1d(again, firsts)[0])
            shown = _checks.show(names[k].item() if hasattr(names[k], "item") else names[k])
            words = f"episode must keep the rows of an episode together; {shown} begins again in row"
            self.note("together", f"{words} {self.table.file_row(int(starts[k]))}")
        return again

    def _sample(
        self, place: NDArray[np.uint64], starts: IntArray, lengths: IntArray, whole: BoolArray, limit: int
    ) -> Sample | None:
        """The rows of the whole episodes first in the draw, at most ``kept`` together."""
        chosen, limit = choose(place, lengths, whole, limit, self.limits.kept)
        if not len(chosen):
            return Sample(place[:0], lengths[:0], {}, limit)
        labels = [label for label in SAMPLED if self.has(label)]
        query = f"SELECT row, {', '.join(labels)} FROM {self.table.rows}"
        if len(chosen) == len(starts):
            rows = self.table.fetch(query)
        else:
            asked = np.concatenate([np.arange(starts[k], starts[k] + lengths[k]) for k in chosen])
            wanted = "row IN (SELECT unnest($asked::BIGINT[]))"
            rows = self.table.fetch(f"{query} WHERE {wanted} ORDER BY row", asked=asked.tolist())
        del rows["row"]
        for label in MOVE:
            rows[label] = self._numbers(label, rows[label])[0]
        rows = {label: np.ma.filled(column, np.nan) if label == "reward" else np.ma.getdata(column)
                for label, column in rows.items()}  # fmt: skip
        return Sample(place[chosen], lengths[chosen], rows, limit)

    def result(self, sample: Sample | None) -> FileCounts:
        """What was counted."""
        recording = Recording(
            by_episodes=self.has("episode"), truncated=self.truncated, broken=len(self.broken), files=1,
            dropped=self.dropped, reasons=tuple(self.reasons.values()), **self.facts,
        )  # fmt: skip
        key, sums = add(self.key, self.sums)  # a name may be written in two ways
        known = frozenset(self.table.columns)
        unknown = tuple(label for label in self.table.labels if label not in COLUMNS)
        return FileCounts(key, sums, recording, sample, known, unknown)


def _absent(values: Any) -> BoolArray:
    return np.asarray(np.ma.getmaskarray(values), dtype=np.bool_)


def choose(
    place: NDArray[np.uint64], lengths: IntArray, whole: BoolArray, limit: int, kept: int
) -> tuple[IntArray, int]:
    """The episodes first in the draw that fit, in their order, and the place of the first that does not."""
    order = np.flatnonzero(whole & (place < np.uint64(limit)))
    order = order[np.argsort(place[order])]
    fits = np.cumsum(lengths[order]) <= kept
    if not fits.all():
        limit = int(place[order[np.argmin(fits)]])
    return np.sort(order[place[order] < np.uint64(limit)]), limit


def hash_places(number: IntArray, name: str) -> NDArray[np.uint64]:
    """splitmix64 of number + a hash of the name: a place in the draw for each."""
    salt = np.uint64(int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "little"))
    with np.errstate(over="ignore"):
        x = (number.astype(np.uint64) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15) + salt
        x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        return np.asarray(x ^ (x >> np.uint64(31)))


def add(key: IntArray, sums: Array) -> tuple[IntArray, Array]:
    """Rows of one key added in their order, sorted by s, a, s', ended."""
    order = np.lexsort(key.T[::-1])
    key, sums = key[order], sums[order]
    starts = np.flatnonzero(np.append(True, (key[1:] != key[:-1]).any(axis=1))[: len(key)])
    if len(starts) < len(key):
        added = [np.add.reduceat(sums[:, k], starts) for k in range(3)]
        sums = np.column_stack([*added, np.fmin.reduceat(sums[:, 3], starts), np.fmax.reduceat(sums[:, 4], starts)])
        key = key[starts]
    return key, sums

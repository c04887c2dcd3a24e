"""Files of any size as counts: each is summed alone, and the sums are added in the order of the files' names.

So one process, several, and a cluster give the same bits.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any

import numpy as np

from oee_tabular import _checks, _workers
from oee_tabular._checks import Column
from oee_tabular.data.counting import LARGEST, N_REASONS, FileCounts, Limits, Sample, add, choose, count_file
from oee_tabular.data.counts import Recording, TransitionCounts, holds_counts
from oee_tabular.data.files import Paths, find_log_files, plain_name
from oee_tabular.data.labels import COLUMNS, warn_left_out
from oee_tabular.data.reader import LogFile
from oee_tabular.data.transitions import Transitions
from oee_tabular.mdp import FiniteMDP


def open_log(
    path: Paths,
    *,
    simulator: FiniteMDP | None = None,
    n_states: int | None = None,
    n_actions: int | None = None,
    bad_rows: str = "refuse",
    kept_moves: int = 200_000,
    output: str | os.PathLike[str] | None = None,
    jobs: int = 1,
    dask: str | None = None,
    progress: bool = False,
) -> TransitionCounts:
    """Count a log of any size, in memory of the size of its counts: what ``Problem`` takes where no log fits.

    Parameters
    ----------
    path : file (.parquet, .csv, .csv.gz, .npz), folder (with all inside, ``column=value`` folders as columns), pattern, or a
        list of these
    simulator : FiniteMDP, optional: whose states and actions there are, others are bad; where it has names, so may the log
    n_states, n_actions : int, optional, in its place: states and actions from there on are bad
    bad_rows : "refuse" | "drop": raise for the first row that is none of a log, or leave such rows out and count them;
        a row that is left out breaks its episode, whose other transitions are still counted
    kept_moves : int, 200 000: whole episodes of so many transitions are kept for importance sampling, drawn by a hash
    output : .npz to write the counts to, whole or not at all
    jobs : processes on this machine, -1: one a core; dask : address of a scheduler whose workers see the files
    progress : whether to show a bar

    Raises
    ------
    ValueError
        Names the file, the row or the column, the rule and the value: files that are no tables, have other columns than the
        first, or rows that are none of a log, where they are refused. Rewards alone may be missing.
    OSError
        A file that is not there; no scheduler at the address.

    Notes
    -----
    Cost: O(rows) time, memory of the different transitions of a file and of the episodes' names. Serial, processes and
    cluster give the same bits.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> folder = pathlib.Path(tempfile.mkdtemp())
    >>> for k in range(2):
    ...     Transitions([0, 1], [0, 0], [1, 2], episode=[0, 0]).save(folder / f"part-{k}.csv")
    >>> Transitions.open(folder)
    TransitionCounts(4 transitions, 2 different, of 2 files in 2 episodes of 2 steps: 0 terminated, 2 truncated;
                     states 0..2, actions 0..0; 2 whole episodes kept)
    """
    _checks.boolean(progress, "progress")
    if _checks.is_sparse(path):
        raise ValueError(f"path must be a path, or several; got {_checks.show(path)}")
    if isinstance(path, str | os.PathLike) and holds_counts(path):
        return TransitionCounts.load(path)
    _checks.one_of(bad_rows, "bad_rows", ("refuse", "drop"))
    limits = _limits(simulator, n_states, n_actions)
    limits = limits._replace(drop=bad_rows == "drop", kept=_checks.positive_integer(kept_moves, "kept_moves"))
    if jobs != -1:
        _checks.positive_integer(jobs, "jobs")
    files = find_log_files(path, tables_only=True)
    total = _Total(limits.kept)
    calls = ((file, plain_name(file, files), limits, total.limit) for file in files)
    results = _workers.each(count_file, calls, len(files), jobs=jobs, dask=dask)
    for file, counts in zip(files, _with_bar(results, len(files), progress), strict=True):
        total.add(file, counts)
    result = total.result()
    if output is not None:
        result.save(output)
    return result


def _limits(simulator: FiniteMDP | None, n_states: int | None, n_actions: int | None) -> Limits:
    if simulator is not None:
        _checks.instance(simulator, FiniteMDP, "simulator")
        if n_states is not None or n_actions is not None:
            raise ValueError("n_states and n_actions must be left out where simulator is given, which has its own")
        names = (simulator.state_names, simulator.action_names)
        return Limits((simulator.n_states, simulator.n_actions), names)
    given = ((n_states, "n_states"), (n_actions, "n_actions"))
    states, actions = (LARGEST if size is None else _checks.positive_integer(size, name) for size, name in given)
    return Limits((states, actions))


def _with_bar(results: Iterator[Any], total: int, progress: bool) -> Iterator[Any]:
    from tqdm import tqdm

    return iter(tqdm(results, total=total, desc="counting", unit="file", disable=not progress))


class _Total:
    """The sums of the files so far."""

    def __init__(self, kept: int) -> None:
        self.kept, self.limit = kept, 2**64 - 1
        self.key, self.sums = np.zeros((0, 4), dtype=np.int64), np.zeros((0, 5))
        self.recording = Recording(by_episodes=False)
        self.samples: Sample | None = None
        self.first: tuple[LogFile, FileCounts] | None = None
        self.rewarded = False

    def add(self, file: LogFile, counts: FileCounts) -> None:
        """One more file."""
        self._check_columns(file, counts)
        self.key, self.sums = add(np.concatenate([self.key, counts.key]), np.concatenate([self.sums, counts.sums]))
        self.rewarded |= "reward" in counts.known
        one, two = self.recording, counts.recording
        shortest = [length for length in (one.shortest, two.shortest) if length]
        self.recording = Recording(
            two.by_episodes, one.episodes + two.episodes, min(shortest, default=0), max(one.longest, two.longest),
            one.truncated + two.truncated, one.broken + two.broken, one.files + 1, one.dropped + two.dropped,
            (*one.reasons, *two.reasons)[:N_REASONS],
        )  # fmt: skip
        if counts.sample is not None:
            self._add_sample(counts.sample)

    def _check_columns(self, file: LogFile, counts: FileCounts) -> None:
        """All files have the same of a log's columns; rewards alone may be missing in some."""
        if self.first is None:
            self.first = file, counts
            warn_left_out(file.path, counts.unknown, COLUMNS, level=5)
            return
        other, before = self.first
        differ = sorted((before.known ^ counts.known) - {"reward"})
        if differ:
            has, lacks = (other, file) if differ[0] in before.known else (file, other)
            raise ValueError(
                f"all files must have the same columns; {has.path!r} has {differ[0]!r}, and {lacks.path!r} does not"
            )

    def _add_sample(self, more: Sample) -> None:
        """Those first in the draw of all."""
        if self.samples is None:
            rows, place, length = more.rows, more.place, more.length
        else:
            place = np.concatenate([self.samples.place, more.place])
            length = np.concatenate([self.samples.length, more.length])
            rows = _join_rows(self.samples, more)
        limit = min(self.limit, more.limit)
        chosen, self.limit = choose(place, length, np.ones(len(place), dtype=np.bool_), limit, self.kept)
        if len(chosen) < len(place):
            is_chosen = np.zeros(len(place), dtype=np.bool_)
            is_chosen[chosen] = True
            rows = {label: column[np.repeat(is_chosen, length)] for label, column in rows.items()}
        self.samples = Sample(place[chosen], length[chosen], rows)

    def result(self) -> TransitionCounts:
        """The counts of all files."""
        if not len(self.key):
            raise ValueError(f"path must have at least one good row; of {self.recording.files} files none has")
        rewards: dict[str, Any] = {}
        if self.rewarded and self.sums[:, 1].any():
            rewards = {"reward_sum": self.sums[:, 2], "reward_min": self.sums[:, 3], "reward_max": self.sums[:, 4],
                       "reward_count": self.sums[:, 1]}  # fmt: skip
        sample = None
        if self.samples is not None and len(self.samples.place):
            episode = np.repeat(np.arange(len(self.samples.place)), self.samples.length)
            sample = Transitions(**self.samples.rows, episode=episode)
        state, action, next_state, ended = (column.copy() for column in self.key.T)
        columns: dict[str, Any] = {"state": state, "action": action, "next_state": next_state, "terminated": ended == 1}
        columns |= {"count": self.sums[:, 0].copy(), "recording": self.recording, "sample": sample}
        return TransitionCounts(**columns, **rewards)


def _join_rows(one: Sample, two: Sample) -> dict[str, Column]:
    """The rows of two samples; a reward that only one has is nan in the other."""
    if not one.rows or not two.rows:
        return one.rows or two.rows
    n_one, n_two = (int(sample.length.sum()) for sample in (one, two))
    labels = dict.fromkeys([*one.rows, *two.rows])
    return {
        label: np.concatenate(
            [one.rows.get(label, np.full(n_one, np.nan)), two.rows.get(label, np.full(n_two, np.nan))]
        )
        for label in labels
    }

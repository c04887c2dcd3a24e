"""Files of any size as counts: each is summed alone, and the sums are added in the order of the files' names.

So one process, several, and a cluster give the same bits.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from oee_tabular import _checks, _workers
from oee_tabular.data.counting import LARGEST, N_REASONS, FileCounts, Limits, Sample, count_file
from oee_tabular.data.counts import Recording, TransitionCounts, holds_counts
from oee_tabular.data.files import Paths, find_log_files, plain_name
from oee_tabular.data.labels import COLUMNS, warn_left_out
from oee_tabular.data.reader import LogFile
from oee_tabular.data.sums import Sums
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
    if not (_checks.is_integer(jobs) and jobs == -1):
        _checks.positive_integer(jobs, "jobs")
    from tqdm import tqdm

    files = find_log_files(path, tables_only=True)
    calls = ((file, plain_name(file, files), limits) for file in files)
    results = _workers.each(count_file, calls, len(files), jobs=jobs, dask=dask)
    total = _Total(limits.kept)
    for file, counts in zip(
        files, tqdm(results, "counting", len(files), unit="file", disable=not progress), strict=True
    ):
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


class _Total:
    """The sums of the files so far."""

    def __init__(self, kept: int) -> None:
        self.kept, self.sums = kept, Sums()
        self.recording = Recording(by_episodes=False)
        self.sample = Sample(np.zeros(0, dtype=np.uint64), np.zeros(0, dtype=np.int64), {})
        self.first: tuple[LogFile, FileCounts] | None = None

    def add(self, file: LogFile, counts: FileCounts) -> None:
        """One more file."""
        self._check_columns(file, counts)
        self.sums.add(counts.key, counts.sums)
        one, two = self.recording, counts.recording
        shortest = [length for length in (one.shortest, two.shortest) if length]
        self.recording = Recording(
            two.by_episodes, one.episodes + two.episodes, min(shortest, default=0), max(one.longest, two.longest),
            one.truncated + two.truncated, one.broken + two.broken, one.files + 1, one.dropped + two.dropped,
            (*one.reasons, *two.reasons)[:N_REASONS],
        )  # fmt: skip
        if counts.sample is not None:
            self.sample = join_samples(self.sample, counts.sample, self.kept)

    def _check_columns(self, file: LogFile, counts: FileCounts) -> None:
        """All files have the same of a log's columns; rewards alone may be missing in some."""
        if self.first is None:
            self.first = file, counts
            warn_left_out(file.path, counts.unknown, COLUMNS, level=4)
            return
        other, before = self.first
        differ = sorted((before.known ^ counts.known) - {"reward"})
        if differ:
            has, lacks = (other, file) if differ[0] in before.known else (file, other)
            raise ValueError(
                f"all files must have the same columns; {has.path!r} has {differ[0]!r}, and {lacks.path!r} does not"
            )

    def result(self) -> TransitionCounts:
        """The counts of all files."""
        key, sums = self.sums.entries()
        order = np.lexsort(key.T[::-1])  # by s, a, s', ended
        key, sums = key[order], sums[order]
        if not len(key):
            first = "" if self.first is None else f", the first of which is {self.first[0].path!r}"
            raise ValueError(f"path must have at least one good row; of {self.recording.files} files none has{first}")
        columns: dict[str, Any] = dict(zip(("state", "action", "next_state"), key.T.copy(), strict=False))
        if sums[:, 1].any():
            names = ("reward_count", "reward_sum", "reward_min", "reward_max")
            columns |= dict(zip(names, sums.T[1:].copy(), strict=True))
        if len(self.sample.place):
            episode = np.repeat(np.arange(len(self.sample.place)), self.sample.length)
            columns["sample"] = Transitions(**self.sample.rows, episode=episode)
        return TransitionCounts(**columns, count=sums[:, 0].copy(), terminated=key[:, 3] == 1, recording=self.recording)


def join_samples(one: Sample, two: Sample, kept: int) -> Sample:
    """The episodes first in the draw of both; a reward that only one has is nan in the other."""
    parts = [sample for sample in (one, two) if len(sample.place)]
    rows = {}
    for label in dict.fromkeys(label for part in parts for label in part.rows):
        rows[label] = np.concatenate([part.rows.get(label, np.full(part.length.sum(), np.nan)) for part in parts])
    place, length = np.concatenate([one.place, two.place]), np.concatenate([one.length, two.length])
    return Sample(place, length, rows, min(one.limit, two.limit)).cut(kept)

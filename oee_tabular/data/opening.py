"""Files of any size as counts: each is summed alone, and the sums are added in order.

The order is that of the files' names, so that one process, several, and a cluster give
the same bits.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import Any, Literal

import numpy as np

from oee_tabular import _checks, _parallel
from oee_tabular._progress import progress_bar
from oee_tabular.data.copies import Namesakes, Overlaps, Reordered, refuse_same_bytes
from oee_tabular.data.counting import (
    COUNTED,
    LARGEST,
    NUMBERS_PER_ENTRY,
    WAY,
    FileCounts,
    Limits,
    Run,
    Sample,
    count_file,
    name_missing_memory,
)
from oee_tabular.data.counts import (
    N_REASONS,
    Recording,
    TransitionCounts,
    holds_counts,
)
from oee_tabular.data.files import (
    Paths,
    find_log_files,
    plain_name,
    warn_of_empty_files,
)
from oee_tabular.data.frames import is_frame
from oee_tabular.data.joining import (
    TIMESTEP,
    Folders,
    Row,
    SameColumns,
    judge,
    warn_of,
)
from oee_tabular.data.labels import (
    ColumnsLike,
    check_columns,
    warn_left_out,
    warn_read_as,
)
from oee_tabular.data.rules import KEY
from oee_tabular.data.sums import add_sums, join_sums
from oee_tabular.data.tables import LogFile
from oee_tabular.data.transitions import Transitions, names_by_label
from oee_tabular.exceptions import ArgumentError, DataWarning
from oee_tabular.mdp import FiniteMDP, name_text
from oee_tabular.typing import Column


def open_log(
    path: Paths,
    *,
    simulator: FiniteMDP | None = None,
    n_states: int | None = None,
    n_actions: int | None = None,
    bad_rows: Literal["refuse", "drop"] = "refuse",
    kept_moves: int = 200_000,
    output: str | os.PathLike[str] | None = None,
    jobs: int = 1,
    dask: str | None = None,
    progress: bool = False,
    columns: ColumnsLike | None = None,
) -> TransitionCounts:
    """Count a log of any size, in memory of the size of its counts.

    ``Problem`` takes the result.

    Parameters
    ----------
    path : path_like, or iterable of path_like
        A file (.parquet, .csv, .csv.gz, .npz), a folder (with all inside,
        ``column=value`` folders as columns), a pattern, a Minari data set, or several
        of these.
    simulator : FiniteMDP, optional
        The model. States and actions outside it are bad; the log may use its names.
    n_states : int, optional
        The number of states in place of a simulator; larger states are bad.
    n_actions : int, optional
        The number of actions in place of a simulator; larger actions are bad.
    bad_rows : {'refuse', 'drop'}, default 'refuse'
        Raise at the first invalid row, or leave such rows out and give their number.
        The other transitions of a broken episode are still counted. Where the state and
        the action of such a row can be read, ``dropped`` counts it, and intervals let
        it lead anywhere. A terminated row without a next state leads to the simulator's
        terminal state, where there is only one.
    kept_moves : int, default 200_000
        About how many transitions are kept, in whole episodes, for importance
        sampling. A hash of its name decides whether an episode is kept.
    output : path_like, optional
        The .npz file to write the counts to, whole or not at all.
    jobs : int, default 1
        The number of processes on this machine; -1 means one a core.
    dask : str, optional
        The address of a scheduler whose workers see the files.
    progress : bool, default False
        Whether to show a bar.
    columns : mapping of str to str, optional
        What the files call a log's columns, as ``Transitions.load`` takes it.

    Returns
    -------
    TransitionCounts
        The counts, with a sample of whole episodes.

    Raises
    ------
    ValueError
        If a file is no table or has other columns than the first (rewards alone may be
        missing), has invalid rows that are refused, or is a copy of another one. The
        error names the file, the row or the column, the rule and the value.
    OSError
        If a file is not there, or there is no scheduler at the address.
    MemoryError
        If the different transitions are more than memory holds; the error says how
        many they are, and what helps.

    Notes
    -----
    The time is linear in the number of rows. The memory is that of the distinct
    transitions of one file and of the names of the episodes. The result does not
    depend on ``jobs`` or ``dask``. ``load`` says what a file may hold, and when an
    episode goes on in the next file.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> folder = pathlib.Path(tempfile.mkdtemp())
    >>> for k in range(2):
    ...     log = Transitions([0, k], [0, 0], [k, 2], episode=[0, 0])
    ...     log.save(folder / f"part-{k}.csv")
    >>> Transitions.open(folder)
    TransitionCounts(4 transitions, 4 different, of 2 files in 2 episodes of 2 steps:
                     0 terminated, 2 truncated; states 0..2, actions 0..0;
                     2 whole episodes kept)
    """
    _checks.boolean(progress, "progress")
    named = check_columns(columns)
    _checks.one_of(bad_rows, "bad_rows", ("refuse", "drop"))
    limits = _limits(simulator, n_states, n_actions)
    limits = limits._replace(
        drop=bad_rows == "drop", kept=_checks.positive_integer(kept_moves, "kept_moves")
    )
    limits = limits._replace(columns=named)
    if not limits.drop:
        limits = limits._replace(end=None)
    if not (_checks.is_integer(jobs) and jobs == -1):
        _checks.positive_integer(jobs, "jobs")
    if isinstance(path, str | os.PathLike) and holds_counts(path):
        refuse_columns(named, "counts")
        counted = TransitionCounts.load(path)
        if output is not None:
            counted.save(output)
        return counted
    files = find_log_files(path, warns=True)
    refuse_same_bytes(files)
    limits = limits._replace(has_others=len(files) > 1)
    calls = ((file, plain_name(file, files), limits) for file in files)
    results = _parallel.each(count_file, calls, len(files), jobs=jobs, dask=dask)
    shown = progress_bar(
        "counting",
        results,
        total=len(files),
        unit="file",
        disable=not progress,
        delay=0,
        leave=True,
    )
    result = _add_files(files, shown, limits)
    if output is not None:
        result.save(output)
    return result


def _add_files(
    files: Sequence[LogFile], counted: Iterable[FileCounts], limits: Limits
) -> TransitionCounts:
    """Add the counts of the files in their order: their sums, recording and sample."""
    sums: list[dict[str, Column]] = []
    recording = Recording(by_episodes=False)
    episodes = _Episodes(limits)
    reported: set[object] = set()
    same_columns = SameColumns()
    folders = Folders()
    namesakes = Namesakes(files)
    overlaps = Overlaps()
    reordered = Reordered()
    dropped: Counter[tuple[int, int]] = Counter()
    n_ended = 0
    empty: list[str] = []
    for file, counts in zip(files, counted, strict=True):
        renamed = [pair for pair in counts.matching.renamed if pair not in reported]
        left = [label for label in counts.matching.left_out if label not in reported]
        reported.update(renamed, left)
        warn_read_as(repr(file.path), renamed)
        warn_left_out(repr(file.path), left)
        if counts.sums is not None or counts.recording.dropped:
            same_columns.add(file.path, counts.known)
        folders.add(file, counts.known, counts.episodes, counts.matching.fields())
        overlaps.add(file.path, counts.ends_print)
        if counts.sums is None and not counts.recording.dropped:
            empty.append(file.path)
        if counts.sums is not None:
            namesakes.add_sums(file.path, counts.sums)
            if len(files) > 1:  # hashes of all rows take a fifth of the reading
                reordered.add_sums(file.path, counts.sums)
            n_entries = sum(len(part["count"]) for part in (*sums, counts.sums))
            with name_missing_memory(file.path, partial(int, n_entries)):
                _checks.require_memory(NUMBERS_PER_ENTRY * n_entries, file.path)
                add_sums(sums, counts.sums)
        dropped.update(counts.dropped)
        n_ended += counts.n_ended
        recording = recording.join(episodes.add(counts))
    episodes.end()
    if not sums:
        raise ArgumentError(
            "path",
            f"must have at least one good row; of {len(files)} files none has, the"
            f" first of which is {files[0].path!r}"
            + "".join(f"; {reason}" for reason in recording.reasons[:1]),
        )
    warn_of(episodes.notes)
    overlaps.warn()
    reordered.warn(overlaps.found)
    warn_of_empty_files(empty, len(files))
    recording = episodes.correct(recording)
    if n_ended:
        _warn_of_ends(n_ended, limits)
    n_entries = sum(len(part["count"]) for part in sums)
    with name_missing_memory(files[-1].path, partial(int, n_entries)):
        whole = join_sums(sums)
    _require_finite_sums(whole)
    return _to_counts(whole, recording, episodes.sample, dropped)


def _require_finite_sums(sums: Mapping[str, Column]) -> None:
    """Raise an ArgumentError where rewards add up to more than a float holds."""
    over = np.flatnonzero(~np.isfinite(sums["reward_sum"].astype(float)))
    if over.size:
        k = over[0]
        raise ArgumentError(
            "path",
            "must have rewards whose sums are floats; those of state"
            f" {sums['state'][k]}, action {sums['action'][k]} add up to"
            f" {sums['reward_sum'][k]} (give them in a larger unit)",
        )


def _warn_of_ends(number: int, limits: Limits) -> None:
    """Warn of terminated rows without a next state, and say where they end."""
    end = name_text(limits.names[0], limits.end)
    rows = "1 terminated row has" if number == 1 else f"{number} terminated rows have"
    _checks.warn(
        f"{rows} no next_state: read as {_checks.show(end)}, the only state of the"
        " simulator in which an episode is over",
        DataWarning,
    )


class _Episodes:
    """Hold the sample of the files so far, and the episode that may go on in the next.

    ``lengths`` are those of the episodes that are whole, their least and largest of
    each file.
    """

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self.sample = Sample()
        self.notes: list[str] = []
        self.lengths: list[int] = []
        self.n_joined = 0
        self.n_truncated = 0  # the cuts between joined parts, which are counted as ends
        self.n_broken = 0  # joined episodes that are broken in both parts
        self.last: Row | None = None
        self.knows_truncated = False  # the file of the last row
        self.open: Run | None = None

    def add(self, counts: FileCounts) -> Recording:
        """Add a file; return how it was recorded, with what is seen here alone."""
        recording = counts.recording
        ends = counts.ends
        if counts.sums is None and not recording.dropped:
            return recording  # an empty part
        if ends is None:
            self.end()
            self._join(counts.sample)
            self.last = None
            return recording
        names = self.limits.names[0]
        verdict = judge(
            self.last, ends.first, show=lambda state: name_text(names, state)
        )
        self.notes += [verdict.note] if verdict.note else []
        head = ends.head
        if verdict.fault:
            place = f"{ends.first.path!r}: {TIMESTEP}"
            if not self.limits.drop:
                raise ArgumentError(place, verdict.fault + WAY)
            words = f"{ArgumentError(place, verdict.fault)}{COUNTED}"
            recording = recording._replace(
                broken=recording.broken + (not head.is_broken),
                reasons=(words, *recording.reasons)[:N_REASONS],
            )
            head = head._replace(is_broken=True)
        if verdict.is_one and self.open is not None:
            self.n_joined += 1
            self.n_truncated += not self.knows_truncated
            self.n_broken += self.open.is_broken and head.is_broken
            self.open = self.open.join(head, self.limits.kept)
        else:
            self.end()
            self.open = head
        if not ends.is_single:
            self.end()
            self.lengths += ends.others
            self.open = ends.tail
        self._join(counts.sample)
        self.last = ends.last
        self.knows_truncated = "truncated" in counts.known
        return recording

    def end(self) -> None:
        """Add the open episode, which does not go on."""
        if self.open is not None:
            self.lengths.append(self.open.n)
            self._join(self.open.sample(self.limits.kept))
        self.open = None

    def _join(self, sample: Sample) -> None:
        """Add a sample to that of the files before."""
        self.sample = self.sample.join(sample, self.limits.kept)

    def correct(self, recording: Recording) -> Recording:
        """Correct the sum of the files' recordings by counting joined episodes once."""
        if not self.n_joined:
            return recording
        return recording._replace(
            episodes=recording.episodes - self.n_joined,
            shortest=min(self.lengths),
            longest=max(self.lengths),
            truncated=recording.truncated - self.n_truncated,
            broken=recording.broken - self.n_broken,
        )


def _to_counts(
    sums: dict[str, Column],
    recording: Recording,
    sample: Sample,
    dropped: Mapping[tuple[int, int], int],
) -> TransitionCounts:
    """Make counts in the order of s, a, s', terminated, with their sample.

    They have no rewards where there are none.
    """
    order = np.lexsort([sums[label] for label in reversed(KEY)])
    has_rewards = sums["reward_count"].any()
    columns: dict[str, Any] = {
        label: column[order]
        for label, column in sums.items()
        if has_rewards or not label.startswith("reward")
    }
    rows = dict(sample.rows)
    if len(rows.get("place", ())):
        place = rows.pop("place")
        episode = np.cumsum(np.diff(place, prepend=place[:1]) != 0)
        columns["sample"] = Transitions(**rows, episode=episode)
    if dropped:
        columns["dropped"] = np.array(
            [(*pair, number) for pair, number in sorted(dropped.items())]
        )
    return TransitionCounts(**columns, recording=recording)


def _limits(
    simulator: FiniteMDP | None, n_states: int | None, n_actions: int | None
) -> Limits:
    """Return the limits of states and actions: a simulator's, or given numbers."""
    if simulator is not None:
        _checks.instance(simulator, FiniteMDP, "simulator")
        if n_states is not None or n_actions is not None:
            raise ArgumentError(
                "n_states and n_actions",
                "must be left out where simulator is given, which has its own",
            )
        names = (simulator.state_names, simulator.action_names)
        ends = np.flatnonzero(simulator.absorbing())
        end = int(ends[0]) if len(ends) == 1 else None
        return Limits((simulator.n_states, simulator.n_actions), names, end=end)
    states = LARGEST
    actions = LARGEST
    if n_states is not None:
        states = _checks.positive_integer(n_states, "n_states")
    if n_actions is not None:
        actions = _checks.positive_integer(n_actions, "n_actions")
    return Limits((states, actions))


def refuse_columns(columns: object, source: str) -> None:
    """Raise an ArgumentError where ``columns`` is given for a log that is no table."""
    is_empty = isinstance(columns, Mapping) and not columns
    if columns is not None and not is_empty:
        raise ArgumentError(
            "columns",
            f"must be left out for {source}: it names the columns of a table, a file or"
            " a data frame",
        )


def read_log(
    source: Any,
    simulator: FiniteMDP,
    name: str = "log",
    columns: ColumnsLike | None = None,
) -> Transitions | TransitionCounts:
    """Read a log of any form and return it in the simulator's numbers.

    ``source``: Transitions, counts, a data frame, episodes as lists of steps, a path,
    or a list of paths, a pattern or a folder. ``name``: what errors call it.
    ``columns``: what a file or a frame calls a log's columns.
    """
    log: Any = source
    is_list = isinstance(source, list | tuple)
    if _are_paths(source):
        try:
            if not is_list and holds_counts(source):
                refuse_columns(columns, "counts")
                log = TransitionCounts.load(source)
            else:
                log = Transitions._load(source, columns, names_by_label(simulator))
        except ArgumentError as error:
            argument = error.argument
            if argument != "columns":
                argument = f"{name}: {argument}"
            raise ArgumentError(argument, error.rule) from error
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from error
    elif is_list:
        refuse_columns(columns, "a list of episodes")
        log = Transitions.from_episodes(source)
        name = "episodes"
    elif not isinstance(source, Transitions | TransitionCounts) and is_frame(source):
        log = Transitions.from_frame(source, simulator=simulator, columns=columns)
        name = "frame"
    else:
        refuse_columns(columns, type(source).__name__)
    if isinstance(log, TransitionCounts):
        return log
    if not isinstance(log, Transitions):
        raise ArgumentError(
            name,
            f"must be Transitions; got {type(log).__name__}{_suggest_transitions(log)}",
        )
    return log.numbered(simulator, name)


def _are_paths(source: object) -> bool:
    """Return whether a source of a log is a path, or a list of paths."""
    is_list = isinstance(source, list | tuple)
    paths: Any = source if is_list and source else (source,)
    return all(isinstance(path, str | os.PathLike) for path in paths)


def has_labels(source: object) -> bool:
    """Return whether a source of a log, a file or a frame, has labels of columns."""
    if isinstance(source, str | os.PathLike):
        try:
            return not holds_counts(source)
        except ArgumentError:
            # its reader says what is wrong with a path, by the argument's own name
            return True
    if _are_paths(source):
        return True
    return not isinstance(source, Transitions | TransitionCounts) and is_frame(source)


def _suggest_transitions(value: Any) -> str:
    """Suggest how to make a log of an object that is none."""
    if hasattr(value, "read"):
        return " (an open file: give its name)"
    if isinstance(value, Mapping):
        return " (a mapping of columns: Transitions(**log))"
    if getattr(value, "ndim", 0) == 2:
        return " (columns state, action, next_state: Transitions(*log.T))"
    return ""

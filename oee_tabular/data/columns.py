"""Columns, episodes and files of every log, of states as numbers or as vectors."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import freeze
from oee_tabular._keywords import suggest_keywords
from oee_tabular.data import files
from oee_tabular.data.copies import refuse_same_bytes
from oee_tabular.data.frames import number_in_order
from oee_tabular.data.joining import Source, join_logs
from oee_tabular.data.labels import ColumnsLike
from oee_tabular.data.rules import (
    COLUMNS,
    NO_NAMES,
    ColumnLike,
    check_array,
    find_order_faults,
    find_repeat,
)
from oee_tabular.exceptions import ArgumentError, DataWarning
from oee_tabular.typing import (
    Array,
    BoolArray,
    Column,
    IntArray,
    IntArrayLike,
    RealArrayLike,
    Seed,
)


@dataclass(frozen=True, eq=False, repr=False, init=False)
class LogColumns:
    """Hold the columns of a log, (n,) or, where states are vectors, (n, d).

    ``Transitions`` describes them.
    """

    FILES: ClassVar[files.Format]
    ALLOWS_MISSING_REWARDS: ClassVar[bool] = False
    # the files of a log that is read from several, which set it for themselves
    _sources: ClassVar[tuple[Source, ...]] = ()

    state: Column
    action: Column
    next_state: Column
    reward: Array | None
    terminated: BoolArray
    truncated: BoolArray
    episode: IntArray | None
    timestep: IntArray | None
    behavior_probability: Array | None

    def __init__(
        self,
        state: ColumnLike,
        action: ColumnLike,
        next_state: ColumnLike,
        reward: RealArrayLike | None = None,
        *,
        terminated: RealArrayLike | None = None,
        episode: ColumnLike | None = None,
        timestep: RealArrayLike | None = None,
        behavior_probability: RealArrayLike | None = None,
        truncated: RealArrayLike | None = None,
    ) -> None:
        given = {
            "reward": reward,
            "terminated": terminated,
            "truncated": truncated,
            "episode": _number_texts(episode),
            "timestep": timestep,
            "behavior_probability": behavior_probability,
        }
        columns: dict[str, Column | None] = self._moves(state, action, next_state)
        for label, value in given.items():
            columns[label] = None if value is None else check_array(value, label)
        rewards = columns["reward"]
        if rewards is not None and not self.ALLOWS_MISSING_REWARDS:
            _checks.require_finite(rewards, "reward")
        elif rewards is not None and rewards.size and np.isnan(rewards).all():
            columns["reward"] = None
        lengths = {
            name: len(column) for name, column in columns.items() if column is not None
        }
        if len(set(lengths.values())) > 1:
            raise ArgumentError(
                "columns", f"must have equal lengths; they have {lengths}"
            )
        n = lengths["state"]
        if n == 0:
            raise ArgumentError("state", "must have at least one row; the log is empty")
        if columns["terminated"] is None:
            columns["terminated"] = np.zeros(n, dtype=np.bool_)
        if columns["episode"] is not None:
            self._check_episodes(columns)
        elif columns["truncated"] is None:
            columns["truncated"] = np.zeros(n, dtype=np.bool_)
        for name, column in columns.items():
            object.__setattr__(self, name, None if column is None else freeze(column))

    def _check_episodes(self, columns: dict[str, Any]) -> None:
        """Check that episodes are consecutive, in order, and end where they say.

        Fills in timestep and truncated.
        """
        episode = columns["episode"]
        starts = _episode_starts(episode)
        repeat = find_repeat(episode[starts[:-1]], starts[:-1])
        if repeat is not None:
            raise ArgumentError("episode", repeat[1])
        is_first, is_last = np.zeros((2, len(episode)), dtype=np.bool_)
        is_first[starts[:-1]] = True
        is_last[starts[1:] - 1] = True
        given = {name: column for name, column in columns.items() if column is not None}
        before = {
            name: np.concatenate([column[:1], column[:-1]])
            for name, column in given.items()
            if name in ("next_state", "timestep", "terminated", "truncated")
        }
        faults = find_order_faults(
            given, before, is_first, ~is_first, self._differs, self._show
        )
        if faults:
            raise faults[0].to_error()
        if columns["timestep"] is None:
            timestep = np.arange(len(episode))
            timestep -= np.repeat(starts[:-1], np.diff(starts))
            columns["timestep"] = timestep
        if columns["truncated"] is None:
            columns["truncated"] = is_last & ~columns["terminated"]

    @staticmethod
    def _moves(
        state: ColumnLike, action: ColumnLike, next_state: ColumnLike
    ) -> dict[str, Column | None]:
        """Check each of the three columns of a transition."""
        raise NotImplementedError

    @staticmethod
    def _differs(following: Column, state: Column) -> BoolArray:
        """Return for each row whether its next state and the state after it differ."""
        return np.asarray(following != state)

    def _show(self, state: Column) -> Any:
        """Return one row's state as errors show it."""
        return state.tolist()

    def _describe_source(self, row: int) -> str:
        """Return the file of a row and its place there; empty for a single source."""
        for source in self._sources:
            if row < source.n_rows:
                return f" ({source.place(row)} of {source.path!r})"
            row -= source.n_rows
        return ""

    def __len__(self) -> int:
        return len(self.state)

    @property
    def episode_starts(self) -> IntArray | None:
        """Return the rows at which episodes begin, with n at the end.

        They are (n_episodes + 1,) integers; None without episodes.
        """
        return None if self.episode is None else _episode_starts(self.episode)

    @property
    def n_episodes(self) -> int | None:
        """Return the number of episodes; None without episodes."""
        starts = self.episode_starts
        return None if starts is None else len(starts) - 1

    def columns(self) -> dict[str, Column]:
        """Return the columns that the log has, in the order of the file formats.

        Returns
        -------
        dict of str to ndarray
            The columns by their labels.
        """
        return {
            name: getattr(self, name)
            for name in COLUMNS
            if getattr(self, name) is not None
        }

    def select(self, rows: IntArrayLike) -> Self:
        """Return the given rows as independent transitions.

        Timesteps are kept, episodes are not.

        Parameters
        ----------
        rows : array_like of bool or int
            A mask of shape (n,), or row numbers.

        Returns
        -------
        Transitions
            The log of these rows, a log of the same class.

        Raises
        ------
        ValueError
            If ``rows`` is no mask and no row numbers of the log, or chooses no row.
        """
        asked = _checks.as_array(rows, "rows", "a mask or row numbers")
        try:
            chosen = np.zeros(0, dtype=np.int64)
            if asked.size:
                chosen = np.arange(len(self))[asked]
            if chosen.ndim != 1:
                raise IndexError(f"they have shape {asked.shape}")
        except (IndexError, ValueError, TypeError, OverflowError) as error:
            raise ArgumentError(
                "rows",
                f"must be a mask or row numbers of the log's {len(self)} rows; {error}",
            ) from None
        if chosen.size == 0:
            raise ArgumentError(
                "rows", "must choose at least one row; they choose none"
            )
        columns = self.columns()
        columns.pop("episode", None)
        return type(self)(**{name: column[chosen] for name, column in columns.items()})

    def first(self, n: int) -> Self:
        """Return the first n rows with their episodes.

        Parameters
        ----------
        n : int
            The number of rows.

        Returns
        -------
        Transitions
            The log of these rows; its last episode is truncated where it is cut.

        Raises
        ------
        ValueError
            If the log has fewer rows.
        """
        size = self._check_size(n)
        columns = {
            name: column[:size].copy() for name, column in self.columns().items()
        }
        if self.episode is not None:
            columns["truncated"][-1] |= not columns["terminated"][-1]
        return type(self)(**columns)

    @classmethod
    def concatenate(cls, logs: Sequence[Self]) -> Self:
        """Join several logs to one, in their order.

        Parameters
        ----------
        logs : sequence of Transitions
            The logs, of one class.

        Returns
        -------
        Transitions
            The joined log. Episodes are numbered on; a column that one of the logs
            lacks is left out with a warning, but rewards that one of them lacks are
            missing there, nan.

        Raises
        ------
        ValueError
            If there is no log, or something else among the logs.

        Examples
        --------
        >>> from oee_tabular import Transitions
        >>> a = Transitions([0, 1], [0, 0], [1, 2], episode=[0, 0])
        >>> b = Transitions([0], [1], [2], episode=[0])
        >>> Transitions.concatenate([a, b]).episode
        array([0, 0, 1])
        """
        return cls._concatenate(logs, "logs[{}]".format)

    @classmethod
    def _concatenate(cls, logs: Sequence[Self], call: Callable[[int], str]) -> Self:
        """Join several logs to one; warnings call the k-th of them ``call(k)``."""
        parts = _checks.collection(logs, "logs", f"one or more {cls.__name__}")
        if not parts or not all(isinstance(log, cls) for log in parts):
            raise ArgumentError(
                "logs", f"must be one or more {cls.__name__}; got {_checks.show(logs)}"
            )
        columns = [log.columns() for log in parts]
        if cls.ALLOWS_MISSING_REWARDS and any("reward" in part for part in columns):
            columns = [
                {"reward": np.full(len(part["state"]), np.nan)} | part
                for part in columns
            ]
        joined = {
            name: [part[name] for part in columns]
            for name in columns[0]
            if all(name in part for part in columns)
        }
        left_out = [name for part in columns for name in part if name not in joined]
        if left_out:
            k = next(k for k, part in enumerate(columns) if left_out[0] not in part)
            names = ", ".join(dict.fromkeys(left_out))
            _checks.warn(
                f"left out of the joined log: {names}, which {call(k)} lacks",
                DataWarning,
            )
        if "episode" in joined:
            joined["episode"] = _number_on(joined["episode"])
        return cls(**{name: np.concatenate(part) for name, part in joined.items()})

    def draw(self, n: int, *, seed: Seed) -> Self:
        """Draw n rows without replacement, as independent transitions.

        It is the paper's way of sampling.

        Parameters
        ----------
        n : int
            The number of rows.
        seed : int, Generator or None
            Anything that ``numpy.random.default_rng`` takes.

        Returns
        -------
        Transitions
            The log of the drawn rows.

        Raises
        ------
        ValueError
            If the log has fewer rows.
        """
        order = _checks.generator(seed).permutation(len(self))
        return self.select(order[: self._check_size(n)])

    def _check_size(self, n: object) -> int:
        """Check a number of rows, of which the log must have as many."""
        size = _checks.positive_integer(n, "n")
        if size > len(self):
            raise ArgumentError(
                "n", f"must be at most the {len(self)} rows of the log; it is {size}"
            )
        return size

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the log to a file, whole or not at all.

        Numbers survive each format to the last bit.

        Parameters
        ----------
        path : path_like
            A file that ends in .npz, .csv, .csv.gz or .parquet; one that is there is
            replaced. A log of numbered states with episodes and rewards can also be
            written as a Minari data set: a new folder without suffix, or
            ``minari:namespace/name-v0``.

        Raises
        ------
        ValueError
            If the path has another ending, or the format cannot hold the log.

        See Also
        --------
        load : Read the file.
        """
        files.save(self, self.FILES, path)

    @classmethod
    @suggest_keywords
    def load(cls, path: files.Paths, *, columns: ColumnsLike | None = None) -> Self:
        r"""Read a log from files.

        Parameters
        ----------
        path : path_like, or iterable of path_like
            A file .npz, .csv, .csv.gz or .parquet, a Minari folder, or a Minari id that is on
            this machine. Several files, a pattern or a folder of files are one log, in
            the order of their names, numbers by their size (``concatenate``). An
            episode that is cut at the end of a file goes on in the next one.
        columns : mapping of str to str, optional
            What the files call a log's columns, ``{"state": "pose_before"}``; several
            labels to a state or an action make a tuple, or a vector. Without it they
            are found by their own labels, and by those of other projects that mean one
            thing. None in place of a label leaves the column out.

        Returns
        -------
        Transitions
            The log.

        Raises
        ------
        ValueError
            If a file is no log, or a copy of another one; the error names the file, the
            column, the row and the rule.
        OSError
            If a file is not there.

        See Also
        --------
        save : Write such a file.

        Notes
        -----
        The columns of CSV and parquet files have the names of the constructor's
        parameters. Only state, action and next_state are required. A vector has the
        columns state_0, state_1, ..., next_state_0, ..., and action or action_0, ...
        Labels of other projects, such as ``obs``, ``next_obs`` and ``rewards``, are
        read with a warning, and refused where they may mean two things, as ``done``.

        Each line of a CSV file is a transition: a quote that does not close in its
        line is an error, and so is a second header. A missing reward is an empty field
        or a word as other programs write it: nan, NA, NULL, None, N/A. Flags are true,
        false, t, f, yes, no, y, n, 0 and 1. Episodes are as many as their texts: 7 and
        007 are two. States and actions in numbers are read as numbers: 7 and 007 are
        one.

        Of several files, the last episode of one and the first of the next are one
        where they have one id, the last row is neither terminated nor truncated, and
        states and timesteps go on; else a warning says what speaks against it. A
        folder ``column=value`` names a column of the files in it.

        Files that hold the same bytes are refused, and so are ``a.csv`` and
        ``a.parquet`` with the same transitions. Warnings name two files that share runs
        of 20 rows or more, or hold the same rows in another order, tables of a folder
        in a format that is not read, and files without rows.

        Examples
        --------
        >>> import pathlib, tempfile
        >>> from oee_tabular import Transitions
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "log.csv"
        >>> _ = path.write_text("state,action,next_state\n0,0,1\n1,0,2\n")
        >>> Transitions.load(path)
        Transitions(2 transitions: 0 terminated, 0 truncated; states 0..2, actions 0..0)
        """
        return cls._load(path, columns)

    @classmethod
    def _load(
        cls,
        path: files.Paths,
        columns: ColumnsLike | None,
        names: files.OwnNames = NO_NAMES,
    ) -> Self:
        """Read a log from files; ``names`` are the simulator's, where it is known.

        They are by a log's columns, and none of them is a word for no value.
        """
        form = cls.FILES.with_columns(columns)
        found = files.find_log_files(path, warns=True)
        refuse_same_bytes(found)
        reported: set[Any] = set()
        parts = (files.load(form, file, reported, names) for file in found)
        log: Self = join_logs(
            cls, found, parts, files.warn_of_empty_files, form.columns
        )
        return log


def _number_texts(episode: Any) -> Any:
    """Number episodes that are texts in the order of their first rows.

    Other episodes are returned as they are. Blanks around a text say nothing, as in
    files and frames.
    """
    if isinstance(episode, np.ndarray):
        may_hold_texts = episode.ndim == 1 and episode.dtype.kind in "UO"
    else:
        may_hold_texts = isinstance(episode, list | tuple)
    items = list(episode) if may_hold_texts else []
    if items and all(isinstance(item, str) for item in items):
        return number_in_order([item.strip() for item in items])[0]
    return episode


def _number_on(parts: Sequence[IntArray]) -> list[IntArray]:
    """Renumber the episodes of several logs so that no two logs share a number."""
    sizes = [int(part.max()) + 1 - min(int(part.min()), 0) for part in parts]
    if sum(sizes) >= 2**63:  # which 64 bits do not hold
        parts = [np.unique(part, return_inverse=True)[1] for part in parts]
        sizes = [int(part.max()) + 1 for part in parts]
    firsts = itertools.accumulate(sizes[:-1], initial=0)
    return [
        part + (first - min(int(part.min()), 0))
        for part, first in zip(parts, firsts, strict=True)
    ]


def _episode_starts(episode: IntArray) -> IntArray:
    """Return the rows at which the episode changes, with 0 and n at the ends."""
    changes = np.flatnonzero(episode[1:] != episode[:-1]) + 1
    return np.concatenate([[0], changes, [len(episode)]]).astype(np.int64)

"""Columns, episodes and files of every log, of numbered states or not."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from oee_tabular import _checks, _files
from oee_tabular._checks import freeze
from oee_tabular.data import files
from oee_tabular.data.frames import number_in_order
from oee_tabular.data.rules import (
    COLUMNS,
    check_array,
    count_others,
    find_order_faults,
    find_repeat,
)
from oee_tabular.exceptions import ArgumentError
from oee_tabular.typing import Array, BoolArray, Column, IntArray, Seed


@dataclass(frozen=True, eq=False, repr=False, init=False)
class LogColumns:
    """The columns of a log, (n,) or, where states are vectors, (n, d); those of
    ``Transitions`` are described there.
    """

    FILES: ClassVar[files.Format]
    ALLOWS_MISSING_REWARDS: ClassVar[bool] = False

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
        state: ArrayLike,
        action: ArrayLike,
        next_state: ArrayLike,
        reward: ArrayLike | None = None,
        *,
        terminated: ArrayLike | None = None,
        episode: ArrayLike | None = None,
        timestep: ArrayLike | None = None,
        behavior_probability: ArrayLike | None = None,
        truncated: ArrayLike | None = None,
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
        columns |= {
            label: None if value is None else check_array(value, label)
            for label, value in given.items()
        }
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
        """Episodes stand together, in order, and end where they say; fills in timestep
        and truncated.
        """
        episode = columns["episode"]
        starts = _episode_starts(episode)
        repeat = find_repeat(episode[starts[:-1]], starts[:-1])
        if repeat is not None:
            raise ValueError(repeat[1])
        is_first, is_last = np.zeros((2, len(episode)), dtype=np.bool_)
        is_first[starts[:-1]] = True
        is_last[starts[1:] - 1] = True
        if columns["timestep"] is None:
            columns["timestep"] = np.arange(len(episode)) - np.repeat(
                starts[:-1], np.diff(starts)
            )
        given = {name: column for name, column in columns.items() if column is not None}
        before = {
            name: np.concatenate([column[:1], column[:-1]])
            for name, column in given.items()
        }
        for fault in find_order_faults(
            given, before, is_first, ~is_first, self._differs, self._show
        ):
            raise ValueError(fault.describe() + count_others(fault))
        if columns["truncated"] is None:
            columns["truncated"] = is_last & ~columns["terminated"]

    @staticmethod
    def _moves(
        state: ArrayLike, action: ArrayLike, next_state: ArrayLike
    ) -> dict[str, Column | None]:
        """The three columns of a transition, checked each for itself."""
        raise NotImplementedError

    @staticmethod
    def _differs(following: Column, state: Column) -> BoolArray:
        """Row by row, whether a next state and the state that follows it differ."""
        return np.asarray(following != state)

    def _show(self, state: Column) -> Any:
        """One row's state, as errors show it."""
        return state.tolist()

    def __len__(self) -> int:
        return len(self.state)

    @property
    def episode_starts(self) -> IntArray | None:
        """(n_episodes + 1,) row numbers at which episodes begin, and n at the end; None
        without episodes.
        """
        return None if self.episode is None else _episode_starts(self.episode)

    @property
    def n_episodes(self) -> int | None:
        """Number of episodes; None without episodes."""
        starts = self.episode_starts
        return None if starts is None else len(starts) - 1

    def columns(self) -> dict[str, Column]:
        """The columns that the log has, in the order of the file formats."""
        return {
            name: getattr(self, name)
            for name in COLUMNS
            if getattr(self, name) is not None
        }

    def select(self, rows: object) -> Self:
        """The given rows (a mask or row numbers) as independent transitions: timesteps
        are kept, episodes are not.
        """
        try:
            asked = np.asarray(rows)
            chosen = (
                np.arange(len(self))[asked]
                if asked.size
                else np.zeros(0, dtype=np.int64)
            )
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
        return type(self)(
            **{
                name: column[chosen]
                for name, column in self.columns().items()
                if name != "episode"
            }
        )

    def first(self, n: int) -> Self:
        """The first n rows with their episodes; the last episode is truncated where it
        is cut.
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
        """One log of several, in their order: episodes are numbered on; a column that
        one of them lacks is dropped.

        Rewards that one of them lacks are missing there, nan.

        Examples
        --------
        >>> from oee_tabular import Transitions
        >>> a, b = Transitions([0, 1], [0, 0], [1, 2], episode=[0, 0]), Transitions([0], [1], [2], episode=[0])
        >>> Transitions.concatenate([a, b]).episode
        array([0, 0, 1])
        """
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
        if "episode" in joined:
            after = np.cumsum(
                [0, *(int(part.max()) + 1 for part in joined["episode"][:-1])]
            )
            joined["episode"] = [
                part + first
                for part, first in zip(joined["episode"], after, strict=True)
            ]
        return cls(**{name: np.concatenate(part) for name, part in joined.items()})

    def draw(self, n: int, *, seed: Seed) -> Self:
        """Draw n rows without replacement, as independent transitions: the paper's way
        of sampling.
        """
        return self.select(
            _checks.generator(seed).permutation(len(self))[: self._check_size(n)]
        )

    def _check_size(self, n: object) -> int:
        size = _checks.positive_integer(n, "n")
        if size > len(self):
            raise ArgumentError(
                "n", f"must be at most the {len(self)} rows of the log; it is {size}"
            )
        return size

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write .npz, .csv or .parquet; a log of numbered states also as a Minari data
        set (which needs episodes and rewards).

        A Minari data set is a folder without suffix, or ``minari:namespace/name-v0``.
        What is written appears whole or not at all; numbers survive each format to the
        last bit.
        """
        files.save(self, self.FILES, path)

    @classmethod
    def load(cls, path: Any) -> Self:
        """Read .npz, .csv, .parquet, a Minari folder or a Minari id that is on this
        machine.

        Several files, a pattern or a folder of files are one log, in the order of their
        names (``concatenate``). Columns of CSV and parquet are the constructor's names,
        only state, action and next_state are required; those of vectors are state_0,
        state_1, ..., next_state_0, ..., action or action_0, ...
        """
        logs = []
        reported: set[str] = set()
        for file in files.find_log_files(path):
            columns = files.load(cls.FILES, file, reported)
            with _files.parts_of(file.path, "a log"):
                logs.append(cls(**columns))
        return logs[0] if len(logs) == 1 else cls.concatenate(logs)


def _number_texts(episode: Any) -> Any:
    """Episodes that have texts for numbers, in the order of their first rows."""
    is_texts = (
        episode.ndim == 1 and episode.dtype.kind in "UO"
        if isinstance(episode, np.ndarray)
        else True
    )
    items = (
        list(episode)
        if is_texts and isinstance(episode, list | tuple | np.ndarray)
        else []
    )
    return (
        number_in_order(items)[0]
        if items and all(isinstance(item, str) for item in items)
        else episode
    )


def _episode_starts(episode: IntArray) -> IntArray:
    changes = np.flatnonzero(np.diff(episode)) + 1
    return np.concatenate([[0], changes, [len(episode)]]).astype(np.int64)

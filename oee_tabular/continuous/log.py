"""A log of moves between states in R^d, before a task has encoded it into numbered states.

The fields are those of ``Transitions``; in files a state is spread over the columns state_0, state_1, ..., next_state_0, ...
An action is a number from the task's finite set (column ``action``), or what was commanded (columns action_0, action_1, ...),
which is matched to the nearest action of the set.
"""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from oee_tabular import _checks
from oee_tabular._checks import Array, BoolArray, IntArray, freeze
from oee_tabular.data import transitions as plain

CHAIN_TOLERANCE = 1e-6  # relative: float32 copies of one state are the same state


@dataclass(frozen=True, eq=False, repr=False)
class ContinuousTransitions:
    """Logged moves with continuous states, one a row; checked when made and immutable.

    Parameters
    ----------
    state, next_state : (n, d) finite numbers
    action : (n,) integers from 0, numbers of a task's actions; or (n, k) numbers, the commands themselves
    reward : (n,) finite numbers, optional
    terminated, truncated, episode, timestep, behavior_probability : (n,), optional
        As in ``Transitions``; within an episode each next_state is the following row's state, up to a relative 1e-6.

    Raises
    ------
    ValueError
        Names the column, the row, the rule and the value found.

    Notes
    -----
    ``Discretization.encode_log`` makes ``Transitions`` of it, ``Discretization.counts`` soft counts.

    Examples
    --------
    >>> ContinuousTransitions([[0.0, 0.1], [0.2, 0.3]], [0, 1], [[0.2, 0.3], [0.4, 0.1]], episode=[0, 0])
    ContinuousTransitions(2 transitions of 2-dimensional states in 1 episodes: 0 terminated, 1 truncated;
                          actions 0..1)
    """

    state: Array
    action: NDArray[Any]
    next_state: Array
    reward: Array | None
    terminated: BoolArray
    truncated: BoolArray
    episode: IntArray | None
    timestep: IntArray | None
    behavior_probability: Array | None

    def __init__(
        self,
        state: Any,
        action: Any,
        next_state: Any,
        reward: Any = None,
        *,
        terminated: Any = None,
        episode: Any = None,
        timestep: Any = None,
        behavior_probability: Any = None,
        truncated: Any = None,
    ) -> None:
        states, following = _vectors(state, "state"), _vectors(next_state, "next_state")
        actions = _actions(action)
        n = len(states)
        if following.shape[1] != states.shape[1]:
            raise ValueError(
                f"next_state must have the {states.shape[1]} coordinates of state; it has {following.shape[1]}"
            )
        lengths = {"state": n, "action": len(actions), "next_state": len(following)}
        if len(set(lengths.values())) > 1:
            raise ValueError(f"columns must have equal lengths; they have {lengths}")
        # the checks of the other columns are those of a log whose states are all one state
        rest = plain.Transitions(
            np.zeros(n, dtype=np.int64),
            np.zeros(n, dtype=np.int64),
            np.zeros(n, dtype=np.int64),
            reward,
            terminated=terminated,
            episode=episode,
            timestep=timestep,
            behavior_probability=behavior_probability,
            truncated=truncated,
        )
        _check_chain(states, following, rest.episode)
        columns = rest.columns() | {"state": freeze(states), "action": freeze(actions), "next_state": freeze(following)}
        for name in plain.COLUMNS:
            object.__setattr__(self, name, columns.get(name))

    def __len__(self) -> int:
        return len(self.state)

    def __repr__(self) -> str:
        text = f"{len(self)} transitions of {self.n_state}-dimensional states"
        if self.episode is not None:
            text += f" in {len(np.unique(self.episode))} episodes"
        text += f": {int(self.terminated.sum())} terminated, {int(self.truncated.sum())} truncated"
        if self.action.ndim == 1:
            text += f"; actions 0..{self.action.max()}"
        else:
            text += f"; actions are {self.action.shape[1]}-dimensional commands"
        if self.reward is not None:
            text += f"; rewards {self.reward.min():g} to {self.reward.max():g}"
        return f"ContinuousTransitions({text})"

    @property
    def n_state(self) -> int:
        """The number d of coordinates of a state."""
        return int(self.state.shape[1])

    def columns(self) -> dict[str, NDArray[Any]]:
        """The columns that the log has, (n,) or (n, d)."""
        return {name: getattr(self, name) for name in plain.COLUMNS if getattr(self, name) is not None}

    def action_numbers(self, actions: Any, *, strict: bool = False) -> IntArray:
        """(n,) which of a task's ``actions`` (A,) or (A, k) each row took.

        Commands are matched to the nearest action (Euclidean distance). Where one is not in the set a warning says how many
        are not and the largest distance, or an error does with ``strict``.
        """
        _checks.boolean(strict, "strict")
        table = _checks.float_array(actions, "actions", ndim=(1, 2))
        table = table.reshape(len(table), -1)
        if self.action.ndim == 1:
            bad = np.flatnonzero(self.action >= len(table))
            if bad.size:
                raise ValueError(
                    f"log.action[{bad[0]}] must be in 0..{len(table) - 1}, the numbers of the task's actions; "
                    f"it is {self.action[bad[0]]} ({bad.size} such rows in all)"
                )
            return np.asarray(self.action, dtype=np.int64)
        if self.action.shape[1] != table.shape[1]:
            raise ValueError(
                f"log.action must have the {table.shape[1]} coordinates of the task's actions; it has {self.action.shape[1]}"
            )
        distance = np.linalg.norm(self.action[:, None, :] - table[None], axis=2)
        nearest = distance.argmin(axis=1)
        away = distance[np.arange(len(self)), nearest]
        off = np.flatnonzero(away > 1e-6 * (1.0 + np.abs(table).max()))
        if off.size:
            worst = int(away.argmax())
            found = (
                f"{off.size} of {len(self)} rows do not; the farthest, row {worst}, is {self.action[worst].tolist()}, "
                f"{away[worst]:.3g} from {table[nearest[worst]].tolist()}"
            )
            if strict:
                raise ValueError(f"log.action must be one of the task's {len(table)} actions; {found}")
            warnings.warn(f"log.action is moved to the nearest of the task's actions: {found}", stacklevel=3)
        return np.asarray(nearest, dtype=np.int64)

    def select(self, rows: Any) -> Self:
        """A bag of the given rows (a mask or row numbers): timesteps are kept, episodes are not."""
        asked = np.asarray(rows)
        if asked.size == 0:
            raise ValueError("rows must choose at least one row; they choose none")
        try:
            chosen = np.arange(len(self))[asked]
        except IndexError as error:
            raise ValueError(f"rows must be a mask or row numbers of the log's {len(self)} rows; {error}") from None
        if chosen.size == 0:
            raise ValueError("rows must choose at least one row; they choose none")
        return type(self)(**{name: column[chosen] for name, column in self.columns().items() if name != "episode"})

    def first(self, n: int) -> Self:
        """The first n rows with their episodes; the last episode is truncated where it is cut."""
        size = _checks.positive_integer(n, "n")
        if size > len(self):
            raise ValueError(f"n must be at most the {len(self)} rows of the log; it is {size}")
        columns = {name: column[:size].copy() for name, column in self.columns().items()}
        if self.episode is not None:
            columns["truncated"][-1] |= not columns["terminated"][-1]
        return type(self)(**columns)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write .npz, .csv or .parquet, whole or not at all; numbers survive each of them to the last bit."""
        from oee_tabular.continuous import log_files

        log_files.write(self.columns(), path)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read .npz, .csv, .parquet, or a Minari folder or id, whose observations are the states.

        Required of a table are state_0, ..., next_state_0, ... and action or action_0, ...
        """
        from oee_tabular.continuous import log_files

        columns = log_files.read(path)
        try:
            return cls(**columns)
        except ValueError as error:
            raise ValueError(f"{os.fspath(path)!r}: {error}") from None


def _vectors(value: Any, name: str) -> Array:
    array = _checks.float_array(value, name)
    if array.ndim != 2 or array.shape[1] == 0:
        raise ValueError(f"{name} must have shape (n, d); it has shape {array.shape}")
    if len(array) == 0:
        raise ValueError(f"{name} must have at least one row; the log is empty")
    _checks.require_finite(array, name)
    return array


def _actions(value: Any) -> NDArray[Any]:
    array = _checks.as_array(value, "action")
    if array.ndim == 2:
        return _vectors(array, "action")
    if array.ndim != 1:
        raise ValueError(f"action must have shape (n,) (numbers) or (n, k) (commands); it has shape {array.shape}")
    return plain._integers(array, "action")


def _check_chain(state: Array, following: Array, episode: IntArray | None) -> None:
    if episode is None or len(state) < 2:
        return
    apart = np.abs(following[:-1] - state[1:])
    broken = (apart > CHAIN_TOLERANCE * (1.0 + np.abs(state[1:]))).any(axis=1) & (episode[:-1] == episode[1:])
    rows = np.flatnonzero(broken)
    if rows.size:
        row = int(rows[0])
        raise ValueError(
            f"next_state[{row}] must be the state of row {row + 1}, the next of episode {episode[row]}; it is "
            f"{following[row].tolist()}, and state[{row + 1}] is {state[row + 1].tolist()} ({rows.size} such rows in all)"
        )

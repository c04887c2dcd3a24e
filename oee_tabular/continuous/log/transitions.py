"""Logs of transitions between states in R^d, before a task encodes them into numbers.

The fields are those of ``Transitions``; in files a state is spread over the columns
state_0, state_1, ..., next_state_0, ... An action is a number from the task's finite
set (column ``action``), or what was commanded (columns action_0, action_1, ...), which
is matched to the nearest action of the set.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from oee_tabular import _checks, _files
from oee_tabular.continuous.log.lists import find_lists, read_lists
from oee_tabular.data.aliases import NUMBERED, stem
from oee_tabular.data.columns import LogColumns
from oee_tabular.data.files import Columns, Format
from oee_tabular.data.frames import is_minari, minari_episodes
from oee_tabular.data.labels import ColumnsLike, show_labels, suggest_columns
from oee_tabular.data.rules import check_array
from oee_tabular.data.tables import LogFile, read_labels
from oee_tabular.exceptions import ArgumentError, DataWarning
from oee_tabular.typing import Array, BoolArray, IntArray, RealArrayLike

# the columns of a log that is recorded by stepping
RECORDED = (
    "state",
    "action",
    "next_state",
    "reward",
    "terminated",
    "truncated",
    "episode",
    "behavior_probability",
)
CHAIN_TOLERANCE = 1e-6  # relative: float32 copies of one state are the same state


class VectorFormat(Format):
    """The format of logs whose columns are vectors.

    Vectors are (n, d) arrays in an npz file and numbered columns in a table. Minari
    data sets are read, not written.
    """

    kind = "continuous_transitions"
    writes_minari = False
    has_vectors = True

    def to_table(self, columns: Columns) -> Columns:
        """Split each vector into one column for each coordinate."""
        flat: Columns = {}
        for name, column in columns.items():
            if column.ndim == 1:
                flat[name] = column
            else:
                flat |= {f"{name}_{k}": part for k, part in enumerate(column.T)}
        return flat

    def from_table(self, flat: Columns, name: str) -> Columns:
        """Join state_0, state_1, ... into one column (n, d), by their numbers."""
        columns: Columns = {}
        parts: dict[str, dict[int, NDArray[Any]]] = {}
        for label, column in flat.items():
            if match := NUMBERED.fullmatch(label):
                parts.setdefault(match[1], {})[int(match[2])] = column
            else:
                columns[label] = column
        for vector, part in parts.items():
            if vector in columns:
                raise ArgumentError(
                    f"{name!r}",
                    f"must have either {vector} or {vector}_0, ...; it has both",
                )
            missing = next((k for k in range(len(part)) if k not in part), None)
            if missing is not None:
                text = (
                    f"every column from {vector}_0 to {vector}_{max(part)};"
                    f" {vector}_{missing} is missing"
                )
                raise ArgumentError(f"{name!r}", f"must have {text}")
            # columns of kinds without a common kind cannot be stacked
            with _files.parts_of(name, f"{vector}_0, ..."):
                columns[vector] = np.stack([part[k] for k in range(len(part))], axis=1)
        if columns["state"].ndim == 1:
            raise ArgumentError(
                f"{name!r}",
                "must have the columns state_0, ..., next_state_0, ...; it has one"
                " column state: a log of numbered states",
            )
        return columns

    def read_lists(self, file: LogFile, reported: set[Any]) -> Columns | None:
        """Return the columns of parquet whose states are lists; None of another file.

        Such are the frames of LeRobot's data sets.
        """
        if file.suffix != ".parquet" or file.fixed:
            return None
        return read_lists(self, file.path, reported)

    def require(
        self, labels: Iterable[str], name: str, taken: Iterable[str] | None = None
    ) -> None:
        """Raise a ValueError unless the three columns of a transition are there."""
        labels = list(labels)
        whole = set(map(stem, labels if taken is None else taken))
        absent = [column for column in self.required if column not in whole]
        if absent:
            expected = ("state_0", "next_state_0", *self.required)
            raise ArgumentError(
                f"{name!r}",
                "must have the columns state_0, ..., next_state_0, ... and action (or"
                f" action_0, ...); it has no {', no '.join(absent)}, only"
                f" {show_labels(labels)}{suggest_columns(expected, labels)}"
                " (say which columns hold them: columns={'state_0': 'LABEL'},"
                " --column state_0=LABEL)",
            )

    def check_episode(
        self, observations: NDArray[Any], actions: NDArray[Any], name: str
    ) -> None:
        """Raise a ValueError unless observations are vectors, and actions known forms.

        Actions are numbers (n,) or vectors (n, k).
        """
        if (
            observations.ndim != 2
            or observations.dtype.kind not in "fiu"
            or actions.ndim not in (1, 2)
        ):
            raise ArgumentError(
                f"{name!r}",
                "must have observations that are vectors, and actions that are numbers"
                f" or vectors; they have shapes {observations.shape} of"
                f" {observations.dtype} and {actions.shape} of {actions.dtype}",
            )


VECTORS = VectorFormat()


def holds_states(
    path: str | os.PathLike[str], columns: ColumnsLike | None = None
) -> bool:
    """Return whether a file or Minari data set is a log of continuous states.

    Of tables only the header is read. ``columns``: what it calls a log's columns.
    Several labels to a state may make a name as well, and say nothing.
    """
    name = _files.local(path)
    suffix = LogFile(name).suffix
    if suffix == ".npz":
        return _files.npz_kind(_files.read_npz(name)) == VECTORS.kind
    if suffix in (".csv", ".parquet"):
        try:
            if suffix == ".parquet" and find_lists(name, columns or {}):
                return True
            said = {
                field: label
                for field, label in (columns or {}).items()
                if not isinstance(label, list | tuple)
            }
            found = VECTORS.with_columns(said).match(read_labels(name), name)
            return "state_0" in found.taken
        except ValueError:
            return False  # whoever reads it says what is wrong
    if not is_minari(name):
        return False
    first = next(iter(minari_episodes(name)), None)
    return first is not None and np.asarray(first.observations).ndim == 2


@dataclass(frozen=True, eq=False, repr=False, init=False)
class ContinuousTransitions(LogColumns):
    """Logged transitions with continuous states, one per row, checked and immutable.

    Parameters
    ----------
    state : array_like of shape (n, d)
        The states, finite numbers.
    action : array_like of shape (n,) or (n, k)
        Integers from 0, the numbers of a task's actions; or the commands themselves.
    next_state : array_like of shape (n, d)
        The next states, finite numbers.
    reward : array_like of shape (n,), optional
        The rewards, finite numbers.
    terminated : array_like of bool, shape (n,), optional
        Whether the episode ended in the next state. By default no episode ended.
    episode : array_like of int or str, shape (n,), optional
        The episode of each row. Within an episode each next_state is the following
        row's state, up to a relative 1e-6.
    timestep : array_like of int, shape (n,), optional
        The time t of each row, from 0; by default 0, 1, 2, ... within each episode.
    behavior_probability : array_like of shape (n,), optional
        The probability with which the behaviour policy took the action, in [0, 1].
    truncated : array_like of bool, shape (n,), optional
        Whether the recording stopped after the row, but not the task. By default it did
        so in the last row of every episode that did not terminate.

    Raises
    ------
    ValueError
        If a column breaks a rule; the text names the column, the row, the rule and the
        value found.

    See Also
    --------
    Transitions : A log of numbered states.
    Discretization.encode : Make ``Transitions`` of this log.
    Discretization.counts : Make soft counts of this log.

    Examples
    --------
    >>> ContinuousTransitions(
    ...     [[0.0, 0.1], [0.2, 0.3]], [0, 1], [[0.2, 0.3], [0.4, 0.1]], episode=[0, 0]
    ... )
    ContinuousTransitions(2 transitions of 2-dimensional states in 1 episodes: 0 terminated, 1 truncated;
                          actions 0..1)
    """

    FILES: ClassVar[Format] = VECTORS

    state: Array
    next_state: Array

    @staticmethod
    def _moves(
        state: object, action: object, next_state: object
    ) -> dict[str, NDArray[Any] | None]:
        """Check the states, actions and next states, and return them by name."""
        states = _vectors(state, "state")
        following = _vectors(next_state, "next_state")
        if following.shape[1] != states.shape[1]:
            raise ArgumentError(
                "next_state",
                f"must have the {states.shape[1]} coordinates of state; it has"
                f" {following.shape[1]}",
            )
        return {"state": states, "action": _actions(action), "next_state": following}

    @staticmethod
    def _differs(following: NDArray[Any], state: NDArray[Any]) -> BoolArray:
        """Return which rows (n,) differ by more than a float32 copy does."""
        far = np.abs(following - state) > CHAIN_TOLERANCE * (1.0 + np.abs(state))
        return np.asarray(far.any(axis=1))

    def __repr__(self) -> str:
        """Describe the log in two lines."""
        text = f"{len(self)} transitions of {self.n_state}-dimensional states"
        if self.episode is not None:
            text += f" in {len(np.unique(self.episode))} episodes"
        text += (
            f": {int(self.terminated.sum())} terminated, {int(self.truncated.sum())}"
            " truncated"
        )
        if self.action.ndim == 1:
            text += f"; actions 0..{self.action.max()}"
        else:
            text += f"; actions are {self.action.shape[-1]}-dimensional commands"
        if self.reward is not None:
            text += f"; rewards {self.reward.min():g} to {self.reward.max():g}"
        return f"ContinuousTransitions({text})"

    @property
    def n_state(self) -> int:
        """Return the number d of coordinates of a state."""
        return int(self.state.shape[1])

    def action_numbers(
        self, actions: RealArrayLike, *, strict: bool = False
    ) -> IntArray:
        """Return the number of the task's action that each row took.

        Parameters
        ----------
        actions : array_like of shape (A,) or (A, k)
            The task's actions.
        strict : bool, default False
            Whether a command that is not one of the actions is an error, not a warning.

        Returns
        -------
        ndarray of int, shape (n,)
            The number of each row's action.

        Raises
        ------
        ValueError
            If the actions do not fit the log's, or their distances to its commands do
            not fit into memory; if, with ``strict``, a command is not in the set; or if
            one lies farther off than half of what the actions are apart.

        Warns
        -----
        DataWarning
            If commands are not in the set, with how many there are and the largest
            distance.

        Notes
        -----
        Commands are matched to the nearest action by Euclidean distance.
        """
        _checks.boolean(strict, "strict")
        table = _checks.float_array(actions, "actions", ndim=(1, 2))
        if table.size == 0:
            raise ArgumentError(
                "actions", f"must hold at least one; they have shape {table.shape}"
            )
        table = table.reshape(len(table), -1)
        if self.action.ndim == 1:
            bad = np.flatnonzero(self.action >= len(table))
            if bad.size:
                raise ArgumentError(
                    f"log.action[{bad[0]}]",
                    f"must be in 0..{len(table) - 1}, the numbers of the task's"
                    f" actions; it is {self.action[bad[0]]} ({bad.size} such rows in"
                    " all)",
                )
            return np.asarray(self.action, dtype=np.int64)
        if self.action.shape[1] != table.shape[1]:
            raise ArgumentError(
                "log.action",
                f"must have the {table.shape[1]} coordinates of the task's actions; it"
                f" has {self.action.shape[1]}",
            )
        # the differences, their squares and the distances, before the first is made
        n_values = float(len(self)) * (2 * table.size + len(table))
        _checks.require_memory(n_values, "actions", len(table))
        distances = np.linalg.norm(self.action[:, None, :] - table[None], axis=2)
        nearest = distances.argmin(axis=1)
        distance = distances.min(axis=1)
        n_off = int((distance > 1e-6 * (1.0 + np.abs(table).max())).sum())
        worst = int(distance.argmax())
        if n_off == 0:
            return np.asarray(nearest, dtype=np.int64)
        about = f"the task's {len(table)} actions"
        which = (
            f"{n_off} of {len(self)} rows are none of them; the farthest, row {worst},"
            f" is {self.action[worst].tolist()}, {distance[worst]:.3g} from"
            f" {table[nearest[worst]].tolist()}"
        )
        if strict:
            raise ArgumentError("log.action", f"must be one of {about}; {which}")
        gaps = [np.diff(np.unique(column)).max(initial=0.0) for column in table.T]
        room = 0.5 * float(np.linalg.norm(gaps)) * (1.0 + 1e-9)  # 0 of a single action
        if 0.0 < room < distance[worst]:
            raise ArgumentError(
                "log.action",
                f"must lie among {about}, no farther off than half of what they are"
                f" apart; {which}. Name actions that reach as far"
                " (tasks.GymnasiumTask(actions=), --task-option actions=)",
            )
        _checks.warn(
            f"log.action is moved to the nearest of {about}: {which}. More actions"
            " (tasks.GymnasiumTask(actions=), --task-option actions=) move it less",
            DataWarning,
        )
        return np.asarray(nearest, dtype=np.int64)


def _vectors(value: object, name: str) -> Array:
    """Return a column of finite vectors as an array (n, d)."""
    array = _checks.float_array(value, name)
    if array.ndim != 2 or array.shape[1] == 0:
        hint = " (a log of numbered states: Transitions)" if array.ndim == 1 else ""
        raise ArgumentError(
            name, f"must have shape (n, d); it has shape {array.shape}{hint}"
        )
    if len(array) == 0:
        raise ArgumentError(name, "must have at least one row; the log is empty")
    _checks.require_finite(array, name)
    return array


def _actions(value: object) -> NDArray[Any]:
    """Return the column of actions as numbers (n,) or commands (n, k)."""
    array = _checks.as_array(value, "action")
    if array.ndim not in (1, 2):
        raise ArgumentError(
            "action",
            "must have shape (n,) (numbers) or (n, k) (commands); it has shape"
            f" {array.shape}",
        )
    if array.ndim == 1:
        return check_array(array, "action")
    return _vectors(array, "action")

"""A log of transitions (s, a, s'), with the rest of what a recording may hold.

Episodes are ragged: a flat table with an episode number for each row, never padded. A *terminated* transition ends the
task (nothing is paid afterwards); a *truncated* one ends the recording only, and the task would have gone on.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from oee_tabular import _checks, _printing
from oee_tabular._checks import Array, BoolArray, IntArray, freeze
from oee_tabular._sparse import canonical

COLUMNS = (
    "state",
    "action",
    "next_state",
    "reward",
    "terminated",
    "truncated",
    "episode",
    "timestep",
    "behavior_probability",
)


@dataclass(frozen=True, eq=False, repr=False)
class Transitions:
    """Logged moves of the target environment, one a row; checked when made and immutable.

    Parameters
    ----------
    state, action, next_state : (n,) integers from 0
    reward : (n,) finite numbers, optional
    terminated : (n,) booleans, optional
        The move ended the task. Default: none did.
    episode : (n,) integers, optional
        Rows of one episode stand together, in order; each row's next_state is the following row's state, and a
        terminated or truncated row is the last of its episode. Without it the rows are a bag of moves.
    timestep : (n,) integers from 0, optional
        t of each row; within an episode 0, 1, 2, ... (the default there).
    behavior_probability : (n,) numbers in [0, 1], optional
        Probability with which the behaviour policy took the recorded action.
    truncated : (n,) booleans, optional
        The recording stopped after this move although the task went on. Default: the last row of every episode that
        did not terminate.

    Raises
    ------
    ValueError
        Names the column, the row, the rule and the value found.

    Examples
    --------
    >>> log = Transitions([0, 1, 0], [0, 0, 1], [1, 2, 0], [0.0, 1.0, 0.0], terminated=[0, 1, 0], episode=[0, 0, 1])
    >>> log
    Transitions(3 transitions in 2 episodes of 1 to 2 steps: 1 terminated, 1 truncated;
                states 0..2, actions 0..1; rewards 0 to 1)
    """

    state: IntArray
    action: IntArray
    next_state: IntArray
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
        columns: dict[str, NDArray[Any] | None] = {
            "state": _integers(state, "state"),
            "action": _integers(action, "action"),
            "next_state": _integers(next_state, "next_state"),
            "reward": None if reward is None else _checks.float_array(reward, "reward", ndim=1),
            "terminated": None if terminated is None else _booleans(terminated, "terminated"),
            "truncated": None if truncated is None else _booleans(truncated, "truncated"),
            "episode": None if episode is None else _integers(episode, "episode", low=None),
            "timestep": None if timestep is None else _integers(timestep, "timestep"),
            "behavior_probability": None,
        }
        if behavior_probability is not None:
            columns["behavior_probability"] = _checks.float_array(behavior_probability, "behavior_probability", ndim=1)
        lengths = {name: len(column) for name, column in columns.items() if column is not None}
        if len(set(lengths.values())) > 1:
            raise ValueError(f"columns must have equal lengths; they have {lengths}")
        n = lengths["state"]
        if n == 0:
            raise ValueError("state must have at least one row; the log is empty")
        _check_numbers(columns["reward"], columns["behavior_probability"])
        if columns["terminated"] is None:
            columns["terminated"] = np.zeros(n, dtype=np.bool_)
        starts = None if columns["episode"] is None else _episode_starts(columns["episode"])
        if starts is not None:
            _check_episodes(columns, starts)
        elif columns["truncated"] is None:
            columns["truncated"] = np.zeros(n, dtype=np.bool_)
        for name, column in columns.items():
            object.__setattr__(self, name, None if column is None else freeze(column))

    def __len__(self) -> int:
        return len(self.state)

    def __repr__(self) -> str:
        return f"Transitions({self.describe()})"

    def _repr_html_(self) -> str:
        rows = [(name.replace("_", " "), value) for name, value in self.summary().items() if value is not None]
        return _printing.facts("Transitions: a log", rows)

    @property
    def episode_starts(self) -> IntArray | None:
        """(n_episodes + 1,) row numbers at which episodes begin, and n at the end; None without episodes."""
        return None if self.episode is None else _episode_starts(self.episode)

    @property
    def n_episodes(self) -> int | None:
        """Number of episodes; None without episodes."""
        starts = self.episode_starts
        return None if starts is None else len(starts) - 1

    def counts(self, n_states: int, n_actions: int, *, discount: float | None = None) -> sparse.csr_array:
        """How often each (s, a, s') was seen: csr of shape (S*A, S), row s*A + a.

        With ``discount`` each move counts discount**timestep, the paper's discounted d (needs timesteps).
        Raises ValueError where a state or action is outside the given numbers.
        """
        _checks.positive_integer(n_states, "n_states")
        _checks.positive_integer(n_actions, "n_actions")
        _checks.require_memory(float(n_states) * n_actions, "n_states * n_actions", n_states * n_actions)
        for name, column, limit in (
            ("state", self.state, n_states),
            ("action", self.action, n_actions),
            ("next_state", self.next_state, n_states),
        ):
            bad = np.flatnonzero(column >= limit)
            if bad.size:
                given = "n_actions" if name == "action" else "n_states"
                raise ValueError(
                    f"log.{name}[{bad[0]}] must be in 0..{limit - 1}; it is {column[bad[0]]} ({bad.size} such rows in all; "
                    f"{given} is {limit})"
                )
        weights = np.ones(len(self))
        if discount is not None:
            if self.timestep is None:
                raise ValueError("log must have timesteps (or episodes) to be counted with a discount; it has none")
            weights = _checks.number_in(discount, "discount", 0.0, 1.0) ** self.timestep.astype(np.float64)
        rows = self.state * n_actions + self.action
        matrix = sparse.csr_array((weights, (rows, self.next_state)), shape=(n_states * n_actions, n_states))
        return canonical(matrix, drop_zeros=True)

    def select(self, rows: Any) -> Self:
        """A bag of the given rows (a mask or row numbers): timesteps are kept, episodes are not."""
        try:
            asked = np.asarray(rows)
            chosen = np.arange(len(self))[asked] if asked.size else np.zeros(0, dtype=np.int64)
            if chosen.ndim != 1:
                raise IndexError(f"they have shape {asked.shape}")
        except (IndexError, ValueError, TypeError, OverflowError) as error:
            raise ValueError(f"rows must be a mask or row numbers of the log's {len(self)} rows; {error}") from None
        if chosen.size == 0:
            raise ValueError("rows must choose at least one row; they choose none")
        return type(self)(
            self.state[chosen],
            self.action[chosen],
            self.next_state[chosen],
            None if self.reward is None else self.reward[chosen],
            terminated=self.terminated[chosen],
            truncated=self.truncated[chosen],
            timestep=None if self.timestep is None else self.timestep[chosen],
            behavior_probability=None if self.behavior_probability is None else self.behavior_probability[chosen],
        )

    def first(self, n: int) -> Self:
        """The first n rows with their episodes; the last episode is truncated where it is cut."""
        size = _checks.positive_integer(n, "n")
        if size > len(self):
            raise ValueError(f"n must be at most the {len(self)} rows of the log; it is {size}")
        columns = {name: column[:size].copy() for name, column in self.columns().items()}
        if self.episode is not None:
            columns["truncated"][-1] |= not columns["terminated"][-1]
        return type(self)(**columns)

    @classmethod
    def concatenate(cls, logs: Sequence[Self]) -> Self:
        """One log of several, in their order: episodes are numbered on; a column that one of them lacks is dropped.

        Examples
        --------
        >>> a, b = Transitions([0, 1], [0, 0], [1, 2], episode=[0, 0]), Transitions([0], [1], [2], episode=[0])
        >>> Transitions.concatenate([a, b]).episode
        array([0, 0, 1])
        """
        parts = list(logs)
        if not parts or not all(isinstance(log, cls) for log in parts):
            raise ValueError(f"logs must be one or more {cls.__name__}; got {parts!r:.80}")
        columns = [log.columns() for log in parts]
        joined = {
            name: [part[name] for part in columns] for name in columns[0] if all(name in part for part in columns)
        }
        if "episode" in joined:
            after = np.cumsum([0, *(int(part.max()) + 1 for part in joined["episode"][:-1])])
            joined["episode"] = [part + first for part, first in zip(joined["episode"], after, strict=True)]
        return cls(**{name: np.concatenate(part) for name, part in joined.items()})

    def draw(self, n: int, *, seed: Any) -> Self:
        """A bag of n rows drawn without replacement, the paper's way of taking a sample."""
        size = _checks.positive_integer(n, "n")
        if size > len(self):
            raise ValueError(f"n must be at most the {len(self)} rows of the log; it is {size}")
        return self.select(_checks.generator(seed).permutation(len(self))[:size])

    def summary(self) -> dict[str, Any]:
        """What the log holds, as plain numbers."""
        starts = self.episode_starts
        lengths = None if starts is None else np.diff(starts)
        return {
            "transitions": len(self),
            "episodes": self.n_episodes,
            "episode_length_min": None if lengths is None else int(lengths.min()),
            "episode_length_max": None if lengths is None else int(lengths.max()),
            "terminated": int(self.terminated.sum()),
            "truncated": int(self.truncated.sum()),
            "states_seen": len(np.unique(np.concatenate([self.state, self.next_state]))),
            "largest_state": int(max(self.state.max(), self.next_state.max())),
            "largest_action": int(self.action.max()),
            "state_action_pairs_seen": len(np.unique(np.stack([self.state, self.action]), axis=1).T),
            "reward_min": None if self.reward is None else float(self.reward.min()),
            "reward_max": None if self.reward is None else float(self.reward.max()),
            "behavior_probability": self.behavior_probability is not None,
        }

    def describe(self) -> str:
        """The summary in one line."""
        facts = self.summary()
        text = f"{facts['transitions']} transitions"
        if facts["episodes"] is not None:
            text += f" in {facts['episodes']} episodes of {facts['episode_length_min']} to {facts['episode_length_max']} steps"
        text += f": {facts['terminated']} terminated, {facts['truncated']} truncated"
        text += f"; states 0..{facts['largest_state']}, actions 0..{facts['largest_action']}"
        if self.reward is not None:
            text += f"; rewards {facts['reward_min']:g} to {facts['reward_max']:g}"
        return text + ("; behaviour probabilities" if facts["behavior_probability"] else "")

    def columns(self) -> dict[str, NDArray[Any]]:
        """The columns that the log has, in the order of the file formats."""
        return {name: getattr(self, name) for name in COLUMNS if getattr(self, name) is not None}

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write .npz, .csv, .parquet, or a Minari data set (a folder without suffix, or ``minari:namespace/name-v0``).

        The file appears whole or not at all. A Minari data set needs episodes and rewards.
        """
        from oee_tabular.data import files

        files.save(self, path)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read .npz, .csv, .parquet, a Minari folder or a Minari id that is on this machine.

        Columns of CSV and parquet are the constructor's names; only state, action and next_state are required.
        """
        from oee_tabular.data import files

        return files.load(cls, path)


def _integers(value: Any, name: str, *, low: int | None = 0) -> IntArray:
    try:
        array = np.array(value)
    except ValueError as error:
        raise ValueError(f"{name} must be a column of integers; {error}") from None
    if array.ndim != 1:
        raise ValueError(f"{name} must have 1 dimension; it has shape {array.shape}")
    if array.size == 0:
        return np.zeros(0, dtype=np.int64)
    if array.dtype.kind not in "iuf":
        raise ValueError(f"{name} must hold integers; it holds {array.dtype}")
    if array.dtype.kind == "f":
        bad = np.flatnonzero(~((np.abs(array) <= 2.0**53) & (array == np.floor(array))))
        if bad.size:
            raise ValueError(f"{name}[{bad[0]}] must be an integer; it is {array[bad[0]]}")
    if array.dtype.kind == "u" and (bad := np.flatnonzero(array > np.iinfo(np.int64).max)).size:
        raise ValueError(f"{name}[{bad[0]}] must be below 2**63; it is {array[bad[0]]}")
    whole: IntArray = array.astype(np.int64)
    if low is not None and (bad := np.flatnonzero(whole < low)).size:
        raise ValueError(f"{name}[{bad[0]}] must be at least {low}; it is {whole[bad[0]]}")
    return whole


def _booleans(value: Any, name: str) -> BoolArray:
    array = _checks.as_array(value, name)
    if array.ndim != 1:
        raise ValueError(f"{name} must have 1 dimension; it has shape {array.shape}")
    if array.dtype.kind == "b" or array.size == 0:
        return array.astype(np.bool_)
    words = np.char.lower(array.astype(str))
    true, false = (np.isin(words, (word, digit, f"{digit}.0")) for word, digit in (("true", "1"), ("false", "0")))
    bad = np.flatnonzero(~(true | false))
    if bad.size:
        raise ValueError(f"{name}[{bad[0]}] must be a boolean (or 0 or 1); it is {array.tolist()[bad[0]]!r}")
    return true


def _check_numbers(reward: Array | None, probability: Array | None) -> None:
    if reward is not None:
        _checks.require_finite(reward, "reward")
    if probability is not None:
        bad = np.flatnonzero(~((probability >= 0) & (probability <= 1)))
        if bad.size:
            raise ValueError(f"behavior_probability[{bad[0]}] must be in [0, 1]; it is {probability[bad[0]]}")


def _episode_starts(episode: IntArray) -> IntArray:
    changes = np.flatnonzero(np.diff(episode)) + 1
    return np.concatenate([[0], changes, [len(episode)]]).astype(np.int64)


def _check_episodes(columns: dict[str, NDArray[Any] | None], starts: IntArray) -> None:
    """Episodes stand together, in order, and end where they say; fills in timestep and truncated."""
    episode, state, next_state = columns["episode"], columns["state"], columns["next_state"]
    terminated, truncated, timestep = columns["terminated"], columns["truncated"], columns["timestep"]
    assert episode is not None
    assert state is not None
    assert next_state is not None
    assert terminated is not None
    first, n = starts[:-1], len(state)
    names = episode[first]
    unique, index = np.unique(names, return_index=True)
    if len(unique) < len(names):
        again = int(np.setdiff1d(np.arange(len(names)), index)[0])
        raise ValueError(
            f"episode must keep the rows of an episode together; {names[again]} begins again in row {first[again]}"
        )
    position = np.arange(n) - np.repeat(first, np.diff(starts))
    if timestep is None:
        columns["timestep"] = position.astype(np.int64)
    elif (bad := np.flatnonzero(timestep != position)).size:
        row = int(bad[0])
        raise ValueError(
            f"timestep[{row}] must be {position[row]} (steps of an episode in order from 0); it is {timestep[row]} "
            f"in episode {episode[row]}"
        )
    last = np.zeros(n, dtype=np.bool_)
    last[starts[1:] - 1] = True
    broken = np.flatnonzero(~last[:-1] & (next_state[:-1] != state[1:]))
    if broken.size:
        row = int(broken[0])
        raise ValueError(
            f"next_state[{row}] must be the state of row {row + 1}, the next of episode {episode[row]}; "
            f"it is {next_state[row]}, and state[{row + 1}] is {state[row + 1]} ({broken.size} such rows in all)"
        )
    for name, flags in (("terminated", terminated), ("truncated", truncated)):
        if flags is not None and (early := np.flatnonzero(flags & ~last)).size:
            raise ValueError(
                f"{name}[{early[0]}] must be False: episode {episode[early[0]]} goes on in row {early[0] + 1}"
            )
    if truncated is None:
        columns["truncated"] = last & ~terminated

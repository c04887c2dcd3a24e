"""A log as counts: each distinct transition once, for logs that memory does not hold.

Counts, with rewards, are sufficient for values, ratios, tests and intervals. For what
needs whole episodes (importance sampling) a sample of them can stand beside the counts.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from oee_tabular import _checks, _files, _printing
from oee_tabular._checks import freeze
from oee_tabular._keywords import suggest_keywords
from oee_tabular._sparse import canonical, check_csr, row_of_entry
from oee_tabular.data.rules import COLUMNS, KEY, MOVE, check_array
from oee_tabular.data.sums import COUNTED, RowSums, counts_of
from oee_tabular.data.transitions import Transitions, describe_facts
from oee_tabular.exceptions import ArgumentError
from oee_tabular.typing import (
    Array,
    BoolArray,
    Column,
    Csr,
    IntArray,
    IntArrayLike,
    RealArrayLike,
    SparseLike,
)

KIND = "transition_counts"
REWARDS = COUNTED[1:]
N_REASONS = 5  # kinds of bad rows of which an example is given


class Recording(NamedTuple):
    """Hold how counted transitions were recorded, and which were left out.

    Attributes
    ----------
    by_episodes : bool
        Whether transitions may depend on those before them.
    episodes : int
        The number of episodes.
    shortest : int
        The length of the shortest episode, in transitions.
    longest : int
        The length of the longest episode, in transitions.
    truncated : int
        The number of episodes that were truncated.
    broken : int
        The number of episodes with a bad row.
    files : int
        The number of files.
    dropped : int
        The number of rows left out.
    reasons : tuple of str
        The first dropped row of each kind, in words.
    """

    by_episodes: bool = True
    episodes: int = 0
    shortest: int = 0
    longest: int = 0
    truncated: int = 0
    broken: int = 0
    files: int = 0
    dropped: int = 0
    reasons: tuple[str, ...] = ()

    def join(self, other: Recording) -> Recording:
        """Return the two as one recording, by episodes if the ``other`` is."""
        lengths = [length for length in (self.shortest, other.shortest) if length]
        return Recording(
            other.by_episodes,
            self.episodes + other.episodes,
            min(lengths, default=0),
            max(self.longest, other.longest),
            self.truncated + other.truncated,
            self.broken + other.broken,
            self.files + other.files,
            self.dropped + other.dropped,
            (*self.reasons, *other.reasons)[:N_REASONS],
        )


RECORDED_BY_EPISODES = Recording()


@suggest_keywords
@dataclass(frozen=True, eq=False, repr=False, init=False)
class TransitionCounts:
    """Hold the distinct transitions of a log with their counts, immutable.

    They are checked when made. ``Transitions.open`` counts files of any size;
    ``Problem`` takes the result in place of a log.

    Parameters
    ----------
    state : array_like of int of shape (K,)
        The states, from 0.
    action : array_like of int of shape (K,)
        The actions, from 0.
    next_state : array_like of int of shape (K,)
        The next states, from 0.
    count : array_like of shape (K,)
        The positive number of times that each transition was recorded. Tests and
        intervals need whole numbers.
    terminated : array_like of bool of shape (K,), optional
        Whether the transition ended the task; one transition may stand twice,
        terminated and not. By default none did.
    reward_sum : array_like of shape (K,), optional
        The finite sum of the rewards of each row's transitions.
    reward_min : array_like of shape (K,), optional
        The least of these rewards, nan where there are none.
    reward_max : array_like of shape (K,), optional
        The largest of these rewards, nan where there are none.
    reward_count : array_like of shape (K,), optional
        The number of these transitions that have a reward. None means all.
    recording : Recording, optional
        How the transitions were recorded. By default as episodes, whose bounds are
        valid for independent transitions too.
    sample : Transitions, optional
        Whole episodes of the log, drawn uniformly, for importance sampling.
    dropped : array_like of int of shape (L, 3), optional
        The state and the action of rows that were left out, and the number of such
        rows. Nobody knows where these transitions led: ``Problem.dropped`` holds them,
        so that intervals let them lead anywhere. None means that there are none.

    Raises
    ------
    ValueError
        If a column breaks a rule; the error names the column, the row, the rule and the
        value.

    See Also
    --------
    Transitions : A log whose transitions stand one a row.

    Examples
    --------
    >>> from oee_tabular import Transitions
    >>> TransitionCounts([0, 1], [0, 0], [1, 2], [30, 12])
    TransitionCounts(42 transitions, 2 different: 0 terminated, 0 truncated;
                     states 0..2, actions 0..0)
    """

    state: IntArray
    action: IntArray
    next_state: IntArray
    count: Array
    terminated: BoolArray
    reward_sum: Array | None
    reward_min: Array | None
    reward_max: Array | None
    reward_count: Array | None
    recording: Recording
    sample: Transitions | None
    dropped: IntArray | None

    # columns of a log that counts do not have
    reward: ClassVar[None] = None
    episode: ClassVar[None] = None
    timestep: ClassVar[None] = None
    episode_starts: ClassVar[None] = None
    behavior_probability: ClassVar[None] = None

    def __init__(
        self,
        state: IntArrayLike,
        action: IntArrayLike,
        next_state: IntArrayLike,
        count: RealArrayLike,
        terminated: RealArrayLike | None = None,
        reward_sum: RealArrayLike | None = None,
        reward_min: RealArrayLike | None = None,
        reward_max: RealArrayLike | None = None,
        reward_count: RealArrayLike | None = None,
        recording: Recording = RECORDED_BY_EPISODES,
        sample: Transitions | None = None,
        dropped: IntArrayLike | None = None,
    ) -> None:
        given = {
            "state": state,
            "action": action,
            "next_state": next_state,
            "terminated": terminated,
            "count": count,
            "reward_sum": reward_sum,
            "reward_min": reward_min,
            "reward_max": reward_max,
            "reward_count": reward_count,
        }
        columns: dict[str, Column] = {}
        for name, value in given.items():
            if value is None and name not in (*MOVE, "count"):
                continue
            if name in KEY:
                columns[name] = check_array(value, name)
            else:
                columns[name] = _checks.float_array(value, name, ndim=1)
        if "terminated" not in columns or not columns["terminated"].size:
            columns["terminated"] = np.zeros(len(columns["state"]), dtype=np.bool_)
        lengths = {name: len(column) for name, column in columns.items()}
        if len(set(lengths.values())) > 1:
            raise ArgumentError(
                "columns", f"must have equal lengths; they have {lengths}"
            )
        if lengths["state"] == 0:
            raise ArgumentError("state", "must have at least one row; the log is empty")
        if len({name in columns for name in REWARDS[:3]}) > 1:
            raise ArgumentError(
                "reward_sum, reward_min and reward_max", "must be given together"
            )
        count = columns["count"]
        is_good = (count > 0) & (count <= 2.0**53)
        _require(count, "count", is_good, "positive and at most 2**53")
        if "reward_sum" in columns:
            _check_counted_rewards(columns)
        _checks.instance(recording, Recording, "recording")
        recording = _require_recording(recording)
        if sample is not None:
            _checks.instance(sample, Transitions, "sample", "Transitions")
        for name in given:
            column = columns.get(name)
            object.__setattr__(self, name, None if column is None else freeze(column))
        object.__setattr__(self, "recording", recording)
        object.__setattr__(self, "sample", sample)
        lost = None if dropped is None else _check_dropped(dropped)
        object.__setattr__(self, "dropped", lost)

    @classmethod
    def of(cls, matrix: SparseLike, n_actions: int) -> Self:
        """Make counts of a matrix of them.

        Parameters
        ----------
        matrix : sparse of shape (S*A, S)
            The counts, in row s*A + a.
        n_actions : int
            The number A of actions.

        Returns
        -------
        TransitionCounts
            The counts.

        Raises
        ------
        ValueError
            If it is no such matrix, or all counts are 0.
        """
        actions = _checks.positive_integer(n_actions, "n_actions")
        csr = canonical(check_csr(matrix, "matrix"), drop_zeros=True)
        if csr.nnz == 0:
            raise ArgumentError(
                "matrix", "must have at least one transition; all counts are 0"
            )
        state, action = np.divmod(row_of_entry(csr), actions)
        return cls(state, action, csr.indices.astype(np.int64), csr.data)

    def __len__(self) -> int:
        """Return how many transitions were counted."""
        return round(float(self.count.sum()))

    def __repr__(self) -> str:
        return f"TransitionCounts({self.describe()})"

    def _repr_html_(self) -> str:
        """Return the summary as HTML, which notebooks show."""
        rows = [
            (name.replace("_", " "), value)
            for name, value in self.summary().items()
            if value not in (None, ())
        ]
        return _printing.facts("TransitionCounts: a log, counted", rows)

    @property
    def n_dropped_of_pairs(self) -> int:
        """Return how many rows were left out whose state and action are known."""
        return 0 if self.dropped is None else int(self.dropped[:, 2].sum())

    @property
    def by_episodes(self) -> bool:
        """Return whether transitions may depend on those before them."""
        return self.recording.by_episodes

    def counts(
        self, n_states: int, n_actions: int, *, discount: float | None = None
    ) -> Csr:
        """Return the counts of each (s, a, s').

        Parameters
        ----------
        n_states : int
            The number S of states.
        n_actions : int
            The number A of actions.
        discount : None, optional
            Must be left out, since counts have no timesteps; it is there because
            ``Transitions.counts`` has it.

        Returns
        -------
        csr_array of shape (S*A, S)
            The counts, in row s*A + a.

        Raises
        ------
        ValueError
            If a discount is given, or a state or action is outside the given numbers.
        """
        if discount is not None:
            raise ArgumentError(
                "discount",
                "must be left out where counts are given: they have no timesteps",
            )
        return counts_of(self, self.count, n_states, n_actions)

    def dropped_of_pairs(self, n_states: int, n_actions: int) -> Array:
        """Return how many rows of each state-action pair were left out.

        Parameters
        ----------
        n_states : int
            The number S of states.
        n_actions : int
            The number A of actions.

        Returns
        -------
        ndarray of shape (S*A,)
            The numbers, in row s*A + a.

        Raises
        ------
        ValueError
            If a state or action is outside the given numbers.
        """
        shape = (
            _checks.positive_integer(n_states, "n_states"),
            _checks.positive_integer(n_actions, "n_actions"),
        )
        _checks.require_memory(
            float(shape[0]) * shape[1], "n_states * n_actions", shape[0] * shape[1]
        )
        numbers = np.zeros(shape)
        if self.dropped is not None:
            state, action, number = self.dropped.T
            for column, values, size in (
                (0, state, n_states),
                (1, action, n_actions),
            ):
                bad = np.flatnonzero(values >= size)
                if bad.size:
                    raise ArgumentError(
                        f"log.dropped[{bad[0]}, {column}]",
                        f"must be in 0..{size - 1}; it is {values[bad[0]]}",
                    )
            np.add.at(numbers, (state, action), number)
        return numbers.reshape(-1)

    def moves(self) -> RowSums:
        """Return the rows, with the count of each and its rewards.

        Returns
        -------
        RowSums
            The number and the rewards of each row.
        """
        return RowSums(*(getattr(self, name) for name in COUNTED))

    def columns(self) -> dict[str, Column]:
        """Return the columns that the counts have.

        Returns
        -------
        dict of str to ndarray of shape (K,)
            The columns by their labels.
        """
        return {
            name: getattr(self, name)
            for name in (*KEY, *COUNTED)
            if getattr(self, name) is not None
        }

    def summary(self) -> dict[str, Any]:
        """Summarise the counts as plain numbers and words.

        Returns
        -------
        dict
            The numbers of transitions, episodes, states and so on, by name; None where
            there is no such number.
        """
        told = self.recording
        least: float | None = None
        largest: float | None = None
        missing: int | None = None
        if self.reward_min is not None and self.reward_max is not None:
            least = float(np.nanmin(self.reward_min))
            largest = float(np.nanmax(self.reward_max))
        if self.reward_count is not None:
            missing = round(float((self.count - self.reward_count).sum()))
        return {
            "transitions": len(self),
            "different": len(self.count),
            "files": told.files or None,
            "episodes": told.episodes or None,
            "episode_length_min": told.shortest or None,
            "episode_length_max": told.longest or None,
            "terminated": round(float(self.count[self.terminated].sum())),
            "truncated": told.truncated,
            "largest_state": int(max(self.state.max(), self.next_state.max())),
            "largest_action": int(self.action.max()),
            "reward_min": least,
            "reward_max": largest,
            "rewards_missing": missing,
            "sampled_episodes": None if self.sample is None else self.sample.n_episodes,
            "broken_episodes": told.broken or None,
            "rows_dropped": told.dropped or None,
            "rows_dropped_of_known_pairs": self.n_dropped_of_pairs or None,
            "why": told.reasons,
        }

    def describe(self) -> str:
        """Return the summary in one line.

        Returns
        -------
        str
            The line, as ``repr`` has it in its parentheses.
        """
        return describe_facts(self.summary())

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the counts to a file with a digest of its contents.

        Parameters
        ----------
        path : path_like
            The file, which ends in .npz.

        See Also
        --------
        load : Read the file.
        """
        arrays: dict[str, Column] = self.columns() | {
            "recording": np.array([int(value) for value in self.recording[:-1]]),
            "reasons": np.array(self.recording.reasons, dtype=np.str_),
        }
        if self.dropped is not None:
            arrays["dropped"] = self.dropped
        sample = {} if self.sample is None else self.sample.columns()
        for name, column in sample.items():
            arrays[f"sample_{name}"] = column
        _files.save_npz(path, KIND, arrays)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> TransitionCounts:
        """Read counts that ``save`` wrote.

        Parameters
        ----------
        path : path_like
            The file.

        Returns
        -------
        TransitionCounts
            The counts.

        Raises
        ------
        ValueError
            If the file is something else, or has changed since; the error names it.
        """
        arrays = _files.load_npz(path, KIND)
        with _files.parts_of(path, "counts"):
            return _from_arrays(arrays)


def holds_counts(path: str | os.PathLike[str]) -> bool:
    """Return whether a file holds counts, from the name of its kind alone."""
    return _files.kind_of(path) == KIND


def _require(values: Array, name: str, is_good: BoolArray, rule: str) -> None:
    """Raise an ArgumentError that names the first bad value."""
    bad = np.flatnonzero(~is_good)
    if bad.size:
        raise ArgumentError(
            f"{name}[{bad[0]}]", f"must be {rule}; it is {values[bad[0]]:g}"
        )


def _check_dropped(dropped: object) -> IntArray | None:
    """Check the rows that were left out, (state, action, number); None for no row."""
    table = _checks.as_array(dropped, "dropped", "integers of shape (L, 3)")
    if table.ndim != 2 or table.shape[1] != 3 or table.dtype.kind not in "iu":
        raise ArgumentError(
            "dropped",
            "must be integers of shape (L, 3), the state, the action and the number of"
            f" rows; it is {table.dtype} of shape {table.shape}",
        )
    least = np.array([0, 0, 1])
    bad = np.argwhere((table < least) | (table > 2**53))
    if len(bad):
        row, column = bad[0].tolist()
        raise ArgumentError(
            f"dropped[{row}, {column}]",
            f"must be in {least[column]}..2**53; it is {table[row, column]}",
        )
    return freeze(table.astype(np.int64)) if len(table) else None


def _check_counted_rewards(columns: dict[str, Column]) -> None:
    """Check the sums, least, largest and numbers of rewards against the counts.

    Fills in the numbers, which are the counts by default.
    """
    count = columns["count"]
    n_paid = columns.setdefault("reward_count", count.copy())
    is_good = (n_paid >= 0) & (n_paid <= count)
    _require(n_paid, "reward_count", is_good, "in [0, count]")
    for name in REWARDS[:3]:
        # least and largest of no reward are nan
        is_absent = (n_paid == 0) & np.isnan(columns[name])
        _checks.require_finite(np.where(is_absent, 0.0, columns[name]), name)


def _require_recording(recording: Recording) -> Recording:
    """Return a recording whose numbers and words are such, or raise an ArgumentError."""
    *numbers, reasons = recording
    for name, value in zip(Recording._fields, numbers, strict=False):
        is_number = _checks.is_integer(value) or isinstance(value, bool | np.bool_)
        if not is_number or not 0 <= value <= 2**53:
            raise ArgumentError(
                f"recording's {name}",
                f"must be an integer in 0..2**53; it is {_checks.show(value)}",
            )
    words = _checks.collection(reasons, "recording's reasons", "texts")
    for k, text in enumerate(words):
        if not isinstance(text, str):
            raise ArgumentError(
                f"recording's reasons[{k}]",
                f"must be a text; it is {_checks.show(text)}",
            )
    return _check_recording(
        np.array([int(value) for value in numbers]), np.array(words, dtype=np.str_)
    )


def _check_recording(numbers: Column, reasons: Column) -> Recording:
    """Return the recording that the arrays of a file hold, or raise an ArgumentError.

    Its words are printed: they hold no control characters.
    """
    n = len(Recording._fields) - 1
    if numbers.shape != (n,) or numbers.dtype.kind not in "iu":
        raise ArgumentError(
            "recording",
            f"must be {n} integers; it is {numbers.dtype} of shape {numbers.shape}",
        )
    values = numbers.tolist()
    told = dict(zip(Recording._fields, values, strict=False))
    for name, value in told.items():
        if not 0 <= value <= 2**53:
            raise ArgumentError(
                f"recording's {name}", f"must be in 0..2**53; it is {value}"
            )
    if told["by_episodes"] > 1:
        raise ArgumentError(
            "recording's by_episodes", f"must be 0 or 1; it is {told['by_episodes']}"
        )
    for name, limit in (("shortest", "longest"), ("broken", "episodes")):
        if told[name] > told[limit]:
            raise ArgumentError(
                f"recording's {name}",
                f"must be at most {limit}, {told[limit]}; it is {told[name]}",
            )
    if reasons.ndim != 1 or len(reasons) > N_REASONS or reasons.dtype.kind not in "UT":
        is_empty = reasons.shape == (0,)
        if not is_empty:
            raise ArgumentError(
                "reasons",
                f"must be at most {N_REASONS} texts; it is {reasons.dtype} of shape"
                f" {reasons.shape}",
            )
    words = tuple(map(str, reasons.tolist()))
    for k, text in enumerate(words):
        if _checks.escape_controls(text) != text:
            raise ArgumentError(
                f"reasons[{k}]",
                f"must be a text without control characters; it is {_checks.show(text)}",
            )
    return Recording._make([bool(values[0]), *values[1:], words])


def _from_arrays(arrays: dict[str, Column]) -> TransitionCounts:
    """Make counts of the parts of their file."""
    parts = {name: column for name, column in arrays.items() if name != _files.KIND}
    recording = _check_recording(parts.pop("recording"), parts.pop("reasons"))
    # files of earlier versions do not have it
    dropped: Any = parts.pop("dropped", None)
    sample = {
        name.removeprefix("sample_"): parts.pop(name)
        for name in list(parts)
        if name.startswith("sample_")
    }
    columns = {
        name: parts.pop(name)
        for name in (*KEY, *COUNTED)
        if name in parts or name not in REWARDS
    }
    if parts:
        raise ArgumentError(
            "it",
            "must hold the parts of counts alone; it has"
            f" {_checks.show(next(iter(parts)))}",
        )
    for name in sample:
        if name not in COLUMNS:
            raise ArgumentError(
                f"sample_{name}", "must be left out: a log has no such column"
            )
    for name in MOVE if sample else ():
        if name not in sample:
            raise ArgumentError(
                f"sample_{name}", "must be a column of the sample; it is missing"
            )
    episodes = Transitions(**sample) if sample else None
    if episodes is not None and (episodes.state_names or episodes.action_names):
        raise ArgumentError("sample", "must be in numbers; it holds names")
    counts = TransitionCounts(
        **columns, recording=recording, sample=episodes, dropped=dropped
    )
    if counts.n_dropped_of_pairs > recording.dropped:
        raise ArgumentError(
            "dropped",
            f"must have at most the {recording.dropped} rows that were left out; it has"
            f" {counts.n_dropped_of_pairs}",
        )
    return counts

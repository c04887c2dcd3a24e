"""Logs of transitions (s, a, s') with rewards, episodes and other optional columns.

Episodes are ragged: a flat table with an episode number for each row, never padded. A
*terminated* transition ends the task (all later rewards are 0); a *truncated* one ends
the recording only, and the task would have continued.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Never, Self

import numpy as np

from oee_tabular import _checks, _printing
from oee_tabular._containers import without_shared_labels
from oee_tabular._keywords import suggest_keywords
from oee_tabular.data import files
from oee_tabular.data.columns import LogColumns
from oee_tabular.data.frames import encode_names, episode_columns, frame_columns
from oee_tabular.data.labels import ColumnsLike, suggest
from oee_tabular.data.rules import (
    COLUMNS,
    MOVE,
    ColumnLike,
    as_objects,
    check_array,
)
from oee_tabular.data.sums import RowSums, counts_of
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import FiniteMDP, Name, NamesLike, name_text, renumber
from oee_tabular.typing import Column, Csr, FrameLike, IntArray, RealArrayLike

if TYPE_CHECKING:
    from oee_tabular.data.opening import open_log


@suggest_keywords
@dataclass(frozen=True, eq=False, repr=False, init=False)
class Transitions(LogColumns):
    """Hold logged transitions (s, a, s', r) of the target.

    The columns are checked when the log is made, and are read-only afterwards.
    ``load`` reads a log from files, ``from_frame`` makes one of a data frame,
    ``from_episodes`` of lists of steps, and ``open`` counts files that memory does not
    hold. Every parameter is also an attribute, ``len(log)`` is the number n of
    transitions, and ``n_episodes`` the number of episodes, or None.

    Parameters
    ----------
    state : array_like of shape (n,)
        The states s_i, integers from 0 or names. Names are texts, or tuples of texts
        and numbers, none of which reads as a number. They are numbered in the order of
        their first appearance (``state_names[state]``); ``numbered(simulator)`` matches
        them to a simulator's, which ``Problem`` and ``transition_ratio`` do by
        themselves.
    action : array_like of shape (n,)
        The actions a_i, by the same rules. They are required, although the signature
        has the default None.
    next_state : array_like of shape (n,)
        The next states s'_i, by the same rules, likewise required.
    reward : array_like of shape (n,), optional
        The finite rewards r_i, nan where one is missing. Without any, ``log.reward`` is
        None.
    terminated : array_like of bool of shape (n,), optional
        Whether the transition ended the task. None means that none did.
    episode : array_like of shape (n,), optional
        The episodes, integers or texts. Rows of one episode are consecutive and in
        order; each row's next_state is the following row's state, and a terminated or
        truncated row is the last of its episode. None means that the transitions are
        independent.
    timestep : array_like of int of shape (n,), optional
        The time t of each row, from 0; within an episode 0, 1, 2, ... (the default
        there).
    behavior_probability : array_like of shape (n,), optional
        The probability in [0, 1] with which the behaviour policy took the recorded
        action.
    truncated : array_like of bool of shape (n,), optional
        Whether the recording stopped after this transition, but not the task. None
        means the last row of every episode that did not terminate.
    state_names : sequence of str or tuple, optional
        The names of the numbers in ``state`` and ``next_state``. None means that they
        are a simulator's numbers.
    action_names : sequence of str or tuple, optional
        The names of the numbers in ``action``. None means a simulator's numbers.

    Raises
    ------
    ValueError
        If a column breaks a rule; the error names the column, the row, the rule and the
        value.

    See Also
    --------
    TransitionCounts : Counts of the transitions of a log that memory does not hold.

    Examples
    --------
    >>> log = Transitions(
    ...     [0, 1, 0],
    ...     [0, 0, 1],
    ...     [1, 2, 0],
    ...     [0.0, 1.0, 0.0],
    ...     terminated=[0, 1, 0],
    ...     episode=[0, 0, 1],
    ... )
    >>> log
    Transitions(3 transitions in 2 episodes of 1 to 2 steps: 1 terminated, 1 truncated;
                states 0..2, actions 0..1; rewards 0 to 1)
    """

    FILES: ClassVar[files.Format] = files.Format()
    ALLOWS_MISSING_REWARDS: ClassVar[bool] = True
    # ``data`` sets it, since what counts files of any size knows logs
    if TYPE_CHECKING:
        open = staticmethod(open_log)
    else:
        open: ClassVar[Callable[..., Any]]

    state: IntArray
    action: IntArray
    next_state: IntArray
    state_names: tuple[Name, ...] | None
    action_names: tuple[Name, ...] | None

    def __init__(
        self,
        state: ColumnLike,
        action: ColumnLike | None = None,
        next_state: ColumnLike | None = None,
        reward: RealArrayLike | None = None,
        *,
        terminated: RealArrayLike | None = None,
        episode: ColumnLike | None = None,
        timestep: RealArrayLike | None = None,
        behavior_probability: RealArrayLike | None = None,
        truncated: RealArrayLike | None = None,
        state_names: NamesLike | None = None,
        action_names: NamesLike | None = None,
    ) -> None:
        if action is None or next_state is None:
            lacking = "action" if action is None else "next_state"
            raise ArgumentError(
                lacking,
                "must be given, (n,) as state (of a data frame:"
                " Transitions.from_frame(frame))",
            )
        given = without_shared_labels(
            {
                "state": state,
                "action": action,
                "next_state": next_state,
                "reward": reward,
                "terminated": terminated,
                "episode": episode,
                "timestep": timestep,
                "behavior_probability": behavior_probability,
                "truncated": truncated,
            }
        )
        (states, following), called = encode_names(
            {name: given.pop(name) for name in ("state", "next_state")},
            state_names,
            "state_names",
        )
        (actions,), acts = encode_names(
            {"action": given.pop("action")}, action_names, "action_names"
        )
        object.__setattr__(self, "state_names", called)
        object.__setattr__(self, "action_names", acts)
        super().__init__(
            states,
            actions,
            following,
            **given,
        )
        for column, names in self._names().items():
            bad = np.flatnonzero(getattr(self, column) >= len(names))
            if bad.size:
                value = getattr(self, column)[bad[0]]
                raise ArgumentError(
                    f"{column}[{bad[0]}]",
                    f"must have a name, of which there are {len(names)}; it is {value}",
                )

    def _names(self) -> dict[str, tuple[Name, ...]]:
        """Return the names of the numbers in each column that has names."""
        names = {
            "state": self.state_names,
            "action": self.action_names,
            "next_state": self.state_names,
        }
        return {column: own for column, own in names.items() if own is not None}

    @staticmethod
    def _moves(
        state: ColumnLike, action: ColumnLike, next_state: ColumnLike
    ) -> dict[str, Column | None]:
        """Check the three columns of numbers of a transition."""
        numbers = {"state": state, "action": action, "next_state": next_state}
        return {name: check_array(column, name) for name, column in numbers.items()}

    def _show(self, state: Column) -> Any:
        """Return one row's state as errors show it, by its name if it has one."""
        if self.state_names is None:
            return state.tolist()
        return name_text(self.state_names, state)

    def columns(self) -> dict[str, Column]:
        """Return the columns that the log has, in the order of the file formats.

        Returns
        -------
        dict of str to ndarray of shape (n,)
            The columns by their labels; states and actions are names where they have
            names.
        """
        names = {column: as_objects(own) for column, own in self._names().items()}
        columns = super().columns()
        return columns | {column: own[columns[column]] for column, own in names.items()}

    @classmethod
    def from_frame(
        cls,
        frame: FrameLike,
        *,
        simulator: FiniteMDP | None = None,
        columns: ColumnsLike | None = None,
        state: Hashable | Sequence[Hashable] | None = None,
        action: Hashable | Sequence[Hashable] | None = None,
        next_state: Hashable | Sequence[Hashable] | None = None,
        reward: Hashable | None = None,
        terminated: Hashable | None = None,
        truncated: Hashable | None = None,
        episode: Hashable | None = None,
        timestep: Hashable | None = None,
        behavior_probability: Hashable | None = None,
        **others: Never,
    ) -> Self:
        """Make a log of a data frame of pandas, polars, arrow, or another library.

        Parameters
        ----------
        frame : FrameLike
            The frame, one transition a row, of any library that narwhals reads. Levels
            of its index that have names are columns; those that a log does not have
            are left out with a warning. Labels of other projects that mean one thing,
            such as ``obs``, are read with a warning, and refused where they may mean
            two things, as ``done``.
        simulator : FiniteMDP, optional
            The model to whose names those of states and actions are matched at once.
            None means that the log keeps the names (``numbered``).
        columns : mapping of str to str, optional
            What the frame calls a log's columns, ``{"state": "place"}``. The keywords
            below say the same; where both name a column, they must agree. None in place
            of a name leaves the column out.
        state : str or sequence of str, optional
            The name of the column of states in the frame, ``"state"`` by default.
            Several names, ``["row", "column"]``, make tuples of their values, which are
            names.
        action : str or sequence of str, optional
            The frame's name, or names, of the column of actions.
        next_state : str or sequence of str, optional
            The frame's name, or names, of the column of next states.
        reward : str, optional
            The frame's name of the column of rewards.
        terminated : str, optional
            The frame's name of the column of terminations.
        truncated : str, optional
            The frame's name of the column of truncations.
        episode : str, optional
            The frame's name of the column of episodes, which may be texts.
        timestep : str, optional
            The frame's name of the column of times.
        behavior_probability : str, optional
            The frame's name of the column of the recorded actions' probabilities.
        **others : Never
            Any other keyword is refused, with the column that it resembles.

        Returns
        -------
        Transitions
            The log.

        Raises
        ------
        ValueError
            If it is no data frame, lacks a column (the error has those present), has a
            row without a value, or has a name that is not the simulator's (the error
            has the nearest one); and where the constructor refuses a column.

        Examples
        --------
        >>> import pandas as pd
        >>> frame = pd.DataFrame(
        ...     [("hall", "go", "dock"), ("hall", "stay", "hall")],
        ...     columns=["place", "action", "to"],
        ... )
        >>> log = Transitions.from_frame(frame, state="place", next_state="to")
        >>> log.state_names, log.next_state.tolist()
        (('hall', 'dock'), [1, 0])
        """
        for keyword in others:
            raise ArgumentError(
                "column_names",
                f"must be of {', '.join(COLUMNS)}; got"
                f" {keyword!r:.80}{suggest(keyword, COLUMNS)}",
            )
        column_names = {
            "state": state,
            "action": action,
            "next_state": next_state,
            "reward": reward,
            "terminated": terminated,
            "truncated": truncated,
            "episode": episode,
            "timestep": timestep,
            "behavior_probability": behavior_probability,
        }
        own = {} if simulator is None else names_by_label(simulator)
        values = frame_columns(frame, column_names, columns, own)
        try:
            log = cls(**values)
        except ValueError:
            # an unknown name says more than the episode that it breaks
            if simulator is not None:
                cls(*(values[label] for label in MOVE)).numbered(simulator, "frame")
            raise
        return log if simulator is None else log.numbered(simulator, "frame")

    @classmethod
    @suggest_keywords
    def from_episodes(
        cls, episodes: Sequence[Sequence[Any]], *, simulator: FiniteMDP | None = None
    ) -> Self:
        """Make a log of episodes that are lists of (state, action, reward) steps.

        Parameters
        ----------
        episodes : list of list of tuple
            The episodes, each a list of steps whose states and actions are numbers or
            names. A step is (state, action, reward): it led to the next step's state.
            An episode ends with its last state, (state,), or (state, terminated) with
            whether the task ended; without it the next state of the last step is
            unknown, and the step is left out with a warning. Steps may also be (state,
            action, reward, next_state), (state, action, reward, next_state,
            terminated), or with truncated after these, as a loop over a Gymnasium
            environment's ``step`` has them: an episode that ends without being
            terminated is truncated.
        simulator : FiniteMDP, optional
            The model to whose names those of the steps are matched at once.

        Returns
        -------
        Transitions
            The log.

        Raises
        ------
        ValueError
            If a step has another form, no next state is known, or the constructor
            refuses a column.

        Examples
        --------
        >>> Transitions.from_episodes(
        ...     [[("hall", "go", -1.0), ("door", "go", 5.0), ("dock", True)]]
        ... )
        Transitions(2 transitions in 1 episode of 2 steps: 1 terminated, 0 truncated;
                    3 named states, 1 named actions; rewards -1 to 5)
        """
        log = cls(**episode_columns(episodes))
        return log if simulator is None else log.numbered(simulator, "episodes")

    def numbered(self, simulator: FiniteMDP, name: str = "log") -> Self:
        """Return the log in the numbers of a simulator's states and actions.

        Parameters
        ----------
        simulator : FiniteMDP
            The model to whose names the log's are matched.
        name : str, default 'log'
            What errors call the log.

        Returns
        -------
        Transitions
            The log in numbers; itself if it has no names.

        Raises
        ------
        ValueError
            If a name is not the simulator's; the error has the first such row and the
            nearest name.
        """
        if not self._names():
            return self
        _checks.instance(simulator, FiniteMDP, "simulator")
        columns = super().columns()
        for column, own in self._names().items():
            names = simulator.state_names
            size = simulator.n_states
            if column == "action":
                names = simulator.action_names
                size = simulator.n_actions
            columns[column] = renumber(
                columns[column],
                own,
                names,
                size,
                f"{name}.{column}",
                self._describe_source,
            )
        log = type(self)(**columns)
        object.__setattr__(log, "_sources", self._sources)
        return log

    def __repr__(self) -> str:
        return f"Transitions({self.describe()})"

    def _repr_html_(self) -> str:
        """Return the summary as HTML, which notebooks show."""
        rows = [
            (name.replace("_", " "), value)
            for name, value in self.summary().items()
            if value is not None
        ]
        return _printing.facts("Transitions: a log", rows)

    def counts(
        self, n_states: int, n_actions: int, *, discount: float | None = None
    ) -> Csr:
        """Count the transitions of each (s, a, s').

        Parameters
        ----------
        n_states : int
            The number S of states.
        n_actions : int
            The number A of actions.
        discount : float, optional
            The discount in [0, 1]. Each transition then has weight discount**timestep,
            the paper's discounted d, for which the log must have timesteps. None means
            weight 1.

        Returns
        -------
        csr_array of shape (S*A, S)
            The counts, in row s*A + a.

        Raises
        ------
        ValueError
            If a state or action is outside the given numbers, the log has names, or it
            has no timesteps to discount by.
        """
        if self._names():
            raise ArgumentError(
                "log",
                "must be in a simulator's numbers to be counted; its states or actions"
                " have names: log.numbered(simulator)",
            )
        weights = np.ones(len(self))
        if discount is not None:
            if self.timestep is None:
                raise ArgumentError(
                    "log",
                    "must have timesteps (or episodes) to be counted with a discount;"
                    " it has none",
                )
            gamma = _checks.number_in(discount, "discount", 0.0, 1.0)
            weights = gamma ** self.timestep.astype(np.float64)
        return counts_of(self, weights, n_states, n_actions)

    def moves(self) -> RowSums:
        """Return each transition with count 1 and its reward.

        Returns
        -------
        RowSums
            The number and the rewards of each row.
        """
        return RowSums.of_transitions(len(self), self.reward)

    @property
    def by_episodes(self) -> bool:
        """Return whether transitions may depend on those before them."""
        return self.episode is not None

    def summary(self) -> dict[str, Any]:
        """Summarise the log's contents as plain numbers.

        Returns
        -------
        dict
            The numbers of transitions, episodes, states and so on, by name; None where
            there is no such number.

        Notes
        -----
        The cost is O(n).
        """
        import pandas as pd

        states = pd.unique(np.concatenate([self.state, self.next_state]))
        pairs = pd.DataFrame(
            {"state": self.state, "action": self.action}
        ).drop_duplicates()
        return self._facts() | {
            "states_seen": len(states),
            "state_action_pairs_seen": len(pairs),
        }

    def _facts(self) -> dict[str, Any]:
        """Return the part of the summary that one line prints."""
        starts = self.episode_starts
        lengths = None if starts is None else np.diff(starts)
        rewards = self.reward
        return {
            "transitions": len(self),
            "episodes": None if lengths is None else len(lengths),
            "episode_length_min": None if lengths is None else int(lengths.min()),
            "episode_length_max": None if lengths is None else int(lengths.max()),
            "terminated": int(self.terminated.sum()),
            "truncated": int(self.truncated.sum()),
            "largest_state": int(max(self.state.max(), self.next_state.max())),
            "largest_action": int(self.action.max()),
            "reward_min": None if rewards is None else float(np.nanmin(rewards)),
            "reward_max": None if rewards is None else float(np.nanmax(rewards)),
            "rewards_missing": None
            if rewards is None
            else int(np.isnan(rewards).sum()),
            "behavior_probability": self.behavior_probability is not None,
        }

    def describe(self) -> str:
        """Return the summary in one line.

        Returns
        -------
        str
            The line, as ``repr`` has it in its parentheses.
        """
        return describe_facts(
            self._facts(), state_names=self.state_names, action_names=self.action_names
        )


def names_by_label(simulator: FiniteMDP) -> dict[str, tuple[Name, ...] | None]:
    """Return the names that a simulator has for the values of a log's columns."""
    _checks.instance(simulator, FiniteMDP, "simulator")
    names = (simulator.state_names, simulator.action_names, simulator.state_names)
    return dict(zip(MOVE, names, strict=True))


def describe_facts(facts: dict[str, Any], **names: tuple[Name, ...] | None) -> str:
    """Return a log's summary in one line.

    ``names`` are those of its states and actions, where they have names.
    """
    text = f"{facts['transitions']} transitions"
    if facts.get("different"):
        text += f", {facts['different']} different"
    if facts.get("files"):
        text += f", of {_count(facts['files'], 'file')}"
    if facts["episodes"]:
        shortest = facts["episode_length_min"]
        longest = facts["episode_length_max"]
        steps = _count(longest, "step")
        if shortest < longest:
            steps = f"{shortest} to {steps}"
        text += f" in {_count(facts['episodes'], 'episode')} of {steps}"
    text += f": {facts['terminated']} terminated, {facts['truncated']} truncated"
    for word, mark in (("state", ";"), ("action", ",")):
        own = names.get(f"{word}_names")
        if own:
            text += f"{mark} {len(own)} named {word}s"
        else:
            text += f"{mark} {word}s 0..{facts[f'largest_{word}']}"
    if facts["reward_min"] is not None:
        # adding 0.0 makes -0.0 plain
        least = facts["reward_min"] + 0.0
        largest = facts["reward_max"] + 0.0
        text += f"; rewards {least:g} to {largest:g}"
        if facts["rewards_missing"]:
            text += f", {facts['rewards_missing']} of {facts['transitions']} missing"
    if facts.get("behavior_probability"):
        text += "; behaviour probabilities"
    if facts.get("sampled_episodes") is not None:
        text += f"; {facts['sampled_episodes']} whole episodes kept"
    if facts.get("rows_dropped"):
        text += (
            f"; {facts['rows_dropped']} invalid rows dropped,"
            f" {facts['broken_episodes'] or 0} episodes broken"
        )
        if facts.get("rows_dropped_of_known_pairs"):
            known = facts["rows_dropped_of_known_pairs"]
            text += f" ({known} of known state and action)"
    elif facts.get("broken_episodes"):
        text += f"; {_count(facts['broken_episodes'], 'episode')} broken"
    return text


def _count(number: int, word: str) -> str:
    """Return a number of things in words, "1 file" or "2 files"."""
    return f"{number} {word}s" if number > 1 else f"{number} {word}"

"""A problem: a simulator and a log of the target, checked together once."""

from __future__ import annotations

import copy
import dataclasses
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, TypeAlias, TypeVar

import numpy as np

from oee_tabular import _checks, _printing
from oee_tabular._keywords import suggest_keywords
from oee_tabular.data import (
    TransitionCounts,
    Transitions,
    Trials,
    has_labels,
    read_log,
    require_fit,
)
from oee_tabular.data.labels import ColumnsLike
from oee_tabular.estimators import findings
from oee_tabular.estimators.findings import Finding
from oee_tabular.estimators.rewards import (
    RewardConflict,
    conflict,
    simulator_rewards,
    with_log_rewards,
)
from oee_tabular.estimators.starts import StartConflict, find_start_conflict
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import (
    FiniteMDP,
    check_policy,
    optional_horizon_length,
    require_available_rows,
    source_of_row,
)
from oee_tabular.ratio import refuse_unsupported
from oee_tabular.ratio.quotient import check_simulator_data
from oee_tabular.ratio.support import checked_counts, without_impossible
from oee_tabular.typing import (
    Array,
    Csr,
    FrameLike,
    IntArray,
    PolicyLike,
    SparseLike,
)

# a log with episodes in any of its forms (``read_log``): a log, a data frame, a path,
# or a list of paths or of episodes
EpisodesLike: TypeAlias = (
    Transitions | FrameLike | str | os.PathLike[str] | Sequence[Any]
)
LogLike: TypeAlias = EpisodesLike | TransitionCounts | SparseLike
LogT = TypeVar("LogT", bound=Transitions | TransitionCounts)
MIN_SHIFTED = 3  # episodes after which next_state may be shifted
_ALLOW = " (to allow them: simulator.with_support_of(log, epsilon))"


@suggest_keywords
@dataclass(frozen=True, eq=False, repr=False)
class Problem:
    """The input of an estimator: a simulator and a log of the target.

    The simulator is a model of the target, the real environment. The log holds
    transitions that were recorded in the target. Both are checked against each other
    when the problem is made. ``oee.evaluate``, ``oee.interval`` and all estimators take
    a problem.

    Parameters
    ----------
    simulator : FiniteMDP
        The simulator.
    log : Transitions, TransitionCounts or their source
        The log of the target. Its source may be a path or a Minari id
        (``Transitions.load``), a data frame (``Transitions.from_frame``), or episodes
        as lists of steps (``Transitions.from_episodes``); names of states and actions
        are matched to the simulator's. Counts are ``TransitionCounts``, their file, or
        a sparse matrix of shape (S*A, S).
    horizon : int, optional
        The number of rewards, at t = 0..horizon-1. None means the infinite discounted
        sum.
    behavior_policy : PolicyLike, optional
        The policy that recorded the log, for importance sampling where the log lacks
        probabilities.
    simulator_data : Transitions or 'exact', optional
        A log of the simulator, or its exact probabilities, for the paper's ratio of
        ratios only.
    rewards : {'simulator', 'log'}, default 'simulator'
        The rewards that off-environment evaluation and the model-based baseline use:
        the simulator's, or the log's mean for each transition that has one (the
        simulator's elsewhere). Importance sampling always uses the log's.
    episodes : Transitions or their source, optional
        Whole episodes for importance sampling, if ``log`` has transitions without
        episodes.
    counts : sparse matrix of shape (S*A, S), optional
        Nonnegative counts that replace the log's in estimators that use counts. They
        may be fractions, such as those of ``Discretization.counts``, but tests and
        intervals need whole numbers. Importance sampling and the paper's ratio of
        ratios still use the log.
    impossible : {'refuse', 'drop'}, default 'refuse'
        What is done with logged transitions whose simulator probability is 0. 'refuse'
        raises an error. 'drop' leaves them out of ``counts``; likelihood and guaranteed
        intervals then allow any next state for them (``inference.asymptotic``).
    columns : mapping of str to str, optional
        What the files or frames of ``log`` and ``episodes`` call a log's columns,
        ``{"state": "pose_before"}`` (``Transitions.load``, ``Transitions.from_frame``).
        It must be left out where both are anything else.
    trials : Trials, optional
        The outcomes of whole runs in the target. ``oee.interval`` and ``oee.evaluate``
        join them with the log (``inference.trials``); estimators use the log alone.

    Raises
    ------
    ValueError
        If states or actions are outside the simulator's; if transitions have simulator
        probability 0 (the first are named); if a terminated transition leads into a
        state that is not terminal in the simulator; if ``rewards`` is "log" and the log
        has none; if counts have another shape, or are negative, not finite, or all 0;
        if the trials have another discount or horizon, or are successes where the
        problem's value is no probability of success.

    See Also
    --------
    Estimator : What evaluates a policy in a problem.
    oee_tabular.evaluate : Evaluate policies by several estimators.

    Notes
    -----
    Terminated transitions in ``log`` are redirected to the simulator's terminal states.
    ``counts`` is csr, without the transitions that were dropped.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator, target = (
    ...     oee.tasks.gridworld(3, slip=0.3),
    ...     oee.tasks.gridworld(3, slip=0.1),
    ... )
    >>> log = oee.sample_episodes(
    ...     target, oee.uniform_policy(target), 20, horizon=30, seed=0
    ... )
    >>> problem = Problem(simulator, log, horizon=30)
    >>> int(problem.counts.sum()) == len(log), problem.reward_conflict is None
    (True, True)
    """

    simulator: FiniteMDP
    log: Transitions | TransitionCounts
    horizon: int | None = None
    behavior_policy: Array | None = None
    simulator_data: Transitions | Literal["exact"] | None = None
    rewards: Literal["simulator", "log"] = "simulator"
    episodes: Transitions | None = None
    _counts: Csr | None = (
        None  # the counts that were given; ``counts`` are those in use
    )
    impossible: Literal["refuse", "drop"] = "refuse"
    trials: Trials | None = None

    def __init__(
        self,
        simulator: FiniteMDP,
        log: LogLike,
        horizon: int | None = None,
        behavior_policy: PolicyLike | None = None,
        simulator_data: Transitions | Literal["exact"] | None = None,
        rewards: Literal["simulator", "log"] = "simulator",
        episodes: EpisodesLike | None = None,
        counts: SparseLike | None = None,
        *,
        impossible: Literal["refuse", "drop"] = "refuse",
        columns: ColumnsLike | None = None,
        trials: Trials | None = None,
        _counts: SparseLike
        | None = None,  # dataclasses.replace passes every field by its name
    ) -> None:
        _checks.instance(simulator, FiniteMDP, "simulator")
        _checks.one_of(impossible, "impossible", ("refuse", "drop"), _ALLOW)
        may_drop = impossible == "drop"
        counts = _counts if counts is None else counts
        if _checks.is_sparse(log):
            log = TransitionCounts.of(
                _check_counts(log, simulator, may_drop=may_drop), simulator.n_actions
            )
        is_log_alone = episodes is None or has_labels(log)
        recorded = read_log(log, simulator, columns=columns if is_log_alone else None)
        whole: Transitions | None = None
        if episodes is not None:
            is_named = has_labels(episodes) or not has_labels(log)
            source = read_log(
                episodes, simulator, "episodes", columns if is_named else None
            )
            whole = _checks.instance(source, Transitions, "episodes", "Transitions")
        _checks.one_of(rewards, "rewards", ("simulator", "log"))
        horizon = optional_horizon_length(horizon, simulator)
        if behavior_policy is not None:
            behavior_policy = check_policy(
                behavior_policy, simulator, name="behavior_policy"
            )
        recorded = settle(recorded, simulator, "log")
        if whole is not None:
            whole = settle(whole, simulator, "episodes")
        check_simulator_data(simulator_data)
        if isinstance(simulator_data, Transitions):
            name = "simulator_data"
            simulator_data = settle(
                simulator_data.numbered(simulator, name), simulator, name
            )
        if rewards == "log" and recorded.moves().reward_sum is None:
            raise ArgumentError(
                "rewards",
                "must be 'simulator' where the log has no reward column; it is 'log'",
            )
        if counts is not None:
            counts = _check_counts(counts, simulator, may_drop=may_drop)
        if trials is not None:
            _checks.instance(trials, Trials, "trials")
            paying = simulator
            if rewards == "log":
                paying = with_log_rewards(simulator, recorded)
            require_fit(trials, paying, horizon)
        fields = (
            simulator,
            recorded,
            horizon,
            behavior_policy,
            simulator_data,
            rewards,
            whole,
            counts,
            impossible,
            trials,
        )
        for field, value in zip(dataclasses.fields(self), fields, strict=True):
            object.__setattr__(self, field.name, value)
        if not simulator.has_all_actions:
            lost = np.flatnonzero(self._unread)
            require_available_rows(simulator, lost, "log", by_row=True)
        if counts is None and not may_drop:
            try:
                refuse_unsupported(self.counts, simulator)
            except ArgumentError as error:
                rule = error.rule + _suggest_shift(recorded)
                raise ArgumentError(error.argument, rule) from None
        if may_drop and self.counts.nnz == 0:
            raise ArgumentError(
                "log",
                "must have a transition that the simulator can make; impossible='drop'"
                " leaves none",
            )

    def __repr__(self) -> str:
        return (
            f"Problem({self.simulator!r}, {self.log!r}, value: sum of discount^t *"
            f" reward over {self._span}, rewards of the {self.rewards})"
        )

    @property
    def _span(self) -> str:
        """Return the times whose rewards count, in words."""
        return "t >= 0" if self.horizon is None else f"t = 0..{self.horizon - 1}"

    def _repr_html_(self) -> str:
        """Return the table that a notebook shows."""
        agreement = "agree"
        if self.reward_conflict is not None:
            agreement = str(self.reward_conflict)
        rows = [
            ("simulator", repr(self.simulator)),
            ("log", self.log.describe()),
            ("rewards", f"the {self.rewards}'s"),
            ("value", f"sum of discount^t * reward over {self._span}, not normalised"),
            ("rewards of log and simulator", agreement),
        ]
        if self.trials is not None:
            rows.append(("trials", self.trials.describe()))
        return _printing.facts("Problem: the value of a policy in the target", rows)

    @property
    def counts(self) -> Csr:
        """Return the counts in use, csr of shape (S*A, S).

        They are those of the log's transitions, or the given ones, without what was
        dropped.
        """
        return self._split_counts[0]

    @property
    def dropped(self) -> Array:
        """Return the number of transitions of each pair that were dropped, (S*A,).

        They are impossible in the simulator, or rows of the log's files that were left
        out although their state and action can be read. Intervals let them lead
        anywhere.
        """
        return self._split_counts[1]

    @cached_property
    def _split_counts(self) -> tuple[Csr, Array]:
        """Return the counts in use, and the number of dropped transitions (S*A,)."""
        counts = self._counts
        if counts is None:
            counts = self.log.counts(self.simulator.n_states, self.simulator.n_actions)
        dropped = self._unread
        if self.impossible == "refuse":
            return counts, dropped
        kept, impossible = without_impossible(counts, self.simulator)
        return kept, impossible + dropped

    @cached_property
    def _unread(self) -> Array:
        """Return the number of rows of each pair that the log's files lost, (S*A,).

        Counts that were given replace the log's, and have none.
        """
        shape = self.simulator.n_states, self.simulator.n_actions
        if self._counts is None and isinstance(self.log, TransitionCounts):
            return self.log.dropped_of_pairs(*shape)
        return np.zeros(shape[0] * shape[1])

    @property
    def observed(self) -> Transitions | Csr:
        """Return the data that a ratio is fitted to: the log, or the counts in use."""
        if self._counts is not None or not isinstance(self.log, Transitions):
            return self.counts
        return self.counts if self.dropped.any() else self.log

    @cached_property
    def cache(self) -> dict[Any, Any]:
        """Return a store that fits to this log share (``Method.fit``)."""
        return {}

    def __getstate__(self) -> dict[str, Any]:
        """Return the state of pickles, which leaves out the store of fits."""
        return {name: value for name, value in vars(self).items() if name != "cache"}

    @cached_property
    def without_trials(self) -> Problem:
        """Return the same problem without trials, which shares the store of fits."""
        if self.trials is None:
            return self
        alone = copy.copy(self)
        object.__setattr__(alone, "trials", None)
        vars(alone)["cache"] = self.cache
        return alone

    @cached_property
    def soft(self) -> bool:
        """Return whether some counts are fractions, which intervals refuse."""
        data = self.counts.data
        return bool((data != np.floor(data)).any())

    @property
    def recorded(self) -> Any:
        """Return the log with whole episodes.

        It is ``episodes``, the sample beside counts, or the log itself.
        """
        kept = self.log.sample if isinstance(self.log, TransitionCounts) else None
        return self.episodes or kept or self.log

    @cached_property
    def model(self) -> FiniteMDP:
        """Return the simulator, with the log's rewards if ``rewards`` is "log"."""
        if self.rewards == "simulator":
            return self.simulator
        return with_log_rewards(self.simulator, self.log)

    @cached_property
    def reward_conflict(self) -> RewardConflict | None:
        """Return where the rewards of log and simulator differ.

        It is None if they agree, or if the log has none.
        """
        return conflict(self.simulator, self.log)

    @cached_property
    def start_conflict(self) -> StartConflict | None:
        """Return where the log's episodes begin otherwise than the simulator's.

        It is None if they agree, or if the log has no episodes.
        """
        return find_start_conflict(self.recorded, self.simulator)

    @cached_property
    def behavior_conflict(self) -> int:
        """Return the number of transitions that contradict ``behavior_policy``.

        The log's own behaviour probability differs there.
        """
        log = self.recorded
        if self.behavior_policy is None or log.behavior_probability is None:
            return 0
        given = self.behavior_policy[log.state, log.action]
        return int(np.sum(np.abs(given - log.behavior_probability) > 1e-6))

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Return the warnings about the data, which concern every policy."""
        log = self.log
        result = list[Finding]()
        if self.start_conflict is not None:
            state = self.simulator.names.state(self.start_conflict.state)
            result.append(findings.starts_contradict(state, *self.start_conflict[1:]))
        if self.reward_conflict is not None:
            result.append(
                findings.rewards_contradict(
                    self.reward_conflict,
                    log_pays=self.rewards == "log",
                    is_rounding=self.reward_conflict.is_rounding,
                )
            )
        result += findings.behavior_contradicts(self.behavior_conflict)
        if isinstance(log, TransitionCounts):
            lost = self._unread
            result += findings.rows_dropped(
                log.recording.dropped, log.recording.reasons, lost, len(log)
            )
            kept = 0 if log.sample is None else log.sample.n_episodes or 0
            result += findings.episodes_sampled(kept, log.recording.episodes)
        result += findings.moves_dropped(
            self.dropped - self._unread, float(self.counts.sum())
        )
        if self.simulator.sampling is not None:
            result.append(findings.SAMPLED)
        return tuple(result)

    def rewards_of(self, log: Transitions) -> Array:
        """Return the rewards of a log, or the simulator's where it has none.

        Parameters
        ----------
        log : Transitions
            The log, or some of its rows.

        Returns
        -------
        ndarray of shape (n,)
            The reward of each row.
        """
        _checks.instance(log, Transitions, "log", "Transitions")
        if log.reward is not None and not np.isnan(log.reward).any():
            return log.reward
        simulated = simulator_rewards(self.simulator, log)
        if log.reward is None:
            return simulated
        return np.where(np.isnan(log.reward), simulated, log.reward)


def require_policy(problem: object, policy: PolicyLike) -> Array:
    """Check a problem and a policy of it, and return the policy's array (S, A)."""
    return check_policy(policy, _checks.instance(problem, Problem, "problem").simulator)


def settle(log: LogT, simulator: FiniteMDP, name: str) -> LogT:
    """Redirect terminated transitions to the simulator's terminal states.

    A log that does not fit the simulator is a ValueError that names ``name``.
    """
    sizes = {
        "state": simulator.n_states,
        "action": simulator.n_actions,
        "next_state": simulator.n_states,
    }
    for column, size in sizes.items():
        values: IntArray = getattr(log, column)
        bad = np.flatnonzero(values >= size)
        if bad.size:
            rule = (
                f"must be in 0..{size - 1}, the simulator's; it is {values[bad[0]]}"
                f" ({bad.size} such transitions)"
            )
            if values.max() == size and values.min() >= 1:
                rule += "; are they numbered from 1? Then subtract 1"
            row = int(bad[0])
            place = f"{name}.{column}[{row}]{source_of_row(log, row)}"
            raise ArgumentError(place, rule)
    if not simulator.has_all_actions:
        rows = log.state * simulator.n_actions + log.action
        require_available_rows(simulator, rows, name)
    lead = np.arange(simulator.n_states)
    lead[: len(simulator.terminal_state)] = simulator.terminal_state
    arrival = np.where(log.terminated, lead[log.next_state], log.next_state)
    going_on = np.flatnonzero(log.terminated & ~simulator.absorbing()[arrival])
    if going_on.size:
        row = int(going_on[0])
        where = simulator.names.state(arrival[row])
        raise ArgumentError(
            f"{name}.terminated[{row}]{source_of_row(log, row)}",
            f"must be False, or state {where} must be terminal in the simulator (every"
            f" action leads back to it with reward 0); it is not ({going_on.size} such"
            " transitions). If a time limit cut the log's episodes there, mark them"
            " truncated instead; if the task ends there, make the state terminal,"
            f" P[{arrival[row]}] = 0; P[{arrival[row]}, :, {arrival[row]}] = 1 with"
            " reward 0, or say where termination leads with FiniteMDP(...,"
            f" terminal_state=){_suggest_shift(log)}",
        )
    if isinstance(log, TransitionCounts) and log.sample is not None:
        log = replace(log, sample=settle(log.sample, simulator, f"{name}.sample"))
    if np.array_equal(arrival, log.next_state):
        return log
    return replace(log, next_state=arrival)


def _suggest_shift(log: Transitions | TransitionCounts) -> str:
    """Return a sentence where next states are those of the next episode, or ""."""
    if not isinstance(log, Transitions) or log.episode_starts is None:
        return ""
    first = log.episode_starts[1:-1]
    is_shifted = log.next_state[first - 1] == log.state[first]
    n_shifted = int(is_shifted.sum())
    if len(first) < MIN_SHIFTED or n_shifted < 0.9 * len(first):
        return ""
    return (
        f". In {n_shifted} of the {len(first)} places where an episode ends, next_state"
        " is the state of the next row, which is of another episode: was next_state made"
        " by shifting state by one row? Then the last next_state of each episode is"
        " wrong: write where it led, or leave the field empty and count the log with"
        " Transitions.open(..., bad_rows='drop') (oee counts --bad-rows drop)"
    )


def _check_counts(counts: Any, simulator: FiniteMDP, *, may_drop: bool) -> Csr:
    """Check counts that were given, and return them as csr of shape (S*A, S)."""
    matrix = checked_counts(counts, simulator)
    if may_drop:
        return matrix
    if matrix.nnz == 0:
        raise ArgumentError("counts", "must have at least one transition; all are 0")
    refuse_unsupported(matrix, simulator, what="counts")
    return matrix

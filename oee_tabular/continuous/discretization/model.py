"""Finite MDPs of continuous tasks, with the encoding of continuous states and logs."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from typing import Any, Literal, TypeAlias

import numpy as np

from oee_tabular import _checks, _files
from oee_tabular._parallel import one_thread
from oee_tabular._results import checked
from oee_tabular._sparse import canonical, check_csr, row_of_entry
from oee_tabular.continuous.discretization.cells import (
    Grid,
    Places,
    VoronoiCells,
    indicator,
    spread_over_pairs,
)
from oee_tabular.continuous.log.numbering import number_actions
from oee_tabular.continuous.log.transitions import ContinuousTransitions
from oee_tabular.continuous.task.base import (
    ContinuousTask,
    StatePolicy,
    check_probabilities,
    check_states,
)
from oee_tabular.continuous.task.episodes import monte_carlo_value
from oee_tabular.data import Transitions
from oee_tabular.exceptions import ArgumentError, DataWarning
from oee_tabular.mdp import KIND, FiniteMDP, check_policy
from oee_tabular.typing import Array, BoolArray, Csr, IntArray, RealArrayLike, Seed

OUTSIDE = ("error", "nearest", "drop")
Outside: TypeAlias = Literal["error", "nearest", "drop"]
N_RISK_STEPS = 300  # of EM: weights of mixtures change by less than 1e-3 later


@checked()
@dataclass(frozen=True, eq=False, repr=False)
class Discretization:
    """A FiniteMDP made from a continuous task, with the encoding that belongs to it.

    ``discretize`` makes it.

    Attributes
    ----------
    mdp : FiniteMDP
        One state for each cell and last, where episodes can end, the terminal one.
    task : ContinuousTask
        The task whose states are encoded.
    places : Places
        The cells, and where the task was stepped.
    simulators : tuple of FiniteMDP
        The MDPs of the task without a floor, and of each of the ``others``.
    metadata : dict
        How it was made, in plain numbers and words.
    diagnostics : dict
        The ``closure_error`` and ``closure_standard_error`` of the uniform policy,
        where they were measured, both relative to its value.

    Examples
    --------
    >>> from oee_tabular.tasks import CartPole, cartpole_policy, discretize, record
    >>> model = discretize(CartPole(10.0), cells=(32, 32), closure_episodes=0)
    >>> log = record(
    ...     CartPole(15.0),
    ...     cartpole_policy(0.3),
    ...     n_transitions=500,
    ...     max_steps=100,
    ...     seed=0,
    ... )
    >>> encoded = model.encode(log, seed=0)
    >>> (
    ...     len(encoded),
    ...     model.policy(cartpole_policy(0.3)).shape,
    ...     round(float(model.counts(log).sum()), 6),
    ... )
    (500, (1025, 2), 500.0)
    """

    mdp: FiniteMDP
    task: ContinuousTask
    places: Places
    simulators: tuple[FiniteMDP, ...]
    metadata: dict[str, Any] = field(default_factory=dict)
    diagnostics: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check that the task is that of the MDP."""
        if self.task.n_actions != self.mdp.n_actions:
            raise ArgumentError(
                "task",
                f"must have the MDP's {self.mdp.n_actions} actions;"
                f" {_checks.show(self.task.name)} has {self.task.n_actions}",
            )

    def __repr__(self) -> str:
        """Describe task, cells and MDP in one line."""
        settings = ", ".join(
            f"{name}={value}" for name, value in self.task.parameters().items()
        )
        return (
            f"Discretization({self.task.name}({settings}): {self.cells.extent()};"
            f" {self.mdp})"
        )

    @property
    def cells(self) -> Grid | VoronoiCells:
        """Return the cells in which the states lie."""
        return self.places.cells

    @property
    def points(self) -> Array:
        """Return states (p, d) that stand for the cells."""
        return self.places.points

    @property
    def plain(self) -> FiniteMDP:
        """Return the task on the cells without a floor."""
        return self.simulators[0]

    @property
    def over(self) -> int | None:
        """Return the number of the terminal state, None where episodes do not end."""
        return self.cells.n_cells if self.task.terminates else None

    def policy(self, policy: StatePolicy | Array, name: str = "policy") -> Array:
        """Return a policy's probabilities in each numbered state.

        Parameters
        ----------
        policy : function or ndarray of shape (S, A)
            A function of states (n, d) giving probabilities (n, A), of which the mean
            over the points of each cell is taken; or probabilities on the cells, which
            are checked as ``Problem`` checks them and may leave out the terminal state.
        name : str, default 'policy'
            The name of the argument in errors.

        Returns
        -------
        ndarray of shape (S, A)
            The probabilities; uniform in the terminal state.

        Raises
        ------
        ValueError
            If they are no probabilities of the task's actions.
        """
        n_actions = self.task.n_actions
        if callable(policy):
            array = self.places.mean(
                check_probabilities(policy, self.points, n_actions)
            )
            array /= array.sum(axis=1, keepdims=True)
        else:
            array = _checks.float_array(policy, name, ndim=(2,))
        if self.over is not None and array.shape == (self.cells.n_cells, n_actions):
            array = np.concatenate([array, np.full((1, n_actions), 1.0 / n_actions)])
        return array if callable(policy) else check_policy(array, self.mdp, name=name)

    def policy_function(self, table: Array) -> StatePolicy:
        """Return a policy of states from one on the cells.

        Parameters
        ----------
        table : ndarray of shape (S, A)
            The probabilities on the cells.

        Returns
        -------
        function
            Of states (n, d) it gives probabilities (n, A): the mean over the cells that
            a state is shared out to.
        """
        array = _checks.float_array(table, "table", ndim=2)
        if len(array) < self.cells.n_cells:
            raise ArgumentError(
                "table",
                f"must have a row for each of {self.cells.n_cells} cells; it has"
                f" shape {array.shape}",
            )
        inner = array[: self.cells.n_cells]

        def interpolated(states: Array) -> Array:
            """Return the mean of the table's rows over the cells of each state."""
            weights = self.cells.weights(self.task.features(states))
            found = np.asarray(weights @ inner)
            return np.asarray(found / found.sum(axis=1, keepdims=True))

        return interpolated

    def closure_error(
        self,
        policy: StatePolicy | None = None,
        *,
        horizon: int = 100,
        n_episodes: int = 2000,
        seed: Seed = 0,
    ) -> tuple[float, float]:
        """Measure by how much the cells change the value of a policy.

        Parameters
        ----------
        policy : function, optional
            The policy: of states (n, d) it gives probabilities (n, A). By default it is
            uniform.
        horizon : int, default 100
            The number of rewards.
        n_episodes : int, default 2000
            The number of Monte Carlo episodes in the task.
        seed : int, Generator or SeedSequence, optional
            The source of Monte Carlo's random numbers, by default 0.

        Returns
        -------
        error : float
            (J on the cells - J in the task) / scale.
        standard_error : float
            Its standard error, by Monte Carlo.

        Notes
        -----
        The scale is abs(J in the task), or the standard deviation of a return if that
        is larger (for returns that change sign).
        """
        # what it compiles with is imported only here
        from oee_tabular.exact import policy_value

        chosen = uniform_policy_of(self.task) if policy is None else policy
        mc = monte_carlo_value(
            self.task,
            chosen,
            n_episodes,
            horizon,
            discount=self.mdp.discount,
            seed=seed,
        )
        value = policy_value(self.plain, self.policy(chosen), horizon=horizon)
        scale = max(abs(mc.value), mc.deviation, np.finfo(float).tiny)
        return (value - mc.value) / scale, mc.standard_error / scale

    def mixture(self, weights: Sequence[float] | Array) -> Discretization:
        """Return the same states with the simulator sum_k w_k P_k of ``simulators``.

        Parameters
        ----------
        weights : array_like of shape (len(simulators),)
            Nonnegative weights that sum to 1.

        Returns
        -------
        Discretization
            The same but for its ``mdp``.

        Raises
        ------
        ValueError
            If there are not as many weights as simulators, or they are negative or do
            not sum to 1.
        """
        shares = _checks.distribution(weights, "weights", (len(self.simulators),))
        pairs = zip(shares, self.simulators, strict=True)
        used = [(share, part) for share, part in pairs if share > 0.0]
        rewards = np.sum([share * part.rewards for share, part in used], axis=0)
        transitions = sum(share * part.transitions for share, part in used)
        return replace(self, mdp=self.with_transitions(transitions, rewards))

    def with_transitions(
        self, transitions: Csr, rewards: Array | None = None
    ) -> FiniteMDP:
        """Return an MDP on the same states with other transitions, wherever they lead.

        Parameters
        ----------
        transitions : csr array of shape (S * A, S)
            The transition probabilities.
        rewards : ndarray of shape (S, A), optional
            The rewards; by default the task's.

        Returns
        -------
        FiniteMDP
            The MDP.
        """
        plain = self.plain
        transitions = check_csr(transitions, "transitions")
        chosen = plain.rewards if rewards is None else rewards
        return self.places.finite_mdp(
            self.task, transitions, chosen, plain.initial, plain.discount
        )

    @one_thread
    def fit_weights(self, counts: Csr) -> Array:
        """Fit weights of ``simulators`` that minimise the KL risk of counts.

        Parameters
        ----------
        counts : csr array of shape (S * A, S)
            The counts of the log, with support in some simulator.

        Returns
        -------
        ndarray of shape (len(simulators),)
            The weights w, nonnegative, summing to 1.

        Raises
        ------
        ValueError
            If none of the simulators allows a transition of the counts.

        Notes
        -----
        The risk is -sum_x n_x log sum_k w_k P_k(x); the mixture is zeta within the
        simulators' hull. It is convex in w, and each step of EM decreases it. A
        simulator with the target's parameters is found where the log is long: this is
        system identification, stated as a ratio.
        """
        entries = self._require_counts(counts).tocoo()
        if not entries.data.sum() > 0.0:
            raise ArgumentError("counts", "must have a transition; they have none")
        rows, columns = entries.coords
        parts = [part.transitions[rows, columns] for part in self.simulators]
        table = np.stack([np.asarray(part).ravel() for part in parts], axis=1)
        impossible = np.flatnonzero(table.sum(axis=1) == 0.0)
        if impossible.size:
            s, a = divmod(int(entries.coords[0][impossible[0]]), self.task.n_actions)
            raise ArgumentError(
                "counts",
                f"must have transitions that some simulator allows; ({s}, {a},"
                f" {entries.coords[1][impossible[0]]}) is allowed by none"
                f" ({impossible.size} such transitions in all)",
            )
        weights = np.full(table.shape[1], 1.0 / table.shape[1])
        for _ in range(N_RISK_STEPS):
            share = table * weights
            share /= share.sum(axis=1, keepdims=True)
            weights = entries.data @ share / entries.data.sum()
        return np.asarray(weights)

    def encode_states(
        self,
        states: RealArrayLike,
        *,
        seed: Seed = None,
        outside: Literal["error", "nearest"] = "error",
    ) -> IntArray:
        """Return the number of each state.

        Parameters
        ----------
        states : array_like of shape (n, d)
            Finite numbers.
        seed : int, Generator or SeedSequence, optional
            Without one, each state has the number with the largest weight; with one, it
            is drawn by the weights, so that the mean over draws is the interpolation.
        outside : {'error', 'nearest'}, default 'error'
            What is done with states outside the cells: an error that names and counts
            them, or the nearest place with a warning.

        Returns
        -------
        ndarray of int, shape (n,)
            The numbers.

        Raises
        ------
        ValueError
            If states lie outside the cells and ``outside`` is 'error'.
        """
        _checks.one_of(outside, "outside", OUTSIDE[:2])
        array = check_states(self.task, states)
        ended = self.task.terminated(array) & self.task.end_shows(array)
        self._outside(array, ended, "states", outside)
        draws = None if seed is None else _checks.generator(seed).random(len(array))
        return _pick(self.places.weights(self.task, array, ended), draws)

    def encode(
        self,
        log: ContinuousTransitions,
        *,
        seed: Seed = None,
        outside: Outside = "error",
    ) -> Transitions:
        """Return the log with numbered states and actions, ready for ``Problem``.

        Parameters
        ----------
        log : ContinuousTransitions
            A log of the task's states.
        seed : int, Generator or SeedSequence, optional
            As in ``encode_states``; each state that episodes pass through is drawn
            once.
        outside : {'error', 'nearest', 'drop'}, default 'error'
            What is done with rows that have a state outside the cells: an error that
            names and counts them, the nearest place, or to leave them out (the rest is
            then a bag without episodes); both of the latter with a warning.

        Returns
        -------
        Transitions
            The encoded log.

        Raises
        ------
        ValueError
            If the log has other dimensions than the task, or actions or states that the
            task does not know.
        """
        kept, actions, ended = self._select_rows(log, outside)
        draws: Any = (None, None)
        episode = np.arange(len(kept)) if kept.episode is None else kept.episode
        # rows whose next state is the next row's state
        same = np.flatnonzero(episode[1:] == episode[:-1])
        if seed is not None:
            draws = _checks.generator(seed).random((len(kept), 2)).T
            draws[1, same] = draws[0, same + 1]
        before = self.places.weights(self.task, kept.state, np.zeros_like(ended))
        after = self.places.weights(self.task, kept.next_state, ended)
        first = _pick(before, draws[0])
        following = _pick(after, draws[1])
        # float32 copies of one state may lie on two sides of an edge
        first[same + 1] = following[same]
        columns = kept.columns() | {
            "state": first,
            "action": actions,
            "next_state": following,
            "terminated": ended,
        }
        columns["truncated"] = (kept.truncated | kept.terminated) & ~ended
        return Transitions(**columns)

    def counts(self, log: ContinuousTransitions, *, outside: Outside = "error") -> Csr:
        """Compute soft counts n(s, a, s') of a log.

        Parameters
        ----------
        log : ContinuousTransitions
            A log of the task's states.
        outside : {'error', 'nearest', 'drop'}, default 'error'
            What is done with rows that have a state outside the cells, as in
            ``encode``.

        Returns
        -------
        csr array of shape (S * A, S)
            The counts, sum over rows of w_s(state) w_s'(next_state); they sum to the
            number of rows.

        Raises
        ------
        ValueError
            As in ``encode``.

        Notes
        -----
        They are the mean of ``encode(...).counts(...)`` over draws, without their
        noise. On a grid, where a command moves the features alike everywhere, a
        transition is carried to the vertex i of its box, and spread as the simulator's
        rows are: w_j(vertex_i + phi(s') - phi(s)).
        """
        kept, actions, ended = self._select_rows(log, outside)
        task = self.task
        cells = self.cells
        if task.is_translation_invariant and isinstance(cells, Grid):
            before = task.features(kept.state)
            after = task.features(kept.next_state)
            number = _pick(cells.weights(before), None)
            start = indicator(number, cells.n_cells)
            arrival = cells.weights(cells.vertices()[number] + after - before)
        else:
            start = self.places.weights(task, kept.state, np.zeros_like(ended))
            arrival = self.places.weights(task, kept.next_state, ended)
        pairs = spread_over_pairs(start, actions, task.n_actions)
        return canonical(pairs.T @ arrival, drop_zeros=True)

    def supported(self, counts: Csr) -> tuple[Csr, float]:
        """Return the counts where ``mdp`` has probability, and the others' share.

        Parameters
        ----------
        counts : csr array of shape (S * A, S)
            The counts.

        Returns
        -------
        kept : csr array of shape (S * A, S)
            The counts with support.
        share : float
            The share of the counts without support, to be reported with what is made of
            them.
        """
        matrix = canonical(self._require_counts(counts), drop_zeros=True)
        has_probability = self.mdp.transitions.astype(np.bool_)
        kept = canonical(matrix.multiply(has_probability), drop_zeros=True)
        total = float(matrix.data.sum())
        share = 1.0 - float(kept.data.sum()) / total if total > 0 else 0.0
        return kept, share

    def _require_counts(self, counts: object) -> Csr:
        """Require counts of the transitions of ``mdp``, and return them as csr."""
        matrix = check_csr(counts, "counts")
        if matrix.shape != self.mdp.transitions.shape:
            raise ArgumentError(
                "counts",
                f"must have shape {self.mdp.transitions.shape}; it has shape"
                f" {matrix.shape}",
            )
        _checks.require_nonnegative(matrix.data, "counts.data")
        return matrix

    def displacement_ties(self) -> IntArray:
        """Return a tie for each entry of ``mdp.transitions``.

        Returns
        -------
        ndarray of int, shape (nnz,)
            The ties, for ``transition_ratio(tie=...)``; entries with the same number
            share one ratio.

        Raises
        ------
        ValueError
            If the cells are no grid, or episodes can end.

        Notes
        -----
        The displacement is how many cells along each axis a transition leads. It serves
        tasks whose commands move the features alike everywhere.
        """
        grid = self.cells
        matrix = self.mdp.transitions
        if not isinstance(grid, Grid) or self.over is not None:
            raise ArgumentError(
                "cells",
                "must be a grid without an absorbing state to tie displacements; they"
                f" are {grid.extent()}",
            )
        first, action = np.divmod(row_of_entry(matrix), self.task.n_actions)
        places = grid.indices()
        apart = places[matrix.indices] - places[first] + grid.shape
        sizes = (self.task.n_actions, *(2 * n for n in grid.shape))
        return np.asarray(np.ravel_multi_index((action, *apart.T), sizes))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the MDP as ``FiniteMDP.load`` reads it, with the metadata as JSON.

        Parameters
        ----------
        path : str or path-like
            The file, .npz.
        """
        metadata = json.dumps(self.metadata | {"version": version("oee-tabular")})
        _files.save_npz(
            path, KIND, self.mdp.arrays() | {"metadata": np.array(metadata)}
        )

    def _select_rows(
        self, log: ContinuousTransitions, outside: Outside
    ) -> tuple[ContinuousTransitions, IntArray, BoolArray]:
        """Return the rows that can be encoded, their actions, and which ones end."""
        _checks.one_of(outside, "outside", OUTSIDE)
        task = self.task
        actions = number_actions(task, log)
        ended = log.terminated | task.terminated(log.next_state)
        if not task.terminates and log.terminated.any():
            row = int(log.terminated.argmax())
            raise ArgumentError(
                f"log.terminated[{row}]",
                f"must be False: episodes of {task.name} do not end; it is True",
            )
        before = np.flatnonzero(task.terminated(log.state))
        if before.size and task.terminates:
            raise ArgumentError(
                f"log.state[{before[0]}]",
                f"must be a state in which {task.name} goes on; it is over in"
                f" {log.state[before[0]].tolist()} ({before.size} such rows in all)",
            )
        hidden = np.flatnonzero(
            ended & ~task.end_shows(log.next_state) & task.terminates
        )
        if hidden.size:
            _checks.warn(
                f"log.terminated: {hidden.size} of {int(ended.sum())} ends do not show"
                f" in the features ({', '.join(task.feature_names)}); the first, row"
                f" {hidden[0]}, leads to {log.next_state[hidden[0]].tolist()}. They are"
                " taken as truncated, the process going on",
                DataWarning,
            )
        ended[hidden] = False
        gone = self._outside(log.state, np.zeros_like(ended), "log.state", outside)
        gone |= self._outside(log.next_state, ended, "log.next_state", outside)
        if outside != "drop" or not gone.any():
            return log, actions, ended
        if gone.all():
            raise ArgumentError(
                "outside",
                "must not be 'drop' where every row is outside; nothing would be left",
            )
        return log.select(~gone), actions[~gone], ended[~gone]

    def _outside(
        self, states: Array, ended: BoolArray, name: str, outside: Outside
    ) -> BoolArray:
        """Return which states that are not terminal lie outside the cells.

        An error or a warning counts them.
        """
        features = self.task.features(states)
        gone = self.cells.outside(features) & ~ended
        rows = np.flatnonzero(gone)
        if rows.size:
            pairs = zip(self.task.feature_names, features[rows[0]], strict=True)
            place = ", ".join(f"{feature}={value:.4g}" for feature, value in pairs)
            rule = (
                f"must be inside {self.cells.extent()}: {rows.size} of {len(states)}"
                f" rows are not; the first, row {rows[0]}, is at {place}. "
            )
            if outside == "error":
                raise ArgumentError(
                    name,
                    f"{rule}A wider grid, or outside='nearest' or 'drop' (--task-option"
                    " outside=), takes them",
                )
            done = "moved to the nearest place inside"
            if outside == "drop":
                done = "left out"
            _checks.warn(f"{name} {rule}They are {done}", DataWarning)
        return np.asarray(gone)


def uniform_policy_of(task: ContinuousTask) -> StatePolicy:
    """Return the policy that gives every action the same probability."""
    return lambda states: np.full((len(states), task.n_actions), 1.0 / task.n_actions)


def _pick(weights: Csr, draws: Array | None) -> IntArray:
    """Return a state number for each row of weights.

    It is the heaviest, or the one that a uniform number (n,) picks.
    """
    low = weights.indptr[:-1]
    width = np.diff(weights.indptr)
    table = np.zeros((len(width), int(width.max(initial=1))))
    table[np.arange(table.shape[1]) < width[:, None]] = weights.data
    if draws is None:
        pick = table.argmax(axis=1)
    else:
        running = np.cumsum(table, axis=1)
        level = (draws * running[:, -1])[:, None]
        pick = np.minimum((running <= level).sum(axis=1), width - 1)
    return np.asarray(weights.indices[low + pick], dtype=np.int64)

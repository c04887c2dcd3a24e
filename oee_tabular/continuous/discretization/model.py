"""A continuous task as a FiniteMDP, with the way from continuous states and logs to its numbered states."""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from typing import Any

import numpy as np
from scipy import sparse

from oee_tabular import _checks, _files
from oee_tabular._checks import Array, BoolArray, IntArray, Seed
from oee_tabular._sparse import canonical, csr_on_pattern, find, row_of_entry, row_sums
from oee_tabular._threads import one_thread
from oee_tabular.continuous.discretization.grid import Grid
from oee_tabular.continuous.discretization.places import Places, weights_of
from oee_tabular.continuous.episodes import monte_carlo_value
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.task import ContinuousTask, StatePolicy, check_probabilities, check_states, require_log_of
from oee_tabular.data import Transitions
from oee_tabular.mdp import FiniteMDP, check_policy
from oee_tabular.mdp.finite_mdp import KIND

OUTSIDE = ("error", "nearest", "drop")
POINTS_AT_A_TIME = 100_000  # bounds the memory
N_RISK_STEPS = 300  # of EM: weights of mixtures change by less than 1e-3 later


@dataclass(frozen=True, eq=False, repr=False)
class Discretization:
    """A FiniteMDP made from a continuous task by ``discretize``, with the encoding that belongs to it.

    Attributes
    ----------
    mdp : FiniteMDP with one state for each cell and last, where episodes can end, the one that is over
    task : ContinuousTask whose states are encoded
    places : the cells, and where the task was stepped
    simulators : FiniteMDPs of the task without a floor, and of each of the ``others``
    weights : how the simulators are mixed in ``mdp``
    metadata : how it was made: plain numbers and words
    diagnostics : ``closure_error`` and ``closure_standard_error`` of the uniform policy, where measured

    Examples
    --------
    >>> from oee_tabular.tasks import CartPole, cartpole_policy, discretize, record
    >>> model = discretize(CartPole(10.0), cells=(32, 32), closure_episodes=0)
    >>> log = record(CartPole(15.0), cartpole_policy(0.3), n_transitions=500, max_steps=100, seed=0)
    >>> encoded = model.encode(log, seed=0)
    >>> len(encoded), model.policy(cartpole_policy(0.3)).shape, round(float(model.counts(log).sum()), 6)
    (500, (1025, 2), 500.0)
    """

    mdp: FiniteMDP
    task: ContinuousTask
    places: Places
    simulators: tuple[FiniteMDP, ...]
    weights: tuple[float, ...]
    metadata: dict[str, Any] = field(default_factory=dict)
    diagnostics: dict[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        settings = ", ".join(f"{name}={value}" for name, value in self.task.parameters().items())
        return f"Discretization({self.task.name}({settings}): {self.cells.extent()}; {self.mdp})"

    @property
    def cells(self) -> Any:
        """Where the states lie."""
        return self.places.cells

    @property
    def points(self) -> Array:
        """(p, d) states that stand for the cells."""
        return self.places.points

    @property
    def plain(self) -> FiniteMDP:
        """The task on the cells without a floor."""
        return self.simulators[0]

    @property
    def over(self) -> int | None:
        """The number of the absorbing state in which episodes end, None where they do not."""
        return self.cells.n_cells if self.task.terminates else None

    # ---- policies and values --------------------------------------------------------------------------------------

    def policy(self, policy: StatePolicy | Array, name: str = "policy") -> Array:
        """(S, A) a policy function in each state: its mean over the points of the cell; uniform where it is over.

        An array is looked at as ``Problem`` looks at it; it may leave out the state that is over.
        """
        n_actions = self.task.n_actions
        if not callable(policy):
            array = _checks.float_array(policy, name, ndim=(2,))
            if self.over is not None and array.shape == (self.cells.n_cells, n_actions):
                array = np.concatenate([array, np.full((1, n_actions), 1.0 / n_actions)])
            return check_policy(array, self.mdp, name=name)
        table = np.full((self.mdp.n_states, n_actions), 1.0 / n_actions)
        total = np.zeros((self.cells.n_cells, n_actions))
        for low in range(0, len(self.points), POINTS_AT_A_TIME):
            part = slice(low, low + POINTS_AT_A_TIME)
            at_points, cell = check_probabilities(policy, self.points[part], n_actions), self.places.point_cell[part]
            for a in range(n_actions):
                total[:, a] += np.bincount(cell, at_points[:, a], self.cells.n_cells)
        table[: self.cells.n_cells] = total
        return np.asarray(table / table.sum(axis=1, keepdims=True))

    def policy_function(self, table: Array) -> StatePolicy:
        """A policy of states from one on the cells: its mean over the cells that a state is shared out to."""
        inner = np.asarray(table, dtype=np.float64)[: self.cells.n_cells]

        def interpolated(states: Array) -> Array:
            found = self.cells.weights(self.task.features(states)) @ inner
            return np.asarray(found / found.sum(axis=1, keepdims=True))

        return interpolated

    def closure_error(
        self, policy: StatePolicy | None = None, *, horizon: int = 100, n_episodes: int = 2000, seed: Seed = 0
    ) -> tuple[float, float]:
        """What discretising costs: (J on the cells - J in the task) / scale, and its standard error.

        J is the value of ``policy`` (default: uniform), in the task by Monte Carlo. The scale is |J in the task|, or the
        standard deviation of a return if that is larger (for returns that change sign).
        """
        from oee_tabular.exact import policy_value  # what it compiles with is imported only here

        def uniform(states: Array) -> Array:
            return np.full((len(states), self.task.n_actions), 1.0 / self.task.n_actions)

        chosen = uniform if policy is None else policy
        mc = monte_carlo_value(self.task, chosen, n_episodes, horizon, discount=self.mdp.discount, seed=seed)
        value = policy_value(self.plain, self.policy(chosen), horizon=horizon)
        scale = max(abs(mc.value), mc.deviation, np.finfo(float).tiny)
        return (value - mc.value) / scale, mc.standard_error / scale

    # ---- mixtures of simulators -----------------------------------------------------------------------------------

    def mixture(self, weights: Sequence[float] | Array) -> Discretization:
        """The same states with sum_k w_k P_k over ``simulators``: another simulator, and ``metadata`` says so.

        Raises ValueError unless there are as many weights as simulators, nonnegative, summing to 1.
        """
        shares = _checks.float_array(weights, "weights")
        if shares.shape != (len(self.simulators),):
            raise ValueError(
                f"weights must have one number for each of {len(self.simulators)} simulators; it has shape {shares.shape}"
            )
        _checks.require_nonnegative(shares, "weights")
        _checks.require_sums_to_one(np.array([shares.sum()]), "weights")
        used = [(share, part) for share, part in zip(shares, self.simulators, strict=True) if share > 0.0]
        matrix = sum(share * part.transitions for share, part in used)
        paid = np.sum([share * part.rewards for share, part in used], axis=0)
        found = finite_mdp(self.task, self.places, sparse.csr_array(matrix), paid, self.plain)
        return replace(self, mdp=found, weights=tuple(shares.tolist()))

    def with_transitions(self, transitions: sparse.csr_array) -> FiniteMDP:
        """Other transitions on the same states with the task's rewards, wherever they lead."""
        return finite_mdp(self.task, self.places, transitions, self.plain.rewards, self.plain)

    @one_thread
    def fit_weights(self, counts: sparse.csr_array) -> Array:
        """Weights w of ``simulators`` that minimise the KL risk -sum_x n_x log sum_k w_k P_k(x): zeta within their hull.

        Convex in w; each step of EM decreases it. A simulator with the target's parameters is found where the log is long: this
        is system identification, stated as a ratio. Raises ValueError for a transition that none of them allows.
        """
        entries = counts.tocoo()
        table = np.stack([np.asarray(part.transitions[entries.coords]).ravel() for part in self.simulators], axis=1)
        impossible = np.flatnonzero(table.sum(axis=1) == 0.0)
        if impossible.size:
            s, a = divmod(int(entries.coords[0][impossible[0]]), self.task.n_actions)
            raise ValueError(
                f"counts must have transitions that some simulator allows; ({s}, {a}, {entries.coords[1][impossible[0]]}) "
                f"is allowed by none ({impossible.size} such transitions in all)"
            )
        weights = np.full(table.shape[1], 1.0 / table.shape[1])
        for _ in range(N_RISK_STEPS):
            share = table * weights
            share /= share.sum(axis=1, keepdims=True)
            weights = entries.data @ share / entries.data.sum()
        return np.asarray(weights)

    # ---- logs -----------------------------------------------------------------------------------------------------

    def encode_states(self, states: object, *, seed: Any = None, outside: str = "error") -> IntArray:
        """(n,) the number of each state.

        Parameters
        ----------
        states : (n, d) finite numbers
        seed : without one, the state with the largest weight; with one, drawn by the weights (so that the mean over draws
            is the interpolation)
        outside : "error" | "nearest"
            What to do with states outside the cells: name and count them, or take the nearest place with a warning.
        """
        _checks.one_of(outside, "outside", OUTSIDE[:2])
        array = check_states(self.task, states)
        ended = self.task.terminated(array) & self.task.end_shows(array)
        self._outside(array, ~ended, "states", outside)
        draws = None if seed is None else _checks.generator(seed).random(len(array))
        return _pick(weights_of(self.cells, self.task, array, ended), draws)

    def encode(
        self, log: ContinuousTransitions, *, seed: Any = None, outside: str = "error", strict: bool = False
    ) -> Transitions:
        """The log with numbered states and actions, ready for ``Problem``.

        Parameters
        ----------
        seed : as in ``encode_states``; each state that episodes pass through is drawn once
        outside : "error" | "nearest" | "drop"
            Rows with a state outside the cells: an error that names and counts them, the nearest place, or left out (the rest
            is then a bag without episodes); both of the latter with a warning.
        strict : an error, not a warning, for actions that are not in the task's set

        Raises
        ------
        ValueError
            A log with other dimensions than the task; actions or states that the task does not know.
        """
        kept, actions, ended = self._checked(log, outside, strict)
        draws = None if seed is None else _checks.generator(seed).random((len(kept), 2))
        if draws is not None and kept.episode is not None:  # the next row's state is this row's next state
            same = kept.episode[1:] == kept.episode[:-1]
            draws[:-1, 1] = np.where(same, draws[1:, 0], draws[:-1, 1])
        start, arrival = self._weights(kept, ended)
        first = _pick(start, None if draws is None else draws[:, 0])
        following = _pick(arrival, None if draws is None else draws[:, 1])
        if kept.episode is not None:
            follows = np.flatnonzero(kept.episode[1:] == kept.episode[:-1])
            first[follows + 1] = following[follows]  # float32 copies of one state may lie on two sides of an edge
        columns = kept.columns() | {"state": first, "action": actions, "next_state": following, "terminated": ended}
        columns["truncated"] = (kept.truncated | kept.terminated) & ~ended
        return Transitions(**columns)

    def counts(self, log: ContinuousTransitions, *, outside: str = "error", strict: bool = False) -> sparse.csr_array:
        """Soft counts n(s, a, s') = sum over rows of w_s(state) w_s'(next_state): csr of shape (S*A, S).

        The mean of ``encode(...).counts(...)`` over draws, without their noise. Arguments and errors as there. Where a command
        moves the features alike everywhere, a transition is carried to the vertex i of its box, and spread as the simulator's
        rows are: w_j(vertex_i + phi(s') - phi(s)).
        """
        kept, actions, ended = self._checked(log, outside, strict)
        n_states, n_actions = self.mdp.n_states, self.task.n_actions
        if self.task.is_translation_invariant:
            grid = self.cells
            before, after = self.task.features(kept.state), self.task.features(kept.next_state)
            number = _pick(grid.weights(before), None)
            start = sparse.csr_array((np.ones(len(kept)), number, np.arange(len(kept) + 1)), (len(kept), n_states))
            arrival = grid.weights(grid.vertices(number) + after - before)
        else:
            start, arrival = self._weights(kept, ended)
        rows = start.indices.astype(np.int64) * n_actions + np.repeat(actions, np.diff(start.indptr))
        spread = sparse.csr_array((start.data, rows, start.indptr), shape=(len(kept), n_states * n_actions))
        return canonical(sparse.csr_array(spread.T @ arrival), drop_zeros=True)

    def supported(self, counts: sparse.csr_array) -> tuple[sparse.csr_array, float]:
        """The counts that lie where ``mdp`` has probability, and the share of those that do not: to be reported with it."""
        matrix = canonical(counts, drop_zeros=True)
        rows, columns = row_of_entry(matrix), matrix.indices.astype(np.int64)
        possible = find(self.mdp.transitions, rows, columns)[1]
        kept = canonical(csr_on_pattern(matrix, np.where(possible, matrix.data, 0.0)), drop_zeros=True)
        total = float(matrix.data.sum())
        return kept, 1.0 - float(kept.data.sum()) / total if total > 0 else 0.0

    def displacement_ties(self) -> IntArray:
        """(nnz,) a tie for each entry of ``mdp.transitions``: the action, and how many cells along each axis it leads.

        For ``transition_ratio(tie=...)`` of tasks whose commands move the features alike everywhere; on grids alone.
        """
        grid, matrix = self.cells, self.mdp.transitions
        if not isinstance(grid, Grid) or self.over is not None:
            raise ValueError(
                f"cells must be a grid without an absorbing state to tie displacements; they are {grid.extent()}"
            )
        first, action = np.divmod(row_of_entry(matrix), self.task.n_actions)
        places = np.stack(np.unravel_index(np.arange(grid.n_cells), grid.shape), axis=1)
        apart = places[matrix.indices] - places[first] + grid.shape
        return np.asarray(np.ravel_multi_index((action, *apart.T), (self.task.n_actions, *(2 * n for n in grid.shape))))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the MDP as ``FiniteMDP.load`` reads it, with the metadata as JSON."""
        metadata = json.dumps(self.metadata | {"version": version("oee-tabular")})
        _files.save_npz(path, KIND, self.mdp.arrays() | {"metadata": np.array(metadata)})

    def _weights(self, log: ContinuousTransitions, ended: BoolArray) -> tuple[sparse.csr_array, sparse.csr_array]:
        alive = np.zeros(len(log), dtype=np.bool_)
        return weights_of(self.cells, self.task, log.state, alive), weights_of(
            self.cells, self.task, log.next_state, ended
        )

    def _checked(
        self, log: ContinuousTransitions, outside: str, strict: bool
    ) -> tuple[ContinuousTransitions, IntArray, BoolArray]:
        """The rows that can be encoded, their action numbers, and which end in the absorbing state."""
        require_log_of(self.task, log)
        _checks.one_of(outside, "outside", OUTSIDE)
        _checks.boolean(strict, "strict")
        task, actions = self.task, log.action_numbers(self.task.actions, strict=strict)
        ended = np.array(log.terminated)
        if not task.terminates and ended.any():
            row = int(np.flatnonzero(ended)[0])
            raise ValueError(f"log.terminated[{row}] must be False: episodes of {task.name} do not end; it is True")
        if task.terminates:
            before = np.flatnonzero(task.terminated(log.state))
            if before.size:
                raise ValueError(
                    f"log.state[{before[0]}] must be a state in which {task.name} goes on; it is over in "
                    f"{log.state[before[0]].tolist()} ({before.size} such rows in all)"
                )
            ended = self._shown(log, ended | task.terminated(log.next_state))
        gone = self._outside(log.state, np.ones(len(log), dtype=np.bool_), "log.state", outside)
        gone |= self._outside(log.next_state, ~ended, "log.next_state", outside)
        if outside == "drop" and gone.any():
            if gone.all():
                raise ValueError("outside must not be 'drop' where every row is outside; nothing would be left")
            return log.select(~gone), actions[~gone], ended[~gone]
        return log, actions, ended

    def _shown(self, log: ContinuousTransitions, ended: BoolArray) -> BoolArray:
        """Without the ends that the features do not tell, which are warned about."""
        hidden = np.flatnonzero(ended & ~self.task.end_shows(log.next_state))
        if hidden.size:
            warnings.warn(
                f"log.terminated: {hidden.size} of {int(ended.sum())} ends do not show in the features "
                f"({', '.join(self.task.feature_names)}); the first, row {hidden[0]}, leads to "
                f"{log.next_state[hidden[0]].tolist()}. They are taken as truncated, the process going on",
                stacklevel=4,
            )
            ended[hidden] = False
        return ended

    def _outside(self, states: Array, asked: BoolArray, name: str, outside: str) -> BoolArray:
        gone = np.asarray(self.cells.outside(self.task.features(states)) & asked)
        rows = np.flatnonzero(gone)
        if rows.size:
            at = self.task.features(states[rows[:1]])[0]
            place = ", ".join(f"{k}={v:.4g}" for k, v in zip(self.task.feature_names, at, strict=True))
            found = f"{rows.size} of {len(states)} rows are not; the first, row {rows[0]}, is at {place}"
            text = f"{name} must be inside {self.cells.extent()}: {found}"
            if outside == "error":
                raise ValueError(
                    f"{text}. A wider grid, or outside='nearest' or 'drop' (--task-option outside=), takes them"
                )
            done = "left out" if outside == "drop" else "moved to the nearest place inside"
            warnings.warn(f"{text}. They are {done}", stacklevel=4)
        return gone


def finite_mdp(
    task: ContinuousTask, places: Places, matrix: sparse.csr_array, paid: Array, like: FiniteMDP | float
) -> FiniteMDP:
    """The FiniteMDP of rows and rewards r(s, a); ``like`` has where episodes begin, or is the discount.

    Rewards of a task with ``reward_terms`` are those of the cells' mean terms, r(i, a, j): they telescope on cells as they do
    in the task. Taken transition by transition, their mean error would add up.
    """
    matrix = canonical(matrix, drop_zeros=True)
    matrix.data.flags.writeable = True
    matrix.data /= row_sums(matrix)[row_of_entry(matrix)]
    rewards: Any = paid
    terms = task.reward_terms(places.points)
    if terms is not None:
        mean = np.stack([places.mean(column) for column in terms.T], axis=1)
        rows = row_of_entry(matrix)
        state, action = np.divmod(rows, task.n_actions)
        between = task.reward_of(mean[state], action, mean[matrix.indices])
        first = between[matrix.indptr[:-1]]
        is_of_pair = np.array_equal(between, first[rows])
        rewards = first.reshape(paid.shape) if is_of_pair else csr_on_pattern(matrix, between)
    if isinstance(like, FiniteMDP):
        return FiniteMDP(matrix, rewards, like.initial, like.discount)
    starts, mass = task.initial_points()
    initial = np.zeros(matrix.shape[1])
    initial[: places.cells.n_cells] = places.cells.weights(task.features(starts)).T @ mass
    return FiniteMDP(matrix, rewards, initial / initial.sum(), like)


def _pick(weights: sparse.csr_array, draws: Array | None) -> IntArray:
    """One state number a row: the heaviest, or the one that a uniform number (n,) picks."""
    low, width = weights.indptr[:-1], np.diff(weights.indptr)
    table = np.zeros((len(width), int(width.max())))
    table[np.arange(table.shape[1]) < width[:, None]] = weights.data
    if draws is None:
        pick = table.argmax(axis=1)
    else:
        running = np.cumsum(table, axis=1)
        pick = np.minimum((running <= (draws * running[:, -1])[:, None]).sum(axis=1), width - 1)
    return np.asarray(weights.indices[low + pick], dtype=np.int64)

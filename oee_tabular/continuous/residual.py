"""A simulator corrected by what a log leaves over: ``ResidualSimulator``, a ``ContinuousTask`` again.

    s' = f(s, a) + g(s, a) + e

f is the task's own step, g a function of the state, the action and the displacement f(s, a) - s, chosen for each coordinate
among nested classes by held-out error over episodes (regression), e what g leaves over, drawn from the log. It is the paper's
ratio of transitions with one tie: with q the law of the simulator's scatter s' - f(s, a) and p that of g + e,

    zeta(s, a, s') = p(s' - f(s, a) | s, a) / q(s' - f(s, a)),

so that transitions of one displacement from f share what the log says of it. No cells, and no support: the corrected simulator
is stepped, not weighted. Cells, ratios and exact values can come after it, as after any simulator.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import ndtr

from oee_tabular import _checks
from oee_tabular._checks import Array, BoolArray, IntArray, Seed
from oee_tabular._threads import one_thread
from oee_tabular.continuous.coordinate import TRIFLE, Coordinate
from oee_tabular.continuous.history import HistoryEffect, history_effects
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.regression import Fit, Functions, Grams, groups_of
from oee_tabular.continuous.scatter import Scatter
from oee_tabular.continuous.stops import Stops
from oee_tabular.continuous.task import ContinuousTask, DerivedTask, Moves, find_periods, require_log_of, shortest
from oee_tabular.continuous.units import other_units

APART = 8.0  # robust deviations: such residuals no smooth g should be fitted to
MOST_APART = 0.2  # share of rows that may be so
ROUNDS = 3  # of setting them apart and fitting again
SKEWED = 5.0  # standard errors between the means of two scatters: they are not the same
SAME = 1e-9  # of a displacement's deviation: rounding


class ResidualSimulator(DerivedTask):
    """The task, its step corrected by the residuals s' - f(s, a) of a log.

    Parameters
    ----------
    task : ContinuousTask, the simulator
    log : ContinuousTransitions of the target
    seed : of the random functions that g may be made of, and of the simulator's scatter that the log's is compared with

    Attributes
    ----------
    coordinates : a ``Coordinate`` for each coordinate of the state, and for the reward where it had to be learned
    fits : g of each of them; see ``regression.Fit``
    residuals, left_over : (n, k) s' - f(s, a) of the log's rows, f without its stops, and what g leaves of it
    paid : the least and the largest reward of the log and of the simulator's own steps from its rows
    units : the columns that seem to be in another unit than the simulator's, and in which; "" where none does

    Raises
    ------
    ValueError
        A log of other states than the task's, or of actions that it has not.

    Notes
    -----
    g is kept within the residuals that were logged, and its arguments within theirs. Rows that no smooth g fits (contacts)
    are left to e; those that end at a stop are in neither: the simulator's own is undone before g, the target's put where the
    corrected step passes it (``stops``). e is 0 where nothing is left over; the simulator's own where that is of its size and
    mean; otherwise a whole row's e is drawn from the log's rows of the same action: from all, or from 8 near by where the
    residuals of neighbours tell of each other. A coordinate that ended at one extreme five times in the log goes no further.
    The reward is ``reward_between``; where the task has none, its own step's plus a residual learned alike. Steps end where
    ``terminated`` says so; where that does not repeat the task's own steps, where the nearest known next state does.
    O(n p^2) for p functions (some 200), accumulated in blocks: a log of 150 000 transitions needs some 200 MB. A step costs the
    task's own and O(p).

    Examples
    --------
    >>> from oee_tabular.tasks import CartPole, cartpole_policy, monte_carlo_value, record
    >>> log = record(CartPole(15.0), cartpole_policy(0.3), n_transitions=3000, max_steps=100, seed=0)
    >>> corrected = ResidualSimulator(CartPole(10.0), log, seed=0)
    >>> [(c.name, c.kind, c.scatter) for c in corrected.coordinates][2]
    ('theta', 'zero', 'simulator')
    >>> truth, found, before = (
    ...     monte_carlo_value(task, cartpole_policy(0.6), 4000, 100, seed=0, normalized=True).value
    ...     for task in (CartPole(15.0), corrected, CartPole(10.0)))
    >>> abs(found - truth) < 0.2 * abs(before - truth)
    True
    """

    @one_thread
    def __init__(self, task: ContinuousTask, log: ContinuousTransitions, *, seed: Seed = None) -> None:
        super().__init__(_checks.instance(task, ContinuousTask, "task"), f"{task.name}, corrected by a log")
        require_log_of(task, log)
        rng = np.random.default_rng(_checks.seed_sequence(seed, (10**6 + 2,)))
        actions = log.action_numbers(task.actions)
        own = task.moves(log.state, actions, np.zeros((len(log), task.n_disturbances)))
        self._periods, self._start = find_periods(task, own.next_state), np.resize(task.feature_low, self.n_state)
        ends = self._start - SAME, np.resize(task.feature_high, self.n_state) + SAME
        self._wrapped = (self._periods > 0) & ((own.next_state >= ends[0]) & (own.next_state <= ends[1])).all(axis=0)
        features = task.features(log.state)
        self._seen = features.min(axis=0), features.max(axis=0)
        self.units = other_units(task, log.state, actions, log.next_state, self._shortest)
        self._stops = Stops(log.state, log.next_state, own.next_state, self._periods > 0)
        self._is_stopped = self._stops.is_stopped(log.next_state)
        free = self._free(log.state, actions, own.next_state)
        self.residuals = self._differences(log, own, np.where(self._is_stopped[:, None], own.next_state, free))
        is_smooth = self._fit(log, actions, free, rng)
        spread = self._fit_scatter(log, actions, own, rng)
        self._remember_ends(log, own)
        self.coordinates = self._describe(log, actions, spread, is_smooth)

    # ---- what the log says ---------------------------------------------------------------------------------------------

    def _shortest(self, differences: Array) -> Array:
        return shortest(differences, self._periods) if self._periods.any() else differences

    def _free(self, states: Array, actions: IntArray, own: Array) -> Array:
        """The simulator's next states without its stops."""

        def step(states: Array, rows: IntArray) -> Array:
            return self.task.moves(states, actions[rows], np.zeros((len(rows), self.task.n_disturbances))).next_state

        return self._stops.free(step, states, own)

    def _displacements(self, states: Array, actions: IntArray, free: Array) -> Array:
        """(n, m) f(s, a) - s, and under each action that the state remembers."""
        d = self.n_state - self.n_remembered
        own = self._shortest(free - states)[:, :d]
        if self.n_remembered == 0:
            return own
        return np.column_stack([own, shortest(self.task.past_displacements(states, actions), self._periods[:d])])

    def _differences(self, log: ContinuousTransitions, own: Moves, following: Array) -> Array:
        """(n, d) s' - f(s, a), and the rewards' difference where the task does not know r(s, a, s')."""
        apart = self._shortest(log.next_state - following)
        known = self.task.reward_between(log.state[:1], np.zeros(1, dtype=np.int64), log.next_state[:1]) is not None
        self._learns_reward = not known and log.reward is not None
        if self._learns_reward and log.reward is not None:
            apart = np.column_stack([apart, np.where(own.terminated == log.terminated, log.reward - own.reward, 0.0)])
        return apart

    def _fit(self, log: ContinuousTransitions, actions: IntArray, free: Array, rng: np.random.Generator) -> BoolArray:
        """Fit g to smooth rows, which it finds by what g leaves over; then what is lost at stops."""
        arguments = log.state, actions, self._displacements(log.state, actions, free)
        self._functions = Functions(self.task, *arguments, rng)
        self._group = groups_of(log.episode, len(log), self._functions.width, self.n_actions)
        is_free = ~self._is_stopped
        self._ends_of_g = np.stack([self.residuals[is_free].min(axis=0), self.residuals[is_free].max(axis=0)])
        is_smooth = is_free
        for _ in range(1 + ROUNDS):
            self._grams = Grams(self._functions, arguments, self.residuals, self._group, is_smooth)
            self._use(self._grams.choose())
            added = self._correction(*arguments)
            last, is_smooth = is_smooth, is_free & ~self._is_apart(self.residuals - added)
            if np.array_equal(is_smooth, last):
                break
        self.left_over = self.residuals - added
        moved = free + added[:, : self.n_state]
        self._stops.learn(moved, moved + self._shortest(log.next_state - moved))
        stopped = self._keep(self._stops.push(moved))
        self._stops.hold(stopped)
        self.left_over[self._is_stopped, : self.n_state] = self._shortest(log.next_state - stopped)[self._is_stopped]
        return last

    def _is_apart(self, left: Array) -> BoolArray:
        """(n,) rows with a residual far beyond the others', where they are few: contacts, stops."""
        size = np.median(np.abs(left), axis=0) / 0.6745
        floor = 1e-3 * np.sqrt((self.residuals**2).mean(axis=0))
        far = np.abs(left) > APART * np.maximum(size, floor) + 1e-300
        far &= far.mean(axis=0) <= MOST_APART
        return np.asarray(far.any(axis=1) & (far.any(axis=1).mean() <= MOST_APART))

    def _use(self, fits: Sequence[Fit]) -> None:
        self.fits, self._is_zero = list(fits), not any(len(fit.columns) for fit in fits)
        self._coefficients = self._functions.stack(fits)

    def _correction(self, states: Array, actions: IntArray, displacement: Array) -> Array:
        """(n, k) g(s, a), within what was logged."""
        if self._is_zero:
            return np.zeros((len(states), len(self.fits)))
        return self._functions.predict(states, actions, displacement, self._coefficients, self._ends_of_g)

    def _fit_scatter(
        self, log: ContinuousTransitions, actions: IntArray, own: Moves, rng: np.random.Generator
    ) -> Array:
        """Compare what is left over with the simulator's own scatter, whose (k,) root mean square is returned."""
        some, d = np.sort(rng.permutation(len(log))[:5000]), self.n_state
        scattered, is_free = self.task.step(log.state[some], actions[some], rng), ~self._is_stopped
        away = self._shortest(scattered.next_state - own.next_state[some])
        spread, can_own = np.zeros(len(self.fits)), np.full(len(self.fits), self.task.n_disturbances > 0)
        spread[:d] = np.sqrt((away**2).mean(axis=0))
        apart = np.abs(away.mean(axis=0) - self.left_over[is_free, :d].mean(axis=0))
        can_own[:d] &= apart <= SKEWED * spread[:d] * np.sqrt(2.0 / len(some))
        rounding = np.full(len(spread), SAME)
        rounding[:d] = SAME * self._shortest(log.next_state - log.state).std(axis=0)
        rounding[:d] += np.finfo(float).eps * np.abs(log.next_state).max(axis=0)
        self._scatter = Scatter(
            self.task, log.state[is_free], actions[is_free], self.left_over[is_free], spread=spread, rounding=rounding,
            can_own=can_own, rng=rng,
        )  # fmt: skip
        self.n_disturbances = self.task.n_disturbances + int(self._scatter.drawn.any())
        self._gain = self._find_gain(log.state[some], actions[some]) if self._scatter.own.any() else None
        if self._learns_reward:  # is drawn from the log all the same
            is_alike = scattered.terminated == own.terminated[some]
            spread[-1] = _rms(np.where(is_alike, scattered.reward - own.reward[some], 0.0))
        return spread

    def _find_gain(self, states: Array, actions: IntArray) -> Array | None:
        """(q, d) B where the simulator's noise is xi B at all of these rows, up to rounding; else None.

        Then a second step for the noise is spared: a sixth of Monte Carlo's time in CartPole.
        """
        rows = np.resize(np.arange(len(states)), max(len(states), 1000))
        xi = np.random.default_rng(0).standard_normal((len(rows), self.task.n_disturbances))
        ends = [self.task.moves(states[rows], actions[rows], x).next_state for x in (np.zeros_like(xi), xi)]
        gain = np.linalg.lstsq(xi, ends[1] - ends[0])[0]
        is_additive = np.abs(ends[1] - ends[0] - xi @ gain).max() <= 8 * np.finfo(float).eps * np.abs(ends).max()
        return gain * self._scatter.own[: self.n_state] if is_additive else None

    def _remember_ends(self, log: ContinuousTransitions, own: Moves) -> None:
        """Known next states: whether they end, and what is paid."""
        self._knows_ends = bool((self.task.terminated(own.next_state) == own.terminated).all())
        self._ends = np.concatenate([log.terminated, own.terminated])
        self._paid = np.concatenate([own.reward if log.reward is None else log.reward, own.reward])
        self.paid = float(self._paid.min()), float(self._paid.max())
        self._places = self.task.smooth(np.concatenate([log.next_state, own.next_state]))
        self._unit = np.maximum(self._places.std(axis=0), 1e-300)
        self._trees: dict[bool | None, tuple[IntArray, cKDTree]] = {}

    def _describe(
        self, log: ContinuousTransitions, actions: IntArray, spread: Array, is_smooth: BoolArray
    ) -> tuple[Coordinate, ...]:
        """One ``Coordinate`` each; rows that g was not fitted to count by what it leaves of them."""
        squares, rough = (self.residuals**2).sum(axis=0), (self.left_over[~is_smooth] ** 2).sum(axis=0)
        moved = self._shortest(log.next_state - log.state).std(axis=0)
        displaced = np.append(moved, 0.0 if log.reward is None else log.reward.std())[: len(spread)]
        effects, is_drawn = [HistoryEffect()] * len(spread), self._scatter.drawn
        if (np.sqrt((self.left_over**2).mean(axis=0)) * is_drawn > TRIFLE * displaced).any():
            effects = history_effects(
                self.task, log, actions, self.left_over, self._group, is_smooth=is_smooth, is_free=~self._is_stopped,
                least=TRIFLE * displaced,
            )  # fmt: skip
        return tuple(
            Coordinate(
                name, fit.kind, fit.per_action, float(spread[k]), _rms(self.residuals[:, k]), _rms(self.left_over[:, k]),
                float(displaced[k]), float(1.0 - (fit.error + rough[k]) / squares[k]) if squares[k] > 0 else 0.0,
                fit.t_statistic, self._scatter.source(k), effects[k] if is_drawn[k] else HistoryEffect(),
            )
            for k, (name, fit) in enumerate(zip((*self.state_names, "reward"), self.fits, strict=False))
        )  # fmt: skip

    def resampled(self, seed: Any = None) -> ResidualSimulator:
        """The same corrected by a bootstrap's log: groups of whole episodes drawn with replacement, g of the same classes."""
        rng, n_groups = _checks.generator(seed), len(self._grams.g)
        weights = np.bincount(rng.integers(n_groups, size=n_groups), minlength=n_groups).astype(np.float64)
        again = copy.copy(self)
        again._use(self._grams.refit(self.fits, weights))
        again._scatter = self._scatter.weighted(weights[self._group[~self._is_stopped]])
        return again

    @property
    def hidden_part(self) -> float:
        """The largest part of a step, in its deviations, that history explains; 0 where the state is Markov."""
        return max((c.history.part / c.displacement for c in self.coordinates if c.hidden), default=0.0)

    @property
    def held_out_error(self) -> float:
        """Mean square one-step error on held-out episodes, in the displacement's variance, summed over coordinates."""
        return sum(c.unexplained for c in self.coordinates)

    def beyond(self, states: Array) -> BoolArray:
        """(n,) states with a feature outside the range of the log's, where no data support g."""
        features = self.task.features(states)
        return np.asarray(((features < self._seen[0]) | (features > self._seen[1])).any(axis=1))

    # ---- the task ------------------------------------------------------------------------------------------------------

    @one_thread
    def moves(self, states: Array, actions: IntArray, disturbance: Array) -> Moves:
        """One corrected step; the last disturbance chooses e, where it is drawn from the log."""
        actions, scatter = np.asarray(actions, dtype=np.int64), self._scatter
        xi = disturbance[:, : self.task.n_disturbances]
        own = self.task.moves(states, actions, np.zeros_like(xi))
        free = own.next_state if self._is_zero else self._free(states, actions, own.next_state)
        added = self._correction(states, actions, self._displacements(states, actions, free))
        if scatter.drawn.any():
            added += scatter.draw(states, actions, ndtr(disturbance[:, -1]))
        following = self._stops.push(free + added[:, : self.n_state])
        if self._gain is not None:
            following = following + xi @ self._gain
        elif scatter.own.any():
            noise = self.task.moves(states, actions, xi).next_state - own.next_state
            following = following + np.where(scatter.own[: self.n_state], noise, 0.0)
        if self._wrapped.any() or np.isfinite(self._stops.bounds).any():
            following = np.where(following != own.next_state, self._keep(following), following)
        self._stops.hold(following)
        ends = self._is_over(following, own.terminated)
        return Moves(following, self._reward(states, actions, following, ends, own, added), ends)

    def step(self, states: Array, actions: IntArray, rng: np.random.Generator) -> Moves:
        """One random step; what chooses e is a stream of its own, so that ``rng`` gives what it gives to the task."""
        xi = rng.standard_normal((len(states), self.task.n_disturbances))
        if self._scatter.drawn.any():
            xi = np.column_stack([xi, rng.spawn(1)[0].standard_normal(len(states))])
        return self.moves(states, actions, xi)

    def _keep(self, following: Array) -> Array:
        """Within the stops, and within one turn where the task is."""
        kept = np.asarray(np.clip(following, *self._stops.bounds))
        for i in np.flatnonzero(self._wrapped):
            kept[:, i] = self._start[i] + (kept[:, i] - self._start[i]) % self._periods[i]
        return kept

    def _is_over(self, following: Array, own: BoolArray) -> BoolArray:
        if not self.terminates:
            return own
        if self._knows_ends:
            return self.task.terminated(following)
        return np.asarray(self._ends[self._nearest(following)])

    def _nearest(self, following: Array, end: bool | None = None) -> IntArray:
        """The nearest known next state to each; among those only that end so, where ``end`` is given."""
        if end not in self._trees:
            among = np.flatnonzero(self._ends == end) if end is not None else np.arange(len(self._ends))
            self._trees[end] = among, cKDTree(self._places[among] / self._unit)
        among, tree = self._trees[end]
        return np.asarray(among[tree.query(self.task.smooth(following) / self._unit)[1]])

    def _reward(
        self, states: Array, actions: IntArray, following: Array, ends: BoolArray, own: Moves, added: Array
    ) -> Array:
        between = self.task.reward_between(states, actions, following)
        if between is not None:
            return between
        paid = own.reward + added[:, -1] if self._learns_reward else own.reward
        is_other = ends != own.terminated
        if is_other.any():  # a step that ends otherwise than the simulator's is paid as the nearest that ends so
            paid = paid.copy()
            for end in (False, True):
                rows = np.flatnonzero(is_other & (ends == end))
                if len(rows) and (self._ends == end).any():
                    paid[rows] = self._paid[self._nearest(following[rows], end)]
        return paid

    def parameters(self) -> dict[str, Any]:
        """The task's, and what the correction is made of."""
        learned = {c.name: [c.kind, c.per_action, c.scatter] for c in self.coordinates}
        return self.task.parameters() | {"corrected_by_moves": len(self.residuals), "correction": learned}


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean()))

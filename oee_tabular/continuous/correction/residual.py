"""Simulators corrected by the residuals of a log, which are tasks again.

    s' = f(s, a) + g(s, a) + e

f is the task's own step, g a function of the state, the action and the displacement
f(s, a) - s, chosen for each coordinate among nested classes by held-out error over
episodes (regression), e what g leaves over, drawn from the log. It is the paper's ratio
of transitions with one tie: with q the law of the simulator's scatter s' - f(s, a) and
p that of g + e,

    zeta(s, a, s') = p(s' - f(s, a) | s, a) / q(s' - f(s, a)),

so that transitions of one displacement from f share what the log says of it. No cells,
and no support: the corrected simulator (``ResidualSimulator``) is stepped, not
weighted. Cells, ratios and exact values can come after it, as after any simulator.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy.special import ndtr

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular._parallel import one_thread
from oee_tabular.continuous.correction.hidden_state import (
    HistoryEffect,
    history_effects,
)
from oee_tabular.continuous.correction.history import (
    HistoryTask,
    blend_steps,
    count_whole_actions,
)
from oee_tabular.continuous.correction.neighbors import Neighbors
from oee_tabular.continuous.correction.regression import (
    Fit,
    Functions,
    Grams,
    draw_groups,
    episode_groups,
)
from oee_tabular.continuous.correction.scatter import (
    draw_residuals,
    measure_scatter,
    root_mean_square,
)
from oee_tabular.continuous.correction.starts import odd_starts
from oee_tabular.continuous.correction.stops import (
    find_stops,
    free_steps,
    hold_steps,
    learn_pushes,
    push_steps,
)
from oee_tabular.continuous.correction.units import other_units
from oee_tabular.continuous.log.numbering import number_and_share
from oee_tabular.continuous.log.transitions import ContinuousTransitions
from oee_tabular.continuous.task.base import (
    ContinuousTask,
    DerivedTask,
    Moves,
    find_periods,
    shortest,
)
from oee_tabular.typing import Array, BoolArray, IntArray, Seed

# robust deviations: g is not fitted to residuals beyond, as of contacts
OUTLYING_DEVIATIONS = 8.0
MAX_OUTLYING_SHARE = 0.2  # of the rows: where there are more, none is outlying
N_ROUNDS = 3  # of leaving them out and fitting again
ANGLE_ROUNDING = 1e-9  # in units of an angle
MIN_STANDARD_ERRORS = 3.0  # where g explains more, the target differs
# Where history explains a larger share of what is left over, the state is not all that
# decides.
MIN_HIDDEN_SHARE = 0.1
MIN_HIDDEN_DEVIATIONS = 0.03  # of a step's own deviation: less is no hidden state
MAX_SCATTER_DIFFERENCE = 0.05  # share by which two equal scatters may differ


@dataclass(frozen=True)
class Coordinate:
    """What a log says of one coordinate of the next state, or of the reward.

    It says how the target differs, and whether the coordinate is Markov.

    Attributes
    ----------
    name : str
        The coordinate's name.
    kind : str
        The class of functions to which g belongs.
    per_action : bool
        Whether each action has its own coefficients.
    t_statistic : float
        How many standard errors what g explains is from 0.
    simulator_scatter : float
        The root mean square of the simulator's own step about f.
    residual_scatter : float
        The root mean square of s' - f(s, a) in the log.
    left_over : float
        The root mean square of s' - f(s, a) - g(s, a).
    displacement : float
        The standard deviation of s' - s in the log (of the reward).
    explained : float
        The share of the residual's mean square, of every row, that g explains on
        episodes to which it was not fitted.
    scatter : {'none', 'simulator', 'log'}
        Where the noise about f + g is taken from.
    history : HistoryEffect
        What earlier actions and residuals explain of what is left over.
    """

    name: str
    kind: str
    per_action: bool
    t_statistic: float
    simulator_scatter: float
    residual_scatter: float
    left_over: float
    displacement: float
    explained: float
    scatter: Literal["none", "simulator", "log"]
    history: HistoryEffect

    @property
    def differs(self) -> bool:
        """Return whether the target's step differs from the simulator's.

        It does where g is surely not zero, or where the scatter is another.
        """
        difference = abs(self.left_over - self.simulator_scatter)
        is_alike = difference <= MAX_SCATTER_DIFFERENCE * self.simulator_scatter
        is_sure = self.t_statistic > MIN_STANDARD_ERRORS
        return is_sure or (self.scatter == "log" and not is_alike)

    @property
    def unexplained(self) -> float:
        """Return the held-out mean square error of f + g.

        It is in units of the displacement's variance.
        """
        if self.displacement == 0.0:
            return 0.0
        return (1.0 - self.explained) * (self.residual_scatter / self.displacement) ** 2

    @property
    def hidden(self) -> bool:
        """Return whether history explains enough of what is left over.

        Something that is not in the state then decides the next one.
        """
        least = MIN_HIDDEN_DEVIATIONS * self.displacement
        return self.history.r_squared > MIN_HIDDEN_SHARE and self.history.part > least


@suggest_keywords
class ResidualSimulator(DerivedTask):
    """A task whose step is corrected by the residuals s' - f(s, a) of a log.

    Its states, actions, rewards and units are the task's.

    Parameters
    ----------
    task : ContinuousTask
        The simulator.
    log : ContinuousTransitions
        A log of the target.
    seed : int, Generator or SeedSequence, optional
        The source of the random functions of which g may be made, and of the
        simulator's scatter, with which the log's is compared.

    Attributes
    ----------
    coordinates : tuple of Coordinate
        One for each coordinate of the state, and one for the reward where it had to be
        learned.
    fits : list of Fit
        g of each of them; see ``regression.Fit``.
    residuals : ndarray of shape (n, k)
        s' - f(s, a) of the log's rows, f without its stops.
    left_over : ndarray of shape (n, k)
        What g leaves of the residuals.
    units : str
        The columns that seem to be in another unit than the simulator's, and in which;
        "" where none does.
    odd_starts : ndarray of shape (k,)
        The share of the squares of ``left_over`` that the first rows of episodes make,
        where they do not fit the other rows; 0 elsewhere.

    Raises
    ------
    ValueError
        If the log has other states than the task, or actions that it has not.

    See Also
    --------
    corrected_value : The value of a policy in the corrected simulator.
    fit_parameters : Fit a simulator's physical parameters first.

    Notes
    -----
    g is kept within the residuals that were logged, and its arguments within theirs.
    Rows that no smooth g fits (contacts) are left to e; those that end at a stop are in
    neither: the simulator's own is undone before g, the target's put where the
    corrected step passes it (``stops``). e is 0 where nothing is left over; the
    simulator's own where that is of its size and mean; otherwise a whole row's e is
    drawn from the log's rows of the same action: from all, or from 8 near by where the
    residuals of neighbours tell of each other. A coordinate that ended at one extreme
    five times in the log goes no further. The reward is ``reward_between``; where the
    task has none, its own step's plus a residual learned alike. Steps end where
    ``terminated`` says so; where that does not repeat the task's own steps, where the
    nearest known next state does. O(n p^2) for p functions (some 200), accumulated in
    blocks: a log of 150 000 transitions needs some 200 MB. A step costs the task's own
    and O(p).

    Examples
    --------
    >>> from oee_tabular.tasks import (
    ...     CartPole,
    ...     cartpole_policy,
    ...     monte_carlo_value,
    ...     record,
    ... )
    >>> log = record(
    ...     CartPole(15.0),
    ...     cartpole_policy(0.3),
    ...     n_transitions=3000,
    ...     max_steps=100,
    ...     seed=0,
    ... )
    >>> corrected = ResidualSimulator(CartPole(10.0), log, seed=0)
    >>> [(c.name, c.kind, c.scatter) for c in corrected.coordinates][2]
    ('theta', 'zero', 'simulator')
    >>> truth, found, before = (
    ...     monte_carlo_value(
    ...         task, cartpole_policy(0.6), 4000, 100, seed=0, normalized=True
    ...     ).value
    ...     for task in (CartPole(15.0), corrected, CartPole(10.0))
    ... )
    >>> abs(found - truth) < 0.2 * abs(before - truth)
    True
    """

    @one_thread
    def __init__(
        self, task: ContinuousTask, log: ContinuousTransitions, *, seed: Seed = None
    ) -> None:
        super().__init__(
            _checks.instance(task, ContinuousTask, "task"),
            f"{task.name}, corrected by a log",
        )
        rng = np.random.default_rng(_checks.seed_sequence(seed, (10**6 + 2,)))
        actions, shares = number_and_share(task, log)
        own = task.noiseless_step(log.state, actions)
        self._periods = find_periods(task, own.next_state)
        # the simulator's steps under the commands that were given, not under the
        # actions next to them: what these leave would count as a difference
        self._logged_commands = None
        step = own
        if shares is not None:
            self._logged_commands = shares @ task.actions
            apart = blend_steps(task, log.state, actions, own.next_state, shares)
            step = replace(
                own,
                next_state=own.next_state + apart.next_state,
                reward=own.reward + apart.reward,
            )
        self._start = np.resize(task.feature_low, self.n_state)
        low = self._start - ANGLE_ROUNDING
        high = np.resize(task.feature_high, self.n_state) + ANGLE_ROUNDING
        # angles that the task itself keeps within one turn
        is_inside = (own.next_state >= low) & (own.next_state <= high)
        self._wraps = (self._periods > 0) & is_inside.all(axis=0)
        features = task.features(log.state)
        self._range = features.min(axis=0), features.max(axis=0)
        is_memory = np.zeros(self.n_state, dtype=np.bool_)
        if isinstance(task, HistoryTask):
            self._range = count_whole_actions(task, *self._range)
            is_memory[task.task.n_state :] = True
        self.units = other_units(task, log, actions, self._periods)
        self._stops = find_stops(
            log.state, log.next_state, step.next_state, self._periods > 0, is_memory
        )
        self._known_ends = np.concatenate([log.terminated, own.terminated])
        self._known_rewards = np.concatenate(
            [own.reward if log.reward is None else log.reward, own.reward]
        )
        self._neighbors = Neighbors(
            task, np.concatenate([log.next_state, own.next_state])
        )
        self._knows_ends = bool(
            (task.terminated(own.next_state) == own.terminated).all()
        )
        is_free = ~self._stops.is_stopped(log.next_state)
        is_smooth = self._fit(log, actions, step, is_free, rng)
        self._scatter = measure_scatter(
            task, log, actions, own, self.left_over, is_free, self._periods, rng
        )
        self._is_free = is_free
        self.n_disturbances = task.n_disturbances + int(self._scatter.drawn.any())
        self.coordinates = self._describe(log, actions, shares, is_smooth, is_free)

    def _fit(
        self,
        log: ContinuousTransitions,
        actions: IntArray,
        own: Moves,
        is_free: BoolArray,
        rng: np.random.Generator,
    ) -> BoolArray:
        """Fit g to smooth rows, then what is lost at stops; return which are smooth.

        Rows are smooth where g leaves no outlying residual.
        """
        d = self.n_state
        free = free_steps(self._stops, self.task, log.state, actions, own.next_state)
        self.residuals = shortest(
            log.next_state - np.where(is_free[:, None], free, own.next_state),
            self._periods,
        )
        if log.reward is not None:
            known = self.task.reward_between(log.state, actions, log.next_state)
            if known is None:
                is_alike = own.terminated == log.terminated
                of_reward = np.where(is_alike, log.reward - own.reward, 0.0)
                self.residuals = np.column_stack([self.residuals, of_reward])
        displacements = self._displacements(log.state, actions, free)
        arguments = log.state, actions, displacements, self._logged_commands
        self._functions = Functions(self.task, *arguments, rng)
        self._group = episode_groups(
            log.episode, len(log), self._functions.width, self.n_actions
        )
        self._limits = np.stack(
            [self.residuals[is_free].min(axis=0), self.residuals[is_free].max(axis=0)]
        )
        is_smooth = is_free
        for _ in range(1 + N_ROUNDS):
            self._grams = Grams(
                self._functions, arguments, self.residuals, self._group, is_smooth
            )
            self._set_fits(self._grams.choose())
            added = self._correction(log.state, actions, free, self._logged_commands)
            last = is_smooth
            is_smooth = is_free & ~self._is_outlying(self.residuals - added)
            if np.array_equal(is_smooth, last):
                break
        self.left_over = self.residuals - added
        following = free + added[:, :d]
        self._pushes = learn_pushes(
            self._stops,
            following,
            following + shortest(log.next_state - following, self._periods),
        )
        pushed = push_steps(self._stops, self._pushes, following)
        stopped = hold_steps(self._stops, self._clip(pushed))
        left = shortest(log.next_state - stopped, self._periods)
        self.left_over[~is_free, :d] = left[~is_free]
        return last

    def _displacements(self, states: Array, actions: IntArray, free: Array) -> Array:
        """Return what g depends on besides (s, a), (n, m).

        ``free`` are the simulator's next states without its stops.
        """
        return np.column_stack(
            [
                shortest(d, self._periods)
                for d in self.task.displacements(states, actions, free)
            ]
        )

    def _is_outlying(self, left: Array) -> BoolArray:
        """Return which rows (n,) have a residual far beyond the others'.

        Contacts and stops are such rows. There are none where they would be many.
        """
        size = np.median(np.abs(left), axis=0) / 0.6745
        floor = 1e-3 * root_mean_square(self.residuals)
        is_far = np.abs(left) > OUTLYING_DEVIATIONS * np.maximum(size, floor) + 1e-300
        is_far &= is_far.mean(axis=0) <= MAX_OUTLYING_SHARE
        is_row_far = is_far.any(axis=1)
        return np.asarray(is_row_far & (is_row_far.mean() <= MAX_OUTLYING_SHARE))

    def _set_fits(self, fits: list[Fit]) -> None:
        """Take these fits for g."""
        self.fits = fits
        self._is_zero = not any(len(fit.columns) for fit in fits)
        self._coefficients = self._functions.stack(fits)

    def _correction(
        self,
        states: Array,
        actions: IntArray,
        free: Array,
        commands: Array | None = None,
    ) -> Array:
        """Compute g(s, a), (n, k), within what was logged.

        ``commands`` are the rows' own; None means those of their actions.
        """
        if self._is_zero:
            return np.zeros((len(states), len(self.fits)))
        displacements = self._displacements(states, actions, free)
        return self._functions.predict(
            states, actions, displacements, self._coefficients, self._limits, commands
        )

    def _describe(
        self,
        log: ContinuousTransitions,
        actions: IntArray,
        shares: Array | None,
        is_smooth: BoolArray,
        is_free: BoolArray,
    ) -> tuple[Coordinate, ...]:
        """Return a ``Coordinate`` for each target.

        Rows to which g was not fitted count by what it leaves of them.
        """
        scatter = self._scatter
        left = root_mean_square(self.left_over)
        residual = root_mean_square(self.residuals)
        squares = (self.residuals**2).sum(axis=0)
        rough = (self.left_over[~is_smooth] ** 2).sum(axis=0)
        moved = shortest(log.next_state - log.state, self._periods).std(axis=0)
        reward_deviation = 0.0 if log.reward is None else log.reward.std()
        displaced = np.append(moved, reward_deviation)[: len(left)]
        effects = [HistoryEffect() for _ in left]
        least = MIN_HIDDEN_DEVIATIONS * displaced
        self.odd_starts = odd_starts(log, self.left_over, least)
        if (left * scatter.drawn > least).any():
            effects = history_effects(
                self.task,
                log,
                actions,
                self.left_over,
                self._group,
                is_smooth=is_smooth,
                is_free=is_free,
                least=least,
                shares=shares,
            )
        coordinates = []
        names = (*self.state_names, "reward")
        for k, (name, fit) in enumerate(zip(names, self.fits, strict=False)):
            explained = 0.0
            if squares[k] > 0:
                explained = float(1.0 - (fit.error + rough[k]) / squares[k])
            coordinate = Coordinate(
                name=name,
                kind=fit.kind,
                per_action=fit.per_action,
                t_statistic=fit.t_statistic,
                simulator_scatter=float(scatter.spread[k]),
                residual_scatter=float(residual[k]),
                left_over=float(left[k]),
                displacement=float(displaced[k]),
                explained=explained,
                scatter=scatter.source(k),
                history=effects[k] if scatter.drawn[k] else HistoryEffect(),
            )
            coordinates.append(coordinate)
        return tuple(coordinates)

    def resampled(self, seed: Seed = None) -> ResidualSimulator:
        """Return the simulator corrected by a bootstrap's log.

        Parameters
        ----------
        seed : int, Generator or SeedSequence, optional
            The source of random numbers. The same seed gives the same bits.

        Returns
        -------
        ResidualSimulator
            The same with g fitted to groups of whole episodes drawn with replacement.
            The classes of g are chosen anew, by the held-out errors of the groups that
            were drawn.
        """
        weights = draw_groups(len(self._grams.g), seed)
        again = copy.copy(self)
        again._set_fits(self._grams.refit(weights))
        again._scatter = self._scatter.reweighted(weights[self._group[self._is_free]])
        return again

    @property
    def rewards(self) -> tuple[float, float]:
        """Return the least and the largest reward that is known.

        Known are those of the log and of the simulator's own steps from its rows.
        """
        return float(self._known_rewards.min()), float(self._known_rewards.max())

    @property
    def hidden_part(self) -> float:
        """Return the largest part of a step, in its deviations, that history explains.

        It is 0 where the state is Markov.
        """
        return max(
            (c.history.part / c.displacement for c in self.coordinates if c.hidden),
            default=0.0,
        )

    @property
    def held_out_error(self) -> float:
        """Return the mean square one-step error on held-out episodes.

        It is in units of the displacement's variance, summed over coordinates.
        """
        return sum(c.unexplained for c in self.coordinates)

    def beyond(self, states: Array) -> BoolArray:
        """Return which states have a feature outside the range of the log's.

        Parameters
        ----------
        states : ndarray of shape (n, d)
            The states.

        Returns
        -------
        ndarray of bool, shape (n,)
            Whether no data support g there.
        """
        features = self.task.features(states)
        low, high = self._range
        return np.asarray(((features < low) | (features > high)).any(axis=1))

    @one_thread
    def moves(self, states: Array, actions: IntArray, disturbance: Array) -> Moves:
        """Take one corrected step from each state.

        Parameters
        ----------
        states : ndarray of shape (n, d)
            The states.
        actions : ndarray of int, shape (n,)
            The number of the action in each state.
        disturbance : ndarray of shape (n, n_disturbances)
            The disturbance xi, whose last component chooses e where that is drawn from
            the log.

        Returns
        -------
        Moves
            The next states, the rewards, and whether the next states are terminal.
        """
        actions = np.asarray(actions, dtype=np.int64)
        scatter = self._scatter
        own = self.task.noiseless_step(states, actions)
        free = own.next_state
        if not self._is_zero:
            free = free_steps(self._stops, self.task, states, actions, own.next_state)
        added = self._correction(states, actions, free)
        if scatter.drawn.any():
            uniform = ndtr(disturbance[:, -1])
            added += draw_residuals(scatter, states, actions, uniform)
        moved = free + added[:, : self.n_state]
        following = push_steps(self._stops, self._pushes, moved)
        if scatter.own.any():
            xi = disturbance[:, : self.task.n_disturbances]
            noise = self.task.moves(states, actions, xi).next_state - own.next_state
            following += np.where(scatter.own[: self.n_state], noise, 0.0)
        if self._wraps.any() or np.isfinite(self._stops.bounds).any():
            # what the correction left as it was keeps the simulator's bits
            is_changed = following != own.next_state
            following = np.where(is_changed, self._clip(following), following)
        following = hold_steps(self._stops, following)
        ends = own.terminated
        if self.terminates and self._knows_ends:
            ends = self.task.terminated(following)
        elif self.terminates:
            every = np.arange(len(self._known_ends))
            ends = self._known_ends[self._neighbors.find(following, every, key=None)]
        reward = self._reward(states, actions, following, ends, own, added)
        return Moves(following, reward, ends)

    def step(self, states: Array, actions: IntArray, rng: np.random.Generator) -> Moves:
        """Take one random step from each state.

        Parameters
        ----------
        states : ndarray of shape (n, d)
            The states.
        actions : ndarray of int, shape (n,)
            The number of the action in each state.
        rng : numpy.random.Generator
            The source of random numbers.

        Returns
        -------
        Moves
            The next states, the rewards, and whether the next states are terminal.

        Notes
        -----
        What chooses e is a stream of its own, so that ``rng`` gives the same numbers
        that it gives to the task.
        """
        xi = rng.standard_normal((len(states), self.task.n_disturbances))
        if self._scatter.drawn.any():
            xi = np.column_stack([xi, rng.spawn(1)[0].standard_normal(len(states))])
        return self.moves(states, actions, xi)

    def _clip(self, following: Array) -> Array:
        """Return next states within the stops and, if the task's are, within a turn."""
        inside = np.clip(following, *self._stops.bounds)
        periods = np.where(self._wraps, self._periods, 1.0)
        turned = self._start + (inside - self._start) % periods
        return np.where(self._wraps, turned, inside)

    def _reward(
        self,
        states: Array,
        actions: IntArray,
        following: Array,
        ends: BoolArray,
        own: Moves,
        added: Array,
    ) -> Array:
        """Compute the rewards of steps.

        They are r(s, a, s') where the task knows it; otherwise the simulator's own with
        what was learned, or that of the nearest step that ended alike.
        """
        known = self.task.reward_between(states, actions, following)
        if known is not None:
            return known
        if added.shape[1] > self.n_state:
            reward = own.reward + added[:, -1]
        else:
            reward = own.reward.copy()
        for end in (False, True):
            rows = np.flatnonzero((ends == end) & (own.terminated != end))
            alike = np.flatnonzero(self._known_ends == end)
            if len(rows) and len(alike):
                nearest = self._neighbors.find(following[rows], alike, key=end)
                reward[rows] = self._known_rewards[nearest]
        return reward

    def parameters(self) -> dict[str, Any]:
        """Return the task's parameters, and what the correction is made of.

        Returns
        -------
        dict
            The parameters, with the number of transitions and the class of each
            coordinate's correction.
        """
        learned = {c.name: [c.kind, c.per_action, c.scatter] for c in self.coordinates}
        return self.task.parameters() | {
            "corrected_by_moves": len(self.residuals),
            "correction": learned,
        }

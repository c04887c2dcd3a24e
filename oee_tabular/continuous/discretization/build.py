"""Continuous tasks as finite MDPs, on a grid or on cells of visited states.

States s in R^d with features phi(s), cells j = 1, ..., N with weights w_j(phi) that sum
to 1 over j, and pairs x_k at which the task is stepped (``cells.Places``):

    P(j | i, a) = sum_k W_{(i,a),k} E_xi[w_j(phi(f(x_k, xi)))],
    r(i, a) = sum_k W_{(i,a),k} E_xi[r(x_k, xi)],
    pi(a | i) = mean of pi(a | s) over the states of cell i

Another task stepped at the same places has the same states; a ratio between the two
differs from 1 by their dynamics alone. A log becomes soft counts n(i, a, j) = sum over
its rows of w_i(s) w_j(s') (``Discretization.counts``) or numbered transitions drawn by
these weights (``encode``), so that the ratio of the target's and the simulator's
transitions is a matrix as it is for any finite MDP. Where episodes can end, one
absorbing state without rewards, the last, stands for all terminal states.

What is exact: the mean of a step on a grid, and rewards r(s, a) at the places. What is
lost is measured (``closure_error``): the value of a policy on the cells minus its Monte
Carlo value in the task. No interval covers that error; ``calibrate`` takes out the part
that the simulator has itself.

``GridInterpolation``, up to a few dimensions: the Markov chain approximation of Munos
and Moore [1]. The mean of a step is exact, and its variance too large by f (1 - f) h^2
a step and coordinate, which is why a grid must be fine compared with the *step*, not
with the range. A log's states lie within the cells, not on the vertices, and soft
counts of its transitions spread wider than the vertices' own rows. For a ratio of
transition probabilities the simulator must be looked at in the same places: with a log
the row of (i, a) is the mean over the log's own (s, a), each weighed by w_i(s), of
where the *simulator* leads from there. The strength of a prior must then be given
(small): the evidence takes the rows for independent samples, finds them closer than
those would be, and believes the simulator. Where a command moves the features alike
everywhere (``task.is_translation_invariant``) it is the other way round: the rows are
the vertices' own, and the log's transitions are carried to the vertices.

``VisitedCells``, for four dimensions and more, where a uniform grid spends nearly all
its vertices where no episode goes: the Voronoi cells of centres put (by Lloyd's
iteration [2]) among states that a log or the simulator did visit. Some of these are
stepped under every action, and the log's under the action that was logged.

References: [1] R. Munos and A. Moore, Variable resolution discretization in optimal
control, Machine Learning 49, 2002. [2] S. Lloyd, Least squares quantization in PCM,
IEEE Transactions on Information Theory 28, 1982.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular._parallel import one_thread
from oee_tabular.continuous.discretization.cells import (
    Grid,
    Places,
    VoronoiCells,
    average_of_pairs,
    each_action,
    indicator,
    spread_over_pairs,
)
from oee_tabular.continuous.discretization.model import (
    Discretization,
    uniform_policy_of,
)
from oee_tabular.continuous.log.numbering import number_actions
from oee_tabular.continuous.log.transitions import ContinuousTransitions
from oee_tabular.continuous.task.base import (
    ContinuousTask,
    StatePolicy,
    check_states,
    require_log_of,
)
from oee_tabular.continuous.task.episodes import record
from oee_tabular.exceptions import ArgumentError, DiscretizationWarning
from oee_tabular.typing import Array, RealArrayLike, Seed

N_LLOYD = 3  # iterations for the centres of cells
N_BOX_POINTS = 4  # along each axis, where a state is the box around its vertex
DEFAULT_VERTICES = {1: 201, 2: 41, 3: 15}  # along each feature, by how many there are
DEFAULT_CELLS = 1000  # above
CLOSURE_TOLERANCE = 0.05  # share of the value: a larger closure error is warned about


@suggest_keywords
@dataclass(frozen=True)
class GridInterpolation:
    """A regular grid over a task's features, on whose vertices the states lie.

    It is what ``discretize(task, log, cells=GridInterpolation((60, 60)))`` takes.

    Parameters
    ----------
    shape : tuple of int
        The number of vertices along each of the k features, at least 2.
    low : array_like of shape (k,), optional
        The lower ends of the grid; by default the task's ``feature_low``.
    high : array_like of shape (k,), optional
        The upper ends of the grid; by default the task's ``feature_high``.
    noise_points : int, optional
        The number of Gauss-Hermite points for each component of the disturbance; 1
        leaves it at 0. None means the task's ``noise_points``.
    vertex_weight : float, default 0.01
        At a log, how many transitions the row of the vertex itself is worth beside the
        log's places.

    Raises
    ------
    ValueError
        If a number is out of its range.

    See Also
    --------
    VisitedCells : Cells for four features and more.

    Notes
    -----
    Costs A S 2^k entries for each noise point: 10^6 vertices with two actions in a few
    seconds and under a gigabyte.

    Examples
    --------
    >>> from oee_tabular.tasks import CartPole, discretize
    >>> model = discretize(CartPole(gravity=10.0), cells=GridInterpolation((60, 60)))
    >>> model.mdp.n_states, model.over
    (3601, 3600)
    """

    shape: tuple[int, ...]
    low: RealArrayLike | None = None
    high: RealArrayLike | None = None
    noise_points: int | None = None
    vertex_weight: float = 0.01

    def __post_init__(self) -> None:
        given = _checks.plain_array(self.shape, "shape")
        try:
            shape = tuple(_checks.positive_integer(n, "shape") for n in given)
        except TypeError:
            raise ArgumentError(
                "shape",
                f"must be a tuple of positive integers; got {_checks.show(self.shape)}",
            ) from None
        if not shape or min(shape) < 2:
            raise ArgumentError(
                "shape",
                f"must have at least 2 vertices along each feature; it is {shape}",
            )
        object.__setattr__(self, "shape", shape)
        _checks.number_in(self.vertex_weight, "vertex_weight", 0.0, np.inf)
        for name in ("low", "high"):
            if getattr(self, name) is not None:
                _checks.float_array(getattr(self, name), name, ndim=1)
        if self.noise_points is not None:
            _checks.positive_integer(self.noise_points, "noise_points")

    def places(
        self, task: ContinuousTask, log: ContinuousTransitions | None, *others: object
    ) -> Places:
        """Return the vertices and, at a log, its own states, with their actions.

        Parameters
        ----------
        task : ContinuousTask
            The task that is stepped there.
        log : ContinuousTransitions or None
            A log of the target.
        *others : object
            Not used; ``VisitedCells.places`` takes them.

        Returns
        -------
        Places
            The grid with the state-action pairs that are stepped.

        Raises
        ------
        ValueError
            If the grid does not fit the task's features.
        """
        k = len(task.feature_names)
        if len(self.shape) != k:
            raise ArgumentError(
                "shape",
                f"must have {k} numbers, one for each feature of {task.name}"
                f" ({', '.join(task.feature_names)}); it is {self.shape}",
            )
        low, high = _check_ends(
            task.feature_low if self.low is None else self.low,
            task.feature_high if self.high is None else self.high,
            k,
        )
        grid = Grid(low, high, self.shape, task.periodic)
        points = task.embed(grid.vertices())
        cell = np.arange(grid.n_cells)
        states, actions = each_action(task, points)
        averages = None
        if task.is_translation_invariant:
            line = (np.arange(N_BOX_POINTS) + 0.5) / N_BOX_POINTS - 0.5
            box = np.stack(np.meshgrid(*[line] * k, indexing="ij"), axis=-1)
            box = box.reshape(-1, k)
            spread = grid.vertices()[:, None] + box * grid.spacing
            points = task.embed(spread.reshape(-1, k))
            cell = np.repeat(cell, len(box))
        elif log is not None:
            own = check_states(task, log.state, "log.state")
            chosen = number_actions(task, log)
            inside = ~grid.outside(task.features(own))
            own = own[inside]
            chosen = chosen[inside]
            start = grid.weights(task.features(own))
            logged = spread_over_pairs(start, chosen, task.n_actions)
            # where the log has nothing, the row is the vertex's own
            vertex = np.where(logged.sum(axis=0) > 0, self.vertex_weight, 1.0)
            weights = sparse.vstack([sparse.diags_array(vertex), logged], format="csr")
            averages = average_of_pairs(weights)
            states = np.concatenate([states, own])
            actions = np.concatenate([actions, chosen])
        return Places(grid, states, actions, averages, points, cell, self.noise_points)


@suggest_keywords
@dataclass(frozen=True)
class VisitedCells:
    """Voronoi cells of visited states, each of which is a state of the finite MDP.

    They are what ``discretize(task, log, cells=VisitedCells(3000))`` takes.

    Parameters
    ----------
    n_cells : int
        The largest number of cells; those in which no visited state lies are dropped.
    n_simulated : int, default 30000
        The number of states that the task and the ``others`` of ``discretize`` visit by
        themselves under its ``policies``, for what the log leaves out.
    n_stepped : int, default 60000
        The number of these states that are stepped under every action; the log's are
        under the logged one as well.
    max_steps : int, default 100
        The longest episode; states of the log later than this do not shape the cells.

    Raises
    ------
    ValueError
        If a number is not a positive integer.

    See Also
    --------
    GridInterpolation : A regular grid, for up to three features.

    Notes
    -----
    The same log, policies and seed give the same cells. Costs 3 (n + n_simulated) + A
    n_stepped nearest-cell searches, for each task.

    Examples
    --------
    >>> from oee_tabular.tasks import CartPole, cartpole_policy, discretize
    >>> model = discretize(
    ...     CartPole(form="full"),
    ...     cells=VisitedCells(200),
    ...     policies=[cartpole_policy(0.3)],
    ...     closure_episodes=0,
    ... )
    >>> model.mdp.n_states
    201
    """

    n_cells: int
    n_simulated: int = 30_000
    n_stepped: int = 60_000
    max_steps: int = 100

    def __post_init__(self) -> None:
        for name in ("n_cells", "n_simulated", "n_stepped", "max_steps"):
            _checks.positive_integer(getattr(self, name), name)

    def places(
        self,
        task: ContinuousTask,
        log: ContinuousTransitions | None,
        others: Sequence[ContinuousTask],
        policies: Sequence[StatePolicy],
        seed: Seed,
    ) -> Places:
        """Return cells of visited states, and some of the states under each action.

        Parameters
        ----------
        task : ContinuousTask
            The task that is stepped there.
        log : ContinuousTransitions or None
            A log of the target, whose states are among the visited ones.
        others : sequence of ContinuousTask
            Tasks that visit states as well.
        policies : sequence of functions
            The policies under which the tasks visit states.
        seed : int, Generator or SeedSequence
            The source of random numbers. The same seed gives the same bits.

        Returns
        -------
        Places
            The cells with the state-action pairs that are stepped.
        """
        rng = _checks.generator(seed)
        points = visited_states(
            [task, *others],
            policies,
            self.n_simulated,
            max_steps=self.max_steps,
            seed=rng,
        )
        if log is not None:
            own = check_states(task, log.state, "log.state")
            early = own if log.timestep is None else own[log.timestep < self.max_steps]
            points = np.concatenate([early, points])
        cells = self._cells(task.features(points), rng)
        cell = cells.nearest(task.features(points))[0]
        one_each = np.unique(cell, return_index=True)[1]
        drawn = rng.permutation(len(points))[: max(0, self.n_stepped - len(one_each))]
        # each once: a state that counted twice would pull the row of its cell
        chosen = np.union1d(one_each, drawn)
        states, actions = each_action(task, points[chosen])
        start = np.repeat(cell[chosen], task.n_actions)
        if log is not None:
            states = np.concatenate([states, own])
            actions = np.append(actions, number_actions(task, log))
            start = np.append(start, cells.nearest(task.features(own))[0])
        pairs = indicator(
            start * task.n_actions + actions, cells.n_cells * task.n_actions
        )
        averages = average_of_pairs(pairs)
        return Places(
            cells,
            states,
            actions,
            averages,
            points,
            cell,
            seed=int(rng.integers(2**62)),
        )

    def _cells(self, features: Array, rng: np.random.Generator) -> VoronoiCells:
        """Return cells whose centres Lloyd's iteration puts among points (m, k)."""
        spread = features.std(axis=0)
        scale = np.where(spread > 0, spread, 1.0)
        points = features / scale
        unique = np.unique(points, axis=0)
        centres = unique[rng.permutation(len(unique))[: self.n_cells]]
        for _ in range(N_LLOYD):
            number = cKDTree(centres).query(points)[1]
            n = np.bincount(number, minlength=len(centres))
            sums = [np.bincount(number, column, len(centres)) for column in points.T]
            total = np.stack(sums, axis=1)
            centres = total[n > 0] / n[n > 0, None]
        distance, number = cKDTree(centres).query(points)
        kept = centres[np.unique(number)]
        return VoronoiCells(kept * scale, scale, float(np.max(distance)))


# where the states lie: vertices along each feature, a number of visited cells, or the
# places of another discretisation
CellsLike: TypeAlias = (
    int | tuple[int, ...] | GridInterpolation | VisitedCells | Discretization
)


def _require_tasks(tasks: object, name: str) -> list[ContinuousTask]:
    """Return a collection of continuous tasks as a list."""
    return [
        _checks.instance(task, ContinuousTask, f"{name}[{k}]")
        for k, task in enumerate(
            _checks.collection(tasks, name, "a sequence of continuous tasks")
        )
    ]


def _require_policies(policies: object, name: str) -> list[StatePolicy]:
    """Return a collection of functions of states as a list."""
    every = _checks.collection(policies, name, "a sequence of functions of states")
    for k, policy in enumerate(every):
        _checks.function(policy, f"{name}[{k}]")
    return list(every)


def visited_states(
    tasks: Sequence[ContinuousTask],
    policies: Sequence[StatePolicy],
    n: int,
    *,
    max_steps: int,
    seed: Seed,
) -> Array:
    """Draw states before each transition from every task under every policy.

    Parameters
    ----------
    tasks : sequence of ContinuousTask
        The tasks that the cells must serve: the simulator under several parameters
        (never the target's data).
    policies : sequence of functions
        The policies: of states (n, d) they give probabilities (n, A).
    n : int
        How many states in all, in equal parts from each task under each policy.
    max_steps : int
        The longest episode.
    seed : int, Generator or SeedSequence
        The source of random numbers. The same seed gives the same bits.

    Returns
    -------
    ndarray of shape (n, d)
        The states.

    Raises
    ------
    ValueError
        If there are no tasks or no policies, or a number is not a positive integer.

    Examples
    --------
    >>> from oee_tabular.tasks import CartPole, cartpole_policy
    >>> visited_states(
    ...     [CartPole(5.0), CartPole(20.0)],
    ...     [cartpole_policy(0.3)],
    ...     1000,
    ...     max_steps=100,
    ...     seed=0,
    ... ).shape
    (1000, 4)
    """
    size = _checks.positive_integer(n, "n")
    _checks.positive_integer(max_steps, "max_steps")
    several = _require_tasks(tasks, "tasks")
    pairs = [
        (task, policy)
        for task in several
        for policy in _require_policies(policies, "policies")
    ]
    if not pairs:
        raise ValueError(
            "tasks and policies must have at least one each; one of them is empty"
        )
    each = -(-size // len(pairs))
    streams = _checks.generator(seed).spawn(len(pairs))
    visited = []
    for (task, policy), stream in zip(pairs, streams, strict=True):
        log = record(task, policy, n_transitions=each, max_steps=max_steps, seed=stream)
        visited.append(log.state)
    return np.concatenate(visited)[:size]


@suggest_keywords
@one_thread
def discretize(
    task: ContinuousTask,
    log: ContinuousTransitions | None = None,
    *,
    cells: CellsLike | None = None,
    floor: float = 0.0,
    others: Sequence[ContinuousTask] | None = None,
    policies: Sequence[StatePolicy] = (),
    discount: float = 0.99,
    closure_episodes: int = 2000,
    seed: Seed = 0,
) -> Discretization:
    """Make a FiniteMDP on numbered states of a continuous task.

    Ratios of transition probabilities are then matrices there too.

    Parameters
    ----------
    task : ContinuousTask
        The simulator.
    log : ContinuousTransitions, optional
        A log of the target, at whose states and actions the task is stepped. Its next
        states are used for a ``floor`` alone.
    cells : int, tuple, GridInterpolation, VisitedCells or Discretization, optional
        Where the states lie: (n_1, ..., n_k) vertices along each feature or
        ``GridInterpolation``; a number of cells or ``VisitedCells``; another
        Discretization, whose states and places are taken. None means the task's own, or
        else a grid up to three features and 1000 visited cells above.
    floor : float, default 0.0
        The probability in [0, 1] that the model gives to outcomes other than the
        task's. They are those of the ``others``. If there are no others, they are the
        log's transitions that are impossible in the task
        (``FiniteMDP.with_support_of``).
    others : sequence of ContinuousTask, optional
        The task under other parameters, which should bracket the target's. None means
        the task's own ``others()``.
    policies : sequence of functions, default ()
        The policies whose states the cells must serve: of states (n, d) they give
        probabilities (n, A). By default the uniform policy.
    discount : float, default 0.99
        The discount of the MDP, in [0, 1].
    closure_episodes : int, default 2000
        The number of episodes of the uniform policy in which the error of the
        discretisation (the closure error) is measured. 0 means that it is not measured.
    seed : int, Generator or SeedSequence, default 0
        The seed of the visited states and of the random disturbances.

    Returns
    -------
    Discretization
        The finite MDP with its encoding.

    Raises
    ------
    ValueError
        If the cells do not fit the task's features, the task's step leaves the finite
        numbers, the log has other states, or there is a floor without a log and without
        others.

    Warns
    -----
    DiscretizationWarning
        If the closure error is beyond 5%.

    See Also
    --------
    corrected_value : A value without cells.

    Notes
    -----
    A floor makes a defensive simulator, which gives probability to what the target may
    do. It is another simulator: results made with it say so (``metadata``), and
    ``plain`` is the one without. A ratio is at most K / floor wherever the target lies
    in the convex hull of the K others.

    Examples
    --------
    >>> from oee_tabular.tasks import CartPole, cartpole_policy, record
    >>> log = record(
    ...     CartPole(15.0),
    ...     cartpole_policy(0.3),
    ...     n_transitions=2000,
    ...     max_steps=100,
    ...     seed=0,
    ... )
    >>> model = discretize(CartPole(10.0), log, cells=(32, 32), floor=0.001)
    >>> model.mdp
    FiniteMDP(1025 states, 2 actions, 12337 transitions, rewards r(s, a), discount 0.99)
    >>> model.supported(model.counts(log))[1]
    0.0
    """
    _checks.instance(task, ContinuousTask, "task")
    share = _checks.number_in(floor, "floor", 0.0, 1.0)
    visiting = _require_policies(policies, "policies")
    if log is not None:
        require_log_of(task, log)
    process = task.on_features()
    if others is None:
        mixed = list(process.others())
    else:
        mixed = [other.on_features() for other in _require_tasks(others, "others")]
    if share > 0.0 and not mixed:
        _checks.number_in(floor, "floor", 0.0, 1.0, open_ends=True)
        if log is None:
            raise ArgumentError(
                "floor",
                f"must be 0 without a log, for {task.name} has no others; it is"
                f" {floor}",
            )
    chosen = _check_cells(_choose_cells(process) if cells is None else cells)
    if isinstance(chosen, Discretization):
        places = chosen.places
    else:
        visiting = visiting or [uniform_policy_of(task)]
        places = chosen.places(
            process, log if process is task else None, mixed, visiting, seed
        )
    if share == 0.0 and others is None:
        mixed = []
    initial = _initial_distribution(process, places)
    simulators = tuple(
        places.simulate(each, initial, discount) for each in (process, *mixed)
    )
    metadata = {
        "task": task.name,
        "parameters": task.parameters(),
        "features": list(task.feature_names),
        "cells": places.cells.extent(),
        "floor": share,
        "others": [other.parameters() for other in mixed],
    }
    model = Discretization(simulators[0], process, places, simulators, metadata)
    if not _checks.is_zero(closure_episodes):
        model = _measure_closure(
            model, _checks.positive_integer(closure_episodes, "closure_episodes")
        )
    model = replace(model, task=task)
    if share == 0.0:
        return model
    if mixed or log is None:
        shares = np.full(1 + len(mixed), share / len(mixed))
        shares[0] = 1.0 - share
        return model.mixture(shares)
    # ``encode`` and ``counts`` warn of states outside again, where they are called
    with warnings.catch_warnings(action="ignore"):
        counts = model.counts(log, outside="nearest")
    return replace(model, mdp=model.plain.with_support_of(counts, share))


def _initial_distribution(task: ContinuousTask, places: Places) -> Array:
    """Return the probability (S,) with which an episode begins in each state.

    None begins in the last state, which is the end of a task that terminates.
    """
    starts, mass = task.initial_points()
    weights = places.cells.weights(task.features(starts))
    inner = np.asarray(weights.T @ mass)
    return np.append(inner / inner.sum(), np.zeros(int(task.terminates)))


def _check_ends(low: object, high: object, k: int) -> tuple[Array, Array]:
    """Return the least and the largest features (k,) of a grid, the former below."""
    ends = {"low": _checks.float_array(low, "low")}
    ends["high"] = _checks.float_array(high, "high")
    for name, end in ends.items():
        if end.shape != (k,):
            raise ArgumentError(
                name, f"must have shape ({k},); it has shape {end.shape}"
            )
        _checks.require_finite(end, name)
    for axis in np.flatnonzero(ends["low"] >= ends["high"]):
        raise ArgumentError(
            f"high[{axis}]",
            f"must be above low[{axis}], {ends['low'][axis]}; it is"
            f" {ends['high'][axis]}",
        )
    return ends["low"], ends["high"]


def _check_cells(cells: Any) -> Discretization | GridInterpolation | VisitedCells:
    """Return cells as what makes them: a number, a grid's shape, or such a thing."""
    if isinstance(cells, bool):
        raise ArgumentError("cells", f"must be a number or a grid; got {cells}")
    if _checks.is_integer(cells):
        return VisitedCells(int(cells))
    if isinstance(cells, Discretization | GridInterpolation | VisitedCells):
        return cells
    try:
        return GridInterpolation(cells)
    except ArgumentError as error:
        raise ArgumentError("cells", error.rule) from None


def _choose_cells(task: ContinuousTask) -> CellsLike:
    """Return the task's own cells, or those for its number of features."""
    if task.default_cells is not None:
        return task.default_cells
    k = len(task.feature_names)
    return (DEFAULT_VERTICES[k],) * k if k in DEFAULT_VERTICES else DEFAULT_CELLS


def _measure_closure(model: Discretization, n_episodes: int) -> Discretization:
    """Return the model with the uniform policy's closure error.

    It warns where the error is beyond the tolerance and Monte Carlo's own error.
    """
    try:
        error, noise = model.closure_error(n_episodes=n_episodes)
    except ArgumentError as refusal:
        if refusal.argument != "n_episodes":
            raise
        raise ArgumentError("closure_episodes", refusal.rule) from None
    if abs(error) > CLOSURE_TOLERANCE + 2.0 * noise:
        text = (
            f"{model.cells.extent()} is too coarse for the steps of {model.task.name}:"
            f" the uniform policy's value on it has a closure error of {error:+.1%}"
            f" (+-{noise:.1%}) against Monte Carlo"
        )
        if isinstance(model.cells, Grid):
            task = model.task
            grid = model.cells
            some = slice(None, None, max(1, len(model.places.states) // 2000))
            states = model.places.states[some]
            actions = model.places.actions[some]
            moved = task.noiseless_step(states, actions).next_state
            length = np.abs(task.features(moved) - task.features(states))
            period = np.where(grid.periodic, grid.high - grid.low, np.inf)
            shorter = np.minimum(length, np.abs(period - length))
            median = np.median(shorter / grid.spacing, axis=0)
            steps = ", ".join(
                f"{name} {step:.2g}"
                for name, step in zip(task.feature_names, median, strict=True)
            )
            text += (
                f"; the median step, in spacings: {steps}. A step well below 1 is"
                " smeared out by interpolation: take more points there"
            )
        _checks.warn(text, DiscretizationWarning)
    measured = {"closure_error": error, "closure_standard_error": noise}
    return replace(model, diagnostics=measured)

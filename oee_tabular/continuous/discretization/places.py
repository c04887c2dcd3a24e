"""Where a continuous task is stepped (``Places``), and the two ways to choose it.

``GridInterpolation``, up to a few dimensions: the Markov chain approximation of Munos and Moore [1]. The mean of a step is
exact, and its variance too large by f (1 - f) h^2 a step and coordinate, which is why a grid must be fine compared with the
*step*, not with the range. A log's states lie within the cells, not on the vertices, and soft counts of its transitions spread
wider than the vertices' own rows. For a ratio of transition probabilities the simulator must be looked at in the same places:
with a log the row of (i, a) is the mean over the log's own (s, a), each weighed by w_i(s), of where the *simulator* leads from
there. The strength of a prior must then be given (small): the evidence takes the rows for independent samples, finds them
closer than those would be, and believes the simulator. Where a command moves the features alike everywhere
(``task.is_translation_invariant``) it is the other way round: the rows are the vertices' own, and the log's transitions are
carried to the vertices.

``VisitedCells``, for four dimensions and more, where a uniform grid spends nearly all its vertices where no episode goes: the
Voronoi cells of centres put (by Lloyd's iteration [2]) among states that a log or the simulator did visit. Some of these are
stepped under every action, and the log's under the action that was logged.

References: [1] R. Munos and A. Moore, Variable resolution discretization in optimal control, Machine Learning 49, 2002.
[2] S. Lloyd, Least squares quantization in PCM, IEEE Transactions on Information Theory 28, 1982.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from oee_tabular import _checks
from oee_tabular._checks import Array, BoolArray, IntArray
from oee_tabular._progress import progress_bar
from oee_tabular._sparse import canonical, csr_on_pattern, row_of_entry, row_sums
from oee_tabular.continuous.discretization.cells import Grid, VoronoiCells, indicator
from oee_tabular.continuous.episodes import record
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.task import ContinuousTask, StatePolicy, check_states
from oee_tabular.mdp import FiniteMDP

PLACES_AT_A_TIME = 250_000  # bounds the memory
N_LLOYD = 3  # iterations for the centres of cells
POINTS_OF_A_BOX = 4  # along each axis, where a state is the box around its vertex


@dataclass(frozen=True, eq=False)
class Places:
    """Cells, the state-action pairs that are stepped, and how a row is the mean of them.

    Attributes
    ----------
    cells : Grid or VoronoiCells, where the numbered states lie
    states, actions : (m, d), (m,) the pairs that are stepped
    averages : csr (n_cells * A, m), W; None where pair k is row k
    points, point_cell : (p, d), (p,) states that stand for the cells: policies and costs are means over them
    noise_points : Gauss-Hermite points of each disturbance; None: the stepped task's
    seed : of one draw of the disturbances for each pair, in place of those points; None: no draws
    """

    cells: Any
    states: Array
    actions: IntArray
    averages: sparse.csr_array | None
    points: Array
    point_cell: IntArray
    noise_points: int | None = None
    seed: int | None = None

    def mean(self, values: Array) -> Array:
        """(n_cells, ...) the mean over each cell of values (p, ...), one for each point."""
        p = len(self.point_cell)
        matrix = sparse.csr_array((np.ones(p), (self.point_cell, np.arange(p))), shape=(self.cells.n_cells, p))
        return np.asarray(((matrix @ values).T / np.diff(matrix.indptr)).T)

    def weights(self, task: ContinuousTask, states: Array, ended: BoolArray) -> sparse.csr_array:
        """(n, S) how states are shared out among the numbered ones; what has ended lies in the absorbing state, the last."""
        inner = self.cells.weights(task.features(states))
        if not task.terminates:
            return inner
        inner = sparse.csr_array(sparse.diags_array(np.where(ended, 0.0, 1.0)) @ inner)
        last = sparse.csr_array(ended[:, None].astype(np.float64))
        return canonical(sparse.hstack([inner, last]), drop_zeros=True)

    def simulate(self, task: ContinuousTask, initial: Array, discount: float) -> FiniteMDP:
        """The FiniteMDP of a task that is stepped at these places."""
        rng = None if self.seed is None else np.random.default_rng(self.seed)
        parts = progress_bar("stepping", range(0, len(self.states), PLACES_AT_A_TIME))
        blocks = [self._step(task, slice(low, low + PLACES_AT_A_TIME), rng) for low in parts]
        matrix = sparse.csr_array(sparse.vstack([block for block, _ in blocks], format="csr"))
        paid = np.concatenate([rewards for _, rewards in blocks])
        if self.averages is not None:
            matrix, paid = sparse.csr_array(self.averages @ matrix), np.asarray(self.averages @ paid)
        paid = paid.reshape(-1, task.n_actions)
        if task.terminates:
            last = np.eye(1, matrix.shape[1], matrix.shape[1] - 1)
            stay = sparse.csr_array(np.repeat(last, task.n_actions, axis=0))
            matrix = sparse.csr_array(sparse.vstack([matrix, stay], format="csr"))
            paid = np.concatenate([paid, np.zeros((1, task.n_actions))])
        return self.finite_mdp(task, matrix, paid, initial, discount)

    def finite_mdp(self, task: ContinuousTask, matrix: Any, paid: Array, initial: Array, discount: float) -> FiniteMDP:
        """The FiniteMDP of rows, which are normalised, and rewards r(s, a).

        Rewards of a task with ``reward_terms`` are those of the cells' mean terms, r(i, a, j): they telescope on cells as they
        do in the task. Taken transition by transition, their mean error would add up.
        """
        matrix = canonical(matrix, drop_zeros=True)
        rows, rewards = row_of_entry(matrix), paid
        matrix = csr_on_pattern(matrix, matrix.data / row_sums(matrix)[rows], own=True)
        terms = task.reward_terms(self.points)
        if terms is not None:
            mean, (state, action) = self.mean(terms), np.divmod(rows, task.n_actions)
            between = task.reward_of(mean[state], action, mean[matrix.indices])
            first = between[matrix.indptr[:-1]]
            is_of_pair = np.array_equal(between, first[rows])
            rewards = first.reshape(paid.shape) if is_of_pair else csr_on_pattern(matrix, between)
        return FiniteMDP(matrix, rewards, initial, discount)

    def _step(
        self, task: ContinuousTask, part: slice, rng: np.random.Generator | None
    ) -> tuple[sparse.csr_array, Array]:
        """Where some of the pairs lead, and what they pay, on average over the disturbances."""
        states, actions = self.states[part], self.actions[part]
        if rng is None:
            points = task.noise_points if self.noise_points is None else self.noise_points
            nodes, chances = gauss_hermite(points, task.n_disturbances)
            draws = [np.broadcast_to(node, (len(states), len(node))) for node in nodes]
        else:
            draws, chances = [rng.standard_normal((len(states), task.n_disturbances))], np.ones(1)
        gone = task.terminated(states)
        total: Any = 0.0
        paid = np.zeros(len(states))
        for disturbance, chance in zip(draws, chances, strict=True):
            moved = task.moves(states, actions, disturbance)
            bad = np.flatnonzero(~np.isfinite(moved.next_state).all(axis=1))
            if bad.size:
                raise ValueError(
                    f"task must step to finite states; from {states[bad[0]].tolist()} under action {actions[bad[0]]} it "
                    f"steps to {moved.next_state[bad[0]].tolist()}"
                )
            ended = moved.terminated & task.end_shows(moved.next_state) | gone
            total = total + chance * self.weights(task, moved.next_state, ended)
            paid += chance * np.where(gone, 0.0, moved.reward)
        return sparse.csr_array(total), paid


def gauss_hermite(points: int, n: int) -> tuple[Array, Array]:
    """Nodes (m, n) and weights (m,) that average over N(0, I_n): exact for polynomials of degree 2 points - 1.

    >>> nodes, weights = gauss_hermite(3, 2)
    >>> round(float(weights @ nodes[:, 0] ** 4), 12), len(nodes)
    (3.0, 9)
    """
    line, chance = np.polynomial.hermite_e.hermegauss(_checks.positive_integer(points, "noise_points"))
    nodes, weights = (np.array(list(itertools.product(x, repeat=n))) for x in (line, chance / chance.sum()))
    return nodes, weights.prod(axis=1)


def each_action(task: ContinuousTask, states: Array) -> tuple[Array, IntArray]:
    """Each state under each action, in rows s*A + a."""
    return np.repeat(states, task.n_actions, axis=0), np.tile(np.arange(task.n_actions), len(states))


def spread_over_pairs(start: sparse.csr_array, actions: IntArray, n_actions: int) -> sparse.csr_array:
    """(n, S * A) the weights (n, S) of states that are left by actions (n,), in the columns of the pairs s*A + a."""
    pairs = start.indices.astype(np.int64) * n_actions + np.repeat(actions, np.diff(start.indptr))
    return sparse.csr_array((start.data, pairs, start.indptr), shape=(len(actions), start.shape[1] * n_actions))


def average_of_pairs(weights: sparse.csr_array) -> sparse.csr_array:
    """(S * A, m) W, of the weights (m, S * A) that stepped pairs have in the numbered ones."""
    return sparse.csr_array(sparse.diags_array(1.0 / weights.sum(axis=0)) @ weights.T)


@dataclass(frozen=True)
class GridInterpolation:
    """A regular grid over a task's features, for ``discretize(task, log, cells=GridInterpolation((60, 60)))``.

    Parameters
    ----------
    shape : vertices along each feature, at least 2
    low, high : (k,) the grid's range; default the task's ``feature_low`` and ``feature_high``
    noise_points : the number of Gauss-Hermite points for each component of the disturbance; 1 leaves it at 0; None: the task's
        ``noise_points``
    vertex_weight : at a log, how many transitions the row of the vertex itself is worth beside the log's places

    Notes
    -----
    Cost: A S 2^k entries for each noise point; 10^6 vertices with two actions in a few seconds and under a gigabyte.

    Examples
    --------
    >>> from oee_tabular.tasks import CartPole, discretize
    >>> model = discretize(CartPole(gravity=10.0), cells=GridInterpolation((60, 60)))
    >>> model.mdp.n_states, model.over
    (3601, 3600)
    """

    shape: tuple[int, ...]
    low: Any = None
    high: Any = None
    noise_points: int | None = None
    vertex_weight: float = 0.01

    def __post_init__(self) -> None:
        try:
            shape = tuple(_checks.positive_integer(n, "shape") for n in self.shape)
        except TypeError:
            raise ValueError(f"shape must be a tuple of positive integers; got {_checks.show(self.shape)}") from None
        if not shape or min(shape) < 2:
            raise ValueError(f"shape must have at least 2 vertices along each feature; it is {shape}")
        object.__setattr__(self, "shape", shape)
        _checks.number_in(self.vertex_weight, "vertex_weight", 0.0, np.inf)

    def grid(self, task: ContinuousTask) -> Grid:
        """The grid for the features of ``task``."""
        k = len(task.feature_names)
        if len(self.shape) != k:
            raise ValueError(
                f"shape must have {k} numbers, one for each feature of {task.name} ({', '.join(task.feature_names)}); "
                f"it is {self.shape}"
            )
        low = _checks.float_array(task.feature_low if self.low is None else self.low, "low")
        high = _checks.float_array(task.feature_high if self.high is None else self.high, "high")
        for name, end in (("low", low), ("high", high)):
            if end.shape != (k,):
                raise ValueError(f"{name} must have shape ({k},); it has shape {end.shape}")
            _checks.require_finite(end, name)
        for axis in np.flatnonzero(low >= high):
            raise ValueError(f"high[{axis}] must be above low[{axis}], {low[axis]}; it is {high[axis]}")
        return Grid(low, high, self.shape, task.periodic)

    def places(self, task: ContinuousTask, log: ContinuousTransitions | None, *others: object) -> Places:
        """The vertices under each action and, at a log, the log's own states and actions."""
        grid = self.grid(task)
        points, cell = task.embed(grid.vertices()), np.arange(grid.n_cells)
        states, actions = each_action(task, points)
        averages = None
        if task.is_translation_invariant:
            line = (np.arange(POINTS_OF_A_BOX) + 0.5) / POINTS_OF_A_BOX - 0.5
            box = np.stack(np.meshgrid(*[line] * len(self.shape), indexing="ij"), axis=-1).reshape(-1, len(self.shape))
            points = task.embed((grid.vertices()[:, None] + box * grid.spacing).reshape(-1, len(self.shape)))
            cell = np.repeat(cell, len(box))
        elif log is not None:
            own, chosen = check_states(task, log.state, "log.state"), log.action_numbers(task.actions)
            inside = ~grid.outside(task.features(own))
            own, chosen = own[inside], chosen[inside]
            logged = spread_over_pairs(grid.weights(task.features(own)), chosen, task.n_actions)
            vertex = np.where(logged.sum(axis=0) > 0, self.vertex_weight, 1.0)
            averages = average_of_pairs(sparse.vstack([sparse.diags_array(vertex), logged], format="csr"))
            states, actions = np.concatenate([states, own]), np.concatenate([actions, chosen])
        return Places(grid, states, actions, averages, points, cell, self.noise_points)


@dataclass(frozen=True)
class VisitedCells:
    """Voronoi cells of visited states, for ``discretize(task, log, cells=VisitedCells(3000))``.

    Parameters
    ----------
    n_cells : at most so many; cells in which no visited state lies are dropped
    n_simulated : states that the task and the ``others`` of ``discretize`` visit by themselves under its ``policies``, for what
        the log leaves out
    n_stepped : of all these states, how many are stepped under every action; the log's are under the logged one as well
    max_steps : longest episode; states of the log later than this do not shape the cells

    Notes
    -----
    The same log, policies and seed give the same cells. Cost: 3 (n + n_simulated) + A n_stepped nearest-cell searches, for each
    task.

    Examples
    --------
    >>> from oee_tabular.tasks import CartPole, cartpole_policy, discretize
    >>> model = discretize(CartPole(form="full"), cells=VisitedCells(200), policies=[cartpole_policy(0.3)], closure_episodes=0)
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
        seed: Any,
    ) -> Places:
        """Cells of the log's states and of those that the simulators visit, and some of these under each action."""
        rng = _checks.generator(seed)
        points = visited_states([task, *others], policies, self.n_simulated, max_steps=self.max_steps, seed=rng)
        if log is not None:
            own = check_states(task, log.state, "log.state")
            early = own if log.timestep is None else own[log.timestep < self.max_steps]
            points = np.concatenate([early, points])
        cells = self._cells(task.features(points), rng)
        cell = cells.nearest(task.features(points))[0]
        one_each = np.unique(cell, return_index=True)[1]
        drawn = rng.permutation(len(points))[: max(0, self.n_stepped - len(one_each))]
        chosen = np.union1d(one_each, drawn)  # each once: a state that counted twice would pull the row of its cell
        states, actions = each_action(task, points[chosen])
        start = np.repeat(cell[chosen], task.n_actions)
        if log is not None:
            states, actions = np.concatenate([states, own]), np.append(actions, log.action_numbers(task.actions))
            start = np.append(start, cells.nearest(task.features(own))[0])
        pairs = indicator(start * task.n_actions + actions, cells.n_cells * task.n_actions)
        averages = average_of_pairs(pairs)
        return Places(cells, states, actions, averages, points, cell, seed=int(rng.integers(2**62)))

    def _cells(self, features: Array, rng: np.random.Generator) -> VoronoiCells:
        """Centres among these points (m, k)."""
        spread = features.std(axis=0)
        scale = np.where(spread > 0, spread, 1.0)
        points = features / scale
        unique = np.unique(points, axis=0)
        centres = unique[rng.permutation(len(unique))[: self.n_cells]]
        for _ in range(N_LLOYD):
            number = cKDTree(centres).query(points)[1]
            n = np.bincount(number, minlength=len(centres))
            total = np.stack([np.bincount(number, column, len(centres)) for column in points.T], axis=1)
            centres = total[n > 0] / n[n > 0, None]
        distance, number = cKDTree(centres).query(points)
        return VoronoiCells(centres[np.unique(number)] * scale, scale, float(distance.max()))


def visited_states(
    tasks: Sequence[ContinuousTask], policies: Sequence[StatePolicy], n: int, *, max_steps: int, seed: Any
) -> Array:
    """(n, d) states before each transition, in equal parts from every task under every policy.

    Parameters
    ----------
    tasks : those that the cells must serve: the simulator under several parameters (never the target's data)
    policies : functions of states (n, d) giving probabilities (n, A)
    n : how many states in all
    max_steps : longest episode
    seed : the same seed gives the same bits

    Examples
    --------
    >>> from oee_tabular.tasks import CartPole, cartpole_policy
    >>> visited_states([CartPole(5.0), CartPole(20.0)], [cartpole_policy(0.3)], 1000, max_steps=100, seed=0).shape
    (1000, 4)
    """
    size = _checks.positive_integer(n, "n")
    pairs = [(task, policy) for task in tasks for policy in policies]
    if not pairs:
        raise ValueError("tasks and policies must have at least one each; one of them is empty")
    each = -(-size // len(pairs))
    found = [
        record(task, policy, n_transitions=each, max_steps=max_steps, seed=stream).state
        for (task, policy), stream in zip(pairs, _checks.generator(seed).spawn(len(pairs)), strict=True)
    ]
    return np.concatenate(found)[:size]

"""``discretize``: a continuous task as a FiniteMDP, with the encoding of logs and the measure of what it costs."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array
from oee_tabular._threads import one_thread
from oee_tabular.continuous.discretization.cells import Grid
from oee_tabular.continuous.discretization.model import Discretization, finite_mdp, uniform_policy_of
from oee_tabular.continuous.discretization.places import GridInterpolation, Places, VisitedCells
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.task import ContinuousTask, StatePolicy, require_log_of
from oee_tabular.mdp import FiniteMDP

DEFAULT_VERTICES = {1: 201, 2: 41, 3: 15}  # along each feature, by how many there are
DEFAULT_CELLS = 1000  # above
TOLERANCE = 0.05  # of the closure error: beyond it is warned about
SMALLEST_REACH = 2  # cells around where a step leads, over which a floor is spread
UNREACHED_SHARE = 1e-3  # of the log's transitions that a floor need not reach
MOST_ENTRIES = 2e7  # of a matrix with a floor


@one_thread
def discretize(
    task: ContinuousTask,
    log: ContinuousTransitions | None = None,
    *,
    cells: Any = None,
    floor: float = 0.0,
    others: Sequence[ContinuousTask] | None = None,
    policies: Sequence[StatePolicy] = (),
    discount: float = 0.99,
    closure_episodes: int = 2000,
    seed: Any = 0,
) -> Discretization:
    """A continuous task as a FiniteMDP on numbered states, so that ratios are matrices there too.

    Parameters
    ----------
    task : ContinuousTask, the simulator
    log : ContinuousTransitions of the target, at whose states and actions the task is stepped (its next states are not used,
        except to find how far a ``floor`` must reach)
    cells : where the states lie: (n_1, ..., n_k) vertices along each feature or ``GridInterpolation``; a number of cells or
        ``VisitedCells``; another Discretization, whose states and places are taken; None: the task's own, or a grid up to three
        features and 1000 visited cells above
    floor : with this probability a step is another one: one of the ``others``, or uniform over the cells near where the step
        leads and begins, as far as the log's transitions ask. A *defensive* simulator, which gives probability to what the
        target may do. It is another simulator: results made with it say so (``metadata``), and ``plain`` is the one without
    others : the task under other parameters, which should bracket the target's: a ratio is at most K / floor wherever the
        target lies in the convex hull of the K others. None: the task's own ``others()``
    policies : those whose states the cells must serve, functions of states (n, d) giving probabilities (n, A); none: uniform
    discount : of the MDP, in [0, 1]
    closure_episodes : of the uniform policy, by which what discretising costs is measured; 0: not measured
    seed : of visited states and random disturbances

    Raises
    ------
    ValueError
        Cells that do not fit the task's features; a task whose step leaves the finite numbers; a log of other states.

    Warns
    -----
    UserWarning
        Where the closure error is beyond 5%.

    Examples
    --------
    >>> from oee_tabular.tasks import CartPole, cartpole_policy, record
    >>> log = record(CartPole(15.0), cartpole_policy(0.3), n_transitions=2000, max_steps=100, seed=0)
    >>> model = discretize(CartPole(10.0), log, cells=(32, 32), floor=0.001)
    >>> model.mdp
    FiniteMDP(1025 states, 2 actions, 96779 transitions, rewards r(s, a), discount 0.99)
    >>> model.supported(model.counts(log))[1] < 0.001
    True
    """
    _checks.instance(task, ContinuousTask, "task")
    share = _checks.number_in(floor, "floor", 0.0, 1.0)
    if log is not None:
        require_log_of(task, log)
    process = task.on_features()
    mixed = list(process.others()) if others is None else [other.on_features() for other in others]
    if isinstance(cells, Discretization):
        places = cells.places
    else:
        visiting = list(policies) or [uniform_policy_of(task)]
        given = log if process is task else None
        places = _builder(cells, process).places(process, given, mixed, visiting, seed)
    if share == 0.0 and others is None:
        mixed = []
    initial = _initial(process, places)
    simulators = tuple(finite_mdp(process, places, *places.step(each), initial, discount) for each in (process, *mixed))
    metadata: dict[str, Any] = {"task": task.name, "parameters": task.parameters()}
    metadata |= {"features": list(task.feature_names)} | places.facts
    metadata |= {"floor": share, "others": [other.parameters() for other in mixed]}
    found = Discretization(simulators[0], process, places, simulators, (1.0,), metadata)
    if closure_episodes:
        found = _with_closure_error(found, _checks.positive_integer(closure_episodes, "closure_episodes"))
    found = replace(found, task=task)
    if not mixed:
        return _with_floor(found, process, share, log) if share > 0.0 else found
    weights = (1.0 - share, *[share / len(mixed)] * len(mixed))
    return found.mixture(weights) if share > 0.0 else replace(found, weights=weights)


def _builder(cells: Any, task: ContinuousTask) -> GridInterpolation | VisitedCells:
    chosen, k = task.default_cells if cells is None else cells, len(task.feature_names)
    if chosen is None:
        chosen = (DEFAULT_VERTICES[k],) * k if k in DEFAULT_VERTICES else DEFAULT_CELLS
    if isinstance(chosen, GridInterpolation | VisitedCells):
        return chosen
    is_number = isinstance(chosen, int | np.integer)
    return VisitedCells(int(chosen)) if is_number else GridInterpolation(chosen)


def _initial(task: ContinuousTask, places: Places) -> Array:
    """(S,) where episodes begin."""
    starts, mass = task.initial_points()
    initial = places.cells.weights(task.features(starts)).T @ mass
    return np.append(initial / initial.sum(), np.zeros(int(task.terminates)))


def _with_floor(
    model: Discretization, process: ContinuousTask, floor: float, log: ContinuousTransitions | None
) -> Discretization:
    """(1 - floor) P + floor (P + I) N / 2, N uniform near each cell: near where a step leads and, lest that is over, begins."""
    reach, plain = SMALLEST_REACH, model.plain
    begins = sparse.kron(sparse.eye_array(plain.n_states), np.ones((plain.n_actions, 1)), format="csr")
    around, counts = sparse.csr_array(0.5 * (plain.transitions + begins)), None
    if log is not None:
        with warnings.catch_warnings(action="ignore"):  # whoever encodes the log is told
            counts = model.counts(log, outside="nearest")
    while True:
        near = model.cells.neighbourhood(process, reach)
        matrix = sparse.csr_array((1.0 - floor) * plain.transitions + floor * (around @ near))
        mdp = FiniteMDP(matrix, plain.rewards, plain.initial, plain.discount)
        found = replace(model, mdp=mdp, metadata=model.metadata | {"reach": reach})
        is_all_near = near.nnz >= model.cells.n_cells**2
        if counts is None or is_all_near or 2.0 * matrix.nnz > MOST_ENTRIES:
            return found
        if found.supported(counts)[1] <= UNREACHED_SHARE:
            return found
        reach += max(1, reach // 2)


def _with_closure_error(model: Discretization, n_episodes: int) -> Discretization:
    """With the uniform policy's closure error, and a warning where it is beyond the tolerance and Monte Carlo's own error."""
    error, noise = model.closure_error(n_episodes=n_episodes)
    if abs(error) > TOLERANCE + 2.0 * noise:
        text = (
            f"{model.cells.extent()} is too coarse for the steps of {model.task.name}: the uniform policy's value on it has a "
            f"closure error of {error:+.1%} (+-{noise:.1%}) against Monte Carlo"
        )
        if isinstance(model.cells, Grid):
            steps = zip(model.task.feature_names, _median_step(model), strict=True)
            text += f"; the median step, in spacings: {', '.join(f'{name} {step:.2g}' for name, step in steps)}. A step well "
            text += "below 1 is smeared out by interpolation: take more points there"
        warnings.warn(text, stacklevel=4)
    return replace(model, diagnostics={"closure_error": error, "closure_standard_error": noise})


def _median_step(model: Discretization) -> Array:
    """(k,) the median length of a step from some of the places, in spacings of the grid."""
    task, grid, places = model.task, model.cells, model.places
    some = slice(None, None, max(1, len(places.states) // 2000))
    states = places.states[some]
    moved = task.moves(states, places.actions[some], np.zeros((len(states), task.n_disturbances)))
    length = np.abs(task.features(moved.next_state) - task.features(states))
    period = np.where(grid.periodic, grid.high - grid.low, np.inf)
    return np.asarray(np.median(np.minimum(length, np.abs(period - length)) / grid.spacing, axis=0))

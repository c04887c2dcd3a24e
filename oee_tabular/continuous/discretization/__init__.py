"""Continuous tasks as finite MDPs: ``discretize``, on a grid or on cells of visited states (places).

States s in R^d with features phi(s), cells j = 1, ..., N with weights w_j(phi) that sum to 1 over j, and pairs x_k at which
the task is stepped (places):

    P(j | i, a) = sum_k W_{(i,a),k} E_xi[w_j(phi(f(x_k, xi)))],     r(i, a) = sum_k W_{(i,a),k} E_xi[r(x_k, xi)],
    pi(a | i) = mean of pi(a | s) over the states of cell i

Another task stepped at the same places has the same states; a ratio between the two differs from 1 by their dynamics alone.
A log becomes soft counts n(i, a, j) = sum over its rows of w_i(s) w_j(s') (``Discretization.counts``) or numbered transitions
drawn by these weights (``encode``), so that the ratio of the target's and the simulator's transitions is a matrix as it is for
any finite MDP. Where episodes can end, one absorbing state that pays nothing, the last, stands for all that is over.

What is exact: the mean of a step on a grid, and rewards r(s, a) at the places. What is lost is measured (``closure_error``):
the value of a policy on the cells minus its Monte Carlo value in the task. No interval covers that error; ``calibrate`` takes
out the part that the simulator has itself.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._threads import one_thread
from oee_tabular.continuous.discretization.cells import Grid
from oee_tabular.continuous.discretization.model import Discretization, uniform_policy_of
from oee_tabular.continuous.discretization.places import GridInterpolation, Places, VisitedCells, visited_states
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.task import ContinuousTask, StatePolicy, require_log_of

__all__ = ["Discretization", "Grid", "GridInterpolation", "Places", "VisitedCells", "discretize", "visited_states"]

DEFAULT_VERTICES = {1: 201, 2: 41, 3: 15}  # along each feature, by how many there are
DEFAULT_CELLS = 1000  # above
TOLERANCE = 0.05  # of the closure error: beyond it is warned about


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
    log : ContinuousTransitions of the target, at whose states and actions the task is stepped (its next states are used for a
        ``floor`` alone)
    cells : where the states lie: (n_1, ..., n_k) vertices along each feature or ``GridInterpolation``; a number of cells or
        ``VisitedCells``; another Discretization, whose states and places are taken; None: the task's own, or a grid up to three
        features and 1000 visited cells above
    floor : with this probability a step is another one: one of the ``others``; where there are none, one of the log's that the
        task gives no probability (``FiniteMDP.with_support_of``). A *defensive* simulator, which gives probability to what the
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
        Cells that do not fit the task's features; a task whose step leaves the finite numbers; a log of other states; a floor
        without a log and without others.

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
    FiniteMDP(1025 states, 2 actions, 12337 transitions, rewards r(s, a), discount 0.99)
    >>> model.supported(model.counts(log))[1]
    0.0
    """
    _checks.instance(task, ContinuousTask, "task")
    share = _checks.number_in(floor, "floor", 0.0, 1.0)
    if log is not None:
        require_log_of(task, log)
    process = task.on_features()
    mixed = list(process.others()) if others is None else [other.on_features() for other in others]
    if share > 0.0 and not mixed:
        _checks.number_in(floor, "floor", 0.0, 1.0, open_ends=True)
        if log is None:
            raise ValueError(f"floor must be 0 without a log, for {task.name} has no others; it is {floor}")
    if isinstance(cells, Discretization):
        places = cells.places
    else:
        visiting = list(policies) or [uniform_policy_of(task)]
        chosen, k = process.default_cells if cells is None else cells, len(process.feature_names)
        if chosen is None:
            chosen = (DEFAULT_VERTICES[k],) * k if k in DEFAULT_VERTICES else DEFAULT_CELLS
        if not isinstance(chosen, GridInterpolation | VisitedCells):
            is_number = isinstance(chosen, int | np.integer)
            chosen = VisitedCells(int(chosen)) if is_number else GridInterpolation(chosen)
        places = chosen.places(process, log if process is task else None, mixed, visiting, seed)
    if share == 0.0 and others is None:
        mixed = []
    starts, mass = process.initial_points()
    inner = places.cells.weights(process.features(starts)).T @ mass
    initial = np.append(inner / inner.sum(), np.zeros(int(process.terminates)))
    simulators = tuple(places.simulate(each, initial, discount) for each in (process, *mixed))
    metadata: dict[str, Any] = {
        "task": task.name,
        "parameters": task.parameters(),
        "features": list(task.feature_names),
    }
    metadata |= {"cells": places.cells.extent(), "floor": share, "others": [other.parameters() for other in mixed]}
    model = Discretization(simulators[0], process, places, simulators, metadata)
    if closure_episodes:
        model = _measure_closure(model, _checks.positive_integer(closure_episodes, "closure_episodes"))
    model = replace(model, task=task)
    if share == 0.0:
        return model
    if mixed:
        return model.mixture([1.0 - share, *[share / len(mixed)] * len(mixed)])
    assert log is not None
    with warnings.catch_warnings(action="ignore"):  # whoever encodes the log is told
        counts = model.counts(log, outside="nearest")
    return replace(model, mdp=model.plain.with_support_of(counts, share))


def _measure_closure(model: Discretization, n_episodes: int) -> Discretization:
    """With the uniform policy's closure error, and a warning where it is beyond the tolerance and Monte Carlo's own error."""
    error, noise = model.closure_error(n_episodes=n_episodes)
    if abs(error) > TOLERANCE + 2.0 * noise:
        text = (
            f"{model.cells.extent()} is too coarse for the steps of {model.task.name}: the uniform policy's value on it has a "
            f"closure error of {error:+.1%} (+-{noise:.1%}) against Monte Carlo"
        )
        if isinstance(model.cells, Grid):
            task, grid, some = model.task, model.cells, slice(None, None, max(1, len(model.places.states) // 2000))
            states, actions = model.places.states[some], model.places.actions[some]
            moved = task.moves(states, actions, np.zeros((len(states), task.n_disturbances)))
            length = np.abs(task.features(moved.next_state) - task.features(states))
            period = np.where(grid.periodic, grid.high - grid.low, np.inf)
            median = np.median(np.minimum(length, np.abs(period - length)) / grid.spacing, axis=0)
            steps = ", ".join(f"{name} {step:.2g}" for name, step in zip(task.feature_names, median, strict=True))
            text += f"; the median step, in spacings: {steps}. A step well below 1 is smeared out by interpolation: take more "
            text += "points there"
        warnings.warn(text, stacklevel=4)
    return replace(model, diagnostics={"closure_error": error, "closure_standard_error": noise})

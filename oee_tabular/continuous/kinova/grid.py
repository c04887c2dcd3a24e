"""The hand's process as a FiniteMDP on a grid whose spacing is a command's step; a log's moves, policies and costs on it.

With the grid's spacing equal to the step, the simulator's displacements lie near vertices, and interpolation smears little.
"""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray, Seed
from oee_tabular._sparse import canonical, row_of_entry
from oee_tabular._threads import one_thread
from oee_tabular.continuous.discretization import Discretization
from oee_tabular.continuous.grid import Grid
from oee_tabular.continuous.interpolation import GridInterpolation
from oee_tabular.continuous.kinova.dynamics import (
    CENTER,
    COMMANDS,
    DEAD_BAND,
    GOALS,
    REACH,
    STEP,
    KinovaArm,
    goal_number,
)
from oee_tabular.continuous.kinova.hand import KinovaHand, fit_hand
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.support import defensive_mixture

DEFENSIVE = (0.5, 1.5)  # factors on the displacements that a defensive simulator mixes in: a target may lie between
ARM_STATE = len(KinovaArm.state_names)
WIDEST = 20  # boxes that a command may lead along an axis


@one_thread
def kinova_model(
    arm: KinovaArm | KinovaHand,
    *,
    spacing: float = STEP,
    defensive: float = 0.0,
    points: int = 3,
    n_states: int = 500,
    seed: Seed = 0,
) -> Discretization:
    """The 3-D MDP of the hand's position on a grid of ``spacing`` m (default: the step of a command) around home.

    A state is the box around a vertex. A point that is uniform in its box and moves by D_a ends in the boxes around as the
    multilinear weights of D_a say; cost and policy are means over ``points ** 3`` points of the box.

    Parameters
    ----------
    arm : KinovaArm (fitted first), or what ``fit_hand`` made of one
    spacing : m between vertices, half a command's step to five
    defensive : epsilon of a mixture with the same displacements times 0.5 and 1.5, and twice the scatter, so that a ratio
        has support where a target moves less or further; it is another simulator, and ``metadata`` says so
    points : along each axis of a box, over which costs and policies are averaged
    n_states, seed : of ``fit_hand``

    Notes
    -----
    13 125 states, 27 commands, 2.7 million entries with the defaults (2.7 times as many with ``defensive``).

    Examples
    --------
    >>> from oee_tabular.continuous.kinova.hand import ideal_hand
    >>> model = kinova_model(ideal_hand(), spacing=2 * STEP)
    >>> model.mdp.n_states, box_policy(model, 0).shape, round(float(goal_costs(model, 0).max()), 3)
    (1859, (1859, 27), -0.026)
    >>> moved = ContinuousTransitions([CENTER], [26], [CENTER + 1.4 * STEP])
    >>> from oee_tabular.continuous.support import within_support
    >>> counts, uncovered = within_support(move_counts(model, moved), model)
    >>> round(float(counts.sum()), 6), round(uncovered, 6), len(displacement_tie(model)) == model.mdp.transitions.nnz
    (1.0, 0.0, True)
    """
    step = _checks.number_in(spacing, "spacing", 0.5 * STEP, 5.0 * STEP)
    share = _checks.number_in(defensive, "defensive", 0.0, 1.0)
    inner = _checks.positive_integer(points, "points")
    hand = fit_hand(arm, n_states=n_states, seed=seed) if isinstance(arm, KinovaArm) else arm
    cells = np.round(REACH / step).astype(int)
    shape = tuple(int(2 * n + 1) for n in cells)
    builder = GridInterpolation(shape, CENTER - cells * step, CENTER + cells * step, closure_episodes=0)
    found = builder.build(hand)
    if share > 0.0:
        scattered = replace(builder, noise_points=2)  # at one standard deviation on either side
        others = [scattered.build(hand.scaled(factor)) for factor in DEFENSIVE]
        found = defensive_mixture(found, others, epsilon=share)
    line = step * ((np.arange(inner) + 0.5) / inner - 0.5)
    within = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)
    places = np.asarray((found.points[:, None, :] + within).reshape(-1, 3))
    found = replace(found, points=places, point_cell=np.repeat(found.point_cell, len(within)))
    return replace(found, mdp=found.mdp.with_rewards(goal_costs(found, hand.goal)))


def goal_costs(model: Discretization, goal: int) -> Array:
    """(S,) r of each state for a goal, -mean |x - goal| over its box, in m: ``model.mdp.with_rewards`` takes it."""
    return -model.mean(np.linalg.norm(model.points - GOALS[goal_number(goal)], axis=1))


def box_policy(model: Discretization, goal: int, delta: float = 0.0) -> Array:
    """(S, 27) ``kinova_policy(goal, delta)`` averaged over each box exactly: the controller treats the axes apart.

    ``model.policy`` does the same for any function, on the box's points.
    """
    cells = model.cells
    assert isinstance(cells, Grid)
    share = _checks.number_in(delta, "delta", 0.0, 1.0)
    apart = (GOALS[goal_number(goal)] - cells.vertices()) / cells.spacing  # in boxes
    edge = DEAD_BAND / cells.spacing
    up, down = np.clip(0.5 + apart - edge, 0.0, 1.0), np.clip(0.5 - apart - edge, 0.0, 1.0)
    each = np.stack([down, 1.0 - up - down, up], axis=2)
    table = each[:, 0, :, None, None] * each[:, 1, None, :, None] * each[:, 2, None, None, :]
    return np.asarray(share / len(COMMANDS) + (1.0 - share) * table.reshape(len(apart), -1))


def move_counts(model: Discretization, log: ContinuousTransitions, *, outside: str = "error") -> sparse.csr_array:
    """Counts n(s, a, s') of a log's moves, each carried to the vertex of its box: csr of shape (S*A, S).

        n(i, a, j) = sum over rows with x in box i of w_j(vertex_i + x' - x)

    So a move is spread exactly as the simulator's rows spread theirs, and not once more for where in its box it began.
    ``outside`` "error": ValueError for states outside the grid; "drop": such moves are left out, with a warning. O(n).
    """
    _checks.instance(log, ContinuousTransitions, "log")
    if log.n_state not in (3, ARM_STATE):
        raise ValueError(
            f"log.state must be the position x, y, z, or the {ARM_STATE} coordinates of the arm (hand_log makes positions); it "
            f"has {log.n_state} coordinates"
        )
    _checks.one_of(outside, "outside", ("error", "drop"))
    cells = model.cells
    assert isinstance(cells, Grid)
    start, shift = log.state[:, :3], log.next_state[:, :3] - log.state[:, :3]
    actions = log.action_numbers(model.task.actions)
    gone = np.flatnonzero(cells.outside(start))
    if gone.size:
        text = (
            f"log.state must be inside {cells.extent()}; {gone.size} of {len(log)} rows are not, the first, row {gone[0]}, "
            f"is at {start[gone[0]].tolist()}"
        )
        if outside == "error" or gone.size == len(log):
            raise ValueError(text)
        warnings.warn(f"{text}. They are left out", stacklevel=2)
        start, shift = np.delete(start, gone, axis=0), np.delete(shift, gone, axis=0)
        actions = np.delete(actions, gone)
    box = np.rint((start - cells.low) / cells.spacing).astype(np.int64)
    number = np.ravel_multi_index(tuple(box.T), cells.shape)
    vertices, weights = cells.interpolate(cells.low + box * cells.spacing + shift)
    rows = number * model.task.n_actions + actions
    where = (np.repeat(rows, weights.shape[1]), vertices.ravel())
    shape = (cells.n_cells * model.task.n_actions, cells.n_cells)
    return canonical(sparse.csr_array((weights.ravel(), where), shape=shape), drop_zeros=True)


def displacement_tie(model: Discretization) -> IntArray:
    """(nnz,) the tie of each entry of ``model.mdp.transitions``: the command, and how many boxes along each axis it leads."""
    cells, matrix = model.cells, model.mdp.transitions
    assert isinstance(cells, Grid)
    first, action = np.divmod(row_of_entry(matrix), model.task.n_actions)
    places = np.stack(np.unravel_index(np.arange(cells.n_cells), cells.shape), axis=1)
    apart = places[matrix.indices] - places[first] + WIDEST
    return np.asarray(action * (2 * WIDEST + 1) ** 3 + apart @ np.array([(2 * WIDEST + 1) ** 2, 2 * WIDEST + 1, 1]))

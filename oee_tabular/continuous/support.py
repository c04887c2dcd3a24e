"""Where a log's moves have probability: what a simulator supports of them, and defensive simulators, which support more.

Those are mixtures: of the task under several parameters (``defensive_mixture``), or with a small chance of ending anywhere
near (``with_floor``, which ``GridInterpolation(floor=...)`` uses). Both are other simulators than the plain one, and say so.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import BoolArray
from oee_tabular._sparse import canonical, check_csr, csr_on_pattern, find, row_of_entry, row_sums
from oee_tabular.continuous.discretization import Discretization
from oee_tabular.continuous.grid import ENTRIES_AT_A_TIME, Grid, each_action
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.task import ContinuousTask
from oee_tabular.mdp import FiniteMDP

USUAL = 2  # cells that a floor reaches at least
DUST = 1e-3  # share of the moves that a floor need not reach
LOOKED = 5000  # moves by which the reach is found
MOST_ENTRIES = 2e7  # of a matrix with a floor


def defensive_mixture(
    simulator: Discretization, others: Sequence[Discretization], *, epsilon: float = 0.1
) -> Discretization:
    """(1 - epsilon) P_simulator + epsilon mean_k P_k, all on the same cells.

    A ratio against it is at most K / epsilon wherever the target lies in the convex hull of the K others, and no target mass
    there is without support. It is *another simulator*: results made with it say so (``metadata["defensive"]``), beside
    those of the plain one.

    Parameters
    ----------
    simulator : Discretization
    others : the same task under other parameters, which should bracket the target's, built on the same cells
    epsilon : weight of the others, in [0, 1]

    Raises
    ------
    ValueError
        Different numbers of states or actions; rewards r(s, a, s') (a mixture of moves has no single one).

    Examples
    --------
    >>> import oee_tabular as oee
    >>> from oee_tabular.tasks import CartPole, GridInterpolation
    >>> builder = GridInterpolation((20, 20), closure_episodes=0)
    >>> plain, low, high = (builder.build(CartPole(gravity)) for gravity in (10.0, 5.0, 20.0))
    >>> mixture = defensive_mixture(plain, [low, high], epsilon=0.1)
    >>> round(float(oee.true_ratio(high.mdp, mixture.mdp).values.data.max()), 3) <= 2 / 0.1
    True
    """
    weight = _checks.number_in(epsilon, "epsilon", 0.0, 1.0)
    if not others:
        raise ValueError("others must have at least one Discretization; it has none")
    for k, other in enumerate(others):
        if other.mdp.transitions.shape != simulator.mdp.transitions.shape:
            raise ValueError(
                f"others[{k}] must have the simulator's rows and states, {simulator.mdp.transitions.shape}; "
                f"it has {other.mdp.transitions.shape}"
            )
    every = [simulator, *others]
    shares = [1.0 - weight] + [weight / len(others)] * len(others)
    if any(part.mdp.transition_rewards is not None for part in every):
        raise ValueError("others and simulator must have rewards r(s, a) (rewards='expected'); one has r(s, a, s')")
    matrix = canonical(
        sum(share * part.mdp.transitions for share, part in zip(shares, every, strict=True)), drop_zeros=True
    )
    matrix.data.flags.writeable = True
    matrix.data /= row_sums(matrix)[row_of_entry(matrix)]
    rewards = np.sum([share * part.mdp.rewards for share, part in zip(shares, every, strict=True)], axis=0)
    own = simulator.mdp
    mdp = FiniteMDP(matrix, rewards, own.initial, own.discount, layout=own.layout)
    mdp = mdp.with_names(own.state_names, own.action_names)
    said = {"epsilon": weight, "others": [other.task.parameters() for other in others]}
    return replace(simulator, mdp=mdp, metadata=simulator.metadata | {"defensive": said})


def supported(counts: sparse.csr_array, transitions: sparse.csr_array) -> tuple[sparse.csr_array, float]:
    """The counts that lie where ``transitions`` has probability, and the share of those that do not: to be reported with it."""
    matrix = canonical(check_csr(counts, "counts"), drop_zeros=True)
    known = canonical(check_csr(transitions, "transitions"), drop_zeros=True)
    possible = find(known, row_of_entry(matrix), matrix.indices.astype(np.int64))[1]
    kept = canonical(csr_on_pattern(matrix, np.where(possible, matrix.data, 0.0)), drop_zeros=True)
    total = float(matrix.data.sum())
    return kept, 1.0 - float(kept.data.sum()) / total if total > 0 else 0.0


def within_support(counts: sparse.csr_array, model: Discretization) -> tuple[sparse.csr_array, float]:
    """``supported`` by the model's transitions."""
    return supported(counts, model.mdp.transitions)


def frequencies(counts: sparse.csr_array, n_actions: int) -> sparse.csr_array:
    """The log's own rows n(s, a, s') / n(s, a); what was never visited stays where it is."""
    total = row_sums(check_csr(counts, "counts"))
    scale = np.divide(1.0, total, out=np.zeros_like(total), where=total > 0)
    return sparse.csr_array(sparse.diags_array(scale) @ counts + staying(total == 0, n_actions))


def staying(rows: BoolArray, n_actions: int) -> sparse.csr_array:
    """csr (S*A, S): the given rows s*A + a lead to s, the others nowhere."""
    number = np.arange(len(rows))
    shape = (len(rows), len(rows) // n_actions)
    return sparse.csr_array((rows.astype(np.float64), (number, number // n_actions)), shape=shape)


def with_floor(
    task: ContinuousTask, grid: Grid, matrix: sparse.csr_array, floor: float, reach: int
) -> sparse.csr_array:
    """(1 - floor) P + floor * uniform over the vertices within ``reach`` cells of where the vertex leads."""
    shape = np.array(grid.shape)
    offsets = np.array(list(itertools.product(range(-reach, reach + 2), repeat=len(shape))), dtype=np.int64)
    at_a_time = max(1, ENTRIES_AT_A_TIME // (len(offsets) * task.n_actions))
    blocks = []
    for low in range(0, grid.n_cells, at_a_time):
        numbers = np.arange(low, min(low + at_a_time, grid.n_cells))
        states, actions = each_action(task, task.embed(grid.vertices(numbers)))
        moved = task.moves(states, actions, np.zeros((len(states), task.n_disturbances)))
        index = grid.locate(task.features(moved.next_state))[0][:, None, :] + offsets
        index = np.where(grid.periodic, index % shape, index)
        inside = ((index >= 0) & (index < shape)).all(axis=2)
        over = np.zeros(inside.shape, dtype=np.bool_)
        if task.terminates:  # beyond the grid only what is over there counts
            places = (grid.low + index * grid.spacing).reshape(-1, len(shape))
            over = task.terminated(task.embed(places)).reshape(inside.shape)
            over[task.terminated(states)] = True
        flat = np.ravel_multi_index(tuple(np.moveaxis(np.clip(index, 0, shape - 1), 2, 0)), grid.shape)
        columns = np.where(over, grid.n_cells, flat)
        share = np.where(inside | over, 1.0, 0.0)
        share *= floor / share.sum(axis=1, keepdims=True)
        starts = np.arange(len(states) + 1) * len(offsets)
        block = sparse.csr_array((share.ravel(), columns.ravel(), starts), shape=(len(states), matrix.shape[1]))
        block.sum_duplicates()
        block.eliminate_zeros()
        blocks.append(block)
    return sparse.csr_array((1.0 - floor) * matrix + sparse.vstack(blocks, format="csr"))


def reach_of(task: ContinuousTask, grid: Grid, log: ContinuousTransitions) -> int:
    """The ``reach`` of ``with_floor`` by which all but a thousandth of the log's moves have support; its actions are numbers.

    At least 2 cells, and at most what keeps the rows within 20 million entries; by 5000 of the moves.
    """
    some = np.unique(np.linspace(0, len(log) - 1, LOOKED).astype(np.int64))
    features, arrivals = (task.features(states[some]) for states in (log.state, log.next_state))
    kept = ~(grid.outside(features) | grid.outside(arrivals) | log.terminated[some])
    if not kept.any():
        return USUAL
    start = grid.weights(features[kept])
    row = np.repeat(np.arange(start.shape[0]), np.diff(start.indptr))
    pairs, which = np.unique(
        start.indices.astype(np.int64) * task.n_actions + log.action[some][kept][row], return_inverse=True
    )
    states = task.embed(grid.vertices(pairs // task.n_actions))
    moved = task.moves(states, pairs % task.n_actions, np.zeros((len(pairs), task.n_disturbances)))
    lead = grid.locate(task.features(moved.next_state))[0]
    away = np.abs(grid.locate(arrivals[kept])[0][row] - lead[which])
    away = np.where(grid.periodic, np.minimum(away, np.array(grid.shape) - away), away).max(axis=1)
    farthest = np.zeros(start.shape[0], dtype=np.int64)
    np.maximum.at(farthest, row, away)
    wanted = int(np.quantile(farthest, 1.0 - DUST, method="higher"))
    room = (MOST_ENTRIES / (grid.n_cells * task.n_actions)) ** (1.0 / len(grid.shape)) / 2.0 - 1.0
    return max(USUAL, min(wanted, int(room)))

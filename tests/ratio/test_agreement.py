"""The structured solver and Clarabel at tolerances of 1e-12, on the paper's 10 x 10 grid: the same ratios."""

import warnings

import numpy as np
import pytest

import oee_tabular as oee
from oee_tabular.ratio import dual, statements


def grid_problem(n_episodes):
    """Counts of the target on the simulator's moves, the simulator's probabilities, rows."""
    simulator, target = oee.tasks.gridworld(10, 0.3), oee.tasks.gridworld(10, 0.1)
    rows = np.repeat(np.arange(400), np.diff(simulator.transitions.indptr))
    counts = oee.sample_episodes(target, oee.uniform_policy(target), n_episodes, 1000, seed=0).counts(100, 4)
    observed = np.asarray(counts[rows, simulator.transitions.indices]).reshape(-1)
    return observed, simulator.transitions.data, simulator.transitions.indptr.astype(np.int64)


def coordinates(n_episodes, by_row, ridge, toward):
    observed, probability, indptr = grid_problem(n_episodes)
    spread = np.diff(indptr)
    if by_row:
        n_row = np.repeat(np.add.reduceat(observed, indptr[:-1]), spread)
        p, q = (observed + probability) / (n_row + 1.0), probability
    else:
        p, q, indptr = observed / observed.sum(), probability / probability.sum(), np.array([0, len(observed)])
    bend = np.full(len(p), ridge) if toward is None else ridge * q
    return dual.Coordinates(p, q, bend, np.full(len(p), toward or 0.0)), indptr


@pytest.mark.parametrize(
    ("n_episodes", "by_row", "ridge", "toward", "largest"),
    [
        (45, False, 0.0, None, 1e-10),
        (45, False, 1e-4, None, 1e-9),
        (45, False, 0.1, 1.0, 1e-9),
        (270, True, 0.0, None, 1e-9),
        (45, True, 0.1, 1.0, 1e-9),
    ],
    ids=["normalised", "ridge to 0", "ridge to 1", "rows", "rows, ridge"],
)
def test_the_two_solvers_agree(n_episodes, by_row, ridge, toward, largest):
    """Asked for and found: 1e-10 normalised with a box, 1e-9 by rows and with a ridge."""
    program, indptr = coordinates(n_episodes, by_row, ridge, toward)
    ours = dual.solve_rows(program, 0.01, 10.0, indptr)
    statement = statements.state_rows(program, 0.01, 10.0, indptr)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        statement.problem.solve(solver="CLARABEL", warm_start=False, **statements.clarabel_options(1e-12))
    assert statement.problem.status == "optimal"
    assert np.abs(statement.variable.value - ours.ratio).max() < largest
    assert ours.gap.max() < 1e-14
    below, above = ours.enclosure()
    assert (below <= ours.ratio).all()
    assert (ours.ratio <= above).all()
    assert ((above - below) <= 1e-12 * ours.ratio).all()

"""Certain changes of rows: bounds that hold, all at once, and say nothing where there is nothing to say."""

import numpy as np

import oee_tabular as oee
from oee_tabular.inference import row_changes

SIMULATOR, TARGET = oee.tasks.gridworld(4, 0.3), oee.tasks.gridworld(4, 0.1)


def true_change():
    apart = np.abs((SIMULATOR.transitions - TARGET.transitions).toarray()).sum(axis=1)
    return 0.5 * apart.reshape(16, 4)


def test_the_simulator_s_own_log_changes_nothing():
    log = oee.sample_transitions(SIMULATOR, np.full((16, 4), 1 / 64), 4_000, seed=1)
    found = row_changes(oee.Problem(SIMULATOR, log))
    assert found.n_certain == 0
    assert found.counts.sum() == 4_000


def test_rows_without_moves_are_left_open():
    found = row_changes(oee.Problem(SIMULATOR, oee.Transitions([0], [0], [4])))
    assert found.tested == 1
    assert found.next_state[3, 3] == -1
    assert np.isnan(found.observed[3, 3])
    assert found.certain[3, 3] == found.estimated[3, 3] == found.evidence[3, 3] == 0.0

"""Certain changes of rows: bounds that hold, all at once, and say nothing where there is nothing to say."""

import numpy as np
import pytest
from helpers import Dense, table_of, tiny
from numpy.testing import assert_allclose
from scipy import optimize

import oee_tabular as oee
from oee_tabular.inference import row_changes

SIMULATOR, TARGET = oee.tasks.gridworld(4, 0.3), oee.tasks.gridworld(4, 0.1)


def test_the_simulator_s_own_log_changes_nothing():
    log = oee.sample_transitions(SIMULATOR, np.full((16, 4), 1 / 64), 4_000, seed=1)
    found = row_changes(oee.Problem(SIMULATOR, log))
    assert found.n_certain == 0
    assert found.counts.sum() == 4_000


def test_rows_without_transitions_are_left_open():
    found = row_changes(oee.Problem(SIMULATOR, oee.Transitions([0], [0], [4])))
    assert found.tested == 1
    assert found.next_state[3, 3] == -1
    assert np.isnan(found.observed[3, 3])
    assert found.certain[3, 3] == found.estimated[3, 3] == found.evidence[3, 3] == 0.0


@pytest.mark.parametrize("episodes", [False, True])
def test_changes_of_rows_by_roots_of_their_own(episodes):
    simulator, target, log, policy = tiny(5, moves=400, left_out=[3])
    if episodes:
        log = oee.sample_episodes(target, policy, 40, 10, seed=0)
    found = row_changes(oee.Problem(simulator, log), confidence=0.9)
    P, n = Dense(simulator).P, table_of(log, policy.shape)
    tested = (n.sum(axis=2) > 0).sum()
    level = 0.1 / tested
    for s, a in np.ndindex(policy.shape):
        total = n[s, a].sum()
        if total == 0:
            assert found.certain[s, a] == 0.0
            continue
        phat = n[s, a] / total
        if episodes:
            c = np.log(1 / level) + 2 * np.log(np.e * (1 + total / 2))
        else:
            c = optimize.brentq(lambda c: -c + 2 * np.log(np.e * c / 2) - np.log(level), 2.0 + 1e-9, 1e4)
        more = phat > P[s, a]
        f = phat[more].sum()

        def kl(p, f=f):
            rest = (1 - f) * np.log((1 - f) / (1 - p)) if f < 1 else 0.0
            return f * np.log(f / p) + rest

        smallest = optimize.brentq(lambda p, radius=c / total: kl(p) - radius, 1e-300, f)
        assert_allclose(found.certain[s, a], max(smallest - P[s, a][more].sum(), 0.0), atol=1e-9)
        assert_allclose(found.estimated[s, a], np.abs(phat - P[s, a]).sum() / 2, rtol=1e-12)
        seen = phat > 0
        assert_allclose(found.evidence[s, a], (n[s, a][seen] * np.log(phat[seen] / P[s, a][seen])).sum(), rtol=1e-9)
        j = int(np.abs(phat - P[s, a]).argmax())
        assert (found.next_state[s, a], found.simulated[s, a], found.observed[s, a]) == (
            j, pytest.approx(P[s, a, j]), pytest.approx(phat[j]),
        )  # fmt: skip
    assert found.tested == tested

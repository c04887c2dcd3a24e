"""Tied ratios: the pooled program's closed form, its limits, and what is refused."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import sparse

import oee_tabular as oee
from oee_tabular.ratio import Tied, transition_ratio, true_ratio


def fit_tied(log_or_counts, simulator, tie, **options):
    return Tied(tie, **options).fit(log_or_counts, simulator)


def ring(p, n=12, n_actions=2):
    """Steps of 0, 1 or 2 around a ring with probabilities p[a]: the displacement does not depend on the state."""
    dense = np.zeros((n, n_actions, n))
    for s in range(n):
        for a in range(n_actions):
            for k in range(3):
                dense[s, a, (s + k) % n] += p[a][k]
    return oee.FiniteMDP(dense, np.linspace(0, 1, n), np.eye(n)[0], 0.9)


def displacement(s, a, following):
    return 3 * a + (following - s) % 12


SIMULATOR = ring([[0.2, 0.5, 0.3], [0.6, 0.3, 0.1]])
TARGET = ring([[0.1, 0.3, 0.6], [0.2, 0.4, 0.4]])


def test_a_function_of_the_key_is_found_exactly():
    zeta = fit_tied(100 * TARGET.transitions, SIMULATOR, displacement, strength=0.0)
    assert_allclose(zeta.values.toarray(), true_ratio(TARGET, SIMULATOR).values.toarray(), rtol=1e-9)
    assert zeta.gap < 1e-10
    assert zeta.details["n_keys"] == 6
    assert zeta.details["n_groups"] == 2
    assert_allclose(zeta.details["pooled_row_sums"], 1.0)


def test_an_unrecorded_action_keeps_the_simulator():
    only = 50 * TARGET.transitions.toarray()
    only[1::2] = 0.0
    zeta = fit_tied(sparse.csr_array(only), SIMULATOR, displacement)
    assert_allclose(zeta.values.toarray()[1::2][SIMULATOR.transitions.toarray()[1::2] > 0], 1.0)
    assert zeta.details["groups_visited"] == 1


def test_no_mass_left_in_a_row():
    simulator = oee.FiniteMDP([[[0.5, 0.5]], [[0.0, 1.0]]], [0.0, 1.0], [1.0, 0.0], 0.9)
    counts = sparse.csr_array([[4.0, 0.0], [0.0, 0.0]])
    with pytest.raises(ValueError, match=r"strength must be positive here: no key of row \(s=1, a=0\)"):
        fit_tied(counts, simulator, np.array([0, 1, 1]), strength=0.0)


def test_a_discount_weights_the_log_s_transitions():
    log = oee.sample_episodes(TARGET, oee.uniform_policy(TARGET), 50, 20, seed=0)
    fit = transition_ratio(log, SIMULATOR, tie=displacement, discount=0.5)
    by_hand = fit_tied(
        log.counts(SIMULATOR.n_states, SIMULATOR.n_actions, discount=0.5), SIMULATOR, displacement, strength=3.0
    )
    assert_allclose(fit.values.data, by_hand.values.data, rtol=1e-12)


def test_a_tied_ratio_says_that_unseen_rows_come_from_the_tie():
    """Rows that the log missed: the finding says where what is told of them comes from."""
    log = oee.Transitions([0] * 30, [0, 1] * 15, [0, 1, 2] * 10)
    policy = oee.uniform_policy(SIMULATOR)
    for ratio, tied in ((Tied(displacement), True), ("conditional", False)):
        found = oee.estimators.OffEnvironment(ratio=ratio)(oee.Problem(SIMULATOR, log), policy)
        told = [finding.text for finding in found.findings if finding.kind == "coverage"]
        assert [("Transitions of the same key elsewhere" in text) for text in told] == [tied]

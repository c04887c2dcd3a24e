"""The value between the centre's and the log's: where it stops, its standard error, its interval, and what they say."""

import functools

import numpy as np
from scipy import sparse

import oee_tabular as oee
from oee_tabular.estimators import OffEnvironment


def pair(seed, n_states=6, size=0.5):
    """Rows of five successors; the target's are moved down along V by ``size``."""
    rng = np.random.default_rng(seed)
    rows = rng.dirichlet(np.full(n_states, 2.0), (n_states, 2))
    simulator = oee.FiniteMDP(rows, rng.normal(size=(n_states, 2)), np.full(n_states, 1 / n_states), 0.9)
    policy = rng.dirichlet(np.ones(2), n_states)
    level = oee.state_values(simulator, policy)
    raw = rows * np.exp(-size * (level - level.mean()) / level.std())
    return simulator, simulator.with_transitions(raw / raw.sum(axis=2, keepdims=True)), policy


def estimated(seed, size, per_row):
    simulator, target, policy = pair(seed, size=size)
    problem = oee.Problem(simulator, oee.sample_transitions(target, np.full((6, 2), 1 / 12), 12 * per_row, seed=seed))
    ratio = functools.partial(oee.transition_ratio, prior="simulator", strength=30.0)
    return OffEnvironment(ratio)(problem, policy)


def test_a_value_that_rests_on_the_prior_against_the_log_says_so():
    """More than two standard errors of their difference from maximum likelihood's value, in words with that value."""
    told = []
    for seed in range(30):
        facts = (estimate := estimated(seed, 1.5, 1 + seed % 4)).diagnostics
        error = facts["one_step_standard_error"] ** 2 - facts["unseen_standard_error"] ** 2
        apart = np.sqrt(error - facts["standard_error_if_centre_fits"] ** 2)
        distance = abs(estimate.value - facts["maximum_likelihood_value"]) / apart
        words = [str(finding) for finding in estimate.findings if finding.kind == "against"]
        assert len(words) == (distance > 2)
        if words:
            assert f"gives {facts['maximum_likelihood_value']:.4g}, {distance:.1f} standard errors" in words[0]
        told += words
    assert told


def test_without_noise_nothing_is_moved():
    """Rows with one successor: no change, no error."""
    simulator = oee.FiniteMDP(sparse.csr_array([[0.0, 1.0], [0.0, 1.0]]), [1.0, 0.0], [1.0, 0.0], 0.9)
    found = OffEnvironment()(oee.Problem(simulator, oee.Transitions([0, 1], [0, 0], [1, 1])), np.ones((2, 1)))
    assert (found.value, found.standard_error, found.interval) == (1.0, 0.0, (1.0, 1.0))
    assert found.diagnostics["moved"] == 0.0
    assert found.diagnostics["one_step_distance"] == 0.0

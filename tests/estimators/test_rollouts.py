"""Estimators that roll out: the engine is ``sample_returns``, the truth its exact
moments, step by step its recorded paths.
"""

import numpy as np
import pytest
from helpers import random_mdp, random_policy, survival_chain
from numpy.testing import assert_allclose

import oee_tabular as oee
from oee_tabular.estimators import OffEnvironment, Oracle
from oee_tabular.estimators.errors import effective_sample_size
from oee_tabular.estimators.rollouts import rollout_horizon

KINDS = ("per_decision", "trajectory")


def problem_of(simulator, horizon=None):
    """With a log that does not matter."""
    return oee.Problem(
        simulator,
        oee.Transitions([0], [0], simulator.transitions.indices[:1]),
        horizon=horizon,
    )


def ratio_with(simulator, data):
    """Any numbers on the simulator's moves: rows of zeta * P need not sum to 1."""
    true = oee.true_ratio(simulator, simulator)
    values = true.values.copy()
    values.data = np.array(data, dtype=np.float64)
    return oee.TransitionRatio(values, "any", 0.0, true.visited, 1.0, true.counts)


def close_pair(rng, form):
    """A random simulator, a policy and a zeta between .8 and 1.25, rows not normalised."""
    simulator = random_mdp(rng, n_states=int(rng.integers(2, 8)), form=form)
    return (
        simulator,
        random_policy(rng, simulator),
        ratio_with(simulator, rng.uniform(0.8, 1.25, simulator.transitions.nnz)),
    )


def product(
    simulator,
    zeta,
    policy,
    *,
    horizon,
    n,
    seed=0,
    kind="per_decision",
    self_normalized=False,
):
    estimator = OffEnvironment(
        zeta, "monte_carlo", kind, self_normalized=self_normalized, n_rollouts=n
    )
    return estimator(problem_of(simulator, horizon), policy, seed=seed)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("form", [1, 2, 3])
@pytest.mark.parametrize("horizon", [6, None])
def test_products_are_the_mean_of_sample_returns(kind, form, horizon):
    """The same bits for the same seed: there is one engine."""
    simulator, policy, zeta = close_pair(np.random.default_rng(form), form)
    steps = horizon or rollout_horizon(simulator.discount, None)
    drawn = oee.sample_returns(
        simulator, policy, 50, steps, seed=3, zeta=zeta, kind=kind
    )
    found = product(simulator, zeta, policy, horizon=horizon, n=50, seed=3, kind=kind)
    assert found.value == drawn.mean
    assert_allclose(found.standard_error, drawn.standard_error, rtol=1e-14)
    assert_allclose(found.diagnostics["mean_weight"], drawn.weights.mean(), rtol=1e-14)
    oracle = Oracle(simulator, "monte_carlo", kind, n_rollouts=50)(
        problem_of(simulator, steps), policy, seed=3
    )
    assert_allclose(oracle.value, drawn.returns.mean(), rtol=1e-14)


@pytest.mark.parametrize("form", [1, 2, 3])
@pytest.mark.parametrize("horizon", [1, 4, 7])
def test_self_normalised_products_step_by_step(form, horizon):
    """sum_t gamma^t sum_i w_it r_it / sum_i w_it from the recorded paths; an episode
    that is over has its last weight.
    """
    rewards = np.array([2.0, 0.0]) if form < 3 else np.array([2.0, 3.0, 0.0, 0.0])
    simulator = oee.FiniteMDP(
        [[[0.7, 0.3]], [[0.0, 1.0]]], rewards.reshape((2, 1, 2)[:form]), [1.0, 0.0], 0.9
    )
    zeta = ratio_with(simulator, [1.4, 0.3, 1.0])
    n = 30
    log = oee.sample_returns(
        simulator, np.ones((2, 1)), n, horizon, seed=1, record=True
    ).log
    carried = np.ones((n, horizon))
    paid = np.zeros((n, horizon))
    ends = np.ones(n)
    largest = []
    for i in range(n):
        weight = 1.0
        rows = range(log.episode_starts[i], log.episode_starts[i + 1])
        for t in range(horizon):
            if t < len(rows):
                after = weight * (1.4 if log.next_state[rows[t]] == 0 else 0.3)
                carried[i, t] = ends[i] = after if form == 3 else weight
                paid[i, t] = 0.9**t * log.reward[rows[t]]
                weight = after
                largest.append(carried[i, t])
            else:
                carried[i, t] = ends[i] = weight
    found = product(
        simulator,
        zeta,
        np.ones((2, 1)),
        horizon=horizon,
        n=n,
        seed=1,
        self_normalized=True,
    )
    mass = carried.sum(axis=0)
    value = (carried * paid).sum(axis=0) / mass
    assert_allclose(found.value, value.sum(), rtol=1e-13)
    influence = ((carried * paid - value * carried) * n / mass).sum(axis=1)
    error = influence.std(ddof=1) / np.sqrt(n)
    if error > 1e-12:
        assert_allclose(found.standard_error, error, rtol=1e-10)
    assert_allclose(found.diagnostics["largest_weight"], np.max(largest), rtol=1e-14)
    assert_allclose(found.diagnostics["mean_weight"], ends.mean(), rtol=1e-14)
    assert_allclose(
        found.diagnostics["effective_sample_size"],
        ends.sum() ** 2 / (ends**2).sum(),
        rtol=1e-12,
    )
    whole = product(
        simulator,
        zeta,
        np.ones((2, 1)),
        horizon=horizon,
        n=n,
        seed=1,
        kind="trajectory",
        self_normalized=True,
    )
    assert_allclose(whole.value, ends @ paid.sum(axis=1) / ends.sum(), rtol=1e-13)
    assert_allclose(whole.diagnostics["largest_weight"], ends.max(), rtol=1e-14)


@pytest.mark.parametrize("horizon", [3, 4, 5, 8, 9])
@pytest.mark.parametrize("n", [1, 200])
def test_the_largest_weight_is_one_that_a_reward_carries(horizon, n):
    """Not that of an episode that is over, whatever is drawn beside it; W = 2^t, and 32
    where the chain ends.
    """
    chain = survival_chain(0.9)
    zeta = ratio_with(chain, [2.0, 32.0, 1.0])
    drawn = oee.sample_returns(chain, np.ones((2, 1)), n, horizon, seed=0, zeta=zeta)
    found = product(chain, zeta, np.ones((2, 1)), horizon=horizon, n=n)
    assert found.diagnostics["largest_weight"] == 2.0 ** (drawn.lengths.max() - 1)
    whole = product(
        chain, zeta, np.ones((2, 1)), horizon=horizon, n=n, kind="trajectory"
    )
    assert whole.diagnostics["largest_weight"] == drawn.weights.max()
    assert n == 1 or drawn.weights.max() > 2.0 ** (horizon - 1)


def test_weights_of_0_have_nothing_to_divide_by():
    simulator = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0.0, 1.0], [1.0, 0.0], 0.9)
    for kind in KINDS:
        nothing = ratio_with(simulator, [0.0] * 4)
        assert (
            product(
                simulator, nothing, np.ones((2, 1)), horizon=4, n=50, kind=kind
            ).value
            == 0.0
        )
        none = product(
            simulator,
            nothing,
            np.ones((2, 1)),
            horizon=4,
            n=50,
            kind=kind,
            self_normalized=True,
        )
        assert np.isnan(none.value)
        assert none.status.startswith("at some step every weight is 0")
    with pytest.raises(
        ValueError, match="horizon must be given for rollouts at discount 1"
    ):
        product(
            simulator.with_discount(1.0), nothing, np.ones((2, 1)), horizon=None, n=50
        )


def test_products_that_overflow_say_so_without_a_warning():
    simulator = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0.0, 1.0], [1.0, 0.0], 0.9)
    for kind in KINDS:
        for normal in (False, True):
            huge = ratio_with(simulator, [1e200] * 4)
            found = product(
                simulator,
                huge,
                np.ones((2, 1)),
                horizon=6,
                n=50,
                kind=kind,
                self_normalized=normal,
            )
            assert not np.isfinite(found.value)
            assert (
                found.status
                == "the product of ratios overflows: shorten the horizon, or use oee"
            )
    once = product(
        simulator, ratio_with(simulator, [1e200] * 4), np.ones((2, 1)), horizon=2, n=50
    )
    assert once.status == "ok"
    assert_allclose(once.diagnostics["effective_sample_size"], 50)
    assert_allclose(effective_sample_size(np.array([1e200, 3e200])), 1.6)
    assert_allclose(effective_sample_size(np.array([1e-200, 3e-200])), 1.6)

"""A horizon is followed as far as the discount can show; the rest is said, or refused with its cost."""

import numpy as np
import pytest
from scipy import sparse

import oee_tabular as oee
from oee_tabular.mdp.horizons import limit_horizon

TARGET, SIMULATOR = (oee.tasks.gridworld(3, slip) for slip in (0.1, 0.3))
POLICY = oee.uniform_policy(TARGET)
ZETA = oee.true_ratio(TARGET, SIMULATOR)
FAR = 10**9
LOG = oee.sample_episodes(TARGET, POLICY, 20, 30, seed=0)

FAR_AND_INFINITE = {
    "policy_value": lambda horizon: oee.policy_value(TARGET, POLICY, horizon=horizon),
    "state_values": lambda horizon: oee.state_values(TARGET, POLICY, horizon=horizon),
    "action_values": lambda horizon: oee.action_values(TARGET, POLICY, horizon=horizon),
    "occupancy": lambda horizon: oee.occupancy(TARGET, POLICY, horizon=horizon),
    "transition_gradient": lambda horizon: oee.exact.transition_gradient(TARGET, POLICY, horizon=horizon),
    "variance": lambda horizon: oee.return_moments(TARGET, POLICY, horizon=horizon).variance,
    "a limit": lambda horizon: oee.estimators.Simulator().limit(SIMULATOR, TARGET, POLICY, horizon=horizon),
    "an estimate": lambda horizon: (
        oee.estimators.ModelBased()(oee.Problem(SIMULATOR, LOG, horizon=horizon), POLICY).value
    ),
}


@pytest.mark.parametrize("name", FAR_AND_INFINITE)
def test_far_beyond_the_discount_is_the_infinite_sum(name):
    with pytest.warns(UserWarning, match="horizon 1000000000 is followed to step 13803"):
        far = FAR_AND_INFINITE[name](FAR)
    np.testing.assert_allclose(far, FAR_AND_INFINITE[name](None), rtol=1e-11, atol=1e-13)


@pytest.mark.large
def test_a_late_reward_is_not_cut_off():
    n = 12_000  # a corridor: the only reward comes after 12 000 steps, .99^12000 = 4e-53
    rows = sparse.csr_array((np.ones(n), (np.arange(n), np.minimum(np.arange(1, n + 1), n - 1))), shape=(n, n))
    corridor = oee.FiniteMDP(rows, np.eye(1, n, n - 1)[0], 0, 0.99)
    with pytest.warns(UserWarning, match="is followed to step"):
        far = oee.policy_value(corridor, np.ones((n, 1)), horizon=FAR)
    assert far == pytest.approx(0.99 ** (n - 1) / 0.01, rel=1e-9)


def test_policies_that_change_with_time_are_followed_to_their_end():
    changing, fast = np.repeat(POLICY[None], 10_500, axis=0), TARGET.with_discount(0.5)
    assert oee.policy_value(fast, changing, horizon=10_500) == pytest.approx(oee.policy_value(fast, POLICY), rel=1e-12)


def test_weights_that_outgrow_the_discount_are_not_cut():
    expert = oee.tasks.gridworld_expert(3)
    loop = oee.FiniteMDP(np.ones((1, 2, 1)), [[1.0, 0.0]], [1.0], 0.9)
    with pytest.raises(ValueError, match=r"horizon must be one that can be carried out; 100000000000 steps take some"):
        oee.policy_is_moments(loop, [[0.5, 0.5]], [[1.0, 0.0]], horizon=10**11)
    with pytest.warns(UserWarning, match="is followed to step"):  # here the spectral radius is below 1
        far = oee.weighted_return_moments(SIMULATOR, ZETA, expert, horizon=FAR)
    assert far.variance == pytest.approx(oee.weighted_return_moments(SIMULATOR, ZETA, expert).variance, rel=1e-9)


def test_at_discount_1_the_cost_is_reported():
    for call in (oee.policy_value, oee.return_moments, oee.occupancy):
        with pytest.raises(ValueError, match=r"1000000000 steps take some \de\+1\d multiply-adds \(.* hours\)"):
            call(TARGET.with_discount(1.0), POLICY, horizon=FAR)
    with pytest.warns(UserWarning, match=r"horizon 20000 takes some 2e\+09 multiply-adds"):
        assert limit_horizon(20_000, 1.0, work=1.2e5) == 20_000


def test_arrays_with_an_entry_for_each_step_must_fit():
    with pytest.raises(ValueError, match=r"horizon must be small enough .*; 1000000 needs 7.45e\+03 GiB"):
        limit_horizon(10**6, 1.0, kept=10**6)


def test_sampled_episodes():
    with pytest.warns(UserWarning, match="is followed to step"):
        log = oee.sample_episodes(TARGET, POLICY, 3, FAR, seed=0)
    np.testing.assert_array_equal(log.state, oee.sample_episodes(TARGET, POLICY, 3, 10_000, seed=0).state)
    endless = oee.FiniteMDP(np.ones((1, 1, 1)), [1.0], [1.0], 0.5)
    assert len(oee.sample_episodes(endless, [[1.0]], 1, 200_000, seed=0)) == 200_000  # a log of a million is not cut

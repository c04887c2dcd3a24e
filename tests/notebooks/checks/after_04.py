"""What the cells of notebook 04 leave is what its text says."""

import numpy as np

import oee_tabular as oee


def after_04_03(first):
    np.testing.assert_allclose(first, 1.0, rtol=1e-9)


def after_04_05(W, middle, second):
    assert middle[-1] < 1e-3
    assert (W[:, -1] ** 2).mean() < 0.01 * second[-1]


def after_04_11(second_moment):
    assert second_moment(0.3, 0.1) < second_moment(0.1, 0.3)


def after_04_15(curves, horizons, policy, simulator, target, zeta):
    # the weighted three have the target's value as their mean
    for h in map(int, horizons):
        J = oee.policy_value(target, policy, horizon=h)
        for moments in (
            oee.doubly_robust_moments(simulator, zeta, policy, horizon=h),
            oee.weighted_return_moments(simulator, zeta, policy, horizon=h),
            oee.weighted_return_moments(
                simulator, zeta, policy, horizon=h, kind="trajectory"
            ),
        ):
            np.testing.assert_allclose(moments.mean, J, rtol=1e-8)
    assert (
        curves["return, unweighted"][-1]
        < curves["doubly robust"][-1]
        < curves["per decision"][-1]
        < curves["trajectory"][-1]
    )


def after_04_19(spread):
    multiplied, reweighted, simulated = spread.values()
    assert (reweighted < simulated).all()
    assert (simulated < multiplied).all()
    assert reweighted.max() < 3


def after_04_21(J, covered, exactly, value):
    assert covered.mean() < 0.88
    assert value.std() < 0.1 * exactly
    assert (value > J).mean() > 0.6


def after_04_23(policy, target, variance):
    np.testing.assert_allclose(
        variance[10], oee.return_moments(target, policy, horizon=50).variance, rtol=1e-9
    )
    assert variance[0] > 1e4 * variance[10]


def after_04_25(divided, plain):
    assert divided > 0.5 * plain  # at T = 200


def after_04_09(exact, free, growth, policies, simulator, t, zeta):
    for name, policy in policies.items():
        assert exact.weight_growth(simulator, zeta, policy) <= free
        assert (growth[name] <= np.exp(free * t) * (1 + 1e-9)).all()

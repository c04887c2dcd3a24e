"""What the cells of notebook 01 leave is what its text says."""

import numpy as np

import oee_tabular as oee


def after_01_05(V, fast, motor):
    np.testing.assert_allclose(V, oee.state_values(motor, fast))


def after_01_07(curves):
    assert curves["fast"][0] > curves["slow"][0]
    assert curves["fast"][-1] < curves["slow"][-1]


def after_01_11(finite, rest, whole):
    assert (np.abs(whole - finite) <= rest).all()


def after_01_16(by_occupancy, by_values, d):
    np.testing.assert_allclose(by_values, by_occupancy, rtol=1e-10)
    np.testing.assert_allclose(d.sum(), 1.0)


def after_01_18(moments, n, running):
    assert abs(running[-1] - moments.mean) < 4 * moments.standard_deviation / np.sqrt(n)


def after_01_22(entering, leaving, paid_leaving, policy):
    # leaving pays for the start at once, then what entering pays, one step later
    start = leaving.rewards[0, 0]
    np.testing.assert_allclose(
        paid_leaving, start + 0.99 * oee.policy_value(entering, policy, horizon=99)
    )


def after_01_24(gap, share):
    np.testing.assert_allclose(share.sum(), gap, rtol=1e-9)


def after_01_26(found):
    assert found.error_bound < 1e-9

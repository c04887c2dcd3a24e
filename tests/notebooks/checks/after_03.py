"""What the cells of notebook 03 leave is what its text says."""

import numpy as np

import oee_tabular as oee


def after_03_03(P_tr, by_the_page, zeta):
    np.testing.assert_allclose(by_the_page[P_tr > 0], zeta.values.data, rtol=1e-12)


def after_03_09(T, J_of_paper, policy, reweighted, target):
    assert abs(reweighted.transitions - target.transitions).max() < 1e-15
    np.testing.assert_allclose(
        J_of_paper, oee.policy_value(reweighted, policy, horizon=T), rtol=1e-9
    )


def after_03_15(wrong):
    assert wrong["default"].mean() < 0.1 * wrong["plain"].mean()


def after_03_17(truth, values, worst):
    # what the title and the slides say
    assert worst["default"] < 0.3 < 1 < worst["plain"] < 1.5 < 20 < worst["simulator"]
    assert (
        np.abs(values["default"] - truth) < 0.1 * np.abs(values["simulator"] - truth)
    ).all()


def after_03_21(by_counts, fallback):
    np.testing.assert_allclose(by_counts, fallback, rtol=1e-9)


def after_03_23(errors, slope):
    # 1000 transitions with the tilt beat 100 000 without
    assert errors["default"][0] < errors["plain"][-1]
    assert -0.6 < slope < -0.4


def after_03_25(exploded, mended):
    assert mended < 100 < 1e20 < exploded


def after_03_27(bound, quotient_variance):
    assert quotient_variance > 1.3 * bound

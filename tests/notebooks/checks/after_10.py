"""What the cells of notebook 10 leave is what its text says."""

import numpy as np

import oee_tabular as oee


def after_10_03(testing, verdicts):
    assert verdicts.passed
    assert len(testing.LAWS) == 16


def after_10_06(checked):
    assert [found.passed for found in checked.values()] == [
        True,
        False,
        False,
        False,
        False,
    ]


def after_10_08(checked):
    assert "ragged" in checked["drops finished episodes"].broken
    assert checked["SaysUnbiased"].broken == ("unbiased",)


def after_10_10(chain, limit, t):
    assert abs(chain.truth - sum(0.9**t * 0.7**t)) < 1e-12
    assert abs(limit - sum(0.9**t)) < 1e-12


def after_10_13(more):
    assert more.passed


def after_10_15(found):
    assert abs(found.inefficiency - 1) < 4 * found.inefficiency_error


def after_10_16(found, rmse, sizes):
    assert abs(rmse["smoothed (ours)"][-1] / np.sqrt(found.bound / sizes[-1]) - 1) < 0.4


def after_10_20(exceeds, simulator, target):
    assert exceeds((simulator, target))


def after_10_22(normalised_sides, simulator, target):
    assert normalised_sides(target, simulator, oee.uniform_policy(target)).holds


def after_10_22b(ratio):
    assert (ratio["oee"].loc[["paper_grid", "floor_motor"]] < 0.6).all(axis=None)
    assert (
        ratio["oee"].loc["garnet_identical"] < ratio["ours"].loc["garnet_identical"]
    ).all()


def after_10_18(test_simulation_lemma):
    test_simulation_lemma()  # raises where the lemma is false

"""What the cells of notebook 11 leave is what its text says."""

import numpy as np


def after_11_05(found):
    assert all(estimate.status == "ok" for estimate in found.values())


def after_11_07(errors, high, low, truths):
    for before, after in errors:
        assert abs(after) < 0.25 * abs(before)
    assert all(low[k] - 15 < truths[k][0] < high[k] + 15 for k in range(2))


def after_11_09(value):
    assert "hidden state" in value.status


def after_11_11(after, mended, report, truth, wrong):
    assert not any(c.hidden for c in mended.coordinates)
    assert abs(after - truth) < abs(wrong - truth) / 5
    assert report.answers[0].estimator == "oee (residual, last 2 actions)"


def after_c6f613b9(after, fit, truth):
    assert np.abs(fit.residual).max() < 1e-9  # nothing is left
    assert abs(after - truth) < 0.5

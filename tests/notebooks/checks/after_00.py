"""What the cells of notebook 00 leave is what its text says."""

import numpy as np


def after_00_10(log):
    assert log.reward.sum() == 0


def after_00_16(report, sure):
    (shown,) = (
        result.estimate.interval
        for result in report.results
        if result.estimator == "oee"
    )
    assert sure.width > 0.5
    np.testing.assert_allclose(shown, [sure.lower, sure.upper], atol=1e-6)


def after_00_18(boxed, sure):
    assert boxed.width < sure.width


def after_00_26(intervals, promised, truth):
    assert truth in intervals["+ 3000 as planned"]
    assert promised not in intervals["+ 3000 as planned"]
    assert (
        intervals["+ 3000 as planned"].width < 0.25 * intervals["+ 3000 random"].width
    )

"""What the cells of notebook 00 leave is what its text says."""

import numpy as np

import oee_tabular as oee


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


def after_00_26b(data, policy, real, simulator):
    assert data.startswith("R0lGODlh")  # GIF89a in base 64
    # the stream that animate_two gives to both robots
    word = int(np.random.default_rng(1).integers(2**63))
    arrived, fallen = (
        oee.sample_episodes(mdp, policy, 1, 30, seed=word) for mdp in (simulator, real)
    )
    assert arrived.next_state[-1] == 63
    assert fallen.next_state[-1] != 63
    assert real.absorbing()[fallen.next_state[-1]]

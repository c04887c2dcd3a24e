"""What the cells of notebook 08 leave is what its text says."""

import numpy as np


def after_08_05(mdp):
    assert mdp.n_states == 32 * 32 + 1


def after_08_07(off, sizes, wrong):
    assert off[sizes.index(32)] > 0.5 * wrong
    assert off[sizes.index(100)] < 0.1 * wrong
    assert (np.diff(off) < 0).all()


def after_08_09(J_sim, plane, value):
    assert abs(value - J_sim[2]) > 10 * abs(plane - J_sim[2])


def after_08_15(calibrated, error, fixed):
    np.testing.assert_allclose(fixed.diagnostics["calibrated_value"], calibrated[2])
    assert error["calibrated"] < min(0.003, 0.3 * error["raw"])


def after_08_17(linear, means, residual):
    assert means["OEE, calibrated"][1] < 0.5 * means["simulator"][1]
    assert means["OEE, calibrated"][2] < 0.5 * min(
        means["simulator"][2], means["model-based"][2]
    )
    assert max(means["model-based, calibrated"][2], linear, residual) < 0.003


def after_08_19(away, error):
    paper_oee, paper_sim = (
        np.nanmean(away[name])
        for name in ("the paper's OEE", "its own simulator, left out")
    )
    assert paper_sim < paper_oee
    assert error["calibrated"] < 0.1 * paper_oee


def after_08_03(J_sim, J_target, samples):
    for name, line in {"simulator": J_sim, "target": J_target}.items():
        for few, many in zip(samples[name], line, strict=True):
            assert abs(few.value - many) < 5 * few.standard_error

"""What the cells of notebook 05b leave is what its text says."""

import numpy as np


def after_05b_26(many, one):
    assert one.details["strength"] < 0.5 * many.details["strength"]


def after_05b_27(largest, strengths):
    assert largest[0] == "log P at s 1"
    assert strengths["log P at s"][0] < 0.01 * strengths["drift at s"][0]


def after_05b_30(error):
    assert error["the halves, known"] < 0.1 * error["the default's"]
    assert error["the default's"] < 0.75 * error["one direction"]


def after_05b_33(J, se, values):
    # the move mends most of what the wrong prior did
    assert abs(values[2] - J) < 0.5 * abs(values[0] - J)
    # its narrow interval knew nothing of it
    assert abs(values[0] - J) > 1.96 * 10 * se[0]
    # the default was right to begin with
    assert abs(values[5] - J) < 0.1 * abs(values[2] - J)


def after_05b_34a(left_over, thresholds):
    for t in thresholds.values():
        assert left_over(6, t) <= np.sqrt(1 + t**2)
    assert left_over(0, 1.70) < 0.2 < 0.5 < left_over(0, 0.73) < 0.55


def after_05b_36(error):
    assert error["tilt by (action, displacement)"] < 0.5 * error["tilt by log P"]
    assert error["default"] < 0.5 * error["tilt by log P"]


def after_05b_38(rms, zetas):
    # the tilt's zeta is much nearer than the counts' ...
    assert zetas[:, 1].mean() < 0.3 * zetas[:, 0].mean()
    assert rms[0][1] > 3 * rms[0][0]  # ... and its value much further away
    assert rms[1][1] < 0.5 * rms[0][1]  # the move mends most of it
    assert rms[0][3] < 1.2 * rms[0][0]  # with V the value needs no move

"""What the cells of notebook 06 leave is what its text says."""

import numpy as np

import oee_tabular as oee


def after_06_04(curves, networks, slope, trivial):
    assert abs(networks[0] - trivial) < 0.01
    assert abs(slope + 0.5) < 0.05
    assert (curves["default (tilt by evidence)"] < 0.1 * networks).all()


def after_06_04b(curves, networks, parts):
    assert all((curve < 1.9 * networks).all() for curve in curves.values())
    assert (np.diff(parts["sampling"]) < 0).all()


def after_06_08(growth):
    assert (
        growth["the paper's quotient"][-1] > 10 * growth["the same, rows divided"][-1]
    )


def after_06_10(values):
    assert (values.error["OEE, exact"] < 0.5 * values.error["simulator"]).all()


def after_06_12(sd):
    assert sd[0.1] > 1e5 * sd[0.9]


def after_06_14(against_itself, oee_off, wide):
    assert (against_itself == 0).all()
    assert wide.columns[0].startswith("OEE")
    assert oee_off.min() > 0.015


def after_06_17(nearer, same):
    assert same.sum() == 11
    assert nearer.sum() == 5


def after_06_19(better, experiments, gap, mean):
    assert [
        experiments.published("kinova", "table1", s)["mean"].item()
        for s in ("true_value", "oee", "simulator")
    ] == mean.tolist()
    assert better == 5
    assert 0.25 < gap < 0.4


def after_06_21(n, needed):
    growth_rate = np.log(needed[-1].ratio / needed[0].ratio) / np.log(n[-1] / n[0])
    assert abs(growth_rate - 0.5) < 0.01
    assert (
        min(found.probability_flat + found.probability_forced for found in needed) > 0.3
    )


def after_06_23(sides):
    assert not any(s.holds for s in sides[1:])
    assert round(sides[1].ratio, 2) == 1.43


def after_06_25(both, curves):
    assert all(s.holds for found in both.values() for s in found)
    assert (
        curves["(C) by KL of the path"][-1]
        < 0.1 * curves["(B) rows sum to 1"][-1]
        < curves["(A) any rows"][-1]
    )


def after_06_06(gridworld_policy, simulator, target):
    for delta in (0.0, 0.4):
        policy = gridworld_policy(10, delta)
        visits = [oee.occupancy(mdp, policy).sum(axis=1) for mdp in (target, simulator)]
        ratio = visits[0] / visits[1]
        if delta == 0:
            assert np.abs(ratio - 1).max() < 1e-9
        else:
            assert ratio.max() > 2 * ratio.min()

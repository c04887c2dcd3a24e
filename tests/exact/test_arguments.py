"""Bad input of the room's functions: whichever argument is wrong, it is named first, with the rule and what was given."""

import inspect

import numpy as np
import pytest
from helpers import BEHAVIOR, POLICY, environments, survival_chain
from scipy import sparse

import oee_tabular as oee
from oee_tabular import exact

FUNCTIONS = (
    exact.action_values,
    exact.doubly_robust_moments,
    exact.efficiency_bound,
    exact.leading_bias,
    exact.occupancy,
    exact.policy_is_moments,
    exact.policy_value,
    exact.policy_values_by_horizon,
    exact.ratio_of_ratios_variance,
    exact.return_moments,
    exact.reweight,
    exact.state_values,
    exact.trajectory_efficiency_bound,
    exact.weight_growth,
    exact.weight_moments,
    exact.weighted_return_moments,
)
SIMULATOR, TARGET = environments(2)
SHARE = np.array([[0.1, 0.2], [0.15, 0.05], [0.3, 0.2]])
GOOD = {
    "mdp": SIMULATOR,
    "simulator": SIMULATOR,
    "target": TARGET,
    "policy": POLICY,
    "behavior_policy": BEHAVIOR,
    "zeta": oee.true_ratio(TARGET, SIMULATOR),
    "ratio": oee.true_ratio(TARGET, SIMULATOR),
    "data_distribution": SHARE,
    "simulator_distribution": SHARE[::-1],
    "baseline": np.zeros((3, 3)),
    "horizon": 2,
}


def edited(entry, value):
    matrix = SIMULATOR.transitions.copy()
    matrix.data = matrix.data.copy()
    matrix.data[entry] = value
    return matrix


MODEL = [(3, " must be a FiniteMDP; got int$"), (None, " must be a FiniteMDP; got NoneType$")]
TABLE = [(POLICY * 2, r"\[0\] must sum to 1"), (np.stack([POLICY] * 3), " must have shape ")]
SHAPE = r" must be sparse of shape \(6, 3\), row s\*A \+ a; got "
RATIO = [
    (3.0, SHAPE + "float$"),
    (np.ones((6, 3)), SHAPE + r"\(6, 3\)$"),
    (edited(5, -1.0), r" must be finite and nonnegative; at s=0, a=1 -> s'=2 it is -1\.0$"),
    (edited(6, np.nan), " must be finite and nonnegative; at s=1, a=0 -> s'=0 it is nan$"),
]
DISTRIBUTION = [
    (SHARE / 2, " must sum to 1"),
    (np.full(3, 1 / 3), r" must have shape \(3, 2\); it has shape \(3,\)$"),
]
FLAG = [("yes", " must be ")]
BAD = {  # of an argument's name: what is given, and what is said after the name
    "mdp": MODEL,
    "simulator": MODEL,
    "target": MODEL,
    "policy": TABLE,
    "behavior_policy": TABLE,
    "zeta": RATIO,
    "ratio": RATIO,
    "data_distribution": DISTRIBUTION,
    "simulator_distribution": DISTRIBUTION,
    "horizon": [(0, " must be a positive integer; it is 0$")],
    "kind": [("step", " must be one of 'per_decision', 'trajectory'; got 'step'$")],
    "rows": [("clipped", " must be one of 'as_they_are', 'normalised'; got 'clipped'$")],
    "model": [("bush", " must be one of 'mdp', 'tree', 'stationary'; got 'bush'$")],
    "of": [("pairs", " must be one of 'state', 'state_action', 'transition'; got 'pairs'$")],
    "baseline": [
        ("V", " must be an array of numbers; got str"),
        (np.full((3, 3), np.inf), r"\[0, 0\] must be finite; it is inf$"),
        (np.ones((2, 3)), r" must have shape \(3, 3\), values to go at t; it has \(2, 3\)$"),
    ],
    "sources": FLAG,
    "self_normalized": FLAG,
    "independent_samples": FLAG,
    "action_baseline": FLAG,
    "normalized": FLAG,
}


@pytest.mark.parametrize("function", FUNCTIONS)
def test_each_wrong_argument_is_named(function):
    names = inspect.signature(function).parameters
    right = {name: GOOD[name] for name in names if name in GOOD}
    function(**right)
    for name in names.keys() & BAD.keys():
        for value, text in BAD[name]:
            with pytest.raises(ValueError, match=f"^{name}{text}"):
                function(**right | {name: value})


CHAIN, ONE, SAME = survival_chain(), np.ones((2, 1)), sparse.csr_array(np.ones((2, 2)))
GRID = oee.tasks.gridworld(3, 0.3)
UNIFORM = oee.uniform_policy(GRID)
TOGETHER = {
    "a trajectory without end": (
        lambda: oee.weighted_return_moments(CHAIN, SAME, ONE, kind="trajectory"),
        "horizon must be given: the infinite sum has no variance for trajectory weights",
    ),
    "self-normalised without end": (
        lambda: oee.weighted_return_moments(CHAIN, SAME, ONE, self_normalized=True),
        "horizon must be given: the infinite sum has no variance for self-normalised weights",
    ),
    "moments at discount 1": (
        lambda: oee.return_moments(CHAIN.with_discount(1.0), ONE),
        "horizon must be given: at discount 1",
    ),
    "the bound at discount 1": (
        lambda: oee.efficiency_bound(TARGET.with_discount(1.0), POLICY, SHARE),
        "^horizon must be given at discount 1$",
    ),
    "the bias at discount 1": (
        lambda: exact.leading_bias(TARGET.with_discount(1.0), POLICY, SHARE),
        "^horizon must be given at discount 1$",
    ),
    "doubly robust without end": (
        lambda: oee.doubly_robust_moments(CHAIN, SAME, ONE, horizon=None),
        "^horizon must be a positive integer; got None$",
    ),
    "values of no horizon": (
        lambda: exact.policy_values_by_horizon(CHAIN, ONE, horizon=None),
        "horizon must be a positive integer; got None",
    ),
    "policies of another length": (
        lambda: exact.policy_values_by_horizon(CHAIN, np.stack([ONE] * 3), horizon=2),
        r"policy must have shape \(2, 1\) or \(2, 2, 1\) .*it has shape \(3, 2, 1\)",
    ),
    "a target outside the simulator": (
        lambda: exact.ratio_of_ratios_variance(oee.tasks.gridworld(3, 0.0), GRID, UNIFORM, UNIFORM / 9, UNIFORM / 9),
        "target must stay in the simulator's support",
    ),
    "no support": (
        lambda: oee.trajectory_efficiency_bound(GRID, np.eye(4)[np.zeros(9, dtype=int)], UNIFORM, horizon=3),
        r"^behavior_policy must take every action that the policy takes; in state 0 it never takes action 1 \(",
    ),
}


@pytest.mark.parametrize("name", TOGETHER)
def test_arguments_that_do_not_go_together(name):
    call, text = TOGETHER[name]
    with pytest.raises(ValueError, match=text):
        call()

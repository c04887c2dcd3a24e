"""Methods of ratios as objects: what a name stands for, and limits."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import oee_tabular as oee
from oee_tabular.estimators import OffEnvironment
from oee_tabular.ratio import Conditional, InClass, Joint, Network, Quotient, Sgd, Tied

SIMULATOR, TARGET = oee.tasks.gridworld(3, 0.3), oee.tasks.gridworld(3, 0.1)
POLICY = oee.tasks.gridworld_policy(3, 0.5)
LOG = oee.sample_episodes(TARGET, oee.uniform_policy(TARGET), 30, 20, seed=0)
SHIFT = np.arange(SIMULATOR.transitions.nnz) % 3
STATE = np.arange(9.0)
SAME = {
    "conditional": ({"prior": "simulator", "strength": 2.0}, Conditional(prior="simulator", strength=2.0)),
    "tied": ({"tie": SHIFT, "strength": 1.0}, Tied(SHIFT, strength=1.0)),
    "linear": ({"features": SHIFT.astype(float)}, InClass(features=SHIFT.astype(float))),
    "kernel": ({"coordinates": STATE, "bandwidth": 2.0}, InClass(kernel="gaussian", coordinates=STATE, bandwidth=2.0)),
    "ratio_of_ratios": ({"lower": 0.1, "simulator_data": "exact"}, Quotient(lower=0.1, data="exact")),
    "joint": ({"upper": 5.0, "simulator_data": "exact"}, Joint(upper=5.0, data="exact")),
}


@pytest.mark.parametrize("name", SAME)
def test_a_name_stands_for_an_object(name):
    options, method = SAME[name]
    named = oee.transition_ratio(LOG, SIMULATOR, method=name, seed=3, **options)
    for found in (oee.transition_ratio(LOG, SIMULATOR, method=method, seed=3), method.fit(LOG, SIMULATOR, seed=3)):
        assert_array_equal(found.values.data, named.values.data)
        assert (found.method, found.gap) == (named.method, named.gap)


def test_a_limit_knows_no_training():
    values = [
        OffEnvironment(Quotient(normalized=False, lower=0.5, upper=2.0, **by)).limit(SIMULATOR, TARGET, POLICY)
        for by in ({}, {"solver": Sgd(n_iterations=5)}, {"functions": Network()})
    ]
    assert values[0] == values[1] == values[2]

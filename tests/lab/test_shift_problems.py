"""The problems on which the prior is confirmed: their targets differ from their simulators and stay in their support."""

import numpy as np
import pytest
from benchmarks.shift_problems import KEPT_ASIDE, PROBLEMS, SEEN, make_problem


@pytest.mark.parametrize("name", sorted(PROBLEMS))
def test_problem(name):
    family = make_problem(name, 0)
    simulated, real = family.simulator.transitions.toarray(), family.target.transitions.toarray()
    assert not family.identical
    assert np.abs(simulated - real).max() > 0.01
    assert not real[simulated == 0].any()
    assert 30 <= family.simulator.n_states <= 400
    assert np.isfinite(family.truth)


def test_halves_share_nothing():
    assert len(SEEN) == len(KEPT_ASIDE) == 9
    assert set(SEEN) | set(KEPT_ASIDE) == set(PROBLEMS)

"""What a newcomer's own files run into: each was met by someone who had read the README
alone.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import oee_tabular as oee


def dock(slip=0.1):
    """Three places in a row and a dock; forwards or stay; -1 a step, 10 at the dock,
    where it is over.
    """
    P = np.zeros((4, 2, 4))
    r = np.full((4, 2, 4), -1.0)
    for s in range(3):
        P[s, 0, s + 1] = 1.0 - slip
        P[s, 0, s] = slip
        P[s, 1, s] = 1.0
    P[3, :, 3] = 1.0
    r[:3, :, 3] = 10.0
    r[3] = 0.0
    return oee.FiniteMDP(P, r, [1.0, 0, 0, 0], 0.9)


SWAP = oee.FiniteMDP(
    [[[0, 1, 0]], [[1, 0, 0]], [[0, 0, 1]]], [0.0, 1.0, 2.0], [1, 0, 0], 0.9
)
DOCK = dock()
ENDED = {"terminated": [False, True]}


@pytest.mark.parametrize(
    ("simulator", "rows", "columns", "text"),
    [
        (
            DOCK,
            ([0, 0], [0, 0], [1, 2]),
            {},
            r"to 1 of its transitions \(1 of 2 with repetitions\).* No action leads"
            r" from 0 to 2 "
            r"in the simulator, so action noise does not help\..*P\[0, 0\] \*= 0\.99;"
            r" P\[0, 0, 2\] \+= 0\.01; \(2\) if the log",
        ),
        (DOCK, ([0, 0], [0, 1], [2, 1]), {}, "it does for 1 of the 2"),
        (
            DOCK,
            ([0], [1], [1]),
            {},
            r"Fix one of these: \(1\) simulator\.with_action_noise",
        ),
        (
            DOCK,
            ([1, 2, 3], [0] * 3, [2, 3, 4]),
            {},
            r"it is 4 \(1 such transitions\); are they numbered from 1\? Then subtract",
        ),
        (
            SWAP,
            ([1, 2], [0, 0], [2, 1]),
            {},
            "With 1 subtracted from every state all transitions are possible",
        ),
        (DOCK, ([1], [0], [7]), {}, r"it is 7 \(1 such transitions\)$"),
        (
            DOCK,
            ([0, 1], [0, 0], [1, 2]),
            ENDED,
            (
                r"mark them truncated instead; if the task ends there, make the state"
                r" terminal, P"
            ),
        ),
    ],
)
def test_what_contradicts_the_simulator_has_its_own_ways_out(
    simulator, rows, columns, text
):
    """Transitions that no action makes, states numbered from one, time limits that are
    called ends.
    """
    with pytest.raises(ValueError, match=text):
        oee.Problem(simulator, oee.Transitions(*rows, **columns))


def test_single_precision_is_scaled():
    """Frequencies of a network or a file in float32 sum to 1 to 1e-7; what misses 1 by
    more is refused.
    """
    rng = np.random.default_rng(0)
    P = rng.dirichlet(np.ones(7), size=(7, 3))
    policy = rng.dirichlet(np.ones(3), size=7)
    single = oee.FiniteMDP(
        P.astype(np.float32), np.zeros(7), np.full(7, 1 / 7, dtype=np.float32), 0.9
    )
    assert_allclose(single.transitions.toarray().sum(axis=1), 1.0, rtol=0, atol=1e-15)
    assert_allclose(
        single.transitions.toarray(), P.reshape(21, 7), rtol=1e-6, atol=1e-8
    )
    assert np.isfinite(oee.policy_value(single, policy.astype(np.float32)))
    with pytest.raises(ValueError, match=r"policy\[0\] must sum to 1"):
        oee.policy_value(single, (0.999 * policy).astype(np.float32))
    with pytest.raises(ValueError, match=r"must sum to 1"):
        oee.policy_value(single, policy + 1e-7)  # double precision is taken at its word

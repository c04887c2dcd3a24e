"""The error of impossible transitions: which remedies it offers, and to whom."""

import numpy as np
import pytest

import oee_tabular as oee
from oee_tabular import TransitionCounts, Transitions
from oee_tabular.ratio import refuse_unsupported

# 0 leads to 1, 1 to 2, and 2 back to 0
RING = np.eye(3)[[1, 2, 0]][:, None]


def ring(**more):
    return oee.FiniteMDP(RING, [0.0, 0.0, 1.0], 0, 0.9, **more)


def sampled(n):
    """Return a simulator of n samples of each pair, without chance."""
    state = np.tile(np.arange(3), n)
    log = Transitions(state, 0 * state, (state + 1) % 3, 1.0 * state)
    return oee.FiniteMDP.from_log(log, discount=0.9, initial=0)


def told_of(simulator, odd, of):
    """Return the error of a log with ``odd`` of ``of`` transitions from 1 to 0."""
    counts = TransitionCounts(
        [0, 1, 1, 2], [0] * 4, [1, 2, 0, 0], [9, of - odd, odd, 9]
    )
    with pytest.raises(ValueError, match="support") as caught:
        refuse_unsupported(counts.counts(3, 1), simulator)
    return str(caught.value)


@pytest.mark.parametrize("odd", [1, 3, 6])
def test_a_rare_transition_may_be_allowed(odd):
    assert "allow=0.0099" in told_of(sampled(100), odd, 200)
    assert "allow=0.01" in told_of(ring(), odd, 200)


@pytest.mark.parametrize(("odd", "of"), [(40, 200), (190, 200), (5, 6)])
@pytest.mark.parametrize("simulator", [sampled(100), ring()])
def test_a_frequent_one_is_named_and_not_allowed(simulator, odd, of):
    told = told_of(simulator, odd, of)
    assert "allow=" not in told
    assert f"a=0 {odd} of {of} transitions are impossible, most to 0: more than" in told
    assert "--impossible drop" in told


@pytest.mark.parametrize("has_ends", [False, True])
def test_a_column_that_was_shifted_is_recognised(has_ends):
    """The next state of each episode's last row is the first state of the next one."""
    rng = np.random.default_rng(0)
    first = rng.integers(0, 2, 40)
    state = np.concatenate([np.arange(k, k + 3) % 3 for k in first])
    episode = np.repeat(np.arange(40), 3)
    shifted = np.append(state[1:], 0)
    more = {"terminated": np.tile([0, 0, 1], 40)} if has_ends else {}
    log = Transitions(state, 0 * state, shifted, episode=episode, **more)
    with pytest.raises(ValueError, match="made by shifting state by one row") as caught:
        oee.Problem(ring(), log)
    assert "In 39 of the 39 places where an episode ends" in str(caught.value)
    # other next states say nothing of it
    right = (state + 1) % 3
    right[5] = 0 if right[5] else 1
    wrong = Transitions(state, 0 * state, right)
    with pytest.raises(ValueError, match="support") as caught:
        oee.Problem(ring(), wrong)
    assert "shifting" not in str(caught.value)

"""Certain changes of rows: bounds that hold, all at once, and say nothing where there is nothing to say."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.optimize import brentq

import oee_tabular as oee
from oee_tabular.inference import row_changes
from oee_tabular.inference.changes import lower_mass

SIMULATOR, TARGET = oee.tasks.gridworld(4, 0.3), oee.tasks.gridworld(4, 0.1)


def true_change():
    apart = np.abs((SIMULATOR.transitions - TARGET.transitions).toarray()).sum(axis=1)
    return 0.5 * apart.reshape(16, 4)


@pytest.mark.parametrize("n", [300, 5_000, 50_000])
def test_bounds_hold_all_at_once(n):
    truth, kept = true_change(), 0
    for seed in range(40):
        log = oee.sample_transitions(TARGET, np.full((16, 4), 1 / 64), n, seed=seed)
        found = row_changes(oee.Problem(SIMULATOR, log), confidence=0.9)
        kept += bool((found.certain <= truth + 1e-12).all())
        assert (found.certain <= found.estimated + 1e-12).all()
    assert kept >= 36
    if n == 50_000:
        assert found.n_certain > 40
        assert found.certain.max() > 0.1


def test_episodes_take_the_wider_ball():
    log = oee.sample_episodes(TARGET, oee.uniform_policy(TARGET), 200, 40, seed=0)
    bag = log.draw(len(log), seed=0)
    whole, drawn = (row_changes(oee.Problem(SIMULATOR, data)) for data in (log, bag))
    assert_allclose(whole.estimated, drawn.estimated, rtol=1e-12, atol=1e-15)
    assert (whole.certain <= drawn.certain + 1e-12).all()
    assert whole.certain.sum() < drawn.certain.sum()


def test_the_simulator_s_own_log_changes_nothing_and_its_fields_agree():
    log = oee.sample_transitions(SIMULATOR, np.full((16, 4), 1 / 64), 4_000, seed=1)
    found = row_changes(oee.Problem(SIMULATOR, log))
    assert found.n_certain == 0
    assert found.largest() == []
    assert found.counts.sum() == 4_000
    s, a = 5, 2
    row = SIMULATOR.transitions[[s * 4 + a]].toarray()[0]
    moved = log.counts(16, 4)[[s * 4 + a]].toarray()[0] / found.counts[s, a]
    to = found.next_state[s, a]
    assert abs(moved - row).max() == pytest.approx(abs(moved[to] - row[to]))
    assert (found.simulated[s, a], found.observed[s, a]) == (pytest.approx(row[to]), pytest.approx(moved[to]))
    assert found.estimated[s, a] == pytest.approx(0.5 * abs(moved - row).sum())


def test_rows_without_moves_are_left_open():
    found = row_changes(oee.Problem(SIMULATOR, oee.Transitions([0], [0], [4])))
    assert found.tested == 1
    assert found.next_state[3, 3] == -1
    assert np.isnan(found.observed[3, 3])
    assert found.certain[3, 3] == found.estimated[3, 3] == found.evidence[3, 3] == 0.0


@given(st.floats(0.01, 0.99), st.floats(1e-6, 3.0))
def test_the_smallest_mass_is_the_root(frequency, epsilon):
    low = float(lower_mass(np.array([frequency]), np.array([epsilon]))[0])

    def gap(p):
        return frequency * np.log(frequency / p) + (1 - frequency) * np.log((1 - frequency) / (1 - p)) - epsilon

    root = brentq(gap, 1e-300, frequency)
    assert_allclose(low, root, rtol=1e-6, atol=1e-11)


def test_no_ball_and_certain_frequencies():
    assert lower_mass(np.array([0.0, 1.0, 0.5]), np.array([1.0, 0.1, np.inf])) == pytest.approx(
        [0.0, np.exp(-0.1), 0.0], abs=1e-12
    )


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda p: row_changes(p.simulator), "problem must be a Problem; got FiniteMDP"),
        (lambda p: row_changes(p, confidence=1.0), r"confidence must be in \(0, 1\); it is 1"),
        (lambda p: row_changes(p).largest(0), "k must be a positive integer; it is 0"),
    ],
)
def test_bad_calls(call, text):
    with pytest.raises(ValueError, match=text):
        call(oee.Problem(SIMULATOR, oee.Transitions([0], [0], [4])))

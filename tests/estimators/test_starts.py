"""Where a log's episodes begin, against the simulator's first states."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import oee_tabular as oee

UNIFORM = np.full((4, 2), 0.5)


def model(initial):
    """Return four states that lead everywhere alike."""
    return oee.FiniteMDP(
        np.full((4, 2, 4), 0.25),
        np.arange(4.0),
        initial,
        0.9,
        state_names=["dock", "hall", "lane", "yard"],
    )


def log_of(starts):
    """Return episodes of one transition each."""
    n = len(starts)
    rng = np.random.default_rng(n)
    return oee.Transitions(
        starts,
        rng.integers(0, 2, n),
        rng.integers(0, 4, n),
        np.asarray(starts, dtype=float),
        episode=np.arange(n),
    )


def texts(problem):
    return [str(one) for one in problem.findings if one.kind == "first states"]


@pytest.mark.parametrize(
    ("initial", "numbers", "words"),
    [
        (0.25, [40, 0, 0, 0], "40 episodes all begin in state 'dock', to which the"),
        ([0.0, 0.5, 0.5, 0], [0, 20, 19, 1], "40 episodes 1 begin in state 'yard'"),
        ([0.05, 0.9, 0.05, 0], [30, 60, 10, 0], "100 episodes 60 begin in state"),
        ([0.5, 0.5, 0, 0], [200, 0, 0, 0], "200 episodes all begin in state 'dock'"),
    ],
)
def test_a_log_that_begins_elsewhere_has_a_finding(initial, numbers, words):
    law = np.full(4, initial) if np.ndim(initial) == 0 else initial
    log = log_of(np.repeat(np.arange(4), numbers))
    problem = oee.Problem(model(law), log)
    assert words.replace("'", "") in texts(problem)[0].replace("'", "")
    conflict = problem.start_conflict
    assert f"gives probability {conflict.probability:.3g}." in texts(problem)[0]
    assert problem.findings[0].severity >= 1
    # without episodes nobody knows
    rows = log.select(np.arange(len(log)))
    assert oee.Problem(model(law), rows).start_conflict is None


@given(st.integers(0, 10_000), st.integers(1, 300))
@settings(max_examples=300, deadline=None)
def test_a_log_of_the_simulator_itself_has_none(seed, n):
    rng = np.random.default_rng(seed)
    law = rng.dirichlet(np.full(4, 0.5))
    log = log_of(rng.choice(4, n, p=law))
    assert oee.Problem(model(law), log).start_conflict is None


@given(st.integers(0, 10_000), st.integers(1, 40), st.integers(1, 300))
@settings(max_examples=100, deadline=None)
@pytest.mark.filterwarnings("ignore")
def test_a_simulator_made_of_samples_may_lack_a_first_state(seed, n_samples, n):
    rng = np.random.default_rng(seed)
    law = rng.dirichlet(np.full(4, 0.5))
    sampled = log_of(rng.choice(4, n_samples, p=law))
    simulator = oee.FiniteMDP.from_log(sampled, discount=0.9, n_states=4, n_actions=2)
    log = log_of(rng.choice(4, n, p=law))
    allowed = simulator.with_support_of(log, 0.1)
    assert oee.Problem(allowed, log).start_conflict is None


@pytest.mark.filterwarnings("ignore:the log has no episodes")
def test_the_mean_of_all_states_is_no_first_state():
    """A simulator made of rows starts anywhere; the log's episodes all start at 0."""
    simulator = model(0)
    sampled = oee.sample_episodes(simulator, UNIFORM, 300, 30, seed=0)
    rows = oee.FiniteMDP.from_log(sampled.select(np.arange(len(sampled))), discount=0.9)
    log = oee.sample_episodes(simulator, UNIFORM, 50, 30, seed=1)
    found = texts(oee.Problem(rows, log))
    assert found[0].startswith("Of the log's 50 episodes all begin in state")
    assert texts(oee.Problem(rows.with_initial(0), log)) == []


def test_counts_begin_where_their_sample_does(tmp_path):
    log = oee.sample_episodes(model(0), UNIFORM, 50, 30, seed=1)
    for k in range(2):
        part = log if k else oee.sample_episodes(model(0), UNIFORM, 9, 30, seed=2)
        part.save(tmp_path / f"{k}.csv")
    counts = oee.Transitions.open(tmp_path)
    law = [0.1, 0.9, 0, 0]
    assert "59 episodes all begin" in texts(oee.Problem(model(law), counts))[0]

"""What a simulator's own sampling adds to an interval: coverage, and each part by
another way of computing it.
"""

import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose

import oee_tabular as oee
from oee_tabular.exceptions import SimulatorWarning
from oee_tabular.inference.asymptotic import outside_margin
from oee_tabular.inference.evidence import gather
from oee_tabular.mdp.empirical import Sampling

# most logs here are a few transitions
pytestmark = pytest.mark.filterwarnings("ignore:the log has no episodes")

PI = np.full((4, 2), 0.5)
START = [0.5, 0, 0, 0.5]
SIMULATOR = oee.FiniteMDP(
    [
        [[0.6, 0.3, 0.1, 0], [0.2, 0.2, 0.3, 0.3]],
        [[0, 0.5, 0.5, 0], [0.1, 0.1, 0.1, 0.7]],
        [[0.3, 0, 0.4, 0.3], [0.25] * 4],
        [[0, 0, 0.1, 0.9], [0.5, 0.02, 0, 0.48]],
    ],
    [0, 1, -2.0, 4],
    START,
    0.8,
)
TARGET = SIMULATOR.with_transitions(
    [
        [[0.5, 0.3, 0.2, 0], [0.3, 0.2, 0.2, 0.3]],
        [[0, 0.6, 0.4, 0], [0.1, 0.2, 0.1, 0.6]],
        [[0.2, 0, 0.4, 0.4], [0.25] * 4],
        [[0, 0, 0.2, 0.8], [0.5, 0.02, 0, 0.48]],
    ]
)


def sampled(seed, spread=2.0):
    """The simulator of a log of its own, with noise in its rewards."""
    log = oee.sample_episodes(SIMULATOR, PI, 40, 10, seed=(seed, 0))
    noise = spread * np.random.default_rng(seed).normal(size=len(log))
    return oee.FiniteMDP.from_log(
        oee.Transitions(**log.columns() | {"reward": log.reward + noise}), discount=0.8
    )


def test_intervals_hold_the_truth_where_the_simulator_was_sampled_too():
    """Of 60: 57; 46 without its share. Of 300: 287 and 236 (all by this function)."""
    truth = oee.policy_value(TARGET, PI)
    hits = {"whole": 0, "bare": 0}
    for seed in range(60):
        simulator = sampled(1000 + seed)
        log = oee.sample_episodes(TARGET, PI, 40, 10, seed=(1000 + seed, 1))
        for name, model in {
            "whole": simulator,
            "bare": simulator._replace(sampling=None),
        }.items():
            hits[name] += truth in oee.interval(
                oee.Problem(model, log, impossible="drop"), PI
            )
    assert hits["whole"] >= 54
    assert hits["bare"] <= 50


def test_the_report_says_where_the_policy_s_own_pairs_are_short():
    log = oee.Transitions(
        [0] * 50 + [1] * 5,
        [0] * 55,
        [0] * 25 + [1] * 25 + [0] * 5,
        [1.0] * 50 + [3.0] * 5,
    )
    with pytest.warns(UserWarning, match="filled in"):
        simulator = oee.FiniteMDP.from_log(log, discount=0.8, n_actions=2)
    problem = oee.Problem(simulator, log)
    few = oee.evaluate(problem, [0, 0], estimators=["simulator", "oee"], seed=0)
    assert (
        "1 of the 2 state-action pairs that the policy uses have fewer than 10 samples"
        in " ".join(few.warnings)
    )
    assert few.records()[0]["interval_method"] == "simulator's samples"
    assert "it was sampled" in few.answer
    none = oee.evaluate(problem, [1, 1], estimators=["simulator"], seed=0)
    assert none.records()[0]["lower"] is None
    assert "do not rely on the value, which has no interval" in " ".join(none.warnings)
    wide = oee.evaluate(
        problem, [0, 0], estimators=["simulator"], confidence=0.99, seed=0
    ).records()[0]
    narrow = few.records()[0]
    assert_allclose(
        (wide["upper"] - wide["lower"]) / (narrow["upper"] - narrow["lower"]),
        2.5758 / 1.96,
        rtol=1e-3,
    )


@pytest.mark.parametrize("horizon", [None, 6])
def test_the_variance_is_that_of_starts_and_mean_rewards(horizon):
    """By the values of the same rows under drawn starts and rewards."""
    simulator = sampled(0)
    log = oee.sample_transitions(SIMULATOR, np.full((4, 2), 1 / 8), 800, seed=1)
    problem = oee.Problem(simulator, log, horizon=horizon, impossible="drop")
    evidence = gather(problem, PI)
    found = outside_margin(problem, evidence)
    rng = np.random.default_rng(0)
    base = simulator.with_transitions(evidence.fitted.transitions)
    pays = base.transition_rewards
    errors = simulator.sampling.reward_error
    values = []
    for _ in range(600):
        table = pays.copy()
        table.data = pays.data + rng.normal(size=pays.nnz) * np.sqrt(
            errors.toarray()[pays.nonzero()]
        )
        starts = (
            rng.multinomial(int(simulator.sampling.starts), simulator.initial)
            / simulator.sampling.starts
        )
        drawn = oee.FiniteMDP(base.transitions, table, starts, 0.8)
        values.append(oee.policy_value(drawn, PI, horizon=horizon))
    assert_allclose(np.var(values), found.variance, rtol=0.15)


def test_transitions_met_once_may_lead_anywhere():
    """Row (0, 0): one of its 5 samples is of a move that no other made: a fifth of its
    moves was never met.
    """
    log = oee.Transitions([0, 0, 0, 0, 0, 1], [0] * 6, [0, 0, 0, 0, 1, 0], [0.0] * 6)
    simulator = oee.FiniteMDP.from_log(log, [0.0, 10.0], discount=0.5, initial=0)
    problem = oee.Problem(simulator, oee.Transitions([1], [0], [0]))
    found = outside_margin(problem, gather(problem, [0, 0]))
    v0, v1 = oee.state_values(simulator, [0, 0])
    time = oee.occupancy(simulator, [0, 0]).reshape(-1) / 0.5
    assert_allclose(
        found.up, time[0] * 0.2 * 0.5 * (v1 - 0.8 * v0 - 0.2 * v1), rtol=1e-12
    )
    # (1, 0) was met twice
    assert_allclose(
        found.down, time[0] * 0.2 * 0.5 * (0.8 * v0 + 0.2 * v1 - v0), rtol=1e-12
    )
    assert found.variance == 0.0
    interval = oee.interval(problem, [0, 0])
    bare = oee.interval(
        oee.Problem(simulator._replace(sampling=None), problem.log), [0, 0]
    )
    assert_allclose(
        [interval.diagnostics["uncut_lower"], interval.upper],
        [bare.diagnostics["uncut_lower"] - found.down, bare.upper + found.up],
        rtol=1e-9,
    )
    assert interval.lower == bare.lower == 0.0  # no reward is below 0
    assert interval.diagnostics["never_met_share"] == 0.0
    assert interval.diagnostics["unmet_share"] == pytest.approx(0.5 * time[0] * 0.2)
    again = oee.Problem(simulator, oee.Transitions([0, 1], [0, 0], [1, 0]))
    assert outside_margin(again, gather(again, [0, 0])).up == 0.0  # the log met it too


def swayed(simulator, problem, horizon, sign, share):
    """J where a share of each row's unmet moves goes, step by step, to where it is
    worth most (sign -1: least).
    """
    evidence = gather(problem, PI)
    p = evidence.fitted.transitions.toarray()
    pays = evidence.with_rows(evidence.transition_rewards).transitions.toarray()
    counts = (
        np.rint(simulator.transitions.toarray() * simulator.sampling.pairs[:, None])
        + problem.counts.toarray()
    )
    total = counts.sum(axis=1)
    unmet = np.where(total > 0, (counts == 1).sum(axis=1) / np.maximum(total, 1), 1.0)
    plain = np.zeros(4)
    value = np.zeros(4)
    for _ in range(horizon):
        far = sign * max(sign * simulator.reward_data) + 0.8 * sign * max(sign * plain)
        place = np.argmax(sign * plain)
        far += 0.8 * (value[place] - plain[place])
        q = (p * (pays + 0.8 * value)).sum(axis=1)
        value = 0.5 * (q + share * unmet * (far - q)).reshape(4, 2).sum(axis=1)
        plain = 0.5 * (p * (pays + 0.8 * plain)).sum(axis=1).reshape(4, 2).sum(axis=1)
    return simulator.initial @ value


@pytest.mark.parametrize("horizon", [1, 2, 7])
def test_with_a_horizon_unmet_transitions_lead_to_the_extreme_value_to_go(horizon):
    log = oee.sample_episodes(SIMULATOR, PI, 4, 5, seed=3)
    with pytest.warns(UserWarning, match="filled in"):
        simulator = oee.FiniteMDP.from_log(
            oee.Transitions(**log.columns()), discount=0.8, n_states=4
        )
    recorded = oee.sample_episodes(simulator, PI, 2, 5, seed=3)
    problem = oee.Problem(simulator, recorded, horizon=horizon)
    found = outside_margin(problem, gather(problem, PI))
    assert found.up > 0.0
    for sign, size in ((1.0, found.up), (-1.0, -found.down)):
        rise = (
            swayed(simulator, problem, horizon, sign, 1e-6)
            - swayed(simulator, problem, horizon, sign, 0.0)
        ) / 1e-6
        assert_allclose(rise, size, rtol=1e-4)


def test_a_row_that_was_filled_in_may_lead_anywhere():
    with pytest.warns(UserWarning, match="filled in"):
        simulator = oee.FiniteMDP.from_log(
            oee.Transitions([0, 0, 1], [0, 0, 0], [0, 0, 1], [0, 0, 9.0]), n_actions=2
        )
    assert simulator.sampling.pairs.tolist() == [2, 0, 1, 0]
    problem = oee.Problem(simulator, oee.Transitions([0], [0], [0]))
    found = oee.interval(problem, [1, 1])
    assert found.upper > 0.5 * 9.0 * 99  # from 0 by action 1 to 1, where it stays


def test_differences_know_of_it_and_the_report_says_it():
    simulator = sampled(3)
    log = oee.sample_episodes(TARGET, PI, 40, 10, seed=4)
    policies = {"one": PI, "other": [0, 0, 0, 0]}
    whole, bare = (
        oee.inference.compare_policies(
            oee.Problem(model, log, impossible="drop"), policies
        )
        for model in (simulator, simulator._replace(sampling=None))
    )
    assert whole.lower[1, 0] < bare.lower[1, 0]
    assert whole.upper[1, 0] > bare.upper[1, 0]
    told = [
        str(finding)
        for finding in oee.Problem(simulator, log, impossible="drop").findings
    ]
    assert told[-1].startswith("The simulator was made of samples")


def test_it_is_kept_where_it_holds(tmp_path):
    simulator = sampled(0)
    own = simulator.sampling
    assert isinstance(own, Sampling)
    simulator.save(tmp_path / "s.npz")
    loaded = oee.FiniteMDP.load(tmp_path / "s.npz").sampling
    assert loaded.pairs.tolist() == own.pairs.tolist()
    assert loaded.starts == own.starts == 40
    assert abs(loaded.reward_error - own.reward_error).max() == 0
    assert simulator.with_discount(0.5).sampling is own
    assert simulator.with_transitions(simulator.transitions).sampling is None
    assert simulator.with_rewards(np.zeros(4)).sampling.reward_error is None
    assert simulator.with_initial(0).sampling.starts == np.inf
    assert (
        simulator.with_action_noise(0.1).sampling.pairs[:2].tolist()
        == [own.pairs[:2].min()] * 2
    )
    assert oee.tasks.gridworld(3, slip=0.3).sampling is None


def shelf(is_marked, seed):
    """Return a sampled simulator of a row of places and a log, both over at the last.

    Only where it is marked do the samples say that episodes end there.
    """
    rng = np.random.default_rng(seed)
    n = int(rng.integers(4, 8))
    problems = []
    for forward, n_episodes in ((0.8, 300), (0.7, 25)):
        steps = []
        for episode in range(n_episodes):
            place = int(rng.integers(0, n - 1))
            while place < n - 1:
                after = min(place + 1, n - 1) if rng.random() < forward else place
                steps.append((episode, place, after, after == n - 1))
                place = after
        episodes, state, following, is_over = (
            np.array(x) for x in zip(*steps, strict=True)
        )
        problems.append(
            oee.Transitions(
                state,
                np.zeros(len(state), dtype=int),
                following,
                np.where(is_over, 10.0, -1.0),
                episode=episodes,
                terminated=is_over if is_marked else None,
            )
        )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SimulatorWarning)
        simulator = oee.FiniteMDP.from_log(problems[0], discount=0.95, initial=0)
    return oee.Problem(simulator, problems[1]), np.ones((n, 1))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("horizon", [None, 30])
def test_no_end_is_beyond_what_rewards_of_samples_can_sum_to(seed, horizon):
    """Where nobody says that episodes end, the interval allows for what might follow."""
    problem, policy = shelf(False, seed)
    problem = oee.Problem(problem.simulator, problem.log, horizon=horizon)
    found = oee.interval(problem, policy)
    steps = 1 / 0.05 if horizon is None else (1 - 0.95**horizon) / 0.05
    assert -steps - 1e-9 <= found.lower <= found.upper <= 10.0 * steps + 1e-9
    report = oee.evaluate(problem, {"on": policy}, seed=0)
    said = report.uncertainty.assumptions["on"]
    assert "neither the simulator's samples nor the log show what follows" in said
    assert f"in state {policy.shape[0] - 1}" in said


@pytest.mark.parametrize("seed", range(4))
def test_an_end_that_samples_tell_is_certain(seed):
    problem, policy = shelf(True, seed)
    report = oee.evaluate(problem, {"on": policy}, seed=0)
    assert report.uncertainty.assumptions["on"] == ""
    found = oee.interval(problem, policy)
    assert found.upper - found.lower < 10.0


def test_the_rewards_of_the_log_bound_what_is_possible_too():
    """Samples that paid less than the log's rows do not cut the interval."""
    sampled = oee.Transitions(
        [1, 0, 0, 0, 0], [0] * 5, [0, 0, 1, 0, 0], [0, 1.0, 1, 0, 0]
    )
    simulator = oee.FiniteMDP.from_log(sampled, discount=0.9, initial=0)
    log = oee.Transitions([0, 1, 1, 1], [0] * 4, [1, 1, 1, 1], [0, 1.0, 1, 1])
    for rewards in ("log", "simulator"):
        problem = oee.Problem(simulator, log, rewards=rewards, impossible="drop")
        found = oee.interval(problem, np.ones((2, 1)))
        assert found.diagnostics["highest_possible"] >= 10.0 - 1e-9
        assert found.lower <= 5.0 <= found.upper  # J where each step pays 1 or 0


def test_a_pair_that_the_log_has_was_met():
    state, action = [0] * 6 + [1] * 6, [0] * 6 + [0, 0, 0, 1, 1, 1]
    sampled = oee.Transitions(
        state, action, [0, 0, 0, 1, 1, 1] * 2, [0.0, 0, 0, 1, 1, 1] * 2
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SimulatorWarning)
        simulator = oee.FiniteMDP.from_log(sampled, discount=0.9, initial=0)
    log = oee.Transitions([0, 0, 1, 1], [1, 1, 0, 0], [0, 1, 0, 0], [0.0, 1, 0, 0])
    policy = np.array([[0.0, 1.0], [1.0, 0.0]])
    report = oee.evaluate(oee.Problem(simulator, log), {"m": policy}, seed=0)
    assert "show what follows" not in report.uncertainty.assumptions["m"]

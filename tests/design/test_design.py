"""Planned data collection: closed forms, certificates, known figures, bad calls."""

import numpy as np
import pytest
from helpers import random_mdp, random_policy, rngs
from hypothesis import given, settings
from numpy.testing import assert_allclose

import oee_tabular as oee
from oee_tabular import FiniteMDP, Problem, Transitions, plan_data_collection
from oee_tabular.design import programs
from oee_tabular.design.programs import collection_mdp
from oee_tabular.tasks.gridworld import gridworld_policy

few = settings(max_examples=25, deadline=None)


def small_grid(slip):
    """A 5 x 5 grid, slip .3 for .1."""
    base = oee.tasks.gridworld(5, slip, discount=0.95)
    row, column = np.divmod(np.arange(25), 5)
    return FiniteMDP(base.transitions, (row + column - 8) / 8, base.initial, 0.95)


SIMULATOR, TARGET, POLICY = small_grid(0.3), small_grid(0.1), gridworld_policy(5, 0.5)
THREE = {f"delta {d}": gridworld_policy(5, d) for d in (0.1, 0.5, 0.9)}


def log_of(mdp, counts):
    """A log with these counts (S, A), every move to the likeliest next state."""
    pairs = np.repeat(np.arange(counts.size), counts.reshape(-1))
    likeliest = np.argmax(mdp.transitions.toarray(), axis=1)
    return Transitions(pairs // mdp.n_actions, pairs % mdp.n_actions, likeliest[pairs])


def variances(plan, q):
    """Of each policy, after the plan's n transitions distributed as q (S, A)."""
    total = plan.counts + plan.n * q
    with np.errstate(divide="ignore"):
        return np.array([np.divide(c, total, out=np.zeros_like(c), where=c > 0).sum() for c in plan.costs.values()])


def inefficiency(plan, q):
    """The largest of the policies', as the plan counts it."""
    least = np.array([o.variance_after / o.inefficiency for o in plan.policies])
    return np.max(variances(plan, q)[least > 0] / least[least > 0], initial=0.0)


def deterministic_chain():
    """0 -> 1 -> 2 by action 0, action 1 stays; 2 is the end; state 0 pays -1, state 1 pays -2."""
    transitions = np.zeros((3, 2, 3))
    transitions[0, 0, 1] = transitions[1, 0, 2] = transitions[0, 1, 0] = transitions[1, 1, 1] = transitions[2, :, 2] = 1
    return FiniteMDP(transitions, [-1.0, -2.0, 0.0], [1.0, 0.0, 0.0], 0.9)


def test_deterministic_rows_have_an_optimistic_cost():
    """State 0, action 0: the other action would stay in 0. V = (-2.8, -2, 0): range 0.8, d = 0.1, gamma / (1 - gamma) = 9."""
    chain = deterministic_chain()
    ahead = np.array([[1.0, 0.0]] * 3)
    plan = plan_data_collection(chain, ahead, n=100)
    assert plan.optimistic.tolist() == [[True, True], [True, True], [False, False]]
    assert_allclose(plan.costs["policy"][0], [81 * 0.1**2 * 0.8**2 / 4, 0.0], rtol=1e-9)
    assert_allclose(plan.costs["policy"][1], [81 * 0.09**2 * 2.0**2 / 4, 0.0], rtol=1e-9)
    assert_allclose(plan.distribution[:2, 0], np.array([0.8, 1.8]) / 2.6, rtol=1e-9)
    assert "worst variance assumed" in str(plan)
    without = plan_data_collection(chain, ahead, n=100, optimistic=False)
    assert without.status.startswith("nothing to learn")
    assert without.expected_width == (0.0, 0.0)
    assert without.next_pairs == ()
    assert plan_data_collection(chain, ahead, n=9, sampling="behavior", optimistic=False).distribution[2].sum() == 0
    # R(. | 0, 0) = 0.975 on state 1 (the mean of both actions gives 0.05 / 2), 0.075 on state 0; at most 2 R
    boxed = plan_data_collection(chain, ahead, n=100, upper_ratio=2.0, lower_ratio=0.5)
    assert_allclose(boxed.costs["policy"][0, 0], 81 * 0.1**2 * 0.8**2 * 0.15 * 0.85, rtol=1e-9)


def test_optimism_fades_with_observations():
    chain, ahead = deterministic_chain(), np.array([[1.0, 0.0]] * 3)
    previous = np.inf
    for number in (1, 10, 100, 1000):
        counts = np.zeros((3, 2), dtype=int)
        counts[0, 0] = number
        plan = plan_data_collection(Problem(chain, log_of(chain, counts)), ahead, n=50)
        surprise = min(0.5, 1 - 0.05 ** (1 / number))
        assert_allclose(plan.costs["policy"][0, 0], 0.81 * 0.8**2 * surprise * (1 - surprise), rtol=1e-9)
        assert plan.costs["policy"][0, 0] < previous
        previous = plan.costs["policy"][0, 0]
    assert plan.distribution[0, 0] == 0.0
    # at least R / 2 = 0.0375 on state 0, however often it was not seen
    boxed = plan_data_collection(Problem(chain, log_of(chain, counts)), ahead, n=50, lower_ratio=0.5, upper_ratio=2.0)
    assert_allclose(boxed.costs["policy"][0, 0], 0.81 * 0.8**2 * 0.0375 * 0.9625, rtol=1e-9)


def test_rewards_of_transitions_that_the_simulator_lacks():
    """r(s, a, s') of another action's move is that action's; that of staying, the row's own mean."""
    transitions = np.zeros((3, 2, 3))
    transitions[0, 0, 1] = transitions[0, 1, 2] = 1.0
    transitions[1:, :, :] = np.eye(3)[1:, None, :]
    rewards = np.full((3, 2, 3), np.nan)
    rewards[0, 0, 1], rewards[0, 1, 2], rewards[1, :, 1], rewards[2, :, 2] = 1.0, 5.0, 0.0, 0.0
    chain = FiniteMDP(transitions, rewards, [1.0, 0.0, 0.0], 0.5)
    plan = plan_data_collection(chain, np.array([[1.0, 0.0]] * 3), n=5)
    # G = r + gamma V: 1 for the own move, 5 for the other action's, 1 + 0.5 * 1 for staying
    assert_allclose(plan.costs["policy"][0], [(5.0 - 1.0) ** 2 / 4, 0.0])


@pytest.mark.parametrize("pay", [-1.0, 0.3, 1e9])
def test_a_value_that_no_transition_changes_needs_none(pay):
    """Every move of the first step pays the same: what is left of its variance is rounding."""
    rows = np.full((3, 2, 3), 1 / 3)
    simulator = oee.FiniteMDP(rows, np.full((3, 2, 3), pay), [1, 0, 0], 1.0)
    log = oee.Transitions([0, 0, 0, 1, 2], [0, 0, 0, 1, 1], [1, 2, 2, 0, 1])
    problem = oee.Problem(simulator, log, horizon=1)
    policy = np.full((3, 2), 0.5)
    assert oee.plan_data_collection(problem, policy, n=5).advice == "More transitions would not narrow it."


@given(rngs)
@settings(max_examples=15, deadline=None)
def test_a_report_and_a_plan_give_one_piece_of_advice(rng):
    simulator = random_mdp(rng)
    policies = {name: random_policy(rng, simulator) for name in "ab"}
    share = np.full((simulator.n_states, simulator.n_actions), 1.0)
    share[0, 0] = 0.0 if share.size > 1 else 1.0
    log = oee.sample_transitions(simulator, share / share.sum(), int(rng.integers(1, 200)), seed=1)
    problem = oee.Problem(simulator, log)
    said = oee.evaluate(problem, policies, estimators=["simulator"], quick=True).uncertainty.next
    for sampling in ("free", "behavior"):
        plan = oee.plan_data_collection(problem, policies, n=50, sampling=sampling)
        assert plan.advice == said
        assert said in str(plan)


@given(rngs)
@few
def test_every_plan_keeps_its_certificate(rng):
    """Both solvers; no other behaviour, nor uniform and on-policy sampling, is better than the gap admits."""
    mdp = random_mdp(rng)
    policies = {str(k): random_policy(rng, mdp) for k in range(int(rng.integers(1, 4)))}
    counts = rng.integers(0, 3, (mdp.n_states, mdp.n_actions))
    known = Problem(mdp, log_of(mdp, counts)) if counts.any() else mdp
    world = collection_mdp(mdp, 1 - mdp.discount)
    behaviors = [oee.uniform_policy(mdp), *policies.values(), *(random_policy(rng, mdp) for _ in range(4))]
    others = [oee.occupancy(world, pi) for pi in behaviors]
    for sampling in ("free", "behavior"):
        options = {"n": 30, "sampling": sampling, "model": "simulator"}
        plans = [plan_data_collection(known, policies, solver=x, **options) for x in ("auto", "CLARABEL")]
        assert plans[0].gap < 1e-3
        if plans[0].status.startswith("nothing"):
            continue
        assert_allclose(plans[1].inefficiency, plans[0].inefficiency, rtol=3e-3)
        uniform = [np.full(counts.shape, 1 / counts.size)] if sampling == "free" else []
        for plan in plans:
            assert_allclose(plan.distribution.sum(), 1.0, rtol=1e-9)
            assert_allclose(variances(plan, plan.distribution), [o.variance_after for o in plan.policies], rtol=1e-9)
            assert plan.inefficiency == pytest.approx(inefficiency(plan, plan.distribution), rel=1e-9)
            for q in (*others, *uniform):
                assert plan.inefficiency * (1 - plan.gap) <= inefficiency(plan, q) * (1 + 1e-9)


def test_sequential_use():
    """Recording what a plan says leads to the error that it foretold, and a plan in two halves is the plan of the whole."""
    first = plan_data_collection(SIMULATOR, POLICY, n=4000)
    problem = Problem(SIMULATOR, log_of(SIMULATOR, first.allocation))
    second = plan_data_collection(problem, POLICY, n=4000, model="simulator")
    assert second.unvisited == 0
    assert_allclose(second.expected_width[0], first.expected_width[1], rtol=1e-3)
    assert_allclose(second.expected_width[1], first.expected_width[1] / np.sqrt(2), rtol=1e-3)
    assert_allclose(second.distribution, first.distribution, atol=1e-3)
    assert_allclose(second.after(4000)["policy"].variance_after, second.policies[0].variance_after, rtol=1e-12)
    assert_allclose(second.after(16_000)["policy"].width[1], second.expected_width[0] / np.sqrt(5), rtol=1e-3)
    three = plan_data_collection(problem, THREE, n=4000, sampling="behavior")
    assert three.gap < 0.01
    assert three.model == "the estimate from the log"
    assert three.expected_width[1] < three.expected_width[0] < np.inf


def test_rows_that_the_log_lacks_come_first():
    counts = np.full((25, 4), 50)
    counts[7] = 0
    problem = Problem(SIMULATOR, log_of(SIMULATOR, counts))
    plan = plan_data_collection(problem, POLICY, n=100, model="simulator")
    assert plan.unvisited == 4
    assert {s for s, _ in plan.next_pairs[:4]} == {7}
    assert plan.distribution[7].sum() > 0.25
    assert "pairs that matter and were never recorded: 4" in str(plan)
    assert "inf" in str(plan)


def test_a_plan_without_a_good_certificate_says_so(monkeypatch):
    monkeypatch.setattr(programs, "N_NEWTON_STEPS", 1)
    plan = plan_data_collection(SIMULATOR, THREE, n=10, sampling="behavior")
    assert plan.status.startswith("not finished: another plan may be better by up to")
    assert plan.status in str(plan)


def test_a_state_that_only_the_model_never_leaves():
    """It is still to be tested there, and an episode does not end in it."""
    rows = SIMULATOR.transitions.toarray().reshape(25, 4, 25)
    rows[6] = 0.0
    rows[6, :, 6] = 1.0
    rows[24] = np.eye(25)[24]
    wide = SIMULATOR.with_transitions(0.5 * rows + 0.5 * SIMULATOR.transitions.toarray().reshape(25, 4, 25))
    stuck = SIMULATOR.with_transitions(rows)
    plan = plan_data_collection(wide, POLICY, n=50, sampling="behavior", model=stuck)
    assert plan.optimistic[6].all()
    assert plan.costs["policy"][6].min() > 0
    assert plan.distribution[6].min() > 0
    assert plan.gap < 0.01

"""Estimators worked by hand, and what the problem gives them."""

import numpy as np
from estimators.four_states import BEHAVIOR, POLICY, environments, recorded_problem, reweighted_zeta
from numpy.testing import assert_allclose

import oee_tabular as oee
from oee_tabular import Problem, Transitions, exact
from oee_tabular.estimators import ImportanceSampling, ModelBased, OffEnvironment, Oracle


def grids(size=5, **options):
    return oee.tasks.gridworld(size, 0.3, **options), oee.tasks.gridworld(size, 0.1, **options)


def test_a_behaviour_policy_may_be_given_instead_of_recorded():
    simulator, target = grids()
    behavior = oee.tasks.gridworld_policy(5, 0.3)
    log = oee.sample_episodes(target, behavior, 20, 30, seed=0)
    columns = {name: column for name, column in log.columns().items() if name != "behavior_probability"}
    policy = oee.tasks.gridworld_policy(5, 0.5)
    given_policy = Problem(simulator, Transitions(**columns), horizon=30, behavior_policy=behavior)
    recorded = ImportanceSampling()(Problem(simulator, log, horizon=30), policy)
    assert ImportanceSampling()(given_policy, policy).value == recorded.value


def test_the_log_s_rewards_count_and_the_simulator_s_where_there_are_none():
    problem, _ = recorded_problem(2)
    columns = dict(problem.log.columns())
    values = []
    for reward in (columns["reward"], None, 3.0 * columns["reward"]):  # of r(s, a) the log has what the simulator pays
        given = Problem(problem.simulator, Transitions(**columns | {"reward": reward}))
        values.append(ImportanceSampling()(given, POLICY).value)
    assert_allclose(values, values[0] * np.array([1.0, 1.0, 3.0]), rtol=1e-12)


# ---- model based -------------------------------------------------------------------------------------------------


def test_model_based_by_hand():
    """State 0 seen going to 1 (twice) and 0 (once): V = r / (1 - gamma / 3)."""
    transitions = np.array([[[0.5, 0.5]], [[0.0, 1.0]]])
    simulator = oee.FiniteMDP(transitions, [1.0, 0.0], [1.0, 0.0], 0.9)
    problem = Problem(simulator, Transitions([0, 0, 0], [0, 0, 0], [1, 1, 0]))
    policy = np.ones((2, 1))
    found = ModelBased()(problem, policy)
    assert_allclose(found.value, 1 / (1 - 0.9 / 3), rtol=1e-14)
    # V = 1 / (1 - gamma p), dV/dp = gamma V^2, Var p = p (1 - p) / n
    assert_allclose(found.standard_error, 0.9 * found.value**2 * np.sqrt(1 / 3 * 2 / 3 / 3), rtol=1e-12)


# ---- the problem -------------------------------------------------------------------------------------------------


def test_importance_sampling_uses_the_whole_episodes_behind_a_draw():
    simulator, target = grids()
    episodes = oee.sample_episodes(target, oee.uniform_policy(target), 20, 30, seed=0)
    policy = oee.tasks.gridworld_policy(5, 0.2)
    drawn = Problem(simulator, episodes.draw(50, seed=0), horizon=30, episodes=episodes)
    assert ImportanceSampling()(drawn, policy) == ImportanceSampling()(Problem(simulator, episodes, horizon=30), policy)


def test_the_truncation_bound_uses_the_largest_reward_of_a_transition():
    transitions = np.array([[[0.0, 0.5, 0.5]], [[1.0, 0.0, 0.0]], [[1.0, 0.0, 0.0]]])
    rewards = np.zeros((3, 1, 3))
    rewards[0, 0, 1:] = [100.0, -100.0]
    mdp = oee.FiniteMDP(transitions, rewards, [0.0, 1.0, 0.0], 0.9)
    log = Transitions([1], [0], [0], [0.0], episode=[0], behavior_probability=[1.0])
    facts = ImportanceSampling()(Problem(mdp, log), np.ones((3, 1))).diagnostics
    assert_allclose(facts["truncation_bias_bound"], 100 * 0.9 / 0.1)
    endless = ImportanceSampling()(Problem(mdp.with_discount(1.0), log), np.zeros((3, 1)) + 1.0).diagnostics
    assert endless["truncation_bias_bound"] == np.inf


def test_a_given_ratio_has_its_own_warnings():
    """An unnormalised zeta has a value and nothing more; the truth is not moved."""
    problem, target = recorded_problem(3)
    loose = OffEnvironment(reweighted_zeta(problem.simulator, target, 1.01))(problem, POLICY)
    assert set(loose.diagnostics) == {"gap", "row_sum_error", "largest_weight", "error_bound", "method"}
    assert loose.standard_error is None
    true = oee.true_ratio(target, problem.simulator)
    for estimator in (OffEnvironment(true), OffEnvironment(lambda log, simulator: true), Oracle(target)):
        found = estimator(problem, POLICY)
        assert_allclose(found.value, oee.policy_value(target, POLICY), rtol=1e-12)
        assert_allclose(found.diagnostics["largest_weight"], true.values.data.max())
        assert (found.model_value is None) == isinstance(estimator, Oracle)


def test_ratios_by_name_get_what_the_problem_knows():
    """The behaviour policy, the simulator's data and the seed reach ``transition_ratio``."""
    simulator, target = environments(3)
    log = oee.sample_episodes(target, BEHAVIOR, 200, 6, seed=1)
    for method in ("ratio_of_ratios", "joint"):
        for options in ({}, {"behavior_policy": BEHAVIOR}, {"simulator_data": "exact", "behavior_policy": BEHAVIOR}):
            problem = Problem(simulator, log, **options)
            zeta = oee.transition_ratio(log, simulator, method=method, seed=np.random.default_rng(4), **options)
            found = OffEnvironment(method).fit(problem, POLICY, np.random.default_rng(4))
            assert_allclose(found.values.toarray(), zeta.values.toarray(), rtol=1e-12)
    shares = 1e12 / 8 * target.transitions
    expected = oee.transition_ratio(shares, simulator, method="joint", simulator_data="exact", behavior_policy=BEHAVIOR)
    limit = OffEnvironment("joint").limit(simulator, target, POLICY, behavior_policy=BEHAVIOR)
    assert_allclose(limit, oee.policy_value(exact.reweight(simulator, expected), POLICY), rtol=1e-9)

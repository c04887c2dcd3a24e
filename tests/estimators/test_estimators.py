import numpy as np
import pytest
from helpers import paths, random_mdp, random_policy, rngs
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

import oee_tabular as oee
from oee_tabular import Transitions, exact
from oee_tabular.estimators import ImportanceSampling, ModelBased, OffEnvironment, Oracle, Problem, Simulator


def grids(size=5, **options):
    return oee.tasks.gridworld(size, 0.3, **options), oee.tasks.gridworld(size, 0.1, **options)


def covering_log(target, n=3000, seed=0):
    weights = np.full((target.n_states, target.n_actions), 1 / (target.n_states * target.n_actions))
    return oee.sample_transitions(target, weights, n, seed=seed)


@given(rngs, st.sampled_from([None, 5]))
def test_simulator_and_oracle_are_the_two_ends(rng, horizon):
    simulator = random_mdp(rng)
    target = random_mdp(rng, like=simulator)
    problem = Problem(simulator, covering_log(target, 50), horizon=horizon)
    policy = random_policy(rng, simulator)
    assert Simulator()(problem, policy).value == oee.policy_value(simulator, policy, horizon=horizon)
    truth = oee.policy_value(target, policy, horizon=horizon)
    assert_allclose(Oracle(target)(problem, policy).value, truth, rtol=0, atol=1e-9 * max(1, abs(truth)))


def test_off_environment_is_the_value_of_zeta_times_p():
    simulator, target = grids()
    log = covering_log(target)
    problem = Problem(simulator, log, horizon=60)
    policy = oee.tasks.gridworld_policy(5, 0.5)
    model = oee.transition_ratio(log, simulator, values_of=policy, horizon=60).target_model(simulator)
    estimate = OffEnvironment()(problem, policy)
    assert_allclose(estimate.diagnostics["model_value"], oee.policy_value(model, policy, horizon=60), rtol=1e-12)
    assert estimate.diagnostics["moved"] == 0.0
    assert estimate.value == estimate.diagnostics["model_value"]
    assert estimate.diagnostics["coverage"] == 1.0
    assert estimate.diagnostics["gap"] < 1e-12
    given_ratio = OffEnvironment(ratio=oee.true_ratio(target, simulator))(problem, policy)
    assert_allclose(given_ratio.value, oee.policy_value(target, policy, horizon=60), rtol=1e-12)
    by_function = OffEnvironment(ratio=lambda log, sim: oee.transition_ratio(log, sim, strength=9.0))(problem, policy)
    assert by_function.value != estimate.value


# ---- importance sampling: worked by hand -------------------------------------------------------------------------

LOG = Transitions(
    [0, 1, 0, 0, 1, 1], [0, 1, 1, 0, 0, 1], [1, 2, 2, 1, 1, 2], [1.0, 2.0, 4.0, 1.0, 3.0, 2.0],
    terminated=[0, 1, 1, 0, 0, 1], episode=[0, 0, 1, 2, 2, 2], behavior_probability=[0.5, 0.25, 0.5, 0.5, 0.75, 0.25],
)  # fmt: skip
POLICY = np.array([[0.25, 0.75], [0.5, 0.5], [1.0, 0.0]])
# ratios: 0.5, 2 | 1.5 | 0.5, 2/3, 2; products 0.5, 1 | 1.5 | 0.5, 1/3, 2/3
RETURNS = np.array([1 + 0.5 * 2, 4.0, 1 + 0.5 * 3 + 0.25 * 2])
LAST = np.array([1.0, 1.5, 2 / 3])


def three_state_problem(horizon=None, **options):
    transitions = np.full((3, 2, 3), 1 / 3)
    transitions[2] = [0.0, 0.0, 1.0]
    mdp = oee.FiniteMDP(transitions, np.array([1.0, 1.0, 0.0]), [1.0, 0.0, 0.0], 0.5)
    return Problem(mdp, LOG, horizon=horizon, **options)


def test_importance_sampling_by_hand():
    problem = three_state_problem()
    trajectory = ImportanceSampling("trajectory")(problem, POLICY)
    assert_allclose(trajectory.value, np.mean(LAST * RETURNS), rtol=1e-14)
    assert_allclose(trajectory.standard_error, np.std(LAST * RETURNS, ddof=1) / np.sqrt(3), rtol=1e-14)
    assert_allclose(trajectory.diagnostics["effective_sample_size"], LAST.sum() ** 2 / (LAST**2).sum())
    weighted = ImportanceSampling("trajectory", self_normalized=True)(problem, POLICY)
    assert_allclose(weighted.value, (LAST * RETURNS).sum() / LAST.sum(), rtol=1e-14)
    decisions = np.array([0.5 * 1 + 1 * 0.5 * 2, 1.5 * 4, 0.5 * 1 + 1 / 3 * 0.5 * 3 + 2 / 3 * 0.25 * 2])
    assert_allclose(ImportanceSampling()(problem, POLICY).value, decisions.mean(), rtol=1e-14)


def test_the_two_conventions_for_episodes_that_ended():
    """Step 0: weights .5, 1.5, .5; step 1: 1, (1.5), 1/3; step 2: (1), (1.5), 2/3. In brackets: ended, pad or zero."""
    problem = three_state_problem()
    first = (0.5 * 1 + 1.5 * 4 + 0.5 * 1) / 2.5
    pad = first + 0.5 * (1 * 2 + 1 / 3 * 3) / (1 + 1.5 + 1 / 3) + 0.25 * (2 / 3 * 2) / (1 + 1.5 + 2 / 3)
    zero = first + 0.5 * (1 * 2 + 1 / 3 * 3) / (1 + 1 / 3) + 0.25 * 2
    for ragged, expected in (("pad", pad), ("zero", zero)):
        found = ImportanceSampling(self_normalized=True, ragged=ragged)(problem, POLICY)
        assert_allclose(found.value, expected, rtol=1e-14)


def test_a_horizon_cuts_episodes():
    problem = three_state_problem(horizon=2)
    decisions = np.array([0.5 * 1 + 1 * 0.5 * 2, 1.5 * 4, 0.5 * 1 + 1 / 3 * 0.5 * 3])
    found = ImportanceSampling()(problem, POLICY)
    assert_allclose(found.value, decisions.mean(), rtol=1e-14)
    assert found.diagnostics["truncation_bias_bound"] == 0.0
    last = np.array([1.0, 1.5, 1 / 3])
    returns = np.array([2.0, 4.0, 2.5])
    assert_allclose(ImportanceSampling("trajectory")(problem, POLICY).value, (last * returns).mean(), rtol=1e-14)


@pytest.mark.parametrize("kind", ["trajectory", "per_decision"])
@pytest.mark.parametrize("self_normalized", [False, True])
def test_importance_sampling_converges_to_the_target_s_value(kind, self_normalized):
    rng = np.random.default_rng(5)
    target = random_mdp(rng, n_states=3, n_actions=2, discount=0.9, form=3)
    behavior, policy = (random_policy(rng, target, zeros=0.0) for _ in range(2))
    truth = sum(p * sum(0.9**t * r for t, (_, _, _, r) in enumerate(steps)) for p, steps in paths(target, policy, 3))
    log = oee.sample_episodes(target, behavior, 200_000, 3, seed=1)
    found = ImportanceSampling(kind, self_normalized)(Problem(target, log, horizon=3), policy)
    assert found.standard_error < 0.05
    assert abs(found.value - truth) < 4 * found.standard_error
    estimated = ImportanceSampling(kind, self_normalized, behavior="estimated")(Problem(target, log, horizon=3), policy)
    assert_allclose(estimated.value, by_hand(log, policy, kind, self_normalized), rtol=1e-9)


def by_hand(log, policy, kind, self_normalized):
    """Weights over the shares of each action in the log, episodes of three moves, discount 0.9."""
    taken = np.zeros_like(policy)
    np.add.at(taken, (log.state, log.action), 1.0)
    shares = taken / taken.sum(axis=1, keepdims=True)
    weights = (policy / shares)[log.state, log.action].reshape(-1, 3).cumprod(axis=1)
    if kind == "trajectory":
        weights = np.repeat(weights[:, -1:], 3, axis=1)
    paid = (weights * log.reward.reshape(-1, 3)).mean(axis=0) / (weights.mean(axis=0) if self_normalized else 1.0)
    return paid @ 0.9 ** np.arange(3)


def test_on_the_behaviour_policy_itself_all_weights_are_one():
    simulator, target = grids()
    behavior = oee.uniform_policy(target)
    log = oee.sample_episodes(target, behavior, 50, 30, seed=0)
    problem = Problem(simulator, log, horizon=30)
    returns = [
        (0.99 ** log.timestep[a:b] * log.reward[a:b]).sum()
        for a, b in zip(log.episode_starts[:-1], log.episode_starts[1:], strict=True)
    ]
    for kind in ("trajectory", "per_decision"):
        for self_normalized in (False, True):
            found = ImportanceSampling(kind, self_normalized)(problem, behavior)
            assert_allclose(found.value, np.mean(returns), rtol=1e-12)
            assert_allclose(found.diagnostics["effective_sample_size"], 50)


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
    problem = three_state_problem()
    bare = Transitions(**{name: column for name, column in LOG.columns().items() if name != "reward"})
    without = Problem(problem.simulator, bare)
    ones = Transitions(**(LOG.columns() | {"reward": np.ones(6)}))
    expected = ImportanceSampling()(Problem(problem.simulator, ones), POLICY).value
    assert ImportanceSampling()(without, POLICY).value == expected


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


def test_fallbacks_of_the_model():
    """State 1 was never left in the log: "stay" stays there for ever, "simulator" leaves with probability 1/2."""
    transitions = np.array([[[0.0, 1.0, 0.0]], [[0.0, 0.5, 0.5]], [[0.0, 0.0, 1.0]]])
    simulator = oee.FiniteMDP(transitions, [0.0, 1.0, 0.0], [1.0, 0.0, 0.0], 0.9)
    problem = Problem(simulator, Transitions([0], [0], [1]))
    policy = np.ones((3, 1))
    assert_allclose(ModelBased()(problem, policy).value, 0.9 * 1 / (1 - 0.9), rtol=1e-12)
    assert_allclose(ModelBased("simulator")(problem, policy).value, 0.9 / (1 - 0.45), rtol=1e-12)
    assert ModelBased()(problem, policy).diagnostics["fallback_share"] > 0.5


# ---- the problem -------------------------------------------------------------------------------------------------


def test_terminated_moves_go_to_the_simulator_s_terminal_states():
    taxi = oee.tasks.toy_text("Taxi-v4")
    destination = int(np.flatnonzero(taxi.terminal_state != np.arange(500))[0])
    before = taxi.transitions.tocsc()[:, [taxi.terminal_state[destination]]].nonzero()[0]
    row = int(before[before < 3000][0])
    log = Transitions([row // 6], [row % 6], [destination], [20.0], terminated=[True])
    problem = Problem(taxi, log)
    assert problem.log.next_state[0] == taxi.terminal_state[destination]
    assert problem.log.reward[0] == 20.0
    assert problem.reward_conflict is None


def test_importance_sampling_uses_the_whole_episodes_behind_a_draw():
    simulator, target = grids()
    episodes = oee.sample_episodes(target, oee.uniform_policy(target), 20, 30, seed=0)
    policy = oee.tasks.gridworld_policy(5, 0.2)
    drawn = Problem(simulator, episodes.draw(50, seed=0), horizon=30, episodes=episodes)
    whole = Problem(simulator, episodes, horizon=30)
    assert ImportanceSampling()(drawn, policy).value == ImportanceSampling()(whole, policy).value
    with pytest.raises(ValueError, match="needs whole episodes"):
        ImportanceSampling()(Problem(simulator, episodes.draw(50, seed=0)), policy)


def test_the_truncation_bound_counts_the_largest_reward_of_a_move_not_the_mean():
    transitions = np.array([[[0.0, 0.5, 0.5]], [[1.0, 0.0, 0.0]], [[1.0, 0.0, 0.0]]])
    rewards = np.zeros((3, 1, 3))
    rewards[0, 0, 1:] = [100.0, -100.0]
    mdp = oee.FiniteMDP(transitions, rewards, [0.0, 1.0, 0.0], 0.9)
    log = Transitions([1], [0], [0], [0.0], episode=[0], behavior_probability=[1.0])
    facts = ImportanceSampling()(Problem(mdp, log), np.ones((3, 1))).diagnostics
    assert_allclose(facts["truncation_bias_bound"], 100 * 0.9 / 0.1)
    endless = ImportanceSampling()(Problem(mdp.with_discount(1.0), log), np.zeros((3, 1)) + 1.0).diagnostics
    assert endless["truncation_bias_bound"] == np.inf


@pytest.mark.parametrize("form", ["r(s)", "r(s, a, s')"])
def test_the_product_s_weights_by_hand(form):
    """A ring of two states that pay 1 and 3, zeta = 2 everywhere, T = 3: no chance in it.

    Per decision r_t carries 2^t, or 2^(t + 1) where it depends on s'; trajectory-wise all carry 2^(T - 1), or 2^T.
    """
    ring = np.array([[[0.0, 1.0]], [[1.0, 0.0]]])
    paid = np.array([1.0, 3.0])
    rewards = paid if form == "r(s)" else np.broadcast_to(paid[:, None, None], (2, 1, 2)).copy()
    simulator = oee.FiniteMDP(ring, rewards, [1.0, 0.0], 0.5)
    problem = Problem(simulator, Transitions([0], [0], [1]), horizon=3)
    true = oee.true_ratio(simulator, simulator)
    double = oee.TransitionRatio(true.values * 2.0, "twice", 0.0, true.visited, 1.0, true.counts)
    late = 0 if form == "r(s)" else 1
    payments = np.array([1.0, 0.5 * 3.0, 0.25 * 1.0])
    weights = {"per_decision": 2.0 ** (np.arange(3) + late), "trajectory": np.full(3, 2.0 ** (2 + late))}
    for weighting, weight in weights.items():
        found = OffEnvironment(double, "monte_carlo", weighting, n_rollouts=5)(problem, np.ones((2, 1)), seed=0)
        assert_allclose(found.value, weight @ payments, rtol=1e-14)
    limit = oee.policy_value(exact.reweight(simulator, double), np.ones((2, 1)), horizon=3)
    assert_allclose(limit, weights["per_decision"] @ payments, rtol=1e-14)

"""Tasks by name, and the grid."""

import gymnasium
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import stats

import oee_tabular as oee
from oee_tabular.lab.bench import tandem
from oee_tabular.tasks import (
    CartPole,
    HistoryTask,
    Reacher,
    cartpole_policy,
    discretize,
    fit_hand,
    fit_parameters,
    gridworld,
    gridworld_expert,
    gridworld_policy,
    gymnasium_simulator,
    named_task,
    reacher_policy,
    record,
    record_episodes,
    record_goals,
    train_expert,
    visited_states,
)


def test_names_with_arguments():
    grid = named_task("gridworld:4,slip=0.3,pay=current", discount=0.5)
    assert grid.mdp.discount == 0.5
    assert grid.mdp.transition_rewards is None
    assert_array_equal(grid.expert(), oee.tasks.gridworld_expert(4))
    lake = named_task("FrozenLake-v1:map_name=8x8,success_rate=1/3,is_slippery=true")
    assert lake.mdp.n_states == 64
    assert_allclose(lake.mdp.transitions.toarray()[1 * 4 + 2, [1 + 8, 2, 1]], 1 / 3)
    own = named_task("FrozenLake-v1:desc=['SFH','FFG'],is_slippery=False")
    assert own.mdp.n_states == 6
    assert_array_equal(lake.expert(), oee.optimal_policy(lake.mdp))


def test_files(tmp_path):
    mdp = oee.tasks.gridworld(3, 0.2)
    mdp.save(tmp_path / "sim.npz")
    task = named_task(str(tmp_path / "sim.npz"), discount=0.7)
    assert task.mdp.discount == 0.7
    assert task.environment is None
    assert_array_equal(task.mdp.transitions.data, mdp.transitions.data)


@pytest.mark.parametrize(
    ("spec", "text"),
    [
        ("gridword:10", "'gridword' is neither"),
        ("FrozenLake-v2", "near: FrozenLake-v1"),
        (
            "gridworld",
            "must be like 'gridworld:10,slip=0.3'; missing a required argument: 'size'",
        ),
        ("gridworld:10,slop=0.3", "must be like 'gridworld:10,slip=0.3'"),
        ("gridworld:1,slip=0.3", "size must be at least 2; it is 1"),
        ("gridworld:4,slip=1.3", r"slip must be in \[0, 1\]; it is 1.3"),
        ("FrozenLake-v1:8x8", "must give its arguments as key=value; found '8x8'"),
        ("FrozenLake-v1:map=8x8", "does not take these arguments"),
        ("Blackjack-v1", "must have a state that can be set"),
    ],
)
def test_bad_names(spec, text):
    with pytest.raises(ValueError, match=text):
        named_task(spec)


def test_recording_steps_the_environment_itself():
    """The frequencies of a recorded log agree with the table by a chi-square test.

    Its structure agrees with the time limit.
    """
    env = gymnasium.make(
        "FrozenLake-v1", map_name="4x4", success_rate=0.6, max_episode_steps=20
    )
    mdp = oee.FiniteMDP.from_gymnasium(env)
    policy = np.random.default_rng(0).dirichlet(np.ones(4), size=16)
    log = record_episodes(env, policy, n_transitions=30_000, seed=5)
    assert len(log) == 30_000
    lengths = np.diff(log.episode_starts)
    assert lengths.max() == 20
    last = log.episode_starts[1:] - 1
    assert_array_equal(
        log.terminated[last] | log.truncated[last], np.ones(len(last), dtype=bool)
    )
    counts = log.counts(16, 4).toarray()
    expected = counts.sum(axis=1, keepdims=True) * mdp.transitions.toarray()
    assert counts[expected == 0].sum() == 0
    free = (expected > 0).sum() - (counts.sum(axis=1) > 0).sum()
    statistic = ((counts - expected)[expected > 0] ** 2 / expected[expected > 0]).sum()
    assert stats.chi2.sf(statistic, free) > 1e-4
    assert_array_equal(log.behavior_probability, policy[log.state, log.action])
    again = record_episodes(env, policy, n_transitions=500, seed=5)
    assert_array_equal(again.next_state, log.next_state[:500])
    assert again.truncated[-1] or again.terminated[-1]


def test_recording_episodes():
    env = gymnasium.make("CliffWalking-v1", is_slippery=True, max_episode_steps=50)
    log = record_episodes(env, np.full((48, 4), 0.25), n_episodes=7, seed=0)
    assert log.n_episodes == 7
    assert_allclose(np.unique(log.reward), [-100, -1])


def test_recording_refuses():
    env = gymnasium.make("FrozenLake-v1")
    uniform = np.full((16, 4), 0.25)
    with pytest.raises(ValueError, match="one of n_transitions and n_episodes"):
        record_episodes(env, uniform, seed=0)
    with pytest.raises(
        ValueError, match=r"policy must have shape \(16, 4\) .*; it has shape \(16, 3\)"
    ):
        record_episodes(env, np.full((16, 3), 1 / 3), n_episodes=1, seed=0)
    with pytest.raises(ValueError, match=r"env.observation_space must be Discrete"):
        record_episodes(gymnasium.make("CartPole-v1"), uniform, n_episodes=1, seed=0)


# ---- the grid
def test_the_exact_ratio_takes_three_values():
    """The ratio is 9/7 (intended), 1/3 (not intended) or 7/6, as paper/README says.

    7/6 is for staying put in a corner under an action into a wall.
    """
    ratio = oee.true_ratio(gridworld(10, 0.1), gridworld(10, 0.3))
    # the goal's four moves, zeta = 1, come last
    zeta = ratio.values.data[: 4 * 99 * 4][:1572]
    assert_allclose(np.unique(np.round(zeta, 12)), np.round([1 / 3, 7 / 6, 9 / 7], 12))
    assert_array_equal(ratio.values.data[1572:], np.ones(4))
    # (0, 0), row - 1, stays
    corner = ratio.values.toarray().reshape(100, 4, 100)[0, 1, 0]
    assert_allclose(corner, 7 / 6)


def test_the_trivial_estimate_scores_0570():
    """zeta = 1 has a mean absolute error of 0.570 on the support, as paper/README says.

    The goal is left out.
    """
    ratio = oee.true_ratio(gridworld(10, 0.1), gridworld(10, 0.3))
    assert_allclose(np.abs(ratio.values.data[:1572] - 1).mean(), 0.570, atol=5e-4)


def test_transitions_into_walls_stay_and_the_goal_absorbs():
    grid = gridworld(3, 0.3)
    table = grid.transitions.toarray().reshape(9, 4, 9)
    # row - 1 and column - 1 both stay
    assert_allclose(table[0, 1], [0.8, 0.1, 0, 0.1, 0, 0, 0, 0, 0])
    assert_allclose(table[4, 2], [0, 0.1, 0, 0.1, 0, 0.7, 0, 0.1, 0])
    assert_array_equal(table[8], np.eye(9)[[8] * 4])
    assert grid.absorbing()[8]
    assert_array_equal(np.flatnonzero(grid.initial), [0])


def test_without_slip_the_support_shrinks():
    assert gridworld(3, 0.0).transitions.nnz == 9 * 4
    with pytest.raises(ValueError, match=r"the simulator gives probability 0 to"):
        oee.true_ratio(gridworld(3, 0.1), gridworld(3, 0.0))


def test_paying_for_the_next_or_the_current_cell():
    """J_next at T equals (J_current at T + 1 - first reward) / discount.

    The same rewards come one step later.
    """
    following = gridworld(5, 0.2)
    current = gridworld(5, 0.2, pay="current")
    policy = gridworld_policy(5, 0.5)
    first = -0.2 * 8
    shifted = (oee.policy_value(current, policy, horizon=31) - first) / 0.99
    assert_allclose(
        oee.policy_value(following, policy, horizon=30), shifted, rtol=1e-12
    )


def test_the_expert_walks_rows_then_columns():
    grid = gridworld(4, 0.0, pay="current", discount=1.0)
    distances = range(6, 0, -1)
    assert_allclose(
        oee.policy_value(grid, gridworld_expert(4)), -0.2 * sum(distances), rtol=1e-12
    )


def test_the_scale_of_the_paper_s_values():
    """delta = 0.1, T = 200 has |J| = 1.60 when the current cell pays."""
    target = gridworld(10, 0.1, pay="current")
    value = oee.policy_value(
        target, gridworld_policy(10, 0.1), horizon=200, normalized=True
    )
    assert_allclose(value, -1.60, atol=0.01)


def test_under_the_uniform_policy_the_chain_does_not_depend_on_slip():
    """paper/README: the true (s, a) ratio of the paper's data is 1."""
    uniform = oee.uniform_policy(gridworld(6, 0.3))
    assert_allclose(
        oee.occupancy(gridworld(6, 0.3), uniform),
        oee.occupancy(gridworld(6, 0.1), uniform),
        atol=1e-15,
    )


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: cartpole_policy(weights=np.inf), "^weights must have 1 dimension"),
        (
            lambda: cartpole_policy(weights=(1.0, np.nan, 0.0)),
            r"^weights\[1\] must be f",
        ),
        (
            lambda: cartpole_policy(weights="abc"),
            "^weights must be an array of numbers",
        ),
        (lambda: cartpole_policy(weights=(1.0, 2.0)), "^weights must be three numbers"),
        (lambda: reacher_policy(target=3.0), r"^target must be two finite numbers"),
        (
            lambda: reacher_policy(target=(0.1, np.inf)),
            r"^target must be two finite num",
        ),
        (lambda: reacher_policy(length="1"), r"^length must be a number; got '1'"),
        (lambda: reacher_policy(length=-1), r"^length must be in \[0, "),
        (lambda: reacher_policy(stiffness=np.nan), r"^stiffness must be in"),
        (lambda: Reacher(1e308), r"^length must be in \[0, "),
        (
            lambda: HistoryTask(CartPole(), steps=np.zeros(2)),
            "^steps must be a positive",
        ),
        (lambda: train_expert(task=[CartPole()]), "^task must be a CartPole; got list"),
        (
            lambda: train_expert(population=3 * 10**13),
            "^population must be small enough for this machine's memory",
        ),
        (
            lambda: train_expert(horizon=4 * 10**9),
            r"^horizon must leave a number of steps that ends, .*; it is \d",
        ),
        (
            lambda: visited_states(CartPole(), [], 9, max_steps=9, seed=0),
            "^tasks must be",
        ),
        (
            lambda: visited_states([CartPole(), 3], [], 9, max_steps=9, seed=0),
            r"^tasks\[1\] must be a ContinuousTask; got int",
        ),
        (
            lambda: discretize(CartPole(), others=3),
            "^others must be a sequence of cont",
        ),
        (
            lambda: discretize(CartPole(), policies=[3]),
            r"^policies\[0\] must be a funct",
        ),
        (
            lambda: gymnasium_simulator(["Pendulum-v1"]),
            "^spec must be a text; got list",
        ),
        (lambda: gymnasium_simulator("Pendulum-v1", state=3), "^state must be a text"),
        (
            lambda: record_goals("arm"),
            "^arm must be a KinovaArm or KinovaHand; got str",
        ),
        (
            lambda: fit_hand(None),
            "^arm must be a KinovaArm or KinovaHand; got NoneType",
        ),
        (lambda: gridworld(3, np.zeros(2)), "^slip must be a number"),
        (lambda: tandem("45"), "^size must be a positive integer; got '45'"),
        (lambda: tandem(1), "^size must be at least 2; it is 1"),
        (lambda: tandem(10**9), "^size must be small enough"),
    ],
)
def test_parameters_that_no_task_has(call, text):
    with pytest.raises(ValueError, match=text):
        call()


def test_bounds_of_parameters():
    log = record(CartPole(), cartpole_policy(0.3), n_episodes=1, max_steps=20, seed=0)
    for bounds, text in (
        ([0.0, 1.0], "^bounds must map names of parameters to"),
        ({"gravity": 3.0}, r"^bounds\['gravity'\] must have 1 dimension"),
        ({"gravity": (1.0, np.nan)}, r"^bounds\['gravity'\] must be two numbers"),
        ({"gravity": "ab"}, r"^bounds\['gravity'\] must be an array of numbers"),
    ):
        with pytest.raises(ValueError, match=text):
            fit_parameters(CartPole, {"gravity": 9.8}, log, bounds=bounds)

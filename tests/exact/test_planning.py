import itertools

import numpy as np
import pytest
from helpers import random_mdp, rngs
from hypothesis import given, settings
from numpy.testing import assert_allclose, assert_array_equal

import oee_tabular as oee
from oee_tabular import FiniteMDP
from oee_tabular.mdp.policies import deterministic_policy


@given(rngs)
@settings(max_examples=30)
def test_policy_iteration_finds_the_best_of_all_deterministic_policies(rng):
    mdp = random_mdp(rng, n_states=3, n_actions=3)
    best = np.full(3, -np.inf)
    for actions in itertools.product(range(3), repeat=3):
        best = np.maximum(
            best, oee.state_values(mdp, deterministic_policy(np.array(actions), 3))
        )
    policy = oee.optimal_policy(mdp)
    assert set(np.unique(policy)) <= {0.0, 1.0}
    assert_allclose(
        oee.state_values(mdp, policy),
        best,
        rtol=0,
        atol=1e-9 * max(1, np.abs(best).max()),
    )


@given(rngs)
def test_backward_induction_satisfies_the_optimality_equation(rng):
    mdp = random_mdp(rng, discount=1.0)
    horizon = 4
    policy = oee.optimal_policy(mdp, horizon=horizon)
    value = np.zeros(mdp.n_states)
    for _ in range(horizon):
        value = (
            mdp.rewards + (mdp.transitions @ value).reshape(mdp.rewards.shape)
        ).max(axis=1)
    assert_allclose(
        oee.state_values(mdp, policy, horizon=horizon), value, rtol=0, atol=1e-10
    )


def test_of_equal_actions_the_first_is_taken():
    mdp = oee.FiniteMDP(np.ones((1, 3, 1)), np.array([[0.0, 1.0, 1.0]]), [1.0], 0.9)
    assert oee.optimal_policy(mdp).tolist() == [[0.0, 1.0, 0.0]]


@pytest.mark.parametrize(
    ("left", "less"), [(1e-4, 1e-6), (1e-6, 1e-5), (1e-8, 1e-5), (1e-9, 1e-4)]
)
def test_near_discount_one_an_action_of_less_value_is_no_tie(left, less):
    """Its loss in every step adds up to less / left."""
    rows = np.full((2, 3, 2), 0.5)
    mdp = oee.FiniteMDP(
        rows, [[1.0 - less, 1.0, 1.0], [5.0, 5.0, 5.0 - less]], [0.5, 0.5], 1.0 - left
    )
    assert oee.optimal_policy(mdp).argmax(axis=1).tolist() == [1, 0]


def test_discount_one_on_frozen_lake():
    """The best chance of reaching the goal on the 4 x 4 map is 14/17.

    Gymnasium's documentation says 0.82.
    """
    lake = oee.tasks.toy_text("FrozenLake-v1", map_name="4x4", discount=1.0)
    assert_allclose(
        oee.policy_value(lake, oee.optimal_policy(lake)), 14 / 17, rtol=1e-12
    )


@pytest.mark.parametrize("name", ["forest", "frozen_lake", "gridworld"])
def test_peers_agree(name):
    """QuantEcon and MDPToolbox (hiive) find the same optimal values.

    Three named MDPs are solved; the values of the optimal policy agree as well.
    """
    import hiive.mdptoolbox.example
    import hiive.mdptoolbox.mdp
    from quantecon.markov import DiscreteDP

    if name == "forest":
        transitions, rewards = hiive.mdptoolbox.example.forest(S=10)
        mdp = oee.FiniteMDP(
            transitions.transpose(1, 0, 2), rewards, np.full(10, 0.1), 0.95
        )
    elif name == "frozen_lake":
        mdp = oee.tasks.toy_text("FrozenLake-v1", map_name="8x8")
    else:
        mdp = oee.tasks.gridworld(10, 0.3)
    dense = mdp.transitions.toarray().reshape(mdp.n_states, mdp.n_actions, mdp.n_states)
    ours = oee.state_values(mdp, oee.optimal_policy(mdp))
    economists = DiscreteDP(mdp.rewards, dense, mdp.discount).solve(
        method="policy_iteration"
    )
    assert_allclose(ours, economists.v, rtol=0, atol=1e-9)
    toolbox = hiive.mdptoolbox.mdp.PolicyIteration(
        dense.transpose(1, 0, 2), mdp.rewards, mdp.discount
    )
    toolbox.run()
    assert_allclose(ours, toolbox.V, rtol=0, atol=1e-9)
    # a stochastic policy: QuantEcon on the one-action problem, and the stationary flow
    # of its chain
    policy = np.random.default_rng(0).dirichlet(
        np.ones(mdp.n_actions), size=mdp.n_states
    )
    kernel = np.einsum("sa,sat->st", policy, dense)
    chain = DiscreteDP(
        (policy * mdp.rewards).sum(axis=1, keepdims=True),
        kernel[:, None, :],
        mdp.discount,
    )
    peer = chain.evaluate_policy(np.zeros(mdp.n_states, dtype=int))
    assert_allclose(oee.state_values(mdp, policy), peer, rtol=0, atol=1e-9)


def test_at_discount_one_the_plan_starts_from_a_policy_that_is_absorbed():
    """The plan leads out of a state where staying for nothing is not absorbed.

    Action 0 stays for nothing, action 1 costs 1 and leads out, where the reward is 5 on
    the way.
    """
    rows = np.array(
        [
            [[1.0, 0, 0], [0, 1.0, 0]],
            [[0, 0, 1.0], [0, 1.0, 0]],
            [[0, 0, 1.0], [0, 0, 1.0]],
        ]
    )
    mdp = FiniteMDP(
        rows, np.array([[0.0, -1.0], [5.0, 0.0], [0.0, 0.0]]), [1, 0, 0], 1.0
    )
    plan = oee.optimal_policy(mdp)
    assert oee.policy_value(mdp, plan) == 4.0
    assert_array_equal(plan[:2], [[0.0, 1.0], [1.0, 0.0]])


def test_with_a_horizon_the_first_of_equal_actions_and_the_discount():
    """With discount 0.5, a reward of 6 at once is better than 10 later.

    At the last step only the reward at once counts.
    """
    rows = np.array([[[0.0, 1.0], [0.0, 1.0], [0.0, 1.0]], [[0.0, 1.0]] * 3])
    rows[0, 0] = [1.0, 0.0]
    mdp = FiniteMDP(rows, np.array([[0.0, 6.0, 6.0], [0.0, 0.0, 0.0]]), [1, 0], 0.5)
    plan = oee.optimal_policy(mdp, horizon=3)
    assert plan.shape == (3, 2, 3)
    assert_array_equal(plan[:, 0], [[0.0, 1.0, 0.0]] * 3)
    assert_array_equal(plan[:, 1], [[1.0, 0.0, 0.0]] * 3)
    free = oee.optimal_policy(mdp.with_discount(1.0), horizon=2)
    assert_array_equal(free[:, 0], [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def test_equal_actions_up_to_rounding_are_equal():
    """0.1 + 0.2 against 0.3: the first, whichever is the larger in floating point."""
    rows = np.ones((1, 2, 1))
    for rewards in ([[0.1 + 0.2, 0.3]], [[0.3, 0.1 + 0.2]]):
        assert_array_equal(
            oee.optimal_policy(FiniteMDP(rows, np.array(rewards), [1.0], 0.0)),
            [[1.0, 0.0]],
        )


def check_plan(mdp):
    """No action is worth more than the plan's."""
    plan = oee.optimal_policy(mdp)
    q = oee.action_values(mdp, plan)
    assert (q.max(axis=1) <= (plan * q).sum(axis=1) + 1e-10 * np.abs(q).max()).all()


@pytest.mark.large
@pytest.mark.parametrize("discount", [0.5, 0.9, 0.999, 0.99999])
def test_plans_cannot_be_improved(discount):
    """No action improves on the plan of a random MDP, a queue or a ring.

    The queue has two rates of service, the ring two drifts; all begin from a greedy
    policy.
    """
    check_plan(
        random_mdp(
            np.random.default_rng(0), n_states=60, n_actions=5, discount=discount
        )
    )
    rng = np.random.default_rng(1)
    n = 300
    at = np.arange(n)
    for is_ring in (False, True):
        rows = np.zeros((n, 2, n))
        for action, up in enumerate((0.45, 0.6)):
            ahead, back = (
                ((at + 1) % n, at - 1)
                if is_ring
                else (np.minimum(at + 1, n - 1), np.maximum(at - 1, 0))
            )
            np.add.at(rows[:, action], (at, ahead), up)
            np.add.at(rows[:, action], (at, back), 1.0 - up)
        rewards = rng.normal(size=(n, 2)) - (0.0 if is_ring else 0.01 * at[:, None])
        check_plan(FiniteMDP(rows, rewards, np.full(n, 1 / n), discount))


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # where kernels are not compiled
def test_plans_of_rewards_near_the_largest_float_end():
    mdp = FiniteMDP(np.ones((1, 2, 1)), np.array([[1e308, 1.5e308]]), [1.0], 0.99)
    with pytest.warns(UserWarning, match="beyond the largest float"):
        assert oee.optimal_policy(mdp).sum() == 1.0


@pytest.mark.parametrize("unit", [1e-200, 1e-12, 1e-3, 1e9])
def test_the_unit_of_rewards_does_not_matter(unit):
    rng = np.random.default_rng(0)
    transitions = rng.dirichlet(np.ones(4), size=(4, 3))
    rewards = rng.uniform(size=(4, 3))
    best = oee.optimal_policy(oee.FiniteMDP(transitions, rewards, 0, 0.9))
    assert_array_equal(
        oee.optimal_policy(oee.FiniteMDP(transitions, unit * rewards, 0, 0.9)), best
    )

"""Environments by brute force: toy-text tables, discretised tables, the bench's pairs."""

from types import SimpleNamespace

import numpy as np
import pytest
from audit.reference import Dense
from numpy.testing import assert_allclose
from scipy import integrate, stats

import oee_tabular as oee
from oee_tabular.continuous.task import ContinuousTask, Moves
from oee_tabular.tasks import GridInterpolation, discretize


def test_a_toy_text_table_with_duplicates_and_ends_by_path():
    """Outcomes of one (s, a, s') are added up, their rewards averaged by probability; what was ended pays no more."""
    table = {
        0: {0: [(0.3, 1, 1.0, False), (0.2, 1, 5.0, False), (0.5, 2, -1.0, True)], 1: [(1.0, 0, 0.5, False)]},
        1: {0: [(0.6, 2, 2.0, False), (0.4, 2, 3.0, True)], 1: [(0.0, 0, 9.0, False), (1.0, 1, 0.0, False)]},
        2: {0: [(1.0, 0, 4.0, False)], 1: [(0.5, 2, 1.0, False), (0.5, 0, 1.0, True)]},
    }
    env = SimpleNamespace(P=table, initial_state_distrib=np.array([1.0, 0.0, 0.0]))
    mdp = oee.FiniteMDP.from_gymnasium(env, discount=0.9)
    policy = np.array([[0.7, 0.3], [0.5, 0.5], [0.4, 0.6]])

    def walk(s, steps):
        if steps == 0:
            return 0.0
        return sum(
            policy[s, a] * p * (r + (0.0 if ended else 0.9 * walk(j, steps - 1)))
            for a in range(2)
            for p, j, r, ended in table[s][a]
            if p > 0
        )

    assert_allclose(oee.policy_value(mdp, policy, horizon=5), walk(0, 5), rtol=1e-12)
    assert_allclose(mdp.transitions.toarray().sum(axis=1), 1.0, rtol=1e-15)
    assert_allclose(Dense(mdp).P[0, 0, 1], 0.5)
    assert_allclose(Dense(mdp).r[0, 0, 1], (0.3 * 1 + 0.2 * 5) / 0.5)


class Line(ContinuousTask):
    """x' = 0.8 x + a + 0.3 xi on a line, pays x'; starts evenly in [-1, 1]."""

    name, state_names, feature_names = "line", ("x",), ("x",)
    actions, n_disturbances, periodic, terminates = np.array([-0.2, 0.3]), 1, (False,), False
    feature_low, feature_high = np.array([-3.0]), np.array([3.0])

    def moves(self, states, actions, disturbance):
        following = 0.8 * states + self.actions[actions][:, None] + 0.3 * disturbance
        return Moves(following, following[:, 0], np.zeros(len(states), dtype=bool))

    def initial_states(self, n, rng):
        return rng.uniform(-1.0, 1.0, (n, 1))


def test_a_discretised_table_by_integrals():
    """Vertex j gets the integral of its hat; the nodes and weights of the quadrature are numpy's."""
    model = discretize(Line(), cells=GridInterpolation((13,), noise_points=20), closure_episodes=0)
    vertices = np.linspace(-3, 3, 13)
    table = model.mdp.transitions.toarray().reshape(13, 2, 13)
    nodes, weights = np.polynomial.hermite_e.hermegauss(20)
    weights = weights / weights.sum()
    for s in range(13):
        for a, push in enumerate([-0.2, 0.3]):
            mean = 0.8 * vertices[s] + push
            at = np.clip(mean + 0.3 * nodes, -3, 3)
            hats = np.clip(1 - np.abs(at[:, None] - vertices[None]) / 0.5, 0, None)
            assert_allclose(table[s, a], weights @ hats, atol=1e-9)
            x = np.linspace(mean - 2.4, mean + 2.4, 4001)
            hats = np.clip(1 - np.abs(np.clip(x, -3, 3)[:, None] - vertices[None]) / 0.5, 0, None)
            whole = integrate.trapezoid(hats * stats.norm.pdf(x, mean, 0.3)[:, None], x, axis=0)
            assert_allclose(table[s, a], whole, atol=0.02)
            assert_allclose(model.mdp.rewards[s, a], mean, atol=1e-9)
    inner = np.array([0.5 if abs(v) < 1 else 0.25 if abs(v) == 1 else 0.0 for v in vertices]) * 0.5
    assert_allclose(model.mdp.initial, inner, atol=0.006)  # 50 000 draws


@pytest.mark.parametrize("name", ["machine", "queue25", "corridor30", "garnet"])
def test_the_truth_of_a_bench_pair_and_where_its_episodes_go(name):
    """By a dense solve, and by stepping an episode's distribution until all of it is over or cut."""
    every = oee.bench.families()
    family = every[next(key for key in every if key.startswith(name))]
    base = Dense(family.target)
    if family.horizon is None and base.g < 1:
        assert_allclose(family.truth, base.J(family.policy), rtol=1e-8)
    else:
        assert_allclose(family.truth, base.J(family.policy, family.horizon), rtol=1e-8)
    over = np.array([(base.P[s, :, s] == 1.0).all() and (base.r[s, :, s] == 0.0).all() for s in range(len(base.mu))])
    at, visits = base.mu.copy(), np.zeros_like(family.policy)
    for t in range(family.length):
        going = at if t == 0 else np.where(over, 0.0, at)
        visits += going[:, None] * family.data_policy
        at = going @ base.chain(family.data_policy)
    assert_allclose(family.moves_per_state_action, visits, atol=1e-8)
    assert_allclose(family.data_distribution.sum(), 1.0)
    assert family.open_rows == sum((row > 0).sum() > 1 for row in Dense(family.simulator).P.reshape(-1, len(base.mu)))

"""Environments by brute force: displacements, the gridworld, toy-text tables, discretised tables, the bench's pairs."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from audit.reference import Dense
from numpy.testing import assert_allclose
from scipy import stats

import oee_tabular as oee
from oee_tabular.bench.league import league_of
from oee_tabular.mdp.layout import displacements


@pytest.mark.parametrize("given", [False, True])
def test_displacements_move_by_move(given):
    rng = np.random.default_rng(0)
    P = rng.dirichlet(np.ones(5), size=(5, 2)) * (rng.random((5, 2, 5)) < 0.7)
    P = P / P.sum(axis=2, keepdims=True)
    places = rng.integers(0, 3, size=(5, 2)).astype(float) if given else np.arange(5.0)[:, None]
    mdp = oee.FiniteMDP(P, np.zeros(5), np.full(5, 0.2), 0.9, layout=places if given else None)
    kinds, kind = displacements(mdp)
    mass = {}
    for number, (s, a, j) in enumerate(np.argwhere(P > 0)):
        step = tuple(places[j] - places[s])
        assert tuple(kinds[kind[number]]) == step
        mass[step] = mass.get(step, 0.0) + P[s, a, j]
    assert [tuple(k) for k in kinds] == sorted(mass, key=lambda step: (-mass[step], step))


@pytest.mark.parametrize("pay", ["next", "current"])
def test_the_gridworld_cell_by_cell(pay):
    size, slip = 3, 0.3
    mdp = oee.tasks.gridworld(size, slip, pay=pay)
    base = Dense(mdp)
    for s in range(9):
        row, column = divmod(s, size)
        for a in range(4):
            want = np.zeros(9)
            for direction, (down, right) in enumerate([(1, 0), (-1, 0), (0, 1), (0, -1)]):
                to = s
                if 0 <= row + down < size and 0 <= column + right < size:
                    to = (row + down) * size + column + right
                want[8 if s == 8 else to] += 0.7 if direction == a else 0.1
            assert_allclose(base.P[s, a], want, atol=1e-15)
            for j in np.flatnonzero(want):
                at = j if pay == "next" else s
                assert_allclose(base.r[s, a, j], -0.2 * (4 - at // size - at % size), atol=1e-15)
    assert_allclose(mdp.layout, [divmod(s, size) for s in range(9)])
    assert mdp.initial[0] == 1.0


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


class Line(oee.tasks.ContinuousTask):
    """x' = 0.8 x + a + 0.3 noise on a line, pays x."""

    name, state_names, feature_names = "line", ("x",), ("x",)

    def __init__(self):
        self._scale = 0.3

    def parameters(self):
        return {}

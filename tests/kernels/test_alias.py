"""Alias tables, counted in whole numbers: what each outcome has in the table is its
probability; and Philox's answers.
"""

from fractions import Fraction

import numpy as np
import pytest
from helpers import random_mdp, random_policy, rngs
from hypothesis import given
from scipy import sparse

import oee_tabular as oee
from oee_tabular.simulate._rollout import philox
from oee_tabular.simulate.sampler import alias_table


@pytest.mark.parametrize(
    ("counter", "key", "answer"),
    [
        # Random123's kat_vectors for philox4x32-10
        ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
        (
            (0xFFFFFFFF,) * 4,
            (0xFFFFFFFF,) * 2,
            (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD),
        ),
        (
            (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
            (0xA4093822, 0x299F31D0),
            (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
        ),
    ],
)
def test_philox_gives_its_published_answers(counter, key, answer):
    words = philox(*(np.uint64(word) for word in (*counter, *key)))
    assert tuple(int(word) for word in words) == answer


def table_shares(mdp, policy):
    """Of each state, and of the first state's draw: {entry: share of the words of 62
    bits}, by going through its slots.
    """
    table = alias_table(mdp, policy, mdp.initial, mdp.absorbing(), np.zeros(0))
    shares = []
    for code in table.code:
        first = int(code) >> 8
        k = int(code) & 63
        units = {}
        for slot in range(first, first + 2**k):
            threshold = int(table.word[slot]) >> k
            alias = int(table.word[slot]) & (2**k - 1)
            for entry, number in (
                (table.entry[slot], threshold),
                (table.entry[first + alias], 2 ** (62 - k) - threshold),
            ):
                units[entry] = units.get(entry, 0) + number
        assert sum(units.values()) == 2**62
        shares.append(
            {int(entry): Fraction(number, 2**62) for entry, number in units.items()}
        )
    return shares


def check_table(mdp, policy):
    """Each (a, s') has the chance policy(a | s) P(s' | s, a) to some roundings, 0 where
    that is 0; the first state likewise.
    """
    indptr = mdp.transitions.indptr
    data = mdp.transitions.data
    *states, start = table_shares(mdp, policy)
    for state, shares in enumerate(states):
        for action, weight in enumerate(policy[state]):
            row = state * mdp.n_actions + action
            total = sum(Fraction(x) for x in data[indptr[row] : indptr[row + 1]])
            for x in range(indptr[row], indptr[row + 1]):
                chance = (
                    Fraction(weight)
                    * Fraction(data[x])
                    / total
                    / sum(Fraction(a) for a in policy[state])
                )
                share = shares.pop(x, Fraction(0))
                assert abs(share - chance) <= Fraction(1, 2**50)
                assert chance > 0 or share == 0
        assert not any(shares.values())
    for place, state in enumerate(np.flatnonzero(mdp.initial)):
        assert abs(
            start.get(mdp.transitions.nnz + place, 0) - Fraction(mdp.initial[state])
        ) <= Fraction(1, 2**50)


@given(rngs)
def test_the_table_has_each_probability(rng):
    mdp = random_mdp(rng)
    check_table(mdp, random_policy(rng, mdp))


@pytest.mark.parametrize(
    "row",
    [
        [1.0],
        [0.5, 0.5],
        [0.25] * 4,
        [1 / 3] * 3,
        [1.0, 1e-300],
        [1e-30, 1.0, 1e-18],
        [1 - 2**-53, 2**-53],
        [0.3, 0.3 - 8e-9, 0.4],
        pytest.param(
            np.random.default_rng(0).dirichlet(np.ones(3000)), marks=pytest.mark.large
        ),
    ],
)
def test_particular_rows(row):
    n = len(row)
    transitions = sparse.csr_array(
        (np.tile(row, n), np.tile(np.arange(n), n), np.arange(n + 1) * n), shape=(n, n)
    )
    if n > 100:  # one row is enough
        transitions = sparse.vstack(
            [transitions[[0], :], sparse.eye_array(n, format="csr")[1:, :]],
            format="csr",
        )
    initial = np.array(row) / np.sum(row)
    mdp = oee.FiniteMDP(transitions, np.zeros(n), initial, 0.9)
    check_table(mdp, np.ones((n, 1)))

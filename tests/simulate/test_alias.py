"""Alias tables, counted in whole numbers: what each outcome has in the table is its probability."""

from fractions import Fraction

import numpy as np
import pytest
from helpers import rngs
from hypothesis import given
from numpy.testing import assert_array_equal

from oee_tabular.simulate import _lanes as lanes
from oee_tabular.simulate import sampler as alias


def table_of(rows, records=None):
    """The table of states with one action and these chances; nothing is over, rewards and factors number the entries."""
    n, chance = len(rows), np.concatenate(rows)
    starts = np.concatenate([[0], np.cumsum([len(row) for row in rows])])
    numbers = np.arange(len(chance))
    table = alias.build(
        starts, numbers % n, chance, np.ones((n, 1)), np.eye(n)[0], numbers + 0.5, numbers + 0.25,
        np.zeros(n, dtype=bool), records=records,
    )  # fmt: skip
    return table, starts


def masses(table, starts, state):
    """Units of 2^-64 that each outcome of a state has, by going through its slots."""
    code = int(table.code[state])
    first, k = code >> 8, code & 255
    room = 2 ** (64 - k)
    found = [0] * (starts[state + 1] - starts[state])
    for i in range(2**k):
        word = int(table.slots.word[first + i])
        threshold, other = word >> k, word & (2**k - 1)
        found[table.slots.entry[first + i] - starts[state]] += threshold
        found[table.slots.entry[first + other] - starts[state]] += room - threshold
    return found


def check(rows):
    table, starts = table_of(rows)
    for state, row in enumerate(rows):
        found = masses(table, starts, state)
        assert sum(found) == 2**64
        total = sum(Fraction(float(x)) for x in row)
        shares = [Fraction(float(x)) / total * 2**64 for x in row]
        most, slots = max(shares), 2 ** (int(table.code[state]) & 255)
        assert slots < 2 * max(sum(mass > 0 for mass in found), 1)
        for mass, share in zip(found, shares, strict=True):
            # to half a unit and the roundings of a double; the most probable takes what others leave
            miss = len(row) * Fraction(1, 2) if share == most else Fraction(1, 2)
            assert abs(mass - share) <= miss + slots * 2**11
            assert share > 0 or mass == 0


@given(rngs)
def test_the_table_has_each_probability_to_its_resolution(rng):
    rows = [rng.dirichlet(np.full(rng.integers(1, 30), 0.3)) for _ in range(rng.integers(1, 6))]
    rows = [np.where((np.arange(len(row)) > 0) & (rng.random(len(row)) < 0.2), 0.0, row) + (0 if row[0] else 1e-9)
            for row in rows]  # fmt: skip
    check(rows)


@pytest.mark.parametrize(
    "row",
    [
        [1.0],
        [0.5, 0.5],
        [0.0, 0.0, 1.0],
        [0.25] * 4,
        [1 / 3] * 3,
        [1.0, 1e-300],
        [1e-30, 1.0, 1e-18],
        [1 - 2**-53, 2**-53],
        [0.3, 0.30000001, 0.4],
        np.random.default_rng(0).dirichlet(np.ones(5000)),  # its slots take 13 of the 64 bits
    ],
)
def test_particular_rows(row):
    check([np.array(row), np.array([1.0])])


@given(rngs)
def test_a_word_below_the_threshold_takes_the_slots_own_outcome_and_no_other_does(rng):
    """But where its bits are the threshold's first ones: that is said, and nothing else is."""
    table, _ = table_of([rng.dirichlet(np.ones(rng.integers(1, 12))), np.ones(1)])
    code = table.code[0]
    first, k = int(code) >> 8, int(code) & 255
    for i in range(2**k):
        word = int(table.slots.word[first + i])
        threshold, other = word >> k + 32, word & (2**k - 1)
        for high, taken in (
            (0, i),
            (threshold - 1, i),
            (threshold, None),
            (threshold + 1, other),
            (2 ** (32 - k) - 1, other),
        ):
            if 0 <= high < 2 ** (32 - k):
                x = high << k | i
                slot, distance = lanes.choose(code, np.uint64(x << 32 | x), table.slots.word, np.uint64(2 ** (k + 32)))
                assert (int(distance) < 2 ** (k + 33)) >= (high == threshold)
                assert (int(distance) < 2 ** (k + 33)) <= (abs(high - threshold) <= 1 or high == 2 ** (32 - k) - 1)
                assert high == threshold or int(slot) == first + taken


def test_records_hold_what_arrays_hold_in_aligned_32_bytes():
    rows = [np.random.default_rng(s).dirichlet(np.ones(s + 1)) for s in range(9)]
    (arrays, _), (records, _) = table_of(rows, records=False), table_of(rows, records=True)
    for one, other in (
        (arrays.code, records.code),
        (arrays.over, records.over),
        *zip(arrays.slots, records.slots, strict=True),
    ):
        assert_array_equal(one, other)
    assert records.slots.word.strides == (32,)
    assert records.slots.word.ctypes.data % 32 == 0
    assert [getattr(records.slots, name).ctypes.data - records.slots.word.ctypes.data
            for name in ("word", "following", "reward", "factor")] == [0, 8, 16, 24]  # fmt: skip
    assert arrays.slots.word.strides == (8,)


def test_rewards_of_a_row_and_of_an_entry_and_codes_of_successors():
    """Two states, two actions, in all four forms."""
    indptr, indices = np.array([0, 2, 3, 4, 6]), np.array([0, 1, 1, 0, 0, 1])
    prob, policy = np.array([0.5, 0.5, 1.0, 1.0, 0.25, 0.75]), np.array([[0.5, 0.5], [0.25, 0.75]])
    for pay in (np.arange(4) + 10.0, np.arange(6) + 10.0):
        for ratio in (np.zeros(0), np.arange(6) / 4):
            table = alias.build(
                indptr, indices, prob, policy, np.array([0.0, 1.0]), pay, ratio, np.zeros(2, dtype=bool)
            )
            for state in range(2):
                low, k = int(table.code[state]) >> 8, int(table.code[state]) & 255
                for i in range(low, low + 2**k):
                    x = table.slots.entry[i]
                    assert table.slots.following[i] == table.code[indices[x]]
                    assert (
                        table.slots.reward[i]
                        == pay[x if len(pay) == 6 else np.searchsorted(indptr, x, side="right") - 1]
                    )
                    assert len(ratio) == 0 or table.slots.factor[i] == ratio[x]
            begin = int(table.code[2])
            assert begin & 255 == 0
            assert table.slots.following[begin >> 8] == table.code[1]


def test_rows_that_sum_to_one_only_to_the_tolerance():
    """Each row of P and of the policy is divided by its own sum."""
    prob, policy = np.array([0.5, 0.5, 0.2, 0.8]), np.array([[0.3, 0.7]])
    off = np.repeat([1 + 8e-9, 1 - 8e-9], 2)
    found = []
    for p, pi in ((prob, policy), (prob * off, policy * (1 + 5e-9))):
        table = alias.build(
            np.array([0, 2, 4]), np.array([0, 0, 0, 0]), p, pi, np.ones(1), np.zeros(2), np.zeros(0), np.zeros(1, bool)
        )
        found.append(masses(table, np.array([0, 4]), 0))
    for one, other in zip(*found, strict=True):
        assert abs(one - other) <= 2**13


@given(rngs)
def test_every_slot_is_one_states(rng):
    n = int(rng.integers(1, 9))
    lengths, over = rng.integers(1, 9, n), rng.random(n) < 0.4
    starts = np.concatenate([[0], np.cumsum(lengths)])
    prob = np.concatenate([np.full(length, 1 / length) for length in lengths])
    table = alias.build(
        starts, np.zeros(starts[-1], int), prob, np.ones((n, 1)), np.eye(n)[0], np.zeros(n), np.zeros(0), over
    )
    taken = [np.arange(int(code) >> 8, (int(code) >> 8) + 2 ** (int(code) & 255)) for code in table.code]
    assert_array_equal(np.sort(np.concatenate(taken)), np.arange(len(table.slots.word)))
    for state in range(n):
        assert set(table.slots.entry[taken[state]]) == set(range(starts[state], starts[state + 1]))


def test_states_that_are_over_have_the_last_codes():
    for over in (np.array([True, False, True, False]), np.ones(4, dtype=bool), np.zeros(4, dtype=bool)):
        table = alias.build(
            np.arange(5), np.arange(4), np.ones(4), np.ones((4, 1)), np.eye(4)[0], np.zeros(4), np.zeros(0), over
        )
        assert_array_equal(table.code[:4] >= table.over, over)

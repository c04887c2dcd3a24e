"""The compiled rows against plain numpy: the same recurrences, without a compiler and without cleverness."""

import numpy as np
import pytest
from helpers import rngs
from hypothesis import given
from numpy.testing import assert_allclose

from oee_tabular.ratio import _dual, dual


def minimisers(m, form):
    """argmin over [lower, upper] of (q m - pull) g - p log g + a/2 g^2, entry by entry."""
    found = []
    for p, q, a, pull in zip(form.p, form.q, form.a, form.pull, strict=True):
        b = q * m - pull
        if a > 0:
            g = (np.sqrt(b * b + 4 * a * p) - b) / (2 * a) if b <= 0 else 2 * p / (b + np.sqrt(b * b + 4 * a * p))
        elif b > 0:
            g = p / b
        else:
            g = np.inf if p > 0 or b < 0 else 0.0
        found.append(np.clip(g, form.lower, form.upper))
    return np.array(found)


def root(form):
    """m of sum q g(m) = sum q by bisection."""
    left, right = -1e6, 1e6
    for _ in range(200):
        m = 0.5 * (left + right)
        left, right = (m, right) if form.q @ minimisers(m, form) > form.q.sum() else (left, m)
    return 0.5 * (left + right)


def programs(rng, curved):
    """A few rows with zeros in p, and their ends."""
    lengths = rng.integers(1, 7, 5)
    indptr = np.concatenate([[0], np.cumsum(lengths)])
    rows = np.repeat(np.arange(5), lengths)
    p = rng.integers(0, 5, indptr[-1]) + 0.0
    p[indptr[:-1]] += 1
    q = rng.integers(1, 9, indptr[-1]) + 0.0
    p, q = (x / np.bincount(rows, x)[rows] for x in (p, q))
    a = rng.uniform(0.01, 2.0, len(p)) if curved else np.zeros(len(p))
    box = (float(rng.choice([0.0, 0.3])), float(rng.choice([1.7, np.inf])))
    return dual.Coordinates(p, q, a, np.full(len(p), float(rng.uniform(0, 2)))), box, indptr


@pytest.mark.parametrize("curved", [False, True])
@given(rng=rngs)
def test_each_row_is_the_root_of_its_dual(curved, rng):
    program, box, indptr = programs(rng, curved)
    found = dual.solve_rows(program, *box, indptr)
    whole = program.kernel_form(*box)
    below, above = found.enclosure()
    for k, (low, high) in enumerate(zip(indptr[:-1], indptr[1:], strict=True)):
        form = _dual.Form(*(x[low:high] for x in whole[:4]), *box)
        by_hand = minimisers(root(form), form)
        seen = form.p > 0  # where p = 0 = a the minimiser jumps at the root
        assert_allclose(found.ratio[low:high][seen | curved], by_hand[seen | curved], rtol=1e-6, atol=1e-9)
        assert_allclose(form.q @ found.ratio[low:high], form.q.sum(), rtol=1e-12)
        assert found.gap[k] < 1e-12
    assert (below <= found.ratio * (1 + 1e-15)).all()
    assert (found.ratio <= above * (1 + 1e-15)).all()


@given(rngs)
def test_without_the_equality_every_entry_is_by_itself(rng):
    program, box, _ = programs(rng, curved=bool(rng.integers(2)))
    form = program.kernel_form(box[0], 9.0)
    assert_allclose(dual.solve_free(program, box[0], 9.0), minimisers(1.0, form), rtol=1e-12)

"""The worst row in a ball of Kullback and Leibler, in a box or not, against its own
statement and a conic program.
"""

import warnings

import cvxpy as cp
import numpy as np
from helpers import rngs
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from oee_tabular.inference import robust as kernel


def random_row(rng, box=True):
    k = int(rng.integers(2, 6))
    n = int(rng.integers(1, 40))
    prior = rng.dirichlet(np.ones(k)) * 0.9 + 0.1 / k
    phat = rng.multinomial(n, prior) / n
    v = rng.integers(-3, 4, size=k) + 0.0
    low, high = (
        (0.3 * prior, np.minimum(2.5 * prior, 1.0))
        if box
        else (np.zeros(k), np.ones(k))
    )
    return phat, v, low, high, float(10 ** rng.uniform(-2, 0.3))


def solve_row(phat, v, low, high, epsilon):
    out = np.empty(len(v))
    above = np.empty(1)
    kl = np.empty(1)
    lam = np.zeros(1)
    kernel.worst_rows(
        np.array([epsilon]),
        phat,
        v,
        kernel.order_by_row(v, np.zeros(len(v), dtype=int)),
        low,
        high,
        np.array([0, len(v)]),
        lam,
        out,
        np.empty(len(v)),
        above,
        kl,
    )
    return out, above[0], kl[0]


@settings(max_examples=150)
@given(rngs, st.booleans())
# a probability of 7e-15 where the frequency is .04
@example(np.random.default_rng(520864), False)
def test_37_the_worst_row_is_feasible_and_certified(rng, box):
    phat, v, low, high, epsilon = random_row(rng, box)
    p, above, kl = solve_row(phat, v, low, high, epsilon)
    assert_allclose(p.sum(), 1.0, rtol=1e-12)
    assert (p >= low - 1e-12).all()
    assert (p <= high + 1e-12).all()
    # the ball misses the box: no point of the box is nearer
    if kl > epsilon * (1 + 1e-9):
        return
    assert_allclose(
        kl,
        sum(a * np.log(a / b) for a, b in zip(phat, p, strict=True) if a > 0),
        atol=1e-9,
    )
    assert above >= p @ v - 1e-12
    assert above - p @ v < 1e-7 * max(1.0, np.abs(v).max())
    tv = 0.5 * np.abs(p - phat).sum()
    # Pinsker: the KL ball is inside the L1 ball
    assert tv <= np.sqrt(epsilon / 2) + 1e-9


def test_the_worst_row_against_clarabel():
    rng = np.random.default_rng(0)
    for trial in range(40):
        phat, v, low, high, epsilon = random_row(rng, trial % 2 == 0)
        p, _, kl = solve_row(phat, v, low, high, epsilon)
        x = cp.Variable(len(v))
        seen = phat > 0
        ball = cp.sum(cp.kl_div(phat[seen], x[seen]) + phat[seen] - x[seen]) <= epsilon
        problem = cp.Problem(
            cp.Maximize(v @ x), [ball, cp.sum(x) == 1, x >= low, x <= high]
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            problem.solve(solver="CLARABEL")
        if kl > epsilon * (1 + 1e-9):
            assert problem.status.startswith("infeasible")
            continue
        assert_allclose(p @ v, problem.value, atol=1e-6)

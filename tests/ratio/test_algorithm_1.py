"""Algorithm 1 from end to end: both tables, their quotient, and how far from the
optimum of eq. 3.7 its trace says it is.

The risk is p / mu^2 strongly convex in each cell, so sum p (g - g*)^2 <= 2 mu^2
(risk(g) - risk(g*)).
"""

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

import oee_tabular as oee
from oee_tabular import paper
from oee_tabular.ratio import Quotient, Sgd

NU = 0.2
MU = 5.0
BOX = {"lower": NU, "upper": MU, "normalized": False}
SGD = Sgd(step_size=0.02, batch_size=128, n_iterations=20_000)
START_EXCESS = 0.05  # nats: what g = 1 lacks at least


def draw_logs():
    """3 states, 2 actions, every move possible; 3000 moves of the target and of the
    simulator, uniform (s, a).
    """
    rng = np.random.default_rng(0)
    simulator, target = (
        oee.FiniteMDP(
            rng.dirichlet(np.full(3, 2.0), (3, 2)), np.zeros(3), np.eye(3)[0], 0.9
        )
        for _ in range(2)
    )
    # the target is recorded elsewhere: neither ratio is 1
    shares = rng.dirichlet(np.full(6, 2.0)).reshape(3, 2)
    return simulator, *(
        oee.sample_transitions(mdp, of, 3000, seed=k)
        for k, (mdp, of) in enumerate(
            [(target, shares), (simulator, np.full((3, 2), 1 / 6))]
        )
    )


def shares(log):
    """p or q of (s, a, s'), of shape (3, 2, 3)."""
    return log.counts(3, 2).toarray().reshape(3, 2, 3) / len(log)


def tables(logs):
    """p, q of (s, a, s') and of (s, a), and the exact optima of eq. 3.7."""
    p, q = (shares(log) for log in logs[1:])
    pairs = [(p.ravel(), q.ravel()), (p.sum(axis=2).ravel(), q.sum(axis=2).ravel())]
    return [(p, q, oee.density_ratio(p, q, **BOX).ratio) for p, q in pairs]


def test_both_tables_and_their_quotient_are_within_the_traces_bound():
    simulator, te, tr = logs = draw_logs()
    fitted = Quotient(**BOX, solver=SGD, data=tr).fit(te, simulator, seed=1)
    for beta, (p, q, best) in zip(fitted.details["beta"], tables(logs), strict=True):
        excess = beta.trace.excess[-1]
        assert_allclose(
            excess,
            paper.risk(beta.ratio, p, q) - paper.risk(best, p, q),
            rtol=1e-6,
            atol=1e-12,
        )
        assert_allclose(beta.gap, excess, rtol=1e-6, atol=1e-12)
        assert_allclose(
            beta.trace.error[-1], np.abs(beta.ratio - best).mean(), rtol=1e-9
        )
        assert np.sqrt(p @ (beta.ratio - best) ** 2) <= MU * np.sqrt(2 * excess)
        assert beta.trace.iteration[-1] == SGD.n_iterations
        assert beta.trace.excess[0] > START_EXCESS
        assert excess < 0.05 * beta.trace.excess[0]
    (_, _, a), (_, _, b) = tables(logs)
    (moves, pairs) = fitted.details["beta"]
    row = np.repeat(np.arange(6), 3)
    zeta = a / b[row]
    assert_allclose(fitted.values.data, moves.ratio / pairs.ratio[row], rtol=1e-12)
    assert np.abs(fitted.values.data - zeta).mean() < 0.15 * np.abs(zeta - 1).mean()


def test_algorithm_1_step_by_step():
    """The same draws, one update at a time, and its trace."""
    p = np.array([3.0, 1.0, 4.0]) / 8
    q = np.array([2.0, 4.0, 2.0]) / 8
    options = {
        "lower": 0.2,
        "upper": 3.0,
        "normalized": False,
        "ridge": 0.1,
        "toward": 1.0,
    }
    found = oee.density_ratio(
        p,
        q,
        solver=Sgd(0.05, batch_size=16, n_iterations=60),
        seed=4,
        **options,
    )
    best = oee.density_ratio(p, q, **options)
    generator = np.random.default_rng(4)
    g = np.ones(3)
    trace = {}
    for iteration in range(1, 61):
        counts = [
            np.bincount(
                np.searchsorted(
                    np.cumsum(x), generator.random(16) * x.sum(), side="right"
                ),
                minlength=3,
            )
            / 16
            for x in (p, q)
        ]
        g = np.clip(
            g - 0.05 * (counts[1] - counts[0] / g + 0.1 * q * (g - 1.0)), 0.2, 3.0
        )
        value = q @ g - p @ np.log(g) + 0.05 * q @ (g - 1.0) ** 2
        trace[iteration] = (value - best.objective, np.abs(g - best.ratio).mean())
    assert_allclose(found.ratio, g, rtol=1e-12)
    points = found.trace.iteration
    assert points[0] == 1
    assert points[-1] == 60
    assert_array_equal(points, np.unique(np.round(np.geomspace(1, 60, 50))))
    assert_allclose(found.trace.excess, [trace[i][0] for i in points], atol=1e-12)
    assert_allclose(found.trace.error, [trace[i][1] for i in points], rtol=1e-9)
    assert_allclose(found.gap, trace[60][0], atol=1e-12)

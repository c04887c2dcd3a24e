"""Dropped transitions: the band that they owe against the value's derivative, and what
the other methods refuse.
"""

import itertools

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import sparse

import oee_tabular as oee
from oee_tabular.estimators.findings import moves_dropped
from oee_tabular.inference import compare_policies
from oee_tabular.inference.asymptotic import outside_margin
from oee_tabular.inference.evidence import gather

S = 4
A = 2
STRAYS = (0, 3)
EACH = 3.0


def world(seed, form, each=EACH):
    """Two next states an action, counts of 15 transitions each, and in two pairs three
    to a state that is none of these.
    """
    rng = np.random.default_rng(seed)
    P = np.zeros((S, A, S))
    for s, a in itertools.product(range(S), range(A)):
        P[s, a, rng.choice(S, 2, replace=False)] = rng.dirichlet([1, 1])
    r = (
        rng.normal(size=(S, A))
        if form == "r(s, a)"
        else np.where(P > 0, rng.normal(size=P.shape), np.nan)
    )
    rows = P.reshape(S * A, S)
    counts = np.array([rng.multinomial(15, row) for row in rows], dtype=float)
    for x in STRAYS:
        counts[x, np.flatnonzero(rows[x] == 0)[0]] = each
    return P, r, counts, rng.dirichlet([1, 1], size=S)


def problem_of(P, r, counts, horizon=None):
    return oee.Problem(
        oee.FiniteMDP(P, r, 0, 0.9),
        sparse.csr_array(counts),
        horizon=horizon,
        impossible="drop",
    )


def value_of(P, r, policy, horizon):
    """V(0) at discount 0.9 by numpy alone."""
    kernel = 0.9 * np.einsum("sa,sat->st", policy, P)
    pay = (policy * r).sum(axis=1)
    if horizon is None:
        return np.linalg.solve(np.eye(S) - kernel, pay)[0]
    value = np.zeros(S)
    for _ in range(horizon):
        value = pay + kernel @ value
    return value[0]


@pytest.mark.parametrize("form", ["r(s, a)", "r(s, a, s')"])
@pytest.mark.parametrize("horizon", [None, 1])
def test_the_band_is_first_order_over_all_places(form, horizon):
    """d / de of the value whose pairs send a share e q to the place of most or least r
    + gamma V.
    """
    for seed in range(6):
        P, r, counts, policy = world(seed, form)
        problem = problem_of(P, r, counts, horizon)
        evidence = gather(problem, policy)
        margin = outside_margin(problem, evidence)
        rows = evidence.fitted.transitions.toarray()
        share = problem.dropped / (problem.dropped + evidence.n)
        for sign, size in ((-1.0, margin.down), (1.0, margin.up)):
            paid = (
                r
                if r.ndim == 2
                else np.where(np.isnan(r), sign * np.nanmax(sign * r), r)
            )
            extreme = None if r.ndim == 2 else sign * np.nanmax(sign * r)
            every = []
            for places in itertools.product(range(S), repeat=len(STRAYS)):
                values = []
                for e in (0.0, 1e-6):
                    moved = rows.copy()
                    pay = (
                        paid
                        if r.ndim == 2
                        else (rows.reshape(P.shape) * paid).sum(axis=2)
                    ).copy()
                    for x, to in zip(STRAYS, places, strict=True):
                        moved[x] = (1 - e * share[x]) * rows[x] + e * share[x] * np.eye(
                            S
                        )[to]
                        if extreme is not None:
                            pay[x // A, x % A] += (
                                e * share[x] * (extreme - pay[x // A, x % A])
                            )
                    values.append(
                        value_of(moved.reshape(P.shape), pay, policy, horizon)
                    )
                every.append(sign * (values[1] - values[0]) / 1e-6)
            assert_allclose(size, max(0.0, *every), rtol=1e-4, atol=1e-7)
        assert margin.diagnostics["dropped_transitions"] == 2 * EACH


@pytest.mark.parametrize("form", ["r(s, a)", "r(s, a, s')"])
def test_the_band_of_a_horizon_has_the_extreme_of_every_step(form):
    """d / de of values to go of which every step sends a share e q where its own r +
    gamma V is least or most.
    """
    P, r, counts, policy = world(3, form)
    problem = problem_of(P, r, counts, 4)
    evidence = gather(problem, policy)
    margin = outside_margin(problem, evidence)
    rows = evidence.fitted.transitions.toarray().reshape(P.shape)
    paid = r[:, :, None] if r.ndim == 2 else r
    share = (problem.dropped / (problem.dropped + evidence.n)).reshape(S, A)
    for sign, size in ((-1.0, margin.down), (1.0, margin.up)):
        values = []
        for e in (0.0, 1e-6):
            value = np.zeros(S)
            for _ in range(4):
                kept = np.nansum(rows * (paid + 0.9 * value), axis=2)
                most = sign * np.nanmax(sign * paid, axis=None if r.ndim == 3 else 2)
                gain = np.maximum(
                    sign * (most + 0.9 * sign * (sign * value).max() - kept), 0.0
                )
                value = (policy * (kept + sign * e * share * gain)).sum(axis=1)
            values.append(value[0])
        assert_allclose(size, sign * (values[1] - values[0]) / 1e-6, rtol=1e-4)


@pytest.mark.parametrize("method", ["likelihood", "robust"])
@pytest.mark.parametrize("horizon", [None, 3])
def test_intervals_widen_by_the_band(method, horizon):
    P, r, counts, policy = world(7, "r(s, a)")
    problem = problem_of(P, r, counts, horizon)
    assert problem.dropped.tolist() == [EACH, 0, 0, EACH, 0, 0, 0, 0]
    kept = oee.Problem(problem.simulator, problem.counts, horizon=horizon)
    found, bare = (
        oee.interval(p, policy, method=method, radius="independent")
        for p in (problem, kept)
    )
    margin = outside_margin(problem, gather(problem, policy))
    assert_allclose(
        [found.lower, found.upper],
        [bare.lower - margin.down, bare.upper + margin.up],
        rtol=1e-9,
    )
    assert found.diagnostics["dropped_transitions"] == 2 * EACH
    assert 0.0 < found.diagnostics["dropped_share"] < 0.2
    assert outside_margin(kept, gather(kept, policy)) is None


def test_differences_know_of_them_and_other_methods_refuse():
    P, r, counts, policy = world(7, "r(s, a)")
    simulator = oee.FiniteMDP(P, r, 0, 0.9)
    problem = oee.Problem(simulator, sparse.csr_array(counts), impossible="drop")
    kept = oee.Problem(simulator, problem.counts)
    policies = {"one": policy, "other": policy[:, ::-1]}
    wide = compare_policies(problem, policies)
    narrow = compare_policies(kept, policies)
    assert (wide.values == narrow.values).all()
    off = ~np.eye(2, dtype=bool)
    assert (wide.lower < narrow.lower)[off].all()
    assert (wide.upper > narrow.upper)[off].all()
    assert_allclose(wide.lower, -wide.upper.T, atol=1e-12)
    for method in ("delta", "bootstrap"):
        with pytest.raises(
            ValueError,
            match=rf"^method must be 'likelihood' or 'robust' .*; it is '{method}'$",
        ):
            oee.interval(problem, policy, method=method)
    with pytest.raises(
        ValueError,
        match=(
            r"^lower_ratio and upper_ratio must be None if impossible transitions were"
        ),
    ):
        oee.interval(problem, policy, upper_ratio=2.0)


def test_a_problem_drops_what_it_says():
    P, r, counts, policy = world(1, "r(s, a)")
    simulator = oee.FiniteMDP(P, r, 0, 0.9)
    x, to = np.nonzero(counts)
    log = oee.Transitions(
        *(np.repeat(part, counts[x, to].astype(int)) for part in (x // A, x % A, to))
    )
    problem = oee.Problem(simulator, log, impossible="drop")
    assert len(problem.log) == counts.sum()
    assert problem.counts.sum() == counts.sum() - 2 * EACH
    assert str(problem.findings[0]).startswith(
        f"6 of the log's {counts.sum():g} transitions, in 2 state-action pairs"
    )
    one = str(moves_dropped(np.array([0.0, 1.0]), 9.0)[0])
    assert one.startswith(
        "1 of the log's 10 transitions, in 1 state-action pair, is impossible in the"
        " simulator"
    )
    report = oee.evaluate(problem, {"p": policy, "q": policy[:, ::-1]}, seed=0)
    for row in report.records():
        if row["estimator"] in ("oee", "model-based"):
            assert row["lower"] < row["value"] < row["upper"]
    with pytest.raises(ValueError, match=r"impossible='drop' leaves none$"):
        oee.Problem(
            simulator,
            oee.Transitions([0], [0], [np.flatnonzero(P[0, 0] == 0)[0]]),
            impossible="drop",
        )


@pytest.mark.parametrize(
    ("state", "action", "following", "share"),
    [
        # all that is known of (0, 0) is a transition that was dropped
        ([0, 1], [0, 0], [1, 2], 1.0),
        ([0, 0], [0, 0], [1, 0], 0.5),
        ([0, 1, 1], [0, 0, 0], [0, 2, 0], 0.0),  # dropped where the policy never is
    ],
)
def test_what_is_unseen_is_a_share(state, action, following, share):
    """State 0 is never left, so that its time counts once a dropped transition shows
    that it can be.
    """
    rows = [[[1.0, 0, 0]], [[0, 0.5, 0.5]], [[0, 0, 1.0]]]
    simulator = oee.FiniteMDP(rows, [0, 1.0, 2.0], [1.0, 0, 0], 0.9)
    problem = oee.Problem(
        simulator, oee.Transitions(state, action, following), impossible="drop"
    )
    found = compare_policies(problem, {"one": [0, 0, 0], "other": [0, 0, 0]})
    assert_allclose(found.unrecorded_share, share, rtol=1e-12)

"""Dropped moves: ends against every place that they may have led to, one by one."""

import itertools

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import sparse

import oee_tabular as oee
from oee_tabular.estimators.findings import moves_dropped
from oee_tabular.inference import compare_policies
from oee_tabular.inference.evidence import evidence_of, gather
from oee_tabular.inference.likelihood import profile_end
from oee_tabular.inference.margins import _ahead, stray_swing
from oee_tabular.inference.robust import extreme_value, radii

S, A, STRAYS, EACH = 4, 2, (0, 3), 3.0


def world(seed, form):
    """Two next states an action, counts of 15 moves each, and in two rows three moves to a state that is none of these."""
    rng = np.random.default_rng(seed)
    P = np.zeros((S, A, S))
    for s, a in itertools.product(range(S), range(A)):
        P[s, a, rng.choice(S, 2, replace=False)] = rng.dirichlet([1, 1])
    r = rng.normal(size=(S, A)) if form == "r(s, a)" else np.where(P > 0, rng.normal(size=P.shape), np.nan)
    rows = P.reshape(S * A, S)
    counts = np.array([rng.multinomial(15, row) for row in rows], dtype=float)
    for x in STRAYS:
        counts[x, np.flatnonzero(rows[x] == 0)[0]] = EACH
    return P, r, counts, rng.dirichlet([1, 1], size=S)


def led(P, r, counts, places, sign):
    """The model and the counts in which the strays of each row led to its place."""
    P, counts = P.reshape(S * A, S).copy(), np.where(P.reshape(S * A, S) > 0, counts, 0.0)
    for x, place in zip(STRAYS, places, strict=True):
        P[x] *= 0.7
        P[x, place] += 0.3
        counts[x, place] += EACH
    if r.ndim == 3:
        paid = np.where(np.isnan(r), sign * np.nanmax(sign * r), r)
        r = np.where(P.reshape(r.shape) > 0, paid, np.nan)
    return oee.FiniteMDP(P.reshape(S, A, S), r, 0, 0.9), sparse.csr_array(counts)


@pytest.mark.parametrize("horizon", [None, 4])
@pytest.mark.parametrize("form", ["r(s, a)", "r(s, a, s')"])
@pytest.mark.parametrize("method", ["likelihood", "robust"])
def test_each_end_is_the_most_extreme_of_all_places(method, form, horizon):
    for seed in range(3 if method == "likelihood" else 1):
        P, r, counts, policy = world(seed, form)
        problem = oee.Problem(oee.FiniteMDP(P, r, 0, 0.9), sparse.csr_array(counts), horizon=horizon, impossible="drop")
        found = oee.interval(problem, policy, method=method, radius="independent")
        for sign, end in ((-1.0, found.lower), (1.0, found.upper)):
            every = []
            for places in itertools.product(range(S), repeat=len(STRAYS)):
                model, moved = led(P, r, counts, places, sign)
                evidence = evidence_of(model, moved, horizon, policy)
                if method == "likelihood":
                    every.append(profile_end(evidence, 0.95, sign).value)
                else:
                    every.append(extreme_value(evidence, radii(evidence, 0.95, "independent"), sign).bound)
            assert_allclose(end, sign * max(sign * value for value in every), rtol=1e-9)


@pytest.mark.parametrize("horizon", [None, 3])
def test_wherever_they_led_the_value_of_the_frequencies_is_inside(horizon):
    P, r, counts, policy = world(7, "r(s, a)")
    simulator = oee.FiniteMDP(P, r, 0, 0.9)
    problem = oee.Problem(simulator, sparse.csr_array(counts), horizon=horizon, impossible="drop")
    assert problem.dropped.tolist() == [EACH, 0, 0, EACH, 0, 0, 0, 0]
    found, kept = oee.interval(problem, policy), oee.Problem(simulator, problem.counts, horizon=horizon)
    bare = oee.interval(kept, policy)
    assert found.lower < bare.lower < bare.upper < found.upper
    assert found.diagnostics["dropped_moves"] == 2 * EACH
    rng = np.random.default_rng(0)
    rows = gather(kept, policy).with_rows(gather(kept, policy).phat).transitions.toarray()
    share = (problem.dropped / (problem.dropped + problem.counts.sum(axis=1)))[:, None]
    for _ in range(200):
        target = (1 - share) * rows + share * rng.dirichlet(np.full(S, 0.1), size=S * A)
        value = oee.policy_value(simulator.with_transitions(target.reshape(P.shape)), policy, horizon=horizon)
        assert found.lower < value < found.upper


def value_of(P, r, policy, horizon):
    """V(0) at discount 0.95 by numpy alone."""
    kernel, pay = 0.95 * np.einsum("sa,sat->st", policy, P), (policy * r).sum(axis=1)
    if horizon is None:
        return np.linalg.solve(np.eye(S) - kernel, pay)[0]
    value = np.zeros(S)
    for _ in range(horizon):
        value = pay + kernel @ value
    return value[0]


@pytest.mark.parametrize("form", ["r(s, a)", "r(s, a, s')"])
@pytest.mark.parametrize("horizon", [None, 1, 2, 4])
def test_swings_reach_to_every_place_or_mixture_of_places(form, horizon):
    """Shares of two thirds: improving all places at once, over a horizon, stops before the extreme, or on the wrong side."""
    for seed in range(12):
        P, r, counts, policy = world(seed, form)
        counts[list(STRAYS)] = np.where(counts[list(STRAYS)] == EACH, 30.0, counts[list(STRAYS)])
        problem = oee.Problem(
            oee.FiniteMDP(P, r, 0, 0.95), sparse.csr_array(counts), horizon=horizon, impossible="drop"
        )
        evidence = gather(problem, policy)
        down, up = stray_swing(problem, evidence)
        rows = evidence.with_rows(evidence.phat).transitions.toarray()
        middle = oee.policy_value(oee.FiniteMDP(rows.reshape(P.shape), r, 0, 0.95), policy, horizon=horizon)
        share = problem.dropped / (problem.dropped + evidence.n)
        for sign, swing in ((-1.0, down), (1.0, up)):
            paid = r if r.ndim == 2 else np.where(np.isnan(r), sign * np.nanmax(sign * r), r)
            every = []
            for places in itertools.product([*np.eye(S), np.full(S, 1 / S)], repeat=len(STRAYS)):
                moved = rows.copy()
                for x, to in zip(STRAYS, places, strict=True):
                    moved[x] = (1 - share[x]) * rows[x] + share[x] * to
                moved = moved.reshape(P.shape)
                pay = paid if r.ndim == 2 else (moved * paid).sum(axis=2)
                every.append(sign * (value_of(moved, pay, policy, horizon) - middle))
            assert max(every) <= swing + 1e-9
            assert swing >= 0.0
            if horizon in (None, 1):
                assert_allclose(swing, max(every), rtol=1e-9, atol=1e-12)


def test_differences_know_of_them_and_other_methods_refuse():
    P, r, counts, policy = world(7, "r(s, a)")
    simulator = oee.FiniteMDP(P, r, 0, 0.9)
    problem = oee.Problem(simulator, sparse.csr_array(counts), impossible="drop")
    kept = oee.Problem(simulator, problem.counts)
    policies = {"one": policy, "other": policy[:, ::-1]}
    wide, narrow = compare_policies(problem, policies), compare_policies(kept, policies)
    assert (wide.values == narrow.values).all()
    off = ~np.eye(2, dtype=bool)
    assert (wide.lower < narrow.lower)[off].all()
    assert (wide.upper > narrow.upper)[off].all()
    assert_allclose(wide.lower, -wide.upper.T, atol=1e-12)
    for method in ("delta", "bootstrap"):
        with pytest.raises(ValueError, match=rf"^method must be 'likelihood' or 'robust' .*; it is '{method}'$"):
            oee.interval(problem, policy, method=method)
    with pytest.raises(ValueError, match=r"^lower_ratio and upper_ratio must be None where impossible moves were"):
        oee.interval(problem, policy, upper_ratio=2.0)


def test_a_problem_drops_what_it_says():
    P, r, counts, policy = world(1, "r(s, a)")
    simulator = oee.FiniteMDP(P, r, 0, 0.9)
    x, to = np.nonzero(counts)
    log = oee.Transitions(*(np.repeat(part, counts[x, to].astype(int)) for part in (x // A, x % A, to)))
    problem = oee.Problem(simulator, log, impossible="drop")
    assert len(problem.log) == counts.sum()
    assert problem.counts.sum() == counts.sum() - 2 * EACH
    told = [str(finding) for finding in problem.findings]
    assert told == [
        f"6 of the log's {counts.sum():g} moves, of 2 pairs of a state and an action, are impossible in the simulator and left "
        "out of every model. Likelihood intervals let these moves lead anywhere; all other intervals ignore them."
    ]
    one = str(moves_dropped(np.array([0.0, 1.0]), 9.0)[0])
    assert one.startswith(
        "1 of the log's 10 moves, of 1 pair of a state and an action, is impossible in the simulator and left"
    )
    report = oee.evaluate(problem, {"p": policy, "q": policy[:, ::-1]}, seed=0)
    for row in report.records():
        if row["estimator"] in ("oee", "model-based"):
            assert row["lower"] < row["value"] < row["upper"]
    with pytest.raises(ValueError, match=r"^impossible must be one of 'refuse', 'drop'; got 'allow' \(to allow "):
        oee.Problem(simulator, log, impossible="allow")
    with pytest.raises(ValueError, match=r"none is left where impossible is 'drop'$"):
        oee.Problem(simulator, oee.Transitions([0], [0], [np.flatnonzero(P[0, 0] == 0)[0]]), impossible="drop")


@pytest.mark.filterwarnings("ignore:horizon .* is followed to step")
def test_a_horizon_is_followed_as_far_as_the_discount_shows():
    simulator = oee.FiniteMDP([[[1, 0]], [[0.5, 0.5]]], [0, 1.0], [1, 0], 0.5)
    log = oee.Transitions([0, 0], [0, 0], [1, 0])
    endless, long = (oee.Problem(simulator, log, impossible="drop", horizon=T) for T in (10**12, 100))
    for sign, found in zip((-1, 1), stray_swing(endless, gather(endless, [0, 0])), strict=True):
        assert found == pytest.approx(stray_swing(long, gather(long, [0, 0]))[sign > 0], abs=1e-12)
    rows = np.array([0])
    ways = [_ahead(gather(p, [0, 0]).model, np.ones((2, 1)), rows, p.horizon) for p in (endless, long)]
    for one, other in zip(*ways, strict=True):
        assert_allclose(one, other, atol=1e-12)


@pytest.mark.parametrize(
    ("state", "action", "following", "share"),
    [
        ([0, 1], [0, 0], [1, 2], 1.0),  # all that is known of (0, 0) is a move that was dropped
        ([0, 0], [0, 0], [1, 0], 0.5),
        ([0, 1, 1], [0, 0, 0], [0, 2, 0], 0.0),  # dropped where the policy never is
    ],
)
def test_what_is_unseen_is_a_share(state, action, following, share):
    """State 0 is never left, so that its time counts once a dropped move shows that it can be."""
    rows = [[[1.0, 0, 0]], [[0, 0.5, 0.5]], [[0, 0, 1.0]]]
    simulator = oee.FiniteMDP(rows, [0, 1.0, 2.0], [1.0, 0, 0], 0.9)
    problem = oee.Problem(simulator, oee.Transitions(state, action, following), impossible="drop")
    found = compare_policies(problem, {"one": [0, 0, 0], "other": [0, 0, 0]})
    assert_allclose(found.unseen_share, share, rtol=1e-12)


def test_rows_that_were_never_recorded_count_in_full():
    simulator = oee.FiniteMDP([[[0, 0.5, 0.5]], [[0, 0, 1.0]], [[0, 0, 1.0]]], [0, 1.0, 0], [1.0, 0, 0], 0.5)
    problem = oee.Problem(simulator, oee.Transitions([1], [0], [2]))
    found = compare_policies(problem, {"one": [0, 0, 0], "other": [0, 0, 0]})
    assert_allclose(found.unseen_share, 0.8, rtol=1e-12)  # 1 of 1 + .25, in state 1, the time in 2 left out

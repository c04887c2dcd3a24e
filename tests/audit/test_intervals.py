"""What is sure, by brute force: likelihood intervals, changes of rows, compared policies, divergences and path bounds."""

import itertools

import numpy as np
import pytest
from audit.reference import Dense, sequences, table_of
from numpy.testing import assert_allclose
from scipy import optimize, special, stats

import oee_tabular as oee
from oee_tabular import inference
from oee_tabular.report.uncertainty import choose_interval
from oee_tabular.theory import kl_path_sides, normalised_sides, path_kl, unnormalised_sides


def tiny(seed, n_states=3, n_actions=2, discount=0.8, moves=25, left_out=(), form="sa"):
    rng = np.random.default_rng(seed)
    P = rng.dirichlet(np.full(n_states, 1.5), size=(n_states, n_actions))
    r = rng.normal(size=(n_states, n_actions, n_states)[: len(form)])
    simulator = oee.FiniteMDP(P, r, rng.dirichlet(np.ones(n_states)), discount)
    target = simulator.with_transitions(rng.dirichlet(np.full(n_states, 2.0), size=(n_states, n_actions)))
    share = np.ones((n_states, n_actions))
    share.reshape(-1)[list(left_out)] = 0.0
    log = oee.sample_transitions(target, share / share.sum(), moves, seed=seed)
    return simulator, target, log, rng.dirichlet(np.ones(n_actions), size=n_states)


@pytest.mark.parametrize(
    ("seed", "n_states", "n_actions", "left_out", "form"),
    [(0, 2, 2, [1], "sa"), (1, 2, 2, [0, 3], "sat"), (2, 3, 1, [1], "sat"), (3, 3, 1, [0], "sa")],
)
def test_the_interval_that_is_printed_by_brute_force_over_the_rows(seed, n_states, n_actions, left_out, form):
    simulator, _, log, policy = tiny(seed, n_states, n_actions, left_out=left_out, form=form)
    report = oee.evaluate(oee.Problem(simulator, log), policy, estimators=["oee"])
    found = report.results[0].estimate
    base, n = Dense(simulator), table_of(log, policy.shape)
    shape = n.shape

    def rows(x):
        raw = np.exp(x.reshape(shape) - x.reshape(shape).max(axis=2, keepdims=True))
        return raw / raw.sum(axis=2, keepdims=True)

    likeliest = n / np.maximum(n.sum(axis=2, keepdims=True), 1)

    def room(x):
        seen = n > 0
        logs = special.log_softmax(x.reshape(shape), axis=2)
        return stats.chi2.ppf(0.95, 1) / 2 - (n[seen] * (np.log(likeliest[seen]) - logs[seen])).sum()

    ends = []
    corners = [np.array(c) for c in itertools.product(range(n_states), repeat=len(left_out))]
    for sign in (-1, 1):
        best = -np.inf
        for corner in corners:  # J is linear in a single row, and its extreme is at a vertex of each free row

            def model(x, corner=corner):
                P = rows(x).reshape(-1, n_states)
                P[left_out] = np.eye(n_states)[corner]
                return base.like(P.reshape(shape))

            start = np.log(np.maximum(likeliest, 0.02)).reshape(-1)
            got = optimize.minimize(
                lambda x, model=model, sign=sign: -sign * model(x).J(policy), start, method="SLSQP",
                constraints=[{"type": "ineq", "fun": room}], options={"maxiter": 300, "ftol": 1e-12},
            )  # fmt: skip
            if room(got.x) > -1e-6:
                best = max(best, -got.fun)
        ends.append(sign * best)
    width = ends[1] - ends[0]
    assert_allclose(found.interval, (min(ends[0], found.value), max(ends[1], found.value)), atol=2e-3 * width)
    assert found.interval[0] <= found.value <= found.interval[1]


@pytest.mark.parametrize("episodes", [False, True])
def test_changes_of_rows_by_roots_of_their_own(episodes):
    simulator, target, log, policy = tiny(5, moves=400, left_out=[3])
    if episodes:
        log = oee.sample_episodes(target, policy, 40, 10, seed=0)
    found = inference.row_changes(oee.Problem(simulator, log), confidence=0.9)
    P, n = Dense(simulator).P, table_of(log, policy.shape)
    tested = (n.sum(axis=2) > 0).sum()
    level = 0.1 / tested
    for s, a in np.ndindex(policy.shape):
        total = n[s, a].sum()
        if total == 0:
            assert found.certain[s, a] == 0.0
            continue
        phat = n[s, a] / total
        if episodes:
            c = np.log(1 / level) + 2 * np.log(np.e * (1 + total / 2))
        else:
            c = optimize.brentq(lambda c: -c + 2 * np.log(np.e * c / 2) - np.log(level), 2.0 + 1e-9, 1e4)
        more = phat > P[s, a]
        f = phat[more].sum()

        def kl(p, f=f):
            rest = (1 - f) * np.log((1 - f) / (1 - p)) if f < 1 else 0.0
            return f * np.log(f / p) + rest

        smallest = optimize.brentq(lambda p, radius=c / total: kl(p) - radius, 1e-300, f)
        assert_allclose(found.certain[s, a], max(smallest - P[s, a][more].sum(), 0.0), atol=1e-9)
        assert_allclose(found.estimated[s, a], np.abs(phat - P[s, a]).sum() / 2, rtol=1e-12)
        seen = phat > 0
        assert_allclose(found.evidence[s, a], (n[s, a][seen] * np.log(phat[seen] / P[s, a][seen])).sum(), rtol=1e-9)
        j = int(np.abs(phat - P[s, a]).argmax())
        assert (found.next_state[s, a], found.simulated[s, a], found.observed[s, a]) == (
            j, pytest.approx(P[s, a, j]), pytest.approx(phat[j]),
        )  # fmt: skip
    assert found.tested == tested


@pytest.mark.parametrize("left_out", [[], [3]])
@pytest.mark.parametrize("horizon", [None, 5])
def test_compared_policies_by_the_variance_of_each_row_with_one_more_move(left_out, horizon):
    simulator, _, log, first = tiny(6, moves=60, left_out=left_out)
    second = np.random.default_rng(0).dirichlet([1.0, 1.0], size=3)
    policies = {"first": first, "second": second}
    found = inference.compare_policies(oee.Problem(simulator, log, horizon=horizon), policies, n_draws=200_000)
    base, n = Dense(simulator), table_of(log, first.shape)
    total = n.sum(axis=2, keepdims=True)
    model = base.like(np.where(total > 0, n / np.maximum(total, 1), base.P))
    law = (n + base.P) / (total + 1)
    values = [model.J(policies[name], horizon) for name in found.names]
    slopes = [model.slope(policies[name], horizon) for name in found.names]
    covariance = np.array(
        [
            [
                (
                    ((law * x * y).sum(axis=2) - (law * x).sum(axis=2) * (law * y).sum(axis=2))
                    / np.maximum(total[:, :, 0], 1)
                ).sum()
                for y in slopes
            ]
            for x in slopes
        ]
    )
    assert_allclose(found.values, values, rtol=1e-9)
    assert values[0] >= values[1]
    assert_allclose(found.covariance, covariance, rtol=1e-7)
    spread = np.sqrt(covariance[0, 0] + covariance[1, 1] - 2 * covariance[0, 1])
    gap = values[0] - values[1]
    assert_allclose(found.probability_best[0], stats.norm.cdf(gap / spread), atol=0.005)
    assert_allclose([found.lower[0, 1], found.upper[0, 1]], gap + spread * stats.norm.ppf([0.025, 0.975]), rtol=1e-7)
    time = model.visits(policies[found.names[0]], horizon)
    time = time if horizon is None else sum(time)
    assert_allclose(found.unseen_share[0], time[total[:, :, 0] == 0].sum() / time.sum(), rtol=1e-9)


@pytest.mark.parametrize("form", ["sa", "sat"])
def test_path_bounds_by_every_path(form):
    simulator, target, _, policy = tiny(8, 2, 2, form=form)
    model, truth, steps = Dense(simulator), Dense(target), 4
    own = []
    for t in range(steps + 1):
        kl = 0.0
        for chance, path in sequences(model, policy, t):
            kl += chance * sum(np.log(model.P[move] / truth.P[move]) for move in path)
        own.append(kl)
    assert_allclose(path_kl(target, simulator, policy, horizon=steps), own, rtol=1e-9, atol=1e-14)
    shift = int(form == "sat")
    size = np.abs(model.r).max()
    error = abs(model.J(policy, steps) - truth.J(policy, steps))
    g, eta = model.g, np.abs(model.P - truth.P).sum(axis=2).max()
    bounds = {
        kl_path_sides: sum(g**t * min(2.0, np.sqrt(2 * own[t + shift])) for t in range(steps)),
        normalised_sides: sum(g**t * min(2.0, (t + shift) * eta) for t in range(steps)),
        unnormalised_sides: sum(g**t * ((1 + eta) ** (t + shift) - 1) for t in range(steps)),
    }
    for sides, bound in bounds.items():
        found = sides(target, simulator, policy, horizon=steps)
        assert_allclose([found.left, found.right], [error, size * bound], rtol=1e-9)
        assert found.holds


@pytest.mark.parametrize("value", [1.0 + 5e-10, -5e-10, 0.4])
def test_a_value_at_an_end_of_the_interval_but_for_rounding_stays_and_the_end_goes_with_it(value):
    estimate = oee.Estimate(value, model_value=value)
    sure = inference.Interval(0.0, 1.0, 0.95, "likelihood", {})
    found = choose_interval(estimate, sure, 0.95)
    assert found.value == value
    assert found.interval == (min(0.0, value), max(1.0, value))

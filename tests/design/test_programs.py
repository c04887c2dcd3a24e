"""Plans of data collection by own programs on three states: the cost of a row, the best shares, the errors foretold."""

import numpy as np
import pytest
from helpers import Dense
from numpy.testing import assert_allclose
from scipy import optimize

import oee_tabular as oee

pytestmark = pytest.mark.filterwarnings("ignore:Values in x were outside bounds:RuntimeWarning")  # SLSQP of older scipy


def three(seed=0):
    rng = np.random.default_rng(seed)
    simulator = oee.FiniteMDP(rng.dirichlet(np.ones(3), size=(3, 2)), rng.normal(size=(3, 2)), [0.5, 0.3, 0.2], 0.8)
    policies = {name: rng.dirichlet([2.0, 2.0], size=3) for name in ("one", "two")}
    return simulator, policies


def costs_of(base, policy, horizon=None):
    """c_x = Var_{s'}[dJ / dP(s' | x)]."""
    slope = base.slope(policy, horizon)
    return (base.P * slope**2).sum(axis=2) - (base.P * slope).sum(axis=2) ** 2


def best_shares(costs, before, n, flow=None):
    """argmin over q of max_k sum c_k / (before + n q) / least_k, q a distribution, with flow(q) = 0 where given."""
    size = before.size
    rules = [{"type": "eq", "fun": lambda q: q.sum() - 1.0}] if flow is None else [{"type": "eq", "fun": flow}]

    def solve(list_of_costs, least):
        ends = [
            {"type": "ineq", "fun": lambda x, c=c, v=v: x[-1] - (c / (before + n * np.maximum(x[:-1], 1e-9))).sum() / v}
            for c, v in zip(list_of_costs, least, strict=True)
        ]
        whole = [{"type": "eq", "fun": lambda x, rule=rule: rule["fun"](x[:-1])} for rule in rules]
        start = np.append(np.full(size, 1 / size), 5.0)
        found = optimize.minimize(
            lambda x: x[-1], start, method="SLSQP", bounds=[(1e-9, 1)] * size + [(0, None)],
            constraints=[*ends, *whole], options={"ftol": 1e-13, "maxiter": 2000},
        )  # fmt: skip
        return found.x[:-1], found.x[-1]

    def scale(c):
        return (c / (before + n / size)).sum()

    least = [solve([c], [scale(c)])[1] * scale(c) for c in costs]
    return (*solve(costs, least), least)


def collected(base, restart):
    """q(s') - (1 - b) mu - b sum q P: 0 for what a behaviour policy records that starts again with probability 1 - b."""

    def flow(q):
        q = q.reshape(base.P.shape[:2])
        return q.sum(axis=1) - restart * base.mu - (1 - restart) * np.einsum("sa,sat->t", q, base.P)

    return flow


@pytest.mark.parametrize("sampling", ["free", "behavior"])
@pytest.mark.parametrize(
    ("counts", "number", "solver"),
    [(0, 1, "frank_wolfe"), (40, 1, "frank_wolfe"), (0, 2, "frank_wolfe"), (40, 2, "frank_wolfe"), (0, 2, "CLARABEL")],
)
def test_a_plan_is_the_least_of_its_own_program(sampling, counts, number, solver):
    simulator, policies = three()
    policies = dict(list(policies.items())[:number])
    base, n = Dense(simulator), 200
    given, before = simulator, np.zeros(6)
    if counts:
        log = oee.sample_transitions(simulator, [[0.5, 0.1], [0.1, 0.1], [0.1, 0.1]], counts, seed=0)
        given = oee.Problem(simulator, log)
        np.add.at(before, log.state * 2 + log.action, 1.0)
    plan = oee.plan_data_collection(given, policies, n=n, sampling=sampling, model="simulator", solver=solver)
    costs = [costs_of(base, policy).reshape(-1) for policy in policies.values()]
    for name, own in zip(policies, costs, strict=True):
        assert_allclose(plan.costs[name].reshape(-1), own, rtol=1e-9)
    flow = collected(base, 0.2) if sampling == "behavior" else None
    _, worst, least = best_shares(costs, before, n, flow)
    q = plan.distribution.reshape(-1)
    if flow is not None:
        assert_allclose(flow(q), 0.0, atol=1e-9)
        assert plan.restart == pytest.approx(0.2)
    assert_allclose(q.sum(), 1.0, rtol=1e-9)
    assert_allclose(plan.inefficiency, worst, rtol=3e-3)
    assert plan.gap < 2e-3
    for outlook, own, alone in zip(plan.policies, costs, least, strict=True):
        after = (own / (before + n * q)).sum()
        assert_allclose(outlook.variance_after, after, rtol=1e-6)
        assert_allclose(outlook.inefficiency, after / alone, rtol=3e-3)
        now = (own / before).sum() if (before > 0).all() else np.inf
        assert_allclose(outlook.variance_now, now, rtol=1e-9)
        free = best_shares([own], before, n)[2][0]
        assert_allclose(outlook.free_inefficiency, after / free, rtol=3e-3)
        assert_allclose(outlook.width[1], 2 * 1.959963984540054 * np.sqrt(after), rtol=1e-6)
        later = plan.after(1000)[outlook.name].variance_after
        assert_allclose(later, (own / (before + 1000 * q)).sum(), rtol=1e-6)


@pytest.mark.parametrize("discount", [0.8, 1.0])
def test_over_a_horizon_the_sum_over_time_stands_inside_the_variance(discount):
    simulator, policies = three(2)
    simulator = simulator.with_discount(discount)
    plan = oee.plan_data_collection(simulator, policies["one"], n=50, horizon=4, model="simulator")
    own = costs_of(Dense(simulator), policies["one"], 4)
    assert_allclose(plan.costs["policy"], own, rtol=1e-9)
    assert_allclose(plan.expected_standard_error[1], np.sqrt(own).sum() / np.sqrt(50), rtol=1e-9)  # Neyman's


@pytest.mark.parametrize(("lower", "upper"), [(0.5, 2.0), (0.0, 1.05), (0.9, 4.0)])
def test_a_row_without_spread_costs_its_largest_plausible_variance(lower, upper):
    """By brute force over the corners of the box and the edges between them."""
    P = np.array([[[1.0, 0.0, 0.0], [0.2, 0.5, 0.3]], [[0.0, 1.0, 0.0], [0.3, 0.3, 0.4]], [[0.5, 0.0, 0.5]] * 2])
    simulator = oee.FiniteMDP(P, np.array([0.0, 1.0, -2.0]), [0.4, 0.3, 0.3], 0.8)
    policy = np.full((3, 2), 0.5)
    plan = oee.plan_data_collection(simulator, policy, n=100, model="simulator", lower_ratio=lower, upper_ratio=upper)
    slope = Dense(simulator).slope(policy)
    for s in (0, 1):
        R = 0.9 * P[s, 0] + 0.05 * P[s].mean(axis=0) + 0.05 * np.eye(3)[s]
        low, high = lower * R, np.minimum(upper * R, 1.0)
        best, order = 0.0, np.argsort(high - low)  # the widest entry is what the other two leave
        low, high, g = low[order], high[order], slope[s, 0][order]
        for x in np.linspace(low[0], high[0], 401):
            least, most = max(low[1], 1 - x - high[2]), min(high[1], 1 - x - low[2])
            if least <= most:
                y = np.linspace(least, most, 401)
                p = np.array([np.full(401, x), y, 1 - x - y])
                best = max(best, (g**2 @ p - (g @ p) ** 2).max())
        assert plan.optimistic[s, 0]
        assert_allclose(plan.costs["policy"][s, 0], best, rtol=1e-3)
    assert not plan.optimistic[2].any()


@pytest.mark.parametrize("costs_a_move", [False, True])
def test_a_behaviour_plan_where_episodes_end(costs_a_move):
    """Entering the absorbing state leads to a start, at once or by one recorded move more."""
    rng = np.random.default_rng(4)
    P = rng.dirichlet(np.ones(3), size=(3, 2))
    P[2] = [0.0, 0.0, 1.0]
    simulator = oee.FiniteMDP(P, np.array([1.0, -1.0, 0.0]), [0.6, 0.4, 0.0], 0.8)
    policy, n = np.array([[0.7, 0.3], [0.2, 0.8], [0.5, 0.5]]), 100
    plan = oee.plan_data_collection(
        simulator, policy, n=n, sampling="behavior", model="simulator", restart=0.3, restart_costs_a_move=costs_a_move
    )
    base = Dense(simulator)
    own = costs_of(base, policy).reshape(-1)
    led = P.copy()
    if costs_a_move:
        led[2] = base.mu
    else:
        led[:, :, :2] += P[:, :, 2:] * base.mu[:2]
        led[:, :, 2] = 0.0
    q = plan.distribution.reshape(-1)
    flow = collected(base.like(led), 0.3)
    assert_allclose(flow(q), 0.0, atol=1e-9)
    assert q[4:].sum() > 0 if costs_a_move else q[4:].sum() < 1e-12
    used = np.array([0, 1, 2, 3, 4, 5]) if costs_a_move else np.arange(4)

    def spent(x):
        return flow(np.pad(x, (0, 6 - len(used))))[: len(used) // 2]

    _, _, least = best_shares([own[used]], np.zeros(len(used)), n, spent)
    assert_allclose(plan.policies[0].variance_after, least[0], rtol=3e-3)


def test_the_next_pairs_are_the_largest_falls_one_after_another():
    simulator, policies = three(3)
    log = oee.sample_transitions(simulator, [[0.5, 0.1], [0.2, 0.1], [0.1, 0.0]], 30, seed=0)
    plan = oee.plan_data_collection(oee.Problem(simulator, log), policies["one"], n=8, model="simulator")
    cost, counts = costs_of(Dense(simulator), policies["one"]), np.zeros((3, 2))
    np.add.at(counts, (log.state, log.action), 1.0)
    own, z = [], 1.959963984540054
    for _ in range(8):
        error = np.sqrt(sum(cost[x] / counts[x] for x in np.ndindex(3, 2) if counts[x]))
        falls = {
            x: z * cost[x] / counts[x] / (counts[x] + 1) / error if counts[x] else 2 * z * np.sqrt(cost[x])
            for x in np.ndindex(3, 2)
        }
        own.append(max(falls, key=falls.get))
        counts[own[-1]] += 1
    assert list(plan.next_pairs) == own

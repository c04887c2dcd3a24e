"""Planned data collection: closed forms, certificates, known figures, bad calls."""

import numpy as np
import pytest
from helpers import Dense, random_mdp, random_policy, rngs
from hypothesis import given, settings
from numpy.testing import assert_allclose
from scipy import optimize

import oee_tabular as oee
from oee_tabular import FiniteMDP, Problem, Transitions, plan_data_collection
from oee_tabular.design import programs
from oee_tabular.design.programs import collection_mdp
from oee_tabular.tasks.gridworld import gridworld_policy

few = settings(max_examples=25, deadline=None)


def small_grid(slip):
    """A 5 x 5 grid, slip .3 for .1."""
    base = oee.tasks.gridworld(5, slip, discount=0.95)
    row, column = np.divmod(np.arange(25), 5)
    return FiniteMDP(base.transitions, (row + column - 8) / 8, base.initial, 0.95)


SIMULATOR = small_grid(0.3)
TARGET = small_grid(0.1)
POLICY = gridworld_policy(5, 0.5)
THREE = {f"delta {d}": gridworld_policy(5, d) for d in (0.1, 0.5, 0.9)}


def log_of(mdp, counts):
    """A log with these counts (S, A), every move to the likeliest next state."""
    pairs = np.repeat(np.arange(counts.size), counts.reshape(-1))
    likeliest = np.argmax(mdp.transitions.toarray(), axis=1)
    return Transitions(pairs // mdp.n_actions, pairs % mdp.n_actions, likeliest[pairs])


def variances(plan, q):
    """Of each policy, after the plan's n transitions distributed as q (S, A)."""
    total = plan.counts + plan.n * q
    with np.errstate(divide="ignore"):
        return np.array(
            [
                np.divide(c, total, out=np.zeros_like(c), where=c > 0).sum()
                for c in plan.costs.values()
            ]
        )


def inefficiency(plan, q):
    """The largest of the policies', as the plan counts it."""
    least = np.array([o.variance_after / o.inefficiency for o in plan.policies])
    return np.max(variances(plan, q)[least > 0] / least[least > 0], initial=0.0)


def deterministic_chain():
    """0 -> 1 -> 2 by action 0, action 1 stays; 2 is the end; state 0 pays -1, state 1
    pays -2.
    """
    transitions = np.zeros((3, 2, 3))
    transitions[0, 0, 1] = transitions[1, 0, 2] = transitions[0, 1, 0] = transitions[
        1, 1, 1
    ] = transitions[2, :, 2] = 1
    return FiniteMDP(transitions, [-1.0, -2.0, 0.0], [1.0, 0.0, 0.0], 0.9)


def test_deterministic_rows_have_an_optimistic_cost():
    """State 0, action 0: the other action would stay in 0. V = (-2.8, -2, 0): range
    0.8, d = 0.1, gamma / (1 - gamma) = 9.
    """
    chain = deterministic_chain()
    ahead = np.array([[1.0, 0.0]] * 3)
    plan = plan_data_collection(chain, ahead, n=100)
    assert plan.optimistic.tolist() == [[True, True], [True, True], [False, False]]
    assert_allclose(plan.costs["policy"][0], [81 * 0.1**2 * 0.8**2 / 4, 0.0], rtol=1e-9)
    assert_allclose(
        plan.costs["policy"][1], [81 * 0.09**2 * 2.0**2 / 4, 0.0], rtol=1e-9
    )
    assert_allclose(plan.distribution[:2, 0], np.array([0.8, 1.8]) / 2.6, rtol=1e-9)
    assert "worst variance assumed" in str(plan)
    without = plan_data_collection(chain, ahead, n=100, optimistic=False)
    assert without.status.startswith("nothing to learn")
    assert without.expected_width == (0.0, 0.0)
    assert without.next_pairs == ()
    assert (
        plan_data_collection(chain, ahead, n=9, sampling="behavior", optimistic=False)
        .distribution[2]
        .sum()
        == 0
    )
    # R(. | 0, 0) = 0.975 on state 1 (the mean of both actions gives 0.05 / 2), 0.075 on
    # state 0; at most 2 R
    boxed = plan_data_collection(chain, ahead, n=100, upper_ratio=2.0, lower_ratio=0.5)
    assert_allclose(
        boxed.costs["policy"][0, 0], 81 * 0.1**2 * 0.8**2 * 0.15 * 0.85, rtol=1e-9
    )


def test_optimism_fades_with_observations():
    chain = deterministic_chain()
    ahead = np.array([[1.0, 0.0]] * 3)
    previous = np.inf
    for number in (1, 10, 100, 1000):
        counts = np.zeros((3, 2), dtype=int)
        counts[0, 0] = number
        plan = plan_data_collection(Problem(chain, log_of(chain, counts)), ahead, n=50)
        surprise = min(0.5, 1 - 0.05 ** (1 / number))
        assert_allclose(
            plan.costs["policy"][0, 0],
            0.81 * 0.8**2 * surprise * (1 - surprise),
            rtol=1e-9,
        )
        assert plan.costs["policy"][0, 0] < previous
        previous = plan.costs["policy"][0, 0]
    assert plan.distribution[0, 0] == 0.0
    # at least R / 2 = 0.0375 on state 0, however often it was not seen
    boxed = plan_data_collection(
        Problem(chain, log_of(chain, counts)),
        ahead,
        n=50,
        lower_ratio=0.5,
        upper_ratio=2.0,
    )
    assert_allclose(
        boxed.costs["policy"][0, 0], 0.81 * 0.8**2 * 0.0375 * 0.9625, rtol=1e-9
    )


def test_rewards_of_transitions_that_the_simulator_lacks():
    """r(s, a, s') of another action's move is that action's; that of staying, the row's
    own mean.
    """
    transitions = np.zeros((3, 2, 3))
    transitions[0, 0, 1] = transitions[0, 1, 2] = 1.0
    transitions[1:, :, :] = np.eye(3)[1:, None, :]
    rewards = np.full((3, 2, 3), np.nan)
    rewards[0, 0, 1] = 1.0
    rewards[0, 1, 2] = 5.0
    rewards[1, :, 1] = 0.0
    rewards[2, :, 2] = 0.0
    chain = FiniteMDP(transitions, rewards, [1.0, 0.0, 0.0], 0.5)
    plan = plan_data_collection(chain, np.array([[1.0, 0.0]] * 3), n=5)
    # G = r + gamma V: 1 for the own move, 5 for the other action's, 1 + 0.5 * 1 for
    # staying
    assert_allclose(plan.costs["policy"][0], [(5.0 - 1.0) ** 2 / 4, 0.0])


@pytest.mark.parametrize("pay", [-1.0, 0.3, 1e9])
def test_a_value_that_no_transition_changes_needs_none(pay):
    """Every move of the first step pays the same: what is left of its variance is
    rounding.
    """
    rows = np.full((3, 2, 3), 1 / 3)
    simulator = oee.FiniteMDP(rows, np.full((3, 2, 3), pay), [1, 0, 0], 1.0)
    log = oee.Transitions([0, 0, 0, 1, 2], [0, 0, 0, 1, 1], [1, 2, 2, 0, 1])
    problem = oee.Problem(simulator, log, horizon=1)
    policy = np.full((3, 2), 0.5)
    assert (
        oee.plan_data_collection(problem, policy, n=5).advice
        == "More transitions would not narrow it."
    )


@given(rngs)
@settings(max_examples=15, deadline=None)
def test_a_report_and_a_plan_give_one_piece_of_advice(rng):
    simulator = random_mdp(rng)
    policies = {name: random_policy(rng, simulator) for name in "ab"}
    share = np.full((simulator.n_states, simulator.n_actions), 1.0)
    share[0, 0] = 0.0 if share.size > 1 else 1.0
    log = oee.sample_transitions(
        simulator, share / share.sum(), int(rng.integers(1, 200)), seed=1
    )
    problem = oee.Problem(simulator, log)
    said = oee.evaluate(
        problem, policies, estimators=["simulator"], quick=True
    ).uncertainty.next
    for sampling in ("free", "behavior"):
        plan = oee.plan_data_collection(problem, policies, n=50, sampling=sampling)
        assert plan.advice == said
        assert said in str(plan)


@given(rngs)
@few
def test_every_plan_keeps_its_certificate(rng):
    """Both solvers; no other behaviour, nor uniform and on-policy sampling, is better
    than the gap admits.
    """
    mdp = random_mdp(rng)
    policies = {str(k): random_policy(rng, mdp) for k in range(int(rng.integers(1, 4)))}
    counts = rng.integers(0, 3, (mdp.n_states, mdp.n_actions))
    known = Problem(mdp, log_of(mdp, counts)) if counts.any() else mdp
    world = collection_mdp(mdp, 1 - mdp.discount)
    behaviors = [
        oee.uniform_policy(mdp),
        *policies.values(),
        *(random_policy(rng, mdp) for _ in range(4)),
    ]
    others = [oee.occupancy(world, pi) for pi in behaviors]
    for sampling in ("free", "behavior"):
        options = {"n": 30, "sampling": sampling, "model": "simulator"}
        plans = [
            plan_data_collection(known, policies, solver=x, **options)
            for x in ("auto", "CLARABEL")
        ]
        assert plans[0].gap < 1e-3
        if plans[0].status.startswith("nothing"):
            continue
        assert_allclose(plans[1].inefficiency, plans[0].inefficiency, rtol=3e-3)
        uniform = [np.full(counts.shape, 1 / counts.size)] if sampling == "free" else []
        for plan in plans:
            assert_allclose(plan.distribution.sum(), 1.0, rtol=1e-9)
            assert_allclose(
                variances(plan, plan.distribution),
                [o.variance_after for o in plan.policies],
                rtol=1e-9,
            )
            assert plan.inefficiency == pytest.approx(
                inefficiency(plan, plan.distribution), rel=1e-9
            )
            for q in (*others, *uniform):
                assert plan.inefficiency * (1 - plan.gap) <= inefficiency(plan, q) * (
                    1 + 1e-9
                )


def test_sequential_use():
    """Recording what a plan says leads to the error that it foretold, and a plan in two
    halves is the plan of the whole.
    """
    first = plan_data_collection(SIMULATOR, POLICY, n=4000)
    problem = Problem(SIMULATOR, log_of(SIMULATOR, first.allocation))
    second = plan_data_collection(problem, POLICY, n=4000, model="simulator")
    assert second.unrecorded == 0
    assert_allclose(second.expected_width[0], first.expected_width[1], rtol=1e-3)
    assert_allclose(
        second.expected_width[1], first.expected_width[1] / np.sqrt(2), rtol=1e-3
    )
    assert_allclose(second.distribution, first.distribution, atol=1e-3)
    assert_allclose(
        second.after(4000)["policy"].variance_after,
        second.policies[0].variance_after,
        rtol=1e-12,
    )
    assert_allclose(
        second.after(16_000)["policy"].width[1],
        second.expected_width[0] / np.sqrt(5),
        rtol=1e-3,
    )
    three = plan_data_collection(problem, THREE, n=4000, sampling="behavior")
    assert three.gap < 0.01
    assert three.model == "the estimate from the log"
    assert three.expected_width[1] < three.expected_width[0] < np.inf


def test_what_is_expected_of_a_plan_is_the_least_certain_policy_s():
    plan = plan_data_collection(SIMULATOR, THREE, n=500)
    for expected, ends in (
        (plan.expected_standard_error, [o.standard_error for o in plan.policies]),
        (plan.expected_width, [o.width for o in plan.policies]),
    ):
        assert len({after for _, after in ends}) == 3
        assert expected == tuple(map(max, zip(*ends, strict=True)))


def test_rows_that_the_log_lacks_come_first():
    counts = np.full((25, 4), 50)
    counts[7] = 0
    problem = Problem(SIMULATOR, log_of(SIMULATOR, counts))
    plan = plan_data_collection(problem, POLICY, n=100, model="simulator")
    assert plan.unrecorded == 4
    assert {s for s, _ in plan.next_pairs[:4]} == {7}
    assert plan.distribution[7].sum() > 0.25
    assert "pairs that matter and were never recorded: 4" in str(plan)
    assert "inf" in str(plan)


def test_a_plan_without_a_good_certificate_says_so(monkeypatch):
    monkeypatch.setattr(programs, "MAX_NEWTON_STEPS", 1)
    plan = plan_data_collection(SIMULATOR, THREE, n=10, sampling="behavior")
    assert plan.status.startswith("not finished: another plan may be better by up to")
    assert plan.status in str(plan)


def test_a_state_that_only_the_model_never_leaves():
    """It is still to be tested there, and an episode does not end in it."""
    rows = SIMULATOR.transitions.toarray().reshape(25, 4, 25)
    rows[6] = 0.0
    rows[6, :, 6] = 1.0
    rows[24] = np.eye(25)[24]
    wide = SIMULATOR.with_transitions(
        0.5 * rows + 0.5 * SIMULATOR.transitions.toarray().reshape(25, 4, 25)
    )
    stuck = SIMULATOR.with_transitions(rows)
    plan = plan_data_collection(wide, POLICY, n=50, sampling="behavior", model=stuck)
    assert plan.optimistic[6].all()
    assert plan.costs["policy"][6].min() > 0
    assert plan.distribution[6].min() > 0
    assert plan.gap < 0.01


# ---- plans of data collection by own programs on three states: the cost of a row, the
# best shares, the errors foretold SLSQP of older scipy
pytestmark = pytest.mark.filterwarnings(
    "ignore:Values in x were outside bounds:RuntimeWarning"
)


def three(seed=0):
    rng = np.random.default_rng(seed)
    simulator = oee.FiniteMDP(
        rng.dirichlet(np.ones(3), size=(3, 2)),
        rng.normal(size=(3, 2)),
        [0.5, 0.3, 0.2],
        0.8,
    )
    policies = {name: rng.dirichlet([2.0, 2.0], size=3) for name in ("one", "two")}
    return simulator, policies


def costs_of(base, policy, horizon=None):
    """c_x = Var_{s'}[dJ / dP(s' | x)]."""
    slope = base.slope(policy, horizon)
    return (base.P * slope**2).sum(axis=2) - (base.P * slope).sum(axis=2) ** 2


def best_shares(costs, before, n, flow=None):
    """argmin over q of max_k sum c_k / (before + n q) / least_k, q a distribution, with
    flow(q) = 0 where given.
    """
    size = before.size
    rules = (
        [{"type": "eq", "fun": lambda q: q.sum() - 1.0}]
        if flow is None
        else [{"type": "eq", "fun": flow}]
    )

    def solve(list_of_costs, least):
        ends = [
            {
                "type": "ineq",
                "fun": lambda x, c=c, v=v: (
                    x[-1] - (c / (before + n * np.maximum(x[:-1], 1e-9))).sum() / v
                ),
            }
            for c, v in zip(list_of_costs, least, strict=True)
        ]
        whole = [
            {"type": "eq", "fun": lambda x, rule=rule: rule["fun"](x[:-1])}
            for rule in rules
        ]
        start = np.append(np.full(size, 1 / size), 5.0)
        found = optimize.minimize(
            lambda x: x[-1],
            start,
            method="SLSQP",
            bounds=[(1e-9, 1)] * size + [(0, None)],
            constraints=[*ends, *whole],
            options={"ftol": 1e-13, "maxiter": 2000},
        )
        return found.x[:-1], found.x[-1]

    def scale(c):
        return (c / (before + n / size)).sum()

    least = [solve([c], [scale(c)])[1] * scale(c) for c in costs]
    return (*solve(costs, least), least)


def collected(base, restart):
    """q(s') - (1 - b) mu - b sum q P: 0 for what a behaviour policy records that starts
    again with probability 1 - b.
    """

    def flow(q):
        q = q.reshape(base.P.shape[:2])
        return (
            q.sum(axis=1)
            - restart * base.mu
            - (1 - restart) * np.einsum("sa,sat->t", q, base.P)
        )

    return flow


@pytest.mark.parametrize("sampling", ["free", "behavior"])
@pytest.mark.parametrize(
    ("counts", "number", "solver"),
    [
        (0, 1, "auto"),
        (40, 1, "auto"),
        (0, 2, "auto"),
        (40, 2, "auto"),
        (0, 2, "CLARABEL"),
    ],
)
def test_a_plan_is_the_least_of_its_own_program(sampling, counts, number, solver):
    simulator, policies = three()
    policies = dict(list(policies.items())[:number])
    base = Dense(simulator)
    n = 200
    given = simulator
    before = np.zeros(6)
    if counts:
        log = oee.sample_transitions(
            simulator, [[0.5, 0.1], [0.1, 0.1], [0.1, 0.1]], counts, seed=0
        )
        given = oee.Problem(simulator, log)
        np.add.at(before, log.state * 2 + log.action, 1.0)
    plan = oee.plan_data_collection(
        given, policies, n=n, sampling=sampling, model="simulator", solver=solver
    )
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
        assert_allclose(
            outlook.width[1], 2 * 1.959963984540054 * np.sqrt(after), rtol=1e-6
        )
        later = plan.after(1000)[outlook.name].variance_after
        assert_allclose(later, (own / (before + 1000 * q)).sum(), rtol=1e-6)


@pytest.mark.parametrize("discount", [0.8, 1.0])
def test_over_a_horizon_the_sum_over_time_stands_inside_the_variance(discount):
    simulator, policies = three(2)
    simulator = simulator.with_discount(discount)
    plan = oee.plan_data_collection(
        simulator, policies["one"], n=50, horizon=4, model="simulator"
    )
    own = costs_of(Dense(simulator), policies["one"], 4)
    assert_allclose(plan.costs["policy"], own, rtol=1e-9)
    # Neyman's
    assert_allclose(
        plan.expected_standard_error[1], np.sqrt(own).sum() / np.sqrt(50), rtol=1e-9
    )
    assert plan.allocation.sum() == 50
    assert (plan.allocation >= np.floor(50 * plan.distribution)).all()
    planned = oee.plan_data_collection(
        simulator,
        policies["one"],
        n=50,
        horizon=4,
        model="simulator",
        sampling="behavior",
    )
    # 1 / T, or 1 - discount
    assert_allclose(planned.restart, 0.25 if discount == 1.0 else 0.2)


@given(rngs)
@few
def test_a_bound_by_lagrange_holds_at_any_multipliers(rng):
    mdp = random_mdp(rng)
    world = collection_mdp(mdp, 0.3)
    n_pairs = mdp.n_states * mdp.n_actions
    program = programs.Program(
        rng.uniform(0, 1, (2, n_pairs)), np.full(n_pairs, 0.1), world
    )
    flow, right = program.equations()
    v = rng.normal(size=mdp.n_states)
    share = rng.uniform()
    prices = flow.T @ v
    # where it is free to record there is nothing to learn
    program.costs[:, prices.argmin()] = 0.0
    bound = program.lower_bound(np.array([share, 1 - share]), prices, float(right @ v))
    q = oee.occupancy(world, random_policy(rng, mdp)).reshape(-1)
    assert bound <= programs.sum_variances(program.costs, program.base, q).max() + 1e-9


@pytest.mark.parametrize(("lower", "upper"), [(0.5, 2.0), (0.0, 1.05), (0.9, 4.0)])
def test_a_row_without_spread_costs_its_largest_plausible_variance(lower, upper):
    """By brute force over the corners of the box and the edges between them."""
    P = np.array(
        [
            [[1.0, 0.0, 0.0], [0.2, 0.5, 0.3]],
            [[0.0, 1.0, 0.0], [0.3, 0.3, 0.4]],
            [[0.5, 0.0, 0.5]] * 2,
        ]
    )
    simulator = oee.FiniteMDP(P, np.array([0.0, 1.0, -2.0]), [0.4, 0.3, 0.3], 0.8)
    policy = np.full((3, 2), 0.5)
    plan = oee.plan_data_collection(
        simulator,
        policy,
        n=100,
        model="simulator",
        lower_ratio=lower,
        upper_ratio=upper,
    )
    slope = Dense(simulator).slope(policy)
    for s in (0, 1):
        R = 0.9 * P[s, 0] + 0.05 * P[s].mean(axis=0) + 0.05 * np.eye(3)[s]
        low = lower * R
        high = np.minimum(upper * R, 1.0)
        # the widest entry is what the other two leave
        best = 0.0
        order = np.argsort(high - low)
        low = low[order]
        high = high[order]
        g = slope[s, 0][order]
        for x in np.linspace(low[0], high[0], 401):
            least = max(low[1], 1 - x - high[2])
            most = min(high[1], 1 - x - low[2])
            if least <= most:
                y = np.linspace(least, most, 401)
                p = np.array([np.full(401, x), y, 1 - x - y])
                best = max(best, (g**2 @ p - (g @ p) ** 2).max())
        assert plan.optimistic[s, 0]
        assert_allclose(plan.costs["policy"][s, 0], best, rtol=1e-3)
    assert not plan.optimistic[2].any()


@pytest.mark.parametrize("costs_a_move", [False, True])
def test_a_behaviour_plan_where_episodes_end(costs_a_move):
    """Entering the absorbing state leads to a start, at once or by one recorded move
    more.
    """
    rng = np.random.default_rng(4)
    P = rng.dirichlet(np.ones(3), size=(3, 2))
    P[2] = [0.0, 0.0, 1.0]
    simulator = oee.FiniteMDP(P, np.array([1.0, -1.0, 0.0]), [0.6, 0.4, 0.0], 0.8)
    policy = np.array([[0.7, 0.3], [0.2, 0.8], [0.5, 0.5]])
    n = 100
    plan = oee.plan_data_collection(
        simulator,
        policy,
        n=n,
        sampling="behavior",
        model="simulator",
        restart=0.3,
        restart_costs_a_move=costs_a_move,
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
    log = oee.sample_transitions(
        simulator, [[0.5, 0.1], [0.2, 0.1], [0.1, 0.0]], 30, seed=0
    )
    plan = oee.plan_data_collection(
        oee.Problem(simulator, log), policies["one"], n=8, model="simulator"
    )
    cost = costs_of(Dense(simulator), policies["one"])
    counts = np.zeros((3, 2))
    np.add.at(counts, (log.state, log.action), 1.0)
    own = []
    z = 1.959963984540054
    for _ in range(8):
        error = np.sqrt(sum(cost[x] / counts[x] for x in np.ndindex(3, 2) if counts[x]))
        falls = {
            x: (
                z * cost[x] / counts[x] / (counts[x] + 1) / error
                if counts[x]
                else 2 * z * np.sqrt(cost[x])
            )
            for x in np.ndindex(3, 2)
        }
        own.append(max(falls, key=falls.get))
        counts[own[-1]] += 1
    assert list(plan.next_pairs) == own
    # a pair that comes several times after the first stands once, with how often
    line = next(x for x in str(plan).splitlines() if x.startswith("then the next"))
    told = line.split(": ", 1)[1]
    for s, a in set(own[1:]):
        name = f"action {a} in state {s}"
        times = own[1:].count((s, a))
        assert told.count(name) == 1
        assert (f"{name} ({times} times)" in told) == (times > 1)


@pytest.mark.parametrize(
    ("ratio", "first"), [(1.5, (1, 0)), (3.0, (1, 0)), (5.0, (0, 0))]
)
def test_a_pair_without_records_may_be_worth_more_than_one_with_a_record(ratio, first):
    """One transition of state 1 takes off 2 z sqrt(c_1), a second of state 0
    z sqrt(c_0) / 2: they are equal where sqrt(c_0 / c_1) = 4.
    """
    rows = np.zeros((6, 1, 6))
    rows[0, 0, 2:4] = rows[1, 0, 4:6] = 0.5
    rows[range(2, 6), 0, range(2, 6)] = 1.0
    pay = np.zeros((6, 1, 6))
    pay[0, 0, 2:4] = [-ratio, ratio]
    pay[1, 0, 4:6] = [-1.0, 1.0]
    simulator = oee.FiniteMDP(rows, pay, [0.5, 0.5, 0, 0, 0, 0], 0.9)
    plan = oee.plan_data_collection(
        oee.Problem(simulator, oee.Transitions([0], [0], [2])),
        np.zeros(6, dtype=int),
        n=1,
        model="simulator",
    )
    assert plan.next_pairs[0] == first


# ---- plans for gains: the difference of two gradients in place of one


def gain_costs(base, policy, minus, horizon=None):
    """Var_{s'}[dJ_policy / dP(s' | x) - dJ_minus / dP(s' | x)]."""
    slope = base.slope(policy, horizon) - base.slope(minus, horizon)
    return (base.P * slope**2).sum(axis=2) - (base.P * slope).sum(axis=2) ** 2


@pytest.mark.parametrize("sampling", ["free", "behavior"])
@pytest.mark.parametrize("number", [1, 2])
def test_a_plan_for_gains_is_the_least_of_its_own_program(sampling, number):
    simulator, policies = three()
    base = Dense(simulator)
    runs = np.array([[0.5, 0.5], [0.9, 0.1], [0.2, 0.8]])
    named = dict(list(policies.items())[:number])
    plan = oee.plan_data_collection(
        simulator, named, n=200, sampling=sampling, model="simulator", minus=runs
    )
    costs = [gain_costs(base, policy, runs).reshape(-1) for policy in named.values()]
    for name, own in zip(named, costs, strict=True):
        assert_allclose(plan.costs[name].reshape(-1), own, rtol=1e-9)
    flow = collected(base, 0.2) if sampling == "behavior" else None
    _, worst, least = best_shares(costs, np.zeros(6), 200, flow)
    assert_allclose(plan.inefficiency, worst, rtol=3e-3)
    assert plan.gap < 2e-3
    q = plan.distribution.reshape(-1)
    for outlook, own, alone in zip(plan.policies, costs, least, strict=True):
        assert_allclose(outlook.variance_after, (own / (200 * q)).sum(), rtol=1e-6)
        assert_allclose(outlook.inefficiency, outlook.variance_after / alone, rtol=3e-3)
    assert plan.is_gain
    assert "gains over the policy that is subtracted" in str(plan)
    assert "gains over the policy" in plan._repr_html_()
    assert plan.to_dict()["quantity"] == "gain"


@given(rngs)
@few
def test_laws_of_plans_for_gains(rng):
    """No gain over oneself, one plan for both signs, and the same certificate."""
    mdp = random_mdp(rng)
    policies = {str(k): random_policy(rng, mdp) for k in range(int(rng.integers(1, 4)))}
    runs = random_policy(rng, mdp)
    counts = rng.integers(0, 3, (mdp.n_states, mdp.n_actions))
    known = Problem(mdp, log_of(mdp, counts)) if counts.any() else mdp
    world = collection_mdp(mdp, 1 - mdp.discount)
    others = [oee.occupancy(world, pi) for pi in (runs, *policies.values())]
    for sampling in ("free", "behavior"):
        options = {"n": 30, "sampling": sampling, "model": "simulator"}
        plan = plan_data_collection(known, policies, minus=runs, **options)
        assert plan.gap < 1e-3
        for q in others if plan.status == "ok" else ():
            best = plan.inefficiency * (1 - plan.gap)
            assert best <= inefficiency(plan, q) * (1 + 1e-9)
        first = policies["0"]
        forth = plan_data_collection(known, first, minus=runs, **options)
        back = plan_data_collection(known, runs, minus=first, **options)
        size = forth.costs["policy"].max()
        assert_allclose(
            forth.costs["policy"], back.costs["policy"], rtol=1e-9, atol=1e-9 * size
        )
        assert_allclose(
            forth.policies[0].variance_after, back.policies[0].variance_after, rtol=3e-3
        )
        own = plan_data_collection(known, runs, minus=runs, **options)
        assert own.status.startswith("nothing to learn: these policies' gains")
        assert own.expected_width == (0.0, 0.0)


@given(rngs)
@few
def test_a_plan_for_gains_over_a_policy_without_gradient_is_that_for_values(rng):
    """The one that runs quits: two ends, that pay the same, so that no transition
    matters to it.
    """
    inner = random_mdp(rng)
    n, width = inner.n_states, inner.n_actions
    P = np.zeros((n + 2, width + 1, n + 2))
    P[:n, :width, :n] = inner.transitions.toarray().reshape(n, width, n)
    P[:, width, n:] = 0.5
    P[n:] = np.eye(n + 2)[n:, None, :]
    pay = np.zeros((n + 2, width + 1))
    pay[:n, :width] = inner.rewards
    pay[:n, width] = rng.normal()
    start = np.append(inner.initial, [0.0, 0.0])
    mdp = FiniteMDP(P, pay, start, inner.discount)
    policies = {name: random_policy(rng, mdp) for name in "ab"}
    quits = np.full(n + 2, width)
    log = oee.sample_transitions(mdp, np.full(pay.shape, 1 / pay.size), 40, seed=0)
    for sampling in ("free", "behavior"):
        options = {"n": 30, "sampling": sampling, "optimistic": False}
        gain = plan_data_collection(Problem(mdp, log), policies, minus=quits, **options)
        value = plan_data_collection(Problem(mdp, log), policies, **options)
        for name in policies:
            size = value.costs[name].max()
            assert_allclose(gain.costs[name], value.costs[name], atol=1e-9 * size)
        if value.status == "ok" and size > 1e-9:
            assert_allclose(gain.inefficiency, value.inefficiency, rtol=1e-3)
            assert gain.next_pairs[0] == value.next_pairs[0]
            told = value.advice.replace("estimated value", "estimated gain")
            assert gain.advice == told.replace(
                "what happens there is assumed and not measured",
                "no measurement says what happens there",
            )


@pytest.mark.parametrize("discount", [0.8, 1.0])
def test_a_plan_for_gains_over_a_horizon(discount):
    simulator, policies = three(2)
    simulator = simulator.with_discount(discount)
    plan = oee.plan_data_collection(
        simulator, policies["one"], n=50, horizon=4, minus=policies["two"]
    )
    own = gain_costs(Dense(simulator), policies["one"], policies["two"], 4)
    assert_allclose(plan.costs["policy"], own, rtol=1e-9)


def test_policies_that_differ_where_no_one_comes_have_nothing_to_learn():
    """What is left of equal gradients is rounding, also where they are large."""
    rng = np.random.default_rng(5)
    P = rng.dirichlet(np.ones(6), size=(6, 2))
    P[:5, :, 5] = 0.0
    P[:5] /= P[:5].sum(axis=2, keepdims=True)
    simulator = FiniteMDP(P, 1e6 * rng.normal(size=6), np.eye(6)[0], 0.9999)
    policy = rng.dirichlet([1.0, 1.0], size=6)
    other = policy.copy()
    other[5] = policy[5, ::-1]
    plan = plan_data_collection(simulator, policy, n=9, minus=other)
    assert plan.status.startswith("nothing to learn")
    assert plan.advice == "More transitions would not narrow it."


def test_a_plan_for_a_gain_beats_the_plan_for_the_value_at_it():
    """What two policies share need not be known for their difference."""
    runs = oee.mix(POLICY, oee.uniform_policy(SIMULATOR), 0.9)
    value = plan_data_collection(SIMULATOR, POLICY, n=1000)
    gain = plan_data_collection(SIMULATOR, POLICY, n=1000, minus=runs)
    least = variances(gain, gain.distribution)[0]
    assert least < variances(gain, value.distribution)[0]
    assert gain.expected_standard_error[1] < 0.5 * value.expected_standard_error[1]

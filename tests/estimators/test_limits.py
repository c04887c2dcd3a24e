"""Exact population limits of the estimators, on logs whose frequencies are exact."""

import functools

import numpy as np
import pytest
from helpers import Dense, dense, paths, random_mdp, random_policy, rngs, survival_chain
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy import optimize, sparse

import oee_tabular as oee
from oee_tabular.estimators import (
    DoublyRobust,
    DualDice,
    ImportanceSampling,
    Magic,
    Marginalized,
    ModelBased,
    OffEnvironment,
    Oracle,
    Simulator,
)

LIKELIHOOD = functools.partial(oee.transition_ratio, prior="none")


def pair(rng, discount=0.9, n_states=4):
    """A simulator, and a target on its support whose probabilities are multiples of
    1/12.
    """
    simulator = random_mdp(rng, n_states=n_states, n_actions=2, discount=discount)
    rows = []
    for row in dense(simulator)[0].reshape(-1, n_states):
        support = np.flatnonzero(row)
        new = np.zeros(n_states)
        new[support] = rng.multinomial(12, np.full(len(support), 1 / len(support))) / 12
        rows.append(new)
    target = simulator.with_transitions(np.array(rows).reshape(n_states, 2, n_states))
    return simulator, target


def exact_log(target, share):
    """A log with 12 * k moves in each row, k = 1, 2, ... where ``share`` is positive,
    in the target's exact proportions.
    """
    state = []
    action = []
    following = []
    for s, a, j in np.argwhere(dense(target)[0] > 0):
        number = round(12 * dense(target)[0][s, a, j]) * round(share[s, a])
        state += [s] * number
        action += [a] * number
        following += [j] * number
    return oee.Transitions(state, action, following)


def case(rng, **options):
    simulator, target = pair(rng, **options)
    share = rng.integers(0, 3, size=(simulator.n_states, 2))
    share[0, 0] = 1
    return simulator, target, share, random_policy(rng, simulator)


@settings(max_examples=60)
@given(rngs, st.sampled_from([None, 3]))
def test_21_with_exact_frequencies_every_deterministic_estimator_is_at_its_limit(
    rng, horizon
):
    simulator, target, share, policy = case(rng)
    problem = oee.Problem(simulator, exact_log(target, share), horizon=horizon)
    options = {"data_distribution": share / share.sum(), "horizon": horizon}
    likelihood = OffEnvironment(ratio=LIKELIHOOD)
    estimators = [
        Simulator(),
        Oracle(target),
        likelihood,
        ModelBased(),
        ModelBased(fallback="simulator"),
        DoublyRobust(ratio=LIKELIHOOD),
        DoublyRobust(weights="beta"),
        Marginalized(ratio=LIKELIHOOD),
        Marginalized(ratio=LIKELIHOOD, lower=0.8, upper=1.3),
    ]
    if horizon is None:
        estimators.append(DualDice())
    values = {}
    for estimator in estimators:
        limit = estimator.limit(simulator, target, policy, **options)
        value = estimator(problem, policy).value
        assert_allclose(value, limit, rtol=1e-7, atol=1e-8, err_msg=repr(estimator))
        values[type(estimator).__name__ + getattr(estimator, "fallback", "")] = value
    # off-environment evaluation == maximum likelihood == DualDICE (statement 21)
    assert_allclose(
        values["OffEnvironment"], values["ModelBasedsimulator"], rtol=1e-7, atol=1e-8
    )
    if horizon is None:
        assert_allclose(
            values["DualDice"], values["OffEnvironment"], rtol=1e-7, atol=1e-8
        )


@given(rngs, st.sampled_from([None, 4]))
def test_with_full_support_the_limit_is_the_truth(rng, horizon):
    simulator, target = pair(rng)
    policy = random_policy(rng, simulator)
    truth = oee.policy_value(target, policy, horizon=horizon)
    behavior = random_policy(rng, simulator, zeros=0)
    for estimator in (
        OffEnvironment(),
        OffEnvironment(ratio=oee.true_ratio(target, simulator)),
        Magic(),
        Marginalized(),
        ModelBased(),
        OffEnvironment(ratio=LIKELIHOOD, evaluation="monte_carlo"),
        Oracle(target),
        Oracle(target, evaluation="monte_carlo"),
        DoublyRobust(),
        DoublyRobust(data="rollouts"),
        DoublyRobust(data="episodes"),
        DoublyRobust(data="episodes", self_normalized=True),
        ImportanceSampling(),
        ImportanceSampling(kind="trajectory"),
        ImportanceSampling(self_normalized=True),
    ):
        limit = estimator.limit(
            simulator, target, policy, behavior_policy=behavior, horizon=horizon
        )
        assert_allclose(limit, truth, rtol=1e-6, atol=1e-6, err_msg=repr(estimator))


@given(rngs, st.sampled_from(["occupancy", "beta"]))
def test_24_the_error_on_transitions_is_a_product_of_errors(rng, weights):
    """sum_x (visits_w - visits_target)(x) (T'Q_sim - Q_sim)(x), visits discounted sums."""
    simulator, target, share, policy = case(rng)
    share[:] = 1
    distribution = share / share.sum()
    estimator = DoublyRobust(weights=weights, ratio=oee.true_ratio(target, simulator))
    limit = estimator.limit(simulator, target, policy, data_distribution=distribution)
    q = oee.action_values(simulator, policy)
    v = oee.state_values(simulator, policy)
    # target.rewards: the simulator's pay, its own moves
    moved = target.rewards + 0.9 * dense(target)[0] @ v - q
    visits = (
        oee.occupancy(target if weights == "occupancy" else simulator, policy) / 0.1
    )
    error = ((visits - oee.occupancy(target, policy) / 0.1) * moved).sum()
    assert_allclose(
        limit - oee.policy_value(target, policy), error, rtol=1e-7, atol=1e-8
    )


def test_28_with_beta_alone_halving_the_mismatch_quarters_the_error():
    rng = np.random.default_rng(2)
    simulator = oee.FiniteMDP(
        rng.dirichlet(np.ones(4), (4, 2)), rng.normal(size=4), [1, 0, 0, 0], 0.9
    )
    other = rng.dirichlet(np.ones(4), (4, 2))
    policy = np.full((4, 2), 0.5)
    errors = []
    naive = []
    for size in (0.04, 0.02, 0.01):
        target = simulator.with_transitions(
            (1 - size) * dense(simulator)[0] + size * other
        )
        truth = oee.policy_value(target, policy)
        errors.append(
            abs(DoublyRobust(weights="beta").limit(simulator, target, policy) - truth)
        )
        naive.append(abs(Simulator().limit(simulator, target, policy) - truth))
    assert_allclose(np.array(errors[:-1]) / errors[1:], 4, atol=0.2)
    assert_allclose(np.array(naive[:-1]) / naive[1:], 2, atol=0.2)
    assert errors[0] < 0.2 * naive[0]


def test_32_finished_episodes_dropped_from_the_normaliser_estimate_something_else():
    """The survival chain: truth 1 / (1 - .63) = 2.70; dropping the dead gives sum
    gamma^t = 10.
    """
    chain = survival_chain()
    ones = np.ones((2, 1))
    options = {"behavior_policy": ones}
    kept = ImportanceSampling(self_normalized=True).limit(chain, chain, ones, **options)
    dropped = ImportanceSampling(self_normalized=True, ragged="zero").limit(
        chain, chain, ones, **options
    )
    assert_allclose(kept, 1 / (1 - 0.63), rtol=1e-9)
    assert_allclose(dropped, 10.0, rtol=1e-9)


@given(rngs)
def test_31_self_normalised_values_shift_with_the_reward_and_stay_in_the_range_of_returns(
    rng,
):
    simulator, target = pair(rng)
    policy = random_policy(rng, simulator)
    behavior = random_policy(rng, simulator, zeros=0)
    if simulator.closed().any():
        return
    log = oee.sample_episodes(target, behavior, 20, 6, seed=int(rng.integers(1 << 30)))
    raised = oee.Transitions(**(log.columns() | {"reward": log.reward + 2.0}))
    gamma = 0.9 ** np.arange(6)
    for kind in ("trajectory", "per_decision"):
        estimator = ImportanceSampling(kind=kind, self_normalized=True)
        plain, shifted = (
            estimator(
                oee.Problem(simulator, each, horizon=6, behavior_policy=behavior),
                policy,
            ).value
            for each in (log, raised)
        )
        if np.isnan(plain):
            continue
        assert_allclose(shifted, plain + 2.0 * gamma.sum(), rtol=1e-9, atol=1e-9)
        if kind == "trajectory":
            returns = log.reward.reshape(20, 6) @ gamma
            assert returns.min() - 1e-9 <= plain <= returns.max() + 1e-9


def test_a_ratio_that_diverges_is_a_status():
    simulator = oee.tasks.gridworld(6, 0.3)
    target = oee.tasks.gridworld(6, 0.1)
    behavior = oee.uniform_policy(simulator)
    log = oee.sample_episodes(target, behavior, 12, 60, seed=0)
    problem = oee.Problem(simulator, log, behavior_policy=behavior)
    policy = oee.tasks.gridworld_policy(6, 0.5)
    assert (
        "spectral radius"
        in OffEnvironment("ratio_of_ratios")(problem, policy, seed=0).status
    )
    for estimator in (
        DoublyRobust(ratio="ratio_of_ratios"),
        DoublyRobust("episodes", ratio="ratio_of_ratios"),
        Marginalized("ratio_of_ratios"),
        Magic("ratio_of_ratios"),
    ):
        found = estimator(problem, policy, seed=0)
        assert np.isnan(found.value)
        assert "spectral radius" in found.status


# ---- limits of the estimators by every path and by dense algebra
HORIZON = 3


def world(seed=0, form="sat", lack=False):
    """Two states, two actions; the behaviour lacks action 1 in state 1 where ``lack``."""
    rng = np.random.default_rng(seed)
    P, Q = rng.dirichlet([2.0, 2.0], size=(2, 2, 2))
    r = rng.normal(size=(2, 2, 2)[: len(form)])
    simulator = oee.FiniteMDP(P, r, [0.6, 0.4], 0.9)
    behavior = np.array([[0.3, 0.7], [1.0, 0.0] if lack else [0.6, 0.4]])
    return (
        simulator,
        simulator.with_transitions(Q),
        rng.dirichlet([1.0, 1.0], size=2),
        behavior,
    )


def weighted(target, policy, behavior):
    """(probability under the behaviour, weights rho_0..t, rewards) of every path of the
    horizon.
    """
    for chance, path in paths(target, behavior, HORIZON):
        rho = np.cumprod([policy[s, a] / behavior[s, a] for s, a, _, _ in path])
        yield chance, rho, np.array([paid for *_, paid in path])


@pytest.mark.parametrize("lack", [False, True])
@pytest.mark.parametrize("kind", ["trajectory", "per_decision"])
@pytest.mark.parametrize("normal", [False, True])
def test_importance_sampling_s_limit_by_every_path(lack, kind, normal):
    simulator, target, policy, behavior = world(lack=lack)
    found = ImportanceSampling(kind=kind, self_normalized=normal).limit(
        simulator, target, policy, behavior_policy=behavior, horizon=HORIZON
    )
    g = 0.9 ** np.arange(HORIZON)
    chances, rhos, rewards = (
        np.array(x) for x in zip(*weighted(target, policy, behavior), strict=True)
    )
    weights = (
        rhos if kind == "per_decision" else np.repeat(rhos[:, -1:], HORIZON, axis=1)
    )
    top = chances @ (weights * rewards)
    mass = chances @ weights if normal else np.ones(HORIZON)
    assert_allclose(found, (g * top / mass).sum(), rtol=1e-10)
    if not lack:
        assert_allclose(found, Dense(target).J(policy, HORIZON), rtol=1e-10)


@pytest.mark.parametrize("form", ["sa", "sat"])
def test_doubly_robust_on_episodes_without_support_by_every_path(form):
    """E[V(s_0) + sum g^t rho_t (r_t + g V(s_t+1) - Q(s_t, a_t))], V and Q of the model:
    here the simulator itself.
    """
    simulator, target, policy, behavior = world(form=form, lack=True)
    same = oee.true_ratio(simulator, simulator)
    found = DoublyRobust(data="episodes", ratio=same).limit(
        simulator, target, policy, behavior_policy=behavior, horizon=HORIZON
    )
    truth = Dense(target)
    model = Dense(simulator)
    # the reward of a model's row is its own mean for r(s, a, s')
    V = model.values(policy, HORIZON)
    Q = [
        np.einsum("sat,sat->sa", model.P, model.r + model.g * V[t + 1])
        for t in range(HORIZON)
    ]
    own = model.mu @ V[0]
    for chance, path in paths(target, behavior, HORIZON):
        rho = 1.0
        for t, (s, a, j, _) in enumerate(path):
            rho *= policy[s, a] / behavior[s, a]
            own += (
                chance
                * 0.9**t
                * rho
                * (truth.r[s, a, j] + 0.9 * V[t + 1][j] - Q[t][s, a])
            )
    assert_allclose(found, own, rtol=1e-10)
    # the model fills in, with its own error
    assert abs(own - truth.J(policy, HORIZON)) > 1e-5


def ragged_world():
    """Two states that go on, and the absorbing state 2."""
    P = np.array(
        [
            [[0.5, 0.3, 0.2], [0.2, 0.6, 0.2]],
            [[0.4, 0.4, 0.2], [0.3, 0.3, 0.4]],
            [[0, 0, 1.0]] * 2,
        ]
    )
    simulator = oee.FiniteMDP(
        P, np.array([[1.0, -0.5], [0.3, 2.0], [0.0, 0.0]]), [0.7, 0.3, 0.0], 0.9
    )
    policy = np.array([[0.8, 0.2], [0.3, 0.7], [0.5, 0.5]])
    return simulator, policy, np.array([[0.4, 0.6], [0.5, 0.5], [0.5, 0.5]])


def clipped(p, q, low, high):
    """argmin sum q g - p log g over low <= g <= high with sum q g = 1: clip(p / (c q))."""

    def mass(c):
        return (q * np.clip(p / (c * q), low, high)).sum() - 1.0

    return np.clip(p / (optimize.brentq(mass, 1e-6, 1e6) * q), low, high)


@pytest.mark.parametrize("box", [(0.01, 10.0), (0.7, 1.3)])
def test_the_limit_of_the_quotient_of_two_clipped_ratios(box):
    """Rows of zeta * P need not sum to 1; doubly robust on rollouts has the same limit,
    by any V.
    """
    simulator, target, policy, behavior = world(2)
    share = np.array([[0.2, 0.4], [0.25, 0.15]])
    here = Dense(simulator)
    there = Dense(target)
    at = here.mu
    d = np.zeros((2, 2))
    # every move counts alike, as in a log, of episodes of a thousand
    for _ in range(1000):
        d += at[:, None] * behavior / 1000
        at = at @ here.chain(behavior)
    pairs = clipped(share, d, *box)
    moves = clipped(share[:, :, None] * there.P, d[:, :, None] * here.P, *box)
    own = here.like(moves / pairs[:, :, None] * here.P).J(policy)
    ask = functools.partial(
        oee.transition_ratio,
        method="ratio_of_ratios",
        simulator_data="exact",
        behavior_policy=behavior,
        lower=box[0],
        upper=box[1],
    )
    options = {"data_distribution": share, "behavior_policy": behavior}
    assert_allclose(
        OffEnvironment(ratio=ask).limit(simulator, target, policy, **options),
        own,
        rtol=1e-7,
    )
    on_rollouts = DoublyRobust(data="rollouts", ratio=ask).limit(
        simulator, target, policy, **options
    )
    assert_allclose(on_rollouts, own, rtol=1e-7)
    if box[1] == 10.0:
        assert_allclose(own, there.J(policy), rtol=1e-9)
        named = OffEnvironment(ratio="ratio_of_ratios").limit(
            simulator, target, policy, **options
        )
        assert_allclose(named, own, rtol=1e-7)


@pytest.mark.parametrize("ragged", ["pad", "zero"])
def test_the_limit_of_weighted_importance_sampling_where_episodes_end(ragged):
    """Weights stand still once it is over; "zero" takes such paths out of the step's
    normaliser.
    """
    simulator, policy, behavior = ragged_world()
    top = np.zeros(4)
    mass = np.zeros(4)
    for chance, path in paths(simulator, behavior, 4):
        rho = 1.0
        for t, (s, a, _, paid) in enumerate(path):
            rho *= policy[s, a] / behavior[s, a] if s != 2 else 1.0
            top[t] += chance * rho * paid
            mass[t] += chance * rho * (s != 2 or ragged == "pad")
    found = ImportanceSampling(
        kind="per_decision", self_normalized=True, ragged=ragged
    ).limit(simulator, simulator, policy, behavior_policy=behavior, horizon=4)
    assert_allclose(found, (0.9 ** np.arange(4) * top / mass).sum(), rtol=1e-10)


@pytest.mark.parametrize("form", ["sa", "sat"])
@pytest.mark.parametrize("weighting", ["per_decision", "trajectory"])
@pytest.mark.parametrize("normal", [False, True])
def test_the_limit_of_products_of_ratios_by_every_path_of_the_simulator(
    form, weighting, normal
):
    """A reward r(s, a) at t rests on t ratios, a reward r(s, a, s') on t + 1; rows of
    zeta * P that do not sum to 1.
    """
    simulator, target, policy, behavior = world(2, form)
    ask = functools.partial(
        oee.transition_ratio,
        method="ratio_of_ratios",
        simulator_data="exact",
        behavior_policy=behavior,
        lower=0.7,
        upper=1.3,
    )
    share = np.array([[0.2, 0.4], [0.25, 0.15]])
    fitted = ask(
        sparse.csr_array(share.reshape(4, 1) * Dense(target).P.reshape(4, 2)), simulator
    )
    zeta = fitted.values.toarray().reshape(2, 2, 2)
    shift = int(form == "sat")
    g = 0.9 ** np.arange(HORIZON)
    top = np.zeros(HORIZON)
    mass = np.zeros(HORIZON)
    for chance, path in paths(simulator, policy, HORIZON):
        w = np.cumprod([1.0] + [zeta[s, a, j] for s, a, j, _ in path])
        w = (
            w[shift : shift + HORIZON]
            if weighting == "per_decision"
            else np.full(HORIZON, w[HORIZON - 1 + shift])
        )
        top += chance * w * np.array([paid for *_, paid in path])
        mass += chance * w
    own = g @ (top / (mass if normal else 1.0))
    found = OffEnvironment(
        ratio=ask, evaluation="monte_carlo", weighting=weighting, self_normalized=normal
    ).limit(simulator, target, policy, data_distribution=share, horizon=HORIZON)
    assert_allclose(found, own, rtol=1e-9)


# ---- episodes that start in an absorbing state, or end at once

LIVE = {
    "goes on": (
        [
            [[0.2, 0.3, 0.5, 0], [0.1, 0.4, 0.2, 0.3]],
            [[0, 0, 0.6, 0.4], [0.5, 0, 0, 0.5]],
        ],
        [
            [[0.3, 0.2, 0.5, 0], [0.2, 0.3, 0.1, 0.4]],
            [[0, 0, 0.5, 0.5], [0.4, 0, 0, 0.6]],
        ],
    ),
    "ends at once": (
        [[[0, 0, 0.5, 0.5], [0, 0, 0.2, 0.8]], [[0, 0, 0.6, 0.4], [0, 0, 0.5, 0.5]]],
        [[[0, 0, 0.4, 0.6], [0, 0, 0.3, 0.7]], [[0, 0, 0.5, 0.5], [0, 0, 0.4, 0.6]]],
    ),
}
STARTS = {
    "some": [0.3, 0.2, 0.3, 0.2],
    "most": [0.1, 0.0, 0.5, 0.4],
    "one": [0.5, 0.0, 0.5, 0.0],
    "all": [0.0, 0.0, 0.5, 0.5],
    "none": [0.5, 0.5, 0.0, 0.0],
}
OF_ENDS = {
    **{
        f"{kind}, {'self-normalised, ' if by_weight else ''}{ragged}": (
            ImportanceSampling(kind=kind, self_normalized=by_weight, ragged=ragged)
        )
        for kind in ("per_decision", "trajectory")
        for by_weight in (False, True)
        for ragged in ("pad", "zero")
    },
    "estimated behaviour": ImportanceSampling(
        self_normalized=True, ragged="zero", behavior="estimated"
    ),
    "OffEnvironment": OffEnvironment(),
    "ratio of ratios": OffEnvironment("ratio_of_ratios"),
    "joint": OffEnvironment("joint"),
    **{
        f"rollouts, {weighting}, {by_weight}": OffEnvironment(
            evaluation="monte_carlo",
            weighting=weighting,
            self_normalized=by_weight,
            n_rollouts=20_000,
        )
        for weighting in ("per_decision", "trajectory")
        for by_weight in (False, True)
    },
    "ModelBased": ModelBased(),
    "DoublyRobust": DoublyRobust(),
    "DoublyRobust, rollouts": DoublyRobust(data="rollouts", n_rollouts=20_000),
    "DoublyRobust, episodes": DoublyRobust(data="episodes"),
    "DoublyRobust, normalised": DoublyRobust(data="episodes", self_normalized=True),
    "Marginalized": Marginalized(),
}


def ended_pair(live, start, form, discount):
    """A simulator and a target with two live states and two ends."""
    target, simulator = np.zeros((2, 4, 2, 4))
    target[:2], simulator[:2] = LIVE[live]
    for p in (target, simulator):
        p[2, :, 2] = p[3, :, 3] = 1.0
    rewards = np.random.default_rng(form).integers(1, 5, (4, 2, 4)[:form]).astype(float)
    rewards[2:] = 0.0
    made = oee.FiniteMDP(target, rewards, STARTS[start], discount)
    return made.with_transitions(simulator), made


@pytest.mark.parametrize("live", LIVE)
@pytest.mark.parametrize("start", STARTS)
@pytest.mark.parametrize(("discount", "horizon"), [(1.0, 2), (0.8, 4), (0.6, None)])
def test_limits_of_episodes_that_start_ended(live, start, discount, horizon):
    """Such an episode has one step, without reward, in every estimator."""
    form = 1 + (len(live) + len(start) + (horizon or 0)) % 3
    simulator, target = ended_pair(live, start, form, discount)
    behavior = np.array([[0.6, 0.4], [0.3, 0.7], [0.5, 0.5], [0.9, 0.1]])
    policy = np.array([[0.4, 0.6], [0.6, 0.4], [0.1, 0.9], [0.5, 0.5]])
    log = oee.sample_episodes(target, behavior, 20_000, horizon or 50, seed=3)
    problem = oee.Problem(simulator, log, horizon=horizon)
    for name, estimator in OF_ENDS.items():
        found = estimator(problem, policy, seed=1)
        limit = estimator.limit(
            simulator, target, policy, behavior_policy=behavior, horizon=horizon
        )
        # quotients have no error, and that of rollouts leaves out the log's noise
        allowed = 5.0 * (found.standard_error or 0.0) + 0.02 * (1.0 + abs(limit))
        assert abs(found.value - limit) <= allowed, name

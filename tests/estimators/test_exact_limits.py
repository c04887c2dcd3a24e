"""Limits of the estimators by every path and by dense algebra."""

import functools

import numpy as np
import pytest
from helpers import Dense, paths
from numpy.testing import assert_allclose
from scipy import optimize, sparse

import oee_tabular as oee
from oee_tabular.estimators import DoublyRobust, ImportanceSampling, OffEnvironment

HORIZON = 3


def world(seed=0, form="sat", lack=False):
    """Two states, two actions; the behaviour lacks action 1 in state 1 where ``lack``."""
    rng = np.random.default_rng(seed)
    P, Q = rng.dirichlet([2.0, 2.0], size=(2, 2, 2))
    r = rng.normal(size=(2, 2, 2)[: len(form)])
    simulator = oee.FiniteMDP(P, r, [0.6, 0.4], 0.9)
    behavior = np.array([[0.3, 0.7], [1.0, 0.0] if lack else [0.6, 0.4]])
    return simulator, simulator.with_transitions(Q), rng.dirichlet([1.0, 1.0], size=2), behavior


def weighted(target, policy, behavior):
    """(probability under the behaviour, weights rho_0..t, rewards) of every path of the horizon."""
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
    chances, rhos, rewards = (np.array(x) for x in zip(*weighted(target, policy, behavior), strict=True))
    weights = rhos if kind == "per_decision" else np.repeat(rhos[:, -1:], HORIZON, axis=1)
    top = chances @ (weights * rewards)
    mass = chances @ weights if normal else np.ones(HORIZON)
    assert_allclose(found, (g * top / mass).sum(), rtol=1e-10)
    if not lack:
        assert_allclose(found, Dense(target).J(policy, HORIZON), rtol=1e-10)


@pytest.mark.parametrize("form", ["sa", "sat"])
def test_doubly_robust_on_episodes_without_support_by_every_path(form):
    """E[V(s_0) + sum g^t rho_t (r_t + g V(s_t+1) - Q(s_t, a_t))], V and Q of the model: here the simulator itself."""
    simulator, target, policy, behavior = world(form=form, lack=True)
    same = oee.true_ratio(simulator, simulator)
    found = DoublyRobust(data="episodes", ratio=same).limit(
        simulator, target, policy, behavior_policy=behavior, horizon=HORIZON
    )
    truth, model = Dense(target), Dense(simulator)
    # the reward of a model's row is its own mean for r(s, a, s')
    V = model.values(policy, HORIZON)
    Q = [np.einsum("sat,sat->sa", model.P, model.r + model.g * V[t + 1]) for t in range(HORIZON)]
    own = model.mu @ V[0]
    for chance, path in paths(target, behavior, HORIZON):
        rho = 1.0
        for t, (s, a, j, _) in enumerate(path):
            rho *= policy[s, a] / behavior[s, a]
            own += chance * 0.9**t * rho * (truth.r[s, a, j] + 0.9 * V[t + 1][j] - Q[t][s, a])
    assert_allclose(found, own, rtol=1e-10)
    assert abs(own - truth.J(policy, HORIZON)) > 1e-5  # the model fills in, with its own error


def ragged_world():
    """Two states that go on, and the absorbing state 2."""
    P = np.array([[[0.5, 0.3, 0.2], [0.2, 0.6, 0.2]], [[0.4, 0.4, 0.2], [0.3, 0.3, 0.4]], [[0, 0, 1.0]] * 2])
    simulator = oee.FiniteMDP(P, np.array([[1.0, -0.5], [0.3, 2.0], [0.0, 0.0]]), [0.7, 0.3, 0.0], 0.9)
    policy = np.array([[0.8, 0.2], [0.3, 0.7], [0.5, 0.5]])
    return simulator, policy, np.array([[0.4, 0.6], [0.5, 0.5], [0.5, 0.5]])


def clipped(p, q, low, high):
    """argmin sum q g - p log g over low <= g <= high with sum q g = 1: clip(p / (c q))."""

    def mass(c):
        return (q * np.clip(p / (c * q), low, high)).sum() - 1.0

    return np.clip(p / (optimize.brentq(mass, 1e-6, 1e6) * q), low, high)


@pytest.mark.parametrize("box", [(0.01, 10.0), (0.7, 1.3)])
def test_the_limit_of_the_quotient_of_two_clipped_ratios(box):
    """Rows of zeta * P need not sum to 1; doubly robust on rollouts has the same limit, by any V."""
    simulator, target, policy, behavior = world(2)
    share = np.array([[0.2, 0.4], [0.25, 0.15]])
    here, there = Dense(simulator), Dense(target)
    at, d = here.mu, np.zeros((2, 2))
    for _ in range(1000):  # every move counts alike, as in a log, of episodes of a thousand
        d += at[:, None] * behavior / 1000
        at = at @ here.chain(behavior)
    pairs = clipped(share, d, *box)
    moves = clipped(share[:, :, None] * there.P, d[:, :, None] * here.P, *box)
    own = here.like(moves / pairs[:, :, None] * here.P).J(policy)
    ask = functools.partial(
        oee.transition_ratio, method="ratio_of_ratios", simulator_data="exact", behavior_policy=behavior,
        lower=box[0], upper=box[1],
    )  # fmt: skip
    options = {"data_distribution": share, "behavior_policy": behavior}
    assert_allclose(OffEnvironment(ratio=ask).limit(simulator, target, policy, **options), own, rtol=1e-7)
    on_rollouts = DoublyRobust(data="rollouts", ratio=ask).limit(simulator, target, policy, **options)
    assert_allclose(on_rollouts, own, rtol=1e-7)
    if box[1] == 10.0:
        assert_allclose(own, there.J(policy), rtol=1e-9)
        named = OffEnvironment(ratio="ratio_of_ratios").limit(simulator, target, policy, **options)
        assert_allclose(named, own, rtol=1e-7)


@pytest.mark.parametrize("ragged", ["pad", "zero"])
def test_the_limit_of_weighted_importance_sampling_where_episodes_end(ragged):
    """Weights stand still once it is over; "zero" takes such paths out of the step's normaliser."""
    simulator, policy, behavior = ragged_world()
    top, mass = np.zeros(4), np.zeros(4)
    for chance, path in paths(simulator, behavior, 4):
        rho = 1.0
        for t, (s, a, _, paid) in enumerate(path):
            rho *= policy[s, a] / behavior[s, a] if s != 2 else 1.0
            top[t] += chance * rho * paid
            mass[t] += chance * rho * (s != 2 or ragged == "pad")
    found = ImportanceSampling(kind="per_decision", self_normalized=True, ragged=ragged).limit(
        simulator, simulator, policy, behavior_policy=behavior, horizon=4
    )
    assert_allclose(found, (0.9 ** np.arange(4) * top / mass).sum(), rtol=1e-10)


@pytest.mark.parametrize("form", ["sa", "sat"])
@pytest.mark.parametrize("weighting", ["per_decision", "trajectory"])
@pytest.mark.parametrize("normal", [False, True])
def test_the_limit_of_products_of_ratios_by_every_path_of_the_simulator(form, weighting, normal):
    """A reward r(s, a) at t rests on t ratios, a reward r(s, a, s') on t + 1; rows of zeta * P that do not sum to 1."""
    simulator, target, policy, behavior = world(2, form)
    ask = functools.partial(
        oee.transition_ratio, method="ratio_of_ratios", simulator_data="exact", behavior_policy=behavior,
        lower=0.7, upper=1.3,
    )  # fmt: skip
    share = np.array([[0.2, 0.4], [0.25, 0.15]])
    fitted = ask(sparse.csr_array(share.reshape(4, 1) * Dense(target).P.reshape(4, 2)), simulator)
    zeta = fitted.values.toarray().reshape(2, 2, 2)
    shift = int(form == "sat")
    g = 0.9 ** np.arange(HORIZON)
    top, mass = np.zeros(HORIZON), np.zeros(HORIZON)
    for chance, path in paths(simulator, policy, HORIZON):
        w = np.cumprod([1.0] + [zeta[s, a, j] for s, a, j, _ in path])
        w = w[shift : shift + HORIZON] if weighting == "per_decision" else np.full(HORIZON, w[HORIZON - 1 + shift])
        top += chance * w * np.array([paid for *_, paid in path])
        mass += chance * w
    own = g @ (top / (mass if normal else 1.0))
    found = OffEnvironment(ratio=ask, evaluation="monte_carlo", weighting=weighting, self_normalized=normal).limit(
        simulator, target, policy, data_distribution=share, horizon=HORIZON
    )
    assert_allclose(found, own, rtol=1e-9)

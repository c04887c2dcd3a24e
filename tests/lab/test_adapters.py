"""Tests of the adapters to other libraries' estimators.

The padding is checked by hand, names by equations that have one solution in a table,
and values by the other libraries' numbers.
"""

import sys
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import oee_tabular as oee
from oee_tabular.estimators.names import NAMED, named_estimators
from oee_tabular.lab.bench.adapters import PEERS, Peer, pad_episodes

SAME = {
    "TrajectoryWiseImportanceSampling": "is",
    "PerDecisionImportanceSampling": "pdis",
    "SelfNormalizedTIS": "wis",
    "SelfNormalizedPDIS": "wpdis",
    "VanillaISPDIS": "pdis",
    "PDWIS": "wpdis",
}
ALL = [(library, name) for library, names in PEERS.items() for name in names]
MISSING = {
    "scope-rl": "scope_rl.ope.discrete.basic_estimators",
    "offline-rl-ope": "offline_rl_ope.api",
}


@pytest.fixture(scope="module", params=["random_walk", "machine"])
def drawn(request):
    family = oee.bench.families()[request.param]
    return family, family.problem(2000, seed=0)


def test_padded_episodes_give_the_same_importance_sampling(drawn):
    family, problem = drawn
    episodes = pad_episodes(problem, family.policy)
    taken = np.take_along_axis(
        episodes["policy"], episodes["action"][:, :, None], axis=2
    )[:, :, 0]
    weights = np.cumprod(taken / episodes["behavior"], axis=1)
    discount = family.simulator.discount ** np.arange(weights.shape[1])
    value = (discount * weights * episodes["reward"]).sum(axis=1).mean()
    assert_allclose(value, NAMED["pdis"]()(problem, family.policy).value, rtol=1e-12)
    assert episodes["alive"].sum() == len(problem.log)
    assert_allclose(episodes["policy"].sum(axis=2), 1.0)


def test_a_horizon_cuts_episodes():
    pair = oee.testing.case("ragged")
    assert pad_episodes(pair.problem(50, seed=0), pair.policy)["alive"].shape == (50, 6)


@pytest.mark.parametrize(("library", "name"), ALL)
def test_the_libraries(library, name, drawn):
    pytest.importorskip(MISSING[library], reason=f"needs {library}, with torch")
    family, problem = drawn
    value = Peer(library, name)(problem, family.policy).value
    assert np.isfinite(value)
    if name in SAME:  # offline-rl-ope has single precision
        rtol = 1e-8 if library == "scope-rl" else 1e-4
        assert_allclose(
            value, NAMED[SAME[name]]()(problem, family.policy).value, rtol=rtol
        )


def scope_rl(
    *,
    step_per_trajectory,
    action,
    reward,
    pscore,
    evaluation_policy_action_dist,
    gamma,
    **others,
):
    """Estimate by per-decision importance sampling on SCOPE-RL's flat arrays."""
    taken = evaluation_policy_action_dist[np.arange(len(action)), action] / pscore
    weights = np.cumprod(taken.reshape(-1, step_per_trajectory), axis=1)
    q = others["state_action_value_prediction"]
    assert q.shape == evaluation_policy_action_dist.shape
    assert ((q == 0.0).all(axis=1) == (pscore == 1.0)).all()  # after the end
    return (
        (weights * reward.reshape(weights.shape))
        @ gamma ** np.arange(step_per_trajectory)
    ).mean()


def offline_rl_ope(*, rewards, states, actions, weights, discount, is_msk):
    """Estimate the same on offline-rl-ope's columns of rewards for each episode."""
    paid = np.array([column[:, 0] for column in rewards]) * is_msk
    return ((weights * paid) @ discount ** np.arange(weights.shape[1])).mean()


class Tensor(np.ndarray):
    def unsqueeze(self, axis):
        return np.expand_dims(self, axis)


@pytest.fixture
def stubs(monkeypatch):
    """Stand in for both libraries and torch, as far as the adapters call them."""
    loaded = SimpleNamespace(estimate_policy_value=scope_rl, predict=offline_rl_ope)
    monkeypatch.setattr(Peer, "load", lambda peer: loaded)
    torch = SimpleNamespace(
        float32=float, tensor=lambda values, dtype: np.asarray(values).view(Tensor)
    )
    monkeypatch.setitem(sys.modules, "torch", torch)


def test_peers_by_name_beside_ours(stubs):
    names = "scope-rl:PerDecisionImportanceSampling, offline-rl-ope:VanillaISPDIS, pdis"
    table = oee.bench.run(names, families="machine", sizes=3, seeds=2).table
    assert (table.status == "ok").all()
    values = table.pivot(index="seed", columns="estimator", values="value")
    for name in names.split(", "):
        assert_allclose(values[name], values["pdis"], rtol=1e-12)


def test_without_the_libraries_the_extra_is_named(monkeypatch):
    for library, module in MISSING.items():
        monkeypatch.setitem(sys.modules, module, None)
        name = PEERS[library][-1]
        with pytest.raises(
            ImportError,
            match=(
                rf"{library}:{name} needs {library}; in a clone: pip install"
                rf" '.\[{library}\]'"
            ),
        ):
            oee.bench.run(f"oee,{library}:{name}", families="machine")
    row = oee.bench.run(
        Peer("scope-rl", "DoublyRobust"), families=["machine"], sizes=[1], seeds=1
    ).table.iloc[-1]
    assert (row.estimator, row.status.split(":")[0]) == ("Peer", "ImportError")


@pytest.mark.parametrize("name", ["machine", "queue25"])
def test_names_from_the_literature_solve_the_published_equations(name):
    """Check the published equations on a log of all pairs.

    They are E[(r + gamma q(s', pi) - q(s, a)) f] = 0 and E[w (f(s, a) - gamma f(s',
    pi))] = f(s_0, pi).
    """
    family = oee.bench.families()[name]
    simulator = family.simulator
    policy = family.policy
    log = oee.sample_transitions(
        family.target, np.full(policy.shape, 1 / policy.size), 20_000, seed=0
    )
    problem = oee.Problem(simulator, log)
    pair = log.state * policy.shape[1] + log.action
    moves = np.zeros((policy.size, policy.shape[0]))
    np.add.at(moves, (pair, log.next_state), simulator.discount)
    matrix = np.diag(np.bincount(pair)) - (moves[:, :, None] * policy).reshape(
        policy.size, -1
    )
    rewards = np.bincount(pair, problem.rewards_of(log))
    start = (simulator.initial[:, None] * policy).ravel()
    by_q = start @ np.linalg.solve(matrix, rewards)
    by_w = np.linalg.solve(matrix.T, start) @ rewards
    for own, value in {
        "fqe": by_q,
        "mql": by_q,
        "mwl": by_w,
        "gendice": by_w,
        "dualdice": by_w,
    }.items():
        (estimator,) = named_estimators([own]).values()
        assert_allclose(estimator(problem, policy).value, value, rtol=1e-9)
    rows = oee.bench.run(
        ["fqe", "mql", "gradientdice"], families=[name], sizes=[3], seeds=1
    ).table
    assert rows.estimator.tolist()[2:] == ["fqe", "mql", "gradientdice"]
    assert rows.status.tolist() == ["ok"] * 5


BAG = oee.Transitions([0], [0], [1], [1.0])
BARE = oee.Transitions([0], [0], [1], [1.0], episode=[0])


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (
            lambda case: Peer("offline-rl-ope", "IS"),
            "offline-rl-ope's estimator must be one of 'Vanilla.*; got 'IS'",
        ),
        (
            lambda case: oee.bench.run("scope-rl:PDIS"),
            "scope-rl's estimator must be one of 'Traj.*; got 'PDIS'",
        ),
        (
            lambda case: oee.bench.run("scope-rl"),
            "scope-rl's estimator must be one of .*; got ''",
        ),
        (
            lambda case: Peer("d3rlpy", "FQE"),
            "library must be one of 'scope-rl', 'offline-rl-ope'; got 'd3rlpy'",
        ),
        (
            lambda case: pad_episodes(oee.Problem(case.simulator, BAG), case.policy),
            "log must have episodes for importance",
        ),
        (
            lambda case: pad_episodes(oee.Problem(case.simulator, BARE), case.policy),
            "log must have behaviour probabilities",
        ),
    ],
)
def test_bad_calls(call, text):
    with pytest.raises(ValueError, match=text):
        call(oee.testing.case("ragged"))

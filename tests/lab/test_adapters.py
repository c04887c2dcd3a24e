"""Estimators of other libraries: the padding by hand, the libraries' numbers where they are installed (they pull in torch)."""

import importlib.util

import numpy as np
import pytest

import oee_tabular as oee
from oee_tabular.estimators.names import NAMED
from oee_tabular.lab.bench.adapters import OFFLINE, SCOPE, OfflineRLOPE, ScopeRL, padded

SAME = {"TrajectoryWiseImportanceSampling": "is", "PerDecisionImportanceSampling": "pdis", "SelfNormalizedTIS": "wis",
        "SelfNormalizedPDIS": "wpdis", "VanillaISPDIS": "pdis", "PDWIS": "wpdis"}  # fmt: skip


@pytest.fixture(scope="module", params=["random_walk", "machine"])
def drawn(request):
    family = oee.bench.families()[request.param]
    return family, family.problem(2000, seed=0)


def test_padded_episodes_give_the_same_importance_sampling(drawn):
    family, problem = drawn
    episodes = padded(problem, family.policy)
    taken = np.take_along_axis(episodes.policy, episodes.action[:, :, None], axis=2)[:, :, 0]
    weights = np.cumprod(taken / episodes.behavior, axis=1)
    discount = family.simulator.discount ** np.arange(weights.shape[1])
    value = (discount * weights * episodes.reward).sum(axis=1).mean()
    np.testing.assert_allclose(value, NAMED["pdis"]()(problem, family.policy).value, rtol=1e-12)
    assert episodes.alive.sum() == len(problem.log)
    np.testing.assert_allclose(episodes.policy.sum(axis=2), 1.0)


def test_a_horizon_cuts_episodes():
    pair = oee.testing.case("ragged")
    assert padded(pair.problem(50, seed=0), pair.policy).alive.shape == (50, 6)


@pytest.mark.skipif(importlib.util.find_spec("scope_rl") is None, reason="needs scope-rl, with torch")
@pytest.mark.parametrize("name", SCOPE)
def test_scope_rl(name, drawn):
    family, problem = drawn
    value = ScopeRL(name)(problem, family.policy).value
    assert np.isfinite(value)
    if name in SAME:
        np.testing.assert_allclose(value, NAMED[SAME[name]]()(problem, family.policy).value, rtol=1e-8)


@pytest.mark.skipif(importlib.util.find_spec("offline_rl_ope") is None, reason="needs offline-rl-ope, with torch")
@pytest.mark.parametrize("name", OFFLINE)
def test_offline_rl_ope(name, drawn):
    family, problem = drawn
    value = OfflineRLOPE(name)(problem, family.policy).value
    np.testing.assert_allclose(value, NAMED[SAME[name]]()(problem, family.policy).value, rtol=1e-4)  # single precision


def test_without_the_libraries_the_extra_is_named(drawn, monkeypatch):
    family, problem = drawn
    monkeypatch.setitem(__import__("sys").modules, "scope_rl.ope.discrete", None)
    monkeypatch.setitem(__import__("sys").modules, "torch", None)
    with pytest.raises(ImportError, match=r"ScopeRL needs scope-rl; in a clone: pip install '.\[scope-rl\]'"):
        ScopeRL()(problem, family.policy)
    with pytest.raises(ImportError, match=r"pip install '.\[offline-rl-ope\]'"):
        OfflineRLOPE()(problem, family.policy)
    row = oee.bench.run(ScopeRL(), families=["machine"], sizes=[1], seeds=1).table.iloc[-1]
    assert (row.estimator, row.status.split(":")[0]) == ("ScopeRL", "ImportError")


def test_bad_calls(drawn):
    family, problem = drawn
    with pytest.raises(ValueError, match="estimator must be one of 'VanillaISPDIS', 'PDWIS'; got 'IS'"):
        OfflineRLOPE("IS")
    log = problem.log
    bag = oee.Transitions(log.state, log.action, log.next_state, log.reward)
    with pytest.raises(ValueError, match="log must have episodes for importance sampling"):
        padded(oee.Problem(problem.simulator, bag), family.policy)
    bare = oee.Transitions(
        log.state, log.action, log.next_state, log.reward, terminated=log.terminated, episode=log.episode
    )
    with pytest.raises(ValueError, match="log must have behaviour probabilities for importance sampling"):
        padded(oee.Problem(problem.simulator, bare), family.policy)

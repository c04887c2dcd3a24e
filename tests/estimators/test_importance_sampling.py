"""Importance sampling episode by episode: errors, bounds of truncation, weights of 0."""

import functools

import numpy as np
import pytest
from estimators.four_states import (
    BEHAVIOR,
    POLICY,
    environments,
    plain_episodes,
    recorded_problem,
)
from numpy.testing import assert_allclose

import oee_tabular as oee
from oee_tabular import FiniteMDP, Problem, Transitions
from oee_tabular.estimators import DoublyRobust, ImportanceSampling, Magic
from oee_tabular.testing import case, padded_log


def sampled_value(episodes, ratios, multiplicity, gamma, horizon, *, pad, kind, normal):
    """The value of episodes that count as often as ``multiplicity`` says, in the
    plainest way.
    """
    longest = max(min(len(steps), horizon) for steps, _ in episodes)
    products = [np.cumprod(r[:horizon]) for r in ratios]
    if kind == "trajectory":
        weights = np.array([p[-1] for p in products]) * multiplicity
        returns = [
            sum(gamma**t * step[3] for t, step in enumerate(steps[:horizon]))
            for steps, _ in episodes
        ]
        return (
            weights
            @ np.array(returns)
            / (weights.sum() if normal else multiplicity.sum())
        )
    value = 0.0
    for t in range(longest):
        above = below = 0.0
        for k, (steps, _) in enumerate(episodes):
            if t < len(products[k]):
                above += multiplicity[k] * products[k][t] * steps[t][3]
                below += multiplicity[k] * products[k][t]
            elif pad:
                below += multiplicity[k] * products[k][-1]
        value += gamma**t * above / (below if normal else multiplicity.sum())
    return value


@pytest.mark.parametrize("horizon", [None, 3])
@pytest.mark.parametrize(
    ("kind", "ragged", "normal"),
    [
        ("per_decision", "pad", True),
        ("per_decision", "zero", True),
        ("trajectory", "pad", True),
        ("per_decision", "pad", False),
        ("trajectory", "pad", False),
    ],
)
def test_the_error_of_a_value_is_the_derivative_in_each_episode(
    kind, ragged, normal, horizon
):
    """Values and infinitesimal jackknife, by central differences in how often each
    episode counts.
    """
    problem, _ = recorded_problem(2, horizon=horizon, n=12)
    episodes = plain_episodes(problem.log)
    ratios = [
        [POLICY[s, a] / BEHAVIOR[s, a] for s, a, _, _ in steps] for steps, _ in episodes
    ]
    n = len(episodes)
    step = 1e-5
    how = {
        "gamma": 0.9,
        "horizon": horizon or 99,
        "pad": ragged == "pad",
        "kind": kind,
        "normal": normal,
    }
    value = functools.partial(sampled_value, episodes, ratios, **how)
    influence = np.array(
        [
            n
            * (value(np.ones(n) + step * unit) - value(np.ones(n) - step * unit))
            / (2 * step)
            for unit in np.eye(n)
        ]
    )
    found = ImportanceSampling(kind, self_normalized=normal, ragged=ragged)(
        problem, POLICY
    )
    assert_allclose(found.value, value(np.ones(n)), rtol=1e-12)
    assert_allclose(found.standard_error, influence.std(ddof=1) / np.sqrt(n), rtol=1e-6)
    last = np.array([np.prod(r[: horizon or 99]) for r in ratios])
    facts = found.diagnostics
    assert_allclose(facts["mean_weight"], last.mean())
    assert_allclose(facts["effective_sample_size"], last.sum() ** 2 / (last**2).sum())
    every = np.concatenate([np.cumprod(r[: horizon or 99]) for r in ratios])
    assert_allclose(
        facts["largest_weight"], last.max() if kind == "trajectory" else every.max()
    )
    cut = np.array(
        [not over and len(steps) < (horizon or 99) for steps, over in episodes]
    )
    if horizon is None:
        assert 0 < cut.sum() < n
        sizes = np.array([len(steps) for steps, _ in episodes])
        largest = max(
            np.abs(problem.log.reward).max(), np.abs(problem.simulator.rewards).max()
        )
        bound = (last * largest * 0.9**sizes / 0.1)[cut].sum()
        assert_allclose(
            facts["truncation_bias_bound"],
            bound / (last.sum() if normal else n),
            rtol=1e-12,
        )


def test_the_truncation_bound_with_a_horizon_or_without_a_discount():
    """Cut after 2 of 5 steps at 0.5: 3 * (1/4 + 1/8 + 1/16); at discount 1: 3 * 3."""
    rows = np.array([[[0.0, 1.0]], [[1.0, 0.0]]])
    mdp = FiniteMDP(rows, np.array([1.0, -3.0]), [1, 0], 0.5)
    log = Transitions(
        [0, 1],
        [0, 0],
        [1, 0],
        [1.0, -3.0],
        episode=[0, 0],
        behavior_probability=[1.0, 1.0],
    )
    for model, bound in (
        (mdp, 3 * (1 / 4 + 1 / 8 + 1 / 16)),
        (mdp.with_discount(1.0), 9.0),
    ):
        facts = ImportanceSampling()(
            Problem(model, log, horizon=5), np.ones((2, 1))
        ).diagnostics
        assert_allclose(facts["truncation_bias_bound"], bound)
    whole = ImportanceSampling()(Problem(mdp, log, horizon=2), np.ones((2, 1)))
    assert whole.diagnostics["truncation_bias_bound"] == 0.0
    assert "starts" not in [finding.kind for finding in whole.findings]
    away = Transitions(
        [1, 0],
        [0, 0],
        [0, 1],
        [1.0, 1.0],
        episode=[0, 1],
        behavior_probability=[1.0, 1.0],
    )
    found = ImportanceSampling()(Problem(mdp, away, horizon=1), np.ones((2, 1)))
    assert "50% of the episodes start where the simulator never does" in str(
        found.findings[-1]
    )


def test_one_deciding_episode_has_no_error():
    """Two episodes, one of weight 0: the self-normalised value is the other's return,
    without a standard error.
    """
    mdp = FiniteMDP(np.full((1, 2, 1), 1.0), np.array([[2.0, 5.0]]), [1.0], 0.9)
    log = Transitions(
        [0, 0],
        [0, 1],
        [0, 0],
        [2.0, 5.0],
        episode=[0, 1],
        behavior_probability=[0.5, 0.5],
    )
    only = np.array([[1.0, 0.0]])
    found = ImportanceSampling(self_normalized=True)(Problem(mdp, log, horizon=1), only)
    assert (found.value, found.standard_error, found.status) == (2.0, None, "ok")
    plain = ImportanceSampling()(Problem(mdp, log, horizon=1), only)
    assert (plain.value, plain.standard_error) == (2.0, 2.0)
    both = ImportanceSampling(self_normalized=True)(
        Problem(mdp, log, horizon=1), np.array([[0.5, 0.5]])
    )
    assert both.standard_error is not None
    rare = np.array([[0.05, 0.95]])  # weights .1 and 1.9: worth 1.1 episodes
    assert (
        ImportanceSampling(self_normalized=True)(
            Problem(mdp, log, horizon=1), rare
        ).standard_error
        is None
    )


def test_without_any_weight_no_bias_is_bounded():
    """Self-normalised, all weights 0: no value, and a bound of 0."""
    simulator, target = environments(2)
    log = oee.sample_episodes(target, np.tile([1.0, 0.0], (4, 1)), 5, 2, seed=0)
    never = np.tile([0.0, 1.0], (4, 1))
    problem = Problem(simulator, log)
    for kind in ("trajectory", "per_decision"):
        found = ImportanceSampling(kind, self_normalized=True)(problem, never)
        assert np.isnan(found.value)
        assert found.standard_error is None
        assert found.diagnostics["truncation_bias_bound"] == 0.0
        assert (
            found.status
            == "the weight of every whole episode is 0: none of the log is one that the"
            " policy could have made"
        )
    assert np.isfinite(DoublyRobust(data="episodes")(problem, never).value)
    for estimator in (DoublyRobust(data="episodes", self_normalized=True), Magic()):
        found = estimator(problem, never)
        assert np.isnan(found.value)
        assert "weight" in found.status
        assert "is 0" in found.status


def test_frequencies_stand_in_for_the_behaviour_policy():
    mdp = FiniteMDP(
        np.full((2, 2, 2), 0.5), np.array([[2.0, 5.0], [0.0, 0.0]]), [1.0, 0.0], 0.9
    )
    log = Transitions(
        [0, 0, 0, 0, 1],
        [0, 1, 0, 0, 1],
        [0, 0, 0, 1, 0],
        [2.0, 5.0, 2.0, 2.0, 0.0],
        episode=[0, 1, 2, 3, 3],
    )
    found = ImportanceSampling(behavior="estimated")(
        Problem(mdp, log, horizon=2), np.full((2, 2), 0.5)
    )
    assert_allclose(found.value, (3 * 2.0 * 0.5 / 0.75 + 5.0 * 0.5 / 0.25) / 4)


@pytest.mark.parametrize("kind", ["trajectory", "per_decision"])
@pytest.mark.parametrize("self_normalized", [False, True])
def test_rows_after_an_episode_s_end_weigh_nothing(kind, self_normalized):
    """Whatever policy and behaviour do in the absorbing state, the weight stays what it
    was at the end.
    """
    pair = case("ragged")
    policy = pair.policy.copy()
    log = pair.log(60, seed=0)
    policy[-1] = [0.9, 0.1]
    estimator = ImportanceSampling(kind=kind, self_normalized=self_normalized)
    one, other = (
        estimator(Problem(pair.simulator, each, horizon=pair.horizon), policy)
        for each in (log, padded_log(log, (0, 1, 0), 0.5))
    )
    assert_allclose(
        [other.value, other.standard_error], [one.value, one.standard_error], rtol=1e-12
    )

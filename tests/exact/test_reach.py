"""What a policy never reaches from the start does not matter to J.

The oracle is the same MDP without the states that are never reached.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy import sparse

import oee_tabular as oee
from oee_tabular import estimators, exact
from oee_tabular.exceptions import DivergentKernelError
from oee_tabular.ratio import Conditional

N_LIVE = 4  # and one state that ends the episode
FEATURELESS = Conditional(prior="simulator")  # others look at all states


class Pair:
    """Simulator and target, whole and without what is never reached.

    States come in any order. Action 0 stays among the live states and the end, action 1
    leads to states in which rewards are paid for ever, or which lead back.
    """

    def __init__(self, seed, form=2, discount=1.0, junk="loops"):
        rng = np.random.default_rng(seed)
        n = N_LIVE + 1
        size = n + 4
        p = np.zeros((size, 2, size))
        for s in range(N_LIVE):
            p[s, 0, :n] = rng.dirichlet(np.ones(n))
            p[s, 1, n:] = rng.dirichlet(np.ones(size - n))
        p[N_LIVE, :, N_LIVE] = 1.0
        p[n, :, n + 1] = p[n + 1, :, n] = 1.0  # a loop of two
        p[n + 2, :, n + 2] = 1.0  # a loop of one
        p[n + 3] = 1.0 / size  # which leads to all states
        q = p.copy()
        for s in range(N_LIVE):
            q[s, 0, :n] = rng.dirichlet(np.ones(n))
        rewards = rng.normal(size=(size, 2, size)[:form])
        rewards[N_LIVE] = 0.0
        if junk == "without reward":
            rewards[n:] = 0.0
        initial = np.append(rng.dirichlet(np.ones(N_LIVE)), np.zeros(size - N_LIVE))
        order = rng.permutation(size)
        # where a state of the whole has gone
        self.place = np.argsort(order)
        self.n = n
        self.whole = self._pair(p, q, rewards, initial, discount, order, 2)
        self.small = self._pair(
            p[:n, :1, :n],
            q[:n, :1, :n],
            rewards[:n, :1, :n][:, :, :n] if form == 3 else rewards[:n, :1],
            initial[:n],
            discount,
            np.arange(n),
            1,
        )
        self.policy = np.tile([1.0, 0.0], (size, 1))
        self.policies = self.policy, np.ones((n, 1))
        log = oee.sample_episodes(self.small[1], np.ones((n, 1)), 200, 60, seed=seed)
        columns = dict(log.columns())
        columns["state"] = self.place[columns["state"]]
        columns["next_state"] = self.place[columns["next_state"]]
        self.logs = oee.Transitions(**columns), log

    @staticmethod
    def _pair(p, q, rewards, initial, discount, order, n_actions):
        index = np.ix_(order, range(n_actions), order)
        if rewards.ndim == 3:
            rewards = rewards[index]
        else:
            rewards = rewards[order][:, :n_actions]
        return tuple(
            oee.FiniteMDP(x[index], rewards, initial[order], discount) for x in (q, p)
        )

    def both(self, function):
        """What a function of (simulator, target, policy, log) says of either."""
        models = (self.whole, self.small)
        return [
            function(*pair, policy, log)
            for pair, policy, log in zip(models, self.policies, self.logs, strict=True)
        ]


def box_range(simulator, target, policy, log):
    found = oee.value_range(simulator, policy, 0.5, 2.0)
    return [found.lower, found.upper]


FROM_THE_START = {
    "value": lambda s, t, pi, log: oee.policy_value(t, pi),
    "value and bound": lambda s, t, pi, log: exact.evaluate_policy(t, pi).value,
    "reweighted": lambda s, t, pi, log: oee.policy_value(
        exact.reweight(s, oee.true_ratio(t, s)), pi
    ),
    "gradient": lambda s, t, pi, log: np.sort(
        exact.transition_gradient(t, pi)[exact.transition_gradient(t, pi) != 0.0]
    ),
    "gradient of another's values": lambda s, t, pi, log: float(
        np.abs(exact.transition_gradient(t, pi, values_of=s)).sum()
    ),
    "range": box_range,
}


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([2, 3]))
@pytest.mark.parametrize("name", FROM_THE_START)
def test_what_is_never_reached_changes_no_number(name, seed, form):
    whole, small = Pair(seed, form).both(FROM_THE_START[name])
    assert_allclose(whole, small, rtol=1e-12, atol=1e-12)


ESTIMATORS = {
    "Simulator": estimators.Simulator(),
    "ModelBased": estimators.ModelBased(),
    "ModelBased, simulator": estimators.ModelBased(fallback="simulator"),
    "OffEnvironment": estimators.OffEnvironment(FEATURELESS),
    "OffEnvironment, none": estimators.OffEnvironment(Conditional(prior="none")),
    "DoublyRobust": estimators.DoublyRobust(ratio=FEATURELESS),
    "DoublyRobust, beta": estimators.DoublyRobust(weights="beta"),
    "DoublyRobust, episodes": estimators.DoublyRobust(
        data="episodes", ratio=FEATURELESS
    ),
    "DoublyRobust, normalised": estimators.DoublyRobust(
        data="episodes", self_normalized=True, ratio=FEATURELESS
    ),
    "Magic": estimators.Magic(ratio=FEATURELESS, n_bootstrap=20),
    "ImportanceSampling": estimators.ImportanceSampling(),
    "ImportanceSampling, normalised": estimators.ImportanceSampling(
        self_normalized=True
    ),
}


@pytest.mark.parametrize("name", ESTIMATORS)
@pytest.mark.parametrize("seed", [1, 2])
def test_estimates_and_limits_need_only_what_is_reached(name, seed):
    def estimate(simulator, target, policy, log):
        found = ESTIMATORS[name](oee.Problem(simulator, log), policy, seed=0)
        assert found.status == "ok"
        return [found.value, found.standard_error or 0.0, *(found.interval or ())]

    def limit(simulator, target, policy, log):
        return ESTIMATORS[name].limit(simulator, target, policy)

    for function in (estimate, limit):
        whole, small = Pair(seed, 3).both(function)
        assert_allclose(whole, small, rtol=1e-10, atol=1e-12)


def test_the_default_ratio_and_the_oracle_have_a_value():
    """Their directions look at all states, so that they may differ a little."""

    def value(estimator):
        def found(simulator, target, policy, log):
            made = estimator(target)(oee.Problem(simulator, log), policy, seed=0)
            assert made.status == "ok"
            assert np.isfinite(made.standard_error or 0.0)
            return made.value

        return found

    pair = Pair(3)
    whole, small = pair.both(value(lambda target: estimators.OffEnvironment()))
    assert_allclose(whole, small, rtol=0.02)
    whole, small = pair.both(value(estimators.Oracle))
    assert_allclose(whole, small, rtol=1e-12)


def test_the_report_has_every_row():
    def table(simulator, target, policy, log):
        report = oee.evaluate(
            oee.Problem(simulator, log),
            policy,
            estimators=["simulator", "model-based", "pdis", "wpdis"],
            target=target,
            seed=0,
        )
        return [
            x
            for result in report.results
            for x in (result.estimate.value, result.estimate.standard_error or 0.0)
        ] + list(report.truth.values())

    whole, small = Pair(4).both(table)
    assert_allclose(whole, small, rtol=1e-10)


@pytest.mark.parametrize("method", ["likelihood", "delta", "robust"])
def test_intervals_with_a_horizon_are_the_same(method):
    def ends(simulator, target, policy, log):
        problem = oee.Problem(simulator, log, horizon=12)
        found = oee.interval(problem, policy, method=method)
        return [found.lower, found.upper]

    whole, small = Pair(5).both(ends)
    assert_allclose(whole, small, rtol=1e-8)


def test_values_of_all_states_are_refused_or_nan():
    pair = Pair(6)
    model = pair.whole[1]
    for function in (oee.state_values, oee.action_values):
        with pytest.raises(DivergentKernelError, match="for ever among states of"):
            function(model, pair.policy)
    found = exact.evaluate_policy(model, pair.policy).values
    expected = oee.state_values(pair.small[1], pair.policies[1])
    assert_allclose(found[pair.place[: pair.n]], expected, rtol=1e-12, atol=1e-13)
    assert np.isnan(found[pair.place[pair.n :]]).all()
    # no loop with rewards: every state has its value
    model = Pair(6, junk="without reward").whole[1]
    assert np.isfinite(oee.state_values(model, pair.policy)).all()


@pytest.mark.parametrize("share", [1e-12, 0.5, 1.0])
def test_what_is_reached_is_refused_by_name(share):
    pair = Pair(7)
    model = pair.whole[1]
    leaving = pair.policy.copy()
    leaving[pair.place[0]] = [1.0 - share, share]
    for call in (
        lambda: oee.policy_value(model, leaving),
        lambda: exact.evaluate_policy(model, leaving),
        lambda: exact.transition_gradient(model, leaving),
        lambda: oee.value_range(model, leaving, 0.5, 2.0),
    ):
        with pytest.raises(DivergentKernelError, match="horizon must be given"):
            call()
    # a start in a loop of one: it alone is named
    start = np.zeros(model.n_states)
    start[pair.place[pair.n + 2]] = 1.0
    rows = model.transitions.toarray().reshape(model.n_states, 2, -1)
    elsewhere = oee.FiniteMDP(rows, model.rewards, start, 1.0)
    with pytest.raises(DivergentKernelError, match=rf"s={pair.place[pair.n + 2]} has"):
        oee.policy_value(elsewhere, pair.policy)


def test_one_policy_that_diverges_leaves_the_others():
    pair = Pair(8)
    simulator = pair.whole[0]
    problem = oee.Problem(simulator, pair.logs[0])
    endless = np.tile([0.5, 0.5], (simulator.n_states, 1))
    report = oee.evaluate(
        problem,
        {"ends": pair.policy, "endless": endless},
        estimators={
            "simulator": estimators.Simulator(),
            "model": estimators.ModelBased(fallback="simulator"),
        },
        seed=0,
    )
    for result in report.results:
        assert np.isfinite(result.estimate.value) == (result.policy == "ends")
        assert (result.estimate.status == "ok") == (result.policy == "ends")


def test_episodes_that_start_where_the_sum_diverges_have_no_value():
    """The control variate would be unknown: no number is made up."""
    pair = Pair(9)
    columns = dict(pair.logs[0].columns())
    loop = pair.place[pair.n + 2]
    columns["state"] = columns["state"].copy()
    columns["next_state"] = columns["next_state"].copy()
    last = columns["episode"] == columns["episode"][-1]
    columns["state"][last] = loop
    columns["next_state"][last] = loop
    columns["terminated"] = columns["terminated"] & ~last
    log = oee.Transitions(**columns)
    estimator = estimators.DoublyRobust(data="episodes", ratio=FEATURELESS)
    found = estimator(oee.Problem(pair.whole[0], log), pair.policy, seed=0)
    assert np.isnan(found.value)
    assert "for ever" in found.status


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6))
def test_kernels_that_grow_where_nobody_comes_have_a_value(seed):
    """Rows of zeta P that sum to 2 diverge below discount 1 as well."""
    pair = Pair(seed, 2, discount=0.9)
    simulator = pair.whole[0]
    factor = np.ones(simulator.n_states)
    factor[pair.place[pair.n :]] = 2.0
    lengths = np.diff(simulator.transitions.indptr)
    data = np.repeat(np.repeat(factor, 2), lengths)
    zeta = sparse.csr_array(
        (data, simulator.transitions.indices, simulator.transitions.indptr),
        shape=simulator.transitions.shape,
    )
    model = exact.reweight(simulator, zeta)
    with pytest.raises(DivergentKernelError):
        oee.state_values(model, pair.policy)
    small = pair.small[0]
    assert_allclose(
        oee.policy_value(model, pair.policy),
        oee.policy_value(small, np.ones((pair.n, 1))),
        rtol=1e-12,
        atol=1e-13,
    )
    visits = oee.occupancy(model, pair.policy)
    assert_allclose(visits.sum(), 1.0, rtol=1e-12)
    assert (visits[pair.place[pair.n :]] == 0.0).all()


def test_a_ratio_of_0_closes_the_way_to_a_loop():
    """The transition is stored, and its probability is 0."""
    rows = [[[0.5, 0.25, 0.25]], [[0.0, 1.0, 0.0]], [[0.0, 0.0, 1.0]]]
    simulator = oee.FiniteMDP(rows, [1.0, 0.0, 5.0], [1.0, 0.0, 0.0], 1.0)
    zeta = sparse.csr_array([[1.0, 2.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    model = exact.reweight(simulator, zeta)
    assert oee.policy_value(model, [[1.0]] * 3) == pytest.approx(2.0)
    with pytest.raises(DivergentKernelError):
        oee.policy_value(simulator, [[1.0]] * 3)


def test_taxi_s_policy_may_do_anything_where_it_never_comes():
    taxi = oee.tasks.toy_text("Taxi-v4", discount=1.0)
    best = oee.optimal_policy(oee.tasks.toy_text("Taxi-v4", discount=0.999))
    value = oee.policy_value(taxi, best)
    comes = oee.occupancy(taxi, best, horizon=60, of="state") > 0.0
    idle = best.copy()
    idle[~comes] = np.eye(6)[0]
    assert (~comes).sum() > 50
    assert oee.policy_value(taxi, idle) == pytest.approx(value, rel=1e-12)
    assert value == pytest.approx(7.93, abs=0.01)
    with pytest.raises(DivergentKernelError):
        oee.state_values(taxi, idle)

"""Actions that cannot be taken: rules, copies, and laws against MDPs without them.

``lifted`` puts the A actions of each state of an MDP into A + k places, other ones in
each state; the places left over cannot be taken. Nothing that is computed may change,
but for where it stands. ``filled`` gives each place left over the row of an action that
can be taken: what neither a policy nor a log uses does not matter.
"""

import copy
import dataclasses
import pickle
from types import SimpleNamespace

import numpy as np
import pytest
from helpers import Page
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import oee_tabular as oee
from oee_tabular import FiniteMDP, testing
from oee_tabular.exceptions import ArgumentError

CLOSE = {"rtol": 1e-9, "atol": 1e-9}


class Lift:
    """Places of the actions of each state among more actions."""

    def __init__(self, places, n_places):
        self.places = np.array(places)
        self.n_places = n_places
        self.available = np.zeros((len(places), n_places), dtype=bool)
        np.put_along_axis(self.available, self.places, True, axis=1)

    def table(self, table):
        """An (S, A, ...) table with zeros in the places left over."""
        given = np.asarray(table)
        lifted = np.zeros((len(given), self.n_places, *given.shape[2:]))
        for new, old, places in zip(lifted, given, self.places, strict=True):
            new[places] = old
        return lifted

    def back(self, table):
        """The (S, A, ...) entries of a lifted table that can be taken."""
        return np.array([row[k] for row, k in zip(table, self.places, strict=True)])

    def log(self, log):
        return dataclasses.replace(log, action=self.places[log.state, log.action])

    def dense(self, mdp):
        """Transitions (S, A, S) and rewards of the lifted MDP."""
        shape = (mdp.n_states, mdp.n_actions, mdp.n_states)
        transitions = mdp.transitions.toarray().reshape(shape)
        rewards = mdp.rewards
        if mdp.transition_rewards is not None:
            rewards = mdp.transition_rewards.toarray().reshape(shape)
        return self.table(transitions), self.table(rewards)

    def mdp(self, mdp):
        transitions, rewards = self.dense(mdp)
        return FiniteMDP(
            transitions,
            rewards,
            mdp.initial,
            mdp.discount,
            available=self.available,
        )

    def filled(self, mdp):
        """The MDP in which each place left over repeats the state's first action."""
        transitions, rewards = self.dense(mdp)
        for s, k in np.argwhere(~self.available):
            transitions[s, k] = transitions[s, self.places[s, 0]]
            rewards[s, k] = rewards[s, self.places[s, 0]]
        return FiniteMDP(transitions, rewards, mdp.initial, mdp.discount)


@st.composite
def lifts(draw, n_states, n_actions, same=False):
    """A lift of all states alike (``same``), or of each in its own way."""
    n_places = n_actions + draw(st.integers(1, 2))
    order = st.permutations(range(n_places))
    if same:
        places = [sorted(draw(order)[:n_actions])] * n_states
    else:
        places = [draw(order)[:n_actions] for _ in range(n_states)]
    return Lift(places, n_places)


@st.composite
def models(draw, same=False, **options):
    mdp = draw(testing.mdps(**options))
    return mdp, draw(lifts(mdp.n_states, mdp.n_actions, same))


@given(models(), st.data())
def test_values_of_policies_do_not_change(model, data):
    mdp, lift = model
    masked = lift.mdp(mdp)
    policy = data.draw(testing.policies(mdp))
    horizon = data.draw(testing.horizons(mdp))
    lifted = lift.table(policy)
    for name in ("policy_value", "state_values"):
        compute = getattr(oee, name)
        assert_allclose(
            compute(masked, lifted, horizon=horizon),
            compute(mdp, policy, horizon=horizon),
            **CLOSE,
        )
    q = oee.action_values(masked, lifted, horizon=horizon)
    assert_allclose(
        lift.back(q), oee.action_values(mdp, policy, horizon=horizon), **CLOSE
    )
    assert (q[~lift.available] == -np.inf).all()
    steps = horizon or 3
    assert_allclose(
        oee.occupancy(masked, lifted, horizon=steps),
        lift.table(oee.occupancy(mdp, policy, horizon=steps)),
        **CLOSE,
    )
    ours, theirs = (
        oee.return_moments(m, pi, horizon=steps)
        for m, pi in ((masked, lifted), (mdp, policy))
    )
    assert_allclose([ours.mean, ours.variance], [theirs.mean, theirs.variance], **CLOSE)


@given(models(), st.data())
def test_optimal_uniform_and_noisy_actions_are_among_those_that_can_be_taken(
    model, data
):
    mdp, lift = model
    masked = lift.mdp(mdp)
    horizon = data.draw(testing.horizons(mdp))
    best = oee.optimal_policy(masked, horizon=horizon)
    assert not best[..., ~lift.available].any()
    assert_allclose(
        oee.policy_value(masked, best, horizon=horizon),
        oee.policy_value(
            mdp, oee.optimal_policy(mdp, horizon=horizon), horizon=horizon
        ),
        **CLOSE,
    )
    uniform = oee.uniform_policy(masked)
    assert_allclose(uniform, lift.table(oee.uniform_policy(mdp)))
    policy = data.draw(testing.policies(mdp))
    mixed = oee.mix(lift.table(policy), uniform, 0.3)
    assert not mixed[~lift.available].any()
    noisy = masked.with_action_noise(0.4)
    assert_array_equal(noisy.available, lift.available)
    assert_allclose(
        noisy.transitions.toarray(),
        lift.mdp(mdp.with_action_noise(0.4)).transitions.toarray(),
        **CLOSE,
    )
    assert_allclose(
        oee.policy_value(noisy, lift.table(policy), horizon=4),
        oee.policy_value(masked, oee.mix(uniform, lift.table(policy), 0.4), horizon=4),
        **CLOSE,
    )


@settings(max_examples=15)
@given(models(discounts=(0.0, 0.5, 0.9)), st.data())
def test_ranges_and_bounds_do_not_change(model, data):
    mdp, lift = model
    masked, filled = lift.mdp(mdp), lift.filled(mdp)
    policy = data.draw(testing.policies(mdp))
    horizon = data.draw(st.sampled_from([None, 3]))
    share = data.draw(testing.policies(mdp)) / mdp.n_states
    lifted = lift.table(policy)
    box = data.draw(st.sampled_from([(0.5, 2.0), (0.0, np.inf)]))
    ranges = [
        oee.value_range(m, pi, *box, horizon=horizon)
        for m, pi in ((mdp, policy), (masked, lifted), (filled, lifted))
    ]
    for other in ranges[1:]:
        assert_allclose(
            (other.lower, other.upper), (ranges[0].lower, ranges[0].upper), **CLOSE
        )
    bound = oee.efficiency_bound(mdp, policy, share, horizon=horizon)
    for other in (masked, filled):
        assert_allclose(
            oee.efficiency_bound(other, lifted, lift.table(share), horizon=horizon),
            bound,
            **CLOSE,
        )
    behavior = data.draw(testing.policies(mdp, zeros=False))
    for kind in ("mdp", "tree", "stationary"):
        ours, theirs = (
            oee.trajectory_efficiency_bound(m, b, pi, horizon=3, model=kind)
            for m, b, pi in (
                (masked, lift.table(behavior), lifted),
                (mdp, behavior, policy),
            )
        )
        assert_allclose(ours, theirs, **CLOSE)


@settings(max_examples=10)
@given(models(discounts=(0.5, 0.9), min_states=2), st.data())
def test_robust_policies_and_decisions_take_what_can_be_taken(model, data):
    mdp, lift = model
    masked = lift.mdp(mdp)
    horizon = data.draw(st.sampled_from([None, 3]))
    ours = oee.robust_policy(masked, 0.5, 2.0, horizon=horizon)
    theirs = oee.robust_policy(mdp, 0.5, 2.0, horizon=horizon)
    assert not ours.policy[..., ~lift.available].any()
    scale = 1.0 + abs(theirs.value)
    assert_allclose(ours.value, theirs.value, atol=1e-8 * scale)
    assert ours.gap <= 1e-7 * scale
    running = oee.uniform_policy(masked)
    log = oee.sample_episodes(masked, running, 5, 6, seed=0)
    found = oee.improve(oee.Problem(masked, log, horizon=horizon), running)
    assert not found.policy[~lift.available].any()
    assert all(not c.policy[~lift.available].any() for c in found.candidates)


@settings(max_examples=8)
@given(models(discounts=(0.5, 0.9), min_states=2), st.data())
def test_an_interval_gives_nothing_to_rows_that_cannot_be_used(model, data):
    mdp, lift = model
    masked, filled = lift.mdp(mdp), lift.filled(mdp)
    policy = data.draw(testing.policies(mdp))
    log = data.draw(testing.logs(mdp, kind=None))
    box = data.draw(st.sampled_from([{}, {"lower_ratio": 0.5, "upper_ratio": 2.0}]))
    horizon = data.draw(st.sampled_from([None, 3]))
    for method in ("likelihood", "robust"):
        ends = [
            oee.interval(
                oee.Problem(m, record, horizon=horizon), pi, method=method, **box
            )
            for m, record, pi in (
                (mdp, log, policy),
                (masked, lift.log(log), lift.table(policy)),
                (filled, lift.log(log), lift.table(policy)),
            )
        ]
        if method == "robust":
            found = [(end.lower, end.upper) for end in ends]
        else:  # the quoted one begins at the prior, which knows actions by their numbers
            found = [end.worst_case or (end.lower, end.upper) for end in ends]
        assert_allclose(found[1], found[0], rtol=1e-5, atol=1e-5)
        assert_allclose(found[2], found[0], rtol=1e-5, atol=1e-5)


@settings(max_examples=5)
@given(models(same=True, discounts=(0.5, 0.9), min_states=2), st.data())
def test_an_action_that_no_state_has_changes_no_estimate_and_no_report(model, data):
    mdp, lift = model
    masked = lift.mdp(mdp)
    policy = data.draw(testing.policies(mdp))
    behavior = oee.uniform_policy(mdp)
    log = data.draw(testing.logs(mdp))
    pairs = [
        (
            oee.Problem(mdp, log, horizon=3, behavior_policy=behavior),
            policy,
        ),
        (
            oee.Problem(
                masked,
                lift.log(log),
                horizon=3,
                behavior_policy=oee.uniform_policy(masked),
            ),
            lift.table(policy),
        ),
    ]
    reports = [oee.evaluate(problem, pi, seed=0) for problem, pi in pairs]
    for one, other in zip(*(r.table.to_dict("records") for r in reports), strict=True):
        for column in ("value", "lower", "upper", "standard_error"):
            # the strengths of the prior are found to about 1e-6
            assert_allclose(other[column], one[column], rtol=1e-5, atol=1e-5)
    estimators = [
        oee.estimators.ModelBased(fallback="stay"),
        oee.estimators.ModelBased(fallback="simulator"),
        oee.estimators.ModelBased(fallback="zero"),
        oee.estimators.DoublyRobust(),
        oee.estimators.ImportanceSampling(behavior="estimated"),
        oee.estimators.Marginalized(),
        oee.estimators.OffEnvironment(),
        oee.estimators.OffEnvironment(ratio=oee.ratio.Quotient(0.1, 10, data="exact")),
    ]
    for estimator in estimators:
        one, other = (estimator(problem, pi).value for problem, pi in pairs)
        assert_allclose(other, one, rtol=1e-5, atol=1e-5)


@settings(max_examples=8)
@given(models(discounts=(0.5, 0.9), min_states=2), st.data())
def test_plans_record_what_can_be_recorded(model, data):
    mdp, lift = model
    masked = lift.mdp(mdp)
    policy = data.draw(testing.policies(mdp))
    for sampling in ("free", "behavior"):
        ours, theirs = (
            oee.plan_data_collection(m, pi, n=20, sampling=sampling)
            for m, pi in ((masked, lift.table(policy)), (mdp, policy))
        )
        assert not ours.distribution[~lift.available].any()
        assert not ours.behavior_policy[~lift.available].any()
        if sampling == "free":
            assert_allclose(ours.distribution, lift.table(theirs.distribution), **CLOSE)
        assert_allclose(
            ours.expected_standard_error, theirs.expected_standard_error, rtol=1e-3
        )
        assert all(lift.available[s, a] for s, a in ours.next_pairs)


@given(testing.mdps(allow_unavailable=True), st.data())
def test_samples_and_copies(mdp, data):
    assert_array_equal(
        np.diff(mdp.csr.indptr).reshape(mdp.rewards.shape) > 0, mdp.available
    )
    assert not mdp.rewards[~mdp.available].any()
    log = oee.sample_episodes(mdp, oee.uniform_policy(mdp), 3, 4, seed=0)
    assert mdp.available[log.state, log.action].all()
    drawn = data.draw(testing.logs(mdp, kind=None))
    assert mdp.available[drawn.state, drawn.action].all()
    same = [
        copy.copy(mdp),
        copy.deepcopy(mdp),
        pickle.loads(pickle.dumps(mdp)),
        mdp.with_transitions(mdp.transitions),
        mdp.with_transitions(
            mdp.transitions.toarray().reshape(*mdp.rewards.shape, mdp.n_states)
        ),
        mdp.with_rewards(mdp.rewards),
        mdp.with_discount(0.5),
        mdp.with_initial(0),
        mdp.with_layout(None),
        mdp.with_names([f"s{k}." for k in range(mdp.n_states)]),
        mdp.with_action_noise(0.1),
        mdp.with_support_of(log, 0.1),
        oee.Problem(mdp, log, rewards="log").model,
        oee.transition_ratio(log, mdp).target_model(mdp),
        eval(testing.as_code(mdp)),
    ]
    for other in same:
        assert_array_equal(other.available, mdp.available)
        assert other.has_all_actions == mdp.has_all_actions


def two_states(**changes):
    """High and low; in high only two of three actions can be taken."""
    transitions = np.zeros((2, 3, 2))
    transitions[0, 1:] = [0.5, 0.5], [1.0, 0.0]
    transitions[1] = [0.2, 0.8]
    arguments = {
        "transitions": transitions,
        "rewards": [1.0, 2.0],
        "initial": 0,
        "discount": 0.9,
        "state_names": ["high", "low"],
        "action_names": ["charge", "search", "wait"],
        "available": [[0, 1, 1], [1, 1, 1]],
    }
    return FiniteMDP(**arguments | changes)


def test_files_keep_it(tmp_path):
    mdp = two_states()
    mdp.save(tmp_path / "mdp.npz")
    again = FiniteMDP.load(tmp_path / "mdp.npz")
    assert_array_equal(again.available, mdp.available)
    assert repr(again) == repr(mdp)
    assert "2 states, 3 actions (5 of 6 pairs)" in repr(mdp)
    assert "available pairs" in mdp._repr_html_()
    full = two_states(available=None, transitions=np.full((2, 3, 2), 0.5))
    assert full.available.all()
    assert full.available.shape == (2, 3)
    assert "available" not in full.arrays()
    with pytest.raises(ValueError, match="read-only"):
        full.available[0, 0] = False
    with pytest.raises(ValueError, match="read-only"):
        mdp.available[0, 0] = True


def test_all_true_is_the_same_as_none():
    full = np.full((2, 3, 2), 0.5)
    mdp = two_states(transitions=full, available=np.ones((2, 3)) > 0)
    assert mdp.has_all_actions
    assert repr(mdp) == repr(two_states(transitions=full, available=None))


@pytest.mark.parametrize(
    "rewards",
    [
        [[np.nan, 1.0, 1.0], [2.0, 2.0, 2.0]],
        [[np.inf, 1.0, 1.0], [2.0, 2.0, 2.0]],
        np.array([[[np.inf] * 2, [1.0] * 2, [1.0] * 2], [[2.0] * 2] * 3]),
        [1.0, 2.0],
    ],
)
def test_rewards_of_what_cannot_be_taken_are_ignored(rewards):
    mdp = two_states(rewards=rewards)
    assert_array_equal(mdp.rewards, [[0.0, 1.0, 1.0], [2.0, 2.0, 2.0]])
    values = oee.state_values(mdp, oee.uniform_policy(mdp))
    assert_allclose(
        values, oee.state_values(two_states(), oee.uniform_policy(two_states()))
    )
    assert_array_equal(
        FiniteMDP(**mdp._arguments()).with_discount(0.5).rewards, mdp.rewards
    )


def test_sparse_transitions_and_rewards():
    from scipy import sparse

    dense = two_states(rewards=np.full((2, 3, 2), 1.5))
    table = sparse.csr_array(np.full((6, 2), 1.5))
    given_ = [
        two_states(transitions=dense.transitions, rewards=table),
        two_states(
            transitions=[sparse.csr_array(dense.transitions[a::3]) for a in range(3)],
            rewards=[sparse.csr_array(np.full((2, 2), 1.5))] * 3,
        ),
        two_states(transitions=dense.transitions.astype(np.float32), rewards=table),
    ]
    for mdp in given_:
        assert_array_equal(mdp.rewards, dense.rewards)
        assert_allclose(
            mdp.transitions.toarray(), dense.transitions.toarray(), atol=1e-7
        )
        assert mdp.transition_rewards[[0]].nnz == 0


def test_a_new_row_of_what_cannot_be_taken_is_refused():
    mdp = two_states()
    with pytest.raises(
        ArgumentError, match=r"^new transitions\[0, 0\] .* s=high, a=ch"
    ):
        mdp.with_transitions(np.full((2, 3, 2), 0.5))
    log = oee.Transitions([0], [0], [1])
    with pytest.raises(ArgumentError, match=r"^log\[0\] .* state high action charge"):
        mdp.with_support_of(log, 0.1)


def test_forms_of_policies():
    mdp = two_states()
    can = {"high": "wait", "low": "charge"}
    assert oee.policy_value(mdp, can) == oee.policy_value(mdp, [2, 0])
    for bad in (
        {"high": "charge", "low": "wait"},
        [0, 1],
        ["charge", "wait"],
        lambda state: "charge",
        [[1e-9, 0.5, 0.5 - 1e-9], [1.0, 0.0, 0.0]],
        np.full((2, 3), 1 / 3, dtype=np.float32),
    ):
        with pytest.raises(
            ArgumentError, match=r"^policy\[0, 0\] .* charge .* state hi"
        ):
            oee.policy_value(mdp, bad)
    by_step = np.stack([oee.uniform_policy(mdp)] * 3)
    oee.policy_value(mdp, by_step, horizon=3)
    by_step[2, 0] = [1.0, 0.0, 0.0]
    with pytest.raises(ArgumentError, match=r"^policy\[2, 0, 0\] must be 0"):
        oee.policy_value(mdp, by_step, horizon=3)


@pytest.mark.parametrize("drop", ["refuse", "drop"])
def test_logs_and_counts_that_use_it(drop):
    mdp = two_states()
    log = oee.Transitions([1, 0, 0], [1, 1, 0], [1, 1, 1])
    with pytest.raises(ArgumentError, match=r"^log\[2\] .* high action charge"):
        oee.Problem(mdp, log, impossible=drop)
    good = oee.Transitions([1, 0], [1, 1], [1, 1])
    problem = oee.Problem(mdp, good, impossible=drop)
    assert problem.counts.sum() == 2
    with pytest.raises(ArgumentError, match=r"^episodes\[2\] .* high action charge"):
        oee.Problem(mdp, good, episodes=log, impossible=drop)
    for counts in (log.counts(2, 3), oee.data.TransitionCounts.of(log.counts(2, 3), 3)):
        with pytest.raises(ArgumentError, match=r"high action charge cannot be"):
            oee.Problem(mdp, counts, impossible=drop)
    with pytest.raises(ArgumentError, match=r"high action charge cannot be"):
        oee.transition_ratio(log, mdp)
    share = np.full((2, 3), 1 / 6)
    for call in (
        lambda: oee.sample_transitions(mdp, share, 3, seed=0),
        lambda: oee.efficiency_bound(mdp, oee.uniform_policy(mdp), share),
    ):
        with pytest.raises(ArgumentError, match=r"distribution\[0, 0\] must be 0"):
            call()


def test_what_cannot_be_taken_does_not_count_as_never_recorded():
    mdp = two_states()
    log = oee.sample_episodes(mdp, oee.uniform_policy(mdp), 20, 10, seed=0)
    assert "5 of 5 pairs recorded" in repr(oee.transition_ratio(log, mdp))
    problem = oee.Problem(mdp, log)
    report = oee.evaluate(problem, oee.uniform_policy(mdp), seed=0)
    assert "It has every state-action pair of them" in Page(report.to_html()).text
    kept = log.action != 0
    some = oee.Transitions(log.state[kept], log.action[kept], log.next_state[kept])
    part = oee.Problem(mdp, some)
    report = oee.evaluate(part, oee.uniform_policy(mdp), seed=0)
    assert "It lacks 1 of their 5 state-action pairs" in Page(report.to_html()).text


def test_target_and_simulator_have_the_same_actions():
    mdp = two_states()
    other = two_states(available=[[0, 1, 1], [1, 1, 0]], transitions=_without(1, 2))
    for call in (
        lambda: oee.true_ratio(mdp, other),
        lambda: oee.true_ratio(other, mdp),
        lambda: oee.estimators.Oracle(other).limit(mdp, other, [1, 1]),
    ):
        with pytest.raises(ArgumentError, match=r"^target must .* low action wait"):
            call()


def _without(state, action):
    transitions = two_states().transitions.toarray().reshape(2, 3, 2)
    transitions[state, action] = 0.0
    return transitions


# ---------------------------------------------------------------- environments


def table_of(mdp):
    """A toy-text table of an MDP that has no entries for what cannot be taken."""
    return {
        s: {
            a: [
                (float(p), int(to), float(mdp.rewards[s, a]), False)
                for to, p in enumerate(
                    mdp.transitions[[s * mdp.n_actions + a]].toarray()[0]
                )
                if p > 0
            ]
            for a in range(mdp.n_actions)
            if mdp.available[s, a]
        }
        for s in range(mdp.n_states)
    }


class Stepped:
    """An MDP as an environment that can only be stepped, with masks in its info."""

    def __init__(self, mdp, has_masks=True, n_seed=0):
        from gymnasium import spaces

        self.mdp = mdp
        self.has_masks = has_masks
        self.observation_space = spaces.Discrete(mdp.n_states)
        self.action_space = spaces.Discrete(mdp.n_actions)
        self.random = np.random.default_rng(n_seed)
        self.state = 0

    def info(self):
        mask = self.mdp.available[self.state].astype(np.int8)
        return {"action_mask": mask} if self.has_masks else {}

    def reset(self, *, seed=None, options=None):
        self.state = int(self.random.choice(self.mdp.n_states, p=self.mdp.initial))
        return self.state, self.info()

    def step(self, action):
        if not self.mdp.available[self.state, action]:
            raise LookupError("this action cannot be taken here")
        row = self.mdp.transitions[[self.state * self.mdp.n_actions + action]]
        reward = float(self.mdp.rewards[self.state, action])
        self.state = int(self.random.choice(self.mdp.n_states, p=row.toarray()[0]))
        return self.state, reward, False, False, self.info()


@given(testing.mdps(allow_unavailable=True, rewards=("sa",), discounts=(0.9,)))
def test_tables_without_some_actions(mdp):
    used = mdp.available.any(axis=0)
    env = SimpleNamespace(P=table_of(mdp), initial_state_distrib=mdp.initial)
    if not used[: int(used.nonzero()[0].max()) + 1].all():
        with pytest.raises(ArgumentError, match=r"env\.P must have each action"):
            FiniteMDP.from_gymnasium(env)
        return
    read = FiniteMDP.from_gymnasium(env, discount=0.9)
    n = read.n_actions  # actions at the end that no state has are not in the table
    assert_array_equal(read.available, mdp.available[:, :n])
    assert_allclose(read.rewards, mdp.rewards[:, :n])
    listed = [[env.P[s].get(a, []) for a in range(n)] for s in range(mdp.n_states)]
    same = FiniteMDP.from_gymnasium(
        SimpleNamespace(P=listed, initial_state_distrib=mdp.initial)
    )
    assert_array_equal(same.available, read.available)


@settings(max_examples=10)
@given(
    testing.mdps(
        allow_unavailable=True, rewards=("sa",), discounts=(0.9,), absorbing=False
    )
)
def test_masks_of_an_environment_that_is_stepped(mdp):
    sampled = FiniteMDP.from_env(Stepped(mdp), samples_per_pair=2, seed=0)
    met = sampled.sampling.pairs.reshape(mdp.rewards.shape)
    is_met = (np.isfinite(met) & (met > 0)).any(axis=1)
    assert_array_equal(sampled.available[is_met], mdp.available[is_met])
    assert_allclose(sampled.rewards[is_met], mdp.rewards[is_met])


def test_taxi_leaves_out_what_changes_nothing():
    """The best way is the same with the masks; a drive into a wall is refused."""
    env = oee.tasks.make_environment("Taxi-v4")
    free = FiniteMDP.from_gymnasium(env, discount=0.95)
    masked = FiniteMDP.from_gymnasium(env, discount=0.95, masked=True)
    assert free.has_all_actions
    own = masked.available[:500]
    assert_array_equal(own[3], env.unwrapped.action_mask(3).astype(bool))
    assert masked.available[500:].all()  # twins
    best = oee.optimal_policy(masked)
    assert_allclose(
        oee.policy_value(masked, best),
        oee.policy_value(free, oee.optimal_policy(free)),
        rtol=1e-9,
    )
    gain = oee.policy_value(masked, oee.uniform_policy(masked)) - oee.policy_value(
        free, oee.uniform_policy(free)
    )
    assert gain > 1.0
    log = oee.sample_episodes(free, oee.uniform_policy(free), 3, 40, seed=0)
    with pytest.raises(
        ArgumentError, match=r"^log\[\d+\] must have an action that can"
    ):
        oee.Problem(masked, log)
    lake = oee.tasks.make_environment("FrozenLake-v1")
    with pytest.raises(
        ArgumentError, match=r"^masked must be False .* no action_mask|it"
    ):
        FiniteMDP.from_gymnasium(lake, masked=True)


def test_bad_masks_are_named():
    mdp = two_states()

    class Odd(Stepped):
        def __init__(self, masks, in_reset=True):
            super().__init__(mdp)
            self.masks = list(masks)
            self.in_reset = in_reset

        def info(self):
            return {"action_mask": self.masks.pop(0) if self.masks else [0, 1, 1]}

    for masks, text in (
        ([[0, 0, 0]], r"must allow an action in state 0"),
        ([[0, 1]], r"^env\.reset: info\[.action_mask.\] must be 3 numbers 0 or 1"),
        ([[0, 1, 2]], r"must be 3 numbers 0 or 1"),
        ([[0, 1, 1]] * 2 + [[0, 0, 1]] * 20, r"must be the same whenever state"),
    ):
        env = Odd(masks)
        env.mdp = two_states(transitions=np.full((2, 3, 2), 0.5), available=None)
        with pytest.raises(ArgumentError, match=text):
            FiniteMDP.from_env(env, samples_per_pair=3, seed=0)
    silent = Stepped(two_states(), has_masks=False)
    with pytest.raises(ArgumentError, match=r"must not raise; .*cannot be taken here"):
        FiniteMDP.from_env(silent, samples_per_pair=1, seed=0)
    whole = Stepped(two_states(transitions=np.full((2, 3, 2), 0.5), available=None))
    whole.info = lambda: {"action_mask": [0, 1, 1]}
    every = FiniteMDP.from_env(whole, samples_per_pair=1, seed=0, masked=False)
    assert every.has_all_actions


def test_a_log_s_own_mdp():
    """Pairs that cannot be taken are not filled in by the state's other actions."""
    log = oee.Transitions(
        [0, 0, 1, 1], [1, 2, 0, 1], [1, 0, 0, 1], [1.0, 1.0, 2.0, 2.0]
    )
    with pytest.warns(UserWarning, match="1 state-action pairs were never recorded"):
        mdp = FiniteMDP.from_log(
            log, initial=0, available=[[0, 1, 1], [1, 1, 1]], discount=0.9
        )
    assert_array_equal(mdp.available, [[False, True, True], [True] * 3])
    assert_allclose(mdp.transitions.toarray()[5], [0.5, 0.5])
    with pytest.raises(ArgumentError, match=r"^log\[0\] .* state 0 action 1 cannot"):
        FiniteMDP.from_log(log, initial=0, available=[[1, 0, 1], [1, 1, 1]])
    with pytest.raises(ArgumentError, match=r"^available must have shape \(2, 3\)"):
        FiniteMDP.from_log(log, initial=0, available=[[1, 1], [1, 1]])

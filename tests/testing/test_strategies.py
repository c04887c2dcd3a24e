"""The strategies keep their promises, and shrink to what one would write down."""

import re

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, find, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import oee_tabular as oee
from oee_tabular.testing import as_code, horizons, logs, mdp_pairs, mdps, policies

QUICK = settings(
    max_examples=25, suppress_health_check=[HealthCheck.too_slow], deadline=None
)
ENDLESS = oee.FiniteMDP(np.ones((1, 1, 1)), [1.0], [1.0], 1.0)
GRID = oee.tasks.gridworld(2, 0.3)


def smallest(strategy, condition=lambda drawn: True, **options):
    phases = [Phase.generate, Phase.shrink]
    chosen = {
        "max_examples": 1000,
        "database": None,
        "derandomize": True,
        "phases": phases,
    } | options
    return find(strategy, condition, settings=settings(**chosen))


@QUICK
@given(st.data())
def test_everything_drawn_can_be_evaluated(data):
    """Validity is the constructors' business: what is drawn passes them, and every
    horizon that is offered exists.
    """
    mdp = data.draw(mdps())
    policy = data.draw(policies(mdp))
    assert np.isfinite(oee.policy_value(mdp, policy, horizon=data.draw(horizons(mdp))))
    assert policy.shape == (mdp.n_states, mdp.n_actions)
    assert_allclose(policy.sum(axis=1), 1.0)
    assert mdp.discount < 1.0 or (
        mdp.absorbing()[-1] and np.all(mdp.transitions.toarray()[:, -1] > 0)
    )
    assert np.all(data.draw(policies(mdp, zeros=False)) > 0)


@QUICK
@given(
    mdps(
        min_states=2,
        max_states=3,
        max_actions=2,
        discounts=(0.5,),
        rewards=("sa",),
        absorbing=True,
    )
)
def test_options_are_kept(mdp):
    assert mdp.n_states in (2, 3)
    assert mdp.n_actions in (1, 2)
    assert mdp.discount == 0.5
    assert mdp.transition_rewards is None
    assert mdp.absorbing()[-1]


@pytest.mark.parametrize("support", ["equal", "inside", "violated"])
def test_pairs_have_the_support_that_was_asked_for(support):
    @QUICK
    @given(mdp_pairs(support=support, max_states=4, max_actions=2))
    def check(pair):
        simulator, target = pair
        here, there = (mdp.transitions.toarray() > 0 for mdp in pair)
        for name in (
            "rewards" if simulator.transition_rewards is None else "initial",
            "initial",
            "discount",
        ):
            assert_array_equal(getattr(simulator, name), getattr(target, name))
        if support == "violated":
            rows, _ = np.nonzero(there & ~here)
            assert np.any(simulator.initial[rows // simulator.n_actions] > 0)
            with pytest.raises(ValueError, match="probability 0"):
                oee.true_ratio(target, simulator)
        else:
            assert not np.any(there & ~here)
            assert support == "inside" or np.all(there == here)
            oee.true_ratio(target, simulator)
        for mdp in pair:
            assert np.isfinite(oee.policy_value(mdp, oee.uniform_policy(mdp)))

    check()


@QUICK
@given(st.data())
def test_logs_are_of_their_mdp(data):
    mdp = data.draw(mdps(max_states=4))
    behavior = data.draw(policies(mdp))
    kind = data.draw(st.sampled_from(["episodes", "transitions"]))
    log = data.draw(
        logs(mdp, kind=kind, behavior_policy=behavior, max_episodes=3, max_steps=4)
    )
    assert 1 <= len(log) <= 12
    assert np.all(
        mdp.transitions.toarray()[
            log.state * mdp.n_actions + log.action, log.next_state
        ]
        > 0
    )
    assert_array_equal(log.behavior_probability, behavior[log.state, log.action])
    assert np.all(log.behavior_probability > 0)
    assert oee.Problem(mdp, log).reward_conflict is None
    assert (log.episode is None) == (kind == "transitions")
    if kind == "episodes":
        starts = log.episode_starts
        assert log.n_episodes <= 3
        assert np.diff(starts).max() <= 4
        assert np.all(mdp.initial[log.state[starts[:-1]]] > 0)
        assert_array_equal(log.terminated, mdp.absorbing()[log.next_state])


@pytest.mark.parametrize(
    "condition",
    [
        lambda m: m.transitions.nnz < m.n_states**2 * m.n_actions,
        lambda m: m.transition_rewards is not None,
        lambda m: m.discount == 1.0,
        lambda m: m.n_states == 1 and m.n_actions == 3,
        lambda m: m.absorbing().any() and not m.absorbing().all(),
        lambda m: (
            m.n_states == 2
            and len(np.unique(m.transitions.data)) == 1
            and m.transitions.nnz == 4
        ),
    ],
)
def test_exact_zeros_ties_and_every_form_are_there(condition):
    smallest(mdps(), condition, phases=[Phase.generate])


def test_examples_shrink_to_the_simplest():
    simplest = smallest(mdps(), max_examples=20)
    assert (
        simplest.n_states,
        simplest.n_actions,
        simplest.discount,
        simplest.rewards,
    ) == (1, 1, 0.0, 0.0)
    branching = smallest(
        mdps(max_states=3, max_actions=2),
        lambda m: m.transitions.nnz > m.n_states * m.n_actions,
    )
    assert (branching.n_states, branching.n_actions) == (2, 1)
    assert_allclose(branching.transitions.data, 0.5)
    simulator, _ = smallest(
        mdp_pairs(support="violated", max_states=3, max_actions=2), max_examples=20
    )
    assert (simulator.n_states, simulator.n_actions) == (2, 1)
    assert len(smallest(logs(branching), lambda log: log.n_episodes == 2)) == 2


def test_no_rewards_either_kind_and_any_behaviour():
    unshrunk = {"phases": [Phase.generate]}
    assert smallest(logs(GRID, rewards=False), **unshrunk).reward is None
    assert (
        smallest(
            logs(GRID, kind=None), lambda log: log.episode is None, **unshrunk
        ).timestep
        is None
    )
    assert np.all(smallest(logs(GRID), **unshrunk).behavior_probability == 0.25)
    with pytest.raises(Exception, match=r"[Nn]o"):
        smallest(horizons(ENDLESS), lambda horizon: horizon is None)


# ---- what is drawn, as code


def same(one, two):
    """Return whether two objects are of one kind and have the same arrays."""
    if isinstance(one, np.ndarray):
        return one.dtype == two.dtype and np.array_equal(
            one, two, equal_nan=one.dtype.kind == "f"
        )
    if isinstance(one, oee.Transitions):
        mine, others = one.columns(), two.columns()
        return list(mine) == list(others) and all(
            same(mine[name], others[name]) for name in mine
        )
    names = ("rewards", "initial", "terminal_state", "layout")
    tables = [one.transitions != two.transitions]
    if one.transition_rewards is not None:
        tables.append(one.transition_rewards != two.transition_rewards)
    return (
        one.discount == two.discount
        and one.state_names == two.state_names
        and one.action_names == two.action_names
        and (one.transition_rewards is None) == (two.transition_rewards is None)
        and not any(table.nnz for table in tables)
        and all(
            (getattr(one, name) is None and getattr(two, name) is None)
            or same(getattr(one, name), getattr(two, name))
            for name in names
        )
    )


def run_code(text):
    return eval(text, {"np": np, "oee": oee})


@QUICK
@given(st.data())
def test_code_evaluates_to_an_equal_object(data):
    mdp = data.draw(mdps())
    for value in (
        mdp,
        data.draw(policies(mdp)),
        data.draw(logs(mdp, kind=None, rewards=data.draw(st.booleans()))),
    ):
        assert same(run_code(as_code(value)), value)


@pytest.mark.parametrize(
    "value",
    [
        GRID,
        ENDLESS,
        # r(s, a, s') that is undefined, names, where termination leads, a layout
        oee.FiniteMDP(
            [[[0.5, 0.5]], [[0.0, 1.0]]],
            [[[1.0, -2.5]], [[np.nan, 0.1 + 0.2]]],
            [1 / 3, 2 / 3],
            1.0,
            terminal_state=[1, 1],
            state_names=["a hall's", 'the "roof"'],
            action_names=[("up", 1)],
        ),
        GRID.with_transitions(GRID.transitions),
        oee.Transitions(["hall", "roof"], ["up", "down"], ["roof", "hall"]),
        oee.Transitions([0], [0], [1], [np.nan], episode=[7], timestep=[0]),
        np.array([], dtype=np.int64),
        np.array([[True, False]]),
        np.array([1, 2], dtype=np.float32),
        np.array([np.inf, -np.inf, np.nan, -0.0]),
    ],
    ids=repr,
)
def test_code_of_every_form(value):
    assert same(run_code(as_code(value)), value)


@pytest.mark.parametrize(
    "value",
    [
        *(3, -1.5, None, True, "x", (1,), [1.0, None], {"a": 1}),
        *(10**4000, -(3**20000), range(5), range(10**12), range(9, 0, -2)),
    ],
    ids=lambda value: type(value).__name__,
)
def test_code_of_plain_values(value):
    assert run_code(as_code(value)) == value


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (oee.tasks.gridworld(5, 0.3), "at most 400 numbers .*; it has 2500 prob"),
        (np.zeros(401), "at most 400 numbers .*; it has 401"),
        (
            oee.Transitions([0] * 65, [0] * 65, [1] * 65),
            "at most 64 rows .*; it has 65",
        ),
        (object(), "must be an MDP, a log, an array or a plain value; got 'object'"),
    ],
)
def test_code_of_what_is_too_large_or_something_else(value, text):
    with pytest.raises(ValueError, match=f"value must .*{text}|value {text}"):
        as_code(value)


def blended(problem, policy):
    """Wrong: a thirtieth of the simulator's rows, however many transitions there are."""
    counts = problem.counts.toarray()
    totals = counts.sum(axis=1, keepdims=True)
    rows = np.where(
        totals > 0,
        counts / np.maximum(totals, 1),
        problem.simulator.transitions.toarray(),
    )
    rows = 0.97 * rows + 0.03 * problem.simulator.transitions.toarray()
    simulator = problem.simulator
    model = simulator.with_transitions(
        rows.reshape(simulator.n_states, simulator.n_actions, -1)
    )
    return oee.policy_value(model, policy, horizon=problem.horizon)


def breaks(simulator, target, policy, log):
    """Return whether, on exact counts, the blend is off; the log only has to be one."""
    oee.Problem(simulator, log)
    counts = 1e9 * target.transitions
    value = blended(oee.Problem(simulator, counts), policy)
    return abs(value - oee.policy_value(target, policy)) > 1e-6


def test_a_shrunk_counterexample_is_printed_as_code_that_breaks_the_law():
    @settings(
        max_examples=200,
        derandomize=True,
        database=None,
        deadline=None,
        print_blob=False,
        phases=[Phase.generate, Phase.shrink],
    )
    @given(st.data())
    def law(data):
        simulator, target = data.draw(mdp_pairs(discounts=(0.5,), max_states=3))
        policy = data.draw(policies(simulator))
        log = data.draw(logs(target))
        assert not breaks(simulator, target, policy, log)

    with pytest.raises(AssertionError) as caught:
        law()
    notes = "\n".join(caught.value.__notes__)
    drawn = re.split(r"^ *Draw \d+: ", notes, flags=re.M)[1:]
    pair, policy, log = (run_code(text.strip()) for text in drawn)
    assert breaks(*pair, policy, log)
    assert pair[0].n_states == 2
    assert len(notes) < 3000

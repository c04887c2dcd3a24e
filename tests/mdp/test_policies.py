"""The forms of a policy: an action a state, by number or name; a mapping; a function;
several of them.
"""

import math
import re
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from helpers import NAMED, PLAIN
from numpy.testing import assert_array_equal
from scipy import sparse

import oee_tabular as oee
from oee_tabular.mdp import check_policy
from oee_tabular.mdp.horizons import horizon_length, limit_horizon
from oee_tabular.mdp.policies import check_policies

SUM_TOLERANCE = 1e-8  # of a row's sum
LOG = oee.Transitions(
    [0, 1, 0], [0, 0, 1], [1, 2, 0], [-1.0, -1, -1], episode=[0, 0, 1]
)


FORMS = [
    {"hall": "go", ("room", 1): "stay"},
    {0: 0, 1: 1, 2: [0.5, 0.5]},
    {
        "hall": {"go": 1.0},
        "('room', 1)": (0.0, 1.0),
        "dock": np.array([0.5, 0.5], dtype=np.float32),
    },
    lambda state: {"hall": 0, ("room", 1): "stay"}.get(state),
    lambda state: None if state == "dock" else np.int64(state != "hall"),
    lambda state: (
        {"go": float(state == "hall"), 1: float(state != "hall")}
        if state != "dock"
        else [0.5, 0.5]
    ),
    (0, 1, 1),
    np.array([0, 1, 1], np.uint8),
    ["go", "stay", "stay"],
    np.array(["go", "stay", "stay"]),
    np.array(["go", "stay", "stay"], object),
]


@pytest.mark.parametrize("k", range(len(FORMS)))
def test_forms_of_one_policy(k):
    """The dock is terminal: a mapping or a function may leave it out."""
    last = [0.5, 0.5] if k < 6 else [0, 1]
    assert_array_equal(check_policy(FORMS[k], NAMED), [[1, 0], [0, 1], last])


def test_a_function_without_names_is_given_numbers():
    seen = []
    check_policy(lambda state: seen.append(state) or 0, PLAIN)
    assert seen == [0, 1, 2]
    assert all(type(state) is int for state in seen)


def test_actions_that_are_called_by_tuples():
    """Moves on a grid; a list of pairs of numbers stays a list of rows."""
    mdp = PLAIN.with_names(None, [(0, 1), (1, 0)])
    assert_array_equal(
        check_policy([(0, 1), (1, 0), (0, 1)], mdp), [[0, 1], [1, 0], [0, 1]]
    )
    assert_array_equal(check_policy({0: (0, 1), 1: [0, 1]}, mdp)[:2], [[1, 0], [0, 1]])
    far = PLAIN.with_names(None, [("x", 1), ("y", 1)])
    assert_array_equal(
        check_policy([("x", 1), ("y", 1), ("y", 1)], far), [[1, 0], [0, 1], [0, 1]]
    )


@pytest.mark.parametrize(
    "call",
    [
        lambda pi: oee.policy_value(NAMED, pi),
        lambda pi: oee.policy_value(NAMED.with_discount(0.9999), pi, horizon=20_000),
        lambda pi: oee.occupancy(NAMED, pi, horizon=5).tolist(),
        lambda pi: oee.return_moments(NAMED, pi, horizon=5).mean,
        lambda pi: oee.sample_episodes(NAMED, pi, 4, 5, seed=0).state.tolist(),
        lambda pi: oee.efficiency_bound(NAMED, pi, np.full((3, 2), 1 / 6)),
        lambda pi: oee.interval(oee.Problem(NAMED, LOG), pi).lower,
        lambda pi: (
            oee.estimators.OffEnvironment()(
                oee.Problem(NAMED, LOG, behavior_policy=pi), pi
            ).value
        ),
        lambda pi: (
            oee.estimators.ImportanceSampling()(
                oee.Problem(NAMED, LOG, 2, np.full((3, 2), 0.5)), pi
            ).value
        ),
        lambda pi: (
            oee.transition_ratio(LOG, NAMED, values_of=pi).values.toarray().tolist()
        ),
        lambda pi: (
            oee.transition_ratio(LOG, NAMED, values_of=[pi, np.full((3, 2), 0.5)])
            .values.toarray()
            .tolist()
        ),
        lambda pi: (
            oee.plan_data_collection(oee.Problem(NAMED, LOG), pi, n=9).next_pairs
        ),
        lambda pi: oee.plan_data_collection(NAMED, {"a": pi}, n=9).next_pairs,
        lambda pi: oee.evaluate(
            oee.Problem(NAMED, LOG), pi, estimators=["oee"], seed=0
        ).records()[0]["value"],
    ],
)
def test_wherever_an_array_is_taken(call):
    """Four forms of one policy, one answer."""
    array = np.array([[1.0, 0], [0, 1], [1, 0]])
    expected = call(array)
    by_state = {"hall": "go", ("room", 1): 1, "dock": 0}
    for form in (
        [0, 1, 0],
        ["go", "stay", "go"],
        by_state,
        lambda s: int(s == ("room", 1)),
    ):
        assert call(form) == expected


def test_environments_other_than_ours_take_actions_too():
    from oee_tabular.tasks import make_environment, record_episodes

    actions = np.arange(16) % 4
    env = make_environment("FrozenLake-v1")
    one, other = (
        record_episodes(env, pi, n_episodes=3, seed=0)
        for pi in (actions, np.eye(4)[actions])
    )
    assert_array_equal(one.state, other.state)


HALVES = [[0.5, 0.5]] * 2


def test_mixtures():
    assert_array_equal(oee.mix([0, 1], HALVES, 0.5), [[0.75, 0.25], [0.25, 0.75]])
    assert_array_equal(
        oee.mix(HALVES, np.array([0, 1]), 0.5), [[0.75, 0.25], [0.25, 0.75]]
    )


def test_one_or_several():
    one = np.array([[1.0, 0], [0, 1], [0, 1]])
    for policies, names in (
        (one, ["policy"]),
        (one.tolist(), ["policy"]),
        ([0, 1, 1], ["policy"]),
        (["go", "stay", "stay"], ["policy"]),
        ({"hall": "go", ("room", 1): "stay", "dock": "stay"}, ["policy"]),
        ({0: 0, 1: 1, 2: 1}, ["policy"]),
        (lambda s: int(s != "hall"), ["policy"]),
        ([one, [0, 1, 1]], ["policy 0", "policy 1"]),
        ([[0, 1, 1], [0, 1, 1]], ["policy 0", "policy 1"]),
        ([lambda s: int(s != "hall")], ["policy 0"]),
        ([{0: 0, 1: 1, 2: 1}], ["policy 0"]),
        ({"a": one, "b": [0, 1, 1]}, ["a", "b"]),
        ({0: one, 1: one}, ["0", "1"]),
        ({"hall": lambda s: int(s != "hall")}, ["hall"]),
        # not rows, since there are two actions
        ([[0, 1, 1]] * 3, ["policy 0", "policy 1", "policy 2"]),
    ):
        found = check_policies(policies, NAMED)
        assert list(found) == names
        for policy in found.values():
            assert_array_equal(policy, one)
    assert check_policies([], NAMED) == check_policies({}, NAMED) == {}


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (0.0, None),
        (0.9 * SUM_TOLERANCE, None),
        (-0.999 * SUM_TOLERANCE, None),
        (1.1 * SUM_TOLERANCE, "must sum to 1"),
        (-1.1 * SUM_TOLERANCE, "must sum to 1"),
        (-1.5, "must be nonnegative; it is -1"),
        (np.nan, "must be finite; it is nan"),
        (np.inf, "must be finite; it is inf"),
    ],
)
def test_the_last_entry_is_checked(change, words, order):
    """Within the tolerance as it is, else refused by its place."""
    given = np.full(
        (PLAIN.n_states, PLAIN.n_actions), 1.0 / PLAIN.n_actions, order=order
    )
    given[-1, -1] += change
    if words is None:
        assert_array_equal(check_policy(given, PLAIN), given)
    else:
        with pytest.raises(ValueError, match=rf"policy\[{PLAIN.n_states - 1}.*{words}"):
            check_policy(given, PLAIN)


# ---- a horizon is followed as far as the discount can show; the rest is said, or
# refused with its cost
TARGET, SIMULATOR = (oee.tasks.gridworld(3, slip) for slip in (0.1, 0.3))
POLICY = oee.uniform_policy(TARGET)
ZETA = oee.true_ratio(TARGET, SIMULATOR)
FAR = 10**9
STEPS_LOG = oee.sample_episodes(TARGET, POLICY, 20, 30, seed=0)

FAR_AND_INFINITE = {
    "policy_value": lambda horizon: oee.policy_value(TARGET, POLICY, horizon=horizon),
    "state_values": lambda horizon: oee.state_values(TARGET, POLICY, horizon=horizon),
    "action_values": lambda horizon: oee.action_values(TARGET, POLICY, horizon=horizon),
    "occupancy": lambda horizon: oee.occupancy(TARGET, POLICY, horizon=horizon),
    "transition_gradient": lambda horizon: oee.exact.transition_gradient(
        TARGET, POLICY, horizon=horizon
    ),
    "variance": lambda horizon: (
        oee.return_moments(TARGET, POLICY, horizon=horizon).variance
    ),
    "a limit": (
        lambda horizon: oee.estimators.Simulator().limit(
            SIMULATOR, TARGET, POLICY, horizon=horizon
        )
    ),
    "an estimate": lambda horizon: (
        oee.estimators.ModelBased()(
            oee.Problem(SIMULATOR, STEPS_LOG, horizon=horizon), POLICY
        ).value
    ),
}


@pytest.mark.parametrize("name", FAR_AND_INFINITE)
def test_far_beyond_the_discount_is_the_infinite_sum(name):
    with pytest.warns(
        UserWarning, match="horizon 1000000000 is followed to step 13803"
    ):
        far = FAR_AND_INFINITE[name](FAR)
    np.testing.assert_allclose(
        far, FAR_AND_INFINITE[name](None), rtol=1e-11, atol=1e-13
    )


@pytest.mark.large
def test_a_late_reward_is_not_cut_off():
    # a corridor: the only reward comes after 12 000 steps, .99^12000 = 4e-53
    n = 12_000
    rows = sparse.csr_array(
        (np.ones(n), (np.arange(n), np.minimum(np.arange(1, n + 1), n - 1))),
        shape=(n, n),
    )
    corridor = oee.FiniteMDP(rows, np.eye(1, n, n - 1)[0], 0, 0.99)
    with pytest.warns(UserWarning, match="is followed to step"):
        far = oee.policy_value(corridor, np.ones((n, 1)), horizon=FAR)
    assert far == pytest.approx(0.99 ** (n - 1) / 0.01, rel=1e-9)


def test_policies_that_change_with_time_are_followed_to_their_end():
    changing = np.repeat(POLICY[None], 10_500, axis=0)
    fast = TARGET.with_discount(0.5)
    assert oee.policy_value(fast, changing, horizon=10_500) == pytest.approx(
        oee.policy_value(fast, POLICY), rel=1e-12
    )


def test_weights_that_outgrow_the_discount_are_not_cut():
    expert = oee.tasks.gridworld_expert(3)
    loop = oee.FiniteMDP(np.ones((1, 2, 1)), [[1.0, 0.0]], [1.0], 0.9)
    with pytest.raises(
        ValueError,
        match=(
            r"horizon must be one that can be carried out; 100000000000 steps take some"
        ),
    ):
        oee.policy_is_moments(loop, [[0.5, 0.5]], [[1.0, 0.0]], horizon=10**11)
    # here the spectral radius is below 1
    with pytest.warns(UserWarning, match="is followed to step"):
        far = oee.weighted_return_moments(SIMULATOR, ZETA, expert, horizon=FAR)
    assert far.variance == pytest.approx(
        oee.weighted_return_moments(SIMULATOR, ZETA, expert).variance, rel=1e-9
    )


def test_at_discount_1_the_cost_is_reported():
    for call in (oee.policy_value, oee.return_moments, oee.occupancy):
        with pytest.raises(
            ValueError,
            match=r"1000000000 steps take some \de\+1\d multiply-adds \(.* hours\)",
        ):
            call(TARGET.with_discount(1.0), POLICY, horizon=FAR)
    with pytest.warns(
        UserWarning, match=r"horizon 20000 takes some 2e\+09 multiply-adds"
    ):
        assert limit_horizon(20_000, 1.0, work=1.2e5) == 20_000


def test_a_horizon_is_followed_until_nothing_can_be_left():
    """The first reward may come after as many steps as there are states; rows that sum
    to more than 1 undo a part of the discount.
    """
    least = math.ceil(200 * math.log(2) / -math.log(0.9))
    with pytest.warns(UserWarning, match=f"is followed to step {20_000 + least}"):
        assert limit_horizon(FAR, 0.9, ahead=20_000) == 20_000 + least
    growing = SimpleNamespace(
        transitions=sparse.csr_array([[1.05]]), discount=0.95, n_states=1
    )
    least = math.ceil(200 * math.log(2) / -math.log(0.95 * 1.05))
    with pytest.warns(UserWarning, match=f"is followed to step {1 + least}"):
        assert horizon_length(FAR, growing) == 1 + least


def test_arrays_with_an_entry_for_each_step_must_fit():
    with pytest.raises(
        ValueError,
        match=r"horizon must be small enough .*; 1000000 needs 7.45e\+03 GiB",
    ):
        limit_horizon(10**6, 1.0, kept=10**6)


def test_sampled_episodes():
    with pytest.warns(UserWarning, match="is followed to step"):
        log = oee.sample_episodes(TARGET, POLICY, 3, FAR, seed=0)
    np.testing.assert_array_equal(
        log.state, oee.sample_episodes(TARGET, POLICY, 3, 10_000, seed=0).state
    )
    endless = oee.FiniteMDP(np.ones((1, 1, 1)), [1.0], [1.0], 0.5)
    # a log of a million is not cut
    assert len(oee.sample_episodes(endless, [[1.0]], 1, 200_000, seed=0)) == 200_000


# ---- what models return
TWO = oee.FiniteMDP(np.full((2, 2, 2), 0.5), np.zeros((2, 2)), 0, 0.9)
THREE = oee.FiniteMDP(np.full((2, 3, 2), 0.5), np.zeros((2, 3)), 0, 0.9)


@pytest.mark.parametrize(
    "rest", [None, 0.0, {}, (), "state", np.zeros(3), [np.zeros((1, 2))], 7.5]
)
@pytest.mark.parametrize(
    "action", [1, np.int64(1), np.uint8(1), np.array(1), np.array([1]), np.array([[1]])]
)
def test_a_tuple_that_begins_with_an_integer_is_an_action_and_a_state(action, rest):
    for mdp in (TWO, THREE):
        wanted = np.eye(mdp.n_actions)[[1, 1]]
        for choice in ((action, rest), (action, rest, 0.5)):
            found = check_policy(lambda s, c=choice: c, mdp)
            assert_array_equal(found, wanted)


@pytest.mark.parametrize("pair", [(1, 0), (0, 1), (np.array(1), np.array([0]))])
def test_two_integers_of_two_actions_are_ambiguous(pair):
    with pytest.raises(
        ValueError, match=r"policy\(0\) must be an action, \(action, st"
    ):
        check_policy(lambda s: pair, TWO)
    # of three actions they are no distribution
    assert_array_equal(
        check_policy(lambda s: pair, THREE), np.eye(3)[[int(pair[0])] * 2]
    )


@pytest.mark.parametrize(
    "choice", [(0.5, 0.5, 0), (0.0, 1), (0.5, None), (True, None), (None, 1)]
)
def test_a_tuple_with_an_integer_or_none_elsewhere_is_no_distribution(choice):
    with pytest.raises(ValueError, match=r"policy\(0\) must be an action"):
        check_policy(lambda s: choice, THREE if len(choice) == 3 else TWO)


@pytest.mark.parametrize(
    "row", [(0.25, 0.75), [1, 0], [1, 0.0], np.array([1, 0]), (np.float32(0.5),) * 2]
)
def test_floats_and_lists_are_distributions(row):
    assert_array_equal(check_policy(lambda s: row, TWO), [list(row)] * 2)


def test_a_tuple_may_begin_with_a_name_or_be_one():
    named = TWO.with_names(action_names=["left", ("turn", 1)])
    for choice in (("left", None), ("turn", 1), (("turn", 1), {})):
        k = int(choice[0] != "left")
        assert_array_equal(
            check_policy(lambda s, c=choice: c, named), np.eye(2)[[k, k]]
        )


def test_tuples_of_numbers_in_a_mapping_are_distributions():
    assert_array_equal(check_policy({0: (1, 0), 1: (0, 1.0)}, TWO), np.eye(2))
    assert_array_equal(
        check_policy({0: (np.array(1), None), 1: (0, 1)}, TWO), [[0, 1], [0, 1]]
    )


@pytest.mark.parametrize(
    "policy",
    [
        [1.0, 0.0],
        [True, False],
        (0.0, 1.0),
        np.array([1.0, 0.0], dtype=np.float32),
        pd.array([1.0, 0.0], dtype="Float64"),
        np.array([True, True]),
    ],
    ids=repr,
)
def test_actions_are_integers_and_the_remedy_makes_them(policy):
    mdp = oee.FiniteMDP(np.full((2, 2, 2), 0.5), np.eye(2), 0, 0.9)
    rule = r"^policy must be integers .* numpy\.asarray\(policy\)\.astype\(int\)"
    with pytest.raises(ValueError, match=rule):
        oee.policy_value(mdp, policy)
    oee.policy_value(mdp, np.asarray(policy).astype(int))
    for choice in (policy[0], np.float32(policy[0])):
        with pytest.raises(ValueError, match=r"an action is an integer: int\(action\)"):
            oee.policy_value(mdp, {0: choice, 1: 0})
    with pytest.raises(ValueError, match="must have shape"):
        oee.policy_value(mdp, [0.5, 0.5])


def test_the_remedies_for_tables_work():
    mdp = oee.FiniteMDP(np.full((2, 2, 2), 0.5), np.eye(2), 0, 0.9)
    polars = pytest.importorskip("polars")
    narwhals = pytest.importorskip("narwhals")
    tables = [pd.DataFrame(np.eye(2)), pd.Series([0, 1]), polars.DataFrame(np.eye(2))]
    tables.append(narwhals.from_native(tables[-1]))
    for policy in tables:
        with pytest.raises(
            ValueError, match="must be an array or a mapping"
        ) as refused:
            oee.policy_value(mdp, policy)
        remedies = re.findall(r"policy\.\w+\(.*?\)", str(refused.value))
        assert remedies
        for remedy in remedies:
            made = eval(remedy, {"policy": policy})
            assert oee.policy_value(mdp, made) == oee.policy_value(mdp, [0, 1])


def frames_of_policies():
    """Yield simulators with frames, each of which holds the policy of ``EXPECTED``."""
    plain = oee.FiniteMDP(np.full((2, 2, 2), 0.5), np.eye(2), 0, 0.9)
    named = plain.with_names(["dock", "hall"], ["go", "wait"])
    table = pd.DataFrame([[0.25, 0.75], [1.0, 0.0]])
    texts = table.set_axis(["0", "1"], axis=1)
    yield plain, table
    yield plain, texts
    yield plain, texts[["1", "0"]]
    yield plain, texts.set_axis(["0", "1"])
    yield plain, texts.iloc[::-1].set_axis(["1", "0"])
    yield plain, texts.assign(state=["0", "1"])
    yield plain, texts.iloc[::-1].assign(state=[1, 0])
    yield plain, texts.astype(str)
    yield plain, table.set_axis(["action_0", "action_1"], axis=1)
    yield plain, table[[1, 0]].set_axis(["a2", "a1"], axis=1)
    yield plain, table.set_axis(["x", "y"], axis=1)
    yield named, table.set_axis(["go", "wait"], axis=1)
    yield named, table.set_axis(["go", "wait"], axis=1)[["wait", "go"]]
    yield named, table.set_axis(["go", "wait"], axis=1).assign(state=["dock", "hall"])
    yield named, texts.set_axis(["dock", "hall"])
    rows = [(s, a, table[a][s]) for s in range(2) for a in range(2)]
    long = pd.DataFrame(rows, columns=["state", "action", "probability"])
    yield plain, long
    yield plain, long.iloc[[2, 0, 1]]
    yield plain, long.astype(str)
    yield plain, long.set_index(["state", "action"])["probability"]


FRAMES = list(frames_of_policies())
CHOICES = [
    pd.Series([1, 0]),
    pd.Series([1.0, 0.0]),
    pd.Series(["1", "0"]),
    pd.Series([1, 0], index=["0", "1"]),
    pd.Series(["0", "1"], index=["1", "0"]),
    pd.DataFrame({"state": [1, 0], "action": [0, 1]}),
    pd.DataFrame({"state": ["1", "0"], "action": ["0", "1"]}),
    pd.DataFrame({"0": [False, True], "1": [True, False]}),
    pd.get_dummies(pd.Series([1, 0])),
    pd.get_dummies(pd.Series(["1", "0"])).assign(state=[0, 1]),
]


def remedies_for(simulator, policy):
    """Return what the calls of the refusal make of a policy."""
    with pytest.raises(ValueError, match="must be an array or a mapping") as refused:
        check_policy(policy, simulator)
    text = str(refused.value)
    advice = text[text.index(" (") + 2 : -1]
    calls = [part.partition(": policy")[2] for part in advice.split("; ")]
    assert calls
    return [eval(f"policy{call}", {"policy": policy}) for call in calls]


@pytest.mark.parametrize("k", range(len(FRAMES)))
def test_the_remedies_for_labels_work(k):
    simulator, policy = FRAMES[k]
    for made in remedies_for(simulator, policy):
        found = check_policy(made, simulator)
        assert found.tolist() == [[0.25, 0.75], [1.0, 0.0]]


@pytest.mark.parametrize("policy", CHOICES)
def test_the_remedies_for_choices_work(policy):
    simulator = FRAMES[0][0]
    for made in remedies_for(simulator, policy):
        assert check_policy(made, simulator).tolist() == [[0, 1], [1, 0]]

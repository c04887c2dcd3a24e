"""The forms of a policy: an action a state, by number or name; a mapping; a function; several of them."""

import numpy as np
import pytest
from helpers import NAMED, PLAIN
from numpy.testing import assert_array_equal

import oee_tabular as oee
from oee_tabular.mdp import check_policy
from oee_tabular.mdp.policies import check_policies

SUM_TOLERANCE = 1e-8  # of a row's sum
LOG = oee.Transitions([0, 1, 0], [0, 0, 1], [1, 2, 0], [-1.0, -1, -1], episode=[0, 0, 1])


FORMS = [
    {"hall": "go", ("room", 1): "stay"},
    {0: 0, 1: 1, 2: [0.5, 0.5]},
    {"hall": {"go": 1.0}, "('room', 1)": (0.0, 1.0), "dock": np.array([0.5, 0.5], dtype=np.float32)},
    lambda state: {"hall": 0, ("room", 1): "stay"}.get(state),
    lambda state: None if state == "dock" else np.int64(state != "hall"),
    lambda state: {"go": float(state == "hall"), 1: float(state != "hall")} if state != "dock" else [0.5, 0.5],
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
    assert_array_equal(check_policy([(0, 1), (1, 0), (0, 1)], mdp), [[0, 1], [1, 0], [0, 1]])
    assert_array_equal(check_policy({0: (0, 1), 1: [0, 1]}, mdp)[:2], [[1, 0], [0, 1]])
    far = PLAIN.with_names(None, [("x", 1), ("y", 1)])
    assert_array_equal(check_policy([("x", 1), ("y", 1), ("y", 1)], far), [[1, 0], [0, 1], [0, 1]])


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
        lambda pi: oee.estimators.OffEnvironment()(oee.Problem(NAMED, LOG, behavior_policy=pi), pi).value,
        lambda pi: oee.estimators.ImportanceSampling()(oee.Problem(NAMED, LOG, 2, np.full((3, 2), 0.5)), pi).value,
        lambda pi: oee.transition_ratio(LOG, NAMED, values_of=pi).values.toarray().tolist(),
        lambda pi: oee.transition_ratio(LOG, NAMED, values_of=[pi, np.full((3, 2), 0.5)]).values.toarray().tolist(),
        lambda pi: oee.plan_data_collection(oee.Problem(NAMED, LOG), pi, n=9).next_pairs,
        lambda pi: oee.plan_data_collection(NAMED, {"a": pi}, n=9).next_pairs,
        lambda pi: oee.evaluate(oee.Problem(NAMED, LOG), pi, estimators=["oee"], seed=0).records()[0]["value"],
    ],
)
def test_wherever_an_array_is_taken(call):
    """Four forms of one policy, one answer."""
    array = np.array([[1.0, 0], [0, 1], [1, 0]])
    expected = call(array)
    by_state = {"hall": "go", ("room", 1): 1, "dock": 0}
    for form in ([0, 1, 0], ["go", "stay", "go"], by_state, lambda s: int(s == ("room", 1))):
        assert call(form) == expected


def test_environments_other_than_ours_take_actions_too():
    from oee_tabular.tasks import make_environment, record_episodes

    actions = np.arange(16) % 4
    env = make_environment("FrozenLake-v1")
    one, other = (record_episodes(env, pi, n_episodes=3, seed=0) for pi in (actions, np.eye(4)[actions]))
    assert_array_equal(one.state, other.state)


HALVES = [[0.5, 0.5]] * 2


def test_mixtures():
    assert_array_equal(oee.mix([0, 1], HALVES, 0.5), [[0.75, 0.25], [0.25, 0.75]])
    assert_array_equal(oee.mix(HALVES, np.array([0, 1]), 0.5), [[0.75, 0.25], [0.25, 0.75]])


def test_one_or_several():
    one = np.array([[1.0, 0], [0, 1], [0, 1]])
    for policies, names in (
        (one, ["policy"]), (one.tolist(), ["policy"]), ([0, 1, 1], ["policy"]), (["go", "stay", "stay"], ["policy"]),
        ({"hall": "go", ("room", 1): "stay", "dock": "stay"}, ["policy"]), ({0: 0, 1: 1, 2: 1}, ["policy"]),
        (lambda s: int(s != "hall"), ["policy"]),
        ([one, [0, 1, 1]], ["policy 0", "policy 1"]), ([[0, 1, 1], [0, 1, 1]], ["policy 0", "policy 1"]),
        ([lambda s: int(s != "hall")], ["policy 0"]), ([{0: 0, 1: 1, 2: 1}], ["policy 0"]),
        ({"a": one, "b": [0, 1, 1]}, ["a", "b"]), ({0: one, 1: one}, ["0", "1"]),
        ({"hall": lambda s: int(s != "hall")}, ["hall"]),
        ([[0, 1, 1]] * 3, ["policy 0", "policy 1", "policy 2"]),  # not rows, since there are two actions
    ):  # fmt: skip
        found = check_policies(policies, NAMED)
        assert list(found) == names
        for policy in found.values():
            assert_array_equal(policy, one)
    assert check_policies([], NAMED) == check_policies({}, NAMED) == {}


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize(
    ("change", "words"),
    [(0.0, None), (0.9 * SUM_TOLERANCE, None), (-0.999 * SUM_TOLERANCE, None), (1.1 * SUM_TOLERANCE, "must sum to 1"),
     (-1.1 * SUM_TOLERANCE, "must sum to 1"), (-1.5, "must be nonnegative; it is -1"), (np.nan, "must be finite; it is nan"),
     (np.inf, "must be finite; it is inf")],
)  # fmt: skip
def test_the_last_entry_is_checked(change, words, order):
    """Within the tolerance as it is, else refused by its place."""
    given = np.full((PLAIN.n_states, PLAIN.n_actions), 1.0 / PLAIN.n_actions, order=order)
    given[-1, -1] += change
    if words is None:
        assert_array_equal(check_policy(given, PLAIN), given)
    else:
        with pytest.raises(ValueError, match=rf"policy\[{PLAIN.n_states - 1}.*{words}"):
            check_policy(given, PLAIN)

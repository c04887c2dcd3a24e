"""Trials: their numbers, their files, and the problems that they fit."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import oee_tabular as oee
from oee_tabular.data import success_simulator
from oee_tabular.exceptions import ArgumentError, DataWarning

GRID = oee.tasks.gridworld(3, 0.3)
LOG = oee.sample_transitions(GRID, np.full((9, 4), 1 / 36), 80, seed=0)


@given(st.integers(1, 60), st.data())
def test_successes_are_returns_of_1_and_0(number, data):
    won = data.draw(st.integers(0, number))
    trials = oee.Trials.from_successes(won, number)
    assert len(trials) == number
    assert trials.mean == pytest.approx(won / number)
    assert trials.number == number
    assert trials.discount == 1.0


@given(
    st.lists(
        st.tuples(st.floats(-5, 5), st.integers(1, 5)), min_size=2, max_size=12
    ).filter(lambda rows: len(rows) > 1)
)
def test_equal_weights_count_for_nothing(rows):
    returns = [value for value, _ in rows]
    plain = oee.Trials(returns)
    weighted = oee.Trials(returns, weight=[2.5] * len(returns))
    assert weighted.number == pytest.approx(plain.number)
    assert weighted.mean == pytest.approx(plain.mean, abs=1e-12)
    assert weighted.variance == pytest.approx(plain.variance, abs=1e-12)
    assert plain.variance == pytest.approx(np.var(returns, ddof=1), abs=1e-12)


def test_a_heavy_trial_leaves_few():
    trials = oee.Trials([1.0, 0.0, 0.0], weight=[98.0, 1.0, 1.0])
    assert trials.mean == pytest.approx(0.98)
    assert 1.0 < trials.number < 1.1


def test_trials_of_several_policies():
    trials = oee.Trials([1.0, 2.0, 3.0], policy=["a", "b", "a"], horizon=4)
    assert trials.names == ("a", "b")
    one = trials.of("a")
    np.testing.assert_array_equal(one.returns, [1.0, 3.0])
    assert one.policy is None
    assert one.horizon == 4


def test_trials_of_one_policy_keep_their_weights():
    trials = oee.Trials([1.0, 2.0, 3.0], policy=["a", "b", "a"], weight=[1.0, 5.0, 3.0])
    one = trials.of("a")
    np.testing.assert_array_equal(one.weight, [1.0, 3.0])
    assert one.mean == pytest.approx(2.5)
    assert one.number == pytest.approx(1.6)


def test_a_table_of_returns(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text("policy,return,weight\na,1.5,1\nb,2,2\n", encoding="utf-8")
    trials = oee.Trials.load(path, horizon=3)
    np.testing.assert_array_equal(trials.returns, [1.5, 2.0])
    np.testing.assert_array_equal(trials.weight, [1.0, 2.0])
    assert trials.names == ("a", "b")
    assert not trials.is_success


@pytest.mark.parametrize("number", ["9" * 400, "9" * 5000, "1e999", "NaN", "[1]"])
def test_a_return_that_is_no_float_is_refused(tmp_path, number):
    path = tmp_path / "eval_info.json"
    path.write_text('{"per_episode": [{"sum_reward": ' + number + "}]}")
    with pytest.raises(ValueError, match=r"^'.*eval_info.json'.* must (be|have) "):
        oee.Trials.load(path, measure="return")


@pytest.mark.parametrize("words", [("1", "0"), ("true", "false"), ("True", "False")])
def test_a_table_of_successes(tmp_path, words):
    path = tmp_path / "t.csv"
    path.write_text("success\n" + "\n".join(words) + "\n", encoding="utf-8")
    trials = oee.Trials.load(path, success=8)
    np.testing.assert_array_equal(trials.returns, [1.0, 0.0])
    assert trials.is_success
    assert trials.success == (8,)


def test_the_measure_chooses_one_of_two_outcomes(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text("success,return\n1,7\n0,3\n", encoding="utf-8")
    assert oee.Trials.load(path).is_success
    returns = oee.Trials.load(path, measure="return", discount=0.9)
    np.testing.assert_array_equal(returns.returns, [7.0, 3.0])


def test_other_columns_are_not_read(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text("success,operator\n1,ann\n0,bob\n", encoding="utf-8")
    with pytest.warns(DataWarning, match="operator"):
        oee.Trials.load(path)


NEW = {
    "per_task": [
        {
            "task_group": "libero_10",
            "task_id": k,
            "metrics": {
                "sum_rewards": [1.0, 0.5 * k],
                "max_rewards": [1.0, 0.0],
                "successes": [True, bool(k)],
            },
        }
        for k in range(2)
    ],
    "overall": {"pc_success": 75.0, "n_episodes": 4},
}
OLD = {
    "per_episode": [
        {"episode_ix": 0, "sum_reward": 2.0, "success": True, "seed": 1},
        {"episode_ix": 1, "sum_reward": 0.0, "success": False, "seed": 2},
    ],
    "aggregated": {"pc_success": 50.0},
}


def written(path, content):
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


def test_the_older_form_of_lerobot(tmp_path):
    path = written(tmp_path / "eval_info.json", OLD)
    np.testing.assert_array_equal(oee.Trials.load(path).returns, [1.0, 0.0])
    returns = oee.Trials.load(path, measure="return")
    np.testing.assert_array_equal(returns.returns, [2.0, 0.0])
    assert returns.discount == 1.0


def test_the_newer_form_of_lerobot_has_tasks(tmp_path):
    path = written(tmp_path / "eval_info.json", NEW)
    with pytest.raises(ArgumentError, match="'libero_10/0', 'libero_10/1'"):
        oee.Trials.load(path)
    trials = oee.Trials.load(path, task="libero_10/1")
    np.testing.assert_array_equal(trials.returns, [1.0, 1.0])
    one = written(tmp_path / "one.json", NEW | {"per_task": NEW["per_task"][:1]})
    assert oee.Trials.load(one).mean == 0.5


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ([], "eval_info.json of LeRobot"),
        ({"overall": {}}, "it has .overall"),
        ({"per_episode": []}, "no return of any episode"),
        ({"per_episode": [{"success": 2}]}, "true or false as its success"),
        ({"per_episode": [{"success": None}]}, "true or false"),
        ({"per_episode": [3]}, "eval_info.json"),
        ({"per_task": [{"metrics": 1}]}, "eval_info.json"),
        ({"per_task": []}, "must name one of the 0 tasks"),
    ],
)
def test_other_json_is_refused(tmp_path, content, says):
    path = written(tmp_path / "x.json", content)
    with pytest.raises(ArgumentError, match=says):
        oee.Trials.load(path)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("outcome\n1\n", "must have the column success or return; it has 'outcome'"),
        ("sucess\n1\n", r"it has 'sucess' \(is 'sucess' success\?"),
        ("retrun,policy\n1,a\n", r"is 'retrun' return\?"),
        ("return,polcy\n1,a\n", "'polcy' resembles policy"),
        ("success,Wieght\n1,2\n", "'Wieght' resembles weight"),
        ("return,weights\n1,2\n", "'weights' resembles weight"),
        ("success\n", "at least one trial"),
        ("success,wieght,height\n1,2,3\n", "'wieght' resembles weight"),
        ("success\n1\n2\n", r"row 1 \(line 3\) must have 1 or 0"),
        ("success\n1\nmaybe\n", r"row 1 \(line 3\)"),
        ("return\n1\nx\n", r"row 1 \(line 3\) must have a finite number in return"),
        ("return\ninf\n2\n", r"row 0 \(line 2\)"),
        ("return,weight\n1,0\n", "positive weight"),
        ("return,weight\n1,-2\n", "positive weight"),
        ("return,policy\n1,\n", "a name in policy"),
    ],
)
def test_bad_tables_are_refused_with_the_row(tmp_path, text, says):
    path = tmp_path / "t.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ArgumentError, match=says):
        oee.Trials.load(path)


def test_the_success_simulator_counts_paths():
    """A chain 0 -> 1 -> 2 with stays: success within two steps."""
    stay = 0.25
    P = np.zeros((3, 1, 3))
    P[0, 0, :2] = stay, 1 - stay
    P[1, 0, 1:] = stay, 1 - stay
    P[2, 0, 0] = 1.0  # it would begin again
    mdp = oee.FiniteMDP(P, [5.0, 1.0, 2.0], 0, 0.9, state_names=["a", "b", "c"])
    reach = success_simulator(mdp, "c")
    assert reach.discount == 1.0
    values = [oee.policy_value(reach, [0, 0, 0], horizon=t) for t in (1, 2, 3)]
    exact = [0.0, 0.75**2, 0.75**2 * (1 + 2 * stay)]
    np.testing.assert_allclose(values, exact, atol=1e-15)
    again = oee.Trials.from_successes(1, 2, success=["c"])
    log = oee.sample_episodes(reach, [0, 0, 0], 5, 6, seed=0)
    assert oee.Problem(reach, log, horizon=3, trials=again).trials is again


@given(st.integers(0, 50))
def test_the_value_of_a_success_simulator_is_a_probability(seed):
    rng = np.random.default_rng(seed)
    P = rng.dirichlet(np.ones(5), (5, 2))
    mdp = oee.FiniteMDP(P, rng.normal(size=(5, 2, 5)), 0, 0.9)
    reach = success_simulator(mdp, [3, 4])
    policy = rng.integers(0, 2, 5)
    # without success, the mass that is still among 0, 1, 2
    left = np.eye(5)[0]
    K = P[np.arange(5), policy]
    for _ in range(4):
        left = (left * np.isin(np.arange(5), [3, 4], invert=True)) @ K
        left[3:] = 0.0
    value = oee.policy_value(reach, policy, horizon=4)
    assert value == pytest.approx(1.0 - left.sum(), abs=1e-12)


def problem(trials, simulator=GRID, log=LOG, **options):
    return oee.Problem(simulator, log, trials=trials, **options)


def test_trials_of_another_quantity_are_refused():
    reach = success_simulator(GRID, 8)
    log = oee.sample_episodes(reach, oee.uniform_policy(reach), 9, 9, seed=0)
    won = oee.Trials.from_successes(9, 12)
    cases = [
        (lambda: problem(won), "a success counts 1 at discount 1, .* discount 0.99"),
        (
            lambda: problem(won, GRID.with_discount(1.0), horizon=9),
            "pay 1 on entering terminal states",
        ),
        (
            lambda: problem(
                oee.Trials.from_successes(1, 2, success=7), reach, log, horizon=9
            ),
            "trials.success must be the states",
        ),
        (
            lambda: problem(
                oee.Trials.from_successes(1, 2, horizon=5), reach, log, horizon=9
            ),
            "trials.horizon must be the problem's, 9; it is 5",
        ),
        (
            lambda: problem(oee.Trials([-1.0], discount=1.0)),
            "trials.discount must be the problem's, 0.99; it is 1",
        ),
        (lambda: problem(oee.Trials([-1.0], horizon=5)), "trials.horizon"),
        (lambda: problem(oee.Trials([-1.0, -1e6])), r"trials.returns\[1\] must be in"),
        (lambda: problem(oee.Trials([3.0])), r"trials.returns\[0\] must be in"),
        (
            lambda: problem(oee.Trials([-1.0], policy=np.ones((2, 4)) / 4)),
            "trials.policy must have shape",
        ),
    ]
    for call, says in cases:
        with pytest.raises(ArgumentError, match=says):
            call()
    assert problem(won, reach, log, horizon=9).trials is won


@pytest.mark.parametrize(
    "label", ["height", "eight", "police", "weighted", "policy_id"]
)
def test_words_near_a_column_s_label_are_columns_that_are_not_read(tmp_path, label):
    path = tmp_path / "t.csv"
    path.write_text(f"success,{label}\n1,2\n0,3\n", encoding="utf-8")
    with pytest.warns(oee.exceptions.DataWarning, match=f"not read: .{label}"):
        assert oee.Trials.load(path).number == 2

"""--trials and --success: they are Python's, and what they refuse."""

import json

import pytest

import oee_tabular as oee
from oee_tabular.data import success_simulator

DATA = "--simulator sim.npz --log log.csv --policy mine=expert --horizon 6"


def both(told):
    return next(row for row in told["results"] if row["estimator"] == "oee+trials")


def test_successes_are_those_of_python(run, folder):
    told = json.loads(run(f"evaluate {DATA} --trials 9/12 --success r2c2 --json"))
    simulator = success_simulator(oee.FiniteMDP.load("sim.npz"), "r2c2")
    log = oee.Transitions.load("log.csv").columns() | {"reward": None}
    trials = oee.Trials.from_successes(9, 12)
    problem = oee.Problem(simulator, oee.Transitions(**log), horizon=6, trials=trials)
    policy = oee.optimal_policy(oee.FiniteMDP.load("sim.npz").with_discount(0.99))
    found = oee.inference.join_trials(problem, policy)
    assert both(told)["value"] == pytest.approx(found.value)
    assert both(told)["lower"] == pytest.approx(found.interval.lower)
    assert told["trials"][0]["more_trials"] == pytest.approx(found.more_trials)
    assert told["warnings"] == [] or "rewards" not in str(told["warnings"])
    assert told["facts"]["trials"] == "9 of 12 succeeded (“mine”)"
    by_number = json.loads(run(f"evaluate {DATA} --trials 9/12 --success 8 --json"))
    assert both(by_number) == both(told)


def test_a_table_of_returns_of_two_policies(run, folder):
    (folder / "t.csv").write_text(
        "policy,return\nmine,-3\nmine,-4\nother,-4.5\nmine,-2.5\n", encoding="utf-8"
    )
    told = json.loads(
        run(f"evaluate {DATA} --policy other=uniform --trials t.csv --json")
    )
    assert [row["policy"] for row in told["trials"]] == ["mine", "other"]
    assert [row["number"] for row in told["trials"]] == [3.0, 1.0]
    error = run(f"evaluate {DATA} --trials t.csv", code=2)
    assert "a policy that is evaluated ('mine'); it is 'other'" in error


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (
            "--trials 13/12 --success 8",
            "--trials must be SUCCESSES/TRIALS with at most",
        ),
        ("--trials 0/0 --success 8", "--trials must be SUCCESSES/TRIALS with at most"),
        ("--trials 9/12", "a success counts 1 at discount 1"),
        ("--trials 9of12", "--trials must be SUCCESSES/TRIALS, as 9/12, or a .csv"),
        ("--trials nowhere.csv", "no such file: nowhere.csv"),
        ("--trials 9/12 --success r9c9", "--success"),
        (
            "--trials 9/12 --success r0c0",
            "--success must be states in which no episode",
        ),
        (
            "--trials 9/12 --success 8 --discount 0.9",
            "--discount must be 1 or left out",
        ),
        ("--trials 9/12 --success 8 --rewards log", "--rewards must be simulator with"),
    ],
)
def test_what_is_refused(run, folder, words, says):
    assert says in run(f"evaluate {DATA} {words}", code=2)


def test_counts_that_are_a_file_are_refused(run, folder):
    (folder / "9").mkdir()
    (folder / "9" / "12").write_text("success\n1\n", encoding="utf-8")
    error = run(f"evaluate {DATA} --trials 9/12 --success 8", code=2)
    assert (
        "--trials must be clear: '9/12' are counts, and a file has this name" in error
    )


def test_the_example_and_continuous_tasks_take_no_trials(run):
    assert "--trials needs --simulator" in run("evaluate --trials 9/12", code=2)


def test_counts_of_a_log_lose_their_rewards_too(run, folder):
    run("counts log.csv --simulator sim.npz --output counts.npz")
    words = DATA.replace("log.csv", "counts.npz")
    told = json.loads(run(f"evaluate {words} --trials 9/12 --success 8 --json"))
    whole = json.loads(run(f"evaluate {DATA} --trials 9/12 --success 8 --json"))
    assert both(told)["value"] == pytest.approx(both(whole)["value"])
    assert "rewards contradict" not in str(told["warnings"])

"""The commands of values: what they print is what Python's functions give."""

import json
import warnings
from html import unescape

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

import oee_tabular as oee
from oee_tabular.cli import main

UNIFORM = np.full((9, 4), 0.25)
DATA = "--simulator sim.npz --log log.csv"


def problem(**options):
    return oee.Problem(
        oee.FiniteMDP.load("sim.npz"), oee.Transitions.load("log.csv"), **options
    )


def test_without_arguments_it_runs_the_paper_s_grid(run, tmp_path):
    out = run("evaluate --output out")
    for word in (
        "10% expert",
        "90% expert",
        "simulator says",
        "3,162 transitions",
        "200 rewards",
    ):
        assert word in out
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    errors = {
        (row["policy"], row["estimator"]): abs(row["error"])
        for row in report["results"]
    }
    for policy in ("10% expert", "50% expert", "90% expert"):
        assert errors[policy, "oee"] < 0.5 * errors[policy, "simulator"]
    assert_allclose(report["results"][0]["true_value"], -1.5789855, rtol=1e-6)
    again = run(
        "evaluate --output out --estimators simulator --discount 0.9 --horizon 50"
        " --policy uniform --raw"
    )
    files = ("report.json", "table.csv", "values.png", "values.pdf", "values.svg")
    assert f"\nWritten: {', '.join(f'out/{name}' for name in files)}\n" in again
    assert "50 rewards (discount 0.9)" in again
    assert "0.01 × the discounted sum of" in out
    assert "0.01 ×" not in again
    more = run("evaluate --verbose")
    for word in ("oee", "model-based", "3162 transitions", "t = 0..199"):
        assert word in more


def test_from_files_to_a_value(run):
    """simulator, log and policy as three files; the answer is Python's."""
    run("export gridworld:4,slip=0.3 --output sim.npz")
    assert "500 transitions" in run(
        "sample gridworld:4,slip=0.1 --transitions 500 --horizon 60 --output log.csv"
    )
    run("policy gridworld:4,slip=0.3 mix:0.8 --output pi.npy")
    words = f"evaluate {DATA} --policy mine=pi.npy --horizon 30"
    result = json.loads(run(words, "--json"))
    values = {row["estimator"]: row["value"] for row in result["results"]}
    estimate = oee.estimators.OffEnvironment()(
        problem(horizon=30), oee.tasks.gridworld_policy(4, 0.8)
    )
    assert values["oee"] == estimate.value
    assert {row["policy"] for row in result["results"]} == {"mine"}
    assert result["facts"]["log_name"] == "log.csv"
    shown = run(
        words, "--target gridworld:4,slip=0.1 --normalized --estimators oee,oracle"
    )
    assert "The exact value, known" in " ".join(shown.split())
    assert "0.01 × the discounted sum of 30 rewards" in shown


def test_the_behaviour_policy_of_a_log_without_probabilities(run, folder):
    columns = oee.Transitions.load("log.csv").columns()
    del columns["behavior_probability"]
    oee.Transitions(**columns).save("log.csv")
    words = f"evaluate {DATA} --policy half=mix:0.5 --horizon 20 --all"
    assert "wpdis" not in run(words)
    assert "wpdis" in run(words, "--behavior uniform")


def test_action_noise_is_part_of_what_is_reported(run, folder):
    words = "evaluate --simulator gridworld:3,slip=0.0 --log log.csv --estimators oee"
    assert "(--action-noise)" in run(words, code=2)
    shown = " ".join(run(words, "--action-noise 0.3").split())
    assert "gridworld:3,slip=0.0 with action noise 0.3" in shown
    assert (
        json.loads(run(words, "--action-noise 0.3 --json"))["facts"]["action_noise"]
        == 0.3
    )


@pytest.mark.parametrize(
    ("flag", "text"),
    [
        (
            "--guaranteed --estimators oee --policy uniform",
            "guaranteed at any sample size is",
        ),
        ("--all --quick --policy mix:0.5", "wpdis"),
        ("--verbose --quick --policy mix:0.5", "max weight"),
    ],
)
def test_more_is_printed_where_it_is_asked_for(run, folder, flag, text):
    plain, more = (
        " ".join(run("evaluate", DATA, flags).split())
        for flags in (flag.partition(" ")[2], flag)
    )
    assert text in more
    assert text not in plain


@pytest.mark.parametrize(
    "command",
    ["evaluate --policy uniform", "compare --policy uniform --policy optimal"],
)
def test_a_box_narrows_the_interval(run, folder, command):
    plain, boxed = (
        json.loads(run(command, DATA, more, "--json")) for more in ("", "--box 0.2,3")
    )
    one, two = (
        (found.get("intervals") or found["policies"])[0] for found in (plain, boxed)
    )
    assert one["lower"] <= two["lower"] < two["upper"] <= one["upper"]
    known = oee.interval(problem(), UNIFORM, lower_ratio=0.2, upper_ratio=3.0)
    if "facts" in boxed:
        assert (two["lower"], two["upper"]) == (known.lower, known.upper)
        assert (
            boxed["facts"]["target"]
            == "assumed between 0.2 and 3 times the simulator's probabilities"
        )


@pytest.mark.parametrize("factor", ["1", "2.5", "inf"])
def test_the_factor_of_unrecorded_pairs_is_python_s(run, folder, factor):
    target = oee.tasks.gridworld(3, slip=0.1)
    oee.sample_episodes(target, oee.uniform_policy(target), 2, 30, seed=0).save(
        "log.csv"
    )
    known = oee.interval(problem(), UNIFORM, unrecorded=float(factor))
    assert known.diagnostics["unrecorded_pairs"] > 0
    for command in (
        "evaluate --policy uniform --estimators oee",
        "compare --policy uniform --policy optimal",
    ):
        words = (command, DATA, "--unrecorded", factor)
        found = json.loads(run(*words, "--json"))
        rows = found["results"] if "results" in found else found["policies"]
        row = next(row for row in rows if row["policy"] == "uniform")
        assert (row["lower"], row["upper"]) == (known.lower, known.upper)
        assert (row["sampling_lower"], row["sampling_upper"]) == known.sampling
        assert (row["worst_case_lower"], row["worst_case_upper"]) == known.worst_case
        said = {"1": "as estimated", "2.5": "a factor of 2.5", "inf": "be anything"}
        assert said[factor] in " ".join(run(*words).split())


@pytest.mark.parametrize(
    "box", ["0.5", "a,b", "1,2,3", "nan,2", "2,0.5", "1.5,2", "-1,2", "0.2,0.7", "inf,"]
)
def test_what_is_no_box(run, folder, box):
    for command in (
        "evaluate",
        "compare --policy uniform --policy optimal",
        "plan --transitions 5",
    ):
        said = run(command, DATA, f"--box={box}", code=2)
        assert said.startswith(
            "oee: --box must be LOWER,UPPER, bounds on P_target / P with 0 <= LOWER <="
            " 1 <= UPPER"
        )
        assert repr(box) in said


def test_impossible_transitions_are_refused_dropped_or_allowed(run, folder):
    grid = oee.FiniteMDP.load("sim.npz")
    table = grid.transitions.toarray().reshape(9, 4, 9)
    table[0, 0] = np.eye(9)[1]  # action n of r0c0 leads to r0c1, for sure
    sure = grid.with_rewards(grid.rewards).with_transitions(table)
    sure.save("sim.npz")
    log = oee.Transitions.load("log.csv")
    words = f"evaluate {DATA} --policy uniform --estimators oee --json"
    told = run(words, code=2)
    assert "allow=" not in told  # of what happens nearly always
    assert "48 of 51 transitions are impossible, most to r1c0: more than" in told
    assert "(--impossible drop)" in told
    dropped, allowed = (
        json.loads(run(words, "--impossible", way)) for way in ("drop", "allow=0.02")
    )
    for made, expected in (
        (dropped, oee.interval(problem(impossible="drop"), UNIFORM)),
        (
            allowed,
            oee.interval(oee.Problem(sure.with_support_of(log, 0.02), log), UNIFORM),
        ),
    ):
        assert (made["intervals"][0]["lower"], made["intervals"][0]["upper"]) == (
            expected.lower,
            expected.upper,
        )
    assert "are impossible in the simulator and left out of every model" in " ".join(
        dropped["warnings"]
    )
    assert dropped["facts"]["impossible"] == "drop"
    run("counts log.csv --output counted.npz")
    counted = json.loads(
        run(words.replace("log.csv", "counted.npz"), "--impossible allow=0.02")
    )
    assert counted["intervals"] == allowed["intervals"]
    for bad in ("allow=2", "allow", "allow=0", "allow=x", "dropp", "drop=1"):
        said = run(words, "--impossible", bad, code=2)
        assert said.startswith(
            "oee: --impossible must be refuse, drop, or allow=EPS with 0 < EPS < 1,"
            " allow=0.01; got"
        )


def test_compare_says_which_or_that_it_cannot(run, folder):
    words = f"compare {DATA} --horizon 30 --policy best=optimal --policy any=uniform"
    assert run(words).startswith(
        "Of 2 policies, “best” is worth most in the target. It is better than “any” by "
    )
    found = json.loads(run(words, "--json"))
    assert found["best"] == "best"
    asked = problem(horizon=30)
    compared = oee.inference.compare_policies(
        asked, {"best": oee.optimal_policy(asked.simulator), "any": UNIFORM}
    )
    sure = oee.interval(asked, UNIFORM)
    first, second = found["policies"]
    assert (first["policy"], second["policy"]) == compared.names
    assert (second["lower"], second["upper"]) == (sure.lower, sure.upper)
    assert second["probability_best"] == compared.probability_best[1]
    assert first["unrecorded_share"] == compared.unrecorded_share[0]
    (apart,) = found["differences"]
    assert (apart["policy"], apart["than"], apart["difference"]) == (
        "any",
        "best",
        second["value"] - first["value"],
    )
    assert (apart["lower"], apart["upper"]) == (
        compared.lower[1, 0],
        compared.upper[1, 0],
    )
    oee.Transitions.load("log.csv").first(12).save("log.csv")
    words = words.replace("any=uniform", "any=uniform --policy other=mix:0.02")
    doubt = json.loads(run(words, "--json"))
    assert doubt["best"] is None
    assert "The log cannot say which of" in doubt["sentence"]
    assert {row["probability_best"] for row in doubt["policies"]} == {None}
    assert "There is no P(best), because" in run(words, "--verbose")
    assert "P(best)" not in run(words)


@pytest.mark.parametrize("moves", [6, 60, 600])
def test_compare_and_evaluate_say_one_value(run, folder, moves):
    oee.Transitions.load("log.csv").first(moves).save("log.csv")
    words = f"{DATA} --policy best=optimal --policy any=uniform --json"
    compared, evaluated = (
        json.loads(run(command, words)) for command in ("compare", "evaluate")
    )
    rows = [row for row in evaluated["results"] if row["estimator"] == "oee"]
    told = [
        {key: row[key] for key in ("policy", "value", "lower", "upper")}
        for row in compared["policies"]
    ]
    assert told == sorted(
        ({key: row[key] for key in told[0]} for row in rows),
        key=lambda row: -row["value"],
    )
    assert evaluated["answer"].startswith(compared["sentence"])
    for apart in compared["differences"]:
        assert apart["lower"] <= apart["difference"] <= apart["upper"]


def test_compare_wants_two(run, folder):
    assert "--policy must be given twice or more" in run(
        f"compare {DATA} --policy uniform", code=2
    )
    assert "'uniform' is given twice" in run(
        f"compare {DATA} --policy uniform --policy uniform", code=2
    )
    words = (
        "compare --simulator cartpole --log log.csv --policy uniform --policy expert"
    )
    assert (
        "--simulator must have numbered states to compare policies; 'cartpole' is"
        " continuous" in run(words, code=2)
    )
    with pytest.raises(
        ValueError,
        match=r"^policies must be at least two to compare; there is 'policy'$",
    ):
        oee.report.contest(problem(), UNIFORM)


PLAN = f"plan {DATA} --transitions 400 --discount 0.9"


def test_plan_writes_a_policy_that_narrows_the_intervals(run, folder):
    text = run(PLAN, "--policy one=mix:0.5 --policy two=mix:0.9 --output next.npy")
    assert text.startswith("Plan for 400 transitions, by a behaviour policy")
    rows = {
        line.split()[0]: line.split()
        for line in text.splitlines()
        if line.startswith(("one", "two"))
    }
    assert all(float(row[3]) < float(row[1]) for row in rows.values())
    assert_allclose(np.load("next.npy").sum(axis=1), 1.0)
    found = json.loads(run(PLAN, "--json"))
    assert found["most"][0]["state"].startswith("r")
    assert found["most"][0]["action"] in "nesw"
    # with the simulator's names, which --policy reads
    run(PLAN, "--policy one=mix:0.5 --policy two=mix:0.9 --output next.csv")
    assert pd.read_csv("next.csv")["state"][0] == "r0c0"
    run("policy sim.npz next.csv --output again.npy")
    assert_allclose(np.load("again.npy"), np.load("next.npy"))
    run(PLAN, "--free --output share.csv")
    assert_allclose(pd.read_csv("share.csv")["share"].sum(), 1.0)
    free = run(PLAN, "--free --output share.npy")
    assert "shares of the pairs, (S, A), that sum to 1" in free
    assert_allclose(np.load("share.npy").sum(), 1.0)


def test_plan_takes_what_its_function_takes(run, folder):
    more = (
        "--plan-option restart=0.2 --plan-option model=simulator --plan-option"
        " optimistic=false --box 0.5,2"
    )
    found = json.loads(run(PLAN, more, "--policy uniform --json"))
    asked = oee.Problem(
        oee.FiniteMDP.load("sim.npz").with_discount(0.9),
        oee.Transitions.load("log.csv"),
    )
    plan = oee.design.plan_data_collection(
        asked,
        {"uniform": UNIFORM},
        n=400,
        sampling="behavior",
        restart=0.2,
        model="simulator",
        optimistic=False,
        lower_ratio=0.5,
        upper_ratio=2.0,
    )
    assert_allclose(
        found["policies"][0]["width"], plan.to_dict()["policies"][0]["width"], rtol=1e-9
    )


def test_plan_for_the_gain_over_the_policy_that_runs(run, folder):
    more = "--plan-option model=simulator --policy mix:0.9 --minus uniform --json"
    found = json.loads(run(PLAN, more))
    simulator = oee.FiniteMDP.load("sim.npz").with_discount(0.9)
    best = oee.optimal_policy(simulator)
    plan = oee.plan_data_collection(
        oee.Problem(simulator, oee.Transitions.load("log.csv")),
        oee.mix(best, UNIFORM, 0.9),
        n=400,
        sampling="behavior",
        model="simulator",
        minus=UNIFORM,
    )
    assert found["quantity"] == "gain"
    assert_allclose(
        found["policies"][0]["width"], plan.to_dict()["policies"][0]["width"], rtol=1e-9
    )
    assert "no such file: nowhere.npy" in run(PLAN, "--minus nowhere.npy", code=2)


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ("0", "--transitions must be a positive integer; it is 0"),
        (
            "5 --plan-option restarts=0.1",
            "got 'restarts=0.1' (did you mean restart=VALUE?)",
        ),
        (
            "5 --plan-option restart",
            "--plan-option must be NAME=VALUE, NAME one of model, optimistic, restart,",
        ),
        (
            "5 --plan-option restart=2",
            "--plan-option restart must be in (0, 1); it is 2",
        ),
    ],
)
def test_what_is_no_plan(run, folder, words, text):
    assert text in run(f"plan {DATA} --transitions", words, code=2)


@pytest.mark.parametrize(
    "text", ["\u00b2", "--1", "1-", "\u2460", "9" * 5000, "-" + "9" * 5000]
)
def test_a_word_that_is_no_integer_is_refused_with_its_option(text, capsys):
    words = ["export", "gridworld:3,slip=0.2", f"--initial={text}", "--output", "x.npz"]
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == 2
    assert capsys.readouterr().err.startswith("oee: --initial must be")


@pytest.mark.parametrize(
    "text", ["1/\u00b2", "\u00b2/3", "1/" + "9" * 5000, "9" * 400 + "/1"]
)
def test_a_fraction_that_is_no_number_is_refused_with_its_argument(text, capsys):
    with pytest.raises(SystemExit) as ended:
        main(["export", f"gridworld:5,slip={text}", "--output", "x.npz"])
    assert ended.value.code == 2
    assert "slip must be" in capsys.readouterr().err


def test_what_the_log_s_reader_warns_of_stands_in_the_report(folder, run, capsys):
    """Of several files: columns that are left out, and rows that count twice."""
    table = pd.read_csv("log.csv")[["state", "action", "next_state", "reward"]]
    table = table.rename(columns={"next_state": "next_obs"})
    table.iloc[:200].to_csv("a.csv")
    table.iloc[100:400].to_csv("b.csv", index=False)
    words = "--simulator sim.npz --log a.csv --log b.csv --policy uniform"
    told = json.loads(run(f"evaluate {words} --estimators oee --json"))
    notes = told["facts"]["log_notes"]
    assert any("it reads 'next_obs' as next_state" in note for note in notes)
    assert any("count twice" in note for note in notes)
    assert {f"While the log was read: {x}." for x in notes} <= set(told["warnings"])
    text = run(f"evaluate {words} --estimators oee --verbose --report page.html")
    page = unescape((folder / "page.html").read_text())
    for note in notes:
        assert note in " ".join(text.split())
        assert note in page
    assert page.count(notes[0]) == 1
    # they change no default text but for the number of notes that it leaves out
    assert notes[0] not in " ".join(run(f"evaluate {words} --estimators oee").split())
    compared = f"compare {words} --policy optimal --quick"
    assert set(notes) <= set(json.loads(run(f"{compared} --json"))["warnings"])
    assert notes[0] in " ".join(run(f"{compared} --verbose").split())
    planned = run(f"plan {words} --transitions 20 --json")
    assert json.loads(planned)["log_notes"] == notes
    logs = words.replace("--policy uniform", "--running uniform")
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        with pytest.raises(SystemExit):
            main(["improve", *logs.split(), "--json"])
    assert json.loads(capsys.readouterr().out)["log_notes"] == notes

"""Ways in and out of the command: one's own simulators and policies, impossible moves, comparison, JSON, progress, help."""

import json
import re
import subprocess
import sys
import time

import numpy as np
import pytest
import typer.main
from numpy.testing import assert_allclose

import oee_tabular as oee
from oee_tabular import _progress
from oee_tabular.cli import main
from oee_tabular.cli.commands import app
from oee_tabular.cli.options import SHAPES

OWN = '''
import gymnasium, numpy as np, oee_tabular as oee
from gymnasium import spaces

def named(slip=0.3):
    return oee.tasks.gridworld(3, slip=slip).with_names([f"r{s // 3}c{s % 3}" for s in range(9)], ["n", "e", "s", "w"])

class Corridor(gymnasium.Env):
    """Three places; forwards succeeds in 3 of 4."""

    observation_space, action_space = spaces.Discrete(3), spaces.Discrete(2)

    def __init__(self, table=True, chance=0.75):
        self.chance, self.initial_state_distrib = chance, np.array([1.0, 0.0, 0.0])
        if table:
            self.P = {s: {a: [(1.0, s, -1.0, False)] for a in (0, 1)} for s in range(3)}
            for s in (0, 1):
                self.P[s][1] = [(chance, s + 1, -1.0, s == 1), (1 - chance, s, -1.0, False)]

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.place = 0
        return 0, {}

    def step(self, action):
        self.place += int(action == 1 and self.np_random.random() < self.chance)
        return self.place, -1.0, self.place == 2, False, {}

if "OwnCorridor-v0" not in gymnasium.registry:
    gymnasium.register("OwnCorridor-v0", entry_point=Corridor)
number = 3

def north_then_east(place):
    return "n" if place != "r0c0" else {"e": 0.5, "n": 0.5}

def unsure(place):
    return {"n": 0.5}

def broken():
    raise KeyError("gone")
'''


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with a module of one's own, a simulator with names, and a log of its target."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own_worlds.py").write_text(OWN)
    grid = oee.tasks.gridworld(3, slip=0.3).with_names([f"r{s // 3}c{s % 3}" for s in range(9)], ["n", "e", "s", "w"])
    grid.save("sim.npz")
    target = oee.tasks.gridworld(3, slip=0.1)
    oee.sample_episodes(target, oee.uniform_policy(target), 40, 30, seed=0).save("log.csv")
    yield tmp_path
    sys.modules.pop("own_worlds", None)


def run(capsys, *arguments, code=0):
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    assert (ended.value.code or 0) == code
    captured = capsys.readouterr()
    return captured.out if code == 0 else captured.err


# ---------------------------------------------------------------- simulators of one's own


@pytest.mark.parametrize("spec", ["own_worlds:Corridor", "own_worlds:OwnCorridor-v0", "own_worlds:Corridor,chance=0.5"])
def test_environments_of_one_s_own(capsys, folder, spec):
    run(capsys, "export", spec, "--output", "made.npz", "--discount", "0.9")
    chance = 0.5 if "0.5" in spec else 0.75
    made = oee.FiniteMDP.load("made.npz")
    assert made.transitions.toarray()[1, :3].tolist() == [1 - chance, chance, 0.0]
    assert made.discount == 0.9
    run(capsys, "sample", spec, "--episodes", 3, "--output", "own.csv")
    assert oee.Transitions.load("own.csv").terminated.sum() == 3


@pytest.mark.parametrize("ending", [".csv", ".parquet", ".npz"])
def test_what_is_sampled_has_names_and_is_read_again(capsys, folder, ending):
    mdp = oee.tasks.gridworld(3, slip=0.2).with_names([(s // 3, s % 3) for s in range(9)], ["n", "e", "s", "w"])
    mdp.save("named.npz")
    run(capsys, "sample", "named.npz", "--transitions", 300, "--output", f"by_name{ending}")
    log = oee.Transitions.load(f"by_name{ending}")
    assert log.action_names is not None
    same = oee.sample_episodes(mdp, oee.uniform_policy(mdp), 60, 1000, seed=0).first(300)
    assert_allclose(log.numbered(mdp).next_state, same.next_state)
    assert "named states" in run(capsys, "info", f"by_name{ending}")
    run(capsys, "counts", f"by_name{ending}", "--simulator", "named.npz", "--output", "counts.npz")
    ask = ["evaluate", "--simulator", "named.npz", "--estimators", "oee", "--json", "--log"]
    values = [json.loads(run(capsys, *ask, file))["results"][0]["value"] for file in (f"by_name{ending}", "counts.npz")]
    assert values[0] == values[1]


def test_a_minari_folder_of_named_states_holds_numbers(capsys, folder):
    pytest.importorskip("minari")
    oee.tasks.gridworld(3, slip=0.2).with_names(action_names=["n", "e", "s", "w"]).save("named.npz")
    run(capsys, "sample", "named.npz", "--episodes", 2, "--output", "folder")
    assert oee.Transitions.load("folder").action_names is None


def test_a_function_s_mdp_and_one_that_is_sampled(capsys, folder):
    run(capsys, "export", "own_worlds:named,slip=0.2", "--output", "made.npz")
    made = oee.FiniteMDP.load("made.npz")
    assert made.action_names == ("n", "e", "s", "w")
    assert abs(made.transitions - oee.tasks.gridworld(3, slip=0.2).transitions).max() == 0
    words = ["export", "own_worlds:Corridor,table=False", "--output", "sampled.npz"]
    assert "oee export own_worlds:Corridor,table=False --samples-per-pair 100" in run(capsys, *words, code=2)
    run(capsys, *words, "--samples-per-pair", 400)
    sampled = oee.FiniteMDP.load("sampled.npz")
    assert_allclose(sampled.transitions.toarray()[1], [0.25, 0.75, 0.0], atol=0.1)


@pytest.mark.parametrize(
    ("spec", "text"),
    [
        (
            "own_worlds:nothing",
            r"'own_worlds' has no object 'nothing' \(it has Corridor, broken, named, north_then_east, unsure\)",
        ),
        ("own_worlds:number", r"must be a FiniteMDP or a Gymnasium environment, or a class or .*; found int"),
        ("own_worlds:broken", r"'own_worlds:broken' cannot be made; it raises KeyError: 'gone'"),
        ("own_worlds:named,slop=1", r"cannot be made; it raises TypeError: .*'slop'"),
        ("not_a_module:Thing", r"module 'not_a_module' cannot be found, neither in .* nor installed"),
        ("own_worlds:OwnCorridor-v7", r"near: OwnCorridor-v0"),
        ("Unheard-v0", r"is neither.* \(your own: module:Class or module:EnvId-v0\)"),
    ],
)
def test_what_is_no_simulator(capsys, folder, spec, text):
    assert re.search(text, said := run(capsys, "export", spec, "--output", "made.npz", code=2))
    assert said.count("\n") == 1


# ---------------------------------------------------------------- policies and starts


def test_policies_from_tables(capsys, folder):
    actions = oee.tasks.gridworld_expert(3).argmax(axis=1)
    np.save("array.npy", actions)
    lines = [f"r{s // 3}c{s % 3},{'nesw'[a]}" for s, a in enumerate(actions)]
    (folder / "words.csv").write_text("\n".join(["state,action", *lines]))
    (folder / "numbers.csv").write_text("\n".join(["action,state", *(f"{a},{s}" for s, a in enumerate(actions))]))
    wide = [",".join([str(s), *("1" if b == a else "0" for b in range(4))]) for s, a in enumerate(actions)]
    (folder / "wide.csv").write_text("\n".join(["state,n,e,s,w", *wide]))
    long = [f"{s},{a},{p}" for s, a in enumerate(actions) for a, p in ((a, 0.75), ((a + 1) % 4, 0.25))]
    (folder / "long.csv").write_text("\n".join(["state,action,probability", *long]))
    for name in ("words", "numbers", "wide"):
        run(capsys, "policy", "sim.npz", f"{name}.csv", "--output", "made.npy")
        assert (np.load("made.npy").argmax(axis=1) == actions).all()
        assert np.load("made.npy").sum() == 9
    run(capsys, "policy", "sim.npz", "long.csv", "--output", "made.npy")
    assert (np.load("made.npy")[np.arange(9), actions] == 0.75).all()
    run(capsys, "policy", "sim.npz", "array.npy", "--output", "made.npy")
    assert (np.load("made.npy").argmax(axis=1) == actions).all()


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("state,act\nr0c0,n", r"must have the columns state and action, .*; it has state, act and 1 rows"),
        ("place,action\nr0c0,n", r"it has place, action and 1 rows"),
        ("state,action\n", r"and 0 rows"),
        ("state,action\nr0c0,north", r"must be one of the MDP's names; it is 'north'"),
        ("state,action\nr0c9,n", r"state must be one of the MDP's names; it is 'r0c9' \(did you mean 'r0c"),
        ("state,action\nr0c0,n\nr0c0,e", r"must have a row for each state; state r0c0 has two"),
        (
            "state,action\nr0c0,n",
            r"must have every state that is not terminal; state r0c1 is not there \(7 such",
        ),
        ("state,action,probability\nr0c0,n,0.4", r"must sum to 1 .*; it sums to 0.4"),
        ("state,action,probability\nr0c0,n,much", r"must have numbers as probabilities; it has 'much'"),
        ("state,action,probability\nr0c0,n,.5\nr0c0,n,.5", r"state r0c0, action n is there twice"),
    ],
)
def test_tables_that_are_no_policy(capsys, folder, text, told):
    (folder / "pi.csv").write_text(text)
    said = run(capsys, "policy", "sim.npz", "pi.csv", "--output", "made.npy", code=2)
    assert re.search(told, said)
    assert said.count("\n") == 1


def test_words_that_are_no_policy(capsys, folder):
    for word, hint in (("optimum", r" \(did you mean 'optimal'\?\)"), ("pi.txt", "")):
        said = run(capsys, "policy", "sim.npz", word, "--output", "made.npy", code=2)
        assert re.search(rf"or a \.npy, \.npz or \.csv file; got '{word}'{hint}$", said.strip())


def test_a_policy_that_is_a_function_of_one_s_own(capsys, folder):
    run(capsys, "policy", "sim.npz", "own_worlds:north_then_east", "--output", "made.npy")
    expected = np.zeros((9, 4))
    expected[:, 0], expected[0] = 1.0, [0.5, 0.5, 0.0, 0.0]
    assert_allclose(np.load("made.npy"), expected)
    for name, told in (
        ("unsure", r"'own_worlds:unsure'\('r0c0'\) must sum to 1 .*; it sums to 0\.5"),
        ("north", r"'own_worlds' has no object 'north' \(it has Corridor"),
    ):
        said = run(capsys, "policy", "sim.npz", f"own_worlds:{name}", "--output", "other.npy", code=2)
        assert re.search(told, said)
        assert said.count("\n") == 1


def test_another_start(capsys, folder):
    words = ["evaluate", "--simulator", "sim.npz", "--log", "log.csv", "--estimators", "simulator", "--json"]
    grid = oee.FiniteMDP.load("sim.npz")
    for start in ("r2c1", "7"):
        row = json.loads(run(capsys, *words, "--initial", start))["results"][0]
        begun = oee.FiniteMDP(grid.transitions, grid.transition_rewards, 7, grid.discount)
        assert_allclose(row["value"], oee.policy_value(begun, oee.optimal_policy(begun)), rtol=1e-12)
    assert "initial must be one of the MDP's names; it is 'r2c7'" in run(capsys, *words, "--initial", "r2c7", code=2)
    assert "initial must be in 0..8; it is 9" in run(capsys, *words, "--initial", "9", code=2)
    assert "--initial needs --simulator and --log" in run(capsys, "evaluate", "--initial", "1", code=2)


# ---------------------------------------------------------------- impossible moves


def test_impossible_moves_are_refused_dropped_or_allowed(capsys, folder):
    grid = oee.FiniteMDP.load("sim.npz")
    table = grid.transitions.toarray().reshape(9, 4, 9)
    table[0, 0] = np.eye(9)[1]  # action n of r0c0 leads to r0c1, for sure
    grid.with_rewards(grid.rewards).with_transitions(table).save("sure.npz")
    words = [
        "evaluate",
        "--simulator",
        "sure.npz",
        "--log",
        "log.csv",
        "--policy",
        "uniform",
        "--estimators",
        "oee",
        "--json",
    ]
    told = run(capsys, *words, code=2)
    assert "(--impossible allow=0.01)" in told
    assert "(--impossible drop)" in told
    log = oee.Transitions.load("log.csv")
    sure, uniform = oee.FiniteMDP.load("sure.npz"), np.full((9, 4), 0.25)
    dropped = json.loads(run(capsys, *words, "--impossible", "drop"))
    found = oee.interval(oee.Problem(sure, log, impossible="drop"), uniform)
    assert (dropped["intervals"][0]["lower"], dropped["intervals"][0]["upper"]) == (found.lower, found.upper)
    assert "are impossible in the simulator and left out of every model" in " ".join(dropped["warnings"])
    assert dropped["facts"]["impossible"] == "drop"
    allowed = json.loads(run(capsys, *words, "--impossible", "allow=0.02"))
    found = oee.interval(oee.Problem(sure.with_support_of(log, 0.02), log), uniform)
    assert (allowed["intervals"][0]["lower"], allowed["intervals"][0]["upper"]) == (found.lower, found.upper)
    run(capsys, "counts", "log.csv", "--output", "counted.npz")
    counted = [*words[:4], "counted.npz", *words[5:], "--impossible", "allow=0.02"]
    assert json.loads(run(capsys, *counted))["intervals"] == allowed["intervals"]
    for bad in ("allow=2", "allow", "allow=0", "allow=x", "dropp", "drop=1"):
        said = run(capsys, *words, "--impossible", bad, code=2)
        assert (
            said == f"oee: --impossible must be refuse, drop, or allow=EPS with 0 < EPS < 1, allow=0.01; got {bad!r}\n"
        )


# ---------------------------------------------------------------- comparison


def test_compare_says_which_or_that_it_cannot(capsys, folder):
    words = ["compare", "--simulator", "sim.npz", "--log", "log.csv", "--horizon", "30"]
    text = run(capsys, *words, "--policy", "best=optimal", "--policy", "any=uniform")
    assert text.startswith("Of 2 policies, “best” is worth most in the target. It is better than “any” by ")
    found = json.loads(run(capsys, *words, "--policy", "best=optimal", "--policy", "any=uniform", "--json"))
    assert found["best"] == "best"
    problem = oee.Problem(oee.FiniteMDP.load("sim.npz"), oee.Transitions.load("log.csv"), horizon=30)
    policies = {"best": oee.optimal_policy(problem.simulator), "any": np.full((9, 4), 0.25)}
    compared = oee.inference.compare_policies(problem, policies)
    sure = oee.interval(problem, policies["any"])
    first, second = found["policies"]
    assert (first["policy"], second["policy"]) == compared.names
    assert (second["lower"], second["upper"]) == (sure.lower, sure.upper)
    assert [second["probability_best"], first["unseen_share"]] == [
        compared.probability_best[1],
        compared.unseen_share[0],
    ]
    (apart,) = found["differences"]
    assert (apart["policy"], apart["than"], apart["difference"]) == ("any", "best", second["value"] - first["value"])
    assert (apart["lower"], apart["upper"]) == (compared.lower[1, 0], compared.upper[1, 0])
    same = ["--policy", "one=uniform", "--policy", "other=mix:0.02", "--policy", "best=optimal"]
    few = oee.Transitions.load("log.csv").first(12)
    few.save("few.csv")
    doubt = json.loads(run(capsys, *words[:4], "few.csv", *words[5:], *same, "--json"))
    assert doubt["best"] is None
    assert "The log cannot say which of" in doubt["sentence"]
    assert {row["probability_best"] for row in doubt["policies"]} == {None}
    assert "There is no P(best): " in run(capsys, *words[:4], "few.csv", *words[5:], *same)


@pytest.mark.parametrize("moves", [6, 60, 600])
def test_compare_and_evaluate_say_one_value(capsys, folder, moves):
    oee.Transitions.load("log.csv").first(moves).save("some.csv")
    words = [
        "--simulator",
        "sim.npz",
        "--log",
        "some.csv",
        "--policy",
        "best=optimal",
        "--policy",
        "any=uniform",
        "--json",
    ]
    compared, evaluated = (json.loads(run(capsys, command, *words)) for command in ("compare", "evaluate"))
    rows = [row for row in evaluated["results"] if row["estimator"] == "oee"]
    told = [{key: row[key] for key in ("policy", "value", "lower", "upper")} for row in compared["policies"]]
    assert told == sorted(({key: row[key] for key in told[0]} for row in rows), key=lambda row: -row["value"])
    assert evaluated["answer"].startswith(compared["sentence"])
    for apart in compared["differences"]:
        assert apart["lower"] <= apart["difference"] <= apart["upper"]


def test_compare_wants_two(capsys, folder):
    words = ["compare", "--simulator", "sim.npz", "--log", "log.csv", "--policy"]
    assert "--policy must be given twice or more" in run(capsys, *words, "uniform", code=2)
    assert "'uniform' is given twice" in run(capsys, *words, "uniform", "--policy", "uniform", code=2)
    with pytest.raises(ValueError, match=r"^policies must be at least two to compare; there is 'policy'$"):
        oee.report.contest(
            oee.Problem(oee.FiniteMDP.load("sim.npz"), oee.Transitions.load("log.csv")), np.full((9, 4), 0.25)
        )


# ---------------------------------------------------------------- JSON


def test_every_command_has_json_of_its_shape(capsys, folder):
    data = ["--simulator", "sim.npz", "--log", "log.csv"]
    (folder / "mine.py").write_text("from oee_tabular.estimators import ModelBased as Mine\n")
    commands = {
        "evaluate": [*data, "--estimators", "simulator"],
        "compare": [*data, "--policy", "uniform", "--policy", "optimal", "--quick"],
        "plan": [*data, "--transitions", "50", "--horizon", "20"],
        "sample": ["gridworld:3,slip=0.1", "--episodes", "2", "--output", "l.npz"],
        "policy": ["sim.npz", "uniform", "--output", "p.npy"],
        "export": ["gridworld:3,slip=0.1", "--output", "e.npz"],
        "counts": ["log.csv", "--output", "c.npz"],
        "info": ["sim.npz"],
        "reproduce": ["--list"],
        "bench": ["--sizes", "1", "--seeds", "1", "--families", "ring", "--jobs", "1", "--output", "b"],
        "check": ["mine:Mine", "--repetitions", "3"],
    }
    assert set(commands) == set(SHAPES) == set(typer.main.get_command(app).commands)
    for command in set(commands) - {"bench", "check"}:  # which take longer, and have tests of their own
        found = json.loads(run(capsys, command, *commands[command], "--json"))
        assert set(found) == set(SHAPES[command])
        assert found["version"] == oee.__version__
    plan = json.loads(run(capsys, "plan", *commands["plan"], "--json"))
    assert plan["most"][0]["state"].startswith("r")
    assert plan["most"][0]["action"] in "nesw"
    assert json.loads(run(capsys, "info", "sim.npz", "--json"))["kind"] == "finite_mdp"


# ---------------------------------------------------------------- progress and help


def test_slow_steps_are_told_once_on_stderr(capsys, monkeypatch):
    monkeypatch.setattr(_progress, "SECONDS", 0.02)
    _progress.report_step("nobody listens")
    with _progress.show_steps():
        _progress.report_step("a first step")
        with _progress.show_steps():
            wait_for(lambda: "first" in _said(capsys))
        _progress.report_step("a second step")
        wait_for(lambda: "second" in _said(capsys))
        time.sleep(0.1)
    lines = "".join(SAID).splitlines()
    assert [re.sub(r"\d+ s", "N s", line) for line in lines] == ["oee: N s: a first step", "oee: N s: a second step"]


SAID: list[str] = []


def _said(capsys):
    captured = capsys.readouterr()
    assert captured.out == ""
    SAID.append(captured.err)
    return "".join(SAID)


def wait_for(condition):
    for _ in range(500):
        if condition():
            return
        time.sleep(0.02)
    raise AssertionError("not told")


def test_what_is_done_is_told_by_policy_and_interval(folder, monkeypatch):
    steps = []
    monkeypatch.setattr("oee_tabular._progress.report_step", steps.append)
    problem = oee.Problem(oee.FiniteMDP.load("sim.npz"), oee.Transitions.load("log.csv"))
    oee.evaluate(problem, {"a": np.full((9, 4), 0.25), "b": [0] * 9}, estimators=["oee"])
    assert steps == [
        "oee of “a” (policy 1 of 2)",
        "oee of “b” (policy 2 of 2)",
        "likelihood interval of “a” (policy 1 of 2)",
        "likelihood interval of “b” (policy 2 of 2)",
        "comparison of the policies, and what to record next",
    ]


def test_json_is_alone_on_stdout(folder):
    script = "import sys; from oee_tabular import _progress; _progress.SECONDS = 0.001\n"
    script += "from oee_tabular.cli import main; main(sys.argv[1:])"
    words = ["evaluate", "--simulator", "sim.npz", "--log", "log.csv", "--estimators", "simulator", "--json"]
    done = subprocess.run([sys.executable, "-c", script, *words], capture_output=True, text=True, check=True)
    assert "results" in json.loads(done.stdout)
    assert re.match(r"oee: \d+ s: ", done.stderr)


@pytest.mark.parametrize("asked", ["-h", "--help"])
def test_help_in_groups(capsys, asked):
    text = run(capsys, "evaluate", asked)
    titles = [line for line in text.splitlines() if line.endswith(":") and not line.startswith(" ")]
    assert titles == ["Input:", "Value:", "Output:", "Continuous tasks:", "Options:"]
    assert "--simulator SIM" in text
    assert "--log FILE" in text
    assert "<" not in text.replace("0 < EPS", "")
    commands = run(capsys, asked)
    assert "--install-completion" in commands
    assert "..." not in commands.split("Commands:")[1]


def test_every_option_has_its_group_and_a_word_for_its_value():
    for name, command in typer.main.get_command(app).commands.items():
        for option in command.params:
            if option.param_type_name == "option" and option.name != "help":
                assert option.rich_help_panel, (name, option.name)
                assert option.is_flag or option.metavar, (name, option.name)

import json
import subprocess
import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import oee_tabular as oee
from oee_tabular.cli import main


def run(capsys, *arguments, code=0):
    """stdout (or stderr for an expected error) of ``oee arguments``."""
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    assert (ended.value.code or 0) == code
    captured = capsys.readouterr()
    return captured.out if code == 0 else captured.err


def test_help_does_not_import_what_is_slow():
    script = "import sys, oee_tabular.cli as c\ntry:\n    c.main(['--help'])\nexcept SystemExit:\n    pass\n"
    script += "print(sorted({'cvxpy', 'numba', 'scipy', 'pandas', 'gymnasium', 'matplotlib'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip().endswith("[]")
    assert "evaluate" in done.stdout


def test_importing_the_package_is_light():
    script = "import sys, oee_tabular as o; print(sorted({'cvxpy', 'numba', 'pandas', 'gymnasium'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_own_files_import_nothing_that_they_do_not_need(tmp_path):
    """The command's warm start: neither pandas nor Gymnasium, nor the wing, nor what users' own modules take."""
    grid = oee.tasks.gridworld(4, 0.1)
    grid.save(tmp_path / "s.npz")
    oee.sample_episodes(grid, oee.uniform_policy(grid), 5, 20, seed=0).save(tmp_path / "log.csv")
    np.save(tmp_path / "p.npy", oee.uniform_policy(grid))
    words = ["evaluate", "--simulator", "s.npz", "--log", "log.csv", "--policy", "p.npy"]
    script = f"import sys, oee_tabular.cli as c\ntry:\n    c.main({words})\nexcept SystemExit:\n    pass\n"
    slow = {"cvxpy", "pandas", "pyarrow", "gymnasium", "matplotlib", "oee_tabular.testing"}
    script += f"print(sorted({slow | {'oee_tabular.continuous.names'}} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=tmp_path)
    assert "95% interval of oee (likelihood)" in done.stdout
    assert done.stdout.strip().endswith("[]")


def test_without_arguments_it_runs_the_paper_s_grid(capsys, tmp_path):
    out = run(capsys, "evaluate", "--output", tmp_path / "out")
    for word in (
        "delta=0.1",
        "delta=0.5",
        "delta=0.9",
        "oee",
        "model-based",
        "3162 transitions",
        "t = 0..199",
    ):
        assert word in out
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    errors = {(row["policy"], row["estimator"]): abs(row["error"]) for row in report["results"]}
    for delta in ("delta=0.1", "delta=0.5", "delta=0.9"):
        assert errors[delta, "oee"] < 0.5 * errors[delta, "simulator"]
    assert_allclose(report["results"][0]["true_value"], -1.5789855, rtol=1e-6)


def test_from_files_to_a_value(capsys, tmp_path):
    """simulator, log and policy as three files; the answer is the API's."""
    sim, log, pi = tmp_path / "sim.npz", tmp_path / "log.csv", tmp_path / "pi.npy"
    run(capsys, "export", "gridworld:4,slip=0.3", "--output", sim)
    said = run(capsys, "sample", "gridworld:4,slip=0.1", "--transitions", 500, "--horizon", 60, "--output", log)
    assert "500 transitions" in said
    run(capsys, "policy", "gridworld:4,slip=0.3", "mix:0.8", "--output", pi)
    arguments = ["evaluate", "--simulator", sim, "--log", log, "--policy", f"mine={pi}", "--horizon", 30, "--json"]
    result = json.loads(run(capsys, *arguments))
    values = {row["estimator"]: row["value"] for row in result["results"]}
    problem = oee.Problem(oee.FiniteMDP.load(sim), oee.Transitions.load(log), horizon=30)
    assert values["oee"] == oee.estimators.OffEnvironment()(problem, oee.tasks.gridworld_policy(4, 0.8)).value
    assert {row["policy"] for row in result["results"]} == {"mine"}
    shown = run(
        capsys, *arguments[:-1], "--target", "gridworld:4,slip=0.1", "--normalized", "--estimators", "oee,oracle"
    )
    assert "Exact value in the target" in shown
    assert "(1 - discount)" in shown


def test_policies_by_name_and_behaviour(capsys, tmp_path):
    log = tmp_path / "log.npz"
    run(capsys, "sample", "gridworld:3,slip=0.1", "--episodes", 20, "--policy", "mix:0.3", "--output", log)
    assert oee.Transitions.load(log).n_episodes == 20
    bare = oee.Transitions.load(log).columns()
    del bare["behavior_probability"]
    oee.Transitions(**bare).save(tmp_path / "bare.npz")
    out = run(
        capsys, "evaluate", "--simulator", "gridworld:3,slip=0.3", "--log", tmp_path / "bare.npz",
        "--policy", "uniform", "--policy", "optimal", "--policy", "half=mix:0.5", "--behavior", "mix:0.3", "--horizon", 20,
    )  # fmt: skip
    for word in ("uniform", "optimal", "half", "wpdis"):
        assert word in out
    np.savez(tmp_path / "named.npz", policy=np.full((9, 4), 0.25), other=np.zeros(3))
    out = run(
        capsys, "evaluate", "--simulator", "gridworld:3,slip=0.3", "--log", log, "--policy", tmp_path / "named.npz"
    )
    assert "named.npz" in out


def test_sampling_steps_gymnasium(capsys, tmp_path):
    path = tmp_path / "lake.npz"
    run(capsys, "sample", "FrozenLake-v1:map_name=4x4", "--transitions", 200, "--seed", 3, "--output", path)
    import gymnasium

    log = oee.record_episodes(gymnasium.make("FrozenLake-v1"), np.full((16, 4), 0.25), n_transitions=200, seed=3)
    assert_array_equal(oee.Transitions.load(path).next_state, log.next_state)


def test_info(capsys, tmp_path):
    oee.tasks.gridworld(3, 0.3).save(tmp_path / "m.npz")
    assert "FiniteMDP(9 states, 4 actions" in run(capsys, "info", tmp_path / "m.npz")
    assert "1 state in which an episode is over" in run(capsys, "info", tmp_path / "m.npz")
    oee.Transitions([0], [0], [3]).save(tmp_path / "l.csv")
    assert "Transitions(1 transitions" in run(capsys, "info", tmp_path / "l.csv")
    np.save(tmp_path / "p.npy", np.ones((9, 4)))
    assert "float64 of shape (9, 4)" in run(capsys, "info", tmp_path / "p.npy")


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["evaluate", "--simulator", "gridworld:4,slip=0.3"], "--log must be given with --simulator"),
        (["evaluate", "--log", "x.npz"], "--simulator must be given with --log"),
        (["evaluate", "--estimators", "oe"], "got 'oe' (did you mean 'oee'?)"),
        (["evaluate", "--target", "gridworld:10,slip=0.1"], "--target needs --simulator and --log"),
        (["evaluate", "--confidence", "1.5"], "confidence must be in (0, 1); it is 1.5"),
        (["evaluate", "--horizon", "0"], "horizon must be a positive integer; it is 0"),
        (["evaluate", "--rewards", "mine"], "rewards must be one of 'simulator', 'log'; got 'mine'"),
        (["evaluate", "--policy", "mix:x"], "--policy must be like mix:0.5; got 'mix:x'"),
        (
            ["evaluate", "--policy", "best"],
            "must be uniform, optimal, expert, mix:WEIGHT, MODULE:FUNCTION, or a .npy, .npz or .csv file",
        ),
        (["evaluate", "--policy", "a=uniform", "--policy", "a=optimal"], "'a' is given twice"),
        (["evaluate", "--policy", "nowhere.npy"], "no such file: nowhere.npy"),
        (["evaluate", "--output", "/proc/version/below"], "output must be a folder that can be written"),
        (["sample", "gridworld:3,slip=0.1", "--output", "l.npz"], "one of --transitions and --episodes must be given"),
        (["sample", "nowhere-v1", "--episodes", "1", "--output", "l.npz"], "'nowhere-v1' is neither"),
        (
            ["sample", "gridworld:3,slip=0.1", "--episodes", "1", "--output", "l.txt"],
            "path must end in .npz, .csv, .csv.gz, .parquet",
        ),
        (["info", "nowhere.npz"], "no such file: nowhere.npz"),
    ],
)
def test_errors_are_one_line_and_exit_with_2(capsys, tmp_path, monkeypatch, arguments, text):
    monkeypatch.chdir(tmp_path)
    said = run(capsys, *arguments, code=2)
    assert text in said
    assert said.startswith("oee: ")
    assert said.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_warnings_are_lines_not_python(capsys, tmp_path, monkeypatch):
    import warnings

    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)
    path = tmp_path / "typo.csv"
    path.write_text("state,action,next_state,behaviour_probability\n0,0,3,0.25\n")
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        with pytest.raises(SystemExit):
            main(["info", str(path)])
    assert "oee: warning:" in (said := capsys.readouterr().err)
    assert "behaviour_probability (did you mean behavior_probability?)" in said
    assert "cli.py" not in said


def test_info_of_reports_and_of_nothing(capsys, tmp_path):
    run(capsys, "evaluate", "--estimators", "oee", "--output", tmp_path / "out")
    for path in (tmp_path / "out", tmp_path / "out" / "report.json"):
        told = run(capsys, "info", path)
        assert "Report of (1 - discount)" in told
        assert "] (likelihood)" in told
    assert "no such file: nofile" in run(capsys, "info", "nofile", code=2)
    (tmp_path / "other.json").write_text("{}")
    assert "must be a report that oee evaluate wrote" in run(capsys, "info", tmp_path / "other.json", code=2)
    np.save(tmp_path / "p.npy", np.full((9, 4), 0.25))
    assert "policy of 9 states and 4 actions" in run(capsys, "info", tmp_path / "p.npy")
    assert run(capsys, "--version").startswith("oee 0.")


def test_the_horizon_ends_episodes_that_would_not(capsys, tmp_path):
    """CliffWalking has no limit of its own; going up for ever would never end."""
    up = np.zeros((48, 4))
    up[:, 0] = 1.0
    np.save(tmp_path / "up.npy", up)
    arguments = ["sample", "CliffWalking-v1", "--policy", tmp_path / "up.npy", "--episodes", 2, "--horizon", 7]
    assert "14 transitions in 2 episodes of 7 steps" in run(capsys, *arguments, "--output", tmp_path / "l.npz")


def test_action_noise_is_part_of_what_is_reported(capsys, tmp_path):
    log = tmp_path / "log.npz"
    run(capsys, "sample", "gridworld:3,slip=0.3", "--episodes", 5, "--output", log)
    arguments = ["evaluate", "--simulator", "gridworld:3,slip=0.0", "--log", log, "--estimators", "oee"]
    assert "(--action-noise)" in run(capsys, *arguments, code=2)
    out = run(capsys, *arguments, "--action-noise", 0.3)
    assert "gridworld:3,slip=0.0 with action noise 0.3" in out
    facts = json.loads(run(capsys, *arguments, "--action-noise", 0.3, "--json"))["facts"]
    assert facts["action_noise"] == 0.3
    assert facts["log_name"] == str(log)


def test_plan_writes_a_policy_that_narrows_the_intervals(tmp_path, capsys):
    log, output = tmp_path / "log.npz", tmp_path / "next.npy"
    run(capsys, "sample", "gridworld:3,slip=0.1", "--policy", "uniform", "--transitions", "400", "--output", str(log))
    words = [
        "plan",
        "--simulator",
        "gridworld:3,slip=0.3",
        "--log",
        str(log),
        "--transitions",
        "400",
        "--discount",
        "0.9",
    ]
    text = run(capsys, *words, "--policy", "one=mix:0.5", "--policy", "two=mix:0.9", "--output", str(output))
    assert text.startswith("Plan for 400 transitions, by a behaviour policy")
    rows = {line.split()[0]: line.split() for line in text.splitlines() if line.startswith(("one", "two"))}
    assert all(float(row[3]) < float(row[1]) for row in rows.values())
    chosen = np.load(output)
    assert chosen.shape == (9, 4)
    np.testing.assert_allclose(chosen.sum(axis=1), 1.0)
    assert run(capsys, *words, "--free") != text


def test_guaranteed_intervals_are_asked_for(tmp_path, capsys):
    log = tmp_path / "log.npz"
    run(capsys, "sample", "gridworld:3,slip=0.1", "--policy", "uniform", "--transitions", "400", "--output", str(log))
    words = [
        "evaluate",
        "--simulator",
        "gridworld:3,slip=0.3",
        "--log",
        str(log),
        "--policy",
        "uniform",
        "--estimators",
        "oee",
    ]
    assert "guaranteed" not in run(capsys, *words)
    assert "The interval guaranteed at any sample size is" in run(capsys, *words, "--guaranteed")


def test_a_negative_seed_is_refused_by_its_name(capsys):
    said = run(
        capsys, "sample", "gridworld:3,slip=0.1", "--episodes", "1", "--output", "log.npz", "--seed", "-1", code=2
    )
    assert "--seed" in said
    assert "Invalid value for '--seed'" in " ".join(said.split())

"""The command on continuous tasks: a small CartPole end to end, and what it says to bad calls."""

import json
import re
import warnings
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import oee_tabular as oee
from oee_tabular.cli import main
from oee_tabular.continuous.cell_rows import no_support
from oee_tabular.continuous.estimators import MonteCarloValue, Residual
from oee_tabular.continuous.names import continuous_simulator
from oee_tabular.estimators import calibrate
from oee_tabular.report import Settings, evaluate_continuous
from oee_tabular.tasks import (
    CartPole,
    ContinuousTask,
    HistoryTask,
    ResidualSimulator,
    cartpole_policy,
    discretize,
    monte_carlo_value,
    named_task,
    record,
)

SMALL = ["--grid=16x16", "--task-option=simulations=400", "--estimators", "simulator,oee,model-based"]
COARSE = "ignore:the 16 x 16 grid .* is too coarse"
LOG = record(CartPole(15.0), cartpole_policy(0.3), n_transitions=1500, max_steps=100, seed=0)


def run(capsys, *arguments, code=0):
    """stdout (or stderr for an expected error) of ``oee arguments``."""
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        with pytest.raises(SystemExit) as ended:
            main([str(argument) for argument in arguments])
    assert (ended.value.code or 0) == code
    captured = capsys.readouterr()
    return captured.out if code == 0 else captured.err


@pytest.fixture(autouse=True)
def _own_showwarning(monkeypatch):
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)


@pytest.fixture(scope="module")
def log_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("logs") / "log.csv"
    LOG.save(path)
    return path


# ---------------------------------------------------------------- end to end


def test_from_a_simulator_s_name_to_a_calibrated_value(capsys, tmp_path):
    log = tmp_path / "log.csv"
    said = run(capsys, "sample", "cartpole:gravity=15", "--policy", "mix:0.7", "--transitions", 3000, "--output", log)
    assert "3000 transitions of 4-dimensional states" in said
    assert_array_equal(pd.read_csv(log).columns[:4], ["state_0", "state_1", "state_2", "state_3"])
    words = [
        "evaluate",
        "--simulator",
        "cartpole:gravity=10",
        "--log",
        log,
        "--policy",
        "expert",
        "--policy",
        "half=mix:0.5",
    ]
    words += [*SMALL, "--target", "cartpole:gravity=15", "--normalized"]
    shown = run(capsys, *words)
    for text in (
        "simulator (continuous)", "simulator (plain)", "oee (calibrated)", "target (continuous)", "t = 0..99",
        "defensive: with probability 0.001", "uncovered mass", "largest zeta", "D_inf", "closure error",
    ):  # fmt: skip
        assert text in shown
    report = json.loads(run(capsys, *words, "--json"))
    rows = {(row["policy"], row["estimator"]): row for row in report["results"]}
    raw, calibrated = rows["half", "oee on the grid"], rows["half", "oee (calibrated)"]
    factor = rows["half", "simulator (continuous)"]["value"] / rows["half", "simulator (plain)"]["value"]
    assert_allclose(calibrated["value"], raw["value"] * factor)
    assert "calibration" in calibrated
    assert {"uncovered_mass", "largest_zeta", "d_inf"} <= set(raw)
    assert_allclose(raw["d_inf"], np.log(raw["largest_zeta"]))
    truth = rows["half", "target (continuous)"]["value"]
    assert abs(calibrated["value"] - truth) < 0.05
    assert report["facts"]["uncovered_mass"] < 0.01
    again = json.loads(run(capsys, *words, "--json"))
    assert again == report


def test_the_files_of_a_task(capsys, tmp_path):
    """export, info, policy: a file of the finite MDP that knows its cells; a policy's array on them is evaluated."""
    simulator, table, log = tmp_path / "simulator.npz", tmp_path / "pi.npy", tmp_path / "log.npz"
    assert "Discretization(CartPole(gravity=10" in run(capsys, "export", "cartpole:gravity=10", "--output", simulator)
    mdp = oee.FiniteMDP.load(simulator)
    assert_allclose(mdp.transitions.toarray(), discretize(CartPole(10), cells=(32, 32)).mdp.transitions.toarray())
    said = run(capsys, "info", simulator)
    assert "made from a continuous task: task CartPole, parameters {'gravity': 10" in said
    LOG.save(log)
    for path in (log, tmp_path / "log.csv", tmp_path / "log.parquet"):
        LOG.save(path)
        said = run(capsys, "info", path)
        assert "ContinuousTransitions(1500 transitions of 4-dimensional states" in said
        assert "state: _0 " in said
    run(capsys, "policy", "cartpole:gravity=10", "mix:0.5", "--output", table)
    assert np.load(table).shape == (1025, 2)
    words = [
        "evaluate",
        "--simulator",
        "cartpole",
        "--log",
        log,
        "--task-option=simulations=2000",
        "--estimators",
        "oee",
        "--grid",
        "auto",
        "--json",
    ]
    rows = json.loads(run(capsys, *words, "--policy", f"file={table}", "--policy", "name=mix:0.5"))["results"]
    raw = {row["policy"]: row["value"] for row in rows if row["estimator"] == "oee on the grid"}
    assert_allclose(raw["file"], raw["name"], rtol=1e-10)
    words = ["sample", "cartpole", "--policy", table, "--episodes", 3, "--horizon", 7, "--output", log]
    said = run(capsys, *words, "--overwrite")
    assert "21 transitions" in said


def test_minari(capsys, tmp_path, monkeypatch):
    """A data set with vectors as observations, by Minari's own writer."""
    minari = pytest.importorskip("minari")
    import gymnasium
    from minari.data_collector import EpisodeBuffer

    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    log, buffers = record(CartPole(15.0), cartpole_policy(0.3), n_episodes=3, max_steps=30, seed=0), []
    for k in range(3):
        rows = log.episode == k
        states = np.concatenate([log.state[rows], log.next_state[rows][-1:]])
        buffers.append(EpisodeBuffer(
            id=k, observations=list(states), actions=list(log.action[rows]), rewards=list(log.reward[rows]),
            terminations=list(log.terminated[rows]), truncations=list(log.truncated[rows]), infos={},
        ))  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        minari.create_dataset_from_buffers(
            "pole/random-v0", buffers, observation_space=gymnasium.spaces.Box(-10, 10, (4,), np.float64),
            action_space=gymnasium.spaces.Discrete(2), data_format="arrow",
        )  # fmt: skip
    found = oee.ContinuousTransitions.load("pole/random-v0")
    assert_allclose(found.state, log.state)
    assert_array_equal(found.action, log.action)
    assert_array_equal(found.terminated, log.terminated)
    assert "4-dimensional states in 3 episodes" in run(capsys, "info", "pole/random-v0")


# ---------------------------------------------------------------- bad calls


def changed(**columns):
    """The log as a bag with other columns."""
    kept = {name: np.array(column) for name, column in LOG.columns().items() if name not in ("episode", "timestep")}
    for name, change in columns.items():
        kept[name] = change(kept[name])
    return oee.ContinuousTransitions(**kept)


def fast(states):
    states[[3, 8]] = [0.0, 0.0, -0.1, 3.25]
    return states


def fast_still(states):
    states[[3, 8]] = [0.0, 0.0, -0.1 + 0.02 * 3.25, 3.25]
    return states


def commands(action):
    pushes = np.array([[-10.0], [10.0]])[action]
    pushes[5] = 8.5
    return pushes


def spoiled(path):
    """A CSV with a state that is no number."""
    frame = pd.read_csv(path)
    frame.loc[2, "state_1"] = np.nan
    frame.to_csv(path, index=False)


FAST, PUSHED = changed(state=fast, next_state=fast_still), changed(action=commands)
NARROW = changed(state=lambda s: s[:, :2], next_state=lambda s: s[:, :2])
BAD = {
    "other dimensions": (
        NARROW, [], "log.state must have the 4 coordinates of CartPole (x, x_dot, theta, theta_dot); it has 2",
    ),
    "outside": (FAST, [], "x [-3.2, 3.2]: 2 of 1500 rows are not; the first, row 3, is at theta="),
    "the way out": (FAST, [], "outside='nearest' or 'drop' (--task-option outside=), takes them"),
    "strict": (
        PUSHED, ["--task-option=strict=true"], "log.action must be one of the task's 2 actions; 1 of 1500 rows do not;",
    ),
    "no such action": (changed(action=lambda a: a + 1), [], "must be in 0..1, the numbers of the task's actions; it is 2"),
    "outside how": (LOG, ["--task-option=outside=clip"], "--task-option outside must be one of 'error', "),
    "a grid in words": (LOG, ["--grid=fine"], "--grid must be like 32x32, 3000 or auto; got 'fine'"),
    "a line": (
        LOG, ["--grid=32x32x32"], "--grid must have 2 numbers, one for each feature of",
    ),
    "calibration": (LOG, ["--task-option=calibration=both"], "must be one of 'ratio', 'difference', 'none'; got 'both'"),
    "floor": (LOG, ["--task-option=floor=2"], "--task-option floor must be in [0, 1]; it is 2"),
    "simulations": (LOG, ["--task-option=simulations=0"], "--task-option simulations must be a positive integer; it is 0"),
    "twice an option": (
        LOG, ["--task-option=floor=0.1", "--task-option=floor=0.2"], "--task-option names must differ; 'floor' is given twice",
    ),
    "unknown": (
        LOG, ["--task-option=flor=0.1"], "--task-option must be NAME=VALUE, NAME one of outside, strict, calibration, "
        "floor, simulations, state, actions; got 'flor=0.1' (did you mean floor=VALUE?)",
    ),
    "no value": (LOG, ["--task-option=strict"], "got 'strict' (did you mean strict=VALUE?)"),
    "no truth": (LOG, ["--task-option=strict=x"], "--task-option strict must be True or False; got 'x'"),
    "no share": (LOG, ["--task-option=floor=x"], "--task-option floor must be a number; got 'x'"),
    "policy": (LOG, ["--policy", "optimal"], "must be uniform, expert, mix:WEIGHT or MODULE:FUNCTION of states; got"),
    "mixture": (LOG, ["--policy", "mix:2"], "the weight of --policy 'mix:2' must be in [0, 1]; it is 2"),
    "twice": (LOG, ["--policy", "a=expert", "--policy", "a=uniform"], "--policy names must differ; 'a' is given twice"),
    "noise": (LOG, ["--action-noise", "0.1"], "--action-noise must be left out for a continuous task"),
    "rewards": (LOG, ["--rewards", "log"], "--rewards must be left out for a continuous task"),
    "box": (LOG, ["--box", "0.5,2"], "--box must be left out for a continuous task, whose states have no numbers; it is 0.5,2"),
    "target": (LOG, ["--target", "gridworld:3,slip=0.1"], "--target must be a continuous task as the simulator is"),
    "guaranteed": (LOG, ["--guaranteed"], "guaranteed must be False where counts are given"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_bad_calls(capsys, tmp_path, case):
    log, options, text = BAD[case]
    log.save(tmp_path / "log.npz")
    words = ["evaluate", "--simulator", "cartpole", "--log", tmp_path / "log.npz", "--estimators", "oee", *options]
    for option in ("--grid=16x16", "--task-option=simulations=50"):
        is_given = any(word.rpartition("=")[0] == option.rpartition("=")[0] for word in options)
        words += [] if is_given else [option]
    said = run(capsys, *words, code=2).splitlines()
    assert text in said[-1]
    assert said[-1].startswith("oee: ")


def test_states_that_are_no_numbers(capsys, tmp_path):
    path = tmp_path / "log.csv"
    LOG.save(path)
    spoiled(path)
    said = run(capsys, "evaluate", "--simulator", "cartpole", "--log", path, code=2)
    assert "state_1[2] must have a value" in said


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["sample", "cartpole:gravty=10", "--episodes", "1", "--output", "l.csv"], "does not take these arguments"),
        (["sample", "cartpole:10", "--episodes", "1", "--output", "l.csv"], "must give its arguments as key=value; found 10"),
        (["sample", "cartpole:gravity=-1", "--episodes", "1", "--output", "l.csv"], "gravity must be in [0, inf); it is -1"),
        (["sample", "cartpole", "--episodes", "1", "--output", "l.txt"], "path must end in .npz, .csv, .parquet"),
        (["evaluate", "--grid=8x8"], "--grid needs a continuous task"),
        (["evaluate", "--task-option=strict=true"], "--task-option needs a continuous task"),
        (["evaluate", "--task-option=simulations=5"], "--task-option needs a continuous task"),
        (["evaluate", "--simulator", "cartpole"], "--log must be given with --simulator"),
    ],
)  # fmt: skip
def test_bad_words(capsys, tmp_path, monkeypatch, words, text):
    monkeypatch.chdir(tmp_path)
    said = run(capsys, *words, code=2)
    assert text in said
    assert list(tmp_path.iterdir()) == []


def test_numbered_and_continuous_logs_are_told_apart(capsys, tmp_path, log_file):
    oee.Transitions([0], [0], [3]).save(tmp_path / "numbers.csv")
    said = run(capsys, "evaluate", "--simulator", "cartpole", "--log", tmp_path / "numbers.csv", code=2)
    assert "must have the columns state_0" in said
    said = run(capsys, "evaluate", "--simulator", "gridworld:3,slip=0.3", "--log", log_file, code=2)
    assert "must have the columns state, action, next_state" in said


# ---------------------------------------------------------------- what is told, not refused


def evaluated(log, **settings):
    """(texts of the warnings, the report) on the small grid."""
    simulator = continuous_simulator("cartpole:gravity=10")
    chosen = Settings(**({"grid": (16, 16), "episodes": 50} | settings))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        report = evaluate_continuous(
            simulator, log, {"expert": simulator.expert}, settings=chosen, estimators=["oee"], seed=0
        )
    return [str(w.message) for w in caught], report


@pytest.mark.parametrize(
    ("log", "settings", "text"),
    [
        (FAST, {"outside": "drop"}, r"log\.state must be .*: 2 of 1500 rows are not; .* They are left out"),
        (
            FAST,
            {"outside": "nearest"},
            r"log\.state must be .*: 2 of 1500 rows are not; .* They are moved to the nearest place inside",
        ),
        (PUSHED, {}, r"moved to the nearest of the task's actions: 1 of 1500 .* row 5, is \[8.5\], 1.5 from \[10.0\]"),
        (LOG, {"grid": (6, 6)}, "too coarse for the steps of CartPole: .* a closure error of"),
    ],
)
def test_warnings_are_told_once_and_stand_in_the_report(log, settings, text):
    import re

    texts, report = evaluated(log, **settings)
    assert sum(bool(re.search(text, each)) for each in texts) == 1
    assert sum(bool(re.search(text, each)) for each in report.warnings) == 1


def test_rows_left_out_are_counted():
    _, report = evaluated(FAST, outside="drop")
    assert report.facts["rows_left_out"] == 2
    assert len(report.problem.log) == 1498


def test_uncovered_mass_is_warned_about():
    """A log whose moves the simulator does not make: every next state nearly a cell away."""
    pushed = np.array(LOG.next_state)
    pushed[:, 3] += 0.2
    log = changed(next_state=lambda _: pushed)
    _, report = evaluated(log, grid=(32, 32))
    assert report.facts["uncovered_mass"] > 0.05
    assert any("have probability 0 in the plain simulator" in text and "others" in text for text in report.warnings)


@pytest.mark.filterwarnings(COARSE)
def test_the_command_s_configuration_by_hand():
    """The same numbers from the pieces: the log's places, floor .001, soft counts, strength .01, ratio."""
    _, report = evaluated(LOG)
    model = discretize(CartPole(10), LOG, cells=(16, 16), floor=1e-3)
    pi = model.policy(cartpole_policy(0.0))
    zeta = oee.transition_ratio(model.counts(LOG), model.mdp, prior="simulator", strength=0.01)
    problem = oee.Problem(model.mdp, model.encode(LOG, seed=0), horizon=100, counts=model.counts(LOG))
    raw = oee.estimators.OffEnvironment(zeta)(problem, pi)
    rows = {row["estimator"]: row for row in report.records()}
    assert_allclose(rows["oee on the grid"]["value"], raw.value, rtol=1e-12)
    mc = rows["simulator (continuous)"]
    found = calibrate(
        raw, discretised=oee.policy_value(model.plain, pi, horizon=100), continuous=mc["value"],
        continuous_error=mc["standard_error"],
    )  # fmt: skip
    row = rows["oee (calibrated)"]
    assert_allclose(row["value"], found.diagnostics["calibrated_value"], rtol=1e-12)
    assert_allclose(row["standard_error"], found.diagnostics["calibrated_standard_error"])
    assert_allclose([row["lower"], row["upper"]], row["value"] + 1.96 * row["standard_error"] * np.array([-1, 1]))
    far = monte_carlo_value(CartPole(10), cartpole_policy(0.0), 4000, 100, seed=1)
    assert abs(mc["value"] - far.value) < 5 * np.hypot(mc["standard_error"], far.standard_error)


@pytest.mark.filterwarnings(COARSE)
def test_the_corrected_simulator_comes_first():
    """Its value is that of the task by hand, its interval has the truth, and it is what is said first."""
    simulator, policy = continuous_simulator("cartpole:gravity=10"), cartpole_policy(0.4)
    report = evaluate_continuous(
        simulator, LOG, {"mixed": policy}, settings=Settings(grid=(16, 16), episodes=3000), seed=0, estimators=["oee"]
    )
    first = report.records()[0]
    assert first["estimator"] == "oee (residual)"
    corrected = ResidualSimulator(CartPole(10.0), LOG, seed=0)
    stream = np.random.default_rng(np.random.SeedSequence(0, spawn_key=(10**6,)))
    assert first["value"] == monte_carlo_value(corrected, policy, 3000, 100, seed=stream).value
    truth = monte_carlo_value(CartPole(15.0), policy, 20_000, 100, seed=0)
    assert first["lower"] < truth.value < first["upper"]
    before = {row["estimator"]: row["value"] for row in report.records()}["simulator (continuous)"]
    assert first["upper"] - first["lower"] < 0.5 * abs(before - truth.value)
    assert first["interval_method"] == "refits"
    assert report.answers[0].estimator == "oee (residual)"
    assert report.uncertainty.sentences[0].startswith(
        "The target's steps differ from the simulator's in x_dot (residuals "
    )
    assert "theta_dot" in report.uncertainty.sentences[0]
    assert "oee (residual)" not in str(
        evaluate_continuous(
            simulator, LOG, {"mixed": policy}, settings=Settings(grid=(16, 16), episodes=50), seed=0,
            estimators=["simulator"],
        )
    )  # fmt: skip


@pytest.mark.filterwarnings(COARSE)
def test_an_error_of_the_corrected_value_covers_other_logs():
    """Standard error of refits and rollouts against the spread of the estimate over logs."""
    policy, errors, values = cartpole_policy(0.4), [], []
    for seed in range(8):
        log = record(CartPole(15.0), cartpole_policy(0.3), n_transitions=400, max_steps=100, seed=seed)
        corrected = ResidualSimulator(CartPole(10.0), log, seed=0)
        mc = MonteCarloValue(corrected, {b"": policy}, 100, 500, 0.99, np.random.SeedSequence(seed))
        found = Residual(mc, corrected)(None, np.zeros(0))
        values.append(found.value)
        errors.append(found.standard_error)
        assert found.standard_error >= mc(np.zeros(0)).standard_error
        assert found.standard_error == Residual(mc, corrected)(None, np.zeros(0)).standard_error
    assert 0.4 < np.mean(errors) / np.std(values, ddof=1) < 2.5


class Remembers(HistoryTask):
    """CartPole that is kicked by a push to the right after a push to the right."""

    step = ContinuousTask.step

    def moves(self, states, actions, disturbance):
        moved = super().moves(states, actions, disturbance)
        moved.next_state[:, 3] += 0.2 * states[:, 5] * actions
        return moved


@pytest.mark.filterwarnings(COARSE, "ignore:.*(have no probability|do not show in the features)")
def test_hidden_state_is_said_and_not_put_in_front():
    """Where the action before decides, the row says so, and a row with that action in the state stands before all."""
    simulator, target = continuous_simulator("cartpole:gravity=10"), Remembers(CartPole(10.0))
    columns = record(target, target.policy(cartpole_policy(0.5)), n_transitions=3000, max_steps=100, seed=0).columns()
    log = oee.ContinuousTransitions(**(columns | {k: columns[k][:, :4] for k in ("state", "next_state")}))
    policy = cartpole_policy(0.4)
    report = evaluate_continuous(
        simulator, log, {"mixed": policy}, settings=Settings(grid=(16, 16), episodes=3000), seed=0, estimators=["oee"]
    )
    assert [row["estimator"] for row in report.records()][:2] == ["oee (residual, last action)", "oee (residual)"]
    assert report.answers[0].estimator == "oee (residual, last action)"
    hidden = report.results[1].estimate
    assert "the state is not all that the next one depends on" in hidden.status
    assert (hidden.standard_error, hidden.interval) == (None, None)
    assert "because the action of one step ago explains" in report.uncertainty.sentences[0]
    truth = monte_carlo_value(target, target.policy(policy), 5000, 100, seed=0).value
    values = {row["estimator"]: row["value"] for row in report.records()}
    assert abs(values["oee (residual, last action)"] - truth) < abs(values["simulator (continuous)"] - truth) / 3


@pytest.mark.filterwarnings(COARSE)
def test_a_few_moves_without_support_are_left_out_and_told():
    simulator = continuous_simulator("cartpole:gravity=10")
    with pytest.warns(UserWarning, match=r"0.0032 of the log's transitions have no probability .* begin at state \d+"):
        report = evaluate_continuous(
            simulator, LOG, {"expert": simulator.expert}, settings=Settings(grid=(60, 60), floor=0.0, episodes=50),
            seed=0, estimators=["oee"],
        )  # fmt: skip
    assert 0.003 < report.facts["moves_left_out"] < 0.004
    assert any("(theta=" in text and "leave them out" in text for text in report.warnings)


def test_a_way_out_that_is_in_force_is_not_advised():
    simulator = continuous_simulator("cartpole:gravity=10")
    columns = LOG.columns()
    columns["next_state"] = -columns["next_state"]
    bag = oee.ContinuousTransitions(**{k: columns[k] for k in ("state", "action", "next_state")})
    few, policies = Settings(grid="auto", episodes=50), {"expert": simulator.expert}
    for settings in (
        few,
        replace(few, floor=0.0, outside="drop"),
    ):  # the floor reaches as far as the log; or they are dropped
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            report = evaluate_continuous(simulator, bag, policies, settings=settings, seed=0, estimators=["oee"])
        assert report.records()[-1]["estimator"] == "oee on the grid"
    assert report.facts["moves_left_out"] > 0.01
    said = r"left out: .* none on .*, and no ratio exists there. Ways out: a defensive share \(--task-option floor=0.001\), a c"
    settings = replace(few, floor=0.0)
    with pytest.warns(UserWarning, match=said):
        report = evaluate_continuous(simulator, bag, policies, settings=settings, seed=0, estimators=["oee"])
    assert [row["estimator"] for row in report.records()] == ["oee (residual)", "simulator (continuous)"]
    text = no_support(discretize(CartPole(), cells=(6, 6), closure_episodes=0), 0.3, 0.01)
    assert text.endswith(
        "Ways out: a coarser grid (--grid NxM), or without those transitions (--task-option outside=drop)"
    )


def test_calibration_by_difference_and_none():
    _, ratio = evaluated(LOG)
    _, plus = evaluated(LOG, calibration="difference")
    _, none = evaluated(LOG, calibration="none")
    assert "oee (calibrated)" not in {row["estimator"] for row in none.records()}
    values = [{row["estimator"]: row["value"] for row in report.records()} for report in (ratio, plus)]
    assert values[0]["oee on the grid"] == values[1]["oee on the grid"]
    assert values[0]["oee (calibrated)"] != values[1]["oee (calibrated)"]


def test_behaviour_probabilities_from_a_policy():
    """A log without probabilities gets them from the behaviour policy in its own states, not in cells."""
    bare = oee.ContinuousTransitions(**{k: v for k, v in LOG.columns().items() if k != "behavior_probability"})
    simulator = continuous_simulator("cartpole:gravity=10")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        report = evaluate_continuous(
            simulator, bare, {"expert": simulator.expert}, behavior=simulator.policy("mix:0.7"),
            settings=Settings(grid=(16, 16), episodes=50), seed=0,
        )  # fmt: skip
    assert "wpdis" in {row["estimator"] for row in report.records()}
    assert_allclose(report.problem.log.behavior_probability, LOG.behavior_probability)


@pytest.mark.filterwarnings("ignore:the 1000 cells of visited states .* is too coarse")
def test_the_whole_state_has_cells_of_its_own():
    task = named_task("cartpole:form=full")
    assert task.mdp.n_states == 1001
    assert task.expert().shape == (1001, 2)


# ---------------------------------------------------------------- the arms


def test_reacher_from_the_command_line(capsys, tmp_path):
    """Cells of the log, the averaged lengths as the simulator, the plain one beside it."""
    log = tmp_path / "log.npz"
    run(
        capsys, "sample", "reacher:length=0.2,tamed=True", "--policy", "mix:0.5", "--transitions", 5000, "--output", log
    )
    words = [
        "evaluate",
        "--simulator",
        "reacher:length=0.1,reward_length=0.2,tamed=True",
        "--log",
        log,
        "--policy",
        "mix:0.5",
    ]
    words += ["--grid", "auto", "--estimators", "simulator,oee", "--task-option=simulations=1000", "--json"]
    report = json.loads(run(capsys, *words, "--target", "reacher:length=0.2,tamed=True"))
    value = {row["estimator"]: row["value"] for row in report["results"]}
    right = value["target (continuous)"]
    assert abs(value["oee on the grid"] - right) < 0.9 * abs(value["simulator (continuous)"] - right)
    assert "oee (calibrated)" not in value
    assert report["facts"]["floor"] == 0.8
    assert (
        "a step is one of length=0.05; length=0.07; length=0.14; length=0.2 (plain: without)"
        in report["facts"]["simulator"]
    )
    assert any(text.startswith("standard errors and intervals are of the log alone") for text in report["warnings"])
    plain = json.loads(run(capsys, *words[:-1], "--task-option=floor=0.2", "--json"))
    assert plain["facts"]["uncovered_mass"] == report["facts"]["uncovered_mass"] > 0.1  # of the plain simulator
    text = run(capsys, *words[:7], "--policy", f"file={tmp_path / 'pi.npy'}", code=2)
    assert (
        "--policy must be uniform, expert, mix:WEIGHT or MODULE:FUNCTION for Reacher, whose cells are made of" in text
    )


def test_the_arm_from_the_command_line(capsys, tmp_path):
    """Ties, calibration by the difference, and the stand-in's name; positions alone by form=hand."""
    pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'oee-tabular[mujoco]'")
    log = tmp_path / "log.npz"
    run(capsys, "sample", "kinova:velocity_scale=1.4", "--policy", "expert", "--episodes", 50, "--output", log)
    words = ["evaluate", "--simulator", "kinova", "--log", log, "--policy", "expert", "--estimators", "simulator,oee"]
    words += ["--grid=auto", "--task-option=simulations=40", "--target", "kinova:velocity_scale=1.4", "--json"]
    report = json.loads(run(capsys, *words))
    value = {row["estimator"]: row["value"] for row in report["results"]}
    right = value["target (continuous)"]
    assert abs(value["oee (calibrated)"] - right) < 0.3 * abs(value["simulator (continuous)"] - right)
    assert value["oee (calibrated)"] - value["oee on the grid"] == pytest.approx(
        value["simulator (continuous)"] - value["simulator (plain)"]
    )
    assert report["facts"]["ratio"] == {"tie": "displacements", "strength": 3.0}
    said = [
        text for text in report["warnings"] if "in unrecorded state-action pairs" in text and text.startswith("oee")
    ]
    assert said
    assert all("Transitions of the same key elsewhere stand for them." in text for text in said)
    assert "a step is one of scaled=0.5, scatter=2; scaled=1.5, scatter=2" in report["facts"]["simulator"]


def test_the_arm_needs_a_form(capsys, tmp_path):
    LOG.save(tmp_path / "log.npz")
    words = ["evaluate", "--simulator", "kinova:form=elbow", "--log", tmp_path / "log.npz"]
    assert "form must be one of 'arm', 'hand'; got 'elbow'" in run(capsys, *words, code=2)
    words = ["evaluate", "--simulator", "kinova", "--log", tmp_path / "log.npz"]
    assert "log.state must have the 27 coordinates of Kinova Gen3" in run(capsys, *words, code=2)


def test_the_advice_says_where_a_cell_is():
    simulator, target = (continuous_simulator(f"cartpole:gravity={g}") for g in (10, 15))
    log = target.record(target.policy("mix:0.7"), n_transitions=500, seed=0)
    few = Settings(grid="auto", episodes=200)
    report = evaluate_continuous(
        simulator, log, {"expert": simulator.expert}, settings=few, seed=0, estimators=["oee"], horizon=20
    )
    assert re.search(r"Record action \d in state \d+ \(theta=.*, theta_dot=", str(report))

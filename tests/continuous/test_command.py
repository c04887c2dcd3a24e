"""The command on continuous tasks: a small CartPole end to end, and what it says to bad
calls.
"""

import json
import re
import warnings
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import oee_tabular as oee
from oee_tabular.continuous.command import continuous_simulator
from oee_tabular.estimators import calibrate
from oee_tabular.report import Settings, evaluate_continuous
from oee_tabular.tasks import (
    CartPole,
    ResidualSimulator,
    cartpole_policy,
    discretize,
    monte_carlo_value,
    named_task,
    record,
)

COARSE = pytest.mark.filterwarnings("ignore:the 16 x 16 grid .* is too coarse")
LOG = record(
    CartPole(15.0), cartpole_policy(0.3), n_transitions=1500, max_steps=100, seed=0
)
SIMULATOR = continuous_simulator("cartpole:gravity=10")


def by_row(report):
    """Row name -> record, of a Report or of what --json printed; of several policies
    the last.
    """
    rows = (
        json.loads(report)["results"] if isinstance(report, str) else report.records()
    )
    return {row["estimator"]: row for row in rows}


# ---------------------------------------------------------------- end to end


def test_from_a_simulator_s_name_to_a_calibrated_value(run):
    said = run(
        "sample cartpole:gravity=15 --policy mix:0.7 --transitions 3000 --output"
        " log.csv"
    )
    assert "3000 transitions of 4-dimensional states" in said
    assert_array_equal(
        pd.read_csv("log.csv").columns[:4], ["state_0", "state_1", "state_2", "state_3"]
    )
    words = (
        "evaluate --simulator cartpole:gravity=10 --log log.csv --policy expert"
        " --policy half=mix:0.5 --grid=16x16 --normalized --task-option=simulations=400"
        " --estimators simulator,oee,model-based --target cartpole:gravity=15"
    )
    shown = run(f"{words} --verbose")
    for text in (
        "simulator (continuous)",
        "simulator (plain)",
        "oee (calibrated)",
        "target (continuous)",
        "t = 0..99",
        "defensive: with probability 0.001",
        "uncovered mass",
        "largest zeta",
        "D_inf",
        "closure error",
    ):
        assert text in shown
    assert (
        "simulator (continuous), target (continuous) (rollouts): value ± quantile ×"
        " standard error, the Monte Carlo error of the rollouts"
        in " ".join(shown.split())
    )
    report = run(words, "--json")
    rows = by_row(report)
    raw = rows["oee on the grid"]
    calibrated = rows["oee (calibrated)"]
    factor = (
        rows["simulator (continuous)"]["value"] / rows["simulator (plain)"]["value"]
    )
    assert_allclose(calibrated["value"], raw["value"] * factor)
    assert "calibration" in calibrated
    assert {"uncovered_mass", "largest_zeta", "d_inf"} <= set(raw)
    assert_allclose(raw["d_inf"], np.log(raw["largest_zeta"]))
    assert abs(calibrated["value"] - rows["target (continuous)"]["value"]) < 0.05
    assert json.loads(report)["facts"]["uncovered_mass"] < 0.01
    few = by_row(run(words.replace("simulator,oee,model-based", "simulator"), "--json"))
    assert all(row == rows[name] | {"notes": row["notes"]} for name, row in few.items())


def test_the_files_of_a_task(run):
    """export, info, policy: a file of the finite MDP that knows its cells; a policy's
    array on them is evaluated.
    """
    assert "Discretization(CartPole(gravity=10" in run(
        "export cartpole:gravity=10 --output simulator.npz"
    )
    mdp = oee.FiniteMDP.load("simulator.npz")
    assert_allclose(
        mdp.transitions.toarray(),
        discretize(CartPole(10), cells=(32, 32)).mdp.transitions.toarray(),
    )
    said = run("info simulator.npz")
    assert (
        "made from a continuous task: task CartPole, parameters {'gravity': 10" in said
    )
    for path in ("log.npz", "log.csv", "log.parquet"):
        LOG.save(path)
        said = run("info", path)
        assert "ContinuousTransitions(1500 transitions of 4-dimensional states" in said
        assert "state: _0 " in said
    run("policy cartpole:gravity=10 mix:0.5 --output pi.npy")
    assert np.load("pi.npy").shape == (1025, 2)
    words = (
        "evaluate --simulator cartpole --log log.npz --task-option=simulations=2000"
        " --estimators oee --grid auto --json"
    )
    values = [
        by_row(run(words, "--policy", policy))["oee on the grid"]["value"]
        for policy in ("pi.npy", "mix:0.5")
    ]
    assert_allclose(values[0], values[1], rtol=1e-10)
    said = run(
        "sample cartpole --policy pi.npy --episodes 3 --horizon 7 --output log.npz"
        " --overwrite"
    )
    assert "21 transitions" in said


def test_minari(run, tmp_path, monkeypatch):
    """A data set with vectors as observations, by Minari's own writer."""
    minari = pytest.importorskip("minari")
    import gymnasium
    from minari.data_collector import EpisodeBuffer

    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    log = record(
        CartPole(15.0), cartpole_policy(0.3), n_episodes=3, max_steps=30, seed=0
    )
    buffers = []
    for k in range(3):
        rows = log.episode == k
        states = np.concatenate([log.state[rows], log.next_state[rows][-1:]])
        buffers.append(
            EpisodeBuffer(
                id=k,
                observations=list(states),
                actions=list(log.action[rows]),
                rewards=list(log.reward[rows]),
                terminations=list(log.terminated[rows]),
                truncations=list(log.truncated[rows]),
                infos={},
            )
        )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        minari.create_dataset_from_buffers(
            "pole/random-v0",
            buffers,
            observation_space=gymnasium.spaces.Box(-10, 10, (4,), np.float64),
            action_space=gymnasium.spaces.Discrete(2),
            data_format="arrow",
        )
    found = oee.ContinuousTransitions.load("pole/random-v0")
    assert_allclose(found.state, log.state)
    assert_array_equal(found.action, log.action)
    assert_array_equal(found.terminated, log.terminated)
    assert "4-dimensional states in 3 episodes" in run("info pole/random-v0")


# ---------------------------------------------------------------- bad calls


def changed(**columns):
    """The log as a bag with other columns."""
    kept = {
        name: np.array(column)
        for name, column in LOG.columns().items()
        if name not in ("episode", "timestep")
    }
    return oee.ContinuousTransitions(
        **kept | {name: change(kept[name]) for name, change in columns.items()}
    )


def at_rows(rows, place):
    def change(column):
        column[rows] = place
        return column

    return change


FAST = changed(
    state=at_rows([3, 8], [0.0, 0.0, -0.1, 3.25]),
    next_state=at_rows([3, 8], [0.0, 0.0, -0.1 + 0.02 * 3.25, 3.25]),
)
PUSHED = changed(
    action=lambda action: at_rows(5, 8.5)(np.array([[-10.0], [10.0]])[action])
)
BAD = {
    "outside": (
        FAST,
        "",
        "x [-3.2, 3.2]: 2 of 1500 rows are not; the first, row 3, is at theta=",
    ),
    "the way out": (
        FAST,
        "",
        "outside='nearest' or 'drop' (--task-option outside=), takes them",
    ),
    "outside how": (
        LOG,
        "--task-option=outside=clip",
        "--task-option outside must be one of 'error', ",
    ),
    "a grid in words": (
        LOG,
        "--grid=fine",
        "--grid must be like 32x32, 3000 or auto; got 'fine'",
    ),
    "a line": (
        LOG,
        "--grid=32x32x32",
        "--grid must have 2 numbers, one for each feature of",
    ),
    "calibration": (
        LOG,
        "--task-option=calibration=both",
        "must be one of 'ratio', 'difference', 'none'; got 'both'",
    ),
    "floor": (
        LOG,
        "--task-option=floor=2",
        "--task-option floor must be in [0, 1]; it is 2",
    ),
    "simulations": (
        LOG,
        "--task-option=simulations=0",
        "--task-option simulations must be a positive integer; it is 0",
    ),
    "twice an option": (
        LOG,
        "--task-option=floor=0.1 --task-option=floor=0.2",
        "--task-option names must differ; 'floor' is given twice",
    ),
    "unknown": (
        LOG,
        "--task-option=flor=0.1",
        (
            "--task-option must be NAME=VALUE, NAME one of outside, strict,"
            " calibration, floor, simulations, state, actions; got 'flor=0.1' (did you"
            " mean floor=VALUE?)"
        ),
    ),
    "no value": (
        LOG,
        "--task-option=strict",
        "got 'strict' (did you mean strict=VALUE?)",
    ),
    "no truth": (
        LOG,
        "--task-option=strict=x",
        "--task-option strict must be True or False; got 'x'",
    ),
    "no share": (
        LOG,
        "--task-option=floor=x",
        "--task-option floor must be a number; got 'x'",
    ),
    "policy": (
        LOG,
        "--policy optimal",
        "must be uniform, expert, mix:WEIGHT or MODULE:FUNCTION of states; got",
    ),
    "mixture": (
        LOG,
        "--policy mix:2",
        "the weight of --policy 'mix:2' must be in [0, 1]; it is 2",
    ),
    "twice": (
        LOG,
        "--policy a=expert --policy a=uniform",
        "--policy names must differ; 'a' is given twice",
    ),
    "noise": (
        LOG,
        "--action-noise 0.1",
        "--action-noise must be left out for a continuous task",
    ),
    "rewards": (
        LOG,
        "--rewards log",
        "--rewards must be left out for a continuous task",
    ),
    "box": (
        LOG,
        "--box 0.5,2",
        (
            "--box must be left out for a continuous task, whose states have no"
            " numbers; it is 0.5,2"
        ),
    ),
    "target": (
        LOG,
        "--target gridworld:3,slip=0.1",
        "--target must be a continuous task as the simulator is",
    ),
    "guaranteed": (
        LOG,
        "--guaranteed",
        "guaranteed must be False where counts are given",
    ),
    "a negative history": (
        LOG,
        "--history=-1",
        "--history must be a positive integer; it is -1",
    ),
    "no parameter": (
        LOG,
        "--fit gravty",
        (
            "--fit must name parameters of CartPole (gravity, noise); got 'gravty' (did"
            " you mea"
        ),
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_calls(run, case):
    log, options, text = BAD[case]
    log.save("log.npz")
    words = f"evaluate --simulator cartpole --log log.npz --estimators oee {options}"
    for option in ("--grid=16x16", "--task-option=simulations=50"):
        words += "" if option.rpartition("=")[0] in options else f" {option}"
    said = run(words, code=2).splitlines()
    assert text in said[-1]
    assert said[-1].startswith("oee: ")


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (
            "sample cartpole:gravty=10 --episodes 1 --output l.csv",
            "does not take these arguments",
        ),
        (
            "sample cartpole:10 --episodes 1 --output l.csv",
            "must give its arguments as key=value; found 10",
        ),
        (
            "sample cartpole:gravity=-1 --episodes 1 --output l.csv",
            "gravity must be in [0, inf); it is -1",
        ),
        (
            "sample cartpole --episodes 1 --output l.txt",
            "--output must end in .npz, .csv, .csv.gz, .parquet",
        ),
        ("evaluate --grid=8x8", "--grid needs a continuous task"),
        ("evaluate --task-option=strict=true", "--task-option needs a continuous task"),
        ("evaluate --history=2", "--history needs a continuous task"),
        ("evaluate --simulator cartpole", "--log must be given with --simulator"),
        (
            "evaluate --simulator kinova:form=elbow --log l.csv",
            "form must be one of 'arm', 'hand'; got 'elbow'",
        ),
    ],
)
def test_bad_words(run, tmp_path, words, text):
    if "evaluate" in words and "l.csv" in words:
        LOG.save("l.csv")
    before = list(tmp_path.iterdir())
    assert text in run(words, code=2)
    assert list(tmp_path.iterdir()) == before


def test_kinds_of_logs_are_recognised(run):
    oee.Transitions([0], [0], [3]).save("numbers.csv")
    LOG.save("log.csv")
    for simulator, log, text in (
        ("cartpole", "numbers.csv", "must have the columns state_0"),
        (
            "gridworld:3,slip=0.3",
            "log.csv",
            "must have the columns state, action, next_state",
        ),
        ("kinova", "log.csv", "log.state must have the 27 coordinates of Kinova Gen3"),
    ):
        assert text in run("evaluate --simulator", simulator, "--log", log, code=2)


# ---------------------------------------------------------------- what is told, not
# refused


def evaluated(log, policy=SIMULATOR.expert, *, estimators=("oee",), **settings):
    """(texts of the warnings, the report) on the small grid."""
    chosen = Settings(**({"grid": (16, 16), "episodes": 50} | settings))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        report = evaluate_continuous(
            SIMULATOR,
            log,
            {"policy": policy},
            settings=chosen,
            estimators=list(estimators),
            seed=0,
        )
    return [str(w.message) for w in caught], report


@pytest.mark.parametrize(
    ("log", "settings", "text"),
    [
        (
            FAST,
            {"outside": "drop"},
            r"log\.state must be .*: 2 of 1500 rows are not; .* They are left out",
        ),
        (
            FAST,
            {"outside": "nearest"},
            (
                r"log\.state must be .*: 2 of .* They are moved to the nearest place"
                r" inside"
            ),
        ),
        (
            PUSHED,
            {},
            (
                r"moved to the nearest of the task's 2 actions: 1 of 1500 .* row 5, is"
                r" \[8.5\], 1.5 from \[10.0\]"
            ),
        ),
        (
            LOG,
            {"grid": (6, 6)},
            "too coarse for the steps of CartPole: .* a closure error of",
        ),
    ],
)
def test_warnings_are_printed_once_and_stand_in_the_report(log, settings, text):
    texts, report = evaluated(log, **settings)
    assert sum(bool(re.search(text, each)) for each in texts) == 1
    assert sum(bool(re.search(text, each)) for each in report.warnings) == 1
    dropped = 2 if settings.get("outside") == "drop" else 0
    assert (report.facts["rows_left_out"], len(report.problem.log)) == (
        dropped,
        1500 - dropped,
    )


def test_uncovered_mass_is_warned_about():
    """A log whose moves the simulator does not make: every next state nearly a cell
    away.
    """
    _, report = evaluated(
        changed(next_state=lambda s: s + np.array([0, 0, 0, 0.2])), grid=(32, 32)
    )
    assert report.facts["uncovered_mass"] > 0.05
    assert any(
        "have probability 0 in the plain simulator" in text and "others" in text
        for text in report.warnings
    )


def test_the_command_s_configuration_by_hand():
    """The same numbers from the pieces: the log's places, floor .001, soft counts,
    strength .01, calibrated by the ratio.
    """
    report = evaluated(LOG)[1]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = discretize(CartPole(10), LOG, cells=(16, 16), floor=1e-3)
    pi = model.policy(cartpole_policy(0.0))
    zeta = oee.transition_ratio(
        model.counts(LOG), model.mdp, prior="simulator", strength=0.01
    )
    problem = oee.Problem(
        model.mdp, model.encode(LOG, seed=0), horizon=100, counts=model.counts(LOG)
    )
    raw = oee.estimators.OffEnvironment(zeta)(problem, pi)
    rows = by_row(report)
    assert_allclose(rows["oee on the grid"]["value"], raw.value, rtol=1e-12)
    mc = rows["simulator (continuous)"]
    below = oee.policy_value(model.plain, pi, horizon=100)
    for kind in ("ratio", "difference"):
        known = {
            "discretised": below,
            "continuous": mc["value"],
            "continuous_error": mc["standard_error"],
        }
        found = calibrate(raw, kind=kind, **known).diagnostics
        row = by_row(evaluated(LOG, calibration=kind)[1])["oee (calibrated)"]
        assert_allclose(row["value"], found["calibrated_value"], rtol=1e-12)
        assert_allclose(row["standard_error"], found["calibrated_standard_error"])
        assert_allclose(
            [row["lower"], row["upper"]],
            np.minimum(
                row["value"] + 1.96 * row["standard_error"] * np.array([-1, 1]),
                (1.0 - 0.99**100) / 0.01,  # what 100 rewards of 1 sum to
            ),
        )
    assert "oee (calibrated)" not in by_row(evaluated(LOG, calibration="none")[1])
    far = monte_carlo_value(CartPole(10), cartpole_policy(0.0), 4000, 100, seed=1)
    assert abs(mc["value"] - far.value) < 5 * np.hypot(
        mc["standard_error"], far.standard_error
    )


def test_the_corrected_simulator_comes_first():
    """Its value is that of the task by hand, its interval has the truth, and it is what
    is said first.
    """
    policy = cartpole_policy(0.4)
    report = evaluated(LOG, policy, episodes=3000)[1]
    first = report.records()[0]
    assert first["estimator"] == report.answers[0].estimator == "oee (residual)"
    corrected = ResidualSimulator(CartPole(10.0), LOG, seed=0)
    stream = np.random.default_rng(np.random.SeedSequence(0, spawn_key=(10**6,)))
    assert (
        first["value"]
        == monte_carlo_value(corrected, policy, 3000, 100, seed=stream).value
    )
    truth = monte_carlo_value(CartPole(15.0), policy, 20_000, 100, seed=0)
    assert first["lower"] < truth.value < first["upper"]
    before = by_row(report)["simulator (continuous)"]["value"]
    assert first["upper"] - first["lower"] < 0.5 * abs(before - truth.value)
    assert first["interval_method"] == "refits"
    said = report.uncertainty.sentences[0]
    assert said.startswith(
        "The target's steps differ from the simulator's in “x_dot” (by "
    )
    assert "theta_dot" in said
    assert "oee (residual)" not in by_row(
        evaluated(LOG, policy, estimators=["simulator"])[1]
    )


def test_transitions_without_support_are_reported_with_the_ways_out():
    """A few are left out of the rows on the cells, many leave those rows out; a way out
    that is in force is not advised.
    """
    texts, report = evaluated(LOG, grid=(60, 60), floor=0.0)
    pattern = (
        r"0.0032 of the log's transitions have no probability .* begin at state \d+"
    )
    assert any(re.search(pattern, text) for text in texts)
    assert 0.003 < report.facts["moves_left_out"] < 0.004
    assert any(
        "(theta=" in text and "leave them out" in text for text in report.warnings
    )
    columns = LOG.columns()
    columns["next_state"] = -columns["next_state"]
    bag = oee.ContinuousTransitions(
        **{k: columns[k] for k in ("state", "action", "next_state")}
    )
    few = Settings(grid="auto", episodes=50)
    for settings in (
        few,
        replace(few, floor=0.0, outside="drop"),
    ):  # the floor reaches as far as the log; or they are dropped
        assert (
            list(by_row(evaluated(bag, **vars(settings))[1]))[-1] == "oee on the grid"
        )
    texts, report = evaluated(bag, **vars(replace(few, floor=0.0)))
    said = (
        r"left out: .* none on .*, and no ratio exists there. Ways out: a defensive"
        r" share \(--task-option floor=0.001\), a c"
    )
    assert any(re.search(said, text) for text in texts)
    assert list(by_row(report)) == ["oee (residual)", "simulator (continuous)"]


@COARSE
def test_behaviour_probabilities_from_a_policy():
    """A log without probabilities gets them from the behaviour policy in its own
    states; without one nothing is said.
    """
    bare = oee.ContinuousTransitions(
        **{k: v for k, v in LOG.columns().items() if k != "behavior_probability"}
    )
    known = {"settings": Settings(grid=(16, 16), episodes=50), "seed": 0}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        report, without = (
            evaluate_continuous(
                SIMULATOR,
                bare,
                {"expert": SIMULATOR.expert},
                behavior=behavior,
                **known,
            )
            for behavior in (SIMULATOR.policy("mix:0.7"), None)
        )
    assert_allclose(report.problem.log.behavior_probability, LOG.behavior_probability)
    assert set(by_row(report)) - set(by_row(without)) == {"pdis", "wpdis"}
    assert not any("mportance sampling" in text for text in without.warnings)


def test_importance_sampling_is_in_the_log_s_own_states():
    """By hand: products of probabilities in each state, not in its cell."""
    policy = cartpole_policy(0.2)
    weight = policy(LOG.state)[np.arange(1500), LOG.action] / LOG.behavior_probability
    episodes = [LOG.episode == k for k in np.unique(LOG.episode)]
    paid = [
        (np.cumprod(weight[rows]) * 0.99 ** LOG.timestep[rows] * LOG.reward[rows]).sum()
        for rows in episodes
    ]
    for grid in (None, (16, 16)):
        assert by_row(evaluated(LOG, policy, estimators=["pdis"], grid=grid)[1])[
            "pdis"
        ]["value"] == pytest.approx(np.mean(paid))


@pytest.mark.filterwarnings("ignore:the 1000 cells of visited states .* is too coarse")
def test_the_whole_state_has_cells_of_its_own():
    task = named_task("cartpole:form=full")
    assert task.mdp.n_states == 1001
    assert task.expert().shape == (1001, 2)


def test_the_advice_says_where_a_cell_is():
    report = evaluated(LOG.first(500), grid="auto", episodes=200)[1]
    assert re.search(
        r"[Rr]ecord\s+action\s+\d\s+in\s+state\s+\d+\s+\(theta=[^)]*theta_dot=",
        str(report),
    )


# ---------------------------------------------------------------- the arms


def test_reacher_from_the_command_line(run):
    """Cells of the log, the averaged lengths as the simulator, the plain one beside it."""
    run(
        "sample reacher:length=0.2,tamed=True --policy mix:0.5 --transitions 5000"
        " --output log.npz"
    )
    words = (
        "evaluate --simulator reacher:length=0.1,reward_length=0.2,tamed=True --log"
        " log.npz"
    )
    chosen = "--quick --grid auto --json --policy mix:0.5 --task-option=simulations="
    # of 20 000 episodes the ratio of errors is .65; of 4000 it is .57 to .75 by chance
    printed = run(
        words,
        f"{chosen}4000 --estimators simulator,oee --target"
        " reacher:length=0.2,tamed=True",
    )
    report = json.loads(printed)
    value = {name: row["value"] for name, row in by_row(printed).items()}
    right = value["target (continuous)"]
    assert abs(value["oee on the grid"] - right) < 0.7 * abs(
        value["simulator (continuous)"] - right
    )
    assert "oee (calibrated)" not in value
    facts = report["facts"]
    assert facts["floor"] == 0.8
    assert (
        "a step is one of length=0.05; length=0.07; length=0.14; length=0.2 (plain:"
        " without)" in facts["simulator"]
    )
    assert any(
        text.startswith("standard errors and intervals count the log's noise")
        for text in report["warnings"]
    )
    plain = json.loads(
        run(words, f"{chosen}100 --estimators simulator --task-option=floor=0.2")
    )
    # of the plain simulator
    assert plain["facts"]["uncovered_mass"] == facts["uncovered_mass"] > 0.1
    text = run(words, "--policy file=pi.npy", code=2)
    assert (
        "--policy must be uniform, expert, mix:WEIGHT or MODULE:FUNCTION for Reacher,"
        " whose cells are made of" in text
    )


def test_the_arm_from_the_command_line(run):
    """Ties, calibration by the difference, and the stand-in's name."""
    pytest.importorskip(
        "mujoco", reason="MuJoCo is not installed: pip install '.[mujoco]'"
    )
    run(
        "sample kinova:velocity_scale=1.4 --policy expert --episodes 30 --output"
        " log.npz"
    )
    printed = run(
        "evaluate --simulator kinova --log log.npz --policy expert --estimators"
        " simulator,oee --grid=13x13x11 --json --quick",
        "--task-option=simulations=20 --horizon 6 --target kinova:velocity_scale=1.4",
    )
    report = json.loads(printed)
    value = {name: row["value"] for name, row in by_row(printed).items()}
    right = value["target (continuous)"]
    assert abs(value["oee (calibrated)"] - right) < 0.3 * abs(
        value["simulator (continuous)"] - right
    )
    moved = value["oee (calibrated)"] - value["oee on the grid"]
    assert moved == pytest.approx(
        value["simulator (continuous)"] - value["simulator (plain)"]
    )
    assert report["facts"]["ratio"] == {"tie": "displacements", "strength": 3.0}
    said = [
        t
        for t in report["warnings"]
        if "that were never recorded" in t and t.startswith("oee")
    ]
    assert said
    assert all(
        "Transitions of the same key elsewhere stand for them." in text for text in said
    )
    assert (
        "a step is one of scaled=0.5, scatter=2; scaled=1.5, scatter=2"
        in report["facts"]["simulator"]
    )

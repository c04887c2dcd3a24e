"""Bad input: an error at the call that names the argument, the place and the rule. The
table of calls is tests/bad_calls.py.
"""

import doctest
import importlib.util
import inspect
import warnings
from dataclasses import replace
from decimal import Decimal
from types import SimpleNamespace

import gymnasium
import numpy as np
import pandas as pd
import pytest
from bad_calls import TABLE
from fuzz_calls import arguments_of, call, functions
from fuzz_values import valid_values
from helpers import NAMED, survival_chain
from kernels.files import save_npz
from matplotlib.figure import Figure
from scipy import sparse

import oee_tabular as oee
from oee_tabular import ContinuousTransitions, FiniteMDP, Transitions
from oee_tabular.testing.assignments import check, draw_case

GOOD = np.array([[[0.5, 0.5], [0.0, 1.0]], [[1.0, 0.0], [0.3, 0.7]]])
CAN = [[True, True], [False, True]]
LACKING = np.array([[[0.5, 0.5], [0.0, 1.0]], [[0.0, 0.0], [0.3, 0.7]]])
PAIR = oee.bench.families()["corridor30"]
RAGGED = oee.testing.case("ragged")
RAGGED_PLAN = oee.plan_data_collection(
    RAGGED.problem(100, seed=0), RAGGED.policy, n=100
)
GRID = oee.tasks.gridworld(3, 0.3)
STIFF = oee.tasks.gridworld(3, 0.0)
UNIFORM = oee.uniform_policy(GRID)
LOG = oee.sample_episodes(GRID, UNIFORM, 4, 20, seed=0)
REPORT = oee.evaluate(oee.Problem(GRID, LOG), UNIFORM, estimators="simulator", seed=0)
PHI = np.arange(120.0) % 7
KEYS = np.arange(120) % 3
HALVES = [[0.5, 0.5]] * 2
COIN = np.full((2, 1, 2), 0.5)
SIGNALLING = [Decimal(0), Decimal("sNaN")]
ITSELF = []
ITSELF.append(ITSELF)
SGD = {"solver": "sgd", "normalized": False, "lower": 0.1, "upper": 9.0}


def edited(array, index, value):
    changed = np.array(array, dtype=float)
    changed[index] = value
    return changed


def spoilt(kind, data):
    """A sparse matrix whose data was replaced."""
    matrix = kind(GOOD.reshape(-1, 2))
    matrix.data = data
    return matrix


class Trained:
    """A model as another library has them."""

    def predict(self, state, deterministic=True):
        return np.array(0), None


def rows(array):
    """The same as a sparse matrix of rows."""
    return sparse.csr_array(array.reshape(-1, array.shape[-1]))


def mdp(
    transitions=GOOD, rewards=(0.0, 1.0), initial=(1.0, 0.0), discount=0.9, **options
):
    rewards = np.array(rewards) if isinstance(rewards, tuple) else rewards
    return FiniteMDP(transitions, rewards, initial, discount, **options)


def walk(stay):
    """From 0 to the end 1 with probability 1 - stay, -1 a step."""
    return FiniteMDP([[[stay, 1 - stay]], [[0, 1.0]]], [-1.0, 0.0], 0, 1.0)


def log(**changes):
    columns = {
        "state": [0, 1, 2],
        "action": [0, 0, 1],
        "next_state": [1, 2, 0],
        "episode": [0, 0, 0],
    }
    return Transitions(**(columns | changes))


def without(name):
    return Transitions(
        **{key: value for key, value in LOG.columns().items() if key != name}
    )


def frame(**changes):
    return pd.DataFrame(
        {"state": ["hall"], "action": ["go"], "next_state": ["dock"]}
    ).assign(**changes)


def broken():
    matrix = sparse.csr_array(np.ones((6, 3)))
    matrix.indptr[5] = 10**6  # native code would follow it
    return matrix


def from_env(env, **more):
    return FiniteMDP.from_env(env, samples_per_pair=1, **more)


def prior_that_returns(rows):
    return SimpleNamespace(uses=frozenset(), fit_rows=lambda given, solver: rows)


def density(**options):
    return oee.density_ratio([3, 1, 2], [1, 1, 1], **options)


def zeta(**options):
    return oee.transition_ratio(LOG.counts(9, 4), GRID, **options)


def boxed(**options):
    box = {
        "lower": 0.2,
        "upper": 5.0,
        "normalized": False,
        "functions": oee.ratio.Network(),
    }
    return oee.ratio.Quotient(**box | options)


def plan(problem, policies=UNIFORM, **options):
    return oee.plan_data_collection(problem, policies, **{"n": 1} | options)


def family(**changes):
    given = {
        name: getattr(PAIR, name)
        for name in ("simulator", "target", "policy", "data_policy", "about")
    }
    return oee.bench.Family(**(given | changes))


def compared(estimator=lambda problem, policy: 1.0, pair=(GRID, GRID), **options):
    return oee.testing.compare_with_oracle(
        estimator, pair, UNIFORM, **{"n": 9, "behavior_policy": UNIFORM} | options
    )


POLE = oee.tasks.cartpole_policy(0.3)


def pole(width=4, rows=slice(None), **first):
    """A log of CartPole: so many coordinates of its states, these rows; ``first``:
    other values in row 0.
    """
    log = oee.tasks.record(
        oee.tasks.CartPole(), POLE, n_transitions=50, max_steps=100, seed=0
    )
    columns = {
        name: np.array(log.columns()[name])[rows]
        for name in ("state", "action", "next_state")
    }
    for name, value in first.items():
        columns[name][0] = value
    return ContinuousTransitions(
        columns["state"][:, :width], columns["action"], columns["next_state"][:, :width]
    )


def states(**changes):
    columns = {
        "state": [[0.0, 0.1], [0.4, 0.1]],
        "action": [0, 1],
        "next_state": [[0.4, 0.1], [0.5, 0.0]],
        "episode": [4, 4],
    }
    return ContinuousTransitions(**(columns | changes))


def hand(width, size=0.1, action=(0.0, 0.0, 1.0)):
    return ContinuousTransitions(
        np.full((2, width), size), [list(action)] * 2, np.full((2, width), size)
    )


def corrected():
    return oee.tasks.ResidualSimulator(oee.tasks.CartPole(), pole(), seed=0)


def cells(shape=(6, 6), **options):
    return oee.tasks.discretize(
        oee.tasks.CartPole(), cells=shape, **{"closure_episodes": 0} | options
    )


class Nowhere(oee.tasks.CartPole):
    def moves(self, states, actions, disturbance):
        moved = super().moves(states, actions, disturbance)
        return replace(moved, next_state=np.nan * moved.next_state)


def pendulum(**changes):
    named = {
        "state_names": ("angle", "speed"),
        "actions": [[-2.0], [2.0]],
        "low": [-4.0, -8.0],
        "high": [4.0, 8.0],
    }
    return oee.tasks.GymnasiumTask(
        lambda: gymnasium.make("Pendulum-v1"), **named | changes
    )


NAMES = {}
for room in (
    oee,
    oee.bench,
    oee.estimators,
    oee.exact,
    oee.inference,
    oee.mdp,
    oee.plots,
    oee.ratio,
    oee.shrinkage,
    oee.simulate,
    oee.report,
    oee.tasks,
    oee.testing,
    oee.theory,
):
    NAMES |= {name: getattr(room, name) for name in room.__all__}
NAMES |= globals() | {
    "HALL": NAMED,
    "CHAIN": survival_chain(),
    "ONES": survival_chain().transitions.sign(),
    "ONLY": np.ones((2, 1)),
    "LOOP": FiniteMDP(np.eye(6)[[[0]] * 6], np.zeros(6), 0, 0.9),
    "COIN": FiniteMDP(COIN, [1.0, 0.0], 0, 0.9),
    "PAID": FiniteMDP(COIN, np.ones((2, 1, 2)), 0, 0.9),
    "PLACES": np.array([[0.5, -1.0], [2.0, 3.0], [7.0, 7.0]]),
    "PLACE": np.arange(9.0),
    "ONE": oee.Estimate(1.0),
    "HUGE": GRID.with_rewards(1e200 * GRID.rewards),
    "ENDLESS": GRID.with_discount(1.0),
    "P": oee.Problem(GRID, LOG),
    "RIGID": oee.Problem(STIFF, Transitions([0], [0], [3])),
    "EVEN": UNIFORM / 9,
    "UP": np.eye(4)[np.zeros(9, dtype=int)],
    "ZETA": oee.true_ratio(GRID, GRID),
    "COUNTS": LOG.counts(9, 4),
    "FAR": Transitions([9], [0], [0]),
    "NEVER": Transitions(
        **LOG.columns() | {"behavior_probability": np.zeros(len(LOG))}
    ),
    "BROKEN": broken(),
    "HALS": Transitions(["hall", "hal", "hall", "hal"], ["go"] * 4, ["hall"] * 4),
    "AXES": Figure().subplots(),
    "TWINS": np.stack([np.arange(36.0), np.ones(36), 3 - np.arange(36.0)], axis=1),
    "from_episodes": Transitions.from_episodes,
    "from_frame": Transitions.from_frame,
    "TRIED": oee.Problem(GRID, LOG, trials=oee.Trials([-1.0], policy=UNIFORM)),
    "success_simulator": oee.data.success_simulator,
    "check_answer": check,
    "draw_case": draw_case,
    "LAKE": oee.tasks.make_environment("FrozenLake-v1"),
}
LINES = [line for line in TABLE.replace("\n  ", " ").splitlines() if "  ->  " in line]


@pytest.mark.parametrize("line", LINES, ids=lambda line: line[:60])
@pytest.mark.filterwarnings("ignore")
def test_bad_calls(line):
    source, text = line.split("  ->  ", 1)
    with pytest.raises((ValueError, TypeError, FileNotFoundError)) as refused:
        eval(source, NAMES)
    wanted = f"{text.rstrip()}...\n"
    assert doctest.OutputChecker().check_output(
        wanted, f"{refused.value}\n", doctest.ELLIPSIS
    ), refused.value


POSITIVE = [(0, "must be a positive integer"), (1.5, "must be a positive integer")]
SEED = [("a", "must be what numpy.random."), (-1, "must be what numpy.random.")]
SHARES = [(2 * UNIFORM, "must sum to 1"), (3, "must have shape (9, 4)")]
BOUND = [(-1, "must be in [0, inf"), ("x", "must be a number")]
# of an argument's name: what is given, and the rule, whichever public function has it
RULES = {
    "mdp": [(3, "must be a FiniteMDP")],
    "simulator": [(3, "must be a FiniteMDP")],
    "target": [(3, "must be a FiniteMDP")],
    "problem": [(3, "must be a Problem")],
    "discount": [(1.5, "must be in [0, 1]"), ("x", "must be a number")],
    "policy": [
        (3, "must be an action, or a distribution"),
        ("x", "must be an action, or"),
        (2 * UNIFORM, "must sum to 1"),
    ],
    "behavior_policy": [(2 * UNIFORM, "must sum to 1")],
    "data_distribution": SHARES,
    "distribution": SHARES[:1],
    "confidence": [(1.0, "must be in (0, 1)"), ("x", "must be a number")],
    "lower": BOUND,
    "upper": BOUND,
    "ridge": BOUND[:1],
    "lower_ratio": [("x", "must be a number")],
    "upper_ratio": [("x", "must be a number")],
    "unrecorded": [("x", "must be a number"), (0.5, "must be in [1, inf]")],
    "interval_seconds": [("x", "must be a number"), (0, "must be in (0, inf)")],
    "delta": [(1.5, "must be in [0, 1]")],
    "floor": [(1.5, "must be in [0, 1]")],
    "path": [(3, "must be "), ("a\0", "must be text"), (None, "must be ")],
    "slip": [(1.1, "must be in [0, 1]")],
    "weight_of_a": [(2, "must be in [0, 1]")],
    "discretised": [(np.inf, "must be finite")],
    "continuous_error": BOUND,
    "eta": BOUND,
    "reward_bound": [(np.inf, "must be finite")],
    "order": [(0, "must be positive"), ("x", "must be a number")],
    "constant": [(0.0, "must be in (0, inf)")],
    "p_min": [(2.0, "must be in [0, 1]")],
    "gravity": BOUND,
    "noise": [(np.nan, "must be in [0, inf)")],
    "gear": BOUND,
    "timestep": [(0.0, "must be in (0, inf)")],
    "reward_length": [(0.0, "must be in (0, inf)")],
    "velocity_scale": [(-1.0, "must be in [0, 3]")],
    "latency": [(0.3, "must be in [0, 0.2]")],
    "payload": [(np.nan, "must be in")],
    "refits": [(1, "must be at least 2")],
    "closure_episodes": [(-1, "must be a positive integer")],
    "repetitions": [(1, "must be at least")],
    "held_out": [(-0.1, "must be in [0, 1]")],
    "epsilon": [("x", "must be a number")],
    "step_size": [(0, "must be in (0, inf)")],
    "seed": SEED,
    "n_states": POSITIVE,
}
for number in (
    "horizon",
    "n",
    "n_actions",
    "n_episodes",
    "n_rollouts",
    "max_steps",
    "n_draws",
    "n_lengths",
    "batch_size",
    "n_iterations",
    "patience",
    "n_bootstrap",
    "m",
    "k",
    "kept_moves",
    "n_cells",
    "paths",
    "substeps",
    "population",
    "n_runs",
    "n_transitions",
    "max_states",
    "max_horizon",
    "top",
):
    RULES[number] = POSITIVE
for word in (
    "impossible",
    "bad_rows",
    "loss",
    "radius",
    "resample",
    "of",
    "sampling",
    "fallback",
    "weights",
    "ragged",
    "pay",
    "behavior",
    "evaluation",
    "weighting",
    "activation",
    "optimizer",
    "support",
    "kind",
    "method",
    "form",
    "inertia",
):
    RULES[word] = [("words", "must be one of '")]
# functions in which the name means something else, or is not used or checked in the
# call that is tried
OTHERWISE = {
    "seed": [
        "transition_ratio",
        "interval",
        "density_ratio",
        "Conditional.fit",
        "InClass.fit",
        "Tied.fit",
        "discretize",
        "ContinuousSimulator.discretize",
        "Families",
        "families",
        "garnet_worse",
        "run",
        "check_estimator",
        "Case.logs",  # which draws when it is asked for the first
    ],
    "repetitions": ["Case.logs"],
    "horizon": ["transition_ratio", "plan_data_collection"],
    "n_episodes": ["record", "record_episodes", "ContinuousSimulator.record"],
    "policy": [
        *("monte_carlo_value", "record", "record_episodes", "corrected_value"),
        *("ContinuousSimulator.record", "Discretization.policy"),
        "Discretization.closure_error",
        *("Trials", "Trials.from_successes"),  # names as well
    ],
    "behavior_policy": ["transition_ratio", "compare_with_oracle", "Joint", "Quotient"],
    "simulator": [
        "Transitions.from_episodes",
        "Transitions.from_frame",
        "Transitions.numbered",
        "evaluate_continuous",
    ],
    "target": ["Reacher", "reacher_policy", "evaluate_continuous"],
    "path": ["Report.to_html", "Improvement.to_html"],
    "paths": ["plot_paths"],
    "discount": ["TransitionCounts.counts"],
    "timestep": ["Transitions.from_frame"],
    "n": ["plot_errors", "Case.logs"],
    "unrecorded": ["plot_occupancy"],
    "lower": ["plot_intervals"],
    "upper": ["plot_intervals"],
    "ridge": ["Conditional", "InClass", "Joint"],
    "weights": ["RatioFit", "cartpole_policy", "Discretization.mixture"],
    "method": ["TransitionRatio"],
    "kind": ["Finding"],
    "behavior": ["evaluate_continuous"],
    "n_bootstrap": ["interval", "compare_policies"],
}


@pytest.fixture(scope="module")
def known():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return valid_values()


@pytest.mark.parametrize("argument", RULES)
@pytest.mark.filterwarnings("ignore")
def test_one_argument_has_one_rule_everywhere(argument, known):
    """A class of results keeps what it is given."""
    checked = 0
    for name, function in functions(known).items():
        is_room = any(
            name in getattr(oee, room).__all__ for room in ("estimators", "ratio")
        )
        kept = (
            inspect.isclass(function)
            and (name in known["holders"] or name == "Embedded")
            and not is_room
        )
        if (
            kept
            or name in OTHERWISE.get(argument, ())
            or argument not in inspect.signature(function).parameters
        ):
            continue
        values = arguments_of(name, function, known)
        for wrong, rule in RULES[argument]:
            with pytest.raises(ValueError) as refused:
                call(function, values | {argument: wrong})
            found = str(refused.value)
            assert found.startswith(argument), (name, found)
            assert rule in found, (name, found)
        checked += 1
    assert checked or (
        argument == "n_runs" and importlib.util.find_spec("mujoco") is None
    )


def test_files_that_hold_something_else(tmp_path):
    GRID.save(tmp_path / "mdp.npz")
    LOG.save(tmp_path / "log.npz")
    np.savez(tmp_path / "other.npz", a=np.ones(3))
    (tmp_path / "broken.npz").write_bytes(b"PK\x03\x04 not really")
    (tmp_path / "broken.parquet").write_bytes(b"no")
    (tmp_path / "no_columns.csv").write_text("s,a\n0,1\n")
    (tmp_path / "gap.csv").write_text("state,action,next_state\n0,1,2\n1,,2\n")
    (tmp_path / "words.csv").write_text("state,action,next_state\nhall,0,2\n")
    (tmp_path / "empty.csv").write_text("")
    (tmp_path / "surplus.csv").write_text("state,action,next_state\n0,0,1,9\n")
    save_npz(tmp_path / "parts.npz", "finite_mdp", {"shape": np.array([2, 1])})
    table = [
        (
            FiniteMDP.load,
            "log.npz",
            r"must hold a FiniteMDP; it holds a log of numbered states",
        ),
        (
            Transitions.load,
            "mdp.npz",
            r"must hold a log of numbered states \(Transitions\); it holds a FiniteMDP",
        ),
        (FiniteMDP.load, "other.npz", r"must hold a FiniteMDP; it holds the arrays "),
        (FiniteMDP.load, "broken.npz", r"must be an npz or npy file of plain arrays"),
        (Transitions.load, "broken.parquet", r"must be a parquet table"),
        (
            Transitions.load,
            "no_columns.csv",
            r"must have the columns state, action, next_state; it has s, a",
        ),
        (Transitions.load, "gap.csv", r"action\[1\] must have a value; it has none"),
        (Transitions.load, "words.csv", r"words.csv': state\[0\] must be a number"),
        (Transitions.load, "surplus.csv", r"must have 3 fields, as the header has"),
        (
            FiniteMDP.load,
            "parts.npz",
            r"must hold every part of a FiniteMDP; 'rewards_data' is missing",
        ),
        (
            Transitions.load,
            "empty.csv",
            r"must have a header; the file is empty \(beside other files of a log",
        ),
    ]
    for load, name, text in table:
        with pytest.raises(ValueError, match=text):
            load(tmp_path / name)
    for name in ("nowhere.npz", "nowhere.csv", "nowhere.parquet"):
        with pytest.raises(FileNotFoundError, match="nowhere"):
            Transitions.load(tmp_path / name)


def test_an_extra_that_is_not_installed_is_named(tmp_path, monkeypatch):
    import importlib.util

    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(
        ImportError, match=r"is not installed; in a clone: pip install '.\[minari\]'"
    ):
        LOG.save(tmp_path / "folder")
    assert list(tmp_path.iterdir()) == []

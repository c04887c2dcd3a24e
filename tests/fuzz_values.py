"""What tests/fuzz_calls.py gives: a valid value for each argument, by its name, and
hostile ones.
"""

import array
import collections
import contextlib
import datetime
import enum
import functools
import importlib.util
import io
import pathlib
import re
import tempfile
import types
import uuid
from decimal import Decimal
from fractions import Fraction
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy import sparse

import oee_tabular as oee
from oee_tabular.ratio.method import Population

SIZE = 3
T = 3


class Raises:
    """Everything that is asked of it fails, but with no error of ours."""

    n_states = 9
    n_actions = 4
    terminal_state = ()

    def __call__(self, *_, **__):
        return "no"


class Spite(Exception):
    """What a hostile object raises: of its own, and no error of the package."""


class SpiteOfText(Exception):
    """What it raises where it is written: no error may need its text."""


def spiteful(*names, kind=object, error=Spite, **fields):
    """An object whose methods of these names raise."""

    def fail(*_, **__):
        raise error("no")

    return type("Spiteful", (kind,), {**dict.fromkeys(names, fail), **fields})()


class Quantity:
    """Numbers with a unit, as pint and astropy have them."""

    def __init__(self, magnitude, unit):
        self.magnitude = self.value = magnitude
        self.units = self.unit = unit
        self.shape = np.shape(magnitude)
        self.dtype = np.asarray(magnitude).dtype
        self.ndim = len(self.shape)

    def __array__(self, dtype=None, copy=None):
        return np.array(self.magnitude, dtype=dtype)

    def __len__(self):
        return len(self.magnitude)

    def __getitem__(self, key):
        return Quantity(self.magnitude[key], self.unit)

    def __repr__(self):
        return f"{self.magnitude} {self.unit}"


class Fresh:
    """A hostile value that a call uses up, or changes: each call has its own."""

    def __init__(self, make):
        self.make = make


def circle():
    """A list that contains itself."""
    value = [0]
    value.append(value)
    return value


def circle_of_dicts():
    """A dict that contains itself."""
    value = {}
    value["a"] = value
    return value


def array_with_itself():
    """An array of objects that contains itself."""
    value = np.empty(2, dtype=object)
    value[0] = value
    return value


def endless():
    """A generator that raises after a while."""
    yield from range(5)
    raise Spite("no more")


@functools.cache
def valid_values():
    """A value for every argument that has one name in all functions."""
    simulator, target = (oee.tasks.gridworld(SIZE, slip=slip) for slip in (0.3, 0.1))
    uniform = oee.uniform_policy(target)
    expert = oee.tasks.gridworld_expert(SIZE)
    log = oee.sample_episodes(target, uniform, 20, 20, seed=0)
    zeta = oee.true_ratio(target, simulator)
    even = np.full((9, 4), 1 / 36)
    g = np.array([1.0, 0.8, 1.3])
    p = np.array([0.3, 0.4, 0.3])
    q = np.array([0.4, 0.3, 0.3])
    problem = oee.Problem(simulator, log, horizon=20)
    cartpole = oee.tasks.CartPole()
    moves = oee.tasks.record(
        cartpole, oee.tasks.cartpole_policy(0.5), n_transitions=60, max_steps=30, seed=0
    )
    known = {
        "mdp": target,
        "simulator": simulator,
        "target": target,
        "model": simulator,
        "models": target,
        "values_of": None,
        "policy": uniform,
        "behavior_policy": uniform,
        "minus": uniform,
        "running": uniform,
        "policy_a": uniform,
        "policy_b": expert,
        "weight_of_a": 0.5,
        "policies": {"uniform": uniform, "expert": expert},
        "zeta": zeta,
        "ratio": None,
        "horizon": T,
        "seed": 0,
        "distribution": even,
        "data_distribution": even,
        "simulator_distribution": even,
        "n": 50,
        "n_episodes": 5,
        "moves": target.transitions,
        "log": log,
        "log_or_counts": log,
        "problem": problem,
        "episodes": None,
        "p": p,
        "q": q,
        "g": g,
        "x_p": np.arange(10.0)[:, None],
        "x_q": np.arange(8.0)[:, None],
        "k": 1,
        "pairs": g,
        "true_moves": g,
        "true_pairs": g,
        "mu": 2.0,
        "nu": 0.5,
        "error": 0.1,
        "eta": 0.1,
        "order": 2.0,
        "reward_bound": 1.0,
        "discount": 0.9,
        "confidence": 0.95,
        "renyi": 2.0,
        "constant": 1.0,
        "p_min": 0.1,
        "q_min": 0.1,
        "n_cells": 5,
        "lower": 0.5,
        "upper": 2.0,
        "lower_ratio": None,
        "upper_ratio": None,
        "delta": 0.5,
        "goal": 0,
        "estimates": g,
        "truths": p,
        "epsilon": 0.1,
        "n_months": None,
        "source": "recorded",
        "simulator_group": 3,
        "target_group": 4,
        "data_policy": uniform,
        "size": SIZE,
        "slip": 0.1,
        "available": np.ones((9, 4), dtype=bool),
        "masked": False,
        "allow_unavailable": True,
        "alpha": 0.8,
        "beta": 0.6,
        "search_reward": 2.0,
        "wait_reward": 1.0,
        "rescue_reward": -3.0,
        "identifier": "FrozenLake-v1",
        "spec": "gridworld:3,slip=0.3",
        "state": [0, 1],
        "action": [1, 0],
        "next_state": [1, 2],
        "reward": [0.0, 1.0],
        "count": [3, 1],
        "operand": 1.0,
        "figure": Figure(),
        "about": {"machine": "a chain"},
        "command": "oee bench",
        "factor": 0.5,
        "key": "coverage",
        "transitions": target.transitions,
        "rewards": np.zeros((9, 4)),
        "initial": target.initial,
        "name": "ragged",
        "kernel": target.transitions[::4],
        "b": target.initial,
        "path_divergence": np.array([0.0, 0.1, 0.2]),
        "estimate": oee.Estimate(1.0, 0.1),
        "discretised": 1.0,
        "continuous": 1.2,
        "new": simulator.transitions,
        "n_states": 9,
        "n_actions": 4,
        "rows": [0, 1],
        "gradient": np.ones(target.transitions.nnz),
        "logs": [log, log],
        "env": oee.tasks.make_environment("FrozenLake-v1"),
        "coordinates": np.arange(9.0),
        "layout": np.arange(9.0),
        "bandwidth": 1.0,
        "estimator": oee.estimators.ModelBased(),
        "pair": (simulator, target),
        "solver": "dual",
        "task": cartpole,
        "max_steps": 20,
        "length": 0.1,
        "gravity": 10.0,
        "states": np.arange(9),
        "actions": (0, 1, 2, 3),
        "probability": 0.5,
        "folder": Path(tempfile.gettempdir()) / "none",
        "per_row": 1.0,
        "continuous_log": moves,
        "path": Path(tempfile.gettempdir()) / "new.npz",
        "matrix": target.transitions,
        "m": 10,
        "samples_per_pair": 2,
        "frame": pd.DataFrame(log.columns()),
        "generator": np.random.default_rng(0),
        "population": population(target, simulator, uniform),
        "holders": holders(
            target,
            simulator,
            {"uniform": uniform, "expert": expert},
            log,
            zeta,
            problem,
            moves,
        ),
    }
    return known | {"own": own_values(known)}


def population(target, simulator, policy):
    """What estimators' limits are of."""
    return Population(
        simulator, target, policy, policy / 9, np.ones(36, dtype=bool), policy, 20
    )


def holders(target, simulator, policies, log, zeta, problem, moves):
    """A valid object of each public class: what its methods are bound to."""
    log.save(path := Path(tempfile.mkdtemp()) / "log.npz")
    uniform = policies["uniform"]
    values = [
        target,
        log,
        moves,
        oee.Transitions.open(path),
        oee.transition_ratio(log, simulator),
        problem,
        oee.Estimate(1.0, 0.1),
        oee.density_ratio([1, 2], [2, 1]),
        oee.interval(problem, uniform),
        oee.return_moments(target, uniform),
        oee.exact.reweight(simulator, zeta),
        oee.plots.map_of(target),
        oee.plan_data_collection(problem, uniform, n=20),
        oee.evaluate(problem, uniform, quick=True),
        oee.exact.solve_policy_system(target.transitions[::4], target.initial, 0.9),
        oee.sample_returns(target, uniform, 9, 5, seed=0),
        oee.robust_policy(simulator, 0.5, 2.0),
    ]
    values += [
        values[13].results[0],
        oee.report.Settings(episodes=100),
        *results(values, problem, policies, target, simulator),
    ]
    return {type(value).__name__: value for value in values} | {
        "OracleComparison": oee.testing.compare_with_oracle(
            oee.estimators.ModelBased(),
            (simulator, target),
            uniform,
            n=20,
            data_distribution=uniform / 9,
            repetitions=2,
        )
    }


def results(values, problem, policies, target, simulator):
    """Objects that calls return, methods of ratios, and estimators."""
    compared = oee.inference.compare_policies(problem, policies, n_draws=20)
    verdict = oee.testing.Verdict("limit", "held", "x")
    sgd = {
        "normalized": False,
        "lower": 0.1,
        "upper": 9.0,
        "solver": oee.ratio.Sgd(n_iterations=5),
    }
    cartpole = oee.tasks.CartPole()
    league = oee.bench.run("model-based", families=["machine"], sizes=[3], seeds=1)
    estimators = [getattr(oee.estimators, name)() for name in ESTIMATORS]
    return [
        oee.density_ratio([1, 2], [2, 1], **sgd).trace,
        compared,
        compared.decide(),
        oee.check_assumptions([1, 1], [1, 1], lower=0.5, upper=2.0),
        oee.inference.row_changes(problem),
        verdict,
        oee.inference.selection_measures([1, 2], [1, 3]),
        values[12].policies[0],
        oee.estimators.Finding("x", 1.0, "x"),
        oee.theory.Sides(0.0, 1.0),
        oee.theory.simulation_lemma(target, simulator, policies["uniform"]),
        (decided := oee.improve(problem, policies["uniform"])),
        decided.candidates[0],
        league,
        oee.theory.universal_constant_counterexample(1000),
        oee.testing.case("exact"),
        oee.bench.families()["machine"],
        oee.testing.Verdicts("x", frozenset(), 0, {"limit": verdict}),
        oee.tasks.named_task("gridworld:3,slip=0.1"),
        oee.tasks.Moves(np.zeros((2, 4)), np.zeros(2), np.zeros(2, dtype=bool)),
        oee.tasks.MonteCarlo(1.0, 0.1, 1.0, 100),
        oee.tasks.discretize(cartpole, cells=(3, 3), closure_episodes=0),
        oee.ratio.Conditional(),
        oee.ratio.NoPrior(),
        oee.ratio.PriorRows(np.zeros(3)),
        oee.shrinkage.Shrinkage(),
        oee.shrinkage.SoftThreshold(),
        oee.ratio.Sgd(),
        oee.ratio.Table(),
        oee.ratio.Linear(np.arange(3.0)),
        oee.ratio.Kernel(np.arange(3.0)),
        oee.tasks.ParameterFit(
            cartpole, {"gravity": 9.8}, {"gravity": 0.1}, np.zeros(4), {"gravity": 10.0}
        ),
        oee.ratio.Quotient(),
        oee.ratio.Joint(),
        oee.ratio.Tied(np.arange(120) % 3),
        oee.ratio.Network(),
        *estimators,
        oee.ratio.InClass(features=np.arange(120) % 3.0),
        oee.tasks.gymnasium_simulator("Pendulum-v1"),
        oee.tasks.embedded_default(seed=0),
        oee.Trials([-3.0, -2.0, -4.0], policy="mine"),
        oee.inference.join_trials(
            tried_problem(problem.simulator, problem.log), policies["uniform"]
        ),
        oee.tasks.bus_engines(30, seed=0),
    ]


ESTIMATORS = (
    "DoublyRobust",
    "DualDice",
    "ImportanceSampling",
    "Magic",
    "Marginalized",
    "ModelBased",
    "OffEnvironment",
    "Simulator",
)


def saved(known, name):
    """The path of a file that an object of a class was saved to."""
    path = str(Path(tempfile.mkdtemp()) / f"{name}.npz")
    known["holders"][name].save(path)
    return {"path": path}


def tried_file():
    """The path of a table of trials."""
    path = Path(tempfile.mkdtemp()) / "trials.csv"
    path.write_text("success\n1\n0\n1\n", encoding="utf-8")
    return path


def tried_problem(simulator, log):
    """A problem with trials."""
    trials = oee.Trials([-3.0, -2.0, -4.0])
    return oee.Problem(simulator, log, horizon=20, trials=trials)


def own_values(known):
    """Arguments whose meaning differs from that of the same name elsewhere: function
    name -> values.
    """
    moves = known["continuous_log"]
    log = known["log"]
    simulator = known["simulator"]
    driver = oee.tasks.cartpole_policy(0.5)
    # rewards r(s, a)
    paid = [oee.tasks.gridworld(SIZE, slip, pay="current") for slip in (0.1, 0.3)]
    files = {
        f"{n}.load": saved(known, n)
        for n in (
            "ContinuousTransitions",
            "FiniteMDP",
            "TransitionCounts",
            "Transitions",
        )
    }
    columns = dict.fromkeys(
        (
            "reward",
            "terminated",
            "truncated",
            "episode",
            "timestep",
            "behavior_probability",
        )
    )
    trials = {"policy": None, "discount": None, "horizon": None, "success": 8}
    kernel = {"kernel": None, "coordinates": None}
    ratio_options = (
        "horizon",
        "discount",
        "bandwidth",
        "lower",
        "upper",
        "behavior_policy",
        *kernel,
    )
    counted = dict(
        zip(
            ("simulator", "n_states", "n_actions", "bad_rows", "progress"),
            (None, 9, 4, "refuse", False),
            strict=True,
        )
    )
    # of .umb files by others
    files["FiniteMDP.load"] |= dict.fromkeys(("reward", "success", "until"))
    own = {
        "Report.legend": {"rows": known["holders"]["Report"].records()},
        "ContinuousTransitions.concatenate": {"logs": [moves, moves]},
        "FiniteMDP.from_env": {"max_steps": 100},
        "FiniteMDP.to_env": {"max_steps": 100},
        "TransitionCounts.led_to": {
            "next_state": known["holders"]["TransitionCounts"].next_state
        },
        "TransitionRatio.maximum_likelihood_model": {"simulator": simulator},
        "Transitions.led_to": {"next_state": log.next_state},
        "Transitions.from_episodes": {
            "episodes": [[(0, 1, 0.5), (1, 2, 0.0)], [(3, 0, 1.0)]]
        },
        "Transitions.from_frame": {
            "frame": known["frame"],
            "state": "state",
            "reward": None,
        },
        "Transitions.open": saved(known, "Transitions") | counted,
        "Transitions": (
            columns | {name: known[name] for name in ("state", "action", "next_state")}
        ),
        "ContinuousTransitions": (
            columns
            | {
                name: getattr(moves, name)[:2]
                for name in ("state", "action", "next_state")
            }
        ),
        "reweight": {"ratio": known["zeta"]},
        "check_policy": {"name": "policy", "horizon": None},
        "plan_data_collection": {"horizon": None, "n": 20, "solver": "auto"},
        "evaluate_continuous": {
            "simulator": oee.tasks.CartPole(10.0),
            "log": moves,
            "policies": {"mine": driver},
            "settings": oee.report.Settings(episodes=100),
            "history": 0,
            "horizon": 20,
            "target": None,
        },
        "check_page": {"path": Path(tempfile.gettempdir()) / "page.html"},
        "contest": {"policies": [known["policy"], known["policy"]]},
        "evaluate": {"target": None, "estimators": ["oee", "model-based"]},
        "transition_ratio": dict.fromkeys(ratio_options),
        "InClass": {"features": np.arange(simulator.transitions.nnz) % 3.0, **kernel},
        "Tied": {"tie": np.arange(simulator.transitions.nnz) % 3},
        "interval": {"n_bootstrap": 20},
        "improve": {"candidates": None, "split": None, "unrecorded": 3.0},
        "compare_policies": {"n_draws": 100, "n_bootstrap": 20},
        "ResidualSimulator": {"log": moves},
        "LinearModel": {"log": moves},
        "resimulate": {"log": moves},
        "record": {"policy": driver, "n_episodes": None, "n_transitions": 20},
        "monte_carlo_value": {"policy": driver},
        "record_episodes": {
            "n_transitions": 20,
            "n_episodes": None,
            "policy": np.full((16, 4), 0.25),
        },
        "DualDice.__call__": {"problem": oee.Problem(simulator, log)},
        "Problem": {"behavior_policy": None, "rewards": "simulator", "trials": None},
        "Trials": trials | {"returns": [-3.0, -2.0, -4.0], "weight": [1.0, 1.0, 2.0]},
        "Trials.from_successes": trials | {"successes": 9, "trials": 12},
        "Trials.load": {
            "path": tried_file(),
            "measure": None,
            "task": None,
            "discount": None,
            "horizon": None,
            "success": 8,
        },
        "Trials.of": {"name": "mine"},
        "success_simulator": {"success": 8},
        "join_trials": {
            "problem": tried_problem(simulator, log),
            "name": None,
            "seconds": None,
        },
        "Magic": {"ratio": "conditional"},
        "Marginalized": {
            "ratio": "conditional",
            "lower": None,
            "upper": None,
            "features": None,
        },
        "OffEnvironment": {"ratio": "conditional"},
        "DoublyRobust": {"ratio": "conditional"},
        "ratio_error_sides": {"moves": known["g"]},
        "compare_with_oracle": {
            "n": 20,
            "repetitions": 3,
            "horizon": None,
            "data_distribution": known["data_distribution"],
        },
        "relabelled_log": {"states": np.arange(9), "actions": np.arange(4)},
        "estimation_sides": {"n": 1000},
        "universal_constant_counterexample": {"n": 1000, "mu": 10.0, "nu": 0.1},
        "Reacher": {"target": (0.1, 0.1)},
        "value_error_sides": {"target": paid[0], "model": paid[1]},
        "value_bound_counterexample": {"nu": 0.9, "epsilon": 0.01},
        "KinovaArm": {"goal": 0},
        "kinova_policy": {"delta": 0.0},
    }
    own |= {
        "families": {"seed": 0},
        "garnet_worse": {"n_states": 5},
        "tandem": {"size": 3},
        "check_estimator": {"laws": ["limit"]},
        "league_of": {"table": known["holders"]["League"].table},
        "as_code": {"value": known["holders"]["Case"].simulator},
        "Families": {"makers": {}, "seed": 0, "left_out": {}},
        "run": {
            "estimators": "model-based",
            "families": ["machine"],
            "sizes": [3],
            "seeds": 1,
            "jobs": 1,
        },
        "Finding.sentence": {"figure": "x"},
        "ArgumentError": {"argument": "x", "rule": "must be y"},
        "UnknownKeywordError": {
            "function": "f",
            "keyword": "x",
            "nearest": None,
            "known": ["y"],
        },
        "Comparison.bounds": {"one": "uniform", "other": "expert"},
    }
    pair = known["holders"]["Case"]
    own |= {
        "Case.logs": {"repetitions": 2},
        "Case.problem_of": {"log": pair.log(20, seed=0)},
        "Case.relabelled": {
            "states": np.arange(pair.simulator.n_states),
            "actions": np.arange(pair.simulator.n_actions),
        },
        "Case.with_rewards": {"scale": 2.0, "shift": 1.0},
        "Verdicts.__getitem__": {"operand": "limit"},
    }
    names = known["holders"]["League"].table["estimator"].unique()
    own["League.with_labels"] = {"labels": {str(names[0]): "ours"}}
    cells = known["holders"]["Discretization"]
    counts = cells.counts(moves)
    own |= {
        "Discretization.counts": {"log": moves},
        "Discretization.encode": {"log": moves},
        "Discretization.encode_states": {"states": moves.state},
        "Discretization.fit_weights": {"counts": cells.supported(counts)[0]},
        "ContinuousSimulator.record": {
            "policy": first_action,
            "n_transitions": 20,
        },
        "Discretization.supported": {"counts": counts},
        "Discretization.mixture": {"weights": [1.0]},
        "Discretization.policy": {"policy": driver},
        "Discretization.policy_function": {"table": np.full((9, 2), 0.5)},
        "Discretization.with_transitions": {
            "transitions": cells.mdp.transitions,
            "rewards": None,
        },
    }
    return files | plots_values(known) | task_values(known) | arm_values() | own


def task_values(known):
    """Arguments of what makes and records continuous tasks."""
    cartpole = known["task"]
    driver = oee.tasks.cartpole_policy(0.5)
    ends = [2.4, 3.0, 0.21, 3.2]
    return {
        "train_expert": {
            "iterations": 1,
            "population": 2,
            "elite": 1,
            "episodes": 1,
            "horizon": 3,
        },
        "reacher_log": {"task": oee.tasks.Reacher(), "n": 20, "max_steps": 10},
        "discretize": {"log": None, "cells": (3, 3), "closure_episodes": 0},
        "visited_states": {
            "tasks": [cartpole],
            "policies": [driver],
            "n": 5,
            "max_steps": 3,
        },
        "fit_parameters": {
            "task_of": oee.tasks.CartPole,
            "start": {"gravity": 10.0},
            "log": known["continuous_log"],
        },
        "gymnasium_simulator": {"spec": "Pendulum-v1"},
        "make_environment": {"identifier": "FrozenLake-v1"},
        "corrected_value": {
            "corrected": oee.tasks.ResidualSimulator(cartpole, known["continuous_log"]),
            "policy": driver,
            "n_episodes": 20,
            "horizon": 5,
            "refits": 2,
            "paths": 5,
        },
        "GymnasiumTask": {
            "make": make_cartpole,
            "state_names": ("x", "x_dot", "theta", "theta_dot"),
            "actions": [0, 1],
            "low": [-end for end in ends],
            "high": ends,
            "get_state": get_state,
            "set_state": set_state,
        },
        "GridInterpolation": {"shape": (3, 3)},
        "VisitedCells": {"n_cells": 5},
        "padded_log": {"actions": [0]},
    }


def arm_values():
    """Arguments of what moves the arm; none without MuJoCo."""
    if importlib.util.find_spec("mujoco") is None:
        return {}
    arm = oee.tasks.KinovaArm(0)
    hand = oee.tasks.fit_hand(arm, n_states=20)
    goals = oee.tasks.record_goals(arm, n_runs=1, horizon=3, seed=0)
    goals.save(path := Path(tempfile.mkdtemp()) / "arm.npz")
    return {
        "fit_hand": {"arm": arm, "n_states": 20},
        "record_goals": {"arm": arm, "n_runs": 1, "horizon": 3},
        "hand_log": {"log": goals},
        "load_kinova_log": {"path": path},
        "KinovaHand": {
            name: getattr(hand, name)
            for name in ("coefficients", "scatter", "starts", "source")
        },
    }


def make_cartpole():
    return oee.tasks.make_environment("CartPole-v1")


def first_action(states):
    """The first of 9 actions, whatever the states are."""
    return np.eye(9)[np.zeros(len(states), dtype=int)]


def get_state(env):
    return env.unwrapped.state


def set_state(env, state):
    env.unwrapped.state = np.array(state)
    env.unwrapped.steps_beyond_terminated = None


def plots_values(known):
    """Arguments of what draws, on axes that nobody shows."""
    row = {
        "policy": "p",
        "estimator": "oee",
        "value": 1.0,
        "lower": 0.5,
        "upper": 1.5,
        "true_value": 1.1,
    }
    cells = {"shape": (1, 2), "over": [0, 1]}
    curve = {"a": [1.0, 2.0]}
    size = {"size": (2.0, 2.0)}
    own = {
        "plot_values": {"records": [row]},
        "plot_states": {"time": [0.2, 0.8], "recorded": [3, 4]},
        "plot_intervals": {
            "names": ["a", "b"],
            "values": [1.0, 2.0],
            "lower": [0.0, 1.0],
            "upper": [2.0, 3.0],
        },
        "plot_curves": {"x": [0.0, 1.0], "curves": curve},
        "plot_errors": {"n": [1.0, 2.0], "errors": curve},
        "plot_variance_growth": {"variances": curve},
        "plot_grid": cells | {"values": [1.0, 2.0], "label": "value"},
        "plot_ratio": cells | {"values": [1.0, 2.0]},
        "plot_coverage": cells | {"counts": [3, 0]},
        "plot_occupancy": cells | {"time": [0.2, 0.8]},
        "plot_policy": {"mdp": known["target"], "policy": known["policies"]["expert"]},
        "plot_paths": {"mdp": known["target"], "paths": [0, 1, 2]},
        "schematic": {},
        "label_ends": {},
        "Report.plot": {},
        "Interval.plot": {},
        "Plan.plot": {},
        "Comparison.plot": {},
    }
    axes = Figure().subplots()
    own_map = {
        "Map.of_shape": {"rows": 2, "columns": 3},
        "Map.spread": {"values": np.ones(9)},
        "Map.place": {"state": 0},
    }
    folder = Path(tempfile.gettempdir())
    own_map["animate_two"] = {
        "simulator": known["simulator"],
        "target": known["target"],
        "policy": known["policies"]["expert"],
        "path": folder / "new.gif",
        "horizon": 2,
    }
    drawn = {
        "save_figure": size | {"path": folder / "new.png"},
        "figure_png": size,
        "figure_svg": size | {"title": "t", "description": "d"},
    }
    return (
        own_map
        | {name: values | {"ax": axes} for name, values in own.items()}
        | {name: values | {"draw": len_of_lines} for name, values in drawn.items()}
    )


def len_of_lines(ax):
    """Draw nothing."""
    return len(ax.get_lines())


def malformed(change):
    """A csr of 36 x 9 that lies about itself: native code would read beyond its arrays."""
    matrix = sparse.csr_array(np.eye(9)[np.arange(36) % 9])
    if change == "object":
        matrix.data = np.array(["x"] * 36, dtype=object)
        return matrix
    part, index, value = change
    array = getattr(matrix, part).copy()
    if index is None:  # another length or another type
        array = value(array)
    else:
        array[index] = value
    setattr(matrix, part, array)
    return matrix


MALFORMED = (
    "object",
    ("indptr", 5, 10**6),
    ("indptr", -1, 2**31 - 1),
    ("indptr", 3, -7),
    ("indptr", 0, 4),
    ("indices", 7, 10**9),
    ("indices", 7, -(10**9)),
    ("indices", 0, 9),
    ("data", 3, np.nan),
    ("indptr", None, lambda a: a[:-5]),
    ("indices", None, lambda a: a[:4]),
    ("data", None, lambda a: a[:4]),
    ("indices", None, lambda a: a + 0.5),
    ("indptr", None, lambda a: a.astype(float)),
    ("data", None, lambda a: a.astype(complex)),
    ("indices", None, lambda a: a.astype(object)),
    ("data", None, lambda a: a[:, None]),
)


def nested(depth):
    """A list in a list in a list ..."""
    value = [0]
    for _ in range(depth):
        value = [value]
    return value


PROTOCOL = (
    "__array__",
    "__len__",
    "__iter__",
    "__eq__",
    "__bool__",
    "__hash__",
    "__float__",
    "__index__",
    "__int__",
    "__getitem__",
    "__contains__",
    "__fspath__",
    "__getattr__",
    "__lt__",
    "__format__",
)


@functools.cache
def others():
    """Results of another problem: of other sizes, with names, or without rewards."""
    pair = oee.testing.case("ragged")
    problem = pair.problem(40, seed=0)
    named = pair.simulator.with_names(
        state_names=[f"s{k}" for k in range(pair.simulator.n_states)]
    )
    policies = {"a": pair.policy, "b": pair.behavior}
    return (
        pair,
        problem,
        problem.log,
        problem.counts,
        pair.policy,
        named,
        oee.transition_ratio(problem.log, pair.simulator),
        oee.interval(problem, pair.policy),
        oee.return_moments(pair.target, pair.policy, horizon=5, sources=True),
        oee.inference.compare_policies(problem, policies, n_draws=20),
        oee.evaluate(problem, policies, quick=True),
        oee.plan_data_collection(problem, pair.policy, n=5),
        oee.sample_returns(pair.target, pair.policy, 3, 5, seed=0),
        oee.Estimate(float("nan"), status="no"),
        oee.Estimate(np.inf, 0.0, (-np.inf, np.inf), {"x": [1]}),
        [oee.Estimate(1.0)] * 2,
        {"a": oee.Estimate(1.0)},
        oee.tasks.CartPole(),
        oee.tasks.Reacher(),
        oee.estimators.Diagnostics(coverage=0.5, colour="x"),
    )


@functools.cache
def general():
    """Hostile values for any argument."""
    deep = nested(3000)
    table = pd.DataFrame({"state": [0, 1], "action": [1, 0]})
    return (
        None,
        "",
        "raw",
        "1",
        b"x",
        float("nan"),
        float("inf"),
        -float("inf"),
        -1,
        0,
        1,
        2,
        0.5,
        1.5,
        -0.0,
        2**31,
        2**53 + 1,
        2**63,
        2**70,
        10**9,
        10**12,
        10**400,
        10**5000,
        1e308,
        -1e308,
        1e-320,
        1e17,
        1j,
        True,
        False,
        np.bool_(True),
        object(),
        Raises(),
        Raises,
        [],
        [[]],
        [[], [1]],
        (),
        {},
        {"a": None},
        {"a": 1},
        set(),
        [None],
        ["a"],
        [1, [2, 3]],
        [np.nan],
        [1.5],
        [object()],
        range(3),
        slice(None),
        Fresh(lambda: iter([1])),
        Fresh(endless),
        Fresh(circle),
        Fresh(circle_of_dicts),
        Fresh(array_with_itself),
        Fresh(lambda: (k for k in range(9))),
        Fresh(lambda: map(str, range(9))),
        Fresh(lambda: {0: 1}.items()),
        *(spiteful(name) for name in PROTOCOL),
        spiteful("__repr__", "__str__", "__format__", error=SpiteOfText),
        spiteful("__repr__", "__str__", kind=float, error=SpiteOfText),
        spiteful("__iter__", "keys", "items", kind=dict),
        spiteful("__eq__", "__bool__", shape=(9, 4), dtype=np.dtype(float)),
        [spiteful("__repr__", "__str__", "__format__", error=SpiteOfText)] * 9,
        {"a": spiteful("__repr__", "__str__", "__format__", error=SpiteOfText)},
        Quantity(np.ones(9), "m"),
        Quantity(0.5, "s"),
        Quantity(np.full((9, 4), 0.25), "kg"),
        np.ma.masked_array(np.full((9, 4), 0.25), mask=np.eye(9, 4, dtype=bool)),
        np.ma.masked_array(np.arange(9), mask=np.arange(9) == 3),
        np.ma.masked_array(["a", "b"], mask=[True, False]),
        np.matrix(np.full((9, 4), 0.25)),
        np.matrix([0]),
        np.zeros(9).view(np.recarray),
        np.rec.array([(1, 2.0)], dtype=[("state", int), ("action", float)]),
        np.array("x"),
        np.array(None),
        np.array(True),
        np.array({"a": 1}),
        np.zeros((9, 4), dtype=np.float16),
        np.full((9, 4), 0.25, dtype=np.longdouble),
        np.full((4, 9), 0.25).T,
        np.zeros((9, 0)),
        np.zeros((0, 4)),
        np.array([b"a", b"b"]),
        np.array([Decimal("0.5")] * 9),
        np.array([Fraction(1, 2)] * 9),
        np.array(["1e999", "nan"]),
        np.intp(-1),
        np.int64(-(2**63)),
        np.float32("nan"),
        np.str_(""),
        np.datetime64("2020-01-01"),
        np.dtype(float),
        np.float64,
        Decimal("1e9999"),
        Decimal("sNaN"),
        Fraction(10**400, 3),
        complex("nan"),
        "\ud800",
        ["\ud800", "b"],
        {"\ud800": 1.0},
        "\u202egnp.exe",
        "\x00",
        "\n" * 300,
        "a\nb",
        "{}",
        "{0}%s",
        " ",
        "None",
        "NaN",
        "é",
        "$\\frac{",
        "<script>alert(1)</script>",
        bytearray(b"ab"),
        frozenset([1]),
        {None: None},
        {1: 2, "1": 3},
        {(0, 1): 0.5},
        {0: 1.0, 1: {2: 0.5}},
        {np.nan: 1},
        {b"a": 1},
        {True: False},
        types.MappingProxyType({"a": 1.0}),
        types.SimpleNamespace(n_states=9, n_actions=4),
        collections.OrderedDict(a=1),
        collections.Counter("abc"),
        collections.deque([1, 2]),
        collections.namedtuple("Pair", "a b")(1, 2),
        array.array("d", [0.5]),
        datetime.date(2020, 1, 1),
        datetime.timedelta(1),
        uuid.UUID(int=1),
        io.BytesIO(b"x"),
        io.StringIO("state,action,next_state"),
        re.compile("x"),
        enum.Enum("Colour", "red"),
        Path("."),
        Path("/dev/null"),
        Path("/"),
        Path("x" * 300 + ".csv"),
        pathlib.PurePosixPath("a/b.npz"),
        object,
        type,
        np.ndarray,
        dict,
        oee.FiniteMDP,
        oee.Transitions,
        oee.Estimate,
        oee.Report,
        oee.tasks.CartPole,
        oee.estimators.ModelBased,
        oee.exceptions.ArgumentError("x", "y"),
        oee.exceptions.ArgumentError,
        pd.Series([0.25] * 9, index=range(9, 0, -1)),
        pd.Series([1, 2], dtype="Int64"),
        pd.Series([1, None], dtype="Int64"),
        pd.Series(["a", "b"], dtype="category"),
        pd.Series([Decimal(1)]),
        pd.Series([1.0, 2.0], dtype="Sparse[float]"),
        pd.Index([1, 2]),
        pd.Timestamp("2020"),
        pd.Categorical(["a", "b"]),
        pd.DataFrame({0: [1], "0": [2]}),
        pd.DataFrame(np.full((9, 4), 0.25), index=list("ihgfedcba")),
        sparse.csr_array(np.full((9, 4), 0.25)),
        sparse.csr_array(np.eye(36, 9), dtype=np.float32),
        sparse.lil_array((36, 9)),
        sparse.bsr_array(np.ones((36, 9))),
        sparse.csr_matrix(np.eye(36, 9)),
        sparse.csr_array(np.ones((36, 9), dtype=np.int8)),
        *others(),
        len,
        int,
        np.array(1.0),
        np.array(np.nan),
        np.array([]),
        np.array([1, 2]),
        np.array(["a", "b"]),
        np.array([None, 1], dtype=object),
        np.array(["2020-01-01"], dtype="datetime64[D]"),
        np.zeros((2, 2, 2, 2)),
        np.zeros((9, 4)),
        np.full((9, 4), np.nan),
        np.full((9, 4), 1e308),
        np.ones((9, 4)) / 4,
        np.ones((9, 4), dtype=complex),
        np.eye(9),
        np.ones(9),
        np.zeros(9, dtype=bool),
        np.float32(0.5),
        np.int8(3),
        sparse.csr_array((36, 9)),
        sparse.csr_array(np.full((36, 9), np.nan)),
        sparse.csr_array(np.full((36, 9), 1e300)),
        sparse.csr_array(np.full((36, 9), -1.0)),
        sparse.eye_array(9, format="coo"),
        oee.tasks.gridworld(2, 0.1),
        oee.tasks.recycling_robot(),
        oee.tasks.gridworld(SIZE, 0.0),
        oee.Transitions([0], [0], [1]),
        oee.Estimate(1.0),
        Path("nowhere"),
        "nowhere.npz",
        deep,
        {"a": deep},
        [deep] * 9,
        {0: deep},
        list(range(10**6)),
        ["x" * 10**6] * 9,
        dict.fromkeys(range(10**5), "x"),
        "\x1b[31mX\x07",
        ["\x1b[2J\r"] * 9,
        "x" * 10**6,
        "no\x00where.csv",
        "s3://bucket/log.parquet",
        "x" * 5000 + ".npz",
        "..",
        "*.csv",
        b"\xff\xfe.npz",
        np.array([[1, 2], [3]], dtype=object),
        np.full((9, 4), None),
        np.full(9, "a", dtype=object),
        np.array([deep, 1], dtype=object),
        pd.Series([0.5, 0.5], index=[7, 7]),
        pd.Series([1] * 9, index=list("abcdefghi")),
        pd.Series([1, None]),
        pd.Series(["a", pd.NA]),
        pd.Series([0] * 9, index=pd.MultiIndex.from_product([[0, 1, 2], list("abc")])),
        table,
        table.T,
        pd.DataFrame([[1, 2]], columns=["state"] * 2),
        pd.DataFrame(),
        pd.NA,
        pd.NaT,
        Decimal("NaN"),
        Decimal(1),
        Fraction(1, 2),
        np.float16(0.5),
        np.longdouble(0.5),
        np.str_("\x1b"),
        np.bytes_(b"x"),
        np.datetime64("NaT"),
        np.timedelta64(3, "s"),
        np.void(b"ab"),
        np.complex64(1j),
        np.uint64(2**64 - 1),
        memoryview(b"ab"),
        np.ma.masked_array([1.0, 2.0], mask=[True, False]),
        np.ma.masked,
        np.zeros(9, dtype=[("a", "i4"), ("b", "f8")]),
        np.zeros((0, 0)),
        np.broadcast_to(0.25, (9, 4)),
        np.zeros(10**6),
        np.full(10**6, "abc"),
        np.array([2**64 - 1], dtype=np.uint64),
        np.zeros((1,) * 32),
        sparse.csc_array(np.ones((4, 4))),
        sparse.csr_array((0, 0)),
        sparse.coo_array(np.ones(9)),
        sparse.csr_matrix((36, 9), dtype=bool),
        sparse.csr_array(np.ones((36, 9), dtype=complex)),
        sparse.dok_array((9, 9)),
        np.random.default_rng(0),
        np.random.SeedSequence(3),
        np.random,
        oee,
        Exception("x"),
        NotImplemented,
        Ellipsis,
        lambda *_, **__: deep,
        lambda *_: "\x1b[31m",
        lambda: None,
        *(malformed(change) for change in MALFORMED),
    )


def hostile(rng, valid):
    """One hostile value: of a general kind, or the valid one spoilt."""
    if rng.random() < 0.75:
        value = general()[rng.integers(len(general()))]
        return value.make() if isinstance(value, Fresh) else value
    return spoilt(rng, valid)


def spoilt(rng, valid):
    """A valid value with one thing wrong: an entry, the shape, or the kind of numbers."""
    if sparse.issparse(valid):
        if rng.random() < 0.3:
            return malformed(MALFORMED[rng.integers(len(MALFORMED))])
        spoiled = sparse.csr_array(valid).astype(float)
        spoiled.data[rng.integers(spoiled.nnz)] = rng.choice(
            [np.nan, np.inf, -1.0, 1e300, 1e-310, 0.0]
        )
        return spoiled if rng.random() < 0.7 else spoiled[:-1]
    with contextlib.suppress(ValueError):  # a ragged list has no shape
        if not isinstance(valid, bool | str | None.__class__ | dict) and np.shape(
            valid
        ):
            return spoilt_array(rng, np.array(valid))
    return [valid]


def spoilt_array(rng, array):
    """An array with one entry, its shape or its type changed."""
    if array.dtype.kind not in "fiub" or array.size == 0:
        return array
    change = rng.integers(6)
    if change == 0:
        array = array.astype(float)
        array.flat[rng.integers(array.size)] = rng.choice(
            [np.nan, np.inf, -1.0, 1e308, 1e-320]
        )
        return array
    with np.errstate(over="ignore"):
        larger = array.astype(float) * 1e308
        return (
            array[:-1],
            array.astype(str),
            array[None],
            array.astype(object),
            larger,
        )[change - 1]

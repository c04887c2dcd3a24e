"""What tests/fuzz_calls.py gives: a valid value for each argument, by its name, and hostile ones."""

import tempfile
from pathlib import Path

import numpy as np
from scipy import sparse

import oee_tabular as oee

SIZE, T = 3, 3


class Raises:
    """Everything that is asked of it fails, but with no error of ours."""

    n_states, n_actions, terminal_state = 9, 4, ()

    def __call__(self, *_, **__):
        return "no"


def valid_values():
    """A value for every argument that has one name in all functions."""
    simulator, target = (oee.tasks.gridworld(SIZE, slip=slip) for slip in (0.3, 0.1))
    uniform, expert = oee.uniform_policy(target), oee.tasks.gridworld_expert(SIZE)
    log = oee.sample_episodes(target, uniform, 20, 20, seed=0)
    zeta = oee.true_ratio(target, simulator)
    even = np.full((9, 4), 1 / 36)
    g, p, q = np.array([1.0, 0.8, 1.3]), np.array([0.3, 0.4, 0.3]), np.array([0.4, 0.3, 0.3])
    problem = oee.Problem(simulator, log, horizon=20)
    cartpole = oee.tasks.CartPole()
    moves = oee.tasks.record(cartpole, oee.tasks.cartpole_policy(0.5), n_transitions=60, max_steps=30, seed=0)
    return {
        "mdp": target, "simulator": simulator, "target": target, "model": simulator, "models": target, "values_of": None,
        "policy": uniform, "behavior_policy": uniform, "policy_a": uniform, "policy_b": expert, "weight_of_a": 0.5,
        "policies": {"uniform": uniform, "expert": expert}, "zeta": zeta, "ratio": None, "horizon": T, "seed": 0,
        "distribution": even, "data_distribution": even, "simulator_distribution": even, "n": 50, "n_episodes": 5,
        "moves": target.transitions, "log": log, "log_or_counts": log, "problem": problem, "episodes": None,
        "p": p, "q": q, "g": g, "x_p": np.arange(10.0)[:, None], "x_q": np.arange(8.0)[:, None], "k": 1,
        "pairs": g, "true_moves": g, "true_pairs": g, "mu": 2.0, "nu": 0.5, "error": 0.1, "eta": 0.1, "order": 2.0,
        "reward_bound": 1.0, "discount": 0.9, "confidence": 0.95, "renyi": 2.0, "constant": 1.0, "p_min": 0.1, "q_min": 0.1,
        "n_cells": 5, "lower": 0.5, "upper": 2.0, "lower_ratio": None, "upper_ratio": None, "delta": 0.5, "goal": 0,
        "estimates": g, "truths": p, "epsilon": 0.1, "size": SIZE, "slip": 0.1, "identifier": "FrozenLake-v1",
        "spec": "gridworld:3,slip=0.3", "state": [0, 1], "action": [1, 0], "next_state": [1, 2], "reward": [0.0, 1.0],
        "count": [3, 1],
        "transitions": target.transitions, "rewards": np.zeros((9, 4)), "initial": target.initial, "name": "ragged",
        "kernel": target.transitions[::4], "b": target.initial, "path_divergence": np.array([0.0, 0.1, 0.2]),
        "estimate": oee.Estimate(1.0, 0.1), "discretised": 1.0, "continuous": 1.2, "new": simulator.transitions,
        "n_states": 9, "n_actions": 4, "rows": [0, 1], "gradient": np.ones(target.transitions.nnz), "logs": [log, log],
        "env": oee.tasks.make_environment("FrozenLake-v1"), "coordinates": np.arange(9.0), "layout": np.arange(9.0),
        "bandwidth": 1.0, "estimator": oee.estimators.ModelBased(), "pair": (simulator, target), "solver": "dual",
        "task": cartpole, "max_steps": 20, "length": 0.1, "gravity": 10.0, "states": np.arange(9), "actions": (0, 1, 2, 3),
        "probability": 0.5, "folder": Path(tempfile.gettempdir()) / "none", "per_row": 1.0, "continuous_log": moves,
    }  # fmt: skip


def own_values(known):
    """Arguments whose meaning differs from that of the same name elsewhere: function name -> values."""
    moves = known["continuous_log"]
    driver = oee.tasks.cartpole_policy(0.5)
    paid = [oee.tasks.gridworld(SIZE, slip, pay="current") for slip in (0.1, 0.3)]  # rewards r(s, a)
    return {
        "reweight": {"ratio": known["zeta"]},
        "check_policy": {"name": "policy", "horizon": None},
        "plan_data_collection": {"horizon": None, "n": 20, "solver": "auto"},
        "evaluate": {"target": None, "estimators": ["oee", "model-based"]},
        "transition_ratio": {
            "horizon": None,
            "discount": None,
            "coordinates": None,
            "bandwidth": None,
            "lower": None,
            "upper": None,
            "kernel": None,
            "behavior_policy": None,
        },
        "InClass": {
            "features": np.arange(known["simulator"].transitions.nnz) % 3.0,
            "kernel": None,
            "coordinates": None,
        },
        "Tied": {"tie": np.arange(known["simulator"].transitions.nnz) % 3},
        "density_ratio": {"kernel": None, "coordinates": None},
        "density_ratio_samples": {"kernel": None},
        "interval": {"n_bootstrap": 20},
        "compare_policies": {"n_draws": 100, "n_bootstrap": 20},
        "ContinuousTransitions": {
            "state": moves.state[:2],
            "action": moves.action[:2],
            "next_state": moves.next_state[:2],
        },
        "ResidualSimulator": {"log": moves},
        "LinearModel": {"log": moves},
        "record": {"policy": driver, "n_episodes": None, "n_transitions": 20},
        "monte_carlo_value": {"policy": driver},
        "resimulate": {"log": moves},
        "record_episodes": {"n_transitions": 20, "n_episodes": None, "policy": np.full((16, 4), 0.25)},
        "DualDice.__call__": {"problem": oee.Problem(known["simulator"], known["log"])},
        "Problem": {"behavior_policy": None, "rewards": "simulator"},
        "Magic": {"ratio": "conditional"},
        "Marginalized": {"ratio": "conditional", "lower": None, "upper": None},
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
        "universal_constant_counterexample": {"n": 1000, "mu": 10.0, "nu": 0.1},
        "estimation_sides": {"n": 1000},
        "Reacher": {"target": (0.1, 0.1)},
        "value_error_sides": {"target": paid[0], "model": paid[1]},
        "value_bound_counterexample": {"nu": 0.9, "epsilon": 0.01},
        "Transitions": {"episode": None, "action": known["action"], "next_state": known["next_state"]},
        "KinovaArm": {"goal": 0},
        "kinova_policy": {"delta": 0.0},
    }


def hostile(rng, valid):
    """One hostile value: of a general kind, or the valid one spoilt."""
    general = (
        None, "", "raw", "1", b"x", float("nan"), float("inf"), -float("inf"), -1, 0, 1, 2, 0.5, 1.5, -0.0, 2**31, 2**53 + 1,
        2**63, 2**70, 10**9, 10**12, 10**400, 1e308, -1e308, 1e-320, 1e17, 1j, True, False, np.bool_(True), object(), Raises(),
        Raises, [], [[]], [[], [1]], (), {}, {"a": None}, {"a": 1}, set(), [None], ["a"], [1, [2, 3]], [np.nan], [1.5],
        [object()], range(3), slice(None), iter([1]), len, int, np.array(1.0), np.array(np.nan), np.array([]), np.array([1, 2]),
        np.array(["a", "b"]), np.array([None, 1], dtype=object), np.array(["2020-01-01"], dtype="datetime64[D]"),
        np.zeros((2, 2, 2, 2)), np.zeros((9, 4)), np.full((9, 4), np.nan), np.full((9, 4), 1e308), np.ones((9, 4)) / 4,
        np.ones((9, 4), dtype=complex), np.eye(9), np.ones(9), np.zeros(9, dtype=bool), np.float32(0.5), np.int8(3),
        sparse.csr_array((36, 9)), sparse.csr_array(np.full((36, 9), np.nan)), sparse.csr_array(np.full((36, 9), 1e300)),
        sparse.csr_array(np.full((36, 9), -1.0)), sparse.eye_array(9, format="coo"), oee.tasks.gridworld(2, 0.1),
        oee.tasks.gridworld(SIZE, 0.0), oee.Transitions([0], [0], [1]), oee.Estimate(1.0), Path("nowhere"), "nowhere.npz",
    )  # fmt: skip
    if rng.random() < 0.7:
        return general[rng.integers(len(general))]
    return spoilt(rng, valid)


def spoilt(rng, valid):
    """A valid value with one thing wrong: an entry, the shape, or the kind of numbers."""
    if sparse.issparse(valid):
        spoiled = sparse.csr_array(valid).astype(float)
        spoiled.data[rng.integers(spoiled.nnz)] = rng.choice([np.nan, np.inf, -1.0, 1e300, 1e-310, 0.0])
        return spoiled if rng.random() < 0.7 else spoiled[:-1]
    if isinstance(valid, bool | str | None.__class__ | dict) or not np.shape(valid):
        return [valid]
    array = np.array(valid)
    if array.dtype.kind not in "fiub" or array.size == 0:
        return array
    change = rng.integers(6)
    if change == 0:
        array = array.astype(float)
        array.flat[rng.integers(array.size)] = rng.choice([np.nan, np.inf, -1.0, 1e308, 1e-320])
        return array
    with np.errstate(over="ignore"):
        return (array[:-1], array.astype(str), array[None], array.astype(object), array.astype(float) * 1e308)[
            change - 1
        ]

"""Experiment table1: the robot arm of the paper's Table I, as a simulated stand-in.

No data of the robot was ever published. A cell records runs to the five goals in the
perturbed arm, 10 to each, fits zeta tied over displacements to them, and values the
controller by every estimator. Values are mean discounted costs over the goals, in m.
"""

from __future__ import annotations

import copy
import functools
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from scipy import sparse

from oee_tabular.continuous import (
    ContinuousTransitions,
    Discretization,
    ResidualSimulator,
    discretize,
    kinova,
    monte_carlo_value,
)
from oee_tabular.exact import policy_value
from oee_tabular.lab.experiment import (
    Cell,
    Row,
    Stream,
    experiment,
    panels,
    percent,
    reach,
)
from oee_tabular.lab.experiments.common import frequencies, published_table
from oee_tabular.mdp import FiniteMDP
from oee_tabular.ratio import TransitionRatio
from oee_tabular.shrinkage import transition_ratio
from oee_tabular.simulate import sample_episodes
from oee_tabular.typing import Array

TARGETS: dict[str, dict[str, float]] = {
    "velocity x 1.4": {"velocity_scale": 1.4},
    "everything": {
        "velocity_scale": 1.2,
        "latency": 0.05,
        "payload": 1.0,
        "friction": 2.0,
        "gain": 0.4,
        "encoder_noise": 2e-3,
    },
}
POLICIES = (0.0, 0.3)  # delta: the controller itself, and with 30 % of random commands
N_RUNS = 10  # recorded runs to each goal
N_VALUE_RUNS = 50  # runs to each goal of a Monte Carlo value
RUNS = (len(kinova.GOALS), N_RUNS, kinova.HORIZON)  # the shape of a log
DISCOUNTS = 0.99 ** np.arange(kinova.HORIZON)
EPSILON = 0.1  # floor of the defensive simulator, as of ``discretize``
STRENGTH = 3.0  # of the ties, in transitions for each command
TRUE = "true value, 50 runs"
OEE = "OEE, tied, exact"
SIMULATOR = "simulator, 50 runs"
RESIDUAL = "residual, 250 runs"
PUBLISHED = {TRUE: "true_value", OEE: "oee", SIMULATOR: "simulator"}
REFERENCE = "velocity x 1.4"
UNIT = "mean discounted cost over 5 goals (m), T = 25"
PUBLISHED_SD = {TRUE: 0.016, OEE: 0.101, SIMULATOR: 0.170}


def arm_of(target: str) -> kinova.KinovaArm:
    """Return the simulated arm ("simulator"), or a perturbed one; never a real one."""
    changes: dict[str, Any] = {}
    if target != "simulator":
        changes = dict(TARGETS[target])
    return kinova.KinovaArm(**changes)


@functools.cache
def simulators() -> tuple[Discretization, Discretization]:
    """Return the simulator on the grid of the hand's position, and its mixture."""
    defensive = discretize(
        kinova.fit_hand(arm_of("simulator")), floor=EPSILON, closure_episodes=0
    )
    return replace(defensive, mdp=defensive.plain), defensive


@functools.cache
def controller(goal: int) -> tuple[Array, Array]:
    """Return the controller to a goal (S, 27) and its rewards (S,), on the grid."""
    plain = simulators()[0]
    costs = kinova.ideal_hand().towards(goal).costs(plain.points)
    return plain.policy(kinova.kinova_policy(goal)), plain.places.mean(costs)


@functools.cache
def grid_values(target: str) -> dict[str, dict[float, Array]]:
    """Compute the values of the goals on the grid, as name -> delta -> values.

    They are those of the simulators and of the target itself (the oracle).
    """
    plain, defensive = simulators()
    own = discretize(kinova.fit_hand(arm_of(target)), cells=plain, closure_episodes=0)
    models = {
        "simulator on the grid": plain,
        "defensive simulator on the grid": defensive,
        "oracle on the grid": own,
    }
    return {name: goal_values(model.mdp) for name, model in models.items()}


def simulate_values(task: Any, delta: float) -> Array:
    """Simulate the values of the goals (5,), with 50 runs each.

    The task is an arm or a corrected one.
    """
    goals = range(len(kinova.GOALS))
    horizon = kinova.HORIZON
    policies = [kinova.kinova_policy(g, delta) for g in goals]
    found = [
        monte_carlo_value(
            towards(task, g), policies[g], N_VALUE_RUNS, horizon, seed=[9, g]
        )
        for g in goals
    ]
    return np.array([each.value for each in found])


@functools.cache
def known_values(target: str, delta: float) -> Array:
    """Simulate the values of the goals (5,) in an arm, once a process."""
    return simulate_values(arm_of(target), delta)


def towards(task: Any, goal: int) -> Any:
    """Return the arm, or the corrected one, with another goal; its step is the same."""
    if not isinstance(task, ResidualSimulator):
        return task.towards(goal)
    again = copy.copy(task)
    again.task = towards(task.task, goal)
    return again


def goal_values(mdp: FiniteMDP) -> dict[float, Array]:
    """Compute the exact values (5,) of the policies to each goal in ``mdp``, by delta.

    They are on the grid.
    """
    found: dict[float, list[float]] = {delta: [] for delta in POLICIES}
    for g in range(len(kinova.GOALS)):
        policy, cost = controller(g)
        paid = mdp.with_rewards(cost)
        for delta, values in found.items():
            values.append(
                policy_value(
                    paid,
                    delta / policy.shape[1] + (1.0 - delta) * policy,
                    horizon=kinova.HORIZON,
                )
            )
    return {delta: np.array(values) for delta, values in found.items()}


def run_values(log: ContinuousTransitions) -> Array:
    """Compute the mean discounted cost (5,) of the runs to each goal."""
    reward = np.reshape(log.reward, RUNS)  # type: ignore[arg-type]
    return np.asarray((reward @ DISCOUNTS).mean(axis=1))


def importance_sampling(log: ContinuousTransitions, delta: float) -> Array:
    """Estimate (5,) by per-decision importance sampling from the runs themselves.

    The reward r_t depends on the state alone.
    """
    goal = np.repeat(np.arange(len(kinova.GOALS)), len(log) // len(kinova.GOALS))
    chosen = np.empty(len(log))
    for g in range(len(kinova.GOALS)):
        rows = np.flatnonzero(goal == g)
        chosen[rows] = kinova.kinova_policy(g, delta)(log.state[rows])[
            np.arange(len(rows)), log.action[rows]
        ]
    ratio = chosen / log.behavior_probability  # type: ignore[operator]
    weight = weights_before(np.reshape(ratio, RUNS))
    reward = np.reshape(log.reward, RUNS)  # type: ignore[arg-type]
    return np.asarray((weight * reward @ DISCOUNTS).mean(axis=1))


def weights_before(ratios: Array) -> Array:
    """Compute the product of the ratios of earlier steps, at each step."""
    return np.concatenate(
        [np.ones_like(ratios[..., :1]), np.cumprod(ratios, axis=-1)[..., :-1]], axis=-1
    )


def product_values(
    model: Discretization, zeta: TransitionRatio, delta: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Estimate by the paper's product of ratios over 10 simulated runs to each goal.

    The two results (5,) are plain and self-normalised.
    """
    plain = []
    normalized = []
    for g in range(len(kinova.GOALS)):
        policy, costs = controller(g)
        policy = delta / policy.shape[1] + (1.0 - delta) * policy
        runs = sample_episodes(model.mdp, policy, N_RUNS, kinova.HORIZON, seed=rng)
        rows = runs.state * policy.shape[1] + runs.action
        weight = weights_before(
            np.reshape(zeta.values[rows, runs.next_state], RUNS[1:])
        )
        paid = weight * np.reshape(costs[runs.state], RUNS[1:])
        plain.append(paid.mean(axis=0) @ DISCOUNTS)
        normalized.append((paid.sum(axis=0) / weight.sum(axis=0)) @ DISCOUNTS)
    return np.array(plain), np.array(normalized)


ORDER = (
    TRUE,
    OEE,
    SIMULATOR,
    RESIDUAL,
    "OEE, tied, exact, calibrated",
    "OEE, tied, 50 simulated runs",
    "OEE, tied, 50 simulated runs, self-normalised",
    "OEE, tied, exact, plain simulator",
    "OEE, not tied",
    "model-based",
    "PDIS",
    "oracle on the grid",
    "simulator on the grid",
    "defensive simulator on the grid",
    "true value, 250 runs",
    "simulator, 250 runs",
)


def published_value(row: Row) -> float:
    """Return the number of Table I beside the controller's rows.

    It is that of the robot, not of the stand-in, and stands beside the reference
    mismatch.
    """
    is_reference = row["policy"] == 0.0 and row["target"] == REFERENCE
    if is_reference and row["estimator"] in PUBLISHED:
        return paper_value(row["estimator"])
    return np.nan


def draw(table: pd.DataFrame, summary: pd.DataFrame, figure: Any) -> None:
    """Draw mean and standard deviation over the seeds of every estimator.

    They are of the controller, beside Table I of the paper.
    """
    from oee_tabular.plots import plot_intervals

    part = summary[summary.policy == 0.0]
    cases: list[Any] = list(part.groupby(["target", "data"], sort=False).groups)
    names = [f"stand-in, {target}; data: delta = {data:g}" for target, data in cases]
    axes = panels(
        figure,
        [*names, "the paper's Table I (the real arm)"],
        columns=2,
        size=(6.4, 4.6),
    )
    for ax, (target, data) in zip(axes, cases, strict=False):
        shown = part[(part.target == target) & (part.data == data)].set_index(
            "estimator"
        )
        mean = shown["value_mean"]
        sd = shown["value_sd"].fillna(0.0)
        truth = float(mean["true value, 250 runs"])
        ends = (1.25 * min(truth, mean[SIMULATOR]), 0.75 * max(truth, mean[SIMULATOR]))
        plot_intervals(
            list(shown.index),
            mean,
            mean - sd,
            mean + sd,
            ax,
            truth=truth,
            limits=ends,
            xlabel=UNIT,
        )
    mean = np.array([paper_value(name) for name in PUBLISHED])
    sd = np.array([PUBLISHED_SD[name] for name in PUBLISHED])
    names = ["true value", "OEE", "simulator"]
    plot_intervals(
        names, mean, mean - sd, mean + sd, axes[-1], truth=mean[0], xlabel=UNIT
    )


def finding(table: pd.DataFrame) -> str:
    """Write what OEE removes of the simulator's error, over the logs of each target.

    It is for the controller.
    """
    own = table[(table.policy == 0.0) & (table.estimator == OEE)]
    means = own.groupby(["target", "data"], sort=False).removed.mean()
    parts = [
        f"{reach(means[target], percent)} ({target})" for target in own.target.unique()
    ]
    return f"Exact OEE, tied, removes {', '.join(parts)} of the simulator's error"


def paper_value(name: str) -> float:
    """Return the paper's number for one of its three rows."""
    table = published_table()
    own = table[(table.figure == "kinova") & (table.series == PUBLISHED[name])]
    return float(own["mean"].iloc[0])


@experiment(
    "Table I on a simulated stand-in for the Kinova Gen3 (not the robot)",
    group="continuous",
    requires=("mujoco",),
    axes={"target": tuple(TARGETS), "data": (0.0, 0.3)},
    smoke={"target": (REFERENCE,), "data": (0.0,)},
    keys=("target", "data", "policy", "estimator"),
    measures=("value", "error", "removed", "uncovered", "left_out"),
    draw=draw,
    finding=finding,
    paper=published_value,
)
def table1(settings: Cell, stream: Stream) -> list[Row]:
    """Evaluate a SIMULATED STAND-IN: no data of the paper's robot was published, so the
    target is the same MuJoCo arm perturbed. Means of sum_t 0.99^t (-|x_t - goal|) in m
    over 5 goals, T = 25, 10 runs to each goal, recorded with a share delta of random
    commands. removed: share of the simulator's error (of 250 runs) that is gone. zeta
    is tied over displacements, against a defensive simulator (10% of it displacements
    times 0.5 and 1.5, a change of the paper's fixed simulator; the plain one beside
    it); calibrated: plus the simulator's difference between 250 runs and the grid.
    uncovered: share of the log's transitions without support, left_out: of states
    outside the grid. residual: the simulated arm corrected by what the log's steps
    leave over its own, 250 runs. The paper's column has the real arm's numbers.
    """
    target = str(settings["target"])
    data = float(settings["data"])
    rng = stream.generator()
    (plain, defensive) = simulators()
    recorded = {
        delta: kinova.record_goals(arm_of(target), n_runs=N_RUNS, delta=delta, seed=rng)
        for delta in sorted({data, *POLICIES})
    }
    corrected = ResidualSimulator(arm_of("simulator"), recorded[data], seed=0)
    log = kinova.hand_log(recorded[data])
    inside = ~(
        defensive.cells.outside(log.state) | defensive.cells.outside(log.next_state)
    )
    counts = defensive.counts(log if inside.all() else log.select(inside))
    zeta, models = models_of(plain, defensive, counts)
    exact = exact_values(models, target)
    rows: list[Row] = []
    for delta in POLICIES:
        truth, simulated = (known_values(name, delta) for name in (target, "simulator"))
        values = {name: found[delta] for name, found in exact.items()}
        again = kinova.record_goals(
            arm_of("simulator"), n_runs=N_RUNS, delta=delta, seed=rng
        )
        product, normalized = product_values(defensive, zeta, delta, rng)
        values |= {
            TRUE: run_values(recorded[delta]),
            SIMULATOR: run_values(again),
            "true value, 250 runs": truth,
            "simulator, 250 runs": simulated,
            "OEE, tied, exact, calibrated": (
                values[OEE] + simulated - values["defensive simulator on the grid"]
            ),
            "OEE, tied, 50 simulated runs": product,
            "OEE, tied, 50 simulated runs, self-normalised": normalized,
            RESIDUAL: simulate_values(corrected, delta),
            "PDIS": importance_sampling(recorded[data], delta),
        }
        for name in ORDER:
            rows.append(
                {
                    "policy": delta,
                    "estimator": name,
                    **compare(values[name], truth, simulated),
                    "left_out": 1.0 - inside.mean(),
                    "uncovered": models[name][1] if name in models else 0.0,
                    **by_goal(values[name]),
                }
            )
    return rows


def models_of(
    plain: Discretization, defensive: Discretization, counts: sparse.csr_array
) -> tuple[TransitionRatio, dict[str, tuple[FiniteMDP, float]]]:
    """Correct both simulators by a log's counts, tied or not, or take the counts alone.

    The first result is the tied zeta of the defensive simulator; a model stands with
    the share of the log's transitions that it does not support.
    """
    kept, uncovered = defensive.supported(counts)
    kept_plain, uncovered_plain = plain.supported(counts)
    zeta = transition_ratio(
        kept, defensive.mdp, tie=defensive.displacement_ties(), strength=STRENGTH
    )
    tied_plain = transition_ratio(
        kept_plain, plain.mdp, tie=plain.displacement_ties(), strength=STRENGTH
    )
    cellwise = transition_ratio(kept, defensive.mdp, prior="simulator", strength=1.0)
    return zeta, {
        OEE: (zeta.target_model(defensive.mdp), uncovered),
        "OEE, tied, exact, plain simulator": (
            tied_plain.target_model(plain.mdp),
            uncovered_plain,
        ),
        "OEE, not tied": (cellwise.target_model(defensive.mdp), uncovered),
        "model-based": (
            plain.mdp.with_transitions(frequencies(counts, plain.mdp.n_actions)),
            0.0,
        ),
    }


def exact_values(
    models: dict[str, tuple[FiniteMDP, float]], target: str
) -> dict[str, dict[float, Array]]:
    """Compute the values of the goals without rollouts, as name -> delta -> values."""
    found = {name: goal_values(model) for name, (model, _) in models.items()}
    return found | grid_values(target)


def by_goal(values: Array) -> Row:
    """Return the values of the goals, each under its name."""
    return {f"goal_{g}": float(value) for g, value in enumerate(values)}


def compare(values: Array, truth: Array, simulated: Array) -> Row:
    """Compare an estimate of the goals' values with the truth and the simulator's."""
    value = values.mean()
    apart = abs(simulated.mean() - truth.mean())
    return {
        "value": value,
        "error": value - truth.mean(),
        "removed": 1.0 - abs(value - truth.mean()) / apart,
    }

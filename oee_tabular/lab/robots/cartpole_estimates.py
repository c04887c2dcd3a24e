"""Every estimate of CartPole's values from one log, in one documented configuration.

    32 x 32 grid over (theta, theta'), the simulator (gravity 10) looked at in the log's own places, floor 0.001,
    zeta from soft counts with prior "simulator" and strength 0.01, exact evaluation, calibrated by the ratio.

The same for every gravity and n; ``cartpole_choice`` compares others on logs that no other experiment reports. Moves from or
to states outside the grid, one in a million, are left out; ends of the track, which (theta, theta') does not show, are taken
as truncations.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from oee_tabular._checks import Array
from oee_tabular._sparse import row_sums
from oee_tabular.continuous.cartpole.dynamics import CartPole
from oee_tabular.continuous.cartpole.expert import cartpole_policy
from oee_tabular.continuous.discretization import Discretization, GridInterpolation, discretize
from oee_tabular.continuous.episodes import record
from oee_tabular.continuous.gymnasium_named import gymnasium_simulator
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.task import ContinuousTask
from oee_tabular.estimators.rollouts import normalize_by_step, segment_products
from oee_tabular.exact import policy_value
from oee_tabular.lab.robots import LinearGaussian, cartpole_truth, frequencies
from oee_tabular.lab.robots.cartpole_truth import DELTAS, HORIZON, SIMULATED
from oee_tabular.mdp import FiniteMDP
from oee_tabular.ratio import TransitionRatio, transition_ratio

VERTICES, STRENGTH, FLOOR = 32, 0.01, 1e-3
DISCOUNT, BEHAVIOR = 0.99, 0.3
FINE_VERTICES = 320  # at which a task's values are within 0.1% of its own Monte Carlo


def exact_values(mdp: FiniteMDP, policies: Iterable[Array]) -> Array:
    """(1 - discount) times the value of each policy."""
    return np.array([policy_value(mdp, policy, horizon=HORIZON, normalized=True) for policy in policies])


def policies_of(model: Discretization) -> list[Array]:
    """The six policies of ``DELTAS`` on the model's states."""
    return [model.policy(cartpole_policy(delta)) for delta in DELTAS]


def calibrated(raw: Array, discretised: Array) -> Array:
    """Each raw value times the simulator's own value, by Monte Carlo / its value on the cells."""
    return raw * (cartpole_truth.values("simulator", SIMULATED) / discretised)


# ---- logs ----------------------------------------------------------------------------------------------------------------


def target_log(kind: str, gravity: float, n: int, generator: np.random.Generator, behavior: float = BEHAVIOR) -> Any:
    """n moves by delta = ``behavior``; kind "compiled" (our dynamics, the paper's noise) or "gymnasium" (stepped, no noise)."""
    policy = cartpole_policy(behavior)
    if kind == "gymnasium":
        task: Any = gymnasium_simulator(f"CartPole-v1:gravity={gravity}").task
        return task.record(policy, n_transitions=n, max_steps=HORIZON, seed=generator)
    return record(CartPole(gravity), policy, n_transitions=n, max_steps=HORIZON, seed=generator)


# ---- models of the log -----------------------------------------------------------------------------------------------------


def linear_model(log: ContinuousTransitions) -> LinearGaussian:
    """(theta, theta') linear in theta, theta', the force and 1; the model knows where the pole has fallen."""
    return LinearGaussian(CartPole(), log, slice(2, 4))


def fine_values(task: ContinuousTask) -> Array:
    """The values in a task of the angle, exact on a fine grid; noise is left at 0."""
    model = discretize(task, cells=(FINE_VERTICES, FINE_VERTICES), closure_episodes=0)
    return exact_values(model.mdp, policies_of(model))


def importance_sampling(log: ContinuousTransitions, *, self_normalized: bool) -> Array:
    """Per decision, on the log's whole episodes, with the probabilities that policy and behaviour have in each state."""
    assert log.episode is not None
    cut = log.episode[
        log.truncated & (log.columns()["timestep"] < HORIZON - 1)
    ]  # the last episode is cut where the log ends
    whole = log.first(len(log) - int(np.isin(log.episode, cut).sum()))
    columns = whole.columns()
    action, known = columns["action"], columns["behavior_probability"]
    starts = np.append(np.flatnonzero(np.diff(columns["episode"], prepend=-1)), len(whole))
    reward = (1.0 - DISCOUNT) * DISCOUNT ** columns["timestep"].astype(np.float64) * columns["reward"]
    found = []
    for delta in DELTAS:
        chosen = cartpole_policy(delta)(whole.state)[np.arange(len(action)), action]
        weight = segment_products(chosen / known, starts)
        if self_normalized:
            found.append(normalize_by_step(reward, weight, starts, weight[starts[1:] - 1])[0])
        else:
            found.append(float(np.add.reduceat(weight * reward, starts[:-1]).mean()))
    return np.array(found)


# ---- all of them -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Corrected:
    """Off-environment evaluation on a grid at a log's places: the simulator there, its zeta, and values raw and calibrated."""

    simulator: Discretization
    counts: sparse.csr_array
    zeta: TransitionRatio
    policies: list[Array]
    raw: Array
    calibrated: Array


def off_environment(log: ContinuousTransitions, *, vertices: int = VERTICES, strength: float = STRENGTH) -> Corrected:
    """The documented configuration, or another grid and strength."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*(ends do not show in the features|They are left out)")
        simulator = discretize(CartPole(SIMULATED), log, cells=(vertices, vertices), floor=FLOOR, closure_episodes=0)
        counts = simulator.counts(log, outside="drop")
    zeta = transition_ratio(counts, simulator.mdp, prior="simulator", strength=strength)
    policies = policies_of(simulator)
    raw, inside = (exact_values(mdp, policies) for mdp in (zeta.target_model(simulator.mdp), simulator.mdp))
    return Corrected(simulator, counts, zeta, policies, raw, calibrated(raw, inside))


def model_based(log: ContinuousTransitions, found: Corrected) -> tuple[Array, Array]:
    """The log's soft frequencies on the same cells, raw and calibrated.

    Calibration takes the simulator through the same: looked at in the log's places, and staying where the log was never.
    """
    mdp, n_actions = found.simulator.mdp, found.simulator.task.n_actions
    raw = exact_values(mdp.with_transitions(frequencies(found.counts, n_actions)), found.policies)
    cells = GridInterpolation(found.simulator.cells.shape, vertex_weight=0.0)
    looked = discretize(CartPole(SIMULATED), log, cells=cells, closure_episodes=0)
    seen = sparse.diags_array((row_sums(found.counts) > 0).astype(float))
    same = frequencies(sparse.csr_array(seen @ looked.mdp.transitions), n_actions)
    placebo = exact_values(mdp.with_transitions(same), found.policies)
    return raw, calibrated(raw, placebo)


def oracle(gravity: float, found: Corrected, noise: float) -> tuple[Array, Array]:
    """The target itself on the same cells and in the same places: what no log improves on; raw and calibrated."""
    target = discretize(CartPole(gravity, noise), cells=found.simulator, closure_episodes=0)
    raw, inside = (exact_values(mdp, found.policies) for mdp in (target.mdp, found.simulator.plain))
    return raw, calibrated(raw, inside)


def estimates(log: ContinuousTransitions, gravity: float, *, noise: float) -> tuple[dict[str, Array], Corrected]:
    """Name -> (6,) values at each of ``DELTAS``; ``gravity`` and ``noise`` are for the oracle alone."""
    found = off_environment(log)
    model, model_mended = model_based(log, found)
    ideal, ideal_mended = oracle(gravity, found, noise)
    return {
        "simulator": cartpole_truth.values("simulator", SIMULATED),
        "OEE": found.raw,
        "OEE, calibrated": found.calibrated,
        "model-based": model,
        "model-based, calibrated": model_mended,
        "linear model": fine_values(linear_model(log)),
        "IS, per decision": importance_sampling(log, self_normalized=False),
        "IS, self-normalised": importance_sampling(log, self_normalized=True),
        "oracle": ideal,
        "oracle, calibrated": ideal_mended,
    }, found

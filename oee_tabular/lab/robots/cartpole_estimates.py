"""What CartPole's policies are worth, and every estimate of it from one log, in one documented configuration.

    32 x 32 grid over (theta, theta'), the simulator (gravity 10) looked at in the log's own places, floor 0.001,
    zeta from soft counts with prior "simulator" and strength 0.01, exact evaluation, calibrated by the ratio.

The same for every gravity and n; ``cartpole_choice`` compares others on logs that no other experiment reports. Moves from or
to states outside the grid, one in a million, are left out; ends of the track, which (theta, theta') does not show, are taken
as truncations.

Values are (1 - discount) sum_{t<100} discount^t r_t, discount 0.99: at most 0.634, a pole that never falls. The truth is in
``cartpole_truth.csv``: means of 400 000 episodes, their standard errors beside them (at most 3e-4). The simulator's own value,
which a user has and which calibration needs, has other random numbers than the truth that estimates are held to.

    python -m oee_tabular.lab.robots.cartpole_estimates     makes the table again, the same to the last bit (five minutes)
"""

from __future__ import annotations

import functools
import hashlib
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy import sparse

from oee_tabular._checks import Array
from oee_tabular._sparse import row_sums
from oee_tabular.continuous.cartpole import PAPER_NOISE, CartPole, cartpole_policy
from oee_tabular.continuous.discretization import Discretization, GridInterpolation, discretize
from oee_tabular.continuous.episodes import MonteCarlo, monte_carlo_value, record
from oee_tabular.continuous.gymnasium_named import gymnasium_simulator
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.names import continuous_simulator
from oee_tabular.continuous.rows import sampling_rows
from oee_tabular.continuous.task import ContinuousTask
from oee_tabular.estimators import ImportanceSampling
from oee_tabular.exact import policy_value
from oee_tabular.lab.robots import LinearGaussian, frequencies
from oee_tabular.mdp import FiniteMDP
from oee_tabular.ratio import TransitionRatio, transition_ratio

DELTAS = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)
GRAVITIES = (7.5, 10.0, 12.5, 15.0)
SIMULATED = 10.0
HORIZON, EPISODES = 100, 400_000
CASES = {
    "target": (GRAVITIES, PAPER_NOISE, False),
    "target without noise": (GRAVITIES, 0.0, False),  # Gymnasium's
    "simulator": ((SIMULATED,), PAPER_NOISE, False),
    "deterministic expert": ((SIMULATED,), PAPER_NOISE, True),
}


def simulate_truth(case: str, gravity: float, delta: float, episodes: int = EPISODES) -> MonteCarlo:
    """One value of the table, with its own random numbers."""
    _, noise, deterministic = CASES[case]
    words = hashlib.sha256(f"cartpole {case} {gravity:g} {delta:g}".encode()).digest()
    return monte_carlo_value(
        CartPole(gravity, noise), cartpole_policy(delta, deterministic=deterministic), episodes, HORIZON,
        seed=np.frombuffer(words[:16], dtype=">u4").tolist(), normalized=True,
    )  # fmt: skip


def make_truths(episodes: int = EPISODES) -> pd.DataFrame:
    """The whole table: case, gravity, delta, value, standard_error, episodes."""
    keys = [
        (case, gravity, delta) for case, (gravities, _, _) in CASES.items() for gravity in gravities for delta in DELTAS
    ]
    found = [simulate_truth(*key, episodes) for key in keys]
    table = pd.DataFrame(keys, columns=["case", "gravity", "delta"])
    errors = [each.standard_error for each in found]
    return table.assign(value=[each.value for each in found], standard_error=errors, episodes=episodes)


@functools.cache
def truth_table() -> pd.DataFrame:
    """The shipped table."""
    with resources.files("oee_tabular.lab.robots").joinpath("cartpole_truth.csv").open() as handle:
        return pd.read_csv(handle)


def true_values(case: str, gravity: float, column: str = "value") -> Array:
    """(6,) values at each of ``DELTAS``, or their standard errors."""
    own = truth_table().query("case == @case and gravity == @gravity").set_index("delta")[column]
    return np.asarray(own.reindex(DELTAS), dtype=np.float64)


VERTICES, STRENGTH, FLOOR = 32, 0.01, 1e-3
DISCOUNT, BEHAVIOR = 0.99, 0.3
VISITING = continuous_simulator("cartpole").policies
FINE_VERTICES = 320  # at which a task's values are within 0.1% of its own Monte Carlo


def exact_values(mdp: FiniteMDP, policies: Iterable[Array]) -> Array:
    """(1 - discount) times the value of each policy."""
    return np.array([policy_value(mdp, policy, horizon=HORIZON, normalized=True) for policy in policies])


def policies_of(model: Discretization) -> list[Array]:
    """The six policies of ``DELTAS`` on the model's states."""
    return [model.policy(cartpole_policy(delta)) for delta in DELTAS]


def calibrated(raw: Array, discretised: Array) -> Array:
    """Each raw value times the simulator's own value, by Monte Carlo / its value on the cells."""
    return raw * (true_values("simulator", SIMULATED) / discretised)


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
    episode, is_cut = log.columns()["episode"], log.truncated & (log.columns()["timestep"] < HORIZON - 1)
    whole = log.first(len(log) - int(np.isin(episode, episode[is_cut]).sum()))  # the last is cut where the log ends
    estimator = ImportanceSampling(kind="per_decision", self_normalized=self_normalized)
    weigh = sampling_rows({"": estimator}, whole, len(CartPole.actions), HORIZON, DISCOUNT)[""]
    return (1.0 - DISCOUNT) * np.array([weigh(cartpole_policy(delta)).value for delta in DELTAS])


# ---- all of them -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Corrected:
    """Off-environment evaluation on cells at a log's places: the simulator there, its zeta, and values raw and calibrated.

    ``uncovered`` : share of the log's transitions without probability, which are left out.
    """

    simulator: Discretization
    counts: sparse.csr_array
    uncovered: float
    zeta: TransitionRatio
    policies: list[Array]
    raw: Array
    calibrated: Array


def off_environment(
    log: ContinuousTransitions, *, cells: Any = (VERTICES, VERTICES), strength: float = STRENGTH, form: str = "angle"
) -> Corrected:
    """The documented configuration; or other cells and strength, or cells of the whole state (``form`` "full")."""
    task = CartPole(SIMULATED, form=form)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*(ends do not show in the features|They are left out)")
        simulator = discretize(task, log, cells=cells, floor=FLOOR, policies=VISITING, closure_episodes=0)
        counts, uncovered = simulator.supported(simulator.counts(log, outside="drop"))
    zeta = transition_ratio(counts, simulator.mdp, prior="simulator", strength=strength)
    policies = policies_of(simulator)
    raw, inside = (exact_values(mdp, policies) for mdp in (zeta.target_model(simulator.mdp), simulator.mdp))
    return Corrected(simulator, counts, uncovered, zeta, policies, raw, calibrated(raw, inside))


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
        "simulator": true_values("simulator", SIMULATED),
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


if __name__ == "__main__":
    make_truths().to_csv(Path(__file__).with_name("cartpole_truth.csv"), index=False, lineterminator="\n")

"""What the gridworld experiments share: pairs of environments, logs by the paper's recipe, errors."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from oee_tabular._checks import Array
from oee_tabular.data import Transitions
from oee_tabular.estimators import Estimator
from oee_tabular.estimators.names import named_estimators
from oee_tabular.lab.panels import Errors
from oee_tabular.mdp import FiniteMDP, uniform_policy
from oee_tabular.ratio import TransitionRatio, true_ratio
from oee_tabular.simulate import sample_episodes
from oee_tabular.tasks import gridworld, gridworld_policy

SIMULATED_SLIP, REAL_SLIP = 0.3, 0.1
HORIZON, LONGEST = 200, 1000  # rewards of a value, steps of a recorded episode
HALF_DECADES = tuple(round(10**e) for e in (3, 3.5, 4, 4.5, 5, 5.5))
DELTAS = (0.1, 0.5, 0.9)
SCALE, SMALL_SCALE = 0.01, 0.05  # values times (1 - discount): of ``grids``, of ``small_grids``
NORMALISED = "of the value times (1 - discount)"
MEAN_ERROR = f"mean |error| {NORMALISED}"
ZETA_ERROR = "mean |zeta error| (ratio, no unit)"


@functools.lru_cache(maxsize=8)
def grids(size: int = 10, real: float = REAL_SLIP, discount: float = 0.99) -> tuple[FiniteMDP, FiniteMDP]:
    """The simulated and the real gridworld."""
    return gridworld(size, SIMULATED_SLIP, discount=discount), gridworld(size, real, discount=discount)


def halves(size: int) -> tuple[FiniteMDP, FiniteMDP]:
    """Slip 0.3 simulated; 0.1 real on the left half (small columns), 0.5 on the right."""
    simulator, less, more = (gridworld(size, slip) for slip in (SIMULATED_SLIP, 0.1, 0.5))
    left = np.repeat(np.arange(size * size) % size < size // 2, 4).astype(float)
    mixed = sparse.diags_array(left) @ less.transitions + sparse.diags_array(1 - left) @ more.transitions
    return simulator, simulator.with_transitions(sparse.csr_array(mixed))


def small_grids() -> tuple[FiniteMDP, FiniteMDP]:
    """5 x 5, discount 0.95, reward -Manhattan distance / 8 of the current cell."""
    row, column = np.divmod(np.arange(25), 5)
    simulator, target = grids(5, discount=0.95)
    return simulator.with_rewards((row + column - 8) / 8), target.with_rewards((row + column - 8) / 8)


def behavior_of(name: str, mdp: FiniteMDP) -> Array:
    """Of the name "uniform", or "pi_0.5": half expert, half uniform."""
    if name == "uniform":
        return uniform_policy(mdp)
    return gridworld_policy(round(mdp.n_states**0.5), float(name.removeprefix("pi_")))


def sample_pool(target: FiniteMDP, behavior: Array, n: int, generator: np.random.Generator) -> Transitions:
    """Whole episodes of at most 1000 steps that hold at least n transitions: a pilot of 20 says how many are needed."""
    pilot = sample_episodes(target, behavior, 20, LONGEST, seed=generator)
    needed = 20 + round(1.2 * n / (len(pilot) / 20))
    while len(pool := sample_episodes(target, behavior, needed, LONGEST, seed=generator)) < n:
        needed *= 2  # not episodes_holding's rule: the saved tables are of these draws
    return pool


def sample_log(target: FiniteMDP, behavior: Array, n: int, generator: np.random.Generator) -> Transitions:
    """n transitions drawn without replacement from such episodes: the paper's recipe."""
    return sample_pool(target, behavior, n, generator).draw(n, seed=generator)


def estimators_of(names: Mapping[str, str], target: FiniteMDP | None = None) -> dict[str, Estimator]:
    """Curve -> estimator, of curve -> its name in ``oee evaluate``; an oracle is told the target."""
    made = named_estimators(list(names.values()), target)
    return {curve: made[name] for curve, name in names.items()}


def zeta_error(zeta: TransitionRatio, target: FiniteMDP, simulator: FiniteMDP) -> float:
    """Mean |zeta_hat - zeta| over all (s, a, s') in the simulator's support; terminal states are left out."""
    truth = true_ratio(target, simulator).values.data
    live = np.repeat(np.repeat(~simulator.absorbing(), simulator.n_actions), np.diff(simulator.transitions.indptr))
    return float(np.abs(zeta.values.data - truth)[live].mean())


def rmse(errors: ArrayLike) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(errors))))


def error_of(value: float, truth: float, scale: float = SCALE) -> dict[str, float]:
    """A row's signed error and its square."""
    error = scale * (value - truth)
    return {"error": error, "squared_error": error**2}


def rmse_panels(curves: str, *by: str, **options: Any) -> Errors:
    """Root mean square errors over the seeds against n."""
    return Errors("error", curves, by=by, how=rmse, ylabel=f"RMSE {NORMALISED}", **options)

"""What discretising costs: the closure error, measured, and the warning about a grid that is too coarse."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from oee_tabular._checks import Array, Seed
from oee_tabular.continuous.episodes import monte_carlo_value
from oee_tabular.continuous.grid import Places
from oee_tabular.continuous.task import StatePolicy
from oee_tabular.mdp import FiniteMDP


@dataclass(frozen=True)
class Closure:
    """What discretising costs: the value of one policy in the finite model against Monte Carlo in the task itself.

    Attributes
    ----------
    discretised : the value in the finite model
    monte_carlo : the value in the task itself
    error : (discretised - monte_carlo) / scale, where the scale is |monte_carlo|, or the standard deviation of a return if
        that is larger (for returns that change sign)
    standard_error : Monte Carlo's, on the same scale

    Examples
    --------
    >>> from oee_tabular.tasks import CartPole, GridInterpolation
    >>> closure = GridInterpolation((32, 32), closure_episodes=0).build(CartPole()).closure(n_episodes=1000, seed=0)
    >>> abs(closure.error) < 0.05, closure.standard_error < 0.02
    (True, True)
    """

    discretised: float
    monte_carlo: float
    error: float
    standard_error: float


def measure(
    found: Places,
    mdp: FiniteMDP,
    policy: StatePolicy | None,
    *,
    horizon: int,
    n_episodes: int,
    discount: float | None,
    seed: Seed,
) -> Closure:
    """The closure error of ``policy`` (default: uniform); see ``Discretization.closure``."""
    from oee_tabular.exact import policy_value  # what it compiles with is imported only here

    def uniform(states: Array) -> Array:
        return np.full((len(states), found.task.n_actions), 1.0 / found.task.n_actions)

    chosen = uniform if policy is None else policy
    gamma = mdp.discount if discount is None else discount
    mc = monte_carlo_value(found.task, chosen, n_episodes, horizon, discount=gamma, seed=seed)
    value = policy_value(mdp.with_discount(gamma), found.policy(chosen), horizon=horizon)
    scale = max(abs(mc.value), mc.deviation, np.finfo(float).tiny)
    return Closure(value, mc.value, (value - mc.value) / scale, mc.standard_error / scale)


def warn_if_coarse(found: Places, closure: Closure, steps_in_cells: Sequence[float], tolerance: float) -> None:
    """A warning where the measured closure error is beyond ``tolerance`` and Monte Carlo's own error."""
    if abs(closure.error) <= tolerance + 2.0 * closure.standard_error:
        return
    steps = ", ".join(f"{name} {step:.2g}" for name, step in zip(found.task.feature_names, steps_in_cells, strict=True))
    warnings.warn(
        f"{found.cells.extent()} is too coarse for the steps of {found.task.name}: the uniform policy's value is "
        f"{closure.discretised:.4g}, and {closure.monte_carlo:.4g} by Monte Carlo, a closure error of {closure.error:+.1%} "
        f"(+-{closure.standard_error:.1%}); the median step, in spacings: {steps}. A step well below 1 is smeared out by "
        "interpolation: take more points there",
        stacklevel=4,
    )

"""What the gridworld experiments share: the pair of environments, logs by the paper's recipe, panels of a figure."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import sparse

from oee_tabular._checks import Array
from oee_tabular.data import Transitions
from oee_tabular.mdp import FiniteMDP, uniform_policy
from oee_tabular.ratio import TransitionRatio, true_ratio
from oee_tabular.simulate import sample_episodes
from oee_tabular.tasks import gridworld, gridworld_policy

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SIMULATED_SLIP, REAL_SLIP = 0.3, 0.1
HORIZON, LONGEST = 200, 1000  # rewards of a value, steps of a recorded episode
HALF_DECADES = tuple(round(10**e) for e in (3, 3.5, 4, 4.5, 5, 5.5))
DELTAS = (0.1, 0.5, 0.9)


@functools.lru_cache(maxsize=8)
def grids(size: int) -> tuple[FiniteMDP, FiniteMDP]:
    """The simulated and the real gridworld."""
    return gridworld(size, SIMULATED_SLIP), gridworld(size, REAL_SLIP)


def halves(size: int) -> tuple[FiniteMDP, FiniteMDP]:
    """Slip 0.3 simulated; 0.1 real on the left half (small columns), 0.5 on the right."""
    simulator, less, more = (gridworld(size, slip) for slip in (SIMULATED_SLIP, 0.1, 0.5))
    left = np.repeat(np.arange(size * size) % size < size // 2, 4).astype(float)
    mixed = sparse.diags_array(left) @ less.transitions + sparse.diags_array(1 - left) @ more.transitions
    return simulator, simulator.with_transitions(sparse.csr_array(mixed))


def small_grids() -> tuple[FiniteMDP, FiniteMDP]:
    """5 x 5, discount 0.95, reward -Manhattan distance / 8 of the current cell."""
    row, column = np.divmod(np.arange(25), 5)
    made = []
    for slip in (SIMULATED_SLIP, REAL_SLIP):
        base = gridworld(5, slip, discount=0.95)
        made.append(base.with_rewards((row + column - 8) / 8))
    return made[0], made[1]


def behavior_of(name: str, mdp: FiniteMDP) -> Array:
    """Of the name "uniform", or "pi_0.5": half expert, half uniform."""
    if name == "uniform":
        return uniform_policy(mdp)
    return gridworld_policy(round(mdp.n_states**0.5), float(name.removeprefix("pi_")))


def episodes_for(target: FiniteMDP, behavior: Array, n: int, generator: np.random.Generator) -> Transitions:
    """Whole episodes of at most 1000 steps that hold at least n moves: a pilot of 20 says how many are needed."""
    pilot = sample_episodes(target, behavior, 20, LONGEST, seed=generator)
    needed = 20 + round(1.2 * n / (len(pilot) / 20))
    while len(pool := sample_episodes(target, behavior, needed, LONGEST, seed=generator)) < n:
        needed *= 2
    return pool


def drawn(target: FiniteMDP, behavior: Array, n: int, generator: np.random.Generator) -> Transitions:
    """n moves drawn without replacement from such episodes: the paper's recipe."""
    return episodes_for(target, behavior, n, generator).draw(n, seed=generator)


def zeta_error(zeta: TransitionRatio, target: FiniteMDP, simulator: FiniteMDP) -> float:
    """Mean |zeta_hat - zeta| over all (s, a, s') in the simulator's support; states that are over are left out."""
    truth = true_ratio(target, simulator).values.data
    live = np.repeat(np.repeat(~simulator.absorbing(), simulator.n_actions), np.diff(simulator.transitions.indptr))
    return float(np.abs(zeta.values.data - truth)[live].mean())


def rmse(errors: Any) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(errors))))


def panels(
    figure: Figure, names: list[Any], *, columns: int | None = None, size: tuple[float, float] = (4.8, 3.9)
) -> list[Axes]:
    """Titled axes side by side, each of ``size`` inches."""
    across = len(names) if columns is None else min(columns, len(names))
    down = -(-len(names) // across)
    figure.set_size_inches(size[0] * across, size[1] * down)
    axes = list(np.ravel(figure.subplots(down, across, squeeze=False)))
    for ax, name in zip(axes, names, strict=False):
        ax.set_title(str(name), fontsize="medium")
    for ax in axes[len(names) :]:
        ax.set_visible(False)
    return axes[: len(names)]


def series_of(
    frame: pd.DataFrame, by: str, x: str, value: str, where: list[Any], how: Callable[[Any], float] | None = None
) -> dict[str, Array]:
    """name -> values at ``where``: the mean (or ``how``) of the rows of each name and x; nan where there are none."""
    found = {}
    for name, part in frame.groupby(by, sort=False):
        groups = part.groupby(x)[value]
        values = groups.mean() if how is None else groups.apply(how)
        found[str(name)] = values.reindex(where).to_numpy(dtype=float)
    return found


def quantile_bands(
    frame: pd.DataFrame, by: str, x: str, value: str, where: list[Any]
) -> dict[str, tuple[Array, Array]]:
    """name -> (smallest, largest) over the seeds at each x."""
    found = {}
    for name, part in frame.groupby(by, sort=False):
        groups = part.groupby(x)[value]
        found[str(name)] = tuple(end.reindex(where).to_numpy(dtype=float) for end in (groups.min(), groups.max()))
    return found  # type: ignore[return-value]

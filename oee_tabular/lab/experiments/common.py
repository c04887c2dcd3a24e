"""Functions that experiments share.

They give the paper's published figures, pairs of gridworlds, logs by the paper's recipe
and errors.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy import sparse

import oee_tabular as oee
from oee_tabular._sparse import row_sums
from oee_tabular.lab.experiment import Panels
from oee_tabular.tasks import gridworld, gridworld_policy
from oee_tabular.typing import Array

HORIZON = 200  # rewards of a value
MAX_EPISODE_STEPS = 1000  # of a recorded episode
HALF_DECADES = tuple(round(10**e) for e in (3, 3.5, 4, 4.5, 5, 5.5))
DELTAS = (0.1, 0.5, 0.9)
DATA = {"uniform": 0.0, "pi_0.5": 0.5}  # delta of the policies that record
SCALE = 0.01  # 1 - discount of ``grids``
SMALL_SCALE = 0.05  # 1 - discount of ``small_grids``
MEAN_ERROR = "mean |error| of (1 - discount) J"


@functools.cache
def published_table() -> pd.DataFrame:
    """Load the paper's published figures as numbers.

    The columns are figure, setting, series, x, mean, lo and hi. Some curves were never
    published.
    """
    return pd.read_csv(Path(__file__).with_name("paper.csv"))


def published(figure: str, setting: str, series: str) -> pd.DataFrame:
    """Return the points of one of the paper's curves by x; empty if unpublished."""
    table = published_table()
    points = table[
        (table.figure == figure) & (table.setting == setting) & (table.series == series)
    ]
    return points.sort_values("x").reset_index(drop=True)


def published_at(figure: str, setting: str, series: str, x: float) -> float:
    """Return the published mean at one point; nan where there is none."""
    return float(
        published(figure, setting, series).set_index("x")["mean"].get(x, float("nan"))
    )


@functools.lru_cache(maxsize=8)
def grids(
    size: int = 10, real: float = 0.1, discount: float = 0.99
) -> tuple[oee.FiniteMDP, oee.FiniteMDP]:
    """Return the simulated gridworld, of slip 0.3, and the real one."""
    return gridworld(size, 0.3, discount=discount), gridworld(
        size, real, discount=discount
    )


def small_grids() -> tuple[oee.FiniteMDP, oee.FiniteMDP]:
    """Return grids of 5 x 5 with discount 0.95, simulated and real.

    The reward is -Manhattan distance / 8 of the current cell.
    """
    row, column = np.divmod(np.arange(25), 5)
    simulator, target = grids(5, discount=0.95)
    return simulator.with_rewards((row + column - 8) / 8), target.with_rewards(
        (row + column - 8) / 8
    )


def sample_pool(
    target: oee.FiniteMDP, behavior: Array, n: int, generator: np.random.Generator
) -> oee.Transitions:
    """Sample whole episodes of at most 1000 steps with at least n transitions.

    A pilot of 20 episodes says how many are needed.
    """
    pilot = oee.sample_episodes(target, behavior, 20, MAX_EPISODE_STEPS, seed=generator)
    needed = 20 + round(1.2 * n / (len(pilot) / 20))
    while True:
        pool = oee.sample_episodes(
            target, behavior, needed, MAX_EPISODE_STEPS, seed=generator
        )
        if len(pool) >= n:
            return pool
        needed *= 2  # not episodes_holding's rule: the saved tables are of these draws


def sample_log(
    target: oee.FiniteMDP, delta: float, n: int, generator: np.random.Generator
) -> oee.Transitions:
    """Draw n transitions without replacement from whole episodes of pi_delta.

    This is the paper's recipe.
    """
    behavior = gridworld_policy(round(target.n_states**0.5), delta)
    return sample_pool(target, behavior, n, generator).draw(n, seed=generator)


def zeta_error(
    zeta: oee.TransitionRatio, target: oee.FiniteMDP, simulator: oee.FiniteMDP
) -> float:
    """Compute the mean |zeta_hat - zeta| over all (s, a, s').

    It is over the simulator's support; terminal states are left out.
    """
    truth = oee.true_ratio(target, simulator).values.data
    live = np.repeat(
        np.repeat(~simulator.absorbing(), simulator.n_actions),
        np.diff(simulator.transitions.indptr),
    )
    return float(np.abs(zeta.values.data - truth)[live].mean())


def signed_error(value: float, truth: float, scale: float = SCALE) -> dict[str, float]:
    """Return the columns of an error: the scaled error and its square."""
    error = scale * (value - truth)
    return {"error": error, "squared_error": error**2}


def rmse(errors: ArrayLike) -> float:
    """Compute the root mean square of errors."""
    return float(np.sqrt(np.mean(np.square(errors))))


# Figures of errors have logarithmic axes and a line of slope -1/2 against n.
ErrorPanels = functools.partial(Panels, log=True, slope=-0.5, axes={"xscale": "log"})
RmsePanels = functools.partial(
    ErrorPanels, "error", how=rmse, ylabel="RMSE of (1 - discount) J"
)


# ---- the robots


def frequencies(counts: sparse.csr_array, n_actions: int) -> sparse.csr_array:
    """Compute the log's own rows n(s, a, s') / n(s, a).

    In a pair that was never recorded the state stays as it is.
    """
    total = row_sums(counts)
    unrecorded = np.flatnonzero(total == 0)
    staying = sparse.csr_array(
        (np.ones(len(unrecorded)), (unrecorded, unrecorded // n_actions)),
        shape=counts.shape,
    )
    return sparse.csr_array(
        sparse.diags_array(1.0 / np.where(total > 0, total, 1.0)) @ counts + staying
    )


def distance_between(first: pd.DataFrame, second: pd.DataFrame) -> float:
    """Compute the mean |difference| of two of the paper's curves.

    It is nan where they have no points in common.
    """
    both = first.merge(second, on="x")
    if both.empty:
        return float("nan")
    return float((both["mean_x"] - both["mean_y"]).abs().mean())


def mark_paper(
    ax: Any, figure: str, setting: str, markers: Mapping[str, tuple[str, str]]
) -> None:
    """Mark what the paper published, series -> (name, marker).

    The paper's expert is lost, so its points need not lie on our lines.
    """
    for series, (name, marker) in markers.items():
        points = published(figure, setting, series)
        if len(points):
            label = f"the paper's {name}"
            ax.plot(
                points.x,
                points["mean"],
                ls="none",
                marker=marker,
                mfc="none",
                color="0.35",
                label=label,
            )


def select_deltas(table: pd.DataFrame, deltas: Iterable[float]) -> pd.DataFrame:
    """Return a row for each policy, for figures.

    The columns value_0.1, truth_0.1, ... become delta, value, truth and error.
    """
    parts = [
        table.assign(
            delta=delta,
            value=table[f"value_{delta:g}"],
            truth=table[f"truth_{delta:g}"],
        )
        for delta in deltas
    ]
    found = pd.concat(parts)
    return found.assign(error=(found.value - found.truth).abs())

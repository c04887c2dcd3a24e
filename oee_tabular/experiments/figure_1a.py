"""fig1a: the mean absolute error of zeta against the number of transitions, on grids of 10, 20 and 40."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from oee_tabular.experiments import paper
from oee_tabular.experiments.common import (
    HALF_DECADES,
    behavior_of,
    drawn,
    grids,
    panels,
    quantile_bands,
    series_of,
    zeta_error,
)
from oee_tabular.experiments.registry import Cell, Experiment, Row, Stream
from oee_tabular.ratio import TransitionRatio, action_displacement, transition_ratio

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

DEFAULT, PAPER = "default (average of candidates, evidence)", "paper's networks"
RATIOS: dict[str, Callable[..., TransitionRatio]] = {
    DEFAULT: transition_ratio,
    "maximum likelihood": partial(transition_ratio, prior="none"),
    "simulator prior": partial(transition_ratio, prior="simulator"),
    "paper's quotient, tabular": partial(transition_ratio, method="ratio_of_ratios"),
    "linear class": partial(transition_ratio, method="linear"),
}


def cell(settings: Cell, stream: Stream) -> list[Row]:
    """One log, every estimator."""
    size, n = int(settings["grid"]), int(settings["n"])
    simulator, target = grids(size)
    generator = stream.generator()
    log = drawn(target, behavior_of(str(settings["data"]), target), n, generator)
    rows = []
    for name, fit in RATIOS.items():
        options: dict[str, Any] = {}
        if "quotient" in name:
            options["seed"] = generator
        if "linear" in name:
            options["features"] = action_displacement(
                simulator, np.column_stack(np.divmod(np.arange(size * size), size))
            )
        zeta = fit(log, simulator, **options)
        rows.append({"estimator": name, "error": zeta_error(zeta, target, simulator), "gap": zeta.gap})
    return rows


def published(summary: pd.DataFrame) -> list[float]:
    """The networks' error at the same grid and n, for the paper's data."""
    series = "mean_absolute_error_of_zeta"
    return [
        paper.at("fig1a", f"grid={grid}", series, float(n)) if data == "uniform" else np.nan
        for data, grid, n in zip(summary["data"], summary["grid"], summary["n"], strict=True)
    ]


def draw(table: pd.DataFrame, summary: pd.DataFrame, figure: Figure) -> None:
    """A panel for each grid and data policy."""
    from oee_tabular.plots import plot_errors

    cases: list[Any] = list(table.groupby(["data", "grid"], sort=False).groups)
    names = [f"{size} x {size}, data of {data}" for data, size in cases]
    for ax, (data, size) in zip(panels(figure, names, columns=3), cases, strict=True):
        part = table[(table.data == data) & (table.grid == size)]
        n = sorted(part.n.unique())
        curves = series_of(part, "estimator", "n", "error", n)
        bands = quantile_bands(part, "estimator", "n", "error", n)
        points = paper.curve("fig1a", f"grid={size}", "mean_absolute_error_of_zeta")
        if data == "uniform" and len(points):
            curves[PAPER] = points.set_index("x")["mean"].reindex(n).to_numpy(dtype=float)
        plot_errors(n, curves, ax, bands=bands, slope=None, ylabel="mean |zeta error| (ratio, no unit)")


FIGURE_1A = Experiment(
    id="fig1a",
    title="Figure 1a: error of the ratio of transition probabilities against sample size",
    axes={"data": ("uniform", "pi_0.5"), "grid": (10, 20, 40), "n": HALF_DECADES},
    smoke={"data": ("uniform",), "grid": (10,), "n": HALF_DECADES[:3]},
    run=cell,
    keys=("data", "grid", "n", "estimator"),
    measures=("error",),
    draw=draw,
    paper=published,
    caption=(
        "Mean |zeta_hat - zeta| over all (s, a, s') of the simulator's support, the goal left out; slip 0.3 simulated, "
        "0.1 real; n moves drawn without replacement from episodes of at most 1000 steps. Lines: means over the seeds; "
        "bands: the smallest and the largest. The linear class has indicators of (action, displacement). The paper's "
        "networks (published for 10 and 40, uniform data only) in the same panels. zeta = 1 scores 0.570."
    ),
)

"""How errors fall with n: rates, and a target that one tilt misses."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from oee_tabular.estimators import ModelBased, OffEnvironment, Problem, Simulator
from oee_tabular.exact import policy_value
from oee_tabular.experiments.common import (
    DELTAS,
    HALF_DECADES,
    HORIZON,
    behavior_of,
    drawn,
    episodes_for,
    grids,
    halves,
    panels,
    rmse,
    series_of,
    zeta_error,
)
from oee_tabular.experiments.registry import Cell, Experiment, Row, Stream
from oee_tabular.mdp import uniform_policy
from oee_tabular.ratio import TransitionRatio, transition_ratio
from oee_tabular.tasks import gridworld_policy

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

SCALE = 0.01  # values times (1 - discount)
MARK = 30_000  # n from which slopes are fitted

# ---- rate --------------------------------------------------------------------------------------------------------------

RATIOS: dict[str, Callable[..., TransitionRatio]] = {
    "maximum likelihood": lambda log, simulator, _: transition_ratio(log, simulator, prior="none"),
    "simulator prior, strength 1": lambda log, simulator, _: transition_ratio(
        log, simulator, prior="simulator", strength=1.0
    ),
    "default": lambda log, simulator, policy: transition_ratio(log, simulator, values_of=policy, horizon=HORIZON),
}


def rate_cell(settings: Cell, stream: Stream) -> list[Row]:
    """One log: the first n moves of its episodes; three ratios, three policies."""
    n = int(settings["n"])
    simulator, target = grids(10)
    generator = stream.generator()
    log = episodes_for(target, behavior_of(str(settings["data"]), target), n, generator).first(n)
    problem = Problem(simulator, log, horizon=HORIZON)
    rows = []
    for name, fit in RATIOS.items():
        for delta in DELTAS:
            policy = gridworld_policy(10, delta)
            zeta = fit(log, simulator, policy)
            value = OffEnvironment(zeta)(problem, policy).value
            error = SCALE * (value - policy_value(target, policy, horizon=HORIZON))
            rows.append({"ratio": name, "delta": delta, "error": error, "squared_error": error**2,
                         "zeta_error": zeta_error(zeta, target, simulator)})  # fmt: skip
    return rows


def fitted_slopes(table: pd.DataFrame, value: str = "squared_error", start: int = MARK) -> pd.Series:
    """Least-squares slope of log10 RMSE on log10 n, for each data policy, policy and ratio, from ``start`` on."""
    late = table[table.n >= start]
    points = late.groupby(["data", "delta", "ratio", "n"], sort=False)[value].mean().reset_index()
    return points.groupby(["data", "delta", "ratio"], sort=False)[["n", value]].apply(
        lambda g: 0.5 * np.polyfit(np.log10(g["n"]), np.log10(g[value]), 1)[0] if len(g) > 1 else np.nan
    )


def draw_rate(table: pd.DataFrame, summary: pd.DataFrame, figure: Figure) -> None:
    """RMSE against n with slopes -1/2 and -1/4."""
    from oee_tabular.plots import plot_errors

    cases: list[Any] = list(table.groupby(["data", "delta"], sort=False).groups)
    n = sorted(table.n.unique())
    names = [f"data of {data}, delta = {delta:g}" for data, delta in cases]
    for ax, (data, delta) in zip(panels(figure, names, columns=3), cases, strict=True):
        part = table[(table.data == data) & (table.delta == delta)]
        curves = series_of(part, "ratio", "n", "error", n, rmse)
        first = next(iter(curves.values()))[0]
        ax.plot(
            n, first * (np.array(n) / n[0]) ** -0.25, color="grey", lw=1, ls=(0, (1, 4)), label="slope -0.25", zorder=0
        )
        plot_errors(n, curves, ax, slope=-0.5, ylabel="RMSE of the value times (1 - discount)")


RATE = Experiment(
    id="rate",
    title="The rate is n^-1/2, not the paper's bound n^-1/4",
    axes={"data": ("uniform", "pi_0.5"), "n": (*HALF_DECADES, 1_000_000)},
    smoke={"data": ("uniform",), "n": (1000, 10_000)},
    repetitions=60,
    run=rate_cell,
    keys=("data", "n", "delta", "ratio"),
    measures=("squared_error", "error", "zeta_error"),
    draw=draw_rate,
    caption=(
        "10 x 10 grid, T = 200; the first n moves of episodes of at most 1000 steps of the uniform policy, or of "
        "pi_0.5. Root mean square over the seeds of the error of the exact value, with lines of slope -1/2 and -1/4. "
        "The default is more accurate at every n, by less as n grows where its centre is only nearly right: its slope is "
        "then flatter. Where the data policy hardly visits what the evaluated policy needs (data of pi_0.5, delta ="
        " 0.1), n = 10^6 is not yet large."
    ),
)

# ---- misspecified ------------------------------------------------------------------------------------------------------

CHOICES: dict[str, OffEnvironment] = {
    "default": OffEnvironment(),
    "one tilt for all": OffEnvironment(ratio=partial(transition_ratio, smoothness=np.inf)),
}


def misspecified_cell(settings: Cell, stream: Stream) -> list[Row]:
    """One log; the value and the one-step value of two ratios, maximum likelihood, the simulator."""
    n = int(settings["n"])
    simulator, target = halves(20)
    log = drawn(target, uniform_policy(target), n, stream.generator())
    problem = Problem(simulator, log, horizon=HORIZON)
    rows = []
    for delta in DELTAS:
        policy = gridworld_policy(20, delta)
        truth = policy_value(target, policy, horizon=HORIZON)
        values = {
            "maximum likelihood": ModelBased()(problem, policy).value,
            "simulator": Simulator()(problem, policy).value,
        }
        moved = {}
        for name, estimator in CHOICES.items():
            estimate = estimator(problem, policy)
            values[name], moved[name] = estimate.value, estimate.diagnostics["moved"]
            values[f"{name}, one-step"] = estimate.diagnostics["one_step_value"]
        for name, value in values.items():
            error = SCALE * (value - truth)
            rows.append({"delta": delta, "estimator": name, "error": error, "squared_error": error**2,
                         "moved": moved.get(name, np.nan)})  # fmt: skip
    return rows


def draw_misspecified(table: pd.DataFrame, summary: pd.DataFrame, figure: Figure) -> None:
    """RMSE against n for each policy."""
    from oee_tabular.plots import plot_errors

    deltas, n = sorted(table.delta.unique()), sorted(table.n.unique())
    for ax, delta in zip(panels(figure, [f"delta = {delta:g}" for delta in deltas]), deltas, strict=True):
        curves = series_of(table[table.delta == delta], "estimator", "n", "error", n, rmse)
        plot_errors(n, curves, ax, slope=None, ylabel="RMSE of the value times (1 - discount)")


MISSPECIFIED = Experiment(
    id="misspecified",
    title="A target that one tilt cannot express",
    axes={"n": HALF_DECADES},
    smoke={"n": (1000, 3162)},
    repetitions=20,
    run=misspecified_cell,
    keys=("n", "delta", "estimator"),
    measures=("squared_error", "error", "moved"),
    draw=draw_misspecified,
    caption=(
        "20 x 20 grid, slip 0.3 simulated; 0.1 real on the left half, 0.5 on the right; T = 200, data of the uniform "
        "policy. Root mean square over the seeds. The default finds that theta varies over the states; with one theta "
        "for all the centre is wrong, and the value is moved from it (the share moved is in the table) towards the "
        "one-step value, which has maximum likelihood's variance."
    ),
)

"""How errors fall with n: rates, and a target that one tilt misses."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from oee_tabular.estimators import ModelBased, OffEnvironment, Problem, Simulator
from oee_tabular.exact import policy_value
from oee_tabular.lab.experiments import common as grid
from oee_tabular.lab.experiments.common import DELTAS, HALF_DECADES, HORIZON
from oee_tabular.lab.findings import course, listed, span
from oee_tabular.lab.registry import Cell, Experiment, Row, Stream
from oee_tabular.mdp import uniform_policy
from oee_tabular.ratio import TransitionRatio, transition_ratio
from oee_tabular.tasks import gridworld_policy

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

# ---- rate --------------------------------------------------------------------------------------------------------------

RATIOS: dict[str, Callable[..., TransitionRatio]] = {
    "maximum likelihood": lambda log, simulator, _: transition_ratio(log, simulator, prior="none"),
    "simulator prior, strength 1": lambda log, simulator, _: transition_ratio(
        log, simulator, prior="simulator", strength=1.0
    ),
    "default": lambda log, simulator, policy: transition_ratio(log, simulator, values_of=policy, horizon=HORIZON),
}


def rate_cell(settings: Cell, stream: Stream) -> list[Row]:
    """10 x 10 grid, T = 200; the first n moves of episodes of at most 1000 steps of the uniform policy, or of pi_0.5.
    Root mean square over the seeds of the error of the exact value, with lines of slope -1/2 and -1/4. The default is
    more accurate at every n, by less as n grows where its centre is only nearly right: its slope is then flatter.
    Where the data policy hardly visits what the evaluated policy needs (data of pi_0.5, delta = 0.1), n = 10^6 is not
    yet large.
    """
    n = int(settings["n"])
    simulator, target = grid.grids()
    generator = stream.generator()
    log = grid.episodes_for(target, grid.behavior_of(str(settings["data"]), target), n, generator).first(n)
    problem = Problem(simulator, log, horizon=HORIZON)
    rows: list[Row] = []
    for name, fit in RATIOS.items():
        for delta in DELTAS:
            policy = gridworld_policy(10, delta)
            zeta = fit(log, simulator, policy)
            error = grid.error_of(
                OffEnvironment(zeta)(problem, policy).value, policy_value(target, policy, horizon=HORIZON)
            )
            off = grid.zeta_error(zeta, target, simulator)
            rows.append({"ratio": name, "delta": delta, **error, "zeta_error": off})
    return rows


def quarter_slope(ax: Axes, rows: pd.DataFrame) -> None:
    """A grey line of slope -1/4 from where the first curve begins."""
    n = np.sort(rows.n.unique())
    first = rows[(rows.n == n[0]) & (rows.ratio == rows.ratio.iloc[0])]
    line = grid.rmse(first.error) * (n / n[0]) ** -0.25
    ax.plot(n, line, color="grey", lw=1, ls=(0, (1, 4)), label="slope -0.25", zorder=0)


def rate_finding(table: pd.DataFrame) -> str:
    """The slope of each curve from its first n to its last, the mean over the panels; its error where there is one n."""
    first, last = table.n.min(), table.n.max()
    by = table.pivot_table("error", ["ratio", "data", "delta"], "n", aggfunc=grid.rmse)
    if first == last:
        return f"{span(table)} the RMSE is {listed(by[last].groupby('ratio').mean())}"
    slopes = np.log(by[last] / by[first]).groupby("ratio").mean() / np.log(last / first)
    return f"{span(table)} errors go as {listed(slopes, 'n^{:.2f}'.format)}"


RATE = Experiment(
    id="rate",
    title="The rate of the error, beside the paper's bound n^-1/4",
    axes={"data": ("uniform", "pi_0.5"), "n": (*HALF_DECADES, 1_000_000)},
    smoke={"data": ("uniform",), "n": (1000, 10_000)},
    repetitions=60,
    run=rate_cell,
    keys=("data", "n", "delta", "ratio"),
    measures=("squared_error", "error", "zeta_error"),
    draw=grid.rmse_panels(
        "ratio",
        "data",
        "delta",
        title="data of {data}, delta = {delta:g}",
        slope=-0.5,
        beneath=quarter_slope,
        columns=3,
    ),
    finding=rate_finding,
)

# ---- misspecified ------------------------------------------------------------------------------------------------------

CHOICES: dict[str, OffEnvironment] = {
    "default": OffEnvironment(),
    "one tilt for all": OffEnvironment(ratio=partial(transition_ratio, prior="tilt")),
}


def misspecified_cell(settings: Cell, stream: Stream) -> list[Row]:
    """20 x 20 grid, slip 0.3 simulated; 0.1 real on the left half, 0.5 on the right; T = 200, data of the uniform
    policy. Root mean square over the seeds. The default finds that the slip changes across the floor; with one
    theta for all the prior is wrong, and the value is moved from it (the share moved is in the table) towards maximum
    likelihood's.
    """
    n = int(settings["n"])
    simulator, target = grid.halves(20)
    log = grid.drawn(target, uniform_policy(target), n, stream.generator())
    problem = Problem(simulator, log, horizon=HORIZON)
    rows: list[Row] = []
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
            error = grid.error_of(value, truth)
            rows.append({"delta": delta, "estimator": name, **error, "moved": moved.get(name, np.nan)})
    return rows


def misspecified_finding(table: pd.DataFrame) -> str:
    """How the default, one tilt and maximum likelihood go with n."""
    names = ("default", *list(CHOICES)[1:], "maximum likelihood")
    each = [f"of {name} {course(table[table.estimator == name], how=grid.rmse)}" for name in names]
    return f"{span(table)} the RMSE " + "; ".join(each)


MISSPECIFIED = Experiment(
    id="misspecified",
    title="A target that one tilt cannot express",
    axes={"n": HALF_DECADES},
    smoke={"n": (1000, 3162)},
    repetitions=20,
    run=misspecified_cell,
    keys=("n", "delta", "estimator"),
    measures=("squared_error", "error", "moved"),
    draw=grid.rmse_panels("estimator", "delta"),
    finding=misspecified_finding,
)

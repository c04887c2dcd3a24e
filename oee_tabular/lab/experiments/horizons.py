"""What importance sampling costs: products over the horizon, and data policies far from the one evaluated."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from oee_tabular.estimators import OffEnvironment, Problem
from oee_tabular.exact import occupancy, policy_is_moments, policy_value, weighted_return_moments
from oee_tabular.lab.experiments.common import (
    DELTAS,
    HORIZON,
    MEAN_ERROR,
    SCALE,
    drawn,
    episodes_for,
    estimators_of,
    grids,
)
from oee_tabular.lab.findings import number, reach, span
from oee_tabular.lab.panels import Panels
from oee_tabular.lab.registry import Cell, Experiment, Row, Stream
from oee_tabular.mdp import uniform_policy
from oee_tabular.ratio import true_ratio
from oee_tabular.tasks import gridworld_policy

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

HORIZONS = (1, 2, 5, 10, 20, 50, 100, 150, 200)


def horizon_cell(settings: Cell, stream: Stream) -> list[Row]:
    """10 x 10 grid, slip 0.3 simulated, 0.1 real. The exact standard deviation of one product-weighted return of the
    simulator with the true zeta (no estimation error), by dynamic programming; the mean |error| over the seeds of the
    exact value with zeta from 3162 moves of the uniform policy; the simulator's error.
    """
    delta, n = float(settings["delta"]), 3162
    simulator, target = grids()
    policy = gridworld_policy(10, delta)
    log = drawn(target, uniform_policy(target), n, stream.generator())
    truth = true_ratio(target, simulator)
    rows = []
    for steps in HORIZONS:
        spread = {}
        for kind in ("per_decision", "trajectory"):
            moments = weighted_return_moments(simulator, truth, policy, kind=kind, horizon=steps)
            spread[f"oracle sd, {kind.replace('_', ' ')}"] = float(np.sqrt(moments.variance))
        value = OffEnvironment()(Problem(simulator, log, horizon=steps), policy).value
        simulated, real = (policy_value(mdp, policy, horizon=steps) for mdp in (simulator, target))
        spread |= {"OEE exact, |error|": abs(value - real), "simulator, |error|": abs(simulated - real)}
        rows += [{"horizon": steps, "quantity": name, "size": SCALE * size} for name, size in spread.items()]
    return rows


def horizon_finding(table: pd.DataFrame) -> str:
    """By how much a product's spread grows, and the largest error of the exact value."""
    sizes = table.groupby(["quantity", "delta", "horizon"])["size"].mean()
    growth = (
        sizes["oracle sd, per decision"]
        .groupby("delta")
        .agg(lambda by_horizon: by_horizon.iloc[-1] / by_horizon.iloc[0])
    )
    return (
        f"{span(table.rename(columns={'horizon': 'T'}), 'T')} the sd of a per-decision product grows {reach(growth)} times; "
        f"exact OEE's error is at most {number(sizes['OEE exact, |error|'].max())}"
    )


HORIZON_EXPERIMENT = Experiment(
    id="horizon",
    title="Products of ratios explode with the horizon; exact evaluation does not",
    axes={"delta": DELTAS},
    smoke={"delta": (0.5,)},
    run=horizon_cell,
    keys=("delta", "horizon", "quantity"),
    measures=("size",),
    draw=Panels(
        "size",
        "quantity",
        "horizon",
        ("delta",),
        log=True,
        xlabel="horizon T (rewards)",
        ylabel="size, times (1 - discount)",
    ),
    finding=horizon_finding,
)


CURVES = {  # and their names in ``oee evaluate``
    "simulator": "simulator",
    "OEE, exact": "oee",
    "model-based": "model-based",
    "PDIS": "pdis",
    "WIS, per decision": "wpdis",
}


def behaviour_cell(settings: Cell, stream: Stream) -> list[Row]:
    """10 x 10 grid, T = 200; 3162 moves of pi_b in the real grid (whole episodes for importance sampling, with the
    true behaviour probabilities). Means over the seeds, and the exact standard deviation of PDIS by dynamic
    programming. distance in the table: the total variation between the two policies, averaged over the evaluated
    policy's time.
    """
    behavior_delta, delta = float(settings["behavior_delta"]), float(settings["delta"])
    simulator, target = grids()
    behavior, policy = gridworld_policy(10, behavior_delta), gridworld_policy(10, delta)
    generator = stream.generator()
    pool = episodes_for(target, behavior, 3162, generator)
    problem = Problem(simulator, pool.first(3162), horizon=HORIZON, behavior_policy=behavior, episodes=pool)
    truth = policy_value(target, policy, horizon=HORIZON)
    time = occupancy(target, policy, horizon=HORIZON).sum(axis=1)
    distance = float(time @ (0.5 * np.abs(behavior - policy).sum(axis=1)))
    moments = policy_is_moments(target, behavior, policy, horizon=HORIZON)
    episodes = pool.summary()["episodes"]
    rows = []
    for name, estimate in estimators_of(CURVES).items():
        found = estimate(problem, policy)
        rows.append({"distance": distance, "estimator": name, "error": abs(SCALE * (found.value - truth)),
                     "effective_sample_size": found.diagnostics.get("effective_sample_size", np.nan),
                     "pdis_exact_sd": SCALE * float(np.sqrt(moments.variance / episodes)), "episodes": episodes})  # fmt: skip
    return rows


def mark_evaluated(ax: Axes, rows: pd.DataFrame) -> None:
    """Where the policy that recorded the log is the one that is evaluated."""
    ax.axvline(rows.delta.iloc[0], color="grey", lw=0.8, ls=":")


def behaviour_finding(table: pd.DataFrame) -> str:
    """PDIS where the log's policy is nearest to the evaluated one and where it is farthest; OEE at its worst."""
    means = table.groupby(["estimator", "delta", "distance"]).error.mean()
    near, far = (means["PDIS"].groupby("delta").nth(k).mean() for k in (0, -1))
    return (
        f"PDIS errs by {number(near)} from logs of the policy nearest to the evaluated one, by {number(far)} of the "
        f"farthest; exact OEE by at most {number(means['OEE, exact'].max())}"
    )


DATA_POLICY = Experiment(
    id="data_policy",
    title="Importance sampling is good only near the policy that made the data",
    axes={"delta": (0.5, 0.9), "behavior_delta": (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)},
    smoke={"delta": (0.5,), "behavior_delta": (0.0, 0.5)},
    run=behaviour_cell,
    keys=("delta", "behavior_delta", "distance", "estimator"),
    measures=("error", "effective_sample_size", "pdis_exact_sd"),
    draw=Panels(
        "error",
        "estimator",
        "behavior_delta",
        by=("delta",),
        title="evaluated: delta = {delta:g}",
        xlabel="delta of the policy that recorded the log",
        ylabel=MEAN_ERROR,
        extra={"PDIS: exact sd": "pdis_exact_sd"},
        log=True,
        beneath=mark_evaluated,
        axes={"ylim": (1e-3, 1e3)},
        size=(5.6, 4.2),
    ),
    finding=behaviour_finding,
)

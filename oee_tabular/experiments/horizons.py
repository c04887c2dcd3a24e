"""What importance sampling costs: products over the horizon, and data policies far from the one evaluated."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from oee_tabular.estimators import Estimator, ImportanceSampling, ModelBased, OffEnvironment, Problem, Simulator
from oee_tabular.exact import occupancy, policy_is_moments, policy_value, weighted_return_moments
from oee_tabular.experiments.common import HORIZON, episodes_for, grids, panels, series_of
from oee_tabular.experiments.registry import Cell, Experiment, Row, Stream
from oee_tabular.mdp import uniform_policy
from oee_tabular.ratio import true_ratio
from oee_tabular.tasks import gridworld_policy

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

HORIZONS = (1, 2, 5, 10, 20, 50, 100, 150, 200)
SCALE = 0.01


def horizon_cell(settings: Cell, stream: Stream) -> list[Row]:
    """Exact standard deviations of one product with the true zeta; the error of the exact value with a log's."""
    delta, n = float(settings["delta"]), 3162
    simulator, target = grids(10)
    policy = gridworld_policy(10, delta)
    generator = stream.generator()
    log = episodes_for(target, uniform_policy(target), n, generator).draw(n, seed=generator)
    truth = true_ratio(target, simulator)
    rows = []
    for steps in HORIZONS:
        spread = {}
        for kind in ("per_decision", "trajectory"):
            moments = weighted_return_moments(simulator, truth, policy, kind=kind, horizon=steps)
            spread[f"oracle sd, {kind.replace('_', ' ')}"] = float(np.sqrt(moments.variance))
        value = OffEnvironment()(Problem(simulator, log, horizon=steps), policy).value
        spread["OEE exact, |error|"] = abs(value - policy_value(target, policy, horizon=steps))
        spread["simulator, |error|"] = abs(
            policy_value(simulator, policy, horizon=steps) - policy_value(target, policy, horizon=steps)
        )
        rows += [{"horizon": steps, "quantity": name, "size": SCALE * size} for name, size in spread.items()]
    return rows


def draw_horizon(table: pd.DataFrame, summary: pd.DataFrame, figure: Figure) -> None:
    """A panel for each policy, logarithmic."""
    from oee_tabular.plots import plot_curves

    deltas = sorted(table.delta.unique())
    for ax, delta in zip(panels(figure, [f"delta = {delta:g}" for delta in deltas]), deltas, strict=True):
        part = table[table.delta == delta]
        where = sorted(part.horizon.unique())
        plot_curves(where, series_of(part, "quantity", "horizon", "size", where), ax,
                    xlabel="horizon T (rewards)", ylabel="size, times (1 - discount)")  # fmt: skip
        ax.set_yscale("log")


HORIZON_EXPERIMENT = Experiment(
    id="horizon",
    title="Products of ratios explode with the horizon; exact evaluation does not",
    axes={"delta": (0.1, 0.5, 0.9)},
    smoke={"delta": (0.5,)},
    run=horizon_cell,
    keys=("delta", "horizon", "quantity"),
    measures=("size",),
    draw=draw_horizon,
    caption=(
        "10 x 10 grid, slip 0.3 simulated, 0.1 real. The exact standard deviation of one product-weighted return of the"
        " simulator with the true zeta (no estimation error), by dynamic programming; the mean |error| over the seeds "
        "of the exact value with zeta from 3162 moves of the uniform policy; the simulator's error."
    ),
)


def behaviour_cell(settings: Cell, stream: Stream) -> list[Row]:
    """A log of 50 episodes under pi_b; policies delta = 0.5 by all estimators."""
    behavior_delta, delta = float(settings["behavior_delta"]), float(settings["delta"])
    simulator, target = grids(10)
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
    estimators: dict[str, Estimator] = {
        "simulator": Simulator(),
        "OEE, exact": OffEnvironment(),
        "model-based": ModelBased(),
        "PDIS": ImportanceSampling(),
        "WIS, per decision": ImportanceSampling(self_normalized=True),
    }
    for name, estimate in estimators.items():
        found = estimate(problem, policy)
        rows.append({"distance": distance, "estimator": name, "error": abs(SCALE * (found.value - truth)),
                     "effective_sample_size": found.diagnostics.get("effective_sample_size", np.nan),
                     "pdis_exact_sd": SCALE * float(np.sqrt(moments.variance / episodes)), "episodes": episodes})  # fmt: skip
    return rows


def draw_behaviour(table: pd.DataFrame, summary: pd.DataFrame, figure: Figure) -> None:
    """Error against the distance between the policies."""
    from oee_tabular.plots import plot_curves

    deltas = sorted(table.delta.unique())
    axes = panels(figure, [f"evaluated: delta = {delta:g}" for delta in deltas], size=(5.6, 4.2))
    for ax, delta in zip(axes, deltas, strict=True):
        part = table[table.delta == delta]
        where = sorted(part.behavior_delta.unique())
        curves = series_of(part, "estimator", "behavior_delta", "error", where)
        curves["PDIS: exact sd"] = part.groupby("behavior_delta").pdis_exact_sd.mean().reindex(where).to_numpy()
        plot_curves(where, curves, ax, xlabel="delta of the policy that recorded the log",
                    ylabel="mean |error| of the value times (1 - discount)")  # fmt: skip
        ax.set_yscale("log")
        ax.axvline(delta, color="grey", lw=0.8, ls=":")
        ax.set_ylim(1e-3, 1e3)


DATA_POLICY = Experiment(
    id="data_policy",
    title="Importance sampling is good only near the policy that made the data",
    axes={"delta": (0.5, 0.9), "behavior_delta": (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)},
    smoke={"delta": (0.5,), "behavior_delta": (0.0, 0.5)},
    run=behaviour_cell,
    keys=("delta", "behavior_delta", "distance", "estimator"),
    measures=("error", "effective_sample_size", "pdis_exact_sd"),
    draw=draw_behaviour,
    caption=(
        "10 x 10 grid, T = 200; 3162 moves of pi_b in the real grid (whole episodes for importance sampling, with the "
        "true behaviour probabilities). Means over the seeds, and the exact standard deviation of PDIS by dynamic "
        "programming. distance in the table: the total variation between the two policies, averaged over the evaluated "
        "policy's time."
    ),
)

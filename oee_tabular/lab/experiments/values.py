"""fig1bcd: the value of three policies by every estimator; and what products, horizons and data policies do to it.

On the paper's grid: slip 0.3 simulated, 0.1 real, T = 200, one reward r(s, a, s') everywhere.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from oee_tabular._checks import Array
from oee_tabular._sparse import csr_on_pattern
from oee_tabular.estimators import OffEnvironment, Oracle, Problem
from oee_tabular.exact import occupancy, policy_is_moments, policy_value, weighted_return_moments
from oee_tabular.lab.experiments.common import (
    DELTAS,
    HORIZON,
    MEAN_ERROR,
    SCALE,
    estimators_of,
    grids,
    sample_log,
    sample_pool,
)
from oee_tabular.lab.findings import listed, rank
from oee_tabular.lab.panels import Beside, Errors, Panels
from oee_tabular.lab.registry import Cell, Experiment, Row, Stream
from oee_tabular.mdp import FiniteMDP, uniform_policy
from oee_tabular.ratio import true_ratio
from oee_tabular.tasks import gridworld, gridworld_policy

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

# ---- fig1bcd -----------------------------------------------------------------------------------------------------------

N_ROLLOUTS = 100  # of the products
BY_MODEL = {  # curves, and their names in ``oee evaluate``
    "simulator": "simulator", "OEE, exact": "oee", "OEE, product": "oee-product", "oracle, exact": "oracle",
    "oracle, product": "oracle-product", "model-based": "model-based",
}  # fmt: skip
BY_POLICY = {
    "IS": "is", "PDIS": "pdis", "WIS": "wis", "doubly robust": "dr", "marginalised": "marginalized",
}  # fmt: skip


def values_cell(settings: Cell, stream: Stream) -> list[Row]:
    """The paper's 10 x 10 grid; a log of n transitions of the uniform policy. Left: means and the range over the seeds
    at the largest n of at most 3162; right: mean error over delta. Above: by models and ratios of dynamics; below: by
    ratios of policies, with the whole episodes behind the log and the true behaviour policy. Products are means of 100
    rollouts; exact_sd in table.csv is their exact standard deviation.
    """
    n = int(settings["n"])
    simulator, target = grids()
    generator = stream.generator()
    behavior = uniform_policy(target)
    pool = sample_pool(target, behavior, n, generator)
    problem = Problem(simulator, pool.draw(n, seed=generator), horizon=HORIZON, behavior_policy=behavior, episodes=pool)
    rollouts = stream.generator(use="rollouts")
    facts: dict[str, Row] = {name: {"episodes": pool.summary()["episodes"]} for name in ("IS", "PDIS", "WIS")}
    rows = []
    for delta in DELTAS:
        policy = gridworld_policy(10, delta)
        truth = SCALE * policy_value(target, policy, horizon=HORIZON)
        fitted = OffEnvironment().fit(problem, policy, generator)
        for name, zeta in (("OEE, product", fitted), ("oracle, product", true_ratio(target, simulator))):
            moments = weighted_return_moments(simulator, zeta, policy, horizon=HORIZON)
            facts[name] = {"exact_sd": SCALE * float(np.sqrt(moments.variance / N_ROLLOUTS))}
        for name, estimate in estimators_of(BY_MODEL | BY_POLICY, target).items():
            value = SCALE * estimate(problem, policy, seed=rollouts).value
            row = {"delta": delta, "estimator": name, "value": value, "truth": truth, "error": abs(value - truth)}
            rows.append(row | facts.get(name, {}))
    return rows


def _pair_of_panels(names: tuple[str, ...], title: str) -> list[Panels]:
    """Values of these estimators over delta at one n, and their errors over n."""

    def at_one_size(table: pd.DataFrame) -> pd.DataFrame:
        size = table.n[table.n <= 3162].max()  # the paper's n
        rows: pd.DataFrame = table[table.estimator.isin(names) & (table.n == size)]
        return rows

    values = Panels(
        "value", "estimator", "delta", title=f"{title}: values at the paper's n", only=at_one_size, bands=True,
        extra={"true value": "truth"}, axes={"ylim": (-2.5, 0.1)}, size=(6.4, 4.2),
        xlabel="delta: the policy is delta expert + (1 - delta) uniform", ylabel="value times (1 - discount)",
    )  # fmt: skip
    errors = Errors(
        "error", "estimator", title=f"{title}: errors", only=lambda table: table[table.estimator.isin(names)],
        slope=None, ylabel=MEAN_ERROR,
    )  # fmt: skip
    return [values, errors]


FIGURE_1BCD = Experiment(
    "fig1bcd", "Figure 1b, c, d: the value of three policies in the real grid",
    axes={"n": (1000, 3162, 10_000, 31_623)}, smoke={"n": (3162,)},
    run=values_cell, keys=("n", "delta", "estimator"), measures=("error", "value"),
    finding=rank("Mean error", "error", "estimator", names=("simulator", "OEE, exact", "WIS")),
    draw=Beside(
        [
            *_pair_of_panels(tuple(BY_MODEL), "Ratios of dynamics"),
            *_pair_of_panels(("OEE, exact", *BY_POLICY), "Ratios of policies"),
        ], columns=2, size=(6.4, 4.2),
    ),
)  # fmt: skip

# ---- estimands: the published recipe ---------------------------------------------------------------------------------

TRUE = "true, r(s_t+1)"


def short_weight_value(simulator: FiniteMDP, target: FiniteMDP, policy: Array) -> float:
    """sum_t gamma^t E[r(s_{t+1})], s_t the target's, the last step the simulator's: a weight one step too short."""
    time = occupancy(target, policy, horizon=HORIZON)
    return float(sum(simulator.discount**t for t in range(HORIZON)) * np.sum(time * simulator.rewards))


def with_next_rewards_averaged(simulator: FiniteMDP) -> FiniteMDP:
    """The same MDP with rewards r(s, a) = sum_s' P r(s, a, s'): a product then weighs r_t without the last ratio."""
    transitions = csr_on_pattern(simulator.transitions, simulator.transitions.data)
    names = {name: getattr(simulator, name) for name in ("layout", "state_names", "action_names")}
    return FiniteMDP(transitions, simulator.rewards, simulator.initial, simulator.discount, **names)


def estimands_cell(settings: Cell, stream: Stream) -> list[Row]:
    """What is estimated, with the exact zeta and no estimation error at all. The published code's true curve has rewards
    r(s_t+1), its OEE r(s_t), and its oracle r(s_t+1) with a weight that lacks the last step, self-normalised over 100 rollouts.
    That OEE beats the oracle there is no merit of an estimate. The first two are exact, the last is the mean over the seeds.
    """
    simulator, target = grids()
    policy = gridworld_policy(10, float(settings["delta"]))
    truth = policy_value(target, policy, horizon=HORIZON)
    oracle = Oracle(target, evaluation="monte_carlo", self_normalized=True, n_rollouts=N_ROLLOUTS)
    log = sample_pool(target, uniform_policy(target), 100, stream.generator()).draw(100, seed=0)
    shifted = Problem(with_next_rewards_averaged(simulator), log, horizon=HORIZON)
    values = {
        TRUE: truth,
        "OEE's, r(s_t)": policy_value(gridworld(10, 0.1, pay="current"), policy, horizon=HORIZON),
        "oracle's, one move short": short_weight_value(simulator, target, policy),
        "the same, 100 rollouts": oracle(shifted, policy, seed=stream.generator(use="rollouts")).value,
    }
    return [
        {"quantity": name, "value": SCALE * value, "distance": SCALE * abs(value - truth)}
        for name, value in values.items()
    ]


def estimands_finding(table: pd.DataFrame) -> str:
    """How far from the true curve each of the others is, on average over delta."""
    mean = table[table.quantity != TRUE].groupby("quantity", sort=False).distance.mean()
    return f"Distance: {listed(mean)}"


ESTIMANDS = Experiment(
    "estimands", "The published recipe compares three different quantities",
    axes={"delta": tuple(round(0.1 * k, 1) for k in range(1, 10))}, smoke={"delta": DELTAS},
    run=estimands_cell, keys=("delta", "quantity"), measures=("value", "distance"), finding=estimands_finding,
    draw=Panels(
        "distance", "quantity", "delta", title="how far from the true curve", xlabel="delta",
        ylabel="|value - true value| times (1 - discount)", only=lambda table: table[table.quantity != TRUE], size=(6.4, 4.4),
    ),
)  # fmt: skip

# ---- horizon -----------------------------------------------------------------------------------------------------------

HORIZONS = (1, 2, 5, 10, 20, 50, 100, 150, 200)


def horizon_cell(settings: Cell, stream: Stream) -> list[Row]:
    """The paper's 10 x 10 grid. The exact standard deviation of one product-weighted return of the simulator with the
    true zeta (no estimation error), by dynamic programming; the mean |error| over the seeds of the exact value with
    zeta from 3162 transitions of the uniform policy; the simulator's error.
    """
    simulator, target = grids()
    policy = gridworld_policy(10, float(settings["delta"]))
    log = sample_log(target, uniform_policy(target), 3162, stream.generator())
    truth = true_ratio(target, simulator)
    rows = []
    for horizon in HORIZONS:
        sizes = {}
        for kind in ("per_decision", "trajectory"):
            moments = weighted_return_moments(simulator, truth, policy, kind=kind, horizon=horizon)
            sizes[f"oracle sd, {kind.replace('_', ' ')}"] = float(np.sqrt(moments.variance))
        value = OffEnvironment()(Problem(simulator, log, horizon=horizon), policy).value
        simulated, real = (policy_value(mdp, policy, horizon=horizon) for mdp in (simulator, target))
        sizes |= {"OEE exact, |error|": abs(value - real), "simulator, |error|": abs(simulated - real)}
        rows += [{"horizon": horizon, "quantity": name, "size": SCALE * size} for name, size in sizes.items()]
    return rows


HORIZON_EXPERIMENT = Experiment(
    "horizon", "Products of ratios explode with the horizon; exact evaluation does not",
    axes={"delta": DELTAS}, smoke={"delta": (0.5,)},
    run=horizon_cell, keys=("delta", "horizon", "quantity"), measures=("size",),
    finding=rank("Mean over delta", "size", "quantity", "horizon"),
    draw=Panels(
        "size", "quantity", "horizon", ("delta",), log=True, xlabel="horizon T (rewards)",
        ylabel="size, times (1 - discount)",
    ),
)  # fmt: skip

# ---- data_policy -------------------------------------------------------------------------------------------------------

CURVES = {
    "simulator": "simulator", "OEE, exact": "oee", "model-based": "model-based", "PDIS": "pdis",
    "WIS, per decision": "wpdis",
}  # fmt: skip


def data_policy_cell(settings: Cell, stream: Stream) -> list[Row]:
    """The paper's 10 x 10 grid; 3162 transitions of pi_b in the real grid (whole episodes for importance sampling, with
    the true behaviour probabilities). Means over the seeds, and the exact standard deviation of PDIS. distance in the
    table: the total variation between the two policies, averaged over the evaluated policy's time. Dotted: where they
    are the same.
    """
    simulator, target = grids()
    behavior, policy = (gridworld_policy(10, float(settings[name])) for name in ("behavior_delta", "delta"))
    pool = sample_pool(target, behavior, 3162, stream.generator())
    problem = Problem(simulator, pool.first(3162), horizon=HORIZON, behavior_policy=behavior, episodes=pool)
    truth = policy_value(target, policy, horizon=HORIZON)
    time = occupancy(target, policy, horizon=HORIZON).sum(axis=1)
    moments = policy_is_moments(target, behavior, policy, horizon=HORIZON)
    episodes = pool.summary()["episodes"]
    facts = {"pdis_exact_sd": SCALE * float(np.sqrt(moments.variance / episodes)), "episodes": episodes}
    distance = float(time @ (0.5 * np.abs(behavior - policy).sum(axis=1)))
    rows = []
    for name, estimate in estimators_of(CURVES).items():
        result = estimate(problem, policy)
        size = result.diagnostics.get("effective_sample_size", np.nan)
        rows.append({"distance": distance, "estimator": name, "error": abs(SCALE * (result.value - truth)),
                     "effective_sample_size": size, **facts})  # fmt: skip
    return rows


def mark_evaluated(ax: Axes, rows: pd.DataFrame) -> None:
    """Where the policy that recorded the log is the one that is evaluated."""
    ax.axvline(rows.delta.iloc[0], color="grey", lw=0.8, ls=":")


DATA_POLICY = Experiment(
    "data_policy", "Importance sampling is good only near the policy that made the data",
    axes={"delta": (0.5, 0.9), "behavior_delta": (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)},
    smoke={"delta": (0.5,), "behavior_delta": (0.0, 0.5)},
    run=data_policy_cell, keys=("delta", "behavior_delta", "distance", "estimator"),
    measures=("error", "effective_sample_size", "pdis_exact_sd"),
    finding=rank("Mean error", "error", "estimator", "behavior_delta"),
    draw=Panels(
        "error", "estimator", "behavior_delta", by=("delta",), title="evaluated: delta = {delta:g}",
        xlabel="delta of the policy that recorded the log", ylabel=MEAN_ERROR, extra={"PDIS: exact sd": "pdis_exact_sd"},
        log=True, beneath=mark_evaluated, axes={"ylim": (1e-3, 1e3)}, size=(5.6, 4.2),
    ),
)  # fmt: skip

"""fig1bcd: the value of three policies by every estimator; and what products, horizons and data policies do to it.

On the paper's grid: slip 0.3 simulated, 0.1 real, T = 200, one reward r(s, a, s') everywhere.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

import oee_tabular as oee
from oee_tabular._sparse import csr_on_pattern
from oee_tabular.estimators import OffEnvironment, Oracle
from oee_tabular.estimators.names import NAMED
from oee_tabular.lab.experiments.common import DELTAS, HORIZON, MEAN_ERROR, SCALE, grids, sample_log, sample_pool
from oee_tabular.lab.panels import Panels, listed
from oee_tabular.lab.registry import Cell, Row, Stream, experiment
from oee_tabular.tasks import gridworld, gridworld_policy

N_ROLLOUTS = 100  # of the products
BY_MODEL = {  # curves, and their names in ``oee evaluate``
    "simulator": "simulator", "OEE, exact": "oee", "OEE, product": "oee-product", "oracle, exact": "oracle",
    "oracle, product": "oracle-product", "model-based": "model-based",
}  # fmt: skip
BY_POLICY = {
    "IS": "is", "PDIS": "pdis", "WIS": "wis", "doubly robust": "dr", "marginalised": "marginalized",
}  # fmt: skip


def plot_group(names: list[str], title: str, **options: Any) -> Panels:
    """The errors of these estimators over n, and their values over delta at the paper's n."""

    def choose(table: pd.DataFrame) -> pd.DataFrame:
        return table[table.estimator.isin(names)]

    def choose_n(table: pd.DataFrame) -> pd.DataFrame:
        own = choose(table[table.n <= 3162])
        largest: pd.DataFrame = own[own.n == own.n.max()]
        return largest

    values = Panels(
        "value", "estimator", "delta", title=f"{title}: values at the paper's n", only=choose_n, bands=True,
        xlabel="delta: the policy is delta expert + (1 - delta) uniform", ylabel="(1 - discount) J",
        extra={"true value": "truth"}, axes={"ylim": (-2.5, 0.1)},
    )  # fmt: skip
    beside = [values, *options.pop("beside", ())]
    return Panels(
        "error",
        "estimator",
        title=f"{title}: errors",
        only=choose,
        log=True,
        axes={"xscale": "log"},
        ylabel=MEAN_ERROR,
        beside=beside,
        **options,
    )


BELOW = plot_group(["OEE, exact", *BY_POLICY], "Ratios of policies")


@experiment(
    "Figure 1b, c, d: the value of three policies in the real grid", axes={"n": (1000, 3162, 10_000, 31_623)},
    keys=("n", "delta", "estimator"), measures=("error", "value"),
    draw=plot_group([*BY_MODEL], "Ratios of dynamics", beside=[BELOW, *BELOW.beside], columns=2, size=(6.4, 4.2)),
)  # fmt: skip
def fig1bcd(settings: Cell, stream: Stream) -> list[Row]:
    """10 x 10 grid; a log of n transitions of the uniform policy. Means over the seeds, values with their range. Above: ratios
    of dynamics; below: ratios of policies, with the whole episodes behind the log and the true behaviour policy. Products are
    means of 100 rollouts; exact_sd in table.csv is their exact standard deviation.
    """
    n, generator, rollouts = settings["n"], stream.generator(), stream.generator(use="rollouts")
    simulator, target = grids()
    behavior = oee.uniform_policy(target)
    pool = sample_pool(target, behavior, n, generator)
    log = pool.draw(n, seed=generator)
    problem = oee.Problem(simulator, log, horizon=HORIZON, behavior_policy=behavior, episodes=pool)
    facts: dict[str, Row] = {name: {"episodes": pool.summary()["episodes"]} for name in ("IS", "PDIS", "WIS")}
    rows = []
    for delta in DELTAS:
        policy = gridworld_policy(10, delta)
        truth = SCALE * oee.policy_value(target, policy, horizon=HORIZON)
        fitted = OffEnvironment().fit(problem, policy, generator)
        for name, zeta in (("OEE, product", fitted), ("oracle, product", oee.true_ratio(target, simulator))):
            moments = oee.weighted_return_moments(simulator, zeta, policy, horizon=HORIZON)
            facts[name] = {"exact_sd": SCALE * float(np.sqrt(moments.variance / N_ROLLOUTS))}
        for name, kind in (BY_MODEL | BY_POLICY).items():
            value = SCALE * NAMED[kind](target)(problem, policy, seed=rollouts).value
            row = {"delta": delta, "estimator": name, "value": value, "truth": truth, "error": abs(value - truth)}
            rows.append(row | facts.get(name, {}))
    return rows


TRUE = "true, r(s_t+1)"


def with_next_rewards_averaged(simulator: oee.FiniteMDP) -> oee.FiniteMDP:
    """The same MDP with rewards r(s, a) = sum_s' P r(s, a, s'): a product then weighs r_t without the last ratio."""
    transitions = csr_on_pattern(simulator.transitions, simulator.transitions.data)
    names = {name: getattr(simulator, name) for name in ("layout", "state_names", "action_names")}
    return oee.FiniteMDP(transitions, simulator.rewards, simulator.initial, simulator.discount, **names)


def drop_truth(table: pd.DataFrame) -> pd.DataFrame:
    """The rows of the quantities that are not the true one."""
    return table[table.quantity != TRUE]


@experiment(
    "The published recipe compares three different quantities",
    axes={"delta": tuple(round(0.1 * k, 1) for k in range(1, 10))},
    keys=("delta", "quantity"), measures=("value", "distance"),
    finding=lambda table: f"Distance: {listed(drop_truth(table).groupby('quantity', sort=False).distance.mean())}",
    draw=Panels(
        "distance", "quantity", "delta", xlabel="delta", ylabel="|value - true value| times (1 - discount)", only=drop_truth,
        size=(6.4, 4.4),
    ),
)  # fmt: skip
def estimands(settings: Cell, stream: Stream) -> list[Row]:
    """What is estimated, with the exact zeta and no estimation error at all. The published code's true curve has rewards
    r(s_t+1), its OEE r(s_t), and its oracle r(s_t+1) with a weight that lacks the last step, self-normalised over 100 rollouts.
    That OEE beats the oracle there is no merit of an estimate.
    """
    simulator, target = grids()
    policy = gridworld_policy(10, settings["delta"])
    truth = oee.policy_value(target, policy, horizon=HORIZON)
    oracle = Oracle(target, evaluation="monte_carlo", self_normalized=True, n_rollouts=N_ROLLOUTS)
    log = sample_pool(target, oee.uniform_policy(target), 100, stream.generator()).draw(100, seed=0)
    shifted = oee.Problem(with_next_rewards_averaged(simulator), log, horizon=HORIZON)
    # sum_t gamma^t E[r(s_{t+1})], s_t the target's, the last step the simulator's: a weight one step too short
    time = oee.occupancy(target, policy, horizon=HORIZON)
    short = float(sum(simulator.discount**t for t in range(HORIZON)) * np.sum(time * simulator.rewards))
    values = {
        TRUE: truth,
        "OEE's, r(s_t)": oee.policy_value(gridworld(10, 0.1, pay="current"), policy, horizon=HORIZON),
        "oracle's, one move short": short,
        "the same, 100 rollouts": oracle(shifted, policy, seed=stream.generator(use="rollouts")).value,
    }
    return [
        {"quantity": name, "value": SCALE * value, "distance": SCALE * abs(value - truth)}
        for name, value in values.items()
    ]


@experiment(
    "Products of ratios explode with the horizon; exact evaluation does not",
    axes={"delta": DELTAS}, keys=("delta", "horizon", "quantity"), measures=("size",),
    draw=Panels(
        "size", "quantity", "horizon", by=("delta",), log=True, xlabel="horizon T (rewards)", ylabel="(1 - discount) size"
    ),
)  # fmt: skip
def horizon(settings: Cell, stream: Stream) -> list[Row]:
    """10 x 10 grid. The exact standard deviation of one product-weighted return of the simulator with the true zeta; the mean
    |error| of the exact value with zeta from 3162 transitions of the uniform policy; the simulator's error.
    """
    simulator, target = grids()
    policy = gridworld_policy(10, settings["delta"])
    log = sample_log(target, 0.0, 3162, stream.generator())
    zeta = oee.true_ratio(target, simulator)
    rows = []
    for steps in (1, 2, 5, 10, 20, 50, 100, 150, 200):
        sizes = {}
        for kind in ("per_decision", "trajectory"):
            moments = oee.weighted_return_moments(simulator, zeta, policy, kind=kind, horizon=steps)
            sizes[f"oracle sd, {kind.replace('_', ' ')}"] = float(np.sqrt(moments.variance))
        value = OffEnvironment()(oee.Problem(simulator, log, horizon=steps), policy).value
        simulated, real = (oee.policy_value(mdp, policy, horizon=steps) for mdp in (simulator, target))
        sizes |= {"OEE exact, |error|": abs(value - real), "simulator, |error|": abs(simulated - real)}
        rows += [{"horizon": steps, "quantity": name, "size": SCALE * size} for name, size in sizes.items()]
    return rows


CURVES = {
    "simulator": "simulator", "OEE, exact": "oee", "model-based": "model-based", "PDIS": "pdis",
    "WIS, per decision": "wpdis",
}  # fmt: skip


@experiment(
    "Importance sampling is good only near the policy that made the data",
    axes={"delta": (0.5, 0.9), "behavior_delta": (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)},
    keys=("delta", "behavior_delta", "distance", "estimator"),
    measures=("error", "effective_sample_size", "pdis_exact_sd"),
    draw=Panels(
        "error", "estimator", "behavior_delta", by=("delta",), xlabel="delta of the policy that recorded the log",
        ylabel=MEAN_ERROR, extra={"PDIS: exact sd": "pdis_exact_sd"}, log=True, axes={"ylim": (1e-3, 1e3)},
        beneath=lambda ax, rows: ax.axvline(rows.delta.iloc[0], color="grey", lw=0.8, ls=":"),  # the same policy
    ),
)  # fmt: skip
def data_policy(settings: Cell, stream: Stream) -> list[Row]:
    """10 x 10 grid; 3162 transitions of pi_b (whole episodes for importance sampling, with the true behaviour policy). distance
    in the table: the total variation between the two policies, averaged over the evaluated policy's time. Dotted: the same.
    """
    simulator, target = grids()
    behavior, policy = (gridworld_policy(10, settings[name]) for name in ("behavior_delta", "delta"))
    pool = sample_pool(target, behavior, 3162, stream.generator())
    problem = oee.Problem(simulator, pool.first(3162), horizon=HORIZON, behavior_policy=behavior, episodes=pool)
    truth = oee.policy_value(target, policy, horizon=HORIZON)
    time = oee.occupancy(target, policy, horizon=HORIZON).sum(axis=1)
    distance = float(time @ (0.5 * np.abs(behavior - policy).sum(axis=1)))
    episodes = pool.summary()["episodes"]
    variance = oee.policy_is_moments(target, behavior, policy, horizon=HORIZON).variance / episodes
    facts = {"pdis_exact_sd": SCALE * float(np.sqrt(variance)), "episodes": episodes}
    rows = []
    for name, kind in CURVES.items():
        result = NAMED[kind]()(problem, policy)
        size = result.diagnostics.get("effective_sample_size", np.nan)
        error = {"error": abs(SCALE * (result.value - truth)), "effective_sample_size": size}
        rows.append({"distance": distance, "estimator": name, **error, **facts})
    return rows

"""Experiments on the value of policies by every estimator, on grids and toy text.

They also show what products, horizons and data policies do to it. On the paper's grid
(fig1bcd, estimands, horizon, data_policy): slip 0.3 simulated, 0.1 real, T = 200, one
reward r(s, a, s') everywhere. On Gymnasium's toy text: FrozenLake, Taxi in the rain and
with faults, CliffWalking; five policies, valued and ranked.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

import oee_tabular as oee
from oee_tabular._sparse import csr_on_pattern
from oee_tabular.estimators import OffEnvironment, Oracle
from oee_tabular.estimators.names import NAMED
from oee_tabular.lab.experiment import (
    Cell,
    Experiment,
    Panels,
    Row,
    Stream,
    experiment,
    listed,
)
from oee_tabular.lab.experiments import common
from oee_tabular.lab.experiments.common import (
    DELTAS,
    HORIZON,
    SCALE,
    grids,
    sample_log,
    sample_pool,
)
from oee_tabular.tasks import gridworld, gridworld_policy, named_task
from oee_tabular.typing import Array

N_ROLLOUTS = 100  # of the products
ESTIMATORS = {  # curves, and their names in ``oee evaluate``
    "simulator": "simulator",
    "OEE, exact": "oee",
    "OEE, product": "oee-product",
    "oracle, exact": "oracle",
    "oracle, product": "oracle-product",
    "model-based": "model-based",
    "IS": "is",
    "PDIS": "pdis",
    "WIS": "wis",
    "doubly robust": "dr",
    "marginalised": "marginalized",
    "WIS, per decision": "wpdis",
}
# estimators that use ratios of dynamics, and those that use ratios of policies
BY_MODEL = [*ESTIMATORS][:6]
BY_POLICY = [*ESTIMATORS][6:11]


def plot_group(names: list[str], title: str, **options: Any) -> Panels:
    """Return panels of the errors of these estimators over n, and of their values.

    The values are over delta at the paper's n.
    """

    def choose(table: pd.DataFrame) -> pd.DataFrame:
        """Return the rows of these estimators."""
        return table[table.estimator.isin(names)]

    def choose_n(table: pd.DataFrame) -> pd.DataFrame:
        """Return their rows at the paper's n."""
        return choose(table[table.n == table.n[table.n <= 3162].max()])

    values = Panels(
        "value",
        "estimator",
        "delta",
        title=f"{title}: values at the paper's n",
        only=choose_n,
        bands=True,
        xlabel="delta: the policy is delta expert + (1 - delta) uniform",
        ylabel="(1 - discount) J",
        extra={"true value": "truth"},
        axes={"ylim": (-2.5, 0.1)},
    )
    errors: dict[str, Any] = {
        "log": True,
        "axes": {"xscale": "log"},
        "ylabel": common.MEAN_ERROR,
        "only": choose,
    }
    beside = [values, *options.pop("beside", ())]
    return Panels(
        "error",
        "estimator",
        title=f"{title}: errors",
        beside=beside,
        **errors,
        **options,
    )


BELOW = plot_group(["OEE, exact", *BY_POLICY], "Ratios of policies")


@experiment(
    "Figure 1b, c, d: the value of three policies in the real grid",
    axes={"n": (1000, 3162, 10_000, 31_623)},
    keys=("n", "delta", "estimator"),
    measures=("error", "value"),
    draw=plot_group(
        BY_MODEL,
        "Ratios of dynamics",
        beside=[BELOW, *BELOW.beside],
        columns=2,
        size=(6.4, 4.2),
    ),
)
def fig1bcd(settings: Cell, stream: Stream) -> list[Row]:
    """10 x 10 grid; a log of n transitions of the uniform policy. Means over the seeds,
    values with their range. Above: ratios of dynamics; below: ratios of policies, with
    the whole episodes behind the log and the true behaviour policy. Products are means
    of 100 rollouts; exact_sd in table.csv is their exact standard deviation.
    """
    n = settings["n"]
    generator = stream.generator()
    rollouts = stream.generator(use="rollouts")
    simulator, target = grids()
    behavior = oee.uniform_policy(target)
    pool = sample_pool(target, behavior, n, generator)
    log = pool.draw(n, seed=generator)
    problem = oee.Problem(
        simulator, log, horizon=HORIZON, behavior_policy=behavior, episodes=pool
    )
    facts: dict[str, Row] = {
        name: {"episodes": pool.summary()["episodes"]} for name in ("IS", "PDIS", "WIS")
    }
    rows = []
    for delta in DELTAS:
        policy = gridworld_policy(10, delta)
        truth = SCALE * oee.policy_value(target, policy, horizon=HORIZON)
        fitted = OffEnvironment().fit(problem, policy, generator)
        for name, zeta in (
            ("OEE, product", fitted),
            ("oracle, product", oee.true_ratio(target, simulator)),
        ):
            moments = oee.weighted_return_moments(
                simulator, zeta, policy, horizon=HORIZON
            )
            facts[name] = {
                "exact_sd": SCALE * float(np.sqrt(moments.variance / N_ROLLOUTS))
            }
        for name in (*BY_MODEL, *BY_POLICY):
            value = (
                SCALE
                * NAMED[ESTIMATORS[name]](target)(problem, policy, seed=rollouts).value
            )
            row = {
                "delta": delta,
                "estimator": name,
                "value": value,
                "truth": truth,
                "error": abs(value - truth),
            }
            rows.append(row | facts.get(name, {}))
    return rows


TRUE = "true, r(s_t+1)"


def with_next_rewards_averaged(simulator: oee.FiniteMDP) -> oee.FiniteMDP:
    """Return the same MDP with rewards r(s, a) = sum_s' P r(s, a, s').

    A product then weighs r_t without the last ratio.
    """
    transitions = csr_on_pattern(simulator.transitions, simulator.transitions.data)
    names = {
        name: getattr(simulator, name)
        for name in ("layout", "state_names", "action_names")
    }
    return oee.FiniteMDP(
        transitions, simulator.rewards, simulator.initial, simulator.discount, **names
    )


def drop_truth(table: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of the quantities that are not the true one."""
    return table[table.quantity != TRUE]


@experiment(
    "The published recipe compares three different quantities",
    axes={"delta": tuple(round(0.1 * k, 1) for k in range(1, 10))},
    keys=("delta", "quantity"),
    measures=("value", "distance"),
    finding=lambda table: (
        "Distance:"
        f" {listed(drop_truth(table).groupby('quantity', sort=False).distance.mean())}"
    ),
    draw=Panels(
        "distance",
        "quantity",
        "delta",
        xlabel="delta",
        ylabel="|value - true value| times (1 - discount)",
        only=drop_truth,
        size=(6.4, 4.4),
    ),
)
def estimands(settings: Cell, stream: Stream) -> list[Row]:
    """Compare what is estimated, with the exact zeta and no estimation error at all.
    The published code's true curve has rewards r(s_t+1), its OEE r(s_t), and its oracle
    r(s_t+1) with a weight that lacks the last step, self-normalised over 100 rollouts.
    That OEE beats the oracle there is no merit of an estimate.
    """
    simulator, target = grids()
    policy = gridworld_policy(10, settings["delta"])
    truth = oee.policy_value(target, policy, horizon=HORIZON)
    oracle = Oracle(
        target, evaluation="monte_carlo", self_normalized=True, n_rollouts=N_ROLLOUTS
    )
    log = sample_pool(target, oee.uniform_policy(target), 100, stream.generator()).draw(
        100, seed=0
    )
    shifted = oee.Problem(with_next_rewards_averaged(simulator), log, horizon=HORIZON)
    # sum_t gamma^t E[r(s_{t+1})], s_t the target's, the last step the simulator's: a
    # weight one step too short
    time = oee.occupancy(target, policy, horizon=HORIZON)
    short = float(
        sum(simulator.discount**t for t in range(HORIZON))
        * np.sum(time * simulator.rewards)
    )
    values = {
        TRUE: truth,
        "OEE's, r(s_t)": oee.policy_value(
            gridworld(10, 0.1, pay="current"), policy, horizon=HORIZON
        ),
        "oracle's, one move short": short,
        "the same, 100 rollouts": (
            oracle(shifted, policy, seed=stream.generator(use="rollouts")).value
        ),
    }
    return [
        {
            "quantity": name,
            "value": SCALE * value,
            "distance": SCALE * abs(value - truth),
        }
        for name, value in values.items()
    ]


@experiment(
    "Products of ratios explode with the horizon; exact evaluation does not",
    axes={"delta": DELTAS},
    keys=("delta", "horizon", "quantity"),
    measures=("size",),
    draw=Panels(
        "size",
        "quantity",
        "horizon",
        by=("delta",),
        log=True,
        xlabel="horizon T (rewards)",
        ylabel="(1 - discount) size",
    ),
)
def horizon(settings: Cell, stream: Stream) -> list[Row]:
    """10 x 10 grid. The exact standard deviation of one product-weighted return of the
    simulator with the true zeta; the mean |error| of the exact value with zeta from
    3162 transitions of the uniform policy; the simulator's error.
    """
    simulator, target = grids()
    policy = gridworld_policy(10, settings["delta"])
    log = sample_log(target, 0.0, 3162, stream.generator())
    zeta = oee.true_ratio(target, simulator)
    rows = []
    for steps in (1, 2, 5, 10, 20, 50, 100, 150, 200):
        sizes = {}
        for kind in ("per_decision", "trajectory"):
            moments = oee.weighted_return_moments(
                simulator, zeta, policy, kind=kind, horizon=steps
            )
            sizes[f"oracle sd, {kind.replace('_', ' ')}"] = float(
                np.sqrt(moments.variance)
            )
        value = OffEnvironment()(
            oee.Problem(simulator, log, horizon=steps), policy
        ).value
        simulated, real = (
            oee.policy_value(mdp, policy, horizon=steps) for mdp in (simulator, target)
        )
        sizes |= {
            "OEE exact, |error|": abs(value - real),
            "simulator, |error|": abs(simulated - real),
        }
        rows += [
            {"horizon": steps, "quantity": name, "size": SCALE * size}
            for name, size in sizes.items()
        ]
    return rows


@experiment(
    "Importance sampling is good only near the policy that made the data",
    axes={
        "delta": (0.5, 0.9),
        "behavior_delta": (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9),
    },
    keys=("delta", "behavior_delta", "distance", "estimator"),
    measures=("error", "effective_sample_size", "pdis_exact_sd"),
    draw=Panels(
        "error",
        "estimator",
        "behavior_delta",
        by=("delta",),
        xlabel="delta of the policy that recorded the log",
        ylabel=common.MEAN_ERROR,
        extra={"PDIS: exact sd": "pdis_exact_sd"},
        log=True,
        axes={"ylim": (1e-3, 1e3)},
        # the same policy
        beneath=lambda ax, rows: ax.axvline(
            rows.delta.iloc[0], color="grey", lw=0.8, ls=":"
        ),
    ),
)
def data_policy(settings: Cell, stream: Stream) -> list[Row]:
    """10 x 10 grid; 3162 transitions of pi_b (whole episodes for importance sampling,
    with the true behaviour policy). distance in the table: the total variation between
    the two policies, averaged over the evaluated policy's time. Dotted: the same.
    """
    simulator, target = grids()
    behavior, policy = (
        gridworld_policy(10, settings[name]) for name in ("behavior_delta", "delta")
    )
    pool = sample_pool(target, behavior, 3162, stream.generator())
    problem = oee.Problem(
        simulator,
        pool.first(3162),
        horizon=HORIZON,
        behavior_policy=behavior,
        episodes=pool,
    )
    truth = oee.policy_value(target, policy, horizon=HORIZON)
    time = oee.occupancy(target, policy, horizon=HORIZON).sum(axis=1)
    distance = float(time @ (0.5 * np.abs(behavior - policy).sum(axis=1)))
    episodes = pool.summary()["episodes"]
    variance = (
        oee.policy_is_moments(target, behavior, policy, horizon=HORIZON).variance
        / episodes
    )
    facts = {"pdis_exact_sd": SCALE * float(np.sqrt(variance)), "episodes": episodes}
    rows = []
    for name in ("simulator", "OEE, exact", "model-based", "PDIS", "WIS, per decision"):
        result = NAMED[ESTIMATORS[name]]()(problem, policy)
        size = result.diagnostics.get("effective_sample_size", np.nan)
        error = {
            "error": abs(SCALE * (result.value - truth)),
            "effective_sample_size": size,
        }
        rows.append({"distance": distance, "estimator": name, **error, **facts})
    return rows


# ---- toy text

LAKE = "FrozenLake-v1:map_name=8x8,success_rate="
TAXI_RAIN = "Taxi-v4:is_rainy=true,rainy_probability="
CLIFF = "CliffWalking-v1"
# simulator, target, discount; random actions that give the simulator support; those of
# the target, which its log does not show
CASES: dict[str, tuple[str, str, float, float, float]] = {
    "slippery FrozenLake": (f"{LAKE}1/3", f"{LAKE}0.6", 0.99, 0.0, 0.0),
    "rain": (f"{TAXI_RAIN}0.8", f"{TAXI_RAIN}0.6", 0.95, 0.0, 0.0),
    "random-action faults": ("Taxi-v4", "Taxi-v4", 0.95, 0.05, 0.2),
    "slippery cliff": (CLIFF, f"{CLIFF}:is_slippery=true", 0.95, 0.1, 0.0),
}


@functools.lru_cache(maxsize=4)
def make_case(case: str) -> tuple[oee.FiniteMDP, oee.FiniteMDP, dict[str, Array]]:
    """Make a simulator, its target, and five policies.

    The simulator may mistake their order; each is mixed with the uniform policy.
    """
    *names, discount, noise, faults = CASES[case]
    simulator, target = (named_task(name, discount=discount).mdp for name in names)
    simulator = simulator.with_action_noise(noise) if noise else simulator
    target = target.with_action_noise(faults) if faults else target
    best, cautious, ideal = map(
        oee.optimal_policy, (simulator, simulator.with_action_noise(0.3), target)
    )
    shares = {
        "simulator's optimum, 90%": (best, 0.9),
        "simulator's optimum, 60%": (best, 0.6),
        "cautious (optimum under 30% noise), 90%": (cautious, 0.9),
        "target's optimum, 90%": (ideal, 0.9),
        "target's optimum, 60%": (ideal, 0.6),
    }
    uniform = oee.uniform_policy(simulator)
    return (
        simulator,
        target,
        {
            name: oee.mix(policy, uniform, share)
            for name, (policy, share) in shares.items()
        },
    )


def record(
    case: str, behavior: Array, n: int, generator: np.random.Generator
) -> oee.Transitions:
    """Record n transitions by stepping Gymnasium's environment.

    Faults replace the action by a random one before it is executed.
    """
    from gymnasium.wrappers import TransformAction

    _, name, discount, _, faults = CASES[case]
    make: Any = named_task(name, discount=discount).environment
    environment = make()
    actions = environment.action_space

    def fail(action: Any) -> Any:  # the log keeps the action that was chosen
        """Replace some actions by random ones; the log keeps what was chosen."""
        if generator.random() < faults:
            return int(generator.integers(actions.n))
        return action

    stepped = TransformAction(environment, fail, actions) if faults else environment
    log = oee.record_episodes(stepped, behavior, n_transitions=n, seed=generator)
    environment.close()
    return log


def compute_values(settings: Cell, stream: Stream) -> list[Row]:
    """FrozenLake: success rate 1/3 simulated, 0.6 real. Rain: the taxi goes where it is
    sent with probability 0.8 simulated, 0.6 real. Faults: a random action is executed
    with probability 0.2. The simulators of faults (5%) and of the cliff (10%) have
    random actions for the support that a ratio needs. The log is recorded with 50% of
    the simulator's optimum. Means over five policies and the seeds; tau is that of
    their order, regret what choosing the best estimate loses.
    """
    case = settings["case"]
    simulator, target, policies = make_case(case)
    behavior = oee.mix(
        oee.optimal_policy(simulator), oee.uniform_policy(simulator), 0.5
    )
    log = record(case, behavior, settings["n"], stream.generator())
    # On the cliff the same transition has the reward -1 or -100, by the action.
    rewards: Any = "log" if case == "slippery cliff" else "simulator"
    problem = oee.Problem(simulator, log, behavior_policy=behavior, rewards=rewards)
    truths = np.array(
        [oee.policy_value(target, policy) for policy in policies.values()]
    )
    rows = []
    for name in (
        "simulator",
        "OEE, exact",
        "model-based",
        "WIS, per decision",
        "doubly robust",
    ):
        estimator = NAMED[ESTIMATORS[name]]()
        values = np.array(
            [estimator(problem, policy, seed=0).value for policy in policies.values()]
        )
        order: Row = {
            "kendall_tau": float(stats.kendalltau(values, truths).statistic),
            "regret": float(truths.max() - truths[int(np.argmax(values))]),
        }
        for policy, value, truth in zip(policies, values, truths, strict=True):
            own = {
                "estimator": name,
                "policy": policy,
                "value": value,
                "truth": truth,
                "error": abs(value - truth),
            }
            rows.append(own | order)
    return rows


RANKING = Panels(
    "kendall_tau",
    "estimator",
    ylabel="Kendall's tau with the true order",
    axes={"xscale": "log", "ylim": (-1.05, 1.05)},
)
ERRORS = common.ErrorPanels(
    "error",
    "estimator",
    by=("case",),
    ylabel="mean |error| (discounted sum of rewards)",
    beside=[RANKING],
    columns=2,
)


def make_experiment(name: str, title: str, *cases: str) -> Experiment:
    """Make the experiment of these cases."""
    return Experiment(
        name,
        title,
        axes={"case": cases, "n": (1000, 3162, 10_000, 31_623)},
        group="gymnasium",
        run=compute_values,
        keys=("case", "n", "policy", "estimator"),
        measures=("error", "kendall_tau", "regret"),
        draw=ERRORS,
        finding=ERRORS.find,
    )


frozen_lake = make_experiment(
    "frozen_lake",
    "FrozenLake 8 x 8: the ice is less slippery than simulated",
    "slippery FrozenLake",
)
taxi = make_experiment(
    "taxi", "Taxi: rain, and random-action faults", "rain", "random-action faults"
)
cliff_walking = make_experiment(
    "cliff_walking", "CliffWalking: dry simulator, slippery cliff", "slippery cliff"
)

"""Gymnasium's toy text: FrozenLake, Taxi in the rain and with faults, CliffWalking; five policies, valued and ranked."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from scipy import stats

import oee_tabular as oee
from oee_tabular._checks import Array
from oee_tabular.estimators.names import NAMED
from oee_tabular.lab.experiments.common import ErrorPanels
from oee_tabular.lab.panels import Panels
from oee_tabular.lab.registry import Cell, Experiment, Row, Stream
from oee_tabular.tasks import named_task

CURVES = {  # and their names in ``oee evaluate``
    "simulator": "simulator",
    "OEE, exact": "oee",
    "model-based": "model-based",
    "WIS, per decision": "wpdis",
    "doubly robust": "dr",
}
LAKE, TAXI_RAIN = "FrozenLake-v1:map_name=8x8,success_rate=", "Taxi-v4:is_rainy=true,rainy_probability="
CLIFF = "CliffWalking-v1"
# simulator, target, discount; random actions that give the simulator support; those of the target, which its log does not show
CASES: dict[str, tuple[str, str, float, float, float]] = {
    "slippery FrozenLake": (f"{LAKE}1/3", f"{LAKE}0.6", 0.99, 0.0, 0.0),
    "rain": (f"{TAXI_RAIN}0.8", f"{TAXI_RAIN}0.6", 0.95, 0.0, 0.0),
    "random-action faults": ("Taxi-v4", "Taxi-v4", 0.95, 0.05, 0.2),
    "slippery cliff": (CLIFF, f"{CLIFF}:is_slippery=true", 0.95, 0.1, 0.0),
}


@functools.lru_cache(maxsize=4)
def make_case(case: str) -> tuple[oee.FiniteMDP, oee.FiniteMDP, dict[str, Array]]:
    """Simulator, target, and five policies of which the simulator may mistake the order: each mixed with the uniform one."""
    *names, discount, noise, faults = CASES[case]
    simulator, target = (named_task(name, discount=discount).mdp for name in names)
    simulator = simulator.with_action_noise(noise) if noise else simulator
    target = target.with_action_noise(faults) if faults else target
    best, cautious, ideal = map(oee.optimal_policy, (simulator, simulator.with_action_noise(0.3), target))
    shares = {
        "simulator's optimum, 90%": (best, 0.9),
        "simulator's optimum, 60%": (best, 0.6),
        "cautious (optimum under 30% noise), 90%": (cautious, 0.9),
        "target's optimum, 90%": (ideal, 0.9),
        "target's optimum, 60%": (ideal, 0.6),
    }
    uniform = oee.uniform_policy(simulator)
    return simulator, target, {name: oee.mix(policy, uniform, share) for name, (policy, share) in shares.items()}


def record(case: str, behavior: Array, n: int, generator: np.random.Generator) -> oee.Transitions:
    """n transitions by stepping Gymnasium's environment; faults replace the action by a random one before it is executed."""
    from gymnasium.wrappers import TransformAction

    _, name, discount, _, faults = CASES[case]
    make: Any = named_task(name, discount=discount).environment
    environment = make()
    actions = environment.action_space

    def fail(action: Any) -> Any:  # the log keeps the action that was chosen
        return int(generator.integers(actions.n)) if generator.random() < faults else action

    stepped = TransformAction(environment, fail, actions) if faults else environment
    log = oee.record_episodes(stepped, behavior, n_transitions=n, seed=generator)
    environment.close()
    return log


def compute_values(settings: Cell, stream: Stream) -> list[Row]:
    """FrozenLake: success rate 1/3 simulated, 0.6 real. Rain: the taxi goes where it is sent with probability 0.8 simulated,
    0.6 real. Faults: a random action is executed with probability 0.2. The simulators of faults (5%) and of the cliff (10%)
    have random actions for the support that a ratio needs. The log is recorded with 50% of the simulator's optimum. Means over
    five policies and the seeds; tau is that of their order, regret what choosing the best estimate loses.
    """
    case = settings["case"]
    simulator, target, policies = make_case(case)
    behavior = oee.mix(oee.optimal_policy(simulator), oee.uniform_policy(simulator), 0.5)
    log = record(case, behavior, settings["n"], stream.generator())
    # the same transition pays -1 or -100 on the cliff
    rewards: Any = "log" if case == "slippery cliff" else "simulator"
    problem = oee.Problem(simulator, log, behavior_policy=behavior, rewards=rewards)
    truths = np.array([oee.policy_value(target, policy) for policy in policies.values()])
    rows = []
    for name, kind in CURVES.items():
        values = np.array([NAMED[kind]()(problem, policy, seed=0).value for policy in policies.values()])
        order: Row = {
            "kendall_tau": float(stats.kendalltau(values, truths).statistic),
            "regret": float(truths.max() - truths[int(np.argmax(values))]),
        }
        for policy, value, truth in zip(policies, values, truths, strict=True):
            own = {"estimator": name, "policy": policy, "value": value, "truth": truth, "error": abs(value - truth)}
            rows.append(own | order)
    return rows


RANKING = Panels(
    "kendall_tau",
    "estimator",
    ylabel="Kendall's tau with the true order",
    axes={"xscale": "log", "ylim": (-1.05, 1.05)},
)
ERRORS = ErrorPanels(
    "error", "estimator", by=("case",), ylabel="mean |error| (discounted sum of rewards)", beside=[RANKING], columns=2
)


def make_experiment(name: str, title: str, *cases: str) -> Experiment:
    """The experiment of these cases."""
    return Experiment(
        name, title, axes={"case": cases, "n": (1000, 3162, 10_000, 31_623)}, group="gymnasium",
        run=compute_values, keys=("case", "n", "policy", "estimator"), measures=("error", "kendall_tau", "regret"),
        draw=ERRORS, finding=ERRORS.find,
    )  # fmt: skip


frozen_lake = make_experiment(
    "frozen_lake", "FrozenLake 8 x 8: the ice is less slippery than simulated", "slippery FrozenLake"
)
taxi = make_experiment("taxi", "Taxi: rain, and random-action faults", "rain", "random-action faults")
cliff_walking = make_experiment("cliff_walking", "CliffWalking: dry simulator, slippery cliff", "slippery cliff")

"""Gymnasium's toy text: FrozenLake, Taxi in the rain and with faults, CliffWalking; five policies, valued and ranked."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from oee_tabular._checks import Array
from oee_tabular.estimators import Problem
from oee_tabular.exact import optimal_policy, policy_value
from oee_tabular.lab.experiments.common import estimators_of
from oee_tabular.lab.findings import rank
from oee_tabular.lab.panels import Beside, Errors, Panels
from oee_tabular.lab.registry import Cell, Experiment, Row, Stream
from oee_tabular.mdp import FiniteMDP, mix, uniform_policy
from oee_tabular.tasks import named_task, record_episodes

SAMPLES = (1000, 3162, 10_000, 31_623)
CURVES = {  # and their names in ``oee evaluate``
    "simulator": "simulator",
    "OEE, exact": "oee",
    "model-based": "model-based",
    "WIS, per decision": "wpdis",
    "doubly robust": "dr",
}


@dataclass(frozen=True)
class ToyTextPair:
    """Gymnasium's environments as simulator and target, by name.

    Attributes
    ----------
    noise : random actions that give the simulator support
    faults : random actions of the target, which its log does not show
    rewards : as of ``Problem``
    """

    simulator: str
    target: str
    discount: float = 0.95
    noise: float = 0.0
    faults: float = 0.0
    rewards: Literal["simulator", "log"] = "simulator"


LAKE, TAXI_RAIN = "FrozenLake-v1:map_name=8x8,success_rate=", "Taxi-v4:is_rainy=true,rainy_probability="
CLIFF = "CliffWalking-v1"
CASES: dict[str, ToyTextPair] = {
    "slippery FrozenLake": ToyTextPair(f"{LAKE}1/3", f"{LAKE}0.6", discount=0.99),
    "rain": ToyTextPair(f"{TAXI_RAIN}0.8", f"{TAXI_RAIN}0.6"),
    "random-action faults": ToyTextPair("Taxi-v4", "Taxi-v4", noise=0.05, faults=0.2),
    "slippery cliff": ToyTextPair(CLIFF, f"{CLIFF}:is_slippery=true", noise=0.1, rewards="log"),
}


@functools.lru_cache(maxsize=4)
def environments(case: str) -> tuple[FiniteMDP, FiniteMDP, Any]:
    """Simulator (with the noise that gives it support), target, and what steps the target."""
    own = CASES[case]
    simulator, target = (named_task(name, discount=own.discount) for name in (own.simulator, own.target))
    noisy = simulator.mdp.with_action_noise(own.noise) if own.noise else simulator.mdp
    truth = target.mdp.with_action_noise(own.faults) if own.faults else target.mdp
    return noisy, truth, target.environment


@functools.lru_cache(maxsize=4)
def policies(case: str) -> dict[str, Array]:
    """Five policies of which the simulator may mistake the order: each mixed with the uniform one."""
    simulator, target, _ = environments(case)
    uniform = uniform_policy(simulator)
    return {
        "simulator's optimum, 90%": mix(optimal_policy(simulator), uniform, 0.9),
        "simulator's optimum, 60%": mix(optimal_policy(simulator), uniform, 0.6),
        "cautious (optimum under 30% noise), 90%": mix(optimal_policy(simulator.with_action_noise(0.3)), uniform, 0.9),
        "target's optimum, 90%": mix(optimal_policy(target), uniform, 0.9),
        "target's optimum, 60%": mix(optimal_policy(target), uniform, 0.6),
    }


def recorded(case: str, behavior: Array, n: int, generator: np.random.Generator) -> Any:
    """n transitions by stepping Gymnasium's environment; faults replace the action by a random one before it is executed."""
    _, _, make = environments(case)
    environment = make()
    faults = CASES[case].faults
    if faults:
        environment = _faulty(environment, faults, generator)
    log = record_episodes(environment, behavior, n_transitions=n, seed=generator)
    environment.close()
    return log


def _faulty(environment: Any, probability: float, generator: np.random.Generator) -> Any:
    import gymnasium

    class Faults(gymnasium.ActionWrapper[Any, Any, Any]):
        """With ``probability`` a uniformly random action is executed; the log keeps the one that was chosen."""

        def action(self, action: object) -> Any:
            if generator.random() < probability:
                return int(generator.integers(self.env.action_space.n))  # type: ignore[attr-defined]
            return action

    return Faults(environment)


def cell(settings: Cell, stream: Stream) -> list[Row]:
    """One log; every policy and estimator, and how well each ranks the policies."""
    from scipy import stats

    case, n = str(settings["case"]), int(settings["n"])
    simulator, target, _ = environments(case)
    behavior = mix(optimal_policy(simulator), uniform_policy(simulator), 0.5)
    log = recorded(case, behavior, n, stream.generator())
    problem = Problem(simulator, log, behavior_policy=behavior, rewards=CASES[case].rewards)
    asked = policies(case)
    truths = np.array([policy_value(target, policy) for policy in asked.values()])
    rows = []
    for name, estimate in estimators_of(CURVES).items():
        values = np.array([estimate(problem, policy, seed=0).value for policy in asked.values()])
        tau = float(stats.kendalltau(values, truths).statistic)
        regret = float(truths.max() - truths[int(np.argmax(values))])
        for policy, value, truth in zip(asked, values, truths, strict=True):
            rows.append({"estimator": name, "policy": policy, "value": value, "truth": truth, "error": abs(value - truth),
                         "kendall_tau": tau, "regret": regret})  # fmt: skip
    return rows


ERRORS = Errors("error", "estimator", title="{case}: error", ylabel="mean |error| (discounted sum of rewards)")
RANKING = Panels(
    "kendall_tau",
    "estimator",
    title="{case}: ranking",
    ylabel="Kendall's tau with the true order",
    axes={"xscale": "log", "ylim": (-1.05, 1.05)},
)


COMMON = (
    " Five policies: 90% and 60% of the simulator's optimum and of the target's, 90% of a cautious one, the rest uniform; "
    "the log is recorded by stepping the environment with 50% of the simulator's optimum. Means over policies and seeds; "
    "tau is that of the five policies' order, regret in the table what choosing the best estimate loses."
)


def _experiment(name: str, title: str, cases: tuple[str, ...], caption: str) -> Experiment:
    return Experiment(
        name, title, axes={"case": cases, "n": SAMPLES}, smoke={"case": cases[:1], "n": SAMPLES[:1]}, group="gymnasium",
        run=cell, keys=("case", "n", "policy", "estimator"), measures=("error", "kendall_tau", "regret"),
        finding=rank("Mean error", "error", "estimator", names=("simulator", "OEE, exact", "model-based")),
        draw=Beside([ERRORS, RANKING], by=("case",), columns=2, size=(5.4, 3.9)), caption=caption + COMMON,
    )  # fmt: skip


FROZEN_LAKE = _experiment(
    "frozen_lake", "FrozenLake 8 x 8: the ice is less slippery than simulated", ("slippery FrozenLake",),
    "Success rate 1/3 simulated, 0.6 real; discount 0.99.",
)  # fmt: skip
TAXI = _experiment(
    "taxi", "Taxi: rain, and random-action faults", ("rain", "random-action faults"),
    "Rain: the taxi goes where it is sent with probability 0.8 simulated, 0.6 real. Faults: a random action is executed with "
    "probability 0.2 in the real one; the simulator has none, and gets 5% for the support that a ratio needs. Discount 0.95.",
)  # fmt: skip
CLIFF_WALKING = _experiment(
    "cliff_walking", "CliffWalking: dry simulator, slippery cliff", ("slippery cliff",),
    "The simulator is deterministic; with_action_noise(0.1) gives it support. The same transition pays -1 or -100 there, so "
    "rewards are the log's. Discount 0.95.",
)  # fmt: skip

"""The guide's example over 40 logs (seeds 0 to 39): errors of the default and of
maximum likelihood beside the simulator's.
"""

import numpy as np

import oee_tabular as oee
from oee_tabular.estimators import ModelBased, OffEnvironment, Problem
from oee_tabular.tasks import named_task

NAME = "FrozenLake-v1:map_name=8x8,success_rate="


def main():
    """A line for each estimator."""
    simulator = named_task(f"{NAME}1/3", discount=0.99).mdp
    task = named_task(f"{NAME}0.6", discount=0.99)
    best = oee.optimal_policy(task.mdp)
    uniform = oee.uniform_policy(task.mdp)
    policy = oee.mix(best, uniform, 0.7)
    behavior = oee.mix(best, uniform, 0.49)
    truth = oee.policy_value(task.mdp, policy)
    off = abs(oee.policy_value(simulator, policy) - truth)
    logs = [
        oee.record_episodes(
            task.environment(), behavior, n_transitions=20_000, seed=seed
        )
        for seed in range(40)
    ]
    for name, estimate in {
        "oee": OffEnvironment(),
        "model-based": ModelBased(),
    }.items():
        errors = np.array(
            [estimate(Problem(simulator, log), policy).value - truth for log in logs]
        )
        rmse = np.sqrt(np.mean(errors**2))
        print(
            f"{name:<12} RMSE {rmse:.4f}, {rmse / off:.1%} of the simulator's error"
            f" ({off:.4f}); below a quarter of it: {(np.abs(errors) < off / 4).sum()}"
            f" of {len(logs)}"
        )


if __name__ == "__main__":
    main()

"""Estimators and families of a user's own, by MODULE:OBJECT."""

import oee_tabular as oee


def guess(problem, policy, *, seed=None):
    return oee.Estimate(float(len(problem.log)), 1.0, diagnostics={"seed": seed})


class Maker:
    def __call__(self, problem, policy, *, seed=None):
        return oee.Estimate(
            1.0, interval=(0.0, 2.0), diagnostics={"interval_method": "mine"}
        )


def pairs(seed):
    simulator = oee.tasks.gridworld(3, 0.3)
    target = oee.tasks.gridworld(3, 0.1 + 0.01 * seed)
    policy = oee.uniform_policy(simulator)
    return {
        "three": oee.bench.Family(
            simulator, target, policy, policy, "Moves slip less than simulated."
        )
    }


def constant():
    return pairs(0)


def wrong():
    return {"three": 3}


def outside(seed):
    simulator = oee.tasks.gridworld(3, 0.0)
    target = oee.tasks.gridworld(3, 0.1)
    policy = oee.uniform_policy(simulator)
    return oee.bench.Families(
        {
            "bent": lambda: oee.bench.Family(
                simulator, target, policy, policy, "It slips."
            )
        },
        seed,
        {},
    )

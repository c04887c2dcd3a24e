"""Policies made from the log that they are evaluated on: who is told, and what covers.

    python tests/benchmarks/made_from_log.py            # 20 logs a family, some minutes
    python tests/benchmarks/made_from_log.py --logs 2

For each number of transitions a pair it prints how often the policy that is best in the
log's counts, and neither in the corrected simulator nor in the simulator, gets the note
of ``oee.evaluate``, how often its 95% interval then holds the true value, and how often
the note stands by the corrected simulator's and the simulator's best policies and the
recording one.
"""

import argparse
import warnings

import numpy as np

import oee_tabular as oee
from oee_tabular.report.selection import is_best_in_log

NAMES = (
    "machine",
    "forest12",
    "river_swim",
    "queue25",
    "inventory20",
    "garnet_dirichlet10",
    "garnet_worse",
    "ageing_asset",
    "gambler",
    "parking",
)
SIZES = (3, 10, 30)


def measure(names, per_pair, n_logs):
    """Return the shares: noted, noted among others, held where noted."""
    noted, others, held = [], [], []
    for name in names:
        family = oee.bench.families()[name]
        simulator, target = family.simulator, family.target
        best = oee.optimal_policy(simulator)
        runs = oee.mix(best, oee.uniform_policy(simulator), 0.5)
        share = oee.occupancy(target, runs)
        for seed in range(n_logs):
            log = oee.sample_transitions(
                target, share, per_pair * share.size, seed=seed
            )
            problem = oee.Problem(simulator, log)
            ratio = oee.transition_ratio(log, simulator, values_of=runs)
            made = oee.optimal_policy(ratio.maximum_likelihood_model(simulator))
            corrected = oee.optimal_policy(ratio.target_model(simulator))
            is_noted = is_best_in_log(problem, made)
            if not any(np.array_equal(made, policy) for policy in (corrected, best)):
                noted.append(is_noted)
            others += [
                is_best_in_log(problem, policy)
                for policy in (corrected, best, runs)
                if not np.array_equal(policy, made)
            ]
            if is_noted:
                value = oee.policy_value(target, made)
                held.append(value in oee.interval(problem, made))
    return [float(np.mean(each)) if each else np.nan for each in (noted, others, held)]


def main():
    """Print a line for each size."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--logs", type=int, default=20)
    n_logs = parser.parse_args().logs
    warnings.simplefilter("ignore")
    for size in SIZES:
        noted, others, held = measure(NAMES, size, n_logs)
        print(
            f"{size:3} a pair: noted {noted:.0%}, of the others {others:.1%};"
            f" where noted the interval holds in {held:.0%}",
            flush=True,
        )


if __name__ == "__main__":
    main()

"""The ends of likelihood intervals and of gains against SLSQP, on random problems.

    python tests/benchmarks/likelihood_ends.py                 # 60 problems, 24 starts
    python tests/benchmarks/likelihood_ends.py --problems 6

Problems have 3 to 8 states, two actions and logs of 8, 20 or 60 transitions, in which some
pairs may not be recorded. One in three has a horizon of 5. Half of the ends are those of
a value, half those of a gain over another policy. SLSQP starts from several random points
and keeps its best feasible end. What is printed is by how much of the interval's width
the package's end falls short of that.
"""

import argparse
import sys
import warnings
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from helpers import random_policy
from slsqp import best_of_slsqp, problem_of

from oee_tabular.inference.evidence import gather
from oee_tabular.inference.profile_ascent import likelihood_ends


def shortfalls(seed, n_starts):
    """Return by how much both ends of a problem fall short, in units of the width."""
    rng = np.random.default_rng((2000, seed))
    horizon = None if seed % 3 else 5
    problem, policy = problem_of(rng, horizon=horizon, n=int(rng.choice([8, 20, 60])))
    running = random_policy(rng, problem.simulator) if seed % 2 else None
    evidence = gather(problem, policy)
    low, high = (end.value for end in likelihood_ends(evidence, 0.95, minus=running))
    lowest, highest = (
        best_of_slsqp(evidence, sign, n_starts, rng, running) for sign in (-1.0, 1.0)
    )
    width = max(high - low, 1e-12)
    return [(low - lowest) / width, (highest - high) / width]


def main():
    """Print how far the ends are from those of SLSQP."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--problems", type=int, default=60)
    parser.add_argument("--starts", type=int, default=24)
    given = parser.parse_args()
    short = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of SLSQP's bounds
        for seed in range(given.problems):
            short.append(shortfalls(seed, given.starts))
            if max(short[-1]) > 1e-6:
                print(
                    f"problem {seed}: short by {max(short[-1]):.2%} of the width",
                    flush=True,
                )
    ends = np.ravel(short)
    found = ends[np.isfinite(ends)]
    print(
        f"{len(found)} ends of which SLSQP has a feasible point:"
        f" {np.sum(found > 1e-6)} short by more than 1e-6 of the width, the most by"
        f" {found.max():.2%}; SLSQP is short in {np.sum(found < -1e-6)}, the most by"
        f" {-found.min():.2%}"
    )


if __name__ == "__main__":
    main()

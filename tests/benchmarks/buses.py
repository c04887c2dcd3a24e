"""Errors on Rust's bus engines: python tests/benchmarks/buses.py [DRAWS] [SOURCE].

For 30, 100, 300 and 1000 months of group 4, with group 3 as the simulator, the root
mean squared error of five values of the policy that replaces the engine from bin 60 on,
with a bootstrap standard error over the draws, and how often the two intervals cover
the value. SOURCE is that of ``oee.tasks.bus_engines``: "recorded" or "target".
"""

import sys
import warnings

import numpy as np

import oee_tabular as oee
from oee_tabular.estimators import ModelBased, OffEnvironment
from oee_tabular.ratio import Tied

SIZES = (30, 100, 300, 1000)
N_RESAMPLES = 1000


def measure(n_months, seed, source):
    """Return the errors, whether the intervals cover, and their widths, on one log."""
    buses = oee.tasks.bus_engines(n_months, seed=seed, source=source)
    truth = oee.policy_value(buses.target, buses.policy)
    problem = oee.Problem(buses.simulator, buses.log)
    values = {
        "simulator": oee.policy_value(buses.simulator, buses.policy),
        "counting": ModelBased(fallback="simulator")(problem, buses.policy).value,
        "default": OffEnvironment()(problem, buses.policy).value,
        "tie": OffEnvironment(ratio=Tied(buses.tie))(problem, buses.policy).value,
    }
    ends = {
        "default": oee.interval(problem, buses.policy),
        "tie": oee.interval(problem, buses.policy, tie=buses.tie),
    }
    values["centre of the tie's interval"] = (
        ends["tie"].lower + ends["tie"].upper
    ) / 2.0
    errors = {name: value - truth for name, value in values.items()}
    covers = {name: truth in found for name, found in ends.items()}
    widths = {name: found.width for name, found in ends.items()}
    return errors, covers, widths


def main():
    """Print a line for each number of months and value."""
    n_draws = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    source = sys.argv[2] if len(sys.argv) > 2 else "recorded"
    warnings.simplefilter("ignore")
    rng = np.random.default_rng(0)
    shares = rng.multinomial(n_draws, np.full(n_draws, 1 / n_draws), N_RESAMPLES)
    for n_months in SIZES:
        draws = [measure(n_months, [n_months, k], source) for k in range(n_draws)]
        for name in draws[0][0]:
            squares = np.array([errors[name] ** 2 for errors, _, _ in draws])
            spread = np.sqrt(shares @ squares / n_draws).std()
            print(
                f"{n_months:5} {name:30} RMSE {np.sqrt(squares.mean()):.3f} ± {spread:.3f}"
            )
        for name in draws[0][1]:
            hits = np.mean([covers[name] for _, covers, _ in draws])
            width = np.median([widths[name] for _, _, widths in draws])
            print(
                f"{n_months:5} interval, {name:20} covers {hits:.2f} ±"
                f" {np.sqrt(hits * (1 - hits) / n_draws):.2f}; median width {width:.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()

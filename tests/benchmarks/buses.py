"""Errors on Rust's bus engines: python tests/benchmarks/buses.py [DRAWS] [SOURCE].

For 30, 100, 300 and 1000 months of group 4, with group 3 as the simulator, the root
mean squared error of values of the policy that replaces the engine from bin 60 on, with
a bootstrap standard error over the draws, and how often their intervals cover the
truth. SOURCE is that of ``oee.tasks.bus_engines``: "target", where one wear of all bins
is the truth, or "recorded". There each error is printed from two truths: from the
target's value, and, as ``counted``, from what counting all 4292 months gives.

python tests/benchmarks/buses.py [DRAWS] improve: how often ``oee.improve`` deploys a
policy on months sampled from the target, how often the gain in the target is at least
its lower end where it deploys, and whether what it deploys is better.
"""

import sys
import warnings

import numpy as np

import oee_tabular as oee
from oee_tabular.estimators import ModelBased, OffEnvironment
from oee_tabular.ratio import Tied

SIZES = (30, 100, 300, 1000)
DECISION_SIZES = (300, 1000)
BINS_OF_AN_AGE = 20
N_RESAMPLES = 1000


def tie_by_age(state, action, following):
    """Return keys of the increment and the age of the engine, 20 bins each."""
    start = np.where(action == 1, 0, state)
    return following - start + 3 * (start // BINS_OF_AN_AGE)


def measure(n_months, seed, source):
    """Return the value and the ends of the interval of each rule on one log."""
    buses = oee.tasks.bus_engines(n_months, seed=seed, source=source)
    problem = oee.Problem(buses.simulator, buses.log)
    nowhere = (np.nan, np.nan)
    simulated = oee.policy_value(buses.simulator, buses.policy)
    counting = ModelBased(fallback="simulator")(problem, buses.policy).value
    found = {
        "simulator": (simulated, *nowhere),
        "counting": (counting, *nowhere),
    }
    for name, tie in (("default", None), ("tie", buses.tie), ("by age", tie_by_age)):
        ratio = {} if tie is None else {"ratio": Tied(tie)}
        value = OffEnvironment(**ratio)(problem, buses.policy).value
        ends = oee.interval(problem, buses.policy, tie=tie)
        found[name] = (value, ends.lower, ends.upper)
    return found


def measure_decisions(n_draws):
    """Print for each number of months how often improve deploys, and is right."""
    for n_months in DECISION_SIZES:
        gains = []
        for k in range(n_draws):
            buses = oee.tasks.bus_engines(n_months, seed=[n_months, k], source="target")
            problem = oee.Problem(buses.simulator, buses.log)
            found = oee.improve(problem, buses.policy, seed=0)
            if found.deploy:
                value = oee.policy_value(buses.target, found.policy)
                gain = value - oee.policy_value(buses.target, buses.policy)
                gains.append((gain, found.gain_lower))
        share = len(gains) / n_draws
        error = np.sqrt(share * (1 - share) / n_draws)
        line = f"{n_months:5} deploys in {share:.2f} ± {error:.2f}"
        if gains:
            n_held = sum(gain >= lower for gain, lower in gains)
            n_worse = sum(gain <= 0 for gain, _ in gains)
            line += (
                f"; the bound holds in {n_held} of {len(gains)}, {n_worse} are worse"
            )
            line += f"; median gain {np.median([gain for gain, _ in gains]):.2f}"
        print(line, flush=True)


def main():
    """Print a line for each number of months, value and truth."""
    n_draws = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    source = sys.argv[2] if len(sys.argv) > 2 else "recorded"
    warnings.simplefilter("ignore")
    if source == "improve":
        measure_decisions(n_draws)
        return
    whole = oee.tasks.bus_engines()
    truths = {"target": oee.policy_value(whole.target, whole.policy)}
    if source == "recorded":
        problem = oee.Problem(whole.simulator, whole.log)
        every = ModelBased(fallback="simulator")(problem, whole.policy)
        truths["counted"] = every.value
    print({name: round(truth, 3) for name, truth in truths.items()})
    rng = np.random.default_rng(0)
    shares = rng.multinomial(n_draws, np.full(n_draws, 1 / n_draws), N_RESAMPLES)
    for n_months in SIZES:
        draws = [measure(n_months, [n_months, k], source) for k in range(n_draws)]
        for name in draws[0]:
            values, lower, upper = np.array([draw[name] for draw in draws]).T
            for what, truth in truths.items():
                squares = (values - truth) ** 2
                error = np.sqrt(shares @ squares / n_draws).std()
                line = f"{n_months:5} {name:9} from {what}: "
                line += f"RMSE {np.sqrt(squares.mean()):.3f} ± {error:.3f}"
                if np.isfinite(lower).all():
                    hits = np.mean((lower <= truth) & (truth <= upper))
                    spread = np.sqrt(hits * (1 - hits) / n_draws)
                    line += f"; interval covers {hits:.2f} ± {spread:.2f}, median"
                    line += f" width {np.median(upper - lower):.2f}"
                print(line, flush=True)


if __name__ == "__main__":
    main()

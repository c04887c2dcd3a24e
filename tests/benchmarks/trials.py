"""How narrow log and trials are together, and how often they cover.

    python tests/benchmarks/trials.py [--families held] [--logs 14] [--seed 8200]
    python tests/benchmarks/trials.py --starts

Each family of ``oee_tabular.lab.bench.families_redrawn`` is drawn anew by the seed. Its
policy is tried 30 times in the target, and its log has 3 or 10 transitions for each
stochastic pair. Columns, as medians over the families but for the shares:

- log: the log's own interval covers, in % of the logs;
- covers: the joined interval covers, with its standard error;
- width: of the joined interval over that of the bound (1 / V_log + m / Var Y)^-1;
- worth: the number of trials alone whose interval is as narrow, at the bound;
- saved: the share of these that the log saves;
- error: the root mean squared error of the value over that of the trials' mean.

With ``--starts`` it prints, of the bench's families, what the first state alone can
save: Var V(s_0) / Var Y, exactly. A control variate that knows the first state of each
trial and the true values saves this share of the trials, and none saves more.

How T is corrected for few trials was chosen on the kinds that ``SPLIT`` calls tuned,
with seed 7100. The table of ``notebooks/trials.md`` is of both.
"""

import argparse
import math
import sys
import time
import warnings

import numpy as np
import pandas as pd
from scipy import stats

import oee_tabular as oee
from oee_tabular.inference import trials as joining
from oee_tabular.lab.bench.families_redrawn import SPLIT
from oee_tabular.lab.bench.families_unrecorded import families
from oee_tabular.mdp import check_policy

LEVEL = 0.95
QUANTILE = 1.959963984540054
LIMIT = 0.5 * QUANTILE**2
# standard deviations at which the log's ends are computed; ``join_trials`` goes on from
# there, which moves an end by less than a thousandth of the width
NODES = (joining.NEAREST, 0.5, 1.0, 1.5, QUANTILE, 2.5, 3.5, 6.0)
NUMBERS = (12, 30)
SIZES = (3, 10)


def measure(family, name, size, seed):
    """One log and its trials: a row for each number of trials."""
    rng = np.random.default_rng(seed)
    n = family.size(size)
    log = family.log(n, seed=rng)
    horizon = family.horizon
    steps = horizon or math.ceil(math.log(1e-6) / math.log(family.target.discount))
    tried = oee.sample_returns(
        family.target, family.policy, max(NUMBERS), horizon=steps, seed=rng
    )
    policy = check_policy(family.policy, family.simulator)
    moments = oee.return_moments(family.target, policy, horizon=horizon)
    of_log = (
        oee.efficiency_bound(
            family.target, policy, family.data_distribution, horizon=horizon
        )
        / n
    )
    alone = oee.Problem(family.simulator, log, horizon=horizon)

    def find(z):
        level = math.erf(z / math.sqrt(2.0))
        return oee.interval(alone, policy, confidence=level)

    own = find(QUANTILE)
    known = {z: find(z) for z in NODES}
    curve = joining._curve(known, joining._quoted, (QUANTILE,))
    estimate = oee.estimators.OffEnvironment()(alone, policy)
    rows = []
    for m in NUMBERS:
        trials = oee.Trials(tried.returns[:m])
        outcomes = joining.read_outcomes(alone, policy, trials)
        cut = joining._cut(curve, outcomes, LIMIT)
        ends = np.array([[cut.lower, cut.upper]])
        p_value = stats.chi2.sf(2.0 * cut.least, 1)
        value = joining._weigh(estimate.value, estimate.standard_error, outcomes)
        if p_value < joining.CONTRADICTION_LEVEL:
            ends = np.vstack([ends, [own.lower, own.upper], outcomes.ends(LEVEL)])
            value = outcomes.mean
        lower = ends[:, 0].min()
        upper = ends[:, 1].max()
        value = min(max(value, lower), upper)
        width = upper - lower
        least = 1.0 / (1.0 / of_log + m / moments.variance)
        worth = moments.variance * (2.0 * QUANTILE / width) ** 2
        rows.append(
            {
                "family": name,
                "size": size,
                "m": m,
                "log": family.truth in own,
                "covers": lower <= family.truth <= upper,
                "width": width / (2.0 * QUANTILE * math.sqrt(least)),
                "worth": worth,
                "saved": 1.0 - m / worth,
                "error": (value - family.truth) ** 2 / moments.variance * m,
                "rejects": p_value < joining.CONTRADICTION_LEVEL,
            }
        )
    return rows


def summarise(rows):
    """The table: a row for each number of trials and size of the log."""
    frame = pd.DataFrame(rows)
    lines = []
    for (m, size), part in frame.groupby(["m", "size"]):
        medians = part.groupby("family")[["width", "worth", "saved"]].median().median()
        share = part["covers"].mean()
        lines.append(
            {
                "trials": m,
                "transitions a pair": size,
                "logs": len(part),
                "log covers": 100 * part["log"].mean(),
                "both cover": 100 * share,
                "standard error": 100 * math.sqrt(share * (1 - share) / len(part)),
                "width": medians["width"],
                "worth": medians["worth"],
                "saved": medians["saved"],
                "error": math.sqrt(part["error"].mean()),
                "contradicted": 100 * part["rejects"].mean(),
            }
        )
    return pd.DataFrame(lines).round(3)


def chosen_families(which, seed):
    """The families of a split by name, or all of the bench that are small."""
    if which == "bench":
        known = oee.bench.families()
        return {k: known[k] for k in known if known[k].simulator.n_states <= 100}
    known = families(seed)
    kinds = [kind for kind, split in SPLIT.items() if split == which]
    return {name: known[name] for kind in kinds for name in (kind, f"{kind}_far")}


def run(
    which="held",
    logs=14,
    seed=8200,
    names=None,
    say=print,
):
    """Measure ``logs`` logs of each family, each with models of its own."""
    warnings.simplefilter("ignore")
    rows = []
    started = time.monotonic()
    for repetition in range(logs):
        drawn = chosen_families(which, seed + repetition)
        for k, (name, family) in enumerate(drawn.items()):
            if names is not None and name not in names:
                continue
            for size in SIZES:
                rows += measure(family, name, size, [seed, repetition, k, size])
        say(f"{repetition + 1} of {logs}, {time.monotonic() - started:.0f} s")
        say(summarise(rows).to_string(index=False), flush=True)
    return rows


def starting_shares(which="bench", seed=8200):
    """Var V(s_0) / Var Y of each family: what a start-state control variate can save."""
    shares = {}
    for name, family in chosen_families(which, seed).items():
        model = family.target
        values = oee.state_values(model, family.policy, horizon=family.horizon)
        spread = model.initial @ values**2 - (model.initial @ values) ** 2
        whole = oee.return_moments(model, family.policy, horizon=family.horizon)
        shares[name] = max(spread, 0.0) / whole.variance
    return pd.Series(shares)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument(
        "--families", default="held", choices=("held", "tuned", "bench")
    )
    parser.add_argument("--logs", type=int, default=14)
    parser.add_argument("--seed", type=int, default=8200)
    parser.add_argument("--output")
    parser.add_argument("--starts", action="store_true")
    given = parser.parse_args()
    if given.starts:
        print(starting_shares().describe(percentiles=[0.5, 0.9]).round(3).to_string())
        sys.exit()
    table = summarise(run(given.families, given.logs, given.seed))
    print(table.to_string(index=False))
    if given.output:
        table.to_csv(given.output, index=False)

"""How narrow log and trials are together, and how often they cover.

    python tests/benchmarks/trials.py [--families held] [--logs 7] [--seed 8200]

Each family of ``oee_tabular.lab.bench.families_redrawn`` is drawn anew by the seed. Its
policy is tried 30 times in the target, and its log has 3 or 10 transitions for each
stochastic pair. Columns, as medians over the families but for the shares:

- log: the log's own interval covers, in % of the logs;
- covers: the joined interval covers, with its standard error;
- width: of the joined interval over that of the bound (1 / V_log + m / Var Y)^-1;
- worth: the number of trials alone whose interval is as narrow, at the bound;
- saved: the share of these that the log saves;
- error: the root mean squared error of the value over that of the trials' mean.

How T is corrected for few trials was chosen on the kinds that ``SPLIT`` calls tuned,
with seed 7100. The table of ``notebooks/trials.md`` is of those kept aside.
"""

import argparse
import dataclasses
import functools
import math
import time
import warnings

import numpy as np
import pandas as pd

import oee_tabular as oee
from oee_tabular.inference import trials as joining
from oee_tabular.lab.bench.families_redrawn import SPLIT
from oee_tabular.lab.bench.families_unrecorded import families
from oee_tabular.mdp import check_policy

LEVEL = 0.95
QUANTILE = 1.959963984540054
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

    @functools.cache
    def find(z):
        level = math.erf(z / math.sqrt(2.0))
        found = oee.interval(alone, policy, confidence=level)
        # only the quoted interval is joined
        return dataclasses.replace(found, sampling=None, worst_case=None)

    own = find(QUANTILE)
    rows = []
    for m in NUMBERS:
        trials = oee.Trials(tried.returns[:m])
        outcomes = joining.read_outcomes(alone, policy, trials)
        found, p_value = joining._join(find, own, outcomes, outcomes.ends(LEVEL), LEVEL)
        both = joining._describe(
            alone, policy, outcomes, found, own, outcomes.ends(LEVEL), p_value, LEVEL
        )
        least = 1.0 / (1.0 / of_log + m / moments.variance)
        worth = moments.variance * (2.0 * QUANTILE / found.width) ** 2
        rows.append(
            {
                "family": name,
                "size": size,
                "m": m,
                "log": family.truth in own,
                "covers": family.truth in found,
                "width": found.width / (2.0 * QUANTILE * math.sqrt(least)),
                "worth": worth,
                "saved": 1.0 - m / worth,
                "error": (both.value - family.truth) ** 2 / moments.variance * m,
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
    logs=7,
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


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument(
        "--families", default="held", choices=("held", "tuned", "bench")
    )
    parser.add_argument("--logs", type=int, default=7)
    parser.add_argument("--seed", type=int, default=8200)
    parser.add_argument("--output")
    given = parser.parse_args()
    table = summarise(run(given.families, given.logs, given.seed))
    print(table.to_string(index=False))
    if given.output:
        table.to_csv(given.output, index=False)

"""Differences and P(best): python tests/benchmarks/differences.py [tuned|held] [LOGS].

On the redrawn families (``oee_tabular.lab.bench.families_redrawn``) five policies are
compared from each log: the family's near and far policy, a mixture of both, and of the
far one with 3% and 10% of uniform actions, which are nearly worth the same as it. For
each pair of policies the probability that the first is better is scored by -log of what
it gives to the truth, and each interval of a difference that lies on one side of 0 is a
claim. *default*: ``compare_policies``. *maximum likelihood*: the difference of the
maximum-likelihood values over its own standard error, which was the rule before.
Left out are comparisons of which the package says that the log cannot tell, as a policy
spends much of its time in unrecorded pairs.
"""

import sys
import warnings
import zlib
from itertools import combinations

import numpy as np
import pandas as pd
from scipy.special import log_ndtr

import oee_tabular as oee
from oee_tabular.inference.asymptotic import value_covariances
from oee_tabular.inference.evidence import gather
from oee_tabular.lab.bench import families_redrawn, families_unrecorded

SIZES = (1.0, 3.0, 10.0, 30.0)
NORMAL = 1.959963984540054


def rows_of(kind, repetition):
    """Return a row for each size and pair of policies of one kind's two families."""
    every = families_unrecorded.families(repetition)
    near, far = every[kind], every[f"{kind}_far"]
    uniform = oee.uniform_policy(near.simulator)
    policies = {
        "near": near.policy,
        "far": far.policy,
        "half": 0.5 * near.policy + 0.5 * far.policy,
        "tie 3": 0.97 * far.policy + 0.03 * uniform,
        "tie 10": 0.9 * far.policy + 0.1 * uniform,
    }
    truth = {
        name: oee.policy_value(near.target, policy, horizon=near.horizon)
        for name, policy in policies.items()
    }
    for size in SIZES:
        seed = zlib.crc32(f"{kind} {size} {repetition}".encode())
        problem = near.problem(near.size(size), seed)
        found = oee.inference.compare_policies(problem, policies)
        place = {name: k for k, name in enumerate(found.names)}
        evidences = [gather(problem, policy) for policy in policies.values()]
        plain = np.array(
            [oee.policy_value(e.fitted, e.policy, horizon=e.horizon) for e in evidences]
        )
        covariance = sum(value_covariances(evidences, prior=1.0))
        for (i, one), (j, other) in combinations(enumerate(policies), 2):
            a, b = place[one], place[other]
            lower, upper = found.bounds(one, other)
            if np.isnan(lower):
                continue
            difference = truth[one] - truth[other]
            default = (
                found.values[a] - found.values[b],
                _spread(found.covariance, a, b),
                lower,
                upper,
            )
            likely = plain[i] - plain[j], _spread(covariance, i, j)
            half = NORMAL * likely[1]
            for rule, (gap, spread, low, high) in (
                ("default", default),
                ("maximum likelihood", (*likely, likely[0] - half, likely[0] + half)),
            ):
                sign = 1.0 if difference > 0 else -1.0
                score = -log_ndtr(sign * gap / max(spread, 1e-300))
                yield {
                    "kind": kind,
                    "size": size,
                    "rule": rule,
                    "is_tie": "tie" in other and ("tie" in one or one == "far"),
                    "score": float(score),
                    "is_claim": bool(low > 0 or high < 0),
                    "is_wrong": bool(min(sign * low, sign * high) < 0)
                    and bool(low > 0 or high < 0),
                    "covers": bool(low <= difference <= high),
                }


def _spread(covariance, i, j):
    """Return the standard error of a difference."""
    variance = covariance[i, i] + covariance[j, j] - 2 * covariance[i, j]
    return float(np.sqrt(max(variance, 0.0)))


def main(half="held", logs=24):
    """Print the log loss, claims and coverage by rule and size."""
    warnings.simplefilter("ignore")
    kinds = [name for name, own in families_redrawn.SPLIT.items() if own == half]
    table = pd.DataFrame(
        [
            row
            for kind in kinds
            for repetition in range(int(logs))
            for row in rows_of(kind, repetition)
        ]
    )
    keys = ["is_tie", "rule", "size"]
    groups = table.groupby(keys)
    summary = groups[["score", "is_claim", "covers"]].mean()
    summary["wrong claims"] = groups["is_wrong"].sum()
    summary["comparisons"] = groups.size()
    print(f"{half}: {len(kinds)} kinds, {logs} logs of each size")
    print(summary.round(4).to_string())


if __name__ == "__main__":
    main(*sys.argv[1:])

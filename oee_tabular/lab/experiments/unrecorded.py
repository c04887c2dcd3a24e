"""Study of the value and of its interval where pairs were never recorded.

The families are those of ``lab.bench.families_unrecorded``: 22 kinds, and 8 kinds of
faults that lie exactly where nobody recorded, each with a near and a far policy,
redrawn in each repetition. Half of each sort are *tuned*: rules and constants were
chosen on them. The others are *held*, and were run once when the choice was fixed.

    python -m oee_tabular.lab.experiments.unrecorded held --output folder --jobs 2

writes ``table.csv`` (a row a log and policy), ``value.csv`` (errors over those of
maximum likelihood), ``interval.csv`` (coverage and width) and ``kinds.csv`` (the
coverage of each kind).

*Likelihood, k*: the profile likelihood interval in which unrecorded rows lie between P
/ k and k P, P = zeta P the fitted ones, and recorded rows are bound by their counts.
*Fit, k*: the value, -+ 1.96 standard errors, widened on each side by how much worse (or
better) J can be where unrecorded rows alone leave the fitted ones by at most the factor
k. This is a robust evaluation, whose optimum is global. *squares*: the two parts are
added as squares. *recorded*: what the factor allows replaces the standard error of the
unrecorded rows, where it is more. *quoted*: *fit, 3, recorded*, but not beyond both
*sampling* and *likelihood, inf*: the interval that ``oee.interval`` gives.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

from oee_tabular._sparse import row_sums
from oee_tabular.estimators import Estimate, ModelBased, OffEnvironment, Problem
from oee_tabular.estimators.off_environment import NORMAL
from oee_tabular.exact import occupancy, policy_value, reweight
from oee_tabular.inference import profile_ascent
from oee_tabular.inference.evidence import Evidence, gather
from oee_tabular.inference.robust import extreme_value
from oee_tabular.lab.bench import families_redrawn, families_unrecorded
from oee_tabular.lab.bench.cell import facts_of
from oee_tabular.lab.bench.family import Family
from oee_tabular.lab.experiment import (
    Cell,
    Panels,
    Row,
    RunSettings,
    Stream,
    experiment,
    percent,
)
from oee_tabular.lab.run import Store, run_and_write
from oee_tabular.ratio import Conditional, TransitionRatio
from oee_tabular.shrinkage.strength import choose_strength
from oee_tabular.shrinkage.threshold import threshold
from oee_tabular.typing import Array

SPLIT = {**families_redrawn.SPLIT, **families_unrecorded.SPLIT}
FAULTS = tuple(families_unrecorded.SPLIT)
QUOTED = "quoted"
SIZES = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0)
LEAST_SIZE = 1.0  # of the logs whose intervals are computed
FACTORS = (1.0, 2.0, 3.0, 5.0, 10.0, np.inf)
# drawn directions of an ascent: with 16 instead, 2 of 120 ends moved by more than .1%
# of the width, and the study took four times as long
N_DIRECTIONS = 2
LEAST_COVERAGE = 0.88  # of a kind, both policies together
LEAST_ERROR = 0.5  # of the reference, in standard deviations of an efficient estimator


def within_factor(evidence: Evidence, fitted: Array, factor: float) -> Evidence:
    """Return the evidence in which unrecorded rows are within a factor of fitted ones.

    ``fitted`` (entries,) are the fitted rows; recorded rows stay as they are.
    """
    is_open = evidence.rows.spread(evidence.n) == 0
    if np.isinf(factor):
        return evidence
    return replace(
        evidence,
        phat=np.where(is_open, fitted, evidence.phat),
        low=np.where(is_open, fitted / factor, evidence.low),
        high=np.where(is_open, np.minimum(fitted * factor, 1.0), evidence.high),
    )


def find_extremes(
    evidence: Evidence, fitted: Array, factor: float
) -> tuple[float, float]:
    """Return the extremes of J where unrecorded rows alone leave the fitted ones."""
    is_open = evidence.rows.spread(evidence.n) == 0
    low = np.zeros(len(fitted))
    high = np.ones(len(fitted))
    if np.isfinite(factor):
        low = fitted / factor
        high = np.minimum(fitted * factor, 1.0)
    within = replace(
        evidence,
        phat=fitted,
        low=np.where(is_open, low, fitted),
        high=np.where(is_open, high, fitted),
    )
    free = np.full(len(evidence.n), np.inf)
    worst, best = (extreme_value(within, free, sign).value for sign in (-1.0, 1.0))
    return worst, best


def measure_ends(problem: Problem, policy: Array, zeta: TransitionRatio) -> Row:
    """Measure the ends of both intervals at each factor."""
    evidence = gather(problem, policy)
    fitted = zeta.values.data * problem.simulator.transitions.data
    fitted = fitted / evidence.rows.spread(evidence.rows.sums(fitted))
    found: Row = {}
    usual = profile_ascent.MAX_DRAWN_DIRECTIONS
    try:
        profile_ascent.MAX_DRAWN_DIRECTIONS = N_DIRECTIONS
        for factor in FACTORS:
            ends = profile_ascent.likelihood_ends(
                within_factor(evidence, fitted, factor), NORMAL_LEVEL
            )
            found[f"low_{factor:g}"], found[f"high_{factor:g}"] = (
                end.value for end in ends
            )
            worst, best = find_extremes(evidence, fitted, factor)
            found |= {f"worst_{factor:g}": worst, f"best_{factor:g}": best}
    finally:
        profile_ascent.MAX_DRAWN_DIRECTIONS = usual
    return found


NORMAL_LEVEL = 0.95
PARTS = {
    "model": "model_value",
    "filled": "maximum_likelihood_value",  # with fitted rows where none is recorded
    "one_step": "one_step_value",
    "se": "one_step_standard_error",
    "unrecorded_se": "unrecorded_standard_error",
    "se_fit": "standard_error_if_centre_fits",
    "unrecorded": "unrecorded_share",
    "effective": "effective_sample_size",
    "strength": "strength",
}


def parts_of(estimate: Estimate) -> Row:
    """Return the numbers that the default's value is made of."""
    facts: Mapping[str, Any] = estimate.diagnostics
    parts = {name: float(facts.get(given, np.nan)) for name, given in PARTS.items()}
    return {"value": estimate.value, **parts}


def measure_gain(problem: Problem, zeta: TransitionRatio) -> float:
    """Return by how much the log evidence of the tilt is above the simulator's."""
    influence = zeta._influence
    if influence is None or influence.prior is None:
        return 0.0
    rows = influence.rows
    own = choose_strength(influence.counts, rows.weights, rows)
    tilted = choose_strength(influence.counts, influence.prior.at(rows), rows)
    return tilted.score - own.score


def measure_thickness(problem: Problem, zeta: TransitionRatio, policy: Array) -> float:
    """Return how many transitions a recorded pair has, by the policy's squared time."""
    model = reweight(problem.model, zeta)
    time = occupancy(model, policy, horizon=problem.horizon)
    n = row_sums(problem.counts)
    has_data = (n > 0) & (np.diff(problem.model.transitions.indptr) > 1)
    d = time.reshape(-1)[has_data]
    return float((d**2).sum() / (d**2 / n[has_data]).sum())


def measure(family: Family, problem: Problem, *, has_intervals: bool = True) -> Row:
    """Measure value and intervals of a family's policy on a log."""
    policy = family.policy
    zeta = OffEnvironment().fit(problem, policy, np.random.default_rng(0))
    fixed = OffEnvironment(ratio=Conditional(prior="simulator"))(problem, policy)
    row: Row = {
        **parts_of(OffEnvironment(ratio=zeta)(problem, policy)),
        "likelihood": ModelBased(fallback="simulator")(problem, policy).value,
        "simulator": policy_value(family.simulator, policy, horizon=family.horizon),
        "centred": fixed.value,
        "gain": measure_gain(problem, zeta),
        "thickness": measure_thickness(problem, zeta, policy),
    }
    if has_intervals:
        row |= measure_ends(problem, policy, zeta)
    return row


# ---- the rules, from the parts of a row


def move(row: Any, *, cap: float = np.inf, has_rho: bool = False) -> float:
    """Return the default's value by a rule for its change towards the log.

    ``cap`` is the largest ratio of the change to the nearer value's; ``has_rho`` lets
    it go to maximum likelihood where the prior hardly narrows the standard error.
    """
    recorded = np.sqrt(max(row.se**2 - row.unrecorded_se**2, 0.0))
    shared = min(row.se_fit / recorded, 1.0) if recorded > 0 else 1.0
    s = recorded * np.sqrt(1.0 - shared**2)
    one_step = row.one_step - row.model
    filled = row.filled - row.model
    change = 0.0
    if one_step * filled > 0:
        near = min(one_step, filled, key=abs)
        distance = abs(near) / s if s > 0 else np.inf
        share = np.clip((distance - 2.0) / 2.0, 0.0, 1.0)
        if has_rho and row.unrecorded < 0.02 and recorded > 0:
            share = max(share, np.clip((row.se_fit / recorded - 0.6) / 0.2, 0.0, 1.0))
        change = near + share * (filled - near)
        change = np.sign(change) * min(abs(change), cap * abs(near))
    rest = min(abs(change), threshold(s, row.se_fit) * s)
    return float(row.model + np.sign(change) * (abs(change) - rest))


def values_by_rule(table: pd.DataFrame) -> dict[str, Any]:
    """Return the values of each rule."""
    rows = list(table.itertuples())

    def rule(**options: Any) -> Array:
        """Return the default's values by a rule."""
        return np.array([move(row, **options) for row in rows])

    return {
        "default": table.value,
        "lengthened freely": rule(),
        "at most three times": rule(cap=3.0),
        "at most twice": rule(cap=2.0),
        "not lengthened": rule(cap=1.0),
        "rho": rule(has_rho=True),
        "rho, at most twice": rule(has_rho=True, cap=2.0),
        "gate": np.where(table.gain < 7.0, table.centred, table.value),
        "gate, at most twice": np.where(table.gain < 7.0, table.centred, rule(cap=2.0)),
        "one-step": table.one_step,
        "simulator": table.simulator,
        "maximum likelihood": table.likelihood,
    }


def intervals_by_rule(table: pd.DataFrame) -> dict[str, tuple[Any, Any]]:
    """Return the ends of each rule, around the value lengthened at most twice."""
    value = np.array([move(row, cap=2.0) for row in table.itertuples()])
    half = NORMAL * table.se
    recorded = NORMAL * np.sqrt(np.maximum(table.se**2 - table.unrecorded_se**2, 0.0))
    lower = np.minimum(value, table.likelihood)
    upper = np.maximum(value, table.likelihood)
    ends: dict[str, tuple[Any, Any]] = {
        "sampling today": (table.value - half, table.value + half),
        "sampling": (value - half, value + half),
        "hull 1.8": (lower - 1.8 * table.se, upper + 1.8 * table.se),
    }
    for factor in FACTORS:
        k = f"{factor:g}"
        ends[f"likelihood {k}"] = table[f"low_{k}"], table[f"high_{k}"]
    for factor in FACTORS[1:]:
        k = f"{factor:g}"
        below = np.maximum(table.worst_1 - table[f"worst_{k}"], 0.0)
        above = np.maximum(table[f"best_{k}"] - table.best_1, 0.0)
        ends[f"fit {k}"] = value - half - below, value + half + above
        ends[f"fit {k}, squares"] = (
            value - np.hypot(half, below),
            value + np.hypot(half, above),
        )
        ends[f"fit {k}, recorded"] = (
            value - np.maximum(half, recorded + below),
            value + np.maximum(half, recorded + above),
        )
        below = np.maximum(table.low_1 - table[f"low_{k}"], 0.0)
        above = np.maximum(table[f"high_{k}"] - table.high_1, 0.0)
        ends[f"likelihood {k}, around the value"] = (
            value - half - below,
            value + half + above,
        )
    low, high = ends["likelihood 3"]
    ends["likelihood 3 and sampling"] = (
        np.minimum(low, value - half),
        np.maximum(high, value + half),
    )
    # what oee.interval gives: never beyond both of its ends
    low, high = ends["fit 3, recorded"]
    ends[QUOTED] = (
        np.maximum(low, np.minimum(value - half, table.low_inf)),
        np.minimum(high, np.maximum(value + half, table.high_inf)),
    )
    return ends


# ---- the tables


def compare_values(table: pd.DataFrame) -> pd.DataFrame:
    """Return the errors of each rule over maximum likelihood's and the reference's.

    The reference is the better one of maximum likelihood and simulator, at least half
    the standard deviation of an efficient estimator.
    """
    rows = table[table.sort == "ordinary"]
    scale = np.sqrt(rows.bound)
    squares = pd.DataFrame(
        {
            name: ((value - rows.truth) / scale) ** 2
            for name, value in values_by_rule(rows).items()
        },
        index=rows.index,
    )
    keys = [rows[name] for name in ("family", "policy", "size")]
    cells = squares.groupby(keys).mean() ** 0.5
    reference = np.minimum(cells["maximum likelihood"], cells["simulator"])
    found = {}
    for over, divisor in (
        ("likelihood", cells["maximum likelihood"]),
        ("reference", np.maximum(reference, LEAST_ERROR)),
    ):
        ratio = cells.div(divisor, axis=0)
        found[over, "mean"] = ratio.map(np.log).groupby("size").mean().map(np.exp)
        found[over, "worst"] = ratio.groupby("size").max()
    parts = [
        ratio.T.rename_axis(index="rule", columns=None).assign(over=over, what=what)
        for (over, what), ratio in found.items()
    ]
    whole: pd.DataFrame = pd.concat(parts).reset_index()
    return whole.set_index(["over", "what", "rule"])


def is_surely_below(covered: Any, least: float = LEAST_COVERAGE) -> bool:
    """Return whether a share is surely (95%, one-sided) below a number."""
    return bool(stats.binom.cdf(covered.sum(), covered.count(), least) < 0.05)


def compare_intervals(table: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return coverage and width of each rule, and the coverage of each kind.

    Widths are over those of an efficient estimator's interval, the median over the
    cells of the medians; faults have none, since nothing is efficient there.
    """
    rows = table[table["size"] >= LEAST_SIZE]
    efficient = 2 * NORMAL * np.sqrt(rows.bound)
    parts = []
    for name, (lower, upper) in intervals_by_rule(rows).items():
        parts.append(
            rows[["family", "sort", "policy", "size"]].assign(
                rule=name,
                covered=((lower <= rows.truth) & (rows.truth <= upper)).astype(float),
                width=(upper - lower) / efficient,
            )
        )
    long = pd.concat(parts)
    by = long.groupby(["sort", "rule", "size"], sort=False)
    cells = long.groupby(["sort", "rule", "size", "family", "policy"], sort=False)
    kinds = long.groupby(["sort", "rule", "size", "family"], sort=False).covered
    each = kinds.agg(["mean", is_surely_below])
    summary = pd.DataFrame(
        {
            "covers": by.covered.mean(),
            "width": cells.width.median().groupby(["sort", "rule", "size"]).median(),
            "wide": by.width.quantile(0.9),
            "least": each["mean"].groupby(["sort", "rule", "size"]).min(),
            "surely_below": each["is_surely_below"]
            .groupby(["sort", "rule", "size"])
            .sum(),
        }
    )
    whole = long.groupby(["sort", "rule", "family"], sort=False).covered
    return summary.reset_index(), whole.agg(["mean", is_surely_below]).reset_index()


def find(table: pd.DataFrame) -> str:
    """Write coverage and width of the interval at factor 3."""
    summary, _ = compare_intervals(table)
    ours = summary[summary.rule == "fit 3"].groupby("sort").covers.mean()
    return (
        "Within a factor of 3 of the fit where nothing was recorded the interval covers"
        f" {percent(ours.get('ordinary', np.nan))}, with faults there"
        f" {percent(ours.get('fault', np.nan))}"
    )


@experiment(
    "The value and its interval where pairs were never recorded",
    axes={"family": tuple(SPLIT), "size": SIZES},
    smoke={"family": ("worn_out",), "size": (1.0,)},
    repetitions=24,
    group="sureness",
    keys=("families", "sort", "size"),
    measures=("value", "se", "unrecorded"),
    finding=find,
    draw=Panels("unrecorded", curves="families", x="size", by=("sort",)),
)
def unrecorded(settings: Cell, stream: Stream) -> list[Row]:
    """Both policies of a kind on one log. The models are drawn anew by the
    repetition.
    """
    name = str(settings["family"])
    every = families_unrecorded.families(stream.seed + int(settings["repetition"]))
    size = float(settings["size"])
    near = every[name]
    problem = near.problem(near.size(size), stream.generator())
    rows = []
    for policy, family in (("near", near), ("far", every[f"{name}_far"])):
        facts = facts_of(family, problem)
        row: Row = {
            "policy": policy,
            "families": SPLIT[name],
            "sort": "fault" if name in FAULTS else "ordinary",
        }
        row |= {key: facts[key] for key in ("n", "truth", "covered", "bound")}
        rows.append(row | measure(family, problem, has_intervals=size >= LEAST_SIZE))
    return rows


def write(store: Store) -> None:
    """Write the tables of a run."""
    table = store.table()
    summary, kinds = compare_intervals(table)
    values = compare_values(table)
    for name, frame in (
        ("table", table),
        ("value", values.reset_index()),
        ("interval", summary),
        ("kinds", kinds),
    ):
        frame.to_csv(store.folder / f"{name}.csv", index=False)
    print(values.round(3).to_string())
    wide = summary.pivot_table(index=["sort", "rule"], columns="size", sort=False)
    print(wide.round(3).to_string())


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one half of the families, and write and print its tables."""
    parser = argparse.ArgumentParser(description="Value and interval, by half.")
    parser.add_argument("half", choices=("tuned", "held", "all"))
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=unrecorded.repetitions)
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args(arguments)
    names = tuple(name for name, half in SPLIT.items() if given.half in (half, "all"))
    settings = RunSettings(
        unrecorded, {"family": names, "size": SIZES}, given.seeds, seed=0
    )
    run_and_write(given.output, settings, write, say=print, jobs=given.jobs)


if __name__ == "__main__":
    main()

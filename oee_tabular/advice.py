"""Plain-language warnings: what a result does not tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from oee_tabular import _printing
from oee_tabular.estimators import Estimate, Problem


@dataclass(frozen=True)
class Finding:
    """Something to know about one estimator's value of one policy.

    ``text`` holds ``{}`` where the figure stands; findings of one kind about several policies are told in one sentence,
    with the figure that is worst.
    """

    kind: str
    estimator: str
    policy: str
    severity: float
    figure: str
    text: str


def about_problem(problem: Problem) -> list[tuple[str, bool]]:
    """What is odd about the data, whatever the policy; and whether it concerns every value that a model gives."""
    found = []
    conflict = problem.reward_conflict
    if conflict is not None:
        if problem.rewards == "simulator":
            remedy = (
                'The simulator, oee and model-based values pay the simulator\'s; rewards="log" (--rewards log) pays what the '
                "log has seen."
            )
        else:
            remedy = "The oee and model-based values pay the log's mean where it has seen a move."
        text = str(conflict)
        found.append((f"{text[0].upper()}{text[1:]}. {remedy}", problem.rewards == "simulator"))
    differ = problem.behavior_conflict
    if differ:
        found.append(
            (f"The log's behaviour probabilities are used; they differ from behavior_policy in {differ} rows.", False)
        )
    if problem.simulator.discount == 1.0 and problem.horizon is None:
        found.append(
            ("At discount 1 without a horizon there is no coverage, and no standard error of a model's value.", False)
        )
    return found


def about_estimate(policy: str, estimator: str, estimate: Estimate, scale: float = 1.0) -> list[Finding]:
    """What a reader must know before using this number; ``scale`` multiplies values that are shown."""
    facts = estimate.diagnostics
    silent = estimate.standard_error is None and estimate.status == "ok" and bool(facts.get("standard_error_of"))
    no_interval = estimate.interval is None and (estimate.standard_error is not None or silent)
    bare = estimate.standard_error is not None and "one_step_distance" not in facts  # unseen rows are not in it
    found: list[Finding] = []

    def add(kind: str, severity: float, figure: str, text: str) -> None:
        found.append(Finding(kind, estimator, policy, severity, figure, text))

    if estimate.status != "ok":
        finite = abs(estimate.value) < float("inf")
        add("status", 1.0, estimate.status, "do not rely on the value: {}." if finite else "no value: {}.")
    fallback = facts.get("fallback_share", 0.0)
    if fallback > 0.02:
        add(
            "coverage",
            fallback,
            f"{fallback:.0%}",
            "{} of the policy's discounted time is spent in state-action pairs that the log has never seen. "
            + (
                "What is said of them comes from moves of the same kind elsewhere (the tie)."
                if "n_keys" in facts
                else "Nothing there is learned from the target"
                + (", and the standard error does not cover it" if bare else "")
                + (": there is no interval." if no_interval else ".")
            ),
        )
    single = facts.get("single_share", 0.0)
    if no_interval and silent and single <= 0.02:
        add(
            "constant",
            1.0,
            "no standard error",
            "there is {} and no interval: what was seen never varied, which does not make the value certain.",
        )
    if no_interval and single > 0.02:
        add(
            "single",
            single,
            f"{single:.0%}",
            "{} of the policy's discounted time is spent in state-action pairs with one recorded move, whose variance is not "
            "known: there is no interval.",
        )
    uncovered = facts.get("uncovered_mass", 0.0)
    if uncovered > 0.01:
        add(
            "support",
            uncovered,
            f"{uncovered:.1%}",
            "{} of the log's moves have probability 0 in the plain simulator, where no ratio exists; what is said of them "
            f"rests on the defensive share (largest zeta {facts['largest_zeta']:.3g}, D_inf {facts['d_inf']:.2g} nats). "
            "A simulator under parameters that bracket the target (tasks.defensive_mixture), process noise or wider cells "
            "would cover them.",
        )
    row_sum = facts.get("row_sum_error", 0.0)
    if row_sum > 1e-3:
        add(
            "row sums",
            row_sum,
            f"{row_sum:.2g}",
            "the rows of zeta * P miss 1 by up to {}; over a horizon such errors multiply. The row-normalised ratio (oee) does "
            "not have them.",
        )
    samples = facts.get("n_episodes", facts.get("n_rollouts"))
    effective = facts.get("effective_sample_size", float("inf"))
    if samples is not None and effective < max(10.0, 0.05 * samples):
        noun = "episodes" if "n_episodes" in facts else "rollouts"
        add(
            "weights",
            -effective,
            f"{effective:.1f}",
            f"the weights rest on about {{}} of {samples} {noun}: the value is largely chance, its standard error too small.",
        )
    bound = facts.get("truncation_bias_bound", 0.0)
    reach = f"by up to {bound:.3g} (as a discounted sum)" if bound < float("inf") else "without bound at discount 1"
    if bound > max(1e-3 * abs(estimate.value), 0.1 * (estimate.standard_error or 0.0)):
        add(
            "truncation",
            bound,
            reach,
            f"{round(facts['truncated_share'] * facts['n_episodes'])} of {facts['n_episodes']} episodes were cut before they "
            "were over; what they lack can change the value {}.",
        )
    foreign = facts.get("foreign_starts_share", 0.0)
    if foreign > 0:
        add(
            "starts",
            foreign,
            f"{foreign:.0%}",
            "{} of the episodes start where the simulator never does; importance sampling estimates the value from the log's "
            "own starts.",
        )
    moved = facts.get("moved", 0.0)
    if moved > 0:
        add(
            "against",
            moved,
            f"{moved:.0%}",
            "the log speaks against every kind of change that was tried along this policy, so the value is moved by {} "
            "from the corrected simulator towards what the log alone says. If you know what may differ, say it: features of "
            "moves (features=, on the command line --features) or moves that are alike (tie=, --tie).",
        )
    if "replaced_value" in facts and estimate.interval is not None:
        replaced, (lower, upper) = facts["replaced_value"], estimate.interval
        add(
            "outside",
            max(lower - replaced, replaced - upper),
            format(replaced * scale, _printing.spec(lower * scale, upper * scale)),
            f"the estimator's own value, {{}}, lies outside the interval that the log allows; {facts['replaced_by']} stands in "
            "its place.",
        )
    gap = facts.get("gap", 0.0)
    if gap > 1e-6:
        add("gap", gap, f"{gap:.1e}", "the ratio's program is solved only to a gap of {} nats.")
    error_bound = facts.get("error_bound", 0.0)
    if error_bound > 1e-6 * max(1.0, abs(estimate.value)):
        add("linear algebra", error_bound, f"{error_bound:.1e}", "the linear algebra is certain only to {}.")
    return found


def sentences(findings: Sequence[Finding]) -> list[tuple[str, frozenset[tuple[str, str]]]]:
    """One sentence per kind and estimator, with the (policy, estimator) pairs that it is about."""
    groups: dict[tuple[str, str, str], list[Finding]] = {}
    for finding in findings:
        groups.setdefault((finding.estimator, finding.kind, finding.text), []).append(finding)
    told = []
    for (estimator, _, text), members in groups.items():
        worst = max(members, key=lambda finding: finding.severity)
        figure = worst.figure if len(members) == 1 else f"{worst.figure} ({worst.policy} is the worst)"
        names = ", ".join(finding.policy for finding in members)
        told.append(
            (f"{estimator} ({names}): {text.format(figure)}", frozenset((f.policy, estimator) for f in members))
        )
    return told

"""``evaluate``: policies by estimators, with what a reader must know; ``contest``:
which policy is best.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from oee_tabular import _checks, _progress
from oee_tabular._parallel import one_thread
from oee_tabular.estimators import Estimator, Problem
from oee_tabular.estimators.findings import (
    FEW_WEIGHTED,
    MADE_FROM_LOG,
    WEIGHTLESS,
    Finding,
)
from oee_tabular.estimators.functions import as_estimator
from oee_tabular.estimators.names import default_names, named_estimators
from oee_tabular.exact import Model, action_values, occupancy, policy_value
from oee_tabular.exceptions import ArgumentError
from oee_tabular.inference.comparison import several_policies
from oee_tabular.inference.evidence import gather
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.policies import check_policies
from oee_tabular.report import text
from oee_tabular.report.results import Report, Result, first_results
from oee_tabular.report.uncertainty import (
    LIKELIHOOD,
    SHARED,
    Premises,
    add_comparison,
    choose_interval,
    find_intervals,
)
from oee_tabular.typing import Array, Seed


@one_thread
def evaluate(
    problem: Problem,
    policies: object,
    *,
    estimators: Sequence[str | Estimator] | Mapping[str, Estimator] | None = None,
    confidence: float = 0.95,
    seed: Seed = None,
    normalized: bool = False,
    target: FiniteMDP | None = None,
    facts: Mapping[str, Any] | None = None,
    guaranteed: bool = False,
    quick: bool = False,
    **assumed: Any,
) -> Report:
    """Evaluate policies in the target by several estimators.

    Parameters
    ----------
    problem : Problem
    policies : a policy in any of its forms (``mdp.check_policy``: (S, A), (S,) actions,
        by state, a function), a list of such, or a mapping name -> policy
    estimators : names, estimators, or a mapping name -> estimator; None: the simulator,
        off-environment evaluation, the model-based baseline, and importance sampling
        where the log allows it
    confidence : level of the intervals
    seed : int, or anything that ``numpy.random.SeedSequence`` takes; every (policy,
        estimator) has a stream of its own
    normalized : whether the report multiplies by (1 - discount)
    target : the true target, where it is known (teaching, research): adds its exact
        values and the errors
    guaranteed : whether the intervals that hold at any sample size are computed too
        (``interval(method="robust")``)
    quick : whether likelihood intervals, most of the time of large problems, are left
        out
    assumed : what you know about the target, by the keywords lower_ratio, upper_ratio,
        tie and features (as in ``inference.interval``): a box narrows likelihood and
        guaranteed intervals and comparisons; a tie, or features, adds a row (oee-tied,
        oee-features) with the interval of its own model
    facts : more to keep in the report's ``facts`` (names of files, how the simulator
        was changed)

    Returns
    -------
    Report
        Estimates with their intervals, in the order policy, estimator; warnings in
        plain language; ``uncertainty``. A value that the log corrects and that lies
        outside the likelihood interval is replaced by the nearer end.
        ``diagnostics["interval_method"]`` names the interval.

    Raises
    ------
    ValueError
        Bad arguments, and what the estimators that were asked for raise.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> pair = oee.testing.case("ragged")
    >>> report = evaluate(pair.problem(1000, seed=0), {"new": pair.policy}, estimators=["simulator", "wpdis"], seed=0)
    >>> report.table[["policy", "estimator", "value"]].round(2).values.tolist()
    [['new', 'simulator', 7.97], ['new', 'wpdis', 10.57]]
    >>> report.uncertainty.sentences[0]
    'The data reject the simulator in 6 of the 6 recorded state-action pairs.'
    """
    _checks.instance(problem, Problem, "problem", "Problem(simulator, log, ...)")
    for flag, name in (
        (normalized, "normalized"),
        (guaranteed, "guaranteed"),
        (quick, "quick"),
    ):
        _checks.boolean(flag, name)
    if quick and guaranteed:
        raise ArgumentError(
            "guaranteed", "must be False where quick is True: it leaves intervals out"
        )
    if facts is not None:
        _checks.instance(facts, Mapping, "facts")
    simulator = problem.simulator
    if target is not None:
        _checks.instance(target, FiniteMDP, "target")
        if target.transitions.shape != simulator.transitions.shape:
            raise ArgumentError(
                "target",
                f"must have the simulator's {simulator.n_states} states and"
                f" {simulator.n_actions} actions; it has {target.n_states} and"
                f" {target.n_actions}",
            )
    level = _checks.number_in(confidence, "confidence", 0.0, 1.0, open_ends=True)
    if normalized and simulator.discount == 1.0:
        raise ArgumentError(
            "normalized",
            "must be False at discount 1: the factor (1 - discount) would be 0",
        )
    named = check_policies(policies, simulator, name="policy")
    if not named:
        raise ArgumentError("policies", "must hold at least one; it is empty")
    known = Premises(**assumed)
    if quick and str(known):
        raise ArgumentError(
            "quick",
            "must be False with lower_ratio or upper_ratio: it leaves out the intervals"
            " that they narrow",
        )
    chosen, left_out = _choose_estimators(problem, estimators, target)
    truth = {}
    if target is not None:
        truth = {
            name: policy_value(target, pi, horizon=problem.horizon)
            for name, pi in named.items()
        }
    scale = 1.0 - simulator.discount if normalized else 1.0
    with _progress.show_steps(only_terminal=True):
        results = _run_estimators(problem, named, chosen | known.estimators, seed)
        hidden: frozenset[tuple[str, str]] = frozenset()
        if estimators is None:
            results, reasons = _drop_weightless(results)
            left_out += reasons
            uncertain = (
                r
                for r in results
                if any(f.kind == FEW_WEIGHTED for f in r.estimate.findings)
            )
            hidden = frozenset((r.policy, r.estimator) for r in uncertain)
        uncertainty = find_intervals(
            problem, named, level, known, guaranteed=guaranteed, quick=quick
        )
        for k, result in enumerate(results):
            key = SHARED if result.estimator in known.estimators else LIKELIHOOD
            likelihood = uncertainty.intervals.get(result.policy, {}).get(key)
            results[k] = replace(
                result,
                estimate=choose_interval(result.estimate, likelihood, level, scale),
            )
        front = {
            name: result.estimate for name, result in first_results(results).items()
        }
        uncertainty = add_comparison(
            uncertainty, problem, named, level, known, front, scale
        )
    models = [
        (r.policy, r.estimator) for r in results if not r.estimate.is_from_episodes
    ]
    warnings_and_rows: list[tuple[str, list[Pair]]] = [
        (sentence, []) for sentence in left_out
    ]
    warnings_and_rows += [
        (str(finding), models if finding.severity > 0 else [])
        for finding in problem.findings
    ]
    warnings, notes = number_notes(
        results, [*warnings_and_rows, *group_findings(results)]
    )
    about = {
        "simulator": repr(simulator),
        "log": problem.log.describe(),
        "rewards": problem.rewards,
    }
    about |= {"target": str(known)} if str(known) else {}
    return Report(
        tuple(results),
        truth,
        warnings,
        notes,
        level,
        normalized,
        simulator.discount,
        problem.horizon,
        seed,
        about | dict(facts or {}),
        uncertainty,
        problem,
        named,
        hidden,
    )


def contest(problem: Problem, policies: object, **options: Any) -> Report:
    """Compare policies on one log: ``evaluate`` by off-environment evaluation alone,
    which is exact; of two or more policies.

    Parameters
    ----------
    problem : Problem
    policies : two or more, as for ``evaluate``
    options : confidence (of the values' intervals, and of all differences from the best
        together), quick, lower_ratio, upper_ratio, tie, features, as for ``evaluate``

    Returns
    -------
    Report
        ``best`` is the policy that is worth most, None where the log cannot say;
        ``comparison()`` has the differences.

    Raises
    ------
    ValueError
        Fewer than two policies; discount 1 without a horizon; bad arguments.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> pair = oee.testing.case("ragged")
    >>> found = contest(pair.problem(1000, seed=0), {"new": pair.policy, "recorded": pair.behavior})
    >>> print(found.headline)
    Of 2 policies, “new” is worth most in the target. It is better than “recorded” by 3.255 (95%: 3.134 to 3.389).
    >>> [round(found.comparison()[1][key], 2) for key in ("less_by", "less_by_lower", "less_by_upper")]
    [3.26, 3.13, 3.39]
    """
    _checks.instance(problem, Problem, "problem", "Problem(simulator, log, ...)")
    several_policies(policies, problem.simulator)
    if problem.simulator.discount == 1.0 and problem.horizon is None:
        raise ArgumentError("horizon", "must be given at discount 1")
    return evaluate(problem, policies, estimators=["oee"], seed=0, **options)


def is_best_in_log(problem: Problem, policy: Array) -> bool:
    """Whether the policy is optimal in the log's own model, without a horizon, and not
    in the simulator.

    The log's own model has its frequencies, and the simulator's rows where there are
    none.
    """
    if problem.simulator.discount == 1.0:
        return False
    evidence = gather(problem, policy)
    return _is_optimal(evidence.fitted, policy) and not _is_optimal(
        problem.model, policy
    )


def _is_optimal(model: Model, policy: Array) -> bool:
    """Whether no action is better than the policy's own in any state that it reaches."""
    values = action_values(model, policy)
    lost = values.max(axis=1) - (policy * values).sum(axis=1)
    reached = occupancy(model, policy).sum(axis=1) > 0
    return bool(lost[reached].max() <= 1e-9 * max(1.0, float(np.abs(values).max())))


def _choose_estimators(
    problem: Problem,
    estimators: Sequence[str | Estimator] | Mapping[str, Estimator] | None,
    target: FiniteMDP | None,
) -> tuple[dict[str, Estimator], list[str]]:
    """The estimators by name, and sentences on those that are left out."""
    if estimators is None:
        names, left_out = default_names(problem)
        return named_estimators(names, target), left_out
    chosen: dict[str, Estimator] = {}
    if isinstance(estimators, Mapping):
        for name, estimator in estimators.items():
            _checks.function(estimator, f"estimators[{name!r}]")
        chosen |= estimators
    else:
        several = (estimators,) if isinstance(estimators, str) else estimators
        for item in _checks.collection(several, "estimators", "names or estimators"):
            if isinstance(item, str):
                chosen |= named_estimators([item], target)
            elif callable(item):
                label = type(item).__name__
                while label in chosen:
                    label += "'"
                chosen[label] = item
            else:
                raise ArgumentError(
                    "estimators",
                    f"must be names or callables; got {_checks.show(item)}",
                )
    if not chosen:
        raise ArgumentError("estimators", "must name at least one; it is empty")
    return chosen, []


def _run_estimators(
    problem: Problem,
    policies: Mapping[str, Array],
    chosen: Mapping[str, Estimator],
    seed: Any,
) -> list[Result]:
    """Every estimate of every policy; of a policy that was made from the log with a
    finding about that.
    """
    results = []
    for i, (name, policy) in enumerate(policies.items()):
        is_from_log = is_best_in_log(problem, policy)
        for j, (label, estimator) in enumerate(chosen.items()):
            _progress.report_step(
                f"{label} of “{name}” (policy {i + 1} of {len(policies)})"
            )
            # functions are taken, too
            run = as_estimator(estimator, f"estimators[{label!r}]")
            estimate = run(problem, policy, seed=_checks.seed_sequence(seed, (i, j)))
            if is_from_log and estimate.is_from_log and estimate.status == "ok":
                estimate = replace(
                    estimate, findings=(MADE_FROM_LOG, *estimate.findings)
                )
            results.append(Result(name, label, estimate))
    return results


def _drop_weightless(results: Sequence[Result]) -> tuple[list[Result], list[str]]:
    """Without importance sampling that has no positive weight, and a sentence about
    that.
    """
    kept = [result for result in results if WEIGHTLESS not in result.estimate.findings]
    lost = [result for result in results if WEIGHTLESS in result.estimate.findings]
    names = ", ".join(dict.fromkeys(result.policy for result in lost))
    return kept, (
        [text.MISSING_WEIGHTS.format(names, lost[0].estimate.status)] if lost else []
    )


Pair = tuple[str, str]  # (policy, estimator)
N_FIGURES = 3  # of policies, the worst ones, that a note gives


def group_findings(results: Sequence[Result]) -> list[tuple[str, list[Pair]]]:
    """One sentence for all findings of one kind and text, with the (policy, estimator)
    that it is about.
    """
    groups: dict[tuple[str, str], list[tuple[Finding, str, str]]] = {}
    for result in results:
        for finding in result.estimate.findings:
            group = groups.setdefault((finding.kind, finding.text), [])
            group.append((finding, result.policy, result.estimator))
    sentences = []
    for members in groups.values():
        # the policies it is said of -> the estimators
        by_policies: dict[tuple[str, ...], list[str]] = {}
        for label in dict.fromkeys(member[2] for member in members):
            own = tuple(member[1] for member in members if member[2] == label)
            by_policies.setdefault(own, []).append(label)
        about = "; ".join(
            f"{', '.join(labels)} ({', '.join(own)})"
            for own, labels in by_policies.items()
        )
        # the worst of each policy, or of each estimator of a single one
        figures: dict[str, str] = {}
        several = len({policy for _, policy, _ in members}) > 1
        worst = sorted(members, key=lambda member: -member[0].severity)
        for finding, policy, label in worst:
            figures.setdefault(policy if several else label, finding.figure)
        listed = ", ".join(
            f"{figure} ({name})" for name, figure in list(figures.items())[:N_FIGURES]
        )
        figure = worst[0][0].figure if len(set(figures.values())) == 1 else listed
        sentences.append(
            (
                f"{about}: {worst[0][0].sentence(figure)}",
                [member[1:] for member in members],
            )
        )
    return sentences


def number_notes(
    results: Iterable[Result], warnings: Sequence[tuple[str, Collection[Pair]]]
) -> tuple[tuple[str, ...], dict[Pair, tuple[int, ...]]]:
    """The sentences, numbered from 1, and the numbers of those that are about each
    (policy, estimator).
    """
    every = [(result.policy, result.estimator) for result in results]
    notes = {
        pair: tuple(
            k for k, (_, pairs) in enumerate(warnings, start=1) if pair in pairs
        )
        for pair in every
    }
    return tuple(sentence for sentence, _ in warnings), notes

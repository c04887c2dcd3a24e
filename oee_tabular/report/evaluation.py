"""``evaluate``: policies by estimators, with what a reader must know; ``contest``: which policy is best."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from oee_tabular import _checks, _progress
from oee_tabular._checks import Array, Seed
from oee_tabular._threads import one_thread
from oee_tabular.estimators import Estimate, Estimator, Problem
from oee_tabular.estimators.findings import MADE_FROM_LOG, WEIGHTLESS
from oee_tabular.estimators.names import default_names, named_estimators
from oee_tabular.exact import Model, action_values, occupancy, policy_value
from oee_tabular.inference.comparison import several_policies
from oee_tabular.inference.evidence import gather
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.policies import check_policies
from oee_tabular.report import text
from oee_tabular.report.assumptions import Assumptions
from oee_tabular.report.interval_choice import choose_interval, group_findings
from oee_tabular.report.results import Report, Result, headline
from oee_tabular.report.uncertainty import LIKELIHOOD, SHARED, assess, with_values


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
    policies : a policy in any of its forms (``mdp.check_policy``: (S, A), (S,) actions, by state, a function), a list of such,
        or a mapping name -> policy
    estimators : names, estimators, or a mapping name -> estimator; None: the simulator, off-environment evaluation, the
        model-based baseline, and importance sampling where the log allows it
    confidence : level of the intervals
    seed : int, or anything that ``numpy.random.SeedSequence`` takes; every (policy, estimator) has a stream of its own
    normalized : whether the report multiplies by (1 - discount)
    target : the true target, where it is known (teaching, research): adds its exact values and the errors
    guaranteed : whether the intervals that hold at any sample size are computed too (``interval(method="robust")``)
    quick : whether likelihood intervals, most of the time of large problems, are left out
    assumed : what you know about the target, by the keywords lower_ratio, upper_ratio, tie and features (as in
        ``inference.interval``): a box narrows likelihood and guaranteed intervals and comparisons; a tie, or features, adds
        a row (oee-tied, oee-features) with the interval of its own model
    facts : more to keep in the report's ``facts`` (names of files, how the simulator was changed)

    Returns
    -------
    Report
        Estimates with their intervals, in the order policy, estimator; warnings in plain language; ``uncertainty``. A value
        that the log corrects and that lies outside the likelihood interval is replaced by the nearer end.
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
    >>> report.uncertainty.sentences[0].split(":")[0]
    'The target differs from the simulator'
    """
    _checks.boolean(normalized, "normalized")
    _checks.boolean(guaranteed, "guaranteed")
    if _checks.boolean(quick, "quick") and guaranteed:
        raise ValueError("guaranteed must be False where quick is True: it leaves intervals out")
    if quick and {"lower_ratio", "upper_ratio"} & {name for name, value in assumed.items() if value is not None}:
        raise ValueError(
            "quick must be False with lower_ratio or upper_ratio: it leaves out the intervals that they narrow"
        )
    _checks.instance(problem, Problem, "problem", "Problem(simulator, log, ...)")
    if target is not None:
        _checks.instance(target, FiniteMDP, "target")
    if facts is not None:
        _checks.instance(facts, Mapping, "facts")
    if target is not None and target.transitions.shape != problem.simulator.transitions.shape:
        raise ValueError(
            f"target must have the simulator's {problem.simulator.n_states} states and {problem.simulator.n_actions} actions; "
            f"it has {target.n_states} and {target.n_actions}"
        )
    level = _checks.number_in(confidence, "confidence", 0.0, 1.0, open_ends=True)
    if normalized and problem.simulator.discount == 1.0:
        raise ValueError("normalized must be False at discount 1: the factor (1 - discount) would be 0")
    named_policies = check_policies(policies, problem.simulator, name="policy")
    if not named_policies:
        raise ValueError("policies must hold at least one; it is empty")
    assumptions = Assumptions(**assumed)
    own = assumptions.estimators()
    chosen, left_out = _choose_estimators(problem, estimators, target)
    chosen |= own
    truth = {}
    if target is not None:
        truth = {name: policy_value(target, pi, horizon=problem.horizon) for name, pi in named_policies.items()}
    scale = 1.0 - problem.simulator.discount if normalized else 1.0
    with _progress.show_steps(only_terminal=True):
        raw = _run_estimators(problem, named_policies, chosen, seed)
        hidden: frozenset[tuple[str, str]] = frozenset()
        if estimators is None:
            raw, reasons = _drop_weightless(raw)
            left_out += reasons
            hidden = frozenset(
                (r.policy, r.estimator) for r in raw if any(f.kind == "weights" for f in r.estimate.findings)
            )
        known = assess(problem, named_policies, level, guaranteed=guaranteed, quick=quick, assumed=assumptions)
    made_from_log = {name for name, policy in named_policies.items() if is_best_in_log(problem, policy)}
    results = []
    for result in raw:
        estimate = result.estimate
        if result.policy in made_from_log and estimate.is_from_log and estimate.status == "ok":
            estimate = replace(estimate, findings=(MADE_FROM_LOG, *estimate.findings))
        key = SHARED if result.estimator in own else LIKELIHOOD
        likelihood = known.intervals.get(result.policy, {}).get(key)
        results.append(replace(result, estimate=choose_interval(estimate, likelihood, level, scale)))
    by_policy = {name: [result for result in results if result.policy == name] for name in named_policies}
    known = with_values(known, {name: headline(own).estimate for name, own in by_policy.items()}, scale)
    warnings, notes = _collect_warnings(problem, results, left_out)
    told = {"simulator": repr(problem.simulator), "log": problem.log.describe(), "rewards": problem.rewards}
    told |= {"target": str(assumptions)} if str(assumptions) else {}
    return Report(
        results=tuple(results),
        truth=truth,
        warnings=warnings,
        notes=notes,
        confidence=level,
        normalized=normalized,
        discount=problem.simulator.discount,
        horizon=problem.horizon,
        seed=seed,
        facts=told | dict(facts or {}),
        uncertainty=known,
        problem=problem,
        policies=named_policies,
        hidden=hidden,
    )


def contest(problem: Problem, policies: object, **options: Any) -> Report:
    """Compare policies on one log: ``evaluate`` by off-environment evaluation alone, which is exact; of two or more policies.

    Parameters
    ----------
    problem : Problem
    policies : two or more, as for ``evaluate``
    options : confidence (of the values' intervals, and of all differences from the best together), quick, lower_ratio,
        upper_ratio, tie, features, as for ``evaluate``

    Returns
    -------
    Report
        ``best`` is the policy that is worth most, None where the log cannot say; ``comparison()`` has the differences.

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
        raise ValueError("horizon must be given at discount 1")
    return evaluate(problem, policies, estimators=["oee"], seed=0, **options)


def is_best_in_log(problem: Problem, policy: Array) -> bool:
    """Whether the policy is optimal in the log's own model, without a horizon, and not in the simulator.

    The log's own model has its frequencies, and the simulator's rows where there are none.
    """
    if problem.simulator.discount == 1.0:
        return False
    evidence = gather(problem, policy)
    return _is_optimal(evidence.fitted, policy) and not _is_optimal(problem.model, policy)


def _is_optimal(model: Model, policy: Array) -> bool:
    """Whether no action is better than the policy's own in any state that it reaches."""
    values = action_values(model, policy)
    lost = values.max(axis=1) - (policy * values).sum(axis=1)
    reached = occupancy(model, policy).sum(axis=1) > 0
    return bool(lost[reached].max() <= 1e-9 * max(1.0, float(np.abs(values).max())))


def _drop_weightless(raw: Sequence[Result]) -> tuple[list[Result], list[str]]:
    """Without importance sampling that has no positive weight, and a sentence about that."""
    kept = [result for result in raw if WEIGHTLESS not in result.estimate.findings]
    lost = [result for result in raw if WEIGHTLESS in result.estimate.findings]
    names = list(dict.fromkeys(result.policy for result in lost))
    return kept, [text.missing_weights(names, lost[0].estimate.status)] if lost else []


def _run_estimators(
    problem: Problem, policies: Mapping[str, Any], chosen: Mapping[str, Estimator], seed: Any
) -> list[Result]:
    raw = []
    for i, policy in enumerate(policies):
        for j, estimator in enumerate(chosen):
            _progress.report_step(f"{estimator} of “{policy}” (policy {i + 1} of {len(policies)})")
            stream = _checks.seed_sequence(seed, (i, j))
            estimate = chosen[estimator](problem, policies[policy], seed=stream)
            _checks.instance(estimate, Estimate, f"what estimator {estimator!r} returns", "Estimate, Estimate(value)")
            raw.append(Result(policy, estimator, estimate))
    return raw


def _collect_warnings(
    problem: Problem, results: Sequence[Result], left_out: Sequence[str]
) -> tuple[tuple[str, ...], dict[tuple[str, str], tuple[int, ...]]]:
    """Every sentence to be read before use, and of each (policy, estimator) the numbers of those that concern it."""
    general = [*left_out, *(str(finding) for finding in problem.findings)]
    on_models = tuple(k for k, f in enumerate(problem.findings, start=1 + len(left_out)) if f.severity > 0)
    told = group_findings([(r.policy, r.estimator, finding) for r in results for finding in r.estimate.findings])
    notes = {
        (r.policy, r.estimator): (() if r.estimate.is_from_episodes else on_models)
        + tuple(k for k, (_, pairs) in enumerate(told, start=1 + len(general)) if (r.policy, r.estimator) in pairs)
        for r in results
    }
    return (*general, *(sentence for sentence, _ in told)), notes


def _choose_estimators(
    problem: Problem, estimators: Sequence[str | Estimator] | Mapping[str, Estimator] | None, target: FiniteMDP | None
) -> tuple[dict[str, Estimator], list[str]]:
    if estimators is None:
        names, left_out = default_names(problem)
        return named_estimators(names, target), left_out
    if isinstance(estimators, Mapping):
        for name, estimator in estimators.items():
            _checks.function(estimator, f"estimators[{name!r}]")
        if not estimators:
            raise ValueError("estimators must hold at least one; it is empty")
        return dict(estimators), []
    found: dict[str, Estimator] = {}
    every = (
        (estimators,)
        if isinstance(estimators, str)
        else _checks.collection(estimators, "estimators", "names or estimators")
    )
    for item in every:
        if isinstance(item, str):
            found |= named_estimators([item], target)
        elif callable(item):
            label = type(item).__name__
            while label in found:
                label += "'"
            found[label] = item
        else:
            raise ValueError(f"estimators must be names or callables; got {_checks.show(item)}")
    if not found:
        raise ValueError("estimators must name at least one; it is empty")
    return found, []

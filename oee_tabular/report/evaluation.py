"""Evaluation of policies by several estimators, and the contest between policies."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import blake2b
from typing import Any, TypeAlias, TypedDict, Unpack

import numpy as np

from oee_tabular import _checks, _progress
from oee_tabular._keywords import suggest_keywords
from oee_tabular._parallel import one_thread
from oee_tabular._results import conform
from oee_tabular.estimators import Estimate, Estimator, OffEnvironment, Problem
from oee_tabular.estimators.findings import (
    FEW_WEIGHTED,
    MADE_FROM_LOG,
    WEIGHTLESS,
    Finding,
)
from oee_tabular.estimators.functions import as_estimator
from oee_tabular.estimators.names import (
    EstimatorName,
    default_names,
    named_estimators,
)
from oee_tabular.estimators.off_environment import estimate_with_rows
from oee_tabular.estimators.rewards import reward_effect
from oee_tabular.exact import (
    largest_reward,
    policy_value,
)
from oee_tabular.exceptions import ArgumentError
from oee_tabular.inference.comparison import several_policies
from oee_tabular.inference.intervals import check_factor, check_seconds
from oee_tabular.inference.shared_parameters import FeaturesLike, TieLike
from oee_tabular.inference.trials import (
    METHOD,
    JoinedTrials,
    find_trials,
    read_outcomes,
    require_tried,
    trials_by_policy,
)
from oee_tabular.mdp import FiniteMDP, check_policies, require_same_available
from oee_tabular.report import text
from oee_tabular.report.notes import ASIDE, LEFT_OUT
from oee_tabular.report.results import Report
from oee_tabular.report.rows import Result, first_results
from oee_tabular.report.selection import is_best_in_log
from oee_tabular.report.uncertainty import (
    LIKELIHOOD,
    SHARED,
    Premises,
    Uncertainty,
    add_comparison,
    choose_interval,
    find_intervals,
)
from oee_tabular.typing import Array, PoliciesLike, SeedNumbers

# transitions of a simulator from which on a command shows the report before the
# intervals
MIN_LARGE_TRANSITIONS = 200_000
# the least limit of the time in which a command searches for a large problem's
# intervals
MIN_INTERVAL_SECONDS = 30.0
# what the rows of trials alone, and of log and trials together, are called
TRIALS = "trials"
WITH_TRIALS = "oee+trials"
MAX_FIGURES = 3  # of the worst policies, that a note gives

Pair: TypeAlias = tuple[str, str]  # (policy, estimator)
Member: TypeAlias = tuple[Finding, str, str]  # a finding, its policy, its estimator


# what evaluates: an estimator, a class that makes one, or a function of a problem and
# a policy
Answer: TypeAlias = float | np.floating[Any] | np.integer[Any] | Estimate
EstimatorLike: TypeAlias = (
    Estimator | Callable[..., Answer | Estimator | Callable[..., Answer]]
)
EstimatorsLike: TypeAlias = (
    EstimatorName
    | EstimatorLike
    | Sequence[EstimatorName | EstimatorLike]
    | Mapping[str, EstimatorLike]
)


@suggest_keywords
def evaluate(
    problem: Problem,
    policies: PoliciesLike,
    *,
    estimators: EstimatorsLike | None = None,
    confidence: float = 0.95,
    seed: SeedNumbers = None,
    normalized: bool = False,
    target: FiniteMDP | None = None,
    facts: Mapping[str, Any] | None = None,
    guaranteed: bool = False,
    quick: bool = False,
    lower_ratio: float | None = None,
    upper_ratio: float | None = None,
    tie: TieLike | None = None,
    features: FeaturesLike | None = None,
    unrecorded: float | None = None,
    interval_seconds: float | None = None,
) -> Report:
    """Evaluate policies in the target environment, from a simulator and a log.

    Each estimator gives a value of each policy: the discounted sum of rewards that the
    policy is expected to collect in the target. The report puts an interval beside each
    value, tests the simulator against the log, says which policy is worth most, and
    lists in plain language what limits the answer.

    Parameters
    ----------
    problem : Problem
        The simulator, the log of the target, and what is known of the recording.
    policies : policy, list of policies, or dict of str to policy
        The policies to evaluate. A policy is an (S, A) array of probabilities, an (S,)
        array of actions or their names, a mapping from states to actions, or a function
        of a state (``mdp.check_policy``). S and A are the numbers of states and
        actions. Without names, one policy is called "policy", and several "policy 0",
        "policy 1", ...
    estimators : names, estimators, or a mapping from names to estimators, optional
        What evaluates the policies: names such as ``"oee"``, ``"model-based"`` or
        ``"wpdis"``, estimator objects such as ``oee.estimators.OffEnvironment()``, and
        functions of (problem, policy) or (problem, policy, seed).
        ``oee.estimators.names.NAMED`` maps every name to its meaning. None means
        ``["simulator", "oee", "model-based"]``, and also ``["pdis", "wpdis"]``
        (importance sampling) if the log has episodes and the behaviour policy is known.
    confidence : float, default 0.95
        The level of all intervals, in (0, 1).
    seed : int or sequence of int, optional
        The seed of the estimators that sample. The same seed gives the same report.
        Every pair of a policy and an estimator has its own random stream, which depends
        on the seed and on the two names, and not on their order or on the other pairs.
        None draws a new seed. A ``numpy.random.Generator`` or ``SeedSequence`` is
        refused.
    normalized : bool, default False
        Whether tables, pictures and files of the report multiply values by
        (1 - discount). This is an error at discount 1.
    target : FiniteMDP, optional
        The true target, if it is known (in teaching and research), with the simulator's
        states and actions. The report then has the exact values and the errors.
    facts : Mapping of str to value, optional
        More entries for the report's ``facts``, such as names of files.
    guaranteed : bool, default False
        Whether to compute also the intervals that cover at any sample size
        (``interval(method="robust")``).
    quick : bool, default False
        Whether to leave out the likelihood intervals, which take most of the time in
        large problems. Then ``guaranteed`` must be False, and no bound, ``unrecorded``
        or ``interval_seconds`` may be given.
    lower_ratio : float, optional
        A known lower bound in [0, 1] on P_target / P_simulator, the ratio of transition
        probabilities. It narrows likelihood intervals, guaranteed intervals and
        comparisons. It may be given without ``upper_ratio``, but not with ``quick``.
    upper_ratio : float, optional
        A known upper bound of at least 1 on P_target / P_simulator, likewise.
    tie : array_like of int of shape (nnz,), data frame or callable, optional
        A key for each of the nnz transitions that the simulator allows, not for each
        logged one: an array aligned with ``simulator.transitions.data``, or another
        form that ``ratio.Tied`` describes. Transitions with the same key are assumed
        to differ from the simulator by the same factor. The report then has one more
        estimator, ``"oee-tied"``, whose interval rests on this assumption. ``features``
        must be None.
    features : array_like of shape (nnz,), data frame or callable, optional
        Features of each of the nnz transitions that the simulator allows, or another
        form that ``ratio.Conditional`` describes. The target is assumed to differ
        from the simulator only along these features. The report then has one more
        estimator, ``"oee-features"``, whose interval rests on this assumption. ``tie``
        must be None.
    unrecorded : float, optional
        The factor, at least 1, by which the probabilities of pairs that were never
        recorded may differ from the estimated ones in likelihood intervals; as in
        ``inference.interval``. None is 3 (without a box).
    interval_seconds : float, optional
        The time, above 0, in which the likelihood intervals of all policies are
        searched for. The ends found so far are then inner bounds, and the report says
        so. None sets no limit.

    Returns
    -------
    Report
        The estimates with their intervals, in the order policy, estimator.
        ``print(report)`` begins with the answer, ``report.table`` is a data frame,
        ``report.best`` is the name of the best of several policies, or None,
        ``report.warnings`` lists what limits the answer, and ``report.to_html(path)``
        writes a page for readers who did not run the evaluation.

    Raises
    ------
    ValueError
        If an argument is out of its range or contradicts another, if the log
        contradicts ``lower_ratio`` and ``upper_ratio``, or if one of the requested
        estimators cannot evaluate this problem.

    See Also
    --------
    oee_tabular.report.contest : Compare policies by off-environment evaluation alone.
    oee_tabular.report.evaluate_continuous : Evaluate policies of continuous tasks.
    oee_tabular.inference.interval : Compute one interval, by any of four methods.
    oee_tabular.design.plan_data_collection : Choose what to record next.

    Notes
    -----
    A value that the log corrects is quoted with its likelihood interval. If the value
    lies outside of this interval, the nearer end replaces it. Other values have the
    interval of their estimator, or else value ± a normal quantile times the standard
    error. ``diagnostics["interval_method"]`` of an estimate names its interval.

    A likelihood interval costs about a hundred linear solves, and about three times as
    many where the policy reaches pairs that were never recorded. It is left out of
    problems in which more than ten million transitions can be reached.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> pair = oee.testing.case("ragged")
    >>> # a simulator, and a log of 1000 episodes
    >>> problem = pair.problem(1000, seed=0)
    >>> names = ["simulator", "wpdis"]
    >>> report = oee.evaluate(problem, {"new": pair.policy}, estimators=names, seed=0)
    >>> report.table[["policy", "estimator", "value"]].round(2).values.tolist()
    [['new', 'simulator', 7.97], ['new', 'wpdis', 10.57]]
    >>> report.uncertainty.sentences[0].partition(":")[0]
    'The target differs from the simulator'
    """
    return evaluate_showing(
        problem,
        policies,
        None,
        estimators=estimators,
        confidence=confidence,
        seed=seed,
        normalized=normalized,
        target=target,
        facts=facts,
        guaranteed=guaranteed,
        quick=quick,
        lower_ratio=lower_ratio,
        upper_ratio=upper_ratio,
        tie=tie,
        features=features,
        unrecorded=unrecorded,
        interval_seconds=interval_seconds,
    )


@one_thread
def evaluate_showing(
    problem: Problem,
    policies: PoliciesLike,
    show: Callable[[Report], object] | None,
    *,
    estimators: EstimatorsLike | None = None,
    confidence: float = 0.95,
    seed: SeedNumbers = None,
    normalized: bool = False,
    target: FiniteMDP | None = None,
    facts: Mapping[str, Any] | None = None,
    guaranteed: bool = False,
    quick: bool = False,
    lower_ratio: float | None = None,
    upper_ratio: float | None = None,
    tie: TieLike | None = None,
    features: FeaturesLike | None = None,
    unrecorded: float | None = None,
    interval_seconds: float | None = None,
) -> Report:
    """Evaluate policies, and show a large problem's report before its intervals.

    The other arguments are those of ``evaluate``. In a large problem ``show`` gets the
    report without likelihood intervals as soon as it is ready; the search for them then
    ends after ``interval_seconds``, or after the time that the report took, but not
    before ``MIN_INTERVAL_SECONDS``. Without ``show`` there is no limit by default.
    """
    _check_problem_and_flags(
        problem, normalized=normalized, guaranteed=guaranteed, quick=quick
    )
    known = Premises(lower_ratio, upper_ratio, tie, features, unrecorded)
    request = _check_request(
        problem,
        policies,
        known,
        estimators=estimators,
        confidence=confidence,
        seed=seed,
        normalized=normalized,
        target=target,
        facts=facts,
        interval_seconds=interval_seconds,
        quick=quick,
    )
    seconds = request.seconds
    started = time.monotonic()
    rows = _estimate(request)
    if quick:
        return _write_report(request, rows, text.QUICK, guaranteed, seconds)
    if show is None or not _is_large(problem):
        return _write_report(request, rows, "", guaranteed, seconds)
    show(_write_report(request, rows, text.SEARCHED_NEXT, False, None))
    if seconds is None:
        seconds = max(time.monotonic() - started, MIN_INTERVAL_SECONDS)
    return _write_report(request, rows, "", guaranteed, seconds)


@dataclass(frozen=True, eq=False)
class _Request:
    """Hold what ``evaluate`` was asked for, after all checks.

    Attributes
    ----------
    problem : Problem
        The simulator and the log.
    named : dict of str to ndarray of shape (S, A)
        The policies by name.
    known : Premises
        What the user knows of the target.
    level : float
        The level of the intervals.
    chosen : dict of str to estimator
        The estimators by name.
    left_out : tuple of str
        A sentence on each default estimator that is left out.
    truth : dict of str to float
        The exact values, where the target is known.
    facts : dict of str to value
        More facts for the report.
    seed : Seed
        The seed.
    normalized : bool
        Whether the report multiplies values by (1 - discount).
    seconds : float or None
        The time in which likelihood intervals are searched for.
    has_default_rows : bool
        Whether no estimators were named.
    """

    problem: Problem
    named: Mapping[str, Array]
    known: Premises
    level: float
    chosen: Mapping[str, EstimatorLike]
    left_out: tuple[str, ...]
    truth: Mapping[str, float]
    facts: Mapping[str, Any]
    seed: SeedNumbers
    normalized: bool
    seconds: float | None
    has_default_rows: bool

    @property
    def scale(self) -> float:
        """Return the factor of all values in sentences: (1 - discount) or 1."""
        return 1.0 - self.problem.simulator.discount if self.normalized else 1.0


@dataclass(frozen=True)
class _Rows:
    """Hold what the estimators gave, before any interval is chosen.

    Attributes
    ----------
    results : tuple of Result
        The estimates.
    left_out : tuple of str
        A sentence on each estimator that is left out.
    hidden : frozenset of (policy, estimator)
        The results that a short table leaves out.
    """

    results: tuple[Result, ...]
    left_out: tuple[str, ...]
    hidden: frozenset[Pair]


def _check_request(
    problem: Problem,
    policies: PoliciesLike,
    known: Premises,
    *,
    estimators: EstimatorsLike | None,
    confidence: float,
    seed: SeedNumbers,
    normalized: bool,
    target: FiniteMDP | None,
    facts: Mapping[str, Any] | None,
    interval_seconds: float | None,
    quick: bool,
) -> _Request:
    """Check the arguments of ``evaluate``, and compute what needs no estimator."""
    if facts is not None:
        conform(facts, "facts", Mapping[str, Any])
    simulator = problem.simulator
    if target is not None:
        _check_target(target, simulator)
    level = _checks.number_in(confidence, "confidence", 0.0, 1.0, open_ends=True)
    if normalized and simulator.discount == 1.0:
        raise ArgumentError(
            "normalized",
            "must be False at discount 1: the factor (1 - discount) would be 0",
        )
    named = check_policies(policies, simulator, name="policy")
    if not named:
        raise ArgumentError("policies", "must hold at least one; it is empty")
    require_tried(problem, named)
    check_factor(known.unrecorded, has_box=known.has_box)
    seconds = check_seconds(interval_seconds, "interval_seconds")
    _refuse_beside_quick(known, interval_seconds, quick=quick)
    chosen, left_out = _choose_estimators(problem, estimators, target)
    truth = {}
    if target is not None:
        truth = {
            name: policy_value(target, pi, horizon=problem.horizon)
            for name, pi in named.items()
        }
    return _Request(
        problem,
        named,
        known,
        level,
        chosen,
        tuple(left_out),
        truth,
        dict(facts or {}),
        seed,
        normalized,
        seconds,
        estimators is None,
    )


def _estimate(request: _Request) -> _Rows:
    """Run the estimators; of the default ones leave out those without any weight."""
    with _progress.show_steps(only_terminal=True):
        results = _run_estimators(
            request.problem,
            request.named,
            {**request.chosen, **request.known.estimators},
            request.seed,
        )
        if not request.has_default_rows:
            return _Rows(tuple(results), request.left_out, frozenset())
        results, reasons = _drop_weightless(results)
        hidden = _pairs_with_few_weights(results)
        return _Rows(tuple(results), (*request.left_out, *reasons), hidden)


def _describe_premises(
    problem: Problem, policies: Mapping[str, Array], known: Premises
) -> dict[str, Any]:
    """Return the facts of a report: simulator, log, trials, rewards, what is known."""
    about: dict[str, Any] = {
        "simulator": repr(problem.simulator),
        "log": problem.log.describe(),
        "rewards": problem.rewards,
    }
    if problem.trials is not None:
        about["trials"] = "; ".join(
            f"{trials.describe()} (“{name}”)"
            for name, trials in trials_by_policy(problem, policies).items()
        )
    if known.has_box:
        about["target"] = str(known)
    return about


def _is_large(problem: Problem) -> bool:
    """Return whether likelihood intervals take longer than a reader waits."""
    return problem.simulator.transitions.nnz >= MIN_LARGE_TRANSITIONS


def _refuse_beside_quick(
    known: Premises, interval_seconds: float | None, *, quick: bool
) -> None:
    """Refuse what narrows or limits intervals where ``quick`` leaves them out."""
    what = ""
    if known.has_box:
        what = (
            "lower_ratio or upper_ratio: it leaves out the intervals that they narrow"
        )
    elif known.unrecorded is not None and math.isinf(known.unrecorded):
        what = "unrecorded=inf: it leaves out the search for this worst case"
    elif interval_seconds is not None:
        what = "interval_seconds: it leaves out the intervals that this is about"
    if quick and what:
        raise ArgumentError("quick", f"must be False with {what}")


def _write_report(
    request: _Request,
    rows: _Rows,
    missing: str,
    guaranteed: bool,
    seconds: float | None,
) -> Report:
    """Write the report; ``missing`` says why it has no likelihood intervals."""
    with _progress.show_steps(only_terminal=True):
        found = find_intervals(
            request.problem,
            request.named,
            request.level,
            request.known,
            guaranteed=guaranteed,
            missing=missing,
            seconds=seconds,
        )
        return _put_together(request, rows, found)


def _put_together(request: _Request, rows: _Rows, found: Uncertainty) -> Report:
    """Put estimates, intervals, comparison and notes together."""
    problem = request.problem
    named = request.named
    level = request.level
    scale = request.scale
    size = largest_reward(problem.model)
    results = _choose_intervals(rows.results, found, request.known, level, scale, size)
    results = _add_trials(problem, named, results, found, level)
    front = {name: result.estimate for name, result in first_results(results).items()}
    default = _default_estimates(
        problem, named, results, request.chosen, found, level, scale, size
    )
    uncertainty = add_comparison(
        found, problem, named, level, request.known, front, default, scale
    )
    effect = ""
    if problem.reward_conflict is not None:
        effect = text.reward_change(
            {name: scale * reward_effect(problem, pi) for name, pi in named.items()}
        )
    warnings, notes = _collect_warnings(problem, results, rows.left_out, effect)
    return Report(
        tuple(results),
        request.truth,
        warnings,
        notes,
        level,
        request.normalized,
        problem.simulator.discount,
        problem.horizon,
        request.seed,
        {**_describe_premises(problem, named, request.known), **request.facts},
        uncertainty,
        problem,
        named,
        rows.hidden,
        _kinds_of_warnings(problem, results, rows.left_out),
    )


@suggest_keywords
def contest(
    problem: Problem,
    policies: PoliciesLike,
    *,
    confidence: float = 0.95,
    normalized: bool = False,
    target: FiniteMDP | None = None,
    facts: Mapping[str, Any] | None = None,
    guaranteed: bool = False,
    quick: bool = False,
    lower_ratio: float | None = None,
    upper_ratio: float | None = None,
    tie: TieLike | None = None,
    features: FeaturesLike | None = None,
    unrecorded: float | None = None,
    interval_seconds: float | None = None,
) -> Report:
    """Compare two or more policies on one log by off-environment evaluation alone.

    This is ``evaluate`` with the estimator ``"oee"``, which is exact and needs no seed.

    Parameters
    ----------
    problem : Problem
        The simulator, the log of the target, and what is known of the recording.
    policies : PoliciesLike
        A list of two or more policies, or a mapping from names to policies.
    confidence : float, default 0.95
        The level of the intervals of values, and of the intervals of all differences
        from the best together, in (0, 1).
    normalized : bool, default False
        Whether the report multiplies values by (1 - discount).
    target : FiniteMDP, optional
        The true target, where it is known: adds exact values and errors.
    facts : Mapping of str to value, optional
        More entries for the report's ``facts``.
    guaranteed : bool, default False
        Whether to compute also the intervals that cover at any sample size.
    quick : bool, default False
        Whether to leave out the likelihood intervals. The ranking then rests on the
        intervals of the differences alone.
    lower_ratio : float, optional
        A known lower bound in [0, 1] on target over simulator probabilities.
    upper_ratio : float, optional
        A known upper bound of at least 1 on target over simulator probabilities.
    tie : array, data frame or function, optional
        A key for each transition, as in ``evaluate``.
    features : array, data frame or function, optional
        Features of each transition, as in ``evaluate``.
    unrecorded : float, optional
        The factor of pairs that were never recorded, as in ``evaluate``.
    interval_seconds : float, optional
        The time for likelihood intervals, as in ``evaluate``.

    Returns
    -------
    Report
        ``best`` is the policy that is worth most, None where the log cannot say, and
        ``comparison()`` has the differences from it.

    Raises
    ------
    ValueError
        If there are fewer than two policies, if the discount is 1 and the problem has
        no horizon, or as in ``evaluate``.

    See Also
    --------
    evaluate : Evaluate policies by several estimators.
    inference.compare_policies : Compute the differences and their covariance alone.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> pair = oee.testing.case("ragged")
    >>> found = contest(
    ...     pair.problem(1000, seed=0), {"new": pair.policy, "recorded": pair.behavior}
    ... )
    >>> print(found.headline)
    Of 2 policies, “new” is worth most in the target. It is better than “recorded” by 3.26 (95%: 3.13 to 3.38).
    >>> [
    ...     round(found.comparison()[1][key], 2)
    ...     for key in ("less_by", "less_by_lower", "less_by_upper")
    ... ]
    [3.26, 3.13, 3.38]
    """
    return contest_showing(
        problem,
        policies,
        None,
        confidence=confidence,
        normalized=normalized,
        target=target,
        facts=facts,
        guaranteed=guaranteed,
        quick=quick,
        lower_ratio=lower_ratio,
        upper_ratio=upper_ratio,
        tie=tie,
        features=features,
        unrecorded=unrecorded,
        interval_seconds=interval_seconds,
    )


class ContestOptions(TypedDict, total=False):
    """Hold the options of ``contest``, which are options of ``evaluate`` as well."""

    confidence: float
    normalized: bool
    target: FiniteMDP | None
    facts: Mapping[str, Any] | None
    guaranteed: bool
    quick: bool
    lower_ratio: float | None
    upper_ratio: float | None
    tie: TieLike | None
    features: FeaturesLike | None
    unrecorded: float | None
    interval_seconds: float | None


def contest_showing(
    problem: Problem,
    policies: PoliciesLike,
    show: Callable[[Report], object] | None,
    **options: Unpack[ContestOptions],
) -> Report:
    """Compare policies, and show a large problem's report before its intervals.

    The arguments are those of ``contest`` and ``evaluate_showing``.
    """
    _checks.instance(problem, Problem, "problem", "Problem(simulator, log, ...)")
    several_policies(policies, problem.simulator)
    if problem.simulator.discount == 1.0 and problem.horizon is None:
        raise ArgumentError("horizon", "must be given at discount 1")
    return evaluate_showing(
        problem, policies, show, estimators=["oee"], seed=0, **options
    )


def _check_problem_and_flags(
    problem: Problem, *, normalized: bool, guaranteed: bool, quick: bool
) -> None:
    """Check the problem and the options of ``evaluate`` that are true or false."""
    _checks.instance(problem, Problem, "problem", "Problem(simulator, log, ...)")
    _checks.boolean(normalized, "normalized")
    _checks.boolean(guaranteed, "guaranteed")
    _checks.boolean(quick, "quick")
    if quick and guaranteed:
        raise ArgumentError(
            "guaranteed", "must be False where quick is True: it leaves intervals out"
        )


def _check_target(target: FiniteMDP, simulator: FiniteMDP) -> None:
    """Refuse a target whose numbers of states or actions are not the simulator's."""
    _checks.instance(target, FiniteMDP, "target")
    if target.transitions.shape != simulator.transitions.shape:
        raise ArgumentError(
            "target",
            f"must have the simulator's {simulator.n_states} states and"
            f" {simulator.n_actions} actions; it has {target.n_states} and"
            f" {target.n_actions}",
        )
    require_same_available(target, simulator)


def _choose_estimators(
    problem: Problem,
    estimators: EstimatorsLike | None,
    target: FiniteMDP | None,
) -> tuple[dict[str, EstimatorLike], list[str]]:
    """Return the estimators by name, and a sentence on each that is left out."""
    if estimators is None:
        names, left_out = default_names(problem)
        return {**named_estimators(names, target)}, left_out
    chosen: dict[str, EstimatorLike] = {}
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
                # a second estimator of one class gets another name
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
    chosen: Mapping[str, EstimatorLike],
    seed: SeedNumbers,
) -> list[Result]:
    """Run every estimator on every policy.

    Estimates of a policy that is the best in the log's own model get a finding about
    it: the log has been used twice.
    """
    results = []
    for i, (name, policy) in enumerate(policies.items()):
        is_from_log = is_best_in_log(problem, policy)
        for label, estimator in chosen.items():
            _progress.report_step(
                f"{label} of “{name}” (policy {i + 1} of {len(policies)})"
            )
            run = as_estimator(estimator, f"estimators[{label!r}]")
            stream = _checks.seed_sequence(seed, _stream_key(name, label))
            estimate = run(problem, policy, seed=stream)
            if is_from_log and estimate.is_from_log and estimate.status == "ok":
                estimate = replace(
                    estimate, findings=(MADE_FROM_LOG, *estimate.findings)
                )
            results.append(Result(name, label, estimate))
            _progress.report_finished(f"{label} of “{name}”: {estimate}")
    return results


def _stream_key(policy: str, estimator: str) -> tuple[int, ...]:
    """Return the key of a pair's random stream: a digest of its two names.

    So a row stays the same whatever stands before it, or is left out.
    """
    text = json.dumps([policy, str(estimator)]).encode()
    words = np.frombuffer(blake2b(text, digest_size=16).digest(), dtype="<u4")
    return tuple(words.tolist())


def _drop_weightless(results: Sequence[Result]) -> tuple[list[Result], list[str]]:
    """Drop importance sampling without a positive weight, and say so in a sentence."""
    kept = [result for result in results if WEIGHTLESS not in result.estimate.findings]
    lost = [result for result in results if WEIGHTLESS in result.estimate.findings]
    if not lost:
        return kept, []
    names = ", ".join(dict.fromkeys(result.policy for result in lost))
    return kept, [text.MISSING_WEIGHTS.format(names, lost[0].estimate.status)]


def _pairs_with_few_weights(results: Sequence[Result]) -> frozenset[Pair]:
    """Return the (policy, estimator) whose estimate rests on a few episodes."""
    pairs = []
    for result in results:
        kinds = {finding.kind for finding in result.estimate.findings}
        if FEW_WEIGHTED in kinds:
            pairs.append((result.policy, result.estimator))
    return frozenset(pairs)


def _choose_intervals(
    results: Sequence[Result],
    uncertainty: Uncertainty,
    known: Premises,
    level: float,
    scale: float,
    size: float,
) -> list[Result]:
    """Give every estimate the interval to quote, and a value inside of it."""
    shared = known.estimators
    chosen = []
    for result in results:
        key = SHARED if result.estimator in shared else LIKELIHOOD
        likelihood = uncertainty.intervals.get(result.policy, {}).get(key)
        estimate = choose_interval(result.estimate, likelihood, level, scale, size=size)
        chosen.append(replace(result, estimate=estimate))
    return chosen


def _add_trials(
    problem: Problem,
    policies: Mapping[str, Array],
    results: Sequence[Result],
    uncertainty: Uncertainty,
    level: float,
) -> list[Result]:
    """Add to the results of each policy that was tried its trials, and both together.

    The value by both is the one that the report states first.
    """
    if problem.trials is None:
        return list(results)
    extended: list[Result] = []
    for name, policy in policies.items():
        extended += [result for result in results if result.policy == name]
        trials = find_trials(problem, policy, name)
        if trials is None:
            continue
        outcomes = read_outcomes(problem, policy, trials)
        error = math.sqrt(outcomes.variance / outcomes.number)
        alone = Estimate(
            outcomes.mean,
            error if error > 0.0 else None,
            outcomes.ends(level),
            {
                "interval_method": "trials",
                "effective_sample_size": outcomes.number,
            },
            is_from_episodes=True,
        )
        extended.append(Result(name, TRIALS, alone))
        both = uncertainty.trials.get(name)
        if both is not None:
            extended.append(Result(name, WITH_TRIALS, _estimate_of_both(both)))
    return extended


def _estimate_of_both(both: JoinedTrials) -> Estimate:
    """Return the value of log and trials together, with the joined interval."""
    found = both.interval
    has_interval = found.status == "ok"
    return Estimate(
        both.value,
        both.standard_error,
        (found.lower, found.upper) if has_interval else None,
        {"interval_method": METHOD, "effective_sample_size": both.worth}
        if has_interval
        else {},
        is_headline=True,
    )


def _default_estimates(
    problem: Problem,
    policies: Mapping[str, Array],
    results: Sequence[Result],
    chosen: Mapping[str, EstimatorLike],
    uncertainty: Uncertainty,
    level: float,
    scale: float,
    size: float,
) -> dict[str, Estimate]:
    """Return the default's estimate of each policy, with its interval.

    It is that of the table where the table has it.
    """
    default = OffEnvironment()
    labels = {label for label, estimator in chosen.items() if estimator == default}
    known = {
        result.policy: result.estimate
        for result in results
        if result.estimator in labels
    }
    for name, policy in policies.items():
        if name not in known:
            estimate, _ = estimate_with_rows(problem, policy)
            likelihood = uncertainty.intervals.get(name, {}).get(LIKELIHOOD)
            known[name] = choose_interval(estimate, likelihood, level, scale, size=size)
    return known


def _collect_warnings(
    problem: Problem,
    results: Sequence[Result],
    left_out: Sequence[str],
    effect: str = "",
) -> tuple[tuple[str, ...], dict[Pair, tuple[int, ...]]]:
    """Return all warnings, and the numbers of those about each (policy, estimator).

    Warnings about the problem concern every estimate that does not average the log's
    own episodes. ``effect`` is what other rewards do to the values.
    """
    models = [
        (result.policy, result.estimator)
        for result in results
        if not result.estimate.is_from_episodes
    ]
    warnings: list[tuple[str, list[Pair]]] = [(sentence, []) for sentence in left_out]
    for finding in problem.findings:
        sentence = finding.sentence(finding.figure or effect)
        warnings.append((sentence, models if finding.severity > 0 else []))
    return number_notes(results, [*warnings, *group_findings(results)])


def _kinds_of_warnings(
    problem: Problem, results: Sequence[Result], left_out: Sequence[str]
) -> tuple[str, ...]:
    """Return the kind of each of the warnings of ``_collect_warnings``."""
    kinds = [LEFT_OUT for _ in left_out]
    for finding in problem.findings:
        kinds.append(finding.kind if finding.severity > 0 else ASIDE)
    return (*kinds, *kinds_of_findings(results))


def kinds_of_findings(results: Sequence[Result]) -> tuple[str, ...]:
    """Return the kind of each of the sentences of ``group_findings``."""
    return tuple(kind for kind, _ in _group_members(results))


def _group_members(
    results: Sequence[Result],
) -> dict[tuple[str, str], list[Member]]:
    """Return the findings of one kind and text with their policies and estimators."""
    groups: dict[tuple[str, str], list[Member]] = {}
    for result in results:
        for finding in result.estimate.findings:
            group = groups.setdefault((finding.kind, finding.text), [])
            group.append((finding, result.policy, result.estimator))
    return groups


def group_findings(results: Sequence[Result]) -> list[tuple[str, list[Pair]]]:
    """Write one sentence for all findings of one kind and text.

    With each sentence come the (policy, estimator) that it is about.
    """
    sentences = []
    for members in _group_members(results).values():
        worst = max(members, key=lambda member: member[0].severity)[0]
        sentence = worst.sentence(_write_figures(members))
        pairs = [(policy, estimator) for _, policy, estimator in members]
        sentences.append((f"{_write_subject(members)}: {sentence}", pairs))
    return sentences


def _write_subject(members: Sequence[Member]) -> str:
    """Write which estimators a finding is about, with the policies of each."""
    by_policies: dict[tuple[str, ...], list[str]] = {}
    for label in dict.fromkeys(estimator for _, _, estimator in members):
        own = tuple(policy for _, policy, estimator in members if estimator == label)
        by_policies.setdefault(own, []).append(label)
    return "; ".join(
        f"{', '.join(labels)} ({', '.join(own)})" for own, labels in by_policies.items()
    )


def _write_figures(members: Sequence[Member]) -> str:
    """Write the worst figure of each policy, or of each estimator of a single policy.

    Figures that are all equal are written once.
    """
    figures: dict[str, str] = {}
    has_several_policies = len({policy for _, policy, _ in members}) > 1
    worst_first = sorted(members, key=lambda member: -member[0].severity)
    for finding, policy, label in worst_first:
        name = policy if has_several_policies else label
        figures.setdefault(name, finding.figure)
    if len(set(figures.values())) == 1:
        return worst_first[0][0].figure
    shown = list(figures.items())[:MAX_FIGURES]
    return ", ".join(f"{figure} ({name})" for name, figure in shown)


def number_notes(
    results: Iterable[Result], warnings: Sequence[tuple[str, Collection[Pair]]]
) -> tuple[tuple[str, ...], dict[Pair, tuple[int, ...]]]:
    """Give warnings numbers from 1, and list those about each (policy, estimator)."""
    notes: dict[Pair, tuple[int, ...]] = {}
    for result in results:
        pair = (result.policy, result.estimator)
        notes[pair] = tuple(
            k for k, (_, pairs) in enumerate(warnings, start=1) if pair in pairs
        )
    return tuple(sentence for sentence, _ in warnings), notes

"""Uncertainty of a report: intervals, tests of the simulator, ranking, and advice."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from statistics import NormalDist
from typing import Any, Final, TypedDict

import numpy as np
from scipy import special

from oee_tabular import _checks, _printing, _progress
from oee_tabular._results import checked
from oee_tabular.design.advice import advice
from oee_tabular.estimators import Estimate, Estimator, OffEnvironment, Problem
from oee_tabular.estimators.findings import NEVER_VARIED, no_value, outside
from oee_tabular.estimators.off_environment import estimate_with_rows
from oee_tabular.exact import (
    back_up_transitions,
    occupancy,
    policy_value,
    state_values,
)
from oee_tabular.exceptions import ArgumentError
from oee_tabular.inference import (
    Comparison,
    Decision,
    Interval,
    interval,
)
from oee_tabular.inference.comparison import MIN_RECORDED_SHARE, compare_estimates
from oee_tabular.inference.evidence import Evidence, gather
from oee_tabular.inference.intervals import interval_without_search, join_trials
from oee_tabular.inference.robust import independent_radius
from oee_tabular.inference.shared_parameters import FeaturesLike, TieLike
from oee_tabular.inference.trials import (
    CONTRADICTION_LEVEL,
    JoinedTrials,
    find_trials,
    read_outcomes,
)
from oee_tabular.report import text
from oee_tabular.shrinkage import transition_ratio
from oee_tabular.typing import Array, BoolArray

# reachable transitions, beyond which likelihood intervals take many minutes and are
# left out
MAX_TRANSITIONS = 10_000_000
# standard deviations from which on the test of all transitions together rejects the
# simulator
MIN_Z = 3.0
# the share of all pairs' tests that may reject a correct simulator
TEST_LEVEL = 0.05
# the share of a policy's time in unrecorded pairs up to which a report does not say
# what its interval lets them do
MAX_UNMET_SHARE_UNTOLD = 0.1  # of time, where samples of a simulator say nothing
MAX_SHARE_UNTOLD = 0.01
# of the value: a smaller standard error is rounding
ERROR_TOLERANCE = 1e-12
# of the ends, which are found by iteration: a value so close to an end is inside
END_TOLERANCE = 1e-9
MIN_SECONDS = 1.0  # in which log and trials are joined where time is over
# the keys of a policy's intervals; "shared" is the one under a tie or features
LIKELIHOOD = "likelihood"
SHARED = "shared"
GUARANTEED: Final = "robust"
WITH_TRIALS = "with trials"
# what ``diagnostics["interval_method"]`` calls the intervals that are set here
NOISE = "standard error"
ROLLOUTS = "rollouts"  # the same, where a standard error is that of rollouts
OWN = "the estimator's own"
OWN_LEVEL = 0.95  # the confidence of the intervals that estimators set themselves


class BoxOptions(TypedDict):
    """Hold bounds on target over simulator probabilities, as keyword arguments."""

    lower_ratio: float | None
    upper_ratio: float | None


@dataclass(frozen=True, eq=False)
class Premises:
    """Hold what the user knows about the target.

    ``lower_ratio`` and ``upper_ratio`` are a box around the simulator's probabilities,
    which narrows likelihood and guaranteed intervals. ``tie`` or ``features`` (as in
    ``transition_ratio``) add an estimator with the interval of its own model
    (``inference.profile_ascent``). ``unrecorded`` is the factor of ``interval``.
    """

    lower_ratio: float | None = None
    upper_ratio: float | None = None
    tie: TieLike | None = None
    features: FeaturesLike | None = None
    unrecorded: float | None = None

    def __post_init__(self) -> None:
        if self.tie is not None and self.features is not None:
            raise ValueError(
                "tie and features must not be given together: they are two different"
                " models"
            )
        # before any work; a number is kept as a float, which can be put in words
        limits = {
            "lower_ratio": (0.0, 1.0),
            "upper_ratio": (1.0, np.inf),
            "unrecorded": (1.0, np.inf),
        }
        for name, (low, high) in limits.items():
            given = getattr(self, name)
            if given is not None:
                number = _checks.number_in(
                    given, name, low, high, infinite=np.isinf(high)
                )
                object.__setattr__(self, name, number)

    @property
    def has_box(self) -> bool:
        """Return whether the ratio of probabilities is bounded on either side."""
        return self.lower_ratio is not None or self.upper_ratio is not None

    @property
    def box(self) -> BoxOptions:
        """Return the box as keyword arguments of ``interval``."""
        return {"lower_ratio": self.lower_ratio, "upper_ratio": self.upper_ratio}

    def __str__(self) -> str:
        """Return the box in words; "" without one."""
        if not self.has_box:
            return ""
        lower = self.lower_ratio or 0.0
        upper = "any number of" if self.upper_ratio is None else f"{self.upper_ratio:g}"
        return (
            f"assumed between {lower:g} and {upper} times the simulator's probabilities"
        )

    @property
    def estimators(self) -> dict[str, Estimator]:
        """Return the estimator that rests on the tie or the features, by name."""
        if self.tie is not None:
            tied = partial(transition_ratio, method="tied", tie=self.tie)
            return {"oee-tied": OffEnvironment(tied)}
        if self.features is not None:
            along = partial(transition_ratio, prior="tilt", features=self.features)
            return {"oee-features": OffEnvironment(along)}
        return {}

    def intervals(
        self,
        problem: Problem,
        policy: Array,
        level: float,
        *,
        guaranteed: bool,
        seconds: float | None,
    ) -> dict[str, Interval]:
        """Compute the intervals of a policy by the log alone, by their keys.

        Raises ValueError, naming the pairs, where the log contradicts the box. The
        search for a likelihood interval ends after ``seconds``.
        """
        problem = problem.without_trials
        likelihood = interval(
            problem,
            policy,
            confidence=level,
            unrecorded=self.unrecorded,
            seconds=seconds,
            **self.box,
        )
        if self.has_box and likelihood.status != "ok":
            raise ValueError(
                f"lower_ratio and upper_ratio must fit the log: {likelihood.status}"
            )
        result = {LIKELIHOOD: likelihood}
        if guaranteed:
            result[GUARANTEED] = interval(
                problem, policy, method=GUARANTEED, confidence=level, **self.box
            )
        if self.estimators:
            result[SHARED] = interval(
                problem, policy, tie=self.tie, features=self.features, confidence=level
            )
        return result


@checked()
@dataclass(frozen=True)
class Uncertainty:
    """Hold how certain the log makes the values of policies.

    Attributes
    ----------
    intervals : dict of str to dict of str to Interval
        The intervals of each policy, by policy and method, as discounted sums.
    distance : tuple of str
        Sentences on how far the target is from the simulator, and on why there are no
        likelihood intervals.
    policies : dict of str to str
        A sentence on the interval of each policy; "" where there is nothing to say.
    comparison : Comparison or None
        The comparison of the policies. Its intervals of all differences from the best
        cover together.
    decision : Decision or None
        Which policy is best, as far as the log can say.
    ranking : str
        The sentence about the decision; "" for a single policy.
    next : str
        The sentence on what to record next.
    caveat : str
        A warning before any value; "" where there is none.
    assumptions : dict of str to str
        For each policy that spends more than 1% of its time in pairs that were never
        recorded, what its interval lets them do.
    default : dict of str to Estimate
        The default's estimate of each policy, on which the comparison rests.
    unanswered : tuple of str
        The policies of which no value is stated above the table, because the log cannot
        say it; ``caveat`` says why.
    trials : dict of str to JoinedTrials
        What log and trials say together of each policy that was tried.
    """

    intervals: Mapping[str, Mapping[str, Interval]] = field(default_factory=dict)
    distance: tuple[str, ...] = ()
    policies: Mapping[str, str] = field(default_factory=dict)
    comparison: Comparison | None = None
    decision: Decision | None = None
    ranking: str = ""
    next: str = ""
    caveat: str = ""
    assumptions: Mapping[str, str] = field(default_factory=dict)
    default: Mapping[str, Estimate] = field(default_factory=dict)
    unanswered: tuple[str, ...] = ()
    trials: Mapping[str, JoinedTrials] = field(default_factory=dict)

    @property
    def likelihood(self) -> dict[str, Interval]:
        """Return the likelihood interval of each policy that has one."""
        intervals = {
            name: methods[LIKELIHOOD]
            for name, methods in self.intervals.items()
            if LIKELIHOOD in methods
        }
        return {name: one for name, one in intervals.items() if one.status == "ok"}

    @property
    def sentences(self) -> tuple[str, ...]:
        """Return every sentence: distance, policies, ranking, and what to record."""
        ends = (sentence for sentence in (self.ranking, self.next) if sentence)
        return (*self._distance_and_policies, *ends)

    @property
    def details(self) -> tuple[str, ...]:
        """Return the sentences without the ranking, which stands above the table."""
        last = (self.next,) if self.next else ()
        return (*self._distance_and_policies, *last)

    @property
    def _distance_and_policies(self) -> tuple[str, ...]:
        """Return the sentences on the target's distance and on each policy."""
        about = (
            f"{name}: {sentence}"
            for name, sentence in self.policies.items()
            if sentence
        )
        return (*self.distance, *about)


# before the values


def find_intervals(
    problem: Problem,
    policies: Mapping[str, Array],
    level: float,
    known: Premises,
    *,
    guaranteed: bool,
    missing: str = "",
    seconds: float | None = None,
) -> Uncertainty:
    """Test the simulator against the log, and compute the intervals of every policy.

    Where there are no intervals, a sentence says why; ``missing`` is a reason to leave
    them out. ``seconds`` is a limit of the
    time in which the intervals of all policies are searched for.
    """
    if problem.soft:
        if guaranteed:
            reason = "soft counts are no independent transitions"
            raise ArgumentError(
                "guaranteed", f"must be False where counts are given: {reason}"
            )
        return Uncertainty(distance=(text.SOFT,))
    evidence = gather(problem, next(iter(policies.values())))
    lacking = _reason_without_intervals(problem, evidence) or missing
    test = _tested(problem, evidence)
    distance = (test.sentence(),)
    del evidence  # as much memory as the simulator
    if lacking:
        if guaranteed:
            raise ArgumentError("guaranteed", f"must be False here: {lacking}")
        sentence = text.MISSING_INTERVALS.format(lacking)
        if problem.trials is not None:
            sentence = f"{sentence} {text.NOT_JOINED}"
        is_infinite = problem.simulator.discount == 1.0 and problem.horizon is None
        if not known.has_box and not is_infinite:
            intervals = {}
            for name, policy in policies.items():
                if found := _interval_if_quick(problem, policy, level, known):
                    intervals[name] = found
            if len(intervals) == len(policies):
                sentence = text.MISSING_WORST_CASES.format(lacking)
                if problem.trials is not None:
                    sentence = f"{sentence} {text.NOT_JOINED}"
            return Uncertainty(intervals, (*distance, sentence))
        return Uncertainty(distance=(*distance, sentence))
    intervals = {}
    watch = _progress.Watch(seconds)
    for i, (name, policy) in enumerate(policies.items()):
        _progress.report_step(
            f"likelihood interval of “{name}” (policy {i + 1} of {len(policies)})"
        )
        intervals[name] = known.intervals(
            problem,
            policy,
            level,
            guaranteed=guaranteed,
            seconds=watch.part(1.0 / (len(policies) - i)).left,
        )
    joined = _join_trials(problem, policies, level, known, watch)
    for name, both in joined.items():
        intervals[name][WITH_TRIALS] = both.interval
    left_out = []
    if test.is_passed:
        left_out = [
            name
            for name, policy in policies.items()
            if _leaves_out_simulator(problem, policy, intervals[name][LIKELIHOOD])
        ]
    return Uncertainty(intervals, (test.sentence(left_out),), trials=joined)


def _join_trials(
    problem: Problem,
    policies: Mapping[str, Array],
    level: float,
    known: Premises,
    watch: _progress.Watch,
) -> dict[str, JoinedTrials]:
    """Join the trials of each policy that was tried with the log."""
    joined = {}
    for name, policy in policies.items():
        if find_trials(problem, policy, name) is None:
            continue
        _progress.report_step(f"trials of “{name}”")
        joined[name] = join_trials(
            problem,
            policy,
            name=name,
            confidence=level,
            unrecorded=known.unrecorded,
            seconds=None if watch.left is None else max(watch.left, MIN_SECONDS),
            **known.box,
        )
    return joined


def _interval_if_quick(
    problem: Problem, policy: Array, level: float, known: Premises
) -> dict[str, Interval]:
    """Return the interval of a policy that needs no search, by its key, or {}."""
    found = interval_without_search(
        problem, policy, confidence=level, unrecorded=known.unrecorded
    )
    return {} if found is None else {LIKELIHOOD: found}


def _reason_without_intervals(problem: Problem, evidence: Evidence) -> str:
    """Return why there cannot be likelihood intervals; "" where there can."""
    if problem.simulator.discount == 1.0 and problem.horizon is None:
        return "at discount 1 they need a horizon"
    if len(evidence.phat) > MAX_TRANSITIONS:
        reachable = int(np.diff(evidence.rows.indptr)[evidence.reachable].sum())
        if reachable > MAX_TRANSITIONS:
            return (
                f"{reachable} transitions can be reached, more than {MAX_TRANSITIONS}"
            )
    return ""


@dataclass(frozen=True, eq=False)
class _Test:
    """Hold what the log says against the simulator.

    ``n_tested`` pairs have several next states and records, ``z`` is the score of all
    transitions together, ``is_rejecting`` (S*A,) are the pairs that reject the
    simulator by themselves.
    """

    n_tested: int
    z: float
    is_rejecting: BoolArray

    @property
    def is_rejected(self) -> bool:
        """Return whether all transitions together reject the simulator."""
        return abs(self.z) >= MIN_Z

    @property
    def is_passed(self) -> bool:
        """Return whether something was tested, and nothing rejects the simulator."""
        is_any = self.is_rejected or bool(self.is_rejecting.any())
        return self.n_tested > 0 and not is_any

    def sentence(self, left_out: Sequence[str] = ()) -> str:
        """Say what the log tells of the simulator, all together and pair by pair.

        ``left_out`` are the policies of ``text.verdict_on_simulator``.
        """
        if self.n_tested == 0:
            return text.NOT_TESTED
        return text.verdict_on_simulator(
            self.z,
            int(self.is_rejecting.sum()),
            self.n_tested,
            is_rejected=self.is_rejected,
            left_out=left_out,
        )


def _tested(problem: Problem, evidence: Evidence) -> _Test:
    """Return ``_test_simulator``, which is the same for all policies of a problem."""
    if _test_simulator not in problem.cache:
        problem.cache[_test_simulator] = _test_simulator(evidence)
    found: _Test = problem.cache[_test_simulator]
    return found


def _test_simulator(evidence: Evidence) -> _Test:
    """Test the simulator against the log, as a whole and pair by pair.

    The pairs' tests are KL balls that hold at any number of transitions, and share 5%.
    The test of all transitions together is the score test of the tilt along log P: sum
    (n - n_sa P) log P over its standard deviation under P.
    """
    tested = (evidence.n > 0) & evidence.is_stochastic
    is_rejecting = np.zeros(len(tested), dtype=np.bool_)
    n_tested = int(tested.sum())
    if n_tested == 0:
        return _Test(0, 0.0, is_rejecting)
    rows = evidence.rows.select(tested)
    n = evidence.n[tested]
    phat = evidence.phat[rows.entries]
    kl = rows.sums(special.rel_entr(phat, rows.weights))
    radius = independent_radius(n, np.diff(rows.indptr), TEST_LEVEL / n_tested)
    is_rejecting[rows.number] = kl > radius
    phi = rows.center(np.log(rows.weights))
    score = float(np.sum(rows.spread(n) * (phat - rows.weights) * phi))
    spread = float(np.sum(rows.spread(n) * rows.weights * phi**2))
    z = score / np.sqrt(spread) if spread > 0 else 0.0
    return _Test(n_tested, z, is_rejecting)


def _leaves_out_simulator(problem: Problem, policy: Array, found: Interval) -> bool:
    """Return whether an interval leaves out the policy's value in the simulator."""
    if found.status != "ok":
        return False
    value = policy_value(problem.model, policy, horizon=problem.horizon)
    rounding = ERROR_TOLERANCE * max(abs(value), 1e-300)
    return not found.lower - rounding <= value <= found.upper + rounding


def _explain_distance(problem: Problem, policy: Array, scale: float) -> str:
    """Say in which pairs the corrected simulator's value differs from the simulator's.

        J(Q) - J(P) = sum_sa d(s, a) sum_s' (Q - P)(s' | s, a) (r + gamma V(s')),

    with d the discounted time in the simulator P, and V the values in the corrected
    simulator Q = zeta P: exact, without a horizon. "" with a horizon, at discount 1,
    and where no pair rejects the simulator by itself, or all of the difference is
    rounding.
    """
    if problem.horizon is not None or problem.simulator.discount == 1.0:
        return ""
    evidence = gather(problem, policy)
    is_rejecting = _tested(problem, evidence).is_rejecting
    if not is_rejecting.any():
        return ""
    _, corrected = estimate_with_rows(problem, policy)
    rows = evidence.rows
    values = state_values(evidence.with_rows(corrected), policy)
    time = occupancy(problem.model, policy).reshape(-1)
    time = time / (1.0 - problem.simulator.discount)
    ahead = back_up_transitions(evidence.model, values)
    change = time * rows.sums((corrected - rows.weights) * ahead)
    whole = float(change.sum())
    if not abs(whole) > ERROR_TOLERANCE * max(
        abs(float(values @ problem.model.initial)), 1e-300
    ):
        return ""
    is_recorded = evidence.n > 0
    return text.distance_from_simulator(
        scale * whole,
        scale * float(change[is_rejecting].sum()),
        scale * float(change[is_recorded & ~is_rejecting].sum()),
        scale * float(change[~is_recorded].sum()),
    )


def descending_key(value: float) -> float:
    """Return a key that sorts values from the largest, and nan and infinities last."""
    return -value if math.isfinite(value) else math.inf


# the one interval that stands beside each value, and the value that stands inside it


def choose_interval(
    estimate: Estimate,
    likelihood: Interval | None,
    level: float,
    scale: float = 1.0,
    *,
    size: float = 1.0,
) -> Estimate:
    """Give an estimate the interval to quote, a value inside of it, and its findings.

    A value that the log corrects has the likelihood interval, where there is one. If
    the value lies outside, the nearer end replaces it (``replaced_value`` and
    ``replaced_by`` in the diagnostics). Others have the estimator's own interval, at
    ``level``, or value ± a normal quantile times the standard error, where that
    includes what matters: not where ``measured`` is below ``MIN_RECORDED_SHARE``, and
    not where the variance is unknown. ``diagnostics["interval_method"]`` names the
    interval. ``scale`` multiplies values in the findings. ``size`` is the largest
    reward, of which rounding is a share.
    """
    is_corrected = estimate.model_value is not None and not math.isnan(estimate.value)
    if is_corrected and likelihood is not None and likelihood.status == "ok":
        chosen = _put_inside(estimate, likelihood, scale, size)
        # what the interval lets unrecorded pairs do is said beside it
        told = tuple(f for f in chosen.findings if f.kind != "coverage")
        chosen = replace(chosen, findings=told)
    else:
        chosen = _within_bounds(_with_own_interval(estimate, level))
    lacks_interval = chosen.interval is None and (
        chosen.standard_error is not None or chosen.status == "ok"
    )
    findings = []
    if chosen.status != "ok":
        findings.append(no_value(chosen.status, chosen.value))
    for finding in chosen.findings:
        words = finding.text
        if lacks_interval and finding.alone is not None:
            words = finding.alone
        if words:
            findings.append(replace(finding, text=words, alone=None))
    return replace(chosen, findings=tuple(findings))


def _with_own_interval(estimate: Estimate, level: float) -> Estimate:
    """Give an estimate its own interval, or one from its standard error."""
    quantile = NormalDist().inv_cdf(0.5 + level / 2.0)
    value = estimate.value
    error = estimate.standard_error
    facts: dict[str, Any] = estimate.diagnostics
    if estimate.interval is not None:
        if not estimate.is_normal or level == OWN_LEVEL:
            return estimate
        factor = quantile / NormalDist().inv_cdf(0.5 + OWN_LEVEL / 2.0)
        lower, upper = (value + factor * (end - value) for end in estimate.interval)
        return replace(estimate, interval=(lower, upper))
    is_incomplete = estimate.measured < MIN_RECORDED_SHARE
    if error is None or is_incomplete or not math.isfinite(value):
        return estimate
    # what does not vary, but for rounding, has no error to show
    if error <= ERROR_TOLERANCE * abs(value):
        findings = (*estimate.findings, NEVER_VARIED)
        facts = {"standard_error_of": "log"} | facts
        return replace(
            estimate, standard_error=None, diagnostics=facts, findings=findings
        )
    ends = (value - quantile * error, value + quantile * error)
    is_simulated = facts.get("standard_error_of") == ROLLOUTS
    method = ROLLOUTS if is_simulated else NOISE
    return replace(
        estimate, interval=ends, diagnostics=facts | {"interval_method": method}
    )


def _within_bounds(estimate: Estimate) -> Estimate:
    """Let an interval end where no value is possible beyond."""
    if estimate.interval is None or estimate.bounds is None:
        return estimate
    lowest, highest = estimate.bounds
    lower, upper = estimate.interval
    # a value that rounding puts beyond its bound keeps its interval around it
    lower = min(max(lower, lowest), estimate.value)
    upper = max(min(upper, highest), estimate.value)
    return replace(estimate, interval=(lower, upper))


def _put_inside(
    estimate: Estimate, likelihood: Interval, scale: float, size: float
) -> Estimate:
    """Give an estimate the likelihood interval, and a value inside of it."""
    lower = likelihood.lower
    upper = likelihood.upper
    value = estimate.value
    facts = estimate.diagnostics | {"interval_method": likelihood.method}
    tolerance = END_TOLERANCE * max(size, abs(lower), abs(upper))
    if lower - tolerance <= value <= upper + tolerance:
        return replace(
            estimate, interval=(min(lower, value), max(upper, value)), diagnostics=facts
        )
    end = upper
    which = "upper"
    if value < lower:
        end = lower
        which = "lower"
    facts |= {"replaced_value": value, "replaced_by": f"the interval's {which} end"}
    shown = format(value * scale, _printing.spec(lower * scale, upper * scale))
    finding = outside(shown, abs(value - end), which)
    return replace(
        estimate,
        value=end,
        interval=(lower, upper),
        diagnostics=facts,
        findings=(*estimate.findings, finding),
    )


# after the values: which policy is best, what to record next


def add_comparison(
    found: Uncertainty,
    problem: Problem,
    policies: Mapping[str, Array],
    level: float,
    known: Premises,
    front: Mapping[str, Estimate],
    default: Mapping[str, Estimate],
    scale: float,
) -> Uncertainty:
    """Compare the policies, and add the sentences that need their values.

    They say what the intervals assume, which policy is best, and what to record next.
    ``front`` are the estimates that stand first, ``default`` those of the default, on
    which alone the comparison rests; ``scale`` multiplies values in the sentences.
    """
    _progress.report_step("comparison of the policies, and what to record next")
    assumptions = {}
    about = {}
    for name, methods in found.intervals.items():
        coverage = default[name].diagnostics.get("coverage")
        share = None if coverage is None else 1.0 - coverage
        quoted = methods.get(WITH_TRIALS, methods[LIKELIHOOD])
        told = (
            _write_assumption(quoted, share, scale, has_box=known.has_box),
            _write_unmet(quoted, problem),
        )
        assumptions[name] = " ".join(filter(None, told))
        sentences = [_describe(methods, scale)]
        if name in found.trials:
            sentences.append(_describe_trials(found.trials[name], level, scale))
        if len(policies) > 1:  # that of a single policy stands beside its value
            sentences.insert(0, assumptions[name])
        sentences.append(_explain_distance(problem, policies[name], scale))
        about[name] = " ".join(filter(None, sentences))
    found = replace(found, policies=about, assumptions=assumptions, default=default)
    caveats = [
        _write_contradictions(found.trials, scale),
        _write_apart(problem, policies, front, found.trials, level, scale),
    ]
    if caveat := " ".join(filter(None, caveats)):
        found = replace(found, caveat=" ".join(filter(None, (found.caveat, caveat))))
    has_ranking = len(front) > 1 and any(
        math.isfinite(estimate.value) for estimate in front.values()
    )
    if problem.simulator.discount == 1.0 and problem.horizon is None:
        return replace(found, ranking=text.NEEDS_HORIZON if has_ranking else "")
    comparison = None
    decision = None
    ranking = ""
    if len(front) > 1:
        # all differences from the best hold at once
        each = 1.0 - (1.0 - level) / (len(front) - 1)
        comparison = compare_estimates(
            problem, policies, default, confidence=each, **known.box
        )
    if comparison is not None and has_ranking:
        # values with trials stand first, but the ranking is by the log
        decision = comparison.decide(intervals=found.likelihood)
        is_by_default = all(front[name] is default[name] for name in front)
        ranking = _rank(
            decision,
            comparison,
            found.likelihood,
            level,
            scale,
            by_default=is_by_default,
        )
        if problem.trials is not None:
            ranking = f"{ranking} {text.RANKED_WITHOUT_TRIALS}"
    return replace(
        found,
        comparison=comparison,
        decision=decision,
        ranking=ranking,
        next=advice(problem, policies, level),
    )


def _rank(
    decision: Decision,
    comparison: Comparison,
    likelihood: Mapping[str, Interval],
    level: float,
    scale: float,
    *,
    by_default: bool,
) -> str:
    """Say which policy is best, and by how much it is better than the next.

    ``by_default`` says that the values that stand first are the default's as well.
    """
    names = comparison.names
    prefix = "" if by_default else text.BY_DEFAULT
    if decision.margin is None:
        return prefix + text.no_best_policy(
            decision.candidates, len(names), are_equal=decision.are_equal
        )
    best, following = names[:2]
    # likelihood intervals that are apart already tell which policy is better
    ours = likelihood.get(best)
    theirs = likelihood.get(following)
    overlap = ours is None or theirs is None or ours.lower <= theirs.upper
    difference, lower, upper = (scale * x for x in decision.margin)
    return prefix + text.best_policy(
        best, following, len(names), (difference, lower, upper), level, overlap=overlap
    )


def _write_assumption(
    quoted: Interval, share: float | None, scale: float, *, has_box: bool
) -> str:
    """Say what an interval lets unrecorded pairs do; "" where they hardly matter.

    ``share`` is the share of the policy's time in them, where it is known.
    """
    unrecorded = int(quoted.diagnostics.get("unrecorded_pairs", 0))
    is_small = share is not None and share <= MAX_SHARE_UNTOLD
    if quoted.status != "ok" or not unrecorded or is_small:
        return ""
    factor = float(quoted.diagnostics["unrecorded_factor"])

    def scaled(ends: tuple[float, float] | None) -> tuple[float, float] | None:
        """Return the ends of an interval in the report's unit."""
        return None if ends is None else (scale * ends[0], scale * ends[1])

    anything = quoted.worst_case
    if anything is not None:
        # around maximum likelihood's value, it may be short of the quoted interval
        anything = min(anything[0], quoted.lower), max(anything[1], quoted.upper)
    return text.assumption(
        factor,
        unrecorded,
        share,
        scaled(quoted.sampling) if factor > 1.0 else None,
        scaled(anything) if math.isfinite(factor) else None,
        has_box=has_box,
    )


def _write_unmet(quoted: Interval, problem: Problem) -> str:
    """Say where an interval is wide because the simulator's samples say nothing.

    That is so where the policy spends much of its time in a pair that neither the
    samples nor the log have. "" elsewhere.
    """
    share = float(quoted.diagnostics.get("never_met_share", 0.0))
    if quoted.status != "ok" or share <= MAX_UNMET_SHARE_UNTOLD:
        return ""
    row = int(quoted.diagnostics["never_met_row"])
    names = problem.simulator.names
    state, action = divmod(row, problem.simulator.n_actions)
    return text.unmet(share, names.describe_pair(state, action))


def _describe_trials(both: JoinedTrials, level: float, scale: float) -> str:
    """Say what log and trials say each, what both are worth, and what to do next."""
    own = (scale * both.log.lower, scale * both.log.upper)
    tried = (scale * both.trials[0], scale * both.trials[1])
    sentences = [text.both_sources(scale * both.mean, tried, own, both.number, level)]
    if math.isfinite(both.worth) and not both.is_contradicted:
        sentences.append(text.worth_of_both(both.worth))
    if both.more_trials is not None and both.more_transitions is not None:
        sentences.append(text.halve_interval(both.more_trials, both.more_transitions))
    return " ".join(sentences)


def _write_contradictions(trials: Mapping[str, JoinedTrials], scale: float) -> str:
    """Say of which policies the trials contradict the log; "" if of none."""
    return " ".join(
        text.contradiction(
            name,
            (scale * both.trials[0], scale * both.trials[1]),
            (scale * both.log.lower, scale * both.log.upper),
            both.p_value,
            CONTRADICTION_LEVEL,
        )
        for name, both in trials.items()
        if both.is_contradicted
    )


def _write_apart(
    problem: Problem,
    policies: Mapping[str, Array],
    front: Mapping[str, Estimate],
    joined: Mapping[str, JoinedTrials],
    level: float,
    scale: float,
) -> str:
    """Say of which policies the trials' interval and the log's have nothing in common.

    It is asked where log and trials are not joined; what is joined has a test.
    """
    sentences = []
    for name, policy in policies.items():
        trials = find_trials(problem, policy, name)
        estimate = front.get(name)
        if trials is None or name in joined or estimate is None:
            continue
        of_log = estimate.interval
        if of_log is None or not estimate.is_from_log:
            continue
        of_trials = read_outcomes(problem, policy, trials).ends(level)
        if of_trials[1] < of_log[0] or of_log[1] < of_trials[0]:
            words = text.contradiction(
                name,
                (scale * of_trials[0], scale * of_trials[1]),
                (scale * of_log[0], scale * of_log[1]),
                None,
                level,
            )
            sentences.append(words)
    return " ".join(sentences)


def _describe(intervals: Mapping[str, Interval], scale: float) -> str:
    """Say what the intervals of a policy assume beside unrecorded pairs."""
    quoted = intervals[LIKELIHOOD]
    if quoted.status != "ok":
        return f"{quoted.status}."
    sentences = []
    if "stopped_after" in quoted.diagnostics:
        about = quoted.diagnostics
        sentences.append(text.stopped(about["inner_bounds_of"], about["stopped_after"]))
    dropped = bool(quoted.diagnostics.get("dropped_transitions", 0.0))
    if dropped and quoted.sampling is not None:
        lower, upper = quoted.sampling
        sentences.append(text.without_dropped(lower * scale, upper * scale))
    elif dropped:
        sentences.append(text.DROPPED)
    if GUARANTEED in intervals:
        widest = intervals[GUARANTEED]
        ends = text.format_interval(scale * widest.lower, scale * widest.upper)
        sentences.append(text.INTERVAL_AT_ANY_SIZE.format(ends))
    return " ".join(sentences)

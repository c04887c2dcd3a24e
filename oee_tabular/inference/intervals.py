"""Confidence intervals for J by four methods, and the range of J in a box."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, field
from statistics import NormalDist
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from oee_tabular import _checks, _printing, _progress
from oee_tabular._keywords import suggest_keywords
from oee_tabular._parallel import one_thread
from oee_tabular._results import checked
from oee_tabular.estimators import Estimate, Problem
from oee_tabular.estimators.off_environment import estimate_with_rows
from oee_tabular.exact import policy_value
from oee_tabular.exceptions import ArgumentError
from oee_tabular.inference.asymptotic import (
    Margin,
    bootstrap_values,
    outside_margin,
    value_covariances,
)
from oee_tabular.inference.evidence import (
    Evidence,
    describe_rows,
    evidence_of,
    gather,
    possible_values,
    reachable_rows,
    require_squares,
    unrecorded_share,
)
from oee_tabular.inference.profile_ascent import End, likelihood_ends
from oee_tabular.inference.robust import (
    RadiusKind,
    extreme_value,
    find_contradictions,
    radii,
    require_end,
)
from oee_tabular.inference.shared_parameters import (
    FeaturesLike,
    TieLike,
    shared_directions,
    shared_ends,
)
from oee_tabular.inference.trials import METHOD as WITH_TRIALS
from oee_tabular.inference.trials import JoinedTrials, join
from oee_tabular.mdp import FiniteMDP, check_policy
from oee_tabular.typing import Array, IntArray, PolicyLike, Seed

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# by how much probabilities of unrecorded pairs may differ from the estimated ones
FACTOR = 3.0
# calls of ``interval`` among which a limit of time is divided
CALLS_WITH_TRIALS = 20
METHODS = ("likelihood", "delta", "bootstrap", "robust")
# of the ends: a narrower interval of observed spread is none
VARIATION_TOLERANCE = 1e-12
NO_VARIATION = (
    "the log's transitions that affect the value never vary: no spread can be"
    " estimated; use method='likelihood'"
)


@checked(levels=("confidence",))
@dataclass(frozen=True)
class Interval:
    """A confidence interval for J of a policy in the target, a discounted sum.

    Attributes
    ----------
    lower : float
        The lower end; nan where ``status`` says why there is no interval.
    upper : float
        The upper end; nan where ``status`` says why there is no interval.
    confidence : float
        The level asked for, in (0, 1). "robust" covers with at least this level at any
        sample size, the others as the log grows. It is 1 for a ``value_range``.
    method : str
        "likelihood", "delta", "bootstrap" or "robust"; "likelihood under the tie" or
        "likelihood under the features"; "likelihood with trials"; "range" for a
        ``value_range``.
    diagnostics : dict
        Plain numbers. ``unrecorded_share`` is the share of the policy's discounted time
        in stochastic pairs that were never recorded, and ``unrecorded_pairs`` how many
        of them the policy reaches; ``unrecorded_factor`` is the factor that a
        likelihood interval allows them. A likelihood interval is cut to what the
        rewards of the policy's pairs can sum to (``lowest_possible`` and
        ``highest_possible``), and so is ``sampling``; ``uncut_lower``, ``uncut_upper``
        and ``uncut_sampling_lower``, ``uncut_sampling_upper`` are the ends before,
        where that changes them. If impossible transitions were dropped,
        ``dropped_transitions`` is their number and ``dropped_share`` their estimated
        share of the policy's time. The others describe how the method found the ends.
    status : str
        "ok", or the contradiction between the log and the assumed box.
    sampling : (float, float) or None
        The likelihood interval at ``unrecorded=1``: unrecorded pairs behave as
        estimated. None for the other methods and if there is no standard error. If the
        policy reaches only recorded pairs and no transition was dropped, it is the
        likelihood interval before it is widened for a sampled simulator. Otherwise it
        is the value of ``OffEnvironment()`` ± a normal quantile times its standard
        error, which counts an unrecorded pair as if it had been recorded once.
    worst_case : (float, float) or None
        The likelihood interval at ``unrecorded=inf``: unrecorded pairs may do anything
        that the simulator (and the box) allows. None for the other methods.
    under : str
        The assumption that the interval rests on: "the tie" or "the features"; "" if
        there is none.
    width : float
        The upper end minus the lower end.

    See Also
    --------
    interval : Compute a confidence interval.
    value_range : Compute the range of J without data.

    Examples
    --------
    >>> from oee_tabular.testing import case
    >>> pair = case("ragged")  # a known target
    >>> likelihood = interval(pair.problem(1000, seed=0), pair.policy)
    >>> round(likelihood.lower, 2), round(likelihood.upper, 2), pair.truth in likelihood
    (9.87, 10.54, True)
    >>> print(likelihood)
    [9.87, 10.54], 95% likelihood interval; discounted sum of rewards, not normalised
    """

    lower: float
    upper: float
    confidence: float
    method: str
    diagnostics: dict[str, Any] = field(default_factory=dict, repr=False)
    status: str = "ok"
    sampling: tuple[float, float] | None = None
    under: str = field(default="", repr=False)
    worst_case: tuple[float, float] | None = None

    @property
    def width(self) -> float:
        """Return the upper end minus the lower end."""
        return self.upper - self.lower

    def __contains__(self, value: object) -> bool:
        return isinstance(value, int | float) and self.lower <= value <= self.upper

    def __str__(self) -> str:
        level = f"{100 * self.confidence:.4g}%"
        if self.method == "range":
            what = "range over all models in the box"
        elif self.under:
            what = f"{level} likelihood interval under {self.under}"
        elif self.method == WITH_TRIALS:
            what = f"{level} likelihood interval of log and trials"
        else:
            what = f"{level} {self.method} interval"
        if self.status != "ok":
            return f"no {what}: {self.status}"
        if self.diagnostics.get("inner_bounds_of") == "interval":
            what = (
                f"inner bounds of the {what} (the search was stopped after"
                f" {self.diagnostics['stopped_after']:.3g} s)"
            )
        ends = _printing.interval(self.lower, self.upper, exact=self.method == "range")
        return f"{ends}, {what}; {_printing.SUM}"

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the interval on a line (``oee_tabular.plots.plot_intervals``).

        Parameters
        ----------
        ax : matplotlib Axes, optional
            The axes to draw on. None makes new ones.

        Returns
        -------
        matplotlib Axes
            The axes with the picture.
        """
        from oee_tabular.plots import plot_intervals  # a room above, on use

        return plot_intervals(
            ["value"], [np.nan], [self.lower], [self.upper], ax, title=str(self)
        )

    def _repr_html_(self) -> str:
        spec = _printing.spec(self.lower, self.upper)
        rows: list[tuple[str, object]] = [
            ("lower", format(self.lower, spec)),
            ("upper", format(self.upper, spec)),
            ("width", f"{self.width:.4g}"),
            ("confidence", f"{100 * self.confidence:.4g}%"),
            ("method", self.method),
        ]
        for ends, meaning in (
            (self.sampling, "if unrecorded pairs behave as estimated"),
            (self.worst_case, "if unrecorded pairs may do anything"),
        ):
            if ends is not None:
                rows.append((meaning, _printing.interval(*ends)))
        rows += [
            (name, f"{x:.4g}" if isinstance(x, float) else x)
            for name, x in self.diagnostics.items()
        ]
        return _printing.facts(
            f"Interval for a value: {_printing.SUM}", [*rows, ("status", self.status)]
        )


@suggest_keywords
@one_thread
def interval(
    problem: Problem,
    policy: PolicyLike,
    *,
    method: Literal["likelihood", "delta", "bootstrap", "robust"] = "likelihood",
    confidence: float = 0.95,
    lower_ratio: float | None = None,
    upper_ratio: float | None = None,
    tie: TieLike | None = None,
    features: FeaturesLike | None = None,
    unrecorded: float | None = None,
    radius: Literal["auto", "independent", "anytime"] = "auto",
    resample: Literal["transitions", "episodes"] = "transitions",
    n_bootstrap: int = 400,
    seconds: float | None = None,
    seed: Seed = None,
) -> Interval:
    """Compute a confidence interval for the value of a policy in the target.

    The trials of a problem that has some are joined with its log (``join_trials``). The
    value J is the expected discounted sum of rewards over the problem's horizon.
    Rewards count as known. Every method uses the problem's log and simulator; the
    bounds nu P <= P_target <= mu P of ``lower_ratio`` and ``upper_ratio`` are called
    the box.

    Parameters
    ----------
    problem : Problem
        The simulator, the log of the target, and the horizon.
    policy : PolicyLike
        The policy, in any of the forms of ``mdp.check_policy``.
    method : {'likelihood', 'delta', 'bootstrap', 'robust'}, default 'likelihood'
        How the interval is made:

        - "likelihood": the values that the profile likelihood does not reject, by the
          chi-square quantile of one degree of freedom. It covers in large logs.
          Unrecorded pairs that the policy reaches take their worst and best
          distributions in the box that are near the estimated ones (``unrecorded``).
        - "delta": the value of the maximum-likelihood model ± a normal quantile times
          its standard error. It covers in large logs. It assumes that the simulator is
          exact in unrecorded pairs.
        - "bootstrap": percentiles of the values of resampled maximum-likelihood models.
          It makes the same assumption as "delta".
        - "robust": an interval that covers at any sample size, and is much wider. It
          assumes only that the distributions of all pairs lie in the box and in KL
          balls around their frequencies. Robust policy evaluation computes the ends and
          certifies them.
    confidence : float, default 0.95
        The level, in (0, 1).
    lower_ratio : float, optional
        Lower bound nu in [0, 1] of the box nu P <= P_target <= mu P. The box limits
        "likelihood" in unrecorded pairs and "robust" in all pairs. If the log
        contradicts the box, there is no interval (see Returns); the test is weak
        because it allows for all pairs at once. None for both bounds allows any
        distribution on the simulator's support.
    upper_ratio : float, optional
        Upper bound mu >= 1 of the box.
    tie : array, data frame or function, optional
        A key for each transition that the simulator allows, in the forms of
        ``ratio.Tied``. Transitions with the same key are assumed to differ from the
        simulator by the same factor. The likelihood interval is narrower under this
        assumption, and may miss the value if it is false. Only for "likelihood",
        without bounds and without ``features``.
    features : array, data frame or function, optional
        Features of each transition, as in ``transition_ratio``, along which alone the
        target differs from the simulator.
    unrecorded : float, optional
        The factor, at least 1, by which the probabilities of "likelihood" in pairs that
        were never recorded may differ from the estimated ones (of ``OffEnvironment()``,
        zeta P). 1: they behave as estimated (``Interval.sampling``). ``inf``: they may
        do anything that the simulator and the box allow (``Interval.worst_case``). None
        is 3; with a box, which bounds these pairs itself, it is ``inf``.
    radius : {'auto', 'independent', 'anytime'}, default 'auto'
        The radius of the KL balls of "robust" and of the test of the box. "independent"
        is valid if the counts of pairs were fixed before recording, "anytime" also if
        they are random, as in episodes. "auto" is "anytime" for a log with episodes and
        "independent" otherwise.
    resample : {'transitions', 'episodes'}, default 'transitions'
        What the bootstrap resamples. "episodes" needs a log with at least
        10 episodes.
    n_bootstrap : int, default 400
        The number of resamples, for "bootstrap" only.
    seconds : float, optional
        The time, above 0, after which the search for the ends of ``worst_case`` is
        stopped (and of the interval itself where every pair is recorded). The ends
        found so far are then inner bounds, as ``diagnostics["inner_bounds_of"]`` says.
        None sets no limit.
    seed : int, Generator or SeedSequence, optional
        The seed of the resamples, for "bootstrap" only. None draws a new seed.

    Returns
    -------
    Interval
        The interval, in the unit of J (a discounted sum). If the counts contradict the
        box with this confidence, its ends are nan, and its status names the pairs.

    Raises
    ------
    ValueError
        If an argument is out of its range, if the discount is 1 and the problem has no
        horizon, or if the method cannot take the box, the tie, the features or the
        dropped transitions.

    See Also
    --------
    value_range : Compute the range of J in a box, without data.
    compare_policies : Compare the values of several policies.
    oee_tabular.evaluate : Evaluate policies, with the intervals of all of them.

    Notes
    -----
    "likelihood" costs about a hundred linear solves, all of them for ``worst_case``
    where the policy reaches unrecorded pairs; the interval itself then costs a few
    policy evaluations, as "robust" does. "bootstrap" costs ``n_bootstrap`` policy
    evaluations.

    A "likelihood" interval of a policy that reaches unrecorded pairs is, at a factor k
    between 1 and ``inf``, the default's value -+ max(z se, z se_recorded + Delta_k).
    Here se is its standard error, and se_recorded that of the recorded pairs alone.
    Delta_k is by how much J(Q) falls (rises) in the worst (best) model whose unrecorded
    pairs are within the factor k of the estimated rows Q = zeta P, by robust policy
    evaluation, which is certified. No end goes beyond both ``sampling`` and
    ``worst_case``, or beyond what the rewards can sum to. So the interval holds the
    value, and a larger factor below ``inf`` never gives a shorter one. The ends at
    ``inf`` are around the value by maximum likelihood, so one of them can lie inside.

    ``promised`` in a likelihood interval's diagnostics is a first-order bound on how
    far models in the set may lie beyond its ends, 0 at convergence.
    With a horizon, J may be least or largest in the midst of the set. There it is sought
    where the policy can reach at most 128 states; in larger problems the ends are those
    of ascents along the set's limit, and ``promised`` may stay above 0.

    If a Problem dropped impossible transitions, "likelihood" and "robust" let them lead
    anywhere (to first order), and the others are refused. All intervals widen for a
    sampled simulator's uncertainty in first states, rewards and unsampled transitions
    (``inference.asymptotic``; ``unmet_share`` is the share of time that the latter may
    take, ``never_met_share`` the share in pairs that neither the samples nor the log
    have, most of it in row s*A + a = ``never_met_row``). ``sampling`` includes neither.

    Examples
    --------
    >>> from oee_tabular.testing import case
    >>> pair = case("ragged")  # a known target
    >>> problem = pair.problem(1000, seed=0)
    >>> [
    ...     round(interval(problem, pair.policy, method=method).width, 2)
    ...     for method in ("likelihood", "delta", "robust")
    ... ]
    [0.66, 0.66, 5.12]
    """
    _checks.instance(problem, Problem, "problem")
    _checks.one_of(method, "method", METHODS)
    _checks.one_of(radius, "radius", ("auto", "independent", "anytime"))
    _checks.one_of(resample, "resample", ("transitions", "episodes"))
    level = _checks.number_in(confidence, "confidence", 0.0, 1.0, open_ends=True)
    has_box = lower_ratio is not None or upper_ratio is not None
    factor = check_factor(unrecorded, has_box=has_box)
    limit = check_seconds(seconds, "seconds")
    # options of one method are checked with all of them
    number = _checks.positive_integer(n_bootstrap, "n_bootstrap")
    _checks.generator(seed)
    if problem.simulator.discount == 1.0 and problem.horizon is None:
        raise ArgumentError("horizon", "must be given at discount 1")
    if problem.trials is not None:
        _refuse_beside_trials(method, tie, features)
        both = join_trials(
            problem,
            policy,
            confidence=level,
            lower_ratio=lower_ratio,
            upper_ratio=upper_ratio,
            unrecorded=unrecorded,
            seconds=limit,
        )
        return both.interval
    if tie is not None or features is not None:
        return _interval_under(
            problem, policy, tie, features, level, method, has_box=has_box
        )
    evidence = gather(problem, policy, lower_ratio, upper_ratio)
    has_dropped = bool(problem.dropped.any())
    if has_dropped and method not in ("likelihood", "robust"):
        raise ArgumentError(
            "method",
            "must be 'likelihood' or 'robust' if impossible transitions were dropped;"
            f" it is {_checks.show(method)}",
        )
    if has_dropped and evidence.has_box:
        raise ValueError(
            "lower_ratio and upper_ratio must be None if impossible transitions were"
            " dropped: no box contains those"
        )
    # the counts of a log of episodes are random themselves
    kind = radius
    if kind == "auto":
        kind = "anytime" if problem.log.by_episodes else "independent"
    z = NormalDist().inv_cdf(0.5 + level / 2.0)
    margin, facts = _gather_facts(problem, evidence)
    if evidence.has_box:
        wrong = find_contradictions(evidence, level, kind)
        if wrong.size:
            box = (lower_ratio, upper_ratio)
            status = _write_contradiction(evidence, wrong, box, level)
            facts["contradicted_rows"] = wrong
            return Interval(np.nan, np.nan, level, method, facts, status)
    if method == "likelihood":
        return _likelihood_interval(
            problem, evidence, level, factor, margin, facts, limit
        )
    if method == "robust":
        lower, upper, about = _robust_interval(problem, evidence, level, kind)
    elif method == "delta":
        lower, upper, about = _delta_interval(evidence, z)
    else:
        values = bootstrap_values(
            problem, evidence, by=resample, n_bootstrap=number, seed=seed
        )
        lower, upper, about = _percentile_interval(values, level)
    facts |= about
    if margin is not None:
        lower, upper = margin.widen(lower, upper, z)
    # a spread of 0 is no evidence of certainty, unless every transition is certain
    is_narrow = not upper - lower > VARIATION_TOLERANCE * max(abs(lower), abs(upper))
    is_certain = not (evidence.is_stochastic & evidence.reachable).any()
    if method in ("delta", "bootstrap") and is_narrow and not is_certain:
        facts["standard_error"] = np.nan
        return Interval(np.nan, np.nan, level, method, facts, NO_VARIATION)
    return Interval(lower, upper, level, method, facts)


@suggest_keywords
@one_thread
def join_trials(
    problem: Problem,
    policy: PolicyLike,
    *,
    name: str | None = None,
    confidence: float = 0.95,
    lower_ratio: float | None = None,
    upper_ratio: float | None = None,
    unrecorded: float | None = None,
    seconds: float | None = None,
) -> JoinedTrials:
    """Join the trials of a policy with the log, by one likelihood.

    Parameters
    ----------
    problem : Problem
        The simulator, the log and the trials.
    policy : PolicyLike
        The policy that was tried.
    name : str, optional
        The name of the policy among the trials. None means that the trials have no
        names.
    confidence : float, default 0.95
        The level of the intervals, in (0, 1).
    lower_ratio : float, optional
        Lower bound of the box, as in ``interval``.
    upper_ratio : float, optional
        Upper bound of the box, as in ``interval``.
    unrecorded : float, optional
        The factor of pairs that were never recorded, as in ``interval``.
    seconds : float, optional
        The time for the log's searches, as in ``interval``.

    Returns
    -------
    JoinedTrials
        Value, intervals, the test of log against trials, and what halves the
        interval.

    Raises
    ------
    ValueError
        If the problem has no trials of this policy, or an argument is out of its range.

    See Also
    --------
    interval : Compute the joined interval alone.

    Notes
    -----
    It costs ten to thirty times as much as ``interval`` without trials.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> from oee_tabular.testing import case
    >>> pair = case("ragged")  # a known target
    >>> log = pair.problem(30, seed=0).log
    >>> trials = oee.Trials([10.2, 9.6, 11.4, 8.9, 10.9, 10.1])
    >>> both = join_trials(oee.Problem(pair.simulator, log, trials=trials), pair.policy)
    >>> both.interval.width < both.log.width, round(both.p_value, 2) > 0.01
    (True, True)
    """
    _checks.instance(problem, Problem, "problem")
    level = _checks.number_in(confidence, "confidence", 0.0, 1.0, open_ends=True)
    limit = check_seconds(seconds, "seconds")
    pi = check_policy(policy, problem.simulator)

    def find(z: float) -> Interval:
        """Return the log's interval at z standard deviations."""
        return interval(
            problem.without_trials,
            pi,
            confidence=math.erf(z / math.sqrt(2.0)),
            lower_ratio=lower_ratio,
            upper_ratio=upper_ratio,
            unrecorded=unrecorded,
            # 0 would leave the search out, and a tiny limit must not become it
            seconds=limit and max(limit / CALLS_WITH_TRIALS, sys.float_info.min),
        )

    return join(problem, pi, name, level, find)


@suggest_keywords
@one_thread
def value_range(
    simulator: FiniteMDP,
    policy: PolicyLike,
    lower_ratio: float | None,
    upper_ratio: float | None,
    *,
    horizon: int | None = None,
) -> Interval:
    """Compute the range of J over all targets in a box around the simulator.

    The targets are those of Assumption V.1: nu P <= P' <= mu P.

    Parameters
    ----------
    simulator : FiniteMDP
        The simulator, with transition probabilities P.
    policy : PolicyLike
        The policy; with a horizon T also an array of shape (T, S, A).
    lower_ratio : float or None
        Lower bound nu in [0, 1]; 0 or None sets no lower bound.
    upper_ratio : float or None
        Upper bound mu in [1, inf]; inf or None sets no upper bound.
    horizon : int, optional
        Number of rewards, at t = 0..horizon-1. None means the infinite discounted sum.

    Returns
    -------
    Interval
        The range, in the unit of J. Models in the box attain both ends. ``confidence``
        is 1 and ``method`` "range". In its ``diagnostics``, ``sweeps`` is the number of
        robust evaluations, and ``certified_beyond`` by how much at most rounding
        widened an end.

    Raises
    ------
    ValueError
        If an argument is out of its range, or if the discount is 1, there is no
        horizon, and the sum diverges in some model of the box.

    See Also
    --------
    interval : Compute a confidence interval from a log.

    Notes
    -----
    Without data ``interval`` with this box is the same. With a horizon the target may
    change from step to step. Cost: some policy evaluations, and O(nnz) a sweep.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator = oee.tasks.gridworld(4, slip=0.3)
    >>> expert = oee.tasks.gridworld_expert(4)
    >>> print(value_range(simulator, expert, 0.5, 2.0))
    [-13.48, -3.82], range over all models in the box; discounted sum of rewards, not normalised
    """
    _checks.instance(simulator, FiniteMDP, "simulator")
    horizon = _checks.optional_horizon(horizon)
    pi = check_policy(policy, simulator, horizon=horizon)
    evidence = evidence_of(simulator, pi, horizon, None, lower_ratio, upper_ratio)
    if simulator.discount == 1.0 and horizon is None:
        require_end(evidence)
    free = np.full(len(evidence.n), np.inf)
    low, high = (extreme_value(evidence, free, sign) for sign in (-1.0, 1.0))
    beyond = max(abs(end.bound - end.value) for end in (low, high))
    facts = {"sweeps": max(low.sweeps, high.sweeps), "certified_beyond": beyond}
    return Interval(low.bound, high.bound, 1.0, "range", facts)


def interval_without_search(
    problem: Problem, policy: PolicyLike, *, confidence: float, unrecorded: float | None
) -> Interval | None:
    """Compute the likelihood interval without the search for its worst case.

    None where it would be that search's alone: where every pair is recorded, and at an
    infinite factor. The other arguments are those of ``interval``.
    """
    factor = check_factor(unrecorded, has_box=False)
    evidence = gather(problem, policy)
    if math.isinf(factor) or not _count_unrecorded(evidence):
        return None
    estimate, _ = estimate_with_rows(problem, evidence.policy)
    if estimate.standard_error is None or not math.isfinite(estimate.standard_error):
        return None
    margin, facts = _gather_facts(problem, evidence)
    return _likelihood_interval(
        problem, evidence, confidence, factor, margin, facts, 0.0
    )


def _refuse_beside_trials(method: str, tie: object, features: object) -> None:
    """Refuse what cannot be joined with trials."""
    remedy = "(problem.without_trials has none)"
    if method != "likelihood":
        raise ArgumentError(
            "method",
            f"must be 'likelihood' with trials, which it joins; it is {method!r}"
            f" {remedy}",
        )
    for name, given in (("tie", tie), ("features", features)):
        if given is not None:
            raise ArgumentError(name, f"must be None with trials {remedy}")


def _gather_facts(
    problem: Problem, evidence: Evidence
) -> tuple[Margin | None, dict[str, Any]]:
    """Return by how much an interval is to be widened, and its first diagnostics."""
    margin = outside_margin(problem, evidence)
    facts: dict[str, Any] = {
        "unrecorded_share": unrecorded_share(evidence),
        "unrecorded_pairs": _count_unrecorded(evidence),
    }
    if margin is not None:
        facts |= margin.diagnostics
    return margin, facts


def check_factor(unrecorded: object, *, has_box: bool) -> float:
    """Check the factor of unrecorded pairs; None is the default.

    The default is ``FACTOR``, and infinity with a box, which bounds these pairs itself.
    """
    if unrecorded is None:
        return np.inf if has_box else FACTOR
    return _checks.number_in(unrecorded, "unrecorded", 1.0, np.inf, infinite=True)


def check_seconds(seconds: object, name: str) -> float | None:
    """Check a limit in seconds, above 0; None is no limit."""
    if seconds is None:
        return None
    return _checks.number_in(seconds, name, 0.0, np.inf, open_ends=True)


def _likelihood_interval(
    problem: Problem,
    evidence: Evidence,
    level: float,
    factor: float,
    margin: Margin | None,
    facts: dict[str, Any],
    seconds: float | None,
) -> Interval:
    """Compute the likelihood interval at a factor, with its two ends.

    The end at infinity, ``worst_case``, is the profile likelihood's interval, by
    ascents; it is the interval itself where every pair is recorded. The search for it
    ends after ``seconds``, and is left out where they are 0. The end at 1,
    ``sampling``, is the default's value -+ z standard errors.

    At a factor k between, the ends are

        value -+ max(z se, z se_recorded + Delta_k),

    se_recorded the standard error of the recorded pairs alone, and Delta_k by how much
    J falls below (rises above) J(Q) in the worst (best) model whose unrecorded pairs
    are within the factor k of the estimated rows Q = zeta P, and whose recorded pairs
    are Q's: a robust evaluation, whose optimum is global and certified. They do not go
    beyond both ``sampling`` and ``worst_case``. So the value is inside, and a larger
    finite factor never gives a shorter interval. The default's
    value is a better centre than maximum likelihood's where pairs have few transitions.
    """
    z = NormalDist().inv_cdf(0.5 + level / 2.0)
    has_gaps = facts["unrecorded_pairs"] > 0
    estimate = None
    worst = None
    ends: list[End] = []
    if seconds is None or seconds > 0.0:
        ends += likelihood_ends(evidence, level, _progress.Watch(seconds))
        worst = ends[0].value, ends[1].value
        facts |= _describe_ends(ends)
    sampling = worst
    if has_gaps or problem.dropped.any() or worst is None:
        estimate, estimated = estimate_with_rows(problem, evidence.policy)
        sampling = _interval_as_estimated(evidence, estimate, z, worst)
        facts["sampling_method"] = "value ± quantile x standard error"
    facts["unrecorded_factor"] = factor
    quoted = worst
    is_searched = True  # whether the ends are those of the ascents
    if has_gaps and factor < np.inf and estimate is not None and sampling is not None:
        is_searched = False
        quoted = _widen_by_factor(evidence, estimate, estimated, factor, z)
        if worst is not None and all(end.is_final for end in ends):
            # no further than what both ends of the factor allow
            quoted = (
                max(quoted[0], min(sampling[0], worst[0])),
                min(quoted[1], max(sampling[1], worst[1])),
            )
    elif worst is None:
        is_searched = False
        quoted = sampling
    assert quoted is not None  # with an estimate or a search there is one
    if margin is not None:
        quoted = margin.widen(*quoted, z)
        worst = None if worst is None else margin.widen(*worst, z)
    if factor == 1.0 and sampling is not None:
        is_searched = False
        quoted = sampling
    possible = possible_values(problem, evidence, z)
    facts |= {"lowest_possible": possible[0], "highest_possible": possible[1]}
    quoted = _cut(*quoted, possible, facts, "uncut")
    if sampling is not None:
        sampling = _cut(*sampling, possible, facts, "uncut_sampling")
    if not all(end.is_final for end in ends):
        facts["stopped_after"] = seconds
        facts["inner_bounds_of"] = "interval" if is_searched else "worst case"
    return Interval(
        *quoted,
        level,
        "likelihood",
        facts,
        sampling=sampling,
        worst_case=worst,
    )


def _cut(
    lower: float,
    upper: float,
    possible: tuple[float, float],
    facts: dict[str, Any],
    name: str,
) -> tuple[float, float]:
    """Return ends within what the rewards can sum to, and keep those before.

    A normal quantile knows no bounds: around a value near the largest one possible, its
    upper end is often beyond. The ends before the cut go into ``facts`` where it
    changes them.
    """
    cut = float(np.clip(lower, *possible)), float(np.clip(upper, *possible))
    if cut != (lower, upper):
        facts |= {f"{name}_lower": lower, f"{name}_upper": upper}
    return cut


def _describe_ends(ends: list[End]) -> dict[str, Any]:
    """Return how the ends of the profile likelihood's interval were found."""
    return {
        "divergence": max(end.divergence for end in ends),
        "iterations": max(end.iterations for end in ends),
        "last_change": max(end.change for end in ends),
        "promised": max(end.promised for end in ends),
    }


def _widen_by_factor(
    evidence: Evidence, estimate: Estimate, estimated: Array, factor: float, z: float
) -> tuple[float, float]:
    """Compute value -+ max(z se, z se_recorded + Delta), Delta by robust evaluation."""
    error = estimate.standard_error or 0.0
    in_gaps = estimate.diagnostics["unrecorded_standard_error"]
    recorded = float(np.sqrt(max(error**2 - in_gaps**2, 0.0)))
    near = evidence.near(estimated, factor)
    free = np.full(len(evidence.n), np.inf)
    centre = policy_value(near.fitted, evidence.policy, horizon=evidence.horizon)
    low, high = (extreme_value(near, free, sign) for sign in (-1.0, 1.0))
    down = max(centre - low.bound, 0.0)
    up = max(high.bound - centre, 0.0)
    return (
        estimate.value - max(z * error, z * recorded + down),
        estimate.value + max(z * error, z * recorded + up),
    )


def _robust_interval(
    problem: Problem, evidence: Evidence, level: float, kind: RadiusKind
) -> tuple[float, float, dict[str, Any]]:
    """Return certified bounds of J over KL balls and box, and how they were found."""
    require_squares(problem.model)
    radius_of_row = radii(evidence, level, kind)
    low, high = (extreme_value(evidence, radius_of_row, sign) for sign in (-1.0, 1.0))
    beyond = max(abs(low.bound - low.value), abs(high.bound - high.value))
    about = {
        "radius": kind,
        "sweeps": max(low.sweeps, high.sweeps),
        "certified_beyond": beyond,
    }
    return low.bound, high.bound, about


def _delta_interval(
    evidence: Evidence, z: float
) -> tuple[float, float, dict[str, Any]]:
    """Return the maximum-likelihood value -+ z standard errors by the delta method."""
    value = policy_value(evidence.fitted, evidence.policy, horizon=evidence.horizon)
    recorded, _ = value_covariances([evidence], prior=0.0)
    error = float(np.sqrt(recorded[0, 0]))
    return value - z * error, value + z * error, {"standard_error": error}


def _percentile_interval(
    values: Array, level: float
) -> tuple[float, float, dict[str, Any]]:
    """Return the percentile interval of resampled values, and their deviation."""
    shares = [(1.0 - level) / 2.0, (1.0 + level) / 2.0]
    lower, upper = (float(x) for x in np.quantile(values, shares))
    return lower, upper, {"standard_error": float(values.std(ddof=1))}


def _write_contradiction(
    evidence: Evidence,
    wrong: IntArray,
    box: tuple[float | None, float | None],
    level: float,
) -> str:
    """Write in which pairs the counts contradict the box."""
    lower = box[0] or 0
    upper = np.inf if box[1] is None else box[1]
    plural = "s" if wrong.size > 1 else ""
    return (
        f"the counts contradict the box [{lower:g}, {upper:g}] in {wrong.size}"
        f" state-action pair{plural}, with confidence {level:g}:"
        f" {describe_rows(evidence, wrong)}; widen it"
    )


def _interval_under(
    problem: Problem,
    policy: PolicyLike,
    tie: TieLike | None,
    features: FeaturesLike | None,
    level: float,
    method: str,
    *,
    has_box: bool,
) -> Interval:
    """Compute the likelihood interval of a model whose rows share parameters."""
    given = "features" if tie is None else "tie"
    if has_box:
        raise ValueError(
            f"lower_ratio and upper_ratio must be None with {given}, which defines the"
            " model"
        )
    if method != "likelihood":
        raise ArgumentError(
            "method", f"must be 'likelihood' with {given}, which defines the model"
        )
    if problem.dropped.any():
        raise ValueError(
            "tie and features must be left out if impossible transitions were dropped,"
            " which they do not describe"
        )
    directions = shared_directions(problem.simulator, tie, features)
    pi = check_policy(policy, problem.simulator)
    lower, upper, estimate = shared_ends(problem, pi, directions, level)
    facts = {"estimate": estimate, "n_parameters": len(directions.names)}
    under = f"the {given}"
    return Interval(
        lower, upper, level, f"likelihood under {under}", facts, under=under
    )


def _interval_as_estimated(
    evidence: Evidence,
    estimate: Estimate,
    z: float,
    worst: tuple[float, float] | None,
) -> tuple[float, float] | None:
    """Return the default's value -+ a normal quantile times its standard error.

    Under a box it stays within the ends of the worst case. None without a standard
    error.
    """
    if estimate.standard_error is None or not np.isfinite(estimate.standard_error):
        return None
    lower = estimate.value - z * estimate.standard_error
    upper = estimate.value + z * estimate.standard_error
    if evidence.has_box and worst is not None:
        lower, upper = np.clip((lower, upper), *worst).tolist()
    return lower, upper


def _count_unrecorded(evidence: Evidence) -> int:
    """Count the stochastic pairs that bear on the value and were never recorded."""
    steps = 1 if evidence.model.discount == 0.0 else evidence.horizon
    if steps is not None and evidence.model.reward_data is None:
        # with rewards r(s, a), no reward depends on where the last step leads
        steps -= 1
    reached = evidence.reachable if steps is None else reachable_rows(evidence, steps)
    return int(((evidence.n == 0) & evidence.is_stochastic & reached).sum())

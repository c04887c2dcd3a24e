"""Trials of a policy joined with the log: one likelihood for J.

    l(j) = D(j) + T(j),   {j : l(j) <= min l + chi^2_1 / 2},

with D the log's half deviance at J = j, and T that of the trials; log and trials are
independent.

*The log's.* ``interval`` finds for a level the ends of J. D is its inverse: where an
end at the level chi^2_1(z^2) is at j, D(j) = z^2 / 2, and D is 0 between the two ends
at level 0. So D rests on the same models and the same assumption about unrecorded pairs
as the log's own interval, and is the profile likelihood where every pair is recorded.
It is a monotone curve on each side. It is interpolated between levels, and the ends of
the joined interval are computed anew until they stay (``last_change``).

*The trials'.* With m outcomes y of mean y_m and variance s^2 (unbiased), T = z^2 / 2 of

    returns     Phi(z) = F_{m-1}((y_m - j) / (s / sqrt m)),  F of Student's t,
    successes   z = (y_m - j) / sqrt(j (1 - j) / m),  the score.

Both are the usual likelihoods, m/2 log(1 + (y_m - j)^2 / s^2) and m KL(y_m || j), to
first order, with a correction for few trials: without a log the interval is Student's
and Wilson's [1]. Returns that do not vary have the variance of the corrected simulator.

*The least width.* No estimator of both has a variance below V = (1 / V_log + m / Var
Y)^-1. Three times the trials that have as narrow an interval halve it, or as many
transitions as bring as much: n V_log / Var Y for each trial, recorded as the n before.

*Contradiction.* 2 min l is a chi-square of one degree of freedom if log and trials are
of one target. Where it rejects that, the interval reaches over both.

Sources: [1] E. B. Wilson, Probable inference, the law of succession, and statistical
inference, JASA 22, 1927. A. Owen, Empirical Likelihood, 2001.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from statistics import NormalDist
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq, minimize_scalar
from scipy.special import gammaincinv, ndtri_exp, stdtr, stdtrit
from scipy.stats import chi2

from oee_tabular import _checks
from oee_tabular._results import checked
from oee_tabular.data import Trials, success_states
from oee_tabular.estimators import Problem
from oee_tabular.estimators.off_environment import estimate_with_rows
from oee_tabular.exact import return_moments
from oee_tabular.exceptions import ArgumentError
from oee_tabular.inference.evidence import gather
from oee_tabular.mdp import check_policy
from oee_tabular.typing import Array

if TYPE_CHECKING:
    from oee_tabular.inference.intervals import Interval

METHOD = "likelihood with trials"  # of an interval
# p-value below which log and trials contradict each other
CONTRADICTION_LEVEL = 0.01
# standard deviations at which the log's interval is computed first
NEAREST = 1e-3  # of them stands for level 0
FIRST_DEVIATIONS = (NEAREST, 1.0, 2.0, 3.5, 7.0)
MAX_DEVIATIONS = 7.0  # of the log: beyond them a level is 1 as a float
# of the joined interval's width: by how much its ends may move in the last round
END_TOLERANCE = 1e-6
MAX_ROUNDS = 8
MIN_GAP = 0.1  # standard deviations between nodes that are not the latest
GRID_STEP = 0.01  # standard deviations between the points that are searched
SAME_POLICY = 1e-9  # of a probability: policies that differ by less are the same
# of the squared mean: a smaller variance is rounding
VARIANCE_TOLERANCE = 1e-20
SMALLEST_WIDTH = 5e-324  # the least positive float
MAX_LOG_TRIALS = 300.0  # natural logarithm of more trials than any interval is worth


class Outcomes(NamedTuple):
    """The outcomes of m trials: their mean, and the variance of one of them.

    ``freedom`` are the degrees of freedom of the variance; it is infinite where the
    variance is the corrected simulator's. Successes have no variance of their own.
    """

    number: float
    mean: float
    variance: float
    freedom: float
    is_success: bool

    def deviations(self, j: Array) -> Array:
        """Return the signed root of 2 T at values j, in standard deviations."""
        if self.is_success:
            with np.errstate(divide="ignore", invalid="ignore"):
                spread = np.sqrt(np.clip(j * (1.0 - j), 0.0, None) / self.number)
                z = (self.mean - j) / spread
            # at 0 and 1 only an outcome that never varied is possible
            z = np.where((spread == 0.0) & (j == self.mean), 0.0, z)
            return np.where((j < 0.0) | (j > 1.0), np.inf, z)
        t = (self.mean - j) / math.sqrt(self.variance / self.number)
        if math.isinf(self.freedom):
            return np.asarray(t)
        # from the tail, where the distribution function is not 1
        tail = stdtr(self.freedom, -np.abs(t))
        with np.errstate(divide="ignore"):
            z = -ndtri_exp(np.log(tail))
        return np.asarray(np.sign(t) * z)

    def half_deviance(self, j: Array) -> Array:
        """Return T at values j."""
        return np.asarray(0.5 * self.deviations(j) ** 2)

    def ends(self, level: float) -> tuple[float, float]:
        """Return the interval of the trials alone: Wilson's, or Student's."""
        z = NormalDist().inv_cdf(0.5 + level / 2.0)
        m = self.number
        if self.is_success:
            centre = (self.mean + z**2 / (2.0 * m)) / (1.0 + z**2 / m)
            spread = self.mean * (1.0 - self.mean) / m + z**2 / (4.0 * m**2)
            half = z * math.sqrt(spread) / (1.0 + z**2 / m)
        else:
            quantile = z
            if math.isfinite(self.freedom):
                quantile = float(stdtrit(self.freedom, 0.5 + level / 2.0))
            centre = self.mean
            half = quantile * math.sqrt(self.variance / m)
        return centre - half, centre + half


@dataclass(frozen=True, eq=False)
class Curve:
    """The log's ends of J as functions of z, from level 0 (z = 0) outwards.

    ``nodes`` are values of z, ``lower`` and ``upper`` the ends there.
    """

    nodes: Array
    lower: Array
    upper: Array

    @cached_property
    def below(self) -> Callable[[Array], Array]:
        """Return the lower end as a function of z."""
        return _interpolate(self.nodes, self.lower)

    @cached_property
    def above(self) -> Callable[[Array], Array]:
        """Return the upper end as a function of z."""
        return _interpolate(self.nodes, self.upper)

    def at(self, place: Array) -> tuple[Array, Array]:
        """Return z and J at places on the curve.

        From -1 to 1 is the stretch between the two ends of level 0; beyond it a place
        is one unit farther out than its z.
        """
        z = np.sign(place) * np.maximum(np.abs(place) - 1.0, 0.0)
        out = np.maximum(np.abs(z), self.nodes[0])
        share = 0.5 * (np.clip(place, -1.0, 1.0) + 1.0)
        middle = self.lower[0] + share * (self.upper[0] - self.lower[0])
        j = np.where(place < -1.0, self.below(out), middle)
        return z, np.where(place > 1.0, self.above(out), j)


def _interpolate(nodes: Array, ends: Array) -> Callable[[Array], Array]:
    """Return a cubic spline through ends, which stays between those of two nodes.

    Where ends stop at once, a spline alone would swing.
    """
    smooth = CubicSpline(nodes, ends)

    def curve(z: Array) -> Array:
        """Return the end at each z."""
        k = np.clip(np.searchsorted(nodes, z) - 1, 0, len(nodes) - 2)
        low = np.minimum(ends[k], ends[k + 1])
        high = np.maximum(ends[k], ends[k + 1])
        return np.asarray(np.clip(smooth(z), low, high))

    return curve


class Cut(NamedTuple):
    """The joined interval, the least of l, and the log's z at both ends and there."""

    lower: float
    upper: float
    least: float
    deviations: tuple[float, ...]


@checked()
@dataclass(frozen=True)
class JoinedTrials:
    """Hold what a log and trials of one policy say together of its value.

    Attributes
    ----------
    value : float
        The value by both, a discounted sum: the least of l(j) with the default's value
        and standard error for the log, put inside of the interval. Where both
        contradict each other it is the mean of the trials, which saw the target itself.
    standard_error : float or None
        The standard error by both, sqrt(V); None where the log has none, or both
        contradict each other.
    interval : Interval
        The joined interval.
    log : Interval
        The interval by the log alone.
    trials : (float, float)
        The interval by the trials alone.
    mean : float
        The mean outcome of the trials.
    number : float
        The number of trials; with weights, of trials of equal weight that are worth as
        much.
    variance : float
        The variance of one outcome.
    p_value : float
        The p-value, in [0, 1], of the test that log and trials are of one target.
    is_contradicted : bool
        Whether this test rejects at 1%. The interval then reaches over the joined one,
        the log's and the trials'.
    worth : float
        The number of trials alone whose own interval, Wilson's or Student's as in
        ``trials``, would be as narrow: inf where the joined interval is a point, nan
        where it has no ends.
    more_trials : float or None
        The number of further trials that halve the interval, about three times
        ``worth``; by the bound where that is no number. None without a standard error.
    more_transitions : float or None
        The number of further transitions, recorded as those of the log, that halve it.

    See Also
    --------
    join_trials : Join the trials of a policy with the log.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> from oee_tabular.testing import case
    >>> pair = case("ragged")
    >>> log = pair.problem(30, seed=0).log
    >>> trials = oee.Trials([10.2, 9.6, 11.4, 8.9, 10.9, 10.1])
    >>> problem = oee.Problem(pair.simulator, log, trials=trials)
    >>> both = oee.inference.join_trials(problem, pair.policy)
    >>> both.number, round(both.mean, 2), both.is_contradicted
    (6.0, 10.18, False)
    """

    value: float
    standard_error: float | None
    interval: Interval
    log: Interval
    trials: tuple[float, float]
    mean: float
    number: float
    variance: float
    p_value: float
    is_contradicted: bool
    worth: float
    more_trials: float | None
    more_transitions: float | None


def join(
    problem: Problem,
    policy: Array,
    name: str | None,
    level: float,
    find: Callable[[float], Interval],
) -> JoinedTrials:
    """Join the trials of a checked policy with the log.

    ``find`` returns the log's interval at a number of standard deviations.
    """
    trials = find_trials(problem, policy, name)
    if trials is None:
        raise ArgumentError("problem", "must have trials of this policy; it has none")
    own = replace(find(NormalDist().inv_cdf(0.5 + level / 2.0)), confidence=level)
    outcomes = read_outcomes(problem, policy, trials)
    by_trials = outcomes.ends(level)
    joined = replace(own, method=METHOD)
    p_value = 1.0
    if own.status == "ok":
        joined, p_value = _join(find, own, outcomes, by_trials, level)
    return _describe(problem, policy, outcomes, joined, own, by_trials, p_value, level)


def _join(
    find: Callable[[float], Interval],
    own: Interval,
    outcomes: Outcomes,
    by_trials: tuple[float, float],
    level: float,
) -> tuple[Interval, float]:
    """Return the joined interval, and the p-value of log against trials.

    The ends at both ends of the factor of unrecorded pairs are joined as well.
    """
    known = {z: find(z) for z in FIRST_DEVIATIONS}
    known[NormalDist().inv_cdf(0.5 + level / 2.0)] = own
    limit = float(gammaincinv(0.5, level))
    cut, change = _refine(find, known, _quoted, outcomes, limit)
    p_value = float(chi2.sf(2.0 * cut.least, 1))
    ends = cut.lower, cut.upper
    if p_value < CONTRADICTION_LEVEL:
        ends = (
            min(ends[0], own.lower, by_trials[0]),
            max(ends[1], own.upper, by_trials[1]),
        )
    more: dict[str, tuple[float, float] | None] = {}
    for label, ends_of in (("sampling", _sampling), ("worst_case", _worst)):
        more[label] = None
        found = [(ends_of(one), _quoted(one)) for one in known.values()]
        if all(side == quoted for side, quoted in found):
            more[label] = (cut.lower, cut.upper)
        elif all(side is not None for side, _ in found):
            other, _ = _refine(find, known, ends_of, outcomes, limit)
            more[label] = (other.lower, other.upper)
    # the cut is of the log's own interval: trials may show returns beyond
    facts = {k: v for k, v in own.diagnostics.items() if not k.startswith("uncut")}
    facts |= {
        "trials": outcomes.number,
        "trials_mean": outcomes.mean,
        "log_lower": own.lower,
        "log_upper": own.upper,
        "trials_lower": by_trials[0],
        "trials_upper": by_trials[1],
        "contradiction_p_value": p_value,
        "last_change": change,
    }
    joined = replace(
        own,
        lower=ends[0],
        upper=ends[1],
        method=METHOD,
        diagnostics=facts,
        sampling=more["sampling"],
        worst_case=more["worst_case"],
    )
    return joined, p_value


def _quoted(found: Interval) -> tuple[float, float]:
    """Return the ends of an interval, not cut to what the rewards can sum to.

    Cut ends would not move with the level, by which the likelihood is known.
    """
    facts = found.diagnostics
    return (
        facts.get("uncut_lower", found.lower),
        facts.get("uncut_upper", found.upper),
    )


def _sampling(found: Interval) -> tuple[float, float] | None:
    """Return the ends if unrecorded pairs behave as estimated, not cut."""
    if found.sampling is None:
        return None
    lower, upper = found.sampling
    facts = found.diagnostics
    return (
        facts.get("uncut_sampling_lower", lower),
        facts.get("uncut_sampling_upper", upper),
    )


def _worst(found: Interval) -> tuple[float, float] | None:
    """Return the ends if unrecorded pairs may do anything."""
    return found.worst_case


def _refine(
    find: Callable[[float], Interval],
    known: dict[float, Interval],
    ends_of: Callable[[Interval], tuple[float, float] | None],
    outcomes: Outcomes,
    limit: float,
) -> tuple[Cut, float]:
    """Cut the curve, and compute the log's ends anew there until the cut stays.

    New ends are also computed at three places around the least of l, since the cut
    depends on that.

    ``known`` are the log's intervals by z, to which new ones are added. The second
    result is by how much the ends moved in the last round.
    """
    cut = _cut(_curve(known, ends_of, ()), outcomes, limit)
    around: tuple[float, ...] = ()
    change = np.inf
    for _ in range(MAX_ROUNDS):
        *outer, centre = (max(abs(z), NEAREST) for z in cut.deviations)
        if not around or not min(around) <= centre <= max(around):
            around = (centre, max(centre - MIN_GAP / 2, NEAREST), centre + MIN_GAP / 2)
        latest = tuple(min(z, MAX_DEVIATIONS) for z in (*outer, *around))
        known.update({z: find(z) for z in latest if z not in known})
        before = cut
        cut = _cut(_curve(known, ends_of, latest), outcomes, limit)
        change = max(abs(cut.lower - before.lower), abs(cut.upper - before.upper))
        if change <= END_TOLERANCE * (cut.upper - cut.lower):
            break
    return cut, float(change)


def _curve(
    known: Mapping[float, Interval],
    ends_of: Callable[[Interval], tuple[float, float] | None],
    latest: Sequence[float],
) -> Curve:
    """Return the log's ends as a curve that is monotone, whatever rounding does.

    Beside the ``latest`` nodes the curve has others that are far enough from all, since
    its slope is wrong where two nodes are close.
    """
    kept = list(latest)
    for z in sorted(known):
        if all(abs(z - other) > MIN_GAP for other in kept):
            kept.append(z)
    # the ends of level 0 are where the curve begins
    kept.append(NEAREST)
    nodes = np.array(sorted(set(kept)))
    ends = np.array([ends_of(known[z]) for z in nodes], dtype=np.float64)
    lower = np.minimum.accumulate(ends[:, 0])
    upper = np.maximum.accumulate(ends[:, 1])
    if lower[0] > upper[0]:
        lower[0] = upper[0] = 0.5 * (lower[0] + upper[0])
    return Curve(nodes, lower, upper)


def _cut(curve: Curve, outcomes: Outcomes, limit: float) -> Cut:
    """Find the j with l(j) <= min l + limit, between its least and its largest."""

    def height(place: Array) -> Array:
        """Return l at places on the curve."""
        z, j = curve.at(place)
        return np.asarray(0.5 * z**2 + outcomes.half_deviance(j))

    farthest = 1.0 + MAX_DEVIATIONS
    places = np.linspace(-farthest, farthest, 1 + round(2.0 * farthest / GRID_STEP))
    # the mean may be a narrow valley between two of them
    low, high = curve.lower[0], curve.upper[0]
    if low < outcomes.mean < high:
        middle = 2.0 * (outcomes.mean - low) / (high - low) - 1.0
        places = np.sort(np.append(places, middle))
    heights = height(places)
    k = int(np.argmin(heights))
    around = (places[max(k - 1, 0)], places[min(k + 1, len(places) - 1)])
    finest = minimize_scalar(
        lambda x: float(height(np.array([x]))[0]),
        bounds=around,
        method="bounded",
        options={"xatol": 1e-9},
    )
    least = float(heights[k])
    centre = float(places[k])
    if finest.fun < least:
        least = float(finest.fun)
        centre = float(finest.x)
    ends = []
    for outward in (-1, 1):
        ends.append(_find_end(height, places, heights, centre, least + limit, outward))
    z, j = curve.at(np.array([*ends, centre]))
    return Cut(float(j[0]), float(j[1]), least, tuple(z.tolist()))


def _find_end(
    height: Callable[[Array], Array],
    places: Array,
    heights: Array,
    centre: float,
    bar: float,
    outward: int,
) -> float:
    """Return the farthest place on a side at which l is at most the bar."""
    is_in = np.flatnonzero(heights <= bar)
    last = centre
    if is_in.size:
        last = float(places[is_in[0 if outward < 0 else -1]])
        last = min(last, centre) if outward < 0 else max(last, centre)
    beyond = places[places < last] if outward < 0 else places[places > last]
    if not beyond.size:
        return last
    following = float(beyond[-1] if outward < 0 else beyond[0])

    def above(x: float) -> float:
        """Return l less the bar, finite where l is not."""
        return min(float(height(np.array([x]))[0]) - bar, 1e6)

    if not above(last) < 0.0 < above(following):
        return last
    return float(brentq(above, last, following, xtol=1e-12, rtol=1e-12))


def find_trials(problem: Problem, policy: Array, name: str | None) -> Trials | None:
    """Return the trials of a policy; None where there are those of others only.

    Trials without a policy are of the one policy that is asked for.
    """
    trials = problem.trials
    if trials is None:
        return None
    if isinstance(trials.policy, np.ndarray):
        tried = check_policy(trials.policy, problem.simulator, name="trials.policy")
        is_same = tried.shape == policy.shape and bool(
            (np.abs(tried - policy) <= SAME_POLICY).all()
        )
        if name is None and not is_same:
            raise ArgumentError(
                "trials.policy",
                "must be the policy that is evaluated; it is another one (evaluate the"
                " policy that was tried)",
            )
        return trials if is_same else None
    if not trials.names:
        return trials
    if name is not None:
        return trials.of(name) if name in trials.names else None
    if len(trials.names) > 1:
        raise ArgumentError(
            "trials.policy",
            f"must be one policy here; the trials name {_names(trials)}"
            " (trials.of(name) are those of one)",
        )
    return trials.of(trials.names[0])


def trials_by_policy(
    problem: Problem, policies: Mapping[str, Array]
) -> dict[str, Trials]:
    """Return the trials of each policy that was tried, by the policy's name."""
    found = {name: find_trials(problem, pi, name) for name, pi in policies.items()}
    return {name: trials for name, trials in found.items() if trials is not None}


def require_tried(problem: Problem, policies: Mapping[str, Array]) -> None:
    """Refuse trials of a policy that is not among those that are evaluated."""
    trials = problem.trials
    if trials is None:
        return
    known = ", ".join(map(repr, policies))
    missing = [name for name in trials.names if name not in policies]
    if missing:
        raise ArgumentError(
            "trials.policy",
            f"must be a policy that is evaluated ({known}); it is {missing[0]!r}"
            " (evaluate it as well, or leave out its trials: trials.of(name))",
        )
    if trials.policy is None and len(policies) > 1:
        raise ArgumentError(
            "trials.policy",
            f"must name the policy that was tried, one of {known}; it is None",
        )
    is_array = isinstance(trials.policy, np.ndarray)
    if is_array and all(
        find_trials(problem, pi, name) is None for name, pi in policies.items()
    ):
        raise ArgumentError(
            "trials.policy",
            f"must be a policy that is evaluated ({known}); it is another one",
        )


def _names(trials: Trials) -> str:
    """Return the names of the policies that were tried, in words."""
    return _checks.show(", ".join(map(repr, trials.names)))


def is_success(problem: Problem, trials: Trials) -> bool:
    """Return whether the outcomes of trials are successes and failures.

    Returns of 0 and 1 are, where the problem's value is a probability of success.
    """
    if trials.is_success:
        return True
    is_binary = bool(np.isin(trials.returns, (0.0, 1.0)).all())
    has_success = problem.simulator.discount == 1.0 and is_binary
    return has_success and success_states(problem.model) is not None


def read_outcomes(problem: Problem, policy: Array, trials: Trials) -> Outcomes:
    """Return the outcomes of trials, with a variance where they do not vary.

    Returns of 0 and 1 are successes where the problem's value is a probability.
    """
    if is_success(problem, trials):
        p = trials.mean
        return Outcomes(trials.number, p, p * (1.0 - p), np.inf, True)
    m = trials.number
    variance = trials.variance
    # nan for a single trial
    if variance > VARIANCE_TOLERANCE * max(trials.mean**2, 1e-300):
        return Outcomes(m, trials.mean, variance, m - 1.0, False)
    _, rows = estimate_with_rows(problem.without_trials, policy)
    model = gather(problem, policy).with_rows(rows)
    moments = return_moments(
        problem.model.with_transitions(model.transitions),
        policy,
        horizon=problem.horizon,
    )
    least = VARIANCE_TOLERANCE * max(trials.mean**2, 1e-300)
    return Outcomes(m, trials.mean, max(moments.variance, least), np.inf, False)


def _describe(
    problem: Problem,
    policy: Array,
    outcomes: Outcomes,
    joined: Interval,
    own: Interval,
    by_trials: tuple[float, float],
    p_value: float,
    level: float,
) -> JoinedTrials:
    """Put value, standard error, and what halves it beside the intervals."""
    estimate, _ = estimate_with_rows(problem.without_trials, policy)
    error = estimate.standard_error
    has_error = error is not None and math.isfinite(error) and error > 0.0
    value = estimate.value
    is_contradicted = p_value < CONTRADICTION_LEVEL
    if is_contradicted:
        value = outcomes.mean
    elif has_error and math.isfinite(value):
        value = _weigh(estimate.value, float(error or 0.0), outcomes)
    if joined.status == "ok":
        value = min(max(value, joined.lower), joined.upper)
    variance = outcomes.variance
    if outcomes.is_success:
        variance = max(value * (1.0 - value), 0.0)
    both = None
    more_trials = None
    more_transitions = None
    if has_error and variance > 0.0 and not is_contradicted:
        of_log = float(error or 0.0) ** 2
        least = 1.0 / (1.0 / of_log + outcomes.number / variance)
        both = math.sqrt(least)
        as_precise = variance / least
    worth = math.nan
    if joined.status == "ok":
        worth = _count_as_narrow(outcomes, value, joined.width, level)
    if both is not None:
        more_trials = 3.0 * (worth if math.isfinite(worth) else as_precise)
        per_trial = float(problem.counts.sum()) * of_log / variance
        more_transitions = more_trials * per_trial
    return JoinedTrials(
        value,
        both,
        joined,
        own,
        by_trials,
        outcomes.mean,
        outcomes.number,
        variance,
        p_value,
        is_contradicted,
        worth,
        more_trials,
        more_transitions,
    )


def _count_as_narrow(
    outcomes: Outcomes, value: float, width: float, level: float
) -> float:
    """Return the number of trials alone whose interval around a value has a width.

    The interval is that of ``Outcomes.ends``, so that the number fits the row of the
    trials. It is inf for a width of 0.
    """
    if not width > 0.0:
        return math.inf
    mean = min(max(value, 0.0), 1.0) if outcomes.is_success else value
    least = 1.0 if math.isfinite(outcomes.freedom) else 0.0

    def excess(log_number: float) -> float:
        """Return how much wider the interval is, from the logarithm of the number."""
        further = math.exp(log_number)
        freedom = further if least else outcomes.freedom
        found = outcomes._replace(number=least + further, mean=mean, freedom=freedom)
        lower, upper = found.ends(level)
        # two ends that rounding makes one are narrower than any width
        return math.log(max(upper - lower, SMALLEST_WIDTH)) - math.log(width)

    # so many trials that the interval is wider, or as many as there is a number for
    low, high = -20.0, 20.0
    if excess(low) <= 0.0:
        return least
    while excess(high) > 0.0:
        high += 20.0
        if high > MAX_LOG_TRIALS:
            return math.inf
    return least + math.exp(brentq(excess, low, high, xtol=1e-10))


def _weigh(value: float, error: float, outcomes: Outcomes) -> float:
    """Return the j where (j - value)^2 / (2 error^2) + T(j) is least."""
    low, high = sorted((value, outcomes.mean))
    if outcomes.is_success:
        low = min(max(low, 0.0), 1.0)
        high = min(max(high, 0.0), 1.0)
    if not low < high:
        return low

    def height(j: float) -> float:
        """Return the sum of both half deviances."""
        of_trials = float(outcomes.half_deviance(np.array([j]))[0])
        return min(0.5 * ((j - value) / error) ** 2 + of_trials, 1e300)

    grid = np.linspace(low, high, 65)
    k = int(np.argmin([height(float(j)) for j in grid]))
    around = (float(grid[max(k - 1, 0)]), float(grid[min(k + 1, 64)]))
    found = minimize_scalar(height, bounds=around, method="bounded")
    return float(found.x if found.fun <= height(float(grid[k])) else grid[k])

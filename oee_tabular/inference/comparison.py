"""Comparisons of several policies on one log: differences, ranking, and P(best)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import TYPE_CHECKING, Literal

import numpy as np

from oee_tabular import _checks, _printing
from oee_tabular._keywords import suggest_keywords
from oee_tabular._parallel import one_thread
from oee_tabular._results import checked, conform
from oee_tabular.estimators import Estimate, Problem
from oee_tabular.estimators.off_environment import estimate_with_rows
from oee_tabular.exact import policy_value, time_in_pairs
from oee_tabular.exceptions import ArgumentError
from oee_tabular.inference.asymptotic import (
    bootstrap_values,
    outside_margin,
    value_covariances,
)
from oee_tabular.inference.evidence import (
    Evidence,
    check_ratios,
    gather,
    require_squares,
)
from oee_tabular.inference.intervals import Interval
from oee_tabular.mdp import FiniteMDP, check_policies
from oee_tabular.typing import Array, PoliciesLike, RealArrayLike, Seed

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# the share of a policy's discounted time in recorded pairs from which on an interval or
# P(best) that counts sampling noise alone is trusted
MIN_RECORDED_SHARE = 0.9
# of the largest value: smaller differences are rounding
EQUALITY_TOLERANCE = 1e-12
# the least factor of maximum likelihood's standard errors that those of the default's
# differences have
MIN_ERROR_FACTOR = 0.8


@checked()
@dataclass(frozen=True)
class Decision:
    """The policy with the largest value, if the log can decide.

    Attributes
    ----------
    candidates : tuple of str
        The policies that are not significantly worse than another, largest value first.
    are_equal : bool
        Whether several candidates agree in all that affects J.
    probability_best : dict of str to float or None
        P(best) of each policy, in [0, 1]; None if the log cannot say.
    margin : (float, float, float) or None
        By how much the best exceeds the next, in the unit of J: (difference, lower,
        upper). None without a best.

    See Also
    --------
    Comparison.decide : Make the decision.

    Examples
    --------
    >>> from oee_tabular.testing import case
    >>> pair = case("ragged")  # a known target
    >>> comparison = compare_policies(
    ...     pair.problem(1000, seed=0), {"new": pair.policy, "recorded": pair.behavior}
    ... )
    >>> decision = comparison.decide()
    >>> decision.best, [round(x, 2) for x in decision.margin]
    ('new', [3.26, 3.13, 3.38])
    """

    candidates: tuple[str, ...]
    are_equal: bool
    probability_best: Mapping[str, float | None]
    margin: tuple[float, float, float] | None

    @property
    def best(self) -> str | None:
        """Return the name of the policy that is worth most.

        None where the log cannot say, or where several are worth the same.
        """
        return self.candidates[0] if len(self.candidates) == 1 else None


@checked(
    shapes={
        "names": "k",
        "values": "k",
        "standard_errors": "k",
        "differences": "k k",
        "lower": "k k",
        "upper": "k k",
        "probability_best": "k",
        "covariance": "k k",
        "unrecorded_share": "k",
    },
    levels=("confidence",),
)
@dataclass(frozen=True, eq=False)
class Comparison:
    """The values of several policies on one log, and their differences.

    Attributes
    ----------
    names : tuple of str
        The policies, best estimated value first.
    values : ndarray of shape (k,)
        Their values by ``OffEnvironment()``, discounted sums.
    standard_errors : ndarray of shape (k,)
        The standard errors of the values: those of maximum likelihood times
        ``error_factor``.
    differences : ndarray of shape (k, k)
        The value of the row's policy minus that of the column's.
    lower : ndarray of shape (k, k)
        Lower ends of the intervals for the differences.
    upper : ndarray of shape (k, k)
        Upper ends of the intervals for the differences.
    probability_best : ndarray of shape (k,)
        P(best): the probability that the policy has the largest value, under the
        values' joint normal distribution (or the bootstrap's). ``decide`` gives it only
        where the log covers the policies.
    covariance : ndarray of shape (k, k)
        The covariance of the values.
    unrecorded_share : ndarray of shape (k,)
        The share in [0, 1] of each policy's discounted time, in states that can be
        left, that is in unrecorded stochastic pairs, in the model whose value is
        compared. Where transitions were dropped they count as well, in the
        maximum-likelihood model.
    confidence : float
        The level of each interval by itself, in (0, 1).
    error_factor : float
        The factor of maximum likelihood's standard errors, in [0.8, 1].

    See Also
    --------
    compare_policies : Compute the comparison.

    Examples
    --------
    >>> from oee_tabular.testing import case
    >>> pair = case("ragged")  # a known target
    >>> comparison = compare_policies(
    ...     pair.problem(1000, seed=0), {"new": pair.policy, "recorded": pair.behavior}
    ... )
    >>> (
    ...     comparison.names,
    ...     comparison.differences[0].round(2).tolist(),
    ...     comparison.upper[1].round(2).tolist(),
    ... )
    (('new', 'recorded'), [0.0, 3.26], [-3.13, 0.0])
    """

    names: tuple[str, ...]
    values: Array
    standard_errors: Array
    differences: Array
    lower: Array
    upper: Array
    probability_best: Array
    covariance: Array
    unrecorded_share: Array
    confidence: float
    error_factor: float = 1.0

    def __post_init__(self) -> None:
        if not self.names:
            raise ArgumentError("names", "must have a policy; it is empty")
        if len(set(self.names)) < len(self.names):
            raise ArgumentError(
                "names", f"must differ; they are {_checks.show(self.names)}"
            )

    def decide(
        self,
        values: Mapping[str, float] | None = None,
        intervals: Mapping[str, Interval] | None = None,
    ) -> Decision:
        """Decide which policy is worth most: one rule for the ranking and P(best).

        Parameters
        ----------
        values : dict of str to float, optional
            The value of each policy that is shown. None takes the comparison's own.
        intervals : dict of str to Interval, optional
            The likelihood interval of each policy that has one.

        Returns
        -------
        Decision
            The candidates, P(best), and the margin of the best.

        Notes
        -----
        One policy is significantly better than another if the interval of their
        difference says so and at least ``MIN_RECORDED_SHARE`` (90%) of both policies'
        time is in recorded pairs, or where likelihood intervals say so.

        P(best) is given where at least 90% of every policy's time is in recorded pairs,
        unless it contradicts the ranking: no policy is best but P(best) exceeds the
        confidence of all differences, or one is best (by likelihood intervals) and its
        P(best) is below that confidence.
        """
        intervals = conform(intervals, "intervals", dict[str, Interval] | None)
        if values is not None:
            conform(values, "values", dict[str, float])
            for name in values:
                _checks.one_of(name, "a key of values", self.names)
            if not values:
                raise ArgumentError("values", "must have a policy; it is empty")
        if values is None:
            values = dict(zip(self.names, self.values.tolist(), strict=True))
        shown = values
        known = intervals or {}
        place = self.names.index

        def descending(name: str) -> float:
            """Return a key that sorts policies by value, largest first and nan last."""
            return -shown[name] if math.isfinite(shown[name]) else math.inf

        order = sorted(shown, key=descending)

        def is_better(one: str, other: str) -> bool:
            """Return whether one policy is significantly better than another."""
            return self.bounds(one, other, known)[0] > 0

        candidates = [
            a for a in order if a == order[0] or not any(is_better(b, a) for b in order)
        ]
        places = [place(name) for name in candidates]
        rows = np.ix_(places, places)
        scale = max((abs(x) for x in shown.values() if math.isfinite(x)), default=0.0)
        is_one = len(candidates) == 1
        largest_end = np.abs([self.lower[rows], self.upper[rows]]).max()
        are_equal = not is_one and bool(largest_end <= EQUALITY_TOLERANCE * scale)
        # the confidence of all differences from the best together
        level = 1.0 - (len(order) - 1) * (1.0 - self.confidence)
        largest_probability = self.probability_best.max()
        if is_one:
            largest_probability = self.probability_best[places[0]]
        is_recorded = self.unrecorded_share.max() <= 1.0 - MIN_RECORDED_SHARE
        agrees = are_equal or (largest_probability > level) == is_one
        best: dict[str, float | None] = dict.fromkeys(order)
        if is_recorded and agrees:
            best = {name: float(self.probability_best[place(name)]) for name in order}
        if not is_one:
            return Decision(tuple(candidates), are_equal, best, None)
        one, other = order[:2]
        difference = shown[one] - shown[other]
        lower, upper = self.bounds(one, other, known)
        return Decision(
            (one,),
            False,
            best,
            (difference, min(lower, difference), max(upper, difference)),
        )

    def bounds(
        self, one: str, other: str, intervals: Mapping[str, Interval] | None = None
    ) -> tuple[float, float]:
        """Return an interval for the value of one policy minus that of another.

        Parameters
        ----------
        one : str
            The name of the first policy.
        other : str
            The name of the policy whose value is subtracted.
        intervals : dict of str to Interval, optional
            The likelihood interval of each policy that has one.

        Returns
        -------
        tuple of (float, float)
            Lower and upper end, in the unit of J; nan where the log cannot say.

        Notes
        -----
        The interval includes unrecorded pairs. It is the paired one where at least
        ``MIN_RECORDED_SHARE`` (90%) of both policies' time is in recorded pairs,
        otherwise the difference of the likelihood intervals' ends. Of two that there
        are, it is the one that tells the policies apart, or the shorter.
        """
        _checks.one_of(one, "one", self.names)
        _checks.one_of(other, "other", self.names)
        conform(intervals, "intervals", dict[str, Interval] | None)
        i = self.names.index(one)
        j = self.names.index(other)
        known = intervals or {}
        ours = known.get(one)
        theirs = known.get(other)
        separate = (np.nan, np.nan)
        if ours is not None and theirs is not None:
            separate = (ours.lower - theirs.upper, ours.upper - theirs.lower)
        if max(self.unrecorded_share[[i, j]]) > 1.0 - MIN_RECORDED_SHARE:
            return separate
        paired = float(self.lower[i, j]), float(self.upper[i, j])

        def preference(ends: tuple[float, float]) -> tuple[bool, bool, float]:
            """Return a key: first what tells the policies apart, then the shorter."""
            width = ends[1] - ends[0]
            return not ends[0] > 0, not width < math.inf, width

        return min(paired, separate, key=preference)

    def __str__(self) -> str:
        width = max(len(name) for name in self.names)
        lines = []
        for name, value, error, best, difference in self._rows():
            line = f"{name:<{width}}  {value:>10}  {error:>10}  {best:>7}  {difference}"
            lines.append(line.rstrip())
        level = f"{100 * self.confidence:.4g}%"
        lines.append(f"values: {_printing.SUM}; intervals at {level}")
        return "\n".join(lines)

    def _rows(self) -> list[list[str]]:
        """Return the header, and a row for each policy.

        P(best) is left out where the log cannot say.
        """
        rows = [
            ["policy", "value", "std. error", "P(best)", "difference from the best"]
        ]
        best = self.decide().probability_best
        for i, name in enumerate(self.names):
            probability = best[name]
            ends = (self.lower[i, 0], self.upper[i, 0])
            around = self.values[i] + self.standard_errors[i] * np.array([-2.0, 2.0])
            difference = ""
            if i:
                shown = format(self.differences[i, 0], _printing.spec(*ends))
                difference = f"{shown} {_printing.interval(*ends)}"
            rows.append(
                [
                    name,
                    format(self.values[i], _printing.spec(*around)),
                    f"{self.standard_errors[i]:.2g}",
                    "-" if probability is None else _printing.probability(probability),
                    difference,
                ]
            )
        return rows

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw by how much each policy differs from the best, with its interval.

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

        ends = self.differences[1:, 0], self.lower[1:, 0], self.upper[1:, 0]
        names = [f"{name} less {self.names[0]}" for name in self.names[1:]]
        best = self.decide().best
        title = "The log cannot say which policy is worth most"
        if best is not None:
            title = f"“{best}” is worth most"
        return plot_intervals(
            names,
            *ends,
            ax,
            truth=0.0,
            truth_label="no difference:",
            xlabel="difference (discounted sum of rewards)",
            title=title,
        )

    def _repr_html_(self) -> str:
        header, *rows = self._rows()
        header[4] += f", {100 * self.confidence:.4g}% interval"
        return _printing.table(
            header, rows, caption=f"Policies on one log; values: {_printing.SUM}"
        )


@suggest_keywords
@one_thread
def compare_policies(
    problem: Problem,
    policies: PoliciesLike,
    *,
    method: Literal["delta", "bootstrap"] = "delta",
    confidence: float = 0.95,
    lower_ratio: float | None = None,
    upper_ratio: float | None = None,
    n_draws: int = 10_000,
    n_bootstrap: int = 400,
    seed: Seed = 0,
) -> Comparison:
    """Compare the values of policies on one log, with intervals and P(best).

    Differences are known much more precisely than values if the policies visit the same
    pairs.

    Parameters
    ----------
    problem : Problem
        The simulator, the log of the target, and the horizon.
    policies : PoliciesLike
        A list of two or more policies, or a mapping from names to policies.
    method : {'delta', 'bootstrap'}, default 'delta'
        How the covariance of the values is estimated: by the delta method, or over
        common resamples of the transitions.
    confidence : float, default 0.95
        The level of each interval by itself, in (0, 1).
    lower_ratio : float, optional
        Lower bound in [0, 1] of the box lower_ratio * P <= P_target <= upper_ratio * P.
        None sets no lower bound.
    upper_ratio : float, optional
        Upper bound of at least 1 of the box. None sets no upper bound.
    n_draws : int, default 10000
        The number of draws of the joint normal distribution behind
        ``probability_best``, for "delta".
    n_bootstrap : int, default 400
        The number of resamples, for "bootstrap".
    seed : Seed, default 0
        The seed of the draws and of the resamples. They depend on the seed and the
        policies' names, and not on their order.

    Returns
    -------
    Comparison
        Values, differences with intervals, and P(best), in the unit of J.

    Raises
    ------
    ValueError
        If there are fewer than two policies, or if an argument is out of its range.

    See Also
    --------
    interval : Compute a confidence interval for one policy.
    oee_tabular.report.contest : Compare policies, with sentences and pictures.

    Notes
    -----
    Values are those of ``OffEnvironment()``, which vary less than those of the
    maximum-likelihood model. Their covariance is that of maximum likelihood,

        Cov(J_i, J_j) = sum_x Cov_x(G_i, G_j) / max(n_x, 1),

    times the square of ``error_factor``. G is the gradient of J at the
    maximum-likelihood model, and Cov_x is under the frequencies with one simulated
    transition added, (n_x phat + P) / (n_x + 1) ("delta"). So an unrecorded pair is as
    uncertain as one transition would leave it, and a pair recorded once is not certain.
    With "bootstrap" the covariance is over common resamples of the transitions, with
    unrecorded pairs as before. The factor is the largest ratio, over the policies, of
    the standard error that the default has if its prior fits to its own standard error;
    it is at least 0.8, and tends to 1 as the log grows. An interval also holds the
    difference by maximum likelihood where the two are further apart than the noise.

    In a box [nu, mu] sum (P' - P)^2 / P is at most (1 - nu) (mu - 1), so no pair
    changes the mean of G by more than the root of that times its standard deviation
    under P. That is the most that an unrecorded pair adds to a standard error.

    Dropped transitions, and a simulator that was sampled, widen each difference by the
    most that they can change either value; P(best) ignores them.

    Unrecorded pairs are as estimated in the values. If a policy spends much of its time
    there (``unrecorded_share``), a target that differs there in one direction can
    change its value by more than the variance shows.

    Examples
    --------
    >>> from oee_tabular.testing import case
    >>> pair = case("ragged")  # a known target
    >>> comparison = compare_policies(
    ...     pair.problem(1000, seed=0), {"new": pair.policy, "recorded": pair.behavior}
    ... )
    >>> print(comparison)
    policy         value  std. error  P(best)  difference from the best
    new            10.18        0.16  > 99.9%
    recorded        6.92        0.12   < 0.1%  -3.26 [-3.38, -3.13]
    values: discounted sum of rewards, not normalised; intervals at 95%
    """
    return compare_estimates(
        problem,
        policies,
        None,
        method=method,
        confidence=confidence,
        lower_ratio=lower_ratio,
        upper_ratio=upper_ratio,
        n_draws=n_draws,
        n_bootstrap=n_bootstrap,
        seed=seed,
    )


def compare_estimates(
    problem: Problem,
    policies: PoliciesLike,
    estimates: Mapping[str, Estimate] | None,
    *,
    method: Literal["delta", "bootstrap"] = "delta",
    confidence: float = 0.95,
    lower_ratio: float | None = None,
    upper_ratio: float | None = None,
    n_draws: int = 10_000,
    n_bootstrap: int = 400,
    seed: Seed = 0,
) -> Comparison:
    """Compare policies whose estimates by the default are known, or None.

    The arguments are those of ``compare_policies``. A report gives the estimates that
    it shows, so that its differences are differences of these.
    """
    _checks.instance(problem, Problem, "problem")
    _checks.one_of(method, "method", ("delta", "bootstrap"))
    level = _checks.number_in(confidence, "confidence", 0.0, 1.0, open_ends=True)
    named = several_policies(policies, problem.simulator)
    require_squares(problem.model)
    number = _checks.positive_integer(n_draws, "n_draws")
    _checks.require_memory(4.0 * number * len(named), "n_draws", n_draws)
    # options of one method are checked with both
    n_resamples = _checks.positive_integer(n_bootstrap, "n_bootstrap")
    generator = _checks.generator(seed)
    # in the order of the names, so that the draws do not depend on the order given
    names = sorted(named)
    evidences = [
        gather(problem, named[name], lower_ratio, upper_ratio) for name in names
    ]
    likely = np.array(
        [policy_value(e.fitted, e.policy, horizon=e.horizon) for e in evidences]
    )
    if estimates is None:
        estimates = {
            name: estimate_with_rows(problem, e.policy)[0]
            for name, e in zip(names, evidences, strict=True)
        }
    values, factor = _center([estimates.get(name) for name in names], likely)
    recorded, never = value_covariances(evidences, prior=1.0)
    nu, mu = check_ratios(lower_ratio, upper_ratio)
    # the most that a box leaves of the variance in unrecorded pairs
    never = factor**2 * never * min(1.0, (1.0 - nu) * (mu - 1.0))
    recorded = factor**2 * recorded
    if method == "delta":
        covariance = recorded + never
        normal = generator.standard_normal((number, len(values)))
        draws = values + normal @ _root(covariance).T
    else:
        resampled = _resample(problem, evidences, n_resamples, generator)
        covariance = factor**2 * np.atleast_2d(np.cov(resampled.T)) + never
        draws = values + factor * (resampled - likely)
        draws = draws + generator.standard_normal(draws.shape) @ _root(never).T
    best = _probability_best(draws)
    if method == "delta" and len(values) == 2:
        best = _better_of_two(values, covariance)
    # of equals the one that was given first
    given = list(named)
    order = np.lexsort((np.array([given.index(name) for name in names]), -values))
    values = values[order]
    likely = likely[order]
    covariance = covariance[np.ix_(order, order)]
    variance = np.maximum(np.diag(covariance), 0.0)
    z = NormalDist().inv_cdf(0.5 + level / 2.0)
    variance_of_difference = variance[:, None] + variance[None, :] - 2.0 * covariance
    half = z * np.sqrt(np.maximum(variance_of_difference, 0.0))
    down, up = np.array([_outside_changes(problem, evidences[i], z) for i in order]).T
    outside = (down[:, None] + up[None, :]) * (1.0 - np.eye(len(values)))
    difference = values[:, None] - values[None, :]
    lower = difference - half
    upper = difference + half
    # what shrinkage alone tells apart is not known: policies that nearly do the same
    # have no standard error of a difference, but may have different priors
    plain = likely[:, None] - likely[None, :]
    is_apart = np.abs(plain - difference) > half / factor
    lower = np.where(is_apart, np.minimum(lower, plain), lower)
    upper = np.where(is_apart, np.maximum(upper, plain), upper)
    return Comparison(
        tuple(names[i] for i in order),
        values,
        np.sqrt(variance),
        difference,
        lower - outside,
        upper + outside.T,
        best[order],
        covariance,
        np.array(
            [
                _unrecorded_share(problem, evidences[i], estimates.get(names[i]))
                for i in order
            ]
        ),
        level,
        factor,
    )


def _center(estimates: Sequence[Estimate | None], likely: Array) -> tuple[Array, float]:
    """Return the values of policies, and the factor of their standard errors.

    ``likely`` are the values in the maximum-likelihood model, which stand in for an
    estimate without a value.

    The default varies less than maximum likelihood, since it borrows strength. Its
    standard deviation is between that of a fit whose centre is right and that of
    maximum likelihood; the factor is the largest ratio of these two errors, at least
    ``MIN_ERROR_FACTOR``. It tends to 1 as the log grows.
    """
    values = likely.copy()
    ratios = [MIN_ERROR_FACTOR]
    for k, estimate in enumerate(estimates):
        if estimate is None or not math.isfinite(estimate.value):
            ratios.append(1.0)
            continue
        values[k] = estimate.value
        narrow = estimate.diagnostics.get("standard_error_if_centre_fits")
        error = estimate.standard_error
        if narrow is None or error is None or not error > 0.0:
            ratios.append(1.0)
        else:
            ratios.append(float(narrow) / error)
    return values, min(max(ratios), 1.0)


def _resample(
    problem: Problem,
    evidences: list[Evidence],
    n_bootstrap: int,
    generator: np.random.Generator,
) -> Array:
    """Return the values (n_bootstrap, k) of the policies in common resamples."""
    # the same resamples for every policy keep the correlation of their values
    seed = int(generator.integers(1 << 62))
    values = [
        bootstrap_values(
            problem, e, by="transitions", n_bootstrap=n_bootstrap, seed=seed
        )
        for e in evidences
    ]
    return np.column_stack(values)


def _probability_best(draws: Array) -> Array:
    """Return the share of the draws (n, k) in which each of k policies is the best."""
    # policies that are equal but for rounding share a draw
    tolerance = EQUALITY_TOLERANCE * np.abs(draws).max()
    is_top = draws >= draws.max(axis=1, keepdims=True) - tolerance
    shares = is_top / is_top.sum(axis=1, keepdims=True)
    return np.asarray(np.sum(shares, axis=0) / len(draws))


def _better_of_two(values: Array, covariance: Array) -> Array:
    """Return the probability (2,) that each of two policies is the better one.

    It needs no draws; equal policies share it.
    """
    difference = float(values[0] - values[1])
    spread = covariance[0, 0] + covariance[1, 1] - 2.0 * covariance[0, 1]
    size = max(covariance[0, 0], covariance[1, 1])
    if abs(difference) <= EQUALITY_TOLERANCE * np.abs(values).max():
        return np.full(2, 0.5)
    if not spread > EQUALITY_TOLERANCE * size:  # rounding of equal variances
        return np.array([float(difference > 0.0), float(difference < 0.0)])
    first = NormalDist().cdf(difference / math.sqrt(spread))
    return np.array([first, 1.0 - first])


def several_policies(policies: object, mdp: FiniteMDP) -> dict[str, Array]:
    """Check that there are at least two policies, and return name -> (S, A)."""
    named = check_policies(policies, mdp)
    if len(named) < 2:
        raise ArgumentError(
            "policies",
            "must be at least two to compare; there is"
            f" {', '.join(map(repr, named)) or 'none'}",
        )
    return named


def _unrecorded_share(
    problem: Problem, evidence: Evidence, estimate: Estimate | None
) -> float:
    """Return the share of a policy's time in unrecorded or dropped transitions.

    It is that of the model whose value is compared, where nothing was dropped.
    """
    covered = None if estimate is None else estimate.diagnostics.get("coverage")
    if covered is not None and not problem.dropped.any():
        return 1.0 - float(covered)
    time = time_in_pairs(evidence.fitted, evidence.policy, evidence.horizon)
    dropped = problem.dropped
    never = (evidence.n == 0) & evidence.is_stochastic
    unknown = np.where(never, 1.0, dropped / np.maximum(dropped + evidence.n, 1.0))
    left = ~evidence.model.closed() | dropped.reshape(time.shape).any(axis=1)
    return float(time.reshape(-1) @ unknown) / max(float(time[left].sum()), 1e-300)


def _outside_changes(
    problem: Problem, evidence: Evidence, z: float
) -> tuple[float, float]:
    """Return by how much, down and up, what the simulator lacks may change a value.

    That are dropped transitions, and the simulator's own sampling.
    """
    margin = outside_margin(problem, evidence)
    if margin is None:
        return 0.0, 0.0
    half = z * float(np.sqrt(margin.variance))
    return margin.down + half, margin.up + half


def _root(covariance: Array) -> Array:
    """Return B with B B^T = covariance, without eigenvalues that are rounding.

    Their roots are no rounding: without them equal rows stay equal.
    """
    values, vectors = np.linalg.eigh(covariance)
    is_real = values > 4.0 * len(values) * np.finfo(float).eps * values.max(initial=0.0)
    return np.asarray(vectors * np.sqrt(np.where(is_real, values, 0.0)))


@checked()
@dataclass(frozen=True)
class Selection:
    """Measures of how well estimated values rank policies with known true values.

    Attributes
    ----------
    rank_correlation : float
        Spearman's rank correlation, in [-1, 1]; 1 for the same order, nan where all
        estimates or all true values are equal.
    regret : float
        The best true value minus the best true value among the k policies ranked first,
        divided by the range of true values if that is not 0; in [0, 1].
    absolute_error : float
        The mean absolute error of the estimates, in the unit of J.

    See Also
    --------
    selection_measures : Compute these measures.

    Examples
    --------
    >>> # 2 chosen, 3 is best, of 0 to 3
    >>> round(selection_measures([3.0, 2.0, 1.0], [2.0, 3.0, 0.0]).regret, 4)
    0.3333
    """

    rank_correlation: float
    regret: float
    absolute_error: float


@suggest_keywords
def selection_measures(
    estimates: RealArrayLike, truths: RealArrayLike, *, k: int = 1
) -> Selection:
    """Measure how well estimated values rank policies whose true values are known.

    Parameters
    ----------
    estimates : array of shape (n,)
        The estimated values of n >= 2 policies, finite.
    truths : array of shape (n,)
        Their true values, finite.
    k : int, default 1
        How many of the policies ranked first the best is taken of, at most n.

    Returns
    -------
    Selection
        Spearman's rank correlation, regret@k as a share of the range of true values,
        and the mean absolute error.

    Raises
    ------
    ValueError
        If the arrays differ in length, are shorter than 2 or not finite, or if k is out
        of its range.

    Examples
    --------
    >>> selection_measures([3.0, 2.0, 1.0], [2.0, 3.0, 0.0])
    Selection(rank_correlation=0.5, regret=0.3333333333333333, absolute_error=1.0)
    """
    guess = _checks.float_array(estimates, "estimates", ndim=1)
    truth = _checks.float_array(truths, "truths", ndim=1)
    if guess.shape != truth.shape or len(guess) < 2:
        raise ValueError(
            "estimates and truths must have one length of at least 2; they have"
            f" {len(guess)} and {len(truth)}"
        )
    for array, name in ((guess, "estimates"), (truth, "truths")):
        _checks.require_finite(array, name)
    number = _checks.positive_integer(k, "k")
    if number > len(guess):
        raise ArgumentError(
            "k", f"must be at most the number of policies, {len(guess)}; it is {number}"
        )
    from scipy import stats  # takes a quarter of a second to import

    # the correlation with a constant is not defined
    correlation = float("nan")
    if np.ptp(guess) != 0 and np.ptp(truth) != 0:
        correlation = float(stats.spearmanr(guess, truth).statistic)
    chosen = np.argsort(-guess, kind="stable")[:number]
    short = float(truth.max() - truth[chosen].max())
    width = float(np.ptp(truth))
    return Selection(
        correlation,
        short / width if width > 0 else 0.0,
        float(np.abs(guess - truth).mean()),
    )

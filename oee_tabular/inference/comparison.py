"""Several policies from one log: differences with their correlation kept, a ranking,
and how well estimates rank policies.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from statistics import NormalDist
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from oee_tabular import _checks, _printing
from oee_tabular._parallel import one_thread
from oee_tabular.estimators import Problem
from oee_tabular.exact import policy_value
from oee_tabular.exact.occupancy import time_in_pairs
from oee_tabular.exceptions import ArgumentError
from oee_tabular.inference.asymptotic import (
    bootstrap_values,
    outside_margin,
    value_covariances,
)
from oee_tabular.inference.evidence import Evidence, gather, require_squares
from oee_tabular.inference.intervals import Interval
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.policies import check_policies
from oee_tabular.plots import plot_intervals
from oee_tabular.typing import Array, Seed

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# of a policy's time in pairs that the log has: below it what counts the log's noise
# alone says nothing
ENOUGH = 0.9


@dataclass(frozen=True)
class Decision:
    """The policy with the largest value, if the log can decide.

    Attributes
    ----------
    candidates : the policies that are not significantly worse than another, largest
        value first
    are_equal : whether several candidates agree in all that affects J
    probability_best : policy -> P(best); None if the log cannot say
    margin : by how much the best exceeds the next, and an interval: (difference, lower,
        upper); None without a best

    Examples
    --------
    >>> from oee_tabular.testing import case
    >>> pair = case("ragged")  # a known target
    >>> comparison = compare_policies(pair.problem(1000, seed=0), {"new": pair.policy, "recorded": pair.behavior})
    >>> decision = comparison.decide()
    >>> decision.best, [round(x, 2) for x in decision.margin]
    ('new', [3.26, 3.13, 3.39])
    """

    candidates: tuple[str, ...]
    are_equal: bool
    probability_best: Mapping[str, float | None]
    margin: tuple[float, float, float] | None

    @property
    def best(self) -> str | None:
        """The policy that is worth most; None where the log cannot say, or several are
        worth the same.
        """
        return self.candidates[0] if len(self.candidates) == 1 else None


@dataclass(frozen=True, eq=False)
class Comparison:
    """Policies on one log.

    Attributes
    ----------
    names : the policies, best estimated value first
    values, standard_errors : (k,) of the maximum-likelihood model
    differences : (k, k) value of the row's policy minus that of the column's
    lower, upper : (k, k) intervals for the differences, at ``confidence``
    probability_best : (k,) P(best): the probability that the policy has the largest
        value, under the values' joint normal distribution (or the bootstrap's);
        ``decide`` gives it only where the log covers the policies
    covariance : (k, k) of the values
    unrecorded_share : (k,) in [0, 1], the share of each policy's discounted time in
        states that can be left that is in unrecorded stochastic pairs or in dropped
        transitions
    confidence : of ``lower`` and ``upper``, each by itself

    Examples
    --------
    >>> from oee_tabular.testing import case
    >>> pair = case("ragged")  # a known target
    >>> comparison = compare_policies(pair.problem(1000, seed=0), {"new": pair.policy, "recorded": pair.behavior})
    >>> comparison.names, comparison.differences[0].round(2).tolist(), comparison.upper[1].round(2).tolist()
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

    def decide(
        self,
        values: Mapping[str, float] | None = None,
        intervals: Mapping[str, Interval] | None = None,
    ) -> Decision:
        """Say which policy is worth most: one rule for the ranking, P(best) and every
        sentence.

        One policy is significantly better than another if the interval of their
        difference says so and the log has ``ENOUGH`` of both policies' time, or where
        likelihood intervals say so. P(best) is given where the log has ``ENOUGH`` of
        every policy's time, unless it contradicts the ranking: no policy is best but
        P(best) exceeds the confidence of all differences, or one is best (by likelihood
        intervals) and P(best) is below that confidence.

        Parameters
        ----------
        values : policy -> the value that is shown; None: the comparison's own
        intervals : policy -> likelihood interval, where there is one
        """
        shown = (
            dict(zip(self.names, self.values.tolist(), strict=True))
            if values is None
            else values
        )
        known = intervals or {}
        place = self.names.index
        order = sorted(
            shown,
            key=lambda name: -shown[name] if math.isfinite(shown[name]) else math.inf,
        )

        def is_better(one: str, other: str) -> bool:
            return self.bounds(one, other, known)[0] > 0

        candidates = [
            a for a in order if a == order[0] or not any(is_better(b, a) for b in order)
        ]
        rows = np.ix_(*[[place(name) for name in candidates]] * 2)
        scale = max((abs(x) for x in shown.values() if math.isfinite(x)), default=0.0)
        is_one = len(candidates) == 1
        are_equal = not is_one and bool(
            np.abs([self.lower[rows], self.upper[rows]]).max() <= 1e-12 * scale
        )
        level = 1.0 - (len(order) - 1) * (1.0 - self.confidence)
        is_sure = (
            self.probability_best.max() > level
            if not is_one
            else self.probability_best[place(candidates[0])] > level
        )
        says = self.unrecorded_share.max() <= 1.0 - ENOUGH and (
            are_equal or is_sure == is_one
        )
        best = {
            name: float(self.probability_best[place(name)]) if says else None
            for name in order
        }
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
        """An interval for the value of one policy minus that of another, which includes
        unrecorded pairs.

        The paired one where the log has ``ENOUGH`` of both policies' time, the
        difference of the likelihood intervals' ends else; of two that there are, one
        that tells the policies apart, or the shorter. nan without either.

        Parameters
        ----------
        one, other : names of two policies
        intervals : policy -> likelihood interval, where there is one
        """
        i = self.names.index(one)
        j = self.names.index(other)
        ours, theirs = ((intervals or {}).get(name) for name in (one, other))
        separate = (
            (np.nan, np.nan)
            if ours is None or theirs is None
            else (ours.lower - theirs.upper, ours.upper - theirs.lower)
        )
        if max(self.unrecorded_share[[i, j]]) > 1.0 - ENOUGH:
            return separate
        paired = float(self.lower[i, j]), float(self.upper[i, j])
        return min(
            paired,
            separate,
            key=lambda ends: (
                not ends[0] > 0,
                not ends[1] - ends[0] < math.inf,
                ends[1] - ends[0],
            ),
        )

    def __str__(self) -> str:
        width = max(len(name) for name in self.names)
        lines = [
            f"{row[0]:<{width}}  {row[1]:>10}  {row[2]:>10}  {row[3]:>7}  {row[4]}".rstrip()
            for row in self._rows()
        ]
        return "\n".join(
            [
                *lines,
                f"values: {_printing.SUM}; intervals at {100 * self.confidence:.4g}%",
            ]
        )

    def _rows(self) -> list[list[str]]:
        """The header, then a row each policy; P(best) is left out where the log cannot
        say.
        """
        rows = [
            ["policy", "value", "std. error", "P(best)", "difference from the best"]
        ]
        best = self.decide().probability_best
        for i, name in enumerate(self.names):
            difference = ""
            share = best[name]
            ends = (self.lower[i, 0], self.upper[i, 0])
            if i:
                difference = (
                    f"{self.differences[i, 0]:{_printing.spec(*ends)}}"
                    f" {_printing.interval(*ends)}"
                )
            numbers = f"{self.values[i]:.5g}", f"{self.standard_errors[i]:.2g}"
            rows.append(
                [name, *numbers, "-" if share is None else f"{share:.1%}", difference]
            )
        return rows

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw by how much each policy differs from the best, with its interval;
        without ``ax`` on new axes.
        """
        ends = self.differences[1:, 0], self.lower[1:, 0], self.upper[1:, 0]
        names = [f"{name} less {self.names[0]}" for name in self.names[1:]]
        best = self.decide().best
        return plot_intervals(
            names,
            *ends,
            ax,
            truth=0.0,
            truth_label="no difference:",
            xlabel="difference (discounted sum of rewards)",
            title=(
                "The log cannot say which policy is worth most"
                if best is None
                else f"“{best}” is worth most"
            ),
        )

    def _repr_html_(self) -> str:
        header, *rows = self._rows()
        header[4] += f", {100 * self.confidence:.4g}% interval"
        return _printing.table(
            header, rows, caption=f"Policies on one log; values: {_printing.SUM}"
        )


@one_thread
def compare_policies(
    problem: Problem,
    policies: object,
    *,
    method: Literal["delta", "bootstrap"] = "delta",
    confidence: float = 0.95,
    lower_ratio: float | None = None,
    upper_ratio: float | None = None,
    n_draws: int = 10_000,
    n_bootstrap: int = 400,
    seed: Seed = 0,
) -> Comparison:
    """Compare the values of policies on the same log: differences with intervals, and
    P(best).

    Cov(J_i, J_j) = sum_x Cov_x(G_i, G_j) / max(n_x, 1), G the gradient of J at the
    maximum-likelihood model, Cov_x under the frequencies with one simulated transition
    added, (n_x phat + P) / (n_x + 1) ("delta"): an unrecorded pair is as uncertain as
    one transition would leave it, and a pair recorded once is not certain. With
    "bootstrap" the covariance is over common resamples of the transitions, with
    unrecorded pairs as before. Differences are known much more precisely than values if
    the policies visit the same pairs.

    Parameters
    ----------
    problem : Problem
    policies : two or more, a mapping name -> policy or a list of them
    method, confidence, lower_ratio, upper_ratio : as in ``interval``
    n_draws : draws of the joint normal distribution behind ``probability_best``
        ("delta")
    n_bootstrap, seed : of the bootstrap, and of the draws

    Notes
    -----
    In a box [nu, mu] sum (P' - P)^2 / P is at most (1 - nu) (mu - 1), so no pair
    changes the mean of G by more than the root of that times its standard deviation
    under P: the most that an unrecorded pair adds to a standard error.

    Dropped transitions, and a simulator that was sampled, widen each difference by the
    most that they can change either value; P(best) ignores them.

    Unrecorded pairs are as simulated in the values. If a policy spends much of its time
    there (``unrecorded_share``), a target that differs there in one direction can
    change its value by more than the variance shows.

    Examples
    --------
    >>> from oee_tabular.testing import case
    >>> pair = case("ragged")  # a known target
    >>> comparison = compare_policies(pair.problem(1000, seed=0), {"new": pair.policy, "recorded": pair.behavior})
    >>> print(comparison)
    policy         value  std. error  P(best)  difference from the best
    new           10.203        0.17   100.0%
    recorded      6.9413        0.13     0.0%  -3.261 [-3.389, -3.134]
    values: discounted sum of rewards, not normalised; intervals at 95%
    """
    _checks.instance(problem, Problem, "problem")
    _checks.one_of(method, "method", ("delta", "bootstrap"))
    level = _checks.number_in(confidence, "confidence", 0.0, 1.0, open_ends=True)
    named = several_policies(policies, problem.simulator)
    require_squares(problem.model)
    number = _checks.positive_integer(n_draws, "n_draws")
    _checks.require_memory(4.0 * number * len(named), "n_draws", n_draws)
    evidences = [
        gather(problem, policy, lower_ratio, upper_ratio) for policy in named.values()
    ]
    values = np.array(
        [policy_value(e.fitted, e.policy, horizon=e.horizon) for e in evidences]
    )
    recorded, never = value_covariances(evidences, prior=1.0)
    room = (1.0 - (lower_ratio or 0.0)) * (
        (np.inf if upper_ratio is None else upper_ratio) - 1.0
    )
    never = never * min(1.0, room)
    generator = _checks.generator(seed)
    if method == "delta":
        covariance = recorded + never
        draws = (
            values
            + generator.standard_normal((number, len(values))) @ _root(covariance).T
        )
    else:
        number = _checks.positive_integer(n_bootstrap, "n_bootstrap")
        fixed = int(generator.integers(1 << 62))  # the same resamples for every policy
        draws = np.column_stack(
            [
                bootstrap_values(
                    problem, e, by="transitions", n_bootstrap=number, seed=fixed
                )
                for e in evidences
            ]
        )
        covariance = np.atleast_2d(np.cov(draws.T)) + never
        draws = draws + generator.standard_normal(draws.shape) @ _root(never).T
    is_top = (
        draws >= draws.max(axis=1, keepdims=True) - 1e-12 * np.abs(draws).max()
    )  # equals but for rounding share a draw
    best = np.sum(is_top / is_top.sum(axis=1, keepdims=True), axis=0) / len(draws)
    order = np.argsort(-values, kind="stable")
    values = values[order]
    covariance = covariance[np.ix_(order, order)]
    variance = np.maximum(np.diag(covariance), 0.0)
    z = NormalDist().inv_cdf(0.5 + level / 2.0)
    half = z * np.sqrt(
        np.maximum(variance[:, None] + variance[None, :] - 2.0 * covariance, 0.0)
    )
    down, up = np.array([_outside_changes(problem, evidences[i], z) for i in order]).T
    outside = (down[:, None] + up[None, :]) * (1.0 - np.eye(len(values)))
    difference = values[:, None] - values[None, :]
    return Comparison(
        tuple(list(named)[i] for i in order),
        values,
        np.sqrt(variance),
        difference,
        difference - half - outside,
        difference + half + outside.T,
        best[order],
        covariance,
        np.array([_unrecorded_share(problem, evidences[i]) for i in order]),
        level,
    )


def several_policies(policies: object, mdp: FiniteMDP) -> dict[str, Array]:
    """Name -> (S, A) of at least two; a ValueError where there are fewer."""
    named = check_policies(policies, mdp)
    if len(named) < 2:
        raise ArgumentError(
            "policies",
            "must be at least two to compare; there is"
            f" {', '.join(map(repr, named)) or 'none'}",
        )
    return named


def _unrecorded_share(problem: Problem, evidence: Evidence) -> float:
    time = time_in_pairs(evidence.fitted, evidence.policy, evidence.horizon)
    dropped = problem.dropped
    never = (evidence.n == 0) & evidence.open_rows
    unknown = np.where(never, 1.0, dropped / np.maximum(dropped + evidence.n, 1.0))
    left = ~evidence.model.closed() | dropped.reshape(time.shape).any(axis=1)
    return float(time.reshape(-1) @ unknown) / max(float(time[left].sum()), 1e-300)


def _outside_changes(
    problem: Problem, evidence: Evidence, z: float
) -> tuple[float, float]:
    """By how much dropped transitions, and the simulator's own sampling, may change a
    value: down, up.
    """
    margin = outside_margin(problem, evidence)
    if margin is None:
        return 0.0, 0.0
    half = z * float(np.sqrt(margin.variance))
    return margin.down + half, margin.up + half


def _root(covariance: Array) -> Array:
    """B with B B^T = covariance; what of it is rounding, whose root is not, is left
    out: equal rows stay equal.
    """
    values, vectors = np.linalg.eigh(covariance)
    is_real = values > 4.0 * len(values) * np.finfo(float).eps * values.max(initial=0.0)
    return np.asarray(vectors * np.sqrt(np.where(is_real, values, 0.0)))


@dataclass(frozen=True)
class Selection:
    """Measures of how well estimated values rank policies with known true values.

    Attributes
    ----------
    rank_correlation : Spearman's; 1: the same order
    regret : the best value of all minus the best of the k policies ranked first,
        divided by the range of true values if that is not 0
    absolute_error : the mean |estimate - true value|, units of J

    Examples
    --------
    >>> round(selection_measures([3.0, 2.0, 1.0], [2.0, 3.0, 0.0]).regret, 4)  # 2 chosen, 3 is best, of 0 to 3
    0.3333
    """

    rank_correlation: float
    regret: float
    absolute_error: float


def selection_measures(
    estimates: ArrayLike, truths: ArrayLike, *, k: int = 1
) -> Selection:
    """Compute Spearman's rank correlation, regret@k (a share of the range of true
    values) and mean absolute error.

    Parameters
    ----------
    estimates, truths : of one length, at least 2; finite
    k : positive int, at most their number: of how many ranked first the best is taken

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
    flat = np.ptp(guess) == 0 or np.ptp(truth) == 0
    from scipy import stats  # a quarter of a second

    correlation = (
        float("nan") if flat else float(stats.spearmanr(guess, truth).statistic)
    )
    chosen = np.argsort(-guess, kind="stable")[:number]
    short = float(truth.max() - truth[chosen].max())
    width = float(np.ptp(truth))
    return Selection(
        correlation,
        short / width if width > 0 else 0.0,
        float(np.abs(guess - truth).mean()),
    )

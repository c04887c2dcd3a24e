"""The likelihood interval of a model whose rows share parameters: transitions that are tied, or features.

Under a tie, or features phi, the target is assumed to be P_theta proportional to P exp(theta . phi) in each row, phi the
indicators of the keys under a tie. f(theta) is the negative log-likelihood of the counts with a unit Gaussian penalty on
standardised directions (``ratio.prior.ridge``), theta_hat its minimiser, and the interval holds J(P_theta) over

    {theta : f(theta) - f(theta_hat) <= q / 2},   q the quantile of chi-square with one degree of freedom.

An end is found by linearising J (Frank and Wolfe). With g the gradient of J at theta_k, theta_{k+1} lies between theta_k and
the maximiser of s g . theta over the set, s = 1 or -1, as far as J grows. The set is convex, so that the maximiser is
argmin f(theta) - c s g . theta for the one c > 0 that puts it on the boundary: a root in c, bracketed, each value by Newton's
method. At the fixed point g and f' are parallel, the first-order condition of an end.

Nothing else is free: pairs that were never recorded follow from theta. Where the tie or the features are wrong the interval
need not cover, however many transitions there are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq
from scipy.special import gammaincinv

from oee_tabular._checks import Array
from oee_tabular.estimators import Problem
from oee_tabular.exact import ReweightedModel, policy_value, transition_gradient
from oee_tabular.exact.reweighted import with_rows
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.rows import Rows
from oee_tabular.ratio.features import feature_array
from oee_tabular.ratio.prior._ridge import evaluate, minimise, sum_columns
from oee_tabular.ratio.prior.directions import Directions, own_directions
from oee_tabular.ratio.prior.ridge import Ridge, fit_ridge
from oee_tabular.ratio.support import aligned_counts
from oee_tabular.ratio.ties import tie_keys

N_LINEARISATIONS = 30
TOLERANCE = 1e-7  # of the width, by which the last linearisation may still have moved an end
LARGEST_LOG_FORCE = 60.0  # of c: beyond it rounding is all that the set has to give


def shared_directions(simulator: FiniteMDP, tie: object, features: object) -> Directions:
    """The directions of a tie or of features, checked; both as in ``transition_ratio``."""
    if tie is not None and features is not None:
        raise ValueError("tie and features must not be given together: they are two different models")
    rows = Rows.of(simulator)
    if tie is not None:
        return own_directions(simulator, keys=tie_keys(tie, rows, simulator))
    array = feature_array(features, simulator)
    spread = np.abs(rows.center(array)).max(axis=0)
    constant = np.flatnonzero(spread <= 1e-12 * np.maximum(np.abs(array).max(axis=0), 1e-300))
    if constant.size:
        raise ValueError(
            f"features must differ between the next states of some state-action pair; feature {constant[0]} is constant in "
            "every one"
        )
    return own_directions(simulator, array)


def shared_ends(problem: Problem, policy: Array, directions: Directions, level: float) -> tuple[float, float, float]:
    """Lower end, upper end, and J at theta_hat."""
    whole = Rows.of(problem.simulator)
    counts = aligned_counts(problem.counts, problem.simulator)
    visited = whole.select((whole.sums(counts) > 0) & (np.diff(whole.indptr) > 1))
    if not len(visited):
        raise ValueError("log must have a transition of a state-action pair with more than one next state; it has none")
    observed = counts[visited.entries]
    fit = fit_ridge(directions, visited, observed, None, by_evidence=False)
    risk = visited.sums(observed), sum_columns(directions.columns(visited), observed, visited.n_actions)
    model = _SharedModel(problem, policy, fit, whole, risk, visited)
    middle = model.value(fit.theta[0])
    rise = float(gammaincinv(0.5, level))  # half of chi-square's quantile
    lower, upper = (_end(model, rise, sign, middle) for sign in (-1.0, 1.0))
    return lower, upper, middle


@dataclass(frozen=True, eq=False)
class _SharedModel:
    """The directions' model on a problem's counts: f, J and its gradient in theta (d,)."""

    problem: Problem
    policy: Array
    fit: Ridge
    whole: Rows
    risk: tuple[Array, Array]
    visited: Rows

    def value(self, theta: Array) -> float:
        """J(P_theta)."""
        return policy_value(self._target(self._tilt(theta)), self.policy, horizon=self.problem.horizon)

    def gradient(self, theta: Array) -> Array:
        """dJ / dtheta."""
        tilt = self._tilt(theta)
        target = self._target(tilt)
        slope = transition_gradient(target, self.policy, horizon=self.problem.horizon)
        return np.asarray(tilt.pull(self.whole, slope * target.transitions.data).sum(axis=0))

    def rise(self, theta: Array) -> float:
        """f(theta) - f(theta_hat)."""
        columns = self.fit.directions.columns(self.visited)
        here, best = (self._tilt(theta).theta, self.fit.theta)
        return float(np.subtract(*(evaluate(columns, self.risk, x, self.fit.penalty)[0] for x in (here, best))))

    def minimise(self, force: Array) -> Array:
        """argmin f(theta) - force . theta."""
        mass, pulled = self.risk
        moved = pulled.copy()
        moved[0] += force
        columns = self.fit.directions.columns(self.visited)
        theta, _, _ = minimise(columns, (mass, moved), self.fit.theta, self.fit.penalty, 1e-22)
        return np.asarray(theta[0])

    def _tilt(self, theta: Array) -> Ridge:
        """With no parameters of an action alone."""
        full = np.zeros(self.fit.theta.shape)
        full[0] = theta
        return replace(self.fit, theta=full)

    def _target(self, tilt: Ridge) -> ReweightedModel:
        return with_rows(self.problem.model, tilt.at(self.whole))


def _end(model: _SharedModel, rise: float, sign: float, middle: float) -> float:
    """The farthest J in the direction ``sign``."""
    theta, end = model.fit.theta[0], middle
    for _ in range(N_LINEARISATIONS):
        force = sign * model.gradient(theta)
        if not np.abs(force).max() > 0:
            break
        step = _maximise_on_boundary(model, force, rise) - theta
        length, last = 1.0, end
        while length > 1e-3 and sign * (end := model.value(theta + length * step)) <= sign * last:
            length *= 0.5  # what lies between two members is one: the set is convex
        if sign * (end - last) <= TOLERANCE * abs(end - middle):
            return sign * max(sign * end, sign * last)
        theta = theta + length * step
    return end


def _maximise_on_boundary(model: _SharedModel, force: Array, rise: float) -> Array:
    """argmax force . theta where f is at most ``rise`` above its minimum."""

    def excess(log_c: float) -> float:
        return model.rise(model.minimise(np.exp(log_c) / np.abs(force).max() * force)) - rise

    low = high = 0.0
    while excess(high) < 0 and high < LARGEST_LOG_FORCE:
        low, high = high, high + 2.0
    while excess(low) > 0 and low > -LARGEST_LOG_FORCE:
        low, high = low - 2.0, low
    if excess(low) < 0.0 < excess(high):
        low = brentq(excess, low, high, xtol=1e-10)
    return model.minimise(np.exp(low) / np.abs(force).max() * force)

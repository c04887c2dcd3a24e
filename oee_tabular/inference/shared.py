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

from dataclasses import replace

import numpy as np
from scipy.optimize import brentq
from scipy.special import gammaincinv

from oee_tabular._checks import Array
from oee_tabular.estimators import Problem
from oee_tabular.exact import policy_value, transition_gradient
from oee_tabular.exact.reweighted import with_rows
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.rows import Rows
from oee_tabular.ratio.features import feature_array
from oee_tabular.ratio.prior._ridge import minimise, penalized_risk, sum_columns
from oee_tabular.ratio.prior.directions import Directions, own_directions
from oee_tabular.ratio.prior.ridge import fit_ridge
from oee_tabular.ratio.support import aligned_counts
from oee_tabular.ratio.ties import tie_keys

N_LINEARISATIONS = 200
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
    rows, horizon = Rows.of(problem.simulator), problem.horizon
    counts = aligned_counts(problem.counts, problem.simulator)
    visited = rows.select((rows.sums(counts) > 0) & (np.diff(rows.indptr) > 1))
    if not len(visited):
        raise ValueError("log must have a transition of a state-action pair with more than one next state; it has none")
    observed, columns = counts[visited.entries], directions.columns(visited)
    fit = fit_ridge(directions, visited, observed, None, by_evidence=False)
    mass, pulled = visited.sums(observed), sum_columns(columns, observed, visited.n_actions)
    action = np.zeros((len(fit.theta), 1))
    action[0] = 1.0  # no parameters of an action alone
    least = penalized_risk(columns, (mass, pulled), fit.theta, fit.penalty)[0]
    limit = least + float(gammaincinv(0.5, level))  # half of chi-square's quantile

    def value(theta: Array) -> float:
        return policy_value(with_rows(problem.model, replace(fit, theta=theta).at(rows)), policy, horizon=horizon)

    def gradient(theta: Array) -> Array:
        tilt = replace(fit, theta=theta)
        target = with_rows(problem.model, tilt.at(rows))
        slope = transition_gradient(target, policy, horizon=horizon)
        return np.asarray(action * tilt.pull(rows, slope * target.transitions.data).sum(axis=0))

    def minimise_against(force: Array) -> Array:
        """argmin f(theta) - force . theta."""
        return np.asarray(action * minimise(columns, (mass, pulled + force[:-1]), fit.theta, fit.penalty, 1e-22)[0])

    def maximise_on_boundary(force: Array) -> Array:
        """argmax force . theta where f is at most the limit."""
        force = force / np.abs(force).max()

        def excess(log_c: float) -> float:
            theta = minimise_against(np.exp(log_c) * force)
            rise: float = penalized_risk(columns, (mass, pulled), theta, fit.penalty)[0] - limit
            return rise

        low = high = 0.0
        while excess(high) < 0 and high < LARGEST_LOG_FORCE:
            low, high = high, high + 2.0
        while excess(low) > 0 and low > -LARGEST_LOG_FORCE:
            low, high = low - 2.0, low
        if excess(low) < 0.0 < excess(high):
            low = brentq(excess, low, high, xtol=1e-10)
        return minimise_against(np.exp(low) * force)

    middle = value(fit.theta)

    def find_end(sign: float) -> float:
        """The farthest J in the direction ``sign``."""
        theta, end = fit.theta, middle
        for _ in range(N_LINEARISATIONS):
            force = sign * gradient(theta)
            if not np.abs(force).max() > 0:
                break
            step = maximise_on_boundary(force) - theta
            length, last = 1.0, end
            while length > 1e-3 and sign * (end := value(theta + length * step)) <= sign * last:
                length *= 0.5  # what lies between two members is one: the set is convex
            if sign * (end - last) <= TOLERANCE * abs(end - middle):
                return sign * max(sign * end, sign * last)
            theta = theta + length * step
        return end

    return find_end(-1.0), find_end(1.0), middle

"""Intervals of J where rows share parameters, by a tie or by features.

The target is assumed to be P_theta proportional to P exp(theta . phi) in each row, phi
the features, or the indicators of the keys under a tie. f(theta) is the negative
log-likelihood of the counts with a unit Gaussian penalty on standardised directions
(``shrinkage.ridge``), theta_hat its minimiser, and the interval holds J(P_theta) over
{theta : f(theta) - f(theta_hat) <= c}, c half the chi-square quantile with one degree
of freedom. An end is found by linearising J (Frank and Wolfe). With g the gradient of J
at theta_k, theta_{k+1} lies between theta_k and the maximiser of s g . theta over the
set, s = 1 or -1, as far as J grows. The set is convex, so that the maximiser is argmin
f(theta) - c' s g . theta for the one c' > 0 that puts it on the boundary: a bracketed
root in c', each value by Newton's method. At the fixed point g and f' are parallel, the
first-order condition of an end. Pairs that were never recorded follow from theta; where
the tie or the features are wrong the interval need not cover, however many transitions
there are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

import numpy as np
from scipy.optimize import brentq
from scipy.special import gammaincinv

from oee_tabular.estimators import Problem
from oee_tabular.exact import policy_value, transition_gradient, with_rows
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import FiniteMDP, Rows
from oee_tabular.ratio.features import feature_array
from oee_tabular.ratio.support import aligned_counts
from oee_tabular.ratio.ties import tie_keys
from oee_tabular.shrinkage._ridge import sum_columns
from oee_tabular.shrinkage.directions import Directions, own_directions
from oee_tabular.shrinkage.newton import Risk, minimise, penalized_risk
from oee_tabular.shrinkage.ridge import fit_ridge
from oee_tabular.typing import Array, FrameLike, IntArrayLike, RealArrayLike

# a key for each transition of the simulator: an array, a data frame, or a function of
# (state, action, next_state) arrays
TieLike: TypeAlias = IntArrayLike | FrameLike | Callable[..., object]
# features of each transition, in the same forms
FeaturesLike: TypeAlias = RealArrayLike | FrameLike | Callable[..., object]

MAX_LINEARISATIONS = 200
# of the distance between end and estimate, by which the last linearisation may still
# have moved an end
LINEARISATION_TOLERANCE = 1e-7
# of log c': beyond it rounding is all that the set has to give
MAX_LOG_FORCE = 60.0
MIN_LENGTH = 1e-3  # of the way to the maximiser of the linearisation


def shared_directions(
    simulator: FiniteMDP, tie: TieLike | None, features: FeaturesLike | None
) -> Directions:
    """Check a tie or features, and return the directions that they allow.

    Both are as in ``transition_ratio``.
    """
    if tie is not None and features is not None:
        raise ValueError(
            "tie and features must not be given together: they are two different models"
        )
    rows = Rows.of(simulator)
    if tie is not None:
        return own_directions(simulator, keys=tie_keys(tie, rows, simulator))
    array = feature_array(features, simulator)
    spread = np.abs(rows.center(array)).max(axis=0)
    size = np.maximum(np.abs(array).max(axis=0), 1e-300)
    constant = np.flatnonzero(spread <= 1e-12 * size)
    if constant.size:
        raise ArgumentError(
            "features",
            "must differ between the next states of some state-action pair; feature"
            f" {constant[0]} is constant in every one",
        )
    return own_directions(simulator, array)


def shared_ends(
    problem: Problem, policy: Array, directions: Directions, level: float
) -> tuple[float, float, float]:
    """Find both ends, and J at theta_hat, where rows share parameters."""
    rows = Rows.of(problem.simulator)
    horizon = problem.horizon
    counts = aligned_counts(problem.counts, problem.simulator)
    visited = rows.select((rows.sums(counts) > 0) & (np.diff(rows.indptr) > 1))
    if not len(visited):
        raise ArgumentError(
            "log",
            "must have a transition of a state-action pair with more than one next"
            " state; it has none",
        )
    observed = counts[visited.entries]
    columns = directions.columns(visited)
    fit = fit_ridge(directions, visited, observed, None, by_evidence=False)
    mass = visited.sums(observed)
    pulled = sum_columns(columns, observed, visited.n_actions)
    action = np.zeros((len(fit.theta), 1))
    action[0] = 1.0  # no parameters of an action alone
    least = penalized_risk(columns, Risk(mass, pulled), fit.theta, fit.penalty)[0]
    limit = least + float(gammaincinv(0.5, level))  # half of chi-square's quantile

    def value(theta: Array) -> float:
        """Return J of the model with parameters theta."""
        target = with_rows(problem.model, replace(fit, theta=theta).at(rows))
        return policy_value(target, policy, horizon=horizon)

    def gradient(theta: Array) -> Array:
        """Return the gradient of J in theta."""
        tilt = replace(fit, theta=theta)
        target = with_rows(problem.model, tilt.at(rows))
        slope = transition_gradient(target, policy, horizon=horizon)
        pull = tilt.pull(rows, slope * target.transitions.data)
        return np.asarray(action * pull.sum(axis=0))

    def minimise_against(force: Array) -> Array:
        """Return argmin f(theta) - force . theta."""
        statistics = Risk(mass, pulled + force[:-1])
        theta, *_ = minimise(columns, statistics, fit.theta, fit.penalty, 1e-22)
        return np.asarray(action * theta)

    def maximise_on_boundary(force: Array) -> Array:
        """Return argmax force . theta where f is at most the limit."""
        force = force / np.abs(force).max()

        def excess(log_c: float) -> float:
            """Return by how much f exceeds the limit at the minimiser for c'."""
            theta = minimise_against(np.exp(log_c) * force)
            risk = penalized_risk(columns, Risk(mass, pulled), theta, fit.penalty)[0]
            return float(risk - limit)

        low = high = 0.0
        while excess(high) < 0 and high < MAX_LOG_FORCE:
            low = high
            high = high + 2.0
        while excess(low) > 0 and low > -MAX_LOG_FORCE:
            high = low
            low = low - 2.0
        if excess(low) < 0.0 < excess(high):
            low = brentq(excess, low, high, xtol=1e-10)
        return minimise_against(np.exp(low) * force)

    middle = value(fit.theta)

    def find_end(sign: float) -> float:
        """Return the farthest J in the direction ``sign``."""
        theta = fit.theta
        end = middle
        for _ in range(MAX_LINEARISATIONS):
            force = sign * gradient(theta)
            if not np.abs(force).max() > 0:
                break
            step = maximise_on_boundary(force) - theta
            length = 1.0
            last = end
            # the set is convex: what lies between two members is one
            while length > MIN_LENGTH:
                end = value(theta + length * step)
                if not sign * end <= sign * last:
                    break
                length *= 0.5
            tolerance = LINEARISATION_TOLERANCE * abs(end - middle)
            if sign * (end - last) <= tolerance:
                return sign * max(sign * end, sign * last)
            theta = theta + length * step
        return end

    return find_end(-1.0), find_end(1.0), middle

"""MAGIC: a blend of importance sampling and the model, by the number of steps that the log is used for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array, PolicyLike, Seed
from oee_tabular._threads import one_thread
from oee_tabular.estimators.base import ROUNDING, Estimate, ExactLimit, catch_divergence
from oee_tabular.estimators.doubly_robust import DoublyRobust
from oee_tabular.estimators.episodes import EpisodeTerms
from oee_tabular.estimators.off_environment import OffEnvironment, RatioOption, ratio_claims
from oee_tabular.estimators.problem import Problem, require_policy
from oee_tabular.estimators.rollouts import weight_status
from oee_tabular.exact import reweight
from oee_tabular.ratio.method import Population


@dataclass(frozen=True)
class Magic(ExactLimit):
    """Model and guided importance sampling combining [1], on the log's episodes.

    g_j uses weighted doubly robust for the first j steps and the model zeta * P after them (j = 0: the model alone, j = T:
    the whole of it). The weights x on the simplex minimise x^T (Omega + b b^T) x, Omega the covariance of the g_j over
    episodes and b_j how far g_j is from the central half of the bootstrap distribution of g_T, the weights normalised again on
    each resample (one without any weight at some step is left out).

    Parameters
    ----------
    ratio : as in ``OffEnvironment``: the model
    n_lengths : how many j are blended (spread evenly from 0 to T)
    n_bootstrap : resamples of the episodes

    Notes
    -----
    Limit: that of weighted doubly robust. The standard error takes the model for known: where most of the weight is on it, that
    is too small. Source: [1] P. Thomas and E. Brunskill, Data-efficient off-policy policy evaluation
    for reinforcement learning, ICML 2016.

    Examples
    --------
    >>> from oee_tabular.testing import case
    >>> pair = case("ragged")  # a target that is known: the truth is 10.07
    >>> estimate = Magic()(pair.problem(1000, seed=0), pair.policy, seed=0)
    >>> round(estimate.value, 1), round(estimate.diagnostics["share_of_model"], 1)
    (10.1, 1.0)
    """

    ratio: RatioOption = "conditional"
    n_lengths: int = 25
    n_bootstrap: int = 200

    def __post_init__(self) -> None:
        OffEnvironment(ratio=self.ratio)  # or an error
        _checks.positive_integer(self.n_lengths, "n_lengths")
        _checks.positive_integer(self.n_bootstrap, "n_bootstrap")

    @one_thread
    @catch_divergence
    def __call__(self, problem: Problem, policy: PolicyLike, *, seed: Seed = None) -> Estimate:
        """``seed`` is for the bootstrap and for ratios that sample the simulator."""
        pi = require_policy(problem, policy)
        generator = _checks.generator(seed)
        zeta = OffEnvironment(ratio=self.ratio).fit(problem, pi, generator)
        terms = EpisodeTerms.from_problem(problem, pi, reweight(problem.model, zeta), self_normalized=True)
        n, columns = terms.partial.shape
        if n < 2:
            return Estimate(float("nan"), status="the blend needs at least 2 episodes")
        if np.isnan(terms.total):
            return Estimate(terms.total, status=weight_status(terms.total))
        lengths = np.unique(np.round(np.linspace(0, columns - 1, min(self.n_lengths, columns))).astype(int))
        parts = terms.partial[:, lengths]
        totals = parts.sum(axis=0)
        covariance = n / (n - 1.0) * (parts - totals / n).T @ (parts - totals / n)
        draws = generator.integers(0, n, size=(self.n_bootstrap, n))
        low, high = np.nanquantile(terms.resample(draws), [0.25, 0.75])
        bias = np.maximum(np.maximum(totals - high, low - totals), 0.0)
        weights = simplex_minimum(covariance + np.outer(bias, bias))
        error = float(np.sqrt(max(weights @ covariance @ weights, 0.0)))
        return terms.estimate(
            zeta,
            float(weights @ totals),
            error if error > ROUNDING * float(np.abs(n * parts).max()) else None,
            share_of_model=float(weights[0]),
            share_of_log=float(weights[-1]),
        )

    @property
    def claims(self) -> frozenset[str]:
        """Words of ``testing.CLAIMS``."""
        return ratio_claims(self.ratio) - {"after_end"} | {"consistent", "random"}

    def limit_of(self, population: Population) -> float:
        """J_target, that of weighted doubly robust; refused where the behaviour policy lacks support."""
        return DoublyRobust(data="episodes", ratio=self.ratio, self_normalized=True).limit_of(population)


def simplex_minimum(matrix: Array) -> Array:
    """argmin x^T A x over the simplex, A positive semidefinite.

    Nonnegative least squares: the minimiser of y^T A y + (sum y - 1)^2 over y >= 0 is a multiple of it.
    """
    values, vectors = np.linalg.eigh(matrix)
    scale = max(float(values.max()), 1e-300)
    root = (np.sqrt(np.maximum(values, 0.0) / scale) * vectors).T
    stacked = np.vstack([root, np.ones(len(matrix))])
    from scipy.optimize import nnls  # a tenth of a second

    y, _ = nnls(stacked, np.append(np.zeros(len(root)), 1.0), maxiter=100 * len(matrix))
    return np.asarray(y / y.sum())

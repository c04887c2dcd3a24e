"""The base class of the package's estimators: it checks arguments, adds findings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._parallel import one_thread
from oee_tabular.estimators.estimate import Estimate
from oee_tabular.estimators.findings import WEIGHTLESS, from_diagnostics
from oee_tabular.estimators.problem import Problem, require_policy
from oee_tabular.exact import largest_reward
from oee_tabular.exceptions import DivergentKernelError
from oee_tabular.mdp import (
    FiniteMDP,
    check_policy,
    optional_horizon_length,
    require_available,
)
from oee_tabular.ratio.method import Population
from oee_tabular.ratio.support import refuse_unsupported, require_pair
from oee_tabular.typing import Array, PolicyLike, RealArrayLike, Seed

# the claims (testing.CLAIMS) of an estimator that reads the log's counts alone
OF_COUNTS = frozenset({"relabelling", "scale", "padding", "after_end"})


class TabularEstimator:
    """The base of the package's estimators, which checks arguments and adds findings.

    A subclass defines ``estimate``, ``limit_of`` and ``claims``.
    """

    @one_thread
    def __call__(
        self, problem: Problem, policy: PolicyLike, *, seed: Seed = None
    ) -> Estimate:
        """Estimate the policy's value in the target.

        Parameters
        ----------
        problem : Problem
            The simulator and the log.
        policy : PolicyLike
            The policy to evaluate.
        seed : int, Generator or None, optional
            The seed of rollouts, resamples and the simulator's data.

        Returns
        -------
        Estimate
            The value with its findings. It is nan if its sum diverges; the status says
            why.
        """
        pi = require_policy(problem, policy)
        try:
            estimate = self.estimate(problem, pi, _checks.generator(seed))
        except DivergentKernelError as divergence:
            return Estimate(float("nan"), status=str(divergence))
        if WEIGHTLESS in estimate.findings:
            return estimate
        warnings = from_diagnostics(
            estimate.diagnostics,
            estimate.value,
            estimate.standard_error,
            largest_reward(problem.model),
        )
        return replace(estimate, findings=(*warnings, *estimate.findings))

    def estimate(
        self, problem: Problem, policy: Array, generator: np.random.Generator
    ) -> Estimate:
        """Estimate the value of a checked policy, without the findings it leads to.

        Parameters
        ----------
        problem : Problem
            The simulator and the log.
        policy : ndarray of shape (S, A)
            The policy's probabilities.
        generator : numpy.random.Generator
            The source of whatever is drawn.

        Returns
        -------
        Estimate
            The value, without the findings that follow from its diagnostics.
        """
        raise NotImplementedError

    def limit(
        self,
        simulator: FiniteMDP,
        target: FiniteMDP,
        policy: PolicyLike,
        *,
        data_distribution: RealArrayLike | None = None,
        behavior_policy: PolicyLike | None = None,
        horizon: int | None = None,
    ) -> float:
        """Compute the exact limit of the estimated value as the log grows.

        Parameters
        ----------
        simulator : FiniteMDP
            The simulator.
        target : FiniteMDP
            The target, inside the simulator's support where there are data.
        policy : PolicyLike
            The policy to evaluate.
        data_distribution : array_like of shape (S, A), optional
            The share of the log's transitions in each state-action pair; None means
            evenly. Only its support matters, except for the quotient of two ratios and
            with features.
        behavior_policy : PolicyLike, optional
            The policy of the log's episodes; None means one that takes every action of
            ``policy``.
        horizon : int, optional
            The number of rewards; None means the infinite discounted sum.

        Returns
        -------
        float
            The limit, bias included; not normalised.

        Raises
        ------
        ValueError
            If target and simulator do not match, or if the target has transitions
            outside the simulator's support where there are data.
        """
        require_pair(target, simulator)
        share = simulator.available / np.count_nonzero(simulator.available)
        if data_distribution is not None:
            share = _checks.distribution(
                data_distribution, "data_distribution", share.shape
            )
            require_available(share, simulator, "data_distribution")
        support = share.reshape(-1) > 0
        keep = sparse.diags_array(support.astype(np.float64), format="csr")
        refuse_unsupported(
            sparse.csr_array(keep @ target.transitions), simulator, what="target"
        )
        if behavior_policy is not None:
            behavior_policy = check_policy(
                behavior_policy, simulator, name="behavior_policy"
            )
        steps = optional_horizon_length(horizon, simulator)
        pi = check_policy(policy, simulator)
        return self.limit_of(
            Population(simulator, target, pi, share, support, behavior_policy, steps)
        )

    def limit_of(self, population: Population) -> float:
        """Compute the limit in a checked population.

        Parameters
        ----------
        population : Population
            Simulator, target, policy, horizon and how the data are recorded.

        Returns
        -------
        float
            The limit of the value; not normalised.
        """
        raise NotImplementedError

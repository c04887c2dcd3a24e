"""The model-based baseline: the maximum-likelihood model of the log."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular._sparse import align, row_of_entry, row_sums
from oee_tabular.estimators.base import (
    OF_COUNTS,
    ROUNDING,
    Estimate,
    TabularEstimator,
    coverage,
    delta_error,
    learnable_shares,
)
from oee_tabular.estimators.problem import Problem
from oee_tabular.exact import evaluate_policy, transition_gradient
from oee_tabular.exact.occupancy import time_in_pairs
from oee_tabular.mdp import FiniteMDP
from oee_tabular.ratio.method import Population
from oee_tabular.typing import Array, Csr


@suggest_keywords
@dataclass(frozen=True)
class ModelBased(TabularEstimator):
    """The model-based baseline: the value in the maximum-likelihood model of the log.

    The rows of the model are the log's frequencies n(s, a, s') / n(s, a).

    Parameters
    ----------
    fallback : {'stay', 'simulator'}, default 'stay'
        The rows of unrecorded pairs: the state stays (with reward r(s, a, s) if the
        simulator defines it, else its expected r(s, a)), or the simulator's.

    See Also
    --------
    OffEnvironment : The simulator corrected by the log.

    Notes
    -----
    The value converges to J of the target's rows where the log's distribution has mass,
    and of the fallback's elsewhere; it attains the efficiency bound. With full coverage
    it equals off-environment evaluation without shrinkage. The standard error takes the
    variance of a row's own frequencies, which is 0 in a row with one transition:
    ``diagnostics["single_share"]`` is the share of the policy's discounted time in such
    pairs (of several next states).

    Examples
    --------
    >>> from oee_tabular.testing import case
    >>> pair = case("ragged")  # a known target: J = 10.07
    >>> estimate = ModelBased()(pair.problem(1000, seed=0), pair.policy)
    >>> round(estimate.value, 2), round(estimate.standard_error, 2)
    (10.2, 0.17)
    >>> round(
    ...     ModelBased().limit(
    ...         pair.simulator, pair.target, pair.policy, horizon=pair.horizon
    ...     ),
    ...     2,
    ... )
    10.07
    """

    fallback: Literal["stay", "simulator"] = "stay"

    def __post_init__(self) -> None:
        _checks.one_of(self.fallback, "fallback", ("stay", "simulator"))

    claims = OF_COUNTS | {"consistent", "shift"}

    def estimate(
        self, problem: Problem, policy: Array, generator: np.random.Generator
    ) -> Estimate:
        """Compute the exact value in the log's model.

        Parameters
        ----------
        problem : Problem
            The simulator and the log.
        policy : ndarray of shape (S, A)
            The policy's probabilities.
        generator : numpy.random.Generator
            Not used: the estimate is exact given the log.

        Returns
        -------
        Estimate
            The value, without the findings that follow from its diagnostics.
        """
        model = self.model(problem)
        totals = row_sums(problem.counts)
        result = evaluate_policy(model, policy, horizon=problem.horizon)
        time = time_in_pairs(model, policy, problem.horizon)
        shares = learnable_shares(problem, time)
        covered = coverage(problem, shares, totals.reshape(policy.shape))
        n_successors = np.diff(problem.model.transitions.indptr)
        single = float(shares.reshape(-1)[(totals == 1) & (n_successors > 1)].sum())
        gradient = transition_gradient(
            model, policy, horizon=problem.horizon, values=result.values, time=time
        )
        delta = delta_error(model.transitions, model.transitions.data, totals, gradient)
        least = ROUNDING * max(abs(result.value), float(np.abs(model.rewards).max()))
        # an error of 0 is certain only where no pair has several next states
        error = delta if (n_successors <= 1).all() or delta > least else None
        return Estimate(
            result.value,
            error,
            diagnostics={
                "error_bound": result.error_bound,
                "method": result.method,
                **covered,
                "single_share": single,
                "standard_error_of": "log",
            },
            measured=covered["coverage"] - single,
        )

    def limit_of(self, population: Population) -> float:
        """Compute J of the target's rows where the data are, else of the fallback's.

        Parameters
        ----------
        population : Population
            Simulator, target, policy, horizon and how the data are recorded.

        Returns
        -------
        float
            The limit of the value; not normalised.
        """
        keep = sparse.diags_array(population.support.astype(np.float64), format="csr")
        rows = sparse.csr_array(keep @ population.target.transitions)
        return population.value(self._fill_rows(population.simulator, rows))

    def model(self, problem: Problem) -> FiniteMDP:
        """Return the model: the log's frequencies, and the fallback elsewhere.

        Parameters
        ----------
        problem : Problem
            The simulator and the log.

        Returns
        -------
        FiniteMDP
            The model, with the rewards, start and discount of the problem.
        """
        counts = _checks.instance(problem, Problem, "problem").counts
        data = counts.data / row_sums(counts)[row_of_entry(counts)]
        rows = sparse.csr_array(
            (data, counts.indices, counts.indptr), shape=counts.shape
        )
        return self._fill_rows(problem.model, rows)

    def _fill_rows(self, base: FiniteMDP, rows: sparse.csr_array) -> FiniteMDP:
        """Return ``base`` with these rows, and the fallback's where they are 0."""
        size = rows.shape[0]
        empty = np.flatnonzero(row_sums(rows) == 0)
        ones = np.ones(len(empty))
        if self.fallback == "simulator":
            chosen = sparse.csr_array((ones, (empty, empty)), shape=(size, size))
            rest = chosen @ base.transitions
        else:
            states = empty // base.n_actions
            rest = sparse.csr_array((ones, (empty, states)), shape=rows.shape)
        matrix = sparse.csr_array(rows + rest)
        rewards: Array | Csr = base.rewards
        if base.transition_rewards is not None:
            matrix.sort_indices()
            data, defined = align(base.transition_rewards, matrix)
            data = np.where(
                defined, data, base.rewards.reshape(-1)[row_of_entry(matrix)]
            )
            rewards = sparse.csr_array(
                (data, matrix.indices, matrix.indptr), shape=matrix.shape
            )
        return FiniteMDP(
            matrix,
            rewards,
            base.initial,
            base.discount,
            terminal_state=base.terminal_state,
            layout=base.layout,
            state_names=base.state_names,
            action_names=base.action_names,
        )

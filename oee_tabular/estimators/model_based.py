"""The model-based baseline: the maximum-likelihood model of the log."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular._sparse import align, row_of_entry, row_sums
from oee_tabular.estimators.base import OF_COUNTS, TabularEstimator
from oee_tabular.estimators.errors import ROUNDING, delta_error
from oee_tabular.estimators.estimate import Estimate
from oee_tabular.estimators.findings import MIN_SHARE, Finding
from oee_tabular.estimators.problem import Problem
from oee_tabular.estimators.recorded_time import coverage, learnable_shares
from oee_tabular.exact import (
    evaluate_policy,
    policy_value,
    time_in_pairs,
    transition_gradient,
)
from oee_tabular.mdp import FiniteMDP, csr_from_entries
from oee_tabular.ratio.method import Population
from oee_tabular.typing import Array, Csr

# what stands for unrecorded pairs where it is not the simulator, said where the policy
# spends time there
ELSEWHERE = {
    "stay": (
        "in unrecorded state-action pairs its state never changes, so that a reward"
        " there is paid for ever."
    ),
    "zero": "in unrecorded state-action pairs its Q stays 0, as if the task ended.",
}


@suggest_keywords
@dataclass(frozen=True)
class ModelBased(TabularEstimator):
    """The model-based baseline: the value in the maximum-likelihood model of the log.

    The rows of the model are the log's frequencies n(s, a, s') / n(s, a).

    Parameters
    ----------
    fallback : {'stay', 'simulator', 'zero'}, default 'stay'
        What happens in unrecorded pairs: the state stays (with reward r(s, a, s) if the
        simulator defines it, else its expected r(s, a)); or what does in the simulator;
        or everything ends without reward, so that their Q is 0. With 'simulator' it is
        fitted Q evaluation whose unrecorded pairs take the simulator's update, with
        'zero' fitted Q evaluation of the log alone, whose Q begins at 0.

    See Also
    --------
    OffEnvironment : The simulator corrected by the log.

    Notes
    -----
    The value converges to J of the target's rows where the log's distribution has mass,
    and of the fallback's elsewhere; it attains the efficiency bound. With full coverage
    it equals off-environment evaluation without shrinkage, and fitted Q evaluation,
    which iterates Q(s, a) <- mean of r + gamma sum_a' pi(a' | s') Q(s', a') over the
    log: here the fixed point is solved for. The standard error takes the
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

    fallback: Literal["stay", "simulator", "zero"] = "stay"

    def __post_init__(self) -> None:
        _checks.one_of(self.fallback, "fallback", ("stay", "simulator", "zero"))

    @property
    def claims(self) -> frozenset[str]:
        """Return what it claims: a Q that stays 0 is not shifted with the rewards."""
        own = OF_COUNTS | {"consistent"}
        return own if self.fallback == "zero" else own | {"shift"}

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
        wide = self._policy(policy)
        result = evaluate_policy(model, wide, horizon=problem.horizon)
        time = time_in_pairs(model, wide, problem.horizon)
        shares = learnable_shares(problem, time[: len(policy)])
        covered = coverage(problem, shares, totals.reshape(policy.shape))
        n_successors = np.diff(problem.model.transitions.indptr)
        single = float(shares.reshape(-1)[(totals == 1) & (n_successors > 1)].sum())
        gradient = transition_gradient(
            model, wide, horizon=problem.horizon, values=result.values, time=time
        )
        counted = np.pad(totals, (0, time.size - len(totals)))
        delta = delta_error(
            model.transitions, model.transitions.data, counted, gradient
        )
        least = ROUNDING * max(abs(result.value), float(np.abs(model.rewards).max()))
        # an error of 0 is certain only where no pair has several next states
        error = delta if (n_successors <= 1).all() or delta > least else None
        share = covered["unrecorded_share"]
        warnings: tuple[Finding, ...] = ()
        if share > MIN_SHARE and self.fallback in ELSEWHERE:
            warnings = (Finding("elsewhere", share, ELSEWHERE[self.fallback]),)
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
            findings=warnings,
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
        model = self._fill_rows(population.simulator, rows)
        policy = self._policy(population.policy)
        return policy_value(model, policy, horizon=population.horizon)

    def model(self, problem: Problem) -> FiniteMDP:
        """Return the model: the log's frequencies, and the fallback elsewhere.

        With the fallback 'zero' it has a last state more, in which all actions stay
        without reward, and to which unrecorded pairs lead.

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

    def _policy(self, policy: Array) -> Array:
        """Return the policy in the states of the model."""
        if self.fallback != "zero":
            return policy
        last = np.eye(policy.shape[1])[:1]
        return np.concatenate([policy, last])

    def _fill_rows(self, base: FiniteMDP, rows: sparse.csr_array) -> FiniteMDP:
        """Return ``base`` with these rows, and the fallback's where they are 0."""
        if self.fallback == "zero":
            return _end_elsewhere(base, rows)
        size = rows.shape[0]
        empty = np.flatnonzero((row_sums(rows) == 0) & base.available.reshape(-1))
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
            available=None if base.has_all_actions else base.available,
        )


def _end_elsewhere(base: FiniteMDP, rows: Csr) -> FiniteMDP:
    """Return ``base`` with these rows; those that are 0 lead to a last state more.

    Nothing is paid on the way to it, nor in it.
    """
    n = base.n_states
    # rows of actions that cannot be taken stay empty
    recorded = (row_sums(rows) > 0) | ~base.available.reshape(-1)
    size = len(recorded) + base.n_actions
    ends = np.flatnonzero(np.append(~recorded, np.ones(base.n_actions, dtype=bool)))
    matrix = csr_from_entries(
        np.append(row_of_entry(rows), ends),
        np.append(rows.indices, np.full(len(ends), n)),
        np.append(rows.data, np.ones(len(ends))),
        (size, n + 1),
    )
    expected = np.where(recorded, base.rewards.reshape(-1), 0.0)
    expected = np.append(expected, np.zeros(base.n_actions))
    rewards: Array | Csr = expected.reshape(n + 1, base.n_actions)
    if base.transition_rewards is not None:
        own = base.transition_rewards
        table = csr_from_entries(row_of_entry(own), own.indices, own.data, matrix.shape)
        data, defined = align(table, matrix)
        data = np.where(defined, data, expected[row_of_entry(matrix)])
        data[np.isin(row_of_entry(matrix), ends)] = 0.0
        rewards = sparse.csr_array(
            (data, matrix.indices, matrix.indptr), shape=matrix.shape
        )
    return FiniteMDP(
        matrix,
        rewards,
        np.append(base.initial, 0.0),
        base.discount,
        terminal_state=base.terminal_state,
        available=np.pad(base.available, ((0, 1), (0, 0)), constant_values=True),
    )

"""The model-based baseline: the maximum-likelihood model of the log."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array, PolicyLike, Seed
from oee_tabular._sparse import align, row_of_entry, row_sums, row_variances
from oee_tabular._threads import one_thread
from oee_tabular.estimators import findings
from oee_tabular.estimators.base import (
    OF_COUNTS,
    ROUNDING,
    Estimate,
    ExactLimit,
    catch_divergence,
    expected_rewards,
)
from oee_tabular.estimators.off_environment import coverage
from oee_tabular.estimators.problem import Problem, require_policy
from oee_tabular.exact import evaluate_policy, transition_gradient
from oee_tabular.exact.linear import exponent
from oee_tabular.exact.occupancy import time_in_pairs
from oee_tabular.mdp import FiniteMDP
from oee_tabular.ratio.method import Population


@dataclass(frozen=True)
class ModelBased(ExactLimit):
    """J in the model whose rows are the log's frequencies n_sas' / n_sa.

    Parameters
    ----------
    fallback : "stay" | "simulator"
        What a row never visited does: stay where it is (paying r(s, a, s) where the simulator defines it, else its
        expected r(s, a)), or as the simulator.

    Notes
    -----
    Limit: J(P_lim) with P_lim = P_target where the log's distribution has mass, the fallback elsewhere; it attains the
    efficiency bound. With known simulator and full coverage it equals off-environment evaluation without shrinkage.
    The standard error takes the variance of a row's own frequencies, 0 in a row with one move:
    ``diagnostics["single_share"]`` is the share of the policy's discounted time in such rows (of several next states).

    Examples
    --------
    >>> from oee_tabular.testing import case
    >>> pair = case("ragged")  # a target that is known: the truth is 10.07
    >>> estimate = ModelBased()(pair.problem(1000, seed=0), pair.policy)
    >>> round(estimate.value, 2), round(estimate.standard_error, 2)
    (10.2, 0.17)
    >>> round(ModelBased().limit(pair.simulator, pair.target, pair.policy, horizon=pair.horizon), 2)
    10.07
    """

    fallback: Literal["stay", "simulator"] = "stay"

    def __post_init__(self) -> None:
        _checks.one_of(self.fallback, "fallback", ("stay", "simulator"))

    @one_thread
    @catch_divergence
    def __call__(self, problem: Problem, policy: PolicyLike, *, seed: Seed = None) -> Estimate:
        """Exact given the log; ``seed`` is not used."""
        pi = require_policy(problem, policy)
        totals = row_sums(problem.counts)
        model = self.model(problem)
        found = evaluate_policy(model, pi, horizon=problem.horizon)
        diagnostics: dict[str, object] = {"error_bound": found.error_bound, "method": found.method}
        told = findings.linear_algebra(found.error_bound, found.value)
        shape = (model.n_states, model.n_actions)
        time = time_in_pairs(model, pi, problem.horizon)
        seen = coverage(problem, model, pi, totals.reshape(shape), time)
        repeated = np.where((totals == 1) & (np.diff(problem.model.transitions.indptr) > 1), 0.0, totals)
        known = coverage(problem, model, pi, repeated.reshape(shape), time)["coverage"]
        single = seen["coverage"] - known
        gradient = transition_gradient(model, pi, horizon=problem.horizon, values=found.values, time=time)
        delta = delta_error(model.transitions, model.transitions.data, totals, gradient)
        certain = bool((np.diff(problem.model.transitions.indptr) <= 1).all())
        least = ROUNDING * max(abs(found.value), float(np.abs(model.rewards).max()))
        error = delta if certain or delta > least else None
        return Estimate(
            found.value,
            error,
            diagnostics=diagnostics | seen | {"single_share": single, "standard_error_of": "log"},
            findings=(
                *findings.unseen_time(seen["fallback_share"], bare=error is not None, judged=True),
                *findings.single_moves(single, error),
                *told,
            ),
            measured=known,
        )

    @property
    def claims(self) -> frozenset[str]:
        """Words of ``testing.CLAIMS``."""
        return OF_COUNTS | {"consistent", "shift"}

    def limit_of(self, people: Population) -> float:
        """J of the target's rows where the data are, the fallback's elsewhere."""
        if self.fallback == "simulator":
            return people.value(people.model(people.simulator.transitions))
        rows = np.arange(people.simulator.n_states * people.simulator.n_actions)
        stay = sparse.csr_array(
            (np.ones(len(rows)), (rows, rows // people.simulator.n_actions)), shape=people.simulator.transitions.shape
        )
        keep, rest = (np.where(mask, 1.0, 0.0) for mask in (people.support, ~people.support))
        model = sparse.csr_array(sparse.diags_array(keep) @ people.target.transitions + sparse.diags_array(rest) @ stay)
        staying = people.simulator.rewards.reshape(-1)
        if people.simulator.transition_rewards is not None:
            own, defined = align(people.simulator.transition_rewards, stay)
            staying = np.where(defined, own, staying)
        paid = np.where(people.support, expected_rewards(people.simulator, people.target.transitions), staying)
        rewards = paid.reshape(people.simulator.rewards.shape)
        return people.value(FiniteMDP(model, rewards, people.simulator.initial, people.simulator.discount))

    def model(self, problem: Problem) -> FiniteMDP:
        """The frequencies of the log, the fallback where it has none."""
        counts = problem.counts
        totals = row_sums(counts)
        base = problem.model
        unseen = np.flatnonzero(totals == 0)
        rows = row_of_entry(counts)
        frequency = sparse.csr_array((counts.data / totals[rows], counts.indices, counts.indptr), shape=counts.shape)
        if self.fallback == "simulator":
            keep = sparse.csr_array((np.ones(len(unseen)), (unseen, unseen)), shape=(len(totals), len(totals)))
            rest = keep @ base.transitions
        else:
            stay = unseen // base.n_actions
            rest = sparse.csr_array((np.ones(len(unseen)), (unseen, stay)), shape=counts.shape)
        matrix = sparse.csr_array(frequency + rest)
        rewards: object = base.rewards
        if base.transition_rewards is not None:
            matrix.sort_indices()
            data, defined = align(base.transition_rewards, matrix)
            data = np.where(defined, data, base.rewards.reshape(-1)[row_of_entry(matrix)])
            rewards = sparse.csr_array((data, matrix.indices, matrix.indptr), shape=matrix.shape)
        return FiniteMDP(
            matrix, rewards, base.initial, base.discount, terminal_state=base.terminal_state, layout=base.layout,
            state_names=base.state_names, action_names=base.action_names,
        )  # fmt: skip


def delta_error(matrix: sparse.csr_array, frequency: Array, totals: Array, gradient: Array) -> float:
    """Delta method, root of the sum over visited rows of Var(gradient) / n, variances under ``frequency``."""
    shift = exponent(gradient)
    gradient = np.ldexp(gradient, -shift)
    variance = row_variances(matrix, frequency, gradient)
    return float(np.ldexp(np.sqrt(np.sum(variance[totals > 0] / totals[totals > 0])), shift))

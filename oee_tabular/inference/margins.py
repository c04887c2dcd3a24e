"""What an interval owes to transitions outside the simulator's support, and to a simulator that was made of samples itself.

Of the transitions from (s, a) the target may make a share q_sa that the simulator rules out, to any state at all:

    q_sa = f / (m + n)          Good and Turing's estimate of the probability of transitions never met [1]: m samples of the
                                simulator and n of the log, f of them met once; 1 in a row without any, which was filled in
         + k / (k + n)          k transitions of the log dropped as impossible (``Problem(impossible="drop")``)

To first order, at the maximum-likelihood model with D_sa the discounted time in (s, a), they take or add at most

    sum_sa D_sa q_sa |extreme over all states and rewards of r + gamma V - E_p (r + gamma V)|

(with a horizon the sum goes over steps too, V having those that are left). That is a band and no bound: where q is large,
transitions that lead to where q is large again may lead further. A simulator's own sampling (``FiniteMDP.from_env``,
``from_log``) adds the variance

    Var_mu(V) / m_starts + sum_sa,s' (D_sa p_s')^2 Var(mean reward of the transition).

Source: [1] I. Good, The population frequencies of species and the estimation of population parameters, Biometrika 40, 1953.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from oee_tabular._checks import Array
from oee_tabular._sparse import align
from oee_tabular.estimators import Problem
from oee_tabular.exact import ReweightedModel, occupancy, policy_value, state_values
from oee_tabular.inference.evidence import Evidence
from oee_tabular.mdp.horizons import horizon_length, total_discount


class Margin(NamedTuple):
    """J of the frequencies, the variance that the simulator's sampling adds, and what the band takes and adds.

    ``unmet_share`` (None where the simulator is known) and ``dropped_share`` are shares of the policy's discounted time,
    ``dropped`` a number of transitions.
    """

    value: float
    variance: float
    down: float
    up: float
    unmet_share: float | None
    dropped_share: float
    dropped: float

    @property
    def diagnostics(self) -> dict[str, float]:
        """For ``Interval``; without those of what is not there."""
        facts = {} if self.unmet_share is None else {"unmet_share": self.unmet_share}
        if self.unmet_share is not None:
            facts["sampling_error"] = float(np.sqrt(self.variance))
        if self.dropped:
            facts |= {"dropped_moves": self.dropped, "dropped_share": self.dropped_share}
        return facts

    def widen(self, lower: float, upper: float, z: float) -> tuple[float, float]:
        """The ends for this simulator, from those for one that is known and rules nothing out wrongly."""
        spread = z * np.sqrt(self.variance)
        low = self.value - float(np.hypot(max(self.value - lower, 0.0), spread)) - self.down
        return low, self.value + float(np.hypot(max(upper - self.value, 0.0), spread)) + self.up


def outside_margin(problem: Problem, evidence: Evidence) -> Margin | None:
    """None where the simulator is known and nothing was dropped."""
    sampling = problem.simulator.sampling
    if sampling is None and not problem.dropped.any():
        return None
    model, policy, horizon = evidence.model, evidence.policy, evidence.horizon
    fitted = evidence.with_rows(evidence.phat)
    share = occupancy(fitted, policy, horizon=horizon).reshape(-1)
    total = total_discount(model.discount, horizon)
    unmet, variance = np.zeros(len(share)), 0.0
    if sampling is not None:
        values = state_values(fitted, policy, horizon=horizon)
        unmet = _unmet_share(evidence, sampling.pairs)
        variance = max(float(model.initial @ values**2) - float(model.initial @ values) ** 2, 0.0) / sampling.starts
        if sampling.reward_error is not None:
            each, _ = align(sampling.reward_error, model.transitions)
            variance += float((total * share[evidence.rows] * evidence.phat) ** 2 @ each)
    dropped = problem.dropped / np.maximum(problem.dropped + evidence.n, 1.0)
    down, up = _band(evidence, fitted, np.minimum(unmet + dropped, 1.0))
    return Margin(
        policy_value(fitted, policy, horizon=horizon),
        variance,
        down,
        up,
        None if sampling is None else float(share @ unmet),
        float(share @ dropped),
        float(problem.dropped.sum()),
    )


def _unmet_share(evidence: Evidence, pairs: Array) -> Array:
    """(S*A,) Good and Turing's estimate in each row; ``pairs`` are the simulator's samples, inf where it is known."""
    known = ~np.isfinite(pairs)
    simulator = evidence.model.transitions.data * np.where(known, 0.0, pairs)[evidence.rows]
    number = np.rint(simulator) + np.where(evidence.n > 0, evidence.n, 0.0)[evidence.rows] * evidence.phat
    once = np.bincount(evidence.rows, np.abs(number - 1.0) < 0.5, len(pairs))
    total = np.where(known, 1.0, pairs) + evidence.n
    return np.where(known, 0.0, np.where(total > 0, np.minimum(once / np.maximum(total, 1.0), 1.0), 1.0))


def _band(evidence: Evidence, fitted: ReweightedModel, q: Array) -> tuple[float, float]:
    """What a share q (S*A,) of transitions to any state takes and adds, to first order."""
    policy, gamma = evidence.policy, fitted.discount
    if evidence.horizon is None:
        values = state_values(fitted, policy)
        time = occupancy(fitted, policy).reshape(-1) / (1.0 - gamma)
        return float(time @ (q * _reach(evidence, values, -1.0))), float(time @ (q * _reach(evidence, values, 1.0)))
    values, beyond = np.zeros(len(policy)), np.zeros((len(policy), 2))
    for _ in range(horizon_length(evidence.horizon, fitted)):
        each = np.column_stack([q * _reach(evidence, values, sign) for sign in (-1.0, 1.0)])
        ahead = (each + gamma * (fitted.transitions @ beyond)).reshape(*policy.shape, 2)
        beyond = np.einsum("sa,sak->sk", policy, ahead)
        worth = fitted.rewards + gamma * (fitted.transitions @ values).reshape(policy.shape)
        values = (policy * worth).sum(axis=1)
    down, up = evidence.model.initial @ beyond
    return float(down), float(up)


def _reach(evidence: Evidence, values: Array, sign: float) -> Array:
    """(S*A,) by how much the best (sign 1) or worst r + gamma V of any transition differs from the row's own mean."""
    model, gamma = evidence.model, evidence.model.discount
    extreme = gamma * sign * float((sign * values).max())
    mean = gamma * np.bincount(evidence.rows, evidence.phat * values[model.transitions.indices], len(evidence.n))
    if model.reward_data is not None:
        mean += np.bincount(evidence.rows, evidence.phat * model.reward_data, len(evidence.n))
        extreme += sign * float((sign * model.reward_data).max())
    return np.asarray(np.maximum(sign * (extreme - mean), 0.0))

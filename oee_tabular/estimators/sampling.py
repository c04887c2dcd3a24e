"""What a simulator's own sampling (``FiniteMDP.from_env``, ``from_log``) does to a policy's value in it.

By the delta method, with G(s, a, s') = dJ / dP(s' | s, a) (``exact.transition_gradient``), D(s, a) the discounted time in
(s, a), n(s, a) samples of each pair and m first states,

    Var J = sum_(s, a) Var_(s' ~ P(. | s, a)) G(s, a, s') / (n(s, a) - 1) + Var_mu V / m
            + sum_(s, a, s') (D(s, a) P(s' | s, a))^2 Var(mean reward of the transition).

n - 1, since P is the frequency of these samples. A pair without two samples has no variance to show; ``unknown_share`` says how
much of the policy's time is spent there.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from oee_tabular._checks import Array
from oee_tabular._sparse import align
from oee_tabular.estimators.findings import Finding
from oee_tabular.estimators.model_based import delta_error
from oee_tabular.exact import occupancy, state_values, transition_gradient
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.horizons import total_discount

N_FEW = 10  # samples: with fewer, a normal interval is a guess
MIN_SHARE = 1e-3  # of the policy's discounted time: less is not worth a sentence


class SamplingError(NamedTuple):
    """The standard error of J, how many of the pairs that the policy uses have few samples, and shares of its time."""

    standard_error: float
    n_used: int
    n_few: int
    few_share: float
    unknown_share: float


def compute_sampling_error(simulator: FiniteMDP, policy: Array, horizon: int | None) -> SamplingError | None:
    """Return what the sampling does to J; None for one that is known, and for an infinite sum at discount 1."""
    sampling, matrix = simulator.sampling, simulator.transitions
    if sampling is None or (horizon is None and simulator.discount == 1.0):
        return None
    share = occupancy(simulator, policy, horizon=horizon).reshape(-1)
    gradient = transition_gradient(simulator, policy, horizon=horizon)
    values = state_values(simulator, policy, horizon=horizon)
    variance = delta_error(matrix, matrix.data, np.maximum(sampling.pairs - 1.0, 1.0), gradient) ** 2
    variance += float(simulator.initial @ (values - simulator.initial @ values) ** 2) / sampling.starts
    if sampling.reward_error is not None:
        time = share * total_discount(simulator.discount, horizon)
        each, _ = align(sampling.reward_error, matrix)
        variance += float((np.repeat(time, np.diff(matrix.indptr)) * matrix.data) ** 2 @ each)
    is_few = (share > 0.0) & (sampling.pairs < N_FEW)
    return SamplingError(
        math.sqrt(variance),
        int(((share > 0.0) & np.isfinite(sampling.pairs)).sum()),
        int(is_few.sum()),
        float(share[is_few].sum()),
        float(share[sampling.pairs < 2.0].sum()),
    )


def short_samples(error: SamplingError, *, has_interval: bool) -> tuple[Finding, ...]:
    """Say plainly that the policy goes where the simulator was hardly sampled."""
    if error.few_share <= MIN_SHARE:
        return ()
    text = (
        f"the simulator was sampled, and {{}} of the {error.n_used} state-action pairs that the policy uses have fewer than "
        f"{N_FEW} samples ({error.few_share:.1%} of its discounted time)"
    )
    if not has_interval:
        text += "; do not rely on the value, which has no interval"
    return (Finding("few samples", error.few_share, f"{text}.", str(error.n_few)),)

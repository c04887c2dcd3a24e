"""The paper's product of ratios on rollouts of the simulator (its equation for J in terms of zeta), by Monte Carlo.

W_t = zeta_1 ... zeta_t along a path; a reward r(s, a) at time t carries W_t, a reward r(s, a, s') W_{t+1}. Per decision:
sum_t gamma^t W r_t; trajectory-wise: the last weight times the whole return. An episode that is over keeps its last weight.
Exact values and variances exist by dynamic programming; this shows what sampling costs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray
from oee_tabular._sparse import find
from oee_tabular.data import Transitions
from oee_tabular.estimators.base import Estimate, effective_sample_size, mean_and_error
from oee_tabular.mdp import FiniteMDP
from oee_tabular.ratio import TransitionRatio
from oee_tabular.simulate import sample_episodes

WEIGHTINGS = ("per_decision", "trajectory")


@dataclass(frozen=True)
class Weighted:
    """Ragged episodes as flat rows: discounted reward, weight of each reward, where episodes start.

    ``kept`` is the weight that each episode has at steps after its last row (it is over, and pays nothing).
    """

    reward: Array
    weight: Array
    starts: IntArray
    timestep: IntArray
    kept: Array


def rollout_horizon(discount: float, horizon: int | None) -> int:
    """The horizon, or for the infinite sum the first t with discount^t < 1e-12."""
    if horizon is not None:
        return horizon
    if discount == 1.0:
        raise ValueError("horizon must be given for rollouts at discount 1")
    return 1 if discount == 0.0 else int(np.ceil(np.log(1e-12) / np.log(discount))) + 1


def product_estimate(
    model: FiniteMDP,
    ratio: TransitionRatio,
    policy: Array,
    *,
    horizon: int | None,
    weighting: str,
    self_normalized: bool,
    n_rollouts: int,
    seed: Any,
) -> Estimate:
    """J by ``n_rollouts`` rollouts of ``model`` weighted by products of ``ratio``."""
    steps = rollout_horizon(model.discount, horizon)
    rollouts = sample_episodes(model, policy, n_rollouts, steps, seed=seed)
    rows = rollouts.state * model.n_actions + rollouts.action
    zeta = ratio.on(model)
    position, _ = find(model.transitions, rows, rollouts.next_state)
    weighted = _weights(model, rollouts, zeta[position], weighting, steps)
    value, error = combine(
        weighted, self_normalized=self_normalized, keep_last=True, per_decision=weighting == "per_decision"
    )
    last = weighted.kept
    return Estimate(
        value,
        error,
        status=weight_status(value),
        diagnostics={
            "standard_error_of": "rollouts",
            "n_rollouts": n_rollouts,
            "effective_sample_size": effective_sample_size(last),
            "largest_weight": float(weighted.weight.max()),
            "mean_weight": float(last.mean()),
            "row_sum_error": ratio.row_sum_error,
        },
    )


def weight_status(value: float) -> str:
    """What to say where a self-normalised estimate has nothing to divide by."""
    if np.isnan(value):
        return "at some step every weight is 0: no episode went the policy's way that far (shorten the horizon, or use oee)"
    return "ok"


def _weights(model: FiniteMDP, rollouts: Transitions, zeta: Array, weighting: str, horizon: int) -> Weighted:
    """W_t for r(s, a) and W_{t+1} for r(s, a, s'); after the end of an episode the product stands still."""
    starts, timestep = rollouts.episode_starts, rollouts.timestep
    assert starts is not None
    assert timestep is not None
    assert rollouts.reward is not None
    after = segment_products(zeta, starts)
    weight, lengths = after, np.diff(starts)
    kept = after[starts[1:] - 1]
    if model.transition_rewards is None:  # r(s, a): the weight before the move
        weight = np.ones(len(after))
        inner = np.ones(len(after), dtype=np.bool_)
        inner[starts[:-1]] = False
        weight[inner] = after[np.flatnonzero(inner) - 1]
        kept = np.where(lengths < horizon, kept, weight[starts[1:] - 1])
    if weighting == "trajectory":
        weight = np.repeat(kept, lengths)
    reward = model.discount ** timestep.astype(np.float64) * rollouts.reward
    return Weighted(reward, weight, starts, timestep, kept)


def segment_products(values: Array, starts: IntArray) -> Array:
    """Running products within each episode; exact zeros stay zeros."""
    result = np.array(values, dtype=np.float64)
    lengths = np.diff(starts)
    for t in range(1, int(lengths.max())):
        here = starts[:-1][lengths > t] + t
        result[here] *= result[here - 1]
    return result


def combine(
    weighted: Weighted, *, self_normalized: bool, keep_last: bool, per_decision: bool
) -> tuple[float, float | None]:
    """The estimate and its standard error.

    Plain: the mean over episodes of sum_t w_t r_t. Self-normalised: sum_i w_i r_i / sum_i w_i, step by step per decision
    (an ended episode has its kept weight if ``keep_last``, else weight 0), once trajectory-wise; its error is that of the
    linearised ratio. nan where the weights to divide by are all 0.
    """
    starts = weighted.starts
    totals = np.add.reduceat(weighted.weight * weighted.reward, starts[:-1])
    if not self_normalized:
        return mean_and_error(totals)
    n = len(totals)
    kept = weighted.kept
    if not per_decision:
        mass = float(kept.sum())
        if mass == 0.0:
            return float("nan"), None
        value = float(totals.sum()) / mass
        influence = (totals - value * kept) * (n / mass)
        return value, mean_and_error(influence, abs(value))[1]
    lengths = np.diff(starts)
    horizon = int(lengths.max())
    step_mass = np.bincount(weighted.timestep, weights=weighted.weight, minlength=horizon)
    if keep_last:
        ended = np.bincount(lengths, weights=kept, minlength=horizon + 1)[:horizon]
        step_mass = step_mass + np.cumsum(ended)
    paid = np.bincount(weighted.timestep, weights=weighted.weight * weighted.reward, minlength=horizon)
    if np.any(step_mass == 0.0):
        return float("nan"), None
    step_value = paid / step_mass
    value = float(step_value.sum())
    # linearised: sum_t (w_it r_it - step_value_t w_it) n / step_mass_t, an ended episode counting with its kept weight
    t = weighted.timestep
    terms = (weighted.weight * weighted.reward - step_value[t] * weighted.weight) * (n / step_mass[t])
    influence = np.add.reduceat(terms, starts[:-1])
    if keep_last:
        tail = np.concatenate([np.cumsum((step_value * n / step_mass)[::-1])[::-1], [0.0]])
        influence = influence - kept * tail[lengths]
    return value, mean_and_error(influence, float(np.abs(step_value).sum()))[1]


def check_rollout_options(weighting: str, n_rollouts: int) -> None:
    """Options that OffEnvironment and Oracle share."""
    _checks.one_of(weighting, "weighting", WEIGHTINGS)
    _checks.positive_integer(n_rollouts, "n_rollouts")

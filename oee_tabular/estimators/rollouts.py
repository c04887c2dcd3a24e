"""Weighted sums over episodes: the log's, or rollouts of the simulator.

The latter are the paper's J in terms of zeta. Let W_t = zeta_1 ... zeta_t along a path.
The weight of a reward r(s, a) at time t is W_t, that of a reward r(s, a, s') is
W_{t+1}. Per decision the sum is that of gamma^t W r_t; trajectory-wise it is the last
weight times the whole return. An episode that has ended keeps its last weight. Episodes
are stored in flat arrays, episode i in rows starts[i] to starts[i + 1] - 1.
"""

from __future__ import annotations

import numpy as np

from oee_tabular.estimators.errors import mean_and_error
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import FiniteMDP
from oee_tabular.simulate import Drawn, entry_rewards
from oee_tabular.typing import Array, IntArray

NEGLIGIBLE_DISCOUNT = 1e-12  # an infinite sum is cut where discount^t is below this


def rollout_horizon(discount: float, horizon: int | None) -> int:
    """Return the horizon, for the infinite sum the first t with discount^t < 1e-12."""
    if horizon is not None:
        return horizon
    if discount == 1.0:
        raise ArgumentError("horizon", "must be given for rollouts at discount 1")
    if discount == 0.0:
        return 1
    return int(np.ceil(np.log(NEGLIGIBLE_DISCOUNT) / np.log(discount))) + 1


def weight_status(value: float) -> str:
    """Return the status of a self-normalised value, which is nan without weights."""
    if np.isnan(value):
        return (
            "at some step every weight is 0: no episode went the policy's way that far"
            " (shorten the horizon, or use oee)"
        )
    return "ok"


def step_numbers(starts: IntArray) -> IntArray:
    """Return the step of each row in its episode."""
    return np.arange(starts[-1]) - np.repeat(starts[:-1], np.diff(starts))


def segment_products(values: Array, starts: IntArray) -> Array:
    """Compute the running products within each episode; zeros stay exact."""
    result = np.array(values, dtype=np.float64)
    lengths = np.diff(starts)
    for t in range(1, int(lengths.max())):
        here = starts[:-1][lengths > t] + t
        result[here] *= result[here - 1]
    return result


def normalize_by_episode(totals: Array, weights: Array) -> tuple[float, float | None]:
    """Compute sum_i X_i / sum_i W_i and its linearised standard error.

    The value is nan where the sum of the weights is 0 or infinite.
    """
    mass = float(weights.sum())
    if not 0.0 < mass < np.inf:
        return float("nan"), None
    value = float(totals.sum()) / mass
    influence = (totals - value * weights) * (len(totals) / mass)
    _, error = mean_and_error(influence, abs(value))
    return value, error


def normalize_by_step(
    reward: Array,
    weight: Array,
    starts: IntArray,
    last: Array,
    *,
    keep_last: bool = True,
) -> tuple[float, float | None]:
    """Compute sum_t (sum_i w_it r_it / sum_i w_it) and its linearised standard error.

    ``reward`` is discounted. An episode that has ended counts in the sums of weights
    with its ``last`` weight, or with 0 unless ``keep_last``. The value is nan where the
    sum of the weights of a step is 0 or infinite.
    """
    step = step_numbers(starts)
    lengths = np.diff(starts)
    n = len(lengths)
    horizon = int(lengths.max())
    with np.errstate(over="ignore", invalid="ignore"):
        mass = np.bincount(step, weight)
        rewards = np.bincount(step, weight * reward)
    if keep_last:
        mass += np.cumsum(
            np.bincount(lengths, weights=last, minlength=horizon + 1)[:horizon]
        )
    if not np.all((mass > 0.0) & (mass < np.inf)):
        return float("nan"), None
    value = rewards / mass
    scale = n / mass
    # each episode's sum_t (w_it r_it - value_t w_it) n / mass_t
    influence = np.add.reduceat(
        (reward - value[step]) * weight * scale[step], starts[:-1]
    )
    if keep_last:
        tail = np.concatenate([np.cumsum((value * scale)[::-1])[::-1], [0.0]])
        influence -= last * tail[lengths]
    _, error = mean_and_error(influence, float(np.abs(value).sum()))
    return float(value.sum()), error


def carried_rewards(mdp: FiniteMDP, drawn: Drawn) -> tuple[Array, Array]:
    """Return gamma^t r_t of each recorded step, and its weight."""
    path = drawn.path
    starts = drawn.starts
    reward = (
        mdp.discount ** step_numbers(starts).astype(np.float64)
        * entry_rewards(mdp)[path]
    )
    with np.errstate(over="ignore", invalid="ignore"):
        weight = segment_products(drawn.ratio[path], starts)
    if mdp.reward_data is None:
        weight = np.concatenate([[1.0], weight[:-1]])
        weight[starts[:-1]] = 1.0
    return reward, weight

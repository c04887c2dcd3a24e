"""The paper's product of ratios on rollouts of the simulator (its equation for J in terms of zeta), by Monte Carlo.

W_t = zeta_1 ... zeta_t along a path; a reward r(s, a) at time t carries W_t, a reward r(s, a, s') W_{t+1}. Per decision:
sum_t gamma^t W r_t; trajectory-wise: the last weight times the whole return. An episode that is over keeps its last weight.
Exact values and variances exist by dynamic programming; this shows what sampling costs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray, Seed
from oee_tabular.estimators import findings
from oee_tabular.estimators.base import Estimate, effective_sample_size, mean_and_error
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.horizons import horizon_length
from oee_tabular.ratio import TransitionRatio
from oee_tabular.simulate.sampler import Drawn, draw, entry_rewards

WEIGHTINGS = ("per_decision", "trajectory")
OVERFLOW = "the product of ratios overflows: shorten the horizon, or use oee"


@dataclass(frozen=True)
class Weighted:
    """Ragged episodes as flat rows, step by step: discounted reward, weight of each reward, where episodes start.

    ``kept`` is the weight that each episode has at steps after its last row (it is over, and pays nothing).
    """

    reward: Array
    weight: Array
    starts: IntArray
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
    seed: Seed,
) -> Estimate:
    """J by ``n_rollouts`` rollouts of ``model`` weighted by products of ``ratio``: the episodes of ``sample_returns``."""
    ratio.on(model)  # or an error
    steps = rollout_horizon(model.discount, horizon)
    per_decision = weighting == "per_decision"
    drawn = draw(
        model, policy, n_rollouts, horizon_length(steps, model), seed=seed, zeta=ratio,
        record=self_normalized and per_decision, name="n_rollouts",
    )  # fmt: skip
    if self_normalized and per_decision:
        value, error = _by_step(_weighted(model, drawn), keep_last=True)
    elif self_normalized:
        value, error = _by_episode(drawn.whole, drawn.weights)
    else:
        value, error = mean_and_error(drawn.weighted if per_decision else drawn.whole)
    effective = effective_sample_size(drawn.weights)
    return Estimate(
        value,
        error,
        status=weight_status(value) if np.isfinite(value) or np.isfinite(drawn.weights).all() else OVERFLOW,
        diagnostics={
            "standard_error_of": "rollouts",
            "n_rollouts": n_rollouts,
            "effective_sample_size": effective,
            "largest_weight": float((drawn.largest if per_decision else drawn.weights).max()),
            "mean_weight": float(drawn.weights.mean()),
            "row_sum_error": ratio.row_sum_error,
        },
        findings=(
            *findings.varied(error),
            *findings.row_sums(ratio.row_sum_error),
            *findings.weights(effective, n_rollouts, "rollouts"),
        ),
    )


def of_products(known: frozenset[str], *, self_normalized: bool) -> frozenset[str]:
    """What products of ratios claim: they move with the rewards where they are divided by the sum of their weights."""
    return known | {"random", "shift"} if self_normalized else (known - {"shift"}) | {"random"}


def weight_status(value: float) -> str:
    """What to say where a self-normalised estimate has nothing to divide by."""
    if np.isnan(value):
        return "at some step every weight is 0: no episode went the policy's way that far (shorten the horizon, or use oee)"
    return "ok"


def _weighted(mdp: FiniteMDP, drawn: Drawn) -> Weighted:
    """The same episodes, step by step."""
    from oee_tabular.estimators import _episodes as episodes

    starts, path = drawn.starts, drawn.path
    weight, reward = np.empty((2, len(path)))
    by_move, powers = mdp.reward_data is not None, mdp.discount ** np.arange(drawn.lengths.max(), dtype=np.float64)
    episodes.carried(starts, path, drawn.ratio, entry_rewards(mdp), powers, by_move, weight, reward)
    return Weighted(reward, weight, starts, drawn.weights)


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
    linearised ratio. nan where the weights to divide by are all 0, or infinite.
    """
    if self_normalized and per_decision:
        return _by_step(weighted, keep_last=keep_last)
    totals = np.add.reduceat(weighted.weight * weighted.reward, weighted.starts[:-1])
    return _by_episode(totals, weighted.kept) if self_normalized else mean_and_error(totals)


def _by_episode(totals: Array, weights: Array) -> tuple[float, float | None]:
    """sum_i X_i / sum_i W_i, with the error of that ratio."""
    mass = float(weights.sum())
    if not 0.0 < mass < np.inf:
        return float("nan"), None
    value = float(totals.sum()) / mass
    return value, mean_and_error((totals - value * weights) * (len(totals) / mass), abs(value))[1]


def _by_step(weighted: Weighted, *, keep_last: bool) -> tuple[float, float | None]:
    """sum_t sum_i w_it r_it / sum_i w_it, with the error of those ratios."""
    from oee_tabular.estimators import _episodes as episodes

    rows, lengths = (weighted.starts, weighted.weight, weighted.reward), np.diff(weighted.starts)
    n, horizon = len(lengths), int(lengths.max())
    mass, paid, influence = np.zeros(horizon), np.zeros(horizon), np.empty(n)
    episodes.step_sums(*rows, mass, paid)
    if keep_last:
        mass += np.cumsum(np.bincount(lengths, weights=weighted.kept, minlength=horizon + 1)[:horizon])
    if not np.all((mass > 0.0) & (mass < np.inf)):
        return float("nan"), None
    value, scale = paid / mass, n / mass
    # linearised: sum_t (w_it r_it - value_t w_it) n / mass_t, an ended episode counting with its kept weight
    episodes.linearised(*rows, value, scale, influence)
    if keep_last:
        tail = np.concatenate([np.cumsum((value * scale)[::-1])[::-1], [0.0]])
        influence -= weighted.kept * tail[lengths]
    total = float(value.sum())
    return total, mean_and_error(influence, float(np.abs(value).sum()))[1]


def check_rollout_options(weighting: str, n_rollouts: int) -> None:
    """Options that OffEnvironment and Oracle share."""
    _checks.one_of(weighting, "weighting", WEIGHTINGS)
    _checks.positive_integer(n_rollouts, "n_rollouts")

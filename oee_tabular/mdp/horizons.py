"""Horizons, cut where the discount leaves nothing and refused for their cost."""

from __future__ import annotations

import math
from typing import Any

from oee_tabular import _checks
from oee_tabular._sparse import row_sums
from oee_tabular.exceptions import ArgumentError, CostWarning
from oee_tabular.mdp.policies import count_dimensions
from oee_tabular.typing import PolicyLike

SHORT_HORIZON = 10_000  # rewards; such a horizon is carried out as it stands
# The share of a reward that counts as nothing. It is far below rounding, so that late
# and unlikely rewards are not lost either.
LEAST_WEIGHT = 2.0**-200
SLOW_MULTIPLY_ADDS = 2e9  # some seconds
MAX_MULTIPLY_ADDS = 2e10  # a minute or more


def limit_horizon(
    horizon: int, rate: float, *, ahead: int = 0, work: float = 1.0, kept: float = 1.0
) -> int:
    """Shorten a horizon to the steps that the discount leaves visible.

    Returns min(horizon, max(10 000, ahead + t)) with rate^t = 2^-200, and warns where
    that is less or takes long. ``rate``: what a step multiplies the weight of all later
    rewards by, at most; from 1 on nothing fades. ``ahead``: the steps before a reward
    may come at all (the number of states). ``work``, ``kept``: the multiply-adds of a
    step, and the numbers that are kept of it; ValueError above a million steps that
    cost more than 2e10 multiply-adds, or where memory lacks.

    >>> limit_horizon(500, 0.9), limit_horizon(5000, 1.0, work=100.0)
    (500, 5000)
    """
    if horizon <= SHORT_HORIZON:
        return horizon
    fading = 1.0 if rate <= 0.0 else math.inf
    if 0.0 < rate < 1.0:
        fading = math.ceil(math.log(LEAST_WEIGHT) / math.log(rate))
    length = int(min(horizon, max(SHORT_HORIZON, ahead + fading)))
    cost = length * work
    if horizon > 10**6 and cost > MAX_MULTIPLY_ADDS:
        raise ArgumentError(
            "horizon",
            f"must be one that can be carried out; {horizon} steps take some {cost:.0e}"
            f" multiply-adds ({cost / 3.6e12:.2g} hours), and nothing ends"
            " them earlier",
        )
    _checks.require_memory(length * kept, "horizon", horizon)
    if length < horizon:
        rule = (
            "from there on the discount leaves less of a reward than 2**-200, which no"
            " float shows beside the sum"
        )
        _checks.warn(
            f"horizon {horizon} is followed to step {length}: {rule}", CostWarning
        )
    elif cost > SLOW_MULTIPLY_ADDS:
        _checks.warn(
            f"horizon {horizon} takes some {cost:.0e} multiply-adds ({cost / 1e9:.2g}"
            " seconds)",
            CostWarning,
        )
    return length


def horizon_length(
    horizon: object, model: Any, policy: PolicyLike | None = None, *, kept: float = 1.0
) -> int:
    """Check a horizon and return it as an int, limited by the discount of ``model``.

    ``model`` is a FiniteMDP or a ReweightedModel. With a policy (T, S, A) the horizon
    stays as it is.
    """
    length = _checks.positive_integer(horizon, "horizon")
    if length <= SHORT_HORIZON or count_dimensions(policy) == 3:
        return length
    # rows of zeta * P may sum to more than 1
    growth = float(row_sums(model.transitions).max())
    if growth <= 1.0 + 2.0 * _checks.SUM_TOLERANCE:
        growth = 1.0
    rate = model.discount * growth
    return limit_horizon(
        length, rate, ahead=model.n_states, work=model.transitions.nnz, kept=kept
    )


def optional_horizon_length(
    horizon: object, model: Any, policy: PolicyLike | None = None, *, kept: float = 1.0
) -> int | None:
    """Return ``horizon_length``, or None for the infinite sum."""
    if horizon is None:
        return None
    return horizon_length(horizon, model, policy, kept=kept)


def total_discount(discount: float, horizon: int | None) -> float:
    """Return sum_t discount^t over the horizon."""
    if horizon is None:
        return 1.0 / (1.0 - discount)
    if discount == 1.0:
        return float(horizon)
    return (1.0 - discount**horizon) / (1.0 - discount)

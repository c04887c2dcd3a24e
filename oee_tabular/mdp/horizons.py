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
LONG_HORIZON = 10**6  # rewards; a longer one is refused where it takes a minute or more
# The share of a reward that counts as nothing. It is far below rounding, so that late
# and unlikely rewards are not lost either.
NEGLIGIBLE_SHARE = 2.0**-200
MULTIPLY_ADDS_PER_SECOND = 1e9  # roughly; it is used for warnings and errors alone
SLOW_MULTIPLY_ADDS = 2e9  # some seconds
MAX_MULTIPLY_ADDS = 2e10  # a minute or more


def limit_horizon(
    horizon: int, rate: float, *, ahead: int = 0, work: float = 1.0, kept: float = 1.0
) -> int:
    """Shorten a horizon to the steps that the discount leaves visible.

    Parameters
    ----------
    horizon : int
        The number of rewards.
    rate : float
        The most that a step multiplies the weight of all later rewards by; from 1 on
        nothing fades.
    ahead : int
        The steps before a reward may come at all: the number of states.
    work : float
        The multiply-adds of a step.
    kept : float
        The numbers that are kept of a step.

    Returns
    -------
    int
        min(horizon, max(10 000, ahead + t)) with rate^t = 2^-200. A warning says where
        that is less than the horizon, or takes long.

    Raises
    ------
    ArgumentError
        If more than a million steps cost more than 2e10 multiply-adds, or memory lacks.

    Examples
    --------
    >>> limit_horizon(500, 0.9), limit_horizon(5000, 1.0, work=100.0)
    (500, 5000)
    """
    if horizon <= SHORT_HORIZON:
        return horizon
    fading = 1.0 if rate <= 0.0 else math.inf
    if 0.0 < rate < 1.0:
        fading = math.ceil(math.log(NEGLIGIBLE_SHARE) / math.log(rate))
    length = int(min(horizon, max(SHORT_HORIZON, ahead + fading)))
    cost = length * work
    if horizon > LONG_HORIZON and cost > MAX_MULTIPLY_ADDS:
        raise ArgumentError(
            "horizon",
            f"must be one that can be carried out; {horizon} steps take some {cost:.0e}"
            f" multiply-adds ({cost / MULTIPLY_ADDS_PER_SECOND / 3600.0:.2g} hours),"
            " and nothing ends them earlier",
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
            f"horizon {horizon} takes some {cost:.0e} multiply-adds"
            f" ({cost / MULTIPLY_ADDS_PER_SECOND:.2g} seconds)",
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
    """Compute sum_t discount^t over the horizon.

    It is (1 - discount^T) / (1 - discount), without the digits that the first difference
    loses near discount 1.

    >>> total_discount(0.5, 3), total_discount(1.0 - 1e-14, 3)
    (1.75, 2.9999999999999702)
    """
    if horizon is None:
        return 1.0 / (1.0 - discount)
    if discount == 1.0:
        return float(horizon)
    rest = 1.0 - discount
    if discount < 0.5:
        return (1.0 - discount**horizon) / rest
    # from 1/2 on the rest is exact, and near 1 it has digits that discount^T lacks
    return -math.expm1(horizon * math.log1p(-rest)) / rest


def possible_sums(
    lowest: float, highest: float, horizon: int | None, discount: float, *, ends: bool
) -> tuple[float, float]:
    """Return between which ends sum_{t<T} gamma^t r_t lies, by the rewards' own.

    Where episodes may end, rewards are 0 from then on. Rewards of 0 sum to 0, however
    many they are.

    >>> possible_sums(-2.0, -1.0, 3, 1.0, ends=False)
    (-6.0, -3.0)
    >>> possible_sums(-2.0, -1.0, None, 0.5, ends=True)
    (-4.0, 0.0)
    """
    weight = total_discount(discount, horizon)
    if ends:
        lowest = min(lowest, 0.0)
        highest = max(highest, 0.0)
    return lowest and lowest * weight, highest and highest * weight

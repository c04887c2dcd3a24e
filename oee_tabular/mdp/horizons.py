"""How far a horizon is followed: no further than the discount can show, and not where the cost would be absurd."""

from __future__ import annotations

import math
import warnings
from typing import Any, Protocol

from oee_tabular import _checks
from oee_tabular._checks import PolicyLike
from oee_tabular._sparse import row_sums
from oee_tabular.mdp.policy_forms import changes_with_time

SHORT = 10_000  # horizons up to here are followed as they stand
FADED = 2.0**-200  # of a reward's weight; far below rounding, so that late and unlikely rewards are not lost either
SLOW, ABSURD = 2e9, 2e10  # multiply-adds: some seconds, and a minute or more


class Rewarding(Protocol):
    """What is read of a FiniteMDP or a ReweightedModel."""

    @property
    def n_states(self) -> int:
        """S."""

    @property
    def discount(self) -> float:
        """gamma."""

    @property
    def transitions(self) -> Any:
        """csr (S*A, S)."""


def followed(horizon: int, rate: float, *, ahead: int = 0, work: float = 1.0, kept: float = 1.0) -> int:
    """The number of steps that are carried out for a horizon, with a warning where that is fewer or takes long.

    A horizon beyond max(10 000, ahead + t), where rate^t = 2^-200, stops there: what comes later is far below rounding.

    Parameters
    ----------
    horizon : a positive int
    rate : what a step multiplies the weight of all later rewards by, at most; from 1 on nothing fades
    ahead : steps before a reward may come at all (the number of states)
    work : multiply-adds of a step
    kept : numbers that are kept of each step

    Raises
    ------
    ValueError
        A horizon above a million whose cost is absurd (more than 2e10 multiply-adds), or numbers that the memory does not
        hold; with the estimate.

    Examples
    --------
    >>> followed(500, 0.9), followed(5000, 1.0, work=100.0)
    (500, 5000)
    """
    if horizon <= SHORT:
        return horizon
    limit = float(horizon)
    if rate <= 0.0:
        limit = 1.0
    elif rate < 1.0:
        limit = math.ceil(math.log(FADED) / math.log(rate))
    steps = int(min(horizon, max(SHORT, ahead + limit)))
    cost = steps * work
    if horizon > 10**6 and cost > ABSURD:
        raise ValueError(
            f"horizon must be one that can be carried out; {horizon} steps take some {cost:.0e} multiply-adds "
            f"({cost / 3.6e12:.2g} hours), and nothing ends them earlier"
        )
    _checks.require_memory(steps * kept, "horizon", horizon)
    if steps < horizon:
        warnings.warn(
            f"horizon {horizon} is followed to step {steps}: from there on the discount leaves less of a reward than "
            f"2**-200, which no float shows beside the sum",
            stacklevel=3,
        )
    elif cost > SLOW:
        warnings.warn(f"horizon {horizon} takes some {cost:.0e} multiply-adds ({cost / 1e9:.2g} seconds)", stacklevel=3)
    return steps


def steps_of(horizon: object, model: Rewarding, policy: PolicyLike | None = None, *, kept: float = 1.0) -> int:
    """A horizon as a positive int, as far as it is ``followed`` in ``model``; with a policy (T, S, A) to its end."""
    steps = _checks.positive_integer(horizon, "horizon")
    if steps <= SHORT or changes_with_time(policy):
        return steps
    growth = max(1.0, float(row_sums(model.transitions).max()))
    rate = model.discount * (growth if growth > 1.0 + 2.0 * _checks.SUM_TOLERANCE else 1.0)
    return followed(steps, rate, ahead=model.n_states, work=model.transitions.nnz, kept=kept)


def optional_steps(
    horizon: object, model: Rewarding, policy: PolicyLike | None = None, *, kept: float = 1.0
) -> int | None:
    """``steps_of``, or None for the infinite sum."""
    return None if horizon is None else steps_of(horizon, model, policy, kept=kept)


def total_discount(discount: float, horizon: int | None) -> float:
    """sum_t discount^t over the horizon."""
    if horizon is None:
        return 1.0 / (1.0 - discount)
    return float(horizon) if discount == 1.0 else (1.0 - discount**horizon) / (1.0 - discount)

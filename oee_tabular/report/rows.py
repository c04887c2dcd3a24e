"""One estimate of one policy, and which of a policy's estimates is stated first."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from oee_tabular._results import checked
from oee_tabular.estimators import Estimate


@checked()
@dataclass(frozen=True)
class Result:
    """Hold one estimate of one policy with its name.

    Attributes
    ----------
    policy : str
        The name of the policy in the report.
    estimator : str
        The name of the estimator in the report.
    estimate : Estimate
        The value, a discounted sum of rewards. It is never multiplied by (1 -
        discount).

    Examples
    --------
    >>> Result("expert", "oee", Estimate(1.25, 0.5))
    Result(policy='expert', estimator='oee', estimate=Estimate(1.25 ± 0.5 (standard error)))
    """

    policy: str
    estimator: str
    estimate: Estimate


def first_results(results: Sequence[Result]) -> dict[str, Result]:
    """Choose the result of each policy that a report states first.

    A finite value goes before none, a value that the log corrects before others, and
    the simulator's value comes last.
    """

    def order(result: Result) -> tuple[bool, bool, bool, bool]:
        """Return a key that puts the result to be stated first before all others."""
        found = result.estimate
        return (
            not math.isfinite(found.value),
            not found.is_headline,
            found.model_value is None,
            not found.is_from_log,
        )

    names = dict.fromkeys(result.policy for result in results)
    return {
        name: min((result for result in results if result.policy == name), key=order)
        for name in names
    }

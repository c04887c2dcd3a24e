"""What the user knows about the target: a box, a tie or features; passed on to intervals, comparison and estimators."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Any

from oee_tabular.estimators import Estimator, OffEnvironment, Problem
from oee_tabular.inference import Interval, interval
from oee_tabular.ratio import transition_ratio


@dataclass(frozen=True, eq=False)
class Assumptions:
    """Assumptions about the target.

    Parameters
    ----------
    lower_ratio, upper_ratio : the box lower_ratio * P <= P_target <= upper_ratio * P, which narrows likelihood and guaranteed
        intervals; None: any probabilities of what the simulator makes possible
    tie, features : transitions that are alike, or directions of change, as in ``transition_ratio``; one of them. Each adds a
        row (oee-tied, oee-features) whose interval is that of its own model (``inference.shared``)

    Examples
    --------
    >>> list(Assumptions(tie=[0, 0, 1]).estimators())
    ['oee-tied']
    """

    lower_ratio: float | None = None
    upper_ratio: float | None = None
    tie: Any = field(default=None, repr=False)
    features: Any = field(default=None, repr=False)

    @property
    def box(self) -> dict[str, Any]:
        """The box, as ``interval`` takes it."""
        return {"lower_ratio": self.lower_ratio, "upper_ratio": self.upper_ratio}

    def __str__(self) -> str:
        """The box in words; "" without one."""
        if self.lower_ratio is None and self.upper_ratio is None:
            return ""
        lower, upper = self.lower_ratio or 0.0, "any number of" if self.upper_ratio is None else f"{self.upper_ratio:g}"
        return f"assumed between {lower:g} and {upper} times the simulator's probabilities"

    def estimators(self) -> dict[str, Estimator]:
        """The estimators that rest on the tie or the features, by name."""
        if self.tie is not None and self.features is not None:
            raise ValueError("tie and features must not be given together: they are two different models")
        own: dict[str, Estimator] = {}
        if self.tie is not None:
            own["oee-tied"] = OffEnvironment(ratio=partial(transition_ratio, method="tied", tie=self.tie))
        if self.features is not None:
            own["oee-features"] = OffEnvironment(ratio=partial(transition_ratio, prior="tilt", features=self.features))
        return own

    def interval(self, problem: Problem, policy: Any, **options: Any) -> Interval:
        """The interval in the box; a ValueError where the log contradicts it, with the pairs."""
        found = interval(problem, policy, **options, **self.box)
        if self.box != {"lower_ratio": None, "upper_ratio": None} and found.status != "ok":
            raise ValueError(f"lower_ratio and upper_ratio must fit the log: {found.status}")
        return found

    def model_interval(self, problem: Problem, policy: Any, confidence: float) -> Interval | None:
        """The interval under the tie or the features; None without them."""
        if self.tie is None and self.features is None:
            return None
        return interval(problem, policy, tie=self.tie, features=self.features, confidence=confidence)

"""``contest``: which of several policies is worth most, by how much, or that the log cannot say."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from oee_tabular import __version__, _checks, _printing, _progress
from oee_tabular._checks import Array
from oee_tabular._threads import one_thread
from oee_tabular.estimators import OffEnvironment, Problem
from oee_tabular.inference import Comparison, Interval
from oee_tabular.inference.comparison import several_policies
from oee_tabular.report.assumptions import Assumptions
from oee_tabular.report.quoting import LIKELIHOOD, quoted
from oee_tabular.report.results import aligned
from oee_tabular.report.sureness import Sureness, how_sure, ranked, sampling_columns

NO_P_BEST = "; beyond 10% there is no P(best), nor where the differences cannot say."


@dataclass(frozen=True)
class Contest:
    """What ``oee compare`` prints.

    Attributes
    ----------
    comparison : of the log's own frequencies: intervals of the differences, P(best); those from one policy hold all at once
    sureness : likelihood intervals of each policy, and the sentence
    confidence : of the intervals
    values : policy -> the value that ``evaluate`` gives as ``oee``, best first

    Examples
    --------
    >>> import oee_tabular as oee
    >>> pair = oee.testing.case("ragged")
    >>> found = contest(pair.problem(1000, seed=0), {"new": pair.policy, "recorded": pair.behavior})
    >>> print(found.sentence)
    Of 2 policies, “new” is worth most in the target. It is better than “recorded” by 3.255 (95%: 3.134 to 3.389).
    >>> found.to_dict()["differences"][0]["upper"] < 0
    True
    """

    comparison: Comparison
    sureness: Sureness
    confidence: float
    values: Mapping[str, float]

    @property
    def sentence(self) -> str:
        """Which policy is worth most, or which of them it may be."""
        return self.sureness.ranking

    @property
    def best(self) -> str | None:
        """The policy that is worth most, None where the log cannot say, or several are worth the same."""
        return self.sureness.best

    def to_dict(self) -> dict[str, Any]:
        """Everything, as plain values."""
        found = self.comparison
        policies, differences = [], []
        leader = next(iter(self.values))
        best = found.decide(self.values, self.sureness.likelihood).probability_best
        for name, value in self.values.items():
            i, ends = found.names.index(name), self._interval(name)
            policies.append(
                {
                    "policy": name,
                    "value": value,
                    "lower": None if ends is None else ends.lower,
                    "upper": None if ends is None else ends.upper,
                    **sampling_columns(ends, 1.0),
                    "probability_best": best[name],
                    "unseen_share": float(found.unseen_share[i]),
                }
            )
            if name != leader:
                differences.append({"policy": name, "than": leader} | self._difference(name, leader))
        return {
            "version": __version__, "confidence": self.confidence, "best": self.best, "sentence": self.sentence,
            "policies": policies, "differences": differences,
        }  # fmt: skip

    def to_json(self) -> str:
        """``to_dict`` as JSON."""
        return json.dumps(self.to_dict(), indent=2, allow_nan=False)

    def __str__(self) -> str:
        head = ["policy", "value", f"{self.confidence:.0%} interval", "P(best)", "unseen", "less than the best by"]
        body = [self._row(record) for record in self.to_dict()["policies"]]
        told = [
            f"Values: {_printing.SUM}, as oee evaluate gives them (oee); their intervals by the likelihood, those of "
            f"differences by the log's frequencies, for all at once, at {self.confidence:.0%}. unseen: share of the policy's "
            "time of which the log says nothing"
            + (
                "; beyond 10% there is no P(best), nor where the differences cannot say."
                if "-" in [row[3] for row in body]
                else "."
            )
        ]
        return "\n".join([self.sentence, "", *aligned([head, *body], numeric_from=len(head)), "", *told])

    def _row(self, record: Mapping[str, Any]) -> list[str]:
        leader, ends = next(iter(self.values)), self._interval(record["policy"])
        form = ".5g" if ends is None else _printing.spec(ends.lower, ends.upper)
        best, less = record["probability_best"], ""
        if record["policy"] != leader:
            less_by = self._difference(leader, record["policy"])
            low, high = less_by["lower"], less_by["upper"]
            less = f"{less_by['difference']:{_printing.spec(low, high)}} {_printing.interval(low, high)}"
        return [
            record["policy"],
            format(record["value"], form),
            "" if ends is None else _printing.interval(ends.lower, ends.upper),
            "-" if best is None else f"{best:.1%}",
            f"{record['unseen_share']:.1%}",
            less,
        ]

    def _difference(self, one: str, other: str) -> dict[str, float]:
        """Of two values, and its interval, which has the difference of those that are shown in it."""
        found, apart = self.comparison, self.values[one] - self.values[other]
        pair = found.names.index(one), found.names.index(other)
        return {
            "difference": apart, "lower": min(float(found.lower[pair]), apart), "upper": max(float(found.upper[pair]), apart)
        }  # fmt: skip

    def _interval(self, name: str) -> Interval | None:
        found = self.sureness.intervals.get(name, {}).get(LIKELIHOOD)
        return found if found is not None and found.status == "ok" else None


@one_thread
def contest(
    problem: Problem,
    policies: object,
    *,
    confidence: float = 0.95,
    quick: bool = False,
    lower_ratio: float | None = None,
    upper_ratio: float | None = None,
) -> Contest:
    """Compare policies on one log: differences with their intervals, P(best), and the sentence.

    Parameters
    ----------
    problem : Problem
    policies : two or more, as for ``evaluate``
    confidence : of the values' intervals, and of all differences from the best together
    quick : whether likelihood intervals are left out
    lower_ratio, upper_ratio : the box lower_ratio * P <= P_target <= upper_ratio * P, which narrows intervals and differences

    Raises
    ------
    ValueError
        Fewer than two policies; discount 1 without a horizon; bad arguments.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> pair = oee.testing.case("ragged")
    >>> contest(pair.problem(20, seed=0), {"one": pair.policy, "same": pair.policy}).best is None
    True
    """
    _checks.instance(problem, Problem, "problem", "Problem(simulator, log, ...)")
    level = _checks.number_in(confidence, "confidence", 0.0, 1.0, open_ends=True)
    _checks.boolean(quick, "quick")
    named = several_policies(policies, problem.simulator)
    if problem.simulator.discount == 1.0 and problem.horizon is None:
        raise ValueError("horizon must be given at discount 1")
    box = Assumptions(lower_ratio, upper_ratio)
    sure = how_sure(problem, named, level, guaranteed=False, quick=quick, scale=1.0, assumed=box)
    found = sure.comparison
    assert found is not None
    values = {name: _value(problem, named[name], sure, name, level) for name in named}
    values = {name: values[name] for name in sorted(named, key=lambda name: -values[name])}
    return Contest(found, ranked(sure, values), level, values)


def _value(problem: Problem, policy: Array, sure: Sureness, name: str, level: float) -> float:
    """What ``evaluate`` shows as ``oee``; where that has no value, maximum likelihood's."""
    _progress.report_step(f"value of “{name}”")
    estimate = OffEnvironment()(problem, policy, seed=0)  # exact: no seed matters
    found = quoted(estimate, sure.intervals.get(name, {}).get(LIKELIHOOD), level).value
    assert sure.comparison is not None
    return found if math.isfinite(found) else float(sure.comparison.values[sure.comparison.names.index(name)])

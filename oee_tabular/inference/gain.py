"""The gain of a policy over the one that runs, and a bound below it.

The gain is J(pi) - J(pi_0), both values in one model P'. Its lower end,

    L = min {J(pi; P') - J(pi_0; P') : sum_x n_x KL(phat_x || P'_x) <= chi^2_1 / 2},

has one budget for all rows, so that what the two policies share cancels. Rows that were
never recorded are anywhere on the simulator's support, in the box, or within a factor
of the estimated rows. L is the lower end of an interval (``profile_ascent``): where J
of the running policy is known, it is that of ``interval`` less this value. The interval
is two-sided, so that one-sidedly L is below the gain more often than the confidence
says.

The point gain is the difference of the default's values, as in ``comparison``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from statistics import NormalDist

import numpy as np

from oee_tabular._progress import Watch
from oee_tabular.estimators import Problem
from oee_tabular.estimators.off_environment import estimate_with_rows
from oee_tabular.exceptions import ArgumentError
from oee_tabular.inference.asymptotic import outside_margin
from oee_tabular.inference.evidence import Evidence, describe_rows, evidence_of
from oee_tabular.inference.profile_ascent import Search
from oee_tabular.inference.robust import find_contradictions
from oee_tabular.typing import Array

Box = tuple[float | None, float | None]


@dataclass(frozen=True, eq=False)
class Gain:
    """The gain of a policy over another one, from a problem's log.

    ``problem`` has the log that the bound rests on, the ``whole`` one or a part of it.
    ``box`` are the bounds of P_target / P, and ``factor`` is the one that unrecorded
    pairs are within, inf for none.
    """

    problem: Problem
    whole: Problem
    policy: Array
    running: Array
    confidence: float
    box: Box
    factor: float

    @property
    def is_none(self) -> bool:
        """Return whether the two policies are one."""
        return bool(np.array_equal(self.policy, self.running))

    @cached_property
    def evidence(self) -> Evidence:
        """Return the evidence, with unrecorded rows within the factor."""
        problem = self.problem
        evidence = evidence_of(
            problem.model, self.policy, problem.horizon, problem.counts, *self.box
        )
        if np.isinf(self.factor):
            return evidence
        _, estimated = estimate_with_rows(problem, self.policy)
        near = evidence.near(estimated, self.factor)
        never = evidence.rows.spread(evidence.n) == 0
        return replace(
            evidence,
            phat=np.where(never, near.phat, evidence.phat),
            low=np.where(never, near.low, evidence.low),
            high=np.where(never, near.high, evidence.high),
        )

    @cached_property
    def point(self) -> float:
        """Return the difference of the default's values, nan where one is missing."""
        if self.is_none:
            return 0.0
        ours, theirs = (
            estimate_with_rows(self.problem, policy)[0].value
            for policy in (self.policy, self.running)
        )
        return float(ours - theirs)

    @cached_property
    def _search(self) -> Search:
        """Return the search for the lower end."""
        return Search.begin(self.evidence, self.confidence, self.running)

    @cached_property
    def rough(self) -> float:
        """Return a lower end that a thorough search may find to be lower."""
        return self._find(is_rough=True)

    @cached_property
    def lower(self) -> float:
        """Return the lower end; in large problems the rough one, for time."""
        if not self.is_none and self._search.is_large:
            return self.rough
        return self._find(is_rough=False)

    def _find(self, *, is_rough: bool) -> float:
        """Find the lower end, and widen it for what the simulator may lack."""
        if self.is_none:
            return 0.0
        search = self._search
        end = search.find_end(-1.0, Watch(None), is_rough=is_rough)
        if not is_rough:
            other = search.find_end(1.0, Watch(None), is_rough=True)
            end = search.leave_limit(end, other, -1.0, Watch(None))
        return self._widen(end.value)

    def _widen(self, lower: float) -> float:
        """Lower the end for dropped transitions and a simulator made of samples.

        What they may take of one value they may add to the other.
        """
        ours, theirs = (
            outside_margin(self.whole, replace(self.evidence, policy=policy))
            for policy in (self.policy, self.running)
        )
        if ours is None or theirs is None:
            return lower
        z = NormalDist().inv_cdf(0.5 + self.confidence / 2.0)
        spread = z * float(np.sqrt(ours.variance) + np.sqrt(theirs.variance))
        middle = ours.value - theirs.value
        below = float(np.hypot(max(middle - lower, 0.0), spread))
        return middle - below - ours.down - theirs.up


def require_consistent_box(gain: Gain) -> None:
    """Refuse a box that the log contradicts, and one beside dropped transitions."""
    given = [
        name
        for name, bound in zip(("lower_ratio", "upper_ratio"), gain.box, strict=True)
        if bound is not None
    ]
    if not given:
        return
    problem = gain.whole
    if problem.dropped.any():
        raise ArgumentError(
            given[0],
            "must be None if impossible transitions were dropped: no box contains"
            f" those; it is {gain.box[given[0] == 'upper_ratio']:g}",
        )
    # the counts of a log of episodes are random themselves
    wrong = find_contradictions(
        gain.evidence,
        gain.confidence,
        "anytime" if problem.log.by_episodes else "independent",
    )
    if wrong.size:
        lower, upper = gain.box
        raise ArgumentError(
            given[0],
            "must be of a box that the log does not contradict; the counts contradict"
            f" [{lower or 0.0:g}, {np.inf if upper is None else upper:g}] in"
            f" {wrong.size} state-action pair{'s' if wrong.size > 1 else ''}:"
            f" {describe_rows(gain.evidence, wrong)} (widen it)",
        )

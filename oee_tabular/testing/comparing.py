"""Does the mean of an estimator's values tend to a number? What the statistical laws share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import stdtrit

from oee_tabular._checks import Array
from oee_tabular.testing.calls import Broken, Subject
from oee_tabular.testing.cases import Case

SMALL, LARGE = 300, 4800  # episodes
ROLLOUTS = {SMALL: 100, LARGE: 1000}  # of an estimator that has such a field, at least
SURE = 1e-5  # chance of a right estimator's failing a comparison, two-sided


@dataclass(frozen=True)
class Runs:
    """Values of independent logs of ``SMALL`` and of ``LARGE`` episodes (the small ones without those that had no value)."""

    small: Array
    large: Array

    @property
    def mean(self) -> float:
        """Mean over the large logs."""
        return float(self.large.mean())

    @property
    def tolerance(self) -> float:
        """How far the mean may be from its limit: by chance, and by a third of what 16 times as many episodes moved it.

        A bias of order n^-1/2 is moved by three times what is left of it, one of order 1/n by 15 times.
        """
        n = len(self.large)
        chance = float(stdtrit(n - 1, 1.0 - SURE / 2) * self.large.std(ddof=1) / np.sqrt(n))
        moved = abs(float(self.small.mean()) - self.mean) / 3.0 if len(self.small) else 0.0
        return chance + moved


def runs(subject: Subject, pair: Case) -> Runs:
    """The values on a case, worked out once."""
    if pair.name not in subject.memory:
        small, large = [], []
        key = sum(pair.name.encode())
        half = max(subject.repetitions // 2, 2)
        for k, log in enumerate(pair.logs(SMALL, half, seed=subject.log_seed(key, SMALL))):
            try:
                small.append(subject.value(pair, log, seed=k, rollouts=ROLLOUTS[SMALL]))
            except Broken as broken:
                if broken.outcome == "raises":
                    raise
        for k, log in enumerate(pair.logs(LARGE, subject.repetitions, seed=subject.log_seed(key, LARGE))):
            large.append(subject.value(pair, log, seed=1000 + k, rollouts=ROLLOUTS[LARGE]))
        subject.memory[pair.name] = Runs(np.array(small), np.array(large))
    found: Any = subject.memory[pair.name]
    assert isinstance(found, Runs)
    return found


def tends_to(subject: Subject, pair: Case, goal: float, what: str) -> str:
    """A sentence with the numbers, or ``Broken``."""
    found = runs(subject, pair)
    allowed = found.tolerance + 1e-9 * max(1.0, abs(goal))
    numbers = f"{pair.name}: mean {found.mean:.5g} (of {len(found.large)} logs of {LARGE} episodes), {what} {goal:.5g}"
    if not abs(found.mean - goal) <= allowed:
        truth = "" if goal == pair.truth else f", J_target {pair.truth:.5g}"
        raise Broken(
            "fails",
            f"{numbers}: off by {abs(found.mean - goal):.3g}, tolerance {allowed:.2g}{truth}",
            f"pair = case({pair.name!r}); estimator(pair.problem({LARGE}, seed=0), pair.policy, seed=0) against {goal:.5g}",
        )
    return f"{numbers}, tolerance {allowed:.2g}"


def exactly(found: float, expected: float, what: str, where: str, *, tolerance: float = 1e-8) -> None:
    """``Broken`` where two numbers differ by more than a relative tolerance."""
    if not abs(found - expected) <= tolerance * max(1.0, abs(expected)):
        raise Broken(
            "fails", f"{what}: {found:.10g}, expected {expected:.10g} (off by {abs(found - expected):.2g})", where
        )


def same_mean(first: Array, second: Array, what: str, where: str) -> str:
    """``Broken`` where the means of two samples differ by more than chance allows."""
    error = float(np.sqrt(first.var(ddof=1) / len(first) + second.var(ddof=1) / len(second)))
    allowed = float(stdtrit(min(len(first), len(second)) - 1, 1.0 - SURE / 2)) * error + 1e-9
    apart = abs(float(first.mean() - second.mean()))
    numbers = f"{what}: means {first.mean():.5g} and {second.mean():.5g} over {len(first)} seeds"
    if not apart <= allowed:
        raise Broken("fails", f"{numbers}, apart by {apart:.2g}, tolerance {allowed:.2g}", where)
    return f"{numbers}, tolerance {allowed:.2g}"

"""How much better a policy looks in the log that made it than in another one.

A policy that is made from a log follows some of its noise, and the same log certifies
too much of it. Halves of the log show by how much. With A and B two halves, pi_A the
candidate that A makes, and g_A(pi) the gain of pi by the frequencies of A,

    optimism = mean of g_A(pi_A) - g_B(pi_A) and of g_B(pi_B) - g_A(pi_B)

over several halvings. It is 0 on average for a policy that no log makes, such as the
simulator's optimum. What is gained by choosing among policies that are nearly equal
grows with the standard error, n^(-1/2), so the optimism of the whole log is that of its
halves by the root of 2. A lower end is lowered by it where it is positive.
"""

from __future__ import annotations

import math

import numpy as np

from oee_tabular import _progress
from oee_tabular.decision.candidates import propose_optima
from oee_tabular.decision.splitting import split_counts
from oee_tabular.estimators import Problem
from oee_tabular.estimators.off_environment import estimate_with_rows
from oee_tabular.exact import policy_value, with_rows
from oee_tabular.exceptions import ArgumentError
from oee_tabular.inference.evidence import gather
from oee_tabular.typing import Array

N_HALVINGS = 4
# pairs, above which the log is halved once, because each half is fitted anew
MAX_PAIRS_OFTEN = 20_000


def measure_optimism(problem: Problem, running: Array) -> dict[str, float]:
    """Compute the optimism of each of the package's candidates, at least 0.

    The halvings are the same whatever the seed. A log that cannot be halved shows none.
    """
    n_halvings = N_HALVINGS if running.size <= MAX_PAIRS_OFTEN else 1
    _, whole = estimate_with_rows(problem, running)
    found: dict[str, list[float]] = {}
    for k in range(n_halvings):
        _progress.report_step(f"halves of the log ({k + 1} of {n_halvings})")
        try:
            parts = split_counts(problem, 0.5, np.random.default_rng(k))
        except ArgumentError:  # a half has no transitions
            continue
        halves = [
            Problem(problem.model, counts, horizon=problem.horizon) for counts in parts
        ]
        gains = [_Gains(half, whole, running) for half in halves]
        for half, own, other in zip(halves, gains, gains[::-1], strict=True):
            for name, policy in propose_optima(half, running):
                excess = own.of(policy) - other.of(policy)
                found.setdefault(name, []).append(excess)
    return {
        name: max(float(np.mean(values)) / math.sqrt(2.0), 0.0)
        for name, values in found.items()
    }


class _Gains:
    """Gains over the running policy by the frequencies of a part of the log.

    Pairs that the part does not hold have the ``whole`` log's rows of zeta P.
    """

    def __init__(self, part: Problem, whole: Array, running: Array) -> None:
        evidence = gather(part, running)
        is_held = evidence.rows.spread(evidence.n) > 0
        rows = np.where(is_held, evidence.phat, whole)
        self._model = with_rows(part.model, rows)
        self._horizon = part.horizon
        self._running = self._value(running)

    def _value(self, policy: Array) -> float:
        """Return the value of a policy."""
        return policy_value(self._model, policy, horizon=self._horizon)

    def of(self, policy: Array) -> float:
        """Return the gain of a policy."""
        return self._value(policy) - self._running

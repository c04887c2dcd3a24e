"""Where the target differs significantly from the simulator: a lower bound on the
change in every recorded pair.

With the confidence asked for, all rows at once satisfy KL(phat || P_target) <= epsilon
(the balls of ``interval(method= "robust")``). A set A of next states has, by the
data-processing inequality, kl(phat(A), P_target(A)) <= epsilon as well, so P_target(A)
>= l, the smaller root of kl(phat(A), l) = epsilon, and the total variation between the
rows is at least l - P(A). A is where the log has more than the simulator, {phat > P}.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import rel_entr

from oee_tabular import _checks
from oee_tabular.estimators import Problem
from oee_tabular.inference.evidence import gather
from oee_tabular.inference.robust import anytime_radius, independent_radius
from oee_tabular.mdp import uniform_policy
from oee_tabular.typing import Array, IntArray


@dataclass(frozen=True, eq=False)
class RowChanges:
    """The distance of each pair from the simulator in total variation, the share of
    transitions that end elsewhere.

    Attributes
    ----------
    certain : (S, A) in [0, 1]: at least so much, all at once, with ``confidence``; 0
        where nothing is certain
    estimated : (S, A) between the log's frequencies and the simulator; 0 without
        transitions
    counts : (S, A) transitions of the log
    evidence : (S, A) nats, n KL(phat || P): the evidence of the pair's own transitions
        against the simulator
    next_state : (S, A) where the log's frequency differs most, -1 without transitions
    simulated, observed : (S, A) its probability in the simulator and its frequency in
        the log; nan without transitions
    confidence, tested : of all rows together; how many they are

    Examples
    --------
    >>> from oee_tabular.testing import case
    >>> changes = row_changes(case("ragged").problem(1000, seed=0))
    >>> changes.n_certain, changes.largest(1), [round(float(x[0, 0]), 2) for x in (changes.certain, changes.estimated)]
    (3, [(0, 0)], [0.14, 0.22])
    """

    certain: Array
    estimated: Array
    counts: Array
    evidence: Array
    next_state: IntArray
    simulated: Array
    observed: Array
    confidence: float
    tested: int

    @property
    def n_certain(self) -> int:
        """In how many (s, a) the target differs for certain."""
        return int((self.certain > 0).sum())

    def largest(self, k: int = 10) -> list[tuple[int, int]]:
        """The k pairs (s, a) with the largest certain change (the more evidence first
        among equals); none that are 0.
        """
        number = _checks.positive_integer(k, "k")
        flat = self.certain.reshape(-1)
        guess = self.evidence.reshape(-1)
        order = np.lexsort((-guess, -flat))[:number]
        return [divmod(int(i), self.certain.shape[1]) for i in order if flat[i] > 0]


def row_changes(problem: Problem, *, confidence: float = 0.95) -> RowChanges:
    """Bound from below the change of each pair's distribution from the simulator.

    Parameters
    ----------
    problem : Problem
    confidence : that every bound holds, in (0, 1)

    Notes
    -----
    Radii are "anytime" for a log with episodes, "independent" otherwise, as in
    ``interval``; they share 1 - confidence evenly among the rows with data and more
    than one next state. Cost: O(nnz).

    Examples
    --------
    >>> import numpy as np
    >>> import oee_tabular as oee
    >>> simulator, target = oee.tasks.gridworld(4, slip=0.3), oee.tasks.gridworld(4, slip=0.0)
    >>> log = oee.sample_transitions(target, np.full((16, 4), 1 / 64), 20_000, seed=0)
    >>> changes = oee.inference.row_changes(oee.Problem(simulator, log))
    >>> s, a = changes.largest(1)[0]
    >>> bool(0.2 < changes.certain[s, a] <= changes.estimated[s, a] <= 0.31)
    True
    """
    _checks.instance(problem, Problem, "problem")
    level = _checks.number_in(confidence, "confidence", 0.0, 1.0, open_ends=True)
    evidence = gather(problem, uniform_policy(problem.simulator))
    n = evidence.n
    phat = evidence.phat
    rows = evidence.rows
    simulated = evidence.rows.weights
    tested = (n > 0) & evidence.open_rows
    have = n > 0
    shape = evidence.policy.shape
    number = int(tested.sum())
    radius = anytime_radius if problem.log.by_episodes else independent_radius
    epsilon = radius(n, np.diff(rows.indptr), (1.0 - level) / max(number, 1))
    more = phat > simulated
    change = np.abs(phat - simulated)
    seen_mass = np.minimum(rows.sums(np.where(more, phat, 0.0)), 1.0)
    least = lower_mass(seen_mass, epsilon) - rows.sums(np.where(more, simulated, 0.0))
    is_largest = change == rows.spread(rows.largest(change))
    entry = np.minimum.reduceat(
        np.where(is_largest, np.arange(len(change)), len(change)), rows.indptr[:-1]
    )
    return RowChanges(
        np.where(tested, np.maximum(least, 0.0), 0.0).reshape(shape),
        np.where(have, 0.5 * rows.sums(change), 0.0).reshape(shape),
        n.reshape(shape),
        (n * rows.sums(rel_entr(phat, simulated))).reshape(shape),
        np.where(have, rows.arrival[entry], -1).astype(np.int64).reshape(shape),
        np.where(have, simulated[entry], np.nan).reshape(shape),
        np.where(have, phat[entry], np.nan).reshape(shape),
        level,
        number,
    )


def lower_mass(frequency: Array, epsilon: Array) -> Array:
    """The smallest p with kl(frequency, p) <= epsilon, binary; rounded down. Bisection,
    O(60) passes.
    """
    low = np.zeros(len(frequency))
    high = np.array(frequency)
    for _ in range(60):
        middle = 0.5 * (low + high)
        outside = (
            rel_entr(frequency, middle) + rel_entr(1.0 - frequency, 1.0 - middle)
            > epsilon
        )
        low = np.where(outside, middle, low)
        high = np.where(outside, high, middle)
    return low

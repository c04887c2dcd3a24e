"""Where the target differs from the simulator: a lower bound on every pair's change.

With the confidence asked for, all rows at once satisfy KL(phat || P_target) <= epsilon
(the balls of ``interval(method="robust")``). By the data-processing inequality, a set A
of next states has kl(phat(A), P_target(A)) <= epsilon as well. So P_target(A) >= l, the
smaller root of kl(phat(A), l) = epsilon, and the total variation between the rows is at
least l - P(A). A is where the log has more than the simulator, {phat > P}.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import rel_entr

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular._results import checked
from oee_tabular.estimators import Problem
from oee_tabular.inference.evidence import gather
from oee_tabular.inference.robust import anytime_radius, independent_radius
from oee_tabular.mdp import reduce_rows, uniform_policy
from oee_tabular.typing import Array, IntArray

N_BISECTIONS = 60  # of [0, 1], to more than a double's 53 bits


@checked(
    shapes=dict.fromkeys(
        (
            *("certain", "estimated", "counts", "evidence"),
            *("next_state", "simulated", "observed"),
        ),
        "S A",
    ),
    levels=("confidence",),
    counts=("tested",),
)
@dataclass(frozen=True, eq=False)
class RowChanges:
    """The distance in total variation of each pair in the target from the simulator.

    The distance is the share of transitions that end elsewhere.

    Attributes
    ----------
    certain : ndarray of shape (S, A)
        A lower bound in [0, 1] on the distance; all bounds hold at once with
        ``confidence``. 0 where nothing is certain.
    estimated : ndarray of shape (S, A)
        The distance in [0, 1] between the log's frequencies and the simulator; 0
        without transitions.
    counts : ndarray of shape (S, A)
        The number of transitions in the log.
    evidence : ndarray of shape (S, A)
        The evidence of the pair's own transitions against the simulator, n KL(phat ||
        P), in nats.
    next_state : ndarray of shape (S, A)
        The next state whose frequency in the log differs most from the simulator; -1
        without transitions.
    simulated : ndarray of shape (S, A)
        The probability of this next state in the simulator; nan without transitions.
    observed : ndarray of shape (S, A)
        The frequency of this next state in the log; nan without transitions.
    confidence : float
        The level at which all bounds hold together, in (0, 1).
    tested : int
        The number of pairs that were tested: recorded, with more than one next state.

    See Also
    --------
    row_changes : Compute these changes.

    Examples
    --------
    >>> from oee_tabular.testing import case
    >>> changes = row_changes(case("ragged").problem(1000, seed=0))
    >>> (
    ...     changes.n_certain,
    ...     changes.largest(1),
    ...     [round(float(x[0, 0]), 2) for x in (changes.certain, changes.estimated)],
    ... )
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
        """Return in how many pairs the target differs for certain."""
        return int((self.certain > 0).sum())

    def largest(self, k: int = 10) -> list[tuple[int, int]]:
        """Return the pairs with the largest certain change.

        Among equal changes the pair with more evidence comes first.

        Parameters
        ----------
        k : int, default 10
            The number of pairs, at most. Pairs without a certain change are left out.

        Returns
        -------
        list of (int, int)
            The pairs (state, action), the largest change first.
        """
        number = _checks.positive_integer(k, "k")
        flat = self.certain.reshape(-1)
        guess = self.evidence.reshape(-1)
        order = np.lexsort((-guess, -flat))[:number]
        return [divmod(int(i), self.certain.shape[1]) for i in order if flat[i] > 0]


@suggest_keywords
def row_changes(problem: Problem, *, confidence: float = 0.95) -> RowChanges:
    """Bound from below the change of each pair's distribution from the simulator.

    Parameters
    ----------
    problem : Problem
        The simulator and the log of the target.
    confidence : float, default 0.95
        The probability in (0, 1) that every bound holds.

    Returns
    -------
    RowChanges
        The bounds and the estimated changes, in total variation.

    Raises
    ------
    ValueError
        If an argument is out of its range.

    See Also
    --------
    interval : Compute an interval for J; its robust method uses the same KL balls.

    Notes
    -----
    Radii are "anytime" for a log with episodes, "independent" otherwise, as in
    ``interval``. They share 1 - confidence evenly among the rows with data and more
    than one next state. Cost: O(nnz).

    Examples
    --------
    >>> import numpy as np
    >>> import oee_tabular as oee
    >>> simulator, target = (
    ...     oee.tasks.gridworld(4, slip=0.3),
    ...     oee.tasks.gridworld(4, slip=0.0),
    ... )
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
    tested = (n > 0) & evidence.is_stochastic
    have = n > 0
    shape = evidence.policy.shape
    number = int(tested.sum())
    radius = anytime_radius if problem.log.by_episodes else independent_radius
    epsilon = radius(n, np.diff(rows.indptr), (1.0 - level) / max(number, 1))
    more = phat > simulated
    change = np.abs(phat - simulated)
    observed_mass = np.minimum(rows.sums(np.where(more, phat, 0.0)), 1.0)
    simulated_mass = rows.sums(np.where(more, simulated, 0.0))
    least = lower_mass(observed_mass, epsilon) - simulated_mass
    is_largest = change == rows.spread(rows.largest(change))
    # the first entry of each row that has its largest change
    entries = np.where(is_largest, np.arange(len(change)), len(change))
    entry = reduce_rows(np.minimum, entries, rows.indptr).astype(np.int64)
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
    """Compute the smallest p with binary kl(frequency, p) <= epsilon, rounded down.

    It takes 60 bisections.
    """
    low = np.zeros(len(frequency))
    high = np.array(frequency)
    for _ in range(N_BISECTIONS):
        middle = 0.5 * (low + high)
        kl = rel_entr(frequency, middle) + rel_entr(1.0 - frequency, 1.0 - middle)
        outside = kl > epsilon
        low = np.where(outside, middle, low)
        high = np.where(outside, high, middle)
    return low

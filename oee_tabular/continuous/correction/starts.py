"""First rows of episodes whose states are not where the episodes began.

A recorder that writes the state of a reset in place of the state in which the robot
started makes one wrong step in each episode. A correction takes them for noise of every
step, and its values are wrong without a sign of it in their intervals.

The thresholds were first set on logs of CartPole and of a cart, and then compared with
26 others on 80 logs of systems drawn anew; 80 more were kept aside
(``tests/benchmarks/first_rows.py``). On those false first rows are seen in 91, 88 and
68% (rows of the episode before, of one start, zeros), and in 1% of the true logs. With
a share of 0.3 and a ratio of 5 these are 94, 91 and 72%, but 2% of the true logs, and 4%
of the first half.
"""

from __future__ import annotations

import numpy as np

from oee_tabular.continuous.log.transitions import ContinuousTransitions
from oee_tabular.typing import Array

MIN_EPISODES = 5  # whose first rows are odd; fewer are odd rows, of which another note
MIN_SHARE = 0.5  # of a coordinate's unexplained squares, by the first rows alone
# how often larger the mean square of first rows must be than that of second ones,
# because a correction may be worse where episodes start
MIN_RATIO = 10.0


def odd_starts(log: ContinuousTransitions, left_over: Array, least: Array) -> Array:
    """Return the share of squares that first rows make of what is unexplained.

    Parameters
    ----------
    log : ContinuousTransitions
        The log.
    left_over : ndarray of shape (n, k)
        What the simulator, or a correction, leaves of each row for each of k targets.
    least : ndarray of shape (k,)
        The root mean square up to which what is left matters to nobody.

    Returns
    -------
    ndarray of shape (k,)
        The share, in [0, 1]; 0 where first rows are like others.
    """
    none = np.zeros(left_over.shape[1])
    if log.episode is None:
        return none
    order = np.argsort(log.episode, kind="stable")
    begins = np.append(True, np.diff(log.episode[order]) != 0)
    first, second = order[begins], order[np.append(False, begins[:-1]) & ~begins]
    if min(len(first), len(second)) < MIN_EPISODES:
        return none
    squares = left_over**2
    total = squares.sum(axis=0)
    of_first, of_second = (squares[rows].mean(axis=0) for rows in (first, second))
    share = squares[first].sum(axis=0) / np.where(total > 0.0, total, 1.0)
    n_large = (squares[first] > MIN_RATIO * of_second).sum(axis=0)
    is_odd = (
        (share > MIN_SHARE)
        & (of_first > MIN_RATIO * of_second)
        & (of_first > MIN_RATIO * total / len(log))
        & (n_large >= MIN_EPISODES)
        & (np.sqrt(total / len(log)) > least)
    )
    return np.where(is_odd, share, 0.0)

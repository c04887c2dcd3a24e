"""Whether a log's episodes begin where the simulator says that they do.

Of n episodes k_s begin in state s, to which the simulator gives p_s. Each state with an
episode, or with one expected, is tested by the binomial tails, all of S at ``LEVEL``
together. Where the simulator's own first states are frequencies of N samples, p_s is
the end of its Clopper-Pearson interval at ``SAMPLED_LEVEL``.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from oee_tabular.mdp import FiniteMDP
from oee_tabular.typing import Array

LEVEL = 1e-6
SAMPLED_LEVEL = 1e-7
MIN_EXPECTED = 10.0  # episodes of a state where none begins


class StartConflict(NamedTuple):
    """Hold the state that speaks most against the simulator's first states.

    ``number`` of ``episodes`` begin there; ``probability`` is the simulator's.
    """

    state: int
    number: int
    episodes: int
    probability: float


def find_start_conflict(log: Any, simulator: FiniteMDP) -> StartConflict | None:
    """Return where a log's episodes begin otherwise than the simulator's, or None.

    It is None as well where the log has no episodes.
    """
    starts = log.episode_starts
    if starts is None:
        return None
    n = len(starts) - 1
    law = simulator.initial
    counts = np.bincount(log.state[starts[:-1]], minlength=len(law))
    tested = np.flatnonzero((counts > 0) | (n * law >= MIN_EXPECTED))
    chances = _find_chances(
        counts[tested].astype(np.float64), n, law[tested], simulator
    )
    k = int(np.argmin(chances))
    if 2.0 * len(law) * chances[k] > LEVEL:
        return None
    # of several states that are sure the one with most episodes
    sure = tested[2.0 * len(law) * chances <= LEVEL]
    state = int(sure[np.argmax(counts[sure])])
    return StartConflict(state, int(counts[state]), n, float(law[state]))


def _find_chances(counts: Array, n: int, law: Array, simulator: FiniteMDP) -> Array:
    """Return for each state the smaller of the two tails of its number of episodes."""
    from scipy import special

    least: Any = law
    most: Any = law
    sampling = simulator.sampling
    if sampling is not None and np.isfinite(sampling.starts):
        of = sampling.starts
        known = np.minimum(law * of, of)
        most = special.betaincinv(
            known + 1, np.maximum(of - known, 1e-9), 1 - SAMPLED_LEVEL
        )
        least = special.betaincinv(
            np.maximum(known, 1e-9), of - known + 1, SAMPLED_LEVEL
        )
        most = np.where(known >= of, 1.0, most)
        least = np.where(known <= 0, 0.0, least)
    # P(K >= k) and P(K <= k)
    upper = np.where(
        counts > 0, special.betainc(np.maximum(counts, 1), n - counts + 1, most), 1.0
    )
    lower = np.where(
        counts < n,
        special.betainc(np.maximum(n - counts, 1), counts + 1, 1 - least),
        1.0,
    )
    return np.asarray(np.minimum(upper, lower))

"""A log in two parts: one chooses a policy, the other one certifies it."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._sparse import canonical, csr_on_pattern
from oee_tabular.data import Transitions
from oee_tabular.estimators import Problem
from oee_tabular.exceptions import ArgumentError
from oee_tabular.ratio.support import without_impossible
from oee_tabular.typing import Csr, Seed

HALF = 0.5  # of the log: what chooses where ``split`` is True


def check_split(split: object) -> float | None:
    """Return the share of the log that chooses; None where it is not split."""
    if split is None or split is False:
        return None
    if split is True:
        return HALF
    return _checks.number_in(split, "split", 0.0, 1.0, open_ends=True)


def split_counts(problem: Problem, share: float, seed: Seed) -> tuple[Csr, Csr]:
    """Draw the counts of the part that chooses, and of the one that certifies.

    Whole episodes are drawn where the log has them, else single transitions.
    """
    generator = _checks.generator(seed)
    whole = problem.counts
    log = problem.log
    starts = log.episode_starts if isinstance(log, Transitions) else None
    has_episodes = starts is not None and len(starts) > 2
    if has_episodes and problem.observed is log and starts is not None:
        assert isinstance(log, Transitions)
        n_episodes = len(starts) - 1
        number = min(max(round(share * n_episodes), 1), n_episodes - 1)
        chosen = np.zeros(n_episodes, dtype=np.bool_)
        chosen[generator.permutation(n_episodes)[:number]] = True
        rows = np.flatnonzero(np.repeat(chosen, np.diff(starts)))
        model = problem.simulator
        first = log.select(rows).counts(model.n_states, model.n_actions)
        first, _ = without_impossible(first, model)
    else:
        drawn = generator.binomial(whole.data.astype(np.int64), share)
        first = csr_on_pattern(whole, drawn.astype(np.float64))
    parts = tuple(
        canonical(sparse.csr_array(part), drop_zeros=True)
        for part in (first, whole - first)
    )
    for part in parts:
        if part.nnz == 0:
            raise ArgumentError(
                "split",
                "must leave transitions to both parts of the log; with"
                f" {whole.sum():.0f} in all, one of them has none (record more, or"
                " leave it out)",
            )
    return parts[0], parts[1]

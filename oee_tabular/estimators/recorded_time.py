"""The share of a policy's time that the log has recorded."""

from __future__ import annotations

from typing import Any

import numpy as np

from oee_tabular.estimators.problem import Problem
from oee_tabular.typing import Array


def learnable_shares(problem: Problem, time: Array) -> Array:
    """Compute the shares of the policy's time, without states that no action leaves.

    ``time`` and the result have the shape (S, A).
    """
    alive = np.where(problem.simulator.closed()[:, None], 0.0, time)
    return np.asarray(alive / (float(alive.sum()) or 1.0))


def coverage(problem: Problem, shares: Array, counts: Array) -> dict[str, Any]:
    """Compute the share of the policy's time in recorded pairs, and the sample size.

    ``shares`` (S, A) are those of ``learnable_shares``, ``counts`` (S, A) the log's.
    The effective sample size is (sum d)^2 / (sum d^2 / n) over recorded pairs: as many
    transitions drawn from the policy's occupancy have the same variance.
    """
    recorded = counts > 0
    d = shares[recorded]
    n = counts[recorded]
    missed = np.where(recorded, 0.0, shares)
    share = float(missed.sum())
    spread = float(np.sum(d * d / n))
    longest = np.argsort(-missed, axis=None, kind="stable")[:3]
    pairs = [divmod(int(k), shares.shape[1]) for k in longest if missed.flat[k] > 0]
    return {
        "unrecorded": "; ".join(problem.simulator.names.pair(s, a) for s, a in pairs),
        "coverage": 1.0 - share,
        "unrecorded_share": share,
        "effective_sample_size": float(d.sum()) ** 2 / spread if spread > 0 else 0.0,
    }

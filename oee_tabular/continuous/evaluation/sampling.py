"""Rows of a report by importance sampling on the log's own episodes.

The policy's probabilities are those in the log's own states: every row of the log is a
state of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
from scipy import sparse

from oee_tabular.continuous.correction.history import consecutive
from oee_tabular.continuous.log.transitions import ContinuousTransitions
from oee_tabular.continuous.task.base import (
    StatePolicy,
    check_probabilities,
)
from oee_tabular.data import Transitions
from oee_tabular.estimators import (
    Estimate,
    Estimator,
    Problem,
)
from oee_tabular.mdp import FiniteMDP


def sampling_rows(
    wanted: Mapping[str, Estimator],
    log: ContinuousTransitions,
    n_actions: int,
    horizon: int,
    discount: float,
) -> dict[str, Callable[[StatePolicy], Estimate]]:
    """Return importance sampling rows by name, on the episodes of a log.

    A row is a function of a policy, which estimates its value.

    The log's actions are numbers. Row i of the log is state i; whatever is done there,
    the row that follows in its episode comes, or the end, state n. What follows a
    truncated episode is not known; it is not the end.
    """
    if not wanted:
        return {}
    n = len(log)
    before, after = consecutive(log)
    following = np.append(np.where(log.terminated, n, 0), n)
    following[before] = after
    entries = (
        np.ones((n + 1) * n_actions),
        np.repeat(following, n_actions),
        np.arange((n + 1) * n_actions + 1),
    )
    kernel = sparse.csr_array(entries, shape=((n + 1) * n_actions, n + 1))
    rewards = np.zeros(n + 1) if log.reward is None else np.append(log.reward, 0.0)
    mdp = FiniteMDP(kernel, rewards, np.full(n + 1, 1.0 / (n + 1)), discount)
    columns: dict[str, Any] = log.columns() | {
        "state": np.arange(n),
        "next_state": following[:n],
    }
    columns["truncated"] = ~np.isin(np.arange(n), before) & ~log.terminated
    if log.reward is None:  # without rewards there is nothing to average
        columns |= {"episode": None, "timestep": None}
    problem = Problem(mdp, Transitions(**columns), horizon=horizon)

    def weigh(estimator: Estimator, policy: StatePolicy) -> Estimate:
        """Estimate a policy's value by its probabilities in the log's own states."""
        table = check_probabilities(policy, log.state, n_actions)
        at_end = np.full(n_actions, 1.0 / n_actions)
        return estimator(problem, np.vstack([table, at_end]))

    return {name: partial(weigh, estimator) for name, estimator in wanted.items()}

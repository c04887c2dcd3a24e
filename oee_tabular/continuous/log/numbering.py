"""A log of a task with its actions as the task's numbers.

Every caller that steps a task from a log's rows asks here, so that the log is held
against the task, and warned about, in one place.
"""

from __future__ import annotations

import numpy as np

from oee_tabular.continuous.log.transitions import ContinuousTransitions
from oee_tabular.continuous.task.base import (
    ContinuousTask,
    StatePolicy,
    check_probabilities,
    require_log_of,
)
from oee_tabular.typing import IntArray


def number_actions(
    task: ContinuousTask, log: ContinuousTransitions, *, strict: bool = False
) -> IntArray:
    """Return the number (n,) of the task's action that each row of its log took.

    A log of other states is a ValueError. Commands that the task does not have are
    those nearest to them, with a warning, or an error if ``strict``.
    """
    require_log_of(task, log)
    return log.action_numbers(task.actions, strict=strict)


def number_log(
    task: ContinuousTask,
    log: ContinuousTransitions,
    *,
    strict: bool = False,
    behavior: StatePolicy | None = None,
) -> ContinuousTransitions:
    """Return the log with numbers of the task's actions in place of commands.

    ``behavior``, the policy that recorded the log, gives the probabilities of its
    actions where the log has none.
    """
    actions = number_actions(task, log, strict=strict)
    columns = log.columns() | {"action": actions}
    if behavior is not None and log.behavior_probability is None:
        every = check_probabilities(behavior, log.state, task.n_actions)
        columns["behavior_probability"] = every[np.arange(len(log)), actions]
    return ContinuousTransitions(**columns)

"""A log of a task with its actions as the task's numbers.

Every caller that steps a task from a log's rows asks here, so that the log is held
against the task, and warned about, in one place.
"""

from __future__ import annotations

import warnings

import numpy as np

from oee_tabular.continuous.log.transitions import ContinuousTransitions
from oee_tabular.continuous.task.base import (
    ContinuousTask,
    StatePolicy,
    check_probabilities,
    require_log_of,
)
from oee_tabular.exceptions import DataWarning
from oee_tabular.typing import Array, IntArray


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


def share_commands(task: ContinuousTask, log: ContinuousTransitions) -> Array | None:
    """Return how each row's command is shared out among the task's actions, (n, A).

    The shares are those of ``interpolate_weights``, whose mean is the command. None
    where every row took an action of the task, and where the actions are no product
    grid: a row then counts for the action nearest to its command. Callers have numbered
    the log's actions before, which refuses more of them than memory holds.
    """
    actions = task.actions
    if (
        log.action.ndim == 1
        or actions.ndim == 1
        or log.action.shape[1:] != actions.shape[1:]
    ):
        return None
    if not is_product_grid(actions):
        return None
    shares = interpolate_weights(log.action.astype(np.float64), actions)
    return None if (shares.max(axis=1) == 1.0).all() else shares


def number_and_share(
    task: ContinuousTask, log: ContinuousTransitions
) -> tuple[IntArray, Array | None]:
    """Return the numbers of the actions of each row, and the shares of its command.

    The shares are None where the numbers alone say what was done. Where they are not,
    nobody is warned that commands are moved to the nearest action: they are not.
    """
    require_log_of(task, log)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataWarning)
        actions = number_actions(task, log)
    shares = share_commands(task, log)
    return (number_actions(task, log) if shares is None else actions), shares


def describe_shares(task: ContinuousTask, shares: Array, *, has_cells: bool) -> str:
    """Say what is done with commands between the task's actions, by their shares."""
    n_between = int((shares.max(axis=1) < 1.0).sum())
    others = (
        "the rows on cells and the linear model" if has_cells else "the linear model"
    )
    verb = "take" if has_cells else "takes"
    return (
        f"{n_between:,} of the log's {len(shares):,} commands lie between the task's"
        f" {task.n_actions} actions. The correction reads such a command as a mean of"
        f" the actions around it; {others} {verb} the nearest action."
    )


def is_product_grid(actions: Array) -> bool:
    """Say whether commands (A, k) are all combinations of their coordinates' levels."""
    n_levels = [len(np.unique(column)) for column in actions.T]
    n_unique = len(np.unique(actions, axis=0))
    return bool(np.prod(n_levels) == len(actions) == n_unique)


def interpolate_weights(commands: Array, actions: Array) -> Array:
    """Compute multilinear weights (n, A) on a product grid of actions.

    Commands beyond the grid count as its nearest ones. Where the actions are no product
    grid, the nearest has the weight 1.
    """
    if not is_product_grid(actions):
        distance = ((commands[:, None, :] - actions[None]) ** 2).sum(axis=2)
        return np.asarray(np.eye(len(actions))[distance.argmin(axis=1)])
    levels = [np.unique(column) for column in actions.T]
    shape = tuple(len(each) for each in levels)
    weights = np.ones((len(commands), 1))
    for column, each in zip(commands.T, levels, strict=True):
        parts = [np.interp(column, each, one) for one in np.eye(len(each))]
        own = np.column_stack(parts)
        weights = (weights[:, :, None] * own[:, None, :]).reshape(len(commands), -1)
    columns = zip(actions.T, levels, strict=True)
    place = [np.searchsorted(each, column) for column, each in columns]
    return np.asarray(weights[:, np.ravel_multi_index(tuple(place), shape)])
